from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.identify.linear import Linear
from calib.identify.passes import Passes
from calib.identify.problem import Problem
from calib.identify.roots import compressed, smallest_eigenvalue, triangle_of, upper_root
from calib.identify.rows import NONE, Rows
from calib.identify.streamed import Streamed, linearised, whole_groups
from calib.model import batch
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics, Samples

#: Numbers of kinds in the registry.
DISTANCE, FIXED, PAIR, PLANE, POINT, POSE = 2, 4, 3, 5, 0, 1

COUNT = 260


def rows_of_kinds(robot, kinds, seed=0, count=COUNT) -> tuple[Kinematics, Rows]:
    """Rows of some kinds in two frames with two targets, each a little off."""
    rng = np.random.default_rng(seed)
    model = error_model(
        robot,
        "dh+gain+compliance",
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
        rng.normal(0.0, 20.0, (count, 6)),
    )
    T = kinematics.poses(np.zeros(len(model)), samples)
    points = T[:, :3, 3] + rng.normal(0.0, 1e-3, (count, 3))
    turned = Rotation.from_rotvec(rng.normal(0.0, 0.01, (count, 3))).as_matrix()
    measured = np.hstack([points, (T[:, :3, :3] @ turned).reshape(-1, 9)])
    lengths = np.isin(of, (DISTANCE, PAIR))
    measured[lengths, 0] = rng.uniform(0.3, 0.6, np.sum(lengths))
    return kinematics, Rows(
        samples,
        of,
        measured,
        partner,
        rng.uniform(0.5e-4, 2e-4, count),
        rng.uniform(0.5e-3, 2e-3, count),
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


@pytest.fixture(params=KINDS)
def both(request, ur3):
    """The linearised problem with its derivative, and without, and weights, noise and priors."""
    kinematics, rows = rows_of_kinds(ur3, KINDS[request.param])
    rng = np.random.default_rng(1)
    p = len(kinematics.model)
    x = rng.normal(0.0, 1e-3, p)
    problem = Problem.first(kinematics, rows)
    dense = Linear.at(problem, x)
    streamed = Streamed.at(replace(problem, passes=Passes.of(kinematics, rows)), x)
    weights = rng.uniform(0.0, 1.0, COUNT) * (rng.uniform(size=COUNT) > 0.1)
    noise = tuple(rng.uniform(0.5, 2.0, len(dense.smallest)))
    return dense, streamed, x, weights, noise, np.full(p, 1e6), np.zeros(p)


def test_residuals_of_every_kind(both):
    dense, streamed, x, *_ = both
    scales = streamed.passes.rows.scales
    residual = streamed.passes.residual(x) / scales
    np.testing.assert_allclose(residual, dense.y - dense.A @ x, atol=1e-9)
    np.testing.assert_allclose(streamed.residual(x), dense.residual(x), atol=1e-9)
    np.testing.assert_allclose(streamed.residual(0.5 * x), dense.residual(0.5 * x), atol=1e-8)


def test_normal_equations_of_every_kind(both):
    dense, streamed, _, weights, *_ = both
    expected, found = dense.data(weights), streamed.data(weights)
    scale = np.abs(expected.H).max()
    np.testing.assert_allclose(found.H, expected.H, atol=1e-12 * scale)
    np.testing.assert_allclose(found.g, expected.g, atol=1e-12 * np.abs(expected.g).max())
    np.testing.assert_allclose(found.yy, expected.yy, rtol=1e-10)
    np.testing.assert_allclose(found.count, expected.count, rtol=1e-12)
    np.testing.assert_allclose(streamed.smallest, dense.smallest)


def test_scores_of_every_kind(both):
    dense, streamed, _, weights, noise, precision, centre = both
    left, covariance, freedom = dense.fit(weights, noise, precision, centre)
    at, *of_streamed = streamed.fit(weights, noise, precision, centre)
    np.testing.assert_allclose(
        of_streamed[0], covariance, atol=1e-8 * np.abs(covariance).max(), rtol=0.0
    )
    assert of_streamed[1] == pytest.approx(freedom, rel=1e-8)
    expected = dense.scores(left, covariance, weights, noise)
    found = streamed.scores(at, covariance, weights, noise)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)
    for c in range(len(noise)):
        one = dense.norms(left, covariance, weights, noise[c], c)
        np.testing.assert_allclose(
            streamed.norms(at, covariance, weights, noise[c], c), one, rtol=1e-6, atol=1e-6
        )


def test_a_few_numbers_stand_for_all_rows(both):
    dense, streamed, x, weights, noise, precision, _ = both
    passes = streamed.passes
    scales = dense.noise_of(noise) * passes.rows.scales
    assert passes.noise_of(scales) == pytest.approx(noise)
    data, r0 = dense.data(weights), dense.residual(x)
    H = np.tensordot(1.0 / np.square(noise), data.H, 1)
    slope = np.tensordot(1.0 / np.square(noise), data.g - data.H @ x, 1)
    r, J = passes.system(x, weights, scales, precision)
    assert r.shape == (len(x) + 1,)
    np.testing.assert_allclose(J.T @ J, H, atol=1e-11 * np.abs(H).max())
    np.testing.assert_allclose(-J.T @ r, slope, atol=1e-10 * np.abs(slope).max())
    square = np.sum(weights @ np.where(dense.used, r0 / dense.noise_of(noise), 0.0) ** 2)
    assert float(r @ r) == pytest.approx(square, rel=1e-9)
    triangle = passes.triangle(x, np.sqrt(weights), noise)
    np.testing.assert_allclose(
        triangle[:, :-1].T @ triangle[:, :-1], H, atol=1e-11 * np.abs(H).max()
    )


def test_directions_that_hardly_matter_are_kept_by_qr(ur3):
    """Without priors, and with two targets that a frame cannot be told from, the normal matrix is singular."""
    kinematics, rows = rows_of_kinds(ur3, (POINT,))
    passes, p = Passes.of(kinematics, rows), len(kinematics.model)
    _, by_qr = passes.system(np.zeros(p), np.ones(COUNT), rows.scales, np.zeros(p))
    problem = Problem.first(kinematics, rows)
    _, J = problem.system(np.zeros(p))
    expected = np.linalg.svd(J, compute_uv=False)
    found = np.linalg.svd(by_qr, compute_uv=False)
    # Ten digits, and not the eight that a normal matrix leaves.
    np.testing.assert_allclose(found, expected, atol=1e-12 * expected[0])


def test_the_result_does_not_depend_on_the_number_of_threads(ur3, monkeypatch):
    monkeypatch.setattr(batch, "CHUNK", 32)
    kinematics, rows = rows_of_kinds(ur3, KINDS["all"])
    x = np.full(len(kinematics.model), 1e-3)
    found = []
    for threads in ("1", "4"):
        monkeypatch.setenv("OMP_NUM_THREADS", threads)
        found.append(Passes.of(kinematics, rows).normal(x, np.ones(COUNT)))
    np.testing.assert_array_equal(found[0], found[1])


def test_normal_matrices_are_remembered_for_the_same_weights_only(ur3):
    kinematics, rows = rows_of_kinds(ur3, (POINT,))
    passes, x = Passes.of(kinematics, rows), np.zeros(len(kinematics.model))
    ones = np.ones(COUNT)
    first = passes.normal(x, ones)
    assert passes.normal(x, ones.copy()) is first
    assert passes.normal(x, 0.5 * ones)[0, 0, 0] == pytest.approx(0.5 * first[0, 0, 0])
    assert not np.array_equal(passes.normal(x + 1e-3, ones), first)


def test_parts_of_whole_groups_add_up(ur3, monkeypatch):
    monkeypatch.setattr("calib.identify.streamed.CHUNK", 40)
    kinematics, rows = rows_of_kinds(ur3, KINDS["all"])
    problem = Problem.first(kinematics, rows)
    x, weights = np.full(len(kinematics.model), 1e-3), np.linspace(0.0, 1.0, COUNT)
    groups = np.arange(COUNT) // 7
    many = replace(problem, passes=Passes.of(kinematics, rows))
    parts = list(whole_groups(many, linearised(many, x), x, groups))
    assert len(parts) > 3
    chosen = np.concatenate([own for own, _ in parts])
    np.testing.assert_array_equal(np.sort(chosen), np.arange(COUNT))
    for own, _ in parts:  # no group is torn apart
        assert set(groups[own]).isdisjoint(groups[np.setdiff1d(np.arange(COUNT), own)])
    expected = Linear.at(problem, x).data(weights)
    H = np.sum([part.data(weights[own]).H for own, part in parts], axis=0)
    np.testing.assert_allclose(H, expected.H, atol=1e-12 * np.abs(expected.H).max())
    whole = list(whole_groups(problem, linearised(problem, x), x, groups))
    assert len(whole) == 1


def test_square_roots_of_normal_matrices():
    rng = np.random.default_rng(0)
    A = rng.normal(size=(30, 6)) * np.logspace(0, 6, 6)
    for H in (A.T @ A, np.zeros((6, 6)), np.outer(A[0], A[0])):
        R = compressed(H)
        np.testing.assert_allclose(R.T @ R, H, atol=1e-13 * max(np.abs(H).max(), 1e-300))
    np.testing.assert_allclose(
        triangle_of(A).T @ triangle_of(A), A.T @ A, atol=1e-12 * (A.T @ A).max()
    )
    assert triangle_of(A[:2]).shape == (6, 6)
    assert not triangle_of(A[:0]).any()
    C = np.cov(rng.normal(size=(6, 40)))
    T = upper_root(C)
    np.testing.assert_allclose(T.T @ T, C, atol=1e-14)
    np.testing.assert_array_equal(T, np.triu(T))
    assert smallest_eigenvalue(np.diag([1.0, 1e-8])) == pytest.approx(1.0)
    assert smallest_eigenvalue(np.ones((2, 2))) == pytest.approx(0.0, abs=1e-15)
