"""Corners to touch in words: joint values from the foot, errors, and what cannot be touched."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.verbs.plan.touch_text import no_touch_text, touch_text
from tests.verbs.plan.test_touch import touched


def test_each_corner_has_its_place_its_error_and_two_lines_of_joint_values():
    plan = touched()
    lines = touch_text(plan).splitlines()
    assert max(map(len, lines)) <= 100
    first = next(i for i, line in enumerate(lines) if line.startswith("corner"))
    above, touch = lines[first + 1 : first + 3]
    assert above.split()[:4] == ["0", *(f"{1e3 * value:.1f}" for value in plan.places[0])]
    for line, q in ((above, plan.above[0]), (touch, plan.touching[0])):
        values = [float(word) for word in line.split()[-6:]]
        np.testing.assert_allclose(values, np.degrees(q[::-1]), atol=0.0051)
    error = f"{1e3 * plan.expected[0]:.2f}"
    assert touch.split()[:4] == ["error", error, "mm", "touch"]


def test_what_cannot_be_touched_says_why():
    plan = touched()
    reached = np.array([True, False, True, True, True])
    free = np.array([False, False, True, True, True])
    text = touch_text(replace(plan, reached=reached, free=free))
    assert text.count("out of reach") == 1
    assert text.count("the robot collides") == 1
    assert text.count(" mm  touch ") == 3


def test_no_corner_at_all_says_how_many_for_which_reason():
    plan = touched()
    reached = np.array([True, False, True, False, False])
    text = no_touch_text(replace(plan, reached=reached, free=np.zeros(5, dtype=bool)))
    assert "None of 5 corners" in text
    assert "3 out of reach, 2 where the robot collides" in text
