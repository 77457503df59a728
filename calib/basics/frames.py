"""Frames of other libraries, and dicts of columns, as tables in memory; and columns as frames.

pandas, polars and pyarrow are never imported to read a frame: each gives its columns by name, in a way of its own. To
make one, the library is imported by its name.
"""

from __future__ import annotations

import hashlib
import importlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, Protocol, TypeAlias, get_args

from calib.basics.arguments import wrong_type
from calib.basics.tables import Table
from calib.basics.workbook import text_of_cell
from calib.errors import CalibError, MeasurementError, choices

#: Libraries whose frames are made.
Library: TypeAlias = Literal["pandas", "polars"]


class HasItems(Protocol):
    """A dict of columns, or a frame of pandas."""

    def items(self) -> Iterable[tuple[Any, Any]]:
        """Return the columns with their names."""
        ...


class HasSeries(Protocol):
    """A frame of polars."""

    def iter_columns(self) -> Iterable[Any]:
        """Return the columns, which know their names."""
        ...


class HasColumns(Protocol):
    """A table of pyarrow."""

    @property
    def column_names(self) -> Sequence[str]:
        """The names of the columns."""
        ...

    @property
    def columns(self) -> Sequence[Any]:
        """The columns."""
        ...


#: Columns by name: a frame of pandas or polars, a table of pyarrow, or a dict of sequences.
Frame: TypeAlias = HasItems | HasSeries | HasColumns

#: Ways in which a frame gives its columns.
_WAYS = ("items", "iter_columns", "column_names")

_FRAME = "a frame of pandas or polars, or a dict of columns by their headers"


def is_frame(value: object) -> bool:
    """Return True if a value gives columns by name."""
    return any(hasattr(value, way) for way in _WAYS)


def table_of_frame(frame: Frame, argument: str = "frame") -> Table:
    """Return a frame as a table, whose columns are then read as those of a file.

    Args:
        frame: Columns by name: a frame of pandas or polars, a table of pyarrow, or a dict of sequences. What libraries
            take for a missing value is an empty cell.
        argument: Its name, for messages.

    Returns:
        The table, called after the frame's class in messages; ``lines`` are the rows, from 1.

    Raises:
        ArgumentError: It is none of these.
        MeasurementError: It has no columns, or columns of different lengths.
    """
    if not is_frame(frame):
        raise wrong_type(argument, frame, _FRAME)
    source = type(frame).__name__
    columns: list[tuple[str, list[str]]] = []
    for name, values in _columns(frame):
        if isinstance(values, (str, bytes)) or not isinstance(values, Iterable):
            raise wrong_type(f"{argument}[{name!r}]", values, "a sequence of cells")
        columns.append((" ".join(str(name).split()), list(map(text_of_cell, _listed(values)))))
    header = tuple(name for name, _ in columns)
    if not header:
        raise MeasurementError(f"{source}: there are no columns.")
    first, cells_of_first = columns[0]
    for name, cells in columns:
        if len(cells) != len(cells_of_first):
            raise MeasurementError(
                f"{source}: the column '{first}' has {len(cells_of_first)} rows, '{name}' has {len(cells)}. Give all "
                "as many."
            )
    rows = tuple(map(list, zip(*(cells for _, cells in columns), strict=True)))
    text = "\n".join("\t".join(row) for row in (header, *rows))
    sha256 = hashlib.sha256(text.encode()).hexdigest()
    # Between the cells is no sign: a comma in one is decimal, as behind a tab.
    return Table(source, sha256, "\t", header, tuple(range(1, len(rows) + 1)), rows)


def _columns(frame: Any) -> Iterable[tuple[Any, Any]]:  # noqa: ANN401  of any library
    """Return the columns of a frame with their names."""
    if hasattr(frame, "items"):
        columns: Iterable[tuple[Any, Any]] = frame.items()
        return columns
    if hasattr(frame, "iter_columns"):
        return [(series.name, series) for series in frame.iter_columns()]
    return zip(frame.column_names, frame.columns, strict=True)


def _listed(values: Any) -> Iterable[Any]:  # noqa: ANN401  of any library
    """Return the cells of a column as Python's own numbers and texts, where its library can."""
    for way in ("tolist", "to_list", "to_pylist"):
        if hasattr(values, way):
            cells: Iterable[Any] = getattr(values, way)()
            return cells
    return list(values)


def frame_of(columns: Mapping[str, Sequence[Any]], library: Library = "pandas") -> Any:  # noqa: ANN401
    """Return columns as a frame.

    Args:
        columns: Numbers, words or truth values by the names of the columns; None where there is none.
        library: ``"pandas"`` or ``"polars"``.

    Returns:
        A ``pandas.DataFrame`` or a ``polars.DataFrame``.

    Raises:
        CalibError: Another library, or it is not installed.
    """
    if library not in get_args(Library):
        raise CalibError(
            f"The library '{library}' is not one whose frames are made; choose one of {choices(get_args(Library))}."
        )
    try:
        made = importlib.import_module(library)
    except ImportError as error:
        raise CalibError(
            f"A frame needs {library}, which is not installed: pip install 'robot-calib[{library}]'"
        ) from error
    return made.DataFrame(dict(columns))
