"""The frame as a cell file, and all of a survey as a table."""

import json
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from calib.circle_points.survey import Survey, base_frame
from calib.data.cell import Cell
from calib.text.base_frame import cell_text
from tests.circle_points.virtual_sweeps import virtual_sweeps

T_TRUE = pin.exp6(np.array([2.0, 1.0, -0.5, 0.3, -0.8, 1.2])).homogeneous


@pytest.fixture(scope="module")
def found(ur3) -> Survey:
    return base_frame(virtual_sweeps(ur3, T_TRUE, 33e-6, arcs=np.radians([270.0, 180.0])), ur3)


@pytest.mark.parametrize(
    "twist", [(2.0, 1.0, -0.5, 0.3, -0.8, 1.2), (0.1, 3.0, 1.0, 0.0, np.pi / 2, 0.0)]
)
def test_the_cell_file_is_the_frame_to_the_last_digits(tmp_path, found, twist):
    T = pin.exp6(np.array(twist)).homogeneous
    moved = replace(found.frame, T_tracker_base=T)
    path = tmp_path / "frame.toml"
    path.write_text(cell_text(moved, 'my "sweeps".csv', base="base", tip="tool0"), encoding="utf-8")
    cell = Cell.read(path)
    assert (cell.base, cell.tip, cell.estimate_frame) == ("base", "tool0", False)
    assert cell.T_frame_base == pytest.approx(T, abs=1e-12)
    assert cell.tracker is None
    path.write_text(cell_text(moved, "s.csv"), encoding="utf-8")
    assert (Cell.read(path).base, Cell.read(path).tip) == (None, None)


def test_the_table_has_everything(found, ur3):
    table = found.table()
    assert table["schema"] == "base-frame 2"
    assert table["frame"]["T_tracker_base"] is found.frame.T_tracker_base
    assert [joint["name"] for joint in table["joints"]] == [*ur3.joint_names[:2]]
    assert table["pairs"][0]["angle_nominal"] == pytest.approx(np.pi / 2)
    circle = table["joints"][0]["circle"]
    assert circle["residuals_m"].shape == (40, 2)
    assert circle["basis"] @ table["joints"][0]["circle"]["basis"].T == pytest.approx(np.eye(3))
    plain = json.dumps(table, default=lambda array: array.tolist())
    assert "findings" in json.loads(plain)
