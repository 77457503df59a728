"""All figures of a result that its verdicts rest on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.basics.channels import Channels
from calib.diagnosis.reasons import Reason, Why
from calib.diagnosis.stated_values import Scale
from calib.result.calibration import Calibration
from calib.result.collected_evidence import (
    _collect_evidence,
    _expected_over_limits,
    _notes,
    compare_validation_errors,
    without_explained,
)
from calib.robot.ranges import spread_poses
from tests.parts import with_part

ALL = Channels.of_unit(np.ones((10, 3), dtype=bool))


def test_one_wild_validation_row_is_set_aside():
    validation = np.arange(10) >= 4
    nominal, calibrated = np.full((10, 3), 1e-3), np.full((10, 3), 1e-4)
    nominal[7] = calibrated[7] = 0.05
    found = compare_validation_errors(validation, np.arange(10) == 7, nominal, calibrated, ALL)
    assert (found.before["m"].n, found.after["m"].n, found.aside) == (5, 5, 1)
    assert found.after["m"].rms == pytest.approx(1e-4 * np.sqrt(3))
    # Stated too is the error with it.
    assert (found.whole["m"].n, found.whole["m"].max) == (6, pytest.approx(0.05 * np.sqrt(3)))


@pytest.mark.parametrize(
    ("rows", "wild", "aside"),
    [(1, 1, 0), (2, 1, 1), (6, 3, 0), (13, 2, 0), (14, 2, 2), (20, 3, 3), (20, 4, 0)],
)
def test_many_rows_that_do_not_fit_are_no_accidents(rows: int, wild: int, aside: int):
    """One of several may be, or 15 % of the rows."""
    validation = np.arange(4 + rows) >= 4
    residual = np.full((4 + rows, 3), 1e-3)
    suspects = np.arange(4 + rows) >= 4 + rows - wild
    channels = Channels.of_unit(np.ones(residual.shape, dtype=bool))
    found = compare_validation_errors(validation, suspects, residual, residual, channels)
    assert (found.before["m"].n, found.aside) == (rows - aside, aside)


@pytest.mark.parametrize(("name", "places"), [("points", 3), ("set-ups", 3 * 6 + 3), ("poses", 12)])
def test_a_full_geometry_has_four_parameters_a_joint_besides_frames_and_targets(
    calibrated, name: str, places: int
):
    _, c = calibrated(name)

    def full_model_parameters(result: Calibration) -> int:
        fitted = result.fit.geometry
        rows, residual = fitted.estimate.problem.rows, result.rows.residual_calibrated
        evidence = _collect_evidence(result, result.geometry, fitted, residual, rows, ())
        return evidence.full_model_parameters

    assert full_model_parameters(c) == 6 * 4 + places
    # None is asked for if the model was named.
    assert full_model_parameters(with_part(c, "method", candidates=())) == 0


def test_the_nominal_robot_is_off_over_the_joint_limits_by_what_was_corrected(calibrated):
    """Without uncertainty of the parameters: the distance of both predictions, rms."""
    _, c = calibrated("known set-ups")
    certain = with_part(
        c,
        "geometry",
        covariance=np.zeros_like(c.covariance),
        expected_measured=0.0,
        scale=None,
        undetermined=0.0,
    )
    of_model, of_nominal, _ = _expected_over_limits(certain, certain.geometry)
    q = spread_poses(c.nominal)
    points = c.predict(q, target=c.setup.targets[0], group=c.setup.groups[0])
    setup = c.nominal_setup
    T = setup.T_frame_base[0] @ c.nominal.poses(q) @ setup.T_tip_target[0]
    away = np.linalg.norm(points - T[:, :3, 3], axis=1)
    assert of_model == 0.0
    assert of_nominal == pytest.approx(np.sqrt(np.mean(away**2)))


def test_if_all_changes_are_scale_the_nominal_robot_is_the_better_one(calibrated):
    """The floor under its error counts before the scale: the model alone is off by the growth of the arm."""
    _, c = calibrated("known set-ups")
    scale = Scale(share=1.0, std=1e-9, freedom=1e6, prior=1.0, growth=c.geometry.x)
    grown = with_part(
        c,
        "geometry",
        covariance=np.zeros_like(c.covariance),
        expected_measured=0.0,
        scale=scale,
        undetermined=0.0,
    )
    of_model, of_nominal, by_scale = _expected_over_limits(grown, grown.geometry)
    exact = with_part(grown, "geometry", scale=None)
    _, changed, _ = _expected_over_limits(exact, exact.geometry)
    assert of_model == by_scale == pytest.approx(changed, rel=0.02)
    assert of_nominal < 0.02 * of_model


def test_over_the_joint_limits_the_variance_of_predictions_counts_for_both_robots(calibrated):
    """trace(J C J^T), mean over the poses: all of it is expected of a model that is certain where it was measured."""
    _, c = calibrated("known set-ups")
    c = with_part(c, "geometry", scale=None)
    only_there = with_part(
        c, "geometry", expected_measured=0.0, extrapolation=1.0, undetermined=0.0
    )
    certain = with_part(only_there, "geometry", covariance=np.zeros_like(c.covariance))
    of_model, of_nominal, _ = _expected_over_limits(only_there, only_there.geometry)
    _, away, _ = _expected_over_limits(certain, certain.geometry)
    std = c.geometry.pose_std(c.samples(spread_poses(c.nominal)))[:, 0]
    assert of_model == pytest.approx(np.sqrt(np.mean(std**2)))
    assert of_nominal == pytest.approx(np.hypot(away, of_model))


def test_it_is_said_if_all_joints_arrived_from_one_side(calibrated):
    """In every fitted row, by the moves that the table states."""
    _, c = calibrated("points")
    table = c.fit.measurements

    first, second, *others = c.nominal.joint_names

    def falling(moves) -> list[str] | None:
        """The joints that are said to have come falling; None: nothing is said of a side."""
        result = with_part(c, "fit_in_memory", measurements=replace(table, moves=moves))
        said = [reason.values for reason in _notes(result) if reason.why is Why.ONE_SIDED]
        assert all({*v["rising"], *v["falling"]} == {first, second, *others} for v in said)
        return said[0]["falling"] if said else None

    rising = np.full(table.joints.shape, 0.1)
    assert falling(rising) == []
    assert falling(-rising) == [first, second, *others]
    assert falling(np.where(np.arange(6) == 1, -rising, rising)) == [second]
    assert falling(0.0 * rising) is None
    rising[7, 2] = -0.1
    assert falling(rising) is None
    assert falling(None) is None


def test_late_joint_values_are_not_said_to_be_creep_too():
    creeps, short = Reason.of(Why.CREEPS, joint="a"), Reason.of(Why.STOPS_SHORT, joint="a")
    late, step = Reason.of(Why.JOINTS_LATE, of_step=0.1), Reason.of(Why.TARGET_STEP)
    assert without_explained([creeps, short], [step, late]) == (short,)
    assert without_explained([creeps, short], [step]) == (creeps, short)


def test_a_robot_that_is_corrected_already_is_named(calibrated):
    _, first = calibrated("known set-ups")
    assert Why.ALREADY_CORRECTED not in {note.why for note in _notes(first)}
    again = replace(first, nominal=first.robot)
    (note,) = [note for note in _notes(again) if note.why is Why.ALREADY_CORRECTED]
    assert note.values == {"run": first.run, "verdict": ""}
