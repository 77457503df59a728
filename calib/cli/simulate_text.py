"""What ``calib simulate`` prints: what was simulated, in plain words."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from calib.measure.simulation import Simulated, VirtualCell
    from calib.measure.truth import Truth
    from calib.model.parameters import Parameter

_WIDTH = 100


def simulated_text(cell: VirtualCell, made: Simulated, notes: Sequence[str]) -> str:
    """What was simulated, what is wrong with the robot, and what disturbs the measurements.

    Args:
        cell: The virtual cell.
        made: What it measured.
        notes: Sentences that a person must read.
    """
    paragraphs = [
        [_what(cell, made)],
        list(_errors(cell.truth, made)),
        list(_places(cell)),
        list(_noise(cell, made)),
        list(_events(cell, made)),
        [f"Note: {note}" for note in notes],
    ]
    return "\n\n".join(
        "\n".join(line if line.startswith("  ") else _fill(line) for line in lines)
        for lines in paragraphs
        if lines
    )


def _fill(text: str) -> str:
    """A sentence in lines of the usual width."""
    return textwrap.fill(text, _WIDTH, break_on_hyphens=False, break_long_words=False)


def _what(cell: VirtualCell, made: Simulated) -> str:
    """How many rows of what."""
    from calib import kinds

    robot, table = cell.robot, made.measurements
    held_back = int(table.validation.sum())
    rows = f"{len(table)} rows"
    if held_back:
        rows += f" ({len(table) - held_back} to estimate from, {held_back} to validate with)"
    what = f"the {kinds.get(cell.kind).words}"
    names = cell.truth.targets
    if len(names) > 1:
        what += f", at each pose of {len(names)} targets ({', '.join(names)})"
    groups = f", in {len(cell.truth.groups)} set-ups in turn" * (len(cell.truth.groups) > 1)
    visits = f" Each pose is visited {cell.visits} times." * (cell.visits > 1)
    return (
        f"Simulated: robot '{robot.name}', {robot.base} to {robot.tip}, {rows}. Each row measures {what}"
        f"{groups}.{visits}"
    )


def _errors(truth: Truth, made: Simulated) -> Iterator[str]:
    """The true errors by family, and what they come to."""
    from calib.families import FAMILIES

    yield f"The robot's true errors, model {truth.model.name}:"
    pairs = [
        (p, float(v)) for p, v in zip(truth.model.parameters, truth.x, strict=True) if v != 0.0
    ]
    shown = {(p.family, p.unit): None for p, _ in pairs}
    for family, unit in sorted(shown, key=lambda key: (list(FAMILIES).index(key[0]), key[1])):
        yield _family_line(
            family, unit, [(p, v) for p, v in pairs if (p.family, p.unit) == (family, unit)]
        )
    if not pairs:
        yield "  none: the robot is as its URDF says"
    off = truth.nominal_errors(made.q)
    yield (
        f"  So the nominal robot puts the target {_mm(_rms(off))} mm (rms), {_mm(off.max())} mm at most, from its true "
        "place."
    )


def _family_line(family: str, unit: str, pairs: Sequence[tuple[Parameter, float]]) -> str:
    """One family: how many errors, their rms, the largest."""
    from calib.families import unit_of

    scale, symbol = unit_of(unit).shown
    rms = math.sqrt(sum(v * v for _, v in pairs) / len(pairs))
    one, largest = max(pairs, key=lambda pair: abs(pair[1]))
    count = f"{len(pairs):>3} " + ("error, " if len(pairs) == 1 else "errors,")
    return (
        f"  {family:<13}{count} rms {scale * rms:.3g} {symbol}, largest {one.name} "
        f"{scale * largest:.3g} {symbol}"
    )


def _places(cell: VirtualCell) -> Iterator[str]:
    """Where targets and frames truly are."""
    from calib import kinds

    truth = cell.truth
    for name, T, said in zip(
        truth.targets, truth.T_tip_target, truth.said_T_tip_target, strict=True
    ):
        label = "The target" if len(truth.targets) == 1 else f"The target '{name}'"
        yield (
            f"{label} sits at {_point(T[:3, 3])} mm in the tip; it is said to sit at {_point(said[:3, 3])} mm."
        )
    if not kinds.get(cell.kind).directions:
        return
    for name, T in zip(truth.groups, truth.T_frame_base, strict=True):
        label = "The measurement frame" if len(truth.groups) == 1 else f"The frame of '{name}'"
        if (abs(T - _identity()) < 1e-12).all():
            yield f"{label} is the base frame."
        else:
            yield f"In {label[0].lower()}{label[1:]} the base is at {_point(T[:3, 3])} mm."


def _noise(cell: VirtualCell, made: Simulated) -> Iterator[str]:
    """What is uncertain in a measurement."""
    from calib import kinds

    noise = cell.noise
    what = "length" if kinds.get(cell.kind).lengths == 1 else "coordinate"
    if noise is None:
        yield f"Noise of a {what}: none."
    else:
        low, high = _mm(made.sigma.min()), _mm(made.sigma.max())
        between = f"{low} mm" if low == high else f"{low} to {high} mm"
        parts = [f"the instrument's {1e6 * noise.constant:g} um"]
        if noise.per_length:
            parts[0] += f" + {1e6 * noise.per_length:g} um/m"
        if noise.repeatability:
            parts.append(f"the robot's repeatability {1e6 * noise.repeatability:g} um")
        yield f"Noise of a {what}: {between} (standard deviation): {', '.join(parts)}."
    if kinds.get(cell.kind).angles:
        yield f"Noise of an orientation about each axis: {math.degrees(cell.sigma_angle):g} deg."
    steps = [
        f"{math.degrees(cell.encoder.angle):g} deg" if cell.encoder.angle else "",
        f"{1e3 * cell.encoder.length:g} mm" if cell.encoder.length else "",
    ]
    if any(steps):
        said = " and ".join(step for step in steps if step)
        yield f"Joint values are read in steps of {said}; the robot stands up to half a step beside them."


def _events(cell: VirtualCell, made: Simulated) -> Iterator[str]:
    """Outliers, a moved target, drift."""
    if made.outlier_rows and cell.outliers is not None:
        shown = ", ".join(map(str, made.outlier_rows[:20]))
        more = len(made.outlier_rows) - 20
        shown += f" and {more} more" * (more > 0)
        yield f"Outliers of {_mm(cell.outliers.size)} mm: rows {shown}."
    if cell.moved is not None:
        which = "The target" if cell.moved.target is None else f"The target '{cell.moved.target}'"
        yield (
            f"{which} moves by {_point(cell.moved.by)} mm in the tip before row {cell.moved.row}: "
            f"{len(made.moved_rows)} rows find it there."
        )
    if cell.drift.any():
        yield (
            f"Drift from the first row to the last: {_point(cell.drift)} mm in the measurement frame."
        )


def _identity() -> NDArray[np.float64]:
    """A pose that changes nothing."""
    import numpy as np

    return np.eye(4)


def _rms(values: NDArray[np.float64]) -> float:
    """Root of the mean square."""
    return math.sqrt(float((values**2).mean()))


def _mm(value: float) -> str:
    """A length in mm."""
    return f"{1e3 * float(value):.3g}"


def _point(values: NDArray[np.float64]) -> str:
    """Three lengths in mm."""
    return "(" + ", ".join(f"{1e3 * v + 0.0:.3f}".rstrip("0").rstrip(".") for v in values) + ")"
