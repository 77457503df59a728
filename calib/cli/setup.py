"""What the verbs begin with: cell, robot and table of a call, and whether its outputs can be written."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from calib.cli.words import (
    check_model,
    parse_columns,
    parse_frame,
    parse_held,
    parse_payload,
    parse_point,
)
from calib.errors import CalibError, FileError, choices

if TYPE_CHECKING:
    from calib.measure.cell import Cell
    from calib.measure.measurements import Measurements
    from calib.model.robot import Robot


def read_cell(
    path: Path | None,
    *,
    base: str | None = None,
    tip: str | None = None,
    target: str | None = None,
    frame: str | None = None,
    model: str | None = None,
    kind: str | None = None,
    hold: Iterable[str] | None = None,
    payload: str | None = None,
) -> Cell:
    """The cell file, if there is one, with what the command line says on top of it."""
    from calib.measure.cell import Cell

    cell = Cell() if path is None else Cell.read(path)
    said: dict[str, Any] = {"base": base, "tip": tip, "model": model, "kind": kind}
    if target is not None:
        said["target"] = parse_point(target, "--target")
    if frame is not None:
        said["estimate_frame"], said["frame_directions"] = parse_frame(frame)
    if hold:
        said["held"] = {**cell.held, **parse_held(hold)}
    if payload is not None:
        said["payload"] = parse_payload(payload, cell.payload)
    cell = replace(cell, **{name: value for name, value in said.items() if value is not None})
    check_model(cell.model, "--model" if model is not None else str(path))
    return cell


def load(robot: str, cell: Cell) -> Robot:
    """The robot's chain between the cell's base and tip, with the joints that the cell holds."""
    from calib.model.robot import Robot

    return Robot.load(robot, cell.base, cell.tip, held=cell.held)


def load_with_data(
    robot: str,
    cell: Cell,
    data: Path,
    columns: Iterable[str] | None,
    points: Path | None = None,
    points_unit: str | None = None,
) -> tuple[Robot, Measurements]:
    """The robot, and the table with its joint columns matched to the chain's joints.

    A tip that was not named is the end of the longest chain whose joints all have a column.

    Raises:
        CalibError: A file cannot be read or does not fit the other; or a unit of points that there are not.
    """
    from calib.measure.measurements import Measurements
    from calib.measure.table import Table
    from calib.model.robot import Robot
    from calib.units import split_header

    if points_unit is not None and points is None:
        message = "--points-unit is the unit of a list of points; name the list with --points."
        raise CalibError(message)
    renamed = parse_columns(columns or [])
    read = Table.read(data)
    names = {split_header(label)[0] for label in read.header}
    names |= {split_header(wanted)[0] for wanted in renamed.values()}
    arm = Robot.load(robot, cell.base, cell.tip, measured=names, held=cell.held)
    table = Measurements.read(
        read,
        joint_names=arm.joint_names,
        joint_types=arm.joint_types,
        columns=renamed,
        kind=cell.kind,
        points=points,
        points_unit=points_unit,
    )
    return arm, table


def check_outputs(
    outputs: Iterable[Path | None], inputs: Iterable[str | Path], *, force: bool
) -> None:
    """Refuse outputs before the work rather than after it: existing files, missing folders, the inputs, one twice.

    Raises:
        FileError: An output cannot be written.
    """
    from calib.model.files import check_no_xacro, check_writable

    wanted = [path for path in outputs if path is not None]
    taken = {Path(os.path.realpath(path)): "an input" for path in inputs}
    for path in wanted:
        resolved = Path(os.path.realpath(path))
        if resolved in taken:
            message = f"{path} is also {taken[resolved]} of this command; choose another name."
            raise FileError(message)
        taken[resolved] = "another output"
        check_no_xacro(path)
        if os.path.isdir(path):  # noqa: PTH112  a name that is too long is no error here
            message = f"{path} is a folder; name a file inside it."
            raise FileError(message)
        if os.path.exists(path) and not force:  # noqa: PTH110
            message = f"{path} exists already; add --force or choose another name."
            raise FileError(message)
        if not path.parent.is_dir():
            home = " Here '~' does not stand for your home folder; write it out." * (
                path.parts[0].startswith("~")
            )
            message = f"{path}: the folder '{path.parent}' does not exist; make it first.{home}"
            raise FileError(message)
        check_writable(path)


def row_ranges(rows: Iterable[int], limit: int = 12) -> str:
    """Row numbers in words, runs of them as one: ``4, 7 to 9``; at most ``limit`` of these, then how many rows more."""
    runs: list[list[int]] = []
    for row in sorted(rows):
        if runs and row == runs[-1][1] + 1:
            runs[-1][1] = row
        else:
            runs.append([row, row])
    said = [
        str(a) if a == b else f"{a}{', ' if b == a + 1 else ' to '}{b}" for a, b in runs[:limit]
    ]
    rest = sum(b - a + 1 for a, b in runs[limit:])
    return ", ".join(said) + (f" and {rest} more" if rest else "")


def say_ignored(measurements: Measurements, robot: Robot) -> None:
    """Name the rows and columns that were not used; a joint among these hints at a wrong base or tip."""
    from calib.units import split_header

    if measurements.unmeasured:
        left_out, many = measurements.unmeasured, len(measurements.unmeasured) > 1
        text = (
            f"{len(left_out)} of {len(measurements) + len(left_out)} rows {'are' if many else 'is'} not measured, and "
            f"{'are' if many else 'is'} left out: {'rows' if many else 'row'} {row_ranges(left_out)}."
        )
        typer.echo(textwrap.fill(text, 100) + "\n")
    if not measurements.ignored:
        return
    text = f"Columns not used: {choices(measurements.ignored)}."
    moving = {joint.name for joint in robot.urdf.joints if joint.type != "fixed"}
    names = [split_header(label)[0] for label in measurements.ignored]
    # A held joint and one that follows another have columns that are not needed: nothing is wrong with the chain.
    known = {*robot.held, *(joint.name for joint in robot.joints)}
    outside = [name for name in names if name in moving - known]
    if outside:
        text += (
            f" Of the robot's joints, {choices(outside)} "
            f"{'is' if len(outside) == 1 else 'are'} not between '{robot.base}' and '{robot.tip}' "
            "(--base, --tip)."
        )
    typer.echo(textwrap.fill(text, 100, break_on_hyphens=False, break_long_words=False) + "\n")
