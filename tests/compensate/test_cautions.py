from __future__ import annotations

import numpy as np
import pytest

from calib.compensate.commands import commands
from calib.compensate.program import Program
from calib.errors import ModelError
from calib.model.readback import random_joint_values
from calib.model.robot import Robot
from calib.model.torques import Payload
from tests.compensate.arms import off, stored
from tests.show.calibrations import made

#: Well inside the workspace, far from singularities [rad].
GOOD = np.radians([-20.0, -80.0, 60.0, -70.0, -90.0, 10.0])


def said(found, start: str) -> list[str]:
    """For each row the words that begin so, or nothing."""
    return [next((w for w in row if w.startswith(start)), "") for row in found.warnings]


def test_large_corrections_of_a_joint_are_said(ur3):
    q = np.tile(GOOD, (60, 1))
    q[:, 4] = np.linspace(0.02, 1.0, 60)
    found = commands(off(ur3, size=2.0), Program.of_joints(q), nominal=ur3)
    words = said(found, "a joint is corrected by much")
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
    words = said(found, "the arm turns over: from row")
    steps = np.abs(np.diff(found.q, axis=0)).max(axis=1)
    assert [bool(w) for w in words] == [False, *(steps > 0.5)]
    assert sum(map(bool, words)) == 1


def test_poses_far_apart_are_no_path(ur3):
    q = random_joint_values(ur3, 6, 4)
    found = commands(off(ur3), Program.of_poses(ur3.poses(q), q), nominal=ur3)
    assert not any(said(found, "the arm turns over"))
    assert not any(said(found, "a jump"))


def test_a_jump_is_said_also_across_rows_without_a_command(ur3):
    # The elbow goes through straight, where the true arm has to jump.
    q = np.tile(np.radians([-20.0, -100.0, 0.0, -80.0, -60.0, 0.0]), (81, 1))
    q[:, 2] = np.radians(np.linspace(-3.0, 3.0, 81))
    poses = ur3.poses(q)
    poses[34:42, :3, 3] += 5.0
    found = commands(off(ur3, seed=2), Program.of_poses(poses, q), nominal=ur3, match="pose")
    assert np.flatnonzero(~found.reached).tolist() == list(range(34, 42))
    words = said(found, "a jump: from row")
    (row,) = (i for i, w in enumerate(words) if w)
    moved = np.degrees(np.abs(found.q[42] - found.q[33]))
    assert row == 42
    assert words[row].startswith(
        f"a jump: from row 34 it moves {moved.max():.1f} deg of 'elbow_joint'"
    )
    assert moved.max() > 10.0


def test_a_solution_far_from_what_was_given_is_said(ur3):
    found = commands(off(ur3), Program.of_poses(ur3.poses(GOOD), GOOD + 0.3), nominal=ur3)
    assert not any(said(found, "far from"))
    wrong = GOOD.copy()
    wrong[0] += 1.2
    found = commands(off(ur3), Program.of_poses(ur3.poses(GOOD), wrong), nominal=ur3)
    (words,) = said(found, "far from the joint values given: ")
    assert words.endswith(" deg of 'shoulder_pan_joint'")


def test_what_was_accepted_is_said(ur3):
    far = ur3.poses(np.radians([[10.0, -90.0, 0.0, -90.0, 40.0, 0.0]]))[0]
    far[2, 3] += 0.02
    program = Program.of_poses(far, np.radians([10.0, -90.0, 3.0, -90.0, 40.0, 0.0]))
    found = commands(off(ur3), program, nominal=ur3, match="position", accept=(0.1, 0.1))
    assert said(found, "an error is left") == [f"an error is left: {1e3 * found.left[0, 0]:.4f} mm"]


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
    words = said(found, "the tool is turned by")
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
    for true in (ur5, stored("paper")):
        nominal = ur3 if true is ur5 else ur5
        with pytest.raises(
            ModelError, match=r"has the tool \d+ mm away from where the nominal robot"
        ):
            commands(true, Program.of_joints(GOOD), nominal=nominal)


def test_a_payload_that_changes_nothing_is_refused(ur3):
    with pytest.raises(ModelError, match="the model has no compliances"):
        commands(stored("paper"), Program.of_joints(GOOD), nominal=ur3, payload=Payload(5.0))


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


def test_nothing_may_be_left_and_rounding_is_nothing(ur3):
    found = commands(off(ur3), Program.of_joints(GOOD), nominal=ur3, accept=(0.0, 0.0))
    assert found.reached.all()
