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
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import qmc

from calib.compensation.nominal_actual import Arm
from calib.errors import ModelError, choices, did_you_mean
from calib.robot.readback import column_limits, full_ranges
from calib.robot.robot import Robot, read_only
from calib.units import unit_fault

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.int_]

POSE, POSITION, AXIS = "pose", "position", "axis"

MATCHES = (POSE, POSITION, AXIS)
"""What is matched: position and orientation; the position alone; position and direction of the tool's z axis."""

_ROWS = {POSE: 6, POSITION: 3, AXIS: 5}

#: No joint moves further than this in one step [rad or m]; a row rests when its next step is shorter than the second or
#: lowers its squared error by a smaller share than the third.
_LONGEST_STEP, _STILL, _STALLED = 0.3, 1e-12, 1e-9

#: An error below this is rounding [m]; above the second it was not reached by a redundant arm that was pulled, above
#: the third not by one that follows the row before.
_NOTHING, _REACHED, _FOLLOWED = 1e-13, 1e-9, 1e-8

#: Damping after the first step that failed, relative to the largest singular value; and when to give up.
_FIRST_DAMPING, _LARGEST_DAMPING = 1e-3, 1e3

#: A joint this near to its limit is at it; and joint values may pass their limits by so much [rad or m].
_AT_LIMIT, _ROUNDING = 1e-12, 1e-9

#: Singular values below this, relative to the largest, are zero.
_RANK = 1e-9

#: A row follows the one before if no joint moves further than this [rad or m], inside of a block of rows than the
#: second; else all solutions are looked at. The longest block, and the steps that what is near may take.
_NEAR, _VERY_NEAR, _LONGEST_BLOCK, _FEW_STEPS = 0.5, 0.1, 256, 15

#: Sets of joint values that a solution is looked for from, and in how many steps.
_SPREAD, _STEPS = 48, 30


@dataclass(frozen=True, slots=True)
class Matching:
    """What is matched, one of `MATCHES`, and the length that one radian weighs as [m]."""

    name: str
    length: float

    @property
    def rows(self) -> int:
        """How many numbers are matched."""
        return _ROWS[self.name]

    def error(self, T_now: Array, T_wanted: Array) -> Array:
        """The error of poses (N, 4, 4), angles times the length, shape (N, rows), [m]."""
        turned = np.swapaxes(T_now[:, :3, :3], 1, 2)
        moved = (turned @ (T_wanted[:, :3, 3] - T_now[:, :3, 3])[:, :, None])[:, :, 0]
        if self.name == POSITION:
            return np.asarray(moved)
        relative = turned @ T_wanted[:, :3, :3]
        angles = _tilt(relative[:, :, 2]) if self.name == AXIS else _turn(relative)
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
    found = _Search(arm, T_wanted, start, matching, bounds, pulled=redundant)
    found.run(steps)
    left = np.flatnonzero(np.linalg.norm(found.error, axis=1) > _REACHED)
    if redundant and len(left):
        # Next to a singularity the pull can be in the way of what can be reached.
        again = _Search(arm, T_wanted[left], start[left], matching, bounds, pulled=False)
        again.run(steps)
        nearer = np.linalg.norm(again.error, axis=1) < np.linalg.norm(found.error[left], axis=1)
        found.move(left[nearer], *(one[nearer] for one in (again.q, again.poses, again.twists)))
    return Solved(*map(read_only, (found.q, found.poses, found.twists)))


class _Search:
    """Where the rows are."""

    def __init__(
        self,
        arm: Arm,
        wanted: Array,
        start: Array,
        matching: Matching,
        limits: Array | None,
        *,
        pulled: bool,
    ) -> None:
        """At the start, or at the limits that it lies beyond."""
        self.arm, self.wanted, self.start, self.matching = arm, wanted, start, matching
        self.limits, self.pulled = limits, pulled
        self.q = start.copy() if limits is None else np.clip(start, limits[:, 0], limits[:, 1])
        self.poses, self.twists = arm.motion(self.q)
        self.error = matching.error(self.poses, wanted)
        self.damping, self.moving = np.zeros(len(start)), np.ones(len(start), dtype=bool)

    def run(self, steps: int) -> None:
        """Steps until every row rests."""
        for _ in range(steps):
            if not self.moving.any():
                break
            self.step()

    def move(self, rows: Indices, q: Array, poses: Array, twists: Array) -> None:
        """Move some rows."""
        self.q[rows], self.poses[rows], self.twists[rows] = q, poses, twists

    def step(self) -> None:
        """One step of every row that still moves."""
        rows = np.flatnonzero(self.moving)
        dq, stopped = self._bounded_step(rows)
        q = self.q[rows] + dq
        poses, twists = self.arm.motion(q)
        error = self.matching.error(poses, self.wanted[rows])
        before = np.einsum("ni,ni->n", self.error[rows], self.error[rows])
        after = np.einsum("ni,ni->n", error, error)
        better = after <= np.maximum(before, _NOTHING**2)
        self.move(rows[better], q[better], poses[better], twists[better])
        self.error[rows[better]] = error[better]
        still = np.abs(dq).max(axis=1) <= _STILL
        stalled = better & (after > _NOTHING**2) & (before - after <= _STALLED * after)
        damping = self.damping[rows]
        damping = np.where(
            better,
            np.where(damping > 1e-6, damping / 5.0, 0.0),
            np.maximum(10.0 * damping, _FIRST_DAMPING),
        )
        self.damping[rows] = damping
        self.moving[rows] = ~(((still | stalled) & ~stopped) | (damping > _LARGEST_DAMPING))

    def _bounded_step(self, rows: Indices) -> tuple[Array, Mask]:
        """The step of each row, not too long and no further than the first limit in its way, and which end there."""
        dq = self._direction(rows, np.zeros((len(rows), self.q.shape[1]), dtype=bool))
        if self.limits is not None:
            low, high = self.limits.T
            at_low, at_high = self.q[rows] <= low + _AT_LIMIT, self.q[rows] >= high - _AT_LIMIT
            through = np.flatnonzero(_pushed(dq, at_low, at_high).any(axis=1))
            if len(through):
                dq[through] = self._held_direction(rows[through], at_low[through], at_high[through])
            dq = np.where(_pushed(dq, at_low, at_high, 0.0), 0.0, dq)
        longest = np.abs(dq).max(axis=1)
        dq = dq * np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, 1e-300))[:, None]
        if self.limits is None:
            return dq, np.zeros(len(rows), dtype=bool)
        with np.errstate(divide="ignore", invalid="ignore"):
            room = (np.where(dq > 0.0, high, low) - self.q[rows]) / dq
        first = np.clip(np.where(dq != 0.0, room, np.inf).min(axis=1), 0.0, 1.0)
        return np.asarray(dq * first[:, None]), first < 1.0

    def _held_direction(self, rows: Indices, at_low: Mask, at_high: Mask) -> Array:
        """The steps of rows of which a free step would push joints through limits: these are held."""
        held = np.zeros(at_low.shape, dtype=bool)
        while True:
            dq = self._direction(rows, held)
            pushed = _pushed(dq, at_low, at_high)
            if not pushed.any():
                return dq
            held |= pushed

    def _direction(self, rows: Indices, held: Mask) -> Array:
        """The damped step of each row, and the pull of a redundant arm to where it started; some joints held."""
        jacobian = self.matching.jacobian(self.twists[rows])
        jacobian *= ~held[:, None, :]
        u, s, vt = np.linalg.svd(jacobian, full_matrices=False)
        scale = s[:, :1]
        kept = s > _RANK * scale
        damped = s**2 + (self.damping[rows, None] * scale) ** 2
        inverse = np.where(kept, s / np.where(kept, damped, 1.0), 0.0)
        along = np.einsum("nij,ni->nj", u, self.error[rows]) * inverse
        step = np.einsum("nji,nj->ni", vt, along)
        if self.pulled:
            pull = np.where(held, 0.0, self.start[rows] - self.q[rows])
            used = np.einsum("nji,ni->nj", vt, pull) * kept
            step += pull - np.einsum("nji,nj->ni", vt, used)
        return np.where(held, 0.0, step)


def _pushed(dq: Array, at_low: Mask, at_high: Mask, rounding: float = _AT_LIMIT) -> Mask:
    """Which joints at a limit a step would push through it by more than rounding."""
    return np.asarray((at_low & (dq < -rounding)) | (at_high & (dq > rounding)))


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
    """Each row's solution follows the row before, and that of the first is the nearest to a start, shape (m,).

    A path T_base_tool (N, 4, 4) is followed in blocks, which grow as long as all goes well; where a row cannot follow,
    all solutions found from joint values spread over the limits are looked at.
    """
    low, high = full_ranges(arm.robot).T
    unit = qmc.Sobol(len(low), scramble=False).random_base2(6)[:_SPREAD]
    # Half a step inside: the first of the sequence is the corner where every joint is at its limit.
    spread = low + (high - low) * (unit + 0.5 / _SPREAD)
    limits = column_limits(arm.robot)
    count = len(T_wanted)
    q, poses = np.empty((count, len(start))), np.empty_like(T_wanted)
    q[0], poses[0] = _nearest(arm, T_wanted[0], np.vstack([start, spread]), matching)
    done, block = 1, 1
    while done < count:
        wanted, before = T_wanted[done : done + block], q[done - 1]
        starts = np.tile(before, (len(wanted), 1))
        solved = solve(arm, wanted, starts, matching, limits, steps=_FEW_STEPS)
        good = _good(solved.q, matching.error(solved.T_base_tool, wanted), limits)
        jumps = np.abs(np.diff(np.vstack([before, solved.q]), axis=0)).max(axis=1)
        good &= jumps <= (_NEAR if len(wanted) == 1 else _VERY_NEAR)
        taken = len(good) if good.all() else int(np.argmin(good))
        q[done : done + taken] = solved.q[:taken]
        poses[done : done + taken] = solved.T_base_tool[:taken]
        if not taken and block == 1:
            q[done], poses[done] = _nearest(arm, wanted[0], np.vstack([before, spread]), matching)
            taken = 1
        done += taken
        block = min(2 * block, _LONGEST_BLOCK) if taken == len(good) else 1
    return Solved(read_only(q), read_only(poses), arm.motion(q)[1])


def start_values(
    robot: Robot, named: Mapping[str, float] | None, others: float | None = None
) -> Array:
    """Joint values to start near, shape (m,) [rad or m]: those named, the others at one value or in mid range.

    Raises:
        ModelError: A joint that the chain does not have, or a value in a unit that is not the joint's.
    """
    values = full_ranges(robot).mean(axis=1)
    if others is not None:
        values[:] = others
    for name, value in (named or {}).items():
        if name not in robot.joint_names:
            raise ModelError(
                f"The chain has no joint '{name}' to start at{did_you_mean(name, robot.joint_names)}; it has "
                f"{choices(robot.joint_names)}."
            )
        fault = unit_fault(value, slides=robot.joint_types[name] == "prismatic")
        if fault:
            raise ModelError(f"The value of '{name}' to start at {fault}.")
        values[robot.joint_names.index(name)] = value
    return read_only(values)


def _nearest(arm: Arm, T: Array, seeds: Array, matching: Matching) -> tuple[Array, Array]:
    """Of the solutions that are found from seeds the one nearest to the first of these; or the best there is."""
    limits, reference = column_limits(arm.robot), seeds[0]
    wanted = np.tile(T, (len(seeds), 1, 1))
    solved = solve(arm, wanted, seeds, matching, limits, steps=_STEPS)
    q = _turned_to(arm.robot, solved.q, reference, limits)
    error = matching.error(solved.T_base_tool, wanted)
    good = _good(q, error, limits)
    cost = np.linalg.norm(error, axis=1)
    if good.any():
        cost = np.where(good, np.linalg.norm(q - reference, axis=1), np.inf)
    best = int(np.argmin(cost))
    return q[best], solved.T_base_tool[best]


def _good(q: Array, error: Array, limits: Array) -> Mask:
    """Which rows have reached their pose inside the limits, shape (N,)."""
    inside = ((q >= limits[:, 0] - _ROUNDING) & (q <= limits[:, 1] + _ROUNDING)).all(axis=1)
    return np.asarray((np.linalg.norm(error, axis=1) <= _FOLLOWED) & inside)


def _turned_to(robot: Robot, q: Array, reference: Array, limits: Array) -> Array:
    """The same poses with each turning joint by whole turns as near to the reference as its limits allow."""
    turn, (low, high) = 2.0 * np.pi, limits.T
    free = [
        robot.joint_types[name] != "prismatic" and set(np.abs(column)) <= {0.0, 1.0}
        for name, column in zip(robot.joint_names, robot.coupling.T, strict=True)
    ]
    values = q - turn * np.round((q - reference) / turn)
    values = np.where(values > high + _ROUNDING, values - turn, values)
    values = np.where(values < low - _ROUNDING, values + turn, values)
    return np.where(free, values, q)
