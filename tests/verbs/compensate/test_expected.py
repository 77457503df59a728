"""The error to expect of commands: closed forms, drawn numbers, and robots whose errors are known."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pinocchio as pin
import pytest

from calib.data.cell import Cell, Priors
from calib.data.measurements import Measurements
from calib.model.parameter_sets import error_model
from calib.numerics.repeats import Repeats
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.compensate.expected import (
    BAND,
    ExpectedErrors,
    Source,
    _beyond_noise,
    _contributions,
    _freedom,
    _mean_errors,
    expected_errors,
)
from calib.verbs.compensate.nominal_actual import pair_of
from calib.verbs.compensate.pose_covariance import PoseCovariance
from calib.verbs.simulate.truth import draw_truth
from tests.hard_cases import CASES, made
from tests.parts import with_part
from tests.verbs.compensate.arms import off

TOOL = np.array([0.0, 0.05, 0.15])


def squares(found: ExpectedErrors) -> dict[str, float]:
    """Mean square of each source [mm^2]."""
    return {source: 1e6 * square for source, square in found.contributions.items()}


@pytest.mark.parametrize(
    ("variances", "lacking", "mean"),
    [
        ((1.0, 1.0, 1.0), 0.0, np.sqrt(8.0 / np.pi)),
        ((0.0, 1.0, 1.0), 0.0, np.sqrt(np.pi / 2.0)),
        ((1.0, 0.0, 0.0), 0.0, np.sqrt(2.0 / np.pi)),
        ((0.0, 0.0, 0.0), 3.0, np.sqrt(8.0 / np.pi)),
        ((0.0, 0.0, 0.0), 0.0, 0.0),
    ],
)
def test_the_mean_length_of_a_normal_error(variances, lacking, mean):
    covariance = np.diag([*variances, *np.array(variances) * 4.0])[None]
    errors = _mean_errors(covariance, np.array([lacking, 4.0 * lacking]))
    assert errors[0] == pytest.approx([mean, 2.0 * mean], rel=1e-9)


def test_the_mean_of_unlike_axes_is_that_of_draws():
    rng = np.random.default_rng(1)
    root = rng.normal(size=(3, 3)) * [1.0, 0.3, 0.1]
    covariance = np.zeros((1, 6, 6))
    covariance[0, :3, :3] = root @ root.T
    drawn = np.linalg.norm(rng.normal(size=(200_000, 3)) @ root.T, axis=1).mean()
    assert _mean_errors(covariance, np.zeros(2))[0, 0] == pytest.approx(drawn, rel=0.02)


def with_mean(mean: float, freedom: float) -> ExpectedErrors:
    """Expected errors of one row."""
    return ExpectedErrors(np.array([[mean, 0.0]]), {}, freedom, None, "stated", validated=True)


def known_to(*shared: float, by_priors: float = 0.0, by_scale: float = 0.0) -> PoseCovariance:
    """A pose known to these variances along x, each of an unknown of its own."""
    covariance = np.diag([sum(shared), 0.0, 0.0, 0.0, 0.0, 0.0])[None]
    return PoseCovariance(covariance, np.array(shared), by_priors, by_scale)


@pytest.mark.parametrize("shared", [(1.0,), (1.0, 0.7, 0.2), (1.0,) * 12])
def test_the_range_holds_its_share_of_draws(shared):
    rng = np.random.default_rng(2)
    root_mean_squares = np.sqrt(rng.normal(size=(50_000, len(shared))) ** 2 @ shared)
    certain = with_part(made("paper"), "noise", freedom=1e9)
    freedom = _freedom(certain, known_to(*shared), 0.0, None)
    low, high = with_mean(float(root_mean_squares.mean()), freedom).band
    inside = np.mean((root_mean_squares > low) & (root_mean_squares < high))
    assert inside == pytest.approx(BAND, abs=0.03)


def test_variances_are_known_as_well_as_what_tells_them():
    result = made("paper")
    held_out = result.cross_validation
    assert _freedom(result, known_to(0.0), 2e-8, held_out) == pytest.approx(
        held_out.errors_without_outliers["m"].n
    )
    assert _freedom(result, known_to(0.0), 0.0, held_out) == np.inf
    assert with_mean(1e-3, np.inf).band == (1e-3, 1e-3)
    many = (1e-3,) * 1000
    noise = _freedom(result, known_to(*many), 0.0, None)
    assert noise == pytest.approx(1.0 / (1e-3 + 1.0 / result.noise.freedom))
    priors = known_to(*many, by_priors=1.0)
    assert result.method.prior_std_from == "data"
    assert _freedom(result, priors, 0.0, None) == pytest.approx(1.0 / (1e-3 + 1.0 / 6.0))
    given = with_part(result, "method", prior_std_from="given")
    assert _freedom(given, priors, 0.0, None) == pytest.approx(1000.0)


def test_contributions_are_the_mean_square_and_none_is_negative():
    rising = _contributions(1.0, 2.0, known_to(5.0), known_to(9.0), known_to(10.0))
    assert list(rising.values()) == pytest.approx([1.0, 2.0, 3.0, 4.0, 1.0, 0.0])
    assert tuple(rising) == get_args(Source)
    falling = _contributions(1.0, 2.0, known_to(5.0), known_to(3.0), known_to(10.0))
    assert list(falling.values()) == pytest.approx([1.0, 2.0, 1.0, 0.0, 7.0, 0.0])
    scaled = _contributions(1.0, 2.0, known_to(5.0), known_to(9.0), known_to(13.0, by_scale=3.0))
    assert list(scaled.values()) == pytest.approx([1.0, 2.0, 3.0, 4.0, 1.0, 3.0])
    known_better = _contributions(0.0, 4.0, known_to(3.0), known_to(2.0), known_to(2.0))
    assert list(known_better.values()) == pytest.approx([0.0, 2.0, 0.0, 0.0, 0.0, 0.0])


def test_held_out_errors_beyond_noise_and_prediction():
    # 30 points: noise 0.1 mm and lack 0.2 mm a coordinate; a fit that takes a fifth of the scalars.
    noise, lack, leverage = 1e-4, 2e-4, 0.2
    variance = noise**2 + lack**2
    held_out = variance / (1.0 - leverage)
    predicted = 3.0 * variance * leverage
    rms = float(np.sqrt(3.0 * held_out))

    def beyond(sigma: float, freedom: float, rows: int = 30) -> float:
        return _beyond_noise(rows, rms, 3.0, predicted, sigma, freedom)

    assert beyond(noise, np.inf) == pytest.approx(3.0 * lack**2)
    assert beyond(noise, 60.0) == pytest.approx(3.0 * lack**2)
    # Noise that nobody states counts as error, so that near the measured poses the held-out error is expected.
    assert beyond(np.nan, 0.0) + predicted == pytest.approx(3.0 * held_out)
    # A tenth more than the noise is by chance; of many rows it is not.
    louder = float(noise * np.sqrt(1.0 + (lack / noise) ** 2) / np.sqrt(1.1))
    assert beyond(louder, np.inf) == 0.0
    assert beyond(louder, np.inf, rows=3000) > 0.0
    assert beyond(louder, 20.0, rows=3000) == 0.0
    # One length of a distance has a third of three coordinates.
    alone = _beyond_noise(30, float(np.sqrt(held_out)), 1.0, predicted, noise, np.inf)
    assert alone == pytest.approx(3.0 * lack**2)
    assert beyond(np.nan, 0.0, rows=0) == 0.0


#: Kinds of results; those that take longest are slow.
SLOW = {"auto", "non_geometric", "with_outliers"}
KINDS = [
    pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW))
    for name in sorted(set(CASES) - {"many_rows", "do_not_use"})
]


@pytest.mark.parametrize("case", KINDS)
def test_every_kind_of_result_has_errors_to_expect(case: str):
    result = made(case)
    q = random_joint_values(result.nominal, 4, 1)
    for tool in (TOOL, result.setup.targets[0]):
        for frame in (None, result.setup.groups[0]):
            found = expected_errors(pair_of(result, tool=tool, frame=frame), q)
            assert found.errors.shape == (4, 2)
            assert (found.errors >= 0.0).all()
            low, high = found.band
            assert low <= found.mean <= high
            added = squares(found)
            assert min(added.values()) >= 0.0
            if frame is not None and result.rows.tells_place:
                assert added["base"] == 0.0
                assert found.in_measured_frame is None
            if isinstance(tool, str):
                assert added["tool"] == 0.0


@pytest.fixture(scope="module")
def estimated(ur3: Robot) -> Calibration:
    """Points in a frame that is estimated, the noise stated."""
    q = random_joint_values(ur3, 25, 4)
    rng = np.random.default_rng(5)
    poses = off(ur3, model="dh").poses(q)
    points = poses[:, :3, 3] + poses[:, :3, :3] @ [0.05, 0.04, 0.03]
    table = Measurements(ur3.joint_names, q, points + 5e-5 * rng.normal(size=points.shape))
    cell = Cell(estimate_frame=True, sigma={"m": 5e-5}, model="dh", scale_certified=True)
    return calibrate(ur3, table, cell=cell)


def test_the_frame_of_the_program_counts(estimated: Calibration):
    q = random_joint_values(estimated.nominal, 20, 8)
    in_base = expected_errors(pair_of(estimated, tool=TOOL), q)
    in_frame = expected_errors(pair_of(estimated, tool=TOOL, frame=""), q)
    at_target = expected_errors(pair_of(estimated, tool="", frame=""), q)
    assert in_base.largest == "base"
    assert in_base.in_measured_frame == pytest.approx(in_frame.mean, rel=1e-9)
    assert in_frame.in_measured_frame is None
    assert in_base.mean > in_frame.mean > at_target.mean
    assert in_frame.largest == "tool"
    for one in (in_base, in_frame, at_target):
        assert one.noise == "stated"
        assert one.validated
    shared = ("model", "parameters")
    assert [squares(in_base)[name] for name in shared] == [
        squares(in_frame)[name] for name in shared
    ]


def test_a_scale_that_nobody_knows_is_a_source_of_its_own(estimated: Calibration):
    """Of poses far from the base it is the largest; where the scale is certified it is none."""
    q = random_joint_values(estimated.nominal, 20, 8)
    certain = expected_errors(pair_of(estimated, tool="", frame=""), q)
    cell = replace(estimated.fit.cell, scale_certified=False)
    unknown = calibrate(estimated.nominal, estimated.fit.measurements, cell=cell)
    found = expected_errors(pair_of(unknown, tool="", frame=""), q)
    assert squares(certain)["scale"] == 0.0
    assert found.largest == "scale"
    for source in ("model", "parameters", "poses"):
        assert squares(found)[source] == pytest.approx(squares(certain)[source], rel=1e-6)
    points = unknown.predict(q) - unknown.T_frame_base[:3, 3]
    reach = np.sqrt(np.mean(np.sum(points**2, axis=1)))
    expected = 1e3 * unknown.geometry.scale.size * reach
    assert np.sqrt(squares(found)["scale"]) == pytest.approx(expected, rel=0.3)


@pytest.mark.parametrize("factor", [100.0, 0.01])
def test_a_stated_noise_that_the_residuals_contradict_is_not_believed(
    estimated: Calibration, factor: float
):
    q = random_joint_values(estimated.nominal, 20, 8)
    stated = with_part(estimated, "noise", sigma_given={"m": factor * 5e-5})
    nothing = with_part(estimated, "noise", sigma_given={})
    found = expected_errors(pair_of(stated, tool="", frame=""), q)
    assert found.noise == ("unknown" if factor > 1.0 else "stated")
    expected = squares(expected_errors(pair_of(nothing, tool="", frame=""), q))
    assert squares(found) == pytest.approx(expected, rel=0.2)


def test_noise_that_is_not_stated_counts_as_error(estimated: Calibration):
    q = random_joint_values(estimated.nominal, 20, 8)

    def of(result: Calibration) -> ExpectedErrors:
        return expected_errors(pair_of(result, tool="", frame=""), q)

    assert squares(of(estimated))["model"] == 0.0
    unknown = of(with_part(estimated, "noise", sigma_given={}))
    held_out = estimated.cross_validation.errors_without_outliers["m"].rms
    added = squares(unknown)
    assert unknown.noise == "unknown"
    assert added["model"] + added["parameters"] == pytest.approx(1e6 * held_out**2, rel=0.2)
    scatter = Repeats({"m": 5e-5}, {"m": 40.0}, 0.0)
    repeated = of(with_part(estimated, "noise", sigma_given={}, repeats=scatter))
    assert (repeated.noise, squares(repeated)["model"]) == ("repeats", 0.0)
    few = of(
        with_part(estimated, "noise", sigma_given={}, repeats=replace(scatter, freedoms={"m": 3.0}))
    )
    assert few.noise == "unknown"
    alone = of(with_part(estimated, "geometry", cross_validation=None))
    assert not alone.validated
    assert squares(alone)["model"] == 0.0


def test_each_model_has_its_errors(ur3: Robot):
    truth = draw_truth(ur3, "zeros+gain", {"zero": 3e-3, "gain": 2e-3}, 1)
    q, where = random_joint_values(ur3, 20, 4), random_joint_values(ur3, 20, 8)
    points = truth.points(q) + 5e-5 * np.random.default_rng(5).normal(size=(20, 3))
    cell = Cell(sigma={"m": 5e-5}, model="zeros+gain")
    result = calibrate(ur3, Measurements(ur3.joint_names, q, points), cell=cell)
    pairs = [
        pair_of(result, tool="", frame="", non_geometric=non_geometric)
        for non_geometric in (True, False)
    ]
    non_geometric, geometry = (expected_errors(pair, where) for pair in pairs)
    assert non_geometric.largest == "parameters"
    assert squares(non_geometric)["model"] == 0.0
    # The gains are what the geometry lacks: where the true robot goes tells how much.
    assert geometry.largest == "model"
    away = truth.tip_poses(where) @ truth.T_tip_target[0] - pairs[1].actual.poses(where)
    true = float(np.linalg.norm(away[:, :3, 3], axis=1).mean())
    assert geometry.mean == pytest.approx(true, rel=0.3)
    assert non_geometric.mean < 0.1 * true


@pytest.mark.slow
@pytest.mark.parametrize("known", [True, False])
def test_true_errors_are_those_expected_over_many_robots(ur3: Robot, known: bool):
    """Errors drawn from the priors, the first joint anywhere on its base: in the base, and in the measurement frame."""
    priors = Priors("given", length=3e-4, angle=2e-3, zero=3e-3)
    model = error_model(ur3, "dh", target=False)
    prior_std = np.array(
        [{"length": 3e-4, "angle": 2e-3, "zero": 3e-3}[p.family] for p in model.parameters]
    )
    base_sizes = np.array([3e-4, 3e-4, 0.0, 2e-3, 2e-3, 0.0]) * (not known)
    q, where = random_joint_values(ur3, 20, 1), random_joint_values(ur3, 40, 2)
    tool = np.eye(4)
    tool[:3, 3] = TOOL
    true, expected = np.zeros(2), np.zeros(2)
    rng = np.random.default_rng(3)
    for _ in range(40):
        robot = model.apply(ur3, prior_std * rng.normal(size=len(model)))
        placements = robot.placements.copy()
        displaced = pin.exp6(base_sizes * rng.normal(size=6)).homogeneous
        placements[0] = (
            ur3.placements[0] @ displaced @ np.linalg.inv(ur3.placements[0]) @ placements[0]
        )
        robot = robot.with_placements(placements)
        poses = robot.poses(q)
        points = poses[:, :3, 3] + poses[:, :3, :3] @ [0.05, 0.04, 0.03]
        table = Measurements(ur3.joint_names, q, points + 5e-5 * rng.normal(size=points.shape))
        cell = Cell(estimate_frame=not known, sigma={"m": 5e-5}, model="dh", priors=priors)
        result = calibrate(ur3, table, cell=cell, validate=False)
        arrived, wanted = robot.poses(where) @ tool, result.robot.poses(where) @ tool
        for k, (frame, T) in enumerate(((None, np.eye(4)), ("", result.T_frame_base))):
            missed = (arrived - T @ wanted)[:, :3, 3]
            true[k] += np.linalg.norm(missed, axis=1).mean()
            expected[k] += expected_errors(pair_of(result, tool=tool, frame=frame), where).mean
    assert expected == pytest.approx(true, rel=0.2)
    assert known or expected[0] > 1.5 * expected[1]
