"""Inverse kinematics of an arm with known errors: joint values that bring its tool to a pose, near those given.

The error of a pose along the tool's own axes, in the order of a twist, and a Levenberg-Marquardt step on it, all rows
at once, with the singular values of the Jacobian J = U S V^T:

    e  = (R_now^T (p_wanted - p_now), log(R_now^T R_wanted))
    dq = V S (S^2 + lambda^2)^-1 U^T e + (1 - V_r V_r^T) (q_start - q)

The damping lambda is zero until a step fails to lower the error; the second term keeps a redundant arm at the joint
values nearest to those at which it started. Steps are short, so that a row stays in its branch. If readings are
coupled, steps are in the joints' values, to which the limits apply; starts and solutions are readings. Source:
Y. Nakamura, H. Hanafusa, Inverse kinematic solutions with singularity robustness, 1986.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array, Mask, read_only, rigid_inverse
from calib.basics.units import unit_fault
from calib.errors import ModelError, choices
from calib.robot.ranges import column_limits, full_ranges, spread_between
from calib.robot.robot import Robot
from calib.verbs.compensate.nominal_actual import Arm

POSE = "pose"  #: Position and orientation are matched.
POSITION = "position"  #: The position alone is matched.
AXIS = "axis"  #: Position and direction of the tool's z axis are matched.

MATCHES = (POSE, POSITION, AXIS)

#: No joint moves farther than this in one step [rad or m].
_LONGEST_STEP = 0.3

#: A row rests if its next step is shorter than this [rad or m] ...
_STILL = 1e-12

#: ... or lowers its squared error by a smaller share than this.
_STALLED = 1e-9

#: An error below this is rounding [m].
_NOTHING = 1e-13

#: A pose with an error above this is not reached [m].
_REACHED = 1e-9

#: Joints that start at a limit start again so far inside of it [rad] or [m].
_INSIDE = 0.01

#: Damping after the first step that failed, relative to the largest singular value.
_FIRST_DAMPING = 1e-3

#: Damping at which a row is given up.
_LARGEST_DAMPING = 1e3

#: Damping below this becomes zero after a step that succeeded.
_LEAST_DAMPING = 1e-6

#: Joint values may exceed their limits by this much [rad or m].
_ROUNDING = 1e-9

#: Singular values below this share of the largest are zero.
_RANK = 1e-9

#: Number of sets of joint values to start at if the row before is not a good start, and steps from each.
_SPREAD = 48
_STEPS = 30

_TURN = 2.0 * np.pi


class Matching(NamedTuple):
    """Part of a pose that is matched."""

    #: One of `MATCHES`.
    name: str
    #: Length that one radian counts as [m].
    length: float

    @property
    def rows(self) -> int:
        """Number of scalars that are matched."""
        return {POSE: 6, POSITION: 3, AXIS: 5}[self.name]

    def error(self, T_now: Array, T_wanted: Array) -> Array:
        """Compute the error of poses along the tool's own axes, wanted minus now.

        Args:
            T_now: Poses of the tool as they are, in any one frame, shape (N, 4, 4), [m].
            T_wanted: Wanted poses in the same frame, shape (N, 4, 4), [m].

        Returns:
            The position, then the angles that `name` matches times `length`, shape (N, 6), (N, 3) or (N, 5), [m].
        """
        T_now_wanted = rigid_inverse(T_now) @ T_wanted
        R = T_now_wanted[:, :3, :3]
        position = T_now_wanted[:, :3, 3]
        if self.name == POSITION:
            return position
        if self.name == AXIS:
            angles = _tilt(R[:, :, 2])
        else:
            angles = np.full((len(R), 3), np.nan)
            is_number = np.isfinite(R).all(axis=(1, 2))
            if is_number.any():
                angles[is_number] = Rotation.from_matrix(R[is_number]).as_rotvec()
        return np.concatenate([position, self.length * angles], axis=1)

    def motions(self, error: Array) -> Array:
        """Compute the motions exp(e) along the tool's own axes that remove errors: T_now exp(e) = T_wanted.

        Args:
            error: As `error` returns it, shape (N, rows), [m]; directions that are not matched do not move.

        Returns:
            shape (N, 4, 4), [m]; exact for small angles.
        """
        twists = np.zeros((len(error), 6))
        twists[:, :3] = error[:, :3]
        twists[:, 3 : self.rows] = error[:, 3:] / self.length
        return np.array([pin.exp6(twist).homogeneous for twist in twists])

    def jacobian(self, twists: Array) -> Array:
        """Return the matched rows of the tool's twists, angles times `length`.

        Args:
            twists: Motion of the tool per joint value, along the tool's own axes, linear part first,
                shape (N, 6, m), [m or rad per rad or m].

        Returns:
            shape (N, rows, m), [m per rad or m].
        """
        rows = twists[:, : self.rows].copy()
        rows[:, 3:] *= self.length
        return np.asarray(rows)

    def misses(self, T_now: Array, T_wanted: Array) -> Array:
        """Compute distance and angle between poses, of what `name` says is matched.

        Args:
            T_now: Poses of the tool as they are, in any one frame, shape (N, 4, 4), [m].
            T_wanted: Wanted poses in the same frame, shape (N, 4, 4), [m].

        Returns:
            Distance [m] and angle [rad], shape (N, 2); the angle is NaN if it is not matched.
        """
        error = self.error(T_now, T_wanted)
        distance = np.linalg.norm(error[:, :3], axis=1)
        angle = np.full(len(error), np.nan)
        if self.rows > 3:
            angle = np.linalg.norm(error[:, 3:], axis=1) / self.length
        return np.stack([distance, angle], axis=1)


class Solution(NamedTuple):
    """Readings of the joints, as near to the wanted poses as was found, and the tool there."""

    #: Readings, shape (N, m), [rad] or [m].
    q: Array
    #: Shape (N, 4, 4), [m].
    T_base_tool: Array
    #: Shape (N, 6, m), see `calib.verbs.compensate.nominal_actual.Arm.motion`.
    twists: Array


def solve(
    arm: Arm,
    T_wanted: Array,
    start: Array,
    matching: Matching,
    limits: Array | None = None,
    *,
    steps: int = 400,
) -> Solution:
    """Solve for joint values that bring the tool to poses, near those that each row starts at.

    A redundant arm keeps to the limits. Any other goes beyond them if it must: the caller checks that, and how far a
    pose is missed.

    Args:
        arm: The robot with its errors and its tool.
        T_wanted: Poses of the tool in the base, shape (N, 4, 4), [m].
        start: Readings of the joints to start at, shape (N, m), [rad] or [m].
        matching: Part of the poses that is matched: pose, position, or position and axis.
        limits: Lowest and highest joint values, shape (m, 2), [rad] or [m]; None: there are none.
        steps: Maximum number of steps.

    Returns:
        The readings of the joints where each row rests, and the tool there; read-only.
    """
    joint_count = start.shape[1]
    is_redundant = joint_count > matching.rows
    if limits is None or not is_redundant:
        limits = np.tile([-np.inf, np.inf], (joint_count, 1))
    values = arm.robot.input_values(start)
    found = _search(arm, T_wanted, values, matching, limits, pulled=is_redundant, steps=steps)
    if is_redundant:
        # Next to a singularity the pull can be in the way of what can be reached, and so can joints that start at their
        # limits, which the first steps hold there: without either, some rows come nearer.
        inside = np.clip(values, limits[:, 0] + _INSIDE, limits[:, 1] - _INSIDE)
        for begin, pulled in ((values, False), (inside, True)):
            _, _, _, error = found
            miss = np.linalg.norm(error, axis=1)
            missed = np.flatnonzero(miss > _REACHED)
            if not len(missed):
                break
            goals, starts = T_wanted[missed], begin[missed]
            missed_arm = arm.at_rows(missed)
            again = _search(missed_arm, goals, starts, matching, limits, pulled=pulled, steps=steps)
            _, _, _, error_again = again
            nearer = np.linalg.norm(error_again, axis=1) < miss[missed]
            for rows, rows_again in zip(found, again, strict=True):
                rows[missed[nearer]] = rows_again[nearer]
    q, T_base_tool, twists, _ = found
    return Solution(read_only(arm.robot.readings(q)), read_only(T_base_tool), read_only(twists))


def _search(
    arm: Arm,
    T_wanted: Array,
    start: Array,
    matching: Matching,
    limits: Array,
    *,
    pulled: bool,
    steps: int,
) -> tuple[Array, Array, Array, Array]:
    """Take steps of N rows from start values towards wanted poses of the tool, inside the limits, until each rests.

    If ``pulled``, a redundant arm is drawn towards the joint values (N, m) that it starts at. Returned are the joint
    values where the rows rest, T_base_tool and twists there as of `Arm.motion`, and the error left of `Matching.error`.
    """
    low, high = limits.T
    q = np.clip(start, low, high)
    T_base_tool, twists = arm.motion(arm.robot.readings(q))
    error = matching.error(T_base_tool, T_wanted)
    damping = np.zeros(len(start))
    moving = np.arange(len(start))  # the rows that do not rest
    for _ in range(steps):
        if not len(moving):
            break
        jacobian = matching.jacobian(twists[moving])
        pull = start[moving] - q[moving] if pulled else None
        dq = _step_inside(jacobian, error[moving], damping[moving], pull, q[moving], limits)
        q_tried = np.clip(q[moving] + dq, low, high)
        is_cut = (q_tried != q[moving] + dq).any(axis=1)
        T_tried, twists_tried = arm.at_rows(moving).motion(arm.robot.readings(q_tried))
        error_tried = matching.error(T_tried, T_wanted[moving])

        # A row takes the step if its error is not larger there, or is rounding.
        before = np.einsum("ni,ni->n", error[moving], error[moving])
        after = np.einsum("ni,ni->n", error_tried, error_tried)
        is_better = after <= np.maximum(before, _NOTHING**2)
        taken = moving[is_better]
        q[taken] = q_tried[is_better]
        T_base_tool[taken] = T_tried[is_better]
        twists[taken] = twists_tried[is_better]
        error[taken] = error_tried[is_better]

        lower = np.where(damping[moving] > _LEAST_DAMPING, damping[moving] / 5.0, 0.0)
        higher = np.maximum(10.0 * damping[moving], _FIRST_DAMPING)
        damping[moving] = np.where(is_better, lower, higher)

        # A row rests if it moves no more, or if what it gains is not worth another step. One whose step was cut short
        # by a limit does not rest yet: the next step holds the joint at the limit.
        is_still = np.abs(dq).max(axis=1) <= _STILL
        gains_little = before - after <= _STALLED * after
        is_stalled = is_better & (after > _NOTHING**2) & gains_little
        rests = (is_still | is_stalled) & ~is_cut
        is_given_up = damping[moving] > _LARGEST_DAMPING
        moving = moving[~rests & ~is_given_up]
    return q, T_base_tool, twists, error


def _step_inside(
    jacobian: Array, error: Array, damping: Array, pull: Array | None, q: Array, limits: Array
) -> Array:
    """Return the step of `_step`, (n, m) [rad] or [m], shortened to `_LONGEST_STEP`, that pushes no joint outwards.

    The joint values q are (n, m), their limits (m, 2); one at a limit is not moved beyond it. Joints that the step
    would push through their limits are held, until none of these is left.
    """
    low, high = limits.T
    held = np.zeros(q.shape, dtype=bool)
    while True:
        dq = _step(jacobian, error, damping, pull, held)
        pushes_down = (q <= low) & (dq < 0.0)
        pushes_up = (q >= high) & (dq > 0.0)
        if not (pushes_down | pushes_up).any():
            break
        held |= pushes_down | pushes_up
    longest = np.abs(dq).max(axis=1, keepdims=True)
    scale = np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, 1e-300))
    return np.asarray(dq * scale)


def _step(J: Array, error: Array, damping: Array, pull: Array | None, held: Mask) -> Array:
    """Return the damped step of n rows, and the pull of a redundant arm to where it started, (n, m) [rad] or [m].

        dq = V S (S^2 + lambda^2)^-1 U^T e + (1 - V_r V_r^T) pull,    J = U S V^T

    J is the Jacobian of what is matched, (n, rows, m), e its error; lambda, (n,), is relative to the largest singular
    value; the pull is start minus present joint values, (n, m), None for no pull; joints that are held, (n, m), do not
    move.
    """
    U, S, Vt = np.linalg.svd(J * ~held[:, None, :], full_matrices=False)
    largest = S[:, :1]
    nonzero = _RANK * largest < S
    damped = S**2 + (damping[:, None] * largest) ** 2
    divisor = np.where(nonzero, damped, 1.0)
    inverse = np.where(nonzero, S / divisor, 0.0)
    coordinates = np.einsum("nij,ni->nj", U, error) * inverse
    step = np.einsum("nji,nj->ni", Vt, coordinates)
    if pull is not None:
        free_pull = np.where(held, 0.0, pull)
        used = np.einsum("nji,ni->nj", Vt, free_pull) * nonzero
        step += free_pull - np.einsum("nji,nj->ni", Vt, used)
    return np.where(held, 0.0, step)


def _tilt(z: Array) -> Array:
    """Return the smallest rotations, about x and y, (N, 2) [rad], that bring the tool's z axis to directions (N, 3)."""
    sine = np.hypot(z[:, 0], z[:, 1])
    across = np.stack([-z[:, 1], z[:, 0]], axis=1)
    across[sine == 0.0] = [1.0, 0.0]  # straight back may be reached by any turn; about x is one
    length = np.where(sine == 0.0, 1.0, sine)
    axis = across / length[:, None]
    angle = np.arctan2(sine, z[:, 2])
    return np.asarray(axis * angle[:, None])


def follow(arm: Arm, T_wanted: Array, start: Array, matching: Matching) -> Solution:
    """Solve poses in turn, each near the solution of the one before, and the first near a start.

    If none is found inside the limits, solutions from joint values spread over the limits are compared.

    Args:
        arm: The robot with its errors and its tool.
        T_wanted: Poses of the tool in the base, shape (N, 4, 4), [m].
        start: Readings of the joints near which the first pose is solved, shape (m,), [rad] or [m].
        matching: Part of the poses that is matched.

    Returns:
        The readings at the N poses, and the tool there; of a pose that cannot be reached those that miss it least.
    """
    spread = arm.robot.readings(spread_between(full_ranges(arm.robot), _SPREAD))
    q = np.empty((len(T_wanted), len(start)))
    for i, T in enumerate(T_wanted):
        before = start
        is_solved = False
        if i > 0:
            before = q[i - 1]
            q[i], is_solved = _nearest(arm, T, before[None], matching)
        if not is_solved:
            seeds = np.vstack([before, spread])
            q[i], _ = _nearest(arm, T, seeds, matching)
    return Solution(read_only(q), *arm.motion(q))


def _nearest(arm: Arm, T: Array, seeds: Array, matching: Matching) -> tuple[Array, bool]:
    """Return, of the solutions for a pose (4, 4) from seeds (n, m), the one nearest to the first seed, and True.

    If none of them is inside the limits, it is the one that misses least, and False. Seeds and solution are readings.
    """
    robot = arm.robot
    limits = column_limits(robot)
    T_wanted = np.tile(T, (len(seeds), 1, 1))
    solution = solve(arm, T_wanted, seeds, matching, limits, steps=_STEPS)
    allowed = limits + np.array([-_ROUNDING, _ROUNDING])
    first_seed = robot.input_values(seeds[0])[0]
    q = by_whole_turns(robot, robot.input_values(solution.q), first_seed, allowed)
    is_inside = ((q >= allowed[:, 0]) & (q <= allowed[:, 1])).all(axis=1)
    misses = np.linalg.norm(matching.error(solution.T_base_tool, T_wanted), axis=1)
    is_solution = (misses <= 10.0 * _REACHED) & is_inside
    is_found = bool(is_solution.any())
    cost = misses
    if is_found:
        cost = np.where(is_solution, np.linalg.norm(q - first_seed, axis=1), np.inf)
    return robot.readings(q[int(np.argmin(cost))])[0], is_found


def may_turn(robot: Robot) -> Mask:
    """Return which measured joints may be whole turns away at the same pose, shape (m,).

    Joints that slide, or that others follow in another ratio than 1, may not.
    """
    result = []
    for name, column in zip(robot.joint_names, robot.mimic_matrix.T, strict=True):
        turns = robot.joint_types[name] != "prismatic"
        # Joints that follow in another ratio would not make whole turns.
        is_one_to_one = set(np.abs(column)) <= {0.0, 1.0}
        result.append(turns and is_one_to_one)
    return np.array(result)


def by_whole_turns(robot: Robot, q: Array, seed: Array, allowed: Array) -> Array:
    """Turn joint values by whole turns as near to others as limits allow.

    Args:
        robot: The robot, with m measured joints.
        q: Joint values, shape (n, m), [rad] or [m].
        seed: Those to come near to, shape (m,).
        allowed: Limits, shape (m, 2).

    Returns:
        shape (n, m); joints that may not turn, see `may_turn`, stay.
    """
    low, high = allowed.T
    turned = q - _TURN * np.round((q - seed) / _TURN)
    turned = turned - _TURN * (turned > high) + _TURN * (turned < low)
    return np.where(may_turn(robot), turned, q)


def start_values(
    robot: Robot, named: Mapping[str, float] | None, others: float | None = None
) -> Array:
    """Return readings of the joints to start near.

    Args:
        robot: The robot.
        named: Readings of joints by name [rad] or [m]; None: none.
        others: Reading of the other joints; None: that in the middle of their ranges.

    Returns:
        shape (m,), [rad] or [m].

    Raises:
        ModelError: A joint that the chain does not have, or a value in the wrong unit.
    """
    values = robot.readings(full_ranges(robot).mean(axis=1))[0].copy()
    if others is not None:
        values[:] = others
    for name, value in (named or {}).items():
        if name not in robot.joint_names:
            raise ModelError(
                f"The chain has no joint '{name}' to start at; it has {choices(robot.joint_names)}."
            )
        fault = unit_fault(value, slides=robot.joint_types[name] == "prismatic")
        if fault:
            raise ModelError(f"The value of '{name}' to start at {fault}.")
        values[robot.joint_names.index(name)] = value
    return read_only(values)
