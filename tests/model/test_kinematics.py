from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from calib.data import PAPER_TARGET
from calib.errors import ModelError
from calib.model.error_model import FRAME, LENGTH, TARGET, TIP, ErrorModel, Parameter, error_model
from calib.model.kinematics import Kinematics
from calib.model.robot import Robot

ROBOTS = ("ur3", "panda", "prismatic", "continuous", "below_a_torso")
SETS = ("dh", "hayati", "placement", "zeros", "frames")


def pose(seed: int, size: float = 1.0) -> np.ndarray:
    return pin.exp6(np.random.default_rng(seed).uniform(-size, size, 6)).homogeneous


@pytest.fixture(scope="module")
def robots(ur3, panda, serial_urdf) -> dict[str, Robot]:
    prismatic = serial_urdf(
        [
            ("prismatic", (0, 0, 0.3), (0.1, 0, 0), (0, 1, 1)),
            ("revolute", (0.2, 0, 0), (0, 1.2, 0), (0, 0, -1)),
            ("prismatic", (0, 0.1, 0.2), (1.0, 0, 0.3), (1, 0, 0)),
            ("revolute", (0.1, 0.1, 0.0), (0.0, 1.0, 0.3), (0.1, 0.5, 0.2)),
        ]
    )
    return {
        "ur3": ur3,
        "panda": panda,
        "prismatic": Robot.from_urdf(prismatic),
        "continuous": Robot.load("kinova", tip="j2s6s200_end_effector"),
        "below_a_torso": Robot.load("pr2", base="torso_lift_link", tip="l_gripper_tool_frame"),
    }


def seen(robot: Robot, model: ErrorModel) -> Kinematics:
    """From a frame that is turned and far away, at a target off the tip that is turned too."""
    return Kinematics(robot, model, pose(1, 2.0), pose(2, 0.3))


def some_q(robot: Robot, count: int = 3) -> np.ndarray:
    return np.random.default_rng(4).uniform(-1.5, 1.5, (count, len(robot.joints)))


def finite_x(model: ErrorModel) -> np.ndarray:
    size = [0.02 if p.unit == "m" else 0.1 for p in model.parameters]
    return np.random.default_rng(5).uniform(-1, 1, len(model)) * size


def twists_by_differences(
    poses: Callable[[np.ndarray], np.ndarray], x: np.ndarray, k: int
) -> np.ndarray:
    """d/dx_k as twists (N, 6) along the frame's axes, by central differences and Richardson's extrapolation.

    The linear part is the derivative of the position; the angular part the derivative of log(R(x + h) R(x)^T).
    """

    def central(h: float) -> np.ndarray:
        step = h * np.eye(len(x))[k]
        plus, minus = poses(x + step), poses(x - step)
        turn = [pin.log3(a[:3, :3] @ b[:3, :3].T) for a, b in zip(plus, minus, strict=True)]
        return np.hstack([plus[:, :3, 3] - minus[:, :3, 3], turn]) / (2 * h)

    h = 4e-3
    coarse, middle, fine = central(h), central(h / 2), central(h / 4)
    first, second = (4 * middle - coarse) / 3, (4 * fine - middle) / 3
    return (16 * second - first) / 15


@pytest.mark.parametrize("at", ["nominal", "displaced"])
@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("which", ROBOTS)
def test_every_column_equals_its_differences(robots, which, name, at):
    robot = robots[which]
    model = error_model(robot, name, frame=True, target=True)
    kinematics, q = seen(robot, model), some_q(robot)
    x = np.zeros(len(model)) if at == "nominal" else finite_x(model)
    poses, twists = kinematics.twists(x, q)
    np.testing.assert_allclose(poses, kinematics.poses(x, q), rtol=0, atol=1e-14)
    for k, parameter in enumerate(model.names):
        expected = twists_by_differences(lambda x: kinematics.poses(x, q), x, k)
        for part in (slice(0, 3), slice(3, 6)):
            difference = np.linalg.norm(twists[:, part, k] - expected[:, part])
            scale = np.linalg.norm(expected[:, part])
            # Columns that are zero are zero up to the rounding of the differences.
            assert difference <= 1e-7 * scale + 1e-12, (parameter, difference, scale)


@pytest.mark.parametrize("at", ["nominal", "displaced"])
def test_the_paper_s_columns_equal_their_differences(ur3, paper_table, at):
    model = error_model(ur3, "paper")
    T_tip_target = np.eye(4)
    T_tip_target[:3, 3] = PAPER_TARGET
    kinematics, q = Kinematics(ur3, model, np.eye(4), T_tip_target), paper_table.joints
    x = np.zeros(27) if at == "nominal" else finite_x(model)
    points, jacobian = kinematics.points_jacobian(x, q)
    assert jacobian.shape == (35, 3, 27)
    np.testing.assert_allclose(points, kinematics.points(x, q), rtol=0, atol=1e-15)
    for k in range(27):
        expected = twists_by_differences(lambda x: kinematics.poses(x, q), x, k)[:, :3]
        difference = np.linalg.norm(jacobian[:, :, k] - expected)
        assert difference <= 1e-7 * np.linalg.norm(expected), model.names[k]


def test_parameters_of_the_tip_equal_their_differences(robots):
    # No named set has all six of the tip; a model of one's own may.
    robot = robots["panda"]
    unit = ["m"] * 3 + ["rad"] * 3
    tip = tuple(Parameter(f"tip{k}", unit[k], TIP, np.eye(6)[k], LENGTH) for k in range(6))
    model = ErrorModel("mine", (FRAME, *robot.joint_names, TIP, TARGET), tip)
    kinematics, q, x = seen(robot, model), some_q(robot), finite_x(model)
    _, twists = kinematics.twists(x, q)
    for k in range(6):
        expected = twists_by_differences(lambda x: kinematics.poses(x, q), x, k)
        np.testing.assert_allclose(twists[:, :, k], expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("which", ROBOTS)
def test_placement_columns_are_pinocchio_s_frame_regressor(robots, which):
    robot = robots[which]
    model = error_model(robot, "placement", target=False)
    T_tip_target, q = pose(2, 0.3), some_q(robot)
    # The base's own axes, so that the regressor's LOCAL_WORLD_ALIGNED twists need only be turned by the base.
    _, twists = Kinematics(robot, model, np.eye(4), T_tip_target).twists(np.zeros(len(model)), q)
    chain = robot.chain_model(robot.placements)
    last = chain.njoints - 1
    target = chain.addFrame(
        pin.Frame(
            "target", last, 0, pin.SE3(robot.placements[-1] @ T_tip_target), pin.FrameType.OP_FRAME
        )
    )
    data = chain.createData()
    R_base_root = robot.T_root_base[:3, :3].T
    for configuration, twist in zip(robot.configurations(q), twists, strict=True):
        pin.forwardKinematics(chain, data, configuration)
        regressor = pin.computeFrameKinematicRegressor(chain, data, target, pin.LOCAL_WORLD_ALIGNED)
        expected = np.vstack([R_base_root @ regressor[:3], R_base_root @ regressor[3:]])
        np.testing.assert_allclose(twist, expected, rtol=0, atol=1e-13)


def test_poses_are_frame_robot_and_target_in_a_row(robots):
    for robot in robots.values():
        model = error_model(robot, "frames", frame=True)
        kinematics, q = seen(robot, model), some_q(robot)
        expected = kinematics.T_frame_base @ robot.poses(q) @ kinematics.T_tip_target
        np.testing.assert_allclose(kinematics.poses(np.zeros(9), q), expected, atol=1e-14)
        # Frame and target are displaced on the right, one factor after the other.
        x = finite_x(model)
        F = np.linalg.multi_dot([pin.exp6(np.eye(6)[k] * x[k]).homogeneous for k in range(6)])
        T = pin.SE3(np.eye(3), x[6:]).homogeneous
        expected = kinematics.T_frame_base @ F @ robot.poses(q) @ kinematics.T_tip_target @ T
        np.testing.assert_allclose(kinematics.poses(x, q), expected, atol=1e-14)


def test_points_are_the_poses_translation(robots):
    for robot in robots.values():
        model = error_model(robot, "dh", frame=True)
        kinematics, q, x = seen(robot, model), some_q(robot), finite_x(model)
        poses = kinematics.poses(x, q)
        np.testing.assert_allclose(kinematics.points(x, q), poses[:, :3, 3], atol=1e-14)
        points, jacobian = kinematics.points_jacobian(x, q)
        np.testing.assert_allclose(points, poses[:, :3, 3], atol=1e-14)
        np.testing.assert_array_equal(jacobian, kinematics.twists(x, q)[1][:, :3])


def test_the_jacobian_at_x_is_that_of_the_displaced_robot(ur3):
    # What is solved is the model at x, never the nominal one patched: a zero of the displaced robot's own DH
    # turns the same points.
    model = error_model(ur3, "zeros", target=False)
    x, q = finite_x(model), some_q(ur3)
    _, at_x = Kinematics(ur3, model, np.eye(4), np.eye(4)).twists(x, q)
    moved = model.apply(ur3, x)
    _, at_zero = Kinematics(moved, model, np.eye(4), np.eye(4)).twists(np.zeros(6), q)
    np.testing.assert_allclose(at_x, at_zero, atol=1e-12)


def test_a_model_without_parameters(ur3):
    model = error_model(ur3, "frames", target=False)
    poses, twists = Kinematics(ur3, model, np.eye(4), np.eye(4)).twists(np.zeros(0), some_q(ur3))
    np.testing.assert_allclose(poses, ur3.poses(some_q(ur3)), atol=1e-14)
    assert twists.shape == (3, 6, 0)


def test_one_set_of_joint_values_and_none(ur3):
    model = error_model(ur3, "paper")
    kinematics, q = seen(ur3, model), some_q(ur3, 1)
    assert kinematics.poses(np.zeros(27), q[0]).shape == (1, 4, 4)
    np.testing.assert_array_equal(
        kinematics.twists(np.zeros(27), q[0])[1], kinematics.twists(np.zeros(27), q)[1]
    )
    assert kinematics.poses(np.zeros(27), np.zeros((0, 6))).shape == (0, 4, 4)
    assert kinematics.twists(np.zeros(27), np.zeros((0, 6)))[1].shape == (0, 6, 27)


def test_wrong_sizes_are_refused(ur3):
    kinematics = seen(ur3, error_model(ur3, "paper"))
    for method in (kinematics.poses, kinematics.points, kinematics.twists):
        with pytest.raises(ModelError, match="27 parameters"):
            method(np.zeros(26), np.zeros((2, 6)))
        with pytest.raises(ModelError, match="has 6 joints"):
            method(np.zeros(27), np.zeros((2, 7)))
