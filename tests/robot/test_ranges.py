"""Limits and ranges of joints, and values spread between them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.stats import qmc

from calib import example
from calib.basics.units import Angle, Length
from calib.data.measurements import Measurements
from calib.errors import CalibError
from calib.robot.ranges import (
    _DIRECTIONS,
    column_limits,
    column_ranges,
    full_ranges,
    joint_ranges,
    random_joint_values,
    range_text,
    scrambled_sobol,
    sobol,
    spread_between,
    spread_poses,
)
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf

#: A slide with limits, a turn without, a knee, and an ankle that turns twice as far the other way.
LEG = """<robot name="leg">
  <link name="a"/><link name="b"/><link name="c"/><link name="d"/><link name="e"/>
  <joint name="lift" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
    <limit lower="0.1" upper="0.4" effort="1" velocity="1"/></joint>
  <joint name="turn" type="continuous"><parent link="b"/><child link="c"/><axis xyz="0 0 1"/></joint>
  <joint name="knee" type="revolute"><parent link="c"/><child link="d"/><axis xyz="0 1 0"/>
    <limit lower="-7" upper="7" effort="1" velocity="1"/></joint>
  <joint name="ankle" type="revolute"><parent link="d"/><child link="e"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="3" effort="1" velocity="1"/><mimic joint="knee" multiplier="-2" offset="1"/></joint>
</robot>"""


@pytest.fixture(scope="module")
def leg():
    return Robot.from_urdf(Urdf.from_bytes(LEG.encode(), "leg.urdf"), "a", "e")


@pytest.fixture(scope="module")
def ur3():
    return Robot.load(example.paper_urdf(), base="base", tip="tool0")


def test_limits_of_columns(leg):
    # The ankle, 1 - 2 knee, stays between -1 and 3.
    expected = [[0.1, 0.4], [-np.inf, np.inf], [-1.0, 1.0]]
    np.testing.assert_allclose(column_limits(leg), expected)


def test_without_more_they_are_the_limits_or_a_turn(leg, ur3):
    np.testing.assert_allclose(joint_ranges(leg), [[0.1, 0.4], [-np.pi, np.pi], [-1.0, 1.0]])
    np.testing.assert_array_equal(joint_ranges(ur3), column_ranges(ur3))


@pytest.mark.parametrize(
    ("kind", "limits", "expected"),
    [
        ("revolute", (0.0, 6.0), (0.0, 6.0)),  # all of it, not the half within pi of zero
        ("revolute", (-3.2, 3.2), (-np.pi, np.pi)),
        ("revolute", (-2 * np.pi, 2 * np.pi), (-np.pi, np.pi)),
        ("revolute", (1.5, 12.0), (1.5, 1.5 + 2 * np.pi)),
        ("revolute", (-12.0, 0.0), (-2 * np.pi, 0.0)),
        ("continuous", None, (-np.pi, np.pi)),
        ("prismatic", (0.0, 12.0), (0.0, 12.0)),
        ("prismatic", (-499.0, 0.5), (-499.0, 0.5)),
        ("prismatic", (-1000.0, 1000.0), (-1.0, 1.0)),  # no limits at all
        ("prismatic", (0.0, 1000.0), (0.0, 1.0)),
        ("prismatic", (-1e16, 0.5), (-1.0, 0.5)),
    ],
)
def test_a_joint_goes_everywhere_it_can(kind, limits, expected):
    limit = (
        ""
        if limits is None
        else f'<limit lower="{limits[0]}" upper="{limits[1]}" effort="1" velocity="1"/>'
    )
    text = f"""<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="{kind}">
      <parent link="a"/><child link="b"/><axis xyz="0 0 1"/>{limit}</joint></robot>"""
    robot = Robot.from_urdf(Urdf.from_bytes(text.encode(), "r.urdf"), "a", "b")
    np.testing.assert_allclose(full_ranges(robot), [expected], atol=1e-12)


def test_given_ranges_may_go_beyond_one_turn_but_not_beyond_limits(leg, ur3):
    ranges = joint_ranges(leg, {"turn": (-1.0, 20.0), "lift": (0.2, 0.3)})
    np.testing.assert_allclose(ranges, [[0.2, 0.3], [-1.0, 20.0], [-1.0, 1.0]])
    # 360 deg in decimals is a little more than the limit of 6.283185307179586 rad.
    wide = joint_ranges(ur3, {"wrist_1_joint": (-6.2832, 6.2832)})
    np.testing.assert_array_equal(wide[3], [-2 * np.pi, 2 * np.pi])


def test_ranges_of_the_paper_s_rows(ur3):
    m = Measurements.read(example.paper_measurements(), ur3.joint_names, ur3.joint_types)
    q = m.joints_for(ur3.joint_names)[m.estimation]
    ranges = np.degrees(joint_ranges(ur3, like=q, margin=np.radians(5.0)))
    # Table 2 by eye; joint 6 was measured beyond its limit of 360 deg.
    expected = [
        [-77.77, -0.11], [-133.81, -17.71], [-95.21, 128.63],
        [-226.34, -30.52], [-65.49, 63.61], [-133.05, 420.75],
    ]  # fmt: skip
    np.testing.assert_allclose(ranges, expected, atol=1e-9)
    narrowed = joint_ranges(ur3, {"elbow_joint": (0.0, 1.0)}, q)
    np.testing.assert_array_equal(narrowed[2], [0.0, 1.0])


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"ankle": (0, 1)}, "for 'ankle', which is not a joint of .* 'lift', 'turn', 'knee'"),
        ({"turn": (1, -1)}, "of 'turn' is 57.2958 to -57.2958 deg; the lower end"),
        ({"lift": (Angle(0.2), Angle(0.3))}, "joint 'lift' is an angle, and the joint slides"),
        ({"turn": (Length(0), Length(0.1))}, "joint 'turn' is a length, and the joint turns"),
        ({"lift": (0.2, 0.5)}, "of 'lift' is 200 to 500 mm; .* 100 to 400 mm"),
    ],
)
def test_ranges_that_cannot_be_are_refused(leg, given, said):
    with pytest.raises(CalibError, match=said):
        joint_ranges(leg, given)


# Columns that move several joints


def mimic_pair(lower: float, upper: float, numbers: str) -> Robot:
    limit = '<limit lower="{}" upper="{}" effort="1" velocity="1"/>'
    text = (
        '<robot name="r"><link name="a"/><link name="b"/><link name="c"/>'
        '<joint name="1" type="revolute"><parent link="a"/><child link="b"/>'
        f"{limit.format(-1, 2)}</joint>"
        '<joint name="2" type="revolute"><parent link="b"/><child link="c"/>'
        f'{limit.format(lower, upper)}<mimic joint="1" {numbers}/></joint></robot>'
    )
    return Robot.from_urdf(Urdf.from_bytes(text.encode(), "r.urdf"), tip="c")


@pytest.mark.parametrize(
    ("lower", "upper", "numbers", "expected"),
    [
        (-3, 3, "", (-1, 2)),
        (-0.5, 3, "", (-0.5, 2)),
        (-0.5, 0.25, 'multiplier="0.5"', (-1, 0.5)),
        (-0.5, 1, 'multiplier="-1"', (-1, 0.5)),
        (-0.5, 1, 'offset="0.5"', (-1, 0.5)),
        (2.5, 3, "", (-1, 2)),  # the two cannot both be had: the column's own stay
    ],
)
def test_a_column_keeps_within_the_limits_of_its_followers(lower, upper, numbers, expected):
    robot = mimic_pair(lower, upper, numbers)
    np.testing.assert_allclose(column_ranges(robot), [expected])
    for q in (random_joint_values(robot), spread_poses(robot)):
        assert q.min() >= expected[0]
        assert q.max() <= expected[1]


def test_a_range_is_shown_in_degrees_or_millimetres(leg):
    assert range_text(leg, "turn", (-np.pi / 2, np.pi)) == "-90 to 180 deg"
    assert range_text(leg, "lift", (0.1, 0.4)) == "100 to 400 mm"


# Spread joint values


def test_kept_direction_numbers_are_those_of_scipy():
    kept = np.load(_DIRECTIONS)
    bits, columns = kept.shape
    np.testing.assert_array_equal(kept, qmc.Sobol(columns, scramble=False, bits=bits)._sv.T)
    # A point whose number has one bit set differs from the one before by that bit's direction number.
    numbers = 2 ** np.arange(16)
    x = (np.vstack([np.zeros(columns), sobol(2**15, columns)]) * 2**bits).astype(np.uint32)
    np.testing.assert_array_equal(kept[:16], x[numbers] ^ x[numbers - 1])


@pytest.mark.parametrize(("count", "columns"), [(1, 1), (200, 6), (256, 14), (4096, 7), (300, 33)])
def test_spread_rows_are_scipys_sequence(count, columns):
    low, high = -np.arange(1.0, columns + 1.0), np.full(columns, 3.0)
    q = spread_between(np.column_stack([low, high]), count)
    np.testing.assert_array_equal(q, low + sobol(count, columns) * (high - low))
    assert not q.flags.writeable


@pytest.mark.parametrize(("columns", "size", "blocks"), [(1, 4, 3), (6, 4096, 20), (32, 8, 2)])
def test_scrambled_points_are_those_of_scipy(columns, size, blocks):
    parent = np.random.default_rng(5)
    for scipys, ours in ((5, 5), (parent, np.random.SeedSequence(5).spawn(1)[0])):
        sequence = qmc.Sobol(columns, scramble=True, seed=scipys)
        for points in itertools.islice(scrambled_sobol(columns, size, ours), blocks):
            np.testing.assert_array_equal(points, sequence.random(size))


def test_scrambled_points_of_more_columns_than_are_kept():
    points = next(scrambled_sobol(33, 8, 5))
    assert points.shape == (8, 33)
    # One point of each eighth in every column.
    np.testing.assert_array_equal(np.sort(np.floor(8 * points), axis=0)[:, 32], np.arange(8))


# Coupled readings


KNEE_AGAINST_TURN = {"knee": {"turn": 2.0}}


@pytest.fixture(scope="module")
def coupled_leg():
    urdf = Urdf.from_bytes(LEG.encode(), "leg.urdf")
    return Robot.from_urdf(urdf, "a", "e", coupling=KNEE_AGAINST_TURN)


def test_limits_and_ranges_are_those_of_the_joints_and_not_of_their_readings(leg, coupled_leg):
    np.testing.assert_array_equal(column_limits(coupled_leg), column_limits(leg))
    np.testing.assert_array_equal(full_ranges(coupled_leg), full_ranges(leg))
    # Ranges of measured readings: the knee is at its reading plus twice that of the turn.
    like = [[0.2, 0.1, 0.3], [0.3, 0.2, -0.2]]
    expected = [[0.2, 0.3], [0.1, 0.2], [0.2, 0.5]]
    np.testing.assert_allclose(joint_ranges(coupled_leg, like=like), expected, atol=1e-15)


def test_readings_are_spread_so_that_the_joints_fill_their_ranges(leg, coupled_leg):
    for made in (
        spread_poses,
        lambda robot, count: random_joint_values(robot, count, 3),
    ):
        values, readings = made(leg, 64), made(coupled_leg, 64)
        by_hand = values - 2.0 * values[:, [1]] * np.array([0.0, 0.0, 1.0])
        np.testing.assert_allclose(readings, by_hand, rtol=0, atol=1e-14)
        chain = coupled_leg.chain_values(readings)
        np.testing.assert_allclose(chain, leg.chain_values(values), rtol=0, atol=1e-13)


def test_a_mimicking_joint_of_any_chain_narrows_the_joint_that_it_follows():
    limit = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
    joints = "".join(
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.3 0 0"/><axis xyz="0 0 1"/>{limit}{mimic}</joint>'
        for name, parent, child, mimic in (
            ("l1", "root", "left", ""),
            ("r1", "root", "elbow", ""),
            ("r2", "elbow", "right", '<mimic joint="r1" multiplier="2"/>'),
        )
    )
    links = "".join(f'<link name="{name}"/>' for name in ("root", "left", "elbow", "right"))
    urdf = Urdf.from_bytes(f'<robot name="two">{links}{joints}</robot>'.encode(), "two")
    robot = Robot.from_urdf(urdf, "root", "left", branches=[("root", "right")])
    assert robot.joint_names == ("l1", "r1")
    np.testing.assert_allclose(full_ranges(robot), [[-1.0, 1.0], [-0.5, 0.5]])
