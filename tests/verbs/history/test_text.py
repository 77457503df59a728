"""A history in words."""

from __future__ import annotations

import shutil

from calib.verbs.history.found_files import Note, What
from calib.verbs.history.history import history
from calib.verbs.history.text import note_sentences
from tests.verbs.history.shelf import put, result


def test_a_robot_without_a_valid_calibration_says_why(tmp_path):
    put(tmp_path, "1.json", result(1, date="2026-01-01", use="do not use"))
    assert "none: every verdict is 'do not use'" in history(tmp_path).summary()
    assert "never" in history(tmp_path).summary("A")


def test_a_folder_without_results_says_where_they_come_from(tmp_path):
    (tmp_path / "other.json").write_text('{"version": 1}')
    text = history(tmp_path).summary()
    assert text.startswith("0 robots with 0 calibrations")
    assert "calib calibrate --json" in " ".join(text.split())
    assert "Notes:" not in text


def test_dates_say_where_they_are_from(tmp_path):
    put(tmp_path, "1.json", result(1, time="2026-01-02T03:04:05Z"))
    text = history(tmp_path).summary("A")
    assert "2026-01-02T03:04:05Z (calibrated)" in text


def test_notes_on_other_robots_are_left_out_but_not_those_on_damaged_files(tmp_path):
    path = put(tmp_path, "1.json", result(1, "A", "2026-01-01"))
    put(tmp_path, "2.json", result(2, "B", "2026-01-01"))
    shutil.copy(path, tmp_path / "copy.json")
    (tmp_path / "broken.json").write_text("{")
    found = history(tmp_path)
    assert "copy.json" in found.summary("A")
    assert "copy.json" not in found.summary("B")
    assert "broken.json" in found.summary("B")


def test_every_note_has_a_sentence_and_many_are_counted():
    for what in What:
        (sentence,) = note_sentences((Note(what, ("a.json", "b.json"), "why"),), set())
        assert "a.json" in sentence
    notes = tuple(Note(What.COPY, (f"{k}.json", "a.json")) for k in range(20))
    sentences = list(note_sentences(notes, set()))
    assert len(sentences) == 13
    assert "8 more" in sentences[-1]
    files = tuple(f"{k}.json" for k in range(9))
    (sentence,) = note_sentences((Note(What.NO_SERIAL, files),), set())
    assert "4.json and 4 more" in sentence
