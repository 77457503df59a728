"""Reasons of a verdict: codes and the numbers that they rest on; the sentences are in `calib.show.verdict_text`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any

from calib.basics.values import keep_read_only
from calib.errors import ArgumentError, choices
from calib.numerics.errors import Errors

#: Verdict that the corrected robot is better, which held-out rows prove.
USE = "use"

#: Verdict that it may be better, or that something about the measurements is in doubt.
CARE = "use with care"

#: Verdict that it is not better, or that the input is wrong.
NO = "do not use"

#: All verdicts; there is no other word.
VERDICTS = (USE, CARE, NO)


class Role(Enum):
    """The effect of a reason on the verdict; of some reasons it depends on their values too."""

    #: The input is wrong, however well it fits: do not use
    WRONG_INPUT = auto()
    #: The corrected robot is not better: do not use
    AGAINST = auto()
    #: A given value is in doubt: use with care, stated before all other doubts
    GIVEN = auto()
    #: Use with care
    CARE = auto()
    #: Something to improve: use with care only if the gain is not proven
    IMPROVE = auto()
    #: Stated, but decides nothing
    INFORMATION = auto()


class Group(Enum):
    """Reasons of different roles that the rules treat alike."""

    #: The residuals may not be the measurements' noise
    NOT_NOISE = auto()
    #: Better measurements may show a gain after all
    NOT_SEEN = auto()
    #: Mistakes of some pictures, which are stated before all else
    PICTURES = auto()


class Why(str, Enum):
    """Reasons by their codes in the result file; `calib.show.verdict_text.SENTENCES` has a sentence for each."""

    #: The effect on the verdict
    role: Role
    #: The group, if any
    group: Group | None

    def __new__(cls, code: str, role: Role, group: Group | None = None) -> Why:
        """Make the entry of a reason: a text, its code, with its role in a verdict and its group (None: no group)."""
        why = str.__new__(cls, code)
        why._value_ = code
        why.role = role
        why.group = group
        return why

    # A usual mistake explains the rows
    TARGET_ELSEWHERE = "target_elsewhere", Role.WRONG_INPUT
    WRONG_UNIT = "wrong_unit", Role.WRONG_INPUT
    OTHER_BASE = "other_base", Role.WRONG_INPUT
    OTHER_TIP = "other_tip", Role.WRONG_INPUT
    OWN_FRAME = "own_frame", Role.WRONG_INPUT
    JOINTS_TURNED = "joints_turned", Role.WRONG_INPUT
    JOINT_ZERO = "joint_zero", Role.WRONG_INPUT
    JOINT_FACTOR = "joint_factor", Role.WRONG_INPUT
    JOINT_CONSTANT = "joint_constant", Role.WRONG_INPUT
    READINGS_COUPLED = "readings_coupled", Role.WRONG_INPUT
    READINGS_NOT_COUPLED = "readings_not_coupled", Role.WRONG_INPUT
    COLUMNS_SWAPPED = "columns_swapped", Role.WRONG_INPUT
    COLUMNS_REVERSED = "columns_reversed", Role.WRONG_INPUT
    ROWS_SHIFTED = "rows_shifted", Role.WRONG_INPUT
    ROWS_MOVED = "rows_moved", Role.WRONG_INPUT
    SIGN_TURNED = "sign_turned", Role.WRONG_INPUT
    POINTS_MIRRORED = "points_mirrored", Role.WRONG_INPUT
    POSES_INVERSE = "poses_inverse", Role.WRONG_INPUT
    SCALAR_ELSEWHERE = "scalar_elsewhere", Role.WRONG_INPUT
    ORIENTATIONS_INVERSE = "orientations_inverse", Role.WRONG_INPUT
    ORIENTATIONS_JOINT_TURNED = "orientations_joint_turned", Role.WRONG_INPUT
    ORIENTATIONS_JOINT_ZERO = "orientations_joint_zero", Role.WRONG_INPUT
    TWO_MISTAKES = "two_mistakes", Role.WRONG_INPUT
    FLANGE_INVERSE = "flange_inverse", Role.WRONG_INPUT
    FLANGE_OFF = "flange_off", Role.WRONG_INPUT
    FLANGE_CONVENTION = "flange_convention", Role.WRONG_INPUT
    CAMERA_ON_OTHER_LINK = "camera_on_other_link", Role.WRONG_INPUT

    # A mistake in DH rows explains the rows of the table
    DH_CELLS = "dh_cells", Role.WRONG_INPUT
    DH_ROWS_EXCHANGED = "dh_rows_exchanged", Role.WRONG_INPUT
    DH_NUMBERS_EXCHANGED = "dh_numbers_exchanged", Role.WRONG_INPUT
    DH_CONVENTION = "dh_convention", Role.WRONG_INPUT
    DH_VARIANT = "dh_variant", Role.WRONG_INPUT
    DH_UNIT = "dh_unit", Role.WRONG_INPUT

    # A frame was sought and not found
    FRAME_NOT_FOUND = "frame_not_found", Role.WRONG_INPUT

    # No arm has such errors
    PARAMETER_ABSURD = "parameter_absurd", Role.WRONG_INPUT
    NOISE_ABSURD = "noise_absurd", Role.WRONG_INPUT
    ORIENTATION_ABSURD = "orientation_absurd", Role.WRONG_INPUT

    # Frames and targets are not located
    SETUP_UNDETERMINED = "setup_undetermined", Role.AGAINST
    SETUP_UNSURE = "setup_unsure", Role.CARE

    # The corrected robot is not better
    NOTHING_TO_GAIN = "nothing_to_gain", Role.AGAINST, Group.NOT_SEEN
    STILL_FAR_OFF = "still_far_off", Role.AGAINST
    NO_URDF_HOLDS = "no_urdf_holds", Role.AGAINST
    TOO_FEW = "too_few", Role.AGAINST, Group.NOT_SEEN
    NO_BETTER = "no_better", Role.AGAINST, Group.NOT_SEEN
    WORSE_WITH_OUTLIERS = "worse_with_outliers", Role.AGAINST
    UNKNOWN_ELSEWHERE = "unknown_elsewhere", Role.AGAINST
    VALIDATION_NO_BETTER = "validation_no_better", Role.AGAINST
    CHAIN_AGAINST = "chain_against", Role.AGAINST

    # Given values are in doubt
    TARGET_FAR = "target_far", Role.GIVEN
    JOINTS_LATE = "joints_late", Role.GIVEN
    MEASUREMENTS_COMPUTED = "measurements_computed", Role.GIVEN
    OTHER_VARIANT = "other_variant", Role.GIVEN
    BASE_MOVED = "base_moved", Role.GIVEN
    LENGTHS_SCALED = "lengths_scaled", Role.CARE
    SCALE_HIDDEN = "scale_hidden", Role.CARE
    NOISE_LARGE = "noise_large", Role.CARE, Group.NOT_NOISE
    NOISE_ABOVE_SIGMA = "noise_above_sigma", Role.CARE, Group.NOT_NOISE

    # The gain is in doubt
    MUCH_REMAINS = "much_remains", Role.CARE
    MAY_BE_CHANCE = "may_be_chance", Role.CARE
    SMALL_GAIN = "small_gain", Role.CARE
    FAR_OFF_BEFORE = "far_off_before", Role.CARE
    PARAMETER_FAR = "parameter_far", Role.CARE
    COMPLIANCE_NEGATIVE = "compliance_negative", Role.CARE
    CHAIN_CARE = "chain_care", Role.CARE
    VALIDATION_SMALL_GAIN = "validation_small_gain", Role.CARE
    VALIDATION_UNLIKE = "validation_unlike", Role.CARE
    MANY_OUTLIERS = "many_outliers", Role.CARE

    # The measured poses do not determine all that the model has, or the model does not explain the rows
    FEW_NUMBERS = "few_numbers", Role.IMPROVE
    JOINTS_STILL = "joints_still", Role.CARE
    SOLE_POSTURE = "sole_posture", Role.CARE
    CORNER = "corner", Role.IMPROVE
    NO_LENGTH = "no_length", Role.IMPROVE
    HANDS_ALONE = "hands_alone", Role.IMPROVE
    STOPS_ALONE = "stops_alone", Role.IMPROVE
    MODEL_LACKS = "model_lacks", Role.IMPROVE, Group.NOT_NOISE
    REPEATS_AGREE = "repeats_agree", Role.IMPROVE

    # The residuals have a pattern
    JOINT_PATTERN = "joint_pattern", Role.IMPROVE
    JOINTS_COARSE = "joints_coarse", Role.CARE
    JOINTS_LAG = "joints_lag", Role.CARE, Group.NOT_NOISE
    TARGET_STEP = "target_step", Role.CARE
    DRIFT = "drift", Role.CARE
    SETUP_UNPREDICTED = "setup_unpredicted", Role.CARE
    SETUP_FLAGGED = "setup_flagged", Role.CARE

    # Images of a board
    PICTURES_TURNED = "pictures_turned", Role.GIVEN, Group.PICTURES
    PICTURES_EXCHANGED = "pictures_exchanged", Role.GIVEN, Group.PICTURES
    CAMERA_MOVED = "camera_moved", Role.GIVEN, Group.PICTURES
    CAMERA_REFOCUSED = "camera_refocused", Role.GIVEN, Group.PICTURES
    SENSE_REVERSED = "sense_reversed", Role.WRONG_INPUT
    SENSE_UNKNOWN = "sense_unknown", Role.CARE
    FOCAL_LENGTH_OFF = "focal_length_off", Role.GIVEN
    BOARD_SCALE_OFF = "board_scale_off", Role.GIVEN
    CORNERS_OFF = "corners_off", Role.IMPROVE
    BOARD_HEAD_ON = "board_head_on", Role.CARE
    FEW_CORNERS = "few_corners", Role.CARE
    ONE_AXIS = "one_axis", Role.CARE
    CAMERA_TOO_ROUGH = "camera_too_rough", Role.IMPROVE

    # Gains and information
    SETUP_LOCATED = "setup_located", Role.INFORMATION
    GAIN = "gain", Role.INFORMATION
    VALIDATION_GAIN = "validation_gain", Role.INFORMATION
    LARGER_MODEL = "larger_model", Role.INFORMATION
    LARGER_NO_CLOSER = "larger_no_closer", Role.INFORMATION
    STOPS_SHORT = "stops_short", Role.INFORMATION
    CREEPS = "creeps", Role.INFORMATION
    ONE_SIDED = "one_sided", Role.INFORMATION
    OUTSIDE = "outside", Role.INFORMATION
    ALREADY_CORRECTED = "already_corrected", Role.INFORMATION
    ROWS_COPIED = "rows_copied", Role.INFORMATION
    READINGS_TURNED = "readings_turned", Role.INFORMATION
    OTHER_END = "other_end", Role.INFORMATION
    CORNERS_THINNED = "corners_thinned", Role.INFORMATION
    DRIFT_REMOVED = "drift_removed", Role.INFORMATION
    REFERENCES_DRIFT = "references_drift", Role.INFORMATION
    REFERENCES_STEP = "references_step", Role.INFORMATION
    REFERENCES_STILL = "references_still", Role.INFORMATION
    REFERENCES_TOO_FEW = "references_too_few", Role.INFORMATION
    REFERENCE_MOVED = "reference_moved", Role.INFORMATION
    REFERENCE_MISREAD = "reference_misread", Role.INFORMATION
    SIGMA_UNLIKELY = "sigma_unlikely", Role.INFORMATION
    COVARIANCES_IDLE = "covariances_idle", Role.INFORMATION

    # Explanations of the errors of newly measured rows
    FRAME_MOVED = "frame_moved", Role.INFORMATION
    TARGET_MOVED = "target_moved", Role.INFORMATION
    OTHER_SIDES = "other_sides", Role.INFORMATION


@dataclass(frozen=True, slots=True)
class Reason:
    """One reason of a verdict."""

    #: The reason's entry: its code and role
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
            why: Its entry.
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
        """The code, as the result file has it: ``"nothing_to_gain"``."""
        return str(self.why.value)

    @property
    def entry(self) -> dict[str, Any]:
        """The code and the values, as a value of another reason has them."""
        return {"code": self.code, **self.values}

    def with_values(self, **values: Any) -> Reason:  # noqa: ANN401
        """Return the reason with further values before its own; those that it has stay.

        Args:
            **values: Numbers, in SI units, and names.
        """
        return Reason(self.why, {**values, **self.values})

    def with_others(self, others: Sequence[Mapping[str, Any]]) -> Reason:
        """Return the reason with other mistakes that explain the rows as well, as its value ``"others"``.

        Args:
            others: The mistakes as `entry` has them; if there are none, the reason has no such value.
        """
        return Reason(self.why, {**self.values, "others": list(others)}) if others else self


@dataclass(frozen=True, slots=True)
class Verdict:
    """Verdict on the corrected robot, or on the non-geometric model; true if it is ``use``, without reserve.

    Raises:
        ArgumentError: Its word is not one of `VERDICTS`.
    """

    #: ``"use"``, ``"use with care"`` or ``"do not use"``
    use: str
    #: The weightiest first
    reasons: tuple[Reason, ...]

    def __post_init__(self) -> None:
        """Refuse any other word: code that asks only for ``do not use`` would take it for a good verdict."""
        if self.use not in VERDICTS:
            raise ArgumentError(f"A verdict is {choices(VERDICTS)}, not {self.use!r}.")

    def __bool__(self) -> bool:
        """True for ``use`` alone; a result without a verdict has None, which is false too."""
        return self.use == USE
