"""Corrections of joint origins as PAL Robotics' robots apply them to their URDF: ``master_calibration.yaml``.

    robot_state_publisher:
      geometric_calibration:
        arm_right_2_dx: 0.0004        # of the joint arm_right_2_joint

Each number is added to the ``<origin>`` as it is written: dx, dy, dz to xyz [m], droll, dpitch, dyaw to rpy [rad]. PAL
publishes no description; this is the form in use on TIAGo Pro, as FIGAROH writes it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import yaml

from calib.basics.arrays import Array
from calib.basics.files import write_atomically
from calib.errors import CalibError, FileError
from calib.verbs.convert.format import YAML, Format, Notes, Options, Source, parse_yaml
from calib.verbs.convert.origins import JointOrigin, origins_of

#: Names of the numbers of a joint, in the order of xyz and rpy.
_ENDINGS = ("dx", "dy", "dz", "droll", "dpitch", "dyaw")

#: Ending of the joints' names that the keys leave out.
_JOINT = "_joint"

#: A change of an origin below this is not written [m or rad].
_LEAST = 1e-12

#: Origins with their corrections agree with those of the corrected robot to this [m; rotation matrices: 1].
_TOLERANCE = 1e-9


def _write(source: Source, path: Path, options: Options) -> Notes:
    """Write the corrections of a robot's joint origins as PAL Robotics' robots read them, in m and rad."""
    if source.nominal is None:
        raise CalibError(
            f"{path}: corrections are added to the URDF that the robot runs; give it as --robot."
        )
    nominal, corrected = origins_of(source.nominal), origins_of(source.robot)
    numbers: dict[str, float] = {}
    for name, origin in nominal.items():
        changes = origin_change(origin, corrected[name].T_parent_joint)
        for ending, change in zip(_ENDINGS, changes.tolist(), strict=True):
            if abs(change) > _LEAST:
                numbers[f"{name.removesuffix(_JOINT)}_{ending}"] = change
    table = {"robot_state_publisher": {"geometric_calibration": numbers}}
    text = yaml.safe_dump(table, sort_keys=False, allow_unicode=True, width=math.inf)
    data = f"# Added to the <origin> of each joint [m, rad], by calib.\n{text}".encode()
    for name, origin in applied(nominal, data, path).items():
        if np.abs(origin.T_parent_joint - corrected[name].T_parent_joint).max() > _TOLERANCE:
            raise FileError(
                f"{path}: the correction of '{name}' does not read back; rename the joint in the URDF."
            )
    write_atomically(path, data, overwrite=options.overwrite)
    return ()


def origin_change(origin: JointOrigin, T_parent_joint: Array) -> Array:
    """Return the numbers to add to an ``<origin>`` as it is written, so that it becomes a pose.

        Rz(yaw + dyaw) Ry(pitch + dpitch) Rx(roll + droll) = R

    Args:
        origin: The origin.
        T_parent_joint: Shape (4, 4), [m], the pose that it becomes.

    Returns:
        dx, dy, dz [m], droll, dpitch, dyaw [rad], shape (6,), with the nearer of the two triples of angles that give
        the rotation. If pitch is a right angle, roll and yaw may change by much, in opposite directions.
    """
    corrected = JointOrigin.of(T_parent_joint)
    roll, pitch, yaw = corrected.rpy
    triples = np.array([corrected.rpy, (roll + math.pi, math.pi - pitch, yaw + math.pi)])
    turns = triples - origin.rpy
    turns -= 2.0 * math.pi * np.round(turns / (2.0 * math.pi))
    nearer = turns[np.argmin(np.abs(turns).sum(axis=1))]
    return np.concatenate([np.subtract(corrected.xyz, origin.xyz), nearer])


def applied(
    origins: Mapping[str, JointOrigin], data: bytes, path: str | Path
) -> dict[str, JointOrigin]:
    """Return origins with the corrections of a file.

    Args:
        origins: The origins as the URDF has them, by the joints' names.
        data: The file.
        path: Its name, for messages.

    Raises:
        FileError: It has no such corrections.
    """
    section = parse_yaml(data, str(path), "master_calibration.yaml").get("robot_state_publisher")
    numbers = section.get("geometric_calibration") if isinstance(section, dict) else None
    if not isinstance(numbers, dict):
        raise FileError(f"{path}: it has no robot_state_publisher: geometric_calibration.")
    result = {}
    for name, origin in origins.items():
        keys = [f"{name.removesuffix(_JOINT)}_{ending}" for ending in _ENDINGS]
        changes = [float(numbers.get(key, 0.0)) for key in keys]
        xyz_rpy = np.add([*origin.xyz, *origin.rpy], changes).tolist()
        result[name] = JointOrigin(tuple(xyz_rpy[:3]), tuple(xyz_rpy[3:]))
    return result


FORMATS = {"pal": Format("geometric_calibration of PAL's robots", YAML, _write)}
