"""Plans of images on the robot's foot: camera and board where they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.basics.arrays import rigid_inverse
from calib.verbs.plan.images.view import shown
from calib.verbs.plan.view import plan_page
from tests.verbs.plan.images.test_plan import planned
from tests.verbs.plan.images.views import BOARD, standing
from tests.verbs.plan.test_view import moved
from tests.verbs.view.test_page import table_of
from tests.view_fixtures import scene_of


def test_a_camera_in_the_hand_moves_and_the_board_stands():
    plan = planned()
    moving = shown(plan)
    assert (moving.robot.base, moving.robot.tip) == ("base_link", "tool0")
    assert moving.robot.joint_names == plan.robot.joint_names[::-1]
    # The camera in the foot, by the chain the other way round.
    T_camera_foot = plan.sight.T_frame_base @ plan.robot.poses(plan.joints)
    expected = rigid_inverse(T_camera_foot)[:, :3, 3]
    np.testing.assert_allclose(moving.places(moving.joints)[:, 0], expected, atol=1e-12)
    (box,) = moving.cell.boxes
    middle = plan.sight.T_tip_board @ np.append(BOARD.centre, 1.0)
    np.testing.assert_allclose(box.T_base_box[:3, 3], middle[:3], atol=1e-12)
    np.testing.assert_allclose(box.size[:2], BOARD.size)


def test_a_board_in_the_hand_moves_and_the_camera_stands():
    plan = planned(standing)
    moving = shown(plan)
    assert moving.robot is plan.robot
    T_base_camera = rigid_inverse(plan.sight.T_frame_base)
    middle = (T_base_camera @ np.c_[plan.expected[:, 0], np.ones(14)].T).T[:, :3]
    np.testing.assert_allclose(moving.places(moving.joints)[:, 0], middle, atol=1e-12)
    assert moving.cell.boxes[0].name == "camera"
    np.testing.assert_allclose(moving.cell.boxes[0].T_base_box, T_base_camera)


def test_other_plans_are_as_they_are():
    plan = replace(planned(), sight=None)
    assert shown(plan) is plan


def test_the_page_has_images_in_place_of_points():
    plan = planned()
    page = plan_page(plan, first_row=3)
    numbers = table_of(page)["numbers"]
    assert numbers["image"][:2] == ["image_003.png", "image_004.png"]
    assert "point" not in numbers
    degrees = float(numbers["wrist_3_joint"][0].split()[0])
    assert degrees == pytest.approx(np.degrees(plan.joints[0, 0]), abs=1e-3)
    assert numbers["distance of the board"][0].endswith(" mm")
    (board,) = moved(scene_of(page), r"nominal/around/\d+")
    np.testing.assert_allclose(board, shown(plan).cell.boxes[0].T_base_box, atol=1e-12)
