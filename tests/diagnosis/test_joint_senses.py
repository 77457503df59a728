"""Senses of joints: each one reversed in turn is named, and one that did not move is said to be unknown."""

from __future__ import annotations

from dataclasses import replace

import pytest

from calib.diagnosis.joint_senses import doubtful_senses
from calib.diagnosis.reasons import Why
from tests.images import arm, cell, poses, table


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
