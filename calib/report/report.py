"""The report of a calibration: verdict first, then errors before and after, figures, parameters, and the method.

One HTML page, ``report.html.j2`` filled in: figures inside, no script, nothing from the network; it prints on A4.
"""

from __future__ import annotations

import base64
import os
from collections import Counter
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

import calib.report.tables as tables
import calib.text.summary as texts
from calib.data.forms.orientations import find_convention
from calib.data.kinds import get as kind_named
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Why
from calib.errors import FileError
from calib.files import write_atomically
from calib.numerics.intervals import interval_factor
from calib.report.tables import MOST_LISTED
from calib.result.calibration import CalibrationValues
from calib.result.calibration_file import versions
from calib.text.layout.doubtful_rows import outside_text, robustness_text
from calib.text.layout.lines import deg, mm
from calib.text.places import frame_sentences, target_sentences
from calib.text.readings import coupling_sentence
from calib.text.verdict import reason_text

if TYPE_CHECKING:
    from calib.report.figures import Drawing

#: A drawing with more bytes than this as SVG goes into the page as PNG: browsers scroll slowly over large SVG.
_LARGE = 260_000

#: A longer word in a table [letters] may be broken anywhere: it would push its table off the page.
_LONGEST_WORD = 24


def write_report(
    calibration: CalibrationValues,
    path: str | Path,
    *,
    command: str = "",
    overwrite: bool = False,
) -> Path:
    """Write the report of a calibration as one HTML page.

    Args:
        calibration: The result.
        path: Name of the file, which ends in .html or .htm.
        command: The command line that made the calibration; empty where there was none.
        overwrite: Replace an existing file.

    Returns:
        The file's path.

    Raises:
        FileError: The name does not end in .html or .htm, the file exists, or it cannot be written.
    """
    check_ending(path)
    page = report_bytes(calibration, command=command)
    return write_atomically(path, page, overwrite=overwrite)


def check_ending(path: str | Path) -> None:
    """Refuse a file name that does not end in .html or .htm.

    Raises:
        FileError: It does not.
    """
    if Path(path).suffix.lower() not in (".html", ".htm"):
        raise FileError(
            f"'{path}': a report is a page; let the name end in .html. The summary is its text."
        )


def report_bytes(calibration: CalibrationValues, *, command: str = "") -> bytes:
    """Return the page, UTF-8.

    Two reports of one calibration differ in their date only: that of the environment variable ``SOURCE_DATE_EPOCH``
    (seconds since 1970), else now.

    Args:
        calibration: The result.
        command: The command line that made it; empty where there was none.
    """
    import jinja2

    from calib.report.figures import drawings

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.tests["long"] = _has_long_word
    content = _content(calibration)
    content["command"] = command or "not from the command line"
    content["date"] = _date()
    content["figures"] = [(figure, _picture(figure)) for figure in drawings(calibration)]
    page = environment.get_template("report.html.j2").render(**content)
    return page.encode("utf-8", "replace")


def _has_long_word(text: str) -> bool:
    """Tell if a cell holds a word that must be broken to fit its column."""
    return any(len(word) > _LONGEST_WORD for word in text.split())


def _date() -> str:
    """Return the date and time of the report, UTC."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH", "")
    date = datetime.now(timezone.utc)
    if epoch.isdecimal():
        date = datetime.fromtimestamp(int(epoch), timezone.utc)
    return f"{date:%Y-%m-%d %H:%M} UTC"


def _picture(drawing: Drawing) -> str:
    """Draw a figure and return it as a data address: SVG, or PNG where SVG would be large."""
    from calib.report.figures import rendered

    media_type = "svg+xml"
    data = rendered(drawing, "svg")
    if len(data) > _LARGE:
        media_type = "png"
        data = rendered(drawing, "png")
    return f"data:image/{media_type};base64,{base64.b64encode(data).decode('ascii')}"


def _rows_text(m: Measurements) -> str:
    """Return how many rows there are, and in which convention orientations were given."""
    text = f"{m.estimation.sum():,} to estimate, {m.validation.sum():,} to validate"
    if m.orientation:
        text += f"; orientations as {find_convention(m.orientation).words}"
    return text


def _content(c: CalibrationValues) -> dict[str, Any]:
    """Return the variables of the template, all but date, command and figures.

    The template calls `calib.report.tables` and `calib.text.summary` itself; here are the texts that need more.
    """
    m = c.measurements
    reasons = c.verdict.reasons if c.verdict else ()
    return {
        "c": c,
        "texts": texts,
        "tables": tables,
        "known": texts.facts(c),
        "source": m.source or "from memory",
        "rows_text": _rows_text(m),
        "reasons": [reason_text(reason) for reason in reasons],
        "robustness": robustness_text(c.robustness) if c.robustness else "",
        "unweighted": int(np.sum(c.weights[m.estimation] <= 0.0)),
        "factor": f"{interval_factor(c.fitted.estimate.freedom):.2f}",
        "places": [*target_sentences(c, MOST_LISTED), *frame_sentences(c, MOST_LISTED)],
        "combinations": _combinations(c),
        "kinds": _kinds(c),
        "outside": _outside(c),
        "versions": ", ".join(f"{name} {version}" for name, version in versions().items()),
        **_measurement_setup(c),
    }


def _combinations(c: CalibrationValues) -> list[str]:
    """Word the unidentifiable combinations of parameters; beyond `MOST_LISTED` they are counted."""
    combinations = [
        texts.combination_text(combination) for combination in c.observability.unidentifiable
    ]
    listed = combinations[:MOST_LISTED]
    more = len(combinations) - len(listed)
    if more:
        listed.append(f"and {more} more")
    return listed


def _kinds(c: CalibrationValues) -> str:
    """Word the kinds of measurements with their numbers of rows."""
    counts = Counter(c.measurements.kinds)
    return "; ".join(f"{kind_named(kind).words} ({n:,} rows)" for kind, n in counts.items())


def _outside(c: CalibrationValues) -> str:
    """Word the validation rows outside of the fitted joint ranges; empty where the verdict names them already."""
    if c.verdict and any(reason.why == Why.OUTSIDE for reason in c.verdict.reasons):
        return ""
    m = c.measurements
    return outside_text(c.outside, np.array(m.rows)[m.validation].tolist())


def _measurement_setup(c: CalibrationValues) -> dict[str, str]:
    """Write the base's position [mm] and rpy angles [deg] in the measurement frame, held joints, coupled readings."""
    T_frame_base = c.T_frame_base
    rpy = pin.rpy.matrixToRpy(T_frame_base[:3, :3])
    held = [f"{name} at {value:.6g}" for name, value in c.cell.held.items()]
    return {
        "at": ", ".join(mm(value) for value in T_frame_base[:3, 3]),
        "rpy": ", ".join(deg(angle) for angle in rpy),
        "held": ", ".join(held),
        "coupling": coupling_sentence(c.nominal).partition(": ")[2],
    }
