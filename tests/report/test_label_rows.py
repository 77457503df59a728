"""Which rows are flagged, how far off they are, and where the target was."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from calib.report import label_rows as rows
from calib.report.figure_base import new_figure, number_points, row_kinds, rows_text
from calib.report.label_rows import angles_of, flagged_rows, lengths_of


def test_every_row_is_of_one_kind(calibrations):
    c = calibrations.made("with_outliers")
    kinds = row_kinds(c)
    assert [kind.word for kind in kinds] == ["estimation", "validation", "outlier"]
    assert np.all(np.sum([kind.mask for kind in kinds], axis=0) == 1)
    flagged = {one.row for one in (*c.outliers, *c.suspects)}
    assert {c.measurements.rows[k] for k in np.flatnonzero(flagged_rows(c))} == flagged
    assert kinds[2].handle().get_label() == f"{len(flagged)} outliers"
    assert len({(kind.colour, kind.marker) for kind in kinds}) == 3
    assert rows_text(np.array([True]), "estimation") == "1 estimation row"


def test_sizes_of_errors_are_those_of_the_tables(calibrations):
    c = calibrations.made("poses")
    v = c.measurements.validation
    lengths, angles = (size(c.residual_calibrated, c.used)[v] for size in (lengths_of, angles_of))
    errors = c.errors["calibrated"]["validation"]
    assert lengths.max() == pytest.approx(errors.max, rel=1e-12)
    assert np.sqrt(np.mean(angles**2)) == pytest.approx(errors.rms_angle, rel=1e-12)


def test_few_points_are_numbered_and_many_are_not(calibrations):
    m = calibrations.made("paper").measurements
    ax = new_figure(2.0).subplots()
    number_points(ax, m.rows, m.points[:, :2], m.validation)
    assert [text.get_text() for text in ax.texts] == ["31", "32", "33", "34", "35"]
    number_points(ax, m.rows, m.points[:, :2], m.estimation)
    assert len(ax.texts) == 5


#: Those that stand in one picture for different things.
GROUPS = (
    ("NOMINAL", "CALIBRATED", "MEASURED"),
    ("ESTIMATION", "VALIDATION", "OUTLIER"),
)


def linear(colour):
    rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def lab(rgb):
    XYZ = np.array(
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    ) @ np.clip(rgb, 0.0, 1.0)
    t = XYZ / np.array([0.9505, 1.0, 1.089])
    f = np.where(t > 0.008856, np.cbrt(t), 7.787 * t + 16.0 / 116.0)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


def test_the_robots_differ_in_grey_print_and_all_stand_out_from_paper():
    lightness = [lab(linear(getattr(rows, name)))[0] for name in GROUPS[0]]
    assert min(abs(a - b) for a, b in itertools.combinations(lightness, 2)) > 18.0
    for name in {*GROUPS[0], *GROUPS[1], "INK", "SOFT"}:
        light = float(np.array([0.2126, 0.7152, 0.0722]) @ linear(getattr(rows, name)))
        assert 1.05 / (0.05 + light) > (4.5 if name in ("INK", "SOFT") else 2.4), name
