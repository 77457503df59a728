"""Plans of poses, as `calib plan` prints them, and in notebooks."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import singledispatch
from typing import TYPE_CHECKING

import numpy as np

from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.values import one_line
from calib.instruments.camera import CameraInstrument
from calib.instruments.instrument import Instrument
from calib.show.as_html import notebook_html
from calib.show.blocks import NOTEBOOK, Facts, Page, Paragraph, Section
from calib.show.lines import mm, paragraphs, plural, wrap
from calib.show.robot_sentences import coupling_sentence
from calib.show.tables import Column, labelled, name_column, table_lines
from calib.show.words import chain_name
from calib.verbs.plan.plan import Plan
from calib.verbs.plan.plan_file import distances_and_tilts, first_rows, image_name

if TYPE_CHECKING:
    from calib.verbs.plan.forecast import Forecast
    from calib.verbs.plan.notes import Code, Note

_CRITERIA = {
    "V": "least mean error over the workspace (V-optimal)",
    "D": "most information on the parameters (D-optimal)",
    "A": "least mean variance of the parameters (A-optimal)",
}

_REASONS = {
    "region": "outside the region",
    "tracker_range": "out of the tracker's range",
    "reflector_cone": "with the reflector turned away",
    "beam": "with the line of sight obstructed",
    "limits": "not within the joint ranges",
    "focus": "too near or too far",
    "tilt": "too slanted",
    "image": "not in the image",
    "collision": "in collision",
    "approach": "with a blocked approach",
}

#: How poses are approached, by the request.
_APPROACHES = {
    "straight": "straight from the pose before",
    "one": "from one side: drive to the row 'via' before each pose, so that every joint arrives rising",
    "both": "from both sides: each pose is measured twice, after a row 'via' from which every joint rises, and after "
    "one from which it falls",
}

#: The sentence of each note; {0}, {1} are its values.
_NOTES: dict[Code, str] = {
    "generic_target": "No target was given: planned for one at {0} mm in each tip (--target; of several hands each by "
    "its name in the table [targets_mm] of the cell file).",
    "orientation_noise": "Assumed noise of an orientation: {0} rad about each axis (sigma_angle_deg in the cell).",
    "camera_assumed": "Nothing is known of the camera's intrinsics: planned for a focal length of {0} px and no "
    "distortion.",
    "image_noise": "Assumed noise of a corner: {0} px in u and v (sigma_image_px in the cell).",
    "board_scale": "Most of the expected error comes from the scale of the print, which is known to {0} %: with an "
    "exact one it would be {1}. Measure the print with a caliper, and state it in the board's description.",
    "one_side_hides": "From one side lost motion cannot be told from the joints' zeros: the expected error is that of "
    "programs that come from any side. --approach straight or both determines it.",
    "reflector_not_checked": "The reflector's direction was not checked: the tracker's position is not known "
    "(--tracker).",
    "collisions_not_checked": "Collisions were not checked.",
    "images_checked": "Checked for collisions: links, the board as a plate of 10 mm, and the camera as a ball, in the "
    "hand as a rod, with each other{0}; and that no link is between the camera and the board. Not checked: obstacles "
    "that the cell file does not name, cables, hoses, brackets, people. Run the first round slowly.",
    "collisions_checked": "Checked for collisions: links, and each target with a rod of {0} as its holder, with each "
    "other{1}. Not checked: obstacles that the cell file does not name, cables, hoses, other holders, the "
    "instrument, people. Run the first round slowly.",
    "no_geometry": "Not checked for collisions, without geometry in the URDF: {0}.",
    "always_close": "Always closer than the clearance, rejected only where they touch: {0}.",
    "always_touching": "Not checked against each other, since they touch at (nearly) all poses: {0}.",
}

#: Width of a label of the plan's head [columns].
_PLAN_LABEL = 15


def plan_text(plan: Plan, first_row: int = 1) -> str:
    """Write a plan in paragraphs: its head, the forecasts, and notes, the last ones on moves that are blocked.

    Args:
        plan: The plan.
        first_row: Number of the first row or image of its table, see `calib.verbs.plan.plan_file.write_plan`.
    """
    notes = [note_text(note) for note in plan.notes]
    # Moves by the rows of the table, or by images, each with a pose to move through if one was found.
    # Each pose has a row for each target, after that of the pose to come from.
    before = 0 if plan.via is None else 1
    rows = first_rows(plan, first_row)
    moves, without_detour = [], []
    for blocked in plan.blocked:
        start = f"row {rows[blocked.start - 1] + before}"
        end = f"row {rows[blocked.end - 1]}"
        if isinstance(plan.instrument, CameraInstrument):
            start, end = (
                image_name(first_row + pose - 1, _first_station(plan, pose - 1))
                for pose in (blocked.start, blocked.end)
            )
        move = f"{start if blocked.start else 'the start'} to {end}"
        if blocked.by is None:
            without_detour.append(move)
        else:
            values = []
            for joint, value in zip(plan.robot.inputs, blocked.by, strict=True):
                slides = joint.type == "prismatic"
                values.append(
                    f"{1e3 * value:.1f} mm" if slides else f"{math.degrees(value):.1f} deg"
                )
            move += f" (via {', '.join(values)})"
        moves.append(move)
    if moves:
        notes.append(f"The straight path in joint space collides from {', '.join(moves)}.")
    if without_detour:
        notes.append(f"No detour was found from {', '.join(without_detour)}: insert a pose there.")
    return paragraphs(_head(plan), _forecasts(plan), [f"Note: {note}" for note in notes])


def _first_station(plan: Plan, pose: int) -> str:
    """Return the name of the first station that measures at a pose, by its index."""
    return plan.sights[int(np.argmax(plan.seen[pose]))][0]


def note_text(note: Note) -> str:
    """Word a note of a plan, by its code and its values in SI units, as a sentence with lengths in mm."""
    if note.code == "board_scale":
        scale, rms = map(float, note.values)
        return _NOTES[note.code].format(f"{100 * scale:.2g}", _mm(rms))
    if note.code == "generic_target":
        return _NOTES[note.code].format(", ".join(f"{1e3 * float(v):g}" for v in note.values))
    if note.code == "images_checked":
        return _NOTES[note.code].format(_and_with(note.values))
    if note.code == "collisions_checked":
        radius, *obstacles = note.values
        others = _and_with(obstacles)
        return _NOTES[note.code].format(f"{1e3 * float(radius):g} mm radius", others)
    return _NOTES[note.code].format(", ".join(map(str, note.values)))


def _and_with(obstacles: Sequence[str | float]) -> str:
    """Word further bodies that are compared; empty: there are none."""
    return f" and with {', '.join(map(str, obstacles))}" if obstacles else ""


def _mm(value: float) -> str:
    """Format a length [m] in mm, with four significant digits and at most four decimals."""
    size = abs(1e3 * value)
    digits = 4
    for limit, fewer in ((1, 3), (10, 2), (100, 1)):
        if size >= limit:
            digits = fewer
    return f"{1e3 * value:.{digits}f} mm"


def _head(plan: Plan) -> Iterator[str]:
    """Yield the paragraphs of a plan's head: robot, numbers of poses and candidates, criterion, model, coupling."""
    forecast = plan.forecast
    auto = ", for 'auto'" if plan.cell.model != plan.model else ""
    indices = ", ".join(f"{name} {value:.3g}" for name, value in forecast.indices.items())
    rejected = ", ".join(f"{n} {_REASONS[why]}" for why, n in plan.refused.items() if n)
    yield _what_is_planned(plan.instrument, plan)
    for label, text in (
        *_facts(plan.instrument, plan),
        ("criterion", _CRITERIA[plan.request.criterion]),
        ("approach", _APPROACHES[plan.request.approach]),
        (
            "error model",
            f"{plan.model}{auto}: {forecast.columns} parameters, rank {forecast.rank} (whole workspace "
            f"{forecast.workspace_rank})",
        ),
        ("observability", f"{indices} (1 mm, 1 mrad)"),
        ("candidates", f"{plan.candidates} of {plan.drawn} drawn"),
        ("rejected", rejected or "none"),
    ):
        yield labelled(label, text, _PLAN_LABEL, "  ")
    coupling = coupling_sentence(plan.robot)
    if coupling:
        yield wrap(coupling, "  ")


@singledispatch
def _what_is_planned(_instrument: Instrument, plan: Plan) -> str:
    """Word the robot, its chain, the numbers of poses and the targets."""
    robot, count = plan.robot, plan.request.count
    taken = f" in addition to {len(plan.taken)} measured ones" if len(plan.taken) else ""
    chains = " and ".join(f"{chain.base} to {chain.tip}" for chain in robot.chains)
    word = "chain" if len(robot.chains) == 1 else "chains"
    at_each = f"targets at each: {', '.join(plan.targets)}"
    if not plan.seen.all():
        at_each = f"targets: {_counts(plan)}"
    return (
        f"Plan for '{robot.name}' ({robot.urdf.source}), {word} {chains}: {count} poses for "
        f"calibration{taken}, {plan.request.validation} for validation; {at_each}."
    )


def _counts(plan: Plan) -> str:
    """Word at how many poses each target is measured, by each of several stations."""
    several = len({group for group, _ in plan.sights}) > 1
    parts = []
    for (group, target), seen in zip(plan.sights, plan.seen.T, strict=True):
        by = f" by {group}" if several else ""
        parts.append(f"{target}{by} at {plural(int(seen.sum()), 'pose')}")
    return ", ".join(parts)


@_what_is_planned.register
def _(_instrument: CameraInstrument, plan: Plan) -> str:
    """Word the robot, the links of camera and board, and the numbers of images."""
    robot, count = plan.robot, plan.request.count
    taken = f" in addition to {len(plan.taken)} taken already" if len(plan.taken) else ""
    cameras = " and ".join(dict.fromkeys(chain.base for chain in robot.chains))
    boards = " and ".join(dict.fromkeys(chain.tip for chain in robot.chains))
    what, each = "images", ""
    if len(plan.views) > 1:
        what, each = "poses", f"; boards seen: {_counts(plan)}"
    return (
        f"Plan for '{robot.name}' ({robot.urdf.source}), camera on {cameras}, board on {boards}: {count} {what} "
        f"for calibration{taken}, {plan.request.validation} for validation{each}."
    )


@singledispatch
def _facts(_instrument: Instrument, _plan: Plan) -> Iterator[tuple[str, str]]:
    """Yield label and text of what the poses cover as the instrument sees it; nothing unless it is a camera."""
    yield from ()


@_facts.register
def _(_instrument: CameraInstrument, plan: Plan) -> Iterator[tuple[str, str]]:
    """Yield label and text of the board's distances and tilts, and how much of the image its corners cover.

    Of several cameras and boards each pair has its own.
    """
    for k, (view, sightline) in enumerate(zip(plan.views, plan.sightlines, strict=True)):
        assert isinstance(view.instrument, CameraInstrument)
        seen = plan.seen[:, k]
        if not seen.any():
            continue
        distances, tilts = (
            values[seen] for values in distances_and_tilts(view.instrument, plan, k)
        )
        least, most, half = np.degrees([tilts.min(), tilts.max(), np.median(tilts)])
        covered = view.instrument.coverage(sightline.target_poses(plan.joints[seen]))
        if len(plan.views) > 1:
            group, target = plan.sights[k]
            yield (
                "board",
                f"{target}, seen by {group or 'the camera'} in {plural(int(seen.sum()), 'image')}",
            )
        yield "distance", f"{1e3 * distances.min():.0f} to {1e3 * distances.max():.0f} mm"
        yield "tilt", f"{least:.0f} to {most:.0f} deg, half of the images above {half:.0f} deg"
        yield "image", f"corners in {100.0 * covered:.0f} % of its area"


def _forecasts(plan: Plan) -> Iterator[str]:
    """Yield lines on the expected errors: of the plan, of random poses, of those taken, of other numbers of poses."""
    forecast, count, taken = plan.forecast, plan.request.count, len(plan.taken)
    planned, random, others = f"these {count} poses", f"{count} random ones", "poses"
    if taken:
        planned = f"the {taken} taken and these {count}"
        random += " instead of these"
        others = f"more poses after the {taken} taken"
    rows: list[tuple[str, Forecast | None]] = [
        (planned, forecast),
        (random, plan.at_random),
        (f"the {taken} taken alone", plan.before),
    ]
    for number, at_number in plan.ladder:
        if number != count:
            rows.append((f"{number} {others}", at_number))
    columns = [
        name_column("", 36),
        Column("rms", 10),
        Column("of 90 % of calibrations", 27),
        Column("worst place", 13),
    ]
    cells = []
    for label, other in rows:
        if other is not None:
            span = f"{_mm(other.rms_low)} to {_mm(other.rms_high)}"
            cells.append((f"  {label}", _mm(other.rms), span, _mm(other.max)))
    yield "Expected error of a predicted position after the calibration, over the workspace:"
    yield from table_lines(columns, cells)
    yield f"{noise_text(forecast.sigma)}. Unmodelled errors are not included."
    unknown = forecast.columns - sum(map(bool, forecast.identifiable))
    if unknown:
        yield f"{unknown} parameters are known in combinations only."


def noise_text(sigma: Mapping[str, float]) -> str:
    """Word the noise of a forecast, without a full stop: standard deviations of one scalar, given by their SI units."""
    parts = []
    for symbol, std in sigma.items():
        unit = RESIDUAL_UNITS[symbol]
        size = f"{unit.to_shown * std:.4f} {unit.shown}"
        parts.append(
            f"of one measured coordinate: {size}" if symbol == "m" else f"{unit.per}: {size}"
        )
    return f"Noise {', '.join(parts)}"


def plan_html(p: Plan) -> str:
    """Write a plan for a notebook, as HTML: numbers of poses, expected errors of these and of random ones."""
    count = p.request.count
    rows = [
        ("poses", f"{count}, and {p.request.validation} for validation"),
        ("expected rms error", f"{mm(p.forecast.rms)} mm"),
        ("of random poses", f"{mm(p.at_random.rms)} mm"),
        ("model", p.model),
        ("candidates", f"{p.candidates} of {p.drawn} drawn"),
    ]
    if p.blocked:
        rows.append(("moves that are not free", str(len(p.blocked))))
    excerpt = [Paragraph(f"Plan for {chain_name(p.robot)}"), Facts(rows)]
    return notebook_html(Page("Plan", p.robot.name, [Section(lambda: excerpt, on=NOTEBOOK)]))


def plan_line(p: Plan) -> str:
    """Write a plan in one line: robot, poses, expected error."""
    count = p.request.count
    poses = f"{plural(count, 'pose')} and {p.request.validation} for validation"
    return one_line("Plan", chain_name(p.robot), poses, f"expected rms {mm(p.forecast.rms)} mm")
