"""The table [uncertainty] of a cell file."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.data.stated_uncertainty import StatedUncertainty
from calib.errors import CalibError

TABLE = """
[uncertainty]
instrument_mpe = "15 um + 6 um/m"
instrument_mpe_deg = 0.01
repeatability_mm = 0.02
resolution_deg = 0.001
resolution_mm = 0.01
lost_motion_deg = 0.005
drift_mm = 0.03
frame_mm = 0.1
frame_deg = 0.02
target_mm = 0.05
temperature_C = [18, 26]
arm_expansion_um_per_m_K = 12
instrument_expansion_um_per_m_K = 9.5
"""


def read(tmp_path, text):
    path = tmp_path / "cell.toml"
    path.write_text(text)
    return Cell.read(path).uncertainty


def test_all_keys_are_read_in_si_units(tmp_path):
    stated = read(tmp_path, TABLE)
    expected = StatedUncertainty(
        instrument_limit=15.0 / 1e6,
        instrument_limit_per_length=6e-6,
        instrument_limit_angle=np.radians(0.01),
        repeatability=2e-5,
        resolution=np.radians(0.001),
        resolution_sliding=1e-5,
        lost_motion=np.radians(0.005),
        drift=3e-5,
        frame=1e-4,
        frame_angle=np.radians(0.02),
        target=5e-5,
        temperature=(18.0, 26.0),
        arm_expansion=1.2e-5,
        instrument_expansion=9.5e-6,
    )
    assert stated.temperature == expected.temperature
    for field in fields(stated):
        if field.name != "temperature":
            value = getattr(expected, field.name)
            assert getattr(stated, field.name) == pytest.approx(value, rel=1e-12), field.name


def test_a_limit_of_error_is_even(tmp_path):
    stated = read(tmp_path, TABLE)
    assert stated.instrument_std(3.0) == pytest.approx(33e-6 / np.sqrt(3.0))


def test_nothing_is_stated_without_the_table():
    stated = Cell().uncertainty
    assert stated == StatedUncertainty()
    assert stated.temperature == ()
    assert stated.arm_expansion == 2.3e-5


@pytest.mark.parametrize(
    "text",
    [
        "drift_mm = -0.1",
        "drift_mm = nan",
        'drift_mm = "0.1"',
        "temperature_C = [26, 18]",
        "temperature_C = 20",
        "temperature_C = [18, 26, 30]",
        "temperature_C = [18, 200]",
        "arm_expansion_um_per_m_K = -1",
        "instrument_mpe = 0.1",
        "accuracy_mm = 0.1",
    ],
)
def test_what_is_no_size_or_range_is_refused(tmp_path, text):
    with pytest.raises(CalibError):
        read(tmp_path, f"[uncertainty]\n{text}\n")


@pytest.mark.parametrize("values", [{"drift": -1.0}, {"temperature": (3.0,)}, {"frame": "much"}])
def test_values_in_memory_are_checked(values):
    with pytest.raises(CalibError):
        StatedUncertainty(**values)
