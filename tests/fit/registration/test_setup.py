"""Frames and targets of a setup: the directions of their parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell, GroupDistance
from calib.errors import ModelError
from calib.fit.registration.labels import joined_stations
from calib.fit.registration.setup import KnownDistance, Setup, known_distances
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.error_model import ErrorModel
from calib.model.kinematics import Kinematics, Samples
from calib.model.parameter_sets import frame_and_target_model
from calib.robot.robot import Robot
from calib.robot.urdf import read_urdf
from tests.fit.registration.tables import as_kind


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_planes_directions_move_it_wherever_it_faces(scene, ur3, axis):
    """Height and two tilts, of one metre and one radian a unit: no direction of a wall is lost."""
    quarter = {"x": ("y", -90), "y": ("x", 90), "z": ("z", 0)}[axis]
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler(*quarter, degrees=True).as_matrix()
    _, setup = rows_and_setup(ur3, as_kind(scene.points(4), "plane"), Cell())
    setup = setup.with_poses(T[None], setup.T_tip_target)
    plain = frame_and_target_model(setup.frame_unknowns, (), setup.target_names, rotation=False)
    model = setup.turn_directions(plain)
    assert model.names == plain.names == ("frame_z", "frame_rx", "frame_ry")
    names = tuple(joint.name for joint in scene.robot.joints)
    places = (model.places[0], *names, *model.places[1:])
    whole = ErrorModel("frames", places, model.parameters)
    kinematics = Kinematics(scene.robot, whole, T, np.eye(4))
    poses, twists = kinematics.twists(np.zeros(3), scene.samples(5))
    x, y, z = poses[:, :3, 3].T
    np.testing.assert_allclose(twists[:, 2, 0], 1.0, atol=1e-12)
    np.testing.assert_allclose(twists[:, 2, 1], y, atol=1e-12)
    np.testing.assert_allclose(twists[:, 2, 2], -x, atol=1e-12)
    assert np.ptp(z) > 0.01


#: Turns of two frames and two targets.
TURNS = Rotation.from_rotvec([[0.3, -0.2, 0.5], [1.0, 0.4, 0.0], [0.0, 0.9, 0.2], [-0.6, 0.0, 1.2]])


def two_frames_and_targets(**changes) -> Setup:
    """A tracker's frame and a plane's, the one given; targets of which the second is given."""
    T = np.tile(np.eye(4), (4, 1, 1))
    T[:, :3, :3] = TURNS.as_matrix()
    T[:, :3, 3] = np.arange(12.0).reshape(4, 3) / 10.0
    setup = Setup(
        groups=("tracker", "plane"),
        targets=("a", "b"),
        T_frame_base=T[:2],
        T_tip_target=T[2:],
        unknown=(("x", "y", "rz"), ("z", "rx")),
        frame_given=np.array([True, False]),
        target_unknown=np.array([True, True]),
        target_given=np.array([False, True]),
        rotation=False,
        own_axes=np.array([False, True]),
    )
    return replace(setup, **changes)


def samples_of(frame, target) -> Samples:
    return Samples(np.zeros((len(frame), 6)), np.array(frame), np.array(target))


def test_unknowns_are_the_directions_of_frames_and_the_coordinates_of_targets():
    setup = two_frames_and_targets()
    assert setup.count == 3 + 2 + 2 * 3
    assert replace(setup, rotation=True).count == 3 + 2 + 2 * 6
    one = replace(setup, target_unknown=np.array([False, True]))
    assert (one.count, one.unknown_targets, one.estimate_target) == (3 + 2 + 3, ("b",), True)
    assert not replace(setup, target_unknown=np.zeros(2, dtype=bool)).estimate_target


def test_what_is_given_or_was_observed_is_fixed():
    setup = two_frames_and_targets()
    fixed = setup.with_given_fixed()
    assert fixed.unknown == ((), ("z", "rx"))
    assert fixed.target_unknown.tolist() == [True, False]
    observed = setup.with_given_fixed(samples_of([1], [1]))
    assert observed.unknown == ((), ())
    assert observed.target_unknown.tolist() == [True, False]


def test_samples_see_an_unknown_by_their_frame_or_their_target():
    setup = two_frames_and_targets(unknown=((), ("z",)), target_unknown=np.array([False, True]))
    samples = samples_of([0, 1, 0, 1], [0, 0, 1, 1])
    assert setup.unknown_at(samples).tolist() == [False, True, True, True]
    frames, targets = setup.seen_by(samples_of([1, 1], [0, 0]))
    assert (frames.tolist(), targets.tolist()) == ([False, True], [True, False])


def test_a_target_is_predicted_in_the_frame_of_its_sample():
    setup = two_frames_and_targets()
    T_base_tip = np.tile(np.eye(4), (2, 1, 1))
    T_base_tip[:, :3, 3] = [[0.5, 0.0, 0.1], [0.0, -0.4, 0.2]]
    found = setup.target_poses(T_base_tip, samples_of([1, 0], [0, 1]))
    for k, (f, t) in enumerate([(1, 0), (0, 1)]):
        expected = setup.T_frame_base[f] @ T_base_tip[k] @ setup.T_tip_target[t]
        np.testing.assert_allclose(found[k], expected)


def test_parameters_move_targets_along_the_tip_and_turn_them_about_their_own_axes():
    """Frames that are no planes move along the base's axes."""
    setup = two_frames_and_targets(rotation=True)
    model = setup.turn_directions(
        frame_and_target_model(
            setup.frame_unknowns, setup.unknown_targets, setup.target_names, rotation=True
        )
    )
    x = np.zeros(len(model))
    moves = {"target_x[a]": 0.1, "target_z[a]": -0.2, "target_ry[b]": 0.3, "frame_y[tracker]": 0.4}
    for name, value in moves.items():
        x[model.index(name)] = value
    found = setup.displaced(model.displacements(x)[0])
    shift = found.T_tip_target[:, :3, 3] - setup.T_tip_target[:, :3, 3]
    np.testing.assert_allclose(shift, [[0.1, 0.0, -0.2], [0.0, 0.0, 0.0]], atol=1e-12)
    turn = Rotation.from_rotvec([0.0, 0.3, 0.0])
    np.testing.assert_allclose(found.T_tip_target[0, :3, :3], TURNS[2].as_matrix(), atol=1e-12)
    turned = (TURNS[3] * turn).as_matrix()
    np.testing.assert_allclose(found.T_tip_target[1, :3, :3], turned, atol=1e-12)
    moved = np.eye(4)
    moved[1, 3] = 0.4
    np.testing.assert_allclose(found.T_frame_base[0], setup.T_frame_base[0] @ moved, atol=1e-12)
    np.testing.assert_array_equal(found.T_frame_base[1], setup.T_frame_base[1])


def test_directions_are_turned_of_parameters_that_follow_others_too():
    """A plane's height that follows a target's coordinate, which stays along the axes that it shares with the tip."""
    T_tip_target = np.tile(np.eye(4), (2, 1, 1))
    setup = two_frames_and_targets(unknown=((), ("z",)), T_tip_target=T_tip_target)
    plain = frame_and_target_model(
        setup.frame_unknowns, setup.unknown_targets, setup.target_names, rotation=False
    )
    tied = plain.tied({"frame_z[plane]": ("target_x[a]", 1.0)})
    turned = setup.turn_directions(tied)
    assert turned.parameters == tied.parameters
    (height,) = [term for term in turned.terms if term.name == "frame_z[plane]"]
    np.testing.assert_allclose(height.direction[:3], TURNS[1].as_matrix().T[:, 2], atol=1e-12)


def test_each_row_is_seen_through_the_chain_between_its_links():
    """Frames and targets of which no link is stated are on the robot's base and tip."""
    base, elbow, wrist, tip = "panda_link0", "panda_link3", "panda_link5", "panda_link8"
    urdf = read_urdf("panda")
    robot = Robot.from_urdf(urdf, base, tip, branches=[(elbow, tip), (base, wrist)])
    frame, target = np.array([0, 1, 1, 0]), np.array([0, 1, 0, 0])
    setup = two_frames_and_targets(frame_links=(elbow, base), target_links=(tip, wrist))
    np.testing.assert_array_equal(setup.chains(robot, frame, target), [1, 2, 0, 1])
    with pytest.raises(ModelError):
        setup.chains(robot, np.array([0]), np.array([1]))
    of_targets = replace(setup, frame_links=())
    np.testing.assert_array_equal(of_targets.chains(robot, frame, target), [0, 2, 0, 0])
    of_frames = replace(setup, target_links=())
    np.testing.assert_array_equal(of_frames.chains(robot, frame, target), [1, 0, 0, 1])
    assert setup.chains(Robot.from_urdf(urdf, base, tip), frame, target) is None


def named(table, names):
    return replace(table, groups=tuple(names))


def test_a_star_stands_for_the_same_text_in_both_groups(four_frames, ur3):
    groups = ["a/0", "a/1", "b/0", "b/1", "c/1", "?/0", "[x]/0", "[x]/1"]
    table = named(as_kind(four_frames.points(8), "fixed"), groups)
    cell = Cell(
        distances=(GroupDistance("*/0", "*/1", 0.2, 1e-5), GroupDistance("a/0", "b/0", 0.5, 2e-5))
    )
    rows, setup = rows_and_setup(ur3, table, cell)
    known = known_distances(cell, setup)
    assert known == (
        KnownDistance(0, 1, 0.2, 1e-5),
        KnownDistance(2, 3, 0.2, 1e-5),
        KnownDistance(6, 7, 0.2, 1e-5),
        KnownDistance(0, 2, 0.5, 2e-5),
    )
    np.testing.assert_array_equal(joined_stations(rows, known), [0, 0, 0, 0, 1, 2, 3, 3])
    np.testing.assert_array_equal(joined_stations(rows, ()), np.arange(8))
