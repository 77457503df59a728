"""Poses of the flange that are inverted, of another convention, or of other pictures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.basics.arrays import read_only
from calib.data.forms.flange_poses import flange_joints
from calib.data.forms.orientations import find_convention
from calib.diagnosis.flange_mistakes import flange_mistakes
from calib.diagnosis.reasons import Why
from calib.robot.flange import FLANGE, NAME
from calib.robot.robot import Robot
from tests.result.test_flange_poses import CELL, CORNERS, table, views

ROBOT = Robot.load(NAME, base=FLANGE, tip="base")
T = views(12)


def read_as(given: str, meant: str) -> np.ndarray:
    """The poses if their numbers, of the convention that is meant, are read as those of the given one."""
    result = T.copy()
    numbers = find_convention(meant).numbers(T[:, :3, :3])
    result[:, :3, :3] = find_convention(given).matrices(numbers)
    return result


def mistakes(poses: np.ndarray) -> list[tuple[Why, str]]:
    q = flange_joints(poses[:, :3, 3], poses[:, :3, :3])
    joints = read_only(np.repeat(q, len(CORNERS), axis=0))
    wrong = replace(table(T, noise=0.2), joints=joints, moves=None)
    found = list(flange_mistakes(ROBOT, CELL, wrong))
    return [(reason.why, reason.values.get("convention", "")) for reason in found]


def test_nothing_is_said_of_right_ones():
    assert mistakes(T) == []


@pytest.mark.parametrize(
    ("poses", "found"),
    [
        (np.linalg.inv(T), (Why.FLANGE_INVERSE, "")),
        (read_as("quaternion", "abb"), (Why.FLANGE_CONVENTION, "abb")),
        (read_as("staubli", "yaskawa"), (Why.FLANGE_CONVENTION, "yaskawa")),
        (T[::-1], (Why.FLANGE_OFF, "")),
    ],
)
def test_each_mistake_is_named(poses: np.ndarray, found: tuple[Why, str]):
    assert mistakes(poses) == [found]
