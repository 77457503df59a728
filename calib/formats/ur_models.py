"""The Universal Robots arms: their nominal kinematics, and a bare URDF of each; `ur_mount` recognises one in a URDF."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.errors import ModelError, choices
from calib.formats.ur_dh import COLUMNS, FullDH, kinematics_hash
from calib.model.robot import Robot
from calib.model.urdf import Urdf

Array = NDArray[np.float64]

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
"""What ``kinematics.yaml`` calls the six links."""

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

TOLERANCE = 1e-6
"""A robot that is an arm of the table may lie this far from it [m and rad]."""

#: Half of pi as the controllers' own files write it [rad].
_HALF_PI = 1.570796327


@dataclass(frozen=True, slots=True, eq=False)
class UrModel:
    """One type of arm.

    Attributes:
        name: Such as ``"UR5e"``; of an arm that calib does not know ``"arm of urcontrol.conf"``.
        nominal: Its nominal DH rows.
    """

    name: str
    nominal: FullDH

    @property
    def known(self) -> bool:
        """Whether Universal Robots sells it under this name."""
        return self.name in _MODELS

    def same(self, rows: FullDH) -> bool:
        """Whether rows are those of this type of arm."""
        return all(
            np.abs(getattr(self.nominal, name) - getattr(rows, name)).max() < TOLERANCE
            for name in COLUMNS
        )

    @property
    def said(self) -> str:
        """Its name with the article: ``"a UR5e"``."""
        return f"{'a' if self.known else 'an'} {self.name}"

    @property
    def default_hash(self) -> str:
        """What the ROS driver makes of the nominal rows."""
        return kinematics_hash(self.nominal)


#: The arms by name.
_MODELS = {
    name: UrModel(
        name,
        FullDH(
            theta=np.zeros(6),
            a=np.array([0.0, a2, a3, 0.0, 0.0, 0.0]),
            d=np.array([d1, 0.0, 0.0, d4, d5, d6]),
            alpha=np.array([_HALF_PI, 0.0, 0.0, _HALF_PI, -_HALF_PI, 0.0]),
        ),
    )
    for name, (d1, a2, a3, d4, d5, d6) in _LENGTHS.items()
}

MODELS = tuple(_MODELS.values())
"""The arms that are known."""


NAMES = tuple(_MODELS)
"""Their names."""


def ur_model(name: str | UrModel) -> UrModel:
    """The arm of that name, whatever its capitals, spaces and underscores; an arm itself is returned.

    Raises:
        ModelError: There is none.

    Example:
        >>> ur_model("ur5e").nominal.a.tolist()
        [0.0, -0.425, -0.3922, 0.0, 0.0, 0.0]
    """
    if isinstance(name, UrModel):
        return name
    for model in MODELS:
        if _plain(model.name) == _plain(name):
            return model
    raise ModelError(
        f"'{name}' is not an arm of Universal Robots that calib knows: {choices(NAMES, limit=40)}. For another one "
        "give its urcontrol.conf, which has the nominal rows."
    )


def ur_robot(model: UrModel | str) -> Robot:
    """A bare URDF of an arm with its nominal kinematics, from ``base``, the controller's, to ``tool0``, its flange.

    Links, joints and origins are those of Universal Robots' description for ROS 2, without bodies.

    Raises:
        ModelError: No arm has that name.

    Example:
        >>> ur_robot("ur5e")
        Robot('ur5e', base to tool0, 6 joints)
    """
    model = ur_model(model)
    data = _urdf_text(model).encode()
    urdf = Urdf.from_bytes(data, f"the nominal {model.name}")
    return Robot.from_urdf(urdf, base="base", tip="tool0")


def _plain(name: str) -> str:
    """A name without capitals, spaces, hyphens and underscores."""
    return "".join(letter for letter in name.lower() if letter not in " -_")


def _urdf_text(model: UrModel) -> str:
    """The bare URDF; where nothing turns, an <origin> of the nominal rows says so exactly."""
    name = _plain(model.name)
    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        f"<!-- Kinematics of a Universal Robots {model.name}, without bodies, by calib: efforts and speeds are only",
        "     there because a URDF must have them. -->",
        f'<robot name="{name}">',
        *_fixed("base_link", None, "", "0.0 0.0 0.0"),
        *_fixed(
            "base_link_inertia", "base_link", "base_link-base_link_inertia", f"0.0 0.0 {np.pi}"
        ),
        *_fixed("base", "base_link", "base_link-base_fixed_joint", f"0.0 0.0 {np.pi}"),
    ]
    parent = "base_link_inertia"
    for link, joint, placement in zip(LINKS, JOINTS, model.nominal.chain(), strict=False):
        bound = np.pi if joint == "elbow_joint" else 2.0 * np.pi
        lines += [
            f'  <link name="{link}_link"/>',
            f'  <joint name="{joint}" type="revolute">',
            f"    {_origin(placement)}",
            f'    <parent link="{parent}"/>',
            f'    <child link="{link}_link"/>',
            '    <axis xyz="0 0 1"/>',
            f'    <limit lower="{-bound}" upper="{bound}" effort="1000" velocity="{np.pi}"/>',
            "  </joint>",
        ]
        parent = f"{link}_link"
    half = np.pi / 2.0
    lines += [
        *_fixed("ft_frame", parent, "wrist_3_link-ft_frame", f"{np.pi} 0.0 0.0"),
        *_fixed("flange", parent, "wrist_3-flange", f"0.0 {-half} {-half}"),
        *_fixed("tool0", "flange", "flange-tool0", f"{half} 0.0 {half}"),
        "</robot>",
        "",
    ]
    return "\n".join(lines)


def _fixed(link: str, parent: str | None, joint: str, rpy: str) -> list[str]:
    """A link, and the fixed joint that turns it in its parent."""
    lines = [f'  <link name="{link}"/>']
    if parent is None:
        return lines
    return [
        *lines,
        f'  <joint name="{joint}" type="fixed">',
        f'    <origin xyz="0.0 0.0 0.0" rpy="{rpy}"/>',
        f'    <parent link="{parent}"/>',
        f'    <child link="{link}"/>',
        "  </joint>",
    ]


def _origin(T: Array) -> str:
    """An <origin> with numbers that read back exactly."""
    xyz = " ".join(repr(float(value) + 0.0) for value in T[:3, 3])
    rpy = " ".join(repr(float(value) + 0.0) for value in pin.rpy.matrixToRpy(T[:3, :3]))
    return f'<origin xyz="{xyz}" rpy="{rpy}"/>'
