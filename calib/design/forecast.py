"""What a calibration will reach, before anything is measured.

The parameters' covariance after a fit of the linearised measurements, C = (diag(1 / tau^2) + sum A_i^T A_i)^-1, gives
the standard deviation of each parameter, and that of a predicted position, sqrt(tr(J C J^T)). One calibration's rms
error over the workspace is a draw: rms^2 = x^T B x with x ~ N(0, C), a sum of chi-squares weighted by the eigenvalues
of C B.

It knows nothing of errors that the model lacks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular

import calib.kinds as registry
from calib.design.candidates import planning_ranges
from calib.design.optimal import information
from calib.design.sensitivity import Sensitivity
from calib.errors import MeasurementError
from calib.identify.registration import register
from calib.identify.setup import rows_of
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.model.observability import analyse, steps
from calib.model.readback import spread_between
from calib.model.robot import Robot, read_only

Array = NDArray[np.float64]

#: Without a prior a direction that no pose tells is held by this much [m and rad], as in a fit.
LEASH = 1.0

#: Draws for the range of one calibration's rms, and their seed: the same every time.
_DRAWS, _SEED = 20_000, 20170401

#: Poses over which a forecast without a plan is made.
_POSES = 4096

#: Share of calibrations whose rms lies inside the range.
_RANGE = 0.90


@dataclass(frozen=True, slots=True, eq=False)
class Workspace:
    """The poses over which accuracy is forecast.

    Attributes:
        measured: shape (n, d, p), see `Sensitivity.measured`.
        located: shape (n, 3 k, p), see `Sensitivity.located`.
        rank: Of the parameters, what the poses of the whole workspace can tell.
    """

    measured: Array
    located: Array
    rank: int

    @classmethod
    def of(cls, sensitivity: Sensitivity, q: Array) -> Workspace:
        """At joint values, shape (n, m), [rad] or [m]."""
        measured, located = sensitivity.measured(q), sensitivity.located(q)
        flat = measured.reshape(-1, measured.shape[2])
        # In metres, as a fit's own analysis: the rank is that which it will find.
        sigma = np.repeat(sensitivity.noise(q), measured.shape[1])
        rank = analyse(flat * sigma[:, None], sensitivity.names, sensitivity.units).rank
        return cls(read_only(measured), read_only(located), rank)

    @property
    def mean_square(self) -> Array:
        """B: the mean over poses and targets of J^T J, shape (p, p), [m^2 per unit^2]."""
        targets = self.located.shape[1] // 3
        return np.asarray(information(self.located) / (len(self.located) * targets))


@dataclass(frozen=True, slots=True, eq=False)
class Forecast:
    """What a calibration at some poses will reach.

    Attributes:
        names: The parameters.
        units: Of each.
        parameter_std: shape (p,), expected standard deviation after the fit, in the units.
        identifiable: shape (p,), which parameters these poses tell by themselves; the others are known in combinations
            only, and their standard deviation is mostly their prior's.
        poses: Number of poses.
        rms: Expected rms error of a predicted position over the workspace [m].
        rms_low: Below it lies the rms of 5 % of calibrations [m].
        rms_high: Above it, of 5 % [m].
        max: Largest standard deviation of a predicted position over the workspace [m].
        quantile_95: What 95 % of the positions do not exceed [m].
        sigma: Noise of one measured coordinate, rms over the poses [m].
        rank: What the poses tell.
        columns: Number of parameters.
        workspace_rank: What the poses of the whole workspace could tell.
        mean_variance: Mean over the workspace of the variance of what is measured there, as the calibrated robot
            predicts it, in variances of the noise.
        worst_variance: Largest likewise.
        indices: O1 to O5.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    parameter_std: Array
    identifiable: NDArray[np.bool_]
    poses: int
    rms: float
    rms_low: float
    rms_high: float
    max: float
    quantile_95: float
    sigma: float
    rank: int
    columns: int
    workspace_rank: int
    mean_variance: float
    worst_variance: float
    indices: dict[str, float]

    @classmethod
    def of(cls, sensitivity: Sensitivity, workspace: Workspace, q: Array) -> Forecast:
        """What a fit of measurements at these poses will reach.

        Args:
            sensitivity: Of the model that will be fitted.
            workspace: Over which accuracy is wanted.
            q: shape (N, m), joint values to be measured, [rad] or [m].
        """
        measured = sensitivity.measured(q)
        root = covariance_root(measured, sensitivity.precision)
        targets = workspace.located.shape[1] // 3
        moves = workspace.located @ root
        variance = np.sum(moves.reshape(len(moves) * targets, -1) ** 2, axis=1)
        relative = np.sum((workspace.measured @ root) ** 2, axis=(1, 2))
        low, high = _rms_range(moves)
        sigma = sensitivity.noise(q)
        flat = (
            measured.reshape(-1, measured.shape[2]) * np.repeat(sigma, measured.shape[1])[:, None]
        )
        seen = analyse(flat, sensitivity.names, sensitivity.units)
        return cls(
            names=sensitivity.names,
            units=sensitivity.units,
            parameter_std=read_only(np.linalg.norm(root, axis=1)),
            identifiable=seen.identifiable,
            poses=len(q),
            rms=float(np.sqrt(np.mean(variance))),
            rms_low=low,
            rms_high=high,
            max=float(np.sqrt(np.max(variance))),
            quantile_95=float(np.sqrt(np.quantile(variance, 0.95))),
            sigma=float(np.sqrt(np.mean(sigma**2))),
            rank=seen.rank,
            columns=len(sensitivity.names),
            workspace_rank=workspace.rank,
            mean_variance=float(np.mean(relative)),
            worst_variance=float(np.max(relative)),
            indices=dict(seen.indices),
        )

    @property
    def efficiency(self) -> float:
        """(rank / N) / mean variance: about 1 for the best N poses, no bound, and more with tight priors.

        See `calib.design.optimal`: rank / N is a bound of the largest variance.
        """
        return self.workspace_rank / self.poses / self.mean_variance


def forecast(robot: Robot, cell: Cell, joints: ArrayLike, margin: float = 0.0) -> Forecast:
    """What a calibration measured at these poses will reach, over the joint ranges.

    Args:
        robot: The nominal robot.
        cell: Model, targets, frames, noise and priors; ``"auto"`` is taken as ``"placement"``.
        joints: shape (N, m), [rad] or [m], in the order of ``robot.joint_names``.
        margin: See `calib.design.candidates.planning_ranges`.

    Raises:
        ModelError: The model or the cell do not fit the robot, or a joint's value is missing.
        MeasurementError: No pose.
    """
    robot.chain_values(joints)
    q = np.atleast_2d(np.asarray(joints, dtype=np.float64))
    if not len(q):
        raise MeasurementError("A forecast needs poses; none was given.")
    sensitivity = Sensitivity.of(robot, cell)
    everywhere = spread_between(planning_ranges(robot, cell.ranges, margin), _POSES)
    return Forecast.of(sensitivity, Workspace.of(sensitivity, everywhere), q)


def forecast_of_table(robot: Robot, cell: Cell, measurements: Measurements) -> Forecast | None:
    """What a fit of a table's estimation rows can reach, by its poses alone; the target is registered.

    Args:
        robot: The nominal robot.
        cell: As for the fit; ``"auto"`` is taken as ``"placement"``.
        measurements: The table.

    Returns:
        None where rows are of several kinds, targets or set-ups, or of a kind whose poses are not free.

    Raises:
        MeasurementError: A joint's column is missing, or too few rows.
    """
    seen = measurements.select(measurements.estimation)
    kinds = set(seen.kinds)
    if (
        len(kinds) > 1
        or len(set(seen.targets)) > 1
        or len(set(seen.groups)) > 1
        or not all(registry.get(kind).free for kind in kinds)
    ):
        return None
    rows, setup = rows_of(robot, measurements, cell)
    started = register(robot, setup, rows.select(measurements.estimation))
    known = replace(
        cell,
        kind=seen.kinds[0],
        T_frame_base=cell.T_frame_base if seen.kinds[0] != "distance" else started.T_frame_base[0],
        target=started.T_tip_target[0, :3, 3],
        targets={},
        frames={},
    )
    return forecast(robot, known, seen.joints_for(robot.joint_names))


def held(precision: Array) -> Array:
    """The priors' precision, with a leash on the parameters that have none, shape (p,)."""
    return np.where(precision > 0.0, precision, 1.0 / LEASH**2)


def covariance_root(measured: Array, precision: Array) -> Array:
    """A root of the parameters' covariance after measurements, C = root root^T, shape (p, p).

    By a QR decomposition of the measurements and the priors below each other: what a fine instrument tells, and what
    nothing but the leash holds, are too far apart for their squares.

    Args:
        measured: shape (n, d, p), see `Sensitivity.measured`.
        precision: shape (p,), see `Sensitivity`.
    """
    rows = np.concatenate(
        [measured.reshape(-1, measured.shape[2]), np.diag(np.sqrt(held(precision)))]
    )
    R = np.linalg.qr(rows, mode="r")
    return np.asarray(solve_triangular(R, np.eye(len(R))))


def parameter_weight(units: tuple[str, ...]) -> Array:
    """W of the criterion ``A``: 1 / step^2 of each parameter by its unit, shape (p, p)."""
    return np.diag(1.0 / steps(units) ** 2)


def _rms_range(moves: Array) -> tuple[float, float]:
    """Between which the rms of 90 % of calibrations lies, quantiles of x^T B x with x ~ N(0, C), [m].

    Args:
        moves: shape (n, 3 k, p), the derivative of the k targets' positions by independent errors of size 1.
    """
    squares = information(moves) / (len(moves) * (moves.shape[1] // 3))
    weights = np.maximum(np.linalg.eigvalsh(squares), 0.0)
    draws = _chi_squares(len(weights)) @ weights
    tail = 0.5 * (1.0 - _RANGE)
    low, high = np.sqrt(np.quantile(draws, [tail, 1.0 - tail]))
    return float(low), float(high)


@lru_cache(maxsize=4)
def _chi_squares(count: int) -> Array:
    """Draws of so many independent chi-squares of one degree of freedom, shape (draws, count).

    They are the same every time, and drawing them takes longer than the rest of a forecast: they are kept.
    """
    return read_only(np.random.default_rng(_SEED).chisquare(1, size=(_DRAWS, count)))
