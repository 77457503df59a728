"""A table of a report: its cells are text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

#: Rows, poses, targets or combinations of parameters that a report lists at most; the others are counted.
MOST_LISTED = 40


class Table(NamedTuple):
    """A table whose cells are text; without rows it is not shown."""

    #: Its caption, with the unit where all numbers have the same
    title: str
    #: Labels of the columns
    head: Sequence[str]
    #: Cells, one for each column
    rows: Sequence[Sequence[str]]
    #: A letter for each column: ``l`` for text, ``r`` for numbers
    align: str
    #: Sentences below the table
    note: str = ""
    #: Labels above the head, each with the number of columns that it spans
    groups: Sequence[tuple[str, int]] = ()
    #: Indices of the rows in bold, from 0
    strong: Sequence[int] = ()
