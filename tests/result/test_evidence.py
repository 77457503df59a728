"""What the verdict looks at besides errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Why
from calib.result.calibrate import Calibration, calibrate
from calib.result.evidence import disagreeing_setups, validation_errors
from calib.robot.readback import random_joint_values

ALL = np.ones((10, 3), dtype=bool)


def test_one_wild_validation_row_is_set_aside():
    validation = np.arange(10) >= 4
    nominal, calibrated = np.full((10, 3), 1e-3), np.full((10, 3), 1e-4)
    nominal[7] = calibrated[7] = 0.05
    before, after, aside = validation_errors(
        validation, np.arange(10) == 7, nominal, calibrated, ALL
    )
    assert (before.n, after.n, aside) == (5, 5, 1)
    assert after.rms == pytest.approx(1e-4 * np.sqrt(3))


def test_many_rows_that_do_not_fit_are_no_accidents():
    validation = np.arange(10) >= 4
    residual = np.full((10, 3), 1e-3)
    before, _, aside = validation_errors(validation, np.arange(10) >= 7, residual, residual, ALL)
    assert (before.n, aside) == (6, 0)


def table_of(scene: Any, q: np.ndarray, rng: np.random.Generator, bias: Any = 0.0) -> Measurements:
    """Points of the true robot at these joint values, seen in the base frame."""
    points = scene.kinematics.points(scene.x, scene.samples(len(q), q=q))
    points = points + 3e-5 * rng.normal(size=points.shape) + bias
    return Measurements(joint_names=scene.robot.joint_names, joints=q, points=points)


def arm(make_scene: Callable[..., Any], seed: int, **given: Any) -> Any:
    usual = {"frames": [np.eye(4)], "length": 3e-4, "angle": 3e-3}
    return make_scene(seed, **(usual | given))


def reasons(result: Calibration) -> dict[Why, dict[str, Any]]:
    """The numbers and names of each reason."""
    assert result.verdict is not None
    return {reason.why: reason.values for reason in result.verdict.reasons}


def judged(make_scene, seed, changed=None, *, rows=70, bias=0.0, given=None, **how) -> Calibration:
    """A fit to a table of random poses that was changed."""
    scene, rng = arm(make_scene, seed, **(given or {})), np.random.default_rng(seed - 60)
    m = table_of(scene, random_joint_values(scene.robot, rows, seed - 60), rng, bias)
    return calibrate(scene.robot, changed(m) if changed else m, **{"model": "dh", **how})


def test_good_data_give_no_reason_for_care(make_scene):
    result = judged(make_scene, 61)
    assert result.verdict.use == "use"
    assert list(reasons(result)) == [Why.GAIN]


def test_a_corner_of_the_workspace(make_scene):
    scene = arm(make_scene, 62)
    rng = np.random.default_rng(2)
    q = np.array([0.3, -1.2, 1.4, -0.8, 0.6, 0.2]) + 0.25 * rng.uniform(-1, 1, (70, 6))
    result = calibrate(scene.robot, table_of(scene, q, rng), model="dh")
    assert reasons(result)[Why.CORNER]["spread"] < 1 / 3


def test_a_tracker_that_drifts(make_scene):
    way = np.linspace(0.0, 1.0, 90)[:, None] * np.array([4e-4, -3e-4, 2e-4])
    result = judged(make_scene, 63, rows=90, bias=way)
    assert result.verdict.use == "use with care"
    assert reasons(result)[Why.DRIFT]["p"] < 0.003


def test_a_joint_whose_error_follows_its_angle(make_scene):
    given = {"model": "dh+gain", "other": {"gain": 1.5e-3}}
    result = judged(make_scene, 64, rows=90, given=given)
    assert result.verdict.use == "use"
    assert reasons(result)[Why.JOINT_PATTERN]["quantity"] == "angle"


def test_a_set_up_that_the_others_do_not_predict(calibrated):
    """In one of three set-ups a joint slipped: each set-up alone looks well, but not from the others."""
    scene, good = calibrated("set-ups")
    m = good.measurements
    joints = m.joints.copy()
    joints[np.array(m.groups) == "1", 2] += 2e-4
    slipped = calibrate(scene.robot, replace(m, joints=joints), cell=good.cell)
    assert reasons(slipped)[Why.SETUP_UNPREDICTED]["setup"] == "1"
    assert slipped.verdict.use == "use with care"
    assert Why.SETUP_UNPREDICTED not in reasons(good)
    assert len(disagreeing_setups(good.fitted)) == 0


def test_a_set_up_whose_rows_are_flagged(calibrated):
    """A joint slipped further: the robust fit takes that set-up's rows for outliers, and the set-up is named."""
    scene, good = calibrated("set-ups")
    m = good.measurements
    joints = m.joints.copy()
    joints[np.array(m.groups) == "1", 2] += 2e-3
    slipped = calibrate(scene.robot, replace(m, joints=joints), cell=good.cell)
    assert reasons(slipped)[Why.SETUP_FLAGGED]["setup"] == "1"
    assert slipped.verdict.use != "use"
    assert Why.SETUP_FLAGGED not in reasons(good)


def test_sockets_without_a_known_distance_tell_no_length(calibrated):
    scene, good = calibrated("sockets")
    assert Why.NO_LENGTH not in reasons(good)
    unknown = calibrate(scene.robot, good.measurements, cell=replace(good.cell, distances=()))
    assert Why.NO_LENGTH in reasons(unknown)
    assert unknown.verdict.use == "use with care"


def test_a_model_that_lacks_what_placements_have(make_scene):
    result = judged(make_scene, 67, model="zeros", given={"model": "placement"})
    told = reasons(result)[Why.MODEL_LACKS]
    assert (told["model"], told["less_m"] < 0.6 * told["noise_m"]) == ("zeros", True)


def rounded(m: Measurements) -> Measurements:
    return replace(m, joints=np.radians(np.round(np.degrees(m.joints))))


def test_noise_that_no_instrument_has(make_scene):
    """Joint values to 1 deg: the gain on unseen rows is real, but what is left is not the tracker's."""
    noise = reasons(judged(make_scene, 68, rounded))[Why.NOISE_LARGE]["noise_m"]
    assert noise > 1e-3
    told = reasons(judged(make_scene, 68, rounded, cell=Cell(sigma=3e-5)))
    assert told[Why.NOISE_ABOVE_SIGMA]["ratio"] == pytest.approx(noise / 3e-5, rel=0.01)
    assert told[Why.JOINTS_COARSE]["by_rad"] == pytest.approx(np.radians(1.0))
    scene = arm(make_scene, 68)
    q = np.radians(np.round(np.degrees(random_joint_values(scene.robot, 60, 8)), 1))
    m = table_of(scene, q, np.random.default_rng(8))
    assert list(reasons(calibrate(scene.robot, m, model="dh"))) == [Why.GAIN]


@pytest.mark.parametrize(("row", "by"), [(35, 3e-3), (55, 1e-3)])
def test_a_target_that_was_knocked(make_scene, row, by):
    """Half way no row is flagged; of the last quarter all are."""
    robot, knock = arm(make_scene, 69).robot, np.array([0.0, by, 0.0])

    def knocked(m: Measurements) -> Measurements:
        later = (np.arange(len(m)) >= row - 1)[:, None]
        return replace(m, points=m.points + later * (robot.poses(m.joints)[:, :3, :3] @ knock))

    result = judged(make_scene, 69, knocked)
    told = reasons(result)[Why.TARGET_STEP]
    assert (result.verdict.use, told["row"]) == ("use with care", row)
    assert told["moved_m"] == pytest.approx(by, rel=0.05)


@pytest.mark.parametrize("scale", [0.01, -0.01])
def test_a_scale_of_the_instrument(make_scene, scale):
    """A board printed 1 % too large: the fit makes every link longer, and unseen rows agree."""
    result = judged(make_scene, 70, lambda m: replace(m, points=(1.0 + scale) * m.points))
    told = reasons(result)[Why.LENGTHS_SCALED]
    assert told["scale"] == pytest.approx(scale, abs=3.0 * told["std"])
    assert result.verdict.use == "use with care"


def test_a_joint_that_moves_against_its_load_where_gravity_is_turned(make_scene):
    scene = arm(make_scene, 71, model="dh+compliance", other={"compliance": 2e-4})
    scene.x[scene.kinematics.model.family("compliance")] = 1e-4
    m = table_of(scene, random_joint_values(scene.robot, 70, 11), np.random.default_rng(11))
    up, down = (Cell(model="dh+compliance", gravity=(0.0, 0.0, g)) for g in (9.81, -9.81))
    assert Why.COMPLIANCE_NEGATIVE in reasons(calibrate(scene.robot, m, cell=up))
    assert Why.COMPLIANCE_NEGATIVE not in reasons(calibrate(scene.robot, m, cell=down))


def test_copies_of_rows_are_left_out(make_scene):
    def twice(m: Measurements) -> Measurements:
        each = np.arange(80) // 2
        return Measurements(m.joint_names, joints=m.joints[each], points=m.points[each])

    one, other = judged(make_scene, 72, rows=40), judged(make_scene, 72, twice, rows=40)
    np.testing.assert_array_equal(one.x, other.x)
    assert reasons(other)[Why.ROWS_COPIED] == {"rows": 40, "row": 2}
