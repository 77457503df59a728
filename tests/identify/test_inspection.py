"""What each kind of measurement can tell of a robot: golden ranks at poses that such measurements can have."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.data import PAPER_TARGET, paper_urdf
from calib.errors import ModelError
from calib.identify.inspection import Inspection, inspect
from calib.identify.registration import register
from calib.identify.table_rows import rows_of
from calib.measure.cell import Cell, GroupDistance
from calib.measure.measurements import Measurements
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics, Samples
from calib.model.robot import Robot
from calib.model.torques import Payload, gravity_load

#: Sockets, and planes n p = d, in the base [m].
SOCKETS = np.array([[0.25, 0.1, 0.2], [0.1, -0.3, 0.15], [-0.2, 0.2, 0.35]])
NORMALS = np.array([[0.3, 0.2, 1.0], [1.0, 0.1, 0.0], [0.0, 1.0, 0.2]])
NORMALS /= np.linalg.norm(NORMALS, axis=1, keepdims=True)
OFFSETS = np.array([0.1, 0.3, 0.2])
ANCHORS = np.array([[0.6, 0.2, 0.1], [-0.5, 0.5, 0.3], [0.1, -0.7, 0.5]])

POSES = 40

TARGET = np.eye(4)
TARGET[:3, 3] = PAPER_TARGET


@pytest.fixture(scope="module")
def arm() -> Robot:
    return Robot.load(paper_urdf(), base="base", tip="tool0")


def where(robot: Robot, q: np.ndarray) -> np.ndarray:
    """The target in the base, shape (N, 3)."""
    points: np.ndarray = (robot.poses(q) @ TARGET)[:, :3, 3]
    return points


def touching(robot: Robot, q: np.ndarray, A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Joint values near q at which A p = b of the target's position p, by Newton's method; those that got there."""
    model = error_model(
        robot, "zeros", target=False
    )  # their columns are the derivative by the joints
    kinematics, x = Kinematics(robot, model, np.eye(4), TARGET), np.zeros(len(model))
    for _ in range(60):
        points, jacobian = kinematics.points_jacobian(x, q)
        step = np.linalg.pinv(A @ jacobian) @ (b - points @ A.T)[:, :, None]
        largest = np.abs(step).max(axis=1)
        q = q + step[:, :, 0] * np.minimum(1.0, 0.3 / np.maximum(largest, 1e-12))
    there = np.abs(b - where(robot, q) @ A.T).max(axis=1) < 1e-13
    assert there.sum() > 0.9 * len(q)
    return q[there]


def random_q(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-np.pi, np.pi, (count, 6))


def table(robot: Robot, kind: str, groups: int = 1) -> Measurements:
    """Measurements of a kind by the perfect robot, with so many sockets, planes or anchors."""
    names: list[str] = []
    if kind in ("fixed", "plane"):
        parts = []
        for g in range(groups):
            A = np.eye(3) if kind == "fixed" else NORMALS[[g]]
            b = SOCKETS[g] if kind == "fixed" else OFFSETS[[g]]
            parts.append(touching(robot, random_q(POSES, g), A, b))
            names += [f"{kind} {g}"] * len(parts[-1])
        q = np.concatenate(parts)
    else:
        q = random_q(2 * POSES if kind == "pair" else POSES * groups)
        names = [f"group {i % groups}" for i in range(len(q))]
    points, count = where(robot, q), len(q)
    distances, pairs = None, ()
    if kind == "distance":
        distances = np.linalg.norm(points - ANCHORS[np.arange(count) % groups], axis=1)
    elif kind == "pair":
        distances = np.repeat(np.linalg.norm(points[::2] - points[1::2], axis=1), 2)
        pairs = tuple(str(i // 2) for i in range(count))
    return Measurements(
        joint_names=robot.joint_names,
        joints=q,
        points=points if kind in ("point", "pose") else np.full((count, 3), np.nan),
        kinds=(kind,) * count,
        groups=tuple(names),
        rotations=robot.poses(q)[:, :3, :3] if kind == "pose" else None,
        distances=distances,
        pairs=pairs,
        source="perfect.csv",
    )


def looked_at(
    robot: Robot, measurements: Measurements | None, model: str, **cell: object
) -> Inspection:
    return inspect(robot, Cell(target=PAPER_TARGET, model=model, **cell), measurements)  # type: ignore[arg-type]


def ranks(
    robot: Robot, measurements: Measurements | None, models: Sequence[str], **cell: object
) -> list[int]:
    found = (looked_at(robot, measurements, model, **cell).observability for model in models)
    return [one.rank for one in found]


SETS = ("dh", "hayati", "placement")


# Golden ranks. 27 of the robot and target can be told from points in a known frame, 6 of which are where the base
# stands; 21 are inside the robot; one of these is its scale.


def test_points_and_poses(arm):
    points, poses = table(arm, "point"), table(arm, "pose")
    assert ranks(arm, points, SETS) == [21, 23, 27]
    assert ranks(arm, points, SETS, estimate_frame=True) == [25, 27, 27]
    assert ranks(arm, poses, SETS) == [24, 26, 30]
    assert ranks(arm, poses, SETS, estimate_frame=True) == [28, 30, 30]


def test_a_partly_known_frame(arm):
    # x, y and rz: d1 and theta1 are told from the frame's z, and of theta1 and rz one is
    rank = ranks(
        arm, table(arm, "point"), SETS, estimate_frame=True, frame_directions=("x", "y", "rz")
    )
    assert rank == [23, 25, 27]


def test_pairs_tell_neither_where_the_base_stands_nor_how_it_is_turned(arm):
    assert ranks(arm, table(arm, "pair"), SETS) == [19, 21, 21]
    texts = [str(c) for c in looked_at(arm, table(arm, "pair"), "dh").observability.unidentifiable]
    assert texts[:2] == ["d1 at all", "theta1 at all"]


@pytest.mark.parametrize("groups", [1, 2, 3])
def test_each_anchor_adds_its_three_coordinates(arm, groups):
    expected = [19 + 3 * groups, 21 + 3 * groups, 21 + 3 * groups]
    assert ranks(arm, table(arm, "distance", groups), SETS) == expected


@pytest.mark.parametrize("groups", [1, 2, 3])
def test_sockets_do_not_tell_the_scale(arm, groups):
    # Nothing is measured but angles: a robot twice as large in a world twice as large does the same.
    measured = table(arm, "fixed", groups)
    expected = [18 + 3 * groups, 20 + 3 * groups, 20 + 3 * groups]
    assert ranks(arm, measured, SETS) == expected


@pytest.mark.parametrize("groups", [1, 2, 3])
def test_planes_do_not_tell_the_scale(arm, groups):
    measured = table(arm, "plane", groups)
    expected = [18 + 3 * groups, 20 + 3 * groups, 20 + 3 * groups]
    assert ranks(arm, measured, SETS) == expected


def test_the_scale_is_what_sockets_do_not_tell(arm):
    # Every length of robot, target and world a thousandth longer, by hand: the ball stays in its sockets.
    measured = table(arm, "fixed", 3)
    groups = tuple(dict.fromkeys(measured.groups))
    model = error_model(arm, "placement", frame=dict.fromkeys(groups, ("x", "y", "z")))
    T_frame_base = np.tile(np.eye(4), (3, 1, 1))
    T_frame_base[:, :3, 3] = -SOCKETS
    x = np.zeros(len(model))
    for joint, T in zip(arm.joints, arm.placements, strict=False):
        x[[model.index(f"{joint.name}.{k}") for k in "xyz"]] = 1e-3 * T[:3, :3].T @ T[:3, 3]
    # the set has no parameters of the tip's placement; the target takes its part
    T_last_target = arm.placements[-1] @ TARGET
    from_last = T_last_target[:3, :3].T @ T_last_target[:3, 3]
    x[[model.index(f"target_{k}") for k in "xyz"]] = 1e-3 * from_last
    for group, socket in zip(groups, SOCKETS, strict=True):
        x[[model.index(f"frame_{k}[{group}]") for k in "xyz"]] = -1e-3 * socket
    frame = np.array([groups.index(group) for group in measured.groups])
    samples = Samples(measured.joints, frame, np.zeros_like(frame))
    kinematics = Kinematics(arm, model, T_frame_base, TARGET)
    assert np.abs(kinematics.points(0 * x, samples)).max() < 1e-12
    assert np.abs(kinematics.points(x, samples)).max() < 1e-12
    # a distance to the same points would have told: by a thousandth of it
    far = samples.frame != 0
    seen_from_first = Samples(samples.q[far], np.zeros(far.sum(), dtype=int), samples.target[far])
    lengths = [np.linalg.norm(kinematics.points(y, seen_from_first), axis=1) for y in (0 * x, x)]
    np.testing.assert_allclose(lengths[1] / lengths[0], 1.001, rtol=1e-12)


def test_a_known_distance_between_two_sockets_tells_the_scale(arm):
    measured = table(arm, "fixed", 3)
    assert ranks(arm, measured, ["placement"]) == [29]
    first, second, third = SOCKETS
    known = GroupDistance("fixed 0", "fixed 1", float(np.linalg.norm(first - second)), 1e-5)
    assert ranks(arm, measured, ["placement"], distances=(known,)) == [30]
    # a second one tells of nothing that the first one and the ball in its sockets did not
    other = GroupDistance("fixed 1", "fixed 2", float(np.linalg.norm(second - third)), 1e-5)
    assert ranks(arm, measured, ["placement"], distances=(known, other)) == [30]


def test_a_wall_is_as_good_as_a_floor(arm):
    # The second plane stands nearly upright: it is still known along its own normal.
    measured = table(arm, "plane", 2)
    model = looked_at(arm, measured, "zeros")
    texts = [str(c) for c in model.observability.unidentifiable]
    assert not any("at all" in text for text in texts)
    assert model.observability.rank == 13


def test_one_plane_square_to_the_first_axis_tells_less(arm):
    q = touching(arm, random_q(POSES), np.array([[0.0, 0.0, 1.0]]), np.array([0.1]))
    level = Measurements(
        joint_names=arm.joint_names,
        joints=q,
        points=np.full((len(q), 3), np.nan),
        kinds=("plane",) * len(q),
    )
    found = looked_at(arm, level, "dh").observability
    assert found.rank == 19
    texts = [str(c) for c in found.unidentifiable]
    assert {"a1 at all", "theta1 at all", "d2 at all", "d3 at all", "d4 at all"} <= set(texts)


@pytest.mark.parametrize(
    ("kind", "groups"),
    [("point", 1), ("pose", 1), ("pair", 1), ("distance", 2), ("fixed", 2), ("plane", 2)],
)
def test_gain_and_eccentricity_add_their_columns_to_every_kind(arm, kind, groups):
    measured = table(arm, kind, groups)
    (alone,) = ranks(arm, measured, ["hayati"])
    assert ranks(arm, measured, ["hayati+gain"]) == [alone + 6]
    assert ranks(arm, measured, ["hayati+eccentricity"]) == [alone + 12]


def test_compliance_shows_where_there_is_a_load(arm):
    measured = table(arm, "pose")
    # gravity does not load the first, upright axis, and the bare wrist's masses lie on its last two axes
    bare = looked_at(arm, measured, "dh+compliance").observability
    assert bare.rank == 24 + 3
    texts = [str(c) for c in bare.unidentifiable]
    for name in ("shoulder_pan_joint", "wrist_2_joint", "wrist_3_joint"):
        assert f"{name}.compliance at all" in texts
    held = Payload(5.0, np.array([0.05, 0.03, 0.1]))
    loaded = looked_at(arm, measured, "dh+compliance", payload=held).observability
    assert loaded.rank == 24 + 5
    assert "shoulder_pan_joint.compliance at all" in [str(c) for c in loaded.unidentifiable]
    # hung on a wall every axis carries load
    wall = (9.81, 0.0, 0.0)
    assert ranks(arm, measured, ["dh+compliance"], payload=held, gravity=wall) == [24 + 6]


def test_measured_torques_are_what_holds_the_load(arm):
    # A table with the drives' torques at rest says of the load what gravity would; where it has none, gravity does.
    measured = table(arm, "point")
    held = Payload(5.0, np.array([0.05, 0.03, 0.1]))
    load = gravity_load(arm, measured.joints, held)
    torques = np.full_like(load, np.nan)
    torques[:, 1] = -load[:, 1]
    torques[:, 0] = 7.0  # something that no gravity explains
    driven = replace(measured, torques=torques)
    rows, _ = rows_of(arm, driven, Cell(target=PAPER_TARGET, payload=held))
    assert rows.samples.load is not None
    np.testing.assert_array_equal(rows.samples.load[:, 1:], load[:, 1:])
    np.testing.assert_array_equal(rows.samples.load[:, 0], -7.0)
    # a torque on the upright axis shows its compliance, one and the same torque as its zero
    texts = [
        str(c) for c in looked_at(arm, driven, "zeros+compliance").observability.unidentifiable
    ]
    assert not any(text.startswith("shoulder_pan_joint.compliance at all") for text in texts)
    expected = (
        "shoulder_pan_joint.zero and shoulder_pan_joint.compliance together (+1 mrad, +143 urad/Nm)"
    )
    assert expected in texts


def test_two_targets_have_their_own_unknowns(arm):
    q = random_q(POSES)
    target = np.array([0.05, -0.04, 0.1])
    other = (arm.poses(q) @ [*target, 1.0])[:, :3]
    both = Measurements(
        joint_names=arm.joint_names,
        joints=np.concatenate([q, q]),
        points=np.concatenate([where(arm, q), other]),
        targets=("one",) * POSES + ("two",) * POSES,
    )
    # Two points behind the last axis tell all of the last placement but a turn about the line through them.
    cell = {"targets": {"two": target}}
    assert ranks(arm, both, SETS, **cell) == [24, 26, 30]


# Without a table, and what does not depend on chance


def test_poses_over_the_joint_limits(arm):
    spread = looked_at(arm, None, "dh")
    assert spread.poses == "200 poses spread over the joint limits"
    assert spread.observability.rank == 21
    assert ranks(arm, None, ["dh"], kind="pose") == [24]
    far = looked_at(arm, None, "dh", kind="distance")
    assert far.poses.endswith("limits, anchor 700, -500, 300 mm from the base")
    assert far.observability.rank == 22
    generic = inspect(arm, Cell(model="dh"))
    assert generic.poses.endswith("target 50, 70, 30 mm off the tip")
    assert generic.observability.rank == 21


@pytest.mark.parametrize(
    ("kind", "why"),
    [
        ("pair", "which rows are a pair is for a table to say"),
        ("fixed", "the joints turn about a target that stays in its socket"),
        ("plane", "the joints move a target that stays in its plane"),
    ],
)
def test_kinds_that_need_a_table(arm, kind, why):
    # At any other poses sockets and planes would seem to tell the scale.
    with pytest.raises(
        ModelError, match=rf"limits say nothing of kind '{kind}': {why}\. Give a table of such rows"
    ):
        inspect(arm, Cell(kind=kind))


def test_auto_is_looked_at_as_dh(arm):
    measured = table(arm, "point")
    assert (
        looked_at(arm, measured, "auto").model.names == looked_at(arm, measured, "dh").model.names
    )


@pytest.mark.parametrize(
    ("kind", "groups"),
    [("point", 1), ("pose", 1), ("pair", 1), ("distance", 3), ("fixed", 3), ("plane", 3)],
)
def test_the_result_is_the_same_twice_and_in_another_order_of_rows(arm, kind, groups):
    measured = table(arm, kind, groups)
    model = "placement+gain+eccentricity+compliance"
    once, twice = (looked_at(arm, measured, model).observability for _ in range(2))
    np.testing.assert_array_equal(once.singular_values, twice.singular_values)
    assert once.unidentifiable == twice.unidentifiable
    assert once.indices == twice.indices
    order = np.random.default_rng(1).permutation(len(measured))
    # the first row of each group stays in front of the others', for groups are numbered as they come
    order = order[np.argsort([measured.groups[i] for i in order], kind="stable")]
    mixed = looked_at(arm, permuted(measured, order), model).observability
    assert mixed.rank == once.rank
    assert mixed.condition == pytest.approx(once.condition, rel=1e-8)
    assert [str(c) for c in mixed.unidentifiable] == [str(c) for c in once.unidentifiable]
    np.testing.assert_array_equal(mixed.identifiable, once.identifiable)


def permuted(m: Measurements, order: np.ndarray) -> Measurements:
    return Measurements(
        joint_names=m.joint_names,
        joints=m.joints[order],
        points=m.points[order],
        kinds=tuple(m.kinds[i] for i in order),
        groups=tuple(m.groups[i] for i in order),
        rotations=None if m.rotations is None else m.rotations[order],
        distances=None if m.distances is None else m.distances[order],
        pairs=tuple(m.pairs[i] for i in order),
        source=m.source,
    )


def test_the_frame_of_a_plane_does_not_depend_on_the_order_of_rows(arm):
    measured = table(arm, "plane", 3)
    order = np.concatenate(
        [
            np.flatnonzero([g == name for g in measured.groups])[::-1]
            for name in dict.fromkeys(measured.groups)
        ]
    )
    frames = []
    for one in (measured, permuted(measured, order)):
        rows, setup = rows_of(arm, one, Cell(target=PAPER_TARGET))
        frames.append(register(arm, setup, rows).T_frame_base)
    np.testing.assert_allclose(frames[1], frames[0], rtol=0, atol=1e-9)
    # the plane itself, its z to the side of its normal's largest component, and turned no more than that
    for T, normal, offset in zip(frames[0], NORMALS, OFFSETS, strict=True):
        np.testing.assert_allclose(T[2], [*normal, -offset], rtol=0, atol=1e-9)
        turn = np.arccos((np.trace(T[:3, :3]) - 1) / 2)
        assert turn == pytest.approx(np.arccos(normal[2]), abs=1e-6)


# The document


def test_the_document_states_these_ranks(arm):
    text = (Path(__file__).parents[2] / "docs" / "parameters.md").read_text(encoding="utf-8")
    rows = re.findall(
        r"^\| `(\w+)` \| (\d) [a-z]+ \| (\d+) of (\d+) \| (\d+) of (\d+) \| (\d+) of (\d+) \|$",
        text,
        re.MULTILINE,
    )
    assert [row[0] for row in rows] == ["distance"] * 2 + ["pair"] + ["fixed"] * 2 + ["plane"] * 2
    for kind, groups, *numbers in rows:
        measured = table(arm, kind, int(groups) if kind != "pair" else 1)
        for k, name in enumerate(SETS):
            found = looked_at(arm, measured, name).observability
            assert [found.rank, found.columns] == [int(n) for n in numbers[2 * k : 2 * k + 2]]
