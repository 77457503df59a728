"""A region as a file: JSON in SI units, see docs/workspace.md.

It names robot, base, tip, joints and target: in another base frame the same numbers are another place.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from calib.basics.arrays import Array, Mask, read_only
from calib.basics.files import write_atomically
from calib.basics.json_files import damage, json_bytes, read_json
from calib.errors import CalibError, FileError
from calib.robot.robot import Robot
from calib.verbs.workspace.region import Region
from calib.verbs.workspace.region_rows import RegionView
from calib.version import __version__

SCHEMA = "region 1"


def write_region(view: RegionView, path: str | Path, seed: int, *, overwrite: bool = False) -> Path:
    """Write a region as a JSON file, with the robot, the target and the samples that it was made from.

    Args:
        view: The region, voxels of the robot's base frame; the robot with the ranges of its joints; the target in the
            tip; and the density of the samples.
        path: The file.
        seed: Seed that the samples of the workspace were drawn with.
        overwrite: Whether an existing file is replaced.

    Returns:
        The path of the file.

    Raises:
        FileError: It cannot be written.
    """
    robot, region = view.robot, view.region
    table = {
        "schema": SCHEMA,
        "calib": __version__,
        "robot": {
            "name": robot.name,
            "base": robot.base,
            "tip": robot.tip,
            "joints": _joint_table(view),
        },
        "target_xyz_m": view.target,
        "samples": view.density.samples,
        "seed": seed,
        "share": region.share,
        "held": region.held,
        "volume_m3": region.volume,
        "voxel_m": region.voxel,
        "origin_m": region.origin,
        "shape": region.cells.shape,
        "runs": _runs(region.cells),
    }
    return write_atomically(path, json_bytes(table), overwrite=overwrite)


def _joint_table(view: RegionView) -> list[dict[str, Any]]:
    """Return name, lowest and highest value of each joint, the unit in the keys: ``low_rad`` or ``low_m``.

    Args:
        view: Gives the robot, and the ranges of its m measured joints, shape (m, 2), [rad] or [m].
    """
    table = []
    for joint, (low, high) in zip(view.robot.inputs, view.ranges, strict=True):
        unit = "m" if joint.type == "prismatic" else "rad"
        table.append({"name": joint.name, f"low_{unit}": low, f"high_{unit}": high})
    return table


def _runs(cells: Mask) -> list[int]:
    """Encode which voxels of a grid are inside by the lengths of runs: outside, inside, outside, ...

    Args:
        cells: True for voxels inside, shape (nx, ny, nz).

    Returns:
        Numbers of voxels in a row, in the order in which the last index varies fastest. The first run is outside, of 0
        voxels where the first voxel is inside.
    """
    flat = cells.ravel()
    changes = np.flatnonzero(np.diff(flat)) + 1
    lengths: list[int] = np.diff([0, *changes, flat.size]).tolist()
    return [0, *lengths] if flat[0] else lengths


class _Origin(NamedTuple):
    """Chain and target that a region was made for."""

    #: Name of the base link.
    base: str
    #: Name of the tip link.
    tip: str
    #: Names of the measured joints.
    joints: list[str]
    #: Shape (3,), position of the target in the tip [m].
    target: Array


def read_region(
    path: str | Path, robot: Robot | None = None, target: Array | None = None
) -> Region:
    """Read a region from a JSON file, and check that it was made for a robot and a target.

    Args:
        path: The file.
        robot: The robot that the region is to be used for: base, tip and measured joints must be those of the file;
            None: they are not checked.
        target: Position of the target in the tip, shape (3,), [m], at most a voxel from that of the file; None: it is
            not checked.

    Returns:
        The region, voxels of the robot's base frame.

    Raises:
        FileError: It cannot be read, or is damaged.
        CalibError: It was made for another base, tip or joints, or a target more than a voxel away.
    """
    expected = (
        f"a region of calib {__version__} has '{SCHEMA}'. Make it again with 'calib workspace -o'."
    )
    table = read_json(path, "region", SCHEMA, expected)
    try:
        region = _region_of(table)
        origin = _origin_of(table)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise FileError(
            f"{path}: the region is damaged: {damage(error)}. "
            "Write it again with 'calib workspace -o'."
        ) from error
    _check_origin(path, origin, region, robot, target)
    return region


def _region_of(table: Mapping[str, Any]) -> Region:
    """Return the region that a file describes.

    Args:
        table: Values of the file by their keys, in SI units; lengths of runs outside and inside say which voxels belong
            to the region.

    Raises:
        KeyError, TypeError, ValueError, OverflowError: A value is missing, or of the wrong kind or shape.
    """
    runs = np.asarray(table["runs"], dtype=np.int64)
    is_inside = np.arange(len(runs)) % 2 == 1
    return Region(
        origin=read_only(table["origin_m"]).reshape(3),
        voxel=float(table["voxel_m"]),
        cells=np.repeat(is_inside, runs).reshape(table["shape"]),
        share=float(table["share"]),
        held=float(table["held"]),
    )


def _origin_of(table: Mapping[str, Any]) -> _Origin:
    """Return the base, tip, joints and target that the region of a file was made for.

    Args:
        table: Values of the file by their keys, in SI units.

    Raises:
        KeyError, TypeError, ValueError, OverflowError: A value is missing, or of the wrong kind or shape.
    """
    robot = table["robot"]
    return _Origin(
        base=robot["base"],
        tip=robot["tip"],
        joints=[joint["name"] for joint in robot["joints"]],
        target=read_only(table["target_xyz_m"]).reshape(3),
    )


def _check_origin(
    path: str | Path,
    origin: _Origin,
    region: Region,
    robot: Robot | None,
    target: Array | None,
) -> None:
    """Refuse a region that was made for another chain, or for a target more than a voxel away.

    Args:
        path: The file, which the message names.
        origin: Base, tip, joints and target that the region was made for.
        region: Gives the edge of a voxel [m].
        robot: The robot that the region is to be used for; None: it is not checked.
        target: Position of the target in the tip, shape (3,), [m]; None: it is not checked.

    Raises:
        CalibError: It was made for others.
    """
    same_chain = True
    if robot is not None:
        chain = (robot.base, robot.tip, list(robot.joint_names))
        same_chain = origin[:3] == chain
    distance = 0.0
    if target is not None:
        distance = float(np.linalg.norm(target - origin.target))
    if same_chain and distance <= region.voxel:
        return
    place = ", ".join(f"{1e3 * value:.6g}" for value in origin.target)
    raise CalibError(
        f"{path}: the region was made for the base {origin.base}, the tip {origin.tip}, the "
        f"joints {', '.join(origin.joints)} and a target at {place} mm: give the same --base, "
        "--tip, --hold and --target, or make the region again with 'calib workspace'."
    )
