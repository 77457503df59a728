import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.show.camera import look_at, row_direction


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
    half = np.tan(np.deg2rad(camera.fov_deg) / 2) * np.array([16 / 9, 1.0])
    at = local[:, :2] / depth[:, None] / half
    assert np.abs(at[:, 0]).max() < 0.97
    assert at[:, 1].min() > -0.72
    assert at[:, 1].max() < 0.78
    filled = np.ptp(at, axis=0) / [1.9, 1.44]
    assert filled.max() > 0.97
    np.testing.assert_allclose(camera.axes @ camera.axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(camera.axes) == pytest.approx(1.0)
    assert (np.linalg.norm(points - camera.centre, axis=1) <= camera.radius * (1 + 1e-9)).all()


def test_many_points_in_one_plane_are_seen_as_the_few_at_its_corners():
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 21), np.linspace(0, 1, 21), [0.5]), axis=-1)
    points = grid.reshape(-1, 3)
    corners = points[(np.abs(points[:, 0]) == 1) & np.isin(points[:, 1], [0, 1])]
    back = np.array([0.6, 0.8, 0.0])
    many, few = look_at(points, back), look_at(corners, back)
    np.testing.assert_allclose(many.centre, few.centre, rtol=0, atol=1e-12)
    assert many.distance == pytest.approx(few.distance, rel=1e-12)
    assert many.radius == pytest.approx(few.radius, rel=1e-12)


@pytest.mark.parametrize("points", [[[0, 0, 0], [1, 0, 1], [2, 0, 0]], [[0, 0, 0], [0, 0, 1]]])
def test_the_row_is_seen_from_a_horizontal_direction(points):
    back = row_direction(np.array(points, dtype=float))
    assert np.linalg.norm(back) == pytest.approx(1.0)
    assert back[2] == 0
    if points[-1][0]:  # an arm along x reaches to the right on the screen
        right = np.array([-back[1], back[0], 0.0])
        assert right[0] > 0.9
