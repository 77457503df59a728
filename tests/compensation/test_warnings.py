from __future__ import annotations

import re

import numpy as np
import pytest

from calib.compensation.commands import commands
from calib.compensation.nominal_actual import Arm
from calib.compensation.program import Program
from calib.errors import ModelError
from calib.robot.readback import random_joint_values
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from tests.compensation.arms import off
from tests.hard_cases import made

#: Well inside the workspace, far from singularities [rad].
GOOD = np.radians([-20.0, -80.0, 60.0, -70.0, -90.0, 10.0])


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
    found = commands(true, Program.of_poses([far, ur3.poses(GOOD)[0]], [GOOD, GOOD]), nominal=ur3)
    assert found.reasons[0].startswith("the true robot cannot reach it: ")
    distance = np.linalg.norm(far[:3, 3]) - np.linalg.norm(true.poses(GOOD)[0, :3, 3])
    left = float(found.reasons[0].split(": ")[1].split(" mm")[0])
    assert left == pytest.approx(1e3 * found.left[0, 0], abs=1e-4)
    assert 0.0 < found.left[0, 0] < 2.0 * distance
    assert np.isnan(found.q[0]).all()
    assert np.isnan(found.T_send[0]).all()
    assert np.isnan(found.missed[0]).all()
    # The other row is none the worse for it.
    assert found.reasons[1] == ""
    assert found.left[1].max() < 1e-9


def test_what_is_left_may_be_accepted(ur3):
    far = ur3.poses(np.radians([[10.0, -90.0, 0.0, -90.0, 40.0, 0.0]]))[0]
    far[2, 3] += 0.02  # stretched upwards, and 20 mm more
    program = Program.of_poses(far, np.radians([10.0, -90.0, 3.0, -90.0, 40.0, 0.0]))
    refused = commands(off(ur3), program, nominal=ur3, match="position")
    assert not refused.reached.any()
    enough = (2.0 * refused.left[0, 0], 1.0)
    taken = commands(off(ur3), program, nominal=ur3, match="position", accept=enough)
    assert taken.reached.all()
    assert taken.left[0, 0] == refused.left[0, 0]
    assert "nominal" in [w.code for w in taken.warnings[0]]
    assert np.isnan(taken.q_nominal).all()
    assert np.isfinite(taken.T_send).all()


def test_a_limit_that_would_be_passed_is_named(ur3):
    free = commands(off(ur3), Program.of_joints(GOOD), nominal=ur3).q[0]
    narrow = with_limit(ur3, "elbow_joint", float((free[2] + GOOD[2]) / 2.0))
    if free[2] < GOOD[2]:
        pytest.fail("the seed moves the elbow the other way: choose another one")
    found = commands(off(narrow), Program.of_joints(GOOD), nominal=narrow)
    said = found.reasons[0]
    assert said.startswith(
        f"'elbow_joint' would have to be at {np.degrees(free[2]):.4f} deg, beyond"
    )
    assert said.endswith(f"{np.degrees((free[2] + GOOD[2]) / 2.0):.4f}")


def test_a_program_beyond_a_limit_is_told_so(ur3):
    beyond = GOOD + np.radians([0.0, 0.0, 0.0, 0.0, 0.0, 400.0])
    found = commands(off(ur3), Program.of_joints(beyond), nominal=ur3)
    assert found.reasons[0].endswith(
        "beyond its limit 360.0000; without correction it is beyond it too, at 410.0000"
    )


def test_a_sliding_joint_is_told_in_millimetres(serial_urdf):
    robot = Robot.from_urdf(
        serial_urdf(
            [
                ("prismatic", (0, 0, 0.3), (0, 0, 0), (1, 0, 0)),
                ("prismatic", (0, 0, 0.1), (0, 0, 0), (0, 1, 0)),
                ("prismatic", (0, 0, 0.1), (0, 0, 0), (0, 0, 1)),
            ]
        )
    )
    found = commands(off(robot), Program.of_points([0.1 + 3.01, 0.0, 0.5]), nominal=robot)
    assert "'j1' would have to be at 301" in found.reasons[0]
    assert "mm, beyond its limit 3000.0000; without" in found.reasons[0]


def test_near_a_singularity_is_said(ur3):
    q = np.tile(GOOD, (30, 1))
    q[:, 4] = np.linspace(0.005, 0.6, 30)
    found = commands(off(ur3), Program.of_joints(q), nominal=ur3)
    said = np.array([any(w.code == "singular" for w in one) for one in found.warnings])
    assert found.reached[2:].all()
    # One side is near, the other is not, and what is said is what happens: a millimetre takes so many degrees.
    assert said[2]
    assert not said[10:].any()
    (warning,) = (str(w) for w in found.warnings[2] if w.code == "singular")
    by_length, by_angle = re.findall(
        r"may take ([\d.]+) deg of 'wrist|it ([\d.]+) deg of 'wrist", warning
    )
    # By differences: where the tool is sent a millimetre further, in the worst direction, and turned.
    true = Arm.of(off(ur3), np.eye(4))
    _, before = Arm.of(ur3, np.eye(4)).motion(q[2:3])
    _, after = true.motion(found.q[2:3])
    rng = np.random.default_rng(0)
    for said_degrees, unit, part in ((by_length[0], 1e-3, 0), (by_angle[1], np.radians(0.1), 3)):
        worst = 0.0
        for twists in (before, after):
            directions = rng.normal(size=(6, 20000))
            directions[3 - part : 6 - part] = 0.0
            directions /= np.linalg.norm(directions, axis=0)
            worst = max(worst, np.abs(np.linalg.solve(twists[0], unit * directions)).max())
        assert float(said_degrees) == pytest.approx(np.degrees(worst), rel=0.02)


@pytest.mark.slow
def test_a_solution_in_another_branch_is_none(ur3):
    # Across the wrist's singularity: the true robot's lies on its other side.
    q = np.tile(GOOD, (120, 1))
    q[:, 4] = np.linspace(-0.03, 0.03, 120)
    found = commands(off(ur3), Program.of_joints(q), nominal=ur3)
    sides = np.sign(found.q[:, 4]) == np.sign(q[:, 4])
    assert sides[found.reached].mean() > 0.95
    refused = [reason for reason in found.reasons if reason]
    assert refused
    assert {reason.split(":")[0] for reason in refused} <= {
        "next to a singularity",
        "the true robot cannot reach it",
    }


def test_large_corrections_are_said(ur3):
    found = commands(off(ur3), Program.of_joints(GOOD), nominal=ur3, limit=(1e-4, np.radians(0.01)))
    moved, turned = found.pose_corrections[0]
    assert tuple(map(str, found.warnings[0])) == (
        f"the pose moves by {1e3 * moved:.2f} mm, more than 0.1 mm",
        f"the pose turns by {np.degrees(turned):.2f} deg, more than 0.01 deg",
    )


def test_outside_of_what_was_measured_is_said(ur3):
    middle = made("paper").ranges.mean(axis=1)
    middle[4] += 0.5
    beyond = middle.copy()
    beyond[2] = made("paper").ranges[2, 1] + 0.5
    found = commands(made("paper"), Program.of_joints([middle, beyond]), nominal=ur3)
    assert not any(w.code == "outside" for w in found.warnings[0])
    assert any(
        str(w).startswith("outside the joint range that was measured: 'elbow_joint' ")
        for w in found.warnings[1]
    )


# What to know of a command


def said(found, code: str) -> list[str]:
    """For each row the warning of that code, or nothing."""
    return [next((str(w) for w in row if w.code == code), "") for row in found.warnings]


def test_large_corrections_of_a_joint_are_said(ur3):
    q = np.tile(GOOD, (60, 1))
    q[:, 4] = np.linspace(0.02, 1.0, 60)
    found = commands(off(ur3, size=2.0), Program.of_joints(q), nominal=ur3)
    words = said(found, "joint")
    corrections = np.degrees(np.abs(found.joint_corrections))
    reached = found.reached
    assert [bool(w) for w in np.array(words)[reached]] == (
        corrections[reached].max(axis=1) > 5.0
    ).tolist()
    row = next(i for i, w in enumerate(words) if w)
    joint = ur3.joint_names[int(corrections[row].argmax())]
    assert (
        words[row] == f"a joint is corrected by much: {corrections[row].max():.1f} deg of '{joint}'"
    )


def test_an_arm_that_turns_over_between_poses_is_said(ur3):
    # The tool turns about its own axis, further than the last joint can: it has to start over from the other side.
    count = 80
    turns = np.tile(GOOD, (count, 1))
    turns[:, 5] = np.linspace(0.0, 2.6 * np.pi, count)
    start = dict(zip(ur3.joint_names, GOOD, strict=True))
    found = commands(off(ur3), Program.of_poses(ur3.poses(turns)), nominal=ur3, start=start)
    words = said(found, "turns over")
    steps = np.abs(np.diff(found.q, axis=0)).max(axis=1)
    assert [bool(w) for w in words] == [False, *(steps > 0.5)]
    assert sum(map(bool, words)) == 1


def test_a_jump_is_said_also_across_rows_without_a_command(ur3):
    # The elbow goes through straight, where the true arm has to jump.
    q = np.tile(np.radians([-20.0, -100.0, 0.0, -80.0, -60.0, 0.0]), (81, 1))
    q[:, 2] = np.radians(np.linspace(-3.0, 3.0, 81))
    poses = ur3.poses(q)
    poses[34:42, :3, 3] += 5.0
    found = commands(off(ur3, seed=2), Program.of_poses(poses, q), nominal=ur3, match="pose")
    assert np.flatnonzero(~found.reached).tolist() == list(range(34, 42))
    words = said(found, "jump")
    (row,) = (i for i, w in enumerate(words) if w)
    moved = np.degrees(np.abs(found.q[42] - found.q[33]))
    assert row == 42
    assert words[row].startswith(
        f"a jump: from row 34 it moves {moved.max():.1f} deg of 'elbow_joint'"
    )
    assert moved.max() > 10.0


def test_a_solution_far_from_what_was_given_is_said(ur3):
    found = commands(off(ur3), Program.of_poses(ur3.poses(GOOD), GOOD + 0.3), nominal=ur3)
    assert not any(said(found, "far"))
    wrong = GOOD.copy()
    wrong[0] += 1.2
    found = commands(off(ur3), Program.of_poses(ur3.poses(GOOD), wrong), nominal=ur3)
    (words,) = said(found, "far")
    assert words.endswith(" deg of 'shoulder_pan_joint'")


def test_weighted_rows_that_end_far_away_have_no_command():
    result = made("two_joints")
    q = 0.5 * random_joint_values(result.nominal, 2)
    poses = result.nominal.poses(q)
    poses[1, :3, 3] += 1.0
    found = commands(result, Program.of_poses(poses, q))
    assert found.match == "weighted"
    assert found.reached.tolist() == [True, False]
    assert "mm and" in found.reasons[1]
    generous = commands(result, Program.of_poses(poses, q), limit=(5.0, 1.0))
    assert generous.reached.all()


def test_an_angle_that_a_weighted_match_makes_worse_is_said(serial_urdf):
    # A wrist that is nearly straight: a millimetre of the tool costs it degrees.
    three = Robot.from_urdf(
        serial_urdf(
            [
                ("revolute", (0, 0, 0.3), (0, 0, 0), (0, 0, 1)),
                ("revolute", (0.3, 0, 0), (0, 0, 0), (0, 0, 1)),
                ("revolute", (0.3, 0, 0), (0, 0, 0), (0, 0, 1)),
            ],
            ((0.02, 0.0, 0.0), (0.0, 0.0, 0.0)),
        )
    )
    q = np.tile([0.2, 0.02, 0.4], (30, 1))
    q[:, 1] = np.linspace(0.02, 1.2, 30)
    found = commands(off(three, size=2.0), Program.of_joints(q), nominal=three)
    words = said(found, "turned")
    worse = found.left[:, 1] > found.missed[:, 1] + np.radians(0.2)
    assert [bool(w) for w in words] == (worse & found.reached).tolist()
    assert any(words)
    assert not all(words)


def test_positions_of_poses_keep_their_orientation_as_the_nominal_robot_does(ur3):
    poses = ur3.poses(GOOD)
    found = commands(off(ur3), Program.of_poses(poses, GOOD + 0.1), nominal=ur3, match="position")
    assert found.q_nominal == pytest.approx(GOOD[None], abs=1e-8)
    assert found.pose_corrections[0, 1] < np.radians(1.0)


def test_another_robot_is_refused(ur3):
    ur5 = Robot.load("ur5", base="base", tip="tool0")
    for true in (ur5, made("paper")):
        nominal = ur3 if true is ur5 else ur5
        with pytest.raises(
            ModelError, match=r"has the tool \d+ mm away from where the nominal robot"
        ):
            commands(true, Program.of_joints(GOOD), nominal=nominal)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"accept": (np.nan, 1.0)}, "What may be left is nan m and 1.0 rad"),
        ({"accept": (-1.0, 1.0)}, "What may be left is -1.0 m"),
        ({"limit": (np.nan, np.nan)}, "What may be corrected without a warning is nan m"),
        ({"limit": (0.1, -1.0)}, "both must be 0 or more"),
    ],
)
def test_sizes_that_are_none_are_refused(ur3, arguments, named):
    with pytest.raises(ModelError, match=named):
        commands(off(ur3), Program.of_joints(GOOD), nominal=ur3, **arguments)
