"""The first page of a report, for the customer: verdict, record, errors before and after, and lines to sign.

It is one sheet of A4, so long texts are shortened: the sections after it have them in full.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from calib.data.record import Record
from calib.robot.robot import Robot
from calib.show.blocks import Block, Verdict
from calib.show.lines import number, plural
from calib.show.tables import Table
from calib.show.words import ends_text

#: Lines of the sheet that are left for reasons, long entries of the form, the note, and rows of the table.
_LINES = 16

#: Lines of a report's form; longer forms leave less room.
_FORM = 9

#: Letters in a line of a reason or of the note.
_LINE = 100

#: Letters in a line of an entry of the form.
_ENTRY = 28

#: Most letters of a reason.
_REASON = 2 * _LINE

#: Most letters of a robot's name.
_NAME = 60

#: Ending of a text that was shortened.
_MORE = " ..."

#: Label and value of a line of a form; without a value it is filled in by hand.
Line = tuple[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class FirstPage(Block):
    """The first page of a report; only pages on HTML have one."""

    #: The verdict, with all that it rests on
    verdict: Verdict
    #: Name of the section that has all of it in full
    section: str
    #: Who measured what for whom, where, when and with what
    record: Record
    robot: Robot
    #: Label and value of the measuring uncertainty
    uncertainty: Line
    #: Name of the measurements' file; empty if there was none
    source: str
    #: Errors before and after
    table: Table
    #: Decision rule, number of poses, in sentences
    rule: Sequence[str]
    #: Who signs
    parties: tuple[str, str]
    #: Lines of the form's halves in place of the report's; None: the report's
    form: tuple[Sequence[Line], Sequence[Line]] | None = None

    @property
    def left(self) -> list[Line]:
        """Label and value of each line of the form's left half: customer and robot; an empty value stays blank."""
        if self.form is not None:
            return [*self.form[0]]
        robot, record = self.robot, self.record
        chain = f"{robot.name}, {ends_text(robot)}, {plural(len(robot.all_joints), 'joint')}"
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

    @property
    def right(self) -> list[Line]:
        """Label and value of each line of the form's right half: instrument, place, time; an empty one stays blank."""
        if self.form is not None:
            return [*self.form[1]]
        record = self.record
        temperatures = " to ".join(number(value, 1) for value in record.temperature_C)
        return [
            ("Instrument", record.instrument),
            ("Instrument, serial no.", record.instrument_serial),
            ("Calibrated until", record.calibration_due),
            self.uncertainty,
            ("Uncertainty from", record.uncertainty_from),
            ("Place", record.place),
            ("Measured on", record.date),
            ("Air temperature [°C]", temperatures),
            ("Measurements", _shortened(self.source or "from memory", _NAME)),
        ]

    @property
    def listed(self) -> list[str]:
        """The reasons that fit on the sheet, long ones shortened; the last line counts the others."""
        room = _LINES - len(self.table.rows) - _line_count(self.record.note, _LINE)
        room -= max(len(self.left) - _FORM, 0)
        for (_, on_left), (_, on_right) in zip(self.left, self.right, strict=True):
            room -= max(_line_count(on_left, _ENTRY), _line_count(on_right, _ENTRY), 1) - 1
        shown: list[str] = []
        for reason in self.verdict.reasons:
            text = _shortened(reason, _REASON)
            room -= _line_count(text, _LINE)
            if room < 1:
                break
            shown.append(text)
        more = len(self.verdict.reasons) - len(shown)
        if more:
            shown.append(f"{plural(more, 'more statement')}: see section '{self.section}'.")
        return shown


def robot_name(robot: Robot) -> str:
    """Return a robot's name in one line, shortened to the room for it."""
    return _shortened(robot.name, _NAME)


def _line_count(text: str, width: int) -> int:
    """Return the number of lines of this many letters that a text takes; 0 for none."""
    return -(-len(text) // width)


def _shortened(text: str, longest: int) -> str:
    """Return a text in one line, of at most ``longest`` letters: what is longer is cut, at a blank if it can be.

    Dots stand at the end of one that was cut.
    """
    text = " ".join(text.split())
    if len(text) <= longest:
        return text
    at_blank = textwrap.shorten(text, longest, placeholder=_MORE)
    return at_blank if len(at_blank) > longest // 2 else text[: longest - len(_MORE)] + _MORE
