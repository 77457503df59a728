"""A region as a file: JSON in SI units, see docs/workspace.md.

It names the robot, base, tip, joints and target: in another base frame the same numbers mean another place.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from calib.basics.arrays import Array, read_only
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
        view: The region, and what it was made from.
        path: The file.
        seed: Seed with which the samples of the workspace were drawn.
        overwrite: Whether an existing file is replaced.

    Returns:
        The path of the file.

    Raises:
        FileError: It cannot be written.
    """
    robot, region = view.robot, view.region
    joints = []
    for joint, (low, high) in zip(robot.inputs, view.ranges, strict=True):
        unit = "m" if joint.type == "prismatic" else "rad"
        joints.append({"name": joint.name, f"low_{unit}": low, f"high_{unit}": high})
    table = {
        "schema": SCHEMA,
        "calib": __version__,
        "robot": {
            "name": robot.name,
            "base": robot.base,
            "tip": robot.tip,
            "joints": joints,
        },
        "target_xyz_m": view.target,
        "samples": view.density.samples,
        "seed": seed,
        "volume_m3": region.volume,
        **region_table(region),
    }
    return write_atomically(path, json_bytes(table), overwrite=overwrite)


def region_table(region: Region) -> dict[str, Any]:
    """Return the voxels of a region as JSON has them; `region_of_table` makes the same region of it."""
    # Lengths of runs of voxels outside, inside, outside, ... of the region, the last index varying fastest. The first
    # run is outside, of length 0 if the first voxel is inside.
    flat = region.cells.ravel()
    changes = np.flatnonzero(np.diff(flat)) + 1
    runs = np.diff([0, *changes, flat.size]).tolist()
    if flat[0]:
        runs.insert(0, 0)
    return {
        "share": region.share,
        "held": region.held,
        "voxel_m": region.voxel,
        "origin_m": region.origin,
        "shape": region.cells.shape,
        "runs": runs,
    }


def region_of_table(table: Mapping[str, Any]) -> Region:
    """Return the region of a table that `region_table` made; one that is damaged raises what reading it raises."""
    runs = np.asarray(table["runs"], dtype=np.int64)
    is_inside = np.arange(len(runs)) % 2 == 1
    return Region(
        origin=read_only(table["origin_m"]).reshape(3),
        voxel=float(table["voxel_m"]),
        cells=np.repeat(is_inside, runs).reshape(table["shape"]),
        share=float(table["share"]),
        held=float(table["held"]),
    )


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
        region = region_of_table(table)
        base, tip = table["robot"]["base"], table["robot"]["tip"]
        joints = [joint["name"] for joint in table["robot"]["joints"]]
        of_file = read_only(table["target_xyz_m"]).reshape(3)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise FileError(
            f"{path}: the region is damaged: {damage(error)}. "
            "Write it again with 'calib workspace -o'."
        ) from error
    is_same_chain = True
    if robot is not None:
        is_same_chain = (base, tip, joints) == (robot.base, robot.tip, list(robot.joint_names))
    distance = 0.0 if target is None else float(np.linalg.norm(target - of_file))
    if not is_same_chain or distance > region.voxel:
        place = ", ".join(f"{1e3 * value:.6g}" for value in of_file)
        raise CalibError(
            f"{path}: the region was made for the base {base}, the tip {tip}, the "
            f"joints {', '.join(joints)} and a target at {place} mm: give the same --base, "
            "--tip, --hold and --target, or make the region again with 'calib workspace'."
        )
    return region
