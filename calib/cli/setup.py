"""From the words of a command line to a cell, a robot and a table; where its jobs run and what it may write."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
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

    from calib.data.cell import Cell, Tracker
    from calib.data.measurements import Measurements
    from calib.result.calibration import CalibrationValues
    from calib.robot.payload import Payload
    from calib.robot.robot import Robot


def parse_point(text: str, option: str, example: str = "70 -70 22.5 mm") -> NDArray[np.float64]:
    """Three numbers and a unit of length, such as ``70 -70 22.5 mm``, as a point [m], shape (3,)."""
    from calib.robot.robot import read_only
    from calib.units import LENGTH, parse_quantities

    return read_only(parse_quantities(text, option, {LENGTH: 3}, example)[LENGTH])


def parse_tool(text: str) -> NDArray[np.float64] | str:
    """``--tool``: a pose in the tip (4, 4) [m]; or the name of a target, empty for the only one."""
    import numpy as np
    from scipy.spatial.transform import Rotation

    from calib.units import ANGLE, LENGTH, parse_quantities

    word, _, name = text.strip().partition(":")
    if word == "target":
        return name.strip()
    parts, example = {LENGTH: 3, ANGLE: 3}, "0 0 100 mm 0 0 90 deg"
    if not any(sign.isdigit() for sign in text):
        raise CalibError(f'--tool "{text}": it must be a pose, "{example}", or target[:NAME].')
    found = parse_quantities(text, "--tool", parts, example)
    T = np.eye(4)
    T[:3, 3] = found.get(LENGTH, [0.0] * 3)
    T[:3, :3] = Rotation.from_rotvec(found.get(ANGLE, [0.0] * 3)).as_matrix()
    return T


def parse_tracker(text: str | None, given: Tracker | None) -> Tracker | None:
    """``--tracker``: a position in the robot's base, such as ``2500 0 500 mm``; the rest is the given one's."""
    from calib.data.cell import Tracker

    if text is None:
        return given
    position = parse_point(text, "--tracker", "2500 0 500 mm")
    return Tracker(position) if given is None else replace(given, position=position)


def parse_pair(text: str, option: str, example: str) -> tuple[float | None, float | None]:
    """A length [m], an angle [rad], or both, ``10 mm 2 deg``; None for what is not named."""
    from calib.units import ANGLE, LENGTH, parse_quantities

    found = parse_quantities(text, option, {LENGTH: 1, ANGLE: 1}, example, signed=False)
    return found.get(LENGTH, [None])[0], found.get(ANGLE, [None])[0]


def parse_payload(text: str, given: Payload | None) -> Payload:
    """``--payload``: a mass such as ``5 kg``; its centre is that of the payload already given, or the tip."""
    from calib.robot.payload import Payload as PayloadClass
    from calib.units import MASS, parse_amount

    mass = parse_amount(text, "--payload", MASS, "5 kg")
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
    """``--hold``, or another option of its form, as the values of joints by name [rad or m]."""
    from calib.units import parse_joint_value

    wanted = "'joint=value' with a unit, such as 'torso_lift_joint=0.3 m', and each joint once"
    found = _pairs(pairs, option, wanted)
    return {name: parse_joint_value(v, f"{option} '{name}={v}'") for name, v in found.items()}


def parse_columns(pairs: Iterable[str]) -> dict[str, str]:
    """``--columns`` as a mapping from the table's names to calib's."""
    wanted = "'name in the table=name in the URDF', with a unit in brackets if the table has none, each name once"
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
    """The cell file, if there is one, with options as they are written, those of `CellOptions`, on top of it."""
    from calib.data.cell import Cell
    from calib.data.cell_file import FRAME

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
        "priors": None if priors is None else found.priors.with_source(priors),
    }
    if frame is not None:
        said |= FRAME(frame, "--frame")
    return replace(found, **{name: value for name, value in said.items() if value is not None})


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
    """
    from calib.data.measurements import Measurements
    from calib.data.table import Table
    from calib.robot.robot import Robot

    if points_unit is not None and points is None:
        raise CalibError(
            "--points-unit is the unit of a list of points; name the list with --points."
        )
    if Path(robot).suffix.lower() in (".csv", ".txt", ".tsv"):
        raise CalibError(f"'{robot}' stands where the robot belongs: ROBOT comes first, then DATA.")
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
    """Refuse outputs before the work rather than after it: existing files, missing folders, the inputs, one twice."""
    from calib.files import check_no_xacro, check_writable

    taken = {Path(os.path.realpath(path)): "an input" for path in inputs}
    for path in outputs:
        if path is None:
            continue
        resolved = Path(os.path.realpath(path))
        if resolved in taken:
            raise FileError(f"{path} is also {taken[resolved]} of this command.")
        taken[resolved] = "another output"
        check_no_xacro(path)
        check_writable(path, overwrite=force)


def check_chain(cell: Cell, result: CalibrationValues, name: str) -> None:
    """Refuse another base or tip than the result's, in the file ``name``: its frame and target would mean another."""
    own = result.nominal
    for option, given, wanted in (("base", cell.base, own.base), ("tip", cell.tip, own.tip)):
        if given is not None and given != wanted:
            raise CalibError(
                f"{name} is the result for --{option} {wanted}, and '{given}' was given."
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


def say_accepted(name: str, stated: str) -> None:
    """Say on stderr, to those too who want nothing printed, which verdict ``do not use`` was accepted.

    Args:
        name: The file that the verdict is on.
        stated: The verdict, as `calib.text.verdict.against` has it; nothing is said where it is empty.
    """
    if stated:
        typer.echo(
            f"calib: the verdict on {name} is: {stated} Because of --accept it was used all the same.",
            err=True,
        )


def say_ignored(measurements: Measurements, robot: Robot) -> None:
    """Name the rows and columns that were not used; a joint among these hints at a wrong base or tip."""
    from calib.units import split_header

    if held_out := measurements.unmeasured:
        total = len(measurements) + len(held_out)
        text = (
            f"{len(held_out)} of {total} rows not measured, and left out: {row_ranges(held_out)}."
        )
        typer.echo(fill(text) + "\n")
    if not measurements.ignored:
        return
    text = f"Columns not used: {choices(measurements.ignored)}."
    moving = {joint.name for joint in robot.urdf.joints if joint.type != "fixed"}
    # A held joint and one that follows another have columns that are not needed: nothing is wrong with the chain.
    moving -= {*robot.held, *(joint.name for joint in robot.joints)}
    if outside := [n for n, _ in map(split_header, measurements.ignored) if n in moving]:
        text += (
            f" Not between '{robot.base}' and '{robot.tip}' (--base, --tip): {choices(outside)}."
        )
    typer.echo(fill(text) + "\n")


@contextmanager
def executor_of(
    workers: int | None, dask: str | None, count: int | None, *, default: int | None = None
) -> Iterator[Executor | None]:
    """Where ``count`` jobs run, by default in so many processes or one a core; None: in this one, in turn."""
    if count is None:
        yield None
        return
    if dask is not None and workers is not None:
        raise CalibError("--workers are processes of this machine; leave them out, or --dask.")
    if dask is not None:
        try:
            from distributed import Client

            client = Client(dask, timeout="10s", set_as_default=False)  # type: ignore[no-untyped-call]
        except ImportError as error:
            raise CalibError("Dask is not installed: pip install distributed.") from error
        except (OSError, ValueError) as error:
            raise CalibError(
                f'--dask "{dask}": no Dask scheduler answers there: {error}.'
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
