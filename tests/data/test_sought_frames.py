"""A kind from outside without `locate`: given or sought, its frame leaves the same errors."""

from __future__ import annotations

from operator import attrgetter

import pytest

import calib
from calib.diagnosis.reasons import Why
from tests.sought_frames import KINDS, measured, sought_kinds, unstated

__all__ = ["sought_kinds"]
pytestmark = pytest.mark.usefixtures("sought_kinds")


def check_that_it_does_not_matter_whether_the_frame_is_given(robot, what, seed):
    table, cell = measured(robot, what, seed)
    given = calib.calibrate(robot, table, cell=cell)
    sought = calib.calibrate(robot, table, cell=unstated(cell))
    for part in ("trust.nominal_cross_validation", "geometry.cross_validation"):
        validation = attrgetter(part)
        expected = validation(given).errors.leading.rms
        assert validation(sought).errors.leading.rms == pytest.approx(expected, rel=1e-4)
    assert sought.verdict.use == given.verdict.use
    assert Why.FAR_OFF_BEFORE not in [reason.why for reason in sought.verdict.reasons]


@pytest.mark.parametrize("seed", range(3))
def test_a_line_is_found(ur3, seed):
    check_that_it_does_not_matter_whether_the_frame_is_given(ur3, "line", seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("name", ["ur3", "panda"])
def test_twenty_lines_are_found(request, name, seed):
    robot = request.getfixturevalue(name)
    check_that_it_does_not_matter_whether_the_frame_is_given(robot, "line", seed)


@pytest.mark.slow
@pytest.mark.parametrize("what", KINDS)
@pytest.mark.parametrize("name", ["ur3", "panda"])
def test_frames_of_other_kinds_are_found(request, name, what):
    robot = request.getfixturevalue(name)
    check_that_it_does_not_matter_whether_the_frame_is_given(robot, what, 0)
