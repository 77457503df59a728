"""Cylinders that draw links and joints: their places and sizes; and URDFs of them: what is written is read back."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib.robot.generated.cylinder_urdf import (
    GREY,
    Cylinder,
    NewJoint,
    bar,
    joint_body,
    link_radii,
    rods,
    urdf_bytes,
)
from calib.robot.urdf import Urdf


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
