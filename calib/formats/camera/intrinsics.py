"""The calibrated intrinsics of a camera as files of ROS and OpenCV, each read back before it appears."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from calib.camera.camera import Camera
from calib.camera.camera_file import camera_info_yaml, opencv_yaml
from calib.camera.camera_yaml import camera_of_yaml
from calib.errors import CalibError, FileError, ModelError, choices, did_you_mean
from calib.files import write_atomically
from calib.formats.camera.handover import calibration_of
from calib.formats.camera.options import CameraOptions
from calib.formats.source import Options, Source
from calib.mappings import ReadOnlyMapping

#: The text of a camera, by the name of the format.
_TEXTS: Mapping[str, Callable[[Camera], str]] = ReadOnlyMapping(
    {"camera-info": camera_info_yaml, "opencv-camera": opencv_yaml}
)


def write_intrinsics(name: str, source: Source, path: Path, options: Options) -> None:
    """Write the intrinsics of a camera of a calibration.

    Args:
        name: The format: ``"camera-info"`` of ROS, or ``"opencv-camera"``.
        source: The calibration.
        path: The file.
        options: ``camera``, which camera it is, and ``overwrite``.

    Raises:
        CalibError: The source is no calibration, or links were named, which the file does not have.
        ModelError: There is no such camera, or the calibration is not one by images.
        FileError: The file exists, cannot be written, or does not read back.
    """
    chosen = options.camera
    if chosen != CameraOptions(camera=chosen.camera):
        raise CalibError(
            f"{path}: a file of intrinsics has no links; of the camera's options it takes --camera alone."
        )
    camera = one_camera(calibration_of(source).cameras, chosen.camera)
    text = _TEXTS[name](camera)
    _check_text(text, camera, path)
    write_atomically(path, text.encode(), overwrite=options.overwrite)


def one_camera(cameras: Mapping[str, Camera], name: str | None) -> Camera:
    """Return a camera by its name, or of None the only one.

    Args:
        cameras: Calibrated cameras by the names of their stations.
        name: The name.

    Raises:
        ModelError: There is no such camera, or several and none is named.
    """
    if not cameras:
        raise ModelError(
            "This result has no camera: it was not calibrated with images of a board (kind 'pixel')."
        )
    if name is None:
        if len(cameras) > 1:
            raise ModelError(
                f"There are {len(cameras)} cameras: {choices(cameras)}; name one with --camera."
            )
        return next(iter(cameras.values()))
    if name not in cameras:
        raise ModelError(
            f"There is no camera '{name}'{did_you_mean(name, cameras)}; there is {choices(cameras)}."
        )
    return cameras[name]


def _check_text(text: str, camera: Camera, path: Path) -> None:
    """Refuse a text that, read back, is another camera."""
    read = camera_of_yaml(text, str(path))
    is_same = (read.width, read.height, read.lens) == (camera.width, camera.height, camera.lens)
    assert camera.values is not None, "a calibration knows its camera's numbers"
    assert read.values is not None, "a file of a camera states its numbers"
    if not is_same or not np.array_equal(read.values, camera.values):
        raise FileError(
            f"{path}: the camera '{camera.name}' does not read back. It is not written. Please report this."
        )
