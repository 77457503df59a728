from __future__ import annotations

import meshcat
import numpy as np
import pytest
import umsgpack
from hypothesis import given, settings, strategies as st
from meshcat import geometry as mc

from calib.viewer.scene import (
    FOV_DEG,
    PackedGeometry,
    SceneWindow,
    look_at,
    row_direction,
    without_shadow,
)
from calib.viewer.shapes import shaded

TRIANGLE = shaded(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))


def scene_of(draw):
    window = SceneWindow()
    draw(meshcat.Visualizer(window=window))
    return umsgpack.unpackb(window.scene())


def test_a_shape_drawn_twice_is_stored_once():
    def draw(scene):
        scene["one"].set_object(PackedGeometry(TRIANGLE))
        scene["two"].set_object(PackedGeometry(TRIANGLE))
        scene["ball"].set_object(mc.Sphere(0.5))

    scene = scene_of(draw)
    objects = [c["object"] for c in scene["commands"]]
    assert len(objects) == 3
    assert len(scene["geometries"]) == 2
    for lowered in objects:
        (name,) = lowered["geometries"]
        assert scene["geometries"][name]["uuid"] == name
        assert lowered["object"]["geometry"] == name
        assert lowered["object"]["material"] == lowered["materials"][0]["uuid"]
    assert objects[0]["geometries"] == objects[1]["geometries"]
    assert objects[0]["object"]["uuid"] != objects[1]["object"]["uuid"]


def test_triangles_are_packed_as_they_are():
    scene = scene_of(lambda root: root["t"].set_object(PackedGeometry(TRIANGLE)))
    (geometry,) = scene["geometries"].values()
    data = geometry["data"]
    position = np.frombuffer(data["attributes"]["position"]["array"].data, "<f4")
    np.testing.assert_array_equal(position.reshape(-1, 3), TRIANGLE.vertices)
    normal = np.frombuffer(data["attributes"]["normal"]["array"].data, np.int8)
    np.testing.assert_array_equal(normal.reshape(-1, 3), [[0, 0, 127]] * 3)
    assert data["attributes"]["normal"]["normalized"] is True
    index = np.frombuffer(data["index"]["array"].data, "<u2")
    np.testing.assert_array_equal(index.reshape(-1, 3), TRIANGLE.faces)


def test_the_last_object_and_transform_count_and_properties_follow_the_object():
    def draw(scene):
        scene["a"].set_object(mc.Box([1, 1, 1]))
        scene["a"].set_property("visible", False)
        scene["a"].set_object(mc.Box([2, 2, 2]))
        scene["a"].set_transform(np.eye(4))
        scene["a"].set_transform(2 * np.eye(4))
        without_shadow(scene["a"])

    commands = scene_of(draw)["commands"]
    assert [c["type"] for c in commands] == ["set_object", "set_transform", "set_property"]
    assert commands[1]["matrix"][0] == 2
    assert commands[2] == {
        "type": "set_property",
        "path": "/meshcat/a/<object>",
        "property": "castShadow",
        "value": False,
    }


def test_the_same_scene_is_the_same_bytes():
    def draw(scene):
        scene["a"].set_object(mc.Box([1, 1, 1]), mc.MeshPhongMaterial(color=0xFF0000))

    assert scene_of(draw) == scene_of(draw)


@settings(max_examples=50, deadline=None)
@given(
    seed=st.integers(0, 1000),
    size=st.floats(0.01, 100.0),
    angle=st.floats(0, 7),
    count=st.sampled_from([50, 500]),
)
def test_all_points_are_in_view_and_fill_it(seed, size, angle, count):
    rng = np.random.default_rng(seed)
    points = size * (rng.normal(size=(count, 3)) * [2, 1, 1] + rng.normal(size=3) * 10)
    camera = look_at(points, np.array([np.cos(angle), np.sin(angle), 0.0]))
    local = (points - camera.centre) @ camera.axes.T
    depth = camera.distance - local[:, 2]
    assert (depth > 0.02 * size).all()
    half = np.tan(np.deg2rad(FOV_DEG) / 2) * np.array([16 / 9, 1.0])
    at = local[:, :2] / depth[:, None] / half
    assert np.abs(at[:, 0]).max() < 0.97
    assert at[:, 1].min() > -0.72
    assert at[:, 1].max() < 0.78
    filled = np.ptp(at, axis=0) / [1.9, 1.44]
    assert filled.max() > 0.97
    np.testing.assert_allclose(camera.axes @ camera.axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(camera.axes) == pytest.approx(1.0)
    assert (np.linalg.norm(points - camera.centre, axis=1) <= camera.radius * (1 + 1e-9)).all()


@pytest.mark.parametrize("points", [[[0, 0, 0], [1, 0, 1], [2, 0, 0]], [[0, 0, 0], [0, 0, 1]]])
def test_the_row_is_seen_from_a_horizontal_direction(points):
    back = row_direction(np.array(points, dtype=float))
    assert np.linalg.norm(back) == pytest.approx(1.0)
    assert back[2] == 0
    if points[-1][0]:  # an arm along x reaches to the right on the screen
        right = np.array([-back[1], back[0], 0.0])
        assert right[0] > 0.9
