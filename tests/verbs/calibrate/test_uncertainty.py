"""Bootstrap and profile against the covariance, against known truth, and where the covariance is wrong."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.special import fdtri, stdtrit

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import CalibError, ModelError
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.kinematics import Kinematics
from calib.model.parameter_sets import error_model
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.ranges import random_joint_values, spread_poses
from calib.robot.robot import Robot
from calib.verbs.calibrate.uncertainty import (
    Bootstrap,
    _draws,
    _fit_sample,
    bootstrap,
    bootstrap_counts,
    profile,
    profile_interval,
)
from tests.fits import table_of_missed_stops

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
    return calibrate(
        robot, table, cell=Cell(model=model, scale_certified=True, **cell), validate=False
    )


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
        prior_std = {"length": 3e-4, "angle": 3e-3, "noise": NOISE, "noise_angle": 1e-3}
        return make_scene(1, frames=frames, targets=targets, model=model, **prior_std)

    if kind == "poses":
        one = scene("dh", places[:1])
        return one, one.poses(60), Cell(model="dh", estimate_frame=True)
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
        assert found.measured_rms == pytest.approx(of_dh.geometry.expected_measured, rel=0.1)
        assert found.everywhere_rms == pytest.approx(of_dh.geometry.expected_everywhere, rel=0.1)
        assert found.stopped == 0
        q = spread_poses(of_dh.nominal, 50)
        ratio = found.position_std(of_dh.samples(q)) / of_dh.position_std(q)
        assert np.mean(ratio) == pytest.approx(1.0, abs=0.1)

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
        with pytest.raises(ModelError, match=f"'{name}' stands at its bound, .* rad: it has"):
            profile_interval(result, name)

    @pytest.mark.parametrize(
        "kind",
        [
            "sockets",
            *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("poses", "pairs", "planes")),
        ],
    )
    def test_every_kind_of_row(self, make_scene, join, kind: str):
        """Parameters and, where no row tells the base's place, shapes: as the covariance has them."""
        scene, table, cell = scene_of(kind, make_scene, join)
        # No draw of rows tells the scale of the instrument.
        exact = replace(cell, scale_certified=True)
        result = calibrate(scene.robot, table, cell=exact, validate=False)
        found = bootstrap(result, 100, 1)
        known = [k for k, p in enumerate(result.parameters) if p.identifiable]
        ratio = (found.std / np.sqrt(np.diag(result.covariance)))[known]
        assert np.mean(ratio) == pytest.approx(1.0, abs=0.12)
        assert 0.7 < ratio.min() < ratio.max() < 1.4
        # Beyond the first order an unknown turn of the whole arm leaves a trace.
        assert found.measured_rms == pytest.approx(result.geometry.expected_measured, rel=0.2)
        assert found.everywhere_rms == pytest.approx(result.geometry.expected_everywhere, rel=0.2)

    def test_the_seed_decides_and_progress_is_told(self, of_target: Calibration):
        told: list[tuple[int, int]] = []
        one = bootstrap(of_target, 40, 3, lambda done, every: told.append((done, every)))
        assert told == [(k, 40) for k in range(1, 41)]
        assert np.array_equal(one.x, bootstrap(of_target, 40, 3).x)
        assert not np.array_equal(one.x, bootstrap(of_target, 40, 4).x)
        assert not one.x.flags.writeable

    @pytest.mark.parametrize(("count", "seed"), [(39, 1), (10**12, 1), (100, -1)])
    def test_what_cannot_be_drawn_is_refused(self, of_target: Calibration, count: int, seed: int):
        with pytest.raises(CalibError, match=f"bootstrap of {count} samples with seed {seed} was"):
            bootstrap(of_target, count, seed)


class TestProfile:
    @pytest.mark.parametrize("level", [0.5, 0.95])
    def test_of_a_linear_problem_is_student_s(self, of_target: Calibration, level: float):
        reach = stdtrit(of_target.noise.freedom, 0.5 + level / 2.0)
        for p in of_target.parameters:
            found = profile_interval(of_target, p.name, level)
            expected = [p.value - reach * p.std, p.value + reach * p.std]
            assert [found.low, found.high] == pytest.approx(expected, abs=1e-3 * reach * p.std)
            assert found.level == level

    def test_at_its_ends_the_best_of_the_others_has_risen_by_f(self, of_zeros: Calibration):
        """By SciPy, and not from where calib begins."""
        estimate = of_zeros.fit.geometry.estimate
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
        rise = fdtri(1.0, of_zeros.noise.freedom, 0.9)
        for end in (found.low, found.high):
            assert squares(end) - least == pytest.approx(rise, rel=2e-3)

    def test_what_has_none_is_refused(self, of_target: Calibration):
        with pytest.raises(ModelError, match="'frames' has no parameter 'd9'"):
            profile_interval(of_target, "d9")
        with pytest.raises(CalibError, match="level of an interval is 1; it must lie between"):
            profile_interval(of_target, "target_x", 1.0)


def test_the_papers_solver_has_none_of_it(ur3: Robot, table: Measurements, paper_cell: Cell):
    result = calibrate(ur3, table, cell=paper_cell, solver="paper", validate=False)
    for asked in (
        lambda: bootstrap(result, 100, 1),
        lambda: profile_interval(result, "a2"),
    ):
        with pytest.raises(ModelError, match=r"The solver 'paper' .* Choose"):
            asked()
    assert result.trust.robustness is None


BLOCKS = np.array(["b", "a", "a", "c", "b", "d", "d", "d"])


def test_blocks_are_drawn_whole_and_as_many_as_there_are():
    counts = bootstrap_counts(BLOCKS, 500, 0, np.zeros(8))
    assert counts.shape == (500, 8)
    for label in "abcd":
        rows = counts[:, label == BLOCKS]
        np.testing.assert_array_equal(rows, rows[:, :1].repeat(rows.shape[1], axis=1))
    first = [int(np.flatnonzero(label == BLOCKS)[0]) for label in "abcd"]
    np.testing.assert_array_equal(counts[:, first].sum(axis=1), np.full(500, 4))
    # Each is drawn as often as the others: binomial with 4 draws of a probability of 1/4.
    np.testing.assert_allclose(counts[:, first].mean(axis=0), 1.0, atol=0.16)
    np.testing.assert_allclose(counts[:, first].var(axis=0), 0.75, rtol=0.25)


def test_every_set_up_stays_in_every_sample():
    blocks, strata = np.arange(12), np.repeat([0, 1, 2], [2, 4, 6])
    counts = bootstrap_counts(blocks, 200, 1, strata)
    for s, size in enumerate((2, 4, 6)):
        np.testing.assert_array_equal(counts[:, strata == s].sum(axis=1), np.full(200, size))


@pytest.mark.parametrize("level", [0.5, 0.95, 0.999])
@pytest.mark.parametrize("guess", [0.2, 1.0, 7.0])
def test_a_parabola_gives_the_normal_interval_whatever_the_first_step(level, guess):
    found = profile(lambda x: 40.0 + ((x - 3.0) / 0.5) ** 2, 3.0, 0.5 * guess, level)
    reach = 0.5 * stats.norm.ppf(0.5 + level / 2)
    assert found == pytest.approx((3.0 - reach, 3.0 + reach), rel=1e-3)


def test_a_skew_cost_has_a_skew_interval():
    """The rate of an exponential: -2 log L = 2 n (rate mean - log rate)."""
    n, mean = 8, 2.0

    def cost(rate: float) -> float:
        return 2 * n * (rate * mean - np.log(rate)) if rate > 0 else np.inf

    low, high = profile(cost, 1 / mean, 1 / mean / np.sqrt(n))
    limit = cost(1 / mean) + stats.chi2.ppf(0.95, 1)
    assert cost(low) == pytest.approx(limit, abs=1e-2)
    assert cost(high) == pytest.approx(limit, abs=1e-2)
    assert high - 0.5 > 1.3 * (0.5 - low)


def test_ends_where_the_cost_does_not_rise_are_open():
    found = profile(lambda x: x**2 if x < 0 else 1.0 - np.exp(-x), 0.0, 1.0)
    assert found == pytest.approx((-1.96, np.inf), abs=1e-2)
    assert profile(lambda _: 5.0, 0.0, 1.0) == (-np.inf, np.inf)


def test_rows_and_priors_are_drawn_independently(calibrated):
    """Rows as `bootstrap_counts` draws them, and a normal number for each prior and each known distance."""
    _, c = calibrated("sockets")
    problem = c.fit.geometry.estimate.problem
    rows = problem.rows
    counts, normal = (np.array(drawn) for drawn in zip(*_draws(problem, 40, 3), strict=True))
    expected = bootstrap_counts(rows.blocks, 40, 3, rows.samples.frame)
    np.testing.assert_array_equal(counts, expected)
    assert len(problem.distances) > 0
    assert normal.shape == (40, len(c.geometry.x) + len(problem.distances))
    assert abs(normal.mean()) < 0.1
    assert normal.std() == pytest.approx(1.0, abs=0.1)
    assert normal[0, 0] != np.random.default_rng(3).normal()


def test_a_draw_does_not_hang_on_what_was_computed_before(make_scene):
    """Four targets at each of 80 stops that miss theirs: stops are drawn whole, in whatever process."""
    scene = make_scene(4, frames=[np.eye(4)], targets=4, length=0.0, angle=0.0)
    table = table_of_missed_stops(scene, 80, 4)
    rows, setup = rows_and_setup(scene.robot, table, Cell())
    found = fit(Task(scene.robot, Cell(), setup, "frames"), rows)
    problem = found.estimate.problem
    assert len(rows) > 256
    assert np.any(problem.stop_shares)
    (drawn,) = _draws(problem, 1, 5)
    problem.linear(found.estimate.x)
    after, _ = _fit_sample(found, drawn)
    problem._last.clear()
    fresh, _ = _fit_sample(found, drawn)
    np.testing.assert_array_equal(after, fresh)
