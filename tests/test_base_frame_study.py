"""The study of the base frame runs, and its bars hold in a short run."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

SCRIPT = Path(__file__).parents[1] / "scripts" / "base_frame_study.py"


@pytest.fixture(scope="module")
def study() -> ModuleType:
    spec = importlib.util.spec_from_file_location("base_frame_study", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def test_an_arc_too_short_for_its_noise_has_no_line_of_numbers(study):
    assert study.center_bias(20, 1e-2, 5, 0) is None


@pytest.mark.slow
@pytest.mark.parametrize("arcs", [(270.0, 180.0), (60.0, 60.0)])
def test_the_frame(study, arcs: tuple[float, float]):
    xi, inside, bound = study.frame_runs(study.Case(arcs, given=False), 150, 0)
    position, turn = np.linalg.norm(xi[:, :3], axis=1), np.linalg.norm(xi[:, 3:], axis=1)
    assert np.sqrt(np.mean(position**2)) < 1.2 * bound[0]
    assert np.sqrt(np.mean(turn**2)) < 1.2 * bound[1]
    assert 0.92 <= inside.mean() <= 0.98
    if arcs[0] == 270.0:
        assert np.median(position) < 0.05e-3
        assert np.median(turn) < 0.1e-3


@pytest.mark.slow
def test_a_calibration_behind_it(study):
    nominal, in_base, free = study.one_robot(3)
    assert nominal > 5e-4
    assert in_base < 6e-5
    assert free < 6e-5
