from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from calib.errors import ModelError
from calib.example import PAPER_TARGET
from calib.model.error_model import DIRECTIONS, error_model
from calib.model.families import LENGTH
from calib.model.kinematics import Kinematics, Samples
from calib.model.parameters import FRAME, TARGET, TIP, ErrorModel, Parameter
from calib.robot.chain import pinocchio_chain
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf

SETS = ("dh", "hayati", "placement", "zeros", "frames")

#: Robots of example-robot-data that are more than a serial arm on a base: name, base, tip.
CHAINS = {
    "continuous": ("kinova", None, "j2s6s200_end_effector"),
    "below_a_torso": ("pr2", "torso_lift_link", "l_gripper_tool_frame"),
    "tiago_head_to_arm": ("tiago_no_hand", "xtion_rgb_optical_frame", "wrist_ft_tool_link"),
    "talos_head_to_arm": ("talos_full_v2", "rgbd_optical_frame", "wrist_left_ft_tool_link"),
    "pr2_head_to_finger": ("pr2", "head_plate_frame", "r_gripper_l_finger_tip_link"),
    "panda_finger_to_base": ("panda", "panda_rightfinger", "panda_link0"),
    "panda_fingers": ("panda", "panda_leftfinger", "panda_rightfinger"),
    "turned_round_bare": ("ur3", "wrist_3_link", "base"),
}

#: The links of a robot with followers on both branches.
LINKS = ("fork", "elsewhere", "a", "b", "c", "tip", "base")

#: Joints that are held in one of them.
HELD = {"torso_lift_joint": 0.2, "head_2_joint": -0.3, "arm_4_joint": 0.7}

ROBOTS = ("ur3", "panda", "prismatic", "mimic", "tiago_held", *CHAINS)

#: Behind a set's name, every error that changes with the joints' state.
FAMILIES = "+gain+eccentricity+compliance"


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
        "mimic": mimicking(),
        "tiago_held": Robot.load(*CHAINS["tiago_head_to_arm"], held=HELD),
        **{which: Robot.load(*ends) for which, ends in CHAINS.items()},
    }


def mimicking() -> Robot:
    """Skew axes, followers of every kind on both branches, a driver outside, base and tip moved directly."""

    def joint(name: str, parent: str, child: str, kind: str = "revolute", mimic: str = "") -> str:
        inside = f"<mimic {mimic}/>" if mimic else ""
        return (
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            '<origin xyz="0.1 0.2 0.3" rpy="0.1 0.3 0.2"/><axis xyz="1 2 -0.5"/>'
            f'<limit lower="-1" upper="1" effort="1" velocity="1"/>{inside}</joint>'
        )

    joints = (
        joint("outside", "fork", "elsewhere"),
        joint("a1", "fork", "a"),
        joint("a2", "a", "b", "prismatic", 'joint="a1" multiplier="0.2" offset="0.1"'),
        joint("a3", "b", "tip", "continuous"),
        joint("b1", "fork", "c", "continuous", 'joint="a1" multiplier="-0.5"'),
        joint("b2", "c", "base", "revolute", 'joint="outside" multiplier="1.5" offset="-0.2"'),
    )
    links = "".join(f'<link name="{link}"/>' for link in LINKS)
    text = f'<robot name="mimic">{links}{"".join(joints)}</robot>'
    return Robot.from_urdf(Urdf.from_bytes(text.encode(), "mimic.urdf"), "base", "tip")


def seen(robot: Robot, model: ErrorModel) -> Kinematics:
    """From a frame that is turned and far away, at a target off the tip that is turned too."""
    return Kinematics(robot, model, pose(1, 2.0), pose(2, 0.3))


def some_q(robot: Robot, count: int = 3) -> np.ndarray:
    return np.random.default_rng(4).uniform(-1.5, 1.5, (count, len(robot.joint_names)))


def some_load(robot: Robot, count: int = 3) -> np.ndarray:
    """Loads of up to 20 Nm or N."""
    return np.random.default_rng(6).uniform(-20, 20, (count, len(robot.joints)))


def sizes(model: ErrorModel) -> np.ndarray:
    """What moves a joint or a placement by 2 cm or 0.1 rad or so, in each parameter's unit."""
    by_unit = {"m": 0.02, "rad": 0.1, "1": 0.05, "m/m": 0.05, "rad/Nm": 5e-3, "m/N": 1e-3}
    return np.array([by_unit[unit] for unit in model.units])


def finite_x(model: ErrorModel) -> np.ndarray:
    return np.random.default_rng(5).uniform(-1, 1, len(model)) * sizes(model)


def twists_by_differences(
    poses: Callable[[np.ndarray], np.ndarray], x: np.ndarray, k: int, unit: float = 1.0
) -> np.ndarray:
    """d/dx_k as twists (N, 6) along the frame's axes, by central differences and Richardson's extrapolation.

    The linear part is the derivative of the position; the angular part the derivative of log(R(x + h) R(x)^T).
    Steps are of the order of 4e-3 times ``unit``.
    """

    def central(h: float) -> np.ndarray:
        step = h * np.eye(len(x))[k]
        plus, minus = poses(x + step), poses(x - step)
        turn = [pin.log3(a[:3, :3] @ b[:3, :3].T) for a, b in zip(plus, minus, strict=True)]
        return np.hstack([plus[:, :3, 3] - minus[:, :3, 3], turn]) / (2 * h)

    h = 4e-3 * unit
    coarse, middle, fine = central(h), central(h / 2), central(h / 4)
    first, second = (4 * middle - coarse) / 3, (4 * fine - middle) / 3
    return (16 * second - first) / 15


def assert_columns_equal_their_differences(
    kinematics: Kinematics, x: np.ndarray, samples: Samples
) -> None:
    """Every column of `Kinematics.twists`, linear and angular part each to 1e-7 of its norm."""
    model = kinematics.model
    poses, twists = kinematics.twists(x, samples)
    assert twists.shape == (len(samples), 6, len(model))
    np.testing.assert_allclose(poses, kinematics.poses(x, samples), rtol=0, atol=1e-13)
    step = {"m": 1.0, "rad": 1.0, "1": 1.0, "m/m": 1.0, "rad/Nm": 0.05, "m/N": 0.05}
    for k, parameter in enumerate(model.parameters):
        unit = step[parameter.unit]
        expected = twists_by_differences(lambda x: kinematics.poses(x, samples), x, k, unit)
        for part in (slice(0, 3), slice(3, 6)):
            difference = np.linalg.norm(twists[:, part, k] - expected[:, part])
            scale = np.linalg.norm(expected[:, part])
            # Columns that are zero are zero up to the rounding of the differences.
            assert difference <= 1e-7 * scale + 2e-12 / unit, (parameter.name, difference, scale)


@pytest.mark.parametrize("at", ["nominal", "displaced"])
@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("which", ROBOTS)
def test_every_column_equals_its_differences(robots, which, name, at):
    robot = robots[which]
    nominal = at == "nominal"
    model = error_model(robot, name if nominal else name + FAMILIES, frame=True, rotation=True)
    x = np.zeros(len(model)) if nominal else finite_x(model)
    samples = Samples.at(some_q(robot), some_load(robot))
    assert_columns_equal_their_differences(seen(robot, model), x, samples)


def several(robot: Robot, name: str, rotation: bool = True) -> tuple[Kinematics, Samples]:
    """Three frames, one of them known and one partly, three targets, one of them known, and 8 samples."""
    model = error_model(
        robot,
        name,
        frame={"left": DIRECTIONS, "known": (), "top": ("x", "z", "ry")},
        targets=("ball", "fixed", "cone"),
        target=("ball", "cone"),
        rotation=rotation,
    )
    kinematics = Kinematics(
        robot,
        model,
        np.array([pose(seed, 2.0) for seed in (1, 2, 3)]),
        np.array([pose(seed, 0.3) for seed in (4, 5, 6)]),
    )
    samples = Samples(
        q=some_q(robot, 8),
        frame=np.array([0, 2, 1, 0, 1, 2, 0, 2]),
        target=np.array([2, 0, 1, 1, 2, 2, 0, 1]),
        load=some_load(robot, 8),
    )
    return kinematics, samples


@pytest.mark.parametrize("at", ["nominal", "displaced"])
@pytest.mark.parametrize("name", ["dh", "placement", "zeros" + FAMILIES])
@pytest.mark.parametrize("which", ["ur3", "mimic", "tiago_held", "talos_head_to_arm"])
def test_every_column_with_several_frames_and_targets(robots, which, name, at):
    kinematics, samples = several(robots[which], name)
    model = kinematics.model
    x = np.zeros(len(model)) if at == "nominal" else finite_x(model)
    assert_columns_equal_their_differences(kinematics, x, samples)


@pytest.mark.parametrize("which", ["ur3", "mimic", "talos_head_to_arm"])
def test_several_frames_and_targets_are_each_as_if_alone(robots, which):
    # A row's frame and target are the only ones that it knows of.
    robot = robots[which]
    kinematics, samples = several(robot, "dh" + FAMILIES)
    model, x = kinematics.model, finite_x(kinematics.model)
    poses, twists = kinematics.twists(x, samples)
    groups, targets = ("left", "known", "top"), ("ball", "fixed", "cone")
    for i in range(len(samples)):
        f, t = samples.frame[i], samples.target[i]
        group, target = groups[f], targets[t]
        directions = {"left": DIRECTIONS, "known": (), "top": ("x", "z", "ry")}[group]
        alone = error_model(
            robot,
            "dh" + FAMILIES,
            frame={group: directions},
            targets=(target,),
            target=target != "fixed",
            rotation=True,
        )
        one = Kinematics(robot, alone, kinematics.T_frame_base[f], kinematics.T_tip_target[t])
        columns = [model.index(name) for name in alone.names]
        where = Samples.at(samples.q[i], samples.load[[i]])
        pose_alone, twists_alone = one.twists(x[columns], where)
        np.testing.assert_allclose(poses[i], pose_alone[0], rtol=0, atol=1e-13)
        np.testing.assert_allclose(twists[i][:, columns], twists_alone[0], rtol=0, atol=1e-12)
        others = np.setdiff1d(np.arange(len(model)), columns)
        np.testing.assert_array_equal(twists[i][:, others], 0)


@pytest.mark.parametrize("name", ["placement+gain+compliance", "zeros+eccentricity"])
@pytest.mark.parametrize("which", ["ur3", "mimic", "pr2_head_to_finger"])
def test_tied_and_frozen_columns_are_those_of_the_free_model(robots, which, name):
    robot = robots[which]
    free = error_model(robot, name, frame=True)
    names = [n for n, u in zip(free.names, free.units, strict=True) if u == "rad"]
    first, second, third, gone = names[0], names[1], names[-1], names[2]
    tied = free.tied({second: (first, -2.0), third: (first, 0.5)}).without([gone])
    x = finite_x(tied)
    every = np.zeros(len(free))
    for name, value in zip(tied.names, x, strict=True):
        every[free.index(name)] = value
    leader = x[tied.index(first)]
    every[free.index(second)], every[free.index(third)] = -2.0 * leader, 0.5 * leader
    samples = Samples.at(some_q(robot), some_load(robot))
    poses, twists = seen(robot, tied).twists(x, samples)
    free_poses, free_twists = seen(robot, free).twists(every, samples)
    np.testing.assert_allclose(poses, free_poses, rtol=0, atol=1e-13)
    for k, name in enumerate(tied.names):
        expected = free_twists[:, :, free.index(name)]
        if name == first:
            followers = free_twists[:, :, [free.index(second), free.index(third)]]
            expected = expected + followers @ [-2.0, 0.5]
        np.testing.assert_allclose(twists[:, :, k], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("which", ROBOTS)
def test_errors_of_the_joints_state_move_the_joints(robots, which):
    # The same poses as of the nominal robot with its joints where these errors put them.
    robot = robots[which]
    model = error_model(robot, "frames" + FAMILIES, target=False)
    x, q, load = finite_x(model), some_q(robot), some_load(robot)
    value = dict(zip(model.names, x, strict=True))
    column = np.zeros_like(q)
    for c, joint in enumerate(robot.inputs):
        column[:, c] = value[f"{joint.name}.gain"] * q[:, c]
        if joint.type != "prismatic":
            column[:, c] += value[f"{joint.name}.sin"] * np.sin(q[:, c])
            column[:, c] += value[f"{joint.name}.cos"] * np.cos(q[:, c])
    given_way = load * [value[f"{joint.name}.compliance"] for joint in robot.joints]
    chain = pinocchio_chain(robot.joints, robot.placements)
    configurations = robot.chain_values(q + column) + given_way
    data = chain.createData()
    poses = Kinematics(robot, model, np.eye(4), np.eye(4)).poses(x, Samples.at(q, load))
    for configuration, one in zip(configurations, poses, strict=True):
        pin.forwardKinematics(chain, data, configuration)
        T_root_tip = data.oMi[chain.njoints - 1].homogeneous @ robot.placements[-1]
        expected = np.linalg.inv(robot.T_root_base) @ T_root_tip
        np.testing.assert_allclose(one, expected, rtol=0, atol=1e-13)


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
    chain = pinocchio_chain(robot.joints, robot.placements)
    last = chain.njoints - 1
    target = chain.addFrame(
        pin.Frame(
            "target", last, 0, pin.SE3(robot.placements[-1] @ T_tip_target), pin.FrameType.OP_FRAME
        )
    )
    data = chain.createData()
    R_base_root = robot.T_root_base[:3, :3].T
    # Placements that no <origin> carries are left out; skew axes have their zero besides.
    carried = [6 * i + k for i in range(last) if robot.carriers[i] is not None for k in range(6)]
    own = [k for k, name in enumerate(model.names) if not name.endswith(".zero")]
    configurations = robot.chain_values(q)
    for configuration, twist in zip(configurations, twists, strict=True):
        pin.forwardKinematics(chain, data, configuration)
        regressor = pin.computeFrameKinematicRegressor(chain, data, target, pin.LOCAL_WORLD_ALIGNED)
        expected = np.vstack([R_base_root @ regressor[:3], R_base_root @ regressor[3:]])
        np.testing.assert_allclose(twist[:, own], expected[:, carried], rtol=0, atol=1e-13)
        for i, joint in enumerate(robot.joints):
            if f"{joint.name}.zero" in model.names:
                about = regressor[:, 6 * i + 3 : 6 * i + 6] @ joint.axis
                zero = np.concatenate([R_base_root @ about[:3], R_base_root @ about[3:]])
                column = twist[:, model.index(f"{joint.name}.zero")]
                np.testing.assert_allclose(column, zero, rtol=0, atol=1e-13)


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


def test_the_jacobian_at_x_is_that_of_the_displaced_robot(ur3):
    # What is solved is the model at x, never the nominal one patched: a zero of the displaced robot's own DH
    # turns the same points.
    model = error_model(ur3, "zeros", target=False)
    x, q = finite_x(model), some_q(ur3)
    _, at_x = Kinematics(ur3, model, np.eye(4), np.eye(4)).twists(x, q)
    moved = model.apply(ur3, x)
    _, at_zero = Kinematics(moved, model, np.eye(4), np.eye(4)).twists(np.zeros(6), q)
    np.testing.assert_allclose(at_x, at_zero, atol=1e-12)


def test_another_number_of_frames_or_targets_than_the_model_has_is_refused(ur3):
    model = error_model(ur3, "dh", frame={"left": DIRECTIONS, "right": ()}, targets=("ball",))
    two, one = np.tile(np.eye(4), (2, 1, 1)), np.eye(4)
    assert Kinematics(ur3, model, two, one).T_tip_target.shape == (1, 4, 4)
    with pytest.raises(
        ModelError,
        match=r"1 poses T_frame_base were given; the model 'dh' has 2 such places: "
        r"'\(frame\)left', '\(frame\)right'",
    ):
        Kinematics(ur3, model, one, one)
    with pytest.raises(ModelError, match=r"2 poses T_tip_target were given; .* has 1 such"):
        Kinematics(ur3, model, two, two)


def test_compliances_need_the_load(ur3):
    model = error_model(ur3, "zeros+compliance")
    kinematics = seen(ur3, model)
    for method in (kinematics.poses, kinematics.twists):
        with pytest.raises(ModelError, match=r"shoulder_pan_joint' needs the load"):
            method(np.zeros(len(model)), some_q(ur3))
