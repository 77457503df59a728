"""Errors that the rows do not determine: expected if joints moved little, hardly if they moved over their ranges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell, Priors
from calib.data.measurements import Measurements
from calib.numerics.rigid_motion import displacements_by, without_rigid_motion
from calib.result.calibrate import calibrate
from calib.result.row_scatter import joint_twists
from calib.robot.ranges import random_joint_values
from calib.verbs.evaluate.evaluation import evaluate
from calib.verbs.simulate.truth import draw_truth

#: Errors of an arm that differs from its URDF by little but eccentricity [m], [rad].
ECCENTRIC = {"length": 1e-4, "angle": 3e-4, "zero": 5e-4, "eccentricity": 2e-3}

#: Noise of a coordinate [m].
NOISE = 5e-5


def calibrated_in_part(robot, share, seed, model="dh", validate=True, **cell):
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
        validate=validate,
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


@pytest.fixture(scope="module")
def in_a_corner(ur3):
    """A calibration in a corner of the joint ranges, of an arm with eccentricity that the model lacks."""
    return calibrated_in_part(ur3, 0.12, 3, estimate_frame=False)[0]


@pytest.mark.parametrize("frame", [False, True])
def test_the_covariance_of_the_families_is_that_error_at_each_pose(ur3, in_a_corner, frame):
    """Over the limits it is the square that is added, with rare families and what is added at the measured poses.

    Of a frame that is estimated, what a rigid motion of all poses does is no error.
    """
    result = in_a_corner
    if frame:
        result, _ = calibrated_in_part(ur3, 0.12, 3, estimate_frame=True, validate=False)
    model = result.geometry
    families = model.undetermined_families
    everywhere = random_joint_values(result.nominal, 300, 11)
    measured = result.fit.measurements.joints

    def mean_square(q):
        samples = result.samples(q)
        T, own = model.twists(samples)
        further = families.twists(result.nominal, model.setup, samples, in_base=False)
        J = np.concatenate([own, further], axis=2)[:, :3]
        if frame:
            J = without_rigid_motion(T[:, :3, 3], J)
        return np.mean(np.sum((J @ families.factor) ** 2, axis=(1, 2)))

    added = mean_square(everywhere) - mean_square(measured)
    assert 1.0 < np.sqrt(added) / model.undetermined < 1.15
    assert mean_square(measured) < 0.05 * mean_square(everywhere)


def test_further_parameters_move_joints_by_their_factors(in_a_corner):
    """A gain by the joint's value, an eccentricity by its sine, a second harmonic by that of twice the value."""
    families = in_a_corner.geometry.undetermined_families
    nominal = replace(in_a_corner.geometry.kinematics, T_tip_target=in_a_corner.setup.T_tip_target)
    samples = in_a_corner.samples(random_joint_values(in_a_corner.nominal, 4, 2))
    J_q = joint_twists(nominal, np.zeros(len(in_a_corner.parameters)), samples)
    J = families.twists(in_a_corner.nominal, in_a_corner.setup, samples, in_base=False)
    joint = in_a_corner.nominal.joint_names[1]
    q = samples.q[:, 1]
    for factor, number in (("gain", q), ("sin", np.sin(q)), ("cos_2", np.cos(2.0 * q))):
        column = J[:, :, families.names.index(f"{joint}.{factor}")]
        assert column == pytest.approx(J_q[:, :, 1] * number[:, None], abs=1e-6)


def test_in_the_base_the_motion_that_compensates_is_left_out(in_a_corner):
    families = in_a_corner.geometry.undetermined_families
    robot, setup = in_a_corner.nominal, in_a_corner.setup
    turned = replace(setup, T_frame_base=setup.T_frame_base.copy())
    samples = in_a_corner.samples(random_joint_values(robot, 3, 2))
    in_base = families.twists(robot, turned, samples, in_base=True)
    motion = np.random.default_rng(0).standard_normal((6, len(families.names)))
    moved = replace(families, base_motion=motion).twists(robot, turned, samples, in_base=True)
    points = robot.poses(samples.q) @ setup.T_tip_target[0]
    assert in_base[:, :3] - moved[:, :3] == pytest.approx(
        displacements_by(motion, points[:, :3, 3])
    )
    assert in_base[:, 3:] - moved[:, 3:] == pytest.approx(
        np.broadcast_to(motion[3:], (3, 3, len(families.names)))
    )
