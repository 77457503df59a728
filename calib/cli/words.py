"""From the words of a command line to values: points, frames, models, held joints, payloads, columns."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from typing import TYPE_CHECKING

from calib.errors import CalibError, choices

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from calib.model.torques import Payload

#: The model that lets the data choose; it takes no families, for it tries them all.
AUTO = "auto"

_KILOGRAMS = {"kg": 1.0, "g": 1e-3}


def parse_point(text: str, option: str) -> NDArray[np.float64]:
    """Three numbers and a unit of length, such as ``70 -70 22.5 mm``, as a point [m], shape (3,).

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
        raise CalibError(
            f'{option} was given as "{text}"; it must be three numbers and a unit, such as "70 -70 22.5 mm".'
        )
    if words[3] not in symbols("length"):
        raise CalibError(
            f"{option} was given as \"{text}\"; '{words[3]}' is no unit of length. Choose one of "
            f"{choices(symbols('length'))}."
        )
    return read_only([UNITS[words[3]].to_si * number for number in numbers])


def parse_frame(text: str) -> tuple[bool, tuple[str, ...]]:
    """``--frame``: whether the measurement frame is estimated, and which of its directions are.

    Raises:
        CalibError: Neither ``known`` nor ``estimate`` nor a list of directions such as ``x,y,rz``.
    """
    from calib.measure.cell import DIRECTIONS

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
    """A length [m], an angle [rad], or both: ``10 mm``, ``2 deg``, ``10 mm 2 deg``.

    Args:
        text: The words.
        option: For messages.
        example: For messages.

    Returns:
        Length and angle; None for what is not named.

    Raises:
        CalibError: Anything else, a value below zero, or two of one kind.
    """
    from calib.measure.quantities import ANGLE, LENGTH, parse_quantity

    found: dict[str, float] = {}
    parts = re.findall(r"[^\s,]+\s*[A-Za-zµμ]+", text)
    whole = re.sub(r"[\s,]+", "", "".join(parts)) == re.sub(r"[\s,]+", "", text)
    try:
        values = [parse_quantity(part) for part in parts] if whole else []
    except CalibError as error:
        raise CalibError(f'{option} was given as "{text}"; {error}. Write "{example}".') from error
    for value, kind in values:
        if kind in (LENGTH, ANGLE) and kind not in found and value >= 0.0:
            found[kind] = value
    if not values or len(found) != len(values):
        raise CalibError(
            f'{option} was given as "{text}"; it must be a length, an angle, or one of each, not below 0 and with '
            f'units, such as "{example}".'
        )
    return found.get(LENGTH), found.get(ANGLE)


def check_model(text: str, source: str) -> None:
    """Refuse a model that does not exist.

    Args:
        text: A parameter set, and families of errors behind it: ``dh+gain``.
        source: Where it was given.

    Raises:
        CalibError: No such set or family, or a family twice.
    """
    from calib.families import joint_families
    from calib.model.error_model import MODELS

    if text == AUTO:
        return
    base, *families = (part.strip() for part in text.split("+"))
    known = base in MODELS and set(families) <= set(joint_families())
    if not known or len(set(families)) < len(families):
        raise CalibError(
            f"{source}: there is no model '{text}'. It is '{AUTO}', or one of {choices(MODELS)} and behind it, each "
            f"with a '+' and once, any of {choices(joint_families())}: 'dh+gain'."
        )


def parse_held(pairs: Iterable[str], option: str = "--hold") -> dict[str, float]:
    """``--hold``, or another option of its form, as the values of joints by name [rad or m].

    Raises:
        CalibError: A pair without an equals sign, a name twice, or a value without a unit.
    """
    from calib.measure.quantities import parse_joint_value

    held: dict[str, float] = {}
    for pair in pairs:
        name, equals, value = (part.strip() for part in pair.rpartition("="))
        # rpartition leaves all of a text without an equals sign in the last part.
        if not (name and equals and value) or name in held:
            raise CalibError(
                f"{option} was given '{pair}'; it must be 'joint=value' with a unit of angle or length, such as "
                "'torso_lift_joint=0.3 m', and each joint once."
            )
        held[name] = parse_joint_value(value, f"{option} '{pair}'")
    return held


def parse_payload(text: str, given: Payload | None) -> Payload:
    """``--payload``: a mass such as ``5 kg``; its centre is that of the payload already given, or the tip.

    Raises:
        CalibError: No mass with a unit.
    """
    from dataclasses import replace

    from calib.model.torques import Payload as PayloadClass

    match = re.fullmatch(r"\s*([\d.]+(?:[eE][+-]?\d+)?)\s*(kg|g)\s*", text)
    try:
        mass = float(match[1]) * _KILOGRAMS[match[2]] if match else math.nan
    except ValueError:
        mass = math.nan
    if not math.isfinite(mass):
        raise CalibError(
            f'--payload was given as "{text}"; it must be a mass in kg or g, such as "5 kg". Its centre of mass stands '
            "in the cell file."
        )
    return PayloadClass(mass) if given is None else replace(given, mass=mass)


def parse_columns(pairs: Iterable[str]) -> dict[str, str]:
    """``--columns`` as a mapping from the table's names to calib's.

    Raises:
        CalibError: A pair without an equals sign, or a name twice.
    """
    wanted = (
        "'name in the table=name in the URDF', with a unit in brackets behind it if the table has none, and each name "
        "once"
    )
    return _mapping(pairs, "--columns", wanted)


def parse_sweeps(pairs: Iterable[str]) -> dict[str, str]:
    """``--sweep "ring_a=joint 1"`` as a mapping from the file's names of sweeps to what they are.

    Raises:
        CalibError: A pair without an equals sign, or a name twice.
    """
    wanted = "'name in the file=sweep', such as 'ring_a=joint 1', and each name once"
    return _mapping(pairs, "--sweep", wanted)


def _mapping(pairs: Iterable[str], option: str, wanted: str) -> dict[str, str]:
    """Pairs with an equals sign between as a mapping.

    Raises:
        CalibError: A pair without an equals sign, or a name twice.
    """
    mapping: dict[str, str] = {}
    for pair in pairs:
        name, equals, value = (part.strip() for part in pair.partition("="))
        if not (name and equals and value) or name in mapping:
            raise CalibError(f"{option} was given '{pair}'; it must be {wanted}.")
        mapping[name] = value
    return mapping
