from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.calibration import calibrate
from calib.compensate.commands import commands
from calib.compensate.inverse import Matching, solve
from calib.compensate.nominal_actual import Arm
from calib.compensate.program import Program
from calib.errors import ModelError
from calib.measure.ranges import column_limits
from calib.model.readback import random_joint_values
from calib.model.robot import Robot
from tests.compensate.arms import off, turned
from tests.show.calibrations import made, table

POSE = Matching("pose", 0.01)

START = np.radians([-20.0, -80.0, 60.0, -70.0, -90.0, 10.0])


def controller(
    nominal: Robot, T_send: np.ndarray, near: np.ndarray, tool: np.ndarray
) -> np.ndarray:
    """What a controller with the nominal model makes of poses: its own inverse kinematics."""
    return solve(Arm.of(nominal, tool), T_send, near, POSE, column_limits(nominal)).q


@pytest.mark.parametrize("name", ["ur3", "panda"])
def test_the_true_robot_arrives_by_joints_and_by_poses(name, request):
    nominal = request.getfixturevalue(name)
    true, tool = off(nominal), turned(5, 0.2)
    q = random_joint_values(nominal, 300, 8)
    found = commands(true, Program.of_joints(q), nominal=nominal, tool=tool)
    wanted = nominal.poses(q) @ tool
    assert found.T_wanted == pytest.approx(wanted, abs=1e-12)
    reached = found.reached
    assert reached.mean() > 0.8
    arrived = true.poses(found.q[reached]) @ tool
    assert POSE.misses(arrived, wanted[reached]).max() < 1e-9
    # Every row without a command says why.
    assert [bool(reason) for reason in found.reasons] == (~reached).tolist()
    # The same by the controller's own inverse kinematics, unless a row says that it may come out elsewhere.
    astray = np.array([any("sent as a pose" in w for w in said) for said in found.warnings])
    plain = reached & ~astray
    assert astray.sum() < 0.05 * len(q)
    sent = controller(nominal, found.T_send[plain], found.q_nominal[plain], tool)
    assert POSE.misses(true.poses(sent) @ tool, wanted[plain]).max() < 1e-9
    assert found.left_by_pose[plain].max() < 1e-9
    if name == "ur3":  # without a redundant joint both modes are one command
        assert found.T_send[plain] == pytest.approx(nominal.poses(found.q[plain]) @ tool, abs=1e-12)
    before = POSE.misses(true.poses(q) @ tool, wanted)
    assert found.missed[reached] == pytest.approx(before[reached], abs=1e-12)
    assert found.left[reached].max() < 1e-9


@pytest.mark.parametrize("case", ["larger", "poses"])
def test_a_result_predicts_that_its_commands_arrive(case):
    result = made(case)
    q = result.measurements.joints_for(result.nominal.joint_names)
    wanted = result.predict_poses(q[:20], larger=False)[:, :3, 3] + 1e-3
    found = commands(result, Program.of_points(wanted, q[:20]), tool="", frame="")
    assert found.match == "position"
    assert found.reached.all()
    assert result.predict(found.q) == pytest.approx(wanted, abs=1e-9)
    assert np.isfinite(found.std).all()
    assert found.result is result


def test_paper_rows_that_the_fit_did_not_see():
    """Commands for the measured points of rows 31 to 35, judged by a model that was fitted to all 35 rows."""
    result, robot = made("paper"), made("paper").nominal
    rows = table(robot)
    everything = calibrate(
        robot,
        replace(rows, sets=("estimate",) * len(rows)),
        cell=result.cell,
        validate=False,
    )
    held_back = rows.validation
    points, q = rows.points[held_back], rows.joints_for(robot.joint_names)[held_back]
    found = commands(result, Program.of_points(points, q), tool="", frame="")

    def mean_mm(values: np.ndarray) -> float:
        return float(1e3 * np.linalg.norm(everything.predict(values) - points, axis=1).mean())

    assert found.reached.all()
    assert mean_mm(found.q_nominal) == pytest.approx(2.545, abs=0.01)
    assert mean_mm(found.q) < 0.15


def test_a_straight_path_stays_smooth(ur3):
    path = np.tile(ur3.poses(START)[0], (2000, 1, 1))
    path[:, :3, 3] += np.linspace(0.0, 1.0, 2000)[:, None] * [0.1, 0.15, -0.05]
    start = dict(zip(ur3.joint_names, START, strict=True))
    found = commands(off(ur3), Program.of_poses(path), nominal=ur3, start=start)
    assert found.reached.all()
    nominal = np.abs(np.diff(found.q_nominal, axis=0)).max()
    assert np.abs(np.diff(found.q, axis=0)).max() < 1.1 * nominal
    sent = np.linalg.norm(np.diff(found.T_send[:, :3, 3], axis=0), axis=1)
    assert sent.max() < 1.1 * np.linalg.norm(path[1, :3, 3] - path[0, :3, 3])


def test_the_frame_of_the_poses(ur3):
    true, T = off(ur3), turned(7)
    poses = ur3.poses(START)
    in_base = commands(true, Program.of_poses(poses, START), nominal=ur3)
    in_frame = commands(true, Program.of_poses(T @ poses, START), nominal=ur3, frame=T)
    assert in_frame.q == pytest.approx(in_base.q, abs=1e-10)
    assert in_frame.T_send == pytest.approx(T @ in_base.T_send, abs=1e-10)
    assert in_frame.pose_corrections == pytest.approx(in_base.pose_corrections, abs=1e-10)


def test_joint_values_beside_poses_say_where_to_start(ur3):
    wanted = ur3.poses(START)
    other = START - [0, 0, 0, 0, 0, 2.0 * np.pi]
    found = commands(off(ur3), Program.of_poses(wanted, other), nominal=ur3)
    assert found.q_nominal == pytest.approx(other[None], abs=1e-9)
    assert np.abs(found.joint_corrections).max() < 0.1


def test_of_points_the_pose_to_send_is_turned_as_the_nominal_robot_is(ur3):
    found = commands(off(ur3), Program.of_points(ur3.poses(START)[:, :3, 3], START), nominal=ur3)
    assert found.T_wanted == pytest.approx(ur3.poses(START), abs=1e-9)
    assert np.isnan(found.missed[0, 1])
    assert found.pose_corrections[0, 1] < 0.05


def test_fewer_joints_are_weighted():
    result = made("two_joints")
    q = 0.5 * random_joint_values(result.nominal, 5)
    found = commands(result, Program.of_joints(q))
    assert found.match == "weighted"
    assert found.reached.all()
    assert (found.left[:, 0] <= found.missed[:, 0] + 1e-12).all()


def test_a_robot_that_is_right_needs_no_correction(ur3):
    found = commands(ur3, Program.of_joints(START), nominal=ur3)
    assert np.abs(found.joint_corrections).max() < 1e-12
    assert found.pose_corrections.max() < 1e-12


@pytest.mark.parametrize(
    ("program", "arguments", "said"),
    [
        (Program.of_joints(np.zeros(7)), {}, r"has 7 joint values in each row; .* has 6 joints"),
        (Program.of_points(np.ones(3)), {"match": "pose"}, "not how it is turned, so that 'pose'"),
        (
            Program.of_joints(START),
            {"start": {"elbow_joint": 0.1}},
            "a start for the first row has no use",
        ),
        (Program.of_joints(START), {"match": "poses"}, "choose one of 'pose'"),
        (Program.of_joints(START), {"lever": 0.0}, "length greater than 0"),
        (Program.of_poses(np.eye(4)), {"start": {"elbow": 0.1}}, "no joints 'elbow'"),
    ],
)
def test_what_does_not_fit_is_refused(ur3, program, arguments, said):
    with pytest.raises(ModelError, match=said):
        commands(off(ur3), program, nominal=ur3, **arguments)
