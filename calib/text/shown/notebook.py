"""Results as small tables of HTML, which notebooks show in place of a line; every text is escaped."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from calib.design.plan import PlanValues
from calib.diagnosis.reasons import Verdict
from calib.result.calibration import CalibrationValues
from calib.result.comparison import ComparisonValues
from calib.result.evaluation import EvaluationValues
from calib.robot.robot import Robot
from calib.text.comparison import sentence
from calib.text.layout.lines import mm
from calib.text.shown.short import before_and_after, rms_text
from calib.text.verdict import reason_text


def calibration_html(c: CalibrationValues) -> str:
    """Write a calibration: the verdict with its first reason, errors before and after, rows."""
    where, before, after = before_and_after(c)
    rows = [*_verdict_rows(c.verdict)]
    rows.append((f"rms error, nominal ({where} rows)", rms_text(before)))
    rows.append((f"rms error, calibrated ({where} rows)", rms_text(after)))
    other = c.non_geometric
    if other is not None and other.cross_validation is not None:
        errors = other.cross_validation.errors_without_outliers
        rows.append((f"rms error, model '{other.name}' ({where} rows)", rms_text(errors)))
    rows.append(("model", c.model.name))
    rows.append(("rows", f"{len(c.rows)}, {len(c.outliers)} of them outliers"))
    return _table(f"Calibration of {_chain(c.nominal)}", rows)


def evaluation_html(e: EvaluationValues) -> str:
    """Write an evaluation: the errors of each set of rows."""
    rows = []
    for name, errors in e.errors.items():
        if errors.units:
            rows.append((f"rms error, {name} rows", rms_text(errors)))
    rows.append(("rows", str(len(e.measurements))))
    if e.registered:
        rows.append(("registered to the rows", " and ".join(e.registered)))
    return _table(f"Evaluation of {_chain(e.robot)}", rows)


def comparison_html(c: ComparisonValues) -> str:
    """Write a comparison: its answer, and the verdict on each result."""
    rows = [("answer", sentence(c))]
    for name, result in zip(c.names, (c.a, c.b), strict=True):
        verdict = "no verdict" if result.verdict is None else result.verdict.use
        _, _, after = before_and_after(result)
        rows.append((name, f"{verdict}, rms error {rms_text(after)}, {len(result.rows)} rows"))
    return _table(f"Comparison of two calibrations of {_chain(c.a.nominal)}", rows)


def plan_html(p: PlanValues) -> str:
    """Write a plan: numbers of poses, expected error of these and of random poses."""
    count = len(p.estimation)
    rows = [
        ("poses", f"{count}, and {len(p.joints) - count} for validation"),
        ("expected rms error", f"{mm(p.forecast.rms)} mm"),
        ("of random poses", f"{mm(p.at_random.rms)} mm"),
        ("model", p.model),
        ("candidates", f"{p.candidates} of {p.drawn} drawn"),
    ]
    if p.blocked:
        rows.append(("moves that are not free", str(len(p.blocked))))
    return _table(f"Plan for {_chain(p.robot)}", rows)


def _verdict_rows(verdict: Verdict | None) -> Iterable[Sequence[str]]:
    """Write the verdict, and its first reason in words."""
    if verdict is None:
        yield "verdict", "none"
        return
    yield "verdict", verdict.use
    if verdict.reasons:
        yield "first reason", reason_text(verdict.reasons[0])


def _table(title: str, rows: Iterable[Sequence[str]]) -> str:
    """Write a table of two columns with a caption, its texts escaped."""
    lines = [
        f'<tr><th style="text-align:left">{escape(label)}</th>'
        f'<td style="text-align:left">{escape(text)}</td></tr>'
        for label, text in rows
    ]
    caption = f'<caption style="text-align:left">{escape(title)}</caption>'
    return "\n".join(["<table>", caption, *lines, "</table>"])


def _chain(robot: Robot) -> str:
    """Name a robot and its chain."""
    return f"'{robot.name}', {robot.base} to {robot.tip}"
