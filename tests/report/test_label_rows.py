"""Which rows are flagged, how far off they are, and where the target was."""

from __future__ import annotations

import numpy as np
import pytest

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
