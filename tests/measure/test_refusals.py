"""What cells, regions, sweeps and virtual cells refuse, in full: what was given, what is allowed, the fix."""

from __future__ import annotations

import re

import numpy as np
import pytest

from calib.errors import CalibError, FileError
from calib.measure.cell import Cell
from calib.measure.cell_parts import GroupDistance
from calib.measure.quantities import parse_joint_value
from calib.measure.ranges import joint_ranges


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
