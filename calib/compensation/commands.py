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

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

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
from calib.compensation.program import CORRECTION, Program
from calib.compensation.warnings import Attempt, Finding, reasons_of, warnings_of
from calib.data.checks import to_quaternions
from calib.data.table import POINT, QUATERNION, ROLL_PITCH_YAW, ROTATION_VECTOR, STATUS
from calib.errors import ModelError, choices
from calib.files import write_atomically
from calib.result.calibration import Calibration
from calib.robot.readback import column_limits
from calib.robot.robot import Payload, Robot, read_only, rigid_inverse

Array = NDArray[np.float64]

#: A pose that the nominal robot misses by more is matched in part [m].
_LOST = 1e-6

#: Less than this is rounding [m], [rad].
_EXACT = 1e-9

#: The nominal robot differs from the actual one by a hundredth at most, so that each time two digits are won.
_TIMES = 6

#: The length that an angle weighs as with another controller; below the second there is nothing to correct [m].
_SHORT, _ENOUGH = 0.01, 1e-12

#: The units of a table: symbol, how many are one in SI units, decimals. Angles are exact to 1e-11 rad, lengths to
#: 1e-9 m, on any arm far below what a controller resolves.
_Unit = tuple[str, float, int]
_DEG, _RAD, _MM, _PLAIN = (
    ("deg", math.degrees(1.0), 9),
    ("rad", 1.0, 12),
    ("mm", 1e3, 6),
    ("", 1.0, 12),
)


@dataclass(frozen=True, slots=True, eq=False)
class Commands:
    """What to command so that the true robot does what a program wants; rows that cannot be reached are NaN.

    Attributes:
        pair: The robot as its controller has it and the actual one, their tools, and the frame of the poses.
        program: What was asked for.
        match: What of the poses is reached, one of `calib.compensation.inverse.MATCHES`.
        T_wanted: shape (N, 4, 4), pose of the tool that is wanted, in the frame of the poses [m]; where only its
            position was given, oriented as the nominal robot's is.
        q_nominal: shape (N, m), joint values that the nominal model has for it [rad] or [m].
        q: shape (N, m), joint values to command [rad] or [m].
        T_send: shape (N, 4, 4), pose to send to a controller with the nominal model, in that frame [m].
        missed: shape (N, 2), how far the true robot would miss at ``q_nominal``, as the calibrated model predicts:
            position [m], angle [rad]. Of the position alone the angle is NaN.
        left: shape (N, 2), how far it misses at ``q`` [m], [rad]: what cannot be reached.
        left_by_pose: shape (N, 2), how far it misses if ``T_send`` is sent, to a controller that stays near
            ``q_nominal`` [m], [rad].
        std: shape (N, 2), standard deviation of where the true robot arrives, by the covariance of the geometry:
            position [m], angle [rad]. NaN where nothing is known, as of two robots without a result.
        reasons: Why a row has no command; None where it has one.
        warnings: For each row what to know of its command; mostly nothing.
    """

    pair: Pair
    program: Program
    match: str
    T_wanted: Array
    q_nominal: Array
    q: Array
    T_send: Array
    missed: Array
    left: Array
    left_by_pose: Array
    std: Array
    reasons: tuple[Finding | None, ...]
    warnings: tuple[tuple[Finding, ...], ...]

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
    def joint_corrections(self) -> Array:
        """What the true robot needs beside the nominal one, q - q_nominal, shape (N, m), [rad] or [m]."""
        return np.asarray(self.q - self.q_nominal)

    @property
    def pose_corrections(self) -> Array:
        """How far the pose to send is from the one wanted, shape (N, 2): position [m], angle [rad]."""
        return Matching(POSE, 1.0).misses(self.T_send, self.T_wanted)


def compensate(
    calibration: Calibration | Robot,
    program: Program,
    *,
    nominal: Robot | None = None,
    tool: ArrayLike | str | None = None,
    frame: ArrayLike | str | None = None,
    accept: tuple[float, float] = (1e-8, 1e-8),
    larger: bool | Payload = True,
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
        accept: What may be left of the error: position [m], angle [rad]; no less than 1e-9.
        larger: Whether to use the non-geometric model, where there is one, else the geometry that the URDF holds; or
            the payload to use it with, in place of the one at its calibration.

    Raises:
        ModelError: A tool, frame or joint that does not exist, a program of another robot, or no nominal robot.
    """
    pair = pair_of(calibration, nominal, tool=tool, frame=frame, larger=larger)
    robot = pair.nominal.robot
    count = len(robot.joint_names)
    if program.q is not None and program.q.shape[1] != count:
        raise ModelError(
            f"The program has {program.q.shape[1]} joint values in each row; '{robot.name}' has {count} joints from "
            f"'{robot.base}' to '{robot.tip}': {choices(robot.joint_names)}."
        )
    if not all(size >= 0.0 for size in accept):  # NaN is not, infinity is
        raise ModelError(
            f"The accepted error is {accept[0]} m and {accept[1]} rad; give 0 or more."
        )
    accept = (max(accept[0], _EXACT), max(accept[1], _EXACT))
    usual = POSE if count >= 6 else AXIS if count == 5 else POSITION
    # Where all is reached the length that weighs an angle is one of scale: the arm's own.
    matching = Matching(program.match or (usual if program.oriented else POSITION), pair.reach)
    T_wanted, starts = _nominal(pair, program, matching)
    solved = solve(pair.actual, T_wanted, starts.q, matching, column_limits(robot))
    T_send, left_by_pose = _poses_to_send(pair, T_wanted, starts, solved, matching)
    before = Solved(starts.q, *pair.actual.motion(starts.q))
    found = Attempt(pair, program, matching, T_wanted, starts, before, solved, left_by_pose)
    reasons = reasons_of(found, accept)
    reached = np.array([reason is None for reason in reasons])
    nominal_reaches = found.nominal_reaches
    return Commands(
        pair=pair,
        program=program,
        match=matching.name,
        T_wanted=read_only(pair.T_frame_base @ T_wanted),
        q_nominal=_where(nominal_reaches, starts.q),
        q=_where(reached, solved.q),
        T_send=_where(reached, pair.T_frame_base @ T_send),
        missed=_where(nominal_reaches, found.misses(before)),
        left=read_only(found.misses(solved)),
        left_by_pose=_where(reached, left_by_pose),
        std=_where(reached, pair.std(solved.q)),
        reasons=tuple(reasons),
        warnings=warnings_of(found, reached, accept),
    )


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
    controller, another = (Matching(POSE, length) for length in (pair.reach, _SHORT))
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
    send: Literal["both", "joints", "poses"] = "both",
    orientation: Literal["rotation-vector", "quaternion", "rpy"] = "rotation-vector",
    overwrite: bool = False,
) -> Path:
    """Write commands as a CSV table in deg and mm; docs/compensation.md describes it.

    First the columns of the program that went along, then joint values and poses to send, then by how much they were
    changed, then ``ok`` or the codes of warnings or of the reason why a row has no command and its cells are empty.

    ``send`` says which of the two forms are written; a rotation vector is in rad.

    Raises:
        FileError: The file exists and ``overwrite`` is False, or it cannot be written.
    """
    robot, T_send = commands.nominal, commands.T_send
    names = robot.joint_names
    of_joints = [_MM if robot.joint_types[name] == "prismatic" else _DEG for name in names]
    blocks: list[tuple[Sequence[str], Sequence[_Unit], Array]] = []
    if send != "poses":
        blocks.append((names, of_joints, commands.q))
    if send != "joints":
        blocks.append((POINT, [_MM] * 3, T_send[:, :3, 3]))
        blocks.append(_orientations(T_send[:, :3, :3], orientation))
    if send != "poses":
        blocks.append(([CORRECTION + n for n in names], of_joints, commands.joint_corrections))
    of_pose = (CORRECTION + "position", CORRECTION + "angle")
    blocks.append((of_pose, (_MM, _DEG), commands.pose_corrections))
    columns: list[Sequence[str]] = [(label, *cells) for label, cells in commands.program.kept]
    for headers, units, values in blocks:
        for name, (symbol, scale, digits), column in zip(headers, units, values.T, strict=True):
            label = f"{name} [{symbol}]" if symbol else name
            columns.append((label, *(_number(v, digits) for v in (scale * column).tolist())))
    status = []
    for reason, said in zip(commands.reasons, commands.warnings, strict=True):
        codes = "; ".join(dict.fromkeys(one.code for one in said))
        warned = f"warning: {codes}" if codes else "ok"
        status.append(f"no command: {reason.code}" if reason else warned)
    columns.append((STATUS, *status))
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(zip(*columns, strict=True))
    return write_atomically(path, text.getvalue().encode(), overwrite=overwrite)


def _orientations(R: Array, form: str) -> tuple[Sequence[str], Sequence[_Unit], Array]:
    """Rotations (N, 3, 3) in some form: names, units, values; NaN stays NaN."""
    if form == "quaternion":
        return QUATERNION, [_PLAIN] * 4, to_quaternions(R)
    there = np.isfinite(R).all(axis=(1, 2))
    values = np.full((len(R), 3), np.nan)
    if form == "rpy":
        values[there] = np.reshape([pin.rpy.matrixToRpy(matrix) for matrix in R[there]], (-1, 3))
        return ROLL_PITCH_YAW, [_DEG] * 3, values
    if there.any():
        values[there] = Rotation.from_matrix(R[there]).as_rotvec()
    return ROTATION_VECTOR, [_RAD] * 3, values


def _number(value: float, digits: int) -> str:
    """One number as text, without a sign before zero; empty for NaN."""
    if not math.isfinite(value):
        return ""
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text
