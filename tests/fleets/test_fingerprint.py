"""A fingerprint is the same for the same values, and another for any other."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.data.cell import Cell, Tracker
from calib.fleets.fleet import fingerprint


def test_a_robot_and_a_cell_by_what_they_are(ur3):
    cell = Cell(target=(0.0, 0.1, 0.2), tracker=Tracker((3.0, 0.0, 0.0)))
    told = fingerprint(ur3, cell)
    assert told == fingerprint(*pickle.loads(pickle.dumps((ur3, cell))))
    others = [
        (ur3.rebuilt(tip="wrist_3_link"), cell),
        (ur3, replace(cell, target=np.nextafter(cell.target, 1.0))),
        (ur3, replace(cell, frozen=("d3",))),
        (ur3, replace(cell, tracker=None)),
    ]
    assert len({told, *(fingerprint(*other) for other in others)}) == 5


def test_arrays_by_shape_kind_and_every_bit():
    x = np.arange(6.0)
    kinds = [x, x.reshape(2, 3), x.astype(np.float32), -x, 3.0, Path("3.0"), "3.0"]
    assert len({fingerprint(kind) for kind in kinds}) == len(kinds)
    assert fingerprint(x[::2]) == fingerprint(x[::2].copy())
