"""Payload: a mass at the tip that the URDF does not hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from calib.basics.arrays import Array, read_only
from calib.basics.records import key
from calib.basics.value_forms import POINT_MM, number
from calib.basics.values import Value
from calib.errors import ModelError


@dataclass(frozen=True, slots=True, eq=False)
class Payload(Value):
    """A point mass that the tip carries and that the URDF does not hold."""

    #: [kg], 0 or more.
    mass: float = key("mass_kg", number("kg"), "Mass at the tip.", json="mass_kg")
    #: shape (3,), its centre of mass in the frame of the tip [m].
    com: Array = key(
        "com_mm",
        POINT_MM,
        "Its centre of mass in the tip.",
        default_factory=lambda: np.zeros(3),
        absent="0, 0, 0",
        json="com_m",
    )

    def __post_init__(self) -> None:
        """Copy the centre of mass and check the numbers."""
        com = finite_vector(self.com, "centre of mass of a payload", "[m]")
        object.__setattr__(self, "com", com)
        if not (np.isfinite(self.mass) and self.mass >= 0):
            raise ModelError(
                f"The mass of a payload is {self.mass} kg; give a number of kg, 0 or more."
            )


def finite_vector(values: ArrayLike, name: str, unit: str) -> Array:
    """Return three finite numbers as a read-only array of shape (3,).

    Args:
        values: The numbers.
        name: Their name in the message, such as ``"acceleration of gravity"``.
        unit: Their unit in the message, such as ``"[m/s^2]"``.

    Raises:
        ModelError: They are not three, or not finite.
    """
    array = read_only(values)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise ModelError(f"The {name} is {values!r}; give three finite numbers {unit}.")
    return array
