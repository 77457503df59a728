"""A trend in words and on a page: what changed, the results and the joints as tables, the figures over time."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calib.basics.dates import date_text
from calib.basics.files import write_atomically
from calib.errors import choices
from calib.show.as_html import check_ending, page_bytes
from calib.show.as_text import page_text
from calib.show.blocks import HTML, Block, Bullets, Drawing, Page, Paragraph, Section, Verdict
from calib.show.lines import mm, number, plural
from calib.show.look import CALIBRATED, INK, OUTLIER, SOFT
from calib.show.plotting import legend_above, new_figure
from calib.show.tables import Column, Row, Table, name_column
from calib.show.words import chain_name
from calib.verbs.compare.difference import unknown_frame
from calib.verbs.compare.text import kept_sentence
from calib.verbs.compare.trend import JointHistory, RobotTrend

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Unit in which a zero is shown, and factor to it, by its unit.
_SHOWN = {"rad": ("mrad", 1e3), "m": ("mm", 1e3)}

#: Height of the panel of a joint [in].
_PANEL = 1.5


def trend_text(t: RobotTrend) -> str:
    """Write a trend: what changed, the joints, the results."""
    return page_text(_page(t))


def write_report(t: RobotTrend, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write the page of a trend; see `RobotTrend.write_report`."""
    check_ending(path)
    return write_atomically(path, page_bytes(_page(t)), overwrite=overwrite)


def _page(t: RobotTrend) -> Page:
    """List the sections that show a trend."""
    robot = chain_name(t.results[0].nominal)
    serial = t.results[0].record.robot_serial
    subject = f"{robot}, serial no. {serial}" if serial else robot
    sections = (
        Section(lambda: [Paragraph(f"{plural(len(t.results), 'calibration')} of {subject}")]),
        Section(partial(_answer, t), "Outcome"),
        Section(lambda: [_joints(t)], "Joint zeros"),
        Section(lambda: [_zeros_drawing(t)], on=HTML),
        Section(lambda: [_results(t)], "Displacement of the target"),
        Section(lambda: [_moves_drawing(t)], on=HTML),
        Section(lambda: [Bullets(list(_notes(t)))], "Notes"),
    )
    return Page("Trend", subject, sections)


def _answer(t: RobotTrend) -> Iterator[Block]:
    """Say whether a tolerance is kept, and which joints are not steady."""
    sentences = [sentence(joint, t) for joint in t.changed]
    if not sentences:
        sentences = ["No joint's zero drifts or has a step that these data could show."]
    if t.kept is not None and t.tolerance is not None:
        yield Verdict(t.kept, [kept_sentence(t.kept, t.tolerance), *sentences])
    else:
        yield Bullets(sentences)


def sentence(joint: JointHistory, t: RobotTrend) -> str:
    """Say what the zero of a joint that is not steady does."""
    if joint.trend is None:
        return f"{joint.joint}: its zero cannot be told from the places of base and target."
    unit, factor = _SHOWN[joint.unit]
    trend = joint.trend
    rate = (
        f"{number(factor * trend.rate, 3, '+')} ± {number(factor * trend.rate_std)} {unit} a month"
    )
    step = f"{number(factor * trend.step, 3, '+')} ± {number(factor * trend.step_std)} {unit}"
    when = date_text(t.dates[trend.step_at])[:10]
    before = date_text(t.dates[max(trend.step_at - 1, 0)])[:10]
    return {
        "drift": f"{joint.joint}: its zero drifts by {rate}.",
        "step": f"{joint.joint}: its zero has a step of {step} between {before} and {when}.",
        "change": f"{joint.joint}: its zero changed by {step} between {before} and {when}.",
        "unsteady": f"{joint.joint}: its zero scatters by more than the noise, without a drift or a single step.",
        "steady": f"{joint.joint}: its zero is steady ({rate}).",
    }[trend.shape]


def _joints(t: RobotTrend) -> Table:
    """Show each joint: what its zero does, its rate, and its best step."""
    columns = [
        name_column("joint"),
        Column("zero", left=True, gap=2),
        Column("rate", gap=2, note="Rates are in mrad (mm of a prismatic joint) a month."),
        Column("std"),
        Column("step", gap=2, note="Of each joint the best single step, found or not."),
        Column("std"),
        Column("on", left=True, gap=2),
        Column("p", left=True, gap=2),
    ]
    rows: list[Row] = []
    for joint in t.joints:
        trend = joint.trend
        if trend is None:
            rows.append((joint.joint, "cannot be seen", "-", "-", "-", "-", "-", "-"))
            continue
        _, factor = _SHOWN[joint.unit]
        figures = (trend.rate, trend.rate_std, trend.step, trend.step_std)
        shown = [factor * figure for figure in figures]
        when = date_text(t.dates[trend.step_at])[:10]
        rows.append((joint.joint, trend.shape, *shown, when, f"{trend.p:.1g}"))
    changed = [k for k, joint in enumerate(t.joints) if joint in t.changed]
    return Table("joint, mrad or mm", columns, rows, strong=changed)


def _results(t: RobotTrend) -> Table:
    """Show each result with the displacement of the target since the first one."""
    columns = [
        name_column("result"),
        Column("measured", left=True, gap=2),
        Column("verdict", left=True, gap=2),
        Column(
            "moved",
            unit="mm",
            gap=2,
            note="Rms over the joint values that both measured, without noise.",
        ),
        Column("std", unit="mm"),
        Column("since the first", left=True, gap=2),
    ]
    rows: list[Row] = []
    for k, (name, date, result) in enumerate(zip(t.names, t.dates, t.results, strict=True)):
        verdict = "none" if result.verdict is None else result.verdict.use
        moved, std, outcome = float("nan"), float("nan"), ""
        if k:
            comparison = t.comparisons[k - 1]
            moved, std = comparison.moves[0].moved, comparison.moves[0].std
            outcome = comparison.outcome
        rows.append((name, date_text(date)[:10], verdict, moved, std, outcome))
    return Table("result, mm", columns, rows)


def _zeros_drawing(t: RobotTrend) -> Drawing:
    """Return the figure of the joint zeros over time."""
    caption = (
        "Change of each joint's zero since the first result, with its standard deviation. A line is the rate, a dashed "
        "line the step; joints that are steady have neither. Joints whose zero cannot be told from the places of base "
        "and target are left out."
    )
    return Drawing(
        "zeros", "Joint zeros", "Joint zeros over time", caption, partial(_draw_zeros, t)
    )


def _draw_zeros(t: RobotTrend) -> Figure:
    """Draw the zeros of the joints that can be seen, a panel each."""
    seen = [joint for joint in t.joints if joint.trend is not None]
    rows = max((len(seen) + 1) // 2, 1)
    figure = new_figure(_PANEL * rows + 0.4)
    axes = np.atleast_1d(figure.subplots(rows, 2, sharex=True)).ravel()
    for ax, joint in zip(axes, seen, strict=False):
        unit, factor = _SHOWN[joint.unit]
        ax.errorbar(
            t.months, factor * joint.values, factor * joint.stds, fmt="o", color=INK, ms=3, lw=1
        )
        trend = joint.trend
        if trend is not None and trend.shape == "drift":
            weights = joint.stds**-2.0
            middle = np.average(t.months, weights=weights)
            mean = np.average(joint.values, weights=weights)
            ax.plot(t.months, factor * (mean + trend.rate * (t.months - middle)), color=OUTLIER)
        elif trend is not None and trend.shape in ("step", "change"):
            before = np.arange(len(t.months)) < trend.step_at
            weights = joint.stds**-2.0
            levels = np.where(
                before,
                np.average(joint.values[before], weights=weights[before]),
                np.average(joint.values[~before], weights=weights[~before]),
            )
            ax.plot(t.months, factor * levels, "--", color=OUTLIER, drawstyle="steps-mid")
        ax.set_title(joint.joint, fontsize="small")
        ax.set_ylabel(unit)
    for ax in axes[len(seen) :]:
        ax.set_visible(False)
    for ax in axes[-2:]:
        ax.set_xlabel(f"months since {date_text(t.dates[0])[:10]}")
    return figure


def _moves_drawing(t: RobotTrend) -> Drawing:
    """Return the figure of the target's displacement over time."""
    caption = (
        "Displacement of the target since the first result, rms over the joint values that both measured, without the "
        "part that noise explains, with its standard deviation."
    )
    return Drawing(
        "moves", "Displacement", "Displacement of the target", caption, partial(_draw_moves, t)
    )


def _draw_moves(t: RobotTrend) -> Figure:
    """Draw the displacement of the target in each result, and the tolerance."""
    figure = new_figure(2.2)
    ax = figure.subplots()
    moves = [comparison.moves[0] for comparison in t.comparisons]
    moved = [1e3 * move.moved for move in moves]
    stds = [1e3 * move.std for move in moves]
    ax.errorbar(t.months[1:], moved, stds, fmt="o-", color=CALIBRATED, ms=4, lw=1, label="moved")
    if t.tolerance is not None:
        ax.axhline(1e3 * t.tolerance, color=SOFT, ls="--", label="tolerance")
    ax.set_xlabel(f"months since {date_text(t.dates[0])[:10]}")
    ax.set_ylabel("mm rms")
    ax.set_xlim(left=0.0)
    ax.set_ylim(bottom=0.0)
    legend_above(figure)
    return figure


def _notes(t: RobotTrend) -> Iterator[str]:
    """Yield caveats of a trend, in sentences."""
    unseen = [joint.joint for joint in t.joints if joint.trend is None]
    if unseen:
        yield (
            f"A change of the zero of {choices(unseen)} looks like one of the places of base or target, which were "
            "estimated: it cannot be seen."
        )
    if t.changed:
        yield (
            "A changed length, or a changed angle between two axes, looks like one of the zeros here: calib compare of "
            "two results tells them apart."
        )
    if not any(unknown_frame(result) for result in t.results):
        yield "All take the measurement frame as known: its error looks like a drift of the first joints."
    serials = dict.fromkeys(filter(None, (result.record.robot_serial for result in t.results)))
    if len(serials) > 1:
        yield f"The records name several robots, of the serial numbers {choices(serials)}."
    if len(set(t.dates)) < len(t.dates):
        yield "Some results are of the same date."
    untold = [c for c in t.comparisons if c.outcome == "cannot tell"]
    if untold:
        yield (
            f"Whether the robot drifted cannot be told from {plural(len(untold), 'result')} (the verdict, the same "
            "measurements, or other errors): calib compare of the first and that one says why."
        )
    if t.tolerance is not None:
        yield f"A displacement within {mm(t.tolerance)} mm means its value and twice its standard deviation."
