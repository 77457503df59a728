"""Which calibration was valid when, and the URDF of an earlier one, byte for byte."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from dataclasses import replace

import pytest

import calib
from calib.basics.json_files import plain
from calib.errors import CalibError, FileError, VerdictError
from calib.verbs.history.found_files import What
from calib.verbs.history.history import history
from tests.places import ROOT
from tests.verbs.history.shelf import put, result

DOC = ROOT / "docs" / "history.md"

NO = "do not use"


def ends(entries):
    return [(entry.result.path, entry.end, entry.by) for entry in entries]


def test_a_calibration_is_valid_until_the_next_one(tmp_path):
    put(tmp_path, "b/later.json", result(2, date="2026-03-01"))
    put(tmp_path, "a.json", result(1, date="2026-01-01"))
    put(tmp_path, "other.json", result(3, "B", "2026-02-01"))
    found = history(tmp_path)
    assert list(found.robots) == ["A", "B"]
    assert ends(found.of("A")) == [("a.json", "replaced", "b/later.json"), ("b/later.json", "", "")]
    assert found.notes == ()
    first, second = found.of("A")
    assert first.until == second.result.date
    on = {
        date: found.valid_on("A", date)
        for date in ("2025-12-31", "2026-01-01", "2026-02-28", "2026-03-01", "2030-01-01")
    }
    assert list(on.values()) == [None, first, first, second, second]
    assert found.valid_on("A", "2026-02-28 23:59") is first
    with pytest.raises(CalibError, match="is no date"):
        found.valid_on("A", "01.03.2026")
    with pytest.raises(CalibError, match=r"'C'.*'A', 'B'"):
        found.of("C")


def test_measured_comes_before_calibrated(tmp_path):
    # The one that was measured first was calibrated again last.
    put(tmp_path, "1.json", result(1, date="2026-01-01", time="2026-09-09T10:00:00Z"))
    put(tmp_path, "2.json", result(2, date="2026-02-01", time="2026-02-02T10:00:00Z"))
    put(tmp_path, "3.json", result(3, time="2026-01-15T10:00:00Z"))
    assert [entry.result.path for entry in history(tmp_path).of("A")] == [
        "1.json",
        "3.json",
        "2.json",
    ]


def test_do_not_use_is_never_valid_unless_its_urdf_was_written(tmp_path):
    put(tmp_path, "1.json", result(1, date="2026-01-01", use="use"))
    put(tmp_path, "2.json", result(2, date="2026-02-01", use=NO))
    assert ends(history(tmp_path).of("A")) == [("1.json", "", ""), ("2.json", "never", "")]
    result(2, use=NO).write_urdf(tmp_path / "accepted.urdf", accept=True)
    entries = history(tmp_path).of("A")
    assert ends(entries) == [("1.json", "replaced", "2.json"), ("2.json", "", "")]
    assert [entry.accepted for entry in entries] == [False, True]


def evaluation(serial: str, date: str, outcome: str, sha256: str = "", judged: str = "urdf"):
    """What `calib evaluate --tolerance --json` writes, as far as it matters; see the test of the command."""
    return json.dumps(
        {
            "schema": "evaluation 4",
            "acceptance": {"robot": judged, "outcome": outcome},
            "inputs": {"urdf": {"sha256": sha256}},
            "record": {"robot_serial": serial, "date": date},
        }
    )


def test_a_failed_check_ends_it(tmp_path):
    put(tmp_path, "1.json", result(1, date="2026-01-01"))
    put(tmp_path, "2.json", result(2, date="2026-03-01"))
    check = tmp_path / "check.json"
    check.write_text(evaluation("A", "2026-02-01", "fail"))
    found = history(tmp_path)
    assert ends(found.of("A")) == [("1.json", "check failed", "check.json"), ("2.json", "", "")]
    assert found.valid_on("A", "2026-02-10") is None
    # One that passes, is of the nominal robot, of another robot, or of the day of the calibration changes nothing.
    for text in (
        evaluation("A", "2026-02-01", "pass"),
        evaluation("A", "2026-02-01", "fail", judged="nominal"),
        evaluation("B", "2026-02-01", "fail"),
        evaluation("A", "2026-01-01", "fail"),
        evaluation("A", "2025-12-01", "fail"),
    ):
        check.write_text(text)
        assert ends(history(tmp_path).of("A"))[0][1] == "replaced"
    # By the hash of the URDF it concerns that calibration alone.
    first = fitted_sha256(1)
    check.write_text(evaluation("", "2026-02-01", "fail", first))
    assert ends(history(tmp_path).of("A"))[0][1] == "check failed"
    check.write_text(evaluation("", "2026-04-01", "fail", first))
    assert [end for _, end, _ in ends(history(tmp_path).of("A"))] == ["replaced", ""]


def fitted_sha256(number: int) -> str:
    return result(number).robot.urdf.sha256


def test_an_earlier_urdf_is_restored_byte_for_byte(tmp_path):
    shelf = tmp_path / "shelf"
    for number, date in ((1, "2026-01-01"), (2, "2026-02-01"), (3, "2026-03-01")):
        put(shelf, f"{number}.json", result(number, date=date))
        result(number).write_urdf(tmp_path / f"{number}.urdf")
    found = history(shelf)
    written = (tmp_path / "2.urdf").read_bytes()
    sha256 = hashlib.sha256(written).hexdigest()
    file = hashlib.sha256((shelf / "2.json").read_bytes()).hexdigest()
    assert found.of("A")[1].result.urdf_sha256 == sha256
    for which in (
        "2026-02-15",
        "2026-02-01",
        result(2).run,
        result(2).run[:6],
        sha256[:9],
        file[:8],
    ):
        entry = found.restore("A", which, tmp_path / "back.urdf", overwrite=True)
        assert entry.result.path == "2.json"
        assert (tmp_path / "back.urdf").read_bytes() == written
    with pytest.raises(FileError, match="exists"):
        found.restore("A", "2026-02-15", tmp_path / "back.urdf")
    for which in ("2025-01-01", "ffffffffffff", result(2).run[:5], ""):
        with pytest.raises(CalibError):
            found.restore("A", which, tmp_path / "none.urdf")
    assert not (tmp_path / "none.urdf").exists()


def test_a_urdf_with_a_link_is_restored_by_its_hash(tmp_path):
    put(tmp_path, "1.json", result(1))
    linked = result(1).write_urdf(tmp_path / "linked.urdf", target_link=True).read_bytes()
    found = history(tmp_path)
    assert found.notes == ()
    assert [urdf.path for urdf in found.urdfs] == ["linked.urdf"]
    found.restore("A", hashlib.sha256(linked).hexdigest(), tmp_path / "back.urdf")
    assert (tmp_path / "back.urdf").read_bytes() == linked
    found.restore("A", result(1).run, tmp_path / "plain.urdf")
    assert (tmp_path / "plain.urdf").read_bytes() == result(1).robot.urdf.data


def test_other_digits_than_the_result_states_are_not_passed_off_as_the_same(tmp_path):
    path = put(tmp_path, "1.json", result(1))
    # As if another version had written other digits: the result states the hash of that file.
    foreign = result(1).robot.urdf.data.replace(b"</robot>", b"</robot>\n")
    sha256 = hashlib.sha256(foreign).hexdigest()
    text = path.read_text(encoding="utf-8").replace(result(1).robot.urdf.sha256, sha256)
    checksum = calib.basics.json_files.digest({"urdf": {"sha256": sha256}})[:12]
    old = calib.basics.json_files.digest({"urdf": {"sha256": result(1).robot.urdf.sha256}})[:12]
    path.write_text(text.replace(old, checksum), encoding="utf-8")
    with pytest.raises(CalibError, match="calib convert"):
        history(tmp_path).restore("A", result(1).run, tmp_path / "back.urdf")
    (tmp_path / "kept.urdf").write_bytes(foreign)
    history(tmp_path).restore("A", result(1).run, tmp_path / "back.urdf")
    assert (tmp_path / "back.urdf").read_bytes() == foreign


def test_a_verdict_against_it_is_obeyed(tmp_path):
    put(tmp_path, "1.json", result(1, date="2026-01-01", use=NO))
    found = history(tmp_path)
    run = found.of("A")[0].result.run
    with pytest.raises(VerdictError):
        found.restore("A", run, tmp_path / "x.urdf")
    assert not (tmp_path / "x.urdf").exists()
    found.restore("A", run, tmp_path / "x.urdf", accept=True)
    assert b"calib verdict" in (tmp_path / "x.urdf").read_bytes()


def noted(found, what: What):
    return [note.paths for note in found.notes if note.what is what]


def test_copies_count_once(tmp_path):
    path = put(tmp_path, "1.json", result(1, date="2026-01-01"))
    shutil.copy(path, tmp_path / "copy.json")
    put(tmp_path, "again/1.json", result(1, date="2026-01-01", time="2031-01-01T00:00:00Z"))
    found = history(tmp_path)
    assert [entry.result.path for entry in found.of("A")] == ["1.json"]
    assert noted(found, What.COPY) == [("copy.json", "1.json"), ("again/1.json", "1.json")]


def test_one_run_of_two_robots_is_said(tmp_path):
    put(tmp_path, "1.json", result(1, "A", "2026-01-01"))
    put(tmp_path, "2.json", result(1, "B", "2026-01-01"))
    found = history(tmp_path)
    assert list(found.robots) == ["A", "B"]
    assert noted(found, What.SHARED_RUN) == [("1.json", "2.json")]


def test_two_results_of_one_date_are_said_and_the_later_calibrated_wins(tmp_path):
    put(tmp_path, "1.json", result(1, date="2026-01-01", time="2026-01-03T00:00:00Z"))
    put(tmp_path, "2.json", result(2, date="2026-01-01", time="2026-01-02T00:00:00Z"))
    found = history(tmp_path)
    assert [(e.result.path, e.is_valid) for e in found.of("A")] == [
        ("2.json", False),
        ("1.json", True),
    ]
    assert noted(found, What.SAME_DATE) == [("2.json", "1.json")]
    assert found.valid_on("A", "2026-01-01").result.path == "1.json"


def test_results_without_serial_number_are_said_or_have_that_of_their_folder(tmp_path):
    put(tmp_path, "SN-1/result.json", result(1, "", "2026-01-01"))
    put(tmp_path, "SN-2/result.json", result(2, "A", "2026-01-01"))
    found = history(tmp_path)
    assert list(found.robots) == ["A"]
    assert noted(found, What.NO_SERIAL) == [("SN-1/result.json",)]
    assert list(history(tmp_path, by_folder=True).robots) == ["A", "SN-1"]


def test_a_urdf_that_was_changed_is_said(tmp_path):
    put(tmp_path, "1.json", result(1), urdf=True)
    assert history(tmp_path).notes == ()
    urdf = tmp_path / "1.urdf"
    urdf.write_bytes(urdf.read_bytes().replace(b'"0 0 0"', b'"0 0 0.001"', 1))
    found = history(tmp_path)
    assert noted(found, What.CHANGED_URDF) == [("1.urdf", "1.json")]
    assert found.urdfs == ()


def test_its_table_is_that_of_the_document(tmp_path):
    put(tmp_path, "1.json", result(1, date="2026-01-01"))
    (tmp_path / "broken.json").write_text("{")
    found = history(tmp_path)
    table = json.loads(found.write_json(tmp_path / "h.json").read_bytes())
    assert table == plain(found.table())
    text = DOC.read_text(encoding="utf-8")
    for key in {*table, *table["robots"][0]["calibrations"][0], *table["notes"][0]}:
        assert re.search(rf"[`.{{,]{key}[`,}}\[]", text), key
    for what in What:
        assert f"| `{what.name.lower()}` |" in text


def test_a_robot_has_the_earlier_results_of_version_0_1_0(tmp_path):
    path = put(tmp_path, "old.json", replace(result(1), record=result(1).record))
    table = json.loads(path.read_bytes())
    for key in ("checksums", "run", "time", "outputs"):
        del table[key]
    path.write_text(json.dumps(table))
    result(1).write_urdf(tmp_path / "old.urdf")
    found = history(tmp_path)
    entry = found.of("A")[0]
    assert entry.result.urdf_sha256 == ""
    assert noted(found, What.FILE_DATE) == [("old.json",)]
    found.restore("A", entry.result.run[:12], tmp_path / "back.urdf")
    assert (tmp_path / "back.urdf").read_bytes() == (tmp_path / "old.urdf").read_bytes()
