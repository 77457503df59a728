"""Keys of a JSON file as docs/comparison.md lists them, and as the file has them."""

from __future__ import annotations

import re
from typing import Any

from tests.places import ROOT

#: Stands between the keys of a comparison and those of a trend.
BETWEEN = "That of several results:"


def documented_keys() -> tuple[set[str], set[str]]:
    """The keys of a comparison and those of a trend."""
    text = (ROOT / "docs" / "comparison.md").read_text(encoding="utf-8")
    comparison, trend = text.split("## As JSON")[1].split(BETWEEN)
    return _in_table(comparison), _in_table(trend)


def _in_table(text: str) -> set[str]:
    """Every key in the first cells of a table."""
    found = set()
    for cell in re.findall(r"^\| `([^`]+)` \|", text, re.MULTILINE):
        brace = re.search(r"\{(.*?)\}", cell)
        parts = brace[1].split(",") if brace else [""]
        found |= {cell.replace(brace[0], part) if brace else cell for part in parts}
    return found


def keys(value: Any, path: str = "") -> set[str]:
    """Every key of nested tables, as the document writes it."""
    if isinstance(value, dict):
        return set().union(*(keys(v, f"{path}.{k}" if path else k) for k, v in value.items()))
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return set().union(*(keys(entry, f"{path}[]") for entry in value))
    return {path}
