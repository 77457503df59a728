"""What has moved during a session: from a stop on its readings are of a new target, or of a new station.

As long as it is not known whether the target or the base has moved, they are of both. Robot and cell are the same, so
that no stop is lost.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.basics.values import Value
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.fit.registration.setup import Setup
from calib.model.error_model import FRAME, TARGET
from calib.model.parameter_sets import DIRECTIONS, placed_name
from calib.verbs.measure.moved import Moved
from calib.verbs.measure.stop import Code
from calib.verbs.plan.sensitivity import Sensitivity

T = TypeVar("T")

#: What a station without a name is called after it has moved.
_STATION = "station"


#: Standard deviation of how far something moves that is knocked, along each axis [m] and about it [rad].
_KNOCKED_LENGTH = 0.02
_KNOCKED_ANGLE = float(np.deg2rad(2.0))


@dataclass(frozen=True, slots=True, eq=False)
class Break(Value):
    """Something has moved before a stop."""

    #: Number of the first stop after it
    stop: int
    #: The target that may have moved; None: none
    target: str | None
    #: The station that may have moved, or whose base has; None: none
    station: str | None
    #: Shape (4, 4), T_tip_target before it moved [m]; None: no target
    T_tip_target: Array | None
    #: Shape (4, 4), T_frame_base before it moved [m]; None: no station
    T_frame_base: Array | None

    @classmethod
    def of(cls, found: Sequence[Moved], numbers: Sequence[int], setup: Setup) -> Break:
        """Make a break of what may have moved, the likeliest first.

        Args:
            found: What may have moved.
            numbers: Numbers of the stops of the fit.
            setup: Frames and targets as that estimated them.
        """
        targets = [moved.name for moved in found if moved.what == "target"]
        stations = [moved.name for moved in found if moved.what == "base"]
        T_tip_target = T_frame_base = None
        if targets:
            T_tip_target = read_only(setup.T_tip_target[setup.targets.index(targets[0])])
        if stations:
            T_frame_base = read_only(setup.T_frame_base[setup.groups.index(stations[0])])
        return cls(
            numbers[found[0].first],
            targets[0] if targets else None,
            stations[0] if stations else None,
            T_tip_target,
            T_frame_base,
        )

    def same_as(self, other: Break) -> bool:
        """Return whether another break says that the same has moved."""
        mine, theirs = (
            (self.stop, self.target, self.station),
            (other.stop, other.target, other.station),
        )
        return mine == theirs

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


def cell_after(
    cell: Cell, breaks: Sequence[Break], occurring: Collection[str], *, rotation: bool
) -> Cell:
    """Return the cell with what it says of targets and stations for their new names too.

    They stand about where they stood, within what a knock moves.

    Args:
        cell: As it was at the beginning.
        breaks: What has moved.
        occurring: Names of targets and stations that were measured.
        rotation: Whether the orientation of targets is estimated.
    """
    for k, broken in enumerate(breaks, start=2):
        priors = dict(cell.parameter_priors)
        old, new = _names(broken.target, k, "")
        if new in occurring and broken.T_tip_target is not None:
            directions = DIRECTIONS if rotation else DIRECTIONS[:3]
            priors |= {placed_name("target", d, new): _knocked(d) for d in directions}
            cell = replace(
                cell,
                boards=_also(cell.boards, old, new),
                tips=_also(cell.tips, old, new),
                targets={**cell.targets, new: broken.T_tip_target[:3, 3]},
                estimate_target=True,
            )
        old, new = _names(broken.station, k, _STATION)
        if new in occurring and broken.T_frame_base is not None:
            priors |= {placed_name("frame", d, new): _knocked(d) for d in DIRECTIONS}
            cell = replace(
                cell,
                cameras=_also(cell.cameras, old, new),
                bases=_also(cell.bases, old, new),
                frames={**cell.frames, new: broken.T_frame_base},
                estimate_frame=True,
            )
        cell = replace(cell, parameter_priors=priors)
    return cell


def _names(moved: str | None, k: int, unnamed: str) -> tuple[str, str]:
    """Return the name of what has moved at the beginning, and since break k; both empty if nothing has."""
    if moved is None:
        return "", ""
    origin = _origin(moved)
    return origin, f"{origin or unnamed} ({k})"


def _knocked(direction: str) -> float:
    """Return the standard deviation of a knock along or about an axis, by its name in `DIRECTIONS`."""
    return _KNOCKED_ANGLE if direction.startswith("r") else _KNOCKED_LENGTH


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
