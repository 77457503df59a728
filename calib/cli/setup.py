"""From the words of a command line to robots, measurements and cells."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from calib.cli.options import Knowledge, Model
from calib.errors import CalibError, FileError, choices

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from calib.measure.cell import Cell
    from calib.measure.measurements import Measurements
    from calib.model.robot import Robot


def read_cell(
    path: Path | None,
    *,
    base: str | None,
    tip: str | None,
    target: str | None,
    frame: Knowledge | None,
    model: Model | None,
) -> Cell:
    """The cell file, if there is one, with what the command line says on top of it."""
    from calib.measure.cell import Cell

    cell = Cell() if path is None else Cell.read(path)
    if base is not None:
        cell = replace(cell, base=base)
    if tip is not None:
        cell = replace(cell, tip=tip)
    if target is not None:
        cell = replace(cell, target=parse_point(target, "--target"))
    if frame is not None:
        cell = replace(cell, estimate_frame=frame is Knowledge.estimate)
    if model is not None:
        cell = replace(cell, model=model.value)
    return cell


def load(robot: str, cell: Cell) -> Robot:
    """The robot's chain between the cell's base and tip."""
    from calib.model.robot import Robot

    return Robot.load(robot, cell.base, cell.tip)


def load_with_data(
    robot: str, cell: Cell, data: Path, columns: Iterable[str] | None
) -> tuple[Robot, Measurements]:
    """The robot, and the table with its joint columns matched to the chain's joints.

    A tip that was not named is the end of the longest chain whose joints all have a column.
    """
    from calib.measure.measurements import Measurements
    from calib.measure.table import Table
    from calib.model.robot import Robot
    from calib.units import split_header

    renamed = parse_columns(columns or [])
    names = {split_header(label)[0] for label in Table.read(data).header}
    names |= {split_header(wanted)[0] for wanted in renamed.values()}
    arm = Robot.load(robot, cell.base, cell.tip, measured=names)
    table = Measurements.read(
        data, joint_names=arm.joint_names, joint_types=arm.joint_types, columns=renamed
    )
    return arm, table


def parse_point(text: str, option: str) -> NDArray[np.float64]:
    """Three numbers and a unit of length, such as ``70 -70 22.5 mm``, in metres.

    Raises:
        CalibError: Anything else.
    """
    from calib.model.robot import read_only
    from calib.units import UNITS, symbols

    # "22.5mm" is as clear as "22.5 mm".
    words = re.sub(r"(?<=[\d.])(?=[a-z]+\s*$)", " ", text.replace(",", " ")).split()
    try:
        numbers = [float(word) for word in words[:3]]
    except ValueError:
        numbers = []
    if len(words) != 4 or len(numbers) != 3 or not all(map(math.isfinite, numbers)):
        message = f'{option} was given as "{text}"; it must be three numbers and a unit, such as "70 -70 22.5 mm".'
        raise CalibError(message)
    if words[3] not in symbols("length"):
        message = (
            f"{option} was given as \"{text}\"; '{words[3]}' is no unit of length. Choose one of "
            f"{choices(symbols('length'))}."
        )
        raise CalibError(message)
    return read_only([UNITS[words[3]].to_si * number for number in numbers])


def parse_columns(pairs: Iterable[str]) -> dict[str, str]:
    """``--columns`` as a mapping from the table's names to calib's.

    Raises:
        CalibError: A pair without an equals sign, or a name twice.
    """
    mapping: dict[str, str] = {}
    for pair in pairs:
        name, equals, wanted = (part.strip() for part in pair.partition("="))
        if not (name and equals and wanted) or name in mapping:
            message = (
                f"--columns was given '{pair}'; it must be 'name in the table=name in the URDF', with a unit in "
                "brackets behind it if the table has none, and each name once."
            )
            raise CalibError(message)
        mapping[name] = wanted
    return mapping


def check_outputs(
    outputs: Iterable[Path | None], inputs: Iterable[str | Path], *, force: bool
) -> None:
    """Refuse outputs before the work rather than after it: existing files, missing folders, the inputs, one twice.

    Raises:
        FileError: An output cannot be written.
    """
    wanted = [path for path in outputs if path is not None]
    taken = {Path(path).resolve(): "an input" for path in inputs}
    for path in wanted:
        resolved = path.resolve()
        if resolved in taken:
            message = f"{path} is also {taken[resolved]} of this command; choose another name."
            raise FileError(message)
        taken[resolved] = "another output"
        if path.is_dir():
            message = f"{path} is a folder; name a file inside it."
            raise FileError(message)
        if path.exists() and not force:
            message = f"{path} exists already; add --force or choose another name."
            raise FileError(message)
        if not path.parent.is_dir():
            home = " Here '~' does not stand for your home folder; write it out." * (
                path.parts[0].startswith("~")
            )
            message = f"{path}: the folder '{path.parent}' does not exist; make it first.{home}"
            raise FileError(message)


def say_ignored(measurements: Measurements, robot: Robot) -> None:
    """Name the columns of the table that were not used; a joint among them hints at a wrong base or tip."""
    from calib.units import split_header

    if not measurements.ignored:
        return
    text = f"Columns not used: {choices(measurements.ignored)}."
    moving = {joint.name for joint in robot.urdf.joints if joint.type != "fixed"}
    names = [split_header(label)[0] for label in measurements.ignored]
    outside = [name for name in names if name in moving]
    if outside:
        text += (
            f" Of the robot's joints, {choices(outside)} "
            f"{'is' if len(outside) == 1 else 'are'} not between '{robot.base}' and '{robot.tip}' "
            "(--base, --tip)."
        )
    typer.echo(textwrap.fill(text, 100, break_on_hyphens=False, break_long_words=False) + "\n")
