from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.calibration import calibrate
from calib.compensation.commands import (
    Commands,
    Finding,
    _poses_to_send,
    compensate,
    write_commands,
)
from calib.compensation.expected import expected_errors
from calib.compensation.inverse import Matching, Solved, solve
from calib.compensation.nominal_actual import Arm, pair_of
from calib.compensation.program import Program, read_program
from calib.errors import VerdictError
from calib.robot.ranges import column_limits, random_joint_values
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from tests.compensation.arms import off, turned
from tests.hard_cases import made, table

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
    q = result.measurements.joints_for(result.nominal.joint_names)
    wanted = result.predict_poses(q[:20], non_geometric=False)[:, :3, 3] + 1e-3
    found = compensate(result, Program.of_points(wanted, q[:20]), tool="", frame="")
    assert found.match == "position"
    assert found.reached.all()
    assert result.predict(found.q) == pytest.approx(wanted, abs=1e-9)
    assert np.isfinite(found.expected_errors).all()
    assert found.pair.result is result


def test_each_row_has_its_error_to_expect(tmp_path: Path):
    result = made("paper")
    q = np.vstack([result.ranges.mean(axis=1), random_joint_values(result.nominal, 2, 1)])
    wanted = result.robot.poses(q)
    wanted[1, :3, 3] = 2.0  # out of reach
    found = compensate(result, Program.of_poses(wanted, q))
    assert found.reached.tolist() == [True, False, True]
    alone = expected_errors(found.pair, found.q[[0, 2]])
    assert found.expected_errors[[0, 2]] == pytest.approx(alone.errors, rel=1e-9)
    assert np.isnan(found.expected_errors[1]).all()
    written = rows(write_commands(found, tmp_path / "c.csv"))
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
        cell=result.cell,
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
    starts = Solved(PANDA[None], *pair.nominal.motion(PANDA[None]))
    solved = solve(pair.actual, wanted, starts.q, matching)
    T_send, left = _poses_to_send(pair, wanted, starts, solved, matching)
    assert left[0, 0] < 1e-12
    # Its own choice of the elbow would have cost this much.
    naive = solve(pair.nominal, pair.nominal.poses(solved.q), starts.q, POSE)
    assert matching.misses(pair.actual.poses(naive.q), wanted)[0, 0] > 1e-10
    controlled = solve(pair.nominal, T_send, starts.q, POSE)
    assert matching.misses(true.poses(controlled.q), wanted)[0, 0] < 1e-12


JOINTS = [
    "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint",
]  # fmt: skip


@pytest.fixture(scope="module")
def true() -> Robot:
    """The paper's UR3 as it was found to be."""
    path = Path(__file__).parents[2] / "urdf" / "ur3_calibrated.urdf"
    return Robot.load(path, "base", "tool0")


@pytest.fixture(scope="module")
def four(ur3: Robot, true: Robot) -> Commands:
    """Of four rows: two plain, one with a pitch of 90 degrees, one out of reach."""
    q = np.radians(
        [[10, -80, 70, -60, -90, 5], [-20, -60, 80, -100, 60, 350], [0, -90, 90, 0, 90, 0]]
    )
    T = ur3.poses(q)
    T[2, :3, :3] = Rotation.from_euler("xyz", [0.3, np.pi / 2, 0.0]).as_matrix()
    poses = np.concatenate([T, T[:1]])
    poses[3, :3, 3] = [1.0, 1.0, 1.0]
    program = Program(
        labels=tuple(f"row {k}" for k in "abcd"),
        q=np.vstack([q, q[:1]]),
        T_wanted=poses,
        kept=(("name", ("a", "b", 'the "third"', "d, far")), ("speed [mm/s]", ("1", "2", "", "4"))),
    )
    found = compensate(true, program, nominal=ur3)
    assert found.reached.tolist() == [True, True, True, False]
    return found


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_what_stands_in_the_table(four: Commands, tmp_path: Path):
    table = rows(write_commands(four, tmp_path / "c.csv"))
    corrections = [f"correction {name} [deg]" for name in JOINTS]
    assert list(table[0]) == [
        "name", "speed [mm/s]", *(f"{name} [deg]" for name in JOINTS), "x [mm]", "y [mm]", "z [mm]",
        "rx [rad]", "ry [rad]", "rz [rad]", *corrections, "correction position [mm]", "correction angle [deg]",
        "status",
    ]  # fmt: skip
    assert [row["name"] for row in table] == ["a", "b", 'the "third"', "d, far"]
    assert [row["speed [mm/s]"] for row in table] == ["1", "2", "", "4"]
    for i, row in enumerate(table[:3]):
        joints = [float(row[f"{name} [deg]"]) for name in JOINTS]
        changes = [float(row[name]) for name in corrections]
        assert np.abs(np.radians(joints) - four.q[i]).max() < 1e-11
        assert np.abs(np.radians(changes) - four.joint_corrections[i]).max() < 1e-11
        moved = [
            float(row["correction position [mm]"]) / 1e3,
            np.radians(float(row["correction angle [deg]"])),
        ]
        assert np.abs(moved - four.pose_corrections[i]).max() < 1e-9
    assert table[0]["status"] == "ok"
    last = table[-1]
    assert (last.pop("name"), last.pop("speed [mm/s]")) == ("d, far", "4")
    assert last.pop("status") == "no command: unreachable"
    assert set(last.values()) == {""}


@pytest.mark.parametrize("form", ["rotation-vector", "quaternion", "rpy"])
def test_every_form_of_an_orientation_is_read_back(
    four: Commands, tmp_path: Path, ur3: Robot, form: str
):
    # Half turns, and a pitch of a right angle.
    R = Rotation.from_euler(
        "ZYX", [[0.3, np.pi / 2, 1e-9], [2.0, 0.0, np.pi], [1.0, -np.pi / 2, 0.0]]
    )
    T_send = four.T_send.copy()
    T_send[:3, :3, :3] = R.as_matrix()
    table = rows(write_commands(replace(four, T_send=T_send), tmp_path / "c.csv", orientation=form))
    path = tmp_path / "read.csv"
    with path.open("w", encoding="utf-8", newline="") as file:
        names = [name for name in table[0] if not name.startswith("correction")]
        writer = csv.DictWriter(file, names, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(table[:3])
    program = read_program(path, ur3)
    assert np.abs(program.T_wanted - T_send[:3]).max() < 1e-9
    assert np.abs(program.q - four.q[:3]).max() < 1e-11
    assert program.kept == tuple((label, cells[:3]) for label, cells in four.program.kept)


def test_zeros_have_no_sign_and_warnings_are_named(ur3: Robot, tmp_path: Path):
    near = np.radians([[10, -80, 70, -60, 0.2, 5]])
    row = rows(
        write_commands(compensate(ur3, Program.of_joints(near), nominal=ur3), tmp_path / "c.csv")
    )[0]
    assert {row[f"correction {name} [deg]"] for name in JOINTS} == {"0.000000000"}
    assert row["status"] == "warning: near singularity"


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


# Findings


#: Well inside the workspace, far from singularities [rad].
GOOD = np.radians([-20.0, -80.0, 60.0, -70.0, -90.0, 10.0])


def warned(found: Commands, code: str) -> list[Finding | None]:
    """For each row the warning of that code."""
    return [next((w for w in row if w.code == code), None) for row in found.warnings]


# Why there is no command


def with_limit(robot: Robot, joint: str, upper: float) -> Robot:
    """The robot with another upper limit of one joint."""
    text = robot.urdf.data.decode()
    start = text.index(f'<joint name="{joint}"')
    limit = text.index("<limit", start)
    end = text.index("/>", limit)
    narrow = f'<limit effort="1" lower="-6.2" upper="{upper!r}" velocity="1"'
    return Robot.from_urdf(
        Urdf.from_bytes((text[:limit] + narrow + text[end:]).encode(), "x.urdf"), "base", "tool0"
    )


def test_out_of_reach_says_how_far(ur3):
    true = off(ur3)
    far = ur3.poses(GOOD)[0]
    far[:3, 3] *= 3.0
    found = compensate(true, Program.of_poses([far, ur3.poses(GOOD)[0]], [GOOD, GOOD]), nominal=ur3)
    reason = found.reasons[0]
    distance = np.linalg.norm(far[:3, 3]) - np.linalg.norm(true.poses(GOOD)[0, :3, 3])
    assert reason.code == "unreachable"
    assert reason.numbers == pytest.approx(found.left[0])
    assert 0.0 < found.left[0, 0] < 2.0 * distance
    assert np.isnan([*found.q[0], *found.T_send[0].ravel(), *found.missed[0]]).all()
    # The other row is none the worse for it.
    assert found.reasons[1] is None
    assert found.left[1].max() < 1e-9


def test_what_is_left_may_be_accepted(ur3):
    far = ur3.poses(np.radians([[10.0, -90.0, 0.0, -90.0, 40.0, 0.0]]))[0]
    far[2, 3] += 0.02  # stretched upwards, and 20 mm more
    program = Program.of_poses(far, np.radians([10.0, -90.0, 3.0, -90.0, 40.0, 0.0]))
    program = replace(program, match="position")
    refused = compensate(off(ur3), program, nominal=ur3)
    assert not refused.reached.any()
    taken = compensate(off(ur3), program, nominal=ur3, tolerance=(2.0 * refused.left[0, 0], 1.0))
    assert taken.reached.all()
    assert taken.left[0, 0] == refused.left[0, 0]
    assert np.isnan(taken.q_nominal).all()
    assert np.isfinite(taken.T_send).all()


def test_a_limit_that_would_be_passed_is_named(ur3, serial_urdf):
    free = compensate(off(ur3), Program.of_joints(GOOD), nominal=ur3).q[0]
    assert free[2] > GOOD[2]
    limit = float((free[2] + GOOD[2]) / 2.0)
    narrow = with_limit(ur3, "elbow_joint", limit)
    (reason,) = compensate(off(narrow), Program.of_joints(GOOD), nominal=narrow).reasons
    assert (reason.code, reason.joint) == ("beyond limit", "elbow_joint")
    assert reason.numbers == pytest.approx((free[2], limit))
    axes = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    robot = Robot.from_urdf(
        serial_urdf([("prismatic", (0, 0, 0.1), (0, 0, 0), axis) for axis in axes])
    )
    program = Program.of_points([3.11, 0.0, 0.5])
    (reason,) = compensate(off(robot), program, nominal=robot).reasons
    assert (reason.code, reason.joint, reason.numbers[1]) == ("beyond limit", "j1", 3.0)


@pytest.mark.slow
def test_a_solution_in_another_branch_is_none(ur3):
    # Across the wrist's singularity: the true robot's lies on its other side.
    q = np.tile(GOOD, (120, 1))
    q[:, 4] = np.linspace(-0.03, 0.03, 120)
    found = compensate(off(ur3), Program.of_joints(q), nominal=ur3)
    sides = np.sign(found.q[:, 4]) == np.sign(q[:, 4])
    assert sides[found.reached].mean() > 0.95
    assert {reason.code for reason in found.reasons if reason} <= {"other branch", "unreachable"}
    assert not found.reached.all()


# What to know of a command


def test_near_a_singularity_is_said(ur3):
    q = np.tile(GOOD, (30, 1))
    q[:, 4] = np.linspace(0.005, 0.6, 30)
    found = compensate(off(ur3), Program.of_joints(q), nominal=ur3)
    said = warned(found, "near singularity")
    assert found.reached[2:].all()
    # One side is near, the other is not, and what is said is what happens: a millimetre takes so many degrees.
    assert said[2]
    assert not any(said[10:])
    # By differences: where the tool is sent a millimetre further, in the worst direction.
    motion = Arm.of(off(ur3), np.eye(4)).motion(found.q[2:3])[1][0]
    directions = np.random.default_rng(0).normal(size=(6, 20000))
    directions[3:] = 0.0
    directions /= np.linalg.norm(directions, axis=0)
    worst = np.abs(np.linalg.solve(motion, 1e-3 * directions)).max()
    assert said[2].numbers[0] == pytest.approx(worst, rel=0.02)


def test_large_corrections_are_said(ur3):
    q = np.tile(GOOD, (40, 1))
    q[:, 4] = np.linspace(0.02, 1.0, 40)
    found = compensate(off(ur3, size=2.0), Program.of_joints(q), nominal=ur3)
    words, corrections = warned(found, "large joint correction"), np.abs(found.joint_corrections)
    large = np.nan_to_num(corrections).max(axis=1) > np.radians(5.0)
    assert [bool(w) for w in words] == (found.reached & large).tolist()
    row = next(i for i, w in enumerate(words) if w)
    assert words[row].joint == ur3.joint_names[int(corrections[row].argmax())]
    assert words[row].numbers[0] == corrections[row].max()
    moved = found.pose_corrections
    far = found.reached & ((moved[:, 0] > 0.01) | (moved[:, 1] > np.radians(2.0)))
    assert [bool(w) for w in warned(found, "large pose correction")] == far.tolist()


def test_outside_of_what_was_measured_is_said(ur3):
    middle = made("paper").ranges.mean(axis=1)
    middle[4] += 0.5
    beyond = middle.copy()
    beyond[2] = made("paper").ranges[2, 1] + 0.5
    found = compensate(made("paper"), Program.of_joints([middle, beyond]), nominal=ur3)
    inside, outside = warned(found, "outside measured range")
    assert inside is None
    assert outside.joint == "elbow_joint"


def test_an_arm_that_turns_over_between_poses_is_said(ur3):
    # The tool turns about its own axis, further than the last joint can: it has to start over from the other side.
    turns = np.tile(GOOD, (50, 1))
    turns[:, 5] = np.linspace(0.0, 2.6 * np.pi, 50)
    start = dict(zip(ur3.joint_names, GOOD, strict=True))
    program = replace(Program.of_poses(ur3.poses(turns)), start=start)
    found = compensate(off(ur3), program, nominal=ur3)
    words = warned(found, "jump")
    steps = np.abs(np.diff(found.q, axis=0)).max(axis=1)
    assert [bool(w) for w in words] == [False, *(steps > 0.5)]
    assert sum(map(bool, words)) == 1


def test_a_jump_is_said_also_across_rows_without_a_command(ur3):
    # The elbow goes through straight, where the true arm has to jump.
    q = np.tile(np.radians([-20.0, -100.0, 0.0, -80.0, -60.0, 0.0]), (81, 1))
    q[:, 2] = np.radians(np.linspace(-3.0, 3.0, 81))
    poses = ur3.poses(q)
    poses[34:42, :3, 3] += 5.0
    found = compensate(off(ur3, seed=2), Program.of_poses(poses, q), nominal=ur3)
    assert np.flatnonzero(~found.reached).tolist() == list(range(34, 42))
    (word,) = (w for w in warned(found, "jump") if w)
    moved = np.abs(found.q[42] - found.q[33]).max()
    assert warned(found, "jump")[42] == ("jump", (moved,), "elbow_joint", "row 34")
    assert word.numbers[0] > np.radians(10.0)


def test_commands_are_not_made_by_what_is_not_to_be_used(ur3):
    stated = off(ur3)
    stated = replace(stated, urdf=stated.urdf.with_verdict("do not use (no_better): Worse."))
    program = Program.of_joints(GOOD)
    with pytest.raises(VerdictError, match=r"no_better\): Worse\..*accept=True"):
        compensate(stated, program, nominal=ur3)
    accepted = compensate(stated, program, nominal=ur3, accept=True)
    np.testing.assert_array_equal(accepted.q, compensate(off(ur3), program, nominal=ur3).q)
