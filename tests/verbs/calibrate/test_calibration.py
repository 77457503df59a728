"""What writes a calibration obeys its verdict."""

from __future__ import annotations

import inspect
import re
from dataclasses import fields, replace
from pathlib import Path

import pytest

import calib
from calib.diagnosis.reasons import CARE, NO, USE, Reason, Verdict, Why
from calib.errors import CalibError, VerdictError
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.verbs.evaluate.acceptance import assess
from calib.verbs.evaluate.report import summary
from calib.verbs.simulate.scenario import Scenario
from tests.parts import with_part
from tests.verbs.fleet.arms import CELL

LOST = Reason.of(Why.PARAMETER_FAR, largest=0.2)


@pytest.fixture(scope="module")
def result(ur3: Robot) -> Calibration:
    """A calibration of a robot with errors."""
    scenario = Scenario(ur3, cell=CELL, model="zeros")
    made = scenario.draw(1).measure(scenario.random_poses(14, 1), 1)
    return calibrate(ur3, made.measurements, cell=CELL, validate=False)


def judged(result: Calibration, use: str) -> Calibration:
    return with_part(result, "geometry", verdict=Verdict(use, (LOST,)))


def test_a_urdf_that_is_not_to_be_used_is_not_written(result: Calibration, tmp_path: Path):
    path = tmp_path / "c.urdf"
    with pytest.raises(
        VerdictError, match=r"do not use \(parameter_far\).*--accept.*accept=True"
    ) as caught:
        judged(result, NO).write_urdf(path)
    assert isinstance(caught.value, CalibError)
    assert not path.exists()


def test_what_is_accepted_states_its_verdict_and_is_else_the_same(result: Calibration, tmp_path):
    plain = result.write_urdf(tmp_path / "plain.urdf").read_bytes()
    accepted = judged(result, NO).write_urdf(tmp_path / "c.urdf", accept=True, target_link=True)
    urdf = Urdf.read(accepted)
    assert urdf.verdict.startswith("do not use (parameter_far): ")
    assert "200 mm or mrad" in urdf.verdict
    without = judged(result, USE).write_urdf(tmp_path / "t.urdf", target_link=True).read_bytes()
    assert urdf.with_comments(run=urdf.run, verdict="").data == without
    assert Robot.load(accepted, "base", "calib_target").joint_names == result.robot.joint_names
    assert plain == result.robot.urdf.data


@pytest.mark.parametrize("use", [USE, CARE])
def test_any_other_verdict_is_written_without_a_comment(result: Calibration, tmp_path, use: str):
    path = judged(result, use).write_urdf(tmp_path / "c.urdf", accept=True)
    assert path.read_bytes() == result.robot.urdf.data


def test_what_an_earlier_calibration_stated_does_not_stay(result: Calibration, tmp_path: Path):
    stated = result.robot.urdf.with_comments(run="", verdict="do not use (no_better): Of January.")
    later = replace(result, robot=replace(result.robot, urdf=stated))
    assert later.write_urdf(tmp_path / "a.urdf").read_bytes() == result.robot.urdf.data
    again = judged(later, NO).write_urdf(tmp_path / "b.urdf", accept=True)
    assert again.read_bytes().count(b"calib verdict") == 1
    assert "parameter_far" in Urdf.read(again).verdict


def test_the_summary_of_an_evaluation_is_what_the_command_line_prints(ur3: Robot, table):
    evaluation = calib.evaluate(ur3, table, CELL)
    assessment = assess(ur3, table, CELL)
    assert summary(assessment).startswith(evaluation.summary())


def test_help_lists_every_attribute_of_a_calibration():
    text = inspect.getdoc(Calibration)
    names = {field.name for field in fields(Calibration)}
    names |= {name for name, value in vars(Calibration).items() if isinstance(value, property)}
    assert [name for name in names if not re.search(rf"\b{name}\b", text)] == []
    assert len(text.splitlines()) < 25


@pytest.mark.parametrize("name", ["predict", "predict_poses", "position_std", "tip_poses"])
def test_the_first_line_of_a_prediction_says_by_which_model(name: str):
    first = inspect.getdoc(getattr(Calibration, name)).splitlines()[0]
    assert "non-geometric model if there is one, else" in first
