"""What verbs begin with: cell, robot and table of a call, and whether its outputs can be written."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from calib.cli.terminal import fill, row_ranges
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
    from calib.identify.result import Calibration
    from calib.measure.cell import Cell
    from calib.measure.measurements import Measurements
    from calib.model.robot import Robot


def read_cell(
    cell: Path | None,
    *,
    base: str | None = None,
    tip: str | None = None,
    target: str | None = None,
    frame: str | None = None,
    model: str | None = None,
    kind: str | None = None,
    hold: Iterable[str] | None = None,
    payload: str | None = None,
    fix_target: bool = False,
    freeze: Iterable[str] | None = None,
    priors: str | None = None,
    repeats: str | None = None,
) -> Cell:
    """The cell file, if there is one, with what the command line says on top of it.

    The arguments are options as they are written; ``asdict`` of `calib.cli.options.CellOptions` has them.
    """
    from calib.measure.cell import Cell

    found = Cell() if cell is None else Cell.read(cell)
    said: dict[str, Any] = {
        "base": base,
        "tip": tip,
        "model": model,
        "kind": kind,
        "repeats": repeats,
    }
    if target is not None:
        said["target"] = parse_point(target, "--target")
    if frame is not None:
        said["estimate_frame"], said["frame_directions"] = parse_frame(frame)
    if hold:
        said["held"] = {**found.held, **parse_held(hold)}
    if payload is not None:
        said["payload"] = parse_payload(payload, found.payload)
    if fix_target:
        said["estimate_target"] = False
    if freeze:
        said["frozen"] = (*found.frozen, *freeze)
    if priors is not None:
        said["priors"] = found.priors.with_sizes(priors)
    found = replace(found, **{name: value for name, value in said.items() if value is not None})
    check_model(found.model, "--model" if model is not None else str(cell))
    return found


def load(robot: str, cell: Cell) -> Robot:
    """The robot's chain between the cell's base and tip, with the joints that the cell holds."""
    from calib.model.robot import Robot

    return Robot.load(robot, cell.base, cell.tip, held=cell.held)


def load_with_data(
    robot: str,
    cell: Cell,
    data: Path,
    columns: Iterable[str] | None = None,
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
        raise CalibError(
            "--points-unit is the unit of a list of points; name the list with --points."
        )
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
            raise FileError(
                f"{path} is also {taken[resolved]} of this command; choose another name."
            )
        taken[resolved] = "another output"
        check_no_xacro(path)
        if os.path.isdir(path):  # noqa: PTH112  a name that is too long is no error here
            raise FileError(f"{path} is a folder; name a file inside it.")
        if os.path.exists(path) and not force:  # noqa: PTH110
            raise FileError(f"{path} exists already; add --force or choose another name.")
        if not path.parent.is_dir():
            home = " Here '~' does not stand for your home folder; write it out." * (
                path.parts[0].startswith("~")
            )
            raise FileError(
                f"{path}: the folder '{path.parent}' does not exist; make it first.{home}"
            )
        check_writable(path)


def check_chain(cell: Cell, result: Calibration, name: str) -> None:
    """Refuse another base or tip than the result's: its frame and its target would mean something else.

    Args:
        cell: What was asked for.
        result: The result.
        name: Name of its file.

    Raises:
        CalibError: They differ.
    """
    own = result.nominal
    for option, given, wanted in (("base", cell.base, own.base), ("tip", cell.tip, own.tip)):
        if given is not None and given != wanted:
            raise CalibError(
                f"{name} is the result for --{option} {wanted}, and '{given}' was given; leave out --{option}, or "
                f"--calibration."
            )


def with_target_link(robot: Robot, cell: Cell) -> Cell:
    """The cell with the target that the URDF's link ``calib_target`` carries, if it has one at this tip.

    Args:
        robot: The robot.
        cell: The set-up.
    """
    from calib.identify.result_urdf import TARGET_LINK

    if robot.tip == TARGET_LINK:
        return cell.with_target((0.0, 0.0, 0.0), estimate=cell.estimate_target)
    if TARGET_LINK not in robot.urdf.links:
        return cell
    with_link = robot.rebuilt(tip=TARGET_LINK)
    if with_link.joint_names != robot.joint_names:
        return cell
    T_last_target, T_last_tip = with_link.placements[-1], robot.placements[-1]
    point = T_last_tip[:3, :3].T @ (T_last_target[:3, 3] - T_last_tip[:3, 3])
    return cell.with_target(point, estimate=cell.estimate_target)


def say_ignored(measurements: Measurements, robot: Robot) -> None:
    """Name the rows and columns that were not used; a joint among these hints at a wrong base or tip."""
    from calib.units import split_header

    if measurements.unmeasured:
        left_out, many = measurements.unmeasured, len(measurements.unmeasured) > 1
        text = (
            f"{len(left_out)} of {len(measurements) + len(left_out)} rows {'are' if many else 'is'} not measured, and "
            f"{'are' if many else 'is'} left out: {'rows' if many else 'row'} {row_ranges(left_out)}."
        )
        typer.echo(fill(text) + "\n")
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
    typer.echo(fill(text) + "\n")
