"""Virtual cells of a truth that is at hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from calib.data.cell import Cell, Tracker
from calib.verbs.simulate.scenario import Scenario, VirtualCell
from calib.verbs.simulate.truth import Truth


def virtual(truth: Truth, kind: str = "point", tracker: Any = None, **more: Any) -> VirtualCell:
    """A cell that measures a truth; its tracker stands at the origin of each measurement frame, or at a place."""
    there = None if tracker is None else Tracker(tracker)
    cell = Cell(kind=kind, estimate_frame=True, tracker=there)
    return VirtualCell(Scenario(truth.nominal, cell=cell, **more), truth)


def changed(cell: VirtualCell, **more: Any) -> VirtualCell:
    """The same truth, measured otherwise."""
    return VirtualCell(replace(cell.scenario, **more), cell.truth)
