"""Frames and targets that a cell states for a table, and the directions in which they are estimated."""

from __future__ import annotations

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.fit.registration.table_rows import rows_and_setup
from calib.robot.robot import Robot
from tests.fit.registration.tables import as_kind

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


def test_targets_are_oriented_where_that_is_given_or_measured(scene):
    given = Cell(target=np.zeros(3), target_rotation=np.eye(3))
    assert not setup_of(scene.points(4), Cell()).oriented
    assert setup_of(scene.points(4), given).oriented
    assert setup_of(scene.poses(4), Cell()).oriented
