"""The study of sessions: its yardsticks, what it takes for a named mistake, and that a file is resumed."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.places import ROOT

sys.path.insert(0, str(ROOT / "scripts"))

import session_study as study

from calib.verbs.simulate.operator import GROSS, Mistakes, Operator


@pytest.fixture(scope="module")
def setting():
    return study.draw(study.Case("ur3", "points", 1, mistakes=False, model="zeros", stated=True))


@pytest.mark.parametrize("guess", [1, 7, 20, 90])
def test_the_fewest_are_found_wherever_the_search_begins(guess: int):
    tried = []

    def limit(count: int) -> float:
        tried.append(count)
        return 10.0 / np.sqrt(count)

    assert study.fewest(limit, 2.0, 3, 100, guess) == 25
    assert min(tried) >= 3
    assert study.fewest(limit, 20.0, 3, 100, guess) == 3
    assert study.fewest(limit, 0.5, 3, 100, guess) == 100


def test_a_plan_takes_fewer_poses_than_random_ones_and_the_simulation_agrees(setting):
    planned = [setting.plan(count).rms_high for count in (10, 20)]
    forecast = setting.random_forecast(20)
    assert planned[1] < planned[0]
    assert planned[1] < forecast
    assert setting.random_limit(20, 1) == pytest.approx(forecast, rel=0.35)


def test_every_other_camera_is_on_the_hand():
    links = []
    for seed in (0, 1):
        case = study.Case("ur3", "pixels", seed, mistakes=False, model="zeros", stated=True)
        setting = study.draw(case)
        links.append(setting.robot.base)
        assert setting.known.boards[""].sigma_scale == study.SCALE
        # Other robots and cameras of the same cell stand where this one does.
        other, truth = setting.scenario.draw(9).truth, setting.virtual.truth
        assert other.T_frame_base[0] == pytest.approx(truth.T_frame_base[0])
        assert other.T_tip_target[0] == pytest.approx(truth.T_tip_target[0])
        assert not np.allclose(other.x, truth.x)
    assert links == ["base", "tool0"]


def test_what_can_be_told_grows_with_what_is_known(setting):
    """Of a robot with wrong zeros alone little is known at first, and everything after ten poses."""
    q = setting.virtual.poses(12, 1)
    operator = Operator.of(setting.virtual, 1, Mistakes(at={2: GROSS, 12: GROSS}))
    known = np.diag(setting.sensitivity.precision)
    powers = []
    for pose in q:
        before = known
        power, known = setting.power(operator.measure(pose), known)
        powers.append(power)
        assert np.all(np.diag(known) >= np.diag(before))
        assert np.array_equal(known, before) == (len(powers) in (2, 12))
    assert max(powers[:11]) < 0.2
    assert powers[11] > 0.95


def row(number: int, outcome: str = "good", found: str = "", wrong: str = "", since: int = 0):
    """A reading of a session in a file."""
    return {
        "number": number,
        "stop": number,
        "outcome": outcome,
        "found": [{"code": found, "stops": [number]}] if found else [],
        "mistake": {"code": wrong, "since": since or number} if wrong else None,
        "power": 1.0 if wrong in ("gross", "not_there") else None,
    }


def test_what_counts_as_named():
    rows = [
        row(1),
        row(2, found="gross"),
        row(3, "again", "gross", "gross"),
        row(4, "again", "gross", "repeated"),
        row(5, wrong="not_there"),
        row(6, found="something_moved", wrong="target_moved"),
        row(7, wrong="target_moved", since=6),
        row(8, "again", "repeated", "missed"),
        row(9, wrong="missed", since=8),
    ]
    judged = [(j.code, j.named, j.right) for j in study.judgements({"rows": rows})]
    assert judged == [
        ("", False, False),
        ("", True, False),
        ("gross", True, True),
        ("repeated", True, False),
        ("not_there", False, False),
        ("target_moved", True, True),
        ("missed", True, True),
    ]
    table = {line[0]: line[1:] for line in study.mistake_rows([{"rows": rows}])}
    assert table["gross"] == [1, "100.0 %", "100.0 %", "100.0 %", 1, "100.0 %"]
    assert table["all"] == [5, "80.0 %", "60.0 %", "80.0 %", 2, "50.0 %"]
    assert table["none (false alarms)"][:2] == [2, "50.0 %"]


def test_what_is_found_later_counts_as_that():
    rows = [
        row(1, wrong="gross"),
        row(2, wrong="target_moved"),
        row(3, wrong="target_moved", since=2),
        row(4, found="something_moved", wrong="target_moved", since=2),
    ]
    session = {"rows": rows, "found": [{"code": "gross", "stops": [1]}]}
    judged = [(j.code, j.named, j.ever) for j in study.judgements(session)]
    assert judged == [("gross", False, True), ("target_moved", False, True)]
    assert [j.ever for j in study.judgements({"rows": rows[:3]})] == [False, False]


def test_a_session_that_failed_did_not_meet_its_aim():
    done = {"robot": "ur3", "kind": "points", "aim_m": 1e-4, "nominal_m": 1e-3, "mistakes": True}
    rows = [{"add_seconds": 0.1, "next_seconds": 0.2}]
    good = {**done, "true_m": 5e-5, "stops": 20, "needed": 19, "reached": True, "rows": rows}
    failed = {**done, "true_m": None, "reached": False, "failed": "no", "rows": rows}
    *_, line = study.accuracy_rows([good, failed, good, good])
    assert line[:2] == ["all", 4]
    assert line[4:10] == ["75.0 %", "0.50, inf", "20.0", "-", "-", "1.05"]
    assert line[11] == "25.0 %"


@pytest.mark.slow
def test_a_file_is_resumed_and_a_line_that_was_cut_off_is_run_again(tmp_path: Path, monkeypatch):
    out = tmp_path / "s.jsonl"
    words = ["run", "--robots", "ur3", "--kinds", "points", "--model", "zeros", "--out", str(out)]

    def sessions(count: int) -> list[dict]:
        monkeypatch.setattr(sys, "argv", ["session_study.py", *words, "--count", str(count)])
        study.main()
        return [json.loads(line) for line in out.read_text().splitlines()]

    (first,) = sessions(1)
    assert first["reached"]
    assert first["true_m"] <= 1.3 * first["aim_m"]
    assert first["aim_m"] == pytest.approx(study.AIM * first["best_m"])
    assert first["stops"] == len([r for r in first["rows"] if r["outcome"] != "again"])
    whole = out.read_text()
    out.write_text(whole + whole[:50])
    again, second = sessions(2)
    assert again == first
    assert second["seed"] == 1
