"""Factory kinematics of UFACTORY and Flexiv into robots and back: YAML with the origins of ``joint1``, ``joint2``, ...

    kinematics:
      joint1: {x: 0.0, y: 0.0, z: 0.2671, roll: 0.0, pitch: 0.0, yaw: 0.0005}      # [m], [rad]

The numbers are the ``<origin>`` of the joint of that name in the maker's URDF, after the prefix of its names. Flexiv's
file has the fixed joint ``link7_to_flange`` too, and may have the ``axis`` of a joint. UFACTORY's has no place for a
displacement of the flange after the last axis, which is noted. What is written is read back before it appears.
"""

from __future__ import annotations

import copy
import math
import os
import re
import shlex
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from calib.basics.arrays import Array, rigid_inverse
from calib.basics.files import read_bytes, write_atomically
from calib.errors import FileError, ModelError, choices
from calib.result.calibration import check_same_joints
from calib.robot.arm_models import ARMS, FLEXIV, UFACTORY, ArmModel, Maker, find_arm
from calib.robot.dh_rows import screw
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.convert.format import (
    YAML,
    Conversion,
    Format,
    Note,
    Notes,
    Options,
    Source,
    SourceKind,
    parse_yaml,
)
from calib.verbs.convert.joint_arms import NumberedJoints, arm_robot, check_arm, flange_distance
from calib.verbs.convert.kinematics_tables import (
    POSE_KEYS,
    KinematicsTable,
    find_table,
    pose_entry,
)
from calib.verbs.convert.origins import JointOrigin, with_origins
from calib.verbs.convert.ur_formats import displaced
from calib.verbs.convert.urdf_formats import arm_of

PathLike = str | os.PathLike[str]

#: The file may differ from the robot by this [m and rad].
_EXACT = 1e-9

#: A displacement below this is rounding [m and rad].
_ROUNDING = 1e-12

#: A calibration that moves the flange further may be of another arm [m].
_SUSPECT = 0.01

#: No calibration moves the flange further [m].
_FARTHEST = 0.2

#: An axis may differ from that of the URDF by the rounding of a text [1].
_SAME_AXIS = 1e-4

_WHAT = "kinematics YAML"

_JOINT = re.compile(r"joint[1-9][0-9]*")


class JointYaml(NamedTuple):
    """A file with the origins of joints."""

    #: Its content.
    content: Mapping[Any, Any]
    #: The table of the arm.
    table: KinematicsTable
    #: x, y, z [m], roll, pitch, yaw [rad] of each pose in the table, by its name.
    numbers: Mapping[str, Array]

    @classmethod
    def read(
        cls, path: PathLike, data: bytes | None = None, section: str | None = None
    ) -> JointYaml:
        """Read a file.

        Args:
            path: The file, for messages if ``data`` is given.
            data: The bytes of a file that is not written yet; None: they are read from ``path``.
            section: Which of several arms, see `find_table`; None: the file has one.

        Raises:
            FileError: It cannot be read, lacks these numbers, or has those of several arms.
        """
        given = read_bytes(path, _WHAT) if data is None else data
        content = parse_yaml(given, str(path), _WHAT)
        table = find_table(path, content, section)
        poses = () if table is None else tuple(filter(table.has, table.entries))
        joints = [name for name in poses if _JOINT.fullmatch(name)]
        wanted = [f"joint{i + 1}" for i in range(max(len(joints), 1))]
        missing = [name for name in wanted if name not in joints]
        if table is None or missing:
            raise FileError(
                f"{path}: there is no '{missing[0]}' with x, y, z, roll, pitch and yaw. A file of UFACTORY or Flexiv "
                "has them for joint1, joint2, ... below 'kinematics'."
            )
        return cls(content, table, {name: table.numbers(path, name) for name in poses})

    @property
    def joint_count(self) -> int:
        """Number of joints."""
        return sum(1 for name in self.numbers if _JOINT.fullmatch(name))

    def other_axis(self, axes: Mapping[str, Array]) -> str | None:
        """Return the first joint whose stated axis is not the given one, (3,); None if all that are stated agree."""
        for name, axis in axes.items():
            stated = self.table.entries[name].get("axis")
            if stated is not None and not _is_axis(stated, axis):
                return name
        return None

    def onto(self, path: PathLike, nominal: Robot) -> tuple[Robot, Notes]:
        """Return a robot with these origins.

        Args:
            path: The file, for messages.
            nominal: The robot whose origins they replace, by the joints' names; others stay.

        Returns:
            The robot, and notes on origins that it has no joint for, or that the file does not have.

        Raises:
            ModelError: The robot has other joints.
            FileError: The file states another axis of a joint than the URDF.
        """
        numbered = NumberedJoints.of(nominal)
        if numbered is None or len(numbered.joints) != self.joint_count:
            names = choices(joint.name for joint in nominal.joints)
            raise ModelError(
                f"{path} has joint1 to joint{self.joint_count}; the robot '{nominal.name}' from '{nominal.base}' to "
                f"'{nominal.tip}' must end in joints of these names, after any prefix, but has {names}. Give the "
                "maker's URDF, and its --base and --tip."
            )
        axes = {j.name.removeprefix(numbered.prefix): j.axis for j in numbered.joints}
        other = self.other_axis(axes)
        if other is not None:
            written = " ".join(f"{number:g}" for number in axes[other])
            raise FileError(
                f"{path}: the axis of '{other}' is '{self.table.entries[other]['axis']}', and in the URDF '{written}'. "
                "Give the URDF of the same version of the maker's description."
            )
        stated = {joint.name: joint for joint in nominal.urdf.joints}
        origins = {}
        unused = []
        for name, numbers in self.numbers.items():
            joint = stated.get(numbered.prefix + name)
            if joint is None:
                unused.append(name)
                continue
            x, y, z, roll, pitch, yaw = numbers.tolist()
            origins[joint.name] = JointOrigin((x, y, z), (roll, pitch, yaw))
        notes: Notes = ()
        if unused:
            sentence = "{0} has origins of {1}, which the URDF has no joints for."
            notes += (Note("origins without joint", sentence, (str(path), choices(unused))),)
        return with_origins(nominal, origins), notes


def read_joint_yaml(
    path: PathLike,
    *,
    robot: Robot | None = None,
    arm: ArmModel | None = None,
    section: str | None = None,
) -> Source:
    """Read the arm that a file of UFACTORY or Flexiv describes.

    Args:
        path: The file.
        robot: The nominal robot whose URDF is corrected; None: a bare one of the arm.
        arm: The arm; None: the one with the nearest kinematics.
        section: Which of several arms the file has, see `find_table`; None: it has one.

    Returns:
        The robot and its nominal robot.

    Raises:
        FileError: The file cannot be read, or its numbers are not those of a calibration of this arm.
        ModelError: The robot is another arm.
    """
    file = JointYaml.read(path, section=section)
    if robot is not None:
        if arm is not None:
            check_arm(robot, arm)
        nominal = robot
    else:
        candidates = ARMS if arm is None else (arm,)
        nominal = _nearest(path, file, candidates)
    corrected, notes = file.onto(path, nominal)
    moved = flange_distance(corrected, nominal)
    if moved > _FARTHEST:
        raise FileError(
            f"{path} moves '{nominal.tip}' of '{nominal.name}' by up to {1e3 * moved:.0f} mm; a calibration moves it "
            "by millimetres. Give the URDF of this type of arm, from the maker's description, or its name as --arm."
        )
    if moved > _SUSPECT:
        sentence = (
            "{0} moves the flange by up to {1:.0f} mm; a calibration moves it by millimetres. Check that it is of this "
            "type of arm, {2}."
        )
        notes += (Note("large correction", sentence, (str(path), moved, nominal.name)),)
    model = arm_of(nominal, Options(arm=None if arm is None else arm.name))
    return Source("joint-yaml", corrected, nominal, model=model, content=file, notes=notes)


def _nearest(path: PathLike, file: JointYaml, candidates: tuple[ArmModel, ...]) -> Robot:
    """Return the bare robot of the arm with a file's joints that the file moves least; `FileError` if there is none."""
    robots = []
    for arm in candidates:
        axes = dict(zip(arm.joints, arm.axes, strict=False))
        if len(arm.axes) == file.joint_count and file.other_axis(axes) is None:
            robots.append(arm_robot(arm))
    if not robots:
        names = choices(arm.name for arm in candidates)
        raise FileError(
            f"{path} has {file.joint_count} joints; none of {names} has as many, about these axes. Give the arm's "
            "nominal URDF as --robot."
        )
    return min(robots, key=lambda robot: flange_distance(file.onto(path, robot)[0], robot))


def _is_axis(text: object, axis: Array) -> bool:
    """Return True if an ``axis`` of a file, three numbers in a text or a list, is that of the URDF."""
    words = text if isinstance(text, list) else str(text).split()
    try:
        numbers = np.array([float(word) for word in words])
    except (TypeError, ValueError):
        return False
    return numbers.shape == (3,) and bool(np.abs(numbers - axis).max() < _SAME_AXIS)


# Writing


def joint_yaml(
    maker: Maker, source: Source, path: PathLike, own: JointYaml | None = None
) -> tuple[bytes, Array]:
    """Return a robot as the YAML that its maker's description takes.

    Args:
        maker: The maker.
        source: The robot and its nominal robot.
        path: The file, for messages.
        own: The robot's own file: its other entries stay, and numbers that differ by rounding only; None: the source,
            if it is such a file, else a new one.

    Returns:
        The file, and the displacement of the flange that it cannot hold, in the flange's axes, shape (4, 4) [m]; the
        identity if there is none.

    Raises:
        ModelError: The robot does not have the maker's joints, or the file does not read back.
    """
    robot = source.robot
    numbered = NumberedJoints.of(robot)
    if numbered is None:
        raise ModelError(
            f"{path}: this format is for arms of {maker.name}, whose joints are joint1, joint2, ... after any prefix, "
            f"and '{robot.name}' has {choices(joint.name for joint in robot.joints)}."
        )
    if source.nominal is not None:
        check_same_joints(robot, source.nominal)
    if own is None and isinstance(source.content, JointYaml):
        own = source.content
    names = [joint.name for joint in numbered.joints]
    origins = {name: np.array(robot.urdf.joint(name).T_parent_joint) for name in names}
    mount = _joint_after(robot, names[-1])
    T_tool = np.eye(4)
    left: dict[str, JointOrigin] = {}
    if maker.states_flange:
        flange = numbered.prefix + maker.flange_joint
        if flange in {joint.name for joint in robot.urdf.joints}:
            origins[flange] = np.array(robot.urdf.joint(flange).T_parent_joint)
    elif mount is not None:
        # The joint's frame moves along and about its axis, as far as that brings the flange to its nominal place.
        T_corrected = np.asarray(robot.urdf.joint(mount).T_parent_joint)
        nominal = robot if source.nominal is None else source.nominal
        T_nominal = np.asarray(nominal.urdf.joint(mount).T_parent_joint)
        G = _along_z(T_corrected @ rigid_inverse(T_nominal))
        origins[names[-1]] = origins[names[-1]] @ G
        rest = rigid_inverse(G) @ T_corrected
        T_tool = _rounded(rigid_inverse(T_nominal) @ rest)
        left = {mount: JointOrigin.of(rest)}

    data = _bytes_of(origins, numbered.prefix, own, {j.name: j.axis for j in numbered.joints})
    again = JointYaml.read(path, data, None if own is None else "/".join(own.table.where) or None)
    read_back, _ = again.onto(path, robot)
    q = random_joint_values(robot)
    difference = float(np.abs(with_origins(read_back, left).poses(q) - robot.poses(q)).max())
    if not difference <= _EXACT:
        raise ModelError(
            f"{Path(path).name}: read back, it puts the tip of '{robot.name}' {difference:.1e} m or rad away from the "
            "robot. Only the origins of its joints may have been corrected."
        )
    return data, T_tool


def _bytes_of(
    origins: Mapping[str, Array],
    prefix: str,
    own: JointYaml | None,
    axes: Mapping[str, Array],
) -> bytes:
    """Return the file of joint origins [m] by name, in a copy of the robot's own file if there is one."""
    table: dict[str, Any] = {} if own is None else dict(own.table.entries)
    for name, T in origins.items():
        key = name.removeprefix(prefix)
        like = None if own is None else own.numbers.get(key)
        held = table.get(key, {})
        extra = {k: value for k, value in held.items() if k not in POSE_KEYS}
        axis = axes.get(name)
        if not held and axis is not None and not _is_axis("0 0 1", axis):
            extra = {"axis": " ".join(f"{number:g}" for number in axis)}
        table[key] = pose_entry(T, like) | extra
    content: dict[Any, Any] = {"kinematics": table}
    if own is not None and own.table.where[:1] == ("kinematics",):
        content = copy.deepcopy(dict(own.content))
        inner = content
        for level in own.table.where[:-1]:
            inner = inner[level]
        inner[own.table.where[-1]] = table
    text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=math.inf)
    return f"# Lengths in m, angles in rad, R = Rz(yaw) Ry(pitch) Rx(roll).\n{text}".encode()


def _joint_after(robot: Robot, name: str) -> str | None:
    """Return the first fixed joint after a moving one on the way to the tip; None if the tip is its link."""
    _, names = robot.urdf.chain(robot.base, robot.tip)
    after = names[names.index(name) + 1 :]
    return after[0] if after else None


def _along_z(T: Array) -> Array:
    """Return the motion along and about z nearest to a pose, both (4, 4) [m]."""
    return screw(2, np.arctan2(T[1, 0] - T[0, 1], T[0, 0] + T[1, 1]), T[2, 3])


def _rounded(T: Array) -> Array:
    """Return a pose (4, 4), exactly the identity if it is the identity except for rounding."""
    return np.eye(4) if np.abs(T - np.eye(4)).max() < _ROUNDING else T


_FLANGE_DISPLACED = (
    "Not in the file: the flange lies off by ({0:.6f}, {1:.6f}, {2:.6f}) mm and ({3:.6f}, {4:.6f}, {5:.6f}) mrad "
    "(rotation vector), in the axes of the flange. T_flange_tcp of the tool becomes T_tool T_flange_tcp, where T_tool "
    "is this displacement."
)


def _write(maker: Maker, source: Source, path: Path, options: Options) -> Notes:
    """Write the file of an arm, alone or in a copy of the robot's own file; the note is on the flange."""
    own = None
    if options.update is not None:
        own = JointYaml.read(options.update, section=options.section)
    data, T_tool = joint_yaml(maker, source, path, own)
    write_atomically(path, data, overwrite=options.overwrite)
    return displaced("flange displaced", _FLANGE_DISPLACED, T_tool)


def _type_of(conversion: Conversion) -> str | None:
    """Return the name of the arm that was converted, None if it is not known."""
    model = conversion.source.model
    return model.name if isinstance(model, ArmModel) else None


def _ufactory_launch(conversion: Conversion) -> str:
    """Return the commands that put the file where UFACTORY's description looks for it, and start its driver."""
    name = _type_of(conversion)
    plain = "TYPE" if name is None else name.lower()
    folder = '"$(ros2 pkg prefix --share xarm_description)"/config/kinematics/user'
    return (
        f"  mkdir -p {folder}\n"
        f"  cp {shlex.quote(str(conversion.path))} {folder}/{plain}_kinematics_calib.yaml\n"
        f"  ros2 launch xarm_moveit_config {plain}_moveit_realmove.launch.py robot_ip:=ADDRESS kinematics_suffix:=calib"
    )


def _flexiv_launch(conversion: Conversion) -> str:
    """Return the command that starts Flexiv's driver with the file."""
    name = _type_of(conversion) or "TYPE"
    launch = "rizon" if name.startswith("Rizon") else "flexiv"
    path = shlex.quote(str(conversion.path))
    if not conversion.path.is_absolute():
        path = f'"$PWD"/{path}'
    return (
        f"  ros2 launch flexiv_bringup {launch}.launch.py robot_sn:=SERIAL robot_type:={name} \\\n"
        f"    kinematics_params_file:={path}"
    )


# As formats and a source of a conversion


def _read(source: str, options: Options) -> Source:
    """Read a file onto the given nominal robot, or onto a bare one of the arm with the chain of the options."""
    arm = None if options.arm is None else find_arm(options.arm)
    if arm is not None and not isinstance(arm, ArmModel):
        raise ModelError(
            f"{source} has the joints of UFACTORY or Flexiv, not those of a {arm.name}."
        )
    given = None if options.robot is None else options.load(options.robot)
    result = read_joint_yaml(source, robot=given, arm=arm, section=options.section)
    return result if given is not None else options.on_chain(result)


def _format(maker: Maker, launch: Callable[[Conversion], str]) -> Format:
    """Return the registry row of a maker."""
    return Format(
        f"kinematics YAML of {maker.name}'s description",
        YAML,
        partial(_write, maker),
        updates=True,
        command=launch,
    )


FORMATS = {
    "ufactory-yaml": _format(UFACTORY, _ufactory_launch),
    "flexiv-yaml": _format(FLEXIV, _flexiv_launch),
}

KINDS = {"joint-yaml": SourceKind(YAML, "joint1", _read)}
