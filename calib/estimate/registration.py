"""Registration: where targets and measurement frames stand, before anything about the robot is estimated.

By plain least squares, for a robust fit from a wrong start takes every row for an outlier: in closed form where the
problem is linear, else by Levenberg-Marquardt from several starts.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from calib.errors import MeasurementError
from calib.estimate.rows import LENGTHS, NONE, Rows
from calib.estimate.setup import Setup
from calib.estimate.solvers import levenberg_marquardt
from calib.model.error_model import frame_and_target_model
from calib.model.observability import steps
from calib.model.parameters import ErrorModel
from calib.robot import kernel
from calib.units import Array, Mask

#: Distances from the tip at which a target is looked for when nothing is known of it [m]; so many starts, those that
#: fit best, are refined, with so many rows of each view of a target.
_REACHES, _REFINED, _ROWS, _FEWEST_ROWS = (0.15, 0.7), 5, 200, 20

#: Directions of a frame that is wholly unknown, and the points that show all of them.
_ALL, _FEWEST_POINTS = 6, 3

#: A row that is this many median distances off does not take part in a nominal robot's registration.
_GROSS, _GROSS_ROUNDS = 5.0, 5

#: Rows in which gross ones, and patterns of residuals, are looked for; more do not change what is found.
ENOUGH = 20_000


def register(T_base_tip: Array, setup: Setup, rows: Rows, *, tolerance: float = 1e-12) -> Setup:
    """The set-up with what is to be estimated where these poses of the tip put it, (N, 4, 4), [m], by enough of them.

    `MeasurementError` with too few rows; what is known stays as given, and so does what no row sees.
    """
    _check_enough(setup, rows)
    some = _some(rows)
    return register_poses(T_base_tip[some], setup, rows.select(some), tolerance=tolerance)


def register_poses(
    T_base_tip: Array, setup: Setup, rows: Rows, *, tolerance: float = 1e-12
) -> Setup:
    """`register` with every row."""
    if not setup.count:
        return setup
    linear = _linear_start(setup, T_base_tip, rows)
    if linear is not None and np.all(rows.where(lambda kind: kind.position and kind.size == 3)):
        return linear  # of points this is the least-squares solution itself
    model = frame_and_target_model(
        setup.frame_unknowns, setup.unknown_targets, setup.target_names, rotation=setup.rotation
    )
    starts = [linear] if linear else _starts(setup, T_base_tip, rows)
    starts = [_turned_targets(start, T_base_tip, rows) for start in starts]

    def misfit(start: Setup) -> float:
        residual = rows.residual(start.seen(T_base_tip, rows.samples)) / rows.scales
        return float(np.sum(residual[rows.used] ** 2))

    found, x, step = [], np.zeros(len(model)), steps(model.units)
    for start in sorted(starts, key=misfit)[:_REFINED]:
        own = start.aligned(model)
        system = partial(_system, own, T_base_tip, rows, start)
        solution = levenberg_marquardt(system, x, step, tolerance=tolerance)
        found.append((solution.cost, start.displaced(own.displacements(solution.x)[0])))
    setup = min(found, key=lambda one: one[0])[1]
    # Somewhere definite where no row tells: a plane's turn about its normal.
    T_frame_base = setup.T_frame_base.copy()
    for (f, directions), kind in itertools.product(enumerate(setup.unknown), rows.present):
        if kind.settle is None or not setup.own_axes[f] or directions != kind.directions:
            continue
        if np.any(rows.where(kind.__eq__) & (rows.samples.frame == f)):
            T_frame_base[f] = kind.settle(T_frame_base[f])
    return setup.placed(T_frame_base, setup.T_tip_target)


def nominal_setup(T_base_tip: Array, setup: Setup, rows: Rows) -> Setup:
    """Frames and targets as given; those that were not given as the nominal robot registers them, gross rows aside."""
    return _without_gross(T_base_tip, setup.not_given(), rows)


def register_unseen(T_base_tip: Array, placed: Setup, unseen: Setup, rows: Rows) -> Setup:
    """A set-up with what is unknown in ``unseen`` where rows that no fit has seen put it, gross ones aside."""
    own = unseen.unknown_at(rows.samples)
    loose = unseen.placed(placed.T_frame_base, placed.T_tip_target)
    found = _without_gross(T_base_tip[own], loose, rows.select(own))
    return placed.placed(found.T_frame_base, found.T_tip_target)


def _without_gross(T_base_tip: Array, setup: Setup, rows: Rows) -> Setup:
    """`register_poses` without the rows that are far off."""
    if not setup.count:
        return setup
    some = rows.evenly(ENOUGH)
    T_base_tip, rows = T_base_tip[some], rows.select(some)
    alive = np.any(rows.used, axis=1)
    kept = np.ones(len(rows), dtype=bool)
    for _ in range(_GROSS_ROUNDS + 1):
        found = register(T_base_tip[kept], setup, rows.select(kept))
        residual = rows.residual(found.seen(T_base_tip, rows.samples))
        distance = np.sqrt(np.sum((residual / rows.scales) ** 2, axis=1))
        near = (distance <= _GROSS * np.median(distance[alive])) | ~alive
        few = np.sum(near & alive) < 0.6 * np.sum(alive) or not rows.keeps_frames(near)
        near = rows.with_partners(near)
        if few or np.array_equal(near, kept):
            break
        kept = near
    return found


def _check_enough(setup: Setup, rows: Rows) -> None:
    """Refuse fewer numbers than unknowns of what rows see, in all and for each frame."""
    setup = setup.as_known(*map(np.logical_not, setup.seen_by(rows.samples)))
    points = rows.where(lambda kind: kind.coordinates and not kind.orientation)
    frame = rows.samples.frame
    whole = [len(directions) == _ALL for directions in setup.unknown]
    parts = [("The table", np.ones(len(rows), dtype=bool), setup.count, any(whole))]
    for f, name in enumerate(setup.groups):
        if np.any(frame == f):
            parts.append((f"The set-up '{name}'", frame == f, len(setup.unknown[f]), whole[f]))
    for what, own, unknowns, three in parts:
        count, seen = int(np.sum(rows.used[own])), int(np.sum(own))
        # Two points leave the rotation about the line through them.
        if count < unknowns or (three and np.all(points[own]) and seen < _FEWEST_POINTS):
            raise MeasurementError(
                f"{what} has {seen} row{'s' * (seen != 1)} with {count} numbers for {unknowns} unknowns of frame and "
                "target. Measure 3 or more poses a set-up, or give what is known of it."
            )


def _some(rows: Rows) -> Mask:
    """Rows that are enough to find a start, spread evenly over what each frame sees of each target; whole pairs."""
    if len(rows) <= _FEWEST_ROWS:
        return np.ones(len(rows), dtype=bool)
    told, samples = np.flatnonzero(rows.kinds != NONE), rows.samples
    view = (samples.frame * (int(samples.target.max()) + 1) + samples.target)[told]
    views = np.unique(view)
    most = max(_ROWS // len(views), _FEWEST_ROWS)
    mask = np.zeros(len(rows), dtype=bool)
    for v in views:
        own = told[view == v]
        mask[own[np.linspace(0, len(own) - 1, min(len(own), most)).astype(int)]] = True
    return rows.with_partners(mask)


def _starts(setup: Setup, T_base_tip: Array, rows: Rows) -> list[Setup]:
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
        if len(setup.groups) == 1 and name in unknown and len(unknown) < _ALL:
            for quarter in (1, 2, 3):
                R = np.eye(4)
                R[:3, :3] = Rotation.from_euler("xyz"[axis], quarter * np.pi / 2).as_matrix()
                turned.append(setup.placed(setup.T_frame_base @ R, setup.T_tip_target))
    pairs = itertools.product(turned, places)
    return [_frames_around(one.placed(one.T_frame_base, T), T_base_tip, rows) for one, T in pairs]


def _system(
    model: ErrorModel, T_base_tip: Array, rows: Rows, setup: Setup, x: Array
) -> tuple[Array, Array]:
    """The whitened residual and its own derivative, shapes (M,) and (M, p), over fixed poses of the tip."""
    displacement, directions = model.displacements(x)
    frames, here = len(setup.groups), setup.displaced(displacement)
    T_frame_base = here.T_frame_base[rows.samples.frame]
    T_frame_target = here.seen(T_base_tip, rows.samples)
    local = directions.reshape(len(displacement), 6, -1)
    outer = np.array([T[:, :3].transpose(2, 1, 0) for T in (T_frame_base, T_frame_target)])
    moves = kernel.regressor(outer, outer[1, 3])
    columns = np.zeros((len(model), 6, len(rows)))
    places = (local[:frames], rows.samples.frame), (local[frames + 1 :], rows.samples.target)
    for k, (at, which) in enumerate(places):
        kernel.add_columns(columns[:, :3], moves[k], at, which)
        if rows.width > LENGTHS:
            kernel.add_columns(columns[:, 3:], outer[k, :3], at[:, 3:], which)
    used, scales = rows.used, rows.scales
    residual = (rows.residual(T_frame_target) / scales)[used]
    slopes = rows.derivative(T_frame_target, columns.transpose(2, 1, 0))
    return residual, (slopes / -scales[:, :, None])[used]


def _linear_start(setup: Setup, T_base_tip: Array, rows: Rows) -> Setup | None:
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
    return _turned_targets(found, T_base_tip, rows) if setup.rotation else found


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
        if len(directions) == _ALL and np.sum(placed) >= 3:
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
    whole = [f for f, d in enumerate(setup.unknown) if len(d) == _ALL]
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
    turned = _turned_targets(setup.placed(T_frame_base, setup.T_tip_target), T_base_tip, rows)
    known = tuple(tuple(x for x in d if x in "xyz") for d in setup.unknown)
    found = _linear_start(replace(turned, unknown=known, rotation=False), T_base_tip, rows)
    return found and setup.placed(found.T_frame_base, found.T_tip_target)


def _nearest_rotation(M: Array) -> Array:
    """The rotation nearest to a matrix, shape (3, 3)."""
    U, _, V = np.linalg.svd(M)
    return np.asarray(U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ V))]) @ V)


def _turned_targets(setup: Setup, T_base_tip: Array, rows: Rows) -> Setup:
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
