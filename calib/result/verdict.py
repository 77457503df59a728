"""The verdict: whether the corrected robot should be used, and why, in codes and numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np
from scipy.special import stdtr

from calib.estimate.statistics import CrossValidation, Errors
from calib.units import Array, Integers, Mask

USE, CARE, NO = "use", "use with care", "do not use"

#: Scalar measurements for each parameter below which a fit leans on its priors; a share of flagged rows above which
#: they are no accident; validation rows so many times as far off as left-out rows were not measured like them.
_FEW, _MANY_OUTLIERS, _ANOTHER_MEASUREMENT = 2.0, 0.15, 10.0

#: Errors and noise beyond these are no uncalibrated arm's and no instrument's: the set-up is wrong [m], [rad]; and a
#: change of a parameter beyond the third is no error of an arm [m or rad].
_ABSURD, _ABSURD_ANGLE, _TOO_FAR = 0.02, 0.17, 0.1

#: A nominal error below this many standard deviations, rms over all scalars, is that of a robot that is right; a gain
#: that chance gives with this probability may be chance; relative differences below the third are rounding.
_AT_THE_NOISE, _CHANCE, _ROUNDING = 1.45, 0.03, 1e-6

#: A gain is proven where errors on left-out rows fall to this share of the nominal ones, and where no more than the
#: second of the nominal errors over the joint limits is expected to remain. Errors of all rows, outliers too, differ by
#: less than the third where the outliers are accidents; an expected error so many times the nominal one is no robot's.
_FALLS, _REMAINS, _ALIKE, _FAR_MORE = 0.9, 0.4, 1.1, 3.0


class Why(Enum):
    """The codes; `calib.text.verdict.SENTENCES` has what each says."""

    # Another set-up explains the rows
    TARGET_ELSEWHERE, WRONG_UNIT, OTHER_BASE, OWN_FRAME, JOINTS_TURNED = range(5)
    JOINT_ZERO, COLUMNS_SWAPPED, SIGN_TURNED, POINTS_MIRRORED = range(5, 9)
    POSES_INVERSE, COLUMNS_REVERSED, ROWS_SHIFTED, OTHER_TIP = range(80, 84)
    JOINT_CONSTANT, SCALAR_ELSEWHERE, ORIENTATIONS_INVERSE = range(84, 87)
    # No arm has such errors
    PARAMETER_ABSURD, NOISE_ABSURD, ORIENTATION_ABSURD = range(10, 13)
    # It is no better
    NOTHING_TO_GAIN, STILL_FAR_OFF, TOO_FEW, NO_BETTER, VALIDATION_NO_BETTER = range(20, 25)
    WORSE_WITH_OUTLIERS, UNKNOWN_ELSEWHERE = range(25, 27)
    # Care is needed
    MAY_BE_CHANCE, FEW_NUMBERS, FAR_OFF_BEFORE, JOINTS_STILL, MODEL_LACKS = range(30, 35)
    CORNER, JOINT_PATTERN, DRIFT, SETUP_UNPREDICTED, SETUP_FLAGGED = range(35, 40)
    REPEATS_AGREE, NO_LENGTH, PARAMETER_FAR, VALIDATION_UNLIKE, MANY_OUTLIERS = range(40, 45)
    NOISE_LARGE, NOISE_ABOVE_SIGMA, JOINTS_COARSE, TARGET_STEP = range(45, 49)
    LENGTHS_SCALED, COMPLIANCE_NEGATIVE, SMALL_GAIN = range(49, 52)
    # What it buys
    GAIN, LARGER_MODEL, VALIDATION_GAIN, OUTSIDE, LARGER_NO_CLOSER, ROWS_COPIED = range(60, 66)
    # What explains fresh rows
    FRAME_MOVED, TARGET_MOVED = range(70, 72)


@dataclass(frozen=True, slots=True)
class Reason:
    """One reason of a verdict."""

    why: Why  # What it is
    values: Mapping[str, Any]  # The numbers and names that it rests on, in SI units

    @classmethod
    def of(cls, why: Why, **values: Any) -> Reason:  # noqa: ANN401
        """With the rms of `Errors` as ``before_m`` and ``before_rad``, as far as they were measured."""
        found: dict[str, Any] = {}
        for name, value in values.items():
            if isinstance(value, Errors):
                found |= {f"{name}_m": value.rms} if value.n else {}
                found |= {f"{name}_rad": value.rms_angle} if value.n_angle else {}
            else:
                found[name] = value
        return cls(why, found)

    @property
    def code(self) -> str:
        """The code in small letters, as the result file has it: ``"nothing_to_gain"``."""
        return self.why.name.lower()


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether to use the corrected robot."""

    use: str  # ``"use"``, ``"use with care"`` or ``"do not use"``
    reasons: tuple[Reason, ...]  # The weightiest first


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What the verdict is based on; N rows of up to D scalars [m], [rad].

    The nominal robot is cross-validated with frame and target fitted as for the calibrated one.
    """

    nominal: CrossValidation
    calibrated: CrossValidation
    scales: Array  # (N, D), the noise of each scalar
    used: Mask  # (N, D), which scalars were measured
    repeats: Integers  # (N,), rows of one number are repeats of one measurement
    pairs: Mask  # (N,), which rows hold the distance between two poses
    outliers: Mask  # (N,), flagged by the fit to all of them
    # On validation rows: of the nominal and the calibrated robot, and how many more rows were left out as accidents
    validation: tuple[Errors, Errors, int]
    parameters: int
    largest: float  # Change of a parameter of the robot [m or rad]
    noise: float  # Of one length [m]
    expected: float  # Standard deviation of its predictions over the joint limits, rms [m]
    moved: float  # How far they are from the nominal robot's, rms [m]
    whole: int = 0  # Parameters of a full geometry, where `auto` may have taken less
    doubts: tuple[Reason, ...] = ()  # What was found besides errors
    notes: tuple[Reason, ...] = ()  # Told in the end, and decide nothing
    hint: Reason | None = None  # Which set-up would explain the measurements better

    def whitened(self, v: CrossValidation) -> Array:
        """The squared error of each row, in units of the noise, shape (N,)."""
        return np.asarray(np.sum(np.where(self.used, v.residual / self.scales, 0.0) ** 2, axis=1))

    def gain(self, *, of_all: bool = False) -> tuple[float, float]:
        """Mean fall of the squared error on left-out rows, outliers aside, in standard errors; and its chance.

        Of all rows that of the error itself, to which an accident adds no more than the correction is there. Paired by
        poses, and repeats do not count as evidence of their own; 0 where nothing changes. The chance is that of as
        large a mean by Student's t where there is no fall.
        """
        some, squares = (of_all | ~self.outliers) & np.any(self.used, axis=1), []
        for v in (self.nominal, self.calibrated):
            _, poses = np.unique(v.poses[some], return_inverse=True)
            counts = np.maximum(np.bincount(poses), 1)
            error = self.whitened(v)[some]
            squares.append(np.bincount(poses, np.sqrt(error) if of_all else error) / counts)
        fall = squares[0] - squares[1]
        mean = float(np.mean(fall)) if len(fall) else 0.0
        if not self.largest or abs(mean) < _ROUNDING * float(np.mean(squares[0])):
            return 0.0, 1.0
        if len(fall) < 2:
            return float(np.sign(mean)), 1.0
        gain = mean / max(float(np.std(fall, ddof=1)) / float(np.sqrt(len(fall))), 1e-30)
        return gain, float(stdtr(len(fall) - 1, -gain))

    @property
    def quiet(self) -> bool:
        """Whether the nominal robot is as far off as its noise, outliers aside."""
        good = ~self.outliers
        square = np.sum(self.whitened(self.nominal)[good]) / max(int(np.sum(self.used[good])), 1)
        return bool(np.sqrt(square) < _AT_THE_NOISE)

    @property
    def accidental(self) -> bool:
        """Whether flagged rows are as far off the nominal robot, and the error of all rows falls."""
        before, after = (
            np.sum(self.whitened(v)[self.outliers]) for v in (self.nominal, self.calibrated)
        )
        return bool(after < _ALIKE**2 * before and self.gain(of_all=True)[1] < _CHANCE)

    def remains(self) -> float:
        """The share of the nominal robot's error over the joint limits that is expected to remain."""
        return float(self.expected / max(np.hypot(self.expected, self.moved), 1e-30))


#: Doubts whether what a model leaves over is the measurements' noise.
_NOT_NOISE = (Why.MODEL_LACKS, Why.NOISE_LARGE, Why.NOISE_ABOVE_SIGMA)

#: What can be improved where the gain is proven, and is no reason against it.
_REMAINING = (
    Why.JOINTS_STILL,
    Why.MODEL_LACKS,
    Why.CORNER,
    Why.JOINT_PATTERN,
    Why.REPEATS_AGREE,
    Why.NO_LENGTH,
)


def verdict(e: Evidence) -> Verdict:
    """Judge a calibration by its errors on rows that it did not see."""
    if wrong := _absurd(e):
        return Verdict(NO, (wrong[0],))  # nothing else that is told of such a fit means anything
    before, after = e.nominal.errors_without_outliers, e.calibrated.errors_without_outliers
    both: dict[str, Any] = {"before": before, "after": after, "method": e.calibrated.method}
    (gain, p), size, flagged = e.gain(), _size(e), int(np.sum(e.outliers))
    whole = max(e.parameters, e.whole)
    few, sparse = (size["numbers"] < _FEW * count for count in (e.parameters, whole))
    still, quiet = gain <= 0.0 or p > _CHANCE, e.quiet
    every = {"before": e.nominal.errors, "after": e.calibrated.errors}
    of_many = Reason.of(Why.MANY_OUTLIERS, flagged=flagged, rows=len(e.outliers), **every)
    many = flagged > _MANY_OUTLIERS * len(e.outliers)
    accidents = many and e.accidental
    # What a model leaves over is noise only if a larger one does not leave far less, and if an instrument has such.
    odd = many or any(doubt.why in _NOT_NOISE for doubt in e.doubts)
    elsewhere = {"expected_m": e.expected, "remains": e.remains()}
    lost, remains = e.expected > _FAR_MORE * _typical(before), e.remains() > _REMAINS
    unknown = Reason.of(Why.UNKNOWN_ELSEWHERE, **elsewhere)
    against = _those(
        (still and quiet and not odd and not sparse, Reason.of(Why.NOTHING_TO_GAIN, before=before)),
        (after.rms > _ABSURD, Reason.of(Why.STILL_FAR_OFF, **both)),
        (
            still and (few or (quiet and sparse)),
            Reason.of(Why.TOO_FEW, **both | size, parameters=whole, gain=gain),
        ),
        (gain <= 0.0, Reason.of(Why.NO_BETTER, **both)),
        (
            bool(flagged) and _typical(every["after"]) > _ALIKE * _typical(every["before"]),
            replace(of_many, why=Why.WORSE_WITH_OUTLIERS),
        ),
        (still and many and not accidents, of_many),
        (lost and remains, unknown),
    )[:1]
    nominal, fresh, aside = e.validation
    falls = fresh.rms < (1.0 - _ROUNDING) * nominal.rms
    of_fresh: dict[str, Any] = {"rows": fresh.n, "aside": aside, "before": nominal, "after": fresh}
    unfit, unlike = bool(fresh.n) and not falls, fresh.rms > _ANOTHER_MEASUREMENT * after.rms > 0.0
    against += _those((unfit, Reason.of(Why.VALIDATION_NO_BETTER, **of_fresh)))
    careful = [
        *_those(
            (gain > 0.0 and still and not against, Reason.of(Why.MAY_BE_CHANCE, gain=gain)),
            (before.rms > _ABSURD, Reason.of(Why.FAR_OFF_BEFORE, before=before)),
            (lost and not against, unknown),
        ),
        *(doubt for doubt in e.doubts if doubt.why not in _REMAINING),
        *_those(
            (e.largest > _TOO_FAR, Reason.of(Why.PARAMETER_FAR, largest=e.largest)),
            (
                bool(fresh.n) and unlike,
                Reason.of(Why.VALIDATION_UNLIKE, rows=fresh.n, before=fresh, after=after),
            ),
            (many and not accidents and of_many not in against, of_many),
        ),
    ]
    # Where unseen rows prove the gain, these say what is left.
    fewer = Reason.of(Why.FEW_NUMBERS, **size, parameters=e.parameters)
    remaining = _those((few and not against, fewer), (accidents, of_many))
    remaining += [doubt for doubt in e.doubts if doubt.why in _REMAINING]
    gains = _those(
        (gain > 0.0, Reason.of(Why.GAIN, **both, outliers=flagged)),
        (bool(fresh.n) and falls, Reason.of(Why.VALIDATION_GAIN, **of_fresh)),
    )
    proven = not (still or remains) and _typical(after) < _FALLS * _typical(before)
    if not proven and not against:
        careful += remaining
        careful = careful or [Reason.of(Why.SMALL_GAIN, **elsewhere)]
        remaining = []
    use = NO if against else CARE if careful else USE
    return Verdict(use, (*against, *careful, *gains, *remaining, *e.notes))


def _absurd(e: Evidence) -> list[Reason]:
    """Another set-up that explains the rows, or errors that no arm has."""
    before, after = e.nominal.errors_without_outliers, e.calibrated.errors_without_outliers
    turned = bool(after.n_angle) and after.rms_angle > _ABSURD_ANGLE
    far = before.rms > _ABSURD and e.largest > _TOO_FAR
    return ([e.hint] if e.hint else []) + _those(
        (far, Reason.of(Why.PARAMETER_ABSURD, before=before, largest=e.largest)),
        (e.noise > _ABSURD, Reason.of(Why.NOISE_ABSURD, noise_m=e.noise)),
        (turned, Reason.of(Why.ORIENTATION_ABSURD, after=after)),
    )


def _typical(errors: Errors) -> float:
    """Rms of lengths, or of angles where no length was measured."""
    return errors.rms if errors.n else errors.rms_angle


def _those(*told: tuple[bool, Reason]) -> list[Reason]:
    """The reasons that apply."""
    return [reason for applies, reason in told if applies]


def _size(e: Evidence) -> dict[str, int]:
    """At how many different poses and pairs of poses how many scalars were measured, repeats counted once."""
    single = np.any(e.used, axis=1) & ~e.pairs
    first = np.unique(e.repeats, return_index=True)[1]
    return {
        "poses": len(np.unique(e.repeats[single])),
        "pairs": len(np.unique(e.repeats[e.pairs])),
        "numbers": int(np.sum(e.used[first])),
    }
