"""calib.show: a calibration, a robot or two robots, as a file or live."""

from __future__ import annotations

import urllib.request
import webbrowser
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.errors import ModelError
from tests.show.calibrations import made


@pytest.fixture(scope="module")
def result():
    return made("paper")


def test_show_opens_the_page_in_the_browser(result, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    page = calib.show(result)
    assert opened == [Path(page).as_uri()]
    assert page.is_file()


def test_show_can_serve_the_page_and_move_the_robots(result, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    with calib.show(result, live=True) as viewer:
        assert opened == [viewer.url]
        viewer.display(np.zeros(6))
        with urllib.request.urlopen(viewer.url, timeout=10) as answer:
            assert b"data-live" in answer.read()


def test_show_takes_robots_too(result, monkeypatch):
    monkeypatch.setattr(webbrowser, "open", lambda _: True)
    text = calib.show(result.nominal, result.robot).read_text(encoding="utf-8")
    assert "<strong>First</strong>" in text
    assert "ur3.urdf" in text
    alone = calib.show(result.nominal).read_text(encoding="utf-8")
    assert "<strong>" not in alone
    with pytest.raises(
        ModelError, match=r"show takes a Calibration, a Robot or two Robots; 'ur3' was"
    ):
        calib.show("ur3")
    with pytest.raises(
        ModelError, match="show takes a Calibration, a Robot or two Robots; None was"
    ):
        calib.show(None)
    with pytest.raises(ModelError, match="show takes a Calibration"):
        calib.show(result, result.robot)
