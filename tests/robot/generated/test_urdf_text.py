"""URDFs that calib makes: what is written is read back."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from calib.robot.generated.urdf_text import Cylinder, NewJoint, urdf_bytes
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
