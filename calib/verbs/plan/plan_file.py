"""A plan as files, and the poses of a table.

The table of a tracker's plan has a row for each pose and target, with empty cells for what will be measured there;
filled in, or together with an instrument's list of points, it is a table of measurements. A table of images has a row
for each image, with the file name under which to save it; `calib detect` finds in it which joint values belong to which
image. A JSON file has the plan and the forecast in SI units. See docs/planning.md.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import singledispatch
from itertools import compress
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Array, Mask, read_only
from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.files import csv_bytes, write_atomically
from calib.basics.tables import Column, Table
from calib.basics.units import Quantity
from calib.data.cell_chains import Sight
from calib.data.columns import DEFAULT_TARGET, EXPECTED, POINT, VIA, name_columns
from calib.data.forms.column_options import ColumnsInput
from calib.data.forms.orientations import QUATERNION
from calib.data.layout import Layout
from calib.data.measurements import Measurements
from calib.data.references import split_references
from calib.data.values import read_values
from calib.errors import MeasurementError
from calib.instruments.camera import CameraInstrument, board_tilts
from calib.instruments.instrument import Instrument, Sightline
from calib.numerics.moves import SAME_POSE, last_moves
from calib.robot.coupled_readings import coupling_table
from calib.robot.robot import Robot
from calib.verbs.plan.approach import side_name
from calib.verbs.plan.forecast import Forecast
from calib.verbs.plan.plan import Plan
from calib.verbs.plan.sensitivity import View
from calib.version import __version__

SCHEMA = "plan 2"

#: Decimals of degrees and millimetres: those of planned joint values, and of a tracker.
_DIGITS = 3

#: Unit in which values are written, and its number in one SI unit.
_WRITTEN = {unit.quantity: (unit.shown, unit.to_shown) for unit in RESIDUAL_UNITS.values()}

#: A whole number in the name of an image.
_NUMBER = re.compile(r"\d+")


# The table


class Sheet(Protocol):
    """Poses as they are written to a table: those of a `Plan`, or others to measure."""

    @property
    def robot(self) -> Robot:
        """The robot."""

    @property
    def joints(self) -> Array:
        """Joint values of K poses, (K, m)."""

    @property
    def moves(self) -> Array:
        """Last move of each joint before each pose, (K, m)."""

    @property
    def via(self) -> Array | None:
        """Joint values to drive to before each pose, (K, m); None: straight."""

    @property
    def sets(self) -> tuple[str, ...]:
        """The set of each pose."""

    @property
    def targets(self) -> tuple[str, ...]:
        """The targets."""

    @property
    def expected(self) -> Array:
        """Expected places, (K, k, 3)."""

    @property
    def sights(self) -> tuple[Sight, ...]:
        """Station and target of each of the k places."""

    @property
    def seen(self) -> Mask:
        """True where one of them is measured, (K, k)."""

    @property
    def views(self) -> tuple[View, ...]:
        """The measurements of the instruments at a pose."""

    @property
    def sightlines(self) -> tuple[Sightline, ...]:
        """Each instrument and its first target."""


def write_plan(
    plan: Plan,
    path: str | Path,
    *,
    overwrite: bool = False,
    first_row: int = 1,
) -> Path:
    """Write a plan as a CSV table in degrees and millimetres, in the order to drive; several targets have a row each.

    The columns of what is measured are empty; ``expected`` columns have what the nominal robot predicts.

    Args:
        plan: The plan.
        path: The file.
        overwrite: Whether an existing file is replaced.
        first_row: Number of the first row or image: if these are added to a table, one more than its last.

    Returns:
        The path of the file.

    Raises:
        FileError: It cannot be written.
    """
    rows = list(plan_rows(plan.instrument, plan, first_row))
    header = list(rows[-1])  # a pose that is only driven through has fewer cells
    table = [header, *([row.get(name, "") for name in header] for row in rows)]
    return write_atomically(path, csv_bytes(table), overwrite=overwrite)


@singledispatch
def plan_rows(instrument: Instrument, plan: Sheet, number: int) -> Iterator[dict[str, str]]:
    """Yield the cells of each row of a plan by the headers of their columns, in the order to drive.

    A pose that is only driven through has a row of its own.

    Args:
        instrument: The instrument, which determines the columns.
        plan: The plan.
        number: Number of the first row or image; a point is named after its row, ``"P1"``.
    """
    kind = instrument.kind
    lengths: list[tuple[str, Quantity]] = []
    if kind.position:
        lengths = [(axis, "length") for axis in POINT]
    readings = [(reading.name, reading.quantity) for reading in kind.readings]
    empty = [_header(*column) for column in lengths]
    if kind.orientation:
        empty += QUATERNION.columns
    empty += [_header(*column) for column in readings]
    # There are no expected orientations.
    expected = [*range(len(lengths)), *range(kind.size - len(readings), kind.size)]
    T_frame_target = np.eye(4)
    is_named = plan.targets != (DEFAULT_TARGET,)
    has_groups = any(group for group, _ in plan.sights)
    for k, (q, set_name, places) in enumerate(
        zip(plan.joints, plan.sets, plan.expected, strict=True)
    ):
        if plan.via is not None:
            yield {"row": str(number), "set": VIA, **_joint_cells(plan.robot, plan.via[k])}
            number += 1
        for (group, target), place in compress(
            zip(plan.sights, places, strict=True), plan.seen[k].tolist()
        ):
            row = {"row": str(number), "set": set_name, "point": f"P{number}"}
            if plan.via is not None:
                row["approach"] = side_name(plan.moves[k])
            if has_groups:
                row["group"] = group
            if is_named:
                row["target"] = target
            row |= _joint_cells(plan.robot, q)
            row |= dict.fromkeys(empty, "")
            T_frame_target[:3, 3] = place
            values = instrument.predict(T_frame_target[None])[0, expected]
            for (name, quantity), value in zip((*lengths, *readings), values, strict=True):
                row[EXPECTED + _header(name, quantity)] = _cell(quantity, value)
            yield row
            number += 1


@plan_rows.register
def _(instrument: CameraInstrument, plan: Sheet, number: int) -> Iterator[dict[str, str]]:
    """Yield the cells of each image by the headers of their columns, the images numbered from ``number`` on.

    There are no row numbers, because a table of corners has many rows of an image.
    """
    del instrument
    distances, tilts = _of_all_boards(plan)
    # Columns run from the foot of the robot to its hand, even if the chain leads the other way.
    backwards = plan.robot.base_moves and not plan.robot.branches
    has_groups = any(group for group, _ in plan.sights)

    def joint_cells(q: Array) -> dict[str, str]:
        """Return the texts of joint values (m,) by the headers of their columns."""
        cells = list(_joint_cells(plan.robot, q).items())
        return dict(cells[::-1] if backwards else cells)

    for k, q in enumerate(plan.joints):
        if plan.via is not None:
            yield {"set": VIA, **joint_cells(plan.via[k])}
        seen = np.flatnonzero(plan.seen[k]).tolist()
        for group in dict.fromkeys(plan.sights[s][0] for s in seen):
            boards = [s for s in seen if plan.sights[s][0] == group]
            row = {"set": plan.sets[k], "image": image_name(number + k, group)}
            if has_groups:
                row["group"] = group
            row |= joint_cells(q)
            if plan.targets != (DEFAULT_TARGET,):
                row[f"{EXPECTED}target"] = "/".join(plan.sights[s][1] for s in boards)
            far = [f"{1e3 * distances[k, s]:.1f}" for s in boards]
            slanted = [f"{math.degrees(tilts[k, s]):.1f}" for s in boards]
            row[f"{EXPECTED}distance [mm]"] = "/".join(far)
            row[f"{EXPECTED}tilt [deg]"] = "/".join(slanted)
            yield row


def image_name(number: int, group: str = "") -> str:
    """Return the file name of an image by its number, and by the station of its camera if that has a name."""
    return f"{group or 'image'}_{number:03d}.png"


def first_rows(plan: Plan, number: int) -> list[int]:
    """Return the numbers of the first rows of a plan's poses, the row to come from if there is one.

    Args:
        plan: The plan of a tracker.
        number: Number of the first row of all.
    """
    before = 0 if plan.via is None else 1
    counts = before + plan.seen.sum(axis=1)
    return [int(first) for first in number + np.cumsum(counts) - counts]


def distances_and_tilts(
    instrument: CameraInstrument, plan: Sheet, sight: int = 0
) -> tuple[Array, Array]:
    """Return the expected distances (K,) [m] and tilts (K,) [rad] of a board at the poses of a plan, seen or not.

    Args:
        instrument: The camera.
        plan: The plan.
        sight: Index of the camera and the board in ``plan.sights``.
    """
    T_camera_board = plan.sightlines[sight].target_poses(plan.joints)
    tilts = board_tilts(instrument.board, T_camera_board)
    return instrument.board_distances(T_camera_board), tilts


def _of_all_boards(plan: Sheet) -> tuple[Array, Array]:
    """Return the expected distances [m] and tilts [rad] at the poses of a plan of images, for each sight, (K, k)."""
    columns = []
    for k, view in enumerate(plan.views):
        assert isinstance(view.instrument, CameraInstrument)
        columns.append(distances_and_tilts(view.instrument, plan, k))
    distances, tilts = (np.stack(values, axis=1) for values in zip(*columns, strict=True))
    return distances, tilts


def _header(name: str, quantity: Quantity) -> str:
    """Return the header of a column, with the unit that tables are written in: ``"x [mm]"``."""
    return f"{name} [{_WRITTEN[quantity][0]}]"


def _cell(quantity: Quantity, value: float) -> str:
    """Return the text of a number in SI units, in the unit of its column; 0 has no minus."""
    return f"{_WRITTEN[quantity][1] * value + 0.0:.{_DIGITS}f}"


def _joint_cells(robot: Robot, q: Array) -> dict[str, str]:
    """Return the texts in deg or mm of joint values (m,) [rad] or [m], by the headers of their columns.

    Values and columns are in the order of ``robot.joint_names``.
    """
    cells = {}
    for (name, joint_type), value in zip(robot.joint_types.items(), q, strict=True):
        quantity: Quantity = "length" if joint_type == "prismatic" else "angle"
        cells[_header(name, quantity)] = _cell(quantity, value)
    return cells


# Poses of a table


class Poses(NamedTuple):
    """Poses of a table."""

    #: Shape (N, m), [rad] or [m].
    joints: Array
    #: ``"estimate"`` or ``"validate"`` for each.
    sets: tuple[str, ...]
    #: Largest number of a row of the table.
    last_row: int
    #: Largest number in the name of an image; 0 without images.
    last_image: int
    #: Shape (N, m), last move of each joint before each pose [rad] or [m]; None: from the pose before in ``joints``.
    moves: Array | None
    #: Station and target of each row at each pose.
    sights: tuple[frozenset[Sight], ...] = ()


def read_poses(
    path: str | Path, robot: Robot, columns: ColumnsInput = None, *, taken: bool = False
) -> Poses:
    """Read the poses of a table in which measurements may be missing; several targets at one pose are one pose.

    Poses that are only driven through are left out; the moves know them.

    Args:
        path: Path of the table.
        robot: The robot, whose m measured joints have a column each in the table.
        columns: Names and units of the columns, as by ``--columns``; None: as they are.
        taken: Whether only poses that a fit would estimate from are read, measured and of the set ``estimate``; of a
            table in which nothing is measured, such as a plan that is still to be driven or one with a list of points,
            all poses of that set, in rows with a name in the column ``point`` if there is one.

    Returns:
        The poses in the order in which the table says they are measured, columns as ``robot.joint_names``.

    Raises:
        MeasurementError: The table cannot be read as one of this robot, or no row is left.
    """
    table, _ = split_references(Table.read(path), columns, robot.joint_names)
    # A row of the kind ``fixed`` has its joint values alone.
    layout = Layout.find(table, robot.joint_names, robot.joint_types, columns, "fixed")
    values = read_values(table, layout, as_measured=True, needs_all_joints=not robot.branches)
    rows = Measurements(**values)
    named, _ = name_columns(table, robot.joint_names, {})
    numbers = [*range(1, len(table.cells) + 1)]
    if "row" in named:
        numbers = [int(number or 0) for number in table.column(named["row"])]
    chosen = np.ones(len(rows), dtype=np.bool_)
    if taken:
        with_value = set(compress(numbers, _measure_something(table, named)))
        measured = np.array([number in with_value for number in rows.rows], dtype=np.bool_)
        chosen = rows.estimation & (measured | (not measured.any()))
        if not chosen.any():
            raise MeasurementError(f"{table.source}: no row that is measured is 'estimate'.")
    # Rows with the same joint values are one pose if their targets differ, or of several chains their stations; if a
    # target occurs again, the pose is repeated, which counts as another one.
    repeats: Counter[tuple[bytes, str, str]] = Counter()
    rows_of_poses: dict[tuple[bytes, int], list[int]] = {}
    for i in np.flatnonzero(chosen).tolist():
        pose, target = rows.joints[i].tobytes(), rows.targets[i]
        key = pose, target, rows.groups[i] if robot.branches else ""
        rows_of_poses.setdefault((pose, repeats[key]), []).append(i)
        repeats[key] += 1
    first = [of_pose[0] for of_pose in rows_of_poses.values()]
    names = table.column(named["image"]) if "image" in named else []
    of_images = [_NUMBER.findall(Path(name).stem) for name in names]
    joints, moves = rows.joints[first], rows.moves_for(robot.joint_names)[first]
    is_as_before = np.allclose(moves, last_moves(joints), rtol=0.0, atol=SAME_POSE)
    return Poses(
        joints=read_only(joints),
        sets=tuple(rows.sets[i] for i in first),
        last_row=max(numbers),
        last_image=max((int(digits[-1]) for digits in of_images if digits), default=0),
        moves=None if is_as_before else read_only(moves),
        sights=tuple(
            frozenset((rows.groups[i], rows.targets[i]) for i in of_pose)
            for of_pose in rows_of_poses.values()
        ),
    )


def _measure_something(table: Table, named: Mapping[str, Column]) -> list[bool]:
    """Mark the rows that measure something: by a cell, by a kind that needs none, or as a named point of a list.

    Names count only if no cell holds a measurement: a plan that is being filled in names all of its points.
    """
    columns = [*POINT, "distance", "pair", "u"]
    indices = [named[name].index for name in columns if name in named]
    kinds = table.column(named["kind"]) if "kind" in named else [""] * len(table.cells)
    contacts = [name for name in registry.names() if registry.get(name).is_contact]
    measure = [
        kind in contacts or any(cells[i] for i in indices)
        for kind, cells in zip(kinds, table.cells, strict=True)
    ]
    if not any(measure) and "point" in named:
        measure = [name != "" for name in table.column(named["point"])]
    return measure


@singledispatch
def next_number(_instrument: Instrument, poses: Poses) -> int:
    """Return the number of the first row, or image, of a plan that adds to the poses of a table."""
    return max(poses.last_row, 0) + 1


@next_number.register
def _(_instrument: CameraInstrument, poses: Poses) -> int:
    """Return one more than the largest number in the names of the images."""
    return poses.last_image + 1


# The JSON file


def plan_table(plan: Plan) -> dict[str, Any]:
    """Return a plan with its forecasts as nested tables for a JSON file, in SI units; see docs/planning.md."""
    robot, request = plan.robot, plan.request
    joints = []
    for name, joint_type in robot.joint_types.items():
        joints.append({"name": name, "unit": "m" if joint_type == "prismatic" else "rad"})
    poses = []
    for k, (set_name, q) in enumerate(zip(plan.sets, plan.joints, strict=True)):
        expected = plan.expected[k]
        poses.append(
            {"set": set_name, "joints": q, "expected_xyz_m": expected, "seen": plan.seen[k]}
        )
    if plan.via is not None:
        for pose, via in zip(poses, plan.via, strict=True):
            pose["via"] = via
    for name, values in _further_keys(plan.instrument, plan).items():
        for pose, value in zip(poses, values, strict=True):
            pose[name] = value
    blocked = [{"from": move.start, "to": move.end, "by": move.by} for move in plan.blocked]
    return {
        "schema": SCHEMA,
        "calib": __version__,
        "robot": {
            "name": robot.name,
            "urdf": robot.urdf.source,
            "urdf_sha256": robot.urdf.sha256,
            "base": robot.base,
            "tip": robot.tip,
            "chains": [{"base": chain.base, "tip": chain.tip} for chain in robot.chains],
            "joints": joints,
            "coupling": coupling_table(robot.reading_coupling),
        },
        "asked": {
            "criterion": request.criterion,
            "approach": request.approach,
            "model": plan.model,
            "kind": plan.kind,
            "targets": plan.targets,
            "sights": [{"group": group, "target": target} for group, target in plan.sights],
            "seed": request.seed,
            "taken": len(plan.taken),
        },
        "poses": poses,
        "candidates": {"drawn": plan.drawn, "kept": plan.candidates, "refused": dict(plan.refused)},
        "forecast": forecast_table(plan.forecast),
        "before": None if plan.before is None else forecast_table(plan.before),
        "at_random": forecast_table(plan.at_random),
        "ladder": [{"planned": n, **forecast_table(forecast)} for n, forecast in plan.ladder],
        "travel": {"largest_joint_moves": plan.travel, "blocked": blocked},
        "notes": [note._asdict() for note in plan.notes],
    }


@singledispatch
def _further_keys(_instrument: Instrument, _plan: Plan) -> dict[str, Any]:
    """Return what an instrument adds to each pose of the file: by key, one value for each pose."""
    return {}


@_further_keys.register
def _(_instrument: CameraInstrument, plan: Plan) -> dict[str, Any]:
    """Return the tilts of the board, or of each of several."""
    _, tilts = _of_all_boards(plan)
    return {"tilt_rad": (tilts if len(plan.sights) > 1 else tilts[:, 0]).tolist()}


def forecast_table(forecast: Forecast) -> dict[str, Any]:
    """Return a forecast as nested tables for a JSON file, in SI units; docs/planning.md describes the keys."""
    counts = ("poses", "rank", "workspace_rank", "columns")
    lengths = ("rms", "rms_low", "rms_high", "max")
    parameters = zip(
        forecast.names,
        forecast.units,
        forecast.parameter_std,
        forecast.identifiable,
        strict=True,
    )
    keys = ("name", "unit", "std", "identifiable")
    return {
        **{name: getattr(forecast, name) for name in counts},
        **{f"{name}_m": getattr(forecast, name) for name in lengths},
        "sigma": dict(forecast.sigma),
        "indices": dict(forecast.indices),
        "parameters": [dict(zip(keys, row, strict=True)) for row in parameters],
    }
