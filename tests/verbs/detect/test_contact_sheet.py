"""The contact sheet: every picture is on it, its corners are where they were found, and nothing is asked for."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.boards.detection.board_findings import Finding
from calib.boards.detection.detect import Detection
from calib.errors import FileError
from calib.verbs.detect.contact_sheet import write_contact_sheet
from tests.boards.detections import detection, picture, view
from tests.browser import Browser

SMALL = cv2.imencode(".jpg", np.full((48, 64), 90, np.uint8))[1].tobytes()


@pytest.fixture
def found() -> Detection:
    used = replace(picture("a<b>.png", view()), small=SMALL)
    cut = replace(picture("cut.png", view(reason="cut"), camera="wide"), small=SMALL)
    broken = replace(picture("broken.png"), size=(0, 0), reason="unreadable")
    finding = Finding(code="same_picture", pictures=("x.png",))
    return replace(detection(used, cut, broken), findings=(finding,))


def test_a_figure_a_picture(found: Detection, tmp_path: Path):
    text = write_contact_sheet(found, tmp_path / "sheet.html").read_text(encoding="utf-8")
    start, end = "<figure", "</figure>"
    figures = [start + part.split(end)[0] + end for part in text.split(start)[1:]]
    used, cut, broken = (figure.replace("<br>", "<br/>") for figure in figures)
    assert "a&lt;b&gt;.png" in used
    assert "used: 2 corners" in used
    assert "unused" not in used
    assert 'class="bad"' in cut
    assert '<g class="unused">' in cut
    assert "wide" in cut
    assert "<svg" not in broken
    assert text.count('<li><a href="#p') == 2
    assert '<a href="#p2">broken.png</a>' in text


def test_corners_are_drawn_in_pixels_of_the_picture(found: Detection, tmp_path: Path):
    path = write_contact_sheet(found, tmp_path / "sheet.html")
    text = path.read_text(encoding="utf-8")
    drawing = ET.fromstring(text[text.index("<svg") : text.index("</svg>") + 6])
    assert drawing.get("viewBox") == "-0.5 -0.5 640 480"
    circles = list(drawing.iter("circle"))
    assert [(c.get("cx"), c.get("cy")) for c in circles] == [("10.2", "20.5"), ("300.1", "-0.2")]
    assert circles[0].get("class") == "first"
    assert "a&lt;b&gt;.png" in text
    assert "<script" not in text
    with pytest.raises(FileError, match="exists"):
        write_contact_sheet(found, path)
    with pytest.raises(FileError, match="html"):
        write_contact_sheet(found, tmp_path / "sheet.png")


@pytest.mark.slow
@pytest.mark.parametrize("size", [(1400, 900), (412, 860)])
def test_in_a_browser(found: Detection, tmp_path: Path, browser: Browser, size: tuple[int, int]):
    path = write_contact_sheet(found, tmp_path / "sheet.html")
    with browser.open(path.as_uri(), size=size) as tab:
        assert tab.elsewhere == []
        assert tab.complaints == []
        assert tab.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert tab.evaluate("[...document.images].every(i => i.naturalWidth === 64)")
        box = "document.querySelector('svg').getBoundingClientRect()"
        image = "document.querySelector('img').getBoundingClientRect()"
        assert tab.evaluate(f"Math.abs({box}.width - {image}.width)") < 1
        assert tab.evaluate(f"Math.abs({box}.height - {image}.height)") < 1
