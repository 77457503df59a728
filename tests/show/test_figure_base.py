"""The look of figures, their files, and names that fit."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from xml.etree import ElementTree

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from calib.errors import FileError
from calib.show.figure_base import (
    Drawing,
    few_ticks,
    in_style,
    log_axis,
    new_figure,
    plain,
    power_text,
    rendered,
    short_names,
)

NASTY = "<b>$\\frac{a}{$</b> & \"x' 関節\n\udcff"


def sketch(title="t"):
    figure = new_figure(1.2, 3.0)
    ax = figure.subplots()
    ax.plot([1.0, 2.0], [3.0, 4.0])
    ax.set_title(title)
    return figure


def drawing(title="t"):
    return Drawing("sketch", "A sketch", "Of nothing, [mm].", in_style(sketch, title))


def text_of(svg):
    root = ElementTree.fromstring(svg)
    return [element.text for element in root.iter("{http://www.w3.org/2000/svg}text")], root


@pytest.mark.parametrize("kind", ["png", "svg", "pdf"])
def test_the_same_figure_is_the_same_file_whatever_the_users_settings(kind):
    first = rendered(drawing(), kind)
    with mpl.rc_context({"font.size": 30.0, "axes.facecolor": "red", "svg.fonttype": "path"}):
        assert rendered(drawing(), kind) == first
        assert mpl.rcParams["font.size"] == 30.0


def test_files_open_and_carry_title_and_caption():
    with Image.open(io.BytesIO(rendered(drawing(), "png"))) as image:
        image.load()
        assert image.size == (540, 216)
        assert image.info["Title"] == "A sketch"
        assert image.info["Description"] == "Of nothing, [mm]."
    svg = rendered(drawing(), "svg")
    assert b"Of nothing, [mm]." in svg
    assert b"<dc:date>" not in svg
    pdf = rendered(drawing(), "pdf")
    assert pdf.startswith(b"%PDF-")
    assert pdf.rstrip().endswith(b"%%EOF")
    assert b"CreationDate" not in pdf


def test_names_are_text_and_no_formula():
    words, root = text_of(rendered(drawing(plain(NASTY)), "svg"))
    assert plain(NASTY) in words
    assert "\n" not in plain(NASTY)
    assert all(element.tag.split("}")[1] != "b" for element in root.iter())
    for kind in ("png", "pdf"):
        assert len(rendered(drawing(plain(NASTY)), kind)) > 1000


def test_viewers_of_an_svg_may_use_other_fonts():
    svg = rendered(drawing("$ 'DejaVu Sans'"), "svg")
    fonts = [
        line for line in svg.split(b"<text ")[1:] if b"'DejaVu Sans', Verdana, sans-serif" in line
    ]
    assert len(fonts) == svg.count(b"<text ") > 3
    assert "$ 'DejaVu Sans'" in text_of(svg)[0]


def test_another_kind_is_refused():
    with pytest.raises(FileError, match="'jpg'; choose one of 'png', 'svg', 'pdf'"):
        rendered(drawing(), "jpg")


def test_importing_and_listing_takes_no_matplotlib_and_drawing_no_window():
    program = """
import json, sys
import calib.show.figures as figures
early = "matplotlib" in sys.modules
import matplotlib as mpl
before = mpl.rcParams.copy()
from calib.show.figure_base import Drawing, in_style, new_figure, rendered
for kind in figures.KINDS:
    rendered(Drawing("a", "b", "c", in_style(new_figure, 1.0)), kind)
print(json.dumps([early, "matplotlib.pyplot" in sys.modules, mpl.rcParams.copy() == before]))
"""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, check=True
    )
    assert json.loads(done.stdout) == [False, False, True]
    assert done.stderr == ""


@pytest.mark.parametrize(
    ("value", "text"),
    [(1.0, "1"), (0.001, "0.001"), (1000.0, "1000"), (1e4, "10⁴"), (1e-12, "10⁻¹²"), (0.0, "")],
)
def test_numbers_of_a_logarithmic_axis(value, text):
    assert power_text(value) == text


def test_a_logarithmic_axis_has_no_formulas():
    def draw():
        figure = sketch()
        figure.axes[0].set_ylim(1e-9, 1e5)
        log_axis(figure.axes[0], "y")
        log_axis(figure.axes[0], "x")
        return figure

    words, _ = text_of(rendered(Drawing("a", "b", "c", draw), "svg"))
    assert "10⁻⁹" in words
    assert not [word for word in words if "$" in word or "math" in word]


def test_ticks_are_round():
    ticks = few_ticks(4).tick_values(-437.0, 389.0)
    assert len(ticks) <= 6
    np.testing.assert_allclose(np.diff(ticks), 250.0)


names = st.text(st.characters(exclude_categories=()), max_size=120)


@given(st.lists(names, min_size=1, max_size=6, unique=True), st.integers(8, 30))
def test_short_names_fit_on_a_line_and_stay_different(given_names, longest):
    short = short_names(given_names, longest)
    assert all(len(name) <= longest + 4 for name in short)
    assert all(name.isprintable() for name in short)
    assert all(name.encode("utf-8") is not None for name in short)
    differ = {plain(name) for name in given_names}
    if len(differ) == len(given_names):
        assert len(set(short)) == len(short)


def test_a_long_name_keeps_its_ends():
    assert short_names(["shoulder_of_the_left_arm.x", "elbow"], 12) == ["should…arm.x", "elbow"]
