from __future__ import annotations

import numpy as np
import pytest

from calib.errors import UrdfError
from calib.robot.urdf import Urdf
from calib.verbs.convert.camera import readback
from calib.verbs.convert.camera.mount import with_moved_mount
from calib.verbs.convert.camera.readback import check_fixed_frame
from tests.verbs.convert.camera.arms import T_TOOL_OPTICAL, pose, urdf_with_camera


@pytest.fixture(scope="module")
def mounted() -> Urdf:
    return with_moved_mount(
        urdf_with_camera(), "tool0", "color_optical", "camera_mount_joint", T_TOOL_OPTICAL
    )


def test_both_readers_have_the_frame_where_it_was_placed(mounted):
    check_fixed_frame(mounted, "tool0", "color_optical", T_TOOL_OPTICAL)


@pytest.mark.parametrize("off", [(2e-9, 0, 0, 0, 0, 0), (0, 0, 0, 0, 0, 3e-9)])
def test_a_frame_elsewhere_is_refused(mounted, off):
    with pytest.raises(UrdfError, match="read back by Pinocchio, has 'color_optical'"):
        check_fixed_frame(mounted, "tool0", "color_optical", T_TOOL_OPTICAL @ pose(*off))


def test_the_second_reader_counts_too(monkeypatch):
    monkeypatch.setattr(readback, "_by_pinocchio", lambda *_: T_TOOL_OPTICAL)
    with pytest.raises(UrdfError, match="read back by yourdfpy"):
        check_fixed_frame(urdf_with_camera(), "tool0", "color_optical", np.asarray(T_TOOL_OPTICAL))
