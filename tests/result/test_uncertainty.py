"""Bootstrap and profile against the covariance, against known truth, and where the covariance is wrong."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.special import fdtri, stdtrit

from calib.calibration import Calibration, calibrate
from calib.data.cell import Cell, GroupDistance, Priors
from calib.data.measurements import Measurements
from calib.errors import CalibError, ModelError
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics
from calib.result.prediction import correlations
from calib.result.uncertainty import (
    Bootstrap,
    bootstrap,
    profile_interval,
    workspace_uncertainty,
)
from calib.robot.readback import random_joint_values, spread_poses
from calib.robot.robot import Robot

TARGET = np.array([0.05, -0.06, 0.04])
NOISE = 1e-4


def truth(robot: Robot, model: str, seed: int) -> tuple[Kinematics, np.ndarray]:
    """A robot with errors of a model, seen at a target from its base, and these errors."""
    T_tip_target = np.eye(4)
    T_tip_target[:3, 3] = TARGET
    kinematics = Kinematics(robot, error_model(robot, model), np.eye(4), T_tip_target)
    length = np.array(kinematics.model.units) == "m"
    x = np.random.default_rng(seed).normal(size=len(length)) * np.where(length, 2e-4, 3e-3)
    x[-3:] = 0.0
    return kinematics, x


def measured(
    robot: Robot, model: str, poses: int, seed: int, *, repeats: int = 1, noise=NOISE
) -> Measurements:
    """A tracker's table of such a robot; rows of one pose share their error."""
    kinematics, x = truth(robot, model, seed)
    q = random_joint_values(robot, poses, seed)
    points = kinematics.points(x, q) + noise * np.random.default_rng(seed).normal(size=(poses, 3))
    return Measurements(robot.joint_names, np.repeat(q, repeats, 0), np.repeat(points, repeats, 0))


def fitted(robot: Robot, table: Measurements, model: str, **cell) -> Calibration:
    return calibrate(robot, table, cell=Cell(model=model, **cell), validate=False)


@pytest.fixture(scope="module")
def of_dh(ur3: Robot) -> Calibration:
    return fitted(ur3, measured(ur3, "dh", 80, 1), "dh")


@pytest.fixture(scope="module")
def drawn_of_dh(of_dh: Calibration) -> Bootstrap:
    return bootstrap(of_dh, 500, 1)


@pytest.fixture(scope="module")
def of_zeros(ur3: Robot) -> Calibration:
    return fitted(ur3, measured(ur3, "zeros", 30, 2), "zeros")


@pytest.fixture(scope="module")
def of_target(ur3: Robot) -> Calibration:
    """Known frame, no error of the robot: the target alone, in which the prediction is linear."""
    return fitted(ur3, measured(ur3, "frames", 12, 3), "frames")


def scene_of(kind: str, make_scene, join) -> tuple[Any, Measurements, Cell]:
    """A scene with known errors and noise of 0.1 mm, its table, and the cell that says what is known of it."""
    places = [np.eye(4) for _ in range(3)]
    for T, shift in zip(
        places, [(-0.3, -0.1, -0.3), (0.3, -0.2, -0.4), (-0.1, 0.3, -0.5)], strict=True
    ):
        T[:3, 3] = shift
    T_tip_target = np.eye(4)
    T_tip_target[:3, 3] = TARGET
    known = {"target": TARGET, "estimate_target": False}

    def scene(model: str, frames, targets=(T_tip_target,)):
        sizes = {"length": 3e-4, "angle": 3e-3, "noise": NOISE, "noise_angle": 1e-3}
        return make_scene(1, frames=frames, targets=targets, model=model, **sizes)

    if kind == "poses":
        one = scene("dh", places[:1])
        return one, one.poses(60), Cell(model="dh", estimate_frame=True)
    if kind == "two targets":
        other = T_tip_target.copy()
        other[:3, 3] = [-0.1, 0.06, 0.08]
        one = scene("dh", places[:2], (T_tip_target, other))
        tables = [one.points(50), one.points(50, 1, 1), one.points(20, 0, 1)]
        return one, join(*tables), Cell(model="dh", estimate_frame=True)
    if kind == "planes":
        turns = Rotation.from_rotvec([[0.0, 0.0, 0.0], [1.2, 0.1, 0.0], [-0.9, 0.8, 0.0]])
        for T, turn, shift in zip(
            places, turns.as_matrix(), [(0, 0, -0.2), (0, 0.1, -0.25), (0.1, 0, -0.2)], strict=True
        ):
            T[:3, :3], T[:3, 3] = turn, shift
        one = scene("zeros", places)
        return one, join(*(one.plane(40, k) for k in range(3))), Cell(model="zeros", **known)
    if kind == "sockets":
        one = scene("zeros", places)
        return one, join(*(one.fixed(25, k) for k in range(3))), Cell(model="zeros", **known)
    if kind == "distances":
        one = scene("zeros", places[:1])
        return one, one.distances(150), Cell(model="zeros", **known)
    one = scene("zeros", [np.eye(4)])
    return one, one.pairs(100), Cell(model="zeros", **known)


class TestBootstrap:
    def test_with_normal_noise_it_finds_the_covariance(
        self, of_dh: Calibration, drawn_of_dh: Bootstrap
    ):
        found = drawn_of_dh
        ratio = found.std / np.sqrt(np.diag(of_dh.covariance))
        # Known to the data or to the priors alone (d2 and d3 of parallel axes): for all of them.
        assert not all(p.identifiable for p in of_dh.parameters)
        assert np.mean(ratio) == pytest.approx(1.0, abs=0.06)
        assert 0.75 < ratio.min() < ratio.max() < 1.33
        assert found.measured_rms == pytest.approx(of_dh.expected_measured, rel=0.1)
        assert found.everywhere_rms == pytest.approx(of_dh.expected_everywhere, rel=0.1)
        assert found.stopped == 0
        q = spread_poses(of_dh.nominal, 50)
        ratio = found.position_std(of_dh.samples(q)) / of_dh.position_std(q)
        assert np.mean(ratio) == pytest.approx(1.0, abs=0.1)

    def test_its_correlations_are_the_covariances(self, of_dh: Calibration, drawn_of_dh: Bootstrap):
        found = np.corrcoef(drawn_of_dh.x.T)
        std = np.sqrt(np.diag(of_dh.covariance))
        expected = of_dh.covariance / np.outer(std, std)
        assert np.mean(np.abs(found - expected)) < 0.06
        assert np.corrcoef(found.ravel(), expected.ravel())[0, 1] > 0.93

    @pytest.mark.slow
    def test_intervals_hold_the_truth(self, ur3: Robot):
        """Monte Carlo: 20 robots; parameters that the data know, and points on unseen poses."""
        q, inside, inside_points = spread_poses(ur3, 20), [], []
        for seed in range(20):
            kinematics, x = truth(ur3, "zeros", seed)
            result = fitted(ur3, measured(ur3, "zeros", 40, seed), "zeros")
            found = bootstrap(result, 80, seed)
            low, high = found.intervals().T
            known = [p.identifiable for p in result.parameters]
            assert sum(known) >= 5
            right = x + np.append(np.zeros(len(x) - 3), TARGET)
            inside.append(((low < right) & (right < high))[known])
            ends = np.quantile(found.positions(q), (0.025, 0.975), axis=0)
            points = kinematics.points(x, q)
            inside_points.append((ends[0] < points) & (points < ends[1]))
        assert 0.90 < np.mean(np.concatenate(inside)) < 0.985
        assert 0.90 < np.mean(inside_points) < 0.985

    @pytest.mark.slow
    def test_noise_that_differs_by_direction(self, ur3: Robot):
        """A camera, ten times worse in depth: the covariance, which has one noise, is wrong; the bootstrap is not."""
        noise = np.array([3e-5, 3e-5, 3e-4])
        depth, by_covariance, by_bootstrap = [], [], []
        for seed in range(60):
            table = measured(ur3, "frames", 30, seed, noise=noise)
            cell = Cell(model="frames", estimate_frame=True, target=TARGET, estimate_target=False)
            result = calibrate(ur3, table, cell=cell, robust=False, validate=False)
            depth.append(result.T_frame_base[2, 3])
            k = result.model.index("frame_z")
            by_covariance.append(result.parameters[k].std)
            if seed < 8:
                by_bootstrap.append(bootstrap(result, 100, seed).std[k])
        spread = np.std(depth)
        assert np.mean(by_bootstrap) == pytest.approx(spread, rel=0.25)
        assert np.mean(by_covariance) < 0.7 * spread

    @pytest.mark.slow
    def test_repeats_are_drawn_together(self, ur3: Robot):
        """Three copies of each row, taken for independent: the covariance is a third of the true one."""
        table = measured(ur3, "zeros", 40, 4, repeats=3)
        result = fitted(ur3, table, "zeros", repeats="independent")
        known = [k for k, p in enumerate(result.parameters) if p.identifiable]
        ratio = bootstrap(result, 300, 1).std / np.sqrt(np.diag(result.covariance))
        assert np.mean(ratio[known]) == pytest.approx(np.sqrt(3.0), rel=0.15)

    @pytest.mark.slow
    def test_every_set_up_stays_in_every_sample(self, ur3: Robot):
        """One of two set-ups has four poses: drawn among all, it would be missing from one sample in fifty."""
        kinematics, x = truth(ur3, "frames", 5)
        q = random_joint_values(ur3, 40, 5)
        points = kinematics.points(x, q) + 1e-4 * np.random.default_rng(1).normal(size=(40, 3))
        groups = ("left",) * 36 + ("right",) * 4
        table = Measurements(ur3.joint_names, q, points, groups=groups)
        cell = Cell(
            model="frames",
            estimate_frame=True,
            frame_directions=("x", "y", "z"),
            target=TARGET,
            estimate_target=False,
        )
        result = calibrate(ur3, table, cell=cell, validate=False)
        found = bootstrap(result, 400, 1)
        # Four points' mean: a multinomial draw of 4 in 4 keeps their number.
        names = [n for n in result.model.names if "right" in n]
        assert len(names) == 3, result.model.names
        right = [result.model.index(name) for name in names]
        residual = (table.points - result.predict(q, group="right"))[36:]
        expected = np.std(residual, axis=0) / 2.0
        assert found.std[right] == pytest.approx(expected, rel=0.1)

    def test_outliers_keep_no_weight(self, ur3: Robot):
        table = measured(ur3, "zeros", 40, 6)
        points = table.points.copy()
        points[[3, 17]] += 0.03
        clean, spoilt = (
            fitted(ur3, replace(table, points=p), "zeros") for p in (table.points, points)
        )
        assert len(spoilt.outliers) == 2
        a, b = (bootstrap(c, 100, 1).measured_rms for c in (clean, spoilt))
        assert b < 1.3 * a

    def test_a_parameter_at_its_bound_stays_there(self, ur3: Robot):
        name = "elbow_joint.zero"
        kinematics, x = truth(ur3, "zeros", 2)
        k = kinematics.model.index(name)
        end = 0.5 * float(x[k])
        bounds = {name: (min(end, -1e-2), end) if end > 0 else (end, max(end, 1e-2))}
        result = fitted(ur3, measured(ur3, "zeros", 30, 2), "zeros", bounds=bounds)
        assert result.parameter(name).at_bound
        found = bootstrap(result, 40, 1)
        assert np.ptp(found.x[:, k]) < 1e-9
        assert np.min(np.delete(found.std, k)) > 1e-6
        with pytest.raises(ModelError, match=f"'{name}' stands at its bound, .* rad, where the"):
            profile_interval(result, name)

    @pytest.mark.slow
    def test_without_priors(self, ur3: Robot):
        result = fitted(ur3, measured(ur3, "zeros", 40, 7), "zeros", priors=Priors("off"))
        ratio = bootstrap(result, 200, 1).std / np.sqrt(np.diag(result.covariance))
        known = [k for k, p in enumerate(result.parameters) if p.identifiable]
        assert np.mean(ratio[known]) == pytest.approx(1.0, abs=0.15)

    @pytest.mark.parametrize(
        "kind",
        [
            "sockets",
            *(
                pytest.param(kind, marks=pytest.mark.slow)
                for kind in ("poses", "two targets", "distances", "pairs", "planes")
            ),
        ],
    )
    def test_every_kind_of_row(self, make_scene, join, kind: str):
        """Parameters and, where no row tells the base's place, shapes: as the covariance has them."""
        scene, table, cell = scene_of(kind, make_scene, join)
        result = calibrate(scene.robot, table, cell=cell, validate=False)
        found = bootstrap(result, 100, 1)
        known = [k for k, p in enumerate(result.parameters) if p.identifiable]
        ratio = (found.std / np.sqrt(np.diag(result.covariance)))[known]
        assert np.mean(ratio) == pytest.approx(1.0, abs=0.12)
        assert 0.7 < ratio.min() < ratio.max() < 1.4
        # Beyond the first order an unknown turn of the whole arm leaves a trace.
        assert found.measured_rms == pytest.approx(result.expected_measured, rel=0.2)
        assert found.everywhere_rms == pytest.approx(result.expected_everywhere, rel=0.2)

    @pytest.mark.slow
    def test_known_distances_are_drawn_too(self, make_scene, join):
        """Sockets have their scale from them alone: they are not known better than they were said to be."""
        frames = scene_of("sockets", make_scene, join)[0].kinematics.T_frame_base
        scene = make_scene(39, frames=frames, length=3e-4, angle=3e-3, noise=2e-5)
        at = [-T[:3, :3].T @ T[:3, 3] for T in frames]
        length = float(np.linalg.norm(at[0] - at[1]))
        cell = Cell(model="dh", distances=(GroupDistance("0", "1", length, 1e-4),))
        table = join(*(scene.fixed(40, f) for f in range(3)))
        result = calibrate(scene.robot, table, cell=cell, validate=False)
        found = bootstrap(result, 200, 1)
        for name in ("a2", "a3"):
            ratio = found.std[result.model.index(name)] / result.parameter(name).std
            assert 0.75 < ratio < 1.25

    def test_the_seed_decides_and_progress_is_told(self, of_target: Calibration):
        told: list[tuple[int, int]] = []
        one = bootstrap(of_target, 40, 3, lambda done, every: told.append((done, every)))
        assert told == [(k, 40) for k in range(1, 41)]
        assert np.array_equal(one.x, bootstrap(of_target, 40, 3).x)
        assert not np.array_equal(one.x, bootstrap(of_target, 40, 4).x)
        assert not one.x.flags.writeable

    def test_wider_levels_are_wider(self, of_target: Calibration):
        found = bootstrap(of_target, 400, 3)
        narrow, wide = np.diff(found.intervals(0.5))[:, 0], np.diff(found.intervals(0.95))[:, 0]
        assert wide / narrow == pytest.approx(np.full(3, 1.96 / 0.674), rel=0.2)
        with pytest.raises(CalibError, match="level of an interval is 1; it must lie between"):
            found.intervals(1.0)

    @pytest.mark.parametrize(("count", "seed"), [(39, 1), (10**12, 1), (100, -1)])
    def test_what_cannot_be_drawn_is_refused(self, of_target: Calibration, count: int, seed: int):
        with pytest.raises(CalibError, match=f"bootstrap of {count} samples with seed {seed} was"):
            bootstrap(of_target, count, seed)


class TestProfile:
    @pytest.mark.parametrize("level", [0.5, 0.95])
    def test_of_a_linear_problem_is_student_s(self, of_target: Calibration, level: float):
        reach = stdtrit(of_target.freedom, 0.5 + level / 2.0)
        for p in of_target.parameters:
            found = profile_interval(of_target, p.name, level)
            expected = [p.value - reach * p.std, p.value + reach * p.std]
            assert [found.low, found.high] == pytest.approx(expected, abs=1e-3 * reach * p.std)
            assert found.level == level

    def test_of_small_errors_is_nearly_that(self, of_zeros: Calibration):
        for p in of_zeros.parameters:
            found = profile_interval(of_zeros, p.name)
            assert [found.low, found.high] == pytest.approx([p.low, p.high], abs=0.02 * p.std)

    def test_at_its_ends_the_best_of_the_others_has_risen_by_f(self, of_zeros: Calibration):
        """By SciPy, and not from where calib begins."""
        estimate = of_zeros.fitted.estimate
        k = of_zeros.model.index("wrist_1_joint.zero")
        others = np.arange(len(estimate.x)) != k
        found = profile_interval(of_zeros, "wrist_1_joint.zero", 0.9)

        def squares(value: float) -> float:
            def residual(rest: np.ndarray) -> np.ndarray:
                x = np.full(len(others), value)
                x[others] = rest
                return estimate.problem.system(x)[0]

            return (
                2.0
                * least_squares(
                    residual, estimate.x[others], x_scale=1e-3, xtol=1e-12, ftol=1e-14
                ).cost
            )

        least = squares(estimate.x[k])
        rise = fdtri(1.0, of_zeros.freedom, 0.9)
        for end in (found.low, found.high):
            assert squares(end) - least == pytest.approx(rise, rel=2e-3)

    def test_of_the_only_parameter(self, ur3: Robot):
        names = [f"{joint}.zero" for joint in ur3.joint_names]
        cell = Cell(model="zeros", target=TARGET, estimate_target=False, frozen=tuple(names[1:]))
        result = calibrate(ur3, measured(ur3, "zeros", 12, 3), cell=cell, validate=False)
        (p,) = result.parameters
        found = profile_interval(result, p.name)
        assert [found.low, found.high] == pytest.approx([p.low, p.high], abs=0.02 * p.std)

    def test_of_the_larger_model(self, ur3: Robot):
        result = fitted(ur3, measured(ur3, "zeros", 40, 8), "zeros+gain")
        p = result.parameter("elbow_joint.gain")
        found = profile_interval(result, "elbow_joint.gain")
        assert [found.low, found.high] == pytest.approx([p.low, p.high], abs=0.02 * p.std)

    def test_what_has_none_is_refused(self, of_target: Calibration):
        with pytest.raises(ModelError, match="'frames' has no parameter 'd9'"):
            profile_interval(of_target, "d9")
        with pytest.raises(CalibError, match="level of an interval is 1; it must lie between"):
            profile_interval(of_target, "target_x", 1.0)


class TestWorkspace:
    def test_is_the_predicted_uncertainty_over_the_limits(self, of_dh: Calibration):
        found = workspace_uncertainty(of_dh, 300)
        assert found.q.shape == (300, 6)
        assert np.allclose(found.std, of_dh.position_std(found.q), rtol=1e-12)
        assert found.rms == pytest.approx(of_dh.expected_everywhere, rel=0.1)
        assert np.mean(found.std <= found.quantile_95) == pytest.approx(0.95, abs=0.004)
        assert found.rms < found.quantile_95 < found.max
        limits = np.array([[j.lower, j.upper] for j in of_dh.nominal.inputs])
        assert np.ptp(found.q, axis=0) == pytest.approx(
            np.minimum(np.diff(limits)[:, 0], 2 * np.pi), rel=0.02
        )

    def test_names_the_worst_poses(self, of_dh: Calibration):
        found = workspace_uncertainty(of_dh, 300)
        q, std = found.worst(3)
        assert std[0] == found.max
        assert np.all(np.diff(std) <= 0)
        assert np.allclose(of_dh.position_std(q), std, rtol=1e-12)

    def test_of_the_larger_model_unless_the_geometry_is_wanted(self, ur3: Robot):
        result = fitted(ur3, measured(ur3, "zeros", 40, 8), "zeros+gain", priors=Priors("given"))
        larger, alone = (workspace_uncertainty(result, 50, larger=w) for w in (True, False))
        assert np.allclose(larger.std, result.position_std(larger.q), rtol=1e-12)
        assert np.allclose(alone.std, result.position_std(alone.q, larger=False), rtol=1e-12)
        assert larger.rms > 1.05 * alone.rms

    def test_too_few_joint_values_are_refused(self, of_target: Calibration):
        with pytest.raises(CalibError, match="Over 19 joint values there is no 95 % quantile"):
            workspace_uncertainty(of_target, 19)


class TestCorrelations:
    def test_are_the_covariances_in_falling_order(self, of_dh: Calibration):
        pairs = correlations(of_dh, 0.0)
        known = [p.name for p in of_dh.parameters if p.identifiable]
        assert len(pairs) == len(known) * (len(known) - 1) // 2
        C = of_dh.covariance
        for first, second, value in pairs[:20]:
            i, j = of_dh.model.index(first), of_dh.model.index(second)
            assert value == pytest.approx(C[i, j] / np.sqrt(C[i, i] * C[j, j]), abs=1e-12)
        sizes = [abs(value) for _, _, value in pairs]
        assert sizes == sorted(sizes, reverse=True)
        assert {name for pair in pairs for name in pair[:2]} == set(known)

    def test_what_is_known_in_combination_only_is_aside(self, of_dh: Calibration):
        C, i, j = of_dh.covariance, of_dh.model.index("d2"), of_dh.model.index("d3")
        assert not of_dh.parameters[i].identifiable
        assert abs(C[i, j]) > 0.3 * np.sqrt(C[i, i] * C[j, j])
        assert not any("d2" in pair for pair in correlations(of_dh, 0.0))

    def test_pairs_worth_naming(self, ur3: Robot):
        """Points in a corner far from the base: a tilt of the frame there is a shift."""
        kinematics, x = truth(ur3, "frames", 3)
        rng = np.random.default_rng(3)
        q = np.array([0.0, -0.6, 0.8, -0.5, 1.0, 0.0]) + rng.uniform(-0.1, 0.1, (30, 6))
        points = kinematics.points(x, q) + 1e-4 * rng.normal(size=(30, 3))
        table = Measurements(ur3.joint_names, q, points)
        cell = Cell(model="frames", estimate_frame=True, target=TARGET, estimate_target=False)
        result = calibrate(ur3, table, cell=cell, validate=False)
        named = {pair[:2] for pair in correlations(result, 0.9)}
        x_at, y_at, _ = np.mean(points, axis=0)
        assert abs(x_at) > 0.3 > abs(y_at)
        # About y the corner rises, about z it moves sideways.
        assert {("frame_z", "frame_ry"), ("frame_y", "frame_rz")} <= named
        assert len(named) < 15


def test_the_papers_solver_has_none_of_it(ur3: Robot, table: Measurements, paper_cell: Cell):
    result = calibrate(ur3, table, cell=paper_cell, solver="paper", validate=False)
    for asked in (
        lambda: bootstrap(result, 100, 1),
        lambda: profile_interval(result, "a2"),
    ):
        with pytest.raises(ModelError, match=r"The solver 'paper' .* Choose"):
            asked()
    assert result.robustness is None
