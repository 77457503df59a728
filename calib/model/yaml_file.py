"""YAML of other programs: read strictly, so that what a program overlooked is an error and not a number."""

from __future__ import annotations

import contextlib
from collections.abc import Hashable, Iterator
from typing import Any, ClassVar

import yaml

from calib.errors import FileError


class _StrictLoader(yaml.SafeLoader):
    """PyYAML's safe loader without keys that stand twice."""

    #: Of its own: other programs, xacro among them, add tags to SafeLoader that calib does not know.
    yaml_constructors: ClassVar[dict[str | None, Any]] = dict(
        yaml.constructor.SafeConstructor.yaml_constructors
    )

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """A mapping; a key that stands twice is refused."""
        seen: dict[str, int] = {}
        for key, _ in node.value:
            line = key.start_mark.line + 1
            if isinstance(key, yaml.ScalarNode) and seen.setdefault(key.value, line) != line:
                raise yaml.MarkedYAMLError(
                    problem=f"'{key.value}' stands twice, first in line {seen[key.value]}; delete one of them",
                    problem_mark=key.start_mark,
                )
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
        FileError: It is no YAML, a key stands twice, or a tag that YAML itself does not have.
    """
    with _in_words(source, what):
        return _StrictLoader(data).get_single_data()


def yaml_keys(data: bytes, source: str, what: str) -> tuple[str, ...]:
    """The keys of a YAML file's outermost table, whatever is under them: tags are left to who reads it.

    Raises:
        FileError: It is no YAML.
    """
    with _in_words(source, what):
        root = yaml.compose(data, Loader=yaml.SafeLoader)
    return (
        tuple(str(key.value) for key, _ in root.value) if isinstance(root, yaml.MappingNode) else ()
    )


@contextlib.contextmanager
def _in_words(source: str, what: str) -> Iterator[None]:
    """What PyYAML raises, as a message with the file and the line."""
    try:
        yield
    # A tag such as !!timestamp before what is none: PyYAML raises whatever comes of it.
    except (
        yaml.YAMLError,
        ValueError,
        TypeError,
        AttributeError,
        LookupError,
        RecursionError,
    ) as error:
        mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
        place = "" if mark is None else f", line {mark.line + 1}, column {mark.column + 1}"
        reason = getattr(error, "problem", None) or str(error).partition("\n")[0]
        message = (
            f"{source}{place}: this {what} cannot be read as YAML: {reason}; save it as UTF-8 text"
        )
        raise FileError(message) from error
