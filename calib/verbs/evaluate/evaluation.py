"""evaluate: the errors of a robot against measurements, without changing it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np

from calib.basics.arguments import check_names, check_path, check_type
from calib.basics.arrays import Array, Mask, read_only
from calib.basics.channels import RESIDUAL_UNITS, Channels
from calib.basics.frames import Library, frame_of
from calib.basics.jobs import one_blas_thread
from calib.basics.values import ReadOnlyMapping, Value, shown_by
from calib.boards.board import Board
from calib.camera.camera import Camera
from calib.data.cell import Cell
from calib.data.cell_chains import robot_with_chains_of
from calib.data.columns import DEFAULT_TARGET
from calib.data.inputs import CellInput, RobotInput, TableInput, cell_of, inputs_of
from calib.data.measurements import Measurements
from calib.data.record import BLANK, Record
from calib.diagnosis.reasons import Reason, Why
from calib.errors import ArgumentError, CalibError, ModelError, choices, did_you_mean
from calib.fit.registration.board_ends import with_ends_of
from calib.fit.registration.registration import nominal_setup, register_held_out
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.kinematics import Samples
from calib.model.parameter_sets import DIRECTIONS
from calib.numerics.errors import Errors
from calib.result.board_errors import BoardErrors, board_errors
from calib.result.calibration import Calibration
from calib.result.chain_of_result import with_chain_of_result
from calib.result.fitted_model import NonGeometric
from calib.result.result_frames import error_columns
from calib.robot.robot import Robot
from calib.robot.urdf import read_urdf
from calib.show.measured_rows import chains_of_rows
from calib.verbs.evaluate.row_uncertainty import RowUncertainty, matching, row_uncertainty

#: Places that may be taken from an earlier result.
PLACES = ("frame", "target")

_RESULT = "a Calibration, or the path of its file"

#: The reason that names a place which has moved, by the place; of two that explain the errors equally the last counts.
_MOVED = {"frame": Why.FRAME_MOVED, "target": Why.TARGET_MOVED}

#: A frame or target has moved if registering it again makes the rms error this many times smaller.
_FAR_SMALLER = 3.0

#: A registration is trusted if it has this many measured scalars per unknown.
_SCALARS_PER_UNKNOWN = 3

#: An rms error up to this needs no explanation [m].
_SMALL = 1e-4


#: Percentile of the errors of images that is reported besides mean and largest error.
_PERCENTILE = 95.0


@dataclass(frozen=True, slots=True)
class ImageFigures:
    """Errors of images in pixels and at the board; the error of a corner is the distance of its image.

    An error of e pixels of a corner at the depth Z is e Z / f at the board, across the line of sight, with the focal
    length f [px].
    """

    #: Number of images, and of corners in them
    images: int
    corners: int
    #: Mean of the errors, the 95th percentile, and the largest [px]
    mean: float
    p95: float
    largest: float
    #: Mean residual, measured minus predicted, along u and along v [px]
    bias: tuple[float, float]
    #: Mean, 95th percentile and largest error as a length at the board [m]
    mean_at_board: float
    p95_at_board: float
    largest_at_board: float
    #: Errors of the boards' poses in three dimensions; None if no view determines one
    board: BoardErrors | None = None

    @classmethod
    def of(
        cls,
        residual: Array,
        scale: Array,
        rows: Rows,
        names: Sequence[str],
        board: BoardErrors | None = None,
    ) -> ImageFigures | None:
        """Summarise the residuals of images.

        Args:
            residual: shape (N, D), measured minus predicted.
            scale: shape (N,), length that a pixel is at each corner [m/px]; NaN in rows that are not images.
            rows: The N rows.
            names: Name of the image of each row; without names, a pose has one image.
            board: Errors of the boards' poses; None if no view determines one.

        Returns:
            The figures; None if no row is an image.
        """
        images = np.isfinite(scale)
        if not np.any(images):
            return None
        uv = residual[images][:, :2]
        errors = np.linalg.norm(uv, axis=1)
        lengths = errors * scale[images]
        bias = uv.mean(axis=0)
        return cls(
            images=len({(rows.blocks[i], names[i]) for i in np.flatnonzero(images).tolist()}),
            corners=int(np.sum(images)),
            mean=float(errors.mean()),
            p95=float(np.percentile(errors, _PERCENTILE)),
            largest=float(errors.max()),
            bias=(float(bias[0]), float(bias[1])),
            mean_at_board=float(lengths.mean()),
            p95_at_board=float(np.percentile(lengths, _PERCENTILE)),
            largest_at_board=float(lengths.max()),
            board=board,
        )


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
    #: Uncertainty of the rows' errors; None unless a calibration predicts them
    uncertainty: RowUncertainty | None = None

    def __repr__(self) -> str:
        """One line: the robot, rms errors, number of rows."""
        return str(shown_by("verbs.evaluate.text").evaluation_line(self))

    def _repr_html_(self) -> str:
        """A small table for notebooks: errors by set."""
        return str(shown_by("verbs.evaluate.report").evaluation_html(self))

    def summary(self) -> str:
        """Return the evaluation as text, without colours, in 100 columns, as ``calib evaluate`` prints it."""
        return str(shown_by("verbs.evaluate.report").evaluation_text(self))

    def write_report(
        self, path: str | Path, *, accepted: Value | None = None, overwrite: bool = False
    ) -> Path:
        """Write the report, a page that prints on A4, with the characteristics of ISO 9283 and a first page to sign.

        Args:
            path: The file, a page (.html) or a PDF (.pdf), which an installed Chromium, Chrome or Edge prints.
            accepted: Result of `calib.acceptance` for this evaluation; None: no tolerance is tested.
            overwrite: Whether a file that exists is replaced.

        Returns:
            The path.

        Raises:
            ArgumentError: An argument of another type.
            MeasurementError: No row measures anything.
            FileError: The file exists, or cannot be written.
        """
        check_path("path", path)
        report = shown_by("verbs.evaluate.report")
        return Path(report.write_evaluation_report(self, accepted, path, overwrite=overwrite))

    def to_frame(self, library: Library = "pandas") -> Any:  # noqa: ANN401  of any library
        """Return the rows with their errors, residuals, and U of the errors [mm], [deg], [px], as a frame.

        U is in it if a calibration predicts the rows, with whether each error is within.

        Args:
            library: ``"pandas"`` or ``"polars"``.

        Returns:
            A ``pandas.DataFrame`` or a ``polars.DataFrame``.

        Raises:
            CalibError: The library is not installed, or another one was named.
        """
        m = self.measurements
        names = {
            "row": m.rows,
            "set": m.sets,
            "kind": m.kinds,
            "group": m.groups,
            "target": m.targets,
        }
        errors = error_columns({self.robot.name: self.residual}, self.channels)
        own = {name.removeprefix(f"{self.robot.name} "): values for name, values in errors.items()}
        expanded: dict[str, list[Any]] = {}
        for unit in self.channels.present if self.uncertainty is not None else ():
            shown = RESIDUAL_UNITS[unit]
            U, within = self.expanded(unit), self.within(unit)
            known = np.isfinite(U) & np.isfinite(self.channels.norms(self.residual, unit))
            for label, values in (
                (f"U [{shown.shown}]", U * shown.to_shown),
                (f"within U of {shown.measured}", within),
            ):
                pairs = zip(values.tolist(), known.tolist(), strict=True)
                expanded[label] = [value if is_known else None for value, is_known in pairs]
        return frame_of({**names, **own, **expanded}, library)

    @property
    def used(self) -> Mask:
        """True for the entries of the residual that were measured, shape (N, D)."""
        return self.channels.used

    def expanded(self, unit: str) -> Array:
        """Return U of each row's error, of prediction and measurement together, in a unit; shape (N,).

        Args:
            unit: Symbol of the unit, ``"m"``, ``"rad"`` or ``"px"``.

        Returns:
            What the error stays below with 95.45 %, as k = 2 has it; NaN where it is not known.
        """
        if self.uncertainty is None:
            return read_only(np.full(len(self.measurements), np.nan))
        return self.uncertainty.of_errors(unit)

    def within(self, unit: str) -> Mask:
        """Return whether the error of each row is within its U, see `expanded`; shape (N,), False if U is not known."""
        return np.asarray(self.channels.norms(self.residual, unit) <= self.expanded(unit))

    @property
    def errors(self) -> dict[str, Errors]:
        """``errors["estimation" | "validation" | "all"]``: errors of the rows of one set, in each unit measured."""
        m = self.measurements
        every_row = np.ones(len(m), dtype=bool)
        sets = {"estimation": m.estimation, "validation": m.validation, "all": every_row}
        errors = {}
        for name, rows in sets.items():
            errors[name] = Errors.of(self.residual[rows], self.channels.select(rows))
        return errors

    @property
    def errors_by_chain(self) -> dict[str, Errors]:
        """The errors of all rows of each chain, by its links such as ``"base to left_tool"``; empty for one chain."""
        chain = chains_of_rows(self.robot, self.setup, self.measurements)
        if chain is None:
            return {}
        errors = {}
        for number, one in enumerate(self.robot.chains):
            rows = chain == number
            if np.any(rows):
                errors[f"{one.base} to {one.tip}"] = Errors.of(
                    self.residual[rows], self.channels.select(rows)
                )
        return errors


@one_blas_thread()
def evaluate(
    robot: RobotInput,
    measurements: TableInput,
    cell: CellInput = None,
    *,
    calibration: Calibration | str | Path | None = None,
    known: Setup | None = None,
    which: tuple[str, ...] = PLACES,
    non_geometric: NonGeometric | None = None,
) -> Evaluation:
    """Compare a robot with measurements.

    Target and measurement frame are used as the cell gives them; what it does not give is registered to the estimation
    rows, or to all rows if there are none; to the others if no estimation row sees it.

    Args:
        robot: The robot, nominal or corrected; or the path of a URDF or xacro, or a name such as ``"ur3"``: base and
            tip are then the cell's, or the URDF's root and the end of the longest chain whose joints are all in the
            table.
        measurements: The N rows, or the path of their table.
        cell: What is known of target and frame, payload and gravity, or the path of a cell file; None: nothing, and the
            measurements are in the base frame.
        calibration: An earlier result of this robot, or the path of its file: the robot is evaluated with the joint
            origins, chain, frames and targets of that result, whether it is given as nominal or as corrected; with
            ``non_geometric`` by that model. None: the robot is evaluated as it is.
        known: Frames and targets of an earlier result, which win over the cell's: `Calibration.setup`, or its
            ``nominal_setup`` for the nominal robot; None: there are none.
        which: Places taken from ``known``: its ``"frame"``, its ``"target"`` or both.
        non_geometric: The non-geometric model of a result, to predict with on the nominal robot; None: the robot
            predicts by its joint origins. Its frames and targets are the known ones, of which ``which`` are taken; its
            gravity counts, and a payload of the cell wins over its own.

    Returns:
        Residuals of the N rows, measured minus predicted, shape (N, D), with their units, and the frames and targets
        that were used.

    Raises:
        ArgumentError: Robot, measurements or cell are of another type.
        MeasurementError: Too few rows to register what was not given, or a joint's column is missing.
        ModelError: Where a further robot stands is not known; frames are taken from the earlier result, and the table
            has a station that it lacks and whose frame is not to be registered; targets are taken from a result of
            several hands that lacks one of the table's; or ``which`` has another name.
    """
    result: Calibration | None = None
    if calibration is not None:
        check_type("calibration", calibration, (Calibration, str, Path), _RESULT)
        if known is not None:
            raise ArgumentError(
                "The argument 'known' is frames and targets, which 'calibration' has too. Give one of them."
            )
        result = calibration if isinstance(calibration, Calibration) else None
        result = result or Calibration.read_json(str(calibration))
        stated = with_chain_of_result(cell_of(cell), result, "The calibration")
        if not isinstance(robot, Robot) and (result.nominal.branches or result.nominal.parts):
            robot = robot_with_chains_of(result.nominal, read_urdf(str(robot)), stated.held)
        arm, table, known_cell = inputs_of(robot, measurements, result.complete_cell(stated))
        arm = result.corrected(arm) if non_geometric is None else result.uncorrected(arm)
        known = result.setup
    else:
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
    if known is None:
        _refuse_unknown_mounts(arm)
    if non_geometric is not None:
        payload = known_cell.payload or non_geometric.payload
        known_cell = replace(known_cell, payload=payload, gravity=non_geometric.gravity)
        known = non_geometric.setup
    rows, setup = rows_and_setup(arm, table, known_cell)
    if known is not None:
        if "target" in which:
            _refuse_unknown_targets(table, setup, known_cell, known)
        setup = replace(_with_known(setup, known, which), internals=known.internals)
    if non_geometric is None:
        T_base_tip = arm.poses(rows.joints, rows.samples.chain)
    else:
        kinematics = replace(non_geometric.kinematics, robot=arm)
        model = replace(non_geometric, kinematics=kinematics)
        samples = Samples.at(rows.joints, rows.samples.load, rows.samples.moves)
        T_base_tip = model.tips(replace(samples, chain=rows.samples.chain))

    # Boards that look the same from both ends are numbered from the end that suits.
    from_one_end = with_ends_of(table, known_cell, rows, setup.with_given_fixed(), T_base_tip)
    if from_one_end.other_end:
        table = from_one_end
        rows, _ = rows_and_setup(arm, table, known_cell)

    # Frames and targets that were not given, and what only the other rows see of them.
    chosen = registration_rows(table)
    placed = nominal_setup(T_base_tip[chosen], setup, rows.select(chosen))
    unseen = setup.with_given_fixed(rows.samples.select(chosen))
    placed = register_held_out(T_base_tip[~chosen], placed, unseen, rows.select(~chosen))

    sightings = placed.sightings(T_base_tip, rows.samples)
    residual = rows.residual(sightings)
    images = None
    if np.any(rows.is_image):
        scale = rows.lengths_per_unit(sightings)
        board = board_errors(rows, sightings, residual)
        images = ImageFigures.of(residual, scale, rows, table.images, board)
    evaluation = Evaluation(
        robot=arm,
        measurements=table,
        setup=placed,
        registered=_not_given(setup),
        residual=read_only(residual),
        channels=rows.channels,
        record=known_cell.record,
        cameras=known_cell.cameras,
        boards=known_cell.boards,
        images=images,
    )
    if result is None:
        return evaluation
    by_model = non_geometric is not None
    return with_uncertainty(evaluation, result, known_cell, which, non_geometric=by_model)


def with_uncertainty(
    evaluation: Evaluation,
    result: Calibration,
    cell: Cell,
    which: tuple[str, ...] = PLACES,
    *,
    non_geometric: bool = False,
) -> Evaluation:
    """Return the evaluation of a calibrated robot with the uncertainty of its rows' errors.

    Args:
        evaluation: Errors of the robot.
        result: The calibration that it is of.
        cell: Loads and noise of the rows.
        which: Places that are the result's, ``"frame"``, ``"target"`` or both.
        non_geometric: Whether the non-geometric model of the result predicts; else its geometry.
    """
    in_images = replace(cell, cameras=evaluation.cameras, boards=evaluation.boards)
    uncertainty = row_uncertainty(
        result,
        evaluation.robot,
        evaluation.measurements,
        in_images,
        evaluation.setup,
        which=which,
        non_geometric=non_geometric,
    )
    return replace(evaluation, uncertainty=uncertainty)


def _refuse_unknown_mounts(robot: Robot) -> None:
    """Refuse further robots whose place is not stated, by a `ModelError`: it is not registered to the rows."""
    for part in robot.parts:
        if part.mount not in robot.mounts:
            continue
        if np.array_equal(robot.urdf.joint(part.mount).T_parent_joint, np.eye(4)):
            name = part.name
            raise ModelError(
                f"Where the robot '{name}' stands is not stated, and an evaluation does not estimate it. State it in "
                f"the cell file, xyz_mm and rpy_deg of [robots.{name}], or give the --calibration that found it."
            )


def _refuse_unknown_targets(
    measurements: Measurements, setup: Setup, cell: Cell, known: Setup
) -> None:
    """Refuse targets that a result of several hands lacks, by a `ModelError`: which hand they are on is not known.

    A target whose place, or link among the cell's ``tips``, is given is not refused.
    """
    if len(set(known.target_links)) < 2:
        return
    source = measurements.source or "Measurements"
    for name in compress(setup.targets, setup.target_unknown & ~setup.target_given):
        if name in known.targets or name in cell.tips:
            continue
        rows = [k for k, of in enumerate(measurements.targets) if of == name]
        row = measurements.rows[rows[0]] if rows and measurements.rows else 1
        raise ModelError(
            f"{source}, row {row}: the target '{name}' is not one of the result, which has "
            f"{choices(known.targets)}{did_you_mean(name, known.targets)}. Name the target of each "
            "row in the column 'target', or give the link of a new one, --tip NAME=LINK."
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


def _not_given(setup: Setup) -> tuple[str, ...]:
    """List what has to be registered, of ``"target"`` and ``"frame"``: what is unknown and was not given."""
    places = []
    if np.any(setup.target_unknown & ~setup.target_given):
        places.append("target")
    frames = zip(setup.unknown, setup.frame_given, strict=True)
    if any(directions and not given for directions, given in frames):
        places.append("frame")
    return tuple(places)


def _with_known(setup: Setup, known: Setup, which: tuple[str, ...]) -> Setup:
    """Return a table's setup with frames, targets or both (``which``) of an earlier result, which then count as given.

    They are matched by name. If table and result have one frame each, or one target, these are matched whatever they
    are called; but a single target that the table names, so that it is not the default one, is matched by name. Raises
    `ModelError` if the result lacks a station whose frame is not to be registered.
    """
    # Index in the result by the index in the table, both from 0, without those that the result lacks.
    frame_index: dict[int, int] = {}
    target_index: dict[int, int] = {}
    if "frame" in which:
        frame_index = matching(setup.groups, known.groups)
    if "target" in which:
        other_target = setup.targets[0] != DEFAULT_TARGET
        target_index = matching(setup.targets, known.targets, by_name=other_target)
    T_frame_base, T_tip_target = setup.T_frame_base.copy(), setup.T_tip_target.copy()
    for k, of_result in frame_index.items():
        T_frame_base[k] = known.T_frame_base[of_result]
    for k, of_result in target_index.items():
        T_tip_target[k] = known.T_tip_target[of_result]
    frame_known = np.isin(np.arange(len(T_frame_base)), list(frame_index))
    target_known = np.isin(np.arange(len(T_tip_target)), list(target_index))

    if "frame" in which:
        # A frame that is neither known nor to be registered.
        missing = [
            group
            for k, group in enumerate(setup.groups)
            if not frame_known[k] and not setup.unknown[k]
        ]
        if missing:
            raise ModelError(
                f"The result has the stations {choices(known.groups)}; the table's {choices(missing)} are not among "
                "them. Let the measurement frames be found (--frame estimate), or give them in a cell file."
            )
    # If orientations were measured, a position alone is only where registration of the target begins.
    whole = known.oriented or not setup.rotation
    fixed = target_known if whole else np.zeros_like(target_known)
    return replace(
        setup.with_fixed(frame_known, fixed).with_poses(T_frame_base, T_tip_target),
        frame_given=setup.frame_given | frame_known,
        target_given=np.where(target_known, fixed, setup.target_given),
    )


def moved_place(
    robot: Robot,
    measurements: Measurements,
    cell: Cell,
    known: Setup,
    which: tuple[str, ...] = PLACES,
) -> Reason | None:
    """Name the frame or the target of an earlier result if it has moved since.

    It has if registering it again makes the rms error at most one `_FAR_SMALLER`-th. If both do, it is the one with the
    smaller error.

    Args:
        robot: The calibrated robot.
        measurements: Rows that were measured later.
        cell: Known frames, targets and loads of these rows.
        known: Frames and targets of the result, as it estimated them or was given them.
        which: Places taken from them: some of `PLACES`, ``"frame"`` and ``"target"``.

    Returns:
        The reason, ``FRAME_MOVED`` or ``TARGET_MOVED``, with the rms errors in length before, ``given_m``, and after,
        ``error_m`` [m]; None if nothing has moved, the error is at most `_SMALL`, or no length was measured. A place
        with too few rows for a new registration does not count as moved.
    """
    as_known = evaluate(robot, measurements, cell, known=known, which=which)
    rms, best = as_known.errors["all"]["m"].rms, None
    if not rms > _SMALL:
        return None
    least = rms / _FAR_SMALLER
    for place, why in _MOVED.items():
        if place in as_known.registered:
            continue
        open_cell = replace(cell, estimate_target=True)
        if place == "frame":
            open_cell = replace(cell, estimate_frame=True, frame_directions=DIRECTIONS)
        others = tuple(name for name in which if name != place)
        try:
            after = evaluate(robot, measurements, open_cell, known=known, which=others)
        except CalibError:
            continue
        unknowns, scalars = after.setup.count, int(after.used.sum())
        if not unknowns or scalars < _SCALARS_PER_UNKNOWN * unknowns:
            continue
        error = after.errors["all"]["m"].rms
        if error <= least:
            least, best = error, Reason.of(why, given_m=rms, error_m=error)
    return best
