"""Commands for a robot whose controller keeps its own model, such that the true robot arrives (paper, stage four).

The calibrated model predicts where the true robot is, T_true(q), and the nominal one where its controller believes it
to be, T_nominal(q). For a wanted pose T of the tool:

    q:       T_true(q) = T               joint values to command, in the branch of the nominal solution
    T_send = T_nominal(q)                the pose to send: the controller's own inverse kinematics makes q of it

Both are the same command in two forms; for an arm with a redundant joint see `_find_poses_to_send`. Poses sent in
place of the wanted ones are known as fake targets. Source: Z. Roth, B. Mooring, B. Ravani, An overview of robot
calibration, 1987 ("compensation").
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from calib.basics.arguments import check_type, finite_numbers
from calib.basics.arrays import Array, Mask, read_only, rigid_inverse
from calib.data.inputs import ROBOT, RobotInput, chain_of, robot_of
from calib.diagnosis.reasons import NO
from calib.errors import VerdictError
from calib.numerics.moves import last_moves
from calib.result.calibration import Calibration
from calib.result.calibration_file import RESULT, is_result_file, result_of
from calib.robot.gravity import Payload
from calib.robot.ranges import column_limits
from calib.robot.robot import Robot
from calib.verbs.compensate.commands import Commands
from calib.verbs.compensate.expected import expected_errors
from calib.verbs.compensate.inverse import (
    AXIS,
    POSE,
    POSITION,
    Matching,
    Solution,
    follow,
    solve,
    start_values,
)
from calib.verbs.compensate.nominal_actual import Pair, pair_of
from calib.verbs.compensate.robot_program import Program
from calib.verbs.compensate.warnings import find_reasons, find_warnings, within

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
        nominal: The model that the controller has, or the path of its URDF or xacro, or its name; None: the nominal
            robot of the result.
        tool: Tool that is to arrive: a pose in the tip, shape (4, 4) [m], or a position, shape (3,); or the name of a
            target of the calibration ("" for the only one), where the calibrated model has it; None: the tip itself.
        frame: The base in the frame that poses are given and sent in, shape (4, 4) [m], or the name of a station of the
            calibration ("" for the only one); None: the base.
        tolerance: Error that a row may keep: position [m], angle [rad]; no less than 1e-9.
        non_geometric: Whether to use the non-geometric model, if there is one, else the geometry of the URDF; or
            the payload to use it with, in place of the one at its calibration.
        accept: Whether commands are made even if the verdict on the model in use is ``do not use``.

    Returns:
        The commands, a row for each of the program.

    Raises:
        ArgumentError: An argument of another type.
        VerdictError: That verdict is ``do not use``, or a corrected robot's URDF states it, and it is not accepted.
        ModelError: A tool, frame or joint that does not exist, a program of another robot, or no nominal robot.
    """
    check_type("program", program, Program, "a Program, such as Program.of_poses(T)")
    allowed = "an error in position [m] and one in angle [rad], such as (1e-8, 1e-8)"
    finite_numbers("tolerance", tolerance, (2,), allowed)
    check_type("non_geometric", non_geometric, (bool, Payload), "True, False, or a Payload")
    models = _load_models(calibration, nominal)
    pair = pair_of(*models, tool=tool, frame=frame, non_geometric=non_geometric)
    if pair.result is None:
        source = pair.actual.robot.urdf.source
        stated = pair.actual.robot.urdf.verdict
    else:
        verdict = pair.result.verdict_on(non_geometric=pair.non_geometric)
        source = pair.result.source.name or "these measurements"
        is_against = verdict is not None and verdict.use == NO
        stated = f"{NO} (the summary() of the result says why)" if is_against else ""
    if stated and not accept:
        raise VerdictError(
            f"The verdict on {source} is: {stated}. No commands are made by it; accept=True (on the "
            "command line --accept) makes them nonetheless."
        )

    # As the program says, otherwise as much as the number of joints allows.
    match = program.match
    if match is None:
        joint_count = len(pair.nominal.robot.joint_names)
        match = POSE if joint_count >= 6 else AXIS
        if not program.oriented or joint_count < 5:
            match = POSITION
    matching = Matching(match, pair.reach)
    tolerance = (max(tolerance[0], _EXACT), max(tolerance[1], _EXACT))
    T_wanted, nominal_solution = _solve_nominal(pair, program, matching)
    q_nominal = nominal_solution.q
    nominal_misses = matching.misses(nominal_solution.T_base_tool, T_wanted)
    nominal_reaches = within(nominal_misses, _NOMINAL)
    # Corrections are far shorter than moves: the joints come to each row as the nominal robot's do.
    moves = last_moves(_where(nominal_reaches, q_nominal))
    moved = replace(pair, actual=replace(pair.actual, moves=moves))
    uncorrected = Solution(q_nominal, *moved.actual.motion(q_nominal))
    limits = column_limits(pair.nominal.robot)
    corrected = solve(moved.actual, T_wanted, q_nominal, matching, limits)
    T_send, misses_by_pose = _find_poses_to_send(moved, matching, T_wanted, q_nominal, corrected.q)

    misses = matching.misses(corrected.T_base_tool, T_wanted)
    reasons = find_reasons(pair, matching, uncorrected, corrected, misses, tolerance)
    reached = np.array([reason is None for reason in reasons])
    missed = matching.misses(uncorrected.T_base_tool, T_wanted)
    expected = None
    if pair.result and reached.any():
        at_reached = replace(pair, actual=moved.actual.at_rows(np.flatnonzero(reached)))
        expected = expected_errors(at_reached, corrected.q[reached])
    commands = Commands(
        pair=pair,
        program=program,
        match=matching.name,
        T_wanted=read_only(pair.T_frame_base @ T_wanted),
        q_nominal=_where(nominal_reaches, q_nominal),
        q=_where(reached, corrected.q),
        T_send=_where(reached, pair.T_frame_base @ T_send),
        missed=_where(nominal_reaches, missed),
        left=read_only(misses),
        left_by_pose=_where(reached, misses_by_pose),
        expected=expected,
        reasons=tuple(reasons),
        warnings=((),) * len(reasons),
    )
    return replace(commands, warnings=find_warnings(commands, tolerance))


def _load_models(
    calibration: Calibration | RobotInput, nominal: RobotInput | None
) -> tuple[Calibration | Robot, Robot | None]:
    """Return the models of the true robot and of the controller; None if no nominal robot was given.

    One that is read from a file gets base, tip and held joints of the other. Another type raises `ArgumentError`.
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


def _solve_nominal(pair: Pair, program: Program, matching: Matching) -> tuple[Array, Solution]:
    """Return the wanted poses in the base, (N, 4, 4) [m], and the nominal robot at its joint values for them.

    Without poses in the program, they are those that the nominal robot has at the program's joint values. If a full
    pose is given and the robot can have it, these joint values are for the full pose even if less is matched: what is
    left free stays as the program has it.
    """
    nominal = pair.nominal
    if program.T_wanted is None:
        assert program.q is not None
        poses, twists = nominal.motion(program.q)
        return poses, Solution(program.q, poses, twists)

    T_wanted = rigid_inverse(pair.T_frame_base) @ program.T_wanted
    limits = column_limits(nominal.robot)
    has_full_pose = program.oriented and len(nominal.robot.joint_names) >= 6
    full = Matching(POSE, pair.reach) if has_full_pose else matching
    if program.q is not None:
        solution = solve(nominal, T_wanted, program.q, full, limits)
    else:
        start = start_values(nominal.robot, program.start)
        solution = follow(nominal, T_wanted, start, full)

    if full.name != matching.name:
        misses = np.linalg.norm(full.error(solution.T_base_tool, T_wanted), axis=1)
        again = misses > _PARTLY
        if again.any():
            q = solution.q.copy()
            q[again] = solve(nominal, T_wanted[again], solution.q[again], matching, limits).q
            solution = Solution(read_only(q), *nominal.motion(q))
    if not program.oriented:
        # What was not asked for is as the nominal robot has it, so that a pose to send can be compared with it.
        T_wanted[:, :3, :3] = solution.T_base_tool[:, :3, :3]
    return T_wanted, solution


def _find_poses_to_send(
    pair: Pair, matching: Matching, T_wanted: Array, q_nominal: Array, q: Array
) -> tuple[Array, Array]:
    """Return the poses in the base to send for joint values (N, m), (N, 4, 4) [m], and what the true robot then misses.

    That is a distance [m] and an angle [rad] from the wanted poses in the base, shape (N, 2), see `Matching.misses`.
    The controller's own inverse kinematics q_nominal(T_send) is taken to stay near the joint values that it has for the
    wanted pose. A robot without a redundant joint then arrives at the joint values that were meant. One that has a
    redundant joint chooses where its elbow goes, and the pose is corrected for that choice, a few times over:

        T_send <- T_send exp(e),   e: what the actual robot still misses, along the tool's axes
    """
    full = Matching(POSE, pair.reach)
    limits = column_limits(pair.nominal.robot)
    is_redundant = len(pair.nominal.robot.joint_names) > full.rows
    T_send = pair.nominal.poses(q)
    T_arrived = np.empty_like(T_send)
    rows = np.arange(len(T_send))
    for _ in range(_CORRECTIONS):
        q_sent = solve(pair.nominal, T_send[rows], q_nominal[rows], full, limits).q
        T_arrived[rows] = pair.actual.at_rows(rows).poses(q_sent)
        if not is_redundant:
            break
        error = matching.error(T_arrived[rows], T_wanted[rows])
        is_elsewhere = np.abs(q_sent - q[rows]).max(axis=1) > _ENOUGH
        correctable = is_elsewhere & (np.linalg.norm(error, axis=1) > _ENOUGH)
        if not correctable.any():
            break
        rows = rows[correctable]
        T_send[rows] = T_send[rows] @ matching.motions(error[correctable])
    return T_send, matching.misses(T_arrived, T_wanted)


def _where(rows: Mask, values: Array) -> Array:
    """Return values (N, ...), read-only, with NaN in the rows where a mask (N,) is False."""
    further_axes = [1] * (values.ndim - 1)
    mask = rows.reshape(-1, *further_axes)
    return read_only(np.where(mask, values, np.nan))
