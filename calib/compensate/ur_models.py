"""The Universal Robots arms: their nominal kinematics, recognised in a URDF."""

from __future__ import annotations

from dataclasses import dataclass

from calib.compensate.ur_dh import FullDH
from calib.model.robot import Robot


@dataclass(frozen=True, slots=True)
class UrModel:
    """One type of arm.

    Attributes:
        name: Such as ``"UR5e"``.
        nominal: Its nominal DH rows.
        default_hash: What the ROS driver makes of these rows.
    """

    name: str
    nominal: FullDH
    default_hash: str


def ur_model(name: str) -> UrModel:
    """The arm of that name, in capitals or not.

    Raises:
        ModelError: There is none.
    """
    raise NotImplementedError


def recognised(robot: Robot) -> tuple[UrModel, ...]:
    """The arms whose nominal kinematics the robot has, up to where its base and its tip are fixed to them."""
    raise NotImplementedError


def ur_robot(model: UrModel | str) -> Robot:
    """A bare URDF of an arm with its nominal kinematics, ``base`` to ``tool0``."""
    raise NotImplementedError
