"""The result as text for a terminal: what to do, how good it is, what was found. At most 100 columns, no colours.

What the report shows too is public: facts, places, rows of errors and of parameters.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import calib.data.kinds as registry
from calib.model.error_model import placed_name
from calib.model.families import FAMILIES, unit_of
from calib.model.observability import Combination
from calib.model.parameters import FRAME, TARGET
from calib.numerics.errors import Errors
from calib.result.calibration import CalibrationValues
from calib.result.prediction import Outlier, ParameterEstimate
from calib.text.lines import deg, mm, number, wrap
from calib.text.verdict import reason_text, robustness_text
from calib.version import __version__

if TYPE_CHECKING:
    from calib.result.uncertainty import Bootstrap, Profile

#: A parameter with a longer name gets a line for its name alone.
_LONGEST_NAME = 46

#: More combinations or rows, and more targets or measurement frames than this are not listed.
_MOST_ROWS, _MOST_PLACES, _MOST_NAMES = 12, 6, 6

#: Labels of `facts` that the report asks for.
EXPECTED, SCATTER = "Error to expect of a new point", "Scatter of repeats"
SIZES = "Size of the robot's errors"

#: Degrees of freedom from which on the noise is that of the rows.
_TELLING = 6.0

#: A size of errors below this is none [mm, mrad, urad/Nm].
_NOTHING = 2e-3

#: What each method of cross-validation leaves out at a time.
_LEFT_OUT = {
    "leave-one-out": "each row predicted from the others alone",
    "leave-one-pose-out": "each pose, repeats and all, predicted from the others alone",
    "leave-one-station-out": "each station predicted from the others, but for its own frame",
    "leave-stations-out": "some stations predicted from the others, but for their own frames",
    "10-fold": "a tenth of the poses at a time, predicted from the others",
}

#: A row of the error table: label, n, max, mean, rms, span x, span y, span z.
_COLUMNS, _ANGLE_COLUMNS = "{:<33}{:>5}" + " {:>9}" * 6, "{:<33}{:>5}" + " {:>9}" * 3
ANGLE_HEAD = _ANGLE_COLUMNS.format("Orientation error [deg]", "rows", "max", "mean", "rms")


def summary(c: CalibrationValues) -> str:
    """The whole summary of a calibration."""
    m, known = c.rows, facts(c)
    took = "" if math.isnan(c.seconds) else f", {1e3 * c.seconds:.0f} ms"
    verdict = ["Verdict: none, because nothing was cross-validated."]
    if c.verdict is not None:
        verdict = [
            f"Verdict: {c.verdict.use}",
            *(wrap(reason_text(r), "  ") for r in c.verdict.reasons),
        ]
    non_geometric = (
        []
        if c.non_geometric is None
        else [f"Non-geometric model '{c.non_geometric.name}', not in the URDF:"]
    )
    for name, value, half, unit in non_geometric_parameters(c):
        non_geometric.append(f"  {name:<{_LONGEST_NAME}}{value:>10} {half} {unit}")
    every = c.observability.unidentifiable
    unknown = [f"{unidentifiable_text(c)}:"] * bool(every)
    unknown += [wrap(combination_text(one), "  ") for one in every[:_MOST_ROWS]]
    unknown += [f"  and {len(every) - _MOST_ROWS} more"] * (len(every) > _MOST_ROWS)
    parts = (
        wrap(
            f"calib {__version__}: robot '{c.nominal.name}', {c.nominal.base} to {c.nominal.tip}, "
            f"{len(c.nominal.joints)} joints; {m.estimation.sum()} rows to estimate and {m.validation.sum()} to "
            f"validate from {c.source.name or 'memory'}"
        ),
        "\n".join(verdict),
        _errors(c),
        _flagged(c),
        "\n".join(map(wrap, target_sentences(c))),
        "\n".join(map(wrap, frame_sentences(c))),
        _ladder(c),
        "\n".join([*(wrap(f"{label}: {text}") for label, text in known.items()), *unknown]),
        _parameters(c),
        "\n".join(non_geometric),
        wrap(f"{solver_text(c)}{took}. {c.solution.message}"),
    )
    return "\n\n".join(part for part in parts if part)


def facts(c: CalibrationValues) -> dict[str, str]:
    """What was found in numbers, a sentence for each label, as far as there is something to say."""
    of = measured_lengths(c.used)
    noise = [f"{mm(c.sigma)} mm per {of}"] * math.isfinite(c.sigma)
    noise += [f"{deg(c.sigma_angle, 4)} deg about an axis"] * math.isfinite(c.sigma_angle)
    source = f"from residuals, {c.freedom:.0f} d.o.f."
    source = source if c.freedom >= _TELLING else "mostly assumed: too few rows"
    result = {"Noise": f"{' and '.join(noise)} (1 sigma, {source})."}
    if c.repeats is not None and np.isfinite(c.repeats.within[0]):
        scatter, freedom = c.repeats.within[0], c.repeats.freedoms[0]
        result[SCATTER] = f"{mm(scatter)} mm per {of} ({freedom:.0f} d.o.f.)."
    here, everywhere = c.new_point
    result[EXPECTED] = (
        f"{mm(here)} mm rms near the measured poses, {mm(everywhere)} mm over the joint limits."
    )
    if c.cross_validation is None and c.verdict is not None:
        # Another set-up explains the rows: this fit is of something that is not there.
        result[EXPECTED] = "not known: see the verdict."
    elif c.cross_validation is None and c.freedom < _TELLING:
        # Sizes of errors that are found from nothing shrink to nothing, and what is expected with them.
        result[EXPECTED] = "not known: too few rows tell it."
    if c.prior_std:
        shown = [
            (family, size, *FAMILIES[family].unit.shown) for family, size in c.prior_std.items()
        ]
        prior_std = [
            f"{family} {factor * size:.3g} {unit}" if factor * size > _NOTHING else f"{family} none"
            for family, size, factor, unit in shown
        ]
        how = "found from the data" if c.prior_std_from == "data" else "as given"
        result[SIZES] = f"{', '.join(prior_std)} ({how})."
    o = c.observability
    result["Rank"] = f"{o.rank} of {o.columns} parameters, condition number {o.condition:.0f}."
    return result


def measured_lengths(*used: NDArray[np.bool_]) -> str:
    """What lengths are of, by the scalars used, shape (N, D): ``"coordinate"``, ``"length"`` (a distance), or both."""
    numbers = {int(n) for one in used for n in np.sum(one[:, :3], axis=1)}
    found = ["coordinate"] * (max(numbers, default=0) > 1) + ["length"] * (1 in numbers)
    return " or ".join(found) or "coordinate"


def error_title(*used: NDArray[np.bool_]) -> str:
    """What tables of errors in mm are of, by the scalars used, shape (N, D): a distance is no position."""
    return f"{measured_lengths(*used).replace('coordinate', 'position').capitalize()} error"


def error_rows(c: CalibrationValues) -> list[tuple[str, Errors]]:
    """Label and errors of each row of the error tables: before and after, by set, and on held-out rows."""
    rows = [
        (f"{name} rows, {who}", c.errors[who][name])
        for name in ("estimation", "validation")
        for who in c.errors
    ]
    for who, v in (
        ("nominal", c.nominal_cross_validation),
        ("calibrated", c.cross_validation),
        ("non_geometric", None if c.non_geometric is None else c.non_geometric.cross_validation),
    ):
        if v is not None:
            rows.append((f"held-out rows*, {who}", v.errors))
            if c.outliers:
                rows.append(("  the same without outliers", v.errors_without_outliers))
    return rows


def held_out_text(c: CalibrationValues) -> str:
    """What ``held-out rows*`` are; empty without cross-validation."""
    v = c.cross_validation
    return "" if v is None else f"* {v.method}: {_LEFT_OUT[v.method]}"


def error_head(title: str = "Position error") -> str:
    """The head of the error table."""
    return _COLUMNS.format(f"{title} [mm]", "rows", "max", "mean", "rms", "span x", "y", "z")


def error_row(label: str, e: Errors) -> str:
    """One row of the error table, [mm]."""
    return _COLUMNS.format(label, e.n, *map(mm, (e.max, e.mean, e.rms, *e.span_axis)))


def angle_row(label: str, e: Errors) -> str:
    """One row of the table of orientations, [deg]."""
    values = [deg(v, 4) for v in (e.max_angle, e.mean_angle, e.rms_angle)]
    return _ANGLE_COLUMNS.format(label, e.n_angle, *values)


def weights_text(c: CalibrationValues) -> str:
    """Whether the outliers count in the fit."""
    weights = dict(zip(c.rows.numbers, c.weights, strict=True))
    unused = not any(weights.get(o.row) for o in c.outliers)
    return "no weight in the fit" if unused else "full weight in the fit"


def errorless(c: CalibrationValues) -> frozenset[str]:
    """The parameters of families whose errors the data showed to be none: they stay nominal, and have no interval.

    Their prior's standard deviation went to nothing, which is no knowledge of them.
    """
    if c.prior_std_from != "data":
        return frozenset()
    nothing = {f: _NOTHING / FAMILIES[f].unit.shown[0] for f in c.prior_std}
    return frozenset(
        p.name
        for p, found in zip(c.model.parameters, c.parameters, strict=True)
        if c.prior_std.get(p.family, np.inf) <= nothing.get(p.family, 0.0)
        # One with a prior of its own does not share the family's.
        and found.prior_std <= nothing[p.family]
    )


def unidentifiable_text(c: CalibrationValues) -> str:
    """What heads the combinations that nothing determines; empty if there are none."""
    if not c.observability.unidentifiable:
        return ""
    held = " (resolved by the priors only)" if c.prior_std else ""
    return f"Unidentifiable combinations{held}"


def combination_text(one: Combination) -> str:
    """Parameters that change together, such as ``d2 and d4 together (+1 mm, -1 mm)``."""
    if len(one.names) == 1:
        return f"{one.names[0]} at all"
    if len(one.names) > _MOST_NAMES:
        more = len(one.names) - _MOST_NAMES
        return f"{', '.join(one.names[:_MOST_NAMES])} and {more} more together"
    shown = [(step, *unit_of(u).shown) for step, u in zip(one.steps, one.units, strict=True)]
    amounts = ", ".join(f"{factor * step:+.3g} {unit}" for step, factor, unit in shown)
    return f"{', '.join(one.names[:-1])} and {one.names[-1]} together ({amounts})"


def shown_parameters(c: CalibrationValues) -> list[ParameterEstimate]:
    """The parameters of the geometry that are listed: frames and the targets' orientations are told as poses."""
    return [
        p
        for p, m in zip(c.parameters, c.model.parameters, strict=True)
        if m.family != FRAME and not (m.family == TARGET and m.unit == "rad")
    ]


def non_geometric_parameters(c: CalibrationValues) -> Sequence[tuple[str, str, str, str]]:
    """Name, value, half the 95 % interval and unit of the non-geometric model's parameters that the geometry lacks."""
    result = []
    for p in () if c.non_geometric is None else c.non_geometric.parameters:
        if p.name not in c.model.names:
            factor, unit = unit_of(p.unit).shown
            half = "(at bound)" if p.at_bound else f"± {0.5 * factor * (p.high - p.low):.3f}"
            result.append((p.name, number(factor * p.value), half, unit))
    return result


def solver_text(c: CalibrationValues) -> str:
    """How the solver fared, without the time that it took."""
    s = c.solution
    return f"Solver '{c.solver}': {s.status} after {s.iterations} iterations, {s.evaluations} evaluations"


def target_sentences(c: CalibrationValues, most: int = _MOST_PLACES) -> list[str]:
    """Where each target is, how sure that is, and how far it moved; more than ``most`` are counted."""
    own, count = c.setup.target_names, len(c.setup.targets)
    shown = [_target(c, t, name) for t, name in enumerate(own[:most])]
    return shown + [f"... and {count - most} more targets"] * (count > most)


def _target(c: CalibrationValues, t: int, name: str) -> str:
    """One target."""
    T, rotation = c.setup.T_tip_target[t], c.setup.rotation
    what = f"Target '{name}'" if name else "Target"
    place = f"({_listed(T[:3, 3])}) mm{_rpy(T) if rotation else ''} in {c.nominal.tip}"
    if not c.setup.target_unknown[t]:
        return f"{what}: {place}, as given."
    if placed_name("target", "x", name) not in c.model.names:
        return f"{what}: registered to its validation rows, {place}."
    sure = f"({_half_widths(c, 'target', 'xyz', name)}) mm"
    if rotation:
        sure += f" and ({_half_widths(c, 'target', ('rx', 'ry', 'rz'), name)}) deg about its axes"
    if not c.setup.target_given[t]:
        return f"{what}: found at {place}, 95 % ± {sure}."
    moved = float(np.linalg.norm(T[:3, 3] - c.nominal_setup.T_tip_target[t, :3, 3]))
    text = f"{what}: {place}, 95 % ± {sure}; {mm(moved, 1)} mm from the position given."
    if moved > 5e-3:  # given wrongly, rather than mounted inexactly
        text += " Check the sign and the order of the numbers given."
    return text


def frame_sentences(c: CalibrationValues, most: int = _MOST_PLACES) -> list[str]:
    """Where the base stands in each frame that was estimated, and how sure that is; more than ``most`` are counted."""
    many = len(c.setup.groups) > 1
    found = [f for f, directions in enumerate(c.setup.unknown) if directions]
    lines = [_frame(c, f, c.setup.groups[f] if many else "") for f in found[:most]]
    return lines + [f"... and {len(found) - most} more set-ups"] * (len(found) > most)


def _frame(c: CalibrationValues, f: int, group: str) -> str:
    """One measurement frame; of a socket the point in the base, of a plane its normal and distance."""
    T, directions, base = c.setup.T_frame_base[f], c.setup.unknown[f], c.nominal.base
    names = {k for k, g in zip(c.rows.kinds, c.rows.groups, strict=True) if g == c.setup.groups[f]}
    kinds = [registry.get(name) for name in names]
    what = min(kind.place for kind in kinds)  # of an anchor in a socket: anchor
    what += f" '{group}'" if group else ""
    own = {kind.directions if kind.own_frame else () for kind in kinds}
    fitted = placed_name("frame", directions[0], group) in c.model.names
    what += "" if fitted else ", registered to its validation rows"
    if own == {("x", "y", "z")}:
        return f"{what}: found at ({_listed(-T[:3, :3].T @ T[:3, 3])}) mm in {base}."
    if own == {("z", "rx", "ry")}:
        normal = ", ".join(f"{v:.5f}" for v in T[2, :3])
        return f"{what}: found with the normal ({normal}) in {base}, {mm(-T[2, 3])} mm along it."
    place = f"{what}: {base} found at ({_listed(T[:3, 3])}) mm{_rpy(T)} in it"
    if not fitted:
        return f"{place}."
    sure = [
        f"({_half_widths(c, 'frame', some, group)}) {unit}"
        for unit, some in (
            ("mm", [d for d in directions if d in "xyz"]),
            ("deg", [d for d in directions if d not in "xyz"]),
        )
        if some
    ]
    axes = "the frame" if c.setup.own_axes[f] else base
    return f"{place}; 95 % ± {' and '.join(sure)} for {', '.join(directions)} along and about the axes of {axes}."


def _listed(lengths: Iterable[float]) -> str:
    """Lengths [m] in mm with commas between them."""
    return ", ".join(map(mm, lengths))


def _rpy(T: NDArray[np.float64]) -> str:
    """Roll, pitch and yaw of a pose."""
    return f", rpy ({', '.join(map(deg, pin.rpy.matrixToRpy(T[:3, :3])))}) deg"


def _half_widths(c: CalibrationValues, what: str, directions: Iterable[str], name: str) -> str:
    """Half the 95 % intervals of parameters of a frame or target, [mm] or [deg]."""
    every = [c.parameter(placed_name(what, direction, name)) for direction in directions]
    scale = {"m": 1e3, "rad": float(np.degrees(1.0))}
    return ", ".join(f"{0.5 * scale[p.unit] * (p.high - p.low):.3g}" for p in every)


def _errors(c: CalibrationValues) -> str:
    """The error tables: before and after, by set, and on held-out rows; a second one for orientations."""
    rows = error_rows(c)
    lines = [error_head(error_title(c.used)), *(error_row(label, e) for label, e in rows if e.n)]
    if any(e.n_angle for _, e in rows):
        lines += ["", ANGLE_HEAD, *(angle_row(label, e) for label, e in rows if e.n_angle)]
    return "\n".join([*lines, *filter(None, [held_out_text(c)])])


def _flagged(c: CalibrationValues) -> str:
    """The rows that do not belong to the others, the first dozen of each set."""
    if not c.outliers:
        lines = ["Outliers: none."]
    else:
        lines = [wrap(f"Outliers ({weights_text(c)}): {_outliers(c.outliers)}")]
        lines += [wrap(robustness_text(c.robustness), "  ")] if c.robustness is not None else []
    if c.suspects:
        lines.append(wrap(f"Outliers among the validation rows: {_outliers(c.suspects)}"))
    return "\n".join(lines)


def _outliers(every: Sequence[Outlier]) -> str:
    """Rows with residual and score."""
    shown = [
        f"row {o.row} ({mm(o.residual, 2)} mm, {o.score:.1f} sigma)" for o in every[:_MOST_ROWS]
    ]
    more = len(every) - _MOST_ROWS
    return "; ".join(shown + [f"and {more} more"] * (more > 0))


def _ladder(c: CalibrationValues) -> str:
    """The models that were tried, and which of them were chosen."""
    if not c.candidates:
        return ""
    width = max(36, *(len(one.name) + 3 for one in c.candidates))
    row = f"{{:<{width}}}{{:>10}}{{:>10}}{{:>16}}  {{}}"
    lines = [row.format("Models tried", "parameters", "evidence", "held-out rms", "chosen for")]
    best = max(one.evidence for one in c.candidates)
    uses = {"geometry": "the URDF", "non_geometric": "predict()"}
    for one in c.candidates:
        gain, chosen = f"{one.evidence - best:.1f}", uses.get(one.chosen, "")
        e = one.cross_validation.errors_without_outliers
        rms = f"{mm(e.rms)} mm" if e.n else f"{deg(e.rms_angle, 4)} deg"
        cells = f"  {one.name}", one.parameters, gain, rms, chosen
        lines.append(row.format(*cells).rstrip())
    note = (
        "  evidence: restricted log likelihood, less what sizes and sets cost, less the best one's"
    )
    return "\n".join([*lines, note])


def _parameters(c: CalibrationValues) -> str:
    """The parameters with their 95 % intervals; * where the data know them in combinations only."""
    shown, none = shown_parameters(c), errorless(c)
    if not shown:
        return ""
    width = min(max(len(p.name) for p in shown), _LONGEST_NAME) + 2
    row = f"{{:<{width}}}{{:>12}}{{:>12}}{{:>11}}{{:>10}}"
    lines = [row.format("Parameter", "nominal", "value", "change", "95 % +-")]
    for p in shown:
        scale, unit = (1e3, "mm") if p.unit == "m" else (float(np.degrees(1.0)), "deg")
        mark = " #" if p.name in none else "" if p.identifiable else " *"
        half = "at bound" if p.at_bound else f"{0.5 * scale * (p.high - p.low):.3g}"
        lines += [wrap(p.name)] * (len(p.name) > _LONGEST_NAME)
        cells = (
            p.name if len(p.name) <= _LONGEST_NAME else "",
            "-" if p.nominal is None else number(scale * p.nominal),
            number(scale * p.value),
            "-" if p.nominal is None else number(scale * p.delta, 3, "+"),
            "-" if p.name in none else half,
        )
        lines.append(f"{row.format(*cells)} {unit}{mark}")
    if none:
        lines.append("# no errors of this kind were found: kept at its nominal value")
    if not all(p.identifiable or p.name in none for p in shown):
        lines.append("* known in combination with others only; see above")
    return "\n".join(lines)


# Intervals besides those of the covariance

#: Probability that an interval holds the true value.
LEVEL = 0.95

#: A parameter with a longer name gets a line for its name alone; an end of an interval takes so many columns.
_LONGEST_HERE, _NUMBER = 34, 10


def bootstrap_text(result: CalibrationValues, found: Bootstrap) -> str:
    """The bootstrap's intervals beside those of the covariance.

    Those of a frame are left out: its parameters count from where registration put it.
    """
    own = [parameter.family != FRAME for parameter in result.model.parameters]
    ends = found.intervals(LEVEL).tolist()
    rows = [(p, *pair) for p, pair, shown in zip(found.parameters, ends, own, strict=True) if shown]
    lines = [
        f"Bootstrap: {len(found.x)} samples of whole poses, seed {found.seed}",
        *_interval_table(rows, "bootstrap"),
        f"Predicted positions spread by {1e3 * found.measured_rms:.3f} mm rms at the measured poses and "
        f"{1e3 * found.everywhere_rms:.3f} mm",
        f"over the joint limits; by the covariance {1e3 * result.expected_measured:.3f} mm and "
        f"{1e3 * result.expected_everywhere:.3f} mm.",
    ]
    if found.stopped:
        lines.append(f"The solver did not converge on {found.stopped} of the samples.")
    return "\n".join(lines)


def profile_text(profiles: list[tuple[ParameterEstimate, Profile]]) -> str:
    """Intervals by the profile of the cost beside those of the covariance."""
    rows = [(p, found.low, found.high) for p, found in profiles]
    return "\n".join(["Profile of the cost", *_interval_table(rows, "profile")])


def _interval_table(rows: list[tuple[ParameterEstimate, float, float]], what: str) -> list[str]:
    """One line a parameter: its value, the covariance's interval, and another one; in mm, deg and so on."""
    width = min(max([len(p.name) for p, *_ in rows] + [len("95 % intervals")]), _LONGEST_HERE) + 2
    pair = 2 * _NUMBER + 4
    lines = [f"{'95 % intervals':<{width}}{'value':>{_NUMBER}}{'covariance':>{pair}}{what:>{pair}}"]
    for p, low, high in rows:
        factor, unit = (math.degrees(1.0), "deg") if p.unit == "rad" else unit_of(p.unit).shown
        name = p.name
        if len(name) > _LONGEST_HERE:
            lines.append(name)
            name = ""
        value, *ends = (
            f"{round(factor * v, 3) + 0.0:.3f}" if math.isfinite(v) else "open"
            for v in (p.value, p.low, p.high, low, high)
        )
        cells = [f"{a:>{_NUMBER}} .. {b:>{_NUMBER}}" for a, b in (ends[:2], ends[2:])]
        if p.at_bound:
            cells[0] = f"{'at bound':>{pair}}"
        lines.append(f"{name:<{width}}{value:>{_NUMBER}}{''.join(cells)} {unit}")
    return lines


def bootstrap_table(found: Bootstrap) -> dict[str, Any]:
    """The bootstrap as nested tables of plain values, for the result file."""
    return {
        "samples": len(found.x),
        "seed": found.seed,
        "stopped": found.stopped,
        "level": LEVEL,
        "parameters": [
            {"name": p.name, "unit": p.unit, "std": std, "low": low, "high": high}
            for p, std, (low, high) in zip(
                found.parameters, found.std, found.intervals(LEVEL), strict=True
            )
        ],
        "expected": {
            "measured_rms_m": found.measured_rms,
            "everywhere_rms_m": found.everywhere_rms,
        },
    }
