"""Measured points of a list, and which row of a table each belongs to."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.errors import MeasurementError, choices, did_you_mean

#: Between collection, group and point in a point's whole name.
PARTS = "::"

#: Before the last part of a name, such as of ``KR6/P1``, ``Station1_P1`` and ``Ball 1``.
_BEFORE_LAST = re.compile(r"[\s/:_]+")

#: Most lines that a message lists.
_LISTED_LINES = 8

#: Most names of points that a misspelt one is compared with.
_COMPARED_NAMES = 1000


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """N measured points of a file."""

    #: Whole names, with collection and group if the file has them, ``"A::Main::P1"``; empty if it has no names.
    names: tuple[str, ...]
    #: Positions, shape (N, 3), [m], read-only.
    points: NDArray[np.float64]
    #: Line of the file of each point, from 1.
    lines: tuple[int, ...]
    #: The file's name, for messages.
    source: str
    #: Hash of the file's bytes.
    sha256: str
    #: Symbol of the unit of the file's numbers; empty if it is not known.
    unit: str = ""

    def of_rows(self, source: str, rows: Sequence[int], names: Sequence[str] | None) -> list[int]:
        """Return the index of the point of each row of a table, by the names of points or by their order.

        Args:
            source: The table's name, for messages.
            rows: The numbers of the table's rows, for messages.
            names: Name of each row's point, whole or without collection and group; if the list has none of these
                names, the last part of each counts, after a blank, ``/``, ``:`` or ``_``. None: the points are in the
                order of the rows.

        Returns:
            Index of each row's point, from 0; -1 for a row whose point is not measured yet. That is
            taken to be so only if rows name all points of the list; else a name that is not in it
            is more likely misspelt.

        Raises:
            MeasurementError: A row's point is not in the list, is ambiguous, or is that of another
                row; or there are no names, and more or fewer points than rows.
        """
        if names is None:
            if len(self.points) != len(rows):
                raise MeasurementError(
                    f"{self.source} has {len(self.points)} points and {source} {len(rows)} rows to match "
                    "them with, in their order. Add a column 'point' with the points' names, or remove "
                    "what has no counterpart."
                )
            return list(range(len(rows)))

        indices_by_name = self._indices_by_name()
        if indices_by_name.keys().isdisjoint(names):
            # All rows or none: beside P1 a point OLD_P2 is hardly the P2 that was not measured.
            indices_by_name = self._indices_by_part()
        hits = [indices_by_name.get(name, []) for name in names]
        # A name that is not in the list is that of a point not measured yet, or a misspelt one.
        is_complete = {i for indices in hits for i in indices} == {*range(len(self.points))}
        row_of_point: dict[int, int] = {}
        for row, name, indices in zip(rows, names, hits, strict=True):
            fault = None
            if len(indices) > 1:
                lines = ", ".join(str(self.lines[i]) for i in indices[:_LISTED_LINES])
                whole = choices(dict.fromkeys(self.names[i] for i in indices))
                fault = f"several points are called '{name}', in lines {lines}; write the whole name: {whole}"
            elif not indices and not is_complete:
                near = did_you_mean(name, [*self.names, *map(_last, self.names)][:_COMPARED_NAMES])
                fault = f"there is no point '{name}'{near}; it has {choices(self.names)}"
            elif indices:
                first_row = row_of_point.setdefault(indices[0], row)
                if first_row != row:
                    fault = f"row {first_row} names the point '{name}' too, which was measured once"
            if fault is not None:
                raise MeasurementError(
                    f"{source}, row {row}: in {self.source} {fault}. Correct the name or remove "
                    "the row; if the points are in the order of the rows, --columns "
                    '"point=-" does without names.'
                )
        return [indices[0] if indices else -1 for indices in hits]

    def without(self, taken: Sequence[int]) -> Points:
        """Return the points without some of them, by their indices from 0."""
        kept = [i for i in range(len(self.points)) if i not in {*taken}]
        return replace(
            self,
            names=tuple(self.names[i] for i in kept) if self.names else (),
            points=self.points[kept],
            lines=tuple(self.lines[i] for i in kept),
        )

    def _indices_by_name(self) -> Mapping[str, list[int]]:
        """Return the indices of points, from 0, by whole and by last names; whole names win."""
        by_last: dict[str, list[int]] = {}
        by_whole: dict[str, list[int]] = {}
        for i, name in enumerate(self.names):
            by_last.setdefault(_last(name), []).append(i)
            by_whole.setdefault(name, []).append(i)
        return by_last | by_whole

    def _indices_by_part(self) -> Mapping[str, list[int]]:
        """Return the indices of points, from 0, by each ending of their names that begins at one of its later parts."""
        by_part: dict[str, list[int]] = {}
        for i, name in enumerate(self.names):
            for before in _BEFORE_LAST.finditer(name):
                ending = name[before.end() :]
                if ending:
                    by_part.setdefault(ending, []).append(i)
        return by_part


def _last(name: str) -> str:
    """Return the last part of a point's whole name, without collection and group: ``"P1"`` of ``"A::Main::P1"``."""
    return name.rpartition(PARTS)[2].strip()
