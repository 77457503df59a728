"""Joints of several publishers on one time."""

from __future__ import annotations

import numpy as np
import pytest

from calib.errors import MeasurementError
from calib.verbs.bag.streams import Publisher, merged


def publisher(names: tuple[str, ...], times: np.ndarray, offset: float = 0.0) -> Publisher:
    q = np.column_stack([times + offset + 10.0 * k for k in range(len(names))])
    return Publisher(names, times, q, np.full_like(q, np.nan))


def test_subsets_come_onto_the_times_of_the_most_frequent_publisher():
    arm = publisher(("a", "b"), np.arange(0.0, 2.0, 0.01))
    rail = publisher(("rail",), np.arange(0.105, 1.505, 0.1))
    joints = merged([rail, arm], ("b", "rail", "a"))
    assert joints.names == ("b", "rail", "a")
    assert joints.times[0] == pytest.approx(0.11)
    assert joints.times[-1] == pytest.approx(1.4)
    expected = np.column_stack([joints.times + 10.0, joints.times, joints.times])
    np.testing.assert_allclose(joints.q, expected, atol=1e-12)
    np.testing.assert_allclose(joints.at(np.array([0.5, 99.0]))[:, 1], [0.5, 1.4], atol=1e-9)


def test_a_joint_that_two_send_is_that_of_the_more_frequent_one():
    often = publisher(("a",), np.arange(0.0, 1.0, 0.01))
    rarely = publisher(("a", "b"), np.arange(0.0, 1.0, 0.05), offset=5.0)
    joints = merged([rarely, often], ("a", "b"))
    np.testing.assert_allclose(joints.q[:, 0], joints.times, atol=1e-12)
    np.testing.assert_allclose(joints.q[:, 1], joints.times + 15.0, atol=1e-12)


def test_publishers_that_never_overlap_are_refused():
    first = publisher(("a",), np.arange(0.0, 1.0, 0.01))
    second = publisher(("b",), np.arange(2.0, 3.0, 0.01))
    with pytest.raises(MeasurementError, match="same time"):
        merged([first, second], ("a", "b"))
