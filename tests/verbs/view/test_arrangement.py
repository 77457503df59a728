"""Robots, labels and cameras: the robots in view, the magnified targets too, a tracker at the right."""

from __future__ import annotations

import numpy as np
import pytest

import calib.show.scene.scene as stage
from calib.show.scene.posed_robot import PosedRobot, read_visuals
from calib.verbs.view.arrangement import arrange, outline_of

NOTHING = np.zeros((0, 3))


@pytest.fixture(scope="module")
def posed(gantry):
    q = np.random.default_rng(3).uniform(-0.5, 0.5, (80, 3))
    base = np.broadcast_to(np.eye(4), (80, 4, 4))
    return PosedRobot.of(gantry, q, read_visuals(gantry.urdf)[0], base, np.eye(4))


def seen(points: np.ndarray, camera: stage.Camera) -> np.ndarray:
    """Where a camera sees points, shape (N, 2), each from -1 to 1 in a picture of 16:9."""
    local = (np.atleast_2d(points) - camera.centre) @ camera.axes.T
    half = np.tan(np.deg2rad(stage._FOV_DEG) / 2) * np.array([16 / 9, 1.0])
    return local[:, :2] / (camera.distance - local[:, 2:]) / half


def test_every_pose_of_both_robots_is_in_view(posed):
    shown = {"nominal": posed, "calibrated": posed}
    outline = outline_of(shown)
    # Of more than 60 poses too: no place of a link is left out.
    places = posed.poses[:, :, :3, 3].reshape(-1, 3)
    assert {tuple(p) for p in places} <= {tuple(p) for p in outline}
    layout = arrange(shown, 5, stage.span(outline), magnified=NOTHING, around=NOTHING)
    for offset in layout.offsets.values():
        assert np.abs(seen(places + offset, layout.side)).max() < 0.96
    right = np.subtract(*[layout.offsets[who] for who in ("calibrated", "nominal")])
    assert right @ layout.side.axes[0] > 0


def test_the_overlaid_camera_sees_the_magnified_targets(posed):
    shown = {"nominal": posed, "calibrated": posed}
    far = np.array([[0.0, 0.0, 9.0]])
    without, with_far = (
        arrange(shown, 0, 2.0, magnified=points, around=NOTHING) for points in (NOTHING, far)
    )
    assert seen(far, without.over)[0, 1] > 1
    assert seen(far, with_far.over)[0, 1] < 0.7
    np.testing.assert_array_equal(with_far.side.centre, without.side.centre)


def test_a_tracker_is_seen_at_the_right_behind_the_robot(posed):
    for tracker in (np.array([2.0, -3.0, 1.0]), np.array([-4.0, 0.0, 0.5])):
        layout = arrange(
            {"nominal": posed}, 0, 2.0, magnified=NOTHING, around=tracker[None], tracker=tracker
        )
        base = np.zeros(3)
        assert seen(tracker, layout.side)[0, 0] > seen(base, layout.side)[0, 0] + 0.3
        assert (tracker - base) @ layout.side.axes[2] < 0
        assert np.abs(seen(tracker, layout.side)).max() < 0.96


def test_of_a_robot_that_only_moves_what_is_below_its_floor_does_not_make_it_small(ur3):
    q = np.zeros((9, 6))
    # At index 4 the arm is stretched; elsewhere it goes through the floor.
    q[:, 1] = np.linspace(-np.pi, np.pi, 9)
    base = np.broadcast_to(np.eye(4), (9, 4, 4))
    moving = PosedRobot.of(ur3, q, read_visuals(ur3.urdf)[0], base, np.eye(4))
    shown = {"nominal": moving}
    all_of_it, above = (
        arrange(shown, 4, 1.2, magnified=NOTHING, around=NOTHING, only_moves=only_moves)
        for only_moves in (False, True)
    )
    assert above.side.distance < 0.75 * all_of_it.side.distance
    places = moving.poses[:, :, :3, 3].reshape(-1, 3)
    is_above = places[:, 2] >= moving.outline(slice(4, 5))[:, 2].min()
    assert not is_above.all()
    assert np.abs(seen(places[is_above], above.side)).max() < 0.96
    # Of one that hangs, with its base above the arm, all of the motion counts.
    turned = np.broadcast_to(np.diag([1.0, -1.0, -1.0, 1.0]), (9, 4, 4))
    hanging = PosedRobot.of(ur3, q, read_visuals(ur3.urdf)[0], turned, np.eye(4))
    layout = arrange(
        {"nominal": hanging}, 4, 1.2, magnified=NOTHING, around=NOTHING, only_moves=True
    )
    places = hanging.poses[:, :, :3, 3].reshape(-1, 3)
    assert np.abs(seen(places, layout.side)).max() < 0.96
