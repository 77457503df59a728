from __future__ import annotations

import json
from pathlib import Path

import pytest


@pytest.fixture
def folder(examples) -> Path:
    return examples.folder


def test_the_example_of_the_document(examples, folder: Path):
    done = examples.starting("calib compare first.json later.json")
    assert (done.code, done.err) == (0, "")
    assert "two calibrations of robot 'ur3', base to tool0" in done.lines[0]
    assert done.lines[1].startswith("  a: first.json, 40 rows of simulated.csv, model '")
    assert done.lines[4] == "No drift that these data could show."
    assert done.lines[-1] == "Written: compared.json"
    written = json.loads((folder / "compared.json").read_text(encoding="utf-8"))
    assert (written["schema"], written["outcome"]) == ("comparison 5", "no drift shown")
    assert [one["name"] for one in written["results"]] == ["first.json", "later.json"]
    assert len(written["moves"]) == 2


def test_another_robot_is_called_a_drift(call, folder: Path):
    # The simulated robot's errors are not those of the paper's.
    done = call(folder, "compare", "result.json", "first.json")
    said = " ".join(done.out.split())
    assert (done.code, done.err) == (0, "")
    assert "The robot drifted (" in said
    assert "Note: The results estimate different errors: only first.json" in said
    assert call(folder, "compare", "result.json", "first.json", "--quiet").out == ""


def test_a_page_of_both(call, folder: Path, tmp_path: Path):
    done = call(folder, "compare", "first.json", "later.json", "--view", tmp_path / "v.html")
    assert (done.code, done.lines[-1]) == (0, f"Written: {tmp_path / 'v.html'}")
    page = (tmp_path / "v.html").read_text(encoding="utf-8")
    assert "ur3: two calibrations" in page
    assert "a: first.json" in page
    assert "No drift that these data could show." in page
    assert '"pose 1 of 24 over the joint limits"' in page
