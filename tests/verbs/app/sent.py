"""Files as people send them: the paper's robot and table in many other forms."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path

from openpyxl import Workbook

from calib.example import paper_measurements, paper_urdf
from calib.verbs.app.job import Job, Kind

URDF = paper_urdf().read_bytes()
TABLE = paper_measurements().read_text()

#: The rows of the table, its header first.
ROWS = [line.split(",") for line in TABLE.splitlines()]

JOINTS = tuple(label.removesuffix(" [deg]") for label in ROWS[0][2:8])


def with_header(*labels: str) -> bytes:
    """The table with other names of its columns, after ``row`` and ``set``."""
    header = [*ROWS[0][:2], *labels]
    return "\n".join([",".join(header), *(",".join(row) for row in ROWS[1:]), ""]).encode()


def joints_and_points(heading: str = "") -> tuple[bytes, bytes]:
    """The table of joint values, and the list of points as a tracker's program writes it."""
    table = [[*ROWS[0][:8], "point"], *([*row[:8], f"P{row[0]}"] for row in ROWS[1:])]
    points = [f"P{row[0]} {row[8]} {row[9]} {row[10]}" for row in ROWS[1:]]
    return (
        "\n".join(",".join(row) for row in table).encode(),
        "\n".join([*filter(None, [heading]), *points]).encode(),
    )


def workbook(*sheets: str) -> bytes:
    """An Excel file whose last sheet is the table; the others have a note."""
    book = Workbook()
    book.remove(book.active)
    for name in sheets[:-1]:
        book.create_sheet(name).append(["Notes"])
    sheet = book.create_sheet(sheets[-1])
    sheet.append(ROWS[0])
    for row in ROWS[1:]:
        sheet.append([int(row[0]), row[1], *map(float, row[2:])])
    data = io.BytesIO()
    book.save(data)
    return data.getvalue()


def job_of(folder: Path, files: Mapping[str, bytes], **choices: str) -> Job:
    """A job of these files."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)
    return Job(
        folder=folder, kind=Kind.CALIBRATE, created="", key="", inputs=tuple(files), choices=choices
    )
