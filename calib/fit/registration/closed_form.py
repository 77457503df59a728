"""Frames and targets in closed form, on given poses of the tip: solutions of linear equations, else starts.

With the rotation R_f and translation s_f of frame f (T_frame_base), the pose (R_i, p_i) of the tip at row i, and the
target at t in the tip, a measured point is m_i = R_f (R_i t + p_i) + s_f: linear in t and s_f if R_f is known. A
measured orientation is M_i = R_f R_i R_t, linear in R_f and R_t as M_i R_t^T - R_f R_i = 0 (M. Shah, 2013).
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array, Integers
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup

#: Directions of a frame's translation.
_TRANSLATIONS = ("x", "y", "z")

#: Singular values below this share of the largest are zero.
_RANK_TOLERANCE = 1e-9

#: The fewest points that determine a frame's pose.
_FEWEST_POINTS = 3


def linear_setup(setup: Setup, T_base_tip: Array, rows: Rows) -> Setup | None:
    """Estimate targets and translations of frames by linear least squares, unweighted.

    The equations are R_f R_i t + ds_f = m_i - R_f p_i - s_f, for positions t of targets and changes ds_f of the
    translations of frames.

    Args:
        setup: Its rotations of frames are known, and so are the poses that are not estimated.
        T_base_tip: shape (N, 4, 4), pose of the tip at each row [m].
        rows: N rows.

    Returns:
        The setup with estimated translations, and targets turned as they were measured (see
        `with_measured_target_rotations`); targets that no row sees stay. None if a rotation of a frame is estimated, or
        the kind of a row does not compare the target's three coordinates (``point``, ``pose``, ``fixed`` do).
    """
    unknown = {direction for directions in setup.unknown for direction in directions}
    only_coordinates = all(kind.coordinates and not kind.readings for kind in rows.present)
    if not unknown.issubset(_TRANSLATIONS) or not only_coordinates:
        return None

    T_frame_tip = setup.T_frame_base[rows.samples.frame] @ T_base_tip
    R_frame_tip = T_frame_tip[:, :3, :3]
    samples = rows.samples

    # The matrix of R_f R_i t + ds_f by the positions t of targets and the changes ds_f; columns of targets and
    # translations that are not estimated are zero.
    targets = len(setup.targets)
    A = np.zeros((len(samples), 3, 3 * (targets + len(setup.groups))))
    to_unknown = np.flatnonzero(setup.target_unknown[samples.target])  # rows
    first_column = 3 * samples.target[to_unknown]
    for k, axis in enumerate(_TRANSLATIONS):
        A[to_unknown, :, first_column + k] = R_frame_tip[to_unknown, :, k]
        for f, directions in enumerate(setup.unknown):
            if axis in directions:
                A[samples.frame == f, k, 3 * (targets + f) + k] = 1.0

    measured = np.zeros((len(rows), 3))
    has_position = rows.where(lambda kind: kind.position)
    if np.any(has_position):
        measured[has_position] = rows.measured[has_position, :3]
    target = samples.target
    lever = np.einsum("nij,nj->ni", R_frame_tip, setup.T_tip_target[target, :3, 3])
    known_lever = np.where(setup.target_unknown[target, None], 0.0, lever)
    rhs = measured - T_frame_tip[:, :3, 3] - known_lever
    x, *_ = np.linalg.lstsq(A.reshape(-1, A.shape[2]), rhs.ravel(), rcond=_RANK_TOLERANCE)

    positions, changes = np.split(x.reshape(-1, 3), [targets])
    T_frame_base = setup.T_frame_base.copy()
    T_frame_base[:, :3, 3] += changes
    T_tip_target = setup.T_tip_target.copy()
    _, seen_targets = setup.seen_by(rows.samples)
    observed = seen_targets & setup.target_unknown
    T_tip_target[observed, :3, 3] = positions[observed]
    result = setup.with_poses(T_frame_base, T_tip_target)
    if setup.rotation:
        return with_measured_target_rotations(result, T_base_tip, rows)
    return result


def orientation_setup(setup: Setup, T_base_tip: Array, rows: Rows) -> Setup | None:
    """Estimate frames that are wholly unknown and the targets from measured orientations, then from positions.

    Frames that are estimated in part keep their rotation.

    Args:
        setup: The frames and targets.
        T_base_tip: shape (N, 4, 4), pose of the tip at each row [m].
        rows: N rows.

    Returns:
        The setup with the estimated poses; None if no frame is wholly unknown, no target is estimated, or a row has no
        orientation or no position.
    """
    oriented = rows.where(lambda kind: kind.orientation)
    if not np.any(setup.wholly_unknown) or not setup.estimate_target or not np.all(oriented):
        return None
    T_frame_base = setup.T_frame_base.copy()
    for f in np.flatnonzero(setup.wholly_unknown):
        of_frame = np.flatnonzero(rows.samples.frame == f)
        if not len(of_frame):
            continue
        # One target determines the frame, the one that it sees most often; all targets follow from the frames.
        target = rows.samples.target[of_frame]
        of_target = of_frame[target == np.bincount(target).argmax()]
        R_measured = rows.measured[of_target, 3:12].reshape(-1, 3, 3)
        T_frame_base[f, :3, :3] = _frame_rotation(T_base_tip[of_target, :3, :3], R_measured)
    turned = setup.with_poses(T_frame_base, setup.T_tip_target)
    turned = with_measured_target_rotations(turned, T_base_tip, rows)

    # With the rotations known, translations of frames and positions of targets are left.
    translations = []
    for directions in setup.unknown:
        kept = [direction for direction in directions if direction in _TRANSLATIONS]
        translations.append(tuple(kept))
    to_translate = replace(turned, unknown=tuple(translations), rotation=False)
    result = linear_setup(to_translate, T_base_tip, rows)
    if result is None:
        return None
    return setup.with_poses(result.T_frame_base, result.T_tip_target)


def _frame_rotation(R_tip: Array, R_measured: Array) -> Array:
    """R_f of one frame, (3, 3), by M_i R_t^T - R_f R_i = 0 of n rows of one target (M. Shah, 2013).

    R_i, (n, 3, 3), are the orientations of the tip in the base, M_i, (n, 3, 3), those of the target in the frame.
    """
    A = np.zeros((len(R_tip), 9, 18))
    for a, b in itertools.product(range(3), repeat=2):
        # Entry (a, b) of the equation; the unknowns are R_f, then R_t^T, each row by row.
        A[:, 3 * a + b, 9 + b : 18 : 3] = R_measured[:, a]
        A[:, 3 * a + b, 3 * a : 3 * a + 3] = -R_tip[:, :, b]
    _, eigenvectors = np.linalg.eigh(np.einsum("nij,nik->jk", A, A))
    R, _ = eigenvectors[:, 0].reshape(2, 3, 3)
    return nearest_rotation(R if np.linalg.det(R) > 0.0 else -R)


def with_frames_fitted(setup: Setup, T_base_tip: Array, rows: Rows) -> Setup:
    """Fit each estimated frame to its rows, with the targets as they are.

    By measured points if there are three or more and the frame is wholly unknown, else by the kind of rows that locates
    its frame (`Kind.locate`) and has the most scalars (a socket before a plane), else only shifted by the mean of
    measured minus predicted points; without any it stays.

    Args:
        setup: Frames to be fitted, and targets.
        T_base_tip: shape (N, 4, 4), pose of the tip at each row [m].
        rows: N rows.

    Returns:
        The setup with fitted frames; fixed ones, and those that no row sees, stay as they are.
    """
    T_base_target = T_base_tip @ setup.T_tip_target[rows.samples.target]
    T_frame_base: Array = setup.T_frame_base.copy()
    for f, directions in enumerate(setup.unknown):
        of_frame = np.flatnonzero(rows.samples.frame == f)
        if directions and len(of_frame):
            T_frame_base[f] = _fit_frame(setup, f, T_base_target, rows, of_frame)
    return setup.with_poses(T_frame_base, setup.T_tip_target)


def _fit_frame(setup: Setup, f: int, T_base_target: Array, rows: Rows, of_frame: Integers) -> Array:
    """Fit frame f to its n rows, whose numbers are given, (n,): T_frame_base, (4, 4) [m]; see `with_frames_fitted`.

    ``T_base_target`` are the predicted poses of all rows' targets in the base, (N, 4, 4) [m].
    """
    T_frame_base = setup.T_frame_base[f]
    T_base_target = T_base_target[of_frame]
    points = T_base_target[:, :3, 3]
    measured = rows.measured[of_frame]
    has_position = rows.where(lambda kind: kind.position)[of_frame]
    if setup.wholly_unknown[f] and np.sum(has_position) >= _FEWEST_POINTS:
        return _frame_by_points(measured[has_position, :3], points[has_position])

    locating = []
    for kind in rows.present:
        of_kind = rows.where(kind.__eq__)[of_frame]
        if kind.locate is not None and np.any(of_kind):
            locating.append((kind, of_kind))
    if locating:
        kind, of_kind = max(locating, key=lambda one: len(one[0].units))
        assert kind.locate is not None
        places = T_base_target if kind.depends_on_orientation else points
        return kind.locate(places[of_kind], measured[of_kind, : kind.size], T_frame_base)

    result: Array = T_frame_base.copy()
    if np.any(has_position):
        predicted = points[has_position] @ T_frame_base[:3, :3].T + T_frame_base[:3, 3]
        shift = measured[has_position, :3] - predicted
        estimated = np.array([axis in setup.unknown[f] for axis in _TRANSLATIONS])
        result[:3, 3] += np.where(estimated, shift.mean(axis=0), 0.0)
    return result


def _frame_by_points(measured: Array, points: Array) -> Array:
    """T_frame_base, (4, 4) [m], that best maps points in the base, (n, 3), to measured ones (W. Kabsch, 1976)."""
    centre = points.mean(axis=0)
    measured_centre = measured.mean(axis=0)
    R = nearest_rotation((measured - measured_centre).T @ (points - centre))
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = measured_centre - R @ centre
    return T


def with_measured_target_rotations(setup: Setup, T_base_tip: Array, rows: Rows) -> Setup:
    """Turn the estimated targets to the mean of their measured orientations, with the frames as they are.

    Args:
        setup: Frames, and targets to be turned.
        T_base_tip: shape (N, 4, 4), pose of the tip at each row [m].
        rows: N rows.

    Returns:
        The setup with turned targets, at the same positions; fixed ones, and those without measured orientation, stay.
    """
    T_tip_target: Array = setup.T_tip_target.copy()
    T_frame_base = setup.T_frame_base[rows.samples.frame]
    R_frame_tip = T_frame_base[:, :3, :3] @ T_base_tip[:, :3, :3]
    oriented = rows.where(lambda kind: kind.orientation)
    for t in np.flatnonzero(setup.target_unknown):
        of_target = (rows.samples.target == t) & oriented
        if np.any(of_target):
            R_measured = rows.measured[of_target, 3:12].reshape(-1, 3, 3)
            total = np.einsum("nji,njk->ik", R_frame_tip[of_target], R_measured)
            T_tip_target[t, :3, :3] = nearest_rotation(total)
    return setup.with_poses(setup.T_frame_base, T_tip_target)


def with_held_axes(setup: Setup, T_base_tip: Array, rows: Rows) -> Setup:
    """Turn estimated targets so that their z axes, which their rows hold along those of the frames, turn least.

    While a hand lies flat on a plane, its tip turns about the normal alone. With the mean R_f of the tip's rotations at
    frame f an axis a of the tip has the mean direction R_f a, as long as a if it does not turn: a is the eigenvector of
    sum_f n_f R_f^T R_f of the largest eigenvalue.

    Args:
        setup: Frames, and targets to be turned.
        T_base_tip: shape (N, 4, 4), pose of the tip at each row [m].
        rows: N rows.

    Returns:
        The setup with these targets turned by the least angle; itself if no row holds an axis of an estimated target.
    """
    holding = rows.where(lambda kind: kind.holds_axis)
    T_tip_target: Array = setup.T_tip_target.copy()
    for t in np.flatnonzero(setup.target_unknown):
        total = np.zeros((3, 3))
        for f in range(len(setup.groups)):
            chosen = holding & (rows.samples.target == t) & (rows.samples.frame == f)
            if np.any(chosen):
                mean = T_base_tip[chosen, :3, :3].mean(axis=0)
                total += np.sum(chosen) * mean.T @ mean
        if np.any(total):
            R = T_tip_target[t, :3, :3]
            axis = R.T @ np.linalg.eigh(total)[1][:, -1]  # in the target
            axis = -axis if axis[2] < 0.0 else axis
            turn, _ = Rotation.align_vectors(axis[None], [[0.0, 0.0, 1.0]])
            T_tip_target[t, :3, :3] = R @ turn.as_matrix()
    if np.array_equal(T_tip_target, setup.T_tip_target):
        return setup
    return setup.with_poses(setup.T_frame_base, T_tip_target)


def nearest_rotation(M: Array) -> Array:
    """Return the proper rotation matrix, (3, 3), nearest to any matrix M, (3, 3), in the least-squares sense."""
    U, _, V = np.linalg.svd(M)
    handed = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ V))])
    return np.asarray(U @ handed @ V)
