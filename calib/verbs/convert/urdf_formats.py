"""Results and robots as sources of a conversion, and the URDF that is written of either."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.data.inputs import RobotInput, chain_of
from calib.errors import CalibError, ModelError
from calib.result.calibration import Calibration, check_same_joints, is_corrected
from calib.result.calibration_file import read_result
from calib.robot.arm_models import ArmModel, find_arm
from calib.robot.coupled_readings import coupling_lines
from calib.robot.ranges import random_joint_values
from calib.robot.readback import check_written
from calib.robot.robot import Robot
from calib.robot.ur_models import UrModel
from calib.verbs.convert.format import Format, Note, Notes, Options, Source, SourceKind
from calib.verbs.convert.joint_arms import arm_robot, check_arm, is_nominal, known_arm
from calib.verbs.convert.ur_arms import Mount, the_mount, ur_robot


def result_source(result: Calibration, options: Options, name: str) -> Source:
    """Return a result as a source, on the given robot, nominal or corrected, or on the URDF that it holds.

    A non-geometric model is left out, which a note says.

    Args:
        result: The result.
        options: Options of the conversion: the robot, and which arm it is. Base, tip and held joints are the result's.
        name: Name of the result in messages.

    Raises:
        CalibError: The options name another chain.
    """
    nominal = result.nominal
    robot = result.robot
    links = (options.base or nominal.base, options.tip or nominal.tip)
    has_other_links = links != (nominal.base, nominal.tip)
    has_other_held = options.held and options.held != nominal.held
    if has_other_links or has_other_held:
        raise CalibError(
            f"{name} holds base, tip and held joints; leave out --base, --tip and --hold."
        )
    if options.robot is not None:
        chain = chain_of(nominal)
        chain_of_result = replace(
            options, base=chain.base, tip=chain.tip, held=chain.held, coupling=chain.coupling
        )
        arm = chain_of_result.load(options.robot)
        if is_corrected(result, arm):
            nominal, robot = result.uncorrected(arm), arm
        else:
            nominal, robot = arm, result.corrected(arm)
    notes: Notes = ()
    if result.non_geometric is not None:
        sentence = (
            "The result's non-geometric model '{0}' is not converted: no format written here holds it. "
            "'calib compensate' uses it."
        )
        notes = (Note("geometry alone", sentence, (result.non_geometric.name,)),)
    return Source(
        "result",
        robot,
        nominal,
        model=arm_of(nominal, options),
        notes=notes,
        verdict=result.verdict,
        calibration=result,
    )


def robot_source(given: RobotInput, options: Options) -> Source:
    """Return a robot, or the one in a URDF, a xacro or of a name, as a source beside the given nominal one.

    Args:
        given: The robot, the path of its file, or its name.
        options: The nominal robot, base and tip, and the name of the arm, if they are given. Without a nominal
            robot it is the bare arm that is named; a robot that is a known arm as on its data sheet is its own.

    Raises:
        UrdfError: A URDF cannot be read.
        ModelError: The robots have different joints, or are not the arm that is named.
    """
    robot = options.load(given)
    nominal = None
    if options.robot is not None:
        nominal = replace(options, base=robot.base, tip=robot.tip).load(options.robot)
        check_same_joints(robot, nominal)
    else:
        mount = _mount(robot)
        arm = None if options.arm is None else find_arm(options.arm)
        if is_nominal(robot) if mount is None else mount.nominal:
            nominal = robot  # an arm with the kinematics of the data sheet is its own nominal robot
        elif arm is not None:
            bare = ur_robot(arm) if isinstance(arm, UrModel) else arm_robot(arm)
            nominal = bare.rebuilt(base=robot.base, tip=robot.tip)
    model = known_arm(robot) if nominal is None else arm_of(nominal, options)
    return Source("robot", robot, nominal, model=model)


def arm_of(nominal: Robot, options: Options) -> UrModel | ArmModel | None:
    """Return the arm that a nominal robot is; None if it is none that calib knows.

    Args:
        nominal: The nominal robot.
        options: The name of the arm, if it is given.

    Raises:
        ModelError: It is not the arm that the options name.
    """
    if options.arm is not None:
        arm = find_arm(options.arm)
        if isinstance(arm, UrModel):
            return the_mount(nominal, arm).model
        check_arm(nominal, arm)
        return arm
    mount = _mount(nominal)
    return known_arm(nominal) if mount is None else mount.model


def _mount(robot: Robot) -> Mount | None:
    """Return how a robot is mounted as an arm of Universal Robots; None if it is of another maker."""
    try:
        return the_mount(robot)
    except ModelError:
        return None


def write_urdf(source: Source, path: Path, options: Options) -> Notes:
    """Write the URDF of a robot, or with another nominal robot that one's URDF with the robot's placements.

    It is read back by Pinocchio and calib first. The note is on coupled readings, which a URDF does not hold.
    """
    robot = source.robot
    q = random_joint_values(robot)
    written = robot
    if source.kind == "robot" and source.nominal is not None:
        written = source.nominal.with_placements(robot.placements)
    stated = {"run": robot.urdf.run, "verdict": robot.urdf.verdict}
    written = written.with_urdf(written.urdf.with_comments(**stated))
    poses = np.concatenate([chain.poses(q) for chain in robot.chains])
    check_written(written, poses, q)
    written.urdf.write(path, overwrite=options.overwrite)
    coupled = robot.reading_coupling
    if not coupled:
        return ()
    known = "" if written.urdf.dh is None else ", or the rows in a comment of the URDF do"
    sentence = (
        "The joints of the URDF are at their angles, not at the controller's readings. For calib the cell file says "
        "{0}{1}."
    )
    return (Note("coupled readings", sentence, (coupling_lines(coupled), known)),)


FORMATS = {"urdf": Format("the URDF", (".urdf",), write_urdf)}

KINDS = {
    "result": SourceKind(
        (".json",),
        "",
        lambda source, options: result_source(read_result(source), options, source),
    ),
    "robot": SourceKind(("", ".urdf", ".xml", ".mjcf", ".sdf"), "", robot_source),
}
