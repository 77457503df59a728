"""Starts: where frames and targets may stand, in closed form, from the nominal robot's poses.

What is linear in the unknowns is solved outright: a target under known frames, a frame around known targets, the
rotations of both sides of a pose; a socket, an anchor, a plane, as their kinds say. What is not is left to
`calib.identify.registration`, which refines from the best of several starts.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.identify.rows import Rows
from calib.identify.setup import Setup

Array = NDArray[np.float64]

#: Directions of a frame that is wholly unknown.
_ALL = 6


def linear_start(setup: Setup, T_base_tip: Array, rows: Rows) -> tuple[Array, Array] | None:
    """Targets, and the unknown translations of frames, by one linear least squares; None where it does not apply.

    It does where each frame's rotation is known, every row measures a position in it, and the targets' rotations do not
    matter: R_f (R_i t + p_i) + s_f = m_i.

    Args:
        setup: What is known.
        T_base_tip: shape (N, 4, 4), of the nominal robot [m].
        rows: The rows.

    Returns:
        T_frame_base, shape (F, 4, 4), and T_tip_target, shape (T, 4, 4), [m].
    """
    known_turns = all(not {"rx", "ry", "rz"} & set(directions) for directions in setup.unknown)
    if not known_turns or not all(kind.coordinates for kind in rows.present):
        return None
    frame, target = rows.samples.frame, rows.samples.target
    R = setup.T_frame_base[frame][:, :3, :3]
    rhs = rows.points - _carried(setup.T_frame_base[frame], T_base_tip[:, :3, 3])
    frames, targets = len(setup.groups), len(setup.targets)
    A = np.zeros((len(rows), 3, 3 * (targets + frames)))
    R_tip = R @ T_base_tip[:, :3, :3]
    loose = setup.target_unknown[target]
    index = np.flatnonzero(loose)
    for k in range(3):
        A[index, :, 3 * target[index] + k] = R_tip[index, :, k]
        for f, directions in enumerate(setup.unknown):
            if "xyz"[k] in directions:
                A[frame == f, k, 3 * (targets + f) + k] = 1.0
    given = np.einsum("nij,nj->ni", R_tip, setup.T_tip_target[target, :3, 3])
    rhs = rhs - np.where(loose[:, None], 0.0, given)
    x = np.linalg.lstsq(A.reshape(-1, A.shape[2]), rhs.ravel(), rcond=1e-9)[0]
    T_frame_base, T_tip_target = setup.T_frame_base.copy(), setup.T_tip_target.copy()
    T_frame_base[:, :3, 3] += x[3 * targets :].reshape(-1, 3)
    seen = np.isin(np.arange(targets), target) & setup.target_unknown
    T_tip_target[seen, :3, 3] = x[: 3 * targets].reshape(-1, 3)[seen]
    if setup.rotation:
        T_tip_target = turned_targets(setup, T_frame_base, T_tip_target, T_base_tip, rows)
    return T_frame_base, T_tip_target


def frames_around(setup: Setup, T_tip_target: Array, T_base_tip: Array, rows: Rows) -> Array:
    """The frames that suit targets at these places, each by its own kind, shape (F, 4, 4), [m]."""
    seen = T_base_tip @ T_tip_target[rows.samples.target]
    frames: Array = setup.T_frame_base.copy()
    positions = rows.where(lambda kind: kind.position)
    for f, directions in enumerate(setup.unknown):
        own = np.flatnonzero(rows.samples.frame == f)
        if not directions or not len(own):
            continue
        points, measured = seen[own, :3, 3], rows.measured[own]
        placed = positions[own]
        if len(directions) == _ALL and np.sum(placed) >= 3:
            frames[f] = best_fit(points[placed], measured[placed, :3])
            continue
        # What has most scalars a row tells most: a socket before a plane.
        telling = [(k, rows.where(k.__eq__)[own]) for k in rows.present if k.locate is not None]
        telling = [(k, seen) for k, seen in telling if np.any(seen)]
        if telling:
            kind, mine = max(telling, key=lambda one: len(one[0].units))
            assert kind.locate is not None
            frames[f] = kind.locate(points[mine], measured[mine, : kind.size], frames[f])
        elif np.any(placed):
            shift = measured[placed, :3] - _carried(frames[f], points[placed])
            allowed = np.array([axis in directions for axis in "xyz"])
            frames[f, :3, 3] += np.where(allowed, shift.mean(axis=0), 0.0)
    return frames


def pose_start(setup: Setup, T_base_tip: Array, rows: Rows) -> tuple[Array, Array] | None:
    """Rotations of frames and targets from measured orientations, then their translations; None without enough.

    M_i = R_f R_i R_t for each row: M_i R_t^T - R_f R_i = 0 is linear in both rotations; the null vector is projected
    to SO(3) (M. Shah, 2013, for the same equation in hand-eye calibration).
    """
    oriented = rows.where(lambda kind: kind.orientation)
    whole = [f for f, d in enumerate(setup.unknown) if len(d) == _ALL]
    if not whole or not setup.estimate_target or not np.all(oriented):
        return None
    T_frame_base, T_tip_target = setup.T_frame_base.copy(), setup.T_tip_target.copy()
    frame, target = rows.samples.frame, rows.samples.target
    done: set[int] = set()
    for f in whole:
        own = np.flatnonzero(frame == f)
        if not len(own):
            continue
        # The target seen most often from this frame tells both; the others follow from the frame.
        t = int(np.bincount(target[own]).argmax())
        own = own[target[own] == t]
        R_f, R_t = _both_rotations(T_base_tip[own, :3, :3], _orientations(rows, own))
        T_frame_base[f, :3, :3] = R_f
        if t not in done:
            T_tip_target[t, :3, :3] = R_t
            done.add(t)
    turned = setup.placed(T_frame_base, T_tip_target)
    T_tip_target = turned_targets(turned, T_frame_base, T_tip_target, T_base_tip, rows)
    known = tuple(tuple(x for x in d if x in "xyz") for d in setup.unknown)
    return linear_start(_with_unknown(turned, known), T_base_tip, rows)


def _with_unknown(setup: Setup, unknown: tuple[tuple[str, ...], ...]) -> Setup:
    """The set-up with other unknown directions, and targets as points."""
    return replace(setup, unknown=unknown, rotation=False)


def best_fit(points: Array, seen: Array) -> Array:
    """The pose that carries points to where they were seen best (W. Kabsch, 1976), shape (4, 4), [m].

    Args:
        points: shape (N, 3).
        seen: shape (N, 3).
    """
    centre, middle = points.mean(axis=0), seen.mean(axis=0)
    T = np.eye(4)
    T[:3, :3] = _nearest_rotation((seen - middle).T @ (points - centre))
    T[:3, 3] = middle - T[:3, :3] @ centre
    return T


def _nearest_rotation(M: Array) -> Array:
    """The rotation nearest to a matrix, shape (3, 3)."""
    U, _, V = np.linalg.svd(M)
    return np.asarray(U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ V))]) @ V)


def _both_rotations(R_i: Array, M_i: Array) -> tuple[Array, Array]:
    """R_f and R_t with M_i = R_f R_i R_t, shapes (3, 3)."""
    A = np.zeros((len(R_i), 9, 18))
    for a in range(3):
        for b in range(3):
            # Entry (a, b) of M_i R_t^T - R_f R_i, with R_f and R_t^T row by row.
            A[:, 3 * a + b, 9 + b : 18 : 3] = M_i[:, a]
            A[:, 3 * a + b, 3 * a : 3 * a + 3] = -R_i[:, :, b]
    normal = np.einsum("nij,nik->jk", A, A)
    vector = np.linalg.eigh(normal)[1][:, 0]
    R_f, R_t = vector[:9].reshape(3, 3), vector[9:].reshape(3, 3).T
    if np.linalg.det(R_f) < 0.0:
        R_f, R_t = -R_f, -R_t
    return _nearest_rotation(R_f), _nearest_rotation(R_t)


def turned_targets(
    setup: Setup, T_frame_base: Array, T_tip_target: Array, T_base_tip: Array, rows: Rows
) -> Array:
    """The targets with the mean rotation that their poses were seen with, shape (T, 4, 4).

    Args:
        setup: What is unknown.
        T_frame_base: shape (F, 4, 4), [m].
        T_tip_target: shape (T, 4, 4), [m].
        T_base_tip: shape (N, 4, 4), of the nominal robot [m].
        rows: The rows.
    """
    result: Array = T_tip_target.copy()
    R_frame_tip = T_frame_base[rows.samples.frame][:, :3, :3] @ T_base_tip[:, :3, :3]
    oriented = rows.where(lambda kind: kind.orientation)
    for t in range(len(setup.targets)):
        own = (rows.samples.target == t) & oriented
        if np.any(own) and setup.target_unknown[t]:
            mean = np.einsum("nji,njk->ik", R_frame_tip[own], _orientations(rows, own))
            result[t, :3, :3] = _nearest_rotation(mean)
    return result


def _orientations(rows: Rows, own: NDArray[np.generic]) -> Array:
    """The measured orientations of some rows, shape (n, 3, 3)."""
    return rows.measured[own, 3:12].reshape(-1, 3, 3)


def _carried(T: Array, points: Array) -> Array:
    """Points carried by one pose or by one each, shape (N, 3)."""
    T = np.broadcast_to(T, (len(points), 4, 4))
    return np.asarray(np.einsum("nij,nj->ni", T[:, :3, :3], points) + T[:, :3, 3])
