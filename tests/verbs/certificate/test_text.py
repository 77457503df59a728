"""Words of certificates: a sentence for every code, source and distribution; probabilities near 0 and 1."""

from __future__ import annotations

import string

import pytest

from calib.verbs.certificate.text import (
    _SENTENCES,
    gap_text,
    probability,
    temperatures,
    with_uncertainty,
)
from calib.verbs.certificate.untested import Gap, Untested

#: Values of each name that sentences have in braces.
VALUES = {
    "kinds": ("plane",),
    "points": 3,
    "wanted": 5,
    "repeats": 2,
    "joints": ("elbow_joint", "wrist_1_joint"),
    "joint": "elbow_joint",
    "share": 0.1917,
    "rows": (34, 35),
    "names": ("left",),
    "places": ("frame", "target"),
    "stated": "3 kg",
    "low_C": 21.4,
    "high_C": 22.1,
    "due": "2026-05-31",
    "date": "2026-11-26",
    "units": ("m", "rad"),
}


def test_every_code_has_words():
    assert set(_SENTENCES) == set(Untested)


@pytest.mark.parametrize("code", Untested)
def test_sentences_are_made_of_values(code: Untested):
    named = {name for _, name, _, _ in string.Formatter().parse(_SENTENCES[code]) if name}
    if "low_C" in named:
        named.add("high_C")
    text = gap_text(Gap(code, {name: VALUES[name] for name in named}))
    assert text.endswith(".")
    assert "{" not in text


@pytest.mark.parametrize(
    ("code", "values", "words"),
    [
        (Untested.BEYOND, {"joint": "j3", "share": 0.1917}, "'j3' the points cover 19 %"),
        (Untested.OTHER_TEMPERATURES, {"low_C": 21.4, "high_C": 22.1}, "21.4 °C to 22.1 °C"),
        (Untested.REPEATS, {"repeats": 1, "wanted": 3}, "measured once; it takes 3"),
        (Untested.OUTSIDE, {"rows": (34, 35)}, "rows 34, 35"),
    ],
)
def test_values_in_words(code: Untested, values: dict[str, object], words: str):
    assert words in gap_text(Gap(code, values))


def test_temperatures():
    assert temperatures((20.0,)) == "20.0 °C"
    assert temperatures(()) == ""


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "< 0.0001 %"),
        (0.00036, "0.036 %"),
        (0.25, "25 %"),
        (0.623, "62 %"),
        (0.9977, "99.77 %"),
        (0.96, "96.0 %"),
        (1.0, "> 99.9999 %"),
        (float("nan"), "-"),
    ],
)
def test_probabilities(value: float, text: str):
    assert probability(value) == text


def test_a_deviation_and_its_uncertainty_are_in_the_unit_shown():
    assert with_uncertainty(3.4049e-4, 5.62e-5, "m") == ("0.340", "0.056")
    assert with_uncertainty(1e-3, 1e-4, "rad") == ("0.0573", "0.0057")
