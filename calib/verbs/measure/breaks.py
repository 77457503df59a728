"""What has moved during a session: from a stop on its readings are of a new target, or of a new station.

As long as it is not known whether the target or the base has moved, they are of both. Robot and cell are the same, so
that no stop is lost.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

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
    #: The target that may have moved, by its name at the beginning; None: none
    target: str | None
    #: The station that may have moved, or whose base has, by its name at the beginning; None: none
    station: str | None
    #: Shape (4, 4), T_tip_target before it moved [m]; None: no target
    T_tip_target: Array | None
    #: Shape (4, 4), T_frame_base before it moved [m]; None: no station
    T_frame_base: Array | None

    @classmethod
    def of(
        cls,
        found: Sequence[Moved],
        numbers: Sequence[int],
        setup: Setup,
        before: Sequence[Break] = (),
    ) -> Break:
        """Make a break of what may have moved, the likeliest first.

        Args:
            found: What may have moved.
            numbers: Numbers of the stops of the fit.
            setup: Frames and targets as that estimated them.
            before: What had moved before.
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
            _at_beginning("target", targets[0], before) if targets else None,
            _at_beginning("station", stations[0], before) if stations else None,
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
        """True if it is known which of the two has moved."""
        return self.target is None or self.station is None

    @property
    def code(self) -> Code:
        """The code of the finding."""
        if not self.is_decided:
            return "something_moved"
        return "base_moved" if self.target is None else "target_moved"


def relabelled(table: Measurements, number: int, breaks: Sequence[Break]) -> Measurements:
    """Return the readings of a stop with the names of targets and stations as they stand since they have moved.

    Args:
        table: The readings, with the names of the beginning.
        number: Number of the stop.
        breaks: What has moved.
    """
    targets: dict[str | None, str] = {}
    stations: dict[str | None, str] = {}
    for k, broken in enumerate(breaks, start=2):
        if number >= broken.stop:
            targets[broken.target], stations[broken.station] = _names(broken, k)
    new_targets = tuple(targets.get(name, name) for name in table.targets)
    new_groups = tuple(stations.get(name, name) for name in table.groups)
    if (new_targets, new_groups) == (table.targets, table.groups):
        return table
    return replace(table, targets=new_targets, groups=new_groups)


def _names(broken: Break, k: int) -> tuple[str, str]:
    """Return what the target and the station of break k, from 2, are called since then; empty: not moved."""
    target = "" if broken.target is None else f"{broken.target} ({k})"
    return target, "" if broken.station is None else f"{broken.station or _STATION} ({k})"


def _at_beginning(what: Literal["target", "station"], name: str, breaks: Sequence[Break]) -> str:
    """Return the name that a target or station had at the beginning."""
    for k, broken in enumerate(breaks, start=2):
        original = broken.target if what == "target" else broken.station
        if original is not None and name == _names(broken, k)[what == "station"]:
            return original
    return name


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
        new, new_station = _names(broken, k)
        old = broken.target
        if old is not None and new in occurring and broken.T_tip_target is not None:
            directions = DIRECTIONS if rotation else DIRECTIONS[:3]
            priors |= {placed_name("target", d, new): _knocked(d) for d in directions}
            cell = replace(
                cell,
                boards=_also(cell.boards, old, new),
                tips=_also(cell.tips, old, new),
                targets={**cell.targets, new: broken.T_tip_target[:3, 3]},
                estimate_target=True,
            )
        old, new = broken.station, new_station
        if old is not None and new in occurring and broken.T_frame_base is not None:
            priors |= {placed_name("frame", d, new): _knocked(d) for d in DIRECTIONS}
            cell = replace(
                cell,
                # A camera without a name is that of all stations.
                cameras=_also(cell.cameras, old, new) if old else cell.cameras,
                bases=_also(cell.bases, old, new),
                frames={**cell.frames, new: broken.T_frame_base},
                estimate_frame=True,
            )
        cell = replace(cell, parameter_priors=priors)
    return cell


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
        places.add(names.get(broken.target, TARGET))
    if broken.station is not None:
        places.add(stations.get(broken.station, FRAME))
    gone = np.array([p.place in places for p in sensitivity.kinematics.model.parameters])
    if not gone.any():
        return information
    result = np.zeros_like(information)
    cross = information[np.ix_(~gone, gone)]
    own = information[np.ix_(gone, gone)] + np.diag(sensitivity.precision[gone])
    kept = information[np.ix_(~gone, ~gone)] - cross @ np.linalg.solve(own, cross.T)
    result[np.ix_(~gone, ~gone)] = 0.5 * (kept + kept.T)
    return np.asarray(result)
