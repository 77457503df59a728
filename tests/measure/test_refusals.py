"""What cells, regions, sweeps and virtual cells refuse, in full: what was given, what is allowed, the fix."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from calib.errors import CalibError, FileError, ModelError
from calib.measure.cell import Cell
from calib.measure.cell_parts import GroupDistance
from calib.measure.disturbances import MovedTarget, Outliers
from calib.measure.quantities import parse_joint_value
from calib.measure.ranges import joint_ranges
from calib.measure.simulation import VirtualCell
from calib.measure.truth import draw_truth
from calib.measure.truth_file import read_truth, write_truth


def refused(kind: type[CalibError], text: str):
    """The whole message, as it is printed."""
    return pytest.raises(kind, match=f"^{re.escape(text)}$")


def arc(angles: np.ndarray, radius: float = 1.0) -> np.ndarray:
    return radius * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))])


def test_a_noise_that_no_instrument_has():
    with refused(
        CalibError,
        "The noise sigma is 1e+09 m; no instrument has one below 1e-15 or above 1e+06 m. Leave it "
        "out: it is found from the data.",
    ):
        Cell(sigma=1e9)


def test_a_joint_held_at_no_number():
    with refused(
        CalibError,
        "The joint 'elbow_joint' is held at nan; it must be a finite number, in rad or m.",
    ):
        Cell(held={"elbow_joint": np.nan})


def test_a_distance_to_a_group_without_a_name():
    with refused(
        CalibError, "The distance between the groups 'left' and ' ': each must be a name."
    ):
        GroupDistance("left", " ", 0.2, 1e-5)


def test_outliers_without_a_size():
    with refused(CalibError, "Outliers are displaced by 0.0 m; it must be a positive number."):
        Outliers(count=2, size=0.0)


def test_a_target_that_moves_behind_the_last_row():
    with refused(
        CalibError, "The target is to move before row 9; the table has 8 rows. Name one of these."
    ):
        MovedTarget(9, (0.0, 0.0, 1e-3)).rows(["target"] * 8)


def test_ranges_of_joints(ur3):
    with refused(
        CalibError,
        "The range given for the joint 'elbow_joint' is a length, and the joint turns; give an "
        'angle, such as "30 deg".',
    ):
        joint_ranges(ur3, {"elbow_joint": (parse_joint_value("1 mm", ""), 2.0)})
    with refused(
        CalibError,
        "The range of 'elbow_joint' is -229.183 to 114.592 deg; its limits in the URDF are -180 to "
        "180 deg. Give a range inside.",
    ):
        joint_ranges(ur3, {"elbow_joint": (-4.0, 2.0)})


def test_words_for_sets_that_are_not_one_for_each_pose(ur3):
    cell = VirtualCell(draw_truth(ur3, "zeros", seed=1))
    with refused(
        CalibError,
        "There are 3 poses and 2 words that say their sets; give one of 'estimate', 'validate' for each pose.",
    ):
        cell.measure(np.zeros((3, 6)), sets=["estimate"] * 2)


def test_a_truth_that_is_damaged(ur3, tmp_path):
    cell = VirtualCell(draw_truth(ur3, "zeros", seed=1))
    path = write_truth(cell, cell.measure(np.zeros((2, 6))), tmp_path / "t.json")
    table = json.loads(path.read_text())
    table["targets"][0].update(xyz_m=[0.1, 0.2], rpy_rad=[0.0, 0.0, 0.0])
    path.write_text(json.dumps(table))
    with refused(
        FileError,
        f"{path}: the truth is incomplete or damaged (six finite numbers expected, [0.1, 0.2] and [0.0, 0.0, 0.0] "
        "found). Simulate it again.",
    ):
        read_truth(path, ur3)


def test_what_the_truth_has_not(ur3):
    truth = draw_truth(ur3, "zeros", seed=1)
    with refused(ModelError, "The truth has no target 'probe'; it has 'target'."):
        truth.poses(np.zeros((1, 6)), target="probe")


def test_a_cell_with_a_number_of_too_many_digits(tmp_path):
    path = tmp_path / "cell.toml"
    path.write_text(f"sigma_mm = {10**30}\n")
    with refused(FileError, f"{path}: this is not a TOML file: a whole number is beyond 64 bits"):
        Cell.read(path)


def test_a_cell_with_a_line_of_dots(tmp_path):
    path = tmp_path / "cell.toml"
    path.write_text("model = 'dh'\na" + 2000 * ".a" + " = 1\n")
    with refused(
        FileError, f"{path}: this is not a TOML file: line 2 has 2,000 dots; at most 1000 are read"
    ):
        Cell.read(path)
