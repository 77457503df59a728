"""Aim: what it takes, and what it refuses."""

from __future__ import annotations

from typing import Any

import pytest

import calib
from calib.errors import ArgumentError, CalibError
from calib.verbs.plan.choice import MOST_POSES


def test_without_an_error_it_is_that_of_forty_poses_at_random():
    aim = calib.Aim()
    assert (aim.error, aim.poses, aim.region) == (None, 40, None)


def test_an_error_holds_over_a_region():
    region = calib.Region.box([0.2, -0.1, 0.1], [0.4, 0.1, 0.3])
    aim = calib.Aim(error=1e-4, region=region)
    assert aim.error == 1e-4
    assert aim.region is region


@pytest.mark.parametrize(
    "given",
    [
        {"error": 0.0},
        {"error": -1e-4},
        {"error": float("nan")},
        {"error": float("inf")},
        {"poses": 2},
        {"poses": MOST_POSES + 1},
    ],
)
def test_numbers_out_of_range_are_refused(given: dict[str, Any]):
    with pytest.raises(CalibError):
        calib.Aim(**given)


def test_an_error_in_millimetres_is_refused_and_the_unit_is_said():
    with pytest.raises(CalibError, match=r"in metres: 0\.2 mm is 0\.0002"):
        calib.Aim(error=0.2)
    assert calib.Aim(error=0.05).error == 0.05


@pytest.mark.parametrize("given", [{"error": "0.1"}, {"poses": 4.5}, {"region": "box"}])
def test_other_types_are_refused(given: dict[str, Any]):
    with pytest.raises(ArgumentError):
        calib.Aim(**given)


def test_the_least_and_most_poses_are_taken():
    assert calib.Aim(poses=3).poses == 3
    assert calib.Aim(poses=MOST_POSES).poses == MOST_POSES
