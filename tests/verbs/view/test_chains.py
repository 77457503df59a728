"""The whole robot is drawn at every row, the target of each row by its own chain, marks at the links."""

from __future__ import annotations

import numpy as np

from calib.show.scene.posed_robot import chain_bases, stands
from calib.verbs.view.robots_page import pose_robots
from calib.verbs.view.view import marks_of, view_of, view_of_result
from tests.two_handed import fitted


def test_predicted_targets_are_those_of_each_rows_chain():
    c = fitted()
    view = view_of(c)
    m = c.fit.measurements
    expected = [
        c.predict(q, target=target, group="t1")[0]
        for q, target in zip(m.joints_for(c.nominal.joint_names), m.targets, strict=True)
    ]
    T_base_frame = np.linalg.inv(c.setup.T_frame_base[c.setup.groups.index("t1")])
    in_base = np.array(expected) @ T_base_frame[:3, :3].T + T_base_frame[:3, 3]
    np.testing.assert_allclose(view.predicted[1], in_base, atol=1e-9)
    # What was measured is a residual away.
    distance = np.linalg.norm(view.points - view.predicted[1], axis=1)
    norms = np.linalg.norm(c.rows.residual_calibrated, axis=1)
    np.testing.assert_allclose(distance, norms, atol=1e-9)


def test_marks_move_with_the_links_of_their_targets():
    c = fitted()
    view = view_of(c)
    posed = pose_robots(view, {"nominal": (), "calibrated": ()})["calibrated"]
    links = [mark.link for mark in marks_of(c.robot, c.setup)]
    assert links == ["panda_link8", "right/panda_link8"]
    for mark, part in zip(marks_of(c.robot, c.setup), posed.parts[-2:], strict=True):
        mover, _, T_mover_mark = part
        assert posed.links[mover] == mark.link
        target = c.setup.targets[c.setup.target_links.index(mark.link)]
        rows = np.array([name == target for name in c.fit.measurements.targets])
        places = (posed.poses[rows, mover] @ T_mover_mark)[:, :3, 3]
        np.testing.assert_allclose(places, view.predicted[1][rows], atol=1e-9)


def test_without_a_table_the_chains_take_turns():
    c = fitted()
    view = view_of_result(c, c.nominal, cell=c.setup.in_cell(c.fit.cell))
    assert view.chain.tolist()[:4] == [0, 1, 0, 1]
    np.testing.assert_array_equal(view.calibrated_target[1], c.setup.T_tip_target[1])


def test_one_base_stands_and_several_are_drawn_in_the_root():
    c = fitted()
    q = np.full((2, 14), 0.3)
    assert stands(c.robot)
    np.testing.assert_array_equal(chain_bases(c.robot, q, np.array([0, 1])), [np.eye(4)] * 2)
    from calib.robot.robot import Robot

    ends = ("panda_link4", "right/panda_link8")
    moved = Robot.from_urdf(c.robot.urdf, "panda_link0", "panda_link8", branches=[ends])
    q = np.zeros((2, len(moved.joint_names)))
    bases = chain_bases(moved, q, np.array([0, 1]))
    np.testing.assert_array_equal(bases[0], np.eye(4))
    T = Robot.from_urdf(c.robot.urdf, "panda_link0", "panda_link4").poses(np.zeros(4))[0]
    np.testing.assert_allclose(bases[1], T, atol=1e-12)
