"""Places of targets and frames, cameras and boards: the numbers are those of the result."""

from __future__ import annotations

import re

import numpy as np
import pytest

import calib
from calib.basics.arrays import read_only
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.example import PAPER_TARGET_AS_PRINTED
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.show.lines import mm
from calib.verbs.calibrate.places_text import camera_and_board_sentences, frame_sentences
from tests.images import arm, cell, poses, table as image_table


@pytest.mark.slow
def test_target_found_given_moved_and_kept(ur3: Robot, table: Measurements):
    def said(cell: Cell) -> str:
        whole = " ".join(calibrate(ur3, table, cell=cell, validate=False).summary().split())
        end = re.search(r"Measurement frame: |Models tried |Noise: ", whole)
        assert end is not None
        return whole[whole.index("Target: ") : end.start()].strip()

    assert said(Cell(model="dh")).startswith("Target: estimated at (-70.")
    printed = read_only(PAPER_TARGET_AS_PRINTED)
    moved = said(Cell(target=printed, model="dh"))
    assert moved.endswith(
        "mm from the position given. Check the sign and the order of the numbers given."
    )
    kept = said(Cell(target=printed, estimate_target=False, model="frames", estimate_frame=True))
    assert kept == "Target: (69.970, -70.200, 22.520) mm in tool0, as given."


def frames(c: Calibration) -> str:
    return "\n".join(frame_sentences(c))


def test_every_set_up_by_name(calibrated):
    _, c = calibrated("set-ups")
    text = " ".join(frames(c).split())
    for group, T in zip(c.setup.groups, c.setup.T_frame_base, strict=True):
        x, y, z = (mm(v) for v in T[:3, 3])
        assert f"Measurement frame '{group}': base estimated at ({x}, {y}, {z}) mm, rpy (" in text
    assert frames(calibrated("known set-ups")[1]) == ""
    assert frames(calibrated("pairs")[1]) == ""


@pytest.mark.parametrize(("name", "word"), [("sockets", "Socket"), ("distances", "Anchor")])
def test_sockets_and_anchors_are_points_of_the_base(calibrated, name, word):
    _, c = calibrated(name)
    for line, group, T in zip(
        frames(c).splitlines(), c.setup.groups, c.setup.T_frame_base, strict=True
    ):
        assert line.startswith(f"{word} '{group}': estimated at (")
        found = [float(v) for v in re.findall(r"-?\d+\.\d+", line)]
        np.testing.assert_allclose(found, -1e3 * T[:3, :3].T @ T[:3, 3], atol=5.1e-4)


def test_planes_have_their_normal_and_distance_in_the_base(calibrated):
    _, c = calibrated("planes")
    for line, group, T in zip(
        frames(c).splitlines(), c.setup.groups, c.setup.T_frame_base, strict=True
    ):
        assert line.startswith(f"Plane '{group}': estimated with the normal (")
        numbers = [float(v) for v in re.findall(r"-?\d+\.\d+", line)]
        np.testing.assert_allclose(numbers[:3], T[2, :3], atol=5.1e-6)
        assert line.endswith(f"{mm(-T[2, 3])} mm along it.")


def test_intrinsics_and_print_are_worded():
    result = calib.calibrate(
        arm(), image_table(poses(10), noise=0.1), cell=cell(model="frames"), validate=False
    )
    camera, board = camera_and_board_sentences(result)
    for name in ("fx", "fy", "cx", "cy", "k1", "p2"):
        assert f"{name} " in camera
    for word in ("scale x", "sag x", "mm rms"):
        assert word in board


def test_nothing_is_said_without_cameras(ur3, paper_table):
    result = calib.calibrate(ur3, paper_table, cell=Cell(model="frames"), validate=False)
    assert camera_and_board_sentences(result) == []
