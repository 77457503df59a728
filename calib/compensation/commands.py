"""Commands for a robot whose controller keeps its own model, such that the true robot arrives (paper, stage four).

The calibrated model says where the true robot is, T_true(q), the nominal one what its controller believes,
T_nominal(q). For a wanted pose T of the tool:

    q:       T_true(q) = T               joint values to command, in the branch of the nominal solution
    T_send = T_nominal(q)                the pose to send: the controller's own inverse kinematics makes q of it

Both are the same command in two forms; for an arm with a redundant joint see `_poses_to_send`. Poses sent in
place of the wanted ones are known as fake targets. Source: Z. Roth, B. Mooring, B. Ravani, An overview of robot
calibration, 1987 ("compensation").
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from calib.compensation.expected import ExpectedErrors, expected_errors
from calib.compensation.inverse import (
    AXIS,
    POSE,
    POSITION,
    Matching,
    Solved,
    following,
    solve,
    start_values,
)
from calib.compensation.nominal_actual import Pair, pair_of
from calib.compensation.program import CORRECTION, EXPECTED, Program
from calib.data.columns import POINT, QUATERNION, ROLL_PITCH_YAW, ROTATION_VECTOR, STATUS
from calib.diagnosis.reasons import NO
from calib.errors import VerdictError
from calib.files import csv_bytes, write_atomically
from calib.numerics.geometry import to_quaternions
from calib.result.calibration import CalibrationValues
from calib.robot.payload import Payload
from calib.robot.ranges import column_limits
from calib.robot.robot import Robot, read_only, rigid_inverse
from calib.units import Array, Mask

Code = Literal[
    "unreachable",
    "beyond limit",
    "other branch",
    "near singularity",
    "large pose correction",
    "large joint correction",
    "jump",
    "ambiguous pose",
    "outside measured range",
]
"""The first three are reasons why a row has no command, the others warnings; docs/compensation.md says what to do."""

#: A pose that the nominal robot misses by more is matched in part [m]; it is not reached at all [m], [rad].
_LOST, _NOMINAL = 1e-6, (1e-6, 1e-6)

#: Less than this is rounding [m], [rad]; below the second there is nothing to correct [m].
_EXACT, _ENOUGH = 1e-9, 1e-12

#: The nominal robot differs from the actual one by a hundredth at most, so that each time two digits are won.
_TIMES = 6

#: Near a singularity: the smallest singular value of the tool's motion, lengths in units of the arm's reach.
_NEAR_SINGULAR = 0.01

#: Corrections that are larger than real arms need: of a joint [rad], [m], and of the pose to send [m], [rad].
_JOINT_LIMIT, _POSE_LIMIT = (np.radians(5.0), 0.02), (0.01, np.radians(2.0))

#: A jump: joints move from row to row by this more than the nominal ones [rad or m] and by this factor, or further than
#: the third between poses that are nearer than the last to each other (a share of the reach, and [rad]).
_STEP_MORE, _STEP_FACTOR, _TURNED_OVER, _CLOSE = np.radians(2.0), 1.5, 0.5, (0.1, 0.3)

#: The units of a table: how many are one in SI units, decimals. Angles are exact to 1e-11 rad, lengths to 1e-9 m.
_UNITS = {"deg": (math.degrees(1.0), 9), "rad": (1.0, 12), "mm": (1e3, 6), "": (1.0, 12)}

#: The forms of an orientation: names of the columns, their unit, and the numbers of a rotation (3, 3).
_ORIENTATIONS: dict[str, tuple[Sequence[str], str, Callable[[Array], Array]]] = {
    "rotation-vector": (ROTATION_VECTOR, "rad", lambda R: Rotation.from_matrix(R).as_rotvec()),
    "quaternion": (QUATERNION, "", lambda R: to_quaternions(R[None])[0]),
    "rpy": (ROLL_PITCH_YAW, "deg", pin.rpy.matrixToRpy),
}


class Finding(NamedTuple):
    """What to know of a row."""

    code: Code
    #: Of "unreachable", "large pose correction", "ambiguous pose": position [m] and angle [rad], NaN where it is not
    #: matched; "beyond limit": value and limit; "near singularity": what 1 mm of the tool takes of the joint; else how
    #: far the joint moves, or is away [rad or m].
    numbers: tuple[float, ...] = ()
    joint: str = ""  #: The joint that it is about.
    row: str = ""  #: The other row that it is about.


@dataclass(frozen=True, slots=True, eq=False)
class Commands:
    """What to command so that the true robot does what a program wants; rows that cannot be reached are NaN."""

    pair: Pair  #: The robot as its controller has it and the actual one, their tools, the frame of the poses.
    program: Program  #: What was asked for.
    match: str  #: What of the poses is reached, one of `calib.compensation.inverse.MATCHES`.
    #: shape (N, 4, 4), pose of the tool that is wanted, in the frame of the poses [m]; where only its position was
    #: given, oriented as the nominal robot's is.
    T_wanted: Array
    q_nominal: Array  #: shape (N, m), joint values that the nominal model has for it [rad] or [m].
    q: Array  #: shape (N, m), joint values to command [rad] or [m].
    T_send: Array  #: shape (N, 4, 4), pose to send to a controller with the nominal model [m].
    #: shape (N, 2), how far the true robot would miss at ``q_nominal``, as the calibrated model predicts: position
    #: [m], angle [rad]. Of the position alone the angle is NaN.
    missed: Array
    left: Array  #: shape (N, 2), how far it misses at ``q`` [m], [rad]: what cannot be reached.
    #: shape (N, 2), how far it misses if ``T_send`` is sent, to a controller that stays near ``q_nominal``.
    left_by_pose: Array
    #: Errors to expect of the rows that have a command, in their order; None of two robots without a result.
    expected: ExpectedErrors | None
    reasons: tuple[Finding | None, ...]  #: Why a row has no command; None where it has one.
    warnings: tuple[tuple[Finding, ...], ...]  #: For each row what to know of its command.

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.q)

    @property
    def nominal(self) -> Robot:
        """The robot as its controller has it."""
        return self.pair.nominal.robot

    @property
    def reached(self) -> NDArray[np.bool_]:
        """Which rows have a command, shape (N,)."""
        return np.array([reason is None for reason in self.reasons])

    @property
    def expected_errors(self) -> Array:
        """Error to expect of each row, mean distance [m] and angle [rad], shape (N, 2); NaN where it is not known."""
        errors = np.full((len(self), 2), np.nan)
        if self.expected is not None:
            errors[self.reached] = self.expected.errors
        return errors

    @property
    def joint_corrections(self) -> Array:
        """What the true robot needs beside the nominal one, q - q_nominal, shape (N, m), [rad] or [m]."""
        return np.asarray(self.q - self.q_nominal)

    @property
    def pose_corrections(self) -> Array:
        """How far the pose to send is from the one wanted, shape (N, 2): position [m], angle [rad]."""
        return Matching(POSE, 1.0).misses(self.T_send, self.T_wanted)


def compensate(
    calibration: CalibrationValues | Robot,
    program: Program,
    *,
    nominal: Robot | None = None,
    tool: ArrayLike | str | None = None,
    frame: ArrayLike | str | None = None,
    tolerance: tuple[float, float] = (1e-8, 1e-8),
    non_geometric: bool | Payload = True,
    accept: bool = False,
) -> Commands:
    """What to command so that the true robot does what a program wants.

    Args:
        calibration: What the true robot is: a result, or a corrected robot.
        program: What is wanted.
        nominal: What its controller believes; may be left out with a `Calibration`.
        tool: What is to arrive: a pose in the tip, shape (4, 4) [m], or a position, shape (3,); or the name of a target
            of the calibration ("" for the only one), where the calibrated model has it; default the tip itself.
        frame: The base in the frame that poses are given and sent in, shape (4, 4) [m], or the name of a set-up of the
            calibration ("" for the only one); default the base.
        tolerance: What may be left of the error: position [m], angle [rad]; no less than 1e-9.
        non_geometric: Whether to use the non-geometric model, if there is one, else the geometry of the URDF; or
            the payload to use it with, in place of the one at its calibration.
        accept: Whether commands are made also where the verdict on the model that is used is ``do not use``.

    Raises:
        VerdictError: That verdict is ``do not use``, or a corrected robot's URDF states it, and it is not accepted.
        ModelError: A tool, frame or joint that does not exist, a program of another robot, or no nominal robot.
    """
    pair = pair_of(calibration, nominal, tool=tool, frame=frame, non_geometric=non_geometric)
    if not accept:
        _check_verdict(pair)
    robot = pair.nominal.robot
    count = len(robot.joint_names)
    tolerance = (max(tolerance[0], _EXACT), max(tolerance[1], _EXACT))
    usual = POSE if count >= 6 else AXIS if count == 5 else POSITION
    # Where all is reached the length that weighs an angle is one of scale: the arm's own.
    matching = Matching(program.match or (usual if program.oriented else POSITION), pair.reach)
    T_wanted, starts = _nominal(pair, program, matching)
    solved = solve(pair.actual, T_wanted, starts.q, matching, column_limits(robot))
    T_send, left_by_pose = _poses_to_send(pair, T_wanted, starts, solved, matching)
    before = Solved(starts.q, *pair.actual.motion(starts.q))
    left = matching.misses(solved.T_base_tool, T_wanted)
    reasons = _reasons(pair, matching, before, solved, ~_within(left, tolerance), left)
    reached = np.array([reason is None for reason in reasons])
    nominal_reaches = _within(matching.misses(starts.T_base_tool, T_wanted), _NOMINAL)
    commands = Commands(
        pair=pair,
        program=program,
        match=matching.name,
        T_wanted=read_only(pair.T_frame_base @ T_wanted),
        q_nominal=_where(nominal_reaches, starts.q),
        q=_where(reached, solved.q),
        T_send=_where(reached, pair.T_frame_base @ T_send),
        missed=_where(nominal_reaches, matching.misses(before.T_base_tool, T_wanted)),
        left=read_only(left),
        left_by_pose=_where(reached, left_by_pose),
        expected=expected_errors(pair, solved.q[reached])
        if pair.result and reached.any()
        else None,
        reasons=tuple(reasons),
        warnings=((),) * len(reasons),
    )
    return replace(commands, warnings=_warnings(commands, tolerance))


def _check_verdict(pair: Pair) -> None:
    """Refuse commands by a model whose verdict is ``do not use``; `VerdictError`."""
    if pair.result is None:
        source, stated = pair.actual.robot.urdf.source, pair.actual.robot.urdf.verdict
    else:
        judged = pair.result.verdict_on(non_geometric=pair.non_geometric)
        source = pair.result.source.name or "these measurements"
        against = judged is not None and judged.use == NO
        stated = f"{NO} (the summary() of the result says why)" if against else ""
    if stated:
        raise VerdictError(
            f"The verdict on {source} is: {stated}. No commands are made by it; accept=True (on the command line "
            "--accept) makes them nonetheless."
        )


def _within(misses: Array, allowed: tuple[float, float]) -> Mask:
    """Which misses (N, 2) [m], [rad] are small enough; an angle that is not matched is."""
    return np.asarray((misses[:, 0] <= allowed[0]) & ~(misses[:, 1] > allowed[1]))


def _nominal(pair: Pair, program: Program, matching: Matching) -> tuple[Array, Solved]:
    """The poses that are wanted, in the base, and the joint values that the nominal robot has for them.

    These are for the whole pose where one is given, and it can have one, also where less is matched: what is left free
    is to stay as the program has it.
    """
    nominal = pair.nominal
    if program.T_wanted is None:
        assert program.q is not None  # a program has one of them
        poses, twists = nominal.motion(program.q)
        return poses, Solved(program.q, poses, twists)
    T_wanted = rigid_inverse(pair.T_frame_base) @ program.T_wanted
    limits = column_limits(nominal.robot)
    whole = program.oriented and len(nominal.robot.joint_names) >= 6
    full = Matching(POSE, pair.reach) if whole else matching
    if program.q is not None:
        starts = solve(nominal, T_wanted, program.q, full, limits)
    else:
        starts = following(nominal, T_wanted, start_values(nominal.robot, program.start), full)
    lost = np.linalg.norm(full.error(starts.T_base_tool, T_wanted), axis=1) > _LOST
    if full.name != matching.name and lost.any():
        again = solve(nominal, T_wanted[lost], starts.q[lost], matching, limits)
        q = starts.q.copy()
        q[lost] = again.q
        starts = Solved(read_only(q), *nominal.motion(q))
    if not program.oriented:
        # What was not asked for is as the nominal robot has it, so that a pose to send can be compared with it.
        T_wanted[:, :3, :3] = starts.T_base_tool[:, :3, :3]
    return T_wanted, starts


def _poses_to_send(
    pair: Pair, T_wanted: Array, starts: Solved, solved: Solved, matching: Matching
) -> tuple[Array, Array]:
    """The poses to send (N, 4, 4), in the base [m], and how far the actual robot misses then, (N, 2) [m], [rad].

    The controller's own inverse kinematics q = q_nominal(T_send) is taken to stay near the joint values that it has for
    the wanted pose. A robot without a redundant joint then comes to the joint values that were meant. One with a
    redundant joint chooses where its elbow goes, and the pose is corrected for that choice, a few times over:

        T_send <- T_send exp(e),   e: what the actual robot still misses, along the tool's axes
    """
    controller = Matching(POSE, pair.reach)
    limits = column_limits(pair.nominal.robot)
    T_send = pair.nominal.poses(solved.q)
    arrived = np.empty_like(T_send)
    rows = np.arange(len(T_send))
    for _ in range(_TIMES):
        q = solve(pair.nominal, T_send[rows], starts.q[rows], controller, limits).q
        arrived[rows] = pair.actual.poses(q)
        error = matching.error(arrived[rows], T_wanted[rows])
        elsewhere = np.abs(q - solved.q[rows]).max(axis=1) > _ENOUGH
        worth = elsewhere & (np.linalg.norm(error, axis=1) > _ENOUGH)
        if not (worth.any() and len(pair.nominal.robot.joint_names) > controller.rows):
            break
        rows = rows[worth]
        twists = np.zeros((int(worth.sum()), 6))  # what is not matched stays
        twists[:, :3] = error[worth, :3]
        twists[:, 3 : error.shape[1]] = error[worth, 3:] / matching.length
        T_send[rows] = T_send[rows] @ [pin.exp6(twist).homogeneous for twist in twists]
    return T_send, matching.misses(arrived, T_wanted)


def _where(there: NDArray[np.bool_], values: Array) -> Array:
    """The values of some rows, the others NaN; read-only."""
    return read_only(np.where(there.reshape(-1, *[1] * (values.ndim - 1)), values, np.nan))


def _reasons(
    pair: Pair, matching: Matching, before: Solved, solved: Solved, far: Mask, left: Array
) -> list[Finding | None]:
    """For each row why it has no command: it lies in another branch, beyond a limit, or too ``far`` from its pose."""
    robot = pair.actual.robot
    low, high = column_limits(robot).T
    found: list[Finding | None] = [None] * len(left)
    if len(robot.joint_names) == matching.rows:
        # The determinant has turned its sign: a singularity was passed on the way.
        signs = [np.linalg.slogdet(matching.jacobian(one.twists))[0] for one in (before, solved)]
        for row in np.flatnonzero(signs[0] * signs[1] < 0):
            found[row] = Finding("other branch")
    beyond = np.maximum(low - solved.q, solved.q - high)
    for row in np.flatnonzero(beyond.max(axis=1) > _EXACT):
        joint = int(np.argmax(beyond[row]))
        value = float(solved.q[row, joint])
        bound = float(low[joint] if value < low[joint] else high[joint])
        found[row] = Finding("beyond limit", (value, bound), robot.joint_names[joint])
    for row in np.flatnonzero(far):
        found[row] = Finding("unreachable", tuple(left[row].tolist()))
    return found


def _warnings(
    commands: Commands, tolerance: tuple[float, float]
) -> tuple[tuple[Finding, ...], ...]:
    """For each row that is reached what to know of its command; ``tolerance``: what may be left [m], [rad]."""
    pair, program, robot = commands.pair, commands.program, commands.nominal
    rows = np.flatnonzero(commands.reached)
    q, q_nominal = commands.q[rows], commands.q_nominal[rows]
    found: list[list[Finding]] = [[] for _ in program.labels]
    if not len(rows):
        return tuple(map(tuple, found))

    def say(code: Code, which: Mask, sizes: Array, before: Sequence[str] = ()) -> None:
        """A warning of some rows: with both numbers of poses (2 columns), else with the joint of the largest."""
        for i in np.flatnonzero(which).tolist():
            numbers, name = sizes[i], ""
            if code not in ("large pose correction", "ambiguous pose"):
                joint = int(np.argmax(numbers))
                numbers, name = numbers[[joint]], robot.joint_names[joint]
            other = before[i] if before else ""
            found[rows[i]].append(Finding(code, tuple(numbers.tolist()), name, other))

    motion = Matching(commands.match, 1.0).jacobian(pair.actual.motion(q)[1])
    worst = 1e-3 * np.linalg.norm(np.linalg.pinv(motion, rcond=1e-12)[:, :, :3], axis=2)
    motion[:, :3] /= pair.reach
    smallest = np.linalg.svd(motion, compute_uv=False)[:, -1]
    say("near singularity", smallest < _NEAR_SINGULAR, worst)
    moved = commands.pose_corrections[rows]
    say("large pose correction", ~_within(moved, _POSE_LIMIT), moved)
    changes = np.abs(q - q_nominal)
    slides = [robot.joint_types[name] == "prismatic" for name in robot.joint_names]
    allowed = np.where(slides, *_JOINT_LIMIT[::-1])
    say("large joint correction", np.any(changes > allowed, axis=1), changes)
    # From the row before that has a command: others are passed over, as the robot does.
    last = np.maximum(np.arange(len(rows)) - 1, 0)
    planned, after = np.abs(q_nominal - q_nominal[last]), np.abs(q - q[last])
    T = commands.T_wanted[rows]
    close = (_CLOSE[0] * pair.reach, _CLOSE[1])
    near = _within(Matching(POSE, 1.0).misses(T[last], T), close)
    most = _STEP_FACTOR * planned.max(axis=1) + _STEP_MORE
    over = (near & (planned.max(axis=1) > _TURNED_OVER)) | (after.max(axis=1) > most)
    say("jump", over, after, [program.labels[rows[i]] for i in last])
    by_pose, left = commands.left_by_pose[rows], commands.left[rows]
    say("ambiguous pose", ~_within(by_pose - left, tolerance), by_pose)
    for outside in [] if pair.result is None else pair.result.outside_of_measured(q):
        for one in outside.beyond:
            far = Finding("outside measured range", (float(one.by),), one.joint)
            found[rows[outside.index]].append(far)
    return tuple(map(tuple, found))


def write_commands(
    commands: Commands,
    path: str | Path,
    *,
    send: Literal["both", "joints", "poses"] = "both",
    orientation: Literal["rotation-vector", "quaternion", "rpy"] = "rotation-vector",
    overwrite: bool = False,
) -> Path:
    """Write commands as a CSV table in deg and mm; docs/compensation.md describes it.

    First the columns of the program that went along, then joint values and poses to send, then by how much they were
    changed, then with a result the position error to expect, then ``ok`` or the codes of warnings or of the reason why
    a row has no command and its cells are empty.

    ``send`` says which of the two forms are written; a rotation vector is in rad.

    Raises:
        FileError: The file exists and ``overwrite`` is False, or it cannot be written.
    """
    robot, T_send = commands.nominal, commands.T_send
    names = robot.joint_names
    of_joints = ["mm" if robot.joint_types[name] == "prismatic" else "deg" for name in names]
    blocks: list[tuple[Sequence[str], Sequence[str], Array]] = []
    if send != "poses":
        blocks.append((names, of_joints, commands.q))
    if send != "joints":
        form, unit, numbers_of = _ORIENTATIONS[orientation]
        turned = np.full((len(T_send), len(form)), np.nan)
        for row in np.flatnonzero(commands.reached):
            turned[row] = numbers_of(T_send[row, :3, :3])
        blocks += [(POINT, ["mm"] * 3, T_send[:, :3, 3]), (form, [unit] * len(form), turned)]
    if send != "poses":
        blocks.append(([CORRECTION + n for n in names], of_joints, commands.joint_corrections))
    of_pose = (CORRECTION + "position", CORRECTION + "angle")
    blocks.append((of_pose, ("mm", "deg"), commands.pose_corrections))
    if commands.expected is not None:
        blocks.append(((EXPECTED,), ("mm",), commands.expected_errors[:, :1]))
    columns: list[Sequence[str]] = [(label, *cells) for label, cells in commands.program.kept]
    for headers, units, values in blocks:
        for name, symbol, column in zip(headers, units, values.T, strict=True):
            scale, digits = _UNITS[symbol]
            cells = (
                "" if math.isnan(value) else f"{round(value, digits) + 0.0:.{digits}f}"
                for value in (scale * column).tolist()
            )
            columns.append((f"{name} [{symbol}]" if symbol else name, *cells))
    status = []
    for reason, said in zip(commands.reasons, commands.warnings, strict=True):
        codes = "; ".join(dict.fromkeys(one.code for one in said))
        warned = f"warning: {codes}" if codes else "ok"
        status.append(f"no command: {reason.code}" if reason else warned)
    columns.append((STATUS, *status))
    return write_atomically(path, csv_bytes(zip(*columns, strict=True)), overwrite=overwrite)
