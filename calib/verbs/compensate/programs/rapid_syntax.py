"""The text of RAPID modules as tokens, data with their values, and routines with their statements.

Keywords and names count in any case. A module is read as far as it can be: what is no RAPID is passed over up to the
next semicolon.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

from calib.verbs.compensate.programs.flow import Branch, Loop, Node
from calib.verbs.compensate.programs.program_file import NumberText

_TOKEN = re.compile(
    r"""(?P<blank>\s+ | ![^\n]*)
    | (?P<text>"(?:[^"\n]|"")*"?)
    | (?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)
    | (?P<name>[A-Za-z_\x80-\xff][A-Za-z0-9_\x80-\xff]*)
    | (?P<mark>:=|<>|<=|>=|.)""",
    re.VERBOSE | re.DOTALL,
)

#: Words that end a routine, each with the one that began it.
_ENDS = {"proc": "endproc", "func": "endfunc", "trap": "endtrap"}

#: Words that begin a declaration of data.
_STORAGE = ("const", "pers", "var")

#: Words between operands, which are no operands.
_OPERATORS = ("and", "or", "xor", "not", "div", "mod")

#: Words that are in no statement: a semicolon before them is missing.
_NEVER_INSIDE = frozenset(
    {*_ENDS, *_ENDS.values(), "module", "endmodule", "endif", "endfor", "endwhile", "endtest"}
)

#: Words that begin the handlers at the end of a routine.
_HANDLERS = ("error", "undo", "backward")

_OPENING = {"(": ")", "[": "]", "{": "}"}
_CLOSING = frozenset(_OPENING.values())


class Token(NamedTuple):
    """A word of the text: characters ``start`` to ``end`` of the file, the end excluded."""

    #: ``"name"``, ``"number"``, ``"text"`` or ``"mark"``.
    kind: str
    #: As written; names in lower case.
    word: str
    start: int
    end: int


#: Instructions that move the robot to a target, whatever the process.
_MOTIONS = frozenset({"movel", "movej", "movec", "moveabsj"})


@dataclass(frozen=True, slots=True)
class Aggregate:
    """Values in brackets: of a record or an array."""

    items: tuple[Value, ...]
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class Number:
    """A number with its sign."""

    number: NumberText

    @property
    def start(self) -> int:
        """Position of its first character."""
        return self.number.start

    @property
    def end(self) -> int:
        """Position behind its last character."""
        return self.number.end


@dataclass(frozen=True, slots=True)
class Text:
    """A string, without its quotes."""

    text: str
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class Reference:
    """The name of data, and the way to a part of them."""

    #: In lower case.
    name: str
    #: Indices of an array, from 1, each None if it is not a number; or the name of a component.
    steps: tuple[tuple[int | None, ...] | str, ...]
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class Other:
    """Any other expression."""

    #: The function that it calls; empty if it is not one call.
    function: str
    #: All names in it.
    names: frozenset[str]
    start: int
    end: int


Value: TypeAlias = "Aggregate | Number | Text | Reference | Other"


@dataclass(frozen=True, slots=True)
class Assignment:
    """Gives a value to data."""

    to: Reference
    tokens: Sequence[Token]


@dataclass(frozen=True, slots=True)
class Call:
    """Calls a routine or an instruction."""

    #: In lower case; empty if the program finds it as it runs.
    name: str
    arguments: tuple[Value, ...]
    #: Optional arguments by name; None for one without a value.
    options: dict[str, Value | None]
    tokens: Sequence[Token]


@dataclass(frozen=True, slots=True)
class Control:
    """Leaves the order of the text, or is where a GOTO leads."""

    #: ``"goto"``, ``"label"``, ``"return"``, ``"end"`` or ``"other"``.
    kind: str
    label: str
    tokens: Sequence[Token]


Statement: TypeAlias = "Assignment | Call | Control"


@dataclass(frozen=True, slots=True)
class Data:
    """Declared data."""

    name: str
    type: str
    #: Number of indices of an array; 0: not an array.
    dimensions: int
    #: None: none is given.
    value: Value | None
    is_local: bool
    start: int


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of a routine."""

    name: str
    type: str
    is_optional: bool


@dataclass(slots=True, eq=False)
class Routine:
    """A procedure, function or trap routine."""

    kind: str
    name: str
    is_local: bool
    parameters: tuple[Parameter, ...]
    start: int
    data: dict[str, Data] = field(default_factory=dict)
    body: tuple[Node, ...] = ()
    #: Statements of its handlers of errors.
    handlers: tuple[Node, ...] = ()


@dataclass(slots=True, eq=False)
class Module:
    """A module of a file."""

    #: Index of its file.
    file: int
    name: str
    data: dict[str, Data] = field(default_factory=dict)
    routines: dict[str, Routine] = field(default_factory=dict)
    #: Names and types of the components of records; the type of an alias alone, its name empty.
    records: dict[str, tuple[tuple[str, str], ...]] = field(default_factory=dict)


def tokens_of(text: str) -> list[Token]:
    """Return the tokens of a text, without blanks and comments."""
    tokens = []
    for match in _TOKEN.finditer(text):
        kind = match.lastgroup or ""
        if kind == "blank":
            continue
        word = match[0].lower() if kind == "name" else match[0]
        tokens.append(Token(kind, word, match.start(), match.end()))
    return tokens


def read_modules(text: str, file: int) -> list[Module]:
    """Return the modules of a text, its bytes as Latin-1; none if it is not RAPID.

    Args:
        text: The text of the file.
        file: Index of the file, for the modules.
    """
    # The mark of UTF-8 at the beginning would become part of the first word.
    without_mark = (
        text.replace("\xef\xbb\xbf", "   ", 1) if text.startswith("\xef\xbb\xbf") else text
    )
    tokens = tokens_of(without_mark)
    return list(_Parser(tokens, file).modules())


def moves_after_modules(text: str) -> list[Token]:
    """Return the words that begin a motion, such as ``movel``, after the last module of a text: they are in none.

    Args:
        text: The text of the file.
    """
    tokens = tokens_of(text)
    ends = [i for i, token in enumerate(tokens) if token[:2] == ("name", "endmodule")]
    after = tokens[ends[-1] + 1 :] if ends else []
    return [token for token in after if token.kind == "name" and token.word in _MOTIONS]


def split(tokens: Sequence[Token], mark: str) -> list[Sequence[Token]]:
    """Split tokens at a mark outside all brackets."""
    parts = []
    depth = 0
    begin = 0
    for i, token in enumerate(tokens):
        if token.kind != "mark":
            continue
        if token.word in _OPENING:
            depth += 1
        elif token.word in _CLOSING:
            depth -= 1
        elif token.word == mark and depth == 0:
            parts.append(tokens[begin:i])
            begin = i + 1
    parts.append(tokens[begin:])
    return parts


def _closing(tokens: Sequence[Token], opening: int) -> int:
    """Return the index of the bracket that closes the one at an index; the number of tokens if none does."""
    depth = 0
    for i in range(opening, len(tokens)):
        if tokens[i].kind == "mark":
            if tokens[i].word in _OPENING:
                depth += 1
            elif tokens[i].word in _CLOSING:
                depth -= 1
                if depth == 0:
                    return i
    return len(tokens)


def value_of(tokens: Sequence[Token]) -> Value:
    """Return the value that tokens, at least one, stand for."""
    first, last = tokens[0], tokens[-1]
    start, end = first.start, last.end
    if last.kind == "number":
        sign = tokens[0].word if len(tokens) == 2 else ""
        if len(tokens) == 1 or sign in ("-", "+"):
            number = float(last.word)
            return Number(NumberText(start, end, -number if sign == "-" else number))
    if len(tokens) == 1 and first.kind == "text":
        return Text(first.word.strip('"'), start, end)
    if first.word == "[" and _closing(tokens, 0) == len(tokens) - 1:
        inner = tokens[1:-1]
        items = tuple(value_of(part) for part in split(inner, ",") if part)
        return Aggregate(items, start, end)
    reference = _reference(tokens)
    if reference is not None:
        return reference
    function = ""
    is_call = first.kind == "name" and len(tokens) > 1 and tokens[1].word == "("
    if is_call and _closing(tokens, 1) == len(tokens) - 1:
        function = first.word
    names = frozenset(token.word for token in tokens if token.kind == "name")
    return Other(function, names, start, end)


def _reference(tokens: Sequence[Token]) -> Reference | None:
    """Return the reference that tokens are, or None: ``name{1, i}.component``."""
    if tokens[0].kind != "name":
        return None
    steps: list[tuple[int | None, ...] | str] = []
    i = 1
    while i < len(tokens):
        if tokens[i].word == "." and i + 1 < len(tokens) and tokens[i + 1].kind == "name":
            steps.append(tokens[i + 1].word)
            i += 2
        elif tokens[i].word == "{":
            closing = _closing(tokens, i)
            if closing == len(tokens):
                return None
            indices: list[int | None] = []
            for part in split(tokens[i + 1 : closing], ","):
                is_number = len(part) == 1 and part[0].word.isdecimal()
                indices.append(int(part[0].word) if is_number else None)
            steps.append(tuple(indices))
            i = closing + 1
        else:
            return None
    return Reference(tokens[0].word, tuple(steps), tokens[0].start, tokens[-1].end)


def _call(tokens: Sequence[Token]) -> Call:
    """Return the call that the tokens of a statement are."""
    name = tokens[0].word if tokens[0].kind == "name" else ""
    rest = tokens[1:]
    if not name:
        # A procedure whose name is computed stands between per cent signs.
        closing = next((i for i in range(1, len(tokens)) if tokens[i].word == "%"), 0)
        rest = tokens[closing + 1 :]
    arguments: list[Value] = []
    options: dict[str, Value | None] = {}
    for segment in split(rest, ","):
        plain, *optional = split(segment, "\\")
        if plain:
            arguments.append(value_of(plain))
        for part in optional:
            if not part:
                continue
            has_value = len(part) > 2 and part[1].word == ":="
            options[part[0].word] = value_of(part[2:]) if has_value else None
    return Call(name, tuple(arguments), options, tokens)


class _Parser:
    """Goes through the tokens of a file once."""

    def __init__(self, tokens: list[Token], file: int) -> None:
        self._tokens = tokens
        self._file = file
        self._at = 0

    def _word(self, offset: int = 0) -> str:
        """Return the word at the place, or so many tokens on; empty behind the end and for strings."""
        i = self._at + offset
        if i >= len(self._tokens) or self._tokens[i].kind == "text":
            return ""
        return self._tokens[i].word

    def _has_more(self) -> bool:
        """Test whether there are more tokens."""
        return self._at < len(self._tokens)

    def _up_to(self, *marks: str) -> Sequence[Token]:
        """Return the tokens up to a mark outside brackets, and go behind it."""
        depth = 0
        begin = self._at
        while self._has_more():
            token = self._tokens[self._at]
            if token.kind == "mark" and token.word in _OPENING:
                depth += 1
            elif token.kind == "mark" and token.word in _CLOSING:
                depth -= 1
            elif token.kind == "name" and token.word in _NEVER_INSIDE and token.word not in marks:
                break
            elif token.kind != "text" and token.word in marks and (depth <= 0 or token.word == ";"):
                self._at += 1
                return self._tokens[begin : self._at - 1]
            self._at += 1
        return self._tokens[begin : self._at]

    def modules(self) -> Iterator[Module]:
        """Yield the modules of the file that have an end."""
        while self._has_more():
            if self._word() == "module":
                self._at += 1
                module = self._module()
                if module is not None:
                    yield module
            else:
                self._at += 1

    def _module(self) -> Module | None:
        """Return the module behind its first word; None if it has no end."""
        # Its name may begin with a digit, and then is several tokens; attributes follow in parentheses.
        name = self._word()
        end = -1
        while self._has_more() and self._word() != "(":
            token = self._tokens[self._at]
            if end not in (-1, token.start):
                break
            end = token.end
            self._at += 1
        if self._word() == "(":
            self._at = _closing(self._tokens, self._at) + 1
        module = Module(self._file, name)
        while self._has_more():
            word = self._word()
            if word == "endmodule":
                self._at += 1
                return module
            if word == "record":
                self._record(module)
            elif word == "alias":
                alias = self._up_to(";")
                if len(alias) >= 3:
                    module.records[alias[2].word] = (("", alias[1].word),)
            else:
                self._member(module)
        return None

    def _record(self, module: Module) -> None:
        """Read the definition of a record."""
        self._at += 1
        name = self._word()
        self._at += 1
        components: list[tuple[str, str]] = []
        while self._has_more() and self._word() not in ("endrecord", *_NEVER_INSIDE):
            part = self._up_to(";")
            if len(part) >= 2:
                components.append((part[1].word, part[0].word))
        if self._word() == "endrecord":
            self._at += 1
        module.records[name] = tuple(components)

    def _member(self, module: Module) -> None:
        """Read data or a routine of a module."""
        begin = self._at
        is_local = False
        while self._word() in ("local", "task"):
            is_local = is_local or self._word() == "local"
            self._at += 1
        word = self._word()
        if word in ("record", "alias"):
            return
        if word in _STORAGE:
            for data in self._data(is_local=is_local):
                module.data.setdefault(data.name, data)
        elif word in _ENDS:
            routine = self._routine(is_local=is_local)
            module.routines.setdefault(routine.name, routine)
        else:
            self._up_to(";", "endmodule")
            if self._tokens[self._at - 1].word == "endmodule":
                self._at -= 1
            self._at = max(self._at, begin + (word != "endmodule"))

    def _data(self, *, is_local: bool) -> Iterator[Data]:
        """Yield the data of the declaration at the place."""
        self._at += 1
        declared = self._up_to(";")
        if len(declared) < 2:
            return
        type_name = declared[0].word
        for part in split(declared[1:], ","):
            head, *rest = split(part, ":=")
            if not head:
                continue
            dimensions = 0
            if len(head) > 1 and head[1].word == "{":
                dimensions = len(split(head[2 : _closing(head, 1)], ","))
            value = value_of(rest[0]) if rest and rest[0] else None
            yield Data(head[0].word, type_name, dimensions, value, is_local, head[0].start)

    def _routine(self, *, is_local: bool) -> Routine:
        """Return the routine at the place."""
        kind = self._word()
        start = self._tokens[self._at].start
        self._at += 1
        if kind == "func":
            self._at += 1
        name = self._word()
        self._at += 1
        parameters: tuple[Parameter, ...] = ()
        if self._word() == "(":
            closing = _closing(self._tokens, self._at)
            parameters = tuple(_parameters(self._tokens[self._at + 1 : closing]))
            self._at = closing + 1
        routine = Routine(kind, name, is_local, parameters, start)
        ends = (_ENDS[kind], "endmodule", *_HANDLERS)
        routine.body = self._block(routine, ends)
        handlers: list[Node] = []
        while self._word() in _HANDLERS:
            self._at += 1
            if self._word() == "(":
                self._at = _closing(self._tokens, self._at) + 1
            handlers.append(Branch((self._block(routine, ends), ())))
        routine.handlers = tuple(handlers)
        if self._word() == _ENDS[kind]:
            self._at += 1
        return routine

    def _block(self, routine: Routine, ends: tuple[str, ...]) -> tuple[Node, ...]:
        """Return the statements up to one of the words that end them, and stay there."""
        nodes: list[Node] = []
        while self._has_more():
            word = self._word()
            if word in ends or word in ("endproc", "endfunc", "endtrap", "endmodule"):
                # ERROR is also the name of nothing else; a label or a value is not followed by a statement.
                break
            begin = self._at
            if word in _STORAGE:
                for data in self._data(is_local=True):
                    routine.data.setdefault(data.name, data)
            elif word == "if":
                nodes.append(self._if(routine))
            elif word in ("for", "while"):
                self._up_to("do", ";")
                body = self._block(routine, (f"end{word}",))
                self._skip(f"end{word}")
                nodes.append(Loop(body))
            elif word == "test":
                nodes.append(self._test(routine))
            elif word == "<" and self._word(2) == ">":
                # The place of a statement that is not written yet: <SMT>
                self._at += 3
            elif word in (";", "endif", "endfor", "endwhile", "endtest", "else", "elseif"):
                self._at += 1
            else:
                nodes.append(self._statement())
            self._at = max(self._at, begin + 1)
        return tuple(nodes)

    def _skip(self, word: str) -> None:
        """Go behind a word, if it is at the place."""
        if self._word() == word:
            self._at += 1

    def _if(self, routine: Routine) -> Node:
        """Return the branches of the IF at the place, which may have a single statement and no end."""
        self._at += 1
        begin = self._at
        self._up_to("then", ";")
        if self._tokens[self._at - 1].word != "then":
            self._at = _after_condition(self._tokens, begin, self._at)
            return Branch(((self._statement(),), ()))
        ways = []
        has_else = False
        while self._has_more():
            ways.append(self._block(routine, ("elseif", "else", "endif")))
            if self._word() == "elseif":
                self._up_to("then", ";")
            elif self._word() == "else":
                self._at += 1
                has_else = True
            else:
                break
        self._skip("endif")
        return Branch((*ways,) if has_else else (*ways, ()))

    def _test(self, routine: Routine) -> Node:
        """Return the branches of the TEST at the place."""
        self._at += 1
        ends = ("case", "default", "endtest")
        while self._has_more() and self._word() not in (*ends, "endproc", "endmodule"):
            self._at += 1
        ways = []
        has_default = False
        while self._word() in ("case", "default"):
            has_default = has_default or self._word() == "default"
            self._up_to(":", ";")
            ways.append(self._block(routine, ends))
        self._skip("endtest")
        return Branch((*ways,) if has_default else (*ways, ()))

    def _statement(self) -> Statement:
        """Return the simple statement at the place."""
        if self._tokens[self._at].kind == "name" and self._word(1) == ":":
            label = self._tokens[self._at : self._at + 1]
            self._at += 2
            return Control("label", label[0].word, label)
        tokens = self._up_to(";")
        if not tokens:
            return Control("other", "", self._tokens[self._at - 1 : self._at])
        word = tokens[0].word
        if word == "goto":
            return Control("goto", tokens[-1].word, tokens)
        if word in ("return", "raise", "exit", "exitcycle", "trynext", "retry"):
            return Control("return" if word == "return" else "end", "", tokens)
        if word == "connect":
            return Control("other", "", tokens)
        target, *values = split(tokens, ":=")
        reference = _reference(target) if values and target else None
        if reference is not None:
            return Assignment(reference, tokens)
        return _call(tokens)


def _after_condition(tokens: Sequence[Token], begin: int, end: int) -> int:
    """Return where the statement begins behind a condition without THEN: at the first of two operands side by side."""
    depth = 0
    is_operand = False
    for i in range(begin, end):
        token = tokens[i]
        if token.word in _OPENING and token.kind == "mark":
            is_operand = False
            depth += 1
        elif token.word in _CLOSING and token.kind == "mark":
            depth -= 1
            is_operand = True
        elif token.kind == "mark" or token.word in _OPERATORS:
            # A late-bound call begins with a per cent sign.
            if token.word == "%" and is_operand and depth == 0:
                return i
            is_operand = False
        else:
            if is_operand and depth == 0 and token.kind == "name":
                return i
            is_operand = True
    return begin


def _parameters(tokens: Sequence[Token]) -> Iterator[Parameter]:
    """Yield the parameters of a routine; of alternatives each."""
    for part in split(tokens, ","):
        for place, group in enumerate(split(part, "\\")):
            for alternative in split(group, "|"):
                words = [token.word for token in alternative]
                kept = [word for word in words if word not in ("inout", "var", "pers", "ref")]
                if len(kept) >= 2:
                    yield Parameter(kept[1], kept[0], place > 0)


def statements(nodes: Sequence[Node]) -> Iterator[Statement]:
    """Yield all statements in the order of the text."""
    for node in nodes:
        if isinstance(node, Branch):
            for way in node.ways:
                yield from statements(way)
        elif isinstance(node, Loop):
            yield from statements(node.body)
        else:
            yield node
