"""Plans for cells of several hands, cameras and robots: what each view measures, and poses that serve several."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from calib.boards.board import Board
from calib.camera.camera import Camera
from calib.data.cell import Cell, FurtherRobot, Tracker
from calib.data.cell_chains import robot_of_cell
from calib.errors import CalibError, ModelError
from calib.numerics.errors import rms
from calib.result.calibrate import calibrate
from calib.robot.ranges import random_joint_values
from calib.robot.urdf import read_urdf
from calib.verbs.plan.bodies import collision_model
from calib.verbs.plan.choice import PlanRequest
from calib.verbs.plan.collision import CollisionCheck
from calib.verbs.plan.plan import plan
from calib.verbs.plan.plan_file import plan_table, read_poses, write_plan
from calib.verbs.plan.sensitivity import Sensitivity
from calib.verbs.plan.text import plan_text
from calib.verbs.simulate.scenario import Scenario, with_robots_placed

SIGMA = 5e-5

TWO_PANDAS = with_robots_placed(
    Cell(
        estimate_frame=True,
        robots={"right": FurtherRobot("panda")},
        tips={"a": "panda_link8", "b": "right/panda_link8"},
        targets={"a": [0.06, 0.03, 0.05], "b": [-0.04, 0.05, 0.02]},
        sigma={"m": SIGMA},
    )
)

BOARD = Board(pattern="chessboard", columns=5, rows=4, square=0.04)

#: Two cameras on the table that see a board on the flange, and one on the wrist that sees a board on the table.
CAMERAS = Cell(
    cameras={name: Camera(width=1280, height=720) for name in ("wall", "wrist")},
    boards=dict.fromkeys(("flange", "table"), BOARD),
    bases={"wall": "panda_link0", "wrist": "panda_link8"},
    tips={"flange": "panda_link8", "table": "panda_link0"},
    target=[0.0, 0.0, 0.05],
    target_rotation=np.diag([1.0, -1.0, -1.0]),
    sigma={"px": 0.2},
)


@cache
def pandas():
    return robot_of_cell(read_urdf("panda"), TWO_PANDAS)


@cache
def planned():
    request = PlanRequest(count=12, validation=2, candidates=300, ladder=False)
    tracker = replace(TWO_PANDAS, tracker=Tracker([0.5, 2.5, 0.8], nearest=2.3, farthest=2.5))
    return plan(pandas(), tracker, request, collisions=None)


def test_both_hands_are_differentiated_along_their_own_chains():
    """By robots whose origins are moved, through `ErrorModel.apply`, not by the twists of chains."""
    sensitivity = Sensitivity.of(pandas(), TWO_PANDAS)
    model, setup = sensitivity.kinematics.model, sensitivity.setup
    assert sensitivity.sights == (("", "a"), ("", "b"))
    q = random_joint_values(pandas(), 3)
    measured = sensitivity.measured(q) * SIGMA
    assert measured.shape == (3, 6, len(model))
    names = ["panda_joint2.x", "panda_joint4.rz", "right/panda_joint5.ry", "mount_rz[right]"]
    for name in names:
        column = model.index(name)
        points = []
        for sign in (1.0, -1.0):
            x = np.zeros(len(model))
            x[column] = sign * 1e-5
            moved = model.apply(pandas(), x)
            ends = [
                (chain.poses(q) @ T)[:, :3, 3]
                for chain, T in zip(moved.chains, setup.T_tip_target, strict=True)
            ]
            points.append(np.hstack(ends))
        expected = (points[0] - points[1]) / 2e-5
        np.testing.assert_allclose(measured[:, :, column], expected, atol=1e-6)
        assert np.abs(expected).max() > 0.1
    np.testing.assert_allclose(sensitivity.located(q), measured, atol=1e-12)


def test_what_a_view_does_not_see_tells_nothing():
    sensitivity = Sensitivity.of(pandas(), TWO_PANDAS)
    q = random_joint_values(pandas(), 2)
    seen = np.array([[True, False], [False, True]])
    part, whole = sensitivity.measured(q, seen=seen), sensitivity.measured(q)
    np.testing.assert_array_equal(part[0, :3], whole[0, :3])
    np.testing.assert_array_equal(part[1, 3:], whole[1, 3:])
    assert not part[0, 3:].any()
    assert not part[1, :3].any()


def test_a_camera_does_not_tell_of_the_lens_and_the_board_of_another():
    robot = robot_of_cell(read_urdf("panda"), CAMERAS)
    sensitivity = Sensitivity.of(robot, CAMERAS)
    assert sensitivity.sights == (("wall", "flange"), ("wrist", "table"))
    wall, wrist = sensitivity.views
    assert wall.instrument.internals[0].tolist() != wrist.instrument.internals[0].tolist()
    index = {name: k for k, name in enumerate(sensitivity.names)}
    # A pose at which the board is before each camera: 0.4 m along its line of sight.
    for view in (wall, wrist):
        T = np.tile(np.diag([1.0, 1.0, 1.0, 1.0]), (1, 1, 1, 1))
        T[..., 2, 3] = 0.4
        twists = np.zeros((1, 1, 6, len(index)))
        model = sensitivity.kinematics.model
        A = view.instrument.whitened(T, twists, np.array([0.2]), model)
        told = {name for name, k in index.items() if A[0, :, k].any()}
        own = "wall" if view is wall else "wrist"
        board = "flange" if view is wall else "table"
        assert {name.partition("[")[2].rstrip("]") for name in told} == {own, board}
        assert {f"fx[{own}]", f"board_scale_x[{board}]"} <= told


def test_each_hand_is_measured_where_the_tracker_reaches_it():
    """The tracker is near: it reaches one hand at some poses, the other at others, and both at some."""
    found = planned()
    assert found.sights == (("", "a"), ("", "b"))
    assert found.seen.any(axis=1).all()
    assert {tuple(row) for row in found.seen.tolist()} >= {(True, True)}
    assert not found.seen.all()
    for k, (chain, T) in enumerate(zip(found.robot.chains, found.T_tip_target, strict=True)):
        points = (chain.poses(found.joints) @ T)[:, :3, 3]
        far = np.linalg.norm(points - [0.5, 2.5, 0.8], axis=1)
        np.testing.assert_array_equal(found.seen[:, k], (far >= 2.3) & (far <= 2.5))
        np.testing.assert_allclose(found.expected[:, k], points, atol=1e-12)
    text = " ".join(plan_text(found).split())
    count = int(found.seen[:, 0].sum())
    assert f"targets: a at {count} poses" in text


def test_each_hand_has_a_place_of_its_own_in_the_base():
    """By the pose of each tip in the URDF's root, and as expected in a frame at the root."""
    found = planned()
    places = found.places(found.joints)
    assert places.shape == (len(found.joints), 2, 3)
    for k, (chain, name) in enumerate(zip(pandas().chains, ("a", "b"), strict=True)):
        point = np.append(TWO_PANDAS.targets[name], 1.0)
        np.testing.assert_allclose(
            places[:, k], (chain.poses(found.joints) @ point)[:, :3], atol=1e-12
        )
    apart = np.linalg.norm(places[:, 0] - places[:, 1], axis=1)
    assert apart.min() > 0.05


def test_the_table_says_which_hand_and_is_read_again(tmp_path: Path):
    found = planned()
    path = write_plan(found, tmp_path / "plan.csv")
    header, *lines = [line.split(",") for line in path.read_text().splitlines()]
    assert len(lines) == found.seen.sum()
    target = header.index("target")
    expected = [
        found.sights[k][1] for row in found.seen.tolist() for k, seen in enumerate(row) if seen
    ]
    assert [line[target] for line in lines] == expected
    poses = read_poses(path, found.robot)
    np.testing.assert_array_equal(poses.joints, found.joints)
    seen = [
        {sight for sight, is_seen in zip(found.sights, row, strict=True) if is_seen}
        for row in found.seen
    ]
    assert [set(sights) for sights in poses.sights] == seen
    said = plan_table(found)
    assert said["asked"]["sights"] == [{"group": "", "target": name} for name in ("a", "b")]
    assert [list(pose["seen"]) for pose in said["poses"]] == found.seen.tolist()


def test_poses_of_one_hand_alone_call_for_the_other():
    """Of ten poses taken, all of hand a: nothing is known of b, and what is planned makes up for it."""
    q = random_joint_values(pandas(), 10)
    request = PlanRequest(count=12, validation=0, candidates=200, ladder=False)
    found = plan(
        pandas(), TWO_PANDAS, request, taken=q, taken_sights=[[("", "a")]] * 10, collisions=None
    )
    assert found.taken_seen.tolist() == [[True, False]] * 10
    assert found.before is not None
    names = dict(zip(found.before.names, range(len(found.before.names)), strict=True))
    prior = TWO_PANDAS.priors.of("angle")
    last = names["right/panda_joint5.rx"]
    assert found.before.parameter_std[last] == pytest.approx(prior, rel=1e-6)
    assert found.forecast.parameter_std[last] < 0.3 * prior
    both = plan(pandas(), TWO_PANDAS, request, taken=q, collisions=None)
    assert both.before.rms < 0.5 * found.before.rms
    with pytest.raises(ModelError, match="taken_sights"):
        plan(pandas(), TWO_PANDAS, request, taken=q, taken_sights=[[]], collisions=None)


@pytest.mark.slow
def test_a_collision_of_two_arms_and_what_they_carry_is_found():
    model = collision_model(
        Sensitivity.of(pandas(), TWO_PANDAS).instrument,
        Sensitivity.of(pandas(), TWO_PANDAS),
        CollisionCheck(),
    )
    names = {name for pair in model.pairs for name in pair}
    assert {f"the target '{name}' with its holder" for name in "ab"} <= names
    assert ("panda_link7", "right/panda_link7") in model.pairs
    down = np.array([0.0, 1.2, 0.0, -0.6, 0.0, 1.8, 0.0])
    away = np.array([2.5, 0.0, 0.0, -1.5, 0.0, 1.5, 0.0])
    # Face to face, a metre apart, both stretched to the middle; or the right arm turned away.
    assert model.free([[*down, *down], [*down, *away]]).tolist() == [False, True]


def test_what_cannot_be_planned_for_is_refused():
    unplaced = replace(TWO_PANDAS, robots={"right": FurtherRobot("panda")})
    with pytest.raises(CalibError, match=r"\[robots.right\]"):
        plan("panda", unplaced, PlanRequest(count=12))
    two = replace(TWO_PANDAS, bases={"t1": "panda_link0", "t2": "panda_link0"}, estimate_frame=True)
    with pytest.raises(ModelError, match="'t1', 't2'"):
        plan("panda", two, PlanRequest(count=12))


def test_the_hand_that_is_never_measured_is_named():
    far = replace(TWO_PANDAS, tracker=Tracker([0.5, 2.5, 0.8], nearest=60.0, farthest=80.0))
    with pytest.raises(ModelError, match="target 'a' on 'panda_link8': None of"):
        plan(pandas(), far, PlanRequest(count=12, validation=2, candidates=50), collisions=None)


@pytest.mark.slow
def test_a_camera_on_the_head_sees_boards_on_both_hands_at_once(tmp_path: Path):
    T_head_camera = np.eye(4)
    T_head_camera[:3, :3] = [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    cell = Cell(
        cameras={"head": Camera(width=1280, height=720)},
        boards={"": BOARD},
        bases={"head": "head_2_link"},
        tips={"left": "arm_left_7_link", "right": "arm_right_7_link"},
        T_frame_base=np.linalg.inv(T_head_camera),
        target=[0.0, 0.0, 0.06],
        target_rotation=np.diag([1.0, -1.0, -1.0]),
        sigma={"px": 0.2},
    )
    robot = robot_of_cell(read_urdf("tiago_dual"), cell)
    request = PlanRequest(count=20, validation=2, candidates=150, ladder=False)
    found = plan(robot, cell, request, collisions=None)
    assert found.seen.all(axis=1).any()
    for k, (view, sightline) in enumerate(zip(found.views, found.sightlines, strict=True)):
        T = sightline.target_poses(found.joints)
        np.testing.assert_array_equal(
            found.seen[:, k],
            view.instrument.in_focus(T)
            & view.instrument.is_facing(T)
            & view.instrument.in_image(T),
        )
    path = write_plan(found, tmp_path / "images.csv")
    header, *lines = [line.split(",") for line in path.read_text().splitlines()]
    images = [line[header.index("image")] for line in lines]
    assert images == [f"head_{k + 1:03d}.png" for k in range(22)]
    boards = [line[header.index("expected target")] for line in lines]
    assert "left/right" in boards
    assert found.forecast.rms < found.at_random.rms


@pytest.mark.slow
def test_planned_poses_leave_less_error_than_random_ones():
    """Of two Pandas, by fits of simulated measurements, at poses that neither has seen."""
    scenario = Scenario(pandas(), replace(TWO_PANDAS, model="placement"))
    request = PlanRequest(count=14, validation=0, candidates=2000, ladder=False)
    chosen = plan(pandas(), scenario.cell, request, collisions=None)
    assert chosen.forecast.rms < 0.9 * chosen.at_random.rms
    squares = {"planned": [], "random": []}
    for seed in range(3):
        virtual = scenario.draw(seed)
        unseen = scenario.random_poses(200, seed + 50)
        poses = {"planned": chosen.joints, "random": scenario.random_poses(14, seed + 20)}
        for name, q in poses.items():
            made = virtual.measure(q, seed)
            result = calibrate("panda", made.measurements, cell=scenario.cell, validate=False)
            for target in ("a", "b"):
                samples = result.samples(unseen, target=target)
                found = result.geometry.kinematics.points(result.geometry.x, samples)
                squares[name] += [
                    *np.linalg.norm(found - made.truth.points(unseen, target), axis=1)
                ]
    planned_rms, random_rms = (rms(np.array(squares[name])) for name in ("planned", "random"))
    assert planned_rms < 0.8 * random_rms
    assert planned_rms == pytest.approx(chosen.forecast.rms, rel=0.4)


@pytest.mark.slow
def test_from_a_plan_over_simulated_rows_to_further_poses(call, tmp_path: Path):
    """The command line, with one set of options: plan, simulate what was planned, plan further poses."""
    (tmp_path / "cell.toml").write_text(
        'frame = "estimate"\nsigma_mm = 0.05\n[tips]\na = "panda_link8"\nb = "right/panda_link8"\n'
        '[robots.right]\nrobot = "panda"\nxyz_mm = [1000, 0, 0]\nrpy_deg = [0, 0, 180]\n'
    )
    words = ("panda", "--cell", "cell.toml")
    more = ("--no-collisions", "--candidates", "200", "--validation", "0")
    assert call(tmp_path, "plan", *words, *more, "--count", "12", "-o", "p.csv").code == 0
    done = call(tmp_path, "simulate", *words, "--poses", "p.csv", "-o", "t.csv")
    assert (done.code, done.err) == (0, "")
    assert "24 rows" in done.out
    done = call(tmp_path, "plan", *words, *more, "--count", "3", "--taken", "t.csv", "-o", "n.csv")
    assert "3 poses for calibration in addition to 12 measured ones" in " ".join(done.out.split())
    rows = (tmp_path / "n.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in rows[1:]] == [str(k) for k in range(25, 31)]
    refused = call(tmp_path, "plan", *words, *more, "--view", "p.html")
    assert refused.code != 0
    assert "--view shows a plan for one hand" in refused.err
