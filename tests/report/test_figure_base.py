"""The look of figures, their files, and names that fit."""

from __future__ import annotations

import io

import matplotlib as mpl
import pytest
from PIL import Image

from calib.errors import FileError
from calib.report.figure_base import new_figure, short_names
from calib.report.figures import Drawing, rendered

NASTY = "<b>$\\frac{a}{$</b> & \"x' 関節\n"


def sketch(title="t"):
    figure = new_figure(1.2, 3.0)
    ax = figure.subplots()
    ax.plot([1.0, 2.0], [3.0, 4.0])
    ax.set_title(title)
    return figure


def drawing(title="t"):
    return Drawing("sketch", "errors", "A sketch", "Of nothing, [mm].", lambda: sketch(title))


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


def test_a_long_name_keeps_its_ends_and_two_of_one_kind_stay_different():
    assert short_names(["shoulder_of_the_left_arm.x", "elbow"], 12) == ["should…arm.x", "elbow"]
    assert len(set(short_names(["a" * 40 + "1" + "a" * 40, "a" * 81], 12))) == 2
