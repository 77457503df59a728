from __future__ import annotations

from dataclasses import asdict, replace

import pytest

from calib.measure.cell import Cell
from calib.simulate.disturbances import Outliers
from calib.simulate.scenario import Scenario
from calib.simulate.trial import Trials, one_trial, verification_poses


@pytest.mark.parametrize("model", ["dh", "dh+gain", "dh+compliance"])
def test_without_validation_only_the_verdict_is_missing(ur3, model):
    """The fits alone are made then, and what a trial says of them is the same."""
    scenario = Scenario(ur3, outliers=Outliers(count=2), cell=Cell(estimate_frame=True))
    trials = Trials(scenario, Cell(model=model, estimate_frame=True), count=40)
    validated = one_trial(trials, 3)
    alone = one_trial(replace(trials, validate=False), 3)
    assert validated.verdict
    assert alone.verdict == ""
    ours, theirs = asdict(alone), asdict(validated)
    assert ours.pop("model") == theirs.pop("model") == model
    del ours["verdict"], theirs["verdict"]
    assert ours == pytest.approx(theirs, rel=1e-12)
    assert alone.outliers == 2


def test_lengths_are_verified_by_shape(ur3):
    scenario = Scenario(ur3, cell=Cell(kind="pair"))
    trial = one_trial(Trials(scenario, Cell(model="dh", kind="pair"), count=60, validate=False), 0)
    assert trial.rms < 0.5 * trial.nominal_rms
    assert trial.rms == pytest.approx(trial.stated_rms, rel=0.9)


def test_verification_poses_are_made_once(ur3):
    scenario = Scenario(ur3)
    assert verification_poses(scenario) is verification_poses(scenario)
    assert not verification_poses(scenario).flags.writeable
