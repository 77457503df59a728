from __future__ import annotations

import numpy as np
import pytest

from calib.errors import ModelError
from calib.formats.ur_models import MODELS, ur_model, ur_robot
from calib.formats.ur_mount import recognised
from calib.model.readback import check_written
from tests.formats.ur_cases import CASES

Q = np.random.default_rng(8).uniform(-np.pi, np.pi, (20, 6))


@pytest.mark.parametrize("name", CASES["models"]["rows"])
def test_the_nominal_rows(name):
    given = CASES["models"]["rows"][name]
    for column in ("theta", "a", "d", "alpha"):
        assert getattr(ur_model(name).nominal, column).tolist() == given[column]


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_the_bare_urdf_of_each_arm(model):
    robot = ur_robot(model)
    expected = model.nominal.poses(Q)
    np.testing.assert_allclose(robot.poses(Q), expected, rtol=0, atol=1e-14)
    assert model in recognised(robot)
    # Nominal numbers are the data sheet's, digit for digit.
    assert f'xyz="{model.nominal.a[1]} 0.0 0.0" rpy="0.0 0.0 0.0"'.encode() in robot.urdf.data
    limits = {joint.name: joint.upper for joint in robot.joints}
    assert limits["elbow_joint"] == np.pi
    assert limits["wrist_3_joint"] == 2 * np.pi


def test_two_readers_agree_on_the_bare_urdf():
    robot = ur_robot("UR5e")
    check_written(robot, ur_model("UR5e").nominal.poses(Q), Q)


def test_the_links_and_joints_of_the_ros_2_description():
    urdf = ur_robot("UR10e").urdf
    assert [joint.name for joint in urdf.joints if joint.type == "revolute"] == [
        "shoulder_pan_joint",
        "shoulder_lift_joint",
        "elbow_joint",
        "wrist_1_joint",
        "wrist_2_joint",
        "wrist_3_joint",
    ]
    assert {"base_link", "base_link_inertia", "base", "flange", "ft_frame", "tool0"} <= set(
        urdf.links
    )


@pytest.mark.parametrize("text", ["ur5e", "UR5E", " Ur_5-e"])
def test_a_name_in_any_spelling(text):
    assert ur_model(text).name == "UR5e"


def test_an_unknown_name_is_told_the_names():
    with pytest.raises(ModelError, match=r"'UR6' is not an arm .* 'UR3', .* 'UR30'\. .* urcontrol"):
        ur_model("UR6")
