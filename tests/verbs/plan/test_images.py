"""Plans of images: what they hold, what they remark, and whether a fit of such images is as good as forecast."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from calib.basics.arrays import Array
from calib.camera.lenses import LENSES
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import ArgumentError, CalibError
from calib.instruments.camera import SightLimits, board_tilts
from calib.result.calibrate import calibrate
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.plan.choice import PlanRequest
from calib.verbs.plan.plan import Plan, plan
from calib.verbs.workspace.region import Region
from tests.instruments.scenes import BOARD, SIZE, at_places, in_hand, pose, standing
from tests.verbs.compensate.arms import off

EXACT = replace(BOARD, sigma_scale=1e-5, sigma_corner=0.0)
SMALL = PlanRequest(12, 2, candidates=120, ladder=False)


def cell(seen=None, **changes) -> Cell:
    """A cell with a camera and a board as they are in a sightline; at no place without one."""
    given = {
        "model": "hayati",
        "sigma": {"px": 0.2},
        "cameras": {"": SIZE},
        "boards": {"": EXACT},
    }
    made = Cell(**(given | changes))
    return made if seen is None else at_places(made, seen.T_instrument_base, seen.T_tip_target)


@cache
def planned(where=in_hand, request: PlanRequest = SMALL) -> Plan:
    seen = where("ur5")
    return plan(seen.robot, cell(seen), request, collisions=None)


@pytest.mark.parametrize("where", [in_hand, standing])
def test_every_image_of_a_plan_shows_the_board(where):
    found = planned(where)
    assert found.joints.shape == (14, 6)
    assert found.sets.count("validate") == 2
    assert found.kind == "pixel"
    T = found.sightline.target_poses(found.joints)
    assert found.instrument.in_image(T).all()
    assert found.instrument.in_focus(T).all()
    assert found.instrument.is_facing(T).all()
    np.testing.assert_allclose(found.expected[:, 0], (T @ np.append(BOARD.centre, 1.0))[:, :3])
    assert found.forecast.rms < found.at_random.rms
    assert found.candidates == 120


def test_the_limits_asked_for_are_kept():
    seen = in_hand("ur5")
    request = replace(SMALL, sight=SightLimits((0.5, 0.8), tilt=0.4, share=0.8))
    found = plan(seen.robot, cell(seen), request, collisions=None)
    T = found.sightline.target_poses(found.joints)
    assert found.instrument.board_distances(T).min() >= 0.5
    assert found.instrument.board_distances(T).max() <= 0.8
    assert board_tilts(found.instrument.board, T).max() <= 0.4


def test_images_taken_already_count_each_once():
    seen = in_hand("ur5")
    first = planned()
    rows = np.repeat(first.estimation, 3, axis=0)
    few = PlanRequest(4, 0, candidates=120, ladder=False, seed=1)
    more = plan(seen.robot, cell(seen), few, taken=rows, collisions=None)
    assert len(more.taken) == 12
    assert more.before.rms == pytest.approx(first.forecast.rms)
    assert more.forecast.rms < first.forecast.rms


def test_a_print_that_is_not_measured_makes_most_of_the_error():
    seen = in_hand("ur5")
    rough = cell(seen, boards={"": replace(BOARD, sigma_scale=0.003)})
    found = plan(seen.robot, rough, SMALL, collisions=None)
    note = found.notes[0]
    assert note.code == "board_scale"
    assert note.values[0] == 0.003
    assert note.values[1] < 0.7 * found.forecast.rms
    assert note.values[1] == pytest.approx(planned().forecast.rms, rel=0.2)
    assert "board_scale" not in [other.code for other in planned().notes]


def test_600_candidates_are_usual():
    seen = in_hand("ur5")
    request = PlanRequest(6, 0, ladder=False)
    assert plan(seen.robot, cell(seen), request, collisions=None).request.candidates == 600


def test_where_the_board_is_must_be_known_and_no_region_is_taken():
    seen = in_hand("ur5")
    with pytest.raises(CalibError, match="--board-at"):
        plan(seen.robot, cell(), SMALL)
    region = Region(np.zeros(3), 0.1, np.ones((2, 2, 2), dtype=bool), 1.0, 1.0)
    with pytest.raises(CalibError, match="--region is for targets"):
        plan(seen.robot, cell(seen), SMALL, region=region, collisions=None)
    with pytest.raises(ArgumentError, match="sight"):
        PlanRequest(sight=3)


# The forecast


def images_of(plan: Plan, seed: int) -> tuple[Measurements, Robot, Array, Array]:
    """Images by a robot with errors; that robot; and the true poses of its camera and of the board."""
    seen = plan.sightline
    rng = np.random.default_rng(seed)
    true = off(plan.robot, seed, "hayati")
    T_frame_base = (
        pose(rng.normal(size=3) * 5e-3, rng.normal(size=3) * 0.02) @ seen.T_instrument_base
    )
    T_tip_board = seen.T_tip_target @ pose(rng.normal(size=3) * 5e-3, rng.normal(size=3) * 0.02)
    T = T_frame_base @ true.poses(plan.joints) @ T_tip_board
    T[:, :3, 3] += rng.normal(size=(len(T), 3)) * 2e-5
    corners = np.einsum("nij,cj->nci", T[:, :3, :3], BOARD.corners) + T[:, None, :3, 3]
    values = np.array([1010.0, 1015.0, 650.0, 470.0, -0.1, 0.05, 1e-3, -5e-4, 0.0])
    pixels = LENSES["pinhole"].project(corners.reshape(-1, 3), values)
    pixels += rng.normal(size=pixels.shape) * 0.2
    n, c = corners.shape[:2]
    table = Measurements(
        joint_names=plan.robot.joint_names,
        joints=np.repeat(plan.joints, c, axis=0),
        points=np.full((n * c, 3), np.nan),
        kinds=("pixel",) * (n * c),
        readings={"u": pixels[:, 0], "v": pixels[:, 1]},
        board_points=np.tile(BOARD.corners, (n, 1)),
        corners=tuple(np.tile(np.arange(c).astype(str), n)),
        images=tuple(np.repeat([f"image_{k}.png" for k in range(n)], c)),
    )
    return table, true, T_frame_base, T_tip_board


@pytest.mark.slow
def test_a_fit_is_as_good_as_forecast():
    plan = planned(in_hand, PlanRequest(30, 0, candidates=300, ladder=False))
    q = random_joint_values(plan.robot, 500, 5)
    centre = np.append(BOARD.centre, 1.0)
    squares = []
    for seed in range(6):
        table, true, T_frame_base, T_tip_board = images_of(plan, seed)
        fit = cell(base=plan.robot.base, tip=plan.robot.tip)
        result = calibrate(plan.robot, table, cell=fit, validate=False)
        predicted = result.T_frame_base @ result.predict_poses(q) @ centre
        actual = T_frame_base @ true.poses(q) @ T_tip_board @ centre
        squares.append(np.mean(np.sum((predicted - actual) ** 2, axis=1)))
    assert np.sqrt(np.mean(squares)) == pytest.approx(plan.forecast.rms, rel=0.4)
