r"""A certificate as Digital Calibration Certificate (DCC): XML of the PTB's schema 3.2.1, with units of D-SI 2.1.0.

Each quantity is a list over the points in SI units (``\metre``, ``\radian``, ``\one``), with the same digits as the
JSON file, its repr. The attribute ``refType`` of each names it, ``calib_asFound`` and so on, with those of the PTB's
good practice where there are any (``basic_temperature``). All quantities are numbers: readers such as pydcc fail on
others. Degrees of freedom are left out if they are infinite, for which D-SI has no number.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from xml.etree import ElementTree

from calib.basics.dates import parse_date
from calib.basics.files import write_atomically
from calib.errors import CalibError, choices
from calib.result.calibration_file import versions
from calib.show.budget_table import SOURCES
from calib.show.verdict_text import reason_text
from calib.uncertainty.coverage import PROBABILITY
from calib.verbs.certificate.certificate import Certificate, Decision
from calib.verbs.certificate.text import gap_text, method_sentences, rule_sentences

#: The schema, and where a reader finds it.
VERSION = "3.2.1"
_DCC, _SI = "https://ptb.de/dcc", "https://ptb.de/si"
_INSTANCE = "http://www.w3.org/2001/XMLSchema-instance"

#: Units of D-SI by those of the certificate.
_UNITS = {"m": r"\metre", "rad": r"\radian", "1": r"\one", "C": r"\degreecelsius", "%": r"\percent"}

#: Entries of the record that a DCC must have.
_NEEDED = (
    "certificate_number",
    "laboratory",
    "country",
    "customer",
    "responsible",
    "date",
    "robot_serial",
)

#: Characters that XML does not have.
_NOT_XML = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")

#: The word of the schema for each outcome; undecided is told apart by the side of the tolerance.
_CONFORMITY = {"pass": "pass", "fail": "fail"}

Element = ElementTree.Element


def write_dcc(c: Certificate, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write a certificate as DCC, after the XML was read back; see `Certificate.write_dcc`."""
    return write_atomically(path, dcc_bytes(c), overwrite=overwrite)


def dcc_bytes(c: Certificate) -> bytes:
    """Return a certificate as the XML of a DCC, UTF-8.

    Raises:
        CalibError: The record lacks an entry that a DCC must have, or its date is not that of a day.
    """
    given = c.record.given
    missing = [name for name in _NEEDED if name not in given]
    if missing:
        raise CalibError(
            f"A DCC must state {choices(missing)}: add {'it' if len(missing) == 1 else 'them'} to [record] of the cell "
            "file."
        )
    if parse_date(c.record.date) is None:
        raise CalibError(
            f"A DCC states the day of the measurement, and the record's date is '{c.record.date}'. Write it as "
            "2026-11-30 in [record] of the cell file."
        )
    root = _of(
        "digitalCalibrationCertificate",
        _administrative(c),
        _of("measurementResults", _measurement_result(c)),
    )
    root.attrib.update(
        {
            "xmlns:dcc": _DCC,
            "xmlns:si": _SI,
            "xmlns:xsi": _INSTANCE,
            "xsi:schemaLocation": f"{_DCC} {_DCC}/v{VERSION}/dcc.xsd",
            "schemaVersion": VERSION,
        }
    )
    ElementTree.indent(root)
    data: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    ElementTree.fromstring(data)  # an internal error unless it is XML
    return data + b"\n"


# Elements


def _of(tag: str, *children: Element | str | None, ref: str = "") -> Element:
    """Return an element of the DCC's name space with children, or with a text; None is left out."""
    element = Element(f"dcc:{tag}")
    if ref:
        element.set("refType", ref)
    for child in children:
        if isinstance(child, str):
            element.text = _NOT_XML.sub("\ufffd", child)
        elif child is not None:
            element.append(child)
    return element


def _text(tag: str, *texts: str, ref: str = "") -> Element:
    """Return an element with texts in English."""
    contents = []
    for text in texts:
        content = _of("content", text)
        content.set("lang", "en")
        contents.append(content)
    return _of(tag, *contents, ref=ref)


def _si(tag: str, text: str) -> Element:
    """Return an element of D-SI's name space with a text."""
    element = Element(f"si:{tag}")
    element.text = text
    return element


def _real(value: float, unit: str) -> Element:
    """Return a real quantity of D-SI in a unit of `_UNITS`."""
    real = Element("si:real")
    real.extend([_si("value", repr(float(value))), _si("unit", _UNITS[unit])])
    return real


def _real_list(
    values: Sequence[float],
    unit: str,
    uncertainties: Sequence[float] = (),
    factors: Sequence[float] = (),
    labels: Sequence[str] = (),
) -> Element:
    """Return a list of real quantities of D-SI, with expanded uncertainties and coverage factors, or labels, if given.

    Labels are words without blanks.
    """
    listed = Element("si:realListXMLList")
    if labels:
        listed.append(_si("labelXMLList", " ".join(labels)))
    listed.extend([_si("valueXMLList", _numbers(values)), _si("unitXMLList", _UNITS[unit])])
    if len(uncertainties):
        expanded = Element("si:expandedUncXMLList")
        expanded.extend(
            [
                _si("uncertaintyXMLList", _numbers(uncertainties)),
                _si("coverageFactorXMLList", _numbers(factors)),
                _si("coverageProbabilityXMLList", repr(PROBABILITY)),
            ]
        )
        listed.append(expanded)
    return listed


def _numbers(values: Iterable[float]) -> str:
    """Return numbers by their repr, separated by blanks."""
    return " ".join(repr(float(value)) for value in values)


def _quantity(name: str, ref: str, quantity: Element) -> Element:
    """Return a quantity with its name."""
    return _of("quantity", _text("name", name), quantity, ref=ref)


def _identification(issuer: str, value: str, name: str, ref: str = "") -> Element | None:
    """Return an identification; None without a value."""
    if not value:
        return None
    parts = (_of("issuer", issuer), _of("value", value), _text("name", name))
    return _of("identification", *parts, ref=ref)


def _statement(
    ref: str,
    name: str,
    *texts: str,
    norms: Sequence[str] = (),
    conformity: str = "",
    data: Element | None = None,
) -> Element:
    """Return a statement with a declaration, and further parts in the order of the schema."""
    return _of(
        "statement",
        _text("name", name),
        *(_of("norm", norm) for norm in norms),
        _text("declaration", *texts),
        _of("conformity", conformity) if conformity else None,
        data,
        ref=ref,
    )


# Administrative data


def _administrative(c: Certificate) -> Element:
    """Return software, core data, item, laboratory, persons, customer and statements."""
    record = c.record
    day = record.date[:10]
    identifications = [
        _identification("calibrationLaboratory", record.order, "Order no.", "basic_orderNumber"),
        _identification("calibrationLaboratory", c.id, "calib certificate"),
        _identification("calibrationLaboratory", c.calibration.run, "calib run"),
    ]
    core = _of(
        "coreData",
        _of("countryCodeISO3166_1", record.country),
        _of("usedLangCodeISO639_1", "en"),
        _of("mandatoryLangCodeISO639_1", "en"),
        _of("uniqueIdentifier", record.certificate_number),
        _of("identifications", *identifications),
        _of("beginPerformanceDate", day),
        _of("endPerformanceDate", day),
        _of("performanceLocation", "other"),
        _of("issueDate", c.time[:10]),
    )
    where = _text("further", record.place or "not stated")
    person = _of("person", _text("name", record.responsible))
    main = _of("respPerson", person, _of("role", "authorises"), _of("mainSigner", "true"))
    operator = None
    if record.operator:
        person = _of("person", _text("name", record.operator))
        operator = _of("respPerson", person, _of("role", "measured"), _of("mainSigner", "false"))
    laboratory = _of(
        "contact",
        _text("name", record.laboratory),
        _of("location", _of("countryCode", record.country)),
    )
    return _of(
        "administrativeData",
        _software("dccSoftware"),
        core,
        _items(c),
        _of("calibrationLaboratory", laboratory),
        _of("respPersons", main, operator),
        _of("customer", _text("name", record.customer), _of("location", where)),
        _statements(c),
    )


def _software(tag: str) -> Element:
    """Return calib and the packages that computed the certificate, with their versions."""
    listed = []
    for name, version in versions().items():
        kind = "application" if name == "calib" else "library"
        listed.append(
            _of("software", _text("name", name), _of("release", version), _of("type", kind))
        )
    return _of(tag, *listed)


def _items(c: Certificate) -> Element:
    """Return the robot: maker and model, serial numbers, URDFs with their hashes."""
    record, result = c.record, c.calibration
    identifications = [
        _identification(
            "manufacturer", record.robot_serial, "Serial no. of the arm", "basic_serialNumber"
        ),
        _identification("manufacturer", record.controller_serial, "Serial no. of the controller"),
        _identification("other", result.nominal.urdf.source, "URDF"),
        _identification("other", result.nominal.urdf.sha256, "SHA-256 of the URDF as found"),
        _identification("other", result.robot.urdf.sha256, "SHA-256 of the URDF as left"),
    ]
    model = _of("model", record.robot) if record.robot else None
    item = _of(
        "item",
        _text("name", f"Robot {result.nominal.name}"),
        model,
        _of("identifications", *identifications),
    )
    return _of("items", item)


def _statements(c: Certificate) -> Element:
    """Return statements on traceability, validity, conformity, what was not tested, and remarks."""
    record = c.record
    listed = [_statement("calib_results", "Results", *_RESULTS)]
    if record.traceability:
        text = f"Traceable to {record.traceability}; the instrument's certificate: "
        text += record.instrument_certificate or "not stated"
        listed.append(_statement("basic_traceability", "Traceability", text))
    listed.append(_validity(c))
    for unit, decision in c.decisions.items():
        listed.append(_conformity(c, unit, decision))
    listed += [
        _statement(f"calib_notTested calib_{gap.code.value}", "Not tested", gap_text(gap))
        for gap in c.gaps
    ]
    verdict = c.calibration.verdict_on(non_geometric=c.assessment.judged == "non_geometric")
    if verdict is not None:
        texts = [reason_text(reason) for reason in verdict.reasons]
        listed.append(_statement("calib_verdict", "Verdict", verdict.use, *texts))
    if record.note:
        listed.append(_statement("calib_note", "Note", record.note))
    return _of("statements", *listed)


#: What ISO/IEC 17025, 7.8.2.1, has a certificate say of its results.
_RESULTS = ("The results are those of this robot at the time of the measurement.",)


def _validity(c: Certificate) -> Element:
    """Return the statement of validity: the range of each joint, and until when."""
    quantities = []
    for one in c.box:
        unit = "m" if one.prismatic else "rad"
        for name, end, value in zip(
            ("lower", "upper"), ("Min", "Max"), one.calibrated, strict=True
        ):
            if math.isfinite(value):  # of results that know their ranges
                quantity = _real(value, unit)
                ref = f"basic_validityRange{end}"
                quantities.append(_quantity(f"{one.joint}, {name} limit", ref, quantity))
    text = "Valid within these ranges of the joints"
    if c.record.load:
        text += f", with the load {c.record.load}"
    if c.record.valid_until:
        text += f", until {c.record.valid_until}"
    data = _of("data", *quantities) if quantities else None
    return _statement("basic_validityRange", "Validity", f"{text}.", data=data)


def _conformity(c: Certificate, unit: str, decision: Decision) -> Element:
    """Return the statement of conformity in one unit, with tolerance, guard band, probabilities and risks."""
    check, risks = decision.check, decision.risks
    numbers: list[tuple[str, str, float, str]] = [
        ("Largest deviation as left", "calib_largestDeviation", check.figure, unit),
        ("Tolerance", "calib_tolerance", check.tolerance, unit),
        ("Guard band", "calib_guardBand", check.uncertainty, unit),
        ("Factor of the registration", "calib_factor", check.factor, "1"),
        ("Probability of conformity", "calib_conformanceProbability", decision.conformance, "1"),
    ]
    if math.isfinite(decision.specific_risk):
        numbers.append(("Specific risk", "calib_specificRisk", decision.specific_risk, "1"))
    if decision.prior is not None and risks is not None:
        mean, std = decision.prior
        numbers += [
            ("Mean of such robots", "calib_priorMean", mean, unit),
            ("Standard deviation of such robots", "calib_priorStd", std, unit),
            ("Global risk of acceptance", "calib_globalRiskOfAcceptance", risks.consumer, "1"),
            ("Global risk of rejection", "calib_globalRiskOfRejection", risks.producer, "1"),
        ]
    quantities = [
        _quantity(name, ref, _real(value, of))
        for name, ref, value, of in numbers
        if math.isfinite(value)
    ]
    within = check.figure * check.factor <= check.tolerance
    word = _CONFORMITY.get(check.outcome, "conditionalPass" if within else "conditionalFail")
    rule = next(iter(rule_sentences(c)))
    return _statement(
        "basic_conformity",
        "Conformity",
        rule,
        norms=("ISO 14253-1", "JCGM 106"),
        conformity=word,
        data=_of("data", *quantities),
    )


# Results


def _measurement_result(c: Certificate) -> Element:
    """Return methods, instrument, conditions and results."""
    record = c.record
    methods = _of(
        "usedMethods",
        _of(
            "usedMethod",
            _text("name", "Kinematic calibration of a robot"),
            _text("description", *method_sentences(c)),
            _of("norm", "ISO 9283"),
            _of("norm", "JCGM 100"),
            ref="calib_method",
        ),
    )
    equipment = None
    if record.instrument or record.instrument_serial:
        identifications = [
            _identification(
                "manufacturer", record.instrument_serial, "Serial no.", "basic_serialNumber"
            ),
            _identification("other", record.instrument_certificate, "Certificate"),
            _identification("other", record.instrument_calibrated, "Calibrated on"),
            _identification("other", record.calibration_due, "Calibrated until"),
        ]
        present = [one for one in identifications if one is not None]
        equipment = _of(
            "measuringEquipments",
            _of(
                "measuringEquipment",
                _text("name", record.instrument or "Measuring instrument"),
                _of("identifications", *present) if present else None,
                ref="basic_measurementStandard",
            ),
        )
    conditions = _conditions(c)
    return _of(
        "measurementResult",
        _text("name", "Deviations of a robot as found and as left"),
        methods,
        _software("usedSoftware"),
        equipment,
        _of("influenceConditions", *conditions) if conditions else None,
        _of("results", *_results(c)),
    )


def _conditions(c: Certificate) -> list[Element]:
    """Return temperature and humidity as quantities, load, speed, warm-up, order and place in words."""
    record = c.record
    listed = []
    for name, ref, values, unit in (
        ("Air temperature", "basic_temperature", record.temperature_C, "C"),
        ("Humidity", "basic_humidityRelative", record.humidity_percent, "%"),
    ):
        if values:
            ends = (("Min", min(values)), ("Max", max(values)))
            quantities = [
                _quantity(f"{name}, {end}", f"{ref}{end}", _real(value, unit))
                for end, value in ends
            ]
            data = _of("data", *quantities)
            listed.append(_of("influenceCondition", _text("name", name), data, ref=ref))
    for name, text in (
        ("Load", record.load),
        ("Speed", record.speed),
        ("Warm-up", record.warm_up),
        ("Order of the poses", record.sequence),
        ("Place", record.place),
    ):
        if text:
            data = _of("data", _text("text", text))
            listed.append(_of("influenceCondition", _text("name", name), data))
    return listed


def _results(c: Certificate) -> list[Element]:
    """Return a result for the deviations in each unit, and one for the budget."""
    listed = []
    for unit in c.units:
        points = [point for point in c.points if unit in point.deviations]
        of_unit = [point.deviations[unit] for point in points]
        uncertainties = [one.uncertainty for one in of_unit]
        factors = [one.factor for one in of_unit]
        first = _real_list([point.rows[0] for point in points], "1")
        quantities = [_quantity("First row in the table", "calib_row", first)]
        for k, one in enumerate(c.box):
            values = [float(point.joints[k]) for point in points]
            quantities.append(
                _quantity(
                    one.joint,
                    f"calib_joint{k + 1}",
                    _real_list(values, "m" if one.prismatic else "rad"),
                )
            )
        for axis, letter in enumerate("xyz"):
            values = [float(point.position[axis]) for point in points]
            quantities.append(
                _quantity(f"{letter} in the base", f"calib_{letter}", _real_list(values, "m"))
            )
        if all(math.isfinite(one.found) for one in of_unit):
            found = _real_list([one.found for one in of_unit], unit, uncertainties, factors)
            quantities.append(
                _quantity("Deviation as found", "calib_asFound basic_measurementError", found)
            )
        left = _real_list([one.left for one in of_unit], unit, uncertainties, factors)
        quantities.append(
            _quantity("Deviation as left", "calib_asLeft basic_measurementError", left)
        )
        of_pose = _real_list([one.of_pose for one in of_unit], unit)
        quantities.append(
            _quantity("Expanded uncertainty of the pose", "calib_uncertaintyOfPose", of_pose)
        )
        if unit in c.decisions:
            likely = _real_list([one.conformance for one in of_unit], "1")
            quantities.append(
                _quantity("Probability of conformity", "calib_conformanceProbability", likely)
            )
        freedoms = [one.freedom for one in of_unit]
        if all(map(math.isfinite, freedoms)):
            listed_freedoms = _real_list(freedoms, "1")
            quantities.append(
                _quantity("Effective degrees of freedom", "calib_freedom", listed_freedoms)
            )
        what = "positions" if unit == "m" else "orientations"
        data = _of("data", _of("list", *quantities, ref=f"calib_points_{unit}"))
        listed.append(
            _of("result", _text("name", f"Deviations of {what}"), data, ref=f"calib_{what}")
        )
    listed.append(_budget(c))
    return listed


def _budget(c: Certificate) -> Element:
    """Return the budget of the pose's uncertainty: a list over the sources, and the sum."""
    budget = c.budget
    lines = budget.lines
    sources = [line.source.value for line in lines]
    listed = [
        _quantity(name, f"calib_{ref}", _real_list(values, unit, labels=sources))
        for name, ref, values, unit in (
            (
                "Standard uncertainty of the position",
                "position",
                [x.position_std for x in lines],
                "m",
            ),
            (
                "Standard uncertainty of the orientation",
                "orientation",
                [x.orientation_std for x in lines],
                "rad",
            ),
            ("Share of the variance", "share", [x.share for x in lines], "1"),
        )
    ]
    total = [
        _quantity(f"{kind} uncertainty of the {what}", f"calib_{ref}", _real(value, unit))
        for kind, what, ref, value, unit in (
            ("Combined standard", "position", "combinedPosition", budget.position_std, "m"),
            ("Expanded", "position", "expandedPosition", budget.position, "m"),
            (
                "Combined standard",
                "orientation",
                "combinedOrientation",
                budget.orientation_std,
                "rad",
            ),
            ("Expanded", "orientation", "expandedOrientation", budget.orientation, "rad"),
        )
    ]
    words = "; ".join(f"{line.source.value}: {SOURCES[line.source]}" for line in lines)
    data = _of("data", _of("list", *listed, ref="calib_budget"), *total)
    return _of(
        "result",
        _text("name", "Budget of the uncertainty of the pose"),
        _text("description", words),
        data,
        ref="calib_budget",
    )
