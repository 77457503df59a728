"""Reasons why a row has no command, and warnings: each on an arm made for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.verbs.compensate.commands import Commands, CommandWarning
from calib.verbs.compensate.compensate import compensate
from calib.verbs.compensate.inverse import Matching
from calib.verbs.compensate.nominal_actual import Arm
from calib.verbs.compensate.robot_program import Program
from calib.verbs.compensate.warnings import find_warnings
from tests.hard_cases import made
from tests.verbs.compensate.arms import off

POSE = Matching("pose", 0.01)

#: Well inside the workspace, far from singularities [rad].
GOOD = np.radians([-20.0, -80.0, 60.0, -70.0, -90.0, 10.0])


def warned(found: Commands, code: str) -> list[CommandWarning | None]:
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
    middle = made("paper").rows.ranges.mean(axis=1)
    middle[4] += 0.5
    beyond = middle.copy()
    beyond[2] = made("paper").rows.ranges[2, 1] + 0.5
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


def test_a_pose_that_misses_more_than_its_joint_values_is_ambiguous(ur3):
    poses = ur3.poses([GOOD] * 3)
    poses[0, :3, 3] = 5.0  # without a command
    found = compensate(off(ur3), Program.of_poses(poses, [GOOD] * 3), nominal=ur3)
    by_pose, left = found.left_by_pose.copy(), found.left.copy()
    by_pose[1] += 1e-4
    left[2] += 1e-4
    changed = replace(found, left_by_pose=by_pose, left=left)
    changed = replace(changed, warnings=find_warnings(changed, (1e-8, 1e-8)))
    none, word, nothing = warned(changed, "ambiguous pose")
    assert word.numbers == pytest.approx(by_pose[1])
    assert none is nothing is None
