"""Errors that the rows do not determine: expected if joints moved little, hardly if they moved over their ranges."""

from __future__ import annotations

import numpy as np
import pytest

from calib.data.cell import Cell, Priors
from calib.data.measurements import Measurements
from calib.result.calibrate import calibrate
from calib.robot.ranges import random_joint_values
from calib.verbs.evaluate.evaluation import evaluate
from calib.verbs.simulate.truth import draw_truth

#: Errors of an arm that differs from its URDF by little but eccentricity [m], [rad].
ECCENTRIC = {"length": 1e-4, "angle": 3e-4, "zero": 5e-4, "eccentricity": 2e-3}

#: Noise of a coordinate [m].
NOISE = 5e-5


def calibrated_in_part(robot, share, seed, model="dh", **cell):
    """Calibrate an arm with eccentricity in a share of its joint ranges; also the true error over the limits [m]."""
    truth = draw_truth(robot, "placement+eccentricity", ECCENTRIC, seed)
    centre = random_joint_values(robot, 1, seed + 1)
    q = centre + share * (random_joint_values(robot, 30, seed + 2) - centre)
    points = truth.points(q) + NOISE * np.random.default_rng(seed).normal(size=(30, 3))
    result = calibrate(
        robot,
        Measurements(robot.joint_names, q, points),
        cell=Cell(scale_certified=True, **cell),
        model=model,
    )
    fresh = random_joint_values(robot, 300, 99)
    table = Measurements(robot.joint_names, fresh, truth.points(fresh))
    return result, evaluate(result.robot, table, Cell()).errors["all"]["m"].rms


@pytest.mark.parametrize("seed", [3, 10])
def test_eccentricity_in_a_corner_is_expected_over_the_joint_limits(ur3, seed):
    """The zeros that stand for it near are wrong elsewhere: the verdict on them is not `use`."""
    result, true = calibrated_in_part(ur3, 0.12, seed, estimate_frame=False)
    model = result.geometry
    assert 0.4 * true < result.new_point[1] < 3.0 * true
    assert result.verdict.use != "use"
    # By the covariance alone, far too little was expected.
    assert model.undetermined > 3.0 * model.expected_everywhere


def test_rows_all_over_the_limits_determine_all(ur3):
    """There eccentricity is seen among the residuals, and nothing beyond them is expected."""
    result, true = calibrated_in_part(ur3, 1.0, 3)
    assert result.new_point[1] == pytest.approx(true, rel=0.5)
    assert result.geometry.undetermined < 0.5 * true


@pytest.mark.parametrize("key", ["off", "paper"])
def test_without_priors_nothing_is_added(ur3, key):
    truth = draw_truth(ur3, "placement", ECCENTRIC, 3)
    q = random_joint_values(ur3, 30, 5)
    table = Measurements(ur3.joint_names, q, truth.points(q))
    if key == "paper":
        result = calibrate(ur3, table, model="paper", solver="paper", validate=False)
    else:
        result = calibrate(
            ur3, table, cell=Cell(priors=Priors(source="off")), model="dh", validate=False
        )
    assert result.geometry.undetermined == 0.0


def test_the_larger_of_two_estimates_of_what_is_lacking_counts(ur3):
    model = calibrated_in_part(ur3, 1.0, 3)[0].geometry
    u, f = model.undetermined, model.extrapolation
    for v in (-1e-6, 0.0, 1e-9, 1e-4):
        assert model.added_variance(v) == pytest.approx(max((f if v > 0 else 1) * v, v + u * u))
