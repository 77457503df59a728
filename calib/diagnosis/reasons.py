"""Reasons of a verdict: codes and the numbers that they rest on; the sentences are in `calib.text.verdict`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

from calib.numerics.errors import Errors

USE, CARE, NO = "use", "use with care", "do not use"


class Why(Enum):
    """The codes; `calib.text.verdict.SENTENCES` has the sentence of each."""

    # Another set-up explains the rows
    TARGET_ELSEWHERE, WRONG_UNIT, OTHER_BASE, OWN_FRAME, JOINTS_TURNED = range(5)
    JOINT_ZERO, COLUMNS_SWAPPED, SIGN_TURNED, POINTS_MIRRORED = range(5, 9)
    POSES_INVERSE, COLUMNS_REVERSED, ROWS_SHIFTED, OTHER_TIP = range(80, 84)
    JOINT_CONSTANT, SCALAR_ELSEWHERE, ORIENTATIONS_INVERSE = range(84, 87)
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
    # What is gained, and information
    GAIN, LARGER_MODEL, VALIDATION_GAIN, OUTSIDE, LARGER_NO_CLOSER, ROWS_COPIED = range(60, 66)
    SCALE_HIDDEN = 66
    # What explains the errors of newly measured rows
    FRAME_MOVED, TARGET_MOVED = range(70, 72)


@dataclass(frozen=True, slots=True)
class Reason:
    """One reason of a verdict."""

    why: Why  # The code
    values: Mapping[str, Any]  # The numbers and names of its sentence, in SI units

    @classmethod
    def of(cls, why: Why, **values: Any) -> Reason:  # noqa: ANN401
        """Make a reason; of `Errors` the rms is stored, as ``before_m`` and ``before_rad``, if they were measured."""
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
