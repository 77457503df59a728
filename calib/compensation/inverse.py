"""Inverse kinematics of an arm with known errors: joint values that bring its tool to a pose, near those given.

The error of a pose along the tool's own axes, in the order of a twist, and a Levenberg-Marquardt step on it, all rows
at once, with the singular values of the Jacobian J = U S V^T:

    e  = (R_now^T (p_wanted - p_now), log(R_now^T R_wanted))
    dq = V S (S^2 + lambda^2)^-1 U^T e + (1 - V_r V_r^T) (q_start - q)

The damping lambda is zero until a step fails to lower the error; the second term keeps a redundant arm at the joint
values nearest to where it started. Steps are short, so that a row stays in its branch. Source: Y. Nakamura,
H. Hanafusa, Inverse kinematic solutions with singularity robustness, 1986.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from calib.compensation.nominal_actual import Arm
from calib.errors import ModelError, choices
from calib.robot.ranges import column_limits, full_ranges, spread_between
from calib.robot.robot import Robot, read_only, rigid_inverse
from calib.units import Array, Mask, unit_fault

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
            T_now: shape (N, 4, 4), [m].
            T_wanted: shape (N, 4, 4), [m].

        Returns:
            shape (N, rows), position and angles times the length [m].
        """
        relative = rigid_inverse(T_now) @ T_wanted
        R, position = relative[:, :3, :3], relative[:, :3, 3]
        if self.name == POSITION:
            return position
        angles = _tilt(R[:, :, 2]) if self.name == AXIS else _rotation_vectors(R)
        return np.concatenate([position, self.length * angles], axis=1)

    def jacobian(self, twists: Array) -> Array:
        """Return the matched rows of the tool's twists.

        Args:
            twists: Along the tool's own axes, shape (N, 6, m), [m or rad per rad or m].

        Returns:
            shape (N, rows, m), [m per rad or m].
        """
        rows = twists[:, : self.rows].copy()
        rows[:, 3:] *= self.length
        return np.asarray(rows)

    def misses(self, T_now: Array, T_wanted: Array) -> Array:
        """Compute distance [m] and angle [rad] between poses.

        Args:
            T_now: shape (N, 4, 4), [m].
            T_wanted: shape (N, 4, 4), [m].

        Returns:
            shape (N, 2); the angle is NaN where it is not matched.
        """
        error = self.error(T_now, T_wanted)
        distance = np.linalg.norm(error[:, :3], axis=1)
        angle = np.full(len(error), np.nan)
        if self.rows > 3:
            angle = np.linalg.norm(error[:, 3:], axis=1) / self.length
        return np.stack([distance, angle], axis=1)


class Solution(NamedTuple):
    """Joint values, as near to the wanted poses as was found, and the tool there."""

    #: Shape (N, m), [rad] or [m].
    q: Array
    #: Shape (N, 4, 4), [m].
    T_base_tool: Array
    #: Shape (N, 6, m), see `calib.compensation.nominal_actual.Arm.motion`.
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

    An arm that can do without a joint keeps to the limits; one that cannot goes beyond them. That, and how far a pose
    is missed, is for the caller to see.

    Args:
        arm: The arm.
        T_wanted: Poses of the tool in the base, shape (N, 4, 4), [m].
        start: Joint values to start at, shape (N, m), [rad] or [m].
        matching: What of the poses is matched.
        limits: Lowest and highest joint values, shape (m, 2); None: there are none.
        steps: Number of steps at most.

    Returns:
        The solution.
    """
    is_redundant = start.shape[1] > matching.rows
    bounds = limits if is_redundant else None
    solution = _search(arm, T_wanted, start, matching, bounds, steps, pulled=is_redundant)
    misses = np.linalg.norm(matching.error(solution.T_base_tool, T_wanted), axis=1)
    missed = np.flatnonzero(misses > _REACHED)
    if is_redundant and len(missed):
        # Next to a singularity the pull can be in the way of what can be reached.
        T_missed, from_missed = T_wanted[missed], start[missed]
        free = _search(arm, T_missed, from_missed, matching, bounds, steps, pulled=False)
        free_misses = np.linalg.norm(matching.error(free.T_base_tool, T_missed), axis=1)
        nearer = free_misses < misses[missed]
        for values, free_values in zip(solution, free, strict=True):
            values[missed[nearer]] = free_values[nearer]
    return Solution(*map(read_only, solution))


def _search(
    arm: Arm,
    T_wanted: Array,
    start: Array,
    matching: Matching,
    limits: Array | None,
    steps: int,
    *,
    pulled: bool,
) -> Solution:
    """Take steps of all rows, inside the limits, until each rests.

    Args:
        arm: The arm.
        T_wanted: Poses of the tool in the base, shape (N, 4, 4), [m].
        start: Joint values to start at, shape (N, m), [rad] or [m].
        matching: What of the poses is matched.
        limits: Lowest and highest joint values, shape (m, 2); None: there are none.
        steps: Number of steps at most.
        pulled: Whether a redundant arm is pulled to where it started.

    Returns:
        Where the rows rest.
    """
    low, high = np.full((2, start.shape[1]), [[-np.inf], [np.inf]])
    if limits is not None:
        low, high = limits.T
    q = np.clip(start, low, high)
    poses, twists = arm.motion(q)
    error = matching.error(poses, T_wanted)
    damping = np.zeros(len(start))
    rows = np.arange(len(start))  # those that do not rest
    for _ in range(steps):
        if not len(rows):
            break
        jacobian = matching.jacobian(twists[rows])
        pull = start[rows] - q[rows] if pulled else None
        dq = _step_inside(jacobian, error[rows], damping[rows], pull, q[rows], low, high)
        trial = np.clip(q[rows] + dq, low, high)
        is_cut = (trial != q[rows] + dq).any(axis=1)
        trial_poses, trial_twists = arm.motion(trial)
        trial_error = matching.error(trial_poses, T_wanted[rows])
        before = np.einsum("ni,ni->n", error[rows], error[rows])
        after = np.einsum("ni,ni->n", trial_error, trial_error)
        better = after <= np.maximum(before, _NOTHING**2)
        moved = rows[better]
        q[moved] = trial[better]
        poses[moved] = trial_poses[better]
        twists[moved] = trial_twists[better]
        error[moved] = trial_error[better]
        rests = np.abs(dq).max(axis=1) <= _STILL
        rests |= better & (after > _NOTHING**2) & (before - after <= _STALLED * after)
        damping[rows] = _next_damping(damping[rows], better)
        rows = rows[~(rests & ~is_cut) & (damping[rows] <= _LARGEST_DAMPING)]
    return Solution(q, poses, twists)


def _next_damping(damping: Array, better: Mask) -> Array:
    """Lower the damping of rows whose step lowered the error, and raise that of the others; shape (n,)."""
    lower = np.where(damping > _LEAST_DAMPING, damping / 5.0, 0.0)
    higher = np.maximum(10.0 * damping, _FIRST_DAMPING)
    return np.where(better, lower, higher)


def _step_inside(
    J: Array, error: Array, damping: Array, pull: Array | None, q: Array, low: Array, high: Array
) -> Array:
    """Compute the step of each row, not longer than `_LONGEST_STEP`, with joints at their limits held.

    Joints that the step would push through their limits are held, until none of these is left.

    Args:
        J: shape (n, rows, m), see `Matching.jacobian`.
        error: shape (n, rows).
        damping: shape (n,), relative to the largest singular value.
        pull: Joint values from here to the start, shape (n, m); None: none.
        q: shape (n, m), [rad] or [m].
        low: Lowest joint values, shape (m,), or minus infinity.
        high: Highest joint values, shape (m,), or infinity.

    Returns:
        shape (n, m), [rad] or [m].
    """
    held = np.zeros(q.shape, dtype=bool)
    while True:
        dq = _step(J, error, damping, pull, held)
        pushed = ((q <= low) & (dq < 0.0)) | ((q >= high) & (dq > 0.0))
        if not pushed.any():
            break
        held |= pushed
    longest = np.abs(dq).max(axis=1, keepdims=True)
    return np.asarray(dq * np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, 1e-300)))


def _step(J: Array, error: Array, damping: Array, pull: Array | None, held: Mask) -> Array:
    """Compute the damped step of each row, and the pull of a redundant arm to where it started.

    Args:
        J: shape (n, rows, m), see `Matching.jacobian`.
        error: shape (n, rows).
        damping: shape (n,), relative to the largest singular value.
        pull: Joint values from here to the start, shape (n, m); None: none.
        held: Joints that do not move, shape (n, m).

    Returns:
        shape (n, m), [rad] or [m].
    """
    U, S, Vt = np.linalg.svd(J * ~held[:, None, :], full_matrices=False)
    largest = S[:, :1]
    nonzero = _RANK * largest < S
    damped = S**2 + (damping[:, None] * largest) ** 2
    inverse = np.where(nonzero, S / np.where(nonzero, damped, 1.0), 0.0)
    coordinates = np.einsum("nij,ni->nj", U, error) * inverse
    step = np.einsum("nji,nj->ni", Vt, coordinates)
    if pull is not None:
        pull = np.where(held, 0.0, pull)
        used = np.einsum("nji,ni->nj", Vt, pull) * nonzero
        step += pull - np.einsum("nji,nj->ni", Vt, used)
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
        z: Directions in the tool, shape (N, 3).

    Returns:
        shape (N, 2), [rad].
    """
    sine = np.hypot(z[:, 0], z[:, 1])
    across = np.stack([-z[:, 1], z[:, 0]], axis=1)
    across[sine == 0.0] = [1.0, 0.0]  # straight back may be reached by any turn; about x is one
    angle = np.arctan2(sine, z[:, 2])
    return np.asarray(across / np.where(sine == 0.0, 1.0, sine)[:, None] * angle[:, None])


def following(arm: Arm, T_wanted: Array, start: Array, matching: Matching) -> Solution:
    """Solve poses in turn, each near the solution of the one before, and the first near a start.

    Where none is found inside the limits, solutions from joint values spread over the limits are compared.

    Args:
        arm: The arm.
        T_wanted: Poses of the tool in the base, shape (N, 4, 4), [m].
        start: shape (m,), [rad] or [m].
        matching: What of the poses is matched.

    Returns:
        The solution.
    """
    spread = spread_between(full_ranges(arm.robot), _SPREAD)
    q = np.empty((len(T_wanted), len(start)))
    for i, T in enumerate(T_wanted):
        before, is_solved = start, False
        if i:
            before = q[i - 1]
            q[i], is_solved = _nearest(arm, T, before[None], matching)
        if not is_solved:
            q[i], _ = _nearest(arm, T, np.vstack([before, spread]), matching)
    return Solution(read_only(q), *arm.motion(q))


def _nearest(arm: Arm, T: Array, seeds: Array, matching: Matching) -> tuple[Array, bool]:
    """Find, of the solutions from seeds, the one nearest to the first seed; or the best there is.

    Args:
        arm: The arm.
        T: Pose of the tool in the base, shape (4, 4), [m].
        seeds: shape (n, m), [rad] or [m].
        matching: What of the pose is matched.

    Returns:
        Joint values, shape (m,), and whether they are a solution inside the limits.
    """
    limits = column_limits(arm.robot)
    T_wanted = np.tile(T, (len(seeds), 1, 1))
    solution = solve(arm, T_wanted, seeds, matching, limits, steps=_STEPS)
    low = limits[:, 0] - _ROUNDING
    high = limits[:, 1] + _ROUNDING
    # Each turning joint by whole turns as near to the first seed as its limits allow.
    q = solution.q - _TURN * np.round((solution.q - seeds[0]) / _TURN)
    q = q - _TURN * (q > high) + _TURN * (q < low)
    q = np.where(_may_turn(arm.robot), q, solution.q)
    misses = np.linalg.norm(matching.error(solution.T_base_tool, T_wanted), axis=1)
    inside = ((q >= low) & (q <= high)).all(axis=1)
    is_solution = (misses <= 10.0 * _REACHED) & inside
    distance = np.linalg.norm(q - seeds[0], axis=1)
    cost = np.where(is_solution, distance, np.inf) if is_solution.any() else misses
    return q[int(np.argmin(cost))], bool(is_solution.any())


def _may_turn(robot: Robot) -> list[bool]:
    """Return which columns of q may change by a whole turn: joints that turn, and that others follow one to one."""
    columns = zip(robot.joint_names, robot.coupling.T, strict=True)
    return [
        robot.joint_types[name] != "prismatic" and set(np.abs(column)) <= {0.0, 1.0}
        for name, column in columns
    ]


def start_values(
    robot: Robot, named: Mapping[str, float] | None, others: float | None = None
) -> Array:
    """Return joint values to start near.

    Args:
        robot: The robot.
        named: Values of joints by name [rad] or [m]; None: none.
        others: Value of the other joints; None: the middle of their ranges.

    Returns:
        shape (m,), [rad] or [m].

    Raises:
        ModelError: A joint that the chain does not have, or a value in the wrong unit.
    """
    values = full_ranges(robot).mean(axis=1)
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
