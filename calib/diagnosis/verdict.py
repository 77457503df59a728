"""The verdict: whether the corrected robot should be used, and why, in codes and numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import stdtr

from calib.diagnosis.further_unknowns import PREDICTS
from calib.diagnosis.reasons import CARE, NO, USE, Reason, Verdict, Why
from calib.numerics.errors import CrossValidation, Errors
from calib.units import Array, Integers, Mask

#: Scalar measurements per parameter below which a fit leans on its priors.
_FEW = 2.0

#: Fewer poses than this predict each other too well by chance.
_HANDFUL = 8

#: Share of flagged rows above which these are no accidents.
_MANY_OUTLIERS = 0.15

#: Validation rows whose error is more than so many times that of held-out rows were measured differently.
_ANOTHER_MEASUREMENT = 10.0

#: Errors and noise above these are beyond any uncalibrated arm and any instrument: the set-up is wrong [m], [rad].
_ABSURD = 0.02
_ABSURD_ANGLE = 0.17

#: A change of a parameter above this is no error of an arm [m or rad].
_TOO_FAR = 0.1

#: A nominal robot is right to the noise where its error is below so many standard deviations, rms over all scalars.
_AT_THE_NOISE = 1.45

#: A gain whose p-value is above this may be chance.
_CHANCE = 0.03

#: Relative differences below this are rounding.
_ROUNDING = 1e-6

#: A gain is worth having where errors of held-out rows, and of validation rows, fall below this share.
_FALLS = 0.9

#: A gain is proven where no more than this share of the nominal error remains, on held-out rows, noise subtracted, and
#: in what is expected over the joint limits.
_REMAINS = 0.4

#: Errors of flagged rows are alike for the nominal and the calibrated robot within this factor.
_ALIKE = 1.1

#: Where another geometry would leave far less, a named one needs care if more than this share of the error remains.
_LACKING = 0.2

#: An expected error of more than so many times the nominal one is no robot's.
_FAR_MORE = 3.0

#: Another model whose error is less than this share has what this one lacks.
_FAR_LESS = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What the verdict is based on; N rows of up to D scalars [m], [rad].

    The nominal robot is cross-validated with frame and target fitted as for the calibrated one.
    """

    nominal: CrossValidation
    calibrated: CrossValidation
    scales: Array  # (N, D), the noise of each scalar
    used: Mask  # (N, D), which scalars were measured
    #: (N, D), the least noise of each scalar by any model tried, over ``scales``; what exceeds it is lack of model.
    floor: Array
    repeats: Integers  # (N,), rows of one number are repeats of one measurement
    pairs: Mask  # (N,), which rows hold the distance between two poses
    outliers: Mask  # (N,), flagged by the fit to all of them
    # Errors of nominal and calibrated robot on validation rows, and how many further rows were set aside as outliers
    validation: tuple[Errors, Errors, int]
    parameters: int
    changes: bool  # Whether any parameter of the robot has changed
    largest: float  # Largest change of a parameter of the robot in metres or radians [m or rad]
    noise: float  # Of one length [m]
    expected: float  # Error to expect of predictions over the joint limits, rms [m]
    expected_of_nominal: float  # The same of the nominal robot's [m]
    full_model_parameters: int = (
        0  # Parameters of a full geometry, where `auto` may have chosen a smaller one
    )
    doubts: tuple[Reason, ...] = ()  # What was found besides errors
    notes: tuple[Reason, ...] = ()  # Stated last, and decide nothing
    hint: Reason | None = None  # Which set-up would explain the measurements better
    # Of the URDF: name and held-out errors of the non-geometric model, if there is one
    non_geometric: tuple[str, Errors] | None = None

    def whitened(self, v: CrossValidation) -> Array:
        """The squared error of each row, in units of the noise, shape (N,)."""
        return np.asarray(np.sum(np.where(self.used, v.residual / self.scales, 0.0) ** 2, axis=1))

    def gain(self, *, of_all: bool = False) -> tuple[float, float]:
        """Mean fall of the squared error on held-out rows, outliers aside, in standard errors, and its p-value.

        With ``of_all`` the rows include outliers, and the fall is that of the error, not its square: an accident then
        changes it by no more than the correction there. Errors are paired by poses, of which repeats are averaged; the
        fall is 0 where nothing changes. The p-value is that of Student's t for no fall.
        """
        some, squares = (of_all | ~self.outliers) & np.any(self.used, axis=1), []
        for v in (self.nominal, self.calibrated):
            _, poses = np.unique(v.poses[some], return_inverse=True)
            counts = np.maximum(np.bincount(poses), 1)
            error = self.whitened(v)[some]
            squares.append(np.bincount(poses, np.sqrt(error) if of_all else error) / counts)
        fall = squares[0] - squares[1]
        mean = float(np.mean(fall)) if len(fall) else 0.0
        if not self.changes or abs(mean) < _ROUNDING * float(np.mean(squares[0])):
            return 0.0, 1.0
        if len(fall) < 2:
            return float(np.sign(mean)), 1.0
        gain = mean / max(float(np.std(fall, ddof=1)) / float(np.sqrt(len(fall))), 1e-30)
        return gain, float(stdtr(len(fall) - 1, -gain))

    @property
    def at_noise_level(self) -> bool:
        """Whether the nominal robot's error is about the noise that the best model leaves, outliers aside."""
        square, noise = self._squares(self.nominal)
        return bool(square < _AT_THE_NOISE**2 * noise)

    def _squares(self, v: CrossValidation) -> tuple[float, float]:
        """Mean whitened squared error of a scalar, outliers aside, and how much of it is noise."""
        good = ~self.outliers
        count = max(int(np.sum(self.used[good])), 1)
        noise = np.sum(np.where(self.used, self.floor, 0.0)[good] ** 2)
        return float(np.sum(self.whitened(v)[good]) / count), float(noise / count)

    @property
    def accidental(self) -> bool:
        """Whether flagged rows are no further off than with the nominal robot, and the error of all rows falls."""
        before, after = (
            np.sum(self.whitened(v)[self.outliers]) for v in (self.nominal, self.calibrated)
        )
        return bool(after < _ALIKE**2 * before and self.gain(of_all=True)[1] < _CHANCE)

    def remains_everywhere(self) -> float:
        """The share of the nominal robot's error over the joint limits that is expected to remain."""
        return self.expected / max(self.expected_of_nominal, self.expected, 1e-30)

    def remains_held_out(self) -> float:
        """The share of the nominal robot's error on held-out rows that remains, noise subtracted from both.

        The mean of M squared scalars of noise is uncertain by sqrt(2 / M), which is subtracted too.
        """
        (before, noise), (after, _) = map(self._squares, (self.nominal, self.calibrated))
        count = max(int(np.sum(self.used[~self.outliers])), 1)
        left = after - noise * (1.0 + np.sqrt(2.0 / count))
        return float(np.sqrt(max(left, 0.0) / max(before - noise, 1e-30)))


#: Doubts whether the residuals are the measurements' noise.
_NOT_NOISE = (Why.MODEL_LACKS, Why.NOISE_LARGE, Why.NOISE_ABOVE_SIGMA, Why.JOINTS_LAG)

#: What can be improved where the gain is proven, and is then no reason for care.
_REMAINING = (
    Why.MODEL_LACKS,
    Why.CORNER,
    Why.JOINT_PATTERN,
    Why.REPEATS_AGREE,
    Why.NO_LENGTH,
)

#: What is stated and decides nothing.
_INFORMATION = (Why.SCALE_HIDDEN,)

#: Doubts about what was given, which come before all others.
_GIVEN = (Why.TARGET_FAR, Why.BASE_MOVED)


@dataclass(frozen=True, slots=True)
class _Figures:
    """What the rules compare."""

    before: Errors  # Of the nominal robot on held-out rows, outliers aside
    after: Errors  # Of the calibrated one
    before_all: Errors  # Outliers too
    after_all: Errors
    fresh_before: Errors  # On validation rows
    fresh_after: Errors
    gain: float  # In standard errors
    unproven: bool  # Whether the gain may be chance
    handful: bool  # So few poses that held-out rows prove nothing
    few: bool  # Too few numbers for this model
    sparse: bool  # Too few for a full geometry
    flagged: int
    many: bool  # Whether more rows are flagged than can be accidents
    accidents: bool  # Whether these are accidents nonetheless
    plausible: bool  # Whether the noise may be the instrument's
    lost: bool  # Whether the error expected over the joint limits is several times the nominal one
    held_out: float  # Share of the error that remains on held-out rows
    everywhere: float  # And over the joint limits

    @classmethod
    def of(cls, e: Evidence) -> _Figures:
        """Work them out."""
        gain, chance = e.gain()
        size, flagged = _size(e), int(np.sum(e.outliers))
        numbers = size["numbers"]
        before = e.nominal.errors_without_outliers
        many = flagged > _MANY_OUTLIERS * len(e.outliers)
        return cls(
            before=before,
            after=e.calibrated.errors_without_outliers,
            before_all=e.nominal.errors,
            after_all=e.calibrated.errors,
            fresh_before=e.validation[0],
            fresh_after=e.validation[1],
            gain=gain,
            unproven=gain <= 0.0 or chance > _CHANCE,
            handful=size["poses"] + size["pairs"] < _HANDFUL,
            few=numbers < _FEW * e.parameters,
            sparse=numbers < _FEW * max(e.parameters, e.full_model_parameters),
            flagged=flagged,
            many=many,
            accidents=many and e.accidental,
            # Residuals are noise only if a non-geometric model does not leave far less.
            plausible=not many and not any(doubt.why in _NOT_NOISE for doubt in e.doubts),
            lost=e.expected > _FAR_MORE * _typical(before),
            held_out=e.remains_held_out(),
            everywhere=e.remains_everywhere(),
        )

    @property
    def fresh_falls(self) -> bool:
        """Whether the error on validation rows falls at all."""
        return self.fresh_after.rms < (1.0 - _ROUNDING) * self.fresh_before.rms

    @property
    def fresh_falls_little(self) -> bool:
        """Whether it falls, and by next to nothing."""
        return self.fresh_falls and self.fresh_after.rms > _FALLS * self.fresh_before.rms

    @property
    def proven_here(self) -> bool:
        """Whether unseen rows prove a gain that is worth having where they were measured."""
        falls = _typical(self.after) < _FALLS * _typical(self.before)
        little = self.held_out <= _REMAINS
        return falls and little and not self.unproven and not self.fresh_falls_little

    @property
    def proven(self) -> bool:
        """Whether the gain is proven where rows were measured, and expected over the joint limits."""
        return self.proven_here and self.everywhere <= _REMAINS and not self.handful


def verdict(e: Evidence) -> Verdict:
    """Judge a calibration by its errors on rows that it did not see."""
    if wrong := _absurd(e):
        return Verdict(NO, (wrong[0],))  # nothing else about such a fit means anything
    f = _Figures.of(e)
    against = _against(e, f)
    careful, remaining = _careful(e, f, against), _remaining(e, f, against)
    if not f.proven and not against:
        careful += remaining
        remaining = []
        careful = careful or [Reason.of(Why.SMALL_GAIN, **_elsewhere(e, f))]
    use = NO if against else CARE if careful else USE
    information = [doubt for doubt in e.doubts if not _matters(doubt)]
    return Verdict(use, (*against, *careful, *_gains(e, f), *remaining, *information, *e.notes))


def _against(e: Evidence, f: _Figures) -> list[Reason]:
    """Why the corrected robot is not to be used: the weightiest reason, and failing validation rows."""
    both = _both(e, f)
    nothing = f.unproven and e.at_noise_level and f.plausible and not f.sparse
    too_few = f.unproven and (f.handful or f.few or (e.at_noise_level and f.sparse))
    worse = bool(f.flagged) and _typical(f.after_all) > _ALIKE * _typical(f.before_all)
    size = {**_size(e), "parameters": max(e.parameters, e.full_model_parameters), "gain": f.gain}
    unfit = bool(f.fresh_after.n) and not f.fresh_falls
    here_only = f.proven_here and e.expected < _ABSURD
    lost = f.lost and f.everywhere > _REMAINS and not here_only
    first = _applicable(
        (nothing, Reason.of(Why.NOTHING_TO_GAIN, before=f.before)),
        (f.after.rms > _ABSURD, Reason.of(Why.STILL_FAR_OFF, **both)),
        (f.unproven and _has_better(e, f), _better(Why.NO_URDF_HOLDS, e, f)),
        (too_few, Reason.of(Why.TOO_FEW, **both | size)),
        (f.gain <= 0.0, Reason.of(Why.NO_BETTER, **both)),
        (worse, replace(_of_many(e, f), why=Why.WORSE_WITH_OUTLIERS)),
        (f.unproven and f.many and not f.accidents, _of_many(e, f)),
        (lost, Reason.of(Why.UNKNOWN_ELSEWHERE, **_elsewhere(e, f))),
    )[:1]
    return first + _applicable((unfit, Reason.of(Why.VALIDATION_NO_BETTER, **_of_fresh(e, f))))


def _careful(e: Evidence, f: _Figures, against: list[Reason]) -> list[Reason]:
    """Why it is to be used with care, what was given first."""
    doubts = [doubt for doubt in e.doubts if not _remains(doubt, f) and _matters(doubt)]
    given = [doubt for doubt in doubts if doubt.why in _GIVEN]
    much = not f.unproven and f.held_out > _REMAINS and not against
    unlike = bool(f.fresh_after.n) and f.fresh_after.rms > _ANOTHER_MEASUREMENT * f.after.rms > 0.0
    of_unlike = {"rows": f.fresh_after.n, "before": f.fresh_after, "after": f.after}
    many = f.many and not f.accidents and _of_many(e, f) not in against
    return [
        *given,
        *_applicable(
            (much, _better(Why.MUCH_REMAINS, e, f)),
            (
                f.gain > 0.0 and f.unproven and not against,
                Reason.of(Why.MAY_BE_CHANCE, gain=f.gain),
            ),
            (f.before.rms > _ABSURD, Reason.of(Why.FAR_OFF_BEFORE, before=f.before)),
            (f.lost and not against, Reason.of(Why.UNKNOWN_ELSEWHERE, **_elsewhere(e, f))),
            (
                f.fresh_falls_little and not against,
                Reason.of(Why.VALIDATION_SMALL_GAIN, **_of_fresh(e, f)),
            ),
        ),
        *(doubt for doubt in doubts if doubt.why not in _GIVEN),
        *_applicable(
            (e.largest > _TOO_FAR, Reason.of(Why.PARAMETER_FAR, largest=e.largest)),
            (unlike, Reason.of(Why.VALIDATION_UNLIKE, **of_unlike)),
            (many, _of_many(e, f)),
        ),
    ]


def _remaining(e: Evidence, f: _Figures, against: list[Reason]) -> list[Reason]:
    """What is left to improve where unseen rows prove the gain."""
    fewer = Reason.of(Why.FEW_NUMBERS, **_size(e), parameters=e.parameters)
    few = f.few or f.handful
    first = _applicable((few and not against, fewer), (f.accidents, _of_many(e, f)))
    return first + [doubt for doubt in e.doubts if _remains(doubt, f)]


def _remains(doubt: Reason, f: _Figures) -> bool:
    """Whether a doubt says what is left to improve, where the gain is proven."""
    lacking = doubt.why == Why.MODEL_LACKS and "+" not in doubt.values["non_geometric"]
    return doubt.why in _REMAINING and not (lacking and f.held_out > _LACKING)


def _gains(e: Evidence, f: _Figures) -> list[Reason]:
    """What the correction gains."""
    fresh = bool(f.fresh_after.n) and f.fresh_falls and not f.fresh_falls_little
    return _applicable(
        (f.gain > 0.0, Reason.of(Why.GAIN, **_both(e, f), outliers=f.flagged)),
        (fresh, Reason.of(Why.VALIDATION_GAIN, **_of_fresh(e, f))),
    )


def _both(e: Evidence, f: _Figures) -> dict[str, Any]:
    """Errors on held-out rows, and how these were held out."""
    return {"before": f.before, "after": f.after, "method": e.calibrated.method}


def _of_fresh(e: Evidence, f: _Figures) -> dict[str, Any]:
    """Errors on validation rows."""
    aside = e.validation[2]
    return {
        "rows": f.fresh_after.n,
        "aside": aside,
        "before": f.fresh_before,
        "after": f.fresh_after,
    }


def _of_many(e: Evidence, f: _Figures) -> Reason:
    """How many rows are flagged, and the errors with them."""
    rows = {"flagged": f.flagged, "rows": len(e.outliers)}
    return Reason.of(Why.MANY_OUTLIERS, **rows, before=f.before_all, after=f.after_all)


def _elsewhere(e: Evidence, f: _Figures) -> dict[str, float]:
    """What is to be expected over the joint limits."""
    return {"expected_m": e.expected, "remains": f.everywhere}


def _has_better(e: Evidence, f: _Figures) -> bool:
    """Whether the non-geometric model has far smaller errors on held-out rows."""
    if e.non_geometric is None:
        return False
    return _typical(e.non_geometric[1]) < _FAR_LESS * _typical(f.after)


def _better(why: Why, e: Evidence, f: _Figures) -> Reason:
    """What remains, and what the non-geometric model would leave, if that is far less."""
    values: dict[str, Any] = {**_both(e, f), "remains": f.held_out}
    if _has_better(e, f) and e.non_geometric is not None:
        model, less = e.non_geometric
        values |= {"model": model, "less": less}
    return Reason.of(why, **values)


def _matters(doubt: Reason) -> bool:
    """Whether a doubt counts: a drift or a step that does not predict held-out rows is information."""
    return doubt.why not in _INFORMATION and bool(doubt.values.get("falls", 1.0) >= PREDICTS)


def _absurd(e: Evidence) -> list[Reason]:
    """Another set-up that explains the rows, or errors that no arm has."""
    before, after = e.nominal.errors_without_outliers, e.calibrated.errors_without_outliers
    turned = bool(after.n_angle) and after.rms_angle > _ABSURD_ANGLE
    far = before.rms > _ABSURD and e.largest > _TOO_FAR
    return ([e.hint] if e.hint else []) + _applicable(
        (far, Reason.of(Why.PARAMETER_ABSURD, before=before, largest=e.largest)),
        (e.noise > _ABSURD, Reason.of(Why.NOISE_ABSURD, noise_m=e.noise)),
        (turned, Reason.of(Why.ORIENTATION_ABSURD, after=after)),
    )


def _typical(errors: Errors) -> float:
    """Rms of lengths, or of angles where no length was measured."""
    return errors.rms if errors.n else errors.rms_angle


def _applicable(*rules: tuple[bool, Reason]) -> list[Reason]:
    """The reasons whose condition holds, in their order."""
    return [reason for holds, reason in rules if holds]


def _size(e: Evidence) -> dict[str, int]:
    """Numbers of different poses, of pairs of poses, and of scalars measured there, repeats counted once."""
    single = np.any(e.used, axis=1) & ~e.pairs
    first = np.unique(e.repeats, return_index=True)[1]
    return {
        "poses": len(np.unique(e.repeats[single])),
        "pairs": len(np.unique(e.repeats[e.pairs])),
        "numbers": int(np.sum(e.used[first])),
    }
