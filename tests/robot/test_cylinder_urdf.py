"""Cylinders that draw links and joints: their places and sizes; and URDFs of them: what is written is read back."""

from __future__ import annotations

import io

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy

from calib.errors import UrdfError
from calib.robot.cylinder_urdf import (
    GREY,
    Cylinder,
    NewJoint,
    bar,
    dh_urdf,
    joint_body,
    link_radii,
    rods,
    urdf_bytes,
)
from calib.robot.dh_rows import DHRobot, DHRow, DHTable
from calib.robot.readback import check_written
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf, urdf_of_dh


def test_what_is_written_is_read_back():
    T = pin.SE3(
        pin.rpy.rpyToMatrix(0.3, np.pi / 2, 0.0), np.array([1 / 3, 1e-17, -2.0])
    ).homogeneous
    body = Cylinder(np.eye(4), 0.1, 1 / 3, (1.0, 0.5, 0.25))
    joints = [
        NewJoint("lift", "prismatic", "root", "car", T, (0, 0, -1), (-0.1, 1 / 7), (body,)),
        NewJoint("end", "fixed", "car", 'tip "1"', np.eye(4)),
    ]
    urdf = Urdf.from_bytes(urdf_bytes("a & b", ["made", "here"], "root", joints), "x.urdf")
    assert (urdf.name, urdf.root, urdf.links) == ("a & b", "root", ("root", "car", 'tip "1"'))
    lift = urdf.joint("lift")
    assert (lift.type, lift.lower, lift.upper, lift.parent) == ("prismatic", -0.1, 1 / 7, "root")
    assert lift.axis.tolist() == [0, 0, -1]
    assert lift.xyz.tolist() == [1 / 3, 0.0, -2.0]
    np.testing.assert_allclose(lift.T_parent_joint, T, rtol=0, atol=1e-15)
    elements = urdf.elements()
    cylinders = [(c.get("radius"), float(c.get("length"))) for c in elements.iter("cylinder")]
    assert cylinders == [("0.1", 1 / 3)] * 2
    assert [c.get("rgba") for c in elements.iter("color")] == ["1 0.5 0.25 1"]


def translations(*lengths: float) -> list[np.ndarray]:
    poses = np.tile(np.eye(4), (len(lengths), 1, 1))
    poses[:, 0, 3] = lengths
    return list(poses)


def test_links_get_thinner_towards_the_tip():
    radii = link_radii(translations(0.5, 0.3, 0.2))
    np.testing.assert_allclose(radii, [0.035, 0.018])
    # A robot whose joints are all in one place can be seen, too.
    np.testing.assert_allclose(link_radii(translations(0.0, 0.0, 0.0)), [0.0035, 0.0018])


def test_rods_lie_between_the_points_of_a_path():
    path = [np.zeros(3), np.array([0.0, 0.4, 0.0]), np.array([0.3, 0.4, 0.0])]
    first, second = rods(path, 0.05)
    assert (first.length, second.length) == (pytest.approx(0.4), pytest.approx(0.3))
    for rod, start, end in ((first, path[0], path[1]), (second, path[1], path[2])):
        T = rod.T_link_cylinder
        half = 0.5 * rod.length * T[:3, 2]
        np.testing.assert_allclose(T[:3, 3] + half, end, atol=1e-12)
        np.testing.assert_allclose(T[:3, 3] - half, start, atol=1e-12)
        assert (rod.radius, rod.colour) == (0.05, GREY)


def test_what_lies_inside_a_joint_is_not_drawn():
    assert list(rods([np.zeros(3), np.array([0.0, 0.0, 0.02])], 0.05)) == []


def test_a_joint_is_thicker_than_its_link_and_centred():
    body = joint_body(0.1)
    assert (body.radius, body.length) == (pytest.approx(0.13), pytest.approx(0.28))
    np.testing.assert_allclose(body.T_link_cylinder, np.eye(4))
    assert bar(-0.1, 0.5, 0.02, GREY).T_link_cylinder[2, 3] == pytest.approx(0.2)


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
