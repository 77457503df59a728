"""YAML of other programs: read strictly, so that what a program overlooked is an error and not a number."""

from __future__ import annotations

import math
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

from calib.errors import FileError
from calib.model.files import read_bytes


class _StrictLoader(yaml.SafeLoader):
    """PyYAML's safe loader without aliases, without keys that stand twice, with the tags of ROS for angles."""

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
            line = key_node.start_mark.line + 1
            if isinstance(key, Hashable) and key in seen:
                raise yaml.MarkedYAMLError(
                    problem=f"'{key}' stands twice, first in line {seen[key]}; delete one of them",
                    problem_mark=key_node.start_mark,
                )
            if isinstance(key, Hashable):
                seen[key] = line
        return super().construct_mapping(node, deep)


def _angle(unit: float) -> Any:  # noqa: ANN401  PyYAML's constructor
    """What reads a number behind a tag."""
    return lambda loader, node: unit * float(loader.construct_scalar(node))


_StrictLoader.add_constructor("!degrees", _angle(math.radians(1.0)))
_StrictLoader.add_constructor("!radians", _angle(1.0))


def read_yaml(path: str | Path, what: str) -> dict[Any, Any]:
    """The outermost table of a YAML file.

    Args:
        path: The file.
        what: What the file should be, for messages: ``"origins file"``.

    Raises:
        FileError: As `parse_yaml`, or it cannot be read.
    """
    return parse_yaml(read_bytes(path, what), str(path), what)


def parse_yaml(data: bytes, source: str, what: str) -> dict[Any, Any]:
    """The outermost table of a YAML file's bytes; empty where the file holds none.

    Args:
        data: The file.
        source: Name of the file, for messages.
        what: What the file should be, for messages: ``"origins file"``.

    Raises:
        FileError: It is no YAML, a key stands twice, or it has an alias or a tag that is not known.
    """
    try:
        table = _StrictLoader(data).get_single_data()
    except (yaml.YAMLError, ValueError, RecursionError, ArithmeticError) as error:
        mark = getattr(error, "problem_mark", None)
        place = "" if mark is None else f", line {mark.line + 1}, column {mark.column + 1}"
        reason = getattr(error, "problem", None) or str(error).partition("\n")[0]
        raise FileError(f"{source}{place}: this {what} cannot be read as YAML: {reason}") from error
    return table if isinstance(table, dict) else {}
