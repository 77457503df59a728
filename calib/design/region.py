"""Region: the part of space that a robot is measured in, as the voxels of a grid, and as a file.

The file is JSON in SI units, the unit in each key's suffix, versioned by ``schema``; see docs/workspace.md. Beside the
voxels it says which robot, base, tip and target it was made for: in another base frame the same numbers are another
place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from calib.errors import CalibError, FileError, choices
from calib.files import damage, json_bytes, read_json, write_atomically
from calib.robot.robot import Robot, read_only
from calib.version import __version__

SCHEMA = "region 1"

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Numbers that are held at once while distances to voxels are computed.
_CHUNK = 2_000_000


def no_box() -> Array:
    """A box without an end, shape (2, 3), [m]."""
    return read_only([[-np.inf] * 3, [np.inf] * 3])


def checked_box(box: ArrayLike) -> Array:
    """A box as its least and its greatest corner, shape (2, 3), [m], read-only.

    Raises:
        CalibError: Another shape, a NaN, or a corner that is not greater than the other along each axis.
    """
    corners = read_only(np.asarray(box, dtype=np.float64))
    if corners.shape != (2, 3) or np.isnan(corners).any() or not np.all(corners[0] < corners[1]):
        raise CalibError(
            f"The box is {np.asarray(box).tolist()} m; it must be two corners of three numbers, the second greater "
            "than the first along x, y and z."
        )
    return corners


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """Voxels of a grid in the base frame, cut off by a box.

    Attributes:
        origin: shape (3,), the grid's least corner [m].
        voxel: Edge of a voxel [m].
        cells: shape (nx, ny, nz), whether a voxel belongs to the region. Read-only.
        share: The share of the probability that was asked for.
        held: The share of the samples that the voxels hold: not less than ``share``.
        box: shape (2, 3), least and greatest corner of a box that the region ends at [m]; infinite where there is none.

    Raises:
        CalibError: A shape or a number does not fit, or no voxel belongs to the region.
    """

    origin: Array
    voxel: float
    cells: Mask
    share: float
    held: float
    box: Array = field(default_factory=no_box)

    def __post_init__(self) -> None:
        """Copy the arrays and check them."""
        cells = np.array(self.cells, dtype=np.bool_)
        cells.setflags(write=False)
        object.__setattr__(self, "cells", cells)
        object.__setattr__(self, "origin", read_only(self.origin))
        object.__setattr__(self, "box", checked_box(self.box))
        if self.origin.shape != (3,) or cells.ndim != 3 or not 0.0 < self.voxel < np.inf:
            raise CalibError(
                f"A region's grid has an origin of shape {self.origin.shape}, voxels of {self.voxel} m and of shape "
                f"{cells.shape}; it needs three numbers, an edge above 0 and three dimensions."
            )
        if not self.volume > 0.0:
            raise CalibError(
                "The region is empty: no voxel of it lies inside of the box. Give a larger box."
            )

    @property
    def volume(self) -> float:
        """Of all voxels, cut off by the box [m^3]."""
        widths = []
        for axis, count in enumerate(self.cells.shape):
            edges = self.origin[axis] + self.voxel * np.arange(count + 1)
            inside = np.clip(edges, self.box[0, axis], self.box[1, axis])
            widths.append(np.diff(inside))
        return float(np.einsum("ijk,i,j,k", self.cells.astype(np.float64), *widths))

    @property
    def bounds(self) -> Array:
        """Least and greatest corner of the box about the region, shape (2, 3), [m]."""
        low, high = self._voxels(self.cells)
        return read_only([low.min(axis=0), high.max(axis=0)])

    def contains(self, points: ArrayLike) -> Mask:
        """Whether points of shape (N, 3), in the base frame [m], lie in the region, shape (N,)."""
        values = checked_points(points)
        inside = np.all((values >= self.box[0]) & (values <= self.box[1]), axis=1)
        index, known = voxel_of(values, self.origin, self.voxel, self.cells.shape)
        found: Mask = inside & known & self.cells[tuple(index.T)]
        return found

    def depth(self, points: ArrayLike) -> Array:
        """How deep points of shape (N, 3) lie inside of the region, shape (N,), [m]: negative outside.

        It is their distance to the border, which itself is known to about half a voxel.
        """
        values = checked_points(points)
        inside = self.contains(values)
        result = np.empty(len(values))
        padded = np.pad(self.cells, 1)
        around = ndimage.binary_dilation(padded) & ~padded
        low, high = self._voxels(around, shift=-1, cut=False)
        result[inside] = _distance(values[inside], low, high)
        for corner in self.box:
            result[inside] = np.minimum(result[inside], np.abs(values[inside] - corner).min(axis=1))
        # A voxel is nearest only if it has a free side, or the box cuts it.
        cut = np.isfinite(self.box).any()
        border = self.cells if cut else self.cells & ~ndimage.binary_erosion(self.cells)
        result[~inside] = -_distance(values[~inside], *self._voxels(border))
        return result

    def _voxels(self, chosen: Mask, shift: int = 0, *, cut: bool = True) -> tuple[Array, Array]:
        """Least and greatest corners of the chosen voxels, shape (K, 3) each, [m], cut off by the box.

        ``shift`` is added to their indices; without ``cut`` the box does not count.
        """
        index = np.argwhere(chosen) + shift
        low = self.origin + self.voxel * index
        high = low + self.voxel
        if not cut:
            return low, high
        low, high = np.maximum(low, self.box[0]), np.minimum(high, self.box[1])
        left = np.all(low < high, axis=1)
        return low[left], high[left]


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


def _distance(points: Array, low: Array, high: Array) -> Array:
    """From each point to the nearest of some boxes, shape (N,), [m]; 0 inside of one."""
    step = max(1, _CHUNK // max(1, 3 * len(low)))
    found: list[Any] = [np.zeros(0)]
    for start in range(0, len(points), step):
        near = points[start : start + step, None]
        gap = np.maximum(np.maximum(low - near, near - high), 0.0)
        found.append(np.sqrt(np.min(np.einsum("nki,nki->nk", gap, gap), axis=1)))
    return np.concatenate(found)


@dataclass(frozen=True, slots=True, eq=False)
class RegionFile:
    """A region and what it was made from.

    Attributes:
        region: The region, in the base frame.
        robot: The robot's name in the URDF.
        base: Base link.
        tip: Tip link.
        joints: Of each joint its ``name``, and between which values it was moved, ``low_rad`` and ``high_rad``; of one
            that slides ``low_m`` and ``high_m``.
        target: shape (3,), the target in the tip [m].
        samples: How many samples the region was made from.
        seed: Their seed.
    """

    region: Region
    robot: str
    base: str
    tip: str
    joints: Sequence[Mapping[str, Any]]
    target: Array
    samples: int
    seed: int

    @classmethod
    def of(
        cls, region: Region, robot: Robot, target: Array, ranges: Array, samples: int, seed: int
    ) -> RegionFile:
        """The file of a robot's region; ``ranges`` of shape (m, 2), [rad] or [m]."""
        joints = []
        for name, (low, high) in zip(robot.joint_names, ranges.tolist(), strict=True):
            unit = "m" if robot.joint_types[name] == "prismatic" else "rad"
            joints.append({"name": name, f"low_{unit}": low, f"high_{unit}": high})
        return cls(region, robot.name, robot.base, robot.tip, joints, target, samples, seed)

    def write(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the region as JSON, whole or not at all.

        Raises:
            FileError: The file exists and ``overwrite`` is False, or it cannot be written.
        """
        region, flat = self.region, self.region.cells.ravel()
        ends = np.flatnonzero(np.diff(flat)) + 1
        runs = np.diff([0, *ends, flat.size]).tolist()
        table = {
            "schema": SCHEMA,
            "calib": __version__,
            "robot": {
                "name": self.robot,
                "base": self.base,
                "tip": self.tip,
                "joints": self.joints,
            },
            "target_xyz_m": self.target,
            "samples": self.samples,
            "seed": self.seed,
            "share": region.share,
            "held": region.held,
            "volume_m3": region.volume,
            "box_m": region.box if np.isfinite(region.box).any() else None,
            "voxel_m": region.voxel,
            "origin_m": region.origin,
            "shape": region.cells.shape,
            # Voxels in the order of the last index first, as lengths of runs: outside, inside, outside, ...
            "runs": [0, *runs] if flat[0] else runs,
        }
        return write_atomically(Path(path), json_bytes(table), overwrite=overwrite)

    @classmethod
    def read(cls, path: str | Path) -> RegionFile:
        """Read what `write` wrote.

        Raises:
            FileError: The file cannot be read, is no JSON, no region of calib, of another schema, or damaged.
        """
        expected = (
            f"a region of calib {__version__} has '{SCHEMA}'. Give the file that 'calib workspace -o' wrote, by "
            "the same version."
        )
        table = read_json(path, "region", SCHEMA, expected)
        try:
            robot, runs = table["robot"], np.asarray(table["runs"], dtype=np.int64)
            # null is a side without an end.
            box = np.asarray(table["box_m"] or [[None] * 3] * 2, dtype=np.float64)
            region = Region(
                origin=table["origin_m"],
                voxel=float(table["voxel_m"]),
                cells=np.repeat(np.arange(len(runs)) % 2 == 1, runs).reshape(table["shape"]),
                share=float(table["share"]),
                held=float(table["held"]),
                box=np.where(np.isnan(box), [[-np.inf], [np.inf]], box),
            )
            names = (robot["name"], robot["base"], robot["tip"], robot["joints"])
            return cls(
                region, *names, read_only(table["target_xyz_m"]), table["samples"], table["seed"]
            )
        except (CalibError, KeyError, TypeError, ValueError, OverflowError) as error:
            raise FileError(
                f"{path}: the region is damaged: {damage(error)}. Write it again with 'calib workspace -o'."
            ) from error

    def check_fits(self, robot: Robot, target: Array | None = None) -> tuple[str, ...]:
        """Whether the region is one of this robot: refuse another base, say what else differs.

        Args:
            robot: The robot that the region is wanted for.
            target: shape (3,), its target in the tip [m]; None where it is not known.

        Returns:
            Sentences on what differs and may well be meant so: the robot's name, or the target by more than a voxel.

        Raises:
            CalibError: The region is in the frame of another base, or of another tip or other joints.
        """
        for what, here, there in (("base", robot.base, self.base), ("tip", robot.tip, self.tip)):
            if here != there:
                raise CalibError(
                    f"The region was made for the {what} '{there}' of '{self.robot}', and the {what} is '{here}' now. "
                    f"Give --{what} {there}, or make the region again with 'calib workspace'."
                )
        names = tuple(joint["name"] for joint in self.joints)
        if robot.joint_names != names:
            raise CalibError(
                f"The region was made for the joints {choices(names)} of '{self.robot}'; the chain '{robot.base}' to "
                f"'{robot.tip}' of '{robot.name}' has {choices(robot.joint_names)}. Give the same --hold, or make the "
                "region again with 'calib workspace'."
            )
        notes = []
        if robot.name != self.robot:
            notes.append(f"The region was made for '{self.robot}', this robot is '{robot.name}'.")
        apart = 0.0 if target is None else float(np.linalg.norm(target - self.target))
        if apart > self.region.voxel:
            notes.append(
                f"The region was made for a target {1e3 * apart:.0f} mm away from this one in the tip; make it again "
                "with 'calib workspace --target' if that matters."
            )
        return tuple(notes)
