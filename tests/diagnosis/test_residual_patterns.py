"""Patterns in what a fit leaves over, each with its cause."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.augmented_fit import FEWEST_FREEDOM
from calib.diagnosis.computed import ROUNDING_NOISE
from calib.diagnosis.reasons import Why
from calib.diagnosis.residual_patterns import (
    residual_patterns,
)
from calib.result.calibrate import calibrate
from calib.robot.ranges import random_joint_values
from tests.judged import arm, judged, reasons, table_of


def drift_in(make_scene, way: np.ndarray, *frames: str) -> dict[str, Any]:
    """Values of the drift in a fit to points that are displaced by ``way``, (90, 3), and seen in frames by turns."""
    scene, rng = arm(make_scene, 63), np.random.default_rng(3)
    m = table_of(scene, random_joint_values(scene.robot, 90, 3), rng, way)
    if frames:
        m = replace(m, groups=frames * (len(m) // len(frames)))
    result = calibrate(scene.robot, m, model="dh", validate=False)
    found = residual_patterns(result.fit.geometry, np.arange(90), np.zeros((90, 6)))
    return next(dict(reason.values) for reason in found if reason.why is Why.DRIFT)


def test_a_tracker_that_drifts(make_scene):
    way = np.linspace(0.0, 1.0, 90)[:, None] * np.array([4e-4, -3e-4, 2e-4])
    found = drift_in(make_scene, way)
    assert found["p"] < 0.003
    np.testing.assert_allclose(found["drift_xyz"], [4e-4, -3e-4, 2e-4], atol=4e-5)
    assert found["drift_m"] == pytest.approx(np.linalg.norm(found["drift_xyz"]))
    # The axes of two frames may be turned towards each other: no one way is that of both.
    of_two = drift_in(make_scene, way, "left", "right")
    assert of_two["p"] < 0.003
    assert not {"drift_xyz", "drift_m"} & set(of_two)


def test_joints_that_had_not_arrived(make_scene):
    """They miss 0.05 % of the move from the row before, validation rows among these."""

    def late(m: Measurements) -> Measurements:
        back = 5e-4 * np.diff(m.joints, axis=0, prepend=m.joints[:1])
        sets = tuple("validate" if k % 5 == 4 else "estimate" for k in range(len(m)))
        return replace(m, joints=m.joints + back, sets=sets)

    lagging = judged(make_scene, 63, late, rows=90)
    reason = reasons(lagging)[Why.JOINTS_LAG]
    assert lagging.verdict.use == "use with care"
    assert reason["of_move"] == pytest.approx(5e-4, rel=0.15)
    assert reason["falls"] > 0.5
    assert Why.JOINTS_LAG not in reasons(judged(make_scene, 63, rows=90))


def test_a_drift_matters_where_it_predicts_rows(make_scene):
    """The value that says so is that of blocks of consecutive rows."""
    way = np.linspace(0.0, 1.0, 90)[:, None] * np.array([4e-4, -3e-4, 2e-4])
    assert drift_in(make_scene, way)["falls"] > 0.3
    knocked = np.where(np.arange(90)[:, None] < 89, 0.0, [0.0, 0.0, 4e-4])
    assert Why.DRIFT not in reasons(judged(make_scene, 63, rows=90, bias=knocked))


@pytest.mark.parametrize(
    ("model", "rows", "way", "looked"),
    [
        ("dh", 90, 2e-5, True),
        ("dh", 90, 2e-6, False),
        ("zeros", 6, 1e-4, True),
        ("zeros", 5, 1e-4, False),
    ],
)
def test_no_pattern_is_looked_for_in_rounding_or_where_a_fit_is_nearly_exact(
    make_scene, model: str, rows: int, way: float, looked: bool
):
    """A drift of which a hundredth is noise."""
    scene = arm(make_scene, 66, model=model, noise=way / 100.0)
    m = scene.points(rows)
    drift = np.linspace(0.0, way, rows)[:, None] * [1.0, -0.7, 0.5]
    fitted = calibrate(
        scene.robot, replace(m, points=m.points + drift), model=model, validate=False
    ).fit.geometry
    noise = np.median(fitted.estimate.problem.scales)
    assert (fitted.estimate.freedom > FEWEST_FREEDOM and noise > ROUNDING_NOISE) == looked
    moves = np.diff(m.joints, axis=0, prepend=m.joints[:1])
    found = [reason.why for reason in residual_patterns(fitted, np.arange(rows), moves)]
    assert found == [Why.DRIFT] * looked


def test_a_joint_whose_error_follows_its_angle(make_scene):
    given = {"model": "dh+gain", "other": {"gain": 1.5e-3}}
    result = judged(make_scene, 64, rows=90, given=given)
    assert (result.verdict.use, result.verdict.reasons[0].why) == (
        "use with care",
        Why.MUCH_REMAINS,
    )
    assert reasons(result)[Why.JOINT_PATTERN]["quantity"] == "angle"
    # Where joints go, they came from elsewhere: that is no lag.
    assert Why.JOINTS_LAG not in reasons(result)


def rounded(m: Measurements) -> Measurements:
    return replace(m, joints=np.radians(np.round(np.degrees(m.joints))))


def test_noise_that_no_instrument_has(make_scene):
    """Joint values to 1 deg: the gain on unseen rows is real, but what is left is not the tracker's."""
    noise = reasons(judged(make_scene, 68, rounded))[Why.NOISE_LARGE]["noise_m"]
    assert noise > 1e-3
    told = reasons(judged(make_scene, 68, rounded, cell=Cell(sigma={"m": 3e-5})))
    assert told[Why.NOISE_ABOVE_SIGMA]["ratio"] == pytest.approx(noise / 3e-5, rel=0.01)
    assert told[Why.JOINTS_COARSE]["by_rad"] == pytest.approx(np.radians(1.0))
    scene = arm(make_scene, 68)
    q = np.radians(np.round(np.degrees(random_joint_values(scene.robot, 60, 8)), 1))
    m = table_of(scene, q, np.random.default_rng(8))
    cell = Cell(model="dh", instrument="tracker")
    assert list(reasons(calibrate(scene.robot, m, cell=cell))) == [Why.GAIN]


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


def test_a_target_that_was_knocked_in_a_table_that_is_sorted_otherwise(make_scene, tmp_path):
    """The table has the row's number in the file; what happens in its order is found in that of the measurement."""
    scene, knock = arm(make_scene, 69), np.array([0.0, 3e-3, 0.0])
    q = random_joint_values(scene.robot, 70, 9)
    m = table_of(scene, q, np.random.default_rng(9))
    later = (np.arange(70) >= 34)[:, None]
    turned = scene.robot.poses(q)[:, :3, :3] @ knock
    replace(m, points=m.points + later * turned).write(tmp_path / "data.csv")
    header, *rows = (tmp_path / "data.csv").read_text().splitlines()
    in_file = np.random.default_rng(2).permutation(70)
    lines = [f"{header.replace('row,', 'order,')}", *(rows[k] for k in in_file)]
    (tmp_path / "data.csv").write_text("\n".join(lines))
    result = calibrate(scene.robot, tmp_path / "data.csv", model="dh")
    assert reasons(result)[Why.TARGET_STEP]["row"] == np.flatnonzero(in_file == 34)[0] + 1
    # Without the order there is no step, and rows are outliers or noise.
    (tmp_path / "data.csv").write_text("\n".join(lines).replace("order,", "-,"))
    result = calibrate(scene.robot, tmp_path / "data.csv", model="dh")
    assert Why.TARGET_STEP not in reasons(result)
