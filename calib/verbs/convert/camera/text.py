"""The hand-over of a camera as `calib convert` prints it: where the camera and the board are, and how ROS takes it."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array
from calib.camera.lenses import LENSES
from calib.errors import choices
from calib.show.lines import deg, fill, mm, number
from calib.verbs.convert.camera.handover import Handover, PlacedFrame, calibration_of
from calib.verbs.convert.camera.intrinsics import calibrated_camera, numbers_of
from calib.verbs.convert.camera.mount import moved_along
from calib.verbs.convert.camera.static_transform import LAUNCH
from calib.verbs.convert.camera.write import transform_of

if TYPE_CHECKING:
    from calib.verbs.convert.convert import Conversion

#: A mount that is turned by more than this was named by another frame, as a rule [rad].
_TURNED = np.radians(45.0)

#: The formats that place a camera.
_MOUNT = "camera-mount"
_TRANSFORM = "static-transform"

#: Formats of its intrinsics, and what reads them.
_INTRINSICS = {
    "camera-info": "In ROS name it to the driver, as camera_info_url: file://{}.",
    "opencv": "cv2.FileStorage reads it, from Python and C++.",
}

#: Decimals of a number of a lens, by its unit.
_DECIMALS = {"px": 2, "1": 5}


def handover_text(conversion: Conversion) -> list[str]:
    """Word what was handed over of a camera, nothing of other formats.

    Args:
        conversion: The conversion.

    Returns:
        Paragraphs of 100 columns.
    """
    if conversion.format == _MOUNT:
        return [fill(sentence) for sentence in _mount(conversion)]
    if conversion.format == _TRANSFORM:
        return list(_transform(conversion))
    if conversion.format in _INTRINSICS:
        return [fill(sentence) for sentence in _intrinsics(conversion)]
    return []


def concerns_robot(conversion: Conversion) -> bool:
    """Tell if a conversion wrote something of the robot: intrinsics are of the camera alone."""
    return conversion.format not in _INTRINSICS


def _mount(conversion: Conversion) -> Iterator[str]:
    """Word the frames of a URDF, and how MoveIt takes it."""
    handover = Handover.of(conversion.source, conversion.options.camera)
    for frame in handover.frames:
        yield from _placed(frame)
    camera = handover.camera
    if camera is None:
        return
    along = (
        ()
        if camera.T_link_before is None
        else moved_along(handover.urdf, camera.joint.name, camera.link)
    )
    if along:
        yield f"Fixed to it, and moved along: {choices(along)}."
    yield (
        "For tf2 and MoveIt start robot_state_publisher and move_group with this URDF as robot_description. No other "
        f"node may publish '{camera.joint.child}', which has one parent; images and point clouds must come with "
        f"frame_id '{camera.link}'."
    )


def _placed(frame: PlacedFrame) -> Iterator[str]:
    """Word where a frame is, how far it was moved, and that so far is a mistake, as a rule."""
    estimated = frame.estimated
    where = f"'{frame.link}' is at {_pose(estimated.T_link_frame)} in '{estimated.link}'"
    if frame.T_link_before is None:
        yield f"{where}: a new link, fixed by the joint '{frame.joint.name}'."
        return
    length, angle = _distance(frame.T_link_before, estimated.T_link_frame)
    yield (
        f"{where}, {mm(length)} mm and {deg(angle)} deg from where the URDF had it: the origin of "
        f"'{frame.joint.name}' was changed."
    )
    if angle > _TURNED:
        yield (
            f"Is '{frame.link}' the optical frame, with z along the line of sight and x to the right in the image? A "
            "camera's body, with x along the line of sight, is turned by 120 deg from it."
        )


def _transform(conversion: Conversion) -> Iterator[str]:
    """Word the pose that ROS publishes, and how to start it."""
    transform = transform_of(conversion.source, conversion.options.camera)
    yield fill(
        f"'{transform.child}' is at {_pose(transform.T_parent_child)} in '{transform.parent}'. It goes with the "
        "corrected robot; publish it where robot_state_publisher does not have this frame from its URDF: a frame has "
        "one parent. MoveIt reads it from tf2, and needs nothing else; images and point clouds must come with the "
        "frame_id of the camera's optical frame."
    )
    path = shlex.quote(str(conversion.path))
    start = "ros2 launch" if conversion.path.suffix.lower() == LAUNCH else "sh"
    yield f"  {start} {path}"


def _intrinsics(conversion: Conversion) -> Iterator[str]:
    """Word the numbers of a camera with their standard deviations, and what reads the file."""
    calibration = calibration_of(conversion.source)
    camera = calibrated_camera(calibration, conversion.options.camera.camera)
    lens = LENSES[camera.lens]
    sigma = np.zeros(len(lens.names)) if camera.sigma is None else camera.sigma
    parts = []
    for k, (name, unit) in enumerate(zip(lens.names, lens.units, strict=True)):
        decimals = _DECIMALS[unit]
        value = number(float(numbers_of(camera)[k]), decimals)
        parts.append(f"{name} {value} ± {number(float(sigma[k]), decimals)}")
    yield (
        f"Camera '{camera.name}', {camera.width} x {camera.height} px, {camera.lens}, with standard deviations: "
        f"{', '.join(parts)}; fx, fy, cx, cy in px."
    )
    yield _INTRINSICS[conversion.format].format(conversion.path.resolve())


def _pose(T: Array) -> str:
    """Word a pose (4, 4) [m]: x y z, and roll pitch yaw about the fixed axes."""
    place = " ".join(mm(length) for length in T[:3, 3])
    angles = " ".join(deg(angle) for angle in pin.rpy.matrixToRpy(T[:3, :3]))
    return f"x y z = {place} mm, roll pitch yaw = {angles} deg"


def _distance(T_before: Array, T_after: Array) -> tuple[float, float]:
    """Return the distance [m] and the angle [rad] between two poses (4, 4) [m]."""
    length = float(np.linalg.norm(T_after[:3, 3] - T_before[:3, 3]))
    angle = float(np.linalg.norm(pin.log3(T_before[:3, :3].T @ T_after[:3, :3])))
    return length, angle
