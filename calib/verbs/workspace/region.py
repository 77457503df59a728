"""Density and region: how often samples of a workspace lie in each voxel, and the voxels that hold most of them.

The positions of a target are counted in the voxels of a grid. With n of N samples in a voxel of edge h, the density is

    f = n / (N h^3).

It is smoothed with the weights (1, 2, 1) / 4 along each axis, over reached voxels only, so that nothing leaks out of
the workspace. The region for a share p of the samples collects voxels in falling order of the smoothed density until
their counts add up to p N.

Unless the voxel is given, it is the smallest round length at which a smoothed count rests on `SAMPLES_PER_VOXEL`
samples on average: a statistical error of 6 % (10 % at the border of the region of 95 %).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.basics.arguments import check_number, check_type, finite_numbers, numbers, wrong_type
from calib.basics.arrays import Array, Mask
from calib.basics.values import Value, one_line
from calib.errors import CalibError, ModelError
from calib.numerics.geometry import vector

#: Samples that a smoothed count rests on, on average over reached voxels, if the voxel's size is chosen.
SAMPLES_PER_VOXEL = 300.0

#: Largest number of voxels of a grid: 4 million take 32 MB for their counts.
MOST_VOXELS = 4_000_000

#: Largest number of voxels along an axis, if their size is chosen.
_FINEST = 128

#: Weights of a voxel and its two neighbours along an axis.
_WEIGHTS = np.array([0.25, 0.5, 0.25])

#: First digits of a round length.
_ROUND_DIGITS = (1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8)

#: Round lengths in rising order [m].
_ROUND_LENGTHS = tuple(float(f"{n}e{k}") for k in range(-9, 6) for n in _ROUND_DIGITS)

#: Points that lie outside the grid by less than this share of a voxel count as inside: the grid was made of them.
_FACE = 1e-9

#: A side that differs from a whole number of voxels by less than this is that number: the rest is rounding.
_WHOLE = 1e-6

#: Points closer together than this are one point, whose voxel has the edge `_SPOT_VOXEL` [m].
_SPOT = 1e-9
_SPOT_VOXEL = 1e-3

#: Words for positions of points in messages.
_POSITIONS = "positions of shape (N, 3), [m]"


@dataclass(frozen=True, slots=True, eq=False)
class Region(Value):
    """Part of space in which a robot is measured: voxels of a grid in the base frame."""

    #: Shape (3,), the corner of the grid with the least x, y, z [m].
    origin: Array
    #: Edge of a voxel [m].
    voxel: float
    #: Shape (nx, ny, nz), whether a voxel belongs to the region.
    cells: Mask
    #: Share of the samples that the region was made for, 0 to 1.
    share: float
    #: Share of the samples that the voxels hold: not less than ``share``.
    held: float

    def __post_init__(self) -> None:
        """Check the values, and keep read-only copies of the arrays."""
        object.__setattr__(self, "origin", vector(self.origin, "origin"))
        for name in ("voxel", "share", "held"):
            check_number(name, getattr(self, name))
        cells = np.array(self.cells)
        if cells.dtype != np.bool_ or cells.ndim != 3:
            raise wrong_type(
                "cells", self.cells, "True or False for each voxel, shape (nx, ny, nz)"
            )
        cells.setflags(write=False)
        object.__setattr__(self, "cells", cells)

    def __repr__(self) -> str:
        """Return one line: volume, voxels, share of the samples."""
        volume = f"{1e3 * self.volume:.4g} litres"
        voxels = f"{np.count_nonzero(self.cells)} voxels of {1e3 * self.voxel:g} mm"
        return one_line("Region", volume, voxels, f"{100.0 * self.held:.4g} % of the samples")

    @classmethod
    def box(cls, low: ArrayLike, high: ArrayLike) -> Region:
        """Make the region of a box along the axes of the base frame.

        Args:
            low: Its corner with the least x, y, z, shape (3,), [m].
            high: The opposite corner, shape (3,), [m].

        Returns:
            Voxels that hold the box, and no more than a tenth of its shortest side beyond it.

        Raises:
            CalibError: A corner that is no position, or a side without a length.
        """
        first, last = vector(low, "low"), vector(high, "high")
        sides = last - first
        if not np.all(sides > 0.0):
            raise CalibError(
                f"The box from {first.tolist()} to {last.tolist()} m has no extent along an axis; 'low' has the least "
                "x, y and z, 'high' the largest."
            )
        voxel = float(sides.min()) / 10.0
        shape = np.ceil(sides / voxel - _WHOLE).astype(int)
        return cls(first, voxel, np.ones(tuple(shape.tolist()), dtype=np.bool_), 1.0, 1.0)

    @classmethod
    def of_points(
        cls, points: ArrayLike, share: float = 0.95, *, voxel: float | None = None
    ) -> Region:
        """Collect the smallest region that holds a share of points.

        Args:
            points: Positions in the robot's base frame, shape (N, 3), [m], such as
                `calib.verbs.workspace.workspace.workspace_points` samples.
            share: Share of the points, greater than 0 and at most 1.
            voxel: Edge of a voxel [m]; None: chosen by the points, see `Density.of`.

        Raises:
            ArgumentError: Points or voxel are not numbers.
            CalibError: No points, another shape, a share outside of that range, or too many voxels.
        """
        return Density.of(points, voxel).region(share)

    @property
    def points(self) -> Array:
        """Centres of the region's voxels, in the base frame, shape (n, 3), [m]."""
        return np.asarray(self.origin + self.voxel * (np.argwhere(self.cells) + 0.5))

    @property
    def volume(self) -> float:
        """Volume of all voxels of the region [m^3]."""
        return float(np.count_nonzero(self.cells) * self.voxel**3)

    @property
    def bounds(self) -> Array:
        """Least and greatest corner of the box around the region, in the base frame, shape (2, 3), [m]."""
        index = np.argwhere(self.cells)
        corners = np.array([index.min(axis=0), index.max(axis=0) + 1])
        return self.origin + self.voxel * corners

    def contains(self, points: ArrayLike) -> Mask:
        """Test which points lie in one of the region's voxels.

        Args:
            points: Positions in the robot's base frame, shape (N, 3) or (3,), [m].

        Returns:
            True inside, shape (N,).

        Raises:
            ArgumentError: They are not numbers.
            ModelError: They have another shape, or are not finite.
        """
        positions = np.atleast_2d(numbers("points", points, _POSITIONS))
        positions = finite_numbers("points", positions, (None, 3), _POSITIONS)
        index, in_grid = _voxel_of(positions, self.origin, self.voxel, self.cells.shape)
        inside: Mask = in_grid & self.cells[tuple(index.T)]
        return inside


@dataclass(frozen=True, slots=True, eq=False)
class Density(Value):
    """Counts of samples in the voxels of a grid in the base frame."""

    #: Shape (3,), the corner of the grid with the least x, y, z [m].
    origin: Array
    #: Edge of a voxel [m].
    voxel: float
    #: Shape (nx, ny, nz), samples in each voxel.
    counts: NDArray[np.int64]
    #: Shape (nx, ny, nz), the counts smoothed over neighbours, 0 where there is no sample.
    smooth: Array
    #: Shape (nx, ny, nz), the smallest share of the samples, 0 to 1, whose region contains the voxel; infinite if it
    #: holds no sample.
    needed: Array

    @classmethod
    def of(cls, points: ArrayLike, voxel: float | None = None) -> Density:
        """Count samples of a workspace in the voxels of a grid.

        Args:
            points: Positions of a target in the robot's base frame, shape (N, 3), [m].
            voxel: Edge of a voxel [m]; None: the smallest round length at which a smoothed count rests on
                `SAMPLES_PER_VOXEL` samples on average.

        Returns:
            The counts, as they are and smoothed, on a grid that is centred on the box around the points.

        Raises:
            ArgumentError: Points or voxel are not numbers.
            ModelError: There are no points, or they have another shape or are not finite.
            CalibError: The grid would have more than `MOST_VOXELS` voxels.
        """
        samples = finite_numbers("points", points, (None, 3), _POSITIONS)
        if not len(samples):
            raise ModelError(f"There are no points; 'points' must be {_POSITIONS}.")
        if voxel is not None:
            check_number("voxel", voxel)
        edge = _choose_voxel(samples) if voxel is None else float(voxel)
        origin, counts = _count(samples, edge)
        smooth, _ = _smooth(counts)
        densest_first = np.argsort(-smooth.ravel(), kind="stable")
        reached = densest_first[: np.count_nonzero(counts)]
        needed = np.full(counts.size, np.inf)
        needed[reached] = np.cumsum(counts.ravel()[reached]) / len(samples)
        return cls(origin, edge, counts, smooth, needed.reshape(counts.shape))

    @property
    def samples(self) -> int:
        """Number of samples in all voxels together."""
        return int(self.counts.sum())

    @property
    def extent(self) -> Array:
        """Least and greatest corner of the box around all voxels with samples, in the base frame, shape (2, 3), [m]."""
        return Region(self.origin, self.voxel, self.counts > 0, 1.0, 1.0).bounds

    def region(self, share: float = 0.95) -> Region:
        """Collect voxels in falling order of the smoothed density until they hold a share of the samples.

        The order is that of the smoothed counts, the share that of the counts themselves; so a few voxels fewer may
        hold the same share.

        Args:
            share: Share of the samples, greater than 0 and at most 1.

        Returns:
            The voxels, on the same grid in the robot's base frame.

        Raises:
            CalibError: The share is outside of that range.
        """
        check_type("share", share, (int, float, np.number), "a number greater than 0 and at most 1")
        if not 0.0 < share <= 1.0:
            raise CalibError(
                f"The share is {share:g}; it must be greater than 0 and at most 1, such as 0.95."
            )
        # Sums of counts are exact: 0.95 of 100 samples must be 95 of them, in spite of rounding.
        enough = self.needed[self.needed >= share * (1.0 - 1e-12)]
        held = float(enough.min())
        return Region(self.origin, self.voxel, self.needed <= held, float(share), held)

    def share_of(self, points: ArrayLike) -> Array:
        """Return for each point the smallest share of the samples, 0 to 1, whose region holds it.

        Args:
            points: Positions in the robot's base frame, shape (N, 3), [m].

        Returns:
            Shape (N,): near 0 where the target is most often, 1 at the rim of the workspace, infinite where no sample
            lies.
        """
        index, in_grid = _voxel_of(np.asarray(points), self.origin, self.voxel, self.counts.shape)
        return np.where(in_grid, self.needed[tuple(index.T)], np.inf)


def _voxel_of(
    points: Array,
    origin: Array,
    voxel: float,
    shape: tuple[int, ...],
) -> tuple[NDArray[np.intp], Mask]:
    """Return the indices (N, 3) of the voxel that holds each point (N, 3) [m], and which points lie in the grid, (N,).

    A point outside of the grid has the nearest voxel.
    """
    place = (points - origin) / voxel
    last = np.array(shape)
    # Rounding must not put a point that made the grid outside of it.
    in_grid: Mask = np.all((place >= -_FACE) & (place <= last + _FACE), axis=1)
    index = np.floor(np.clip(place, 0.0, last - 0.5)).astype(np.intp)
    return index, in_grid


def _count(points: Array, voxel: float) -> tuple[Array, NDArray[np.int64]]:
    """Return the least corner (3,) of a grid centred on points (N, 3) [m], and the points in each voxel (nx, ny, nz).

    Raises `CalibError` if there would be more than `MOST_VOXELS` voxels.
    """
    low = points.min(axis=0)
    high = points.max(axis=0)
    sides = np.full(3, np.inf)
    if voxel > 0.0:
        sides = np.ceil((high - low) / voxel - _WHOLE).clip(1.0)
    if np.prod(sides) > MOST_VOXELS:
        raise CalibError(
            f"Voxels of {1e3 * voxel:g} mm make a grid of {np.prod(sides):.3g}; at most "
            f"{MOST_VOXELS:,} are made. Give larger ones."
        )
    origin = 0.5 * (low + high) - 0.5 * voxel * sides
    shape = tuple(int(n) for n in sides)
    index, _ = _voxel_of(points, origin, voxel, shape)
    flat = np.ravel_multi_index(tuple(index.T), shape)
    counts = np.bincount(flat, minlength=int(np.prod(shape)))
    return origin, counts.reshape(shape)


def _smooth(counts: NDArray[np.int64]) -> tuple[Array, Array]:
    """Average the count (nx, ny, nz) of each voxel that holds samples with its neighbours that do; others are 0.

    The second grid is the number of voxels that each mean stands for, by its variance: (sum w)^2 / sum w^2.
    """
    reached = (counts > 0).astype(np.float64)
    weight = _spread(reached, _WEIGHTS)
    total = _spread(counts.astype(np.float64), _WEIGHTS)
    mean = reached * total / np.maximum(weight, np.finfo(float).tiny)
    squares = _spread(reached, _WEIGHTS**2)
    return mean, reached * weight**2 / np.maximum(squares, 1e-300)


def _spread(values: Array, weights: Array) -> Array:
    """Convolve values (nx, ny, nz) along each axis with weights (3,) of a voxel and its neighbours; 0 outside."""
    from scipy import ndimage  # imported late: a region that was written has been smoothed

    spread = values
    for axis in range(3):
        spread = ndimage.convolve1d(spread, weights, axis=axis, mode="constant")
    return spread


def _choose_voxel(points: Array) -> float:
    """Choose the smallest round edge [m] at which smoothed counts of points (N, 3) rest on enough samples on average.

    If none is enough, it is the first one that is as long as the points' extent; `_SPOT_VOXEL` if all points are one.
    """
    longest = float(np.ptp(points, axis=0).max())
    if longest < _SPOT:
        return _SPOT_VOXEL
    finest = longest / _FINEST * (1.0 - 1e-9)
    for voxel in _ROUND_LENGTHS:
        if not finest <= voxel < longest:
            continue
        _, counts = _count(points, voxel)
        _, voxels_per_mean = _smooth(counts)
        reached = np.count_nonzero(counts)
        samples_per_mean = float(voxels_per_mean.sum()) / reached * len(points) / reached
        if samples_per_mean >= SAMPLES_PER_VOXEL:
            return voxel
    return next(length for length in _ROUND_LENGTHS if length >= longest)
