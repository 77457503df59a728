"""The study of the base frame runs, and its bars hold in a short run."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from tests.places import ROOT

sys.path.insert(0, str(ROOT / "scripts"))

from base_frame_study import Case, center_bias, frame_runs, robot_errors


def test_an_arc_too_short_for_its_noise_has_no_line_of_numbers():
    assert center_bias(20, 1e-2, 5, 0) is None


@pytest.mark.slow
@pytest.mark.parametrize("arcs", [(270.0, 180.0), (60.0, 60.0)])
def test_the_frame(arcs: tuple[float, float]):
    errors = frame_runs(Case(arcs, given=False), 150, 0)
    position = np.linalg.norm(errors.twists[:, :3], axis=1)
    turn = np.linalg.norm(errors.twists[:, 3:], axis=1)
    assert np.sqrt(np.mean(position**2)) < 1.2 * errors.bound[0]
    assert np.sqrt(np.mean(turn**2)) < 1.2 * errors.bound[1]
    assert 0.92 <= errors.inside.mean() <= 0.98
    if arcs[0] == 270.0:
        assert np.median(position) < 0.05e-3
        assert np.median(turn) < 0.1e-3


@pytest.mark.slow
def test_a_calibration_in_it():
    nominal, in_base, free = robot_errors(3)
    assert nominal > 5e-4
    assert in_base < 6e-5
    assert free < 6e-5
