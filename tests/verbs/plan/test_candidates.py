"""Candidates: inside their ranges, the same every time, the same in a table, and each refusal counted once."""

from __future__ import annotations

import math

import numpy as np
import pytest

from calib.errors import CalibError, ModelError
from calib.instruments.instrument import Condition
from calib.robot.robot import Robot
from calib.verbs.plan.candidates import draw, planning_ranges

DEG = math.pi / 180.0


@pytest.fixture(scope="module")
def mixed(serial_urdf) -> Robot:
    """A turning, a sliding and an endless joint, the limits of the first two at 3."""
    kinds = ("revolute", "prismatic", "continuous")
    axes = ((0, 0, 1), (0, 1, 0), (1, 0, 0))
    joints = [(k, (0, 0, 0.2), (0, 0, 0), a) for k, a in zip(kinds, axes, strict=True)]
    return Robot.from_urdf(serial_urdf(joints))


# Ranges


def test_ranges_keep_the_margin_to_the_urdfs_limits(mixed):
    ranges = planning_ranges(mixed, {}, 5 * DEG)
    np.testing.assert_allclose(ranges[0], [-3 + 5 * DEG, 3 - 5 * DEG])
    # A sliding joint keeps 5 mm, if any.
    np.testing.assert_allclose(ranges[1], [-2.995, 2.995])
    np.testing.assert_allclose(planning_ranges(mixed, {}, 0.0)[1], [-3.0, 3.0])
    # A turn, where there are no limits.
    np.testing.assert_allclose(ranges[2], [-math.pi, math.pi])
    assert not ranges.flags.writeable


@pytest.mark.parametrize(
    ("given", "margin", "words"),
    [
        ({}, math.pi, "leaves nothing of the range of 'j1'"),
        ({"j2": (2.996, 3.0)}, 5 * DEG, "leaves nothing of the range of 'j2'"),
    ],
)
def test_ranges_of_which_nothing_is_left_are_refused(mixed, given, margin, words):
    with pytest.raises(CalibError, match=words):
        planning_ranges(mixed, given, margin)


# Drawing


def test_candidates_fill_their_ranges_and_stay_inside(mixed):
    ranges = planning_ranges(mixed, {"j2": (0.0123456, 0.3)}, 5 * DEG)
    q = draw(mixed, ranges, [], 3000, 0).q
    assert q.shape == (3000, 3)
    low, high = ranges.T
    assert (q >= low - 1e-12).all()
    assert (q <= high + 1e-12).all()
    assert (q.min(axis=0) < low + 0.01 * (high - low)).all()
    assert (q.max(axis=0) > high - 0.01 * (high - low)).all()
    # Evenly: each tenth of each range has a tenth of them.
    for k in range(3):
        counts = np.histogram(q[:, k], bins=10, range=ranges[k])[0]
        assert abs(counts - 300).max() < 15


# Conditions


def beyond(column: int, value: float):
    return lambda q: q[:, column] > value


def test_conditions_are_asked_in_order_and_count_what_they_refuse(ur3):
    tests = [
        Condition("tracker_range", beyond(0, 0.0)),
        Condition("reflector_cone", beyond(1, 1.0)),
        Condition("beam", beyond(2, -9.0)),
    ]
    pool = draw(ur3, planning_ranges(ur3, {}, 0.0), tests, 2000, 0)
    assert (pool.q[:, :2] > [0.0, 1.0]).all()
    assert len(pool.q) == 2000
    assert list(pool.refused) == ["tracker_range", "reflector_cone", "beam"]
    assert pool.refused["tracker_range"] == pytest.approx(pool.drawn / 2, rel=0.01)
    assert pool.refused["beam"] == 0
    assert 2000 <= pool.drawn - sum(pool.refused.values()) < 2000 + 4096


def test_the_workspace_has_what_passed_the_tests_of_where(ur3):
    tests = [
        Condition("region", lambda q: (q[:, 0] > 0.0) & (q[:, 1] > 0.0)),
        Condition("beam", beyond(2, 0.0)),
    ]
    ranges = planning_ranges(ur3, {}, 0.0)
    pool = draw(ur3, ranges, tests, 1000, 0)
    assert (pool.workspace[:, :2] > 0.0).all()
    assert 0.4 < np.mean(pool.workspace[:, 2] > 0.0) < 0.6
    assert (pool.q > [0, 0, 0, -9, -9, -9]).all()
    everywhere = draw(ur3, ranges, tests[1:], 1000, 0)
    assert np.mean(everywhere.workspace > 0.0) == pytest.approx(0.5, abs=0.01)
    only = draw(ur3, ranges, tests[:1], 1000, 0)
    assert np.array_equal(only.workspace, only.q)
    free = draw(ur3, ranges, [], 1000, 0)
    assert np.array_equal(free.workspace, free.q)


def test_nothing_left_names_the_reasons(ur3):
    tests = [
        Condition("region", beyond(0, 0.0)),
        Condition("collision", lambda q: np.zeros(len(q), dtype=bool)),
    ]
    with pytest.raises(ModelError, match=r"^None of (\d+) .*: \d+ by region, \d+ by collision\."):
        draw(ur3, planning_ranges(ur3, {}, 0.0), tests, 10, 0)


# Coupled readings


@pytest.mark.parametrize("factor", [1.0, -1.0, 0.37])
def test_candidates_of_coupled_readings_keep_the_joints_in_their_ranges(mixed, factor):
    robot = Robot.from_urdf(
        mixed.urdf, mixed.base, mixed.tip, coupling={"j3": {"j1": factor}, "j2": {"j1": 0.1}}
    )
    ranges = planning_ranges(robot, {"j2": (0.0123456, 0.3)}, 0.0)
    np.testing.assert_array_equal(ranges, planning_ranges(mixed, {"j2": (0.0123456, 0.3)}, 0.0))
    q = draw(robot, ranges, [], 3000, 0).q
    low, high = ranges.T
    values = q.copy()
    values[:, 1] += 0.1 * q[:, 0]
    values[:, 2] += factor * q[:, 0]
    assert (values >= low).all()
    assert (values <= high).all()
    assert (np.ptp(values, axis=0) > 0.99 * (high - low)).all()
    # The readings are what a table writes, whole steps of 0.001 deg and 0.001 mm.
    steps = q / np.array([DEG, 1e-3, DEG]) * 1000.0
    np.testing.assert_allclose(steps, np.round(steps), rtol=0, atol=1e-6)


def test_a_range_narrower_than_the_rounding_is_kept_in_its_middle(mixed):
    robot = Robot.from_urdf(mixed.urdf, mixed.base, mixed.tip, coupling={"j3": {"j1": 1.0}})
    ranges = planning_ranges(robot, {"j3": (0.1, 0.1 + 1e-7)}, 0.0)
    q = draw(robot, ranges, [], 100, 0).q
    np.testing.assert_allclose(q[:, 2] + q[:, 0], 0.1, rtol=0, atol=1.01e-3 * DEG)
