"""Joint values that the controller has at the targets of a program: those of its nominal robot.

Of joint targets they are the numbers themselves. A pose has several solutions,

    T_base_tip = T_base_frame T_frame_tool inv(T_tip_tool),    q: T_nominal(q) = T_base_tip,

up to whole turns of the joints. The configuration data of a motion by joints allow one of them, or a few, of which the
nearest to the joint values of the motion before is taken. On lines and arcs a controller keeps its configuration: they
are followed in steps short enough that the arm cannot come to another solution.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np

from calib.basics.arrays import Array, Integers, read_only, rigid_inverse
from calib.basics.values import Value
from calib.errors import MeasurementError, choices
from calib.numerics.geometry import to_matrices, to_rotation_vectors
from calib.robot.ranges import column_limits
from calib.robot.robot import Robot
from calib.verbs.compensate.inverse import (
    POSE,
    Matching,
    by_whole_turns,
    follow,
    may_turn,
    solve,
    start_values,
)
from calib.verbs.compensate.nominal_actual import Arm
from calib.verbs.compensate.programs.program_file import ProgramFile, Target
from calib.verbs.compensate.solutions import distinct, inside_limits, joint_solutions

Missing = Literal["configuration", "unreachable"]
"""Why joint values of a motion are not known: no solution agrees with its configuration data, or there is none."""

#: Poses are compared with a radian counting as the reach of a small arm [m].
_MATCHING = Matching(POSE, 0.5)

#: A pose that is missed by less is reached [m]: for arms of fewer than six joints, poses of few digits.
_REACHED, _NEARLY = 1e-8, 1e-4

#: Poses on a line are no farther from each other than this [m], [rad].
_STEP = (0.05, 0.2)

#: A line is not longer than so many steps.
_MOST_STEPS = 400

#: So far along a line poses are solved at once, from the same joint values [m], and no more than so many.
_BLOCK = 0.3
_MOST_IN_BLOCK = 200

#: So many motions are followed at a time.
_RUN = 300

#: No joint moves farther in a step on a line [rad or m]: another solution is farther away.
_JUMP = 0.6

#: So many poses have their solutions found from nothing, if they are so far from each other [m].
_BANK = 24
_FAR = 0.1

#: Joint values may exceed their limits by this: digits that were not written [rad or m].
_ROUNDING = 1e-4

#: So many poses in a row that cannot be reached are not those of this robot.
_HOPELESS = 50

_TURN = 2.0 * np.pi


@dataclass(frozen=True, slots=True, eq=False)
class NominalValues(Value):
    """Joint values of the nominal robot at the N motions of a program."""

    #: Shape (N, m), readings [rad] or [m]; NaN where they are not known.
    q: Array
    #: Why they are not known; None where they are.
    missing: tuple[Missing | None, ...]


def nominal_values(
    robot: Robot, program: ProgramFile, start: Mapping[str, float] | None = None
) -> NominalValues:
    """Find the joint values that a controller with the nominal robot has at each motion of a program.

    Args:
        robot: The robot as its controller has it, with m measured joints.
        program: The program.
        start: Joint values by name [rad] or [m] at which the program begins; None: not known.

    Returns:
        The joint values of the motions, in their order.

    Raises:
        MeasurementError: Where the arm is at the first pose is not known, or it reaches none of many poses.
        ModelError: A start that does not fit the robot.
    """
    return _Search(robot, program, start).found()


def values_of(target: Target) -> Array:
    """Return the numbers of a target, shape (k,), in SI units; those of quaternions as they are."""
    values = np.array([number.value for number in target.numbers])
    return np.asarray(values * np.array(target.scales))


def pose_of(target: Target, values: Array) -> Array:
    """Return T_frame_tool, shape (4, 4) [m], that numbers of a pose in SI units, shape (k,), stand for."""
    assert target.convention is not None
    T = np.eye(4)
    T[:3, 3] = values[:3]
    T[:3, :3] = target.convention.matrices(values[None, 3:])[0]
    return T


def contents_of(targets: Sequence[Target]) -> list[Array]:
    """Return what targets say.

    Args:
        targets: The targets.

    Returns:
        For each T_frame_tool, shape (4, 4) [m], or joint values, shape (m,), [rad] or [m].
    """
    contents = [values_of(target) for target in targets]
    alike: dict[str, list[int]] = {}
    for k, target in enumerate(targets):
        if target.convention is not None:
            alike.setdefault(target.convention.name, []).append(k)
    for rows in alike.values():
        convention = targets[rows[0]].convention
        assert convention is not None
        numbers = np.array([contents[k] for k in rows])
        T = np.tile(np.eye(4), (len(rows), 1, 1))
        T[:, :3, 3] = numbers[:, :3]
        T[:, :3, :3] = convention.matrices(numbers[:, 3:])
        for k, pose in zip(rows, T, strict=True):
            contents[k] = pose
    return contents


def tip_poses(program: ProgramFile) -> dict[int, Array]:
    """Return T_base_tip, shape (4, 4) [m], of the motions to poses, by their indices."""
    contents = contents_of(program.targets)
    rows, frames, poses, tools = [], [], [], []
    for i, move in enumerate(program.moves):
        if program.targets[move.target].convention is not None:
            rows.append(i)
            frames.append(move.T_base_frame)
            poses.append(contents[move.target])
            tools.append(np.eye(4) if move.T_tip_tool is None else move.T_tip_tool)
    if not rows:
        return {}
    T = np.array(frames) @ np.array(poses) @ rigid_inverse(np.array(tools))
    return dict(zip(rows, T, strict=True))


class _Search:
    """The search for the joint values of a program, motion by motion; it lasts for one program."""

    def __init__(
        self, robot: Robot, program: ProgramFile, start: Mapping[str, float] | None
    ) -> None:
        """Find the solutions of all poses that motions by joints go to."""
        self.robot, self.program, self.moves = robot, program, program.moves
        self.arm = Arm.of(robot, np.eye(4))
        self.limits = column_limits(robot)
        self.start = None if not start else start_values(robot, start)
        self.targets = [program.targets[move.target] for move in program.moves]
        self.T = tip_poses(program)
        self.bank = _Bank(robot, self.arm)
        self.solutions: dict[int, Array] = {}
        self.in_vain = 0  # motions in a row for which a search from nothing found nothing
        by_joints = [i for i in self.T if self.moves[i].motion == "joint"]
        if by_joints and not self.is_redundant:
            found = self.bank.solutions(np.array([self.T[i] for i in by_joints]))
            self.solutions = dict(zip(by_joints, found, strict=True))

    @property
    def is_redundant(self) -> bool:
        """True if the arm reaches a pose in a continuum of ways."""
        return len(self.robot.joint_names) > 6

    def found(self) -> NominalValues:
        """Go through the motions in their order."""
        N = len(self.moves)
        q = np.full((N, len(self.robot.joint_names)), np.nan)
        missing: list[Missing | None] = [None] * N
        before, is_lost, i = self.start, False, 0
        while i < N:
            by_joints = not self._is_linear(i)
            if i not in self.T:
                q[i] = before = values_of(self.targets[i])
                is_lost, i = False, i + 1
                continue
            if is_lost and (not by_joints or self.targets[i].configuration is None):
                # Which way the arm bends is not known since a motion whose configuration data nothing agrees with.
                missing[i], i = "configuration", i + 1
                continue
            if not by_joints and before is not None:
                last = i
                while last < min(N, i + _RUN) and self._is_linear(last):
                    last += 1
                followed = self._follow(before, i, last)
                if len(followed):
                    q[i : i + len(followed)], before = followed, followed[-1]
                    i += len(followed)
                    continue
            chosen, missing[i] = self._choose(i, before)
            if chosen is not None:
                q[i] = before = chosen
            is_lost = missing[i] == "configuration"
            i += 1
        return NominalValues(read_only(q), tuple(missing))

    def _is_linear(self, i: int) -> bool:
        """Return whether a motion goes to a pose on a line or an arc."""
        return i in self.T and self.moves[i].motion != "joint"

    def _choose(self, i: int, before: Array | None) -> tuple[Array | None, Missing | None]:
        """Return the joint values of one motion to a pose, (m,), near those before, or why there are none."""
        T = self.T[i][None]
        if self.is_redundant:
            if before is None:
                raise self._start_needed(i)
            solution = follow(self.arm, T, before, _MATCHING)
            missed = np.linalg.norm(_MATCHING.error(solution.T_base_tool, T))
            return (solution.q[0], None) if missed < _REACHED else (None, "unreachable")

        if i not in self.solutions:
            self.solutions[i] = self.bank.solutions(T)[0]
        chosen, missing = self._nearest(i, before)
        if missing is not None and self.in_vain < _HOPELESS:
            # Those found from the solutions of other poses may not be all.
            self.solutions[i] = joint_solutions(self.robot, T)[0]
            chosen, missing = self._nearest(i, before)
        self.in_vain = self.in_vain + 1 if missing == "unreachable" else 0
        if self.in_vain > _HOPELESS:
            raise MeasurementError(
                f"{self._place(i)}: the nominal robot reaches none of {_HOPELESS} poses in a row that end here. Check "
                "the tools and frames (--tool, --frame), and that the robot's base and tip are the controller's base "
                "and flange (--base, --tip)."
            )
        return chosen, missing

    def _nearest(self, i: int, before: Array | None) -> tuple[Array | None, Missing | None]:
        """Return the solution that the configuration data allow, (m,), or the nearest of several, or why none is."""
        solutions, configuration = self.solutions[i], self.targets[i].configuration
        if not len(solutions):
            return None, "unreachable"
        if configuration is not None:
            turned = self._with_turns(solutions)
            allowed = turned[configuration(turned)]
            if len(allowed):
                nearest = 0 if before is None else np.argmin(np.abs(allowed - before).sum(axis=1))
                return allowed[nearest], None
            if self.moves[i].motion == "joint" or before is None:
                return None, "configuration"
        if before is None:
            if len(self._with_turns(solutions)) > 1:
                raise self._start_needed(i)
            return solutions[0], None
        values, seed = self.robot.input_values(solutions), self.robot.input_values(before)[0]
        allowed = self.limits + np.array([-_ROUNDING, _ROUNDING])
        turned = self.robot.readings(by_whole_turns(self.robot, values, seed, allowed))
        return turned[np.argmin(np.abs(turned - before).sum(axis=1))], None

    def _place(self, i: int) -> str:
        """Return the place of a motion, for messages."""
        move = self.moves[i]
        return f"{self.program.texts[move.file].path}, line {move.line}"

    def _start_needed(self, i: int) -> MeasurementError:
        """Return the message that joint values to start near are needed."""
        return MeasurementError(
            f"{self._place(i)}: the program begins with a pose without configuration data, which the arm "
            "reaches in several ways. State joint values near which it is then, such as "
            f'--start "{self.robot.joint_names[0]}=0 deg"; the joints are {choices(self.robot.joint_names)}.'
        )

    def _follow(self, before: Array, first: int, last: int) -> Array:
        """Return joint values (k, m) of linear motions ``first`` to ``last`` - 1, up to one that jumps."""
        poses = [self.robot.poses(before)[0], *(self.T[i] for i in range(first, last))]
        steps, ends = _with_steps(np.array(poses))
        low, high = (self.limits + np.array([-_ROUNDING, _ROUNDING])).T
        near = _near_enough(self.robot)
        found: list[Array] = []
        now, is_short = before, False
        while len(found) < len(steps):
            done = len(found)
            count = 1 if is_short else _block(steps[done:])
            wanted = steps[done : done + count]
            start = np.tile(now, (count, 1))
            solution = solve(self.arm, wanted, start, _MATCHING, self.limits, steps=40)
            misses = np.linalg.norm(_MATCHING.error(solution.T_base_tool, wanted), axis=1)
            values = self.robot.input_values(solution.q)
            moved = np.abs(np.diff(np.vstack([now, solution.q]), axis=0)).max(axis=1)
            is_inside = ((values >= low) & (values <= high)).all(axis=1)
            is_good = (misses < near) & (moved < _JUMP) & is_inside
            good = count if is_good.all() else int(np.argmin(is_good))
            if good == 0 and count == 1:
                break
            is_short = good == 0
            if good:
                found.extend(solution.q[:good])
                now = found[-1]
        at_ends = [found[end] for end in ends.tolist() if end < len(found)]
        return np.array(at_ends).reshape(-1, len(before))

    def _with_turns(self, solutions: Array) -> Array:
        """Return solutions (k, m) with all whole turns of their joints that are inside the limits, (n, m)."""
        limits = np.clip(column_limits(self.robot), -_TURN, _TURN)
        low, high = (limits + np.array([-_ROUNDING, _ROUNDING])).T
        turns = may_turn(self.robot)
        rows: list[tuple[float, ...]] = []
        for row in self.robot.input_values(solutions):
            of_joints = []
            for j, value in enumerate(row.tolist()):
                around = [value + k * _TURN for k in range(-2, 3)] if turns[j] else []
                of_joints.append([v for v in around if low[j] <= v <= high[j]] or [value])
            rows += list(product(*of_joints))
        return self.robot.readings(np.array(rows))


class _Bank:
    """Solutions of some poses, from which those of others are found in a few steps; it lasts for one program."""

    def __init__(self, robot: Robot, arm: Arm) -> None:
        """Start with none."""
        self.robot, self.arm = robot, arm
        self.poses = np.zeros((0, 4, 4))
        self.known: list[Array] = []

    def solutions(self, T: Array) -> list[Array]:
        """Return solutions of poses (N, 4, 4), each (k, m), up to whole turns, inside the limits: all of most poses."""
        found: list[Array] = [np.zeros((0, len(self.robot.joint_names)))] * len(T)
        new = self._far(T)
        of_new = joint_solutions(self.robot, T[new]) if new else []
        for i, solutions in zip(new, of_new, strict=True):
            found[i] = solutions
            if len(solutions):
                self.poses = np.concatenate([self.poses, T[i][None]])
                self.known.append(solutions)
        others = np.setdiff1d(np.arange(len(T)), new).tolist()
        if not others or not self.known:
            return found
        # From the solutions of the two nearest poses: near a limit one has some that the other lacks.
        rows, seeds = [], []
        for i in others:
            for near in np.argsort(_distances(self.poses, T[i]))[:2].tolist():
                rows += [i] * len(self.known[near])
                seeds.append(self.known[near])
        index = np.array(rows)
        solution = solve(self.arm, T[index], np.concatenate(seeds), _MATCHING, steps=60)
        misses = np.linalg.norm(_MATCHING.error(solution.T_base_tool, T[index]), axis=1)
        values, is_inside = inside_limits(self.robot, solution.q)
        is_solution = (misses < _near_enough(self.robot)) & is_inside
        for i in others:
            found[i] = distinct(values[is_solution & (index == i)])
        return found

    def _far(self, T: Array) -> list[int]:
        """Return which of poses (N, 4, 4) are far from those of the bank and from each other, while it has room."""
        chosen: list[int] = []
        away = np.full(len(T), np.inf)
        for pose in self.poses:
            away = np.minimum(away, _distances(T, pose))
        while len(T) and len(self.known) + len(chosen) < _BANK and away.max() > _FAR:
            chosen.append(int(np.argmax(away)))
            away = np.minimum(away, _distances(T, T[chosen[-1]]))
        return chosen


def _near_enough(robot: Robot) -> float:
    """Return by how much a pose may be missed that is reached [m]."""
    return _NEARLY if len(robot.joint_names) < 6 else _REACHED


def _distances(T: Array, T_other: Array) -> Array:
    """Return how far poses (N, 4, 4) are from another one, (N,) [m], a radian counting as `_LENGTH`."""
    error = _MATCHING.error(T, np.broadcast_to(T_other, T.shape))
    return np.asarray(np.linalg.norm(error, axis=1))


def _with_steps(T: Array) -> tuple[Array, Integers]:
    """Return poses on the straight ways between neighbours of poses (n + 1, 4, 4), and which of them end the ways.

    The first pose is not among them: with t from 0 to 1, p(t) = p + t (p' - p) and R(t) = R exp(t log(R^T R')).
    """
    between = np.swapaxes(T[:-1, :3, :3], 1, 2) @ T[1:, :3, :3]
    turns = to_rotation_vectors(between)
    shift = np.diff(T[:, :3, 3], axis=0)
    lengths = np.linalg.norm(shift, axis=1) / _STEP[0]
    angles = np.linalg.norm(turns, axis=1) / _STEP[1]
    counts = np.clip(np.ceil(np.maximum(lengths, angles)), 1, _MOST_STEPS).astype(np.intp)
    way = np.repeat(np.arange(len(counts)), counts)
    ends = np.cumsum(counts) - 1
    share = ((np.arange(len(way)) - ends[way]) / counts[way] + 1.0)[:, None]
    steps = np.tile(np.eye(4), (len(way), 1, 1))
    steps[:, :3, 3] = T[way, :3, 3] + share * shift[way]
    steps[:, :3, :3] = T[way, :3, :3] @ to_matrices(share * turns[way])
    steps[ends] = T[1:]
    return steps, ends


def _block(steps: Array) -> int:
    """Return how many of poses (n, 4, 4) are solved at once, those that are near the first."""
    some = steps[:_MOST_IN_BLOCK]
    is_far = _distances(some, steps[0]) > _BLOCK
    return int(np.argmax(is_far)) if is_far.any() else len(some)
