"""Rows, parameters and covariance of a result as frames, against the result's own arrays."""

from __future__ import annotations

import numpy as np
import pandas as pd
import polars as pl
import pytest

import calib
from calib.errors import CalibError, ModelError


@pytest.mark.parametrize("library", ["pandas", "polars"])
@pytest.mark.parametrize("case", ["paper", "poses", "distances", "mixed"])
def test_rows(calibrations, case, library):
    result = calibrations.made(case)
    frame = result.to_frame("rows", library)
    assert list(frame["row"]) == list(result.rows.numbers)
    assert list(frame["set"]) == list(result.rows.sets)
    assert list(frame["kind"]) == list(result.rows.kinds)
    np.testing.assert_array_equal(frame["weight"].to_numpy(), result.rows.weights)
    estimation = np.array([word == "estimate" for word in frame["set"]])
    for unit, shown, to_shown in (("m", "mm", 1e3), ("rad", "deg", 180 / np.pi)):
        for robot in ("nominal", "calibrated"):
            name = f"{robot} error [{shown}]"
            errors = result.errors[robot]["estimation"]
            assert (name in frame.columns) == (unit in result.rows.channels.present)
            if name in frame.columns:
                values = frame[name].to_numpy().astype(float)[estimation]
                values = values[np.isfinite(values)]
                assert np.sqrt(np.mean(values**2)) / to_shown == pytest.approx(
                    errors[unit].rms, rel=1e-12
                )
                assert np.max(values) / to_shown == pytest.approx(errors[unit].max, rel=1e-12)


def test_residuals_are_measured_minus_predicted(calibrations):
    result = calibrations.made("paper")
    frame = result.to_frame()
    m = result.fit.measurements
    predicted = result.predict(m.joints_for(result.nominal.joint_names), non_geometric=False)
    residual = frame[[f"calibrated residual {axis} [mm]" for axis in "xyz"]].to_numpy()
    np.testing.assert_allclose(residual, 1e3 * (m.points - predicted), atol=1e-9)


@pytest.mark.parametrize("library", ["pandas", "polars"])
def test_parameters_and_covariance(calibrations, library):
    result = calibrations.made("paper")
    frame = result.to_frame("parameters", library)
    names = list(frame["name"])
    assert names == list(result.model.names)
    covariance = result.to_frame("covariance", library)
    for i, name in enumerate(names):
        parameter = result.parameter(name)
        assert frame["value"][i] == parameter.value
        assert frame["std"][i] == parameter.std
        assert frame["unit"][i] == parameter.unit
        assert frame["identifiable"][i] == parameter.identifiable
        np.testing.assert_array_equal(covariance[name].to_numpy(), result.covariance[:, i])
    if library == "pandas":
        assert list(covariance.index) == names
        assert isinstance(covariance, pd.DataFrame)
        assert covariance.loc[names[1], names[2]] == result.covariance[1, 2]
    else:
        assert isinstance(covariance, pl.DataFrame)
        assert covariance["parameter"].to_list() == names


def test_a_result_that_was_read_has_the_same_frames(calibrations, tmp_path):
    result = calibrations.made("paper")
    again = calib.Calibration.read_json(result.write_json(tmp_path / "r.json"))
    for content in ("rows", "parameters", "covariance"):
        pd.testing.assert_frame_equal(again.to_frame(content), result.to_frame(content))
    with pytest.raises(ModelError, match="read from a file"):
        again.plot("points")


def test_other_contents_and_libraries_are_refused(calibrations):
    result = calibrations.made("paper")
    with pytest.raises(CalibError, match="did you mean 'rows'"):
        result.to_frame("row")
    with pytest.raises(CalibError, match="'polars'"):
        result.to_frame("rows", "spark")
