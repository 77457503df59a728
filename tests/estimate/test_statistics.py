"""Errors against the paper's own tables, folds, intervals."""

from __future__ import annotations

import numpy as np
import pytest

from calib.estimate.crossvalidation import folds
from calib.estimate.statistics import Errors, interval_factor, same_poses

# The paper's Table 4: errors of rows 31 to 35 before and after calibration [mm].
BEFORE = np.array(
    [
        [0.83, -2.71, -0.88],
        [-0.91, 0.89, 0.08],
        [-0.96, -0.56, -1.04],
        [3.12, -0.97, -1.28],
        [3.39, 1.09, 0.16],
    ]
)
AFTER = np.array(
    [
        [-1.10, 0.44, 0.39],
        [-1.46, 0.99, 0.90],
        [-0.93, -0.16, -0.39],
        [1.02, 1.37, 0.69],
        [-0.58, 1.43, 1.06],
    ]
)


def parts(left_out):
    return left_out.method, left_out.masks


@pytest.mark.parametrize(
    ("residual", "table5", "span"),
    [
        (BEFORE, (3.5645, 2.5678, 2.7485), (4.35, 3.80, 1.44)),
        (AFTER, (1.8721, 1.5926, 1.6382), (2.48, 1.59, 1.45)),
    ],
)
def test_the_papers_table_5_follows_from_its_table_4(residual, table5, span):
    """Table 4 is printed to 0.01 mm; one maximum of Table 5 is that of its last row, not the largest."""
    errors = Errors.of(residual)
    assert errors.n == 5
    assert errors.mean == pytest.approx(table5[1], abs=0.006)
    assert errors.rms == pytest.approx(table5[2], abs=0.006)
    np.testing.assert_allclose(errors.span_axis, span, atol=0.011)


def test_the_printed_maximum_after_calibration_is_not_the_largest_of_table_4():
    assert Errors.of(AFTER).max == pytest.approx(1.9803, abs=0.01)
    assert Errors.of(BEFORE).max == pytest.approx(3.5645, abs=0.01)


def test_errors_by_axis_by_hand():
    errors = Errors.of(np.array([[1.0, 0.0, 2.0], [-1.0, 3.0, 2.0]]))
    np.testing.assert_allclose(errors.mean_axis, [0.0, 1.5, 2.0])
    np.testing.assert_allclose(errors.rms_axis, [1.0, np.sqrt(4.5), 2.0])
    np.testing.assert_allclose(errors.span_axis, [2.0, 3.0, 0.0])
    assert errors.max == pytest.approx(np.sqrt(14))
    assert not errors.mean_axis.flags.writeable


def test_no_rows_have_no_errors():
    errors = Errors.of(np.zeros((0, 3)))
    assert errors.n == 0
    assert np.isnan(errors.max)
    assert np.isnan(errors.rms)


def test_lengths_and_angles_of_several_kinds():
    """A pose, a point and a distance: what a row lacks does not count as an error of nothing."""
    residual = np.array(
        [[3.0, 0, 4.0, 0, 0.1, 0], [0, 2.0, 0, 0, 0, 0], [-1.0, 0, 0, 0, 0, 0], [0] * 6]
    )
    used = np.array([[1] * 6, [1, 1, 1, 0, 0, 0], [1, 0, 0, 0, 0, 0], [0] * 6], dtype=bool)
    errors = Errors.of(residual, used)
    assert (errors.n, errors.n_angle) == (3, 1)
    assert errors.mean == pytest.approx(8 / 3)
    assert errors.rms == pytest.approx(np.sqrt(30 / 3))
    assert (errors.max, errors.max_angle) == pytest.approx((5.0, 0.1))
    assert np.all(np.isnan(errors.mean_axis))  # not all have axes
    whole = Errors.of(residual[:2], used[:2])
    np.testing.assert_allclose(whole.mean_axis, [1.5, 1.0, 2.0])


def test_lengths_alone_have_no_axes():
    errors = Errors.of(np.array([[1.0], [-3.0]]), np.ones((2, 1), dtype=bool))
    assert (errors.n, errors.max, errors.rms) == pytest.approx((2, 3.0, np.sqrt(5)))
    assert np.all(np.isnan(errors.span_axis))


@pytest.mark.parametrize("rows", [1, 2, 30, 60, 61, 1000])
def test_each_row_is_left_out_once(rows):
    method, masks = parts(folds(np.arange(rows)))
    assert method == ("leave-one-out" if rows <= 60 else "10-fold")
    assert len(masks) == (rows if rows <= 60 else 10)
    np.testing.assert_array_equal(np.sum(masks, axis=0), np.ones(rows))


def test_repeats_of_a_pose_are_left_out_together():
    rng = np.random.default_rng(0)
    poses = rng.uniform(-3, 3, (12, 6))
    order = rng.permutation(np.repeat(np.arange(12), 5))
    labels = same_poses(poses[order] + 1e-4 * rng.uniform(-1, 1, (60, 6)))
    assert labels[0] == 0
    assert labels.max() == 11
    for pose in range(12):
        assert len(set(labels[order == pose])) == 1
    method, masks = parts(folds(labels))
    assert method == "leave-one-pose-out"
    assert [mask.sum() for mask in masks] == [5] * 12


def test_many_repeated_poses_stay_together_in_ten_folds():
    labels = np.tile(np.arange(70), 3)
    method, masks = parts(folds(labels))
    assert method == "10-fold"
    for mask in masks:
        assert set(labels[mask]).isdisjoint(labels[~mask])


def test_different_poses_are_not_taken_for_repeats():
    step = np.zeros((5, 6))
    step[:, 3] = 2e-3 * np.arange(5)
    np.testing.assert_array_equal(same_poses(step), np.arange(5))


@pytest.mark.parametrize("count", [30, 200])
def test_no_fold_is_empty_where_numbers_of_poses_are_missing(count):
    """Poses that are measured for validation only have numbers too."""
    labels = 7 + 10 * np.arange(count)
    method, masks = parts(folds(labels))
    assert method == ("leave-one-out" if count == 30 else "10-fold")
    assert all(mask.any() for mask in masks)
    np.testing.assert_array_equal(np.sum(masks, axis=0), np.ones(count))


@pytest.mark.parametrize("names", [[0, 1], [3, 5, 9], range(4), range(150)])
def test_from_three_set_ups_on_each_is_left_out_as_a_whole(names):
    setups = np.repeat(list(names), 4)
    left_out = folds(np.arange(len(setups)), setups)
    if len(names) < 3:
        assert left_out.method == "leave-one-out"
        return
    np.testing.assert_array_equal(np.sum(left_out.masks, axis=0), np.ones(len(setups)))
    for mask in left_out.masks:
        assert set(setups[mask]).isdisjoint(setups[~mask])
    assert len(left_out.masks) == min(len(names), 50)
    assert left_out.method == ("leave-one-set-up-out" if len(names) < 60 else "leave-set-ups-out")


@pytest.mark.parametrize(
    ("freedom", "factor"), [(1.0, 12.706), (10.0, 2.228), (63.0, 1.998), (1e9, 1.960)]
)
def test_interval_factor_is_students(freedom, factor):
    assert interval_factor(freedom) == pytest.approx(factor, abs=1e-3)


def by_brute_force(joints):
    """Each row that has no pose yet takes all rows near it that have none either."""
    labels = np.full(len(joints), -1)
    for i in range(len(joints)):
        if labels[i] < 0:
            near = np.all(np.abs(joints - joints[i]) <= 1e-3, axis=1) & (labels < 0)
            labels[near] = labels.max() + 1
    return labels


@pytest.mark.parametrize("seed", range(12))
def test_poses_as_by_brute_force(seed):
    rng = np.random.default_rng(seed)
    count, n = int(rng.integers(1, 300)), int(rng.integers(1, 9))
    q = rng.uniform(-3.0, 3.0, (count, n)) * (0.003 if seed % 3 == 0 else 1.0)
    if seed % 3 == 1:
        q = q[rng.integers(0, count, count)] + rng.uniform(-6e-4, 6e-4, (count, n))
    if seed % 4 == 0:
        q[:, 0] = 0.0
    if seed % 5 == 0:
        q = np.round(q, 1)  # a grid, with many rows twice
    np.testing.assert_array_equal(same_poses(q), by_brute_force(q))


def test_many_repeats_and_joints_at_zero_take_no_longer():
    rng = np.random.default_rng(0)
    jitter = rng.uniform(-4e-4, 4e-4, (20_000, 6))
    assert same_poses(1.0 + jitter).max() == 0
    still = np.zeros((5_000, 14))
    still[:, :2] = rng.uniform(-3.0, 3.0, (5_000, 2))
    assert len(np.unique(same_poses(still))) > 4_900
    assert len(np.unique(same_poses(rng.integers(-30, 30, (2_000, 14)) * 0.1))) == 2_000
