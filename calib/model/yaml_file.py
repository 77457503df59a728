"""YAML of other programs: read strictly, so that what a program overlooked is an error and not a number."""

from __future__ import annotations

import contextlib
from collections.abc import Hashable, Iterator
from typing import Any, ClassVar

import yaml

from calib.errors import FileError

LIMIT_BYTES = 300_000
"""Largest YAML file that is read [bytes]: PyYAML takes a second for it."""

#: Most values of a file once each alias is written out.
_MOST_VALUES = 200_000


class _StrictLoader(yaml.SafeLoader):
    """PyYAML's safe loader without aliases, and without keys that stand twice."""

    #: Of its own: other programs, xacro among them, add tags to SafeLoader that calib does not know.
    yaml_constructors: ClassVar[dict[str | None, Any]] = dict(
        yaml.constructor.SafeConstructor.yaml_constructors
    )

    @classmethod
    def whole(cls, data: bytes) -> Any:  # noqa: ANN401  whatever the file holds
        """The content of a file."""
        loader = cls(data)
        try:
            return loader.get_single_data()
        finally:
            loader.dispose()

    def compose_node(self, parent: Any, index: Any) -> Any:  # noqa: ANN401  PyYAML's own types
        """A node; aliases are refused."""
        if self.check_event(yaml.AliasEvent):
            event: Any = self.peek_event()  # type: ignore[no-untyped-call]
            raise yaml.MarkedYAMLError(
                problem=f"an alias (*{event.anchor}) is not read; write the value itself",
                problem_mark=event.start_mark,
            )
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """A mapping; a key that stands twice is refused."""
        seen: dict[Hashable, int] = {}
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, Hashable):
                continue  # PyYAML's own message says so
            line = key_node.start_mark.line + 1
            if key in seen:
                raise yaml.MarkedYAMLError(
                    problem=f"'{key}' stands twice, first in line {seen[key]}; delete one of them",
                    problem_mark=key_node.start_mark,
                )
            seen[key] = line
        return super().construct_mapping(node, deep)


def parse_yaml(data: bytes, source: str, what: str) -> Any:  # noqa: ANN401  whatever the file holds
    """The content of a YAML file's bytes.

    Args:
        data: The file.
        source: Name of the file, for messages.
        what: What the file should be, for messages: ``"origins file"``.

    Returns:
        Dictionaries, lists, text, numbers; None of an empty file.

    Raises:
        FileError: It is no YAML, a key stands twice, an alias or a tag that YAML itself does not have.
    """
    check_length(data, source, what)
    with _in_words(source, what):
        return _StrictLoader.whole(data)


def yaml_keys(data: bytes, source: str, what: str) -> tuple[str, ...]:
    """The keys of a YAML file's outermost table, whatever is under them: tags are left to who reads it.

    Args:
        data: The file.
        source: Name of the file, for messages.
        what: What the file should be, for messages.

    Returns:
        The keys in the file's order; none of a file that is no table.

    Raises:
        FileError: It is no YAML, or too long.
    """
    check_length(data, source, what)
    with _in_words(source, what):
        root = yaml.compose(data, Loader=yaml.SafeLoader)
    return (
        tuple(str(key.value) for key, _ in root.value) if isinstance(root, yaml.MappingNode) else ()
    )


def check_length(data: bytes, source: str, what: str) -> None:
    """Refuse a file that would take longer to read than any such file does.

    Raises:
        FileError: It is longer than `LIMIT_BYTES`.
    """
    if len(data) > LIMIT_BYTES:
        message = (
            f"{source}: this {what} has {len(data):,} bytes, and {LIMIT_BYTES:,} are the most that is read; check "
            "that it is the right file"
        )
        raise FileError(message)


def check_weight(root: yaml.Node) -> None:
    """Refuse a file whose aliases stand for more than it could hold itself, or for themselves.

    Args:
        root: The file's outermost node, aliases resolved.

    Raises:
        yaml.MarkedYAMLError: Written out, it has more than 200,000 values, or no end.
    """
    weights: dict[int, int] = {}
    waiting: list[tuple[yaml.Node, bool]] = [(root, False)]
    while waiting:
        node, done = waiting.pop()
        below = _below(node)
        if done:
            weights[id(node)] = 1 + sum(weights[id(one)] for one in below)
        elif id(node) not in weights:
            weights[id(node)] = _MOST_VALUES  # until it is known: of a node that holds itself
            waiting.append((node, True))
            waiting += [(one, False) for one in below]
    if weights[id(root)] > _MOST_VALUES:
        raise yaml.MarkedYAMLError(
            problem=f"its aliases stand for more than {_MOST_VALUES:,} values, or for themselves",
            problem_mark=root.start_mark,
        )


def _below(node: yaml.Node) -> list[yaml.Node]:
    """The nodes in a node."""
    if isinstance(node, yaml.MappingNode):
        return [one for pair in node.value for one in pair]
    return list(node.value) if isinstance(node, yaml.SequenceNode) else []


@contextlib.contextmanager
def _in_words(source: str, what: str) -> Iterator[None]:
    """What PyYAML raises, as a message with the file and the line."""
    try:
        yield
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = "" if mark is None else f", line {mark.line + 1}, column {mark.column + 1}"
        reason = error.problem or error.context or "it cannot be parsed"
        message = f"{source}{place}: this {what} cannot be read as YAML: {reason}"
        raise FileError(message) from error
    # A tag such as !!timestamp before what is none: PyYAML raises whatever comes of it.
    except (
        yaml.YAMLError,
        ArithmeticError,
        AttributeError,
        LookupError,
        RecursionError,
        TypeError,
        ValueError,
    ) as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        message = f"{source}: this {what} cannot be read as YAML: {reason}; save it as UTF-8 text"
        raise FileError(message) from error
