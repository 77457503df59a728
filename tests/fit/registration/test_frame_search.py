"""Frames of which nothing is known are found from many starts, and only these are sought."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell
from calib.data.kinds import get
from calib.fit.registration.frame_search import (
    _agree,
    _random_pose,
    _rows_of_search,
    _starts,
    find_frame,
    frames_to_search,
    is_plausible,
)
from calib.fit.registration.registration import _search_frames, register
from calib.fit.registration.rows import NONE
from calib.fit.registration.table_rows import rows_and_setup
from tests.sought_frames import KINDS, TARGET, measured, sought_kinds, unstated

__all__ = ["sought_kinds"]
pytestmark = pytest.mark.usefixtures("sought_kinds")


def scene(robot, what="line", seed=1, count=None):
    """Rows, setup without the frame's pose, poses of the tip, and the setup registered from the frame's true pose."""
    table, cell = measured(robot, what, seed, count)
    rows, given = rows_and_setup(robot, table, cell)
    _, setup = rows_and_setup(robot, table, unstated(cell))
    T_base_tip = robot.poses(rows.joints)
    return rows, setup, T_base_tip, register(T_base_tip, given, rows)


def in_another_order(rows):
    """The numbers of rows in another order, and the rows in this order."""
    order = np.random.default_rng(0).permutation(len(rows))
    # What is selected are fewer rows than there are: all rows would be returned as they are.
    samples = rows.samples
    twice = replace(
        rows,
        samples=replace(
            samples,
            q=np.vstack([samples.q, samples.q]),
            frame=np.tile(samples.frame, 2),
            target=np.tile(samples.target, 2),
        ),
        kind=np.tile(rows.kind, 2),
        measured=np.vstack([rows.measured, rows.measured]),
        partner=np.tile(rows.partner, 2),
        sigma={unit: np.tile(sigma, 2) for unit, sigma in rows.sigma.items()},
        poses=np.tile(rows.poses, 2),
        blocks=np.tile(rows.blocks, 2),
    )
    return order, twice.select(order)


def rms(setup, T_base_tip, rows):
    residual = rows.residual(setup.target_poses(T_base_tip, rows.samples))
    return np.sqrt(np.mean(residual[rows.used] ** 2))


@pytest.mark.parametrize("what", KINDS)
@pytest.mark.parametrize("target", [TARGET, None])
def test_a_frame_is_found_as_from_its_true_pose(ur3, what, target):
    table, cell = measured(ur3, what, seed=2)
    rows, setup = rows_and_setup(ur3, table, replace(unstated(cell), target=target))
    _, given = rows_and_setup(ur3, table, cell)
    T_base_tip = ur3.poses(rows.joints)
    found = register(T_base_tip, setup, rows)
    expected = register(T_base_tip, given, rows)
    left = rms(expected, T_base_tip, rows)
    assert rms(found, T_base_tip, rows) == pytest.approx(left, rel=1e-6)
    if what in ("range", "wires", "camera"):
        origins = [
            -T[:3, :3].T @ T[:3, 3] for T in (found.T_frame_base[0], expected.T_frame_base[0])
        ]
        np.testing.assert_allclose(*origins, atol=1e-5)


def test_a_long_tool_and_a_distant_frame_are_found_too(panda):
    """The target is half a metre from the tip, and the table has no word of it."""
    table, cell = measured(panda, "range", seed=0)
    rows, setup = rows_and_setup(panda, table, replace(unstated(cell), target=None))
    T_base_tip = panda.poses(rows.joints)
    T_tip_target, T_frame_base = np.eye(4)[None].copy(), np.eye(4)[None].copy()
    T_tip_target[0, :3, 3] = 0.3, 0.1, 0.4
    T_frame_base[0, :3, 3] = 3.0, -2.0, 1.0
    truth = setup.with_poses(T_frame_base, T_tip_target)
    exact = rows.as_measured_at(truth.target_poses(T_base_tip, rows.samples))
    found = register(T_base_tip, setup, exact)
    np.testing.assert_allclose(found.T_frame_base, T_frame_base, atol=1e-5)
    np.testing.assert_allclose(found.T_tip_target, T_tip_target, atol=1e-5)


@pytest.mark.parametrize("count", [60, 150])
def test_the_order_of_the_rows_does_not_matter(ur3, count):
    rows, setup, T_base_tip, _ = scene(ur3, "camera", count=count + 1)
    rows, T_base_tip = rows.select(slice(count)), T_base_tip[:count]
    order, shuffled = in_another_order(rows)
    chosen, chosen_of_shuffled = _rows_of_search(rows), _rows_of_search(shuffled)
    assert np.sum(chosen) == 60
    np.testing.assert_array_equal(chosen[order], chosen_of_shuffled)
    found = register(T_base_tip, setup, rows)
    again = register(T_base_tip[order], setup, shuffled)
    np.testing.assert_allclose(again.T_frame_base, found.T_frame_base, atol=1e-6)
    np.testing.assert_allclose(again.T_tip_target, found.T_tip_target, atol=1e-6)
    np.testing.assert_array_equal(
        register(T_base_tip, setup, rows).T_frame_base, found.T_frame_base
    )


@pytest.mark.parametrize("what", ["line", "camera"])
def test_rows_of_a_search_differ_in_what_was_measured_where_joint_values_are_the_same(ur3, what):
    """The first reading alone differs."""
    rows, *_ = scene(ur3, what, count=151)
    rows = rows.select(slice(150))
    samples = replace(rows.samples, q=np.zeros_like(rows.joints))
    rows = replace(
        rows, samples=samples, measured=rows.measured * np.eye(rows.measured.shape[1])[0]
    )
    order, shuffled = in_another_order(rows)
    chosen = _rows_of_search(rows)
    np.testing.assert_array_equal(chosen[order], _rows_of_search(shuffled))
    ranks = np.argsort(np.argsort(rows.measured[:, 0]))[chosen]
    assert set(ranks) == set(np.linspace(0, 149, 60).astype(int))


def test_each_target_of_a_search_has_rows(ur3):
    rows, *_ = scene(ur3, count=150)
    samples = replace(rows.samples, target=np.arange(150) % 9)
    assert np.sum(_rows_of_search(replace(rows, samples=samples))) == 90


def test_a_frame_is_sought_only_where_nothing_tells_its_pose(ur3, make_scene):
    rows, setup, *_ = scene(ur3)
    assert frames_to_search(setup, rows) == [0]
    moved = np.eye(4)[None].copy()
    moved[0, 0, 3] = 1e-9
    assert frames_to_search(setup.with_poses(moved, setup.T_tip_target), rows) == []
    assert frames_to_search(setup.with_fixed(np.array([True]), np.array([False])), rows) == []
    for known in ("point", "distance", "plane"):
        kind = rows.kind.copy()
        kind[0] = 1
        mixed = replace(rows, kinds=(*rows.kinds, get(known)), kind=kind)
        assert frames_to_search(setup, mixed) == []
        one_more = replace(mixed, samples=replace(rows.samples, frame=1 - kind))
        two = replace(setup.with_poses(np.tile(np.eye(4), (2, 1, 1)), setup.T_tip_target))
        two = replace(two, groups=("b", "a"), unknown=setup.unknown * 2)
        assert frames_to_search(two, one_more) == [1]  # where the rows of the line are
    built_in = make_scene(0)
    points, of_points = rows_and_setup(
        built_in.robot, built_in.points(8), Cell(estimate_frame=True)
    )
    assert frames_to_search(of_points, points) == []


def test_frames_are_sought_in_the_order_of_their_stations_names(ur3):
    rows, setup, *_ = scene(ur3)
    samples = replace(rows.samples, frame=np.arange(len(rows)) % 3)
    three = replace(
        setup.with_poses(np.tile(np.eye(4), (3, 1, 1)), setup.T_tip_target),
        groups=("c", "a", "b"),
        unknown=setup.unknown * 3,
    )
    assert frames_to_search(three, replace(rows, samples=samples)) == [1, 2, 0]
    assert frames_to_search(three, rows) == [0]  # the others are not seen


def test_several_frames_are_found_beside_one_that_is_located(ur3):
    """Two lines and an anchor: the anchor's rows tell the target, then each line is found."""
    table, cell = measured(ur3, "line", seed=4, count=90)
    rows, setup = rows_and_setup(ur3, table, unstated(cell))
    station = np.arange(90) % 3
    rows = replace(
        rows,
        kinds=(*rows.kinds, get("distance")),
        kind=np.where(station == 2, 1, 0),
        samples=replace(rows.samples, frame=station),
    )
    T_frame_base = np.array([measured(ur3, "line", seed, 60)[1].T_frame_base for seed in range(3)])
    T_frame_base[2, :3, :3] = np.eye(3)
    setup = replace(
        setup.with_poses(np.tile(np.eye(4), (3, 1, 1)), np.eye(4)[None]),
        groups=("edge", "wire", "anchor"),
        unknown=(*setup.unknown * 2, ("x", "y", "z")),
        frame_given=np.zeros(3, dtype=bool),
        own_axes=np.array([True, True, False]),
    )
    T_base_tip = ur3.poses(rows.joints)
    T_tip_target = np.eye(4)[None].copy()
    T_tip_target[0, :3, 3] = 0.1, -0.2, 0.1
    truth = setup.with_poses(T_frame_base, T_tip_target)
    exact = rows.as_measured_at(truth.target_poses(T_base_tip, rows.samples))
    found = register(T_base_tip, setup, exact)
    assert rms(found, T_base_tip, exact) < 1e-8
    np.testing.assert_allclose(found.T_tip_target, T_tip_target, atol=1e-6)
    np.testing.assert_allclose(found.T_frame_base[2], T_frame_base[2], atol=1e-6)


def test_what_other_rows_tell_of_a_target_is_kept(ur3):
    """Five rows do not tell a line and a target, but they tell the line where an anchor's rows tell the target."""
    table, cell = measured(ur3, "line", seed=5, count=60)
    rows, setup = rows_and_setup(ur3, table, replace(unstated(cell), target=None))
    of_line = np.arange(60) < 5
    rows = replace(
        rows,
        kinds=(*rows.kinds, get("distance")),
        kind=np.where(of_line, 0, 1),
        samples=replace(rows.samples, frame=np.where(of_line, 0, 1)),
    )
    setup = replace(
        setup.with_poses(np.tile(np.eye(4), (2, 1, 1)), setup.T_tip_target),
        groups=("edge", "anchor"),
        unknown=(*setup.unknown, ("x", "y", "z")),
        frame_given=np.zeros(2, dtype=bool),
        own_axes=np.array([True, False]),
    )
    T_base_tip = ur3.poses(rows.joints)
    T_frame_base = np.tile(cell.T_frame_base, (2, 1, 1))
    T_frame_base[1, :3, :3] = np.eye(3)
    T_tip_target = np.eye(4)[None].copy()
    T_tip_target[0, :3, 3] = 0.1, -0.2, 0.1
    truth = setup.with_poses(T_frame_base, T_tip_target)
    exact = rows.as_measured_at(truth.target_poses(T_base_tip, rows.samples))
    found = _search_frames(setup, T_base_tip, exact, 1e-12)
    np.testing.assert_allclose(found.T_tip_target, T_tip_target, atol=1e-9)
    assert rms(found, T_base_tip, exact) < 1e-4


def test_pairs_in_a_sought_frame_tell_nothing_of_it_and_stay_whole(ur3):
    rows, setup, *_ = scene(ur3, count=150)
    kind, partner = rows.kind.copy(), rows.partner.copy()
    kind[:100:2], kind[1:100:2] = 1, NONE
    partner[:100:2] = np.arange(1, 100, 2)
    mixed = replace(rows, kinds=(*rows.kinds, get("pair")), kind=kind, partner=partner)
    assert frames_to_search(setup, mixed) == [0]
    chosen = _rows_of_search(mixed)
    assert np.sum(chosen & (kind != NONE)) == 60
    np.testing.assert_array_equal(chosen[:100:2], chosen[1:100:2])
    apart = replace(mixed, samples=replace(mixed.samples, frame=1 * (np.arange(150) < 100)))
    two = replace(
        setup.with_poses(np.tile(np.eye(4), (2, 1, 1)), setup.T_tip_target),
        groups=("edge", "nothing"),
        unknown=setup.unknown * 2,
    )
    assert frames_to_search(two, apart) == [0]


def test_few_starts_are_enough_where_they_agree(ur3):
    line, calls = KINDS["line"], []

    def counting(T):
        calls.append(len(T))
        return line.measure(T)

    rows, setup, T_base_tip, _ = scene(ur3)
    counted = replace(rows, kinds=(replace(line, measure=counting),))
    find_frame(setup, 0, T_base_tip, counted)
    assert len(calls) < 150
    assert set(calls) == {60}


def test_starts_lie_about_the_poses_and_are_the_same_each_time(ur3):
    rows, setup, T_base_tip, _ = scene(ur3, "wires")
    starts = list(_starts(setup, 0, T_base_tip, rows))
    again = list(_starts(setup, 0, T_base_tip, rows))
    assert len(starts) == 60
    T = np.array([start.T_frame_base[0] for start in starts])
    np.testing.assert_array_equal(T, [start.T_frame_base[0] for start in again])
    points = (T_base_tip @ [*TARGET, 1.0])[:, :3]
    centre = points.mean(axis=0)
    spread = np.sqrt(np.mean(np.sum((points - centre) ** 2, axis=1)))
    origins = -np.einsum("nji,nj->ni", T[:, :3, :3], T[:, :3, 3])
    distances = np.linalg.norm(origins - centre, axis=1) / spread
    assert 3.5 < distances.max() <= 4.0
    assert distances.min() < 0.5
    targets = np.array([start.T_tip_target[0, :3, 3] for start in starts])
    np.testing.assert_array_equal(targets[::2], np.tile(TARGET, (30, 1)))
    assert len(np.unique(targets[1::2].round(9), axis=0)) == 14


def test_starts_are_apart_where_the_robot_hardly_moves(ur3):
    rows, setup, T_base_tip, _ = scene(ur3, "range")
    still = np.tile(T_base_tip[:1], (len(rows), 1, 1))
    centre = (still[0] @ [*TARGET, 1.0])[:3]
    starts = [start.T_frame_base[0] for start in _starts(setup, 0, still, rows)]
    distances = [np.linalg.norm(-T[:3, 3] - centre) for T in starts]
    assert 0.35 < max(distances) <= 0.4


@pytest.mark.parametrize("directions", [("rx", "ry"), ("z", "rx", "ry"), ("x", "y", "z"), ("rz",)])
def test_a_start_is_displaced_only_in_directions_that_are_estimated(directions):
    random = np.random.default_rng(3)
    poses = np.array([_random_pose(random, directions, np.ones(3), 2.0) for _ in range(200)])
    turns = Rotation.from_matrix(poses[:, :3, :3]).as_rotvec()
    for k, axis in enumerate("xyz"):
        assert np.any(poses[:, k, 3] != 0.0) == (axis in directions)
        estimated = f"r{axis}" in directions
        assert np.any(np.abs(turns[:, k]) > 1e-9) == estimated
        if estimated:
            assert turns[:, k].min() < -2.0
            assert turns[:, k].max() > 2.0


def test_turns_of_starts_are_uniform():
    random = np.random.default_rng(3)
    six = ("x", "y", "z", "rx", "ry", "rz")
    R = np.array([_random_pose(random, six, np.zeros(3), 1.0)[:3, :3] for _ in range(2000)])
    np.testing.assert_allclose(R.mean(axis=0), 0.0, atol=0.06)
    np.testing.assert_allclose((R**2).mean(axis=0), 1.0 / 3.0, atol=0.03)


def test_residuals_of_most_rows_have_to_be_those_of_an_arm(ur3):
    limits = {"range": 0.02, "angle": 0.17, "camera": 100.0}
    for what, limit in limits.items():
        rows, _, T_base_tip, registered = scene(ur3, what)
        T_frame_target = registered.target_poses(T_base_tip, rows.samples)
        exact = rows.as_measured_at(T_frame_target)
        for share, plausible in ((0.98, True), (1.02, False)):
            error = np.zeros_like(exact.measured)
            error[:, 0] = share * limit
            far = replace(exact, measured=exact.measured + error)
            assert is_plausible(registered, T_base_tip, far) == plausible
    error[: int(0.6 * len(rows))] = 0.0
    with_outliers = replace(exact, measured=exact.measured + 100.0 * error)
    assert is_plausible(registered, T_base_tip, with_outliers)


def test_three_starts_have_to_agree_on_the_lowest_minimum(ur3):
    rows, setup, T_base_tip, good = scene(ur3)
    bad = setup  # far off, at the identity
    assert _agree([(1e3, good), (1.009e3, bad), (1e3, bad)], T_base_tip, rows)
    assert not _agree([(1e3, good), (1.011e3, bad), (1e3, bad)], T_base_tip, rows)
    assert not _agree([(1e3, good), (1e3, good)], T_base_tip, rows)
    assert not _agree([(1e3, good)] * 3 + [(1.0, good)], T_base_tip, rows)
    assert not _agree([(1e3, bad)] * 3, T_base_tip, rows)
    nothing = 0.9e-6 * len(rows)
    assert _agree([(0.0, good), (nothing, good), (nothing, good)], T_base_tip, rows)
    assert not _agree([(0.0, good), (nothing, good), (1.2 * nothing, good)], T_base_tip, rows)


def test_starts_at_which_a_residual_is_not_finite_are_left_out(ur3):
    """A kind that divides by a depth that is zero or negative, and does not say so, is found from the other starts."""
    camera = KINDS["camera"]

    def unguarded(T):
        return camera.measure(T) * np.sqrt(np.sign(T[:, 2:3, 3]))  # and warns

    rows, setup, T_base_tip, registered = scene(ur3, "camera")
    rows = replace(rows, kinds=(replace(camera, measure=unguarded),))
    found = register(T_base_tip, setup, rows)
    assert rms(found, T_base_tip, rows) == pytest.approx(rms(registered, T_base_tip, rows))
    nowhere = replace(camera, measure=lambda T: np.full((len(T), 2), np.nan))
    kept = find_frame(setup, 0, T_base_tip, replace(rows, kinds=(nowhere,)))
    np.testing.assert_array_equal(kept.T_frame_base, setup.T_frame_base)
