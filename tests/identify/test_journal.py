"""Journals: what was written is there again, a cut line is not, and another run's is left alone."""

from __future__ import annotations

import os
import resource

import pytest

from calib.errors import FileError
from calib.identify.journal import journal


def written(path, records, run="run", **options):
    with journal(path, run, **options) as (kept, append):
        for record in records:
            append(record)
    return kept


def test_records_are_there_again(tmp_path):
    path = tmp_path / "j"
    assert written(path, [{"a": 0.1 + 0.2}, {"b": float("inf"), "c": "µ\n"}]) == []
    assert written(path, [{"d": 1}]) == [{"a": 0.1 + 0.2}, {"b": float("inf"), "c": "µ\n"}]
    assert len(written(path, [])) == 3
    assert written(None, [{"a": 1}]) == []


def test_wherever_it_is_cut_the_whole_lines_count(tmp_path):
    path = tmp_path / "j"
    written(path, [{"n": k} for k in range(3)])
    data = path.read_bytes()
    ends = [k + 1 for k, byte in enumerate(data) if byte == ord("\n")]
    for cut in range(len(data) + 1):
        path.write_bytes(data[:cut])
        whole = sum(end <= cut for end in ends) - 1
        if cut and whole < 0:  # no line of it is whole: it could be anything
            with pytest.raises(FileError, match="is no journal of calib"):
                written(path, [])
            continue
        kept = written(path, [{"n": "next"}])
        assert kept == [{"n": k} for k in range(max(whole, 0))]
        assert written(path, []) == [*kept, {"n": "next"}]


def test_a_changed_byte_ends_it(tmp_path):
    path = tmp_path / "j"
    written(path, [{"n": k} for k in range(3)])
    data = path.read_bytes()
    path.write_bytes(data.replace(b'{"n": 1}', b'{"n": 7}'))
    assert written(path, []) == [{"n": 0}]


def test_another_run_is_refused_and_with_force_replaced(tmp_path):
    path = tmp_path / "j"
    written(path, [{"n": 1}])
    before = path.read_bytes()
    with pytest.raises(FileError, match="holds 1 finished parts of another command, or of another"):
        written(path, [], run="other")
    assert path.read_bytes() == before
    assert written(path, [{"n": 2}], run="other", overwrite=True) == []
    assert written(path, [], run="other") == [{"n": 2}]


def test_a_file_of_something_else_is_refused(tmp_path):
    path = tmp_path / "j"
    path.write_text("dear diary\n")
    with pytest.raises(FileError, match="exists already and is no journal of calib; add --force"):
        written(path, [])
    assert path.read_text() == "dear diary\n"
    assert written(path, [{"n": 1}], overwrite=True) == []
    assert written(path, []) == [{"n": 1}]


def test_two_at_a_time_are_refused(tmp_path):
    path = tmp_path / "j"
    with (
        journal(path, "run"),
        pytest.raises(FileError, match="is in use by another run of calib; wait for its end"),
    ):
        written(path, [])


def test_where_it_cannot_be_written_it_says_so(tmp_path):
    with pytest.raises(FileError, match=r"cannot be written: No such file or dir.*another folder"):
        written(tmp_path / "none" / "j", [])
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50, hard))  # as a full disk
    try:
        with pytest.raises(FileError, match="/j' cannot be written: File too large"):
            written(tmp_path / "j", [])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="a system without named pipes")
@pytest.mark.parametrize("overwrite", [False, True])
def test_what_is_no_file_is_refused_and_left_as_it_is(tmp_path, overwrite):
    path, other = tmp_path / "j", tmp_path / "other"
    other.write_text("a table of mine\n")
    path.symlink_to(other)
    with pytest.raises(FileError, match=r"is a symbolic link, and calib keeps the finished parts"):
        written(path, [], overwrite=overwrite)
    assert other.read_text() == "a table of mine\n"
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(FileError, match=r"is a pipe, .*delete it or move it away, or choose"):
        written(path, [], overwrite=overwrite)
    path.unlink()
    path.mkdir()
    with pytest.raises(FileError, match="is a folder, and calib keeps"):
        written(path, [], overwrite=overwrite)
    with pytest.raises(FileError, match="is a device, and calib keeps"):
        written(os.devnull, [], overwrite=overwrite)
