"""What is said of commands next to a singularity, and of joints that slide."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from calib.compensate.commands import commands
from calib.compensate.program import Program
from calib.model.robot import Robot
from calib.model.urdf import Urdf

CALIBRATED = Path(__file__).parents[2] / "urdf" / "ur3_calibrated.urdf"

#: Three joints that slide and a wrist: the pole of the wrist is a singularity.
GANTRY = """<robot name="gantry"><link name="l0"/><link name="l1"/><link name="l2"/><link name="l3"/><link name="l4"/>
<link name="l5"/><link name="l6"/>
{}
</robot>"""
JOINT = (
    '<joint name="{name}" type="{kind}"><parent link="l{i}"/><child link="l{j}"/><origin xyz="{xyz}"/>'
    '<axis xyz="{axis}"/><limit lower="-9" upper="9" effort="1" velocity="1"/></joint>'
)


@pytest.fixture(scope="module")
def gantry() -> Robot:
    joints = [
        ("slide_x", "prismatic", "0 0 1", "1 0 0"),
        ("slide_y", "prismatic", "0 0 0", "0 1 0"),
        ("slide_z", "prismatic", "0 0 0", "0 0 1"),
        ("roll", "revolute", "0 0 0.1", "0 0 1"),
        ("bend", "revolute", "0 0 0.1", "0 1 0"),
        ("spin", "revolute", "0 0 0.5", "0 0 1"),
    ]
    text = "\n".join(
        JOINT.format(name=name, kind=kind, xyz=xyz, axis=axis, i=i, j=i + 1)
        for i, (name, kind, xyz, axis) in enumerate(joints)
    )
    return Robot.from_urdf(Urdf.from_bytes(GANTRY.format(text).encode(), "g.urdf"), "l0", "l6")


def test_a_solution_on_the_other_side_of_a_singularity_has_no_command(ur3: Robot):
    q = np.tile(np.radians([10.0, -80.0, 70.0, -60.0, 0.0, 5.0]), (41, 1))
    q[:, 4] = np.linspace(-0.02, 0.02, 41)  # through the wrist's singularity
    program = Program(tuple(f"row {k}" for k in range(len(q))), q=q)
    true = Robot.load(CALIBRATED, "base", "tool0")
    found = commands(true, program, nominal=ur3, accept=(2e-3, 2e-3))
    said = "next to a singularity: the solution lies in another branch of the arm"
    turned = [reason == said for reason in found.reasons]
    assert 0 < sum(turned) < 10
    np.testing.assert_array_equal(found.reached, [not reason for reason in found.reasons])
    # The others are on their side of it, and where they were.
    assert np.abs(found.q - q)[~np.array(turned)].max() < 0.7


def test_how_far_a_sliding_joint_may_have_to_go_is_said_in_millimetres(gantry: Robot):
    placements = gantry.placements.copy()
    placements[4] = placements[4] @ pin.exp6(np.array([1e-3, 2e-3, 0, 1e-3, 0, 2e-3])).homogeneous
    q = np.array([[0.1, 0.2, 0.3, 0.2, 0.004, 0.1]])
    found = commands(gantry.with_placements(placements), Program(("row 1",), q=q), nominal=gantry)
    said = " ".join(found.warnings[0])
    assert re.search(r"near a singularity: 1 mm of the tool may take \S+ mm of 'slide_[xy]'", said)
