"""The URDF that a result names: found again by its SHA-256."""

from __future__ import annotations

import contextlib
import hashlib
import os
from pathlib import Path

from calib.errors import FileError, UrdfError
from calib.model.files import read_bytes
from calib.model.robot import find_urdf
from calib.model.urdf import LIMIT_BYTES, Urdf
from calib.model.xacro_file import XacroCall, is_xacro, read_xacro

__all__ = ["recorded_urdf"]


def recorded_urdf(name: str, sha256: str, folder: Path) -> Urdf | None:
    """The URDF of that name whose bytes have that SHA-256; None if it is not at hand.

    Looked for beside the result, in the current folder, and in example-robot-data. That of a xacro is flattened anew,
    with the arguments that are in its name.

    Args:
        name: As the result has it: a file's name, of a xacro with its arguments.
        sha256: Of the URDF's bytes, in hexadecimal; of a xacro those of the flattened text.
        folder: Where the result lies.
    """
    if is_xacro(name):
        return _flattened(name, sha256, folder)
    places = [folder / name, Path(name)]
    with contextlib.suppress(UrdfError, FileError):  # none of that name
        places.append(find_urdf(Path(name).stem.removesuffix("_robot")))
    for place in places:
        # Told by its bytes, before it is read as a URDF: any other file of that name is none of ours.
        # A name that is too long for a file is none of one: os.path says so.
        if os.path.isfile(place) and place.stat().st_size <= LIMIT_BYTES:  # noqa: PTH113
            data = read_bytes(place, "URDF", LIMIT_BYTES)
            if hashlib.sha256(data).hexdigest() == sha256:
                return Urdf.read(place)
    return None


def _flattened(name: str, sha256: str, folder: Path) -> Urdf | None:
    """What a xacro beside the result or here becomes, if that has the SHA-256."""
    with contextlib.suppress(UrdfError):  # no arguments that can be read
        call = XacroCall.parse(name)
        for place in (folder / call.path, call.path):
            if os.path.isfile(place):  # noqa: PTH113
                with contextlib.suppress(UrdfError, FileError):  # it became another since then
                    urdf = read_xacro(XacroCall(place, call.arguments))
                    if urdf.sha256 == sha256:
                        return urdf
    return None
