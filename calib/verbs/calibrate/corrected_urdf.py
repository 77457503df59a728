"""The corrected URDF of a calibration: read back before it is written, and refused if the verdict is against it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from calib.basics.arrays import Array
from calib.errors import ModelError, UrdfError, VerdictError, choices
from calib.model.kinematics import Samples
from calib.result.calibration import Calibration
from calib.robot.ranges import random_joint_values
from calib.robot.readback import check_written
from calib.robot.urdf import TARGET_LINK, Urdf
from calib.show.verdict import against, refusal


def write_urdf(
    c: Calibration,
    path: str | Path,
    *,
    overwrite: bool = False,
    target_link: bool = False,
    accept: bool = False,
) -> Path:
    """Write the corrected URDF; see `Calibration.write_urdf`."""
    verdict_against = against(c.verdict)
    if verdict_against and not accept:
        raise VerdictError(refusal(f"'{path}'", verdict_against))
    return checked_urdf(c, target_link=target_link).write(path, overwrite=overwrite)


def checked_urdf(c: Calibration, *, target_link: bool = False) -> Urdf:
    """Return the URDF that `write_urdf` writes, read back; see `Calibration.checked_urdf`."""
    urdf = c.robot.urdf
    if target_link:
        names = c.setup.targets
        if len(names) > 1:
            raise ModelError(
                f"There are {len(names)} targets, {choices(names)}; a target link can be written for one."
            )
        urdf = _with_target_link(urdf, c.robot.tip, c.setup.T_tip_target[0])
    robot = replace(c.robot, urdf=urdf.with_verdict(against(c.verdict)))
    q = random_joint_values(robot)
    # Straight from the parameters, by the path that the fit took, not through the corrected robot.
    T_base_tip = c.geometry.tips(Samples.at(q))
    check_written(robot, T_base_tip, q)
    return robot.urdf


def _with_target_link(urdf: Urdf, tip: str, T_tip_target: Array) -> Urdf:
    """Return a URDF with a link `TARGET_LINK` fixed to its tip; one of an earlier calibration is moved."""
    if TARGET_LINK not in urdf.links:
        return urdf.with_link(TARGET_LINK, tip, T_tip_target)
    joint = next(joint for joint in urdf.joints if joint.child == TARGET_LINK)
    if joint.parent != tip or joint.type != "fixed":
        raise UrdfError(
            f"The URDF has a link '{TARGET_LINK}' already, not fixed to '{tip}' but a child of "
            f"'{joint.parent}' by a {joint.type} joint. Rename it, or do without the target link."
        )
    return urdf.with_origins({joint.name: T_tip_target})
