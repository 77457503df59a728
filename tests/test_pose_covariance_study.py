"""The study of poses with covariances: a few cells."""

from __future__ import annotations

import importlib.util
import sys

import numpy as np
import pytest

from tests.places import ROOT

SCRIPTS = ROOT / "scripts"


@pytest.fixture(scope="module")
def study():
    sys.path.insert(0, str(SCRIPTS))
    path = SCRIPTS / "pose_covariance_study.py"
    spec = importlib.util.spec_from_file_location("pose_covariance_study", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["pose_covariance_study"] = module
    spec.loader.exec_module(module)
    return module


def test_steps_of_joints_scatter_poses_as_they_are_said_to(study):
    """Against poses by the true robot, with joints that are uniform within steps."""
    arm, step = study.ARMS[2], 0.1
    cell = study.draw(arm, step, 1)
    views = cell.poses(25, 1)
    fitted_pictures = study.take_pictures(cell, views, 1)
    table = study.table_of(cell, views, fitted_pictures.T_camera_board, None)
    known = study.Cell(estimate_frame=True)
    rows, setup = study.rows_and_setup(cell.truth.nominal, table, known)
    fitted = study.fit(study.Task(cell.truth.nominal, known, setup, "frames"), rows)
    expected = np.trace(study.by_steps(fitted, rows, step)[0][:3, :3])
    pictures = study.take_pictures(cell, np.tile(views[:1], (3000, 1)), 1)
    moved = pictures.T_camera_board[:, :3, 3]
    assert np.sum(np.var(moved, axis=0)) == pytest.approx(expected, rel=0.1)


@pytest.mark.slow
def test_covariances_are_worth_much_and_need_no_knowledge_of_the_robot(study):
    figures = [study.figures_of((arm, 0.02), seed) for arm in study.ARMS for seed in range(5)]
    squares = np.mean(np.square([f.errors for f in figures]), axis=0)
    equal, alone, with_covariances, _ = np.sqrt(squares / squares[-1])
    assert with_covariances < 1.1
    assert equal > 1.4
    assert alone > 1.1
    assert 0.88 < np.mean([f.covered[2] for f in figures]) < 0.98
