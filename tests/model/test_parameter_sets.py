from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib.errors import ModelError
from calib.example import PAPER_TARGET
from calib.model.dh_table import dh_table
from calib.model.error_model import FRAME, TARGET, TIP, ErrorModel
from calib.model.families import ANGLE, LENGTH, ZERO
from calib.model.kinematics import Kinematics
from calib.model.parameter_sets import (
    DIRECTIONS,
    error_model,
)
from calib.robot.dh_rows import DHTable
from calib.robot.robot import Robot
from tests.robot.shared import joint, urdf_of

COMPLIANCE, ECCENTRICITY, GAIN = "compliance", "eccentricity", "gain"

PAPER_NAMES = (
    *(f"{kind}{row}" for row in range(1, 7) for kind in ("a", "alpha", "d", "theta")),
    *(f"target_{axis}" for axis in "xyz"),
)


def paper_matrix(theta: float, d: float, a: float, alpha: float) -> np.ndarray:
    """The paper's A_i, written out."""
    ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array(
        [
            [ct, -st * ca, st * sa, a * ct],
            [st, ct * ca, -ct * sa, a * st],
            [0, sa, ca, d],
            [0, 0, 0, 1],
        ]
    )


def rotation_y(beta: float) -> np.ndarray:
    return pin.SE3(pin.exp3(np.array([0.0, beta, 0.0])), np.zeros(3)).homogeneous


def pose_of_rows(table: DHTable, q: np.ndarray, offsets: dict[str, float]) -> np.ndarray:
    """T_base_tip from the rows with offsets added, by the paper's matrices and Hayati's Ry."""
    T = table.T_base_0
    for i, row in enumerate(table.rows, start=1):
        turn, slide = (0.0, q[i - 1]) if row.prismatic else (q[i - 1], 0.0)
        T = T @ paper_matrix(
            row.theta + turn + offsets.get(f"theta{i}", 0.0),
            row.d + slide + offsets.get(f"d{i}", 0.0),
            row.a + offsets.get(f"a{i}", 0.0),
            row.alpha + offsets.get(f"alpha{i}", 0.0),
        )
        T = T @ rotation_y(row.beta + offsets.get(f"beta{i}", 0.0))
    return T @ table.T_n_tip


def offsets_of(model: ErrorModel, seed: int = 0) -> np.ndarray:
    """Large offsets, up to 1 cm and 0.1 rad."""
    size = [0.01 if p.unit == "m" else 0.1 for p in model.parameters]
    return np.random.default_rng(seed).uniform(-1, 1, len(model)) * size


def tilted(robot: Robot, seed: int = 1) -> Robot:
    """A robot whose axes are all off by some mrad, as a real one's are."""
    model = error_model(robot, "placement", target=False)
    return model.apply(robot, np.random.default_rng(seed).normal(0, 3e-3, len(model)))


# The sets


def test_the_paper_s_27_parameters(ur3):
    model = error_model(ur3, "paper")
    assert model.names == PAPER_NAMES
    assert len(model) == 27
    families = {"a": LENGTH, "alpha": ANGLE, "d": LENGTH, "theta": ZERO, "target_": TARGET}
    for p in model.parameters:
        assert p.family == families[p.name.rstrip("123456xyz")]
        assert p.unit == ("rad" if p.family in (ANGLE, ZERO) else "m")
    assert model.families == (LENGTH, ANGLE, ZERO)
    nominal = {p.name: p.nominal for p in model.parameters}
    np.testing.assert_allclose((nominal["a2"], nominal["d4"]), (-0.24365, 0.11235), atol=1e-9)


@pytest.mark.parametrize(
    ("name", "count"),
    [("dh", 24), ("hayati", 24), ("placement", 36), ("zeros", 6), ("frames", 0)],
)
@pytest.mark.parametrize("frame", [False, True])
@pytest.mark.parametrize("target", [False, True])
def test_the_sizes_of_the_sets(ur3, name, count, frame, target):
    model = error_model(ur3, name, frame=frame, target=target)
    assert len(model) == count + 6 * frame + 3 * target
    assert model.family(FRAME).sum() == 6 * frame
    assert model.family(TARGET).sum() == 3 * target
    assert model.family(*(LENGTH, ANGLE, ZERO)).sum() == count
    assert model.places == (FRAME, *ur3.joint_names, TIP, TARGET)


def test_hayati_has_beta_in_place_of_d_where_axes_are_parallel(ur3):
    dh, hayati = (set(error_model(ur3, name).names) for name in ("dh", "hayati"))
    assert dh - hayati == {"d2", "d3"}
    assert hayati - dh == {"beta2", "beta3"}


# Several frames and targets, by name


def test_frames_and_targets_by_name(ur3):
    model = error_model(
        ur3,
        "frames",
        frame={"left": DIRECTIONS, "right": (), "top": ("rz", "x")},
        targets=("ball", "cone"),
    )
    assert model.places == (
        *("(frame)left", "(frame)right", "(frame)top"),
        *ur3.joint_names,
        TIP,
        *("(target)ball", "(target)cone"),
    )
    assert model.names == (
        *(f"frame_{d}[left]" for d in DIRECTIONS),
        *("frame_x[top]", "frame_rz[top]"),  # in the order of the directions
        *(f"target_{d}[ball]" for d in "xyz"),
        *(f"target_{d}[cone]" for d in "xyz"),
    )
    top = model.parameters[model.index("frame_rz[top]")]
    assert (top.place, top.unit, top.family) == ("(frame)top", "rad", FRAME)
    np.testing.assert_array_equal(top.direction, np.eye(6)[5])


# Chains of two branches, chains that start with a joint, and joints that follow others


#: Robot, base and tip; whether the base, and the tip, is moved by a joint of the chain without an <origin> between.
CHAINS = {
    "ur3 turned round": ("ur3", "tool0", "base", False, False),
    "ur3 turned round, bare": ("ur3", "wrist_3_link", "base", True, False),
    "tiago head to arm": (
        *("tiago_no_hand", "xtion_rgb_optical_frame", "wrist_ft_tool_link"),
        *(False, False),
    ),
    "talos head to arm": (
        *("talos_full_v2", "rgbd_optical_frame", "wrist_left_ft_tool_link"),
        *(False, False),
    ),
    "pr2 head to finger": ("pr2", "head_plate_frame", "r_gripper_l_finger_tip_link", False, True),
    "panda finger to base": ("panda", "panda_rightfinger", "panda_link0", True, False),
    "panda's fingers": ("panda", "panda_leftfinger", "panda_rightfinger", True, True),
    "pr2's fingers": (
        *("pr2", "l_gripper_l_finger_tip_link", "l_gripper_r_finger_tip_link"),
        *(True, True),
    ),
}


@pytest.fixture(scope="module")
def chains() -> dict[str, Robot]:
    return {which: Robot.load(*ends[:3]) for which, ends in CHAINS.items()}


@pytest.mark.parametrize("name", ["dh", "hayati"])
@pytest.mark.parametrize("which", CHAINS)
def test_offsets_of_any_chain_equal_the_paper_s_matrices(chains, which, name):
    robot = chains[which]
    assert (robot.carriers[0] is None, robot.carriers[-1] is None) == CHAINS[which][3:]
    model, table = error_model(robot, name, target=False), dh_table(robot)
    q = np.random.default_rng(2).uniform(-1, 1, (3, len(robot.joint_names)))
    x = offsets_of(model)
    poses = model.apply(robot, x).poses(q)  # by the corrected URDF: every offset has an <origin>
    for values, pose in zip(robot.chain_values(q), poses, strict=True):
        expected = pose_of_rows(table, values, dict(zip(model.names, x, strict=True)))
        np.testing.assert_allclose(pose, expected, rtol=0, atol=1e-13)


def test_a_skew_axis_has_a_zero_of_its_own_among_the_placement_s(serial_urdf):
    robot = Robot.from_urdf(
        serial_urdf(
            [
                ("revolute", (0, 0, 0.3), (0.1, 0, 0), (0, 0, -1)),
                ("revolute", (0.2, 0, 0), (0, 1.2, 0), (0, 1, 1)),
                ("prismatic", (0, 0.1, 0.2), (1.0, 0, 0.3), (1, 1, 0)),
            ]
        )
    )
    model = error_model(robot, "placement", target=False)
    extra = [name for name in model.names if name.endswith(".zero")]
    assert (extra, len(model)) == (["j2.zero"], 19)
    families = {p.name: p.family for p in model.parameters}
    assert families["j1.rz"] == ZERO
    assert {families[f"j2.{d}"] for d in ("rx", "ry", "rz")} == {ANGLE}
    assert {families[f"j3.{d}"] for d in ("rx", "ry", "rz")} == {ANGLE}
    zero = model.parameters[model.index("j2.zero")]
    np.testing.assert_array_equal(zero.direction[3:], robot.joints[1].axis)


def test_zeros_of_followers_are_tied_to_their_driver_s():
    robot = Robot.from_urdf(
        urdf_of(
            "l0 l1 l2 l3 l4 l5 l6 l7",
            joint("a", "l0", "l1", "continuous"),
            joint("b", "l1", "l2", mimic='joint="a" multiplier="-2" offset="0.3"'),
            joint("c", "l2", "l3", "prismatic", mimic='joint="a" multiplier="0.5"'),
            joint("d", "l3", "l4", mimic='joint="outside" multiplier="4"'),
            joint("e", "l4", "l5", "prismatic", mimic='joint="a" multiplier="0.25"'),
            joint("f", "l5", "l6", mimic='joint="outside" multiplier="-1"'),
            joint("outside", "l0", "l7"),
        ),
        tip="l6",
    )
    assert robot.joint_names == ("a", "outside")
    model = error_model(robot, "zeros", target=False)
    # b follows a; e follows c, for lengths cannot follow angles; f follows d, as their driver is elsewhere
    assert model.names == ("a.zero", "c.zero", "d.zero")
    np.testing.assert_array_equal(
        model.mixing,
        [[1, 0, 0], [-2, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0.5, 0], [0, 0, -0.25]],
    )
    # both kinds in the right proportion are a zero of the column itself
    x, q = np.array([0.1, 0.05, 0.0]), np.array([0.4, -0.3])
    np.testing.assert_allclose(
        model.apply(robot, x).poses(q), robot.poses(q + np.array([0.1, 0.0])), rtol=0, atol=1e-14
    )


# Exactness: a DH offset is a displacement of a placement, and no approximation


def test_betas_turn_the_next_axis_as_hayati_s_ry(ur3):
    robot = tilted(ur3)
    model, table = error_model(robot, "hayati", target=False), dh_table(robot)
    assert {n for n in model.names if n.startswith("beta")} == {"beta2", "beta3"}
    assert all(abs(table.rows[i].beta) > 1e-4 for i in (1, 2))
    q = np.random.default_rng(4).uniform(-np.pi, np.pi, 6)
    for name in ("beta2", "beta3"):
        x = np.zeros(len(model))
        x[model.index(name)] = 0.1
        expected = pose_of_rows(table, q, {name: 0.1})
        np.testing.assert_allclose(model.apply(robot, x).poses(q)[0], expected, atol=1e-13)


# apply


@pytest.mark.parametrize("name", ["dh", "hayati", "placement", "zeros"])
def test_apply_and_kinematics_agree(ur3, name):
    model = error_model(ur3, name, target=True)
    x = offsets_of(model)
    x[model.family(TARGET)] = 0
    T_tip_target = np.eye(4)
    T_tip_target[:3, 3] = PAPER_TARGET
    q = np.random.default_rng(0).uniform(-3, 3, (4, 6))
    poses = Kinematics(ur3, model, np.eye(4), T_tip_target).poses(x, q)
    np.testing.assert_allclose(poses, model.apply(ur3, x).poses(q) @ T_tip_target, atol=1e-14)


@pytest.mark.parametrize("name", ["dhh", "dh+gains", "dh+gain+gain", "dh+", "dh+dh"])
def test_a_set_or_family_that_does_not_exist_or_is_named_twice(ur3, name):
    with pytest.raises(
        ModelError, match=r"Choose 'auto', or one of 'paper', 'dh', .* any of 'gain'"
    ):
        error_model(ur3, name)
