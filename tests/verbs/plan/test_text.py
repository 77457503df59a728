"""Plans as text: head, forecasts, a sentence for each note, and what a plan says of itself."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.verbs.plan.choice import PlanRequest
from calib.verbs.plan.notes import Code, Note
from calib.verbs.plan.plan import Plan, plan
from calib.verbs.plan.plan_file import distances_and_tilts
from calib.verbs.plan.route import Blocked
from calib.verbs.plan.text import note_text, plan_text
from tests.verbs.plan import test_images


@pytest.fixture(scope="module")
def planned(ur3) -> Plan:
    cell = Cell(model="zeros", target=np.array([0.05, 0.07, 0.03]))
    return plan(ur3, cell, PlanRequest(8, 2, candidates=100), collisions=None)


def said(one: Plan) -> str:
    return " ".join(plan_text(one).split())


def test_moves_that_collide_are_named_with_poses_to_drive_by(planned: Plan):
    degrees = ", ".join(f"{d:.1f} deg" for d in np.degrees(planned.joints[3]))
    blocked = Blocked(0, 1, None), Blocked(1, 5, planned.joints[3]), Blocked(1, 2, None)
    many = replace(planned, blocked=blocked)
    assert (
        "Note: The straight path in joint space collides from the start to row 1, row 1 to row 5 (via "
        f"{degrees}), row 1 to row 2."
    ) in said(many)
    assert "collides" not in said(planned)
    # Rows of a table that adds to another one have its numbers.
    added = " ".join(plan_text(many, first_row=36).split())
    assert "collides from the start to row 36, row 36 to row 40 (via" in added
    assert "No detour was found from the start to row 36, row 36 to row 37: insert" in added


def test_parameters_of_which_none_is_known_by_itself(planned: Plan):
    unknown = replace(planned.forecast, identifiable=(False,) * len(planned.forecast.names))
    count = len(unknown.names)
    text = said(replace(planned, forecast=unknown))
    assert (f"{count} parameters are known in combinations only.") in text


def test_every_note_is_a_sentence():
    for code in get_args(Code):
        values = VALUES.get(code, (0.02, "a box"))
        text = note_text(Note(code, values))
        assert text.endswith((".", ")."))
        assert "{" not in text


# Images


def test_the_head_names_links_and_numbers():
    text = said(test_images.planned())
    assert (
        "camera on tool0, board on base_link: 12 images for calibration, 2 for validation." in text
    )
    assert "chain" not in text.split("criterion")[0]


def test_what_the_images_cover():
    images = test_images.planned()
    text, camera = said(images), images.instrument
    distances, tilts = distances_and_tilts(camera, images)
    assert f"distance {1e3 * distances.min():.0f} to {1e3 * distances.max():.0f} mm" in text
    low, high, half = np.round(np.degrees([tilts.min(), tilts.max(), np.median(tilts)]))
    assert f"tilt {low:.0f} to {high:.0f} deg, half of the images above {half:.0f} deg" in text
    covered = 100 * camera.coverage(images.sightline.target_poses(images.joints))
    assert f"image corners in {covered:.0f} % of its area" in text


# Notes


VALUES = {
    "generic_target": (0.05, 0.07, 0.03),
    "orientation_noise": (1e-3,),
    "camera_assumed": (1024.0,),
    "image_noise": (0.3,),
    "board_scale": (0.003, 4e-4),
    "collisions_checked": (0.02, "table"),
    "no_geometry": ("a", "b"),
    "always_close": ("a and b",),
    "always_touching": ("a and b",),
}


@pytest.mark.parametrize("code", get_args(Code))
def test_every_code_has_a_sentence_of_its_own(code):
    text = note_text(Note(code, VALUES.get(code, ())))
    others = {
        note_text(Note(other, VALUES.get(other, ()))) for other in get_args(Code) if other != code
    }
    assert text.endswith(".")
    assert text not in others


# What shows a plan


def test_its_summary_is_what_the_command_line_prints(planned: Plan):
    assert isinstance(planned, Plan)
    assert planned.summary() == plan_text(planned)


def test_its_line_has_the_robot_the_poses_and_the_expected_error(planned: Plan):
    expected = f"expected rms {1e3 * planned.forecast.rms:.3f} mm)"
    assert repr(planned) == f"Plan('ur3', base to tool0, 8 poses and 2 for validation, {expected}"
    assert repr(pickle.loads(pickle.dumps(planned))) == repr(planned)
