"""Coverage: the measured part of the joints' ranges and of the workspace, rows and errors outside of it, and views."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.camera.optics import POINT
from calib.diagnosis.reasons import Reason, Why
from calib.fit.estimate.fitting import Fitted
from calib.fit.estimate.prior_terms import PriorTerms
from calib.fit.estimate.stages import Stage
from calib.fit.registration.rows import Rows
from calib.numerics.likelihood import GaussianPriors
from calib.robot.kernel import over_blocks, sum_over_blocks
from calib.robot.ranges import column_ranges, spread_poses
from calib.robot.robot import Robot

#: A joint value is outside when it is farther from the measured range than this share of the range.
_MARGIN = 0.05

#: A joint whose values differ by less than this did not move [rad or m]; nor is a value this near outside.
_STILL = 1e-3

#: The rows hardly determine the errors of a turning joint that moves less than this [rad].
_HARDLY_MOVED_RAD = 0.35

#: The same of a sliding joint [m].
_HARDLY_MOVED_M = 0.05

#: If the measured tips spread less than this share of what the joints allow, only a corner of the workspace was
#: measured. Random poses reach 0.8 to 1.2, the paper's 0.43, a 20 cm cube of a UR3's workspace 0.28.
_CORNER = 1.0 / 3.0

#: A joint whose measured values span less than this share of its range counts as only partly measured.
_NARROW = 1.0 / 3.0

#: A board that was never tilted by more than this was always seen head on [rad].
_HEAD_ON = np.radians(15.0)

#: An image with fewer corners determines the board's pose poorly, however well it fits.
FEW_CORNERS = 15

#: A larger share of images with few corners is reported.
_SHARE = 0.2

#: If turns of the hand spread by less about all axes but one, the camera's place along that one is undetermined [rad].
_ONE_AXIS = np.radians(10.0)


#: A pose alone determines a direction if the others predict it with so many standard deviations of the noise: its
#: leverage is above 0.99.
_UNPREDICTED = 10.0

#: And of so many times that of the typical pose: if rows are few, the others predict none of them well.
_ABOVE_TYPICAL = 10.0

#: A frame or target of which rows of other poses measure fewer scalars is not determined without the pose, whatever its
#: joints do: three times the unknowns of a pose.
_FEWEST_SCALARS = 18

#: A leverage is below 1, except for rounding.
_HIGHEST_LEVERAGE = 1.0 - 1e-9

#: The share of the rows at each end of a joint's measured values that are predicted by the others.
_OUTER = 0.2

#: An end with fewer rows is not used: their errors say little.
_FEWEST_OUTER = 3


# Rows outside of the measured range


@dataclass(frozen=True, slots=True)
class Beyond:
    """A joint value outside the measured range."""

    #: The joint's name
    joint: str
    #: Whether it slides
    prismatic: bool
    #: Distance from the nearest end of the measured range, > 0 [rad or m]
    by: float


@dataclass(frozen=True, slots=True)
class OutsideRow:
    """A row with joint values outside the measured range."""

    #: The number of the queried row, from 0
    index: int
    #: The joint farthest out first, in shares of their measured range
    beyond: tuple[Beyond, ...]


def outside(
    measured: Array,
    queried: Array,
    names: Sequence[str],
    types: Sequence[str],
) -> tuple[OutsideRow, ...]:
    """Find the queried rows with joint values outside the measured range.

    A continuous joint's range is the circle without the largest gap between its values; a margin of 5 % is allowed.

    Args:
        measured: Joint values of N fitted rows, shape (N, m) [rad or m].
        queried: Joint values of K rows, shape (K, m) [rad or m].
        names: Names of the m joints.
        types: Their URDF types: ``"revolute"``, ``"continuous"`` or ``"prismatic"``.

    Returns:
        The queried rows outside, in their order: each its index, from 0, and the joints outside, with their distances
        from the range [rad or m]; empty if there are no measured rows.
    """
    if not len(measured) or not len(queried):
        return ()

    # Distances from the nearer end of the range, 0 inside; of a continuous joint along the circle.
    distances, spans = np.zeros(queried.shape), np.zeros(len(names))
    for j, kind in enumerate(types):
        low, span = _range(measured[:, j], kind)
        q, spans[j] = queried[:, j], span
        if kind == "continuous":
            after = np.mod(q - low, 2.0 * np.pi) - span
            nearest = np.minimum(after, 2.0 * np.pi - span - after)
            distances[:, j] = np.where(after <= 0.0, 0.0, nearest)
        else:
            distances[:, j] = np.maximum(0.0, np.maximum(low - q, q - low - span))

    spans = np.maximum(spans, _STILL)
    out = distances > np.maximum(_MARGIN * spans, _STILL)
    rows = []
    for i in np.flatnonzero(out.any(axis=1)):
        farthest_first = np.argsort(-distances[i] / spans, kind="stable")
        beyond = [
            Beyond(names[j], types[j] == "prismatic", float(distances[i, j]))
            for j in farthest_first
            if out[i, j]
        ]
        rows.append(OutsideRow(int(i), tuple(beyond)))
    return tuple(rows)


def _range(q: Array, kind: str) -> tuple[float, float]:
    """Return where the range of a joint's values (N,) begins and its length, [rad] or [m], by its URDF type.

    Of a continuous joint it is the circle without the largest gap between values, and begins between 0 and 2 pi.
    """
    if kind != "continuous":
        return float(q.min()), float(np.ptp(q))
    turned = np.sort(np.mod(q, 2.0 * np.pi))
    gaps = np.diff(turned, append=turned[0] + 2.0 * np.pi)
    widest = int(np.argmax(gaps))
    after_gap = (widest + 1) % len(turned)
    return float(turned[after_gap]), float(2.0 * np.pi - gaps[widest])


def extrapolation(fitted: Fitted) -> float:
    """Compare errors of extrapolated predictions with those expected by a fit's covariance.

    Rows at one end of a joint's values are predicted by a linear fit to the others, for both ends of each joint: beyond
    their noise, |r|^2 - sigma^2, they should be off by tr(A C A^T), with the residuals r, the derivatives A of the rows
    by the parameters, and the covariance C of the fit to the others. What the model lacks does not average out over the
    rows as noise does, so with many rows the covariance includes too little of it.

    Args:
        fitted: The fit to N rows.

    Returns:
        The ratio of squared errors, 1 or more; 1 if no end has enough rows.
    """
    estimate = fitted.estimate
    problem, rows = estimate.problem, estimate.problem.rows

    # The rows at each end of each joint's values, whole pairs, if there are enough and others beside them; the ends are
    # those of the values of rows with a weight in the fit.
    masks = []
    for q in rows.joints.T:
        low, high = np.quantile(q[estimate.weights > 0.0], [_OUTER, 1.0 - _OUTER])
        if not low < high:
            continue
        for outer in (q <= low, q >= high):
            mask = rows.with_partners(outer)
            if _FEWEST_OUTER <= np.sum(mask) < 0.5 * len(rows):
                masks.append(mask)
    if not masks:
        return 1.0

    # Fits without the rows of each mask, at noise and priors of the fit to all rows.
    linear = problem.linear(estimate.x)
    noise = np.tile(estimate.noise, (len(masks), 1))
    weights = np.where(np.array(masks), 0.0, problem.weights)
    priors = GaussianPriors(problem.prior_precision, problem.prior_mean)
    x, covariances, _ = linear.fit(weights, problem.stop_shares, noise, priors)
    by_channel = np.append(estimate.noise, 1.0)

    def of_block(block: slice) -> Array:
        """The sums over some of the rows: of squares beyond the noise, and of variances."""
        noise_of_rows = by_channel[rows.channels.index[block]]
        residuals = linear.residual_of(x, block) / noise_of_rows
        A = linear.columns_of(block)[:-1].transpose(2, 1, 0) / noise_of_rows[:, :, None]
        weights = rows.used[block] * problem.weights[block, None]
        sums = np.zeros(2)
        for mask, residual, C in zip(masks, residuals, covariances, strict=True):
            outer = np.flatnonzero(mask[block])
            A_C = A[outer] @ C
            variances = np.sum(A_C * A[outer], axis=2)
            squares = residual[outer] ** 2 - 1.0
            sums += np.sum(weights[outer] * squares), np.sum(weights[outer] * variances)
        return sums

    beyond, expected = map(float, sum_over_blocks(of_block, len(rows)))
    if not expected > 0.0:
        return 1.0
    return float(max(beyond / expected, 1.0))


# The measured part of ranges and workspace


def still_joints(robot: Robot, rows: Rows) -> Iterator[Reason]:
    """Name joints that hardly moved, so that the rows hardly determine their errors.

    Args:
        robot: The robot.
        rows: The rows that were fitted.

    Yields:
        One reason `Why.JOINTS_STILL` with the joints' names; none if all moved.
    """
    still = np.flatnonzero(hardly_moved(robot, rows))
    if len(still):
        yield Reason.of(Why.JOINTS_STILL, joints=", ".join(robot.joint_names[j] for j in still))


def hardly_moved(robot: Robot, rows: Rows) -> Mask:
    """Find the joints that hardly moved over the rows.

    Args:
        robot: The robot, with m measured joints, each turning or sliding.
        rows: N rows.

    Returns:
        True for a joint whose values span less than `_HARDLY_MOVED_RAD`, or `_HARDLY_MOVED_M` if it slides, shape (m,).
    """
    slides = np.array([joint.type == "prismatic" for joint in robot.inputs])
    least = np.where(slides, _HARDLY_MOVED_M, _HARDLY_MOVED_RAD)
    return np.asarray(np.ptp(robot.input_values(rows.joints), axis=0) < least)


def sole_postures(
    fitted: Fitted, numbers: Integers, images: Sequence[str] = ()
) -> Iterator[Reason]:
    """Name poses that alone determine a direction of the parameters: a joint moves only there, say.

    With the derivative A of what is predicted at the pose, in units of the noise, and the covariance C of the
    parameters by all rows and the priors as given, the pose's leverage k is the largest eigenvalue of A C A^T, and the
    others predict it with sqrt(k / (1 - k)) standard deviations of the noise (D. A. Belsley, E. Kuh, R. E. Welsch:
    Regression Diagnostics, 1980). Nothing in the estimate changes.

    Args:
        fitted: A fit to N rows.
        numbers: The rows' numbers in the table, shape (N,).
        images: Of rows that are corners in pictures the picture's name, N strings; empty: there are no such rows.

    Yields:
        At most one reason: of each such pose the number of its first row, its picture, and the joint whose value there
        is farthest from that of all other rows, as a share of its range.
    """
    problem, rows = fitted.estimate.problem, fitted.estimate.problem.rows
    linear = problem.linear(fitted.estimate.x)
    prior = PriorTerms.of(fitted.task, fitted.kinematics.model, fitted.setup)
    every_row = np.ones((1, len(rows)), dtype=bool)
    first = Stage.initial(prior, every_row, len(problem.noise))
    _, covariances, _ = replace(first, noise=problem.noise[None]).fit(linear)
    by_channel = np.append(problem.noise, 1.0)

    def traces_of(rows_of_block: slice) -> Array:
        """Traces of the leverages of some of the rows, (n,)."""
        A = linear.columns_of(rows_of_block)[:-1]
        carried = (covariances[0] @ A.reshape(len(A), -1)).reshape(A.shape)
        noise = by_channel[rows.channels.index[rows_of_block]].T
        return np.asarray(np.sum(np.einsum("pdn,pdn->dn", carried, A) / noise**2, axis=0))

    # The trace bounds the largest eigenvalue: only poses whose bound is high are looked at.
    block = np.unique(rows.blocks, return_inverse=True)[1].reshape(-1)
    leverage = np.bincount(block, np.concatenate(over_blocks(traces_of, len(rows))))
    for b in np.flatnonzero(leverage > 0.5).tolist():
        is_pose = block == b
        A_pose = linear.select(is_pose).A / by_channel[rows.channels.index[is_pose]][:, :, None]
        of_pose = A_pose[rows.used[is_pose]]
        leverage[b] = np.linalg.eigvalsh(of_pose @ covariances[0] @ of_pose.T)[-1]
    leverage = np.clip(leverage, 0.0, _HIGHEST_LEVERAGE)
    unpredicted = np.sqrt(leverage / (1.0 - leverage))
    limit = max(_UNPREDICTED, _ABOVE_TYPICAL * float(np.median(unpredicted)))
    sole = (unpredicted > limit)[block] & _seen_by_others(rows, block)

    robot = fitted.task.robot
    values = robot.input_values(rows.joints)
    low, high = column_ranges(robot).T
    joints: dict[int, str] = {}  # by the row's number in the table
    pictures = []
    for b in np.unique(block[sole]).tolist():
        of_pose = block == b
        here = int(np.flatnonzero(of_pose)[0])
        nearest = np.min(np.abs(values[~of_pose] - values[here]), axis=0) / (high - low)
        joints[int(numbers[here])] = robot.joint_names[int(np.argmax(nearest))]
        pictures.append(images[here] if images else "")
    if joints:
        named = {"pictures": pictures} if any(pictures) else {}
        yield Reason.of(Why.SOLE_POSTURE, rows=list(joints), joints=list(joints.values()), **named)


def _seen_by_others(rows: Rows, block: Integers) -> Mask:
    """Rows, (N,), whose frame and target are determined by rows of other poses, numbered by ``block``, (N,)."""
    scalars = np.sum(rows.used, axis=1)
    result = np.ones(len(rows), dtype=bool)
    for places in (rows.samples.frame, rows.samples.target):
        pair = np.unique(np.column_stack([places, block]), axis=0, return_inverse=True)[1]
        pair = pair.reshape(-1)
        others = np.bincount(places, scalars)[places] - np.bincount(pair, scalars)[pair]
        result &= others >= _FEWEST_SCALARS
    return result


def partial_coverage(fitted: Fitted) -> Iterator[Reason]:
    """Say if the poses cover only part of the joints' ranges, or a corner of the workspace, and which.

    Joints that hardly moved are named by another reason.

    Args:
        fitted: A fit; rows without weight do not count in spread and shares.

    Yields:
        At most one reason: ``spread``, the rms distance of the tips from their mean over that in the whole workspace,
        and of each joint that used little of its range (if none did, of the one that used least), the narrowest first,
        its name, the share of its range that it used, its lowest and highest value, [rad] or [m], and whether it
        slides. None if no joint moved.
    """
    robot, rows = fitted.task.robot, fitted.estimate.problem.rows
    weighted = fitted.estimate.weights > 0.0
    q = rows.joints[weighted]
    spreads = []
    for number, chain in enumerate(robot.chains):
        of_chain = rows.select(weighted).samples.rows_of_chain(number)
        if not len(of_chain):
            continue
        # Hands that touch, or see each other, hardly move in one another: the way of each in the robot counts.
        for arm in chain.arms:
            columns = [robot.joint_names.index(name) for name in arm.joint_names]
            possible_tips = arm.poses(spread_poses(robot)[:, columns])[:, :3, 3]
            tips = arm.poses(q[of_chain][:, columns])[:, :3, 3]
            spreads.append(spread_of(tips, possible_tips))
    spread = min(spreads, default=0.0)
    values = robot.input_values(q)
    shares = shares_of_ranges(values, column_ranges(robot), [j.type for j in robot.inputs])

    moved = ~hardly_moved(robot, rows)
    narrow = np.flatnonzero((shares < _NARROW) & moved).tolist()
    if not np.any(moved) or (spread >= _CORNER and not narrow):
        return
    narrowest = int(np.argmin(np.where(moved, shares, np.inf)))
    narrow = sorted(narrow or [narrowest], key=lambda j: shares[j])
    yield Reason.of(
        Why.CORNER,
        spread=spread,
        joints=[robot.joint_names[j] for j in narrow],
        shares=[float(shares[j]) for j in narrow],
        lows=[float(values[:, j].min()) for j in narrow],
        highs=[float(values[:, j].max()) for j in narrow],
        slides=[robot.inputs[j].type == "prismatic" for j in narrow],
    )


def spread_of(tips: Array, everywhere: Array) -> float:
    """Compare the spread of measured tips with that of the workspace.

    Args:
        tips: Measured positions of the tip, shape (N, 3) [m].
        everywhere: Positions of the tip all over the workspace, shape (K, 3) [m].

    Returns:
        The root mean square distance of the measured tips from their mean, over that of the others; 1 if these are
        all at one place.
    """
    possible = _variance(everywhere)
    if not possible > 0.0:
        # An arm whose tip cannot move at all has been measured everywhere.
        return 1.0
    return float(np.sqrt(_variance(tips) / possible))


def _variance(points: Array) -> float:
    """Variance of points (N, 3): their mean squared distance from their mean, over N - 1 [m^2]."""
    from_mean = points - points.mean(axis=0)
    return float(np.sum(from_mean**2)) / max(len(points) - 1, 1)


def shares_of_ranges(joints: Array, ranges: Array, types: Sequence[str]) -> Array:
    """Find the share of each joint's range that rows use.

    Args:
        joints: Joint values of the rows, shape (N, m) [rad or m].
        ranges: Lower and upper limit of each joint, shape (m, 2); for a turning joint at most a full turn counts.
        types: URDF types of the joints; what a ``"continuous"`` one uses is the circle without the largest gap
            between its values.

    Returns:
        The shares, 0 to 1, shape (m,); 1 of a joint whose range is empty or infinite.
    """
    spans = np.array([_range(q, kind)[1] for q, kind in zip(joints.T, types, strict=True)])
    turning = np.array([kind != "prismatic" for kind in types])
    most = np.where(turning, 2.0 * np.pi, np.inf)
    room = np.minimum(ranges[:, 1] - ranges[:, 0], most)
    limited = (room > 0.0) & np.isfinite(room)
    shares = spans / np.where(limited, room, 1.0)
    return np.where(limited, np.minimum(shares, 1.0), 1.0)


# Views of boards


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """The n views of a fit: a board in a camera at one pose of the robot."""

    #: Shape (n,), number of corners seen
    corners: Integers
    #: Shape (n,), angle between the line of sight to the board and its normal [rad]; a right angle for a body, whose
    #: corners at several heights tell its distance as those of a tilted board do
    tilt: Array
    #: Shape (n, 3, 3), orientation of the tip in the base
    R_base_tip: Array

    @classmethod
    def of(cls, fitted: Fitted) -> Views:
        """Return the n views that a fit saw: of a board's corners in one image there is one row each in the fit.

        Rows of other kinds are left out; at least one is a corner in an image.
        """
        rows = fitted.estimate.problem.rows
        images = rows.select(rows.is_image)
        T_camera_board = fitted.kinematics.poses(fitted.estimate.x, images.samples)
        points = images.points(T_camera_board)
        labels = np.column_stack([images.blocks, images.samples.frame, images.samples.target])
        _, first, view = np.unique(labels, axis=0, return_index=True, return_inverse=True)
        view = view.reshape(-1)
        count = np.bincount(view)
        sums = np.stack([np.bincount(view, column) for column in points.T], axis=1)
        middle = sums / count[:, None]
        sight = middle / np.linalg.norm(middle, axis=1, keepdims=True)
        cosine = np.abs(np.sum(sight * T_camera_board[first, :3, 2], axis=1))
        tilt = np.arccos(np.minimum(cosine, 1.0))
        assert images.samples.internals is not None
        height = images.samples.internals[:, POINT][:, 2]
        tilt[np.bincount(view, np.abs(height)) > 0.0] = 0.5 * np.pi
        chain = images.samples.select(first).chain
        R_base_tip = fitted.task.robot.poses(images.joints[first], chain)[:, :3, :3]
        return cls(count, tilt, R_base_tip)


def doubtful_views(fitted: Fitted) -> Iterator[Reason]:
    """Doubt images that all show the board head on, or few of its corners, or turned about one axis only.

    Args:
        fitted: A fit; nothing is doubted without images.

    Yields:
        A reason for each of these three: the largest tilt [rad]; how many images have few corners, and how many there
        are; the spread of the tip's turns across their main axis [rad].
    """
    if not np.any(fitted.estimate.problem.rows.is_image):
        return
    views = Views.of(fitted)
    most = float(np.max(views.tilt))
    if most < _HEAD_ON:
        yield Reason.of(Why.BOARD_HEAD_ON, tilt_rad=most)
    few = int(np.sum(views.corners < FEW_CORNERS))
    if few > _SHARE * len(views.corners):
        yield Reason.of(Why.FEW_CORNERS, images=few, all=len(views.corners), corners=FEW_CORNERS)
    across = spread_of_axes(views.R_base_tip)
    if across < _ONE_AXIS:
        yield Reason.of(Why.ONE_AXIS, across_rad=across)


def spread_of_axes(rotations: Array) -> float:
    """Return how far rotations go about axes other than their main one.

    Args:
        rotations: Rotation matrices, at least one, shape (n, 3, 3).

    Returns:
        Root mean square of their rotation vectors from a middle one, along the second of their principal axes [rad].
    """
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_matrix(rotations)
    vectors = (turns * turns.mean().inv()).as_rotvec()
    return float(np.sqrt(np.linalg.eigvalsh(vectors.T @ vectors / len(vectors))[1]))
