"""Values from the words of a command line: points, poses, tolerances, payloads, joint values, names of columns."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

from calib.errors import CalibError, choices

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from calib.boards.board import Board
    from calib.camera.camera import Camera
    from calib.data.cell import Tracker
    from calib.data.forms.column_options import ColumnOptions
    from calib.robot.gravity import Payload

#: The size of images: width and height [px].
_IMAGE_SIZE = re.compile(r"(\d{2,5})\s*x\s*(\d{2,5})")


def parse_point(text: str, option: str, example: str = "70 -70 22.5 mm") -> NDArray[np.float64]:
    """Parse a point: three numbers and a unit of length, such as ``70 -70 22.5 mm``.

    Args:
        text: As typed.
        option: The option that it was given with, for messages.
        example: A text that would be right, for messages.

    Returns:
        The point [m], shape (3,), read-only.

    Raises:
        CalibError: It is no such text.
    """
    from calib.basics.arrays import read_only
    from calib.basics.units import LENGTH, parse_quantities

    return read_only(parse_quantities(text, option, {LENGTH: 3}, example)[LENGTH])


def parse_tool(text: str) -> NDArray[np.float64] | str:
    """Parse ``--tool``: ``X Y Z UNIT [RX RY RZ UNIT]``, or ``target[:NAME]``.

    Args:
        text: As typed; the rotation is a rotation vector.

    Returns:
        T_tip_tool, shape (4, 4) [m]; or the name of a target, empty for the only one.

    Raises:
        CalibError: It is neither.
    """
    import numpy as np
    from scipy.spatial.transform import Rotation

    from calib.basics.units import ANGLE, LENGTH, parse_quantities

    word, _, name = text.strip().partition(":")
    if word == "target":
        return name.strip()
    example = "0 0 100 mm 0 0 90 deg"
    if not any(character.isdigit() for character in text):
        raise CalibError(f'--tool "{text}": it must be a pose, "{example}", or target[:NAME].')
    values = parse_quantities(text, "--tool", {LENGTH: 3, ANGLE: 3}, example)
    zero = [0.0, 0.0, 0.0]
    T_tip_tool = np.eye(4)
    T_tip_tool[:3, 3] = values.get(LENGTH, zero)
    T_tip_tool[:3, :3] = Rotation.from_rotvec(values.get(ANGLE, zero)).as_matrix()
    return T_tip_tool


def parse_tracker(text: str | None, tracker: Tracker | None) -> Tracker | None:
    """Parse ``--tracker``: a position in the robot's base, such as ``2500 0 500 mm``.

    Args:
        text: As typed; None without the option.
        tracker: That of the cell file, whose range and noise are kept; None if it has none.

    Returns:
        The tracker at that position; without the option, that of the cell file.
    """
    from calib.data.cell import Tracker

    if text is None:
        return tracker
    position = parse_point(text, "--tracker", "2500 0 500 mm")
    if tracker is None:
        return Tracker(position)
    return replace(tracker, position=position)


def parse_pair(text: str, option: str, example: str) -> tuple[float | None, float | None]:
    """Parse a length, an angle, or both, such as ``10 mm 2 deg``.

    Args:
        text: As typed.
        option: The option that it was given with, for messages.
        example: A text that would be right, for messages.

    Returns:
        Length [m] and angle [rad]; None for one that is not given.

    Raises:
        CalibError: It is neither, or negative.
    """
    from calib.basics.units import ANGLE, LENGTH, parse_quantities

    values = parse_quantities(text, option, {LENGTH: 1, ANGLE: 1}, example, signed=False)
    length = values.get(LENGTH, [None])[0]
    angle = values.get(ANGLE, [None])[0]
    return length, angle


def parse_by_unit(text: str, option: str, example: str) -> dict[str, float]:
    """Parse a size in one or more units of residuals, such as ``0.5 mm 0.1 deg``.

    Args:
        text: As typed.
        option: The option that it was given with, for messages.
        example: A text that would be right, for messages.

    Returns:
        The sizes given, in SI units, by the symbols of `calib.basics.channels.RESIDUAL_UNITS`.

    Raises:
        CalibError: It is no such text, or a size is negative.
    """
    from calib.basics.channels import RESIDUAL_UNITS
    from calib.basics.units import parse_quantities, quantity_name

    names = {symbol: quantity_name(unit.quantity) for symbol, unit in RESIDUAL_UNITS.items()}
    counts = dict.fromkeys(names.values(), 1)
    values = parse_quantities(text, option, counts, example, signed=False)
    return {symbol: values[name][0] for symbol, name in names.items() if name in values}


def parse_payload(text: str, payload: Payload | None) -> Payload:
    """Parse ``--payload``: a mass, such as ``5 kg``.

    Args:
        text: As typed.
        payload: That of the cell file, whose centre of mass is kept; None: the centre of mass is the tip.

    Returns:
        The payload with this mass.

    Raises:
        CalibError: It is no mass.
    """
    from calib.basics.units import MASS, parse_amount
    from calib.robot.gravity import Payload

    mass = parse_amount(text, "--payload", MASS, "5 kg")
    return Payload(mass) if payload is None else replace(payload, mass=mass)


def parse_held(pairs: Iterable[str], option: str = "--hold") -> dict[str, float]:
    """Parse ``--hold`` or another option of the form ``joint=value``.

    Args:
        pairs: As typed, one for each joint.
        option: The option that they were given with, for messages.

    Returns:
        The joints' values by name [rad or m].

    Raises:
        CalibError: One is not of that form, or a joint is named twice.
    """
    from calib.basics.units import parse_joint_value

    form = "'joint=value' with a unit, such as 'torso_lift_joint=0.3 m', and each joint once"
    texts = _mapping(pairs, option, form)
    return {
        name: parse_joint_value(text, f"{option} '{name}={text}'") for name, text in texts.items()
    }


def parse_columns(
    words: Iterable[str] | None, orientation: str | None = None, joint_unit: str | None = None
) -> ColumnOptions:
    """Parse ``--columns``: texts ``name in the table=name in the URDF``, and at most one brand such as ``kuka``.

    Args:
        words: As typed, one for each column or brand; None: not given.
        orientation: ``--orientation``; None: not given.
        joint_unit: ``--joint-unit``; None: not given.

    Returns:
        What is said of the columns.

    Raises:
        CalibError: One is not of that form, a column is named twice, or there is no such brand, convention or unit.
    """
    from calib.data.forms.brands import BRANDS
    from calib.data.forms.column_options import ColumnOptions

    given = list(words or [])
    brands = [word for word in dict.fromkeys(given) if word.strip().casefold() in BRANDS]
    form = (
        "'name in the table=name in the URDF', with a unit in brackets if the table has none, each name once, or one "
        f"brand: {choices(BRANDS)}"
    )
    if len(brands) > 1:
        raise CalibError(f"--columns was given {choices(brands)}; it must be {form}.")
    names = _mapping((word for word in given if word not in brands), "--columns", form)
    brand = brands[0].strip().casefold() if brands else None
    return ColumnOptions(names, brand, orientation, joint_unit)


def _mapping(pairs: Iterable[str], option: str, form: str) -> dict[str, str]:
    """Parse texts ``name=value``; a name may contain an equals sign, a value may not.

    Args:
        pairs: As typed.
        option: The option that they were given with, for messages.
        form: What is allowed, for messages.
    """
    values: dict[str, str] = {}
    for pair in pairs:
        # rpartition leaves all of a text without an equals sign in the last part.
        name, _, value = (part.strip() for part in pair.rpartition("="))
        if not (name and value) or name in values:
            raise CalibError(f"{option} was given '{pair}'; it must be {form}.")
        values[name] = value
    return values


def parse_cameras(texts: Iterable[str]) -> dict[str, Camera]:
    """Parse ``--camera``: files or sizes of images, each with the name of its station in front, or without one.

    Args:
        texts: As typed, such as ``"camera_info.yaml"``, ``"left=left.yaml"`` or ``"1280x720"``.

    Returns:
        The cameras by the names of their stations; ``""`` for one without a name.

    Raises:
        CalibError: A name occurs twice, or a file cannot be read.
    """
    from calib.camera.camera import Camera
    from calib.camera.camera_file import read_camera

    result: dict[str, Camera] = {}
    for name, text in _named_files(texts, "--camera").items():
        size = _IMAGE_SIZE.fullmatch(text)
        if size is None:
            result[name] = read_camera(text)
        else:
            result[name] = Camera(width=int(size[1]), height=int(size[2]))
    return result


def parse_boards(texts: Iterable[str]) -> dict[str, Board]:
    """Parse ``--board``: descriptions of boards, each with the name of its target in front, or without one.

    Args:
        texts: As typed, such as ``"board.toml"`` or ``"left=board.toml"``.

    Returns:
        The boards by the names of their targets; ``""`` for one without a name.

    Raises:
        CalibError: A name occurs twice, or a file cannot be read.
    """
    from calib.boards.board_file import read_board

    return {name: read_board(path) for name, path in _named_files(texts, "--board").items()}


def _named_files(texts: Iterable[str], option: str) -> dict[str, str]:
    """Return what stands behind the names of an option that can be repeated, by the names; CalibError for one twice."""
    result: dict[str, str] = {}
    for text in texts:
        before, equals, behind = text.partition("=")
        name = before.strip() if equals else ""
        if name in result:
            which = f"'{name}'" if name else "one without a name"
            raise CalibError(f"{option} is given twice for {which}; put NAME= before each.")
        result[name] = behind.strip() if equals else text.strip()
    return result
