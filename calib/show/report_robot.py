"""What a report says of the robot: parameters with intervals, DH rows and origins before and after, what is unknown."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.identify.findings import ParameterEstimate
from calib.identify.result import Calibration
from calib.identify.statements import (
    candidate_rms,
    correlation_text,
    errorless,
    larger_parameters,
    rank_text,
    shown_parameters,
    sizes_text,
    unidentifiable_text,
)
from calib.identify.statistics import interval_factor
from calib.identify.words import frame_sentences, target_sentences
from calib.model.dh import DHRow, DHTable, dh_table
from calib.model.robot import read_only, rigid_inverse
from calib.show.document import Block, Bullets, Paragraph, Table, blocks, table
from calib.show.report_accuracy import deg, mm

Array = NDArray[np.float64]

#: More targets or set-ups, and more combinations, than this are counted.
_MOST = 40

#: A frame that moved by less has not [m or rad].
_NOTHING = 1e-9


def parameter_blocks(c: Calibration) -> tuple[Block, ...]:
    """Nominal value, correction and interval of each parameter; targets and frames."""
    every = shown_parameters(c)
    m, factor = c.measurements, interval_factor(c.fitted.estimate.freedom)
    without = int(np.sum(c.weights[m.estimation] <= 0.0))
    rows = f"{m.estimation.sum():,} estimation rows" + (
        f", {without:,} of which have no weight" if without else ""
    )
    none = errorless(c)
    held = "; 'kept' nominal, as no errors of its kind were found" if none else ""
    places = (*target_sentences(c, _MOST), *frame_sentences(c, _MOST))
    return blocks(
        Paragraph(
            f"{len(c.parameters)} parameters of the model '{c.model.name}' were estimated from {rows}. Correction: "
            f"calibrated minus nominal. 95 % ±: half the 95 % interval, {factor:.2f} standard deviations (Student's t, "
            f"{c.freedom:.0f} degrees of freedom). Determined: 'yes' by the measurements alone; 'jointly' in "
            f"combinations only, so that the single value leans on its prior; 'at bound' stopped by a bound{held}."
        ),
        _parameters("Lengths [mm]", [p for p in every if p.unit == "m"], mm, none),
        _parameters("Angles [deg]", [p for p in every if p.unit != "m"], deg, none),
        Bullets(places) if places else None,
        _larger(c),
    )


def geometry_blocks(c: Calibration) -> tuple[Block, ...]:
    """DH rows of both robots, and how each joint's origin moved."""
    return blocks(_dh(c), _origins(c))


def unknown_blocks(c: Calibration) -> tuple[Block, ...]:
    """What the measured poses cannot tell apart."""
    combinations = [str(one) for one in c.observability.unidentifiable]
    shown = combinations[:_MOST]
    if len(combinations) > len(shown):
        shown.append(f"and {len(combinations) - len(shown)} more")
    harmless = " They cost no accuracy at the measured poses, but single values of these parameters mean little."
    return blocks(
        Paragraph(rank_text(c)),
        Paragraph(f"{unidentifiable_text(c).removesuffix(':')}.{harmless}") if shown else None,
        Bullets(tuple(shown)) if shown else None,
        *(Paragraph(text) for text in (correlation_text(c), sizes_text(c)) if text),
    )


def candidate_blocks(c: Calibration) -> tuple[Block, ...]:
    """The models that were tried."""
    if not c.candidates:
        return ()
    best = max(one.log_likelihood for one in c.candidates)
    first = c.candidates[0].cross_validation.errors_without_outliers
    rows = f"{first.n or first.n_angle:,} estimation rows that had a weight when the models were compared"
    words = {"geometry": "the URDF", "larger": "result file"}
    return blocks(
        table(
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
            f"{c.candidates[0].needed:.1f}. Left-out rms: of the {rows}, each predicted by a linearised fit without "
            "it. The errors in section 2 are those of whole fits of the chosen model.",
        )
    )


def _parameters(
    title: str,
    shown: list[ParameterEstimate],
    text: Callable[[float], str],
    none: Collection[str],
) -> Table | None:
    """The parameters of one unit."""

    def row(p: ParameterEstimate) -> tuple[str, ...]:
        kept = p.name in none
        known = (
            "kept" if kept else "at bound" if p.at_bound else "yes" if p.identifiable else "jointly"
        )
        change = "-" if p.nominal is None else signed(text(p.delta))
        nominal = "-" if p.nominal is None else text(p.nominal)
        half = "-" if p.at_bound or kept else text(0.5 * (p.high - p.low))
        return p.name, nominal, text(p.value), change, half, known

    return table(
        title,
        ("parameter", "nominal", "calibrated", "correction", "95 % ±", "determined"),
        map(row, shown),
        "lrrrrl",
    )


def _larger(c: Calibration) -> Table | None:
    """The parameters that no URDF can hold."""
    return table(
        f"Larger model '{'' if c.larger is None else c.larger.name}': in the result file, not in the URDF",
        ("parameter", "value", "95 % interval", "unit"),
        [(name, value, half.strip("()"), unit) for name, value, half, unit in larger_parameters(c)],
        "lrrl",
    )


def _dh(c: Calibration) -> Table | None:
    """The DH rows of the nominal and of the calibrated robot."""
    before = dh_table(c.nominal)
    after = _turned_like(before, dh_table(c.robot))
    tilted = any(row.near_parallel for row in (*before.rows, *after.rows))
    note = "Standard convention: Rz(theta + q) Tz(d) Tx(a) Rx(alpha)"
    note += (
        " Ry(beta), with Hayati's beta between nearly parallel axes, where d is 0."
        if tilted
        else "."
    )
    note += " The rows are read off both URDFs: they give the same poses as the URDFs do."
    if _otherwise(c, before):
        note += (
            " Where the model has other parameters between such axes, they differ from those above."
        )
    for what, T, S in (
        ("Frame 0", before.T_base_0, after.T_base_0),
        ("The tip after the last row", before.T_n_tip, after.T_n_tip),
    ):
        moved, turned = _apart(T, S)
        if moved > _NOTHING or turned > _NOTHING:
            note += f" {what} moved by {mm(moved)} mm and {deg(turned)} deg, which no row shows."
    return table(
        "DH rows before and after",
        ("joint", "robot", "a [mm]", "alpha [deg]", "d [mm]", "theta [deg]")
        + (("beta [deg]",) if tilted else ()),
        [
            line[: 7 if tilted else 6]
            for rows in zip(before.rows, after.rows, strict=True)
            for line in _dh_lines(*rows)
        ],
        "llrrrr" + "r" * tilted,
        note=note,
        strong=tuple(range(2, 3 * len(before.rows), 3)),
    )


def _otherwise(c: Calibration, before: DHTable) -> bool:
    """Whether the model has a d where the rows have Hayati's beta, or a beta where they have a d."""
    names = set(c.model.names)
    return any(
        f"{'d' if row.near_parallel else 'beta'}{k}" in names
        for k, row in enumerate(before.rows[:-1], start=1)  # the last axis has no next one
    )


def _turned_like(before: DHTable, after: DHTable) -> DHTable:
    """The same geometry with each x axis on the side of the other table's, or rows that hardly differ seem to.

    Half a turn of frame i about its z: A_i Rz(pi) = Rz(theta + pi) Tz(d) Tx(-a) Rx(-alpha) Ry(-beta).
    """
    rows, turned = [], 0.0
    for old, new in zip(before.rows, after.rows, strict=True):
        theta = new.theta - turned
        turned = np.pi if np.cos(theta - old.theta) < 0.0 else 0.0
        sign = -1.0 if turned else 1.0
        row = replace(
            new,
            theta=float(np.arctan2(np.sin(theta + turned), np.cos(theta + turned))),
            a=sign * new.a + 0.0,
            alpha=sign * new.alpha + 0.0,
            beta=sign * new.beta + 0.0,
        )
        rows.append(row)
    half = np.diag([-1.0, -1.0, 1.0, 1.0]) if turned else np.eye(4)
    return DHTable(tuple(rows), after.T_base_0, read_only(half @ after.T_n_tip))


def _dh_lines(before: DHRow, after: DHRow) -> Iterator[tuple[str, ...]]:
    """The row before, after, and the difference; none where the rows follow different conventions."""
    for name, who, row in ((before.joint, "nominal", before), ("", "calibrated", after)):
        angles = [deg(v) for v in (row.alpha, row.theta, row.beta)]
        yield name, who, mm(row.a), angles[0], mm(row.d), angles[1], angles[2]
    if before.near_parallel != after.near_parallel:
        yield "", "change", *("-",) * 5
        return
    lengths = [signed(mm(b - a)) for a, b in ((before.a, after.a), (before.d, after.d))]
    turns = [
        signed(deg(float(np.arctan2(np.sin(b - a), np.cos(b - a)))))
        for a, b in (
            (before.alpha, after.alpha),
            (before.theta, after.theta),
            (before.beta, after.beta),
        )
    ]
    yield "", "change", lengths[0], turns[0], lengths[1], turns[1], turns[2]


def _origins(c: Calibration) -> Table | None:
    """The displacement of each origin that changed, in its nominal frame."""
    before, after = c.nominal.origins(), c.robot.origins()
    cells = []
    for joint, T in before.items():
        D = rigid_inverse(T) @ after[joint]
        turn = pin.log3(D[:3, :3])
        if max(np.abs(D[:3, 3]).max(), np.abs(turn).max()) > _NOTHING:
            shift = [signed(mm(float(v))) for v in D[:3, 3]]
            cells.append((joint, *shift, *(signed(mm(float(v))) for v in turn)))
    return table(
        "How far each <origin> of the corrected URDF is from the nominal one",
        ("joint", "x", "y", "z", "rx", "ry", "rz"),
        cells,
        "lrrrrrr",
        groups=(("", 1), ("shift [mm]", 3), ("rotation vector [mrad]", 3)),
        note="Along and about the axes of the nominal origin. All else in the URDF is unchanged.",
    )


def _apart(T: Array, S: Array) -> tuple[float, float]:
    """How far two poses are apart, [m] and [rad]."""
    D = rigid_inverse(T) @ S
    return float(np.linalg.norm(D[:3, 3])), float(np.linalg.norm(pin.log3(D[:3, :3])))


def signed(number: str) -> str:
    """A number with its sign, zero apart."""
    return number if number.startswith("-") or not float(number) else f"+{number}"
