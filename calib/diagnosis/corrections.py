"""Corrections of usual mistakes in a table's columns, each for a trial: other joint values, points or orientations.

Each comes with the code of the mistake that it undoes, and the values of its reason.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any, TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array
from calib.diagnosis.reasons import Why
from calib.robot.robot import Robot

#: Other values of some columns, the code of the mistake, and the values of its reason.
Correction: TypeAlias = tuple[Array, Why, dict[str, Any]]

#: Factors for angles that are in one unit although their header says another.
_ANGLES = {("rad", "deg"): np.degrees(1.0), ("deg", "rad"): np.radians(1.0)}

#: Factors for lengths that are in one unit although their header says another.
_LENGTHS = {("in", "mm"): 25.4, ("mm", "in"): 1.0 / 25.4, ("m", "mm"): 1e3, ("mm", "m"): 1e-3}

#: Offsets of joint zeros between conventions [deg].
_TURNS_DEG = (90.0, -90.0, 180.0)

#: Factors by which the reading of a joint counts that of the one before it: it is shown against the horizontal.
_COUPLINGS = (1.0, -1.0)


def correct_joints(robot: Robot, q: Array) -> Iterator[Correction]:
    """Shift zeros of joints, swap their columns, couple their readings, and scale them from another unit.

    Args:
        robot: The robot.
        q: Joint values of the rows, shape (N, m) [rad] or [m].

    Yields:
        Other joint values.
    """
    names, count = robot.joint_names, len(robot.inputs)
    turns = np.array([joint.type != "prismatic" for joint in robot.inputs])
    for i in np.flatnonzero(turns).tolist():
        yield from shift_zeros(names[i], i, q)
    for i, j in itertools.combinations(range(count), 2):
        order = list(range(count))
        order[i], order[j] = j, i
        yield q[:, order], Why.COLUMNS_SWAPPED, {"first": names[i], "second": names[j]}
    yield q[:, ::-1], Why.COLUMNS_REVERSED, {}

    # The reading of a joint counts that of the one before it, or not as the cell states.
    for i in np.flatnonzero(turns[:-1] & turns[1:]).tolist():
        values = {"joint": names[i + 1], "reading": names[i]}
        stated = float(robot.reading_matrix[i + 1, i])
        for factor in (*_COUPLINGS, 0.0):
            if factor == stated:
                continue
            of_joints = robot.input_values(q).copy()
            of_joints[:, i + 1] += (factor - stated) * q[:, i]
            readings = robot.readings(of_joints)
            if factor:
                yield readings, Why.READINGS_COUPLED, {**values, "factor": factor}
            else:
                yield readings, Why.READINGS_NOT_COUPLED, values

    for (unit, header), factor in _ANGLES.items():
        units = {"what": "joints", "unit": unit, "header": header}
        yield np.where(turns, factor, 1.0) * q, Why.WRONG_UNIT, units


def shift_zeros(name: str, joint: int, q: Array) -> Iterator[Correction]:
    """Shift the zero of a joint by a quarter turn either way, and by half a turn.

    Args:
        name: The joint's name.
        joint: Its number, from 0.
        q: Joint values of the rows, shape (N, m) [rad] or [m].

    Yields:
        Other joint values.
    """
    for turn in np.radians(_TURNS_DEG):
        offsets = turn * np.eye(q.shape[1])[joint]
        yield q + offsets, Why.JOINT_ZERO, {"add_rad": float(turn), "joint": name}


def correct_points(points: Array, *, turns: bool) -> Iterator[Correction]:
    """Mirror points, and scale them from another unit.

    Args:
        points: Measured positions, shape (N, 3) [m].
        turns: Whether their frame may turn freely: then every swap of two columns is a mirror, and so is every sign.

    Yields:
        Other points.
    """
    of_axes = dict(zip("xyz", np.eye(3, dtype=bool), strict=True))
    if turns:
        yield -points, Why.POINTS_MIRRORED, {}
    else:
        for axis, order in {"x": [0, 2, 1], "y": [2, 1, 0], "z": [1, 0, 2]}.items():
            first, second = (other for other in "xyz" if other != axis)
            yield points[:, order], Why.COLUMNS_SWAPPED, {"first": first, "second": second}
            signs = np.where(of_axes[axis], -1.0, 1.0)
            yield points * signs, Why.SIGN_TURNED, {"column": axis}

    for (unit, header), factor in _LENGTHS.items():
        units = {"unit": unit, "header": header}
        yield factor * points, Why.WRONG_UNIT, {"what": "points", **units}
        for axis, of_axis in of_axes.items():
            scaled = points * np.where(of_axis, factor, 1.0)
            yield scaled, Why.WRONG_UNIT, {"what": f"values of '{axis}'", **units}


def correct_orientations(poses: Array) -> Iterator[Correction]:
    """Read the orientations of poses by the conventions of other software, and as inverse ones.

    Args:
        poses: Position [m] and the nine entries of the rotation matrix, row after row, shape (N, 12).

    Yields:
        Other poses. The value ``"scalar"`` is where the scalar of the quaternions stands, ``"last"`` or ``"first"``, if
        it was read from the other end.
    """
    given = Rotation.from_matrix(poses[:, 3:12].reshape(-1, 3, 3))
    wxyz = given.as_quat(scalar_first=True)
    rotations: tuple[tuple[Rotation, Why, dict[str, Any]], ...] = (
        (Rotation.from_quat(wxyz), Why.SCALAR_ELSEWHERE, {"scalar": "last"}),
        (Rotation.from_quat(np.roll(wxyz, -2, 1)), Why.SCALAR_ELSEWHERE, {"scalar": "first"}),
        (given.inv(), Why.ORIENTATIONS_INVERSE, {}),
    )
    for R, why, values in rotations:
        yield np.hstack([poses[:, :3], R.as_matrix().reshape(-1, 9)]), why, values
