"""Frame and target of each row, and measured positions in the base frame."""

from __future__ import annotations

import numpy as np

from calib.show.measured_rows import measured_in_base, setup_of_rows


def test_each_row_has_the_frame_and_target_that_it_names(calibrations):
    c = calibrations.made("mixed")
    m = c.fit.measurements
    T_frame_base, T_tip_target = setup_of_rows(c.setup, m)
    for k, (group, target) in enumerate(zip(m.groups, m.targets, strict=True)):
        station = c.setup.groups.index(group)
        np.testing.assert_array_equal(T_frame_base[k], c.setup.T_frame_base[station])
        number = c.setup.targets.index(target)
        np.testing.assert_array_equal(T_tip_target[k], c.setup.T_tip_target[number])


def test_measured_positions_are_taken_into_the_base_frame(calibrations):
    c = calibrations.made("poses")
    m = c.fit.measurements
    T_frame_base, _ = setup_of_rows(c.setup, m)
    places = measured_in_base(m, T_frame_base)
    back = np.einsum("nij,nj->ni", T_frame_base[:, :3, :3], places) + T_frame_base[:, :3, 3]
    np.testing.assert_allclose(back, m.points, atol=1e-12)


def test_distances_measure_no_position(calibrations):
    c = calibrations.made("distances")
    T_frame_base, _ = setup_of_rows(c.setup, c.fit.measurements)
    assert np.all(np.isnan(measured_in_base(c.fit.measurements, T_frame_base)))
