"""The functions and methods that a xacro's expressions have, none of which takes more time or memory than it should."""

# ruff: noqa: ANN401  the values of a xacro are of any type

from __future__ import annotations

import ast
import functools
import math
import operator
import re
import string
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

#: The largest integer [bits], text [characters] and list [elements] of an expression.
BITS, CHARACTERS, ELEMENTS = 4096, 1_000_000, 100_000

_WIDEST = 200
_DIGITS = re.compile(r"[0-9]+")
_PERCENT = re.compile(r"%(?:\([^()]*\))?[#0 +-]*([0-9]+|\*)?(?:\.([0-9]+|\*)?)?")
_PLAIN_FIELD = re.compile(r"\w*")


class Refused(ValueError):
    """What a xacro must not do."""


@dataclass(slots=True)
class Budget:
    """What the expressions of one file may cost together.

    Attributes:
        left: Steps that are left.
    """

    left: int = 1_000_000

    def spend(self, steps: int) -> None:
        """Take steps away.

        Raises:
            Refused: None are left.
        """
        self.left -= steps
        if self.left < 0:
            message = (
                "the file takes more steps than that of any robot; it is not worked out any further"
            )
            raise Refused(message)

    def each(self, values: Iterable[Any]) -> Iterator[Any]:
        """The values, each for a step."""
        if not isinstance(values, (str, list, tuple, dict, set, frozenset, range)) and not hasattr(
            values,
            "mapping",  # the views of a table
        ):
            message = f"'{type(values).__name__}' object is not iterable"
            raise TypeError(message)
        for value in values:
            self.spend(1)
            yield value

    def made(self, value: object) -> None:
        """Take steps away for the memory of a value itself."""
        if isinstance(value, str):
            self.spend(len(value) // 100)
        elif isinstance(value, (list, tuple, dict, set, frozenset)):
            self.spend(len(value) // 10)

    def weigh(self, value: object) -> None:
        """Take away as many steps as a value has elements, and as many hundred characters, those of its elements too.

        Raises:
            Refused: No steps are left, or its text is longer than texts are.
        """
        waiting = [value]
        characters = 0
        while waiting:
            one = waiting.pop()
            if isinstance(one, dict):
                self.spend(1 + 2 * len(one))
                waiting += [*dict.keys(one), *dict.values(one)]
            elif isinstance(one, (list, tuple, set, frozenset)):
                self.spend(1 + len(one))
                waiting += list.__iter__(one) if isinstance(one, list) else one
            elif isinstance(one, (str, int)):
                # Three bits make a digit, about.
                size = len(one) if isinstance(one, str) else one.bit_length() // 3
                self.spend(size // 100)
                characters += size
                _check(characters, CHARACTERS, "characters")


def result(value: Any) -> Any:
    """The value.

    Raises:
        Refused: It is larger than a xacro's values are.
    """
    if isinstance(value, int):
        _check(value.bit_length(), BITS, "bits")
    elif isinstance(value, str):
        _check(len(value), CHARACTERS, "characters")
    elif isinstance(value, (list, tuple, dict, set, frozenset, range)):
        _check(len(value), ELEMENTS, "elements")
    return value


def _check(size: int, most: int, what: str) -> None:
    """Refuse a value that is too large."""
    if size > most:
        message = f"it makes a value of {size:,} {what}, and {most:,} are the most"
        raise Refused(message)


_OPERATIONS: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
    ast.LShift: operator.lshift,
    ast.RShift: operator.rshift,
    ast.BitOr: operator.or_,
    ast.BitXor: operator.xor,
    ast.BitAnd: operator.and_,
}
_SEQUENCES = (str, list, tuple)


def joined(kind: ast.operator, left: Any, right: Any) -> Any:
    """A sum, product, power, ... whose size is looked at before it is worked out."""
    operation = _OPERATIONS.get(type(kind))
    if operation is None:
        message = f"the operation {type(kind).__name__} is not read in a xacro's expression"
        raise Refused(message)
    if isinstance(left, int) and isinstance(right, int):
        if isinstance(kind, ast.Pow) and right > 0:
            _check(left.bit_length() * right, BITS, "bits")
        if isinstance(kind, ast.LShift) and right > 0:
            _check(left.bit_length() + right, BITS, "bits")
    if isinstance(kind, ast.Mult):
        for sequence, times in ((left, right), (right, left)):
            if isinstance(sequence, _SEQUENCES) and isinstance(times, int):
                most = CHARACTERS if isinstance(sequence, str) else ELEMENTS
                _check(len(sequence) * times, most, "elements")
    if isinstance(kind, ast.Mod) and isinstance(left, str):
        _check_widths(left)
        Budget(ELEMENTS).weigh(right)
    return result(operation(left, right))


def _check_widths(text: str) -> None:
    """Refuse a format that makes one value longer than a line."""
    for found in _PERCENT.finditer(text):
        for digits in filter(None, found.groups()):
            if digits == "*":
                message = "'*' as a width of '%' is not read in a xacro's expression"
                raise Refused(message)
            _check(int(digits[:9]), _WIDEST, "characters")


class _Formatter(string.Formatter):
    """``format`` without attributes and elements in its fields."""

    def get_field(self, field_name: str, args: Any, kwargs: Any) -> Any:
        """The value of a field that is a number or a name."""
        if not _PLAIN_FIELD.fullmatch(field_name):
            message = f"the field '{field_name[:60]}' of format is not read in a xacro's expression"
            raise Refused(message)
        return super().get_field(field_name, args, kwargs)

    def format_field(self, value: Any, format_spec: str) -> Any:
        """A number or a text within a width."""
        for found in _DIGITS.findall(format_spec):
            _check(int(found[:9]), _WIDEST, "characters")
        if not isinstance(value, (str, int, float, complex)):
            Budget(ELEMENTS).weigh(value)
            value = str(value)
        return format(value, format_spec)


def _format(budget: Budget, text: str, *values: Any, **named: Any) -> str:
    """A text with values in its fields."""
    budget.spend(len(text) // 10)
    return _Formatter().vformat(text, values, named)


def _plain(name: str) -> Callable[..., Any]:
    """A method that takes no longer than its owner is long."""

    def call(budget: Budget, owner: Any, *values: Any, **named: Any) -> Any:
        size = len(owner) if hasattr(owner, "__len__") else 1
        budget.spend(1 + size // 100)
        for value in (*values, *named.values()):
            budget.weigh(value)
            if isinstance(value, int) and name in ("ljust", "rjust", "center", "zfill"):
                _check(value, CHARACTERS, "characters")
        if name == "replace" and len(values) > 1:
            _check((size + 1) * (1 + len(values[1])), 10 * CHARACTERS, "characters")
        return getattr(owner, name)(*values, **named)

    return call


def _join(budget: Budget, text: str, parts: Iterable[Any]) -> str:
    """Texts in a row."""
    listed = list(budget.each(parts))
    _check(sum(map(len, listed)) + len(text) * len(listed), CHARACTERS, "characters")
    return text.join(listed)


def _methods(names: str) -> dict[str, Callable[..., Any]]:
    """Methods by name."""
    return {name: _plain(name) for name in names.split()}


METHODS: Mapping[type, Mapping[str, Callable[..., Any]]] = {
    str: {
        **_methods(
            "capitalize center count endswith find index isalnum isalpha isdecimal isdigit isidentifier islower "
            "isnumeric isspace istitle isupper ljust lower lstrip partition replace rfind rindex rjust rpartition "
            "rsplit rstrip split splitlines startswith strip swapcase title upper zfill removeprefix removesuffix"
        ),
        "format": _format,
        "join": _join,
    },
    list: _methods("append copy count extend index insert pop remove reverse"),
    tuple: _methods("count index"),
    dict: _methods("copy get items keys pop update values setdefault"),
    set: _methods("add copy difference discard intersection issubset issuperset union update"),
    frozenset: _methods("copy difference intersection issubset issuperset union"),
    float: _methods("is_integer"),
    int: _methods("bit_length"),
}
"""The methods of values: what each does with the budget, its owner and its arguments."""


class Own(ABC):
    """A function that an expression defines itself, a lambda; called with values it gives one."""

    __slots__ = ()

    @abstractmethod
    def __call__(self, *values: Any, **named: Any) -> Any:
        """Its value."""


@dataclass(frozen=True, slots=True)
class Functions:
    """The functions of Python that expressions may call; all that they go through costs.

    Attributes:
        budget: Of the file.
    """

    budget: Budget

    def by_name(self) -> dict[str, Callable[..., Any]]:
        """All of them, and those of Python's module math."""
        kinds = (float, int, bool, complex, abs, divmod, ord, slice, len, isinstance, issubclass)
        collections = (list, tuple, set, frozenset, all, any)
        own: dict[str, Callable[..., Any]] = {
            "prod": self._product,
            **{name: _few(getattr(math, name)) for name in ("factorial", "comb", "perm")},
        }
        return {
            **{k: own.get(k, v) for k, v in vars(math).items() if callable(v) and k[0] != "_"},
            **{kind.__name__: kind for kind in kinds},
            **{kind.__name__: self._of_each(kind) for kind in collections},
            **{kind.__name__: self._weighed(kind) for kind in (str, repr, hash)},
            **{kind.__name__: self._best(kind) for kind in (min, max)},
            "reversed": self._of_each(lambda values: list(values)[::-1]),
            "enumerate": lambda values, start=0: list(enumerate(self.budget.each(values), start)),
            "zip": lambda *values: list(zip(*map(self.budget.each, values), strict=False)),
            "filter": self._filter,
            "map": self._map,
            "dict": self._table,
            "sorted": self._sorted,
            "sum": self._sum,
            "round": _round,
            "range": lambda *ends: result(range(*ends)),
            "type": lambda value: type(value),
        }

    def _of_each(self, kind: Callable[..., Any]) -> Callable[..., Any]:
        """A function of a list, each element for a step."""
        return lambda values=(): kind(self.budget.each(values))

    def _weighed(self, kind: Callable[..., Any]) -> Callable[..., Any]:
        """A function that goes through all of a value."""

        def call(value: Any = "") -> Any:
            self.budget.weigh(value)
            return kind(value)

        return call

    def _best(self, kind: Callable[..., Any]) -> Callable[..., Any]:
        """The least or the greatest."""

        def call(*values: Any, key: Any = None, **named: Any) -> Any:
            listed = list(self.budget.each(values[0] if len(values) == 1 else values))
            self.budget.weigh(listed)
            return kind(listed, key=self._callable(key), **named)

        return call

    def _table(self, *values: Any, **named: Any) -> dict[Any, Any]:
        """A table."""
        for value in values:
            self.budget.weigh(value)
        return dict(*values, **named)

    def _map(self, function: Any, *values: Any) -> list[Any]:
        """A function's values."""
        call = self._callable(function) or _nothing
        return [call(*row) for row in zip(*map(self.budget.each, values), strict=False)]

    def _filter(self, function: Any, values: Any) -> list[Any]:
        """The values for which a function is true."""
        call = self._callable(function) or bool
        return [value for value in self.budget.each(values) if call(value)]

    def _sorted(self, values: Any, key: Any = None, reverse: bool = False) -> list[Any]:
        """The values in order."""
        listed = list(self.budget.each(values))
        self.budget.weigh(listed)
        return sorted(listed, key=self._callable(key), reverse=bool(reverse))

    def _sum(self, values: Any, start: Any = 0) -> Any:
        """The sum."""
        return functools.reduce(lambda a, b: self._joined(ast.Add(), a, b), values, start)

    def _product(self, values: Any, *, start: Any = 1) -> Any:
        """The product."""
        return functools.reduce(lambda a, b: self._joined(ast.Mult(), a, b), values, start)

    def _joined(self, kind: ast.operator, left: Any, right: Any) -> Any:
        """One step of a sum or product."""
        self.budget.spend(1 + (len(left) // 100 if isinstance(left, _SEQUENCES) else 0))
        return joined(kind, left, right)

    def _callable(self, function: Any) -> Callable[..., Any] | None:
        """What is handed to another function: a lambda, or one of those lent; None for None."""
        if function is None or isinstance(function, Own):
            return function
        lent = (str, float, int, bool, len, abs, list, tuple, ord, repr)
        if any(function is one for one in lent):
            return self.by_name()[function.__name__]
        if any(function is one for one in vars(math).values()):
            return self.by_name()[function.__name__]
        message = (
            "map, filter, sorted, min and max take a lambda, or a function such as float, of xacro"
        )
        raise Refused(message)


def _nothing(*_: Any) -> None:
    """What map does with None for a function."""
    message = "'NoneType' object is not callable"
    raise TypeError(message)


def _round(value: Any, digits: Any = None) -> Any:
    """A number with so many digits."""
    if digits is not None:
        _check(abs(digits), 1000, "digits")
    return round(value, digits)


def _few(kind: Callable[..., Any]) -> Callable[..., Any]:
    """A function that grows with its arguments."""

    def call(*values: int) -> Any:
        for value in values:
            _check(value, 300, "factors")
        return kind(*values)

    return call
