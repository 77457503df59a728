"""A fingerprint is the same for the same values, and another for any other."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.data.cell import Cell, Tracker
from calib.verbs.fleet.fingerprint import fingerprint


def test_a_robot_and_a_cell_by_their_values(ur3):
    cell = Cell(target=(0.0, 0.1, 0.2), tracker=Tracker((3.0, 0.0, 0.0)))
    reference = fingerprint(ur3, cell)
    assert reference == fingerprint(*pickle.loads(pickle.dumps((ur3, cell))))
    others = [
        (ur3.rebuilt(tip="wrist_3_link"), cell),
        (ur3, replace(cell, target=np.nextafter(cell.target, 1.0))),
        (ur3, replace(cell, frozen=("d3",))),
        (ur3, replace(cell, tracker=None)),
    ]
    assert len({reference, *(fingerprint(*other) for other in others)}) == 5


def test_arrays_by_shape_kind_and_every_bit():
    x = np.arange(6.0)
    kinds = [x, x.reshape(2, 3), x.astype(np.float32), -x, 3.0, Path("3.0"), "3.0"]
    assert len({fingerprint(kind) for kind in kinds}) == len(kinds)
    assert fingerprint(x[::2]) == fingerprint(x[::2].copy())


def test_values_without_a_fingerprint_are_refused():
    with pytest.raises(TypeError, match="object"):
        fingerprint(object())
