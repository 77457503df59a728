"""Where a target lies, how often, and the region that holds most of it (the paper, section 4.3).

Joint values are drawn evenly by a scrambled Sobol sequence, and the target's positions counted in the voxels of a grid.
The count n of a voxel of edge h, among N samples, is the density f = n / (N h^3), smoothed over neighbours by
(1, 2, 1) / 4 along each axis and among reached voxels alone, so that nothing leaks out of the workspace. The region of
a share is made of the fewest voxels that hold it: those of the highest density first.

Unless it is given, the voxel is the smallest round length for which a smoothed count rests on `SAMPLES_PER_VOXEL`
samples in the mean, a statistical error of 6 % (10 % at the border of 95 %).

A region's file is JSON in SI units, see docs/workspace.md. It names robot, base, tip and target: in another base frame
the same numbers are another place.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from calib.data.cell import Cell
from calib.data.columns import POINT, name_columns
from calib.data.measurements import Measurements
from calib.data.table import Table
from calib.errors import CalibError, FileError
from calib.files import damage, json_bytes, read_json, write_atomically
from calib.numerics.geometry import vector
from calib.robot.ranges import joint_ranges
from calib.robot.robot import Robot, read_only, rigid_inverse
from calib.units import Array, Mask
from calib.version import __version__

SCHEMA = "region 1"

#: Samples by default, and samples that the smoothed count of a voxel rests on in the mean where its size is chosen.
COUNT, SAMPLES_PER_VOXEL = 2**17, 300.0

#: The most voxels of a grid, and the most along an axis where the size is chosen here.
MOST_VOXELS, _FINEST = 4_000_000, 128

#: Samples that are computed at once.
_CHUNK = 2**15

#: Weights of a voxel and its two neighbours along an axis.
_WEIGHTS = np.array([0.25, 0.5, 0.25])

#: Round lengths in rising order [m].
_ROUND = [float(f"{n}e{k}") for k in range(-9, 6) for n in (1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8)]


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
    low, high = (joint_ranges(robot) if ranges is None else np.asarray(ranges)).T
    sequence = qmc.Sobol(len(low), scramble=True, seed=np.random.default_rng(seed))
    points = np.empty((count, 3))
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
class Region:
    """The part of space that a robot is measured in: voxels of a grid in the base frame."""

    origin: Array  #: shape (3,), the grid's least corner [m].
    voxel: float  #: Edge of a voxel [m].
    cells: Mask  #: shape (nx, ny, nz), whether a voxel belongs to the region.
    share: float  #: The share of the probability that was asked for.
    held: float  #: The share of the samples that the voxels hold: not less than ``share``.

    @property
    def volume(self) -> float:
        """Of all voxels [m^3]."""
        return float(np.count_nonzero(self.cells) * self.voxel**3)

    @property
    def bounds(self) -> Array:
        """Least and greatest corner of the box about the region, shape (2, 3), [m]."""
        index = np.argwhere(self.cells)
        return self.origin + self.voxel * np.array([index.min(axis=0), index.max(axis=0) + 1])

    def contains(self, points: ArrayLike) -> Mask:
        """Whether points of shape (N, 3), in the base frame [m], lie in the region, shape (N,)."""
        index, known = _voxel_of(np.asarray(points), self.origin, self.voxel, self.cells.shape)
        found: Mask = known & self.cells[tuple(index.T)]
        return found


def _voxel_of(
    points: Array, origin: Array, voxel: float, shape: tuple[int, ...]
) -> tuple[NDArray[np.intp], Mask]:
    """The voxel of each point, (N, 3), outside the nearest one; and whether the grid, with its faces, has it, (N,)."""
    at, last = (points - origin) / voxel, np.array(shape)
    # Rounding must not put a point that made the grid outside of it.
    known: Mask = np.all((at >= -1e-9) & (at <= last + 1e-9), axis=1)
    return np.floor(np.clip(at, 0.0, last - 0.5)).astype(np.intp), known


@dataclass(frozen=True, slots=True, eq=False)
class Density:
    """How often samples lie in each voxel of a grid in the base frame."""

    origin: Array  #: shape (3,), the grid's least corner [m].
    voxel: float  #: Edge of a voxel [m].
    counts: NDArray[np.int64]  #: shape (nx, ny, nz), samples in each voxel.
    smooth: Array  #: The same, smoothed over neighbours, 0 where there is no sample.
    needed: Array  #: shape (nx, ny, nz), the smallest share whose region has a voxel, infinite likewise.

    @classmethod
    def of(cls, points: ArrayLike, voxel: float | None = None) -> Density:
        """Count points of shape (N, 3), in the base frame [m]; None: a voxel of a size that suits them."""
        values = np.asarray(points, dtype=np.float64)
        edge = _chosen_voxel(values) if voxel is None else float(voxel)
        origin, counts = _counted(values, edge)
        smooth, needed = _smoothed(counts)[0], np.full(counts.size, np.inf)
        order = np.argsort(-smooth.ravel(), kind="stable")[: np.count_nonzero(counts)]
        needed[order] = np.cumsum(counts.ravel()[order]) / len(values)
        return cls(origin, edge, counts, smooth, needed.reshape(counts.shape))

    @property
    def samples(self) -> int:
        """How many points were counted."""
        return int(self.counts.sum())

    @property
    def extent(self) -> Array:
        """Least and greatest corner of the voxels that hold samples, shape (2, 3), [m]."""
        return Region(self.origin, self.voxel, self.counts > 0, 1.0, 1.0).bounds

    def region(self, share: float = 0.95) -> Region:
        """The fewest voxels that hold a share of the samples: those of the highest density first."""
        if not 0.0 < share <= 1.0:
            raise CalibError(
                f"The share is {share:g}; it must be greater than 0 and at most 1, such as 0.95."
            )
        # Sums of counts are exact, so that 0.95 of 100 samples is 95 of them.
        held = float(self.needed[self.needed >= share * (1.0 - 1e-12)].min())
        return Region(self.origin, self.voxel, self.needed <= held, float(share), held)

    def share_of(self, points: ArrayLike) -> Array:
        """The smallest share whose region holds each of the points, shape (N, 3), in the base frame [m].

        shape (N,): near 0 where the target is most often, 1 at the rim of the workspace, infinite where no sample came.
        """
        index, known = _voxel_of(np.asarray(points), self.origin, self.voxel, self.counts.shape)
        return np.where(known, self.needed[tuple(index.T)], np.inf)


class Checked(NamedTuple):
    """A table, its points in the base (N, 3), and whether they were measured (N,)."""

    rows: Measurements
    points: Array
    measured: Mask


@dataclass(frozen=True, slots=True, eq=False)
class RegionView:
    """A region of a robot's workspace as it is printed and drawn."""

    robot: Robot
    target: Array  #: shape (3,), in the tip [m].
    ranges: Array  #: shape (m, 2), of the joints [rad] or [m].
    density: Density
    region: Region
    checked: Checked | None = None  #: A table whose rows are compared with the region.


def _counted(points: Array, voxel: float) -> tuple[Array, NDArray[np.int64]]:
    """The least corner of a grid that lies evenly about the points [m], and how many lie in each of its voxels."""
    low, high = points.min(axis=0), points.max(axis=0)
    # A length that is a multiple of the voxel's, but for rounding, gets no voxel more.
    sides = np.ceil((high - low) / voxel - 1e-6).clip(1.0) if voxel > 0.0 else np.full(3, np.inf)
    if np.prod(sides) > MOST_VOXELS:
        raise CalibError(
            f"Voxels of {1e3 * voxel:g} mm make a grid of {np.prod(sides):.3g}; at most {MOST_VOXELS:,} are made. "
            "Give larger ones."
        )
    origin = 0.5 * (low + high) - 0.5 * voxel * sides
    shape = tuple(int(n) for n in sides)
    flat = np.ravel_multi_index(tuple(_voxel_of(points, origin, voxel, shape)[0].T), shape)
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


def _chosen_voxel(points: Array) -> float:
    """The smallest round length for which a smoothed count rests on enough samples, see the module's text [m]."""
    longest = float(np.ptp(points, axis=0).max())
    if longest < 1e-9:
        return 1e-3
    finest = longest / _FINEST * (1.0 - 1e-9)
    for voxel in (one for one in _ROUND if finest <= one < longest):
        counts = _counted(points, voxel)[1]
        reached = np.count_nonzero(counts)
        # The mean over the voxels that hold samples.
        rests_on = float(_smoothed(counts)[1].sum()) / reached * len(points) / reached
        if rests_on >= SAMPLES_PER_VOXEL:
            return voxel
    return next(one for one in _ROUND if one >= longest)


def write_region(view: RegionView, path: str | Path, seed: int, *, overwrite: bool = False) -> Path:
    """Write a region and what it was made from as JSON; ``seed`` is that of the samples."""
    robot, region, flat = view.robot, view.region, view.region.cells.ravel()
    units = ["m" if joint.type == "prismatic" else "rad" for joint in robot.inputs]
    joints = [
        {"name": name, f"low_{unit}": low, f"high_{unit}": high}
        for name, unit, (low, high) in zip(robot.joint_names, units, view.ranges, strict=True)
    ]
    runs = np.diff([0, *np.flatnonzero(np.diff(flat)) + 1, flat.size]).tolist()
    table = {
        "schema": SCHEMA,
        "calib": __version__,
        "robot": {"name": robot.name, "base": robot.base, "tip": robot.tip, "joints": joints},
        "target_xyz_m": view.target,
        "samples": view.density.samples,
        "seed": seed,
        "share": region.share,
        "held": region.held,
        "volume_m3": region.volume,
        "voxel_m": region.voxel,
        "origin_m": region.origin,
        "shape": region.cells.shape,
        # Voxels in the order of the last index first, as lengths of runs: outside, inside, outside, ...
        "runs": [0, *runs] if flat[0] else runs,
    }
    return write_atomically(path, json_bytes(table), overwrite=overwrite)


def read_region(
    path: str | Path, robot: Robot | None = None, target: Array | None = None
) -> Region:
    """Read a region's file; one of another base, tip or joints, or a target more than a voxel away, is refused."""
    expected = (
        f"a region of calib {__version__} has '{SCHEMA}'. Make it again with 'calib workspace -o'."
    )
    table = read_json(path, "region", SCHEMA, expected)
    try:
        runs = np.asarray(table["runs"], dtype=np.int64)
        cells = np.repeat(np.arange(len(runs)) % 2 == 1, runs).reshape(table["shape"])
        voxel, share, held = (float(table[key]) for key in ("voxel_m", "share", "held"))
        region = Region(read_only(table["origin_m"]).reshape(3), voxel, cells, share, held)
        own, point = table["robot"], read_only(table["target_xyz_m"]).reshape(3)
        made = own["base"], own["tip"], [joint["name"] for joint in own["joints"]]
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise FileError(
            f"{path}: the region is damaged: {damage(error)}. Write it again with 'calib workspace -o'."
        ) from error
    here = made if robot is None else (robot.base, robot.tip, list(robot.joint_names))
    if here != made or (target is not None and np.linalg.norm(target - point) > voxel):
        at = ", ".join(f"{1e3 * value:.6g}" for value in point)
        raise CalibError(
            f"{path}: the region was made for the base {made[0]}, the tip {made[1]}, the joints {', '.join(made[2])} "
            f"and a target at {at} mm: give the same --base, --tip, --hold and --target, or make the region again with "
            "'calib workspace'."
        )
    return region


def read_rows(
    path: str | Path,
    robot: Robot,
    columns: Mapping[str, str] | None = None,
    kind: str | None = None,
) -> Measurements:
    """A table whose positions may be missing: a list of poses, or a plan that is not filled in."""
    table = Table.read(path)
    named, _ = name_columns(table, (), columns or {})
    cells = [table.column(named[name]) for name in POINT if name in named]
    if kind is None and not (len(cells) == len(POINT) and any(map(any, cells))):
        kind = "fixed"  # a row of this kind measures nothing but its joint values
    return Measurements.read(
        table, robot.joint_names, robot.joint_types, columns=columns, kind=kind
    )


def row_points(robot: Robot, rows: Measurements, cell: Cell, target: Array) -> tuple[Array, Mask]:
    """Where the target was, shape (N, 3), in the base frame [m], and whether that was measured, shape (N,).

    Else it is where the nominal robot puts it.
    """
    T_base_tip = robot.poses(rows.joints_for(robot.joint_names))
    at = np.array([cell.targets.get(name, target) for name in rows.targets]).reshape(-1, 3)
    points = np.einsum("nij,nj->ni", T_base_tip[:, :3, :3], at) + T_base_tip[:, :3, 3]
    measured = rows.positions.copy()
    for i in np.flatnonzero(measured):
        T_frame_base = cell.frames.get(rows.groups[i], cell.T_frame_base)
        if T_frame_base is None and cell.estimate_frame:
            measured[i] = False
            continue
        T_base_frame = np.eye(4) if T_frame_base is None else rigid_inverse(T_frame_base)
        points[i] = T_base_frame[:3, :3] @ rows.points[i] + T_base_frame[:3, 3]
    return points, measured
