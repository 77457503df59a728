"""Which models are fitted to a table, with which weights, and where frames and targets come from."""

from __future__ import annotations

import time
from dataclasses import replace
from unittest import mock

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Why
from calib.fit.estimate.fitting import fit
from calib.model.error_model import FRAME
from calib.result import table_fits as module
from calib.result.calibrate import calibrate
from calib.result.table_fits import fit_table
from calib.robot.gravity import Payload
from tests.fits import TARGETS, every_sixth_validates


def test_a_named_geometry_is_fitted_alone(calibrated):
    scene, c = calibrated("points")
    began = time.perf_counter()
    fits = fit_table(scene.robot, c.fit.measurements, replace(c.fit.cell, model="dh"))
    assert 0.0 < fits.seconds <= time.perf_counter() - began
    assert fits.geometry.task.model == "dh"
    assert fits.non_geometric is None
    assert (fits.candidates, fits.mistake) == ((), None)
    assert len(fits.all_rows) == len(c.fit.measurements)
    assert len(fits.fitted_rows) == np.sum(c.fit.measurements.estimation)


def test_families_behind_a_name_make_a_non_geometric_model(calibrated):
    scene, c = calibrated("gain")
    fits = fit_table(scene.robot, c.fit.measurements, replace(c.fit.cell, model="dh+gain"))
    assert fits.non_geometric is not None
    assert fits.non_geometric.task.model == "dh+gain"
    # The geometry starts where registration for the other model put frames and targets.
    assert fits.geometry.task.model == "dh"
    np.testing.assert_array_equal(
        fits.geometry.setup.T_frame_base, fits.non_geometric.setup.T_frame_base
    )
    assert fits.candidates == ()


def test_the_models_that_the_data_choose_are_fitted(calibrated):
    scene, c = calibrated("gain")
    fits = fit_table(scene.robot, c.fit.measurements, c.fit.cell)
    chosen = {one.chosen: one.name for one in fits.candidates if one.chosen}
    assert chosen == {"geometry": "dh", "non_geometric": "dh+gain"}
    assert fits.geometry.task.model == "dh"
    np.testing.assert_array_equal(fits.geometry.estimate.x, c.geometry.x)


def test_of_a_usual_mistake_only_joint_zeros_are_fitted(ur3, table):
    swapped = replace(table, joints=table.joints[:, [1, 0, 2, 3, 4, 5]])
    fits = fit_table(ur3, swapped, Cell())
    assert fits.mistake is not None
    assert fits.mistake.why == Why.COLUMNS_SWAPPED
    assert fits.geometry.task.model == "zeros"
    assert fits.candidates == ()


@pytest.mark.parametrize(
    ("name", "model", "swapped", "confirmed"),
    [
        ("points", "dh", False, True),
        ("points", "auto", False, False),
        ("gain", "dh+gain", False, False),
        ("points", "zeros", True, False),
    ],
)
def test_outliers_are_confirmed_where_a_named_geometry_alone_was_fitted(
    calibrated, name: str, model: str, swapped: bool, confirmed: bool
):
    """Non-geometric models were tried already where the data chose, and nothing is right of a usual mistake."""
    scene, c = calibrated(name)
    order = [1, 0, 2, 3, 4, 5] if swapped else range(6)
    table = replace(c.fit.measurements, joints=c.fit.measurements.joints[:, order])
    real = module._confirm_outliers
    with mock.patch.object(module, "_confirm_outliers", wraps=real) as asked:
        fits = fit_table(scene.robot, table, c.fit.cell, model=model)
    assert asked.called == confirmed
    assert (fits.mistake is not None) == swapped


def test_frames_that_only_validation_rows_see_are_registered_to_them(make_scene, join):
    scene = make_scene(95, frames=2, length=0.0, angle=0.0, noise=1e-5)
    table = join(scene.points(30, 0), scene.points(10, 1))
    sets = tuple("validate" if group == "1" else "estimate" for group in table.groups)
    table = replace(table, sets=sets)
    fits = fit_table(scene.robot, table, Cell(estimate_frame=True, model="frames"))
    assert [bool(directions) for directions in fits.unseen.unknown] == [False, True]
    assert [bool(directions) for directions in fits.geometry.task.setup.unknown] == [True, False]
    assert not any("[1]" in name for name in fits.geometry.kinematics.model.names)
    assert np.any(fits.geometry.kinematics.model.family(FRAME))
    residual = fits.geometry.residual(fits.all_rows)
    assert np.abs(residual).max() < 1e-4


def test_outliers_that_a_non_geometric_model_confirms_keep_their_fit(make_scene):
    """Two rows off by centimetres are no errors of joints: the geometry is as fitted alone."""
    scene = make_scene(91, frames=[np.eye(4)], length=3e-4, angle=3e-3, noise=2e-5)
    table = every_sixth_validates(scene.points(60))
    points = table.points.copy()
    points[[4, 18]] += [[2e-2, 0.0, 1e-2], [0.0, -3e-2, 0.0]]
    table = replace(table, points=points)
    fits = fit_table(scene.robot, table, Cell(model="dh"))
    alone = fit(fits.geometry.task, fits.fitted_rows)
    assert np.sum(alone.estimate.outliers) == 2
    np.testing.assert_array_equal(fits.geometry.estimate.x, alone.estimate.x)


@pytest.mark.parametrize("bends", [True, False])
def test_a_part_of_many_rows_confirms_outliers_as_all_rows_do(
    make_scene, panda, monkeypatch, bends
):
    """Rows that bend under a payload are good ones for a non-geometric model; rows that are 5 mm off are not."""
    payload = Payload(8.0, np.array([0.0, 0.0, 0.15])) if bends else None
    errors = {"model": "dh+compliance", "other": {"compliance": 4e-5}} if bends else {}
    places = {"frames": [np.eye(4)], "targets": TARGETS[:1]}
    scene = make_scene(0, robot=panda, **places, **errors, length=3e-4, angle=2e-3, payload=payload)
    x, kinematics = scene.x, scene.kinematics
    samples = scene.samples(5000)
    points = kinematics.points(x, samples)
    still = kinematics.points(np.where(kinematics.model.family("compliance"), 0.0, x), samples)
    order = np.argsort(np.linalg.norm(points - still, axis=1))
    # Nine of ten hardly bend, so that they alone are what the geometry fits.
    rows = np.r_[order[:3600:10], order[-40:]]
    table = points[rows] + 1e-4 * scene.rng.normal(size=(400, 3))
    off = np.zeros(400, dtype=bool) if bends else scene.rng.uniform(size=400) < 0.03
    table[off] += 5e-3 * scene.rng.normal(size=(int(off.sum()), 3))
    data = Measurements(panda.joint_names, samples.q[rows], table)
    cell = Cell(model="dh", payload=payload)
    by_few = calibrate(panda, data, cell=cell, validate=False)
    monkeypatch.setattr("calib.result.table_fits._MANY_ROWS", len(rows))
    by_all = calibrate(panda, data, cell=cell, validate=False)
    np.testing.assert_array_equal(by_few.geometry.x, by_all.geometry.x)
    assert by_few.rows.outliers == by_all.rows.outliers
    assert bends or len(by_few.rows.outliers) > 0.5 * off.sum()
    assert not bends or len(by_few.rows.outliers) < 10
