"""The truth file: complete, read back, and read by others."""

import json
import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import calib
from calib.errors import CalibError, FileError
from calib.measure.cell import Cell
from calib.measure.disturbances import Encoder, MovedTarget, Outliers
from calib.measure.simulation import VirtualCell
from calib.measure.truth import draw_truth, tracker_pose
from calib.measure.truth_file import SCHEMA, read_truth, write_true_urdf, write_truth
from calib.model.readback import random_joint_values
from calib.model.robot import Robot
from calib.model.torques import Payload, gravity_load

MANY = "placement+gain+eccentricity+compliance"
FRAMES = {n: tracker_pose((2, y, 0), np.random.default_rng(1)) for n, y in (("a", 1), ("b", -1))}
CELL = Cell(
    targets={"upper": (0.1, 0, 0), "lower": (0, 0.1, 0.05)},
    frames=FRAMES,
    payload=Payload(3.0, np.array([0.0, 0.02, 0.1])),
    frozen=("elbow_joint.x",),
    ties={"wrist_3_joint.x": ("wrist_2_joint.x", -2.0)},
)


@pytest.fixture(scope="module")
def cell(ur3):
    return VirtualCell(
        draw_truth(ur3, MANY, seed=8, cell=CELL),
        outliers=Outliers(count=2),
        moved=MovedTarget(30, (0, 0, 1e-3), "lower"),
        drift=(0, 0, 1e-4),
        encoder=Encoder(1e-5),
        visits=2,
    )


@pytest.fixture(scope="module")
def made(ur3, cell):
    return cell.measure(random_joint_values(ur3, 10, seed=1), 4)


@pytest.fixture
def path(cell, made, tmp_path):
    return write_truth(cell, made, tmp_path / "truth.json")


def chain(path, nominal: bytes) -> pin.Model:
    """Pinocchio's own model of the nominal URDF with the file's origins, by lxml-free text work."""
    from calib.model.urdf import Urdf

    origins = {
        one["joint"]: pin.SE3(
            pin.rpy.rpyToMatrix(*one["rpy_rad"]), np.array(one["xyz_m"])
        ).homogeneous
        for one in json.loads(path.read_text())["origins"]
    }
    return pin.buildModelFromXML(Urdf.from_bytes(nominal, "x").with_origins(origins).data.decode())


def test_another_reader_finds_every_true_position(ur3, path, made):
    """From the JSON and the nominal URDF alone: joints' errors, origins, targets, frames, events."""
    said = json.loads(path.read_text())
    model = chain(path, ur3.urdf.data)
    data = model.createData()
    base, tip = model.getFrameId("base"), model.getFrameId("tool0")
    payload = Payload(said["payload"]["mass_kg"], np.array(said["payload"]["com_m"]))
    targets = {one["target"]: np.array(one["xyz_m"]) for one in said["targets"]}
    frames = {
        one["group"]: pin.SE3(
            pin.rpy.rpyToMatrix(*one["frame_base_rpy_rad"]), np.array(one["frame_base_xyz_m"])
        )
        for one in said["set_ups"]
    }
    moved = said["events"]["moved_target"]
    assert len(said["rows"]) == 40
    for i, row in enumerate(said["rows"]):
        q = np.array(row["joints"])
        load = dict(zip(ur3.joint_names, gravity_load(ur3, q, payload)[0], strict=True))
        value = dict(zip(said["robot"]["joints"], q, strict=True))
        true = dict(value)
        for one in said["displacements"]:
            if one["times"]:
                number = {
                    "value": value[one["place"]],
                    "sin": np.sin(value[one["place"]]),
                    "cos": np.cos(value[one["place"]]),
                    "load": load[one["place"]],
                }[one["times"]]
                true[one["place"]] += one["value"] * number
        configuration = pin.neutral(model)
        for name, angle in true.items():
            joint = model.joints[model.getJointId(name)]
            turn = [angle] if joint.nq == 1 else [np.cos(angle), np.sin(angle)]
            configuration[joint.idx_q : joint.idx_q + joint.nq] = turn
        pin.framesForwardKinematics(model, data, configuration)
        point = targets[row["target"]].copy()
        if row["row"] >= moved["from_row"] and row["target"] == moved["target"]:
            point += moved["displacement_m"]
        found = frames[row["group"]].act((data.oMf[base].inverse() * data.oMf[tip]).act(point))
        assert found == pytest.approx(np.array(row["xyz_m"]), abs=1e-9)
        assert found == pytest.approx(made.points[i], abs=1e-9)


def test_the_displacements_make_the_origins(ur3, path):
    said = json.loads(path.read_text())
    placements = dict(zip((j.name for j in ur3.joints), ur3.placements, strict=False))
    for one in said["displacements"]:
        if not one["times"]:
            turn = pin.exp6(one["value"] * np.array(one["twist"])).homogeneous
            placements[one["place"]] = placements[one["place"]] @ turn
    true = ur3.with_placements(np.array([*placements.values(), ur3.placements[-1]]))
    for one in said["origins"]:
        T = true.origins()[one["joint"]]
        assert T[:3, 3] == pytest.approx(one["xyz_m"], abs=1e-14)
        assert T[:3, :3] == pytest.approx(pin.rpy.rpyToMatrix(*one["rpy_rad"]), abs=1e-14)


def test_events_and_instrument(path, made):
    said = json.loads(path.read_text())
    assert said["schema"] == SCHEMA == "truth 1"
    assert said["seed"] == 4
    events = said["events"]
    assert tuple(one["row"] for one in events["outliers"]) == made.outlier_rows
    for one in events["outliers"]:
        assert np.linalg.norm(one["displacement_m"]) == pytest.approx(5e-3)
    assert events["moved_target"] == {
        "from_row": 30, "target": "lower", "displacement_m": [0, 0, 1e-3],
    }  # fmt: skip
    assert events["drift_m"] == [0, 0, 1e-4]
    assert said["instrument"]["noise"] == {
        "constant_m": 15e-6, "per_length_m_per_m": 6e-6, "repeatability_m": 20e-6,
    }  # fmt: skip
    assert said["instrument"]["encoder_step_rad"] == 1e-5
    assert said["instrument"]["visits"] == 2
    assert said["model"]["ties"] == [
        {"name": "wrist_3_joint.x", "other": "wrist_2_joint.x", "factor": -2.0}
    ]
    sigma = [row["sigma_m"] for row in said["rows"]]
    assert sigma == made.sigma.tolist()


@pytest.mark.parametrize("model", [MANY, "dh", "zeros", "frames"])
def test_what_is_written_is_read_back(ur3, tmp_path, model):
    truth = draw_truth(ur3, model, seed=3, cell=CELL)
    cell = VirtualCell(truth, noise=None)
    q = random_joint_values(ur3, 10)
    path = write_truth(cell, cell.measure(q), tmp_path / "t.json")
    again = read_truth(path, ur3)
    assert again.model.names == truth.model.names
    assert (again.x == truth.x).all()
    assert again.targets == ("upper", "lower")
    for name in ("upper", "lower"):
        for group in ("a", "b"):
            assert again.points(q, name, group) == pytest.approx(
                truth.points(q, name, group), abs=1e-13
            )
    assert again.said_T_tip_target == pytest.approx(truth.said_T_tip_target, abs=1e-15)


def test_the_truth_of_a_true_urdf_and_of_mimic_joints_is_read_back(ur3, tmp_path):
    made = draw_truth(ur3, "dh", seed=1)
    tiago = Robot.load("tiago", tip="arm_7_link", held={"torso_lift_joint": 0.2})
    hand = Robot.load("panda", tip="panda_leftfinger")
    cases = (
        draw_truth(ur3, "placement+gain", seed=2, true_robot=made.robot),
        draw_truth(tiago, MANY, seed=2),
        draw_truth(hand, "zeros+gain", seed=2),
    )
    for k, truth in enumerate(cases):
        cell = VirtualCell(truth, noise=None)
        q = random_joint_values(truth.nominal, 6)
        path = write_truth(cell, cell.measure(q), tmp_path / f"{k}.json")
        assert read_truth(path, truth.nominal).points(q) == pytest.approx(
            truth.points(q), abs=1e-13
        )


def test_another_robot_s_truth(ur3, panda, path):
    with pytest.raises(CalibError, match="the truth of another robot: its joints is"):
        read_truth(path, panda)
    tip = ur3.rebuilt(tip="flange") if "flange" in ur3.urdf.links else ur3.rebuilt(tip="ee_link")
    with pytest.raises(CalibError, match="its tip is 'tool0'"):
        read_truth(path, tip)
    moved = draw_truth(ur3).robot
    with pytest.raises(CalibError, match="its URDF's SHA-256 is"):
        read_truth(path, moved)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "not a JSON file"),
        ("[]", "its 'schema' is None; the truth of a simulated table has 'truth 1'"),
        ('{"schema": "calib-result/1"}', "its 'schema' is 'calib-result/1'"),
        ('{"schema": "truth 1"}', "incomplete or damaged .*Simulate it again"),
    ],
)
def test_what_is_no_truth(ur3, tmp_path, text, said):
    path = tmp_path / "truth.json"
    path.write_text(text)
    with pytest.raises(FileError, match=said):
        read_truth(path, ur3)


@pytest.mark.parametrize("key", ["parameters", "origins", "targets", "set_ups", "gravity_m_s2"])
def test_a_damaged_truth(ur3, path, key):
    table = json.loads(path.read_text())
    for value in (None, [{"name": 1}], "x", [{"name": "a", "value": 10**400}], 10**400):
        path.write_text(json.dumps({**table, key: value}))
        with pytest.raises(CalibError, match="incomplete or damaged"):
            read_truth(path, ur3)


def test_files_are_not_overwritten_unless_asked(cell, made, path):
    before = path.read_bytes()
    with pytest.raises(FileError, match="exists already"):
        write_truth(cell, made, path)
    assert write_truth(cell, made, path, overwrite=True).read_bytes() == before


def test_the_true_urdf(ur3, cell, tmp_path):
    path = write_true_urdf(cell.truth, tmp_path / "true.urdf")
    q = random_joint_values(ur3, 10)
    again = Robot.load(path, "base", "tool0").poses(q)
    assert again == pytest.approx(cell.truth.robot.poses(q), abs=1e-12)
    with pytest.raises(FileError, match="exists already"):
        write_true_urdf(cell.truth, path)


DOC = Path(__file__).parents[2] / "docs" / "simulation.md"


def test_the_document_has_every_key_and_no_other(path):
    said = json.loads(path.read_text())
    section = DOC.read_text(encoding="utf-8").split("## The truth file")[1].split("\n## ")[0]
    rows = [line.split("|")[1:3] for line in section.splitlines() if line.startswith("| `")]
    keys = [key for first, _ in rows for key in re.findall(r"`(\w+)", first)]
    assert sorted(keys) == sorted(said)
    for first, content in rows:
        for key in re.findall(r"`(\w+)", first):
            value = said[key][0] if isinstance(said[key], list) else said[key]
            if isinstance(value, dict):
                assert set(value) <= set(re.findall(r"`(\w+)", content)), key


def test_the_document_s_python_runs(ur3):
    text = DOC.read_text(encoding="utf-8")
    names = {"calib": calib, "robot": ur3}
    exec(re.findall(r"```python\n(.*?)```", text, re.DOTALL)[0], names)
    assert 0.0 < np.abs(names["error"]).max() < 1e-3
