"""Cameras and boards are nodes of the scene, and images are values for the script."""

from __future__ import annotations

import base64
import json
import re

import numpy as np
import pytest

from calib.verbs.view.draw_sight import displacement_factor, images_table
from calib.verbs.view.page import FACTORS, view_page
from calib.verbs.view.view import _at_rows
from tests.images import camera
from tests.verbs.view.image_tables import CORNERS, evaluation
from tests.view_fixtures import scene_of


def floats(text):
    return np.frombuffer(base64.b64decode(text), dtype="<f4").reshape(-1, 2)


@pytest.fixture(scope="module")
def view():
    flagged = np.zeros(4 * CORNERS, bool)
    return _at_rows(evaluation(size=2.0), evaluation(size=0.5), flagged, {"": camera()})


def test_the_images_of_the_script_are_those_of_the_table(view):
    table = images_table(view.sight, FACTORS)
    assert table["sizes"] == [[2400, 2000]] * 4
    assert table["starts"] == [0, CORNERS, 2 * CORNERS, 3 * CORNERS, 4 * CORNERS]
    m = evaluation().measurements
    expected = np.column_stack([m.reading("u"), m.reading("v")])
    np.testing.assert_allclose(floats(table["measured"]), expected, rtol=1e-6)
    np.testing.assert_allclose(floats(table["nominal"])[::CORNERS, 0], [2.0, 4.0, 6.0, 8.0])
    np.testing.assert_allclose(floats(table["calibrated"])[::CORNERS, 0], [0.5, 1.0, 1.5, 2.0])
    assert images_table(None, FACTORS) is None


def test_displacements_are_magnified_up_to_a_part_of_the_image(view):
    # The typical one is 5 px; 6 % of the width are 144 px.
    assert displacement_factor(view.sight, FACTORS) == 20
    assert displacement_factor(view.sight, (100,)) == 1


def test_each_robot_has_camera_and_board_in_the_scene(view):
    page = view_page(view)
    paths = {command["path"] for command in scene_of(page)["commands"]}
    for who in ("nominal", "calibrated"):
        assert any(re.search(f"{who}/robot/links/\\d+/sight/lines", path) for path in paths)
        assert any(path.endswith(f"{who}/standing/00/corners") for path in paths)
    assert b'id="image"' in page.html
    assert b'id="inset"' not in page.html
    table = json.loads(re.search(rb'id="table">([^<]*)<', page.html).group(1))
    assert table["labels"] == ["0.png", "1.png", "2.png", "3.png"]
    assert table["images"]["factor"] == 20
