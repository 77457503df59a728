"""Collisions: spheres whose distances are known, and a UR3 against FCL and forward kinematics that share no code."""

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from scipy.spatial.transform import Rotation

from calib import example
from calib.data.cell import Box
from calib.robot.ranges import spread_poses
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.verbs.plan.collision import CollisionCheck, CollisionModel, _choose_margin, _is_always
from tests.verbs.plan.fcl_scene import bodies, objects, touch

#: Three turning joints in a plane, each 0.3 m behind the other, and a ball of 50 mm in front of each.
LINK = """<link name="{name}"><{kind}><origin xyz="{x} 0 0"/><geometry><sphere radius="0.05"/></geometry></{kind}>
  </link>"""
JOINT = """<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/><origin xyz="{x} 0 0"/>
  <axis xyz="0 0 1"/><limit lower="-3.1" upper="3.1" effort="1" velocity="1"/></joint>"""
NAMES = ("base", "upper", "fore", "hand")
X = (0.0, 0.3, 0.3, 0.2)


def balls(kind: str = "collision", more: str = "") -> str:
    links = [LINK.format(name=n, x=x, kind=kind) for n, x in zip(NAMES, X, strict=True)]
    joints = [
        JOINT.format(name=f"j{i}", parent=NAMES[i - 1], child=NAMES[i], x=0.3 * (i > 1))
        for i in (1, 2, 3)
    ]
    return f'<robot name="balls">{"".join(links + joints)}{more}</robot>'


def robot_of(text: str, base: str = "base", tip: str = "hand") -> Robot:
    return Robot.from_urdf(Urdf.from_bytes(text.encode(), "balls.urdf"), base, tip)


def model_of(robot: Robot, boxes=(), targets=None, **check) -> CollisionModel:
    """Without the mounting plane unless it is asked for."""
    return CollisionModel.of(robot, boxes, targets, CollisionCheck(**{"floor": False} | check))


def centres(q) -> np.ndarray:
    """Of the four balls, in the plane."""
    points, place, angle = [(0.0, 0.0)], np.zeros(2), 0.0
    for value, length, x in zip(q, (0.0, 0.3, 0.3), (0.3, 0.3, 0.2), strict=True):
        place = place + length * np.array([math.cos(angle), math.sin(angle)])
        angle += value
        points.append(place + x * np.array([math.cos(angle), math.sin(angle)]))
    return np.array(points)


def gaps(q) -> dict[tuple[str, str], float]:
    """Between the surfaces of the balls that no joint joins."""
    points = centres(q)
    return {
        (NAMES[i], NAMES[j]): float(np.linalg.norm(points[i] - points[j])) - 0.1
        for i, j in ((0, 2), (0, 3), (1, 3))
    }


@cache
def ball_model(clearance: float = 0.0) -> CollisionModel:
    return model_of(robot_of(balls()), clearance=clearance)


ANGLES = st.tuples(*[st.floats(-3.1, 3.1)] * 3)


@given(q=ANGLES, clearance=st.sampled_from([0.0, 0.03]))
@settings(deadline=None)
def test_balls_touch_where_their_distance_says_so(q, clearance):
    model, gap = ball_model(clearance), gaps(q)
    assert set(model.pairs) == set(gap)
    least = min(gap.values())
    assume(abs(least - clearance) > 1e-6)
    assert model.free(q).tolist() == [least > clearance]


def test_links_always_within_the_clearance_are_refused_where_they_touch():
    model = model_of(robot_of(balls()), clearance=0.7)
    close = dict(model.notes)["always_close"]
    assert {"upper and hand"} <= set(close) <= {"base and fore", "base and hand", "upper and hand"}
    # The balls of upper and hand are 0.4 m apart at most: only where they touch does that pair refuse.
    loose = model_of(robot_of(balls()), clearance=0.42)
    assert dict(loose.notes)["always_close"] == ("upper and hand",)
    q = spread_poses(loose.robot, 200)
    limits = {("base", "fore"): 0.42, ("base", "hand"): 0.42, ("upper", "hand"): 0.0}
    expected = [all(gap > limits[pair] for pair, gap in gaps(row).items()) for row in q]
    assert 10 < sum(expected) < 190
    assert loose.free(q).tolist() == expected


def test_visual_geometry_stands_in_and_bodies_without_any_are_named():
    more = """<link name="ghost"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
      </inertial></link><link name="frame"/><link name="odd"><collision><geometry><cone/></geometry></collision></link>
      <joint name="g" type="fixed"><parent link="hand"/><child link="ghost"/></joint>
      <joint name="h" type="fixed"><parent link="hand"/><child link="frame"/></joint>
      <joint name="i" type="fixed"><parent link="hand"/><child link="odd"/></joint>"""
    model = model_of(robot_of(balls("visual", more)))
    assert model.notes[1:] == (("no_geometry", ("ghost", "odd")),)
    q = spread_poses(model.robot, 200)
    np.testing.assert_array_equal(model.free(q), ball_model().free(q))


def at(x: float, y: float, z: float) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


@given(q=ANGLES)
@settings(deadline=None)
def test_a_box_is_touched_where_its_distance_says_so(q):
    model = box_model()
    outside = np.maximum(np.abs(centres(q)[1:] - [0.5, 0.2]) - [0.05, 0.1], 0.0)
    least = min([*gaps(q).values(), *(np.linalg.norm(outside, axis=1) - 0.05)])
    assume(abs(least) > 1e-6)
    assert model.free(q).tolist() == [least > 0.0]


@cache
def box_model() -> CollisionModel:
    return model_of(robot_of(balls()), [Box("post", (0.1, 0.2, 1.0), at(0.5, 0.2, 0.0))])


ROD = """<robot name="rod"><link name="base"/>
  <link name="arm"><collision><origin xyz="2 0 0" rpy="0 {turn} 0"/><geometry><{shape} radius="0.005" length="2"/>
    </geometry></collision></link>
  <joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="-3.1" upper="3.1" effort="1" velocity="1"/></joint></robot>"""


@pytest.mark.parametrize("shape", ["cylinder", "capsule"])
def test_a_rod_through_the_middle_of_a_box(shape):
    # Of these coal misses some where it is not asked for contacts: the rod's axis goes through the box's centre.
    robot = robot_of(ROD.format(shape=shape, turn=repr(math.pi / 2)), tip="arm")
    for x in (1.5, 2.25):
        for angle in np.linspace(-3.0, 3.0, 5):
            place = at(x * math.cos(angle), x * math.sin(angle), 0.0)
            model = model_of(robot, [Box("post", (0.1, 0.1, 0.1), place)])
            assert model.free([[angle], [angle + 1.0]]).tolist() == [False, True]


def test_a_path_is_checked_between_its_ends():
    model = ball_model()
    ends = [0.0, 2.4, 0.0], [0.0, 3.9, 0.0]
    assert model.free(ends).tolist() == [True, True]
    # On the way, at j2 = pi, the forearm folds back onto the base.
    ways = np.linspace(*np.array(ends), 400)
    expected = all(min(gaps(q).values()) > 0.0 for q in ways)
    assert model.path_free(*ends) is expected is False
    assert model.path_free([0.0, 0.0, 0.0], [3.0, 0.0, 0.0]) is True
    assert model.path_free([0.0, 0.0, 0.0], [0.0, 0.0, 0.0]) is True
    blocked = [0.0, 3.0, 0.0]
    assert model.free(blocked).tolist() == [False]
    assert model.path_free(blocked, blocked) is False
    assert model.path_free([0.0, 0.0, 0.0], blocked) is False


@pytest.mark.parametrize(("touching", "always"), [(19, True), (18, False)])
def test_owners_always_touch_where_some_pair_does_at_95_percent_of_the_samples(touching, always):
    touched = np.zeros((20, 2), dtype=bool)
    touched[:touching:2, 0] = touched[1:touching:2, 1] = True
    assert _is_always(touched) is always


@pytest.mark.parametrize(
    ("gaps_by_sample", "is_box", "expected"),
    [
        # Closer than the clearance now and then: counted at the clearance.
        ([(0.02, 0.2), (0.2, 0.2)], False, (0.05, [1, 0])),
        # Some pair is always closer than it: counted where they touch.
        ([(0.02, 0.2), (0.2, -0.1)], False, (0.0, [0, 1])),
        ([(-0.02, 0.2), (0.2, -0.1)], False, (None, [1, 1])),
        # A box must not be touched all the same.
        ([(-0.02, 0.2), (0.2, -0.1)], True, (0.05, [1, 1])),
    ],
)
def test_how_owners_are_checked_depends_on_how_often_they_touch(gaps_by_sample, is_box, expected):
    def touched(pairs, margin):
        assert pairs == [(0, 2), (1, 2)]
        return np.array(gaps_by_sample) < margin

    margin, times = _choose_margin(touched, [(0, 2), (1, 2)], 0.05, is_box=is_box)
    assert (margin, times.tolist()) == expected


# --- Targets and what holds them, and the mounting plane ------------------------------------------------------------


def rod_gap(start, end, centre) -> float:
    """From a ball's centre to a rod's axis."""
    along = end - start
    share = np.clip((centre - start) @ along / max(along @ along, 1e-300), 0.0, 1.0)
    return float(np.linalg.norm(start + share * along - centre))


@given(q=ANGLES)
@settings(deadline=None)
def test_a_target_and_its_holder_touch_where_their_distance_says_so(q):
    model = held_model()
    assert {
        ("base", "the target 'probe' with its holder"),
        ("upper", "the target 'probe' with its holder"),
    } <= set(model.pairs)
    # Not with the link that it is mounted on, nor with one that it always touches: the tip is in the forearm's ball.
    assert ("hand", "the target 'probe' with its holder") not in model.pairs
    touching = dict(model.notes)["always_touching"]
    assert [one for one in touching if "holder" in one] == [
        "fore and the target 'probe' with its holder"
    ]
    angle = sum(q)
    tip = (model.robot.poses([q])[0] @ [0, 0, 0, 1])[:2]
    end = tip + 0.6 * np.array([math.cos(angle), math.sin(angle)])
    outside = [
        np.linalg.norm(np.maximum(np.abs(p - [0.9, 0.2]) - 0.1, 0.0)) for p in centres(q)[1:]
    ]
    rod = [rod_gap(tip, end, centre) - 0.08 for centre in centres(q)[:2]]
    share = np.linspace(0.0, 1.0, 4001)[:, None]
    points = tip + share * (end - tip)
    to_box = np.linalg.norm(np.maximum(np.abs(points - [0.9, 0.2]) - 0.1, 0.0), axis=1).min() - 0.03
    least = min([*gaps(q).values(), *(np.array(outside) - 0.05), *rod, to_box])
    assume(abs(least) > 1e-4)
    assert model.free(q).tolist() == [least > 0.0]


@cache
def held_model() -> CollisionModel:
    return model_of(
        robot_of(balls()),
        [Box("post", (0.2, 0.2, 1.0), at(0.9, 0.2, 0.0))],
        targets={"probe": (0.6, 0.0, 0.0)},
        holder_radius=0.03,
    )


def test_nothing_comes_below_the_mounting_plane():
    robot = Robot.load("ur10")
    plane = model_of(robot, floor=True, targets={"target": (0.0, 0.05, 0.2)})
    assert any("the mounting plane (z = 0 mm of 'world')" in second for _, second in plane.pairs)
    q = spread_poses(robot, 600)
    free = plane.free(q)
    for link, T in (
        ("tool0", np.eye(4)),
        ("tool0", at(0.0, 0.05, 0.2)),
        ("wrist_1_link", np.eye(4)),
    ):
        robot_to = Robot.load("ur10", tip=link) if link != "tool0" else robot
        height = (robot_to.poses(q[:, : len(robot_to.joint_names)]) @ T)[:, 2, 3]
        assert np.all(height[free] > 0.0)
    # And no pose is refused for it that keeps above: links of 0.1 m and more around the joints.
    without = model_of(robot, targets={"target": (0.0, 0.05, 0.2)}).free(q)
    assert np.all(without[free])
    assert 0.2 < np.mean(free[without]) < 0.8


# --- A real robot, against FCL and forward kinematics written anew -------------------------------------------------


@cache
def ur3() -> Robot:
    return Robot.load(example.paper_urdf(), base="base", tip="tool0")


def fcl_touches(placed, pairs) -> bool:
    return any(touch(placed[a], placed[b]) for a, b in pairs)


NEIGHBOURS = [
    ("base_link", "shoulder_link"),
    ("shoulder_link", "upper_arm_link"),
    ("upper_arm_link", "forearm_link"),
    ("forearm_link", "wrist_1_link"),
    ("wrist_1_link", "wrist_2_link"),
    ("wrist_2_link", "wrist_3_link"),
]


def surroundings() -> list[Box]:
    turned = at(-0.35, 0.2, 0.3)
    turned[:3, :3] = Rotation.from_euler("xyz", [20.0, -30.0, 40.0], degrees=True).as_matrix()
    return [
        Box("table", (1.2, 0.8, 0.04), at(0.0, 0.0, -0.02)),
        Box("pillar", (0.1, 0.1, 0.4), at(0.35, 0.0, 0.2)),
        Box("cabinet", (0.3, 0.2, 0.4), turned),
    ]


@pytest.mark.parametrize("boxed", [False, True])
def test_the_ur3_agrees_with_fcl(boxed):
    boxes = surroundings() if boxed else []
    model = model_of(ur3(), boxes)
    links = list(bodies(ur3()))
    # What is compared is said here anew: all but neighbours, the box of the flange fixed to wrist 3 among them.
    held_out = {*NEIGHBOURS, ("wrist_2_link", "ee_link"), ("wrist_3_link", "ee_link")}
    pairs = {(a, b) for i, a in enumerate(links) for b in links[i + 1 :]} - held_out
    pairs |= {(a, box.name) for box in boxes for a in links if a != "base_link"}
    assert set(model.pairs) == pairs
    assert "always_touching" not in dict(model.notes)
    q = np.random.default_rng(4).uniform(-np.pi, np.pi, (400, 6))
    free = model.free(q)
    expected = [not fcl_touches(objects(ur3(), row, boxes), pairs) for row in q]
    assert 100 < np.count_nonzero(free) < 340
    np.testing.assert_array_equal(free, expected)


def test_cores_find_what_one_configuration_after_the_other_does():
    robot = Robot.load("ur3", "base", "tool0")
    model = CollisionModel.of(robot, targets={"target": [0.07, -0.07, 0.02]})
    scene = model._scene
    configurations = model._configurations(spread_poses(robot, 1500))  # more than one block
    expected = scene._replace(pool=None).touches(configurations)
    assert 0.1 < expected.mean() < 0.9
    np.testing.assert_array_equal(scene.touches(configurations), expected)
    for some in (configurations[expected][:50], configurations[~expected][:50]):
        found = scene.touches(some, first=True).any()
        assert found == scene._replace(pool=None).touches(some).any()
    assert scene.touches(configurations[:0]).shape == (0,)
