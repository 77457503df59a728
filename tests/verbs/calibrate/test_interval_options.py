"""The text of a bootstrap and of profiles: samples that did not converge, long names, open ends, bounds."""

from __future__ import annotations

from dataclasses import replace

import pytest

from calib.basics.arrays import read_only
from calib.data.cell import Cell
from calib.example import PAPER_TARGET
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.verbs.calibrate.interval_text import bootstrap_text, profile_text
from calib.verbs.calibrate.uncertainty import Profile, bootstrap


@pytest.fixture(scope="module")
def result(ur3, paper_table) -> Calibration:
    cell = Cell(target=read_only(PAPER_TARGET), model="zeros")
    return calibrate(ur3, paper_table, cell=cell, validate=False)


def test_samples_that_did_not_converge_are_counted(result):
    found = bootstrap(result, 40, seed=0)
    said = "The solver did not converge on 3 of the samples."
    assert said not in bootstrap_text(result, replace(found, stopped=0))
    assert bootstrap_text(result, replace(found, stopped=3)).splitlines()[-1] == said


def test_a_long_name_has_a_line_of_its_own(result):
    one = result.parameters[0]
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
