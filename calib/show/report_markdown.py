"""A document as Markdown with the tables of GitHub, without its figures. Every name is escaped."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator

from calib.show.document import (
    Block,
    Bullets,
    Document,
    Facts,
    Judgement,
    Paragraph,
    Picture,
    Table,
    plain,
)

#: What means something to Markdown anywhere in a line; "<" and "&" begin HTML.
_SPECIAL = re.compile(r"([\\`*_\[\]|~$])")

#: What means something at the beginning of a line: lists, headings, quotes, rules.
_AT_THE_START = re.compile(r"^(\s*)(#|>|=|[-+](?=[\s-]|$)|\d+[.)](?=\s|$))")

#: What GitHub makes a link of by itself.
_LINKS = re.compile(r"(?i)(https?|ftp|www|mailto)([.:])")


def as_markdown(document: Document) -> str:
    """The whole document; it ends in a line feed. Figures are left out."""
    count = itertools.count(1)
    parts = [f"# {escaped(document.title)}", _facts(document.facts)]
    for number, section in enumerate(document.sections, 1):
        texts = [text for block in section.blocks if (text := _block(block, count))]
        if texts:
            parts += [f"## {number}. {escaped(section.title)}", *texts]
    return "\n\n".join(parts) + "\n"


def escaped(text: str) -> str:
    """Text that Markdown shows as it is."""
    safe = _SPECIAL.sub(r"\\\1", plain(text).strip()).replace("&", "&amp;").replace("<", "&lt;")
    safe = _LINKS.sub(lambda m: m[1] + ("&#46;" if m[2] == "." else "&#58;"), safe)
    safe = safe.replace("@", "&#64;").replace(">", "&gt;")
    return _AT_THE_START.sub(lambda m: f"{m[1]}{m[2][:-1]}\\{m[2][-1]}", safe)


def _block(block: Block, count: Iterator[int]) -> str:
    """One block; a figure is nothing."""
    if isinstance(block, Paragraph):
        return escaped(block.text)
    if isinstance(block, Bullets):
        return "\n".join(f"- {escaped(item)}" for item in block.items)
    if isinstance(block, Facts):
        return _facts(block)
    if isinstance(block, Table):
        return _table(block, next(count))
    if isinstance(block, Picture):
        return ""
    if isinstance(block, Judgement):
        reasons = "\n".join(f"- {escaped(reason)}" for reason in block.reasons)
        return f"**Verdict: {escaped(block.use)}**\n\n{reasons}".rstrip()
    rows = [(line, "") for line in block.blanks]
    rows += [(f"{party}: {line.lower()}", "") for party in block.parties for line in block.lines]
    return _facts(Facts(tuple(rows)))


def _facts(facts: Facts) -> str:
    """A table of two columns without a head that says anything."""
    lines = [f"| {escaped(name)} | {escaped(value)} |" for name, value in facts.pairs]
    return "\n".join(["| | |", "|---|---|", *lines])


def _table(block: Table, number: int) -> str:
    """The title in bold, the table, and its note."""
    head = list(block.head)
    if block.groups:  # Markdown has one line of labels only
        labels = [label for label, span in block.groups for _ in range(span)]
        head = [
            f"{label}: {name}" if label else name for label, name in zip(labels, head, strict=True)
        ]
    rules = ["---:" if side == "r" else "---" for side in block.align]
    lines = [
        f"**Table {number}: {escaped(block.title)}**",
        "",
        _line(escaped(cell) for cell in head),
        _line(rules),
        *(
            _line(
                f"**{text}**" if k in block.strong and text else text
                for text in (escaped(cell).strip() for cell in row)
            )
            for k, row in enumerate(block.rows)
        ),
    ]
    return "\n".join([*lines, *(["", escaped(block.note)] if block.note else [])])


def _line(cells: Iterator[str] | list[str]) -> str:
    """One line of a table."""
    return f"| {' | '.join(cells)} |"
