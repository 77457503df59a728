"""Intervals beside those of the covariance: numbers are those of the parameters."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calib.basics.arrays import read_only
from calib.data.cell import Cell
from calib.example import PAPER_TARGET
from calib.model.error_model import FRAME
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.verbs.calibrate.report import bootstrap_text, profile_text
from calib.verbs.calibrate.uncertainty import LEVEL, Bootstrap, Profile, bootstrap


def numbers(line: str) -> list[float]:
    words = line.replace("..", " ").split()
    return [float(word) for word in words[1:] if word[-1].isdigit()]


@pytest.fixture
def samples(default_result: Calibration) -> SimpleNamespace:
    """What is printed of a bootstrap, with an interval of 1 mm or 1 mrad about each value."""
    values = np.array([p.value for p in default_result.parameters])
    return SimpleNamespace(
        parameters=default_result.parameters,
        x=np.zeros((200, len(values))),
        seed=3,
        stopped=2,
        std=np.full(len(values), 2.5e-4),
        measured_rms=1.5e-4,
        everywhere_rms=3.5e-4,
        intervals=lambda _: values[:, None] + 5e-4 * np.array([-1.0, 1.0]),
    )


def test_a_bootstrap(default_result: Calibration, samples: SimpleNamespace):
    lines = bootstrap_text(default_result, samples).splitlines()
    assert lines[0] == "Bootstrap: 200 samples of whole poses, seed 3"
    shown = [m for m in default_result.model.parameters if m.family != FRAME]
    assert [line.split()[0] for line in lines[2 : 2 + len(shown)]] == [m.name for m in shown]
    first = default_result.parameters[0]
    expected = [first.value, first.low, first.high, first.value - 5e-4, first.value + 5e-4]
    assert numbers(lines[2]) == pytest.approx(1e3 * np.array(expected), abs=5.01e-4)
    text = " ".join(lines)
    for value in (1.5e-4, 3.5e-4, default_result.geometry.expected_measured):
        assert f"{1e3 * value:.3f} mm" in text
    assert "did not converge on 2 of the samples" in text
    assert max(map(len, lines)) <= 100


def test_a_profile_may_be_open_and_a_parameter_at_its_bound(default_result: Calibration):
    p = replace(default_result.parameters[0], at_bound=True)
    line = profile_text([(p, Profile(-math.inf, p.value + 1e-3, LEVEL))]).splitlines()[2]
    assert "at bound" in line
    assert "open .." in line
    assert numbers(line)[-1] == pytest.approx(1e3 * (p.value + 1e-3), abs=5.01e-4)


def test_a_long_name_gets_a_line_of_its_own(default_result: Calibration):
    p = replace(default_result.parameters[0], name="shoulder_" * 12)
    lines = profile_text([(p, Profile(0.0, 1.0, LEVEL))]).splitlines()
    assert max(map(len, lines)) <= 100
    assert "".join(line.strip() for line in lines[2:-1]) == p.name


def test_the_table_is_in_si_units(default_result: Calibration, samples: SimpleNamespace):
    table = Bootstrap.table(samples)
    first = default_result.parameters[0]
    assert table["parameters"][0]["name"] == first.name
    assert table["parameters"][0]["low"] == first.value - 5e-4
    assert table["parameters"][0]["std"] == 2.5e-4
    assert table["expected"] == {"measured_rms_m": 1.5e-4, "everywhere_rms_m": 3.5e-4}
    assert (table["samples"], table["level"]) == (200, LEVEL)


@pytest.fixture(scope="module")
def zeros(ur3, paper_table) -> Calibration:
    cell = Cell(target=read_only(PAPER_TARGET), model="zeros")
    return calibrate(ur3, paper_table, cell=cell, validate=False)


def test_samples_that_did_not_converge_are_counted(zeros: Calibration):
    found = bootstrap(zeros, 40, seed=0)
    said = "The solver did not converge on 3 of the samples."
    assert said not in bootstrap_text(zeros, replace(found, stopped=0))
    assert bootstrap_text(zeros, replace(found, stopped=3)).splitlines()[-1] == said


def test_a_long_name_at_its_bound_has_a_line_of_its_own(zeros):
    one = zeros.parameters[0]
    long = replace(
        one, name="a_joint_with_a_name_that_is_much_longer_than_a_column.zero", at_bound=True
    )
    lines = profile_text(
        [(one, Profile(-1.0, float("inf"), 0.95)), (long, Profile(0.0, 1.0, 0.95))]
    )
    head, first, name, values = lines.splitlines()[1:]
    assert head.endswith("profile")
    assert first.split()[-2:] == ["open", "deg"]
    assert name == long.name
    assert values.startswith("    ")
    assert "at bound" in values
