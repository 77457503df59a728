"""Sentences on cameras and boards: a number for each that was estimated."""

from __future__ import annotations

import calib
from calib.data.cell import Cell
from calib.verbs.calibrate.optics_text import optics_sentences
from tests.images import arm, cell, poses, table


def test_intrinsics_and_print_are_worded():
    result = calib.calibrate(
        arm(), table(poses(10), noise=0.1), cell=cell(model="frames"), validate=False
    )
    camera, board = optics_sentences(result)
    for name in ("fx", "fy", "cx", "cy", "k1", "p2"):
        assert f"{name} " in camera
    for word in ("scale x", "sag x", "mm rms"):
        assert word in board


def test_nothing_is_said_without_cameras(ur3, paper_table):
    result = calib.calibrate(ur3, paper_table, cell=Cell(model="frames"), validate=False)
    assert optics_sentences(result) == []
