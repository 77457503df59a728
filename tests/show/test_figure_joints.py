"""What is left over along each joint's motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.show.figure_base import styled
from calib.show.figure_joints import (
    MOST_ROWS,
    along_joints,
    drawn_rows,
    has_mean,
    has_parts,
    joints_figure,
    mean_rows,
)


@pytest.fixture(autouse=True)
def _look():
    with styled():
        yield


def every(c):
    return np.ones(len(c.measurements), dtype=bool)


def with_residual(c, residual):
    return replace(c, residual_calibrated=residual)


@pytest.mark.parametrize("j", range(6))
def test_an_error_of_a_joint_stands_in_its_own_panel_in_full(calibrations, j):
    """If a joint turned 0.1 mrad too far, what is left over is all along its motion."""
    c = calibrations.made("paper")
    q = c.measurements.joints_for(c.nominal.joint_names)
    off = c.predict(q + 1e-4 * np.eye(6)[j]) - c.predict(q)
    parts = along_joints(with_residual(c, off), every(c))
    np.testing.assert_allclose(parts[:, j], np.linalg.norm(off, axis=1), rtol=1e-3)
    sizes = np.linalg.norm(off, axis=1)[:, None]
    assert np.all(np.abs(parts) <= sizes * (1 + 1e-6))


def test_a_part_is_never_more_than_the_whole(calibrations):
    for name in ("prismatic", "many_parameters", "distances", "mixed"):
        c = calibrations.made(name)
        parts = along_joints(c, every(c))
        assert parts.shape == (len(c.measurements), len(c.nominal.joint_names))
        sizes = np.linalg.norm(np.where(c.used, c.residual_calibrated, 0.0)[:, :3], axis=1)
        assert np.nanmax(np.abs(parts) - sizes[:, None]) < 1e-12


def test_of_a_distance_all_is_along_the_beam(calibrations):
    c = calibrations.made("distances")
    parts = along_joints(c, every(c))
    sizes = np.abs(c.residual_calibrated[:, 0])
    there = np.isfinite(parts[:, 1])
    np.testing.assert_allclose(np.abs(parts[there, 1]), sizes[there])


def test_of_a_plane_all_is_along_its_normal(calibrations):
    c = calibrations.made("distances")
    kinds = ("plane",) * len(c.measurements)
    plane = replace(c, measurements=replace(c.measurements, kinds=kinds))
    q = c.measurements.joints_for(c.nominal.joint_names)
    anchor = c.measurements.groups[0]
    up = c.predict(q + 1e-5 * np.eye(6)[1], group=anchor) - c.predict(q, group=anchor)
    expected = np.sign(up[:, 2]) * c.residual_calibrated[:, 0]
    np.testing.assert_allclose(along_joints(plane, every(c))[:, 1], expected)


def test_a_joint_that_does_not_move_the_target_has_no_part(calibrations):
    """The target on the last axis."""
    c = calibrations.made("paper")
    on_axis = np.array(c.setup.T_tip_target)
    on_axis[:, :2, 3] = 0.0
    kinematics = replace(c.fitted.kinematics, T_tip_target=on_axis)
    moved = replace(c, fitted=replace(c.fitted, kinematics=kinematics))
    x = np.array(c.fitted.estimate.x)
    x[[c.model.index(f"target_{axis}") for axis in "xy"]] = 0.0
    x[[k for k, name in enumerate(c.model.names) if name in ("a6", "alpha6")]] = 0.0
    estimate = replace(c.fitted.estimate, x=x)
    moved = replace(moved, fitted=replace(moved.fitted, estimate=estimate))
    parts = along_joints(moved, every(c))
    assert np.all(np.isnan(parts[:, 5]))
    assert np.all(np.isfinite(parts[:, 0]))
    words = [text.get_text() for text in joints_figure(moved).axes[5].texts]
    assert words == ["does not move the target"]


def test_panels_are_of_the_joints_in_their_units(calibrations):
    figure = joints_figure(calibrations.made("prismatic"))
    labels = [ax.get_xlabel() for ax in figure.axes]
    assert labels == ["joint value [mm]"] * 3 + ["joint value [deg]"]
    assert [ax.get_title(loc="left") for ax in figure.axes] == [
        "slide_x",
        "slide_y",
        "slide_z",
        "turn",
    ]


def test_outliers_do_not_set_the_scale_and_stand_at_its_edge(calibrations):
    c = calibrations.made("with_outliers")
    ax = joints_figure(c).axes[0]
    assert ax.get_ylim()[1] < 0.3
    crosses = next(line for line in ax.lines if line.get_marker() == "x")
    assert len(crosses.get_ydata()) == len(c.outliers) + len(c.suspects)
    assert np.all(np.abs(crosses.get_ydata()) < ax.get_ylim()[1])


def test_the_mean_is_that_of_the_estimation_rows_without_outliers(calibrations):
    c = calibrations.made("paper")
    rows = np.arange(1, 36)
    np.testing.assert_array_equal(mean_rows(c), (rows <= 30) & ~np.isin(rows, [11, 14]))
    figure = joints_figure(c)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels[-1] == "mean of the estimation rows ± 2 standard errors"
    # Wherever a row for validation lies, the band is the same.
    moved = c.residual_calibrated.copy()
    moved[30:] += 0.1
    bands = [
        joints_figure(one).axes[0].collections[-1].get_paths()[0].vertices
        for one in (c, with_residual(c, moved))
    ]
    np.testing.assert_array_equal(*bands)
    assert has_mean(c)
    assert not has_mean(calibrations.made("two_joints"))  # 20 rows to estimate, 25 in all


def test_many_rows_are_thinned_but_not_the_outliers(calibrations):
    c = calibrations.many_rows(6000)
    chosen = drawn_rows(c)
    assert np.count_nonzero(chosen) <= MOST_ROWS + len(c.outliers)
    rows = set(np.array(c.measurements.rows)[chosen])
    assert {one.row for one in c.outliers} <= rows


def test_lengths_between_two_rows_belong_to_neither(calibrations):
    c = calibrations.made("distances")
    assert has_parts(c)
    m = c.measurements
    count = len(m) - len(m) % 2
    pairs = replace(
        m.select(np.arange(len(m)) < count),
        kinds=("pair",) * count,
        pairs=tuple(f"p{k // 2}" for k in range(count)),
        distances=np.repeat(m.distances[:count:2], 2),
    )
    mask = np.arange(len(m)) < count
    assert not has_parts(replace(c, measurements=pairs, used=c.used[mask]))
