"""A page of one robot: all that is to be seen is, and texts are texts."""

from __future__ import annotations

import numpy as np
import pytest

from calib.show.bodies import bodies
from calib.show.page import key
from calib.show.single import Layout, single_page
from calib.show.visuals import read_visuals


@pytest.fixture(scope="module")
def parts(ur3):
    visuals, _ = read_visuals(ur3.urdf)
    return bodies(ur3, np.zeros(6), visuals)


def test_the_scene_holds_the_robot_and_the_points(ur3, parts):
    alone = Layout.of(ur3, np.zeros(6), parts, np.zeros((0, 3)))
    far = np.array([[2.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    wide = Layout.of(ur3, np.zeros(6), parts, far)
    assert wide.size > 2.0 > alone.size > 0.4
    # The floor is the robot's, whatever lies below it.
    assert wide.floor == alone.floor > -0.2
    assert np.linalg.norm(far - wide.camera.centre, axis=1).max() <= wide.camera.radius + 1e-9


def test_texts_are_escaped_and_no_text_is_none(ur3, parts):
    layout = Layout.of(ur3, np.zeros(6), parts, np.zeros((0, 3)))

    def draw(scene):
        scene["ball"].set_transform(np.eye(4))
        return [key("a ball", "#112233", "ball")]

    page = single_page(layout, draw, title="A <title>", text="1 < 2", warnings=["a & b"])
    html = page.html.decode()
    assert "A &lt;title&gt;" in html
    assert "<p>1 &lt; 2</p>" in html
    assert 'data-show="ball"' in html
    assert page.warnings == ("a & b",)
    assert "<p></p>" not in single_page(layout, draw, title="t", text="", warnings=()).html.decode()
