"""The tests of residuals: false alarms of clean tables, and what a real arm's errors leave that must be found."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats

from calib.diagnosis.patterns import (
    FALSE_ALARM,
    Explained,
    Stack,
    _between,
    _combined,
    _level,
    _within,
    drift,
    even_factors,
    f_test,
    functions_of_joint,
    joint_patterns,
    lag,
    norms_of,
    range_of,
    step,
)
from calib.robot.robot import Robot

PRISMATIC = (False, False, False, False, False, True)


def explained(A: np.ndarray, r: np.ndarray, Z: np.ndarray) -> Explained:
    return f_test(range_of(A), r, Z, norms_of(Z))


def deficient(rng: np.random.Generator, rows: int, rank: int, columns: int) -> np.ndarray:
    """Regressors of lower rank than they have columns, in units of very different size."""
    A = rng.normal(size=(rows, rank)) @ rng.normal(size=(rank, columns))
    return A * 10.0 ** rng.uniform(-3, 3, columns)


def ridge_residual(A: np.ndarray, y: np.ndarray) -> np.ndarray:
    """What a fit with priors leaves over."""
    return y - A @ np.linalg.solve(A.T @ A + np.diag(np.sum(A**2, axis=0)), A.T @ y)


def test_the_f_test_against_the_textbook():
    """Two nested linear models of full rank, squares by numpy's least squares."""
    rng = np.random.default_rng(0)
    A, Z, y = rng.normal(size=(40, 5)), rng.normal(size=(40, 3)), rng.normal(size=40)
    small = np.linalg.lstsq(A, y, rcond=None)[1][0]
    large = np.linalg.lstsq(np.hstack([A, Z]), y, rcond=None)[1][0]
    F = (small - large) / 3 / (large / 32)
    test = explained(A, y, Z)
    np.testing.assert_allclose(test.F, F, rtol=1e-10)
    assert test.p == pytest.approx(stats.f.sf(F, 3, 32), rel=1e-9)
    assert test.share == pytest.approx(1 - large / small, rel=1e-10)
    assert (test.columns, test.freedom) == (3, 32)
    assert test.chance == pytest.approx(3 / 35)


def test_the_f_test_counts_degrees_of_freedom_that_were_used_elsewhere():
    rng = np.random.default_rng(0)
    A, Z, y = rng.normal(size=(40, 5)), rng.normal(size=(40, 3)), rng.normal(size=40)
    plain = explained(A, y, Z)
    used = f_test(range_of(A), y, Z, norms_of(Z), used=7)
    np.testing.assert_allclose(used.F, plain.F * 25 / 32)
    assert (used.columns, used.freedom, used.chance) == (3, 25, pytest.approx(3 / 28))


@pytest.mark.parametrize(
    ("rows", "columns", "exact", "before"),
    [
        (8, 3, False, 3),  # no degree of freedom remains
        (40, 3, True, 35),  # the fit explains all
        (40, 0, False, 35),  # nothing further
    ],
)
def test_without_anything_to_test_there_is_no_evidence(rows, columns, exact, before):
    rng = np.random.default_rng(0)
    A, Z = rng.normal(size=(rows, 5)), rng.normal(size=(rows, columns))
    y = A @ np.ones(5) if exact else rng.normal(size=rows)
    assert explained(A, y, Z) == Explained(0.0, 1.0, 0.0, 0.0, 0, before)


def test_one_degree_of_freedom_that_remains_is_enough():
    rng = np.random.default_rng(0)
    A, Z, y = rng.normal(size=(9, 5)), rng.normal(size=(9, 3)), rng.normal(size=9)
    test = explained(A, y, Z)
    assert (test.columns, test.freedom) == (3, 1)
    assert test.p == pytest.approx(stats.f.sf(test.F, 3, 1))


def test_components_are_level_by_their_variance_about_the_fit():
    """Each with a constant of its own: about it the sample variance is one then."""
    rng = np.random.default_rng(0)
    component = np.array([0] * 10 + [1] * 25)
    r = rng.normal(size=35) * np.where(component, 5.0, 1.0) + 3.0
    factors = even_factors(np.eye(2)[component], r, component)
    std = [np.std(r[component == k], ddof=1) for k in range(2)]
    np.testing.assert_allclose(factors, 1.0 / np.array(std)[component])
    # There is nothing to level in a single one.
    one = even_factors(np.ones((35, 1)), r, np.zeros(35, dtype=int))
    np.testing.assert_array_equal(one, np.ones(35))


def test_factors_that_level_sums_of_squares():
    squares, freedom = np.array([18.0, 8.0, 1e-9, 5.0]), np.array([2.0, 2.0, 2.0, 0.0])
    # The third is taken as at least a hundredth of the largest std, the fourth, unknown, as like the largest.
    np.testing.assert_allclose(_level(squares, freedom), 1.0 / np.array([3.0, 2.0, 0.03, 3.0]))
    np.testing.assert_array_equal(_level(np.zeros(2), np.ones(2)), [1.0, 1.0])
    np.testing.assert_array_equal(_level(np.ones(2), np.zeros(2)), [1.0, 1.0])


def test_repeats_are_compared_about_the_mean_of_their_pose():
    """By least squares with a constant for each cell; a component with fewer repeats has lost more to its means."""
    rng = np.random.default_rng(5)
    # Component 0 was measured at both repeats of a pose, component 1 at the four of another one.
    poses = np.r_[np.repeat(np.arange(6), 2), np.repeat(np.arange(6, 12), 4)]
    component = np.where(poses < 6, 0, 1)
    size = np.where(component, 6.0, 1.0)
    r, order = rng.normal(size=36) * size, rng.normal(size=36)
    A = rng.normal(size=(36, 2))
    Z = np.column_stack([order * (component == 0), order * (component == 1)])
    stack = Stack(A, r, np.arange(36), component, np.eye(2)[component], poses)
    cells = np.eye(12)[poses]
    about_mean = r - cells @ np.linalg.lstsq(cells, r, rcond=None)[0]
    squares = np.bincount(component, about_mean**2)
    level = np.sqrt(np.array([6.0, 18.0]) / squares)[component]

    def left(*columns: np.ndarray) -> float:
        X = np.column_stack(columns) * level[:, None]
        return float(np.linalg.lstsq(X, level * r, rcond=None)[1][0])

    small, large = left(cells, A), left(cells, A, Z)
    F = (small - large) / 2 / (large / (36 - 12 - 2 - 2))
    test = _within(stack)(Z)
    np.testing.assert_allclose(test.F, F, rtol=1e-9)
    assert (test.columns, test.freedom) == (2, 20)
    # Without repeats there is nothing to compare.
    alone = Stack(A, r, np.arange(36), component, np.eye(2)[component], np.arange(36))
    assert _within(alone)(Z) == Explained(0.0, 1.0, 0.0, 0.0, 0, 0)


def test_functions_of_a_joint_are_centred_and_of_size_one():
    q = np.array([0.5, 1.0, 3.0, 1.5])
    middle = np.array([-1.0, -0.5, 1.5, 0.0]) / 1.5
    turning = np.column_stack([np.sin(q), np.cos(q), middle])
    np.testing.assert_allclose(functions_of_joint(q, slides=False), turning, atol=1e-12)
    sliding = np.column_stack([middle, middle**2])
    np.testing.assert_allclose(functions_of_joint(q, slides=True), sliding, atol=1e-12)
    # Of a joint that stood still there is nothing to see.
    np.testing.assert_array_equal(
        functions_of_joint(np.full(4, 0.5), slides=True), np.zeros((4, 2))
    )


def test_probabilities_are_uniform_under_noise():
    rng = np.random.default_rng(2)
    p = []
    for _ in range(150):
        A, Z = deficient(rng, 45, 20, 26), rng.normal(size=(45, 6))
        p.append(explained(A, ridge_residual(A, rng.normal(size=45)), Z).p)
    assert stats.kstest(p, "uniform").pvalue > 0.01


class Table:
    """Random regressors, joint values, and noise with what repeats of a pose share."""

    def __init__(self, rng, poses, *, repeats=1, columns=33, prior_std=(1.0, 1.0, 1.0), shared=0.0):
        n, self.poses = poses * repeats, np.repeat(np.arange(poses), repeats)
        self.joints = np.repeat(rng.uniform(-3, 3, (poses, 6)), repeats, axis=0)
        A = rng.normal(size=(poses, 3, columns))
        A[:, :, 0] = A[:, :, 1]
        self.A = np.repeat(A, repeats, axis=0).reshape(3 * n, columns)
        b, w = rng.normal(size=(poses, 3)), rng.normal(size=(n, 3))
        self.noise = np.sqrt(shared) * np.repeat(b, repeats, axis=0) + np.sqrt(1 - shared) * w
        self.noise *= prior_std
        self.along = [self.A[:, [2 * j % columns]] for j in range(6)]
        self.order = np.linspace(0, 1, n)

    def stack(self, pattern=0.0, scale=None):
        y, A, n = (self.noise + pattern).ravel(), self.A, len(self.poses)
        r = y - A @ np.linalg.solve(A.T @ A + np.eye(A.shape[1]), A.T @ y)
        scale = np.ones(3 * n) if scale is None else scale
        component = np.tile(np.arange(3), n)
        ones = np.eye(3)[component] * scale[:, None]
        return Stack(A, r, np.repeat(np.arange(n), 3), component, ones, self.poses)

    def patterns(self, pattern=0.0, along=None, **options):
        stack = self.stack(pattern, **options)
        return joint_patterns(stack, self.joints, PRISMATIC, self.along if along is None else along)

    def drift(self, pattern=0.0):
        return drift(self.stack(pattern), self.order)

    def step(self, pattern=0.0):
        n = len(self.poses)
        return step(self.stack(pattern), np.arange(n), np.tile(np.eye(3), (n, 1)))


AXES = [np.tile(np.eye(3), (60, 1))] * 6


def alarms(find: Callable[[Table], object], count: int, **table) -> int:
    """In how many clean tables something is found."""
    rng = np.random.default_rng(7)
    return sum(bool(find(Table(rng, **table))) for _ in range(count))


@pytest.mark.parametrize(
    "table",
    [
        {"poses": 30},
        {"poses": 12, "columns": 15},
        {"poses": 30, "prior_std": (1.0, 1.0, 6.0)},
        {"poses": 15, "repeats": 4, "shared": 0.8},
        {"poses": 15, "repeats": 4, "shared": 0.0, "prior_std": (1.0, 3.0, 1.0)},
    ],
)
def test_clean_tables_raise_no_more_than_one_alarm_in_a_hundred(table):
    most = stats.binom.ppf(0.999, 40, FALSE_ALARM)
    assert alarms(Table.patterns, 40, **table) <= most
    assert alarms(Table.drift, 40, **table) <= most
    assert alarms(Table.step, 40, **table) <= most


@pytest.mark.slow
def test_the_probability_of_a_drift_is_right_with_repeats():
    """Between and within poses combined: the share of clean tables that are told is the one asked for."""
    rng = np.random.default_rng(11)
    found = [Table(rng, 12, repeats=3, columns=10, shared=0.7).drift() for _ in range(800)]
    told = sum(one is not None for one in found)
    assert stats.binomtest(told, len(found), FALSE_ALARM).pvalue > 0.001


@pytest.mark.parametrize("joint", range(6))
def test_a_pattern_along_fixed_axes_is_found_and_named(joint):
    table = Table(np.random.default_rng(joint), 60, columns=10)
    q = table.joints[:, [joint]]
    pattern = (0.4 * q**2 if PRISMATIC[joint] else np.sin(q)) * np.array([1.5, -1.0, 0.5])
    found = table.patterns(pattern, along=AXES)
    assert found[0][0] == joint
    assert found[0][1].share > 0.3
    assert [test.p for _, test, _ in found] == sorted(test.p for _, test, _ in found)


def test_of_joints_beyond_any_doubt_the_surer_comes_first():
    """Both probabilities are 0 in double precision, of two joints that move almost alike."""
    table = Table(np.random.default_rng(5), 200, columns=10)
    shadow, joint = np.flatnonzero(~np.array(PRISMATIC))[:2]
    table.joints[:, shadow] = table.joints[:, joint] + 1e-3 * np.cos(np.arange(200.0))
    pattern = 1e3 * np.sin(table.joints[:, [joint]]) * np.array([1.5, -1.0, 0.5])
    found = table.patterns(pattern, along=[np.tile(np.eye(3), (200, 1))] * 6)
    (first, surest, _), (second, other, _) = found[:2]
    assert (first, second) == (joint, shadow)
    assert surest.p == other.p == 0.0
    assert surest.F > other.F


@pytest.mark.parametrize(
    ("repeats", "shared", "size"), [(1, 0.0, 3.0), (4, 0.9, 3.0), (5, 0.99, 0.5)]
)
def test_a_drift_is_found(repeats, shared, size):
    """In the last case within repeats, where poses differ far more."""
    rng = np.random.default_rng(10)
    table = Table(rng, 100 // repeats, repeats=repeats, columns=10, shared=shared)
    # Cycles through the poses: each is repeated late and early.
    table.order = rng.permutation(table.order)
    found = table.drift(size * table.order[:, None] * np.array([1.0, 0.0, 0.5]))
    assert found is not None
    assert found.p < 1e-3


@pytest.mark.parametrize(("poses", "repeats", "row"), [(90, 1, 40), (45, 2, 31), (600, 1, 577)])
def test_a_step_is_found_at_its_row(poses, repeats, row):
    table = Table(np.random.default_rng(12), poses, repeats=repeats, columns=10)
    by = np.array([4.0, 0.0, -3.0])
    found = table.step((np.arange(poses * repeats) >= row)[:, None] * by)
    assert (found.row, found.test.p < 1e-9) == (row, True)
    assert found.size == pytest.approx(5.0, abs=1.0)


def test_a_step_is_found_at_its_row_where_rows_near_it_are_as_improbable():
    """All probabilities are zero in floating point: the largest F counts."""
    table = Table(np.random.default_rng(12), 1500, columns=10)
    by = np.array([4000.0, 0.0, -3000.0])
    found = table.step((np.arange(1500) >= 637)[:, None] * by)
    assert (found.row, found.test.p) == (637, 0.0)
    assert found.size == pytest.approx(5000.0, abs=1.0)


def test_a_step_is_as_sure_as_the_best_of_all_rows_tried():
    table = Table(np.random.default_rng(12), 30, columns=10)
    pattern = (np.arange(30) >= 17)[:, None] * np.array([4.0, 0.0, -3.0])
    found = table.step(pattern)
    alone = _between(table.stack(pattern))(found.Z)
    # 30 rows, with three or more before and after each step.
    assert 0.0 < found.test.p == pytest.approx(25 * alone.p)
    assert (found.test.F, found.test.share) == (alone.F, alone.share)


@pytest.mark.parametrize("row", [3, 27])
def test_a_step_has_three_rows_before_and_after_it(row):
    def found(at: int):
        table = Table(np.random.default_rng(12), 30, columns=10)
        return table.step((np.arange(30) >= at)[:, None] * np.array([20.0, 0.0, -15.0]))

    assert found(row).row == row
    assert found(row + int(np.sign(row - 15))).row == row


def test_a_step_is_looked_for_among_the_given_rows_alone():
    """Rows of one target, in their order: the step begins at one of these, and is of all later ones."""
    table = Table(np.random.default_rng(12), 60, columns=10)
    stack = table.stack((np.arange(60) >= 31)[:, None] * np.array([20.0, 0.0, -15.0]))
    along = np.tile(np.eye(3), (60, 1))
    assert step(stack, np.arange(0, 60, 2), along).row in (30, 32)
    assert step(stack, np.arange(28, 33), along) is None
    assert step(stack, np.arange(28, 34), along).row == 31


def test_a_lag_is_the_share_of_a_move_that_is_missed():
    """Where joints stop short the target is behind the prediction: positive shares, negative effects."""
    rng = np.random.default_rng(4)
    table = Table(rng, 40, columns=10)
    moves, shares = 30.0 * rng.normal(size=(120, 2)), np.array([0.2, -0.3])
    found = lag(table.stack(-(moves @ shares).reshape(40, 3)), moves)
    assert found is not None
    np.testing.assert_allclose(found[0], shares, atol=0.02)
    assert found[1].p < 1e-9
    assert lag(table.stack(), moves) is None


def test_between_poses_and_within_repeats_are_combined_by_fisher():
    table = Table(np.random.default_rng(10), 20, repeats=3, columns=10)
    stack = table.stack(1.5 * table.order[:, None] * np.array([1.0, 0.0, 0.5]))
    Z = stack.times(table.order[:, None], stack.ones)
    between, within = _between(stack)(Z), _within(stack)(Z)
    assert between.columns == within.columns == 3
    combined = _combined(stack)(Z)
    assert combined.p == pytest.approx(stats.combine_pvalues([between.p, within.p]).pvalue)
    surest = min(between, within, key=lambda one: one.p)
    assert (combined.F, combined.freedom) == (surest.F, surest.freedom)
    # What is the same at all repeats of a pose is tested between poses alone.
    of_pose = stack.times(table.joints[:, :1], stack.ones)
    assert _combined(stack)(of_pose) == _between(stack)(of_pose)


def points(robot: Robot, q: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Where a target fixed to the tip lies in the base, (N, 3)."""
    T = robot.poses(q)
    return T[:, :3, 3] + T[:, :3, :3] @ target


@pytest.mark.parametrize("joint", range(6))
def test_eccentricity_of_an_encoder_of_a_ur3_is_found_at_its_joint(ur3, joint):
    """3 mrad once per turn, 60 poses of a tracker of 0.12 mm, joint zeros and a target fitted."""
    rng = np.random.default_rng(joint)
    sigma, target, h = 1.2e-4, np.array([-0.07, 0.07, 0.0225]), 1e-6
    q = rng.uniform(-3, 3, (60, 6))
    wrong = q.copy()
    wrong[:, joint] += 3e-3 * np.sin(q[:, joint] + 0.8)
    axes = [  # what turning each joint a little does to the target, by differences
        (points(ur3, q + step, target) - points(ur3, q - step, target)).reshape(-1, 1) / (2 * h)
        for step in h * np.eye(6)
    ]
    A = np.hstack([*axes, ur3.poses(q)[:, :3, :3].reshape(180, 3)]) / sigma
    error = points(ur3, wrong, target) - points(ur3, q, target)
    r = (error / sigma + rng.normal(size=(60, 3))).ravel()
    rows, poses = np.repeat(np.arange(60), 3), np.arange(60)
    stack = Stack(A, r, rows, np.tile(np.arange(3), 60), np.tile(np.eye(3), (60, 1)), poses)
    found = joint_patterns(stack, q, [False] * 6, [axis / sigma for axis in axes])
    assert found[0][0] == joint
