"""False alarms of clean tables, and patterns of a real arm's kind that must be found and named."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats

from calib.identify.patterns import FALSE_ALARM, drift, joint_patterns
from calib.model.robot import Robot

NAMES = ("a", "b", "c", "d", "e", "slide")
PRISMATIC = (False, False, False, False, False, True)


class Table:
    """Random regressors, joint values, and noise with what repeats of a pose share."""

    def __init__(self, rng, poses, *, repeats=1, columns=33, sizes=(1.0, 1.0, 1.0), shared=0.0):
        n, self.poses = poses * repeats, np.repeat(np.arange(poses), repeats)
        self.joints = np.repeat(rng.uniform(-3, 3, (poses, 6)), repeats, axis=0)
        A = rng.normal(size=(poses, 3, columns))
        A[:, :, 0] = A[:, :, 1]
        self.A = np.repeat(A, repeats, axis=0).reshape(3 * n, columns)
        b, w = rng.normal(size=(poses, 3)), rng.normal(size=(n, 3))
        self.noise = np.sqrt(shared) * np.repeat(b, repeats, axis=0) + np.sqrt(1 - shared) * w
        self.noise *= sizes
        self.row_of, self.component_of = np.repeat(np.arange(n), 3), np.tile(np.arange(3), n)
        self.order = np.linspace(0, 1, n)

    def residual(self, pattern=0.0):
        y = (self.noise + pattern).ravel()
        A = self.A
        return y - A @ np.linalg.solve(A.T @ A + np.eye(A.shape[1]), A.T @ y)

    def patterns(self, pattern=0.0, **options):
        r = self.residual(pattern)
        return joint_patterns(
            self.A, r, self.row_of, self.component_of, self.joints, NAMES, PRISMATIC, **options
        )

    def drift(self, pattern=0.0, **options):
        r = self.residual(pattern)
        return drift(self.A, r, self.row_of, self.component_of, self.order, **options)


CLEAN = [
    {"poses": 30},
    {"poses": 12, "columns": 15},
    {"poses": 30, "sizes": (1.0, 1.0, 6.0)},
    {"poses": 20, "repeats": 5, "shared": 0.8},
    {"poses": 15, "repeats": 4, "shared": 0.0, "sizes": (1.0, 3.0, 1.0)},
]


def alarms(find: Callable[[Table], object], count: int, **table) -> int:
    """In how many clean tables something is found."""
    rng = np.random.default_rng(7)
    return sum(bool(find(Table(rng, **table))) for _ in range(count))


@pytest.mark.parametrize("table", CLEAN)
def test_clean_tables_raise_no_more_than_one_alarm_in_a_hundred(table):
    most = stats.binom.ppf(0.999, 300, FALSE_ALARM)
    assert alarms(lambda t: t.patterns(poses=t.poses), 300, **table) <= most
    assert alarms(lambda t: t.drift(poses=t.poses), 300, **table) <= most


def test_the_probability_of_a_drift_is_right_with_repeats():
    """Between and within poses combined: the share of clean tables that are told is the one asked for."""
    rng = np.random.default_rng(11)
    tables = [Table(rng, 12, repeats=3, columns=10, shared=0.7) for _ in range(1500)]
    found = [t.drift(poses=t.poses) is not None for t in tables]
    assert stats.binomtest(sum(found), len(found), FALSE_ALARM).pvalue > 0.001


def test_repeats_taken_for_poses_would_raise_false_alarms():
    """Why the poses are asked for."""
    table = {"poses": 20, "repeats": 5, "shared": 0.8}
    assert alarms(lambda t: t.patterns(), 60, **table) > 20


def test_directions_do_not_raise_false_alarms():
    def find(t):
        return t.patterns(directions=[t.A[:, [2 * j]] for j in range(6)])

    assert alarms(find, 300, poses=30) <= stats.binom.ppf(0.999, 300, FALSE_ALARM)


@pytest.mark.parametrize("joint", range(6))
def test_a_pattern_along_fixed_axes_is_found_and_named(joint):
    rng = np.random.default_rng(joint)
    table = Table(rng, 60, columns=10)
    q = table.joints[:, [joint]]
    pattern = (0.4 * q**2 if PRISMATIC[joint] else np.sin(q)) * np.array([1.5, -1.0, 0.5])
    found = table.patterns(pattern)
    assert found[0].joint == NAMES[joint]
    assert found[0].prismatic == PRISMATIC[joint]
    assert found[0].test.share > 0.3
    assert [f.test.p for f in found] == sorted(f.test.p for f in found)
    text = found[0].sentence()
    assert f"the {'position' if PRISMATIC[joint] else 'angle'} of '{NAMES[joint]}'" in text
    assert f"explains {100 * found[0].test.share:.0f} % of it" in text


def test_a_pattern_shared_by_repeats_is_found():
    rng = np.random.default_rng(5)
    table = Table(rng, 60, repeats=3, columns=10, shared=0.5)
    assert table.patterns(1.5 * np.sin(table.joints[:, [2]]), poses=table.poses)[0].joint == "c"


def test_a_joint_that_stands_still_has_no_pattern():
    table = Table(np.random.default_rng(6), 60, columns=10)
    table.joints[:, 3] = 0.7
    assert "d" not in [f.joint for f in table.patterns(1.0)]


def test_a_constant_is_no_pattern_of_a_joint_that_moves_little():
    table = Table(np.random.default_rng(6), 60, columns=10)
    table.joints[:, 3] = 0.3 * table.joints[:, 3]
    assert table.patterns(100.0) == ()


def test_rows_that_do_not_count_are_left_out():
    """Rows of weight 0 must not look like measurements that fit perfectly, or fit badly."""
    table = Table(np.random.default_rng(8), 80, columns=10)
    pattern = 0.9 * np.sin(table.joints[:, [1]])
    scale = np.ones(240)
    scale[-60:] = 0.0
    pattern[-20:] = 1e4
    A, r = table.A, (table.noise + pattern).ravel()
    labels = (table.row_of, table.component_of)
    all_rows = joint_patterns(A, r, *labels, table.joints, NAMES, PRISMATIC, scale=scale)
    cut = [v[:180] for v in (A, r, *labels)]
    expected = joint_patterns(*cut, table.joints, NAMES, PRISMATIC)
    assert [f.joint for f in expected] == ["b"]
    np.testing.assert_allclose(all_rows[0].test.F, expected[0].test.F, rtol=1e-9)


def test_the_size_of_each_row_s_noise_shapes_the_pattern():
    """Half of the rows are measured ten times worse: a pattern of one size in metres is found by its whitened form."""
    table = Table(np.random.default_rng(9), 60, columns=10)
    table.A[:] = 0.0
    sigma = np.tile([1.0, 10.0], 30)
    scale = np.repeat(1.0 / sigma, 3)
    pattern = np.sin(table.joints[:, [4]]) / sigma[:, None] * 1.2
    sharp = table.patterns(pattern, scale=scale)
    blurred = table.patterns(pattern)
    assert sharp[0].joint == "e"
    assert sharp[0].test.share > 1.2 * max((f.test.share for f in blurred), default=0.0)


@pytest.mark.parametrize(("repeats", "shared"), [(1, 0.0), (4, 0.0), (4, 0.9)])
def test_a_drift_is_found(repeats, shared):
    rng = np.random.default_rng(10)
    table = Table(rng, 60 // repeats, repeats=repeats, columns=10, shared=shared)
    # Cycles through the poses: each is repeated late and early.
    table.order = rng.permutation(table.order)
    poses = table.poses if repeats > 1 else None
    found = table.drift(3.0 * table.order[:, None] * np.array([1.0, 0.0, 0.5]), poses=poses)
    assert found is not None
    assert found.p < 1e-3
    assert "drifts in the order of the rows" in found.sentence()
    assert f"explains {100 * found.test.share:.0f} % of it" in found.sentence()


def test_a_drift_within_repeats_is_found_where_poses_differ_far_more():
    rng = np.random.default_rng(12)
    table = Table(rng, 20, repeats=5, columns=10, shared=0.99)
    table.order = rng.permutation(table.order)
    pattern = 0.5 * table.order[:, None]
    assert table.drift(pattern, poses=table.poses) is not None


def test_no_rows_no_findings():
    nothing = (np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=int), np.zeros(0, dtype=int))
    assert joint_patterns(*nothing, np.zeros((4, 1)), ("a",), (False,)) == ()
    assert drift(*nothing, np.linspace(0, 1, 4)) is None


def columns_of_zeros(robot: Robot, q: np.ndarray, target: np.ndarray) -> list[np.ndarray]:
    """What turning each joint a little does to the target in the base, m of (3 N, 1), by differences."""
    h = 1e-6
    steps = h * np.eye(q.shape[1])
    return [
        ((points(robot, q + step, target) - points(robot, q - step, target)) / (2 * h)).reshape(
            -1, 1
        )
        for step in steps
    ]


def points(robot: Robot, q: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Where a target fixed to the tip lies in the base, (N, 3)."""
    T = robot.poses(q)
    return T[:, :3, 3] + T[:, :3, :3] @ target


@pytest.mark.parametrize("joint", range(6))
def test_eccentricity_of_an_encoder_of_a_ur3_is_found_at_its_joint(ur3, joint):
    """3 mrad once per turn, 60 poses of a tracker of 0.12 mm, joint zeros and a target fitted."""
    rng = np.random.default_rng(joint)
    sigma, target = 1.2e-4, np.array([-0.07, 0.07, 0.0225])
    q = rng.uniform(-3, 3, (60, 6))
    wrong = q.copy()
    wrong[:, joint] += 3e-3 * np.sin(q[:, joint] + 0.8)
    axes = columns_of_zeros(ur3, q, target)
    A = np.hstack([*axes, ur3.poses(q)[:, :3, :3].reshape(180, 3)]) / sigma
    error = points(ur3, wrong, target) - points(ur3, q, target)
    r = (error / sigma + rng.normal(size=(60, 3))).ravel()
    found = joint_patterns(
        A,
        r,
        np.repeat(np.arange(60), 3),
        np.tile(np.arange(3), 60),
        q,
        ur3.joint_names,
        [False] * 6,
        directions=[axis / sigma for axis in axes],
    )
    assert found
    assert found[0].joint == ur3.joint_names[joint]
