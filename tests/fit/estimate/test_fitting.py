"""One fit of every kind of measurement against known truth: exact without noise, calibrated with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import stdtrit

from calib.data.cell import Cell, GroupDistance
from calib.errors import MeasurementError, ModelError
from calib.fit.estimate.fitting import _with_new_poses, fit
from calib.model.error_model import Parameter
from calib.model.kinematics import Kinematics
from calib.model.parameter_sets import MODELS, error_model
from calib.numerics.solvers import SOLVERS, Solution
from calib.result.calibrate import calibrate
from calib.robot.ranges import random_joint_values
from tests.fit.estimate.scene_fits import FREE, OFF, errors, fitted, sockets, task_of

KINDS = {
    "point": (lambda s: [s.points(25)], True),
    "pose": (lambda s: [s.poses(15)], True),
    "distance": (lambda s: [s.distances(60)], False),
    "pair": (lambda s: [s.pairs(60)], False),
    "targets": (lambda s: [s.points(12, 0, t) for t in range(3)], True),
    "set-ups": (lambda s: [s.points(12, f) for f in range(3)], True),
    "mixed": (lambda s: [s.points(12), s.poses(6, 1, 1), s.distances(20, 2), s.pairs(8)], True),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(1))
def test_without_noise_unseen_poses_are_exact(make_scene, join, kind, seed):
    tables, placed = KINDS[kind]
    scene = make_scene(seed, frames=3, targets=3)
    found, rows = fitted(scene, join(*tables(scene)), FREE)
    assert np.abs(found.residual(rows)).max() < 1e-8
    assert np.abs(errors(scene, found, placed=placed)).max() < 1e-8
    assert not found.estimate.outliers.any()


@pytest.mark.parametrize("seed", range(1))
def test_without_noise_a_plane_and_an_anchor_are_exact(make_scene, join, seed):
    scene = sockets(make_scene, seed, 2)
    found, _ = fitted(scene, join(scene.plane(40, 0), scene.distances(40, 1)), FREE)
    assert np.abs(errors(scene, found, placed=False)).max() < 1e-8


@pytest.mark.parametrize("seed", range(1))
def test_sockets_have_no_scale_until_a_distance_is_known(make_scene, join, seed):
    scene = sockets(make_scene, seed, 4)
    names = ("a/0", "a/1", "b/0", "b/1")
    table = join(*(scene.fixed(20, k) for k in range(4)))
    table = replace(table, groups=tuple(names[int(g)] for g in table.groups))
    c = [np.linalg.inv(T)[:3, 3] for T in scene.kinematics.T_frame_base]
    known = tuple(
        GroupDistance(names[i], names[j], float(np.linalg.norm(c[i] - c[j])), 1e-6)
        for i, j in ((0, 1), (2, 3), (0, 2))
    )
    alone, _ = fitted(scene, table, Cell())
    with_bar, _ = fitted(scene, table, Cell(distances=known, priors=OFF))
    assert np.abs(errors(scene, alone, placed=False)).max() > 1e-4
    assert np.abs(errors(scene, with_bar, placed=False)).max() < 1e-8


@pytest.mark.slow
def test_the_noise_of_every_channel_is_found(make_scene, join):
    found = []
    for seed in range(12):
        scene = make_scene(seed, frames=2, noise=5e-5, noise_angle=4e-4, length=4e-4, angle=2e-3)
        one, _ = fitted(
            scene, join(scene.poses(30), scene.distances(40, 1)), Cell(estimate_frame=True)
        )
        found.append(one.estimate.noise)
    lengths, distances, angles = np.sqrt(np.mean(np.square(found), axis=0))
    assert (lengths * 1e-4, distances * 1e-4) == pytest.approx((5e-5, 5e-5), rel=0.1)
    assert angles * 1e-3 == pytest.approx(4e-4, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mode", "shared", "own", "ratio"),
    [("weighted", 1e-4, 5e-5, 1.0), ("weighted", 0.0, 1e-4, 1.0), ("average", 1e-4, 1e-5, 1.0)],
)
def test_repeats_leave_the_covariance_right(make_scene, mode, shared, own, ratio):
    """Monte Carlo: four repeats of 25 poses that share a part of their error; error over predicted spread."""
    squares, inside = [], []
    for seed in range(40):
        scene = make_scene(seed, frames=[np.eye(4)], length=4e-4, angle=3e-3)
        rng = np.random.default_rng(1000 + seed)
        once = scene.points(25)
        q = np.repeat(once.joints, 4, axis=0)
        seen = np.repeat(once.points + shared * rng.normal(size=(25, 3)), 4, axis=0)
        table = type(once)(once.joint_names, q, seen + own * rng.normal(size=seen.shape))
        table = replace(table, targets=("t0",) * 100)
        one, _ = fitted(scene, table, Cell(repeats=mode))
        samples = scene.samples(40, q=random_joint_values(scene.robot, 40, 5))
        poses, jacobian = one.kinematics.twists(one.estimate.x, samples, rotation=False)
        spread = np.einsum("nij,jk,nik->ni", jacobian, one.estimate.covariance, jacobian)
        off = poses[:, :3, 3] - scene.kinematics.points(scene.x, samples)
        squares.append(np.sum(off**2) / np.sum(spread))
        reach = stdtrit(one.estimate.freedom, 0.975)
        inside.append(np.abs(off) < reach * np.sqrt(spread))
    assert np.sqrt(np.mean(squares)) == pytest.approx(ratio, abs=0.12)
    assert 0.93 < np.mean(inside) < 0.975


def test_a_target_with_a_prior_or_a_bound_stays_near_where_it_was_said_to_be(make_scene):
    """Not near where the nominal robot registers it, which is 6 mm from there."""
    scene = make_scene(0, frames=[np.eye(4)], noise=1e-4)
    said = scene.kinematics.T_tip_target[0, :3, 3] + [1e-3, 0.0, 0.0]
    table = scene.points(40)
    for options in (
        {"parameter_priors": {"target_x": 1e-6}},
        {"bounds": {"target_x": (-1e-6, 1e-6)}},
    ):
        found, _ = fitted(scene, table, Cell(target=said, **options))
        assert abs(found.estimated_setup().T_tip_target[0, 0, 3] - said[0]) < 2e-6
        assert np.linalg.norm(found.setup.T_tip_target[0, :3, 3] - said) > 3e-3


@pytest.mark.parametrize(
    ("cell", "error", "message"),
    [
        (Cell(ties={"a2": ("target_y", 1.0)}), ModelError, "'target_y' cannot be frozen or tied"),
        (Cell(bounds={"q9": (0.0, 1.0)}), ModelError, "no parameter 'q9'"),
        (Cell(priors=OFF), MeasurementError, "15 numbers for 27 parameters"),
    ],
)
def test_what_cannot_be_estimated_is_refused(make_scene, cell, error, message):
    scene = make_scene(3, frames=[np.eye(4)])
    with pytest.raises(error, match=message):
        fitted(scene, scene.points(5), cell)


def test_unseen_rows_are_judged_by_the_noise_of_their_own_kind(make_scene, join):
    scene = make_scene(6, frames=2, noise=1e-4, noise_angle=5e-4, length=4e-4, angle=2e-3)
    task, rows = task_of(
        scene, join(scene.poses(50), scene.distances(60, 1)), Cell(estimate_frame=True)
    )
    seen = np.arange(len(rows)) % 3 != 0
    found = fit(task, rows.select(seen))
    left = rows.select(~seen)
    scores = found.held_out_scores(left)
    for kind in np.unique(left.kind):
        assert np.median(scores[left.kind == kind]) == pytest.approx(1.54, rel=0.25)
    assert len(found.held_out_scores(rows.select(np.zeros(len(rows), dtype=bool)))) == 0


def test_a_parameter_set_and_a_solver_of_ones_own(ur3, monkeypatch, make_scene):
    """Each is one entry of a registry; what comes out is the same in memory and in the file."""
    calls = []

    def gauss_newton(system, x0, step_size, step_tolerance):
        x, evaluations = x0.copy(), 0
        while True:
            r, J = system(x)
            step = np.linalg.lstsq(J, -r)[0]
            evaluations += 1
            x = x + step
            if np.linalg.norm(step / step_size) <= max(step_tolerance, 1e-8):
                calls.append(evaluations)
                cost = 0.5 * float(r @ r)
                return Solution(x, cost, "converged", "The steps are short.", evaluations, ())

    def shoulder(robot):
        unit = np.eye(6)
        return [
            Parameter("lift", "m", robot.joints[1].name, unit[2], "length"),
            Parameter("lean", "rad", robot.joints[1].name, unit[3], "angle"),
        ]

    monkeypatch.setitem(MODELS, "shoulder", shoulder)
    monkeypatch.setitem(SOLVERS, "gauss-newton", gauss_newton)
    scene = make_scene(5, frames=[np.eye(4)], length=0.0, angle=0.0, noise=2e-5)
    model = error_model(ur3, "shoulder")
    true = np.zeros(len(model))
    true[:2] = 4e-4, 3e-3
    table = scene.points(30)
    T = np.eye(4)
    T[:3, 3] = 0.05, 0.02, 0.1
    points = Kinematics(ur3, model, np.eye(4), T).points(true, table.joints)
    rng = np.random.default_rng(0)
    table = replace(table, points=points + rng.normal(0.0, 2e-5, points.shape))
    found = calibrate(ur3, table, model="shoulder", solver="gauss-newton")
    assert calls
    assert found.model.names == model.names
    assert np.all(
        np.abs(found.geometry.x - true)[:2] < 5.0 * np.sqrt(np.diag(found.covariance))[:2]
    )
    assert found.method.solver == "gauss-newton"
    other = calibrate(ur3, table, model="shoulder")
    np.testing.assert_allclose(found.geometry.x, other.geometry.x, atol=1e-9)


@pytest.mark.parametrize("model", ["dh", "placement"])
def test_what_an_estimated_frame_takes_leaves_no_trace_on_the_first_joint(
    ur3, paper_table, model, monkeypatch
):
    """A turn of the first joint is one of the frame: what the frame's weak prior leaves of it there is nothing."""
    cell = Cell(estimate_frame=True, model=model)
    result = calibrate(ur3, paper_table, cell=cell, validate=False)
    first = ur3.joints[0].name
    own = {"theta1"} if model == "dh" else {f"{first}.rz", f"{first}.ry"}
    assert {p.delta for p in result.parameters if p.name in own} == {0.0}
    turned, joint = (robot.urdf.joint(first) for robot in (result.robot, ur3))
    np.testing.assert_array_equal(turned.rpy, joint.rpy)
    # Without that there is one, and the frame makes up for it.
    monkeypatch.setattr("calib.fit.estimate.estimate._TRACE", 0.0)
    traced = calibrate(ur3, paper_table, cell=cell, validate=False)
    assert any(1e-8 < abs(p.delta) < 1e-7 for p in traced.parameters if p.name in own)
    apart = np.abs(traced.rows.residual_calibrated - result.rows.residual_calibrated).max()
    assert apart < 1e-9


def test_places_that_a_fit_did_not_see_are_those_of_the_held_out_rows(make_scene, join):
    scene = make_scene(1, frames=3, targets=2)
    task, _ = task_of(scene, join(scene.points(5), scene.points(5, 1, 1), scene.points(5, 2)), FREE)
    nothing = np.zeros(2, dtype=bool)
    fitted_setup = task.setup.with_fixed(np.array([False, True, True]), nothing)
    held_out = task.setup.with_fixed(np.array([True, True, False]), np.array([True, False]))
    fitted_setup = replace(fitted_setup, target_unknown=np.array([True, False]))
    T_frame_base = np.tile(2.0 * np.eye(4), (3, 1, 1))
    T_tip_target = np.tile(np.eye(4), (2, 1, 1))
    T_tip_target[:, 0, 3] = 0.7
    both = _with_new_poses(fitted_setup, held_out, held_out.with_poses(T_frame_base, T_tip_target))
    np.testing.assert_array_equal(both.T_frame_base[:2], fitted_setup.T_frame_base[:2])
    np.testing.assert_array_equal(both.T_frame_base[2], T_frame_base[2])
    np.testing.assert_array_equal(both.T_tip_target[0], fitted_setup.T_tip_target[0])
    np.testing.assert_array_equal(both.T_tip_target[1], T_tip_target[1])
    assert [bool(directions) for directions in both.unknown] == [True, False, True]
    assert both.target_unknown.tolist() == [True, True]
