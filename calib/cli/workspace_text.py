"""What ``calib workspace`` prints."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.design.region import Region
from calib.design.workspace import Density
from calib.measure.measurements import Measurements
from calib.measure.ranges import range_text
from calib.model.robot import Robot, read_only

Array = NDArray[np.float64]

#: Tables with more rows are printed without those that lie well inside.
_MOST_ROWS = 60

#: Measured points this far from where the nominal robot puts them are mostly in another frame [m].
_STRANGE = 0.05


#: With a larger statistical error of a voxel's density a region is not to be relied on.
_UNSURE = 0.12


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What a call found.

    Attributes:
        robot: The robot.
        target: shape (3,), in the tip [m].
        ranges: shape (m, 2), of the joints [rad] or [m].
        density: The density.
        region: Its region.
        reach: The largest distance of a sample from the base's origin [m].
        seed: Of the samples.
        like: The table that the ranges are from.
        margin: What was added to these, in words that follow on the table's name.
        checked: A table, its points in the base (N, 3), whether they were measured (N,), and where the nominal robot
            puts them (N, 3), [m].
    """

    robot: Robot
    target: Array
    ranges: Array
    density: Density
    region: Region
    reach: float
    seed: int
    like: Measurements | None
    margin: str
    checked: tuple[Measurements, Array, NDArray[np.bool_], Array] | None

    @property
    def pose(self) -> Array:
        """Joint values to draw the robot at, shape (m,): the first row's, or some where the target is often."""
        if self.checked is not None and len(self.checked[0]):
            return read_only(self.checked[0].joints_for(self.robot.joint_names)[0])
        low, high = self.ranges.T
        q = low + np.random.default_rng(0).uniform(size=(200, len(low))) * (high - low)
        poses = self.robot.poses(q)
        needed = self.density.share_of(poses[:, :3, :3] @ self.target + poses[:, :3, 3])
        return read_only(q[np.argmin(needed)])


def text(found: Found, *, every_row: bool) -> str:
    """The whole text; ``every_row``: each row of the checked table has a line."""
    parts = [_joints_text(found), _region_text(found)]
    if found.checked is not None:
        parts.append("\n".join(_rows_text(found, every_row=every_row)))
    return "\n\n".join(parts)


def picture_words(found: Found) -> tuple[str, str]:
    """Title and subtitle of the pictures."""
    region, density = found.region, found.density
    title = f"{found.robot.name}: where the target comes to lie, {100 * region.share:.4g} %"
    subtitle = (
        f"{found.robot.base} to {found.robot.tip}; region {volume_text(region.volume)}, voxels of "
        f"{1e3 * density.voxel:g} mm, {density.samples:,} samples"
    )
    return title, subtitle


def volume_text(volume: float) -> str:
    """A volume [m^3] in a unit that suits it."""
    for scale, unit, least in ((1.0, "m3", 10.0), (1e3, "litres", 1e-4), (1e6, "cm3", 1e-7)):
        if volume >= least:
            shown = scale * volume
            return f"{shown:,.0f} {unit}" if shown >= 100.0 else f"{shown:.3g} {unit}"
    return f"{1e9 * volume:.3g} mm3"


def _joints_text(found: Found) -> str:
    """The robot, its target and the ranges of its joints."""
    robot = found.robot
    at = " ".join(f"{1e3 * value:.6g}" for value in found.target)
    target = f"the target at {at} mm in it" if found.target.any() else "the target at its origin"
    lines = [_wrap(f"Robot '{robot.name}', base '{robot.base}', tip '{robot.tip}', {target}."), ""]
    lines.append(f"  {'joint':<32}takes all values from")
    for name, ends in zip(robot.joint_names, found.ranges, strict=True):
        lines.append(
            f"  {name:<32}{range_text(robot, name, ends)}" if len(name) < 32 else f"  {name}"
        )
        if len(name) >= 32:
            lines.append(f"  {'':<32}{range_text(robot, name, ends)}")
    if found.like is not None:
        rows = f"the {int(found.like.estimation.sum())} estimation rows of {found.like.source}"
        lines.append(_wrap(f"These are the values of {rows}{found.margin}.", "  "))
    return "\n".join(lines)


def _region_text(found: Found) -> str:
    """Extent, region, voxels."""
    density, region = found.density, found.region
    voxels = np.count_nonzero(region.cells)
    reached = np.count_nonzero(density.counts)
    lines = [
        f"  {'samples':<12}{density.samples:,}"
        + (f" in the box, of {density.drawn:,}" if density.drawn > density.samples else "")
        + f" (seed {found.seed})",
        f"  {'workspace':<12}{_extent_text(density.extent)}",
        f"  {'reach':<12}{1e3 * found.reach:.0f} mm from the base's origin",
        f"  {'region':<12}{_extent_text(region.bounds)}",
        f"  {'':<12}{volume_text(region.volume)}: {voxels:,} of the {reached:,} voxels that the target reaches",
        f"  {'voxel':<12}{1e3 * density.voxel:g} mm; how often the target is in one is known to about "
        f"{100 * density.error:.1g} %",
    ]
    head = (
        f"Of all places of the target {100 * region.held:.4g} % lie in this region, the smallest one that holds so "
        f"many; in the frame of '{found.robot.base}':"
    )
    said = [_wrap(head), *lines]
    if len(found.robot.joint_names) < 3:
        said.append(
            _wrap(
                "With fewer than three joints the target moves on a line or a surface; the volume is that of the "
                "voxels along it."
            )
        )
    if density.error > _UNSURE:
        said.append(
            _wrap(
                "The voxels hold so few samples that other samples (--seed) would make another region, and less of "
                "them would lie in this one. Give more --samples"
                + (", or a larger --voxel." if density.samples == density.drawn else ".")
            )
        )
    return "\n".join(said)


def _rows_text(found: Found, *, every_row: bool) -> Iterator[str]:
    """Which rows lie inside."""
    if found.checked is None:
        return
    rows, points, measured, predicted = found.checked
    inside, depth = found.region.contains(points), found.region.depth(points)
    how = "as measured" if measured.all() else "where the nominal robot puts them"
    if measured.any() and not measured.all():
        how = "as measured, or else where the nominal robot puts them"
    yield f"Targets of {rows.source}, {how}:"
    if every_row:
        yield from _row_lines(found, inside, depth)
    for word, chosen in (("estimation", rows.estimation), ("validation", rows.validation)):
        if chosen.any():
            yield _wrap(_count_text(word, rows, chosen, inside), "  ")
    near = np.abs(depth) < 0.5 * found.region.voxel
    if near.any():
        yield _wrap(
            f"The border is known to about half a voxel: rows {_numbers(rows, near)} lie so near that other samples "
            "may put them on its other side.",
            "  ",
        )
    off = np.linalg.norm(points - predicted, axis=1)[measured]
    if len(off) and np.median(off) > _STRANGE:
        yield _wrap(
            f"Note: the measured points lie {1e3 * np.median(off):.0f} mm from where the nominal robot puts the "
            "target. If they are not in the base frame, give --frame estimate; if the target is not where it is "
            "said to be, give --target.",
            "  ",
        )


def _row_lines(found: Found, inside: NDArray[np.bool_], depth: Array) -> Iterator[str]:
    """A line for each row of the checked table; in a long one without those well inside."""
    if found.checked is None:
        return
    rows, points, *_ = found.checked
    needed = found.density.share_of(points)
    shown = np.ones(len(rows), dtype=bool)
    if len(rows) > _MOST_ROWS:
        shown = ~inside | (depth < found.region.voxel)
    if shown.any():
        yield (
            f"  {'row':>6}  {'set':<10}{'x':>9}{'y':>9}{'z [mm]':>9}   {'region':<9}{'border [mm]':>11}"
            f"{'within densest':>18}"
        )
    for i in np.flatnonzero(shown):
        x, y, z = (f"{1e3 * value:9.1f}" for value in points[i])
        word = "inside" if inside[i] else "OUTSIDE"
        often = f"{100 * needed[i]:.1f} %" if np.isfinite(needed[i]) else "not reached"
        yield (
            f"  {rows.rows[i]:>6}  {rows.sets[i]:<10}{x}{y}{z}   {word:<9}{1e3 * abs(depth[i]):>11.0f}{often:>18}"
        )
    if not shown.all():
        yield f"  {np.count_nonzero(~shown)} more rows lie inside by a voxel or more."


def _count_text(
    word: str, rows: Measurements, chosen: NDArray[np.bool_], inside: NDArray[np.bool_]
) -> str:
    """How many rows of a set lie inside, and which do not."""
    said = f"{np.count_nonzero(chosen & inside)} of {np.count_nonzero(chosen)} {word} rows lie in the region"
    outside = chosen & ~inside
    return f"{said}; outside: {_numbers(rows, outside)}." if outside.any() else f"{said}."


def _numbers(rows: Measurements, chosen: NDArray[np.bool_]) -> str:
    """The numbers of some rows, not too many."""
    numbers = [str(rows.rows[i]) for i in np.flatnonzero(chosen)]
    return ", ".join(numbers[:20]) + (f" and {len(numbers) - 20} more" if len(numbers) > 20 else "")


def _extent_text(ends: Array) -> str:
    """A box in mm."""
    parts = [
        f"{axis} {1e3 * low + 0.0:.0f} to {1e3 * high + 0.0:.0f}"
        for axis, low, high in zip("xyz", ends[0], ends[1], strict=True)
    ]
    return ", ".join(parts) + " mm"


def _wrap(said: str, indent: str = "") -> str:
    """Text broken at 100 columns."""
    return textwrap.fill(
        said,
        100,
        initial_indent=indent,
        subsequent_indent=indent or "  ",
        break_on_hyphens=False,
        break_long_words=False,
    )
