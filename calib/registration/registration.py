"""Registration: where targets and measurement frames stand, before anything about the robot is estimated.

By plain least squares, for a robust fit from a wrong start takes every row for an outlier: in closed form where the
problem is linear, else by Levenberg-Marquardt from several starts.
"""

from __future__ import annotations

import itertools
from functools import partial

import numpy as np

from calib.errors import MeasurementError
from calib.model.error_model import DIRECTIONS, frame_and_target_model
from calib.model.observability import steps
from calib.model.parameters import ErrorModel
from calib.numerics.solvers import levenberg_marquardt
from calib.registration.rows import LENGTHS, NONE, Rows
from calib.registration.setup import Setup
from calib.registration.starts import linear_start, starts_of, turned_targets
from calib.robot import kernel
from calib.units import Array, Mask

#: The most starts that are refined: those that fit best.
_REFINED = 5

#: Rows of each view of a target that are enough for a registration.
_ROWS = 200

#: With no more rows than this all are used.
_FEWEST_ROWS = 20

#: The fewest points that show all six directions of a frame.
_FEWEST_POINTS = 3


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
    linear = linear_start(setup, T_base_tip, rows)
    if linear is not None and np.all(rows.where(lambda kind: kind.position and kind.size == 3)):
        return linear  # of points this is the least-squares solution itself
    model = frame_and_target_model(
        setup.frame_unknowns, setup.unknown_targets, setup.target_names, rotation=setup.rotation
    )
    starts = [linear] if linear else starts_of(setup, T_base_tip, rows)
    starts = [turned_targets(start, T_base_tip, rows) for start in starts]

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
    whole = [len(directions) == len(DIRECTIONS) for directions in setup.unknown]
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
