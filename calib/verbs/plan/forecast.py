"""Forecast of the accuracy that a calibration will reach, before anything is measured.

The parameters' covariance after a fit of the linearised measurements,

    C = (diag(1 / tau^2) + sum_i A_i^T A_i)^-1,

gives the standard deviation of each parameter, and that of a predicted position, sqrt(tr(J C J^T)). The rms error of a
single calibration over the workspace is random: rms^2 = x^T B x with x ~ N(0, C), a sum of chi-squares weighted by the
eigenvalues of C B. Errors that the model lacks are not included.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.blas import dtrmm

import calib.data.kinds as registry
from calib.basics.arrays import Array, Mask, read_only
from calib.basics.values import Value, keep_read_only
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.fit.registration.registration import register
from calib.fit.registration.table_rows import rows_and_setup
from calib.robot.kernel import over_blocks
from calib.robot.ranges import spread_between
from calib.robot.robot import Robot
from calib.verbs.plan.pose_candidates import planning_ranges
from calib.verbs.plan.sensitivity import Sensitivity

#: Number of poses over which accuracy is forecast without a plan.
_POSES = 4096

#: Share of calibrations whose rms error lies within the range.
_RANGE = 0.90


class Workspace(NamedTuple):
    """Poses over which accuracy is forecast, as `Sensitivity` differentiates them by the p parameters."""

    #: Shape (n, d, p), derivative of the d scalars that are measured at each of n poses, whitened, see
    #: `Sensitivity.measured`.
    measured: Array
    #: Shape (n, 3 k, p), derivative J of the positions of the k targets, [m per unit], see `Sensitivity.located`.
    located: Array
    #: B, shape (p, p), the mean of J^T J over poses and targets [m^2 per units].
    mean_square: Array
    #: Number of parameters, or combinations, that all these poses determine.
    rank: int

    @classmethod
    def of(
        cls,
        sensitivity: Sensitivity,
        q: Array,
        measurable: Array | None = None,
        seen: Mask | None = None,
    ) -> Workspace:
        """Differentiate what is measured, and the positions of the targets, at the poses over which accuracy counts.

        Args:
            sensitivity: The nominal robot in its cell under the error model of the fit.
            q: Joint values of n poses, shape (n, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.
            measurable: n poses at which something is measured, shape (n, m), for an instrument that sees only a
                part of the workspace; None: those of ``q``.
            seen: Which views measure at each of these, see `Sensitivity.measured`; None: all.
        """
        if measurable is None:
            measurable = q
        measured = sensitivity.measured(measurable, None, seen)
        located = sensitivity.located(q)
        mean_square = information(located) / (located[:, :, 0].size // 3)
        rank = sensitivity.analysed(measurable, measured).rank
        return cls(measured, located, mean_square, rank)


@dataclass(frozen=True, slots=True, eq=False)
class Forecast(Value):
    """Accuracy that a calibration at some poses will reach."""

    #: Names of the p parameters.
    names: tuple[str, ...]
    #: Unit of each parameter.
    units: tuple[str, ...]
    #: Shape (p,), expected standard deviation after the fit, in the units.
    parameter_std: Array
    #: Shape (p,), whether these poses determine a parameter by itself.
    identifiable: NDArray[np.bool_]
    #: Number of poses.
    poses: int
    #: Expected rms error of a predicted position over the workspace [m].
    rms: float
    #: Lower end of the range in which the rms error of 90 % of calibrations lies [m].
    rms_low: float
    #: Upper end of that range [m].
    rms_high: float
    #: Largest standard deviation of a predicted position over the workspace [m].
    max: float
    #: Noise of one scalar, rms over the poses, by the units that are measured: ``"m"`` [m] and so on.
    sigma: Mapping[str, float]
    #: Number of parameters, or combinations, that the poses determine.
    rank: int
    #: Number of parameters.
    columns: int
    #: Number of those that the poses of the whole workspace could determine.
    workspace_rank: int
    #: Mean over the workspace of the variance with which the calibrated robot predicts all scalars at a pose, added up,
    #: in variances of the noise.
    mean_variance: float
    #: The largest such variance over the workspace.
    worst_variance: float
    #: Observability indices by name, ``"O1"`` to ``"O5"``.
    indices: Mapping[str, float]

    def __post_init__(self) -> None:
        """Keep read-only copies of the mappings."""
        keep_read_only(self, "indices", "sigma")

    @classmethod
    def of(
        cls,
        sensitivity: Sensitivity,
        workspace: Workspace,
        q: Array,
        moves: Array | None = None,
        seen: Mask | None = None,
    ) -> Forecast:
        """Forecast the accuracy of a fit of measurements at poses.

        The parameters' covariance after the fit, by measurements and priors, is propagated to the workspace.

        Args:
            sensitivity: The nominal robot in its cell under the error model of the fit.
            workspace: The poses over which accuracy counts.
            q: Joint values of the N poses to measure, shape (N, m), [rad] or for sliding joints [m], columns as
                ``robot.joint_names``.
            moves: Last move of each joint before each pose, shape (N, m); None: from the pose before.
            seen: Which views measure at each pose, see `Sensitivity.measured`; None: all.
        """
        measured = sensitivity.measured(q, moves, seen)
        root = covariance_root(measured, sensitivity.precision)
        variance, relative = _spreads(workspace, root)
        rms_low, rms_high = _range_of_rms(root.T @ workspace.mean_square @ root)
        observability = sensitivity.analysed(q, measured)
        return cls(
            names=sensitivity.names,
            units=sensitivity.units,
            parameter_std=read_only(np.linalg.norm(root, axis=1)),
            identifiable=observability.identifiable,
            poses=len(q),
            rms=float(np.sqrt(np.mean(variance))),
            rms_low=rms_low,
            rms_high=rms_high,
            max=float(np.sqrt(np.max(variance))),
            sigma=sensitivity.sigma_by_unit(q),
            rank=observability.rank,
            columns=len(sensitivity.names),
            workspace_rank=workspace.rank,
            mean_variance=float(np.mean(relative)),
            worst_variance=float(np.max(relative)),
            indices=dict(observability.indices),
        )


@lru_cache(maxsize=4)
def _chi_squares(count: int) -> Array:
    """Return draws of independent chi-squares of one degree of freedom, (20000, count), always the same ones."""
    # Kept, because drawing them takes longer than a forecast.
    return np.random.default_rng(20170401).chisquare(1, size=(20_000, count))


def _range_of_rms(squares: Array) -> tuple[float, float]:
    """Return the two rms errors over the workspace [m] between which 90 % of calibrations lie, by random draws.

    With C = root root^T and the mean B of J^T J over the positions, the squared rms is x^T S x with x ~ N(0, I) and
    S = root^T B root, ``squares`` (p, p) [m^2]: a sum of chi-squares weighted by the eigenvalues of S.
    """
    weights = np.maximum(np.linalg.eigvalsh(squares), 0.0)
    draws = _chi_squares(len(squares)) @ weights
    ends = [0.5 - 0.5 * _RANGE, 0.5 + 0.5 * _RANGE]
    low, high = np.sqrt(np.quantile(draws, ends))
    return float(low), float(high)


def forecast(robot: Robot, cell: Cell, joints: ArrayLike) -> Forecast:
    """Forecast the accuracy, over the joint ranges, of a calibration from measurements at some poses.

    Args:
        robot: The nominal robot.
        cell: Cell that the fit will use; the model ``"auto"`` is taken as ``"placement"``. Its ``ranges`` narrow the
            joint ranges.
        joints: Joint values of the N poses to measure, shape (N, m), [rad] or for sliding joints [m], columns as
            ``robot.joint_names``.

    Returns:
        The forecast, over 4096 poses that are spread over the joint ranges.

    Raises:
        ModelError: A kind of measurement, or a parameter, that cannot be planned for.
    """
    sensitivity = Sensitivity.of(robot, cell)
    values = spread_between(planning_ranges(robot, cell.ranges, 0.0), _POSES)
    everywhere = robot.readings(values)
    workspace = Workspace.of(sensitivity, everywhere)
    return Forecast.of(sensitivity, workspace, np.asarray(joints))


def position_std(
    sensitivity: Sensitivity, measured: Array, joints: Array, moves: Array | None = None
) -> Array:
    """Forecast the error of predicted positions of a calibrated robot's targets at single poses.

    It is sqrt(tr(J C J^T)), the root of the sum of the variances of x, y, z; its rms over the workspace is
    `Forecast.rms`.

    Args:
        sensitivity: The nominal robot in its cell, with k targets.
        measured: Joint values of the poses to measure and to fit, shape (N, m), [rad] or for sliding joints [m].
        joints: Joint values of the poses in question, shape (n, m), [rad] or [m].
        moves: Last move of each joint before each pose to measure, shape (N, m); None: from the pose before.

    Returns:
        Shape (n, k), [m].
    """
    root = covariance_root(sensitivity.measured(measured, moves), sensitivity.precision)
    spread = sensitivity.located(joints) @ root
    return np.asarray(np.linalg.norm(spread.reshape(len(joints), -1, 3 * len(root)), axis=2))


def forecast_of_table(robot: Robot, cell: Cell, measurements: Measurements) -> Forecast | None:
    """Forecast a fit of a table's estimation rows, by their poses alone.

    The measured values only serve to register the target, and for distances the anchor.

    Args:
        robot: The nominal robot.
        cell: Cell that the fit will use.
        measurements: The table; rows of the set ``validate`` do not count.

    Returns:
        The forecast, over 4096 poses that are spread over the joint ranges; None for rows of several kinds, targets or
        stations, for a kind whose poses cannot be chosen freely, such as a ball in a socket, and for images.

    Raises:
        ModelError: A parameter that cannot be planned for.
        MeasurementError: Too few rows for the registration.
    """
    fitted = measurements.select(measurements.estimation)
    sorts = set(zip(fitted.kinds, fitted.targets, fitted.groups, strict=True))
    kind = fitted.kinds[0]
    if len(sorts) > 1 or not registry.get(kind).free or registry.get(kind).is_image:
        return None
    rows, setup = rows_and_setup(robot, measurements, cell)
    rows = rows.select(measurements.estimation)
    registered = register(robot.poses(rows.joints), setup, rows)
    T_frame_base = cell.T_frame_base
    if kind == "distance":
        T_frame_base = registered.T_frame_base[0]
    known = replace(
        cell,
        kind=kind,
        T_frame_base=T_frame_base,
        target=registered.T_tip_target[0, :3, 3],
        targets={},
        frames={},
    )
    return forecast(robot, known, fitted.joints_for(robot.joint_names))


def covariance_root(measured: Array, precision: Array) -> Array:
    """Compute a root of the parameters' covariance after measurements, C = root root^T.

        C = (diag(1 / tau^2) + sum_i A_i^T A_i)^-1

    It is found by a QR decomposition of measurements and priors, one above the other: directions that an accurate
    instrument determines, and those that only a weak prior holds, differ too much for their squares.

    Args:
        measured: Whitened derivatives A of the d scalars measured at each of n poses, shape (n, d, p).
        precision: 1 / tau^2 of each parameter's prior, shape (p,).

    Returns:
        The root, upper triangular, shape (p, p), rows in the parameters' units.
    """
    by_scalar = measured.reshape(-1, measured.shape[2])
    by_prior = np.diag(np.sqrt(precision))
    R = np.linalg.qr(np.concatenate([by_scalar, by_prior]), mode="r")
    return np.asarray(solve_triangular(R, np.eye(len(R))))


def _spreads(workspace: Workspace, root: Array) -> tuple[Array, Array]:
    """Propagate the covariance C = root root^T to the n poses of a workspace with k targets.

    The results are the variance of each target's position, (n k,) [m^2]; and that of all scalars at each pose, added
    up, (n,), in variances of the noise.
    """
    p = len(root)

    def squares(derivatives: Array, rows: int) -> Array:
        """Return the squares of derivatives (b, d, p) times the root, added up over so many scalars each."""
        # The root is an upper triangle.
        changes = dtrmm(1.0, root, derivatives.reshape(-1, p).T, trans_a=1).T.reshape(-1, rows * p)
        return np.asarray(np.einsum("nk,nk->n", changes, changes))

    def work(block: slice) -> tuple[Array, Array]:
        """Return both for a slice of the poses."""
        measured = workspace.measured[block]
        return squares(workspace.located[block], 3), squares(measured, measured.shape[1])

    parts = over_blocks(work, len(workspace.located))
    variances, relatives = zip(*parts, strict=True)
    return np.concatenate(variances), np.concatenate(relatives)


def information(A: Array) -> Array:
    """Compute the information matrix sum_i A_i^T A_i of measurements at n poses.

    Args:
        A: Derivative of the d scalars at each pose by p parameters (or coordinates along p directions of these), shape
            (n, d, p); n may be 0.

    Returns:
        Shape (p, p), symmetric, per product of two parameters' units.
    """
    flat = A.reshape(-1, A.shape[2])
    return np.asarray(flat.T @ flat)
