"""KUKA's robot language as statements of tokens, aggregates of numbers, and the ways through a routine.

A statement ends with its line, unless a brace is open. What follows a semicolon is a comment, and lines that begin with
an ampersand are attributes of the file. Words mean the same in upper and lower case.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from calib.verbs.compensate.programs.flow import Branch, Loop, Node
from calib.verbs.compensate.programs.program_file import NumberText, ProgramText

_TOKEN = re.compile(
    r"(?P<text>\"[^\"\r\n]*\"?)"
    r"|(?P<constant>'[^'\r\n]*'?)"
    r"|(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
    r"|(?P<word>[$A-Za-z_\u00c0-\u00ff][\w$]*)"
    r"|(?P<enum>\#\w*)"
    r"|(?P<comment>;[^\r\n]*)"
    r"|(?P<end>\r\n|\r|\n)"
    r"|(?P<sign>==|<=|>=|<>|[^\s])"
)

#: A binary or hexadecimal constant between quotes.
_CONSTANT = re.compile(r"'\s*([BHbh])([0-9A-Fa-f]+)\s*'")

#: A statement with an open brace goes on for no more lines than this.
_MOST_LINES = 12


@dataclass(frozen=True, slots=True)
class Token:
    """A word, a number or a sign of a program."""

    kind: str
    #: In upper case, unless it is a text.
    text: str
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class Statement:
    """The tokens of a statement; the line counts from 1."""

    file: int
    line: int
    tokens: tuple[Token, ...]

    @property
    def words(self) -> tuple[str, ...]:
        """The first three tokens, in upper case."""
        return tuple(token.text for token in self.tokens[:3])


@dataclass(frozen=True, slots=True, eq=False)
class Aggregate:
    """Values in braces, by the names of their fields."""

    file: int
    line: int
    #: Where its first brace stands in the file.
    start: int
    #: The number of each field whose value is one, by its name in upper case.
    numbers: dict[str, NumberText]
    #: Other values as text, by the name of the field in upper case.
    others: dict[str, str]

    def value(self, name: str) -> float | None:
        """Return the number of a field; None if it has none."""
        number = self.numbers.get(name)
        return None if number is None else number.value


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """A variable, an element of an array, a field of one, or a call of a function."""

    #: Its name in upper case.
    name: str
    #: The indices, as text in upper case; empty: none.
    index: str = ""
    field: str = ""
    #: The arguments of a call; None: it is no call.
    arguments: tuple[Expression, ...] | None = None

    @property
    def key(self) -> str | None:
        """The variable or the element by which it is known; None if the index is not a number."""
        if not self.index:
            return self.name
        return f"{self.name}[{self.index}]" if self.index.isdecimal() else None

    def __str__(self) -> str:
        """Return it as it might be written."""
        text = self.name + (f"[{self.index}]" if self.index else "")
        return text + (f".{self.field}" if self.field else "")


@dataclass(frozen=True, slots=True, eq=False)
class Other:
    """An expression of another kind, as text."""

    text: str


#: What stands where a value is expected; a tuple: frames with the geometric operator between them.
Expression = Aggregate | Reference | Other | tuple["Aggregate | Reference | Other", ...]


def statements(text: ProgramText, file: int) -> Iterator[Statement]:
    """Yield the statements of a file in their order.

    Args:
        text: The file.
        file: Its index, which the statements get.
    """
    tokens: list[Token] = []
    first, line, depth = 1, 1, 0
    for match in _TOKEN.finditer(text.text):
        kind = str(match.lastgroup)
        if kind == "end":
            line += 1
            if depth > 0 and line - first < _MOST_LINES:
                continue
            if tokens and tokens[0].text != "&":
                yield Statement(file, first, tuple(tokens))
            tokens, first, depth = [], line, 0
        elif kind != "comment":
            word = match[0]
            if len(tokens) == 2 and tokens[0].kind == "word" and tokens[1].text == ":":
                yield Statement(file, first, tuple(tokens))  # a label, with a statement behind it
                tokens = []
            if not tokens:
                first = line
            tokens.append(
                Token(kind, word if kind == "text" else word.upper(), match.start(), match.end())
            )
            depth += (word == "{") - (word == "}")
    if tokens and tokens[0].text != "&":
        yield Statement(file, first, tuple(tokens))


class Parser:
    """Reads expressions from the tokens of one statement."""

    def __init__(self, statement: Statement, at: int = 0) -> None:
        """Begin at a token, counted from 0."""
        self.statement, self.tokens, self.at = statement, statement.tokens, at

    def peek(self, ahead: int = 0) -> str:
        """Return the text of a token ahead; empty behind the last one."""
        at = self.at + ahead
        return self.tokens[at].text if at < len(self.tokens) else ""

    def kind(self) -> str:
        """Return the kind of the next token; empty behind the last one."""
        return self.tokens[self.at].kind if self.at < len(self.tokens) else ""

    def expression(self) -> Expression:
        """Read frames with the geometric operator between them, or one value."""
        parts = [self._value()]
        while self.peek() == ":":
            self.at += 1
            parts.append(self._value())
        return parts[0] if len(parts) == 1 else tuple(parts)

    def _value(self) -> Aggregate | Reference | Other:
        """Read an aggregate, a reference, or anything else up to where it must end."""
        if self.peek() == "{":
            return self.aggregate()
        if self.kind() == "word":
            return self._reference()
        return Other(self._skipped())

    def _reference(self) -> Reference:
        """Read a name with indices, fields and arguments."""
        name = self.peek()
        self.at += 1
        index, of, arguments = "", "", None
        while self.peek() in ("[", ".", "("):
            if self.peek() == "[":
                index = self._inside("[", "]")
            elif self.peek() == ".":
                of = self.peek(1)
                self.at += 2
            else:
                arguments = self.arguments()
        return Reference(name, index, of, arguments)

    def arguments(self) -> tuple[Expression, ...]:
        """Read the arguments in parentheses."""
        self.at += 1
        found: list[Expression] = []
        while self.at < len(self.tokens) and self.peek() != ")":
            before = self.at
            if self.peek() == ",":
                self.at += 1
                continue
            found.append(self.expression())
            rest = self._skipped()
            if rest:
                found[-1] = Other(rest)
            self.at += self.at == before  # what cannot be read is passed over
        self.at += 1
        return tuple(found)

    def _inside(self, opening: str, closing: str) -> str:
        """Read what stands in brackets, as text."""
        depth, parts = 0, []
        while self.at < len(self.tokens):
            word = self.peek()
            depth += (word == opening) - (word == closing)
            self.at += 1
            if depth == 0:
                break
            parts.append(word)
        return "".join(parts[1:])

    def _skipped(self) -> str:
        """Pass over tokens up to a comma or a closing bracket of this level, and return them as text."""
        depth, parts = 0, []
        while self.at < len(self.tokens):
            word = self.peek()
            if depth == 0 and word in (",", ")", "}", "]"):
                break
            depth += (word in "([{") - (word in ")]}")
            parts.append(word)
            self.at += 1
        return " ".join(parts)

    def aggregate(self) -> Aggregate:
        """Read values in braces."""
        start = self.tokens[self.at].start
        self.at += 1
        if self.kind() == "word" and self.peek(1) == ":":
            self.at += 2  # the type
        numbers: dict[str, NumberText] = {}
        others: dict[str, str] = {}
        while self.at < len(self.tokens) and self.peek() != "}":
            if self.kind() != "word":
                self.at += 1
                continue
            name = self.peek()
            self.at += 1
            if self.peek() == "[":
                self._inside("[", "]")
            at = self.at
            value = self._skipped()
            number = self._number(at)
            if number is None:
                others[name] = value
            else:
                numbers[name] = number
        self.at += 1
        return Aggregate(self.statement.file, self.statement.line, start, numbers, others)

    def _number(self, at: int) -> NumberText | None:
        """Return the number that the tokens from ``at`` to here are; None if they are something else."""
        tokens = self.tokens[at : self.at]
        sign = 1.0
        start = tokens[0].start if tokens else 0
        if len(tokens) == 2 and tokens[0].text in ("+", "-"):
            sign = -1.0 if tokens[0].text == "-" else 1.0
            tokens = tokens[1:]
        if len(tokens) != 1:
            return None
        if tokens[0].kind == "number":
            return NumberText(start, tokens[0].end, sign * float(tokens[0].text))
        constant = _CONSTANT.fullmatch(tokens[0].text)
        if constant is None or (constant[1] == "B" and set(constant[2]) - {"0", "1"}):
            return None
        base = 2 if constant[1] == "B" else 16
        return NumberText(start, tokens[0].end, float(int(constant[2], base)))


@dataclass(frozen=True, slots=True, eq=False)
class Routine:
    """A DEF or DEFFCT: its name and parameters in upper case, and its statements as ways through it."""

    name: str
    parameters: dict[str, bool]  # name, and whether it goes in only
    body: tuple[Node, ...] = field(default=())


#: Words that open a block, and those that close it.
_OPENING = ("IF", "SWITCH", "FOR", "WHILE", "REPEAT", "LOOP")
_CLOSING = ("ENDIF", "ENDSWITCH", "ENDFOR", "ENDWHILE", "UNTIL", "ENDLOOP")


def routines(program: Sequence[Statement]) -> list[Routine]:
    """Return the routines of a program; statements outside of any make one without a name, which comes first."""
    found: list[Routine] = []
    rest: list[Statement] = []
    header: Statement | None = None
    body: list[Statement] = []
    for statement in program:
        words = [word for word in statement.words if word != "GLOBAL"]
        word = words[0] if words else ""
        if word in ("DEF", "DEFFCT"):
            if header is not None:
                found.append(_routine(header, body))
            header, body = statement, []
        elif word in ("END", "ENDFCT") and header is not None:
            found.append(_routine(header, body))
            header, body = None, []
        elif header is None:
            rest.append(statement)
        else:
            body.append(statement)
    if header is not None:
        found.append(_routine(header, body))
    nameless = [Routine("", {}, tuple(_nodes(rest)))] if rest else []
    return nameless + found


def _routine(header: Statement, body: Sequence[Statement]) -> Routine:
    """Return a routine of its first line and its statements."""
    texts = [token.text for token in header.tokens]
    opening = texts.index("(") if "(" in texts else len(texts)
    name = texts[opening - 1] if opening > 0 else ""
    parameters: dict[str, bool] = {}
    for part in " ".join(texts[opening + 1 :]).rstrip(" )").split(","):
        word, _, way = (piece.strip() for piece in part.partition(":"))
        if word:
            parameters[word.split(" ")[0]] = way.startswith("IN")
    return Routine(name, parameters, tuple(_nodes(body)))


def _nodes(body: Sequence[Statement]) -> list[Node]:
    """Return statements as ways: loops, and branches of IF and SWITCH."""
    stack: list[tuple[str, list[list[Node]]]] = [("", [[]])]

    def close() -> None:
        """Put the innermost block into the one around it."""
        word, ways = stack.pop()
        inner = stack[-1][1][-1]
        if word == "IF":
            # Without an ELSE the way past it is a way too.
            inner.append(Branch(tuple(map(tuple, ways if len(ways) > 1 else [*ways, []]))))
        elif word == "SWITCH":
            inner.append(Branch(tuple(map(tuple, [*ways, []]))))
        else:
            inner.append(Loop(tuple(ways[0])))

    for statement in body:
        word = statement.tokens[0].text
        if word in _OPENING:
            stack.append((word, [[]]))
        elif word in ("ELSE", "CASE", "DEFAULT") and stack[-1][0] in ("IF", "SWITCH"):
            stack[-1][1].append([])
        elif word in _CLOSING and len(stack) > 1:
            close()
        else:
            stack[-1][1][-1].append(statement)
    while len(stack) > 1:
        close()
    return stack[0][1][0]
