"""Views of boards as poses, and registration from nothing."""

from __future__ import annotations

import numpy as np
import pytest

from calib.camera.lenses import LENSES
from calib.errors import MeasurementError
from calib.fit.registration.registration import register
from calib.fit.registration.table_rows import rows_and_setup
from calib.fit.registration.views import views_as_poses
from tests.images import BOARD, arm, cell, mounts, poses, table


@pytest.mark.parametrize("lens", LENSES)
def test_views_are_the_poses_of_the_board(lens):
    q = poses(4)
    rows, _ = rows_and_setup(arm(), table(q, lens=lens), cell(lens))
    views, source_rows = views_as_poses(rows)
    T_camera_base, T_tip_board = mounts()
    T = T_camera_base @ arm().poses(q) @ T_tip_board
    measured = views.measured
    np.testing.assert_allclose(measured[:, :3], T[:, :3, 3], atol=1e-7)
    np.testing.assert_allclose(measured[:, 3:12].reshape(-1, 3, 3), T[:, :3, :3], atol=1e-6)
    np.testing.assert_array_equal(source_rows, len(BOARD.corners) * np.arange(4))
    assert [kind.name for kind in views.present] == ["pose"]


def test_a_view_of_few_corners_is_left_out():
    m = table(poses(4))
    few = np.array([i != "1.png" or int(c) < 3 for i, c in zip(m.images, m.corners, strict=True)])
    rows, _ = rows_and_setup(arm(), m.select(few), cell())
    assert len(views_as_poses(rows)[0]) == 3
    none = np.array([int(c) < 3 for c in m.corners])
    rows, _ = rows_and_setup(arm(), m.select(none), cell())
    with pytest.raises(MeasurementError):
        views_as_poses(rows)


@pytest.mark.parametrize("lens", LENSES)
def test_camera_and_board_are_registered_from_nothing(lens):
    robot = arm()
    rows, setup = rows_and_setup(robot, table(poses(6), lens=lens), cell(lens))
    registered = register(robot.poses(rows.joints), setup, rows)
    T_camera_base, T_tip_board = mounts()
    np.testing.assert_allclose(registered.T_frame_base[0], T_camera_base, atol=1e-6)
    np.testing.assert_allclose(registered.T_tip_target[0], T_tip_board, atol=1e-6)


def test_registration_near_another_ends_where_one_from_the_views_does():
    robot = arm()
    rows, setup = rows_and_setup(robot, table(poses(8), noise=0.3), cell())
    T_base_tip = robot.poses(rows.joints)
    some = rows.samples.q[:, 0] != rows.samples.q[0, 0]
    near = register(T_base_tip[some], setup, rows.select(some))
    from_near = register(T_base_tip, setup, rows, near=near)
    from_views = register(T_base_tip, setup, rows)
    moved = np.abs(near.T_frame_base - from_views.T_frame_base).max()
    assert np.abs(from_near.T_frame_base - from_views.T_frame_base).max() < 1e-3 * moved
