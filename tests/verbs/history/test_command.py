"""`calib history` on files that the other verbs wrote."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

import calib.example
from tests.verbs.history.shelf import put, result


@pytest.fixture
def shelf(tmp_path: Path) -> Path:
    put(tmp_path, "results/1.json", result(1, "SN-1", "2026-01-01"))
    put(tmp_path, "results/2.json", result(2, "SN-1", "2026-02-01"))
    put(tmp_path, "results/3.json", result(3, "SN-2", "2026-02-01"))
    return tmp_path


def test_all_robots_or_one(call, shelf: Path):
    done = call(shelf, "history", "results", "--json", "h.json")
    assert (done.code, done.err) == (0, "")
    rows = {line.split()[0]: line.split() for line in done.lines if line.startswith("SN-")}
    assert rows["SN-1"][1:3] == ["2", "2026-02-01"]
    assert rows["SN-1"][-1] == result(2).run
    assert done.lines[-1] == "Written: h.json"
    assert json.loads((shelf / "h.json").read_bytes())["schema"] == "history 1"
    done = call(shelf, "history", "results", "SN-1")
    assert done.lines[0] == "SN-1: 2 calibrations"
    assert [line.split()[0] for line in done.lines[3:5]] == [result(1).run, result(2).run]
    assert call(shelf, "history", "results", "--quiet").out == ""


def test_an_earlier_urdf_is_restored(call, shelf: Path):
    words = ("history", "results", "SN-1", "--restore", "2026-01-15", "-o", "back.urdf")
    done = call(shelf, *words)
    assert (done.code, done.err) == (0, "")
    assert result(1).run in done.out
    assert (shelf / "back.urdf").read_bytes() == result(1).robot.urdf.data
    assert call(shelf, *words).code == 1
    assert call(shelf, *words, "--force").code == 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["results", "SN-9"], "'SN-9'"),
        (["results", "SN-1", "--restore", "2026-01-15"], "-o"),
        (["results", "SN-1", "-o", "x.urdf"], "--restore"),
        (["results", "--restore", "2026-01-15", "-o", "x.urdf"], "serial number"),
        (["results", "SN-1", "--restore", "yesterday", "-o", "x.urdf"], "'yesterday'"),
        (["nowhere"], "no folder"),
    ],
)
def test_what_cannot_be_done_is_said(call, shelf: Path, words, said):
    done = call(shelf, "history", *words)
    assert (done.code, done.out) == (1, "")
    assert said in done.err
    assert not (shelf / "x.urdf").exists()


def test_a_verdict_against_it_has_status_3(call, tmp_path: Path):
    put(tmp_path, "1.json", result(1, "S", "2026-01-01", use="do not use"))
    words = ("history", ".", "S", "--restore", result(1).run, "-o", "x.urdf")
    assert call(tmp_path, *words).code == 3
    assert call(tmp_path, *words, "--accept").code == 0


def test_a_failed_evaluation_ends_a_calibration(call, tmp_path: Path):
    """What `calib calibrate` and `calib evaluate` write, with the record of one cell file each."""
    shutil.copy(calib.example.paper_urdf(), tmp_path / "robot.urdf")
    shutil.copy(calib.example.paper_measurements(), tmp_path / "data.csv")
    for name, date in (("then", "2026-01-01"), ("now", "2026-06-01")):
        text = f'[record]\nrobot_serial = "UR-7"\ndate = {date}\n'
        (tmp_path / f"{name}.toml").write_text(text)
    calibrate = ("calibrate", "robot.urdf", "data.csv", "--base", "base", "--model", "zeros")
    words = ("--cell", "then.toml", "--no-validate", "--json", "r.json", "-o", "c.urdf", "--quiet")
    assert call(tmp_path, *calibrate, *words).code == 0
    evaluate = ("evaluate", "c.urdf", "data.csv", "--calibration", "r.json", "--cell", "now.toml")
    done = call(tmp_path, *evaluate, "--tolerance", "0.001 mm", "--json", "check.json", "--quiet")
    assert done.code == 3
    done = call(tmp_path, "history", ".", "UR-7", "--json", "h.json")
    assert done.code == 0
    (robot,) = json.loads((tmp_path / "h.json").read_bytes())["robots"]
    (calibration,) = robot["calibrations"]
    assert (calibration["end"], calibration["by"]) == ("check failed", "check.json")
    assert (calibration["date"], calibration["until"]) == (
        "2026-01-01T00:00:00Z",
        "2026-06-01T00:00:00Z",
    )
    assert "check failed" in call(tmp_path, "history", ".").out
