"""What a result says, sentence by sentence and row by row; the summary and the report set it, each in its own way."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.families import FAMILIES, unit_of
from calib.identify.correlations import correlations
from calib.identify.prediction import Outlier, ParameterEstimate
from calib.identify.result import Calibration
from calib.identify.selection import Candidate
from calib.identify.statistics import Errors
from calib.identify.words import three
from calib.kinds import get
from calib.model.parameters import FRAME, TARGET

#: Correlations beyond this are told, the largest few.
_WORTH_NAMING, _MOST_PAIRS = 0.95, 4

#: What is left out at a time.
_LEFT_OUT = {
    "leave-one-out": "each row predicted from the others alone",
    "leave-one-pose-out": "each pose, repeats and all, predicted from the others alone",
    "leave-one-set-up-out": "each set-up predicted from the others, but for where it stands itself",
    "leave-set-ups-out": "some set-ups predicted from the others, but for where they stand themselves",
}
_TENTHS = "a tenth of the poses at a time, predicted from the others"

#: Degrees of freedom from which on the noise is that of the rows.
_TELLING = 6.0

#: A size of errors below this says that there are none [mm, mrad, urad/Nm].
_NOTHING = 2e-3


@dataclass(frozen=True, slots=True)
class ParameterText:
    """A parameter as it is shown, in mm or degrees.

    Attributes:
        name: Its name.
        nominal: The value before; ``"-"`` for a target that was not given.
        value: The value after.
        change: The change; ``"-"`` where there is no value before.
        half: Half the 95 % interval, or ``"at bound"``.
        unit: Of all of these.
        identifiable: Whether the measurements determine it; otherwise they know it in combinations only.
        at_bound: Whether it was stopped by a bound.
    """

    name: str
    nominal: str
    value: str
    change: str
    half: str
    unit: str
    identifiable: bool
    at_bound: bool


def measured_lengths(used: NDArray[np.bool_]) -> str:
    """What the residuals' lengths are of: ``"coordinate"``, ``"length"``, such as a distance, or both."""
    numbers = np.sum(used[:, :3], axis=1)
    return _lengths(coordinates=bool(np.any(numbers > 1)), lengths=bool(np.any(numbers == 1)))


def lengths_of_kinds(kinds: Collection[str]) -> str:
    """The same, from the kinds of the rows.

    Args:
        kinds: Such as ``"point"``.
    """
    lengths = [kind for kind in kinds if get(kind).lengths == 1]
    return _lengths(coordinates=len(lengths) < len(kinds), lengths=bool(lengths))


def _lengths(*, coordinates: bool, lengths: bool) -> str:
    """Coordinates, lengths, or both."""
    return " or ".join(["coordinate"] * coordinates + ["length"] * lengths) or "coordinate"


def error_title(used: NDArray[np.bool_]) -> str:
    """What the tables of errors in mm are of: an error of a distance is none of a position."""
    return title_of_errors(measured_lengths(used))


def title_of_errors(lengths: str) -> str:
    """The same, from what `measured_lengths` or `lengths_of_kinds` says."""
    return f"{lengths.replace('coordinate', 'position').capitalize()} error"


def error_rows(c: Calibration) -> list[tuple[str, Errors]]:
    """Label and errors of each row of the error tables: before and after, by set, and on left-out rows."""
    rows = [
        (f"{label} rows, {who}", c.errors[who][name])
        for name, label in (("estimation", "estimation"), ("validation", "validation"))
        for who in c.errors
    ]
    larger = None if c.larger is None else c.larger.cross_validation
    for who, v in (
        ("nominal", c.nominal_cross_validation),
        ("calibrated", c.cross_validation),
        ("larger", larger),
    ):
        if v is not None:
            rows.append((f"left-out rows*, {who}", v.errors))
            if c.outliers:
                rows.append(("  the same without outliers", v.errors_without_outliers))
    return rows


def left_out_text(c: Calibration) -> str:
    """What ``left-out rows*`` are; empty without cross-validation."""
    if c.cross_validation is None:
        return ""
    method = c.cross_validation.method
    return f"* {method}: {_LEFT_OUT.get(method, _TENTHS)}"


def weights_text(c: Calibration) -> str:
    """Whether the outliers count in the fit."""
    weights = dict(zip(c.rows.numbers, c.weights, strict=True))
    unused = not any(weights.get(o.row) for o in c.outliers)
    return "they have no weight in the fit" if unused else "they keep their weight in this fit"


def listed(outliers: Iterable[Outlier]) -> str:
    """Rows with residual and score; the first dozen."""
    every = list(outliers)
    text = "; ".join(
        f"row {o.row} ({1e3 * o.residual:.2f} mm, {o.score:.1f} sigma)" for o in every[:12]
    )
    return text + (f"; and {len(every) - 12} more" if len(every) > 12 else "")


def candidate_rms(one: Candidate) -> str:
    """Error of a candidate on left-out rows, outliers aside, with its unit."""
    errors = one.cross_validation.errors_without_outliers
    return f"{1e3 * errors.rms:.3f} mm" if errors.n else f"{np.degrees(errors.rms_angle):.4f} deg"


def correlation_text(c: Calibration) -> str:
    """The pairs of parameters that hang together most; empty if none do."""
    pairs = correlations(c, _WORTH_NAMING)[:_MOST_PAIRS]
    if not pairs:
        return ""
    named = ", ".join(f"{p.first} and {p.second} ({p.value:+.2f})" for p in pairs)
    return f"Known together better than apart (correlation): {named}."


def noise_text(c: Calibration) -> str:
    """The noise of one coordinate and one angle, and how it is known."""
    found = (
        f"found from what is left over ({c.freedom:.0f} d.o.f.)"
        if c.freedom >= _TELLING
        else "mostly assumed: too few rows to tell"
    )
    parts = [f"{1e3 * c.sigma:.3f} mm a {measured_lengths(c.used)}"] * bool(np.isfinite(c.sigma))
    parts += [f"{np.degrees(c.sigma_angle):.4f} deg about an axis"] * bool(
        np.isfinite(c.sigma_angle)
    )
    return f"Noise: {' and '.join(parts)}, {found}."


def repeats_text(c: Calibration) -> str:
    """How far repeats of a pose scatter; empty where nothing was repeated."""
    if c.repeats is None or not np.isfinite(c.repeats.within[0]):
        return ""
    scatter, freedom = 1e3 * float(c.repeats.within[0]), float(c.repeats.freedoms[0])
    return f"Repeats of a pose scatter by {scatter:.3f} mm a {measured_lengths(c.used)} ({freedom:.0f} d.o.f.)."


def expected_text(c: Calibration) -> str:
    """What the covariance promises."""
    return (
        f"Expected error, if the model is complete: {1e3 * c.expected_measured:.3f} mm rms at the measured poses, "
        f"{1e3 * c.expected_everywhere:.3f} mm over the joint limits."
    )


def sizes_text(c: Calibration) -> str:
    """The size of each family's errors; empty without priors."""
    sizes = [_size(family, size) for family, size in c.sizes.items()]
    if not sizes:
        return ""
    how = "found from the data" if c.sizes_from == "data" else "as given"
    return f"Size of the robot's errors: {', '.join(sizes)} ({how})."


def errorless(c: Calibration) -> frozenset[str]:
    """The parameters of families whose errors the data showed to be none: they stay nominal, and have no interval.

    Their prior's standard deviation went to nothing, which is no knowledge of them.
    """
    if c.sizes_from != "data":
        return frozenset()
    nothing = {f: _NOTHING / FAMILIES[f].unit.shown[0] for f in c.sizes}
    return frozenset(
        p.name
        for p, found in zip(c.model.parameters, c.parameters, strict=True)
        if p.family in nothing
        and c.sizes[p.family] <= nothing[p.family]
        # One with a prior of its own does not share the family's.
        and found.prior_std <= nothing[p.family]
    )


def rank_text(c: Calibration) -> str:
    """How many parameters the poses determine, and how well."""
    o = c.observability
    return f"Rank: {o.rank} of {o.columns} parameters, condition number {o.condition:.0f}."


def unidentifiable_text(c: Calibration) -> str:
    """What is said before the combinations that nothing determines; empty if there are none."""
    if not c.observability.unidentifiable:
        return ""
    held = ", so the priors share them out" if c.sizes else ""
    return f"These changes move nothing that was measured{held}:"


def shown_parameters(c: Calibration) -> list[ParameterEstimate]:
    """The parameters of the geometry that are listed.

    Frames and the targets' orientations are told as poses: their parameters count from where registration put them.
    """
    return [
        p
        for p, m in zip(c.parameters, c.model.parameters, strict=True)
        if m.family != FRAME and not (m.family == TARGET and m.unit == "rad")
    ]


def parameter_text(p: ParameterEstimate) -> ParameterText:
    """One parameter of the geometry."""
    scale, unit = (1e3, "mm") if p.unit == "m" else (float(np.degrees(1.0)), "deg")
    return ParameterText(
        name=p.name,
        nominal="-" if p.nominal is None else three(scale * p.nominal),
        value=three(scale * p.value),
        change="-" if p.nominal is None else three(scale * p.delta, "+"),
        half="at bound" if p.at_bound else f"{0.5 * scale * (p.high - p.low):.3g}",
        unit=unit,
        identifiable=p.identifiable,
        at_bound=p.at_bound,
    )


def larger_parameters(c: Calibration) -> Sequence[tuple[str, str, str, str]]:
    """Name, value, half the 95 % interval and unit of the larger model's parameters that the geometry lacks."""
    if c.larger is None:
        return []
    shown = [p for p in c.larger.parameters if p.name not in c.model.names]
    return [
        (
            p.name,
            three(unit_of(p.unit).shown[0] * p.value),
            "(at bound)"
            if p.at_bound
            else f"± {0.5 * unit_of(p.unit).shown[0] * (p.high - p.low):.3f}",
            unit_of(p.unit).shown[1],
        )
        for p in shown
    ]


def solver_text(c: Calibration) -> str:
    """How the solver fared, without the time that it took."""
    s = c.solution
    return f"Solver '{c.solver}': {s.status} after {s.iterations} iterations, {s.evaluations} evaluations"


def _size(family: str, size: float) -> str:
    """The size of a family's errors in words."""
    factor, unit = FAMILIES[family].unit.shown
    return f"{family} {factor * size:.3g} {unit}" if factor * size > _NOTHING else f"{family} none"
