"""Files of a history: told apart by what they hold; one that is damaged does not stop the others."""

from __future__ import annotations

import json
import os

import pytest

from calib.errors import FileError
from calib.verbs.history.found_files import DateFrom, Note, What, find_files
from tests.verbs.history.shelf import put, result


def test_results_urdfs_and_nothing_else_are_found(tmp_path):
    put(tmp_path, "a/b/c/one.json", result(1, date="2026-01-01"), urdf=True)
    put(tmp_path, ".hidden/two.json", result(2))
    (tmp_path / "other.json").write_text('{"schema": "comparison 5"}')
    (tmp_path / "list.json").write_text("[1, 2]")
    (tmp_path / "plain.urdf").write_bytes(result(1).nominal.urdf.data)
    found = find_files(tmp_path, by_folder=False)
    (one,) = found.results
    assert (one.path, one.serial, one.run) == ("a/b/c/one.json", "A", result(1).run)
    assert one.urdf_sha256 == result(1).robot.urdf.sha256
    assert (one.date.isoformat(), one.date_from) == ("2026-01-01T00:00:00+00:00", DateFrom.MEASURED)
    assert [(urdf.path, urdf.run) for urdf in found.urdfs] == [("a/b/c/one.urdf", one.run)]
    assert found.urdfs[0].sha256 == one.urdf_sha256
    assert found.notes == ()


def test_damaged_files_are_named_and_the_others_are_read(tmp_path):
    path = put(tmp_path, "a.json", result(1, date="2026-01-01"))
    content = path.read_bytes()
    (tmp_path / "cut.json").write_bytes(content[:2000])
    (tmp_path / "empty.json").write_bytes(b"")
    (tmp_path / "changed.json").write_bytes(content.replace(b'"A"', b'"B"'))
    (tmp_path / "newer.json").write_bytes(content.replace(b'"schema": 7', b'"schema": 8'))
    table = json.loads(content)
    for key in ("checksums", "run", "model"):
        del table[key]
    (tmp_path / "lacking.json").write_text(json.dumps(table))
    found = find_files(tmp_path, by_folder=False)
    assert [one.path for one in found.results] == ["a.json"]
    assert {note.what for note in found.notes} == {What.DAMAGED}
    texts = {note.paths[0]: note.text for note in found.notes}
    assert set(texts) == {"cut.json", "empty.json", "changed.json", "newer.json", "lacking.json"}
    assert "'record' was changed" in texts["changed.json"]
    assert "'schema' is 8" in texts["newer.json"]
    assert "'model' is missing" in texts["lacking.json"]
    if hasattr(os, "geteuid") and os.geteuid() != 0:
        (tmp_path / "a.json").chmod(0)
        assert find_files(tmp_path, by_folder=False).results == ()


def test_dates_of_record_result_and_file(tmp_path):
    put(tmp_path, "1.json", result(1, date="10.01.2026", time="2026-01-12T08:00:00Z"))
    path = put(tmp_path, "2.json", result(2))
    table = json.loads(path.read_bytes())
    for key in ("checksums", "run", "time"):
        del table[key]
    path.write_text(json.dumps(table))
    os.utime(path, (1_700_000_000, 1_700_000_000))
    found = find_files(tmp_path, by_folder=False)
    assert [one.date_from for one in found.results] == [DateFrom.CALIBRATED, DateFrom.FILE]
    assert [one.date.timestamp() for one in found.results][1] == 1_700_000_000
    assert found.notes == (
        Note(What.OTHER_DATE, ("1.json",), "10.01.2026"),
        Note(What.FILE_DATE, ("2.json",)),
    )


def test_a_file_is_no_folder(tmp_path):
    with pytest.raises(FileError, match="no folder"):
        find_files(put(tmp_path, "1.json", result(1)), by_folder=False)
