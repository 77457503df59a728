"""Vectors, rotations and poses: checks of given ones, and conversions between forms of a rotation."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from calib.basics.arguments import numbers
from calib.basics.arrays import Array, Mask, read_only
from calib.errors import CalibError

#: Largest coordinate [m] or joint value [m or rad] accepted: no robot gets there, and beyond it doubles are further
#: apart than the accuracy that calib computes to.
FARTHEST = 1e6

#: Largest coordinate of a target or a tool in the tip [m]: a larger number is in another unit.
FARTHEST_IN_TIP = 20.0

#: A rotation matrix written with seven digits is orthonormal to this.
_ORTHONORMAL_TOLERANCE = 1e-6

#: Below this angle [rad] the coefficient of the inverse right Jacobian is taken at its limit: the closed form cancels,
#: and the limit is exact to 1e-11.
_SMALL_ANGLE = 1e-4

#: Last row of a homogeneous transform.
_LAST_ROW = [0, 0, 0, 1]


def vector(value: ArrayLike, what: str) -> Array:
    """Return three given coordinates as a read-only copy.

    Args:
        value: x, y, z, shape (3,), each at most `FARTHEST`.
        what: Name of the value in the error message, such as ``"target"``.

    Returns:
        The coordinates, shape (3,), read-only.

    Raises:
        CalibError: The shape is another, or a coordinate is not finite or too large.
    """
    array = numbers(what, value, "three finite numbers x, y, z")
    in_range = np.abs(array) <= FARTHEST
    if array.shape != (3,) or not in_range.all():
        raise CalibError(
            f"The {what} is {array.tolist()}; it must be three finite numbers x, y, z, "
            f"none beyond {FARTHEST:g}."
        )
    return read_only(array)


def position_in_tip(value: ArrayLike, what: str) -> Array:
    """Return the position of a target or a tool in the tip [m] as a read-only copy.

    Args:
        value: x, y, z, shape (3,) [m].
        what: Name of the value in the error message, such as ``"target"``.

    Returns:
        The position, shape (3,) [m], read-only.

    Raises:
        CalibError: As of `vector`; or a coordinate is beyond `FARTHEST_IN_TIP`, as of millimetres taken for metres.
    """
    position = vector(value, what)
    if np.abs(position).max() > FARTHEST_IN_TIP:
        raise CalibError(
            f"The {what} is {position.tolist()} m in the tip, and none is further away than {FARTHEST_IN_TIP:g} m; "
            "give metres, in a cell file mm."
        )
    return position


def rotation_or_none(value: ArrayLike) -> Array | None:
    """Return a given value as a rotation matrix, shape (3, 3), read-only; None if it is not a rotation."""
    R = np.asarray(value, dtype=np.float64)
    if R.shape != (3, 3) or not_rotations(R[None]).any():
        return None
    return read_only(R)


def pose_or_none(value: ArrayLike) -> Array | None:
    """Return a given value as a pose, shape (4, 4) [m], read-only.

    None if it is not a homogeneous transform, or if a coordinate is beyond `FARTHEST`.
    """
    T = np.asarray(value, dtype=np.float64)
    if T.shape != (4, 4) or T[3].tolist() != _LAST_ROW:
        return None
    if rotation_or_none(T[:3, :3]) is None or not (np.abs(T) <= FARTHEST).all():
        return None
    return read_only(T)


def pose_of(xyz: ArrayLike | None = None, rotation: ArrayLike | None = None) -> Array:
    """Compose a pose from a translation and a rotation.

    Args:
        xyz: Translation, shape (3,) [m]; None: zero.
        rotation: Rotation matrix, shape (3, 3); None: no rotation.

    Returns:
        The homogeneous transform, shape (4, 4) [m].
    """
    T = np.eye(4)
    if rotation is not None:
        T[:3, :3] = rotation
    if xyz is not None:
        T[:3, 3] = xyz
    return T


def not_rotations(matrices: Array) -> Mask:
    """Mark matrices that are not finite, orthonormal and right-handed.

    Args:
        matrices: shape (N, 3, 3).

    Returns:
        True for each matrix that is not a rotation, shape (N,).
    """
    product = np.swapaxes(matrices, 1, 2) @ matrices
    error = np.abs(product - np.eye(3)).max(axis=(1, 2), initial=0.0)
    determinant = np.linalg.det(np.nan_to_num(matrices))
    good = (error <= _ORTHONORMAL_TOLERANCE) & (determinant > 0.0)
    return np.asarray(~good, dtype=np.bool_)


def to_matrices(orientations: Array) -> Array:
    """Convert quaternions or rotation vectors to rotation matrices.

    Args:
        orientations: Quaternions (x, y, z, w), shape (N, 4), or rotation vectors, shape (N, 3)
            [rad]; a row with a NaN stands for no measurement.

    Returns:
        Rotation matrices, shape (N, 3, 3); NaN where there is no measurement.
    """
    result = np.full((len(orientations), 3, 3), np.nan)
    measured = np.isfinite(orientations).all(axis=1)
    if measured.any():
        is_quaternion = orientations.shape[1] == 4
        make = Rotation.from_quat if is_quaternion else Rotation.from_rotvec
        result[measured] = make(orientations[measured]).as_matrix()
    return result


def to_quaternions(rotations: Array) -> Array:
    """Convert rotation matrices to unit quaternions (x, y, z, w) with w >= 0.

    Args:
        rotations: shape (N, 3, 3); a matrix with a NaN stands for no measurement.

    Returns:
        Quaternions, shape (N, 4); NaN where there is no measurement.
    """
    result = np.full((len(rotations), 4), np.nan)
    measured = np.isfinite(rotations).all(axis=(1, 2))
    if measured.any():
        result[measured] = Rotation.from_matrix(rotations[measured]).as_quat(canonical=True)
    return result


def to_rotation_vectors(rotations: Array) -> Array:
    """Convert rotation matrices to rotation vectors, of length pi at most.

    Args:
        rotations: shape (N, 3, 3); a matrix with a NaN stands for no measurement.

    Returns:
        Rotation vectors, shape (N, 3), [rad]; NaN where there is no measurement.
    """
    result = np.full((len(rotations), 3), np.nan)
    measured = np.isfinite(rotations).all(axis=(1, 2))
    if measured.any():
        result[measured] = Rotation.from_matrix(rotations[measured]).as_rotvec()
    return result


def inverse_right_jacobian(rotations: Rotation) -> Array:
    """Return the inverse right Jacobians of SO(3) at N rotations E: log(E exp(w)) = log(E) + J w for small w.

    With r = log(E) and t = |r|

        J = I + [r]x / 2 + (1 / t^2 - 1 / (2 t tan(t / 2))) [r]x^2,

    finite up to t = pi (J. Sola et al., "A micro Lie theory for state estimation in robotics", 2018).

    Returns:
        The matrices J, shape (N, 3, 3).
    """
    r = rotations.as_rotvec()
    t = np.linalg.norm(r, axis=1)
    is_small = t < _SMALL_ANGLE
    safe = np.where(is_small, 1.0, t)
    factor = 1.0 / safe**2 - 0.5 / (safe * np.tan(0.5 * safe))
    factor = np.where(is_small, 1.0 / 12.0, factor)
    upper = np.zeros((len(r), 3, 3))
    upper[:, 0, 1] = -r[:, 2]
    upper[:, 0, 2] = r[:, 1]
    upper[:, 1, 2] = -r[:, 0]
    cross = upper - upper.transpose(0, 2, 1)  # [r]x
    result: Array = np.eye(3) + 0.5 * cross + factor[:, None, None] * (cross @ cross)
    return result
