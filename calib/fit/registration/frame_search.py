"""Search for measurement frames of which nothing is known: starts all over the arm's reach, each one refined.

These are frames whose kinds of rows neither measure positions nor locate their frame (`Kind.locate`), and whose pose
the cell does not give: such as the line of a straight edge, of which rows measure the distance. Their sum of squares
has local minima. Of random poses within a few times the arm's reach between one in eight and nearly all lead to the
lowest one. It is taken as found once several starts have led to it, and its residuals are those of an arm.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array, Mask
from calib.basics.channels import RESIDUAL_UNITS
from calib.data.kinds import Kind
from calib.errors import SolverError
from calib.fit.registration.refinement import refine, target_poses
from calib.fit.registration.rows import NONE, Rows
from calib.fit.registration.setup import Setup
from calib.model.parameter_sets import DIRECTIONS

#: The most starts of a frame. One in eight leads to the lowest minimum if a tool is 0.6 m long and nothing is known of
#: it, nearly all do if the target's place is known.
_STARTS = 60

#: So many starts have to lead to the lowest minimum before the others are left out.
_AGREEING = 3

#: Minima whose sums of squares differ by less than this share are one.
_SAME = 0.01

#: Relative fall of the sum of squares at which the refinement of a start ends: two digits are enough to compare.
_TOLERANCE = 1e-4

#: Sum of squares, in squared standard deviations a scalar, that is as good as zero.
_NOTHING = 1e-6

#: Origins of frames are tried up to so many times the spread of the target's positions from their centre: where an
#: instrument or an object may stand that most poses are measured against.
_FARTHEST = 4.0

#: The least spread of the target's positions [m], even if the robot hardly moves.
_LEAST_SPREAD = 0.1

#: Rows that are enough for a search.
_ROWS = 60

#: The fewest rows for each target that they see.
_ROWS_OF_TARGET = 10


def frames_to_search(setup: Setup, rows: Rows) -> list[int]:
    """Return the frames that have to be searched from many starts, because nothing says where they may be.

    Args:
        setup: Frames and targets, with what is estimated of them; the pose of a frame is not given if it is the
            identity.
        rows: N rows; frames that they do not see are left out.

    Returns:
        Numbers, from 0, of the estimated frames without given pose none of whose rows measures a position or locates
        the frame; ordered by the names of their stations.
    """

    def gives_start(kind: Kind) -> bool:
        """True if a start of the frame follows from rows of a kind, or they do not depend on it."""
        return kind.position or kind.locate is not None or not kind.directions

    if all(map(gives_start, rows.present)):
        return []
    giving = rows.where(gives_start)
    observing = rows.where(lambda kind: bool(kind.directions))
    result = []
    for f, directions in enumerate(setup.unknown):
        of_frame = observing & (rows.samples.frame == f)
        known = np.any(giving[of_frame]) or not np.array_equal(setup.T_frame_base[f], np.eye(4))
        if directions and np.any(of_frame) and not known:
            result.append(f)
    return sorted(result, key=lambda f: setup.groups[f])


def find_frame(setup: Setup, f: int, T_base_tip: Array, rows: Rows) -> Setup:
    """Find a frame, and the targets that are estimated with it, by least squares from many starts.

    Of many rows a part is used.

    Args:
        setup: Frames and targets; of the frames only this one is estimated.
        f: Number of the frame, from 0.
        T_base_tip: shape (N, 4, 4), pose of the tip at each row [m].
        rows: N rows that see the frame.

    Returns:
        The setup at the lowest minimum; as it was if no residual is finite anywhere.
    """
    chosen = _rows_of_search(rows)
    T_base_tip = T_base_tip[chosen]
    rows = rows.select(chosen)
    minima: list[tuple[float, Setup]] = []
    # A kind may divide by what is zero or far out at a start.
    with np.errstate(all="ignore"):
        for start in _starts(setup, f, T_base_tip, rows):
            try:
                minima.append(refine(start, T_base_tip, rows, _TOLERANCE))
            except SolverError:  # it is not finite there
                continue
            if _agree(minima, T_base_tip, rows):
                break
    if not minima:
        return setup
    return _lowest(minima)[1]


def is_plausible(setup: Setup, T_base_tip: Array, rows: Rows) -> bool:
    """Return whether the residuals of most rows are of a size that an uncalibrated arm may have.

    The median, which outliers do not move, is compared with `ResidualUnit.absurd`, beyond any arm and instrument.

    Args:
        setup: Frames and targets as registered.
        T_base_tip: shape (N, 4, 4), pose of the tip at each row [m].
        rows: N rows.

    Returns:
        False if the median of any unit is beyond its limit.
    """
    residual = rows.residual(setup.sightings(T_base_tip, rows.samples))
    for unit in rows.channels.present:
        typical = float(np.nanmedian(rows.channels.norms(residual, unit)))
        if typical > RESIDUAL_UNITS[unit].absurd:
            return False
    return True


def _agree(minima: list[tuple[float, Setup]], T_base_tip: Array, rows: Rows) -> bool:
    """Return whether several starts led to the lowest of the minima (cost and setup), and it is plausible.

    The tip is at T_base_tip at each of the N rows, (N, 4, 4) [m].
    """
    lowest, setup = _lowest(minima)
    limit = (1.0 + _SAME) * lowest + _NOTHING * rows.count
    agreeing = sum(cost <= limit for cost, _ in minima)
    return agreeing >= _AGREEING and is_plausible(setup, T_base_tip, rows)


def _lowest(minima: list[tuple[float, Setup]]) -> tuple[float, Setup]:
    """The first of the minima (cost and setup) with the lowest cost, which is half the sum of squares."""
    return min(minima, key=lambda minimum: minimum[0])


def _rows_of_search(rows: Rows) -> Mask:
    """Mask of rows that are enough for a search, shape (N,), the same ones in whatever order they come.

    Evenly along the rows as sorted by joint values, then by what was measured; pairs stay whole.
    """
    measuring = np.flatnonzero(rows.kind != NONE)
    most = max(_ROWS, _ROWS_OF_TARGET * len(np.unique(rows.samples.target)))
    if len(measuring) <= most:
        return np.ones(len(rows), dtype=bool)
    values = np.hstack([rows.joints, rows.measured])[measuring]
    by_values = measuring[np.lexsort(values.T[::-1])]
    spaced = np.linspace(0, len(measuring) - 1, most).astype(int)
    mask = np.zeros(len(rows), dtype=bool)
    mask[by_values[spaced]] = True
    return rows.with_partners(mask)


def _starts(setup: Setup, f: int, T_base_tip: Array, rows: Rows) -> Iterator[Setup]:
    """Yield setups with frame f at random poses, always the same ones, and targets in turn as they are and moved.

    The frame is placed around the targets of the rows, with the tip at T_base_tip, (N, 4, 4) [m].
    """
    T_base_target = T_base_tip @ setup.T_tip_target[rows.samples.target]
    points = T_base_target[:, :3, 3]
    centre = points.mean(axis=0)
    distances = np.linalg.norm(points - centre, axis=1)
    spread = max(float(np.sqrt(np.mean(distances**2))), _LEAST_SPREAD)
    targets = target_poses(setup)
    random = np.random.default_rng(0)
    for k in range(_STARTS):
        T_frame_base = setup.T_frame_base.copy()
        T_frame_base[f] = _random_pose(random, setup.unknown[f], centre, _FARTHEST * spread)
        # A target's own place is the best guess of it, be it given or at the tip.
        T_tip_target = targets[0] if k % 2 == 0 else targets[k // 2 % len(targets)]
        yield setup.with_poses(T_frame_base, T_tip_target)


def _random_pose(
    random: np.random.Generator,
    directions: tuple[str, ...],
    centre: Array,
    farthest: float,
) -> Array:
    """Draw T_frame_base of a frame, (4, 4) [m], displaced from the identity in the directions that are estimated.

    Its origin is at most ``farthest`` [m] from the centre, (3,) [m], in the base, and its rotation uniform in SO(3), if
    all six are estimated; of ``"x"`` to ``"rz"`` those that are not stay zero.
    """
    translates, turns = np.array([axis in directions for axis in DIRECTIONS]).reshape(2, 3)
    quaternion = random.standard_normal(4)  # its scalar is the last one
    quaternion[:3] *= turns
    away = random.standard_normal(3)
    away *= farthest * random.uniform() / np.linalg.norm(away)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
    T[:3, 3] = np.where(translates, -T[:3, :3] @ (centre + away), 0.0)
    return T
