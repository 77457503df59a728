"""The verdict: each reason by the figures that cause it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.identify.statistics import CrossValidation, Errors
from calib.identify.verdict import Evidence, verdict

ROWS = 30


def validated(size: float, seed: int = 0, spread: float = 0.3) -> CrossValidation:
    """Left-out residuals of an rms near ``size``."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(ROWS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    residual = directions * size * (1.0 + spread * rng.normal(size=(ROWS, 1)))
    errors = Errors.of(residual)
    return CrossValidation("leave-one-out", ROWS, np.arange(ROWS), residual, errors, errors)


def errors(rms: float, n: int = 5) -> Errors:
    return Errors.of(np.full((n, 3), rms / np.sqrt(3)))


GOOD = Evidence(
    nominal=validated(2.5e-3),
    calibrated=validated(0.2e-3, 1),
    larger_validation=None,
    larger_name="",
    scales=np.full((ROWS, 3), 1e-4),
    used=np.ones((ROWS, 3), dtype=bool),
    repeats=np.arange(ROWS),
    pairs=np.zeros(ROWS, dtype=bool),
    outliers=np.arange(ROWS) < 2,
    validation_nominal=errors(2.7e-3),
    validation_calibrated=errors(0.25e-3),
    validation_aside=0,
    still=(),
    missing="",
    findings=(),
    corner="",
    outside="",
    parameters=27,
    largest=5e-3,
    noise=1e-4,
)


def test_a_good_calibration_is_to_be_used_and_says_by_how_much():
    result = verdict(GOOD)
    assert result.use == "use"
    before, after = (1e3 * v.errors_without_outliers.rms for v in (GOOD.nominal, GOOD.calibrated))
    assert (
        f"outliers aside) the error falls from {before:.3f} to {after:.3f} mm rms"
        in result.reasons[0]
    )
    assert "5 validation rows it falls from 2.700 to 0.250 mm rms" in result.reasons[1]


@pytest.mark.parametrize(
    ("change", "use", "reason"),
    [
        (
            {"calibrated": validated(2.9e-3, 1)},
            "do not use",
            "no better than the nominal one, frame and target fitted for both: 2.",
        ),
        ({"calibrated": GOOD.nominal}, "do not use", "no better than the nominal one"),
        (
            {"validation_calibrated": errors(3e-3)},
            "do not use",
            "validation rows the error does not fall",
        ),
        ({"noise": 0.05}, "do not use", "50 mm a coordinate"),
        ({"noise": 0.05, "hint": "Try --base base."}, "do not use", "Try --base base."),
        ({"hint": "Check the signs."}, "do not use", "Check the signs."),
        (
            {"nominal": validated(0.61e-3, 2), "calibrated": validated(0.59e-3, 1)},
            "use with care",
            "within what chance gives",
        ),
        ({"nominal": validated(0.26)}, "use with care", "mm rms off on unseen rows, which"),
        (
            {"parameters": 60},
            "use with care",
            "30 poses with 90 numbers for 60 parameters are few",
        ),
        (
            {"still": ("'elbow_joint' (3 deg)",)},
            "use with care",
            "Hardly moved over these rows: 'elbow_joint' (3 deg)",
        ),
        ({"missing": "Try --model placement."}, "use with care", "Try --model placement."),
        (
            {"nominal": validated(1e-4, 2), "calibrated": validated(1e-4, 3)},
            "do not use",
            "Nothing to gain: the robot",
        ),
        (
            {"nominal": validated(0.5), "calibrated": validated(0.05, 3)},
            "do not use",
            "the calibrated robot is 5",
        ),
        (
            {
                "nominal": validated(0.6e-3, 2),
                "calibrated": validated(0.58e-3, 5),
                "parameters": 60,
            },
            "do not use",
            "are too few to show a gain",
        ),
        ({"corner": "A corner only."}, "use with care", "A corner only."),
        ({"findings": ("A drift.", "A pattern.")}, "use with care", "A drift."),
        (
            {"nominal": validated(0.3), "largest": 0.4},
            "do not use",
            "meets the rows only by moving a parameter by 400 mm or mrad",
        ),
        ({"largest": 4.6}, "use with care", "has moved by 4600 mm or mrad"),
        ({"outliers": np.arange(ROWS) < 6}, "use with care", "6 of 30 rows are flagged"),
    ],
)
def test_each_doubt_is_said_first(change, use, reason):
    result = verdict(replace(GOOD, **change))
    assert result.use == use
    assert reason in result.reasons[0]


def test_a_gain_is_said_even_where_there_are_doubts():
    result = verdict(replace(GOOD, parameters=60))
    assert any("the error falls from" in reason for reason in result.reasons[1:])


def test_outliers_do_not_decide():
    worse = np.array(GOOD.calibrated.residual)
    worse[:2] += 1.0
    after = replace(GOOD.calibrated, residual=worse)
    assert verdict(replace(GOOD, calibrated=after)).use == "use"


def test_validation_rows_that_were_not_measured_like_the_others():
    result = verdict(
        replace(GOOD, validation_nominal=errors(51e-3), validation_calibrated=errors(50e-3))
    )
    assert result.use == "use with care"
    assert "50.000 mm rms off on the 5 validation rows and 0.2" in result.reasons[0]
    assert verdict(replace(GOOD, validation_calibrated=errors(1.8e-3))).use == "use"


def test_validation_rows_set_aside_are_counted():
    reasons = verdict(replace(GOOD, validation_aside=1)).reasons
    assert any("5 validation rows (1 more aside) it falls" in reason for reason in reasons)


def test_without_validation_rows_nothing_is_said_of_them():
    nothing = errors(1.0, 0)
    result = verdict(replace(GOOD, validation_nominal=nothing, validation_calibrated=nothing))
    assert result.use == "use"
    assert not any("validation rows" in reason for reason in result.reasons)


def test_repeats_are_no_evidence_of_their_own():
    """Ten repeats of three poses: a gain on one of them, as large as it is, says little."""
    poses = np.repeat(np.arange(3), 10)
    before, after = np.full((30, 3), 1e-3), np.full((30, 3), 1e-3)
    before[:10] *= 3.0

    def of(residual: np.ndarray, poses: np.ndarray) -> CrossValidation:
        errors = Errors.of(residual)
        return CrossValidation("leave-one-pose-out", 3, poses, residual, errors, errors)

    few = replace(GOOD, outliers=np.zeros(30, dtype=bool), parameters=3)
    rows = np.arange(30)
    taken_singly = replace(few, nominal=of(before, rows), calibrated=of(after, rows))
    together = replace(few, nominal=of(before, poses), calibrated=of(after, poses), repeats=poses)
    assert verdict(taken_singly).use == "use"
    assert verdict(together).use == "use with care"


def test_chance_alone_is_seldom_taken_for_a_gain():
    """Two robots of the same quality, the second by luck a little better or worse: 'use' is rare."""
    used = sum(
        verdict(
            replace(GOOD, nominal=validated(1e-3, 2 * i), calibrated=validated(1e-3, 2 * i + 1))
        ).use
        == "use"
        for i in range(300)
    )
    assert used < 0.06 * 300


def test_a_model_that_explains_nothing_does_not_make_the_robot_right():
    same = validated(2.5e-3)
    noise = np.full((ROWS, 3), 1.5e-3)
    change = {"nominal": same, "calibrated": same, "noise": 1.5e-3, "scales": noise}
    assert "Nothing to gain" in verdict(replace(GOOD, **change)).reasons[0]
    larger = verdict(replace(GOOD, **change, missing="Try --model placement."))
    assert "no better than the nominal one" in larger.reasons[0]


def test_orientations_that_no_instrument_measures_are_a_wrong_set_up():
    """Inverse orientations leave the positions as good as ever."""
    turned = np.hstack([GOOD.calibrated.residual, np.full((ROWS, 3), 1.0)])
    off = Errors.of(turned)
    e = replace(
        GOOD,
        calibrated=replace(
            GOOD.calibrated, residual=turned, errors=off, errors_without_outliers=off
        ),
    )
    result = verdict(e)
    assert result.use == "do not use"
    assert "orientations are 99 deg rms off" in result.reasons[0]
    assert "not the inverse" in result.reasons[0]


def test_a_wrong_set_up_is_all_that_is_said():
    result = verdict(replace(GOOD, hint="Check the signs.", still=("'j1' (0 deg)",), parameters=60))
    assert result.reasons == ("Check the signs.",)


def test_what_a_larger_model_would_give_is_said_but_does_not_decide():
    larger = validated(0.05e-3, 7)
    result = verdict(replace(GOOD, larger_validation=larger, larger_name="dh+gain"))
    assert result.use == "use"
    rms = 1e3 * larger.errors.rms
    assert (
        f"With the larger model 'dh+gain' it would be {rms:.3f} mm rms. No URDF can hold that"
        in result.reasons[1]
    )


def test_rows_outside_of_what_was_fitted_are_said_last_and_decide_nothing():
    result = verdict(replace(GOOD, outside="row 7: 'j1' 20 deg beyond the measured range"))
    assert result.use == "use"
    assert result.reasons[-1] == (
        "Outside of the joint values that were fitted, where errors may be larger: row 7: 'j1' 20 deg beyond the "
        "measured range."
    )


def test_orientations_are_said_beside_positions():
    def turned(size: float, angle: float, seed: int) -> CrossValidation:
        both = np.hstack([validated(size, seed).residual, validated(angle, seed + 1).residual])
        errors = Errors.of(both)
        return CrossValidation("leave-one-out", ROWS, np.arange(ROWS), both, errors, errors)

    scales = np.repeat([[1e-4, 1e-4]], ROWS, axis=0).repeat(3, axis=1)
    before, after = turned(2e-3, 5e-3, 1), turned(2e-4, 4e-4, 3)
    result = verdict(
        replace(GOOD, nominal=before, calibrated=after, scales=scales, used=scales > 0)
    )
    assert result.use == "use"
    old, new = before.errors, after.errors
    assert (
        f"falls from {1e3 * old.rms:.3f} mm and {np.degrees(old.rms_angle):.3f} deg to "
        f"{1e3 * new.rms:.3f} mm and {np.degrees(new.rms_angle):.3f} deg rms."
    ) in result.reasons[0]


def test_scalars_that_were_not_measured_do_not_count():
    """Lengths: one number a row. The same residuals as three numbers a row would be enough for 40 parameters."""
    used = np.zeros((ROWS, 3), dtype=bool)
    used[:, 0] = True
    few = verdict(replace(GOOD, used=used, parameters=40))
    assert few.use == "use with care"
    assert "30 poses with 30 numbers for 40 parameters are few" in few.reasons[0]
    # Of pairs the second rows hold nothing.
    used[ROWS // 2 :] = False
    halves = np.arange(ROWS) < ROWS // 2
    few = verdict(replace(GOOD, used=used, pairs=halves, parameters=40))
    assert few.reasons[0].startswith("15 pairs of poses with 15 numbers for 40 parameters are few")
    some = verdict(replace(GOOD, used=used, pairs=np.arange(ROWS) < 10, parameters=40))
    assert some.reasons[0].startswith("5 poses and 10 pairs of poses with 15 numbers for 40")
    assert verdict(replace(GOOD, parameters=40)).use == "use"
