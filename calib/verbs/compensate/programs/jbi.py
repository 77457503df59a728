"""Yaskawa's (Motoman's) jobs (.jbi): positions in //POS, instructions in //INST.

What ``///TOOL``, ``///USER``, ``///POSTYPE``, ``///PULSE``, ``///RECTAN`` and ``///RCONF`` say holds for the positions
below them. Pulses are integers, theta = pulses / (pulses per radian). The numbers of RCONF choose among the solutions,

    flip: joint B above zero            upper arm, front: as at zero, see `calib.verbs.compensate.programs.arm_posture`
    the next three: whether R, T and S are turned beyond half a turn

Jobs of eight numbers are of older controllers, for which flip is that R is within a right angle of zero.
"""

from __future__ import annotations

import math
import re
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.basics.arrays import Array, Mask, read_only
from calib.basics.files import read_bytes
from calib.data.forms.orientations import CONVENTIONS
from calib.errors import MeasurementError
from calib.verbs.compensate.programs.arm_posture import ArmPosture
from calib.verbs.compensate.programs.numbered_frames import NumberedFrames, pose_of_numbers
from calib.verbs.compensate.programs.program_file import (
    Configuration,
    Left,
    LeftCode,
    Motion,
    Move,
    NumberText,
    ProgramFile,
    ProgramText,
    Stated,
    Target,
)

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)"
_DATUM = re.compile(r"(C|BC|EC|P|BP|EX)(\d+)\s*=\s*(.*)")
_NUMBERS = re.compile(_NUMBER)

#: The first instructions of a line that moves the robot to positions, with any prefix.
_MOTION = re.compile(r"(\+?)(S|SY|E|V|EI)?(I?MOV[A-Z]*)\b")
_MOTIONS: dict[str, Motion] = {
    "MOVJ": "joint",
    "MOVL": "linear",
    "MOVC": "circular",
    "MOVS": "circular",
}
_POSITION = re.compile(r"(?<![A-Z])(C|LP|PX|P)(\d+|\[[^\]]*\])")
_EXTERNAL = re.compile(r"(?<![A-Z])(BC|EC|BP|EX|LBP|LEX)(\d+|\[[^\]]*\])")
#: A further robot or station, on the same line.
_FURTHER = re.compile(r"\s\+(?=[A-Z]*MOV)")
_VARIABLE = re.compile(r"(?:PX|P)(\d+|\[[^\]]*\])")
_INDEX = re.compile(r"(UF|TL|STEP)#\(([^)]*)\)")

#: Instructions that read a variable of positions, and do not change it.
_READING = frozenset(
    (
        *("SFTON", "GETE", "REFP", "MFRAME", "SETTOOL", "CALL", "WAIT", "DISP", "SETREG", "MSG"),
        *("IF", "IFTHEN", "IFTHENEXP", "ELSEIF", "WHILE"),
    )
)
#: Instructions that run other jobs, which may change any variable.
_OTHER_JOBS = re.compile(r"(?:CALL|PSTART|MACRO\d*|JUMP\s+JOB:)\b")

#: Numbers of RCONF that newer controllers write.
_NEW_RCONF = 24

#: Decimals of a position [mm] and of an angle [deg] that controllers read, the latter of newer and older ones.
_LENGTH_DECIMALS, _ANGLE_DECIMALS, _OLD_ANGLE_DECIMALS = 3, 4, 2

#: Of seven joints the last of a job, E, is the third of the arm.
_SEVEN = (0, 1, 6, 2, 3, 4, 5)

#: So close to where configuration data change both solutions are possible [rad].
_CLOSE = 1e-4

_DEG = math.pi / 180.0


def read(path: Path, stated: Stated) -> ProgramFile:
    """Read a Yaskawa job.

    Args:
        path: The job (.jbi).
        stated: What options say; ``data`` are TOOL.CND and UFRAME.CND.

    Returns:
        The job. Variables that it, or a job that it calls, may change are among what is left.

    Raises:
        MeasurementError: It is not a job, or a tool, a frame or pulses are not defined.
    """
    text = read_bytes(path, "program").decode("latin-1")
    lines = _Lines(text)
    heads = [line for line, _, row in lines.rows if row == "/JOB"]
    first = next((row for _, _, row in lines.rows if row and not row.startswith("'")), "")
    if first != "/JOB":
        raise MeasurementError(f"{path} is not a Yaskawa job: it does not begin with /JOB.")
    if len(heads) > 1:
        raise MeasurementError(
            f"{path}, line {heads[1]}: a second job begins here; give each job a file of its own."
        )
    return _Reader(path, text, stated, lines).program()


class _Lines:
    """The lines of a text."""

    def __init__(self, text: str) -> None:
        """Split the text."""
        self.rows: list[tuple[int, int, str]] = []
        self.starts: list[int] = []
        position = 0
        for number, row in enumerate(text.split("\n"), start=1):
            self.starts.append(position)
            # Where the line begins that is left without blanks at its ends.
            start = position + len(row) - len(row.lstrip())
            self.rows.append((number, start, row.strip()))
            position += len(row) + 1

    def at(self, position: int) -> int:
        """Return the line of a character, from 1."""
        return bisect_right(self.starts, position)


@dataclass(frozen=True, slots=True)
class _Datum:
    """A position of the job, with what the lines above it say."""

    name: str
    line: int
    numbers: tuple[NumberText, ...]
    #: ``PULSE``, ``ANGLE``, ``BASE``, ``ROBOT``, ``USER``, ``TOOL`` or another.
    form: str
    tool: int
    user: int
    rconf: tuple[int, ...]


class _Reader:
    """Reads one job."""

    def __init__(self, path: Path, text: str, stated: Stated, lines: _Lines) -> None:
        """Read the positions, and find what the job changes as it runs."""
        self.path, self.text, self.stated = path, text, stated
        self.data: dict[str, _Datum] = {}
        self.base_axes = False
        self.robot_group = True
        self.instructions: list[tuple[int, str]] = []
        self._split(lines)
        tools, frames = _controller_frames(path, stated)
        self.frames = NumberedFrames(path, stated, tools, frames, files="TOOL.CND and UFRAME.CND")
        self.posture = ArmPosture.of(stated.robot)
        self.targets: list[Target] = []
        self.moves: list[Move] = []
        self.left: list[Left] = []
        self.index: dict[str, int] = {}
        self.named: set[str] = set()
        self.needs_pulses = False
        self._find_computed()

    def _split(self, lines: _Lines) -> None:
        """Read the positions, and keep the instructions."""
        section, form, tool, user = "", "PULSE", 0, 0
        rconf: tuple[int, ...] = ()
        for number, start, row in lines.rows:
            if row.startswith("//") and not row.startswith("///") and section != "INST":
                section = row[2:].split(" ")[0]
                continue
            if section == "INST":
                if row.startswith("///GROUP1"):
                    groups = row[len("///GROUP1") :].strip().split(",")
                    self.robot_group = groups[0].startswith("RB")
                    self.base_axes = any(group.startswith("BS") for group in groups)
                elif row and not row.startswith(("'", "//")):
                    self.instructions.append((number, _without_comment(row)))
                continue
            if section != "POS":
                if not section and row and not row.startswith(("'", "/")):
                    self.instructions.append((number, _without_comment(row)))
                continue
            word, _, rest = row.partition(" ")
            values = [int(float(value)) for value in _NUMBERS.findall(rest)]
            if word == "///TOOL" and values:
                tool = values[0]
            elif word == "///USER" and values:
                user = values[0]
            elif word == "///POSTYPE":
                form = rest.strip().upper()
            elif word == "///RCONF":
                rconf = tuple(values)
            elif row and not row.startswith(("'", "/")):
                self._datum(number, start, row, form, tool, user, rconf)

    def _datum(
        self,
        line: int,
        start: int,
        row: str,
        form: str,
        tool: int,
        user: int,
        rconf: tuple[int, ...],
    ) -> None:
        """Take a line of a position, or an instruction, of a job without //INST."""
        match = _DATUM.fullmatch(row)
        if match is None:
            self.instructions.append((line, _without_comment(row)))
            return
        if match[1] not in ("C", "P"):
            return
        name = f"{match[1]}{int(match[2])}"
        if name in self.data:
            raise MeasurementError(
                f"{self.path}, line {line}: position {match[1]}{match[2]} is there twice; keep one."
            )
        begin = start + match.start(3)
        numbers = tuple(
            NumberText(begin + number.start(), begin + number.end(), float(number[0]))
            for number in _NUMBERS.finditer(match[3])
        )
        shown = match[1] + match[2]
        self.data[name] = _Datum(shown, line, numbers, form, tool, user, rconf)

    def _find_computed(self) -> None:
        """Find the variables, frames and tools that the job may change; ``"*"`` is any of them."""
        self.computed: dict[str, set[str]] = {"P": set(), "UF": set(), "TL": set(), "STEP": set()}
        for _, row in self.instructions:
            word, _, rest = row.partition(" ")
            if _MOTION.match(row):
                continue
            if _OTHER_JOBS.match(row):
                self.computed["P"].add("*")
            changed = _VARIABLE.match(rest.strip())
            if changed and word not in _READING:
                self.computed["P"].add(_plain(changed[1]))
            if word in ("MFRAME", "SETTOOL", "GETPOS"):
                for kind, number in _INDEX.findall(rest):
                    self.computed[kind].add(_plain(number))

    def program(self) -> ProgramFile:
        """Go through the instructions."""
        shifted = False
        step = 0
        for line, row in self.instructions:
            word = row.split(" ")[0]
            if word in ("SFTON", "SSFTON"):
                shifted = True
            elif word in ("SFTOF", "SSFTOF"):
                shifted = False
            motion = _MOTION.match(row)
            if motion is None:
                self._other(line, word, row)
                continue
            step += 1
            code: LeftCode | None = "computed" if shifted else None
            if self.computed["STEP"] & {str(step), "*"}:
                code = "not a motion"
            first, *further = _FURTHER.split(row)
            self._motion(line, first, code)
            for part in further:
                if _POSITION.search(part):
                    self._motion(line, "+" + part, code)
        for name, datum in self.data.items():
            if name not in self.named:
                self.left.append(Left(0, datum.line, "unused", datum.name))
        self._check_pulses()
        self.frames.check()
        text = ProgramText(self.path, self.text)
        return ProgramFile((text,), tuple(self.targets), tuple(self.moves), tuple(self.left))

    def _other(self, line: int, word: str, row: str) -> None:
        """Take an instruction that is no motion; positions of the job in it are no targets."""
        for kind, index in _POSITION.findall(row):
            if kind == "C":
                self.named.add(f"C{_plain(index)}")
                self.left.append(Left(0, line, "not a motion", f"{word} {kind}{index}"))
            elif _plain(index).isdigit():
                self.named.add(f"P{_plain(index)}")

    def _motion(self, line: int, row: str, code: LeftCode | None) -> None:
        """Take a motion."""
        match = _MOTION.match(row)
        assert match is not None
        plus, prefix, word = match.groups()
        positions = _POSITION.findall(row)
        if plus:
            code = "group"
        elif prefix == "SY":
            code = "conveyor"
        elif word.startswith("I") or (prefix or "").startswith("EI"):
            code = "relative"
        elif word not in _MOTIONS or prefix not in (None, "S"):
            code = "unread"
        elif re.search(r"\b(?:UNTIL|SRCH)\b", row):
            code = "search"
        elif not self.robot_group:
            code = "group"
        elif not positions:
            code = "external axes" if _EXTERNAL.search(row) else "partial"
        for kind, index in positions[:1] if code is None else positions:
            number = _plain(index)
            name = f"{kind[0]}{number}"
            why = code
            if kind in ("C", "P") and number.isdigit():
                self.named.add(name)
                if why is None:
                    why = self._take(line, name, _MOTIONS[word], follows=prefix == "S")
            else:
                why = why or "computed"
            if why is not None:
                self.left.append(Left(0, line, why, f"{word} {kind}{index}"))
        if not positions:
            self.left.append(Left(0, line, code or "partial", row[:40]))

    def _take(self, line: int, name: str, motion: Motion, *, follows: bool) -> LeftCode | None:
        """Add a motion to a position, and the position if it is new; or return why it is left.

        A robot that ``follows`` a station or another robot does so on its way: joint values are where it ends.
        """
        datum = self.data.get(name)
        if name[0] == "P" and self.computed["P"] & {name[1:], "*"}:
            return "computed"
        if datum is None:
            return "other file"
        if datum.form in ("PULSE", "ANGLE"):
            self._check_count(datum, len(self.stated.joint_names))
            tool = None
            if not self.computed["TL"] & {str(datum.tool), "*"}:
                tool = self.frames.tool(datum.tool, needed=False)
            if name not in self.index:
                target = self._joints(datum)
                if target is None:
                    return None  # the reader ends with a message that asks for pulses
                self._add(name, target)
            self.moves.append(Move(self.index[name], 0, line, motion, tool))
            return None
        if datum.form == "TOOL":
            return "relative"
        if datum.form not in ("BASE", "ROBOT", "USER"):
            return "group"
        if datum.form != "ROBOT" and (self.base_axes or follows):
            return "external axes"
        if len(datum.numbers) == 7:
            return "unread"  # Re, the angle of the elbow of seven joints
        self._check_count(datum, 6)
        T_base_frame: Array | None = np.eye(4)
        if datum.form == "USER":
            if self.computed["UF"] & {str(datum.user), "*"}:
                return "computed"
            T_base_frame = self.frames.frame(datum.user)
        if self.computed["TL"] & {str(datum.tool), "*"}:
            return "computed"
        T_tip_tool = self.frames.tool(datum.tool)
        if T_base_frame is None or T_tip_tool is None:
            return None  # the reader ends with a message that names it
        if name not in self.index:
            self._add(name, self._pose(datum))
        self.moves.append(Move(self.index[name], 0, line, motion, T_tip_tool, T_base_frame))
        return None

    def _check_count(self, datum: _Datum, count: int) -> None:
        """Refuse a position of another number of values, by a `MeasurementError`."""
        if len(datum.numbers) != count:
            what = "joints" if datum.form in ("PULSE", "ANGLE") else "numbers of a pose"
            raise MeasurementError(
                f"{self.path}, line {datum.line}: position {datum.name} has {len(datum.numbers)} values, and there "
                f"should be {count} {what}; give the robot of this job, or hold its other joints."
            )

    def _add(self, name: str, target: Target) -> None:
        """Add the target of a position."""
        self.index[name] = len(self.targets)
        self.targets.append(target)

    def _joints(self, datum: _Datum) -> Target | None:
        """Return the target of joint values; None if pulses are not stated."""
        count = len(datum.numbers)
        scales = (_DEG,) * count
        decimals: int | None = _ANGLE_DECIMALS
        if datum.form == "PULSE":
            decimals = 0
            if not self.stated.pulses:
                self.needs_pulses = True
                return None
            scales = tuple(1.0 / pulses for pulses in self.stated.pulses)
        order = _SEVEN if count == 7 else tuple(range(count))
        numbers = tuple(_with_decimals(datum.numbers[k], decimals) for k in order)
        return Target(datum.name, 0, datum.line, numbers, scales)

    def _pose(self, datum: _Datum) -> Target:
        """Return the target of a pose."""
        angles = _ANGLE_DECIMALS
        written = max(self._decimals(number) for number in datum.numbers[3:])
        if 0 < len(datum.rconf) < _NEW_RCONF and written <= _OLD_ANGLE_DECIMALS:
            angles = _OLD_ANGLE_DECIMALS
        most = (_LENGTH_DECIMALS,) * 3 + (angles,) * 3
        numbers = [_with_decimals(n, d) for n, d in zip(datum.numbers, most, strict=True)]
        return Target(
            datum.name,
            0,
            datum.line,
            tuple(numbers),
            (1e-3,) * 3 + (_DEG,) * 3,
            CONVENTIONS["yaskawa"],
            self._configuration(datum.rconf),
        )

    def _decimals(self, number: NumberText) -> int:
        """Return how many decimals a number is written with."""
        return len(self.text[number.start : number.end].partition(".")[2])

    def _check_pulses(self) -> None:
        """Ask for the pulses if there are any, by a `MeasurementError`."""
        if self.needs_pulses:
            first = self.stated.joint_names[0]
            raise MeasurementError(
                f"{self.path}: positions are in pulses. State the pulses of each joint, such as "
                f'--pulses "{first}=1000 per deg"; below zero if the joint turns the other way.'
            )

    def _configuration(self, rconf: tuple[int, ...]) -> Configuration | None:
        """Return which joint values the numbers of RCONF allow."""
        if len(self.stated.joint_names) != 6 or len(rconf) < 6:
            return None
        posture = self.posture
        no_flip, lower, rear, *turned = (value == 1 for value in rconf[:6])
        old = len(rconf) < _NEW_RCONF

        def allows(q: Array) -> Mask:
            """Return whether joint values (K, 6) [rad] are of the configuration."""
            # The cosine of R is above zero within a right angle of zero, and of whole turns.
            sign = np.cos(q[:, 3]) if old else q[:, 4]
            mask = np.asarray(sign < _CLOSE if no_flip else sign > -_CLOSE)
            if posture is not None:
                mask &= posture.is_elbow_up(q, up=not lower)
                mask &= posture.is_front(q, front=not rear)
            for joint, is_turned in zip((3, 5, 0), turned, strict=True):
                mask &= (np.abs(q[:, joint]) >= math.pi) == is_turned
            return mask

        return allows


def _plain(index: str) -> str:
    """Return a number without leading zeros, or ``"*"`` for one that the job computes."""
    index = index.strip()
    return str(int(index)) if index.isdigit() else "*"


def _with_decimals(number: NumberText, decimals: int | None) -> NumberText:
    """Return a number with the decimals that the controller reads."""
    return NumberText(number.start, number.end, number.value, decimals)


def _without_comment(row: str) -> str:
    """Return an instruction without the comment after it, and without strings."""
    row = re.sub(r'"[^"]*"', '""', row)
    return re.split(r"\s//|\s'", row)[0].strip()


# The controller's files


def _controller_frames(path: Path, stated: Stated) -> tuple[dict[int, Array], dict[int, Array]]:
    """Return tools and frames by number, from files that are given or lie beside the job."""
    tools: dict[int, Array] = {}
    frames: dict[int, Array] = {}
    names = ("tool.cnd", "uframe.cnd")
    beside = sorted(file for file in path.parent.iterdir() if file.name.lower() in names)
    for file in [*beside, *stated.data]:
        text = read_bytes(file, "data file").decode("latin-1")
        if not re.search(r"^//(?:TOOL|UFRAME)\s+\d", text, re.MULTILINE):
            if file in beside:
                continue
            raise MeasurementError(
                f"{file} has no tools or frames of a Yaskawa controller: give TOOL.CND or UFRAME.CND with --data."
            )
        for kind, number, rows in _entries(text):
            if kind == "TOOL":
                tools.update(_tool_of(number, rows))
            else:
                frames.update(_frame_of(number, rows, frames))
    return tools, frames


def _entries(text: str) -> Iterator[tuple[str, int, list[str]]]:
    """Yield the entries of TOOL.CND or UFRAME.CND: kind, number, lines."""
    heads = list(re.finditer(r"^//(TOOL|UFRAME)\s+(\d+)[^\n]*$", text, re.MULTILINE))
    for i, head in enumerate(heads):
        end = heads[i + 1].start() if i + 1 < len(heads) else len(text)
        yield head[1], int(head[2]), [row.strip() for row in text[head.end() : end].split("\n")]


def _tool_of(number: int, rows: list[str]) -> dict[int, Array]:
    """Return the tool of an entry: its first line of six numbers."""
    for row in rows:
        values = [float(value) for value in _NUMBERS.findall(row)]
        if not row.startswith("/") and len(values) == 6:
            return {number: pose_of_numbers(values, "yaskawa")}
    return {}


def _frame_of(number: int, rows: list[str], frames: dict[int, Array]) -> dict[int, Array]:
    """Return the frame of an entry in the base: BUSER in the frame that BASICFRM names; none if that moves."""
    T = np.eye(4)
    for row in rows:
        word = row.lstrip("/").split(" ")[0].split("=")[0]
        values = [float(value) for value in _NUMBERS.findall(row[row.find(word) + len(word) :])]
        if word == "BASICFRM" and len(values) >= 3 and values[1] == 19:
            if int(values[2]) not in frames:
                return {}
            T = frames[int(values[2])]
        elif word == "BASICFRM" and len(values) >= 2 and values[1] == 20:
            return {}
        elif word == "BUSER" and len(values) >= 6:
            return {number: read_only(T @ pose_of_numbers(values, "yaskawa"))}
    return {}
