from __future__ import annotations

import pickle

import numpy as np
import pytest

from calib.errors import ArgumentError, UrdfError
from calib.robot.robot import Robot
from tests.robot.shared import displaced, joint, random_q, urdf_of

UR3 = Robot.load("ur3", "base", "tool0")
PAN, LIFT, ELBOW, WRIST_1, WRIST_2, WRIST_3 = UR3.joint_names

COUPLINGS = {
    "joint 3 against the horizontal": {ELBOW: {LIFT: 1.0}},
    "a palletiser": {ELBOW: {LIFT: -1.0}},
    "two joints": {ELBOW: {LIFT: -1.0}, WRIST_1: {ELBOW: 1.0, LIFT: 1.0}},
    "a wrist with gears": {WRIST_3: {WRIST_2: 0.025}, WRIST_2: {WRIST_1: -0.5}},
}


def by_hand(q, coupling):
    """The values of the joints, sum by sum."""
    values = q.copy()
    names = list(UR3.joint_names)
    for name, factors in coupling.items():
        for other, factor in factors.items():
            values[:, names.index(name)] += factor * q[:, names.index(other)]
    return values


@pytest.mark.parametrize("coupling", COUPLINGS.values(), ids=COUPLINGS)
def test_poses_of_readings_are_those_of_the_joint_values(coupling):
    robot = Robot.load("ur3", "base", "tool0", coupling=coupling)
    q = random_q(UR3)
    values = by_hand(q, coupling)
    assert np.abs(values - q).max() > 1e-3
    np.testing.assert_allclose(robot.poses(q), UR3.poses(values), rtol=0, atol=1e-12)
    np.testing.assert_allclose(robot.input_values(q), values, rtol=0, atol=1e-14)
    np.testing.assert_allclose(robot.readings(values), q, rtol=0, atol=1e-13)
    of_urdf = robot.urdf_values(q)
    for name, column in zip(UR3.joint_names, values.T, strict=True):
        np.testing.assert_allclose(of_urdf[name], column, rtol=0, atol=1e-14)


def test_without_coupling_readings_are_the_joint_values():
    q = random_q(UR3)
    np.testing.assert_array_equal(UR3.input_values(q), q)
    np.testing.assert_array_equal(UR3.readings(q), q)
    np.testing.assert_array_equal(UR3.reading_matrix, np.eye(6))
    assert UR3.reading_coupling == {}


def test_a_mimic_joint_follows_the_value_and_not_the_reading():
    joints = (
        joint("a", "x", "y"),
        joint("b", "y", "z"),
        joint("c", "z", "w", mimic='joint="b" multiplier="-2" offset="0.1"'),
    )
    robot = Robot.from_urdf(urdf_of("x y z w", *joints), tip="w", coupling={"b": {"a": 0.5}})
    q = np.array([[0.2, 0.3]])
    b = 0.3 + 0.5 * 0.2
    np.testing.assert_allclose(robot.chain_values(q), [[0.2, b, -2.0 * b + 0.1]], atol=1e-15)
    np.testing.assert_allclose(robot.urdf_values(q)["c"], [-2.0 * b + 0.1], atol=1e-15)


def test_rebuilt_corrected_and_pickled_robots_keep_the_coupling():
    coupling = {ELBOW: {LIFT: -1.0}}
    robot = Robot.load("ur3", "base", "tool0", coupling=coupling)
    assert robot != UR3
    assert robot.reading_coupling == coupling
    assert robot.rebuilt() == robot
    assert robot.rebuilt(displaced(robot).urdf).reading_coupling == coupling
    assert displaced(robot).reading_coupling == coupling
    copied = pickle.loads(pickle.dumps(robot))
    assert copied == robot
    np.testing.assert_array_equal(copied.poses(np.ones(6)), robot.poses(np.ones(6)))
    # also between links where it has no effect
    assert robot.rebuilt(base="forearm_link").reading_coupling == coupling


FAULTS = {
    "an unknown joint": (
        {"elbow": {LIFT: 1.0}},
        {},
        "'elbow' is not a joint that moves .did you mean",
    ),
    "coupled to an unknown joint": ({ELBOW: {"lift": 1.0}}, {}, "'lift' is not a joint that moves"),
    "a fixed joint": ({"world_joint": {LIFT: 1.0}}, {}, "'world_joint' is not a joint that moves"),
    "itself": ({ELBOW: {ELBOW: 1.0}}, {}, "names 'elbow_joint' itself"),
    "held": ({ELBOW: {LIFT: 1.0}}, {LIFT: 0.5}, "'shoulder_lift_joint' is held at 0.5"),
    "singular": ({ELBOW: {LIFT: 1.0}, LIFT: {ELBOW: 1.0}}, {}, "are singular"),
    "no number": ({ELBOW: {LIFT: "1"}}, {}, "the factor '1' at 'shoulder_lift_joint'"),
    "not finite": ({ELBOW: {LIFT: np.nan}}, {}, "the factor nan at"),
}


@pytest.mark.parametrize(("coupling", "held", "message"), FAULTS.values(), ids=FAULTS)
def test_what_cannot_be_coupled(coupling, held, message):
    with pytest.raises(UrdfError, match=message):
        Robot.load("ur3", "base", "tool0", held=held, coupling=coupling)


def test_a_mimic_joint_has_no_reading_to_couple():
    joints = (
        joint("a", "x", "y"),
        joint("b", "y", "z", mimic='joint="a"'),
        joint("c", "z", "w"),
    )
    for coupling in ({"b": {"c": 1.0}}, {"c": {"b": 1.0}}):
        with pytest.raises(UrdfError, match="'b' mimics 'a', so that it has no reading"):
            Robot.from_urdf(urdf_of("x y z w", *joints), tip="w", coupling=coupling)


def test_a_joint_beside_the_chain_that_a_reading_needs_is_refused():
    with pytest.raises(UrdfError, match="'elbow_joint' are coupled to those of 'shoulder_lift_j"):
        Robot.load("ur3", "upper_arm_link", "tool0", coupling={ELBOW: {LIFT: 1.0}})


def test_what_is_no_mapping_of_mappings_is_refused():
    for coupling in ([ELBOW], {ELBOW: LIFT}, {ELBOW: {3: 1.0}}):
        with pytest.raises(ArgumentError, match="The argument 'coupling"):
            Robot.load("ur3", coupling=coupling)


def test_a_factor_of_zero_couples_nothing():
    assert Robot.load("ur3", "base", "tool0", coupling={ELBOW: {LIFT: 0.0}}) == UR3
