"""The page of a plan: targets, way, boxes and lines of sight where they are."""

from __future__ import annotations

import csv
import re
from dataclasses import replace

import numpy as np
import pytest

from calib import example
from calib.basics.arrays import rigid_inverse
from calib.data.cell import Box, Cell, Tracker
from calib.robot.ranges import random_joint_values
from calib.verbs.plan.choice import PlanRequest
from calib.verbs.plan.plan import plan
from calib.verbs.plan.plan_file import write_plan
from calib.verbs.plan.plan_page import on_foot, plan_page
from tests.instruments.scenes import BOARD, standing
from tests.verbs.plan import test_images
from tests.verbs.view.test_robots_page import floats, table_of
from tests.view_fixtures import moved, positions, scene_of

TARGET = np.array(example.PAPER_TARGET)


# A plan


@pytest.fixture(scope="module")
def planned(ur3):
    T_base_table = np.eye(4)
    T_base_table[:3, 3] = (0.1, 0.0, -0.03)
    cell = Cell(
        target=TARGET,
        model="zeros",
        tracker=Tracker(np.array([2.5, 1.0, 0.8])),
        boxes=(Box("the <table>", np.array([1.2, 0.8, 0.04]), T_base_table),),
    )
    request = PlanRequest(6, 2, candidates=200, ladder=False)
    return plan(ur3, cell, request, taken=random_joint_values(ur3, 3), collisions=None)


def test_targets_way_tracker_and_boxes_of_a_plan(planned):
    page = plan_page(planned)
    scene, sets = scene_of(page), np.array(planned.sets)
    for word in ("estimate", "validate"):
        # The measurement frame is the base: what to expect is the same place.
        expected = planned.expected[sets == word][:, 0]
        np.testing.assert_allclose(
            moved(scene, rf"nominal/{word}/\d+")[:, :3, 3], expected, atol=1e-12
        )
    taken = moved(scene, r"nominal/taken/\d+")[:, :3, 3]
    np.testing.assert_allclose(taken, planned.places(planned.taken)[:, 0], atol=1e-12)
    places = planned.places(planned.joints)[:, 0]
    way = positions(scene, "nominal/way").reshape(-1, 2, 3)
    np.testing.assert_allclose(way, np.stack([places[:-1], places[1:]], axis=1), atol=1e-6)
    table = table_of(page)
    assert table["tracker"] == [2.5, 1.0, 0.8]
    np.testing.assert_allclose(floats(table["targets"], 8, 1, 3)[:, 0], places, atol=1e-6)
    (box,) = moved(scene, r"nominal/around/\d+")
    np.testing.assert_allclose(box, planned.cell.boxes[0].T_base_box, atol=1e-12)


def test_the_poses_of_a_plan_come_one_by_one_with_the_numbers_of_its_table(planned, tmp_path):
    table = table_of(plan_page(planned, first_row=4))
    file = write_plan(planned, tmp_path / "plan.csv", first_row=4)
    rows = list(csv.DictReader(file.read_text(encoding="utf-8").splitlines()))
    assert table["labels"] == [f"pose {k} of 8" for k in range(1, 9)]
    assert [
        {"estimation": "estimate", "validation": "validate"}[kind] for kind in table["kinds"]
    ] == list(planned.sets)
    numbers = table["numbers"]
    for k, row in enumerate(rows):
        assert numbers["point"][k] == row["point"]
        for joint in planned.robot.joint_names:
            assert numbers[joint][k] == f"{row[f'{joint} [deg]']} deg"
        for axis in "xyz":
            assert numbers[f"expected {axis}"][k] == f"{row[f'expected {axis} [mm]']} mm"
    movers = table["robots"]["nominal"]["movers"]
    poses = floats(table["robots"]["nominal"]["poses"], 8, movers, 7)
    np.testing.assert_allclose(poses[:, -1, :3], planned.expected[:, 0], atol=1e-6)
    legend = re.findall(
        r'<input type="checkbox"( checked)? data-show="nominal/(\w+)"',
        plan_page(planned).html.decode(),
    )
    on = {node: bool(checked) for checked, node in legend}
    assert (on["tracker"], on["sight"], on["next"], on["way"]) == (True, False, True, False)


def test_a_plan_without_a_tracker_has_no_line_of_sight(planned):
    blind = replace(planned, cell=replace(planned.cell, tracker=None))
    page = plan_page(blind)
    table = table_of(page)
    assert (table["tracker"], table["targets"], table["planned"]) == (None, "", True)
    assert b'data-show="nominal/sight"' not in page.html


@pytest.mark.slow
def test_chromium_shows_the_tracker_s_line_of_sight_to_each_pose(browser, planned, tmp_path):
    page = plan_page(planned).write(tmp_path / "plan.html")
    ends = (
        "[...viewer.scene_tree.find(['robots', 'nominal', 'tracker']).object.children"
        ".find((one) => one.isLineSegments).geometry.attributes.position.array]"
    )
    with browser.open(page.as_uri(), size=(1400, 900)) as tab:
        for k in (0, 1):
            expected = [[2.5, 1.0, 0.8], planned.expected[k, 0]]
            np.testing.assert_allclose(np.reshape(tab.evaluate(ends), (2, 3)), expected, atol=1e-6)
            shown = tab.evaluate("document.getElementById('numbers').innerText")
            assert f"P{k + 1}" in shown
            assert f"{planned.expected[k, 0, 0] * 1e3:.3f} mm" in shown
            tab.click("#forward")
        label = "document.querySelector('.label').getBoundingClientRect()"
        assert tab.evaluate(f"{label}.left") >= 0
        assert tab.evaluate(f"{label}.right") <= 1400
        assert tab.complaints == []


# Images


def test_a_camera_in_the_hand_moves_and_the_board_stands():
    plan = test_images.planned()
    moving = on_foot(plan.instrument, plan)
    assert (moving.robot.base, moving.robot.tip) == ("base_link", "tool0")
    assert moving.robot.joint_names == plan.robot.joint_names[::-1]
    # The camera in the foot, by the chain the other way round.
    T_camera_foot = plan.sightline.T_instrument_base @ plan.robot.poses(plan.joints)
    expected = rigid_inverse(T_camera_foot)[:, :3, 3]
    np.testing.assert_allclose(moving.places(moving.joints)[:, 0], expected, atol=1e-12)
    (box,) = moving.cell.boxes
    middle = plan.sightline.T_tip_target @ np.append(BOARD.centre, 1.0)
    np.testing.assert_allclose(box.T_base_box[:3, 3], middle[:3], atol=1e-12)
    np.testing.assert_allclose(box.size[:2], BOARD.size)


def test_a_board_in_the_hand_moves_and_the_camera_stands():
    plan = test_images.planned(standing)
    moving = on_foot(plan.instrument, plan)
    assert moving.robot is plan.robot
    T_base_camera = rigid_inverse(plan.sightline.T_instrument_base)
    middle = (T_base_camera @ np.c_[plan.expected[:, 0], np.ones(14)].T).T[:, :3]
    np.testing.assert_allclose(moving.places(moving.joints)[:, 0], middle, atol=1e-12)
    assert moving.cell.boxes[0].name == "camera"
    np.testing.assert_allclose(moving.cell.boxes[0].T_base_box, T_base_camera)


def test_other_plans_are_as_they_are(planned):
    assert on_foot(planned.instrument, planned) is planned


def test_the_page_has_images_in_place_of_points():
    plan = test_images.planned()
    page = plan_page(plan, first_row=3)
    numbers = table_of(page)["numbers"]
    assert numbers["image"][:2] == ["image_003.png", "image_004.png"]
    assert "point" not in numbers
    degrees = float(numbers["wrist_3_joint"][0].split()[0])
    assert degrees == pytest.approx(np.degrees(plan.joints[0, 0]), abs=1e-3)
    assert numbers["distance of the board"][0].endswith(" mm")
    (board,) = moved(scene_of(page), r"nominal/around/\d+")
    np.testing.assert_allclose(
        board, on_foot(plan.instrument, plan).cell.boxes[0].T_base_box, atol=1e-12
    )
