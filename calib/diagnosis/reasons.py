"""Reasons of a verdict: codes and the numbers that they rest on; the sentences are in `calib.show.verdict`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

from calib.basics.values import keep_read_only
from calib.numerics.errors import Errors

#: Verdict that the corrected robot is better, which held-out rows prove.
USE = "use"

#: Verdict that it may be better, or that something about the measurements is in doubt.
CARE = "use with care"

#: Verdict that it is not better, or that the input is wrong.
NO = "do not use"


class Why(Enum):
    """Codes of reasons; `calib.show.verdict.SENTENCES` has the sentence of each."""

    # A usual mistake explains the rows
    TARGET_ELSEWHERE, WRONG_UNIT, OTHER_BASE, OWN_FRAME, JOINTS_TURNED = range(5)
    JOINT_ZERO, COLUMNS_SWAPPED, SIGN_TURNED, POINTS_MIRRORED = range(5, 9)
    POSES_INVERSE, COLUMNS_REVERSED, ROWS_SHIFTED, OTHER_TIP = range(80, 84)
    JOINT_CONSTANT, SCALAR_ELSEWHERE, ORIENTATIONS_INVERSE = range(84, 87)
    READINGS_COUPLED, READINGS_NOT_COUPLED = range(88, 90)
    ORIENTATIONS_JOINT_TURNED, ORIENTATIONS_JOINT_ZERO = range(90, 92)
    CAMERA_ON_OTHER_LINK = 92
    # A frame was sought and not found
    FRAME_NOT_FOUND = 87
    # No arm has such errors
    PARAMETER_ABSURD, NOISE_ABSURD, ORIENTATION_ABSURD = range(10, 13)
    # It is no better
    NOTHING_TO_GAIN, STILL_FAR_OFF, TOO_FEW, NO_BETTER, VALIDATION_NO_BETTER = range(20, 25)
    WORSE_WITH_OUTLIERS, UNKNOWN_ELSEWHERE, NO_URDF_HOLDS = range(25, 28)
    # Care is needed
    MAY_BE_CHANCE, FEW_NUMBERS, FAR_OFF_BEFORE, JOINTS_STILL, MODEL_LACKS = range(30, 35)
    CORNER, JOINT_PATTERN, DRIFT, SETUP_UNPREDICTED, SETUP_FLAGGED = range(35, 40)
    REPEATS_AGREE, NO_LENGTH, PARAMETER_FAR, VALIDATION_UNLIKE, MANY_OUTLIERS = range(40, 45)
    NOISE_LARGE, NOISE_ABOVE_SIGMA, JOINTS_COARSE, TARGET_STEP = range(45, 49)
    LENGTHS_SCALED, COMPLIANCE_NEGATIVE, SMALL_GAIN = range(49, 52)
    TARGET_FAR, BASE_MOVED, MUCH_REMAINS, VALIDATION_SMALL_GAIN, JOINTS_LAG = range(52, 57)
    SOLE_POSTURE = 57
    # Gains, and information
    GAIN, LARGER_MODEL, VALIDATION_GAIN, OUTSIDE, LARGER_NO_CLOSER, ROWS_COPIED = range(60, 66)
    SCALE_HIDDEN, COVARIANCES_IDLE = 66, 67
    # Images of a board
    SENSE_REVERSED, SENSE_UNKNOWN, FOCAL_LENGTH_OFF, BOARD_SCALE_OFF = range(100, 104)
    BOARD_HEAD_ON, FEW_CORNERS, ONE_AXIS, CAMERA_TOO_ROUGH = range(104, 108)
    # Explanations of the errors of newly measured rows
    FRAME_MOVED, TARGET_MOVED = range(70, 72)


#: Doubts whether the residuals are the measurements' noise.
NOT_NOISE = (Why.MODEL_LACKS, Why.NOISE_LARGE, Why.NOISE_ABOVE_SIGMA, Why.JOINTS_LAG)

#: What can be improved where the gain is proven, and is then no reason for care.
REMAINING = (
    Why.MODEL_LACKS,
    Why.CORNER,
    Why.JOINT_PATTERN,
    Why.REPEATS_AGREE,
    Why.NO_LENGTH,
)

#: Reasons that are stated and decide nothing.
INFORMATION = (Why.SCALE_HIDDEN, Why.COVARIANCES_IDLE)

#: Doubts about given values, which come before all others.
GIVEN = (Why.TARGET_FAR, Why.BASE_MOVED, Why.FOCAL_LENGTH_OFF, Why.BOARD_SCALE_OFF)

#: Doubts that the input is wrong, however well it fits.
WRONG_INPUT = (Why.SENSE_REVERSED,)

#: Reasons against a result that better measurements may lift.
NOT_SEEN = (Why.NOTHING_TO_GAIN, Why.NO_BETTER, Why.TOO_FEW)


@dataclass(frozen=True, slots=True)
class Reason:
    """One reason of a verdict."""

    #: The code
    why: Why
    #: The numbers and names of its sentence, in SI units
    values: Mapping[str, Any]

    def __post_init__(self) -> None:
        """Keep a read-only copy of the mapping."""
        keep_read_only(self, "values")

    @classmethod
    def of(cls, why: Why, **values: Any) -> Reason:  # noqa: ANN401
        """Make a reason.

        Args:
            why: The code.
            **values: Numbers, in SI units, and names. Of `Errors` the rms in each unit that was measured is stored,
                such as ``before_m`` [m] and ``before_rad`` [rad].
        """
        stored: dict[str, Any] = {}
        for name, value in values.items():
            if not isinstance(value, Errors):
                stored[name] = value
                continue
            for unit in value.units:
                stored[f"{name}_{unit}"] = value[unit].rms
        return cls(why, stored)

    @property
    def code(self) -> str:
        """Code in small letters, as the result file has it: ``"nothing_to_gain"``."""
        return self.why.name.lower()


@dataclass(frozen=True, slots=True)
class Verdict:
    """Verdict on the corrected robot, or on the non-geometric model."""

    #: ``"use"``, ``"use with care"`` or ``"do not use"``
    use: str
    #: The weightiest first
    reasons: tuple[Reason, ...]
