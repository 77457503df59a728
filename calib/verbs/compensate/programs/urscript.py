"""Programs in Universal Robots' URScript: poses and joint values, the motions to them, and the TCP of these.

Poses are in metres, with rotation vectors, in the controller's base:

    movel(p[...])                     T_base_tcp
    movel(pose_trans(frame, p[...]))  T_base_frame T_frame_tcp
    movej(get_inverse_kin(p[...], qnear=[...]))     the joint values nearest to those

The TCP is that of the last ``set_tcp``. Which values a variable may have at a motion, and which TCP, follows from all
ways through the program that lead there. Functions are followed where they are called.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from calib.basics.arrays import Array, Mask, read_only
from calib.basics.files import read_bytes
from calib.data.forms.orientations import CONVENTIONS
from calib.errors import MeasurementError
from calib.numerics.geometry import to_matrices
from calib.verbs.compensate.programs.flow import State, join, walk
from calib.verbs.compensate.programs.program_file import (
    Configuration,
    Left,
    LeftCode,
    Motion,
    Move,
    ProgramFile,
    ProgramText,
    Stated,
    Target,
    readable,
)
from calib.verbs.compensate.programs.urscript_syntax import (
    Call,
    Expression,
    Function,
    Name,
    Numbers,
    Statement,
    all_functions,
    calls_in,
    names_in,
    read_functions,
    statements,
)

#: The first bytes of what gzip has packed.
_PACKED = b"\x1f\x8b"

#: Motions: how they go to their targets, and the names of these as arguments.
_MOTIONS: MappingProxyType[str, tuple[Motion, tuple[str, ...]]] = MappingProxyType(
    {
        "movej": ("joint", ("q",)),
        "optimovej": ("joint", ("q",)),
        "servoj": ("joint", ("q",)),
        "movel": ("linear", ("pose",)),
        "optimovel": ("linear", ("pose",)),
        "movep": ("linear", ("pose",)),
        "servoc": ("linear", ("pose",)),
        "movec": ("circular", ("pose_via", "pose_to")),
    }
)

#: Functions that move the robot otherwise, and why their numbers stay as they are.
_OTHER_MOTIONS: MappingProxyType[str, LeftCode] = MappingProxyType(
    {
        "speedj": "relative",
        "speedl": "relative",
        "path_offset_set": "relative",
        "freedrive_mode": "force",
        "teach_mode": "force",
        "direct_torque": "force",
        "torque_command": "force",
        "servol": "unread",
        "mc_add_linear": "unread",
        "mc_add_circular": "unread",
        "mc_add_path": "unread",
        "mc_load_path": "other file",
        "mc_run_motion": "unread",
        "move_sequence": "unread",
        "jog": "unread",
    }
)

#: Functions after which motions are led by a force, on a conveyor or displaced, and those that end it.
_SETTINGS: MappingProxyType[str, tuple[str, bool]] = MappingProxyType(
    {
        "force_mode": ("force", True),
        "end_force_mode": ("force", False),
        "track_conveyor_linear": ("conveyor", True),
        "track_conveyor_circular": ("conveyor", True),
        "stop_conveyor_tracking": ("conveyor", False),
        "path_offset_enable": ("computed", True),
        "path_offset_disable": ("computed", False),
    }
)

_LEFT_BY_SETTING: tuple[LeftCode, ...] = ("conveyor", "force", "computed")

#: Functions that make a pose of where the robot is, or of another pose and an offset.
_RELATIVE = re.compile(
    r"get_(?:actual|target)_\w+|get_forward_kin|pose_add|pose_sub|pose_inv|interpolate_pose"
)

#: Functions of the language that move no robot.
_HARMLESS = re.compile(
    r"(?:get|set)_(?:standard|configurable|tool|digital|analog|euromap|runstate|gp|input|joint|target|actual|"
    r"conveyor|tcp|payload|flag|gravity|steptime|controller|jacobian|mass|coriolis|freedrive|forward|inverse|"
    r"safety|base|analogout|analogin|watchdog|world|euler|output)(?:_\w+)?"
    r"|(?:socket|modbus|rtde|interpolate|pose|wrench|rotvec|rpy|force|read|write|encoder|is|to|str|mqtt|rpc|"
    r"rtde)_(?:open|close|send|read|get|set|add|delete|write|trans|inv|sub|dist|pose|str|num|str|input|output|"
    r"port|holding|coil|register|signal|string|byte|line|all|list|int|float|ascii|binary|name|frequency|runstate|"
    r"steady|within|enable|unwind|tick|delta|status|factory|cat|at|find|len|empty|program|digital|value|var|mode|"
    r"last|raw|reset|is|expert|mult|reg|robot|bit|custom|command|secondary|wait)\w*"
    r"|rotvec2rpy|rpy2rotvec|textmsg|popup|request_\w+|sleep|sync|stop[jl]|powerdown|acos|asin|atan2?|ceil|cos|"
    r"d2r|r2d|floor|log|norm|normalize|pow|random|sin|sqrt|tan|length|struct|make_list|clear|append|pop|insert|"
    r"remove|slice|size|shape|bool|sort|inv|transpose|point_dist|binary_list_to_integer|integer_to_binary_list|"
    r"zero_ftsensor|force|servoj_stop|assert|abs|min|max|ft_rtde_input_enable|enable_external_ft_sensor|"
    r"end_(?:freedrive|teach|force|screw_driving)\w*|force_mode_\w+|screw_driving|tool_contact|"
    r"reset_\w*revolution_counter|conveyor_pulse_decode|power\w*|protective_stop|unlock_protective_stop|"
    r"estimate_payload|transition_to_\w+|collision_detection\w*|set_unlock_protective_stop|enter_critical|"
    r"time|timer_\w+|path_offset_get\w*|path_offset_set_\w+|wait_for\w*|var_\w+|zero_\w+"
)

#: What `_Value.code` of a name that no statement gives a value is.
_UNKNOWN = "unknown"

#: The key of the TCP in a state.
_TCP = "tcp"

#: The name by which the TCP of the installation is stated.
_INSTALLED = "TCP"


class _Value(NamedTuple):
    """Value of an expression: numbers in the text, a name that is not defined here, or neither."""

    #: Why there are no numbers; empty if there are; `_UNKNOWN` for a name without a value.
    code: str
    #: Position of the numbers in the text, or -1.
    start: int = -1
    #: The variable that has them; empty for numbers as such.
    name: str = ""
    #: Frames from the base on, in which the pose is.
    frames: tuple[_Value, ...] = ()
    #: Position of the joint values near which the inverse kinematics searches; -1: near those of the moment.
    near: int = -1
    #: Whether inverse kinematics makes joint values of it.
    is_inverse: bool = False
    #: The TCP that the inverse kinematics uses in place of the active one.
    tcp: _Value | None = None


_INSTALLED_TCP = _Value(_UNKNOWN, name=_INSTALLED)


@dataclass(frozen=True, slots=True)
class _Outcome:
    """A motion to one target that a statement can be."""

    call: str
    line: int
    #: The expression of the target as it is written.
    source: str
    kind: Motion
    value: _Value
    tcp: _Value


def read(path: Path, stated: Stated) -> ProgramFile:
    """Read a URScript program.

    Variables that it does not define are taken from the files of ``stated.data``, if these give them a value once.

    Args:
        path: The program.
        stated: What options say of the program.

    Returns:
        The program.

    Raises:
        MeasurementError: It is not URScript, or the TCP or frames are not known.
        FileError: A file cannot be read.
    """
    data = read_bytes(path, "URScript program")
    if data.startswith(_PACKED) or path.suffix.lower() == ".urp":
        raise MeasurementError(
            f"{path}: a .urp is PolyScope's own packed form. Give the .script that PolyScope writes beside it when the "
            "program is saved, and run that."
        )
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise MeasurementError(f"{path}: this text is UTF-16; save it as UTF-8.")
    if len(stated.joint_names) != 6:
        raise MeasurementError(
            f"{path}: URScript is for arms of six joints; the chain has {len(stated.joint_names)} "
            f"({', '.join(stated.joint_names)}). Choose another --base or --tip."
        )
    texts = [ProgramText(path, data.decode("latin-1"))]
    texts += [
        ProgramText(other, read_bytes(other, "URScript").decode("latin-1")) for other in stated.data
    ]
    program = _Program(tuple(texts), stated)
    if not program.is_urscript:
        raise MeasurementError(
            f"{path}: this is not URScript: it has neither a function (def ... end) nor a motion (movej, movel). Other "
            "languages share the ending."
        )
    return program.read()


def _given(function: Function | None, call: Call) -> Iterator[tuple[str, Expression]]:
    """Yield the parameters that a call of a function gives, with their values."""
    if function is not None:
        yield from zip(function.parameters, call.arguments, strict=False)
        yield from ((k, v) for k, v in call.named.items() if k in function.parameters)


class _Program:
    """A program, and what is known of its motions."""

    def __init__(self, texts: tuple[ProgramText, ...], stated: Stated) -> None:
        """Read its functions, and find whose each variable is."""
        self._texts = texts
        self._text = texts[0].text
        self._line_ends = [match.start() for match in re.finditer("\n", self._text)]
        self._stated = stated
        self._top = read_functions(self._text)
        self._functions = list(all_functions(self._top))
        self._owners: dict[tuple[int, str], int] = {}
        self._literals: dict[int, Numbers] = {}
        self._outcomes: dict[_Outcome, None] = {}
        self._left: dict[Left, None] = {}
        self._running: list[Function] = []
        self._visited: set[int] = set()
        self._seen: State = None
        self._unsteady: set[str] = set()
        self._used: set[str] = set()
        self._targets: dict[int, int] = {}
        self._target_list: list[Target] = []
        self._known: dict[str, Numbers] = {}
        self._poses: dict[int, Array | None] = {}
        self._own_variables()
        self._relevant = self._relevant_names()
        self._read_data()

    @property
    def is_urscript(self) -> bool:
        """True if the text has functions or motions."""
        return len(self._functions) > 1 or any(
            call.name in _MOTIONS or call.name in _OTHER_MOTIONS
            for item in statements(self._top.body)
            for call in calls_in(item.value)
        )

    def read(self) -> ProgramFile:
        """Return the program."""
        self._follow()
        moved = {
            outcome.value.start
            for outcome in self._outcomes
            if not outcome.value.code and not outcome.value.frames
        }
        moves: list[Move] = []
        missing_tcp: list[_Outcome] = []
        missing_frames: dict[str, None] = {}
        for outcome in self._outcomes:
            added = self._move(outcome, moved)
            if isinstance(added, Move):
                moves.append(added)
            elif added == _INSTALLED:
                missing_tcp.append(outcome)
            elif added:
                missing_frames[added] = None
        if missing_tcp or missing_frames:
            raise self._not_known(missing_tcp, list(missing_frames))
        self._add_unused()
        left = sorted(self._left, key=lambda item: item.line)
        texts = self._texts[:1]
        return ProgramFile(texts, tuple(self._target_list), tuple(moves), tuple(left))

    # Names

    def _own_variables(self) -> None:
        """Find the variables of each function: those that it makes, unless an outer one has them."""
        for function in self._functions:
            function.variables.update(function.parameters)
        for function in self._functions:
            for item in statements(function.body):
                if item.kind not in ("assignment", "part"):
                    continue
                owner = function
                if item.where == "global":
                    owner = self._top
                elif item.where != "local":
                    owner = self._owner(function, item.name) or function
                owner.variables.add(item.name)
        for function in self._functions:
            for item in statements(function.body):
                is_outer = function.kind in ("thread", "sec") and item.name
                if is_outer and item.name not in function.variables:
                    self._unsteady.add(self._key(function, item.name))

    def _relevant_names(self) -> frozenset[str]:
        """Return the names of variables that targets and TCPs depend on; a state has no others."""
        from_names: list[tuple[str, frozenset[str]]] = []
        relevant: set[str] = set()
        for function in self._functions:
            for item in statements(function.body):
                if item.name:
                    from_names.append((item.name, names_in(item.value)))
                for call in calls_in(item.value):
                    if call.name in _MOTIONS or call.name == "set_tcp":
                        relevant |= names_in(call)
                    inner = self._find_function(function, call.name)
                    for name, value in _given(inner, call):
                        from_names.append((name, names_in(value)))
        count = -1
        while count != len(relevant):
            count = len(relevant)
            for name, others in from_names:
                if name in relevant:
                    relevant |= others
        return frozenset(relevant)

    @staticmethod
    def _owner(function: Function, name: str) -> Function | None:
        """Return the function, itself or an outer one, that has a variable."""
        at: Function | None = function
        while at is not None and name not in at.variables:
            at = at.outer
        return at

    def _key(self, function: Function, name: str) -> str:
        """Return the key of a variable in a state."""
        owner = self._owner(function, name)
        return f"{'' if owner is None else id(owner)}:{name}"

    def _find_function(self, function: Function, name: str) -> Function | None:
        """Return the function of a name that a function can call."""
        at: Function | None = function
        while at is not None and name not in at.functions:
            at = at.outer
        return None if at is None else at.functions[name]

    def _read_data(self) -> None:
        """Read poses of other files that give a variable its value once."""
        for text in self._texts[1:]:
            given: dict[str, list[Expression | None]] = {}
            for function in all_functions(read_functions(text.text)):
                for item in statements(function.body):
                    if item.name:
                        given.setdefault(item.name, []).append(item.value)
            for name, values in given.items():
                value = values[0]
                if len(values) == 1 and isinstance(value, Numbers) and value.numbers:
                    self._known[name] = value

    # The way through the program

    def _follow(self) -> None:
        """Go through all functions: from the text outside them, then those that nothing calls, then the others."""
        start: State = {
            _TCP: frozenset({_INSTALLED_TCP}),
            **{name: frozenset({False}) for name, _ in _SETTINGS.values()},
        }
        end = self._run(self._top, start, is_trial=False)
        called = {
            call.name
            for function in self._functions
            for item in statements(function.body)
            for call in calls_in(item.value)
        }
        rest = self._functions[1:]
        for function in (
            *(item for item in rest if item.name not in called and item.kind == "def"),
            *(item for item in rest if item.kind == "def"),
        ):
            if id(function) not in self._visited:
                end = join([end, self._run(function, join([start, end]), is_trial=False)])
        for function in rest:
            if id(function) not in self._visited:
                self._run(function, join([start, end, self._seen]), is_trial=False)

    def _run(self, function: Function, state: State, *, is_trial: bool) -> State:
        """Run a function, and return the state behind it."""
        if function in self._running:
            return state
        self._visited.add(id(function))
        self._running.append(function)
        exits: list[State] = []

        def run(statement: Statement, now: State, trial: bool) -> State:
            return self._step(statement, now, function, exits, is_trial=trial)

        exits.append(walk(function.body, state, run, is_trial=is_trial))
        self._running.pop()
        return join(exits)

    def _step(
        self,
        statement: Statement,
        state: State,
        function: Function,
        exits: list[State],
        *,
        is_trial: bool,
    ) -> State:
        """Run one statement, and return the state behind it."""
        if state is None:
            # Nothing comes here; its motions are read as at the beginning.
            state = {_TCP: frozenset({_INSTALLED_TCP})}
            self._call_all(statement, state, function, is_trial=is_trial)
            return None
        state = self._call_all(statement, state, function, is_trial=is_trial)
        if state is None:
            return None
        if statement.kind in ("assignment", "part") and statement.name in self._relevant:
            key = self._key(function, statement.name)
            values = frozenset({_Value("computed", name=statement.name)})
            if statement.kind == "assignment" and statement.value is not None:
                values = frozenset(
                    item._replace(name=item.name or statement.name)
                    for item in self._values(statement.value, state, function)
                )
            return {**state, key: values}
        if statement.kind == "return":
            exits.append(state)
            return None
        return state

    def _call_all(
        self, statement: Statement, state: State, function: Function, *, is_trial: bool
    ) -> State:
        """Run the calls in a statement, inner ones first."""
        for call in calls_in(statement.value):
            if state is None:
                return None
            state = self._call(call, state, function, is_trial=is_trial)
        return state

    def _call(self, call: Call, state: State, function: Function, *, is_trial: bool) -> State:
        """Run one call."""
        assert state is not None
        inner = self._find_function(function, call.name)
        if inner is not None:
            arguments = {
                self._key(inner, name): self._values(value, state, function)
                for name, value in _given(inner, call)
                if name in self._relevant
            }
            if inner.kind != "def":
                self._seen = join([self._seen, state])
                return state
            return self._run(inner, {**state, **arguments}, is_trial=is_trial)
        if call.name == "set_tcp":
            tcp = call.arguments[0] if call.arguments else call.named.get("pose")
            if tcp is None:
                return state
            values = self._values(tcp, state, function)
            for item in values:
                self._used.add(item.name)
            return {**state, _TCP: values}
        if call.name in _SETTINGS:
            name, value = _SETTINGS[call.name]
            return {**state, name: frozenset({value})}
        if call.name in _MOTIONS:
            if not is_trial:
                self._motion(call, state, function)
        elif call.name in _OTHER_MOTIONS:
            self._leave(call, _OTHER_MOTIONS[call.name], self._source(call))
        elif not _HARMLESS.fullmatch(call.name):
            self._unknown_call(call)
        return state

    def _unknown_call(self, call: Call) -> None:
        """Name a call of a function that is not in the file, and may move the robot."""
        # A method of a variable, such as an XML-RPC server's, has no name of its own.
        before = self._text[: call.start].rstrip(" ")[-1:]
        if before == ".":
            return
        has_pose = any(
            isinstance(argument, Numbers) and argument.is_pose
            for argument in (*call.arguments, *call.named.values())
        )
        self._use_all(call)
        self._leave(call, "unread" if has_pose else "other file", self._source(call))

    # Values

    def _values(
        self, expression: Expression, state: State, function: Function
    ) -> frozenset[_Value]:
        """Return what an expression may stand for in a state."""
        assert state is not None
        if isinstance(expression, Numbers):
            if expression.numbers is None or len(expression.numbers) != 6:
                return frozenset({_Value("computed")})
            self._literals[expression.start] = expression
            return frozenset({_Value("", expression.start)})
        if isinstance(expression, Name):
            key = self._key(function, expression.name)
            if key in self._unsteady:
                return frozenset({_Value("computed", name=expression.name)})
            if key in state:
                return frozenset(item for item in state[key] if isinstance(item, _Value))
            is_made = self._owner(function, expression.name) is not None
            code = "computed" if is_made else _UNKNOWN
            return frozenset({_Value(code, name=expression.name)})
        calls = (
            list(calls_in(expression)) if isinstance(expression, Call) else list(expression.calls)
        )
        if isinstance(expression, Call) and expression.name == "pose_trans":
            return self._transformed(expression, state, function)
        if isinstance(expression, Call) and expression.name == "get_inverse_kin":
            return self._inverse(expression, state, function)
        is_relative = any(_RELATIVE.fullmatch(call.name) for call in calls)
        return frozenset({_Value("relative" if is_relative else "computed")})

    def _transformed(self, call: Call, state: State, function: Function) -> frozenset[_Value]:
        """Return what a pose in a frame may stand for."""
        if len(call.arguments) != 2:
            return frozenset({_Value("computed")})
        results = set()
        for frame in self._values(call.arguments[0], state, function):
            for value in self._values(call.arguments[1], state, function):
                if value.code:
                    results.add(_Value("computed" if value.code == _UNKNOWN else value.code))
                elif frame.code and frame.code != _UNKNOWN:
                    results.add(_Value(frame.code, name=value.name))
                else:
                    outer = (*frame.frames, frame._replace(frames=()), *value.frames)
                    results.add(value._replace(frames=outer))
        return frozenset(results)

    def _inverse(self, call: Call, state: State, function: Function) -> frozenset[_Value]:
        """Return what the joint values of a pose may stand for."""
        arguments = list(call.arguments)
        pose = arguments[0] if arguments else call.named.get("x")
        near = arguments[1] if len(arguments) > 1 else call.named.get("qnear")
        tcp = arguments[4] if len(arguments) > 4 else call.named.get("tcp")
        if pose is None:
            return frozenset({_Value("computed")})
        near_start = -1
        if near is not None:
            self._use_all(near)
            found = list(self._values(near, state, function))
            if len(found) == 1 and not found[0].code:
                near_start = found[0].start
        tcps: frozenset[_Value | None] = frozenset({None})
        if tcp is not None:
            tcps = frozenset(self._values(tcp, state, function))
        results = set()
        for value in self._values(pose, state, function):
            for one in tcps:
                is_pose = value.code or self._literals[value.start].is_pose
                if not is_pose:
                    value = _Value("computed")
                results.add(value._replace(near=near_start, is_inverse=True, tcp=one))
        return frozenset(results)

    def _use_all(self, expression: Expression) -> None:
        """Note the variables in an expression, which are then not called unused."""
        self._used |= names_in(expression)

    def _source(self, expression: Expression) -> str:
        """Return an expression as it is written, in one short line."""
        line = " ".join(self._text[expression.start : expression.end].split())
        return readable(line if len(line) <= 60 else line[:57] + "...")

    def _line(self, position: int) -> int:
        """Return the line, from 1, of a character."""
        return bisect_left(self._line_ends, position) + 1

    def _leave(self, expression: Expression, code: LeftCode, what: str) -> None:
        """Name a line whose numbers stay as they are."""
        self._left[Left(0, self._line(expression.start), code, what)] = None

    # Motions

    def _motion(self, call: Call, state: State, function: Function) -> None:
        """Note all targets that a motion may go to in a state, or why it is left."""
        assert state is not None
        kind, names = _MOTIONS[call.name]
        targets = list(call.arguments[: len(names)])
        targets += [call.named[name] for name in names if name in call.named]
        for target in targets:
            self._use_all(target)
        for code in _LEFT_BY_SETTING:
            if True in state.get(code, frozenset()):
                self._leave(call, code, self._source(call))
                return
        if len(targets) < len(names):
            self._leave(call, "unread", self._source(call))
            return
        line = self._line(call.start)
        for target in targets:
            values = self._values(target, state, function)
            left = {item.code for item in values if item.code not in ("", _UNKNOWN)}
            if left:
                code = "computed" if "computed" in left else "relative"
                self._leave(call, code, f"{call.name} {self._source(target)}")
                continue
            for value in sorted(values, key=lambda item: (item.start, item.name)):
                tcps = sorted(state[_TCP], key=str)
                is_pose = bool(value.code or value.frames) or self._literals[value.start].is_pose
                # The TCP makes no difference to joint values.
                for tcp in tcps if is_pose else tcps[:1]:
                    assert isinstance(tcp, _Value)
                    outcome = _Outcome(
                        call.name, line, self._source(target), kind, value, value.tcp or tcp
                    )
                    self._outcomes[outcome] = None

    def _move(self, outcome: _Outcome, moved: set[int]) -> Move | str:
        """Return the motion of an outcome, or the name of a frame or TCP that is not known; empty if it is left.

        ``moved`` has the positions of the poses in the base that motions go to.
        """
        value = outcome.value

        def left(code: LeftCode) -> str:
            what = f"{outcome.call} {outcome.source}"
            self._left[Left(0, outcome.line, code, what)] = None
            return ""

        if value.code:
            return left("other file")
        literal = self._literals[value.start]
        if not literal.is_pose and not value.frames:
            return Move(
                self._target(value), 0, outcome.line, outcome.kind, self._tcp_or_none(outcome.tcp)
            )
        if not literal.is_pose:
            return left("computed")
        T_base_frame = self._frame("base")
        T_base_frame = np.eye(4) if T_base_frame is None else T_base_frame
        for frame in value.frames:
            if frame.start in moved:
                # The frame is itself a target: its numbers change, and what is relative to it changes with them.
                return left("relative")
            T = self._pose(frame)
            if T is None and frame.start >= 0:
                return left("computed")
            if T is None:
                return frame.name
            T_base_frame = T_base_frame @ T
        T_tip_tool = self._tcp_or_none(outcome.tcp)
        if T_tip_tool is None:
            if outcome.tcp.code in ("computed", "relative"):
                return left("computed")
            return _INSTALLED
        number = self._target(value)
        return Move(number, 0, outcome.line, outcome.kind, T_tip_tool, read_only(T_base_frame))

    def _tcp_or_none(self, tcp: _Value) -> Array | None:
        """Return T_tip_tool (4, 4) [m] of a TCP, or None if it is not known."""
        tools = {name.lower(): T for name, T in self._stated.tools.items()}
        name = tcp.name.lower()
        if tcp.name and name in tools:
            return read_only(tools[name])
        if tcp.code == _UNKNOWN and tcp.name in self._known:
            return self._pose_of(self._known[tcp.name])
        if tcp.code == _UNKNOWN and "" in tools:
            return read_only(tools[""])
        if tcp.code or tcp.frames:
            return None
        return self._pose_of(self._literals[tcp.start])

    def _frame(self, name: str) -> Array | None:
        """Return a frame (4, 4) [m] that is stated, or defined in other files; or None."""
        for stated, T in self._stated.frames.items():
            if stated.lower() == name.lower():
                return np.asarray(T)
        return None

    def _pose(self, frame: _Value) -> Array | None:
        """Return the pose (4, 4) [m] of a frame, or None if it is not known."""
        stated = self._frame(frame.name) if frame.name else None
        if stated is not None:
            return stated
        if frame.code:
            if frame.name in self._known:
                return self._pose_of(self._known[frame.name])
            return self._stated.frames.get("")
        return self._pose_of(self._literals[frame.start])

    def _pose_of(self, literal: Numbers) -> Array | None:
        """Return the pose (4, 4) [m] that numbers are, or None if they are none; of each once."""
        if id(literal) not in self._poses:
            self._poses[id(literal)] = self._new_pose(literal)
        return self._poses[id(literal)]

    @staticmethod
    def _new_pose(literal: Numbers) -> Array | None:
        """Return the pose (4, 4) [m] that numbers are, or None if they are none."""
        if not literal.is_pose or literal.numbers is None or len(literal.numbers) != 6:
            return None
        values = np.array([item.value for item in literal.numbers]) * literal.scales
        T = np.eye(4)
        T[:3, :3] = to_matrices(values[None, 3:])[0]
        T[:3, 3] = values[:3]
        return read_only(T)

    def _target(self, value: _Value) -> int:
        """Return the index of a target, each once."""
        if value.start not in self._targets:
            literal = self._literals[value.start]
            assert literal.numbers is not None
            self._targets[value.start] = len(self._target_list)
            self._target_list.append(
                Target(
                    value.name,
                    0,
                    self._line(value.start),
                    literal.numbers,
                    literal.scales,
                    CONVENTIONS["rotation-vector"] if literal.is_pose else None,
                    self._nearest(value.near),
                )
            )
        return self._targets[value.start]

    def _nearest(self, near: int) -> Configuration | None:
        """Return which joint values are nearest to those at a position of the text; None if there are none."""
        literal = self._literals.get(near)
        if literal is None or literal.is_pose or literal.numbers is None:
            return None
        q_near = np.array([item.value for item in literal.numbers]) * literal.scales

        def nearest(q: Array) -> Mask:
            distances = np.linalg.norm(np.asarray(q) - q_near, axis=1)
            return np.asarray(np.arange(len(distances)) == np.argmin(distances))

        return nearest

    # What is not known, and what nothing uses

    def _not_known(
        self, without_tcp: Sequence[_Outcome], frames: Sequence[str]
    ) -> MeasurementError:
        """Return the error that names a TCP and frames that are not known."""
        parts = []
        names = sorted({item.tcp.name for item in without_tcp})
        if names == [_INSTALLED]:
            parts.append(
                f"line {without_tcp[0].line} is a motion with the TCP of the installation, as no set_tcp stands "
                f'before it; state that (--tool "{_INSTALLED}=X Y Z mm RX RY RZ deg")'
            )
        elif names:
            parts.append(
                f"the TCP {', '.join(names)} is not defined in the program; state it "
                f'(--tool "{names[0]}=X Y Z mm RX RY RZ deg")'
            )
        if frames:
            quoted = ", ".join(f"'{name}'" for name in frames)
            parts.append(
                f"the frames {quoted} are not defined in the program; state them "
                f'(--frame "{frames[0]}=X Y Z mm RX RY RZ deg"), or give a script that has them (--data)'
            )
        return MeasurementError(f"{self._texts[0].path}: {', and '.join(parts)}.")

    def _add_unused(self) -> None:
        """Name the poses of variables that no motion goes to."""
        positions = set(self._targets)
        frames = {frame.start for outcome in self._outcomes for frame in outcome.value.frames}
        for function in self._functions:
            for item in statements(function.body):
                value = item.value
                is_pose = isinstance(value, Numbers) and value.is_pose and value.numbers
                if not is_pose or item.kind != "assignment" or item.name in self._used:
                    continue
                assert value is not None
                if value.start not in positions | frames:
                    self._left[Left(0, self._line(value.start), "unused", item.name)] = None
