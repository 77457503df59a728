from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.basics.arrays import read_only
from calib.errors import ModelError
from calib.model.kinematics import Kinematics, Samples
from calib.model.parameter_sets import error_model
from calib.result.fitted_model import NonGeometric
from calib.robot.gravity import GRAVITY, Payload, gravity_loads
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.compensate.inverse import Matching
from calib.verbs.compensate.nominal_actual import Arm, pair_of
from tests.hard_cases import made
from tests.verbs.compensate.arms import off, turned

#: Chains that are more than a serial arm on a base: name, base, tip.
CHAINS = {
    "ur3": ("ur3", "base", "tool0"),
    "continuous": ("kinova", None, "j2s6s200_end_effector"),
    "two branches": ("tiago_no_hand", "xtion_rgb_optical_frame", "wrist_ft_tool_link"),
    "mimic and prismatic": ("panda", "panda_link0", "panda_leftfinger"),
    "turned round": ("ur3", "wrist_3_link", "base"),
}


def non_geometric(robot: Robot, families: str, seed: int = 3) -> NonGeometric:
    """A non-geometric model with errors drawn; of a result only what commands are made with."""
    model = error_model(robot, "zeros" + families, target=False)
    prior_std = {
        "m": 5e-4,
        "rad": 2e-3,
        "1": 1e-3,
        "m/m": 1e-3,
        "rad/Nm": 1e-5,
        "m/N": 1e-6,
        "rad/m": 1e-4,
    }
    rng = np.random.default_rng(seed)
    x = np.array([float(rng.normal() * prior_std[p.unit]) for p in model.parameters])
    nothing = dict.fromkeys(
        ("covariance", "base_motion", "prior_std", "setup", "residual", "cross_validation")
    )
    return NonGeometric(
        kinematics=Kinematics(robot, model, np.eye(4), np.eye(4)),
        x=x,
        parameters=(),
        payload=Payload(3.0, read_only([0.02, 0.0, 0.1])),
        gravity=read_only(GRAVITY),
        expected_measured=0.0,
        expected_everywhere=0.0,
        **nothing,
    )


def differences(arm: Arm, q: np.ndarray, step: float = 1e-6) -> np.ndarray:
    """How the tool moves with each joint, by central differences."""
    now = arm.poses(q)
    columns = []
    for c in range(q.shape[1]):
        d = np.zeros(q.shape[1])
        d[c] = step
        ahead, behind = (Matching("pose", 1.0).error(now, arm.poses(q + s * d)) for s in (1, -1))
        columns.append((ahead - behind) / (2.0 * step))
    return np.stack(columns, axis=2)


@pytest.mark.parametrize("case", CHAINS)
def test_the_motion_of_any_chain_is_its_difference(case):
    robot = Robot.load(*CHAINS[case])
    arm = Arm.of(robot, turned(2))
    q = random_joint_values(robot, 4)
    poses, twists = arm.motion(q)
    assert poses == pytest.approx(robot.poses(q) @ turned(2), abs=1e-12)
    assert twists == pytest.approx(differences(arm, q), abs=2e-9)


@pytest.mark.parametrize(
    "families", ["+gain+eccentricity", "+gain+eccentricity+compliance", "+gravity"]
)
@pytest.mark.parametrize("case", ["ur3", "mimic and prismatic", "two branches"])
def test_joints_that_err_with_their_state(case, families):
    robot = Robot.load(*CHAINS[case])
    found = non_geometric(robot, families)
    arm = Arm.of_non_geometric(found, robot, turned(2))
    q = random_joint_values(robot, 4)
    poses, twists = arm.motion(q)
    # By another path: the kinematics that the fit took.
    load = gravity_loads(robot, q, found.payload, found.gravity)
    expected = found.kinematics.poses(found.x, Samples.at(q, load)) @ turned(2)
    assert poses == pytest.approx(expected, abs=1e-12)
    # The load changes with q too, which is left out: a part in a thousand.
    scale = np.abs(twists).max()
    tolerance = 2e-9 if families.endswith("eccentricity") else 1e-3 * scale
    assert twists == pytest.approx(differences(arm, q), abs=tolerance)


def test_of_a_calibration_the_nominal_robot_is_that_of_the_result_or_as_given(ur3):
    found = made("paper")
    q = random_joint_values(ur3, 5)
    for pair in (pair_of(found), pair_of(found, ur3)):
        assert pair.nominal.poses(q) == pytest.approx(found.nominal.poses(q), abs=1e-12)
        assert pair.actual.poses(q) == pytest.approx(found.robot.poses(q), abs=1e-12)
        assert np.array_equal(pair.T_frame_base, np.eye(4))


def test_a_controller_with_the_corrected_robot_is_not_corrected_twice():
    found = made("paper")
    with pytest.raises(ModelError, match="nothing to correct"):
        pair_of(found, found.robot)
    # What the URDF does not hold is left to correct.
    found = made("non_geometric")
    with pytest.raises(ModelError, match="nothing to correct"):
        pair_of(found, found.robot, non_geometric=False)
    q = random_joint_values(found.robot, 5)
    pair = pair_of(found, found.robot)
    assert pair.nominal.poses(q) == pytest.approx(found.robot.poses(q), abs=1e-12)
    assert pair.actual.poses(q) == pytest.approx(pair_of(found).actual.poses(q), abs=1e-12)
    # Nothing was corrected: the nominal robot is the corrected one.
    unchanged = replace(made("paper"), robot=made("paper").nominal)
    assert pair_of(unchanged, unchanged.robot).nominal.robot.urdf.run == unchanged.run


def test_a_target_is_where_each_model_has_it():
    found = made("paper")
    pair = pair_of(found, tool="", frame="")
    q = found.fit.measurements.joints_for(found.nominal.joint_names)
    in_frame = pair.T_frame_base @ pair.actual.poses(q)
    assert in_frame[:, :3, 3] == pytest.approx(found.predict(q), abs=1e-12)
    residual = found.fit.measurements.points - (pair.T_frame_base @ pair.nominal.poses(q))[:, :3, 3]
    assert residual == pytest.approx(found.rows.residual_nominal, abs=1e-12)


def test_with_the_larger_model_or_without():
    found = made("non_geometric")
    q = found.fit.measurements.joints_for(found.nominal.joint_names)[:9]
    with_all = pair_of(found, tool="", frame="")
    predicted = (with_all.T_frame_base @ with_all.actual.poses(q))[:, :3, 3]
    assert predicted == pytest.approx(found.predict(q), abs=1e-10)
    geometry = pair_of(found, tool="", frame="", non_geometric=False)
    predicted = (geometry.T_frame_base @ geometry.actual.poses(q))[:, :3, 3]
    assert predicted == pytest.approx(found.predict(q, non_geometric=False), abs=1e-10)
    light = pair_of(found, non_geometric=Payload(0.0))
    assert np.abs(light.actual.poses(q) - pair_of(found).actual.poses(q)).max() > 1e-6


def test_of_two_robots(ur3):
    true = off(ur3)
    q = random_joint_values(ur3, 3)
    T = turned(1)
    pair = pair_of(true, ur3, tool=T, frame=turned(2))
    assert pair.actual.poses(q) == pytest.approx(true.poses(q) @ T, abs=1e-12)
    assert pair.nominal.poses(q) == pytest.approx(ur3.poses(q) @ T, abs=1e-12)
    assert np.array_equal(pair.T_frame_base, turned(2))
    # The true robot is asked between the nominal one's links.
    wrist = ur3.rebuilt(tip="wrist_3_link")
    assert pair_of(true, wrist).actual.robot.tip == "wrist_3_link"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"tool": "ball"}, "no target 'ball'; it has 'target'"),
        ({"frame": "left"}, "no station 'left'"),
        ({"non_geometric": Payload(1.0)}, "has no compliances"),
        ({"nominal": Robot.load("ur5", "base", "tool0")}, "joint origins are neither"),
        ({"nominal": Robot.load("ur3", "base_link", "tool0")}, "is for --base base --tip tool0"),
    ],
)
def test_what_does_not_fit_the_calibration_is_refused(ur3, arguments, said):
    with pytest.raises(ModelError, match=said):
        pair_of(made("paper"), **{"nominal": ur3, **arguments})


@pytest.mark.parametrize("what", ["tool", "frame"])
@pytest.mark.parametrize(
    "value",
    [
        np.eye(3),
        np.zeros(4),
        np.diag([1.0, 1.0, 2.0, 1.0]),
        np.diag([1.0, 1.0, -1.0, 1.0]),
        [0.0, 0.0, np.nan],
        [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, np.nan], [0, 0, 0, 1]],
    ],
    ids=["rotation", "numbers", "scaled", "mirrored", "position of NaN", "pose of NaN"],
)
def test_a_tool_or_frame_that_is_no_pose_is_refused(ur3, what, value):
    with pytest.raises(ModelError, match=f"The {what} is a pose"):
        pair_of(off(ur3), ur3, **{what: value})


def test_a_position_is_a_pose_without_a_turn(ur3):
    pair = pair_of(off(ur3), ur3, tool=[0.1, -0.2, 0.3])
    T = np.eye(4)
    T[:3, 3] = 0.1, -0.2, 0.3
    q = random_joint_values(ur3, 2)
    assert pair.nominal.poses(q) == pytest.approx(ur3.poses(q) @ T, abs=1e-12)


def test_two_robots_are_one_robot_and_know_no_targets(ur3):
    renamed = ur3.urdf.data.replace(b"elbow_joint", b"elbow")
    strange = Robot.from_urdf(type(ur3.urdf).from_bytes(renamed, "x.urdf"), "base", "tool0")
    for true, arguments, said in (
        (strange, {}, "its nominal robot"),
        (Robot.load("ur5", "base", "tool0"), {}, r"has the tool \d+ mm away"),
        (off(ur3), {"tool": "ball"}, "knows no targets"),
    ):
        with pytest.raises(ModelError, match=said):
            pair_of(true, ur3, **arguments)
