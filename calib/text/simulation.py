"""What ``calib simulate`` prints: what was simulated, a row for each thing; or the figures of a study."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from calib.model.families import FAMILIES, unit_of
from calib.robot.readback import column_limits, range_text
from calib.simulation.scenario import Scenario, Simulated
from calib.simulation.study import VERIFIED, Study, Trials
from calib.text.lines import fill, row_ranges

Array = NDArray[np.float64]

#: Columns of a row's label.
_LABEL = 26

#: A joint value may pass a limit by this [rad or m]: tables hold a few digits, and encoders have steps.
_ROUNDING = 1e-3


def simulated_text(scenario: Scenario, made: Simulated) -> str:
    """What was simulated: what is wrong with the robot, and what disturbs the measurements."""
    table, robot = made.measurements, scenario.robot
    rows = f"{len(table)} rows"
    if held_back := int(table.validation.sum()):
        rows += f" ({len(table) - held_back} to estimate from, {held_back} to validate with)"
    lines = [fill(f"Simulated: robot '{robot.name}', {robot.base} to {robot.tip}, {rows}."), ""]
    measured = [("Each row measures", f"the {scenario.kind.words}")]
    for label, names in (
        ("Targets at each pose", made.truth.targets),
        ("Set-ups in turn", made.truth.groups),
    ):
        measured += [(label, ", ".join(names))] if len(names) > 1 else []
    measured += [("Visits of each pose", str(scenario.visits))] if scenario.visits > 1 else []
    for label, value in (
        *measured,
        *_errors(made),
        *_places(scenario, made),
        *_disturbances(scenario, made),
        *_outside(made),
    ):
        lines.append(fill(f"{label:<{_LABEL - 1}} {value}", "", " " * _LABEL))
    return "\n".join(lines)


def _outside(made: Simulated) -> Iterator[tuple[str, str]]:
    """The joints that stood beyond their limits."""
    robot = made.truth.nominal
    limits = column_limits(robot)
    beyond = (made.q < limits[:, 0] - _ROUNDING) | (made.q > limits[:, 1] + _ROUNDING)
    for k in np.flatnonzero(beyond.any(axis=0)):
        name, rows = robot.joint_names[k], np.array(made.measurements.rows)[beyond[:, k]]
        yield (
            "Note",
            f"outside the limits of '{name}', {range_text(robot, name, limits[k])}: rows {row_ranges(rows)}",
        )


def _errors(made: Simulated) -> Iterator[tuple[str, str]]:
    """The true errors by family, and what they come to."""
    truth = made.truth
    found: dict[tuple[str, str], list[tuple[float, str]]] = {}
    for p, value in zip(truth.model.parameters, truth.x, strict=True):
        if value:
            found.setdefault((p.family, p.unit), []).append((float(value), p.name))
    yield "True errors", f"model {truth.model.name}" + ("" if found else "; none is drawn or given")
    for family, unit in sorted(found, key=lambda key: (list(FAMILIES).index(key[0]), key[1])):
        scale, symbol = unit_of(unit).shown
        pairs = found[family, unit]
        largest, name = max(pairs, key=lambda pair: abs(pair[0]))
        rms = _rms(np.array([value for value, _ in pairs]))
        yield (
            f"  {family}",
            f"{len(pairs)}, rms {scale * rms:.3g} {symbol}, largest {name} {scale * largest:.3g} {symbol}",
        )
    off = truth.nominal_errors(made.q)
    yield "  of the nominal robot", f"{_mm(_rms(off))} mm rms, {_mm(off.max())} mm at most"


def _places(scenario: Scenario, made: Simulated) -> Iterator[tuple[str, str]]:
    """Where targets and frames truly are."""
    truth = made.truth
    targets = zip(truth.targets, truth.T_tip_target, truth.said_T_tip_target, strict=True)
    for name, T, said in targets:
        label = "Target" if len(truth.targets) == 1 else f"Target '{name}'"
        yield label, f"{_point(T[:3, 3])} mm in the tip, said to be {_point(said[:3, 3])} mm"
    if not scenario.kind.directions:  # no row tells anything of a frame
        return
    for name, T in zip(truth.groups, truth.T_frame_base, strict=True):
        label = "Measurement frame" if len(truth.groups) == 1 else f"Frame of '{name}'"
        same = np.abs(T - np.eye(4)).max() < 1e-12
        yield label, "the base frame" if same else f"the base is at {_point(T[:3, 3])} mm in it"


def _disturbances(scenario: Scenario, made: Simulated) -> Iterator[tuple[str, str]]:
    """Noise, steps, outliers, a moved target, drift."""
    noise, encoder, moved = scenario.noise, scenario.encoder, scenario.moved
    said = "none"
    if noise is not None:
        low, high = _mm(made.sigma.min()), _mm(made.sigma.max())
        parts = [f"instrument {1e6 * noise.constant:g} um"]
        parts[0] += f" + {1e6 * noise.per_length:g} um/m" if noise.per_length else ""
        parts += [f"robot {1e6 * noise.repeatability:g} um"] if noise.repeatability else []
        said = f"{low if low == high else f'{low} to {high}'} mm std: {', '.join(parts)}"
    yield f"Noise of a {'length' if scenario.kind.lengths == 1 else 'coordinate'}", said
    if scenario.kind.angles:
        yield "Noise of an orientation", f"{np.degrees(scenario.sigma_angle):g} deg about each axis"
    if encoder.angle or encoder.length:
        steps = (f"{np.degrees(encoder.angle):g} deg", f"{1e3 * encoder.length:g} mm")
        yield "Encoder steps", ", ".join(step for step in steps if not step.startswith("0 "))
    if made.outlier_rows and scenario.outliers is not None:
        yield (
            f"Outliers of {_mm(scenario.outliers.size)} mm",
            f"rows {row_ranges(made.outlier_rows)}",
        )
    if moved is not None:
        which = "all targets" if moved.target is None else f"'{moved.target}'"
        yield (
            "Moved target",
            f"{which} by {_point(moved.by)} mm in the tip before row {moved.row}: {int(made.moved.sum())} rows",
        )
    if scenario.drift.any():
        yield "Drift, first to last row", f"{_point(scenario.drift)} mm in the measurement frame"


def study_text(found: Study, trials: Trials) -> str:
    """The study in figures."""
    how = "planned" if trials.planned else "random"
    where = (
        f"{trials.fitted} {how} poses"
        if trials.poses is None
        else f"the {trials.fitted} poses given"
    )
    count, forecast = len(found.trials), found.forecast
    figures: list[tuple[str, float | None, tuple[float, float]]] = [
        ("nominal", found.nominal_rms, found.range("nominal_rms")),
        ("calibrated", found.rms, found.range("rms")),
        ("calibrated, the worst pose of each", None, found.range("max")),
    ]
    if forecast is not None:
        between = (forecast.rms_low, forecast.rms_high)
        figures.append(("forecast before any measurement", forecast.rms, between))
    stated = _rms(found.values("stated_rms"))
    figures.append(("what the fits say of themselves", stated, found.range("stated_rms")))
    lines = [
        f"Study: {count} robots, each with errors of its own, measured at {where},",
        f"  calibrated, and verified at {VERIFIED} other poses.",
        "",
        f"{'Position error at unseen poses [mm]':<44}{'rms':>9}{'  90 % of robots between':>26}",
    ]
    for label, rms, (low, high) in figures:
        middle = "" if rms is None else f"{1e3 * rms:.3f}"
        lines.append(f"{label:<44}{middle:>9}{1e3 * low:>15.3f} to {1e3 * high:.3f}")
    lines.append("")
    covered = found.values("covered")
    if np.isfinite(covered).all():
        lines.append(
            f"Inside the fits' own 95 % regions: {100 * covered.mean():.1f} % of the true positions."
        )
    for label, name in (("Fitted", "model"), ("Verdicts", "verdict")):
        shares = [
            f"{word} {100 * n / count:.0f} %" for word, n in found.counts(name).items() if word
        ]
        lines += [f"{label}: {', '.join(shares)}"] if shares else []
    outliers, named, wrong = (
        int(found.values(name).sum()) for name in ("outliers", "flagged", "false_alarms")
    )
    if outliers:
        lines.append(f"Outliers: {named} of {outliers} named.")
    if wrong:
        lines.append(f"Rows named as outliers that are none: {wrong} in {count} fits.")
    for seed, reason in found.failures[:1]:
        text = f"{len(found.failures)} trials ended with an error; the first, seed {seed}: {reason}"
        lines.append(fill(text))
    return "\n".join(lines)


def _rms(values: Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def _mm(value: float) -> str:
    """A length in mm."""
    return f"{1e3 * float(value):.3g}"


def _point(values: Array) -> str:
    """Three lengths in mm."""
    return "(" + ", ".join(f"{1e3 * v + 0.0:.3f}".rstrip("0").rstrip(".") for v in values) + ")"
