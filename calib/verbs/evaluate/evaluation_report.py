"""The report of an evaluation: a first page to sign, then the outcome, the figures of ISO 9283, poses and errors.

One HTML page, ``evaluation.html.j2`` filled in; see `calib.show.page`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import calib.verbs.evaluate.evaluation_tables as tables
from calib.basics.arguments import check_type
from calib.basics.files import write_atomically
from calib.result.calibration_file import versions
from calib.show.first_page import (
    FirstPage,
    Outcome,
    left_lines,
    right_lines,
    robot_name,
)
from calib.show.lines import listed, plural, times
from calib.show.page import check_ending, page_bytes
from calib.show.row_values import kinds_text
from calib.show.sizes import with_unit
from calib.show.verdict import reason_text
from calib.verbs.evaluate.acceptance import Acceptance, Assessment
from calib.verbs.evaluate.accuracy_text import accuracy_units, figures_of, missing
from calib.verbs.evaluate.evaluation import Evaluation
from calib.verbs.evaluate.text import FIGURES, outcome_reasons, places_of, robot_in_words

#: What the figure of a criterion is, behind its name.
_MEANING = {
    "max": " AP is the pose accuracy of ISO 9283: the mean error of the repeats of a pose.",
    "mean": " AP is the pose accuracy of ISO 9283: the mean error of the repeats of a pose.",
    "single": "",
}


@dataclass(frozen=True, slots=True)
class Origins:
    """Sources of an evaluation, which its report names; empty where there is none."""

    #: Name of the result's file
    result: str = ""
    #: SHA-256 of its bytes
    result_sha256: str = ""
    #: Source, in words, of targets that were not registered to the rows
    target: str = "as given"
    #: The command line that made the evaluation
    command: str = ""


def write_evaluation_report(
    e: Assessment, path: str | Path, origins: Origins | None = None, *, overwrite: bool = False
) -> Path:
    """Write the report of an evaluation as one HTML page.

    Args:
        e: The evaluation.
        path: Name of the file, which ends in .html or .htm.
        origins: Its sources; None: values in memory.
        overwrite: Replace an existing file.

    Returns:
        The file's path.

    Raises:
        FileError: The name does not end in .html or .htm, the file exists, or it cannot be written.
    """
    check_ending(path)
    page = evaluation_report_bytes(e, origins or Origins())
    return write_atomically(path, page, overwrite=overwrite)


def evaluation_report_bytes(e: Assessment, origins: Origins) -> bytes:
    """Return the page, UTF-8, see `calib.show.page.page_bytes`.

    Args:
        e: The evaluation.
        origins: Its sources.
    """
    reasons = _reasons(e, origins.result)
    rule = list(_rule(e))
    content: dict[str, Any] = {
        "e": e,
        "m": e.evaluations["urdf"].measurements,
        "document": "Evaluation report" if e.accepted is None else "Acceptance test",
        "first": _first_page(e, reasons, rule),
        "tables": tables,
        "units": accuracy_units(figures_of(e)),
        "error_units": e.evaluations["urdf"].channels.present,
        "reasons": reasons,
        "rule": rule,
        "missing": [
            f"{symbols}: needs {needed}."
            for symbols, needed in missing(e.characteristics[e.judged])
        ],
        "judged": robot_in_words(e, origins.result),
        "result": origins.result,
        "result_sha256": origins.result_sha256,
        "kinds": kinds_text(e.evaluations["urdf"].measurements),
        "places": places_of(e, origins.target),
        "versions": ", ".join(f"{name} {version}" for name, version in versions().items()),
        "command": origins.command or "not from the command line",
    }
    return page_bytes(Path(__file__).with_name("evaluation.html.j2"), content)


def _reasons(e: Assessment, result: str) -> list[str]:
    """Word what the outcome rests on, or why there is none; ``result`` is the name of the result's file."""
    if e.accepted is not None:
        return list(outcome_reasons(e, result))
    reasons = ["No tolerance was stated, so there is no outcome."]
    if e.hint is not None:
        reasons.append(reason_text(e.hint))
    return reasons


def _first_page(e: Assessment, reasons: list[str], rule: list[str]) -> FirstPage:
    """Return the first page.

    Args:
        e: The evaluation.
        reasons: What the outcome rests on.
        rule: Poses and decision rule, in sentences.
    """
    urdf = e.evaluations["urdf"]
    robot, record = urdf.robot, urdf.record
    uncertainty = ("Uncertainty (k = 2)", _uncertainty(e.accepted))
    return FirstPage(
        robot=robot_name(robot),
        outcome=Outcome.of("none" if e.accepted is None else e.accepted.outcome),
        reasons=reasons,
        section="Outcome",
        left=left_lines(record, robot),
        right=right_lines(record, uncertainty, urdf.measurements.source),
        note=record.note,
        table=tables.before_and_after(e),
        rule=rule,
        parties=("Tested by", "Accepted by"),
    )


def _uncertainty(a: Acceptance | None) -> str:
    """Word the expanded measuring uncertainty that was stated; empty without a tolerance, to be filled in by hand."""
    if a is None:
        return ""
    stated = [
        with_unit(check.uncertainty, unit)
        for unit, check in a.checks.items()
        if check.uncertainty > 0.0
    ]
    return listed(stated) or "not stated"


def _rule(e: Assessment) -> Iterator[str]:
    """Word poses and repeats, and the rule by which the outcome is decided."""
    judged = e.accuracies[e.judged]
    yield f"Evaluated: {plural(len(judged.poses), 'pose')}, each measured {times(*judged.repeats)}."
    if e.judged in ("calibration", "non_geometric"):
        yield (
            "The errors after calibration are of the model: of the robot itself only where its controller, or the "
            "programs sent to it, use the model."
        )
    a = e.accepted
    if a is None:
        return
    limits = [with_unit(check.tolerance, unit) for unit, check in a.checks.items()]
    yield f"Tolerance T: {listed(limits)}, of the {FIGURES[a.criterion]}, A.{_MEANING[a.criterion]}"
    if any(check.uncertainty > 0.0 for check in a.checks.values()):
        yield (
            "Decision rule: ISO 14253-1, with the expanded uncertainty U as guard band: pass if f A + U <= T, fail if "
            "A - U > T, else undecided; f is 1 unless a frame or target was registered. Who has to prove bears the "
            "uncertainty: for a pass the supplier, for a rejection the customer."
        )
    else:
        yield (
            "Decision rule: pass if f A <= T, fail if A > T, else undecided; f is 1 unless a frame or target was "
            "registered. No measuring uncertainty was stated (--uncertainty), so near the tolerance the outcome is a "
            "matter of chance."
        )


def write_evaluation_report_of(
    evaluation: Evaluation, accepted: Acceptance | None, path: str | Path, *, overwrite: bool
) -> Path:
    """Write the report of one evaluation; see `Evaluation.write_report`."""
    check_type("accepted", accepted, (Acceptance, type(None)), "of calib.acceptance, or None")
    return write_evaluation_report(
        Assessment.of_one(evaluation, accepted), path, overwrite=overwrite
    )
