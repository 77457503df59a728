"""Bodies of stops: which rows are of one stop, and how their scalars change with the displacement of its body.

A stop is one standstill of the robot at which several targets are measured, which are parts of one rigid body; see
`calib.fit.estimate.stop_errors`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.basics.arrays import Array, Integers
from calib.fit.estimate.stop_shares import PARTS, transposed
from calib.fit.registration.rows import Rows
from calib.fit.registration.same_poses import same_poses
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics, Samples


def stop_of_rows(rows: Rows) -> Integers | None:
    """Number the stop of each row: one standstill of the robot at which several targets are measured.

    Rows of a stop have one pose, one measurement frame and one kind of measurement.

    Args:
        rows: N rows of measurements: joint values (``rows.joints``, shape (N, m), [rad or m]), and indices of frame and
            target (``rows.samples``), and of kind (``rows.kind``), of each; rows of one number in ``rows.blocks`` are
            of one pose, or of the two poses of a pair.

    Returns:
        shape (N,), number of each row's stop, >= 0, the same for all rows of a stop, not all numbers being used; -1 for
        rows of a stop with one target, or of a kind that measures no position. None where all are such.
    """
    measured_point = rows.poses  # of one frame, target and corner at one pose
    if not len(rows) or len(np.unique(measured_point)) == len(np.unique(rows.blocks)):
        return None
    # The two poses of a pair are one block.
    pose = same_poses(rows.joints) if np.any(rows.partner >= 0) else rows.blocks
    labels = np.column_stack([pose, rows.samples.frame, rows.kind])
    stop = np.unique(labels, axis=0, return_inverse=True)[1].reshape(-1)
    stop_and_point = np.unique(np.column_stack([stop, measured_point]), axis=0)
    points_of_stop = np.bincount(stop_and_point[:, 0])
    several = points_of_stop[stop] > 1
    chosen = several & rows.where(lambda kind: kind.position or kind.optical)
    if not np.any(chosen):
        return None
    return np.where(chosen, stop, -1)


def twists_of_bodies(origins: Array, points: Array, stops: Integers, counts: Array) -> Array:
    """Differentiate the poses of targets by the displacements of their bodies, which turn about their centroids.

    Args:
        origins: shape (K, 3), position of the origin of each row's target in its measurement frame [m].
        points: shape (K, 3), position of the measured point of each of K rows in its measurement frame, which is the
            target's origin or a corner of a board [m].
        stops: shape (K,), points of one number are of one body, which is the body at one stop (standstill of the
            robot).
        counts: shape (K,), weight of each point in its body's centroid, > 0.

    Returns:
        shape (K, 6, 6), twist of the target at each point along the frame's axes, linear then angular along the rows,
        by a unit of each direction of its body's displacement along the columns: three translations along these axes
        [m], three rotations about them [rad].
    """
    body = np.unique(stops, return_inverse=True)[1].reshape(-1)
    sums = np.stack([np.bincount(body, counts * column) for column in points.T], axis=1)
    centroids = sums / np.bincount(body, counts)[:, None]
    lever = origins - centroids[body]
    twists = np.zeros((len(points), 6, 6))
    twists[:] = np.eye(6)
    # Column k is e_k x lever.
    twists[:, :3, 3:] = transposed(np.cross(np.eye(3), lever[:, None]))
    return twists


def twists_of_joints(kinematics: Kinematics, samples: Samples) -> Array:
    """Differentiate the poses of targets by the joints that turn: the nominal robot misses a stop by their errors.

    Joints that slide are left out: their errors, in another unit, are translations of the body.

    Args:
        kinematics: The nominal robot, and frames and targets as registered.
        samples: K samples of it.

    Returns:
        shape (K, 6, j), twist of the target along the frame's axes, linear [m] then angular [rad], by a radian of each
        of j joints.
    """
    zeros = error_model(
        kinematics.robot,
        "zeros",
        frame=dict.fromkeys(map(str, range(len(kinematics.T_frame_base))), ()),
        target=False,
        targets=[str(k) for k in range(len(kinematics.T_tip_target))],
    )
    turning = [k for k, parameter in enumerate(zeros.parameters) if parameter.unit == "rad"]
    of_zeros = replace(kinematics, model=zeros)
    _, twists = of_zeros.twists(np.zeros(len(zeros)), samples)
    return twists[:, :, turning]


def of_unit_size(J: Array, instruments: NDArray[np.int8], counts: Array) -> Array:
    """Scale Jacobians by displacements of bodies to unit mean square: translations, rotations, and joints apart.

    After this a translation whose three components have the variance 1 each moves an instrument's scalars with a mean
    variance of 1, and so does a rotation, and so do errors of the joints.

    Args:
        J: shape (K, D, d), Jacobian of the D scalars of each of K rows, in units of their sigma, by its body's
            displacement: three translations [m], three rotations [rad], the joints [rad].
        instruments: shape (K, D), index of each scalar's instrument, from 0; -1 for no scalar.
        counts: shape (K,), weight of each row in the mean.

    Returns:
        shape (K, D, d): of each instrument the sum of squares over the three translations has the mean 1 over its
        scalars, and so have that over the rotations and that over the joints. 0 where there is no scalar, or the part
        moves none of an instrument's.
    """
    result = np.zeros(J.shape)
    for c in range(int(instruments.max()) + 1):
        of_instrument = instruments == c
        weight = counts[:, None] * of_instrument
        for part in PARTS:
            square = float(np.sum(weight[:, :, None] * J[:, :, part] ** 2))
            if square > 0.0:
                scale = np.sqrt(np.sum(weight) / square)
                result[:, :, part] += scale * of_instrument[:, :, None] * J[:, :, part]
    return result
