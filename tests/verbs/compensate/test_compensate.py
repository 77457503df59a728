from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.data.measurements import Measurements
from calib.errors import VerdictError
from calib.numerics.moves import last_moves
from calib.result.calibrate import calibrate
from calib.robot.ranges import column_limits, random_joint_values
from calib.robot.robot import Robot
from calib.verbs.compensate.compensate import _find_poses_to_send, compensate
from calib.verbs.compensate.expected import expected_errors
from calib.verbs.compensate.inverse import Matching, solve
from calib.verbs.compensate.nominal_actual import Arm, pair_of
from calib.verbs.compensate.program_table import write_commands
from calib.verbs.compensate.robot_program import Program
from tests.hard_cases import made, table
from tests.verbs.compensate.arms import off, turned

POSE = Matching("pose", 0.01)

START = np.radians([-20.0, -80.0, 60.0, -70.0, -90.0, 10.0])


def controller(
    nominal: Robot, T_send: np.ndarray, near: np.ndarray, tool: np.ndarray
) -> np.ndarray:
    """What a controller with the nominal model makes of poses: its own inverse kinematics."""
    return solve(Arm.of(nominal, tool), T_send, near, POSE, column_limits(nominal)).q


@pytest.mark.parametrize("name", ["ur3", pytest.param("panda", marks=pytest.mark.slow)])
def test_the_true_robot_arrives_by_joints_and_by_poses(name, request):
    nominal = request.getfixturevalue(name)
    true, tool = off(nominal), turned(5, 0.2)
    q = random_joint_values(nominal, 80, 8)
    found = compensate(true, Program.of_joints(q), nominal=nominal, tool=tool)
    wanted = nominal.poses(q) @ tool
    assert found.T_wanted == pytest.approx(wanted, abs=1e-12)
    reached = found.reached
    assert reached.mean() > 0.8
    arrived = true.poses(found.q[reached]) @ tool
    assert POSE.misses(arrived, wanted[reached]).max() < 1e-9
    # Every row without a command says why.
    assert [reason is not None for reason in found.reasons] == (~reached).tolist()
    # The same by the controller's own inverse kinematics, unless a row says that it may come out elsewhere.
    astray = np.array([any(w.code == "ambiguous pose" for w in said) for said in found.warnings])
    plain = reached & ~astray
    assert astray.sum() < 0.05 * len(q)
    sent = controller(nominal, found.T_send[plain], found.q_nominal[plain], tool)
    # A controller that weighs angles otherwise puts a redundant joint elsewhere.
    exact = 1e-9 if name == "ur3" else 1e-7
    assert POSE.misses(true.poses(sent) @ tool, wanted[plain]).max() < exact
    assert found.left_by_pose[plain].max() < 1e-9
    if name == "ur3":  # without a redundant joint both modes are one command
        assert found.T_send[plain] == pytest.approx(nominal.poses(found.q[plain]) @ tool, abs=1e-12)
    before = POSE.misses(true.poses(q) @ tool, wanted)
    assert found.missed[reached] == pytest.approx(before[reached], abs=1e-12)
    assert found.left[reached].max() < 1e-9


@pytest.mark.parametrize("case", ["non_geometric", "poses"])
def test_a_result_predicts_that_its_commands_arrive(case):
    result = made(case)
    q = result.fit.measurements.joints_for(result.nominal.joint_names)
    wanted = result.predict_poses(q[:20], non_geometric=False)[:, :3, 3] + 1e-3
    found = compensate(result, Program.of_points(wanted, q[:20]), tool="", frame="")
    assert found.match == "position"
    assert found.reached.all()
    assert result.predict(found.q) == pytest.approx(wanted, abs=1e-9)
    assert np.isfinite(found.expected_errors).all()
    assert found.pair.result is result


def test_each_row_has_its_error_to_expect(tmp_path: Path):
    result = made("paper")
    q = np.vstack([result.rows.ranges.mean(axis=1), random_joint_values(result.nominal, 2, 1)])
    wanted = result.robot.poses(q)
    wanted[1, :3, 3] = 2.0  # out of reach
    found = compensate(result, Program.of_poses(wanted, q))
    assert found.reached.tolist() == [True, False, True]
    alone = expected_errors(found.pair, found.q[[0, 2]])
    assert found.expected_errors[[0, 2]] == pytest.approx(alone.errors, rel=1e-9)
    assert np.isnan(found.expected_errors[1]).all()
    path = write_commands(found, tmp_path / "c.csv")
    with path.open(encoding="utf-8", newline="") as file:
        written = list(csv.DictReader(file))
    assert list(written[0])[-2:] == ["expected error [mm]", "status"]
    cells = [row["expected error [mm]"] for row in written]
    assert cells[1] == ""
    assert [float(cells[0]), float(cells[2])] == pytest.approx(1e3 * alone.errors[:, 0], abs=1e-6)


def test_of_two_robots_no_error_is_known(ur3: Robot):
    found = compensate(off(ur3), Program.of_joints(START), nominal=ur3)
    assert found.expected is None
    assert np.isnan(found.expected_errors).all()


def test_paper_rows_that_the_fit_did_not_see():
    """Commands for the measured points of rows 31 to 35, judged by a model that was fitted to all 35 rows."""
    result, robot = made("paper"), made("paper").nominal
    rows = table(robot)
    everything = calibrate(
        robot,
        replace(rows, sets=("estimate",) * len(rows)),
        cell=result.fit.cell,
        validate=False,
    )
    held_back = rows.validation
    points, q = rows.points[held_back], rows.joints_for(robot.joint_names)[held_back]
    found = compensate(result, Program.of_points(points, q), tool="", frame="")

    def mean_mm(values: np.ndarray) -> float:
        return float(1e3 * np.linalg.norm(everything.predict(values) - points, axis=1).mean())

    assert found.reached.all()
    assert mean_mm(found.q_nominal) == pytest.approx(2.545, abs=0.01)
    assert mean_mm(found.q) < 0.15


def test_the_frame_of_the_poses(ur3):
    true, T = off(ur3), turned(7)
    poses = ur3.poses(START)
    in_base = compensate(true, Program.of_poses(poses, START), nominal=ur3)
    in_frame = compensate(true, Program.of_poses(T @ poses, START), nominal=ur3, frame=T)
    assert in_frame.q == pytest.approx(in_base.q, abs=1e-10)
    assert in_frame.T_send == pytest.approx(T @ in_base.T_send, abs=1e-10)
    assert in_frame.pose_corrections == pytest.approx(in_base.pose_corrections, abs=1e-10)


#: Well inside the Panda's workspace [rad].
PANDA = np.array([0.3, -0.4, 0.2, -1.9, 0.4, 1.7, 0.5])


@pytest.mark.parametrize("match", ["pose", "axis", "position"])
def test_a_redundant_arm_arrives_with_the_elbow_where_the_controller_puts_it(panda, match):
    true, matching = off(panda), Matching(match, 0.01)
    pair = pair_of(true, panda)
    wanted = panda.poses(PANDA)
    solved = solve(pair.actual, wanted, PANDA[None], matching)
    T_send, left = _find_poses_to_send(pair, matching, wanted, PANDA[None], solved.q)
    assert left[0, 0] < 1e-12
    # Its own choice of the elbow would have cost this much.
    naive = solve(pair.nominal, pair.nominal.poses(solved.q), PANDA[None], POSE)
    assert matching.misses(pair.actual.poses(naive.q), wanted)[0, 0] > 1e-10
    controlled = solve(pair.nominal, T_send, PANDA[None], POSE)
    assert matching.misses(true.poses(controlled.q), wanted)[0, 0] < 1e-12


@pytest.mark.parametrize("match", ["pose", "axis", "position"])
def test_a_motion_by_an_error_takes_it_away(match):
    matching = Matching(match, 0.4)
    T_now, T_wanted = turned(1, 0.01)[None], turned(2, 0.01)[None]
    moved = T_now @ matching.motions(matching.error(T_now, T_wanted))
    before, after = (np.abs(matching.error(T, T_wanted)).max() for T in (T_now, moved))
    assert after < 0.05 * before


def test_what_is_matched_where_nothing_is_said(serial_urdf):
    turning = [
        ("revolute", (0.1, 0.02, 0.2), (0, 0, 0), axis) for axis in ((0, 0, 1), (0, 1, 0)) * 3
    ]
    for count, match in ((3, "position"), (4, "position"), (5, "axis"), (6, "pose")):
        robot = Robot.from_urdf(serial_urdf(turning[:count], ((0.1, 0.0, 0.05), (0.0, 0.0, 0.0))))
        program = Program.of_joints(np.linspace(0.2, 0.9, count))
        found = compensate(off(robot), program, nominal=robot)
        assert found.match == match
        assert found.reached.all()


@pytest.mark.parametrize("match", ["axis", "position"])
def test_what_is_left_free_stays_as_the_program_has_it(ur3, match):
    """The nominal robot takes the full pose, from joint values near it, though the true one need not."""
    wanted = ur3.poses(START)
    program = replace(Program.of_poses(wanted, START + 0.1), match=match)
    found = compensate(off(ur3), program, nominal=ur3)
    assert found.match == match
    assert POSE.misses(ur3.poses(found.q_nominal), wanted).max() < 1e-9
    assert POSE.misses(off(ur3).poses(found.q), wanted).max() > 1e-4


def test_a_full_pose_out_of_reach_is_matched_in_part(ur3):
    """The arm is nearly stretched out, and its tool turned over: only the position can be had."""
    q = np.array([np.radians([10.0, -60.0, 8.0, -60.0, 40.0, 0.0]), START])
    wanted = ur3.poses(q)
    wanted[0, :3, :3] = wanted[0, :3, :3] @ np.diag([1.0, -1.0, -1.0])
    program = Program.of_poses(wanted, q)
    assert compensate(off(ur3), program, nominal=ur3).reached.tolist() == [False, True]
    found = compensate(off(ur3), replace(program, match="position"), nominal=ur3)
    assert found.reached.all()
    arrived = ur3.poses(found.q_nominal)
    assert arrived[:, :3, 3] == pytest.approx(wanted[:, :3, 3], abs=1e-9)
    # The pose that can be had in full stays as it was.
    assert arrived[1] == pytest.approx(wanted[1], abs=1e-9)


def test_a_program_of_points_leaves_the_nominal_robot_as_it_is_turned(ur3):
    points = ur3.poses(START + 0.01)[:, :3, 3]
    found = compensate(off(ur3), Program.of_points(points, START), nominal=ur3)
    assert np.abs(found.q_nominal - START).max() < 0.02
    arrived = ur3.poses(found.q_nominal)
    assert arrived[:, :3, 3] == pytest.approx(points, abs=1e-9)
    # A pose to send has the orientation that the nominal robot has there.
    assert found.T_wanted == pytest.approx(arrived, abs=1e-9)


def test_commands_are_not_made_by_what_is_not_to_be_used(ur3):
    stated = off(ur3)
    stated = replace(
        stated, urdf=stated.urdf.with_comments(run="", verdict="do not use (no_better): Worse.")
    )
    program = Program.of_joints(START)
    with pytest.raises(VerdictError, match=r"no_better\): Worse\..*accept=True"):
        compensate(stated, program, nominal=ur3)
    accepted = compensate(stated, program, nominal=ur3, accept=True)
    np.testing.assert_array_equal(accepted.q, compensate(off(ur3), program, nominal=ur3).q)


def test_a_program_is_corrected_with_its_own_approach(ur3):
    """The joints stop a milliradian short, coming from row to row; the first row has no approach that is known."""
    short = 1e-3
    q = random_joint_values(ur3, 40, 3)
    T = ur3.poses(q - short * np.sign(last_moves(q)))
    points = T[:, :3, :3] @ [0.05, 0.02, 0.1] + T[:, :3, 3]
    m = Measurements(
        ur3.joint_names, q, points + 2e-5 * np.random.default_rng(3).normal(size=(40, 3))
    )
    result = calibrate(ur3, m, model="zeros+lost_motion", validate=False)
    program = Program.of_joints(random_joint_values(ur3, 30, 8))
    found = compensate(result, program, tool="")
    assert found.reached.all()

    def misses(commands: np.ndarray) -> np.ndarray:
        T = ur3.poses(commands - short * np.sign(last_moves(commands)))
        arrived = T[:, :3, :3] @ [0.05, 0.02, 0.1] + T[:, :3, 3]
        return np.linalg.norm(arrived - found.T_wanted[:, :3, 3], axis=1)

    assert misses(found.q)[1:].max() < 0.15 * misses(program.q)[1:].max()
    # In another order the rows get other commands.
    backwards = compensate(result, Program.of_joints(program.q[::-1]), tool="")
    assert np.abs(backwards.q[::-1] - found.q).max() > short
