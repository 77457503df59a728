"""The tables of a calibration: errors, rows, parameters, geometry, joint ranges, models tried, intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.basics.arrays import rigid_inverse
from calib.basics.channels import RESIDUAL_UNITS
from calib.model.dh_table import dh_table
from calib.model.families import unit_of
from calib.numerics.errors import Errors, interval_factor
from calib.result.calibration import Calibration
from calib.result.fitted_model import ParameterEstimate
from calib.result.transforms import known_transforms, plain_name
from calib.show.blocks import HTML, TERMINAL
from calib.show.error_tables import (
    ERROR_COLUMNS,
    ErrorColumn,
    ErrorRow,
    error_cells,
    error_texts,
    sizes_of_errors,
)
from calib.show.lines import number
from calib.show.tables import (
    MOST_LISTED,
    Cell,
    Column,
    Label,
    Row,
    Table,
    name_column,
    residual_column,
)
from calib.show.words import joint_unit, with_unit
from calib.verbs.calibrate.text import errorless, held_out_text, shown_parameters

#: Number of validation rows listed if there are more than `MOST_LISTED`: those with the largest errors.
MOST_WORST = 20

#: Least change of an origin that is listed, [m] along or [rad] about an axis: rounding of the URDF's digits is less.
_LEAST_DISPLACEMENT = 1e-9

#: Indices of the angles alpha, theta and beta among the five DH parameters of a row.
_DH_ANGLES = [1, 3, 4]

#: Transforms that are listed; the others are counted.
_MOST_TRANSFORMS = {TERMINAL: 12, HTML: MOST_LISTED}

#: Columns of the five DH parameters.
_DH_COLUMNS = (
    Column("a [mm]", unit="mm"),
    Column("alpha [deg]", unit="deg", digits=4),
    Column("d [mm]", unit="mm"),
    Column("theta [deg]", unit="deg", digits=4),
    Column("beta [deg]", unit="deg", digits=4),
)


# Errors of sets of rows


def error_rows(c: Calibration) -> list[ErrorRow]:
    """Return the rows of the error tables: nominal and calibrated, by set, and on held-out rows.

    Held-out rows have the non-geometric model too, and if there are outliers, the errors without them as well. Those of
    the nominal robot are left out if a measurement frame was not found: they are those of its wrong place.
    """
    rows = []
    for name in ("estimation", "validation"):
        for who, errors in c.errors.items():
            if who != "nominal" or c.rows.nominal_is_judged:
                label = f"{name} rows, {who}"
                rows.append(ErrorRow(label, errors[name], strong=who == "calibrated"))
    validations = {"nominal": c.trust.nominal_cross_validation, "calibrated": c.cross_validation}
    if c.non_geometric is not None:
        validations["non_geometric"] = c.non_geometric.cross_validation
    for who, validation in validations.items():
        if validation is None:
            continue
        label, strong = f"held-out rows*, {who}", who == "calibrated"
        rows.append(ErrorRow(label, validation.errors, strong))
        if c.rows.outliers:
            without = Label(f"{label}, without outliers", "  the same without outliers")
            rows.append(ErrorRow(without, validation.errors_without_outliers, strong))
    return rows


def errors_at_board(c: Calibration) -> dict[str, Errors]:
    """Return errors of images as lengths at the board [m], by the labels of `error_rows`; empty without images."""
    rows = {}
    by_robot = c.rows.errors_at_board
    for name in ("estimation", "validation"):
        for who, sets in by_robot.items():
            if name in sets:
                rows[f"{name} rows, {who}"] = sets[name]
    validations = {"nominal": c.trust.nominal_cross_validation, "calibrated": c.cross_validation}
    for who, validation in validations.items():
        errors = c.rows.held_out_errors_at_board(validation)
        if errors is not None:
            rows[f"held-out rows*, {who}"] = errors
    return rows


def image_errors(c: Calibration, columns: Sequence[ErrorColumn] = ERROR_COLUMNS) -> Table:
    """Tabulate, for HTML, the errors of each set of rows in the image [px], and beside them at the board [mm].

    The columns are those of ``columns`` that are not optional. Without images there are no rows.
    """
    at_board = errors_at_board(c)
    nothing = Errors({})
    sizes = sizes_of_errors(columns)
    rows: list[Row] = []
    strong = []
    for row in error_rows(c) if at_board else ():
        in_image = row.errors["px"]
        if not in_image.n:
            continue
        if row.strong:
            strong.append(len(rows))
        label = row.label if isinstance(row.label, str) else row.label.full
        lengths = at_board.get(label, nothing)["m"]
        rows.append(
            (row.label, in_image.n, *error_cells(in_image, sizes), *error_cells(lengths, sizes))
        )
    notes = [f"{held_out_text(c)}."] if c.cross_validation is not None else []
    notes.append(
        "An error at the board is that in the image times the corner's distance along the camera's axis over the focal "
        "length: across the line of sight."
    )
    return Table(
        "Errors of corners by set of rows, in the image [px] and at the board [mm]",
        (
            name_column("rows, robot"),
            Column("rows"),
            *(size.column("px", "in the image [px]") for size in sizes),
            *(size.column("m", "at the board [mm]") for size in sizes),
        ),
        rows,
        " ".join(notes),
        strong,
        on=HTML,
    )


def before_and_after(c: Calibration, columns: Sequence[ErrorColumn] = ERROR_COLUMNS) -> Table:
    """Tabulate the errors of rows that took no part in the fit, of the nominal robot beside the calibrated one.

    In each unit that was measured these are validation and held-out rows, or the estimation rows if there are neither;
    below them those of images as lengths at the board.
    """
    nominal, calibrated = c.errors["nominal"], c.errors["calibrated"]
    sets = [("validation rows", nominal["validation"], calibrated["validation"])]
    before, after = c.trust.nominal_cross_validation, c.cross_validation
    if before is not None and after is not None:
        sets.append(("held-out rows", before.errors, after.errors))
        if c.rows.outliers:
            without = before.errors_without_outliers, after.errors_without_outliers
            sets.append(("held-out, without outliers", *without))
    if not any(errors.leading.n for _, _, errors in sets):
        sets = [("estimation rows", nominal["estimation"], calibrated["estimation"])]

    sizes = sizes_of_errors(columns)
    rows: list[Row] = []

    def add_rows(name: str, unit: str, labelled: Sequence[tuple[str, Errors, Errors]]) -> None:
        """Add a row for each set that has errors, nominal and calibrated, in a unit; only the first has the name."""
        for label, of_nominal, of_calibrated in labelled:
            figures = of_nominal[unit], of_calibrated[unit]
            if figures[1].n:
                texts = (*error_texts(figures[0], sizes), *error_texts(figures[1], sizes))
                rows.append((name, label, figures[1].n, *texts))
                name = ""

    for unit in c.rows.channels.present:
        add_rows(f"{RESIDUAL_UNITS[unit].measured} [{RESIDUAL_UNITS[unit].shown}]", unit, sets)
    at_board = errors_at_board(c)
    for labels in (("validation rows", "held-out rows*"), ("estimation rows",)):
        robots = [(label, f"{label}, nominal", f"{label}, calibrated") for label in labels]
        of_images = [
            (label.rstrip("*"), at_board[nominal], at_board[calibrated])
            for label, nominal, calibrated in robots
            if nominal in at_board and calibrated in at_board
        ]
        if of_images:
            add_rows("position at the board [mm]", "m", of_images)
            break
    heads = [Column(size.head, group="before: nominal") for size in sizes]
    heads += [Column(size.head, group="after: calibrated") for size in sizes]
    return Table(
        "Size of the error by set of rows",
        (name_column("error of"), name_column("rows"), Column("number"), *heads),
        rows,
    )


# Errors of single rows


def validation_rows(c: Calibration) -> Table:
    """Tabulate, for HTML, the errors of single validation rows before and after calibration.

    Residuals along the axes of the measurement frame, measured minus predicted, and their norm [mm]; of orientations
    the angle [deg], of images the norm [px]. Of more than `MOST_LISTED` rows the `MOST_WORST` with the largest errors
    after calibration are listed, in the order of the measurement.
    """
    channels = c.rows.channels
    before_after = (
        ("before: nominal", c.rows.residual_nominal),
        ("after: calibrated", c.rows.residual_calibrated),
    )
    indices = np.flatnonzero(c.rows.validation & np.any(channels.used, axis=1))
    subject = f"the {len(indices):,} validation rows"
    if len(indices) > MOST_LISTED:
        subject = f"the {MOST_WORST} of {len(indices):,} validation rows with the largest error after calibration"
        sizes = channels.norms(c.rows.residual_calibrated, channels.present[0])[indices]
        worst = np.argsort(-np.nan_to_num(sizes), kind="stable")[:MOST_WORST]
        indices = indices[np.sort(worst)]

    columns, values = _row_names(c, indices)
    note = ""
    for unit in channels.select(indices).present:
        of_unit = RESIDUAL_UNITS[unit]
        if unit != "m":
            group = f"{of_unit.measured} [{of_unit.shown}]"
            for head, (_, residual) in zip(("before", "after"), before_after, strict=True):
                columns.append(residual_column(head, unit, group=group))
                values.append(channels.norms(residual, unit)[indices].tolist())
            continue
        along, are_vectors = channels.vector_columns(unit)
        for robot, residual in before_after:
            group = f"{robot} [{of_unit.shown}]"
            if np.any(are_vectors[indices]):
                note = (
                    "dx, dy, dz: measured minus predicted along the axes of the measurement frame."
                )
                vectors = np.where(are_vectors[:, None], residual[:, along], np.nan)[indices]
                columns += [residual_column(f"d{axis}", unit, group=group) for axis in "xyz"]
                values += vectors.T.tolist()
            columns.append(residual_column("size", unit, group=group))
            values.append(channels.norms(residual, unit)[indices].tolist())
    title = f"Error of {subject}, which took no part in the fit"
    return Table(title, columns, list(zip(*values, strict=True)), note, on=HTML)


def flagged(c: Calibration) -> Table:
    """Tabulate, for HTML, the flagged rows of either set: errors before and after, score, and weight in the fit.

    Errors are norms in the first unit that was measured; the score is in standard deviations.
    """
    outliers = [*c.rows.outliers, *c.rows.suspects]
    index_of = {row: i for i, row in enumerate(c.rows.numbers)}
    indices = np.array([index_of[outlier.row] for outlier in outliers], dtype=np.int_)
    unit = c.rows.channels.present[0]
    shown = RESIDUAL_UNITS[unit].shown
    residuals = (c.rows.residual_nominal, c.rows.residual_calibrated)
    before, after = (c.rows.channels.norms(residual, unit)[indices] for residual in residuals)
    columns, values = _row_names(c, indices)
    columns += [
        name_column("set"),
        residual_column(f"before [{shown}]", unit),
        residual_column(f"after [{shown}]", unit),
        Column("score", digits=1),
        Column("weight", digits=2),
    ]
    values += [
        [c.rows.sets[i] for i in indices],
        before.tolist(),
        after.tolist(),
        [outlier.score for outlier in outliers],
        c.rows.weights[indices].tolist(),
    ]
    return Table(
        "Rows flagged",
        columns,
        list(zip(*values, strict=True)),
        "Score: distance from what the other rows predict, in standard deviations. Estimation rows are flagged "
        f"beyond {c.rows.flag_limit:.1f}.",
        most={HTML: MOST_LISTED},
        elsewhere="the result file (--json)",
        on=HTML,
    )


def _row_names(
    c: Calibration, indices: NDArray[np.int_]
) -> tuple[list[Column], list[Sequence[Cell]]]:
    """Return columns, and the cells of each, that identify rows by their indices (k,), from 0.

    They are the row's number, and its kind, target and station if the result has several of these.
    """
    columns = [name_column("row")]
    values: list[Sequence[Cell]] = [[str(c.rows.numbers[i]) for i in indices]]
    optional = (("kind", c.rows.kinds), ("target", c.rows.targets), ("station", c.rows.groups))
    for name, of_rows in optional:
        if len(set(of_rows)) > 1:
            columns.append(name_column(name))
            values.append([of_rows[i] for i in indices])
    return columns, values


# Parameters and geometry


def parameters(c: Calibration) -> Table:
    """Tabulate, for a terminal, the parameters with half their 95 % intervals, each in the unit in which it is shown.

    A star marks those known in combination with others only, a hash those kept nominal, whose family has no errors.
    """
    kept = errorless(c)
    rows = []
    for p in shown_parameters(c):
        factor, unit = _shown_unit(p)
        nominal = change = "-"
        if p.nominal is not None:
            nominal = number(factor * p.nominal)
            change = number(factor * p.delta, 3, "+")
        half = f"{0.5 * factor * (p.high - p.low):.3g}"
        mark = "" if p.identifiable else " *"
        if p.at_bound:
            half = "at bound"
        if p.name in kept:
            half, mark = "-", " #"
        rows.append((p.name, nominal, number(factor * p.value), change, half, f"{unit}{mark}"))
    columns = (
        name_column(""),
        Column("nominal", 11, gap=2),
        Column("value", 11),
        Column("change", 10),
        Column("95 % ±", 9),
        Column("", left=True),
    )
    return Table("Parameter", columns, rows, on=TERMINAL)


def parameters_in(c: Calibration, unit: str) -> Table:
    """Tabulate, for HTML, nominal and calibrated value, correction and half the 95 % interval of some parameters.

    Args:
        c: The result.
        unit: ``"mm"`` for the lengths of the model, ``"deg"`` for everything else.

    Returns:
        One row a parameter. Half the interval is ``-`` for a parameter stopped by a bound and for one that stayed
        nominal because its family has no errors; so are nominal value and correction of one that was not given.
    """
    kept = errorless(c)
    rows = []
    for p in shown_parameters(c):
        if (p.unit == "m") != (unit == "mm"):
            continue
        nominal = math.nan if p.nominal is None else p.nominal
        change = math.nan if p.nominal is None else p.delta
        half = math.nan if p.at_bound or p.name in kept else 0.5 * (p.high - p.low)
        determined = "yes" if p.identifiable else "jointly"
        if p.at_bound:
            determined = "at bound"
        if p.name in kept:
            determined = "kept"
        rows.append((p.name, nominal, p.value, change, half, determined))
    digits = 3 if unit == "mm" else 4
    columns = (
        name_column("parameter"),
        Column("nominal", unit=unit, digits=digits),
        Column("calibrated", unit=unit, digits=digits),
        Column("correction", unit=unit, digits=digits, sign="+"),
        Column("95 % ±", unit=unit, digits=digits),
        name_column("determined"),
    )
    title = "Lengths [mm]" if unit == "mm" else "Angles [deg]"
    return Table(title, columns, rows, on=HTML)


def non_geometric(c: Calibration) -> Table:
    """Tabulate the parameters of the non-geometric model that the geometry lacks; no rows without that model."""
    name, further = "", []
    if c.non_geometric is not None:
        name = c.non_geometric.name
        further = [p for p in c.non_geometric.parameters if p.name not in c.model.names]
    rows = []
    for p in further:
        factor, unit = unit_of(p.unit).shown
        half = "at bound" if p.at_bound else f"± {0.5 * factor * (p.high - p.low):.3f}"
        rows.append((p.name, number(factor * p.value), half, unit))
    columns = (
        name_column("parameter", 48),
        Column("value", 9),
        name_column("interval"),
        name_column("unit"),
    )
    title = f"Non-geometric model '{name}', not in the URDF"
    note = "Interval: half of the 95 % interval. The result file has this model."
    return Table(title, columns, rows, note, title_above=True, indent="  ")


def dh(c: Calibration) -> Table:
    """Tabulate, for HTML, the DH rows of the nominal and of the calibrated robot, and their differences [mm, deg].

    They are standard ones, Hayati's between nearly parallel axes; where the robots' rows differ in that, dashes stand
    for the differences.
    """
    before = dh_table(c.nominal).rows
    after = dh_table(c.robot, like=c.nominal).rows
    tilted = any(row.near_parallel for row in (*before, *after))
    # Without nearly parallel axes beta is zero everywhere.
    columns = _DH_COLUMNS if tilted else _DH_COLUMNS[:-1]
    hayati = ""
    if tilted:
        hayati = " Ry(beta), with Hayati's beta between nearly parallel axes, where d is 0"
    rows: list[Row] = []
    for nominal_row, calibrated_row in zip(before, after, strict=True):
        nominal, calibrated = (
            np.array([row.a, row.alpha, row.d, row.theta, row.beta])
            for row in (nominal_row, calibrated_row)
        )
        change = calibrated - nominal
        change[_DH_ANGLES] = np.angle(np.exp(1j * change[_DH_ANGLES]))
        if nominal_row.near_parallel != calibrated_row.near_parallel:
            change[:] = np.nan  # their conventions differ
        signed = [
            replace(column, sign="+").text(value)
            for column, value in zip(columns, change.tolist(), strict=False)
        ]
        count = len(columns)
        rows.append((nominal_row.joint, "nominal", *nominal.tolist()[:count]))
        rows.append(("", "calibrated", *calibrated.tolist()[:count]))
        rows.append(("", "change", *signed))
    return Table(
        "DH rows before and after",
        (name_column("joint"), name_column("robot"), *columns),
        rows,
        f"Standard convention: Rz(theta + q) Tz(d) Tx(a) Rx(alpha){hayati}. The rows are read off both URDFs; frame 0 "
        "and the tip after the last row may have moved too, which the next table shows.",
        strong=range(2, 3 * len(before), 3),
        on=HTML,
    )


def origins(c: Calibration) -> Table:
    """Tabulate the displacement of each joint origin that changed: shift [mm] and rotation vector [mrad].

    Both are of T_nominal_calibrated, along and about the axes of the nominal origin.
    """
    after = c.robot.origins()
    rows: list[Row] = []
    for joint, T_parent_nominal in c.nominal.origins().items():
        T_nominal_calibrated = rigid_inverse(T_parent_nominal) @ after[joint]
        rotation = pin.log3(T_nominal_calibrated[:3, :3])
        twist = np.concatenate([T_nominal_calibrated[:3, 3], rotation])
        if np.abs(twist).max() > _LEAST_DISPLACEMENT:
            rows.append((joint, *twist.tolist()))
    shift = [Column(axis, unit="mm", sign="+", group="shift [mm]") for axis in "xyz"]
    turn = [
        Column(f"r{axis}", unit="mrad", sign="+", group="rotation vector [mrad]") for axis in "xyz"
    ]
    return Table(
        "Displacement of each <origin> of the corrected URDF from the nominal one",
        (name_column("joint"), *shift, *turn),
        rows,
        "Along and about the axes of the nominal origin. All else in the URDF is unchanged.",
        on=HTML,
    )


def ranges(c: Calibration) -> Table:
    """Tabulate, for HTML, the range of each measured joint in the estimation rows beside its limits, [deg] or [mm].

    Dashes stand for limits that it does not have, and for the share of the range between them.
    """
    m = c.fit.measurements
    q = m.joints_for(c.nominal.joint_names)[m.estimation]
    values_of_joints = c.nominal.input_values(q).T
    rows: list[Row] = []
    for joint, values in zip(c.nominal.inputs, values_of_joints, strict=True):
        factor, unit = joint_unit(prismatic=joint.type == "prismatic")
        low, high = values.min(), values.max()
        lower = np.nan if joint.lower is None else joint.lower
        upper = np.nan if joint.upper is None else joint.upper
        used = math.nan
        if upper > lower:  # NaN: a joint without limits
            used = 100.0 * max(0.0, min(high, upper) - max(low, lower)) / (upper - lower)
        ends = [number(factor * value, 2) for value in (low, high, lower, upper)]
        rows.append((joint.name, unit, *ends, float(used)))
    return Table(
        "Joint values of the estimation rows",
        (
            name_column("joint"),
            name_column("unit"),
            Column("lowest", group="measured"),
            Column("highest", group="measured"),
            Column("lower", group="limit"),
            Column("upper", group="limit"),
            Column("used [%]", digits=0),
        ),
        rows,
        "Used: share of the range between the limits. Outside the measured range (extrapolation) errors may be "
        "larger.",
        on=HTML,
    )


# Chains


def chains(c: Calibration) -> Table:
    """Tabulate what the geometry is worth for each chain: held-out and expected errors, and the verdict.

    Errors are without outliers, in the first unit that was measured. There are no rows for a robot of one chain.
    """
    rows: list[Row] = []
    for chain in c.trust.chains:
        before, after = chain.nominal.leading, chain.calibrated.leading
        rows.append(
            (
                f"{chain.base} to {chain.tip}",
                chain.rows,
                with_unit(before.rms, before.unit),
                with_unit(after.rms, after.unit),
                with_unit(chain.expected, "m"),
                chain.verdict.use,
            )
        )
    columns = (
        name_column("", 40),
        Column("rows", 6),
        Column("nominal", 12),
        Column("calibrated", 12),
        Column("expected", 12),
        Column("verdict", left=True, gap=2),
    )
    return Table(
        "Chains: rms error on held-out rows, and that of predictions over the joint limits",
        columns,
        rows,
        indent="  ",
    )


# Transforms


def transforms(c: Calibration) -> Table:
    """Tabulate the transforms between frames, boards, links and robots that are on one body, with 95 % intervals.

    Half an interval is that along the direction, or about the axis, for which it is widest. Transforms of which nothing
    was estimated are left out; of one robot seen from one frame there are no rows.
    """
    factor = interval_factor(c.noise.freedom)
    rows: list[Row] = []
    for one in known_transforms(c):
        if not one.covariance.any():
            continue
        angles = pin.rpy.matrixToRpy(one.pose[:3, :3])
        rows.append(
            (
                f"{plain_name(one.from_name)} to {plain_name(one.to_name)}",
                *one.pose[:3, 3].tolist(),
                factor * one.position_std,
                *angles.tolist(),
                factor * one.orientation_std,
            )
        )
    lengths = [Column(f"{axis} [mm]", 10, unit="mm") for axis in "xyz"]
    turns = [
        Column(f"{axis} [deg]" if axis == "roll" else axis, 8, unit="deg", digits=3)
        for axis in ("roll", "pitch", "yaw")
    ]
    return Table(
        "Transforms: pose of the second in the first, and half its 95 % interval where that is widest",
        (
            name_column("", 26),
            *lengths,
            Column("± mm", 7, unit="mm"),
            *turns,
            Column("± deg", 7, unit="deg", digits=4),
        ),
        rows,
        most=_MOST_TRANSFORMS,
        elsewhere="Calibration.transform",
    )


# Models and intervals


def models(c: Calibration) -> Table:
    """Tabulate, for a terminal, the models that were tried: evidence relative to the best, rms error, and use.

    The rms error is that on held-out rows without outliers, in the first unit that was measured.
    """
    candidates = c.method.candidates
    best = max((candidate.evidence for candidate in candidates), default=0.0)
    uses = {"geometry": "the URDF", "non_geometric": "predict()"}
    rows: list[Row] = []
    for candidate in candidates:
        figures = candidate.cross_validation.errors_without_outliers.leading
        rms = with_unit(figures.rms, figures.unit)
        use = uses.get(candidate.chosen, "")
        evidence = f"{candidate.evidence - best:.1f}"
        rows.append((candidate.name, candidate.parameters, evidence, rms, use))
    columns = (
        name_column("", 35),
        Column("parameters", 10),
        Column("evidence", 9),
        Column("held-out rms", 15),
        Column("chosen for", left=True, gap=2),
    )
    return Table("Models tried", columns, rows, indent="  ", on=TERMINAL)


def intervals(method: str, rows: Sequence[tuple[ParameterEstimate, float, float]]) -> Table:
    """Tabulate the 95 % intervals of parameters by the covariance beside those of another method.

    Args:
        method: Name of the other method.
        rows: Each parameter with the ends of its interval by this method, in SI units; an infinite end is open.
    """

    def interval(low: float, high: float) -> str:
        ends = [number(end) if math.isfinite(end) else "open" for end in (low, high)]
        return f"{ends[0]:>9} .. {ends[1]:>10}"

    cells = []
    for p, low, high in rows:
        factor, unit = _shown_unit(p)
        covariance = "at bound" if p.at_bound else interval(factor * p.low, factor * p.high)
        other = interval(factor * low, factor * high)
        cells.append((p.name, number(factor * p.value), covariance, other, unit))
    columns = (
        name_column(""),
        Column("value", 10, gap=2),
        Column("covariance", 23),
        Column(method, 23),
        Column("", left=True),
    )
    return Table("95 % intervals", columns, cells, tight=True)


def _shown_unit(p: ParameterEstimate) -> tuple[float, str]:
    """Return the factor from SI, and the symbol, of the unit in which a parameter is shown: angles in deg."""
    return (math.degrees(1.0), "deg") if p.unit == "rad" else unit_of(p.unit).shown
