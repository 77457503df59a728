"""What a cell and a table say of frames and targets, and in which directions they are unknown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell, GroupDistance
from calib.data.measurements import Measurements
from calib.model.error_model import frame_and_target_model
from calib.model.kinematics import Kinematics
from calib.model.parameters import ErrorModel
from calib.registration.known_distances import KnownDistance, joined_setups, known_distances
from calib.registration.rows import NONE
from calib.registration.table_rows import FIRST_SIGMA, FIRST_SIGMA_ANGLE, rows_of
from calib.robot.gravity import gravity_loads
from calib.robot.payload import Payload
from calib.robot.robot import Robot

ALL = ("x", "y", "z", "rx", "ry", "rz")
UR3 = Robot.load("ur3", base="base", tip="tool0")


def setup_of(table, cell):
    return rows_of(UR3, table, cell)[1]


@pytest.fixture(scope="module")
def scene(make_scene):
    return make_scene(0, frames=3, targets=2, reach=1.0)


def as_kind(table, kind, **columns):
    """The same rows as another kind: where they lie does not matter here."""
    return replace(table, kinds=(kind,) * len(table), **columns)


@pytest.mark.parametrize(
    ("kind", "unknown"),
    [
        ("distance", ("x", "y", "z")),
        ("fixed", ("x", "y", "z")),
        ("plane", ("z", "rx", "ry")),
        ("pair", ()),
        ("point", ()),
    ],
)
@pytest.mark.parametrize("estimate_frame", [False, True])
def test_sockets_planes_and_anchors_are_unknown_whatever_is_said_of_the_frame(
    scene, kind, unknown, estimate_frame
):
    columns = {}
    if kind in ("distance", "pair"):
        columns["distances"] = np.ones(4)
    if kind == "pair":
        columns["pairs"] = ("a", "a", "b", "b")
    setup = setup_of(as_kind(scene.points(4), kind, **columns), Cell(estimate_frame=estimate_frame))
    if kind == "point" and estimate_frame:
        unknown = ALL
    assert setup.unknown == (unknown,)
    assert setup.own_axes.tolist() == [kind == "plane"]


def test_each_group_has_the_unknowns_of_its_kinds(scene, join):
    table = join(scene.points(4, 0), as_kind(scene.points(4, 1), "plane"), scene.distances(4, 2))
    setup = setup_of(table, Cell(estimate_frame=True, frame_directions=("x", "rz")))
    assert setup.groups == ("0", "1", "2")
    assert setup.frame_unknowns == {"0": ("x", "rz"), "1": ("z", "rx", "ry"), "2": ("x", "y", "z")}
    assert setup.count == 3 + 2 + 3 + 3


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_planes_directions_move_it_wherever_it_faces(scene, axis):
    """Height and two tilts, of one metre and one radian a unit: no direction of a wall is lost."""
    quarter = {"x": ("y", -90), "y": ("x", 90), "z": ("z", 0)}[axis]
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler(*quarter, degrees=True).as_matrix()
    setup = setup_of(as_kind(scene.points(4), "plane"), Cell())
    setup = setup.placed(T[None], setup.T_tip_target)
    plain = frame_and_target_model(setup.frame_unknowns, (), setup.target_names, rotation=False)
    model = setup.aligned(plain)
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


#: Numbers of kinds in the registry.
DISTANCE, FIXED, PAIR, PLANE, POINT, POSE = 2, 4, 3, 5, 0, 1


@pytest.fixture(scope="module")
def seen(make_scene):
    return make_scene(1, frames=4, targets=2, reach=1.0)


def kind_of(table, kind):
    return replace(table, kinds=(kind,) * len(table))


def test_every_kind_has_its_number_and_nothing_is_nan(seen, join, ur3):
    table = join(
        seen.points(2),
        seen.poses(2, 1, 1),
        seen.distances(2, 2),
        seen.pairs(1, 0, 1),
        kind_of(seen.points(1, 3), "fixed"),
        kind_of(seen.points(1, 1), "plane"),
    )
    rows, setup = rows_of(ur3, table, Cell())
    np.testing.assert_array_equal(
        rows.kinds, [POINT, POINT, POSE, POSE, DISTANCE, DISTANCE, PAIR, NONE, FIXED, PLANE]
    )
    for values in (rows.measured, rows.scales):
        assert np.all(np.isfinite(values))
    np.testing.assert_array_equal(rows.measured[:4, :3], table.points[:4])
    np.testing.assert_array_equal(rows.measured[2:4, 3:], table.rotations[2:4].reshape(2, 9))
    np.testing.assert_array_equal(rows.measured[4:7, 0], table.distances[4:7])
    np.testing.assert_array_equal(rows.measured[7:], 0.0)
    np.testing.assert_array_equal(rows.samples.frame, [0, 0, 1, 1, 2, 2, 0, 0, 3, 1])
    np.testing.assert_array_equal(rows.samples.target, [0, 0, 1, 1, 0, 0, 1, 1, 0, 0])
    assert setup.rotation


def test_the_first_row_of_a_pair_carries_the_distance(seen, ur3):
    table = seen.pairs(3)
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


def test_noise_is_the_rows_the_cells_or_a_first_guess(seen, ur3):
    table = seen.poses(3)
    rows, _ = rows_of(ur3, table, Cell())
    assert set(rows.sigma) == {FIRST_SIGMA}
    assert set(rows.sigma_angle) == {FIRST_SIGMA_ANGLE}
    told = replace(table, sigma=np.array([4e-5, 5e-5, 6e-5]))
    rows, _ = rows_of(ur3, told, Cell(sigma=2e-4, sigma_angle=3e-3))
    np.testing.assert_array_equal(rows.sigma, [4e-5, 5e-5, 6e-5])
    np.testing.assert_array_equal(rows.sigma_angle, [3e-3] * 3)


def test_loads_are_those_of_gravity_and_payload_and_measured_ones_where_there_are(seen, ur3):
    table = seen.points(4)
    payload = Payload(3.0, np.array([0.0, 0.02, 0.1]))
    gravity = np.array([0.0, 9.81, 0.0])
    rows, _ = rows_of(ur3, table, Cell(payload=payload, gravity=gravity))
    by_gravity = gravity_loads(ur3, table.joints, payload, gravity)
    np.testing.assert_array_equal(rows.samples.load, by_gravity)
    torques = np.full((4, 6), np.nan)
    torques[:, 1] = [10.0, -20.0, 0.0, 5.0]
    rows, _ = rows_of(ur3, replace(table, torques=torques), Cell(payload=payload, gravity=gravity))
    # The drive holds against the load.
    np.testing.assert_array_equal(rows.samples.load[:, 1, 0], [-10.0, 20.0, 0.0, -5.0])
    np.testing.assert_array_equal(rows.samples.load[:, 2:], by_gravity[:, 2:])


def named(table, names):
    return replace(table, groups=tuple(names))


def test_a_star_stands_for_the_same_text_in_both_groups(seen, ur3):
    groups = ["a/0", "a/1", "b/0", "b/1", "c/1", "?/0", "[x]/0", "[x]/1"]
    table = named(kind_of(seen.points(8), "fixed"), groups)
    cell = Cell(
        distances=(GroupDistance("*/0", "*/1", 0.2, 1e-5), GroupDistance("a/0", "b/0", 0.5, 2e-5))
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
