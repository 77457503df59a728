"""Summary of a calibration in a terminal, its report to print and sign, and its excerpt in notebooks.

`report` is the one list of their sections; `calib.verbs.calibrate.tables` and `calib.verbs.calibrate.text` make what
stands in them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin

import calib.verbs.calibrate.tables as tables
import calib.verbs.calibrate.text as texts
from calib.basics.files import write_atomically
from calib.data.forms.orientations import find_convention
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Why
from calib.model.error_model import FRAME
from calib.numerics.errors import interval_factor
from calib.result.calibration import Calibration
from calib.result.calibration_file import versions
from calib.result.fitted_model import ParameterEstimate
from calib.show.as_html import notebook_html
from calib.show.as_text import blocks_text, page_text
from calib.show.blocks import (
    HTML,
    NOTEBOOK,
    TERMINAL,
    Block,
    Bullets,
    Drawing,
    Facts,
    Page,
    Paragraph,
    Section,
    Verdict,
    report_date,
)
from calib.show.budget_table import budget_sentences, budget_table
from calib.show.error_tables import ERROR_COLUMNS, ErrorColumn, ErrorRow, error_table, error_title
from calib.show.first_page import FirstPage, robot_name
from calib.show.lines import deg, mm, plural, times
from calib.show.plotting import require_matplotlib
from calib.show.report_file import check_report, report_bytes
from calib.show.robot_sentences import coupling_sentence, rows_sentence
from calib.show.tables import MOST_LISTED
from calib.show.verdict_text import reason_text
from calib.show.words import (
    before_and_after,
    chain_name,
    combination_text,
    kinds_text,
    outside_text,
    rms_text,
)
from calib.verbs.calibrate.figures import drawings
from calib.verbs.calibrate.places_text import (
    base_of,
    camera_and_board_sentences,
    chain_sentences,
    frame_sentences,
    target_sentences,
)
from calib.verbs.calibrate.seen_corners import image_rows
from calib.verbs.calibrate.uncertainty import LEVEL, Bootstrap, Profile
from calib.version import __version__

#: Targets, frames, or combinations of parameters that are listed; the others are counted.
_MOST_PLACES = {TERMINAL: 6, HTML: MOST_LISTED}
_MOST_COMBINATIONS = {TERMINAL: 12, HTML: MOST_LISTED}


def summary(c: Calibration) -> str:
    """Write the summary of a calibration: lines of at most 100 columns."""
    return page_text(report(c))


def calibration_html(c: Calibration) -> str:
    """Draw the excerpt of a calibration for a notebook, as an element of HTML."""
    return notebook_html(report(c))


def write_report(
    calibration: Calibration,
    path: str | Path,
    *,
    command: str = "",
    overwrite: bool = False,
) -> Path:
    """Write the report of a calibration as one HTML page, or as PDF.

    Args:
        calibration: The result.
        path: Name of the file, which ends in .html, .htm or .pdf.
        command: The command line that made the calibration; empty if there was none.
        overwrite: Replace an existing file.

    Returns:
        The file's path.

    Raises:
        CalibError: Matplotlib is missing, which draws the figures; or no browser is installed for a PDF.
        FileError: The name does not end in .html, .htm or .pdf, the file exists, or it cannot be written.
    """
    check_report(path)
    require_matplotlib("A report")
    page = report_bytes(report(calibration, command=command), path)
    return write_atomically(path, page, overwrite=overwrite)


def report(
    c: Calibration, *, command: str = "", columns: Sequence[ErrorColumn] = ERROR_COLUMNS
) -> Page:
    """List the sections that show a calibration, each with its media: terminal and HTML unless it says otherwise.

    Args:
        c: The result. Sections for HTML need its measurements and its solved problem in memory.
        command: The command line that made it; empty if there was none.
        columns: The columns of the tables of errors: largest, mean, rms and spans unless given.
    """
    date = report_date()
    figures = partial(_figures, c)
    sections = (
        Section(lambda: [_first_page(c, columns)], on=HTML),
        Section(partial(_head, c), on=TERMINAL),
        Section(partial(_excerpt, c, columns), on=NOTEBOOK),
        Section(lambda: [_verdict(c)], "Verdict"),
        Section(partial(_accuracy, c, columns), "Accuracy before and after"),
        Section(partial(_validation, c), on=HTML),
        Section(partial(figures, "errors"), "Figures of the errors", on=HTML),
        Section(partial(_rows_and_places, c), on=TERMINAL),
        Section(lambda: [tables.models(c), *_evidence_note(c)], on=TERMINAL),
        Section(partial(_facts, c), on=TERMINAL),
        Section(partial(_uncertainty, c), "Uncertainty"),
        Section(partial(figures, "uncertainty"), on=HTML),
        Section(partial(_parameters_in_words, c), "Parameters", on=HTML),
        Section(partial(_parameters, c)),
        Section(partial(figures, "parameters"), on=HTML),
        Section(lambda: [tables.dh(c), tables.origins(c)], "Geometry before and after", on=HTML),
        Section(partial(_outliers, c), "Outliers", on=HTML),
        Section(partial(_identifiability, c), "Identifiability", on=HTML),
        Section(partial(figures, "unknown"), on=HTML),
        Section(partial(figures, "candidates"), "Models tried", on=HTML),
        Section(partial(_measurements, c), "Measurements", on=HTML),
        Section(partial(_method, c), "Method"),
        Section(partial(figures, "method"), on=HTML),
        Section(
            lambda: [_files(c, command, date)], "Files, versions, command", on=HTML, whole=True
        ),
    )
    return Page("Calibration report", f"robot {robot_name(c.nominal)}", sections, date)


def _first_page(c: Calibration, columns: Sequence[ErrorColumn]) -> Block:
    """Make the first page of the report: verdict, record, robot, noise, errors before, after, room for signatures."""
    images = c.rows.count_images(c.rows.estimation)
    if images:
        corners = plural(int(np.sum(c.rows.estimation)), "corner")
        basis = f"{corners} in {plural(images, 'image')}"
    else:
        poses = c.fit.geometry.estimate.problem.rows.poses
        _, repeats = np.unique(poses, return_counts=True)
        often = times(int(repeats.min()), int(repeats.max()))
        basis = f"{plural(len(repeats), 'pose')}, each measured {often}"
    return FirstPage(
        verdict=_verdict(c),
        section="Verdict",
        record=c.record,
        robot=c.nominal,
        uncertainty=("Noise (1 sigma)", texts.facts(c)["Noise"].partition(" (")[0]),
        source=c.source.name,
        table=tables.before_and_after(c, columns),
        rule=[
            f"Rows: {_rows_text(c.fit.measurements)}; the estimate is from {basis}.",
            "The verdict rests on rows that took no part in the fit, not on a tolerance: 'calib evaluate --tolerance' "
            "tests one, on rows measured afterwards.",
        ],
        parties=("Calibrated by", "Approved by"),
    )


def _rows_text(m: Measurements) -> str:
    """Word the numbers of rows to estimate and to validate, and the convention of orientations, if any were given."""
    text = f"{m.estimation.sum():,} to estimate, {m.validation.sum():,} to validate"
    if m.orientation:
        text += f"; orientations as {find_convention(m.orientation).words}"
    return text


def _head(c: Calibration) -> Iterator[Block]:
    """Name the robot, count the measured rows, and name the DH rows that it was made from and coupled readings."""
    rows = rows_sentence(c.nominal)
    yield Paragraph(
        f"calib {__version__}: robot {chain_name(c.nominal)}, {len(c.nominal.all_joints)} joints; "
        f"{texts.counted_rows(c)} from {c.source.name or 'memory'}"
    )
    yield Paragraph(f"{rows}." if rows else "", tight=True)
    yield Paragraph(coupling_sentence(c.nominal), tight=True)


def _excerpt(c: Calibration, columns: Sequence[ErrorColumn]) -> Iterator[Block]:
    """Show the verdict with its first reason, errors before and after, the model, and the numbers of rows and outliers.

    If there is a non-geometric model, its rms error on held-out rows without outliers, too.
    """
    verdict = _verdict(c)
    yield Paragraph(f"Calibration of {chain_name(c.nominal)}")
    yield replace(verdict, reasons=verdict.reasons[:1])
    yield tables.before_and_after(c, columns)
    facts = [("model", c.model.name)]
    other = c.non_geometric
    if other is not None and other.cross_validation is not None:
        where, _, _ = before_and_after(c)
        errors = other.cross_validation.errors_without_outliers
        facts.append((f"rms error, model '{other.name}' ({where} rows)", rms_text(errors)))
    facts.append(("rows", f"{len(c.rows)}, {len(c.rows.outliers)} of them outliers"))
    yield Facts(facts)


def _verdict(c: Calibration) -> Verdict:
    """Word the verdict on the corrected robot and its reasons; ``"none"`` if nothing was cross-validated."""
    if c.verdict is None:
        return Verdict("none", ["Nothing was cross-validated, so there is no verdict."])
    return Verdict(c.verdict.use, [reason_text(reason) for reason in c.verdict.reasons])


def _accuracy(c: Calibration, columns: Sequence[ErrorColumn]) -> Iterator[Block]:
    """Tabulate the errors of sets of rows in each unit that was measured, and of images at the board.

    If all errors in pixels are of images, HTML has them in one table with those at the board, a terminal in two.
    """
    text = (
        "An error is the residual, measured minus predicted; its size is the norm. Nominal: the robot as given, with "
        "the measurement frame and the target as given, or registered on the nominal robot if they were not. "
        "Calibrated: the robot of the corrected URDF."
    )
    if c.non_geometric is not None:
        text += f" Non-geometric: the same with the model '{c.non_geometric.name}'."
    if "pair" in c.rows.kinds:
        text += " The two rows of a pair give one length."
    yield Paragraph(text, on=HTML)

    held_out = texts.held_out_text(c)
    rows = tables.error_rows(c)
    images = tables.image_errors(c, columns)
    for unit in c.rows.channels.present:
        # A page has errors in pixels beside those at the board, if all of them are of images.
        in_pixels = np.any(c.rows.channels.where("px"), axis=1)
        in_images = unit == "px" and bool(images.rows) and bool(np.all(image_rows(c)[in_pixels]))
        yield error_table(
            error_title(unit, c.rows.channels),
            unit,
            rows,
            columns,
            names="rows, robot",
            note=f"{held_out}." if held_out else "",
            on=TERMINAL if in_images else TERMINAL | HTML,
        )
    at_board = [ErrorRow(label, errors) for label, errors in tables.errors_at_board(c).items()]
    yield error_table("Error at the board", "m", at_board, columns, on=TERMINAL)
    yield Paragraph(held_out, on=TERMINAL, tight=True)
    yield images
    yield tables.chains(c)
    yield Bullets(chain_sentences(c), tight=True)


def _validation(c: Calibration) -> Iterator[Block]:
    """Tabulate the validation rows one by one, or word which errors show the accuracy without any."""
    if c.rows.validation.any():
        yield tables.validation_rows(c)
    elif c.cross_validation is not None:
        yield Paragraph(
            "No rows were kept for validation: the errors of the held-out rows show the accuracy at other poses."
        )
    else:
        yield Paragraph(
            "No rows were kept for validation, and there was no cross-validation: these errors show how well the model "
            "fits its rows, not the accuracy at other poses."
        )


def _figures(c: Calibration, section: str) -> list[Drawing]:
    """Return the figures that stand in a section of the report, such as ``"errors"``; none is drawn yet."""
    return [drawing for drawing in drawings(c) if drawing.section == section]


def _rows_and_places(c: Calibration) -> Iterator[Block]:
    """List outliers, targets, frames, cameras and boards in sentences."""
    if c.rows.outliers:
        outliers = texts.outliers_text(c, c.rows.outliers)
        yield Paragraph(f"Outliers ({texts.weights_text(c)}): {outliers}")
        if c.trust.robustness is not None:
            effect = texts.robustness_text(c.trust.robustness)
            yield Bullets([effect], indent="  ", tight=True)
    else:
        yield Paragraph("Outliers: none.")
    if c.rows.suspects:
        suspects = texts.outliers_text(c, c.rows.suspects)
        yield Paragraph(f"Outliers among the validation rows: {suspects}", tight=True)
    yield Bullets(target_sentences(c), most=_MOST_PLACES)
    yield Bullets(frame_sentences(c), most=_MOST_PLACES)
    yield tables.transforms(c)
    yield Bullets(camera_and_board_sentences(c))


def _evidence_note(c: Calibration) -> Iterator[Block]:
    """Explain the column "evidence" of the table of models; nothing if no models were tried."""
    if c.method.candidates:
        note = "evidence: penalised restricted log-likelihood, relative to the best model"
        yield Bullets([note], indent="  ", tight=True)


def _facts(c: Calibration) -> Iterator[Block]:
    """List noise, expected error and rank, and the unidentifiable combinations."""
    yield Facts(list(texts.facts(c).items()))
    combinations = [combination_text(one) for one in c.trust.observability.unidentifiable]
    lead = f"{texts.unidentifiable_text(c)}:"
    yield Bullets(combinations, lead, "  ", _MOST_COMBINATIONS, tight=True)


def _uncertainty(c: Calibration) -> Iterator[Block]:
    """Tabulate the uncertainty budget of the corrected URDF, and word what it means; nothing if it is not known."""
    if c.unknown_accuracy:
        return
    budget = c.budget(non_geometric=False)
    angles = "rad" in c.rows.channels.present
    yield budget_table(budget, angles=angles)
    yield Bullets(list(budget_sentences(budget, angles=angles)), tight=True)


def _parameters_in_words(c: Calibration) -> Iterator[Block]:
    """Explain the tables of the parameters: number, rows that they are from, intervals, and the last column."""
    text = (
        f"{len(c.parameters)} parameters of the model '{c.model.name}' were estimated from "
        f"{c.rows.estimation.sum():,} estimation rows"
    )
    unweighted = int(np.sum(c.rows.weights[c.rows.estimation] <= 0.0))
    if unweighted:
        text += f", {unweighted:,} of which have no weight"
    factor = interval_factor(c.fit.geometry.estimate.freedom)
    text += (
        f". Correction: calibrated minus nominal. 95 % ±: half the 95 % interval, {factor:.2f} standard deviations "
        f"(Student's t, {c.noise.freedom:.0f} degrees of freedom). Determined: 'yes' by the measurements alone; "
        "'jointly' in combinations only, so that the single value depends on its prior; 'at bound' stopped by a bound"
    )
    if texts.errorless(c):
        text += "; 'kept' nominal, because its family has no errors"
    yield Paragraph(f"{text}.")


def _parameters(c: Calibration) -> Iterator[Block]:
    """Tabulate the parameters, and word the places of targets and frames."""
    yield tables.parameters(c)
    kept = texts.errorless(c)
    notes = []
    if kept:
        notes.append("# no errors of this kind were found: kept at its nominal value")
    if not all(p.identifiable or p.name in kept for p in texts.shown_parameters(c)):
        notes.append("* known in combination with others only; see above")
    yield Bullets(notes, on=TERMINAL, tight=True)

    yield tables.parameters_in(c, "mm")
    yield tables.parameters_in(c, "deg")
    places = [*target_sentences(c), *frame_sentences(c), *camera_and_board_sentences(c)]
    yield Bullets(places, on=HTML)
    yield replace(tables.transforms(c), on=HTML)
    yield tables.non_geometric(c)


def _outliers(c: Calibration) -> Iterator[Block]:
    """Count and tabulate the rows that were flagged."""

    def flagged(count: int, kind: str) -> str:
        return f"{count:,} {kind} row{'s are' if count > 1 else ' is'} flagged"

    if c.rows.outliers:
        text = f"{flagged(len(c.rows.outliers), 'estimation')} ({texts.weights_text(c)})."
        if c.trust.robustness:
            text += f" {texts.robustness_text(c.trust.robustness)}"
        yield Paragraph(text)
    if c.rows.suspects:
        yield Paragraph(
            f"{flagged(len(c.rows.suspects), 'validation')}: the calibrated robot does not explain them. Validation "
            "rows never have a weight in the fit, and the errors above include these."
        )
    if c.rows.outliers or c.rows.suspects:
        yield tables.flagged(c)
    else:
        yield Paragraph(
            f"None of the {len(c.rows):,} rows has a score (distance from what the other rows predict, in standard "
            f"deviations) beyond its limit ({c.rows.flag_limit:.1f} for estimation rows)."
        )


def _identifiability(c: Calibration) -> Iterator[Block]:
    """Word the rank, the combinations of parameters that the measurements leave open, and the priors."""
    facts = texts.facts(c)
    yield Paragraph(f"Rank: {facts['Rank']}")
    combinations = [combination_text(one) for one in c.trust.observability.unidentifiable]
    if combinations:
        yield Paragraph(
            f"{texts.unidentifiable_text(c)}. They cost no accuracy at the measured poses, but the single values of "
            "these parameters mean little."
        )
        yield Bullets(combinations, most=_MOST_COMBINATIONS)
    if texts.PRIOR_STD in facts:
        yield Paragraph(f"{texts.PRIOR_STD}: {facts[texts.PRIOR_STD]}")


def _measurements(c: Calibration) -> Iterator[Block]:
    """List what was measured, where, with which noise, the joints' ranges, and validation rows outside of them."""
    m, facts = c.fit.measurements, texts.facts(c)
    unused = f"; {len(m.unmeasured):,} more without a measurement" if m.unmeasured else ""
    at = ", ".join(mm(value) for value in c.T_frame_base[:3, 3])
    rpy = ", ".join(deg(angle) for angle in pin.rpy.matrixToRpy(c.T_frame_base[:3, :3]))
    held = [f"{name} at {value:.6g}" for name, value in c.fit.cell.held.items()]
    yield Facts(
        [
            ("Rows", f"{len(m):,}: {_rows_text(m)} (column 'set'){unused}"),
            ("Each row measures", kinds_text(m)),
            ("Measurement frame", f"{base_of(c, 0)} at ({at}) mm, rpy ({rpy}) deg in it"),
            ("Joints held [rad or m]", ", ".join(held)),
            ("Coupled readings", coupling_sentence(c.nominal).partition(": ")[2]),
            ("Noise of the rows", facts["Noise"]),
            (texts.POSE_NOISE, facts.get(texts.POSE_NOISE, "")),
            (texts.SCATTER, facts.get(texts.SCATTER, "")),
            (
                texts.EXPECTED,
                f"{facts[texts.EXPECTED].removesuffix('.')}; one standard deviation of the target's position, from the "
                "covariance of the parameters.",
            ),
        ]
    )
    yield tables.ranges(c)
    yield from _figures(c, "measurements")
    # The verdict may name them already.
    if c.verdict is None or all(reason.why != Why.OUTSIDE for reason in c.verdict.reasons):
        outside = outside_text(c.rows.outside, np.array(m.rows)[m.validation].tolist())
        if outside:
            yield Paragraph(
                f"Validation rows outside of the fitted joint ranges (extrapolation): {outside}."
            )


def _method(c: Calibration) -> Iterator[Block]:
    """Word how the problem was solved; for HTML, with the fit in memory, also how it was validated, and the priors."""
    solver, message = texts.solver_text(c), c.method.solution.message
    seconds = c.method.seconds
    time = "" if math.isnan(seconds) else f", {1e3 * seconds:.0f} ms"
    yield Paragraph(f"{solver}{time}. {message}", on=TERMINAL)
    if c.fit_in_memory is None:
        return
    validation = "No cross-validation, so there is no verdict."
    if c.cross_validation is not None:
        method, folds = c.cross_validation.method, c.cross_validation.folds
        validation = f"Errors of held-out rows: {method}, {folds} fits."
    weight = "have no" if c.fit.geometry.task.robust else "keep their"
    priors = {
        "data": "Prior standard deviations of the robot's errors: estimated from the data.",
        "given": "Prior standard deviations of the robot's errors: given.",
        "off": "No priors on the robot's errors.",
    }
    sentences = [
        f"{solver}. {message}",
        f"Outliers {weight} weight in the fit.",
        validation,
        priors[c.fit.cell.priors.source],
    ]
    yield Bullets(sentences, on=HTML)


def _files(c: Calibration, command: str, date: str) -> Block:
    """List the files with their hashes, the versions, the command ("": none) and the report's date, given in words."""
    m = c.fit.measurements
    return Facts(
        [
            ("Run", c.run),
            ("Nominal robot", c.nominal.urdf.source or "from memory"),
            ("  SHA-256", c.nominal.urdf.sha256),
            ("Measurements", m.source or "from memory"),
            ("  SHA-256", m.sha256.replace(" + ", ", ") or "-"),
            ("Corrected robot", "as written without a target link"),
            ("  SHA-256", c.robot.urdf.sha256),
            ("Software", ", ".join(f"{name} {version}" for name, version in versions().items())),
            ("Command", command or "not from the command line"),
            ("Date of the report", date),
        ]
    )


# Intervals that are computed on demand, below the summary


def bootstrap_text(c: Calibration, bootstrap: Bootstrap) -> str:
    """Write the bootstrap's intervals beside those of the covariance, and the spread of predicted positions.

    Those of frames are not shown: their parameters count from where registration put the frame.

    Args:
        c: The result.
        bootstrap: Its bootstrap.
    """
    rows = []
    ends = bootstrap.intervals(LEVEL).tolist()
    parameters = zip(bootstrap.parameters, ends, c.model.parameters, strict=True)
    for estimate, (low, high), parameter in parameters:
        if parameter.family != FRAME:
            rows.append((estimate, low, high))
    blocks: Iterable[Block] = (
        Paragraph(f"Bootstrap: {len(bootstrap.x)} samples of whole poses, seed {bootstrap.seed}"),
        tables.intervals("bootstrap", rows),
        Paragraph(
            f"Predicted positions spread by {mm(bootstrap.measured_rms)} mm rms at the measured poses and "
            f"{mm(bootstrap.everywhere_rms)} mm over the joint limits; by the covariance "
            f"{mm(c.geometry.expected_measured)} mm and {mm(c.geometry.expected_everywhere)} mm.",
            tight=True,
        ),
        Paragraph(
            f"The solver did not converge on {bootstrap.stopped} of the samples."
            if bootstrap.stopped
            else "",
            tight=True,
        ),
    )
    return blocks_text(blocks)


def profile_text(profiles: Sequence[tuple[ParameterEstimate, Profile]]) -> str:
    """Write the 95 % intervals of parameters by the profile of the cost beside those by the covariance, as text."""
    rows = [(estimate, profile.low, profile.high) for estimate, profile in profiles]
    return blocks_text([Paragraph("Profile of the cost"), tables.intervals("profile", rows)])
