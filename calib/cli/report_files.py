"""Report and figures of ``calib fit``: what their options mean, what is refused, and what is written."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.errors import CalibError, FileError

if TYPE_CHECKING:
    from calib.identify.result import Calibration


class FigureFormat(str, Enum):
    """The kinds of picture files."""

    png = "png"
    svg = "svg"
    pdf = "pdf"


ReportFile = Annotated[
    Path | None,
    typer.Option(
        "--report",
        metavar="FILE",
        help="Write a report with figures to print and sign: a page, .html.",
    ),
]
FigureFolder = Annotated[
    Path | None,
    typer.Option(
        "--figures",
        metavar="FOLDER",
        help="Write every figure into a folder, and their captions as captions.md; it is made if missing.",
    ),
]
FigureKind = Annotated[
    FigureFormat | None,
    typer.Option("--figure-format", help="The kind of file of --figures. Default: png."),
]


def check_report(
    report: Path | None,
    figures: Path | None,
    kind: FigureFormat | None,
    others: Iterable[Path | None] = (),
) -> None:
    """Refuse before the work what cannot be written after it.

    Args:
        report: The report's file.
        figures: The figures' folder.
        kind: Their kind.
        others: What else the command reads and writes.

    Raises:
        FileError: The report's name has an ending that no report has, or a file stands where the folder should,
            or will.
        CalibError: A kind of figures, and no folder for them.
    """
    if kind is not None and figures is None:
        message = (
            f"--figure-format {kind.value} is for figures; name their folder with --figures FOLDER."
        )
        raise CalibError(message)
    if figures is not None and figures.exists() and not figures.is_dir():
        message = f"{figures} is a file; --figures names a folder, choose another name."
        raise FileError(message)
    if figures is not None:
        _check_folder(figures, (report, *others))
    if report is not None:
        from calib.show.report import check_ending

        check_ending(report)


def _check_folder(folder: Path, files: Iterable[Path | None]) -> None:
    """Refuse a folder whose name a file is to have, or in whose path one stands.

    Raises:
        FileError: It has.
    """
    real = Path(os.path.realpath(folder))
    for file in files:
        if file is None:
            continue
        taken = Path(os.path.realpath(file))
        if taken == real or taken in real.parents:
            message = (
                f"{folder} is the folder of --figures, and {file} is a file of this command: both cannot have the "
                "name; choose another for one of them."
            )
            raise FileError(message)


def check_figures(
    result: Calibration, folder: Path | None, kind: FigureFormat | None, *, force: bool
) -> None:
    """Refuse figures whose files exist before any file is written.

    Raises:
        FileError: A file of that name exists.
    """
    if folder is None or force:
        return
    from calib.show.figures import check_free, drawings, figure_files

    check_free(figure_files(drawings(result), folder, _ending(kind)))


def write_report_files(
    result: Calibration,
    report: Path | None,
    figures: Path | None,
    kind: FigureFormat | None,
    *,
    force: bool,
    quiet: bool,
) -> Iterator[str]:
    """Write the report and the figures asked for, one after the other, and say what was written."""
    if report is not None:
        from calib.cli.terminal import command_line
        from calib.show.report import write_report

        yield str(write_report(result, report, command=command_line(), overwrite=force))
    if figures is not None:
        from calib.cli.progress import progress_bar
        from calib.show.figures import write_figures

        with progress_bar("figures", quiet=quiet) as progress:
            made = write_figures(
                result, figures, kind=_ending(kind), overwrite=force, progress=progress
            )
        yield f"{figures} ({len(made)} figures)"


def _ending(kind: FigureFormat | None) -> str:
    """The ending of a figure's file."""
    return "png" if kind is None else kind.value
