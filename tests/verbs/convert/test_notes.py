"""Notes: values by code, of which there is a sentence each."""

from __future__ import annotations

from typing import get_args

from calib.verbs.convert.notes import Code, Note


def test_a_note_is_a_code_and_its_values():
    assert Note("base displaced", (1e-3,)) == ("base displaced", (1e-3,))
    assert Note("nominal hash").values == ()
    assert len(set(get_args(Code))) == len(get_args(Code))
