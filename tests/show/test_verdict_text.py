"""Every code of the verdict has a sentence, with every number that it names."""

from __future__ import annotations

import math
from string import Formatter

import pytest

from calib.diagnosis.augmented_fit import PREDICTS
from calib.diagnosis.reasons import CARE, NO, USE, Reason, Verdict, Why
from calib.show.verdict_text import SENTENCES, do_not_use_text, reason_text, refusal


@pytest.mark.parametrize("why", Why)
def test_every_code_has_a_sentence(why):
    made = {"before", "after", "change", "chance_p", "measured", "beyond", "outliers_aside"}
    made |= {"named", "ranges", "better", "falls_by", "explained", "chance_explains"}
    names = {one[1].split(":")[0] for one in Formatter().parse(SENTENCES[why]) if one[1]}
    values = dict.fromkeys(names - made - {"rows_aside"}, 0.5)
    more = {"before_m": 2e-3, "after_m": 1e-3, "p": 1e-9, "by_rad": 0.3, "poses": 3}
    text = reason_text(Reason(why, more | values))
    assert text.endswith((".", "?"))
    assert "{" not in text.replace("{ ", "")  # as a cell file's table is written


def test_orientations_are_told_beside_positions():
    values = {"before_m": 2e-3, "after_m": 1e-3, "before_rad": 0.1, "after_rad": 0.01}
    gain = Reason(Why.GAIN, values | {"method": "leave-one-out", "outliers": 2})
    assert reason_text(gain) == (
        "On held-out rows (leave-one-out, outliers excluded) the error falls from 2.000 mm and 5.730 deg to 1.000 "
        "mm and 0.573 deg rms."
    )


def test_two_mistakes_are_both_named_before_what_to_do_about_them():
    both = [
        {"code": "joints_turned", "joints": "elbow"},
        {"code": "wrong_unit", "what": "points", "factor": 10.0, "unit": "cm", "header": "mm"},
    ]
    values = {"given_m": 0.5, "error_m": 4e-3, "both": both}
    _, _, text = reason_text(Reason(Why.TWO_MISTAKES, values)).partition("undone: ")
    places = [text.index(words) for words in ("elbow", "in cm", "by -1", "[cm]")]
    assert places == sorted(places)


def test_only_do_not_use_speaks_against_a_result():
    reasons = (Reason.of(Why.PARAMETER_FAR, largest=0.2), Reason.of(Why.NO_LENGTH))
    assert [do_not_use_text(Verdict(use, reasons)) for use in (USE, CARE)] == ["", ""]
    assert do_not_use_text(None) == ""
    assert do_not_use_text(Verdict(NO, ())) == "do not use"
    said = do_not_use_text(Verdict(NO, reasons))
    assert said == f"do not use (parameter_far): {reason_text(reasons[0])}"
    assert said in refusal("'c.urdf'", said)


def test_errors_in_three_units_are_listed():
    before = {"before_m": 3e-3, "before_rad": 0.01, "before_px": 1.5}
    after = {"after_m": 1e-4, "after_rad": 1e-3, "after_px": 0.25}
    gain = Reason(Why.GAIN, before | after | {"method": "leave-one-out"})
    assert reason_text(gain).endswith(
        "falls from 3.000 mm, 0.573 deg and 1.500 px to 0.100 mm, 0.057 deg and 0.250 px rms."
    )


@pytest.mark.parametrize(
    ("values", "size"), [({"after_px": 150.4}, "150 px"), ({"after_m": 0.264}, "264 mm")]
)
def test_what_is_far_off_is_said_in_its_unit(values, size):
    far = Reason(Why.STILL_FAR_OFF, values | {"method": "leave-one-out"})
    assert reason_text(far).endswith(f"still {size} rms off.")


@pytest.mark.parametrize(
    ("rows", "words"), [(1, "1 validation row lies"), (2, "2 validation rows lie")]
)
def test_one_row_is_no_rows(rows, words):
    reason = Reason.of(Why.OUTSIDE, rows=rows, row=47, joint="elbow", by_rad=0.1)
    assert reason_text(reason).startswith(words)


@pytest.mark.parametrize(
    ("share", "percent"),
    [(0.0, "0"), (5e-5, "less than 0.01"), (4.4e-3, "0.4"), (0.126, "13"), (1.0, "100")],
)
def test_a_small_share_is_not_rounded_to_nothing(share, percent):
    values = {"quantity": "angle", "joint": "elbow", "share": share, "chance": 2e-4, "p": 1e-9}
    text = reason_text(Reason(Why.JOINT_PATTERN, values))
    assert f"explains {percent} % of them (by chance 0.02 %; p < 1e-6)." in text


@pytest.mark.parametrize(
    ("rows", "joints", "said", "advice"),
    [
        ([7], ["elbow"], "Row 7 alone determines the errors of joint 'elbow',", "measure row 7"),
        ([7, 9], ["elbow"] * 2, "Rows 7 and 9 alone determine the errors of", "measure them again"),
        (
            [7, 9],
            ["elbow", "wrist"],
            "joint 'elbow'; row 9 alone determines the errors of joint 'wrist',",
            "with these joints at",
        ),
    ],
)
def test_rows_that_alone_determine_errors_are_told_with_their_joints(rows, joints, said, advice):
    text = reason_text(Reason.of(Why.SOLE_POSTURE, rows=rows, joints=joints))
    assert said in text
    assert advice in text


def test_corners_that_alone_determine_errors_are_called_by_their_picture():
    values = {"rows": [487], "joints": ["head_1_joint"], "pictures": ["head_10.png"]}
    text = reason_text(Reason.of(Why.SOLE_POSTURE, **values))
    assert text.startswith("Picture 'head_10.png' alone determines the errors of joint 'head_1")
    assert "take picture 'head_10.png' again" in text
    assert "487" not in text
    # Beside a row that is no corner both are called by their numbers.
    values = {"rows": [7, 487], "joints": ["a", "a"], "pictures": ["", "head_10.png"]}
    assert reason_text(Reason.of(Why.SOLE_POSTURE, **values)).startswith("Rows 7 and 487 alone")


def test_what_remains_is_told_with_the_figures_of_its_share():
    values = {"before_m": 4.628e-3, "after_m": 4.191e-3, "remains": 0.41}
    free = {"free_before_m": 2.2e-3, "free_after_m": 0.902e-3}
    text = reason_text(Reason.of(Why.MUCH_REMAINS, **values, **free))
    assert "41 % on held-out rows, 0.902 mm of 2.200 mm rms once the noise is subtracted" in text
    assert "from 4.628 to 4.191 mm rms with the noise" in text


@pytest.mark.parametrize(("of_step", "said"), [(0.1234, "lag behind"), (-0.1234, "are ahead of")])
def test_joint_values_of_another_time_are_told_with_their_share_of_a_step(of_step, said):
    text = reason_text(Reason.of(Why.JOINTS_LATE, of_step=of_step, over_arm=1.2, falls=0.9))
    assert f"{said} the measurements by 12.3 % of the time" in text
    assert "falls by 90 %" in text


def test_a_drift_that_was_taken_out_is_told_in_millimetres():
    text = reason_text(Reason.of(Why.DRIFT_REMOVED, drift_m=3.14e-4))
    assert "drifted by 0.314 mm from the first row to the last" in text


def test_rows_outside_may_be_images():
    values = {"rows": 80, "row": 3, "images": 2, "image": "b.png", "joint": "elbow", "by_rad": 0.1}
    text = reason_text(Reason(Why.OUTSIDE, values))
    assert text.startswith("2 validation images lie outside")
    assert "'elbow' in 'b.png' by 5.73 deg" in text


#: Values of reasons about images.
VALUES = {
    Why.CAMERA_ON_OTHER_LINK: {"given_m": 0.05, "error_m": 3e-3, "base": "arm", "tip": "hand"},
    Why.SENSE_REVERSED: {"joint": "elbow", "error_m": 2e-3, "given_m": 9e-3},
    Why.SENSE_UNKNOWN: {"joints": "elbow, wrist"},
    Why.FOCAL_LENGTH_OFF: {"share": 0.015, "std": 0.002, "exact": True},
    Why.BOARD_SCALE_OFF: {"share": -0.01, "std": 0.002, "exact": False},
    Why.COVARIANCES_IDLE: {"scale": 0.0213},
    Why.BOARD_HEAD_ON: {"tilt_rad": 0.1},
    Why.FEW_CORNERS: {"images": 7, "all": 20, "corners": 15},
    Why.ONE_AXIS: {"across_rad": 0.05},
    Why.CAMERA_TOO_ROUGH: {},
}

#: Words of their sentences.
SAID = {
    Why.CAMERA_ON_OTHER_LINK: ("50 mm", "3.0 mm", "'hand' carries the camera and 'arm'"),
    Why.SENSE_REVERSED: ("elbow", "2.0 mm", "9.0 mm"),
    Why.SENSE_UNKNOWN: ("elbow, wrist",),
    Why.FOCAL_LENGTH_OFF: ("+1.50 %", "0.20 %", "exact"),
    Why.BOARD_SCALE_OFF: ("-1.00 %", "square_mm"),
    Why.COVARIANCES_IDLE: ("0.021",),
    Why.BOARD_HEAD_ON: ("6 deg",),
    Why.FEW_CORNERS: ("7 of 20", "15"),
    Why.ONE_AXIS: ("2.9 deg",),
    Why.CAMERA_TOO_ROUGH: ("tracker",),
}


@pytest.mark.parametrize("why", VALUES)
def test_sentences_about_images_have_the_values_of_their_reasons(why):
    text = reason_text(Reason.of(why, **VALUES[why]))
    for words in SAID[why]:
        assert words in text


def test_a_wrong_cell_of_dh_rows_is_told_with_its_numbers():
    cells = [
        {"joint": "J4", "column": "d", "unit": "m", "stated": 0.411, "wanted": 0.42, "line": 6},
        {
            "joint": "J6",
            "column": "alpha",
            "unit": "rad",
            "stated": 0.0,
            "wanted": -0.5 * math.pi,
            "line": 0,
        },
    ]
    values = {"given_m": 9e-3, "given_rad": 1.0, "error_m": 1e-5, "error_rad": 1e-4}
    reason = Reason(Why.DH_CELLS, values | {"cells": cells, "elsewhere": "tool"})
    _, _, text = reason_text(reason).partition(" if ")
    assert text == (
        "'d' of 'J4' (line 6) is 420 mm instead of 411 mm (9 mm too short) and 'alpha' of 'J6' is -90 deg instead of "
        "0 deg. A tool that the controller adds, or the line 'tool', would have the same effect."
    )


@pytest.mark.parametrize("falls", [0.05, 0.15])
@pytest.mark.parametrize(
    ("why", "more"),
    [(Why.DRIFT, {}), (Why.TARGET_STEP, {"row": 7, "target": "T", "moved_m": 1e-3})],
)
def test_what_predicts_no_other_rows_is_not_asked_about(why, more, falls):
    text = reason_text(Reason.of(why, share=0.3, chance=0.05, p=1e-4, falls=falls, **more))
    assert ("?" in text) == (falls > PREDICTS)


@pytest.mark.parametrize(
    ("lines", "said"),
    [([6, 7], "'A5' and 'A6' (lines 6 and 7) are"), ([0, 0], "'A5' and 'A6' are")],
)
def test_exchanged_rows_are_named_with_their_lines(lines, said):
    values = {"given_m": 0.2, "given_rad": 1.0, "error_m": 1e-5, "error_rad": 1e-4}
    values |= {"first": "A5", "second": "A6", "lines": lines}
    assert said in reason_text(Reason(Why.DH_ROWS_EXCHANGED, values))


@pytest.mark.parametrize(
    ("arm", "others", "asks"),
    [("", 2e-4, False), ("", 2e-3, True), ("UR3", 2e-3, False)],
)
def test_many_lengths_that_are_off_may_be_other_joint_values(arm, others, asks):
    """One length alone is a variant's; of a variant that is known nothing is asked, it is named."""
    moved = {"moved_m": 0.02, "interval_m": 1e-4, "others_m": others}
    values = {"joint": "elbow", "length": "d", **moved, "arm": arm}
    text = reason_text(Reason.of(Why.OTHER_VARIANT, **values))
    assert ("same moment" in text, f"a {arm}:" in text) == (asks, bool(arm))


@pytest.mark.parametrize("use", [USE, CARE, NO])
def test_a_non_geometric_model_that_is_not_to_be_used_is_not_said_to_be_used(use):
    text = reason_text(Reason.of(Why.LARGER_MODEL, model="dh+gain", after_m=1e-4, use=use))
    assert ("compensate" in text) == (use != NO)
