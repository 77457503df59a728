"""The report of a calibration: a first page to sign, then errors before and after, figures, parameters, and the method.

One HTML page, ``report.html.j2`` filled in; see `calib.show.page`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import calib.verbs.calibrate.tables as tables
import calib.verbs.calibrate.text as texts
from calib.basics.files import write_atomically
from calib.data.forms.orientations import find_convention
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Why
from calib.numerics.errors import interval_factor
from calib.result.calibration import Calibration
from calib.result.calibration_file import versions
from calib.show.doubtful_rows import outside_text, robustness_text
from calib.show.first_page import (
    FirstPage,
    Outcome,
    left_lines,
    right_lines,
    robot_name,
)
from calib.show.lines import deg, mm, plural, times
from calib.show.page import check_ending, page_bytes
from calib.show.readings import coupling_sentence
from calib.show.row_values import kinds_text
from calib.show.table import MOST_LISTED
from calib.show.verdict import reason_text
from calib.show.words import combination_text
from calib.verbs.calibrate.camera.tables import image_errors, units_of_tables, with_errors_at_board
from calib.verbs.calibrate.optics_text import optics_sentences
from calib.verbs.calibrate.places_text import frame_sentences, target_sentences


def write_report(
    calibration: Calibration,
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


def report_bytes(calibration: Calibration, *, command: str = "") -> bytes:
    """Return the page, UTF-8, see `calib.show.page.page_bytes`.

    Args:
        calibration: The result.
        command: The command line that made it; empty where there was none.
    """
    from calib.verbs.calibrate.figures import drawings

    content = _content(calibration)
    content["command"] = command or "not from the command line"
    return page_bytes(Path(__file__).with_name("report.html.j2"), content, drawings(calibration))


def _rows_text(m: Measurements) -> str:
    """Return how many rows there are, and in which convention orientations were given."""
    text = f"{m.estimation.sum():,} to estimate, {m.validation.sum():,} to validate"
    if m.orientation:
        text += f"; orientations as {find_convention(m.orientation).words}"
    return text


def _content(c: Calibration) -> dict[str, Any]:
    """Return the variables of the template, all but date, command and figures.

    The template calls `calib.verbs.calibrate.tables` and `.text` itself; here are the texts that need more.
    """
    reasons = _reasons(c)
    return {
        "c": c,
        "document": "Calibration report",
        "first": _first_page(c, reasons),
        "texts": texts,
        "tables": tables,
        "known": texts.facts(c),
        "source": c.fit.measurements.source or "from memory",
        "rows_text": _rows_text(c.fit.measurements),
        "reasons": reasons,
        "robustness": robustness_text(c.trust.robustness) if c.trust.robustness else "",
        "unweighted": int(np.sum(c.rows.weights[c.fit.measurements.estimation] <= 0.0)),
        "factor": f"{interval_factor(c.fit.geometry.estimate.freedom):.2f}",
        "places": [
            *target_sentences(c, MOST_LISTED),
            *frame_sentences(c, MOST_LISTED),
            *optics_sentences(c),
        ],
        "combinations": _combinations(c),
        "image_errors": image_errors(c),
        "units": units_of_tables(c),
        "kinds": kinds_text(c.fit.measurements),
        "outside": _outside(c),
        "versions": ", ".join(f"{name} {version}" for name, version in versions().items()),
        **_measurement_setup(c),
    }


def _reasons(c: Calibration) -> list[str]:
    """Word the reasons of the verdict, or why there is none."""
    if c.verdict is None:
        return ["No verdict: the result was not cross-validated."]
    return [reason_text(reason) for reason in c.verdict.reasons]


def _first_page(c: Calibration, reasons: list[str]) -> FirstPage:
    """Return the first page; ``reasons`` are those of the verdict in words."""
    noise = texts.facts(c)["Noise"]
    return FirstPage(
        robot=robot_name(c.nominal),
        outcome=Outcome.of("none" if c.verdict is None else c.verdict.use),
        reasons=reasons,
        section="Verdict",
        left=left_lines(c.record, c.nominal),
        right=right_lines(c.record, ("Noise (1 sigma)", noise.partition(" (")[0]), c.source.name),
        note=c.record.note,
        table=with_errors_at_board(tables.before_and_after(c), c),
        rule=[
            f"Rows: {_rows_text(c.fit.measurements)}; {_estimated_from(c)}.",
            "The verdict rests on rows that took no part in the fit, not on a tolerance: 'calib evaluate --tolerance' "
            "tests one, on rows measured afterwards.",
        ],
        parties=("Calibrated by", "Approved by"),
    )


def _estimated_from(c: Calibration) -> str:
    """Say what the estimate is from: of images how many corners each, else how often each pose was measured."""
    images = c.rows.images_of(c.rows.estimation)
    if images:
        corners = int(np.sum(c.rows.estimation))
        return f"the estimate is from {plural(corners, 'corner')} in {plural(images, 'image')}"
    _, repeats = np.unique(c.fit.geometry.estimate.problem.rows.poses, return_counts=True)
    often = times(int(repeats.min()), int(repeats.max()))
    return f"the estimate is from {plural(len(repeats), 'pose')}, each measured {often}"


def _combinations(c: Calibration) -> list[str]:
    """Word the unidentifiable combinations of parameters; beyond `MOST_LISTED` they are counted."""
    combinations = [
        combination_text(combination) for combination in c.trust.observability.unidentifiable
    ]
    listed = combinations[:MOST_LISTED]
    more = len(combinations) - len(listed)
    if more:
        listed.append(f"and {more} more")
    return listed


def _outside(c: Calibration) -> str:
    """Word the validation rows outside of the fitted joint ranges; empty where the verdict names them already."""
    if c.verdict and any(reason.why == Why.OUTSIDE for reason in c.verdict.reasons):
        return ""
    m = c.fit.measurements
    return outside_text(c.rows.outside, np.array(m.rows)[m.validation].tolist())


def _measurement_setup(c: Calibration) -> dict[str, str]:
    """Write the base's position [mm] and rpy angles [deg] in the measurement frame, held joints, coupled readings."""
    T_frame_base = c.T_frame_base
    rpy = pin.rpy.matrixToRpy(T_frame_base[:3, :3])
    held = [f"{name} at {value:.6g}" for name, value in c.fit.cell.held.items()]
    return {
        "at": ", ".join(mm(value) for value in T_frame_base[:3, 3]),
        "rpy": ", ".join(deg(angle) for angle in rpy),
        "held": ", ".join(held),
        "coupling": coupling_sentence(c.nominal).partition(": ")[2],
    }
