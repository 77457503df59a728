"""Outliers, a target that is knocked, and encoders."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from calib.errors import CalibError
from calib.verbs.simulate.disturbances import Encoder, MovedTarget, Outliers


def test_outliers():
    assert Outliers.parse("3", 1e-3) == Outliers(count=3, size=1e-3)
    assert Outliers.parse("2.5%", 1e-3) == Outliers(share=0.025, size=1e-3)
    for text in ("", "-1", "1.5", "many"):
        with pytest.raises(CalibError, match=r"[Oo]utliers"):
            Outliers.parse(text, 1e-3)


def test_a_target_is_moved_from_its_row_on():
    rows = MovedTarget(3, (0, 0, 1e-3)).rows(["a", "b", "a", "b", "a"])
    assert rows.tolist() == [False, False, True, True, True]
    only = MovedTarget(3, (0, 0, 1e-3), "b").rows(["a", "b", "a", "b", "a"])
    assert only.tolist() == [False, False, False, True, False]


@given(
    st.lists(st.floats(-6.0, 6.0), min_size=1, max_size=8),
    st.floats(1e-6, 0.1),
    st.integers(0, 1000),
)
def test_what_is_read_is_at_most_half_a_step_from_where_the_robot_stands(values, step, seed):
    q = np.array([values])
    encoder = Encoder(angle=step)
    slides = [False] * len(values)
    stood, read = encoder.measure(q, slides, seed)
    assert np.abs(stood - q).max() <= 0.5 * step * (1 + 1e-9)
    assert np.abs(read - stood).max() <= 0.5 * step + 1e-12
    assert np.abs(read / step - np.round(read / step)).max() < 1e-6


def test_more_outliers_are_those_of_fewer_and_others():
    rows = list(range(10, 40))
    few = Outliers(count=3).choose(rows, 5)
    many = Outliers(share=0.5).choose(rows, 5)
    assert set(few) < set(many) <= set(rows)
    assert (len(few), len(many)) == (3, 15)
    assert len(Outliers(share=0.001).choose(rows, 5)) == 1
    with pytest.raises(CalibError):
        Outliers(count=31).choose(rows, 5)
