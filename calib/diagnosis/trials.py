"""Trials of other inputs: poses in place of images, corrected columns, and the errors that a robot has with them.

A correction of a table's columns undoes a usual mistake: other joint values, points or orientations, with the mistake.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array
from calib.basics.units import UNITS
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Reason, Why
from calib.fit.registration.registration import register
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.fit.registration.table_rows import rows_and_setup
from calib.fit.registration.views import views_as_poses
from calib.numerics.errors import Errors
from calib.robot.dh_rows import DHRobot
from calib.robot.robot import Robot

#: Other values of some columns, and the mistake that they undo, without errors.
Correction: TypeAlias = tuple[Array, Reason]

#: Nominal errors of positions below this need no other explanation than an uncalibrated arm [m].
PLAUSIBLE = 0.02

#: The same of orientations [rad].
PLAUSIBLE_ANGLE = 0.1

#: A mistake is named only if undoing it lowers the error to this share.
FAR_BETTER = 0.2

#: Explanations whose errors are within this factor cannot be distinguished: errors of an uncalibrated arm favour any.
AS_GOOD = 1.5

#: Trials that are registered after a screen of all: more than there are explanations as good as the best.
REGISTERED = 12

#: Factors between units of angles, which undo a wrong unit.
_ANGLES = (float(np.degrees(1.0)), float(np.radians(1.0)))

#: Factors of a joint that have an explanation of their own: its sign, and a unit.
SIMPLE_FACTORS = (1.0, *_ANGLES)

#: Factors between units of lengths (m, cm, mm and inches), which undo a wrong unit.
_LENGTHS = (1e3, 1e-3, 10.0, 0.1, 100.0, 0.01, 25.4, 1.0 / 25.4, 2.54, 1.0 / 2.54)

#: Relative difference of factors that are one: units are exact.
_SAME_FACTOR = 1e-9

#: Offsets of joint zeros between conventions [deg]: quarter turns, and halves of them, as of flanges.
_TURNS_DEG = (90.0, -90.0, 180.0, 45.0, -45.0, 135.0, -135.0)

#: Factors by which the reading of a joint counts that of the one before it: it is shown against the horizontal.
_COUPLINGS = (1.0, -1.0)

#: Tolerance of a registration: five digits are enough to compare.
TOLERANCE = 1e-6


# Rows and their errors


def _tip_poses(robot: Robot | DHRobot, rows: Rows) -> Array:
    """Return T_base_tip of rows, each by its own chain, (N, 4, 4) [m]; DH rows are one chain."""
    if isinstance(robot, DHRobot):
        return robot.poses(rows.joints)
    return robot.poses(rows.joints, rows.samples.chain)


def misfit(robot: Robot | DHRobot, setup: Setup, rows: Rows) -> tuple[float, float]:
    """Register what the setup leaves unknown, and return the errors of the robot then.

    Args:
        robot: The robot, or its DH rows, with the joints of the rows in their order.
        setup: Frames and targets, with what is registered.
        rows: Rows of points or poses.

    Returns:
        The rms error of positions [m], the norm of three scalars, and of orientations [rad]; the latter is NaN for
        points.
    """
    T_base_tip = _tip_poses(robot, rows)
    registered = register(T_base_tip, setup, rows, tolerance=TOLERANCE)
    errors = Errors.of(rows.residual(registered.sightings(T_base_tip, rows.samples)), rows.channels)
    return errors["m"].rms, errors["rad"].rms


def with_joints(rows: Rows, q: Array) -> Rows:
    """Copy rows with other joint values, shape (N, m) [rad] or [m]."""
    return replace(rows, samples=replace(rows.samples, q=q))


def poses_of_images(
    robot: Robot, cell: Cell, table: Measurements
) -> tuple[Measurements, Cell] | None:
    """Replace a table of images by the poses of the boards that they show, one row a view (a board in an image).

    Args:
        robot: The nominal robot.
        cell: The cell as given.
        table: Rows of any kind.

    Returns:
        The poses of the board in the camera, with the row number and the joint values of the first corner of each view,
        and the cell with cameras as measurement frames that are estimated unless they are given; None if the table is
        empty or some row is not a corner in an image.
    """
    if not len(table) or not np.all(table.is_image):
        return None
    rows, setup = rows_and_setup(robot, table, cell)
    views, source_rows = views_as_poses(rows)
    mask = np.zeros(len(table), dtype=bool)
    mask[source_rows] = True
    first = table.select(mask)
    poses = replace(
        first,
        kinds=("pose",) * len(first),
        points=views.measured[:, :3],
        rotations=views.measured[:, 3:12].reshape(-1, 3, 3),
        readings={},
        board_points=None,
        sigma={},
        images=(),
        corners=(),
    )
    estimated = any(bool(directions) for directions in setup.unknown)
    return poses, replace(cell, estimate_frame=estimated, kind=None)


# Corrections of columns


def correct_columns(
    robot: Robot, q: Array, units: Mapping[str, str]
) -> Iterator[tuple[int, Correction]]:
    """Shift the zero of each joint in turn, reverse its sign, and scale it from another unit.

    Args:
        robot: The robot, with its m measured joints.
        q: Readings of the joints in the rows, shape (N, m) [rad] or [m].
        units: Symbol of the unit of each column as it was read, by name; a column may be missing.

    Yields:
        The number of the joint, from 0, and a correction, see `correct_joints`.
    """
    for i, (name, joint) in enumerate(zip(robot.joint_names, robot.inputs, strict=True)):
        column = np.arange(q.shape[1]) == i
        turns = joint.type != "prismatic"
        yield i, (np.where(column, -q, q), Reason.of(Why.JOINTS_TURNED, joints=name))
        if turns:
            for shift in shift_zeros(name, i, q):
                yield i, shift
        for factor in _ANGLES if turns else _LENGTHS:
            wrong = wrong_unit(f"values of '{name}'", factor, units.get(name))
            yield i, (np.where(column, factor * q, q), wrong)


def correct_joints(robot: Robot, q: Array, units: Mapping[str, str]) -> Iterator[Correction]:
    """Swap columns of joints, couple their readings, and scale all of them from another unit.

    Args:
        robot: The robot, with its m measured joints and the coupling of their readings.
        q: Readings of the joints in the rows, shape (N, m) [rad] or [m].
        units: Symbol of the unit of each column as it was read, by name; a column may be missing.

    Yields:
        Readings, shape (N, m), in which one mistake is undone, and the mistake.
    """
    names, count = robot.joint_names, len(robot.inputs)
    turns = np.array([joint.type != "prismatic" for joint in robot.inputs])
    for i, j in itertools.combinations(range(count), 2):
        order = list(range(count))
        order[i], order[j] = j, i
        yield q[:, order], Reason.of(Why.COLUMNS_SWAPPED, first=names[i], second=names[j])
    yield q[:, ::-1], Reason.of(Why.COLUMNS_REVERSED)

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
                yield readings, Reason.of(Why.READINGS_COUPLED, **values, factor=factor)
            else:
                yield readings, Reason.of(Why.READINGS_NOT_COUPLED, **values)

    stated_units = {units.get(name) for name, turn in zip(names, turns, strict=True) if turn}
    unit = stated_units.pop() if len(stated_units) == 1 else None
    for factor in _ANGLES:
        wrong = wrong_unit("joint values", factor, unit)
        yield np.where(turns, factor, 1.0) * q, wrong


def wrong_unit(what: str, factor: float, stated: str | None) -> Reason:
    """Name values in a wrong unit: the factor that undoes it, and both units if it is that between two units.

    Args:
        what: The values in words: ``"joint values"``.
        factor: Factor on values in SI units.
        stated: Symbol of the unit that they were read in; None if it is not known.

    Returns:
        The mistake, with ``"what"``; ``"factor"``; ``"unit"``, the true one; and ``"header"``, the stated one. The
        latter two are missing if no unit of the same quantity is so many times the stated one: then the values were
        converted twice, or not at all, before they were written.
    """
    units = {}
    if stated is not None:
        read = UNITS[stated]
        for unit in UNITS.values():
            is_true = np.isclose(unit.to_si, factor * read.to_si, rtol=_SAME_FACTOR, atol=0.0)
            if unit.quantity == read.quantity and is_true:
                units = {"unit": unit.symbol, "header": stated}
    return Reason.of(Why.WRONG_UNIT, what=what, factor=factor, **units)


def shift_zeros(name: str, joint: int, q: Array) -> Iterator[Correction]:
    """Shift the zero of a turning joint by a multiple of 45 deg.

    Args:
        name: The joint's name.
        joint: Its number, from 0.
        q: Joint values of the rows, shape (N, m) [rad] or [m].

    Yields:
        Joint values, shape (N, m), with the turn added to this joint's; and the mistake, a wrong zero, with the turn
        [rad] and the joint's name.
    """
    for turn in np.radians(_TURNS_DEG):
        offsets = turn * np.eye(q.shape[1])[joint]
        yield q + offsets, Reason.of(Why.JOINT_ZERO, add_rad=float(turn), joint=name)


def scale_column(name: str, joint: int, q: Array, factors: Array) -> Iterator[Correction]:
    """Scale the readings of one joint by factors: as by another gear ratio, or by percents.

    Args:
        name: The joint's name.
        joint: Its number, from 0.
        q: Joint values of the rows, shape (N, m) [rad] or [m].
        factors: Factors on this joint's values, shape (F,).

    Yields:
        For each factor the joint values, shape (N, m), and the mistake.
    """
    for factor in factors.tolist():
        scaled = q * np.where(np.arange(q.shape[1]) == joint, factor, 1.0)
        yield scaled, Reason.of(Why.JOINT_FACTOR, joint=name, factor=factor)


def correct_points(points: Array, units: Mapping[str, str], *, turns: bool) -> Iterator[Correction]:
    """Mirror points, and scale them from another unit.

    Args:
        points: Measured positions, shape (N, 3) [m].
        units: Symbol of the unit of ``x``, ``y`` and ``z`` as they were read; any may be missing.
        turns: Whether their frame may turn freely: then every swap of two columns is a mirror, and so is every sign.

    Yields:
        Points, shape (N, 3) [m], in which one mistake is undone, and the mistake.
    """
    of_axes = dict(zip("xyz", np.eye(3, dtype=bool), strict=True))
    if turns:
        yield -points, Reason.of(Why.POINTS_MIRRORED)
    else:
        for axis, order in {"x": [0, 2, 1], "y": [2, 1, 0], "z": [1, 0, 2]}.items():
            first, second = (other for other in "xyz" if other != axis)
            yield points[:, order], Reason.of(Why.COLUMNS_SWAPPED, first=first, second=second)
            signs = np.where(of_axes[axis], -1.0, 1.0)
            yield points * signs, Reason.of(Why.SIGN_TURNED, column=axis)

    for factor in _LENGTHS:
        yield factor * points, wrong_unit("points", factor, units.get("x"))
        for axis, of_axis in of_axes.items():
            scaled = points * np.where(of_axis, factor, 1.0)
            yield scaled, wrong_unit(f"values of '{axis}'", factor, units.get(axis))


def correct_orientations(poses: Array) -> Iterator[Correction]:
    """Read the orientations of poses by the conventions of other software, and as inverse ones.

    Args:
        poses: Position [m] and the nine entries of the rotation matrix, row after row, shape (N, 12).

    Yields:
        Poses, shape (N, 12), with the same positions, in which one mistake is undone; and the mistake. Its value
        ``"scalar"`` is where the scalar of the quaternions stands, ``"last"`` or ``"first"``, if it was read from the
        other end.
    """
    given = Rotation.from_matrix(poses[:, 3:12].reshape(-1, 3, 3))
    wxyz = given.as_quat(scalar_first=True)
    rotations = (
        (Rotation.from_quat(wxyz), Reason.of(Why.SCALAR_ELSEWHERE, scalar="last")),
        (Rotation.from_quat(np.roll(wxyz, -2, 1)), Reason.of(Why.SCALAR_ELSEWHERE, scalar="first")),
        (given.inv(), Reason.of(Why.ORIENTATIONS_INVERSE)),
    )
    for R, mistake in rotations:
        yield np.hstack([poses[:, :3], R.as_matrix().reshape(-1, 9)]), mistake
