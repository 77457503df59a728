from __future__ import annotations

import contextlib
import functools
import os
import pty
import random
import resource
import signal
import stat
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from calib.errors import FileError
from calib.model import files
from calib.model.files import (
    check_no_xacro,
    check_writable,
    expanded_name,
    make_folder,
    read_bytes,
    together,
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
    with pytest.raises(FileError, match=r"cannot be read: .*embedded null"):
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


# Pipes, devices, links


@pytest.fixture
def pipe(tmp_path: Path) -> Path:
    """A named pipe."""
    path = tmp_path / "pipe.csv"
    os.mkfifo(path)
    return path


def in_a_thread(function: Callable[[], object]) -> threading.Thread:
    """The function, running."""
    thread = threading.Thread(target=function)
    thread.start()
    return thread


def test_a_named_pipe_is_read_to_its_end_each_time(pipe: Path):
    for data in (b"x" * 300_000, b"again"):
        writer = in_a_thread(functools.partial(pipe.write_bytes, data))
        assert read_bytes(pipe, "table", 10**6) == data
        writer.join()
        assert read_bytes(pipe, "table", 10**6) == data  # as a command does that looks twice


def test_a_pipe_is_read_no_further_than_the_limit(pipe: Path):
    def write() -> None:
        with contextlib.suppress(BrokenPipeError):
            pipe.write_bytes(b"x" * 3_000_000)

    writer = in_a_thread(write)
    with pytest.raises(FileError, match=r"pipe\.csv' is larger than 1,000 bytes"):
        read_bytes(pipe, "table", 1000)
    writer.join()


def test_a_pipe_that_takes_its_time_is_waited_for(pipe: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(files, "PATIENCE", 0.01)
    opened = threading.Event()

    def write() -> None:
        with pipe.open("wb", buffering=0) as file:
            opened.set()
            time.sleep(0.1)
            file.write(b"late")

    holder = os.open(pipe, os.O_RDWR)  # so that the writer need not wait for the reader
    writer = in_a_thread(write)
    opened.wait()
    os.close(holder)
    assert read_bytes(pipe, "table", 10) == b"late"
    writer.join()


def test_a_named_pipe_without_a_writer_is_refused(pipe: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(files, "PATIENCE", 0.05)
    with pytest.raises(FileError, match=r"pipe\.csv' is a pipe into which nothing was written for"):
        read_bytes(pipe, "table", 10)


@pytest.mark.skipif(sys.platform != "linux", reason="/dev/fd leads to no folder on Linux")
def test_a_pipe_without_a_name_can_be_asked_for_twice():
    reading, writing = os.pipe()
    try:
        os.write(writing, b"once")
        os.close(writing)
        for _ in range(2):
            assert read_bytes(f"/dev/fd/{reading}", "table", 10) == b"once"
    finally:
        os.close(reading)


def test_a_device_is_refused_at_once():
    start = time.monotonic()
    for name in ("/dev/zero", "/dev/null", "/dev/urandom"):
        with pytest.raises(FileError, match=f"table '{name}' is a device; name a file"):
            read_bytes(name, "table", 10**9)
    assert time.monotonic() - start < 1.0


def test_the_terminal_is_refused():
    program = "from calib.model.files import read_bytes; read_bytes('-', 'table', 99)"
    ours, theirs = pty.openpty()
    try:
        call = [sys.executable, "-c", program]
        done = subprocess.run(call, stdin=theirs, capture_output=True, check=False)
    finally:
        os.close(ours)
        os.close(theirs)
    assert b"table '-' is the terminal; name a file" in done.stderr


def test_standard_input_is_a_minus():
    program = "from calib.model.files import read_bytes; print(read_bytes('-', 'table', 99))"
    call = [sys.executable, "-c", program]
    for _ in range(2):
        done = subprocess.run(call, input=b"1;2", capture_output=True, check=True)
        assert done.stdout.strip() == b"b'1;2'"
    with Path(__file__).open("rb") as file:
        done = subprocess.run(call, stdin=file, capture_output=True, check=False)
    assert b"table '-' is larger than 99 bytes" in done.stderr


def test_reads_through_links_and_refuses_circles(tmp_path: Path):
    (tmp_path / "a").write_bytes(b"1")
    (tmp_path / "link").symlink_to("a")
    (tmp_path / "circle").symlink_to("circle")
    (tmp_path / "gone").symlink_to("nowhere")
    assert read_bytes(tmp_path / "link", "table", 9) == b"1"
    with pytest.raises(FileError, match=r"cannot be read: Too many levels of symbolic links"):
        read_bytes(tmp_path / "circle", "table", 9)
    with pytest.raises(FileError, match="does not exist"):
        read_bytes(tmp_path / "gone", "table", 9)
    with pytest.raises(FileError, match=r"cannot be written: Too many levels of symbolic links"):
        write_atomically(tmp_path / "circle", b"", overwrite=True)


@pytest.mark.parametrize("name", ["a b.csv", "\u00e4\u00f6\u4e2d.csv", "\udcff.csv", "-x", "'\"\n"])
def test_strange_names(tmp_path: Path, name: str):
    path = write_atomically(tmp_path / name, b"1", overwrite=False)
    assert write_atomically(path, b"2", overwrite=True).read_bytes() == b"2"
    assert read_bytes(path, "table", 9) == b"2"
    assert names(tmp_path) == [name]
    with pytest.raises(FileError, match="exists already") as caught:
        write_atomically(path, b"3", overwrite=False)
    str(caught.value).encode()


def test_a_place_is_tried_before_the_work(tmp_path: Path):
    kept = tmp_path / "kept"
    kept.write_bytes(b"1")
    for good in (kept, tmp_path / "new"):
        check_writable(good)
    assert names(tmp_path) == ["kept"]
    for bad, says in (
        (tmp_path, "is a folder"),
        (tmp_path / "missing" / "a", "does not exist; create it"),
        (kept / "a", "does not exist; create it"),
        (tmp_path / ("n" * 300), "File name too long"),
        (Path("/dev/full"), "is a device"),
    ):
        with pytest.raises(FileError, match=says):
            check_writable(bad)


@pytest.mark.skipif(sys.platform != "linux", reason="/proc is Linux's")
def test_a_folder_that_takes_no_files_is_found_before_the_work():
    with pytest.raises(FileError, match=r"'/proc/calib\.urdf' cannot be written: .*; choose"):
        check_writable("/proc/calib.urdf")


# A process that ends while it writes


@pytest.mark.parametrize("nameless", [True, False])
@pytest.mark.parametrize("overwrite", [False, True])
def test_the_same_is_written_where_files_need_a_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, nameless: bool, overwrite: bool
):
    if not nameless:
        monkeypatch.delattr(os, "O_TMPFILE", raising=False)
    path = tmp_path / "a"
    if overwrite:
        path.write_bytes(b"old")
        path.chmod(0o640)
    write_atomically(path, b"new" * 1000, overwrite=overwrite)
    check_writable(path)
    assert path.read_bytes() == b"new" * 1000
    assert not overwrite or stat.S_IMODE(path.stat().st_mode) == 0o640
    assert names(tmp_path) == ["a"]


@pytest.mark.skipif(sys.platform != "linux", reason="files without names are Linux's")
def test_a_process_that_is_killed_leaves_the_old_file_or_the_new_one(tmp_path: Path):
    path = tmp_path / "a.json"
    old, new = b"old" * 300_000, b"new" * 300_000
    program = (
        "import sys\n"
        "from calib.model.files import write_atomically\n"
        "print('ready', flush=True)\n"
        "while True:\n"
        "    for word in (b'new', b'old'):\n"
        "        write_atomically(sys.argv[1], word * 300_000, overwrite=True)\n"
    )
    path.write_bytes(old)
    random_ = random.Random(1)
    for number in [signal.SIGKILL, signal.SIGTERM] * 3:
        call = [sys.executable, "-c", program, str(path)]
        with subprocess.Popen(call, stdout=subprocess.PIPE) as process:
            assert process.stdout is not None
            process.stdout.readline()
            time.sleep(0.05 * random_.random())
            process.send_signal(number)
        assert path.read_bytes() in (old, new)
    assert len(names(tmp_path)) <= 2  # the moment between two names is some microseconds


# Several files


def test_files_of_one_command_appear_together(tmp_path: Path):
    (tmp_path / "a").write_bytes(b"old")
    with together():
        assert write_atomically(tmp_path / "a", b"1", overwrite=True) == tmp_path / "a"
        write_atomically(tmp_path / "b", b"2", overwrite=False)
        assert names(tmp_path) == ["a"]
        assert (tmp_path / "a").read_bytes() == b"old"
    assert [(tmp_path / name).read_bytes() for name in names(tmp_path)] == [b"1", b"2"]


def write_two(first: Path, second: Path, data: bytes, *, then: Callable[[], object] = dict) -> None:
    """Write both, and do something else."""
    with together():
        write_atomically(first, b"1", overwrite=False)
        write_atomically(second, data, overwrite=False)
        then()


def test_none_of_them_appears_if_one_cannot_be_written(tmp_path: Path):
    a, b = tmp_path / "a", tmp_path / "b"
    with pytest.raises(FileError, match="does not exist; create it"):
        write_two(a, tmp_path / "missing" / "b", b"2")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        with pytest.raises(FileError, match=r"/b' cannot be written: File too large"):
            write_two(a, b, b"2" * 5000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    with pytest.raises(FileNotFoundError):
        write_two(a, b, b"2", then=(tmp_path / "none").read_bytes)
    assert names(tmp_path) == []
    write_two(a, b, b"2")
    assert names(tmp_path) == ["a", "b"]


def test_a_file_that_a_killed_process_left_is_taken_away_by_the_next_writer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = tmp_path / "a"
    with monkeypatch.context() as patch:

        def killed(*_: object) -> None:
            raise SystemExit

        patch.setattr(Path, "replace", killed)
        with pytest.raises(SystemExit):
            write_atomically(path, b"1", overwrite=True)
    left = [name for name in names(tmp_path) if name.endswith(".tmp")]
    assert len(left) == (1 if hasattr(os, "O_TMPFILE") else 0)
    write_atomically(path, b"2", overwrite=True)
    assert names(tmp_path) == ["a"]
    assert path.read_bytes() == b"2"
