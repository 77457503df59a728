"""The look of figures, their files, kinds of rows, and names that fit."""

from __future__ import annotations

import io

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.lines import Line2D
from PIL import Image

from calib.errors import FileError
from calib.show.drawing import Drawing, rendered
from calib.show.figure_base import new_figure, row_kinds, rows_text, saved, short_names, styled


def sketch():
    figure = new_figure(1.2, 3.0)
    figure.subplots().plot([1.0, 2.0], [3.0, 4.0])
    return figure


def drawing():
    return Drawing("sketch", "errors", "A sketch", "Of nothing, [mm].", sketch)


@pytest.mark.parametrize("kind", ["svg", "pdf"])
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
    assert b"CreationDate" not in pdf
    with pytest.raises(FileError, match="'jpg'"):
        rendered(drawing(), "jpg")


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
        data = saved(figure, kind)
        assert Counted.draws == 1
        again = sketch()
        again.axes[0].add_line(Line2D([1.0, 2.0], [4.0, 3.0]))
        again.axes[0].set_ylabel("two\nlines")
        by_matplotlib = io.BytesIO()
        again.savefig(by_matplotlib, format=kind, dpi=180)
        positions = [f.axes[0].get_position().bounds for f in (figure, again)]
    assert positions[0] == positions[1]
    assert len(data) == pytest.approx(len(by_matplotlib.getvalue()), abs=300)  # metadata


def test_every_row_is_of_one_kind(calibrations):
    c = calibrations.made("with_outliers")
    kinds = row_kinds(c)
    assert [kind.name for kind in kinds] == ["estimation", "validation", "outlier"]
    assert np.all(np.sum([kind.mask for kind in kinds], axis=0) == 1)
    count = len(c.rows.outliers) + len(c.rows.suspects)
    assert kinds[2].style()["label"] == f"{count} outliers"
    assert len({(kind.colour, kind.marker) for kind in kinds}) == 3
    assert rows_text(np.array([True]), "estimation") == "1 estimation row"


def test_long_names_lose_their_middle():
    assert short_names(["a\tb", "abcdefghij"], 6) == ["a b", "abc…ij"]
