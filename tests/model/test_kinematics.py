from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from calib.model.error_model import ErrorModel
from calib.model.kinematics import Kinematics, Samples
from calib.model.parameter_sets import DIRECTIONS, error_model
from calib.robot.chain import pinocchio_chain
from calib.robot.robot import Robot
from tests.robot.shared import joint, urdf_of

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

#: Joints that are held in one of them.
HELD = {"torso_lift_joint": 0.2, "head_2_joint": -0.3, "arm_4_joint": 0.7}

ROBOTS = ("ur3", "panda", "prismatic", "mimic", "tiago_held", *CHAINS)

#: Behind a set's name, every error that changes with the joints' state.
FAMILIES = "+gain+eccentricity+compliance+gravity"


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

    joints = (
        joint("outside", "fork", "elsewhere", axis="1 2 -0.5"),
        joint("a1", "fork", "a", axis="1 2 -0.5"),
        joint("a2", "a", "b", "prismatic", "1 2 -0.5", 'joint="a1" multiplier="0.2" offset="0.1"'),
        joint("a3", "b", "tip", "continuous", "1 2 -0.5"),
        joint("b1", "fork", "c", "continuous", "1 2 -0.5", 'joint="a1" multiplier="-0.5"'),
        joint(
            "b2",
            "c",
            "base",
            "revolute",
            "1 2 -0.5",
            'joint="outside" multiplier="1.5" offset="-0.2"',
        ),
    )
    return Robot.from_urdf(urdf_of("fork elsewhere a b c tip base", *joints), "base", "tip")


def seen(robot: Robot, model: ErrorModel) -> Kinematics:
    """From a frame that is turned and far away, at a target off the tip that is turned too."""
    return Kinematics(robot, model, pose(1, 2.0), pose(2, 0.3))


def some_q(robot: Robot, count: int = 3) -> np.ndarray:
    return np.random.default_rng(4).uniform(-1.5, 1.5, (count, len(robot.joint_names)))


def some_load(robot: Robot, count: int = 3) -> np.ndarray:
    """Loads of up to 20 Nm or N, and lever arms of up to 2 m."""
    n = len(robot.joints)
    scale = np.append(20.0, np.full(n + 2, 2.0))
    return scale * np.random.default_rng(6).uniform(-1, 1, (count, n, n + 3))


def sizes(model: ErrorModel) -> np.ndarray:
    """What moves a joint or a placement by 2 cm or 0.1 rad or so, in each parameter's unit."""
    by_unit = {"m": 0.02, "rad": 0.1, "1": 0.05, "m/m": 0.05, "rad/Nm": 5e-3, "m/N": 1e-3}
    by_unit["rad/m"] = 0.02
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
    step = {"m": 1.0, "rad": 1.0, "1": 1.0, "m/m": 1.0, "rad/Nm": 0.05, "m/N": 0.05, "rad/m": 1.0}
    for k, parameter in enumerate(model.parameters):
        unit = step[parameter.unit]
        expected = twists_by_differences(lambda x: kinematics.poses(x, samples), x, k, unit)
        for part in (slice(0, 3), slice(3, 6)):
            difference = np.linalg.norm(twists[:, part, k] - expected[:, part])
            scale = np.linalg.norm(expected[:, part])
            # Columns that are zero are zero up to the rounding of the differences.
            assert difference <= 1e-7 * scale + 2e-12 / unit, (parameter.name, difference, scale)


#: Each set and each robot in each run, all pairs of them in the slow one.
SOME_PAIRS = [
    pytest.param(which, name, marks=() if (i + k) % len(SETS) == 0 else pytest.mark.slow)
    for i, which in enumerate(ROBOTS)
    for k, name in enumerate(SETS)
]


@pytest.mark.parametrize("at", ["nominal", "displaced"])
@pytest.mark.parametrize(("which", "name"), SOME_PAIRS)
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


@pytest.mark.parametrize("name", ["dh", "placement", "zeros" + FAMILIES])
@pytest.mark.parametrize("which", ["ur3", "mimic"])
def test_every_column_with_several_frames_and_targets(robots, which, name):
    kinematics, samples = several(robots[which], name)
    x = finite_x(kinematics.model)
    assert_columns_equal_their_differences(kinematics, x, samples)


@pytest.mark.parametrize("which", ROBOTS)
def test_errors_of_the_joints_state_move_the_joints(robots, which):
    # The same poses as of the nominal robot with its joints where these errors put them.
    robot = robots[which]
    model = error_model(robot, "frames" + FAMILIES, target=False)
    x, q, load = finite_x(model), some_q(robot), some_load(robot)
    value = dict(zip(model.names, x, strict=True))
    column = np.zeros_like(q)
    for c, one in enumerate(robot.inputs):
        column[:, c] = value[f"{one.name}.gain"] * q[:, c]
        if one.type != "prismatic":
            column[:, c] += value[f"{one.name}.sin"] * np.sin(q[:, c])
            column[:, c] += value[f"{one.name}.cos"] * np.cos(q[:, c])
    given_way = load[:, :, 0] * [value[f"{joint.name}.compliance"] for joint in robot.joints]
    points = [*(joint.name for joint in robot.joints), "tip", "base"]
    for i, one in enumerate(robot.joints):
        for k, point in enumerate(points):
            given_way[:, i] += value.get(f"{one.name}.gravity[{point}]", 0.0) * load[:, i, 1 + k]
    chain = pinocchio_chain(robot.joints, robot.placements)
    configurations = robot.chain_values(q + column) + given_way
    data = chain.createData()
    poses = Kinematics(robot, model, np.eye(4), np.eye(4)).poses(x, Samples.at(q, load))
    for configuration, one in zip(configurations, poses, strict=True):
        pin.forwardKinematics(chain, data, configuration)
        T_root_tip = data.oMi[chain.njoints - 1].homogeneous @ robot.placements[-1]
        expected = np.linalg.inv(robot.T_root_base) @ T_root_tip
        np.testing.assert_allclose(one, expected, rtol=0, atol=1e-13)
