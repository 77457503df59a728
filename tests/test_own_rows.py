"""A kind of measurement and a family of errors that a user registers are simulated like calib's own."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from calib.data import kinds
from calib.data.cell import Cell
from calib.data.kinds import Kind, Reading
from calib.data.measurements import Measurements
from calib.model import families
from calib.model.families import RAD, Factor, Family
from calib.program import app
from calib.verbs.simulate.scenario import Scenario
from tests.places import ROOT

sys.path.insert(0, str(ROOT / "scripts"))

from trials import Task, run_trials

#: A gauge that reads how high the target is, and a joint's error twice a turn.
HEIGHT = Kind(
    name="height",
    words="height of the target",
    units=("m",),
    measure=lambda T: T[:, 2:3, 3],
    derivative=lambda _measured, _T, twists: twists[:, 2:3],
    readings=(Reading("height"),),
)
HARMONIC = Family(
    "harmonic",
    RAD,
    1e-3,
    0.5e-3,
    (
        Factor("sin2", lambda s: np.sin(2 * s.q), lambda s: 2 * np.cos(2 * s.q)),
        Factor("cos2", lambda s: np.cos(2 * s.q), lambda s: -2 * np.sin(2 * s.q)),
    ),
)


@pytest.fixture(autouse=True)
def _registered(monkeypatch):
    """In the registries while a test runs, and in no other test."""
    monkeypatch.setitem(kinds._KINDS, HEIGHT.name, HEIGHT)
    monkeypatch.setitem(families._REGISTRY, HARMONIC.name, HARMONIC)


def test_they_are_simulated_from_the_command_line(tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("cell.toml").write_text('kind = "height"\nmodel = "zeros+harmonic"\n')
    words = "simulate ur3 --base base --tip tool0 --cell cell.toml --outliers 2 -o t.csv"
    done = CliRunner().invoke(app, words.split())
    assert done.exit_code == 0, done.output
    assert "Each row measures the height of the target" in " ".join(done.output.split())
    assert "harmonic                12, rms" in done.output
    truth = json.loads(Path("t_truth.json").read_text())
    table = Measurements.read("t.csv", truth["robot"]["joints"])
    off = table.readings["height"] - [row["xyz_m"][2] for row in truth["rows"]]
    out = [one["row"] - 1 for one in truth["events"]["outliers"]]
    assert np.abs(off[out]) == pytest.approx(5e-3, abs=2e-4)
    assert 1e-5 < np.delete(off, out).std() < 8e-5


def test_they_are_calibrated(ur3):
    cell = Cell(kind="height", model="zeros+harmonic", target=(0.05, 0.05, 0.05))
    scenario = Scenario(ur3, cell, model="zeros+harmonic", sizes={"harmonic": 3e-3})
    found = run_trials(Task(scenario, cell, count=80, validate=False), 2)
    assert (
        found.values("rms") < 0.4 * found.values("nominal_rms")
    ).all()  # a turn about the vertical changes no height
