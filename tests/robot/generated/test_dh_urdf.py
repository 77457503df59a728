"""URDFs of DH rows: read by Pinocchio and yourdfpy, drawn as wide as the arm, with their rows in a comment."""

from __future__ import annotations

import io

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy

from calib.errors import UrdfError
from calib.robot.dh.rows import DHRobot, DHRow, DHTable
from calib.robot.generated.dh_urdf import dh_urdf
from calib.robot.readback import check_written
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf, urdf_of_dh

SHIFT = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 0.3), np.array([0.1, -0.2, 0.3])).homogeneous
ROWS = (
    DHRow("a--b & <c>", theta=0.3, d=0.4, a=0.1, alpha=np.pi / 2, direction=-1, offset=0.2),
    DHRow("slide", True, 0.5, 0.1, 0.02, -1.0, 0.01, -1, 0.05, 0.0, 0.4),
    DHRow("last", False, 1.0, 0.2, -0.3, 0.4, 0.0, 1, 0.0, -2.0, 2.5),
)


@pytest.mark.parametrize("convention", ["standard", "modified", "hayati"])
def test_the_urdf_says_what_the_rows_say(convention):
    rows = tuple(
        row if convention == "hayati" else DHRow(*[getattr(row, k) for k in row.__slots__[:6]], 0.0,
        *[getattr(row, k) for k in row.__slots__[7:]])
        for row in ROWS
    )  # fmt: skip
    table = DHTable(rows, SHIFT, SHIFT @ SHIFT, convention)
    stated = DHRobot(table, "arm", "world", "tcp", {"last": {"a--b & <c>": 0.5}})
    urdf = urdf_of_dh(stated, "arm.csv")
    robot = Robot.from_urdf(urdf)
    assert (robot.base, robot.tip, robot.joint_names) == ("world", "tcp", stated.joint_names)
    assert [joint.type for joint in robot.joints] == ["continuous", "prismatic", "revolute"]
    assert (robot.joints[1].lower, robot.joints[1].upper) == (0.0, 0.4)
    q = np.random.default_rng(1).uniform(-2, 2, (20, 3))
    np.testing.assert_allclose(robot.poses(q), stated.poses(q), rtol=0, atol=1e-12)
    check_written(robot, stated.poses(q), q)
    again = urdf.dh
    assert again is not None
    assert again.table.rows == rows
    assert (again.name, again.base, again.tip) == ("arm", "world", "tcp")
    assert again.coupling == stated.coupling
    np.testing.assert_array_equal(again.table.T_n_tip, table.T_n_tip)


def test_rows_of_kilometres_make_joints_near_each_other():
    far = (
        DHRow("j1", d=0.2),
        DHRow("j2", d=-400.0, a=0.4, alpha=1e-3),
        DHRow("j3", d=400.0, a=0.3),
    )
    stated = DHRobot(DHTable(far, np.eye(4), np.eye(4), "standard"))
    robot = Robot.from_urdf(urdf_of_dh(stated, "far.csv"))
    q = np.random.default_rng(1).uniform(-2, 2, (20, 3))
    np.testing.assert_allclose(robot.poses(q), stated.poses(q), rtol=0, atol=1e-11)
    assert max(np.linalg.norm(joint.xyz) for joint in robot.joints) < 1.0
    assert b'length="400' not in robot.urdf.data


def test_bodies():
    table = DHTable(ROWS, np.eye(4), np.eye(4), "hayati")
    data = dh_urdf(DHRobot(table))
    model = yourdfpy.URDF.load(io.BytesIO(data), load_meshes=False).robot
    by_name = {link.name: link for link in model.links}
    assert [len(by_name[f"link_{i}"].visuals) for i in (1, 2, 3)] == [4, 3, 2]
    column = by_name["base"].visuals[0]  # d of the first row, from the base up
    assert column.geometry.cylinder.length == pytest.approx(0.4)
    np.testing.assert_allclose(column.origin[:3, 3], [0, 0, 0.2], atol=1e-12)
    rail = by_name["link_1"].visuals[-1]  # as long as the joint slides
    assert rail.geometry.cylinder.length == pytest.approx(0.4)
    radii = [link.visuals[0].geometry.cylinder.radius for link in model.links[1:4]]
    assert radii == sorted(radii, reverse=True)
    for link in model.links:
        assert len(link.visuals) == len(link.collisions)
    geometry = pin.buildGeomFromUrdfString(
        pin.buildModelFromXML(data.decode()), data.decode(), pin.GeometryType.COLLISION
    )
    assert geometry.ngeoms == sum(len(link.collisions) for link in model.links)


@pytest.mark.parametrize(("old", "new"), [(b'"d_m": ', b'"d": '), (b'"schema"', b"schema")])
def test_a_comment_that_was_changed_is_named(old, new):
    urdf = urdf_of_dh(DHRobot(DHTable(ROWS, np.eye(4), np.eye(4), "hayati")), "arm.csv")
    changed = Urdf.from_bytes(urdf.data.replace(old, new), "arm.urdf")
    with pytest.raises(UrdfError, match=r"arm\.urdf: the comment 'calib DH rows' was changed"):
        Robot.from_urdf(changed)


def test_a_corrected_urdf_keeps_its_rows():
    urdf = urdf_of_dh(DHRobot(DHTable(ROWS, np.eye(4), np.eye(4), "hayati")), "arm.csv")
    robot = Robot.from_urdf(urdf)
    placements = robot.placements.copy()
    placements[1, 0, 3] += 0.001
    moved = robot.with_placements(placements).urdf.with_link("target", "flange", np.eye(4))
    assert moved.dh is not None
    assert moved.dh.table.rows == ROWS
