"""Files of cameras: the YAML of ROS and OpenCV, and calib's TOML, which says too how well the numbers are known.

The keys of the TOML are those of the fields of `Camera`, the lens's numbers, and either ``intrinsics`` or standard
deviations; or ``file``, which names a file of a camera whose entries the other keys replace.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from calib.basics.arrays import Array
from calib.basics.files import read_bytes
from calib.basics.records import keys_of, parse_toml, read_parts, toml, toml_values
from calib.basics.value_forms import NUMBER, Place
from calib.basics.values import ReadOnlyMapping
from calib.camera.camera import UNKNOWN, Camera
from calib.camera.camera_yaml import camera_info_yaml, camera_of_yaml, opencv_yaml
from calib.camera.lenses import LENSES, Lens
from calib.errors import CalibError, FileError, choices, did_you_mean

__all__ = [
    "camera_info_yaml",
    "camera_of_table",
    "camera_toml",
    "opencv_yaml",
    "read_camera",
]

#: Names a file of a camera whose entries the other keys of a table replace.
_FILE = "file"

#: Says how well all numbers are known, and what it may be.
_INTRINSICS = "intrinsics"
_KNOWN: Mapping[str, float] = ReadOnlyMapping({"exact": 0.0, "unknown": UNKNOWN})

#: Numbers that a lens has in any case; those of distortion are zero if they are not given.
_LINEAR = ("fx", "fy", "cx", "cy")


def read_camera(path: str | Path) -> Camera:
    """Read a camera from a file.

    Args:
        path: A camera_info file of ROS, an echoed CameraInfo message, a YAML file of OpenCV's FileStorage, or calib's
            TOML; in UTF-8. The content says which it is.

    Returns:
        The camera.

    Raises:
        FileError: The file cannot be read, or is neither YAML nor TOML.
        CalibError: A key is unknown, missing or has a wrong value, or calib does not have the lens.
    """
    data = read_bytes(path, "File of a camera")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileError(
            f"{path}: this is not text in UTF-8, so it is not a camera file."
        ) from error
    try:
        table = parse_toml(text)
    except ValueError as error:
        if Path(path).suffix.lower() == ".toml":
            raise FileError(f"{path}: this is not a TOML file: {error}") from error
        return camera_of_yaml(text, str(path))
    if _FILE in table:
        raise CalibError(
            f"{path}: '{_FILE}' names another camera file, but this is one itself. Give that one."
        )
    return camera_of_table(table, str(path))


def camera_of_table(table: Mapping[str, Any], where: str, folder: str | Path = ".") -> Camera:
    """Read a camera from a table of a TOML file.

    Args:
        table: The keys of a camera; or ``file``, the name of a file of a camera, with keys that replace its entries.
        where: Begins messages: the file and the table, ``"cell.toml, [camera]"``.
        folder: Where a relative ``file`` begins: the folder of the file that holds the table.

    Returns:
        The camera.

    Raises:
        FileError: The file named cannot be read, or is neither YAML nor TOML.
        CalibError: A key is unknown, missing or has a wrong value, or calib does not have the lens.
    """
    try:
        return _camera_of_keys(table, folder)
    except CalibError as error:
        kind = FileError if isinstance(error, FileError) else CalibError
        raise kind(f"{where}: {error}") from error


def _camera_of_keys(table: Mapping[str, Any], folder: str | Path) -> Camera:
    """Read a camera from the keys of a table, and of the file in ``folder`` that it may name; see `camera_of_table`.

    Raises CalibError without the place of the fault, or FileError for the file that is named.
    """
    # The keys of the camera's fields; those of its numbers are the lens's.
    rows = [replace(row, part=field.name, needed=False) for field, row in keys_of(Camera)]
    names = [row.name for row in rows]
    attributes = read_parts(rows, {name: table[name] for name in names if name in table})
    if _FILE in table:
        file = table[_FILE]
        if not isinstance(file, str):
            raise CalibError(f"'{_FILE}' is {file!r}; it must be the name of a file in quotes.")
        camera = read_camera(Path(folder) / file)
        given_lens = attributes.get("lens", camera.lens)
        if camera.values is not None and given_lens != camera.lens:
            raise CalibError(
                f"'lens' is '{given_lens}', but the file '{file}' has '{camera.lens}'; leave out one."
            )
        camera = replace(camera, **attributes)
    else:
        missing = [name for name in ("width", "height") if name not in table]
        if missing:
            raise CalibError(
                f"the camera lacks {choices(missing)}, the size of its images [px]; write it, such as width = 1280 and "
                'height = 720, or name a file of the camera, file = "camera_info.yaml".'
            )
        camera = Camera(**attributes)

    lens = LENSES[camera.lens]
    known = (*names, _FILE, *lens.names, _INTRINSICS, *_sigma_keys(lens))
    for name in table:
        if name not in known:
            raise CalibError(
                f"a camera with the lens '{lens.name}' has no key '{name}'{did_you_mean(name, known)}; its keys are "
                f"{choices(known, len(known))}."
            )
    camera = replace(camera, values=_lens_values(table, lens, camera))
    return replace(camera, sigma=_lens_sigma(table, lens, camera))


def _lens_values(table: Mapping[str, Any], lens: Lens, camera: Camera) -> Array | None:
    """Return the intrinsics, shape (m,): the camera's, except for those that a table gives; None without any.

    If the camera has none, a table must give focal lengths and centre, and its distortion is 0 where it is not given.
    CalibError if one is missing or is not a number.
    """
    given = {name: table[name] for name in lens.names if name in table}
    if not given:
        return camera.values
    if camera.values is None:
        missing = [name for name in _LINEAR if name not in given]
        if missing:
            raise CalibError(
                f"the camera has {choices(given)} but lacks {choices(missing)}. Give all of {choices(_LINEAR)} [px], "
                "or none: then they are estimated from the images."
            )
        values = np.zeros(len(lens.names))
    else:
        values = camera.values.copy()
    for name, value in given.items():
        values[lens.names.index(name)] = NUMBER.read(value, Place().key(name))
    return values


def _sigma_keys(lens: Lens) -> dict[str, tuple[str, ...]]:
    """Map each key of a camera table that states standard deviations to its intrinsics, by their names.

    Keys of one intrinsic come last: they override those of a group.
    """
    keys = {
        "sigma_focal_px": ("fx", "fy"),
        "sigma_centre_px": ("cx", "cy"),
        "sigma_distortion": lens.distortion,
    }
    for name, unit in zip(lens.names, lens.units, strict=True):
        keys[_sigma_key(name, unit)] = (name,)
    return keys


def _sigma_key(name: str, unit: str) -> str:
    """Return the key of the standard deviation of one intrinsic by its name and unit: ``"sigma_fx_px"``."""
    return f"sigma_{name}_px" if unit == "px" else f"sigma_{name}"


def _lens_sigma(table: Mapping[str, Any], lens: Lens, camera: Camera) -> Array | None:
    """Return the standard deviations of the intrinsics, shape (m,), from a table; None: they are the lens's default.

    Those that the table does not give are the camera's, or else the default. The table may also say in a word that all
    are exact or unknown. CalibError if it says both, or anything about a camera without intrinsics.
    """
    keys = _sigma_keys(lens)
    given = [key for key in keys if key in table]
    if _INTRINSICS in table:
        if given:
            raise CalibError(f"both '{_INTRINSICS}' and {choices(given)} are given; leave out one.")
        word = table[_INTRINSICS]
        if not isinstance(word, str) or word not in _KNOWN:
            raise CalibError(
                f"'{_INTRINSICS}' is {word!r}{did_you_mean(str(word), _KNOWN)}; it must be one of {choices(_KNOWN)}, "
                "or left out: then the usual accuracy of a manufacturer's numbers is assumed; or write sigma_focal_px, "
                "sigma_centre_px and sigma_distortion."
            )
        if camera.values is not None:
            return np.full(len(camera.values), _KNOWN[word])
        if word != "unknown":
            raise CalibError(
                f"'{_INTRINSICS}' is '{word}', but there are none; give {choices(_LINEAR)}, or a file."
            )
        return None

    if not given:
        return camera.sigma
    if camera.values is None:
        raise CalibError(
            f"{choices(given)} belongs to intrinsics that are not given; give {choices(_LINEAR)} too, or leave it out."
        )
    sigma: Array = lens.default_sigma(camera.values, camera.width)
    if camera.sigma is not None:
        sigma = camera.sigma.copy()
    for key in given:
        value = table[key]
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not value >= 0.0:
            raise CalibError(
                f"'{key}' is {value!r}; it must be 0 (exact) or a number above 0, or inf (not known)."
            )
        sigma[[lens.names.index(name) for name in keys[key]]] = value
    return sigma


def camera_toml(camera: Camera) -> str:
    """Write a camera as calib's TOML, with how well its numbers are known.

    Args:
        camera: The camera.

    Returns:
        The content of a TOML file, which is read back as the same numbers to the last bit.
    """
    lens = LENSES[camera.lens]
    lines = [f"{name} = {toml(value)}" for name, value in toml_values(camera).items()]
    if camera.values is None:
        return "\n".join([*lines, 'intrinsics = "unknown"', ""])
    for name, value in zip(lens.names, camera.values.tolist(), strict=True):
        lines.append(f"{name} = {value!r}")
    for word, sigma in _KNOWN.items():
        if camera.sigma is not None and np.all(camera.sigma == sigma):
            return "\n".join([*lines, f"{_INTRINSICS} = {toml(word)}", ""])
    if camera.sigma is not None:
        lines.append("# Standard deviations; 0: exact, inf: not known.")
        for name, unit, std in zip(lens.names, lens.units, camera.sigma.tolist(), strict=True):
            lines.append(f"{_sigma_key(name, unit)} = {std!r}")
    return "\n".join([*lines, ""])
