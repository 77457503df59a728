from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.compensate.pair import Pair
from calib.errors import ModelError
from calib.model.readback import random_joint_values
from calib.model.robot import Robot, rigid_inverse
from calib.model.torques import Payload
from tests.compensate.arms import off, stored, turned
from tests.show.calibrations import made


def test_of_a_calibration_and_of_its_file(ur3):
    found = made("paper")
    q = random_joint_values(ur3, 5)
    for pair in (
        Pair.of(found),
        Pair.of(stored("paper"), ur3),
        Pair.of(stored("paper"), found.robot),
    ):
        assert pair.believed.poses(q) == pytest.approx(found.nominal.poses(q), abs=1e-12)
        assert pair.true.poses(q) == pytest.approx(found.robot.poses(q), abs=1e-12)
        assert np.array_equal(pair.T_frame_base, np.eye(4))


def test_a_target_is_where_each_model_has_it():
    found = made("paper")
    pair = Pair.of(found, tool="", frame="")
    q = found.measurements.joints_for(found.nominal.joint_names)
    in_frame = pair.T_frame_base @ pair.true.poses(q)
    assert in_frame[:, :3, 3] == pytest.approx(found.predict(q), abs=1e-12)
    residual = found.measurements.points - (pair.T_frame_base @ pair.believed.poses(q))[:, :3, 3]
    assert residual == pytest.approx(found.residual_nominal, abs=1e-12)
    assert pair.std(q)[:, 0] == pytest.approx(found.position_std(q), rel=1e-9)


def test_with_the_larger_model_or_without():
    found = made("larger")
    q = found.measurements.joints_for(found.nominal.joint_names)[:9]
    with_all = Pair.of(found, tool="", frame="")
    predicted = (with_all.T_frame_base @ with_all.true.poses(q))[:, :3, 3]
    assert predicted == pytest.approx(found.predict(q), abs=1e-10)
    geometry = Pair.of(found, tool="", frame="", larger=False)
    predicted = (geometry.T_frame_base @ geometry.true.poses(q))[:, :3, 3]
    assert predicted == pytest.approx(found.predict(q, larger=False), abs=1e-10)
    light = Pair.of(found, payload=Payload(0.0))
    assert np.abs(light.true.poses(q) - Pair.of(found).true.poses(q)).max() > 1e-6


def test_a_controller_may_have_a_third_model(ur3):
    factory = off(ur3, seed=9)
    q = random_joint_values(ur3, 3)
    pair = Pair.of(stored("paper"), factory)
    assert pair.believed.poses(q) == pytest.approx(factory.poses(q), abs=1e-12)
    assert pair.true.poses(q) == pytest.approx(made("paper").robot.poses(q), abs=1e-12)
    assert pair.std(q) == pytest.approx(Pair.of(stored("paper"), ur3).std(q))


def test_of_two_robots(ur3):
    true = off(ur3)
    q = random_joint_values(ur3, 3)
    T = turned(1)
    pair = Pair.of(true, ur3, tool=T, frame=turned(2))
    assert pair.true.poses(q) == pytest.approx(true.poses(q) @ T, abs=1e-12)
    assert pair.believed.poses(q) == pytest.approx(ur3.poses(q) @ T, abs=1e-12)
    assert np.array_equal(pair.T_frame_base, turned(2))
    assert np.isnan(pair.std(q)).all()
    # The true robot is asked between the nominal one's links.
    wrist = ur3.rebuilt(tip="wrist_3_link")
    assert Pair.of(true, wrist).true.robot.tip == "wrist_3_link"


def test_a_point_is_a_tool_that_is_not_turned(ur3):
    pair = Pair.of(off(ur3), ur3, tool=[0.1, 0.0, 0.2])
    inside = rigid_inverse(off(ur3).poses(np.zeros(6))[0]) @ pair.true.poses(np.zeros((1, 6)))[0]
    assert inside[:3, 3] == pytest.approx([0.1, 0.0, 0.2], abs=1e-12)
    assert inside[:3, :3] == pytest.approx(np.eye(3), abs=1e-12)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"nominal": None}, "Give the nominal robot too"),
        ({"tool": "ball"}, "The calibration has no target 'ball'; it has 'target'"),
        ({"frame": "left"}, "The calibration has no set-up 'left'; it has ''"),
        (
            {"tool": np.eye(3)},
            r"The tool has the shape \(3, 3\); a pose \(4, 4\) or a position \(3,\)",
        ),
        ({"tool": [0.0, np.nan, 0.0]}, "of finite numbers, is wanted"),
        ({"frame": 2.0 * np.eye(4)}, "the frame's pose is no rotation"),
    ],
)
def test_what_is_not_there_is_refused(ur3, arguments, said):
    with pytest.raises(ModelError, match=said):
        Pair.of(stored("paper"), **{"nominal": ur3, **arguments})


def test_several_targets_want_a_name(ur3):
    one = stored("paper")
    two = replace(one, known=replace(one.known, targets={"left": np.eye(4), "right": turned(3)}))
    with pytest.raises(ModelError, match=r"has 2 targets: 'left', 'right'\. Name one of them"):
        Pair.of(two, ur3, tool="")
    assert np.array_equal(Pair.of(two, ur3, tool="right").true.T_tip_tool, turned(3))


def test_two_robots_know_no_targets(ur3):
    with pytest.raises(ModelError, match="tool is to be 'ball' of a calibration, but two robots"):
        Pair.of(off(ur3), ur3, tool="ball")
    with pytest.raises(ModelError, match="frame is to be '' of a calibration"):
        Pair.of(off(ur3), ur3, frame="")


def test_two_robots_are_one_robot(ur3):
    other = Robot.load("ur5", base="base_link", tip="tool0")
    renamed = ur3.urdf.data.replace(b"elbow_joint", b"elbow")
    strange = Robot.from_urdf(type(ur3.urdf).from_bytes(renamed, "x.urdf"), "base", "tool0")
    with pytest.raises(
        ModelError, match=r"has the joints 'shoulder_pan_joint'.*Give two URDFs of one"
    ):
        Pair.of(strange, ur3)
    assert other.joint_names == ur3.joint_names  # names alone do not tell robots apart
