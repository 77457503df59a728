"""The corners that cameras saw: predictions, derivatives, and where the boards were."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.boards.board import unfolded
from calib.camera.lenses import LENSES
from calib.result.calibrate import calibrate
from calib.verbs.calibrate.figure_images import corner_errors
from calib.verbs.calibrate.seen_corners import image_rows, seen_corners
from tests.images import BOARD, BODY, arm, cell, poses, table
from tests.verbs.calibrate.seen import by_images, corners


def test_corners_are_those_of_the_table_and_their_images_are_predicted():
    c = by_images()
    (seen,) = seen_corners(c)
    assert image_rows(c).all()
    assert len(seen) == len(c.fit.measurements) == 10 * len(BOARD.corners)
    assert {name: len(at) for name, at in seen.by_image.items()} == {
        f"{k}.png": len(BOARD.corners) for k in range(10)
    }
    np.testing.assert_allclose(seen.designed, np.tile(BOARD.corners, (10, 1)))
    projected = LENSES["pinhole"].project(seen.points, c.optics.cameras[""].values)
    np.testing.assert_allclose(seen.measured - projected, seen.calibrated, atol=1e-6)
    np.testing.assert_array_equal(seen.held_out, c.cross_validation.residual[:, :2])


def test_corners_of_a_body_are_on_a_sheet_and_its_views_face_as_its_tags():
    m = table(poses(8), board=BODY, noise=0.1)
    c = calibrate(arm(), m, cell=cell(boards={"": BODY}, model="zeros"), validate=False)
    (seen,) = seen_corners(c)
    places, R = unfolded(BODY)
    np.testing.assert_array_equal(seen.on_sheet[:20], places)
    np.testing.assert_array_equal(seen.R_board_sheet[:20], R)
    tilt, _, _ = seen.board_views()
    # The first tag is in the x-y plane, and the others are turned away from it evenly.
    normal = seen.T_camera_board[0, :3, 2]
    middle = seen.points[:20].mean(axis=0)
    assert tilt[0] == pytest.approx(np.arccos(normal @ middle / np.linalg.norm(middle)), abs=1e-6)
    on_sheet, printed, residual = corner_errors([seen], "pyramid")
    assert on_sheet.shape == residual.shape == (20, 2)
    # Errors of the print along the axes of the tags.
    of_body = seen.printed[:20] - seen.designed[:20]
    of_body -= of_body.mean(axis=0)
    np.testing.assert_allclose(printed[7], R[7].T @ of_body[7], atol=1e-12)


def test_a_displacement_of_a_corner_in_the_camera_displaces_its_image():
    c = by_images()
    (seen,) = seen_corners(c)
    by = np.array([1e-5, -2e-5, 3e-5])
    project, values = LENSES["pinhole"].project, c.optics.cameras[""].values
    change = project(seen.points + by, values) - project(seen.points, values)
    np.testing.assert_allclose(seen.by_point @ by, change, atol=1e-4)


def test_residuals_of_a_corner_are_a_displacement_along_its_board():
    """The board is turned by 30 deg about the line of sight, so its x is neither u nor v."""
    turned = np.tile(np.eye(4), (2, 1, 1))
    turned[:, :3, :3] = Rotation.from_euler("z", 30, degrees=True).as_matrix()
    displaced = 2000.0 * turned[0, :2, :2] @ [1e-4, -3e-4]
    seen = corners([displaced, displaced], T_camera_board=turned)
    along = seen.along_board(np.array([0, 1]), seen.calibrated)
    np.testing.assert_allclose(along, [1e-4, -3e-4])


@pytest.mark.parametrize(
    ("axis", "angle", "facing"),
    [("y", 20.0, 180.0), ("y", -20.0, 0.0), ("x", 20.0, 90.0), ("x", -20.0, -90.0)],
)
def test_a_tilted_board_faces_to_a_side_of_the_image(axis, angle, facing):
    """Its z points into the page: turned about y (down in the image) by 20 deg, its front looks to the left."""
    T = np.tile(np.eye(4), (2, 1, 1))
    T[:, :3, :3] = Rotation.from_euler(axis, angle, degrees=True).as_matrix()
    T[:, :3, 3] = [0.0, 0.0, 0.5]
    middle = np.zeros((2, 3))
    tilt, direction, distance = corners(
        np.zeros((2, 2)), T_camera_board=T, printed=middle
    ).board_views()
    assert np.degrees(tilt) == pytest.approx([20.0])
    assert np.exp(1j * direction) == pytest.approx(np.exp(1j * np.radians([facing])))
    assert distance == pytest.approx([0.5])


def test_a_view_is_one_board_in_one_image():
    seen = corners(np.zeros((4, 2)), images=("a", "a", "b", "b"))
    seen = replace(seen, boards=("one", "two", "one", "one"))
    assert [len(values) for values in seen.board_views()] == [3, 3, 3]
    assert {name: at.tolist() for name, at in seen.of_board("one").items()} == {
        "0": [0],
        "2": [2],
        "3": [3],
    }
