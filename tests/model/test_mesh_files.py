"""Mesh files, valid and abused: read, or said to be wrong, in bounded time and memory, nothing else opened."""

from __future__ import annotations

import struct
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh

from calib.model.mesh_files import KINDS, MeshFault, read_triangles

SQUARE = "v 0 0 0\nv 2 0 0\nv 2 1 0\nv 0 1 0\n"


def written(folder: Path, name: str, data: bytes | str) -> Path:
    path = folder / name
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return path


def dae(geometry: str = "", scene: str = "", head: str = "", nodes: str = "") -> str:
    """A COLLADA file with the geometry of a triangle."""
    points = (
        '<source id="s"><float_array id="f" count="9">0 0 0 1 0 0 0 1 0</float_array><technique_common>'
        '<accessor source="#f" count="3" stride="3"/></technique_common></source>'
        '<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>'
    )
    shape = geometry or (
        '<triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles>'
    )
    instance = scene or '<node id="n"><instance_geometry url="#g"/></node>'
    return (
        f'{head}<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema"><asset><unit meter="0.5"/></asset>'
        f'<library_geometries><geometry id="g"><mesh>{points}{shape}</mesh></geometry></library_geometries>'
        f'<library_nodes>{nodes}</library_nodes><library_visual_scenes><visual_scene id="w">{instance}'
        '</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#w"/></scene></COLLADA>'
    )


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != ".dae"])
def test_each_kind_is_read_as_trimesh_writes_it(tmp_path: Path, kind: str):
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    path = tmp_path / f"box{kind}"
    box.export(path)
    vertices, faces = read_triangles(path)
    assert faces.shape == (12, 3)
    corners = np.unique(vertices.round(6), axis=0)
    np.testing.assert_allclose(corners, np.unique(box.vertices, axis=0), atol=1e-6)


def test_stl_as_text_and_as_bytes_that_begin_like_text(tmp_path: Path):
    triangle = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype="<f4")
    record = bytes(12) + triangle.tobytes() + bytes(2)
    data = b"solid ".ljust(80) + struct.pack("<I", 1) + record
    for name, content in (("b.stl", data), ("B.STL", data + b"more")):
        np.testing.assert_array_equal(read_triangles(written(tmp_path, name, content))[0], triangle)
    lines = "".join(f"vertex {x:e} {y:g} {z:g}\r\n" for x, y, z in triangle)
    text = f"  solid\r\n facet normal 0 0 1\r\nouter loop\r\n{lines}endloop endfacet endsolid"
    np.testing.assert_array_equal(read_triangles(written(tmp_path, "t.stl", text))[0], triangle)


def test_obj_with_polygons_and_indices_of_all_kinds(tmp_path: Path):
    for face in (
        "f 1 2 3 4",
        "f 1/1 2/1 3/1 4/1",
        "f 1//9 2//9 3//9 4//9",
        "f -4 -3 -2 -1",
        "f 1 2 \\\n 3 4",
    ):
        text = f"mtllib /dev/zero\nmtllib ../x.mtl\n{SQUARE}usemtl a\nvt 0 0\nl 1 2\n{face}\n#f 1 1 1\n"
        vertices, faces = read_triangles(written(tmp_path, "s.obj", text))
        assert faces.tolist() == [[0, 1, 2], [0, 2, 3]]
        assert np.ptp(vertices, axis=0).tolist() == [2, 1, 0]


POLYGONS = {
    "polylist": '<polylist count="2"><input semantic="VERTEX" source="#v" offset="1"/><input semantic="NORMAL" '
    'source="#x" offset="0"/><vcount>3 2</vcount><p>0 0 9 1 0 2 0 0 0 1</p></polylist>',
    "polygons": '<polygons count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></polygons>',
    "tristrips": '<tristrips count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></tristrips>',
    "trifans": '<trifans count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></trifans>',
}


@pytest.mark.parametrize("geometry", ["", *POLYGONS.values()], ids=["triangles", *POLYGONS])
def test_polygons_of_collada(tmp_path: Path, geometry: str):
    vertices, faces = read_triangles(written(tmp_path, "a.dae", dae(geometry)))
    assert faces.tolist() == [[0, 1, 2]]
    np.testing.assert_array_equal(vertices, [[0, 0, 0], [0.5, 0, 0], [0, 0.5, 0]])


def test_nodes_of_collada(tmp_path: Path):
    inner = '<node id="m"><rotate>0 0 1 90</rotate><scale>2 2 2</scale><instance_geometry url="#g"/></node>'
    scene = '<node><matrix>1 0 0 0 0 1 0 0 0 0 1 4 0 0 0 1</matrix><instance_node url="#m"/></node>'
    scene += '<node><translate>9 0 0</translate><node><instance_geometry url="#g"/></node></node>'
    vertices, faces = read_triangles(written(tmp_path, "a.dae", dae(scene=scene, nodes=inner)))
    expected = [[0, 0, 2], [0, 1, 2], [-1, 0, 2], [4.5, 0, 0], [5, 0, 0], [4.5, 0.5, 0]]
    np.testing.assert_allclose(vertices, expected, atol=1e-15)
    assert faces.tolist() == [[0, 1, 2], [3, 4, 5]]


HOLDS_ITSELF = '<node id="m"><instance_node url="#m"/></node>'
DOUBLES = "".join(
    f'<node id="n{i}">' + (f'<instance_node url="#n{i - 1}"/>' * 10 if i else "") + "</node>"
    for i in range(12)
)
ABUSED: dict[str, tuple[str, bytes | str, str]] = {
    "count of 4e9": ("a.stl", bytes(80) + b"\xff\xff\xff\xff" + bytes(50), "cannot be read"),
    "text cut off": ("a.stl", "solid a\nfacet\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n", "cannot be read"),
    "text without numbers": ("a.stl", "solid a\nfacet\nvertex a b c\n", "cannot be read"),
    "nothing": ("a.stl", b"", "cannot be read"),
    "face of no vertex": ("a.obj", f"{SQUARE}f 1 2 5\n", "has faces of vertices that it does not have"),
    "face of vertex 0": ("a.obj", "f 0 0 0\n", "has faces of vertices"),
    "face too far back": ("a.obj", f"{SQUARE}f -1 -2 -5\n", "has faces of vertices"),
    "number of 5000 digits": ("a.obj", f"{SQUARE}f 1 2 {'9' * 5000}\n", "cannot be read"),
    "number of 30 digits": ("a.obj", f"{SQUARE}f 1 2 {'9' * 30}\n", "cannot be read"),
    "two coordinates": ("a.obj", "v 1 2\n", "cannot be read"),
    "not xml": ("a.dae", "<COLLADA>", "cannot be read"),
    "an encoding that is none": ("a.dae", '<?xml version="1.0" encoding="x"?><a/>', "cannot be read"),
    "deep": ("a.dae", "<a>" * 1000 + "</a>" * 1000, "more than 100 in one another"),
    "many elements": ("a.dae", "<a>" + "<b/>" * 500_001 + "</a>", "has more than 500,000 elements"),
    "node in itself": ("a.dae", dae(scene=HOLDS_ITSELF), "has nodes that hold one another"),
    "nodes that double": (
        "a.dae", dae(scene='<node><instance_node url="#n11"/></node>', nodes=DOUBLES), "has nodes that hold",
    ),
    "another file": (
        "a.dae", dae(scene='<node><instance_geometry url="file:///etc/x.dae#g"/></node>'), "has no <geometry>",
    ),
    "polygons of many corners": (
        "a.dae", dae(POLYGONS["polylist"].replace("3 2", "3 999999999999")), "cannot be read",
    ),
    "polygons of minus corners": ("a.dae", dae(POLYGONS["polylist"].replace("3 2", "3 -2")), "cannot be read"),
    "offset": ("a.dae", dae(POLYGONS["polylist"].replace('"1"', '"999999999"')), "cannot be read"),
    "vertices that are none": ("a.dae", dae(POLYGONS["polygons"].replace("#v", "#s")), "has no <vertices> '#s'"),
    "a document type": ("a.dae", dae(head="<!DOCTYPE a>"), "has a <!DOCTYPE>"),
    "ply of 4e9 vertices": (
        "a.ply", "ply\nformat ascii 1.0\nelement vertex 4000000000\nproperty float x\nend_header\n", "cannot be read",
    ),
    "glb that names a file": (
        "a.glb",
        b"glTF\x02\0\0\0\x5c\0\0\0\x48\0\0\0JSON"
        + b'{"asset":{"version":"2.0"},"buffers":[{"uri":"/etc/passwd","byteLength":9}]}'[:72].ljust(72),
        "cannot be read",
    ),
    "glTF": ("a.gltf", "{}", "is of a kind that is not read; save it as one of .stl, .obj, .dae, .ply"),
    "no ending": ("passwd", "root:x", "is of a kind that is not read"),
}  # fmt: skip


@pytest.mark.parametrize(("name", "data", "words"), ABUSED.values(), ids=ABUSED)
def test_abused(tmp_path: Path, name: str, data: bytes | str, words: str):
    path = written(tmp_path, name, data)
    start = time.process_time()
    with pytest.raises(MeshFault) as fault:
        read_triangles(path)
    assert words in str(fault.value)
    assert time.process_time() - start < 5.0


def test_what_is_no_file(tmp_path: Path):
    for name in ("folder.stl", "none.stl", "device.stl"):
        if name == "folder.stl":
            (tmp_path / name).mkdir()
        if name == "device.stl":
            (tmp_path / name).symlink_to("/dev/zero")
        with pytest.raises(MeshFault, match="cannot be read"):
            read_triangles(tmp_path / name)
