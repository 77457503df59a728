"""Small versions of the studies of scripts/ whose tables stand in docs/verification.md."""

from __future__ import annotations

import functools
import sys
from dataclasses import replace

import numpy as np
import pytest

from calib.result.table_fits import fit_table
from calib.robot.gravity import Payload
from tests.places import ROOT

sys.path.insert(0, str(ROOT / "scripts"))

from arms import example_urdfs, load_arm
from selection_study import drawn_widely, errors_by_model, table_of_truth
from verdict_study import DOES_NOT_FALL, HALVED, simulate
from verification_runs import points_run, sockets_run
from verification_study import (
    ALLOWED,
    STUDIES,
    ratio,
    run_one,
    run_study,
    study_text,
)
from verification_truth import JointErrors, Truth, draw_joint_values

#: A small version of each study still takes its minutes.
pytestmark = pytest.mark.slow


@functools.cache
def found(study: str, case: str, runs: int) -> list[dict]:
    return run_study(study, runs, cases=[case])[case]


@pytest.mark.parametrize(
    ("case", "bar"),
    [
        ("dh, tracker, 30", 1.10),
        ("dh, tracker, 60", 1.05),
        ("auto, base, 60", 1.05),
        ("dh, base, 300", 1.05),
    ],
)
def test_the_error_on_unseen_poses_is_as_small_as_the_noise_allows(case, bar):
    runs = found("accuracy", case, 12)
    assert 0.85 < ratio(runs) <= bar
    assert np.median([r["sigma"] for r in runs]) == pytest.approx(1.0, abs=0.05)


def test_intervals_and_predicted_uncertainty_hold_what_they_say():
    runs = found("coverage", "ur3, 60, base", 30)
    for what in ("parameters", "coordinates", "points"):
        assert 0.93 <= np.mean([r[what] for r in runs]) <= 0.97
    assert min(r["count"] for r in runs) >= 9
    assert ratio(runs) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("case", ["30", "60"])
def test_a_fifth_of_displaced_rows_is_flagged_and_costs_what_their_loss_does(case):
    runs = found("outliers", case, 8)
    assert all(r["missed"] == 0 and r["displaced"] == int(case) // 5 for r in runs)
    assert sum(r["wrongly"] for r in runs) <= 1
    # Nothing can do better than the rows that are left; with 30 poses they alone may miss 1.2.
    assert ratio(runs, "error", "kept") <= 1.01
    if case == "60":
        assert ratio(runs, "error", "clean") <= 1.2


@pytest.mark.parametrize(
    "case",
    [
        "ur3, zeros, 30",
        "ur3, dh, 30",
        "iiwa, dh+compliance, 30",
        "ur3, nothing, 12",
        "ur3, zeros, 12",
        "ur3, dh, 12",
        "iiwa, dh+compliance, 12",
    ],
)
def test_auto_picks_no_more_than_is_there_and_does_no_harm(case):
    _, wrong, count = case.split(", ")
    for run in found("auto", case, 1 if count == "30" else 2):
        assert run["model"] in ALLOWED[wrong]
        assert max(run["error"], run["geometry"]) <= 1.02 * run["frames"]


def test_auto_finds_what_is_there():
    assert found("auto", "ur3, zeros, 30", 1)[0]["model"] == "zeros"
    # What bends may be told by the lever arms as well as by the masses.
    picked = found("auto", "iiwa, dh+compliance, 30", 1)[0]["model"]
    assert picked in ("dh+compliance", "dh+gravity")


@pytest.mark.parametrize("seed", [1004, 1103])
def test_a_geometry_that_left_out_poses_contradict_predicts_worse(seed):
    """Two of the robots whose likeliest set is not the one that `auto` takes."""
    _, table = drawn_widely(seed)
    fits = fit_table(table.robot, table.measurements, table.cell)
    likeliest = max(
        (c for c in fits.candidates if "+" not in c.name), key=lambda c: c.evidence
    ).name
    assert fits.geometry.task.model != likeliest
    named = replace(table.cell, model=likeliest)
    other = fit_table(table.robot, table.measurements, named)
    assert table.error(fits.geometry) < 0.9 * table.error(other.geometry)


def test_the_study_has_every_robot_with_two_joints_or_more():
    files = example_urdfs()
    assert len(files) == len(set(files.values())) >= 60
    assert {"panda", "tiago", "pr2", "icub", "ur10_robot", "double_pendulum"} <= set(files)


@pytest.mark.parametrize(
    "case",
    [
        "TwoDofs",
        "double_pendulum_continuous",
        "laikago",
        "panda",
        "pr2",
        "tiago",
        "hextilt_flying_arm_5",
        "human",
        "ur10_robot",
    ],
)
def test_a_robot_of_any_kind_is_calibrated_exactly_without_noise(case):
    assert run_one("robots", case, 0)["written"] <= 1e-8


@pytest.mark.parametrize("case", ["0, 100", "5, 100"])
def test_compliances_lie_in_their_intervals(case):
    runs = found("compliance", case, 6)
    inside = [hit for r in runs for hit in r["inside"].values()]
    # 42 intervals; 36 or fewer of them hold the truth in 1 of 100 tries.
    assert len(inside) == 42
    assert sum(inside) >= 37
    assert ratio(runs) <= 1.2


@pytest.mark.parametrize("case", STUDIES["kinds"].cases())
def test_each_kind_of_measurement_reaches_its_bound(case):
    runs = found("kinds", case, 4)
    assert 0.7 <= ratio(runs) <= 1.25
    if case == "pose":
        assert ratio(runs, "angle", "bound_angle") <= 1.35


def test_the_truth_is_what_it_says():
    robot, rng = load_arm("ur3"), np.random.default_rng(1)
    q = draw_joint_values(robot, 5, rng)
    perfect = Truth.draw(robot, rng, "frames")
    np.testing.assert_allclose(
        perfect.poses(q), robot.poses(q) @ perfect.targets[0], rtol=0, atol=1e-12
    )
    # A joint that is off by a known angle is a joint at another value.
    bent = JointErrors(np.full(6, 1e-3), np.full(6, 2e-3), np.full(6, -1e-3), np.zeros(6))
    off = Truth(robot, perfect.x, "frames", robot, perfect.targets, bent)
    moved = q + 1e-3 * q + 2e-3 * np.sin(q) - 1e-3 * np.cos(q)
    np.testing.assert_allclose(off.points(q), perfect.points(moved), rtol=0, atol=1e-12)


def test_the_load_is_the_slope_of_the_potential_energy():
    robot, rng = load_arm("iiwa"), np.random.default_rng(2)
    truth = Truth.draw(robot, rng, "frames", payload=Payload(5.0, np.array([0.05, 0.03, 0.1])))
    bare = Truth.draw(robot, rng, "frames")
    q = draw_joint_values(robot, 1, rng)
    load = (truth.load(robot.urdf_values(q)) - bare.load(robot.urdf_values(q)))[0]

    def height(values):
        return (robot.poses(values) @ [0.05, 0.03, 0.1, 1.0])[0, 2]

    steps = 1e-6 * np.eye(7)
    slope = np.array([(height(q + s) - height(q - s)) / 2e-6 for s in steps])
    np.testing.assert_allclose(load, -5.0 * 9.81 * slope, atol=1e-6)


def test_a_ball_in_a_socket_is_there():
    truth = Truth.draw(load_arm("ur3"), np.random.default_rng(3))
    run = sockets_run(truth, np.random.default_rng(4), 8, 1e-6)
    p = truth.points(np.array(run.measurements.joints))
    for group in set(run.measurements.groups):
        own = np.array(run.measurements.groups) == group
        assert own.sum() >= 2
        assert np.ptp(p[own], axis=0).max() < 2e-5


def test_the_bound_falls_with_the_noise_and_the_rows():
    truth = Truth.draw(load_arm("ur3"), np.random.default_rng(5))
    bounds = [
        points_run(truth, np.random.default_rng(6), count, sigma).bound ** 0.5
        for count, sigma in ((40, 1e-4), (40, 2e-4), (640, 1e-4))
    ]
    assert bounds[1] == pytest.approx(2.0 * bounds[0], rel=1e-6)
    assert bounds[2] == pytest.approx(0.25 * bounds[0], rel=0.3)


def test_the_table_is_markdown():
    text = study_text("accuracy", 2, run_study("accuracy", 2, cases=["dh, base, 30"]))
    assert text.splitlines()[4] == "| case | bar | value | met |"
    assert "`dh`, N = 30" in text


def test_the_verdict_is_use_where_the_error_halves_and_no_use_where_it_does_not_fall():
    """Of seeds that no threshold was chosen by."""
    outcomes = [simulate(seed) for seed in range(2000, 2035)]
    halved = [outcome.use for outcome in outcomes if outcome.change == HALVED]
    assert len(halved) > 7
    assert halved.count("use") >= 0.8 * len(halved)
    useless = [outcome.use for outcome in outcomes if outcome.change == DOES_NOT_FALL]
    assert "use" not in useless
    ratios = [outcome.expected["geometry"] for outcome in outcomes if outcome.rows > 15]
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(("true", "count"), [("frames", 12), ("zeros", 30), ("dh+compliance", 60)])
def test_auto_predicts_as_well_as_the_best_fixed_model(true, count):
    found = [errors_by_model(table_of_truth("ur5", true, count, seed)) for seed in range(4)]
    mean = {model: np.mean([one[model] for one in found]) for model in found[0]}
    assert mean.pop("auto") <= 1.1 * min(mean.values())
