"""Options for reading a table's columns: their names, the convention of orientations, the unit of joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

from calib.basics.arguments import check_mapping, check_type
from calib.basics.units import Quantity, find_unit, symbols
from calib.basics.values import ReadOnlyMapping
from calib.data.forms.brands import Brand, find_brand
from calib.data.forms.orientations import Convention, find_convention
from calib.errors import CalibError, MeasurementError, choices

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
    #: One of `calib.data.forms.brands.BRANDS`, whose names the other columns have; None: calib's names.
    brand: str | None = None
    #: One of `calib.data.forms.orientations.CONVENTIONS`; None: as the columns' names say.
    orientation: str | None = None
    #: Unit of the joints whose columns name none, ``"deg"``; ``"deg mm"`` if some slide. None: each names its own.
    joint_unit: str | None = None

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
        _units(self.joint_unit)

    @property
    def brand_entry(self) -> Brand | None:
        """The entry of the brand in `BRANDS`; None without one."""
        return None if self.brand is None else find_brand(self.brand)

    @property
    def conventions(self) -> tuple[Convention, ...]:
        """The convention of orientations that was given, then the brand's; none: as the columns' names say."""
        given = [name for name in (self.orientation, self.brand) if name is not None]
        return tuple(map(find_convention, given))

    def joint_unit_of(self, quantity: Quantity) -> str | None:
        """Return the symbol of the unit of joints' columns without one; None if nothing says it.

        Args:
            quantity: ``"angle"`` of a joint that turns, ``"length"`` of one that slides.
        """
        of_brand = {} if self.brand is None else _UNITS_OF_BRANDS
        return _units(self.joint_unit).get(quantity, of_brand.get(quantity))


#: What functions take as ``columns``: names of calib by those of the table, or all that can be said; None: nothing.
ColumnsInput: TypeAlias = Mapping[str, str] | ColumnOptions | None


def column_options(columns: ColumnsInput) -> ColumnOptions:
    """Return what is said of a table's columns, from what a function was given as ``columns``."""
    return columns if isinstance(columns, ColumnOptions) else ColumnOptions(columns or {})


def _units(text: str | None) -> dict[Quantity, str]:
    """Return the symbols of ``--joint-unit`` by their quantities; raises `MeasurementError`."""
    units: dict[Quantity, str] = {}
    for word in (text or "").split():
        try:
            unit = find_unit(word)
        except CalibError:
            unit = None
        if unit is None or unit.quantity not in ("angle", "length") or unit.quantity in units:
            raise MeasurementError(
                f"The unit of joints (--joint-unit) was given as '{text}'; it is one of {choices(symbols('angle'))}, "
                f'for joints that slide one of {choices(symbols("length"))}, or one of each: "deg mm".'
            )
        units[unit.quantity] = unit.symbol
    return units
