from __future__ import annotations

import errno
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from calib.errors import FileError
from calib.verbs.measure.journal import LOCK, Journal

#: Opens a journal and appends events 0, 1, 2, ... of growing size; prints each number when it is acknowledged.
APPENDS = """
import sys
from calib.verbs.measure.journal import Journal
with Journal.open(sys.argv[1]) as journal:
    number = len(journal.events)
    print("open", flush=True)
    while True:
        journal.append({"number": number, "text": "x" * (number % 7 * 3000)})
        print(number, flush=True)
        number += 1
"""


def started(path: Path) -> subprocess.Popen[bytes]:
    """A process that appends to a journal without an end, and has it open."""
    process = subprocess.Popen([sys.executable, "-c", APPENDS, path], stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"open\n"
    return process


def lines(path: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def test_events_come_back_as_they_were(tmp_path: Path):
    path = tmp_path / "journal.jsonl"
    with Journal.create(path) as journal:
        assert journal.events == ()
        journal.append({"event": "row", "q": np.array([0.1, -2e-17]), "nothing": float("nan")})
        journal.append({"event": "note", "text": 'two\nlines, "Bär" \u2028 and \udc80'})
        held = journal.events
    expected = (
        {"event": "row", "q": [0.1, -2e-17], "nothing": None},
        {"event": "note", "text": 'two\nlines, "Bär" \u2028 and \udc80'},
    )
    assert held == expected
    assert path.read_bytes().count(b"\n") == 2
    with Journal.open(path) as journal:
        assert journal.events == expected
        assert journal.torn == ""
        journal.append({"event": "undo"})
    with Journal.open(path) as journal:
        assert [event["event"] for event in journal.events] == ["row", "note", "undo"]


def test_windows_line_ends_are_read(tmp_path: Path):
    path = tmp_path / "journal.jsonl"
    path.write_bytes(b'{"number":0}\r\n{"number":1}\r\n')
    with Journal.open(path) as journal:
        assert [event["number"] for event in journal.events] == [0, 1]
        assert journal.torn == ""


@pytest.mark.parametrize("torn", [b'{"number":2, "te', b"\0\0\0", b'{"num\n', b"17", b"\xff\xfe\n"])
def test_a_torn_last_line_is_dropped_and_told(tmp_path: Path, torn: bytes):
    path = tmp_path / "journal.jsonl"
    whole = b'{"number": 0}\n{"number": 1}\n'
    path.write_bytes(whole + torn)
    with Journal.open(path) as journal:
        assert [event["number"] for event in journal.events] == [0, 1]
        assert journal.torn == torn.rstrip(b"\n").decode("utf-8", "replace")
        assert path.read_bytes() == whole
        journal.append({"number": 2})
    assert [event["number"] for event in lines(path)] == [0, 1, 2]


def test_a_last_line_without_its_end_counts(tmp_path: Path):
    path = tmp_path / "journal.jsonl"
    path.write_bytes(b'{"number": 0}\n{"number": 1}')
    with Journal.open(path) as journal:
        assert journal.torn == ""
        journal.append({"number": 2})
    assert [event["number"] for event in lines(path)] == [0, 1, 2]


def test_damage_before_the_last_line_is_refused_and_left(tmp_path: Path):
    path = tmp_path / "journal.jsonl"
    damaged = b'{"number": 0}\n{"numb\n{"number": 2}\n'
    path.write_bytes(damaged)
    for _ in range(2):  # the lock is free again
        with pytest.raises(FileError, match=r"line 2.*restore it from a copy"):
            Journal.open(path)
    assert path.read_bytes() == damaged


def test_says_what_is_there_and_what_is_not(tmp_path: Path):
    with pytest.raises(FileError, match="this folder has no session"):
        Journal.open(tmp_path / "journal.jsonl")
    assert not list(tmp_path.iterdir())
    Journal.create(tmp_path / "journal.jsonl").close()
    with pytest.raises(FileError, match="this folder has a session"):
        Journal.create(tmp_path / "journal.jsonl")
    with pytest.raises(FileError, match="No such file"):
        Journal.create(tmp_path / "none" / "journal.jsonl")
    journal = Journal.open(tmp_path / "journal.jsonl")
    journal.close()
    with pytest.raises(FileError, match="is closed"):
        journal.append({})


def test_one_process_at_a_time_has_a_session(tmp_path: Path):
    path = tmp_path / "journal.jsonl"
    Journal.create(path).close()
    with started(path) as process:
        for open_it in (Journal.open, Journal.create):
            with pytest.raises(FileError, match=rf"another process \(number {process.pid}\)"):
                open_it(path)
        process.kill()
        process.wait()
    with Journal.open(path):
        with pytest.raises(FileError, match="this process has this session open"):
            Journal.open(path)
        assert (tmp_path / LOCK).read_text() == f"{os.getpid()}\n"
    Journal.open(path).close()


def test_threads_append_one_after_the_other(tmp_path: Path):
    with Journal.create(tmp_path / "journal.jsonl") as journal:
        threads = [
            threading.Thread(target=lambda: [journal.append({"x": "y" * 500}) for _ in range(20)])
            for _ in range(4)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert lines(tmp_path / "journal.jsonl") == [{"x": "y" * 500}] * 80


def test_a_journal_that_was_moved_or_replaced_takes_no_more_events(tmp_path: Path):
    path = tmp_path / "journal.jsonl"
    with Journal.create(path) as journal:
        journal.append({"number": 0})
        shutil.copy(path, tmp_path / "copy")
        path.unlink()
        with pytest.raises(FileError, match="was moved, removed or replaced"):
            journal.append({"number": 1})
        (tmp_path / "copy").rename(path)
        with pytest.raises(FileError, match="was moved, removed or replaced"):
            journal.append({"number": 1})
        assert len(journal.events) == 1


def test_a_file_that_may_not_grow_keeps_its_events_and_takes_more_later(tmp_path: Path):
    path = tmp_path / "journal.jsonl"
    with Journal.create(path) as journal:
        journal.append({"number": 0})
        before = path.read_bytes()
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
        try:
            for _ in range(2):
                with pytest.raises(FileError, match="cannot be written: File too large") as raised:
                    journal.append({"number": 1, "text": "x" * 100_000})
                assert "\n" not in str(raised.value)
                assert path.read_bytes() == before
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        journal.append({"number": 1})
        assert [event["number"] for event in journal.events] == [0, 1]
    assert [event["number"] for event in lines(path)] == [0, 1]


def filled(journal: Journal, path: Path) -> tuple[int, bytes, str]:
    """Appends until the disk is full: the number of events that it took, the file with them, and the error."""
    number = 0
    try:
        while True:
            before = path.read_bytes()
            journal.append({"number": number, "text": "x" * 3000})
            number += 1
    except FileError as error:
        return number, before, str(error)


def test_a_full_disk_keeps_the_events_and_takes_more_when_there_is_room(tmp_path: Path):
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", disk]
    if sys.platform != "linux" or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("only root mounts a small disk")
    try:
        with Journal.create(disk / "journal.jsonl") as journal:
            (disk / "other").write_bytes(b"x" * 40_000)
            number, before, message = filled(journal, disk / "journal.jsonl")
            assert os.strerror(errno.ENOSPC) in message
            assert 0 < number < 50
            assert (disk / "journal.jsonl").read_bytes() == before
            (disk / "other").unlink()
            journal.append({"number": number})
        with Journal.open(disk / "journal.jsonl") as journal:
            assert [event["number"] for event in journal.events] == [*range(number + 1)]
            assert journal.torn == ""
    finally:
        subprocess.run(["umount", disk], check=True)


@pytest.mark.slow
def test_nothing_is_lost_or_doubled_when_the_process_is_killed(tmp_path: Path):
    path = tmp_path / "journal.jsonl"
    Journal.create(path).close()
    moments = random.Random(1)
    known = 0
    for _ in range(50):
        process = started(path)
        time.sleep(moments.uniform(0.0, 0.03))
        process.send_signal(signal.SIGKILL)
        output, _ = process.communicate()
        acknowledged = [int(line) for line in output.split(b"\n")[:-1]]
        known = max([known, *(number + 1 for number in acknowledged)])
        with Journal.open(path) as journal:
            numbers = [event["number"] for event in journal.events]
        assert numbers == [*range(len(numbers))]
        # One more may be on the disk: that which was being acknowledged.
        assert known <= len(numbers) <= known + 1
        known = len(numbers)
    assert known > 100
