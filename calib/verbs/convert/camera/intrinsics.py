"""The calibrated intrinsics of a camera as files of ROS and OpenCV, each read back before it appears."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from calib.basics.arrays import Array
from calib.basics.files import write_atomically
from calib.basics.values import ReadOnlyMapping
from calib.camera.camera import Camera
from calib.camera.camera_file import camera_info_yaml, opencv_yaml
from calib.camera.camera_yaml import camera_of_yaml
from calib.errors import CalibError, FileError, ModelError, choices
from calib.result.calibration import Calibration
from calib.verbs.convert.camera.estimated_frames import index_of
from calib.verbs.convert.camera.handover import calibration_of
from calib.verbs.convert.camera.options import CameraOptions
from calib.verbs.convert.source import Options, Source

#: The text of a camera, by the name of the format.
_TEXTS: Mapping[str, Callable[[Camera], str]] = ReadOnlyMapping(
    {"camera-info": camera_info_yaml, "opencv": opencv_yaml}
)


def write_intrinsics(name: str, source: Source, path: Path, options: Options) -> None:
    """Write the intrinsics of a camera of a calibration.

    Args:
        name: The format: ``"camera-info"`` of ROS, or ``"opencv"``.
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
    camera = calibrated_camera(calibration_of(source), chosen.camera)
    text = _TEXTS[name](camera)
    _check_text(text, camera, path)
    write_atomically(path, text.encode(), overwrite=options.overwrite)


def calibrated_camera(calibration: Calibration, name: str | None) -> Camera:
    """Return a camera of a calibration with its numbers as estimated.

    Args:
        calibration: The calibration.
        name: Name of the camera's station; None: the only camera.

    Raises:
        ModelError: See `camera_of_station`.
    """
    return camera_of_station(calibration.optics.cameras, calibration.setup.groups, name)


def camera_of_station(
    cameras: Mapping[str, Camera], stations: tuple[str, ...], name: str | None
) -> Camera:
    """Return the camera of a station.

    Args:
        cameras: Cameras by their stations; ``""`` is that of all stations that have none of their own.
        stations: Names of all stations.
        name: Name of a station; None: the only camera, at however many stations.

    Raises:
        ModelError: There is no such camera, or several and none is named.
    """
    if not cameras:
        raise ModelError(
            "This result has no camera: it was not calibrated with images of a board (kind 'pixel')."
        )
    if name is None and len(cameras) == 1:
        return next(iter(cameras.values()))
    station = stations[index_of("camera", "--camera", name, stations)]
    camera = cameras.get(station, cameras.get(""))
    if camera is None:
        raise ModelError(f"The station '{station}' has no camera; one has {choices(cameras)}.")
    return camera


def numbers_of(camera: Camera) -> Array:
    """Return the numbers of a calibrated camera's lens, shape (m,); they are known."""
    assert camera.values is not None, "a calibration knows its camera's numbers"
    return camera.values


def _check_text(text: str, camera: Camera, path: Path) -> None:
    """Refuse a text that, read back, is another camera."""
    read = camera_of_yaml(text, str(path))
    is_same = (read.width, read.height, read.lens) == (camera.width, camera.height, camera.lens)
    if not is_same or read.values is None or not np.array_equal(read.values, numbers_of(camera)):
        raise FileError(
            f"{path}: the camera '{camera.name}' does not read back. It is not written. Please report this."
        )
