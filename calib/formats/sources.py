"""Source: what ``calib convert`` reads, whatever its form, as one robot before and after its calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.errors import CalibError, FileError, ModelError, choices
from calib.formats.origins import Origins, origins_of, read_origins
from calib.formats.universal_robots import UrSource, read_ur_conf, read_ur_yaml
from calib.formats.ur_models import UrModel, ur_model, ur_robot
from calib.formats.ur_mount import recognised, the_mount
from calib.formats.yaml_file import read_yaml
from calib.identify.result import Calibration
from calib.identify.result_file import read_result
from calib.model.readback import spread_poses
from calib.model.robot import Robot
from calib.model.xacro_file import is_xacro

Array = NDArray[np.float64]

UR_CONF, UR_YAML, RESULT, ORIGINS, ROBOT = KINDS = (
    "ur-conf",
    "ur-yaml",
    "result",
    "origins",
    "robot",
)
"""What a source may be."""

#: How each kind of source is told, in words.
_READ = (
    "a calibration.conf or a kinematics.yaml of Universal Robots, a result (.json) of 'calib fit', an origins file "
    "(.yaml), a URDF, a xacro, or the name of a robot such as 'ur3'"
)

#: Origins of one robot differ by less than this [m; entries of the rotation].
_SAME = 1e-6


@dataclass(frozen=True, slots=True)
class Asked:
    """What goes with a source.

    Attributes:
        robot: URDF, xacro or name of the nominal robot.
        ur_model: Name of an arm of Universal Robots.
        urcontrol: Its ``urcontrol.conf``.
        base: Base link; default that of the source.
        tip: Tip link; default that of the source.
        held: Joints that stay where they are [rad or m].
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
        hash: The ROS driver's name for the calibration, where the source is a file of Universal Robots and has it.
        model: Which arm of Universal Robots it is, if one.
        conf: The ``calibration.conf`` that was read, if it is one.
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


def source_kind(source: str) -> str:
    """Which of `KINDS` a source is: by its ending, and a YAML file by its first key.

    Raises:
        FileError: It is none, or cannot be read.
    """
    ending = Path(source).suffix.lower()
    if is_xacro(source) or ending in ("", ".urdf", ".xml"):
        return ROBOT
    if ending in (".conf", ".json"):
        return UR_CONF if ending == ".conf" else RESULT
    if ending in (".yaml", ".yml"):
        keys = tuple(map(str, read_yaml(source, "YAML file")))
        for key, kind in (("kinematics", UR_YAML), ("origins", ORIGINS)):
            if key in keys:
                return kind
        raise FileError(
            f"{source}: it has neither 'kinematics', as a kinematics.yaml of Universal Robots, nor 'origins', as an "
            f"origins file of calib{f'; it has {choices(keys)}' if keys else ''}. Give {_READ}."
        )
    raise FileError(f"{source}: 'calib convert' does not know the ending '{ending}'. Give {_READ}.")


def read_source(source: str, asked: Asked) -> Source:
    """Read what is to be converted.

    Args:
        source: A file, or the name of a robot.
        asked: What goes with it.

    Raises:
        FileError: A file cannot be read, or is none of those that are known.
        UrdfError: A URDF cannot be read or lacks a link or joint.
        ModelError: Things that do not fit each other.
        CalibError: Something was given that the source has no use for.
    """
    kind = source_kind(source)
    if asked.ur_model is not None:
        ur_model(asked.ur_model)  # a name that there is not is said first
    if kind in (UR_CONF, UR_YAML):
        return _universal_robots(source, kind, asked)
    if kind == RESULT:
        return _result(source, asked)
    if kind == ORIGINS:
        return _origins(source, asked)
    return _robot(source, asked)


def _universal_robots(source: str, kind: str, asked: Asked) -> Source:
    """A calibration.conf or a kinematics.yaml, on the robot asked for or on a bare one."""
    told = asked.robot or asked.ur_model or asked.urcontrol
    if kind == UR_CONF and not told:
        raise CalibError(
            f"{source}: a calibration.conf has only what is added to an arm's nominal rows. Say of which arm it is, as "
            "in --ur-model UR5e, or give its --urcontrol, or its nominal URDF as --robot."
        )

    def read(robot: Robot | None) -> UrSource:
        if kind == UR_CONF:
            return read_ur_conf(
                source, urcontrol=asked.urcontrol, model=asked.ur_model, robot=robot
            )
        return read_ur_yaml(source, model=asked.ur_model, robot=robot)

    found = read(None if asked.robot is None else asked.load(asked.robot))
    if asked.robot is None and (asked.base or asked.tip or asked.held):
        bare = found.nominal.urdf
        base, tip = asked.base or found.nominal.base, asked.tip or found.nominal.tip
        found = read(Robot.from_urdf(bare, base, tip, held=asked.held))
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


def _result(source: str, asked: Asked) -> Source:
    """A result of ``calib fit``, on the robot asked for or on the URDF that it holds."""
    result = read_result(source)
    nominal, robot = result.nominal, result.robot
    for option, given, own in (("base", asked.base, nominal.base), ("tip", asked.tip, nominal.tip)):
        if given is not None and given != own:
            raise CalibError(
                f"{source} is the result for --{option} {own}, and '{given}' was given; leave out --{option}."
            )
    if asked.held and dict(asked.held) != nominal.held:
        own = ", ".join(f"'{name}' at {value:g}" for name, value in nominal.held.items()) or "none"
        raise CalibError(f"{source} says itself which joints are held ({own}); leave out --hold.")
    if asked.robot is not None:
        arm = Robot.load(asked.robot, nominal.base, nominal.tip, held=nominal.held)
        nominal, robot = _both_states(result, arm, source)
    remarks = []
    if result.larger is not None:
        remarks.append(
            f"The result has a larger model, '{result.larger.name}', whose joints err with their state: no format "
            "written here can hold that. What is converted is its geometry alone; 'calib compensate' uses all of it."
        )
    return Source(
        RESULT,
        f"result of 'calib fit' for '{robot.name}', '{robot.base}' to '{robot.tip}'",
        robot,
        nominal,
        model=_arm(nominal, asked),
        remarks=tuple(remarks),
    )


def _both_states(result: Calibration, robot: Robot, source: str) -> tuple[Robot, Robot]:
    """A result's nominal and corrected robot, from a URDF of either, whose bytes stay as they are.

    Raises:
        ModelError: It is neither.
    """
    origins, corrected = robot.origins(), result.robot.origins()
    if set(origins) != set(corrected):
        raise ModelError(
            f"{source} has origins of the joints {choices(corrected)}; the chain of the robot given, "
            f"'{robot.base}' to '{robot.tip}' of {robot.urdf.source}, has {choices(origins)}. Give the URDF that the "
            "result was made with as --robot."
        )

    def has(wanted: Mapping[str, Array]) -> bool:
        return all(np.abs(origins[name] - T).max() < _SAME for name, T in wanted.items())

    if has(result.nominal.origins()):
        return robot, result.corrected(robot)
    if has(corrected):
        return result.uncorrected(robot), robot
    off = {name: float(np.abs(origins[name] - T).max()) for name, T in corrected.items()}
    worst = max(off, key=lambda name: off[name])
    raise ModelError(
        f"{source} is of another robot than {robot.urdf.source}: the origin of '{worst}' differs from that of the "
        f"result by {off[worst]:.3g} (m, or entries of the rotation). Give the URDF that the result was made with, or "
        "that was corrected by it, as --robot."
    )


def _origins(source: str, asked: Asked) -> Source:
    """An origins file, on the robot asked for."""
    found = read_origins(source)
    if asked.robot is None:
        raise CalibError(
            f"{source} has the origins of joints alone; give the URDF that they belong to as --robot."
        )
    nominal = asked.load(asked.robot)
    robot = found.applied_to(nominal)
    return Source(
        ORIGINS,
        f"origins of {len(found.joints)} joints, '{robot.base}' to '{robot.tip}' of '{robot.name}'",
        robot,
        nominal,
        model=_arm(nominal, asked),
        remarks=_beside(found, robot),
    )


def _beside(found: Origins, robot: Robot) -> tuple[str, ...]:
    """Say which of the chain's joints a file has no origin of."""
    names = {name for name, _ in found.joints}
    missing = [name for name, _ in origins_of(robot).joints if name not in names]
    if not missing:
        return ()
    return (
        f"The file has no origin of {choices(missing)}, which the chain '{robot.base}' to '{robot.tip}' has: they "
        "stay as they are in the URDF.",
    )


def _robot(source: str, asked: Asked) -> Source:
    """A URDF, a xacro or the name of a robot, held against the nominal one asked for."""
    robot = asked.load(source)
    text = f"'{robot.name}', '{robot.base}' to '{robot.tip}', {len(robot.joints)} joints"
    plain = Source(ROBOT, text, robot, None)
    if asked.robot is not None:
        between = replace(asked, base=robot.base, tip=robot.tip)
        nominal = between.load(asked.robot)
        if [j.name for j in nominal.joints] != [j.name for j in robot.joints]:
            raise ModelError(
                f"{source} has the joints {choices(j.name for j in robot.joints)} between '{robot.base}' and "
                f"'{robot.tip}', and {nominal.urdf.source} has {choices(j.name for j in nominal.joints)}. --robot is "
                "the same robot with its nominal kinematics."
            )
        return replace(plain, nominal=nominal, model=_arm(nominal, asked))
    if recognised(robot):  # an arm with the kinematics of the data sheet is its own nominal robot
        return replace(plain, nominal=robot, model=_arm(robot, asked))
    if asked.ur_model is not None:
        bare = ur_robot(asked.ur_model)
        nominal = _like(robot, bare, source)
        return replace(plain, nominal=nominal, model=ur_model(asked.ur_model))
    return plain


def _like(robot: Robot, bare: Robot, source: str) -> Robot:
    """The bare arm between the robot's links."""
    links, joints = bare.urdf.links, [joint.name for joint in bare.joints]
    own = [joint.name for joint in robot.joints]
    if robot.base not in links or robot.tip not in links or own != joints:
        raise ModelError(
            f"{source}: links and joints from '{robot.base}' to '{robot.tip}' are not named as in Universal Robots' "
            f"description ({choices(links)}; {choices(joints)}). Give the nominal URDF as --robot instead of "
            "--ur-model, or name the links with --base and --tip."
        )
    return bare.rebuilt(base=robot.base, tip=robot.tip)


def _arm(nominal: Robot, asked: Asked) -> UrModel | None:
    """The arm of Universal Robots that a nominal robot is, if it is one.

    Raises:
        ModelError: It is not the one asked for.
    """
    if asked.ur_model is not None:
        return the_mount(nominal, ur_model(asked.ur_model))[0]
    try:
        return the_mount(nominal)[0]
    except ModelError:  # of another maker
        return None
