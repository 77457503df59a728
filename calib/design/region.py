"""Region: the part of space that a robot is measured in, as the voxels of a grid, and as a file.

The file is JSON in SI units, see docs/workspace.md. It names robot, base, tip and target: in another base frame the
same numbers are another place.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from scipy.spatial import KDTree

from calib.errors import CalibError, FileError
from calib.files import damage, json_bytes, read_json, write_atomically
from calib.robot.robot import Robot, read_only
from calib.version import __version__

SCHEMA = "region 1"

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """Voxels of a grid in the base frame.

    Attributes:
        origin: shape (3,), the grid's least corner [m].
        voxel: Edge of a voxel [m].
        cells: shape (nx, ny, nz), whether a voxel belongs to the region. Read-only.
        share: The share of the probability that was asked for.
        held: The share of the samples that the voxels hold: not less than ``share``.

    Raises:
        CalibError: A shape or a number does not fit, or no voxel belongs to the region.
    """

    origin: Array
    voxel: float
    cells: Mask
    share: float
    held: float

    def __post_init__(self) -> None:
        """Copy the arrays and check them."""
        cells = np.array(self.cells, dtype=np.bool_)
        cells.setflags(write=False)
        object.__setattr__(self, "cells", cells)
        object.__setattr__(self, "origin", read_only(self.origin))
        if self.origin.shape != (3,) or cells.ndim != 3 or not 0.0 < self.voxel < np.inf:
            raise CalibError(
                f"A region's grid has an origin of shape {self.origin.shape}, voxels of {self.voxel} m and of shape "
                f"{cells.shape}; it needs three numbers, an edge above 0 and three dimensions."
            )
        if not cells.any():
            raise CalibError("The region is empty: no voxel belongs to it.")

    @property
    def volume(self) -> float:
        """Of all voxels [m^3]."""
        return float(np.count_nonzero(self.cells) * self.voxel**3)

    @property
    def bounds(self) -> Array:
        """Least and greatest corner of the box about the region, shape (2, 3), [m]."""
        index = np.argwhere(self.cells)
        ends = np.array([index.min(axis=0), index.max(axis=0) + 1])
        return read_only(self.origin + self.voxel * ends)

    def contains(self, points: ArrayLike) -> Mask:
        """Whether points of shape (N, 3), in the base frame [m], lie in the region, shape (N,)."""
        values = checked_points(points)
        index, known = voxel_of(values, self.origin, self.voxel, self.cells.shape)
        found: Mask = known & self.cells[tuple(index.T)]
        return found

    def depth(self, points: ArrayLike) -> Array:
        """Distance of points of shape (N, 3) to the region's border, shape (N,), [m]: negative outside.

        The border itself is known to about half a voxel.
        """
        values = checked_points(points)
        inside = self.contains(values)
        padded = np.pad(self.cells, 1)
        around = ndimage.binary_dilation(padded) & ~padded
        border = padded & ~ndimage.binary_erosion(padded)
        result = np.empty(len(values))
        result[inside] = self._distance(values[inside], np.argwhere(around) - 1)
        result[~inside] = -self._distance(values[~inside], np.argwhere(border) - 1)
        return result

    def _distance(self, points: Array, voxels: NDArray[np.intp]) -> Array:
        """From each point to the nearest of some voxels, shape (K, 3) of indices, shape (N,), [m]."""
        centres, half = self.origin + self.voxel * (voxels + 0.5), 0.5 * self.voxel
        tree, result = KDTree(centres), np.empty(len(points))
        reach = tree.query(points)[0] + 2.0 * np.sqrt(3.0) * half
        # A nearest voxel has its centre at most its diagonal farther than the nearest centre.
        for i, near in enumerate(tree.query_ball_point(points, reach) if len(points) else ()):
            gap = np.maximum(np.abs(centres[near] - points[i]) - half, 0.0)
            result[i] = np.sqrt(np.min(np.sum(gap**2, axis=1)))
        return result


def checked_points(points: ArrayLike) -> Array:
    """Points, which are finite numbers of shape (N, 3), [m]."""
    values = np.asarray(points, dtype=np.float64)
    if values.ndim != 2 or values.shape[1] != 3 or not np.isfinite(values).all():
        raise CalibError(
            f"Points of shape {values.shape} were given; finite numbers of shape (N, 3) are wanted."
        )
    return values


def voxel_of(
    points: Array, origin: Array, voxel: float, shape: tuple[int, ...]
) -> tuple[NDArray[np.intp], Mask]:
    """The voxel that each point lies in, indices of shape (N, 3), and whether it lies in the grid at all, (N,).

    The grid's outer faces belong to it. Points outside have the index of a voxel at the grid's edge.
    """
    at = (points - origin) / voxel
    last = np.array(shape)
    # Rounding must not put a point that made the grid outside of it.
    known: Mask = np.all((at >= -1e-9) & (at <= last + 1e-9), axis=1)
    index = np.floor(np.clip(at, 0.0, last - 0.5)).astype(np.intp)
    return index, known


@dataclass(frozen=True, slots=True, eq=False)
class RegionFile:
    """A region and what it was made from: the file's ``robot``, ``target_xyz_m``, ``samples`` and ``seed``."""

    region: Region
    about: Mapping[str, Any]

    @classmethod
    def of(
        cls, region: Region, robot: Robot, target: Array, ranges: Array, samples: int, seed: int
    ) -> RegionFile:
        """The file of a robot's region; ``ranges`` of shape (m, 2), [rad] or [m]."""
        joints = []
        for joint, (low, high) in zip(robot.inputs, ranges.tolist(), strict=True):
            unit = "m" if joint.type == "prismatic" else "rad"
            joints.append({"name": joint.name, f"low_{unit}": low, f"high_{unit}": high})
        made_for = {"name": robot.name, "base": robot.base, "tip": robot.tip, "joints": joints}
        numbers = {"target_xyz_m": target, "samples": samples, "seed": seed}
        return cls(region, {"robot": made_for, **numbers})

    def write(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the region as JSON, whole or not at all."""
        region, flat = self.region, self.region.cells.ravel()
        ends = np.flatnonzero(np.diff(flat)) + 1
        runs = np.diff([0, *ends, flat.size]).tolist()
        table = {
            "schema": SCHEMA,
            "calib": __version__,
            **self.about,
            "share": region.share,
            "held": region.held,
            "volume_m3": region.volume,
            "voxel_m": region.voxel,
            "origin_m": region.origin,
            "shape": region.cells.shape,
            # Voxels in the order of the last index first, as lengths of runs: outside, inside, outside, ...
            "runs": [0, *runs] if flat[0] else runs,
        }
        return write_atomically(Path(path), json_bytes(table), overwrite=overwrite)

    @classmethod
    def read(cls, path: str | Path) -> RegionFile:
        """Read what `write` wrote."""
        expected = f"a region of calib {__version__} has '{SCHEMA}'. Make it again with 'calib workspace -o'."
        table = read_json(path, "region", SCHEMA, expected)
        try:
            runs = np.asarray(table["runs"], dtype=np.int64)
            cells = np.repeat(np.arange(len(runs)) % 2 == 1, runs).reshape(table["shape"])
            voxel, share, held = (float(table[key]) for key in ("voxel_m", "share", "held"))
            about = {key: table[key] for key in ("robot", "target_xyz_m", "samples", "seed")}
            [about["robot"][key] for key in ("name", "base", "tip", "joints")]
            return cls(Region(table["origin_m"], voxel, cells, share, held), about)
        except (CalibError, KeyError, TypeError, ValueError, OverflowError) as error:
            raise FileError(
                f"{path}: the region is damaged: {damage(error)}. Write it again with 'calib workspace -o'."
            ) from error

    def check_fits(self, robot: Robot, target: Array | None = None) -> None:
        """Refuse a region of another base, tip or joints, or of a target more than a voxel away in the tip."""
        own = self.about["robot"]
        offset = 0.0 if target is None else np.subtract(target, self.about["target_xyz_m"])
        apart = float(np.linalg.norm(offset))
        moved = f"{1e3 * apart:.0f} mm away" if apart > self.region.voxel else "there"
        for what, here, there in (
            ("base", robot.base, own["base"]),
            ("tip", robot.tip, own["tip"]),
            ("joints", list(robot.joint_names), [joint["name"] for joint in own["joints"]]),
            ("target", moved, "there"),
        ):
            if here != there:
                raise CalibError(
                    f"The region was made for the {what} {there}, and now it is {here}: give the same --base, --tip, "
                    "--hold and --target, or make the region again with 'calib workspace'."
                )
