"""Lengths that no arm is off by: which change, by how much, and the type of arm whose lengths are found."""

from __future__ import annotations

import numpy as np
import pytest

from calib.diagnosis.reasons import Why
from calib.diagnosis.variant import other_variant
from calib.robot.robot import Robot
from calib.robot.ur_models import UrModel, ur_model, ur_urdf


@pytest.fixture
def arm_with(tmp_path):
    """A function that makes a UR arm of whose DH lengths (row, column: 1 for a, 2 for d) some are changed [m]."""

    def make(name, changes=()):
        rows = ur_model(name).rows.copy()
        for row, column, change in changes:
            rows[row, column] += change
        path = tmp_path / "arm.urdf"
        path.write_bytes(ur_urdf(UrModel(name, rows)))
        return Robot.load(path, base="base", tip="tool0")

    return make


@pytest.mark.parametrize(("nominal", "true"), [("ur3e", "UR3"), ("ur10", "UR10e"), ("ur5", "UR5e")])
def test_another_variant_of_the_arm_is_named(arm_with, nominal, true):
    [reason] = other_variant(arm_with(nominal), arm_with(true, [(2, 1, 4e-4), (4, 2, -3e-4)]))
    assert (reason.why, reason.values["arm"]) == (Why.OTHER_VARIANT, true)
    assert (reason.values["joint"], reason.values["length"]) == ("wrist_1_joint", "d")
    moved = ur_model(true).rows[3, 2] - ur_model(nominal).rows[3, 2]
    assert reason.values["moved_m"] == pytest.approx(abs(moved), abs=1e-6)


@pytest.mark.parametrize(
    ("moved", "other", "said"),
    [
        (4.9e-3, 0.8e-3, False),  # below 5 mm, and not far beyond the others
        (5.1e-3, 0.8e-3, True),
        (2.0e-3, 0.2e-3, True),  # more than twenty times the rms of the seven others
        (2.0e-3, 0.3e-3, False),
        (0.9e-3, 0.0, False),  # so small no variant is
    ],
)
def test_a_length_must_be_off_by_more_than_an_arms_errors(arm_with, moved, other, said):
    changes = [(4, 2, moved), (1, 1, other)]
    found = list(other_variant(arm_with("ur3"), arm_with("ur3", changes)))
    assert bool(found) == said
    for reason in found:
        assert (reason.values["joint"], reason.values["length"]) == ("wrist_2_joint", "d")
        assert reason.values["moved_m"] == pytest.approx(moved, abs=1e-6)
        assert reason.values["others_m"] == pytest.approx(other / np.sqrt(7.0), abs=1e-6)
        assert reason.values["arm"] == ""


def test_where_base_and_target_are_tells_nothing_of_the_arm(arm_with):
    """The lengths of the first and of the last row."""
    assert not list(other_variant(arm_with("ur3"), arm_with("ur3", [(0, 2, 0.02), (5, 2, 0.02)])))
