"""Tables as the fit takes them: kinds, pairs, repeats, loads, noise, and known distances by pattern."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.errors import MeasurementError, ModelError
from calib.identify.rows import NONE
from calib.identify.setup import (
    FIRST_SIGMA,
    FIRST_SIGMA_ANGLE,
    KnownDistance,
    _joined,
    joined_setups,
    known_distances,
    rows_of,
)
from calib.measure.cell import Cell, GroupDistance
from calib.measure.measurements import Measurements
from calib.model.torques import Payload, gravity_load

#: Numbers of kinds in the registry.
DISTANCE, FIXED, PAIR, PLANE, POINT, POSE = 2, 4, 3, 5, 0, 1


@pytest.fixture(scope="module")
def scene(make_scene):
    return make_scene(1, frames=4, targets=2, reach=1.0)


def as_kind(table, kind):
    return replace(table, kinds=(kind,) * len(table))


def test_every_kind_has_its_number_and_nothing_is_nan(scene, join, ur3):
    table = join(
        scene.points(2),
        scene.poses(2, 1, 1),
        scene.distances(2, 2),
        scene.pairs(1, 0, 1),
        as_kind(scene.points(1, 3), "fixed"),
        as_kind(scene.points(1, 1), "plane"),
    )
    rows, setup = rows_of(ur3, table, Cell())
    np.testing.assert_array_equal(
        rows.kinds, [POINT, POINT, POSE, POSE, DISTANCE, DISTANCE, PAIR, NONE, FIXED, PLANE]
    )
    for values in (rows.points, rows.measured, rows.scales):
        assert np.all(np.isfinite(values))
    np.testing.assert_array_equal(rows.points[:4], table.points[:4])
    np.testing.assert_array_equal(rows.points[4:], 0.0)
    np.testing.assert_array_equal(rows.measured[2:4, 3:], table.rotations[2:4].reshape(2, 9))
    np.testing.assert_array_equal(rows.measured[4:7, 0], table.distances[4:7])
    np.testing.assert_array_equal(rows.measured[7:], 0.0)
    np.testing.assert_array_equal(rows.samples.frame, [0, 0, 1, 1, 2, 2, 0, 0, 3, 1])
    np.testing.assert_array_equal(rows.samples.target, [0, 0, 1, 1, 0, 0, 1, 1, 0, 0])
    assert setup.rotation


def test_columns_stand_in_the_robots_order(scene, ur3):
    table = scene.points(3)
    order = [3, 0, 5, 1, 2, 4]
    names = tuple(table.joint_names[k] for k in order)
    turned = Measurements(names, table.joints[:, order], table.points)
    rows, _ = rows_of(ur3, turned, Cell())
    np.testing.assert_array_equal(rows.joints, table.joints)


def test_the_first_row_of_a_pair_carries_the_distance(scene, ur3):
    table = scene.pairs(3)
    order = np.array([0, 2, 5, 4, 1, 3])
    mixed = Measurements(
        table.joint_names,
        table.joints[order],
        table.points[order],
        kinds=("pair",) * 6,
        pairs=tuple(table.pairs[k] for k in order),
        distances=table.distances[order],
    )
    rows, _ = rows_of(ur3, mixed, Cell())
    np.testing.assert_array_equal(rows.kinds, [PAIR, PAIR, PAIR, NONE, NONE, NONE])
    np.testing.assert_array_equal(rows.partner, [4, 5, 3, -1, -1, -1])
    np.testing.assert_array_equal(rows.measured[:3, 0], table.distances[[0, 2, 4]])
    # Both rows of a pair are left out together.
    np.testing.assert_array_equal(rows.blocks, [0, 1, 2, 2, 0, 1])


def test_a_pair_that_lost_its_other_row_is_named(scene, ur3):
    table = scene.pairs(2).select(np.array([True, True, False, True]))
    with pytest.raises(MeasurementError, match="row 4: the pair '00p1' has one row only"):
        rows_of(ur3, table, Cell())


def test_repeats_share_pose_frame_target_and_kind(scene, join, ur3):
    once = scene.points(2)
    q = np.repeat(once.joints, 2, axis=0) + 1e-5

    def at(table, joints):
        return replace(table, joints=joints[: len(table)])

    table = join(
        once,
        at(scene.points(2), q[::2]),  # repeats of both
        at(scene.points(2, 1), q[::2]),  # another frame
        at(scene.points(2, 0, 1), q[::2]),  # another target
        at(scene.distances(2), q[::2]),  # another instrument
    )
    rows, _ = rows_of(ur3, table, Cell())
    assert rows.poses[0] == rows.poses[2]
    assert rows.poses[1] == rows.poses[3]
    assert len(set(rows.poses.tolist())) == 8
    # However it was measured, a pose is left out as a whole.
    np.testing.assert_array_equal(rows.blocks, np.tile([0, 1], 5))


def test_pairs_are_repeats_where_both_poses_are(scene, ur3):
    table = scene.pairs(3)
    q = table.joints.copy()
    q[2] = q[0]  # the second pair shares one pose with the first
    q[4:6] = q[0:2]  # the third repeats it
    rows, _ = rows_of(ur3, replace(table, joints=q), Cell())
    first, second, third = rows.poses[rows.kinds == PAIR]
    assert first == third != second


def test_noise_is_the_rows_the_cells_or_a_first_guess(scene, ur3):
    table = scene.poses(3)
    rows, _ = rows_of(ur3, table, Cell())
    assert set(rows.sigma) == {FIRST_SIGMA}
    assert set(rows.sigma_angle) == {FIRST_SIGMA_ANGLE}
    told = replace(table, sigma=np.array([4e-5, 5e-5, 6e-5]))
    rows, _ = rows_of(ur3, told, Cell(sigma=2e-4, sigma_angle=3e-3))
    np.testing.assert_array_equal(rows.sigma, [4e-5, 5e-5, 6e-5])
    np.testing.assert_array_equal(rows.sigma_angle, [3e-3] * 3)


def test_loads_are_those_of_gravity_and_payload_and_measured_ones_where_there_are(scene, ur3):
    table = scene.points(4)
    payload = Payload(3.0, np.array([0.0, 0.02, 0.1]))
    gravity = np.array([0.0, 9.81, 0.0])
    rows, _ = rows_of(ur3, table, Cell(payload=payload, gravity=gravity))
    by_gravity = gravity_load(ur3, table.joints, payload, gravity)
    np.testing.assert_array_equal(rows.samples.load, by_gravity)
    torques = np.full((4, 6), np.nan)
    torques[:, 1] = [10.0, -20.0, 0.0, 5.0]
    rows, _ = rows_of(ur3, replace(table, torques=torques), Cell(payload=payload, gravity=gravity))
    # The drive holds against the load.
    np.testing.assert_array_equal(rows.samples.load[:, 1], [-10.0, 20.0, 0.0, -5.0])
    np.testing.assert_array_equal(rows.samples.load[:, 2:], by_gravity[:, 2:])


def named(table, names):
    return replace(table, groups=tuple(names))


def test_a_star_stands_for_the_same_text_in_both_groups(scene, ur3):
    groups = ["a/0", "a/1", "b/0", "b/1", "c/1", "?/0", "[x]/0", "[x]/1"]
    table = named(as_kind(scene.points(8), "fixed"), groups)
    cell = Cell(
        distances=(
            GroupDistance("*/0", "*/1", 0.2, 1e-5),
            GroupDistance("a/0", "b/0", 0.5, 2e-5),
        )
    )
    rows, setup = rows_of(ur3, table, cell)
    known = known_distances(cell, setup)
    assert known == (
        KnownDistance(0, 1, 0.2, 1e-5),
        KnownDistance(2, 3, 0.2, 1e-5),
        KnownDistance(6, 7, 0.2, 1e-5),
        KnownDistance(0, 2, 0.5, 2e-5),
    )
    np.testing.assert_array_equal(joined_setups(rows, known), [0, 0, 0, 0, 1, 2, 3, 3])
    np.testing.assert_array_equal(joined_setups(rows, ()), np.arange(8))


def test_a_pattern_that_fits_no_two_groups_is_refused(scene, ur3):
    table = named(as_kind(scene.points(2), "fixed"), ["a/0", "b/1"])
    cell = Cell(distances=(GroupDistance("*/0", "*/1", 0.2, 1e-5),))
    _, setup = rows_of(ur3, table, cell)
    with pytest.raises(ModelError, match=r"'\*/0' and '\*/1', which fits no two of 'a/0', 'b/1'"):
        known_distances(cell, setup)


def test_many_pairs_are_joined_as_one_after_the_other():
    rng = np.random.default_rng(0)
    labels = rng.integers(0, 60, 200)
    pairs = [(int(i), int(j)) for i, j in rng.integers(0, 200, (25, 2))]
    expected = labels.copy()
    for i, j in pairs:
        low, high = sorted((expected[i], expected[j]))
        expected[expected == high] = low
    expected = np.unique(expected, return_inverse=True)[1]
    np.testing.assert_array_equal(_joined(labels, pairs), expected)
