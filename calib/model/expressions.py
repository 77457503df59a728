"""The expressions of a xacro, worked out step by step without Python's own evaluation.

What is understood is arithmetic, comparisons, text, lists, tables, comprehensions and the functions that xacro lends.
Attributes are those of a fixed list, so that there is no way from a number to Python's inside; and every step costs, so
that no expression runs for ever or fills the memory.
"""

# ruff: noqa: ANN401  the values of a xacro are of any type

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from calib.model.expression_functions import METHODS, Budget, Own, Refused, joined, result

__all__ = ["Budget", "Evaluator", "Refused"]

#: A longer expression is none [characters].
LONGEST = 20_000

_COMPARE: Mapping[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda a, b: a in b,
    ast.NotIn: lambda a, b: a not in b,
}
_UNARY: Mapping[type[ast.unaryop], Callable[[Any], Any]] = {
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
    ast.Not: operator.not_,
    ast.Invert: operator.invert,
}


@dataclass(frozen=True, slots=True)
class _Scope:
    """Names of a comprehension or a function before those outside."""

    inner: Mapping[str, Any]
    outer: Any

    def __contains__(self, name: object) -> bool:
        return name in self.inner or name in self.outer

    def __getitem__(self, name: str) -> Any:
        return self.inner[name] if name in self.inner else self.outer[name]


@dataclass(frozen=True, slots=True)
class Evaluator:
    """What works out expressions for one xacro.

    Attributes:
        budget: What all of them together may cost.
        functions: What a call of an object does, by the object's `id`; nothing else can be called.
        namespaces: Classes whose attributes are the keys that they hold.
        kept: The objects of ``functions``, so that no other gets one of their ids.
    """

    budget: Budget
    functions: Mapping[int, Callable[..., Any]]
    namespaces: tuple[type, ...] = ()
    kept: tuple[object, ...] = field(default=(), repr=False)

    def __call__(self, text: str, names: Any) -> Any:
        """The value of an expression.

        Args:
            text: The expression.
            names: What its names mean.

        Raises:
            Refused: It does what a xacro must not, or costs too much.
            Exception: Whatever is wrong with it otherwise, as Python says it.
        """
        text = text.strip()
        if len(text) > LONGEST:
            message = f"an expression of {len(text):,} characters; {LONGEST:,} are the most"
            raise Refused(message)
        try:
            tree = ast.parse(text, "<expression>", "eval")
        except MemoryError as error:  # of the parser, for brackets within brackets
            message = "it is nested too deeply"
            raise Refused(message) from error
        return self._value(tree.body, names)

    def _value(self, node: ast.expr, names: Any) -> Any:
        """The value of a part."""
        self.budget.spend(1)
        found = _KINDS.get(type(node))
        if found is None:
            message = f"'{ast.unparse(node)[:60]}' is not read in a xacro's expression"
            raise Refused(message)
        value = found(self, node, names)
        self.budget.made(value)
        return value

    def _constant(self, node: ast.Constant, _names: Any) -> Any:
        """A number, a text, True, False or None."""
        if isinstance(node.value, bytes) or node.value is ...:
            message = f"{node.value!r:.60} is not read in a xacro's expression"
            raise Refused(message)
        return result(node.value)

    def _name(self, node: ast.Name, names: Any) -> Any:
        """What a name means."""
        if node.id.startswith("__"):
            message = f"Use of invalid name(s): {node.id}"
            raise Refused(message)
        if node.id not in names:
            message = f"name '{node.id}' is not defined"
            raise NameError(message)
        return names[node.id]

    def _attribute(self, node: ast.Attribute, names: Any) -> Any:
        """A key of a namespace or of a YAML table; a method out of the list."""
        owner: Any = self._value(node.value, names)
        name = node.attr
        if name.startswith("_"):
            message = f"Use of invalid name(s): {name}"
            raise Refused(message)
        if isinstance(owner, self.namespaces):
            return self._name(ast.Name(name), owner)
        for kind, methods in METHODS.items():
            if isinstance(owner, kind):
                if name in methods:
                    return _Method(owner, methods[name])
                break
        if isinstance(owner, dict):
            return _element(owner, name)
        if isinstance(owner, (int, float, complex)) and name in ("real", "imag"):
            return getattr(owner, name)
        message = f"'.{name}' of {type(owner).__name__} is not read in a xacro's expression"
        raise Refused(message)

    def _subscript(self, node: ast.Subscript, names: Any) -> Any:
        """An element, or a part of a sequence."""
        owner, key = self._value(node.value, names), self._value(node.slice, names)
        if not isinstance(owner, (str, list, tuple, dict, range, *self.namespaces)):
            message = f"{type(owner).__name__} has no elements"
            raise TypeError(message)
        return _element(owner, key)

    def _slice(self, node: ast.Slice, names: Any) -> slice:
        """The bounds of a part."""
        parts = (node.lower, node.upper, node.step)
        return slice(*(None if part is None else self._value(part, names) for part in parts))

    def _call(self, node: ast.Call, names: Any) -> Any:
        """A function that xacro lends, one of the expression's own, or a method."""
        function = self._value(node.func, names)
        positional: list[Any] = list(self._elements(node.args, names))
        named: dict[str, Any] = {}
        for keyword in node.keywords:
            value = self._value(keyword.value, names)
            named.update({keyword.arg: value} if keyword.arg is not None else dict(value))
        self.budget.spend(len(positional) + len(named))
        if isinstance(function, _Method):
            return result(function.function(self.budget, function.owner, *positional, **named))
        if isinstance(function, Own):
            return function(*positional, **named)
        if id(function) not in self.functions:
            message = f"'{ast.unparse(node.func)[:60]}' is no function that a xacro may call"
            raise Refused(message)
        return result(self.functions[id(function)](*positional, **named))

    def _elements(self, nodes: Iterable[ast.expr], names: Any) -> Iterator[Any]:
        """The elements of a list, those behind a star one by one."""
        for node in nodes:
            if isinstance(node, ast.Starred):
                yield from self.budget.each(self._value(node.value, names))
            else:
                yield self._value(node, names)

    def _binary(self, node: ast.BinOp, names: Any) -> Any:
        """A sum, a product and so on."""
        return joined(node.op, self._value(node.left, names), self._value(node.right, names))

    def _unary(self, node: ast.UnaryOp, names: Any) -> Any:
        """A sign, not."""
        return _UNARY[type(node.op)](self._value(node.operand, names))

    def _logic(self, node: ast.BoolOp, names: Any) -> Any:
        """And, or."""
        value = None
        for part in node.values:
            value = self._value(part, names)
            if bool(value) is isinstance(node.op, ast.Or):
                break
        return value

    def _comparison(self, node: ast.Compare, names: Any) -> Any:
        """Less than, in, and so on, one after the other."""
        left = self._value(node.left, names)
        found: Any = True
        for kind, part in zip(node.ops, node.comparators, strict=True):
            right = self._value(part, names)
            for side in (left, right):
                self.budget.weigh(side)
            found = _COMPARE[type(kind)](left, right)
            if not found:
                break
            left = right
        return found

    def _choice(self, node: ast.IfExp, names: Any) -> Any:
        """One value or the other."""
        return self._value(node.body if self._value(node.test, names) else node.orelse, names)

    def _list(self, node: ast.List, names: Any) -> Any:
        return result(list(self._elements(node.elts, names)))

    def _tuple(self, node: ast.Tuple, names: Any) -> Any:
        return result(tuple(self._elements(node.elts, names)))

    def _set(self, node: ast.Set, names: Any) -> Any:
        return result(set(self._elements(node.elts, names)))

    def _dict(self, node: ast.Dict, names: Any) -> Any:
        """A table; another one may stand in it behind two stars."""
        table: dict[Any, Any] = {}
        for key, value in zip(node.keys, node.values, strict=True):
            if key is None:
                table.update(dict(self._value(value, names)))
            else:
                table[self._value(key, names)] = self._value(value, names)
        return result(table)

    def _rows(self, generators: list[ast.comprehension], names: Any) -> Iterator[Any]:
        """The names of each round of a comprehension."""
        if not generators:
            yield names
            return
        first, *rest = generators
        if first.is_async:
            message = "'async' is not read in a xacro's expression"
            raise Refused(message)
        for value in self.budget.each(self._value(first.iter, names)):
            inner = _Scope(dict(_bound(first.target, value)), names)
            if all(self._value(test, inner) for test in first.ifs):
                yield from self._rows(rest, inner)

    def _comprehension(self, node: Any, names: Any) -> Any:
        """A list, or set, made by a rule; a generator is a list here."""
        found = [self._value(node.elt, inner) for inner in self._rows(node.generators, names)]
        return result(set(found) if isinstance(node, ast.SetComp) else found)

    def _table_by_rule(self, node: ast.DictComp, names: Any) -> Any:
        """A table made by a rule."""
        return result(
            {
                self._value(node.key, inner): self._value(node.value, inner)
                for inner in self._rows(node.generators, names)
            }
        )

    def _function(self, node: ast.Lambda, names: Any) -> Any:
        """A function of the expression's own."""
        given = node.args
        if given.vararg or given.kwarg or given.kwonlyargs or given.posonlyargs or given.defaults:
            message = "a lambda has plain arguments in a xacro's expression"
            raise Refused(message)
        return _Function(self, tuple(a.arg for a in given.args), node.body, names)

    def _text(self, node: ast.JoinedStr, names: Any) -> Any:
        """A text with values in it."""
        return result("".join(str(self._value(part, names)) for part in node.values))

    def _formatted(self, node: ast.FormattedValue, names: Any) -> str:
        """A value in a text."""
        value = self._value(node.value, names)
        self.budget.weigh(value)
        if node.conversion == ord("r"):
            value = repr(value)
        spec = "" if node.format_spec is None else str(self._value(node.format_spec, names))
        return str(METHODS[str]["format"](self.budget, "{:" + spec + "}", value))


@dataclass(frozen=True, slots=True)
class _Method:
    """A method of a value, see `METHODS`."""

    owner: Any
    function: Callable[..., Any]


@dataclass(frozen=True, slots=True)
class _Function(Own):
    """A lambda."""

    evaluator: Evaluator
    arguments: tuple[str, ...]
    body: ast.expr
    names: Any

    def __call__(self, *values: Any, **named: Any) -> Any:
        """Its value."""
        if len(values) + len(named) != len(self.arguments):
            message = f"the function takes {len(self.arguments)} arguments"
            raise TypeError(message)
        inner = {**dict(zip(self.arguments, values, strict=False)), **named}
        return self.evaluator._value(self.body, _Scope(inner, self.names))


def _element(owner: Any, key: Any) -> Any:
    """An element, as the owner itself finds it."""
    return owner[key]


def _bound(target: ast.expr, value: Any) -> Iterator[tuple[str, Any]]:
    """The names of a comprehension's target."""
    if isinstance(target, ast.Name):
        yield target.id, value
    elif isinstance(target, (ast.Tuple, ast.List)):
        for part, one in zip(target.elts, value, strict=True):
            yield from _bound(part, one)
    else:
        message = f"'{ast.unparse(target)[:60]}' is not read in a xacro's expression"
        raise Refused(message)


_KINDS: Mapping[type[ast.expr], Callable[..., Any]] = {
    ast.Constant: Evaluator._constant,
    ast.Name: Evaluator._name,
    ast.Attribute: Evaluator._attribute,
    ast.Subscript: Evaluator._subscript,
    ast.Slice: Evaluator._slice,
    ast.Call: Evaluator._call,
    ast.BinOp: Evaluator._binary,
    ast.UnaryOp: Evaluator._unary,
    ast.BoolOp: Evaluator._logic,
    ast.Compare: Evaluator._comparison,
    ast.IfExp: Evaluator._choice,
    ast.List: Evaluator._list,
    ast.Tuple: Evaluator._tuple,
    ast.Set: Evaluator._set,
    ast.Dict: Evaluator._dict,
    ast.ListComp: Evaluator._comprehension,
    ast.SetComp: Evaluator._comprehension,
    ast.GeneratorExp: Evaluator._comprehension,
    ast.DictComp: Evaluator._table_by_rule,
    ast.Lambda: Evaluator._function,
    ast.JoinedStr: Evaluator._text,
    ast.FormattedValue: Evaluator._formatted,
}
