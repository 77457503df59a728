"""Starts of a registration."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from calib.model.error_model import DIRECTIONS
from calib.registration.rows import Rows
from calib.registration.setup import Setup
from calib.units import Array

#: Distances from the tip at which a target is looked for when nothing is known of it [m].
_REACHES = (0.15, 0.7)


def starts_of(setup: Setup, T_base_tip: Array, rows: Rows) -> list[Setup]:
    """Targets to begin with, each with the frames that suit them."""
    oriented = _pose_start(setup, T_base_tip, rows)
    if oriented is not None:
        return [oriented]
    offsets = [reach * axis for reach in _REACHES for axis in [*np.eye(3), *-np.eye(3)]]
    if np.any(setup.target_given & setup.target_unknown):
        offsets.append(np.zeros(3))
    places = [setup.T_tip_target]
    for offset in offsets if setup.estimate_target else ():
        moved = setup.T_tip_target.copy()
        moved[setup.target_unknown, :3, 3] = offset
        places.append(moved)
    # A frame of which one rotation is unknown, but not all, is turned by quarters, so that none is out of reach.
    turned, unknown = [setup], setup.unknown[0]
    for axis, name in enumerate(("rx", "ry", "rz")):
        if len(setup.groups) == 1 and name in unknown and len(unknown) < len(DIRECTIONS):
            for quarter in (1, 2, 3):
                R = np.eye(4)
                R[:3, :3] = Rotation.from_euler("xyz"[axis], quarter * np.pi / 2).as_matrix()
                turned.append(setup.placed(setup.T_frame_base @ R, setup.T_tip_target))
    pairs = itertools.product(turned, places)
    return [_frames_around(one.placed(one.T_frame_base, T), T_base_tip, rows) for one, T in pairs]


def linear_start(setup: Setup, T_base_tip: Array, rows: Rows) -> Setup | None:
    """Targets and translations of frames by linear R_f (R_i t + p_i) + s_f = m_i; None where that is not all."""
    turns = {one for directions in setup.unknown for one in directions if one not in "xyz"}
    if turns or not all(kind.coordinates for kind in rows.present):
        return None
    frame, target = rows.samples.frame, rows.samples.target
    T_frame_tip = setup.T_frame_base[frame] @ T_base_tip
    points = np.zeros((len(rows), 3))
    positions = rows.where(lambda kind: kind.position)
    if np.any(positions):
        points[positions] = rows.measured[positions, :3]
    rhs, R_tip = points - T_frame_tip[:, :3, 3], T_frame_tip[:, :3, :3]
    frames, targets = len(setup.groups), len(setup.targets)
    A = np.zeros((len(rows), 3, 3 * (targets + frames)))
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
    seen = setup.seen_by(rows.samples)[1] & setup.target_unknown
    T_tip_target[seen, :3, 3] = x[: 3 * targets].reshape(-1, 3)[seen]
    found = setup.placed(T_frame_base, T_tip_target)
    return turned_targets(found, T_base_tip, rows) if setup.rotation else found


def _frames_around(setup: Setup, T_base_tip: Array, rows: Rows) -> Setup:
    """The set-up with the frames that suit its targets, each by its own kind of rows."""
    seen = T_base_tip @ setup.T_tip_target[rows.samples.target]
    frames: Array = setup.T_frame_base.copy()
    positions = rows.where(lambda kind: kind.position)
    for f, directions in enumerate(setup.unknown):
        own = np.flatnonzero(rows.samples.frame == f)
        if not directions or not len(own):
            continue
        points, measured = seen[own, :3, 3], rows.measured[own]
        placed = positions[own]
        if len(directions) == len(DIRECTIONS) and np.sum(placed) >= 3:
            # The pose that carries the points to where they were seen best (W. Kabsch, 1976).
            there, here = measured[placed, :3], points[placed]
            centre, middle = here.mean(axis=0), there.mean(axis=0)
            frames[f, :3, :3] = R = _nearest_rotation((there - middle).T @ (here - centre))
            frames[f, :3, 3] = middle - R @ centre
            continue
        # What has most scalars a row tells most: a socket before a plane.
        telling = [(k, rows.where(k.__eq__)[own]) for k in rows.present if k.locate is not None]
        telling = [(k, seen) for k, seen in telling if np.any(seen)]
        if telling:
            kind, mine = max(telling, key=lambda one: len(one[0].units))
            assert kind.locate is not None
            frames[f] = kind.locate(points[mine], measured[mine, : kind.size], frames[f])
        elif np.any(placed):
            carried = points[placed] @ frames[f, :3, :3].T + frames[f, :3, 3]
            shift = measured[placed, :3] - carried
            allowed = np.array([axis in directions for axis in "xyz"])
            frames[f, :3, 3] += np.where(allowed, shift.mean(axis=0), 0.0)
    return setup.placed(frames, setup.T_tip_target)


def _pose_start(setup: Setup, T_base_tip: Array, rows: Rows) -> Setup | None:
    """Rotations by M_i R_t^T - R_f R_i = 0, linear in both (M. Shah, 2013), then translations; None without enough."""
    oriented = rows.where(lambda kind: kind.orientation)
    whole = [f for f, d in enumerate(setup.unknown) if len(d) == len(DIRECTIONS)]
    if not whole or not setup.estimate_target or not np.all(oriented):
        return None
    T_frame_base, frame, target = setup.T_frame_base.copy(), rows.samples.frame, rows.samples.target
    for f in whole:
        own = np.flatnonzero(frame == f)
        if not len(own):
            continue
        # The target seen most often from this frame tells it; all targets follow from the frames.
        own = own[target[own] == np.bincount(target[own]).argmax()]
        R_i, M_i = T_base_tip[own, :3, :3], rows.measured[own, 3:12].reshape(-1, 3, 3)
        A = np.zeros((len(own), 9, 18))
        for a, b in itertools.product(range(3), repeat=2):
            # Entry (a, b) of M_i R_t^T - R_f R_i, with R_f and R_t^T row by row.
            A[:, 3 * a + b, 9 + b : 18 : 3] = M_i[:, a]
            A[:, 3 * a + b, 3 * a : 3 * a + 3] = -R_i[:, :, b]
        vector = np.linalg.eigh(np.einsum("nij,nik->jk", A, A))[1][:, 0].reshape(2, 3, 3)
        R = vector[0] if np.linalg.det(vector[0]) > 0.0 else -vector[0]
        T_frame_base[f, :3, :3] = _nearest_rotation(R)
    turned = turned_targets(setup.placed(T_frame_base, setup.T_tip_target), T_base_tip, rows)
    known = tuple(tuple(x for x in d if x in "xyz") for d in setup.unknown)
    found = linear_start(replace(turned, unknown=known, rotation=False), T_base_tip, rows)
    return found and setup.placed(found.T_frame_base, found.T_tip_target)


def _nearest_rotation(M: Array) -> Array:
    """The rotation nearest to a matrix, shape (3, 3)."""
    U, _, V = np.linalg.svd(M)
    return np.asarray(U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ V))]) @ V)


def turned_targets(setup: Setup, T_base_tip: Array, rows: Rows) -> Setup:
    """The set-up with the targets turned by the mean rotation that their poses were seen with."""
    result: Array = setup.T_tip_target.copy()
    R_frame_tip = setup.T_frame_base[rows.samples.frame][:, :3, :3] @ T_base_tip[:, :3, :3]
    oriented = rows.where(lambda kind: kind.orientation)
    for t in np.flatnonzero(setup.target_unknown):
        own = (rows.samples.target == t) & oriented
        if np.any(own):
            R = rows.measured[own, 3:12].reshape(-1, 3, 3)
            result[t, :3, :3] = _nearest_rotation(np.einsum("nji,njk->ik", R_frame_tip[own], R))
    return setup.placed(setup.T_frame_base, result)
