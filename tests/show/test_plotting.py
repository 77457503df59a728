"""Figures and their files: the same bytes for the same figure, one drawing, and a refusal without matplotlib."""

from __future__ import annotations

import importlib.util
import io

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.lines import Line2D
from PIL import Image

from calib.errors import CalibError, FileError
from calib.show.blocks import Drawing
from calib.show.plotting import (
    new_figure,
    number_points,
    picture_bytes,
    render,
    require_matplotlib,
    styled,
)


def sketch():
    figure = new_figure(1.2, 3.0)
    figure.subplots().plot([1.0, 2.0], [3.0, 4.0])
    return figure


def drawing():
    return Drawing("sketch", "errors", "A sketch", "Of nothing, [mm].", sketch)


@pytest.mark.parametrize("kind", ["svg", "pdf"])
def test_the_same_figure_is_the_same_file_whatever_the_users_settings(kind):
    first = render(drawing(), kind)
    with mpl.rc_context({"font.size": 30.0, "axes.facecolor": "red", "svg.fonttype": "path"}):
        assert render(drawing(), kind) == first
        assert mpl.rcParams["font.size"] == 30.0


def test_files_open_and_carry_title_and_caption():
    with Image.open(io.BytesIO(render(drawing(), "png"))) as image:
        image.load()
        assert image.size == (540, 216)
        assert image.info["Title"] == "A sketch"
        assert image.info["Description"] == "Of nothing, [mm]."
    svg = render(drawing(), "svg")
    assert b"Of nothing, [mm]." in svg
    assert b"<dc:date>" not in svg
    pdf = render(drawing(), "pdf")
    assert pdf.startswith(b"%PDF-")
    assert b"CreationDate" not in pdf
    with pytest.raises(FileError, match="'jpg'"):
        render(drawing(), "jpg")


@pytest.mark.parametrize("kind", ["svg", "png", "pdf"])
def test_a_figure_is_drawn_once_and_laid_out_as_matplotlib_does(kind):
    class Counted(Line2D):
        draws = 0

        def draw(self, renderer):
            Counted.draws += 1
            super().draw(renderer)

    with styled():
        figure = sketch()
        figure.axes[0].add_line(Counted([1.0, 2.0], [4.0, 3.0]))
        figure.axes[0].set_ylabel("two\nlines")
        data = picture_bytes(figure, kind)
        assert Counted.draws == 1
        again = sketch()
        again.axes[0].add_line(Line2D([1.0, 2.0], [4.0, 3.0]))
        again.axes[0].set_ylabel("two\nlines")
        by_matplotlib = io.BytesIO()
        again.savefig(by_matplotlib, format=kind, dpi=180)
        positions = [f.axes[0].get_position().bounds for f in (figure, again)]
    assert positions[0] == positions[1]
    assert len(data) == pytest.approx(len(by_matplotlib.getvalue()), abs=300)  # metadata


def test_without_matplotlib_work_is_refused_with_its_remedy(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(CalibError, match=r"^A report .*: pip install 'robot-calib\[report\]'$"):
        require_matplotlib("A report")
    with pytest.raises(CalibError, match="A figure needs matplotlib"):
        render(drawing())


def test_rows_at_one_place_have_one_text():
    """As repeats of a pose have."""
    ax = new_figure(1.2, 3.0).subplots()
    places = np.array([[0.0, 0.0], [100.0, 50.0], [0.3, 0.1], [np.nan, 0.0], [50.0, 0.0]])
    number_points(ax, [7, 8, 9, 10, 11], places, np.array([True, True, True, True, False]))
    assert [text.get_text() for text in ax.texts] == ["7, 9", "8"]
    number_points(ax, [7, 8, 9, 10, 11], places, np.zeros(5, dtype=bool))
    assert len(ax.texts) == 2
