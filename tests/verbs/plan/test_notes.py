"""Notes of a plan: every code has a sentence."""

from __future__ import annotations

from typing import get_args

import pytest

from calib.verbs.plan.notes import Code, Note
from calib.verbs.plan.text import note_text

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
