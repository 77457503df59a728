"""Which rows are which in figures, and where and how far off they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.show.figure_base import new_figure
from calib.show.figure_rows import (
    angles_of,
    counted,
    flagged_rows,
    free_sides,
    has_angles,
    has_axes,
    left_out,
    lengths_of,
    measured_places,
    number_points,
    row_axis,
    row_kinds,
)


def test_every_row_is_of_one_kind(calibrations):
    c = calibrations.made("with_outliers")
    kinds = row_kinds(c)
    assert [kind.word for kind in kinds] == ["estimation", "validation", "outlier"]
    assert np.all(np.sum([kind.mask for kind in kinds], axis=0) == 1)
    flagged = {one.row for one in (*c.outliers, *c.suspects)}
    assert {c.measurements.rows[k] for k in np.flatnonzero(flagged_rows(c))} == flagged
    assert kinds[2].label == f"{len(flagged)} outliers"
    assert len({(kind.colour, kind.marker) for kind in kinds}) == 3


def test_labels_count(calibrations):
    c = calibrations.made("one_row")
    assert [kind.label for kind in row_kinds(c)] == ["1 estimation row"]
    assert counted(c) == "1 estimation row"
    assert counted(calibrations.made("paper")) == "30 estimation rows and 5 validation rows"


def test_sizes_of_errors_are_those_of_the_tables(calibrations):
    c = calibrations.made("poses")
    v = c.measurements.validation
    lengths, angles = (size(c, c.residual_calibrated)[v] for size in (lengths_of, angles_of))
    errors = c.errors["calibrated"]["validation"]
    assert lengths.max() == pytest.approx(errors.max, rel=1e-12)
    assert np.sqrt(np.mean(angles**2)) == pytest.approx(errors.rms_angle, rel=1e-12)


def test_what_was_not_measured_is_no_number(calibrations):
    c = calibrations.made("mixed")
    poses = c.measurements.of_kind("pose")
    np.testing.assert_array_equal(np.isfinite(angles_of(c, c.residual_nominal)), poses)
    assert has_angles(c)
    distances = calibrations.made("distances")
    assert not has_axes(distances)
    assert not has_angles(distances)
    expected = np.abs(distances.residual_nominal[:, 0])
    np.testing.assert_allclose(lengths_of(distances, distances.residual_nominal), expected)


def test_left_out_rows_stand_where_they_belong(calibrations):
    c = calibrations.made("paper")
    found = left_out(c, c.cross_validation)
    m = c.measurements
    np.testing.assert_array_equal(found[m.estimation], c.cross_validation.residual)
    assert np.all(np.isnan(found[m.validation]))
    assert left_out(c, None) is None


def test_places_are_in_the_base(calibrations):
    c = calibrations.made("paper")
    places, seen = measured_places(c)
    np.testing.assert_allclose(places, c.measurements.points)
    assert np.all(seen)
    # Found in a tracker's frame: the calibrated robot is where it was seen, but for its errors.
    tracker = calibrations.made("poses")
    places, _ = measured_places(tracker)
    T = tracker.robot.poses(tracker.measurements.joints)
    expected = T[:, :3, :3] @ tracker.target + T[:, :3, 3]
    np.testing.assert_allclose(places, expected, atol=2e-4)
    assert np.abs(places - tracker.measurements.points).max() > 0.5


def test_places_that_nobody_measured_are_predicted(calibrations):
    c = calibrations.made("distances")
    places, seen = measured_places(c)
    assert not np.any(seen)
    T = c.robot.poses(c.measurements.joints)
    np.testing.assert_allclose(places, T[:, :3, :3] @ c.target + T[:, :3, 3])


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        (range(31, 36), ["31", "32", "33", "34", "35"]),
        ((7,), ["7"]),
        ((3, 8, 900), ["3", "8", "900"]),
        (range(1, 36), ["5", "10", "15", "20", "25", "30", "35"]),
    ],
)
def test_rows_are_labelled_with_their_numbers(numbers, expected):
    ax = new_figure(2.0).subplots()
    row_axis(ax, list(numbers), 9)
    places = ax.xaxis.get_majorticklocs()
    assert [ax.xaxis.get_major_formatter()(place, 0) for place in places] == expected
    low, high = ax.get_xlim()
    assert low < 0 <= len(numbers) - 1 < high


def test_few_points_are_numbered_and_many_are_not(calibrations):
    c = calibrations.made("paper")
    ax = new_figure(2.0).subplots()
    number_points(ax, c, c.measurements.points[:, :2])
    assert {text.get_text() for text in ax.texts} == {"11", "14", "31", "32", "33", "34", "35"}
    ax = new_figure(2.0).subplots()
    number_points(ax, c, c.measurements.points[:, :2], only=("outlier",))
    assert [text.get_text() for text in ax.texts] == ["11", "14"]
    many = replace(c.measurements, sets=("validate",) * 35)
    number_points(ax, replace(c, measurements=many), c.measurements.points[:, :2])
    assert len(ax.texts) == 2


def test_numbers_stand_where_there_is_room():
    places = np.array([[0.0, 0.0], [0.5, 0.5], [0.53, 0.52], [1.0, 1.0]])
    sides = free_sides(places, [1, 3])
    assert sides[0] != (1, 1)  # there the next point is
    assert sides[1] == (-1, -1)  # elsewhere it would leave the panel
