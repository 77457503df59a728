"""``calib simulate --study``: figures of many virtual cells, their file, and what is refused."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import pytest

from tests.places import ROOT

ARM = ("--base", "base", "--tip", "tool0")
DOC = ROOT / "docs" / "simulation.md"


@pytest.fixture
def simulate(call, shop: Path):
    """A function that simulates the paper's UR3 in the shop with further words."""

    def run(*words: str):
        return call(shop, "simulate", "robot.urdf", *ARM, *words)

    return run


def number(text: str, label: str) -> float:
    """The first figure behind a label."""
    return float(re.search(rf"^{re.escape(label)} +([\d.]+)", text, re.MULTILINE)[1])


@pytest.mark.slow
def test_a_study_says_what_calibrations_reach(simulate, shop: Path):
    done = simulate("--study", "4", "--count", "20", "--workers", "1", "--json", "s.json")
    assert (done.code, done.err) == (0, "")
    assert max(map(len, done.lines)) <= 100
    assert done.lines[0].startswith(
        "Study: 4 robots, each with errors of its own, measured at 20 random"
    )
    nominal, calibrated = number(done.out, "nominal"), number(done.out, "calibrated")
    assert 1.0 < nominal < 10.0
    assert calibrated < 0.05 * nominal
    assert number(done.out, "forecast before any measurement") == pytest.approx(calibrated, rel=0.5)
    inside = re.search(r"95 % regions [^:]*: ([\d.]+) %", done.out)
    assert inside is not None
    assert 85.0 < float(inside[1]) <= 100.0
    assert re.search(r"^Verdicts: ", done.out, re.MULTILINE)
    assert done.lines[-1] == "Written: s.json"
    assert not list(shop.glob("*truth*"))

    kept = json.loads((shop / "s.json").read_text(encoding="utf-8"))
    assert kept["schema"] == "study 1"
    assert [trial["seed"] for trial in kept["trials"]] == [0, 1, 2, 3]
    squares = [trial["rms_m"] ** 2 for trial in kept["trials"]]
    assert kept["rms_m"] == pytest.approx(math.sqrt(sum(squares) / 4), rel=1e-12)
    assert 1e3 * kept["rms_m"] == pytest.approx(calibrated, abs=6e-4)
    assert 1e3 * kept["nominal_rms_m"] == pytest.approx(nominal, abs=6e-4)

    # The document has every key, and no other.
    section = DOC.read_text(encoding="utf-8").partition("## A study")[2].partition("\n## ")[0]
    said = set(re.findall(r"`([a-z_]+)(?:\[\])?`", section)) - {"null"}
    assert said == {*kept, *kept["poses"], *kept["trials"][0], "reason"}


@pytest.mark.slow
def test_the_same_seed_in_any_number_of_processes(simulate):
    words = ("--study", "3", "--count", "15", "--fit-model", "dh", "--seed", "5")
    one, two = simulate(*words, "--workers", "1"), simulate(*words, "--workers", "2")
    assert one.out == two.out
    assert one.out != simulate(*words[:-1], "6", "--workers", "1").out
    assert "Models: dh 100 %" in one.out


@pytest.mark.slow
def test_planned_poses_and_those_of_a_file(simulate):
    done = simulate(
        "--study", "2", "--count", "15", "--planned", "--fit-model", "zeros", "--workers", "1"
    )
    assert (done.code, done.err) == (0, "")
    assert "measured at 15 planned poses" in done.out
    done = simulate("--study", "2", "--poses", "data.csv", "--fit-model", "zeros", "--workers", "1")
    assert (done.code, done.err) == (0, "")
    assert "measured at the 30 poses given" in done.out
