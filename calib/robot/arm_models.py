"""Arms of UFACTORY and Flexiv by name: the nominal origins of their joints, and a URDF of each, of cylinders.

Both makers' descriptions take the joints' origins from a YAML file with x, y, z [m] and roll, pitch, yaw [rad] under
``joint1``, ``joint2``, ..., R = Rz(yaw) Ry(pitch) Rx(roll), as in the ``<origin>`` of a URDF; Flexiv's has the fixed
joint ``link7_to_flange`` too. The numbers here are those of their nominal files, with their rounding.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array, read_only
from calib.basics.values import Value
from calib.errors import ModelError, choices
from calib.robot.cylinder_urdf import NewJoint, joint_body, link_radii, rods, urdf_bytes
from calib.robot.ur_models import MODELS, UrModel, ur_model, ur_urdf

#: x, y, z [m], roll, pitch, yaw [rad].
Numbers = tuple[float, float, float, float, float, float]

#: Limits of joints [rad].
_Limits = tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class Maker:
    """A maker, and what the descriptions of its arms have in common."""

    #: Its name.
    name: str
    #: The link that carries the first joint.
    base: str
    #: The flange's link, and the fixed joint that carries it.
    flange: str
    flange_joint: str
    #: Whether the files have an origin of the flange's joint; else it is the last link's frame.
    states_flange: bool


UFACTORY = Maker("UFACTORY", "link_base", "link_eef", "joint_eef", states_flange=False)

FLEXIV = Maker("Flexiv", "base_link", "flange", "link7_to_flange", states_flange=True)


@dataclass(frozen=True, slots=True, eq=False)
class ArmModel(Value):
    """One type of arm, with its nominal kinematics."""

    #: ``"xArm6"``.
    name: str
    #: Its maker.
    maker: Maker
    #: Shape (n + 1, 6), x, y, z [m], roll, pitch, yaw [rad] of the n joints' origins and of the flange's.
    numbers: Array
    #: Shape (n, 3), the joints' axes, each of its own frame.
    axes: Array
    #: Shape (n, 2), least and largest value of each joint [rad].
    limits: Array

    @property
    def plain(self) -> str:
        """The name in lower case without hyphens, ``"xarm6"``."""
        return _plain(self.name)

    @property
    def joints(self) -> tuple[str, ...]:
        """The names of the n joints and of the flange's; a prefix may stand before them."""
        moving = [f"joint{i + 1}" for i in range(len(self.axes))]
        return (*moving, self.maker.flange_joint)

    @property
    def origins(self) -> Array:
        """Poses of the n joints and of the flange in their parent links, shape (n + 1, 4, 4) [m]."""
        poses = np.tile(np.eye(4), (len(self.numbers), 1, 1))
        for T, (x, y, z, roll, pitch, yaw) in zip(poses, self.numbers, strict=True):
            T[:3, :3] = pin.rpy.rpyToMatrix(roll, pitch, yaw)
            T[:3, 3] = (x, y, z)
        return read_only(poses)


#: Half of pi, and pi, in UFACTORY's files [rad].
_H, _P = 1.5708, 3.1416

#: Origins of UFACTORY's joints, from its package xarm_description.
_UFACTORY: dict[str, tuple[Numbers, ...]] = {
    "xArm5": (
        (0, 0, 0.267, 0, 0, 0),
        (0, 0, 0, -_H, 0, 0),
        (0.0535, -0.2845, 0, 0, 0, 0),
        (0.0775, 0.3425, 0, 0, 0, 0),
        (0.076, 0.097, 0, -_H, 0, 0),
    ),
    "xArm6": (
        (0, 0, 0.267, 0, 0, 0),
        (0, 0, 0, -_H, 0, 0),
        (0.0535, -0.2845, 0, 0, 0, 0),
        (0.0775, 0.3425, 0, -_H, 0, 0),
        (0, 0, 0, _H, 0, 0),
        (0.076, 0.097, 0, -_H, 0, 0),
    ),
    "xArm7": (
        (0, 0, 0.267, 0, 0, 0),
        (0, 0, 0, -_H, 0, 0),
        (0, -0.293, 0, _H, 0, 0),
        (0.0525, 0, 0, _H, 0, 0),
        (0.0775, -0.3425, 0, _H, 0, 0),
        (0, 0, 0, _H, 0, 0),
        (0.076, 0.097, 0, -_H, 0, 0),
    ),
    "Lite6": (
        (0, 0, 0.2435, 0, 0, 0),
        (0, 0, 0, _H, -_H, _P),
        (0.2002, 0, 0, -_P, 0, _H),
        (0.087, -0.22761, 0, _H, 0, 0),
        (0, 0, 0, _H, 0, 0),
        (0, 0.0625, 0, -_H, 0, 0),
    ),
    "UF850": (
        (0, 0, 0.364, 0, 0, 0),
        (0, 0, 0, _H, -_H, 0),
        (0.39, 0, 0, -_P, 0, -_H),
        (0.15, 0.426, 0, -_H, 0, 0),
        (0, 0, 0, -_H, 0, 0),
        (0, -0.09, 0, _H, 0, 0),
    ),
}

#: Limits of a joint that makes a turn to either side [rad].
_TURN = (-2 * np.pi, 2 * np.pi)

#: Limits of UFACTORY's joints [rad].
_UFACTORY_LIMITS: dict[str, _Limits] = {
    "xArm5": (_TURN, (-2.059, 2.0944), (-3.927, 0.19198), (-1.69297, np.pi), _TURN),
    "xArm6": (_TURN, (-2.059, 2.0944), (-3.927, 0.19198), _TURN, (-1.69297, np.pi), _TURN),
    "xArm7": (_TURN, (-2.059, 2.0944), _TURN, (-0.19198, 3.927), _TURN, (-1.69297, np.pi), _TURN),
    "Lite6": (_TURN, (-2.61799, 2.61799), (-0.061087, 5.235988), _TURN, (-2.1642, 2.1642), _TURN),
    "UF850": (
        _TURN,
        (-2.3038346, 2.3038346),
        (-4.2236968, 0.061087),
        _TURN,
        (-2.1642, 2.1642),
        _TURN,
    ),
}

#: Origin of the last joint of all Rizon arms [m], [rad].
_RIZON_WRIST: Numbers = (-0.015, 0.073, 0.11, 0, -np.pi / 2, 0)


def _rizon(arm: tuple[Numbers, ...], flange: float) -> tuple[Numbers, ...]:
    """Return the origins of a Rizon from those of its first six joints and the flange's height [m]."""
    return (*arm, _RIZON_WRIST, (0, 0, flange, 0, 0, np.pi))


_RIZON_4: tuple[Numbers, ...] = (
    (0, 0, 0.155, 0, 0, np.pi),
    (0, 0.03, 0.21, 0, 0, 0),
    (0, 0.035, 0.205, 0, 0, 0),
    (-0.02, -0.03, 0.19, 0, 0, np.pi),
    (-0.02, 0.025, 0.195, 0, 0, np.pi),
    (0, 0.03, 0.19, 0, 0, 0),
)

_RIZON_10: tuple[Numbers, ...] = (
    (0, 0, 0.21, 0, 0, np.pi),
    (0, 0.0675, 0.24, 0, 0, 0),
    (0, 0.0625, 0.2275, 0, 0, 0),
    (0, -0.0625, 0.2225, 0, 0, np.pi),
    (0, 0.0575, 0.205, 0, 0, np.pi),
    (0, 0.03, 0.19, 0, 0, 0),
)

#: Origins of Flexiv's joints and flanges, from its package flexiv_description.
_FLEXIV: dict[str, tuple[Numbers, ...]] = {
    "Rizon4": _rizon(_RIZON_4, 0.081),
    "Rizon4s": _rizon(_RIZON_4, 0.124),
    "Rizon10": _rizon(_RIZON_10, 0.081),
    "Rizon10s": _rizon(_RIZON_10, 0.124),
    "Enlight-L": (
        (0, 0, 0.146, 0, 0, 0),
        (0, -0.037, 0.114, np.pi / 2, 0, 0),
        (0, 0.181, -0.037, -np.pi / 2, 0, 0),
        (0, 0.037, 0.109, -np.pi / 2, 0, 0),
        (0, -0.156, -0.037, np.pi / 2, 0, 0),
        (0, -0.0261, 0.124, np.pi / 2, 0, 0),
        (0, 0.134, -0.0261, -np.pi / 2, 0, 0),
        (0, 0, 0.048, 0, 0, 0),
    ),
}

#: Limits of the joints of the Rizon 4, and of the others until theirs are known [rad].
_RIZON_LIMITS: _Limits = (
    (-2.8798, 2.8798),
    (-2.3562, 2.3562),
    (-3.0543, 3.0543),
    (-1.9548, 2.7751),
    (-3.0543, 3.0543),
    (-1.4835, 4.6251),
    (-3.0543, 3.0543),
)

#: Limits of the joints of the Enlight-L that turn about their links, and of those that bend [rad].
_ENLIGHT_ROLL, _ENLIGHT_BEND = (-6.3705, 6.3705), (-2.1817, 2.1817)

#: Axes of the Rizon's joints: the second, fourth and sixth turn about y.
_RIZON_AXES = tuple((0, i % 2, 1 - i % 2) for i in range(7))


def _models() -> tuple[ArmModel, ...]:
    """Return all arms."""
    models = []
    for name, origins in _UFACTORY.items():
        numbers = read_only([*origins, (0.0,) * 6])
        axes = read_only(np.tile((0.0, 0.0, 1.0), (len(origins), 1)))
        limits = read_only(_UFACTORY_LIMITS[name])
        models.append(ArmModel(name, UFACTORY, numbers, axes, limits))
    for name, origins in _FLEXIV.items():
        is_rizon = name.startswith("Rizon")
        axes = read_only(np.array(_RIZON_AXES if is_rizon else ((0, 0, 1),) * 7, float))
        enlight = ((_ENLIGHT_ROLL, _ENLIGHT_BEND) * 4)[:7]
        limits = read_only(_RIZON_LIMITS if is_rizon else enlight)
        models.append(ArmModel(name, FLEXIV, read_only(origins), axes, limits))
    return tuple(models)


ARMS = _models()
"""The arms that are known."""


def arm_model(name: str) -> ArmModel:
    """Return the arm of a name.

    Args:
        name: The name, in any case, with or without spaces, hyphens and underscores.

    Returns:
        The arm.

    Raises:
        ModelError: No arm of this name is known.

    Example:
        >>> arm_model("xarm_6").numbers[2, :3].tolist()
        [0.0535, -0.2845, 0.0]
    """
    plain = _plain(name)
    for arm in ARMS:
        if arm.plain == plain:
            return arm
    known = choices((arm.name for arm in ARMS), limit=40)
    raise ModelError(f"'{name}' is not an arm of UFACTORY or Flexiv that calib knows: {known}.")


def find_arm(name: str) -> ArmModel | UrModel:
    """Return the arm of a name, of any maker whose arms are known here; see `arm_model` and `ur_model`.

    Raises:
        ModelError: No arm of this name is known.
    """
    plain = _plain(name)
    if any(arm.plain == plain for arm in ARMS):
        return arm_model(name)
    if plain.startswith("ur"):
        return ur_model(name)
    known = choices([*(model.name for model in MODELS), *(arm.name for arm in ARMS)], limit=60)
    raise ModelError(
        f"'{name}' is not an arm that calib knows by name: {known}. For another one give its nominal URDF as --robot."
    )


def named_arm_urdf(name: str) -> tuple[bytes, str] | None:
    """Return the URDF of an arm by a name such as ``"ur10e"``, and the arm's own name; None if no arm has it."""
    try:
        arm = find_arm(name)
    except ModelError:
        return None
    return (ur_urdf(arm) if isinstance(arm, UrModel) else arm_urdf(arm)), arm.name


def arm_urdf(arm: ArmModel) -> bytes:
    """Return the URDF of a nominal arm in UTF-8, with the joints and links of its maker's description, as cylinders."""
    maker, origins = arm.maker, arm.origins
    radii = link_radii([*origins])
    links = [maker.base, *(f"link{i + 1}" for i in range(len(arm.axes)))]
    joints = []
    for i, (x, y, z) in enumerate(arm.axes.astype(int).tolist()):
        ahead = rods([np.zeros(3), origins[i + 1, :3, 3]], radii[i])
        joints.append(
            NewJoint(
                name=arm.joints[i],
                type="revolute",
                parent=links[i],
                child=links[i + 1],
                T_parent_joint=origins[i],
                axis=(x, y, z),
                limits=(float(arm.limits[i, 0]), float(arm.limits[i, 1])),
                bodies=(joint_body(radii[i]), *ahead) if z else tuple(ahead),
            )
        )
    joints.append(NewJoint(arm.joints[-1], "fixed", links[-1], maker.flange, origins[-1]))
    remark = (
        f"Kinematics of a {maker.name} {arm.name}, by calib: its cylinders are not the robot's shape, and efforts and "
        "speeds are only there because a URDF must have them."
    )
    foot = tuple(rods([np.zeros(3), origins[0, :3, 3]], radii[0]))
    return urdf_bytes(arm.plain, [remark], maker.base, joints, foot)


def _plain(name: str) -> str:
    """Return a name in lower case without spaces, hyphens and underscores."""
    return re.sub("[ _-]", "", name.lower())
