"""The arms of Universal Robots by name: their nominal DH rows, and a URDF of each, with links drawn as cylinders.

Universal Robots writes standard (distal) DH, T_i(q) = Rz(theta_i + q_i) Tz(d_i) Tx(a_i) Rx(alpha_i). *Rows* are theta,
a, d, alpha, shape (6, 4), [rad] and [m].
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array, read_only
from calib.basics.values import Value
from calib.errors import ModelError, choices
from calib.robot.cylinder_urdf import (
    Cylinder,
    NewJoint,
    joint_body,
    link_radii,
    rods,
    urdf_bytes,
)
from calib.robot.dh_rows import screw

COLUMNS = ("theta", "a", "d", "alpha")
"""The columns of the rows."""

JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
"""The joints of Universal Robots' descriptions; a prefix may stand before them."""

LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
"""The six links, as ``kinematics.yaml`` names them."""

#: The links of the URDF from the mount to the last joint's.
_URDF_LINKS = ("base_link_inertia", *(f"{link}_link" for link in LINKS))

#: d1, a2, a3, d4, d5, d6 [m], from Universal Robots' article "DH parameters for calculations of kinematics and
#: dynamics" and the descriptions and solvers for ROS that cite it. The UR7e and the UR12e are the UR5e and the UR10e
#: under the names of 2025. All but the UR8 Long, the UR15 and the UR18 give the hash that is published with them.
_LENGTHS = {
    "UR3": (0.1519, -0.24365, -0.21325, 0.11235, 0.08535, 0.0819),
    "UR3e": (0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921),
    "UR5": (0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823),
    "UR5e": (0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    "UR7e": (0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    "UR8 Long": (0.2186, -0.8989, -0.7149, 0.1824, 0.1361, 0.1434),
    "UR10": (0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922),
    "UR10e": (0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
    "UR12e": (0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
    "UR15": (0.2186, -0.6475, -0.5164, 0.1824, 0.1361, 0.1434),
    "UR16e": (0.1807, -0.4784, -0.36, 0.17415, 0.11985, 0.11655),
    "UR18": (0.2186, -0.475, -0.3389, 0.1824, 0.1361, 0.1434),
    "UR20": (0.2363, -0.862, -0.7287, 0.201, 0.1593, 0.1543),
    "UR30": (0.2363, -0.637, -0.5037, 0.201, 0.1593, 0.1543),
}

#: Rows that differ by less are those of the same type of arm [m and rad].
_SAME = 1e-6

#: Half of pi as the controllers' own files write it [rad].
_HALF_PI = 1.570796327

#: Limits of the joints in the URDFs [rad].
_LARGEST_TURN = 2.0 * np.pi

#: Limits of the elbow [rad].
_LARGEST_ELBOW_TURN = np.pi


@dataclass(frozen=True, slots=True, eq=False)
class UrModel(Value):
    """One type of arm, with its nominal kinematics."""

    #: ``"UR5e"``; ``"arm of urcontrol.conf"`` for an arm that calib does not know.
    name: str
    #: Nominal DH rows theta, a, d, alpha, shape (6, 4), [rad] and [m].
    rows: Array

    @property
    def known(self) -> bool:
        """True if Universal Robots sells the arm under this name."""
        return self.name in _LENGTHS

    @property
    def plain(self) -> str:
        """The name in lower case without spaces, ``"ur5e"``."""
        return self.name.lower().replace(" ", "")

    @property
    def chain(self) -> Array:
        """The nominal chain, shape (7, 4, 4), [m]."""
        return chain_of_rows(self.rows)

    def has_rows(self, rows: Array) -> bool:
        """Return True if DH rows, shape (6, 4), are the nominal ones of this type of arm."""
        return bool(np.abs(self.rows - rows).max() < _SAME)


def _known_model(name: str, lengths: tuple[float, ...]) -> UrModel:
    """Return an arm of Universal Robots' structure by its name and lengths d1, a2, a3, d4, d5, d6 [m]."""
    d1, a2, a3, d4, d5, d6 = lengths
    theta = np.zeros(6)
    a = (0.0, a2, a3, 0.0, 0.0, 0.0)
    d = (d1, 0.0, 0.0, d4, d5, d6)
    alpha = (_HALF_PI, 0.0, 0.0, _HALF_PI, -_HALF_PI, 0.0)
    return UrModel(name, read_only(np.transpose([theta, a, d, alpha])))


MODELS = tuple(_known_model(name, lengths) for name, lengths in _LENGTHS.items())
"""The arms that are known."""


def ur_model(name: str | UrModel) -> UrModel:
    """Return the arm of a name.

    Args:
        name: The name, in any case, with or without spaces and underscores; or an arm.

    Returns:
        The arm.

    Raises:
        ModelError: No arm of this name is known.

    Example:
        >>> ur_model("ur5e").rows[:, 1].tolist()
        [0.0, -0.425, -0.3922, 0.0, 0.0, 0.0]
    """
    if isinstance(name, UrModel):
        return name
    plain = re.sub("[ _-]", "", name.lower())
    for model in MODELS:
        if model.plain == plain:
            return model
    raise ModelError(
        f"'{name}' is not an arm of Universal Robots that calib knows: "
        f"{choices(_LENGTHS, limit=40)}. For another one give its urcontrol.conf, which has the "
        "nominal rows."
    )


def chain_of_rows(rows: Array) -> Array:
    """Return the chain of an arm of Universal Robots with given DH rows.

    Args:
        rows: theta, a, d, alpha of six joints, shape (6, 4), [rad] and [m].

    Returns:
        Placements of the six joints and of the flange, shape (7, 4, 4) [m], read-only.
    """
    theta, a, d, alpha = rows.T
    turns = [screw(2, theta[i], 0.0) @ screw(0, alpha[i], a[i]) for i in range(6)]
    # Each joint's frame is at the end of its d, except between parallel axes.
    slides = [screw(2, 0.0, d[i]) for i in range(6)]
    placements = [
        slides[0],
        turns[0],
        slides[1] @ turns[1],
        slides[2] @ turns[2] @ slides[3],
        turns[3] @ slides[4],
        turns[4] @ slides[5] @ screw(2, theta[5], 0.0),
        screw(0, alpha[5], a[5]),
    ]
    return read_only(placements)


def ur_urdf(model: UrModel) -> bytes:
    """Return the URDF of a nominal arm in UTF-8; its links are cylinders, seen and checked for collisions.

    Links, joints and origins are those of Universal Robots' description for ROS 2; ``base`` is the controller's base,
    ``tool0`` its flange.
    """
    half = np.pi / 2.0
    chain = model.chain
    radii = link_radii([*chain])
    mount = _fixed("base_link-base_link_inertia", "base_link", _URDF_LINKS[0], (0.0, 0.0, np.pi))
    joints = [
        replace(mount, bodies=_rods_to(chain[0], radii[0])),
        _fixed("base_link-base_fixed_joint", "base_link", "base", (0.0, 0.0, np.pi)),
    ]
    for i, name in enumerate(JOINTS):
        bound = _LARGEST_ELBOW_TURN if name == "elbow_joint" else _LARGEST_TURN
        joint = NewJoint(
            name=name,
            type="revolute",
            parent=_URDF_LINKS[i],
            child=_URDF_LINKS[i + 1],
            T_parent_joint=chain[i],
            limits=(-bound, bound),
            bodies=(joint_body(radii[i]), *_rods_to(chain[i + 1], radii[i])),
        )
        joints.append(joint)
    joints += [
        _fixed("wrist_3_link-ft_frame", _URDF_LINKS[-1], "ft_frame", (np.pi, 0.0, 0.0)),
        _fixed("wrist_3-flange", _URDF_LINKS[-1], "flange", (0.0, -half, -half)),
        _fixed("flange-tool0", "flange", "tool0", (half, 0.0, half)),
    ]
    remark = (
        f"Kinematics of a Universal Robots {model.name}, by calib: its cylinders are not the robot's shape, and "
        "efforts and speeds are only there because a URDF must have them."
    )
    return urdf_bytes(model.plain, [remark], "base_link", joints)


def _rods_to(T_joint_next: Array, radius: float) -> tuple[Cylinder, ...]:
    """Return the body of a link [m] from the joint that carries it to the next one, whose pose (4, 4) is given."""
    return tuple(rods([np.zeros(3), T_joint_next[:3, 3]], radius))


def _fixed(name: str, parent: str, child: str, rpy: tuple[float, float, float]) -> NewJoint:
    """Return a fixed joint that turns a frame by roll, pitch and yaw [rad]."""
    T = np.eye(4)
    T[:3, :3] = pin.rpy.rpyToMatrix(*rpy)
    return NewJoint(name, "fixed", parent, child, T)
