"""What ``calib simulate`` prints: what was simulated, a row for each thing; or the figures of a study."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.model.families import FAMILIES, unit_of
from calib.numerics.errors import rms
from calib.simulation.scenario import Scenario, Simulated
from calib.simulation.study import VERIFIED, Study, Trials
from calib.text.lines import fill, row_ranges
from calib.units import Array

#: Columns of a row's label.
_LABEL = 26


def simulated_text(scenario: Scenario, made: Simulated) -> str:
    """What was simulated: what is wrong with the robot, and what disturbs the measurements."""
    table, robot = made.measurements, scenario.robot
    rows = f"{len(table)} rows"
    if held_back := int(table.validation.sum()):
        rows += f" ({len(table) - held_back} to estimate from, {held_back} to validate with)"
    lines = [fill(f"Simulated: robot '{robot.name}', {robot.base} to {robot.tip}, {rows}."), ""]
    for label, value in (
        ("Each row measures", f"the {scenario.kind.words}"),
        ("Targets at each pose", ", ".join(made.truth.targets)),
        ("Set-ups in turn", ", ".join(made.truth.groups)),
        ("Visits of each pose", str(scenario.visits)),
        *_errors(made),
        *_places(scenario, made),
        *_disturbances(scenario, made),
    ):
        if value:
            lines.append(fill(f"{label:<{_LABEL - 1}} {value}", "", " " * _LABEL))
    return "\n".join(lines)


def _errors(made: Simulated) -> Iterator[tuple[str, str]]:
    """The true errors by family, and what they come to."""
    truth = made.truth
    found: dict[tuple[int, str, str], list[tuple[float, str]]] = {}
    for p, value in zip(truth.model.parameters, truth.x, strict=True):
        if value:
            key = list(FAMILIES).index(p.family), p.family, p.unit
            found.setdefault(key, []).append((float(value), p.name))
    yield "True errors", f"model {truth.model.name}" + ("" if found else "; none is drawn or given")
    for (_, family, unit), pairs in sorted(found.items()):
        scale, symbol = unit_of(unit).shown
        largest, name = max(pairs, key=lambda pair: abs(pair[0]))
        size = scale * rms(np.array([value for value, _ in pairs]))
        yield (
            f"  {family}",
            f"{len(pairs)}, rms {size:.3g} {symbol}, largest {name} {scale * largest:.3g} {symbol}",
        )
    off = truth.nominal_errors(made.q)
    yield "  of the nominal robot", f"{_mm(rms(off))} mm rms, {_mm(off.max())} mm at most"


def _places(scenario: Scenario, made: Simulated) -> Iterator[tuple[str, str]]:
    """Where targets and frames truly are."""
    truth = made.truth
    targets = zip(truth.targets, truth.T_tip_target, truth.said_T_tip_target, strict=True)
    for name, T, said in targets:
        place = f"{_point(T[:3, 3])} mm in the tip, said to be {_point(said[:3, 3])} mm"
        yield f"Target '{name}'", place
    for name, T in zip(truth.groups, truth.T_frame_base, strict=True):
        same = np.abs(T - np.eye(4)).max() < 1e-12
        place = "the base frame" if same else f"the base is at {_point(T[:3, 3])} mm in it"
        # Where no row tells anything of a frame, nothing is said of it.
        label = f"Frame of '{name}'" if name else "Measurement frame"
        yield label, place if scenario.kind.directions else ""


def _disturbances(scenario: Scenario, made: Simulated) -> Iterator[tuple[str, str]]:
    """Noise, steps, outliers, a moved target, drift; nothing of what there is not."""
    noise, encoder, moved = scenario.noise, scenario.encoder, scenario.moved
    said = "none"
    if noise is not None:
        low, high = _mm(made.sigma.min()), _mm(made.sigma.max())
        said = f"{low if low == high else f'{low} to {high}'} mm std: instrument {1e6 * noise.constant:g} um"
        said += f" + {1e6 * noise.per_length:g} um/m" if noise.per_length else ""
        said += f", robot {1e6 * noise.repeatability:g} um" if noise.repeatability else ""
    yield f"Noise of a {'length' if scenario.kind.lengths == 1 else 'coordinate'}", said
    if scenario.kind.angles:
        yield "Noise of an orientation", f"{np.degrees(scenario.sigma_angle):g} deg about each axis"
    steps = (f"{np.degrees(encoder.angle):g} deg", f"{1e3 * encoder.length:g} mm")
    yield "Encoder steps", ", ".join(step for step in steps if not step.startswith("0 "))
    if made.outlier_rows and scenario.outliers is not None:
        size = _mm(scenario.outliers.size)
        yield f"Outliers of {size} mm", f"rows {row_ranges(made.outlier_rows)}"
    if moved is not None:
        which = "all targets" if moved.target is None else f"'{moved.target}'"
        where = f"{_point(moved.by)} mm in the tip before row {moved.row}"
        yield "Moved target", f"{which} by {where}: {int(made.moved.sum())} rows"
    if scenario.drift.any():
        yield "Drift, first to last row", f"{_point(scenario.drift)} mm in the measurement frame"


def study_text(found: Study, trials: Trials) -> str:
    """The study in figures."""
    how = f"{trials.fitted} {'planned' if trials.planned else 'random'} poses"
    where = how if trials.poses is None else f"the {trials.fitted} poses given"
    count, forecast = len(found.trials), found.forecast
    stated = rms(found.values("stated_rms"))
    figures = [
        ("nominal", found.nominal_rms, found.range("nominal_rms")),
        ("calibrated", found.rms, found.range("rms")),
        ("calibrated, the worst pose of each", None, found.range("max")),
        ("what the fits say of themselves", stated, found.range("stated_rms")),
    ]
    if forecast is not None:
        between = (forecast.rms_low, forecast.rms_high)
        figures.insert(3, ("forecast before any measurement", forecast.rms, between))
    lines = [
        f"Study: {count} robots, each with errors of its own, measured at {where},",
        f"  calibrated, and verified at {VERIFIED} other poses.",
        "",
        f"{'Position error at unseen poses [mm]':<44}{'rms':>9}{'  90 % of robots between':>26}",
    ]
    for label, size, (low, high) in figures:
        middle = "" if size is None else f"{1e3 * size:.3f}"
        lines.append(f"{label:<44}{middle:>9}{1e3 * low:>15.3f} to {1e3 * high:.3f}")
    lines.append("")
    covered = 100 * found.values("covered").mean()
    if np.isfinite(covered):
        lines.append(f"Inside the fits' own 95 % regions: {covered:.1f} % of the true positions.")
    for label, name in (("Fitted", "model"), ("Verdicts", "verdict")):
        words = [f"{w} {100 * n / count:.0f} %" for w, n in found.counts(name).items() if w]
        lines += [f"{label}: {', '.join(words)}"] if words else []
    names = ("outliers", "flagged", "false_alarms")
    outliers, flagged, wrong = (int(found.values(name).sum()) for name in names)
    if outliers or wrong:
        lines.append(f"Outliers: {flagged} of {outliers} named, and {wrong} rows that are none.")
    for seed, reason in found.failures[:1]:
        text = f"{len(found.failures)} trials ended with an error; the first, seed {seed}: {reason}"
        lines.append(fill(text))
    return "\n".join(lines)


def _mm(value: float) -> str:
    """A length in mm."""
    return f"{1e3 * float(value):.3g}"


def _point(values: Array) -> str:
    """Three lengths in mm."""
    return "(" + ", ".join(f"{1e3 * v + 0.0:.3f}".rstrip("0").rstrip(".") for v in values) + ")"
