"""Frames fixed to links of a URDF: their poses, and the one ``<origin>`` that is changed to give a frame another pose.

The optical frame of a camera, whose pose in the carrying link L a calibration estimates, hangs below the camera's mount
by further fixed joints, which stay. With the moved joint's origin O, its parent link P and its child link C:

    T_L_optical = T_L_P  O  T_C_optical,    O = T_L_P^-1  T_L_optical  T_C_optical^-1
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import reduce

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array, rigid_inverse
from calib.errors import UrdfError, choices
from calib.robot.full_model import full_model, link_frame
from calib.robot.readback import check_close
from calib.robot.urdf import Urdf


def with_moved_mount(urdf: Urdf, link: str, frame: str, joint: str, T_link_frame: Array) -> Urdf:
    """Return a URDF in which a frame has another pose in the link that carries it, by the origin of one joint.

    Args:
        urdf: The URDF.
        link: The link that carries the camera.
        frame: The link that is the optical frame.
        joint: A fixed joint above it, such as `mount_joint` chooses.
        T_link_frame: Pose of the optical frame in the carrying link, shape (4, 4) [m].

    Returns:
        The URDF; all bytes except those of the joint's ``<origin>`` are kept.

    Raises:
        UrdfError: There is no such link, a joint between them moves, or the joint is not between them.
    """
    _check_between(urdf, link, frame, joint)
    moved = urdf.joint(joint)
    T_link_parent = fixed_pose(urdf, link, moved.parent)
    T_child_frame = fixed_pose(urdf, moved.child, frame)
    T_parent_child = rigid_inverse(T_link_parent) @ T_link_frame @ rigid_inverse(T_child_frame)
    return urdf.with_origins({joint: T_parent_child})


def mount_joint(urdf: Urdf, link: str, frame: str, joint: str | None) -> str:
    """Return the joint that moves a camera.

    Args:
        urdf: The URDF.
        link: The link that carries the camera.
        frame: The link that is the optical frame.
        joint: The joint as it was named; None: the only one between them.

    Raises:
        UrdfError: There is no such link, a joint between them moves, the joint is not between them, or there are
            several and none is named.
    """
    if joint is not None:
        _check_between(urdf, link, frame, joint)
        return joint
    _, downwards = _fixed_joints(urdf, link, frame)
    if len(downwards) != 1:
        raise UrdfError(
            f"Between '{link}' and '{frame}' there are the fixed joints {choices(downwards)}; name the one that "
            "the camera is mounted by, whose origin is to be changed: --move JOINT."
        )
    return downwards[0]


def with_fixed_link(urdf: Urdf, name: str, parent: str, T_parent_link: Array) -> Urdf:
    """Return a URDF with a link fixed to another one; one that an earlier hand-over added is moved.

    Args:
        urdf: The URDF.
        name: Name of the link.
        parent: Name of the link that carries it.
        T_parent_link: Its pose in the parent, shape (4, 4) [m].

    Raises:
        UrdfError: There is no link ``parent``, or another link of this name that is not fixed to it.
    """
    if name not in urdf.links:
        return urdf.with_link(name, parent, T_parent_link)
    above = [joint for joint in urdf.joints if joint.child == name]
    if not above or above[0].parent != parent or above[0].type != "fixed":
        place = f"a child of '{above[0].parent}'" if above else "the root"
        raise UrdfError(
            f"{urdf.source} has a link '{name}' already, {place}, not fixed to '{parent}'. Choose another name; or, "
            f"if it is the camera's optical frame, give --camera-frame {name} and --move JOINT."
        )
    return urdf.with_origins({above[0].name: T_parent_link})


def fixed_pose(urdf: Urdf, link: str, frame: str) -> Array:
    """Return the pose of a link in another one to which it is fixed, as the URDF states it, shape (4, 4) [m].

    Args:
        urdf: The URDF.
        link: The link in which the pose is given.
        frame: The link whose pose is given.

    Raises:
        UrdfError: There is no such link, or a joint between them moves.
    """
    upwards, downwards = _fixed_joints(urdf, link, frame)
    return rigid_inverse(_product(urdf, upwards)) @ _product(urdf, downwards)


def moved_along(urdf: Urdf, joint: str, frame: str) -> tuple[str, ...]:
    """Return the links that a joint carries besides those between it and a frame, in the file's order.

    Args:
        urdf: The URDF.
        joint: Name of the joint.
        frame: The link that is the optical frame, below the joint.
    """
    carried = [link for link in urdf.links if joint in urdf.chain(urdf.root, link)[1]]
    _, above_frame = urdf.chain(urdf.root, frame)
    on_the_way = {urdf.joint(name).child for name in above_frame}
    return tuple(link for link in carried if link not in on_the_way)


def _product(urdf: Urdf, joints: Iterable[str]) -> Array:
    """Return the product of the origins of joints, first to last, shape (4, 4) [m]."""
    origins = (urdf.joint(name).T_parent_joint for name in joints)
    return reduce(np.matmul, origins, np.eye(4))


def _fixed_joints(urdf: Urdf, link: str, frame: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the joints from the nearest common ancestor down to a link, and those down to a frame.

    If one of them is not fixed, it raises `UrdfError`.
    """
    upwards, downwards = urdf.chain(link, frame)
    joints = [urdf.joint(name) for name in (*upwards, *downwards)]
    moving = [joint for joint in joints if joint.type != "fixed"]
    if moving:
        words = ", ".join(f"'{joint.name}' ({joint.type})" for joint in moving)
        raise UrdfError(
            f"Between '{link}' and '{frame}' of {urdf.source} move the joints {words}, so that '{frame}' is not "
            f"fixed to '{link}'. Name the optical frame of the camera that '{link}' carries."
        )
    return upwards, downwards


def _check_between(urdf: Urdf, link: str, frame: str, joint: str) -> None:
    """Raise `UrdfError` for a joint that is not between a frame and its nearest common ancestor with a link."""
    upwards, downwards = _fixed_joints(urdf, link, frame)
    if joint in downwards:
        return
    child = urdf.joint(joint).child
    reason = f"does not lie between '{link}' and '{frame}'"
    if joint in upwards or joint in urdf.chain(urdf.root, link)[1]:
        reason = f"carries '{link}' itself, in which the pose of the camera was estimated"
    among = f"allowed are {choices(downwards)}"
    if not downwards:
        among = f"there is no joint between them; calibrate with a link above '{child}' that carries the camera"
    raise UrdfError(f"The joint '{joint}' of {urdf.source} {reason}; {among}.")


def check_fixed_frame(urdf: Urdf, link: str, frame: str, T_link_frame: Array) -> None:
    """Compare the pose of a link in another one, as Pinocchio and calib read it from the URDF, with the wanted one.

    Args:
        urdf: The URDF that is to be written.
        link: The link in which the pose is given.
        frame: The link whose pose is given, fixed to it.
        T_link_frame: The pose, shape (4, 4) [m].

    Raises:
        UrdfError: A reader's pose differs by more than `calib.robot.readback.TOLERANCE`, or it cannot read the URDF.
    """
    written = Urdf.from_bytes(urdf.data, urdf.source)
    poses = {
        "Pinocchio": _by_pinocchio(written, link, frame),
        "calib": fixed_pose(written, link, frame),
    }
    for reader, T_read in poses.items():
        check_close(reader, frame, T_read[None], T_link_frame[None])


def _by_pinocchio(urdf: Urdf, link: str, frame: str) -> Array:
    """Return the pose of a link in another one by Pinocchio, shape (4, 4) [m]."""
    model = full_model(urdf)
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    T_root_link, T_root_frame = (data.oMf[link_frame(model, name)] for name in (link, frame))
    return np.asarray((T_root_link.inverse() * T_root_frame).homogeneous)
