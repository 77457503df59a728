"""Registration: frames and targets fitted on given poses of the robot's tip, before its errors are estimated.

By plain least squares, because a robust fit from a wrong start would treat every row as an outlier: in closed form if
the equations are linear, else by Levenberg-Marquardt from several starts. Frames of which nothing is known are searched
first (`calib.fit.registration.frame_search`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.errors import MeasurementError
from calib.fit.registration.closed_form import linear_setup
from calib.fit.registration.frame_search import find_frame, frames_to_search
from calib.fit.registration.refinement import find_starts, refine_best
from calib.fit.registration.rows import NONE, Rows
from calib.fit.registration.setup import Setup
from calib.fit.registration.views import views_as_poses

#: Rows that are enough for a registration, shared by the pairs of a frame and a target.
_ROWS = 200

#: Views that are enough for a registration, shared in the same way.
_VIEWS = 60

#: The fewest rows of each pair of a frame and a target; with no more rows in all none is left out.
_FEWEST_ROWS = 20

#: The fewest points that determine a frame that is wholly unknown.
_FEWEST_POINTS = 3

#: A row at so many times the median distance is an outlier of a robust registration.
_OUTLIER = 5.0

#: The most rounds in which outliers are rejected.
_OUTLIER_ROUNDS = 5

#: With a smaller share of the rows left no further outliers are rejected: the setup is wrong, not the rows.
_FEWEST_KEPT = 0.6

#: Rows in which outliers, and patterns of residuals, are searched; more do not change the result.
ENOUGH = 20_000


def register(
    T_base_tip: Array,
    setup: Setup,
    rows: Rows,
    *,
    tolerance: float = 1e-12,
    near: Setup | None = None,
) -> Setup:
    """Estimate the unknown frames and targets on given poses of the robot: least squares, on a subsample of the rows.

    Args:
        T_base_tip: shape (N, 4, 4), pose of the tip at each row, of the nominal or another robot [m].
        setup: Frames and targets, with what is estimated of them.
        rows: N rows.
        tolerance: Relative fall of the sum of squares at which the refinement ends.
        near: The setup as other rows registered it, where images begin in place of their views.

    Returns:
        The setup with the estimated poses; fixed ones, and those that no row observes, stay as they are.

    Raises:
        MeasurementError: Fewer numbers than unknowns, in all or at one station; fewer than three points of a frame that
            is wholly unknown; or no view of an instrument determines a pose.
        SolverError: The residual is not finite at a start.
    """
    # Enough numbers for the unknowns, of the table and of each frame.
    frames, targets = setup.seen_by(rows.samples)
    observed = setup.with_fixed(~frames, ~targets)
    wholly_unknown = observed.wholly_unknown.tolist()
    every = np.ones(len(rows), dtype=bool)
    _check_part("The table", rows, every, observed.count, points_needed=any(wholly_unknown))
    for f, name in enumerate(setup.groups):
        of_frame = rows.samples.frame == f
        if not np.any(of_frame):
            continue
        unknowns = len(observed.unknown[f])
        points_needed = wholly_unknown[f]
        _check_part(f"Station '{name}'", rows, of_frame, unknowns, points_needed=points_needed)

    sample = _subsample(rows)
    return register_all_rows(
        T_base_tip[sample], setup, rows.select(sample), tolerance=tolerance, near=near
    )


def register_all_rows(
    T_base_tip: Array,
    setup: Setup,
    rows: Rows,
    *,
    tolerance: float = 1e-12,
    near: Setup | None = None,
) -> Setup:
    """Estimate the unknown frames and targets on given poses of the robot, by every row, however few there are.

    Args:
        T_base_tip: shape (N, 4, 4), pose of the tip at each row [m].
        setup: Frames and targets, with what is estimated of them.
        rows: N rows; they are not counted.
        tolerance: Relative fall of the sum of squares at which the refinement ends.
        near: The setup as other rows registered it, where images begin in place of their views.

    Returns:
        The setup with the estimated poses; itself if nothing is estimated.

    Raises:
        MeasurementError: No view of an instrument determines a pose.
        SolverError: The residual is not finite at a start.
    """
    if not setup.count:
        return setup
    if np.any(rows.has_views):
        start = near or _register_to_views(setup, T_base_tip, rows, tolerance)
        starts = [start]
    else:
        linear = linear_setup(setup, T_base_tip, rows)
        only_points = np.all(rows.where(lambda kind: kind.position and kind.size == 3))
        if linear is not None and only_points:
            return linear  # it is the least-squares solution itself
        if linear is not None:
            starts = [linear]
        elif frames_to_search(setup, rows):
            starts = [_search_frames(setup, T_base_tip, rows, tolerance)]
        else:
            starts = find_starts(setup, T_base_tip, rows)
    best = refine_best(starts, T_base_tip, rows, tolerance)
    return _settle(best, rows)


def _register_to_views(setup: Setup, T_base_tip: Array, rows: Rows, tolerance: float) -> Setup:
    """Register frames and targets to a pose for each view, and to the rows of other kinds, again without far-off ones.

    The second time is left out if too few would be near. The tip is at T_base_tip at each of the N rows, (N, 4, 4) [m];
    ``tolerance`` is that of `register_all_rows`. It raises `MeasurementError` if no view determines a pose.
    """
    poses, source_rows = views_as_poses(rows)
    T_base_tip = T_base_tip[source_rows]
    registered = register_all_rows(T_base_tip, setup, poses, tolerance=tolerance)
    # A board nearly head on may be taken for its mirror image.
    near = _near_rows(registered, T_base_tip, poses)
    if near is None or np.all(near):
        return registered
    return register_all_rows(T_base_tip[near], setup, poses.select(near), tolerance=tolerance)


def _search_frames(setup: Setup, T_base_tip: Array, rows: Rows, tolerance: float) -> Setup:
    """Find the frames of which nothing is known one by one, after all that the rows of the other frames determine.

    The tip is at T_base_tip at each of the N rows, (N, 4, 4) [m].
    """
    unknown = frames_to_search(setup, rows)
    numbers = np.arange(len(setup.groups))
    others = rows.with_partners(~np.isin(rows.samples.frame, unknown))
    of_others = setup.with_fixed(np.isin(numbers, unknown), np.zeros_like(setup.target_unknown))
    registered = register_all_rows(
        T_base_tip[others], of_others, rows.select(others), tolerance=tolerance
    )
    _, known_targets = setup.seen_by(rows.samples.select(others))
    for f in unknown:
        of_frame = rows.with_partners(rows.samples.frame == f)
        part = rows.select(of_frame)
        start = setup.with_poses(registered.T_frame_base, registered.T_tip_target)
        start = start.with_fixed(numbers != f, known_targets)
        registered = find_frame(start, f, T_base_tip[of_frame], part)
        known_targets = known_targets | setup.seen_by(part.samples)[1]
    return setup.with_poses(registered.T_frame_base, registered.T_tip_target)


def _settle(setup: Setup, rows: Rows) -> Setup:
    """The setup with directions that no row observes, such as a plane's turn about its normal, at a definite value."""
    T_frame_base = setup.T_frame_base.copy()
    for f, directions in enumerate(setup.unknown):
        if not setup.own_axes[f]:
            continue
        of_frame = rows.samples.frame == f
        for kind in rows.present:
            if kind.settle is None or directions != kind.directions:
                continue
            if np.any(rows.where(kind.__eq__) & of_frame):
                T_frame_base[f] = kind.settle(T_frame_base[f])
    return setup.with_poses(T_frame_base, setup.T_tip_target)


def nominal_setup(
    T_base_tip: Array, setup: Setup, rows: Rows, *, near: Setup | None = None
) -> Setup:
    """Register, on the nominal robot, the frames and targets that were not given; outliers are rejected.

    Args:
        T_base_tip: shape (N, 4, 4), pose of the nominal robot's tip at each row [m].
        setup: Frames and targets; given ones stay as they were given, though the fit may estimate them.
        rows: N rows.
        near: The setup as other rows registered it, where images begin in place of their views.

    Returns:
        The setup in which given frames and targets are marked as fixed, and the others have registered poses.

    Raises:
        MeasurementError: Fewer numbers than unknowns, or too few points, see `register`.
    """
    return _register_without_outliers(T_base_tip, setup.with_given_fixed(), rows, near)


def register_held_out(T_base_tip: Array, fitted: Setup, held_out: Setup, rows: Rows) -> Setup:
    """Register frames and targets that only held-out rows see, on the calibrated robot; outliers are rejected.

    Args:
        T_base_tip: shape (N, 4, 4), pose of the calibrated robot's tip at each row [m].
        fitted: Frames and targets at the solution of a fit.
        held_out: The same frames and targets; those are unknown that no fitted row sees.
        rows: N held-out rows.

    Returns:
        ``fitted`` with the poses of the unknown frames and targets of ``held_out`` as registered.

    Raises:
        MeasurementError: Fewer numbers than unknowns, or too few points, see `register`.
    """
    concerned = held_out.unknown_at(rows.samples)
    start = held_out.with_poses(fitted.T_frame_base, fitted.T_tip_target)
    # By the numbers of lens and print as the fit estimated them, with which these rows are predicted.
    start = replace(start, internals=fitted.internals)
    registered = _register_without_outliers(
        T_base_tip[concerned], start, rows.select(concerned), None
    )
    return fitted.with_poses(registered.T_frame_base, registered.T_tip_target)


def _register_without_outliers(
    T_base_tip: Array, setup: Setup, rows: Rows, near: Setup | None
) -> Setup:
    """Register frames and targets, repeatedly without the rows whose residual is far above the median.

    The tip is at T_base_tip at each of the N rows, (N, 4, 4) [m]; of very many rows a part is used. Images begin at the
    setup ``near`` them, if there is one. It raises `MeasurementError` if the rows are too few (`register`).
    """
    if not setup.count:
        return setup
    sample = rows.evenly(ENOUGH)
    T_base_tip = T_base_tip[sample]
    rows = rows.select(sample)
    kept = np.ones(len(rows), dtype=bool)
    for _ in range(_OUTLIER_ROUNDS + 1):
        near = register(T_base_tip[kept], setup, rows.select(kept), near=near)
        fitting = _near_rows(near, T_base_tip, rows)
        if fitting is None or np.array_equal(fitting, kept):
            break
        kept = fitting
    assert near is not None
    return near


def _near_rows(setup: Setup, T_base_tip: Array, rows: Rows) -> Mask | None:
    """Rows, (N,), whose residual is not far above the median, with the tip at T_base_tip, (N, 4, 4) [m]; and partners.

    Compared are the norms of each row's scalars in units of their sigma. None if too few are left, of all rows or of a
    frame's.
    """
    measuring = np.any(rows.used, axis=1)
    residual = rows.residual(setup.sightings(T_base_tip, rows.samples))
    distance = np.sqrt(np.sum((residual / rows.scales) ** 2, axis=1))
    limit = _OUTLIER * np.median(distance[measuring])
    near = (distance <= limit) | ~measuring
    too_few = np.sum(near & measuring) < _FEWEST_KEPT * np.sum(measuring)
    if too_few or not rows.keeps_frames(near):
        return None
    return rows.with_partners(near)


def _check_part(name: str, rows: Rows, part: Mask, unknowns: int, *, points_needed: bool) -> None:
    """Raise `MeasurementError` if a part of the rows, (N,), has fewer numbers than unknowns.

    A frame that is wholly unknown needs three points: two leave the rotation about the line through them.
    """
    numbers = int(np.sum(rows.used[part]))
    count = int(np.sum(part))
    points = rows.where(lambda kind: kind.coordinates and not kind.depends_on_orientation)
    too_few_points = points_needed and np.all(points[part]) and count < _FEWEST_POINTS
    if numbers < unknowns or too_few_points:
        raise MeasurementError(
            f"{name} has {count} row{'s' * (count != 1)} to estimate from, with {numbers} numbers for {unknowns} "
            "unknowns of frame and target. Measure 3 or more poses at each station (beside rows of the set 'estimate' "
            "those of the set 'validate' do not count), or give what is known of it."
        )


def _subsample(rows: Rows) -> Mask:
    """Mask of rows, (N,), enough for a registration, evenly spaced for each frame and target; pairs stay whole."""
    if len(rows) <= _FEWEST_ROWS:
        return np.ones(len(rows), dtype=bool)
    in_view = rows.has_views
    samples = rows.samples
    # Each pair of a frame and a target has a number.
    targets = int(samples.target.max()) + 1
    seen_pair = samples.frame * targets + samples.target
    pairs = np.unique(seen_pair)
    most = max(_ROWS // len(pairs), _FEWEST_ROWS)
    mask = np.zeros(len(rows), dtype=bool)
    for pair in pairs:
        of_pair = seen_pair == pair
        mask[_evenly_spaced(np.flatnonzero(of_pair & ~in_view & (rows.kind != NONE)), most)] = True
        poses = np.unique(rows.blocks[of_pair & in_view])
        chosen = _evenly_spaced(poses, max(_VIEWS // len(pairs), _FEWEST_ROWS))
        mask |= of_pair & in_view & np.isin(rows.blocks, chosen)  # views are kept whole
    return rows.with_partners(mask)


def _evenly_spaced(values: Integers, most: int) -> Integers:
    """Return at most ``most`` of n values, (n,), evenly spaced in their order; all if there are no more."""
    spaced = np.linspace(0, len(values) - 1, min(len(values), most))
    return np.asarray(values[spaced.astype(int)])
