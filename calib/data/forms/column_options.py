"""Options for reading a table's columns: their names, a robot's brand, the convention of orientations, units of joints.

A brand, one row of `BRANDS`, names the columns of axes, position and orientation. The axes are matched with the robot's
joints in the order of its chain. External axes are not: a rail comes before the arm's first joint, the seventh axis of
some arms between others.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TypeAlias

from calib.basics.arguments import check_mapping, check_type
from calib.basics.units import Quantity, find_unit, symbols
from calib.basics.values import ReadOnlyMapping
from calib.data.forms.orientations import CONVENTIONS, Convention, find_convention
from calib.errors import CalibError, MeasurementError, choices, did_you_mean

# Brands

#: Names of the axes J1 to J7 of brands that number them.
_NUMBERED = tuple(f"J{i}" for i in range(1, 8))

#: Least number of a brand's axes by which a table is taken to be of that brand.
_FEWEST_AXES = 4

LEROBOT = "lerobot"
"""The brand of LeRobot, whose numbers `calib.data.forms.servo_columns` turns into angles."""

TICKS = "ticks"
"""The unit of a servo's encoder, as a column or ``--joint-unit`` names it."""

PERCENT = "%"
"""The unit of LeRobot's numbers from -100 to 100."""

#: Columns of a position, in lower case.
_POSITION = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Brand:
    """Names of columns that a brand's controllers and programs use."""

    #: Its name, as ``--columns`` takes it.
    name: str
    #: Its own spelling, for messages: ``"Stäubli"``.
    title: str
    #: Series of names of the arm's axes from base to flange; a table uses one series.
    axes: tuple[tuple[str, ...], ...]
    #: Names of external axes.
    external: tuple[str, ...]

    def axes_in(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return the axes that are among names of columns, from base to flange, as the brand writes them."""
        by_series = [
            tuple(a for a in series if _position_of(a, names) is not None) for series in self.axes
        ]
        return max(by_series, key=len)

    @property
    def convention(self) -> Convention | None:
        """The convention of orientations with the brand's name; None if the brand has none."""
        return CONVENTIONS.get(self.name)

    @property
    def orientation(self) -> tuple[str, ...]:
        """The columns of an orientation; none if the brand has no convention."""
        return () if self.convention is None else self.convention.columns

    def is_oriented_in(self, names: Sequence[str]) -> bool:
        """Return True if the brand has columns of an orientation, and they are among names of columns."""
        found = [_position_of(name, names) is not None for name in self.orientation]
        return bool(found) and all(found)


_ROWS = (
    Brand(
        "kuka",
        "KUKA",
        (tuple(f"A{i}" for i in range(1, 8)),),
        tuple(f"E{i}" for i in range(1, 7)),
    ),
    Brand("fanuc", "FANUC", (_NUMBERED,), ("J8", "J9", "E1", "E2", "E3")),
    Brand(
        "abb",
        "ABB",
        (tuple(f"rax_{i}" for i in range(1, 7)), _NUMBERED),
        tuple(f"eax_{letter}" for letter in "abcdef"),
    ),
    Brand("staubli", "Stäubli", (_NUMBERED,), ()),
    # E, the seventh axis of some arms, is between the second and the third of the others.
    Brand("yaskawa", "Yaskawa", (tuple("SLEURBT"),), ("E1", "E2", "E3")),
    Brand(
        LEROBOT,
        "LeRobot",
        (
            (
                "shoulder_pan.pos",
                "shoulder_lift.pos",
                "elbow_flex.pos",
                "wrist_flex.pos",
                "wrist_roll.pos",
            ),
        ),
        ("gripper.pos",),
    ),
)

#: All brands by name.
BRANDS: Mapping[str, Brand] = MappingProxyType({row.name: row for row in _ROWS})


def find_brand(name: str) -> Brand:
    """Return the brand of a name, as ``--columns`` gives it; raises `MeasurementError`."""
    if name not in BRANDS:
        raise MeasurementError(
            f"There is no brand '{name}' (--columns){did_you_mean(name, BRANDS)}; there are "
            f"{choices(BRANDS)}."
        )
    return BRANDS[name]


def brands_like(names: Sequence[str]) -> tuple[Brand, ...]:
    """Return the brands whose axes are among names of columns: those whose orientation is there too, if any.

    Args:
        names: Names of the columns, without units.

    Returns:
        The brands; none unless the first axis and three more are there.
    """
    alike = []
    for brand in BRANDS.values():
        axes = brand.axes_in(names)
        is_begun = any(axes[:1] == series[:1] for series in brand.axes)
        if is_begun and len(axes) >= _FEWEST_AXES:
            alike.append(brand)
    oriented = [brand for brand in alike if brand.is_oriented_in(names)]
    return tuple(oriented or alike)


def fix_for_brand(names: Sequence[str]) -> str:
    """Return the sentence that says what to type for a table with a brand's columns; empty if it has none.

    Args:
        names: Names of the columns, without units.
    """
    alike = brands_like(names)
    if not alike:
        return ""
    titles = " or ".join(brand.title for brand in alike)
    options = " or ".join(f"--columns {brand.name}" for brand in alike)
    return f" They look like those of {titles}: {options} maps them to the robot's joints in their order."


def names_by_brand(
    brand: Brand, source: str, names: Mapping[int, str], joint_names: Sequence[str]
) -> dict[int, str]:
    """Return calib's names of the columns that have names of a brand, by their positions in the table.

    Args:
        brand: The brand.
        source: The table's name, for messages.
        names: Names of the columns that are not mapped otherwise, without units, by their positions in the table.
        joint_names: The joints that have no column yet, in the order of the chain; none if they are not known, and
            then the axes keep their names.

    Returns:
        Names by positions, from 0.

    Raises:
        MeasurementError: There are axes, and they are more or fewer than the joints.
    """
    positions = list(names)
    written = list(names.values())
    result: dict[int, str] = {}
    for name in (*_POSITION, *brand.orientation):
        at = _position_of(name, written, in_any_case=True)
        if at is not None:
            result[positions[at]] = name
    axes = brand.axes_in(written)
    joints = joint_names or axes
    if axes and len(axes) != len(joints):
        external = [name for name in brand.external if _position_of(name, written) is not None]
        if len(axes) > len(joints):
            fix = (
                f'Leave out each axis that is none of these joints, as --columns "{axes[-1]}=-", or name the arm\'s '
                "end with --tip."
            )
        else:
            unused = external[0] if external else "name in the table"
            fix = (
                "Name the arm's end with --tip, hold a joint that does not move with --hold, or map a column to a "
                f'joint of it: --columns "{unused}={joints[0]}".'
            )
        others = f", besides external axes {choices(external)}" if external else ""
        raise MeasurementError(
            f"{source}: it has {len(axes)} axes of {brand.title}, {choices(axes)}{others}, and the robot "
            f"{len(joints)} joints, {choices(joints)}. {fix}"
        )
    for axis, joint in zip(axes, joints, strict=False):  # none of the axes may be there
        at = _position_of(axis, written)
        if at is not None:
            result[positions[at]] = joint
    return result


def _position_of(name: str, names: Sequence[str], *, in_any_case: bool = False) -> int | None:
    """Return the position of a name among others, from 0; None if it is not there.

    Upper and lower case are the same, except for single letters other than x, y, z, unless ``in_any_case``.
    """
    is_exact = len(name) == 1 and name not in _POSITION and not in_any_case
    for i, other in enumerate(names):
        if other == name or (not is_exact and other.casefold() == name.casefold()):
            return i
    return None


# Options

#: Units of servos, which say nothing without `ColumnOptions.motors`.
_OF_SERVOS = (TICKS, PERCENT)

#: Units of the joints of a brand's tables that name none.
_UNITS_OF_BRANDS: Mapping[Quantity, str] = {"angle": "deg", "length": "mm"}


@dataclass(frozen=True, slots=True)
class ColumnOptions:
    """Statements about a table's columns that their headers do not make: names, brand, orientation, unit of joints.

    Raises:
        MeasurementError: No such brand, convention or unit.
    """

    #: Names of calib by those of the table, ``{"J1": "shoulder_pan_joint"}``; with a unit, ``{"J1":
    #: "shoulder_pan_joint [deg]"}``, for a column that has none; to ``"-"`` to leave a column out. Several columns may
    #: be mapped to ``"group"``.
    names: Mapping[str, str] = field(default_factory=dict)
    #: One of `calib.data.forms.column_options.BRANDS`, whose names the other columns have; None: calib's names.
    brand: str | None = None
    #: One of `calib.data.forms.orientations.CONVENTIONS`; None: as the columns' names say.
    orientation: str | None = None
    #: Unit of the joints whose columns name none, ``"deg"``; ``"deg mm"`` if some slide; of servos `TICKS`, `PERCENT`.
    #: None: each names its own.
    joint_unit: str | None = None
    #: What the numbers of servos mean: LeRobot's calibration file, or ticks in a turn and the tick of the joints' zero,
    #: ``"4096@2048"``; see `calib.data.forms.servo_columns.Motors.parse`. None: there are none.
    motors: str | os.PathLike[str] | None = None

    def __post_init__(self) -> None:
        """Check the words."""
        check_mapping("columns", self.names)
        object.__setattr__(self, "names", ReadOnlyMapping(self.names))
        for name in ("brand", "orientation", "joint_unit"):
            check_type(name, getattr(self, name), (str, type(None)), "a word, or None")
        if self.brand is not None:
            find_brand(self.brand)
        if self.orientation is not None:
            find_convention(self.orientation)
        check_type("motors", self.motors, (str, os.PathLike, type(None)), "a file, or a text")
        if self.joint_unit not in _OF_SERVOS:
            _units(self.joint_unit)

    @property
    def brand_entry(self) -> Brand | None:
        """The entry of the brand in `BRANDS`; None without one."""
        return None if self.brand is None else find_brand(self.brand)

    @property
    def conventions(self) -> tuple[Convention, ...]:
        """The convention of orientations that was given, then the brand's; none: as the columns' names say."""
        given = None if self.orientation is None else find_convention(self.orientation)
        of_brand = None if self.brand_entry is None else self.brand_entry.convention
        return tuple(row for row in (given, of_brand) if row is not None)

    def joint_unit_of(self, quantity: Quantity) -> str | None:
        """Return the symbol of the unit of joints' columns without one; None if nothing says it.

        Args:
            quantity: ``"angle"`` of a joint that turns, ``"length"`` of one that slides.
        """
        of_brand = {} if self.brand in (None, LEROBOT) else _UNITS_OF_BRANDS
        of_joints = {} if self.joint_unit in _OF_SERVOS else _units(self.joint_unit)
        return of_joints.get(quantity, of_brand.get(quantity))


#: An argument ``columns``: names of calib by those of the table, or all options for columns; None: no option.
ColumnsInput: TypeAlias = Mapping[str, str] | ColumnOptions | None


def column_options(columns: ColumnsInput) -> ColumnOptions:
    """Return an argument ``columns`` as options: a mapping gives the names alone, None gives nothing."""
    return columns if isinstance(columns, ColumnOptions) else ColumnOptions(columns or {})


def _units(text: str | None) -> dict[Quantity, str]:
    """Return the symbols of ``--joint-unit`` by their quantities, none for None; raises `MeasurementError`."""
    units: dict[Quantity, str] = {}
    for word in (text or "").split():
        try:
            unit = find_unit(word)
        except CalibError:
            unit = None
        if unit is None or unit.quantity not in ("angle", "length") or unit.quantity in units:
            raise MeasurementError(
                f"The unit of joints (--joint-unit) was given as '{text}'; it is one of {choices(symbols('angle'))}, "
                f'for joints that slide one of {choices(symbols("length"))}, or one of each: "deg mm"; of servos '
                f"{choices(_OF_SERVOS)}."
            )
        units[unit.quantity] = unit.symbol
    return units
