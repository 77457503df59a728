from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import openpyxl
import pytest

from calib.boards.opencv import opencv
from calib.errors import DeviceError, MeasurementError
from calib.verbs.measure.devices.files import FileReader, FolderReader
from calib.verbs.measure.devices.reading import Reading
from tests.verbs.measure.devices.contexts import UR

HEADER = "x [mm],y [mm],z [mm]\n"

#: Writes pieces to a file, one for each line of its input, which is a Python literal: a mode, a name and bytes.
WRITER = """
import ast, sys
files = {}
for line in sys.stdin:
    mode, name, data = ast.literal_eval(line)
    file = files.get(name) if mode == "ab" else None
    if file is None:
        file = files[name] = open(name, mode, buffering=0)
    file.write(data)
    print("written", flush=True)
"""


class Writer:
    """Another program, which writes files."""

    def __init__(self, process: subprocess.Popen[str], folder: Path) -> None:
        self.process, self.folder = process, folder

    def append(self, name: str, data: bytes) -> None:
        self._write("ab", name, data)

    def replace(self, name: str, data: bytes) -> None:
        self._write("wb", name, data)

    def _write(self, mode: str, name: str, data: bytes) -> None:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(f"{(mode, name, data)!r}\n")
        self.process.stdin.flush()
        assert self.process.stdout.readline() == "written\n"


@pytest.fixture
def writer(tmp_path: Path) -> Iterator[Writer]:
    with subprocess.Popen(
        [sys.executable, "-S", "-c", WRITER],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
    ) as process:
        yield Writer(process, tmp_path)
        process.kill()


@contextmanager
def opened(reader):
    try:
        yield reader
    finally:
        reader.close()


def first(reading: Reading | None) -> list[float]:
    """The first coordinates of a reading's rows [mm]."""
    assert reading is not None
    return [row["x [mm]"] if "x [mm]" in row else 1e3 * row["x [m]"] for row in reading.rows]  # type: ignore[operator, misc]


# A file


def test_rows_that_another_program_appends(writer: Writer, tmp_path: Path):
    writer.append("a.csv", HEADER.encode() + b"1,2,3\n")
    with opened(FileReader(str(tmp_path / "a.csv"), UR)) as reader:
        assert reader.read(0.0) is None  # what is there is old
        writer.append("a.csv", b"4,5,6\n7,8,9\r\n")
        reading = reader.read(2.0)
        assert reading is not None
        assert reading.rows == ({"x [mm]": 4.0, "y [mm]": 5.0, "z [mm]": 6.0},)
        assert reading.source == "a.csv, line 3"
        assert first(reader.read(0.0)) == [7.0]
        assert reader.read(0.0) is None


def test_half_a_row_waits_for_its_end(writer: Writer, tmp_path: Path):
    writer.append("a.csv", HEADER.encode())
    with opened(FileReader(str(tmp_path / "a.csv"), UR)) as reader:
        writer.append("a.csv", b"4,5,6")  # a pause within a number
        assert reader.read(0.5) is None
        writer.append("a.csv", b"1.5\n")
        reading = reader.read(1.0)
        assert reading is not None
        assert reading.rows[0]["z [mm]"] == 61.5


def test_a_file_that_appears_and_is_written_anew(writer: Writer, tmp_path: Path):
    with opened(FileReader(str(tmp_path / "points.txt"), UR)) as reader:
        assert reader.read(0.0) is None
        exported = "Units: mm\r\nPrüfling_1 101,5 200,25 300,125\r\n".encode("cp1252")
        writer.replace("points.txt", exported)
        assert first(reader.read(2.0)) == [pytest.approx(101.5)]
        writer.replace("points.txt", b"")
        assert reader.read(0.0) is None
        writer.replace("points.txt", exported + b"P2 102,5 200,25 300,125\r\n")
        assert first(reader.read(2.0)) == [pytest.approx(102.5)]
        assert reader.read(0.0) is None


def test_a_last_line_that_never_has_an_end_counts_when_the_program_pauses(
    writer: Writer, tmp_path: Path
):
    with opened(FileReader(str(tmp_path / "points.txt"), UR)) as reader:
        writer.replace("points.txt", b"# Units: mm\nP1 101.5 200.25 300.125")
        assert first(reader.read(2.0)) == [pytest.approx(101.5)]


def test_a_name_is_the_same_while_the_file_grows(writer: Writer, tmp_path: Path):
    # Cut within a letter the text would be read in another encoding, and its earlier rows be new ones.
    text = f"target,{HEADER}Bär,1,2,3\nBär,4,5,6\n".encode()
    cut = text.rindex(b"\xa4")
    with opened(FileReader(str(tmp_path / "a.csv"), UR)) as reader:
        writer.append("a.csv", text[:cut])
        assert first(reader.read(2.0)) == [1.0]
        writer.append("a.csv", text[cut:])
        assert first(reader.read(2.0)) == [4.0]
        assert reader.read(0.0) is None


def test_a_malformed_row_is_refused_and_reading_goes_on(writer: Writer, tmp_path: Path):
    writer.append("a.csv", HEADER.encode())
    with opened(FileReader(str(tmp_path / "a.csv"), UR)) as reader:
        writer.append("a.csv", b"1,2\n4,5,6\n")
        assert first(reader.read(2.0)) == [4.0]
        with pytest.raises(MeasurementError, match=r"a\.csv, line 2 "):
            reader.read(0.0)
        assert reader.read(0.0) is None
        writer.append("a.csv", b"7,8,9\n")
        assert first(reader.read(2.0)) == [7.0]


def test_a_workbook_is_read_when_it_is_complete(tmp_path: Path):
    path = tmp_path / "a.xlsx"
    book = openpyxl.Workbook()
    book.active.append(["x [mm]", "y [mm]", "z [mm]"])
    book.active.append([1.5, 2, 3])
    book.save(tmp_path / "whole.xlsx")
    data = (tmp_path / "whole.xlsx").read_bytes()
    with opened(FileReader(str(path), UR)) as reader:
        path.write_bytes(data[:2000])
        assert reader.read(0.2) is None
        path.write_bytes(data)
        assert first(reader.read(2.0)) == [1.5]
        book.active.append([4.5, 5, 6])
        book.save(path)
        assert first(reader.read(2.0)) == [4.5]


def test_what_cannot_be_a_file_of_rows_is_refused_at_once(tmp_path: Path):
    for argument in ("", str(tmp_path), str(tmp_path / "none" / "a.csv")):
        with pytest.raises(DeviceError):
            FileReader(argument, UR)
    (tmp_path / "a.txt").write_text("P1 101.5 200.5 300.5\n")
    with pytest.raises(MeasurementError, match="one unit of length"):
        FileReader(str(tmp_path / "a.txt"), UR)


def test_a_reader_that_is_closed_waits_no_longer(tmp_path: Path):
    reader = FileReader(str(tmp_path / "a.csv"), UR)
    answers: list[Reading | None] = [Reading()]
    thread = threading.Thread(target=lambda: answers.append(reader.read()))
    thread.start()
    time.sleep(0.05)
    assert thread.is_alive()
    reader.close()
    thread.join(1.0)
    assert answers[1:] == [None]


# A folder


def picture(ending: str) -> bytes:
    rng = np.random.default_rng(1)
    image = rng.integers(0, 255, (120, 160), dtype=np.uint8)
    data: bytes = opencv().imencode(ending, image)[1].tobytes()
    return data


@pytest.mark.parametrize("ending", [".png", ".jpg"])
def test_a_picture_is_taken_when_it_is_whole(writer: Writer, tmp_path: Path, ending: str):
    data = picture(ending)
    (tmp_path / f"old{ending}").write_bytes(data)
    with opened(FolderReader(str(tmp_path), UR)) as reader:
        assert reader.read(0.0) is None
        writer.append(f"a{ending}", data[:5000])
        assert reader.read(0.5) is None
        writer.append(f"a{ending}", data[5000:])
        reading = reader.read(2.0)
        assert reading is not None
        assert reading.pictures == (tmp_path / f"a{ending}",)
        assert reader.read(0.0) is None


def test_files_are_given_as_they_were_written(tmp_path: Path):
    with opened(FolderReader(str(tmp_path), UR)) as reader:
        (tmp_path / "b.bmp").write_bytes(picture(".bmp"))
        (tmp_path / "a.csv").write_text(f"target,{HEADER}T1,1,2,3\nT2,4,5,6\n")
        (tmp_path / ".hidden.csv").write_text(f"{HEADER}9,9,9\n")
        (tmp_path / "notes.docx").write_bytes(b"none")
        (tmp_path / "empty.csv").touch()
        (tmp_path / "folder.png").mkdir()
        now = time.time()
        for name, age in (("b.bmp", 2.0), ("a.csv", 1.0)):
            os.utime(tmp_path / name, (now - age, now - age))
        reading = reader.read(2.0)
        assert reading is not None
        assert reading.pictures == (tmp_path / "b.bmp",)
        reading = reader.read(2.0)
        assert first(reading) == [1.0, 4.0]
        assert reading is not None
        assert [row["target"] for row in reading.rows] == ["T1", "T2"]
        assert reader.read(0.0) is None


def test_a_file_that_is_written_again_gives_its_new_rows(tmp_path: Path):
    (tmp_path / "old.csv").write_text(f"{HEADER}1,2,3\n")
    with opened(FolderReader(str(tmp_path), UR)) as reader:
        (tmp_path / "old.csv").write_text(f"{HEADER}1,2,3\n4,5,6\n")
        assert first(reader.read(2.0)) == [4.0]


def test_a_malformed_file_is_said_and_reading_goes_on(tmp_path: Path):
    with opened(FolderReader(str(tmp_path), UR)) as reader:
        (tmp_path / "a.csv").write_text(f"{HEADER}1,2\n4,5,6\n")
        assert first(reader.read(2.0)) == [4.0]
        with pytest.raises(MeasurementError, match=r"a\.csv, line 2"):
            reader.read(0.0)
        (tmp_path / "b.csv").write_bytes(b"\0\1\2\3")
        with pytest.raises(MeasurementError, match="not a text file"):
            reader.read(2.0)
        assert reader.read(0.0) is None


@pytest.mark.slow
def test_a_picture_that_stays_half_is_refused(tmp_path: Path):
    with opened(FolderReader(str(tmp_path), UR)) as reader:
        (tmp_path / "a.png").write_bytes(picture(".png")[:5000])
        with pytest.raises(MeasurementError, match=r"a\.png' has no end"):
            reader.read(8.0)
        assert reader.read(0.5) is None


def test_a_folder_that_is_away_for_a_while(tmp_path: Path):
    folder = tmp_path / "share"
    folder.mkdir()
    with pytest.raises(DeviceError, match="needs a folder that exists"):
        FolderReader(str(tmp_path / "none"), UR)
    with opened(FolderReader(str(folder), UR)) as reader:
        shutil.rmtree(folder)
        with pytest.raises(DeviceError, match="cannot be read"):
            reader.read(0.5)
        assert reader.read(0.15) is None  # it is said once
        folder.mkdir()
        (folder / "a.csv").write_text(f"{HEADER}1,2,3\n")
        assert first(reader.read(2.0)) == [1.0]
