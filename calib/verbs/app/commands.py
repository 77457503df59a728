"""The commands of a job, as they are typed, and the cell file that they read: what the page chose, in calib's words."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from calib.basics.units import LENGTH, parse_amount, parse_point
from calib.data.cell import AUTO
from calib.result.calibration import Calibration
from calib.verbs.app.column_guesses import column_words
from calib.verbs.app.fields import Looked
from calib.verbs.app.guesses import is_typed
from calib.verbs.app.job import (
    CELL,
    CHECKED,
    CORNERS,
    CORRECTED,
    PICTURES,
    POSES,
    REPORT,
    RESULT,
    VIEW,
    Command,
    Job,
)

#: A length as it is typed: a number, with a decimal point or comma, and perhaps its unit.
_TYPED = re.compile(r"(\d+(?:[.,]\d*)?|[.,]\d+)\s*([A-Za-zµμ]*)")


def cell_text(looked: Looked) -> str:
    """Return the cell file of a calibration, TOML; empty if nothing has to be said.

    Raises:
        CalibError: The position of the target or the noise is not of its form.
    """
    lines = [*_cell_lines(looked)]
    serial = looked.value("serial")
    if serial:
        lines += ["", "[record]", f"robot_serial = {_quoted(serial)}"]
    return "\n".join([*lines, ""]).lstrip() if lines else ""


def _cell_lines(looked: Looked) -> Iterator[str]:
    """Yield the lines of the cell file before its tables."""
    for key in ("base", "tip", "kind", "frame", "instrument"):
        if value := looked.value(key):
            yield f"{key} = {_quoted(value)}"
    if target := looked.value("target"):
        numbers = (1e3 * float(value) for value in parse_point(target, "target"))
        yield f"target_mm = [{', '.join(f'{number:.9g}' for number in numbers)}]"
        yield 'target = "estimate"'
    if noise := looked.value("noise"):
        size = parse_length(noise, "noise", "0.03 mm")
        yield f"sigma_mm = {1e3 * size:.9g}"
    model = looked.value("model")
    if model not in ("", AUTO):
        yield f"model = {_quoted(model)}"


def parse_length(text: str, option: str, example: str) -> float:
    """Return a length as people type it [m]; CalibError for anything else.

    Args:
        text: Such as ``"0.2 mm"``; the comma may be a decimal one, and a bare number is of millimetres.
        option: Name of its field, for messages.
        example: A text that would be right, for messages.
    """
    match = _TYPED.fullmatch(text.strip())
    if match is not None:
        text = f"{match[1].replace(',', '.')} {match[2] or 'mm'}"
    return parse_amount(text, option, LENGTH, example)


def _quoted(text: str) -> str:
    """Return a text as a string of TOML."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def calibration_commands(job: Job, looked: Looked) -> tuple[Command, ...]:
    """Return the commands that calibrate the robot of a job; with pictures, first that which finds the corners.

    Args:
        job: The job.
        looked: Its files, and how they are read.
    """
    robot = looked.value("robot_name") or looked.value("robot")
    if not is_typed(job, robot) and looked.value("xacro"):
        robot += f" {looked.value('xacro')}"
    table = looked.value("table")
    commands: list[Command] = []
    if looked.pictures:
        detect = ("detect", PICTURES, "--board", looked.value("board"), "--joints", table)
        commands.append((*detect, "-o", CORNERS))
        table = CORNERS
    words = ["calibrate", robot, table, *_reading_words(looked)]
    for name in ("camera", "board"):
        if value := looked.value(name):
            words += [f"--{name}", value]
    if looked.value("cell"):
        words += ["--cell", looked.value("cell"), *_cell_options(looked)]
    elif cell_text(looked):
        words += ["--cell", CELL]
    return (*commands, (*words, *_output_words()))


def session_commands(
    job: Job, robot: str, arguments: str, table: str, cell: str
) -> tuple[Command, ...]:
    """Return the command that calibrates by the files of a session.

    Args:
        job: The job of the calibration.
        robot: The robot's file in the job, or its name.
        arguments: Arguments of a xacro; empty without.
        table: The stops that count.
        cell: The session's cell.
    """
    if not is_typed(job, robot) and arguments:
        robot += f" {arguments}"
    return (("calibrate", robot, table, "--cell", cell, *_output_words()),)


def _output_words() -> Iterator[str]:
    """Yield the options that name what a calibration writes."""
    yield from ("-o", CORRECTED, "--json", RESULT)
    if find_spec("matplotlib") is not None:
        yield from ("--report", REPORT)
    yield from ("--view", VIEW)


def _reading_words(looked: Looked) -> Iterator[str]:
    """Yield the options that say how the table is read."""
    for name in ("points", "points_unit", "joint_unit"):
        if value := looked.value(name):
            yield from (f"--{name.replace('_', '-')}", value)
    if brand := looked.value("brand"):
        yield from ("--columns", brand)
    for word in column_words(looked, looked.header):
        yield from ("--columns", word)


def _cell_options(looked: Looked) -> Iterator[str]:
    """Yield what was chosen beside a cell file that was sent, which says the rest."""
    for name in ("base", "tip", "kind", "frame", "instrument", "target", "model"):
        one = looked.fields.get(name)
        if one is not None and one.value and one.is_chosen:
            yield from (f"--{name}", one.value)


def check_commands(
    job: Job, result: Path, called: Calibration, table: str, points: str, tolerance: str
) -> tuple[Command, ...]:
    """Return the command that checks a result by fresh rows, which are read as those of the result were.

    Args:
        job: The job.
        result: File of the result.
        called: The result, which knows how its table was read.
        table: The fresh rows, or the folder of pictures, in the job's folder.
        points: The list of their points; empty: the table has them.
        tolerance: Change of positions that does not matter, with its unit; empty: the default.
    """
    words = ["check", _relative(job, result), table]
    call = called.method.call
    if call is not None:
        for column in call.columns:
            words += ["--columns", column]
        for option, value in (
            ("--orientation", call.orientation),
            ("--joint-unit", call.joint_unit),
        ):
            words += [option, value] if value else []
    if points:
        words += ["--points", points]
        if call is not None and call.points_unit:
            words += ["--points-unit", call.points_unit]
    if tolerance:
        words += ["--tolerance", tolerance]
    return ((*words, "--json", CHECKED, "-o", POSES),)


def poses_commands(job: Job, result: Path, count: int) -> tuple[Command, ...]:
    """Return the command that chooses poses to check at.

    Args:
        job: The job.
        result: File of the result.
        count: Number of poses.
    """
    return (("check", _relative(job, result), "--plan", str(count), "-o", POSES),)


def _relative(job: Job, path: Path) -> str:
    """Return the name of a file as it is typed in the folder of a job."""
    return Path(os.path.relpath(path, job.folder)).as_posix()
