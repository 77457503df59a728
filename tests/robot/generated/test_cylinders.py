"""Cylinders that draw links and joints: their places and sizes."""

from __future__ import annotations

import numpy as np
import pytest

from calib.robot.generated.cylinders import GREY, bar, joint_body, link_radii, rods


def translations(*lengths: float) -> list[np.ndarray]:
    poses = np.tile(np.eye(4), (len(lengths), 1, 1))
    poses[:, 0, 3] = lengths
    return list(poses)


def test_links_get_thinner_towards_the_tip():
    radii = link_radii(translations(0.5, 0.3, 0.2))
    np.testing.assert_allclose(radii, [0.035, 0.018])
    # A robot whose joints are all in one place can be seen, too.
    np.testing.assert_allclose(link_radii(translations(0.0, 0.0, 0.0)), [0.0035, 0.0018])


def test_rods_lie_between_the_points_of_a_path():
    path = [np.zeros(3), np.array([0.0, 0.4, 0.0]), np.array([0.3, 0.4, 0.0])]
    first, second = rods(path, 0.05)
    assert (first.length, second.length) == (pytest.approx(0.4), pytest.approx(0.3))
    for rod, start, end in ((first, path[0], path[1]), (second, path[1], path[2])):
        T = rod.T_link_cylinder
        half = 0.5 * rod.length * T[:3, 2]
        np.testing.assert_allclose(T[:3, 3] + half, end, atol=1e-12)
        np.testing.assert_allclose(T[:3, 3] - half, start, atol=1e-12)
        assert (rod.radius, rod.colour) == (0.05, GREY)


def test_what_lies_inside_a_joint_is_not_drawn():
    assert list(rods([np.zeros(3), np.array([0.0, 0.0, 0.02])], 0.05)) == []


def test_a_joint_is_thicker_than_its_link_and_centred():
    body = joint_body(0.1)
    assert (body.radius, body.length) == (pytest.approx(0.13), pytest.approx(0.28))
    np.testing.assert_allclose(body.T_link_cylinder, np.eye(4))
    assert bar(-0.1, 0.5, 0.02, GREY).T_link_cylinder[2, 3] == pytest.approx(0.2)
