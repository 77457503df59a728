"""The verdict: whether the corrected robot should be used, and why."""

from __future__ import annotations

import string
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.estimate.rows import Mask
from calib.estimate.statistics import CrossValidation, Errors

USE, CARE, NO = "use", "use with care", "do not use"

#: Scalar measurements for each parameter that is estimated, below which a fit leans on its priors.
_FEW = 2.0

#: A share of flagged rows above this is no accident.
_MANY_OUTLIERS = 0.15

#: Validation rows this many times as far off as left-out rows were not measured like them.
_ANOTHER_MEASUREMENT = 10.0

#: Errors and noise beyond these are no uncalibrated arm's and no instrument's: the set-up is wrong [m], [rad].
_ABSURD, _ABSURD_ANGLE = 0.02, 0.17

#: A nominal error below this many standard deviations, rms over all scalars, is that of a robot that is right.
_AT_THE_NOISE = 1.45

#: A change of a parameter beyond this is no error of an arm [m or rad].
_TOO_FAR = 0.1

#: Relative differences below this are rounding of the solver.
_ROUNDING = 1e-6

#: A mean gain of fewer standard errors than this may be chance.
_CHANCE = 2.0


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether to use the corrected robot.

    Attributes:
        use: ``"use"``, ``"use with care"`` or ``"do not use"``.
        reasons: Codes with their numbers, the weightiest first; ``str`` of one is a sentence.
    """

    use: str
    reasons: tuple[Reason, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What the verdict is based on; N rows of up to D scalars [m], [rad].

    The nominal robot is cross-validated with frame and target fitted as for the calibrated one. Rows of one number in
    ``repeats`` are repeats of one measurement, ``pairs`` hold the distance between two poses. ``validation`` has the
    errors of the nominal and the calibrated robot there, and how many more rows were left out as accidents.
    """

    nominal: CrossValidation
    calibrated: CrossValidation
    scales: NDArray[np.float64]  # (N, D), the noise of each scalar
    used: Mask  # (N, D), which scalars were measured
    repeats: NDArray[np.int_]
    pairs: Mask
    outliers: Mask  # (N,), flagged by the fit to all of them
    validation: tuple[Errors, Errors, int]
    parameters: int
    largest: float  # change of a parameter of the robot [m or rad]
    noise: float  # of one length [m]
    doubts: tuple[Reason, ...] = ()  # what was found besides errors
    notes: tuple[Reason, ...] = ()  # said in the end, and decide nothing
    hint: Reason | None = None  # which set-up would explain the measurements better


def verdict(e: Evidence) -> Verdict:
    """Judge a calibration by its errors on rows that it did not see."""
    before, after = e.nominal.errors_without_outliers, e.calibrated.errors_without_outliers
    wrong = e.hint or _wrong_setup(e, before, after)
    if wrong:
        # Nothing else that is said of such a fit means anything.
        return Verdict(NO, (wrong,))
    gain = _gain_in_errors(e)
    against = [*_no_better(e, gain, before, after)]
    careful = [*([] if against else _weak(e, gain)), *_odd(e, before, after)]
    use = NO if against else CARE if careful else USE
    return Verdict(use, (*against, *careful, *_gains(e, gain, before, after)))


def _wrong_setup(e: Evidence, before: Errors, after: Errors) -> Reason | None:
    """Errors that no arm has."""
    if before.rms > _ABSURD and e.largest > _TOO_FAR:
        return Reason.of(Why.PARAMETER_ABSURD, before=before, largest=e.largest)
    if e.noise > _ABSURD:
        return Reason.of(Why.NOISE_ABSURD, noise_m=e.noise)
    if after.n_angle and after.rms_angle > _ABSURD_ANGLE:
        return Reason.of(Why.ORIENTATION_ABSURD, after=after)
    return None


def _no_better(e: Evidence, gain: float, before: Errors, after: Errors) -> Iterator[Reason]:
    """Unseen rows that the calibrated robot does not meet better."""
    both = {"before": before, "after": after, "method": e.calibrated.method}
    lacks = any(doubt.why == Why.MODEL_LACKS for doubt in e.doubts)
    # What a model leaves over is noise only if a larger one does not leave far less.
    if gain < _CHANCE and _whitened_rms(e) < _AT_THE_NOISE and not lacks:
        yield Reason.of(Why.NOTHING_TO_GAIN, before=before)
    elif after.rms > _ABSURD:
        yield Reason.of(Why.STILL_FAR_OFF, **both)
    elif 0.0 < gain < _CHANCE and _numbers(e) < _FEW * e.parameters:
        yield Reason.of(Why.TOO_FEW, **both, poses=_poses(e), parameters=e.parameters, gain=gain)
    elif gain <= 0.0:
        yield Reason.of(Why.NO_BETTER, **both)
    nominal, calibrated, _ = e.validation
    if calibrated.n and calibrated.rms >= (1.0 - _ROUNDING) * nominal.rms:
        yield Reason.of(
            Why.VALIDATION_NO_BETTER, rows=calibrated.n, before=nominal, after=calibrated
        )


def _weak(e: Evidence, gain: float) -> Iterator[Reason]:
    """A gain that may be chance, or that few poses show."""
    if 0.0 < gain < _CHANCE:
        yield Reason.of(Why.MAY_BE_CHANCE, gain=gain)
    if _numbers(e) < _FEW * e.parameters:
        yield Reason.of(
            Why.FEW_NUMBERS, poses=_poses(e), numbers=_numbers(e), parameters=e.parameters
        )


def _odd(e: Evidence, before: Errors, after: Errors) -> Iterator[Reason]:
    """What should not be in a calibration that helps."""
    if before.rms > _ABSURD:
        yield Reason.of(Why.FAR_OFF_BEFORE, before=before)
    yield from e.doubts
    if e.largest > _TOO_FAR:
        yield Reason.of(Why.PARAMETER_FAR, largest=e.largest)
    kept = e.validation[1]
    if kept.n and kept.rms > _ANOTHER_MEASUREMENT * after.rms > 0.0:
        yield Reason.of(Why.VALIDATION_UNLIKE, rows=kept.n, before=kept, after=after)
    flagged, rows = int(np.sum(e.outliers)), len(e.outliers)
    if flagged > _MANY_OUTLIERS * rows:
        yield Reason.of(Why.MANY_OUTLIERS, flagged=flagged, rows=rows)


def _gains(e: Evidence, gain: float, before: Errors, after: Errors) -> Iterator[Reason]:
    """What the calibration buys, where it does."""
    if gain > 0.0:
        method, aside = e.calibrated.method, int(np.sum(e.outliers))
        yield Reason.of(Why.GAIN, method=method, outliers=aside, before=before, after=after)
    nominal, calibrated, aside = e.validation
    if calibrated.n and calibrated.rms < (1.0 - _ROUNDING) * nominal.rms:
        rows = calibrated.n
        yield Reason.of(
            Why.VALIDATION_GAIN, rows=rows, aside=aside, before=nominal, after=calibrated
        )
    yield from e.notes


def _gain_in_errors(e: Evidence) -> float:
    """Mean fall of the squared error on left-out rows, outliers aside, in standard errors of that mean.

    Paired by poses, so that one that is hard for both robots does not blur the comparison, and repeats do not count as
    evidence of their own; 0 where nothing changes.
    """
    good = ~e.outliers & np.any(e.used, axis=1)
    squares = []
    for v in (e.nominal, e.calibrated):
        _, poses = np.unique(v.poses[good], return_inverse=True)
        counts = np.maximum(np.bincount(poses), 1)
        squares.append(np.bincount(poses, _whitened(v, e)[good]) / counts)
    fall = squares[0] - squares[1]
    mean = float(np.mean(fall)) if len(fall) else 0.0
    if abs(mean) < _ROUNDING * float(np.mean(squares[0])):
        return 0.0
    if len(fall) < 2:
        return float(np.sign(mean))
    return mean / max(float(np.std(fall, ddof=1)) / float(np.sqrt(len(fall))), 1e-30)


def _poses(e: Evidence) -> str:
    """At how many different poses and pairs of poses something was measured, in words."""
    single = np.any(e.used, axis=1) & ~e.pairs
    counts = {
        "poses": len(np.unique(e.repeats[single])),
        "pairs of poses": len(np.unique(e.repeats[e.pairs])),
    }
    return " and ".join(f"{count} {what}" for what, count in counts.items() if count)


def _numbers(e: Evidence) -> int:
    """Scalars measured, repeats of a pose counted once."""
    first = np.unique(e.repeats, return_index=True)[1]
    return int(np.sum(e.used[first]))


def _whitened(v: CrossValidation, e: Evidence) -> NDArray[np.float64]:
    """The squared error of each row, in units of the noise, shape (N,)."""
    return np.asarray(np.sum(np.where(e.used, v.residual / e.scales, 0.0) ** 2, axis=1))


def _whitened_rms(e: Evidence) -> float:
    """Error of the nominal robot on left-out rows that are no outliers, in units of the noise, rms over scalars."""
    good = ~e.outliers
    count = max(int(np.sum(e.used[good])), 1)
    return float(np.sqrt(np.sum(_whitened(e.nominal, e)[good]) / count))


_OFF = "The nominal robot is {given_m:mm.0f} mm rms off, which no uncalibrated arm is, and only {error_m:mm.1f} mm if "
_NOT_NOISE = "What the model leaves over is not noise: "
_SHARE = "explains {share:%.0f} % of it (chance: {chance:%.0f} %, {chance_p})"
_CHANGED = "Did the arm, its tool or the instrument change in between?"


class Why(Enum):
    """The codes, each with its sentence; a number is written as ``{name:unit.digits}``."""

    # Another set-up explains the rows.
    TARGET_ELSEWHERE = _OFF + "the target is found from the data: leave out --fix-target."
    WRONG_UNIT = _OFF + "the {what} are {unit}: check the unit in the header."
    OTHER_BASE = _OFF + "the points are in the frame of '{link}': try --base {link}."
    OWN_FRAME = _OFF + "the points are in a frame of their own: try --frame estimate."
    JOINTS_TURNED = _OFF + "{joints} turned the other way: check the signs."
    JOINT_ZERO = _OFF + "{add_rad:deg.0f} deg are added to '{joint}': check its zero."
    COLUMNS_SWAPPED = _OFF + "the columns {columns} are swapped."
    # No arm has such errors.
    PARAMETER_ABSURD = (
        "The nominal robot is {before_m:mm.0f} mm rms off on unseen rows, and the fit meets the rows only by moving a "
        "parameter by {largest:mm.0f} mm or mrad: are base and tip, the joint columns and their signs right, and is "
        "each set-up, socket or tracker station a group of its own?"
    )
    NOISE_ABSURD = (
        "What the model leaves over is {noise_m:mm.0f} mm a coordinate, which no arm or instrument explains: are base "
        "and tip, the joint columns and their signs right, the measurements in the base frame (otherwise: --frame "
        "estimate)?"
    )
    ORIENTATION_ABSURD = (
        "On rows it did not see the calibrated robot's orientations are {after_rad:deg.0f} deg rms off: are they those "
        "of the target in the measurement frame and not the inverse, is the scalar of the quaternion in the column qw, "
        "and are rx, ry, rz a rotation vector, not roll, pitch and yaw?"
    )
    # It is no better.
    NOTHING_TO_GAIN = (
        "Nothing to gain: the robot as it is meets these rows to {before} on unseen rows, which is about their noise. "
        "Keep its URDF."
    )
    STILL_FAR_OFF = (
        "On rows it did not see ({method}) the calibrated robot is {after_m:mm.0f} mm rms off."
    )
    TOO_FEW = (
        "{poses} for {parameters} parameters are too few to show a gain: on unseen rows {before} against {after}, "
        "{gain:.1f} standard errors. Measure more poses."
    )
    NO_BETTER = (
        "On rows it did not see ({method}) the calibrated robot is no better than the nominal one, frame and target "
        "fitted for both: {after} against {before}."
    )
    VALIDATION_NO_BETTER = "On the {rows} validation rows the error does not fall: {change}."
    # Care is needed.
    MAY_BE_CHANCE = (
        "The gain on unseen rows is within what chance gives: {gain:.1f} standard errors."
    )
    FEW_NUMBERS = (
        "{poses} with {numbers} numbers for {parameters} parameters are few: the result leans on the priors. Measure "
        "more poses."
    )
    FAR_OFF_BEFORE = (
        "The nominal robot is {before_m:mm.0f} mm rms off on unseen rows, which no uncalibrated arm is. Is it the "
        "right URDF?"
    )
    JOINTS_STILL = (
        "Hardly moved over these rows: {joints}. The result holds near these positions only; measure poses that move "
        "every joint."
    )
    MODEL_LACKS = (
        "The model '{model}' leaves {noise_m:mm.3f} mm a coordinate, all placements would leave {less_m:mm.3f} mm: the "
        "robot has errors that this model lacks. Try --model auto or --model placement."
    )
    CORNER = (
        "The poses cover a corner of the workspace only: their tips spread over {spread:%.0f} % of the distance that "
        "the joint limits allow, and '{joint}' uses {used:%.0f} % of its range. Measure poses all over the workspace."
    )
    JOINT_PATTERN = _NOT_NOISE + "the {quantity} of '{joint}' " + _SHARE + "."
    DRIFT = (
        _NOT_NOISE
        + "it drifts in the order of the rows, which "
        + _SHARE
        + ". Did something warm up, or move?"
    )
    SETUP_UNPREDICTED = (
        "The other set-ups do not predict set-up '{setup}': a fit without it leaves errors there {ratio:.1f} times "
        "those expected. " + _CHANGED
    )
    SETUP_FLAGGED = (
        "{flagged} of the {rows} rows of set-up '{setup}' are flagged as outliers: it does not agree with the others. "
        + _CHANGED
    )
    REPEATS_AGREE = (
        "Repeats of a pose scatter by {within_m:mm.3f} mm a coordinate, the model leaves {noise_m:mm.3f} mm: these are "
        "errors that the model lacks."
    )
    NO_LENGTH = (
        "Nothing that was measured is a length, so the size of the arm is the nominal one's: measure a distance "
        "between two sockets, and give it in the cell file ([[distances]])."
    )
    PARAMETER_FAR = (
        "A parameter has moved by {largest:mm.0f} mm or mrad, which is no error of an arm. Keep the priors on, or "
        "choose a smaller model."
    )
    VALIDATION_UNLIKE = (
        "The calibrated robot is {before} off on the {rows} validation rows and {after} on left-out rows: was the "
        "target or the frame another one?"
    )
    MANY_OUTLIERS = "{flagged} of {rows} rows are flagged as outliers: too many to be accidents."
    # What it buys.
    GAIN = "On rows it did not see ({method}{outliers_aside}) the error falls {change}."
    LARGER_MODEL = "With the larger model '{model}' it would be {after}. No URDF can hold that; predict() does."
    VALIDATION_GAIN = "On the {rows} validation rows{rows_aside} it falls {change}."
    OUTSIDE = "Outside of the joint values that were fitted, where errors may be larger: {rows}."


@dataclass(frozen=True, slots=True)
class Reason:
    """One reason of a verdict; ``str`` makes a sentence of it.

    Attributes:
        why: What it is.
        values: The numbers and names that it stands on, in SI units; ``before_m`` is an rms error, for instance.
    """

    why: Why
    values: Mapping[str, Any]

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

    def __str__(self) -> str:
        """The sentence.

        Example:
            >>> str(Reason.of(Why.VALIDATION_NO_BETTER, rows=5, before_m=1e-3, after_m=2e-3))
            'On the 5 validation rows the error does not fall: from 1.000 to 2.000 mm rms.'
        """
        v = self.values
        said = {name: _rms(v, name) for name in ("before", "after")}
        before, after = said.values()
        if len(before) == 1:  # the unit once is enough
            before = [before[0].split()[0]]
        words = {
            **v,
            **{name: f"{' and '.join(parts)} rms" for name, parts in said.items()},
            "change": f"from {' and '.join(before)} to {' and '.join(after)} rms",
            "chance_p": "p < 1e-6" if v.get("p", 1.0) < 1e-6 else f"p = {v.get('p', 1.0):.1g}",
            "outliers_aside": ", outliers aside" * bool(v.get("outliers")),
            "rows_aside": f" ({v['aside']} more aside)" if v.get("aside") else "",
        }
        return _Units().vformat(self.why.value, (), words)


def _rms(values: Mapping[str, Any], name: str) -> list[str]:
    """An rms error of lengths, of angles, or of both."""
    units = (("m", 1e3, "mm"), ("rad", float(np.degrees(1.0)), "deg"))
    return [
        f"{scale * values[f'{name}_{si}']:.3f} {unit}"
        for si, scale, unit in units
        if f"{name}_{si}" in values
    ]


class _Units(string.Formatter):
    """Numbers in the unit that stands before their format: ``{noise_m:mm.3f}``."""

    def format_field(self, value: Any, format_spec: str) -> Any:  # noqa: ANN401
        for unit, scale in (("mm", 1e3), ("deg", float(np.degrees(1.0))), ("%", 100.0)):
            if format_spec.startswith(unit):
                return format(scale * value, format_spec.removeprefix(unit))
        return format(value, format_spec)
