"""What is said of commands: each code in words."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Reason, Verdict, Why
from calib.result.calibrate import calibrate
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.compensate.commands import Code, Commands, CommandWarning
from calib.verbs.compensate.compensate import compensate
from calib.verbs.compensate.expected import Source
from calib.verbs.compensate.robot_program import Program
from calib.verbs.compensate.text import (
    _REMEDIES,
    _SOURCES,
    _TEXTS,
    _errors_and_corrections,
    finding_text,
    text,
)
from tests.hard_cases import made


@pytest.mark.parametrize(
    ("finding", "said"),
    [
        (CommandWarning("unreachable", (1e-3, np.radians(2))), "cannot reach it: 1.0000 mm, 2.0000 deg would be left"),
        (CommandWarning("unreachable", (1e-3, np.nan)), "cannot reach it: 1.0000 mm would be left"),
        (CommandWarning("beyond limit", (np.radians(370), np.radians(360)), "elbow_joint"),
         "'elbow_joint' would have to be at 370.0000 deg, beyond its limit 360.0000"),
        (CommandWarning("jump", (np.radians(20),), "elbow_joint", "row 4"),
         "a jump: from row 4 'elbow_joint' moves 20.0 deg"),
    ],
)  # fmt: skip
def test_codes_in_words(ur3: Robot, finding: CommandWarning, said: str):
    assert said in finding_text(finding, ur3)


def test_every_code_has_words():
    assert tuple(_TEXTS) == get_args(Code)


def test_every_source_has_words_and_a_remedy():
    assert tuple(_SOURCES) == get_args(Source)
    assert tuple(_REMEDIES) == get_args(Source)


def said(found: Commands) -> str:
    """The text in one line."""
    return " ".join(text(found, "result.json", None).split())


def mainly(found: Commands, source: Source, **changes: object) -> Commands:
    """The commands with expected errors of one source above all."""
    squares = dict.fromkeys(get_args(Source), 1e-08) | {source: 1e-6}
    expected = replace(found.expected, contributions=squares, **changes)
    return replace(found, expected=expected)


@pytest.fixture(scope="module")
def found() -> Commands:
    result = made("paper")
    q = result.rows.ranges.mean(axis=1)
    q[4] += 0.5  # away from the wrist's singularity
    return compensate(result, Program.of_joints(q), tool=(0.0, 0.0, 0.15))


def test_what_a_controller_with_the_corrected_robot_gets_is_said():
    result = made("non_geometric")
    program = Program.of_joints(result.rows.ranges.mean(axis=1) + 0.2)
    of_corrected = said(compensate(result, program, nominal=result.robot))
    assert "correct only what the non-geometric model adds" in of_corrected
    assert "correct only what" not in said(compensate(result, program))


def test_what_commands_rest_on_if_joints_stop_short_is_said(ur3: Robot, found: Commands):
    """The order of the rows with lost motion; the side, if all poses of the calibration were approached from one."""
    q = random_joint_values(ur3, 40, 3)
    points = (ur3.poses(q) @ [0.05, 0.02, 0.1, 1.0])[:, :3]
    points += 2e-5 * np.random.default_rng(3).normal(size=points.shape)
    m = Measurements(ur3.joint_names, q, points)
    of_order = calibrate(ur3, m, model="zeros+lost_motion", validate=False)
    program = Program.of_joints(q[:3])
    assert "in their order: keep it" in said(compensate(of_order, program, tool=""))
    result = made("paper")
    verdict = Verdict("use", (Reason.of(Why.ONE_SIDED, rising=["a"], falling=[]),))
    one_sided = replace(result, geometry=replace(result.geometry, verdict=verdict))
    assert "from this side too" in said(compensate(one_sided, found.program))
    assert "from this side" not in said(found)
    assert "in their order" not in said(found)


def test_the_expected_error_stands_once_and_its_sources_below(found: Commands):
    printed = said(found)
    mean = 1e3 * found.expected.mean
    assert printed.count("Expect position errors of ") == 1
    assert f"Expect position errors of {mean:.3f} mm" in printed
    low, high = found.expected.band
    assert f"{1e3 * low:.3f} and {1e3 * high:.3f} mm" in printed
    shares = [int(word) for word in re.findall(r"(\d+) %", printed)]
    assert sum(shares) == pytest.approx(100, abs=2)


def test_the_remedy_is_that_of_the_largest_source(found: Commands):
    for source in ("parameters", "poses", "tool"):
        assert " ".join(_REMEDIES[source].split()) in said(mainly(found, source))
    assert "sigma_mm" in said(mainly(found, "model", noise="unknown"))
    assert "sigma_mm" not in said(mainly(found, "model", noise="stated"))
    in_frame = said(mainly(found, "base", in_measured_frame=1.234e-4))
    assert "--poses-in measured (0.123 mm)" in in_frame
    assert "--poses-in" not in said(mainly(found, "base", in_measured_frame=None))
    assert "was not cross-validated" in said(mainly(found, "tool", validated=False))


def test_errors_and_corrections_are_lengths_and_angles_of_the_rows_with_a_command(found: Commands):
    pairs = _errors_and_corrections(found)
    rows = found.reached
    lengths, angles = pairs["error without compensation"]
    np.testing.assert_array_equal(lengths, found.missed[rows, 0])
    np.testing.assert_array_equal(angles, found.missed[rows, 1])
    lengths, angles = pairs["correction of a joint"]
    assert lengths.size == 0  # no joint slides
    np.testing.assert_array_equal(angles, np.abs(found.joint_corrections[rows]))
