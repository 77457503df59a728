"""Inverse kinematics of an arm with known errors: joint values that bring its tool to a pose, near those given.

The error of a pose along the tool's own axes, in the order of a twist, and a Levenberg-Marquardt step on it, all rows
at once, with the singular values of the Jacobian J = U S V^T:

    e  = (R_now^T (p_wanted - p_now), log(R_now^T R_wanted))
    dq = V S (S^2 + lambda^2)^-1 U^T e + (1 - V_r V_r^T) (q_start - q)

The damping lambda is zero until a step fails to lower the error; the second term keeps a redundant arm at the joint
values nearest to where it started. Steps are short, so that a row stays in its branch. Where readings are coupled, the
steps are of the joints' values, which the limits are of; starts and solutions are readings. Source: Y. Nakamura,
H. Hanafusa, Inverse kinematic solutions with singularity robustness, 1986.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array, Mask, read_only, rigid_inverse
from calib.basics.units import unit_fault
from calib.errors import ModelError, choices
from calib.robot.ranges import column_limits, full_ranges, spread_between
from calib.robot.robot import Robot
from calib.verbs.compensate.nominal_actual import Arm

Indices = NDArray[np.int_]

POSE = "pose"  #: Position and orientation are matched.
POSITION = "position"  #: The position alone is matched.
AXIS = "axis"  #: Position and direction of the tool's z axis are matched.

MATCHES = (POSE, POSITION, AXIS)

#: No joint moves farther than this in one step [rad or m].
_LONGEST_STEP = 0.3

#: A row rests when its next step is shorter than this [rad or m] ...
_STILL = 1e-12

#: ... or lowers its squared error by a smaller share than this.
_STALLED = 1e-9

#: An error below this is rounding [m].
_NOTHING = 1e-13

#: A pose with an error above this is not reached [m].
_REACHED = 1e-9

#: Damping after the first step that failed, relative to the largest singular value.
_FIRST_DAMPING = 1e-3

#: Damping at which a row is given up, likewise.
_LARGEST_DAMPING = 1e3

#: Damping below this becomes zero after a step that succeeded, likewise.
_LEAST_DAMPING = 1e-6

#: Joint values may exceed their limits by this much [rad or m].
_ROUNDING = 1e-9

#: Singular values below this share of the largest are zero.
_RANK = 1e-9

#: Sets of joint values from which a solution is looked for where the row before is no good start.
_SPREAD = 48

#: Steps of each of these.
_STEPS = 30

_TURN = 2.0 * np.pi


class Matching(NamedTuple):
    """Part of a pose that is matched."""

    #: One of `MATCHES`.
    name: str
    #: Length that one radian weighs as [m].
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
            What `name` says is matched, shape (N, rows), with 6, 3 or 5 rows: the position, then angles times `length`
            [m].
        """
        T_now_wanted = rigid_inverse(T_now) @ T_wanted
        R = T_now_wanted[:, :3, :3]
        position = T_now_wanted[:, :3, 3]
        if self.name == POSITION:
            return position
        angles = _tilt(R[:, :, 2]) if self.name == AXIS else _rotation_vectors(R)
        return np.concatenate([position, self.length * angles], axis=1)

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
            Distance [m] and angle [rad], shape (N, 2); the angle is NaN where it is not matched.
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


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    """Poses that the tool of an arm is to reach in N rows, each near the joint values that it starts at."""

    #: The arm, with m measured joints.
    arm: Arm
    #: Wanted poses of the tool in the base, shape (N, 4, 4), [m].
    T_wanted: Array
    #: Joint values to start at, shape (N, m), [rad] or [m].
    start: Array
    #: What of the poses is matched.
    matching: Matching
    #: Lowest and highest joint values, shape (m, 2), [rad] or [m]; infinite where there is no limit.
    limits: Array
    #: Whether a redundant arm is pulled to the joint values that it starts at.
    pulled: bool

    def select(self, rows: Indices) -> _Task:
        """Return the task of some rows, numbers from 0, shape (n,)."""
        return replace(self, T_wanted=self.T_wanted[rows], start=self.start[rows])

    def clip(self, q: Array) -> Array:
        """Return joint values (N, m) [rad] or [m], those beyond a limit moved onto it."""
        low, high = self.limits.T
        return np.asarray(np.clip(q, low, high))

    def pushes(self, q: Array, dq: Array) -> Mask:
        """Find joints at a limit that a step would push through it.

        Args:
            q: Joint values before the step, shape (N, m), [rad] or [m].
            dq: The step, shape (N, m), [rad] or [m].

        Returns:
            shape (N, m).
        """
        low, high = self.limits.T
        pushes_down = (q <= low) & (dq < 0.0)
        pushes_up = (q >= high) & (dq > 0.0)
        return np.asarray(pushes_down | pushes_up)

    def at(self, q: Array) -> _Attempt:
        """Return the arm at joint values (N, m) [rad] or [m], with the error of its tool there."""
        T_base_tool, twists = self.arm.motion(self.arm.robot.readings(q))
        return _Attempt(q, T_base_tool, twists, self.matching.error(T_base_tool, self.T_wanted))


class _Attempt(NamedTuple):
    """Arm at the joint values that a search has come to, in N rows, and the error that is left."""

    #: Joint values, shape (N, m), [rad] or [m].
    q: Array
    #: The tool there, shape (N, 4, 4), [m].
    T_base_tool: Array
    #: Its motion with the joints, shape (N, 6, m), see `calib.verbs.compensate.nominal_actual.Arm.motion`.
    twists: Array
    #: What is matched of the wanted pose minus this one, shape (N, rows), [m], see `Matching.error`.
    error: Array

    @property
    def squared_error(self) -> Array:
        """Sum of squares of each row's error, shape (N,), [m^2]."""
        return np.asarray(np.einsum("ni,ni->n", self.error, self.error))

    @property
    def miss(self) -> Array:
        """Length of each row's error, shape (N,), [m]."""
        return np.asarray(np.linalg.norm(self.error, axis=1))

    def select(self, rows: Mask | Indices) -> _Attempt:
        """Return some rows: a mask (N,), or numbers from 0, shape (n,)."""
        return _Attempt(*(values[rows] for values in self))

    def with_rows(self, rows: Indices, other: _Attempt) -> _Attempt:
        """Return a copy with rows exchanged.

        Args:
            rows: Numbers from 0 of the rows to exchange, shape (n,).
            other: The n rows that take their place.
        """
        exchanged = []
        for values, other_values in zip(self, other, strict=True):
            copy = values.copy()
            copy[rows] = other_values
            exchanged.append(copy)
        return _Attempt(*exchanged)


class _Trial(NamedTuple):
    """One step of n rows, as it was tried."""

    #: Where it leads.
    attempt: _Attempt
    #: Whether a row takes it: its error is not larger there, or is rounding; shape (n,).
    is_better: Mask
    #: Whether a row rests: it moves no more, or what it gains is not worth another step; shape (n,).
    rests: Mask


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

    An arm that can do without a joint keeps to the limits; one that cannot goes beyond them. That, and how far a pose
    is missed, is for the caller to see.

    Args:
        arm: The robot with its errors and its tool.
        T_wanted: Poses of the tool in the base, shape (N, 4, 4), [m].
        start: Readings of the joints to start at, shape (N, m), [rad] or [m].
        matching: What of the poses is matched: pose, position, or position and axis.
        limits: Lowest and highest joint values, shape (m, 2), [rad] or [m]; None: there are none.
        steps: Number of steps at most.

    Returns:
        The readings of the joints where each row rests, and the tool there; read-only.
    """
    joint_count = start.shape[1]
    is_redundant = joint_count > matching.rows
    if limits is None or not is_redundant:
        limits = np.tile([-np.inf, np.inf], (joint_count, 1))
    values = arm.robot.input_values(start)
    task = _Task(arm, T_wanted, values, matching, limits, pulled=is_redundant)
    attempt = _search(task, steps)
    if is_redundant:
        # Next to a singularity the pull can be in the way of what can be reached.
        attempt = _without_pull_where_missed(task, attempt, steps)
    readings = arm.robot.readings(attempt.q)
    return Solution(read_only(readings), read_only(attempt.T_base_tool), read_only(attempt.twists))


def _without_pull_where_missed(task: _Task, attempt: _Attempt, steps: int) -> _Attempt:
    """Search rows that miss their pose once more, without the pull, and exchange those that come nearer by it.

    Args:
        task: The poses that were searched, with the pull.
        attempt: Where each row came to rest.
        steps: Number of steps at most.
    """
    missed = np.flatnonzero(attempt.miss > _REACHED)
    if not len(missed):
        return attempt
    free = _search(replace(task.select(missed), pulled=False), steps)
    nearer = free.miss < attempt.miss[missed]
    return attempt.with_rows(missed[nearer], free.select(nearer))


def _search(task: _Task, steps: int) -> _Attempt:
    """Take steps of all rows, inside the limits, until each rests.

    Args:
        task: The N poses to reach and the joint values to start at.
        steps: Number of steps at most.

    Returns:
        Where the N rows rest.
    """
    attempt = task.at(task.clip(task.start))
    damping = np.zeros(len(task.start))
    moving = np.arange(len(task.start))  # the rows that do not rest
    for _ in range(steps):
        if not len(moving):
            break
        trial = _try_step(task.select(moving), attempt.select(moving), damping[moving])
        better = trial.is_better
        attempt = attempt.with_rows(moving[better], trial.attempt.select(better))
        damping[moving] = _next_damping(damping[moving], better)
        is_given_up = damping[moving] > _LARGEST_DAMPING
        moving = moving[~trial.rests & ~is_given_up]
    return attempt


def _try_step(task: _Task, now: _Attempt, damping: Array) -> _Trial:
    """Try one step of n rows.

    A row whose step is cut short by a limit does not rest yet: the joint at the limit is held in the next one.

    Args:
        task: The n poses to reach.
        now: The n rows before the step.
        damping: Of each row, shape (n,), relative to the largest singular value of its Jacobian.
    """
    dq = _step_inside(task, now, damping)
    q = task.clip(now.q + dq)
    is_cut = (q != now.q + dq).any(axis=1)
    attempt = task.at(q)
    before, after = now.squared_error, attempt.squared_error
    is_better = after <= np.maximum(before, _NOTHING**2)
    is_still = np.abs(dq).max(axis=1) <= _STILL
    gains_little = before - after <= _STALLED * after
    is_stalled = is_better & (after > _NOTHING**2) & gains_little
    return _Trial(attempt, is_better, rests=(is_still | is_stalled) & ~is_cut)


def _next_damping(damping: Array, better: Mask) -> Array:
    """Lower the damping of rows whose step did not raise the error, and raise that of the others.

    Args:
        damping: shape (n,), relative to the largest singular value.
        better: Whether the row's step did not raise its error, shape (n,).

    Returns:
        shape (n,), likewise.
    """
    lower = np.where(damping > _LEAST_DAMPING, damping / 5.0, 0.0)
    higher = np.maximum(10.0 * damping, _FIRST_DAMPING)
    return np.where(better, lower, higher)


def _step_inside(task: _Task, now: _Attempt, damping: Array) -> Array:
    """Compute the step of each row, not longer than `_LONGEST_STEP`, with joints at their limits held.

    Joints that the step would push through their limits are held, until none of these is left.

    Args:
        task: The n poses to reach.
        now: The n rows before the step.
        damping: Of each row, shape (n,), relative to the largest singular value of its Jacobian.

    Returns:
        Change of the joint values, shape (n, m), [rad] or [m].
    """
    jacobian = task.matching.jacobian(now.twists)
    pull = task.start - now.q if task.pulled else None
    held = np.zeros(now.q.shape, dtype=bool)
    while True:
        dq = _step(jacobian, now.error, damping, pull, held)
        pushed = task.pushes(now.q, dq)
        if not pushed.any():
            break
        held |= pushed
    longest = np.abs(dq).max(axis=1, keepdims=True)
    scale = np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, 1e-300))
    return np.asarray(dq * scale)


def _step(J: Array, error: Array, damping: Array, pull: Array | None, held: Mask) -> Array:
    """Compute the damped step of each row, and the pull of a redundant arm to where it started.

        dq = V S (S^2 + lambda^2)^-1 U^T e + (1 - V_r V_r^T) pull,    J = U S V^T

    Args:
        J: Jacobian of what is matched by the joint values, shape (n, rows, m), see `Matching.jacobian`.
        error: Wanted minus present, shape (n, rows), [m], see `Matching.error`.
        damping: lambda, shape (n,), relative to the largest singular value.
        pull: Joint values to start at minus present ones, shape (n, m), [rad] or [m]; None: no pull.
        held: Joints that do not move, shape (n, m).

    Returns:
        Change of the joint values, shape (n, m), [rad] or [m].
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


def _rotation_vectors(rotations: Array) -> Array:
    """Return rotation vectors of matrices (N, 3, 3), shape (N, 3), [rad]; NaN stays NaN."""
    vectors = np.full((len(rotations), 3), np.nan)
    is_number = np.isfinite(rotations).all(axis=(1, 2))
    if is_number.any():
        vectors[is_number] = Rotation.from_matrix(rotations[is_number]).as_rotvec()
    return vectors


def _tilt(z: Array) -> Array:
    """Return the smallest turn, about x and y, that brings the tool's z axis to a direction.

    Args:
        z: Unit vectors along the tool's axes, shape (N, 3).

    Returns:
        Rotation vectors without their z component, which is 0, shape (N, 2), [rad].
    """
    sine = np.hypot(z[:, 0], z[:, 1])
    across = np.stack([-z[:, 1], z[:, 0]], axis=1)
    across[sine == 0.0] = [1.0, 0.0]  # straight back may be reached by any turn; about x is one
    length = np.where(sine == 0.0, 1.0, sine)
    axis = across / length[:, None]
    angle = np.arctan2(sine, z[:, 2])
    return np.asarray(axis * angle[:, None])


def following(arm: Arm, T_wanted: Array, start: Array, matching: Matching) -> Solution:
    """Solve poses in turn, each near the solution of the one before, and the first near a start.

    Where none is found inside the limits, solutions from joint values spread over the limits are compared.

    Args:
        arm: The robot with its errors and its tool.
        T_wanted: Poses of the tool in the base, shape (N, 4, 4), [m].
        start: Readings of the joints near which the first pose is solved, shape (m,), [rad] or [m].
        matching: What of the poses is matched.

    Returns:
        The readings at the N poses, and the tool there; where a pose cannot be reached those that miss it least.
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
    """Find, of the solutions from seeds, the one nearest to the first seed; or the one that misses least.

    Args:
        arm: The robot with its errors and its tool.
        T: Pose of the tool in the base, shape (4, 4), [m].
        seeds: Readings of the joints from which a solution is looked for, shape (n, m), [rad] or [m].
        matching: What of the pose is matched.

    Returns:
        Readings, shape (m,), [rad] or [m], and whether they are a solution inside the limits.
    """
    robot = arm.robot
    limits = column_limits(robot)
    T_wanted = np.tile(T, (len(seeds), 1, 1))
    solution = solve(arm, T_wanted, seeds, matching, limits, steps=_STEPS)
    allowed = limits + np.array([-_ROUNDING, _ROUNDING])
    first_seed = robot.input_values(seeds[0])[0]
    q = _by_whole_turns(robot, robot.input_values(solution.q), first_seed, allowed)
    misses = np.linalg.norm(matching.error(solution.T_base_tool, T_wanted), axis=1)
    is_solution = (misses <= 10.0 * _REACHED) & _is_inside(q, allowed)
    is_found = bool(is_solution.any())
    cost = misses
    if is_found:
        cost = np.where(is_solution, np.linalg.norm(q - first_seed, axis=1), np.inf)
    return robot.readings(q[int(np.argmin(cost))])[0], is_found


def _is_inside(q: Array, allowed: Array) -> Mask:
    """Return True for joint values (n, m) that are all between the lowest and highest ones (m, 2); shape (n,)."""
    return np.asarray(((q >= allowed[:, 0]) & (q <= allowed[:, 1])).all(axis=1))


def _by_whole_turns(robot: Robot, q: Array, seed: Array, allowed: Array) -> Array:
    """Move each turning joint by whole turns as near to a seed as its limits allow.

    Args:
        robot: Its joints say which may turn.
        q: Joint values, shape (n, m), [rad] or [m].
        seed: Joint values to come near to, shape (m,), [rad] or [m].
        allowed: Lowest and highest joint values, shape (m, 2), [rad] or [m].

    Returns:
        The joint values moved, shape (n, m), [rad] or [m].
    """
    low, high = allowed.T
    moved = q - _TURN * np.round((q - seed) / _TURN)
    moved = moved - _TURN * (moved > high) + _TURN * (moved < low)
    return np.where(_may_turn(robot), moved, q)


def _may_turn(robot: Robot) -> list[bool]:
    """Return which columns of q may change by a whole turn: joints that turn, and that others follow one to one."""
    may_turn = []
    for name, column in zip(robot.joint_names, robot.mimic_matrix.T, strict=True):
        turns = robot.joint_types[name] != "prismatic"
        is_one_to_one = set(np.abs(column)) <= {0.0, 1.0}
        may_turn.append(turns and is_one_to_one)
    return may_turn


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
