from __future__ import annotations

import os
import resource
import stat
import sys
import tempfile
import threading
from pathlib import Path

import pytest

from calib.errors import FileError
from calib.model.files import (
    check_no_xacro,
    expanded_name,
    make_folder,
    read_bytes,
    write_atomically,
)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_reads_up_to_the_limit(tmp_path: Path):
    path = tmp_path / "a.urdf"
    path.write_bytes(b"12345")
    assert read_bytes(path, "URDF", 5) == b"12345"
    assert read_bytes(str(path), "URDF", 6) == b"12345"
    with pytest.raises(FileError, match=r"URDF '.*a\.urdf' is larger than 4 bytes, the most"):
        read_bytes(path, "URDF", 4)


def test_a_xacros_arguments_without_quotes(tmp_path: Path):
    with pytest.raises(FileError, match=r"ur_type:=ur5e' does not exist; .* in one pair of quotes"):
        read_bytes(tmp_path / "ur_type:=ur5e", "table", 9)


@pytest.mark.parametrize("name", ["ur.urdf.xacro", "ur.xacro", "UR.XACRO"])
def test_the_name_of_a_xacro_is_none_for_a_urdf(tmp_path: Path, name: str):
    check_no_xacro(tmp_path / expanded_name(name))
    with pytest.raises(
        FileError, match=f"is the name of a xacro, .*; name it {expanded_name(name)}"
    ):
        check_no_xacro(tmp_path / name)


def test_read_says_what_is_wrong(tmp_path: Path):
    with pytest.raises(FileError, match=r"table '.*none\.csv' does not exist; check the name"):
        read_bytes(tmp_path / "none.csv", "table", 10)
    with pytest.raises(FileError, match="is a folder; name the file inside it"):
        read_bytes(tmp_path, "URDF", 10)
    with pytest.raises(FileError, match="cannot be read: Not a directory"):
        read_bytes(Path(__file__) / "x.urdf", "URDF", 10)
    with pytest.raises(FileError, match="cannot be read: embedded null byte"):
        read_bytes("a\0b", "URDF", 10)


def test_writes_a_new_file_with_the_permissions_of_the_umask(tmp_path: Path):
    path = tmp_path / "new.urdf"
    before = os.umask(0o027)
    try:
        assert write_atomically(path, b"abc", overwrite=False) == path
    finally:
        os.umask(before)
    assert path.read_bytes() == b"abc"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert path.stat().st_nlink == 1
    assert names(tmp_path) == ["new.urdf"]


def test_an_existing_file_stays_unless_asked(tmp_path: Path):
    path = tmp_path / "a.urdf"
    path.write_bytes(b"old")
    path.chmod(0o604)
    wanted = r"a\.urdf' exists already; add --force \(overwrite=True\) or choose another name"
    with pytest.raises(FileError, match=wanted):
        write_atomically(path, b"new", overwrite=False)
    assert path.read_bytes() == b"old"
    assert write_atomically(str(path), b"new", overwrite=True) == path
    assert path.read_bytes() == b"new"
    assert stat.S_IMODE(path.stat().st_mode) == 0o604
    assert names(tmp_path) == ["a.urdf"]


def test_overwrite_also_writes_a_new_file(tmp_path: Path):
    write_atomically(tmp_path / "a.urdf", b"new", overwrite=True)
    assert (tmp_path / "a.urdf").read_bytes() == b"new"


def test_follows_symbolic_links(tmp_path: Path):
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / "target").write_bytes(b"old")
    link, dangling = tmp_path / "link", tmp_path / "dangling"
    link.symlink_to(folder / "target")
    dangling.symlink_to(folder / "later")
    with pytest.raises(FileError, match="exists already"):
        write_atomically(link, b"new", overwrite=False)
    write_atomically(link, b"new", overwrite=True)
    write_atomically(dangling, b"newer", overwrite=False)
    assert link.is_symlink()
    assert dangling.is_symlink()
    assert (folder / "target").read_bytes() == b"new"
    assert (folder / "later").read_bytes() == b"newer"
    assert names(folder) == ["later", "target"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_refuses_places_where_no_file_can_stand(tmp_path: Path, overwrite: bool):
    with pytest.raises(FileError, match="is a folder; name a file inside it"):
        write_atomically(tmp_path, b"", overwrite=overwrite)
    with pytest.raises(FileError, match=r"the folder '.*/missing' does not exist; create it"):
        write_atomically(tmp_path / "missing" / "a.urdf", b"", overwrite=overwrite)
    with pytest.raises(FileError, match="cannot be written: File name too long; choose another"):
        write_atomically(tmp_path / ("n" * 300), b"", overwrite=overwrite)
    with pytest.raises(FileError, match="embedded null"):
        write_atomically("a\0b", b"", overwrite=overwrite)
    assert names(tmp_path) == []


def test_never_replaces_a_device_or_a_pipe(tmp_path: Path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(FileError, match="is a device or a pipe, not a file"):
        write_atomically(pipe, b"", overwrite=True)
    assert stat.S_ISFIFO(pipe.stat().st_mode)


@pytest.mark.skipif(sys.platform != "linux", reason="/dev/fd leads to no folder on Linux")
@pytest.mark.parametrize("overwrite", [False, True])
def test_a_pipe_without_a_folder_is_said_to_be_one(overwrite: bool):
    reading, writing = os.pipe()
    try:
        with pytest.raises(FileError, match=f"'/dev/fd/{writing}' is a device or a pipe, not a f"):
            write_atomically(f"/dev/fd/{writing}", b"", overwrite=overwrite)
    finally:
        os.close(reading)
        os.close(writing)


@pytest.mark.skipif(sys.platform != "linux", reason="/proc is Linux's")
@pytest.mark.parametrize("overwrite", [False, True])
def test_a_folder_that_takes_no_files(overwrite: bool):
    with pytest.raises(FileError, match=r"'/proc/calib\.urdf' cannot be written: .*; choose"):
        write_atomically("/proc/calib.urdf", b"", overwrite=overwrite)


def test_a_folder_without_permission():
    root = os.geteuid() == 0
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o555)
        if root:  # root may write everywhere: become nobody for the attempt
            os.seteuid(65534)
        try:
            with pytest.raises(FileError, match="cannot be written: Permission denied"):
                write_atomically(Path(folder) / "a.urdf", b"", overwrite=False)
        finally:
            if root:
                os.seteuid(0)
            Path(folder).chmod(0o700)
        assert names(Path(folder)) == []


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


def test_of_many_writers_at_once_one_succeeds(tmp_path: Path):
    path = tmp_path / "a.urdf"
    start = threading.Barrier(8)
    won: list[bytes] = []

    def write(data: bytes) -> None:
        start.wait()
        try:
            write_atomically(path, data, overwrite=False)
        except FileError:
            return
        won.append(data)

    threads = [threading.Thread(target=write, args=(bytes([i]) * 5000,)) for i in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert won == [path.read_bytes()]
    assert names(tmp_path) == ["a.urdf"]


def test_makes_a_folder_and_those_above_it_and_leaves_one_that_is_there(tmp_path: Path):
    folder = make_folder(tmp_path / "a" / "b")
    (folder / "kept").write_bytes(b"1")
    assert make_folder(folder) == folder
    assert names(folder) == ["kept"]


def test_a_file_in_the_way_of_a_folder_is_named(tmp_path: Path):
    (tmp_path / "a").write_bytes(b"")
    for path in (tmp_path / "a", tmp_path / "a" / "b"):
        with pytest.raises(
            FileError, match=f"{path}: this folder cannot be made: .*Choose another name"
        ):
            make_folder(path)
