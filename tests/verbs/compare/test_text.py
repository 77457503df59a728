"""A comparison in words: each outcome has a sentence, and numbers are those of the comparison."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from calib.result.calibration import Calibration
from calib.show.lines import mm
from calib.verbs.compare.comparison import Comparison, Displacement, Why, compare
from calib.verbs.compare.difference import Where
from calib.verbs.compare.drift import LEVEL, DriftTest
from calib.verbs.compare.text import comparison_text, notes, sentence


@pytest.fixture(scope="module")
def same(default_result: Calibration) -> Comparison:
    """A result beside itself."""
    return replace(compare(default_result, default_result), names=("january.json", "june.json"))


@pytest.fixture(scope="module")
def drifted(same: Comparison) -> Comparison:
    """A drift of the target by 0.5 mm."""
    test = DriftTest(combinations=12, chi_square=98.7, freedom=55.0, p=1e-15, sigma=7.9)
    near = Displacement("measured ranges", 0.5e-3, 0.9e-3, 0.1e-3, 0.02e-3, np.nan)
    far = Displacement("joint limits", 0.8e-3, 1.7e-3, 0.3e-3, 0.05e-3, 1.5e-3)
    return replace(same, outcome="drift", why="", test=test, moves=(near, far))


def test_every_code_has_a_sentence(same: Comparison):
    texts = set()
    for why in get_args(Why):
        one = replace(same, why=why, only_a=("a1",), only_b=("gain",))
        texts.add(sentence(one))
        assert sentence(one).endswith(".")
    assert len(texts) == len(get_args(Why))


def test_every_place_of_a_displacement_has_words(drifted: Comparison):
    assert {move.where for move in drifted.moves} == set(get_args(Where))


def test_the_numbers_of_a_drift(drifted: Comparison):
    text = " ".join(comparison_text(drifted).split())
    near, far = drifted.moves
    assert f"{mm(near.moved)} ± {mm(near.std)} mm rms" in text
    assert "(7.9 sigma)" in text
    for move in (near, far):
        assert f"{mm(move.rms)} mm rms" in text
        assert f"at most {mm(move.max)} mm" in text
        assert f"{mm(move.noise)} mm rms." in text
    assert "0.086 deg" in text
    assert "chi-square 98.7 over 12 combinations" in text
    assert "p < 1e-12" in text


def test_the_results_stand_at_the_head(same: Comparison):
    text = comparison_text(same)
    lines = text.splitlines()
    assert lines[1].startswith("  a: january.json, 35 rows of ur3_leica.csv, model 'paper'")
    assert lines[2].startswith("  b: june.json, 35 rows")
    assert max(map(len, lines)) <= 100


def test_notes_name_what_limits_the_comparison(same: Comparison):
    other = replace(same, why="", only_a=("gain",), outcome="no drift shown")
    assert len(notes(other)) == len(notes(same)) + 1
    assert all(note.endswith((".", "there.")) for note in notes(other))


def test_the_table_has_the_values(drifted: Comparison):
    table = drifted.table()
    assert table["outcome"] == "drift"
    assert table["test"]["level"] == LEVEL
    assert table["test"]["chi_square"] == drifted.test.chi_square
    near = drifted.moves[0]
    assert table["moves"][0]["rms_m"] == near.rms
    assert table["moves"][0]["moved_rms_m"] == near.moved
    assert table["moves"][0]["noise_rms_m"] == near.noise
    assert table["moves"][0]["moved_std_m"] == near.std
    assert table["moves"][0]["max_m"] == near.max
    assert [result["name"] for result in table["results"]] == ["january.json", "june.json"]
    assert table["results"][0]["sigma"] == drifted.a.noise.sigma
