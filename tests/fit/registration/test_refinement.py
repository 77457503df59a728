"""Starts of a registration: one by orientations, else targets along each axis and frames by quarter turns."""

from __future__ import annotations

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.fit.registration.refinement import find_starts
from calib.fit.registration.table_rows import rows_and_setup


def starts(scene, table, cell):
    rows, setup = rows_and_setup(scene.robot, table, cell)
    return find_starts(setup, scene.robot.poses(rows.joints), rows), setup


def test_orientations_give_one_start(make_scene):
    scene = make_scene(0)
    found, _ = starts(scene, scene.poses(8), Cell(estimate_frame=True))
    assert len(found) == 1


def test_a_target_is_tried_near_and_far_along_each_axis(make_scene):
    scene = make_scene(1)
    found, _ = starts(scene, scene.points(8), Cell(estimate_frame=True))
    places = np.array([start.T_tip_target[0, :3, 3] for start in found])
    assert len(found) == 1 + 2 * 6
    np.testing.assert_allclose(np.linalg.norm(places[1:], axis=1), [0.15] * 6 + [0.7] * 6)
    assert len(np.unique(np.round(places, 9), axis=0)) == 13


@pytest.mark.parametrize(("given", "count"), [(True, 14), (False, 1)])
def test_a_given_target_is_kept_or_tried_at_the_tip_too(make_scene, given, count):
    scene = make_scene(2)
    cell = Cell(target=np.array([0.1, 0.0, 0.2]), estimate_target=given, estimate_frame=True)
    found, setup = starts(scene, scene.points(8), cell)
    assert len(found) == count
    np.testing.assert_array_equal(found[0].T_tip_target, setup.T_tip_target)


def test_a_frame_on_the_floor_is_turned_by_quarters(make_scene):
    scene = make_scene(3)
    cell = Cell(
        target=np.array([0.1, 0.0, 0.2]),
        estimate_target=False,
        estimate_frame=True,
        frame_directions=("x", "y", "rz"),
    )
    found, _ = starts(scene, scene.points(8), cell)
    angles = [
        np.arctan2(start.T_frame_base[0, 1, 0], start.T_frame_base[0, 0, 0]) for start in found
    ]
    np.testing.assert_allclose(
        np.unwrap(angles), [0.0, np.pi / 2, np.pi, 3 * np.pi / 2], atol=1e-12
    )
