"""The tables of a certificate: deviations by point, their summary, validity, decision."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from calib.basics.channels import RESIDUAL_UNITS
from calib.show.lines import number, row_ranges
from calib.show.tables import Column, Row, Table, name_column
from calib.show.words import joint_unit
from calib.verbs.certificate.certificate import Certificate
from calib.verbs.certificate.points import Point
from calib.verbs.certificate.text import probability, with_uncertainty

#: A number of degrees of freedom from here on is as good as infinite.
_MANY = 1000.0


def summary_table(c: Certificate) -> Table:
    """Tabulate the largest deviation as found and as left in each unit, with the largest U."""
    rows: list[Row] = []
    for unit in c.units:
        shown = RESIDUAL_UNITS[unit]
        of_unit = c.of(unit)
        found = np.array([one.found for one in of_unit])
        left = np.array([one.left for one in of_unit])
        widest = max(one.uncertainty for one in of_unit)
        before, _ = with_uncertainty(float(np.max(found)), widest, unit)
        after, expanded = with_uncertainty(float(np.max(left)), widest, unit)
        decision = c.decisions.get(unit)
        tolerance = "" if decision is None else f"{shown.to_shown * decision.check.tolerance:g}"
        outcome = "" if decision is None else decision.check.outcome
        label = f"{shown.measured} [{shown.shown}], largest of {len(of_unit)}"
        rows.append((label, before, after, expanded, tolerance, outcome))
    columns = (
        name_column("deviation", 30),
        *(Column(head, 9) for head in ("as found", "as left", "U")),
        Column("tolerance", 9, optional=True),
        Column("outcome", 9, optional=True),
    )
    return Table("Deviations as found and as left", columns, rows, indent="  ")


def point_tables(c: Certificate) -> Iterator[Table]:
    """Tabulate the deviations at each point, a table for each unit."""
    for unit in c.units:
        shown = RESIDUAL_UNITS[unit]
        rows: list[Row] = [
            (*_names(point), *_figures(point, unit))
            for point in c.points
            if unit in point.deviations
        ]
        columns = (
            name_column("rows", 8),
            *(Column(f"{axis} [mm]", 8, unit="mm", digits=1) for axis in "xyz"),
            *(Column(head, 9) for head in ("as found", "as left", "U")),
            Column("k", 5),
            Column("d.o.f.", 7),
            Column("U pose", 8),
            Column("P(within)", 9, optional=True),
        )
        yield Table(
            f"Deviations of the {shown.measured} [{shown.shown}]",
            columns,
            rows,
            note=(
                "x, y, z: place in the base. U: expanded uncertainty of both deviations, "
                "95.45 % (k = 2 along one direction); k = U over the combined standard uncertainty of the three axes; "
                "d.o.f.: effective degrees of freedom, a dash: infinite. U pose: expanded uncertainty of the pose "
                "that the calibrated robot reaches there. P(within): probability that the deviation as left is within "
                "the tolerance."
            ),
            title_above=True,
            indent="  ",
        )


def _names(point: Point) -> tuple[str, float, float, float]:
    """Return the rows of a point and its place."""
    x, y, z = (float(value) for value in point.position)
    return row_ranges(point.rows), x, y, z


def _figures(point: Point, unit: str) -> tuple[str, ...]:
    """Return the cells of a point's deviation."""
    one = point.deviations[unit]
    found, _ = with_uncertainty(one.found, one.uncertainty, unit)
    left, expanded = with_uncertainty(one.left, one.uncertainty, unit)
    _, of_pose = with_uncertainty(0.0, one.of_pose, unit)
    likely = "" if math.isnan(one.conformance) else probability(one.conformance)
    return found, left, expanded, number(one.factor, 2), _freedom(one.freedom), of_pose, likely


def _freedom(freedom: float) -> str:
    """Write degrees of freedom, rounded down (JCGM 100, G.4.1); a dash for infinitely many."""
    if not math.isfinite(freedom):
        return "-"
    return f"> {_MANY:,.0f}" if freedom > _MANY else f"{math.floor(freedom)}"


def box_table(c: Certificate) -> Table:
    """Tabulate by joint where the certificate is valid: calibrated, tested, limits."""
    rows: list[Row] = []
    for one in c.box:
        factor, unit = joint_unit(prismatic=one.prismatic)
        cells = [
            f"{number(factor * low, 1)} to {number(factor * high, 1)}"
            for low, high in (one.calibrated, one.tested, one.limits)
        ]
        rows.append((f"{one.joint} [{unit}]", *cells))
    columns = (
        name_column("joint", 26),
        *(Column(head, 20) for head in ("valid (calibrated)", "tested", "limits")),
    )
    return Table("Valid within", columns, rows, title_above=True, indent="  ")
