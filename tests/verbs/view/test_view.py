"""Views hold the robots, poses, targets and errors of calibrations, results and tables."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.example import PAPER_TARGET
from calib.result.calibrate import calibrate
from calib.result.calibration_file import read_result
from calib.robot.ranges import column_ranges, random_joint_values
from calib.show.scene.posed_robot import translation
from calib.show.verdict_text import reason_text
from calib.verbs.view.steps import MOST_STEPS
from calib.verbs.view.view import (
    View,
    joint_texts,
    view_of,
    view_of_result,
    view_of_robots,
)
from tests.hard_cases import made, many_rows, with_rows
from tests.parts import with_part
from tests.view_fixtures import registered


@pytest.fixture(scope="module")
def result():
    return made("paper")


@pytest.fixture(scope="module")
def stored(result, tmp_path_factory):
    """The result as its file has it."""
    return read_result(result.write_json(tmp_path_factory.mktemp("stored") / "result.json"))


def distances(view: View) -> np.ndarray:
    """From measured to predicted target in the picture, shape (2, N)."""
    return np.linalg.norm(view.points - view.predicted, axis=2)


def test_the_map_of_uncertainty_is_that_of_the_result_made_here_or_read(result, stored):
    shown = view_of(result).uncertainty
    U = result.uncertainty(shown.q, non_geometric=False)
    np.testing.assert_allclose(shown.position, U.position)
    np.testing.assert_allclose(shown.places, U.poses[:, :3, 3], atol=1e-12)
    assert len(shown.q) <= 1000
    again = view_of_result(stored, stored.nominal).uncertainty
    np.testing.assert_allclose(again.position, shown.position, rtol=1e-6)
    assert view_of_robots(result.nominal, result.robot).uncertainty is None


def test_predictions_are_those_of_the_robots_in_one_base(ur3, disturb):
    q = np.linspace(-1, 1, 12).reshape(2, 6)
    target = translation([0.0, 0.02, 0.1])
    disturbed = disturb(ur3)
    view = View(ur3, disturbed, q, nominal_target=target)
    view = registered(view, translation([0.001, 0, 0]))
    expected = (ur3.poses(q) @ target)[:, :3, 3] + [0.001, 0, 0]
    np.testing.assert_allclose(view.predicted, [expected, disturbed.poses(q)[:, :3, 3]], atol=1e-15)
    assert (view.labels, view.kinds) == (("pose 1", "pose 2"), ("pose",) * 2)
    assert not view.has_points
    assert list(View(ur3, None, q).robots) == ["nominal"]


@pytest.mark.slow
def test_of_many_rows_an_even_choice_is_shown_with_the_flagged_ones():
    c = many_rows(6000)
    view = view_of(c)
    assert 300 < len(view.q) <= MOST_STEPS
    assert view.measured.rows == 6000
    flagged = {f"row {outlier.row}" for outlier in (*c.rows.outliers, *c.rows.suspects)}
    assert flagged
    assert {n for n, k in zip(view.labels, view.kinds, strict=True) if k == "flagged"} == flagged
    numbers = [int(label.removeprefix("row ")) for label in view.labels]
    assert max(np.diff(numbers)) < 20
    np.testing.assert_array_equal(view.q, c.fit.measurements.joints[np.array(numbers) - 1])
    np.testing.assert_allclose(distances(view), view.measured.errors["m"], atol=1e-12)
    assert view.kinds[view.start] == "estimation"


def test_every_row_is_a_pose_and_a_typical_row_is_shown_first(result):
    view = view_of(result)
    assert view.labels == tuple(f"row {row}" for row in range(1, 36))
    assert view.labels[view.start] == "row 5"
    # Of the 28 fitted rows it has neither robot's error far from the median.
    fitted = view.measured.errors["m"][:, np.array(view.kinds) == "estimation"]
    assert fitted.shape == (2, 28)
    below = np.sum(fitted < view.measured.errors["m"][:, [view.start]], axis=1)
    assert np.abs(below - 13.5).max() < 4
    assert [view.labels[n] for n in range(35) if view.kinds[n] == "flagged"] == ["row 11", "row 14"]
    assert view.kinds[30:] == ("validation",) * 5
    np.testing.assert_allclose(view.nominal_target[:, :3, 3], np.tile(PAPER_TARGET, (35, 1)))
    np.testing.assert_array_equal(view.calibrated_target[3, :3, 3], result.target)
    assert (view.verdict, view.note) == ("use", reason_text(result.verdict.reasons[0]))
    assert not len(view.measured.stations)  # measured in the base itself
    np.testing.assert_allclose(distances(view), view.measured.errors["m"], atol=1e-12)
    for k, who in enumerate(("nominal", "calibrated")):
        rms = np.sqrt(np.mean(view.measured.errors["m"][k, 30:] ** 2))
        assert rms == pytest.approx(result.errors[who]["validation"]["m"].rms, abs=1e-12)


def test_measured_points_are_shown_in_the_base_frame_and_the_tracker_where_it_stands(result):
    T = translation([2.0, -1.0, 0.4])
    T[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    moved = replace(
        result.fit.measurements, points=result.fit.measurements.points @ T[:3, :3].T + T[:3, 3]
    )
    setup = result.setup.with_poses(T[None], result.setup.T_tip_target)
    view = view_of(with_rows(with_part(result, "geometry", setup=setup), moved))
    np.testing.assert_allclose(view.points, result.fit.measurements.points, atol=1e-12)
    np.testing.assert_allclose(view.measured.stations, [np.linalg.inv(T)], atol=1e-12)


@pytest.mark.slow
def test_errors_in_the_picture_are_those_of_the_tables_when_the_frame_is_estimated(result):
    cell = Cell(estimate_frame=True)
    calibrated = calibrate(result.nominal, result.fit.measurements, cell=cell, validate=False)
    view = view_of(calibrated)
    off = np.linalg.norm(calibrated.rows.residual_nominal, axis=1)
    np.testing.assert_allclose(distances(view)[0], off, atol=1e-12)
    # Each of the two finds the tracker elsewhere: without that, the number would be another.
    elsewhere = distances(registered(view, np.eye(4)))[0]
    assert np.abs(elsewhere - off).max() > 1e-4
    assert len(view.measured.stations) == 1
    assert view.is_registered_apart
    assert not view_of(result).is_registered_apart


def test_the_calibrated_robot_s_label_follows_the_verdict_and_what_was_written(result):
    assert view_of(result).names[1] == ("Calibrated", f"the corrected URDF (run {result.run})")
    bad = made("do_not_use")
    assert bad.verdict.use == "do not use"
    withheld, accepted = (view_of(bad, accepted=accepted).names[1][1] for accepted in (False, True))
    assert "URDF" in withheld
    assert "corrected" not in withheld
    assert "corrected URDF" in accepted
    unchanged = replace(bad, robot=bad.nominal)
    assert view_of(unchanged, accepted=True).names[1][1].startswith("unchanged")


def test_joint_values_are_told_in_degrees_and_millimetres(gantry):
    view = view_of_robots(gantry)
    assert tuple(view.numbers) == gantry.joint_names
    texts = joint_texts(gantry, np.array([[0.5, -0.0123, np.pi / 4]]))
    assert texts == {"x": ("500.000 mm",), "y": ("-12.300 mm",), "c": ("45.000 deg",)}
    assert not view_of_robots(gantry, gantry).numbers


def test_the_target_and_station_of_the_row_are_shown(ur3):
    q = random_joint_values(ur3, 60, 3)
    T = ur3.poses(q)
    points = T[:, :3, :3] @ PAPER_TARGET + T[:, :3, 3]
    frames = {"near": np.eye(4), "far": translation([2.0, 1.0, 0.5])}
    frames["far"][:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    far = np.arange(60) >= 30
    seen = np.where(far[:, None], points @ frames["far"][:3, :3].T + frames["far"][:3, 3], points)
    table = Measurements(
        joint_names=ur3.joint_names,
        joints=q,
        points=seen,
        groups=tuple("far" if f else "near" for f in far),
        targets=tuple("one" if k % 2 else "two" for k in range(60)),
    )
    calibrated = calibrate(ur3, table, cell=Cell(frames=frames, model="zeros"), validate=False)
    view = view_of(calibrated)
    np.testing.assert_allclose(view.points, points, atol=1e-9)
    for row in (0, 1):
        t = calibrated.setup.targets.index(table.targets[row])
        np.testing.assert_array_equal(view.calibrated_target[row], calibrated.setup.T_tip_target[t])
    np.testing.assert_allclose(view.measured.stations, [np.linalg.inv(frames["far"])], atol=1e-12)


def test_one_robot_moves_one_joint_after_the_other(gantry):
    view = view_of_robots(gantry)
    moved = np.abs(view.q - view.q[0]) > 1e-12
    assert moved.sum(axis=1).max() == 1
    ranges = column_ranges(gantry)
    np.testing.assert_allclose(np.stack([view.q.min(axis=0), view.q.max(axis=0)], axis=1), ranges)
    assert f"x at {1e3 * ranges[0, 0]:.4g} mm" in view.labels
    assert f"c at {np.degrees(ranges[2, 1]):.4g} deg" in view.labels


def test_robots_and_a_table_show_what_evaluate_says(result):
    alone = view_of_robots(result.nominal, None, result.fit.measurements, cells=[result.fit.cell])
    assert (alone.title, alone.calibrated) == ("ur3", None)
    np.testing.assert_allclose(
        alone.measured.errors["m"][0], view_of(result).measured.errors["m"][0]
    )
    both = view_of_robots(
        result.nominal, result.robot, result.fit.measurements, cells=[result.fit.cell] * 2
    )
    np.testing.assert_allclose(distances(both), both.measured.errors["m"], atol=1e-12)
    assert both.labels[both.start] == "row 7"  # here outliers count as fitted
    assert [name for name, _ in both.names] == ["Nominal", "Calibrated"]


def test_a_stored_result_shows_the_errors_of_the_fit_from_either_robot(result, stored):
    shown = view_of_result(stored, result.nominal, result.fit.measurements)
    fresh = view_of(result)
    np.testing.assert_allclose(shown.measured.errors["m"], fresh.measured.errors["m"], atol=1e-9)
    assert (shown.kinds, shown.start, shown.note) == (fresh.kinds, fresh.start, fresh.note)
    other = view_of_result(stored, result.robot, result.fit.measurements)
    np.testing.assert_allclose(shown.predicted, other.predicted, atol=1e-9)
    # Row numbers of another table mean other rows.
    another = replace(result.fit.measurements, sha256="0")
    assert "flagged" not in view_of_result(stored, result.nominal, another).kinds


def test_targets_without_a_table_are_the_result_s_or_the_cell_s(result, stored):
    of_result = view_of_result(stored, result.nominal)
    np.testing.assert_allclose(of_result.calibrated_target[:3, 3], result.target, atol=1e-12)
    cell = Cell().with_target([0.1, 0.2, 0.3])
    for view in (
        view_of_result(stored, result.nominal, cell=cell, known=("frame",)),
        view_of_robots(result.nominal, cells=[cell]),
    ):
        np.testing.assert_allclose(view.nominal_target[:3, 3], [0.1, 0.2, 0.3])
    assert not view_of_robots(result.nominal).nominal_target[:3, 3].any()
