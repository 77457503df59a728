"""The verdict: whether the corrected robot should be used, and why, in codes and numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.basics.arrays import Mask
from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.values import ReadOnlyMapping
from calib.diagnosis.evidence import ALIKE, CHANCE, ROUNDING, Evidence
from calib.diagnosis.further_unknowns import PREDICTS
from calib.diagnosis.reasons import (
    CARE,
    GIVEN,
    INFORMATION,
    NO,
    NOT_NOISE,
    NOT_SEEN,
    REMAINING,
    USE,
    WRONG_INPUT,
    Reason,
    Verdict,
    Why,
)
from calib.numerics.errors import Errors

#: Units with rules of their own.
_LENGTH, _ANGLE = RESIDUAL_UNITS["m"], RESIDUAL_UNITS["rad"]

#: Scalar measurements per parameter below which a fit relies on its priors.
_FEW = 2.0

#: Numbers of a pose, which is what the corners of an image tell of the robot.
_OF_POSE = 6

#: Fewer poses than this predict each other too well by chance.
_HANDFUL = 8

#: Share of flagged rows above which these are no accidents.
_MANY_OUTLIERS = 0.15

#: Validation rows whose error is more than so many times that of held-out rows were measured differently.
_ANOTHER_MEASUREMENT = 10.0

#: A focal length, or a board, that is off by a larger share is another one: lenses are off by 1 to 3 %, prints by 0.3
#: to 1 %.
_OTHER_SHARE = ReadOnlyMapping({Why.FOCAL_LENGTH_OFF: 0.1, Why.BOARD_SCALE_OFF: 0.02})

#: A change of a parameter above this is no error of an arm [m or rad].
_TOO_FAR = 0.1

#: A gain is worth having where errors of held-out rows, and of validation rows, fall below this share.
_FALLS = 0.9

#: A gain is proven where no more than this share of the nominal error remains, on held-out rows, noise subtracted, and
#: in what is expected over the joint limits.
_REMAINS = 0.4

#: Where another geometry would leave far less, a named one needs care if more than this share of the error remains.
_LACKING = 0.2

#: An expected error of more than so many times the nominal one is no robot's.
_FAR_MORE = 3.0

#: Another model whose error is less than this share represents errors that this one lacks.
_FAR_LESS = 0.6


@dataclass(frozen=True, slots=True)
class _Figures:
    """Figures that the rules compare."""

    #: Of the nominal robot on held-out rows, outliers aside
    before: Errors
    #: Of the calibrated one
    after: Errors
    #: Of the nominal robot, outliers too
    before_all: Errors
    #: Of the calibrated one, outliers too
    after_all: Errors
    #: Of the nominal robot on validation rows
    validation_before: Errors
    #: Of the calibrated one
    validation_after: Errors
    #: Fall of the squared error on held-out rows, in standard errors
    gain: float
    #: Whether the gain may be chance
    unproven: bool
    #: So few poses that held-out rows prove nothing
    handful: bool
    #: Too few numbers for this model
    few: bool
    #: Too few for a full geometry
    few_for_full_model: bool
    #: Number of flagged rows
    flagged: int
    #: Whether more rows are flagged than can be accidents
    many: bool
    #: Whether these are accidents nonetheless
    accidents: bool
    #: Whether the noise may be the instrument's
    plausible: bool
    #: Whether the error expected over the joint limits is several times the nominal one
    unpredictable: bool
    #: Share of the error that remains on held-out rows
    held_out: float
    #: Share of the error that is expected to remain over the joint limits
    everywhere: float

    @classmethod
    def of(cls, e: Evidence) -> _Figures:
        """Work out the figures that the rules compare.

        Args:
            e: The figures of the corrected URDF, or of the non-geometric model.
        """
        gain, chance = e.gain()
        size, flagged = _size(e), int(np.sum(e.outliers))
        before = e.nominal.errors_without_outliers
        many = flagged > _MANY_OUTLIERS * len(e.outliers)
        # Residuals are noise only if a non-geometric model does not leave far less.
        not_noise = any(doubt.why in NOT_NOISE for doubt in e.doubts)
        full = max(e.parameters, e.full_model_parameters)
        return cls(
            before=before,
            after=e.calibrated.errors_without_outliers,
            before_all=e.nominal.errors,
            after_all=e.calibrated.errors,
            validation_before=e.validation[0],
            validation_after=e.validation[1],
            gain=gain,
            unproven=gain <= 0.0 or chance > CHANCE,
            handful=size["poses"] + size["pairs"] < _HANDFUL,
            few=size["numbers"] < _FEW * e.parameters,
            few_for_full_model=size["numbers"] < _FEW * full,
            flagged=flagged,
            many=many,
            accidents=many and e.accidental,
            plausible=not many and not not_noise,
            unpredictable=e.expected > _FAR_MORE * _typical(before),
            held_out=e.remains_held_out(),
            everywhere=e.remains_everywhere(),
        )

    @property
    def validated(self) -> bool:
        """True if there are validation rows."""
        return bool(self.validation_after.leading.n)

    @property
    def validation_falls(self) -> bool:
        """True if the error on validation rows falls at all."""
        return _typical(self.validation_after) < (1.0 - ROUNDING) * _typical(self.validation_before)

    @property
    def validation_falls_little(self) -> bool:
        """True if the error on validation rows falls, but by next to nothing."""
        little = _typical(self.validation_after) > _FALLS * _typical(self.validation_before)
        return self.validation_falls and little

    @property
    def proven_where_measured(self) -> bool:
        """True if held-out rows prove a gain that is worth having where they were measured."""
        falls = _typical(self.after) < _FALLS * _typical(self.before)
        little_remains = self.held_out <= _REMAINS
        return falls and little_remains and not self.unproven and not self.validation_falls_little

    @property
    def proven(self) -> bool:
        """True if the gain is proven where rows were measured, and expected over the joint limits."""
        return self.proven_where_measured and self.everywhere <= _REMAINS and not self.handful


def verdict(e: Evidence) -> Verdict:
    """Judge a calibration by its errors on held-out rows.

    Args:
        e: The figures of the corrected URDF, or of the non-geometric model.

    Returns:
        ``use``, ``use with care`` or ``do not use``, with the reasons: against it, for care, gains, remaining
        weaknesses, information.
    """
    absurd = _absurd(e)
    if absurd:
        # Nothing else about such a fit means anything.
        return Verdict(NO, (absurd[0],))
    f = _Figures.of(e)
    against = _against(e, f)
    careful = _careful(e, f, against)
    remaining = _remaining(e, f, against)
    if not f.proven and not against:
        careful += remaining
        remaining = []
        careful = careful or [Reason.of(Why.SMALL_GAIN, **_over_limits(e, f))]
    use = USE
    if careful:
        use = CARE
    if against:
        use = NO
    gains = _gains(e, f)
    information = [doubt for doubt in e.doubts if not _matters(doubt)]
    return Verdict(use, (*against, *careful, *gains, *remaining, *information, *e.notes))


def _against(e: Evidence, f: _Figures) -> list[Reason]:
    """Reasons not to use the corrected robot: the weightiest one, and failing validation rows."""
    both = _both(e, f)
    sufficient = f.plausible and not f.few_for_full_model
    nothing = f.unproven and e.at_noise_level and sufficient
    too_few = f.handful or f.few or (e.at_noise_level and f.few_for_full_model)
    worse = bool(f.flagged) and _typical(f.after_all) > ALIKE * _typical(f.before_all)
    parameters = max(e.parameters, e.full_model_parameters)
    size = {**_size(e), "parameters": parameters, "gain": f.gain}
    good_where_measured = f.proven_where_measured and e.expected < _LENGTH.absurd
    elsewhere = f.unpredictable and f.everywhere > _REMAINS and not good_where_measured
    first = _applicable(
        (nothing, Reason.of(Why.NOTHING_TO_GAIN, before=f.before)),
        (_is_absurd(f.after), Reason.of(Why.STILL_FAR_OFF, **both)),
        (f.unproven and _has_better(e, f), _better(Why.NO_URDF_HOLDS, e, f)),
        (f.unproven and too_few, Reason.of(Why.TOO_FEW, **both | size)),
        (f.gain <= 0.0, Reason.of(Why.NO_BETTER, **both)),
        (worse, replace(_many_outliers(e, f), why=Why.WORSE_WITH_OUTLIERS)),
        (f.unproven and f.many and not f.accidents, _many_outliers(e, f)),
        (elsewhere, Reason.of(Why.UNKNOWN_ELSEWHERE, **_over_limits(e, f))),
    )[:1]
    wrong = [doubt for doubt in e.doubts if _is_wrong_input(doubt)]
    fails = f.validated and not f.validation_falls
    no_better = Reason.of(Why.VALIDATION_NO_BETTER, **_on_validation(e, f))
    return [*wrong, *first, *_applicable((fails, no_better))]


def _careful(e: Evidence, f: _Figures, against: list[Reason]) -> list[Reason]:
    """Reasons for care, doubts about given values first; ``against`` are those not to use it at all."""
    doubts = [
        doubt
        for doubt in e.doubts
        if not _improvable(doubt, f) and _matters(doubt) and not _is_wrong_input(doubt)
    ]
    given = [doubt for doubt in doubts if doubt.why in GIVEN]
    others = [doubt for doubt in doubts if doubt.why not in GIVEN]
    of_gain = _careful_of_gain(e, f, against)
    of_rows = _careful_of_rows(e, f, against)
    return [*given, *of_gain, *others, *of_rows]


def _careful_of_gain(e: Evidence, f: _Figures, against: list[Reason]) -> list[Reason]:
    """Reasons for care about the gain itself."""
    usable = not against
    much = not f.unproven and f.held_out > _REMAINS
    may_be_chance = f.gain > 0.0 and f.unproven
    unknown = Reason.of(Why.UNKNOWN_ELSEWHERE, **_over_limits(e, f))
    small = Reason.of(Why.VALIDATION_SMALL_GAIN, **_on_validation(e, f))
    return _applicable(
        (usable and much, _better(Why.MUCH_REMAINS, e, f)),
        (usable and may_be_chance, Reason.of(Why.MAY_BE_CHANCE, gain=f.gain)),
        (_is_absurd(f.before), Reason.of(Why.FAR_OFF_BEFORE, before=f.before)),
        (usable and f.unpredictable, unknown),
        (usable and f.validation_falls_little, small),
    )


def _careful_of_rows(e: Evidence, f: _Figures, against: list[Reason]) -> list[Reason]:
    """Reasons for care about parameters, validation rows and outliers."""
    after, held_out = f.validation_after, f.after
    far_more = _typical(after) > _ANOTHER_MEASUREMENT * _typical(held_out) > 0.0
    unlike = f.validated and far_more
    different = Reason.of(Why.VALIDATION_UNLIKE, rows=after.leading.n, before=after, after=held_out)
    outliers = _many_outliers(e, f)
    many = f.many and not f.accidents and outliers not in against
    return _applicable(
        (e.largest > _TOO_FAR, Reason.of(Why.PARAMETER_FAR, largest=e.largest)),
        (unlike, different),
        (many, outliers),
    )


def _remaining(e: Evidence, f: _Figures, against: list[Reason]) -> list[Reason]:
    """Reasons that say what to improve, and do not ask for care where held-out rows prove the gain."""
    fewer = Reason.of(Why.FEW_NUMBERS, **_size(e), parameters=e.parameters)
    few = (f.few or f.handful) and not against
    too_rough = f.before.leading.unit == "px" and any(r.why in NOT_SEEN for r in against)
    first = _applicable(
        (few, fewer),
        (f.accidents, _many_outliers(e, f)),
        (too_rough, Reason.of(Why.CAMERA_TOO_ROUGH)),
    )
    return first + [doubt for doubt in e.doubts if _improvable(doubt, f)]


def _is_wrong_input(doubt: Reason) -> bool:
    """Tell whether a doubt is that the input is wrong, so that a result is, however well it fits.

    A focal length or a board that is a little off is a doubt about a given value; one that is far off is another
    camera, resolution or board, or a square that was not measured.
    """
    if doubt.why in _OTHER_SHARE:
        return abs(float(doubt.values["share"])) > _OTHER_SHARE[doubt.why]
    return doubt.why in WRONG_INPUT


def _improvable(doubt: Reason, f: _Figures) -> bool:
    """Tell whether a doubt is no reason for care where the gain is proven.

    A geometry that the model lacks is one if too much of the error remains.
    """
    if doubt.why == Why.MODEL_LACKS and "+" not in doubt.values["non_geometric"]:
        return f.held_out <= _LACKING
    return doubt.why in REMAINING


def _gains(e: Evidence, f: _Figures) -> list[Reason]:
    """Reasons that state the gain, on held-out and on validation rows."""
    on_validation = f.validated and f.validation_falls and not f.validation_falls_little
    return _applicable(
        (f.gain > 0.0, Reason.of(Why.GAIN, **_both(e, f), outliers=f.flagged)),
        (on_validation, Reason.of(Why.VALIDATION_GAIN, **_on_validation(e, f))),
    )


def _both(e: Evidence, f: _Figures) -> dict[str, Any]:
    """Errors of both robots on held-out rows, and the method of cross-validation."""
    return {"before": f.before, "after": f.after, "method": e.calibrated.method}


def _on_validation(e: Evidence, f: _Figures) -> dict[str, Any]:
    """Errors of both robots on validation rows, and how many of these rows were set aside."""
    return {
        "rows": f.validation_after.leading.n,
        "aside": e.validation[2],
        "before": f.validation_before,
        "after": f.validation_after,
        "whole": e.validation_with_suspects,
    }


def _many_outliers(e: Evidence, f: _Figures) -> Reason:
    """Make the reason that many rows are flagged, with the errors that include them."""
    rows = {"flagged": f.flagged, "rows": len(e.outliers)}
    return Reason.of(Why.MANY_OUTLIERS, **rows, before=f.before_all, after=f.after_all)


def _over_limits(e: Evidence, f: _Figures) -> dict[str, float]:
    """Expected error over the joint limits [m], and its share of the nominal robot's."""
    return {"expected_m": e.expected, "remains": f.everywhere}


def _has_better(e: Evidence, f: _Figures) -> bool:
    """Tell whether the non-geometric model has far smaller errors on held-out rows."""
    if e.non_geometric is None:
        return False
    return _typical(e.non_geometric[1]) < _FAR_LESS * _typical(f.after)


def _better(why: Why, e: Evidence, f: _Figures) -> Reason:
    """Make a reason with the remaining error, and that of the non-geometric model if it is far less."""
    values: dict[str, Any] = {**_both(e, f), "remains": f.held_out}
    if _has_better(e, f) and e.non_geometric is not None:
        model, less = e.non_geometric
        values |= {"model": model, "less": less}
    return Reason.of(why, **values)


def _matters(doubt: Reason) -> bool:
    """Tell whether a doubt counts: a drift or a step that does not predict held-out rows is information."""
    if doubt.why in INFORMATION:
        return False
    falls = doubt.values.get("falls", 1.0)
    return bool(falls >= PREDICTS)


def _absurd(e: Evidence) -> list[Reason]:
    """Reasons why the input must be wrong: errors that no arm has."""
    before = e.nominal.errors_without_outliers
    after = e.calibrated.errors_without_outliers
    far = _is_absurd(before) and e.largest > _TOO_FAR
    noisy = {f"noise_{unit}": std for unit, std in e.noise.items() if _exceeds(std, unit)}
    turned = after[_ANGLE.symbol].rms > _ANGLE.absurd
    return _applicable(
        (far, Reason.of(Why.PARAMETER_ABSURD, before=before, largest=e.largest)),
        (bool(noisy), Reason.of(Why.NOISE_ABSURD, **noisy)),
        (turned, Reason.of(Why.ORIENTATION_ABSURD, after=after)),
    )


def _is_absurd(errors: Errors) -> bool:
    """Tell whether errors are beyond any uncalibrated arm, in a unit other than of orientations."""
    return any(_exceeds(errors[unit].rms, unit) for unit in errors.units)


def _exceeds(value: float, unit: str) -> bool:
    """Tell whether an error or noise is beyond any arm and instrument; orientations have a rule of their own."""
    return unit != _ANGLE.symbol and value > RESIDUAL_UNITS[unit].absurd


def _typical(errors: Errors) -> float:
    """Root mean square in the first unit that was measured: of lengths [m], if there are any."""
    return errors.leading.rms


def _applicable(*rules: tuple[bool, Reason]) -> list[Reason]:
    """List the reasons whose condition holds, in their order."""
    return [reason for holds, reason in rules if holds]


def _size(e: Evidence) -> dict[str, int]:
    """Count different poses, pairs of poses, images, and scalars measured there, repeats once."""
    single = np.any(e.used, axis=1) & ~e.pairs
    images = np.zeros(len(e.repeats), dtype=bool) if e.images is None else e.images
    size = {
        "poses": len(np.unique(e.repeats[single])),
        "pairs": len(np.unique(e.repeats[e.pairs])),
        "numbers": _numbers(e, images),
    }
    if np.any(images):
        size["images"] = len(np.unique(e.repeats[images]))
    return size


def _numbers(e: Evidence, images: Mask) -> int:
    """Count the scalars that tell of the robot, repeats once: of an image no more than the board's pose has."""
    _, first, measurement = np.unique(e.repeats, return_index=True, return_inverse=True)
    of_first = np.sum(e.used[first], axis=1)
    of_all = np.bincount(measurement, np.sum(e.used, axis=1))
    of_image = np.minimum(of_all, _OF_POSE)
    return int(np.sum(np.where(images[first], of_image, of_first)))
