"""The verdict in words: its reasons, rows outside of the measured range, weights that were lowered."""

from __future__ import annotations

import string
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calib.diagnosis.augmented_fit import PREDICTS
from calib.diagnosis.reasons import NO, Reason, Verdict, Why
from calib.errors import choices
from calib.show.lines import listed, mm, plural
from calib.show.words import absurd_size, joint_unit, sizes_of

_DEG = float(np.degrees(1.0))

#: A p-value below this is shown as such: its digits mean nothing.
_SMALLEST_P = 1e-6

#: A share below this is shown as such [%].
_SMALLEST_PERCENT = 0.01

#: If the other lengths have changed by more than this, rms, it is not one exchanged part [m].
_MANY_LENGTHS = 1e-3

_OFF = (
    "The nominal robot is {given_m:mm.0f} mm rms off, far more than an uncalibrated arm, but only "
    "{error_m:mm.1f} mm if "
)
_ROWS_OFF = "The robot of the DH rows misses the measured poses by {given_off} rms, but only by {error_off} if "
_TURNED = (
    "The nominal robot's orientations are {given_rad:deg.0f} deg rms off, but only "
    "{error_rad:deg.1f} deg if "
)
_FLANGE = (
    "With the poses of the flange as given the target is {given_m:mm.0f} mm rms off, but only "
    "{error_m:mm.1f} mm if "
)
_REGISTERED_AGAIN = (
    "The rms error is {given_m:mm.2f} mm with the frame and target of the result, but only "
    "{error_m:mm.2f} mm if the "
)
_NOT_NOISE = "The residuals are not noise: "
_SHARE = "explains {explained} % of them (by chance {chance_explains} %; {chance_p})"
_FALLS = "With this effect modelled, the error on held-out blocks of rows {falls_by}."
_CHANGED = "Did the arm, its tool or the instrument change in between?"
_CHECK = (
    "Check base and tip, the joint columns and their signs, whether the measurements belong to "
    "these joint values, and "
)
_COMPENSATE = "send compensated commands (calib compensate with the result file)."

#: The sentence of each code; a number is written as ``{name:unit.digits}``.
SENTENCES = {
    Why.TARGET_ELSEWHERE: _OFF
    + "the target is not held where it was given: check its position and its tip, or leave it to be estimated (omit "
    "--fix-target; with calib evaluate omit --target).",
    Why.WRONG_UNIT: _OFF + "the {what} are {wrong_unit}.",
    Why.OTHER_BASE: _OFF + "the points are in the frame of '{link}': try --base {link}.",
    Why.OWN_FRAME: _OFF + "the points are not in the base frame: try --frame estimate.",
    Why.JOINTS_TURNED: _OFF + "the sign of {joints} is reversed: check the positive direction, or "
    "multiply the values by -1.",
    Why.JOINT_ZERO: _OFF + "{add_rad:deg.0f} deg is added to '{joint}': check its zero position, "
    "or add this to all values of the column.",
    Why.JOINT_FACTOR: _OFF
    + "the values of '{joint}' are multiplied by {factor:.5g}: does the column hold angles of "
    "the motor, or percent? Write the joint's angles into it.",
    Why.COLUMNS_SWAPPED: _OFF
    + "the columns '{first}' and '{second}' are swapped: check the header.",
    Why.POSES_INVERSE: _OFF
    + "the poses are inverted: give the pose of the target in the measurement frame, not that of "
    "the frame in the target (solvePnP gives the board in the camera).",
    Why.COLUMNS_REVERSED: _OFF + "the joint columns are in reverse order: check the header.",
    Why.READINGS_COUPLED: _OFF
    + "the readings of '{joint}' are coupled to those of '{reading}': write "
    "{joint} = {{ {reading} = {factor:.1f} }} below [coupling] in the cell file.",
    Why.READINGS_NOT_COUPLED: _OFF
    + "the readings of '{joint}' are not coupled to those of '{reading}': omit '{reading}' there, "
    "below [coupling] in the cell file.",
    Why.ROWS_SHIFTED: _OFF
    + "joint values and measurements are shifted by one row against each other: check which "
    "measurement belongs to which pose.",
    Why.ROWS_MOVED: _OFF + "the measurements from row {row} on {moved_rows}.",
    Why.TWO_MISTAKES: _OFF + "two mistakes are undone: {both_mistakes}.",
    Why.OTHER_TIP: _OFF + "the target is mounted on '{link}': try --tip {link}.",
    Why.JOINT_CONSTANT: _OFF
    + "'{joint}' moved, although its column holds a single value: give the actual values.",
    Why.SCALAR_ELSEWHERE: _TURNED
    + "the quaternions have their scalar {scalar}: give it in the column qw.",
    Why.ORIENTATIONS_INVERSE: _TURNED
    + "they are inverted: give those of the target in the measurement frame.",
    Why.ORIENTATIONS_JOINT_TURNED: _TURNED
    + "the sign of '{joint}' is reversed: check the positive direction.",
    Why.ORIENTATIONS_JOINT_ZERO: _TURNED
    + "{add_rad:deg.0f} deg is added to '{joint}': check its zero position.",
    Why.DH_CELLS: _ROWS_OFF + "{dh_cells}.{dh_elsewhere}",
    Why.DH_ROWS_EXCHANGED: _ROWS_OFF
    + "the lines of '{first}' and '{second}'{dh_lines} are exchanged: put them into the order of the axes.",
    Why.DH_NUMBERS_EXCHANGED: _ROWS_OFF
    + "the numbers in the rows of '{first}' and '{second}'{dh_lines} are exchanged, joint names and limits as they "
    "are.",
    Why.DH_CONVENTION: _ROWS_OFF
    + "their convention is '{convention}', not '{stated}': state it in the file (# convention: {convention}), with "
    "headings that fit.",
    Why.DH_VARIANT: _ROWS_OFF + "the arm is a {arm}: give its lengths d and a.",
    Why.DH_UNIT: _ROWS_OFF
    + "the {what} are multiplied by {factor:.4g}, as of {unit} under a heading of {header}: correct the heading.",
    Why.FRAME_NOT_FOUND: "The measurement frame{of_station} was not found: from every start the errors "
    "stay larger than those of any uncalibrated arm, so the nominal robot cannot be judged. "
    "Give the frame's approximate pose in the cell; if that does not help, check the robot and the "
    "table.",
    Why.SIGN_TURNED: _OFF + "the sign of '{column}' is reversed: check the column.",
    Why.POINTS_MIRRORED: _OFF
    + "the points are mirrored: two of the columns x, y and z are swapped, or one has the wrong "
    "sign.",
    Why.PARAMETER_ABSURD: "The nominal robot is {before_off} rms off on held-out rows, and "
    "the fit changes a parameter by {largest:mm.0f} mm or mrad, more than any arm needs. "
    + _CHECK
    + "that each station has a group of its own.",
    Why.NOISE_ABSURD: "The residuals are {noise_off} per coordinate, which no arm or "
    "instrument explains. "
    + _CHECK
    + "that they are in the base frame (otherwise: --frame estimate).",
    Why.ORIENTATION_ABSURD: "On held-out rows the calibrated robot's orientations are "
    "{after_rad:deg.0f} deg rms off: are they inverted, is the quaternion's scalar in the column "
    "qw, are rx, ry, rz a rotation vector?",
    Why.NO_URDF_HOLDS: "No URDF can represent these errors: on held-out rows ({method}) the error "
    "of the corrected robot is {after} (nominal: {before}), that of the non-geometric model "
    "'{model}' {less}. Keep the URDF, and " + _COMPENSATE,
    Why.NOTHING_TO_GAIN: "Nothing to gain: the nominal robot is {before} off on held-out rows, "
    "which is about the measurement noise. Keep its URDF.",
    Why.STILL_FAR_OFF: "On held-out rows ({method}) the calibrated robot is still "
    "{after_off} rms off.",
    Why.TOO_FEW: "{measured} are too few for {parameters} parameters: no significant improvement "
    "on held-out rows ({change}, {gain:.1f} standard errors). Measure more poses.",
    Why.NO_BETTER: "On held-out rows ({method}) the calibrated robot is no better than the "
    "nominal one, frame and target fitted for both: {after} against {before}.",
    Why.VALIDATION_NO_BETTER: "On the {rows} validation rows the error does not fall: {change}.",
    Why.TARGET_FAR: "The estimated target{named} is {far_m:mm.0f} mm from the position given: "
    "check the sign and the order of the numbers, and the tip.",
    Why.MEASUREMENTS_COMPUTED: "Residual noise is {noise_m:mm.4f} mm per coordinate, no more than the rounding of the "
    "table ({rounding_m:mm.4f} mm), as if nothing else disturbed it: did the controller compute these positions from "
    "the joint values? Then they say nothing about the arm. Measure it with an instrument of its own.",
    Why.OTHER_VARIANT: "The length {length} of '{joint}' (DH) has changed by {moved_m:mm.1f} ± "
    "{interval_m:mm.1f} mm, the other lengths by {others_m:mm.2f} mm rms: no arm is built that "
    "inaccurately. {variant}",
    Why.BASE_MOVED: "The base, or the first joint's axis in it, is {moved_m:mm.1f} mm and "
    "{turned_rad:deg.2f} deg away from where the given measurement frame puts it. This moves the "
    "points by {effect_m:mm.1f} mm rms; all other corrections of the arm move them by "
    "{arm_m:mm.1f} mm. Unless the measurement frame is aligned with the base better than that, "
    "add --frame estimate; if it is, state it in the cell file: frame_aligned = true.",
    Why.MUCH_REMAINS: "Much of the error remains: {remains:%.0f} % on held-out rows{free_of_noise} "
    "({change}{with_noise}).{better}",
    Why.VALIDATION_SMALL_GAIN: "On the {rows} validation rows{rows_aside} the error hardly falls: "
    "{change}.",
    Why.JOINTS_LATE: "The arm was moving, and the joint values {lag_behind} the measurements by {of_step_abs} % of "
    f"the time from one row to the next. {_FALLS} Measure at standstill, or read both at the same time.",
    Why.JOINTS_LAG: f"{_NOT_NOISE}they follow the last move of the joints, which {_SHARE}: the "
    "joints stop short by about {of_move:%.2f} % of that move, '{joint}' most. "
    f"{_FALLS} Measure at standstill, and read the joint values then; if the gears have backlash, "
    "approach poses from one side.",
    Why.MAY_BE_CHANCE: "The improvement on held-out rows may be due to chance: it is {gain:.1f} "
    "standard errors. Measure more poses.",
    Why.FEW_NUMBERS: "{measured} with {numbers} measured numbers{of_images} are few for {parameters} "
    "parameters: the result relies on the priors. Measure more poses.",
    Why.FAR_OFF_BEFORE: "The nominal robot is {before_off} rms off on held-out rows, far "
    "more than an uncalibrated arm. Is it the right URDF?",
    Why.JOINTS_STILL: "Joints that hardly moved: {joints}. Their errors are known near these "
    "values only; measure poses that move every joint.",
    Why.SOLE_POSTURE: "{sole}, and no other row can check it: {again}, and add poses "
    "with {those} at other values.",
    Why.MODEL_LACKS: "The model '{model}' leaves residuals of {noise} per coordinate, "
    "'{non_geometric}' would leave {less_noise}: the robot has errors that this model lacks. "
    "Try --model auto.",
    Why.CORNER: "Only part of the joints' ranges was measured: {ranges}. Outside, the result is "
    "extrapolated. The measured tip positions spread {spread:%.0f} % as far as the joint limits "
    "allow.",
    Why.JOINT_PATTERN: _NOT_NOISE + "the {quantity} of '{joint}' " + _SHARE + ".",
    Why.DRIFT: f"{_NOT_NOISE}they drift in the order of the rows, which {_SHARE}. {_FALLS} {{warmed}}",
    Why.DRIFT_REMOVED: "The measured positions drifted by {drift} from the first row to the last; this "
    "was estimated, and taken out of them before the fit. Did the instrument warm up, or its foot "
    "move?",
    Why.SETUP_UNPREDICTED: "The other stations do not predict station '{setup}': a fit without it "
    "leaves errors there {ratio:.1f} times those expected. " + _CHANGED,
    Why.SETUP_FLAGGED: "{flagged} of the {rows} rows of station '{setup}' are flagged as "
    "outliers: it does not agree with the others. " + _CHANGED,
    Why.REPEATS_AGREE: "Repeats of a pose scatter by {within} per coordinate, but the "
    "residuals are {noise}: the robot has errors that the model lacks.",
    Why.NO_LENGTH: "No length was measured, so the size of the arm stays nominal; nor do contacts "
    "say where the base stands. To determine the size, add rows that measure a length, or with "
    "sockets give the distance between two of them in the cell file ([[distances]]).",
    Why.HANDS_ALONE: "The hands were seen where they touch, and nowhere else. The size of the arms stays nominal, "
    "and so do offsets next to what they hold: with the hands elsewhere the error is larger, see that expected over "
    "the joint limits. To determine them, add rows that measure lengths: a tracker, a camera.",
    Why.STOPS_ALONE: "End stops tell the zeros of {joints} alone. Lengths, angles between axes, gears, bending, and "
    "where base and tool are stay as they are{others_open}: to determine them, measure.",
    Why.PARAMETER_FAR: "A parameter has changed by {largest:mm.0f} mm or mrad, more than any error "
    "of an arm. Keep the priors on, or choose a smaller model.",
    Why.VALIDATION_UNLIKE: "The error of the calibrated robot is {before} on the {rows} validation "
    "rows, but {after} on held-out rows: did the target or the frame change in between?",
    Why.MANY_OUTLIERS: "{flagged} of {rows} rows are flagged as outliers: do they share a station, "
    "a time or a region? Including them, the error on held-out rows goes {change}.",
    Why.WORSE_WITH_OUTLIERS: "On all held-out rows, including the {flagged} flagged ones, the "
    "error rises {change}: these are not accidents, but show errors that the model lacks.",
    Why.UNKNOWN_ELSEWHERE: "Over the joint limits the expected error is {expected_m:mm.1f} mm rms, "
    "{remains:%.0f} % of that of the nominal robot: these poses do not determine the parameters. "
    "Measure throughout the workspace, or choose a smaller model.",
    Why.SMALL_GAIN: "The error falls little, or only near the measured poses: over the joint "
    "limits {remains:%.0f} % of it is expected to remain.",
    Why.NOISE_LARGE: "Residual noise is {noise_rough} per coordinate, more than any usual "
    "instrument: are the joint values exact, taken at standstill and of the same pose as the "
    "measurement? If this is the instrument's noise, state it as sigma.",
    Why.NOISE_ABOVE_SIGMA: "Residual noise is {ratio:.0f} times the noise that the table or the "
    "cell states: {after} per coordinate instead of {before}. Is the stated noise right, and are "
    "the joint values exact?",
    Why.REFERENCES_DRIFT: "By the references {of_mover} drifted by {moved_m:mm.3f} mm from the first row to the last "
    "({chance_p}). It was taken out of the measured poses; {left_m:mm.3f} mm per coordinate may be left.",
    Why.REFERENCES_STEP: "By the references {of_mover} moved by {moved_m:mm.3f} mm at row {row} (between the rows "
    "{after_row} and {before_row}; {chance_p}). It was taken out of the measured poses; {left_m:mm.3f} mm per "
    "coordinate may be left.",
    Why.REFERENCES_STILL: "The references ({readings} readings) show no drift and no step; a drift of {left_m:mm.3f} "
    "mm per coordinate may be left.",
    Why.REFERENCES_TOO_FEW: "The references ({readings} readings) show nothing of the frame, because none that "
    "stood still was measured often enough: measure each before, between and after the poses.",
    Why.REFERENCE_MOVED: "The reference '{reference}' does not stand still: by itself it moved by {moved_m:mm.3f} mm"
    "{from_row} ({chance_p}). The measured poses were left as they are. Is it loose?",
    Why.REFERENCE_MISREAD: "The reading of the reference '{reference}' in row {row} is {moved_m:mm.3f} mm off the "
    "others ({chance_p}), and was not used.",
    Why.SIGMA_UNLIKELY: "The stated noise is {before} per coordinate, that of the residuals {after}. The "
    "latter is believed: are the unit and the value of the stated one right?",
    Why.JOINTS_COARSE: "The values of '{joint}' are multiples of {beyond}, and rounding explains "
    "{share:%.0f} % of the residuals: give the joint values as precisely as the controller knows "
    "them.",
    Why.TARGET_STEP: f"{_NOT_NOISE}from row {{row}} on the target '{{target}}' is displaced by "
    f"{{moved_m:mm.2f}} mm in the tip, which {_SHARE}. {_FALLS} {{knocked}}",
    Why.LENGTHS_SCALED: "All lengths of the robot together are {scale:%+.2f} % off (standard error "
    "{std:%.2f} %): either the arm's, more than those of any arm, or the instrument's. Check its "
    "scale (the size of a printed board, a tracker's temperature, the unit).",
    Why.COMPLIANCE_NEGATIVE: "'{joint}' would move against its load, which no {family} does. Are "
    "the masses, the payload and the direction of gravity right?",
    Why.SETUP_UNDETERMINED: "These poses do not determine {names}: turn the hand about two axes or more, by 30 deg or "
    "more each, or state what is known of frame and target.",
    Why.SETUP_UNSURE: "Rows that the fit has not seen are off by {after}, those that it has by {before}: there are too "
    "few poses for what is estimated. Add poses.",
    Why.SETUP_LOCATED: "Frames and targets are located to {located} (95 %, the least certain of them). On held-out "
    "rows ({method}{outliers_aside}) the error is {after}, the robot's own errors in it.",
    Why.GAIN: "On held-out rows ({method}{outliers_aside}) the error falls {change}.",
    Why.LARGER_MODEL: "With the non-geometric model '{model}' the error on held-out rows is {after} "
    "(verdict: {use}). No URDF can represent it{used_by}.",
    Why.LARGER_NO_CLOSER: "The non-geometric model '{model}' does not improve positions on held-out "
    "rows: {after}.",
    Why.STOPS_SHORT: "'{joint}' {stops} after each move{other_joints}: calib compensate and predict() correct this by "
    "the order of the rows. To avoid it, approach poses from one side.",
    Why.CREEPS: "'{joint}' {lacks} of its last move when it was measured{other_joints}: calib compensate and predict() "
    "correct this by the order of the rows. To avoid it, wait longer at each pose.",
    Why.ONE_SIDED: "All joints arrived at every pose from one side, {side}. Lost motion, if there is some, is in their "
    "zeros: the robot is as accurate as stated where programs approach poses from this side too.",
    Why.CHAIN_AGAINST: "The chain from '{base}' to '{tip}' must not be used by itself: its error on held-out rows goes "
    "{change}, see the table of chains.",
    Why.CHAIN_CARE: "The chain from '{base}' to '{tip}' needs care by itself: its error on held-out rows goes "
    "{change}, see the table of chains.",
    Why.SCALE_HIDDEN: "The arm's lengths may contain a scale error of the instrument of about {scale:%.2f} %: "
    "{effect_m:mm.2f} mm rms over the joint limits, {share:%.0f} % of the nominal robot's error. If the "
    "scale is known better, say so: --instrument tracker, or in the cell file sigma_scale_percent or, once a known "
    "length was checked, scale_certified = true.",
    Why.ALREADY_CORRECTED: "The robot given is a corrected URDF of run {run}{its_verdict}: changes count from it, and "
    "the priors are centred on it, their sizes estimated from these rows.",
    Why.ROWS_COPIED: "{rows} rows (the first is row {row}) are exact copies of others, and were "
    "ignored.",
    Why.READINGS_TURNED: "Readings of {joints} lay whole turns outside of the joint's limits, and were brought "
    "back by 360 deg; the URDF's limits decide.",
    Why.OTHER_END: "The board looks the same from both ends: in {pictures_off} its corners were numbered from the end "
    "that the robot's motion shows to be the other one, first in {pictures_named}.",
    Why.CORNERS_THINNED: "Of {corners} corners {kept} were fitted, evenly over pictures and board: those of one "
    "picture share the robot's error there.",
    Why.VALIDATION_GAIN: "On the {rows} validation rows{rows_aside} the error falls {change}.",
    Why.OUTSIDE: "{rows_lie} outside the range of the fitted joint values, where "
    "errors may be larger: '{joint}' in {place} by {beyond}.",
    Why.FLANGE_INVERSE: _FLANGE
    + "they are inverted: give the pose of the flange in the base, not that of the base in "
    "the flange; or camera and board are on the other link: exchange --camera-on and --board-on.",
    Why.FLANGE_CONVENTION: _FLANGE
    + "their orientations are of another convention: try --orientation {convention}.",
    Why.FLANGE_OFF: "With these poses of the flange the target is {given_m:mm.0f} mm rms off, more than any robot, and "
    "neither inverse poses nor another convention of their orientations explain it. Do pictures and poses belong "
    "together, are the links right (--camera-on, --board-on), the squares of the board and the camera?",
    Why.CAMERA_ON_OTHER_LINK: _OFF
    + "'{tip}' carries the camera and '{base}' the board: exchange --camera-on and --board-on.",
    Why.SENSE_REVERSED: "The images fit far better if '{joint}' counts in the other direction ({error_m:mm.1f} mm "
    "instead of {given_m:mm.1f} mm): check its positive direction in the table and in the URDF.",
    Why.SENSE_UNKNOWN: "These poses do not show in which direction a joint counts: with the sign of "
    "{joints} reversed the images fit as well. Check it by hand, and turn this joint by 60 deg or more with the other "
    "joints at other values.",
    Why.PICTURES_TURNED: "{of_pictures} fit only if they are turned by half a turn: {pictures_named}. They were left "
    "out. Turn them back, or take them again; does a camera or a program turn pictures by their orientation tag?",
    Why.PICTURES_EXCHANGED: "{of_pictures} fit only with the joint values of each other: {pictures_named}. They were "
    "left out. Were they named wrongly, or are their rows exchanged?",
    Why.CAMERA_MOVED: "{of_pictures}{from_picture} fit only if the camera stood elsewhere, {moved_m:mm.1f} mm and "
    "{moved_rad:deg.2f} deg away: {pictures_named}. {left_out}Was it knocked? Give those rows a name of their own in "
    "the column 'group', or take them again.",
    Why.CAMERA_REFOCUSED: "{of_pictures}{from_picture} fit only with another focal length ({share:%+.2f} %): "
    "{pictures_named}. {left_out}Did autofocus or a zoom move? Switch it off, and take them again.",
    Why.FOCAL_LENGTH_OFF: "The focal length seems to be {share:%+.2f} % off what was stated (standard "
    "deviation {std:%.2f} %): {if_exact}are the intrinsics of this camera, resolution and focus?",
    Why.BOARD_SCALE_OFF: "The board seems to be {share:%+.2f} % off its stated size (standard deviation "
    "{std:%.2f} %), and all lengths of the arm with it: {if_exact}measure the printed squares, many of them at once, "
    "correct square_mm, and run calib detect again.",
    Why.CORNERS_OFF: "The corners of a board are {off_m:mm.2f} mm rms from their places along an axis, and "
    "{stated_m:mm.2f} mm were stated, so that the intervals are too narrow: state a larger sigma_corner_mm.",
    Why.COVARIANCES_IDLE: "The stated covariances say nothing about the errors of the poses (their scale is "
    "{scale:.2g}): are they of these rows, in the order x, y, z, rotations about x, y, z, in m and rad, along the axes "
    "of the measurement frame? Or does the robot miss its stops by far more?",
    Why.BOARD_HEAD_ON: "The board was always seen head on, tilted by {tilt_rad:deg.0f} deg at most: such "
    "images hardly distinguish focal length from distance. Add images with the board tilted by 30 to 45 deg, in all "
    "directions.",
    Why.FEW_CORNERS: "{images} of {all} images show fewer than {corners} corners: their poses are inaccurate, "
    "however well they fit. Show the whole board, close enough to fill the image.",
    Why.ONE_AXIS: "The hand rotated about one axis only, and by {across_rad:deg.1f} deg about others: the camera's "
    "position along that axis is not determined. Rotate the hand about two axes, by 30 deg or more.",
    Why.CAMERA_TOO_ROUGH: "This camera is not accurate enough to show an improvement: move it closer, take "
    "more images, or use a laser tracker.",
    Why.FRAME_MOVED: _REGISTERED_AGAIN
    + "measurement frame is registered again: did the tracker or the robot move? Then add --frame "
    "estimate.",
    Why.TARGET_MOVED: _REGISTERED_AGAIN
    + "target is registered again: was it remounted? Then give its position with --target.",
    Why.OTHER_SIDES: "At the calibration all joints arrived at every pose from one side, here they did not: the errors "
    "contain lost motion, if there is some.",
}

#: Second sentence on a cell, by what has the same effect.
_DH_ELSEWHERE = {
    "": "",
    "base": " The controller's base frame, or the line 'base', would have the same effect.",
    "joint": " If the cell is right, check the joint's positive direction and zero, on the robot and in the table.",
    "tool": " A tool that the controller adds, or the line 'tool', would have the same effect.",
}

#: A length or angle of a row that is less than this is shown as 0 [mm or deg].
_DH_DIGIT = 0.005

#: Second sentence of a reason that much remains, if the non-geometric model leaves far less.
_BETTER = " The non-geometric model '{model}' leaves {less}: " + _COMPENSATE


#: What moves by the references.
_MOVERS = {
    "frame": "the measurement frame (instrument or base)",
    "instrument": "the instrument",
    "base": "the robot's base",
}

#: The most pictures that a sentence names.
_PICTURES_NAMED = 4


def reason_text(reason: Reason) -> str:
    """Word a reason of a verdict in sentences.

    Args:
        reason: The reason; its values are in SI units.

    Returns:
        One or two sentences, with numbers in mm, deg and %.
    """
    values = reason.values
    words = {**values, **_words(values), **_words_of_mistake(values)}
    text = _Units().vformat(SENTENCES[reason.why], (), words)
    sentences = [text]
    # Other mistakes that explain the rows as well.
    sentences += [
        f"Or else ({mm(other['error_m'], 1)} mm): {_undone(other)}"
        for other in values.get("others", ())
    ]
    return " ".join(sentences)


def _undone(mistake: Mapping[str, Any]) -> str:
    """Return how a mistake is undone, with its remedy, as it stands after "but only if"; it has a code and values."""
    sentence = SENTENCES[Why[str(mistake["code"]).upper()]]
    sentence = sentence.removeprefix(_OFF).removeprefix(_ROWS_OFF)
    return _Units().vformat(sentence, (), {**mistake, **_words_of_mistake(mistake)})


def _words_of_mistake(values: Mapping[str, Any]) -> dict[str, str]:
    """Return by name the words that the sentences of usual mistakes take besides their values (SI units)."""
    lines = values.get("lines", ())  # 0 if the rows are of no table
    words = {
        "dh_cells": listed([_dh_cell(cell) for cell in values.get("cells", ())]),
        "dh_elsewhere": _DH_ELSEWHERE[values.get("elsewhere", "")],
        "dh_lines": " (lines {} and {})".format(*lines) if lines and all(lines) else "",
    }
    if "what" in values and "factor" in values:
        if values.get("unit"):
            unit, header = values["unit"], values["header"]
            listed_points = (
                f" (--points-unit {unit} with a list)" if values["what"] == "points" else ""
            )
            words["wrong_unit"] = (
                f"in {unit}, not in {header} as stated: write [{unit}] into the header{listed_points}"
            )
        else:
            words["wrong_unit"] = (
                f"multiplied by {values['factor']:.6g}: they were converted twice, or not at all, before they "
                "were written"
            )
    if "row" in values and "up" in values:
        row = values["row"]
        words["moved_rows"] = (
            f"move down by one row. That of row {row} is missing: insert an empty one there"
            if values["up"]
            else f"move up by one row. That of row {row} is one too many: delete it"
        )
    if "both" in values:
        # What is wrong comes first, as a page may have no room for the remedies.
        parts = [_undone(mistake).removesuffix(".").partition(": ") for mistake in values["both"]]
        (first, _, of_first), (second, _, of_second) = parts
        remedies = f"For the one, {of_first}; for the other, {of_second}"
        if of_first == of_second:
            remedies = f"For each of them, {of_first}"
        words["both_mistakes"] = f"{first}, and {second}. {remedies}"
    return words


def _words(values: Mapping[str, Any]) -> dict[str, str]:
    """Return by name the words that the sentences of `SENTENCES` take besides the values of a reason (SI units)."""
    before = sizes_of(values, "before")
    after = sizes_of(values, "after")
    # The unit of a single size stands once: from 2.350 to 0.208 mm rms.
    start = before[0].split()[0] if len(before) == 1 else listed(before)

    measured = []
    for count, noun in (("poses", "poses"), ("pairs", "pairs of poses")):
        if values.get(count):
            measured.append(f"{values[count]} {noun}")

    if "image" in values:
        images = values["images"]
        rows_lie = f"{plural(images, 'validation image')} {'lies' if images == 1 else 'lie'}"
    elif values.get("rows") == 1:
        rows_lie = "1 validation row lies"
    else:  # of other reasons the rows may be a list, and this is not used
        rows_lie = f"{values.get('rows', 0)} validation rows lie"

    variant = "Does the URDF describe this type and variant of the arm?"
    if values.get("others_m", 0.0) > _MANY_LENGTHS:
        variant += " Or, as others are off too, do joint values and positions belong together: same row, same moment?"
    if values.get("arm"):
        variant = f"The corrected lengths are those of a {values['arm']}: if the arm is one, use its URDF."

    p, falls = values.get("p", 1.0), values.get("falls", 0.0)
    knocked = "So it was probably not knocked."
    warmed = "So probably nothing warmed up, or moved."
    if falls >= PREDICTS:
        knocked = (
            "Was it knocked or remounted? Give those rows a new target name (column 'target')."
        )
        warmed = "Did something warm up, or move?"
    of_step = values.get("of_step", 0.0)
    side = "falling"
    if values.get("rising"):
        side = "rising"
        if values["falling"]:
            side += f", and falling in {choices(values['falling'])}"
    words = {
        "side": side,
        "before": f"{listed(before)} rms",
        "after": f"{listed(after)} rms",
        "change": f"from {start} to {listed(after)} rms",
        **_lag(values),
        "other_joints": f" ({plural(values['others_short'], 'other joint')}: less)"
        if values.get("others_short")
        else "",
        "measured": " and ".join(measured),
        "of_images": ", six of an image," if values.get("images") else "",
        "beyond": "".join(sizes_of(values, "by", ".3g")),
        "explained": _percent(values.get("share", 0.0)),
        "chance_explains": _percent(values.get("chance", 0.0)),
        "chance_p": "p < 1e-6" if p < _SMALLEST_P else f"p = {p:.1g}",
        "used_by": "" if values.get("use") == NO else "; calib compensate and predict() use it",
        "lag_behind": "lag behind" if of_step > 0.0 else "are ahead of",
        "of_step_abs": f"{100.0 * abs(of_step):.1f}",
        "falls_by": f"falls by {_percent(falls)} %" if falls > 0.0 else "does not fall",
        "knocked": knocked,
        "warmed": warmed,
        "outliers_aside": "",
        "free_of_noise": ", noise subtracted",
        "with_noise": "",
        "if_exact": "do not state it as exact, and " if values.get("exact") else "",
        "rows_aside": "",
        "others_open": "",
        "located": " and ".join(sizes_of(values, "located", ".2g")),
        "its_verdict": f", whose verdict was {values['verdict']}" if values.get("verdict") else "",
        "named": "",
        "of_station": "",
        "ranges": _ranges(values),
        "rows_lie": rows_lie,
        "variant": variant,
        "place": f"'{values['image']}'" if "image" in values else f"row {values.get('row', 0)}",
        "better": "",
        "before_off": absurd_size(values, "before"),
        "after_off": absurd_size(values, "after"),
        "noise_off": absurd_size(values, "noise"),
        "drift": "".join(sizes_of(values, "drift")[:1]),
        "noise": "".join(sizes_of(values, "noise")[:1]),
        "noise_rough": "".join(sizes_of(values, "noise", ".1f")[:1]),
        "less_noise": "".join(sizes_of(values, "less")[:1]),
        "given_off": listed(sizes_of(values, "given", ".2f")),
        "error_off": listed(sizes_of(values, "error", ".2f")),
        **_pictures(values),
        "within": "".join(sizes_of(values, "within")[:1]),
        "of_mover": _MOVERS.get(values.get("mover", ""), ""),
        "from_row": f" from row {values['row']} on"
        if values.get("row")
        else ", evenly over the rows",
    }
    if values.get("mover") and values["group"]:
        words["of_mover"] += f" (station '{values['group']}')"
    free_before, free_after = (sizes_of(values, f"free_{side}") for side in ("before", "after"))
    if free_before and free_after:
        # The share is that of these figures; those with the noise may hardly differ.
        words["free_of_noise"] = (
            f", {free_after[0]} of {free_before[0]} rms once the noise is subtracted"
        )
        words["with_noise"] = " with the noise"
    if values.get("outliers"):
        words["outliers_aside"] = ", outliers excluded"
    if values.get("aside"):
        outliers = plural(values["aside"], "outlier")
        whole = listed(sizes_of(values, "whole"))
        words["rows_aside"] = f" ({outliers} excluded; {whole} with them)"
    if values.get("target"):
        words["named"] = f" '{values['target']}'"
    if values.get("station"):
        words["of_station"] = f" of station '{values['station']}'"
    if values.get("not_stopped"):
        words["others_open"] = (
            f", and so do the zeros of {choices(values['not_stopped'], limit=12)}"
        )
    if isinstance(values.get("names"), Sequence):
        words["names"] = choices(values["names"], limit=12)
    if "rows" in values and "joints" in values:
        words |= _sole_postures(values["rows"], values["joints"], values.get("pictures"))
    if words["less_noise"] and "model" in values:
        less = f"{words['less_noise']} rms"
        words["less"] = less
        if "remains" in values:
            words["better"] = _BETTER.format(model=values["model"], less=less)
    return words


def _pictures(values: Mapping[str, Any]) -> dict[str, str]:
    """Word which pictures of which camera a reason is about, for `SENTENCES`; none for the values of other reasons."""
    if "named" not in values:
        return {}
    named, count = values["named"], values["off"]
    camera = f" of camera '{values['camera']}'" if values.get("camera") else ""
    further = count - min(len(named), _PICTURES_NAMED)
    listed_names = ", ".join(f"'{name}'" for name in named[:_PICTURES_NAMED])
    return {
        "pictures_off": plural(count, "picture"),
        "of_pictures": f"{count} of {values.get('of', count)} pictures{camera}",
        "from_picture": f", before or from '{values['first']}' on," if values.get("first") else "",
        "pictures_named": listed_names + (f" and {further} more" if further > 0 else ""),
        "left_out": "They were left out. " if values.get("left_out", True) else "",
    }


def _dh_cell(cell: Mapping[str, Any]) -> str:
    """Word what a cell of DH rows should hold: ``'d' of 'J4' (line 6) is 420 mm instead of 411 mm``."""
    factor, unit = {"m": (1e3, " mm"), "rad": (_DEG, " deg"), "": (1.0, "")}[cell["unit"]]
    stated, wanted = (factor * cell[name] for name in ("stated", "wanted"))
    place = f" (line {cell['line']})" if cell.get("line") else ""
    remark = ""
    if cell["unit"] == "m" and abs(stated) >= _DH_DIGIT and stated * wanted > 0.0:
        change = abs(wanted) - abs(stated)
        size = f"{abs(change):.2f}".rstrip("0").rstrip(".")
        remark = f" ({size} mm too {'short' if change > 0.0 else 'long'})"
    was, becomes = (
        f"{round(value, 2) + 0.0:.2f}".rstrip("0").rstrip(".") + unit for value in (stated, wanted)
    )
    return f"'{cell['column']}' of '{cell['joint']}'{place} is {becomes} instead of {was}{remark}"


def _percent(share: float) -> str:
    """Format a share, 1 for all, as percent without the sign: whole, or with one significant digit below 1 %.

    Shares too small for that are ``less than`` the smallest percentage that is shown.
    """
    percent = 100.0 * share
    if percent == 0.0 or abs(percent) >= 1.0:
        return f"{percent:.0f}"
    return f"{percent:.1g}" if percent >= _SMALLEST_PERCENT else f"less than {_SMALLEST_PERCENT:g}"


def _sole_postures(
    rows: Sequence[int], joints: Sequence[str], pictures: Sequence[str] | None
) -> dict[str, str]:
    """Word which rows, by number, alone determine the errors of which joint, one for each row, for `SENTENCES`.

    Rows that are corners are called by their pictures; None, or an empty name: by their numbers.
    """
    names = [str(row) for row in rows]
    thing, measure = "row", "measure"
    if pictures is not None and all(pictures):
        names = [f"'{picture}'" for picture in pictures]
        thing, measure = "picture", "take"
    named_of_joint: dict[str, list[str]] = {}
    for name, joint in zip(names, joints, strict=True):
        named_of_joint.setdefault(joint, []).append(name)
    parts = []
    for joint, named in named_of_joint.items():
        *before, last = named
        subject = f"{thing} {last} alone determines"
        if before:
            subject = f"{thing}s {', '.join(before)} and {last} alone determine"
        parts.append(f"{subject} the errors of joint '{joint}'")
    text = "; ".join(parts)
    whose = f"{thing} {names[0]}" if len(rows) == 1 else "them"
    return {
        "sole": text[0].upper() + text[1:],
        "again": f"{measure} {whose} again",
        "those": "this joint" if len(named_of_joint) == 1 else "these joints",
    }


def _lag(values: Mapping[str, Any]) -> dict[str, str]:
    """Return how a joint stops, ``"stops 0.21 mrad short"``, and what it lacks; none for values of other reasons."""
    for name, factor, unit in (
        ("lag_rad", 1e3, "mrad"),
        ("lag_m", 1e3, "mm"),
        ("lag_share", 1e2, "%"),
    ):
        if name in values:
            size = f"{factor * abs(values[name]):.2g} {unit}"
            if values[name] > 0.0:
                return {"stops": f"stops {size} short", "lacks": f"still lacked {size}"}
            return {"stops": f"stops {size} too far", "lacks": f"had overshot by {size}"}
    return {}


def _ranges(values: Mapping[str, Any]) -> str:
    """List the joints that moved in a part of their range, with the limits [deg or mm] and that part in %.

    Empty for the values of other reasons.
    """
    if isinstance(values.get("joints"), str) or "shares" not in values:
        return ""
    columns = [values[name] for name in ("joints", "shares", "lows", "highs", "slides")]
    parts = []
    for joint, share, low, high, slides in zip(*columns, strict=True):
        factor, unit = joint_unit(prismatic=slides)
        limits = f"{factor * low:.0f} to {factor * high:.0f} {unit}"
        parts.append(f"'{joint}' from {limits} ({100.0 * share:.0f} %)")
    return ", ".join(parts)


def do_not_use_text(verdict: Verdict | None) -> str:
    """Word the verdict ``do not use`` and its first reason in one line.

    Args:
        verdict: The verdict; None if nothing was judged.

    Returns:
        Such as ``do not use (no_better): On held-out rows ...``; empty for any other verdict, and without one.
    """
    if verdict is None or verdict.use != NO:
        return ""
    if not verdict.reasons:
        return NO
    first = verdict.reasons[0]
    return f"{NO} ({first.code}): {reason_text(first)}"


def refusal(name: str, verdict: str) -> str:
    """Word the message of a `calib.errors.VerdictError`.

    Args:
        name: What the verdict is on: a file in quotes, or "this calibration".
        verdict: The verdict in one line, as `do_not_use_text` words it.

    Returns:
        The verdict, that nothing was written because of it, and how to write it anyway, in one line.
    """
    return (
        f"the verdict on {name} is: {verdict} No file for a robot or controller was written; to write it anyway, add "
        "--accept (in Python accept=True)."
    )


class _Units(string.Formatter):
    """Formats numbers in SI units in the unit that stands before their format: ``{noise_m:mm.3f}``."""

    def format_field(self, value: Any, format_spec: str) -> Any:  # noqa: ANN401
        """Format a value in SI units by a unit and Python's format, ``mm.3f``, without writing the unit.

        The units are mm, deg, and % of a share; without one, as Python does.
        """
        for unit, factor in (("mm", 1e3), ("deg", _DEG), ("%", 100.0)):
            if format_spec.startswith(unit):
                return format(factor * value, format_spec.removeprefix(unit))
        return format(value, format_spec)
