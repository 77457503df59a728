"""Rows of a table of every kind: measured values, pairs, noise; and the frames and targets that a cell states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.basics.channels import RESIDUAL_UNITS
from calib.data.cell import Cell
from calib.data.cell_chains import robot_of_cell
from calib.data.measurements import Measurements
from calib.errors import MeasurementError
from calib.fit.registration.rows import NONE
from calib.fit.registration.table_rows import rows_and_setup
from calib.robot.gravity import Payload, gravity_loads
from calib.robot.robot import Robot
from calib.robot.urdf import read_urdf
from tests.fit.registration.tables import as_kind
from tests.pictures import STATED
from tests.two_handed import CELL, NAMES, two_handed

ALL = ("x", "y", "z", "rx", "ry", "rz")

UR3 = Robot.load("ur3", base="base", tip="tool0")


def setup_of(table, cell):
    return rows_and_setup(UR3, table, cell)[1]


@pytest.mark.parametrize(
    ("kind", "unknown"),
    [
        ("distance", ("x", "y", "z")),
        ("fixed", ("x", "y", "z")),
        ("plane", ("z", "rx", "ry")),
        ("face", ("z", "rx", "ry")),
        ("clasp", ALL),
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
    assert setup.own_axes.tolist() == [kind in ("plane", "face")]


def faces(scene, join, pairs):
    """Rows of hands flat on planes, by the names of both."""
    tables = []
    for plane, hand in pairs:
        table = as_kind(scene.points(4), "face")
        tables.append(replace(table, groups=(plane,) * 4, targets=(hand,) * 4))
    return join(*tables)


def test_the_height_of_one_face_is_that_of_the_planes_it_is_joined_to(scene, join):
    seen = [("table", "a"), ("table", "b"), ("wall", "c"), ("wall", "a"), ("door", "d")]
    setup = setup_of(faces(scene, join, seen), Cell())
    with_height, tilts = ("z", "rx", "ry"), ("rx", "ry")
    assert setup.target_unknowns == {"a": tilts, "b": with_height, "c": with_height, "d": tilts}
    # A known plane gives all hands on it a height.
    known = setup_of(faces(scene, join, seen), Cell(frames={"wall": np.eye(4)}))
    assert known.target_unknowns["a"] == with_height
    assert known.target_unknowns["d"] == tilts
    assert known.count == 3 + 0 + 3 + 3 * 3 + 2


def test_a_clasped_target_is_part_of_its_frame_unless_other_rows_see_it(scene, join):
    clasped = as_kind(scene.points(4), "clasp")
    alone = setup_of(clasped, Cell())
    assert (alone.count, alone.estimate_target, alone.target_given.tolist()) == (6, False, [True])
    seen = replace(scene.points(4), groups=("tracker",) * 4)
    both = setup_of(join(replace(clasped, groups=("grip",) * 4), seen), Cell())
    assert both.target_unknowns == {"": ("x", "y", "z")}
    assert both.target_prior.tolist() == [False]


def test_each_group_has_the_unknowns_of_its_kinds(scene, join):
    table = join(scene.points(4, 0), as_kind(scene.points(4, 1), "plane"), scene.distances(4, 2))
    setup = setup_of(table, Cell(estimate_frame=True, frame_directions=("x", "rz")))
    assert setup.groups == ("0", "1", "2")
    assert setup.frame_unknowns == {"0": ("x", "rz"), "1": ("z", "rx", "ry"), "2": ("x", "y", "z")}
    assert setup.count == 3 + 2 + 3 + 3


def test_targets_are_oriented_where_that_is_given_or_measured(scene):
    given = Cell(target=np.zeros(3), target_rotation=np.eye(3))
    assert not setup_of(scene.points(4), Cell()).oriented
    assert setup_of(scene.points(4), given).oriented
    assert setup_of(scene.poses(4), Cell()).oriented


def test_every_kind_has_its_number_and_nothing_is_nan(four_frames, join, ur3):
    table = join(
        four_frames.points(2),
        four_frames.poses(2, 1, 1),
        four_frames.distances(2, 2),
        four_frames.pairs(1, 0, 1),
        as_kind(four_frames.points(1, 3), "fixed"),
        as_kind(four_frames.points(1, 1), "plane"),
    )
    rows, setup = rows_and_setup(ur3, table, Cell())
    names = [kind.name for kind in rows.kinds]
    assert names == ["point", "pose", "distance", "pair", "fixed", "plane"]
    np.testing.assert_array_equal(rows.kind, [0, 0, 1, 1, 2, 2, 3, NONE, 4, 5])
    for values in (rows.measured, rows.scales):
        assert np.all(np.isfinite(values))
    np.testing.assert_array_equal(rows.measured[:4, :3], table.points[:4])
    np.testing.assert_array_equal(rows.measured[2:4, 3:], table.rotations[2:4].reshape(2, 9))
    np.testing.assert_array_equal(rows.measured[4:7, 0], table.distances[4:7])
    np.testing.assert_array_equal(rows.measured[7:], 0.0)
    np.testing.assert_array_equal(rows.samples.frame, [0, 0, 1, 1, 2, 2, 0, 0, 3, 1])
    np.testing.assert_array_equal(rows.samples.target, [0, 0, 1, 1, 0, 0, 1, 1, 0, 0])
    assert setup.rotation


def test_the_first_row_of_a_pair_carries_the_distance(four_frames, ur3):
    table = four_frames.pairs(3)
    order = np.array([0, 2, 5, 4, 1, 3])
    mixed = Measurements(
        table.joint_names,
        table.joints[order],
        table.points[order],
        kinds=("pair",) * 6,
        pairs=tuple(table.pairs[k] for k in order),
        distances=table.distances[order],
    )
    rows, _ = rows_and_setup(ur3, mixed, Cell())
    assert [kind.name for kind in rows.kinds] == ["pair"]
    np.testing.assert_array_equal(rows.kind, [0, 0, 0, NONE, NONE, NONE])
    np.testing.assert_array_equal(rows.partner, [4, 5, 3, -1, -1, -1])
    np.testing.assert_array_equal(rows.measured[:3, 0], table.distances[[0, 2, 4]])
    # Both rows of a pair are left out together.
    np.testing.assert_array_equal(rows.blocks, [0, 1, 2, 2, 0, 1])


def test_noise_is_the_rows_the_cells_or_a_first_guess(four_frames, ur3):
    table = four_frames.poses(3)
    rows, _ = rows_and_setup(ur3, table, Cell())
    for symbol, unit in RESIDUAL_UNITS.items():
        assert set(rows.sigma[symbol]) == {unit.assumed_sigma}
    told = replace(table, sigma={"m": np.array([4e-5, 5e-5, 6e-5])})
    rows, _ = rows_and_setup(ur3, told, Cell(sigma={"m": 2e-4, "rad": 3e-3}))
    np.testing.assert_array_equal(rows.sigma["m"], [4e-5, 5e-5, 6e-5])
    np.testing.assert_array_equal(rows.sigma["rad"], [3e-3] * 3)


def test_repeats_are_of_one_pose_target_frame_and_kind(ur3):
    """Of six rows at one pose the first three are repeats; another kind, target or frame makes another number."""
    q = np.zeros((7, 6))
    q[6] = 0.5
    table = Measurements(
        ur3.joint_names,
        q,
        np.zeros((7, 3)),
        kinds=("point",) * 3 + ("fixed",) + ("point",) * 3,
        targets=("a", "a", "a", "a", "b", "a", "a"),
        groups=("s",) * 5 + ("t", "s"),
    )
    rows, _ = rows_and_setup(ur3, table, Cell())
    assert rows.poses[0] == rows.poses[1] == rows.poses[2]
    assert len(set(rows.poses[2:])) == 5
    np.testing.assert_array_equal(rows.blocks, [0] * 6 + [1])


def test_repeats_of_a_corner_are_no_repeats_of_another_one():
    """Corner 0, corner 1 and corner 0 again at one pose, and corner 0 at another."""
    board_points = np.array([[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    q = np.array([0.0, 0.0, 0.0, 0.5])[:, None] * np.ones(6)
    table = Measurements(
        UR3.joint_names,
        q,
        np.full((4, 3), np.nan),
        kinds=("pixel",) * 4,
        board_points=board_points,
        corners=("0", "1", "0", "0"),
        readings={"u": np.array([600.0, 650.0, 600.0, 500.0]), "v": np.full(4, 300.0)},
    )
    rows, _ = rows_and_setup(UR3, table, Cell(cameras={"": STATED}))
    assert rows.poses[0] == rows.poses[2]
    assert len(set(rows.poses)) == 3
    np.testing.assert_array_equal(rows.blocks, [0, 0, 0, 1])


def test_two_targets_at_one_pose_are_no_repeats(ur3):
    """Of rows of which no other two are of one pose."""
    q = np.array([0.0, 0.0, 0.5])[:, None] * np.ones(6)
    table = Measurements(ur3.joint_names, q, np.zeros((3, 3)), targets=("a", "b", "a"))
    rows, _ = rows_and_setup(ur3, table, Cell())
    assert len(set(rows.poses)) == 3
    np.testing.assert_array_equal(rows.blocks, [0, 0, 1])
    rows, _ = rows_and_setup(ur3, table.select(np.arange(3) < 2), Cell())  # without another pose
    assert len(set(rows.poses)) == 2


def test_repeats_of_a_pair_repeat_both_its_rows(ur3):
    """Poses 0 to 1, again 0 to 1, and 0 to 2."""
    q = np.array([0.0, 0.5, 0.0, 0.5, 0.0, 1.0])[:, None] * np.ones(6)
    table = Measurements(
        ur3.joint_names,
        q,
        np.full((6, 3), np.nan),
        kinds=("pair",) * 6,
        pairs=("a", "a", "b", "b", "c", "c"),
        distances=np.full(6, 0.2),
    )
    rows, _ = rows_and_setup(ur3, table, Cell())
    first_rows = rows.poses[::2]
    assert first_rows[0] == first_rows[1] != first_rows[2]
    np.testing.assert_array_equal(rows.blocks, [0] * 6)


def test_loads_are_those_of_gravity_and_payload_and_measured_ones_where_there_are(four_frames, ur3):
    table = four_frames.points(4)
    payload = Payload(3.0, np.array([0.0, 0.02, 0.1]))
    gravity = np.array([0.0, 9.81, 0.0])
    rows, _ = rows_and_setup(ur3, table, Cell(payload=payload, gravity=gravity))
    by_gravity = gravity_loads(ur3, table.joints, payload, gravity)
    np.testing.assert_array_equal(rows.samples.load, by_gravity)
    torques = np.full((4, 6), np.nan)
    torques[:, 1] = [10.0, -20.0, 0.0, 5.0]
    rows, _ = rows_and_setup(
        ur3, replace(table, torques=torques), Cell(payload=payload, gravity=gravity)
    )
    # The drive holds against the load.
    np.testing.assert_array_equal(rows.samples.load[:, 1, 0], [-10.0, 20.0, 0.0, -5.0])
    np.testing.assert_array_equal(rows.samples.load[:, 2:], by_gravity[:, 2:])


def test_a_row_needs_the_joints_of_its_own_chain():
    table = two_handed(1, stops=3).measurements
    robot = robot_of_cell(read_urdf("panda"), CELL)
    rows, _ = rows_and_setup(robot, table, CELL)
    assert rows.samples.chain is not None
    np.testing.assert_array_equal(rows.samples.chain, [0, 1] * 3)
    without = table.without_joint.copy()
    without[3, NAMES.index("right/panda_joint2")] = True
    with pytest.raises(MeasurementError, match="right/panda_joint2"):
        rows_and_setup(robot, replace(table, without_joint=without), CELL)
