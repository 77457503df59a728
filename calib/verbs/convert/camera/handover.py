"""What is handed over of a calibrated camera: where its optical frame and the board are, and the URDF with both."""

from __future__ import annotations

from dataclasses import dataclass

from calib.basics.arrays import Array
from calib.basics.values import Value
from calib.errors import CalibError, UrdfError, choices
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.robot.urdf_tree import UrdfJoint
from calib.verbs.convert.camera.estimated_frames import (
    EstimatedFrame,
    estimated_board,
    estimated_camera,
)
from calib.verbs.convert.camera.mount import (
    fixed_pose,
    mount_joint,
    with_fixed_link,
    with_moved_mount,
)
from calib.verbs.convert.camera.options import CameraOptions
from calib.verbs.convert.source import Source


@dataclass(frozen=True, slots=True, eq=False)
class PlacedFrame(Value):
    """A frame that was estimated, and the link of the URDF that stands for it."""

    #: The frame as the calibration estimated it.
    estimated: EstimatedFrame
    #: The link that is this frame.
    link: str
    #: The joint whose origin places it, as the new URDF has it.
    joint: UrdfJoint
    #: Its pose in the carrying link as the URDF had it, shape (4, 4) [m]; None of a link that was added.
    T_link_before: Array | None


@dataclass(frozen=True, slots=True, eq=False)
class Handover(Value):
    """A URDF in which a camera, a board or both are at their estimated poses."""

    #: The corrected URDF with these frames.
    urdf: Urdf
    #: The camera's optical frame; None where only a board was wanted.
    camera: PlacedFrame | None
    #: The board; None where only a camera was wanted.
    board: PlacedFrame | None

    @property
    def frames(self) -> tuple[PlacedFrame, ...]:
        """The frames that were placed, the camera's first."""
        return tuple(frame for frame in (self.camera, self.board) if frame is not None)

    @classmethod
    def of(cls, source: Source, options: CameraOptions) -> Handover:
        """Place a camera and a board in the corrected URDF of a calibration.

        Args:
            source: The calibration, its robot corrected: the estimated frames go with the corrected robot.
            options: Names of the camera, the board, links and the joint that is moved.

        Raises:
            CalibError: The source is no calibration, or no link is named.
            ModelError: There is no such camera or board.
            UrdfError: The URDF has no such link or joint, or they do not fit each other.
        """
        calibration = calibration_of(source)
        check_names(options)
        urdf = source.robot.urdf
        camera = board = None
        if options.camera_frame is not None or options.new_camera_frame is not None:
            estimated = estimated_camera(calibration, options.camera)
            urdf, camera = _with_camera(source.robot, urdf, estimated, options)
        if options.new_board_frame is not None:
            estimated = estimated_board(calibration, options.board)
            urdf, board = _with_new_link(urdf, estimated, options.new_board_frame)
        return cls(urdf, camera, board)


def calibration_of(source: Source) -> Calibration:
    """Return the calibration of a source; CalibError if it is none."""
    if source.calibration is None:
        raise CalibError(
            "A camera's mount, pose and intrinsics come from a calibration: give the result of calib calibrate --json."
        )
    return source.calibration


def check_names(options: CameraOptions) -> None:
    """Refuse names that do not go together, and none at all; CalibError says which to give."""
    if options.camera_frame is not None and options.new_camera_frame is not None:
        raise CalibError(
            "--camera-frame names a link that the URDF has, --new-camera-frame one that it lacks; give one of them."
        )
    if options.move is not None and options.camera_frame is None:
        raise CalibError(
            f"--move {options.move}: name the link of the optical frame that the joint moves, --camera-frame LINK."
        )
    if options.board is not None and options.new_board_frame is None:
        raise CalibError(
            f"--board {options.board}: name the link that is added there, --new-board-frame NAME."
        )
    frames = (options.camera_frame, options.new_camera_frame, options.new_board_frame)
    if not any(frames):
        raise CalibError(
            "Name the link of the camera's optical frame: --camera-frame LINK with --move JOINT where the URDF has "
            "the camera, --new-camera-frame NAME where it does not."
        )


def _with_camera(
    robot: Robot, urdf: Urdf, estimated: EstimatedFrame, options: CameraOptions
) -> tuple[Urdf, PlacedFrame]:
    """Return a URDF with the camera where it was estimated, and what was placed."""
    if options.new_camera_frame is not None:
        return _with_new_link(urdf, estimated, options.new_camera_frame)
    frame = options.camera_frame or ""
    if frame not in urdf.links:
        raise UrdfError(
            f"{urdf.source} has no link '{frame}'; its links are {choices(urdf.links)}. --new-camera-frame {frame} "
            f"adds it to '{estimated.link}'."
        )
    joint = mount_joint(urdf, estimated.link, frame, options.move)
    upwards, downwards = urdf.chain(robot.base, robot.tip)
    if joint in (*upwards, *downwards):
        raise UrdfError(
            f"The joint '{joint}' is part of the chain '{robot.base}' to '{robot.tip}' that was calibrated. Name the "
            "joint that the camera alone is mounted by."
        )
    before = fixed_pose(urdf, estimated.link, frame)
    urdf = with_moved_mount(urdf, estimated.link, frame, joint, estimated.T_link_frame)
    return urdf, PlacedFrame(estimated, frame, urdf.joint(joint), before)


def _with_new_link(urdf: Urdf, estimated: EstimatedFrame, name: str) -> tuple[Urdf, PlacedFrame]:
    """Return a URDF with a link at a frame, and what was placed."""
    urdf = with_fixed_link(urdf, name, estimated.link, estimated.T_link_frame)
    joint = next(joint for joint in urdf.joints if joint.child == name)
    return urdf, PlacedFrame(estimated, name, joint, None)
