"""Whether a tolerance is kept: the decision rule, what counts against it, and what it says."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.stats import binom

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import CalibError, MeasurementError
from calib.files import plain
from calib.result.acceptance import FAIL, PASS, UNDECIDED, Acceptance, Check, acceptance
from calib.result.accuracy import accuracy
from calib.result.evaluation import Evaluation, evaluate
from calib.robot.readback import random_joint_values
from calib.robot.robot import Robot
from calib.text.acceptance import (
    acceptance_reasons,
    acceptance_text,
    accuracy_text,
    poses_text,
    worst_first,
)
from calib.text.evaluation import acceptance_table, accuracy_table

ROBOT = "the robot"


def evaluation(
    robot: Robot,
    lengths: list[float],
    repeats: int = 1,
    turns: list[float] | None = None,
    cell: Cell | None = None,
    **columns: object,
) -> Evaluation:
    """Errors of these sizes [mm] along x, one for each pose, and of these angles [mrad] about z."""
    from scipy.spatial.transform import Rotation

    q = np.repeat(random_joint_values(robot, len(lengths), 3), repeats, axis=0)
    poses = robot.poses(q)
    e = np.zeros((len(q), 3))
    e[:, 0] = 1e-3 * np.repeat(lengths, repeats)
    if turns is not None:
        w = np.zeros((len(q), 3))
        w[:, 2] = 1e-3 * np.repeat(turns, repeats)
        columns["rotations"] = Rotation.from_rotvec(w).as_matrix() @ poses[:, :3, :3]
        columns["kinds"] = ("pose",) * len(q)
    cell = Cell(target=(0.0, 0.0, 0.0), estimate_target=False) if cell is None else cell
    table = Measurements(robot.joint_names, q, poses[:, :3, 3] + e, **columns)
    return evaluate(robot, table, cell)


def text(a: Acceptance) -> str:
    return " ".join(acceptance_text(a, ROBOT).split())


@pytest.mark.parametrize(
    ("figure", "uncertainty", "factor", "outcome"),
    [
        (0.4, 0.0, 1.0, PASS),
        (0.5, 0.0, 1.0, PASS),
        (0.6, 0.0, 1.0, FAIL),
        (0.4, 0.1, 1.0, PASS),
        (0.45, 0.1, 1.0, UNDECIDED),
        (0.55, 0.1, 1.0, UNDECIDED),
        (0.7, 0.1, 1.0, FAIL),
        (0.4, 0.0, 1.2, PASS),
        (0.4, 0.0, 1.3, UNDECIDED),
        (0.4, 0.05, 1.2, UNDECIDED),
        (0.1, 0.0, np.inf, UNDECIDED),
        (0.6, 0.0, np.inf, FAIL),
    ],
)
def test_the_decision_rule(figure: float, uncertainty: float, factor: float, outcome: str):
    # In units that doubles hold exactly: 0.5 is the tolerance.
    check = Check(figure, 0.5, uncertainty, factor, np.nan, seen=False)
    assert check.outcome == outcome
    seen = replace(check, seen=True).outcome
    assert seen == (FAIL if outcome == FAIL else UNDECIDED)


def test_what_is_judged_depends_on_the_criterion(ur3: Robot):
    found = evaluation(ur3, [0.1, 0.2, 0.6], 3)
    shaken = replace(
        found, residual=found.residual + 1e-4 * np.tile([[1.0], [0.0], [-1.0]], (3, 3))
    )
    figures = {
        name: acceptance(shaken, 0.5e-3, criterion=name).length.figure
        for name in ("max", "mean", "single")
    }
    assert figures["max"] == pytest.approx(0.6e-3)
    assert figures["mean"] == pytest.approx(0.3e-3)
    assert figures["single"] == pytest.approx(1e-3 * np.sqrt(0.7**2 + 2 * 0.1**2))
    assert acceptance(found, 0.5e-3).outcome == FAIL
    mean = acceptance(found, 0.5e-3, criterion="mean")
    assert mean.passed
    assert "the mean pose accuracy AP of 3 poses is 0.300 mm, within the tolerance" in text(mean)
    assert "95 % confidence" not in text(mean)
    single = acceptance(shaken, 0.65e-3, criterion="single")
    assert (single.outcome, single.within) == (FAIL, 2)
    assert "the largest error of a single repeat of 3 poses is 0.714 mm (rows 7, 8, 9)" in text(
        single
    )


def test_lengths_and_angles_must_both_be_kept(ur3: Robot):
    found = evaluation(ur3, [0.1, 0.2, 0.3, 0.4], turns=[4.0, 3.0, 2.0, 1.0])
    both = acceptance(found, 0.5e-3, 5e-3)
    assert (both.outcome, both.within) == (PASS, 4)
    assert (both.length.figure, both.angle.figure) == pytest.approx((0.4e-3, 4e-3))
    one = acceptance(found, 0.5e-3, 2.5e-3)
    assert (one.length.outcome, one.angle.outcome, one.outcome) == (PASS, FAIL, FAIL)
    assert one.within == 2
    assert [pose.rows for pose in worst_first(one)] == [(1,), (2,), (3,), (4,)]
    assert "the largest AP of orientation of 4 poses is 0.2292 deg (row 1), above" in text(one)
    unsure = acceptance(found, 0.5e-3, 5e-3, uncertainty_angle=2e-3)
    assert (unsure.length.outcome, unsure.angle.outcome) == (PASS, UNDECIDED)
    assert unsure.outcome == UNDECIDED
    assert "The measuring uncertainty of 0.1146 deg (k = 2) is counted" in text(unsure)
    angle = acceptance(found, None, 5e-3)
    assert angle.length is None
    assert angle.passed
    assert "Positions were measured and have no tolerance: they are not judged." in text(angle)
    length = acceptance(found, 0.5e-3)
    assert "Orientations were measured and have no tolerance: they are not judged." in text(length)


@pytest.mark.parametrize("count", [5, 30, 59])
def test_the_share_holds_with_the_confidence_that_is_said(ur3: Robot, count: int):
    """Clopper and Pearson: whatever the true share is, the limit lies above it once in twenty at most."""
    figures = accuracy(evaluation(ur3, [0.1] * count))
    limits = np.array(
        [Acceptance(figures, "max", None, None, within).share for within in range(count + 1)]
    )
    assert limits[0] == 0.0
    assert limits[-1] == pytest.approx(0.05 ** (1.0 / count))
    for true in np.linspace(0.02, 0.98, 49):
        covered = binom.pmf(np.arange(count + 1), count, true)[limits <= true].sum()
        assert covered >= 0.95 - 1e-12


def test_a_figure_that_the_repeats_do_not_tell(ur3: Robot):
    found = evaluation(ur3, [0.1, 0.48], 4)
    noise = 1e-4 * np.tile([[1.0], [1.0], [-1.0], [-1.0]], (2, 3))
    a = acceptance(replace(found, residual=found.residual + noise), 0.5e-3)
    # s = sqrt(4/3) 0.1 mm with 18 degrees of freedom: t = 2.101, over the root of 4.
    assert a.length.random == pytest.approx(2.101 * np.sqrt(4 / 3) * 1e-4 / 2.0, rel=1e-3)
    assert "an AP is known to ± 0.121 mm (95 %): the figure is closer to the tolerance" in text(a)
    clear = acceptance(replace(found, residual=found.residual + noise), 0.7e-3)
    assert "an AP is known" not in text(clear)


def test_the_factor_stands_in_the_sum(ur3: Robot):
    found = evaluation(ur3, [0.1, -0.1] * 3, cell=Cell())
    for tolerance, side in ((1e-3, "within 1.000"), (0.14e-3, "above 0.140")):
        a = acceptance(found, tolerance, uncertainty=0.04e-3)
        figure = 1e3 * a.length.figure
        held = figure * np.sqrt(18 / 15) + 0.04
        assert a.length.held == pytest.approx(1e-3 * held)
        assert f"{figure:.3f} mm x 1.095 + 0.040 mm = {held:.3f} mm: {side} mm." in text(a)
        assert acceptance_table(a, "urdf", ROBOT)["length"]["held_m"] == a.length.held
    # The factor makes no fail, so it has no part in one.
    assert "Held against" not in text(acceptance(found, 0.5 * a.length.figure))
    cell = Cell(estimate_frame=True)
    nothing_left = acceptance(evaluation(ur3, [0.1, -0.1, 0.1], cell=cell), 1.0)
    assert "Held against" not in text(nothing_left)


def test_what_registering_takes_away_is_counted_and_said(ur3: Robot):
    a = acceptance(evaluation(ur3, [0.1, -0.1] * 3, cell=Cell()), 1e-3)
    assert a.length.factor == pytest.approx(np.sqrt(18 / 15))
    assert (
        "Registered to these rows: target, 3 unknowns from 18 numbers, so random errors look 8.7 % too small, which "
        "is counted against the outcome."
    ) in text(a)
    cell = Cell(estimate_frame=True)
    nothing_left = acceptance(evaluation(ur3, [0.1, -0.1, 0.1], cell=cell), 1.0)
    assert nothing_left.outcome == UNDECIDED
    assert "target and frame, 9 unknowns from 9 numbers, so nothing is left to judge by" in text(
        nothing_left
    )


def test_rows_that_the_fit_saw_prove_nothing(ur3: Robot):
    seen = acceptance(evaluation(ur3, [0.1, 0.2]), 0.5e-3, seen=True)
    assert seen.outcome == UNDECIDED
    assert "they can show that it fails, not that it passes. Measure fresh ones." in text(seen)
    assert "confidence" not in text(seen)
    assert acceptance(evaluation(ur3, [0.1, 0.6]), 0.5e-3, seen=True).outcome == FAIL
    sets = ("estimate", "estimate", "validate")
    apart = acceptance(evaluation(ur3, [0.9, 0.9, 0.1], sets=sets), 0.5e-3, seen=True)
    assert apart.passed
    assert "The validation rows alone are judged: to the others the calibration was fitted." in (
        text(apart)
    )
    sets = ("estimate",) * 6 + ("validate",)
    cell = Cell()
    apart = acceptance(evaluation(ur3, [0.1] * 7, sets=sets, cell=cell), 1e-3, seen=True)
    assert "the calibration was fitted and the target was registered." in text(apart)


def test_lengths_say_nothing_across_them(calibrated):
    _, c = calibrated("distances")
    a = acceptance(evaluate(c.nominal, c.measurements, c.cell), 1.0)
    assert "Rows of the kind 'distance' say nothing of errors across them." in text(a)
    row = poses_text(a, ROBOT).splitlines()[2].split()
    assert row[-4:] == ["-", "-", "-", "-"]
    assert "the largest AP of a length of" in text(a)
    assert "ISO 9283" not in text(a)
    assert accuracy_text({"nominal": a.accuracy}).startswith("Length accuracy [mm] ")


def test_the_poses_are_listed_worst_first_and_counted(ur3: Robot):
    found = evaluation(ur3, [0.1 * k for k in range(1, 13)], 3)
    lines = poses_text(acceptance(found, 0.5e-3), ROBOT).splitlines()
    assert lines[0] == "Poses, the worst first, of the robot:"
    assert lines[2].split() == ["rows", "34,", "35,", "36", "3", "1.200", "1.200", *["0.000"] * 3]  # fmt: skip
    assert len(lines) == 13
    assert lines[-1] == "  and 2 more"
    single = acceptance(found, 0.5e-3, criterion="single")
    assert poses_text(single, ROBOT).splitlines()[1].split()[-1] == "single"
    assert poses_text(single, ROBOT).splitlines()[2].split()[-1] == "1.200"
    order = [pose.rows[0] for pose in worst_first(acceptance(found, 0.5e-3, criterion="single"))]
    assert order == list(range(34, 0, -3))


def test_targets_and_set_ups_are_named_where_there_are_several(ur3: Robot):
    targets, groups = ("a", "b", "b"), ("left", "left", "right")
    found = evaluation(ur3, [0.1, 0.2, 0.3], targets=targets, groups=groups)
    lines = poses_text(acceptance(found, 1e-3), ROBOT).splitlines()
    assert lines[2].startswith("  row 3 (b, right) ")
    assert lines[4].startswith("  row 1 (a, left) ")
    far = evaluation(ur3, [0.1, 0.2], 5, targets=("a" * 40,) * 5 + ("b",) * 5)
    assert all(len(line) <= 100 for line in poses_text(acceptance(far, 1e-3), ROBOT).splitlines())


def test_robots_stand_side_by_side(ur3: Robot):
    many = accuracy(evaluation(ur3, [0.1, 0.2], 3, turns=[1.0, 2.0]))
    few = accuracy(evaluation(ur3, [0.3, 0.4]))
    lines = accuracy_text({"nominal": few, "calibrated": many}).splitlines()
    assert " ".join(lines[0].split()) == (
        "Pose accuracy, ISO 9283 [mm] poses AP max mean RP max mean single"
    )
    assert lines[1].split() == ["nominal", "2", "0.400", "0.350", "-", "-", "0.400"]
    assert lines[2].split() == ["calibrated", "2", "0.200", "0.150", "0.000", "0.000", "0.200"]
    assert lines[4].startswith("Orientation, ISO 9283 [deg]")
    assert lines[5].split() == ["nominal", "0", "-", "-", "-", "-", "-"]
    assert lines[6].split() == ["calibrated", "2", "0.1146", "0.0859", "0.0000", "0.0000", "0.1146"]
    assert "Orientation" not in accuracy_text({"nominal": few})


def test_the_tables_hold_what_the_text_says(ur3: Robot):
    found = evaluation(ur3, [0.1, 0.2], 3, turns=[1.0, 2.0])
    a = acceptance(found, 0.5e-3, uncertainty=0.1e-3)
    table = json.loads(json.dumps(plain(acceptance_table(a, "urdf", ROBOT, ["Mind the gap."]))))
    assert (table["outcome"], table["robot"], table["criterion"]) == ("pass", "urdf", "max")
    assert table["reasons"] == acceptance_reasons(a, ROBOT, ["Mind the gap."])
    assert table["reasons"][-1] == "Mind the gap."
    assert table["length"]["figure_m"] == pytest.approx(0.2e-3)
    assert (table["length"]["tolerance_m"], table["length"]["uncertainty_m"]) == (0.5e-3, 0.1e-3)
    assert table["angle"] is None
    assert (table["within"], table["share"]) == (2, pytest.approx(0.05**0.5))
    figures = json.loads(json.dumps(plain(accuracy_table(a.accuracy))))
    assert figures["ap_max_rad"] == pytest.approx(2e-3)
    assert (figures["repeats_min"], figures["repeats_max"], figures["rows"]) == (3, 3, "all")
    assert [pose["rows"] for pose in figures["poses"]] == [[1, 2, 3], [4, 5, 6]]
    assert figures["poses"][1]["ap_xyz_m"] == pytest.approx([0.2e-3, 0.0, 0.0], abs=1e-12)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({}, "State a tolerance: of positions in m, of orientations in rad, or of both."),
        ({"tolerance": 0.0}, r"The tolerance is 0.0 m; it must be a number above 0\."),
        ({"tolerance": np.nan}, "The tolerance is nan m; it must be a number above 0"),
        ({"tolerance_angle": np.inf}, "The tolerance is inf rad; it must be a number above 0"),
        (
            {"tolerance": 1e-3, "uncertainty": -1e-4},
            r"The measuring uncertainty is -0.0001 m; it must be 0 or larger\.",
        ),
        (
            {"tolerance": 1e-3, "uncertainty_angle": np.nan},
            "The measuring uncertainty is nan rad; it must be 0 or larger",
        ),
        (
            {"tolerance": 1e-3, "criterion": "best"},
            "The criterion is 'best'; choose one of 'max', 'mean', 'single'.",
        ),
    ],
)
def test_what_nothing_can_be_judged_by_is_refused(ur3: Robot, words: dict, message: str):
    with pytest.raises(CalibError, match=message):
        acceptance(evaluation(ur3, [0.1]), **words)


def test_a_tolerance_of_angles_needs_angles(ur3: Robot):
    with pytest.raises(
        MeasurementError,
        match=r"a tolerance of 0\.1 deg was stated, and no orientation was measured",
    ):
        acceptance(evaluation(ur3, [0.1]), 1e-3, np.radians(0.1))


@given(
    figure=st.floats(0.0, 1e-2),
    tolerance=st.floats(1e-6, 1e-2),
    uncertainty=st.floats(0.0, 1e-2),
    factor=st.floats(1.0, 10.0),
)
def test_what_counts_against_an_outcome_never_makes_it_better(
    figure: float, tolerance: float, uncertainty: float, factor: float
):
    plainly = Check(figure, tolerance, 0.0, 1.0, np.nan, seen=False)
    guarded = replace(plainly, uncertainty=uncertainty, factor=factor)
    assert plainly.outcome == (PASS if figure <= tolerance else FAIL)
    assert guarded.outcome in (plainly.outcome, UNDECIDED)
    assert replace(guarded, seen=True).outcome != PASS
