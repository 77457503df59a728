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
from dataclasses import dataclass
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
from calib.fit.registration.setup import Setup
from calib.fit.registration.table_rows import rows_and_setup
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.verbs.evaluate.evaluation import Evaluation, evaluate, registration_rows

#: Rows that are judged: all of a table, its validation rows, or those that nothing was fitted or registered to.
JudgedRows = Literal["all", "validation", "fresh"]

#: Fewer repeats than this have no RP: of two, both lie equally far from their mean, and S is 0 whatever the robot does.
FEWEST_REPEATS = 3

#: From this many poses on, rows are judged alone that the table itself does not set aside from the fitted ones.
FEWEST_APART = 5

#: Residuals that differ by less are those of one row [m]: far above rounding, far below the difference of repeats.
_SAME = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class PoseFigures(Value):
    """Accuracy and repeatability at one pose in one unit; NaN for what was not measured."""

    #: Pose accuracy: norm of the mean error
    ap: float
    #: Shape (3,), the mean error along, or about, the base's axes; NaN where no vector was measured
    ap_axis: Array
    #: Pose repeatability, of orientations the largest about an axis; NaN below three repeats
    rp: float
    #: Shape (3,), three standard deviations along, or about, each; NaN likewise, and below three repeats
    rp_axis: Array
    #: Largest error of a single repeat
    single: float


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
        """Return the figures in a unit, by its symbol; all NaN where none was measured."""
        return self.by_unit.get(unit, _NOTHING)


@dataclass(frozen=True, slots=True, eq=False)
class Accuracy:
    """Accuracy of a robot over the poses that it is judged by."""

    #: The poses in the order of the table
    poses: tuple[PoseAccuracy, ...]
    #: ``"all"``; where something was registered to the others, ``"validation"``, the table's validation rows, or
    #: ``"fresh"``, others that nothing was fitted or registered to
    rows: JudgedRows
    #: Where some rows alone are judged, the use of the others: ``"calibration"``, ``"target"``, ``"frame"``
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

    @property
    def factor(self) -> float:
        """Random errors before something was registered to the same rows, over those after it; 1 or more.

        With n scalars that frames and targets were registered to (``numbers``, repeats counted once) and u unknowns of
        frames and targets (``unknowns``) it is sqrt(n / (n - u)); infinite where no degree of freedom remains, and 1
        where nothing is ``registered`` to the judged rows.
        """
        if not self.registered:
            return 1.0
        freedom = self.numbers - self.unknowns
        if freedom <= 0:
            return np.inf
        return float(np.sqrt(self.numbers / freedom))

    @property
    def units(self) -> tuple[str, ...]:
        """Symbols of the units in which some judged pose has figures, in the order of `RESIDUAL_UNITS`."""
        return tuple(unit for unit in RESIDUAL_UNITS if len(self.of("ap", unit)))

    def of(self, name: str, unit: str) -> Array:
        """Return one figure of all judged poses that have it.

        Args:
            name: ``"ap"``, pose accuracy, the norm of the mean error over repeats, ``"rp"``, pose repeatability by ISO
                9283, or ``"single"``, the largest error of a single repeat.
            unit: Symbol of the unit: ``"m"`` of positions and lengths, ``"rad"`` of orientations.

        Returns:
            shape (k,), in the order of ``poses``, the judged ones, 0 or more; poses where the figure is NaN, not
            measured, are left out.
        """
        values = np.array([getattr(pose[unit], name) for pose in self.poses])
        return np.asarray(values[np.isfinite(values)])

    def figures(self, unit: str) -> dict[str, float]:
        """Return the largest and the mean AP and RP over the judged ``poses``, and the largest single error.

        AP is pose accuracy, the norm of the mean error over a pose's repeats; RP is pose repeatability. Poses without a
        figure are left out of it.

        Args:
            unit: Symbol of the unit: ``"m"`` of positions and lengths, ``"rad"`` of orientations.

        Returns:
            By ``"ap_max"``, ``"ap_mean"``, ``"rp_max"``, ``"rp_mean"`` and ``"single_max"``; NaN where no pose has one.
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
        """The smallest and the largest number of repeats of a judged pose: ``rows`` of each of ``poses``."""
        counts = [len(pose.rows) for pose in self.poses]
        return min(counts), max(counts)


def accuracy(evaluation: Evaluation, *, seen: bool | Mask = False) -> Accuracy:
    """Return pose accuracy and repeatability of an evaluated robot.

    Where a target or a frame was registered to the estimation rows, the validation rows are judged alone, if there are
    any; where a calibration was fitted to some rows, the others, see `judged_rows`.

    Args:
        evaluation: Errors of the robot at the N rows of a table: ``residual``, measured minus predicted, shape (N, D),
            and its ``channels``; frames and targets as given or registered; and ``registered``,
            which of both were registered to these rows.
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
    rows, _ = rows_and_setup(evaluation.robot, m, of_images)
    registration = _registered_to(m, setup, rows)
    of_calibration = seen if isinstance(seen, np.ndarray) else registration & seen
    fitted = measured & of_calibration
    judged = judged_rows(m, measured, fitted, rows.poses, registered=bool(evaluation.registered))

    apart = not np.any(judged & registration)
    others: tuple[str, ...] = ()
    if np.any(fitted & ~judged):
        others += ("calibration",)
    if apart:
        others += evaluation.registered
    return Accuracy(
        poses=_poses(evaluation, rows, judged),
        rows=_name_of(judged, measured, m.validation),
        others=others,
        measured=int(np.sum(measured)),
        fitted=int(np.sum(fitted)),
        seen=bool(np.any(fitted & judged)),
        registered=() if apart else evaluation.registered,
        unknowns=_unknowns(setup),
        numbers=_scalars_without_repeats(rows, measured & registration),
    )


def _scalars_without_repeats(rows: Rows, chosen: Mask) -> int:
    """Return the number of scalars that some rows measure, those of repeats of a pose counted once.

    Args:
        rows: The N rows of a table. Those of one number in ``poses``, shape (N,), are repeats; ``used``, shape (N, D),
            is True for the scalars that a row measures.
        chosen: True for the rows that count, shape (N,).
    """
    _, first_of_pose = np.unique(rows.poses[chosen], return_index=True)
    one_per_pose = np.flatnonzero(chosen)[first_of_pose]
    return int(np.sum(rows.used[one_per_pose]))


def _registered_to(measurements: Measurements, setup: Setup, rows: Rows) -> Mask:
    """Return the rows that frames and targets were registered to, if any were.

    Args:
        measurements: The N rows of the table.
        setup: Frames and targets of these rows, which of them are unknown, and which were given.
        rows: The same N rows as arrays, with the index of the frame and target of each.

    Returns:
        True for these rows, shape (N,): the estimation rows, or all if there are none; and other rows that see an
        unknown frame or target which was not given and which none of these sees.
    """
    usual = registration_rows(measurements)
    unseen_by_usual = setup.with_given_fixed(rows.samples.select(usual))
    return usual | unseen_by_usual.unknown_at(rows.samples)


def _unknowns(setup: Setup) -> int:
    """Return the number of unknowns of the targets and frames that were not given, and so were registered.

    Args:
        setup: F frames and T targets of a table: ``target_unknown`` and ``target_given``, masks of shape (T,),
            ``frame_given``, of shape (F,), and ``unknown``, the estimated directions of each frame. A target counts 3
            unknowns, or 6 where orientations were measured (``rotation``); a frame as many as its unknown directions.
    """
    targets = int(np.sum(setup.target_unknown & ~setup.target_given))
    of_target = 6 if setup.rotation else 3
    of_frames = 0
    for directions, given in zip(setup.unknown, setup.frame_given, strict=True):
        if not given:
            of_frames += len(directions)
    return of_target * targets + of_frames


def _name_of(judged: Mask, measured: Mask, validation: Mask) -> JudgedRows:
    """Return the name of the judged rows among the N rows of a table.

    Args:
        judged: True for the rows that the robot is judged by, shape (N,).
        measured: True for rows that hold a measurement, shape (N,).
        validation: True for the rows of the table's set ``validate``, shape (N,).

    Returns:
        ``"all"`` if all measured rows are judged; ``"validation"`` if just the measured validation rows are; else
        ``"fresh"``, rows that no calibration was fitted to.
    """
    if np.array_equal(judged, measured):
        return "all"
    if np.array_equal(judged, measured & validation):
        return "validation"
    return "fresh"


def _poses(evaluation: Evaluation, rows: Rows, judged: Mask) -> tuple[PoseAccuracy, ...]:
    """Return accuracy and repeatability at each pose of the judged rows.

    Args:
        evaluation: Residuals of the robot, measured minus predicted, at the N rows of a table, with T_frame_base of
            each measurement frame.
        rows: The same N rows as arrays; those of one number in ``poses``, shape (N,), are repeats of one pose, target,
            station and kind.
        judged: True for the rows that the robot is judged by, shape (N,).

    Returns:
        One entry a pose, in the order of their first rows.
    """
    residual = _in_base_axes(evaluation, rows)
    chosen = np.flatnonzero(judged)
    order = chosen[np.argsort(rows.poses[chosen], kind="stable")]
    first_of_pose = np.flatnonzero(np.diff(rows.poses[order])) + 1
    repeats = np.split(order, first_of_pose)
    repeats.sort(key=lambda indices: int(indices[0]))
    return tuple(_of_pose(evaluation, residual, indices) for indices in repeats)


def _in_base_axes(evaluation: Evaluation, rows: Rows) -> Array:
    """Return residuals along the axes of the robot's base: e_base = R^T e_frame, with the rotation R of T_frame_base.

    Args:
        evaluation: ``residual``, measured minus predicted by the robot at N rows, along the axes of each row's
            measurement frame, shape (N, D); and ``setup.T_frame_base``, the pose of the base in each of F frames, shape
            (F, 4, 4).
        rows: The same N rows as arrays: their kinds, and ``samples.frame``, the index of each row's frame, shape (N,).

    Returns:
        shape (N, D): vectors of three components, of positions or of orientations, are turned; what has fewer, such as
        one length, stays as it is.
    """
    residual = evaluation.residual.copy()
    R = evaluation.setup.T_frame_base[rows.samples.frame, :3, :3]
    for unit in rows.channels.present:
        columns, are_vectors = rows.channels.vector_columns(unit)
        if len(columns):
            at = np.ix_(are_vectors, columns)
            residual[at] = np.einsum("nji,nj->ni", R[are_vectors], residual[at])
    return np.asarray(residual)


def _of_pose(evaluation: Evaluation, residual: Array, repeats: NDArray[np.intp]) -> PoseAccuracy:
    """Return accuracy and repeatability at one pose, as ISO 9283 defines them.

    Args:
        evaluation: Errors of the robot at the N rows of a table: ``channels``, the unit of each scalar that a row
            measures, shape (N, D), and the table itself, for kind, station and target of the pose.
        residual: Measured minus predicted of all N rows, shape (N, D), vectors along the base's axes.
        repeats: Indices of the pose's rows in the table, from 0, shape (n,).

    Returns:
        The figures of the pose in each unit that was measured, with the numbers of its rows in the table.
    """
    m, first = evaluation.measurements, repeats[0]
    channels = evaluation.channels.select(repeats)
    by_unit = {}
    for unit in channels.present:
        columns, _ = channels.vector_columns(unit)
        errors = residual[repeats][:, channels.columns(unit)]
        by_unit[unit] = _figures(errors, unit, are_vectors=bool(len(columns)))
    return PoseAccuracy(
        rows=tuple(int(m.rows[i]) for i in repeats),
        kind=m.kinds[first],
        group=m.groups[first],
        target=m.targets[first],
        by_unit=by_unit,
    )


def _figures(e: Array, unit: str, *, are_vectors: bool) -> PoseFigures:
    """Return accuracy and repeatability of the repeats of one pose in one unit.

    Args:
        e: Residuals of n repeats, measured minus predicted, shape (n, d).
        unit: Symbol of their unit.
        are_vectors: Whether they are vectors along, or about, the base's axes.

    Returns:
        In this unit; NaN for repeatability with fewer than `FEWEST_REPEATS` rows.
    """
    mean = e.mean(axis=0)
    enough = len(e) >= FEWEST_REPEATS
    by_axis = 3.0 * e.std(axis=0, ddof=1) if enough else np.full(len(mean), np.nan)
    rp = np.nan
    if enough:
        rp = repeatability(e, unit)
    nothing = np.full(3, np.nan)
    return PoseFigures(
        ap=float(np.linalg.norm(mean)),
        ap_axis=read_only(mean if are_vectors else nothing),
        rp=rp,
        rp_axis=read_only(by_axis if are_vectors else nothing),
        single=_largest_norm(e),
    )


def _largest_norm(vectors: Array) -> float:
    """Return the largest norm of vectors, such as the largest error of a single repeat.

    Args:
        vectors: shape (n, d) with n >= 1, residuals [m] or rotation vectors [rad].

    Returns:
        In their unit.
    """
    return float(np.linalg.norm(vectors, axis=1).max())


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

    Rows that the calibration was not fitted to, if the table sets some of them aside or they are of at least
    `FEWEST_APART` poses; and of these the validation rows alone, if there are any and something was registered to the
    estimation rows. Otherwise all measured rows.

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
        cell: What is known of frames, targets and loads of the table.

    Returns:
        True for these rows, shape (N,).
    """
    fitted = np.zeros(len(measurements), dtype=bool)
    # Of a station that the result does not know no row was fitted.
    with contextlib.suppress(CalibError):
        fitted = _recognised(calibration, robot, measurements, cell)
    same_file = bool(calibration.source.sha256)
    same_file = same_file and calibration.source.sha256 == measurements.sha256
    if same_file and not np.any(fitted):
        return measurements.estimation
    return fitted


@dataclass(frozen=True, slots=True, eq=False)
class _KnownResiduals:
    """Residuals of N rows by two robots, by which a row is recognised in another table.

    Of a row count the scalars in the first of its units: lengths, if it measures any.
    """

    #: Shape (N, D), measured minus predicted by the nominal robot
    nominal: Array
    #: The same by the corrected robot
    corrected: Array
    #: True for the scalars that count, of the same shape
    counts: Mask

    @classmethod
    def of(cls, nominal: Array, corrected: Array, channels: Channels) -> _KnownResiduals:
        """Return residuals with a mask of the scalars that count.

        Args:
            nominal: Measured minus predicted by the nominal robot at N rows, shape (N, D).
            corrected: The same by the corrected robot.
            channels: The unit of each scalar.
        """
        counts = np.zeros_like(channels.used)
        for unit in channels.present:
            not_yet = ~counts.any(axis=1, keepdims=True)
            counts |= channels.where(unit) & not_yet
        return cls(nominal, corrected, counts)

    def rows_with(self, scalars: int) -> NDArray[np.intp]:
        """Return the indices of the rows, from 0, of which a number of scalars count, shape (n,)."""
        return np.flatnonzero(self.counts.sum(axis=1) == scalars)

    def side_by_side(self, rows: Integers) -> Array:
        """Return the residuals of some rows by both robots, side by side.

        Args:
            rows: Indices, from 0, of n rows of which the same number k of scalars count.

        Returns:
            shape (n, 2 k), measured minus predicted: the k by the nominal robot, then those by the corrected one.
        """
        both = []
        for residual in (self.nominal, self.corrected):
            scalars = residual[rows][self.counts[rows]]
            both.append(scalars.reshape(len(rows), -1))
        return np.hstack(both)


def _recognised(c: Calibration, robot: Robot, measurements: Measurements, cell: Cell) -> Mask:
    """Find the rows of a table whose residuals are those of a row that a result was fitted to.

    Args:
        c: The result, which holds the residuals of its own rows by its nominal and by its calibrated robot, and the
            frames and targets of either.
        robot: The robot with which the table is evaluated, nominal or corrected; its joint origins are replaced by
            those of the result.
        measurements: The table, N rows.
        cell: What is known of frames, targets and loads of the table.

    Returns:
        True for these rows, shape (N,).

    Raises:
        CalibError: The table cannot be evaluated, such as with a station that the result does not know.
    """
    nominal = evaluate(c.uncorrected(robot), measurements, cell, known=c.nominal_setup)
    corrected = evaluate(c.corrected(robot), measurements, cell, known=c.setup)
    by_nominal, stored_by_nominal = nominal.residual, c.rows.residual_nominal
    if (
        not c.rows.nominal_is_judged
    ):  # none are stored: those by the calibrated robot alone have to tell the rows
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
    """Find the rows of residuals that are, to rounding, one of the stored rows.

    Args:
        residuals: shape (n, k), [m].
        stored: shape (s, k) with s >= 1, [m].

    Returns:
        True where no component differs from those of some stored row by more than `_SAME`, shape (n,).
    """
    tree = KDTree(stored)
    distance, _ = tree.query(residuals, p=np.inf, distance_upper_bound=_SAME)
    return np.asarray(distance <= _SAME)
