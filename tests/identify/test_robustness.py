"""The fit with and without the rows that do not fit: planted ones do what the comparison says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.identify.calibration import Calibration, calibrate
from calib.identify.robustness import compare
from calib.identify.summary import summary
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics
from calib.model.readback import random_joint_values
from calib.model.robot import Robot

TARGET = np.array([0.05, -0.06, 0.04])
WILD = (4, 21)
CELL = Cell(model="zeros")


@pytest.fixture(scope="module")
def table(ur3: Robot) -> Measurements:
    """Forty good rows, and two of them spoilt by 10 mm; the last ten for validation."""
    q = random_joint_values(ur3, 40, 1)
    poses, rng = ur3.poses(q), np.random.default_rng(1)
    points = poses[:, :3, :3] @ TARGET + poses[:, :3, 3] + 1e-4 * rng.normal(size=(40, 3))
    points[list(WILD)] += [0.0, 0.0, 0.01]
    return Measurements(ur3.joint_names, q, points, sets=("estimate",) * 30 + ("validate",) * 10)


@pytest.fixture(scope="module")
def robust(ur3: Robot, table: Measurements) -> Calibration:
    return calibrate(ur3, table, cell=CELL, validate=False)


@pytest.fixture(scope="module")
def plain(ur3: Robot, table: Measurements) -> Calibration:
    return calibrate(ur3, table, cell=CELL, robust=False, validate=False)


def test_it_is_the_difference_of_the_two_calibrations(robust, plain, table):
    found = robust.robustness
    q = table.joints[table.estimation]
    moved = np.linalg.norm(robust.predict(q) - plain.predict(q), axis=1)
    assert found.lowered
    assert np.flatnonzero(found.flagged).tolist() == list(WILD)
    assert found.moved == pytest.approx(moved, abs=1e-9)
    assert found.moved_rms == pytest.approx(np.sqrt(np.mean(moved**2)), rel=1e-6)
    assert found.moved_max == pytest.approx(np.max(moved), rel=1e-6)
    assert found.names == robust.model.names
    assert found.change == pytest.approx(plain.x - robust.x, abs=1e-9)
    assert found.std == pytest.approx([p.std for p in robust.parameters])
    # Two rows of thirty, a hundred times the noise: worse by far on the rows that nobody doubts.
    assert found.moved_rms > 3.0 * robust.expected_measured
    assert found.errors_lowered.n == found.errors_full.n == 28
    assert found.errors_lowered.rms < 2.5e-4 < 4e-4 < found.errors_full.rms


def test_left_out_errors_are_those_of_the_cross_validation(ur3, table, robust, plain):
    """Linearised here, fitted anew there: each good row predicted from the others, the wild ones included."""
    for result, errors in (
        (robust, robust.robustness.errors_lowered),
        (plain, robust.robustness.errors_full),
    ):
        whole = calibrate(ur3, table, cell=CELL, robust=result is robust)
        found = whole.cross_validation.residual[~robust.robustness.flagged]
        assert errors.rms == pytest.approx(np.sqrt(np.mean(np.sum(found**2, axis=1))), rel=0.15)


def test_seen_from_either_side_it_is_the_same(robust, plain):
    one, other = robust.robustness, plain.robustness
    assert (one.lowered, other.lowered) == (True, False)
    assert other.moved == pytest.approx(one.moved, abs=1e-8)
    assert other.change == pytest.approx(-one.change, abs=1e-8)


def test_its_sentence_says_which_way(robust, plain):
    found = robust.robustness
    moved = f"{1e3 * found.moved_rms:.3f} mm rms at the measured poses, {1e3 * found.moved_max:.3f}"
    full, lowered = (1e3 * e.rms for e in (found.errors_full, found.errors_lowered))
    assert found.sentence() == (
        f"Without these rows' weights lowered the prediction would move by {moved} mm at most; the error of the other "
        f"rows, left out of a linearised fit, would be {full:.3f} mm rms in place of {lowered:.3f} mm."
    )
    assert found.sentence() in " ".join(summary(robust).split())
    said = plain.robustness.sentence()
    assert said.startswith("With these rows' weights lowered the prediction would move by")
    assert said in " ".join(summary(plain).split())
    assert float(said.split("would be ")[1].split()[0]) < float(
        said.split("place of ")[1].split()[0]
    )


def test_a_clean_table_is_not_compared(ur3, table):
    clean = table.select(~np.isin(np.arange(40), WILD))
    result = calibrate(ur3, clean, cell=CELL, validate=False)
    assert result.outliers == ()
    assert result.robustness is None
    assert "weights lowered" not in summary(result)
    assert compare(result.fitted).moved_max < 5e-5


def test_one_pose_leaves_no_row_to_predict(ur3, table):
    """Repeats of one pose: rows can be flagged, but none can be left out."""
    rng = np.random.default_rng(2)
    points = table.points[0] + 1e-4 * rng.normal(size=(20, 3))
    points[7] += 0.02
    one = Measurements(ur3.joint_names, np.tile(table.joints[0], (20, 1)), points)
    cell = replace(CELL, model="frames", repeats="independent")
    found = calibrate(ur3, one, cell=cell, validate=False).robustness
    assert np.flatnonzero(found.flagged).tolist() == [7]
    assert found.errors_full.n == found.errors_lowered.n == 0
    assert found.sentence().endswith("mm at most.")


@pytest.mark.parametrize("size", [0.03, 0.5])
@pytest.mark.parametrize("seed", range(3))
def test_auto_chooses_as_if_gross_rows_were_not_there(ur3, seed: int, size: float):
    """A fifth of the rows is gross: they have no weight in the fits, and no say in which model is chosen."""
    model = error_model(ur3, "dh")
    rng = np.random.default_rng(seed)
    x = rng.normal(size=len(model)) * np.where(np.array(model.units) == "m", 3e-4, 3e-3)
    T_tip_target = np.eye(4)
    T_tip_target[:3, 3] = TARGET
    q = random_joint_values(ur3, 40, seed)
    points = Kinematics(ur3, model, np.eye(4), T_tip_target).points(x, q)
    points += 1e-4 * rng.normal(size=(40, 3))
    thrown = rng.normal(size=(8, 3))
    points[:8] += size * thrown / np.linalg.norm(thrown, axis=1, keepdims=True)
    spoilt, clean = (
        calibrate(ur3, Measurements(ur3.joint_names, q[k:], points[k:]), validate=False)
        for k in (0, 8)
    )
    assert [o.row for o in spoilt.outliers][:8] == list(range(1, 9))
    assert spoilt.model.name == clean.model.name == "dh"
    assert spoilt.larger is None
    assert np.abs(spoilt.predict(q) - clean.predict(q)).max() < 2e-5


def test_a_slip_does_not_move_the_socket_that_is_left_out(make_scene, join):
    """Two of 100 rows slipped: the others, their sockets registered anew, are predicted as if nothing had happened."""
    places = np.tile(np.eye(4), (5, 1, 1))
    places[:, :3, 3] = -np.array(
        [(0.3, 0.1, 0.3), (-0.3, 0.2, 0.4), (0.1, -0.3, 0.5), (0.25, 0.2, 0.2), (-0.2, -0.2, 0.5)]
    )
    T_tip_target = np.eye(4)
    T_tip_target[:3, 3] = TARGET
    scene = make_scene(
        2, frames=list(places), targets=[T_tip_target], model="zeros", angle=3e-3, noise=1e-4
    )
    table = join(*(scene.fixed(20, k) for k in range(5)))
    slipped = table.joints.copy()
    slipped[[5, 47], 1] += 0.04
    cell = Cell(model="zeros", target=TARGET, estimate_target=False)
    clean, spoilt = (
        calibrate(scene.robot, replace(table, joints=q), cell=cell) for q in (table.joints, slipped)
    )
    assert [o.row for o in spoilt.outliers] == [6, 48]
    for part in ("cross_validation", "nominal_cross_validation"):
        one, other = (getattr(c, part) for c in (clean, spoilt))
        assert one.method == "leave-one-set-up-out"
        assert other.errors.rms > 2.0 * one.errors.rms or part == "nominal_cross_validation"
        assert other.errors_without_outliers.rms == pytest.approx(one.errors.rms, rel=0.05)
