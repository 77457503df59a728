"""Outliers, a moved target, encoders with steps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.errors import CalibError
from calib.simulate.truth import (
    STREAMS,
    Encoder,
    MovedTarget,
    Outliers,
    stream,
)


@pytest.mark.parametrize(
    ("outliers", "among", "number"),
    [
        (Outliers(share=0.2), 30, 6),
        (Outliers(share=0.001), 30, 1),
        (Outliers(share=0.0), 30, 0),
        (Outliers(share=1.0), 7, 7),
        (Outliers(count=0), 30, 0),
        (Outliers(count=3), 3, 3),
    ],
)
def test_how_many(outliers, among, number):
    chosen = outliers.choose(range(100, 100 + among), seed=1)
    assert len(chosen) == len(set(chosen)) == number
    assert chosen == sorted(chosen)
    assert set(chosen) <= set(range(100, 100 + among))


def test_more_outliers_are_those_of_fewer_and_others():
    few = Outliers(count=3).choose(range(50), seed=4)
    assert set(few) < set(Outliers(count=8).choose(range(50), seed=4))
    assert few != Outliers(count=3).choose(range(50), seed=5)


@pytest.mark.parametrize("values", [{"share": 1.01}, {"count": -1}, {"size": 0.0}])
def test_wrong_outliers(values):
    with pytest.raises(CalibError, match="Outliers: a share of"):
        Outliers(**values)


def test_more_outliers_than_rows():
    with pytest.raises(CalibError, match="31 outliers were asked for among 30 measurements"):
        Outliers(count=31).choose(range(30), seed=1)


def test_a_target_is_moved_from_its_row_on():
    rows = MovedTarget(3, (0, 0, 1e-3)).rows(["a", "b", "a", "b", "a"])
    assert rows.tolist() == [False, False, True, True, True]
    only = MovedTarget(3, (0, 0, 1e-3), "b").rows(["a", "b", "a", "b", "a"])
    assert only.tolist() == [False, False, False, True, False]


def test_a_moved_target_that_does_not_fit():
    for row in (0, 6):
        with pytest.raises(CalibError, match=f"before row {row}; the table has the rows 1 to 5"):
            MovedTarget(row, (0, 0, 1e-3)).rows(["a"] * 5)
    with pytest.raises(CalibError, match="'c' is to move; there are 'a', 'b'"):
        MovedTarget(2, (0, 0, 1e-3), "c").rows(["a", "b"])


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


def test_joints_that_slide_have_a_step_of_their_own():
    q = np.full((1000, 3), 0.1234567)
    slides = [False, True, False]
    for encoder, moved in ((Encoder(1e-3, 0.0), [0, 2]), (Encoder(0.0, 1e-4), [1])):
        off = encoder.measure(q, slides, 1)[0] - q
        assert [k for k in range(3) if off[:, k].any()] == moved
    # evenly within the step, so that its standard deviation is a step over the root of twelve
    assert off[:, 1].std() == pytest.approx(1e-4 / np.sqrt(12), rel=0.05)


def test_without_steps_nothing_changes():
    q = np.random.default_rng(1).normal(size=(5, 2))
    for found in Encoder().measure(q, [False, True], 1):
        assert (found == q).all()


@pytest.mark.parametrize("values", [(-1e-6, 0.0), (0.0, np.nan)])
def test_what_is_no_step(values):
    with pytest.raises(CalibError, match="encoder's steps are"):
        Encoder(*values)


def test_each_purpose_has_numbers_of_its_own():
    drawn = [tuple(stream(1, purpose).normal(size=3)) for purpose in STREAMS]
    assert len(set(drawn)) == len(STREAMS)
    assert tuple(stream(1, STREAMS[0]).normal(size=3)) == drawn[0]
    assert tuple(stream(2, STREAMS[0]).normal(size=3)) != drawn[0]
    with pytest.raises(CalibError, match="The seed is -1"):
        stream(-1, "errors")
