"""Programs of KUKA: a ``.src``, its ``.dat``, and the controller's ``$config.dat`` and ``$machine.dat``.

Motions go to positions in the data list or to aggregates in the program itself. The tool and the base that are active
at each are followed through the ways of the program: the settings of inline forms (FDAT), BAS(#TOOL, n), $TOOL and
$BASE. With A, B, C about z, y, x and the robot's root in the world,

    T_base_frame = inv($ROBROOT) $BASE,    T_tip_tool = $TOOL

Status and turn of a pose count for motions by joints, and are told from joint values thus (bits from 0):

    status 0: the wrist is behind axis 1   1: axis 3 is bent forwards, beyond the line through the arm   2: A5 < 0
    turn i:   the value of axis i + 1 is below 0
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from calib.basics.arrays import Array, Mask, read_only, rigid_inverse
from calib.basics.files import read_bytes
from calib.data.forms.orientations import find_convention
from calib.errors import MeasurementError, choices
from calib.verbs.compensate.programs.arm_posture import ArmPosture
from calib.verbs.compensate.programs.flow import State, join, walk
from calib.verbs.compensate.programs.krl_syntax import (
    Aggregate,
    Expression,
    Other,
    Parser,
    Reference,
    Routine,
    Statement,
    routines,
    statements,
)
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

_DEG = np.pi / 180.0

_KUKA = find_convention("kuka")

_POSE = ("X", "Y", "Z", "A", "B", "C")

_EXTERNAL = ("E1", "E2", "E3", "E4", "E5", "E6")

_MOTIONS: Mapping[str, Motion] = {
    "PTP": "joint",
    "SPTP": "joint",
    "LIN": "linear",
    "SLIN": "linear",
    "SPL": "linear",
    "CIRC": "circular",
    "SCIRC": "circular",
}

#: Motions by an offset.
_RELATIVE = {f"{word}_REL" for word in _MOTIONS}

#: Where the robot is: a motion to it moves nothing.
_HERE = {
    "$POS_ACT",
    "$AXIS_ACT",
    "$POS_INT",
    "$AXIS_INT",
    "$POS_RET",
    "$AXIS_RET",
    "$AXIS_ACT_MEAS",
}

#: Joint values so close to zero are of both signs to the controller [rad].
_BOTH_SIGNS = 2.0 * _DEG

#: Wrist and elbow so close to where their bits change are of both [m], [m^2].
_CLOSE = 1e-4

#: Words that begin statements, declare variables, or are calls that move no robot.
_NO_CALL = {
    "BAS",
    "WAIT",
    "IF",
    "RETURN",
    "PULSE",
    "HALT",
    "DECL",
    "TRIGGER",
    "INTERRUPT",
    "ON_ERROR_PROCEED",
}

#: So do the controller's own routines for messages, texts, channels and monitoring begin, which move nothing either.
_OWN = (
    "MSG",
    "ERR_",
    "STR",
    "CWRITE",
    "SWRITE",
    "CREAD",
    "SREAD",
    "SET_",
    "RESET_",
    "EKI_",
    "H50",
    "H70",
    "P00",
    "A20",
)

#: Calls are followed to this depth, and while there are no more motions than so many.
_DEEPEST, _MOST_MOVES = 12, 200_000

#: Where an aggregate stands: its file, and the character of its first brace.
_Place: TypeAlias = "tuple[int, int]"

_State: TypeAlias = "Mapping[str, frozenset[Hashable]]"

#: The settings of a state, beside variables of the program: the tool and base, whether the tool is on the robot
#: ($IPO_MODE), and the settings of inline forms that BAS will make active. Tools and bases are pairs: "pose" and its
#: bytes, "name" and how an option states it, or "fault" and the code of what is left.
_TOOL, _BASE, _IPO, _FDAT = "tool", "base", "$IPO_MODE", "FDAT_ACT"

_KINDS = {"$TOOL": _TOOL, "$BASE": _BASE}

#: Not set by the program; an option without a name states it.
_UNSET = ("name", "$active")

_COMPUTED = ("fault", "computed")

#: A base on an external kinematic, or on a conveyor or another robot.
_EXTERNAL_BASE = ("fault", "external axes")
_MOVING_BASE = ("fault", "conveyor")

#: More combinations of tools and bases than these at one motion count as made by the program as it runs.
_MOST_COMBINATIONS = 6

#: Words that begin declarations.
_DECLARING = {"DECL", "GLOBAL", "CONST", "STRUC", "POS", "E6POS", "AXIS", "E6AXIS", "FRAME", "FDAT"}


def read(path: Path, stated: Stated) -> ProgramFile:
    """Read a program of KUKA.

    Args:
        path: The ``.src``; its ``.dat`` is looked for beside it, and ``$config.dat`` beside it or where the
            controller's archive has it.
        stated: What the files do not say; ``data`` may be any ``.dat`` or ``.src``.

    Returns:
        The program.

    Raises:
        FileError: A file cannot be read.
        MeasurementError: It is not a program, its robot has other joints, or tools and bases have to be stated.
    """
    return _Reader(path, stated).program()


def pose_of_fields(aggregate: Aggregate) -> Array | None:
    """Return the pose of a FRAME, shape (4, 4), read-only [m]; None if numbers are missing.

    Args:
        aggregate: Its fields X, Y, Z [mm], A, B, C [deg].
    """
    values = [aggregate.value(name) for name in _POSE]
    numbers = [value for value in values if value is not None]
    if len(numbers) < len(_POSE):
        return None
    T = np.eye(4)
    T[:3, 3] = np.array(numbers[:3]) * 1e-3
    T[:3, :3] = _KUKA.matrices(np.radians([numbers[3:]]))[0]
    return read_only(T)


def _find_files(path: Path) -> Iterator[Path]:
    """Yield the data list of a program, and the controller's configuration, as far as they are there."""
    beside = {}
    with contextlib.suppress(OSError):  # a folder may be read and not listed
        beside = {file.name.lower(): file for file in sorted(path.parent.iterdir())}
    for name in (path.stem.lower() + ".dat", "$config.dat", "$machine.dat"):
        if name in beside:
            yield beside[name]
    if "$config.dat" in beside:
        return
    for folder in path.resolve().parents:
        # KRC/R1/Program/..., KRC/R1/System
        for name in ("System", "system"):
            file = folder / name / "$config.dat"
            if file.is_file():
                yield file
                return


class _Reader:
    """State of the reading of one program."""

    def __init__(self, path: Path, stated: Stated) -> None:
        """Read all files, and find what they define."""
        self.path, self.stated = path, stated
        self.texts = [ProgramText(path, read_bytes(path, "program").decode("latin-1"))]
        seen = {path.resolve()}
        for other in [*_find_files(path), *stated.data]:
            if other.resolve() not in seen:
                seen.add(other.resolve())
                data = read_bytes(other, "data file")
                self.texts.append(ProgramText(other, data.decode("latin-1")))
        parsed = [list(statements(text, file)) for file, text in enumerate(self.texts)]
        self.axes = _axes_of(path, stated)
        self.posture = ArmPosture.of(stated.robot)

        #: Aggregates by where they stand, and those that data lists give to variables.
        self.aggregates: dict[_Place, Aggregate] = {}
        self.defined: dict[str, _Place] = {}
        self.lines = parsed[0]
        self.routines = routines(self.lines)
        self.jumps = any(line.words[0] == "GOTO" for lines in parsed for line in lines)
        self.by_name = {routine.name: routine for routine in self.routines if routine.name}
        for text, lines in zip(self.texts[1:], parsed[1:], strict=True):
            if text.path.suffix.lower() == ".src":
                for routine in routines(lines):
                    self.by_name.setdefault(routine.name, routine)
            else:
                for statement in lines:
                    self._define(statement)
        #: What the program itself gives to variables: aggregates by their place, or None for anything else.
        self.assigned: dict[str, set[_Place | None]] = {}
        for statement in parsed[0]:
            assignment = _assignment(statement)
            if assignment is not None:
                variable, value = assignment
                given = self.assigned.setdefault(variable.key or variable.name, set())
                given.add(self._given(variable, value))
        self.robroot = self._robroot()

        self.targets: list[Target] = []
        self.target_at: dict[_Place, int | LeftCode] = {}
        self.moves: list[Move] = []
        self.left: dict[Left, None] = {}
        self.missing: tuple[dict[str, None], dict[str, None]] = ({}, {})
        self.called: set[str] = set()
        self.frames: dict[bytes, Array] = {}
        self.seen: State = None

    # What files define

    def _keep(self, aggregate: Aggregate) -> _Place:
        """Keep an aggregate, and return its place."""
        place = (aggregate.file, aggregate.start)
        self.aggregates.setdefault(place, aggregate)
        return place

    def _given(self, variable: Reference, value: Expression) -> _Place | None:
        """Return the place of the aggregate that a variable is set to; None if it is set otherwise, or in part."""
        if isinstance(value, Aggregate) and not variable.field and variable.key:
            return self._keep(value)
        return None

    def _define(self, statement: Statement) -> None:
        """Keep the aggregates that a statement of a data list gives to variables."""
        parser = Parser(statement)
        while parser.at < len(statement.tokens):
            if parser.kind() != "word" or parser.peek(1) not in ("=", "["):
                parser.at += 1
                continue
            variable = parser.expression()
            if parser.peek() != "=" or not isinstance(variable, Reference):
                continue
            parser.at += 1
            value = parser.expression()
            place = self._given(variable, value)
            if place is not None and variable.key:
                self.defined.setdefault(variable.key, place)

    def _robroot(self) -> Array:
        """Return the robot's root in the world, shape (4, 4) [m]."""
        if "$ROBROOT" in self.stated.frames:
            return self.stated.frames["$ROBROOT"]
        place = self.defined.get("$ROBROOT")
        T = None if place is None else pose_of_fields(self.aggregates[place])
        return np.eye(4) if T is None else T

    # The ways through the program

    def program(self) -> ProgramFile:
        """Go through all routines, and return the program."""
        if not any(routine.name for routine in self.routines):
            has_motion = any(
                isinstance(node, Statement) and node.tokens[0].text in _MOTIONS
                for routine in self.routines
                for node in routine.body
            )
            if not has_motion:
                raise MeasurementError(
                    f"{self.path}: this is not a program of KUKA's robot language: it has no routine, DEF NAME()."
                )
        start: dict[str, frozenset[Hashable]] = {
            _TOOL: frozenset([_UNSET]),
            _BASE: frozenset([_UNSET]),
            _IPO: frozenset(["#BASE"]),
            _FDAT: frozenset([None]),
        }
        for key, values in self.assigned.items():
            # A data list keeps what the program has set when it ran before.
            first = {*values, self.defined[key]} if key in self.defined else values
            start[key] = frozenset(first)
        started = {name for line in self.lines for name in _started_by(line)}
        for number, routine in enumerate(self.routines):
            if number == 0:
                self._run_routine(routine, start, 0)
            elif routine.name not in self.called:
                # An interrupt or a trigger finds what the program has set; others may be called from anywhere.
                before = [] if routine.name in started else [start]
                self._run_routine(routine, join([*before, self.seen]), 0)
        self._check_missing()
        return self._of_files()

    def _of_files(self) -> ProgramFile:
        """Return the program with only those files that are its own, hold targets, or have lines that are left."""
        used = {0, *(target.file for target in self.targets)}
        used |= {move.file for move in self.moves} | {item.file for item in self.left}
        for k, text in enumerate(self.texts):
            if text.path.stem.lower() == self.path.stem.lower():
                used.add(k)
        files = sorted(used)
        place = {file: k for k, file in enumerate(files)}
        return ProgramFile(
            tuple(self.texts[k] for k in files),
            tuple(replace(target, file=place[target.file]) for target in self.targets),
            tuple(replace(move, file=place[move.file]) for move in self.moves),
            tuple(replace(item, file=place[item.file]) for item in self.left),
        )

    def _run_routine(self, routine: Routine, state: State, depth: int) -> State:
        """Run a routine in a state, and return the state after it."""
        end = self._through(routine, state, depth, is_trial=False)
        self.seen = join([self.seen, end])
        return end

    def _through(self, routine: Routine, state: State, depth: int, *, is_trial: bool) -> State:
        """Go the ways through a routine from a state, and return the state behind it."""
        self.called.add(routine.name)
        labels: dict[str, State] = {}
        exits: list[State] = []
        before = [state]  # the state before a statement by the text, for what nothing reaches

        def run(statement: Statement, now: State, inside_trial: bool) -> State:
            """Run one statement."""
            words = statement.words
            if words[1:] == (":",):
                now = join([now, labels.get(words[0])])
                before[0] = before[0] if now is None else now
                return now
            here = (before[0] if now is None else now) or {}
            if words[0] == "GOTO" and len(words) > 1:
                labels[words[1]] = join([now, labels.get(words[1])])
            elif words[0] == "RETURN":
                exits.append(now)
            else:
                after = self._run(statement, here, depth, is_trial=is_trial or inside_trial)
                before[0] = here if after is None else after
                return None if now is None else after
            before[0] = here
            return None

        known = None
        while self.jumps and known != labels:  # a label further up is reached from further down
            known = dict(labels)
            walk(routine.body, state, run, is_trial=True)
        end = walk(routine.body, state, run, is_trial=is_trial)
        return join([*exits, end])

    def _run(self, statement: Statement, state: _State, depth: int, *, is_trial: bool) -> State:
        """Run one statement in a state, and return the state after it."""
        word = statement.tokens[0].text
        if word in _MOTIONS or word in _RELATIVE or word == "ASYPTP":
            if not is_trial:
                self._motion(statement, state)
            return state
        assignment = _assignment(statement)
        if assignment is not None:
            return self._assign(*assignment, state)
        if word == "SPLINE":
            return self._with(statement, state)
        if len(statement.tokens) > 1 and statement.tokens[1].text == "(":
            arguments = Parser(statement, 1).arguments()
            if word == "BAS":
                return self._bas(arguments, state)
            if word not in _NO_CALL:
                return self._call(statement, arguments, state, depth, is_trial=is_trial)
        return state

    def _assign(self, variable: Reference, value: Expression, state: _State) -> _State:
        """Return the state after an assignment."""
        new = dict(state)
        if variable.name in _KINDS:
            kind = _KINDS[variable.name]
            found = {_COMPUTED} if variable.field else self._frames(value, kind, state)
            new[kind] = frozenset(found)
        elif variable.name == "$IPO_MODE":
            new[_IPO] = frozenset([_word(value)])
        elif variable.name == "FDAT_ACT":
            if not variable.field:
                new[_FDAT] = frozenset(self._values(value, state))
        elif not variable.name.startswith("$"):
            key = variable.key or variable.name
            new[key] = frozenset([self._given(variable, value)])
            if variable.key is None:
                # Any element of the array may be set.
                for other in [*self.defined, *new]:
                    if other.startswith(f"{variable.name}["):
                        new[other] = frozenset([*self._known(other, state), None])
        return new

    def _known(self, key: str, state: _State) -> frozenset[Hashable]:
        """Return what a variable may be: places of aggregates, None for anything else; empty if nothing is known."""
        if key in state:
            return state[key]
        return frozenset([self.defined[key]] if key in self.defined else [])

    def _values(self, value: Expression, state: _State) -> list[Hashable]:
        """Return what an expression may be: places of aggregates; or its text if nothing is known."""
        if isinstance(value, Aggregate):
            return [self._keep(value)]
        if isinstance(value, Reference) and value.key and not value.field:
            found = self._known(value.key, state)
            if found:
                return [value.key if item is None else item for item in found]
            return [value.key]
        return [_word(value)]

    def _bas(self, arguments: tuple[Expression, ...], state: _State) -> _State:
        """Return the state after a call of BAS, the controller's own routine for settings."""
        command = _word(arguments[0]) if arguments else ""
        second = _word(arguments[1]) if len(arguments) > 1 else ""
        new = dict(state)
        if command == "#INITMOV":
            new.update({_BASE: frozenset([_WORLD]), _TOOL: frozenset([_UNSET])})
            new[_IPO] = frozenset(["#BASE"])
        elif command in ("#TOOL", "#BASE"):
            kind = _KINDS[f"${command[1:]}"]
            new[kind] = frozenset(self._numbered(kind, second, state))
        elif command == "#EX_BASE":
            new[_BASE] = frozenset([_EXTERNAL_BASE])
        elif command in ("#FRAMES", "#PTP_PARAMS", "#CP_PARAMS"):
            new.update(self._of_fdat(state.get(_FDAT, frozenset()), state))
        return new

    def _of_fdat(self, settings: Iterable[Hashable], state: _State) -> _State:
        """Return the tools, bases and modes that settings of inline forms (FDAT) make active."""
        tools, bases, modes = set[Hashable](), set[Hashable](), set[Hashable]()
        for setting in settings:
            if setting is None:
                return {}
            if isinstance(setting, str):
                tools.add(("name", setting))
                bases.add(("name", setting))
                modes.add("#BASE")
                continue
            fdat = self.aggregates[setting]  # type: ignore[index]
            for kind, found in (("TOOL", tools), ("BASE", bases)):
                number = fdat.value(f"{kind}_NO")
                text = str(int(number)) if number is not None else ""
                found.update(self._numbered(_KINDS[f"${kind}"], text, state))
            modes.add(fdat.others.get("IPO_FRAME", "#BASE").replace(" ", ""))
        return {_TOOL: frozenset(tools), _BASE: frozenset(bases), _IPO: frozenset(modes)}

    def _numbered(self, kind: str, number: str, state: _State) -> list[Hashable]:
        """Return the tool or base of a number, given as text."""
        if not re.fullmatch(r"-?\d+", number):
            return [_COMPUTED]
        if int(number) <= 0:
            return [_WORLD]
        option = self.stated.tools if kind == _TOOL else self.stated.frames
        if number in option:
            return [_pose(option[number])]
        name = f"{kind.upper()}_DATA[{number}]"
        found = self._known(name, state)
        if not found:
            return [("name", number)]
        return [self._frame_at(item, name) for item in found]

    def _frame_at(self, place: Hashable, name: str) -> Hashable:
        """Return the frame of an aggregate at a place; None: it is computed."""
        if place is None:
            return _COMPUTED
        T = pose_of_fields(self.aggregates[place])  # type: ignore[index]
        return ("name", name) if T is None else _pose(T)

    def _frames(self, value: Expression, kind: str, state: _State) -> set[Hashable]:
        """Return the tools or bases that an expression may be."""
        parts = value if isinstance(value, tuple) else (value,)
        possible: set[Hashable] = {_WORLD}
        for part in parts:
            own = self._frame(part, kind, state)
            if len(own) * len(possible) > _MOST_COMBINATIONS:
                return {_COMPUTED}
            possible = {_product(before, after) for before in possible for after in own}
        return possible

    def _frame(
        self, part: Aggregate | Reference | Other, kind: str, state: _State
    ) -> set[Hashable]:
        """Return the frames that one factor of an expression may be."""
        if isinstance(part, Aggregate):
            T = pose_of_fields(part)
            return {_COMPUTED if T is None else _pose(T)}
        if not isinstance(part, Reference) or part.field:
            return {_COMPUTED}
        name = part.name
        if name in _KINDS:
            return set(state.get(_KINDS[name], {_UNSET}))
        if name in ("$NULLFRAME", "$WORLD"):
            return {_WORLD}
        if name == "$ROBROOT":
            return {_pose(self.robroot)}
        if name in ("STOOL2", "STOOL", "SBASE") and part.arguments:
            return self._of_function(part, kind, state)
        if name in ("EK", "EB", "LK", "EB_ABS"):
            return {_EXTERNAL_BASE if name == "EK" else _MOVING_BASE}
        if part.arguments is not None or part.key is None:
            return {_COMPUTED}
        data = re.fullmatch(r"(TOOL|BASE)_DATA\[(\d+)\]", part.key)
        if data is not None:
            return set(self._numbered(_KINDS[f"${data[1]}"], data[2], state))
        found = self._known(part.key, state)
        if not found:
            option = self.stated.tools if kind == _TOOL else self.stated.frames
            named = {key.upper(): T for key, T in option.items()}
            return {_pose(named[part.key]) if part.key in named else ("name", part.key)}
        return {self._frame_at(item, part.key) for item in found}

    def _of_function(self, call: Reference, kind: str, state: _State) -> set[Hashable]:
        """Return the frames of STOOL2(FP1), STOOL(1) or SBASE(FP1.BASE_NO)."""
        argument = call.arguments[0] if call.arguments else Other("")
        if isinstance(argument, Reference):
            settings = self._values(Reference(argument.name, argument.index), state)
            return set(self._of_fdat(settings, state).get(kind, {_COMPUTED}))
        return set(self._numbered(kind, _word(argument), state))

    def _with(self, statement: Statement, state: _State) -> _State:
        """Return the state with the settings behind WITH in a motion or spline of its own."""
        texts = [token.text for token in statement.tokens]
        if "WITH" not in texts:
            return state
        parser = Parser(statement, texts.index("WITH") + 1)
        new = state
        while parser.at < len(statement.tokens):
            before = parser.at
            variable = parser.expression()
            if parser.peek() == "=" and isinstance(variable, Reference):
                parser.at += 1
                value = parser.expression()
                if variable.name == "$IPO_MODE" and isinstance(value, Reference):
                    argument = (value.arguments or (Other(""),))[0]
                    if isinstance(argument, Reference):
                        settings = self._values(Reference(argument.name, argument.index), state)
                        modes = self._of_fdat(settings, state).get(_IPO, frozenset(["#BASE"]))
                        new = {**new, _IPO: modes}
                elif variable.name in (*_KINDS, "$IPO_MODE"):
                    new = self._assign(variable, value, new)
            parser.at += parser.at == before
        return new

    def _call(
        self,
        statement: Statement,
        arguments: tuple[Expression, ...],
        state: _State,
        depth: int,
        *,
        is_trial: bool,
    ) -> State:
        """Return the state after a call of a routine."""
        name = statement.tokens[0].text
        routine = self.by_name.get(name)
        if routine is None:
            if not (is_trial or name in self.called or name.startswith(_OWN)):
                self.called.add(name)
                self._leave(statement, "other file", f"{name}()")
            return state
        new = dict(state)
        ways = list(routine.parameters.items())
        for k, argument in enumerate(arguments):
            goes_in_only = k >= len(ways) or ways[k][1]
            if isinstance(argument, Reference) and argument.key and not goes_in_only:
                new[argument.key] = frozenset([None])
        if depth >= _DEEPEST or (len(self.moves) > _MOST_MOVES and name in self.called):
            return new
        inner = dict(new)
        for k, (parameter, _) in enumerate(ways):
            given = arguments[k] if k < len(arguments) else Other("")
            values = self._values(given, state)
            inner[parameter] = frozenset(None if isinstance(v, str) else v for v in values)

        return self._through(routine, inner, depth + 1, is_trial=is_trial)

    # Motions

    def _leave(self, statement: Statement, code: LeftCode, what: str) -> None:
        """Name what stays as it is."""
        self.left[Left(statement.file, statement.line, code, what)] = None

    def _motion(self, statement: Statement, state: _State) -> None:
        """Keep the motion of a statement, or name it."""
        word = statement.tokens[0].text
        if word == "ASYPTP":
            self._leave(statement, "external axes", word)
            return
        if word in _RELATIVE:
            self._leave(statement, "relative", word)
            return
        now = self._with(statement, state)
        parser = Parser(statement, 1)
        count = 2 if word in ("CIRC", "SCIRC") else 1
        for _ in range(count):
            expression = parser.expression()
            if parser.peek() == ",":
                parser.at += 1
            self._go(statement, _MOTIONS[word], expression, now)

    def _go(self, statement: Statement, motion: Motion, where: Expression, state: _State) -> None:
        """Keep a motion to where an expression says, or name it."""
        if isinstance(where, tuple):
            self._leave(statement, "relative", _word(where))
            return
        if isinstance(where, Reference) and where.name in _HERE and not where.field:
            return
        if not isinstance(where, (Aggregate, Reference)):
            self._leave(statement, "computed", _word(where))
            return
        name = "" if isinstance(where, Aggregate) else str(where)
        places: Iterable[Hashable]
        if isinstance(where, Aggregate):
            places = [self._keep(where)]
        elif where.arguments is not None or where.key is None or where.field:
            self._leave(statement, "computed", _word(where))
            return
        else:
            places = self._known(where.key, state)
        if not places:
            is_own = where.name.startswith("$")  # type: ignore[union-attr]
            self._leave(statement, "computed" if is_own else "other file", name)
            return
        if None in places:
            self._leave(statement, "computed", name)
            return
        for place in sorted(places):  # type: ignore[type-var]
            self._go_to(statement, motion, place, name, state)  # type: ignore[arg-type]

    def _go_to(
        self, statement: Statement, motion: Motion, place: _Place, name: str, state: _State
    ) -> None:
        """Keep a motion to an aggregate, with all tools and bases that may be active."""
        number = self._target(place, name)
        if isinstance(number, str):
            self._leave(statement, number, name)
            return
        target = self.targets[number]
        tools = sorted(state.get(_TOOL, {_UNSET}), key=repr)
        if target.convention is None:
            T = None
            if len(tools) == 1 and _fault(tools[0]) is None:
                T = self._resolve(tools[0], _TOOL, needed=False)
            self.moves.append(Move(number, statement.file, statement.line, motion, T))
            return
        bases = sorted(state.get(_BASE, {_UNSET}), key=repr)
        modes = state.get(_IPO, {"#BASE"})
        if modes != {"#BASE"}:
            mode = "#TCP" if "#TCP" in modes else "computed"
            code: LeftCode = "external tool" if mode == "#TCP" else "computed"
            self._leave(statement, code, f"{name} $IPO_MODE")
            return
        if len(tools) * len(bases) > _MOST_COMBINATIONS:
            self._leave(statement, "computed", f"{name} $TOOL, $BASE")
            return
        for tool in tools:
            for base in bases:
                faults = [fault for fault in map(_fault, (tool, base)) if fault is not None]
                if faults:
                    self._leave(statement, faults[0], name)
                    return
                T_tool, T_base = self._resolve(tool, _TOOL), self._resolve(base, _BASE)
                if T_tool is None or T_base is None:
                    continue  # missing, which is said at the end
                T_frame = self._in_base(T_base)
                self.moves.append(
                    Move(number, statement.file, statement.line, motion, T_tool, T_frame)
                )

    def _resolve(self, frame: Hashable, kind: str, *, needed: bool = True) -> Array | None:
        """Return the pose of a tool or base, shape (4, 4) [m]; None: it has to be stated, if it is ``needed``."""
        assert isinstance(frame, tuple)
        what, value = frame
        if what == "pose":
            return _array(value)
        option = self.stated.tools if kind == _TOOL else self.stated.frames
        for name in (value, ""):
            if name in option:
                return option[name]
        if needed:
            self.missing[kind == _BASE][value] = None
        return None

    def _in_base(self, T_world_frame: Array) -> Array:
        """Return T_base_frame, shape (4, 4), read-only [m], of a base in the world, made once for each base."""
        key = T_world_frame.tobytes()
        if key not in self.frames:
            self.frames[key] = read_only(rigid_inverse(self.robroot) @ T_world_frame)
        return self.frames[key]

    def _check_missing(self) -> None:
        """Name all tools and bases that are not known, by a `MeasurementError`."""
        tools, bases = self.missing
        if not tools and not bases:
            return
        what, options = [], []
        for names, word, option in ((tools, "tool", "--tool"), (bases, "base", "--frame")):
            if names:
                what.append(f"{word} {choices(names)}")
                options.append(f'{option} "{next(iter(names))}=0 0 0 mm 0 0 0 deg"')
        raise MeasurementError(
            f"{self.path}: the files do not define {' and '.join(what)} of the program. Give the controller's "
            f"$config.dat with --data, or state each: {' and '.join(options)} (a rotation vector; with --orientation "
            "kuka A B C)."
        )

    # Targets

    def _target(self, place: _Place, name: str) -> int | LeftCode:
        """Return the index of the target at a place, or why it cannot be one."""
        if place not in self.target_at:
            target = self._made_target(self.aggregates[place], name)
            if isinstance(target, Target):
                self.targets.append(target)
                self.target_at[place] = len(self.targets) - 1
            else:
                self.target_at[place] = target
        return self.target_at[place]

    def _made_target(self, aggregate: Aggregate, name: str) -> Target | LeftCode:
        """Return the target of an aggregate, or why it cannot be one."""
        external = [axis for axis in _EXTERNAL if axis not in self.axes]
        if any(aggregate.value(axis) or axis in aggregate.others for axis in external):
            return "external axes"
        fields = aggregate.numbers
        if any(field in aggregate.others for field in (*_POSE, *self.axes)):
            return "computed"
        if all(axis in fields for axis in self.axes):
            scales = tuple(self._scale(k) for k in range(len(self.axes)))
            numbers = tuple(fields[axis] for axis in self.axes)
            return Target(name, aggregate.file, aggregate.line, numbers, scales)
        if all(field in fields for field in _POSE):
            if any(axis.startswith("E") for axis in self.axes):
                return "external axes"
            numbers = tuple(fields[field] for field in _POSE)
            scales = (1e-3,) * 3 + (_DEG,) * 3
            dependent: tuple[tuple[NumberText, Callable[[Array], int]], ...] = ()
            if "T" in fields and len(self.axes) == 6:
                dependent = ((fields["T"], _turn_of),)
            return Target(
                name,
                aggregate.file,
                aggregate.line,
                numbers,
                scales,
                _KUKA,
                self._configuration(aggregate),
                dependent,
            )
        return "partial"

    def _scale(self, k: int) -> float:
        """Return the SI units in one unit of an axis."""
        robot = self.stated.robot
        if robot is not None and robot.joint_types[robot.joint_names[k]] == "prismatic":
            return 1e-3
        return _DEG

    def _configuration(self, aggregate: Aggregate) -> Configuration | None:
        """Return which joint values status and turn of a pose allow; None if it has neither."""
        status, turn = aggregate.value("S"), aggregate.value("T")
        if len(self.axes) != 6 or (status is None and turn is None):
            return None
        posture = self.posture

        def allows(q: Array) -> Mask:
            """Return whether joint values (K, 6) [rad] are of this status and turn."""
            allowed = np.ones(len(q), dtype=bool)
            if status is not None:
                bits = int(status)
                allowed &= _has_sign(q[:, 4], negative=bool(bits & 4))
                if posture is not None:
                    front, elbow = posture.signed(q)
                    allowed &= front < _CLOSE if bits & 1 else front > -_CLOSE
                    allowed &= elbow > -_CLOSE if bits & 2 else elbow < _CLOSE
            if turn is not None:
                for axis in range(6):
                    allowed &= _has_sign(q[:, axis], negative=bool(int(turn) >> axis & 1))
            return allowed

        return allows


def _turn_of(q: Array) -> int:
    """Return the turn of joint values, shape (6,) [rad]: a bit for each that is below zero."""
    return sum(1 << axis for axis in range(6) if q[axis] < 0.0)


def _has_sign(values: Array, *, negative: bool) -> Mask:
    """Return whether joint values (K,) [rad] are below zero, or not; close to zero they are both."""
    return np.asarray(values < _BOTH_SIGNS if negative else values > -_BOTH_SIGNS)


def _axes_of(path: Path, stated: Stated) -> tuple[str, ...]:
    """Return the controller's names of the robot's joints, A1 to A6 or E1 to E6, in their order."""
    found = [re.search(r"(?:^|[^a-z0-9])([ae][1-6])$", name.lower()) for name in stated.joint_names]
    names = [match[1].upper() for match in found if match]
    if len(names) == len(stated.joint_names) == len(set(names)):
        return tuple(names)
    if len(stated.joint_names) == 6:
        return tuple(f"A{axis}" for axis in range(1, 7))
    raise MeasurementError(
        f"{path}: the robot has {len(stated.joint_names)} joints, {choices(stated.joint_names)}, and the program names "
        "axes A1 to A6 and E1 to E6. Rename its joints so that they end in these names, such as joint_a1, or hold "
        'those that do not move: --hold "joint=0 deg".'
    )


def _assignment(statement: Statement) -> tuple[Reference, Expression] | None:
    """Return variable and value of an assignment, also of one in a declaration; None if it is none."""
    tokens = statement.tokens
    at = 0
    while at + 1 < len(tokens) and tokens[at].kind == "word" and tokens[at + 1].kind == "word":
        at += 1  # DECL, GLOBAL, CONST and the type
    if tokens[at].kind != "word":
        return None
    if at > 0 and tokens[0].text not in _DECLARING:
        return None
    parser = Parser(statement, at)
    variable = parser.expression()
    if parser.peek() != "=" or not isinstance(variable, Reference) or variable.arguments:
        return None
    parser.at += 1
    return variable, parser.expression()


def _started_by(statement: Statement) -> list[str]:
    """Return the routine that an interrupt or a trigger starts: ``INTERRUPT DECL 3 WHEN ... DO NAME ( )``."""
    words = [token.text for token in statement.tokens]
    if not {"INTERRUPT", "TRIGGER"} & set(words[:3]) or "DO" not in words:
        return []
    return words[words.index("DO") + 1 :][:1]


def _word(value: Expression) -> str:
    """Return an expression as text, for messages and for comparisons."""
    if isinstance(value, tuple):
        return " : ".join(map(_word, value))
    if isinstance(value, Aggregate):
        return "{...}"
    if isinstance(value, Reference):
        return str(value) + ("(...)" if value.arguments else "")
    return value.text


def _pose(T: Array) -> Hashable:
    """Return a pose, shape (4, 4) [m], as a tool or base of the state."""
    return ("pose", np.ascontiguousarray(T, dtype=np.float64).tobytes())


def _array(data: Hashable) -> Array:
    """Return the pose, shape (4, 4), read-only [m], of the bytes of one."""
    assert isinstance(data, bytes)
    return read_only(np.frombuffer(data).reshape(4, 4))


_WORLD = _pose(np.eye(4))


def _fault(frame: Hashable) -> LeftCode | None:
    """Return the code of why a tool or base is not known; None if it is, or has to be stated."""
    assert isinstance(frame, tuple)
    return frame[1] if frame[0] == "fault" else None


def _product(before: Hashable, after: Hashable) -> Hashable:
    """Return the product of two frames; what is not known of one is not known of the product."""
    assert isinstance(before, tuple)
    assert isinstance(after, tuple)
    if before == _WORLD:
        return after
    for frame in (before, after):
        if frame[0] != "pose":
            return frame if frame[0] == "fault" else _COMPUTED
    return _pose(_array(before[1]) @ _array(after[1]))
