"""Write what is handed over of a camera, each file read back before it appears: the URDF, or the pose for ROS 2."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from calib.basics.files import write_atomically
from calib.errors import CalibError
from calib.verbs.convert.camera.estimated_frames import estimated_board, estimated_camera
from calib.verbs.convert.camera.handover import Handover, calibration_of, check_names
from calib.verbs.convert.camera.options import CameraOptions
from calib.verbs.convert.camera.readback import check_fixed_frame
from calib.verbs.convert.camera.static_transform import StaticTransform, file_of
from calib.verbs.convert.source import Options, Source


def mounted(source: Source, options: Options) -> Source:
    """Return a calibration whose URDF has the camera and the board where they were estimated, read back.

    Args:
        source: The calibration.
        options: ``camera``, the names of the frames.

    Raises:
        CalibError: See `Handover.of`.
        UrdfError: A reader of the URDF has a frame elsewhere.
    """
    handover = Handover.of(source, options.camera)
    for frame in handover.frames:
        estimated = frame.estimated
        check_fixed_frame(handover.urdf, estimated.link, frame.link, estimated.T_link_frame)
    return replace(source, robot=replace(source.robot, urdf=handover.urdf))


def write_static_transform(source: Source, path: Path, options: Options) -> None:
    """Write the call of static_transform_publisher, or a launch file, that publishes the pose of a camera or a board.

    Args:
        source: The calibration.
        path: The file, a shell script or a launch file by its ending.
        options: ``camera``, the names of the frames, and ``overwrite``.

    Raises:
        CalibError: See `transform_of`.
        FileError: The file exists, or cannot be written.
    """
    transform = transform_of(source, options.camera)
    about = f"Pose of '{transform.child}' in '{transform.parent}' of {source.robot.name}, calibrated by calib."
    data = file_of(transform, about, path)
    write_atomically(path, data, overwrite=options.overwrite)


def transform_of(source: Source, options: CameraOptions) -> StaticTransform:
    """Return the pose to publish: of the joint that is moved, else of the frame in the link that carries it.

    Args:
        source: The calibration.
        options: Names of the camera or the board, and of the joint if one of the URDF is published with a new origin.

    Raises:
        CalibError: The source is no calibration; a camera and a board at once, or none.
        ModelError: There is no such camera or board.
        UrdfError: See `calib.verbs.convert.camera.mount.mount_joint`.
    """
    check_names(options)
    camera_frame = options.camera_frame or options.new_camera_frame
    if camera_frame is not None and options.new_board_frame is not None:
        raise CalibError(
            "One file publishes one frame: give --camera-frame for the camera, or --new-board-frame alone for the "
            "board."
        )
    if options.move is not None:
        placed = Handover.of(source, options).frames[0]
        joint = placed.joint
        return StaticTransform(joint.parent, joint.child, joint.T_parent_joint)
    calibration = calibration_of(source)
    if camera_frame is not None:
        estimated = estimated_camera(calibration, options.camera)
    else:
        estimated = estimated_board(calibration, options.board)
    child = camera_frame or options.new_board_frame or ""
    return StaticTransform(estimated.link, child, estimated.T_link_frame)
