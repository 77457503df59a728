"""What has moved during a session: from a stop on its readings are of a new target, or of a new station.

As long as it is not known whether the target or the base has moved, they are of both. Robot and cell are the same, so
that no stop is lost.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from calib.basics.arrays import Array
from calib.basics.values import Value
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.model.error_model import FRAME, TARGET
from calib.verbs.measure.moved import Moved
from calib.verbs.measure.stop import Code
from calib.verbs.plan.sensitivity import Sensitivity

T = TypeVar("T")

#: What a station without a name is called after it has moved.
_STATION = "station"


@dataclass(frozen=True, slots=True)
class Break(Value):
    """Something has moved before a stop."""

    #: Number of the first stop after it
    stop: int
    #: The target that may have moved; None: none
    target: str | None
    #: The station that may have moved, or whose base has; None: none
    station: str | None

    @classmethod
    def of(cls, found: Sequence[Moved], numbers: Sequence[int]) -> Break:
        """Make a break of what may have moved, the likeliest first, by the numbers of the stops of the fit."""
        targets = [moved.name for moved in found if moved.what == "target"]
        stations = [moved.name for moved in found if moved.what == "base"]
        return cls(
            numbers[found[0].first],
            targets[0] if targets else None,
            stations[0] if stations else None,
        )

    @property
    def is_decided(self) -> bool:
        """Whether it is known which of the two has moved."""
        return self.target is None or self.station is None

    @property
    def code(self) -> Code:
        """What is said of it."""
        if not self.is_decided:
            return "something_moved"
        return "base_moved" if self.target is None else "target_moved"


def relabelled(table: Measurements, number: int, breaks: Sequence[Break]) -> Measurements:
    """Return the readings of a stop with the names of targets and stations as they stand since they have moved."""
    targets, groups = [*table.targets], [*table.groups]
    for k, broken in enumerate(breaks, start=2):
        if number < broken.stop:
            continue
        if broken.target is not None:
            targets = [f"{t} ({k})" if _origin(t) == _origin(broken.target) else t for t in targets]
            targets = [_last(t, k) for t in targets]
        if broken.station is not None:
            base = _origin(broken.station)
            groups = [_last(f"{g or _STATION} ({k})", k) if _is(g, base) else g for g in groups]
    if targets == [*table.targets] and groups == [*table.groups]:
        return table
    return replace(table, targets=tuple(targets), groups=tuple(groups))


def _origin(name: str) -> str:
    """Return the name of a target or station before it moved."""
    return name.split(" (")[0]


def _is(group: str, base: str) -> bool:
    """Return whether a station is that of a name, as it was before it moved."""
    return _origin(group) == base or (base in ("", _STATION) and _origin(group) in ("", _STATION))


def _last(name: str, k: int) -> str:
    """Return a name with the number of its last move alone."""
    origin = _origin(name)
    return f"{origin} ({k})" if name.endswith(f" ({k})") else name


def cell_after(cell: Cell, breaks: Sequence[Break]) -> Cell:
    """Return the cell with what it says of targets and stations for their new names too, and new places not known."""
    for k, broken in enumerate(breaks, start=2):
        if broken.target is not None:
            old, new = _origin(broken.target), f"{_origin(broken.target)} ({k})"
            cell = replace(
                cell, boards=_also(cell.boards, old, new), tips=_also(cell.tips, old, new)
            )
        if broken.station is not None:
            old = _origin(broken.station)
            new = f"{old or _STATION} ({k})"
            cell = replace(
                cell,
                cameras=_also(cell.cameras, old, new),
                bases=_also(cell.bases, old, new),
                estimate_frame=True,
            )
    if any(broken.target is not None for broken in breaks):
        cell = replace(cell, estimate_target=True)
    return cell


def _also(entries: Mapping[str, T], old: str, new: str) -> Mapping[str, T]:
    """Return entries by name with that of a name for another name too, if there is one."""
    return {**entries, new: entries[old]} if old in entries else entries


def forgotten(information: Array, sensitivity: Sensitivity, broken: Break) -> Array:
    """Return the information (p, p) of the stops before a break about what has not moved.

    With the parameters u of what has moved, and t of the rest, it is M_tt - M_tu M_uu^-1 M_ut, and zero for u.
    """
    places = set()
    names = dict(zip(sensitivity.setup.targets, sensitivity.setup.places[1], strict=True))
    stations = dict(zip(sensitivity.setup.groups, sensitivity.setup.places[0], strict=True))
    if broken.target is not None:
        places.add(names.get(_origin(broken.target), TARGET))
    if broken.station is not None:
        places.add(stations.get(_origin(broken.station), FRAME))
    gone = np.array([p.place in places for p in sensitivity.kinematics.model.parameters])
    if not gone.any():
        return information
    result = np.zeros_like(information)
    cross = information[np.ix_(~gone, gone)]
    own = information[np.ix_(gone, gone)] + np.diag(sensitivity.precision[gone])
    kept = information[np.ix_(~gone, ~gone)] - cross @ np.linalg.solve(own, cross.T)
    result[np.ix_(~gone, ~gone)] = 0.5 * (kept + kept.T)
    return np.asarray(result)
