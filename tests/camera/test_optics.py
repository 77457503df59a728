"""Images of corners: the print's errors by hand, and all derivatives against differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.camera import optics
from calib.camera.lenses import LENSES
from tests.camera.lens_values import VALUES


def rows(lens, count=40):
    rng = np.random.default_rng(4)
    values = np.zeros((count, optics.COUNT))
    values[:, optics.intrinsic_columns(LENSES[lens])] = VALUES[lens]
    values[:, optics.LENS] = list(LENSES).index(lens)
    values[:, optics.POINT] = rng.uniform([0, 0, -0.05], [0.2, 0.2, 0.05], (count, 3))
    values[:, optics.ACROSS] = optics.across(
        values[:, optics.POINT], np.array([0.1, 0.1]), (0.2, 0.2)
    )
    values[:, optics.SCALE] = [0.01, -0.02, 0.03]
    values[:, optics.WARP] = [1e-3, -2e-3]
    values[:, optics.OFFSET] = rng.normal(size=(count, 3)) * 1e-4
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, (count, 3))).as_matrix()
    T[:, :3, 3] = np.column_stack(
        [rng.uniform(-0.1, 0.1, (count, 2)), rng.uniform(0.3, 0.6, count)]
    )
    return T, values


def test_corner_of_a_print_with_errors():
    values = np.zeros((1, optics.COUNT))
    values[0, optics.POINT] = [0.05, 0.10, 0.0]
    values[0, optics.ACROSS] = [-0.5, 1.0]
    values[0, optics.SCALE] = [0.01, -0.02, 0.5]
    values[0, optics.WARP] = [4e-3, 7e-3]
    values[0, optics.OFFSET] = [1e-4, -2e-4, 0.0]
    expected = [0.05 * 1.01 + 1e-4, 0.10 * 0.98 - 2e-4, 4e-3 * 0.75]
    np.testing.assert_allclose(optics.board_points(values)[0], expected, atol=1e-15)


def test_corner_of_a_body_with_errors():
    values = np.zeros((1, optics.COUNT))
    values[0, optics.POINT] = [0.05, 0.10, -0.04]
    values[0, optics.SCALE] = [0.01, -0.02, 0.03]
    values[0, optics.OFFSET] = [1e-4, -2e-4, 3e-4]
    expected = [0.05 * 1.01 + 1e-4, 0.10 * 0.98 - 2e-4, -0.04 * 1.03 + 3e-4]
    np.testing.assert_allclose(optics.board_points(values)[0], expected, atol=1e-15)


def test_across_runs_from_minus_one_to_one():
    points = np.array([[0.0, 0.0, 0.0], [0.2, 0.1, 0.0], [0.1, 0.05, 0.0]])
    across = optics.across(points, np.array([0.1, 0.05, 0.0]), (0.2, 0.1))
    np.testing.assert_allclose(across, [[-1, -1], [1, 1], [0, 0]], atol=1e-12)


def test_a_body_without_width_is_in_its_middle():
    points = np.array([[0.1, 0.0, 0.0], [0.1, 0.1, 0.2]])
    across = optics.across(points, np.array([0.1, 0.05, 0.1]), (0.0, 0.1))
    np.testing.assert_allclose(across, [[0, -1], [0, 1]], atol=1e-12)


@pytest.mark.parametrize("lens", LENSES)
def test_derivatives_by_motion_are_those_of_differences(lens):
    T, values = rows(lens)
    twists = np.tile(np.eye(6), (len(T), 1, 1))
    by_motion, _ = optics.image_derivatives(T, twists, values)
    for k in range(6):
        step = 1e-6

        def moved(sign, k=k, step=step):
            result = T.copy()
            if k < 3:
                result[:, k, 3] += sign * step
            else:
                turn = Rotation.from_rotvec(sign * step * np.eye(3)[k - 3]).as_matrix()
                result[:, :3, :3] = turn @ T[:, :3, :3]
            return optics.images(result, values)

        difference = (moved(1) - moved(-1)) / (2 * step)
        np.testing.assert_allclose(by_motion[:, :, k], difference, rtol=1e-7, atol=2e-5)


@pytest.mark.parametrize("lens", LENSES)
def test_derivatives_by_optics_are_those_of_differences(lens):
    T, values = rows(lens)
    _, by_optics = optics.image_derivatives(T, np.zeros((len(T), 6, 1)), values)
    changing = [
        *optics.intrinsic_columns(LENSES[lens]).tolist(),
        *optics.SCALE,
        *range(optics.WARP.start, optics.WARP.stop),
        *optics.OFFSET,
    ]
    for k in changing:
        step = 1e-6
        up, down = values.copy(), values.copy()
        up[:, k] += step
        down[:, k] -= step
        difference = (optics.images(T, up) - optics.images(T, down)) / (2 * step)
        np.testing.assert_allclose(by_optics[:, :, k], difference, rtol=1e-7, atol=2e-5)


def test_rows_of_both_lenses_keep_their_order():
    T, first = rows("pinhole")
    _, second = rows("fisheye")
    mixed = np.where((np.arange(len(T)) % 2 == 0)[:, None], first, second)
    expected = np.where(
        (np.arange(len(T)) % 2 == 0)[:, None], optics.images(T, first), optics.images(T, second)
    )
    np.testing.assert_array_equal(optics.images(T, mixed), expected)
