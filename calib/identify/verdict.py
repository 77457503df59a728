"""The verdict: whether the corrected robot should be used, and why."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.identify.statistics import CrossValidation, Errors

USE, CARE, NO = "use", "use with care", "do not use"

#: Scalar measurements for each parameter that is estimated, below which a fit leans on its priors.
_FEW = 2.0

#: A share of flagged rows above this is no accident.
_MANY_OUTLIERS = 0.15

#: Validation rows this many times as far off as left-out rows were not measured like them.
_ANOTHER_MEASUREMENT = 10.0

#: Noise above this is no measuring instrument's: the set-up is wrong [m].
_ABSURD_NOISE = 0.02

#: An orientation error on unseen rows beyond this is no instrument's [rad].
_ABSURD_ANGLE = 0.17

#: A nominal robot that is off by more than this is more than uncalibrated [m].
_ANOTHER_ROBOT = 0.02

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
        reasons: Sentences, the weightiest first.
    """

    use: str
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What the verdict is based on.

    Attributes:
        nominal: Cross-validation of the nominal robot, frame and target fitted as for the calibrated one.
        calibrated: Cross-validation of the calibrated robot.
        larger_validation: Cross-validation of the larger model; None without one.
        larger_name: Its name.
        scales: shape (N, D), the noise of each scalar [m], [rad].
        used: shape (N, D), which scalars were measured.
        repeats: shape (N,), rows of one number are repeats of one measurement.
        pairs: shape (N,), which rows hold the distance between two poses.
        outliers: shape (N,), the rows flagged by the fit to all of them.
        validation_nominal: Errors of the nominal robot on the validation rows; n = 0 where there are none.
        validation_calibrated: Errors of the calibrated robot there.
        validation_aside: Number of validation rows left out of the two as accidents.
        still: Joints that hardly moved, in words.
        missing: What a larger geometry would leave over, a sentence; empty where it is not far less.
        findings: What shows that residuals are not noise, sentences.
        corner: That the poses cover a corner of the workspace only, a sentence; or nothing.
        outside: Which validation rows lie outside of the measured joint range, a sentence; or nothing.
        parameters: Number of parameters.
        largest: Largest change of a parameter of the robot [m or rad].
        noise: Estimated standard deviation of one length [m].
        hint: What would explain the measurements better, a sentence; empty where nothing was found.
    """

    nominal: CrossValidation
    calibrated: CrossValidation
    larger_validation: CrossValidation | None
    larger_name: str
    scales: NDArray[np.float64]
    used: NDArray[np.bool_]
    repeats: NDArray[np.int_]
    pairs: NDArray[np.bool_]
    outliers: NDArray[np.bool_]
    validation_nominal: Errors
    validation_calibrated: Errors
    validation_aside: int
    still: tuple[str, ...]
    missing: str
    findings: tuple[str, ...]
    corner: str
    outside: str
    parameters: int
    largest: float
    noise: float
    hint: str = ""


def verdict(evidence: Evidence) -> Verdict:
    """Judge a calibration by its errors on rows that it did not see."""
    wrong = _wrong_setup(evidence)
    if wrong:
        # Nothing else that is said of such a fit means anything.
        return Verdict(NO, tuple(wrong))
    against = _no_better(evidence)
    careful = [*([] if against else _weak_evidence(evidence)), *_oddities(evidence)]
    use = NO if against else CARE if careful else USE
    return Verdict(use, (*against, *careful, *_gains(evidence)))


def _wrong_setup(e: Evidence) -> list[str]:
    """Errors that no arm has."""
    if e.hint:
        return [e.hint]
    before = e.nominal.errors_without_outliers
    if before.rms > _ABSURD_NOISE and e.largest > _TOO_FAR:
        return [
            f"The nominal robot is {1e3 * before.rms:.0f} mm rms off on unseen rows, and the fit meets the rows only "
            f"by moving a parameter by {1e3 * e.largest:.0f} mm or mrad, which is no error of an arm. Are base and "
            "tip, the joint columns and their signs right, and is each set-up, socket or tracker station a group of "
            "its own?"
        ]
    if e.noise > _ABSURD_NOISE:
        return [
            f"What the model leaves over is {1e3 * e.noise:.0f} mm a coordinate, which no arm or instrument explains: "
            "are base and tip the right links, the joint columns in the right order and with the right signs, the "
            "measurements in the base frame (otherwise: --frame estimate)?"
        ]
    after = e.calibrated.errors_without_outliers
    if after.n_angle and after.rms_angle > _ABSURD_ANGLE:
        return [
            f"On rows it did not see the calibrated robot's orientations are {np.degrees(after.rms_angle):.0f} deg rms "
            "off, which no arm or instrument explains: are they those of the target in the measurement frame and not "
            "the inverse, is the scalar of the quaternion in the column qw, and are rx, ry, rz a rotation vector, not "
            "roll, pitch and yaw?"
        ]
    return []


def _no_better(e: Evidence) -> list[str]:
    """Unseen rows that the calibrated robot does not meet better."""
    reasons = []
    before, after = e.nominal.errors_without_outliers, e.calibrated.errors_without_outliers
    gain = _gain_in_errors(e)
    few = _numbers(e) < _FEW * e.parameters
    # What a model leaves over is noise only if a larger one does not leave far less.
    if gain < _CHANCE and _whitened_rms(e) < _AT_THE_NOISE and not e.missing:
        reasons.append(
            f"Nothing to gain: the robot as it is meets these rows to {_both(before)} on unseen rows, which "
            "is about their noise. Keep its URDF."
        )
    elif after.rms > _ABSURD_NOISE:
        reasons.append(
            f"On rows it did not see ({e.calibrated.method}) the calibrated robot is {1e3 * after.rms:.0f} mm rms off."
        )
    elif 0.0 < gain < _CHANCE and few:
        reasons.append(
            f"{_poses(e)} for {e.parameters} parameters are too few to show a gain: on unseen rows {_both(before)} "
            f"against {_both(after)}, {gain:.1f} standard errors. Measure more poses."
        )
    elif gain <= 0.0:
        reasons.append(
            f"On rows it did not see ({e.calibrated.method}) the calibrated robot is no better than the nominal one, "
            f"frame and target fitted for both: {_both(after)} against {_both(before)}."
        )
    worse = e.validation_calibrated.rms >= (1.0 - _ROUNDING) * e.validation_nominal.rms
    if e.validation_calibrated.n and worse:
        reasons.append(
            f"On the {e.validation_calibrated.n} validation rows the error does not fall: "
            f"{_change(e.validation_nominal, e.validation_calibrated)}."
        )
    return reasons


def _weak_evidence(e: Evidence) -> list[str]:
    """A gain that may be chance, or that few poses show."""
    reasons = []
    if 0.0 < _gain_in_errors(e) < _CHANCE:
        reasons.append(
            f"The gain on unseen rows is within what chance gives: {_gain_in_errors(e):.1f} standard errors. The "
            "nominal robot may be as good."
        )
    if _numbers(e) < _FEW * e.parameters:
        reasons.append(
            f"{_poses(e)} with {_numbers(e)} numbers for {e.parameters} parameters are few: the result leans on the "
            "priors. Measure more poses."
        )
    return reasons


def _oddities(e: Evidence) -> list[str]:
    """What should not be in a calibration that helps."""
    reasons = []
    if e.nominal.errors_without_outliers.rms > _ANOTHER_ROBOT:
        reasons.append(
            f"The nominal robot is {1e3 * e.nominal.errors_without_outliers.rms:.0f} mm rms off on unseen "
            "rows, which is more than an uncalibrated arm is: is it the right URDF?"
        )
    if e.still:
        reasons.append(
            f"Hardly moved over these rows: {', '.join(e.still)}. The result holds near these positions only; measure "
            "poses that move every joint."
        )
    reasons += [sentence for sentence in (e.missing, e.corner, *e.findings) if sentence]
    if e.largest > _TOO_FAR:
        reasons.append(
            f"A parameter has moved by {1e3 * e.largest:.0f} mm or mrad, which is no error of an arm: the measurements "
            "do not hold it. Keep the priors on, or choose a smaller model."
        )
    kept, left = e.validation_calibrated, e.calibrated.errors_without_outliers
    if kept.n and kept.rms > _ANOTHER_MEASUREMENT * left.rms > 0.0:
        reasons.append(
            f"The calibrated robot is {_both(kept)} off on the {kept.n} validation rows and {_both(left)} on left-out "
            "rows: look at these rows before using the result. Was the target or the frame another one?"
        )
    flagged, rows = int(np.sum(e.outliers)), len(e.outliers)
    if flagged > _MANY_OUTLIERS * rows:
        reasons.append(
            f"{flagged} of {rows} rows are flagged as outliers: too many to be accidents. Look at them before using "
            "the result."
        )
    return reasons


def _gains(e: Evidence) -> list[str]:
    """What the calibration buys, where it does."""
    reasons = []
    before, after = e.nominal.errors_without_outliers, e.calibrated.errors_without_outliers
    if _gain_in_errors(e) > 0.0:
        aside = ", outliers aside" if np.any(e.outliers) else ""
        reasons.append(
            f"On rows it did not see ({e.calibrated.method}{aside}) the error falls {_change(before, after)}."
        )
    if e.larger_validation is not None:
        larger = e.larger_validation.errors_without_outliers
        reasons.append(
            f"With the larger model '{e.larger_name}' it would be {_both(larger)}. No URDF can hold that: the URDF has "
            f"the geometry alone, the result file and predict() have the rest."
        )
    before, after = e.validation_nominal, e.validation_calibrated
    if after.n and after.rms < (1.0 - _ROUNDING) * before.rms:
        aside = f" ({e.validation_aside} more aside)" if e.validation_aside else ""
        reasons.append(
            f"On the {after.n} validation rows{aside} it falls {_change(before, after)}."
        )
    if e.outside:
        reasons.append(
            f"Outside of the joint values that were fitted, where errors may be larger: {e.outside}."
        )
    return reasons


def _gain_in_errors(e: Evidence) -> float:
    """Mean fall of the squared error on left-out rows, outliers aside, in standard errors of that mean.

    Paired by poses, so that one that is hard for both robots does not blur the comparison, and repeats do not count as
    evidence of their own; 0 where nothing changes.
    """
    squares = [_mean_by_pose(v, e) for v in (e.nominal, e.calibrated)]
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
    result: NDArray[np.float64] = np.sum(np.where(e.used, v.residual / e.scales, 0.0) ** 2, axis=1)
    return result


def _whitened_rms(e: Evidence) -> float:
    """Error of the nominal robot on left-out rows that are no outliers, in units of the noise, rms over scalars."""
    good = ~e.outliers
    count = max(int(np.sum(e.used[good])), 1)
    return float(np.sqrt(np.sum(_whitened(e.nominal, e)[good]) / count))


def _mean_by_pose(v: CrossValidation, e: Evidence) -> NDArray[np.float64]:
    """The mean squared error of each pose that has rows which are no outliers, in units of the noise."""
    good = ~e.outliers & np.any(e.used, axis=1)
    _, poses = np.unique(v.poses[good], return_inverse=True)
    squares = _whitened(v, e)[good]
    result: NDArray[np.float64] = np.bincount(poses, squares) / np.maximum(np.bincount(poses), 1)
    return result


def _both(errors: Errors) -> str:
    """An rms error in words, with that of the angles where there are any."""
    length = f"{1e3 * errors.rms:.3f} mm"
    angle = f"{np.degrees(errors.rms_angle):.3f} deg"
    parts = [length] * (errors.n > 0) + [angle] * (errors.n_angle > 0)
    return f"{' and '.join(parts)} rms"


def _change(before: Errors, after: Errors) -> str:
    """A change of rms errors in words: ``from 2.351 to 0.208 mm rms``."""
    if before.n and before.n_angle:
        return f"from {_both(before).removesuffix(' rms')} to {_both(after)}"
    if before.n:
        return f"from {1e3 * before.rms:.3f} to {1e3 * after.rms:.3f} mm rms"
    return f"from {np.degrees(before.rms_angle):.3f} to {np.degrees(after.rms_angle):.3f} deg rms"
