"""A scene is the same bytes twice, holds a shape once, and its camera sees all of it."""

from __future__ import annotations

import meshcat
import numpy as np
import pytest
import umsgpack
from meshcat import geometry as mc

from calib.show.scene.scene import (
    _FOV_DEG,
    SceneWindow,
    blended,
    look_at,
    rod_between,
)


def scene_of(draw):
    window = SceneWindow()
    draw(meshcat.Visualizer(window=window))
    return umsgpack.unpackb(window.scene())


def test_a_shape_drawn_twice_is_stored_once():
    def draw(scene):
        for name in ("one", "two"):
            scene[name].set_object(mc.TriangularMeshGeometry(np.eye(3), np.array([[0, 1, 2]])))
        scene["ball"].set_object(mc.Sphere(0.5))

    scene = scene_of(draw)
    assert scene_of(draw) == scene
    objects = [c["object"] for c in scene["commands"]]
    assert (len(objects), len(scene["geometries"])) == (3, 2)
    for lowered in objects:
        (name,) = lowered["geometries"]
        assert scene["geometries"][name]["uuid"] == lowered["object"]["geometry"] == name
        assert lowered["object"]["material"] == lowered["materials"][0]["uuid"]
    assert objects[0]["object"]["uuid"] != objects[1]["object"]["uuid"]


@pytest.mark.parametrize(("size", "angle"), [(0.01, 0.3), (1.0, 2.0), (100.0, 5.0)])
def test_all_points_are_in_view_and_fill_it(size, angle):
    rng = np.random.default_rng(int(size))
    points = size * (rng.normal(size=(200, 3)) * [2, 1, 1] + rng.normal(size=3) * 10)
    camera = look_at(points, np.array([np.cos(angle), np.sin(angle), 0.0]))
    local = (points - camera.centre) @ camera.axes.T
    depth = camera.distance - local[:, 2]
    assert (depth > 0.02 * size).all()
    half = np.tan(np.deg2rad(_FOV_DEG) / 2) * np.array([16 / 9, 1.0])
    at = local[:, :2] / depth[:, None] / half
    assert np.abs(at[:, 0]).max() < 0.97
    assert -0.72 < at[:, 1].min() < at[:, 1].max() < 0.78
    assert (np.ptp(at, axis=0) / [1.9, 1.44]).max() > 0.97
    np.testing.assert_allclose(camera.axes @ camera.axes.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("end", [[0, 0, 2.0], [0, 0, -2.0], [1.0, -2.0, 0.5]])
def test_a_rod_lies_between_its_ends(end):
    start, end = np.array([0.3, 0.1, -0.2]), np.array(end)
    T = rod_between(start, end)
    np.testing.assert_allclose((T @ [0, 0, 0.5, 1])[:3], end, atol=1e-12)
    np.testing.assert_allclose((T @ [0, 0, -0.5, 1])[:3], start, atol=1e-12)


def test_colours_are_blended_along_the_scale():
    colours = blended(("#000000", "#ff0000", "#ffffff"), np.array([0.0, 0.25, 0.5, 1.0]))
    np.testing.assert_allclose(colours, [[0, 0, 0], [0.5, 0, 0], [1, 0, 0], [1, 1, 1]])
