"""OpenCV where it is missing, too old, or there."""

from __future__ import annotations

import sys
import types

import pytest

from calib.boards.opencv import opencv
from calib.errors import CalibError


def test_returns_opencv_with_its_boards():
    assert hasattr(opencv().aruco, "CharucoDetector")


def test_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(CalibError, match=r"pip install 'robot-calib\[camera\]'"):
        opencv()


def test_refuses_a_version_without_boards(monkeypatch):
    old = types.ModuleType("cv2")
    old.__version__ = "4.5.4"
    monkeypatch.setitem(sys.modules, "cv2", old)
    with pytest.raises(CalibError, match=r"4\.5\.4"):
        opencv()
