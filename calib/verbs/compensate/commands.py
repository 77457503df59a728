"""Commands for a robot whose controller keeps its own model, such that the true robot arrives (paper, stage four).

The calibrated model predicts where the true robot is, T_true(q), the nominal one what its controller believes,
T_nominal(q). For a wanted pose T of the tool:

    q:       T_true(q) = T               joint values to command, in the branch of the nominal solution
    T_send = T_nominal(q)                the pose to send: the controller's own inverse kinematics makes q of it

Both are the same command in two forms; for an arm with a redundant joint see `_poses_to_send`. Poses sent in
place of the wanted ones are known as fake targets. Source: Z. Roth, B. Mooring, B. Ravani, An overview of robot
calibration, 1987 ("compensation").
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from calib.basics.arguments import check_type, finite_numbers
from calib.basics.arrays import Array, Mask, read_only, rigid_inverse
from calib.basics.values import Value, one_line
from calib.data.inputs import ROBOT, RobotInput, chain_of, robot_of
from calib.diagnosis.reasons import NO
from calib.errors import VerdictError
from calib.result.calibration import Calibration
from calib.result.calibration_file import RESULT, is_result_file, result_of
from calib.robot.gravity import Payload
from calib.robot.ranges import column_limits
from calib.robot.robot import Robot
from calib.verbs.compensate.expected import ExpectedErrors, expected_errors
from calib.verbs.compensate.inverse import (
    AXIS,
    POSE,
    POSITION,
    Matching,
    Solution,
    following,
    solve,
    start_values,
)
from calib.verbs.compensate.nominal_actual import Pair, pair_of
from calib.verbs.compensate.program import Program
from calib.verbs.compensate.warnings import (
    CommandWarning,
    ReachedRows,
    reasons_without_command,
    warnings_of,
    within,
)

#: A pose that the nominal robot misses by more than this is matched in part [m].
_PARTLY = 1e-6

#: A pose that the nominal robot misses by more than this is not reached at all [m], [rad].
_NOMINAL = (1e-6, 1e-6)

#: The least tolerance: less is rounding [m], [rad].
_EXACT = 1e-9

#: Below this there is nothing to correct [rad or m].
_ENOUGH = 1e-12

#: Corrections of the pose to send at most: the nominal robot differs from the actual one by a hundredth at most, so
#: that each wins two digits.
_CORRECTIONS = 6


@dataclass(frozen=True, slots=True, eq=False)
class Commands(Value):
    """Commands that bring the true robot to the poses of a program; rows that cannot be reached are NaN."""

    #: The robot as its controller has it and the actual one, their tools, the frame of the poses.
    pair: Pair
    #: The program.
    program: Program
    #: What of the poses is reached, one of `calib.verbs.compensate.inverse.MATCHES`.
    match: str
    #: shape (N, 4, 4), wanted pose of the tool, in the frame of the poses [m]; where only its position was given,
    #: oriented as the nominal robot's is.
    T_wanted: Array
    #: Shape (N, m), joint values that the nominal model has for it [rad] or [m].
    q_nominal: Array
    #: Shape (N, m), joint values to command [rad] or [m].
    q: Array
    #: Shape (N, 4, 4), pose to send to a controller with the nominal model [m].
    T_send: Array
    #: shape (N, 2), how far the true robot would miss at ``q_nominal``, as the calibrated model predicts: position
    #: [m], angle [rad]. Of the position alone the angle is NaN.
    missed: Array
    #: Shape (N, 2), how far it misses at ``q`` [m], [rad]: what cannot be reached.
    left: Array
    #: shape (N, 2), how far it misses if ``T_send`` is sent, to a controller that stays near ``q_nominal``.
    left_by_pose: Array
    #: Expected errors of the rows that have a command, in their order; None of two robots without a result.
    expected: ExpectedErrors | None
    #: Why a row has no command; None where it has one.
    reasons: tuple[CommandWarning | None, ...]
    #: Of each row that has one.
    warnings: tuple[tuple[CommandWarning, ...], ...]

    def __repr__(self) -> str:
        """Return one line: the robot, how many rows have a command, the largest correction of a position."""
        reached = int(self.reached.sum())
        largest = ""
        if reached:
            largest = f"corrections up to {1e3 * np.nanmax(self.pose_corrections[:, 0]):.3f} mm"
        counts = f"{reached} of {len(self)} rows with a command"
        return one_line("Commands", f"'{self.nominal.name}'", counts, largest)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.q)

    @property
    def nominal(self) -> Robot:
        """The robot as its controller has it."""
        return self.pair.nominal.robot

    @property
    def reached(self) -> Mask:
        """Rows that have a command, shape (N,)."""
        return np.array([reason is None for reason in self.reasons])

    @property
    def expected_errors(self) -> Array:
        """Expected error of each row, mean distance [m] and angle [rad], shape (N, 2); NaN where it is not known."""
        errors = np.full((len(self), 2), np.nan)
        if self.expected is not None:
            errors[self.reached] = self.expected.errors
        return errors

    @property
    def joint_corrections(self) -> Array:
        """Correction of the joint values, q - q_nominal, shape (N, m), [rad] or [m]."""
        return np.asarray(self.q - self.q_nominal)

    @property
    def pose_corrections(self) -> Array:
        """Distance of the pose to send from the wanted one, shape (N, 2): position [m], angle [rad]."""
        return Matching(POSE, 1.0).misses(self.T_send, self.T_wanted)


def compensate(
    calibration: Calibration | RobotInput,
    program: Program,
    *,
    nominal: RobotInput | None = None,
    tool: ArrayLike | str | None = None,
    frame: ArrayLike | str | None = None,
    tolerance: tuple[float, float] = (1e-8, 1e-8),
    non_geometric: bool | Payload = True,
    accept: bool = False,
) -> Commands:
    """Compute commands that bring the true robot to the poses of a program.

    Args:
        calibration: The model of the true robot: a result, or the path of its file (.json); or a corrected robot, the
            path of its URDF or xacro, or its name.
        program: The poses to reach.
        nominal: The model that its controller has, or the path of its URDF or xacro, or its name; None: the nominal
            robot of the result.
        tool: What is to arrive: a pose in the tip, shape (4, 4) [m], or a position, shape (3,); or the name of a target
            of the calibration ("" for the only one), where the calibrated model has it; None: the tip itself.
        frame: The base in the frame that poses are given and sent in, shape (4, 4) [m], or the name of a group of the
            calibration ("" for the only one); None: the base.
        tolerance: Error that a row may keep: position [m], angle [rad]; no less than 1e-9.
        non_geometric: Whether to use the non-geometric model, if there is one, else the geometry of the URDF; or
            the payload to use it with, in place of the one at its calibration.
        accept: Whether commands are made even where the verdict on the model that is used is ``do not use``.

    Returns:
        The commands, a row for each of the program.

    Raises:
        ArgumentError: An argument of another type.
        VerdictError: That verdict is ``do not use``, or a corrected robot's URDF states it, and it is not accepted.
        ModelError: A tool, frame or joint that does not exist, a program of another robot, or no nominal robot.
    """
    check_type("program", program, Program, "a Program, such as Program.of_poses(T)")
    _check_tolerance(tolerance)
    check_type("non_geometric", non_geometric, (bool, Payload), "True, False, or a Payload")
    pair = pair_of(
        *_models(calibration, nominal), tool=tool, frame=frame, non_geometric=non_geometric
    )
    if not accept:
        _check_verdict(pair)
    tolerance = (max(tolerance[0], _EXACT), max(tolerance[1], _EXACT))
    matching = _matching(pair, program)
    # For the nominal robot: the wanted poses in the base, and its joint values for them.
    T_wanted, nominal_solution = _nominal_solution(pair, program, matching)
    limits = column_limits(pair.nominal.robot)
    solution = solve(pair.actual, T_wanted, nominal_solution.q, matching, limits)
    solved = _SolvedProgram(pair, matching, T_wanted, nominal_solution, solution)
    return _assemble(program, solved, tolerance)


def _models(
    calibration: Calibration | RobotInput, nominal: RobotInput | None
) -> tuple[Calibration | Robot, Robot | None]:
    """Return the models of the true robot and of the controller, read where paths or names were given.

    One that is read has the chain of the other one, if that is known.
    """
    allowed = f"{RESULT}; or {ROBOT}"
    check_type("calibration", calibration, (Calibration, Robot, str, Path), allowed)
    check_type("nominal", nominal, (Robot, str, Path, type(None)), f"{ROBOT}, or None")
    true: Calibration | Robot
    if isinstance(calibration, (Calibration, Robot)):
        true = calibration
    elif is_result_file(calibration):
        true = result_of(calibration)
    else:
        chain = chain_of(nominal) if isinstance(nominal, Robot) else None
        true = robot_of(calibration, chain, argument="calibration")
    if nominal is None or isinstance(nominal, Robot):
        return true, nominal
    known = true if isinstance(true, Robot) else true.nominal
    return true, robot_of(nominal, chain_of(known), argument="nominal")


def _check_tolerance(tolerance: object) -> None:
    """Refuse a tolerance that is no pair of finite numbers."""
    allowed = "an error in position [m] and one in angle [rad], such as (1e-8, 1e-8)"
    finite_numbers("tolerance", tolerance, (2,), allowed)


@dataclass(frozen=True, slots=True, eq=False)
class _SolvedProgram:
    """The N poses of a program, and the joint values that the nominal and the actual robot have for them."""

    #: The nominal and the actual robot, with their tools.
    pair: Pair
    #: What of the poses is matched.
    matching: Matching
    #: Wanted poses of the tool in the base, shape (N, 4, 4), [m].
    T_wanted: Array
    #: The nominal robot at its joint values for them.
    nominal: Solution
    #: The actual robot at the joint values to command.
    actual: Solution

    def misses(self, solution: Solution) -> Array:
        """Compute distance [m] and angle [rad] of a robot's tool from the wanted poses, shape (N, 2).

        Args:
            solution: The robot at any joint values for the N poses.
        """
        return self.matching.misses(solution.T_base_tool, self.T_wanted)

    def uncorrected(self) -> Solution:
        """Return the actual robot at the nominal joint values."""
        q_nominal = self.nominal.q
        return Solution(q_nominal, *self.pair.actual.motion(q_nominal))


def _matching(pair: Pair, program: Program) -> Matching:
    """Return what of the poses is matched: as the program says, else as much as the number of joints allows.

    Where all is reached, the length that weighs an angle does not matter: it is the arm's own.

    Args:
        pair: The nominal and the actual robot.
        program: The poses to reach.
    """
    count = len(pair.nominal.robot.joint_names)
    if program.match:
        match = program.match
    elif not program.oriented or count < 5:
        match = POSITION
    else:
        match = POSE if count >= 6 else AXIS
    return Matching(match, pair.reach)


def _assemble(program: Program, solved: _SolvedProgram, tolerance: tuple[float, float]) -> Commands:
    """Return the commands, with what is missed, the expected errors, reasons and warnings.

    Args:
        program: The N rows to run through.
        solved: Its poses, and the joint values of both robots for them.
        tolerance: Error that a row may keep: position [m], angle [rad].
    """
    pair = solved.pair
    uncorrected = solved.uncorrected()
    misses = solved.misses(solved.actual)
    reasons = reasons_without_command(
        pair, solved.matching, uncorrected, solved.actual, misses, tolerance
    )
    reached = np.array([reason is None for reason in reasons])
    nominal_reaches = within(solved.misses(solved.nominal), _NOMINAL)
    T_send, misses_by_pose = _poses_to_send(solved)
    expected = None
    if pair.result and reached.any():
        expected = expected_errors(pair, solved.actual.q[reached])
    without_warnings = Commands(
        pair=pair,
        program=program,
        match=solved.matching.name,
        T_wanted=read_only(pair.T_frame_base @ solved.T_wanted),
        q_nominal=_where(nominal_reaches, solved.nominal.q),
        q=_where(reached, solved.actual.q),
        T_send=_where(reached, pair.T_frame_base @ T_send),
        missed=_where(nominal_reaches, solved.misses(uncorrected)),
        left=read_only(misses),
        left_by_pose=_where(reached, misses_by_pose),
        expected=expected,
        reasons=tuple(reasons),
        warnings=((),) * len(reasons),
    )
    return replace(without_warnings, warnings=_warnings(without_warnings, tolerance))


def _check_verdict(pair: Pair) -> None:
    """Refuse commands by a model whose verdict is ``do not use``; raises `VerdictError`.

    Args:
        pair: Of a result, whose verdict counts, or of two robots, where the actual one's URDF may state a verdict.
    """
    if pair.result is None:
        source = pair.actual.robot.urdf.source
        stated = pair.actual.robot.urdf.verdict
    else:
        verdict = pair.result.verdict_on(non_geometric=pair.non_geometric)
        source = pair.result.source.name or "these measurements"
        is_against = verdict is not None and verdict.use == NO
        stated = f"{NO} (the summary() of the result says why)" if is_against else ""
    if stated:
        raise VerdictError(
            f"The verdict on {source} is: {stated}. No commands are made by it; accept=True (on the "
            "command line --accept) makes them nonetheless."
        )


def _nominal_solution(pair: Pair, program: Program, matching: Matching) -> tuple[Array, Solution]:
    """Solve for the nominal robot.

    Its joint values are for the full pose where one is given, and it can have one, even where less is matched: what is
    left free is to stay as the program has it.

    Args:
        pair: The nominal and the actual robot.
        program: The program.
        matching: What of the poses is matched.

    Returns:
        The wanted poses in the base, shape (N, 4, 4), [m], and the nominal robot at its joint values for them.
    """
    nominal = pair.nominal
    if program.T_wanted is None:
        assert program.q is not None
        poses, twists = nominal.motion(program.q)
        return poses, Solution(program.q, poses, twists)
    T_wanted = rigid_inverse(pair.T_frame_base) @ program.T_wanted
    has_full_pose = program.oriented and len(nominal.robot.joint_names) >= 6
    full = Matching(POSE, pair.reach) if has_full_pose else matching
    if program.q is not None:
        limits = column_limits(nominal.robot)
        solution = solve(nominal, T_wanted, program.q, full, limits)
    else:
        start = start_values(nominal.robot, program.start)
        solution = following(nominal, T_wanted, start, full)
    if full.name != matching.name:
        solution = _matched_in_part(pair, T_wanted, solution, full, matching)
    if not program.oriented:
        # What was not asked for is as the nominal robot has it, so that a pose to send can be compared with it.
        T_wanted[:, :3, :3] = solution.T_base_tool[:, :3, :3]
    return T_wanted, solution


def _matched_in_part(
    pair: Pair,
    T_wanted: Array,
    solution: Solution,
    full: Matching,
    matching: Matching,
) -> Solution:
    """Solve the rows again whose full pose the nominal robot misses, for what has to be matched of it.

    Args:
        pair: Has the nominal robot.
        T_wanted: Wanted poses of the tool in the base, shape (N, 4, 4), [m].
        solution: The nominal robot at its joint values for the full poses.
        full: Matches position and orientation.
        matching: What of the poses has to be matched.

    Returns:
        The nominal robot at its joint values for them, those of the rows that it does not miss as they were.
    """
    misses = np.linalg.norm(full.error(solution.T_base_tool, T_wanted), axis=1)
    again = misses > _PARTLY
    if not again.any():
        return solution
    limits = column_limits(pair.nominal.robot)
    q = solution.q.copy()
    q[again] = solve(pair.nominal, T_wanted[again], solution.q[again], matching, limits).q
    return Solution(read_only(q), *pair.nominal.motion(q))


def _poses_to_send(solved: _SolvedProgram) -> tuple[Array, Array]:
    """Compute the poses to send.

    The controller's own inverse kinematics q = q_nominal(T_send) is taken to stay near the joint values that it has for
    the wanted pose. A robot without a redundant joint then comes to the joint values that were meant. One with a
    redundant joint chooses where its elbow goes, and the pose is corrected for that choice, a few times over:

        T_send <- T_send exp(e),   e: what the actual robot still misses, along the tool's axes

    Args:
        solved: The N wanted poses, and the joint values of the nominal and the actual robot for them.

    Returns:
        The poses in the base, shape (N, 4, 4), [m], and how far the actual robot misses then, shape (N, 2), [m], [rad].
    """
    pair, matching = solved.pair, solved.matching
    T_send = pair.nominal.poses(solved.actual.q)
    T_arrived = np.empty_like(T_send)
    rows = np.arange(len(T_send))
    for _ in range(_CORRECTIONS):
        q = _controller_joint_values(pair, T_send[rows], solved.nominal.q[rows])
        T_arrived[rows] = pair.actual.poses(q)
        if not _is_redundant(pair):
            break
        error = matching.error(T_arrived[rows], solved.T_wanted[rows])
        is_elsewhere = np.abs(q - solved.actual.q[rows]).max(axis=1) > _ENOUGH
        correctable = is_elsewhere & (np.linalg.norm(error, axis=1) > _ENOUGH)
        if not correctable.any():
            break
        rows = rows[correctable]
        T_send[rows] = T_send[rows] @ _motions_by(matching, error[correctable])
    return T_send, matching.misses(T_arrived, solved.T_wanted)


def _is_redundant(pair: Pair) -> bool:
    """Return whether the robot can hold a pose of its tool and move: it has more joints than a pose has scalars."""
    return len(pair.nominal.robot.joint_names) > Matching(POSE, pair.reach).rows


def _controller_joint_values(pair: Pair, T_send: Array, q_nominal: Array) -> Array:
    """Return the joint values that a controller with the nominal model has for poses that are sent to it.

    Args:
        pair: Has the nominal robot.
        T_send: Poses of the tool in the base, shape (n, 4, 4), [m].
        q_nominal: Joint values that it stays near, shape (n, m), [rad] or [m].

    Returns:
        shape (n, m), [rad] or [m].
    """
    limits = column_limits(pair.nominal.robot)
    return solve(pair.nominal, T_send, q_nominal, Matching(POSE, pair.reach), limits).q


def _motions_by(matching: Matching, error: Array) -> Array:
    """Return the motions of the tool, along its own axes, that take away an error: exp(e), shape (n, 4, 4), [m].

    Args:
        matching: What of the poses is matched; what is not stays as it is.
        error: Wanted minus present, shape (n, rows), [m], see `Matching.error`.
    """
    twists = np.zeros((len(error), 6))
    twists[:, :3] = error[:, :3]
    twists[:, 3 : matching.rows] = error[:, 3:] / matching.length
    return np.array([pin.exp6(twist).homogeneous for twist in twists])


def _where(rows: Mask, values: Array) -> Array:
    """Return the values of some rows, the others NaN; read-only.

    Args:
        rows: Which rows keep their values, shape (N,).
        values: shape (N, ...).
    """
    further_axes = [1] * (values.ndim - 1)
    mask = rows.reshape(-1, *further_axes)
    return read_only(np.where(mask, values, np.nan))


def _warnings(
    commands: Commands, tolerance: tuple[float, float]
) -> tuple[tuple[CommandWarning, ...], ...]:
    """Return the warnings of each of the N rows; none for a row without a command.

    Args:
        commands: Complete but for the warnings.
        tolerance: Error that a row may keep: position [m], angle [rad].
    """
    reached = np.flatnonzero(commands.reached)
    rows = ReachedRows(
        pair=commands.pair,
        match=commands.match,
        labels=tuple(commands.program.labels[i] for i in reached),
        T_wanted=commands.T_wanted[reached],
        q_nominal=commands.q_nominal[reached],
        q=commands.q[reached],
        pose_corrections=commands.pose_corrections[reached],
        misses=commands.left[reached],
        misses_by_pose=commands.left_by_pose[reached],
    )
    warnings: list[tuple[CommandWarning, ...]] = [()] * len(commands)
    for i, of_row in zip(reached, warnings_of(rows, tolerance), strict=True):
        warnings[i] = tuple(of_row)
    return tuple(warnings)
