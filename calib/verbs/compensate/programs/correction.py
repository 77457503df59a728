"""The correction of a program: the numbers of its targets such that the true robot goes where the nominal one would.

With the commands of `calib.verbs.compensate.compensate` for the nominal joint values of each motion, q to T_send,

    joint values:  q' = q_written + (q - q_nominal)
    a pose:        T_frame_tool' = T_frame_tool inv(T_nominal(q_nominal)) T_send

where both poses of the nominal robot are those of the motion's tool in the base. The difference of two poses of one
model is exactly nothing where nothing is corrected, so that the text then stays as it is to the last byte.

A target that several motions go to has one set of numbers. Their corrections differ with the tool, the frame, or the
side from which a joint with lost motion comes. The mean of them is taken if that leaves no more than half of the error
at each of the motions; otherwise the target is left as it is.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, Integers, Mask, read_only, rigid_inverse
from calib.basics.values import Value
from calib.data.inputs import RobotInput
from calib.errors import MeasurementError, choices
from calib.numerics.geometry import to_matrices, to_rotation_vectors
from calib.numerics.moves import last_moves
from calib.result.calibration import Calibration
from calib.robot.gravity import Payload
from calib.robot.robot import Robot
from calib.verbs.compensate.commands import Commands, CommandWarning
from calib.verbs.compensate.compensate import compensate
from calib.verbs.compensate.expected import expected_errors
from calib.verbs.compensate.inverse import POSE, Matching
from calib.verbs.compensate.programs.nearest_numbers import nearest_numbers
from calib.verbs.compensate.programs.nominal_values import (
    contents_of,
    nominal_values,
    pose_of,
    values_of,
)
from calib.verbs.compensate.programs.number_text import (
    decimals_for,
    in_column,
    written_integer,
    written_number,
)
from calib.verbs.compensate.programs.program_file import (
    Left,
    NumberText,
    ProgramFile,
    ProgramText,
    Target,
)
from calib.verbs.compensate.robot_program import Program

#: A target that is moved by less stays as it is written [m], [rad]: rounding.
_EXACT = 1e-9

#: Motions whose corrections differ by less from their mean need the same numbers [m], [rad].
_ALIKE = 5e-6

#: The largest share of a motion's error that the mean of several corrections may leave.
_LARGEST_SHARE = 0.5

#: A radian counts as this length, where errors are compared [m].
_LENGTH = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class CorrectedProgram(Value):
    """A program, corrected in the numbers of its targets."""

    #: As it was read.
    program: ProgramFile
    #: Its texts with the new numbers, in the order of ``program.texts``.
    texts: tuple[ProgramText, ...]
    #: Commands of the motions, one for each tool, in the order in which the program takes them up.
    commands: tuple[Commands, ...]
    #: The motions that each of them has rows for, in their order, as indices of ``program.moves``.
    rows: tuple[Integers, ...]
    #: Why a motion has no command; None if it has one, or is among ``left``. N motions.
    reasons: tuple[CommandWarning | None, ...]
    #: Warnings about each of the N motions.
    warnings: tuple[tuple[CommandWarning, ...], ...]
    #: All that stays as it is: what the reader names, and targets of which no solution, or no one set of numbers, is
    #: right.
    left: tuple[Left, ...]
    #: shape (N, 2), how far each motion's pose is moved [m], [rad]; NaN where the target stays because it must.
    corrections: Array
    #: shape (N, 2), expected error at each motion [m], [rad]; NaN where it is not known.
    expected_errors: Array
    #: shape (N, 2), how far each motion's pose is from the one it needs, because others share its target [m], [rad].
    shared: Array
    #: shape (N, 2), how far it is from that because of the digits that are written [m], [rad].
    rounded: Array

    @property
    def is_corrected(self) -> Mask:
        """Mask of the N motions whose target is as the true robot needs it, shape (N,)."""
        return np.isfinite(self.corrections[:, 0])


def corrected(
    program: ProgramFile,
    nominal: Robot,
    calibration: Calibration | RobotInput,
    *,
    start: Mapping[str, float] | None = None,
    tolerance: tuple[float, float] = (1e-8, 1e-8),
    non_geometric: bool | Payload = True,
    accept: bool = False,
) -> CorrectedProgram:
    """Correct the targets of a program so that the true robot goes where the nominal robot would.

    Args:
        program: The program, as the reader of its dialect returns it.
        nominal: The robot as its controller has it, in the controller's base.
        calibration: The model of the true robot, see `calib.verbs.compensate.compensate.compensate`.
        start: Joint values by name [rad] or [m] at which the program begins; None: its first target says.
        tolerance: Error that a motion may keep: position [m], angle [rad].
        non_geometric: Whether to use the non-geometric model, or the payload to use it with.
        accept: Whether the program is corrected even if the verdict on the model is ``do not use``.

    Returns:
        The corrected texts, and what happened to each motion. A target that cannot be reached stays as it is.

    Raises:
        MeasurementError: No motion can be corrected, or where the arm is at the first pose is not known.
        VerdictError: That verdict is ``do not use``, and it is not accepted.
        ModelError: Models that do not fit each other, or a start that does not fit the robot.
    """
    if not program.moves:
        why = choices(sorted({item.code for item in program.left}))
        raise MeasurementError(
            f"{program.texts[0].path}: the program has no motion that can be corrected"
            + (f" ({why}, see docs/programs.md)." if why else ".")
        )
    values = nominal_values(nominal, program, start)
    known = np.flatnonzero([missing is None for missing in values.missing])
    if not len(known):
        codes = choices(sorted({missing for missing in values.missing if missing is not None}))
        raise MeasurementError(
            f"{program.texts[0].path}: the nominal robot has joint values for none of the {len(values.missing)} "
            f"motions ({codes}, see docs/programs.md). Check the tools and frames (--tool, --frame), and that the "
            "robot's base, zeros and signs are those of the controller."
        )
    N = len(program.moves)
    reasons: list[CommandWarning | None] = [None] * N
    left = list(program.left)
    for i, missing in enumerate(values.missing):
        if missing == "unreachable":
            reasons[i] = CommandWarning("unreachable")
        elif missing == "configuration":
            move = program.moves[i]
            left.append(Left(move.file, move.line, missing, program.targets[move.target].name))

    # The commands of each tool, and what the motions need by them.
    commands, rows = [], []
    warnings: list[tuple[CommandWarning, ...]] = [()] * N
    expected = np.full((N, 2), np.nan)
    q = np.full(values.q.shape, np.nan)
    T_written, T_needed = np.full((2, N, 4, 4), np.nan)
    for one, of_tool in _commands_by_tool(
        program, nominal, calibration, values.q, known, tolerance, non_geometric, accept
    ):
        commands.append(one)
        rows.append(of_tool)
        q[of_tool], expected[of_tool] = one.q, one.expected_errors
        T_written[of_tool] = one.pair.nominal.poses(values.q[of_tool])
        T_needed[of_tool] = one.T_send
        for i, reason, of_row in zip(of_tool.tolist(), one.reasons, one.warnings, strict=True):
            reasons[i], warnings[i] = reason, of_row

    # What each target becomes: a pose in its frame, or joint values.
    T_change = rigid_inverse(T_written) @ T_needed
    contents = contents_of(program.targets)
    edits = _Edits(program.texts)
    results: dict[int, _Result] = {}
    for number, moves in _moves_by_target(program).items():
        target = program.targets[number]
        if not np.isfinite(q[moves]).all():
            continue  # a motion to it has no command
        written = contents[number]
        needed = q[moves] if target.convention is None else written @ T_change[moves]
        mean = _common(written, needed)
        turns = _dependent(program, target, moves, values.q, q)
        if mean is None or turns is None:
            first = program.moves[moves[0]]
            left.append(Left(first.file, first.line, "shared", target.name))
            continue
        if not turns and _leaves_configuration(program, target, moves, values.q, q):
            first = program.moves[moves[0]]
            left.append(Left(first.file, first.line, "configuration", target.name))
            continue
        final = edits.write(target, mean, written, nominal)
        for dependent, new in turns:
            edits.replace(
                target.file, dependent, written_integer(edits.old(target, dependent), new)
            )
        for i, of_move in zip(moves, needed, strict=True):
            results[i] = _Result(of_move, mean, final)

    corrections, shared, rounded = np.full((3, N, 2), np.nan)
    matching = Matching(POSE, 1.0)
    for one, of_tool in zip(commands, rows, strict=True):
        done = [i for i in of_tool.tolist() if i in results]
        written = _poses(one, [contents[program.moves[i].target] for i in done])
        needed = _poses(one, [results[i].needed for i in done])
        mean = _poses(one, [results[i].mean for i in done])
        final = _poses(one, [results[i].final for i in done])
        corrections[done] = matching.misses(written, final)
        shared[done] = matching.misses(mean, needed)
        rounded[done] = matching.misses(final, mean)
    return CorrectedProgram(
        program=program,
        texts=edits.texts(),
        commands=tuple(commands),
        rows=tuple(rows),
        reasons=tuple(reasons),
        warnings=tuple(warnings),
        left=tuple(sorted(left, key=lambda item: (item.file, item.line))),
        corrections=read_only(corrections),
        expected_errors=read_only(expected),
        shared=read_only(shared),
        rounded=read_only(rounded),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Result:
    """A corrected target: as one of its motions needs it, as all need it, and as it is written."""

    #: Each a pose in the target's frame, shape (4, 4) [m], or joint values, shape (m,), [rad] or [m].
    needed: Array
    mean: Array
    final: Array


def _commands_by_tool(
    program: ProgramFile,
    nominal: Robot,
    calibration: Calibration | RobotInput,
    q_nominal: Array,
    known: Integers,
    tolerance: tuple[float, float],
    non_geometric: bool | Payload,
    accept: bool,
) -> Iterator[tuple[Commands, Integers]]:
    """Yield commands of the motions whose nominal joint values (N, m) are known, for each tool, and their indices.

    Where a joint stops may depend on its last move. Then each tool has commands of all motions in their order, of which
    those with another tool are left out afterwards.
    """
    by_tool: dict[bytes, list[int]] = {}
    tools: dict[bytes, Array] = {}
    for i in known.tolist():
        tool = program.moves[i].T_tip_tool
        T_tip_tool = np.eye(4) if tool is None else tool
        tools[T_tip_tool.tobytes()] = T_tip_tool
        by_tool.setdefault(T_tip_tool.tobytes(), []).append(i)

    depends_on_moves = True
    for key, T_tip_tool in tools.items():
        of_tool = np.array(by_tool[key])
        rows = known if depends_on_moves else of_tool
        labels = tuple(_label(program, i) for i in rows.tolist())
        motions = Program(labels, q=q_nominal[rows])
        commands = compensate(
            calibration,
            motions,
            nominal=nominal,
            tool=T_tip_tool,
            tolerance=tolerance,
            non_geometric=non_geometric,
            accept=accept,
        )
        depends_on_moves = commands.pair.actual.kinematics.model.depends_on_moves
        if len(rows) > len(of_tool):
            commands = _only(commands, np.isin(rows, of_tool))
        yield commands, of_tool


def _label(program: ProgramFile, i: int) -> str:
    """Return the words for a motion: its line, and the name of its target."""
    move = program.moves[i]
    name = program.targets[move.target].name
    return f"line {move.line}" + (f" ({name})" if name else "")


def _only(commands: Commands, kept: Mask) -> Commands:
    """Return some rows of commands, by a mask (N,)."""
    expected = commands.expected
    reached = kept & commands.reached
    if expected is not None and reached.any():
        moves = last_moves(commands.q_nominal)[reached]
        pair = replace(commands.pair, actual=replace(commands.pair.actual, moves=moves))
        expected = expected_errors(pair, commands.q[reached])
    elif expected is not None:
        expected = None
    rows = np.flatnonzero(kept).tolist()
    program = commands.program
    assert program.q is not None
    return replace(
        commands,
        program=Program(tuple(program.labels[i] for i in rows), q=program.q[kept]),
        T_wanted=read_only(commands.T_wanted[kept]),
        q_nominal=read_only(commands.q_nominal[kept]),
        q=read_only(commands.q[kept]),
        T_send=read_only(commands.T_send[kept]),
        missed=read_only(commands.missed[kept]),
        left=read_only(commands.left[kept]),
        left_by_pose=read_only(commands.left_by_pose[kept]),
        expected=expected,
        reasons=tuple(commands.reasons[i] for i in rows),
        warnings=tuple(commands.warnings[i] for i in rows),
    )


def _moves_by_target(program: ProgramFile) -> dict[int, list[int]]:
    """Return the motions to each target, both by their indices, in the order of the program."""
    by_target: dict[int, list[int]] = {}
    for i, move in enumerate(program.moves):
        by_target.setdefault(move.target, []).append(i)
    return by_target


def _common(written: Array, needed: Array) -> Array | None:
    """Return the mean of what k motions need of a target, or None if that is right for none of them.

    Written is one pose (4, 4) or joint values (m,), needed are poses (k, 4, 4) or joint values (k, m). The mean of
    rotations is R_1 exp(mean log(R_1^T R_i)).
    """
    if len(needed) == 1:
        return np.asarray(needed[0])
    if written.ndim == 1:
        mean = needed.mean(axis=0)
        left = np.abs(needed - mean).max(axis=1)
        error = np.abs(needed - written).max(axis=1)
    else:
        mean = needed[0].copy()
        turns = to_rotation_vectors(needed[0, :3, :3].T @ needed[:, :3, :3])
        mean[:3, :3] = needed[0, :3, :3] @ to_matrices(turns.mean(axis=0)[None])[0]
        mean[:3, 3] = needed[:, :3, 3].mean(axis=0)
        matching = Matching(POSE, _LENGTH)
        left = np.linalg.norm(matching.error(needed, np.broadcast_to(mean, needed.shape)), axis=1)
        there = np.broadcast_to(written, needed.shape)
        error = np.linalg.norm(matching.error(needed, there), axis=1)
    return mean if np.all((left <= _ALIKE) | (left <= _LARGEST_SHARE * error)) else None


def _dependent(
    program: ProgramFile, target: Target, moves: list[int], q_nominal: Array, q: Array
) -> list[tuple[NumberText, int]] | None:
    """Return the new values of the configuration data that change with the joint values (N, m), or None.

    None stands for motions that need different ones. Motions by joints decide, if there are any. Data that do not agree
    with the nominal joint values, such as those of lines, which the controller passes over, stay as they are.
    """
    by_joints = [i for i in moves if program.moves[i].motion == "joint"]
    changes = []
    for number, function in target.dependent:
        new = set()
        for i in by_joints or moves:
            if target.configuration is None:
                agrees = function(q_nominal[i]) == number.value
            else:
                agrees = bool(target.configuration(q_nominal[i][None])[0])
            holds = target.configuration is not None and target.configuration(q[i][None])[0]
            new.add(function(q[i]) if agrees and not holds else int(number.value))
        if len(new) > 1:
            return None
        (value,) = new
        if value != number.value:
            changes.append((number, value))
    return changes


def _leaves_configuration(
    program: ProgramFile, target: Target, moves: list[int], q_nominal: Array, q: Array
) -> bool:
    """Return whether a motion by joints would end in another configuration, where the controller turns a joint far."""
    allows = target.configuration
    by_joints = [i for i in moves if program.moves[i].motion == "joint"]
    if allows is None or not by_joints:
        return False
    return bool(np.any(allows(q_nominal[by_joints]) & ~allows(q[by_joints])))


def _poses(commands: Commands, contents: Sequence[Array]) -> Array:
    """Return poses (n, 4, 4) [m] of targets: as they are, or at joint values (m,) those of the nominal robot's tool."""
    poses = np.tile(np.eye(4), (len(contents), 1, 1))
    joint_values = [k for k, content in enumerate(contents) if content.ndim == 1]
    if joint_values:
        q = np.array([contents[k] for k in joint_values])
        poses[joint_values] = commands.pair.nominal.poses(q)
    for k, content in enumerate(contents):
        if content.ndim == 2:
            poses[k] = content
    return poses


class _Edits:
    """New numbers in texts, collected and then put in at once."""

    def __init__(self, texts: tuple[ProgramText, ...]) -> None:
        """Start with none."""
        self._texts = texts
        self._edits: list[list[tuple[int, int, str]]] = [[] for _ in texts]

    def old(self, target: Target, number: NumberText) -> str:
        """Return a number of a target as it is written."""
        return self._texts[target.file].text[number.start : number.end]

    def replace(self, file: int, number: NumberText, new: str) -> None:
        """Put a text in place of a number of a file."""
        text = self._texts[file].text
        start, new = in_column(text, number.start, text[number.start : number.end], new)
        self._edits[file].append((start, number.end, new))

    def write(self, target: Target, content: Array, written: Array, robot: Robot) -> Array:
        """Write a pose (4, 4) [m] or joint values (m,) as the numbers of a target, and return what they stand for.

        A target that is there already, by what is ``written``, stays as it is.
        """
        if np.abs(content - written).max() <= _EXACT:
            return written
        values = values_of(target)
        new = content
        if target.convention is not None:
            turned = nearest_numbers(target.convention, content[:3, :3], values[3:])
            new = np.concatenate([content[:3, 3], turned])
        final = values.copy()
        for k, number in enumerate(target.numbers):
            scale = target.scales[k]
            old = self.old(target, number)
            decimals = decimals_for(_quantity(target, k, robot), scale)
            text = written_number(old, float(new[k]) / scale, decimals, number.most_decimals)
            before = written_number(old, number.value, decimals, number.most_decimals)
            if text.value != before.value:
                self.replace(target.file, number, text.text)
                final[k] = text.value * scale
        return final if target.convention is None else pose_of(target, final)

    def texts(self) -> tuple[ProgramText, ...]:
        """Return the texts with all new numbers."""
        result = []
        for old, edits in zip(self._texts, self._edits, strict=True):
            parts, done = [], 0
            for start, end, new in sorted(edits):
                if start < done:
                    raise ValueError(f"two numbers at character {start} of {old.path}")
                parts += [old.text[done:start], new]
                done = end
            result.append(replace(old, text="".join([*parts, old.text[done:]])))
        return tuple(result)


def _quantity(target: Target, k: int, robot: Robot) -> str:
    """Return the quantity of a number of a target, by its index, as `decimals_for` takes it."""
    if target.convention is None:
        slides = robot.joint_types[robot.joint_names[k]] == "prismatic"
        return "length" if slides else "angle"
    if k < 3:
        return "length"
    return "angle" if target.convention.unit else "plain"
