"""What a cell and a table say of frames and targets, and in which directions they are unknown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.errors import ModelError
from calib.identify.setup import along_own_axes, rows_of
from calib.measure.cell import Cell, GroupDistance
from calib.model.error_model import frame_and_target_model
from calib.model.kinematics import Kinematics
from calib.model.parameters import ErrorModel
from calib.model.robot import Robot

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


def test_measurements_in_the_base_leave_the_target_alone_unknown(scene):
    setup = setup_of(scene.points(5), Cell())
    assert setup.unknown == ((),)
    assert setup.frame_unknowns == {"": ()}
    assert setup.target_names == setup.unknown_targets == ("",)
    assert setup.estimate_target
    assert setup.count == 3
    assert setup.frame_given.tolist() == [True]
    assert setup.target_given.tolist() == [False]
    assert setup_of(scene.points(5), Cell(estimate_frame=True)).count == 9
    assert setup_of(scene.poses(5), Cell(estimate_frame=True)).count == 12


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


def test_a_socket_is_unknown_beside_pairs_in_its_group(scene, join):
    """Pairs say nothing of a frame, so they do not make a group one that is measured in."""
    setup = setup_of(join(as_kind(scene.points(6), "fixed"), scene.pairs(3)), Cell())
    assert setup.unknown == (("x", "y", "z"),)


def test_each_group_has_the_unknowns_of_its_kinds(scene, join):
    table = join(scene.points(4, 0), as_kind(scene.points(4, 1), "plane"), scene.distances(4, 2))
    setup = setup_of(table, Cell(estimate_frame=True, frame_directions=("x", "rz")))
    assert setup.groups == ("0", "1", "2")
    assert setup.frame_unknowns == {
        "0": ("x", "rz"),
        "1": ("z", "rx", "ry"),
        "2": ("x", "y", "z"),
    }
    assert setup.count == 3 + 2 + 3 + 3


def test_what_is_given_by_name_wins(scene, join):
    table = join(scene.points(3, 0, 0), scene.points(3, 1, 1))
    T, other = np.eye(4), np.eye(4)
    T[0, 3], other[1, 3] = 1.0, 2.0
    cell = Cell(T_frame_base=T, frames={"1": other}, target=np.ones(3), targets={"t0": np.zeros(3)})
    setup = setup_of(table, cell)
    np.testing.assert_array_equal(setup.T_frame_base, [T, other])
    np.testing.assert_array_equal(setup.T_tip_target[:, :3, 3], [np.zeros(3), np.ones(3)])
    assert setup.target_given.all()
    assert setup.target_names == setup.unknown_targets == ("t0", "t1")


def test_a_socket_whose_frame_is_given_is_known(scene):
    table = as_kind(scene.points(4), "fixed")
    setup = setup_of(table, Cell(frames={"0": np.eye(4)}))
    assert setup.unknown == ((),)
    assert setup.frame_given.tolist() == [True]


def test_known_frames_and_targets_lose_their_unknowns(scene, join):
    table = join(scene.points(3, 0, 0), scene.points(3, 1, 1))
    setup = setup_of(table, Cell(estimate_frame=True))
    known = setup.as_known(np.array([True, False]), np.array([False, True]))
    assert known.unknown == ((), ALL)
    assert known.unknown_targets == ("t0",)
    assert known.count == 9


@pytest.mark.parametrize(
    ("cell", "message"),
    [
        (Cell(frames={"9": np.eye(4)}), "frames for '9'; the table's column 'group' has '0'"),
        (Cell(targets={"ball": np.zeros(3)}), "targets for 'ball'.*column 'target' has 't0'"),
        (
            Cell(distances=(GroupDistance("0", "left", 1.0, 1e-5),)),
            "distances between 'left'; the table's column 'group' has '0'",
        ),
    ],
)
def test_names_that_the_table_lacks_are_refused(scene, cell, message):
    with pytest.raises(ModelError, match=message):
        setup_of(scene.points(3), cell)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_planes_directions_move_it_wherever_it_faces(scene, axis):
    """Height and two tilts, of one metre and one radian a unit: no direction of a wall is lost."""
    quarter = {"x": ("y", -90), "y": ("x", 90), "z": ("z", 0)}[axis]
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler(*quarter, degrees=True).as_matrix()
    setup = setup_of(as_kind(scene.points(4), "plane"), Cell())
    setup = setup.placed(T[None], setup.T_tip_target)
    plain = frame_and_target_model(
        setup.frame_unknowns, (), known_targets=setup.target_names, rotation=False
    )
    model = along_own_axes(plain, setup)
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


def test_other_frames_keep_the_bases_axes(scene):
    setup = setup_of(scene.points(4), Cell(estimate_frame=True))
    model = frame_and_target_model(setup.frame_unknowns, ("",))
    assert along_own_axes(model, setup) is model
