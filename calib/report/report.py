"""The report of a calibration: verdict first, then errors before and after, figures, parameters, and how it came about.

One HTML page, ``report.html.j2`` filled in: figures inside, no script, nothing from the network; it prints on A4.
"""

from __future__ import annotations

import base64
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import calib.text.summary as texts
from calib.data.kinds import get as kind_named
from calib.diagnosis.reasons import Why
from calib.errors import FileError
from calib.files import write_atomically
from calib.model.dh import DHRow
from calib.model.dh_table import dh_table
from calib.numerics.intervals import interval_factor
from calib.report.figure_base import angles_of, lengths_of
from calib.result.calibration import CalibrationValues
from calib.result.calibration_file import versions
from calib.robot.robot import rigid_inverse
from calib.text.layout.lines import deg, mm, number
from calib.text.places import frame_sentences, target_sentences
from calib.text.verdict import outside_text, reason_text, robustness_text

if TYPE_CHECKING:
    from calib.report.figures import Drawing


#: A drawing with more bytes than this as SVG goes in as PNG.
_LARGE = 260_000

#: A longer word in a table is broken anywhere: it would push its table off the page.
_LONGEST_WORD = 24

#: More targets, set-ups, combinations of parameters or flagged rows than this are counted; of more rows for validation
#: the worst are listed, so many.
_MOST, _WORST = 40, 20

#: An angle with four figures after the point; factor and figures of a, alpha, d, theta and beta.
_deg = partial(deg, digits=4)
_DH = tuple(
    (1e3, 3) if of == "mm" else (180.0 / np.pi, 4) for of in ("mm", "deg", "mm", "deg", "deg")
)


def write_report(
    calibration: CalibrationValues, path: str | Path, *, command: str = "", overwrite: bool = False
) -> Path:
    """Write the report as a page.

    ``command`` made the calibration, as it was typed; empty where there was none.

    Raises:
        FileError: The name does not end in .html, the file exists, or it cannot be written.
    """
    check_ending(path)
    return write_atomically(path, report_bytes(calibration, command=command), overwrite=overwrite)


def check_ending(path: str | Path) -> None:
    """Refuse a name that does not end in .html or .htm."""
    if Path(path).suffix.lower() not in (".html", ".htm"):
        raise FileError(
            f"'{path}': a report is a page; let the name end in .html. The summary is its text."
        )


def report_bytes(calibration: CalibrationValues, *, command: str = "") -> bytes:
    """The page, UTF-8. Nothing but its date, now or ``SOURCE_DATE_EPOCH``, differs between two of a calibration."""
    import jinja2

    from calib.report.figures import drawings

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.tests["long"] = lambda text: any(len(w) > _LONGEST_WORD for w in text.split())
    epoch = os.environ.get("SOURCE_DATE_EPOCH", "")
    now = datetime.now(timezone.utc)
    when = datetime.fromtimestamp(int(epoch), timezone.utc) if epoch.isdecimal() else now
    content = _content(calibration, command, f"{when:%Y-%m-%d %H:%M} UTC")
    content["figures"] = [(one, _picture(one)) for one in drawings(calibration)]
    page = environment.get_template("report.html.j2").render(**content)
    return page.encode("utf-8", "replace")


def _picture(drawing: Drawing) -> str:
    """The figure as a data address, lines as SVG and as PNG where that would be large."""
    from calib.report.figures import rendered

    media, data = "svg+xml", rendered(drawing, "svg")
    if len(data) > _LARGE:
        media, data = "png", rendered(drawing, "png")
    return f"data:image/{media};base64,{base64.b64encode(data).decode('ascii')}"


def _content(c: CalibrationValues, command: str, date: str) -> dict[str, Any]:
    """What the template is filled with: texts, pairs of texts, and what makes its tables."""
    m, T = c.measurements, c.T_frame_base
    reasons = c.verdict.reasons if c.verdict else ()
    # Validation rows beyond the joint values that were fitted, where the verdict does not name them.
    named = any(reason.why == Why.OUTSIDE for reason in reasons)
    every = [texts.combination_text(one) for one in c.observability.unidentifiable]
    tables = errors, validation_rows, parameters, non_geometric, dh, origins, flagged, ranges
    return {
        "c": c,
        "texts": texts,
        "known": texts.facts(c),
        "date": date,
        "command": command or "not from the command line",
        "source": m.source or "from memory",
        "rows_text": f"{m.estimation.sum():,} to estimate, {m.validation.sum():,} to validate",
        "reasons": [reason_text(one) for one in reasons],
        "robustness": robustness_text(c.robustness) if c.robustness else "",
        "unweighted": int(np.sum(c.weights[m.estimation] <= 0.0)),
        "factor": f"{interval_factor(c.fitted.estimate.freedom):.2f}",
        **{make.__name__: make for make in tables},
        "places": [*target_sentences(c, _MOST), *frame_sentences(c, _MOST)],
        "combinations": every[:_MOST] + [f"and {len(every) - _MOST} more"] * (len(every) > _MOST),
        "kinds": "; ".join(
            f"{kind_named(k).words} ({n:,} rows)" for k, n in Counter(m.kinds).items()
        ),
        "at": ", ".join(map(mm, T[:3, 3])),
        "rpy": ", ".join(map(deg, pin.rpy.matrixToRpy(T[:3, :3]))),
        "held": ", ".join(f"{name} at {value:.6g}" for name, value in c.cell.held.items()),
        "outside": ""
        if named
        else outside_text(c.outside, np.array(m.rows)[m.validation].tolist()),
        "versions": ", ".join(f"{name} {version}" for name, version in versions().items()),
    }


class Table(NamedTuple):
    """A table, all of its cells as text; without rows it is not shown.

    ``align`` is ``l`` (text) or ``r`` (numbers) for each column; ``groups`` are labels above the head, each with the
    number of columns it spans; ``strong`` are the rows that matter most.
    """

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    align: str
    note: str = ""
    groups: Sequence[tuple[str, int]] = ()
    strong: Sequence[int] = ()


def errors(c: CalibrationValues, *, turned: bool = False) -> Table:
    """Errors by set of rows: of positions and lengths [mm], or of orientations [deg]."""
    cells: list[tuple[str, ...]] = []
    strong, before, every = [], "", texts.error_rows(c)
    along = not turned and any(np.any(np.isfinite(e.span_axis)) for _, e in every if e.n)
    for label, e in every:
        # Each label needs no look at the row above.
        rest = label.strip().removeprefix("the same ")
        before = label if rest == label else f"{before}, {rest}"
        values = (e.max_angle, e.mean_angle, e.rms_angle) if turned else (e.max, e.mean, e.rms)
        spans = e.span_axis if along else ()
        if count := e.n_angle if turned else e.n:
            strong += [len(cells)] * (", calibrated" in before)
            cells.append((before, f"{count:,}", *map(_deg if turned else mm, (*values, *spans))))
    notes = [f"{texts.held_out_text(c)}."] * (c.cross_validation is not None)
    notes += ["Span: largest minus smallest signed error along an axis of the frame."] * along
    what = "Orientation error by set of rows [deg]"
    return Table(
        what if turned else f"{texts.error_title(c.used)} by set of rows [mm]",
        ("rows, robot", "number", "max", "mean", "rms", *"xyz"[: 3 * along]),
        cells,
        "lrrrr" + "rrr" * along,
        " ".join(notes),
        [("", 2), ("size of the error", 3), *[("span", 3)] * along],
        strong,
    )


def validation_rows(c: CalibrationValues) -> Table:
    """Errors of single validation rows before and after, as in the paper's Table 4."""
    chosen = np.flatnonzero(c.measurements.validation & np.any(c.used, axis=1))
    which = f"the {len(chosen):,} validation rows"
    if len(chosen) > _MOST:
        size = np.nan_to_num(lengths_of(c.residual_calibrated, c.used)[chosen])
        which = f"the {_WORST} of {len(chosen):,} validation rows with the largest error after calibration"
        chosen = chosen[np.sort(np.argsort(-size, kind="stable")[:_WORST])]
    names, cells = _places(c, chosen)
    used, groups, head = c.used[chosen], [("", len(names))], list(names)
    whole = np.all(used[:, :3], axis=1, keepdims=True) & (used.shape[1] >= 3)
    axes = ("dx", "dy", "dz") if np.any(whole) else ()
    both = ("before: nominal", c.residual_nominal), ("after: calibrated", c.residual_calibrated)
    for who, residual in both if np.any(used[:, :3]) else ():
        groups.append((f"{who} [mm]", len(axes) + 1))
        head += [*axes, "size"]
        parts = np.where(whole, residual[chosen, :3], np.nan)[:, : len(axes)]
        for row, part, size in zip(cells, parts, lengths_of(residual, c.used)[chosen], strict=True):
            row += map(mm, (*part, size))
    if np.any(used[:, 3:]):
        groups.append(("angle [deg]", 2))
        head += ["before", "after"]
        for _, residual in both:
            for row, angle in zip(cells, angles_of(residual, c.used)[chosen], strict=True):
                row.append(_deg(angle))
    note = "dx, dy, dz: measured minus predicted along the axes of the measurement frame."
    align = "l" * len(names) + "r" * (len(head) - len(names))
    title = f"Error of {which}, which took no part in the fit"
    return Table(title, head, cells, align, note if axes else "", groups)


def flagged(c: CalibrationValues) -> Table:
    """The rows flagged, with their errors before and after."""
    m, every = c.measurements, [*c.outliers, *c.suspects]
    indices = np.array([m.rows.index(one.row) for one in every[:_MOST]], dtype=np.int_)
    names, cells = _places(c, indices)
    prior_std = [lengths_of(r, c.used) for r in (c.residual_nominal, c.residual_calibrated)]
    for one, i, row in zip(every, indices, cells, strict=False):
        row += [m.sets[i], *(mm(size[i]) for size in prior_std)]
        row += [number(one.score, 1), f"{c.weights[i]:.2f}"]
    rest = len(every) - len(cells)
    more = f" {rest} more are in the result file (--json)." if rest else ""
    return Table(
        "Rows flagged",
        (*names, "set", "before [mm]", "after [mm]", "score", "weight"),
        cells,
        "l" * len(names) + "lrrrr",
        "Score: distance from what the other rows predict, in standard deviations. Estimation rows are flagged "
        f"beyond {c.flag_limit:.1f}.{more}",
    )


def parameters(c: CalibrationValues, unit: str) -> Table:
    """Nominal value, correction and interval of the parameters in ``"mm"`` or ``"deg"``."""
    scale, digits = (1e3, 3) if unit == "mm" else (float(np.degrees(1.0)), 4)
    none, rows = texts.errorless(c), []
    for p in texts.shown_parameters(c):
        if (p.unit == "m") == (unit == "mm"):
            kept = p.name in none
            half = np.nan if p.at_bound or kept else 0.5 * (p.high - p.low)
            nominal, change = (p.nominal, p.delta) if p.nominal is not None else (np.nan, np.nan)
            cells = [number(scale * value, digits) for value in (nominal, p.value)]
            cells += [number(scale * change, digits, "+"), number(scale * half, digits)]
            word = "at bound" if p.at_bound else "yes" if p.identifiable else "jointly"
            rows.append((p.name, *cells, "kept" if kept else word))
    title = f"{'Lengths' if unit == 'mm' else 'Angles'} [{unit}]"
    head = ("parameter", "nominal", "calibrated", "correction", "95 % ±", "determined")
    return Table(title, head, rows, "lrrrrl")


def non_geometric(c: CalibrationValues) -> Table:
    """The parameters that no URDF can hold."""
    every = texts.non_geometric_parameters(c)
    return Table(
        f"Non-geometric model '{c.non_geometric.name if c.non_geometric else ''}': in the result file, not in the URDF",
        ("parameter", "value", "95 % interval", "unit"),
        [(name, value, half.strip("()"), unit) for name, value, half, unit in every],
        "lrrl",
    )


def dh(c: CalibrationValues) -> Table:
    """The DH rows of the nominal and of the calibrated robot."""
    before, after = dh_table(c.nominal).rows, dh_table(c.robot, like=c.nominal).rows
    tilted = any(row.near_parallel for row in (*before, *after))
    hayati = " Ry(beta), with Hayati's beta between nearly parallel axes, where d is 0" * tilted
    head = ("joint", "robot", "a [mm]", "alpha [deg]", "d [mm]", "theta [deg]", "beta [deg]")
    columns = 6 + tilted
    pairs = zip(before, after, strict=True)
    return Table(
        "DH rows before and after",
        head[:columns],
        [line[:columns] for pair in pairs for line in _dh_lines(*pair)],
        "llrrrrr"[:columns],
        f"Standard convention: Rz(theta + q) Tz(d) Tx(a) Rx(alpha){hayati}. The rows are read off both URDFs; frame 0 "
        "and the tip after the last row may have moved too, which the next table shows.",
        strong=range(2, 3 * len(before), 3),
    )


def _dh_lines(before: DHRow, after: DHRow) -> Iterator[tuple[str, ...]]:
    """The row before, after, and the difference; none where the rows follow different conventions."""
    b, a = (np.array([r.a, r.alpha, r.d, r.theta, r.beta]) for r in (before, after))
    change = a - b
    change[[1, 3, 4]] = np.angle(np.exp(1j * change[[1, 3, 4]]))
    change *= np.nan if before.near_parallel != after.near_parallel else 1.0
    for name, who, values, sign in (
        (before.joint, "nominal", b, "-"),
        ("", "calibrated", a, "-"),
        ("", "change", change, "+"),
    ):
        yield name, who, *(number(u * v, n, sign) for v, (u, n) in zip(values, _DH, strict=True))


def origins(c: CalibrationValues) -> Table:
    """The displacement of each origin that changed, in its nominal frame."""
    after, rows = c.robot.origins(), []
    for joint, T in c.nominal.origins().items():
        D = rigid_inverse(T) @ after[joint]
        twist = np.concatenate([D[:3, 3], pin.log3(D[:3, :3])])
        if np.abs(twist).max() > 1e-9:  # mrad have as many figures as mm
            rows.append((joint, *(number(1e3 * v, 3, "+") for v in twist)))
    return Table(
        "How far each <origin> of the corrected URDF is from the nominal one",
        ("joint", "x", "y", "z", "rx", "ry", "rz"),
        rows,
        "lrrrrrr",
        "Along and about the axes of the nominal origin. All else in the URDF is unchanged.",
        (("", 1), ("shift [mm]", 3), ("rotation vector [mrad]", 3)),
    )


def ranges(c: CalibrationValues) -> Table:
    """Joint values of the estimation rows beside the limits."""
    m = c.measurements
    q, cells = m.joints_for(c.nominal.joint_names)[m.estimation], []
    for joint, values in zip(c.nominal.inputs, q.T, strict=True):
        scale, unit = (1e3, "mm") if joint.type == "prismatic" else (float(np.degrees(1.0)), "deg")
        ends = [values.min(), values.max(), joint.lower, joint.upper]
        low, high, lower, upper = (np.nan if value is None else value for value in ends)
        inside = max(0.0, min(high, upper) - max(low, lower))
        share = number(100.0 * inside / (upper - lower), 0) if upper > lower else "-"
        shown = [number(scale * value, 2) for value in (low, high, lower, upper)]
        cells.append((joint.name, unit, *shown, share))
    return Table(
        "Joint values of the estimation rows",
        ("joint", "unit", "lowest", "highest", "lower", "upper", "used [%]"),
        cells,
        "llrrrrr",
        "Used: share of the range between the limits. Beyond what was measured errors may be larger.",
        (("", 2), ("measured", 2), ("limit", 2), ("", 1)),
    )


def _places(c: CalibrationValues, chosen: NDArray[np.int_]) -> tuple[list[str], list[list[str]]]:
    """What tells rows apart, heads and cells: numbers, and kinds, targets and set-ups where there are several."""
    m = c.measurements
    columns: list[tuple[str, Sequence[object]]] = [("row", m.rows)]
    more = (("kind", m.kinds), ("target", m.targets), ("set-up", m.groups))
    columns += [(name, values) for name, values in more if len(set(values)) > 1]
    cells = [[str(values[i]) for _, values in columns] for i in chosen]
    return [name for name, _ in columns], cells
