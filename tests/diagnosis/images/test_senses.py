"""Senses of joints: each one reversed in turn is named, and one that did not move is said to be unknown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.images.poses import as_poses
from calib.diagnosis.images.senses import doubtful_senses
from calib.diagnosis.reasons import Why
from calib.diagnosis.usual_mistakes import find_usual_mistake
from tests.images import arm, cell, mounts, poses, table


def found(q, reverse=None):
    m = table(q, noise=0.1)
    joints = m.joints.copy()
    if reverse is not None:
        joints[:, reverse] *= -1.0
    return list(doubtful_senses(arm(), cell(), replace(m, joints=joints)))


def test_right_senses_are_not_doubted():
    assert found(poses(12)) == []


@pytest.mark.slow
@pytest.mark.parametrize("joint", range(7))
def test_a_reversed_joint_is_named(joint):
    q = poses(12)
    q[:, joint] += 0.05  # none is about zero
    reasons = found(q, joint)
    assert [reason.why for reason in reasons if reason.why is Why.SENSE_REVERSED]
    assert reasons[0].values["joint"] == arm().joint_names[joint]
    assert reasons[0].values["error_m"] < 0.5 * reasons[0].values["given_m"]


def test_the_sense_of_a_joint_that_stood_still_is_unknown():
    q = poses(12)
    q[:, 2] = 1e-4
    (reason,) = found(q)
    assert reason.why is Why.SENSE_UNKNOWN
    assert reason.values["joints"] == arm().joint_names[2]


def test_images_as_poses_have_the_boards_poses():
    q = poses(5)
    m = table(q)
    result, c = as_poses(arm(), cell(), m)
    T_camera_base, T_tip_board = mounts()
    T = T_camera_base @ arm().poses(q) @ T_tip_board
    np.testing.assert_allclose(result.points, T[:, :3, 3], atol=1e-6)
    np.testing.assert_allclose(result.rotations, T[:, :3, :3], atol=1e-6)
    assert set(result.kinds) == {"pose"}
    assert c.estimate_frame


def test_links_of_camera_and_board_that_are_exchanged_are_named():
    backwards = arm().rebuilt(base="panda_link0", tip="panda_link8")
    told = find_usual_mistake(backwards, cell(), table(poses(12)))
    assert told.why == Why.CAMERA_ON_OTHER_LINK
    assert (told.values["tip"], told.values["base"]) == ("panda_link8", "panda_link0")
    assert told.values["error_m"] < 5e-3 < 0.03 < told.values["given_m"]
