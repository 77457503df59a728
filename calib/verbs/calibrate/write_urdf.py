"""The corrected URDF of a calibration: read back before it is written, and refused if the verdict is against it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.errors import ModelError, UrdfError, VerdictError, choices
from calib.model.kinematics import Samples
from calib.result.calibration import Calibration
from calib.robot.ranges import random_joint_values
from calib.robot.readback import check_written
from calib.robot.urdf import TARGET_LINK, Urdf
from calib.show.verdict_text import do_not_use_text, refusal


def write_urdf(
    c: Calibration,
    path: str | Path,
    *,
    overwrite: bool = False,
    target_link: bool = False,
    accept: bool = False,
) -> Path:
    """Write the corrected URDF; a verdict against it that is not accepted raises `VerdictError`.

    See `Calibration.write_urdf`.
    """
    verdict_against = do_not_use_text(c.verdict)
    if verdict_against and not accept:
        raise VerdictError(refusal(f"'{path}'", verdict_against))
    urdf = checked_urdf(c, target_link=target_link)
    if c.robot.parts:
        for name, own in c.robot.own_urdfs().items():
            described = own.with_comments(run=c.run, verdict=verdict_against)
            described.write(path_of_robot(path, name), overwrite=overwrite)
    return urdf.write(path, overwrite=overwrite)


def path_of_robot(path: str | Path, name: str) -> Path:
    """Return the path of the URDF of one robot of a cell: ``cell_right.urdf`` of ``right`` beside ``cell.urdf``.

    Args:
        path: That of the cell's URDF.
        name: The robot's name; empty for the first, ``cell_first.urdf``.
    """
    of_cell = Path(path)
    return of_cell.with_name(f"{of_cell.stem}_{name or 'first'}{of_cell.suffix}")


def checked_urdf(c: Calibration, *, target_link: bool = False) -> Urdf:
    """Return the corrected URDF, with a link at the target if wanted, after reading it back as a check.

    A link for one of several targets raises `ModelError`; see `Calibration.checked_urdf`.
    """
    urdf = c.robot.urdf
    if target_link:
        names = c.setup.targets
        if len(names) > 1:
            raise ModelError(
                f"There are {len(names)} targets, {choices(names)}; a target link can be written for one."
            )
        tip = c.setup.target_links[0] if c.setup.target_links else c.robot.tip
        T_tip_target = c.setup.T_tip_target[0]
        if TARGET_LINK not in urdf.links:
            urdf = urdf.with_link(TARGET_LINK, tip, T_tip_target)
        else:
            # A link of an earlier calibration is moved.
            joint = next(joint for joint in urdf.joints if joint.child == TARGET_LINK)
            if joint.parent != tip or joint.type != "fixed":
                raise UrdfError(
                    f"The URDF has a link '{TARGET_LINK}' already, not fixed to '{tip}' but a child of "
                    f"'{joint.parent}' by a {joint.type} joint. Rename it, or do without the target link."
                )
            urdf = urdf.with_origins({joint.name: T_tip_target})
    robot = c.robot.with_urdf(urdf)
    q = random_joint_values(robot)
    # Straight from the parameters, by the path that the fit took, not through the corrected robot.
    chain = np.repeat(np.arange(len(robot.chains)), len(q))
    samples = replace(Samples.at(np.tile(q, (len(robot.chains), 1))), chain=chain)
    check_written(robot, c.geometry.tips(samples), q, c.nominal)
    return urdf
