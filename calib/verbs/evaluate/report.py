"""An evaluation as text in a terminal, as a report to print and sign, and as an excerpt in notebooks.

`report` is the one list of their sections; `calib.verbs.evaluate.tables` and `calib.verbs.evaluate.text` make what
stands in them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from calib.basics.arguments import check_type
from calib.basics.files import write_atomically
from calib.result.calibration_file import versions
from calib.show.as_html import notebook_html
from calib.show.as_text import page_text
from calib.show.blocks import (
    EVERYWHERE,
    HTML,
    NOTEBOOK,
    TERMINAL,
    Block,
    Bullets,
    Facts,
    Page,
    Paragraph,
    Section,
    Verdict,
    report_date,
)
from calib.show.error_tables import ERROR_COLUMNS, ErrorColumn
from calib.show.first_page import FirstPage, robot_name
from calib.show.lines import listed, mm
from calib.show.report_file import check_report, report_bytes
from calib.show.verdict_text import reason_text
from calib.show.words import chain_name, kinds_text, with_unit
from calib.verbs.evaluate import tables
from calib.verbs.evaluate.acceptance import Acceptance, Assessment
from calib.verbs.evaluate.evaluation import Evaluation
from calib.verbs.evaluate.text import (
    NAMES,
    named_robot,
    outcome_reasons,
    place_sentences,
    rule_sentences,
    uncertainty_sentences,
)


@dataclass(frozen=True, slots=True)
class Origins:
    """Sources of an evaluation, which are named with it; empty if there is none."""

    #: Name of the result's file
    result: str = ""
    #: SHA-256 of its bytes
    result_sha256: str = ""
    #: Id of its run
    run: str = ""
    #: A sentence that the robot's URDF is of another run
    other_run: str = ""
    #: Source, in words, of targets that were not registered to the rows
    target: str = "as given"
    #: The command line that made the evaluation
    command: str = ""


#: Values in memory.
_NO_FILES = Origins()


def summary(e: Assessment, origins: Origins = _NO_FILES) -> str:
    """Write an evaluation: the outcome first, then places of targets, errors and accuracy of each robot."""
    return page_text(report(e, origins))


def evaluation_text(e: Evaluation) -> str:
    """Write the evaluation of one robot; see `Evaluation.summary`."""
    return summary(Assessment.of_one(e))


def evaluation_html(e: Evaluation) -> str:
    """Draw the excerpt of the evaluation of one robot for a notebook, as an element of HTML."""
    return notebook_html(report(Assessment.of_one(e)))


def write_evaluation_report(
    evaluation: Evaluation, accepted: Acceptance | None, path: str | Path, *, overwrite: bool
) -> Path:
    """Write the report of one evaluation, with the outcome of its acceptance unless None, as one HTML page.

    ArgumentError if ``accepted`` is of another type; FileError as of `write_report`. Return the file's path.
    """
    check_type("accepted", accepted, (Acceptance, type(None)), "of calib.acceptance, or None")
    return write_report(Assessment.of_one(evaluation, accepted), path, overwrite=overwrite)


def write_report(
    e: Assessment, path: str | Path, origins: Origins = _NO_FILES, *, overwrite: bool = False
) -> Path:
    """Write the report of an evaluation as one HTML page, or as PDF.

    Args:
        e: The evaluation.
        path: Name of the file, which ends in .html, .htm or .pdf.
        origins: Its sources.
        overwrite: Replace an existing file.

    Returns:
        The file's path.

    Raises:
        CalibError: No browser is installed for a PDF.
        FileError: The name does not end in .html, .htm or .pdf, the file exists, or it cannot be written.
    """
    check_report(path)
    return write_atomically(path, report_bytes(report(e, origins), path), overwrite=overwrite)


def report(
    e: Assessment, origins: Origins = _NO_FILES, columns: Sequence[ErrorColumn] = ERROR_COLUMNS
) -> Page:
    """List the sections that show an evaluation, each with its media: terminal and HTML unless it says otherwise.

    Args:
        e: The evaluation.
        origins: Its sources.
        columns: The columns of the tables of errors: largest, mean, rms and spans unless given.
    """
    date = report_date()
    robot = e.evaluations["urdf"].robot
    errors = partial(tables.errors, e, origins.result, columns)
    rule = Bullets(list(rule_sentences(e)), on=HTML)
    places = Bullets([*place_sentences(e, origins.target), *filter(None, [origins.other_run])])
    hint = reason_text(e.hint) if e.hint is not None and e.accepted is None else ""
    sections = (
        Section(lambda: [_first_page(e, origins.result)], on=HTML),
        Section(lambda: [Paragraph(f"Evaluation of {chain_name(robot)}")], on=NOTEBOOK),
        Section(lambda: [_verdict(e, origins.result), tables.checks(e), rule], "Outcome"),
        Section(lambda: [places], on=TERMINAL),
        Section(errors, on=TERMINAL | NOTEBOOK),
        Section(partial(_images, e), on=TERMINAL),
        Section(partial(_accuracy, e), "Accuracy and repeatability"),
        Section(
            lambda: [
                tables.poses(e, named_robot(e.judged, origins.result)),
                Bullets(list(uncertainty_sentences(e.accuracies[e.judged])), tight=True),
            ],
            "Poses",
        ),
        Section(lambda: [Paragraph(hint)], on=TERMINAL),
        Section(errors, "Errors of all rows", on=HTML),
        Section(lambda: [_measurements(e), places], "Measurements", on=HTML),
        Section(partial(_registered, e), on=NOTEBOOK),
        Section(
            lambda: [_files(e, origins, date)], "Files, versions, command", on=HTML, whole=True
        ),
    )
    document = "Evaluation report" if e.accepted is None else "Acceptance test"
    return Page(document, f"robot {robot_name(robot)}", sections, date)


def _first_page(e: Assessment, result_name: str) -> Block:
    """Make the first page of the report: outcome, record, robot, uncertainty, accuracy before and after, signatures.

    The outcome names the file of the calibration's result, ``result_name``.
    """
    urdf = e.evaluations["urdf"]
    # Without a tolerance it is filled in by hand.
    uncertainty = ""
    if e.accepted is not None:
        stated = [
            with_unit(check.uncertainty, unit)
            for unit, check in e.accepted.checks.items()
            if check.uncertainty > 0.0
        ]
        uncertainty = listed(stated) or "not stated"
    return FirstPage(
        verdict=_verdict(e, result_name),
        section="Outcome",
        record=urdf.record,
        robot=urdf.robot,
        uncertainty=("Uncertainty (k = 2)", uncertainty),
        source=urdf.measurements.source,
        table=tables.before_and_after(e),
        rule=list(rule_sentences(e)),
        parties=("Tested by", "Accepted by"),
    )


def _verdict(e: Assessment, result_name: str) -> Verdict:
    """Word the outcome and what it rests on, or, for HTML only, that no tolerance was stated; see `outcome_reasons`."""
    if e.accepted is not None:
        return Verdict(e.accepted.outcome, list(outcome_reasons(e, result_name)))
    reasons = ["No tolerance was stated, so there is no outcome."]
    if e.hint is not None:
        reasons.append(reason_text(e.hint))
    return Verdict("none", reasons, on=HTML)


def _images(e: Assessment) -> Iterator[Block]:
    """Tabulate the errors of images, in px and in mm at the board, and count images and corners; none without any.

    The count is of the robot of the URDF; all robots are compared with the same images.
    """
    yield tables.image_errors(e)
    # All robots are compared with the same images.
    counted = e.evaluations["urdf"].images
    if counted is not None:
        yield Paragraph(
            f"{counted.corners:,} corners in {counted.images} images; bias is the mean of measured minus predicted, mm "
            "are at the board.",
            tight=True,
        )
        yield tables.board_errors(e)
        yield Paragraph(
            "The pose of the board that each image alone shows against the predicted one. Alone: what the noise of its "
            "corners makes of it. Predicted: what remains, the error of the prediction. Depth is along the line of "
            "sight, bias its mean and standard deviation.",
            tight=True,
        )
        shown = e.evaluations[e.judged].images
        if e.expected is not None and shown is not None and shown.board is not None:
            yield Paragraph(
                f"The calibration expects {mm(e.expected)} mm rms in three dimensions near its poses; these images "
                f"show {mm(shown.board.predicted)} mm. Those of another day show more if lens, mount or print changed.",
                tight=True,
            )


def _accuracy(e: Assessment) -> Iterator[Block]:
    """Tabulate accuracy and repeatability; a terminal has them if a tolerance was stated, or poses were repeated."""
    repeated = any(accuracy.repeats[1] > 1 for accuracy in e.accuracies.values())
    on = EVERYWHERE if e.accepted is not None or repeated else HTML
    found = e.characteristics[e.judged]
    yield Paragraph(
        "By ISO 9283, over the poses that are evaluated. An error is the residual, measured minus predicted. AP, pose "
        "accuracy: the size of the mean error of a pose's repeats. RP, pose repeatability: mean distance of the "
        "repeats from their mean, plus three standard deviations; it needs three repeats. Single: the largest error of "
        "one measured row. Nominal: the robot before the calibration.",
        on=HTML,
    )
    yield from tables.accuracies(e.accuracies, e.judged, on)
    yield tables.characteristics(found, NAMES[e.judged], on)
    yield Bullets(tables.missing(found), "Not in these data:", "  ", on=on, tight=True)


def _measurements(e: Assessment) -> Block:
    """Count the rows, and name what they measure."""
    m = e.evaluations["urdf"].measurements
    unused = ""
    if m.unmeasured:
        unused = f" ({len(m.unmeasured):,} more without a measurement)"
    return Facts([("Rows", f"{len(m):,}{unused}"), ("Each row measures", kinds_text(m))])


def _registered(e: Assessment) -> Iterator[Block]:
    """Count the rows of the evaluation, and name what was registered to them: target, frame; empty if nothing was."""
    evaluation = e.evaluations["urdf"]
    registered = " and ".join(evaluation.registered)
    yield Facts(
        [("rows", str(len(evaluation.measurements))), ("registered to the rows", registered)]
    )


def _files(e: Assessment, origins: Origins, date: str) -> Block:
    """List the files with their hashes, the versions and the command."""
    urdf = e.evaluations["urdf"]
    m = urdf.measurements
    return Facts(
        [
            ("Robot", urdf.robot.urdf.source or "from memory"),
            ("  SHA-256", urdf.robot.urdf.sha256),
            ("Calibration", origins.result),
            ("  SHA-256", origins.result_sha256),
            ("  Run", origins.run),
            ("Measurements", m.source or "from memory"),
            ("  SHA-256", m.sha256.replace(" + ", ", ") or "-"),
            ("Software", ", ".join(f"{name} {version}" for name, version in versions().items())),
            ("Command", origins.command or "not from the command line"),
            ("Date of the report", date),
        ]
    )
