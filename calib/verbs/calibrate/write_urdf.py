"""The corrected URDF of a calibration: read back before it is written, and refused if the verdict is against it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Array, rigid_inverse
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
    if c.is_setup_only:
        for name, parent, T_parent_link in _located_links(c):
            urdf = _with_fixed_link(urdf, name, parent, T_parent_link)
    if target_link:
        names = c.setup.targets
        if len(names) > 1:
            raise ModelError(
                f"There are {len(names)} targets, {choices(names)}; a target link can be written for one."
            )
        tip = c.setup.target_links[0] if c.setup.target_links else c.robot.tip
        urdf = _with_fixed_link(urdf, TARGET_LINK, tip, c.setup.T_tip_target[0])
    robot = c.robot.with_urdf(urdf)
    q = random_joint_values(robot)
    # Straight from the parameters, by the path that the fit took, not through the corrected robot.
    chain = np.repeat(np.arange(len(robot.chains)), len(q))
    samples = replace(Samples.at(np.tile(q, (len(robot.chains), 1))), chain=chain)
    check_written(robot, c.geometry.tips(samples), q, c.nominal)
    return urdf


def _with_fixed_link(urdf: Urdf, name: str, parent: str, T_parent_link: Array) -> Urdf:
    """Return the URDF with a link fixed to another; one that an earlier calibration added is moved.

    UrdfError if it has another link of this name.
    """
    if name not in urdf.links:
        return urdf.with_link(name, parent, T_parent_link)
    joint = next(joint for joint in urdf.joints if joint.child == name)
    if joint.parent != parent or joint.type != "fixed":
        raise UrdfError(
            f"The URDF has a link '{name}' already, not fixed to '{parent}' but a child of '{joint.parent}' by a "
            f"{joint.type} joint. Rename it, or do without the target link."
        )
    return urdf.with_origins({joint.name: T_parent_link})


def _located_links(c: Calibration) -> Iterator[tuple[str, str, Array]]:
    """Yield name, parent and pose in the parent, (4, 4) [m], of the frames and targets that a result has estimated.

    Frames of sockets, anchors and planes are none of an instrument, and are left out.
    """
    setup = c.setup
    of_image = {registry.get(kind).is_image for kind in c.rows.kinds}
    for f, group in enumerate(setup.groups):
        pairs = zip(c.rows.kinds, c.rows.groups, strict=True)
        kinds = [kind for kind, of_row in pairs if of_row == group]
        is_image = any(registry.get(kind).is_image for kind in kinds)
        if not setup.unknown[f] or not (is_image or registry.get(kinds[0]).tells_place):
            continue
        name = "calib_camera" if is_image else "calib_frame"
        several = len(setup.groups) > 1
        yield (
            f"{name}_{group}" if several else name,
            setup.frame_links[f] if setup.frame_links else c.robot.base,
            rigid_inverse(setup.T_frame_base[f]),
        )
    for t, target in enumerate(setup.targets):
        if setup.target_unknown[t]:
            name = "calib_board" if of_image == {True} else TARGET_LINK
            several = len(setup.targets) > 1
            link = setup.target_links[t] if setup.target_links else c.robot.tip
            yield f"{name}_{target}" if several else name, link, setup.T_tip_target[t]
