from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.errors import MeasurementError
from calib.verbs.compensate.programs.numbered_frames import NumberedFrames, pose_of_numbers
from calib.verbs.compensate.programs.program_file import Stated


def at(x: float) -> np.ndarray:
    T = np.eye(4)
    T[0, 3] = x
    return T


def test_a_pose_of_numbers_is_in_millimetres_and_degrees_about_fixed_axes() -> None:
    T = pose_of_numbers([100.0, -20.0, 3.0, 10.0, -20.0, 130.0], "fanuc", Path("f"))
    turn = Rotation.from_euler("xyz", [10.0, -20.0, 130.0], degrees=True).as_matrix()
    assert np.allclose(T[:3, 3], [0.1, -0.02, 0.003], atol=1e-15)
    assert np.allclose(T[:3, :3], turn, atol=1e-15)
    assert not T.flags.writeable


def test_a_pose_of_no_numbers_is_refused() -> None:
    with pytest.raises(MeasurementError, match=r"f\.va"):
        pose_of_numbers([0.0, 0.0, 0.0, 0.0, 0.0, float("inf")], "fanuc", Path("f.va"))


def test_what_is_stated_by_number_comes_before_files_and_these_before_what_is_stated_for_all() -> (
    None
):
    stated = Stated((), {"1": at(1.0), "": at(9.0)}, {"2": at(2.0)})
    frames = NumberedFrames(Path("p"), stated, {1: at(3.0), 2: at(4.0)}, {}, files="FILES")
    assert [frames.tool(number)[0, 3] for number in (1, 2, 3)] == [1.0, 4.0, 9.0]
    assert frames.frame(2)[0, 3] == 2.0
    frames.check()


def test_all_that_is_missing_and_needed_is_named_at_once() -> None:
    frames = NumberedFrames(Path("p.ls"), Stated(()), {}, {}, files="FILES")
    assert frames.tool(7, needed=False) is None
    frames.check()
    assert frames.tool(3) is None
    assert frames.tool(2) is None
    assert frames.frame(12) is None
    with pytest.raises(MeasurementError) as caught:
        frames.check()
    message = str(caught.value)
    for part in ("p.ls", "'2', '3'", "'12'", '--tool "2=', '--frame "12=', "FILES", "--data"):
        assert part in message
    assert "7" not in message
