"""The tables of a report: errors by set and by row, parameters, geometry, joint ranges, models tried."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.model.dh import dh_table
from calib.model.dh_table import DHRow
from calib.report.figure_base import angles_of, lengths_of
from calib.result.calibration import Calibration
from calib.robot.robot import rigid_inverse
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


def mm(length: float) -> str:
    """A length in mm with three figures after the point."""
    return f"{round(1e3 * length, 3) + 0.0:.3f}" if np.isfinite(length) else "-"


def deg(angle: float) -> str:
    """An angle in degrees with four figures after the point."""
    return f"{round(float(np.degrees(angle)), 4) + 0.0:.4f}" if np.isfinite(angle) else "-"


def signed(number: str) -> str:
    """A number with its sign, zero apart."""
    return number if number.startswith("-") or not float(number) else f"+{number}"


def errors(c: Calibration, *, turned: bool = False) -> Table:
    """Errors by set of rows: of positions and lengths [mm], or of orientations [deg]."""
    rows, before = [], ""
    for label, e in error_rows(c):
        # Each label needs no look at the row above.
        rest = label.strip().removeprefix("the same ")
        before = label if rest == label else f"{before}, {rest}"
        if e.n_angle if turned else e.n:
            rows.append((before, e))
    along = not turned and any(np.any(np.isfinite(e.span_axis)) for _, e in rows)
    cells = [
        (label, f"{e.n_angle:,}", *map(deg, (e.max_angle, e.mean_angle, e.rms_angle)))
        if turned
        else (label, f"{e.n:,}", *map(mm, (e.max, e.mean, e.rms, *e.span_axis[: 3 * along])))
        for label, e in rows
    ]
    notes = [f"{left_out_text(c)}."] * bool(left_out_text(c))
    notes += ["Span: largest minus smallest signed error along an axis of the frame."] * along
    what = "Orientation error by set of rows [deg]"
    return Table(
        what if turned else f"{error_title(c.used)} by set of rows [mm]",
        ("rows, robot", "number", "max", "mean", "rms", *"xyz"[: 3 * along]),
        cells,
        "lrrrr" + "rrr" * along,
        " ".join(notes),
        [("", 2), ("size of the error", 3), *[("span", 3)] * along],
        [k for k, (label, _) in enumerate(rows) if ", calibrated" in label],
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
    names, cells = _places(c, chosen)
    groups, head = [("", len(names))], list(names)
    whole = np.all(used[:, :3], axis=1) & (used.shape[1] >= 3)
    along = bool(np.any(whole))
    both = ("before: nominal", c.residual_nominal), ("after: calibrated", c.residual_calibrated)
    for who, residual in both if np.any(used[:, :3]) else ():
        groups.append((f"{who} [mm]", 4 if along else 1))
        head += [*("dx", "dy", "dz") * along, "size"]
        size = lengths_of(residual, c.used)
        for row, i, axes in zip(cells, chosen, whole, strict=True):
            row += [mm(v) if axes else "-" for v in residual[i, :3]] * along + [mm(size[i])]
    if np.any(used[:, 3:]):
        groups.append(("angle [deg]", 2))
        head += ["before", "after"]
        for _, residual in both:
            for row, angle in zip(cells, angles_of(residual, c.used)[chosen], strict=True):
                row.append(deg(angle))
    note = "dx, dy, dz: measured minus predicted along the axes of the measurement frame."
    align = "l" * len(names) + "r" * (len(head) - len(names))
    title = f"Error of {which}, which took no part in the fit"
    return Table(title, head, cells, align, note * along, groups)


def flagged(c: Calibration) -> Table:
    """The rows flagged, with their errors before and after."""
    m, every = c.measurements, [*c.outliers, *c.suspects]
    shown = every[:_MOST_OUTLIERS]
    indices = np.array([m.rows.index(one.row) for one in shown], dtype=np.int_)
    names, cells = _places(c, indices)
    sizes = [lengths_of(r, c.used) for r in (c.residual_nominal, c.residual_calibrated)]
    for one, i, row in zip(shown, indices, cells, strict=True):
        score = f"{one.score:.1f}" if np.isfinite(one.score) else "-"
        row += [m.sets[i], *(mm(size[i]) for size in sizes), score, f"{c.weights[i]:.2f}"]
    rest = len(every) - len(shown)
    more = f" {rest} more are in the result file (--json)." if rest else ""
    return Table(
        "Rows flagged",
        (*names, "set", "before [mm]", "after [mm]", "score", "weight"),
        cells,
        "l" * len(names) + "lrrrr",
        "Score: distance from what the other rows predict, in standard deviations. Estimation rows are flagged "
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
        half = "-" if p.at_bound or kept else text(0.5 * (p.high - p.low))
        word = "at bound" if p.at_bound else "yes" if p.identifiable else "jointly"
        nominal, change = (
            ("-", "-") if p.nominal is None else (text(p.nominal), signed(text(p.delta)))
        )
        rows.append((p.name, nominal, text(p.value), change, half, "kept" if kept else word))
    title = f"{'Lengths' if unit == 'mm' else 'Angles'} [{unit}]"
    head = ("parameter", "nominal", "calibrated", "correction", "95 % ±", "determined")
    return Table(title, head, rows, "lrrrrl")


def larger(c: Calibration) -> Table:
    """The parameters that no URDF can hold."""
    return Table(
        f"Larger model '{c.larger.name if c.larger else ''}': in the result file, not in the URDF",
        ("parameter", "value", "95 % interval", "unit"),
        [(name, value, half.strip("()"), unit) for name, value, half, unit in larger_parameters(c)],
        "lrrl",
    )


def dh(c: Calibration) -> Table:
    """The DH rows of the nominal and of the calibrated robot."""
    before, after = dh_table(c.nominal), dh_table(c.robot, like=c.nominal)
    tilted = any(row.near_parallel for row in (*before.rows, *after.rows))
    hayati = " Ry(beta), with Hayati's beta between nearly parallel axes, where d is 0" * tilted
    note = f"Standard convention: Rz(theta + q) Tz(d) Tx(a) Rx(alpha){hayati}. The rows are read off both URDFs."
    for what, T, S in (
        ("Frame 0", before.T_base_0, after.T_base_0),
        ("The tip after the last row", before.T_n_tip, after.T_n_tip),
    ):
        shift, turn = (float(np.linalg.norm(part)) for part in np.split(_twist(T, S), 2))
        if max(shift, turn) > _NOTHING:
            note += f" {what} moved by {mm(shift)} mm and {deg(turn)} deg, which no row shows."
    head = ("joint", "robot", "a [mm]", "alpha [deg]", "d [mm]", "theta [deg]", "beta [deg]")
    columns = 6 + tilted
    pairs = zip(before.rows, after.rows, strict=True)
    return Table(
        "DH rows before and after",
        head[:columns],
        [line[:columns] for pair in pairs for line in _dh_lines(*pair)],
        "llrrrrr"[:columns],
        note,
        strong=range(2, 3 * len(before.rows), 3),
    )


def _dh_lines(before: DHRow, after: DHRow) -> Iterator[tuple[str, ...]]:
    """The row before, after, and the difference; none where the rows follow different conventions."""
    for name, who, row in ((before.joint, "nominal", before), ("", "calibrated", after)):
        yield name, who, mm(row.a), deg(row.alpha), mm(row.d), deg(row.theta), deg(row.beta)
    if before.near_parallel != after.near_parallel:
        yield "", "change", *("-",) * 5
        return
    a, d = (signed(mm(b - a)) for a, b in ((before.a, after.a), (before.d, after.d)))
    angles = np.array([(row.alpha, row.theta, row.beta) for row in (before, after)])
    turns = angles[1] - angles[0]
    alpha, theta, beta = (signed(deg(turn)) for turn in np.arctan2(np.sin(turns), np.cos(turns)))
    yield "", "change", a, alpha, d, theta, beta


def _twist(T: Array, S: Array) -> Array:
    """Shift and rotation vector from a pose to another, in its own axes, shape (6,), [m], [rad]."""
    D = rigid_inverse(T) @ S
    return np.concatenate([D[:3, 3], pin.log3(D[:3, :3])])


def origins(c: Calibration) -> Table:
    """The displacement of each origin that changed, in its nominal frame."""
    after = c.robot.origins()
    moved = {joint: _twist(T, after[joint]) for joint, T in c.nominal.origins().items()}
    return Table(
        "How far each <origin> of the corrected URDF is from the nominal one",
        ("joint", "x", "y", "z", "rx", "ry", "rz"),
        [  # mrad have as many figures as mm
            (joint, *(signed(mm(v)) for v in twist))
            for joint, twist in moved.items()
            if np.abs(twist).max() > _NOTHING
        ],
        "lrrrrrr",
        "Along and about the axes of the nominal origin. All else in the URDF is unchanged.",
        (("", 1), ("shift [mm]", 3), ("rotation vector [mrad]", 3)),
    )


def candidates(c: Calibration) -> Table:
    """The models that were tried."""
    best = max(one.log_likelihood for one in c.candidates)
    first = c.candidates[0].cross_validation.errors_without_outliers
    chosen = {"geometry": "the URDF", "larger": "result file", "": ""}
    rows = [
        (
            one.name,
            str(one.parameters),
            f"{one.log_likelihood - best:.1f}",
            candidate_rms(one),
            chosen[one.chosen],
        )
        for one in c.candidates
    ]
    return Table(
        "Models tried; errors on rows left out of the fit",
        ("model", "parameters", "evidence", "left-out rms", "chosen for"),
        rows,
        "lrrrl",
        "Evidence: restricted log likelihood, less the best one's (no unit); a step up must gain "
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
        scale, unit = (1e3, "mm") if joint.type == "prismatic" else (float(np.degrees(1.0)), "deg")
        ends = values.min(), values.max(), joint.lower, joint.upper
        shown = ["-" if v is None else f"{scale * v:.2f}" for v in ends]
        share, (low, high, lower, upper) = "-", ends
        if lower is not None and upper is not None and upper > lower:
            inside = max(0.0, min(high, upper) - max(low, lower))
            share = f"{100.0 * inside / (upper - lower):.0f} %"
            if low < lower - _EXACT or high > upper + _EXACT:
                beyond.append(f"'{joint.name}'")
        cells.append((joint.name, unit, *shown, share))
    note = "Used: share of the range between the limits. Beyond what was measured errors may be larger."
    note += f" Measured beyond the limits of the URDF: {', '.join(beyond)}." * bool(beyond)
    return Table(
        "Joint values of the estimation rows",
        ("joint", "unit", "lowest", "highest", "lower", "upper", "used"),
        cells,
        "llrrrrr",
        note,
        (("", 2), ("measured", 2), ("limit", 2), ("", 1)),
    )


def _places(c: Calibration, chosen: NDArray[np.int_]) -> tuple[list[str], list[list[str]]]:
    """What tells rows apart, heads and cells: numbers, and kinds, targets and set-ups where there are several."""
    m = c.measurements
    columns: list[tuple[str, Sequence[object]]] = [("row", m.rows)]
    more = (("kind", m.kinds), ("target", m.targets), ("set-up", m.groups))
    columns += [(name, values) for name, values in more if len(set(values)) > 1]
    cells = [[str(values[i]) for _, values in columns] for i in chosen]
    return [name for name, _ in columns], cells
