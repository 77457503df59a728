"""FANUC's teach pendant programs as text (.ls): motions in /MN, positions in /POS.

A position has its own numbers of frame and tool (UF, UT), which the controller checks against those in effect; frame 0
is the world, tool 0 the flange. Its configuration 'N U T, 0, 0, 0' has letters for wrist, elbow and front, and the
turns of joints 1, 4 and 6,

    N: joint 5 below zero, F: above      U, D: elbow up, down      T, B: wrist in front of axis 1, behind
    turn = floor((theta + 180 deg) / 360 deg)
"""

from __future__ import annotations

import math
import re
from bisect import bisect_left
from collections.abc import Callable, Iterator
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

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"

#: The first line of a program, after blanks.
_HEAD = re.compile(r"\s*/PROG\b")
_SECTION = re.compile(r"^/(MN|POS|END)\b[^\n]*$", re.MULTILINE)

#: What precedes a statement on its line: its number and a colon, or a colon alone.
_PREFIX = re.compile(r"\s*(\d*)\s*:")
_REMARK = re.compile(r"\s*(?:!|//|--)")

#: ``[1:name]``; a group, ``[GP1:1]``, is no name.
_GROUP_INDEX = re.compile(r"\[\s*GP(\d+)\s*:")
_INDEX_NAME = re.compile(r"\[([^\[\]:]*(?:\[[^\[\]]*\])?[^\[\]:]*):[^\[\]]*\]")

_POSITION = r"(PR?)\[((?:[^\[\]]|\[[^\[\]]*\])*)\]"
_MOTION = re.compile(rf"([JLCAS])\s+{_POSITION}\s*")
_SECOND = re.compile(rf"{_POSITION}\s*")
_PALLET = re.compile(r"[JLCAS]\s+PAL_\w*\[[^\]]*\]")
#: Something short and a position, which is none of the above: it may be a motion.
_PERHAPS = re.compile(rf"(?:[A-Za-z]{{1,2}}|SPLINE)\s+{_POSITION}")

_ASSIGNED = re.compile(rf"(?<![\w.$\]]){_POSITION}\s*=")
_FRAME_SET = re.compile(r"(?<![\w.$])(UFRAME|UTOOL)\[\s*(?:GP\d+\s*,\s*)?(\w+)[^=]*\]\s*=")
_CURRENT = re.compile(r"(?<![\w.$])(UFRAME|UTOOL)_NUM\s*(?:\[[^\]]*\]\s*)?=\s*([^\s;]+)")

#: Options of a motion, in several of the controller's languages, and why its target is not where it goes.
_OPTIONS: tuple[tuple[re.Pattern[str], LeftCode], ...] = (
    (re.compile(r"\bINC\b", re.IGNORECASE), "relative"),
    (re.compile(r"\bVOFFSET\b|,\s*VR\[", re.IGNORECASE), "computed"),
    (re.compile(r"OFFSET\b|,\s*PR\[", re.IGNORECASE), "relative"),
    (re.compile(r"\bSKIP|,\s*(?:LBL|LABEL)\[|\bSEARCH\s*\[", re.IGNORECASE), "search"),
)
#: Statements between which motions do not end at their targets.
_MODES: tuple[tuple[re.Pattern[str], re.Pattern[str], LeftCode], ...] = (
    (re.compile(r"TRACK\s*END", re.I), re.compile(r"TRACK\b", re.I), "search"),
    (re.compile(r"TOUCH\s+OFFSET\s+END", re.I), re.compile(r"TOUCH\s+OFFSET\b", re.I), "relative"),
    (re.compile(r"SOFTFLOAT\s+END", re.I), re.compile(r"SOFTFLOAT\s*\[", re.I), "force"),
    (re.compile(r"FORCE\s*CTRL\s*END", re.I), re.compile(r"FORCE\s*CTRL\b", re.I), "force"),
)
_LINE_TRACK = re.compile(r"LINE_TRACK_SCHEDULE_NUMBER\s*:\s*0*([1-9]\d*)")

_ENTRY = re.compile(r'P\[\s*(\d+)\s*(?::\s*"[^"\n]*")?[^\]\n]*\]\s*\{')
_GROUP = re.compile(r"\bGP(\d+)\s*:")
_FRAME = re.compile(r"\bUF\s*:\s*(\w+)")
_TOOL = re.compile(r"\bUT\s*:\s*(\w+)")
_CONFIG = re.compile(r"\b[CK]ONFIG\s*:\s*'([^']*)'")
_TURNS = re.compile(r"[-+]?\d+")
_VALUE = re.compile(rf"\b(R?[XYZWPR]|[JE]\d+)\s*=\s*(\*+|{_NUMBER})\s*(mm|deg)?")

_POSE = ("X", "Y", "Z", "W", "P", "R")
_SCALES = {"mm": 1e-3, "deg": math.pi / 180.0}

#: Joints, from 0, whose turns the three numbers of a configuration count.
_TURNING = (0, 3, 5)

#: Joint 5 is between flip and no flip if it is closer to zero than this [rad].
_STRAIGHT = 1e-4


def read(path: Path, stated: Stated) -> ProgramFile:
    """Read a FANUC program.

    Args:
        path: The program, as text (.ls).
        stated: What options say; ``data`` are dumps of SYSFRAME.VA or FRAME.DG.

    Returns:
        The program. Positions in position registers, and whatever the program computes, are among what is left.

    Raises:
        MeasurementError: It is not such a program, or a tool or frame is not defined.
    """
    text = read_bytes(path, "program").decode("latin-1")
    if not _HEAD.match(text):
        raise MeasurementError(
            f"{path} is not a FANUC program as text: it does not begin with /PROG. Binary programs (.tp) are saved as "
            "text by the controller (ASCII) or by PrintTP; LiveScript also ends in .ls."
        )
    return _Reader(path, text, stated).program()


# The text


@dataclass(frozen=True, slots=True)
class _Statement:
    """A statement of the program, without names in its indices."""

    line: int
    text: str


def _statements(text: str, start: int, end: int) -> Iterator[_Statement]:
    """Yield the statements between two characters; one goes on to its semicolon, over several lines."""
    line = text.count("\n", 0, start) + 1
    first = line
    parts: list[str] = []
    for row in text[start:end].split("\n"):
        prefix = _PREFIX.match(row)
        rest = row[prefix.end() :] if prefix else row
        if parts and prefix and prefix[1]:
            yield _Statement(first, _without_names(" ".join(parts)))
            parts = []
        if not parts and (_REMARK.match(rest) or not rest.strip("- ;\r\t")):
            line += 1
            continue
        if not parts:
            first = line
        parts.append(rest.strip())
        if rest.rstrip().endswith(";"):
            yield _Statement(first, _without_names(" ".join(parts)))
            parts = []
        line += 1
    if parts:
        yield _Statement(first, _without_names(" ".join(parts)))


def _without_names(text: str) -> str:
    """Return a statement without its semicolon and without the names in its indices."""
    text = _GROUP_INDEX.sub(r"[GP\1,", text.strip().rstrip(";").strip())
    before = None
    while before != text:
        before, text = text, _INDEX_NAME.sub(r"[\1]", text)
    return text


# The positions


@dataclass(frozen=True, slots=True)
class _Values:
    """One group of a position."""

    line: int
    frame: str
    tool: str
    #: The letters of the configuration, and its numbers.
    letters: str
    turns: tuple[NumberText, ...]
    #: The numbers by their name, with their unit; None: not taught.
    numbers: dict[str, tuple[NumberText | None, str]]

    @property
    def joints(self) -> list[str]:
        """Names of the joints that have values, in their order."""
        return sorted((name for name in self.numbers if name[0] == "J"), key=lambda n: int(n[1:]))

    @property
    def external(self) -> list[float | None]:
        """Values of the extended axes; None: not taught."""
        of_axes = (value for name, (value, _) in self.numbers.items() if name[0] == "E")
        return [None if value is None else value.value for value in of_axes]


def _positions(path: Path, text: str, start: int, end: int) -> dict[int, dict[int, _Values]]:
    """Return the positions between two characters by number, each by group."""
    line_ends = [match.start() for match in re.finditer("\n", text)]
    positions: dict[int, dict[int, _Values]] = {}
    for entry in _ENTRY.finditer(text, start, end):
        number = int(entry[1])
        close = text.find("}", entry.end(), end)
        close = end if close < 0 else close
        if number in positions:
            line = bisect_left(line_ends, entry.start()) + 1
            raise MeasurementError(
                f"{path}, line {line}: position P[{number}] is there twice; keep one."
            )
        heads = list(_GROUP.finditer(text, entry.end(), close))
        starts = [(int(head[1]), head.end()) for head in heads] or [(1, entry.end())]
        ends = [head.start() for head in heads[1:]] + [close]
        positions[number] = {
            group: _group(text, begin, stop, line_ends)
            for (group, begin), stop in zip(starts, ends, strict=True)
        }
    return positions


def _group(text: str, start: int, end: int, line_ends: list[int]) -> _Values:
    """Return one group of a position, which stands between two characters."""
    frame, tool = (pattern.search(text, start, end) for pattern in (_FRAME, _TOOL))
    config = _CONFIG.search(text, start, end)
    letters, turns = "", ()
    if config:
        head, comma, _ = config[1].partition(",")
        letters = "".join(head.split())
        if comma:
            begin = config.start(1) + len(head)
            turns = tuple(
                NumberText(turn.start(), turn.end(), float(turn[0]))
                for turn in _TURNS.finditer(text, begin, config.end(1))
            )
    numbers: dict[str, tuple[NumberText | None, str]] = {}
    first = start
    for value in _VALUE.finditer(text, start, end):
        if not numbers:
            first = value.start()
        number = None
        if value[2][0] != "*":
            number = NumberText(value.start(2), value.end(2), float(value[2]))
        numbers[value[1]] = (number, value[3] or "")
    return _Values(
        bisect_left(line_ends, first) + 1,
        frame[1] if frame else "F",
        tool[1] if tool else "F",
        letters,
        turns,
        numbers,
    )


# The program


class _Reader:
    """Reads one program."""

    def __init__(self, path: Path, text: str, stated: Stated) -> None:
        """Find the program's sections and the controller's tools and frames."""
        self.path, self.text, self.stated = path, text, stated
        sections: dict[str, tuple[int, int]] = {}
        for section in _SECTION.finditer(text):
            sections.setdefault(section[1], section.span())
        if "MN" not in sections:
            raise MeasurementError(f"{path}: the program has no section /MN with its statements.")
        last = sections.get("END", (len(text),))[0]
        end = sections.get("POS", (last,))[0]
        self.head = text[: sections["MN"][0]]
        self.statements = list(_statements(text, sections["MN"][1], end))
        self.positions = (
            _positions(path, text, sections["POS"][1], last) if "POS" in sections else {}
        )
        groups = [group for position in self.positions.values() for group in position]
        self.group = min(groups, default=1)
        tools, frames = _controller_frames(path, stated, self.group)
        self.frames = NumberedFrames(path, stated, tools, frames, files="SYSFRAME.VA or FRAME.DG")
        self.posture = ArmPosture.of(stated.robot)
        self.targets: list[Target] = []
        self.moves: list[Move] = []
        self.left: list[Left] = []
        #: Index of the target of each position, and the positions that some motion names.
        self.index: dict[int, int] = {}
        self.named: set[int] = set()
        self._find_computed()

    def _find_computed(self) -> None:
        """Find what the program changes as it runs: positions, registers, frames, tools; ``"*"`` is any of them."""
        self.computed: dict[str, set[str]] = {
            "P": set(),
            "PR": set(),
            "UFRAME": set(),
            "UTOOL": set(),
        }
        current: dict[str, set[str]] = {"UFRAME": set(), "UTOOL": set()}
        for statement in self.statements:
            for kind, index in _ASSIGNED.findall(statement.text):
                first = index.split(",")[0].strip()
                if first.startswith("GP"):
                    first = index.split(",")[1].strip()
                self.computed[kind].add(first if first.isdigit() else "*")
            for kind, index in _FRAME_SET.findall(statement.text):
                self.computed[kind].add(index if index.isdigit() else "*")
            for kind, number in _CURRENT.findall(statement.text):
                current[kind].add(number)
        self.current = {
            kind: next(iter(values)) if len(values) == 1 else "" for kind, values in current.items()
        }

    def program(self) -> ProgramFile:
        """Go through the statements."""
        conveyor = _LINE_TRACK.search(self.head) is not None
        mode: LeftCode | None = "conveyor" if conveyor else None
        leads = self._leader_moves()
        for statement in self.statements:
            for end, begin, code in _MODES:
                if end.match(statement.text):
                    mode = None
                elif begin.match(statement.text):
                    mode = code
            motion = _MOTION.match(statement.text)
            if motion is None:
                self._other(statement)
                continue
            ends = [(motion[1], motion[2], motion[3])]
            rest = statement.text[motion.end() :]
            second = _SECOND.match(rest) if motion[1] == "C" else None
            if second:
                ends.append((motion[1], second[1], second[2]))
                rest = rest[second.end() :]
            code = mode
            for pattern, why in _OPTIONS:
                code = code or (why if pattern.search(rest) else None)
            follows = leads and re.search(r"\bCOORD\b", rest) is not None
            for kind, what, index in ends:
                self._move(statement.line, kind, what, index.strip(), code, follows=follows)
        for number, groups in self.positions.items():
            if number not in self.named and self.group in groups:
                line = groups[self.group].line
                self.left.append(Left(0, line, "unused", f"P[{number}]"))
        self.frames.check()
        text = ProgramText(self.path, self.text)
        return ProgramFile((text,), tuple(self.targets), tuple(self.moves), tuple(self.left))

    def _other(self, statement: _Statement) -> None:
        """Take a statement that is none of the known motions."""
        pallet = _PALLET.match(statement.text)
        if pallet:
            self.left.append(Left(0, statement.line, "computed", pallet[0]))
        elif _PERHAPS.match(statement.text) and not _ASSIGNED.match(statement.text):
            self.left.append(Left(0, statement.line, "unread", statement.text[:40]))

    def _leader_moves(self) -> bool:
        """Return whether another group's values change from one position to the next."""
        values = set()
        for position in self.positions.values():
            others = []
            for group, of_group in sorted(position.items()):
                if group != self.group:
                    numbers = (number for number, _ in of_group.numbers.values())
                    others += [None if n is None else n.value + 0.0 for n in numbers]
            values.add(tuple(others))
        return len(values) > 1

    def _move(
        self, line: int, kind: str, what: str, index: str, code: LeftCode | None, *, follows: bool
    ) -> None:
        """Take a motion to a position, which is corrected, or left for a reason.

        A robot that ``follows`` another group does so on its way: joint values are where it ends.
        """
        name = f"{what}[{index}]"
        if what == "PR":
            of_register: LeftCode = "other file"
            if not index.isdigit() or self.computed["PR"] & {index, "*"}:
                of_register = "computed"
            self.left.append(Left(0, line, code or of_register, name))
            return
        if not index.isdigit():
            self.left.append(Left(0, line, code or "computed", name))
            return
        number = int(index)
        self.named.add(number)
        groups = self.positions.get(number, {})
        if code is None and self.computed["P"] & {index, "*"}:
            code = "computed"
        if code is None and groups and self.group not in groups:
            code = "group"
        if code is None and not groups:
            code = "partial"
        if code is None:
            code = self._take(number, line, kind, follows=follows)
        if code is not None:
            self.left.append(Left(0, line, code, name))

    def _take(self, number: int, line: int, kind: str, *, follows: bool) -> LeftCode | None:
        """Add the motion to a position, and the position if it is new; or return why it is left."""
        values = self.positions[number][self.group]
        if values.joints:
            return self._take_joints(number, values, line, kind)
        if any(name not in values.numbers for name in _POSE):
            remote = any(name in values.numbers for name in ("RX", "RY", "RZ"))
            return "unread" if remote else "partial"
        numbers = [values.numbers[name] for name in _POSE]
        if any(value is None for value, _ in numbers):
            return "partial"
        if [unit for _, unit in numbers] != ["mm"] * 3 + ["deg"] * 3:
            return "unread"
        if follows or any(value != 0.0 for value in values.external):
            return "external axes"
        T_base_frame, of_frame = self._numbered(values.frame, "UFRAME")
        T_tip_tool, of_tool = self._numbered(values.tool, "UTOOL")
        if of_frame or of_tool:
            return of_frame or of_tool
        if T_base_frame is None or T_tip_tool is None:
            return None  # the reader ends with a message that names it
        if number not in self.index:
            self._add(
                Target(
                    f"P[{number}]",
                    0,
                    values.line,
                    tuple(value for value, _ in numbers if value is not None),
                    (1e-3,) * 3 + (_SCALES["deg"],) * 3,
                    CONVENTIONS["fanuc"],
                    self._configuration(values),
                    self._dependent(values),
                ),
                number,
            )
        self._add_move(number, line, kind, T_tip_tool, T_base_frame)
        return None

    def _take_joints(self, number: int, values: _Values, line: int, kind: str) -> LeftCode | None:
        """Add the motion to joint values, and these if they are new; or return why it is left."""
        joints = values.joints
        if len(joints) != len(self.stated.joint_names):
            raise MeasurementError(
                f"{self.path}, line {values.line}: position P[{number}] has values of {len(joints)} joints, and the "
                f"robot has {len(self.stated.joint_names)}; give the robot of this program, or hold its other joints."
            )
        numbers = [values.numbers[name] for name in joints]
        if any(value is None for value, _ in numbers):
            return "partial"
        if any(unit not in _SCALES for _, unit in numbers):
            return "unread"
        if number not in self.index:
            self._add(
                Target(
                    f"P[{number}]",
                    0,
                    values.line,
                    tuple(value for value, _ in numbers if value is not None),
                    tuple(_SCALES[unit] for _, unit in numbers),
                ),
                number,
            )
        tool = None
        if values.tool.isdigit() and not self.computed["UTOOL"] & {values.tool, "*"}:
            tool = self.frames.tool(int(values.tool), needed=False)
        self._add_move(number, line, kind, tool, None)
        return None

    def _numbered(self, number: str, kind: str) -> tuple[Array | None, LeftCode | None]:
        """Return a tool or frame by its number, which ``F`` leaves to the program; or why it is not known."""
        if not number.isdigit():
            number = self.current[kind]
        if not number.isdigit() or self.computed[kind] & {str(int(number)), "*"}:
            return None, "computed"
        find: Callable[[int], Array | None] = (
            self.frames.frame if kind == "UFRAME" else self.frames.tool
        )
        return find(int(number)), None

    def _add(self, target: Target, number: int) -> None:
        """Add the target of a position."""
        self.index[number] = len(self.targets)
        self.targets.append(target)

    def _add_move(
        self,
        number: int,
        line: int,
        kind: str,
        T_tip_tool: Array | None,
        T_base_frame: Array | None,
    ) -> None:
        """Add a motion to the target of a position."""
        motions: dict[str, Motion] = {"J": "joint", "L": "linear", "S": "linear"}
        motion = motions.get(kind, "circular")
        self.moves.append(Move(self.index[number], 0, line, motion, T_tip_tool, T_base_frame))

    def _configuration(self, values: _Values) -> Configuration | None:
        """Return which joint values the configuration of a position allows."""
        if len(self.stated.joint_names) != 6 or not values.letters:
            return None
        letters, posture = values.letters, self.posture
        turns = [int(turn.value) for turn in values.turns] if len(values.turns) == 3 else []

        def allows(q: Array) -> Mask:
            """Return whether joint values (K, 6) [rad] are of the configuration."""
            mask = np.ones(len(q), dtype=bool)
            if "N" in letters:
                mask &= q[:, 4] < _STRAIGHT
            elif "F" in letters:
                mask &= q[:, 4] > -_STRAIGHT
            if posture is not None and set(letters) & set("UD"):
                mask &= posture.is_elbow_up(q, up="U" in letters)
            if posture is not None and set(letters) & set("TB"):
                mask &= posture.is_front(q, front="T" in letters)
            for joint, turn in zip(_TURNING, turns, strict=bool(turns)):
                mask &= np.floor((q[:, joint] + math.pi) / (2.0 * math.pi)) == turn
            return mask

        return allows

    def _dependent(self, values: _Values) -> tuple[tuple[NumberText, Callable[[Array], int]], ...]:
        """Return the turns of a position with their functions of the joint values."""
        if len(self.stated.joint_names) != 6 or len(values.turns) != 3:
            return ()

        def turn_of(joint: int) -> Callable[[Array], int]:
            """Return the function from joint values to the turns of one joint."""
            return lambda q: math.floor((float(q[joint]) + math.pi) / (2.0 * math.pi))

        return tuple(
            (number, turn_of(joint)) for number, joint in zip(values.turns, _TURNING, strict=True)
        )


# The controller's files


_VARIABLE = re.compile(r"^\[\*SYSTEM\*\]\$(MNUFRAME|MNUTOOL)\s.*$", re.MULTILINE)
_ELEMENT = re.compile(
    r"\[(\d+)\s*,\s*(\d+)\]\s*=[^\n]*\n\s*Group:[^\n]*\n"
    + r"\s*".join(rf"{name}:\s*({_NUMBER})" for name in _POSE[:3])
    + r"\s*"
    + r"\s*".join(rf"{name}:\s*({_NUMBER})" for name in _POSE[3:])
)
_LIST = re.compile(r"^(Tool|Jog|User) Frame[^\n]*$", re.MULTILINE)
_LIST_ROW = re.compile(rf"^[ \t]*({_NUMBER}(?:[ \t]+{_NUMBER}){{5}})", re.MULTILINE)


def _controller_frames(
    path: Path, stated: Stated, group: int
) -> tuple[dict[int, Array], dict[int, Array]]:
    """Return tools and frames of a motion group by number, from files that are given or lie beside the program."""
    tools: dict[int, Array] = {0: read_only(np.eye(4))}
    frames: dict[int, Array] = {0: read_only(np.eye(4))}
    beside = sorted(file for file in path.parent.iterdir() if file.name.lower() == "sysframe.va")
    for file in [*beside, *stated.data]:
        text = read_bytes(file, "data file").decode("latin-1")
        found = [*_of_variables(text, group), *_of_list(text)]
        if not found and file not in beside:
            raise MeasurementError(
                f"{file} has no tools or frames of a FANUC controller: give SYSFRAME.VA or FRAME.DG with --data."
            )
        for kind, number, pose in found:
            (tools if "TOOL" in kind.upper() else frames)[number] = pose
    return tools, frames


def _of_variables(text: str, group: int) -> Iterator[tuple[str, int, Array]]:
    """Yield the frames in the text of SYSFRAME.VA: kind, number, pose."""
    heads = list(_VARIABLE.finditer(text))
    for head in heads:
        end = text.find("\n[*", head.end())
        for element in _ELEMENT.finditer(text, head.end(), len(text) if end < 0 else end):
            if int(element[1]) == group:
                numbers = [float(value) for value in element.groups()[2:]]
                yield head[1], int(element[2]), pose_of_numbers(numbers, "fanuc")


def _of_list(text: str) -> Iterator[tuple[str, int, Array]]:
    """Yield the frames in the text of FRAME.DG, whose numbers are those of the rows; it has one decimal."""
    heads = list(_LIST.finditer(text))
    seen: set[str] = set()
    for i, head in enumerate(heads):
        if head[1] == "Jog" or head[1] in seen:
            continue
        seen.add(head[1])
        end = heads[i + 1].start() if i + 1 < len(heads) else len(text)
        for number, row in enumerate(_LIST_ROW.finditer(text, head.end(), end), start=1):
            numbers = [float(value) for value in row[1].split()]
            yield (
                head[1] + "Frame" if head[1] == "User" else "Tool",
                number,
                pose_of_numbers(numbers, "fanuc"),
            )
