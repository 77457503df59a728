"""Scenarios from words and from the table of a cell file."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pytest

from calib.basics.records import keys_of
from calib.data.cell import Cell, Tracker, TrackerNoise
from calib.errors import CalibError
from calib.verbs.simulate.disturbances import Encoder, Outliers
from calib.verbs.simulate.scenario_words import (
    Disturbances,
    ScenarioWords,
    parse_error_sizes,
    read_scenario,
)

TRACKER = Tracker(np.array([2.0, 1.0, 0.5]), noise=TrackerNoise(1e-5, 1e-6, 0.0))

CELL = Cell()


def test_sizes():
    said = (
        "length 0.5 mm, angle 2mrad,zero 0, gain 1e-3, eccentricity 0.1 deg, compliance 2e-5 rad/Nm"
    )
    found = parse_error_sizes(CELL, said, named=False)
    assert tuple(found.values()) == pytest.approx((0.5e-3, 2e-3, 0.0, 1e-3, np.radians(0.1), 2e-5))
    assert parse_error_sizes(CELL, " none ", named=False) is None
    assert parse_error_sizes(CELL, None, named=True) is None
    assert parse_error_sizes(CELL, None, named=False) == {}


def test_single_errors(ur3):
    pairs = ("a2=0.5 mm", "theta3 = -2 mrad", "elbow_joint.compliance=1e-5 rad/Nm", "d1=0")
    scenario = read_scenario(ur3, Cell(model="dh+compliance"), words=ScenarioWords(error=pairs))
    assert scenario.errors == (
        *(("a2", 0.5e-3), ("theta3", -2e-3), ("elbow_joint.compliance", 1e-5)),
        ("d1", 0.0),
    )
    assert scenario.sizes is None
    for wrong in ("a2", "teta2=1 mrad", "a2=1 mrad"):
        with pytest.raises(CalibError, match=r"--error|no parameter"):
            read_scenario(ur3, Cell(model="dh"), words=ScenarioWords(error=(wrong,)))


@pytest.mark.parametrize(
    ("cell", "text", "noise"),
    [
        (CELL, "0.05 mm", TrackerNoise(5e-5, 0.0, 0.0)),
        (CELL, "15 um + 6 um/m", TrackerNoise(15e-6, 6e-6, 0.0)),
        (CELL, None, TrackerNoise()),
        (Cell(tracker=TRACKER), None, TRACKER.noise),
        (Cell(sigma={"m": 1e-4}, tracker=TRACKER), None, TrackerNoise(1e-4, 0.0, 0.0)),
        *((CELL, text, None) for text in ("none", "0", "0 mm", "0 um + 0 um/m")),
    ],
)
def test_noise(ur3, cell, text, noise):
    found = read_scenario(ur3, cell, words=ScenarioWords(noise=text)).noise
    assert (found and pytest.approx(astuple(found))) == (noise and astuple(noise))


def test_every_key_of_the_table(ur3, tmp_path):
    path = tmp_path / "cell.toml"
    path.write_text(
        "[simulation]\nvisits = 3\nencoder_deg = 0.001\nencoder_mm = 0.01\n"
        "outlier_size_mm = 8\ndrift_mm = [0, 0, 0.1]\nmoved_row = 4\nmoved_mm = [1, 0, 0]\nmoved_target = 't'\n"
        "step_row = 7\nstep_mm = [0, 0.2, 0]\nreferences = 2\nreferences_every = 6\n"
    )
    assert all(row.name in path.read_text() for _, row in keys_of(Disturbances))
    made = read_scenario(
        ur3, Cell.read(path), path, ScenarioWords(outliers="2", target_error="2 mm")
    )
    assert (made.target_error, made.visits) == (2e-3, 3)
    assert astuple(made.encoder) == pytest.approx(astuple(Encoder(np.radians(1e-3), 1e-5)))
    assert made.outliers == Outliers(count=2, size=8e-3)
    assert made.drift.tolist() == [0.0, 0.0, 1e-4]
    assert (made.moved.row, made.moved.by.tolist(), made.moved.target) == (4, [1e-3, 0, 0], "t")
    assert (made.step.row, made.step.by.tolist()) == (7, [0.0, 2e-4, 0.0])
    assert astuple(made.standing) == (2, 6)
    path.write_text("[simulation]\nstep_row = 7\n")
    with pytest.raises(CalibError, match="step_mm"):
        read_scenario(ur3, CELL, path)
    for wrong in ("drift_mm = 1", "visit = 2", "visits = 'two'"):
        path.write_text(f"[simulation]\n{wrong}\n")
        with pytest.raises(CalibError, match=r"in \[simulation\]"):
            read_scenario(ur3, CELL, path)
