from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

FILES = ["calibration.json", "report.html", "ur3_calibrated.urdf", "view.html"]


@pytest.fixture
def demo(examples):
    return examples.starting("calib demo")


def test_what_it_prints(demo):
    assert (demo.code, demo.err) == (0, "")
    for words in (
        "robot 'ur3', base to tool0, 6 joints; 30 rows for estimation and 5 for validation",
        "Verdict: use",
        "Outliers (no weight in the fit): row 11 (",
        "The signs of the paper's Table 1 do not fit its Table 2 as printed.",
        "Written: demo/ur3_calibrated.urdf",
        "Written: demo/calibration.json",
        "Written: demo/report.html",
        "Written: demo/view.html",
        "Open demo/report.html and demo/view.html in a browser.",
    ):
        assert words in demo.out


def test_the_comparison_with_the_paper(demo):
    def row(label: str) -> list[float]:
        (line,) = [line for line in demo.lines if line.startswith(label)]
        return [float(word) for word in line[len(label) :].split()]

    assert row("nominal, as the paper prints it") == [3.564, 2.568, 2.748]
    assert row("nominal, here") == pytest.approx([3.606, 2.543, 2.733], abs=1.1e-3)
    assert row("calibrated, as the paper prints it") == [1.872, 1.593, 1.638]
    assert row("calibrated, the paper's algorithm here")[2] == pytest.approx(0.700, abs=2e-3)
    assert row("calibrated, calib")[2] < 0.3


def test_the_files(examples, demo):
    folder = examples.folder / "demo"
    assert sorted(path.name for path in folder.iterdir()) == FILES
    result = json.loads((folder / "calibration.json").read_text(encoding="utf-8"))
    shown = re.search(r"\nvalidation rows, calibrated +5 +\S+ +\S+ +(\S+)", demo.out)
    assert shown is not None
    rms = 1e3 * result["errors"]["calibrated"]["validation"]["m"]["rms"]
    assert float(shown[1]) == pytest.approx(rms, abs=5.001e-4)
    assert b"<html" in (folder / "view.html").read_bytes()[:1000].lower()
    report = (folder / "report.html").read_bytes()
    assert len(report) <= 3_000_000
    assert b"Verdict: use</p>" in report
    assert b"<td>calib demo --out demo</td>" in re.sub(rb"</?span[^>]*>", b"", report)
    assert report.count(b"<figure ") >= 10


@pytest.mark.slow
def test_force_folders_of_folders_and_quiet(call, tmp_path: Path):
    folder = tmp_path / "neuer ordner" / "démo"
    folder.mkdir(parents=True)
    (folder / "view.html").write_text("old", encoding="utf-8")
    done = call(tmp_path, "demo", "--out", "neuer ordner/démo", "--force", "--quiet")
    assert (done.code, done.out, done.err) == (0, "", "")
    assert sorted(path.name for path in folder.iterdir()) == FILES
    assert (folder / "view.html").stat().st_size > 100_000
