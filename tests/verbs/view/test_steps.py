"""Steps of a page: rows, or images with all their corners; a robot with a camera on its hand stands on its foot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.robot.robot import Robot
from calib.verbs.evaluate.evaluation import Evaluation
from calib.verbs.view.steps import rows_of_steps, seen_from_root, typical_step
from calib.verbs.view.view import view_at_rows
from tests.hard_cases import made
from tests.images import arm, mounts
from tests.verbs.view.image_tables import CORNERS, evaluation, without_images


def test_each_image_is_a_step_with_the_rms_of_its_corners():
    first, last = evaluation(size=2.0), evaluation(size=0.5)
    flagged = np.arange(4 * CORNERS) == CORNERS + 3  # a corner of the second image
    view = view_at_rows(first, last, flagged)
    assert view.labels == ("0.png", "1.png", "2.png", "3.png")
    assert [len(rows) for rows in rows_of_steps(first.measurements)] == [CORNERS] * 4
    expected = [[2.0, 4.0, 6.0, 8.0], [0.5, 1.0, 1.5, 2.0]]
    np.testing.assert_allclose(view.measured.errors["px"], expected)
    assert view.kinds == ("estimation", "flagged", "estimation", "estimation")
    assert view.start == 2  # the middle one of those that are not flagged
    m = first.measurements
    np.testing.assert_array_equal(view.q, m.joints_for(view.nominal.joint_names)[::CORNERS])


def test_the_errors_of_an_image_are_its_root_mean_square():
    e = evaluation(1)
    residual = np.zeros((CORNERS, 2))
    residual[0] = [3.0, 4.0]
    view = view_at_rows(replace(e, residual=residual), e, np.zeros(CORNERS, bool))
    assert view.measured.errors["px"][0, 0] == np.sqrt(25.0 / CORNERS)


def test_images_without_names_are_told_by_their_poses():
    e = without_images(evaluation())
    view = view_at_rows(e, e, np.zeros(4 * CORNERS, bool))
    assert view.labels == ("row 1", f"row {CORNERS + 1}", f"row {2 * CORNERS + 1}", "row 61")


def test_rows_of_other_kinds_are_steps_of_their_own():
    c = made("paper")
    m = c.fit.measurements
    e = Evaluation(c.nominal, m, c.nominal_setup, (), c.rows.residual_nominal, c.rows.channels)
    view = view_at_rows(e, e, c.rows.flagged)
    assert view.measured.images is None
    assert view.labels == tuple(f"row {row}" for row in m.rows)
    expected = np.linalg.norm(c.rows.residual_nominal, axis=1)
    np.testing.assert_allclose(view.measured.errors["m"][0], expected, rtol=1e-12)


def test_errors_that_no_row_has_or_one_row_has_choose_the_first_row_or_that_one():
    nan = np.nan
    fitted = np.array([True, True, True, False])
    assert typical_step(np.full((2, 4), nan), fitted) == 0
    assert typical_step(np.array([[nan, nan, nan, 1.0]] * 2), fitted) == 3
    assert typical_step(np.array([[3.0, 1.0, 2.0, 2.0]] * 2), fitted) == 2
    # The median of the one is the extreme of the other: neither is typical.
    assert (
        typical_step(
            np.array([[1.0, 2.0, 3.0, 4.0, 5.0], [4.0, 1.0, 3.0, 5.0, 2.0]]), np.ones(5, bool)
        )
        == 2
    )


def test_a_chain_from_the_hand_is_shown_from_the_root():
    e = evaluation(robot=arm())
    shown = seen_from_root(e)
    assert (shown.robot.base, shown.robot.tip) == ("panda_link0", "panda_link8")
    q = e.measurements.joints_for(shown.robot.joint_names)[[0]]
    T_camera_base, T_tip_board = mounts()
    T_board_camera = (
        shown.setup.T_frame_base[0] @ shown.robot.poses(q)[0] @ shown.setup.T_tip_target[0]
    )
    q_of_chain = e.measurements.joints_for(e.robot.joint_names)[[0]]
    T_camera_board = T_camera_base @ e.robot.poses(q_of_chain)[0] @ T_tip_board
    np.testing.assert_allclose(T_board_camera, np.linalg.inv(T_camera_board), atol=1e-5)
    assert shown.measurements.groups == e.measurements.targets
    assert shown.setup.groups == e.setup.targets


def test_a_chain_from_the_root_stays():
    e = replace(evaluation(), robot=Robot.load("panda", base="panda_link0", tip="panda_link8"))
    assert seen_from_root(e) is e
