"""What lies outside of the measured poses, on the paper's table and on corners of real robots' workspaces."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.data import paper_measurements
from calib.identify.coverage import (
    Beyond,
    OutsideRow,
    outside,
    outside_sentence,
    shares_of_ranges,
    spread_of,
)
from calib.measure.measurements import Measurements
from calib.model.robot import Robot

TYPES = ("revolute",) * 6


def drawn(robot: Robot, count: int, seed: int) -> np.ndarray:
    """Joint values all over the limits."""
    return np.random.default_rng(seed).uniform(*limits(robot).T, (count, len(robot.joint_names)))


def limits(robot: Robot) -> np.ndarray:
    return np.array([(max(j.lower, -np.pi), min(j.upper, np.pi)) for j in robot.joints])


def tips(robot: Robot, q: np.ndarray) -> np.ndarray:
    return robot.poses(q)[:, :3, 3]


def spread(robot: Robot, q: np.ndarray) -> float:
    return spread_of(tips(robot, q), tips(robot, drawn(robot, 2000, 0)))


@pytest.fixture(scope="module")
def paper_joints(ur3):
    table = Measurements.read(paper_measurements(), ur3.joint_names, ur3.joint_types)
    return table.joints_for(ur3.joint_names)


def test_the_paper_s_last_rows_lie_outside(ur3, paper_joints):
    """Rows 34 and 35 ask for joint values far from those of rows 1 to 30."""
    found = outside(paper_joints[:30], paper_joints[30:], ur3.joint_names, TYPES)
    numbers = np.arange(31, 36)
    rows = [int(numbers[row.index]) for row in found]
    assert {34, 35} <= set(rows)
    for row in found:
        asked = paper_joints[30 + row.index]
        for b in row.beyond:
            j = ur3.joint_names.index(b.joint)
            low, high = paper_joints[:30, j].min(), paper_joints[:30, j].max()
            assert b.by == pytest.approx(max(low - asked[j], asked[j] - high))
            assert b.by > 0.05 * (high - low)
    text = outside_sentence(found, numbers.tolist())
    assert "row 34: '" in text
    assert "deg beyond the measured range" in text


def test_the_measured_rows_lie_inside(ur3, paper_joints):
    assert outside(paper_joints[:30], paper_joints[:30], ur3.joint_names, TYPES) == ()
    assert outside_sentence((), []) == ""


def test_a_margin_of_a_twentieth_is_allowed():
    measured = np.array([[0.0, 0.0], [1.0, 2.0]])
    asked = np.array([[1.049, 2.09], [1.051, -0.09], [0.5, 2.11], [-0.2, -0.3]])
    found = outside(measured, asked, ("a", "b"), ("revolute", "prismatic"))
    assert [row.index for row in found] == [1, 2, 3]
    assert found[0].beyond[0].by == pytest.approx(0.051)
    # The worst in shares of its range comes first.
    assert [b.joint for b in found[2].beyond] == ["a", "b"]
    text = outside_sentence(found, range(1, 5))
    assert "row 3: 'b' 110 mm beyond the measured range" in text
    assert "row 4: 'a' 11.5 deg, 'b' 300 mm beyond the measured range" in text


def test_many_rows_are_not_all_named():
    rows = [OutsideRow(i, (Beyond("a", False, 0.1),)) for i in range(8)]
    assert outside_sentence(rows, range(8)).endswith("; and 5 more rows")
    assert outside_sentence(rows[:4], range(8)).endswith("; and 1 more row")
    assert outside_sentence(rows[:3], range(8)).count("row ") == 3


def test_a_joint_that_stood_still_allows_no_motion_but_rounding():
    measured = np.full((5, 1), 0.4)
    found = outside(measured, np.array([[0.4005], [0.5]]), ("a",), ("revolute",))
    assert [row.index for row in found] == [1]


def test_no_rows_are_not_outside():
    assert outside(np.zeros((0, 1)), np.ones((2, 1)), ("a",), ("revolute",)) == ()
    assert outside(np.zeros((2, 1)), np.ones((0, 1)), ("a",), ("revolute",)) == ()


def test_continuous_joints_are_measured_on_a_circle():
    measured = np.radians([[170.0], [-175.0], [150.0], [-160.0]])
    asked = np.radians([[185.0], [-180.0], [540.0], [140.0], [-100.0], [260.0]])
    found = outside(measured, asked, ("a",), ("continuous",))
    assert [row.index for row in found] == [3, 4, 5]
    np.testing.assert_allclose([np.degrees(r.beyond[0].by) for r in found], [10, 60, 60])
    # The same values of a joint with limits are far apart.
    assert [row.index for row in outside(measured, asked[:3], ("a",), ("revolute",))] == [2]


@given(
    turn=st.integers(-3, 3),
    shift=st.floats(-3, 3),
    values=st.lists(st.floats(0.0, 2.0), min_size=2, max_size=9),
    asked=st.floats(-3, 6),
)
def test_where_a_circle_begins_does_not_matter(turn, shift, values, asked):
    measured, there = np.array(values)[:, None], np.array([[asked]])
    once = outside(measured, there, ("a",), ("continuous",))
    turned = outside(measured + shift, there + shift + 2 * np.pi * turn, ("a",), ("continuous",))
    by = [row.beyond[0].by for row in (*once, *turned)]
    if len(by) == 2:
        assert by[1] == pytest.approx(by[0], abs=1e-9)
    elif by:
        # On the margin itself rounding decides.
        assert by[0] == pytest.approx(max(0.05 * np.ptp(measured), 1e-3), abs=1e-9)


@pytest.mark.parametrize("count", [12, 30])
def test_random_poses_are_no_corner(ur3, panda, count):
    for seed in range(6):
        for robot in (ur3, panda):
            assert spread(robot, drawn(robot, count, seed)) > 0.6


def test_the_paper_s_poses_are_no_corner(ur3, paper_joints):
    assert 0.38 < spread(ur3, paper_joints[:30]) < 0.5


@pytest.mark.parametrize("name", ["ur3", "panda"])
def test_a_cube_of_20_cm_is_a_corner(name, request):
    robot = request.getfixturevalue(name)
    q = drawn(robot, 30_000, 1)
    where = tips(robot, q)
    tried = 0
    for centre in where[:30]:
        inside = np.flatnonzero(np.all(np.abs(where - centre) < 0.1, axis=1))
        if len(inside) >= 20:
            tried += 1
            assert spread(robot, q[inside[:30]]) < 1 / 3
    assert tried > 5


def test_flat_and_single_sets_of_tips():
    plane = np.random.default_rng(2).uniform(-1, 1, (300, 3)) * [1.0, 1.0, 0.0]
    assert spread_of(plane, plane) == pytest.approx(1.0)
    assert spread_of(plane[:1], plane) == 0.0
    # An arm whose tip cannot move at all has been measured everywhere.
    assert spread_of(np.zeros((5, 3)), np.zeros((5, 3))) == 1.0


def test_shares_of_ranges():
    q = np.radians([[170.0, 0.0, 0.0, 0.0], [-170.0, 400.0, 0.0, 0.0]])
    q[1, 2] = 0.3
    ranges = np.array([[-np.pi, np.pi], [-2 * np.pi, 2 * np.pi], [-np.inf, np.inf], [0.0, 0.0]])
    types = ("continuous", "revolute", "prismatic", "revolute")
    np.testing.assert_allclose(shares_of_ranges(q, ranges, types), [20 / 360, 1.0, 1.0, 1.0])
