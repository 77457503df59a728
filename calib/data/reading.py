"""Reading: a column of a table with a number that rows of a kind measure."""

from __future__ import annotations

from dataclasses import dataclass

from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.units import UNITS, Quantity
from calib.errors import CalibError, choices


@dataclass(frozen=True, slots=True)
class Reading:
    """A column of the table with a number that rows of a kind measure.

    Raises:
        CalibError: The quantity is none of these.
    """

    #: Name of the column without its unit, ``"distance"``.
    name: str
    #: What it measures: ``"length"``, ``"angle"`` or ``"pixel"``.
    quantity: Quantity = "length"
    #: Whether it is always greater than zero, as a distance is.
    positive: bool = False

    def __post_init__(self) -> None:
        """Check the quantity."""
        allowed = [unit.quantity for unit in RESIDUAL_UNITS.values()]
        if self.quantity not in allowed:
            unit = UNITS.get(str(self.quantity))
            hint = f"; '{unit.symbol}' is a unit of '{unit.quantity}'" if unit else ""
            raise CalibError(
                f"The reading '{self.name}' has the quantity '{self.quantity}'; allowed are {choices(allowed)}{hint}."
            )
