"""Cameras as YAML: the camera_info files of ROS, echoed CameraInfo messages, and OpenCV's FileStorage.

All of them hold a camera matrix, K = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], row by row, and coefficients of distortion
in OpenCV's order. They differ in their names, and in OpenCV's ``%YAML:1.0`` and ``!!opencv-matrix``, which other
readers of YAML refuse.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import yaml

from calib.basics.arrays import Array
from calib.basics.values import ReadOnlyMapping
from calib.camera.camera import Camera
from calib.camera.lenses import LENSES
from calib.errors import CalibError, FileError, choices, did_you_mean

#: Names of lens models in files, and calib's. ``""`` is that of drivers whose images have no distortion.
MODELS: Mapping[str, str] = ReadOnlyMapping(
    {
        "plumb_bob": "pinhole",
        "rational_polynomial": "pinhole",
        "pinhole": "pinhole",
        "": "pinhole",
        "equidistant": "fisheye",
        "fisheye": "fisheye",
    }
)

#: The name that ROS has for a lens model of calib. It hands the coefficients of a rational one to OpenCV, however many.
_ROS_MODEL = {
    "pinhole": "plumb_bob",
    "fisheye": "equidistant",
    "rational": "rational_polynomial",
    "tilted": "rational_polynomial",
}

#: Names of keys, without case and underscores, in the order in which they are looked for.
_KEYS = {
    "image_width": ("imagewidth", "width"),
    "image_height": ("imageheight", "height"),
    "camera_matrix": ("cameramatrix", "k"),
    "distortion_coefficients": ("distortioncoefficients", "distcoeffs", "d"),
    "distortion_model": ("distortionmodel", "cameramodel"),
    "camera_name": ("cameraname", "name"),
    "fisheye_model": ("fisheyemodel",),
    "binning_x": ("binningx",),
    "binning_y": ("binningy",),
    "roi": ("roi",),
}

#: Numbers of coefficients of distortion that files have, by lens.
_COUNTS = {"pinhole": (0, 4, 5, 8, 12, 14), "fisheye": (0, 4)}

#: OpenCV's first line, which is not YAML's.
_OPENCV_HEAD = re.compile(r"\A%YAML:1\.\d[^\n]*\n")

_FORMS = (
    "A camera file is a camera_info file of ROS, a YAML file of OpenCV with camera_matrix and "
    "distortion_coefficients, or calib's TOML with width, height, fx, fy, cx, cy"
)


class _Loader(yaml.SafeLoader):
    """Reads plain values, and OpenCV's matrices as mappings."""


def _matrix(loader: yaml.SafeLoader, node: yaml.Node) -> Any:  # noqa: ANN401
    """Return a node of YAML with OpenCV's tag of a matrix as a mapping; a constructor of the loader."""
    assert isinstance(node, yaml.MappingNode)
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _matrix)


def camera_of_yaml(text: str, where: str) -> Camera:
    """Read a camera from a YAML text.

    Args:
        text: The content of a file.
        where: The file's name, which begins messages.

    Returns:
        The camera. One whose camera matrix is zero is not calibrated, as ROS has it: nothing but its size is known.

    Raises:
        FileError: The text is not YAML.
        CalibError: A key is missing or has a wrong value, or calib does not have the lens.
    """
    if text.lstrip().startswith("<"):
        raise FileError(f"{where}: this is XML. Write the camera as YAML (OpenCV: name it .yaml).")
    try:
        data = next(yaml.load_all(_OPENCV_HEAD.sub("", text), Loader=_Loader), None)
    except (yaml.YAMLError, AssertionError, ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise FileError(f"{where}: this is neither YAML nor TOML: {reason}. {_FORMS}.") from error
    if not isinstance(data, Mapping):
        raise FileError(f"{where}: this is not the description of a camera. {_FORMS}.")

    # The entries by the names of `_KEYS`.
    plain = {str(key).replace("_", "").casefold(): value for key, value in data.items()}
    table = {}
    for key, spellings in _KEYS.items():
        for spelling in reversed(spellings):
            if spelling in plain:
                table[key] = plain[spelling]
    needed = ("image_width", "image_height", "camera_matrix")
    missing = [key for key in needed if key not in table]
    if missing:
        raise CalibError(f"{where}: the camera lacks {choices(missing)}; add it. {_FORMS}.")

    # The camera matrix is not that of the images if these are binned or a part of the sensor.
    for key in ("binning_x", "binning_y"):
        if table.get(key) not in (None, 0, 1):
            raise CalibError(
                f"{where}: '{key}' is {table[key]!r}: the images are smaller than those of the camera matrix. "
                "Give the camera matrix of the images themselves, and no binning."
            )
    roi = table.get("roi")
    if isinstance(roi, Mapping) and (roi.get("x_offset") or roi.get("y_offset")):
        raise CalibError(
            f"{where}: 'roi' begins at ({roi.get('x_offset')}, {roi.get('y_offset')}): the images are cut from "
            "those that the camera matrix belongs to. Give the camera matrix of the images themselves, and no roi."
        )

    width = _pixels(table, "image_width", where)
    height = _pixels(table, "image_height", where)
    matrix = _numbers(table, "camera_matrix", where)
    lens, coefficients = _distortion(table, _lens_name(table, where), where)
    name = str(table.get("camera_name") or "camera")
    values = None
    if np.any(matrix):
        values = np.concatenate([_linear_intrinsics(matrix, where), coefficients])
    try:
        return Camera(name=name, width=width, height=height, lens=lens, values=values)
    except CalibError as error:
        raise CalibError(f"{where}: {error}") from error


def _pixels(table: Mapping[str, Any], key: str, where: str) -> int:
    """Return the image's width or height [px]; an OpenCV file may have it as 1280., which is whole; else CalibError."""
    value = table[key]
    number = _number(value)
    if number is None or number != round(number) or number < 1:
        raise CalibError(
            f"{where}: '{key}' is {value!r}; it must be a whole number of pixels, such as 1280."
        )
    return round(number)


def _number(value: object) -> float | None:
    """Return a number; also of a text such as '1e-05', which YAML 1.1 takes for one; None for others."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if np.isfinite(number) else None


def _numbers(table: Mapping[str, Any], key: str, where: str) -> Array:
    """Return the numbers of a matrix, row by row, shape (n,).

    It may be a mapping with its numbers under ``data``, a list, or a list of rows. CalibError for anything else.
    """
    given = table[key]
    data = given.get("data") if isinstance(given, Mapping) else given
    flat: list[object] = []
    for row in data if isinstance(data, list) else [data]:
        flat += row if isinstance(row, list) else [row]
    numbers = [_number(value) for value in flat]
    if any(number is None for number in numbers):
        raise CalibError(
            f"{where}: '{key}' is {given!r}; it must be a list of numbers, or have one under 'data'."
        )
    return np.array(numbers, dtype=np.float64)


def _linear_intrinsics(matrix: Array, where: str) -> Array:
    """Return fx, fy, cx, cy of a camera matrix (9,), row by row, shape (4,) [px]; CalibError if it is not one."""
    if matrix.shape != (9,):
        raise CalibError(
            f"{where}: 'camera_matrix' has {len(matrix)} numbers; it must have nine, row by row: fx, 0, cx, 0, fy, cy, "
            "0, 0, 1."
        )
    K = matrix.reshape(3, 3)
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    if not np.array_equal(K, [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]):
        raise CalibError(
            f"{where}: 'camera_matrix' is {matrix.tolist()}; it must be fx, 0, cx, 0, fy, cy, 0, 0, 1, without skew."
        )
    return np.array([fx, fy, cx, cy])


def _lens_name(table: Mapping[str, Any], where: str) -> str:
    """Return the lens model, ``"pinhole"`` or ``"fisheye"``, that a file's entries name; CalibError for another one.

    Without a name it is a pinhole, unless the entry ``fisheye_model`` is true.
    """
    fisheye = bool(_number(table.get("fisheye_model")) or table.get("fisheye_model") is True)
    model = table.get("distortion_model")
    if model is None:
        return "fisheye" if fisheye else "pinhole"
    name = str(model).casefold()
    if name not in MODELS:
        allowed = [known for known in MODELS if known]
        raise CalibError(
            f"{where}: 'distortion_model' is {model!r}{did_you_mean(name, allowed)}; allowed are {choices(allowed)}. "
            "Without it a file of OpenCV is 'plumb_bob'."
        )
    return MODELS[name]


def _distortion(table: Mapping[str, Any], lens: str, where: str) -> tuple[str, Array]:
    """Return calib's lens and its coefficients of distortion, shape (d,), zeros if the file has none or fewer.

    ``lens`` is the one that the file names; a pinhole with more coefficients than five that are not zero is rational,
    or tilted. CalibError for a number of coefficients that no lens has.
    """
    names = LENSES[lens].distortion
    if table.get("distortion_coefficients") is None:
        return lens, np.zeros(len(names))
    given = _numbers(table, "distortion_coefficients", where)
    counts = _COUNTS[lens]
    if len(given) not in counts:
        raise CalibError(
            f"{where}: 'distortion_coefficients' has {len(given)} numbers; a lens '{lens}' has "
            f"{', '.join(map(str, counts[1:-1] or counts[1:]))}{f' or {counts[-1]}' if len(counts) > 2 else ''}: "
            f"{', '.join(LENSES['tilted' if lens == 'pinhole' else lens].distortion)}, the last ones left out or zero."
        )
    # The lens of the fewest coefficients that has all that are not zero.
    larger = (lens, "rational", "tilted") if lens == "pinhole" else (lens,)
    chosen = next(name for name in larger if not np.any(given[len(LENSES[name].distortion) :]))
    count = len(LENSES[chosen].distortion)
    return chosen, np.pad(given[:count], (0, max(count - len(given), 0)))


# Writing


def camera_info_yaml(camera: Camera) -> str:
    """Write a camera as a camera_info file of ROS.

    Args:
        camera: The camera; its numbers are known.

    Returns:
        The content of a YAML file, as camera_calibration_parsers reads it: no rectification, and a projection by the
        camera matrix itself.

    Raises:
        CalibError: The camera's numbers are not known.
    """
    values = _known(camera)
    fx, fy, cx, cy, *coefficients = values.tolist()
    projection = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    lines = [
        f"image_width: {camera.width}",
        f"image_height: {camera.height}",
        f"camera_name: {json.dumps(camera.name, ensure_ascii=False)}",
        *_rows("camera_matrix", 3, 3, [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]),
        f"distortion_model: {_ROS_MODEL[camera.lens]}",
        *_rows("distortion_coefficients", 1, len(coefficients), coefficients),
        *_rows("rectification_matrix", 3, 3, np.eye(3).ravel().tolist()),
        *_rows("projection_matrix", 3, 4, projection),
    ]
    return "\n".join([*lines, ""])


def opencv_yaml(camera: Camera) -> str:
    """Write a camera as YAML of OpenCV's FileStorage.

    Args:
        camera: The camera; its numbers are known.

    Returns:
        The content of a file with image_width, image_height, camera_name, distortion_model, fisheye_model (1 for
        cv2.fisheye), camera_matrix and distortion_coefficients.

    Raises:
        CalibError: The camera's numbers are not known.
    """
    values = _known(camera)
    fx, fy, cx, cy, *coefficients = values.tolist()
    lines = [
        "%YAML:1.0",
        "---",
        f"image_width: {camera.width}",
        f"image_height: {camera.height}",
        f"camera_name: {json.dumps(camera.name, ensure_ascii=False)}",
        f"distortion_model: {_ROS_MODEL[camera.lens]}",
        f"fisheye_model: {int(camera.lens == 'fisheye')}",
        *_rows("camera_matrix", 3, 3, [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0], opencv=True),
        *_rows("distortion_coefficients", 1, len(coefficients), coefficients, opencv=True),
    ]
    return "\n".join([*lines, ""])


def _known(camera: Camera) -> Array:
    """Return the intrinsics of a camera, shape (m,), [px] and 1; CalibError if they are not known."""
    if camera.values is None:
        raise CalibError(
            f"Only the image size of the camera '{camera.name}' is known, so there is no camera matrix to write. "
            "Calibrate it first."
        )
    return camera.values


def _rows(
    key: str, rows: int, columns: int, numbers: list[float], *, opencv: bool = False
) -> list[str]:
    """Return the lines of a matrix, whose numbers are given row by row, for ROS or for OpenCV's FileStorage."""
    lines = [f"{key}: !!opencv-matrix" if opencv else f"{key}:", f"   rows: {rows}"]
    lines.append(f"   cols: {columns}")
    if opencv:
        lines.append("   dt: d")
    written = []
    for number in numbers:
        # With a point in it, without which YAML 1.1 takes 1e-05 for a text.
        mantissa, e, exponent = repr(number).partition("e")
        has_no_point = e and "." not in mantissa
        written.append(f"{mantissa}.0e{exponent}" if has_no_point else repr(number))
    lines.append(f"   data: [{', '.join(written)}]")
    return lines
