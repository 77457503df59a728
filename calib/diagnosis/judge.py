"""The verdict: whether the corrected robot should be used, and why, in codes and numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.values import ReadOnlyMapping
from calib.diagnosis.augmented_fit import PREDICTS
from calib.diagnosis.evidence import REMAINS, Evidence
from calib.diagnosis.reasons import CARE, NO, USE, Group, Reason, Role, Verdict, Why
from calib.numerics.errors import Errors

#: Units with rules of their own.
_LENGTH, _ANGLE = RESIDUAL_UNITS["m"], RESIDUAL_UNITS["rad"]

#: If errors of validation rows are more than so many times those of held-out rows, they were measured differently; and
#: if they are more than so many times those of the nominal robot, they say nothing about this calibration.
_ANOTHER_MEASUREMENT = 10.0

#: A larger relative error means that a different lens or board was used: lenses are off by 1 to 3 %, prints by 0.3 to
#: 1 %.
_OTHER_SHARE = ReadOnlyMapping({Why.FOCAL_LENGTH_OFF: 0.1, Why.BOARD_SCALE_OFF: 0.02})

#: What residuals are said to be if nothing explains them.
_RESIDUAL_NOISE = (Why.NOISE_LARGE, Why.NOISE_ABOVE_SIGMA)

#: The corrections of an arm are not its own if the delay of joint values has more than this share of their effect.
_LIKE_THE_ARM = 0.5

#: A larger change of a parameter is not an error of an arm [m or rad].
_TOO_FAR = 0.1

#: A geometry that would leave far less needs care if more than this share of the error remains.
_LACKING = 0.2

#: Another model whose error or noise is less than this share represents errors that this one lacks.
FAR_LESS = 0.6


def judge(evidence: Evidence) -> Verdict:
    """Judge a calibration by its errors on held-out rows.

    Args:
        evidence: The figures of the corrected URDF, or of the non-geometric model.

    Returns:
        ``use``, ``use with care`` or ``do not use``, with the reasons: wrong input, rows that no other can check,
        others against it, for care, gains, what can be improved, information. If errors are such as no arm has, the
        input is wrong: ``do not use``, for that reason alone, or joint values that are late before it.
    """
    before, after, validation = evidence.before, evidence.after, evidence.validation

    # Errors that no arm has: the input must be wrong, and little else about such a fit means anything.
    far = is_absurd(before) and evidence.largest > _TOO_FAR
    turned = after[_ANGLE.symbol].rms > _ANGLE.absurd
    noisy = absurd_noise(evidence.noise)
    absurd = [
        *_applicable(
            (far, Reason.of(Why.PARAMETER_ABSURD, before=before, largest=evidence.largest))
        ),
        *([] if noisy is None else [noisy]),
        *_applicable((turned, Reason.of(Why.ORIENTATION_ABSURD, after=after))),
    ]
    if absurd:
        # Joint values that are late may be the cause, which their effect on held-out rows shows; or pictures.
        causes = [doubt for doubt in evidence.doubts if _may_cause_any_error(doubt)]
        return Verdict(NO, (*causes, absurd[0]))

    against = _against(evidence)
    care = _care(evidence, against)

    # What can be improved is not a reason for care if held-out rows prove the gain.
    few = (evidence.few or evidence.handful) and not against
    unseen = any(reason.why.group is Group.NOT_SEEN for reason in against)
    too_rough = before.leading.unit == "px" and unseen
    improvements = _applicable(
        (few, Reason.of(Why.FEW_NUMBERS, **evidence.counts, parameters=evidence.parameters)),
        (evidence.accidents, _many_outliers(evidence)),
        (too_rough, Reason.of(Why.CAMERA_TOO_ROUGH)),
    )
    improvements += _doubts(evidence, Role.IMPROVE)
    if evidence.scale_decides and not against:
        # What the scale does over the joint limits, and its share of the nominal robot's error there.
        effect = evidence.by_scale
        share = effect / max(evidence.expected_of_nominal, effect)
        care.append(Reason.of(Why.SCALE_HIDDEN, scale=evidence.scale, effect_m=effect, share=share))
    elif not evidence.proven and not against:
        care += improvements
        improvements = []
        care = care or [Reason.of(Why.SMALL_GAIN, **_over_limits(evidence))]

    use = USE
    if care:
        use = CARE
    if against:
        use = NO

    # The gain on held-out and on validation rows.
    held_out = {**_both(evidence), "outliers": evidence.flagged}
    gains = _applicable(
        (evidence.gain > 0.0, Reason.of(Why.GAIN, **held_out)),
        (validation.show_a_gain, Reason.of(Why.VALIDATION_GAIN, **validation.values)),
    )
    # Held-out errors hang on a row that alone determines an error of the arm: no other row can predict it.
    hanging = [reason for reason in against if reason.why.role is Role.AGAINST]
    wrong_input = [reason for reason in against if reason not in hanging]
    alone = [reason for reason in care if reason.why is Why.SOLE_POSTURE]
    of_pictures = [reason for reason in care if reason.why.group is Group.PICTURES]
    care = [reason for reason in care if reason not in (*alone, *of_pictures)]
    information = _doubts(evidence, Role.INFORMATION)
    others = (*gains, *improvements, *information, *evidence.notes)
    return Verdict(use, (*of_pictures, *wrong_input, *alone, *hanging, *care, *others))


def _may_cause_any_error(doubt: Reason) -> bool:
    """Return whether a doubt is about what an error of any size may come from: late joints, or pictures."""
    return doubt.why is Why.JOINTS_LATE or doubt.why.group is Group.PICTURES


def absurd_noise(noise: Mapping[str, float]) -> Reason | None:
    """Return the reason that no arm or instrument has such noise, which needs no held-out rows; None if one may have.

    Args:
        noise: Standard deviation of one scalar as estimated, by the symbol of its unit [m], [rad], [px].
    """
    absurd = {f"noise_{unit}": std for unit, std in noise.items() if _exceeds(std, unit)}
    return Reason.of(Why.NOISE_ABSURD, **absurd) if absurd else None


def _against(evidence: Evidence) -> list[Reason]:
    """List the reasons not to use the corrected robot; empty if there is none.

    They are all signs of wrong input, the weightiest of the other reasons, and validation rows whose error does not
    fall.
    """
    unproven, at_noise_level = evidence.unproven, evidence.at_noise_level
    validation = evidence.validation
    sufficient = evidence.noise_is_plausible and not evidence.few_for_full_model
    nothing = unproven and at_noise_level and sufficient
    few = evidence.few or (at_noise_level and evidence.few_for_full_model)
    too_few = unproven and (evidence.handful or few)
    counts = {**evidence.counts, "parameters": evidence.most_parameters, "gain": evidence.gain}
    many = unproven and evidence.many_flagged and not evidence.accidents
    good_where_measured = evidence.proven_where_measured and evidence.expected < _LENGTH.absurd
    much_expected = evidence.unpredictable and evidence.remains_everywhere > REMAINS
    elsewhere = much_expected and not good_where_measured

    # Validation rows may show that the corrected URDF is better.
    shown = validation.show_a_gain and evidence.gain > 0.0
    hopeless = unproven and _has_better(evidence) and not shown

    both = _both(evidence)
    worse = replace(_many_outliers(evidence), why=Why.WORSE_WITH_OUTLIERS)
    first = _applicable(
        (nothing, Reason.of(Why.NOTHING_TO_GAIN, before=evidence.before)),
        (is_absurd(evidence.after), Reason.of(Why.STILL_FAR_OFF, **both)),
        (hopeless, _better(Why.NO_URDF_HOLDS, evidence)),
        (too_few, Reason.of(Why.TOO_FEW, **both | counts)),
        (evidence.gain <= 0.0, Reason.of(Why.NO_BETTER, **both)),
        (evidence.worse_with_outliers, worse),
        (many, _many_outliers(evidence)),
        (elsewhere, Reason.of(Why.UNKNOWN_ELSEWHERE, **_over_limits(evidence))),
    )[:1]

    fails = validation.exist and not validation.fall
    no_better = Reason.of(Why.VALIDATION_NO_BETTER, **validation.values)
    wrong_input = _doubts(evidence, Role.WRONG_INPUT)
    if _is_another_measurement(evidence, evidence.before):
        wrong_input.append(_validation_unlike(evidence))
        fails = False
    return [*wrong_input, *first, *_applicable((fails, no_better))]


def _care(evidence: Evidence, against: list[Reason]) -> list[Reason]:
    """List the reasons for care, doubts about given values first; ``against`` are those not to use it at all.

    If there are any of these, most doubts about the gain fall away.
    """
    usable = not against
    before, after, validation = evidence.before, evidence.after, evidence.validation
    given, others = _doubts(evidence, Role.GIVEN), _doubts(evidence, Role.CARE)

    # What a larger model explains is neither chance nor noise: it remains.
    explained = _has_better(evidence)
    much_remains = evidence.remains_held_out > REMAINS and (explained or not evidence.unproven)
    if explained:
        much_remains |= any(reason.why in _RESIDUAL_NOISE for reason in others)
        others = [reason for reason in others if reason.why not in _RESIDUAL_NOISE]
    may_be_chance = evidence.gain > 0.0 and evidence.unproven
    about_gain = _applicable(
        (usable and much_remains, _better(Why.MUCH_REMAINS, evidence)),
        (usable and may_be_chance, Reason.of(Why.MAY_BE_CHANCE, gain=evidence.gain)),
        (is_absurd(before), Reason.of(Why.FAR_OFF_BEFORE, before=before)),
        (
            usable and evidence.unpredictable,
            Reason.of(Why.UNKNOWN_ELSEWHERE, **_over_limits(evidence)),
        ),
        (
            usable and validation.fall_little,
            Reason.of(Why.VALIDATION_SMALL_GAIN, **validation.values),
        ),
    )

    unlike = _is_another_measurement(evidence, after)
    unlike = unlike and not _is_another_measurement(evidence, before)
    many = evidence.many_flagged and not evidence.accidents
    stated = any(reason.why is Why.MANY_OUTLIERS for reason in against)
    about_rows = _applicable(
        (
            evidence.largest > _TOO_FAR,
            Reason.of(Why.PARAMETER_FAR, largest=evidence.largest),
        ),
        (unlike, _validation_unlike(evidence)),
        (many and not stated, _many_outliers(evidence)),
    )

    return [*given, *about_gain, *others, *about_rows]


def _is_another_measurement(evidence: Evidence, held_out: Errors) -> bool:
    """Return whether errors on validation rows are far beyond either robot's on held-out rows, in any unit."""
    fresh = evidence.validation.after
    return any(
        fresh[unit].rms > _ANOTHER_MEASUREMENT * held_out[unit].rms > 0.0
        for unit in fresh.units
        if unit in held_out.units
    )


def _validation_unlike(evidence: Evidence) -> Reason:
    """Make the reason that errors on validation rows are unlike those of held-out rows."""
    fresh = evidence.validation.after
    rows = fresh.leading.n
    return Reason.of(Why.VALIDATION_UNLIKE, rows=rows, before=fresh, after=evidence.after)


def _doubts(evidence: Evidence, role: Role) -> list[Reason]:
    """List the findings besides errors whose role in the verdict on this evidence is the given one."""
    return [doubt for doubt in evidence.doubts if _role(doubt, evidence) is role]


def _role(doubt: Reason, evidence: Evidence) -> Role:
    """Return the role of a finding (a doubt besides errors) in the verdict: that of its code, or one by its values."""
    why, values = doubt.why, doubt.values
    # A focal length or a board that is far off is another camera, resolution or board, or a square not measured.
    if why in _OTHER_SHARE and abs(float(values["share"])) > _OTHER_SHARE[why]:
        return Role.WRONG_INPUT
    if why is Why.JOINTS_LATE and values["over_arm"] > _LIKE_THE_ARM:
        return Role.WRONG_INPUT
    # A drift or a step that does not predict held-out rows explains nothing.
    if not values.get("falls", 1.0) >= PREDICTS:
        return Role.INFORMATION
    # A geometry can be named, a non-geometric model is stated beside the URDF anyway.
    is_geometry = why is Why.MODEL_LACKS and "+" not in values["non_geometric"]
    if is_geometry and not evidence.remains_held_out <= _LACKING:
        return Role.CARE
    return why.role


def _applicable(*rules: tuple[bool, Reason]) -> list[Reason]:
    """List the reasons of those rules, each a condition and a reason, whose condition holds, in their order."""
    return [reason for holds, reason in rules if holds]


def _both(evidence: Evidence) -> dict[str, Any]:
    """Return values of a reason: errors of both robots on held-out rows, and the method of cross-validation."""
    return {
        "before": evidence.before,
        "after": evidence.after,
        "method": evidence.calibrated.method,
    }


def _many_outliers(evidence: Evidence) -> Reason:
    """Make the reason that many rows are flagged, with both robots' errors on held-out rows that include them."""
    return Reason.of(
        Why.MANY_OUTLIERS,
        flagged=evidence.flagged,
        rows=len(evidence.outliers),
        before=evidence.nominal.errors,
        after=evidence.calibrated.errors,
    )


def _over_limits(evidence: Evidence) -> dict[str, float]:
    """Return values of a reason: the expected error over the joint limits [m], and its share of the nominal one's."""
    return {"expected_m": evidence.expected, "remains": evidence.remains_everywhere}


def _has_better(evidence: Evidence) -> bool:
    """Return whether the non-geometric model, if there is one, has far smaller errors on held-out rows."""
    if evidence.non_geometric is None:
        return False
    return evidence.non_geometric[1].leading.rms < FAR_LESS * evidence.after.leading.rms


def _better(why: Why, evidence: Evidence) -> Reason:
    """Make a reason ``why`` with the errors of both robots and the share of the nominal one's that remains.

    Name and errors of the non-geometric model are added if these are far smaller. All errors are of held-out rows.
    """
    unit = evidence.before.leading.unit
    free_before, free_after = evidence.free_of_noise
    values: dict[str, Any] = {
        **_both(evidence),
        "remains": evidence.remains_held_out,
        f"free_before_{unit}": free_before,
        f"free_after_{unit}": free_after,
    }
    if _has_better(evidence) and evidence.non_geometric is not None:
        model, less = evidence.non_geometric
        values |= {"model": model, "less": less}
    return Reason.of(why, **values)


def is_absurd(errors: Errors) -> bool:
    """Return whether the rms error in a unit other than of orientations is beyond any uncalibrated arm.

    Args:
        errors: Errors of a robot.
    """
    return any(_exceeds(errors[unit].rms, unit) for unit in errors.units)


def _exceeds(value: float, unit: str) -> bool:
    """Return whether an error or noise, in its SI unit or [px], is beyond any arm; never for orientations."""
    return unit != _ANGLE.symbol and value > RESIDUAL_UNITS[unit].absurd
