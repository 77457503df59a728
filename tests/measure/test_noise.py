"""The noise of an instrument: figures from a data sheet, and the words for them."""

import numpy as np
import pytest

from calib.errors import CalibError
from calib.measure.noise import TrackerNoise, parse_noise


def test_at_three_metres_a_tracker_has_33_um_beside_the_robot_s_20():
    assert TrackerNoise().std(3.0) == pytest.approx(np.hypot(33e-6, 20e-6))
    assert TrackerNoise(repeatability=0.0).std(np.array([0.0, 3.0])) == pytest.approx(
        [15e-6, 33e-6]
    )


@pytest.mark.parametrize(
    ("text", "constant", "per_length"),
    [
        ("15 um + 6 um/m", 15e-6, 6e-6),
        ("15µm+6 μm/m", 15e-6, 6e-6),
        ("0.05 mm", 5e-5, 0.0),
        ("1e-2 mm + 0.001mm / m", 1e-5, 1e-6),
    ],
)
def test_words(text, constant, per_length):
    noise = parse_noise(text, "noise", repeatability=1e-5)
    assert noise.constant == pytest.approx(constant)
    assert noise.per_length == pytest.approx(per_length)
    assert noise.repeatability == 1e-5


@pytest.mark.parametrize(
    "text", ["", "15", "15 kg", "um 15", "1 um + 2 um", "1 um + 2 um/mm", "-1 um", "1..2 um"]
)
def test_other_words_are_refused_with_what_is_allowed(text):
    with pytest.raises(CalibError, match=r"--noise was given as"):
        parse_noise(text, "--noise")


@pytest.mark.parametrize(
    "values", [(-1e-6, 0.0, 0.0), (0.0, 0.0, 0.0), (np.nan, 0.0, 1e-6), (0.0, True, 0.0)]
)
def test_what_is_no_standard_deviation_is_refused(values):
    with pytest.raises(CalibError, match="must be numbers, none below 0 and not all 0"):
        TrackerNoise(*values)
