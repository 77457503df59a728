from __future__ import annotations

import re

import numpy as np
import pytest

from calib.compensate.arm import Arm
from calib.compensate.commands import commands
from calib.compensate.program import Program
from calib.model.readback import random_joint_values
from calib.model.robot import Robot
from calib.model.urdf import Urdf
from tests.compensate.arms import off, stored
from tests.show.calibrations import made

#: Well inside the workspace, far from singularities [rad].
GOOD = np.radians([-20.0, -80.0, 60.0, -70.0, -90.0, 10.0])


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


def test_good_rows_have_no_words(ur3):
    found = commands(off(ur3), Program.of_joints(GOOD), nominal=ur3)
    assert found.reasons == ("",)
    assert found.warnings == ((),)
    assert found.reached.tolist() == [True]


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
    assert "the nominal robot cannot reach the pose itself" in taken.warnings[0]
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


def test_too_few_joints_are_told_so():
    result = made("two_joints")
    q = 0.5 * random_joint_values(result.nominal, 1)
    found = commands(result, Program.of_joints(q), match="pose")
    assert found.reasons[0].endswith("values, for it has 2 joints and cannot match 6 numbers")


def test_near_a_singularity_is_said(ur3):
    q = np.tile(GOOD, (30, 1))
    q[:, 4] = np.linspace(0.005, 0.6, 30)
    found = commands(off(ur3), Program.of_joints(q), nominal=ur3)
    said = np.array(
        [any(w.startswith("near a singularity") for w in one) for one in found.warnings]
    )
    assert found.reached[2:].all()
    # One side is near, the other is not, and what is said is what happens: a millimetre takes so many degrees.
    assert said[2]
    assert not said[10:].any()
    (warning,) = (w for w in found.warnings[2] if w.startswith("near"))
    by_length, by_angle = re.findall(
        r"may take ([\d.]+) deg of 'wrist|it ([\d.]+) deg of 'wrist", warning
    )
    # By differences: where the tool is sent a millimetre further, in the worst direction, and turned.
    true = Arm.of_robot(off(ur3), np.eye(4))
    _, before = Arm.of_robot(ur3, np.eye(4)).motion(q[2:3])
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


def test_a_solution_in_another_branch_is_none(ur3):
    # Across the wrist's singularity: the true robot's lies on its other side.
    q = np.tile(GOOD, (400, 1))
    q[:, 4] = np.linspace(-0.03, 0.03, 400)
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
    assert found.warnings[0] == (
        f"the pose moves by {1e3 * moved:.2f} mm, more than 0.1 mm",
        f"the pose turns by {np.degrees(turned):.2f} deg, more than 0.01 deg",
    )


def test_outside_of_what_was_measured_is_said(ur3):
    middle = stored("paper").ranges.mean(axis=1)
    middle[4] += 0.5
    beyond = middle.copy()
    beyond[2] = stored("paper").ranges[2, 1] + 0.5
    found = commands(stored("paper"), Program.of_joints([middle, beyond]), nominal=ur3)
    assert not any("outside" in w for w in found.warnings[0])
    assert any(
        w.startswith("outside the joint range that was measured: 'elbow_joint' ")
        for w in found.warnings[1]
    )
