"""What a conversion has to say beside its file: codes with values; `calib.text.convert` has the sentences."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Code = Literal[
    "arm by name",
    "arm by kinematics",
    "arm not certain",
    "no hash",
    "nominal hash",
    "not linearised",
    "base displaced",
    "flange displaced",
    "digits lost",
    "other lines kept",
    "other lines left out",
    "joints without origin",
    "geometry alone",
    "nearly parallel axes",
    "taken as parallel",
    "joints without value",
]


class Note(NamedTuple):
    """A code and its values, in SI units."""

    code: Code
    values: tuple[str | float, ...] = ()


def displaced(code: Code, T: NDArray[np.float64]) -> tuple[Note, ...]:
    """A displacement T (4, 4) that a file has no place for: three lengths [m] and a rotation vector [rad]."""
    vector = np.round([*T[:3, 3], *pin.log3(T[:3, :3])], 9) + 0.0
    return (Note(code, tuple(vector.tolist())),) if np.any(vector) else ()
