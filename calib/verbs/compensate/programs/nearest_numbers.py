"""Numbers of an orientation that are near those written: of all triples, quaternions or vectors that mean the same.

    three angles about fixed or moving axes    (a, b, c) = (a + 180, 180 - b, c + 180), each up to 360 deg
    a quaternion                               q = -q
    a rotation vector                          v = v + 2 pi k v / |v|

Where the second angle is a right angle only the sum or the difference of the others is determined: the first one stays
as it is written.
"""

from __future__ import annotations

import numpy as np

from calib.basics.arrays import Array
from calib.data.forms.orientations import ROTATION_VECTOR, Convention

_TURN = 2.0 * np.pi

#: The cosine of a second angle below which that is a right angle.
_RIGHT_ANGLE = 1e-9

#: Matrices that differ by less are the same.
_SAME = 1e-6


def nearest_numbers(convention: Convention, R: Array, written: Array) -> Array:
    """Return the numbers of an orientation that are nearest to others.

    Args:
        convention: Convention of the numbers.
        R: Rotation matrix, shape (3, 3).
        written: The other numbers, shape (k,), angles [rad].

    Returns:
        shape (k,), angles [rad].
    """
    numbers = convention.numbers(R[None])[0]
    if convention.name == ROTATION_VECTOR.name:
        length = float(np.linalg.norm(numbers))
        axis = numbers / length if length > 0.0 else numbers
        turns = np.arange(-2, 3)[:, None]
        candidates = (length + _TURN * turns) * axis
    elif len(numbers) == 4:
        candidates = np.array([numbers, -numbers])
    elif convention.unit == "deg":
        candidates = _angles(convention, R, numbers, written)
    else:
        return np.asarray(numbers)
    return np.asarray(candidates[np.argmin(np.linalg.norm(candidates - written, axis=1))])


def _angles(convention: Convention, R: Array, numbers: Array, written: Array) -> Array:
    """Return triples of angles of one orientation, (n, 3) [rad], each as near to those written as whole turns go."""
    other = np.array([numbers[0] + np.pi, np.pi - numbers[1], numbers[2] + np.pi])
    candidates = np.array([numbers, other])
    if abs(np.cos(numbers[1])) < _RIGHT_ANGLE:
        first = written[0] - numbers[0]
        both = numbers + np.array([[first, 0.0, first], [first, 0.0, -first]])
        apart = np.abs(convention.matrices(both) - R).max(axis=(1, 2))
        candidates = np.concatenate([both[apart < _SAME], candidates])
    return np.asarray(candidates - _TURN * np.round((candidates - written) / _TURN))
