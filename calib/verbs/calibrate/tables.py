"""The tables of a report: errors, validation rows, parameters, geometry before and after, flagged rows, joint ranges.

Every cell is text in the unit that the table's head or title names: lengths [mm], angles [deg], small rotations [mrad].
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import calib.verbs.calibrate.text as texts
from calib.basics.arrays import Array, rigid_inverse
from calib.basics.channels import RESIDUAL_UNITS, Channels
from calib.model.dh_table import dh_table
from calib.numerics.errors import Errors, UnitErrors
from calib.result.calibration import Calibration
from calib.result.fitted_model import ParameterEstimate
from calib.robot.dh.rows import DHRow
from calib.show.errors import error_title
from calib.show.lines import number
from calib.show.sizes import shown
from calib.show.table import MOST_LISTED, Table

#: Number of validation rows listed where there are more than `MOST_LISTED`: those with the largest errors.
MOST_WORST = 20

#: Least change of an origin that is listed, [m] along or [rad] about an axis: rounding of the URDF's digits is less.
_LEAST_DISPLACEMENT = 1e-9

#: Millimetres per metre.
_MM = 1e3

#: Milliradians per radian.
_MRAD = 1e3

#: Degrees per radian.
_DEG = float(np.degrees(1.0))

#: Factor from SI and digits after the point of a, alpha, d, theta and beta in the table of DH rows: [mm] and [deg].
_DH_FORMATS = ((_MM, 3), (_DEG, 4), (_MM, 3), (_DEG, 4), (_DEG, 4))

#: Indices of the angles alpha, theta and beta among the five DH parameters of a row.
_DH_ANGLES = [1, 3, 4]


def errors(c: Calibration, unit: str) -> Table:
    """Tabulate the errors of each set of rows in one unit, of the nominal and the calibrated robot.

    Args:
        c: The result.
        unit: Symbol of the unit: ``"m"`` for errors of positions and lengths [mm], ``"rad"`` for orientations [deg].

    Returns:
        Number of rows, largest, mean and rms error of each set. Position errors also have their span (largest minus
        smallest signed error) along each axis of the measurement frame. The calibrated robot's rows are strong.
    """
    figures = figures_by_label(c, unit)
    with_span = RESIDUAL_UNITS[unit].shows_span and any(map(_has_span, figures.values()))
    rows = [
        (label, f"{e.n:,}", *error_cells(e, with_span=with_span)) for label, e in figures.items()
    ]
    strong = [i for i, label in enumerate(figures) if ", calibrated" in label]
    notes = []
    if c.cross_validation is not None:
        notes.append(f"{texts.held_out_text(c)}.")
    head = ["rows, robot", "number", "max", "mean", "rms"]
    groups = [("", 2), ("size of the error", 3)]
    if with_span:
        notes.append("Span: largest minus smallest signed error along an axis of the frame.")
        head += ["x", "y", "z"]
        groups.append(("span", 3))
    shown_unit = RESIDUAL_UNITS[unit].shown
    title = f"{error_title(unit, c.rows.channels)} by set of rows [{shown_unit}]"
    align = "l" + "r" * (len(head) - 1)
    return Table(title, head, rows, align, " ".join(notes), groups, strong)


def before_and_after(c: Calibration) -> Table:
    """Tabulate the errors of rows that took no part in the fit, of the nominal robot beside the calibrated one.

    In each unit that was measured these are validation and held-out rows; the estimation rows where there are neither.
    """
    sets = _sets_before_and_after(c)
    rows = []
    for unit in c.rows.channels.present:
        name = f"{RESIDUAL_UNITS[unit].measured} [{RESIDUAL_UNITS[unit].shown}]"
        for label, nominal, calibrated in sets:
            count = calibrated[unit].n
            if count:
                cells = (*error_cells(nominal[unit]), *error_cells(calibrated[unit]))
                rows.append((name, label, f"{count:,}", *cells))
                name = ""
    return Table(
        "Size of the error by set of rows",
        ("error of", "rows", "number", *(2 * ("max", "mean", "rms"))),
        rows,
        "llrrrrrrr",
        groups=(("", 3), ("before: nominal", 3), ("after: calibrated", 3)),
    )


def _sets_before_and_after(c: Calibration) -> list[tuple[str, Errors, Errors]]:
    """Return the label of each set of rows that took no part in the fit, and both robots' errors of it.

    The estimation rows where there is no such set.
    """
    before, after = c.errors["nominal"], c.errors["calibrated"]
    sets = [("validation rows", before["validation"], after["validation"])]
    if c.cross_validation is not None and c.trust.nominal_cross_validation is not None:
        nominal, fitted = c.trust.nominal_cross_validation, c.cross_validation
        sets.append(("held-out rows", nominal.errors, fitted.errors))
        if c.rows.outliers:
            without = (nominal.errors_without_outliers, fitted.errors_without_outliers)
            sets.append(("held-out, without outliers", *without))
    if any(calibrated.leading.n for _, _, calibrated in sets):
        return sets
    return [("estimation rows", before["estimation"], after["estimation"])]


def figures_by_label(c: Calibration, unit: str) -> dict[str, UnitErrors]:
    """Return the errors in one unit of each set of rows that has any, by the set's label."""
    labelled = texts.error_rows(c)
    figures = {}
    for label, (_, errors_of_set) in zip(_full_labels(labelled), labelled, strict=True):
        if errors_of_set[unit].n:
            figures[label] = errors_of_set[unit]
    return figures


def _full_labels(labelled: Iterable[tuple[str, Errors]]) -> list[str]:
    """Return the labels of sets so that they need no look at the row above: ``the same ...`` is spelt out."""
    full = []
    subject = ""
    for label, _ in labelled:
        addition = label.strip().removeprefix("the same ")
        subject = label if addition == label else f"{subject}, {addition}"
        full.append(subject)
    return full


def _has_span(e: UnitErrors) -> bool:
    """Tell if a set has errors along the axes of the frame: whole positions, not only lengths."""
    return e.n > 0 and bool(np.any(np.isfinite(e.span_axis)))


def error_cells(e: UnitErrors, *, with_span: bool = False) -> list[str]:
    """Write largest, mean and rms error of a set, and the spans by axis, in the unit that is shown."""
    values = [e.max, e.mean, e.rms]
    if with_span:
        values += e.span_axis.tolist()
    return [shown(value, e.unit) for value in values]


def validation_rows(c: Calibration) -> Table:
    """Tabulate the errors of single validation rows before and after calibration.

    Residuals along the axes of the measurement frame, measured minus predicted, and their norm [mm]; of orientations
    the angle [deg]. Of more than `MOST_LISTED` rows the `MOST_WORST` with the largest errors after calibration are
    listed, in the order of the table of measurements.
    """
    indices = np.flatnonzero(c.fit.measurements.validation & np.any(c.rows.channels.used, axis=1))
    subject = f"the {len(indices):,} validation rows"
    if len(indices) > MOST_LISTED:
        subject = f"the {MOST_WORST} of {len(indices):,} validation rows with the largest error after calibration"
        indices = _worst_rows(c, indices)
    names, cells = _row_columns(c, indices)
    first = _Columns([("", len(names))], list(names), cells)
    errors = [_error_columns(c, indices, unit) for unit in c.rows.channels.select(indices).present]
    columns = _side_by_side([first, *errors])
    note = ""
    if "dx" in columns.head:
        note = "dx, dy, dz: measured minus predicted along the axes of the measurement frame."
    align = "l" * len(names) + "r" * (len(columns.head) - len(names))
    title = f"Error of {subject}, which took no part in the fit"
    return Table(title, columns.head, columns.cells, align, note, columns.groups)


def _worst_rows(c: Calibration, indices: NDArray[np.int_]) -> NDArray[np.int_]:
    """Return the `MOST_WORST` of some rows with the largest calibrated errors in the first unit, in ascending order."""
    unit = c.rows.channels.present[0]
    sizes = c.rows.channels.norms(c.rows.residual_calibrated, unit)[indices]
    order = np.argsort(-np.nan_to_num(sizes), kind="stable")
    return indices[np.sort(order[:MOST_WORST])]


def _has_vectors(channels: Channels, indices: NDArray[np.int_], unit: str) -> bool:
    """Tell if any of some rows measures a whole vector in a unit, such as a position."""
    _, are_vectors = channels.select(indices).vector_columns(unit)
    return bool(np.any(are_vectors))


def _residuals(c: Calibration) -> tuple[tuple[str, Array], tuple[str, Array]]:
    """Return the residuals (N, D) of the nominal and of the calibrated robot with the labels of their columns."""
    before = ("before: nominal", c.rows.residual_nominal)
    after = ("after: calibrated", c.rows.residual_calibrated)
    return before, after


@dataclass(frozen=True, slots=True)
class _Columns:
    """Columns that stand side by side in a table of K rows."""

    #: Labels above the heads, each with the number of columns below it.
    groups: list[tuple[str, int]]
    #: Head of each column.
    head: list[str]
    #: Cells of each of the K rows.
    cells: list[list[str]]


def _side_by_side(blocks: Sequence[_Columns]) -> _Columns:
    """Return columns of the same K rows as one block, from left to right."""
    groups = [group for block in blocks for group in block.groups]
    head = [name for block in blocks for name in block.head]
    cells = [
        list(chain.from_iterable(parts)) for parts in zip(*(b.cells for b in blocks), strict=True)
    ]
    return _Columns(groups, head, cells)


def _error_columns(c: Calibration, indices: NDArray[np.int_], unit: str) -> _Columns:
    """Write the errors of rows in one unit, of the nominal and of the calibrated robot.

    Args:
        c: The result.
        indices: Indices of the K rows.
        unit: Symbol of the unit. Lengths have the signed errors along x, y and z too, if a position is among them.
    """
    if unit == "m":
        return _length_columns(c, indices)
    of_unit = RESIDUAL_UNITS[unit]
    cells = _sizes_before_and_after(c, indices, unit)
    return _Columns([(f"{of_unit.measured} [{of_unit.shown}]", 2)], ["before", "after"], cells)


def _sizes_before_and_after(
    c: Calibration, indices: NDArray[np.int_], unit: str
) -> list[list[str]]:
    """Write the errors of rows in one unit before and after calibration, two cells for each row.

    Args:
        c: The result.
        indices: Indices of the K rows.
        unit: Symbol of the unit.
    """
    sizes = [c.rows.channels.norms(residual, unit)[indices] for _, residual in _residuals(c)]
    return [[shown(size, unit) for size in sizes_of_row] for sizes_of_row in np.transpose(sizes)]


def _length_columns(c: Calibration, indices: NDArray[np.int_]) -> _Columns:
    """Write the errors of rows in lengths, see `_error_columns`."""
    with_axes = _has_vectors(c.rows.channels, indices, "m")
    head = ["dx", "dy", "dz", "size"] if with_axes else ["size"]
    groups, values = [], []
    for label, residual in _residuals(c):
        groups.append((f"{label} [{RESIDUAL_UNITS['m'].shown}]", len(head)))
        if with_axes:
            values.append(_along_axes(c, residual)[indices])
        values.append(c.rows.channels.norms(residual, "m")[indices, None])
    cells = [[shown(value, "m") for value in row] for row in np.hstack(values)]
    return _Columns(groups, 2 * head, cells)


def _along_axes(c: Calibration, residual: Array) -> Array:
    """Return the residuals of positions along x, y, z, shape (N, 3) [m]; NaN where no position was measured."""
    columns, are_vectors = c.rows.channels.vector_columns("m")
    return np.where(are_vectors[:, None], residual[:, columns], np.nan)


def flagged(c: Calibration) -> Table:
    """Tabulate the flagged rows of either set: errors before and after, score, and weight in the fit."""
    m = c.fit.measurements
    outliers = [*c.rows.outliers, *c.rows.suspects]
    listed = outliers[:MOST_LISTED]
    indices = np.array([m.rows.index(outlier.row) for outlier in listed], dtype=np.int_)
    names, rows = _row_columns(c, indices)
    unit = c.rows.channels.present[0]
    shown_unit = RESIDUAL_UNITS[unit].shown
    for outlier, i, cells, sizes in zip(
        listed, indices, rows, _sizes_before_and_after(c, indices, unit), strict=True
    ):
        cells += [m.sets[i], *sizes, number(outlier.score, 1), f"{c.rows.weights[i]:.2f}"]
    note = (
        "Score: distance from what the other rows predict, in standard deviations. Estimation rows are flagged "
        f"beyond {c.rows.flag_limit:.1f}."
    )
    unlisted = len(outliers) - len(listed)
    if unlisted:
        note += f" {unlisted} more are in the result file (--json)."
    return Table(
        "Rows flagged",
        (*names, "set", f"before [{shown_unit}]", f"after [{shown_unit}]", "score", "weight"),
        rows,
        "l" * len(names) + "lrrrr",
        note,
    )


def parameters(c: Calibration, unit: str) -> Table:
    """Tabulate nominal value, calibrated value, correction and 95 % interval of the parameters of one unit.

    Args:
        c: The result.
        unit: ``"mm"`` for the lengths of the model, ``"deg"`` for everything else.

    Returns:
        One row a parameter. Half the interval is ``-`` for a parameter stopped by a bound and for one that stayed
        nominal because its family has no errors; so are nominal value and correction of one that was not given.
    """
    kept = texts.errorless(c)
    shown = [p for p in texts.shown_parameters(c) if (p.unit == "m") == (unit == "mm")]
    rows = [_parameter_row(p, unit, kept=p.name in kept) for p in shown]
    title = "Lengths [mm]" if unit == "mm" else "Angles [deg]"
    head = ("parameter", "nominal", "calibrated", "correction", "95 % ±", "determined")
    return Table(title, head, rows, "lrrrrl")


def _parameter_row(p: ParameterEstimate, unit: str, *, kept: bool) -> tuple[str, ...]:
    """Write a parameter; ``kept``: it stayed nominal, so that it has no interval."""
    scale, digits = (_MM, 3) if unit == "mm" else (_DEG, 4)
    nominal = np.nan if p.nominal is None else p.nominal
    change = np.nan if p.nominal is None else p.delta
    half = np.nan if p.at_bound or kept else 0.5 * (p.high - p.low)
    return (
        p.name,
        number(scale * nominal, digits),
        number(scale * p.value, digits),
        number(scale * change, digits, "+"),
        number(scale * half, digits),
        _determined(p, kept=kept),
    )


def _determined(p: ParameterEstimate, *, kept: bool) -> str:
    """Word how the measurements determine a parameter."""
    if kept:
        return "kept"
    if p.at_bound:
        return "at bound"
    return "yes" if p.identifiable else "jointly"


def non_geometric(c: Calibration) -> Table:
    """Tabulate the parameters of the non-geometric model that no URDF can hold; no rows without that model."""
    name = c.non_geometric.name if c.non_geometric else ""
    rows = []
    for parameter, value, half, unit in texts.non_geometric_parameters(c):
        rows.append((parameter, value, half.strip("()"), unit))
    title = f"Non-geometric model '{name}': in the result file, not in the URDF"
    return Table(title, ("parameter", "value", "95 % interval", "unit"), rows, "lrrl")


def dh(c: Calibration) -> Table:
    """Tabulate the standard DH rows of the nominal and of the calibrated robot, and their differences."""
    before = dh_table(c.nominal).rows
    after = dh_table(c.robot, like=c.nominal).rows
    tilted = any(row.near_parallel for row in (*before, *after))
    # Without nearly parallel axes beta is zero everywhere, and its column is left away.
    columns = 7 if tilted else 6
    rows: list[tuple[str, ...]] = []
    for nominal_row, calibrated_row in zip(before, after, strict=True):
        lines = _dh_lines(nominal_row, calibrated_row)
        rows.extend(line[:columns] for line in lines)
    hayati = ""
    if tilted:
        hayati = " Ry(beta), with Hayati's beta between nearly parallel axes, where d is 0"
    head = ("joint", "robot", "a [mm]", "alpha [deg]", "d [mm]", "theta [deg]", "beta [deg]")
    return Table(
        "DH rows before and after",
        head[:columns],
        rows,
        "llrrrrr"[:columns],
        f"Standard convention: Rz(theta + q) Tz(d) Tx(a) Rx(alpha){hayati}. The rows are read off both URDFs; frame 0 "
        "and the tip after the last row may have moved too, which the next table shows.",
        strong=range(2, 3 * len(before), 3),
    )


def _dh_lines(before: DHRow, after: DHRow) -> Iterator[tuple[str, ...]]:
    """Write a joint's nominal row, calibrated row, and the change; no change where the conventions differ."""
    nominal = np.array([before.a, before.alpha, before.d, before.theta, before.beta])
    calibrated = np.array([after.a, after.alpha, after.d, after.theta, after.beta])
    change = calibrated - nominal
    change[_DH_ANGLES] = np.angle(np.exp(1j * change[_DH_ANGLES]))
    if before.near_parallel != after.near_parallel:
        change[:] = np.nan
    yield before.joint, "nominal", *_dh_cells(nominal, "-")
    yield "", "calibrated", *_dh_cells(calibrated, "-")
    yield "", "change", *_dh_cells(change, "+")


def _dh_cells(values: Array, sign: str) -> list[str]:
    """Write a, alpha, d, theta, beta in [mm] and [deg]; ``sign`` as in `calib.show.lines.number`."""
    cells = []
    for value, (scale, digits) in zip(values, _DH_FORMATS, strict=True):
        cells.append(number(scale * value, digits, sign))
    return cells


def origins(c: Calibration) -> Table:
    """Tabulate the displacement of each joint origin that changed: shift [mm] and rotation vector [mrad].

    Both are of T_nominal_calibrated, along and about the axes of the nominal origin.
    """
    after = c.robot.origins()
    rows = []
    for joint, T_parent_nominal in c.nominal.origins().items():
        T_nominal_calibrated = rigid_inverse(T_parent_nominal) @ after[joint]
        rotation = pin.log3(T_nominal_calibrated[:3, :3])
        twist = np.concatenate([T_nominal_calibrated[:3, 3], rotation])
        if np.abs(twist).max() > _LEAST_DISPLACEMENT:
            shift = [number(_MM * value, 3, "+") for value in twist[:3]]
            turn = [number(_MRAD * value, 3, "+") for value in twist[3:]]
            rows.append((joint, *shift, *turn))
    return Table(
        "Displacement of each <origin> of the corrected URDF from the nominal one",
        ("joint", "x", "y", "z", "rx", "ry", "rz"),
        rows,
        "lrrrrrr",
        "Along and about the axes of the nominal origin. All else in the URDF is unchanged.",
        (("", 1), ("shift [mm]", 3), ("rotation vector [mrad]", 3)),
    )


def ranges(c: Calibration) -> Table:
    """Tabulate the joint values of the estimation rows beside the joint limits, [deg] or [mm]."""
    m = c.fit.measurements
    q = m.joints_for(c.nominal.joint_names)[m.estimation]
    values_of_joints = c.nominal.input_values(q).T
    rows = []
    for joint, values in zip(c.nominal.inputs, values_of_joints, strict=True):
        scale, unit = (_MM, "mm") if joint.type == "prismatic" else (_DEG, "deg")
        low = values.min()
        high = values.max()
        lower = np.nan if joint.lower is None else joint.lower
        upper = np.nan if joint.upper is None else joint.upper
        shown = [number(scale * value, 2) for value in (low, high, lower, upper)]
        rows.append((joint.name, unit, *shown, _used_share(low, high, lower, upper)))
    return Table(
        "Joint values of the estimation rows",
        ("joint", "unit", "lowest", "highest", "lower", "upper", "used [%]"),
        rows,
        "llrrrrr",
        "Used: share of the range between the limits. Outside the measured range (extrapolation) errors may be "
        "larger.",
        (("", 2), ("measured", 2), ("limit", 2), ("", 1)),
    )


def _used_share(low: float, high: float, lower: float, upper: float) -> str:
    """Write the share [%] of the range from ``lower`` to ``upper`` that lies between ``low`` and ``high``."""
    if not upper > lower:  # NaN: a joint without limits
        return "-"
    inside = max(0.0, min(high, upper) - max(low, lower))
    return number(100.0 * inside / (upper - lower), 0)


def _row_columns(c: Calibration, indices: NDArray[np.int_]) -> tuple[list[str], list[list[str]]]:
    """Return heads and cells that identify rows: their number; kind, target and station where there are several.

    Args:
        c: The result.
        indices: Indices of the rows in the table of measurements, from 0, shape (K,).

    Returns:
        The heads, and a list of cells for each of the K rows.
    """
    m = c.fit.measurements
    columns: list[tuple[str, Sequence[object]]] = [("row", m.rows)]
    optional = (("kind", m.kinds), ("target", m.targets), ("station", m.groups))
    for name, values in optional:
        if len(set(values)) > 1:
            columns.append((name, values))
    heads = [name for name, _ in columns]
    cells = [[str(values[i]) for _, values in columns] for i in indices]
    return heads, cells
