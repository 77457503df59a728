"""Each row's product is a frame whose z lies along the next axis and whose x lies across both axes."""

from __future__ import annotations

import numpy as np
import pytest

from calib.model.common_normals import Reference, Rule, cross, first_frame, last_row, row_to
from calib.robot.dh_rows import HAYATI, MODIFIED, STANDARD, DHRow, screw

PURE = Rule(STANDARD, 1e-7)
TILTED = Rule(HAYATI, 0.0)


def frame(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-3, 3, 3)
    lengths = rng.uniform(-1, 1, 3)
    return (
        screw(0, angles[0], lengths[0]) @ screw(1, angles[1], lengths[1]) @ screw(2, *angles[2:], 0)
    )


def unit(*numbers: float) -> np.ndarray:
    return np.array(numbers) / np.linalg.norm(numbers)


def behind(T: np.ndarray, numbers) -> np.ndarray:
    return T @ DHRow("j", False, *numbers).matrix()


def assert_on_axis(T: np.ndarray, point: np.ndarray, axis: np.ndarray) -> None:
    np.testing.assert_allclose(T[:3, 2], axis, atol=1e-12)
    np.testing.assert_allclose(cross(T[:3, 3] - point, axis), np.zeros(3), atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_a_row_leads_along_the_common_normal(seed):
    T = frame(seed)
    rng = np.random.default_rng(seed + 100)
    point = rng.uniform(-1, 1, 3)
    axis = unit(*rng.normal(size=3))
    numbers = row_to(T, point, axis, None, PURE)
    after = behind(T, numbers)
    assert_on_axis(after, point, axis)
    assert abs(after[:3, 0] @ T[:3, 2]) < 1e-12
    assert after[:3, 0] @ T[:3, 0] > 0.0
    assert numbers.beta == 0.0


def test_x_points_as_that_of_the_reference():
    T = np.eye(4)
    point, axis = np.array([0.5, 0.0, 0.2]), unit(0.0, 1.0, 1.0)
    row = DHRow("j", prismatic=False, theta=0.0, d=0.2, a=0.5, alpha=-np.pi / 4)
    turned = Reference(row, np.array([-1.0, 0.0, 0.0]), np.eye(4))
    assert row_to(T, point, axis, None, PURE).a == pytest.approx(0.5)
    assert row_to(T, point, axis, turned, PURE).a == pytest.approx(-0.5)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("rounding", [0.0, 1e-10, -1e-10])
def test_a_normal_across_x_points_to_the_next_axis(side, rounding):
    """From an axis along z to one at 45 deg above x, which y is square to, on either side."""
    T = screw(2, rounding, 0.0)
    numbers = row_to(T, np.array([0.0, 0.3 * side, 0.2]), unit(1.0, 0.0, 1.0), None, PURE)
    expected = (side * np.pi / 2, 0.2, 0.3, side * np.pi / 4, 0.0)
    np.testing.assert_allclose(numbers, expected, atol=1e-9)
    # Of axes that meet it points along z x axis.
    numbers = row_to(T, np.array([0.0, 0.0, 0.2]), unit(side, 0.0, 1.0), None, PURE)
    expected = (side * np.pi / 2, 0.2, 0.0, np.pi / 4, 0.0)
    np.testing.assert_allclose(numbers, expected, atol=1e-9)


@pytest.mark.parametrize("tilt", [0.0, 1e-3, -2e-2])
def test_a_tilted_row_to_a_nearly_parallel_axis_has_no_d(tilt):
    T = frame(7)
    axis = T[:3, :3] @ unit(np.sin(tilt), 0.3 * tilt, np.cos(tilt))
    point = T[:3, 3] + T[:3, :3] @ np.array([0.4, 0.1, 0.3])
    numbers = row_to(T, point, axis, None, TILTED)
    assert numbers.d == 0.0
    assert_on_axis(behind(T, numbers), point, axis)
    assert abs(numbers.beta) <= 2 * abs(tilt) + 1e-15


def test_what_counts_as_parallel():
    row = DHRow("j", prismatic=False, theta=0.0, d=0.0, a=1.0, alpha=0.0)
    crossed = DHRow("j", prismatic=False, theta=0.0, d=0.0, a=1.0, alpha=1.0)
    x, tip = np.eye(3)[0], np.eye(4)
    assert PURE.parallel(5e-8, None)
    assert not PURE.parallel(2e-7, None)
    assert not PURE.parallel(2e-7, Reference(row, x, tip))
    assert TILTED.parallel(np.sin(np.radians(2.9)), None)
    assert not TILTED.parallel(np.sin(np.radians(3.1)), None)
    # nearly parallel in one robot is so in the other, on whichever side of 3 deg it lies
    assert TILTED.parallel(np.sin(np.radians(3.1)), Reference(row, x, tip))
    assert not TILTED.parallel(np.sin(np.radians(2.9)), Reference(crossed, x, tip))


@pytest.mark.parametrize("convention", [STANDARD, MODIFIED, HAYATI])
def test_the_last_row_ends_at_a_tip_on_its_axis(convention):
    T = frame(9)
    tip = T @ screw(2, 0.7, 0.25)
    after = behind(T, last_row(T, tip, None, Rule(convention, 1e-7)))
    np.testing.assert_allclose(after, tip, atol=1e-12)


def test_the_last_row_keeps_the_reference_s_a_and_alpha():
    T = frame(9)
    row = DHRow("j", prismatic=False, theta=0.1, d=0.2, a=0.05, alpha=0.01)
    T_n_tip = screw(1, 0.02, 0.1)
    tip = T @ DHRow("j", prismatic=False, theta=0.4, d=0.3, a=0.05, alpha=0.01).matrix() @ T_n_tip
    numbers = last_row(T, tip, Reference(row, np.eye(3)[0], T_n_tip), TILTED)
    np.testing.assert_allclose(numbers, (0.4, 0.3, 0.05, 0.01, 0.0), atol=1e-12)


def test_frame_0_is_nearest_to_the_base():
    T = first_frame(np.array([0.2, 0.3, 5.0]), np.eye(3)[2], np.eye(4))
    np.testing.assert_allclose(T, screw(0, 0.0, 0.2) @ screw(1, 0.0, 0.3), atol=1e-15)
    # an axis along the base's x: x of the frame is then the base's y
    T = first_frame(np.zeros(3), np.eye(3)[0], np.eye(4))
    np.testing.assert_allclose(T[:3, 0], [0.0, 1.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(T[:3, 2], [1.0, 0.0, 0.0], atol=1e-15)


def test_the_product_of_two_vectors():
    a, b = np.array([1.0, 2.0, 3.0]), np.array([-0.5, 0.2, 4.0])
    np.testing.assert_allclose(cross(a, b), np.cross(a, b), atol=1e-15)


@pytest.mark.parametrize("displaced", [False, True])
def test_frame_n_stays_on_the_last_axis_beside_a_tip_that_is_tilted_or_on_it(displaced):
    """Of a standard row; a parallel axis beside it is led to by its common normal."""
    T = frame(9)
    tip = T @ screw(2, 0.7, 0.25)
    if displaced:
        tip = tip @ screw(0, 0.0, 0.1)
    numbers = last_row(T, tip, None, PURE)
    assert numbers.d == pytest.approx(0.25)
    assert abs(numbers.a) == pytest.approx(0.1 if displaced else 0.0, abs=1e-12)
    tilted = tip @ screw(0, 1e-3, 0.0)
    numbers = last_row(T, tilted, None, PURE)
    assert (numbers.a, numbers.alpha) == pytest.approx((0.0, 0.0), abs=1e-15)
