"""Where a target lies, how often, and the region that holds most of it (the paper, section 4.3).

Joint values are drawn evenly by a scrambled Sobol sequence, and the target's positions counted in the voxels of a grid.
The count n of a voxel of edge h, among N samples, is the density f = n / (N h^3), smoothed over neighbours by
(1, 2, 1) / 4 along each axis and among reached voxels alone, so that nothing leaks out of the workspace. The region of
a share is made of the fewest voxels that hold it: those of the highest density first.

Unless it is given, the voxel is the smallest round length for which a smoothed count rests on `SAMPLES_PER_VOXEL`
samples in the mean, a statistical error of 6 % (10 % at the border of 95 %).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from calib.data.measurements import Measurements
from calib.data.ranges import joint_ranges
from calib.data.surroundings import vector
from calib.design.region import Region, checked_points, voxel_of
from calib.errors import CalibError
from calib.robot.robot import Robot, read_only

Array = NDArray[np.float64]

#: Samples by default, and samples that the smoothed count of a voxel rests on in the mean where its size is chosen.
COUNT, SAMPLES_PER_VOXEL = 2**17, 300.0

#: The most voxels of a grid, and the most along an axis where the size is chosen here.
MOST_VOXELS, _FINEST = 4_000_000, 128

#: Samples that are computed at once.
_CHUNK = 2**15

#: Weights of a voxel and its two neighbours along an axis, and first figures of round lengths.
_WEIGHTS, _ROUND = np.array([0.25, 0.5, 0.25]), (1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10)


def workspace(
    robot: Robot,
    target: ArrayLike = (0.0, 0.0, 0.0),
    ranges: ArrayLike | None = None,
    count: int = COUNT,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Array:
    """Where a target lies when the joints take all their values equally often.

    Args:
        robot: The robot.
        target: shape (3,), the target in the tip [m].
        ranges: shape (m, 2), lowest and highest value of each joint [rad] or [m]; None: those of `joint_ranges`.
        count: How many samples; a power of two is spread the most evenly.
        seed: The same seed gives the same points.
        progress: Called with the samples done and all.

    Returns:
        shape (count, 3), in the base frame [m], read-only.
    """
    # Not above: SciPy's distributions take as long to import as the rest of calib.
    from scipy.stats import qmc

    point = vector(target, "target's position in the tip")
    ends = joint_ranges(robot) if ranges is None else np.asarray(ranges, dtype=np.float64)
    sequence = qmc.Sobol(len(ends), scramble=True, seed=np.random.default_rng(seed))
    points = np.empty((count, 3))
    low, high = ends.T
    for start in range(0, count, _CHUNK):
        # The first piece is a power of two long, as SciPy asks.
        unit = sequence.random(_CHUNK)[: count - start]
        poses = robot.poses(low + unit * (high - low))
        points[start : start + _CHUNK] = poses[:, :3, :3] @ point + poses[:, :3, 3]
        if progress is not None:
            progress(start + len(unit), count)
    points.setflags(write=False)
    return points


@dataclass(frozen=True, slots=True, eq=False)
class Density:
    """How often samples lie in each voxel of a grid in the base frame.

    Attributes:
        origin: shape (3,), the grid's least corner [m].
        voxel: Edge of a voxel [m].
        counts: shape (nx, ny, nz), samples in each voxel. Read-only.
        smooth: shape (nx, ny, nz), the same smoothed over neighbours, 0 where there is no sample. Read-only.
    """

    origin: Array
    voxel: float
    counts: NDArray[np.int64]
    smooth: Array

    @classmethod
    def of(cls, points: ArrayLike, voxel: float | None = None) -> Density:
        """Count points of shape (N, 3), in the base frame [m]; None: a voxel of a size that suits them.

        Raises:
            CalibError: No points, or a voxel that makes no grid, or one of more than `MOST_VOXELS`.
        """
        values = checked_points(points)
        if not len(values):
            raise CalibError("No points were given to count; give one at least.")
        low, high = values.min(axis=0), values.max(axis=0)
        edge = _chosen_voxel(values, low, high) if voxel is None else float(voxel)
        origin, counts = _counted(values, low, high, edge)
        counts.setflags(write=False)
        return cls(origin, edge, counts, read_only(_smoothed(counts)[0]))

    @property
    def samples(self) -> int:
        """How many points were counted."""
        return int(self.counts.sum())

    @property
    def extent(self) -> Array:
        """Least and greatest corner of the voxels that hold samples, shape (2, 3), [m]."""
        return Region(self.origin, self.voxel, self.counts > 0, 1.0, 1.0).bounds

    @property
    def error(self) -> float:
        """Relative statistical error of the smoothed density of a voxel, in the mean."""
        return float(1.0 / np.sqrt(_rests_on(self.counts)))

    def region(self, share: float = 0.95) -> Region:
        """The fewest voxels that hold a share of the samples: those of the highest density first.

        Raises:
            CalibError: The share is not greater than 0 and at most 1.
        """
        if not 0.0 < share <= 1.0:
            raise CalibError(
                f"The share is {share:g}; it must be greater than 0 and at most 1, such as 0.95."
            )
        order, held = self._by_density()
        # Sums of counts are exact, so that 0.95 of 100 samples is 95 of them.
        last = int(np.searchsorted(held, share * (1.0 - 1e-12)))
        cells = np.isin(np.arange(self.counts.size), order[: last + 1]).reshape(self.counts.shape)
        return Region(self.origin, self.voxel, cells, float(share), float(held[last]))

    def share_of(self, points: ArrayLike) -> Array:
        """The smallest share whose region holds each of the points, shape (N, 3), in the base frame [m].

        shape (N,): near 0 where the target is most often, 1 at the rim of the workspace, infinite where no sample came.
        """
        order, held = self._by_density()
        needed = np.full(self.counts.size, np.inf)
        needed[order] = held
        values = checked_points(points)
        index, known = voxel_of(values, self.origin, self.voxel, self.counts.shape)
        found = needed.reshape(self.counts.shape)[tuple(index.T)]
        return read_only(np.where(known, found, np.inf))

    def _by_density(self) -> tuple[NDArray[np.intp], Array]:
        """The voxels with samples, densest first, and the share that those up to each hold."""
        order = np.argsort(-self.smooth.ravel(), kind="stable")[: np.count_nonzero(self.counts)]
        held = np.cumsum(self.counts.ravel()[order]) / self.samples
        return order, held


class Checked(NamedTuple):
    """A table, its points in the base (N, 3), whether they were measured (N,), and where they are predicted."""

    rows: Measurements
    points: Array
    measured: NDArray[np.bool_]
    predicted: Array


@dataclass(frozen=True, slots=True, eq=False)
class RegionView:
    """A region of a robot's workspace as it is printed and drawn.

    Attributes:
        robot: The nominal robot.
        target: shape (3,), in the tip [m].
        ranges: shape (m, 2), of the joints [rad] or [m].
        density: The density.
        region: A region of it.
        checked: A table whose rows are compared with the region; None for none.
    """

    robot: Robot
    target: Array
    ranges: Array
    density: Density
    region: Region
    checked: Checked | None = None

    @property
    def pose(self) -> Array:
        """Joint values to draw the robot at, shape (m,): the first row's, or some where the target is often."""
        if self.checked is not None and len(self.checked.rows):
            return read_only(self.checked.rows.joints_for(self.robot.joint_names)[0])
        low, high = self.ranges.T
        q = low + np.random.default_rng(0).uniform(size=(200, len(low))) * (high - low)
        poses = self.robot.poses(q)
        needed = self.density.share_of(poses[:, :3, :3] @ self.target + poses[:, :3, 3])
        return read_only(q[np.argmin(needed)])


def _counted(
    points: Array, low: Array, high: Array, voxel: float
) -> tuple[Array, NDArray[np.int64]]:
    """The least corner of a grid that lies evenly about the points [m], and how many lie in each of its voxels."""
    if not (np.isfinite(voxel) and voxel > 0.0):
        raise CalibError(f"The voxel is {1e3 * voxel:g} mm; it must be a length greater than 0.")
    # A length that is a multiple of the voxel's, but for rounding, gets no voxel more.
    sides = np.maximum(np.ceil((high - low) / voxel - 1e-6), 1.0)
    if np.prod(sides) > MOST_VOXELS:
        raise CalibError(
            f"Voxels of {1e3 * voxel:g} mm make a grid of {np.prod(sides):.3g}; at most {MOST_VOXELS:,} are made. "
            "Give larger ones."
        )
    origin = read_only(0.5 * (low + high) - 0.5 * voxel * sides)
    shape = tuple(int(n) for n in sides)
    index, _ = voxel_of(points, origin, voxel, shape)
    flat = np.ravel_multi_index(tuple(index.T), shape)
    return origin, np.bincount(flat, minlength=int(np.prod(shape))).reshape(shape)


def _smoothed(counts: NDArray[np.int64]) -> tuple[Array, Array]:
    """Counts averaged over the voxels next to them that hold any, and how many voxels each average stands for."""

    def spread(values: Array, weights: Array) -> Array:
        for axis in range(3):
            values = ndimage.convolve1d(values, weights, axis=axis, mode="constant")
        return values

    reached = (counts > 0).astype(np.float64)
    weight = spread(reached, _WEIGHTS)
    safe = np.maximum(weight, np.finfo(float).tiny)
    mean = reached * spread(counts.astype(np.float64), _WEIGHTS) / safe
    # The variance of a weighted mean is that of a plain one of (sum w)^2 / sum w^2 values.
    return mean, reached * weight**2 / np.maximum(spread(reached, _WEIGHTS**2), 1e-300)


def _rests_on(counts: NDArray[np.int64]) -> float:
    """How many samples the smoothed count of a voxel rests on, in the mean over the voxels with samples."""
    reached = np.count_nonzero(counts)
    return float(_smoothed(counts)[1].sum()) / reached * float(counts.sum()) / reached


def _chosen_voxel(points: Array, low: Array, high: Array) -> float:
    """The smallest round length for which a smoothed count rests on enough samples, see the module's text [m]."""
    longest = float(np.max(high - low))
    if longest < 1e-9:
        return 1e-3
    voxel = _round_up(longest / _FINEST)
    while voxel < longest and _rests_on(_counted(points, low, high, voxel)[1]) < SAMPLES_PER_VOXEL:
        voxel = _round_up(1.01 * voxel)
    return voxel


def _round_up(length: float) -> float:
    """The least round length that is not below another [m]."""
    power = 10.0 ** np.floor(np.log10(length))
    figure = next(step for step in _ROUND if step * power >= length * (1.0 - 1e-9))
    # Written out in decimals, 0.02 is nearer to 20 mm than 2 * 0.01.
    return float(f"{figure * power:.3g}")
