"""The nominal arms of UFACTORY and Flexiv: another reader of their URDFs, names, and published reaches."""

from __future__ import annotations

import io

import numpy as np
import pytest
import yourdfpy

from calib.errors import ModelError
from calib.robot.arm_models import ARMS, arm_model, arm_urdf, find_arm, named_arm_urdf
from calib.robot.robot import Robot
from calib.robot.ur_models import ur_model, ur_urdf

#: Flange over the base with all joints at zero [m], from the makers' drawings: UFACTORY's arms are folded then, and
#: Flexiv's stand upright.
FLANGES = {
    "xArm5": (0.207, 0.0, 0.112),
    "xArm6": (0.207, 0.0, 0.112),
    "xArm7": (0.206, 0.0, 0.1205),
    "Lite6": (0.087, 0.0, 0.1542),
    "UF850": (0.15, 0.0, 0.238),
    "Rizon4": (0.096, -0.113, 1.255),
    "Rizon4s": (0.139, -0.113, 1.255),
    "Rizon10": (0.096, -0.113, 1.405),
    "Rizon10s": (0.139, -0.113, 1.405),
    "Enlight-L": (0.0, 0.0, 1.012),
}


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_the_flange_is_where_the_drawing_has_it(arm):
    urdf = yourdfpy.URDF.load(io.BytesIO(arm_urdf(arm)), load_meshes=False)
    at_zero = urdf.get_transform(arm.maker.flange, arm.maker.base)
    np.testing.assert_allclose(at_zero[:3, 3], FLANGES[arm.name], rtol=0, atol=7e-4)
    robot = Robot.load(arm.plain)
    assert robot.tip == arm.maker.flange
    assert robot.joint_names == arm.joints[:-1]
    q = np.mean(arm.limits, axis=1) + 0.3
    urdf.update_cfg(dict(zip(robot.joint_names, q, strict=True)))
    at_q = urdf.get_transform(arm.maker.flange, arm.maker.base)
    by_calib = Robot.load(arm.plain, base=arm.maker.base).poses(q)[0]
    np.testing.assert_allclose(by_calib, at_q, rtol=0, atol=1e-9)


def test_names_whatever_their_capitals():
    assert arm_model("enlight l").name == "Enlight-L"
    assert find_arm("UR_5e") is ur_model("UR5e")
    assert find_arm("rizon 4S").name == "Rizon4s"
    for name, known in (("xArm8", "UFACTORY"), ("Rizon", "Flexiv")):
        with pytest.raises(ModelError, match=known):
            arm_model(name)
    with pytest.raises(ModelError, match="'UR6' is not an arm of Universal Robots"):
        find_arm("UR6")


def test_only_names_of_arms_have_a_urdf():
    assert named_arm_urdf("ur10e") == (ur_urdf(ur_model("UR10e")), "UR10e")
    assert named_arm_urdf("uf850") == (arm_urdf(arm_model("UF850")), "UF850")
    assert named_arm_urdf("panda") is None
