"""The verdict on a calibration of frames and targets alone, the model ``frames``: is what was sought located?

Nothing of the robot is corrected, so there is no gain to prove. What counts is whether the rows determine every
direction of the frames and targets, whether rows that the fit has not seen are predicted as well as those that it has,
and whether anything speaks against the input. The errors that the robot makes from pose to pose are in the residuals;
they make the result less certain, which its covariance states, and are no reason against it.
"""

from __future__ import annotations

from collections.abc import Sequence

from calib.diagnosis.evidence import Evidence
from calib.diagnosis.judge import absurd_noise, is_absurd
from calib.diagnosis.reasons import CARE, NO, USE, Reason, Role, Verdict, Why
from calib.numerics.errors import Errors

#: Held-out rows are predicted as well as fitted ones if their rms error is no larger than so many times theirs. Of p
#: unknowns and n numbers it is about (n + p) / (n - p) times in square: here the n are fewer than three for each.
_AS_WELL = 1.4

#: Rows of another day are measured like the others if their rms error is no larger than so many times the held-out one.
_ALIKE = 2.0

#: What is said of a robot's errors and the poses that tell of them, and does not matter for frames and targets.
_OF_ROBOT = (
    Why.JOINTS_STILL,
    Why.SOLE_POSTURE,
    Why.CORNER,
    Why.JOINT_PATTERN,
    Why.CAMERA_TOO_ROUGH,
    Why.REPEATS_AGREE,
)

#: What is a doubt about a robot's errors, and only informs about frames and targets: the residuals are its errors.
_INFORMS = (Why.NOISE_LARGE, Why.NOISE_ABOVE_SIGMA, Why.MODEL_LACKS)


def judge_setup(
    evidence: Evidence,
    fitted: Errors,
    undetermined: Sequence[str],
    located: Reason,
) -> Verdict:
    """Judge frames and targets by held-out rows, and by what the rows determine of them.

    Args:
        evidence: The figures of the calibration.
        fitted: Errors on the rows of the fit, outliers aside.
        undetermined: Names of the parameters of frames and targets that the rows do not determine.
        located: States the uncertainty of the result, and its errors on held-out rows.

    Returns:
        ``use``, ``use with care`` or ``do not use``, with the reasons: those against it, for care, information.
    """
    after, validation = evidence.after, evidence.validation
    doubts = [doubt for doubt in evidence.doubts if doubt.why not in _OF_ROBOT]
    against = [doubt for doubt in doubts if doubt.why.role is Role.WRONG_INPUT]
    noisy = absurd_noise(evidence.noise)
    if noisy is not None:
        against.append(noisy)
    elif is_absurd(after):
        against.append(Reason.of(Why.STILL_FAR_OFF, before=evidence.before, after=after))
    if undetermined:
        against.append(Reason.of(Why.SETUP_UNDETERMINED, names=list(undetermined)))

    care = [
        doubt
        for doubt in doubts
        if doubt.why.role in (Role.GIVEN, Role.CARE) and doubt.why not in _INFORMS
    ]
    if evidence.few or evidence.handful:
        counts = {**evidence.counts, "parameters": evidence.parameters}
        care.append(Reason.of(Why.FEW_NUMBERS, **counts))
    if after.leading.rms > _AS_WELL * fitted.leading.rms:
        care.append(Reason.of(Why.SETUP_UNSURE, before=fitted, after=after))
    if evidence.many_flagged:
        flagged, rows = evidence.flagged, len(evidence.outliers)
        errors = {"before": evidence.nominal.errors, "after": evidence.calibrated.errors}
        care.append(Reason.of(Why.MANY_OUTLIERS, flagged=flagged, rows=rows, **errors))
    if validation.exist and validation.after.leading.rms > _ALIKE * after.leading.rms:
        rows = validation.after.leading.n
        unlike = Reason.of(Why.VALIDATION_UNLIKE, rows=rows, before=validation.after, after=after)
        care.append(unlike)

    stated = [*against, *care]
    information = [doubt for doubt in doubts if doubt not in stated]
    use = USE
    if care:
        use = CARE
    if against:
        use = NO
    return Verdict(use, (*stated, located, *information, *evidence.notes))
