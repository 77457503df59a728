"""An evaluation as text: its numbers are those of the assessment, its tables have every robot."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.show.lines import mm
from calib.verbs.evaluate.acceptance import Assessment, assess
from calib.verbs.evaluate.accuracy import accuracy
from calib.verbs.evaluate.evaluation import evaluate
from calib.verbs.evaluate.report import Origins, summary
from calib.verbs.evaluate.text import outcome_reasons, uncertainty_sentences

KNOWN = Cell(target=(0.0, 0.0, 0.0), estimate_target=False)


def measured(robot: Robot, errors: np.ndarray) -> Measurements:
    """Three repeats of each pose, off by these lengths [m] along x."""
    q = np.repeat(random_joint_values(robot, len(errors), 3), 3, axis=0)
    points = robot.poses(q)[:, :3, 3]
    points[:, 0] += np.repeat(errors, 3)
    return Measurements(robot.joint_names, q, points)


@pytest.fixture(scope="module")
def assessment(ur3: Robot) -> Assessment:
    errors = 1e-4 * np.arange(1, 13)
    limits = {"tolerance": {"m": 2e-3}, "uncertainty": {"m": 1e-4}}
    return assess(ur3, measured(ur3, errors), KNOWN, limits=limits)


@pytest.fixture(scope="module")
def text(assessment: Assessment) -> str:
    return summary(assessment, Origins("result.json"))


def numbers(line: str) -> list[float]:
    return [float(word) for word in re.findall(r"-?\d+\.\d+", line)]


def test_the_outcome_stands_first(text: str, assessment: Assessment):
    assert text.splitlines()[0] == f"Verdict: {assessment.accepted.outcome}" == "Verdict: pass"
    said = " ".join(text.split())
    check = assessment.accepted.checks["m"]
    assert f"largest AP of 12 poses is {mm(check.figure)} mm (rows 34, 35, 36)" in said
    assert f"= {mm(check.held)} mm <= {mm(check.tolerance)} mm." in said
    assert max(map(len, text.splitlines())) <= 100


def test_the_errors_are_those_of_the_robot(text: str, assessment: Assessment):
    errors = assessment.evaluations["urdf"].errors["all"]
    (line,) = [line for line in text.splitlines() if line.startswith("  measured rows ")]
    shown = 1e3 * np.array(
        [errors["m"].max, errors["m"].mean, errors["m"].rms, *errors["m"].span_axis]
    )
    assert line.split()[2] == str(errors["m"].n) == "36"
    assert numbers(line) == pytest.approx(shown, abs=5.01e-4)


def test_the_accuracies_are_those_of_the_robot(text: str, assessment: Assessment):
    accuracy = assessment.accuracies["urdf"]
    (line,) = [line for line in text.splitlines() if line.startswith("  URDF as it is ")]
    expected = [1e3 * value for value in accuracy.figures("m").values()]
    assert numbers(line) == pytest.approx(expected, abs=5.01e-4)


def test_the_worst_poses_are_listed(text: str):
    lines = text.splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith("Poses, the worst first"))
    rows = lines[start + 2 :]
    assert rows[0].startswith("  rows 34, 35, 36 ")
    assert numbers(rows[0])[:2] == pytest.approx([1.2, 1.2], abs=1e-3)
    assert len(rows) == 11
    assert rows[-1] == "  and 2 more"


def test_long_names_of_files_are_shortened(assessment: Assessment):
    long = summary(assessment, Origins("a" * 200 + ".json"))
    assert "the URDF as it is:" in long.splitlines()


def test_what_fails_is_above_the_tolerance_without_the_guard_band(ur3: Robot):
    limits = {"tolerance": {"m": 0.9e-3}, "uncertainty": {"m": 1e-4}}
    failed = assess(ur3, measured(ur3, 1e-4 * np.arange(1, 13)), KNOWN, limits=limits)
    said = " ".join(summary(failed, Origins("result.json")).split())
    figure = failed.accepted.checks["m"].figure
    assert said.startswith("Verdict: fail")
    assert (
        f"AP of 12 poses is {mm(figure)} mm (rows 34, 35, 36), above the tolerance of 0.900 mm."
        in said
    )
    equation = (
        f"{mm(figure)} - guard band 0.100 (k = 2, ISO 14253-1) = {mm(figure - 1e-4)} mm > 0.900 mm."
    )
    assert equation in said


def test_a_calibration_that_is_no_better_by_its_figure_is_said(assessment: Assessment):
    """The evaluated robot's largest AP is 1.2 mm; that of the nominal one is smaller, or not."""
    better = replace(assessment.accuracies["urdf"], poses=assessment.accuracies["urdf"].poses[:5])
    for nominal, is_said in ((better, True), (assessment.accuracies["urdf"], False)):
        both = replace(assessment, accuracies={**assessment.accuracies, "nominal": nominal})
        said = " ".join(outcome_reasons(both, "result.json"))
        assert ("0.500 mm: by this figure" in said) == is_said


def test_rows_beyond_their_uncertainty_are_counted_and_named(ur3):
    judged = accuracy(evaluate(ur3, measured(ur3, 1e-4 * np.arange(1, 13)), KNOWN))
    (sentence,) = uncertainty_sentences(
        replace(judged, known={"m": 36, "rad": 0}, beyond={"m": (4, 5, 6, 9), "rad": ()})
    )
    assert "32 of 36 rows" in sentence
    assert "4 to 6, 9" in sentence
    assert not list(uncertainty_sentences(judged))
