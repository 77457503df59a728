"""What a report says of the accuracy: the verdict, errors before and after, rows to validate, outliers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calib.identify.findings import Outlier
from calib.identify.result import Calibration
from calib.identify.statements import error_rows, error_title, left_out_text, weights_text
from calib.identify.statistics import Errors
from calib.show.document import Block, Judgement, Paragraph, Table, blocks, table

Array = NDArray[np.float64]

#: More rows for validation than this are not all listed: the worst of them are, so many.
_MOST_ROWS, _WORST = 40, 20

#: More outliers than this are counted.
_MOST_OUTLIERS = 40


def verdict_blocks(c: Calibration) -> tuple[Block, ...]:
    """Whether to use the result, and why."""
    if c.verdict is None:
        why = "Nothing was cross-validated, so nothing is said of whether to use the result."
        return (Judgement("none", (why,)),)
    return (Judgement(c.verdict.use, c.verdict.reasons),)


def accuracy_blocks(c: Calibration) -> tuple[Block, ...]:
    """Errors before and after: by set, on rows left out, and row by row of those for validation."""
    rows = _whole_labels(error_rows(c))
    larger = "" if c.larger is None else f"; larger is the same with the model '{c.larger.name}'"
    return blocks(
        Paragraph(
            "An error is measured minus predicted; its size is the norm of that. Nominal is the robot as it came, "
            "with the measurement frame and the target as given, or fitted to the rows where they were not; "
            f"calibrated is the robot of the corrected URDF{larger}.{_pairs(c)}"
        ),
        _lengths(error_title(c.used), rows, left_out_text(c), _left_out_nominal(c)),
        _angles(rows, left_out_text(c)),
        _validation_rows(c),
        None if np.any(c.measurements.validation) else Paragraph(_unseen(c)),
    )


def outlier_blocks(c: Calibration) -> tuple[Block, ...]:
    """The rows that do not belong to the others."""
    if not c.outliers and not c.suspects:
        return (
            Paragraph(
                f"None of the {len(c.measurements):,} rows lies further from what the others predict than its limit "
                f"(score {c.flag_limit:.1f} for estimation rows)."
            ),
        )
    robust = "" if c.robustness is None else " " + c.robustness.sentence()
    said = []
    if c.outliers:
        said.append(f"{_rows(len(c.outliers), 'estimation')} flagged ({weights_text(c)}).{robust}")
    if c.suspects:
        said.append(
            f"{_rows(len(c.suspects), 'validation')} not explained by the calibrated robot; such rows never have a "
            "weight in the fit, and count in the errors above."
        )
    return blocks(*map(Paragraph, said), _flagged(c))


def _left_out_nominal(c: Calibration) -> str:
    """That the nominal robot's left-out rows have another frame and target than its other rows, where they have."""
    unknown = [bool(directions) for directions in c.setup.unknown]
    started = any(unknown & c.setup.frame_given) or any(
        c.setup.target_unknown & c.setup.target_given
    )
    if c.nominal_cross_validation is None or not started:
        return ""
    return "Left-out rows, nominal: frame and target are fitted to the others, even if given."


def _pairs(c: Calibration) -> str:
    """That two rows are one number, where they are."""
    return " The two rows of a pair give one length." if "pair" in c.measurements.kinds else ""


def _rows(count: int, kind: str) -> str:
    """Such as ``2 estimation rows are``."""
    return f"{count:,} {kind} row{'s are' if count > 1 else ' is'}"


def _lengths(title: str, rows: Sequence[tuple[str, Errors]], note: str, more: str) -> Table | None:
    """The table of the errors of positions and lengths, [mm]."""
    shown = [(label, e) for label, e in rows if e.n]
    along = any(np.any(np.isfinite(e.span_axis)) for _, e in shown)
    notes = [f"{note}."] * bool(note)
    notes += ["Span: largest minus smallest signed error along an axis of the frame."] * along
    notes += [more] * bool(more)
    return table(
        f"{title} by set of rows [mm]",
        ("rows, robot", "number", "max", "mean", "rms", *("x", "y", "z")[: 3 * along]),
        [
            (
                label,
                f"{e.n:,}",
                *(mm(v) for v in (e.max, e.mean, e.rms, *e.span_axis[: 3 * along])),
            )
            for label, e in shown
        ],
        "lrrrr" + "rrr" * along,
        note=" ".join(notes),
        groups=(("", 2), ("size of the error", 3), *([("span", 3)] if along else [])),
        strong=_after(shown),
    )


def _angles(rows: Sequence[tuple[str, Errors]], note: str) -> Table | None:
    """The table of orientation errors, [deg]."""
    shown = [(label, e) for label, e in rows if e.n_angle]
    cells = [
        (label, f"{e.n_angle:,}", *(deg(v) for v in (e.max_angle, e.mean_angle, e.rms_angle)))
        for label, e in shown
    ]
    return table(
        "Orientation error by set of rows [deg]",
        ("rows, robot", "number", "max", "mean", "rms"),
        cells,
        "lrrrr",
        note=note,
        strong=_after(shown),
    )


def _whole_labels(rows: Sequence[tuple[str, Errors]]) -> list[tuple[str, Errors]]:
    """The rows, each with a label that needs no look at the row above."""
    found: list[tuple[str, Errors]] = []
    for label, errors in rows:
        rest = label.strip().removeprefix("the same ")
        found.append((label if rest == label else f"{found[-1][0]}, {rest}", errors))
    return found


def _after(rows: Sequence[tuple[str, Errors]]) -> tuple[int, ...]:
    """The lines of the calibrated robot."""
    return tuple(k for k, (label, _) in enumerate(rows) if ", calibrated" in label)


def _unseen(c: Calibration) -> str:
    """What stands in for rows that were kept for validation."""
    if c.cross_validation is not None:
        return (
            "No rows were kept for validation: what the robot is worth on rows that it has not seen is that of the "
            "left-out rows."
        )
    return (
        "No rows were kept for validation and none were left out in turn: these errors say how well the model fits "
        "its rows, not how accurate the robot is elsewhere."
    )


def _validation_rows(c: Calibration) -> Table | None:
    """Errors of single validation rows before and after, as in the paper's Table 4."""
    m = c.measurements
    every = np.flatnonzero(m.validation & np.any(c.used, axis=1))
    chosen, which = every, f"the {len(every):,} validation rows"
    if len(every) > _MOST_ROWS:
        after = np.linalg.norm(lengths(c, c.residual_calibrated)[every], axis=1)
        worst = np.argsort(-np.nan_to_num(after), kind="stable")[:_WORST]
        chosen = every[np.sort(worst)]
        which = f"the {_WORST} of {len(every):,} validation rows with the largest error after calibration"
    before, after = (lengths(c, r)[chosen] for r in (c.residual_nominal, c.residual_calibrated))
    labels, names = _places(c, chosen)
    columns: list[tuple[str, int]] = [("", len(names))]
    head, cells = [*names], [list(row) for row in labels]
    along = bool(np.any(np.all(c.used[chosen][:, :3], axis=1)) and c.used.shape[1] >= 3)
    if np.any(c.used[chosen][:, :3]):
        for who, values in (("before: nominal [mm]", before), ("after: calibrated [mm]", after)):
            columns.append((who, 4 if along else 1))
            head += [*(("dx", "dy", "dz") if along else ()), "size"]
            for row, value, used in zip(cells, values, c.used[chosen][:, :3], strict=True):
                whole = bool(np.all(used)) and along
                axes = [mm(v) if whole else "-" for v in value] if along else []
                row += [*axes, mm(float(np.linalg.norm(value))) if np.any(used) else "-"]
    if np.any(c.used[chosen][:, 3:]):
        columns.append(("angle [deg]", 2))
        head += ["before", "after"]
        for row, i in zip(cells, chosen, strict=True):
            turned = bool(np.any(c.used[i, 3:]))
            row += [
                deg(float(np.linalg.norm(r[i, 3:]))) if turned else "-"
                for r in (c.residual_nominal, c.residual_calibrated)
            ]
    return table(
        f"Error of {which}, which took no part in the fit",
        head,
        cells,
        "l" * len(names) + "r" * (len(head) - len(names)),
        groups=tuple(columns),
        note="dx, dy, dz: measured minus predicted along the axes of the measurement frame."
        if along
        else "",
    )


def _places(c: Calibration, chosen: NDArray[np.int_]) -> tuple[list[tuple[str, ...]], list[str]]:
    """What tells rows apart: their numbers, and their kinds, targets and set-ups where there are several."""
    m = c.measurements
    columns: list[tuple[str, Sequence[object]]] = [("row", m.rows)]
    for name, values in (("kind", m.kinds), ("target", m.targets), ("set-up", m.groups)):
        if len(set(values)) > 1:
            columns.append((name, values))
    labels = [tuple(str(values[i]) for _, values in columns) for i in chosen]
    return labels, [name for name, _ in columns]


def _flagged(c: Calibration) -> Table | None:
    """The rows flagged, with their errors before and after."""
    m = c.measurements
    place = {row: i for i, row in enumerate(m.rows)}
    every = [*c.outliers, *c.suspects]
    shown = every[:_MOST_OUTLIERS]
    indices = np.array([place[o.row] for o in shown], dtype=np.int_)
    labels, names = _places(c, indices)
    before = np.linalg.norm(lengths(c, c.residual_nominal), axis=1)
    after = np.linalg.norm(lengths(c, c.residual_calibrated), axis=1)
    cells = [
        (
            *label,
            m.sets[i],
            mm(float(before[i])) if np.any(c.used[i, :3]) else "-",
            mm(float(after[i])) if np.any(c.used[i, :3]) else "-",
            _score(o),
            f"{c.weights[i]:.2f}",
        )
        for o, i, label in zip(shown, indices, labels, strict=True)
    ]
    rest = len(every) - len(shown)
    more = f" {rest} more are in the result file (--json)." if rest else ""
    return table(
        "Rows flagged",
        (*names, "set", "before [mm]", "after [mm]", "score", "weight"),
        cells,
        "l" * len(names) + "lrrrr",
        note="Score: distance from what the other rows predict, in standard deviations. Estimation rows are flagged "
        f"beyond {c.flag_limit:.1f}.{more}",
    )


def _score(outlier: Outlier) -> str:
    """A score with one figure after the point."""
    return f"{outlier.score:.1f}" if np.isfinite(outlier.score) else "-"


def lengths(c: Calibration, residual: Array) -> Array:
    """The lengths of residuals, 0 where none was measured, shape (N, 3 or less), [m]."""
    return np.where(c.used[:, :3], residual[:, :3], 0.0)


def mm(length: float) -> str:
    """A length in mm with three figures after the point."""
    return f"{round(1e3 * length, 3) + 0.0:.3f}" if np.isfinite(length) else "-"


def deg(angle: float) -> str:
    """An angle in degrees with four figures after the point."""
    return f"{round(float(np.degrees(angle)), 4) + 0.0:.4f}" if np.isfinite(angle) else "-"
