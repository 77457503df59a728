"""The format ``camera-mount``: the corrected URDF with a camera, a board or both at their estimated poses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array
from calib.basics.values import Value
from calib.errors import CalibError, UrdfError, choices
from calib.robot.urdf import Urdf
from calib.robot.urdf_tree import UrdfJoint
from calib.show.lines import deg, fill, mm
from calib.verbs.convert.camera_frames import (
    EstimatedFrame,
    check_names,
    estimated_board,
    estimated_camera,
)
from calib.verbs.convert.fixed_frames import (
    check_fixed_frame,
    fixed_pose,
    mount_joint,
    moved_along,
    with_fixed_link,
    with_moved_mount,
)
from calib.verbs.convert.format import CameraOptions, Conversion, Format, Options, Source
from calib.verbs.convert.urdf_formats import write_urdf

#: A mount that is turned by more than this was probably named by another frame [rad].
_TURNED = np.radians(45.0)


@dataclass(frozen=True, slots=True, eq=False)
class PlacedFrame(Value):
    """A frame that was estimated, and the link of the URDF that stands for it."""

    #: The frame as the calibration estimated it.
    estimated: EstimatedFrame
    #: The link that is this frame.
    link: str
    #: The joint whose origin places it, as the new URDF has it.
    joint: UrdfJoint
    #: Its pose in the carrying link as the URDF had it, shape (4, 4) [m]; None for a link that was added.
    T_link_before: Array | None


@dataclass(frozen=True, slots=True, eq=False)
class Handover(Value):
    """A URDF in which a camera, a board or both are at their estimated poses."""

    #: The corrected URDF with these frames.
    urdf: Urdf
    #: The camera's optical frame; None if only a board was wanted.
    camera: PlacedFrame | None
    #: The board; None if only a camera was wanted.
    board: PlacedFrame | None

    @property
    def frames(self) -> tuple[PlacedFrame, ...]:
        """The frames that were placed, the camera's first."""
        return tuple(frame for frame in (self.camera, self.board) if frame is not None)

    @classmethod
    def of(cls, source: Source, options: CameraOptions) -> Handover:
        """Place a camera and a board in the corrected URDF of a calibration.

        Args:
            source: The calibration; the estimated frames go with its corrected robot.
            options: Names of the camera, the board, links and the joint that is moved.

        Raises:
            CalibError: The source is not a calibration, or no link is named.
            ModelError: There is no such camera or board.
            UrdfError: The URDF has no such link or joint, or they do not fit each other.
        """
        calibration = source.require_calibration()
        check_names(options)
        if options.parent is not None:
            raise CalibError(
                "--parent and --child name a transform that is published: --to static-transform. Into the URDF come "
                "frames with --frame-link and --target-link of calib calibrate."
            )
        robot = source.robot
        urdf = robot.urdf
        camera = board = None
        if options.new_camera_frame is not None:
            estimated = estimated_camera(calibration, options.camera)
            urdf, camera = _with_new_link(urdf, estimated, options.new_camera_frame)
        elif options.camera_frame is not None:
            estimated = estimated_camera(calibration, options.camera)
            frame = options.camera_frame
            if frame not in urdf.links:
                raise UrdfError(
                    f"{urdf.source} has no link '{frame}'; its links are {choices(urdf.links)}. --new-camera-frame "
                    f"{frame} adds it to '{estimated.link}'."
                )
            joint = mount_joint(urdf, estimated.link, frame, options.move)
            upwards, downwards = urdf.chain(robot.base, robot.tip)
            if joint in (*upwards, *downwards):
                raise UrdfError(
                    f"The joint '{joint}' is part of the chain '{robot.base}' to '{robot.tip}' that was calibrated. "
                    "Name the joint that the camera alone is mounted by."
                )
            before = fixed_pose(urdf, estimated.link, frame)
            urdf = with_moved_mount(urdf, estimated.link, frame, joint, estimated.T_link_frame)
            camera = PlacedFrame(estimated, frame, urdf.joint(joint), before)
        if options.new_board_frame is not None:
            estimated = estimated_board(calibration, options.board)
            urdf, board = _with_new_link(urdf, estimated, options.new_board_frame)
        return cls(urdf, camera, board)


def _with_new_link(urdf: Urdf, estimated: EstimatedFrame, name: str) -> tuple[Urdf, PlacedFrame]:
    """Return a URDF with a link of this name fixed at an estimated frame, and the frame with its link and joint.

    A link of this name that is fixed to the same parent is moved; any other raises `UrdfError`.
    """
    urdf = with_fixed_link(urdf, name, estimated.link, estimated.T_link_frame)
    joint = next(joint for joint in urdf.joints if joint.child == name)
    return urdf, PlacedFrame(estimated, name, joint, None)


def mounted(source: Source, options: Options) -> Source:
    """Return a calibration whose URDF has the camera and the board at their estimated poses, read back.

    Args:
        source: The calibration.
        options: ``camera``, the names of the frames.

    Raises:
        CalibError: The source is not a calibration, no link is named, or there is no such camera, board, link or joint.
        UrdfError: A reader of the URDF has a frame at another pose.
    """
    handover = Handover.of(source, options.camera)
    for frame in handover.frames:
        estimated = frame.estimated
        check_fixed_frame(handover.urdf, estimated.link, frame.link, estimated.T_link_frame)
    return replace(source, robot=replace(source.robot, urdf=handover.urdf))


# In words


def pose_text(T: Array) -> str:
    """Word a pose (4, 4) [m]: x y z in mm, and roll pitch yaw about the fixed axes in deg."""
    place = " ".join(mm(length) for length in T[:3, 3])
    angles = " ".join(deg(angle) for angle in pin.rpy.matrixToRpy(T[:3, :3]))
    return f"x y z = {place} mm, roll pitch yaw = {angles} deg"


def mount_text(conversion: Conversion) -> list[str]:
    """Word the frames of a URDF, and what MoveIt needs.

    Args:
        conversion: The conversion, to ``camera-mount``.

    Returns:
        Paragraphs of 100 columns.
    """
    handover = Handover.of(conversion.source, conversion.options.camera)
    sentences = [sentence for frame in handover.frames for sentence in _placed(frame)]
    camera = handover.camera
    if camera is not None:
        if camera.T_link_before is not None:
            along = moved_along(handover.urdf, camera.joint.name, camera.link)
            if along:
                sentences.append(f"Fixed to it, and moved along: {choices(along)}.")
        sentences.append(
            "For tf2 and MoveIt start robot_state_publisher and move_group with this URDF as robot_description. No "
            f"other node may publish '{camera.joint.child}', which has one parent; images and point clouds must come "
            f"with frame_id '{camera.link}'."
        )
    return [fill(sentence) for sentence in sentences]


def _placed(frame: PlacedFrame) -> Iterator[str]:
    """Word the pose of a frame and its distance from the former one, and ask about a rotation that looks wrong."""
    estimated = frame.estimated
    T_before, T_after = frame.T_link_before, estimated.T_link_frame
    where = f"'{frame.link}' is at {pose_text(T_after)} in '{estimated.link}'"
    if T_before is None:
        yield f"{where}: a new link, fixed by the joint '{frame.joint.name}'."
        return
    length = float(np.linalg.norm(T_after[:3, 3] - T_before[:3, 3]))
    angle = float(np.linalg.norm(pin.log3(T_before[:3, :3].T @ T_after[:3, :3])))
    yield (
        f"{where}, {mm(length)} mm and {deg(angle)} deg from where the URDF had it: the origin of "
        f"'{frame.joint.name}' was changed."
    )
    if angle > _TURNED:
        yield (
            f"Is '{frame.link}' the optical frame, with z along the line of sight and x to the right in the image? A "
            "camera's body, with x along the line of sight, is turned by 120 deg from it."
        )


FORMATS = {
    "camera-mount": Format(
        "the URDF with the calibrated mount of the camera",
        (),
        lambda source, path, options: write_urdf(mounted(source, options), path, options),
        of_camera=True,
        describe=mount_text,
    )
}
