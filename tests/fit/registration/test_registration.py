"""Targets, measurement frames, sockets, planes and anchors found without a guess, from a robot that is wrong.

The nominal robot is 3 mm and 10 mrad a parameter off, frames lie anywhere within 4 m, targets 0.3 m from the tip.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import MeasurementError
from calib.fit.registration.refinement import _system
from calib.fit.registration.registration import (
    _near_rows,
    _settle,
    _subsample,
    nominal_setup,
    register,
    register_held_out,
)
from calib.fit.registration.rows import Rows
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.error_model import FRAME
from calib.model.parameter_sets import frame_and_target_model

FREE = Cell(estimate_frame=True)
PLANAR = Cell(estimate_frame=True, frame_directions=("x", "y", "rz"))

#: What a robot that wrong leaves over, rms [m, rad]; a false start leaves ten times as much.
LEFT = 0.02


def registered(scene, table, cell):
    rows, setup = rows_and_setup(scene.robot, table, cell)
    return register(scene.robot.poses(rows.joints), setup, rows), rows, setup


def rms(scene, found, rows):
    residual = rows.residual(found.target_poses(scene.robot.poses(rows.joints), rows.samples))[
        rows.used
    ]
    return np.sqrt(np.mean(residual**2))


def off(scene, found):
    """The largest error of a target's place, and of a frame that is wholly found [m]."""
    truth = scene.kinematics
    errors = [
        np.linalg.norm(found.T_tip_target[t, :3, 3] - truth.T_tip_target[int(name[1:]), :3, 3])
        for t, name in enumerate(found.targets)
    ]
    turned = [0.0]
    for f, name in enumerate(found.groups):
        if len(found.unknown[f]) == 6:
            D = np.linalg.inv(truth.T_frame_base[int(name)]) @ found.T_frame_base[f]
            errors.append(np.linalg.norm(D[:3, 3]))
            turned.append(Rotation.from_matrix(D[:3, :3]).magnitude())
    if found.rotation:
        for t, name in enumerate(found.targets):
            R = truth.T_tip_target[int(name[1:]), :3, :3].T @ found.T_tip_target[t, :3, :3]
            turned.append(Rotation.from_matrix(R).magnitude())
    return max(errors), max(turned)


def every(table, frames, targets, count):
    return [table(count, f, t) for f in frames for t in targets]


def flat(k):
    """A frame that is turned about z and moved on the floor."""
    rng = np.random.default_rng(k)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)).as_matrix()
    T[:2, 3] = rng.uniform(-3, 3, 2)
    return T


POINTS_AND_POSES = {
    "points": ({}, FREE, lambda s: [s.points(20)]),
    "six points": ({}, FREE, lambda s: [s.points(8)]),
    "three targets": ({"targets": 3}, FREE, lambda s: every(s.points, [0], range(3), 5)),
    "four set-ups": ({"frames": 4}, FREE, lambda s: every(s.points, range(4), [0], 6)),
    "targets and set-ups": (
        {"frames": 3, "targets": 2},
        FREE,
        lambda s: every(s.points, range(3), range(2), 6),
    ),
    "nothing in common": (
        {"frames": 3, "targets": 3},
        FREE,
        lambda s: [s.points(15, i, i) for i in range(3)],
    ),
    "known frame": ({"frames": [np.eye(4)]}, Cell(), lambda s: [s.points(6)]),
    "floor": ({"frames": [flat(1)]}, PLANAR, lambda s: [s.points(12)]),
    "another floor": ({"frames": [flat(5)]}, PLANAR, lambda s: [s.points(12)]),
    "two floors": (
        {"frames": [flat(2), flat(3)]},
        PLANAR,
        lambda s: every(s.points, range(2), [0], 12),
    ),
    "poses": ({}, FREE, lambda s: [s.poses(12)]),
    "few poses": ({}, FREE, lambda s: [s.poses(5)]),
    "poses, targets and set-ups": (
        {"frames": 3, "targets": 2},
        FREE,
        lambda s: every(s.poses, range(3), range(2), 5),
    ),
    "poses in a known frame": ({"frames": [np.eye(4)]}, Cell(), lambda s: [s.poses(12)]),
    "poses on a floor": ({"frames": [flat(4)]}, PLANAR, lambda s: [s.poses(12)]),
    "poses and points": ({}, FREE, lambda s: [s.poses(12), s.points(12)]),
}


@pytest.mark.parametrize("case", POINTS_AND_POSES)
def test_points_and_poses(make_scene, join, case):
    options, cell, tables = POINTS_AND_POSES[case]
    for seed in range(2):
        scene = make_scene(seed, **options)
        found, rows, _ = registered(scene, join(*tables(scene)), cell)
        assert rms(scene, found, rows) < LEFT
        length, angle = off(scene, found)
        assert length < 0.08
        assert angle < 0.08


def within_reach(make_scene, seed, frames=3, targets=1, **options):
    """Sockets and planes that the arm gets to, facing anywhere."""
    rng = np.random.default_rng(seed)
    places = np.tile(np.eye(4), (frames, 1, 1))
    for T in places:
        T[:3, :3] = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
        T[:3, 3] = -T[:3, :3] @ (np.array([0.3, 0.0, 0.15]) + rng.uniform(-0.1, 0.1, 3))
    return make_scene(seed, frames=list(places), targets=targets, **options)


SCENES = {
    "anchor": (1, 1, lambda s: [s.distances(30)]),
    "three anchors": (3, 1, lambda s: every(s.distances, range(3), [0], 12)),
    "anchor, two targets": (1, 2, lambda s: every(s.distances, [0], range(2), 20)),
    "pairs": (1, 1, lambda s: [s.pairs(25)]),
    "pairs of two targets": (1, 2, lambda s: every(s.pairs, [0], range(2), 20)),
    "socket": (1, 1, lambda s: [s.fixed(15)]),
    "sockets, two targets": (2, 2, lambda s: every(s.fixed, range(2), range(2), 6)),
    "plane": (1, 1, lambda s: [s.plane(30)]),
    "three planes": (3, 1, lambda s: every(s.plane, range(3), [0], 15)),
    "all": (3, 1, lambda s: [s.plane(15, 0), s.distances(10, 1), s.fixed(10, 2)]),
    "all beside points": (3, 1, lambda s: [s.plane(15, 0), s.points(10, 1), s.fixed(10, 2)]),
}


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("case", SCENES)
def test_anchors_pairs_sockets_and_planes(make_scene, join, case, seed):
    frames, targets, tables = SCENES[case]
    scene = within_reach(make_scene, seed, frames, targets)
    found, rows, _ = registered(scene, join(*tables(scene)), FREE)
    assert rms(scene, found, rows) < LEFT
    assert off(scene, found)[0] < 0.12  # a target 0.3 m away, from lengths alone


@pytest.mark.parametrize("case", ["points", "poses", "three anchors", "three planes", "pairs"])
def test_the_right_robot_is_registered_exactly(make_scene, join, case):
    right = {"length": 0.0, "angle": 0.0}
    if case in POINTS_AND_POSES:
        options, cell, tables = POINTS_AND_POSES[case]
        scene = make_scene(9, **options, **right)
    else:
        frames, targets, tables = SCENES[case]
        scene, cell = within_reach(make_scene, 9, frames, targets, **right), FREE
    found, rows, _ = registered(scene, join(*tables(scene)), cell)
    assert rms(scene, found, rows) < 1e-9
    if case != "pairs":  # they are blind to where the frame stands
        assert off(scene, found)[0] < 1e-7


@pytest.mark.parametrize(
    ("counts", "message"),
    [
        ([2], "2 rows to estimate from, with 6 numbers for 9 unknowns"),
        ([2, 2], "4 rows to estimate from, with 12 numbers for 15 unknowns"),
        # Enough numbers, but two points leave the rotation about the line through them.
        ([8, 2], "2 rows to estimate from, with 6 numbers for 6 unknowns"),
    ],
)
def test_fewer_numbers_than_unknowns_are_refused(make_scene, join, counts, message):
    scene = make_scene(12, frames=2)
    table = join(*(scene.points(count, f) for f, count in enumerate(counts)))
    with pytest.raises(MeasurementError, match=message):
        registered(scene, table, FREE)


def test_three_points_are_enough_at_a_further_station(make_scene, join):
    scene = make_scene(12, frames=2, length=0.0, angle=0.0)
    found, _, _ = registered(scene, join(scene.points(8, 0), scene.points(3, 1)), FREE)
    assert off(scene, found)[0] < 1e-7


def test_the_derivative_in_every_frame_and_target_against_differences(make_scene, join):
    scene = make_scene(11, frames=3, targets=2, reach=1.0)
    table = join(scene.poses(4, 0, 0), scene.points(4, 1, 1), scene.distances(4, 2, 0))
    rows, setup = rows_and_setup(scene.robot, table, FREE)
    setup = setup.with_poses(scene.kinematics.T_frame_base, scene.kinematics.T_tip_target)
    model = frame_and_target_model(setup.frame_unknowns, setup.target_unknowns, setup.targets)
    assert len(model) == setup.count == 6 + 6 + 3 + 6 + 3  # points tell nothing of a turn
    assert FRAME + "1" in model.places
    T_base_tip = scene.robot.poses(rows.joints)
    x = 0.1 * np.random.default_rng(12).normal(size=len(model))
    _, J = _system(model, T_base_tip, rows, setup, x)
    scale = 1e4  # of one over the smallest sigma
    for k in range(len(model)):
        e = 1e-3 * np.eye(len(model))[k]

        def at(v):
            return _system(model, T_base_tip, rows, setup, v)[0] / scale

        numeric = (8 * (at(x + e) - at(x - e)) - (at(x + 2 * e) - at(x - 2 * e))) / 12e-3
        np.testing.assert_allclose(J[:, k] / scale, numeric, atol=1e-7)


def test_only_planes_that_rows_touch_and_that_are_wholly_unknown_are_settled(make_scene, join):
    """Of others the directions that no row determines are not the settlement's to choose."""
    places = [np.eye(4) for _ in range(5)]
    for k, T in enumerate(places):
        T[:3, :3] = Rotation.random(random_state=k).as_matrix()
        T[:3, 3] = 0.1, 0.2, 0.3
    scene = make_scene(3, frames=places)
    table = join(*(scene.points(4, f) for f in range(5)))
    kinds = ("plane",) * 16 + ("point",) * 4
    rows, setup = rows_and_setup(scene.robot, replace(table, kinds=kinds), FREE)
    plane = ("z", "rx", "ry")
    setup = replace(
        setup.with_poses(np.array(places), setup.T_tip_target),
        unknown=(plane, ("z", "rx"), plane, plane, plane),
        own_axes=np.array([True, True, False, True, True]),
    )
    touched = rows.select(rows.samples.frame != 3)
    found = _settle(setup, touched)
    np.testing.assert_array_equal(found.T_frame_base[1:], setup.T_frame_base[1:])
    # The same plane up to its side, with its origin where the base's is nearest.
    assert np.abs(found.T_frame_base[0, 2] @ places[0][2]) == pytest.approx(1.0 + 0.3**2)
    np.testing.assert_allclose(found.T_frame_base[0, :2, 3], 0.0, atol=1e-12)


def numbered_rows(ur3, frame, target) -> Rows:
    """Points at random poses, with these numbers of frame and target."""
    count = len(frame)
    rng = np.random.default_rng(2)
    table = Measurements(ur3.joint_names, rng.uniform(-3, 3, (count, 6)), np.zeros((count, 3)))
    rows, _ = rows_and_setup(ur3, table, Cell())
    return replace(rows, samples=replace(rows.samples, frame=frame, target=target))


def test_a_registration_takes_as_many_rows_of_each_pair_of_a_frame_and_a_target(ur3):
    """200 rows for all four pairs, evenly spaced from the first to the last; not less than 20 of each."""
    frame = np.repeat([0, 0, 1, 1], [250, 100, 40, 10])
    target = np.repeat([0, 1, 0, 1], [250, 100, 40, 10])
    drawn = _subsample(numbered_rows(ur3, frame, target))
    assert np.bincount(2 * frame + target, drawn).tolist() == [50, 50, 40, 10]
    of_first = np.flatnonzero(drawn[:250])
    assert (of_first[0], of_first[-1]) == (0, 249)
    assert set(np.diff(of_first)) == {5, 6}
    assert np.sum(_subsample(numbered_rows(ur3, frame[:20], target[:20]))) == 20
    many = np.arange(600) % 12
    drawn = _subsample(numbered_rows(ur3, many, np.zeros(600, dtype=int)))
    assert np.bincount(many, drawn).tolist() == [20] * 12


RIGHT = {"length": 0.0, "angle": 0.0}

SPOILT = {
    "points": lambda s: (s.points(24), [3, 10]),
    "pairs": lambda s: (s.pairs(25), [4, 22]),
}


@pytest.mark.parametrize("case", SPOILT)
def test_outliers_are_left_out_of_a_registration(make_scene, case):
    """It is as without them and, of pairs, without the rows that they share a length with."""
    scene = make_scene(4, **RIGHT, noise=1e-4)
    table, wrong = SPOILT[case](scene)
    rows, setup = rows_and_setup(scene.robot, table, FREE)
    measured = rows.measured.copy()
    measured[wrong] += 0.5
    T_base_tip = scene.robot.poses(rows.joints)
    found = nominal_setup(T_base_tip, setup, replace(rows, measured=measured))
    good = ~np.isin(np.arange(len(rows)), [*wrong, *rows.partner[wrong]])
    expected = register(T_base_tip[good], setup, rows.select(good))
    np.testing.assert_allclose(found.T_tip_target, expected.T_tip_target, atol=1e-7)
    np.testing.assert_allclose(found.T_frame_base, expected.T_frame_base, atol=1e-7)


@pytest.mark.parametrize(
    ("counts", "wrong", "rejected"),
    [
        ([11], [0, 2, 3, 7], True),
        # Fewer than 60 percent of all rows would be left, or fewer than half of the second frame's.
        ([11], [0, 2, 3, 7, 8], False),
        ([16, 4], [1, 16, 17], True),
        ([16, 4], [16, 17, 18], False),
    ],
)
def test_no_rows_are_outliers_where_they_are_too_many(make_scene, join, counts, wrong, rejected):
    scene = make_scene(4, frames=2, **RIGHT, noise=1e-4)
    table = join(*(scene.points(count, f) for f, count in enumerate(counts)))
    rows, setup = rows_and_setup(scene.robot, table, FREE)
    setup = setup.with_poses(
        scene.kinematics.T_frame_base[: len(counts)], scene.kinematics.T_tip_target
    )
    measured = rows.measured.copy()
    measured[wrong] += 0.5
    near = _near_rows(setup, scene.robot.poses(rows.joints), replace(rows, measured=measured))
    if rejected:
        assert near is not None
        assert np.flatnonzero(~near).tolist() == wrong
    else:
        assert near is None


def test_what_was_given_stays_in_the_nominal_setup(make_scene):
    scene = make_scene(5, **RIGHT)
    rows, setup = rows_and_setup(scene.robot, scene.points(8), FREE)
    T_base_tip = scene.robot.poses(rows.joints)
    given = setup.with_poses(scene.kinematics.T_frame_base, setup.T_tip_target)
    given = replace(given, frame_given=np.array([True]))
    found = nominal_setup(T_base_tip, given, rows)
    np.testing.assert_array_equal(found.T_frame_base, given.T_frame_base)
    target = scene.kinematics.T_tip_target
    np.testing.assert_allclose(found.T_tip_target[:, :3, 3], target[:, :3, 3], atol=1e-9)
    both = replace(given, target_given=np.array([True]))
    np.testing.assert_array_equal(
        nominal_setup(T_base_tip, both, rows).T_tip_target, given.T_tip_target
    )


def test_a_frame_that_only_held_out_rows_see_is_added_to_the_fitted_ones(make_scene, join):
    """The other frame stays as fitted, and rows off by what it is off do not excuse an outlier of this one."""
    scene = make_scene(6, frames=2, **RIGHT)
    table = join(scene.points(20, 0), scene.points(20, 1))
    rows, setup = rows_and_setup(scene.robot, table, FREE)
    measured = rows.measured.copy()
    measured[25] += 0.2
    rows = replace(rows, measured=measured)
    moved = scene.kinematics.T_frame_base.copy()
    moved[0, :3, 3] += 0.1
    moved[1] = np.eye(4)
    fitted = setup.with_poses(moved, scene.kinematics.T_tip_target)
    held_out = replace(
        setup.with_fixed(np.array([True, False]), np.array([True])),
        unknown=((), setup.unknown[1]),
    )
    found = register_held_out(scene.robot.poses(rows.joints), fitted, held_out, rows)
    np.testing.assert_array_equal(found.T_frame_base[0], moved[0])
    np.testing.assert_array_equal(found.T_tip_target, fitted.T_tip_target)
    truth = scene.kinematics.T_frame_base[1]
    np.testing.assert_allclose(found.T_frame_base[1], truth, atol=1e-9)
    assert found.unknown == fitted.unknown


def test_as_many_numbers_as_unknowns_are_enough(make_scene, join):
    """One point for a target in a known frame, two for it too, and two poses at a further station."""
    known = make_scene(13, frames=[np.eye(4)], **RIGHT)
    for count in (1, 2):
        found, _, _ = registered(known, known.points(count), Cell())
        assert off(known, found)[0] < 1e-9
    scene = make_scene(13, frames=2, **RIGHT)
    found, _, _ = registered(scene, join(scene.poses(8, 0), scene.poses(2, 1)), FREE)
    assert off(scene, found)[0] < 1e-7


def test_with_too_many_outliers_every_row_counts(make_scene):
    """Four of nine rows, which outweigh each other: they move no frame that is only shifted."""
    frame = np.eye(4)
    frame[:3, 3] = 0.5, -0.2, 0.8
    scene = make_scene(7, frames=[frame], **RIGHT)
    cell = Cell(estimate_frame=True, frame_directions=("x", "y", "z"))
    rows, setup = rows_and_setup(scene.robot, scene.points(9), cell)
    setup = setup.with_poses(setup.T_frame_base, scene.kinematics.T_tip_target)
    setup = setup.with_fixed(np.array([False]), np.array([True]))
    measured = rows.measured.copy()
    measured[:4] += np.array([0.5, -0.5, 0.3, -0.3])[:, None]
    rows = replace(rows, measured=measured)
    found = nominal_setup(scene.robot.poses(rows.joints), setup, rows)
    np.testing.assert_allclose(found.T_frame_base[0], frame, atol=1e-9)


@pytest.mark.parametrize("cell", [FREE, Cell()])
def test_poses_are_registered_by_least_squares(make_scene, join, cell):
    """No small change of frame or targets lowers the sum of squares."""
    scene = make_scene(11, frames=[np.eye(4)], targets=2)
    rows, setup = rows_and_setup(scene.robot, join(scene.poses(12), scene.poses(12, 0, 1)), cell)
    T_base_tip = scene.robot.poses(rows.joints)
    found = register(T_base_tip, setup, rows)
    model = frame_and_target_model(found.frame_unknowns, found.target_unknowns, found.targets)
    r, J = _system(model, T_base_tip, rows, found, np.zeros(len(model)))
    gradient = J.T @ r / (np.linalg.norm(J, axis=0) * np.linalg.norm(r))
    assert np.abs(gradient).max() < 1e-5


def test_a_row_is_far_from_the_others_in_units_of_its_own_noise(make_scene):
    """Two rows are 3 cm off; the instrument is that coarse in one of them."""
    scene = make_scene(4, **RIGHT, noise=1e-4)
    rows, setup = rows_and_setup(scene.robot, scene.points(20), FREE)
    setup = setup.with_poses(scene.kinematics.T_frame_base, scene.kinematics.T_tip_target)
    measured, sigma = rows.measured.copy(), rows.sigma["m"].copy()
    measured[[5, 6], 0] += 0.03
    sigma[6] *= 1e3
    altered = replace(rows, measured=measured, sigma={"m": sigma})
    near = _near_rows(setup, scene.robot.poses(rows.joints), altered)
    assert near is not None
    assert np.flatnonzero(~near).tolist() == [5]
