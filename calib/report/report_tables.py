"""The tables of a report: errors by set and by row, parameters, geometry, joint ranges, models tried."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.model.dh import DHRow, DHTable, dh_table
from calib.report.label_rows import angles_of, lengths_of
from calib.result.calibration import Calibration
from calib.robot.robot import read_only, rigid_inverse
from calib.text.summary import (
    candidate_rms,
    error_rows,
    error_title,
    errorless,
    larger_parameters,
    left_out_text,
    shown_parameters,
)

Array = NDArray[np.float64]

#: More rows for validation than this are not all listed: the worst of them are, so many. More outliers are counted.
_MOST_ROWS, _WORST, _MOST_OUTLIERS = 40, 20, 40

#: A frame that moved by less has not [m or rad].
_NOTHING = 1e-9

#: A joint value beyond a limit by less is at it: tables and URDFs round [m or rad].
_EXACT = 1e-4


@dataclass(frozen=True, slots=True)
class Table:
    """A table, all of its cells as text.

    ``align`` is ``l`` (text) or ``r`` (numbers) for each column; ``groups`` are labels above the head, each with the
    number of columns it spans; ``strong`` are the rows that matter most. A table without rows is not shown.
    """

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    align: str
    note: str = ""
    groups: Sequence[tuple[str, int]] = ()
    strong: Sequence[int] = ()


def errors(c: Calibration, *, turned: bool = False) -> Table:
    """Errors by set of rows: of positions and lengths [mm], or of orientations [deg]."""
    rows, before = [], ""
    for label, e in error_rows(c):
        # Each label needs no look at the row above.
        rest = label.strip().removeprefix("the same ")
        before = label if rest == label else f"{before}, {rest}"
        if e.n_angle if turned else e.n:
            rows.append((before, e))
    strong = [k for k, (label, _) in enumerate(rows) if ", calibrated" in label]
    head = ("rows, robot", "number", "max", "mean", "rms")
    if turned:
        cells = [
            (label, f"{e.n_angle:,}", *map(deg, (e.max_angle, e.mean_angle, e.rms_angle)))
            for label, e in rows
        ]
        title = "Orientation error by set of rows [deg]"
        return Table(title, head, cells, "lrrrr", note=left_out_text(c), strong=strong)
    along = any(np.any(np.isfinite(e.span_axis)) for _, e in rows)
    axes = 3 if along else 0
    notes = [f"{left_out_text(c)}."] * bool(left_out_text(c))
    notes += ["Span: largest minus smallest signed error along an axis of the frame."] * along
    return Table(
        f"{error_title(c.used)} by set of rows [mm]",
        (*head, *"xyz"[:axes]),
        [
            (label, f"{e.n:,}", *map(mm, (e.max, e.mean, e.rms, *e.span_axis[:axes])))
            for label, e in rows
        ],
        "lrrrr" + "r" * axes,
        note=" ".join(notes),
        groups=[("", 2), ("size of the error", 3), *[("span", 3)] * along],
        strong=strong,
    )


def validation_rows(c: Calibration) -> Table:
    """Errors of single validation rows before and after, as in the paper's Table 4."""
    m = c.measurements
    chosen = np.flatnonzero(m.validation & np.any(c.used, axis=1))
    which = f"the {len(chosen):,} validation rows"
    if len(chosen) > _MOST_ROWS:
        size = np.nan_to_num(lengths_of(c.residual_calibrated, c.used)[chosen])
        which = f"the {_WORST} of {len(chosen):,} validation rows with the largest error after calibration"
        chosen = chosen[np.sort(np.argsort(-size, kind="stable")[:_WORST])]
    used = c.used[chosen]
    labels, names = _places(c, chosen)
    columns, head, cells = [("", len(names))], [*names], [list(row) for row in labels]
    whole = np.all(used[:, :3], axis=1) & (used.shape[1] >= 3)
    along = bool(np.any(whole))
    both = (
        ("before: nominal [mm]", c.residual_nominal),
        ("after: calibrated [mm]", c.residual_calibrated),
    )
    for who, residual in both if np.any(used[:, :3]) else ():
        columns.append((who, 4 if along else 1))
        head += [*("dx", "dy", "dz") * along, "size"]
        size = lengths_of(residual, c.used)
        for row, i, axes in zip(cells, chosen, whole, strict=True):
            row += [mm(v) if axes else "-" for v in residual[i, :3]] * along + [mm(size[i])]
    if np.any(used[:, 3:]):
        columns.append(("angle [deg]", 2))
        head += ["before", "after"]
        for _, residual in both:
            for row, angle in zip(cells, angles_of(residual, c.used)[chosen], strict=True):
                row.append(deg(angle))
    note = "dx, dy, dz: measured minus predicted along the axes of the measurement frame."
    return Table(
        f"Error of {which}, which took no part in the fit",
        head,
        cells,
        "l" * len(names) + "r" * (len(head) - len(names)),
        groups=columns,
        note=note * along,
    )


def flagged(c: Calibration) -> Table:
    """The rows flagged, with their errors before and after."""
    m = c.measurements
    place = {row: i for i, row in enumerate(m.rows)}
    every = [*c.outliers, *c.suspects]
    shown = every[:_MOST_OUTLIERS]
    indices = np.array([place[o.row] for o in shown], dtype=np.int_)
    labels, names = _places(c, indices)
    sizes = [lengths_of(r, c.used) for r in (c.residual_nominal, c.residual_calibrated)]
    rest = len(every) - len(shown)
    more = f" {rest} more are in the result file (--json)." if rest else ""
    return Table(
        "Rows flagged",
        (*names, "set", "before [mm]", "after [mm]", "score", "weight"),
        [
            (
                *label,
                m.sets[i],
                *(mm(size[i]) for size in sizes),
                f"{one.score:.1f}" if np.isfinite(one.score) else "-",
                f"{c.weights[i]:.2f}",
            )
            for one, i, label in zip(shown, indices, labels, strict=True)
        ],
        "l" * len(names) + "lrrrr",
        note="Score: distance from what the other rows predict, in standard deviations. Estimation rows are flagged "
        f"beyond {c.flag_limit:.1f}.{more}",
    )


def parameters(c: Calibration, unit: str) -> Table:
    """Nominal value, correction and interval of the parameters in ``"mm"`` or ``"deg"``."""
    text, none = (mm if unit == "mm" else deg), errorless(c)
    rows = []
    for p in shown_parameters(c):
        if (p.unit == "m") != (unit == "mm"):
            continue
        kept = p.name in none
        given = p.nominal is not None
        change = signed(text(p.delta)) if given else "-"
        half = "-" if p.at_bound or kept else text(0.5 * (p.high - p.low))
        word = "at bound" if p.at_bound else "yes" if p.identifiable else "jointly"
        nominal = text(p.nominal) if p.nominal is not None else "-"
        rows.append((p.name, nominal, text(p.value), change, half, "kept" if kept else word))
    return Table(
        f"{'Lengths' if unit == 'mm' else 'Angles'} [{unit}]",
        ("parameter", "nominal", "calibrated", "correction", "95 % ±", "determined"),
        rows,
        "lrrrrl",
    )


def larger(c: Calibration) -> Table:
    """The parameters that no URDF can hold."""
    name = "" if c.larger is None else c.larger.name
    return Table(
        f"Larger model '{name}': in the result file, not in the URDF",
        ("parameter", "value", "95 % interval", "unit"),
        [(name, value, half.strip("()"), unit) for name, value, half, unit in larger_parameters(c)],
        "lrrl",
    )


def dh(c: Calibration) -> Table:
    """The DH rows of the nominal and of the calibrated robot."""
    before = dh_table(c.nominal)
    after = _turned_like(before, dh_table(c.robot))
    tilted = any(row.near_parallel for row in (*before.rows, *after.rows))
    note = "Standard convention: Rz(theta + q) Tz(d) Tx(a) Rx(alpha)"
    hayati = " Ry(beta), with Hayati's beta between nearly parallel axes, where d is 0."
    note += hayati if tilted else "."
    note += " The rows are read off both URDFs: they give the same poses as the URDFs do."
    for what, T, S in (
        ("Frame 0", before.T_base_0, after.T_base_0),
        ("The tip after the last row", before.T_n_tip, after.T_n_tip),
    ):
        D = rigid_inverse(T) @ S
        moved = float(np.linalg.norm(D[:3, 3]))
        turned = float(np.linalg.norm(pin.log3(D[:3, :3])))
        if moved > _NOTHING or turned > _NOTHING:
            note += f" {what} moved by {mm(moved)} mm and {deg(turned)} deg, which no row shows."
    head = ("joint", "robot", "a [mm]", "alpha [deg]", "d [mm]", "theta [deg]", "beta [deg]")
    columns = 7 if tilted else 6
    return Table(
        "DH rows before and after",
        head[:columns],
        [
            line[:columns]
            for rows in zip(before.rows, after.rows, strict=True)
            for line in _dh_lines(*rows)
        ],
        "llrrrrr"[:columns],
        note=note,
        strong=tuple(range(2, 3 * len(before.rows), 3)),
    )


def origins(c: Calibration) -> Table:
    """The displacement of each origin that changed, in its nominal frame."""
    after, cells = c.robot.origins(), []
    for joint, T in c.nominal.origins().items():
        D = rigid_inverse(T) @ after[joint]
        twist = np.concatenate([D[:3, 3], pin.log3(D[:3, :3])])
        if np.abs(twist).max() > _NOTHING:  # mrad have as many figures as mm
            cells.append((joint, *(signed(mm(v)) for v in twist)))
    return Table(
        "How far each <origin> of the corrected URDF is from the nominal one",
        ("joint", "x", "y", "z", "rx", "ry", "rz"),
        cells,
        "lrrrrrr",
        groups=(("", 1), ("shift [mm]", 3), ("rotation vector [mrad]", 3)),
        note="Along and about the axes of the nominal origin. All else in the URDF is unchanged.",
    )


def candidates(c: Calibration) -> Table:
    """The models that were tried."""
    best = max(one.log_likelihood for one in c.candidates)
    first = c.candidates[0].cross_validation.errors_without_outliers
    words = {"geometry": "the URDF", "larger": "result file"}
    return Table(
        "Models tried; errors on rows left out of the fit",
        ("model", "parameters", "evidence", "left-out rms", "chosen for"),
        [
            (
                one.name,
                str(one.parameters),
                f"{one.log_likelihood - best:.1f}",
                candidate_rms(one),
                words.get(one.chosen, ""),
            )
            for one in c.candidates
        ],
        "lrrrl",
        note="Evidence: restricted log likelihood, less the best one's (no unit); a step up must gain "
        f"{c.candidates[0].needed:.1f}. Left-out rms: of the {first.n or first.n_angle:,} estimation rows that had a "
        "weight when the models were compared, each predicted by a linearised fit without it. The errors in section 2 "
        "are those of whole fits of the chosen model.",
    )


def ranges(c: Calibration) -> Table:
    """Joint values of the estimation rows beside the limits."""
    m = c.measurements
    q = m.joints_for(c.nominal.joint_names)[m.estimation]
    cells, beyond = [], []
    for joint, values in zip(c.nominal.inputs, q.T, strict=True):
        slides = joint.type == "prismatic"
        scale, unit = (1e3, "mm") if slides else (float(np.degrees(1.0)), "deg")
        low, high = float(values.min()), float(values.max())
        limits = ["-" if v is None else f"{scale * v:.2f}" for v in (joint.lower, joint.upper)]
        share = "-"
        if joint.lower is not None and joint.upper is not None and joint.upper > joint.lower:
            inside = max(0.0, min(high, joint.upper) - max(low, joint.lower))
            share = f"{100.0 * inside / (joint.upper - joint.lower):.0f} %"
            if low < joint.lower - _EXACT or high > joint.upper + _EXACT:
                beyond.append(f"'{joint.name}'")
        measured = [f"{scale * low:.2f}", f"{scale * high:.2f}"]
        cells.append((joint.name, unit, *measured, *limits, share))
    return Table(
        "Joint values of the estimation rows",
        ("joint", "unit", "lowest", "highest", "lower", "upper", "used"),
        cells,
        "llrrrrr",
        groups=(("", 2), ("measured", 2), ("limit", 2), ("", 1)),
        note="Used: share of the range between the limits. Beyond what was measured errors may be larger."
        + (f" Measured beyond the limits of the URDF: {', '.join(beyond)}." if beyond else ""),
    )


def _places(c: Calibration, chosen: NDArray[np.int_]) -> tuple[list[tuple[str, ...]], list[str]]:
    """What tells rows apart: their numbers, and their kinds, targets and set-ups where there are several."""
    m = c.measurements
    columns: list[tuple[str, Sequence[object]]] = [("row", m.rows)]
    more = (("kind", m.kinds), ("target", m.targets), ("set-up", m.groups))
    columns += [(name, values) for name, values in more if len(set(values)) > 1]
    labels = [tuple(str(values[i]) for _, values in columns) for i in chosen]
    return labels, [name for name, _ in columns]


def _turned_like(before: DHTable, after: DHTable) -> DHTable:
    """The same geometry with each x axis on the side of the other table's, or rows that hardly differ seem to.

    Half a turn of frame i about its z: A_i Rz(pi) = Rz(theta + pi) Tz(d) Tx(-a) Rx(-alpha) Ry(-beta).
    """
    rows, turned = [], 0.0
    for old, new in zip(before.rows, after.rows, strict=True):
        theta = new.theta - turned
        turned = np.pi if np.cos(theta - old.theta) < 0.0 else 0.0
        sign = -1.0 if turned else 1.0
        a, alpha, beta = (sign * v + 0.0 for v in (new.a, new.alpha, new.beta))
        rows.append(replace(new, theta=_wrapped(theta + turned), a=a, alpha=alpha, beta=beta))
    half = np.diag([-1.0, -1.0, 1.0, 1.0]) if turned else np.eye(4)
    return DHTable(tuple(rows), after.T_base_0, read_only(half @ after.T_n_tip))


def _wrapped(angle: float) -> float:
    """An angle between -pi and pi."""
    return float(np.arctan2(np.sin(angle), np.cos(angle)))


def _dh_lines(before: DHRow, after: DHRow) -> Iterator[tuple[str, ...]]:
    """The row before, after, and the difference; none where the rows follow different conventions."""
    for name, who, row in ((before.joint, "nominal", before), ("", "calibrated", after)):
        yield name, who, mm(row.a), deg(row.alpha), mm(row.d), deg(row.theta), deg(row.beta)
    if before.near_parallel != after.near_parallel:
        yield "", "change", *("-",) * 5
        return
    a, d = (signed(mm(b - a)) for a, b in ((before.a, after.a), (before.d, after.d)))
    old, new = ((row.alpha, row.theta, row.beta) for row in (before, after))
    turns = [signed(deg(_wrapped(b - a))) for a, b in zip(old, new, strict=True)]
    yield "", "change", a, turns[0], d, turns[1], turns[2]


def mm(length: float) -> str:
    """A length in mm with three figures after the point."""
    return f"{round(1e3 * length, 3) + 0.0:.3f}" if np.isfinite(length) else "-"


def deg(angle: float) -> str:
    """An angle in degrees with four figures after the point."""
    return f"{round(float(np.degrees(angle)), 4) + 0.0:.4f}" if np.isfinite(angle) else "-"


def signed(number: str) -> str:
    """A number with its sign, zero apart."""
    return number if number.startswith("-") or not float(number) else f"+{number}"
