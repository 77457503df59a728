"""The verdict in words: its reasons, rows outside of the measured range, weights that were lowered."""

from __future__ import annotations

import string
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calib.diagnosis.coverage import OutsideRow
from calib.diagnosis.reasons import NO, Reason, Verdict, Why
from calib.result.robustness import Robustness

#: Rows that a sentence names one by one.
_NAMED = 3

_OFF = (
    "The nominal robot is {given_m:mm.0f} mm rms off, more than any uncalibrated arm, but only "
    "{error_m:mm.1f} mm if "
)
_TURNED = "The nominal robot's orientations are {given_rad:deg.0f} deg rms off, but only {error_rad:deg.1f} deg if "
_ANEW = "The rms is {given_m:mm.3g} mm with frame and target of the result, but only {error_m:mm.3g} mm if the "
_NOT_NOISE = "The residuals are not noise: "
_SHARE = "explains {share:%.0f} % of them (by chance {chance:%.0f} %; {chance_p})"
_FALLS = "Without it the error of held-out blocks of rows {falls_by}."
_CHANGED = "Did the arm, its tool or the instrument change in between?"
_RIGHT = "are base and tip, the joint columns and their signs right, do the measurements belong to these joint values"

#: What each code says; a number is written as ``{name:unit.digits}``.
SENTENCES = {
    Why.TARGET_ELSEWHERE: _OFF + "the target is found from the data: leave out --fix-target.",
    Why.WRONG_UNIT: _OFF
    + "the {what} are in {unit}, although the header says {header}: correct the header.",
    Why.OTHER_BASE: _OFF + "the points are in the frame of '{link}': try --base {link}.",
    Why.OWN_FRAME: _OFF + "the points are not in the frame of the base: try --frame estimate.",
    Why.JOINTS_TURNED: _OFF + "the sign of {joints} is reversed: check which way the values count.",
    Why.JOINT_ZERO: _OFF + "{add_rad:deg.0f} deg is added to '{joint}': check its zero.",
    Why.COLUMNS_SWAPPED: _OFF
    + "the columns '{first}' and '{second}' are swapped: check the header.",
    Why.POSES_INVERSE: _OFF
    + "the poses are inverted: give the target in the measurement frame, not the frame in the "
    "target (what solvePnP gives is the board in the camera).",
    Why.COLUMNS_REVERSED: _OFF + "the joint columns are in reverse order: check the header.",
    Why.ROWS_SHIFTED: _OFF
    + "joint values and measurements are shifted by one row against each other: check which "
    "measurement belongs to which pose.",
    Why.OTHER_TIP: _OFF + "the target moves with '{link}': try --tip {link}.",
    Why.JOINT_CONSTANT: _OFF
    + "'{joint}' moved, although its column holds one value: give the values that it had.",
    Why.SCALAR_ELSEWHERE: _TURNED
    + "the quaternions have their scalar {scalar}: give it in the column qw.",
    Why.ORIENTATIONS_INVERSE: _TURNED
    + "they are inverted: give those of the target in the measurement frame.",
    Why.SIGN_TURNED: _OFF + "the sign of '{column}' is wrong.",
    Why.POINTS_MIRRORED: _OFF
    + "the points are mirrored: two of the columns x, y and z are swapped, or one has the "
    "wrong sign.",
    Why.PARAMETER_ABSURD: "The nominal robot is {before_m:mm.0f} mm rms off on unseen rows, and the fit moves a "
    f"parameter by {{largest:mm.0f}} mm or mrad, more than any arm is off: {_RIGHT}, and is each set-up a group of its "
    "own?",
    Why.NOISE_ABSURD: "The residuals are {noise_m:mm.0f} mm per coordinate, which no arm or instrument explains: "
    f"{_RIGHT}, and are these measurements in the base frame (otherwise: --frame estimate)?",
    Why.ORIENTATION_ABSURD: "On unseen rows the calibrated robot's orientations are {after_rad:deg.0f} deg rms off: "
    "are they inverted, is the quaternion's scalar in the column qw, are rx, ry, rz a rotation vector?",
    Why.NO_URDF_HOLDS: "No URDF can hold these errors: on unseen rows ({method}) the corrected robot is {after} off "
    "(the nominal one {before}); the non-geometric model '{model}' leaves {less}. Keep the URDF, and send "
    "compensated commands (calib compensate with the result file).",
    Why.NOTHING_TO_GAIN: "Nothing to gain: the nominal robot is {before} off on unseen rows, which is about their "
    "noise. Keep its URDF.",
    Why.STILL_FAR_OFF: "On unseen rows ({method}) the calibrated robot is {after_m:mm.0f} mm rms off.",
    Why.TOO_FEW: "{measured} are too few for {parameters} parameters: no gain is proven on unseen rows ({change}, "
    "{gain:.1f} standard errors). Measure more poses.",
    Why.NO_BETTER: "On unseen rows ({method}) the calibrated robot is no better than the nominal one, frame and "
    "target fitted for both: {after} against {before}.",
    Why.VALIDATION_NO_BETTER: "On the {rows} validation rows the error does not fall: {change}.",
    Why.TARGET_FAR: "The target{named} was found {far_m:mm.0f} mm from where it was given: check the sign and the "
    "order of the numbers, and the tip.",
    Why.BASE_MOVED: "The base, or the first joint's axis in it, is not where the measurement frame puts it, but "
    "{moved_m:mm.1f} mm and {turned_rad:deg.2f} deg off. This moves the points by {effect_m:mm.1f} mm rms, all other "
    "corrections of the arm by {arm_m:mm.1f} mm. Unless the measurement frame is aligned with the base better than "
    "that, add --frame estimate.",
    Why.MUCH_REMAINS: "Much of the error remains: {remains:%.0f} % on unseen rows, noise aside ({change}).{better}",
    Why.VALIDATION_SMALL_GAIN: "On the {rows} validation rows{rows_aside} the error hardly falls: {change}.",
    Why.JOINTS_LAG: _NOT_NOISE
    + "they follow the last move of the joints, which "
    + _SHARE
    + ": the joints miss about "
    f"{{of_move:%.2f}} % of that move, '{{joint}}' most. {_FALLS} Measure at standstill, and read the joint values "
    "then; if gears have play, approach poses from one side.",
    Why.MAY_BE_CHANCE: "The gain on unseen rows may be chance: it is {gain:.1f} standard errors. Measure more poses.",
    Why.FEW_NUMBERS: "{measured} with {numbers} numbers for {parameters} parameters are few: the result leans on the "
    "priors. Measure more poses.",
    Why.FAR_OFF_BEFORE: "The nominal robot is {before_m:mm.0f} mm rms off on unseen rows, more than any uncalibrated "
    "arm. Is it the right URDF?",
    Why.JOINTS_STILL: "Joints that hardly moved: {joints}. Their errors are known near these values only; measure "
    "poses that move every joint.",
    Why.SOLE_POSTURE: "{sole}; no other row can check this, nor is it cross-validated. Measure {anew} again, and add "
    "poses with {those} at other values.",
    Why.MODEL_LACKS: "The model '{model}' leaves residuals of {noise_m:mm.3f} mm per coordinate, "
    "'{non_geometric}' would leave {less_m:mm.3f} mm: the robot has errors that this model lacks. Try --model auto.",
    Why.CORNER: "Only part of the joints' ranges was measured: {ranges}. Beyond, the result is extrapolated. The "
    "measured tip positions spread {spread:%.0f} % as far as the joint limits allow.",
    Why.JOINT_PATTERN: _NOT_NOISE + "the {quantity} of '{joint}' " + _SHARE + ".",
    Why.DRIFT: f"{_NOT_NOISE}they drift in the order of the rows, which {_SHARE}. {_FALLS} Did something warm up, or "
    "move?",
    Why.SETUP_UNPREDICTED: "The other set-ups do not predict set-up '{setup}': a fit without it leaves errors there "
    "{ratio:.1f} times those expected. " + _CHANGED,
    Why.SETUP_FLAGGED: "{flagged} of the {rows} rows of set-up '{setup}' are flagged as outliers: it does not agree "
    "with the others. " + _CHANGED,
    Why.REPEATS_AGREE: "Repeats of a pose scatter by {within_m:mm.3f} mm per coordinate, but the residuals are "
    "{noise_m:mm.3f} mm: the robot has errors that the model lacks.",
    Why.NO_LENGTH: "No length was measured, so the size of the arm stays nominal: to find it, measure the distance "
    "between two sockets, and give it in the cell file ([[distances]]).",
    Why.PARAMETER_FAR: "A parameter has moved by {largest:mm.0f} mm or mrad, which is no error of an arm. Keep the "
    "priors on, or choose a smaller model.",
    Why.VALIDATION_UNLIKE: "The calibrated robot is {before} off on the {rows} validation rows and {after} on held-out "
    "rows: was the target or the frame another one there?",
    Why.MANY_OUTLIERS: "{flagged} of {rows} rows are flagged as outliers: do they share a set-up, a time or a region? "
    "With them the error on unseen rows goes {change}.",
    Why.WORSE_WITH_OUTLIERS: "On all unseen rows, including the {flagged} flagged ones, the error rises {change}: "
    "these are no accidents, but show errors that the model lacks.",
    Why.UNKNOWN_ELSEWHERE: "Over the joint limits an error of {expected_m:mm.1f} mm rms is to be expected, "
    "{remains:%.0f} % of the nominal robot's: these poses do not determine the parameters. Measure all over the "
    "workspace, or choose a smaller model.",
    Why.SMALL_GAIN: "The error falls by little, or only near the measured poses: over the joint limits "
    "{remains:%.0f} % of it is expected to remain.",
    Why.NOISE_LARGE: "The residuals are {noise_m:mm.1f} mm per coordinate, more than instruments have: are the joint "
    "values exact, taken at standstill and of the same pose as the measurement? If this is the instrument's noise, "
    "state it as sigma.",
    Why.NOISE_ABOVE_SIGMA: "The residuals are {ratio:.0f} times the noise that the table or the cell states: "
    "{after} in each coordinate against {before}. Is that noise right, and are the joint values exact?",
    Why.JOINTS_COARSE: "The values of '{joint}' are multiples of {beyond}, and rounding explains {share:%.0f} % of "
    "the residuals: give the joint values as precisely as the controller knows them.",
    Why.TARGET_STEP: f"{_NOT_NOISE}from row {{row}} on the target '{{target}}' sits {{moved_m:mm.2f}} mm elsewhere in "
    f"the tip, which {_SHARE}. {_FALLS} Was it knocked, or mounted anew? Then give it another name in the column "
    "'target' from there on.",
    Why.LENGTHS_SCALED: "All lengths of the robot together are {scale:%+.2f} % off (standard error {std:%.2f} %), "
    "more than any arm: check the instrument's scale (the size of a printed board, a tracker's temperature, the unit).",
    Why.COMPLIANCE_NEGATIVE: "'{joint}' would move against its load: that is no compliance. Are masses, payload and "
    "gravity's direction right?",
    Why.GAIN: "On unseen rows ({method}{outliers_aside}) the error falls {change}.",
    Why.LARGER_MODEL: "With the non-geometric model '{model}' it would be {after} ({use}). No URDF can hold that; "
    "calib compensate and predict() use it.",
    Why.LARGER_NO_CLOSER: "The non-geometric model '{model}' brings positions no closer: {after}.",
    Why.SCALE_HIDDEN: "A scale error of the instrument of up to {scale:%.2f} % ({effect_m:mm.2f} mm at "
    "{reach_m:mm.0f} mm from the base) could hide in the arm's lengths. If its scale is certified, say so in the cell "
    "file: scale_certified = true.",
    Why.ROWS_COPIED: "{rows} rows (the first is row {row}) are copies of others to the last digit, and were left "
    "out.",
    Why.VALIDATION_GAIN: "On the {rows} validation rows{rows_aside} it falls {change}.",
    Why.OUTSIDE: "{rows} validation rows lie outside the range of the fitted joint values, where errors may be larger: "
    "'{joint}' in row {row} by {beyond}.",
    Why.FRAME_MOVED: _ANEW
    + "measurement frame is registered anew: did the tracker or the robot move? Then add "
    "--frame estimate.",
    Why.TARGET_MOVED: _ANEW
    + "target is registered anew: was it mounted anew? Then give its place with --target.",
}


def reason_text(reason: Reason) -> str:
    """A reason of a verdict as a sentence."""
    v = reason.values
    units = (("m", 1e3, "mm"), ("rad", float(np.degrees(1.0)), "deg"))
    before, after = (
        [f"{k * v[f'{name}_{si}']:.3f} {unit}" for si, k, unit in units if f"{name}_{si}" in v]
        for name in ("before", "after")
    )
    first = [before[0].split()[0]] if len(before) == 1 else before  # the unit once is enough
    measured = [f"{v[of]} {words}" for of, words in _MEASURED if v.get(of)]
    p = v.get("p", 1.0)
    beyond = [f"{k * v[f'by_{si}']:.3g} {unit}" for si, k, unit in units if f"by_{si}" in v]
    more = {"named": f" '{v['target']}'" if v.get("target") else "", "ranges": _ranges(v)}
    if "rows" in v and "joints" in v:
        more |= _sole_postures(v["rows"], v["joints"])
    if "less_m" in v and "model" in v:
        more["less"] = f"{1e3 * v['less_m']:.3f} mm rms"
    words = {
        **v,
        **more,
        "falls_by": f"falls by {100.0 * v.get('falls', 0.0):.0f} %"
        if v.get("falls", 0.0) > 0.0
        else "does not fall",
        "better": _BETTER.format(**v, **more) if "less" in more and "remains" in v else "",
        "before": f"{' and '.join(before)} rms",
        "after": f"{' and '.join(after)} rms",
        "change": f"from {' and '.join(first)} to {' and '.join(after)} rms",
        "measured": " and ".join(measured),
        "beyond": "".join(beyond),
        "chance_p": "p < 1e-6" if p < 1e-6 else f"p = {p:.1g}",
        "outliers_aside": ", outliers aside" * bool(v.get("outliers")),
        "rows_aside": f" ({v['aside']} more aside)" if v.get("aside") else "",
    }
    text = _Units().vformat(SENTENCES[reason.why], (), words)
    return " ".join([text, *(_as_well(reason, other) for other in v.get("others", ()))])


def _sole_postures(rows: Sequence[int], joints: Sequence[str]) -> Mapping[str, str]:
    """Words for rows that alone determine the errors of a joint each."""
    parts = []
    for joint in dict.fromkeys(joints):
        own = [str(row) for row, other in zip(rows, joints, strict=True) if other == joint]
        several = "rows " + ", ".join(own[:-1]) + f" and {own[-1]}"
        who, verb = (f"row {own[0]}", "determines") if len(own) == 1 else (several, "determine")
        parts.append(f"{who} alone {verb} the errors of joint '{joint}'")
    text, one = "; ".join(parts), len(rows) == 1
    return {
        "sole": text[0].upper() + text[1:],
        "anew": f"row {rows[0]}" if one else "them",
        "those": "this joint" if len(set(joints)) == 1 else "these joints",
    }


#: What stands behind a reason that much remains, where another model leaves far less.
_BETTER = (
    " The non-geometric model '{model}' leaves {less}. No URDF can hold it: send compensated commands (calib "
    "compensate with the result file)."
)


def _as_well(reason: Reason, other: Mapping[str, Any]) -> str:
    """Another set-up that explains the rows as well as the one that a reason names."""
    values = {"given_m": reason.values["given_m"], **other}
    sentence = SENTENCES[Why[str(other["code"]).upper()]].removeprefix(_OFF)
    text = _Units().vformat(sentence, (), values)
    return f"Or else ({1e3 * other['error_m']:.1f} mm): {text}"


def _ranges(v: Mapping[str, Any]) -> str:
    """Which part of their ranges joints moved in."""
    ends = (v.get(name, ()) for name in ("joints", "shares", "lows", "highs", "slides"))
    if isinstance(v.get("joints"), str) or "shares" not in v:
        return ""
    parts = []
    for joint, share, low, high, slides in zip(*ends, strict=True):
        scale, unit = (1e3, "mm") if slides else (float(np.degrees(1.0)), "deg")
        reach = f"{scale * low:.0f} to {scale * high:.0f} {unit}"
        parts.append(f"'{joint}' from {reach} ({100.0 * share:.0f} %)")
    return ", ".join(parts)


def against(verdict: Verdict | None) -> str:
    """Word the verdict ``do not use`` and its first reason in one line.

    Args:
        verdict: The verdict; None where nothing was judged.

    Returns:
        Such as ``do not use (no_better): On unseen rows ...``; empty for any other verdict, and for none.
    """
    if verdict is None or verdict.use != NO:
        return ""
    reasons = [f"({first.code}): {reason_text(first)}" for first in verdict.reasons[:1]]
    return " ".join([NO, *reasons])


def refusal(name: str, verdict: str) -> str:
    """The message of a `calib.errors.VerdictError`.

    Args:
        name: What the verdict is on: a file in quotes, or "this calibration".
        verdict: What speaks against it, as `against` has it.

    Returns:
        The verdict, that nothing was written because of it, and how to write it all the same, in one line.
    """
    return (
        f"the verdict on {name} is: {verdict} So nothing was written that a robot could be given; to write it all the "
        "same, add --accept (in Python accept=True)."
    )


_MEASURED = (("poses", "poses"), ("pairs", "pairs of poses"))


class _Units(string.Formatter):
    """Numbers in the unit that stands before their format: ``{noise_m:mm.3f}``."""

    def format_field(self, value: Any, format_spec: str) -> Any:  # noqa: ANN401
        for unit, scale in (("mm", 1e3), ("deg", float(np.degrees(1.0))), ("%", 100.0)):
            if format_spec.startswith(unit):
                return format(scale * value, format_spec.removeprefix(unit))
        return format(value, format_spec)


def outside_text(rows: Sequence[OutsideRow], numbers: Sequence[int]) -> str:
    """The rows outside of the measured range, the furthest joints of the first few; empty when there are none.

    ``numbers`` has the number of each row that was asked about as a person sees it.
    """
    parts = []
    for row in rows[:_NAMED]:
        units = [(1e3, "mm") if b.prismatic else (np.degrees(1.0), "deg") for b in row.beyond]
        far = [
            f"'{b.joint}' {k * b.by:.3g} {u}" for b, (k, u) in zip(row.beyond, units, strict=True)
        ]
        parts.append(f"row {numbers[row.index]}: {', '.join(far)} beyond the measured range")
    more = len(rows) - _NAMED
    parts += [f"and {more} more row{'s' * (more > 1)}"] * (more > 0)
    return "; ".join(parts)


def robustness_text(found: Robustness) -> str:
    """What lowering the weights of doubtful rows comes to."""
    now, other, how = found.errors_lowered, found.errors_full, "With full"
    if not found.lowered:
        now, other, how = other, now, "With lowered"
    text = (
        f"{how} weight these rows would move the prediction by {1e3 * found.moved_rms:.3f} mm rms at the measured "
        f"poses, {1e3 * found.moved_max:.3f} mm at most"
    )
    if now.n:
        text += f", and the held-out error of the others from about {1e3 * now.rms:.3f} to "
        text += f"{1e3 * other.rms:.3f} mm rms"
    return text + "."
