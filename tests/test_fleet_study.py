"""The study of a fleet over time, small: what is planted is found, and nothing else."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import calib
from tests.places import ROOT

sys.path.insert(0, str(ROOT / "scripts"))
import fleet_study as study


@pytest.mark.slow
def test_history_trends_and_outliers_are_right(tmp_path):
    robots, dates = 10, 4
    fleets = study.make_fleet(tmp_path, robots, dates, None)
    noted = study.spoil(tmp_path, robots, dates)
    study.check_history(tmp_path, robots, dates, noted)
    rows, others = study.check_trends(calib.history(tmp_path), robots, dates, None)
    assert len(rows) == 4
    assert others == []
    # One fleet in twenty has a robot that is flagged by chance, and here it is the same robots each time.
    assert len(set(study.check_outliers(fleets, robots))) <= 1


def test_the_true_robot_is_calibs_without_errors(monkeypatch, ur3):
    for name in ("ZERO", "LENGTH", "NOISE"):
        monkeypatch.setattr(study, name, 0.0)
    fault = study.Planted(2, off=0.012)
    table = study.measured(0, 0, fault)
    assert table.joint_names == ur3.joint_names
    q = table.joints + 0.012 * np.eye(6)[2]
    target = np.append(study.TARGET, 1.0)
    np.testing.assert_allclose(table.points, (ur3.poses(q) @ target)[:, :3], atol=1e-12)
