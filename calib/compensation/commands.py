"""Commands for a robot whose controller keeps its own model, such that the true robot arrives (paper, stage four).

The calibrated model says where the true robot stands, T_true(q), the nominal one what its controller believes,
T_nominal(q). For a wanted pose T of the tool:

    q:       T_true(q) = T               joint values to command, in the branch of the nominal solution
    T_send = T_nominal(q)                the pose to send: the controller's own inverse kinematics makes q of it

Both are the same command in two forms; for an arm with a redundant joint see `_poses_to_send`. Poses sent in
place of the wanted ones are known as fake targets. Source: Z. Roth, B. Mooring, B. Ravani, An overview of robot
calibration, 1987 ("compensation").
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from calib.compensation.inverse import (
    MATCHES,
    POSE,
    POSITION,
    WEIGHTED,
    Matching,
    Solved,
    following,
    solve,
    start_values,
)
from calib.compensation.nominal_actual import Pair, pair_of
from calib.compensation.program import CORRECTION, Program
from calib.compensation.warnings import Warned, reasons_of, warnings_of, within
from calib.data.checks import to_quaternions
from calib.data.ranges import column_limits
from calib.data.table import POINT, QUATERNION, ROLL_PITCH_YAW, ROTATION_VECTOR, STATUS
from calib.errors import ModelError, choices
from calib.files import write_atomically
from calib.result.calibration import Calibration
from calib.robot.robot import Robot, read_only, rigid_inverse
from calib.robot.torques import Payload

__all__ = ["MATCHES", "Commands", "commands", "write_commands"]

Array = NDArray[np.float64]

#: A pose that the nominal robot misses by more is matched in part [m]; by less it reaches it [m], [rad].
_LOST = 1e-6
_NOMINAL = (_LOST, 1e-6)

#: Less than this is rounding [m], [rad].
_EXACT = 1e-9

#: The nominal robot differs from the actual one by a hundredth at most, so that each time two digits are won.
_TIMES = 6

#: The length that an angle counts as where nothing is said, and with another controller; below the last there is
#: nothing to correct [m].
_LEVER, _SHORT, _ENOUGH = 0.01, 0.01, 1e-12

#: What may be written of a command, and how an orientation may be.
SEND = ("both", "joints", "poses")
ORIENTATIONS = ("rotation-vector", "quaternion", "rpy")

#: The units of a table, of angles and of lengths: symbol, how many are one in SI units, decimals. Angles are exact to
#: 1e-11 rad, lengths to 1e-9 m, on any arm far below what a controller resolves. A vector is in radians in both.
_DEG, _RAD = ("deg", math.degrees(1.0), 9), ("rad", 1.0, 12)
_MM, _M, _PLAIN = ("mm", 1e3, 6), ("m", 1.0, 9), ("", 1.0, 12)
UNITS = {"deg mm": (_DEG, _MM), "rad m": (_RAD, _M)}
_Unit = tuple[str, float, int]


@dataclass(frozen=True, slots=True, eq=False)
class Commands:
    """What to command so that the true robot does what a program wants; rows that cannot be reached are NaN.

    Attributes:
        nominal: The robot as its controller has it.
        program: What was asked for.
        match: One of `MATCHES`.
        T_frame_base: shape (4, 4), the base in the frame that poses are given and sent in [m].
        T_tip_tool: shape (4, 4), the tool in the true robot's tip [m].
        T_tip_tool_nominal: shape (4, 4), the tool that the controller is to be set to [m]; another one only if the tool
            is a target that the calibration found elsewhere than was said.
        T_wanted: shape (N, 4, 4), pose of the tool that is wanted, in that frame [m]; where only its position was
            given, oriented as the nominal robot's is.
        q_nominal: shape (N, m), joint values that the nominal model has for it [rad] or [m].
        q: shape (N, m), joint values to command [rad] or [m].
        T_send: shape (N, 4, 4), pose to send to a controller with the nominal model, in that frame [m].
        missed: shape (N, 2), how far the true robot would miss at ``q_nominal``, as the calibrated model predicts:
            position [m], angle [rad]. Of the position alone the angle is NaN.
        left: shape (N, 2), how far it misses at ``q`` [m], [rad]: what cannot be reached.
        left_by_pose: shape (N, 2), how far it misses if ``T_send`` is sent, to a controller that stays near
            ``q_nominal`` [m], [rad].
        std: shape (N, 2), how sure it is where the true robot arrives, as far as the covariance of the geometry knows:
            position [m], angle [rad]. NaN where nothing is known, as of two robots without a result.
        result: The calibration; None where two robots were given.
        reasons: Why a row has no command; empty where it has one.
        warnings: For each row what to know of its command; mostly nothing. ``str()`` of one is its text.
    """

    nominal: Robot
    program: Program
    match: str
    T_frame_base: Array
    T_tip_tool: Array
    T_tip_tool_nominal: Array
    T_wanted: Array
    q_nominal: Array
    q: Array
    T_send: Array
    missed: Array
    left: Array
    left_by_pose: Array
    std: Array
    result: Calibration | None
    reasons: tuple[str, ...]
    warnings: tuple[tuple[Warned, ...], ...]

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.q)

    @property
    def reached(self) -> NDArray[np.bool_]:
        """Which rows have a command, shape (N,)."""
        return np.array([not reason for reason in self.reasons])

    @property
    def joint_corrections(self) -> Array:
        """What the true robot needs beside the nominal one, q - q_nominal, shape (N, m), [rad] or [m]."""
        return np.asarray(self.q - self.q_nominal)

    @property
    def pose_corrections(self) -> Array:
        """How far the pose to send is from the one wanted, shape (N, 2): position [m], angle [rad]."""
        return Matching(POSE, 1.0).misses(self.T_send, self.T_wanted)


def commands(
    calibration: Calibration | Robot,
    program: Program,
    *,
    nominal: Robot | None = None,
    tool: ArrayLike | str | None = None,
    frame: ArrayLike | str | None = None,
    match: str | None = None,
    lever: float | None = None,
    start: Mapping[str, float] | None = None,
    limit: tuple[float, float] = (0.01, math.radians(2.0)),
    accept: tuple[float, float] = (1e-8, 1e-8),
    larger: bool = True,
    payload: Payload | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Commands:
    """What to command so that the true robot does what a program wants.

    Args:
        calibration: What the true robot is: a result, a result that was read, or a corrected robot.
        program: What is wanted.
        nominal: What its controller believes; may be left out with a `Calibration`.
        tool: What is to arrive: a pose in the tip, shape (4, 4) [m], or a position, shape (3,); or the name of a target
            of the calibration ("" for the only one), where the calibrated model has it; default the tip itself.
        frame: The base in the frame that poses are given and sent in, shape (4, 4) [m], or the name of a set-up of the
            calibration ("" for the only one); default the base.
        match: One of `MATCHES`; default ``"pose"``, for fewer than six joints ``"weighted"``, for a program of points
            ``"position"``.
        lever: With ``"weighted"``, the length that an angle of one radian counts as [m]; default 0.01.
        start: Joint values by name [rad] or [m], which the first of a program of poses alone starts near; joints that
            are not named start at the middle of their limits.
        limit: Corrections of the pose larger than this are warned of: position [m], angle [rad].
        accept: What may be left of the error: position [m], angle [rad]; no less than 1e-9. With ``"weighted"`` a
            position may be left that is as large as ``limit``, and any angle.
        larger: Whether to use the larger model, where there is one; else the geometry that the URDF holds.
        payload: What the tip carries; None: what it carried when it was calibrated.
        progress: Called with the number of rows done and of all, where joint values have to be looked for.

    Raises:
        ModelError: A tool, frame, match or joint that does not exist, a program of another robot, or no nominal robot.
    """
    pair = pair_of(calibration, nominal, tool=tool, frame=frame, larger=larger, payload=payload)
    robot = pair.nominal.robot
    # What is matched where nothing is said.
    usual = POSE if len(robot.joint_names) >= 6 else WEIGHTED
    name = match or (usual if program.oriented else POSITION)
    # Where all is reached the lever is one of scale, and the arm's own length is the scale.
    scale = (_LEVER if lever is None else lever) if name == WEIGHTED else pair.reach
    matching = Matching(name, scale)
    _check(program, robot, matching, lever, start)
    for what, sizes in (("be left", accept), ("be corrected without a warning", limit)):
        if not all(size >= 0.0 for size in sizes):  # NaN is not, infinity is
            raise ModelError(
                f"What may {what} is {sizes[0]} m and {sizes[1]} rad; both must be 0 or more."
            )
    accept = (max(accept[0], _EXACT), max(accept[1], _EXACT))
    T_wanted, starts = _nominal(pair, program, matching, start_values(robot, start), progress)
    solved = solve(pair.actual, T_wanted, starts.q, matching, column_limits(robot))
    T_send, left_by_pose = _poses_to_send(pair, T_wanted, starts, solved, matching)
    before = Solved(starts.q, *pair.actual.motion(starts.q))
    missed = matching.misses(before.T_base_tool, T_wanted)
    left = matching.misses(solved.T_base_tool, T_wanted)
    weighted = (limit[0], math.inf) if name == WEIGHTED else None
    reasons = reasons_of(pair, matching, before, solved, left, weighted or accept)
    reached = np.array([not reason for reason in reasons])
    nominal_reaches = within(matching.misses(starts.T_base_tool, T_wanted), weighted or _NOMINAL)
    warnings = warnings_of(
        pair,
        program,
        matching,
        T_wanted,
        starts,
        solved,
        reached=reached,
        nominal_reaches=nominal_reaches,
        missed=missed,
        left=left,
        left_by_pose=left_by_pose,
        accept=accept,
        limit=limit,
    )
    return Commands(
        nominal=robot,
        program=program,
        match=name,
        T_frame_base=pair.T_frame_base,
        T_tip_tool=pair.actual.T_tip_tool,
        T_tip_tool_nominal=pair.nominal.T_tip_tool,
        T_wanted=read_only(pair.T_frame_base @ T_wanted),
        q_nominal=_where(nominal_reaches, starts.q),
        q=_where(reached, solved.q),
        T_send=_where(reached, pair.T_frame_base @ T_send),
        missed=_where(nominal_reaches, missed),
        left=read_only(left),
        left_by_pose=_where(reached, left_by_pose),
        std=_where(reached, pair.std(solved.q)),
        result=pair.result,
        reasons=tuple(reasons),
        warnings=warnings,
    )


def _check(
    program: Program,
    robot: Robot,
    matching: Matching,
    lever: float | None,
    start: Mapping[str, float] | None,
) -> None:
    """Refuse a program that the robot or the matching has no use for, and what the program has none for."""
    if program.q is not None and program.q.shape[1] != len(robot.joint_names):
        raise ModelError(
            f"The program has {program.q.shape[1]} joint values in each row; '{robot.name}' has "
            f"{len(robot.joint_names)} joints from '{robot.base}' to '{robot.tip}': {choices(robot.joint_names)}."
        )
    if not program.oriented and matching.name != POSITION:
        raise ModelError(
            f"The program says where the tool is to be and not how it is turned, so that '{matching.name}' cannot be "
            f"matched. Match '{POSITION}', or give orientations."
        )
    if start and program.q is not None:
        raise ModelError(
            "The program has joint values to start at in each row, so that a start for the first row has no use. "
            "Leave it out."
        )
    if lever is not None and matching.name != WEIGHTED:
        raise ModelError(
            f"A lever is for '{WEIGHTED}', where an angle is weighed against a position, and here '{matching.name}' is "
            "matched. Leave it out."
        )


def _nominal(
    pair: Pair,
    program: Program,
    matching: Matching,
    start: Array,
    progress: Callable[[int, int], None] | None,
) -> tuple[Array, Solved]:
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
        starts = following(nominal, T_wanted, start, full, progress)
    lost = np.linalg.norm(full.error(starts.T_base_tool, T_wanted), axis=1) > _LOST
    if full.name != matching.name and lost.any():
        again = solve(nominal, T_wanted[lost], starts.q[lost], matching, limits)
        q = starts.q.copy()
        q[lost] = again.q
        starts = Solved(read_only(q), *nominal.motion(q))
    if not program.oriented:
        # What was not asked for is as the nominal robot has it, so that a pose to send can be held against it.
        T_wanted[:, :3, :3] = starts.T_base_tool[:, :3, :3]
    return T_wanted, starts


def _poses_to_send(
    pair: Pair, T_wanted: Array, starts: Solved, solved: Solved, matching: Matching
) -> tuple[Array, Array]:
    """The poses to send, and how far the actual robot misses with what the controller makes of them.

    The controller's own inverse kinematics q = q_nominal(T_send) is taken to stay near the joint values that it has for
    the wanted pose. A robot without a redundant joint then comes to the joint values that were meant. One with a
    redundant joint chooses where its elbow goes, and the pose is corrected for that choice, a few times over:

        T_send <- T_send exp(e),   e: what the actual robot still misses, along the tool's axes

    Returns:
        shape (N, 4, 4), in the base [m]; and shape (N, 2), position [m] and angle [rad].
    """
    controller, another = (Matching(POSE, lever) for lever in (pair.reach, _SHORT))
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
        twists[:, 3 : error.shape[1]] = error[worth, 3:] / matching.lever
        T_send[rows] = T_send[rows] @ [pin.exp6(twist).homogeneous for twist in twists]
    # Next to a singularity it is up to the controller where it ends: one that weighs angles otherwise may differ.
    q = solve(pair.nominal, T_send, starts.q, another, limits).q
    misses = (matching.misses(T, T_wanted) for T in (arrived, pair.actual.poses(q)))
    return T_send, read_only(np.maximum(*misses))


def _where(there: NDArray[np.bool_], values: Array) -> Array:
    """The values of some rows, the others NaN; read-only."""
    return read_only(np.where(there.reshape(-1, *[1] * (values.ndim - 1)), values, np.nan))


def write_commands(
    commands: Commands,
    path: str | Path,
    *,
    send: str = "both",
    orientation: str = "rotation-vector",
    units: str = "deg mm",
    overwrite: bool = False,
) -> Path:
    """Write commands as a CSV table; docs/compensation.md describes it.

    First the columns of the program that went along, then joint values and poses to send, then by how much they were
    changed, then whether the row has a command. A row without one has empty cells there.

    Args:
        commands: The commands.
        path: A CSV file.
        send: One of `SEND`: joint values, poses for a controller with the nominal model, or both.
        orientation: One of `ORIENTATIONS`, of the poses.
        units: One of `UNITS`.
        overwrite: Whether a file that exists is replaced.

    Raises:
        ModelError: No such way to send, no such form of an orientation, or no such units.
        FileError: The file exists and ``overwrite`` is False, or it cannot be written.
    """
    for what, given, known in (
        ("send", send, SEND),
        ("orientation", orientation, ORIENTATIONS),
        ("units", units, tuple(UNITS)),
    ):
        if given not in known:
            raise ModelError(
                f"Commands cannot be written with {what} '{given}'; choose one of {choices(known)}."
            )
    robot, (angle, length) = commands.nominal, UNITS[units]
    names = robot.joint_names
    of_joints = [length if robot.joint_types[name] == "prismatic" else angle for name in names]
    changed = [CORRECTION + name for name in names]
    T_send = commands.T_send
    joints = [(names, of_joints, commands.q)] * (send != "poses")
    poses = [(POINT, [length] * 3, T_send[:, :3, 3]), _turns(T_send, orientation, angle)]
    corrections = [(changed, of_joints, commands.joint_corrections)] * (send != "poses")
    of_pose = ((CORRECTION + "position", CORRECTION + "angle"), (length, angle))
    blocks: list[tuple[Sequence[str], Sequence[_Unit], Array]] = [
        *joints, *poses * (send != "joints"), *corrections, (*of_pose, commands.pose_corrections),
    ]  # fmt: skip
    columns: list[Sequence[str]] = [(label, *cells) for label, cells in commands.program.kept]
    for headers, own, values in blocks:
        for name, (symbol, scale, digits), column in zip(headers, own, values.T, strict=True):
            label = f"{name} [{symbol}]" if symbol else name
            columns.append((label, *(_number(v, digits) for v in (scale * column).tolist())))
    columns.append((STATUS, *map(_status, commands.reasons, commands.warnings)))
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(zip(*columns, strict=True))
    return write_atomically(path, text.getvalue().encode(), overwrite=overwrite)


def _turns(T: Array, form: str, angle: _Unit) -> tuple[Sequence[str], Sequence[_Unit], Array]:
    """The rotations of poses (N, 4, 4) in one of `ORIENTATIONS`: names, units, values; NaN stays NaN."""
    R = T[:, :3, :3]
    if form == "quaternion":
        return QUATERNION, [_PLAIN] * 4, to_quaternions(R)
    there = np.isfinite(R).all(axis=(1, 2))
    values = np.full((len(R), 3), np.nan)
    if form == "rpy":
        values[there] = np.reshape([pin.rpy.matrixToRpy(matrix) for matrix in R[there]], (-1, 3))
        return ROLL_PITCH_YAW, [angle] * 3, values
    if there.any():
        values[there] = Rotation.from_matrix(R[there]).as_rotvec()
    return ROTATION_VECTOR, [_RAD] * 3, values


def _number(value: float, digits: int) -> str:
    """One number as text, without a sign before zero; empty for NaN."""
    if not math.isfinite(value):
        return ""
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def _status(reason: str, warnings: tuple[Warned, ...]) -> str:
    """What the last column says of a row."""
    if reason:
        return f"no command: {reason}"
    return f"warning: {'; '.join(map(str, warnings))}" if warnings else "ok"
