"""Many rows are taken part by part and block by block; what comes out must be the same."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.kinds import get
from calib.data.measurements import Measurements
from calib.fit.estimate import problem
from calib.fit.registration.rows import NONE, Rows
from calib.model.kinematics import Kinematics, Samples
from calib.model.parameter_sets import error_model
from calib.numerics.likelihood import GaussianPriors
from calib.result.calibrate import calibrate
from calib.robot import kernel

#: Numbers of kinds in the registry.
ALL_KINDS = tuple(map(get, ("point", "pose", "distance", "pair", "fixed", "plane")))
POINT, POSE, DISTANCE, PAIR, FIXED, PLANE = range(6)

COUNT = 1700


def rows_of_kinds(robot, kinds, seed=0, count=260) -> tuple[Kinematics, Rows]:
    """Rows of some kinds in two frames with two targets, each a little off."""
    rng = np.random.default_rng(seed)
    model = error_model(
        robot,
        "dh+gain+compliance+gravity",
        frame={"a": ("x", "y", "z", "rx", "ry", "rz"), "b": ("z", "rx")},
        target=("left", "right"),
        targets=("left", "right"),
        rotation=POSE in kinds,
    )
    frames, targets = np.tile(np.eye(4), (2, 1, 1)), np.tile(np.eye(4), (2, 1, 1))
    frames[1, :3, 3], targets[1, :3, 3] = (0.1, 0.2, 0.3), (0.05, 0.02, 0.1)
    kinematics = Kinematics(robot, model, frames, targets)
    of = rng.choice([k for k in kinds if k != PAIR] or [NONE], count)
    partner = np.full(count, -1)
    if PAIR in kinds:
        last = count // 6 * 2 if len(kinds) > 1 else count
        of[:last], of[1:last:2] = PAIR, NONE
        partner[:last:2] = np.arange(1, last, 2)
    samples = Samples(
        rng.uniform(-3.0, 3.0, (count, 6)),
        rng.integers(0, 2, count),
        rng.integers(0, 2, count),
        rng.normal(0.0, 20.0, (count, 6, 9)),
    )
    T = kinematics.poses(np.zeros(len(model)), samples)
    points = T[:, :3, 3] + rng.normal(0.0, 1e-3, (count, 3))
    turned = Rotation.from_rotvec(rng.normal(0.0, 0.01, (count, 3))).as_matrix()
    measured = np.hstack([points, (T[:, :3, :3] @ turned).reshape(-1, 9)])
    lengths = np.isin(of, (DISTANCE, PAIR))
    measured[lengths, 0] = rng.uniform(0.3, 0.6, np.sum(lengths))
    return kinematics, Rows(
        samples,
        ALL_KINDS,
        of,
        measured,
        partner,
        {"m": rng.uniform(0.5e-4, 2e-4, count), "rad": rng.uniform(0.5e-3, 2e-3, count)},
        np.arange(count),
        np.where(partner >= 0, partner, np.arange(count)),
    )


KINDS = {
    "point": (POINT,),
    "pose": (POSE,),
    "distance": (DISTANCE,),
    "pair": (PAIR,),
    "fixed": (FIXED,),
    "plane": (PLANE,),
    "all": (POINT, POSE, DISTANCE, PAIR, FIXED, PLANE),
}


@pytest.fixture(scope="module")
def table(ur3) -> Measurements:
    """Points with outliers, repeats, validation rows, and a few rows seen from a second set-up."""
    rng = np.random.default_rng(7)
    model = error_model(ur3, "dh", target=True)
    T = np.eye(4)
    T[:3, 3] = (0.05, 0.02, 0.03)
    x = rng.normal(size=len(model)) * np.where(np.array(model.units) == "m", 3e-4, 3e-3)
    q = rng.uniform(-2.8, 2.8, (COUNT, 6))
    q[100:200] = q[:100]
    points = Kinematics(ur3, model, np.eye(4), T).points(x, q) + rng.normal(0.0, 5e-5, (COUNT, 3))
    points[::90] += rng.normal(0.0, 5e-3, points[::90].shape)
    sets = ["validate" if i % 50 == 7 else "estimate" for i in range(COUNT)]
    return Measurements(joint_names=ur3.joint_names, joints=q, points=points, sets=tuple(sets))


@pytest.mark.slow
def test_parts_and_blocks_do_not_matter(ur3, table, monkeypatch):
    whole = calibrate(ur3, table, model="dh")
    monkeypatch.setattr(kernel, "BLOCK", 100)
    parts = calibrate(ur3, table, model="dh")
    std = np.sqrt(np.diag(whole.covariance))
    np.testing.assert_allclose(parts.geometry.x, whole.geometry.x, atol=1e-6 * std.min())
    np.testing.assert_allclose(parts.rows.scores, whole.rows.scores, rtol=1e-6)
    assert parts.cross_validation.errors["m"].rms == pytest.approx(
        whole.cross_validation.errors["m"].rms, rel=1e-9
    )
    assert parts.verdict.use == whole.verdict.use
    assert [r.why for r in parts.verdict.reasons] == [r.why for r in whole.verdict.reasons]


@pytest.mark.parametrize("most_kept", [0, 10**9])
@pytest.mark.parametrize("kind", KINDS)
def test_the_linearised_problem_in_parts(ur3, kind, most_kept, monkeypatch):
    kinematics, rows = rows_of_kinds(ur3, KINDS[kind])
    x = np.random.default_rng(3).normal(0.0, 1e-4, len(kinematics.model))
    whole = problem.Problem.initial(kinematics, rows).linear(x)
    weights = np.random.default_rng(4).uniform(size=(2, len(rows)))
    rho = np.zeros((len(whole.smallest_noise), 2))
    data, noise = (
        whole.normal_equations(weights, rho),
        np.tile(1.0 + np.arange(len(whole.smallest_noise)), (2, 1)),
    )
    covariance, both = np.linalg.inv(data.H.sum(axis=1) + np.eye(len(x))), np.stack([x, 0.9 * x])
    scores = whole.scores(both, covariance, weights, noise)
    monkeypatch.setattr(kernel, "BLOCK", 31)
    monkeypatch.setattr(problem, "_MOST_KEPT", most_kept)
    parts = problem.Problem.initial(kinematics, rows).linear(x)
    if not np.any(rows.partner >= 0):
        assert isinstance(parts.columns, np.ndarray) == (most_kept > 0)
    every = slice(0, len(rows))
    np.testing.assert_allclose(parts.columns_of(every), whole.columns, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(parts.residual(both), whole.residual(both), rtol=1e-9, atol=1e-6)
    some = np.random.default_rng(5).uniform(size=len(rows)) < 0.5
    np.testing.assert_allclose(
        parts.select(some).columns, whole.select(some).columns, rtol=1e-9, atol=1e-6
    )
    again = parts.normal_equations(weights, rho)
    np.testing.assert_allclose(again.H, data.H, rtol=1e-9, atol=1e-9 * np.abs(data.H).max())
    np.testing.assert_allclose(again.count, data.count)
    np.testing.assert_allclose(parts.scores(both, covariance, weights, noise), scores, rtol=1e-6)


@pytest.mark.parametrize("factor", [1.0, 3.0])
def test_a_fit_without_priors_spends_a_scalar_for_each_parameter(ur3, factor):
    """Whatever the noise, which its covariance grows with."""
    kinematics, rows = rows_of_kinds(ur3, KINDS["pose"])
    p = len(kinematics.model)
    linear = problem.Problem.initial(kinematics, rows).linear(np.zeros(p))
    channels = len(linear.smallest_noise)
    rho, noise = np.zeros((channels, 2)), np.full((1, channels), factor)
    # Loads and gains are far from one unit each: a prior of a millionth of what the rows tell.
    equations = linear.normal_equations(np.ones((1, len(rows))), rho)
    precision = 1e-6 * np.diag(equations.H.sum(axis=(0, 1))) / factor**2
    priors = GaussianPriors(precision, np.zeros(p))
    _, covariance, freedom = linear.fit(np.ones((1, len(rows))), rho, noise, priors)
    spent_on_priors = float(np.sum(precision * np.diag(covariance[0])))
    assert freedom[0] == pytest.approx(6.0 * len(rows) - p + spent_on_priors)
    assert spent_on_priors < 0.2 * p
