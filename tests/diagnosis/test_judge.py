"""The verdict: each reason by the figures that cause it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from calib.diagnosis.evidence import Evidence, ValidationErrors
from calib.diagnosis.judge import judge
from calib.diagnosis.reasons import Reason, Verdict, Why
from calib.numerics.errors import CrossValidation, Errors
from tests.residuals import lengths_and_angles

ROWS = 30


def validated(size: float, seed: int = 0, spread: float = 0.3) -> CrossValidation:
    """Held-out residuals of an rms near ``size``."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(ROWS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    residual = directions * size * (1.0 + spread * rng.normal(size=(ROWS, 1)))
    errors = Errors.of(residual)
    return CrossValidation("leave-one-out", ROWS, np.arange(ROWS), residual, errors, errors)


def errors(rms: float, n: int = 5) -> Errors:
    return Errors.of(np.full((n, 3), rms / np.sqrt(3)))


def on_validation(before: float, after: float, aside: int = 0) -> ValidationErrors:
    return ValidationErrors(errors(before), errors(after), aside, whole=errors(0.26e-3))


GOOD = Evidence(
    nominal=validated(2.5e-3),
    calibrated=validated(0.2e-3, 1),
    scales=np.full((ROWS, 3), 1e-4),
    used=np.ones((ROWS, 3), dtype=bool),
    floor=np.ones((ROWS, 3)),
    repeats=np.arange(ROWS),
    pairs=np.zeros(ROWS, dtype=bool),
    outliers=np.arange(ROWS) < 2,
    validation=on_validation(2.7e-3, 0.25e-3),
    parameters=27,
    changes=True,
    largest=5e-3,
    noise={"m": 1e-4},
    expected=0.2e-3,
    expected_of_nominal=2.5e-3,
)
FLAGGED = np.arange(ROWS) < 6
RIGHT = {"nominal": validated(1e-4, 2), "calibrated": validated(1e-4, 3)}
LOUD = Reason.of(Why.NOISE_LARGE, noise_m=4e-3)
LACKS = Reason.of(Why.MODEL_LACKS, model="dh", non_geometric="placement", noise_m=1e-4, less_m=2e-5)
STILL = Reason.of(Why.JOINTS_STILL, joints="elbow_joint")
FAR = Reason.of(Why.TARGET_FAR, target="", far_m=0.282)


SEVEN = np.repeat(np.arange(ROWS)[:, None] >= ROWS - 7, 3, axis=1)


def _off(why: Why, share: float) -> Reason:
    """A focal length or a board that is other than stated."""
    return Reason.of(why, share=share, std=1e-3, exact=False)


def _late(over_arm: float) -> Reason:
    """Joint values that are late, with an effect of so many times that of the arm's corrections."""
    return Reason.of(Why.JOINTS_LATE, of_step=0.1, over_arm=over_arm, falls=0.9)


def drifting(falls: float) -> Reason:
    """A drift that explains so much of held-out blocks."""
    return Reason.of(Why.DRIFT, share=0.3, chance=0.05, p=1e-4, falls=falls)


def with_errors_at(found: CrossValidation, size: float) -> CrossValidation:
    """With the flagged rows so far off."""
    residual = np.where(FLAGGED[:, None], size / np.sqrt(3.0), found.residual)
    return replace(found, residual=residual, errors=Errors.of(residual))


#: The non-geometric model that explains a robot whose geometry is right.
GAINS = ("frames+gain", errors(0.067e-3))


def codes(found: Verdict) -> list[Why]:
    return [reason.why for reason in found.reasons]


def test_a_good_calibration_is_to_be_used_and_says_by_how_much():
    result = judge(replace(GOOD, validation=on_validation(2.7e-3, 0.25e-3, aside=1)))
    assert (result.use, codes(result)) == ("use", [Why.GAIN, Why.VALIDATION_GAIN])
    gain, fresh = result.reasons
    before, after = (v.errors_without_outliers["m"].rms for v in (GOOD.nominal, GOOD.calibrated))
    assert (gain.values["before_m"], gain.values["after_m"]) == (before, after)
    assert gain.code == "gain"
    assert (gain.values["method"], gain.values["outliers"]) == ("leave-one-out", 2)
    assert (fresh.values["rows"], fresh.values["aside"]) == (5, 1)
    assert fresh.values["whole_m"] == pytest.approx(0.26e-3)


@pytest.mark.parametrize(
    ("change", "use", "why"),
    [
        ({"calibrated": validated(2.9e-3, 1)}, "do not use", Why.NO_BETTER),
        ({"calibrated": GOOD.nominal}, "do not use", Why.NO_BETTER),
        ({"validation": on_validation(2.7e-3, 3e-3)}, "do not use", Why.VALIDATION_NO_BETTER),
        ({"noise": {"m": 0.05}}, "do not use", Why.NOISE_ABSURD),
        ({"nominal": validated(0.3), "largest": 0.4}, "do not use", Why.PARAMETER_ABSURD),
        (
            {"nominal": validated(0.61e-3, 2), "calibrated": validated(0.59e-3, 1)},
            "use with care",
            Why.MAY_BE_CHANCE,
        ),
        ({"nominal": validated(0.26)}, "use with care", Why.FAR_OFF_BEFORE),
        ({"parameters": 60, "expected": 3e-3}, "use with care", Why.FEW_NUMBERS),
        ({"doubts": (_off(Why.BOARD_SCALE_OFF, 0.015),)}, "use with care", Why.BOARD_SCALE_OFF),
        ({"doubts": (_off(Why.BOARD_SCALE_OFF, -0.04),)}, "do not use", Why.BOARD_SCALE_OFF),
        ({"doubts": (_off(Why.FOCAL_LENGTH_OFF, 0.04),)}, "use with care", Why.FOCAL_LENGTH_OFF),
        ({"doubts": (_off(Why.FOCAL_LENGTH_OFF, -0.5),)}, "do not use", Why.FOCAL_LENGTH_OFF),
        # Late joint values are said before errors that no arm has.
        (
            {"nominal": validated(0.3), "largest": 0.4, "doubts": (_late(0.6),)},
            "do not use",
            Why.JOINTS_LATE,
        ),
        ({"doubts": (_late(0.4),)}, "use with care", Why.JOINTS_LATE),
        ({"doubts": (_late(0.6),)}, "do not use", Why.JOINTS_LATE),
        # A joint that stood still was not calibrated, whatever held-out rows say.
        ({"doubts": (STILL,)}, "use with care", Why.JOINTS_STILL),
        # Of seven poses even a proven gain may be chance.
        ({"used": SEVEN, "parameters": 5}, "use with care", Why.FEW_NUMBERS),
        ({"used": SEVEN, "parameters": 5, "changes": False}, "do not use", Why.TOO_FEW),
        # A proven gain is one, though much remains where each fold lacks a row of few.
        (
            {"parameters": 60, "calibrated": validated(1.5e-3, 1)},
            "use with care",
            Why.MUCH_REMAINS,
        ),
        (
            {"doubts": (STILL, LACKS), "expected_of_nominal": 2.2e-4},
            "use with care",
            Why.JOINTS_STILL,
        ),
        ({"expected_of_nominal": 2.2e-4}, "use with care", Why.SMALL_GAIN),
        ({"expected": 0.139, "expected_of_nominal": 0.17}, "do not use", Why.UNKNOWN_ELSEWHERE),
        # Proven where rows were measured, it is good there.
        (
            {"expected": 0.013, "expected_of_nominal": 0.014},
            "use with care",
            Why.UNKNOWN_ELSEWHERE,
        ),
        (
            {
                "expected": 0.013,
                "expected_of_nominal": 0.014,
                "calibrated": validated(1.5e-3, 1),
            },
            "do not use",
            Why.UNKNOWN_ELSEWHERE,
        ),
        ({"changes": False}, "do not use", Why.NO_BETTER),
        (RIGHT, "do not use", Why.NOTHING_TO_GAIN),
        (
            {"nominal": validated(0.5), "calibrated": validated(0.05, 3)},
            "do not use",
            Why.STILL_FAR_OFF,
        ),
        (
            {"nominal": validated(6e-4, 2), "calibrated": validated(5.8e-4, 5), "parameters": 60},
            "do not use",
            Why.TOO_FEW,
        ),
        ({**RIGHT, "parameters": 60}, "do not use", Why.TOO_FEW),
        ({**RIGHT, "full_model_parameters": 60}, "do not use", Why.TOO_FEW),
        ({**RIGHT, "outliers": np.arange(ROWS) < 6}, "do not use", Why.NO_BETTER),
        ({**RIGHT, "doubts": (LOUD,)}, "do not use", Why.NO_BETTER),
        ({"largest": 4.6}, "use with care", Why.PARAMETER_FAR),
        ({"doubts": (FAR,)}, "use with care", Why.TARGET_FAR),
        ({"doubts": (LOUD, FAR)}, "use with care", Why.TARGET_FAR),
        ({"calibrated": validated(1.1e-3, 1)}, "use with care", Why.MUCH_REMAINS),
        (
            {"validation": on_validation(2.7e-3, 2.5e-3)},
            "use with care",
            Why.VALIDATION_SMALL_GAIN,
        ),
        (
            {"calibrated": validated(0.9e-3, 1), "doubts": (LACKS,)},
            "use with care",
            Why.MODEL_LACKS,
        ),
        ({"doubts": (drifting(0.1),)}, "use with care", Why.DRIFT),
        (
            {
                "nominal": validated(3.16e-3, 2),
                "calibrated": validated(3.15e-3, 3),
                "non_geometric": GAINS,
            },
            "do not use",
            Why.NO_URDF_HOLDS,
        ),
        (
            {"outliers": FLAGGED, "calibrated": with_errors_at(GOOD.calibrated, 4e-3)},
            "use with care",
            Why.MANY_OUTLIERS,
        ),
        # As far off as before, but the fall of all errors may be chance.
        (
            {
                "outliers": FLAGGED,
                "nominal": with_errors_at(validated(0.61e-3, 2), 4e-3),
                "calibrated": with_errors_at(validated(0.59e-3, 1), 4e-3),
            },
            "do not use",
            Why.MANY_OUTLIERS,
        ),
        # Far beyond the held-out error it is a doubt; far beyond the nominal one the rows are of something else,
        # whether their error falls or not.
        ({"validation": on_validation(30e-3, 24e-3)}, "use with care", Why.VALIDATION_UNLIKE),
        ({"validation": on_validation(51e-3, 26e-3)}, "do not use", Why.VALIDATION_UNLIKE),
        ({"validation": on_validation(51e-3, 52e-3)}, "do not use", Why.VALIDATION_UNLIKE),
    ],
)
def test_each_doubt_is_said_first(change, use, why):
    result = judge(replace(GOOD, **change))
    assert (result.use, result.reasons[0].why) == (use, why)
    absurd = {Why.NOISE_ABSURD, Why.OTHER_BASE, Why.PARAMETER_ABSURD}
    assert (len(result.reasons) == 1) == (why in absurd)
    # A gain is said even where there are doubts.
    assert Why.GAIN in codes(result) or use == "do not use"


def test_many_flagged_rows_are_accidents_where_they_are_as_far_off_the_nominal_robot():
    accidents = [with_errors_at(v, 20e-3) for v in (GOOD.nominal, GOOD.calibrated)]
    e = replace(GOOD, outliers=FLAGGED, nominal=accidents[0], calibrated=accidents[1])
    result = judge(e)
    assert (result.use, codes(result)) == (
        "use",
        [Why.GAIN, Why.VALIDATION_GAIN, Why.MANY_OUTLIERS],
    )
    # That numbers are few is said before.
    few = judge(replace(e, parameters=60))
    assert codes(few)[-2:] == [Why.FEW_NUMBERS, Why.MANY_OUTLIERS]
    result = judge(replace(e, nominal=GOOD.nominal))
    assert (result.use, codes(result)[0]) == ("do not use", Why.WORSE_WITH_OUTLIERS)


def test_orientations_that_no_instrument_measures_are_a_wrong_set_up():
    """Inverse orientations leave the positions as good as ever."""
    turned = np.hstack([GOOD.calibrated.residual, np.full((ROWS, 3), 1.0)])
    off = Errors.of(turned, lengths_and_angles(np.ones(turned.shape)))
    e = replace(
        GOOD,
        calibrated=replace(
            GOOD.calibrated, residual=turned, errors=off, errors_without_outliers=off
        ),
    )
    (reason,) = judge(e).reasons
    assert reason.why == Why.ORIENTATION_ABSURD
    assert np.degrees(reason.values["after_rad"]) == pytest.approx(99.24, abs=0.01)


def test_orientations_as_an_instrument_measures_them_are_no_wrong_set_up():
    turned = np.hstack([GOOD.calibrated.residual, np.full((ROWS, 3), 1e-3)])
    off = Errors.of(turned, lengths_and_angles(np.ones(turned.shape)))
    calibrated = replace(GOOD.calibrated, errors=off, errors_without_outliers=off)
    assert off["rad"].n == ROWS
    assert judge(replace(GOOD, calibrated=calibrated)).use == "use"


def test_that_no_urdf_holds_what_a_larger_model_does_is_said_before_that_rows_are_few():
    e = replace(
        GOOD,
        nominal=validated(6e-4, 2),
        calibrated=validated(5.8e-4, 5),
        parameters=60,
        non_geometric=GAINS,
        validation=on_validation(6e-4, 6e-4),
    )
    assert codes(judge(e))[0] == Why.NO_URDF_HOLDS
    # Unless validation rows show that this URDF is better nevertheless.
    shown = judge(replace(e, validation=on_validation(6e-4, 4e-4)))
    assert Why.NO_URDF_HOLDS not in codes(shown)
    assert codes(judge(replace(e, non_geometric=None)))[0] == Why.TOO_FEW


def test_a_larger_model_and_rows_outside_are_said_last_and_decide_nothing():
    notes = (
        Reason.of(Why.LARGER_MODEL, model="dh+gain", after=errors(5e-5)),
        Reason.of(Why.OUTSIDE, rows=1, row=7, joint="j1", by_rad=0.3),
    )
    result = judge(replace(GOOD, notes=notes))
    assert (result.use, result.reasons[-2:]) == ("use", notes)
    assert notes[0].values == {"model": "dh+gain", "after_m": pytest.approx(5e-5)}


def test_scalars_that_were_not_measured_do_not_count():
    """Lengths: one number a row. The same residuals as three numbers a row would be enough for 40 parameters."""
    used = np.zeros((ROWS, 3), dtype=bool)
    used[:, 0] = True

    def poses(**change) -> tuple[int, int, int]:
        found = judge(replace(GOOD, used=used, parameters=40, **change)).reasons
        (reason,) = (one for one in found if one.why == Why.FEW_NUMBERS)
        return tuple(reason.values[name] for name in ("poses", "pairs", "numbers"))

    assert poses() == (30, 0, 30)
    # Of pairs the second rows hold nothing.
    used[ROWS // 2 :] = False
    assert poses(pairs=np.arange(ROWS) < ROWS // 2) == (0, 15, 15)
    assert poses(pairs=np.arange(ROWS) < 10) == (5, 10, 15)
    assert judge(replace(GOOD, parameters=40)).use == "use"


def test_a_larger_model_that_moves_joints_alone_is_judged_by_what_it_changes():
    """Gains are no lengths and no angles: none of its parameters in metres or radians has moved."""
    assert judge(replace(GOOD, largest=0.0)).use == "use"


@pytest.mark.parametrize(("share", "may_be_chance"), [(0.98, True), (1.02, False)])
def test_a_gain_is_held_against_chance_with_a_degree_of_freedom_less_than_poses(
    share, may_be_chance
):
    """Four poses, at two of which the squared error falls by more: t is mean over standard error, by hand."""
    t = share * stats.t.ppf(0.97, 3)
    pose = np.arange(ROWS) % 4
    falls = 1.0 + np.sqrt(3.0) / t * np.array([-1.0, 1.0, -1.0, 1.0])
    along_x = 1e-4 * np.eye(3)[0]
    nominal, calibrated = (
        replace(GOOD.nominal, poses=pose, residual=np.sqrt(squares)[pose, None] * along_x)
        for squares in (1.0 + falls, np.ones(4))
    )
    e = replace(GOOD, nominal=nominal, calibrated=calibrated, outliers=np.zeros(ROWS, dtype=bool))
    assert e.gain == pytest.approx(t)
    assert e.unproven == may_be_chance


def test_what_remains_is_counted_without_the_noise_that_the_best_model_leaves():
    """Nominal 2.5 mm, corrected 0.2 mm, all of it noise or none of it."""
    noise = 0.2e-3 / np.sqrt(3.0) / 1e-4
    assert replace(GOOD, floor=np.full((ROWS, 3), noise)).remains_held_out < 0.03
    clean = replace(GOOD, floor=np.full((ROWS, 3), 0.01)).remains_held_out
    assert clean == pytest.approx(0.2 / 2.5, rel=0.05)
    # The noise's mean square, of three scalars of each of 28 rows that are no outliers, is uncertain.
    before, after, noise = (np.full((ROWS, 3), size * 1e-4) for size in (3.0, np.sqrt(2.0), 1.0))
    left = replace(
        GOOD,
        nominal=replace(GOOD.nominal, residual=before),
        calibrated=replace(GOOD.calibrated, residual=after),
        floor=noise / GOOD.scales,
    )
    expected = (2.0 - 1.0 - np.sqrt(2.0 / 84.0)) / (9.0 - 1.0)
    assert left.remains_held_out == pytest.approx(np.sqrt(expected))
    # A robot whose errors only a non-geometric model explains is no robot at its noise.
    assert replace(GOOD, **RIGHT).at_noise_level
    assert not replace(GOOD, **RIGHT, floor=np.full((ROWS, 3), 0.3)).at_noise_level


def test_the_share_that_remains_is_that_of_the_stated_errors_without_noise():
    noise = np.full((ROWS, 3), 2e-3 / np.sqrt(3.0) / 1e-4)
    nominal = replace(GOOD.nominal, errors_without_outliers=errors(2.5e-3))
    nominal = replace(nominal, residual=np.full((ROWS, 3), 2.5e-3 / np.sqrt(3.0)))
    evidence = replace(GOOD, nominal=nominal, calibrated=validated(2.4e-3, 1), floor=noise)
    before, after = evidence.free_of_noise
    # A noise of 2 mm is most of 2.5 mm: 1.5 mm are left.
    assert before == pytest.approx(1.5e-3, rel=1e-9)
    assert after == pytest.approx(before * evidence.remains_held_out, rel=1e-12)
    (reason, *_) = judge(replace(GOOD, calibrated=validated(1.1e-3, 1))).reasons
    values = reason.values
    share = values["free_after_m"] / values["free_before_m"]
    assert share == pytest.approx(values["remains"], rel=1e-12)


def test_much_remains_names_the_model_that_leaves_far_less():
    (reason, *_) = judge(
        replace(GOOD, calibrated=validated(1.1e-3, 1), non_geometric=("dh+gain", errors(1e-4)))
    ).reasons
    assert reason.why == Why.MUCH_REMAINS
    assert (reason.values["model"], reason.values["less_m"]) == ("dh+gain", pytest.approx(1e-4))
    assert reason.values["remains"] == pytest.approx(1.1 / 2.5, rel=0.1)
    (reason, *_) = judge(
        replace(GOOD, calibrated=validated(1.1e-3, 1), non_geometric=("dh+gain", errors(1e-3)))
    ).reasons
    assert "model" not in reason.values


def test_a_row_that_no_other_can_check_is_said_before_what_hangs_on_it():
    """That is all but wrong input; the word is that of the other reasons."""
    alone = Reason.of(Why.SOLE_POSTURE, rows=[30], joints=["elbow_joint"])
    for change, use, first in (
        ({"doubts": (FAR, alone)}, "use with care", [Why.SOLE_POSTURE, Why.TARGET_FAR]),
        (
            {"doubts": (alone,), "calibrated": validated(2.9e-3, 1)},
            "do not use",
            [Why.SOLE_POSTURE, Why.NO_BETTER],
        ),
        (
            {"doubts": (alone, _off(Why.BOARD_SCALE_OFF, -0.04))},
            "do not use",
            [Why.BOARD_SCALE_OFF, Why.SOLE_POSTURE],
        ),
    ):
        found = judge(replace(GOOD, **change))
        assert (found.use, codes(found)[:2]) == (use, first)


@pytest.mark.parametrize("less", [1e-4, 1e-3])
def test_what_another_model_explains_is_neither_noise_nor_chance(less):
    """Of two tables: most of the error falls, or next to nothing does. The other model is far better, or not."""
    explained = less < 1e-3
    other = ("dh+gain", errors(less))
    falls = replace(GOOD, calibrated=validated(0.9e-3, 1), doubts=(LOUD,), non_geometric=other)
    found = judge(falls)
    assert found.use == "use with care"
    assert codes(found)[0] is (Why.MUCH_REMAINS if explained else Why.NOISE_LARGE)
    assert (Why.NOISE_LARGE in codes(found)) is not explained

    hardly = replace(
        GOOD,
        nominal=validated(1.01e-3, 2),
        calibrated=validated(1e-3, 1),
        validation=on_validation(2.7e-3, 2e-3),
        non_geometric=other,
    )
    found = judge(hardly)
    assert (found.use, Why.MAY_BE_CHANCE in codes(found)) == ("use with care", True)
    assert codes(found)[0] is (Why.MUCH_REMAINS if explained else Why.MAY_BE_CHANCE)


def test_a_scale_is_named_where_too_much_would_remain_by_it_alone():
    for by_scale, use in ((0.9e-3, "use"), (1.1e-3, "use with care")):
        expected = float(np.hypot(0.2e-3, by_scale))
        evidence = replace(GOOD, expected=expected, by_scale=by_scale, scale=2e-3)
        result = judge(evidence)
        assert result.use == use
        assert (Why.SCALE_HIDDEN in codes(result)) == (use != "use")
    first = result.reasons[0]
    assert first.values == {"scale": 2e-3, "effect_m": by_scale, "share": pytest.approx(0.44)}
    # Where as much remains without it, it is no matter of the instrument.
    for other in ({"by_scale": 0.1e-3}, {"calibrated": validated(1.5e-3, 1)}):
        assert Why.SCALE_HIDDEN not in codes(judge(replace(evidence, **other)))


def test_a_drift_that_predicts_nothing_is_information():
    result = judge(replace(GOOD, doubts=(drifting(0.09),)))
    assert (result.use, codes(result)[-1]) == ("use", Why.DRIFT)
    # Nor where the gain is not proven.
    result = judge(replace(GOOD, expected_of_nominal=2.2e-4, doubts=(drifting(-0.2),)))
    assert codes(result)[0] == Why.SMALL_GAIN


@pytest.mark.parametrize(
    ("share", "use", "why"),
    [
        (0.89, "use", Why.GAIN),
        (0.91, "use with care", Why.SMALL_GAIN),
        (0.98, "use with care", Why.SMALL_GAIN),
    ],
)
def test_a_gain_is_proven_where_held_out_errors_fall_by_a_tenth(share, use, why):
    """Nearly all of the error is noise, which no calibration takes away."""
    nominal = validated(2.5e-3, 4, spread=0.01)
    residual = share * nominal.residual
    errors_left = Errors.of(residual)
    calibrated = replace(
        nominal, residual=residual, errors=errors_left, errors_without_outliers=errors_left
    )
    noise = 0.999 * share * 2.5e-3 / np.sqrt(3.0) / 1e-4
    e = replace(GOOD, nominal=nominal, calibrated=calibrated, floor=np.full((ROWS, 3), noise))
    assert e.remains_held_out < 0.2
    result = judge(e)
    assert (result.use, result.reasons[0].why) == (use, why)


@pytest.mark.parametrize(
    ("share", "use", "why"),
    [
        (0.89, "use", Why.VALIDATION_GAIN),
        (0.91, "use with care", Why.VALIDATION_SMALL_GAIN),
        (0.98, "use with care", Why.VALIDATION_SMALL_GAIN),
        (1.01, "do not use", Why.VALIDATION_NO_BETTER),
    ],
)
def test_errors_on_validation_rows_must_fall_by_a_tenth(share, use, why):
    result = judge(replace(GOOD, validation=on_validation(1e-3, share * 1e-3)))
    assert result.use == use
    assert why in codes(result)


def test_an_image_tells_six_numbers_of_the_robot_and_repeats_none():
    """Ten images of three corners, the last two at one pose; of 27 parameters twice as many numbers are wanted."""
    repeats = np.repeat([*range(9), 8], 3)
    images = replace(GOOD, repeats=repeats, images=np.ones(ROWS, dtype=bool))
    few = [
        one for one in judge(replace(images, parameters=28)).reasons if one.why == Why.FEW_NUMBERS
    ]
    assert {name: few[0].values[name] for name in ("poses", "numbers", "images")} == {
        "poses": 9,
        "numbers": 54,
        "images": 9,
    }
    enough = judge(replace(images, parameters=27))
    assert Why.FEW_NUMBERS not in [one.why for one in enough.reasons]
