"""The text of URScript programs as functions with statements, and their expressions as far as targets need them.

A line ends a statement outside brackets. What follows ``#``, and lines that begin with ``$``, in which PolyScope names
the nodes of its tree, are no code.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

import numpy as np

from calib.verbs.compensate.programs.flow import Branch, Loop, Node
from calib.verbs.compensate.programs.program_file import NumberText

_TOKEN = re.compile(
    r"""(?P<blank>[^\S\n]+ | \#[^\n]* | ^[^\S\n]*\$[^\n]*)
    | (?P<line>\n | ;)
    | (?P<text>"[^"\n]*"? | '[^'\n]*')
    | (?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)
    | (?P<name>[A-Za-z_\x80-\xff][A-Za-z0-9_\x80-\xff]*)
    | (?P<mark>==|!=|<=|>=|:=|.)""",
    re.VERBOSE | re.DOTALL | re.MULTILINE,
)

_OPENING = ("(", "[", "{")
_CLOSING = (")", "]", "}")

#: Words that begin a function.
_FUNCTIONS = ("def", "thread", "sec")

#: Words that end a block.
_ENDS = ("end", "elif", "else")

#: Words that are no names of variables.
_KEYWORDS = frozenset(
    {
        *("and", "or", "not", "xor", "True", "False", "true", "false", "None", "in", "pass"),
        *("if", "elif", "else", "end", "while", "for", "def", "thread", "sec", "return", "break"),
        *("continue", "halt", "global", "local", "run", "join", "kill"),
        *("enter_critical", "exit_critical"),
    }
)

_DEGREE = np.pi / 180.0


class Token(NamedTuple):
    """A word of the text: characters ``start`` to ``end`` of the file, the end excluded."""

    #: ``"name"``, ``"number"``, ``"text"``, ``"mark"`` or ``"line"``.
    kind: str
    word: str
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class Numbers:
    """A list of numbers, or a pose of six."""

    is_pose: bool
    #: None: not all of them are numbers as such.
    numbers: tuple[NumberText, ...] | None
    #: Radians or metres in one unit of each: of ``d2r(90)`` those of a degree.
    scales: tuple[float, ...]
    #: The expressions in the brackets.
    items: tuple[Expression, ...]
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class Name:
    """The name of a variable."""

    name: str
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class Call:
    """A call of a function."""

    name: str
    arguments: tuple[Expression, ...]
    #: Arguments by name.
    named: dict[str, Expression]
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class Other:
    """Any other expression."""

    #: Names in it.
    names: frozenset[str]
    #: Calls in it, inner ones first.
    calls: tuple[Call, ...]
    start: int
    end: int


Expression: TypeAlias = "Numbers | Name | Call | Other"


@dataclass(frozen=True, slots=True, eq=False)
class Statement:
    """A statement that is no block."""

    #: ``"assignment"``, ``"part"`` for one of a part of a variable, ``"return"``, ``"break"`` or ``"call"``.
    kind: str
    #: The variable of an assignment.
    name: str
    #: ``"global"``, ``"local"`` or empty.
    where: str
    value: Expression | None
    start: int


@dataclass(slots=True, eq=False)
class Function:
    """A function, a thread, or the text outside all of them."""

    #: ``"def"``, ``"thread"``, ``"sec"`` or ``"file"``.
    kind: str
    name: str
    parameters: tuple[str, ...]
    outer: Function | None
    body: tuple[Node, ...] = ()
    functions: dict[str, Function] = field(default_factory=dict)
    #: Names of its own variables.
    variables: set[str] = field(default_factory=set)


def read_functions(text: str) -> Function:
    """Return the text outside all functions, which has these."""
    if text.startswith("\xef\xbb\xbf"):
        text = "   " + text[3:]
    tokens = []
    for match in _TOKEN.finditer(text):
        kind = match.lastgroup or ""
        if kind != "blank":
            tokens.append(Token(kind, match[0], match.start(), match.end()))
    top = Function("file", "", (), None)
    _Parser(tokens).fill(top)
    return top


def calls_in(expression: Expression | None) -> Iterator[Call]:
    """Yield the calls in an expression, inner ones first."""
    if isinstance(expression, Call):
        for argument in (*expression.arguments, *expression.named.values()):
            yield from calls_in(argument)
        yield expression
    elif isinstance(expression, Other):
        yield from expression.calls
    elif isinstance(expression, Numbers):
        for item in expression.items:
            yield from calls_in(item)


def names_in(expression: Expression | None) -> frozenset[str]:
    """Return all names of variables in an expression."""
    if isinstance(expression, Name):
        return frozenset({expression.name})
    if isinstance(expression, Other):
        return expression.names
    if isinstance(expression, Numbers):
        return frozenset().union(*(names_in(item) for item in expression.items))
    if isinstance(expression, Call):
        inside = (*expression.arguments, *expression.named.values())
        return frozenset().union(*(names_in(item) for item in inside))
    return frozenset()


def all_functions(function: Function) -> Iterator[Function]:
    """Yield a function and all inside it, in the order of the text."""
    yield function
    for inner in function.functions.values():
        yield from all_functions(inner)


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


def _split(tokens: Sequence[Token]) -> list[Sequence[Token]]:
    """Split tokens at commas outside all brackets; empty parts are left out."""
    parts = []
    depth = begin = 0
    for i, token in enumerate(tokens):
        if token.kind != "mark":
            continue
        depth += (token.word in _OPENING) - (token.word in _CLOSING)
        if token.word == "," and depth == 0:
            parts.append(tokens[begin:i])
            begin = i + 1
    parts.append(tokens[begin:])
    return [part for part in parts if part]


def _closing(tokens: Sequence[Token], opening: int) -> int:
    """Return the index of the bracket that closes the one at an index; the number of tokens if none does."""
    depth = 0
    for i in range(opening, len(tokens)):
        if tokens[i].kind == "mark":
            depth += (tokens[i].word in _OPENING) - (tokens[i].word in _CLOSING)
            if depth == 0:
                return i
    return len(tokens)


def _unwrapped(tokens: Sequence[Token]) -> Sequence[Token]:
    """Return tokens without parentheses around all of them."""
    while len(tokens) > 2 and tokens[0].word == "(" and _closing(tokens, 0) == len(tokens) - 1:
        tokens = tokens[1:-1]
    return tokens


def _number(tokens: Sequence[Token]) -> tuple[NumberText, float] | None:
    """Return a number with its sign and its unit [rad or m], or None: ``-1.2``, ``d2r(-90)``."""
    words = [token.word for token in tokens]
    if words[:2] == ["d2r", "("] and words[-1] == ")":
        inside = _number(tokens[2:-1]) if len(tokens) > 3 else None
        is_plain = inside is not None and inside[1] == 1.0
        return (inside[0], _DEGREE) if inside is not None and is_plain else None
    sign = words[0] if len(tokens) == 2 and words[0] in ("-", "+") else ""
    if tokens[-1].kind != "number" or len(tokens) != 1 + bool(sign):
        return None
    value = float(words[-1])
    start, end = tokens[0].start, tokens[-1].end
    return NumberText(start, end, -value if sign == "-" else value), 1.0


def expression_of(tokens: Sequence[Token]) -> Expression:
    """Return the expression that tokens, at least one, are."""
    tokens = [token for token in tokens if token.kind != "line"] or list(tokens)
    tokens = _unwrapped(tokens)
    first = tokens[0]
    start, end = first.start, tokens[-1].end
    if len(tokens) == 1 and first.kind == "name" and first.word not in _KEYWORDS:
        return Name(first.word, start, end)
    is_pose = first.word == "p" and len(tokens) > 1 and tokens[1].word == "["
    opening = 1 if is_pose else 0
    if tokens[opening].word == "[" and _closing(tokens, opening) == len(tokens) - 1:
        parts = _split(tokens[opening + 1 : -1])
        numbers = [_number(part) for part in parts]
        items = tuple(expression_of(part) for part in parts)
        known = [number for number in numbers if number is not None]
        if len(known) < len(numbers):
            return Numbers(is_pose, None, (), items, start, end)
        texts = tuple(text for text, _ in known)
        return Numbers(is_pose, texts, tuple(scale for _, scale in known), items, start, end)
    is_call = first.kind == "name" and len(tokens) > 2 and tokens[1].word == "("
    if is_call and first.word not in _KEYWORDS and _closing(tokens, 1) == len(tokens) - 1:
        return _call(tokens)
    names: set[str] = set()
    calls: list[Call] = []
    i = 0
    while i < len(tokens):
        token = tokens[i]
        follows = tokens[i + 1].word if i + 1 < len(tokens) else ""
        if token.kind == "name" and token.word not in _KEYWORDS:
            if follows == "(":
                closing = _closing(tokens, i + 1)
                call = _call(tokens[i : closing + 1])
                calls += calls_in(call)
                names |= names_in(call)
                i = closing
            elif not (token.word == "p" and follows == "["):
                names.add(token.word)
        i += 1
    return Other(frozenset(names), tuple(calls), start, end)


def _call(tokens: Sequence[Token]) -> Call:
    """Return the call that tokens are, a name and what is in its parentheses."""
    arguments, named = [], {}
    inside = tokens[2:-1] if tokens[-1].word == ")" else tokens[2:]
    for part in _split([token for token in inside if token.kind != "line"]):
        if len(part) > 2 and part[0].kind == "name" and part[1].word == "=":
            named[part[0].word] = expression_of(part[2:])
        else:
            arguments.append(expression_of(part))
    return Call(tokens[0].word, tuple(arguments), named, tokens[0].start, tokens[-1].end)


class _Parser:
    """Goes through the tokens of a file once."""

    def __init__(self, tokens: list[Token]) -> None:
        self._tokens = tokens
        self._at = 0

    def fill(self, function: Function) -> None:
        """Read the text outside all functions; an END too many ends none of it."""
        nodes: list[Node] = []
        while self._at < len(self._tokens):
            nodes += self._block(function)
            self._at += 1
        function.body = tuple(nodes)

    def _word(self, offset: int = 0) -> str:
        """Return the word at the place, or so many tokens on; empty behind the end and for strings."""
        i = self._at + offset
        if i >= len(self._tokens) or self._tokens[i].kind == "text":
            return ""
        return self._tokens[i].word

    def _begins_function(self) -> bool:
        """Test whether a function begins at the place; ``sec`` may be a variable too."""
        following = self._tokens[self._at + 1 : self._at + 2]
        has_name = bool(following) and following[0].kind == "name"
        return self._word() in _FUNCTIONS and has_name and self._word(2) in ("(", ":")

    def _line(self) -> list[Token]:
        """Return the tokens up to the end of a statement, and stay there."""
        begin = self._at
        depth = 0
        while self._at < len(self._tokens):
            token = self._tokens[self._at]
            if token.kind == "mark":
                depth += (token.word in _OPENING) - (token.word in _CLOSING)
            is_end = token.kind == "name" and token.word in _ENDS
            is_end = is_end or (self._at > begin and self._begins_function())
            if (token.kind == "line" and depth <= 0) or is_end:
                break
            self._at += 1
        return self._tokens[begin : self._at]

    def _header(self) -> list[Token]:
        """Return the tokens up to the colon of a block, and go behind it."""
        begin = self._at
        depth = 0
        while self._at < len(self._tokens):
            token = self._tokens[self._at]
            if token.kind == "mark":
                depth += (token.word in _OPENING) - (token.word in _CLOSING)
            if token.word == ":" and token.kind == "mark" and depth <= 0:
                self._at += 1
                return self._tokens[begin : self._at - 1]
            if token.kind == "line" and depth <= 0:
                break
            self._at += 1
        return self._tokens[begin : self._at]

    def _block(self, function: Function) -> list[Node]:
        """Return the statements up to a word that ends them, and stay there."""
        nodes: list[Node] = []
        while self._at < len(self._tokens) and self._word() not in _ENDS:
            begin = self._at
            word = self._word()
            if self._tokens[self._at].kind == "line":
                self._at += 1
            elif self._begins_function():
                self._function(function)
            elif word == "if":
                nodes += self._if(function)
            elif word in ("while", "for"):
                self._at += 1
                condition = self._condition()
                body = (*condition, *self._block(function))
                self._skip_end()
                nodes.append(Loop(body))
            else:
                statement = _statement(self._line())
                if statement is not None:
                    nodes.append(statement)
            self._at = max(self._at, begin + 1)
        return nodes

    def _skip_end(self) -> None:
        """Go behind END, if it is at the place."""
        if self._word() == "end":
            self._at += 1

    def _condition(self) -> list[Statement]:
        """Return the condition of a block as a statement, for the calls in it."""
        tokens = self._header()
        if not tokens:
            return []
        return [Statement("call", "", "", expression_of(tokens), tokens[0].start)]

    def _if(self, function: Function) -> list[Node]:
        """Return the condition and the branches of the IF at the place."""
        nodes: list[Node] = []
        ways: list[tuple[Node, ...]] = []
        has_else = False
        while self._word() in ("if", "elif", "else") and not has_else:
            if ways and self._word() == "if":
                break
            has_else = self._word() == "else"
            self._at += 1
            condition = self._condition()
            nodes += condition
            ways.append(tuple(self._block(function)))
        self._skip_end()
        nodes.append(Branch(tuple(ways) if has_else else (*ways, ())))
        return nodes

    def _function(self, outer: Function) -> None:
        """Read the function at the place."""
        kind = self._word()
        self._at += 1
        header = self._header()
        name = header[0].word if header else ""
        inside = header[2:-1] if header and header[-1].word == ")" else header[2:]
        parameters = [part[0].word for part in _split(inside)]
        inner = Function(kind, name, tuple(parameters), outer)
        inner.body = tuple(self._block(inner))
        while self._word() in ("elif", "else"):
            # A branch without its IF: what follows still belongs to the function.
            self._at += 1
            inner.body = (*inner.body, *self._block(inner))
        self._skip_end()
        # Of two with one name the first is kept under a name that nothing calls.
        outer.functions[name if name not in outer.functions else f"{name} {self._at}"] = inner


def _statement(tokens: Sequence[Token]) -> Statement | None:
    """Return the statement that the tokens of a line are; None for one that does nothing."""
    if not tokens:
        return None
    start = tokens[0].start
    where = ""
    if tokens[0].word in ("global", "local") and len(tokens) > 1:
        where = tokens[0].word
        tokens = tokens[1:]
    first = tokens[0].word
    if first in ("break", "continue"):
        return Statement("break", "", "", None, start)
    if first in ("return", "halt"):
        value = expression_of(tokens[1:]) if len(tokens) > 1 else None
        return Statement("return", "", "", value, start)
    depth = 0
    for i, token in enumerate(tokens):
        if token.kind != "mark":
            continue
        depth += (token.word in _OPENING) - (token.word in _CLOSING)
        if token.word in ("=", ":=") and depth == 0 and i > 0 and i + 1 < len(tokens):
            is_part = i > 1
            value = expression_of(tokens[i + 1 :])
            kind = "part" if is_part else "assignment"
            return Statement(kind, first, where, value, start)
    if first in ("run", "join", "kill") and len(tokens) > 1:
        tokens = tokens[1:]
        if first != "run":
            return None
    return Statement("call", "", where, expression_of(tokens), start)
