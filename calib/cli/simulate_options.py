"""The options of ``calib simulate``: which go together, and from words to sizes, errors, noise, steps and events."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from calib.cli.setup import parse_point
from calib.errors import CalibError, choices, did_you_mean

if TYPE_CHECKING:
    from pathlib import Path

    from calib.measure.cell import Cell
    from calib.measure.noise import TrackerNoise
    from calib.model.parameters import Parameter
    from calib.simulate.disturbances import Encoder, MovedTarget, Outliers

_NONE = "none"

#: Noise of an orientation about each axis, of a tracker's 6D probe [deg].
_PROBE_DEG = 0.01

#: How far outliers are off.
_OUTLIER = "5 mm"


def definite(model: str | None) -> str | None:
    """Refuse ``auto``: a robot is wrong in something definite.

    Raises:
        CalibError: It is that.
    """
    if model == "auto":
        raise CalibError(
            "--model auto is for calib fit; say in which errors the simulated robot is wrong, such as placement or "
            "dh+gain."
        )
    return model


def check_together(
    study: int | None, single: Mapping[str, object], of_study: Mapping[str, object]
) -> None:
    """Refuse the files of a single simulation in a study, and what only a study takes in a single one.

    Raises:
        CalibError: One of them was given.
    """
    given = [name for name, value in (of_study if study is None else single).items() if value]
    if given and study is None:
        raise CalibError(
            f"{choices(given)} is for a study of many robots; add --study 200, or leave it out."
        )
    if given:
        raise CalibError(
            f"A study writes no table and no truth; leave {choices(given)} out. --json keeps every trial."
        )


def check_poses(poses: Path | None, count: int | None, *, planned: bool) -> None:
    """Refuse two ways to say which poses.

    Raises:
        CalibError: Poses were given, and others asked for.
    """
    if poses is not None and count is not None:
        raise CalibError("--poses gives the poses, --count says how many are random; choose one.")
    if poses is not None and planned:
        raise CalibError(
            "--planned makes poses; leave --poses out, or leave --planned out to measure at those of the file."
        )


def _quantity(text: str, wanted: str, example: str, where: str) -> float:
    """A number with its unit, in SI units.

    Raises:
        CalibError: Anything else.
    """
    from calib.measure.quantities import parse_quantity

    try:
        value, kind = parse_quantity(text.strip())
    except CalibError as error:
        raise CalibError(f'{where}: {error}. Write "{example}".') from error
    # 0 needs no unit.
    if kind != wanted and not (value == 0.0 and kind == "a number"):
        raise CalibError(f'{where}: "{text.strip()}" is {kind}, {wanted} is wanted: "{example}".')
    return value


def _size(text: str, wanted: str, example: str, where: str) -> float:
    """The same of a value that is not below 0.

    Raises:
        CalibError: Anything else.
    """
    value = _quantity(text, wanted, example, where)
    if value < 0.0:
        raise CalibError(f'{where}: "{text.strip()}" must not be below 0.')
    return value


def parse_size(text: str, option: str, example: str = "1 mm") -> float:
    """A length that is not below 0 [m].

    Raises:
        CalibError: Anything else.
    """
    return _size(text, "a length", example, f'{option} "{text}"')


def parse_angle(text: str, option: str, example: str = "0.01 deg") -> float:
    """An angle that is not below 0 [rad].

    Raises:
        CalibError: Anything else.
    """
    return _size(text, "an angle", example, f'{option} "{text}"')


def parse_sizes(text: str) -> dict[str, float] | None:
    """``length 0.5 mm, angle 3 mrad``; families that are not named keep the sizes of a typical arm; ``none``.

    Raises:
        CalibError: No such family, one twice, or a value that is no size of it.
    """
    from calib.families import FAMILIES

    if text.strip() == _NONE:
        return None
    found: dict[str, float] = {}
    for part in text.split(","):
        words = part.split(None, 1)
        if len(words) != 2 or words[0] not in FAMILIES or words[0] in found:
            raise CalibError(
                f"--sizes was given as \"{text}\"; it must be '{_NONE}', or sizes with commas between them such as "
                f'"length 0.5 mm, angle 3 mrad", each once of {choices(FAMILIES)}.'
            )
        unit = FAMILIES[words[0]].unit
        found[words[0]] = _size(words[1], unit.quantity, unit.example, f"--sizes, {words[0]}")
    return found


def sizes_of(cell: Cell, sizes: str | None, *, named: bool) -> Mapping[str, float] | None:
    """The sizes of errors that are drawn: as said, none beside errors that are named, the cell's, a typical arm's."""
    from calib.families import FAMILIES

    if sizes is not None:
        return parse_sizes(sizes)
    if named:
        return None
    return {f: cell.priors.of(f) for f in FAMILIES} if cell.priors.sizes == "given" else {}


def parse_errors(pairs: Iterable[str], known: Iterable[Parameter]) -> tuple[tuple[str, float], ...]:
    """``--error`` as values of single errors, in their units.

    Args:
        pairs: ``elbow_joint.rx=2 mrad`` each.
        known: The errors that the model has.

    Raises:
        CalibError: A pair without an equals sign, a name twice or unknown, or a value with another unit.
    """
    from calib.families import unit_of

    units = {parameter.name: parameter.unit for parameter in known}
    found: dict[str, float] = {}
    for pair in pairs:
        name, equals, value = (part.strip() for part in pair.rpartition("="))
        if not (name and equals and value) or name in found:
            raise CalibError(
                f"--error was given '{pair}'; it must be 'name=value' with a unit, such as 'elbow_joint.rx=2 mrad', "
                "and each name once."
            )
        if name not in units:
            raise CalibError(
                f"--error '{pair}': the robot has no error '{name}' in this model"
                f"{did_you_mean(name, units)}. It has {choices(units)}; calib inspect prints all, --model chooses "
                "others."
            )
        unit = unit_of(units[name])
        found[name] = _quantity(value, unit.quantity, unit.example, f"--error '{pair}'")
    return tuple(found.items())


def parse_instrument(text: str, repeatability: float) -> TrackerNoise | None:
    """``15 um + 6 um/m``, ``0.05 mm``, ``none``; None where there is no noise at all.

    Args:
        text: Of the instrument.
        repeatability: Of the robot [m].

    Raises:
        CalibError: Anything else.
    """
    from calib.measure.noise import TrackerNoise, parse_noise

    if text.strip() in (_NONE, "0"):
        return TrackerNoise(0.0, 0.0, repeatability) if repeatability else None
    # Read beside a repeatability, so that a noise of "0 mm" is not refused as such.
    read = parse_noise(text, "--noise", repeatability or 1.0)
    if not repeatability and not read.constant and not read.per_length:
        return None
    return TrackerNoise(read.constant, read.per_length, repeatability)


def noise_of(cell: Cell, noise: str | None, repeatability: str | None) -> TrackerNoise | None:
    """The noise that the command line says, else the cell's."""
    from calib.measure.noise import TrackerNoise

    own = None if repeatability is None else parse_size(repeatability, "--repeatability", "0.02 mm")
    if noise is not None:
        return parse_instrument(noise, own or 0.0)
    if cell.sigma is not None:
        found = TrackerNoise(cell.sigma, 0.0, 0.0)
    else:
        found = TrackerNoise() if cell.tracker is None else cell.tracker.noise
    if own is None:
        return found
    if not (own or found.constant or found.per_length):
        return None
    return TrackerNoise(found.constant, found.per_length, own)


def angle_noise_of(cell: Cell, said: str | None, *, any_noise: bool) -> float:
    """The noise of an orientation: as said, the cell's, or a tracker's 6D probe's; none where there is no noise.

    Raises:
        CalibError: No angle, or no kind that measures one.
    """
    from calib.kinds import get as kind_of

    if said is not None:
        if not kind_of(cell.kind or "point").angles:
            raise CalibError(
                "--angle-noise is the noise of orientations; they are measured with --kind pose."
            )
        return parse_angle(said, "--angle-noise")
    if not any_noise:
        return 0.0
    return math.radians(_PROBE_DEG) if cell.sigma_angle is None else cell.sigma_angle


def parse_encoder(texts: Iterable[str]) -> Encoder:
    """``--encoder``: the step of joints that turn, ``0.001 deg``, and of those that slide, ``0.01 mm``.

    Raises:
        CalibError: No length or angle, one below 0, or two of one kind.
    """
    from calib.measure.quantities import ANGLE, LENGTH, parse_quantity
    from calib.simulate.disturbances import Encoder

    steps: dict[str, float] = {}
    for text in texts:
        try:
            value, kind = parse_quantity(text)
        except CalibError as error:
            raise CalibError(
                f'--encoder: {error}. Write "0.001 deg", or "0.01 mm" for joints that slide.'
            ) from error
        if kind not in (ANGLE, LENGTH) or value < 0.0 or kind in steps:
            raise CalibError(
                f'--encoder was given "{text}"; it must be a step that is not below 0, "0.001 deg" for the joints that '
                'turn, "0.01 mm" for those that slide, and one of each at most.'
            )
        steps[kind] = value
    return Encoder(angle=steps.get(ANGLE, 0.0), length=steps.get(LENGTH, 0.0))


def parse_outliers(text: str | None, size: str | None) -> Outliers | None:
    """``--outliers``: a number of rows, ``3``, or a share of them, ``5 %``; and ``--outlier-size``.

    Raises:
        CalibError: Neither, a share above 100 %, or a size of 0, or one without outliers.
    """
    from calib.simulate.disturbances import Outliers

    if text is None:
        if size is not None:
            raise CalibError(
                "--outlier-size says how far outliers are off; say how many there are, such as --outliers 3."
            )
        return None
    off = parse_size(size or _OUTLIER, "--outlier-size", _OUTLIER)
    number = re.fullmatch(r"\s*(\d{1,9})\s*", text)
    share = re.fullmatch(r"\s*(\d+(?:\.\d+)?|\.\d+)\s*%\s*", text)
    if number is None and (share is None or float(share[1]) > 100.0):
        raise CalibError(
            f'--outliers was given as "{text}"; it must be a number of rows, such as "3", or a share of those to '
            'estimate from, such as "5 %", 100 % at most.'
        )
    if not off > 0.0:
        raise CalibError(
            "--outlier-size must be above 0; to have no outliers, leave --outliers out."
        )
    if number is not None:
        return Outliers(count=int(number[1]), size=off)
    return Outliers(share=float(text.replace("%", "")) / 100.0, size=off)


def parse_moved(text: str | None) -> MovedTarget | None:
    """``--moved-target``: ``25: 0 0 0.5 mm``, or with the target's name, ``25 upper: 0 0 0.5 mm``.

    Raises:
        CalibError: Anything else.
    """
    from calib.simulate.disturbances import MovedTarget

    if text is None:
        return None
    match = re.fullmatch(r"\s*(\d{1,9})(?:\s+(\S.*?))?\s*:\s*(\S.*)", text)
    if match is None:
        raise CalibError(
            f'--moved-target was given as "{text}"; it must be the first row that finds it moved, and by how much '
            'along the tip\'s axes, such as "25: 0 0 0.5 mm"; with the name of one of several targets "25 upper: 0 0 '
            '0.5 mm".'
        )
    by = parse_point(match[3], "--moved-target")
    return MovedTarget(int(match[1]), by, match[2])
