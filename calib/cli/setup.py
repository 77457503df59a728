"""From the words of a command line to a cell, a robot and a table; where its jobs run and what it may write."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from calib.errors import CalibError, FileError, choices
from calib.text.lines import fill, row_ranges

if TYPE_CHECKING:
    from concurrent.futures import Executor

    import numpy as np
    from numpy.typing import NDArray

    from calib.data.cell import Cell
    from calib.data.measurements import Measurements
    from calib.data.surroundings import Tracker
    from calib.result.calibration import Calibration
    from calib.robot.robot import Payload, Robot

#: The model that lets the data choose; it takes no families, for it tries them all.
AUTO = "auto"


#: Numbers, and the unit that stands behind them: ``70 -70 22.5 mm``.
_GROUP = re.compile(
    r"((?:[-+]?[\d.]+(?:e[-+]?\d+)?[\s,]*)+?)([A-Za-z\u00b5\u03bc]+)[\s,]*", re.IGNORECASE
)

#: Units of mass, of which the command line alone has one.
_MASSES = {"kg": 1.0, "g": 1e-3}


def parse_amounts(
    text: str, option: str, wanted: Mapping[str, int], example: str, *, signed: bool = True
) -> dict[str, list[float]]:
    """Numbers with units, such as ``10 mm 2 deg``, in SI units by what they are, ``a length``; 0 alone needs no unit.

    Args:
        text: As it was written.
        option: To which it was given.
        wanted: What may be there, once each, and of how many numbers it is.
        example: Of how to write it.
        signed: Whether numbers may be below 0.

    Raises:
        CalibError: Anything else.
    """
    if text.strip() == "0":
        return {kind: [0.0] * count for kind, count in wanted.items()}
    found: dict[str, list[float]] = {}
    good = not _GROUP.sub("", text).strip()
    for numbers, symbol in _GROUP.findall(text) if good else ():
        values, kind = _si_values(numbers, symbol)
        good &= wanted.get(kind) == len(values) and kind not in found
        good &= all(math.isfinite(v) and (signed or v >= 0.0) for v in values)
        found[kind] = values
    if not good or not found:
        one = [
            kind if n == 1 else f"{n} numbers and a unit of {kind.split()[1]}"
            for kind, n in wanted.items()
        ]
        raise CalibError(
            f'{option} was given as "{text}"; it must be {" or ".join(one)}{", not below 0" * (not signed)}, such as '
            f'"{example}".'
        )
    return found


def _si_values(numbers: str, symbol: str) -> tuple[list[float], str]:
    """Numbers in a unit as SI values, and what they are; nothing for what are no numbers, or no unit."""
    from calib.units import UNITS

    unit = UNITS.get("um" if symbol in ("\u00b5m", "\u03bcm") else symbol)
    kind, factor = "a mass", _MASSES.get(symbol)
    if unit is not None:
        kind, factor = f"a{'n' * (unit.quantity == 'angle')} {unit.quantity}", unit.to_si
    try:
        return [
            (factor or math.nan) * float(word) for word in numbers.replace(",", " ").split()
        ], kind
    except ValueError:
        return [], kind


def parse_point(text: str, option: str, example: str = "70 -70 22.5 mm") -> NDArray[np.float64]:
    """Three numbers and a unit of length, such as ``70 -70 22.5 mm``, as a point [m], shape (3,)."""
    from calib.robot.robot import read_only

    (point,) = parse_amounts(text, option, {"a length": 3}, example).values()
    return read_only(point)


def parse_tracker(text: str | None, given: Tracker | None) -> Tracker | None:
    """``--tracker``: a position in the robot's base, such as ``2500 0 500 mm``; the rest is the given one's."""
    from calib.data.surroundings import Tracker

    if text is None:
        return given
    position = parse_point(text, "--tracker")
    return Tracker(position) if given is None else replace(given, position=position)


def parse_frame(text: str) -> tuple[bool, tuple[str, ...]]:
    """``--frame``: whether the measurement frame is estimated, and which of its directions are.

    Raises:
        CalibError: Neither ``known`` nor ``estimate`` nor a list of directions such as ``x,y,rz``.
    """
    from calib.data.kinds import DIRECTIONS

    if text in ("known", "estimate"):
        return text == "estimate", DIRECTIONS
    words = tuple(text.replace(",", " ").split())
    if not words or not set(words) <= set(DIRECTIONS) or len(set(words)) < len(words):
        raise CalibError(
            f"--frame was given as \"{text}\"; it must be 'known', 'estimate' or a list of what is estimated of the "
            f'frame, such as "x,y,rz", each once of {choices(DIRECTIONS)}.'
        )
    return True, words


def parse_pair(text: str, option: str, example: str) -> tuple[float | None, float | None]:
    """A length [m], an angle [rad], or both, ``10 mm 2 deg``; None for what is not named."""
    found = parse_amounts(text, option, {"a length": 1, "an angle": 1}, example, signed=False)
    return found.get("a length", [None])[0], found.get("an angle", [None])[0]


def parse_amount(
    text: str, option: str, wanted: str, example: str, *, signed: bool = False
) -> float:
    """A number with its unit, such as ``0.5 mm``, of what is wanted, ``a length``, in SI units."""
    return parse_amounts(text, option, {wanted: 1}, example, signed=signed)[wanted][0]


def check_model(text: str, source: str) -> None:
    """Refuse a model, such as ``dh+gain``, that does not exist; ``source`` is where it was given.

    Raises:
        CalibError: No such set or family, or a family twice.
    """
    from calib.model.error_model import split_name

    if text == AUTO:
        return
    try:
        split_name(text)
    except CalibError as error:
        raise CalibError(f"{source}: {error} '{AUTO}' lets the data choose.") from error


def parse_payload(text: str, given: Payload | None) -> Payload:
    """``--payload``: a mass such as ``5 kg``; its centre is that of the payload already given, or the tip."""
    from calib.robot.robot import Payload as PayloadClass

    mass = parse_amount(text, "--payload", "a mass", "5 kg")
    return PayloadClass(mass) if given is None else replace(given, mass=mass)


def _pairs(pairs: Iterable[str], option: str, wanted: str) -> dict[str, str]:
    """Texts ``name=value`` as a mapping; a name may hold an equals sign, a value may not."""
    mapping: dict[str, str] = {}
    for pair in pairs:
        # rpartition leaves all of a text without an equals sign in the last part.
        name, _, value = (part.strip() for part in pair.rpartition("="))
        if not (name and value) or name in mapping:
            raise CalibError(f"{option} was given '{pair}'; it must be {wanted}.")
        mapping[name] = value
    return mapping


def parse_held(pairs: Iterable[str], option: str = "--hold") -> dict[str, float]:
    """``--hold``, or another option of its form, as the values of joints by name [rad or m].

    Raises:
        CalibError: A pair without an equals sign, a name twice, or a value without a unit.
    """
    from calib.units import parse_joint_value

    wanted = "'joint=value' with a unit of angle or length, such as 'torso_lift_joint=0.3 m', and each joint once"
    found = _pairs(pairs, option, wanted)
    return {name: parse_joint_value(v, f"{option} '{name}={v}'") for name, v in found.items()}


def parse_columns(pairs: Iterable[str]) -> dict[str, str]:
    """``--columns`` as a mapping from the table's names to calib's.

    Raises:
        CalibError: A pair without an equals sign, or a name twice.
    """
    wanted = (
        "'name in the table=name in the URDF', with a unit in brackets behind it if the table has none, and each name "
        "once"
    )
    return _pairs(pairs, "--columns", wanted)


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
    from calib.data.cell import Cell

    found = Cell() if cell is None else Cell.read(cell)
    said: dict[str, Any] = {
        "base": base,
        "tip": tip,
        "model": model,
        "kind": kind,
        "repeats": repeats,
        "target": None if target is None else parse_point(target, "--target"),
        "held": {**found.held, **parse_held(hold or [])},
        "payload": None if payload is None else parse_payload(payload, found.payload),
        "estimate_target": False if fix_target else None,
        "frozen": (*found.frozen, *(freeze or [])),
        "priors": None if priors is None else found.priors.with_sizes(priors),
    }
    if frame is not None:
        said["estimate_frame"], said["frame_directions"] = parse_frame(frame)
    found = replace(found, **{name: value for name, value in said.items() if value is not None})
    check_model(found.model, "--model" if model is not None else str(cell))
    return found


def load(robot: str, cell: Cell) -> Robot:
    """The robot's chain between the cell's base and tip, with the joints that the cell holds."""
    from calib.robot.robot import Robot

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
    from calib.data.measurements import Measurements
    from calib.data.table import Table
    from calib.robot.robot import Robot

    if points_unit is not None and points is None:
        raise CalibError(
            "--points-unit is the unit of a list of points; name the list with --points."
        )
    renamed = parse_columns(columns or [])
    read = Table.read(data)
    arm = Robot.load(robot, cell.base, cell.tip, measured=read.names(renamed), held=cell.held)
    table = Measurements.read(
        read, arm.joint_names, arm.joint_types, renamed, cell.kind, points, points_unit
    )
    return arm, table


def check_outputs(
    outputs: Iterable[Path | None], inputs: Iterable[str | Path], *, force: bool
) -> None:
    """Refuse outputs before the work rather than after it: existing files, missing folders, the inputs, one twice.

    Raises:
        FileError: An output cannot be written.
    """
    from calib.files import check_no_xacro, check_writable

    taken = {Path(os.path.realpath(path)): "an input" for path in inputs}
    for path in outputs:
        if path is None:
            continue
        resolved = Path(os.path.realpath(path))
        if resolved in taken:
            raise FileError(
                f"{path} is also {taken[resolved]} of this command; choose another name."
            )
        taken[resolved] = "another output"
        check_no_xacro(path)
        check_writable(path, overwrite=force)


def check_chain(cell: Cell, result: Calibration, name: str) -> None:
    """Refuse another base or tip than the result's: its frame and its target would mean something else.

    Raises:
        CalibError: They differ; the text has the ``name`` of the result's file.
    """
    own = result.nominal
    for option, given, wanted in (("base", cell.base, own.base), ("tip", cell.tip, own.tip)):
        if given is not None and given != wanted:
            raise CalibError(
                f"{name} is the result for --{option} {wanted}, and '{given}' was given; leave out --{option}, or "
                f"--calibration."
            )


def with_target_link(robot: Robot, cell: Cell) -> Cell:
    """The cell with the target that the URDF's link ``calib_target`` carries, if it has one at this tip."""
    from calib.calibration import TARGET_LINK

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
    # A held joint and one that follows another have columns that are not needed: nothing is wrong with the chain.
    moving -= {*robot.held, *(joint.name for joint in robot.joints)}
    outside = [n for n, _ in map(split_header, measurements.ignored) if n in moving]
    if outside:
        text += (
            f" Of the robot's joints, {choices(outside)} {'is' if len(outside) == 1 else 'are'} not between "
            f"'{robot.base}' and '{robot.tip}' (--base, --tip)."
        )
    typer.echo(fill(text) + "\n")


@contextmanager
def executor_of(
    workers: int | None, dask: str | None, count: int | None, *, default: int | None = None
) -> Iterator[Executor | None]:
    """Where ``count`` jobs run, by default in so many processes or one a core; None: in this one, one after the other.

    Raises:
        CalibError: Both were given, or there is no such scheduler.
    """
    if count is None:
        yield None
        return
    if dask is not None:
        if workers is not None:
            raise CalibError(
                "--workers are processes of this machine, and --dask has its own workers; leave one of them out."
            )
        try:
            from distributed import Client

            client = Client(dask, timeout="10s", set_as_default=False)  # type: ignore[no-untyped-call]
        except ImportError as error:
            raise CalibError(
                'Dask is not installed: run pip install ".[dask]" in calib\'s folder, or use --workers.'
            ) from error
        except (OSError, ValueError) as error:
            raise CalibError(
                f'--dask "{dask}": no Dask scheduler answers there: {error or "timed out"}.'
            ) from error
        with client, client.get_executor() as executor:  # type: ignore[no-untyped-call]
            yield executor
        return
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    wanted = min(workers or default or cores or 1, count)
    if wanted < 2:
        yield None
        return
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    # A fresh process each: the threads of a parent's linear algebra do not survive a fork.
    methods = multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
    with ProcessPoolExecutor(wanted, mp_context=context) as processes:
        try:
            yield processes
        except BaseException:
            processes.shutdown(wait=False, cancel_futures=True)
            raise
