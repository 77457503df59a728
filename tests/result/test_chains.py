"""Results of several chains: each is judged by its own rows, and the files have all of them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from calib.basics.arrays import Array
from calib.data.cell import Cell, FurtherRobot
from calib.data.cell_chains import robot_of_cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import CARE, NO, USE, Reason, Verdict, Why
from calib.model.parameter_sets import error_model
from calib.numerics.errors import Errors
from calib.numerics.geometry import pose_of
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.result.chains import ChainResult, evidence_of_chain, verdict_with_chains
from calib.result.collected_evidence import _collect_evidence, _expected_over_limits
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf, read_urdf
from tests import images

TIPS = {"left": "arm_left_7_link", "right": "arm_right_7_link"}

OFFSETS = {"left": np.array([0.06, 0.03, 0.05]), "right": np.array([-0.04, 0.05, 0.02])}

NOISE = 1e-4

#: Poses of each hand.
COUNT = 40


def poses_by_pinocchio(urdf: Urdf, robot: Robot, q: Array, base: str, tip: str) -> Array:
    """T_base_tip at joint values (N, m), (N, 4, 4) [m], by Pinocchio alone."""
    model = pin.buildModelFromXML(urdf.data.decode())
    data = model.createData()
    poses = []
    for row in q:
        configuration = pin.neutral(model)
        for name, value in zip(robot.joint_names, row, strict=True):
            configuration[model.joints[model.getJointId(name)].idx_q] = value
        pin.framesForwardKinematics(model, data, configuration)
        ends = (data.oMf[model.getFrameId(link)] for link in (base, tip))
        first, last = ends
        poses.append((first.inverse() * last).homogeneous)
    return np.array(poses)


def drawn(robot: Robot, rng: np.random.Generator) -> Robot:
    """A robot whose placements are off by 0.5 mm and 3 mrad."""
    model = error_model(robot, "placement", target=False)
    sizes = np.where(np.array(model.units) == "m", 5e-4, 3e-3)
    x = np.where(model.of_robot, sizes * rng.standard_normal(len(model)), 0.0)
    return model.apply(robot, x)


def table_of(
    robot: Robot, true: Robot, base: str, tips: dict[str, str], sigma: float
) -> Measurements:
    """Points on hands in a tracker's frame."""
    rng = np.random.default_rng(5)
    frame = pose_of(xyz=[1.0, 2.0, 0.3], rotation=pin.exp3(np.array([1.0, -0.7, 0.4])))
    count = len(tips) * COUNT
    q = random_joint_values(robot, count)
    points = []
    targets = []
    for k, (name, tip) in enumerate(tips.items()):
        of_hand = q[k * COUNT : (k + 1) * COUNT]
        T = frame @ poses_by_pinocchio(true.urdf, robot, of_hand, base, tip)
        points.append(T[:, :3, :3] @ OFFSETS[name] + T[:, :3, 3])
        targets += [name] * COUNT
    noise = sigma * rng.standard_normal((count, 3))
    prismatic = tuple(joint.name for joint in robot.inputs if joint.type == "prismatic")
    return Measurements(
        robot.joint_names,
        q,
        np.concatenate(points) + noise,
        targets=tuple(targets),
        prismatic=prismatic,
    )


@pytest.fixture(scope="module")
def two_hands() -> Calibration:
    cell = Cell(tips=TIPS, estimate_frame=True, instrument="tracker", model="placement")
    robot = robot_of_cell(read_urdf("tiago_dual"), cell)
    true = drawn(robot, np.random.default_rng(4))
    table = table_of(robot, true, "base_footprint", TIPS, NOISE)
    return calibrate(robot, table, cell=cell)


@pytest.mark.slow
def test_both_hands_in_one_fit(two_hands: Calibration, tmp_path: Path):
    chains = two_hands.trust.chains
    assert [(chain.tip, chain.rows, chain.verdict.use) for chain in chains] == [
        ("arm_left_7_link", COUNT, USE),
        ("arm_right_7_link", COUNT, USE),
    ]
    for chain in chains:
        assert chain.calibrated["m"].rms < 0.1 * chain.nominal["m"].rms
        assert chain.expected < 0.2 * chain.expected_of_nominal
    assert two_hands.verdict is not None
    assert two_hands.verdict.use == USE
    # The file and the URDF.
    again = Calibration.read_json(two_hands.write_json(tmp_path / "hands.json"))
    assert again.run == two_hands.run
    assert [chain.verdict.use for chain in again.trust.chains] == [USE, USE]
    q = random_joint_values(two_hands.nominal, 10)
    for target, tip in TIPS.items():
        predicted = two_hands.predict(q, target=target)
        assert np.allclose(again.predict(q, target=target), predicted, rtol=0.0, atol=1e-12)
        written = Urdf.read(two_hands.write_urdf(tmp_path / f"{target}.urdf"))
        T = poses_by_pinocchio(written, two_hands.nominal, q, "base_footprint", tip)
        t = two_hands.setup.targets.index(target)
        in_frame = two_hands.T_frame_base @ T @ two_hands.setup.T_tip_target[t]
        assert np.allclose(predicted, in_frame[:, :3, 3], rtol=0.0, atol=1e-9)


@pytest.mark.slow
def test_two_robots_without_noise_are_recovered_through_their_own_urdfs(tmp_path: Path):
    tips = {"left": "panda_link8", "right": "right/panda_link8"}
    cell = Cell(
        robots={"right": FurtherRobot("panda")},
        tips=tips,
        estimate_frame=True,
        instrument="tracker",
        scale_certified=True,
        model="placement",
    )
    robot = robot_of_cell(read_urdf("panda"), cell)
    place = pose_of(xyz=[1.1, 0.2, 0.05], rotation=pin.exp3(np.array([0.05, -0.02, 2.8])))
    placed = robot.with_limbs([limb.placements for limb in robot.limbs], {"right/mount": place})
    true = drawn(placed, np.random.default_rng(6))
    table = table_of(robot, true, "panda_link0", tips, 0.0)
    result = calibrate("panda", table, cell=cell, validate=False)
    result.write_urdf(tmp_path / "cell.urdf")
    own = {
        name: Urdf.read(tmp_path / f"cell_{word}.urdf")
        for name, word in (("left", "first"), ("right", "right"))
    }
    mount = result.robot.urdf.joint("right/mount").T_parent_joint
    nominal = Robot.from_urdf(read_urdf("panda"), "panda_link0", "panda_link8")
    q = random_joint_values(robot, 20)
    for k, (name, base) in enumerate((("left", np.eye(4)), ("right", mount))):
        of_arm = q[:, 7 * k : 7 * k + 7]
        T = poses_by_pinocchio(own[name], nominal, of_arm, "panda_link0", "panda_link8")
        found = result.T_frame_base @ base @ T @ result.setup.T_tip_target[k]
        true_T = poses_by_pinocchio(true.urdf, robot, q, "panda_link0", tips[name])
        frame = pose_of(xyz=[1.0, 2.0, 0.3], rotation=pin.exp3(np.array([1.0, -0.7, 0.4])))
        points = true_T[:, :3, :3] @ OFFSETS[name] + true_T[:, :3, 3]
        expected = points @ frame[:3, :3].T + frame[:3, 3]
        assert np.allclose(found[:, :3, 3], expected, rtol=0.0, atol=1e-8)


def two_arms() -> Urdf:
    """A turning waist that carries a left arm of three joints, and a right one of two."""
    joints = [("waist", "base", "torso", "0 0 0.3", "0 0 0", "0 0 1")]
    for side, y in (("left", 0.2), ("right", -0.2)):
        upper, lower = f"{side}_upper", f"{side}_lower"
        joints += [
            (f"{side}_shoulder", "torso", upper, f"0.1 {y} 0.2", "0 0 0", "0 1 0"),
            (f"{side}_elbow", upper, lower, "0.3 0 0.05", "0.5 0 0", "0 1 0"),
        ]
    joints.append(("left_wrist", "left_lower", "left_hand", "0.25 0 0.02", "0 0 0.4", "1 0 0"))
    lines = ['<robot name="two_arms">', '<link name="base"/>']
    for name, parent, child, xyz, rpy, axis in joints:
        lines += [
            f'<link name="{child}"/>',
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>',
            f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>',
            '<limit lower="-2" upper="2" effort="1" velocity="1"/></joint>',
        ]
    return Urdf.from_bytes("\n".join([*lines, "</robot>"]).encode(), "two_arms.urdf")


def test_each_hand_is_judged_by_its_rows_its_joints_and_its_own_target():
    tips = {"left": "left_hand", "right": "right_lower"}
    cell = Cell(tips=tips, model="zeros")
    robot = robot_of_cell(two_arms(), cell)
    zeros = error_model(robot, "zeros", target=False)
    true = zeros.apply(robot, np.array([4.0, -3.0, 6.0, -5.0, 3.0, -4.0]) * 1e-3)
    rng = np.random.default_rng(5)
    # So few that the verdicts state the numbers of parameters.
    poses = {"left": 7, "right": 6}
    joints, points, targets = [], [], []
    for seed, (hand, count) in enumerate(poses.items()):
        q = random_joint_values(robot, count, seed)
        T = poses_by_pinocchio(true.urdf, robot, q, "base", tips[hand])
        joints.append(q)
        points.append(T[:, :3, :3] @ OFFSETS[hand] + T[:, :3, 3])
        points[-1] += NOISE * rng.standard_normal((count, 3))
        targets += [hand] * count
    table = Measurements(
        robot.joint_names, np.concatenate(joints), np.concatenate(points), targets=tuple(targets)
    )
    result = calibrate(robot, table, cell=cell, robust=False)
    # The waist moves both hands.
    joints_of = {"left": 4, "right": 3}
    for hand, chain in zip(poses, result.trust.chains, strict=True):
        assert (chain.tip, chain.rows) == (tips[hand], poses[hand])
        target = result.setup.targets.index(hand)
        expected = _expected_over_limits(result, result.geometry, 0, target)
        assert (chain.expected, chain.expected_of_nominal) == expected[:2]
        (few,) = (r.values for r in chain.verdict.reasons if r.why is Why.FEW_NUMBERS)
        assert (few["poses"], few["numbers"]) == (poses[hand], 3 * poses[hand])
        assert few["parameters"] == joints_of[hand]
    first, second = result.trust.chains
    assert first.expected_of_nominal != second.expected_of_nominal


def test_the_call_names_the_links_of_the_only_chain_of_a_robot():
    """Of several it has the links of targets as the cell says, and no tip besides."""
    tips = {"left": "left_hand", "right": "right_lower"}
    several = Cell(tips=tips, model="zeros", estimate_frame=True)
    single = replace(several, tips={})
    tree = robot_of_cell(two_arms(), several)
    arm = Robot.from_urdf(two_arms(), "base", "left_hand", held={"left_wrist": 0.0})
    left = {"left": "left_hand"}
    for robot, cell, hands, said in (
        (tree, several, tips, (None, None, tips, {})),
        (arm, single, left, ("base", "left_hand", {}, {"left_wrist": 0.0})),
    ):
        table = table_of(robot, robot, "base", hands, NOISE)
        told = calibrate(robot, table, cell=cell, validate=False).method.call.cell
        assert (told.base, told.tip, told.tips, told.held) == said


def test_images_of_a_chain_count_as_poses():
    """The corners of one are no more numbers than its pose has."""
    board = replace(images.BOARD, sigma_scale=0.0, sigma_warp=0.0, sigma_corner=0.0)
    cameras = {"": images.camera(sigma=np.zeros(9))}
    cell = images.cell(cameras=cameras, boards={"": board}, model="frames")
    count = 4
    table = images.table(images.poses(count), noise=0.1, seed=1)
    result = calibrate(images.arm(), table, cell=cell, robust=False)
    fitted = result.fit.geometry
    rows = fitted.estimate.problem.rows
    residual = result.rows.residual_calibrated
    evidence = _collect_evidence(result, result.geometry, fitted, residual, rows, ())
    assert evidence.counts == {"poses": 4, "pairs": 0, "images": 4, "numbers": 24}
    chain = np.repeat([0, 1, 1, 1], len(rows) // count)
    of_two = replace(rows, samples=replace(rows.samples, chain=chain))
    x = result.geometry.x
    for number, expected in enumerate([1, 3]):
        moves = np.zeros(len(x), dtype=bool)
        part = evidence_of_chain(evidence, of_two, number, moves, x, (0.0, 0.0, 0.0))
        numbers = 6 * expected
        counts = {"poses": expected, "pairs": 0, "images": expected, "numbers": numbers}
        assert part.counts == counts


NOTHING = Errors({})


@pytest.mark.parametrize(
    ("words", "whole", "expected", "first"),
    [
        ((USE, USE), USE, USE, Why.GAIN),
        ((USE, CARE), USE, CARE, Why.CHAIN_CARE),
        ((CARE, NO), USE, NO, Why.CHAIN_AGAINST),
        ((CARE, NO), CARE, NO, Why.CHAIN_AGAINST),
        ((CARE, CARE), CARE, CARE, Why.GAIN),
        ((USE, USE), NO, NO, Why.GAIN),
    ],
)
def test_the_whole_is_no_better_than_a_chain(
    words: tuple[str, str], whole: str, expected: str, first: Why
):
    gain = Reason.of(Why.GAIN)
    chain = ChainResult("base", "tip", 10, NOTHING, NOTHING, 0.0, 0.0, Verdict(USE, (gain,)))
    chains = tuple(replace(chain, verdict=Verdict(word, (gain,))) for word in words)
    verdict = verdict_with_chains(Verdict(whole, (gain,)), chains)
    assert verdict.use == expected
    assert verdict.reasons[0].why is first
