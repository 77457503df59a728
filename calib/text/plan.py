"""What ``calib plan`` and ``calib workspace`` print."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from calib.robot.ranges import range_text
from calib.text.lines import fill, row_ranges

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from calib.design.notes import Code, Note
    from calib.design.plan import Plan
    from calib.regions.region_rows import Checked, RegionView

_CRITERIA = {
    "V": "least mean error over the workspace (V-optimal)",
    "D": "most information on the parameters (D-optimal)",
    "A": "least mean variance of the parameters (A-optimal)",
}

_REASONS = {
    "region": "outside the region",
    "tracker_range": "out of the tracker's range",
    "reflector_cone": "with the reflector turned away",
    "beam": "with something in the beam",
    "collision": "in collision",
}

_NOTES: dict[Code, str] = {
    "generic_target": "No target was given: planned for one at {0} m in the tip (--target).",
    "orientation_noise": "Assumed noise of an orientation: {0} rad about each axis (sigma_angle_deg in the cell).",
    "reflector_not_checked": "The reflector's direction was not checked: no position of the tracker (--tracker).",
    "collisions_not_checked": "Collisions were not checked.",
    "collisions_checked": "Checked for collisions: links, and each target with a rod of {0} as its holder, with each "
    "other{1}. Not checked: obstacles that the cell file does not name, cables, hoses, other holders, the "
    "instrument, people. Drive the first round slowly.",
    "no_geometry": "Not checked for collisions, without geometry in the URDF: {0}.",
    "always_close": "Always closer than the clearance, refused only where they touch: {0}.",
    "always_touching": "Not checked against each other, for they touch at (nearly) all poses: {0}.",
}


def plan_text(plan: Plan) -> str:
    """The text of a plan."""
    notes = [f"Note: {note}" for note in (*map(note_text, plan.notes), *_blocked(plan))]
    return _paragraphs(_head(plan), _forecasts(plan), notes)


def note_text(note: Note) -> str:
    """A note as a sentence."""
    if note.code == "collisions_checked":
        radius, *around = note.values
        others = f" and with {', '.join(map(str, around))}" if around else ""
        return _NOTES[note.code].format(f"{1e3 * float(radius):g} mm radius", others)
    return _NOTES[note.code].format(", ".join(map(str, note.values)))


def _paragraphs(*paragraphs: Iterable[str]) -> str:
    """Paragraphs of lines, an empty one between; an indented line stays as it is."""
    return "\n\n".join(
        "\n".join(line if line.startswith("  ") else fill(line) for line in lines)
        for lines in map(list, paragraphs)
        if lines
    )


def _mm(value: float) -> str:
    """A length in mm, of four digits that matter."""
    size = abs(1e3 * value)
    return f"{1e3 * value:.{1 if size >= 100 else 2 if size >= 10 else 3 if size >= 1 else 4}f} mm"


def _head(plan: Plan) -> Iterator[str]:
    """How many poses of which robot, out of which candidates, and what is to be estimated."""
    robot, f, count = plan.robot, plan.forecast, len(plan.estimation)
    taken = f", beside {len(plan.taken)} measured already" if len(plan.taken) else ""
    yield (
        f"Plan for '{robot.name}' ({robot.urdf.source}), chain {robot.base} to {robot.tip}: {count} poses to calibrate "
        f"with{taken}, {len(plan.joints) - count} to validate with; targets at each: {', '.join(plan.targets)}."
    )
    auto = ", for 'auto'" if plan.cell.model != plan.model else ""
    yield f"  criterion      {_CRITERIA[plan.request.criterion]}"
    yield (
        f"  error model    {plan.model}{auto}: {f.columns} parameters, rank {f.rank} (whole workspace "
        f"{f.workspace_rank})"
    )
    indices = ", ".join(f"{name} {value:.3g}" for name, value in f.indices.items())
    yield f"  observability  {indices} (1 mm, 1 mrad)"
    yield f"  candidates     {plan.candidates} of {plan.drawn} drawn"
    refused = ", ".join(f"{n} {_REASONS[why]}" for why, n in plan.refused.items() if n)
    yield f"  refused        {refused or 'none'}"


def _forecasts(plan: Plan) -> Iterator[str]:
    """What the plan will reach, and what random poses and those taken alone would; how well parameters are known."""
    f, count, taken = plan.forecast, len(plan.estimation), len(plan.taken)
    yield "Expected error of a predicted position after the calibration, over the workspace:"
    yield f"  {'':<32}{'rms':>11}{'of 90 % of calibrations':>28}{'worst place':>14}"
    rows = [
        (f"those taken and these, {taken + count}" if taken else f"these {count} poses", f),
        (f"{count} random ones" + (" in place of these" if taken else ""), plan.at_random),
        (f"the {taken} taken alone", plan.before),
    ]
    beside = f" beside the {taken} taken" if taken else ""
    rows += [(f"{number} poses{beside}", one) for number, one in plan.ladder if number != count]
    for label, one in rows:
        if one is not None:
            span = f"{_mm(one.rms_low)} to {_mm(one.rms_high)}"
            yield f"  {label:<32}{_mm(one.rms):>11}{span:>28}{_mm(one.max):>14}"
    yield (
        f"Noise of one measured coordinate: {_mm(f.sigma)}. Errors that the model lacks come on top."
    )
    if rest := f.columns - sum(map(bool, f.identifiable)):
        yield f"{rest} parameters are known in combinations only."


def _blocked(plan: Plan) -> Iterator[str]:
    """Moves whose straight way collides, each with a pose to drive by, if one was found."""
    k, named = len(plan.targets), []
    for one in plan.blocked:
        by = () if one.by is None else zip(plan.robot.inputs, one.by, strict=True)
        drive = ", ".join(
            f"{1e3 * v:.1f} mm" if joint.type == "prismatic" else f"{math.degrees(v):.1f} deg"
            for joint, v in by
        )
        start = f"row {k * (one.start - 1) + 1}" if one.start else "the start"
        named.append(
            f"{start} to row {k * (one.end - 1) + 1}" + f" (drive by {drive})" * bool(drive)
        )
    if named:
        yield f"The straight way in joint space collides from {', '.join(named)}."


# The workspace


def workspace_text(view: RegionView, origin: str, seed: int, *, every_row: bool) -> str:
    """The text of a region.

    ``origin`` is what the ranges are taken from, empty for the limits; with ``every_row`` each row of the table has a
    line.
    """
    rows = [] if view.checked is None else _row_lines(view, view.checked, every_row=every_row)
    return _paragraphs(_joints(view, origin), _region(view, seed), rows)


def _joints(view: RegionView, origin: str) -> Iterator[str]:
    """The robot, its target and the ranges of its joints."""
    robot, at = view.robot, " ".join(f"{1e3 * value:.6g}" for value in view.target)
    yield (
        f"Robot '{robot.name}', base '{robot.base}', tip '{robot.tip}', target at {at} mm in the tip."
    )
    yield f"  {'joint':<32}range"
    for name, ends in zip(robot.joint_names, view.ranges, strict=True):
        yield f"  {name:<31} {range_text(robot, name, ends)}"
    if origin:
        yield fill(f"Ranges of {origin}.", "  ")


def _region(view: RegionView, seed: int) -> Iterator[str]:
    """Extent, region, voxels."""
    density, region = view.density, view.region
    voxels, reached = np.count_nonzero(region.cells), np.count_nonzero(density.counts)
    yield (
        f"The smallest region that holds {100 * region.held:.4g} % of the target's positions, in the frame of "
        f"'{view.robot.base}':"
    )
    yield f"  samples     {density.samples:,} (seed {seed})"
    yield f"  workspace   {_extent(density.extent)}"
    yield f"  region      {_extent(region.bounds)}"
    yield (
        f"  volume      {1e3 * region.volume:,.4g} litres, {voxels:,} of {reached:,} reached voxels"
    )
    yield f"  voxel       {1e3 * density.voxel:g} mm"


def _extent(ends: NDArray[np.float64]) -> str:
    """A box in mm."""
    mm = np.round(1e3 * ends) + 0.0
    return ", ".join(f"{a} {mm[0, k]:.0f} to {mm[1, k]:.0f}" for k, a in enumerate("xyz")) + " mm"


def _row_lines(view: RegionView, checked: Checked, *, every_row: bool) -> Iterator[str]:
    """Which rows lie inside; a line for each if wanted."""
    rows, points, measured = checked
    inside = view.region.contains(points)
    yield f"Targets of {rows.source}, {sum(measured)} measured, {sum(~measured)} predicted:"
    if every_row:
        yield (
            f"  {'row':>6}  {'set':<10}{'x':>9}{'y':>9}{'z [mm]':>9}   {'region':<9}"
            f"{'within densest':>14}"
        )
        needed = view.density.share_of(points)
        for i, word in enumerate(rows.sets):
            x, y, z = (f"{1e3 * value:9.1f}" for value in points[i])
            often = f"{100 * needed[i]:.1f} %" if np.isfinite(needed[i]) else "not reached"
            yield (
                f"  {rows.rows[i]:>6}  {word:<10}{x}{y}{z}   {'inside' if inside[i] else 'OUTSIDE':<9}"
                f"{often:>14}"
            )
    for word, chosen in (("estimation", rows.estimation), ("validation", rows.validation)):
        if chosen.any():
            outside = row_ranges(rows.rows[i] for i in np.flatnonzero(chosen & ~inside))
            many = f"{np.count_nonzero(chosen & inside)} of {np.count_nonzero(chosen)} {word} rows"
            yield fill(
                f"{many} lie in the region" + f"; outside: {outside}" * bool(outside) + ".", "  "
            )
