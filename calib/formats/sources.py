"""Source: what ``calib convert`` reads, whatever its form, as one robot before and after its calibration."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.compensation.nominal_actual import is_corrected
from calib.errors import CalibError, FileError, ModelError, choices
from calib.files import read_bytes
from calib.formats.origins import origins_of, parse_yaml, read_origins
from calib.formats.universal_robots import read_ur
from calib.formats.ur_arms import UrModel, ur_model, ur_robot
from calib.formats.ur_mount import recognised, the_mount
from calib.result.calibration_file import read_result
from calib.robot.readback import spread_poses
from calib.robot.robot import Robot
from calib.robot.xacro_file import is_xacro

Array = NDArray[np.float64]

UR_CONF, UR_YAML, RESULT, ORIGINS, ROBOT = "ur-conf", "ur-yaml", "result", "origins", "robot"
"""What a source may be."""


@dataclass(frozen=True, slots=True)
class Asked:
    """What goes with a source: the nominal robot (URDF, xacro or name), or the name of an arm of Universal Robots.

    Base and tip are those of the source where they are not named; ``held`` are joints that stay [rad or m].
    """

    robot: str | None = None
    ur_model: str | None = None
    urcontrol: Path | None = None
    base: str | None = None
    tip: str | None = None
    held: Mapping[str, float] | None = None

    def load(self, source: str) -> Robot:
        """A robot between the links asked for."""
        return Robot.load(source, self.base, self.tip, held=self.held)


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """A robot, and what it was before its calibration.

    Attributes:
        kind: One of `KINDS`.
        text: What was read, in a few words: ``"calibration of a UR5e, calib_12345"``.
        robot: The robot.
        nominal: The same chain with nominal kinematics; None where nothing is known of it.
        hash, model, conf: The ROS driver's name for the calibration, which arm of Universal Robots it is, and the
            ``calibration.conf`` that was read; None of other sources.
        remarks: What its reader should know, sentence by sentence.
    """

    kind: str
    text: str
    robot: Robot
    nominal: Robot | None
    hash: str | None = None
    model: UrModel | None = None
    conf: Path | None = None
    remarks: tuple[str, ...] = ()

    def distances(self) -> tuple[Array, Array] | None:
        """How far the tip lies from the nominal robot's, over the joint limits: shape (N,), [m], and (N,), [rad]."""
        if self.nominal is None:
            return None
        q = spread_poses(self.nominal)
        T, S = self.robot.poses(q), self.nominal.poses(q)
        apart = np.linalg.norm(T[:, :3, 3] - S[:, :3, 3], axis=1)
        chord = np.linalg.norm(T[:, :3, :3] - S[:, :3, :3], axis=(1, 2)) / np.sqrt(8.0)
        return apart, 2.0 * np.arcsin(np.clip(chord, 0.0, 1.0))


def _universal_robots(source: str, kind: str, asked: Asked) -> Source:
    """A calibration.conf or a kinematics.yaml, on the robot asked for or on a bare one."""
    given = None if asked.robot is None else asked.load(asked.robot)
    found = read_ur(source, urcontrol=asked.urcontrol, model=asked.ur_model, robot=given)
    if given is None and (asked.base or asked.tip or asked.held):
        bare = found.nominal
        links = asked.base or bare.base, asked.tip or bare.tip
        given = Robot.from_urdf(bare.urdf, *links, held=asked.held)
        found = read_ur(source, urcontrol=asked.urcontrol, model=asked.ur_model, robot=given)
    name = "" if found.hash is None else f", {found.hash}"
    return Source(
        kind,
        f"calibration of {found.model.said}{name}",
        found.robot,
        found.nominal,
        found.hash,
        found.model,
        Path(source) if kind == UR_CONF else None,
        found.remarks,
    )


def _result(source: str, kind: str, asked: Asked) -> Source:
    """A result of ``calib fit``, on the robot asked for, nominal or corrected, or on the URDF that it holds."""
    result = read_result(source)
    nominal, robot = result.nominal, result.robot
    for option, given, own in (("base", asked.base, nominal.base), ("tip", asked.tip, nominal.tip)):
        if given is not None and given != own:
            raise CalibError(
                f"{source} is the result for --{option} {own}, and '{given}' was given; leave out --{option}."
            )
    if asked.held and dict(asked.held) != nominal.held:
        raise CalibError(f"{source} says itself which joints are held; leave out --hold.")
    if asked.robot is not None:
        arm = Robot.load(asked.robot, nominal.base, nominal.tip, held=nominal.held)
        if arm.origins().keys() != robot.origins().keys():
            raise ModelError(
                f"{source} has origins of the joints {choices(robot.origins())}; the chain of the robot given, "
                f"'{arm.base}' to '{arm.tip}' of {arm.urdf.source}, has {choices(arm.origins())}. Give the URDF that "
                "the result was made with as --robot."
            )
        if is_corrected(result, arm):
            nominal, robot = result.uncorrected(arm), arm
        else:
            nominal, robot = arm, result.corrected(arm)
    remarks: tuple[str, ...] = ()
    if result.larger is not None:
        remarks = (
            f"The result has a larger model, '{result.larger.name}', whose joints err with their state: no format "
            "written here can hold that. What is converted is its geometry alone; 'calib compensate' uses all of it.",
        )
    text = f"result of 'calib fit' for '{robot.name}', '{robot.base}' to '{robot.tip}'"
    return Source(kind, text, robot, nominal, model=_arm(nominal, asked), remarks=remarks)


def _origins(source: str, kind: str, asked: Asked) -> Source:
    """An origins file, on the robot asked for."""
    found = read_origins(source)
    if asked.robot is None:
        raise CalibError(
            f"{source} has the origins of joints alone; give the URDF that they belong to as --robot."
        )
    nominal = asked.load(asked.robot)
    robot = found.applied_to(nominal)
    names = {name for name, _ in found.joints}
    missing = [name for name, _ in origins_of(robot).joints if name not in names]
    remark = (
        f"The file has no origin of {choices(missing)}, which the chain '{robot.base}' to '{robot.tip}' has: they stay "
        "as they are in the URDF."
    )
    text = (
        f"origins of {len(found.joints)} joints, '{robot.base}' to '{robot.tip}' of '{robot.name}'"
    )
    remarks = (remark,) * bool(missing)
    return Source(kind, text, robot, nominal, model=_arm(nominal, asked), remarks=remarks)


def _robot(source: str, kind: str, asked: Asked) -> Source:
    """A URDF, a xacro or the name of a robot, held against the nominal one asked for."""
    robot = asked.load(source)
    own = [joint.name for joint in robot.joints]
    nominal = None
    if asked.robot is not None:
        nominal = replace(asked, base=robot.base, tip=robot.tip).load(asked.robot)
        others = [joint.name for joint in nominal.joints]
        if others != own:
            raise ModelError(
                f"{source} has the joints {choices(own)} between '{robot.base}' and '{robot.tip}', and "
                f"{nominal.urdf.source} has {choices(others)}. --robot is the same robot with its nominal kinematics."
            )
    elif recognised(robot):  # an arm with the kinematics of the data sheet is its own nominal robot
        nominal = robot
    elif asked.ur_model is not None:
        bare = ur_robot(asked.ur_model)
        links, joints = bare.urdf.links, [joint.name for joint in bare.joints]
        if robot.base not in links or robot.tip not in links or own != joints:
            raise ModelError(
                f"{source}: links and joints from '{robot.base}' to '{robot.tip}' are not named as in Universal "
                f"Robots' description ({choices(links)}; {choices(joints)}). Give the nominal URDF as --robot instead "
                "of --ur-model, or name the links with --base and --tip."
            )
        nominal = bare.rebuilt(base=robot.base, tip=robot.tip)
    text = f"'{robot.name}', '{robot.base}' to '{robot.tip}', {len(own)} joints"
    model = None if nominal is None else _arm(nominal, asked)
    return Source(kind, text, robot, nominal, model=model)


def _arm(nominal: Robot, asked: Asked) -> UrModel | None:
    """The arm of Universal Robots that a nominal robot is, if it is one; it must be the one asked for."""
    if asked.ur_model is not None:
        return the_mount(nominal, ur_model(asked.ur_model))[0]
    try:
        return the_mount(nominal)[0]
    except ModelError:  # of another maker
        return None


class Kind(NamedTuple):
    """What a source may be: its files' endings, the first key of one in YAML, and the function that reads it."""

    endings: tuple[str, ...]
    key: str
    read: Callable[[str, str, Asked], Source]


YAML = (".yaml", ".yml")

KINDS = {
    UR_CONF: Kind((".conf",), "", _universal_robots),
    UR_YAML: Kind(YAML, "kinematics", _universal_robots),
    RESULT: Kind((".json",), "", _result),
    ORIGINS: Kind(YAML, "origins", _origins),
    ROBOT: Kind(("", ".urdf", ".xml"), "", _robot),
}
"""What can be read, by name; `calib.formats.convert.FORMATS` is what can be written."""


def source_kind(source: str) -> str:
    """Which of `KINDS` a source is: by its ending, and a YAML file by its first key.

    Raises:
        FileError: It is none, or cannot be read.
    """
    ending = "" if is_xacro(source) else Path(source).suffix.lower()
    keys: tuple[str, ...] = ()
    if ending in YAML:
        keys = tuple(map(str, parse_yaml(read_bytes(source, "YAML file"), source, "YAML file")))
    for name, kind in KINDS.items():
        if ending in kind.endings and (not kind.key or kind.key in keys):
            return name
    found = f"its ending is '{ending}'"
    if ending in YAML:
        found = f"it has neither 'kinematics' nor 'origins', but {choices(keys) or 'no keys'}"
    raise FileError(
        f"{source}: this is none of what 'calib convert' reads; {found}. Give a calibration.conf or a kinematics.yaml "
        "of Universal Robots, a result (.json) of 'calib fit', an origins file (.yaml), a URDF, a xacro, or the name "
        "of a robot such as 'ur3'."
    )


def read_source(source: str, asked: Asked) -> Source:
    """Read what is to be converted: a file, or the name of a robot.

    Raises:
        FileError: A file cannot be read, or is none of those that are known.
        UrdfError: A URDF cannot be read or lacks a link or joint.
        ModelError: Things that do not fit each other.
        CalibError: Something was given that the source has no use for.
    """
    kind = source_kind(source)
    if asked.ur_model is not None:
        ur_model(asked.ur_model)  # a name that there is not is said first
    return KINDS[kind].read(source, kind, asked)
