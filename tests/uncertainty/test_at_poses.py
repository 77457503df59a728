"""The parts of the uncertainty at poses, each against a calculation of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.special import stdtrit

from calib.data.cell import Cell, StatedUncertainty
from calib.data.record import Record
from calib.model.error_model import FRAME, TARGET
from calib.result.calibrate import calibrate
from calib.result.calibration_file import read_result, write_result
from calib.uncertainty.at_poses import (
    Contribution,
    Distribution,
    PoseUncertainty,
    Source,
    arrivals_of,
    by_stated_places,
    parameter_covariances,
    scale_std,
)
from tests.tracked import SIGMA, T_FRAME_BASE, table_of


def part(uncertainty, source):
    """The part of a source; of none that adds nothing."""
    (found,) = [one for one in uncertainty.contributions if one.source is source]
    return found


# Parameters


def test_the_parts_of_the_parameters_add_up_and_are_covariances(tracked):
    parts = parameter_covariances(tracked.geometry)
    scale = np.sqrt(np.diag(tracked.covariance))
    total = sum(parts.values()) / np.outer(scale, scale)
    assert total == pytest.approx(tracked.covariance / np.outer(scale, scale), abs=1e-9)
    for C in parts.values():
        assert np.linalg.eigvalsh(C / np.outer(scale, scale))[0] > -1e-9


def test_frame_and_target_are_what_knowing_them_takes_off(tracked):
    """By the precision of the others, which needs no complement."""
    parts, model = parameter_covariances(tracked.geometry), tracked.geometry.model
    of_frame, of_target = model.family(FRAME), model.family(TARGET)
    assert of_frame.any()
    assert of_target.any()
    precision = np.linalg.inv(tracked.covariance)
    others = ~of_frame
    C_f = np.linalg.inv(precision[np.ix_(others, others)])
    left = tracked.covariance - parts[Source.FRAME]
    assert np.diag(left[np.ix_(others, others)]) == pytest.approx(np.diag(C_f), rel=1e-3)
    others = ~of_frame & ~of_target
    C_r = np.linalg.inv(precision[np.ix_(others, others)])
    left = left - parts[Source.TARGET]
    assert np.diag(left[np.ix_(others, others)]) == pytest.approx(np.diag(C_r), rel=1e-3)


def test_what_priors_hold_is_undetermined(tracked):
    """If the data said nothing, all of a parameter's variance would be its prior's."""
    model = tracked.geometry
    robot = model.model.of_robot
    prior_std = np.array([parameter.prior_std for parameter in model.parameters])
    alone = replace(model, covariance=np.diag(np.where(robot, prior_std, 1.0) ** 2))
    parts = parameter_covariances(alone)
    assert np.diag(parts[Source.UNDETERMINED])[robot] == pytest.approx(prior_std[robot] ** 2)
    assert np.abs(parts[Source.INSTRUMENT]).max() == pytest.approx(0.0, abs=1e-12)


def test_the_whole_of_the_parameters_is_the_models_own(tracked, points):
    uncertainty = tracked.uncertainty(points)
    sources = (Source.INSTRUMENT, Source.TARGET, Source.FRAME)
    known = sum(part(uncertainty, source).covariance for source in sources)
    samples = tracked.samples(points)
    _, J = tracked.geometry.twists(samples)
    priors = J @ parameter_covariances(tracked.geometry)[Source.UNDETERMINED] @ J.transpose(0, 2, 1)
    own = replace(tracked.geometry, scale=None).pose_std(samples) ** 2
    assert np.trace((known + priors)[:, :3, :3], 0, 1, 2) == pytest.approx(own[:, 0], rel=1e-6)
    assert np.trace((known + priors)[:, 3:, 3:], 0, 1, 2) == pytest.approx(own[:, 1], rel=1e-6)


def test_the_scale_displaces_all_points_by_one_number(tracked, points):
    model = tracked.geometry
    _, J = model.twists(tracked.samples(points))
    grown = J[:, :3] @ model.scale.growth
    scale = part(tracked.uncertainty(points), Source.SCALE)
    assert np.trace(scale.covariance[:, :3, :3], 0, 1, 2) == pytest.approx(
        np.sum(grown**2, axis=1) * scale_std(model) ** 2
    )
    # A tracker's 20 um/m at half a metre from the base.
    distance = np.linalg.norm(tracked.predict(points) - tracked.T_frame_base[:3, 3], axis=1)
    assert np.linalg.norm(grown, axis=1) == pytest.approx(distance, rel=0.2)
    assert scale_std(model) == pytest.approx(2e-5, rel=0.05)


# Arrivals


def test_the_instruments_noise_is_not_an_error_of_the_robot(tracked, points):
    """What is left at an arrival is far less than the noise of the rows, which is all the instrument's."""
    rows = tracked.geometry.scatter
    assert np.sqrt(rows.total[0]) == pytest.approx(SIGMA, rel=0.25)
    assert np.sqrt(rows.instrument[0]) == pytest.approx(SIGMA)
    arrivals = arrivals_of(tracked, tracked.geometry)
    assert arrivals.model[0] < 0.5 * SIGMA**2
    assert tracked.uncertainty(points).separated
    blind = replace(
        tracked,
        geometry=replace(tracked.geometry, scatter=replace(rows, instrument=np.full(2, np.nan))),
    )
    assert arrivals_of(blind, blind.geometry).model[0] == pytest.approx(rows.total[0])
    assert not blind.uncertainty(points).separated


def test_a_result_of_an_earlier_version_says_nothing_of_arrivals(tracked, points):
    old = replace(tracked, geometry=replace(tracked.geometry, scatter=None))
    assert Source.MODEL not in {one.source for one in old.uncertainty(points).contributions}


def test_repeats_tell_the_arms_arrivals(tracked):
    """Within repeats are instrument and arrivals; of the rest of the scatter the model is the cause."""
    variance = SIGMA**2
    rows = replace(
        tracked.geometry.scatter,
        total=np.array([9.0 * variance, np.nan]),
        freedom=np.array([1e6, 0.0]),
        within=np.array([4.0 * variance, np.nan]),
        within_freedom=np.array([1e6, 0.0]),
    )
    model = replace(tracked.geometry, scatter=rows)
    arrivals = arrivals_of(tracked, model)
    assert arrivals.repeatability[0] == pytest.approx(3.0 * variance, rel=1e-4)
    assert arrivals.model[0] == pytest.approx(5.0 * variance, rel=1e-4)
    assert arrivals.repeatability[1] == arrivals.model[1] == 0.0


def test_what_is_stated_is_a_line_of_its_own_and_not_of_the_model(with_statements, points):
    stated = with_statements(repeatability=3e-5, drift=2e-5)
    uncertainty = stated.uncertainty(points)
    repeatability, drift = (
        part(uncertainty, source) for source in (Source.REPEATABILITY, Source.DRIFT)
    )
    assert repeatability.covariance[3, :3, :3] == pytest.approx(9e-10 * np.eye(3))
    assert drift.covariance[3, :3, :3] == pytest.approx(4e-10 * np.eye(3))
    assert not np.any(drift.covariance[:, 3:])
    assert np.isinf(drift.freedom)
    without = arrivals_of(with_statements(), stated.geometry).model[0]
    assert arrivals_of(stated, stated.geometry).model[0] < without


# Joints and temperature


def test_steps_of_readings_go_through_pinocchios_jacobian(with_statements, points):
    step, lost = np.radians(0.01), np.radians(0.02)
    result = with_statements(resolution=step, lost_motion=lost)
    uncertainty = result.uncertainty(points)
    model = pin.buildModelFromXML(result.robot.urdf.data.decode())
    data = model.createData()
    frame = model.getFrameId("tool0")
    base = model.getFrameId("base")
    for k, q in enumerate(points):
        values = pin.neutral(model)
        for name, value in zip(result.nominal.joint_names, q, strict=True):
            joint = model.joints[model.getJointId(name)]
            at = joint.idx_q
            values[at : at + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
        J = pin.computeFrameJacobian(model, data, values, frame, pin.LOCAL)
        pin.updateFramePlacements(model, data)
        order = [model.idx_vs[model.getJointId(name)] for name in result.nominal.joint_names]
        J = J[:, order]
        R = T_FRAME_BASE[:3, :3] @ data.oMf[base].rotation.T @ data.oMf[frame].rotation
        linear = R @ (J[:3] - pin.skew(result.target) @ J[3:])
        expected = np.trace(linear @ linear.T)
        for source, limit in ((Source.RESOLUTION, step / 2.0), (Source.LOST_MOTION, lost)):
            found = part(uncertainty, source)
            assert found.distribution is Distribution.UNIFORM
            assert np.trace(found.covariance[k, :3, :3]) == pytest.approx(
                expected * limit**2 / 3.0, rel=1e-3
            )
            turns = np.trace(found.covariance[k, 3:, 3:])
            assert turns == pytest.approx(np.trace(J[3:] @ J[3:].T) * limit**2 / 3.0, rel=1e-3)


@pytest.mark.parametrize(
    ("measured", "expected"), [((), 100.0 / 12.0), ((20.0, 22.0), 100.0 / 12.0 + 4.0)]
)
def test_the_arm_grows_with_the_temperature(with_statements, points, measured, expected):
    """From 18 to 28 degrees, evenly: measured in the middle, or at 21 degrees."""
    result = with_statements(
        Record(temperature_C=measured), temperature=(18.0, 28.0), arm_expansion=2e-5
    )
    found = part(result.uncertainty(points), Source.TEMPERATURE)
    distance = np.linalg.norm(result.predict(points) - result.T_frame_base[:3, 3], axis=1)
    assert np.trace(found.covariance[:, :3, :3], 0, 1, 2) == pytest.approx(
        4e-10 * expected * distance**2
    )


def test_the_instrument_grows_over_the_temperatures_of_the_record(with_statements, points):
    result = with_statements(Record(temperature_C=(20.0, 23.0)), instrument_expansion=1e-5)
    _, J = result.geometry.twists(result.samples(points))
    grown = J[:, :3] @ result.geometry.scale.growth
    found = part(result.uncertainty(points), Source.TEMPERATURE)
    assert np.trace(found.covariance[:, :3, :3], 0, 1, 2) == pytest.approx(
        np.sum(grown**2, axis=1) * 1e-10 * 9.0 / 12.0
    )


# Stated places


@pytest.mark.parametrize("place", ["target", "frame"])
def test_a_stated_place_that_is_off_moves_predictions_as_a_fit_with_it_does(
    ur3, points, place, tmp_path
):
    """Fits with the place as stated, and displaced, against the derivative; priors and weights are held."""
    table, truth = table_of(ur3, 60)
    step = np.array([2e-4, -1e-4, 1e-4])
    stated = StatedUncertainty(target=1e-4) if place == "target" else StatedUncertainty(frame=1e-4)

    def fitted(off):
        target = truth.T_tip_target[0, :3, 3] + (off if place == "target" else 0.0)
        frame = T_FRAME_BASE.copy()
        frame[:3, 3] += off if place == "frame" else 0.0
        cell = Cell(T_frame_base=frame, uncertainty=stated, scale_certified=True)
        cell = replace(cell.with_target(target, estimate=False), priors=replace_source(cell.priors))
        return calibrate(ur3, table, cell=cell, model="dh", robust=False, validate=False)

    here, there = fitted(np.zeros(3)), fitted(step)
    samples = here.samples(points)
    model = here.geometry
    poses, J = model.twists(samples)
    ((source, left),) = by_stated_places(here, model, samples, poses, J, in_base=False)
    assert source.value == place
    moved = there.predict(points) - here.predict(points)
    linear = left[:, :3, :3] @ step / 1e-4
    assert moved == pytest.approx(linear, abs=0.1 * np.abs(linear).max())
    read = read_result(write_result(here, tmp_path / "result.json"))
    for result in (here, read):
        covariance = part(result.uncertainty(points), source).covariance
        assert covariance == pytest.approx(left @ left.transpose(0, 2, 1))


def replace_source(priors):
    """The priors, given."""
    return priors.with_source("given")


# The whole


def two_parts(freedoms, sources=(Source.SCALE, Source.MODEL)):
    """Two parts of 1 mm and 2 mm along an axis each, whose variances are known with degrees of freedom."""
    covariances = np.zeros((2, 1, 6, 6))
    covariances[0, 0, 0, 0], covariances[1, 0, 1, 1] = 1e-6, 4e-6
    parts = [
        Contribution(source, C, Distribution.STUDENT, freedom)
        for source, C, freedom in zip(sources, covariances, freedoms, strict=True)
    ]
    return PoseUncertainty(np.eye(4)[None], tuple(parts))


def test_many_degrees_of_freedom_are_by_welch_and_satterthwaite():
    uncertainty = two_parts((1e4, 2e4))
    assert uncertainty.position_std == pytest.approx([np.sqrt(5e-6)])
    expected = 25.0 / (1.0 / 1e4 + 16.0 / 2e4)
    assert uncertainty.position_freedom == pytest.approx([expected], rel=1e-3)
    assert np.isinf(uncertainty.orientation_freedom[0])
    assert uncertainty.orientation[0] == 0.0


@pytest.mark.parametrize("freedoms", [(6.0, np.inf), (8.0, 6.0), (np.inf, 12.0)])
def test_u_of_a_sum_of_ts_agrees_with_draws(freedoms):
    rng, count = np.random.default_rng(5), 200_000
    squares = np.zeros(count)
    for std, freedom in zip((1e-3, 2e-3), freedoms, strict=True):
        draws = std * rng.standard_normal(count)
        if np.isfinite(freedom):
            draws *= np.sqrt(freedom / rng.chisquare(freedom, count))
        squares += draws**2
    expected = np.quantile(np.sqrt(squares), 0.9545)
    assert two_parts(freedoms).position == pytest.approx([expected], rel=0.03)


def test_u_of_a_sum_of_ts_along_one_axis_is_that_of_a_t_with_its_variance_and_kurtosis():
    """Three of 1 mm and six degrees of freedom: of ten, with 3.6 mm^2, as 3.6 * 10 / 8 = 3 * 6 / 4."""
    covariance = np.zeros((1, 6, 6))
    covariance[0, 0, 0] = 1e-6
    sources = (Source.SCALE, Source.MODEL, Source.DRIFT)
    parts = [Contribution(source, covariance, Distribution.STUDENT, 6.0) for source in sources]
    uncertainty = PoseUncertainty(np.eye(4)[None], tuple(parts))
    assert uncertainty.position_freedom == pytest.approx([10.0])
    within = stdtrit(10.0, 0.5 + 0.5 * 0.9545)
    assert uncertainty.position == pytest.approx([np.sqrt(3.6e-6) * within], rel=1e-3)
    rng = np.random.default_rng(5)
    sums = 1e-3 * np.sum(rng.standard_t(6.0, (3, 200_000)), axis=0)
    assert uncertainty.position == pytest.approx([np.quantile(np.abs(sums), 0.9545)], rel=0.03)


def test_parts_by_one_estimate_of_the_noise_have_its_degrees_of_freedom():
    uncertainty = two_parts((10.0, 10.0), (Source.INSTRUMENT, Source.FRAME))
    assert uncertainty.position_freedom == pytest.approx([10.0])


def test_sources_can_be_taken_away_or_reduced():
    uncertainty = two_parts((np.inf, np.inf))
    assert uncertainty.without(Source.MODEL).position_std == pytest.approx([1e-3])
    quarter = uncertainty.without(Source.MODEL, share=0.25)
    assert quarter.position_std == pytest.approx([np.sqrt(2e-6)])
    nothing = uncertainty.without(Source.MODEL, Source.SCALE)
    assert nothing.position == pytest.approx([0.0])


def test_u_is_larger_where_no_row_was_measured(ur3):
    truth_table, truth = table_of(ur3, 40)
    near = truth_table.joints * 0.3
    rows = truth.points(near) + SIGMA * np.random.default_rng(1).standard_normal((40, 3))
    cell = Cell(sigma={"m": SIGMA}, instrument="tracker")
    table = replace(truth_table, joints=near, points=rows)
    result = calibrate(ur3, table, cell=cell, model="dh")
    inside = result.uncertainty(0.9 * near).position
    outside = result.uncertainty(3.0 * near).position
    assert np.median(outside) > 1.5 * np.median(inside)


def test_a_result_read_from_its_file_says_the_same(tracked, points, tmp_path):
    stated = StatedUncertainty(drift=1e-5, resolution=1e-5, temperature=(18.0, 25.0))
    result = replace(tracked, stated_uncertainty=stated)
    read = read_result(write_result(result, tmp_path / "result.json"))
    assert read.stated_uncertainty == stated
    here, there = result.uncertainty(points), read.uncertainty(points)
    assert [one.source for one in here.contributions] == [one.source for one in there.contributions]
    for one, other in zip(here.contributions, there.contributions, strict=True):
        assert one.covariance == pytest.approx(other.covariance, rel=1e-9, abs=1e-18)
        assert one.freedom == pytest.approx(other.freedom, rel=1e-9)
