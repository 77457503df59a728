"""Truth: drawn, given by name, or as a URDF; where it puts the target."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from calib.basics.arrays import rigid_inverse
from calib.data.cell import Cell, Tracker
from calib.model.families import FAMILIES
from calib.model.parameter_sets import error_model
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.simulate.truth import TARGET_ERROR, draw_truth, tracker_pose

MANY = "placement+gain+eccentricity+compliance"


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_the_true_robot_is_the_geometry_alone(ur3):
    truth = draw_truth(ur3, MANY, seed=1)
    plain = draw_truth(ur3, "placement", seed=1)
    # Families come behind the set: the geometry is the same with and without them.
    assert (truth.robot.placements == plain.robot.placements).all()
    q = random_joint_values(ur3, 5)
    assert plain.tip_poses(q) == pytest.approx(plain.robot.poses(q), abs=1e-14)
    assert np.abs(truth.tip_poses(q) - truth.robot.poses(q))[:, :3, 3].max() > 1e-5


@pytest.mark.parametrize("model", ["placement", "hayati"])
def test_two_independent_readers_agree_with_the_true_urdf(ur3, model, tmp_path):
    yourdfpy = pytest.importorskip("yourdfpy")
    truth = draw_truth(ur3, model, seed=5)
    path = truth.robot.urdf.write(tmp_path / "true.urdf")
    model_of_file = pin.buildModelFromUrdf(str(path))
    data = model_of_file.createData()
    read = yourdfpy.URDF.load(str(path), load_meshes=False, build_collision_scene_graph=False)
    for q in random_joint_values(ur3, 10, seed=2):
        expected = truth.tip_poses(q)[0]
        values = dict(zip(ur3.joint_names, q, strict=True))
        configuration = pin.neutral(model_of_file)
        for name, value in values.items():
            joint = model_of_file.joints[model_of_file.getJointId(name)]
            turn = [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
            configuration[joint.idx_q : joint.idx_q + joint.nq] = turn
        pin.framesForwardKinematics(model_of_file, data, configuration)
        base, tip = (data.oMf[model_of_file.getFrameId(n)] for n in ("base", "tool0"))
        assert (base.inverse() * tip).homogeneous == pytest.approx(expected, abs=1e-9)
        read.update_cfg(values)
        found = np.linalg.inv(read.get_transform("base")) @ read.get_transform("tool0")
        assert found == pytest.approx(expected, abs=1e-9)


def test_drawn_errors_have_the_sizes_of_their_families(ur3):
    model = error_model(ur3, MANY, target=False)
    x = np.array([draw_truth(ur3, MANY, seed=s).x for s in range(300)])
    assert (np.abs(x.mean(axis=0)) < 5 * x.std(axis=0) / np.sqrt(300))[
        ~model.family("compliance")
    ].all()
    for family in model.families:
        rms = np.sqrt((x[:, model.family(family)] ** 2).mean())
        assert rms == pytest.approx(FAMILIES[family].typical, rel=0.08)
    assert (x[:, model.family("compliance")] > 0.0).all()


def test_single_errors_win_over_drawn_ones(ur3):
    given = {"elbow_joint.rx": 2e-3, "wrist_1_joint.gain": 1e-3}
    drawn = draw_truth(ur3, "placement+gain", seed=1)
    truth = draw_truth(ur3, "placement+gain", seed=1, errors=given)
    for name in truth.model.names:
        assert truth.value(name) == given.get(name, drawn.value(name))
    only = draw_truth(ur3, "placement", None, errors={"elbow_joint.rx": 2e-3})
    turn = pin.exp6(np.array([0, 0, 0, 2e-3, 0, 0])).homogeneous
    expected = ur3.placements.copy()
    expected[2] = expected[2] @ turn
    assert only.robot.placements == pytest.approx(expected, abs=1e-15)


def test_what_a_cell_says_of_single_errors_holds(ur3):
    cell = Cell(
        frozen=("d2", "elbow_joint.x"),
        ties={"a3": ("a2", -1.0)},
        bounds={"d1": (-1e-6, 1e-6)},
        parameter_priors={"d6": 1e-9},
    )
    values = [draw_truth(ur3, "dh", seed=s, cell=cell) for s in range(20)]
    for truth in values:
        terms = dict(
            zip((t.name for t in truth.model.terms), truth.model.values(truth.x), strict=True)
        )
        assert "d2" not in terms
        assert terms["a3"] == -terms["a2"]
        assert abs(terms["d1"]) <= 1e-6
        assert abs(terms["d6"]) < 1e-8
    assert {abs(t.value("d1")) for t in values} >= {1e-6}


def test_a_true_urdf_is_the_truth(ur3):
    made = draw_truth(ur3, "placement+gain", seed=4)
    truth = draw_truth(ur3, "zeros+gain", seed=4, true_robot=made.robot)
    assert truth.model.name == "placement+gain"
    assert truth.robot.placements == pytest.approx(made.robot.placements, abs=1e-15)
    geometry = truth.model.family("length", "angle", "zero")
    assert truth.x[geometry] == pytest.approx(made.x[geometry], abs=1e-15)
    # Its errors of the joints' state are drawn, or given.
    assert (truth.x[~geometry] != 0.0).all()
    given = draw_truth(
        ur3, "zeros+gain", None, true_robot=made.robot, errors={"elbow_joint.gain": 1e-3}
    )
    assert given.value("elbow_joint.gain") == 1e-3
    assert np.count_nonzero(given.x[~geometry]) == 1


def test_the_target_is_drawn_about_where_it_is_said_to_be(ur3):
    said = np.array([0.1, 0.0, 0.03])
    cell = Cell(target=said, target_rotation=Rotation.from_euler("x", 0.3).as_matrix())
    off = [
        draw_truth(ur3, "frames", seed=s, cell=cell).T_tip_target[0, :3, 3] - said
        for s in range(300)
    ]
    assert np.std(off) == pytest.approx(TARGET_ERROR, rel=0.1)
    one = draw_truth(ur3, "frames", cell=cell)
    assert (one.stated_T_tip_target[0, :3, :3] == cell.target_rotation).all()
    assert not np.allclose(one.T_tip_target[0, :3, :3], cell.target_rotation, atol=1e-4)


def test_frames_are_the_cell_s_or_drawn_or_the_base(ur3):
    own = tracker_pose((1.0, 2.0, 3.0), rng())
    assert (draw_truth(ur3).T_frame_base[0] == np.eye(4)).all()
    assert (draw_truth(ur3, cell=Cell(T_frame_base=own)).T_frame_base[0] == own).all()
    drawn = draw_truth(ur3, cell=Cell(estimate_frame=True), seed=1).T_frame_base[0]
    tracker = rigid_inverse(drawn)[:3, 3]
    assert np.hypot(*tracker[:2]) == pytest.approx(3.0)
    other = draw_truth(ur3, cell=Cell(estimate_frame=True), seed=2).T_frame_base[0]
    assert not np.allclose(drawn, other)
    cell = Cell(estimate_frame=True, tracker=Tracker(np.array([2.0, 0.5, 0.3])))
    placed = draw_truth(ur3, cell=cell, seed=1).T_frame_base[0]
    assert rigid_inverse(placed)[:3, 3] == pytest.approx([2.0, 0.5, 0.3])
    # Levelled: the tracker's z is up to a few hundredths.
    assert placed[2, 2] > np.cos(0.06)


def test_a_chain_with_a_sliding_joint_a_mimic_joint_and_two_branches():
    robot = Robot.load("tiago", tip="arm_7_link")
    truth = draw_truth(robot, MANY, seed=2)
    slides = [p for p in truth.model.parameters if p.unit == "m/N"]
    assert slides
    q = random_joint_values(robot, 5)
    assert np.isfinite(truth.points(q)).all()
    camera = Robot.load("tiago", base="xtion_rgb_optical_frame", tip="arm_7_link")
    seen = draw_truth(camera, "dh", seed=2)
    q = random_joint_values(camera, 5)
    assert seen.tip_poses(q) == pytest.approx(seen.robot.poses(q), abs=1e-14)
    assert seen.nominal_errors(q).min() > 1e-4
