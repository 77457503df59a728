from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.example import paper_urdf
from calib.robot.robot import Robot
from calib.verbs.compensate.programs.arm_posture import ArmPosture
from tests.verbs.compensate.programs.industrial_arm import (
    FROM_HORIZONTAL,
    LENGTHS,
    industrial_arm,
)


@pytest.fixture(scope="module")
def q() -> np.ndarray:
    degrees = np.random.default_rng(1).uniform(-1, 1, (300, 6)) * [180, 120, 200, 300, 130, 300]
    return np.radians(degrees)


def plane(q: np.ndarray, *, coupled: bool) -> tuple[np.ndarray, np.ndarray]:
    """Elbow and wrist in the arm's plane, (K, 2): forward and up from axis 2; angles of a drawing, not of a URDF."""
    _, l2, a3, l4, _ = LENGTHS
    lean = q[:, 1]
    up = q[:, 2] + (0.0 if coupled else -lean)
    elbow = l2 * np.stack([np.sin(lean), np.cos(lean)], axis=1)
    along = np.stack([np.cos(up), np.sin(up)], axis=1)
    across = np.stack([-np.sin(up), np.cos(up)], axis=1)
    return elbow, elbow + l4 * along + a3 * across


@pytest.mark.parametrize("coupled", [False, True])
def test_front_and_elbow_are_those_of_the_plane(
    tmp_path: Path, q: np.ndarray, coupled: bool
) -> None:
    robot = industrial_arm(tmp_path, FROM_HORIZONTAL if coupled else None)
    posture = ArmPosture.of(robot)
    elbow, wrist = plane(q, coupled=coupled)
    front = wrist[:, 0] + LENGTHS[0] > 0.0
    # The elbow is up if the line from axis 2 to the wrist passes below it, as seen with the wrist in front.
    forearm = wrist - elbow
    up = elbow[:, 1] * forearm[:, 0] - elbow[:, 0] * forearm[:, 1] > 0.0
    assert posture is not None
    assert np.array_equal(posture.is_front(q, front=True), front)
    assert np.array_equal(posture.is_front(q, front=False), ~front)
    assert np.array_equal(posture.is_elbow_up(q, up=True), up)
    assert np.array_equal(posture.is_elbow_up(q, up=False), ~up)
    assert 30 < front.sum() < 270
    assert 30 < up.sum() < 270


def test_an_arm_that_is_stretched_at_zero_has_no_postures_to_choose_from(q: np.ndarray) -> None:
    posture = ArmPosture.of(Robot.load(paper_urdf(), base="base", tip="tool0"))
    assert posture is not None
    assert posture.at_zero[1] == 0.0
    assert posture.is_elbow_up(q, up=True).all()
    assert posture.is_elbow_up(q, up=False).all()


def test_other_arms_have_none(tmp_path: Path) -> None:
    assert ArmPosture.of(None) is None
    arm = industrial_arm(tmp_path)
    held = Robot.load(tmp_path / "arm.urdf", base="base", tip="tool0", held={"joint_3": 0.1})
    shorter = Robot.load(tmp_path / "arm.urdf", base="base", tip="link_5")
    assert ArmPosture.of(held) is None
    assert ArmPosture.of(shorter) is None
    assert ArmPosture.of(arm) is not None
