"""The verdict: whether the corrected robot should be used, and why."""

from __future__ import annotations

from dataclasses import dataclass

from calib.identify.statistics import Errors

USE, CARE, NO = "use", "use with care", "do not use"

#: Scalar measurements left over for each parameter that is estimated, below which a fit is fragile.
_FEW = 1.0

#: A share of flagged rows above this is no accident.
_MANY_OUTLIERS = 0.15

#: Noise above this is no measuring instrument's: the set-up is wrong [m].
_ABSURD_NOISE = 0.02


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether to use the corrected robot.

    Attributes:
        use: ``"use"``, ``"use with care"`` or ``"do not use"``.
        reasons: Sentences.
    """

    use: str
    reasons: tuple[str, ...]


def verdict(
    *,
    before: Errors,
    after: Errors,
    unseen: str,
    validation_before: Errors,
    validation_after: Errors,
    measured: int,
    parameters: int,
    outliers: int,
    rows: int,
    noise: float,
    hint: str = "",
) -> Verdict:
    """Judge a calibration by its errors on rows that it did not see.

    Args:
        before: Errors of the nominal robot on left-out rows, frame and target fitted to the others as for the
            calibrated one, outliers aside.
        after: Errors of the calibrated robot on the same rows.
        unseen: How those rows were left out, for the text.
        validation_before: Errors of the nominal robot on the validation rows; n = 0 where there are none.
        validation_after: Errors of the calibrated robot there.
        measured: Number of scalar measurements.
        parameters: Number of parameters.
        outliers: Number of rows flagged.
        rows: Number of rows.
        noise: Estimated standard deviation of one coordinate [m].
        hint: What would explain the measurements better, a sentence; empty where nothing was found.
    """
    against: list[str] = []
    careful: list[str] = []
    good: list[str] = []
    if hint:
        against.append(hint)
    elif noise > _ABSURD_NOISE:
        against.append(
            f"What the model leaves over is {1e3 * noise:.0f} mm a coordinate, which no arm or instrument explains: "
            "are base and tip the right links, the joint columns in the right order, the measurements in the base "
            "frame (otherwise: --frame estimate)?"
        )
    if after.rms >= before.rms:
        against.append(
            f"On rows it did not see ({unseen}) the calibrated robot is no better than the nominal one: "
            f"{_mm(after.rms)} against {_mm(before.rms)} mm rms."
        )
    else:
        good.append(
            f"On rows it did not see ({unseen}, outliers aside) the error falls from {_mm(before.rms)} to "
            f"{_mm(after.rms)} mm rms."
        )
    if validation_after.n:
        change = f"from {_mm(validation_before.rms)} to {_mm(validation_after.rms)} mm rms"
        if validation_after.rms >= validation_before.rms:
            against.append(
                f"On the {validation_after.n} validation rows the error does not fall: {change}."
            )
        else:
            good.append(f"On the {validation_after.n} validation rows it falls {change}.")
    if measured < (1.0 + _FEW) * parameters:
        careful.append(
            f"{measured} measured coordinates for {parameters} parameters are few: the result leans on the priors. "
            "Measure more poses."
        )
    if outliers > _MANY_OUTLIERS * rows:
        careful.append(
            f"{outliers} of {rows} rows are flagged as outliers: too many to be accidents. Look at them before using "
            "the result."
        )
    use = NO if against else CARE if careful else USE
    return Verdict(use, (*against, *careful, *good))


def _mm(length: float) -> str:
    """A length in mm, three digits after the point."""
    return f"{1e3 * length:.3f}"
