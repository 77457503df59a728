"""The base frame as a cell file."""

import numpy as np
import pinocchio as pin
import pytest

from calib.data.cell import Cell
from calib.verbs.base_frame.base_frame import BaseFrame
from calib.verbs.base_frame.circles import fit_plane
from calib.verbs.base_frame.text import cell_text


@pytest.mark.parametrize(
    "twist", [(2.0, 1.0, -0.5, 0.3, -0.8, 1.2), (0.1, 3.0, 1.0, 0.0, np.pi / 2, 0.0)]
)
def test_the_cell_file_is_the_frame_to_the_last_digits(tmp_path, twist):
    T = pin.exp6(np.array(twist)).homogeneous
    plane = fit_plane(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]))
    frame = BaseFrame(T, 1e-10 * np.eye(6), np.full(6, np.inf), plane)
    path = tmp_path / "frame.toml"
    path.write_text(cell_text(frame, 'my "sweeps".csv', base="base", tip="tool0"), encoding="utf-8")
    cell = Cell.read(path)
    assert (cell.base, cell.tip, cell.estimate_frame) == ("base", "tool0", False)
    assert cell.T_frame_base == pytest.approx(T, abs=1e-12)
