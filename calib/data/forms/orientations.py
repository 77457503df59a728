"""Conventions of orientations in tables: their columns, and the rotation matrix that their numbers stand for.

    three angles about fixed axes x, y, z     R = Rz(z) Ry(y) Rx(x)
    three angles about moving axes x, y, z    R = Rx(x) Ry(y) Rz(z)

A convention is one row of `CONVENTIONS`. Where the second of three angles is a right angle only a sum of the other two
is determined; then the angle about z (fixed axes), or about x (moving axes), is whatever makes both agree.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from calib.basics.arrays import Array
from calib.errors import MeasurementError, choices, did_you_mean
from calib.numerics.geometry import to_matrices, to_quaternions, to_rotation_vectors

#: Order in which ABB writes the numbers x, y, z, w of a quaternion.
_SCALAR_FIRST = [3, 0, 1, 2]

#: Order in which `to_matrices` takes the numbers w, x, y, z of a quaternion.
_SCALAR_LAST = [1, 2, 3, 0]


@dataclass(frozen=True, slots=True)
class Convention:
    """A way to write an orientation as numbers in columns."""

    #: Its name, as ``--orientation`` takes it.
    name: str
    #: The columns' names; single capital letters are read as written, others in any case.
    columns: tuple[str, ...]
    #: Unit in which the numbers are usually written; empty: they have none.
    unit: str
    #: Its description for messages: ``"a quaternion"``.
    words: str
    #: Rotation matrices, shape (N, 3, 3), of numbers, shape (N, k), in SI units; NaN where a number is.
    matrices: Callable[[Array], Array]
    #: Numbers, shape (N, k), in SI units, of rotation matrices, shape (N, 3, 3); NaN where one of a matrix is.
    numbers: Callable[[Array], Array]


# Three angles


def _about_fixed_axes(angles: Array) -> Array:
    """Return R = Rz(z) Ry(y) Rx(x), shape (N, 3, 3), of angles x, y, z, shape (N, 3), [rad]."""
    sx, sy, sz = np.sin(angles).T
    cx, cy, cz = np.cos(angles).T
    entries = [
        [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
        [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
        [-sy, cy * sx, cy * cx],
    ]
    return np.stack([np.stack(row, axis=1) for row in entries], axis=1)


def _angles_about_fixed_axes(R: Array) -> Array:
    """Return the angles x, y, z, shape (N, 3), [rad], of rotation matrices R = Rz(z) Ry(y) Rx(x), shape (N, 3, 3).

    y is from -90 deg to 90 deg. x is that of Rz(-z) R = Ry(y) Rx(x), so that at a right angle y, where z is any, both
    agree to the last digits.
    """
    z = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    sz, cz = np.sin(z), np.cos(z)
    y = np.arctan2(-R[:, 2, 0], cz * R[:, 0, 0] + sz * R[:, 1, 0])
    x = np.arctan2(sz * R[:, 0, 2] - cz * R[:, 1, 2], cz * R[:, 1, 1] - sz * R[:, 0, 1])
    return np.column_stack([x, y, z])


# Matrices


def _nearest_rotations(numbers: Array) -> Array:
    """Return the rotations (N, 3, 3) nearest to matrices r11, r12 ... r33, (N, 9), of few digits; NaN stays.

    With M = U S V^T the nearest rotation is U V^T.
    """
    result = np.full((len(numbers), 3, 3), np.nan)
    measured = np.isfinite(numbers).all(axis=1)
    U, _, Vt = np.linalg.svd(numbers[measured].reshape(-1, 3, 3))
    result[measured] = U @ Vt
    return result


# The conventions

QUATERNION = Convention(
    "quaternion", ("qx", "qy", "qz", "qw"), "", "a quaternion", to_matrices, to_quaternions
)

ROTATION_VECTOR = Convention(
    "rotation-vector",
    ("rx", "ry", "rz"),
    "rad",
    "a rotation vector",
    to_matrices,
    to_rotation_vectors,
)

_ROWS = (
    QUATERNION,
    # First of those with its columns: what they are unless something else is said.
    ROTATION_VECTOR,
    Convention(
        "rpy",
        ("roll", "pitch", "yaw"),
        "deg",
        "roll, pitch, yaw about fixed axes",
        _about_fixed_axes,
        _angles_about_fixed_axes,
    ),
    Convention(
        "abb",
        ("q1", "q2", "q3", "q4"),
        "",
        "a quaternion with the scalar first, as ABB's",
        lambda numbers: to_matrices(numbers[:, _SCALAR_LAST]),
        lambda R: to_quaternions(R)[:, _SCALAR_FIRST],
    ),
    Convention(
        "kuka",
        ("A", "B", "C"),
        "deg",
        "KUKA's A, B, C",
        lambda numbers: _about_fixed_axes(numbers[:, ::-1]),
        lambda R: _angles_about_fixed_axes(R)[:, ::-1],
    ),
    Convention(
        "fanuc",
        ("W", "P", "R"),
        "deg",
        "FANUC's W, P, R",
        _about_fixed_axes,
        _angles_about_fixed_axes,
    ),
    Convention(
        "staubli",
        ("rx", "ry", "rz"),
        "deg",
        "Stäubli's Rx, Ry, Rz about moving axes",
        # Rx(x) Ry(y) Rz(z) is the transpose of Rz(-z) Ry(-y) Rx(-x).
        lambda angles: np.swapaxes(_about_fixed_axes(-angles), 1, 2),
        lambda R: -_angles_about_fixed_axes(R.transpose(0, 2, 1)),
    ),
    Convention(
        "yaskawa",
        ("rx", "ry", "rz"),
        "deg",
        "Yaskawa's Rx, Ry, Rz about fixed axes",
        _about_fixed_axes,
        _angles_about_fixed_axes,
    ),
    Convention(
        "matrix",
        ("r11", "r12", "r13", "r21", "r22", "r23", "r31", "r32", "r33"),
        "",
        "a rotation matrix",
        _nearest_rotations,
        lambda R: R.reshape(-1, 9),
    ),
)

#: All conventions by name; of those with the same columns the first counts if nothing else is said.
CONVENTIONS: Mapping[str, Convention] = MappingProxyType({row.name: row for row in _ROWS})

#: Names of columns as written here, by those that are read in any case, in lower case.
IN_ANY_CASE: Mapping[str, str] = MappingProxyType(
    {name.casefold(): name for row in _ROWS for name in row.columns if len(name) > 1}
)


def find_convention(name: str) -> Convention:
    """Return the convention of a name, as ``--orientation`` gives it; raises `MeasurementError`."""
    if name not in CONVENTIONS:
        raise MeasurementError(
            f"There is no convention of orientations '{name}' (--orientation)"
            f"{did_you_mean(name, CONVENTIONS)}; there are {choices(CONVENTIONS)}."
        )
    return CONVENTIONS[name]
