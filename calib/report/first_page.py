"""The first page of a report, for the customer: outcome, record, errors before and after, and lines to sign.

It is one sheet of A4, so long texts are shortened: the sections behind it have them in full.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from calib.data.record import Record
from calib.report.table import Table
from calib.robot.robot import Robot
from calib.text.layout.lines import number, plural

#: Reasons of the outcome that there is room for; the others are counted.
_MOST_REASONS = 4

#: Letters of a reason that there is room for.
_REASON = 230

#: Letters of a robot's name that there is room for.
_NAME = 60

#: What follows a text that was shortened.
_MORE = " ..."

#: The sign and the shade of each outcome or verdict: a word and a sign, never a colour alone.
_SHADES = {
    "pass": ("\u2713", "good"),
    "use": ("\u2713", "good"),
    "undecided": ("!", "care"),
    "use with care": ("!", "care"),
    "fail": ("\u2715", "bad"),
    "do not use": ("\u2715", "bad"),
    "none": ("\u2013", "none"),
}

#: Label and value of a line of a form; without a value it is filled in by hand.
Line = tuple[str, str]


@dataclass(frozen=True, slots=True)
class Outcome:
    """A verdict, or the outcome of an acceptance test, as it stands on a page."""

    #: ``"Verdict: pass"``
    text: str
    #: The sign before it
    sign: str
    #: Class of its colour in the style sheet: ``"good"``, ``"care"``, ``"bad"`` or ``"none"``
    shade: str

    @classmethod
    def of(cls, verdict: str) -> Outcome:
        """Return the outcome of a verdict's word, such as ``"use with care"``."""
        return cls(f"Verdict: {verdict}", *_SHADES[verdict])


@dataclass(frozen=True, slots=True)
class FirstPage:
    """The first page of a report."""

    #: The robot's name
    robot: str
    #: The outcome
    outcome: Outcome
    #: What it rests on; see `first_reasons`
    reasons: Sequence[str]
    #: Lines of the form's left half: customer and robot
    left: Sequence[Line]
    #: Lines of its right half: instrument, place, time
    right: Sequence[Line]
    #: Anything else that the record has
    note: str
    #: Heading of the tables
    heading: str
    #: Errors before and after
    tables: Sequence[Table]
    #: Decision rule, number of poses, uncertainty, in sentences
    rule: Sequence[str]
    #: Who signs
    parties: tuple[str, str]


def robot_name(robot: Robot) -> str:
    """Return a robot's name in one line, shortened to the room for it."""
    return _shortened(robot.name, _NAME)


def first_reasons(reasons: Sequence[str], section: str) -> list[str]:
    """Return the reasons that there is room for; the last line counts the others.

    Args:
        reasons: All reasons, the most important first.
        section: Name of the section that has all of them.
    """
    shown = [_shortened(reason, _REASON) for reason in reasons[:_MOST_REASONS]]
    more = len(reasons) - len(shown)
    if more:
        shown.append(f"{plural(more, 'more statement')}: see section '{section}'.")
    return shown


def _shortened(text: str, longest: int) -> str:
    """Shorten a text that is too long: at a blank, or within its first word where that is longer itself."""
    text = " ".join(text.split())
    if len(text) <= longest:
        return text
    at_blank = textwrap.shorten(text, longest, placeholder=_MORE)
    return at_blank if len(at_blank) > longest // 2 else text[: longest - len(_MORE)] + _MORE


def left_lines(record: Record, robot: Robot) -> list[Line]:
    """Return the lines about customer and robot."""
    chain = f"{robot.name}, {robot.base} to {robot.tip}, {plural(len(robot.joints), 'joint')}"
    return [
        ("Customer", record.customer),
        ("Order", record.order),
        ("Robot", _shortened(chain, 2 * _NAME)),
        ("Robot, serial no.", record.robot_serial),
        ("Controller, serial no.", record.controller_serial),
        ("Load", record.load),
        ("Speed", record.speed),
        ("Warm-up", record.warm_up),
        ("Measured by", record.operator),
    ]


def right_lines(record: Record, uncertainty: Line, source: str) -> list[Line]:
    """Return the lines about instrument, place and time.

    Args:
        record: The record of the measurement.
        uncertainty: Label and value of the measuring uncertainty.
        source: Name of the measurements' file; empty where there was none.
    """
    temperatures = " to ".join(number(value, 1) for value in record.temperature_C)
    return [
        ("Instrument", record.instrument),
        ("Instrument, serial no.", record.instrument_serial),
        ("Calibrated until", record.calibration_due),
        uncertainty,
        ("Uncertainty from", record.uncertainty_from),
        ("Place", record.place),
        ("Measured on", record.date),
        ("Air temperature [°C]", temperatures),
        ("Measurements", _shortened(source or "from memory", _NAME)),
    ]
