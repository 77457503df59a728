"""A region of the workspace as text, as ``calib workspace`` prints it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from calib.robot.ranges import range_text
from calib.show.lines import fill, paragraphs, row_ranges
from calib.show.tables import Column, labelled, name_column, table_lines

if TYPE_CHECKING:
    from calib.basics.arrays import Array
    from calib.robot.robot import Robot
    from calib.verbs.workspace.region_rows import Checked, RegionView

#: Width of a label of the region [columns].
_REGION_LABEL = 12


def workspace_text(view: RegionView, origin: str, seed: int, *, every_row: bool) -> str:
    """Write a region of the workspace.

    Args:
        view: The region, and the rows that were checked against it.
        origin: Source of the joint ranges, in words; empty: the joints' limits.
        seed: Seed of the sampled joint values.
        every_row: Whether each checked row has a line.

    Returns:
        Joint ranges, region, and checked rows, in lines of 100 columns.
    """
    robot: Robot = view.robot
    target = " ".join(f"{1e3 * value:.6g}" for value in view.target)
    joints = [
        f"Robot '{robot.name}', base '{robot.base}', tip '{robot.tip}', target at {target} mm in the tip."
    ]
    columns = [name_column("  joint", 33), Column("range", left=True)]
    ranges = zip(robot.joint_names, view.ranges, strict=True)
    cells = [(f"  {name}", range_text(robot, name, ends)) for name, ends in ranges]
    joints += table_lines(columns, cells)
    if origin:
        joints.append(fill(f"Ranges of {origin}.", "  "))

    density, region = view.density, view.region
    voxels, reached = np.count_nonzero(region.cells), np.count_nonzero(density.counts)
    volume = f"{1e3 * region.volume:,.4g} litres, {voxels:,} of {reached:,} reached voxels"
    facts = {
        "samples": f"{density.samples:,} (seed {seed})",
        "workspace": _extent(density.extent),
        "region": _extent(region.bounds),
        "volume": volume,
        "voxel": f"{1e3 * density.voxel:g} mm",
    }
    lines = [
        f"The smallest region that holds {100 * region.held:.4g} % of the target's positions, in the frame of "
        f"'{robot.base}':"
    ]
    lines += [labelled(label, text, _REGION_LABEL, "  ") for label, text in facts.items()]

    rows: Iterable[str] = ()
    if view.checked is not None:
        rows = _row_lines(view, view.checked, every_row=every_row)
    return paragraphs(joints, lines, rows)


def _extent(ends: Array) -> str:
    """Format a box in mm, given its least and greatest corner (2, 3) [m]."""
    lower, upper = np.round(1e3 * ends) + 0.0
    axes = [f"{axis} {lower[k]:.0f} to {upper[k]:.0f}" for k, axis in enumerate("xyz")]
    return ", ".join(axes) + " mm"


def _row_lines(view: RegionView, checked: Checked, *, every_row: bool) -> Iterator[str]:
    """Count the rows inside the region, by set, name those outside, and show a table of all of them if wanted."""
    rows, points, measured = checked
    inside = view.region.contains(points)
    yield f"Targets of {rows.source}, {sum(measured)} measured, {sum(~measured)} predicted:"
    if every_row:
        # The target's position of each row, and the share of the densest voxels that reaches it.
        columns = [
            Column("row", 8),
            Column("set", 10, left=True, gap=2),
            Column("x", 9, gap=0),
            Column("y", 8),
            Column("z [mm]", 8),
            Column("region", 9, left=True, gap=3),
            Column("within densest", 14, gap=0),
        ]
        shares = view.density.share_of(points)
        cells = []
        for i, word in enumerate(rows.sets):
            share = f"{100 * shares[i]:.1f} %" if np.isfinite(shares[i]) else "not reached"
            place = [f"{1e3 * value:.1f}" for value in points[i]]
            region = "inside" if inside[i] else "OUTSIDE"
            cells.append([str(rows.rows[i]), word, *place, region, share])
        yield from table_lines(columns, cells)
    for name, chosen in (("estimation", rows.estimation), ("validation", rows.validation)):
        if not chosen.any():
            continue
        text = f"{np.count_nonzero(chosen & inside)} of {np.count_nonzero(chosen)} {name} rows lie in the region"
        outside = row_ranges(rows.rows[i] for i in np.flatnonzero(chosen & ~inside))
        if outside:
            text += f"; outside: {outside}"
        yield fill(f"{text}.", "  ")
