"""Pose accuracy and repeatability of a robot as ISO 9283 defines them.

A pose was commanded once or n times. With e_j what was measured in its repeat j, minus what the robot's model predicts
for the joint values of that row, in the axes of the base,

    AP = |mean e_j|                                 pose accuracy: from the commanded pose to the barycentre
    l_j = |e_j - mean e|,  RP = mean l + 3 S_l      pose repeatability
    AP_a, AP_b, AP_c = mean e_j about x, y, z       of orientations
    RP_a, RP_b, RP_c = 3 S_a, 3 S_b, 3 S_c         of which the largest counts

where S are the standard deviations over n - 1. These are the figures of a controller with this model. Rows that measure
one length have AP = |mean e_j| along it, as ISO 9283's distance accuracy, and RP = 3 S.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from calib.basics.arrays import Array, Integers, Mask, read_only
from calib.basics.channels import RESIDUAL_UNITS, Channels
from calib.basics.values import ReadOnlyMapping, Value
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import CalibError, MeasurementError
from calib.fit.registration.rows import Rows
from calib.fit.registration.table_rows import rows_and_setup
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.verbs.evaluate.evaluation import Evaluation, evaluate, registration_rows

#: Rows that are judged: all of a table, its validation rows, or others that nothing was fitted or registered to.
JudgedRows = Literal["all", "validation", "fresh"]

#: Fewer repeats have no RP: two are equally far from their mean, so that S is 0 whatever the robot does.
FEWEST_REPEATS = 3

#: With this many poses or more, rows that were not fitted are judged alone, even if the table does not set them aside.
FEWEST_APART = 5

#: Residuals that differ by less are those of one row [m, rad or px]: far above rounding, far below the difference of
#: repeats.
_SAME = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class PoseFigures(Value):
    """Accuracy and repeatability at one pose in one unit; NaN for what was not measured."""

    #: Pose accuracy: norm of the mean error
    ap: float
    #: Shape (3,), the mean error along, or about, the base's axes; NaN if no vector was measured
    ap_axis: Array
    #: Pose repeatability, of orientations the largest about an axis; NaN below three repeats
    rp: float
    #: Shape (3,), three standard deviations along, or about, each; NaN as above, and below three repeats
    rp_axis: Array
    #: Largest error of a single repeat
    single: float
    #: Expanded uncertainty of ``ap``, of prediction and measurement together; NaN where it is not known
    U: float = np.nan


#: Figures at a pose that has none in a unit.
_NOTHING = PoseFigures(
    np.nan, read_only(np.full(3, np.nan)), np.nan, read_only(np.full(3, np.nan)), np.nan
)


@dataclass(frozen=True, slots=True, eq=False)
class PoseAccuracy(Value):
    """Accuracy and repeatability at one pose of one target at one station."""

    #: Numbers of the rows in the table: the repeats of the pose
    rows: tuple[int, ...]
    #: Kind of measurement
    kind: str
    #: Their station
    group: str
    #: Their target
    target: str
    #: Figures by the units that were measured there, ``"m"`` and so on
    by_unit: Mapping[str, PoseFigures]

    def __post_init__(self) -> None:
        """Keep a copy that cannot be changed."""
        object.__setattr__(self, "by_unit", ReadOnlyMapping(self.by_unit))

    def __getitem__(self, unit: str) -> PoseFigures:
        """Return the figures in the unit of a symbol, ``"m"``, ``"rad"`` or ``"px"``; all NaN if none was measured."""
        return self.by_unit.get(unit, _NOTHING)


@dataclass(frozen=True, slots=True, eq=False)
class Accuracy:
    """Accuracy of a robot over the poses that it is judged by."""

    #: The poses in the order of their first measurement
    poses: tuple[PoseAccuracy, ...]
    #: ``"all"``; ``"validation"``, the table's validation rows; or ``"fresh"``, others that nothing was fitted or
    #: registered to
    rows: JudgedRows
    #: Uses of the rows that are not judged: ``"calibration"``, ``"target"``, ``"frame"``
    others: tuple[str, ...]
    #: Number of rows that hold a measurement
    measured: int
    #: Number of those that the calibration was fitted to
    fitted: int
    #: Whether some of these are judged
    seen: bool
    #: Some of ``"target"`` and ``"frame"``, registered to the judged rows
    registered: tuple[str, ...]
    #: Number of unknowns of targets and frames that were not given
    unknowns: int
    #: Number of scalars that these were registered to, repeats counted once
    numbers: int
    #: Numbers of the judged rows whose error exceeds its U, by unit
    beyond: Mapping[str, tuple[int, ...]] = field(default_factory=ReadOnlyMapping)
    #: Number of the judged rows whose U is known, by unit
    known: Mapping[str, int] = field(default_factory=ReadOnlyMapping)

    @property
    def factor(self) -> float:
        """Random errors before something was registered to the judged rows, over those after it; 1 or more.

        With n ``numbers`` and u ``unknowns`` it is sqrt(n / (n - u)); infinite if no degree of freedom remains, 1 if
        nothing was registered to the judged rows.
        """
        if not self.registered:
            return 1.0
        freedom = self.numbers - self.unknowns
        if freedom <= 0:
            return np.inf
        return float(np.sqrt(self.numbers / freedom))

    @property
    def has_uncertainty(self) -> bool:
        """True if U is known of some judged row."""
        return any(self.known.values())

    @property
    def units(self) -> tuple[str, ...]:
        """Symbols of the units in which some judged pose has figures, in the order of `RESIDUAL_UNITS`."""
        return tuple(unit for unit in RESIDUAL_UNITS if len(self.of("ap", unit)))

    def of(self, name: str, unit: str) -> Array:
        """Return one figure of all judged poses that have it.

        Args:
            name: ``"ap"``, ``"rp"`` or ``"single"``, as of `PoseFigures`.
            unit: Symbol of the unit: ``"m"`` of positions and lengths, ``"rad"`` of orientations, ``"px"`` of images.

        Returns:
            shape (k,), in that unit, in the order of the poses; those without the figure are left out.
        """
        values = np.array([getattr(pose[unit], name) for pose in self.poses])
        return np.asarray(values[np.isfinite(values)])

    def figures(self, unit: str) -> dict[str, float]:
        """Return the largest and the mean AP and RP over the poses that have them, and the largest single error.

        Args:
            unit: Symbol of the unit: ``"m"`` of positions and lengths, ``"rad"`` of orientations, ``"px"`` of images.

        Returns:
            In that unit, by ``"ap_max"``, ``"ap_mean"``, ``"rp_max"``, ``"rp_mean"`` and ``"single_max"``; NaN if no
            pose has one.
        """
        figures = {}
        for name in ("ap", "rp"):
            values = self.of(name, unit)
            figures[f"{name}_max"] = float(values.max()) if len(values) else np.nan
            figures[f"{name}_mean"] = float(values.mean()) if len(values) else np.nan
        singles = self.of("single", unit)
        figures["single_max"] = float(singles.max()) if len(singles) else np.nan
        return figures

    @property
    def repeats(self) -> tuple[int, int]:
        """The smallest and the largest number of repeats of a judged pose."""
        counts = [len(pose.rows) for pose in self.poses]
        return min(counts), max(counts)


def accuracy(evaluation: Evaluation, *, seen: bool | Mask = False) -> Accuracy:
    """Return pose accuracy and repeatability of an evaluated robot.

    If a target or a frame was registered to the estimation rows, the validation rows are judged alone, if there are
    any; if a calibration was fitted to some rows, the others, see `judged_rows`.

    Args:
        evaluation: Errors of the robot at the N rows of a table.
        seen: True for the rows that a calibration of this robot was fitted to, shape (N,); or one bool: whether it was
            fitted to the rows that frames and targets are registered to, the estimation rows.

    Returns:
        Accuracy and repeatability at each judged pose by unit, along the base's axes, and how these rows were
        chosen.

    Raises:
        MeasurementError: No row measures anything.
    """
    m, setup = evaluation.measurements, evaluation.setup
    measured = np.any(evaluation.used, axis=1)
    if not np.any(measured):
        raise MeasurementError(f"{m.source or 'Measurements'}: no row measures anything.")
    # Repeats have the same joint values: frames, targets and loads of a cell have no part in it.
    of_images = Cell(cameras=evaluation.cameras, boards=evaluation.boards)
    rows, _ = rows_and_setup(evaluation.robot, m, setup.in_cell(of_images))

    # The rows that frames and targets were registered to, if any were; and those that alone see one of them.
    registration = registration_rows(m)
    unseen = setup.with_given_fixed(rows.samples.select(registration))
    registration = registration | unseen.unknown_at(rows.samples)
    of_calibration = seen if isinstance(seen, np.ndarray) else registration & seen
    fitted = measured & of_calibration
    judged = judged_rows(m, measured, fitted, rows.poses, registered=bool(evaluation.registered))

    apart = not np.any(judged & registration)
    others: tuple[str, ...] = ()
    if np.any(fitted & ~judged):
        others += ("calibration",)
    if apart:
        others += evaluation.registered
    name: JudgedRows = "fresh"
    if np.array_equal(judged, measured):
        name = "all"
    elif np.array_equal(judged, measured & m.validation):
        name = "validation"

    # Targets and frames have as many unknowns as unknown directions.
    not_given = setup.with_fixed(np.zeros(len(setup.groups), dtype=bool), setup.target_given)
    unknowns = sum(len(directions) for directions in not_given.target_unknowns.values())
    for directions, given in zip(setup.unknown, setup.frame_given, strict=True):
        if not given:
            unknowns += len(directions)
    # Repeats of a pose count once.
    chosen = measured & registration
    beyond, known = {}, {}
    for unit in evaluation.channels.present:
        has_uncertainty = judged & np.isfinite(evaluation.expanded(unit))
        is_beyond = has_uncertainty & ~evaluation.within(unit)
        beyond[unit] = tuple(np.array(m.rows)[is_beyond].tolist())
        known[unit] = int(np.sum(has_uncertainty))
    _, first_of_pose = np.unique(rows.poses[chosen], return_index=True)
    one_per_pose = np.flatnonzero(chosen)[first_of_pose]
    return Accuracy(
        poses=_poses(evaluation, rows, judged),
        rows=name,
        others=others,
        measured=int(np.sum(measured)),
        fitted=int(np.sum(fitted)),
        seen=bool(np.any(fitted & judged)),
        registered=() if apart else evaluation.registered,
        unknowns=unknowns,
        numbers=int(np.sum(rows.used[one_per_pose])),
        beyond=ReadOnlyMapping(beyond),
        known=ReadOnlyMapping(known),
    )


def _poses(evaluation: Evaluation, rows: Rows, judged: Mask) -> tuple[PoseAccuracy, ...]:
    """Return accuracy and repeatability at each pose of the judged rows, (N,), in the order of their first rows.

    Vectors are turned into the axes of the base, e_base = R^T e_frame, with the rotation R of T_frame_base.
    """
    m = evaluation.measurements
    residual = evaluation.residual.copy()
    R = evaluation.setup.T_frame_base[rows.samples.frame, :3, :3]
    for unit in rows.channels.present:
        columns, are_vectors = rows.channels.vector_columns(unit)
        if len(columns):
            at = np.ix_(are_vectors, columns)
            residual[at] = np.einsum("nji,nj->ni", R[are_vectors], residual[at])

    chosen = np.flatnonzero(judged)
    order = chosen[np.argsort(rows.poses[chosen], kind="stable")]
    first_of_pose = np.flatnonzero(np.diff(rows.poses[order])) + 1
    repeats_of_poses = np.split(order, first_of_pose)
    repeats_of_poses.sort(key=lambda indices: int(indices[0]))

    poses = []
    for repeats in repeats_of_poses:
        channels = evaluation.channels.select(repeats)
        by_unit = {}
        for unit in channels.present:
            columns, _ = channels.vector_columns(unit)
            errors = residual[repeats][:, channels.columns(unit)]
            figures = _figures(errors, unit, are_vectors=bool(len(columns)))
            if evaluation.uncertainty is not None:
                figures = replace(figures, U=evaluation.uncertainty.of_mean(unit, repeats))
            by_unit[unit] = figures
        first = repeats[0]
        poses.append(
            PoseAccuracy(
                rows=tuple(int(m.rows[i]) for i in repeats),
                kind=m.kinds[first],
                group=m.groups[first],
                target=m.targets[first],
                by_unit=by_unit,
            )
        )
    return tuple(poses)


def _figures(e: Array, unit: str, *, are_vectors: bool) -> PoseFigures:
    """Return accuracy and repeatability at one pose from residuals (n, d) of its n repeats, in the unit of this symbol.

    If the residuals are vectors along the base's axes, they are given along each axis too.
    """
    mean = e.mean(axis=0)
    enough = len(e) >= FEWEST_REPEATS
    by_axis = 3.0 * e.std(axis=0, ddof=1) if enough else np.full(len(mean), np.nan)
    nothing = np.full(3, np.nan)
    return PoseFigures(
        ap=pose_accuracy(e),
        ap_axis=read_only(mean if are_vectors else nothing),
        rp=repeatability(e, unit) if enough else np.nan,
        rp_axis=read_only(by_axis if are_vectors else nothing),
        single=float(np.linalg.norm(e, axis=1).max()),
    )


def pose_accuracy(e: Array) -> float:
    """Return the pose accuracy AP of repeats of one pose: the norm of the mean of their residuals e, (n, d)."""
    return float(np.linalg.norm(e.mean(axis=0)))


def repeatability(e: Array, unit: str) -> float:
    """Return the pose repeatability RP of repeats of one pose.

    Of vectors RP = mean l + 3 S_l with l_j = |e_j - mean e|, of one scalar RP = 3 S_e, and of orientations the largest
    3 S about an axis; standard deviations S are over n - 1.

    Args:
        e: Residuals of n >= 2 repeats, measured minus predicted, shape (n, d).
        unit: Symbol of their unit.

    Returns:
        RP in the unit.
    """
    if unit == "rad" or e.shape[1] == 1:
        return float(np.max(3.0 * e.std(axis=0, ddof=1)))
    distances = np.linalg.norm(e - e.mean(axis=0), axis=1)
    return float(distances.mean() + 3.0 * distances.std(ddof=1))


def judged_rows(
    measurements: Measurements,
    measured: Mask,
    fitted: Mask,
    poses: Integers,
    *,
    registered: bool,
) -> Mask:
    """Choose the rows that a robot is judged by.

    They are the rows that the calibration was not fitted to, if the table sets some of them aside or they are of at
    least `FEWEST_APART` poses; and of these the validation rows alone, if there are any and something was registered to
    the estimation rows. Otherwise they are all measured rows.

    Args:
        measurements: The N rows, of the sets ``estimate`` and ``validate``. Validation rows are set aside if there are
            estimation rows too.
        measured: True for rows that hold a measurement, shape (N,).
        fitted: True for rows that the calibration was fitted to, shape (N,); nowhere without a calibration.
        poses: Number of the pose of each row; repeats have the same, shape (N,).
        registered: Whether a frame or target was registered to rows of this table.

    Returns:
        True for the rows to judge by, shape (N,).
    """
    fresh = measured & ~fitted
    aside = fresh & measurements.validation & np.any(measurements.estimation)
    enough = np.any(aside) or len(np.unique(poses[fresh])) >= FEWEST_APART
    if np.any(fitted) and not enough:
        return measured
    if registered and np.any(aside):
        return np.asarray(aside)
    return np.asarray(fresh)


def fitted_rows(
    calibration: Calibration,
    robot: Robot,
    measurements: Measurements,
    cell: Cell,
) -> Mask:
    """Find the rows of a table that a result was fitted to, in any file, in any order and under any number.

    A row is recognised by its residuals with the nominal and with the corrected robot, which depend on every digit
    of its joint values and of what was measured. Where none is recognised in the very file that was calibrated
    from, these are its estimation rows.

    Args:
        calibration: The result, which holds the residuals of the rows that it was fitted to, and the hash of their
            file.
        robot: The robot with which the table is evaluated, nominal or corrected.
        measurements: The table, N rows.
        cell: Known frames, targets and loads of the table.

    Returns:
        True for these rows, shape (N,).
    """
    fitted = np.zeros(len(measurements), dtype=bool)
    # A station that the result does not know has no fitted row.
    with contextlib.suppress(CalibError):
        fitted = _recognise(calibration, robot, measurements, cell)
    same_file = bool(calibration.source.sha256)
    same_file = same_file and calibration.source.sha256 == measurements.sha256
    if same_file and not np.any(fitted):
        return measurements.estimation
    return fitted


@dataclass(frozen=True, slots=True, eq=False)
class _KnownResiduals:
    """Residuals of N rows by two robots, by which a row is recognised in another table.

    Only the scalars in the first of a row's units count: lengths, if it measures any.
    """

    #: Shape (N, D), measured minus predicted by the nominal robot
    nominal: Array
    #: The same by the corrected robot
    corrected: Array
    #: True for the scalars that count, of the same shape
    counts: Mask

    @classmethod
    def of(cls, nominal: Array, corrected: Array, channels: Channels) -> _KnownResiduals:
        """Keep residuals (N, D) by both robots with a mask of the scalars that count, in each row's first unit."""
        counts = np.zeros_like(channels.used)
        for unit in channels.present:
            not_yet = ~counts.any(axis=1, keepdims=True)
            counts |= channels.where(unit) & not_yet
        return cls(nominal, corrected, counts)

    def rows_with(self, scalars: int) -> NDArray[np.intp]:
        """Return the indices of the rows with this number of scalars that count, shape (n,)."""
        return np.flatnonzero(self.counts.sum(axis=1) == scalars)

    def side_by_side(self, rows: Integers) -> Array:
        """Return the k residuals that count in n rows, by the nominal, then by the corrected robot, (n, 2 k)."""
        both = []
        for residual in (self.nominal, self.corrected):
            scalars = residual[rows][self.counts[rows]]
            both.append(scalars.reshape(len(rows), -1))
        return np.hstack(both)


def _recognise(c: Calibration, robot: Robot, measurements: Measurements, cell: Cell) -> Mask:
    """Find the rows of a table, shape (N,), whose residuals are those of a row that a result was fitted to.

    A table that cannot be evaluated, such as one with a station that the result does not know, raises `CalibError`.
    """
    nominal = evaluate(c.uncorrected(robot), measurements, cell, known=c.nominal_setup)
    corrected = evaluate(c.corrected(robot), measurements, cell, known=c.setup)
    by_nominal, stored_by_nominal = nominal.residual, c.rows.residual_nominal
    if not c.rows.nominal_is_judged:
        # None are stored: those by the calibrated robot alone have to distinguish the rows.
        by_nominal, stored_by_nominal = np.zeros_like(by_nominal), np.zeros_like(stored_by_nominal)
    of_table = _KnownResiduals.of(by_nominal, corrected.residual, corrected.channels)
    fitted = c.rows.estimation
    stored = _KnownResiduals.of(
        stored_by_nominal[fitted],
        c.rows.residual_calibrated[fitted],
        c.rows.channels.select(fitted),
    )
    recognised = np.zeros(len(measurements), dtype=bool)
    for scalars in range(1, of_table.counts.shape[1] + 1):
        rows, stored_rows = of_table.rows_with(scalars), stored.rows_with(scalars)
        if len(rows) and len(stored_rows):
            residuals = of_table.side_by_side(rows)
            recognised[rows] = _are_among(residuals, stored.side_by_side(stored_rows))
    return recognised


def _are_among(residuals: Array, stored: Array) -> Mask:
    """Return which residuals (n, k) are within `_SAME` of a stored one, (s, k), in every component; shape (n,)."""
    tree = KDTree(stored)
    distance, _ = tree.query(residuals, p=np.inf, distance_upper_bound=_SAME)
    return np.asarray(distance <= _SAME)
