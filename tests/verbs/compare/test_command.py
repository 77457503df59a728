from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.verbs.compare.visits import Planted, visits


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


@pytest.fixture
def shelf(tmp_path: Path) -> Path:
    for k, result in enumerate(visits(Planted(1, rate=0.3e-3), 4)):
        result.write_json(tmp_path / f"{k}.json")
    return tmp_path


def test_several_results_are_followed_over_time(call, shelf: Path):
    names = ("2.json", "0.json", "3.json", "1.json")
    done = call(shelf, "compare", *names, "--json", "t.json", "--tolerance", "0.1 mm")
    assert (done.code, done.err) == (3, "")
    assert "Verdict: fail" in done.lines
    table = json.loads((shelf / "t.json").read_bytes())
    assert (table["schema"], table["kept"], table["tolerance_m"]) == ("trend 1", "fail", 1e-4)
    assert [one["name"] for one in table["results"]] == [f"{k}.json" for k in range(4)]
    assert table["serial"] == "SN-004"
    assert call(shelf, "compare", *names, "--tolerance", "5 mm", "--quiet").code == 0


def test_two_results_have_a_tolerance_too(call, shelf: Path):
    done = call(shelf, "compare", "0.json", "3.json", "--tolerance", "5 mm")
    assert done.code == 0
    assert done.lines[-1].startswith("Pass: ")
    assert call(shelf, "compare", "0.json", "3.json", "--tolerance", "0.01 mm").code == 3
    dated = call(shelf, "compare", "0.json", "3.json", "--dates", "2026-01-01, 2027-01-01")
    assert "between 2026-01-01 and 2027-01-01" in " ".join(dated.out.split())


@pytest.mark.slow
def test_a_report_and_a_view_of_several(call, shelf: Path):
    names = [f"{k}.json" for k in range(4)]
    done = call(shelf, "compare", *names, "--report", "t.html", "--view", "v.html")
    assert done.lines[-2:] == ["Written: v.html", "Written: t.html"]
    assert "Joint zeros over time" in (shelf / "t.html").read_text(encoding="utf-8")
    assert "b: 3.json" in (shelf / "v.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["0.json"], "two or more"),
        (["0.json", "1.json", "--report", "t.txt"], "html"),
        (["0.json", "1.json", "--dates", "2026-01-01"], "1 dates for 2 results"),
        (["0.json", "1.json", "--tolerance", "0.1"], "--tolerance"),
        (["0.json", "none.json", "1.json"], "none.json"),
    ],
)
def test_what_cannot_be_compared_is_said(call, shelf: Path, words, said):
    done = call(shelf, "compare", *words)
    assert (done.code, done.out) == (1, "")
    assert said in done.err
