"""The truth file: complete, read back, and read by others."""

import json
import re

import numpy as np
import pinocchio as pin
import pytest

from calib.data.cell import Cell
from calib.robot.gravity import Payload, gravity_loads
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.simulate.disturbances import (
    Encoder,
    FrameStep,
    MovedTarget,
    Outliers,
    StandingTargets,
)
from calib.verbs.simulate.equipment import usual_camera
from calib.verbs.simulate.scenario import Scenario, simulate
from calib.verbs.simulate.truth import tracker_pose
from calib.verbs.simulate.truth_file import SCHEMA, write_truth
from tests.places import ROOT
from tests.verbs.simulate.cells import BOARD

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
def scenario(ur3):
    return Scenario(
        ur3,
        CELL,
        MANY,
        outliers=Outliers(count=2),
        moved=MovedTarget(30, (0, 0, 1e-3), "lower"),
        drift=(0, 0, 1e-4),
        encoder=Encoder(1e-5),
        visits=2,
    )


@pytest.fixture(scope="module")
def made(ur3, scenario):
    return scenario.draw(8).measure(random_joint_values(ur3, 10, seed=1), 4)


@pytest.fixture
def path(scenario, made, tmp_path):
    return write_truth(scenario, made, tmp_path / "truth.json")


def chain(path, nominal: bytes) -> pin.Model:
    """Pinocchio's own model of the nominal URDF with the file's origins, by lxml-free text work."""
    from calib.robot.urdf import Urdf

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
        load = dict(zip(ur3.joint_names, gravity_loads(ur3, q, payload)[0, :, 0], strict=True))
        value = dict(zip(said["robot"]["joints"], q, strict=True))
        true = dict(value)
        for one in said["displacements"]:
            if one["times"]:
                number = {
                    "gain": value[one["place"]],
                    "sin": np.sin(value[one["place"]]),
                    "cos": np.cos(value[one["place"]]),
                    "compliance": load[one["place"]],
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


def test_events_and_instrument(path, made):
    said = json.loads(path.read_text())
    assert said["schema"] == SCHEMA == "truth 2"
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


def test_the_truth_has_robot_camera_board_and_pictures(tmp_path):
    robot = Robot.load("ur5", base="tool0", tip="base_link")
    cameras = Cell(kind="pixel", cameras={"": usual_camera()}, boards={"": BOARD})
    cell = Scenario(robot, cameras).draw(7)
    made = cell.measure(cell.poses(3, seed=1))
    path = write_truth(cell.scenario, made, tmp_path / "truth.json")
    truth = json.loads(path.read_text())
    pictures, equipment = made.pictures, cell.equipment
    errors = {entry["name"]: entry["value"] for entry in truth["parameters"]}
    assert errors["fx"] == equipment.camera.values[0] - equipment.stated.values[0]
    assert errors["board_scale_y"] == pytest.approx(equipment.printed.scale[1] - 1.0)
    assert errors["board_sag_x"] == equipment.printed.warp[0]
    assert errors["corner_5_y"] == equipment.printed.offsets[5, 1]
    assert errors["elbow_joint.z"] == cell.truth.value("elbow_joint.z")
    assert truth["cameras"][0]["values"]["cy"] == equipment.camera.values[3]
    assert truth["cameras"][0]["said_values"]["cy"] == 359.5
    np.testing.assert_allclose(truth["boards"][0]["corners_m"], equipment.printed.corners)
    np.testing.assert_allclose(
        truth["set_ups"][0]["frame_base_xyz_m"], cell.truth.T_frame_base[0, :3, 3]
    )
    second = truth["pictures"][1]
    assert second["image"] == "picture_02.png"
    np.testing.assert_allclose(second["joints"], pictures.q[1])
    is_here = pictures.picture == 1
    np.testing.assert_allclose(second["pixels"], pictures.true_pixels[is_here])
    assert second["corners"] == pictures.corner[is_here].tolist()


DOC = ROOT / "docs" / "simulation.md"


def test_the_document_has_every_key_and_no_other(path):
    said = json.loads(path.read_text())
    section = DOC.read_text(encoding="utf-8").split("## The truth file")[1].split("\n## ")[0]
    rows = [line.split("|")[1:3] for line in section.splitlines() if line.startswith("| `")]
    keys = [key for first, _ in rows for key in re.findall(r"`(\w+)", first)]
    assert sorted(keys) == sorted(said)
    for first, content in rows:
        for key in re.findall(r"`(\w+)", first):
            value = said[key]
            if isinstance(value, list):  # there may be no references
                value = value[0] if value else None
            if isinstance(value, dict):
                assert set(value) <= set(re.findall(r"`(\w+)", content)), key


def test_references_and_a_step_of_the_frame(ur3, tmp_path):
    step = FrameStep(3, np.array([0.0, 1e-4, 0.0]))
    scenario = Scenario(ur3, step=step, standing=StandingTargets(2, 5))
    made = simulate(scenario, 5, 0, seed=1)
    said = json.loads(write_truth(scenario, made, tmp_path / "truth.json").read_text())
    assert said["events"]["step"] == {"from_row": 3, "displacement_m": [0, 1e-4, 0]}
    assert [one["target"] for one in said["references"]] == ["reference 1", "reference 2"]
    np.testing.assert_array_equal([one["xyz_m"] for one in said["references"]], made.standing)
