"""Where a URDF comes from: a file, a xacro, or a robot of example-robot-data by its name."""

from __future__ import annotations

import importlib.metadata
import os
from pathlib import Path

from calib.errors import UrdfError, choices
from calib.model.urdf import Urdf
from calib.model.xacro_file import XacroCall, flattened, is_xacro


def read_urdf(source: str | Path) -> Urdf:
    """The URDF of a file, of a xacro with the arguments behind it, or of a robot of example-robot-data.

    The ``data`` of a xacro's URDF are the flattened text, its ``path`` is that of the file, and its ``source`` the
    file's name with the arguments.

    Raises:
        FileError: The file cannot be read.
        UrdfError: No such robot, no URDF, or a xacro that cannot be flattened.
    """
    if not is_xacro(source):
        return Urdf.read(find_urdf(source))
    call = XacroCall.parse(source)
    data = flattened(call)
    try:
        return Urdf.from_bytes(data, call.name, call.path)
    except UrdfError as error:
        message = f"{str(error).rstrip('.')}. This is about the flattened text: xacro FILE ARGUMENTS > robot.urdf"
        raise UrdfError(message) from error


def find_urdf(source: str | Path) -> Path:
    """The URDF file that a path or a robot's name means.

    A name is looked for in the file list of the installed ``example-robot-data`` package, as
    ``<name>_robot.urdf`` and then ``<name>.urdf``: that package's own loader returns a UR5 for ``"ur3"``.

    Raises:
        UrdfError: Neither a file nor a known robot.
    """
    path = Path(source)
    if path.suffix or len(path.parts) != 1 or os.path.isfile(path):  # noqa: PTH113  of any length
        return path
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        files = []
    urdfs = {file.name: Path(str(file.locate())) for file in files if file.suffix == ".urdf"}
    for name in (f"{source}_robot.urdf", f"{source}.urdf"):
        if name in urdfs:
            return urdfs[name]
    known = sorted(name.removesuffix(".urdf").removesuffix("_robot") for name in urdfs)
    message = (
        f"'{source}' is neither a file here nor a robot of example-robot-data. Give the path of a URDF or "
        f"xacro, or one of {choices(dict.fromkeys(known), limit=60)}."
    )
    raise UrdfError(message)
