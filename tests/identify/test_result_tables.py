"""The tables of a result: units in the keys, what was not measured left out, names that another program can follow."""

from __future__ import annotations

import numpy as np
import pytest

from calib.identify.result_fields import ERRORS
from calib.identify.result_file import result_table
from calib.identify.statistics import Errors


def test_every_row_has_the_residuals_of_its_kind(case):
    _, c = case
    widths = {"point": 3, "pose": 3, "distance": 1, "fixed": 3, "plane": 1}
    for row, kind, used in zip(result_table(c)["rows"], c.measurements.kinds, c.used, strict=True):
        assert row["kind"] == kind
        wanted = widths.get(kind, int(used.sum()))
        assert len(row["residual_nominal_m"]) == len(row["residual_calibrated_m"]) == wanted
        assert ("residual_calibrated_rad" in row) == (kind == "pose")


def test_a_distance_is_said_once_for_a_pair(calibrated):
    _, c = calibrated("pairs")
    lengths = [len(row["residual_calibrated_m"]) for row in result_table(c)["rows"]]
    assert lengths == [1, 0] * 76


def test_frames_and_targets_are_those_of_the_result(case):
    _, c = case
    frames = result_table(c)["frames"]
    assert [f["group"] for f in frames["set_ups"]] == list(c.setup.groups)
    assert [t["target"] for t in frames["targets"]] == list(c.setup.targets)
    for f, T, directions in zip(
        frames["set_ups"], c.setup.T_frame_base, c.setup.unknown, strict=True
    ):
        np.testing.assert_array_equal(f["frame_base_xyz_m"], T[:3, 3])
        assert f["estimated"] == list(directions)
    turned = "pose" in c.measurements.kinds
    assert all((t["rpy_rad"] is not None) == turned for t in frames["targets"])


def test_held_joints_with_their_unit(calibrated):
    _, c = calibrated("held")
    assert result_table(c)["robot"]["held"] == [
        {"joint": "wrist_2_joint", "value": 0.8, "unit": "rad"}
    ]
    assert result_table(calibrated("points")[1])["robot"]["held"] == []


def test_the_larger_model_is_whole(calibrated):
    _, c = calibrated("compliance")
    larger = result_table(c)["larger"]
    assert larger["set"] == "dh+compliance"
    assert larger["names"] == [p["name"] for p in larger["parameters"]]
    np.testing.assert_array_equal(larger["x"], c.larger.x)
    assert larger["payload"]["mass_kg"] == 5.0
    np.testing.assert_array_equal(larger["gravity_m_s2"], [0.0, 1.0, -9.75])
    assert "compliance_rad_Nm" in larger["sizes"]
    assert larger["errors"]["validation"]["rms_m"] == c.errors["larger"]["validation"].rms


def test_angles_only_where_there_are_any():
    assert "n_rad" not in ERRORS.table(Errors.of(np.ones((2, 3))))
    table = ERRORS.table(Errors.of(np.ones((2, 6))))
    assert table["n_rad"] == 2
    assert table["max_rad"] == pytest.approx(np.sqrt(3))
    lengths = ERRORS.table(Errors.of(np.ones((2, 1))))
    assert np.all(np.isnan(lengths["rms_xyz_m"]))
