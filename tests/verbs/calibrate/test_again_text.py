"""Results made again, in words."""

from __future__ import annotations

from dataclasses import replace

import pytest

import calib
from calib.example import paper_measurements, paper_urdf
from calib.verbs.calibrate.again import Again, Change, Difference, What
from calib.verbs.calibrate.again_text import again_text


@pytest.fixture(scope="module")
def pair() -> tuple[calib.Calibration, calib.Calibration]:
    """Two calibrations; of the second one measured point was moved."""
    robot = calib.Robot.load(paper_urdf(), base="base", tip="tool0")
    table = calib.Measurements.read(paper_measurements(), robot.joint_names)
    points = table.points.copy()
    points[3] += 1e-4
    tables = (table, replace(table, points=points))
    first, second = (calib.calibrate(robot, each, model="zeros", validate=False) for each in tables)
    return first, second


def made_again(pair: tuple[calib.Calibration, calib.Calibration], *changes: Change) -> Again:
    difference = Difference("parameters[0].value", 1.0, 2.0)
    return Again(
        before=pair[0], result=pair[1], changes=changes, compared=10, differences=(difference,)
    )


def test_what_moved_most_comes_first(pair: tuple[calib.Calibration, calib.Calibration]):
    again = made_again(pair)
    farthest = again.moved[0]
    assert all(farthest.in_std >= other.in_std for other in again.moved)
    text = again_text(again)
    assert f"{farthest.before.name} by {farthest.in_std:.2g}" in text
    assert again.summary() == text
    assert "1 of 10 values" in text


def test_equal_results_say_so_in_one_line(pair: tuple[calib.Calibration, calib.Calibration]):
    again = replace(made_again(pair), result=pair[0], differences=())
    assert again.is_equal
    assert again.has_same_urdf
    assert len(again_text(again).splitlines()) == 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (Change(What.INPUT, "data.csv", 64 * "a", 64 * "b"), ("'data.csv'", 12 * "a", 12 * "b")),
        (Change(What.PLUGIN, "own.py", 64 * "c", ""), ("'own.py'", 12 * "c", "none")),
        (Change(What.OPTION, "cell.model", "", '"dh"'), ("cell.model", "by default", '"dh"')),
        (Change(What.VERSION, "numpy", "2.2.0", "2.4.6"), ("numpy", "2.2.0", "2.4.6")),
    ],
)
def test_each_change_is_named(
    pair: tuple[calib.Calibration, calib.Calibration], change: Change, words: tuple[str, ...]
):
    (line,) = [
        line for line in again_text(made_again(pair, change)).splitlines() if line.startswith("  ")
    ]
    for word in words:
        assert word in line


def test_a_relative_difference_is_that_of_numbers():
    assert Difference("x", 1.0, 1.25).relative == pytest.approx(0.2)
    assert not Difference("x", "a", "b").relative > 0.0


def test_a_parameter_in_standard_deviations(pair: tuple[calib.Calibration, calib.Calibration]):
    for moved in made_again(pair).moved:
        before, now = (result.parameter(moved.before.name) for result in pair)
        assert moved.in_std == pytest.approx(abs(now.value - before.value) / before.std)
