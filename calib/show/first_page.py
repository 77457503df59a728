"""The first page of a report, for the customer: outcome, record, errors before and after, and lines to sign.

It is one sheet of A4, so long texts are shortened: the sections behind it have them in full.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from calib.data.record import Record
from calib.robot.robot import Robot
from calib.show.lines import number, plural
from calib.show.table import Table

#: Lines of the sheet that are left for reasons, long entries of the form, the note, and rows of the table.
_LINES = 16

#: Letters in a line of a reason or of the note.
_LINE = 100

#: Letters in a line of an entry of the form.
_ENTRY = 28

#: Letters of a reason that there is room for.
_REASON = 2 * _LINE

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
    #: All that it rests on, the most important first
    reasons: Sequence[str]
    #: Name of the section that has all of it in full
    section: str
    #: Lines of the form's left half: customer and robot
    left: Sequence[Line]
    #: Lines of its right half: instrument, place, time
    right: Sequence[Line]
    #: Anything else that the record has
    note: str
    #: Errors before and after
    table: Table
    #: Decision rule, number of poses, uncertainty, in sentences
    rule: Sequence[str]
    #: Who signs
    parties: tuple[str, str]

    @property
    def listed(self) -> list[str]:
        """The reasons that there is room for, long ones shortened; the last line counts the others."""
        room = _LINES - len(self.table.rows) - _lines(self.note, _LINE)
        for (_, on_left), (_, on_right) in zip(self.left, self.right, strict=True):
            room -= max(_lines(on_left, _ENTRY), _lines(on_right, _ENTRY), 1) - 1
        shown: list[str] = []
        for reason in self.reasons:
            text = _shortened(reason, _REASON)
            room -= _lines(text, _LINE)
            if room < 1:
                break
            shown.append(text)
        more = len(self.reasons) - len(shown)
        if more:
            shown.append(f"{plural(more, 'more statement')}: see section '{self.section}'.")
        return shown


def _lines(text: str, width: int) -> int:
    """Return the number of lines of this many letters that a text takes; 0 for none."""
    return -(-len(text) // width)


def robot_name(robot: Robot) -> str:
    """Return a robot's name in one line, shortened to the room for it."""
    return _shortened(robot.name, _NAME)


def _shortened(text: str, longest: int) -> str:
    """Shorten a text that is too long: at a blank, or within its first word where that is longer itself."""
    text = " ".join(text.split())
    if len(text) <= longest:
        return text
    at_blank = textwrap.shorten(text, longest, placeholder=_MORE)
    return at_blank if len(at_blank) > longest // 2 else text[: longest - len(_MORE)] + _MORE


def left_lines(record: Record, robot: Robot) -> list[Line]:
    """Return the lines about customer and robot.

    Args:
        record: The record of the measurement.
        robot: The robot.
    """
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
