"""A simulation as text: errors, noise and disturbances are those that were simulated."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import TrackerNoise
from calib.model.families import FAMILIES
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.simulate.disturbances import MovedTarget, Outliers
from calib.verbs.simulate.scenario import Scenario, Simulated
from calib.verbs.simulate.text import _errors_by_family, simulated_text
from calib.verbs.simulate.truth import draw_truth
from tests.verbs.simulate.cells import virtual

SETS = ("estimate",) * 15 + ("validate",) * 5


@pytest.fixture(scope="module")
def scenario(ur3: Robot) -> Scenario:
    return virtual(
        draw_truth(ur3, "zeros", seed=1),
        noise=TrackerNoise(1e-4, 0.0, 0.0),
        outliers=Outliers(0.2, size=5e-3),
        moved=MovedTarget(12, np.array([1e-3, 0.0, 0.0])),
    ).scenario


@pytest.fixture(scope="module")
def simulated(ur3: Robot, scenario: Scenario) -> Simulated:
    cell = virtual(draw_truth(ur3, "zeros", seed=1))
    return replace(cell, scenario=scenario).measure(random_joint_values(ur3, 20, 7), sets=SETS)


@pytest.fixture(scope="module")
def text(scenario: Scenario, simulated: Simulated) -> str:
    return simulated_text(scenario, simulated)


def line_of(text: str, label: str) -> str:
    (line,) = [line for line in text.splitlines() if line.startswith(label)]
    return line


def test_the_rows_are_counted(text: str):
    assert "20 rows (15 for estimation, 5 for validation)" in " ".join(text.split())
    assert max(map(len, text.splitlines())) <= 100


def test_the_true_errors(text: str, simulated: Simulated):
    truth = simulated.truth
    zeros = 1e3 * truth.x[[p.family == "zero" for p in truth.model.parameters]]
    line = line_of(text, "  zero")
    rms, largest = np.sqrt(np.mean(zeros**2)), zeros[np.argmax(np.abs(zeros))]
    assert f"{len(zeros)}, rms {rms:.3g} mrad" in line
    assert f" {largest:.3g} mrad" in line
    errors = 1e3 * truth.nominal_errors(simulated.q)
    line = line_of(text, "  of the nominal robot")
    assert f"{np.sqrt(np.mean(errors**2)):.3g} mm rms, {errors.max():.3g} mm at most" in line


def test_the_disturbances(text: str, simulated: Simulated):
    assert "0.1 mm std: instrument 100 um" in line_of(text, "Noise of a coordinate")
    rows = [
        int(row) for row in re.findall(r"\d+", line_of(text, "Outliers of 5 mm").split("rows")[1])
    ]
    assert set(rows) <= set(simulated.outlier_rows)
    moved = line_of(text, "Moved target")
    assert "(1, 0, 0) mm in the tip before row 12" in moved
    assert f": {int(simulated.moved.sum())} rows" in moved


def test_what_is_not_simulated_has_no_line(text: str):
    assert "Encoder steps" not in text
    assert "Drift" not in text
    assert "Noise of an orientation" not in text


def test_families_of_errors_stand_in_their_order(ur3: Robot):
    truth = draw_truth(ur3, "dh+gain", seed=1)
    families = _errors_by_family(truth)
    names = [family for family, _ in families]
    assert names == sorted(names, key=list(FAMILIES).index)
    assert len(set(names)) > 1
    shown = {name: value for errors in families.values() for name, value in errors.items()}
    given = dict(zip(truth.model.names, truth.x, strict=True))
    assert shown == {name: value for name, value in given.items() if value}
