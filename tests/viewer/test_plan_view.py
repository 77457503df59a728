"""The page of a plan: targets, way, boxes and lines of sight where they are, and what Chromium makes of it."""

from __future__ import annotations

import base64
import re

import numpy as np
import pytest
import umsgpack

from calib import example
from calib.data.cell import Box, Cell, Tracker
from calib.design.optimal import PlanRequest
from calib.design.plan import plan
from calib.robot.readback import random_joint_values
from calib.viewer.design_view import plan_page


@pytest.fixture(scope="module")
def planned(ur3):
    T_base_table = np.eye(4)
    T_base_table[:3, 3] = (0.1, 0.0, -0.03)
    cell = Cell(
        target=np.array(example.PAPER_TARGET),
        model="zeros",
        tracker=Tracker(np.array([2.5, 1.0, 0.8])),
        boxes=(Box("the <table>", np.array([1.2, 0.8, 0.04]), T_base_table),),
    )
    return plan(
        ur3,
        cell,
        PlanRequest(6, 2, candidates=200, ladder=False),
        taken=random_joint_values(ur3, 3),
        collisions=None,
    )


@pytest.fixture(scope="module")
def page(planned):
    return plan_page(planned)


def scene_of(page) -> dict:
    text = re.search(rb'id="scene">([^<]*)<', page.html).group(1)
    return umsgpack.unpackb(base64.b64decode(text))


def moved(scene: dict, pattern: str) -> dict[str, np.ndarray]:
    """The transforms of some nodes, shape (4, 4) each."""
    return {
        c["path"]: np.array(c["matrix"]).reshape(4, 4).T
        for c in scene["commands"]
        if c["type"] == "set_transform" and re.fullmatch(f"/robots/{pattern}", c["path"])
    }


def lines(scene: dict, node: str) -> np.ndarray:
    """The ends of the lines at a node, shape (N, 2, 3)."""
    (command,) = [
        c for c in scene["commands"] if c["type"] == "set_object" and c["path"] == f"/robots/{node}"
    ]
    (name,) = command["object"]["geometries"]
    packed = scene["geometries"][name]["data"]["attributes"]["position"]["array"]
    return np.frombuffer(packed.data, dtype="<f4").reshape(-1, 2, 3)


def test_targets_stand_where_the_nominal_robot_puts_them(planned, page):
    scene = scene_of(page)
    sets = np.array(planned.sets)
    for word, count in (("estimate", 6), ("validate", 2)):
        drawn = [T[:3, 3] for T in moved(scene, rf"{word}/\d+").values()]
        assert len(drawn) == count
        # The measurement frame is the base: what to expect is the same place.
        np.testing.assert_allclose(drawn, planned.expected[sets == word][:, 0], atol=1e-12)
    taken = [T[:3, 3] for T in moved(scene, r"taken/\d+").values()]
    np.testing.assert_allclose(taken, planned.places(planned.taken)[:, 0], atol=1e-12)


def test_way_sight_and_boxes(planned, page):
    scene = scene_of(page)
    places = planned.places(planned.joints)[:, 0]
    np.testing.assert_allclose(lines(scene, "way")[:, 0], places[:-1], atol=1e-6)
    np.testing.assert_allclose(lines(scene, "way")[:, 1], places[1:], atol=1e-6)
    beams = lines(scene, "sight").astype(float)
    np.testing.assert_allclose(beams[:, 0], places, atol=1e-6)
    towards = planned.cell.tracker.position - places
    along = beams[:, 1] - beams[:, 0]
    cosine = (
        np.sum(along * towards, axis=1)
        / np.linalg.norm(along, axis=1)
        / np.linalg.norm(towards, axis=1)
    )
    assert cosine == pytest.approx(np.ones(8), abs=1e-6)
    (table,) = moved(scene, r"around/\d+").values()
    np.testing.assert_allclose(table, planned.cell.boxes[0].T_base_box, atol=1e-12)
