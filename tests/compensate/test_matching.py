from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.compensate.inverse import Matching
from calib.errors import ModelError

TWIST = st.lists(st.floats(-0.5, 0.5), min_size=6, max_size=6).map(np.array)


def pose(twist: np.ndarray) -> np.ndarray:
    return pin.exp6(np.asarray(twist, dtype=float)).homogeneous


def stack(*poses: np.ndarray) -> np.ndarray:
    return np.stack(poses)


@given(TWIST, TWIST)
def test_moving_by_the_error_arrives(first, second):
    now, wanted = stack(pose(first)), stack(pose(second))
    error = Matching("pose", 1.0).error(now, wanted)[0]
    moved = now[0].copy()
    moved[:3, 3] += now[0, :3, :3] @ error[:3]
    moved[:3, :3] = now[0, :3, :3] @ pin.exp3(error[3:])
    assert moved == pytest.approx(wanted[0], abs=1e-12)


@given(TWIST, TWIST)
def test_the_axis_arrives_by_the_least_turn(first, second):
    now, wanted = stack(pose(first)), stack(pose(second))
    error = Matching("axis", 1.0).error(now, wanted)[0]
    R = now[0, :3, :3] @ pin.exp3(np.array([error[3], error[4], 0.0]))
    assert R[:, 2] == pytest.approx(wanted[0, :3, 2], abs=1e-12)
    between = np.arccos(np.clip(now[0, :3, 2] @ wanted[0, :3, 2], -1.0, 1.0))
    assert np.linalg.norm(error[3:]) == pytest.approx(between, abs=1e-7)


def test_a_direction_straight_back_is_half_a_turn():
    back = pose([0, 0, 0, np.pi, 0, 0])
    error = Matching("axis", 1.0).error(stack(np.eye(4)), stack(back))[0]
    assert np.linalg.norm(error[3:]) == pytest.approx(np.pi)


def test_an_angle_counts_as_a_length():
    now, wanted = stack(np.eye(4)), stack(pose([0, 0, 0, 0.1, 0, 0]))
    assert Matching("weighted", 0.02).error(now, wanted)[0, 3] == pytest.approx(0.002)
    twists = np.ones((1, 6, 2))
    assert Matching("weighted", 0.02).jacobian(twists)[0, :, 0].tolist() == [
        1,
        1,
        1,
        0.02,
        0.02,
        0.02,
    ]
    assert twists.min() == 1.0  # what was given is not changed


def test_misses_are_a_distance_and_the_angle_that_is_matched():
    now, wanted = stack(np.eye(4)), stack(pose([0, 0, 0, 0, 0, 0.3]))
    wanted[:, :3, 3] = 0.0, 0.03, 0.04
    assert Matching("pose", 1.0).misses(now, wanted)[0] == pytest.approx([0.05, 0.3])
    assert Matching("weighted", 9.0).misses(now, wanted)[0] == pytest.approx([0.05, 0.3])
    assert Matching("axis", 1.0).misses(now, wanted)[0] == pytest.approx([0.05, 0.0])
    assert np.isnan(Matching("position", 1.0).misses(now, wanted)[0, 1])


def test_an_unknown_name_is_refused_with_those_there_are():
    with pytest.raises(ModelError, match="matched by 'poses'; choose one of 'pose', 'position'"):
        Matching("poses", 1.0)


@pytest.mark.parametrize("lever", [0.0, -1.0, np.nan, np.inf])
def test_a_lever_is_a_length(lever):
    with pytest.raises(ModelError, match="length greater than 0"):
        Matching("weighted", lever)
