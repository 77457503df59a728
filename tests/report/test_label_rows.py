"""Which rows are flagged, how far off they are, and where the target was."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from calib.report import label_rows as rows
from calib.report.figure_base import (
    free_sides,
    new_figure,
    number_points,
    row_kinds,
    rows_text,
)
from calib.report.figure_space import measured_places
from calib.report.label_rows import angles_of, flagged_rows, lengths_of, measured_in_base, placed


def test_every_row_is_of_one_kind(calibrations):
    c = calibrations.made("with_outliers")
    kinds = row_kinds(c)
    assert [kind.word for kind in kinds] == ["estimation", "validation", "outlier"]
    assert np.all(np.sum([kind.mask for kind in kinds], axis=0) == 1)
    flagged = {one.row for one in (*c.outliers, *c.suspects)}
    assert {c.measurements.rows[k] for k in np.flatnonzero(flagged_rows(c))} == flagged
    assert kinds[2].label == f"{len(flagged)} outliers"
    assert len({(kind.colour, kind.marker) for kind in kinds}) == 3
    assert rows_text(np.array([True]), "estimation") == "1 estimation row"


def test_sizes_of_errors_are_those_of_the_tables(calibrations):
    c = calibrations.made("poses")
    v = c.measurements.validation
    lengths, angles = (size(c.residual_calibrated, c.used)[v] for size in (lengths_of, angles_of))
    errors = c.errors["calibrated"]["validation"]
    assert lengths.max() == pytest.approx(errors.max, rel=1e-12)
    assert np.sqrt(np.mean(angles**2)) == pytest.approx(errors.rms_angle, rel=1e-12)


def test_what_was_not_measured_is_no_number(calibrations):
    c = calibrations.made("mixed")
    found = np.isfinite(angles_of(c.residual_nominal, c.used))
    np.testing.assert_array_equal(found, c.measurements.of_kind("pose"))
    distances = calibrations.made("distances")
    expected = np.abs(distances.residual_nominal[:, 0])
    found = lengths_of(distances.residual_nominal, distances.used)
    np.testing.assert_allclose(found, expected)


def test_places_are_in_the_base(calibrations):
    c = calibrations.made("paper")
    np.testing.assert_allclose(measured_places(c), c.measurements.points)
    # Found in a tracker's frame: the calibrated robot is where it was seen, but for its errors.
    tracker = calibrations.made("poses")
    places = measured_places(tracker)
    T = tracker.robot.poses(tracker.measurements.joints)
    expected = T[:, :3, :3] @ tracker.target + T[:, :3, 3]
    np.testing.assert_allclose(places, expected, atol=2e-4)
    assert np.abs(places - tracker.measurements.points).max() > 0.5


def test_places_that_nobody_measured_are_predicted(calibrations):
    c = calibrations.made("distances")
    assert np.all(np.isnan(measured_in_base(c.measurements, placed(c.setup, c.measurements)[0])))
    T = c.robot.poses(c.measurements.joints)
    np.testing.assert_allclose(measured_places(c), T[:, :3, :3] @ c.target + T[:, :3, 3])


def test_few_points_are_numbered_and_many_are_not(calibrations):
    m = calibrations.made("paper").measurements
    ax = new_figure(2.0).subplots()
    number_points(ax, m.rows, m.points[:, :2], m.validation)
    assert [text.get_text() for text in ax.texts] == ["31", "32", "33", "34", "35"]
    number_points(ax, m.rows, m.points[:, :2], m.estimation)
    number_points(ax, m.rows, m.points[:, :2], np.zeros(35, dtype=bool))
    assert len(ax.texts) == 5


def test_numbers_stand_where_there_is_room():
    places = np.array([[0.0, 0.0], [0.5, 0.5], [0.53, 0.52], [1.0, 1.0]])
    sides = free_sides(places, [1, 3])
    assert sides[0] != (1, 1)  # there the next point is
    assert sides[1] == (-1, -1)  # elsewhere it would leave the panel


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


def test_the_robots_differ_in_grey_print():
    lightness = [lab(linear(getattr(rows, name)))[0] for name in GROUPS[0]]
    for one, other in itertools.combinations(lightness, 2):
        assert abs(one - other) > 18.0


def test_colours_stand_out_from_paper():
    for name in {name for group in GROUPS for name in group} | {"INK", "SOFT"}:
        ratio = 1.05 / (
            0.05 + float(np.array([0.2126, 0.7152, 0.0722]) @ linear(getattr(rows, name)))
        )
        assert ratio > (4.5 if name in ("INK", "SOFT") else 2.4), name
