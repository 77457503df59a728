"""Why a verdict is what it is: codes with their numbers in SI units, and the one table that makes sentences of them."""

from __future__ import annotations

import string
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from calib.identify.statistics import Errors

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
    JOINT_TURNED = _OFF + "{joints} turns the other way: check the signs."
    JOINTS_TURNED = _OFF + "{joints} turn the other way: check the signs."
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
