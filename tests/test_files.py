from __future__ import annotations

import os
import resource
import stat
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import pytest

from calib.errors import FileError
from calib.files import (
    check_no_xacro,
    check_writable,
    make_folder,
    read_bytes,
    write_atomically,
)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_read_says_what_is_wrong(tmp_path: Path):
    with pytest.raises(FileError, match=r"table '.*none\.csv' does not exist; check the name"):
        read_bytes(tmp_path / "none.csv", "table")
    with pytest.raises(FileError, match=r"ur_type:=ur5e' does not exist; .* in one pair of quotes"):
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


def test_standard_input_is_a_minus():
    program = "from calib.files import read_bytes; print(read_bytes('-', 'table'))"
    done = subprocess.run(
        [sys.executable, "-c", program], input=b"1;2", capture_output=True, check=True
    )
    assert done.stdout.strip() == b"b'1;2'"


@pytest.mark.parametrize("name", ["ur.urdf.xacro", "ur.xacro", "UR.XACRO"])
def test_the_name_of_a_xacro_is_none_for_a_urdf(tmp_path: Path, name: str):
    check_no_xacro(tmp_path / "ur.urdf")
    with pytest.raises(FileError, match="is the name of a xacro"):
        check_no_xacro(tmp_path / name)


def test_writes_a_new_file_with_the_permissions_of_the_umask(tmp_path: Path):
    path = tmp_path / "new.urdf"
    before = os.umask(0o027)
    try:
        assert write_atomically(path, b"abc", overwrite=False) == path
    finally:
        os.umask(before)
    assert path.read_bytes() == b"abc"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert names(tmp_path) == ["new.urdf"]


def test_an_existing_file_stays_unless_asked_and_keeps_its_permissions(tmp_path: Path):
    path = tmp_path / "a.urdf"
    path.write_bytes(b"old")
    path.chmod(0o604)
    with pytest.raises(FileError, match=r"a\.urdf' exists already; add --force"):
        write_atomically(path, b"new", overwrite=False)
    assert path.read_bytes() == b"old"
    assert write_atomically(str(path), b"new", overwrite=True) == path
    assert path.read_bytes() == b"new"
    assert stat.S_IMODE(path.stat().st_mode) == 0o604
    assert names(tmp_path) == ["a.urdf"]


def test_follows_symbolic_links(tmp_path: Path):
    (tmp_path / "elsewhere").mkdir()
    target, link = tmp_path / "elsewhere" / "target", tmp_path / "link"
    link.symlink_to(target)
    write_atomically(link, b"old", overwrite=False)
    with pytest.raises(FileError, match="exists already"):
        write_atomically(link, b"new", overwrite=False)
    write_atomically(link, b"new", overwrite=True)
    assert link.is_symlink()
    assert target.read_bytes() == b"new"


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


def test_a_folder_without_permission():
    root = os.geteuid() == 0
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o555)
        if root:  # root may write everywhere: become nobody for the attempt
            os.seteuid(65534)
        try:
            with pytest.raises(FileError, match="cannot be written: "):
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


def test_makes_a_folder_and_those_above_it_and_leaves_one_that_is_there(tmp_path: Path):
    folder = make_folder(tmp_path / "a" / "b")
    (folder / "kept").write_bytes(b"1")
    assert make_folder(folder) == folder
    assert names(folder) == ["kept"]
    with pytest.raises(FileError, match=r"kept: this folder cannot be made: .*Choose another name"):
        make_folder(folder / "kept")


@pytest.mark.parametrize("name", ["a b.csv", "\u00e4\u4e2d.csv", "\udcff.csv", "-x", "'\"\n"])
def test_strange_names(tmp_path: Path, name: str):
    path = write_atomically(tmp_path / name, b"2", overwrite=False)
    assert read_bytes(path, "table") == b"2"
    with pytest.raises(FileError, match="exists already") as caught:
        write_atomically(path, b"3", overwrite=False)
    str(caught.value).encode()
