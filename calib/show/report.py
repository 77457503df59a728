"""The report of a calibration: verdict first, then errors before and after, figures, parameters, and how it came about.

It is said once, as a `Document`, and set as a page that can be printed and signed, as Markdown, or as text.
"""

from __future__ import annotations

from pathlib import Path

from calib.errors import FileError, choices
from calib.identify.result import Calibration
from calib.model.files import write_atomically
from calib.show.document import Document, Picture, Section
from calib.show.figures import drawings
from calib.show.report_accuracy import accuracy_blocks, outlier_blocks, verdict_blocks
from calib.show.report_html import as_html
from calib.show.report_markdown import as_markdown
from calib.show.report_record import (
    heading_facts,
    measurement_blocks,
    method_blocks,
    report_date,
    sign_blocks,
    trace_blocks,
)
from calib.show.report_robot import (
    candidate_blocks,
    geometry_blocks,
    parameter_blocks,
    unknown_blocks,
)
from calib.show.report_text import as_text

#: The figures that stand in a section of their matter, by name; all others are figures of the errors.
_BESIDE = {
    "Parameters": ("parameter-changes", "correlations"),
    "What the measurements do not tell": ("singular-values", "workspace-uncertainty"),
    "Models tried": ("candidates",),
    "How it was computed": ("convergence",),
}

#: What a report's file name may end in.
ENDINGS = (".html", ".htm", ".md", ".txt")


def report_of(
    calibration: Calibration, *, command: str = "", figures: bool = True, date: str = ""
) -> Document:
    """What the report says, before it is set.

    The date is that of the clock, or ``SOURCE_DATE_EPOCH`` if that is set, where none is given; nothing else differs
    between two reports of the same calibration.

    Args:
        calibration: The calibration.
        command: The command that made it, as it was typed; empty where there was none.
        figures: Whether it has figures.
        date: That it bears.
    """
    c, date = calibration, date or report_date()
    pictures = tuple(Picture(one) for one in drawings(c)) if figures else ()
    beside = {
        title: [p for p in pictures if p.drawing.name in names] for title, names in _BESIDE.items()
    }
    others = [p for p in pictures if not any(p in some for some in beside.values())]
    sections = (
        Section("Verdict", verdict_blocks(c)),
        Section("Accuracy before and after", accuracy_blocks(c)),
        Section("Figures of the errors", tuple(others)),
        Section("Parameters", parameter_blocks(c)),
        Section("Geometry before and after", geometry_blocks(c)),
        Section("Outliers", outlier_blocks(c)),
        Section("What the measurements do not tell", unknown_blocks(c)),
        Section("Models tried", candidate_blocks(c)),
        Section("How it was measured", measurement_blocks(c)),
        Section("How it was computed", method_blocks(c)),
        Section("Files, versions, command", trace_blocks(c, command, date)),
        Section("Signatures", sign_blocks(c, date)),
    )
    return Document(
        f"Calibration report: robot {c.nominal.name}",
        heading_facts(c, date),
        tuple(Section(s.title, (*s.blocks, *beside.get(s.title, ()))) for s in sections),
    )


def report_bytes(
    calibration: Calibration, ending: str, *, command: str = "", date: str = ""
) -> bytes:
    """The report as a file's content, UTF-8.

    Args:
        calibration: The calibration.
        ending: One of `ENDINGS`.
        command: See `report_of`.
        date: See `report_of`.
    """
    pictured = ending in (".html", ".htm")
    document = report_of(calibration, command=command, figures=pictured, date=date)
    text = (
        as_html(document)
        if pictured
        else as_markdown(document)
        if ending == ".md"
        else as_text(document)
    )
    return text.encode("utf-8", "replace")


def write_report(
    calibration: Calibration, path: str | Path, *, command: str = "", overwrite: bool = False
) -> Path:
    """Write the report: a page (.html), Markdown (.md) or text (.txt), by the name's ending.

    The page is whole: figures inside, no script, nothing from the network; it prints on A4.

    Args:
        calibration: The calibration.
        path: Where to.
        command: See `report_of`.
        overwrite: Whether an existing file may be replaced.

    Raises:
        FileError: The name has another ending, the file exists, or it cannot be written.
    """
    ending = check_ending(path)
    return write_atomically(
        path, report_bytes(calibration, ending, command=command), overwrite=overwrite
    )


def check_ending(path: str | Path) -> str:
    """The ending of a report's name, in small letters.

    Raises:
        FileError: It is none of `ENDINGS`.
    """
    ending = Path(path).suffix.lower()
    if ending not in ENDINGS:
        message = f"'{path}': a report is a page, Markdown or text; let the name end in one of {choices(ENDINGS)}."
        raise FileError(message)
    return ending
