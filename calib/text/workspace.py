"""What ``calib workspace`` prints."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from calib.design.workspace import Checked, RegionView
from calib.robot.readback import range_text
from calib.text.lines import fill, row_ranges

Array = NDArray[np.float64]


def text(view: RegionView, origin: str, seed: int, reach: float, *, every_row: bool) -> str:
    """The whole text.

    Args:
        view: What was found.
        origin: What the ranges are taken from; empty for the limits.
        seed: Of the samples.
        reach: Largest distance of the target from the base's origin [m].
        every_row: Whether each row of the table has a line.
    """
    parts = [_joints_text(view, origin), _region_text(view, seed, reach)]
    if view.checked is not None:
        parts.append(_rows_text(view, view.checked, every_row=every_row))
    return "\n\n".join("\n".join(lines) for lines in parts)


def _joints_text(view: RegionView, origin: str) -> Iterator[str]:
    """The robot, its target and the ranges of its joints."""
    robot = view.robot
    at = " ".join(f"{1e3 * value:.6g}" for value in view.target)
    yield fill(
        f"Robot '{robot.name}', base '{robot.base}', tip '{robot.tip}', target at {at} mm in the tip.",
        hang="  ",
    )
    yield f"\n  {'joint':<32}range"
    for name, ends in zip(robot.joint_names, view.ranges, strict=True):
        yield f"  {name:<31} {range_text(robot, name, ends)}"
    if origin:
        yield fill(f"Ranges of {origin}.", "  ")


def _region_text(view: RegionView, seed: int, reach: float) -> Iterator[str]:
    """Extent, region, voxels."""
    density, region = view.density, view.region
    voxels, reached = np.count_nonzero(region.cells), np.count_nonzero(density.counts)
    yield fill(
        f"The smallest region that holds {100 * region.held:.4g} % of the target's positions, in the frame of "
        f"'{view.robot.base}':",
        hang="  ",
    )
    for label, value in (
        ("samples", f"{density.samples:,} (seed {seed})"),
        ("workspace", _extent_text(density.extent)),
        ("reach", f"{1e3 * reach:.0f} mm from the base's origin"),
        ("region", _extent_text(region.bounds)),
        ("volume", f"{1e3 * region.volume:,.4g} litres, {voxels:,} of {reached:,} reached voxels"),
        (
            "voxel",
            f"{1e3 * density.voxel:g} mm, density known to about {100 * density.error:.1g} %",
        ),
    ):
        yield f"  {label:<12}{value}"


def _rows_text(view: RegionView, checked: Checked, *, every_row: bool) -> Iterator[str]:
    """Which rows lie inside; a line for each if wanted."""
    rows, points, measured, predicted = checked
    inside = view.region.contains(points)
    yield f"Targets of {rows.source}, {sum(measured)} measured, {sum(~measured)} predicted:"
    if every_row:
        yield (
            f"  {'row':>6}  {'set':<10}{'x':>9}{'y':>9}{'z [mm]':>9}   {'region':<9}{'border [mm]':>11}"
            f"{'within densest':>18}"
        )
        depth, needed = view.region.depth(points), view.density.share_of(points)
        for i, word in enumerate(rows.sets):
            x, y, z = (f"{1e3 * value:9.1f}" for value in points[i])
            often = f"{100 * needed[i]:.1f} %" if np.isfinite(needed[i]) else "not reached"
            yield (
                f"  {rows.rows[i]:>6}  {word:<10}{x}{y}{z}   {'inside' if inside[i] else 'OUTSIDE':<9}"
                f"{1e3 * abs(depth[i]):>11.0f}{often:>18}"
            )
    for word, chosen in (("estimation", rows.estimation), ("validation", rows.validation)):
        if chosen.any():
            outside = row_ranges(rows.rows[i] for i in np.flatnonzero(chosen & ~inside))
            many = f"{np.count_nonzero(chosen & inside)} of {np.count_nonzero(chosen)} {word} rows"
            yield fill(
                f"{many} lie in the region" + f"; outside: {outside}" * bool(outside) + ".", "  "
            )
    if measured.any():
        off = 1e3 * np.median(np.linalg.norm(points - predicted, axis=1)[measured])
        yield f"  Median distance of measured to predicted positions: {off:.3g} mm."


def _extent_text(ends: Array) -> str:
    """A box in mm."""
    mm = np.round(1e3 * ends) + 0.0
    return ", ".join(f"{a} {mm[0, k]:.0f} to {mm[1, k]:.0f}" for k, a in enumerate("xyz")) + " mm"
