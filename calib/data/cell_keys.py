"""Keys of a cell file, the forms of their values, and checks of these in memory, for the fields of `calib.data.cell`.

Poses, the noise of each unit, the measurement frame, changes of parameters with their units, and cameras and boards,
which may stand in files of their own.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array
from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.records import (
    Key,
    Option,
    add_entries,
    parse_toml,
    read_parts,
    written_parts,
)
from calib.basics.units import ANGLE, COMPLIANCE, LENGTH, PLAIN, is_number, parse_quantity
from calib.basics.value_forms import (
    POINT_MM,
    TABLE,
    Check,
    Form,
    Place,
    form,
    number,
    three_numbers,
)
from calib.basics.values import ReadOnlyMapping
from calib.boards.board_file import board_of_table, read_board
from calib.camera.camera import Camera
from calib.camera.camera_file import camera_of_table, read_camera
from calib.data.kinds import SIGMAS
from calib.data.priors import PRIOR_STD_RANGE
from calib.errors import CalibError, choices
from calib.model.families import FAMILIES
from calib.model.parameter_sets import DIRECTIONS
from calib.numerics.geometry import FARTHEST, pose_of, pose_or_none, position_in_tip

#: A camera or a board.
_Described = TypeVar("_Described")


# Poses and noise


def _rpy_of(R: Array) -> Array:
    """Return roll, pitch, yaw of a rotation matrix, shape (3,) [rad]; at a pitch of 90 deg the yaw is 0."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # SciPy warns of such a pitch
        return np.asarray(Rotation.from_matrix(R).as_euler("xyz"))


#: Roll, pitch, yaw about fixed axes, as a rotation matrix (3, 3).
RPY_DEG = three_numbers(
    "deg", lambda rpy: Rotation.from_euler("xyz", np.radians(rpy)).as_matrix(), _rpy_of
)


def pose_keys(prefix: str, what: str, *, needed: bool = False) -> Sequence[Key]:
    """Return the keys of a pose, whose parts are the arguments of `calib.numerics.geometry.pose_of`.

    Args:
        prefix: Begins the keys.
        what: What the pose is of, ``"the base in the measurement frame"``.
        needed: Whether the position must be given.
    """
    position = f"Position of {what}."
    orientation = f"Orientation of {what}: roll, pitch, yaw as in a URDF."
    return (
        Key(f"{prefix}xyz_mm", POINT_MM, position, "0, 0, 0", part="xyz", needed=needed),
        Key(f"{prefix}rpy_deg", RPY_DEG, orientation, "0, 0, 0", part="rotation"),
    )


def write_pose(prefix: str) -> Callable[[Array], dict[str, Any]]:
    """Return the function that gives the entries of a file, by the keys of `pose_keys`, of a pose, shape (4, 4) [m]."""
    rows = pose_keys(prefix, "")
    return lambda T: written_parts(rows, {"xyz": T[:3, 3], "rotation": T[:3, :3]})


def pose_form(what: str) -> Form:
    """Return the form of a table with the keys of a pose, as T, shape (4, 4) [m]."""
    rows = pose_keys("", what)

    def read(value: Any, place: Place) -> Array:  # noqa: ANN401
        return pose_of(**read_parts(rows, TABLE.read(value, place), place))

    return Form("a table with xyz_mm and rpy_deg", read, write_pose(""))


def sigma_keys() -> Sequence[Key]:
    """Return the keys of the standard deviations of measured scalars, one for each unit of residuals."""
    rows = []
    for symbol, unit in RESIDUAL_UNITS.items():
        meaning = (
            f"Standard deviation of a measured {unit.measured}, {unit.per}; the start value of its estimate. "
            f"A column `{unit.sigma_name}` of the table overrides it."
        )
        rows.append(Key(unit.sigma_key, number(unit.shown), meaning, "estimated", part=symbol))
    return rows


def write_sigma(sigma: Mapping[str, float]) -> dict[str, Any]:
    """Return the entries of a file, by the keys of `sigma_keys`, of standard deviations by unit."""
    return written_parts(sigma_keys(), sigma)


# Links


def link_options(*options: tuple[str, str, str]) -> tuple[Option, ...]:
    """Return the options that name a link, ``LINK``, or several, each of what it is the link of, ``NAME=LINK``.

    Args:
        options: Of each its flag, its help, and what the name is that of.
    """
    return tuple(
        Option(
            flag,
            metavar="[NAME=]LINK",
            type=list[str],
            help=f"{help_text} With NAME=, of {named}.",
            parse=_one_link,
            merge=lambda of_file, given: given or of_file,
        )
        for flag, help_text, named in options
    )


def _words(typed: str | Iterable[str]) -> list[str]:
    """Return words that are typed as a list; a manifest of a fleet has one word."""
    return [typed] if isinstance(typed, str) else list(typed)


def _one_link(typed: str | Iterable[str], flag: str) -> str | None:
    """Return the link that is typed without a name; None if there is none, CalibError if there are two."""
    links = [word.strip() for word in _words(typed) if "=" not in word]
    if len(links) > 1:
        raise CalibError(
            f"{flag} is given twice, as {choices(links)}; put the name of a station or target and = before each."
        )
    return links[0] if links else None


def robots_by_name(typed: str | Iterable[str], flag: str) -> dict[str, str]:
    """Return further robots by their names, as `words_by_name`; CalibError for one without a name."""
    for word in _words(typed):
        if "=" not in word:
            raise CalibError(f"{flag} '{word}' lacks the robot's name: write NAME={word}.")
    return words_by_name(typed, flag)


def words_by_name(typed: str | Iterable[str], flag: str) -> dict[str, str]:
    """Return the words that are typed after a name, ``NAME=WORD``, by it.

    Args:
        typed: Words, with or without a name.
        flag: The option, for messages.

    Raises:
        CalibError: A name or a word is empty, or a name is given twice.
    """
    result: dict[str, str] = {}
    for word in _words(typed):
        name, equals, link = (part.strip() for part in word.partition("="))
        if not equals:
            continue
        if not name or not link or name in result:
            fault = f"names '{name}' twice" if name in result else "lacks what stands beside ="
            raise CalibError(
                f"{flag} '{word}' {fault}; write a name, = and what it is of, each name once."
            )
        result[name] = link
    return result


# The measurement frame


def frame_of(value: str | Sequence[str]) -> tuple[bool, tuple[str, ...]]:
    """Read the key ``frame``: whether the measurement frame is estimated, and in which directions.

    Args:
        value: ``"known"``, ``"estimate"`` (in all directions), or the directions of the base that are estimated, as a
            list or a text such as ``"x,y,rz"``.

    Returns:
        Whether it is estimated, and in which directions.

    Raises:
        ValueError: Anything else.
    """
    if value in ("known", "estimate"):
        return value == "estimate", DIRECTIONS
    words = value.replace(",", " ").split() if isinstance(value, str) else value
    if not words or not {*words} <= {*DIRECTIONS}:
        raise ValueError
    return True, tuple(words)


def _typed_frame(typed: str | Iterable[str], flag: str) -> tuple[bool, tuple[str, ...]] | None:
    """Read what is typed of the measurement frame, as `frame_of`; None if it is only where frames stand, NAME=LINK."""
    words = [word for word in _words(typed) if "=" not in word]
    if not words:
        return None
    given = words[0] if len(words) == 1 else ",".join(words)
    try:
        return frame_of(given)
    except ValueError as error:
        raise CalibError(f"{flag} is '{given}'; it must be {_FRAME}.") from error


def frame_option(part: int) -> Option:
    """Return the option of the measurement frame, for one of the fields that `frame_of` gives, 0 or 1."""

    def parse(typed: str | Iterable[str], flag: str) -> bool | tuple[str, ...] | None:
        """Return the part that is typed; None if nothing is typed of it."""
        frame = _typed_frame(typed, flag)
        return None if frame is None else frame[part]

    return Option(
        "--frame",
        metavar="known|estimate|LIST|NAME=LINK",
        type=list[str],
        help="Measurement frame. 'known' (the default): the points are in the base frame. 'estimate': they are in "
        'any fixed frame, such as the tracker\'s. A list such as "x,y,rz": the frame is known except for these '
        "directions. NAME=LINK: the frame of that station stands on a link, as by --base.",
        parse=parse,
        merge=lambda of_file, typed: of_file if typed is None else typed,
    )


_FRAME = f"'known', 'estimate' or some of {', '.join(DIRECTIONS)}; its pose is frame_xyz_mm and frame_rpy_deg"


def write_frame(cell: Any) -> str | list[str]:  # noqa: ANN401  a Cell, which is made of these keys
    """Return the key ``frame`` of a cell: whether its measurement frame is estimated, or in which directions."""
    if not cell.estimate_frame:
        return "known"
    is_whole = cell.frame_directions == DIRECTIONS
    return "estimate" if is_whole else list(cell.frame_directions)


FRAME_ESTIMATED = form(_FRAME, lambda value: frame_of(value)[0])
FRAME_DIRECTIONS = form(_FRAME, lambda value: frame_of(value)[1])


# Changes of parameters, with their units

#: An example of a change of each quantity, for messages.
_EXAMPLES = {LENGTH: '"0.5 mm"', ANGLE: '"1 mrad"', PLAIN: "1e-3", COMPLIANCE: '"1e-5 rad/Nm"'}

#: A unit of each quantity that has the size of the SI unit.
_SI = {LENGTH: "m", ANGLE: "rad", PLAIN: "", COMPLIANCE: "rad/Nm"}

#: Quantities of geometric parameters by a pattern of their names, see docs/parameters.md; the first that fits is taken.
_PARAMETERS: tuple[tuple[str, tuple[str, ...]], ...] = (
    (r"[ad]\d+|(frame|target|mount)_[xyz](\[.*\])?|.*\.[xyz]", (LENGTH,)),
    (r"(alpha|beta|theta)\d+|(frame|target|mount)_r[xyz](\[.*\])?|.*\.r[xyz]", (ANGLE,)),
    (r".*\.zero", (LENGTH, ANGLE)),
)


def _quantities_of(parameter: str) -> tuple[str, ...]:
    """Return the quantities, such as `LENGTH`, that a parameter may be of, by its name; all if the name is unknown."""
    for pattern, quantities in _PARAMETERS:
        if re.fullmatch(pattern, parameter):
            return quantities
    factor_name = parameter.rpartition(".")[2]
    quantities_of_families = []
    for family in FAMILIES.values():
        if factor_name in [factor.name for factor in family.factors]:
            units = (family.unit, family.sliding)
            quantities_of_families += [unit.quantity for unit in units if unit]
    return tuple(dict.fromkeys(quantities_of_families)) or tuple(_EXAMPLES)


def _read_change(value: Any, place: Place) -> float:  # noqa: ANN401
    """Read a change, in SI units, of the parameter whose name is that of the place; CalibError for a wrong unit."""
    allowed = _quantities_of(place.name)
    examples = " or ".join(_EXAMPLES[quantity] for quantity in allowed)
    try:
        change, quantity = parse_quantity(value)
    except CalibError as error:
        raise CalibError(f"{place}: {error}. Write {examples}.") from error
    if quantity not in allowed:
        raise CalibError(f"{place} is {value!r}, which is {quantity}; write {examples}.")
    return change


def _read_bounds(value: Any, place: Place) -> tuple[float, ...]:  # noqa: ANN401
    """Read the least and the largest change of a parameter, in SI units, from a list or one value for both signs.

    CalibError for a wrong unit; how many there are is checked in memory.
    """
    if isinstance(value, list):
        return tuple(_read_change(bound, place) for bound in value)
    largest = _read_change(value, place)
    return -largest, largest


def write_change(parameter: str, change: float) -> str | float:
    """Write a change of a parameter, in SI units, with the unit of its quantity."""
    unit = _SI[_quantities_of(parameter)[0]]
    return f"{float(change)!r} {unit}" if unit else float(change)


def write_bounds(parameter: str, bounds: Sequence[float]) -> list[str | float]:
    """Write the least and the largest change of a parameter."""
    return [write_change(parameter, bound) for bound in bounds]


#: The change of a parameter from its nominal value.
CHANGE = Form('a change with its unit, "0.5 mm"', _read_change)

#: The least and the largest change.
BOUNDS = Form('one change for both directions, or two: ["-0.02 deg", "1 mrad"]', _read_bounds)

#: Another parameter and a factor.
TIE = Form(
    'another parameter, or a parameter and a factor: ["a2", -1.0]',
    lambda value, _place: (value, 1.0) if isinstance(value, str) else value,
)


# Cameras and boards


def described_keys(
    word: str,
    read: Callable[[Mapping[str, Any], str, Path], _Described],
    option: Option,
    meanings: tuple[str, str],
) -> Sequence[Key]:
    """Return the keys of a table without a name, ``[camera]``, and of those by name, ``[cameras.left]``.

    Args:
        word: ``"camera"`` or ``"board"``.
        read: Reads one from (its table, its heading, the folder where names of files begin).
        option: The option that adds some.
        meanings: Help of both keys.
    """

    def read_single(value: Any, place: Place) -> _Described:  # noqa: ANN401
        return read(TABLE.read(value, place), place.heading, place.folder)

    def read_several(value: Any, place: Place) -> dict[str, _Described]:  # noqa: ANN401
        """Return the cameras or boards of tables by their names in the cell; CalibError for one without a name."""
        result = {}
        for name, given in TABLE.read(value, place).items():
            if not name:
                raise CalibError(f"{place.heading} has a table without a name; write [{word}].")
            # One with a name is called by it unless it says otherwise.
            table = {"name": name, **TABLE.read(given, place.key(name))}
            result[name] = read(table, f"[{word}s.{name}]", place.folder)
        return result

    single, several = meanings
    return (
        Key(word, Form("a table", read_single), single, "none", (option,), part="single"),
        Key(f"{word}s", Form("tables", read_several), several, "none", part="several"),
    )


def by_name(
    single: _Described | None = None, several: Mapping[str, _Described] | None = None
) -> dict[str, _Described]:
    """Return cameras or boards by their names in the cell; ``""`` for the ``single`` one without a name; None: none."""
    return {**({} if single is None else {"": single}), **(several or {})}


def write_described(
    word: str, write: Callable[[Any], str]
) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """Return the function that gives the entries of a file, by the keys of `described_keys`, of cameras or boards.

    Args:
        word: ``"camera"`` or ``"board"``.
        write: Gives the content of a file of one.
    """

    def entries(described: Mapping[str, Any]) -> dict[str, Any]:
        """Return the table of the one without a name, and those of the others by name."""
        tables = {name: parse_toml(write(each)) for name, each in described.items()}
        single = tables.pop("", None)
        of_single = {} if single is None else {word: single}
        return {**of_single, **({f"{word}s": tables} if tables else {})}

    return entries


#: The size of images: width and height [px].
_IMAGE_SIZE = re.compile(r"(\d{2,5})\s*x\s*(\d{2,5})")


def _parse_cameras(typed: Iterable[str], flag: str) -> dict[str, Camera]:
    """Return the cameras of ``[NAME=]FILE`` or ``[NAME=]WIDTHxHEIGHT`` (then without intrinsics), by name or ``""``.

    CalibError for a name that is given twice, or a fault of a file.
    """
    result: dict[str, Camera] = {}
    for name, file in _named_files(typed, flag).items():
        size = _IMAGE_SIZE.fullmatch(file)
        if size is None:
            result[name] = read_camera(file)
        else:
            result[name] = Camera(width=int(size[1]), height=int(size[2]))
    return result


def _named_files(typed: Iterable[str], flag: str) -> dict[str, str]:
    """Return what follows the names in ``NAME=FILE``, by name, ``""`` without one; CalibError for a name twice."""
    result: dict[str, str] = {}
    for word in typed:
        before, equals, after = word.partition("=")
        name = before.strip() if equals else ""
        if name in result:
            which = f"'{name}'" if name else "one without a name"
            raise CalibError(f"{flag} is given twice for {which}; put NAME= before each.")
        result[name] = after.strip() if equals else word.strip()
    return result


def camera_keys() -> Sequence[Key]:
    """Return the keys ``camera`` and ``cameras`` of a cell file, with the option ``--camera``."""
    option = Option(
        "--camera",
        metavar="[NAME=]FILE|WIDTHxHEIGHT",
        type=list[str],
        help="Intrinsics of the camera: a ROS camera_info file, an OpenCV file, or calib's own; or only the size of "
        "its images, such as 1280x720, if the intrinsics are not known. With NAME=, the camera of that station.",
        parse=_parse_cameras,
        merge=add_entries,
    )
    meanings = (
        "The camera that took images of printed boards, see below.",
        "Several cameras, by station (column `group`).",
    )
    return described_keys("camera", camera_of_table, option, meanings)


def board_keys() -> Sequence[Key]:
    """Return the keys ``board`` and ``boards`` of a cell file, with the option ``--board``."""
    option = Option(
        "--board",
        metavar="[NAME=]FILE",
        type=list[str],
        help="Description of the printed board, as 'calib board' writes it, with the accuracy of its print. With "
        "NAME=, the board of that target.",
        parse=lambda typed, flag: {
            name: read_board(path) for name, path in _named_files(typed, flag).items()
        },
        merge=add_entries,
    )
    meanings = ("The printed board.", "Several boards, by target (column `target`).")
    return described_keys("board", board_of_table, option, meanings)


#: Factors of joints' readings by name, which `calib.data.cell.Cell` checks.
FACTORS = form(
    "a table of joints and factors, such as { joint_2 = 1.0 }",
    lambda value: value if isinstance(value, dict) else None,
)


# Checks of values in memory


def _number_within(value: Any, low: float, high: float) -> float | None:  # noqa: ANN401
    """Return a number of a range, which stays an `Angle` or a `Length`; None for others."""
    return value if is_number(value) and low <= value <= high else None


def _directions_or_none(value: Iterable[str]) -> tuple[str, ...] | None:
    """Return given directions of a frame in the order of `DIRECTIONS`; None if others are given."""
    directions = tuple(d for d in DIRECTIONS if d in value)
    if not directions or sorted(directions) != sorted(value):
        return None
    return directions


def _tie_or_none(value: tuple[str, float]) -> tuple[str, float] | None:
    """Return another parameter's name and a factor; None if the factor is not a number, or zero."""
    name, factor = value
    if not is_number(factor) or factor == 0.0:
        return None
    return name, float(factor)


def _interval_or_none(value: tuple[float, float]) -> tuple[float, float] | None:
    """Return two increasing numbers, or None for others; they stay `Angle` or `Length`."""
    low, high = value
    return (low, high) if low < high else None


def _bounds_or_none(value: tuple[float, float]) -> tuple[float, float] | None:
    """Return the least and the largest change of a parameter; None unless 0 is between them."""
    low, high = value
    return _interval_or_none(value) if low <= 0.0 <= high else None


def _factors_or_none(value: Mapping[str, float]) -> ReadOnlyMapping[str, float] | None:
    """Return factors of joints' readings by name if all are numbers other than 0, or None."""
    if not isinstance(value, Mapping) or not all(isinstance(name, str) for name in value):
        return None
    if not value or not all(is_number(factor) and factor for factor in value.values()):
        return None
    return ReadOnlyMapping({name: float(factor) for name, factor in value.items()})


def _sigma_or_none(value: Mapping[str, float]) -> ReadOnlyMapping[str, float] | None:
    """Return standard deviations by the symbol of their unit if all are numbers in range, or None."""
    if not isinstance(value, Mapping) or not value.keys() <= RESIDUAL_UNITS.keys():
        return None
    if not all(is_number(std) and SIGMAS[0] <= std <= SIGMAS[1] for std in value.values()):
        return None
    return ReadOnlyMapping({unit: float(std) for unit, std in value.items()})


IS_POSE = Check("a 4 x 4 pose with a right-handed rotation [m]", pose_or_none)
IS_POSITION = Check("three numbers [m]", lambda value: position_in_tip(value, "target"))
ARE_SIGMAS = Check(
    f"standard deviations from {SIGMAS[0]:g} to {SIGMAS[1]:g} by unit, such as {{'m': 1e-05}}; units are "
    f"{choices(RESIDUAL_UNITS)}",
    _sigma_or_none,
)
IS_TIE = Check("another parameter and a factor that is not zero, such as ('a2', 1.0)", _tie_or_none)
ARE_BOUNDS = Check(
    "the least and the largest change, with 0 between them, (-0.001, 0.001)", _bounds_or_none
)
IS_PRIOR_STD = Check(
    f"a number from {PRIOR_STD_RANGE[0]:g} to {PRIOR_STD_RANGE[1]:g} of the parameter's unit",
    lambda value: _number_within(value, *PRIOR_STD_RANGE),
)
IS_JOINT_VALUE = Check(
    f"a number from {-FARTHEST:g} to {FARTHEST:g} rad or m",
    lambda value: _number_within(value, -FARTHEST, FARTHEST),
)
ARE_FACTORS = Check(
    "factors of other joints' readings by name, none of them zero, such as {'joint_2': 1.0}",
    _factors_or_none,
)
ARE_DIRECTIONS = Check(f"some of {choices(DIRECTIONS)}, each once", _directions_or_none)
IS_RANGE = Check("the least and the largest value [rad or m]", _interval_or_none)
