"""The Pinocchio model of all of a URDF against its text."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib.errors import UrdfError
from calib.robot.full_model import full_configurations, full_model, joint_frames, link_frame
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from tests.robot.shared import random_q
from tests.robot.test_urdf_xml import PLAIN


@pytest.mark.parametrize("change", [("0 0 0.1", "0 0 0.2"), ('"b"', '"d"')])
def test_a_urdf_that_pinocchio_reads_in_another_way(monkeypatch, change):
    """The comparison itself: the elements of one file against the model of another."""
    other = pin.buildModelFromXML(PLAIN.replace(*change))
    monkeypatch.setattr(pin, "buildModelFromXML", lambda _text: other)
    urdf = Urdf.from_bytes(f"{PLAIN}<!-- {change[1]} -->".encode(), "r.urdf")
    with pytest.raises(UrdfError, match="reads the joints 'one'"):
        full_model(urdf)


@pytest.mark.parametrize("name", ["ur3", "kinova", "tiago_no_hand", "pr2"])
def test_frames_of_all_joints_are_those_of_pinocchio(name):
    robot = Robot.load(name)
    values = robot.urdf_values(random_q(robot, 3))
    model = full_model(robot.urdf)
    data = model.createData()
    last = model.getJointId(robot.joints[-1].name)
    frames = joint_frames(model, robot.urdf, values, [last])
    assert sorted(frames) == list(model.supports[last])
    for i, configuration in enumerate(full_configurations(model, values)):
        pin.forwardKinematics(model, data, configuration)
        for number, T in frames.items():
            expected = data.oMi[number].homogeneous
            np.testing.assert_allclose(T[i], expected, rtol=0, atol=1e-13)


def test_the_model_is_a_copy_and_links_are_found_by_name(ur3):
    model = full_model(ur3.urdf)
    assert model.frames[link_frame(model, "tool0")].name == "link:tool0"
    model.gravity.linear = np.zeros(3)
    assert full_model(ur3.urdf).gravity.linear[2] == -9.81
