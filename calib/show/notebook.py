"""Results as small tables of HTML, which notebooks show in place of a line; every text is escaped."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from calib.diagnosis.reasons import Verdict
from calib.robot.robot import Robot
from calib.show.verdict import reason_text


def verdict_rows(verdict: Verdict | None) -> Iterable[Sequence[str]]:
    """Write the verdict, and its first reason in words."""
    if verdict is None:
        yield "verdict", "none"
        return
    yield "verdict", verdict.use
    if verdict.reasons:
        yield "first reason", reason_text(verdict.reasons[0])


def html_table(title: str, rows: Iterable[Sequence[str]]) -> str:
    """Write a table of two columns with a caption, its texts escaped."""
    lines = [
        f'<tr><th style="text-align:left">{escape(label)}</th>'
        f'<td style="text-align:left">{escape(text)}</td></tr>'
        for label, text in rows
    ]
    caption = f'<caption style="text-align:left">{escape(title)}</caption>'
    return "\n".join(["<table>", caption, *lines, "</table>"])


def chain_name(robot: Robot) -> str:
    """Name a robot and its chain."""
    return f"'{robot.name}', {robot.base} to {robot.tip}"
