import meshcat
import numpy as np
import umsgpack
from meshcat import geometry as mc

from calib.show.shapes import shaded
from calib.show.window import (
    PackedGeometry,
    SceneWindow,
    viewer_licences,
    viewer_script,
    without_shadow,
)

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


def test_the_viewer_comes_with_its_notices():
    assert "MeshCat" in viewer_script()
    licences = viewer_licences()
    for holder in ("Robin Deits", "mrdoob", "Google Inc.", "Permission is hereby granted"):
        assert holder in licences
