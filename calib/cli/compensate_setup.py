"""From the words of ``calib compensate`` to values: the two robots, the tool, the frame, what is accepted."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calib.cli.setup import (
    check_chain,
    parse_held,
    parse_pair,
    parse_payload,
    parse_point,
    with_target_link,
)
from calib.errors import CalibError, choices, did_you_mean
from calib.identify.result import Calibration
from calib.identify.result_file import read_result
from calib.measure.cell import Cell
from calib.measure.table import Table
from calib.model.robot import Robot, read_only
from calib.units import UNITS, split_header, symbols, unit_fault

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from calib.model.torques import Payload

#: The words for the tool that is the calibrated target, for poses in the robot's base, and for poses in the frame that
#: the points were measured in, where there is one.
TARGET, BASE, MEASURED = "target", "base", "measured"

#: What may be left of an error where nothing else is said: position [m], angle [rad].
ACCEPT = (1e-8, 1e-8)

#: What no correction of a pose can pass: a length that no arm has [m], and more than half a turn [rad].
UNLIMITED = (1e6, math.tau)

#: Origins of one robot differ by rounding [m; rotation matrices: 1].
_SAME = 1e-9

_TOOL = (
    'three numbers and a unit of length, such as "0 0 150 mm", and behind them a rotation vector, "0 0 150 mm 0 0 90 '
    'deg", or roll, pitch and yaw, "0 0 150 mm rpy 0 0 90 deg"; or the calibrated target, "target", or "target:NAME"'
)


@dataclass(frozen=True, slots=True, eq=False)
class Robots:
    """The robot as its controller has it, and what is known of the actual one.

    Attributes:
        nominal: As its controller has it.
        actual: A result, or a corrected robot.
        name: What the text calls that.
        was_corrected: Whether ROBOT has the result's joint origins already.
    """

    nominal: Robot
    actual: Calibration | Robot
    name: str
    was_corrected: bool = False

    @property
    def result(self) -> Calibration | None:
        """The result, where there is one."""
        return None if isinstance(self.actual, Robot) else self.actual


def robots_of(
    robot: str,
    calibration: Path | None,
    corrected: str | None,
    program: Path,
    renamed: dict[str, str],
    links: tuple[str | None, str | None],
    hold: list[str] | None,
) -> Robots:
    """The two robots of a call.

    Args:
        robot: ROBOT, as the controller has it.
        calibration: The result's file.
        corrected: In place of it, the corrected URDF: a tip that is not named is then the end of the longest chain
            whose joints are columns of the program.
        program: The program's table.
        renamed: How its columns are renamed.
        links: Base and tip.
        hold: Values of joints.

    Raises:
        CalibError: Neither a result nor a URDF or both, a file cannot be read, or the robots are not one.
    """
    held = parse_held(hold or [])
    if calibration is not None and corrected is None:
        return _of_result(robot, calibration, links, held)
    if corrected is None or calibration is not None:
        both = "" if calibration is None else ", not both"
        raise CalibError(
            "What is true of the robot comes from --calibration result.json or from --corrected corrected.urdf: give "
            f"one of them{both}."
        )
    columns = {split_header(label)[0] for label in Table.read(program).header}
    columns |= {split_header(wanted)[0] for wanted in renamed.values()}
    nominal = Robot.load(robot, *links, measured=columns, held=held)
    actual = Robot.load(corrected, nominal.base, nominal.tip, held=held)
    if actual.joint_names == nominal.joint_names and _differ(nominal, actual) is None:
        raise CalibError(
            f"{robot} and {corrected} have the same joint origins from '{nominal.base}' to '{nominal.tip}': there is "
            "nothing to correct. ROBOT is the robot as its controller has it, --corrected as it truly is."
        )
    return Robots(nominal, actual, Path(corrected).name)


def _of_result(
    robot: str, path: Path, links: tuple[str | None, str | None], held: dict[str, float]
) -> Robots:
    """The robots of a result, which must have begun with the one that was given."""
    result = read_result(path)
    check_chain(Cell(base=links[0], tip=links[1]), result, str(path))
    chain = result.nominal
    nominal = Robot.load(robot, chain.base, chain.tip, held={**chain.held, **held})
    was_corrected = _differ(nominal, result.corrected(nominal)) is None
    joint = None if was_corrected else _differ(nominal, result.uncorrected(nominal))
    if joint is not None:
        raise CalibError(
            f"{nominal.urdf.source}: the origin of '{joint}' is neither the one that {path.name} began with nor its "
            "corrected one. Give the URDF that the result was made with. If the controller has a model of its own, "
            "such as a factory calibration, give that as ROBOT and the corrected URDF with --corrected."
        )
    return Robots(nominal, result, path.name, was_corrected)


def _differ(a: Robot, b: Robot) -> str | None:
    """A joint whose origin is not the same in both; None where there is none."""
    others = b.origins()
    far = (name for name, T in a.origins().items() if np.abs(T - others[name]).max() > _SAME)
    return next(far, None)


def tool_of(text: str | None, robots: Robots) -> NDArray[np.float64] | str | None:
    """What is to arrive: a pose in the tip, the name of a target, or the tip.

    Raises:
        CalibError: The words mean nothing, or a corrected URDF carries no target.
    """
    tool = None if text is None else parse_tool(text)
    if not isinstance(tool, str) or not isinstance(robots.actual, Robot):
        return tool
    target = with_target_link(robots.actual, Cell()).target
    if tool:
        raise CalibError(
            f"--tool was given as '{text}'; a URDF knows one target, without a name. Write --tool {TARGET}, or give "
            "--calibration."
        )
    if target is None:
        raise CalibError(
            f"--tool was given as '{text}', and {robots.name} has no link calib_target, which 'calib fit "
            "--target-link' adds. Give the tool's place, such as \"0 0 150 mm\", or --calibration."
        )
    return target


def parse_tool(text: str) -> NDArray[np.float64] | str:
    """``--tool``: a pose in the tip, shape (4, 4) [m]; or the name of a target, empty for the only one.

    Raises:
        CalibError: Anything else.
    """
    from scipy.spatial.transform import Rotation

    word, colon, name = text.strip().partition(":")
    if word == TARGET:
        if colon and not name.strip():
            raise CalibError(
                f'--tool was given as "{text}"; the name of a target is missing behind the colon.'
            )
        return name.strip()
    parts = re.findall(r"[^\s,]+", re.sub(r"(?<=[\d.])(?=[a-z]+(?:\s|$))", " ", text))
    angles = parts[4:]
    by_axes = angles[:1] == ["rpy"]
    angles = angles[by_axes:]
    try:
        turn = [float(angle) for angle in angles[:3]]
    except ValueError:
        turn = []
    if len(parts) < 4 or (parts[4:] and (len(angles) != 4 or len(turn) != 3)):
        raise CalibError(f'--tool was given as "{text}"; it must be {_TOOL}.')
    T = np.eye(4)
    T[:3, 3] = parse_point(" ".join(parts[:4]), "--tool")
    if angles:
        if angles[3] not in symbols("angle") or not np.isfinite(turn).all():
            raise CalibError(
                f"--tool was given as \"{text}\"; '{angles[3]}' is no unit of angle, or an angle no finite number. "
                f"Choose one of {choices(symbols('angle'))}."
            )
        values = np.multiply(turn, UNITS[angles[3]].to_si)
        if np.abs(values).max() > 2.0 * np.pi + 1e-6:
            raise CalibError(
                f'--tool was given as "{text}": that is more than a whole turn. Mostly degrees are meant: '
                f'"{" ".join(parts[:4])} {" ".join(angles[:3])} deg".'
            )
        rotation = Rotation.from_euler("xyz", values) if by_axes else Rotation.from_rotvec(values)
        T[:3, :3] = rotation.as_matrix()
    return read_only(T)


def frame_of(text: str, robots: Robots) -> str | None:
    """The set-up whose frame poses are given in; None for the base.

    Raises:
        CalibError: There is no result that knows set-ups, or none of that name.
    """
    if text == BASE:
        return None
    if robots.result is None:
        raise CalibError(
            f"--poses-in was given as '{text}', and two URDFs know no measurement frames. Leave it out, or give the "
            "result with --calibration."
        )
    groups = robots.result.setup.groups
    if text != MEASURED and text not in groups:
        names = [name for name in groups if name]
        others = ". The result has no named set-ups"
        if names:
            others = f", or one of its set-ups {choices(names)}"
        raise CalibError(
            f"--poses-in was given as '{text}'; choose '{BASE}', '{MEASURED}' (the frame of the result's points)"
            f"{others}."
        )
    return "" if text == MEASURED else text


def payload_of(text: str | None, robots: Robots, *, geometry: bool) -> Payload | None:
    """What the tip carries; its centre of mass is that of the payload in the result.

    Raises:
        CalibError: No mass, or the result has no compliances that it could matter for.
    """
    if text is None:
        return None
    larger = None if robots.result is None else robots.result.larger
    if larger is None or geometry or "compliance" not in larger.name:
        hint = "; 'calib fit --model dh+compliance' estimates them"
        raise CalibError(
            f'--payload was given as "{text}", and the model in use knows no compliances: a payload changes nothing. '
            f"Leave it out{', or --geometry' if geometry and larger is not None else hint}."
        )
    return parse_payload(text, larger.payload)


def parse_lever(text: str | None, match: str | None) -> float | None:
    """``--lever``: a length above zero [m], where a weighted match may be asked for.

    Raises:
        CalibError: Anything else.
    """
    if text is None:
        return None
    value, angle = parse_pair(text, "--lever", "10 mm")
    if value is None or angle is not None or value == 0.0:
        raise CalibError(
            f'--lever was given as "{text}"; it must be a length above 0, such as "10 mm": what an angle of one radian '
            "counts as."
        )
    if match not in (None, "weighted"):
        raise CalibError(
            "--lever says what an angle counts as where it is weighed against a position, and here "
            f"'{match}' is matched. Leave it out, or add --match weighted."
        )
    return value


def parse_sizes(
    text: str | None, option: str, otherwise: tuple[float, float]
) -> tuple[float, float]:
    """``--limit`` or ``--accept``: a length [m] and an angle [rad].

    Args:
        text: The words; None where nothing was said.
        option: Which option, for messages.
        otherwise: What holds for a size that is not named.

    Raises:
        CalibError: Anything else.
    """
    length, angle = (None, None) if text is None else parse_pair(text, option, "10 mm 2 deg")
    return otherwise[0] if length is None else length, otherwise[1] if angle is None else angle


def parse_start(pairs: Iterable[str], robot: Robot) -> dict[str, float]:
    """``--start`` as values of the robot's joints by name [rad or m].

    Raises:
        CalibError: No pair, a name that the chain does not have, or a unit that is not the joint's.
    """
    start = parse_held(pairs, "--start")
    for name, value in start.items():
        if name not in robot.joint_names:
            raise CalibError(
                f"--start: the chain has no joint '{name}'{did_you_mean(name, robot.joint_names)}. It has "
                f"{choices(robot.joint_names)}."
            )
        fault = unit_fault(value, slides=robot.joint_types[name] == "prismatic")
        if fault:
            raise CalibError(f"--start: the value of '{name}' {fault}.")
    return start
