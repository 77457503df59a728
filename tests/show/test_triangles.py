import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from calib.show.triangles import clustered, shaded

CUBE = np.array(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij")).reshape(3, -1).T.astype(float)
CUBE_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip


def cylinder(sides: int) -> tuple[np.ndarray, np.ndarray]:
    """The side wall of a cylinder about z, its faces outward."""
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    i = np.arange(sides)
    j = (i + 1) % sides
    faces = np.concatenate([np.stack([i, j, j + sides], 1), np.stack([i, j + sides, i + sides], 1)])
    return np.concatenate([ring, ring + np.array([0, 0, 1])]), faces


def test_a_cube_keeps_its_edges():
    mesh = shaded(CUBE, CUBE_FACES)
    assert len(mesh.vertices) == 24  # each corner once for each of its three faces
    assert len(mesh.faces) == 12
    # The normals are those of the faces, outward.
    corners = mesh.vertices[mesh.faces].astype(float)
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    for k in range(3):
        np.testing.assert_array_equal(mesh.normals[mesh.faces[:, k]], 127 * flat)
    outward = np.einsum("ij,ij->i", mesh.vertices - 0.5, mesh.normals)
    assert (outward > 0).all()


def test_a_fine_cylinder_is_smooth_and_a_coarse_one_is_not():
    vertices, faces = cylinder(36)
    smooth = shaded(vertices, faces)
    assert len(smooth.vertices) == 72
    radial = smooth.vertices * [1, 1, 0]
    np.testing.assert_allclose(smooth.normals / 127.0, radial, atol=0.02)
    assert len(shaded(*cylinder(6)).vertices) == 24  # turned by 60 deg: every corner twice


def test_equal_vertices_are_welded_and_slivers_left_out():
    soup = CUBE[CUBE_FACES].reshape(-1, 3)
    faces = np.arange(36).reshape(-1, 3)
    extra = np.array([[0, 0, 1], [0, 1, 1]])
    mesh = shaded(soup, np.concatenate([faces, extra]))
    reference = shaded(CUBE, CUBE_FACES)
    assert len(mesh.vertices) == 24
    assert len(mesh.faces) == len(reference.faces)


def test_a_fan_with_very_many_faces_has_unit_normals():
    vertices, _ = cylinder(2000)
    top = np.concatenate([vertices[2000:], [[0, 0, 1]]])
    i = np.arange(2000)
    mesh = shaded(top, np.stack([i, (i + 1) % 2000, 0 * i + 2000], 1))
    np.testing.assert_array_equal(mesh.normals, np.tile([0, 0, 127], (len(mesh.normals), 1)))


def test_large_meshes_have_wide_indices():
    n = 200
    x, y = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    vertices = np.stack([x, y, np.sin(x) * 20 + np.cos(y) * 20], -1).reshape(-1, 3).astype(float)
    i = (x[:-1, :-1] * n + y[:-1, :-1]).ravel()
    faces = np.concatenate([np.stack([i, i + n, i + n + 1], 1), np.stack([i, i + n + 1, i + 1], 1)])
    mesh = shaded(vertices, faces)
    assert len(mesh.vertices) > 65536
    assert mesh.faces.dtype == np.uint32
    assert mesh.faces.max() == len(mesh.vertices) - 1
    assert shaded(CUBE, CUBE_FACES).faces.dtype == np.uint16


@pytest.mark.parametrize("name", ["vertices", "normals", "faces"])
def test_arrays_cannot_be_written_to(name):
    with pytest.raises(ValueError, match="read-only"):
        getattr(shaded(CUBE, CUBE_FACES), name)[0, 0] = 1


@settings(max_examples=30, deadline=None)
@given(most=st.integers(60, 700), seed=st.integers(0, 99))
def test_clustering_moves_no_vertex_farther_than_it_says(most, seed):
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(400, 3))
    vertices = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    faces = ConvexHull(vertices).simplices.astype(np.int64)
    assert len(faces) > 700
    fewer, merged, cell = clustered(vertices, faces, most)
    assert cell > 0
    assert 0 < len(merged) <= most
    distance = np.linalg.norm(vertices[:, None] - fewer[None], axis=2).min(axis=1)
    assert distance.max() <= np.sqrt(3) * cell * (1 + 1e-9)


def test_a_small_mesh_is_left_alone():
    vertices, faces, cell = clustered(CUBE, CUBE_FACES, 12)
    assert cell == 0
    assert vertices is CUBE
    assert faces is CUBE_FACES


def test_faces_without_area_leave_nothing():
    line = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    mesh = shaded(line, np.array([[0, 1, 2]]))
    assert (mesh.vertices.shape, mesh.normals.shape, mesh.faces.shape) == ((0, 3),) * 3


def test_many_faces_at_one_vertex_take_bounded_memory():
    """Sixty thousand equal faces: each corner is compared with few others."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.tile([[0, 1, 2], [0, 2, 3]], (30_000, 1))
    mesh = shaded(corners, faces)
    assert mesh.faces.shape == (60_000, 3)
    lengths = np.linalg.norm(mesh.normals.astype(float), axis=1)
    np.testing.assert_allclose(lengths, 127.0, atol=1.5)


def test_a_needle_has_the_normal_of_its_face():
    corners = np.array([[0.0, 0, 0], [1e6, 0, 0], [1e6, 1e-3, 0]])
    mesh = shaded(corners, np.array([[0, 1, 2]]))
    np.testing.assert_array_equal(mesh.normals, [[0, 0, 127]] * 3)
