"""A plan with what shows it."""

from __future__ import annotations

import pickle

import pytest

from calib.data.cell import Cell
from calib.verbs.plan.choice import PlanRequest
from calib.verbs.plan.plan import Plan, plan
from calib.verbs.plan.text import plan_text


@pytest.fixture(scope="module")
def planned(ur3) -> Plan:
    request = PlanRequest(count=20, validation=3, candidates=300)
    return plan(ur3, Cell(model="dh"), request, collisions=None)


def test_its_summary_is_what_the_command_line_prints(planned: Plan):
    assert isinstance(planned, Plan)
    assert planned.summary() == plan_text(planned)


def test_its_line_has_the_robot_the_poses_and_the_expected_error(planned: Plan):
    expected = f"expected rms {1e3 * planned.forecast.rms:.3f} mm)"
    assert repr(planned) == f"Plan('ur3', base to tool0, 20 poses and 3 for validation, {expected}"
    assert repr(pickle.loads(pickle.dumps(planned))) == repr(planned)
