"""The study of bodies in the hand: exact without noise, by a truth that is Pinocchio's alone."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from tests.places import ROOT

sys.path.insert(0, str(ROOT / "scripts"))
import body_study as study


@pytest.mark.slow
@pytest.mark.parametrize("body", [study.cube, study.icosahedron])
def test_a_body_is_recovered_through_the_written_urdf(body):
    rng = np.random.default_rng(45)
    exact = study.replace(body(), sigma_scale=0.0, sigma_corner=0.0)
    scene = study.draw_scene(exact, exact.corners, rng)
    result = scene.calibrated(scene.measured(rng, 0.0))
    assert study.errors_through_files(scene, result, rng) < 1e-8


def test_an_icosahedron_has_twenty_tags_around_its_middle():
    corners = study.icosahedron().corners.reshape(20, 4, 3)
    middles = corners.mean(axis=1)
    np.testing.assert_allclose(np.linalg.norm(middles, axis=1), 0.06)
    into = np.cross(corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0])
    assert np.all(np.sum(into * middles, axis=1) < 0.0)
