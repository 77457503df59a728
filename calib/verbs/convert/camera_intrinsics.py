"""The formats ``camera-info`` and ``opencv``: the calibrated intrinsics of a camera as files of ROS and OpenCV."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from calib.basics.arrays import Array
from calib.basics.files import write_atomically
from calib.camera.camera import Camera
from calib.camera.camera_file import camera_info_yaml, opencv_yaml
from calib.camera.camera_yaml import camera_of_yaml
from calib.camera.lenses import LENSES
from calib.errors import CalibError, FileError, ModelError, choices
from calib.result.calibration import Calibration
from calib.show.lines import fill, number
from calib.verbs.convert.camera_frames import index_of
from calib.verbs.convert.format import (
    YAML,
    CameraOptions,
    Conversion,
    Format,
    Notes,
    Options,
    Source,
)

#: Decimals of a number of a lens, by its unit.
_DECIMALS = {"px": 2, "1": 5}


def write_intrinsics(
    text_of: Callable[[Camera], str], source: Source, path: Path, options: Options
) -> Notes:
    """Write the intrinsics of a camera of a calibration; the file is read back before it appears.

    Args:
        text_of: Returns the text of a file with the intrinsics of a camera.
        source: The calibration.
        path: The file.
        options: ``camera``, which camera it is, and ``overwrite``.

    Returns:
        No notes.

    Raises:
        CalibError: The source is not a calibration, or links were named, which the file does not have.
        ModelError: There is no such camera, or the calibration was not made with images.
        FileError: The file exists, cannot be written, or does not read back.
    """
    chosen = options.camera
    if chosen != CameraOptions(camera=chosen.camera):
        raise CalibError(
            f"{path}: a file of intrinsics has no links; of the camera's options it takes --camera alone."
        )
    camera = calibrated_camera(source.require_calibration(), chosen.camera)
    text = text_of(camera)
    read = camera_of_yaml(text, str(path))
    is_same = (read.width, read.height, read.lens) == (camera.width, camera.height, camera.lens)
    if not is_same or read.values is None or not np.array_equal(read.values, _numbers_of(camera)):
        raise FileError(
            f"{path}: the camera '{camera.name}' does not read back. It is not written. Please report this."
        )
    write_atomically(path, text.encode(), overwrite=options.overwrite)
    return ()


def calibrated_camera(calibration: Calibration, name: str | None) -> Camera:
    """Return a camera of a calibration with its numbers as estimated.

    Args:
        calibration: The calibration.
        name: Name of the camera's station; None: the only camera.

    Raises:
        ModelError: The calibration has no such camera, or several and none is named.
    """
    return camera_of_station(calibration.optics.cameras, calibration.setup.groups, name)


def camera_of_station(
    cameras: Mapping[str, Camera], stations: tuple[str, ...], name: str | None
) -> Camera:
    """Return the camera of a station.

    Args:
        cameras: Cameras by their stations; ``""`` is that of all stations without one of their own.
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


def _numbers_of(camera: Camera) -> Array:
    """Return the numbers of a calibrated camera's lens, such as fx, fy, cx, cy [px] and distortion, shape (m,)."""
    assert camera.values is not None, "a calibration knows its camera's numbers"
    return camera.values


def intrinsics_text(reader: str, conversion: Conversion) -> list[str]:
    """Word the numbers of a camera with their standard deviations, and what reads the file.

    Args:
        reader: A sentence on what reads the file, with ``{}`` for its path.
        conversion: The conversion.

    Returns:
        Paragraphs of 100 columns.
    """
    calibration = conversion.source.require_calibration()
    camera = calibrated_camera(calibration, conversion.options.camera.camera)
    lens = LENSES[camera.lens]
    sigma = np.zeros(len(lens.names)) if camera.sigma is None else camera.sigma
    parts = []
    for k, (name, unit) in enumerate(zip(lens.names, lens.units, strict=True)):
        decimals = _DECIMALS[unit]
        value = number(float(_numbers_of(camera)[k]), decimals)
        parts.append(f"{name} {value} ± {number(float(sigma[k]), decimals)}")
    sentence = (
        f"Camera '{camera.name}', {camera.width} x {camera.height} px, {camera.lens}, with standard deviations: "
        f"{', '.join(parts)}; fx, fy, cx, cy in px."
    )
    return [fill(sentence), fill(reader.format(conversion.path.resolve()))]


def _format(what: str, text_of: Callable[[Camera], str], reader: str) -> Format:
    """Return the registry row of a kind of file: what it is, the text of a camera, and the sentence on its reader."""
    return Format(
        what,
        YAML,
        partial(write_intrinsics, text_of),
        of_camera=True,
        has_chain=False,
        describe=partial(intrinsics_text, reader),
    )


FORMATS = {
    "camera-info": _format(
        "the camera's intrinsics for ROS (camera_info)",
        camera_info_yaml,
        "In ROS name it to the driver, as camera_info_url: file://{}.",
    ),
    "opencv": _format(
        "the camera's intrinsics for OpenCV (FileStorage)",
        opencv_yaml,
        "cv2.FileStorage reads it, from Python and C++.",
    ),
}
