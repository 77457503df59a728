"""From the words of ``calib compensate`` to values: the tool, what is warned of and accepted, where to start."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from enum import Enum
from typing import TYPE_CHECKING

from calib.cli.words import parse_pair
from calib.errors import CalibError, choices, did_you_mean

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from calib.model.robot import Robot

#: The word for the tool that is the calibrated target, and what stands before one's name.
TARGET = "target"

#: The word for poses in the robot's base.
BASE = "base"

#: The word for poses in the frame that the points were measured in, where there is one.
MEASURED = "measured"

#: What may be left of an error where nothing else is said: position [m], angle [rad].
_ACCEPT = (1e-8, 1e-8)

#: What no correction of a pose can pass: a length that no arm has [m], and more than half a turn [rad].
_UNLIMITED = (1e6, math.tau)

_TOOL = (
    'three numbers and a unit of length, such as "0 0 150 mm", and behind them a rotation vector, "0 0 150 mm 0 0 90 '
    'deg", or roll, pitch and yaw, "0 0 150 mm rpy 0 0 90 deg"; or the calibrated target, "target", or "target:NAME"'
)


class Match(str, Enum):
    """What of a pose is matched."""

    pose = "pose"
    position = "position"
    axis = "axis"
    weighted = "weighted"


class Given(str, Enum):
    """What a program with both is."""

    joints = "joints"
    poses = "poses"


class Send(str, Enum):
    """What is written to be sent."""

    both = "both"
    joints = "joints"
    poses = "poses"


class TableUnits(str, Enum):
    """The units of what is written."""

    deg_mm = "deg mm"
    rad_m = "rad m"


class Orientation(str, Enum):
    """How orientations are written."""

    vector = "rotation-vector"
    quaternion = "quaternion"
    rpy = "rpy"


def parse_tool(text: str) -> NDArray[np.float64] | str:
    """``--tool``: a pose in the tip, shape (4, 4) [m]; or the name of a target, empty for the only one.

    Raises:
        CalibError: Anything else.
    """
    import numpy as np
    from scipy.spatial.transform import Rotation

    from calib.cli.words import parse_point
    from calib.model.robot import read_only
    from calib.units import UNITS, symbols

    words = text.strip()
    if words == TARGET:
        return ""
    if words.startswith(f"{TARGET}:"):
        name = words.removeprefix(f"{TARGET}:").strip()
        if not name:
            message = (
                f'--tool was given as "{text}"; the name of a target is missing behind the colon.'
            )
            raise CalibError(message)
        return name
    parts = re.findall(r"[^\s,]+", re.sub(r"(?<=[\d.])(?=[a-z]+(?:\s|$))", " ", words))
    angles = parts[4:]
    by_axes = angles[:1] == ["rpy"]
    angles = angles[1:] if by_axes else angles
    try:
        turn = [float(angle) for angle in angles[:3]]
    except ValueError:
        turn = []
    if len(parts) < 4 or (parts[4:] and (len(angles) != 4 or len(turn) != 3)):
        message = f'--tool was given as "{text}"; it must be {_TOOL}.'
        raise CalibError(message)
    T = np.eye(4)
    T[:3, 3] = parse_point(" ".join(parts[:4]), "--tool")
    if angles:
        if angles[3] not in symbols("angle") or not np.isfinite(turn).all():
            message = (
                f"--tool was given as \"{text}\"; '{angles[3]}' is no unit of angle, or an angle no finite number. "
                f"Choose one of {choices(symbols('angle'))}."
            )
            raise CalibError(message)
        values = np.multiply(turn, UNITS[angles[3]].to_si)
        if np.abs(values).max() > 2.0 * np.pi + 1e-6:
            message = (
                f'--tool was given as "{text}": that is more than a whole turn. Mostly degrees are meant: '
                f'"{" ".join(parts[:4])} {" ".join(angles[:3])} deg".'
            )
            raise CalibError(message)
        rotation = Rotation.from_euler("xyz", values) if by_axes else Rotation.from_rotvec(values)
        T[:3, :3] = rotation.as_matrix()
    return read_only(T)


def parse_lever(text: str) -> float:
    """``--lever``: a length above zero [m].

    Raises:
        CalibError: Anything else.
    """
    value, angle = parse_pair(text, "--lever", "10 mm")
    if value is None or angle is not None or value == 0.0:
        message = (
            f'--lever was given as "{text}"; it must be a length above 0, such as "10 mm": what an angle of one radian '
            "counts as."
        )
        raise CalibError(message)
    return value


def parse_limit(text: str) -> tuple[float, float]:
    """``--limit``: a length [m] and an angle [rad]; what is not named is larger than any correction.

    Raises:
        CalibError: Anything else.
    """
    length, angle = parse_pair(text, "--limit", "10 mm 2 deg")
    return _UNLIMITED[0] if length is None else length, _UNLIMITED[1] if angle is None else angle


def parse_accept(text: str | None) -> tuple[float, float]:
    """``--accept``: a length [m] and an angle [rad]; what is not named is as without it.

    Raises:
        CalibError: Anything else.
    """
    if text is None:
        return _ACCEPT
    length, angle = parse_pair(text, "--accept", "0.01 mm 0.001 deg")
    return _ACCEPT[0] if length is None else length, _ACCEPT[1] if angle is None else angle


def parse_start(pairs: Iterable[str], robot: Robot) -> dict[str, float]:
    """``--start`` as values of the robot's joints by name [rad or m].

    Raises:
        CalibError: No pair, a name that the chain does not have, or a unit that is not the joint's.
    """
    from calib.cli.words import parse_held
    from calib.units import unit_fault

    start = parse_held(pairs, "--start")
    for name, value in start.items():
        if name not in robot.joint_names:
            message = (
                f"--start: the chain has no joint '{name}'{did_you_mean(name, robot.joint_names)}. It has "
                f"{choices(robot.joint_names)}."
            )
            raise CalibError(message)
        fault = unit_fault(value, slides=robot.joint_types[name] == "prismatic")
        if fault:
            message = f"--start: the value of '{name}' {fault}."
            raise CalibError(message)
    return start
