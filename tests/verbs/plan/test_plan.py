"""Plans of whole cells: every pose verified by means of its own, and what is said of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.data.cell import Box, Cell, Priors, Reflector, Tracker
from calib.errors import CalibError, ModelError
from calib.example import PAPER_TARGET
from calib.model.families import FAMILIES
from calib.numerics.moves import last_moves
from calib.robot.ranges import column_limits
from calib.verbs.plan.bodies import collision_model
from calib.verbs.plan.choice import PlanRequest
from calib.verbs.plan.collision import CollisionCheck
from calib.verbs.plan.forecast import covariance_root
from calib.verbs.plan.notes import Note
from calib.verbs.plan.plan import Plan, plan
from calib.verbs.plan.sensitivity import Sensitivity
from calib.verbs.workspace.region import Region
from tests.verbs.plan.fcl_scene import bodies, objects, touch

TARGET = np.array(PAPER_TARGET)
DEG = np.pi / 180.0


def box(name: str, size, centre) -> Box:
    T = np.eye(4)
    T[:3, 3] = centre
    return Box(name, np.array(size), T)


TABLE = box("table", (1.6, 1.6, 0.04), (0.0, 0.0, -0.03))
POST = box("post", (0.1, 0.1, 0.8), (0.45, -0.35, 0.4))

BARE = Cell(target=TARGET, model="hayati", sigma={"m": 1e-4}, priors=Priors(source="off"))
FULL = replace(
    BARE,
    boxes=(TABLE, POST),
    tracker=Tracker(np.array([2.2, 0.6, 0.5]), 1.9, 2.7),
    reflector=Reflector(np.array([0.0, 0.0, 1.0]), 50 * DEG),
    ranges={"shoulder_pan_joint": (-120 * DEG, 120 * DEG)},
)
#: Where the target may come: a ring of 50 mm voxels about the base.
_CENTRES = np.stack(np.meshgrid(*[np.arange(-0.775, 0.8, 0.05)] * 3, indexing="ij"), axis=-1)
_AWAY = np.linalg.norm(_CENTRES, axis=-1)
REGION = Region(np.full(3, -0.8), 0.05, (_AWAY > 0.25) & (_AWAY < 0.6), 0.95, 0.95)


@pytest.fixture(scope="module")
def full(ur3) -> Plan:
    return plan(ur3, FULL, PlanRequest(15, 4, candidates=300, seed=1), region=REGION)


@pytest.fixture(scope="module")
def bare(ur3) -> Plan:
    return plan(ur3, BARE, PlanRequest(15, 4, candidates=300), collisions=None)


def points(robot, q) -> np.ndarray:
    return (robot.poses(q) @ np.append(TARGET, 1.0))[:, :3]


# Every pose


def test_poses_are_inside_ranges_and_limits(ur3, full, bare):
    assert full.joints.shape == bare.joints.shape == (19, 6)
    assert np.abs(full.joints[:, 0]).max() <= 120 * DEG + 1e-12
    limits = np.array([(j.lower, j.upper) for j in ur3.inputs])
    for joints in (full.joints, bare.joints):
        assert (joints >= limits[:, 0] + 5 * DEG - 1e-12).all()
        assert (joints <= limits[:, 1] - 5 * DEG + 1e-12).all()
        np.testing.assert_allclose(joints / DEG * 1000, np.round(joints / DEG * 1000), atol=1e-6)
    assert np.abs(bare.joints[:, 0]).max() > 120 * DEG


def test_targets_lie_in_the_region(ur3, full, bare):
    away = np.linalg.norm(points(ur3, full.joints), axis=1)
    assert (away > 0.25 - 0.05 * np.sqrt(3)).all()
    assert (away < 0.6 + 0.05 * np.sqrt(3)).all()
    assert REGION.contains(points(ur3, full.joints)).all()
    assert not REGION.contains(points(ur3, bare.joints)).all()


def test_the_tracker_sees_every_target(ur3, full, bare):
    def seen(joints: np.ndarray) -> np.ndarray:
        towards = FULL.tracker.position - points(ur3, joints)
        distance = np.linalg.norm(towards, axis=1)
        facing = np.einsum("ni,ni->n", ur3.poses(joints)[:, :3, 2], towards) / distance
        return (distance >= 1.9) & (distance <= 2.7) & (facing >= np.cos(50 * DEG))

    assert seen(full.joints).all()
    assert not seen(bare.joints).all()


def touching(robot, q: np.ndarray, boxes) -> bool:
    """Whether FCL finds links, neighbours aside, or links and boxes in contact."""
    placed, links = objects(robot, q, boxes), list(bodies(robot))
    pairs = [(a, b) for i, a in enumerate(links) for b in links[i + 2 :]]
    # The flange's box is fixed to wrist 3 and reaches into wrist 2.
    pairs.remove(("wrist_2_link", "ee_link"))
    pairs += [(a, one.name) for one in boxes for a in links if a != "base_link"]
    return any(touch(placed[a], placed[b]) for a, b in pairs)


def test_every_pose_is_free_by_another_collision_library(ur3, full, bare):
    assert not any(touching(ur3, q, FULL.boxes) for q in full.joints)
    assert any(touching(ur3, q, FULL.boxes) for q in bare.joints)


@pytest.mark.slow
def test_targets_and_their_holders_stay_out_of_a_box_and_above_the_mounting_plane():
    # On an UR10 five of 35 targets were planned inside of this table, and 14 without it below the plane.
    robot, target = calib.Robot.load("ur10"), np.array([0.0, 0.05, 0.2])
    cell = Cell(target=target, model="zeros", sigma={"m": 1e-4})
    table = box("table", (3.0, 3.0, 0.05), (0.0, 0.0, -0.4))

    def lowest(boxes=(), **check) -> float:
        request = PlanRequest(8, 8, candidates=60, ladder=False)
        found = plan(robot, replace(cell, boxes=boxes), request, collisions=CollisionCheck(**check))
        return float(found.places(found.joints)[..., 2].min())

    assert lowest(floor=False) < -0.1
    assert lowest() > 0.0199
    assert lowest(boxes=(table,), floor=False) > -0.4 + 0.0249 + 0.0199


# What is said of them


def test_those_that_were_refused_are_counted_by_reason(full, bare):
    assert list(full.refused) == [
        "region",
        "tracker_range",
        "reflector_cone",
        "beam",
        "collision",
    ]
    assert all(count > 0 for count in full.refused.values())
    assert full.candidates == 300
    assert full.drawn - sum(full.refused.values()) >= 300
    assert bare.refused == {}


def test_notes_are_codes(ur3, full, bare):
    assert bare.notes == (Note("collisions_not_checked"),)
    codes = [note.code for note in full.notes]
    assert codes[0] == "collisions_checked"
    assert full.notes[0].values[:3] == (0.02, "table", "post")
    aimless = replace(FULL, target=None, tracker=None, model="auto")
    p = plan(ur3, aimless, PlanRequest(12, 0, candidates=60, ladder=False), collisions=None)
    assert p.model == "placement"
    assert [note.code for note in p.notes] == [
        "generic_target",
        "reflector_not_checked",
        "collisions_not_checked",
    ]


# Refusals


@pytest.mark.parametrize(
    ("cell", "request_", "given", "words"),
    [
        (
            replace(FULL, tracker=Tracker(np.array([9.0, 0.0, 0.0]), 0.0, 2.0)),
            PlanRequest(12, candidates=300),
            {},
            r"None of \d+ poses drawn can be measured; refused: \d+ by tracker_range\.",
        ),
    ],
)
def test_what_cannot_be_planned_is_refused(ur3, cell, request_, given, words):
    with pytest.raises(CalibError, match=words):
        plan(ur3, cell, request_, collisions=None, **given)


@pytest.fixture(scope="module")
def from_both_sides(ur3) -> Plan:
    cell = replace(FULL, model="hayati+lost_motion", priors=Priors("given"))
    request = PlanRequest(15, 4, candidates=300, seed=1, approach="both")
    return plan(ur3, cell, request, region=REGION)


def test_every_pose_is_measured_from_both_sides(ur3, from_both_sides):
    p = from_both_sides
    assert len(p.joints) == 2 * 19
    assert p.sets.count("validate") == 8
    np.testing.assert_array_equal(p.joints[::2], p.joints[1::2])
    np.testing.assert_allclose(p.moves[::2], 5 * DEG)
    np.testing.assert_allclose(p.moves[1::2], -5 * DEG)
    np.testing.assert_allclose(p.via, p.joints - p.moves, atol=1e-12)
    low, high = column_limits(ur3).T
    assert ((p.via >= low) & (p.via <= high)).all()
    assert (np.abs(p.via[:, 0]) <= 120 * DEG + 1e-9).all()


def test_the_ways_by_which_poses_are_approached_are_free(ur3, from_both_sides):
    p = from_both_sides
    model = collision_model(p.instrument, Sensitivity.of(ur3, p.cell), CollisionCheck())
    assert all(model.path_free(via, q) for via, q in zip(p.via, p.joints, strict=True))


def test_both_sides_determine_lost_motion_and_one_side_does_not(ur3, from_both_sides):
    """Approached from one side, lost motion is a part of the joints' zeros."""
    cell = replace(BARE, model="hayati+lost_motion", priors=Priors("given"))
    request = PlanRequest(15, 0, candidates=300, ladder=False, approach="one")
    one = plan(ur3, cell, request, collisions=None)
    names = one.forecast.names
    of_order = np.array([name.endswith(".lost_motion") for name in names])
    prior = FAMILIES["lost_motion"].prior
    both = from_both_sides.forecast
    assert both.names == names
    assert (both.parameter_std[of_order] < 0.6 * prior).all()
    assert both.identifiable[of_order].all()
    assert (one.forecast.parameter_std[of_order] > 0.9 * prior).all()
    assert not one.forecast.identifiable[of_order].any()
    assert one.forecast.rms > 2.0 * both.rms
    assert Note("one_side_hides") in one.notes
    assert Note("one_side_hides") not in from_both_sides.notes


def test_a_forecast_knows_the_order_to_drive(ur3):
    """As an analysis of the plan's own table, pose after pose, has it."""
    cell = replace(BARE, model="hayati+lost_motion", priors=Priors("given"))
    request = PlanRequest(15, 3, candidates=300, ladder=False)
    straight = plan(ur3, cell, request, collisions=None)
    sensitivity = Sensitivity.of(ur3, cell)
    chosen = np.array(straight.sets) == "estimate"
    measured = sensitivity.measured(straight.joints[chosen], last_moves(straight.joints)[chosen])
    root = covariance_root(measured, sensitivity.precision)
    np.testing.assert_allclose(
        straight.forecast.parameter_std, np.linalg.norm(root, axis=1), rtol=1e-9
    )
    as_if_in_the_tables_order = covariance_root(
        sensitivity.measured(straight.joints[chosen]), sensitivity.precision
    )
    assert not np.allclose(root, as_if_in_the_tables_order, rtol=1e-3)


def test_poses_taken_count_with_the_moves_by_which_they_were_reached(ur3):
    """Poses that were all approached from one side do not determine lost motion."""
    cell = replace(BARE, model="hayati+lost_motion", priors=Priors("given"))
    request = PlanRequest(15, 0, candidates=300, ladder=False, approach="one")
    one = plan(ur3, cell, request, collisions=None)
    few = PlanRequest(2, 0, candidates=300, ladder=False)
    taken = one.estimation
    more = plan(ur3, cell, few, taken=taken, taken_moves=one.moves, collisions=None)
    np.testing.assert_array_equal(more.taken_moves, one.moves)
    np.testing.assert_allclose(more.before.rms, one.forecast.rms, rtol=0.02)
    as_driven = plan(ur3, cell, few, taken=taken, collisions=None)
    assert as_driven.before.rms < 0.7 * more.before.rms
    with pytest.raises(ModelError, match=r"'taken_moves' must have one row for each of 'taken'"):
        plan(ur3, cell, few, taken=taken, taken_moves=one.moves[1:], collisions=None)


def test_an_unknown_approach_is_refused(ur3):
    with pytest.raises(ModelError, match=r"approach 'above'.*straight, one"):
        plan(ur3, BARE, PlanRequest(15, 4, candidates=300, approach="above"), collisions=None)
