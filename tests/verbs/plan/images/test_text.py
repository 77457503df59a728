"""Plans of images in words: their head, what they cover, and their remarks."""

from __future__ import annotations

import numpy as np

from calib.verbs.plan.images.plan_file import coverage, distances_and_tilts
from calib.verbs.plan.images.text import image_facts, image_head
from calib.verbs.plan.text import plan_text
from tests.verbs.plan.images.test_plan import planned


def test_the_head_names_links_and_numbers():
    plan = planned()
    head = image_head(plan)
    assert (
        "camera on tool0, board on base_link: 12 images for calibration, 2 for validation." in head
    )
    text = " ".join(plan_text(plan).split())
    assert head in text
    assert "chain" not in text.split("criterion")[0]


def test_what_the_images_cover():
    plan = planned()
    facts = dict(image_facts(plan))
    distances, tilts = distances_and_tilts(plan)
    assert facts["distance"] == f"{1e3 * distances.min():.0f} to {1e3 * distances.max():.0f} mm"
    low, high, half = np.round(np.degrees([tilts.min(), tilts.max(), np.median(tilts)]))
    assert facts["tilt"] == f"{low:.0f} to {high:.0f} deg, half of the images above {half:.0f} deg"
    assert f"{100 * coverage(plan):.0f} %" in facts["image"]
    assert all(text in " ".join(plan_text(plan).split()) for text in facts.values())
