"""The command in real calls: the examples of docs/check.md, exit statuses, files, refusals."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from calib.example import paper_measurements
from tests.places import ROOT
from tests.verbs.check.shop import paper_result, points, write_rows


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The paper's result, its rows 31 to 33, and the same after the elbow's encoder was exchanged."""
    place = tmp_path_factory.mktemp("check")
    paper_result().write_json(place / "result.json")
    lines = paper_measurements().read_text(encoding="utf-8").splitlines()
    rows = [line.split(",") for line in lines[31:34]]
    (place / "this_morning.csv").write_text("\n".join([lines[0], *lines[31:34]]) + "\n")
    for row in rows:
        row[4] = f"{float(row[4]) - 0.3:.2f}"
    text = "\n".join([lines[0], *(",".join(row) for row in rows)]) + "\n"
    (place / "elbow.csv").write_text(text)
    return place


def test_nothing_has_moved(call, folder: Path, tmp_path: Path):
    written, more = tmp_path / "check.json", tmp_path / "more.csv"
    done = call(folder, "check", "result.json", "this_morning.csv", "--json", written, "-o", more)
    assert (done.code, done.err) == (0, "")
    assert "Nothing has moved." in done.lines
    assert done.lines[-1].startswith(f"Not written: {more}")
    assert not more.exists()
    table = json.loads(written.read_text(encoding="utf-8"))
    assert (table["outcome"], table["named"], table["stops"]) == ("nothing", [], 3)


def test_the_elbow_has_moved(call, folder: Path, tmp_path: Path):
    written = tmp_path / "check.json"
    done = call(folder, "check", "result.json", "elbow.csv", "--json", written)
    assert (done.code, done.err) == (3, "")
    table = json.loads(written.read_text(encoding="utf-8"))
    assert (table["outcome"], table["named"]) == ("moved", [["joint", "elbow_joint"]])
    assert table["causes"][0]["size_rad"] == pytest.approx(np.deg2rad(0.3), rel=0.15)
    assert table["matters"] is True
    quiet = call(folder, "check", "result.json", "elbow.csv", "--quiet", "--tolerance", "5 mm")
    assert (quiet.code, quiet.out) == (3, "")


def test_the_document_shows_what_is_printed(call, folder: Path):
    """With the model that the demo's result has, but for the last digits: the answer and the cause."""
    text = (ROOT / "docs" / "check.md").read_text(encoding="utf-8")
    assert "Nothing has moved." in text
    done = call(folder, "check", "result.json", "elbow.csv")
    answer = next(line for line in done.lines if "has moved" in line)
    assert answer.startswith("Joint 'elbow_joint' has moved: its zero by +0.")
    assert answer.split(":")[0] in text


@pytest.mark.slow
def test_poses_are_planned_and_further_ones_are_written(call, folder: Path, tmp_path: Path):
    plan = tmp_path / "poses.csv"
    done = call(folder, "check", "result.json", "--plan", "3", "-o", plan)
    assert (done.code, done.err) == (0, "")
    assert len(plan.read_text(encoding="utf-8").splitlines()) == 4

    q = paper_result().nominal.columns(
        np.deg2rad(
            [
                [-23.88, -89.52, 56.38, -155.11, -39.03, 60.22],
                [-58.59, -61.89, 36.52, -162.08, 21.63, 114.22],
                [-28.69, -86.58, 77.64, -131.96, 47.38, 334.83],
            ]
        )
    )
    rows = write_rows(
        points(q, zeros=tuple(1.75e-3 * np.eye(6)[2]), noise=3e-5, seed=1), tmp_path / "r.csv"
    )
    more = tmp_path / "more.csv"
    done = call(folder, "check", "result.json", rows, "-o", more, "--json", tmp_path / "c.json")
    assert done.code == 3
    table = json.loads((tmp_path / "c.json").read_text(encoding="utf-8"))
    assert table["outcome"] == "undecided"
    lines = more.read_text(encoding="utf-8").splitlines()
    assert len(lines) == 1 + len(table["further"]["joints"])
    assert lines[1].startswith("4,estimate,P4,")


@pytest.mark.parametrize(
    "words",
    [
        ("result.json",),
        ("result.json", "this_morning.csv", "--plan", "3"),
        ("result.json", "--plan", "3", "--json", "c.json"),
        ("result.json", "nowhere.csv"),
        ("this_morning.csv", "this_morning.csv"),
        ("result.json", "this_morning.csv", "--tolerance", "5 deg"),
    ],
)
def test_wrong_calls_are_refused(call, folder: Path, words: tuple[str, ...]):
    done = call(folder, "check", *words)
    assert done.code == 1
    assert done.err.startswith("calib: ")
    assert "internal error" not in done.err
