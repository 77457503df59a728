"""Distances and angles of axes, and sentences on how joints turned; refusals are tested with the survey."""

import numpy as np
import pytest

from calib.measure.axis_checks import between, turning_findings
from calib.measure.base_frame import Line
from calib.measure.turning import Turning

X, Y, Z = np.eye(3)


@pytest.mark.parametrize(
    ("first", "second", "angle", "distance"),
    [
        (Line(0 * X, Z), Line(0.3 * X + 7 * Z, Z), 0.0, 0.3),
        (Line(0 * X, Z), Line(0.3 * X + 7 * Z, -Z), 180.0, 0.3),
        (Line(0 * X, Z), Line(0.2 * Y + 0.1 * X, X), 90.0, 0.2),
        (Line(0 * X, Z), Line(5 * Z, X), 90.0, 0.0),
    ],
)
def test_between(first: Line, second: Line, angle: float, distance: float):
    found = between(first, second)
    assert np.degrees(found[0]) == pytest.approx(angle)
    assert found[1] == pytest.approx(distance)


def turned(gain: float, once: float, *, found: bool) -> Turning:
    return Turning(1e-4, gain, 1e-4, once, 1e-4, found, found)


def test_sentences():
    assert turning_findings("pan", None) == ()
    assert turning_findings("pan", turned(1e-3, 1e-3, found=False)) == ()
    less, once = turning_findings("pan", turned(-1e-3, 2e-3, found=True))
    assert less.startswith(
        "'pan' turns 1.000 mrad per rad less than its values say (standard deviation 0.100"
    )
    assert once.startswith(
        "'pan' is off by 2.000 mrad once per turn (standard deviation 0.100 mrad)"
    )
    assert "further" in turning_findings("pan", turned(1e-3, 2e-3, found=True))[0]
