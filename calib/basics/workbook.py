"""Sheets of Excel files as the text of a table: cells between tabs, a line for each row of the sheet.

So tables, programs and lists of points in a sheet are read by the readers of text, with the sheet's row numbers.
"""

from __future__ import annotations

import csv
import io
import os
import warnings
from datetime import date, time, timedelta
from typing import TYPE_CHECKING
from zipfile import BadZipFile

from calib.basics.files import read_bytes
from calib.errors import MeasurementError, choices, did_you_mean

if TYPE_CHECKING:
    from openpyxl import Workbook

#: Endings of the files' names, in lower case.
SUFFIXES = (".xlsx", ".xlsm")

#: Between the name of a file and that of its sheet.
_BEFORE_SHEET = "#"

#: How missing values of other libraries write themselves.
_MISSING = ("nan", "<NA>", "NaT")

#: Whole numbers below this are written without a point: where some are missing, libraries make floats of all.
_WHOLE = 1e15

#: Exceptions of openpyxl for a file that is not of Excel, or is damaged.
_DAMAGED = (BadZipFile, KeyError, ValueError, TypeError, IndexError, AttributeError, SyntaxError)


def split_sheet(path: str) -> tuple[str, str | None]:
    """Split a path such as ``"table.xlsx#Sheet"`` into file and sheet.

    Returns:
        The path of the file, and the sheet's name: ``""`` for the first sheet, None if it is not an Excel file.
    """
    file, mark, sheet = path.rpartition(_BEFORE_SHEET)
    if mark and file.casefold().endswith(SUFFIXES):
        return file, sheet.strip()
    return path, "" if path.casefold().endswith(SUFFIXES) else None


def read_sheet(data: bytes, source: str, sheet: str) -> tuple[str, str]:
    r"""Read a sheet of an Excel file as text, cells between tabs.

    Args:
        data: The file's bytes.
        source: The file's name, for messages.
        sheet: The sheet's name; empty: the first one.

    Returns:
        The text: lines that end in ``\n``, one for each row from the first, numbers with all their digits. And the
        sheet's name, empty if the file has no other sheet.

    Raises:
        MeasurementError: openpyxl is not installed, the file or the sheet cannot be read, or a formula has no value.
    """
    values = _load(data, source, values=True)
    sheets = {worksheet.title: worksheet for worksheet in values.worksheets}
    if not sheets or (sheet and sheet not in sheets):
        file = source.rpartition(_BEFORE_SHEET)[0]
        first = next(iter(sheets), "")
        raise MeasurementError(
            f"{file}: there is no sheet '{sheet}'{did_you_mean(sheet, sheets)}; it has {choices(sheets)}. Name one "
            f'after the file, "{file}{_BEFORE_SHEET}{first}".'
        )
    name = sheet or next(iter(sheets))
    formulas = _load(data, source, values=False)[name]

    text = io.StringIO()
    writer = csv.writer(text, delimiter="\t", lineterminator="\n")
    for row in sheets[name].iter_rows(min_row=1, min_col=1):
        for cell in row:
            if cell.value is None and formulas[cell.coordinate].data_type == "f":
                raise MeasurementError(
                    f"{source}, sheet '{name}', cell {cell.coordinate}: the formula has no value. Open and "
                    "save the file in Excel or LibreOffice, which compute it, or save it as CSV."
                )
        writer.writerow([text_of_cell(cell.value) for cell in row])
    return text.getvalue(), "" if len(sheets) == 1 else name


def sheet_names(path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Return the names of the sheets of an Excel file; FileError or MeasurementError as of `read_sheet`."""
    data = read_bytes(path, "Excel file")
    return tuple(worksheet.title for worksheet in _load(data, str(path), values=True).worksheets)


def _load(data: bytes, source: str, *, values: bool) -> Workbook:
    """Load an Excel file, its cells with the values of their formulas or with the formulas.

    MeasurementError, with the file's name ``source``, if openpyxl is not installed or the file is damaged.
    """
    try:
        from openpyxl import load_workbook
    except ImportError as error:
        raise MeasurementError(
            f"{source}: Excel files are read with openpyxl, which is not installed: pip install "
            "'robot-calib[xlsx]'. Or save the sheet as CSV (UTF-8)."
        ) from error
    try:
        with warnings.catch_warnings():  # about what a table does not need, such as styles
            warnings.simplefilter("ignore")
            return load_workbook(io.BytesIO(data), data_only=values)
    except _DAMAGED as error:
        raise MeasurementError(
            f"{source}: this is not an Excel file (.xlsx), or it is damaged ({type(error).__name__}). Save it again, "
            "or as CSV (UTF-8)."
        ) from error


def text_of_cell(value: object) -> str:
    """Return a cell's value as text: a number with all its digits, a date marked as one, nothing for a missing value.

    Args:
        value: A number, a text, a truth value, a date; what pandas and polars have for a missing one is none.
    """
    if value is None or str(value) in _MISSING:
        return ""
    if isinstance(value, bool):
        return str(value).upper()
    if isinstance(value, float):
        number = float(value)
        return str(int(number)) if number.is_integer() and abs(number) < _WHOLE else repr(number)
    if isinstance(value, (date, time, timedelta)):
        return f"date {value}"
    return " ".join(str(value).split())
