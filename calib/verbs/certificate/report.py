"""A certificate as text in a terminal and as a page to print and sign: `page` is the one list of its sections."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from calib.basics.files import write_atomically
from calib.diagnosis.reasons import NO
from calib.result.calibration_file import versions
from calib.show.as_text import page_text
from calib.show.blocks import (
    HTML,
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
from calib.show.budget_table import budget_table
from calib.show.first_page import FirstPage, Line, robot_name
from calib.show.lines import listed
from calib.show.report_file import check_report, report_bytes
from calib.show.verdict_text import reason_text
from calib.show.words import chain_name, with_unit
from calib.verbs.certificate import tables
from calib.verbs.certificate.certificate import Certificate
from calib.verbs.certificate.text import gap_text, method_sentences, rule_sentences, temperatures

#: Kind of the document.
_DOCUMENT = "Calibration certificate"


def summary(c: Certificate) -> str:
    """Write a certificate: conformity first, then deviations, budget, and what was not tested."""
    return page_text(page(c))


def write_report(c: Certificate, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write a certificate as one HTML page, or as PDF; see `Certificate.write_report`."""
    check_report(path)
    return write_atomically(path, report_bytes(page(c), path), overwrite=overwrite)


def page(c: Certificate) -> Page:
    """List the sections of a certificate, each with its media: terminal and HTML unless it says otherwise."""
    date = report_date()
    sections = (
        Section(lambda: [_first_page(c)], on=HTML),
        Section(lambda: [_verdict(c)], on=TERMINAL),
        Section(lambda: [Facts(_item(c))], "Item", on=HTML),
        Section(lambda: [Facts(_instrument(c))], "Instrument and conditions", on=HTML),
        Section(lambda: [Bullets(list(method_sentences(c)), on=HTML)], "Method", on=HTML),
        Section(partial(tables.point_tables, c), "Results"),
        Section(
            lambda: [budget_table(c.budget, angles="rad" in c.units)],
            "Uncertainty budget",
            whole=True,
        ),
        Section(partial(_rule, c), "Decision rule"),
        Section(partial(_validity, c), "Validity", whole=True),
        Section(
            lambda: [
                Bullets([gap_text(gap) for gap in c.gaps], "Not tested, or not stated:", "  ")
            ],
            "What was not tested",
        ),
        Section(lambda: [Bullets(_remarks(c), "Remarks:", "  ")], "Remarks"),
        Section(lambda: [Facts(_files(c, date))], "Files, versions, command", on=HTML, whole=True),
    )
    # Its number stands on every sheet (ISO/IEC 17025, 7.8.2.1).
    document = " ".join(filter(None, (_DOCUMENT, c.record.certificate_number)))
    return Page(document, f"robot {robot_name(c.calibration.nominal)}", sections, date)


def _verdict(c: Certificate) -> Verdict:
    """Word the conformity, with what it rests on."""
    reasons = list(rule_sentences(c))
    if c.decisions:
        reasons = reasons[1:]  # the rule itself has a section
    if not c.is_fresh:
        reasons.append("The points are the validation rows of the calibration's own table.")
    of_calibration = c.calibration.verdict_on(non_geometric=c.assessment.judged == "non_geometric")
    if of_calibration is not None and of_calibration.use == NO:
        reasons.append("The verdict on the calibration itself is 'do not use': see Remarks.")
    return Verdict(c.outcome or "none", reasons)


def _first_page(c: Certificate) -> Block:
    """Make the first page: conformity, who, where and with what, deviations, decision rule, signatures."""
    return FirstPage(
        verdict=_verdict(c),
        section="Decision rule",
        record=c.record,
        robot=c.calibration.nominal,
        uncertainty=("", ""),
        source="",
        table=tables.summary_table(c),
        rule=list(rule_sentences(c))[:1],
        parties=("Measured by", "Authorised by"),
        form=(_left(c), _right(c)),
    )


def _left(c: Certificate) -> list[Line]:
    """Return the lines of the form's left half: parties, item and how it was moved."""
    record = c.record
    return [
        ("Certificate no.", record.certificate_number),
        ("Laboratory", ", ".join(filter(None, (record.laboratory, record.country)))),
        ("Customer", record.customer),
        ("Order", record.order),
        ("Robot", record.robot),
        ("Robot, serial no.", record.robot_serial),
        ("Controller, serial no.", record.controller_serial),
        ("Load", record.load),
        ("Speed", record.speed),
        ("Warm-up", record.warm_up),
        ("Order of the poses", record.sequence),
        ("Measured by", record.operator),
        ("Responsible", record.responsible),
    ]


def _right(c: Certificate) -> list[Line]:
    """Return the lines of the form's right half: instrument, place, conditions."""
    record = c.record
    stated = [with_unit(value, unit) for unit, value in c.stated.items()]
    computed = "by point, section Results"
    return [
        ("Instrument", record.instrument),
        ("Instrument, serial no.", record.instrument_serial),
        ("Its certificate", record.instrument_certificate),
        ("Calibrated on", record.instrument_calibrated),
        ("Calibrated until", record.calibration_due),
        ("Traceable to", record.traceability),
        ("Uncertainty (k = 2)", listed(stated) or computed),
        ("Uncertainty from", record.uncertainty_from),
        ("Place", record.place),
        ("Measured on", record.date),
        ("Air temperature", temperatures(record.temperature_C)),
        ("Humidity", _humidity(c)),
        ("Valid until", record.valid_until),
    ]


def _humidity(c: Certificate) -> str:
    """Write the humidity, one value or two; empty for none."""
    return " to ".join(f"{value:g} %" for value in dict.fromkeys(c.record.humidity_percent))


def _item(c: Certificate) -> list[tuple[str, str]]:
    """Return what is certified: robot, chain, URDFs with their hashes, model."""
    result, record = c.calibration, c.record
    model = result.part(non_geometric=c.assessment.judged == "non_geometric").model.name
    return [
        ("Robot", record.robot),
        ("Serial number", record.robot_serial),
        ("Controller", record.controller_serial),
        ("Chain", chain_name(result.nominal)),
        ("URDF as found", result.nominal.urdf.source or "from memory"),
        ("  SHA-256", result.nominal.urdf.sha256),
        ("URDF as left", f"corrected by run {result.run}"),
        ("  SHA-256", result.robot.urdf.sha256),
        ("Model", model),
    ]


def _instrument(c: Certificate) -> list[tuple[str, str]]:
    """Return the instrument, its traceability, and the conditions; lines without an entry are left out."""
    return [line for line in (*_right(c), *_left(c)[7:11]) if line[1]]


def _rule(c: Certificate) -> Iterator[Block]:
    """Word the decision rule and its risks."""
    yield Bullets(list(rule_sentences(c)), on=HTML)


def _validity(c: Certificate) -> Iterator[Block]:
    """Say where and until when the certificate is valid."""
    record = c.record
    yield tables.box_table(c)
    conditions = [
        ("Load", record.load or "as at the calibration, not stated"),
        ("Temperature", temperatures(record.temperature_C) or "as at the calibration, not stated"),
        ("Until", record.valid_until or "not agreed with the customer"),
    ]
    yield Facts(conditions)
    yield Paragraph(
        "The results are those of this robot at the time of the measurement. Parts that are exchanged or zeros that "
        "are set anew end the validity.",
        on=HTML,
    )


def _remarks(c: Certificate) -> list[str]:
    """Return the verdict on the calibration and what may explain the errors, in sentences."""
    remarks = []
    verdict = c.calibration.verdict_on(non_geometric=c.assessment.judged == "non_geometric")
    if verdict is None:
        remarks.append("The calibration was not cross-validated and has no verdict.")
    else:
        remarks.append(f"The verdict on the calibration: {verdict.use}.")
        remarks += [reason_text(reason) for reason in verdict.reasons]
    if c.assessment.hint is not None:
        remarks.append(reason_text(c.assessment.hint))
    if c.record.note:
        remarks.append(c.record.note)
    return remarks


def _files(c: Certificate, date: str) -> list[tuple[str, str]]:
    """List the files with their hashes, the versions and the command."""
    m = c.measurements
    return [
        ("Certificate", c.id),
        ("Calibration", c.files.result or "from memory"),
        ("  SHA-256", c.files.result_sha256),
        ("  Run", c.calibration.run),
        ("  Table", c.calibration.source.name),
        ("  SHA-256 ", c.calibration.source.sha256),
        ("Measurements", m.source or "from memory"),
        ("  SHA-256  ", m.sha256.replace(" + ", ", ") or "-"),
        ("Software", ", ".join(f"{name} {version}" for name, version in versions().items())),
        ("Command", c.files.command or "not from the command line"),
        ("Date", date),
    ]
