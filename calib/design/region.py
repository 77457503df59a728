"""Region: the part of space that a robot is measured in, as the voxels of a grid."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from calib.errors import CalibError
from calib.model.robot import read_only

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
        if self.origin.shape != (3,) or not np.isfinite(self.origin).all() or cells.ndim != 3:
            raise CalibError(
                f"A region's grid has an origin of shape {self.origin.shape} and voxels of shape {cells.shape}; it "
                "needs three finite numbers and three dimensions."
            )
        if not (0.0 < self.voxel < np.inf):
            raise CalibError(f"A region's voxel is {self.voxel} m; it must be greater than 0.")
        if not (0.0 < self.share <= 1.0 and 0.0 < self.held <= 1.0):
            raise CalibError(
                f"A region's shares are {self.share} and {self.held}; they are greater than 0, at most 1."
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
        """Whether points lie in the region.

        Args:
            points: shape (N, 3), in the base frame [m].

        Returns:
            shape (N,).
        """
        values = checked_points(points)
        inside = np.all((values >= self.box[0]) & (values <= self.box[1]), axis=1)
        index, known = voxel_of(values, self.origin, self.voxel, self.cells.shape)
        found: Mask = inside & known & self.cells[tuple(index.T)]
        return found

    def depth(self, points: ArrayLike) -> Array:
        """How deep points lie inside of the region: their distance to its border, negative outside.

        Args:
            points: shape (N, 3), in the base frame [m].

        Returns:
            shape (N,), [m]. The border itself is known to about half a voxel.
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
        result[~inside] = -_distance(values[~inside], *self._voxels(self.cells & self._on_border()))
        return result

    def within(self, box: ArrayLike) -> Region:
        """The part of the region inside of a box as well.

        Args:
            box: shape (2, 3), least and greatest corner, in the base frame [m].

        Raises:
            CalibError: It is no box, or nothing of the region lies inside.
        """
        corners = checked_box(box)
        low, high = np.maximum(self.box[0], corners[0]), np.minimum(self.box[1], corners[1])
        if not np.all(low < high):
            raise CalibError(
                "The region is empty: no voxel of it lies inside of the box. Give a larger box."
            )
        return replace(self, box=np.array([low, high]))

    def _on_border(self) -> Mask:
        """The voxels of which a side is free, or that the box may cut."""
        if np.isfinite(self.box).any():
            return np.ones_like(self.cells)
        inner: Mask = ~ndimage.binary_erosion(self.cells)
        return inner

    def _voxels(self, chosen: Mask, shift: int = 0, *, cut: bool = True) -> tuple[Array, Array]:
        """Least and greatest corners of voxels, shape (K, 3) each, [m], cut off by the box.

        Args:
            chosen: shape (nx, ny, nz), which.
            shift: What is added to their indices.
            cut: Whether the box cuts them off; those that lie outside are then left out.
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
    """Points as finite numbers of shape (N, 3), [m].

    Raises:
        CalibError: They are not.
    """
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
