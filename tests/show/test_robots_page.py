"""The words about two robots: legend, labels, controls; every name is text."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from calib.show.scene import view_page
from calib.show.view import Cloud, View
from tests.show.test_page import NASTY, Reader


@pytest.fixture(scope="module")
def view(gantry, disturb):
    """A robot without meshes: its page is made at once."""
    rng = np.random.default_rng(4)
    q = rng.uniform(-0.5, 0.5, (35, 3))
    kinds = ("estimation",) * 30 + ("validation",) * 5
    plain = View(gantry, disturb(gantry), q, kinds=kinds)
    return replace(plain, measured=plain.predicted[1] + rng.normal(0, 1e-4, (35, 3)))


def text_of(view) -> str:
    return Reader(view_page(view).html).text


def test_the_legend_counts_the_rows_of_each_kind(view):
    gap = np.array(view.measured)
    gap[0] = np.nan
    kinds = ("flagged", "flagged", *view.kinds[2:])
    text = text_of(replace(view, measured=gap, kinds=kinds))
    assert "measured, fitted (28)" in text
    assert "measured, held back (5)" in text
    assert "measured, flagged (1)" in text  # the other one was not seen
    assert "error arrows, predicted to measured" in text
    assert "beams" not in text
    assert "region measured" not in text


def test_robots_without_measurements_have_arrows_from_one_to_the_other(view):
    plain = replace(
        view,
        measured=np.zeros((0, 3)),
        names=(("Old", "of spring"), ("New <b>", "of autumn")),
        title="",
    )
    text = text_of(plain)
    assert "from old to new <b>" in text
    assert "old solid, new <b> translucent" in text
    assert "gantry: old and new <b>" in text
    assert "measured" not in text


@pytest.mark.parametrize(
    ("verdict", "kind"), [("use", "use"), ("use with care", "care"), ("do not use", "no")]
)
def test_the_verdict_has_a_colour_of_its_own(view, verdict, kind):
    page = view_page(replace(view, verdict=verdict, note="Because."))
    assert f'<b class="verdict {kind}">Verdict: {verdict}.</b> Because.'.encode() in page.html


def test_the_cloud_s_scale_is_in_mm_and_plain_digits(view):
    cloud = Cloud(np.zeros((9, 3)), np.geomspace(5e-2, 0.5, 9), np.ones(9, dtype=bool))
    text = text_of(replace(view, cloud=cloud))
    assert "region measured, by uncertainty" in text
    (low, high) = re.search(r"standard deviation ([\d.]+?)(\d{3}) mm", text).groups()
    assert low == "53"  # mm: the 2 % quantile to two digits
    assert high == "480"


def test_names_add_no_tag_wherever_they_stand(view):
    named = [
        replace(
            view,
            labels=(name,) * 35,
            title=name,
            note=name,
            verdict=name,
            names=((name, name), (name, name)),
        )
        for name in (NASTY, "harmless")
    ]
    nasty, harmless = (Reader(view_page(view).html) for view in named)
    assert nasty.tags == harmless.tags
    assert len(nasty.scripts) == len(harmless.scripts)


def test_the_chosen_factor_is_among_those_offered(view):
    tags = Reader(view_page(view).html).tags
    chosen = [a["value"] for tag, a in tags if tag == "option" and "selected" in a]
    assert chosen[1] == "1"  # robots are true to scale at first
    assert int(chosen[0]) > 1
