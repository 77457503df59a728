"""Deviations of a robot at the points of a certificate, as found and as left, each with its uncertainty.

At a point the deviation is the size A = |mean e_j| of the mean error of its n readings, measured minus predicted: as
found by the nominal robot, as left by the calibrated one. What is uncertain of it is the measurement, not the robot:

    V = sigma^2 I / n + sum of V_s        over the sources s that the instrument and its set-up have

with the standard deviation sigma of one scalar of a reading, and the sources of `calib.uncertainty.at_poses` that the
measurement has too: scale, frame and target, in which the deviations are expressed, drift and temperature. Those of the
robot (its parameters, its repeatability, what its model lacks) are what is measured. U is the length that the error of
the mean stays below (`calib.uncertainty.coverage`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, Integers, read_only
from calib.basics.channels import VECTOR, residual_unit
from calib.basics.values import ReadOnlyMapping, Value
from calib.data.cell import Cell
from calib.errors import MeasurementError
from calib.result.calibration import Calibration
from calib.uncertainty.at_poses import PoseUncertainty, Source, uncertainty_at
from calib.uncertainty.coverage import covered_length
from calib.verbs.certificate.conformity import coverage_quantile
from calib.verbs.evaluate.accuracy import PoseAccuracy
from calib.verbs.evaluate.evaluation import Evaluation

#: Sources that a measured deviation has too: those of the instrument and its set-up, not of the robot.
MEASURING = (
    Source.SCALE,
    Source.FRAME,
    Source.TARGET,
    Source.DRIFT,
    Source.TEMPERATURE,
)

#: The units of a certificate, and the part of a pose's six displacements that each is.
PARTS = {"m": slice(0, VECTOR), "rad": slice(VECTOR, 2 * VECTOR)}

#: The factor of an uncertainty that was stated.
_STATED_FACTOR = 2.0


@dataclass(frozen=True, slots=True)
class Deviation:
    """The deviation at a point in one unit, m or rad."""

    #: As found, by the nominal robot; NaN if that cannot be compared with the rows
    found: float
    #: As left, by the calibrated robot
    left: float
    #: Expanded uncertainty U of both
    uncertainty: float
    #: Coverage factor: U over the combined standard uncertainty, the root of the sum of the variances along three axes
    factor: float
    #: Effective degrees of freedom of U; infinite if it was stated
    freedom: float
    #: Expanded uncertainty of the pose that the calibrated robot reaches there, by its calibration
    of_pose: float
    #: Probability that the deviation as left is within the tolerance; NaN without one
    conformance: float = np.nan


@dataclass(frozen=True, slots=True, eq=False)
class Point(Value):
    """A point of a certificate: a pose that was measured once or several times."""

    #: Numbers of its rows in the table
    rows: tuple[int, ...]
    #: Name of its station
    group: str
    #: Name of its target
    target: str
    #: Shape (m,), joint values of its first row [rad] or [m]
    joints: Array
    #: Shape (3,), position of the target in the base, as the calibrated robot predicts it [m]
    position: Array
    #: By the symbol of the unit, ``"m"`` and ``"rad"``, as far as they were measured
    deviations: Mapping[str, Deviation]

    def __post_init__(self) -> None:
        """Keep a copy that cannot be changed."""
        object.__setattr__(self, "deviations", ReadOnlyMapping(self.deviations))


@dataclass(frozen=True, slots=True, eq=False)
class Reading(Value):
    """Noise of one scalar of a reading in one unit."""

    #: Shape (N,), its standard deviation in each row
    sigma: Array
    #: Its degrees of freedom; infinite if it was stated
    freedom: float
    #: Whether some input states it; else it is what the calibration left, or the scatter of repeats
    is_stated: bool


def reading_noise(
    calibration: Calibration, cell: Cell, left: Evaluation, poses: Sequence[PoseAccuracy], unit: str
) -> Reading:
    """Return the noise of one scalar of the rows of a table.

    It is what the table, the cell or the calibration's inputs state, in this order; else the noise that the calibration
    estimated. Where repeats of a pose scatter more, it is their scatter, over all poses.

    Args:
        calibration: Its noise counts where nothing else is stated.
        cell: States a noise, or none.
        left: Residuals of the calibrated robot at the N rows of the table.
        poses: The poses whose repeats count.
        unit: Symbol of the unit.

    Returns:
        The noise.

    Raises:
        MeasurementError: Nothing states it, the calibration did not estimate it, and no pose is repeated.
    """
    table, noise = left.measurements, calibration.noise
    general, freedom = cell.sigma.get(unit, noise.sigma_given.get(unit, np.nan)), np.inf
    if not np.isfinite(general):
        general, freedom = noise.sigma.get(unit, np.nan), noise.freedom
    by_row = table.stated_sigma.get(unit, np.full(len(table), np.nan))
    sigma = np.where(np.isfinite(by_row), by_row, general)
    is_stated = bool(np.isinf(freedom) or np.all(np.isfinite(by_row)))

    squares, degrees = 0.0, 0
    for pose in poses:
        rows = np.flatnonzero(np.isin(table.rows, pose.rows))
        scalars = left.residual[np.ix_(rows, left.channels.select(rows).columns(unit))]
        squares += float(np.sum((scalars - scalars.mean(axis=0)) ** 2))
        degrees += (len(rows) - 1) * scalars.shape[1]
    if degrees and not squares / degrees <= np.mean(sigma**2):  # also where nothing is known of it
        scatter = np.full(len(table), np.sqrt(squares / degrees))
        return Reading(read_only(scatter), degrees, is_stated)
    if not np.all(np.isfinite(sigma)):
        of_unit = residual_unit(unit)
        raise MeasurementError(
            f"{table.source or 'Measurements'}: nothing states the noise of a measured {of_unit.measured}, and the "
            f"calibration did not measure any. State it in the cell file ({of_unit.sigma_key}) or in a column "
            f"'{of_unit.sigma_name} [{of_unit.shown}]', or give U by --uncertainty."
        )
    return Reading(read_only(sigma), freedom, is_stated)


@dataclass(frozen=True, slots=True, eq=False)
class PointRows(Value):
    """The rows of a table that stand for the K points of a certificate, the first of each, as a result has them."""

    #: The K poses
    poses: tuple[PoseAccuracy, ...]
    #: Index in the table of the first row of each, from 0
    first: tuple[int, ...]
    #: The calibrated robot's pose at each, with its uncertainty by source
    uncertainty: PoseUncertainty
    #: Shape (K, 3), position of the target in the base [m]
    positions: Array


def point_rows(
    calibration: Calibration,
    left: Evaluation,
    poses: Sequence[PoseAccuracy],
    *,
    non_geometric: bool,
) -> PointRows:
    """Return what a result predicts at the first row of each of some poses.

    A station or target that the result does not have stands for its first one: it was registered to the rows.

    Args:
        calibration: The result.
        left: Residuals of its robot at the rows of a table.
        poses: The K poses.
        non_geometric: Whether the non-geometric model predicts, if there is one.
    """
    table, setup = left.measurements, calibration.setup
    first = tuple(table.rows.index(pose.rows[0]) for pose in poses)
    names = calibration.nominal.joint_names
    samples = calibration.samples(
        table.joints_for(names)[list(first)], moves=table.moves_for(names)[list(first)]
    )
    frame = _indices([pose.group for pose in poses], setup.groups)
    target = _indices([pose.target for pose in poses], setup.targets)
    chain = setup.chains(calibration.nominal, frame, target)
    samples = replace(samples, frame=frame, target=target, chain=chain)
    part = calibration.part(non_geometric=non_geometric)
    uncertainty = uncertainty_at(
        calibration, samples, non_geometric=non_geometric, in_base=part.base_motion is not None
    )
    in_base, _ = part.twists(samples, in_base=True)
    return PointRows(tuple(poses), first, uncertainty, read_only(in_base[:, :3, 3]))


@dataclass(frozen=True, slots=True, eq=False)
class Expanded(Value):
    """Expanded uncertainty of the deviation at each of K points in one unit."""

    #: Shape (K,), U
    uncertainty: Array
    #: Shape (K,), U over the combined standard uncertainty
    factor: Array
    #: Shape (K,), effective degrees of freedom
    freedom: Array

    @classmethod
    def stated(cls, uncertainty: float, count: int) -> Expanded:
        """Return what a laboratory states (k = 2), for each of so many points."""
        return cls(
            read_only(np.full(count, uncertainty)),
            read_only(np.full(count, _STATED_FACTOR)),
            read_only(np.full(count, np.inf)),
        )

    @classmethod
    def of(cls, rows: PointRows, unit: str, reading: Reading) -> Expanded:
        """Return the uncertainty of deviations by their sources.

        Args:
            rows: The K points.
            unit: Symbol of the unit, of `PARTS`.
            reading: Noise of one scalar of a reading.
        """
        part = PARTS[unit]
        counts = np.array([len(pose.rows) for pose in rows.poses])
        of_reading = reading.sigma[list(rows.first)] ** 2 / counts
        covariance = of_reading[:, None, None] * np.eye(VECTOR)
        by_source = [(VECTOR * of_reading, reading.freedom)]
        for one in rows.uncertainty.contributions:
            if one.source in MEASURING:
                block = one.covariance[:, part, part]
                covariance = covariance + block
                by_source.append((np.trace(block, axis1=1, axis2=2), one.freedom))
        variance = np.sum([of_source for of_source, _ in by_source], axis=0)
        # Welch and Satterthwaite, JCGM 100, G.4.
        shares = np.sum([of_source**2 / freedom for of_source, freedom in by_source], axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            freedom = np.where(shares > 0.0, variance**2 / shares, np.inf)
            expanded = covered_length(covariance, freedom)
            factor = np.where(variance > 0.0, expanded / np.sqrt(variance), _STATED_FACTOR)
        return cls(expanded, read_only(factor), read_only(freedom))


def deviations(
    rows: PointRows, found: Sequence[PoseAccuracy], unit: str, expanded: Expanded
) -> list[Deviation | None]:
    """Return the deviation at each point in one unit.

    Args:
        rows: The K points, with the accuracy of the calibrated robot.
        found: Accuracy of the nominal robot at the same points; empty if it cannot be compared with the rows.
        unit: Symbol of the unit, of `PARTS`.
        expanded: Uncertainty of the deviations.

    Returns:
        A deviation for each point; None where the unit was not measured.
    """
    of_pose = rows.uncertainty.position if unit == "m" else rows.uncertainty.orientation
    result: list[Deviation | None] = []
    for k, pose in enumerate(rows.poses):
        one = Deviation(
            found=found[k][unit].ap if found else np.nan,
            left=pose[unit].ap,
            uncertainty=float(expanded.uncertainty[k]),
            factor=float(expanded.factor[k]),
            freedom=float(expanded.freedom[k]),
            of_pose=float(of_pose[k]),
        )
        result.append(one if np.isfinite(one.left) else None)
    return result


def standard_uncertainty(deviation: Deviation) -> float:
    """Return the standard uncertainty along one direction that belongs to U (see `coverage_quantile`)."""
    return float(deviation.uncertainty / coverage_quantile(deviation.freedom))


def _indices(names: Sequence[str], known: Sequence[str]) -> Integers:
    """Return the index of each name in a result's, from 0; 0 for one that it lacks."""
    return np.array([known.index(name) if name in known else 0 for name in names], dtype=np.intp)
