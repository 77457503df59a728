"""What ``calib simulate`` prints: what was simulated, in plain words; or the figures of a study."""

from __future__ import annotations

import math
import shlex
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from calib.model.parameters import Parameter
    from calib.simulate.scenario import Scenario, Simulated
    from calib.simulate.study import Study, Trials

_WIDTH = 100

#: Of a line of the command to type next.
_COMMAND_WIDTH = 88


def simulated_text(scenario: Scenario, made: Simulated, notes: Sequence[str]) -> str:
    """What was simulated, what is wrong with the robot, and what disturbs the measurements.

    Args:
        scenario: What was simulated.
        made: What was measured.
        notes: Sentences that a person must read.
    """
    paragraphs = [
        [_what(scenario, made)],
        list(_errors(made)),
        list(_places(scenario, made)),
        list(_noise(scenario, made)),
        list(_events(scenario, made)),
        [f"Note: {note}" for note in notes],
    ]
    return "\n\n".join(
        "\n".join(line if line.startswith("  ") else _fill(line) for line in lines)
        for lines in paragraphs
        if lines
    )


def study_text(found: Study, trials: Trials) -> str:
    """The study in words and figures."""
    from calib.simulate.study import VERIFIED

    poses = _poses_text(trials)
    lines = [
        f"Study: {len(found.trials)} robots, each with errors of its own, {poses},",
        f"  calibrated, and verified at {VERIFIED} other poses.",
        "",
        f"{'Position error at unseen poses [mm]':<44}{'rms':>9}{'  90 % of robots between':>26}",
        _row("nominal", found.nominal_rms, found.range("nominal_rms")),
        _row("calibrated", found.rms, found.range("rms")),
        _row("calibrated, the worst pose of each", None, found.range("max")),
        "",
    ]
    forecast = found.forecast
    if forecast is not None:
        lines += [
            _row(
                "forecast before any measurement",
                forecast.rms,
                (forecast.rms_low, forecast.rms_high),
            ),
        ]
    stated = found.values("stated_rms")
    lines.append(
        _row(
            "what the fits say of themselves",
            float((stated**2).mean() ** 0.5),
            found.range("stated_rms"),
        )
    )
    covered = found.values("covered")
    if (covered == covered).all():
        lines.append(
            f"Inside the fits' own 95 % regions: {100 * covered.mean():.1f} % of the true positions."
        )
    lines += _counts(found)
    return "\n".join(lines)


def next_command(
    robot: str, table: Path, options: Mapping[str, str | None], held: list[str]
) -> str:
    """The command that fits what was simulated, in lines that a shell joins again."""
    parts = [shlex.join(["calib", "fit", robot, str(table)])]
    parts += [shlex.join([o, value]) for o, value in options.items() if value is not None]
    parts += [shlex.join(["--hold", value]) for value in held]
    lines = [""]
    for part in [*parts, "-o corrected.urdf"]:
        if lines[-1] and len(lines[-1]) + len(part) > _COMMAND_WIDTH:
            lines.append("")
        lines[-1] += f" {part}" if lines[-1] else part
    return " \\\n         ".join(lines)


def _fill(text: str) -> str:
    """A sentence in lines of the usual width."""
    return textwrap.fill(text, _WIDTH, break_on_hyphens=False, break_long_words=False)


def _what(scenario: Scenario, made: Simulated) -> str:
    """How many rows of what."""
    robot, table, truth = scenario.robot, made.measurements, made.truth
    held_back = int(table.validation.sum())
    rows = f"{len(table)} rows"
    if held_back:
        rows += f" ({len(table) - held_back} to estimate from, {held_back} to validate with)"
    what = f"the {scenario.kind.words}"
    if len(truth.targets) > 1:
        what += f", at each pose of {len(truth.targets)} targets ({', '.join(truth.targets)})"
    groups = f", in {len(truth.groups)} set-ups in turn" * (len(truth.groups) > 1)
    visits = f" Each pose is visited {scenario.visits} times." * (scenario.visits > 1)
    return (
        f"Simulated: robot '{robot.name}', {robot.base} to {robot.tip}, {rows}. Each row measures {what}"
        f"{groups}.{visits}"
    )


def _errors(made: Simulated) -> Iterator[str]:
    """The true errors by family, and what they come to."""
    from calib.families import FAMILIES

    truth = made.truth
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


def _places(scenario: Scenario, made: Simulated) -> Iterator[str]:
    """Where targets and frames truly are."""
    import numpy as np

    truth = made.truth
    for name, T, said in zip(
        truth.targets, truth.T_tip_target, truth.said_T_tip_target, strict=True
    ):
        label = "The target" if len(truth.targets) == 1 else f"The target '{name}'"
        yield (
            f"{label} sits at {_point(T[:3, 3])} mm in the tip; it is said to sit at {_point(said[:3, 3])} mm."
        )
    if not scenario.kind.directions:  # no row tells anything of a frame
        return
    for name, T in zip(truth.groups, truth.T_frame_base, strict=True):
        label = "The measurement frame" if len(truth.groups) == 1 else f"The frame of '{name}'"
        if np.abs(T - np.eye(4)).max() < 1e-12:
            yield f"{label} is the base frame."
        else:
            yield f"In {label[0].lower()}{label[1:]} the base is at {_point(T[:3, 3])} mm."


def _noise(cell: Scenario, made: Simulated) -> Iterator[str]:
    """What is uncertain in a measurement."""
    noise = cell.noise
    what = "length" if cell.kind.lengths == 1 else "coordinate"
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
    if cell.kind.angles:
        yield f"Noise of an orientation about each axis: {math.degrees(cell.sigma_angle):g} deg."
    steps = [
        f"{math.degrees(cell.encoder.angle):g} deg" if cell.encoder.angle else "",
        f"{1e3 * cell.encoder.length:g} mm" if cell.encoder.length else "",
    ]
    if any(steps):
        said = " and ".join(step for step in steps if step)
        yield f"Joint values are read in steps of {said}; the robot stands up to half a step beside them."


def _events(cell: Scenario, made: Simulated) -> Iterator[str]:
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
            f"{int(made.moved.sum())} rows find it there."
        )
    if any(cell.drift):
        yield (
            f"Drift from the first row to the last: {_point(cell.drift)} mm in the measurement frame."
        )


def _counts(found: Study) -> list[str]:
    """Models, verdicts, outliers and failures, as far as there is something to say."""
    lines = []
    count = len(found.trials)
    models = found.counts("model")
    lines.append(
        "Fitted: " + ", ".join(f"{name} {100 * n / count:.0f} %" for name, n in models.items())
    )
    verdicts = found.counts("verdict")
    if set(verdicts) != {""}:
        lines.append(
            "Verdicts: "
            + ", ".join(f"{word} {100 * n / count:.0f} %" for word, n in verdicts.items())
        )
    outliers, named = int(found.values("outliers").sum()), int(found.values("flagged").sum())
    wrong = int(found.values("false_alarms").sum())
    if outliers:
        lines.append(f"Outliers: {named} of {outliers} named.")
    if wrong:
        lines.append(f"Rows named as outliers that are none: {wrong} in {count} fits.")
    if found.failures:
        seed, reason = found.failures[0]
        text = f"{len(found.failures)} trials ended with an error; the first, seed {seed}: {reason}"
        lines += textwrap.wrap(text, 100, break_on_hyphens=False)
    return lines


def _row(label: str, rms: float | None, between: tuple[float, float]) -> str:
    """A line of the table [mm]."""
    middle = f"{'':>9}" if rms is None else f"{1e3 * rms:>9.3f}"
    return f"{label:<44}{middle}{1e3 * between[0]:>15.3f} to {1e3 * between[1]:.3f}"


def _poses_text(trials: Trials) -> str:
    """How many poses, and how they were made."""
    number = trials.fitted
    if trials.poses is not None:
        return f"measured at the {number} poses given"
    return f"measured at {number} {'planned' if trials.planned else 'random'} poses"


def _rms(values: NDArray[np.float64]) -> float:
    """Root of the mean square."""
    return math.sqrt(float((values**2).mean()))


def _mm(value: float) -> str:
    """A length in mm."""
    return f"{1e3 * float(value):.3g}"


def _point(values: NDArray[np.float64]) -> str:
    """Three lengths in mm."""
    return "(" + ", ".join(f"{1e3 * v + 0.0:.3f}".rstrip("0").rstrip(".") for v in values) + ")"
