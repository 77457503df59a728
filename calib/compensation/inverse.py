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

POSE, POSITION, AXIS = "pose", "position", "axis"

MATCHES = (POSE, POSITION, AXIS)
"""What is matched: position and orientation; the position alone; position and direction of the tool's z axis."""

#: No joint moves further than this in one step [rad or m]; a row rests when its next step is shorter than the second or
#: lowers its squared error by a smaller share than the third.
_LONGEST_STEP, _STILL, _STALLED = 0.3, 1e-12, 1e-9

#: An error below this is rounding [m]; one above the second was not reached.
_NOTHING, _REACHED = 1e-13, 1e-9

#: Damping after the first step that failed, relative to the largest singular value; and when to give up.
_FIRST_DAMPING, _LARGEST_DAMPING = 1e-3, 1e3

#: Joint values may pass their limits by so much [rad or m]; singular values below the second share are zero.
_ROUNDING, _RANK = 1e-9, 1e-9

#: Sets of joint values that a solution is looked for from where the row before is no good start, and in how many steps.
_SPREAD, _STEPS = 48, 30


class Matching(NamedTuple):
    """What is matched, one of `MATCHES`, and the length that one radian weighs as [m]."""

    name: str
    length: float

    @property
    def rows(self) -> int:
        """How many numbers are matched."""
        return {POSE: 6, POSITION: 3, AXIS: 5}[self.name]

    def error(self, T_now: Array, T_wanted: Array) -> Array:
        """The error of poses (N, 4, 4), angles times the length, shape (N, rows), [m]."""
        relative = rigid_inverse(T_now) @ T_wanted
        R, moved = relative[:, :3, :3], relative[:, :3, 3]
        if self.name == POSITION:
            return moved
        angles = _tilt(R[:, :, 2]) if self.name == AXIS else _turn(R)
        return np.concatenate([moved, self.length * angles], axis=1)

    def jacobian(self, twists: Array) -> Array:
        """The same rows of the tool's twists (N, 6, m), shape (N, rows, m), [m per rad or m]."""
        rows = twists[:, : self.rows].copy()
        rows[:, 3:] *= self.length
        return np.asarray(rows)

    def misses(self, T_now: Array, T_wanted: Array) -> Array:
        """Distance [m] and angle [rad] between poses, shape (N, 2); the angle is NaN where it is not matched."""
        error = self.error(T_now, T_wanted)
        angle = np.linalg.norm(error[:, 3:], axis=1) / self.length
        distance = np.linalg.norm(error[:, :3], axis=1)
        return np.stack([distance, angle if self.rows > 3 else np.full(len(angle), np.nan)], axis=1)


class Solved(NamedTuple):
    """Joint values (N, m) [rad or m], as near as was found; poses and twists there, see `Arm.motion`."""

    q: Array
    T_base_tool: Array
    twists: Array


def solve(
    arm: Arm,
    T_wanted: Array,
    start: Array,
    matching: Matching,
    limits: Array | None = None,
    *,
    steps: int = 400,
) -> Solved:
    """Joint values that bring the tool to poses T_base_tool (N, 4, 4) [m], near those that each row starts at (N, m).

    An arm that can do without a joint keeps to the limits (m, 2); one that cannot goes beyond them. That, and how far a
    pose is missed, is for the caller to see.
    """
    redundant = start.shape[1] > matching.rows
    bounds = limits if redundant else None
    found = _search(arm, T_wanted, start, matching, bounds, steps, pulled=redundant)
    before = np.linalg.norm(matching.error(found.T_base_tool, T_wanted), axis=1)
    left = np.flatnonzero(before > _REACHED)
    if redundant and len(left):
        # Next to a singularity the pull can be in the way of what can be reached.
        again = _search(arm, T_wanted[left], start[left], matching, bounds, steps, pulled=False)
        after = np.linalg.norm(matching.error(again.T_base_tool, T_wanted[left]), axis=1)
        nearer = after < before[left]
        for own, other in zip(found, again, strict=True):
            own[left[nearer]] = other[nearer]
    return Solved(*map(read_only, found))


def _search(
    arm: Arm,
    wanted: Array,
    start: Array,
    matching: Matching,
    limits: Array | None,
    steps: int,
    *,
    pulled: bool,
) -> Solved:
    """Steps of all rows, inside the limits, until each rests."""
    low, high = (-np.inf, np.inf) if limits is None else limits.T
    q = np.clip(start, low, high)
    poses, twists = arm.motion(q)
    error = matching.error(poses, wanted)
    damping, rows = np.zeros(len(start)), np.arange(len(start))
    for _ in range(steps):
        if not len(rows):
            break
        J, e = matching.jacobian(twists[rows]), error[rows]
        pull = start[rows] - q[rows] if pulled else None
        # Joints that the step would push through their limits are held, until none is left of these.
        held = np.zeros((len(rows), q.shape[1]), dtype=bool)
        while True:
            dq = _step(J, e, damping[rows], pull, held)
            pushed = ((q[rows] <= low) & (dq < 0.0)) | ((q[rows] >= high) & (dq > 0.0))
            if not pushed.any():
                break
            held |= pushed
        longest = np.abs(dq).max(axis=1, keepdims=True)
        dq *= np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, 1e-300))
        moved = np.clip(q[rows] + dq, low, high)
        cut = (moved != q[rows] + dq).any(axis=1)
        new_poses, new_twists = arm.motion(moved)
        new = matching.error(new_poses, wanted[rows])
        before, after = (np.einsum("ni,ni->n", one, one) for one in (e, new))
        better = after <= np.maximum(before, _NOTHING**2)
        on = rows[better]
        q[on], poses[on], twists[on] = moved[better], new_poses[better], new_twists[better]
        error[on] = new[better]
        still = np.abs(dq).max(axis=1) <= _STILL
        still |= better & (after > _NOTHING**2) & (before - after <= _STALLED * after)
        less = np.where(damping[rows] > 1e-6, damping[rows] / 5.0, 0.0)
        more = np.maximum(10.0 * damping[rows], _FIRST_DAMPING)
        damping[rows] = np.where(better, less, more)
        rows = rows[~(still & ~cut) & (damping[rows] <= _LARGEST_DAMPING)]
    return Solved(q, poses, twists)


def _step(J: Array, error: Array, damping: Array, pull: Array | None, held: Mask) -> Array:
    """The damped step of each row, and the pull of a redundant arm to where it started; some joints held."""
    u, s, vt = np.linalg.svd(J * ~held[:, None, :], full_matrices=False)
    scale = s[:, :1]
    kept = s > _RANK * scale
    damped = s**2 + (damping[:, None] * scale) ** 2
    inverse = np.where(kept, s / np.where(kept, damped, 1.0), 0.0)
    step = np.einsum("nji,nj->ni", vt, np.einsum("nij,ni->nj", u, error) * inverse)
    if pull is not None:
        pull = np.where(held, 0.0, pull)
        used = np.einsum("nji,ni->nj", vt, pull) * kept
        step += pull - np.einsum("nji,nj->ni", vt, used)
    return np.where(held, 0.0, step)


def _turn(rotations: Array) -> Array:
    """Rotation vectors of matrices of shape (N, 3, 3), shape (N, 3), [rad]; NaN stays NaN."""
    result = np.full((len(rotations), 3), np.nan)
    there = np.isfinite(rotations).all(axis=(1, 2))
    if there.any():
        result[there] = Rotation.from_matrix(rotations[there]).as_rotvec()
    return result


def _tilt(z: Array) -> Array:
    """The smallest turn that brings the tool's z axis to a direction given in the tool, (N, 3) to (N, 2), [rad]."""
    sine = np.hypot(z[:, 0], z[:, 1])
    across = np.stack([-z[:, 1], z[:, 0]], axis=1)
    across[sine == 0.0] = [1.0, 0.0]  # straight back may be reached by any turn; about x is one
    angle = np.arctan2(sine, z[:, 2])
    return np.asarray(across / np.where(sine == 0.0, 1.0, sine)[:, None] * angle[:, None])


def following(arm: Arm, T_wanted: Array, start: Array, matching: Matching) -> Solved:
    """Each row's solution is found from that of the row before, and that of the first is the nearest to a start (m,).

    Where none is found inside the limits, those from joint values spread over the limits are looked at.
    """
    spread = spread_between(full_ranges(arm.robot), _SPREAD)
    q = np.empty((len(T_wanted), len(start)))
    for i, T in enumerate(T_wanted):
        before, good = (q[i - 1] if i else start), False
        if i:
            q[i], good = _nearest(arm, T, before[None], matching)
        if not good:
            q[i], _ = _nearest(arm, T, np.vstack([before, spread]), matching)
    return Solved(read_only(q), *arm.motion(q))


def _nearest(arm: Arm, T: Array, seeds: Array, matching: Matching) -> tuple[Array, bool]:
    """Of the solutions that are found from seeds the one nearest to the first of these; or the best there is."""
    robot, limits, turn = arm.robot, column_limits(arm.robot), 2.0 * np.pi
    low, high = limits[:, 0] - _ROUNDING, limits[:, 1] + _ROUNDING
    wanted = np.tile(T, (len(seeds), 1, 1))
    solved = solve(arm, wanted, seeds, matching, limits, steps=_STEPS)
    # Each turning joint by whole turns as near to the first seed as its limits allow.
    free = [
        robot.joint_types[name] != "prismatic" and set(np.abs(column)) <= {0.0, 1.0}
        for name, column in zip(robot.joint_names, robot.coupling.T, strict=True)
    ]
    q = solved.q - turn * np.round((solved.q - seeds[0]) / turn)
    q = np.where(free, q - turn * (q > high) + turn * (q < low), solved.q)
    missed = np.linalg.norm(matching.error(solved.T_base_tool, wanted), axis=1)
    inside = ((q >= low) & (q <= high)).all(axis=1)
    good = (missed <= 10.0 * _REACHED) & inside
    cost = np.linalg.norm(q - seeds[0], axis=1)
    best = int(np.argmin(np.where(good, cost, np.inf) if good.any() else missed))
    return q[best], bool(good.any())


def start_values(
    robot: Robot, named: Mapping[str, float] | None, others: float | None = None
) -> Array:
    """Joint values to start near, shape (m,) [rad or m]: those named, the others at one value or in mid range."""
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
