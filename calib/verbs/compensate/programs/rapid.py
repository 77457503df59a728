"""Programs in ABB's RAPID: robtargets and jointtargets, the motions to them, and the tools and work objects of these.

With the tool and the work object of a motion, in mm and quaternions,

    T_tip_tool = tframe,    T_base_frame = T_base_world uframe oframe

where the world is the robot's base unless the frame ``wobj0`` is stated. The quadrants cf1, cf4 and cf6 of a robtarget
are those of the axes 1, 4 and 6, and bits of cfx say whether axis 5 is negative and the elbow bent the other way.

Procedures are followed where they are called, with the targets that they are called with, from ``main`` on. What
instructions set on the way (a displacement, ConfL, a force) holds for the motions behind them.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from calib.basics.arrays import Array, Mask, read_only
from calib.basics.files import read_bytes
from calib.data.forms.orientations import CONVENTIONS
from calib.errors import MeasurementError
from calib.numerics.geometry import to_matrices
from calib.verbs.compensate.programs.arm_posture import ArmPosture
from calib.verbs.compensate.programs.flow import State, join, walk
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
    readable,
)
from calib.verbs.compensate.programs.rapid_instructions import HARMLESS
from calib.verbs.compensate.programs.rapid_syntax import (
    Aggregate,
    Assignment,
    Call,
    Control,
    Data,
    Module,
    Number,
    Other,
    Reference,
    Routine,
    Statement,
    Text,
    Token,
    Value,
    moves_after_modules,
    read_modules,
    split,
    statements,
    value_of,
)

#: Endings of the names of modules.
_ENDINGS = (".mod", ".modx", ".sys", ".sysx", ".prg")

#: Folders of a task's modules in a backup.
_BACKUP = ("progmod", "sysmod")

#: Numbers from here on say that there is no value: ``9E9``.
_NONE = 1e8

#: Joint values may be in the next quadrant by this: digits that were not written [deg].
_TOLERANCE = 1.0

#: The place of axis 7 of arms with seven joints in their chain, from 0: external axis a of ABB's data.
_AXIS_7 = 2

#: Procedures are followed so deep.
_DEEPEST = 40

#: Names and types of the components of records that hold or make up targets.
_RECORDS = MappingProxyType(
    {
        "robtarget": (
            ("trans", "pos"),
            ("rot", "orient"),
            ("robconf", "confdata"),
            ("extax", "extjoint"),
        ),
        "jointtarget": (("robax", "robjoint"), ("extax", "extjoint")),
    }
)

_TARGETS = tuple(_RECORDS)

#: A linear, circular or joint motion: its name, and what ends it beside the motion.
_MOTION = re.compile(
    r"(?:move|trigg|arc[0-9x]?|arcmove|cap|disp|paint|spot|spotm|grip|laser|lasw)"
    r"(absj|l|j|c)(?:start|end|do|ao|go|sync|ios|[0-9])*"
)

#: Those that go to their targets by joints, on lines, on arcs.
_KINDS: MappingProxyType[str, Motion] = MappingProxyType(
    {"absj": "joint", "j": "joint", "l": "linear", "c": "circular"}
)

#: Motions whose tool is followed by other arguments.
_TOOL_INSIDE = re.compile(r"move(l|j|c)(do|ao|go|sync)")

#: Instructions that move the robot, and why their numbers stay as they are.
_OTHER_MOTIONS: MappingProxyType[str, LeftCode] = MappingProxyType(
    {
        "searchl": "search",
        "searchj": "search",
        "searchc": "search",
        "triggsearchl": "search",
        "egmmovel": "computed",
        "egmmovec": "computed",
        "egmrunjoint": "computed",
        "egmrunpose": "computed",
        "egmrunstream": "computed",
        "pathrecmovebwd": "unread",
        "pathrecmovefwd": "unread",
        "movepnp": "unread",
        "moveextj": "external axes",
        "indamove": "external axes",
        "indrmove": "external axes",
        "indcmove": "external axes",
        "inddmove": "external axes",
        "fcpressl": "force",
        "fcpressl1lstart": "force",
        "fcpress1lstart": "force",
        "fcpressc": "force",
        "fcpressend": "force",
        "fcrefline": "force",
        "fcrefcircle": "force",
        "fcrefspiral": "force",
        "fcrefstart": "force",
        "jog": "unread",
    }
)

#: Instructions after which motions are displaced, or led by a force, and those that end it: setting, value.
_SETTINGS: MappingProxyType[str, tuple[str, bool]] = MappingProxyType(
    {
        "pdispon": ("displaced", True),
        "pdispset": ("displaced", True),
        "pdispoff": ("displaced", False),
        "fcact": ("forced", True),
        "fcdeact": ("forced", False),
        "cssact": ("forced", True),
        "cssactmove": ("forced", True),
        "cssdeact": ("forced", False),
        "cssdeactmove": ("forced", False),
    }
)

#: Settings at the beginning of a program.
_START = MappingProxyType(
    {
        name: frozenset({value})
        for name, value in (
            ("displaced", False),
            ("forced", False),
            ("confl", True),
            ("confj", True),
        )
    }
)

#: Instructions and functions that write into an argument, by its place from 0.
_WRITERS = MappingProxyType(
    {
        "searchl": 1,
        "searchj": 1,
        "searchc": 1,
        "triggsearchl": 1,
        "getdataval": 1,
        "setdataval": 0,
        "strtoval": 1,
        "unpackrawbytes": 2,
        "readrawbytes": 1,
        "mtooltcpcalib": 4,
        "mtoolrotcalib": 3,
        "stooltcpcalib": 4,
        "stoolrotcalib": 3,
    }
)

#: Instructions whose targets describe a region or a measurement.
_NO_MOTION_OF_TARGETS = re.compile(r"wz.*|.*calib|safety.*")

#: Work objects on conveyors are named so by their unit.
_CONVEYOR = re.compile(r"cnv|conv|indcnv", re.IGNORECASE)


@dataclass(frozen=True, slots=True, eq=False)
class _Scope:
    """Scope of names: a routine of a module, with the arguments that it was called with."""

    module: Module
    routine: Routine | None = None
    #: Arguments by the names of parameters.
    arguments: dict[str, _Argument] = field(default_factory=dict)

    @property
    def key(self) -> Hashable:
        """Key by which scopes differ."""
        given = tuple(sorted((name, item.key) for name, item in self.arguments.items()))
        return self.module.file, id(self.module), id(self.routine), given


@dataclass(frozen=True, slots=True, eq=False)
class _Argument:
    """A value that a routine is called with, and where its names are looked up."""

    value: Value
    scope: _Scope

    @property
    def key(self) -> Hashable:
        """Key by which arguments differ."""
        return self.scope.module.file, self.value.start


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """A value in a text, or why there is none."""

    #: Name of the data and part of it, as messages name it; empty for a value that has none.
    name: str
    value: Value | None
    scope: _Scope
    #: The data that it is a part of; None for a value that has no name.
    data: Data | None = None
    code: LeftCode | None = None


@dataclass(frozen=True, slots=True)
class _Unknown:
    """A tool or work object that is not known, or not one of a robot that holds its tool, and why."""

    code: LeftCode
    name: str


@dataclass(frozen=True, slots=True, eq=False)
class _Visit:
    """A statement that runs in a scope, and the settings that are possible then."""

    call: Call
    scope: _Scope
    state: State


def read(path: Path, stated: Stated) -> ProgramFile:
    """Read a RAPID module, and the modules of ``stated.data``.

    Tools and work objects that these do not define are taken from the modules beside the file.

    Args:
        path: The module.
        stated: What options say of the program.

    Returns:
        The program.

    Raises:
        MeasurementError: It is not RAPID, or tools or frames are not known.
        FileError: A file cannot be read.
    """
    if len(stated.joint_names) not in (6, 7):
        raise MeasurementError(
            f"{path}: RAPID programs are corrected for arms of six or seven joints; the chain has "
            f"{len(stated.joint_names)} ({', '.join(stated.joint_names)}). Choose another --base or --tip."
        )
    texts, modules = [], []
    for file, source in enumerate((path, *stated.data)):
        text = _text(source)
        found = read_modules(text, file)
        if not found:
            raise MeasurementError(
                f"{source}: this is no RAPID module, which begins with MODULE and its name, and ends with ENDMODULE. "
                "Save the module in RobotStudio or on the pendant; other languages share the ending."
            )
        texts.append(ProgramText(source, text))
        modules += found
    return _Program(tuple(texts), modules, stated).read()


def _text(path: Path) -> str:
    """Return the text of a file; UTF-16 raises `MeasurementError`."""
    text = read_bytes(path, "RAPID module").decode("latin-1")
    if text[:2] in ("\xff\xfe", "\xfe\xff"):
        raise MeasurementError(f"{path}: this text is UTF-16; save it as ANSI or UTF-8.")
    return text


class _Program:
    """The modules of a program, and what they say of its motions."""

    def __init__(
        self, texts: tuple[ProgramText, ...], modules: list[Module], stated: Stated
    ) -> None:
        """Find the data that change as the program runs."""
        self._texts = texts
        self._modules = modules
        self._stated_tools = {name.lower(): T for name, T in stated.tools.items()}
        self._stated_frames = {name.lower(): T for name, T in stated.frames.items()}
        self._joint_names = stated.joint_names
        self._posture = ArmPosture.of(stated.robot)
        self._line_ends = [[m.start() for m in re.finditer("\n", item.text)] for item in texts]
        self._siblings: list[Module] | None = None
        #: Data and parameters that change, by the module, the routine (0: of the module) and the name.
        self._changed: set[tuple[int, int, str]] = set()
        self._visits: dict[Hashable, _Visit] = {}
        self._returns: dict[Hashable, State] = {}
        self._visited: set[int] = set()
        self._seen: State = None
        self._targets: dict[tuple[int, int], int] = {}
        self._target_list: list[Target] = []
        self._moves: list[Move] = []
        self._left: dict[Left, None] = {}
        self._missing_tools: dict[str, None] = {}
        self._missing_frames: dict[str, None] = {}
        self._mentioned: set[int] = set()
        self._poses: dict[int, Array | None] = {}
        self._find_changes()

    def read(self) -> ProgramFile:
        """Return the program."""
        self._follow()
        for visit in self._visits.values():
            self._motion(visit)
        if self._missing_tools or self._missing_frames:
            raise self._not_defined()
        self._add_unused()
        for file, item in enumerate(self._texts):
            for token in moves_after_modules(item.text):
                self._left[Left(file, item.line_at(token.start), "unread", "after ENDMODULE")] = (
                    None
                )
        return ProgramFile(
            self._texts, tuple(self._target_list), tuple(self._moves), tuple(self._left)
        )

    def _line(self, file: int, position: int) -> int:
        """Return the line, from 1, of a character of a file."""
        return bisect_left(self._line_ends[file], position) + 1

    # Names

    def _routines(self) -> Iterator[tuple[Module, Routine]]:
        """Yield all routines with their modules."""
        for module in self._modules:
            for routine in module.routines.values():
                yield module, routine

    def _find_routine(self, name: str, scope: _Scope) -> tuple[Module, Routine] | None:
        """Return the routine of a name, those of the own module first."""
        own = scope.module.routines.get(name)
        if own is not None:
            return scope.module, own
        for module, routine in self._routines():
            if routine.name == name and not routine.is_local:
                return module, routine
        return None

    def _find_data(self, name: str, scope: _Scope) -> tuple[_Scope, Data] | None:
        """Return the data of a name, and the scope of their declaration."""
        if scope.routine is not None and name in scope.routine.data:
            return scope, scope.routine.data[name]
        if name in scope.module.data:
            return _Scope(scope.module), scope.module.data[name]
        for module in self._modules:
            data = module.data.get(name)
            if data is not None and not data.is_local:
                return _Scope(module), data
        return None

    def _is_changed(self, scope: _Scope, name: str) -> bool:
        """Test whether data, or a parameter, of a scope change as the program runs."""
        routine = 0 if scope.routine is None else id(scope.routine)
        return (id(scope.module), routine, name) in self._changed

    def _change(self, name: str, scope: _Scope) -> None:
        """Note that data, or a parameter, change as the program runs."""
        routine = scope.routine
        is_own = routine is not None and (
            name in routine.data or any(item.name == name for item in routine.parameters)
        )
        if routine is not None and is_own:
            self._changed.add((id(scope.module), id(routine), name))
            return
        found = self._find_data(name, _Scope(scope.module))
        if found is not None:
            self._changed.add((id(found[0].module), 0, name))

    def _find_changes(self) -> None:
        """Find what assignments, instructions and routines with such parameters change."""
        for module, routine in self._routines():
            scope = _Scope(module, routine)
            for statement in statements((*routine.body, *routine.handlers)):
                if isinstance(statement, Assignment):
                    self._change(statement.to.name, scope)
                if isinstance(statement, Call):
                    self._change_written(statement.name, statement.arguments, scope)
                for name, arguments in _function_calls(statement.tokens):
                    self._change_written(name, arguments, scope)
        count = -1
        while count != len(self._changed):
            count = len(self._changed)
            for module, routine in self._routines():
                scope = _Scope(module, routine)
                for statement in statements((*routine.body, *routine.handlers)):
                    if isinstance(statement, Call):
                        self._change_arguments(statement.name, statement.arguments, scope)
                    for name, arguments in _function_calls(statement.tokens):
                        self._change_arguments(name, arguments, scope)

    def _change_written(self, name: str, arguments: Sequence[Value], scope: _Scope) -> None:
        """Note what an instruction that writes into an argument changes."""
        place = _WRITERS.get(name, len(arguments))
        if place >= len(arguments):
            return
        argument = arguments[place]
        if isinstance(argument, Text):
            # SetDataVal names the data in a string.
            self._change(argument.text.lower(), scope)
        elif isinstance(argument, Reference):
            self._change(argument.name, scope)

    def _change_arguments(self, name: str, arguments: Sequence[Value], scope: _Scope) -> None:
        """Note the data that a routine changes by its parameters."""
        found = self._find_routine(name, scope)
        if found is None:
            return
        module, routine = found
        required = [item for item in routine.parameters if not item.is_optional]
        for parameter, argument in zip(required, arguments, strict=False):
            is_changed = (id(module), id(routine), parameter.name) in self._changed
            if is_changed and isinstance(argument, Reference):
                self._change(argument.name, scope)

    # The way through the program

    def _follow(self) -> None:
        """Go through all routines: from ``main``, then those that nothing has called, then traps."""
        order = sorted(self._routines(), key=lambda item: item[1].name != "main")
        for module, routine in order:
            if id(routine) not in self._visited and routine.kind != "trap":
                self._run(module, routine, {}, dict(_START), 0)
        for module, routine in order:
            if routine.kind == "trap":
                self._run(module, routine, {}, join([dict(_START), self._seen]), 0)

    def _run(
        self,
        module: Module,
        routine: Routine,
        arguments: dict[str, _Argument],
        state: State,
        depth: int,
    ) -> State:
        """Run a routine, and return the state behind it."""
        scope = _Scope(module, routine, arguments)
        frozen = None if state is None else tuple(sorted(state.items(), key=lambda item: item[0]))
        key = (scope.key, frozen)
        if key in self._returns:
            return self._returns[key]
        self._returns[key] = state
        self._visited.add(id(routine))
        labels: dict[str, State] = {}
        before = None
        exits: list[State] = []
        while before is None or before != labels:
            before = dict(labels)

            def run(statement: Statement, now: State, _: bool) -> State:
                return self._step(statement, now, scope, labels, exits, depth)

            end = walk(routine.body, state, run)
            exits.append(end)
            anywhere = join([state, *exits])
            walk(routine.handlers, anywhere, run)
        result = join(exits)
        self._returns[key] = result
        return result

    def _step(
        self,
        statement: Statement,
        state: State,
        scope: _Scope,
        labels: dict[str, State],
        exits: list[State],
        depth: int,
    ) -> State:
        """Run one statement, and return the state behind it."""
        if isinstance(statement, Assignment):
            return state
        if isinstance(statement, Control):
            if statement.kind == "label":
                return join([state, labels.get(statement.label)])
            if statement.kind == "goto":
                labels[statement.label] = join([state, labels.get(statement.label)])
                return None
            if statement.kind == "return":
                exits.append(state)
            return state if statement.kind == "other" else None
        # What nothing reaches is read as at the beginning.
        reached = dict(_START) if state is None else state
        if statement.name in _SETTINGS:
            name, value = _SETTINGS[statement.name]
            state = {**reached, name: frozenset({value})}
        elif statement.name in ("confl", "confj"):
            state = {**reached, statement.name: frozenset({"off" not in statement.options})}
        self._seen = join([self._seen, state])
        found = self._find_routine(statement.name, scope) if statement.name else None
        if found is not None and depth < _DEEPEST:
            arguments = self._arguments(statement, found[1], scope)
            return self._run(*found, arguments, state, depth + 1)
        key = (id(statement), scope.key)
        known = self._visits.get(key)
        before = None if known is None else known.state
        self._visits[key] = _Visit(statement, scope, join([before, reached]))
        return state

    def _arguments(self, statement: Call, routine: Routine, scope: _Scope) -> dict[str, _Argument]:
        """Return the arguments of a call that may be, or have, targets, tools and work objects."""
        required = [item for item in routine.parameters if not item.is_optional]
        given: list[tuple[str, str, Value]] = [
            (item.name, item.type, value)
            for item, value in zip(required, statement.arguments, strict=False)
        ]
        for item in routine.parameters:
            option = statement.options.get(item.name)
            if item.is_optional and option is not None:
                given.append((item.name, item.type, option))
        plain = ("num", "dnum", "string", "bool", "switch", "speeddata", "zonedata")
        return {
            name: _Argument(value, scope) for name, of_type, value in given if of_type not in plain
        }

    # Values

    def _resolve(self, value: Value, scope: _Scope) -> list[_Found]:
        """Return the values that an expression can stand for: several for an index that is not a number."""
        if isinstance(value, Other):
            relative = value.function in ("offs", "reltool")
            code: LeftCode = "relative" if relative else "computed"
            if not value.names:
                # A star is the position that was taught last, and is not in the text.
                code = "partial"
            for name in value.names:
                self._mention(name, scope)
            return [_Found(self._source(value, scope), None, scope, code=code)]
        if not isinstance(value, Reference):
            return [_Found("", value, scope)]
        if self._is_changed(scope, value.name):
            self._mention(value.name, scope)
            return [_Found(self._source(value, scope), None, scope, code="computed")]
        argument = scope.arguments.get(value.name)
        if argument is not None and (scope.routine is None or value.name not in scope.routine.data):
            found = self._resolve(argument.value, argument.scope)
            if value.steps:
                found = [part for item in found for part in self._parts(item, value.steps)]
            return found
        data = self._find_data(value.name, scope)
        if data is None:
            is_parameter = scope.routine is not None and any(
                item.name == value.name for item in scope.routine.parameters
            )
            code = "computed" if is_parameter else "other file"
            return [_Found(self._source(value, scope), None, scope, code=code)]
        at, declared = data
        self._mentioned.add(id(declared))
        if self._is_changed(at, value.name) or declared.value is None:
            return [_Found(self._source(value, scope), None, at, declared, "computed")]
        whole = _Found(self._written(declared, at), declared.value, at, declared)
        return self._parts(whole, value.steps)

    def _parts(self, found: _Found, steps: Sequence[tuple[int | None, ...] | str]) -> list[_Found]:
        """Return the parts of a value that indices and names of components lead to."""
        if found.data is None and steps:
            return [replace(found, value=None, code="computed")]
        type_name = found.data.type if found.data else ""
        parts = [found]
        for step in steps:
            if isinstance(step, str):
                components = self._components(type_name)
                place = next((i for i, (name, _) in enumerate(components) if name == step), -1)
                type_name = components[place][1] if place >= 0 else ""
                parts = [_item(part, place, f".{step}") for part in parts]
                continue
            for index in step:
                parts = [
                    item
                    for part in parts
                    for item in (
                        _items(part) if index is None else [_item(part, index - 1, f"{{{index}}}")]
                    )
                ]
        return [replace(part, name=part.name.replace("}{", ",")) for part in parts]

    def _components(self, type_name: str) -> tuple[tuple[str, str], ...]:
        """Return names and types of the components of a record."""
        for module in self._modules:
            record = module.records.get(type_name)
            if record is not None:
                is_alias = len(record) == 1 and not record[0][0]
                return self._components(record[0][1]) if is_alias else record
        return _RECORDS.get(type_name, ())

    def _mention(self, name: str, scope: _Scope) -> None:
        """Note that a line that is left names data, which are then not called unused."""
        found = self._find_data(name, scope)
        if found is not None:
            self._mentioned.add(id(found[1]))
        argument = scope.arguments.get(name)
        if argument is not None and isinstance(argument.value, Reference):
            self._mention(argument.value.name, argument.scope)

    def _source(self, value: Value, scope: _Scope) -> str:
        """Return an expression as it is written, in one short line."""
        text = self._texts[scope.module.file].text[value.start : value.end]
        return _shortened(text)

    def _written(self, data: Data, scope: _Scope) -> str:
        """Return the name of data as it is written."""
        text = self._texts[scope.module.file].text
        return readable(text[data.start : data.start + len(data.name)])

    # Motions

    def _leave(self, visit: _Visit, code: LeftCode, what: str) -> None:
        """Name a motion whose numbers stay as they are."""
        file = visit.scope.module.file
        line = self._line(file, visit.call.tokens[0].start)
        self._left[Left(file, line, code, what)] = None

    def _motion(self, visit: _Visit) -> None:
        """Read an instruction: its motions, or why it is left, or nothing if it moves no robot."""
        call = visit.call
        match = _MOTION.fullmatch(call.name)
        name = self._source_name(visit)
        if call.name in _OTHER_MOTIONS:
            for argument in call.arguments:
                self._mention_all(argument, visit.scope)
            self._leave(visit, _OTHER_MOTIONS[call.name], _motion_text(self, visit))
            return
        if match is None or not call.arguments:
            self._other_call(visit, name)
            return
        kind = _KINDS[match[1]]
        targets = call.arguments[: 2 if kind == "circular" else 1]
        has_tool_inside = _TOOL_INSIDE.fullmatch(call.name) is not None
        place = len(targets) + 2 if has_tool_inside else len(call.arguments) - 1
        if len(call.arguments) < len(targets) + 2 or place >= len(call.arguments):
            # A TriggL... or GripC... that takes no target moves nothing.
            if any(self._is_target(argument, visit.scope) for argument in call.arguments):
                for argument in call.arguments:
                    self._mention_all(argument, visit.scope)
                self._leave(visit, "unread", _motion_text(self, visit))
            return
        state = visit.state or _START
        code: LeftCode | None = None
        what = _motion_text(self, visit)
        if True in state["displaced"] and match[1] != "absj":
            code = "computed"
        elif True in state["forced"]:
            code = "force"
        elif "corr" in call.options:
            code = "computed"
        if code is not None:
            for argument in targets:
                self._mention_all(argument, visit.scope)
            self._leave(visit, code, what)
            return
        is_off = state["confj" if kind == "joint" else "confl"] == frozenset({False})
        tool = call.arguments[place]
        for argument in targets:
            for found in self._resolve(argument, visit.scope):
                self._add_move(visit, kind, found, tool, with_configuration=not is_off, name=name)

    def _source_name(self, visit: _Visit) -> str:
        """Return the name of an instruction as it is written."""
        text = self._texts[visit.scope.module.file].text
        token = visit.call.tokens[0]
        return readable(text[token.start : token.end])

    def _other_call(self, visit: _Visit, name: str) -> None:
        """Name a call that may move the robot: with targets, of a routine in another file, or found as it runs."""
        call = visit.call
        with_targets = any(self._is_target(item, visit.scope) for item in call.arguments)
        if not call.name or call.name == "callbyvar":
            self._leave(visit, "unread", _motion_text(self, visit))
        elif _NO_MOTION_OF_TARGETS.fullmatch(call.name) and with_targets:
            for argument in call.arguments:
                if self._is_target(argument, visit.scope):
                    self._mention_all(argument, visit.scope)
                    self._leave(visit, "not a motion", self._source(argument, visit.scope))
        elif with_targets and call.name not in HARMLESS:
            for argument in call.arguments:
                self._mention_all(argument, visit.scope)
            self._leave(visit, "unread", _motion_text(self, visit))
        elif call.name not in HARMLESS and call.tokens[0].kind == "name":
            self._leave(visit, "other file", name)

    def _is_target(self, value: Value, scope: _Scope) -> bool:
        """Test whether an argument is a robtarget or jointtarget by its type or form."""
        if isinstance(value, Aggregate):
            return len(value.items) in (2, 4) and isinstance(value.items[0], Aggregate)
        if isinstance(value, Other):
            return value.function in ("offs", "reltool", "crobt", "cjointt")
        if not isinstance(value, Reference):
            return False
        if value.name in scope.arguments:
            argument = scope.arguments[value.name]
            return self._is_target(argument.value, argument.scope)
        found = self._find_data(value.name, scope)
        return found is not None and found[1].type in _TARGETS

    def _mention_all(self, value: Value, scope: _Scope) -> None:
        """Note all data that a value names."""
        names = value.names if isinstance(value, Other) else frozenset()
        if isinstance(value, Reference):
            names = frozenset({value.name})
        for name in names:
            self._mention(name, scope)

    def _add_move(
        self,
        visit: _Visit,
        kind: Motion,
        found: _Found,
        tool: Value,
        *,
        with_configuration: bool,
        name: str,
    ) -> None:
        """Add a motion to a target, or name it as left."""
        what = f"{name} {found.name}".strip()
        if found.code is not None or found.value is None:
            self._leave(visit, found.code or "computed", what)
            return
        to_joints = visit.call.name.endswith("absj")
        target = (
            self._joint_target(found)
            if to_joints
            else self._robot_target(found, with_configuration=with_configuration)
        )
        if not isinstance(target, Target):
            self._leave(visit, target, what)
            return
        T_tip_tool: Array | _Unknown | None = self._tool(tool, visit.scope)
        T_base_frame: Array | _Unknown | None = None
        if to_joints:
            T_tip_tool = None if isinstance(T_tip_tool, _Unknown) else T_tip_tool
        else:
            T_base_frame = self._frame(visit.call.options.get("wobj"), visit.scope)
        if isinstance(T_tip_tool, _Unknown) and T_tip_tool.code == "other file":
            self._missing_tools[T_tip_tool.name] = None
        if isinstance(T_base_frame, _Unknown) and T_base_frame.code == "other file":
            self._missing_frames[T_base_frame.name] = None
        if isinstance(T_tip_tool, _Unknown):
            self._leave(visit, T_tip_tool.code, f"{what}, {T_tip_tool.name}")
            return
        if isinstance(T_base_frame, _Unknown):
            self._leave(visit, T_base_frame.code, f"{what}, {T_base_frame.name}")
            return
        file = visit.scope.module.file
        line = self._line(file, visit.call.tokens[0].start)
        number = self._target_index(target)
        self._moves.append(Move(number, file, line, kind, T_tip_tool, T_base_frame))

    def _target_index(self, target: Target) -> int:
        """Return the index of a target, each once; its configuration data count if they do for one of its motions."""
        key = (target.file, target.numbers[0].start)
        if key not in self._targets:
            self._targets[key] = len(self._target_list)
            self._target_list.append(target)
        index = self._targets[key]
        if self._target_list[index].configuration is None and target.configuration is not None:
            self._target_list[index] = target
        return index

    def _numbers(self, value: Value | None, count: int) -> tuple[NumberText, ...] | None:
        """Return so many numbers of an aggregate, or None if it has others."""
        if not isinstance(value, Aggregate) or len(value.items) != count:
            return None
        numbers = tuple(item.number for item in value.items if isinstance(item, Number))
        return numbers if len(numbers) == count else None

    def _values(self, value: Value | None, scope: _Scope, count: int) -> list[float] | None:
        """Return so many values of an aggregate, or of data that have them and never change; None if there are none."""
        if isinstance(value, Reference):
            found = self._resolve(value, scope)
            if len(found) != 1 or found[0].value is None:
                return None
            value, scope = found[0].value, found[0].scope
        numbers = self._numbers(value, count)
        return None if numbers is None else [number.value for number in numbers]

    def _new_target(self, found: _Found, numbers: tuple[NumberText, ...]) -> Target:
        """Return a target with numbers, that are joint values in degrees."""
        file = found.scope.module.file
        line = self._line(file, numbers[0].start)
        scales = (np.pi / 180.0,) * len(numbers)
        return Target(found.name, file, line, numbers, scales)

    def _joint_target(self, found: _Found) -> Target | LeftCode:
        """Return the target of a jointtarget, or why it is left."""
        value = found.value
        if not isinstance(value, Aggregate) or len(value.items) != 2:
            return "computed"
        axes = self._numbers(value.items[0], 6)
        if axes is None:
            return "computed"
        if len(self._joint_names) == 7:
            if not self._has_axis_7:
                return "external axes"
            external = self._numbers(value.items[1], 6)
            if external is None:
                return "computed"
            axes = (*axes[:_AXIS_7], external[0], *axes[_AXIS_7:])
        if any(abs(number.value) >= _NONE for number in axes):
            return "partial"
        return self._new_target(found, axes)

    @property
    def _has_axis_7(self) -> bool:
        """Return True if the third joint of the chain is axis 7, by its name."""
        return "7" in self._joint_names[_AXIS_7]

    def _robot_target(self, found: _Found, *, with_configuration: bool) -> Target | LeftCode:
        """Return the target of a robtarget, or why it is left."""
        value = found.value
        if not isinstance(value, Aggregate) or len(value.items) != 4:
            return "computed"
        position = self._numbers(value.items[0], 3)
        orientation = self._numbers(value.items[1], 4)
        if position is None or orientation is None:
            return "computed"
        if not any(number.value for number in orientation):
            return "not a motion"
        external = self._values(value.items[3], found.scope, 6)
        if external is None:
            return "computed"
        is_moved = any(abs(item) < _NONE and item != 0.0 for item in external)
        if is_moved or len(self._joint_names) == 7:
            return "external axes"
        target = replace(
            self._new_target(found, (*position, *orientation)),
            scales=(1e-3,) * 3 + (1.0,) * 4,
            convention=CONVENTIONS["abb"],
        )
        configuration = self._values(value.items[2], found.scope, 4)
        if not with_configuration or configuration is None:
            return target
        quadrants = np.array(configuration)
        if not np.all(np.isfinite(quadrants)):  # a number that is too large for any controller
            return "computed"
        written = self._numbers(value.items[2], 4)
        dependent: tuple[tuple[NumberText, _Quadrant], ...] = ()
        if written is not None:
            dependent = tuple(
                (written[k], _Quadrant(int(written[k].value), axis)) for k, axis in enumerate(_AXES)
            )
        return replace(
            target, configuration=_configuration(quadrants, self._posture), dependent=dependent
        )

    def _pose(self, value: Value | None) -> Array | None:
        """Return the pose (4, 4) [m] that an aggregate of a position and a quaternion is, or None; of each once."""
        key = id(value)
        if key not in self._poses:
            self._poses[key] = self._new_pose(value)
        return self._poses[key]

    def _new_pose(self, value: Value | None) -> Array | None:
        """Return the pose (4, 4) [m] that an aggregate of a position and a quaternion is, or None."""
        if not isinstance(value, Aggregate) or len(value.items) != 2:
            return None
        position = self._numbers(value.items[0], 3)
        orientation = self._numbers(value.items[1], 4)
        if position is None or orientation is None:
            return None
        w, x, y, z = (number.value for number in orientation)
        if not any((w, x, y, z)):
            return None
        T = np.eye(4)
        T[:3, :3] = to_matrices(np.array([[x, y, z, w]]))[0]
        T[:3, 3] = [1e-3 * number.value for number in position]
        return T

    def _tool(self, value: Value, scope: _Scope) -> Array | _Unknown:
        """Return T_tip_tool (4, 4) [m] of a motion, or why it is not known."""
        if isinstance(value, Reference) and value.name == "tool0":
            return read_only(self._stated_tools.get("tool0", np.eye(4)))
        found, name = self._definition(value, scope)
        stated = self._stated_tools.get(name.lower())
        if stated is not None:
            return read_only(stated)
        if found.code == "other file" and "" in self._stated_tools:
            return read_only(self._stated_tools[""])
        if found.code is not None:
            return _Unknown(found.code, name)
        items = found.value.items if isinstance(found.value, Aggregate) else ()
        if len(items) != 3:
            return _Unknown("computed", name)
        if _is_true(items[0]) is not True:
            return _Unknown("external tool", name)
        T = self._pose(items[1])
        return _Unknown("computed", name) if T is None else read_only(T)

    def _frame(self, value: Value | None, scope: _Scope) -> Array | _Unknown:
        """Return T_base_frame (4, 4) [m] of a motion, or why it is not known."""
        T_base_world = self._stated_frames.get("wobj0", np.eye(4))
        if value is None or (isinstance(value, Reference) and value.name == "wobj0"):
            return read_only(T_base_world)
        found, name = self._definition(value, scope)
        stated = self._stated_frames.get(name.lower())
        if stated is not None:
            return read_only(stated)
        if found.code == "other file" and "" in self._stated_frames:
            return read_only(self._stated_frames[""])
        if found.code is not None:
            return _Unknown(found.code, name)
        items = found.value.items if isinstance(found.value, Aggregate) else ()
        if len(items) != 5:
            return _Unknown("computed", name)
        if _is_true(items[0]) is not False:
            return _Unknown("external tool", name)
        unit = items[2].text if isinstance(items[2], Text) else ""
        if _is_true(items[1]) is not True or unit:
            is_conveyor = _CONVEYOR.match(unit) is not None
            return _Unknown("conveyor" if is_conveyor else "external axes", name)
        user, of_object = self._pose(items[3]), self._pose(items[4])
        if user is None or of_object is None:
            return _Unknown("computed", name)
        return read_only(T_base_world @ user @ of_object)

    def _definition(self, value: Value, scope: _Scope) -> tuple[_Found, str]:
        """Return the definition of a tool or work object, and its name, from the modules beside the file if need be."""
        found = self._resolve(value, scope)
        if len(found) != 1:
            return replace(found[0], value=None, code="computed"), self._source(value, scope)
        one = found[0]
        if (
            one.data is not None
            and one.data.value is None
            and not self._is_changed(one.scope, one.data.name)
        ):
            # A persistent without a value has it in another module.
            one = replace(one, code="other file")
        if one.code == "other file" and isinstance(value, Reference) and not value.steps:
            beside = self._beside(value.name)
            if beside is not None:
                return _Found(beside.name, beside.value, scope), self._source(value, scope)
        argument = scope.arguments.get(value.name) if isinstance(value, Reference) else None
        if one.code is not None and argument is not None:
            return self._definition(argument.value, argument.scope)
        return one, one.name or self._source(value, scope)

    def _beside(self, name: str) -> Data | None:
        """Return data of the modules beside the file, if all that define them agree."""
        if self._siblings is None:
            self._siblings = _modules_beside(self._texts)
        same = [module.data[name] for module in self._siblings if name in module.data]
        defined = [data for data in same if data.value is not None and not data.is_local]
        poses = {str(_plain(data.value)) for data in defined}
        return defined[0] if len(poses) == 1 else None

    # What is not known, and what nothing uses

    def _not_defined(self) -> MeasurementError:
        """Return the error that names all tools and work objects that are defined nowhere."""
        parts = []
        for kind, names, option in (
            ("tooldata", self._missing_tools, "--tool"),
            ("wobjdata", self._missing_frames, "--frame"),
        ):
            if names:
                quoted = ", ".join(f"'{name}'" for name in names)
                first = next(iter(names))
                parts.append(f'{kind} {quoted} ({option} "{first}=X Y Z mm RX RY RZ deg")')
        return MeasurementError(
            f"{self._texts[0].path}: the modules do not define {' and '.join(parts)}. Give the module that does with "
            "--data, or state them by these options."
        )

    def _add_unused(self) -> None:
        """Name the targets of the program that no motion goes to."""
        for module in self._modules:
            owners: list[tuple[_Scope, dict[str, Data]]] = [(_Scope(module), module.data)]
            owners += [(_Scope(module, item), item.data) for item in module.routines.values()]
            for scope, owned in owners:
                for data in owned.values():
                    is_target = data.type in _TARGETS and data.value is not None
                    if is_target and id(data) not in self._mentioned:
                        line = self._line(module.file, data.start)
                        name = self._written(data, scope)
                        changed = self._is_changed(scope, data.name)
                        code: LeftCode = "computed" if changed else "unused"
                        self._left[Left(module.file, line, code, name)] = None


#: The axes of cf1, cf4 and cf6, from 0.
_AXES = (0, 3, 5)


@dataclass(frozen=True, slots=True)
class _Quadrant:
    """The quadrant of an axis by joint values; the written one as long as the axis is not out of it."""

    written: int
    #: From 0.
    axis: int

    def __call__(self, q: Array) -> int:
        """Return the quadrant at joint values, shape (m,) [rad]."""
        angle = float(np.rad2deg(q[self.axis]))
        low = 90.0 * self.written
        if low - _TOLERANCE <= angle <= low + 90.0 + _TOLERANCE:
            return self.written
        return int(np.floor(angle / 90.0))


def _configuration(data: Array, posture: ArmPosture | None) -> Configuration:
    """Return which joint values cf1, cf4, cf6 and cfx allow.

    The quadrants must be those of cf1, cf4 and cf6. Bits of cfx are 1 for a negative axis 5, a wrist behind the lower
    arm, and one behind axis 1. Older controllers and arms with parallel rods write 0 whatever the arm does, so that a
    bit only chooses among several solutions.
    """

    def allowed(q: Array) -> Mask:
        angles = np.rad2deg(np.asarray(q))
        is_allowed = np.ones(len(angles), dtype=bool)
        for axis, quadrant in zip(_AXES, data, strict=False):
            over = angles[:, axis] - 90.0 * np.floor(quadrant)
            is_allowed &= (over >= -_TOLERANCE) & (over <= 90.0 + _TOLERANCE)
        if not 0 <= data[3] <= 7:
            return is_allowed
        of_bits = int(data[3])
        agreeing = [(angles[:, 4] < 0.0) == bool(of_bits & 1)]
        if posture is not None:
            agreeing.append(posture.agrees(q, up=not of_bits & 2))
            agreeing.append(posture.agrees(q, front=not of_bits & 4))
        for agrees in agreeing:
            if (is_allowed & agrees).any():
                is_allowed = is_allowed & agrees
        return is_allowed

    return allowed


def _is_true(value: Value) -> bool | None:
    """Return what TRUE or FALSE stands for; None for anything else."""
    name = value.name if isinstance(value, Reference) else ""
    return {"true": True, "false": False}.get(name)


def _item(found: _Found, place: int, name: str) -> _Found:
    """Return a part of a value by its place from 0."""
    if found.value is None:
        return found
    items = found.value.items if isinstance(found.value, Aggregate) else ()
    if not 0 <= place < len(items):
        return replace(found, name=found.name + name, value=None, code="computed")
    return replace(found, name=found.name + name, value=items[place])


def _items(found: _Found) -> list[_Found]:
    """Return all parts of an array."""
    items = found.value.items if isinstance(found.value, Aggregate) else ()
    parts = [_item(found, i, f"{{{i + 1}}}") for i in range(len(items))]
    return parts or [replace(found, value=None, code=found.code or "computed")]


def _motion_text(program: _Program, visit: _Visit) -> str:
    """Return a motion as it is written, in one short line."""
    tokens = visit.call.tokens
    text = program._texts[visit.scope.module.file].text
    return _shortened(text[tokens[0].start : tokens[-1].end])


def _shortened(text: str) -> str:
    """Return a text in one line of at most 60 characters."""
    line = " ".join(text.split())
    return readable(line if len(line) <= 60 else line[:57] + "...")


def _plain(value: Value | None) -> object:
    """Return a value without its place in the text, for comparison."""
    if isinstance(value, Aggregate):
        return [_plain(item) for item in value.items]
    if isinstance(value, Number):
        return value.number.value
    if isinstance(value, Text):
        return f'"{value.text}"'
    return value.name if isinstance(value, Reference) else None


def _function_calls(tokens: Sequence[Token]) -> Iterator[tuple[str, list[Value]]]:
    """Yield the calls of functions in a statement: name and arguments."""
    for i, token in enumerate(tokens[:-1]):
        if token.kind != "name" or tokens[i + 1].word != "(" or tokens[i + 1].kind != "mark":
            continue
        depth = 0
        for end in range(i + 1, len(tokens)):
            if tokens[end].kind == "mark":
                depth += (tokens[end].word in "([{") - (tokens[end].word in ")]}")
            if depth == 0:
                parts = split(tokens[i + 2 : end], ",")
                plain = [split(part, "\\")[0] for part in parts]
                yield token.word, [value_of(part) for part in plain if part]
                break


def _modules_beside(texts: Sequence[ProgramText]) -> list[Module]:
    """Return the modules beside a program: in its folder, and in the other one of a task's backup."""
    known = {text.path.resolve() for text in texts}
    folder = texts[0].path.resolve().parent
    folders = [folder]
    if folder.name.lower() in _BACKUP:
        folders += [
            other
            for other in _listed(folder.parent)
            if other.name.lower() in _BACKUP and other != folder
        ]
    modules = []
    for place in folders:
        for path in _listed(place):
            if path.suffix.lower() in _ENDINGS and path.is_file() and path.resolve() not in known:
                modules += read_modules(read_bytes(path, "RAPID module").decode("latin-1"), -1)
    return modules


def _listed(folder: Path) -> list[Path]:
    """Return what is in a folder, by name; nothing of one that cannot be listed."""
    try:
        return sorted(folder.iterdir())
    except OSError:
        return []
