"""Where a target comes to lie, how often, and the region that holds most of it (the paper, section 4.3).

Joint values are drawn evenly between their ends, by a scrambled Sobol sequence, and the target's positions counted in
the voxels of a grid. The count n of a voxel of edge h, among N samples, is the density

    f = n / (N h^3)

smoothed over the voxels next to it, by (1, 2, 1) / 4 along each axis and among reached voxels alone, so that nothing
leaks out of the workspace and a flat one stays flat. The region of a share is made of the fewest voxels that hold it:
those of the highest density first.

Small voxels show more and hold fewer samples. Without being told otherwise, the voxel is the smallest round length for
which a smoothed count rests on `SAMPLES_PER_VOXEL` samples in the mean, a statistical error of 6 % (10 % at the border
of 95 %). With plain counts and half as large voxels, the region would hold a few per cent less of the next samples
than of those that it was made from, and other samples would make another region.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from calib.data.ranges import joint_ranges
from calib.data.surroundings import vector
from calib.design.region import Region, checked_box, checked_points, no_box, voxel_of
from calib.errors import CalibError
from calib.robot.robot import Robot, read_only

Array = NDArray[np.float64]

#: Samples that are drawn if nothing else is said.
COUNT = 2**17

#: How many samples the smoothed count of a voxel rests on in the mean, where the voxel's size is chosen here.
SAMPLES_PER_VOXEL = 300.0

#: The most voxels of a grid, and the most along an axis where the size is chosen here.
MOST_VOXELS, _FINEST = 4_000_000, 128

#: Samples that are computed at once.
_CHUNK = 2**15

#: Weights of a voxel and its two neighbours along an axis.
_WEIGHTS = np.array([0.25, 0.5, 0.25])

#: First figures of round lengths.
_ROUND = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)

#: A workspace that is not longer than this is one point [m].
_POINT = 1e-9


def sample_workspace(
    robot: Robot,
    target: ArrayLike = (0.0, 0.0, 0.0),
    ranges: ArrayLike | None = None,
    count: int = COUNT,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Array:
    """Where a target comes to lie when the joints take all their values equally often.

    Args:
        robot: The robot.
        target: shape (3,), the target in the tip [m].
        ranges: shape (m, 2), lowest and highest value of each joint [rad] or [m]; None: those of `joint_ranges`.
        count: How many samples; a power of two is spread the most evenly.
        seed: Of the scrambling: the same seed gives the same points.
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
    """How often samples come to lie in each voxel of a grid in the base frame.

    Attributes:
        origin: shape (3,), the grid's least corner [m].
        voxel: Edge of a voxel [m].
        counts: shape (nx, ny, nz), samples in each voxel. Read-only.
        smooth: shape (nx, ny, nz), the same smoothed over neighbours, 0 where there is no sample. Read-only.
        box: shape (2, 3), the box that samples were taken from [m]; infinite where there is none.
        drawn: Number of samples before those outside of the box were left out.
    """

    origin: Array
    voxel: float
    counts: NDArray[np.int64]
    smooth: Array
    box: Array
    drawn: int

    @classmethod
    def of(
        cls, points: ArrayLike, voxel: float | None = None, box: ArrayLike | None = None
    ) -> Density:
        """Count points in voxels.

        Args:
            points: shape (N, 3), in the base frame [m].
            voxel: Edge of a voxel [m]; None: chosen, see the module's text.
            box: shape (2, 3), least and greatest corner [m]: points outside are left out.

        Raises:
            CalibError: No points, or none in the box; or a voxel that is not greater than zero or so small that
                the grid would have more than `MOST_VOXELS`.
        """
        every = checked_points(points)
        corners = no_box() if box is None else checked_box(box)
        inside = every[np.all((every >= corners[0]) & (every <= corners[1]), axis=1)]
        if not len(every):
            raise CalibError("No points were given to count; give one at least.")
        if not len(inside):
            low, high = np.min(every, axis=0), np.max(every, axis=0)
            a, b, c, d = (
                " ".join(f"{1e3 * v:.4g}" for v in corner) for corner in (*corners, low, high)
            )
            raise CalibError(
                f"The region is empty: none of {len(every):,} samples lies in the box from {a} to {b} mm. They lie "
                f"between {c} and {d} mm in the base frame; give a box there, or wider ranges of the joints."
            )
        low, high = inside.min(axis=0), inside.max(axis=0)
        edge = _chosen_voxel(inside, low, high) if voxel is None else float(voxel)
        origin, shape = _grid(low, high, edge)
        counts = _counted(inside, origin, edge, shape)
        counts.setflags(write=False)
        return cls(origin, edge, counts, read_only(_smoothed(counts)[0]), corners, len(every))

    @property
    def samples(self) -> int:
        """How many points were counted."""
        return int(self.counts.sum())

    @property
    def extent(self) -> Array:
        """Least and greatest corner of the voxels that hold samples, shape (2, 3), [m]."""
        index = np.argwhere(self.counts)
        ends = np.array([index.min(axis=0), index.max(axis=0) + 1])
        return read_only(self.origin + self.voxel * ends)

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
        cells = np.zeros(self.counts.size, dtype=np.bool_)
        cells[order[: last + 1]] = True
        return Region(
            origin=self.origin,
            voxel=self.voxel,
            cells=cells.reshape(self.counts.shape),
            share=float(share),
            held=float(held[last]),
            box=self.box,
        )

    def share_of(self, points: ArrayLike) -> Array:
        """The smallest share whose region holds each of the points, shape (N, 3), in the base frame [m].

        shape (N,): near 0 where the target is most often, 1 at the rim of the workspace, infinite where no sample came.
        """
        values = checked_points(points)
        order, held = self._by_density()
        needed = np.full(self.counts.size, np.inf)
        needed[order] = held
        index, known = voxel_of(values, self.origin, self.voxel, self.counts.shape)
        inside = known & np.all((values >= self.box[0]) & (values <= self.box[1]), axis=1)
        found = needed.reshape(self.counts.shape)[tuple(index.T)]
        return read_only(np.where(inside, found, np.inf))

    def _by_density(self) -> tuple[NDArray[np.intp], Array]:
        """The voxels with samples, densest first, and the share that those up to each hold."""
        order = np.argsort(-self.smooth.ravel(), kind="stable")[: np.count_nonzero(self.counts)]
        held = np.cumsum(self.counts.ravel()[order]) / self.samples
        return order, held


def _grid(low: Array, high: Array, voxel: float) -> tuple[Array, tuple[int, ...]]:
    """Least corner and shape of the grid of voxels that lies evenly about a box, [m]."""
    if not (np.isfinite(voxel) and voxel > 0.0):
        raise CalibError(f"The voxel is {1e3 * voxel:g} mm; it must be a length greater than 0.")
    # A length that is a multiple of the voxel's, but for rounding, gets no voxel more.
    sides = np.maximum(np.ceil((high - low) / voxel - 1e-6), 1.0)
    if np.prod(sides) > MOST_VOXELS:
        many = float(np.prod(sides)) / MOST_VOXELS
        least = voxel * many ** (1.0 / max(1, int(np.sum(sides > 1))))
        size = " x ".join(f"{v:.4g}" for v in 1e3 * (high - low))
        raise CalibError(
            f"Voxels of {1e3 * voxel:g} mm make a grid of {np.prod(sides):.3g} in a workspace of {size} mm; at most "
            f"{MOST_VOXELS:,} are made. Give voxels of {1e3 * _round_up(least):g} mm or more."
        )
    shape = tuple(int(n) for n in sides)
    return read_only(0.5 * (low + high) - 0.5 * voxel * sides), shape


def _counted(
    points: Array, origin: Array, voxel: float, shape: tuple[int, ...]
) -> NDArray[np.int64]:
    """How many points lie in each voxel; all of them lie in the grid."""
    index, _ = voxel_of(points, origin, voxel, shape)
    flat = np.ravel_multi_index(tuple(index.T), shape)
    return np.bincount(flat, minlength=int(np.prod(shape))).reshape(shape)


def _smoothed(counts: NDArray[np.int64]) -> tuple[Array, Array]:
    """Counts averaged over the voxels next to them that hold any, and how many voxels each average stands for."""
    reached = (counts > 0).astype(np.float64)
    weight = _spread(reached, _WEIGHTS)
    safe = np.maximum(weight, np.finfo(float).tiny)
    mean = reached * _spread(counts.astype(np.float64), _WEIGHTS) / safe
    # The variance of a weighted mean is that of a plain one of (sum w)^2 / sum w^2 values.
    stands_for = reached * weight**2 / np.maximum(_spread(reached, _WEIGHTS**2), 1e-300)
    return mean, stands_for


def _spread(values: Array, weights: Array) -> Array:
    """Weighted sums of each voxel and its neighbours, shape (nx, ny, nz)."""
    for axis in range(3):
        values = ndimage.convolve1d(values, weights, axis=axis, mode="constant")
    return values


def _rests_on(counts: NDArray[np.int64]) -> float:
    """How many samples the smoothed count of a voxel rests on, in the mean over the voxels with samples."""
    reached = np.count_nonzero(counts)
    stands_for = float(_smoothed(counts)[1].sum()) / reached
    return stands_for * float(counts.sum()) / reached


def _chosen_voxel(points: Array, low: Array, high: Array) -> float:
    """The smallest round length for which a smoothed count rests on enough samples, see the module's text [m]."""
    longest = float(np.max(high - low))
    if longest < _POINT:
        return 1e-3
    voxel = _round_up(longest / _FINEST)
    while voxel < longest:
        origin, shape = _grid(low, high, voxel)
        if _rests_on(_counted(points, origin, voxel, shape)) >= SAMPLES_PER_VOXEL:
            return voxel
        voxel = _round_up(1.01 * voxel)
    return voxel


def _round_up(length: float) -> float:
    """The least round length that is not below another [m]."""
    power = 10.0 ** np.floor(np.log10(length))
    figures = [step for step in (*_ROUND, 10.0) if step * power >= length * (1.0 - 1e-9)]
    # Written out in decimals, 0.02 is nearer to 20 mm than 2 * 0.01.
    return float(f"{figures[0] * power:.3g}")
