"""The study of boards: a few pictures of each that calib did not draw."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from tests.places import ROOT

sys.path.insert(0, str(ROOT / "scripts"))

import boards_study as study


@pytest.mark.slow
@pytest.mark.parametrize("name", study.KINDS)
def test_boards_are_found_as_precisely_as_stated(name: str):
    figures = study.measure(study.KINDS[name], 6, None, np.random.default_rng(7))
    assert figures.used == 1.0
    assert figures.found > 0.95
    assert figures.rms < 0.15
    assert 0.6 < figures.over_sigma < 1.6
