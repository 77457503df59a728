"""The corrected URDF of a calibration: read back before it is written, and refused if the verdict is against it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.basics.arrays import Array, rigid_inverse
from calib.errors import ModelError, UrdfError, VerdictError
from calib.model.kinematics import Samples
from calib.result.calibration import Calibration
from calib.result.transforms import has_pose
from calib.robot.joined_urdf import SEPARATOR, path_of_robot
from calib.robot.mjcf_write import WrittenMjcf, check_one_robot, is_mjcf_name, model_of, write_mjcf
from calib.robot.ranges import random_joint_values
from calib.robot.readback import check_written
from calib.robot.urdf import FRAME_LINK, TARGET_LINK, Urdf
from calib.show.verdict_text import do_not_use_text, refusal


class AddedLink(NamedTuple):
    """A link that is added to a URDF, fixed to another."""

    #: Its name
    name: str
    #: The link that it is fixed to
    parent: str
    #: Its pose there, (4, 4) [m]
    T_parent_link: Array


def write_urdf(
    c: Calibration,
    path: str | Path,
    *,
    overwrite: bool = False,
    target_link: bool = False,
    frame_link: bool = False,
    accept: bool = False,
) -> Path:
    """Write the corrected URDF; a verdict against it that is not accepted raises `VerdictError`.

    See `Calibration.write_urdf`.
    """
    verdict_against = do_not_use_text(c.verdict)
    if verdict_against and not accept:
        raise VerdictError(refusal(f"'{path}'", verdict_against))
    if is_mjcf_name(path):
        if target_link or frame_link:
            raise ModelError(
                "Links at targets and frames are added to a URDF; name the file .urdf."
            )
        return write_corrected_mjcf(c, path, overwrite=overwrite).paths[0]
    urdf = checked_urdf(c, target_link=target_link, frame_link=frame_link)
    if c.robot.parts:
        links = added_links(c, target_link=target_link, frame_link=frame_link)
        names = [part.name for part in c.robot.parts if part.name]
        for name, own in c.robot.own_urdfs().items():
            for link in links:
                robot, _, parent = link.parent.rpartition(SEPARATOR)
                if (robot if robot in names else "") == name:
                    own = _with_link(own, link._replace(parent=parent))
            described = own.with_comments(run=c.run, verdict=verdict_against)
            described.write(path_of_robot(path, name), overwrite=overwrite)
    return urdf.write(path, overwrite=overwrite)


def checked_urdf(c: Calibration, *, target_link: bool = False, frame_link: bool = False) -> Urdf:
    """Return the corrected URDF, with links at targets and frames if wanted, after reading it back as a check.

    See `Calibration.checked_urdf`.
    """
    urdf = c.robot.urdf
    for link in added_links(c, target_link=target_link, frame_link=frame_link):
        urdf = _with_link(urdf, link)
    robot = c.robot.with_urdf(urdf)
    q = random_joint_values(robot)
    check_written(robot, _poses_of_fit(c, q), q)
    return urdf


def write_corrected_mjcf(c: Calibration, path: str | Path, *, overwrite: bool) -> WrittenMjcf:
    """Write the corrected MJCF of a calibration of a robot that was read from one, after reading it back.

    Args:
        c: The calibration.
        path: The file.
        overwrite: Whether a file that exists is replaced.

    Raises:
        FileError: The robot is of no MJCF, or a file exists or cannot be written.
        ModelError: The calibration is of several robots.
        UrdfError: calib or MuJoCo reads it otherwise.
    """
    check_one_robot(c.robot)
    model = model_of(c.nominal.urdf, str(path))
    q = random_joint_values(c.robot)
    return write_mjcf(
        model,
        c.robot,
        q,
        _poses_of_fit(c, q),
        path,
        overwrite=overwrite,
        verdict=do_not_use_text(c.verdict),
    )


def _poses_of_fit(c: Calibration, q: Array) -> Array:
    """Return T_base_tip (N, 4, 4) [m] of all chains, one after the other, at readings q (N, m).

    They come straight from the parameters, by the path that the fit took, not through the corrected robot.
    """
    count = len(c.robot.chains)
    chain = np.repeat(np.arange(count), len(q))
    samples = replace(Samples.at(np.tile(q, (count, 1))), chain=chain)
    return np.asarray(c.geometry.tips(samples))


def added_links(
    c: Calibration, *, target_link: bool = False, frame_link: bool = False
) -> list[AddedLink]:
    """Return the links at the targets and at the measurement frames of a result; all if it corrects no robot.

    Args:
        c: The result.
        target_link: Whether there is one at each target, ``calib_target``, or ``calib_target_NAME`` of several.
        frame_link: Whether there is one at each frame that has a pose, ``calib_frame`` or ``calib_frame_NAME``.

    Raises:
        ModelError: No frame has a pose.
    """
    setup = c.setup
    if c.is_setup_only:  # what was located is all that it says
        target_link = True
        frame_link |= any(has_pose(c, f) for f in range(len(setup.groups)))
    links = []
    if target_link:
        tips = setup.target_links or (c.robot.tip,) * len(setup.targets)
        for name, tip, T in zip(setup.targets, tips, setup.T_tip_target, strict=True):
            link = TARGET_LINK if len(tips) == 1 else f"{TARGET_LINK}_{name}"
            links.append(AddedLink(link, tip, T))
    if frame_link:
        bases = setup.frame_links or (c.robot.base,) * len(setup.groups)
        posed = [f for f in range(len(bases)) if has_pose(c, f)]
        if not posed:
            raise ModelError(
                "No row determines the pose of a measurement frame: sockets, anchors and planes have none, and pairs "
                "tell no place. Do without the links of the frames."
            )
        for f in posed:
            link = FRAME_LINK if len(bases) == 1 else f"{FRAME_LINK}_{setup.groups[f]}"
            links.append(AddedLink(link, bases[f], rigid_inverse(setup.T_frame_base[f])))
    return links


def _with_link(urdf: Urdf, link: AddedLink) -> Urdf:
    """Return a URDF with a link; one of an earlier calibration is moved, any other of its name raises `UrdfError`."""
    if link.name not in urdf.links:
        return urdf.with_link(link.name, link.parent, link.T_parent_link)
    joint = next(joint for joint in urdf.joints if joint.child == link.name)
    if joint.parent != link.parent or joint.type != "fixed":
        raise UrdfError(
            f"The URDF has a link '{link.name}' already, not fixed to '{link.parent}' but a child of "
            f"'{joint.parent}' by a {joint.type} joint. Rename it, or do without this link."
        )
    return urdf.with_origins({joint.name: link.T_parent_link})
