from __future__ import annotations

import os
import resource
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from calib.basics.files import (
    _remove_leftovers,
    check_writable,
    read_bytes,
    write_atomically,
)
from calib.errors import FileError


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_read_says_what_is_wrong(tmp_path: Path):
    with pytest.raises(FileError, match=r"table '.*none\.csv' does not exist; check the name"):
        read_bytes(tmp_path / "none.csv", "table")
    with pytest.raises(
        FileError, match=r"ur_type:=ur5e' does not exist; .* in the same pair of quotes"
    ):
        read_bytes(tmp_path / "ur_type:=ur5e", "table")
    with pytest.raises(FileError, match="is a folder; name the file inside it"):
        read_bytes(tmp_path, "URDF")
    with pytest.raises(FileError, match="cannot be read: Not a directory"):
        read_bytes(Path(__file__) / "x.urdf", "URDF")
    with pytest.raises(FileError, match=r"cannot be read: .*embedded null"):
        read_bytes("a\0b", "URDF")


def test_a_pipe_can_be_asked_for_twice(tmp_path: Path):
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    writer = threading.Thread(target=pipe.write_bytes, args=(b"x" * 300_000,))
    writer.start()
    for _ in range(2):
        assert read_bytes(pipe, "table") == b"x" * 300_000
    writer.join()


def test_an_existing_file_stays_unless_asked_and_keeps_its_permissions(tmp_path: Path):
    path = tmp_path / "a.urdf"
    path.write_bytes(b"old")
    path.chmod(0o604)
    with pytest.raises(FileError, match=r"a\.urdf' exists already; overwrite it"):
        write_atomically(path, b"new", overwrite=False)
    assert path.read_bytes() == b"old"
    assert write_atomically(str(path), b"new", overwrite=True) == path
    assert path.read_bytes() == b"new"
    assert stat.S_IMODE(path.stat().st_mode) == 0o604
    assert names(tmp_path) == ["a.urdf"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_refuses_places_where_no_file_can_stand(tmp_path: Path, overwrite: bool):
    kept = tmp_path / "kept"
    kept.write_bytes(b"1")
    for bad, says in (
        (tmp_path, "is a folder; name a file inside it"),
        (tmp_path / "missing" / "a", r"the folder '.*/missing' does not exist; create it"),
        (kept / "a", "does not exist; create it|Not a directory"),
        (tmp_path / ("n" * 300), "File name too long"),
        (Path("/dev/null"), "is a device"),
        (Path("a\0b"), "cannot be written: .*null"),
    ):
        with pytest.raises(FileError, match=says):
            write_atomically(bad, b"", overwrite=overwrite)
        with pytest.raises(FileError, match=says):
            check_writable(bad)
    assert names(tmp_path) == ["kept"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_nothing_is_left_when_the_disk_takes_only_a_part(tmp_path: Path, overwrite: bool):
    path = tmp_path / "a.urdf"
    if overwrite:
        path.write_bytes(b"old")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        with pytest.raises(FileError, match="cannot be written: File too large"):
            write_atomically(path, b"x" * 100_000, overwrite=overwrite)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert names(tmp_path) == (["a.urdf"] if overwrite else [])
    assert not overwrite or path.read_bytes() == b"old"


#: Writes a file, and stops before it gets its name.
STOPPED = """
import pathlib, sys, time
from calib.basics.files import write_atomically
def stop(self, target):
    print("stopped", flush=True)
    time.sleep(60)
pathlib.Path.replace = stop
write_atomically(sys.argv[1], b"half", overwrite=False)
"""


def test_what_a_killed_process_left_is_removed_and_what_another_one_writes_stays(tmp_path: Path):
    with subprocess.Popen(
        [sys.executable, "-c", STOPPED, tmp_path / "a"], stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"stopped\n"
        (temporary,) = names(tmp_path)
        _remove_leftovers.cache_clear()
        write_atomically(tmp_path / "b", b"whole", overwrite=False)
        assert names(tmp_path) == [temporary, "b"]
        process.kill()
    _remove_leftovers.cache_clear()
    (tmp_path / ".calib-notes.txt").touch()
    write_atomically(tmp_path / "c", b"whole", overwrite=False)
    assert names(tmp_path) == [".calib-notes.txt", "b", "c"]
