"""Robots of example-robot-data go out and in again: `scripts/round_trip.py` with a few, others in each release."""

from __future__ import annotations

import hashlib
import importlib.util
import sys
from pathlib import Path

import pytest

import calib

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("round_trip", ROOT / "scripts/round_trip.py")
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules.setdefault("round_trip", module)  # its dataclasses look themselves up there
    assert spec.loader is not None
    spec.loader.exec_module(module)
    return module


def test_a_few_robots(script):
    files = sorted(script.urdf_files())
    assert len(files) > 60

    def drawn(path: Path) -> bytes:
        """The order changes with the version."""
        return hashlib.sha256(f"{calib.__version__} {path.name}".encode()).digest()

    for path in sorted(files, key=drawn)[:3]:
        found = script.round_trip(path, count=2)
        assert found.passed, (path, found)
        assert found.joints or found.remark


def test_one_that_is_slid_mimicked_and_turned_without_end(script):
    for name in ("tiago.urdf", "double_pendulum_continuous.urdf"):
        (path,) = [file for file in script.urdf_files() if file.name == name]
        found = script.round_trip(path, count=1)
        assert found.passed, found
        assert found.joints >= 2
        assert 0.0 < found.pinocchio < 1e-12
        assert 0.0 < found.yourdfpy < 1e-12
        assert found.checked in (True, None)


def test_a_reader_that_disagrees_is_seen(script):
    outcome = script.Outcome(same=True, joints=6, pinocchio=1e-16, yourdfpy=1e-8, checked=True)
    assert not outcome.passed
    assert not script.Outcome(same=False).passed
    assert not script.Outcome(same=True, checked=False).passed
    assert script.Outcome(same=True, checked=None).passed
