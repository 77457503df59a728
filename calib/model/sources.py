"""Where a URDF comes from: a file, a xacro, or a robot of example-robot-data by its name.

Which link a chain ends at where none is named.
"""

from __future__ import annotations

import importlib.metadata
import itertools
import os
from collections.abc import Collection
from pathlib import Path

from calib.errors import UrdfError, choices
from calib.model.chain import MOVING
from calib.model.urdf import Urdf, UrdfJoint
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
        raise UrdfError(
            f"{str(error).rstrip('.')}. This is about the flattened text: xacro FILE ARGUMENTS > robot.urdf"
        ) from error


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
    raise UrdfError(
        f"'{source}' is neither a file here nor a robot of example-robot-data. Give the path of a URDF or "
        f"xacro, or one of {choices(dict.fromkeys(known), limit=60)}."
    )


#: Names of a tip, in the order of preference, where several links lie equally far out.
_USUAL_TIPS = ("tool0", "tcp", "tool", "flange", "ee_link")


def farthest_link(
    urdf: Urdf, base: str, measured: Collection[str] | None = None, held: Collection[str] = ()
) -> str:
    """The link with the most moving joints between it and ``base``; a usual tip's name breaks ties.

    Only links that measured joints alone lead to count, if there are any with a moving joint before them. Links
    below the base come first; where nothing moves below it, as on a camera's link, all others are looked at.

    Args:
        urdf: The URDF.
        base: Name of a link.
        measured: Names of the joints whose values are known; all joints if None.
        held: Names of joints that stay where they are; they lead on but do not count.

    Raises:
        UrdfError: The base is not a link.
    """
    urdf.chain(base, base)  # raises, with the names there are, for a link that does not exist
    every = {joint.name for joint in urdf.joints}
    knowns = [every] if measured is None else [measured, every]
    for known, climb in itertools.product(knowns, (False, True)):
        count = _counted(urdf, base, known, held, climb=climb)
        most = max(count.values())
        if most:
            break
    farthest = [link for link in count if count[link] == most]
    return next((name for name in _USUAL_TIPS if name in farthest), farthest[-1])


def _counted(
    urdf: Urdf, base: str, known: Collection[str], held: Collection[str], *, climb: bool
) -> dict[str, int]:
    """The number of moving joints before each link that can be reached; ``climb``: joints are passed upwards too."""
    above = {joint.child: joint for joint in urdf.joints}
    start = base
    while start in above and above[start].type == "fixed":
        start = above[start].parent
    below: dict[str, list[tuple[UrdfJoint, str]]] = {}
    for joint in urdf.joints:
        moves = joint.type in MOVING and joint.mimic is None and joint.name in known
        if joint.type == "fixed" or joint.name in held or moves:
            below.setdefault(joint.parent, []).append((joint, joint.child))
            if climb:
                below.setdefault(joint.child, []).append((joint, joint.parent))
    count = {start: 0}
    waiting = [start]
    for link in waiting:
        for joint, other in below.get(link, []):
            if other not in count:
                count[other] = count[link] + (joint.type != "fixed" and joint.name not in held)
                waiting.append(other)
    return count
