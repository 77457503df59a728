"""Cameras and boards of a table: the numbers of each row, and the unknowns with their priors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.boards.bodies import tag_of_corners
from calib.camera import optics
from calib.camera.camera import UNKNOWN
from calib.errors import MeasurementError
from calib.fit.registration.table_rows import rows_and_setup
from tests.images import BOARD, BODY, VALUES, arm, camera, cell, poses, table


def unknowns(setup):
    return {u.parameter.name: u for u in setup.internals}


def test_rows_have_the_numbers_of_camera_and_board():
    rows, _ = rows_and_setup(arm(), table(poses(3)), cell())
    values = rows.samples.internals
    count = len(BOARD.corners)
    np.testing.assert_array_equal(values[:, :9], np.tile(VALUES["pinhole"], (3 * count, 1)))
    np.testing.assert_array_equal(values[:, optics.POINT], np.tile(BOARD.corners, (3, 1)))
    np.testing.assert_array_equal(values[:, optics.CORNER], np.tile(np.arange(count), 3))
    np.testing.assert_allclose(values[0, optics.ACROSS], [-1 + 2 / 6, -1 + 2 / 5])


def test_unknowns_are_lens_print_and_corners():
    _, setup = rows_and_setup(arm(), table(poses(3)), cell())
    by_name = unknowns(setup)
    assert len(by_name) == 9 + 4 + 2 * len(BOARD.corners)
    assert by_name["fx"].sigma == pytest.approx(7.0)
    assert by_name["fx"].parameter.nominal == 700.0
    assert by_name["board_scale_x"].sigma == BOARD.sigma_scale
    assert by_name["board_sag_y"].sigma == BOARD.sigma_warp
    assert by_name["corner_3_y"].sigma == BOARD.sigma_corner
    assert by_name["corner_3_y"].parameter.samples == ((optics.BOARD, 0), (optics.CORNER, 3))


def test_corners_of_a_body_are_off_along_all_axes_and_it_does_not_sag():
    _, setup = rows_and_setup(arm(), table(poses(3), board=BODY), cell(boards={"": BODY}))
    by_name = unknowns(setup)
    assert len(by_name) == 9 + 3 + 3 * len(BODY.corners)
    assert by_name["board_scale_z"].parameter.internal == optics.SCALE[2]
    assert by_name["corner_3_z"].sigma == BODY.sigma_corner
    assert by_name["corner_3_z"].parameter.internal == optics.OFFSET[2]


def test_a_board_that_is_not_described_is_a_body_if_its_corners_are_not_in_a_plane():
    _, flat = rows_and_setup(arm(), table(poses(3)), cell(boards={}))
    assert "corner_3_z" not in unknowns(flat)
    assert "board_sag_x" in unknowns(flat)
    _, body = rows_and_setup(arm(), table(poses(3), board=BODY), cell(boards={}))
    assert "corner_3_z" in unknowns(body)
    assert "board_sag_x" not in unknowns(body)


def test_a_body_of_another_size_is_refused():
    larger = replace(
        BODY, tags=tuple(tag_of_corners(n, 1.1 * np.array(tag)) for n, tag in BODY.tags)
    )
    with pytest.raises(MeasurementError, match="33 mm, and the board is described with 30 mm"):
        rows_and_setup(arm(), table(poses(3), board=larger), cell(boards={"": BODY}))


def test_what_is_exact_is_not_estimated():
    exact = camera(sigma=np.zeros(9))
    flat = replace(BOARD, sigma_scale=0.0, sigma_warp=0.0, sigma_corner=0.0)
    _, setup = rows_and_setup(arm(), table(poses(3)), cell(cameras={"": exact}, boards={"": flat}))
    assert setup.internals == ()


def test_a_number_that_is_not_known_has_a_wide_prior():
    sigma = np.array([0.0, 0.0, UNKNOWN, UNKNOWN, UNKNOWN, 0.0, 0.0, 0.0, 0.0])
    _, setup = rows_and_setup(arm(), table(poses(3)), cell(cameras={"": camera(sigma=sigma)}))
    by_name = unknowns(setup)
    assert "fx" not in by_name
    assert by_name["cx"].sigma == 1e4
    assert by_name["k1"].sigma == 10.0


def test_corners_seen_once_have_no_errors_of_their_own():
    m = table(poses(3))
    kept = np.array([c != "5" or i == "0.png" for c, i in zip(m.corners, m.images, strict=True)])
    _, setup = rows_and_setup(arm(), m.select(kept), cell())
    assert "corner_5_x" not in unknowns(setup)
    assert "corner_4_x" in unknowns(setup)


def test_corners_without_names_are_named_by_their_places():
    m = table(poses(3))
    _, setup = rows_and_setup(arm(), replace(m, corners=()), cell())
    assert "corner_30/30_x" in unknowns(setup)
    _, setup = rows_and_setup(
        arm(), replace(table(poses(3), board=BODY), corners=()), cell(boards={"": BODY})
    )
    assert "corner_75/60/-20_z" in unknowns(setup)


def test_intrinsics_of_which_nothing_is_known_start_at_those_of_the_images():
    unknown = camera(values=None)
    rows, setup = rows_and_setup(arm(), table(poses(8)), cell(cameras={"": unknown}))
    np.testing.assert_allclose(rows.samples.internals[0, :2], VALUES["pinhole"][:2], rtol=0.02)
    assert unknowns(setup)["fx"].sigma == 1e4


def test_a_board_that_moved_is_one_print():
    m = table(poses(4))
    moved = replace(m, targets=tuple("a" if int(i[0]) < 2 else "b" for i in m.images))
    _, setup = rows_and_setup(arm(), moved, cell())
    assert [n for n in unknowns(setup) if n.startswith("board_scale")] == [
        "board_scale_x",
        "board_scale_y",
    ]
    _, apart = rows_and_setup(arm(), moved, cell(boards={"a": BOARD, "b": BOARD}))
    assert "board_scale_x[a]" in unknowns(apart)
    assert "board_scale_x[b]" in unknowns(apart)


def test_a_camera_of_which_nothing_is_said_is_refused():
    with pytest.raises(MeasurementError, match="--camera"):
        rows_and_setup(arm(), table(poses(3)), cell(cameras={}))


def test_corners_outside_of_the_image_are_refused_with_their_row():
    m = table(poses(3))
    outside = np.flatnonzero(m.reading("u") > 1.01 * 1500)[0]
    with pytest.raises(MeasurementError, match=f"row {outside + 1}:") as refused:
        rows_and_setup(arm(), m, cell(cameras={"": camera(values=None, width=1500)}))
    assert "1500 x 2000" in str(refused.value)


def test_intrinsics_of_another_resolution_are_refused():
    doubled = VALUES["pinhole"] * [2, 2, 2, 2, 1, 1, 1, 1, 1]
    with pytest.raises(MeasurementError, match="cx = 2400"):
        rows_and_setup(arm(), table(poses(3)), cell(cameras={"": camera(values=doubled)}))


@pytest.mark.parametrize("factor", [0.96, 1.005])
def test_a_table_made_with_another_square_is_refused(factor):
    other = replace(BOARD, square=factor * BOARD.square, marker=factor * BOARD.marker)
    with pytest.raises(MeasurementError, match="calib detect"):
        rows_and_setup(arm(), table(poses(3)), cell(boards={"": other}))
    # How well the square is known may change, and its digits.
    same = replace(BOARD, square=BOARD.square * (1.0 + 1e-5), sigma_scale=0.01)
    rows_and_setup(arm(), table(poses(3)), cell(boards={"": same}))


def test_a_single_corner_tells_no_square():
    m = table(poses(8))
    one = m.select([name == "2" for name in m.corners])
    rows_and_setup(arm(), one, cell())


def test_corners_by_other_names_or_at_other_places_are_not_compared():
    m = table(poses(3))
    other = replace(BOARD, square=0.5 * BOARD.square, marker=0.5 * BOARD.marker)
    named = replace(m, corners=tuple(f"c{name}" for name in m.corners))
    rows_and_setup(arm(), named, cell(boards={"": other}))
    reversed_names = replace(m, corners=tuple(str(len(BOARD.corners) - int(n)) for n in m.corners))
    rows_and_setup(arm(), reversed_names, cell(boards={"": other}))


def test_corners_of_one_image_are_no_repeats_and_are_held_out_together():
    rows, _ = rows_and_setup(arm(), table(poses(3)), cell())
    assert len(np.unique(rows.poses)) == len(rows)
    assert len(np.unique(rows.blocks)) == 3
