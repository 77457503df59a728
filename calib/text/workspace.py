"""What ``calib workspace`` prints."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.data.measurements import Measurements
from calib.data.ranges import range_text
from calib.design.region import Region
from calib.design.workspace import Density
from calib.robot.robot import Robot, read_only
from calib.text.lines import fill, row_ranges

Array = NDArray[np.float64]

#: Tables with more rows are printed without those that lie well inside.
_MOST_ROWS = 60

#: Measured points this far from where the nominal robot puts them are mostly in another frame [m].
_STRANGE = 0.05

#: With a larger statistical error of a voxel's density a region is not to be relied on.
_UNSURE = 0.12


class Checked(NamedTuple):
    """A table, its points in the base (N, 3), whether they were measured (N,), and where they are predicted."""

    rows: Measurements
    points: Array
    measured: NDArray[np.bool_]
    predicted: Array


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
        checked: A table whose rows are looked at; None for none.
    """

    robot: Robot
    target: Array
    ranges: Array
    density: Density
    region: Region
    reach: float
    seed: int
    checked: Checked | None

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

    @property
    def title(self) -> str:
        """Of the pictures."""
        return f"{self.robot.name}: where the target comes to lie, {100 * self.region.share:.4g} %"

    @property
    def subtitle(self) -> str:
        """Of the pictures."""
        return (
            f"{self.robot.base} to {self.robot.tip}; region {volume_text(self.region.volume)}, voxels of "
            f"{1e3 * self.density.voxel:g} mm, {self.density.samples:,} samples"
        )


def text(found: Found, origin: str, *, every_row: bool) -> str:
    """The whole text; ``origin``: what the ranges are the values of; ``every_row``: a line for each row checked."""
    parts = [_joints_text(found, origin), _region_text(found)]
    if found.checked is not None:
        parts.append(_rows_text(found, found.checked, every_row=every_row))
    return "\n\n".join("\n".join(lines) for lines in parts)


def volume_text(volume: float) -> str:
    """A volume [m^3] in a unit that suits it."""
    for scale, unit, least in ((1.0, "m3", 10.0), (1e3, "litres", 1e-4), (1e6, "cm3", 1e-7)):
        if volume >= least:
            shown = scale * volume
            return f"{shown:,.0f} {unit}" if shown >= 100.0 else f"{shown:.3g} {unit}"
    return f"{1e9 * volume:.3g} mm3"


def _joints_text(found: Found, origin: str) -> Iterator[str]:
    """The robot, its target and the ranges of its joints."""
    robot = found.robot
    at = " ".join(f"{1e3 * value:.6g}" for value in found.target)
    target = f"the target at {at} mm in it" if found.target.any() else "the target at its origin"
    said = f"Robot '{robot.name}', base '{robot.base}', tip '{robot.tip}', {target}."
    yield fill(said, hang="  ") + "\n"
    yield f"  {'joint':<32}takes all values from"
    for name, ends in zip(robot.joint_names, found.ranges, strict=True):
        values = range_text(robot, name, ends)
        yield f"  {name:<32}{values}" if len(name) < 32 else f"  {name}\n  {'':<32}{values}"
    if origin:
        yield fill(f"These are the values of {origin}.", "  ")


def _region_text(found: Found) -> Iterator[str]:
    """Extent, region, voxels."""
    density, region = found.density, found.region
    yield fill(
        f"Of all places of the target {100 * region.held:.4g} % lie in this region, the smallest one that holds so "
        f"many; in the frame of '{found.robot.base}':",
        hang="  ",
    )
    cut = f" in the box, of {density.drawn:,}" if density.drawn > density.samples else ""
    voxels, reached = np.count_nonzero(region.cells), np.count_nonzero(density.counts)
    for label, value in (
        ("samples", f"{density.samples:,}{cut} (seed {found.seed})"),
        ("workspace", _extent_text(density.extent)),
        ("reach", f"{1e3 * found.reach:.0f} mm from the base's origin"),
        ("region", _extent_text(region.bounds)),
        (
            "",
            f"{volume_text(region.volume)}: {voxels:,} of the {reached:,} voxels that the target reaches",
        ),
        (
            "voxel",
            f"{1e3 * density.voxel:g} mm; how often the target is in one is known to about "
            f"{100 * density.error:.1g} %",
        ),
    ):
        yield f"  {label:<12}{value}"
    if len(found.robot.joint_names) < 3:
        yield fill(
            "With fewer than three joints the target moves on a line or a surface; the volume is that of the voxels "
            "along it.",
            hang="  ",
        )
    if density.error > _UNSURE:
        larger = ", or a larger --voxel" if density.samples == density.drawn else ""
        yield fill(
            "The voxels hold so few samples that other samples (--seed) would make another region. Give more "
            f"--samples{larger}.",
            hang="  ",
        )


def _rows_text(found: Found, checked: Checked, *, every_row: bool) -> Iterator[str]:
    """Which rows lie inside."""
    rows, points, measured, predicted = checked
    inside, depth = found.region.contains(points), found.region.depth(points)
    how = "as measured" if measured.all() else "where the nominal robot puts them"
    if measured.any() and not measured.all():
        how = "as measured, or else where the nominal robot puts them"
    yield f"Targets of {rows.source}, {how}:"
    if every_row:
        yield from _row_lines(found, checked, inside, depth)
    for word, chosen in (("estimation", rows.estimation), ("validation", rows.validation)):
        outside = _numbers(rows, chosen & ~inside)
        if chosen.any():
            many = f"{np.count_nonzero(chosen & inside)} of {np.count_nonzero(chosen)} {word} rows"
            yield fill(
                f"{many} lie in the region" + (f"; outside: {outside}." if outside else "."), "  "
            )
    near = _numbers(rows, np.abs(depth) < 0.5 * found.region.voxel)
    if near:
        yield fill(
            f"The border is known to about half a voxel: rows {near} lie so near that other samples may put them on "
            "its other side.",
            "  ",
        )
    off = np.linalg.norm(points - predicted, axis=1)[measured]
    if len(off) and np.median(off) > _STRANGE:
        yield fill(
            f"Note: the measured points lie {1e3 * np.median(off):.0f} mm from where the nominal robot puts the "
            "target. If they are not in the base frame, give --frame estimate; if the target is not where it is "
            "said to be, give --target.",
            "  ",
        )


def _row_lines(
    found: Found, checked: Checked, inside: NDArray[np.bool_], depth: Array
) -> Iterator[str]:
    """A line for each row of the checked table; in a long one without those well inside."""
    rows, points = checked.rows, checked.points
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


def _numbers(rows: Measurements, chosen: NDArray[np.bool_]) -> str:
    """The numbers of some rows, runs of them as one."""
    return row_ranges(rows.rows[i] for i in np.flatnonzero(chosen))


def _extent_text(ends: Array) -> str:
    """A box in mm."""
    mm = np.round(1e3 * ends) + 0.0
    return ", ".join(f"{a} {mm[0, k]:.0f} to {mm[1, k]:.0f}" for k, a in enumerate("xyz")) + " mm"
