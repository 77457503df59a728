"""evaluate: the errors of a robot against measurements, without changing it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from calib.basics.arguments import check_names, check_path, check_type
from calib.basics.arrays import Array, Mask, read_only
from calib.basics.channels import Channels
from calib.basics.jobs import one_blas_thread
from calib.basics.values import ReadOnlyMapping, Value, shown_by
from calib.boards.board import Board
from calib.camera.camera import Camera
from calib.data.cell import Cell
from calib.data.columns import DEFAULT_TARGET
from calib.data.inputs import CellInput, RobotInput, TableInput, inputs_of
from calib.data.measurements import Measurements
from calib.data.record import BLANK, Record
from calib.diagnosis.reasons import Reason, Why
from calib.errors import CalibError, ModelError, choices
from calib.fit.registration.registration import nominal_setup, register_held_out
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.error_model import DIRECTIONS
from calib.model.kinematics import Samples
from calib.numerics.errors import Errors
from calib.result.fitted_model import NonGeometric
from calib.result.image_errors import ImageFigures, length_of_pixels
from calib.robot.robot import Robot

#: What may be taken from an earlier result.
PLACES = ("frame", "target")

#: The reason that names a place which has moved, by the place; of two that explain the errors alike the last counts.
_MOVED = {"frame": Why.FRAME_MOVED, "target": Why.TARGET_MOVED}

#: A frame or target has moved if registering it anew makes the rms error this many times smaller.
_FAR_SMALLER = 3.0

#: A registration is believed if it rests on this many scalars per unknown.
_SCALARS_PER_UNKNOWN = 3

#: An rms error up to this needs no explanation [m].
_SMALL = 1e-4


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Evaluation(Value):
    """Errors of a robot as it is."""

    #: The robot
    robot: Robot
    #: All N rows
    measurements: Measurements
    #: Frames and targets as given or registered
    setup: Setup
    #: Some of ``"target"`` and ``"frame"``, registered to these rows
    registered: tuple[str, ...]
    #: Shape (N, D), measured minus predicted
    residual: Array
    #: Unit of each entry of the residual, and which were measured
    channels: Channels
    #: Who measured what for whom, where, when and with what, as the cell says
    record: Record = BLANK
    #: Cameras by which images were predicted, as `Cell.cameras`
    cameras: Mapping[str, Camera] = field(default_factory=ReadOnlyMapping)
    #: Printed boards that they showed, as `Cell.boards`
    boards: Mapping[str, Board] = field(default_factory=ReadOnlyMapping)
    #: Errors of images in pixels and at the board; None without images
    images: ImageFigures | None = None

    def __repr__(self) -> str:
        """One line: the robot, rms errors, number of rows."""
        return str(shown_by("verbs.evaluate.text").evaluation_line(self))

    def _repr_html_(self) -> str:
        """A small table for notebooks: errors by set."""
        return str(shown_by("verbs.evaluate.text").evaluation_html(self))

    def summary(self) -> str:
        """Return the evaluation as text, without colours, in 100 columns, as ``calib evaluate`` prints it."""
        return str(shown_by("verbs.evaluate.text").evaluation_text(self))

    def write_report(
        self, path: str | Path, *, accepted: Value | None = None, overwrite: bool = False
    ) -> Path:
        """Write the report, a page that prints on A4, with the figures of ISO 9283 and a first page to sign.

        Args:
            path: The HTML file.
            accepted: What `calib.acceptance` found of this evaluation; None: no tolerance is tested.
            overwrite: Whether a file that exists is replaced.

        Returns:
            The path.

        Raises:
            ArgumentError: An argument of another type.
            MeasurementError: No row measures anything.
            FileError: The file exists, or cannot be written.
        """
        check_path("path", path)
        report = shown_by("verbs.evaluate.evaluation_report")
        return Path(report.write_evaluation_report_of(self, accepted, path, overwrite=overwrite))

    @property
    def used(self) -> Mask:
        """True for the entries of the residual that were measured, of ``channels``, shape (N, D)."""
        return self.channels.used

    @property
    def errors(self) -> dict[str, Errors]:
        """``errors["estimation" | "validation" | "all"]``: largest, mean and rms error of the rows of one set.

        Of ``residual``, measured minus predicted by the robot as it is at N rows, shape (N, D), in each unit of
        ``channels`` that was measured, such as ``["m"]``. The sets are those of ``measurements``.
        """
        m = self.measurements
        every_row = np.ones(len(m), dtype=bool)
        sets = {"estimation": m.estimation, "validation": m.validation, "all": every_row}
        errors = {}
        for name, rows in sets.items():
            errors[name] = Errors.of(self.residual[rows], self.channels.select(rows))
        return errors


@one_blas_thread()
def evaluate(
    robot: RobotInput,
    measurements: TableInput,
    cell: CellInput = None,
    *,
    known: Setup | None = None,
    which: tuple[str, ...] = PLACES,
    non_geometric: NonGeometric | None = None,
) -> Evaluation:
    """Compare a robot with measurements.

    Target and measurement frame are used as the cell gives them; what it does not give is registered to the estimation
    rows, or to all rows if there are none; to the others where no estimation row sees it.

    Args:
        robot: The robot, nominal or corrected; or the path of a URDF or xacro, or a name such as ``"ur3"``: base and
            tip are then the cell's, or the URDF's root and the end of the longest chain whose joints are all in the
            table.
        measurements: The N rows, or the path of their table.
        cell: What is known of target and frame, payload and gravity, or the path of a cell file; None: nothing, and the
            measurements are in the base frame.
        known: Frames and targets of an earlier result, which win over the cell's: `Calibration.setup`, or its
            ``nominal_setup`` for the nominal robot; None: there are none.
        which: What of ``known`` is taken: its ``"frame"``, its ``"target"`` or both.
        non_geometric: The non-geometric model of a result, to predict with on the nominal robot; None: the robot
            predicts by its joint origins. Its frames and targets are the known ones, of which ``which`` are taken; its
            gravity counts, and a payload of the cell wins over its own.

    Returns:
        Residuals of the N rows, measured minus predicted, shape (N, D), with their units, and the frames and targets
        that were used.

    Raises:
        ArgumentError: Robot, measurements or cell are of another type.
        MeasurementError: Too few rows to register what was not given, or a joint's column is missing.
        ModelError: Frames are taken from the earlier result, and the table has a station that it lacks and whose frame
            is not to be registered.
    """
    arm, table, known_cell = inputs_of(robot, measurements, cell)
    check_names("which", which)
    check_type("known", known, (Setup, type(None)), "the setup of a Calibration, or None")
    check_type(
        "non_geometric", non_geometric, (NonGeometric, type(None)), "a NonGeometric, or None"
    )
    if not set(PLACES) >= set(which):
        raise ModelError(
            f"The argument 'which' is {which!r}; it must be some of {choices(PLACES)}."
        )
    if non_geometric is not None:
        payload = known_cell.payload or non_geometric.payload
        known_cell = replace(known_cell, payload=payload, gravity=non_geometric.gravity)
        known = non_geometric.setup
    rows, setup = rows_and_setup(arm, table, known_cell)
    if known is not None:
        setup = replace(_with_known(setup, known, which), internals=known.internals)
    T_base_tip = _tip_poses(arm, rows, non_geometric)
    placed = _registered(T_base_tip, rows, setup, registration_rows(table))
    seen = placed.sightings(T_base_tip, rows.samples)
    residual = rows.residual(seen)
    scale = length_of_pixels(seen, rows)
    return Evaluation(
        robot=arm,
        measurements=table,
        setup=placed,
        registered=_not_given(setup),
        residual=read_only(residual),
        channels=rows.channels,
        record=known_cell.record,
        cameras=known_cell.cameras,
        boards=known_cell.boards,
        images=None if scale is None else ImageFigures.of(residual, scale, rows, table.images),
    )


def registration_rows(measurements: Measurements) -> Mask:
    """Return the rows to which frames and targets are registered: the estimation rows, or all if there are none.

    Args:
        measurements: The N rows of a table, of the sets ``estimate`` and ``validate``.

    Returns:
        True for these rows, shape (N,).
    """
    if np.any(measurements.estimation):
        return measurements.estimation
    return np.ones(len(measurements), dtype=bool)


def _tip_poses(robot: Robot, rows: Rows, non_geometric: NonGeometric | None) -> Array:
    """Return T_base_tip, the pose of the tip in the base, at each row.

    Args:
        robot: The robot: nominal or corrected, but nominal under a non-geometric model.
        rows: The N rows as arrays: joint values, shape (N, m), [rad] or [m], and the loads of gravity on the joints.
        non_geometric: The fitted model, geometry included, whose errors displace the robot; None: the robot is taken as
            it is.

    Returns:
        shape (N, 4, 4), [m].
    """
    if non_geometric is None:
        return robot.poses(rows.joints)
    kinematics = replace(non_geometric.kinematics, robot=robot)
    model = replace(non_geometric, kinematics=kinematics)
    return model.tips(Samples.at(rows.joints, rows.samples.load))


def _registered(T_base_tip: Array, rows: Rows, setup: Setup, chosen: Mask) -> Setup:
    """Register the frames and targets that were not given to the chosen rows, and what only the others see to these.

    Args:
        T_base_tip: Predicted poses of the tip in the base, shape (N, 4, 4), [m].
        rows: The N rows as arrays: what was measured, and the frame and target of each.
        setup: Frames and targets as far as they are given: which are unknown, and which of these are given all the same
            and stay as they are.
        chosen: True for the rows to register to, shape (N,).

    Returns:
        The frames and targets, all placed: T_frame_base, pose of the base in each frame, and T_tip_target, [m].

    Raises:
        MeasurementError: Too few rows for a frame or target.
    """
    placed = nominal_setup(T_base_tip[chosen], setup, rows.select(chosen))
    unseen = setup.with_given_fixed(rows.samples.select(chosen))
    return register_held_out(T_base_tip[~chosen], placed, unseen, rows.select(~chosen))


def _not_given(setup: Setup) -> tuple[str, ...]:
    """List what has to be registered: frames and targets that are unknown and were not given.

    Args:
        setup: F frames and T targets of a table: ``unknown``, the directions of each frame that are to be estimated,
            ``frame_given``, shape (F,); ``target_unknown`` and ``target_given``, shape (T,).

    Returns:
        ``"target"`` if a target is unknown and not given, and ``"frame"`` if a frame is; neither, one or both, in this
        order.
    """
    places = []
    if np.any(setup.target_unknown & ~setup.target_given):
        places.append("target")
    frames = zip(setup.unknown, setup.frame_given, strict=True)
    if any(directions and not given for directions, given in frames):
        places.append("frame")
    return tuple(places)


def _with_known(setup: Setup, known: Setup, which: tuple[str, ...]) -> Setup:
    """Return a table's measurement setup with the frames and targets of an earlier result.

    They are matched by name. Where table and result have one frame each, or one target, these are matched whatever they
    are called; but a single target that the table names, so that it is not the default one, is matched by name.

    Args:
        setup: Frames and targets of the table, as far as they are given.
        known: Those of the result, as it estimated them or was given them: T_frame_base of each station, T_tip_target
            of each target [m], and ``oriented``, whether the orientations of its targets are known.
        which: What to take from the result: ``"frame"``, ``"target"``, or both.

    Returns:
        The table's setup; frames and targets that were taken are given, and no longer unknown. Where orientations were
        measured and those of the result's targets are not known, targets stay unknown and count as not given; their
        position is only where registration begins.

    Raises:
        ModelError: Frames are to be taken, and the table has a station that the result lacks, with a frame that is not
            to be estimated.
    """
    frame_index: dict[int, int] = {}
    target_index: dict[int, int] = {}
    if "frame" in which:
        frame_index = _matches(setup.groups, known.groups)
    if "target" in which:
        other_target = setup.targets[0] != DEFAULT_TARGET
        target_index = _matches(setup.targets, known.targets, by_name=other_target)
    frames = _replaced(setup.T_frame_base, known.T_frame_base, frame_index)
    targets = _replaced(setup.T_tip_target, known.T_tip_target, target_index)
    frame_known = np.isin(np.arange(len(frames)), list(frame_index))
    target_known = np.isin(np.arange(len(targets)), list(target_index))
    if "frame" in which:
        _check_stations(setup, frame_known, known.groups)
    # Where orientations were measured, a position alone is only where registration of the target begins.
    whole = known.oriented or not setup.rotation
    fixed = target_known if whole else np.zeros_like(target_known)
    return replace(
        setup.with_fixed(frame_known, fixed).with_poses(frames, targets),
        frame_given=setup.frame_given | frame_known,
        target_given=np.where(target_known, fixed, setup.target_given),
    )


def _replaced(poses: Array, known: Array, index: Mapping[int, int]) -> Array:
    """Return poses of a table's frames or targets, some of them replaced by those of a result.

    Args:
        poses: Of the table's n frames or targets, T_frame_base or T_tip_target, shape (n, 4, 4), [m].
        known: The same of the result's k frames or targets, shape (k, 4, 4), [m].
        index: Index in the result, by the index in the table, of those to replace; from 0.

    Returns:
        A copy of ``poses``, shape (n, 4, 4), [m].
    """
    result: Array = poses.copy()
    for k, known_index in index.items():
        result[k] = known[known_index]
    return result


def _check_stations(setup: Setup, frame_known: Mask, known_groups: tuple[str, ...]) -> None:
    """Refuse a station whose frame the result does not know and that is not to be registered.

    Args:
        setup: Frames and targets of the table: ``groups``, the F stations' names, and ``unknown``, the directions of
            each frame that are to be estimated, none for a frame taken as known.
        frame_known: True for frames that were taken from the result, shape (F,).
        known_groups: Names of the result's stations.

    Raises:
        ModelError: There is one.
    """
    missing = []
    for k, group in enumerate(setup.groups):
        if not frame_known[k] and not setup.unknown[k]:
            missing.append(group)
    if missing:
        raise ModelError(
            f"The result has the set-ups {choices(known_groups)}; the table's {choices(missing)} are none of them. Let "
            "the measurement frames be found (--frame estimate), or give them in a cell file."
        )


def _matches(
    names: tuple[str, ...], known: tuple[str, ...], *, by_name: bool = False
) -> dict[int, int]:
    """Match frames or targets of a table with those of a result, by name or the only one with the only one.

    Args:
        names: Names of all stations, or of all targets, in the table.
        known: Those in the result.
        by_name: True to match by name also where there is only one of each.

    Returns:
        Index in the result, by the index in the table, both from 0; without those that the result lacks.
    """
    if len(names) == len(known) == 1 and not by_name:
        return {0: 0}
    return {k: known.index(name) for k, name in enumerate(names) if name in known}


def moved_place(
    robot: Robot,
    measurements: Measurements,
    cell: Cell,
    known: Setup,
    which: tuple[str, ...] = PLACES,
) -> Reason | None:
    """Name the frame or the target of an earlier result if it has moved since.

    It has if registering it anew makes the rms error at most one `_FAR_SMALLER`-th. If both do, it is the one with the
    smaller error.

    Args:
        robot: The calibrated robot.
        measurements: Rows that were measured later.
        cell: What is known of frames, targets and loads of these rows.
        known: Frames and targets of the result, as it estimated them or was given them.
        which: What is taken from them: some of `PLACES`, ``"frame"`` and ``"target"``.

    Returns:
        The reason, ``FRAME_MOVED`` or ``TARGET_MOVED``, with the rms errors in length before, ``given_m``, and after,
        ``error_m`` [m]; None where nothing has moved, or the error is below `_SMALL`.
    """
    as_known = evaluate(robot, measurements, cell, known=known, which=which)
    rms, best = as_known.errors["all"]["m"].rms, None
    if not rms > _SMALL:
        return None
    least = rms / _FAR_SMALLER
    for place, why in _MOVED.items():
        if place in as_known.registered:
            continue
        others = tuple(name for name in which if name != place)
        open_cell = _with_open(cell, place)
        error = _registered_error(robot, measurements, open_cell, known, others)
        if error is not None and error <= least:
            least, best = error, Reason.of(why, given_m=rms, error_m=error)
    return best


def _with_open(cell: Cell, place: str) -> Cell:
    """Return a cell that leaves its frames or its targets to be registered.

    Args:
        cell: What is known of frames, targets and loads.
        place: ``"frame"``, all six directions of which are then unknown; or ``"target"``.
    """
    if place == "frame":
        return replace(cell, estimate_frame=True, frame_directions=DIRECTIONS)
    return replace(cell, estimate_target=True)


def _registered_error(
    robot: Robot,
    measurements: Measurements,
    cell: Cell,
    known: Setup,
    which: tuple[str, ...],
) -> float | None:
    """Return the rms error in length of a robot after frames or targets were registered to the rows.

    Args:
        robot: The calibrated robot.
        measurements: The rows.
        cell: What is known of frames, targets and loads; what it leaves open is registered.
        known: Frames and targets of an earlier result.
        which: What is taken from them: ``"frame"``, ``"target"``, both or none.

    Returns:
        [m], over all rows; None where the table cannot be evaluated, nothing is open, or there are fewer than
        `_SCALARS_PER_UNKNOWN` measured scalars for each unknown of frames and targets.
    """
    try:
        after = evaluate(robot, measurements, cell, known=known, which=which)
    except CalibError:
        return None
    unknowns, scalars = after.setup.count, int(after.used.sum())
    if not unknowns or scalars < _SCALARS_PER_UNKNOWN * unknowns:
        return None
    return after.errors["all"]["m"].rms
