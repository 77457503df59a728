"""What a view holds, and what it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.errors import ModelError
from calib.show.view import View, translated


def test_what_is_left_out_is_filled_in(ur3, disturb):
    q = np.linspace(-1, 1, 18).reshape(3, 6)
    view = View(ur3, disturb(ur3), q)
    assert view.labels == ("pose 1", "pose 2", "pose 3")
    assert view.kinds == ("pose",) * 3
    assert not view.measures
    assert np.isnan(view.distances).all()
    np.testing.assert_allclose(view.predicted[0], ur3.poses(q)[:, :3, 3])
    assert list(view.robots) == ["nominal", "calibrated"]
    assert list(View(ur3, None, q).robots) == ["nominal"]


def test_predictions_are_those_of_the_robots_in_one_base(ur3, disturb):
    q = np.linspace(-1, 1, 12).reshape(2, 6)
    shift, target = translated([0.001, 0, 0]), translated([0.0, 0.02, 0.1])
    view = View(
        ur3, disturb(ur3), q, T_base_nominal=shift, nominal_target=target, calibrated_target=target
    )
    nominal = (ur3.poses(q) @ target)[:, :3, 3] + [0.001, 0, 0]
    np.testing.assert_allclose(view.predicted[0], nominal, atol=1e-15)
    measured = view.predicted[1] + [0, 0, 0.002]
    seen = replace(view, measured=measured)
    np.testing.assert_allclose(seen.distances[1], 0.002)
    np.testing.assert_allclose(seen.distances[0], np.linalg.norm(measured - nominal, axis=1))


def test_some_of_the_poses(ur3_view):
    chosen = [4, 30, 34]
    part = ur3_view.select(chosen, 1)
    assert part.labels == ("row 5", "row 31", "row 35")
    assert (part.start, part.rows) == (1, 35)
    np.testing.assert_array_equal(part.measured, ur3_view.measured[chosen])
    np.testing.assert_array_equal(part.errors, ur3_view.errors[:, chosen])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q": np.zeros((35, 5))}, r"q has shape \(35, 5\); finite numbers of shape \(35, 6\)"),
        ({"q": np.full((35, 6), np.nan)}, "q has shape"),
        ({"q": np.zeros((0, 6))}, r"q has shape \(0, 6\)"),
        ({"q": np.zeros(6)}, r"q has shape \(6,\)"),
        ({"nominal_target": np.zeros(2)}, r"nominal_target has shape \(2,\)"),
        ({"T_base_nominal": np.full((4, 4), np.nan)}, "T_base_nominal has shape"),
        ({"measured": np.zeros((4, 3))}, r"measured has shape \(4, 3\); .* shape \(35, 3\)"),
        ({"errors": np.zeros((35, 2))}, r"errors has shape \(35, 2\); .* shape \(2, 35\)"),
        ({"instruments": np.zeros((35, 3))}, "instruments has shape"),
    ],
)
def test_what_does_not_fit_is_refused(ur3_view, change, message):
    with pytest.raises(ModelError, match=message):
        replace(ur3_view, **change)


def test_two_different_robots_are_refused(ur3, gantry):
    with pytest.raises(ModelError, match=r"'shoulder_pan_joint'.*'x', 'y', 'c'.*the same chain"):
        View(ur3, gantry, np.zeros((1, 6)))


def test_the_arrays_of_a_view_are_copies_that_cannot_be_written_to(ur3):
    q = np.zeros((1, 6))
    view = View(ur3, ur3, q)
    q[0] = 1
    assert view.q[0, 0] == 0
    for array in (view.q, view.measured, view.nominal_target):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
