"""Cells of several hands, cameras and robots: the table agrees with the written truth, as Pinocchio alone has it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from calib.boards.board import Board
from calib.camera.camera import Camera
from calib.data.cell import Cell, FurtherRobot
from calib.data.cell_chains import robot_of_cell
from calib.errors import CalibError, ModelError
from calib.numerics.errors import rms
from calib.result.calibrate import calibrate
from calib.robot.urdf import read_urdf
from calib.verbs.simulate.picture_files import write_pictures
from calib.verbs.simulate.scenario import Scenario, simulate, with_robots_placed
from calib.verbs.simulate.text import shown_twice, simulated_text
from calib.verbs.simulate.truth_file import write_truth

TWO_PANDAS = Cell(
    estimate_frame=True,
    robots={"right": FurtherRobot("panda")},
    tips={"a": "panda_link8", "b": "right/panda_link8"},
)

TIAGO = Cell(estimate_frame=True, tips={k: f"arm_{k}_7_link" for k in ("left", "right")})

BOARD = Board(pattern="chessboard", columns=5, rows=4, square=0.04)

#: A camera on the wrist that sees a board on the table, and one on the wall that sees a board on the flange.
WRIST_AND_WALL = Cell(
    kind="pixel",
    bases={"wrist": "panda_link8", "wall": "panda_link0"},
    tips={"table": "panda_link0", "flange": "panda_link8"},
    cameras={name: Camera(width=1280, height=720) for name in ("wrist", "wall")},
    boards={"": BOARD},
)


def pose_in(model: pin.Model, names: tuple[str, ...], q, base: str, tip: str) -> pin.SE3:
    """T_base_tip at joint values, by Pinocchio alone."""
    configuration = pin.neutral(model)
    for name, value in zip(names, q, strict=True):
        configuration[model.joints[model.getJointId(name)].idx_q] = value
    data = model.createData()
    pin.framesForwardKinematics(model, data, configuration)
    return data.oMf[model.getFrameId(base)].inverse() * data.oMf[model.getFrameId(tip)]


def pose_of(said: dict, prefix: str = "") -> pin.SE3:
    """The pose of an entry of a truth file."""
    R = pin.rpy.rpyToMatrix(*said[f"{prefix}rpy_rad"])
    return pin.SE3(R, np.array(said[f"{prefix}xyz_m"]))


@pytest.fixture(scope="module")
def pandas():
    return Scenario("panda", TWO_PANDAS, noise=None)


def test_both_hands_are_measured_at_each_stop_where_the_written_truth_has_them(
    pandas, tmp_path: Path
):
    made = simulate(pandas, 4, 2, seed=3)
    table = made.measurements
    assert table.targets == ("a", "b") * 6
    assert table.sets == ("estimate",) * 8 + ("validate",) * 4
    assert len(table.joint_names) == 14
    made.truth.write_urdf(tmp_path / "true.urdf")
    said = json.loads(write_truth(pandas, made, tmp_path / "t.json").read_text())
    model = pin.buildModelFromUrdf(str(tmp_path / "true.urdf"))
    frame = pose_of(said["set_ups"][0], "frame_base_")
    for k, target in enumerate(said["targets"]):
        assert target["link"] == TWO_PANDAS.tips[target["target"]]
        for row in range(k, len(table), 2):
            T = pose_in(model, table.joint_names, table.joints[row], "panda_link0", target["link"])
            expected = (frame * T).act(np.array(target["xyz_m"]))
            assert np.abs(table.points[row] - expected).max() < 1e-9
    # One URDF a robot: that of the right one has its own errors, and none of them is that of the left.
    left, right = (
        pin.buildModelFromUrdf(str(tmp_path / f"true_{name}.urdf")) for name in ("first", "right")
    )
    assert (
        np.abs(left.jointPlacements[3].translation - right.jointPlacements[3].translation).max()
        > 1e-5
    )
    inside = model.jointPlacements[model.getJointId("right/panda_joint3")]
    assert right.jointPlacements[3].isApprox(inside, 1e-9)


def test_a_further_robot_stands_a_metre_away_to_a_centimetre_or_where_it_is_said(pandas):
    placed = with_robots_placed(TWO_PANDAS).robots["right"].T_root_base
    assert placed[:3, 3].tolist() == [1.0, 0.0, 0.0]
    np.testing.assert_allclose(placed[:3, 0], [-1.0, 0.0, 0.0], atol=1e-15)  # it faces the first
    truth = pandas.draw(0).truth
    T = truth.robot.urdf.joint("right/mount").T_parent_joint
    assert 1e-3 < np.linalg.norm(T[:3, 3] - placed[:3, 3]) < 0.06
    assert 1e-3 < np.linalg.norm(pin.log3(placed[:3, :3].T @ T[:3, :3])) < 0.06
    stated = FurtherRobot("panda", T_root_base=placed, estimated=False)
    known = replace(TWO_PANDAS, robots={"right": stated})
    assert with_robots_placed(known).robots == known.robots
    fixed = Scenario("panda", known).draw(0).truth.robot
    np.testing.assert_allclose(fixed.urdf.joint("right/mount").T_parent_joint, placed, atol=1e-12)


def test_what_a_frame_on_a_hand_sees_moves_with_it():
    """A stereo camera on one hand of TIAGo sees a marker on the other."""
    cell = Cell(
        bases={"eyes": "arm_left_7_link"}, tips={"ball": "arm_right_7_link"}, estimate_frame=True
    )
    made = simulate(Scenario("tiago_dual", cell, sizes=None, target_error=0.0, noise=None), 3, 0)
    truth, table = made.truth, made.measurements
    assert (set(table.groups), set(table.targets)) == ({"eyes"}, {"ball"})
    eyes = np.linalg.inv(truth.T_frame_base[0])
    assert np.linalg.norm(eyes[:3, 3]) == pytest.approx(0.1)  # on the hand, not beside the robot
    model = pin.buildModelFromXML(read_urdf("tiago_dual").data.decode())
    for q, point in zip(table.joints, table.points, strict=True):
        T = pose_in(model, table.joint_names, q, "arm_left_7_link", "arm_right_7_link")
        expected = truth.T_frame_base[0] @ np.append(T.act(truth.T_tip_target[0][:3, 3]), 1.0)
        np.testing.assert_allclose(point, expected[:3], atol=1e-12)


def test_stations_on_one_link_take_the_poses_in_turn_and_those_on_others_all():
    cell = replace(
        TIAGO,
        bases={"t1": "base_footprint", "t2": "base_footprint", "eyes": "head_2_link"},
        base="base_footprint",
    )
    table = simulate(Scenario("tiago_dual", cell), 4, 0).measurements
    pose = np.unique(table.joints, axis=0, return_inverse=True)[1].reshape(-1)
    _, first = np.unique(pose, return_index=True)
    by_pose = [{table.groups[i] for i in np.flatnonzero(pose == pose[k])} for k in sorted(first)]
    assert by_pose == [{"t1", "eyes"}, {"t2", "eyes"}] * 2
    assert len(table) == 4 * 2 * 2


def test_the_repeatability_of_one_arm_is_not_that_of_the_other():
    exact = simulate(Scenario("panda", TWO_PANDAS, noise=None), 200, 0, seed=1).measurements
    robot = replace(Scenario("panda", TWO_PANDAS).noise, constant=0.0, per_length=0.0)
    noisy = simulate(Scenario("panda", TWO_PANDAS, noise=robot), 200, 0, seed=1).measurements
    left, right = (noisy.points - exact.points).reshape(200, 2, 3).swapaxes(0, 1)
    assert rms(left.ravel()) == pytest.approx(20e-6, rel=0.15)
    assert abs(np.corrcoef(left.ravel(), right.ravel())[0, 1]) < 0.15


@pytest.fixture(scope="module")
def pictures():
    scenario = Scenario("panda", WRIST_AND_WALL, sigma={"px": 0.0}, noise=None)
    return scenario, simulate(scenario, 4, 0, seed=2)


def test_each_camera_shows_the_corners_of_its_boards(pictures):
    _, made = pictures
    table, truth, equipment = made.measurements, made.truth, made.pictures.equipment
    assert set(truth.sights) == {
        (0, 0),
        (1, 1),
    }  # a board that stands still before a camera is of no use
    assert set(zip(table.groups, table.targets, strict=True)) == {
        ("wrist", "table"),
        ("wall", "flange"),
    }
    assert all(
        image.startswith(f"{group}_")
        for image, group in zip(table.images, table.groups, strict=True)
    )
    found = np.column_stack([table.readings["u"], table.readings["v"]])
    for k, (group, target, corner) in enumerate(
        zip(table.groups, table.targets, table.corners, strict=True)
    ):
        camera = equipment.cameras[truth.groups.index(group)]
        point = equipment.prints[truth.targets.index(target)].corners[int(corner)]
        T = made.T_frame_target[k]
        fx, fy, cx, cy, *distortion = camera.values
        K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        expected, _ = cv2.projectPoints(
            point, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], K, np.array(distortion)
        )
        np.testing.assert_allclose(found[k], expected.ravel(), atol=1e-6)


def test_a_board_that_comes_into_view_is_found_whole_or_not_at_all(pictures):
    _, made = pictures
    counts = np.bincount(made.pictures.picture, minlength=len(made.pictures.images))
    assert set(counts) == {0, 12}
    assert np.all(counts[made.pictures.picture] == 12)


@pytest.mark.parametrize(
    ("distance", "tilt", "is_used"),
    [
        (0.5, 0.0, True),
        (0.5, 54.0, True),
        (0.5, 56.0, False),
        (0.16, 0.0, False),
        (4.0, 0.0, False),
    ],
)
def test_a_board_that_comes_into_view_slanted_or_cut_or_tiny_is_not_used(distance, tilt, is_used):
    board = Board(
        pattern="charuco", columns=7, rows=5, square=0.04, marker=0.03, dictionary="DICT_5X5_100"
    )
    scenario = Scenario(
        "panda", replace(WRIST_AND_WALL, boards={"": board}), sigma={"px": 0.0}, noise=None
    )
    virtual = scenario.draw(1)
    q = virtual.poses(2, 1)
    wanted = np.eye(4)
    wanted[:3, :3] = Rotation.from_euler("x", tilt, degrees=True).as_matrix()
    wanted[:3, 3] = np.array([0.0, 0.0, distance]) - wanted[:3, :3] @ board.centre
    truth = virtual.truth
    T_base_tip = truth.tip_poses(q[:1], chain=truth.sights[0, 0])[0]
    T_tip_target = truth.T_tip_target.copy()
    T_tip_target[0] = np.linalg.inv(truth.T_frame_base[0] @ T_base_tip) @ wanted
    moved = replace(virtual, truth=replace(truth, T_tip_target=T_tip_target))
    rows = moved.measure(q).measurements
    first = [image == "wrist_01.png" for image in rows.images]
    assert any(first) == is_used


def test_one_print_that_a_picture_shows_twice_is_said():
    """Two boards on one flange, of one description or of one each."""
    cell = Cell(
        kind="pixel",
        bases={"wall": "panda_link0"},
        tips=dict.fromkeys(("left", "right"), "panda_link8"),
        cameras={"wall": Camera(width=1280, height=720)},
        boards={"": BOARD},
    )
    made = simulate(Scenario("panda", cell), 8, 0, seed=1)
    assert shown_twice(made.pictures) == (0, 1)
    assert "--board left=left.toml" in simulated_text(Scenario("panda", cell), made)
    scenario = Scenario("panda", replace(cell, boards={"left": BOARD, "right": BOARD}))
    assert shown_twice(simulate(scenario, 8, 0, seed=1).pictures) == ()


def test_the_truth_file_names_camera_and_board_of_each_picture(pictures, tmp_path: Path):
    scenario, made = pictures
    said = json.loads(write_truth(scenario, made, tmp_path / "t.json").read_text())
    assert [camera["camera"] for camera in said["cameras"]] == ["wrist", "wall"]
    assert [board["board"] for board in said["boards"]] == ["table", "flange"]
    assert said["robot"]["chains"] == [
        {"base": "panda_link8", "tip": "panda_link0"},
        {"base": "panda_link0", "tip": "panda_link8"},
    ]
    shown = [picture for picture in said["pictures"] if picture["corners"]]
    assert {(p["group"], p["board"]) for p in shown} == {("wrist", "table"), ("wall", "flange")}
    names = {error["name"] for error in said["parameters"]}
    assert {"board_scale_x[table]", "board_sag_y[flange]"} <= names
    with pytest.raises(CalibError, match="2 and 2"):
        write_pictures(made, tmp_path / "pictures")
    text = " ".join(simulated_text(scenario, made).split())
    assert "flange seen by wall" in text
    assert "Camera 'wrist'" in text


def test_the_joints_of_pictures_name_the_camera(tmp_path: Path):
    cell = replace(
        WRIST_AND_WALL,
        bases={"wrist": "panda_link8"},
        tips={"table": "panda_link0"},
        cameras={"wrist": Camera(width=320, height=240)},
    )
    made = simulate(Scenario("panda", cell), 1, 0, seed=2)
    write_pictures(made, tmp_path)
    header, row = (tmp_path / "joints.csv").read_text().splitlines()
    assert header.startswith("image,group,panda_joint")
    assert row.startswith("wrist_01.png,wrist,")


def test_what_no_joint_moves_is_refused():
    cell = replace(WRIST_AND_WALL, tips={"flange": "panda_link8"}, bases={**WRIST_AND_WALL.bases})
    with pytest.raises(ModelError, match=r"'wrist' on 'panda_link8'"):
        Scenario("panda", cell).draw(0)


def test_a_true_urdf_of_both_hands_is_the_truth(tmp_path: Path):
    drawn = Scenario("tiago_dual", TIAGO).draw(5).truth
    drawn.write_urdf(tmp_path / "true.urdf")
    true = robot_of_cell(read_urdf(tmp_path / "true.urdf"), TIAGO)
    again = Scenario("tiago_dual", TIAGO, true_robot=true).draw(5).truth
    q = Scenario("tiago_dual", TIAGO).random_poses(3, 0)
    for target in ("left", "right"):
        np.testing.assert_allclose(again.points(q, target), drawn.points(q, target), atol=1e-9)
    assert again.value("arm_right_3_joint.rz") == pytest.approx(
        drawn.value("arm_right_3_joint.rz"), abs=2e-4
    )


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "cell"), [("tiago_dual", TIAGO), ("panda", TWO_PANDAS)])
def test_a_fit_of_simulated_hands_gives_a_better_robot_by_pinocchio(robot, cell, tmp_path: Path):
    made = simulate(Scenario(robot, cell), 40, 0, seed=11)
    result = calibrate(robot, made.measurements, cell=cell, validate=False)
    made.truth.write_urdf(tmp_path / "true.urdf")
    result.write_urdf(tmp_path / "found.urdf", accept=True)
    nominal = robot_of_cell(read_urdf(robot), with_robots_placed(cell)).urdf
    nominal.write(tmp_path / "nominal.urdf")
    models = {
        name: pin.buildModelFromUrdf(str(tmp_path / f"{name}.urdf"))
        for name in ("true", "found", "nominal")
    }
    names = made.measurements.joint_names
    q = Scenario(robot, cell).random_poses(50, 99)
    truth, setup = made.truth, result.setup
    left, right = truth.target_links
    errors = {}
    for name, T in (("found", setup.T_tip_target), ("nominal", truth.T_tip_target)):
        off = []
        for row in q:
            # From hand to hand, the frame does not count.
            between = [
                pin.SE3(P).inverse() * pose_in(model, names, row, left, right) * pin.SE3(Q)
                for model, (P, Q) in ((models[name], T), (models["true"], truth.T_tip_target))
            ]
            # Only the distance of two points is measured.
            found, true = (np.linalg.norm(pose.translation) for pose in between)
            off.append(found - true)
        errors[name] = rms(np.array(off))
    assert errors["nominal"] > 1.5e-3
    assert errors["found"] < 0.1e-3
