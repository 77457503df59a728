"""The usual mistakes, made on the paper's data: calib names the one that was made, and no other."""

from __future__ import annotations

import importlib
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.basics.arrays import read_only
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Reason, Why
from calib.diagnosis.trials import with_joints
from calib.diagnosis.usual_mistakes import (
    _best_factors,
    _choose,
    _some_rows,
    _turned_joints,
    check_positions,
    doubtful_senses,
    find_usual_mistake,
)
from calib.errors import MeasurementError
from calib.example import PAPER_TARGET, paper_urdf
from calib.fit.registration.rows import Rows
from calib.fit.registration.table_rows import rows_and_setup
from calib.result.calibrate import calibrate
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.simulate.truth import draw_truth
from tests import images
from tests.places import ROOT

TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
WRONG = Cell(target=read_only([0.07, -0.07, 0.02252]))


@pytest.fixture(scope="module")
def thirty(table: Measurements) -> Measurements:
    return table.select(np.arange(len(table)) < 30)


def spoilt(rows: Measurements, joints: Any = 1.0, add: Any = 0.0, points: Any = 1.0, **order: Any):
    """The rows with columns times, plus, and in another order."""
    q, p = rows.joints * joints + np.radians(add), points * rows.points
    return replace(
        rows, joints=q[:, order.get("q", range(6))], points=p[:, order.get("p", range(3))]
    )


def seen_elsewhere(rows: Measurements) -> Measurements:
    return replace(rows, points=read_only(rows.points @ TURN.T + np.array([2.0, 1.0, -0.5])))


def test_nothing_is_told_where_nothing_fits_better(ur3: Robot, thirty: Measurements):
    moved, rng = seen_elsewhere(thirty), np.random.default_rng(3)
    for cell, rows in (
        (Cell(), thirty),
        (Cell(target=read_only(PAPER_TARGET)), thirty),
        (WRONG, thirty),  # the target is found anyway
        (Cell(), moved.select(np.arange(30) < 3)),
        (Cell(estimate_frame=True), moved),
        (Cell(T_frame_base=read_only(np.eye(4))), moved),
        (Cell(), replace(thirty, joints=read_only(rng.uniform(-3, 3, (30, 6))))),
    ):
        assert find_usual_mistake(ur3, cell, rows) is None


ELBOW, LIFT, PAN = "elbow_joint", "shoulder_lift_joint", "shoulder_pan_joint"
WRISTS = ["wrist_1_joint", "wrist_2_joint", "wrist_3_joint"]


@pytest.mark.parametrize(
    ("mistake", "why", "values"),
    [
        ({"joints": [1, 1, -1, 1, 1, 1]}, Why.JOINTS_TURNED, [ELBOW]),
        ({"joints": [1, -1, 1, 1, -1, 1]}, Why.JOINTS_TURNED, [LIFT, WRISTS[1]]),
        ({"joints": [-1, 1, 1, -1, 1, -1]}, Why.JOINTS_TURNED, [PAN, WRISTS[0], WRISTS[2]]),
        ({"add": [0, 90, 0, 0, 0, 0]}, Why.JOINT_ZERO, [LIFT, str(-np.pi / 2)]),
        ({"add": [0, 0, 0, -180, 0, 0]}, Why.JOINT_ZERO, [WRISTS[0], str(np.pi)]),
        ({"q": [0, 2, 1, 3, 4, 5]}, Why.COLUMNS_SWAPPED, [LIFT, ELBOW]),
        ({"p": [1, 0, 2]}, Why.COLUMNS_SWAPPED, ["x y"]),
        ({"points": [1, -1, 1]}, Why.SIGN_TURNED, ["y"]),
        ({"points": 1 / 25.4}, Why.WRONG_UNIT, ["points", "in mm"]),
        ({"points": 1e-3}, Why.WRONG_UNIT, ["points", "m mm"]),
        ({"joints": np.degrees(1.0)}, Why.WRONG_UNIT, ["joint values", "0.0174"]),
    ],
)
def test_each_usual_mistake_is_named(ur3: Robot, thirty: Measurements, mistake, why, values):
    told = find_usual_mistake(ur3, Cell(), spoilt(thirty, **mistake))
    assert told.why == why
    assert 2e-3 < told.values["error_m"] < 3e-3
    assert all(one in " ".join(map(str, told.values.values())) for one in values)


@pytest.mark.parametrize(
    ("stated", "true", "why"),
    [
        ({}, {ELBOW: {LIFT: 1.0}}, Why.READINGS_COUPLED),
        ({}, {WRISTS[1]: {WRISTS[0]: -1.0}}, Why.READINGS_COUPLED),
        ({ELBOW: {LIFT: 1.0}}, {ELBOW: {LIFT: -1.0}}, Why.READINGS_COUPLED),
        ({ELBOW: {LIFT: 1.0}}, {}, Why.READINGS_NOT_COUPLED),
        (
            {ELBOW: {LIFT: 1.0}, WRISTS[0]: {ELBOW: 1.0}},
            {ELBOW: {LIFT: -1.0}, WRISTS[0]: {ELBOW: 1.0}},
            Why.READINGS_COUPLED,
        ),
    ],
)
def test_coupled_readings_are_named(ur3: Robot, thirty: Measurements, stated, true, why):
    """The paper's joint values as readings of a controller that couples them."""
    there, here = (
        Robot.from_urdf(ur3.urdf, ur3.base, ur3.tip, coupling=coupling)
        for coupling in (true, stated)
    )
    told = find_usual_mistake(here, Cell(), replace(thirty, joints=there.readings(thirty.joints)))
    assert told.why == why
    assert 2e-3 < told.values["error_m"] < 3e-3
    assert "others" not in told.values
    (joint, factors), *_ = (true or stated).items()
    assert (told.values["joint"], told.values["reading"]) == (joint, next(iter(factors)))
    assert told.values.get("factor") == next(iter(true.get(joint, {}).values()), None)


def test_the_sign_and_the_zero_of_one_joint_are_two_mistakes(ur3: Robot, thirty: Measurements):
    twenty = thirty.select(np.arange(30) < 20)
    told = find_usual_mistake(
        ur3, Cell(), spoilt(twenty, joints=[1, 1, -1, 1, 1, 1], add=[0, 0, 90, 0, 0, 0])
    )
    assert told.why == Why.TWO_MISTAKES
    sign, zero = told.values["both"]
    assert sign == {"code": "joints_turned", "joints": ELBOW}
    # Readings are -q + 90 deg, so that with the other sign a quarter turn is missing.
    assert zero == {"code": "joint_zero", "joint": ELBOW, "add_rad": pytest.approx(np.pi / 2)}
    assert told.values["error_m"] < 3e-3


def test_the_last_joints_zero_is_named_where_it_puts_a_given_target_back(
    ur3: Robot, thirty: Measurements
):
    """By a turn that is round; by another one the target itself may be elsewhere."""
    given = Cell(target=read_only(PAPER_TARGET))
    told = find_usual_mistake(ur3, given, spoilt(thirty, add=[0, 0, 0, 0, 0, 45]))
    assert (told.why, told.values["joint"]) == (Why.JOINT_ZERO, WRISTS[2])
    assert told.values["add_rad"] == pytest.approx(-np.pi / 4)
    assert told.values["error_m"] < 3e-3
    assert find_usual_mistake(ur3, given, spoilt(thirty, add=[0, 0, 0, 0, 0, 30])) is None


def test_all_explanations_that_the_rows_cannot_tell_apart_are_named(
    ur3: Robot, thirty: Measurements
):
    """The last joint's sign, and a zero of 180 deg: the target is found for either, at another place."""
    reason = find_usual_mistake(ur3, Cell(), spoilt(thirty, joints=[1, 1, 1, 1, 1, -1]))
    named = [{"code": reason.code, **reason.values}, *reason.values["others"]]
    assert {one["code"] for one in named} == {"joints_turned", "joint_zero"}
    assert all(one["error_m"] < 1.5 * reason.values["error_m"] + 1e-6 for one in named)
    assert any(one.get("joints") == WRISTS[2] for one in named)
    # Of a mistake that only one thing explains nothing else is named.
    alone = find_usual_mistake(ur3, Cell(), spoilt(thirty, joints=[1, 1, -1, 1, 1, 1]))
    assert "others" not in alone.values


def test_positions_that_are_all_one_are_refused_before_any_fit(ur3: Robot, thirty: Measurements):
    still = replace(thirty, points=np.tile(thirty.points[:1], (30, 1)))
    with pytest.raises(MeasurementError, match="all 30 measured positions are"):
        calibrate(ur3, still)
    one_pose = replace(still, joints=np.tile(thirty.joints[:1], (30, 1)))
    rows, _ = rows_and_setup(ur3, one_pose, Cell())
    check_positions(ur3, rows, "")


def test_points_in_the_frame_of_another_link_are_told_where_no_frame_is_given(
    thirty: Measurements,
):
    world = Robot.load(paper_urdf(), tip="tool0")
    base = find_usual_mistake(world, Cell(), thirty)
    assert (base.why, base.values["link"]) == (Why.OTHER_BASE, "base")
    assert base.values["given_m"] == pytest.approx(0.529, abs=1e-3)
    # That link is turned by half a turn: of a given frame, the first joint's zero explains it.
    given = find_usual_mistake(world, Cell(T_frame_base=read_only(np.eye(4))), thirty)
    assert (given.why, given.values["joint"]) == (Why.JOINT_ZERO, PAN)
    assert "others" not in given.values


@pytest.mark.slow
def test_a_trackers_frame_and_a_target_that_is_fixed(ur3: Robot, thirty: Measurements):
    assert find_usual_mistake(ur3, Cell(), seen_elsewhere(thirty)).why == Why.OWN_FRAME
    for mistake in (
        {"p": [1, 0, 2]},
        {"points": [1, 1, -1]},
    ):  # a frame that may turn cannot tell them apart
        mirrored = spoilt(seen_elsewhere(thirty), **mistake)
        assert (
            find_usual_mistake(ur3, Cell(estimate_frame=True), mirrored).why == Why.POINTS_MIRRORED
        )
    fixed = replace(WRONG, estimate_target=False)
    assert find_usual_mistake(ur3, fixed, thirty).why == Why.TARGET_ELSEWHERE
    world = Robot.load(paper_urdf(), tip="tool0")
    judged = calibrate(world, thirty.select(np.arange(30) < 14), model="zeros").verdict
    assert (judged.use, judged.reasons[0].values["link"]) == ("do not use", "base")


def test_a_joint_without_values_and_a_tip_before_the_last_joints(ur3: Robot, thirty: Measurements):
    for joint in (0, 3):
        told = find_usual_mistake(ur3, Cell(), spoilt(thirty, joints=1.0 - np.eye(6)[joint]))
        assert (told.why, told.values["joint"]) == (Why.JOINT_CONSTANT, ur3.joint_names[joint])
    told = find_usual_mistake(ur3.rebuilt(tip="wrist_1_link"), Cell(), thirty)
    assert told.why == Why.OTHER_TIP
    other = ur3.rebuilt(tip=told.values["link"])
    assert other.joint_names == ur3.joint_names


def test_poses_of_the_frame_in_the_target(ur3: Robot):
    truth, q = draw_truth(ur3, "dh", {}, 1), random_joint_values(ur3, 20, 1)
    T = np.linalg.inv(truth.poses(q))
    table = Measurements(
        ur3.joint_names, q, T[:, :3, 3], kinds=("pose",) * 20, rotations=T[:, :3, :3]
    )
    told = find_usual_mistake(ur3, Cell(), table)
    assert told.why == Why.POSES_INVERSE
    assert told.values["error_m"] < 5e-3 < 0.2 < told.values["given_m"]


@pytest.mark.parametrize("later", [True, False])
def test_measurements_that_stand_a_row_away_from_their_joint_values(
    ur3: Robot, thirty: Measurements, later: bool
):
    points = np.roll(thirty.points, 1 if later else -1, axis=0)
    told = find_usual_mistake(ur3, Cell(), replace(thirty, points=points))
    assert (told.why, told.values["later"]) == (Why.ROWS_SHIFTED, later)
    assert 2e-3 < told.values["error_m"] < 3e-3


@pytest.mark.parametrize("up", [True, False])
@pytest.mark.parametrize("in_file", [True, False])
def test_a_measurement_that_went_missing_moved_the_others(
    ur3: Robot, thirty: Measurements, in_file: bool, up: bool
):
    """In the order of the file or of the measurements, where rows are sorted otherwise in the file."""
    number = (
        np.random.default_rng(1).permutation(30) + 1
    )  # of each row, in the order of measurement
    order = np.argsort(number) if in_file else np.arange(30)
    first, last = order[12], order[-1]
    points = thirty.points.copy()
    source, sink = (order[13:], order[12:-1]) if up else (order[12:-1], order[13:])
    points[sink] = thirty.points[source]
    # Of the measurements that moved up the last place is empty; of those that moved down the first.
    kept = np.arange(30) != (last if up else first)
    table = replace(thirty, points=points, rows=tuple(number.tolist()))
    told = find_usual_mistake(ur3, Cell(), table.select(kept) if up else table)
    assert (told.why, told.values["up"]) == (Why.ROWS_MOVED, up)
    assert told.values["row"] in number[order[11:15]]
    assert told.values["error_m"] < 5e-3


def test_one_axis_in_another_unit(ur3: Robot, thirty: Measurements):
    told = find_usual_mistake(ur3, Cell(), spoilt(thirty, points=[1.0, 1e-3, 1.0]))
    assert (told.why, told.values["what"]) == (Why.WRONG_UNIT, "values of 'y'")
    assert (told.values["unit"], told.values["header"]) == ("m", "mm")


def test_all_signs_of_few_joints_are_tried_and_single_ones_of_many(
    ur3: Robot, thirty: Measurements, serial_urdf
):
    rows, setup = rows_and_setup(ur3, thirty, Cell())
    trials = list(_turned_joints(ur3, setup, rows))
    assert len(trials) == 2**6 - 1
    # The more signs, the larger the error that counts.
    for trial in trials:
        count = len(trial.mistake.values["joints"].split(", "))
        assert trial.factor == pytest.approx(1.0 + 0.2 * count)
    joint = ("revolute", (0.1, 0.0, 0.0), (0, 0, 0), (0, 0, 1))
    for joints, sets in ((7, 2**7 - 1), (8, 8)):
        robot = Robot.from_urdf(serial_urdf([joint] * joints))
        still = with_joints(rows, np.zeros((len(rows), joints)))
        assert len(list(_turned_joints(robot, setup, still))) == sets
    # An unknown frame makes each trial expensive.
    _, free = rows_and_setup(ur3, thirty, Cell(estimate_frame=True))
    assert len(list(_turned_joints(ur3, free, rows))) == 6


def test_a_factor_that_a_sign_explains_as_well_is_no_mistake_of_its_own():
    """The arm's own errors make another factor a little better; a real one is far from any sign or unit."""
    robot = Robot.load("ur5", base="base_link", tip="tool0")
    truth = draw_truth(robot, "dh", seed=1300)
    q = random_joint_values(robot, 30, 1350)
    points = truth.points(q)

    def factors(of_last: float) -> dict[str, float]:
        read = q * np.where(np.arange(6) == 5, of_last, 1.0)
        table = Measurements(robot.joint_names, read, points)
        rows, setup = rows_and_setup(robot, table, Cell())
        unknown = replace(setup, target_unknown=np.ones_like(setup.target_unknown))
        found = [mistake for _, mistake in _best_factors(robot, unknown, rows)]
        return {mistake.values["joint"]: mistake.values["factor"] for mistake in found}

    assert "wrist_3_joint" not in factors(-1.0)
    assert factors(0.5)["wrist_3_joint"] == pytest.approx(2.0, rel=0.03)


def test_sixty_rows_evenly_over_a_long_table_are_looked_at(ur3: Robot):
    q = random_joint_values(ur3, 178, 1)
    table = Measurements(ur3.joint_names, q, ur3.poses(q)[:, :3, 3])
    np.testing.assert_array_equal(_some_rows(table).joints, q[::3])
    short = table.select(np.arange(178) < 60)
    np.testing.assert_array_equal(_some_rows(short).joints, q[:60])


def test_explanations_as_good_as_the_best_are_named_with_it():
    """Ranked by the weighted error, and told apart by the error itself."""

    def explanation(factor: float, error_m: float, why: Why) -> tuple[bool, float, Reason]:
        return False, factor * error_m, Reason.of(why, error_m=error_m)

    best = explanation(1.0, 2e-3, Why.OTHER_BASE)
    contradicted, weighted, own_frame = explanation(2.0, 1.9e-3, Why.OWN_FRAME)
    as_good = contradicted, weighted, own_frame.with_values(given_m=0.5)
    found = _choose([explanation(1.2, 3.1e-3, Why.COLUMNS_REVERSED), as_good, best])
    assert (found.why, found.values["error_m"]) == (Why.OTHER_BASE, 2e-3)
    assert found.values["others"] == [{"code": "own_frame", "error_m": 1.9e-3}]
    # Of an exact table errors are rounding.
    exact = explanation(1.0, 1e-12, Why.OTHER_BASE), explanation(1.0, 5e-7, Why.OWN_FRAME)
    assert len(_choose(list(exact)).values["others"]) == 1


def positions_while_a_base_joint_turns(robot: Robot, by: float, apart: float) -> Rows:
    """Four rows: the tip is turned by so much about the base [rad], positions are so far apart on each axis [m]."""
    q = np.tile([0.3, -1.2, 1.4, -0.8, 0.6, 0.2], (4, 1))
    q[:, 0] += np.linspace(0.0, by, 4)
    points = np.array([0.1, 0.2, 0.3]) + np.linspace(0.0, apart, 4)[:, None]
    return rows_and_setup(robot, Measurements(robot.joint_names, q, points), Cell())[0]


def test_positions_are_all_one_where_only_the_tip_moved(ur3: Robot):
    with pytest.raises(MeasurementError):
        check_positions(ur3, positions_while_a_base_joint_turns(ur3, 0.2, 5e-7), "")
    check_positions(ur3, positions_while_a_base_joint_turns(ur3, 0.2, 2e-6), "")
    # Some millimetres of a tip may be play of the socket.
    check_positions(ur3, positions_while_a_base_joint_turns(ur3, 0.01, 0.0), "")


def test_the_orientations_of_poses_tell_signs_apart_that_positions_do_not(ur3: Robot):
    """With a target on the last joint's axis, its sign has no effect on positions."""
    q = random_joint_values(ur3, 20, 1)
    T = ur3.poses(q)
    turned = q * [1, 1, 1, -1, 1, 1]
    table = Measurements(
        ur3.joint_names, turned, T[:, :3, 3], kinds=("pose",) * 20, rotations=T[:, :3, :3]
    )
    on_axis = Cell(target=read_only(np.zeros(3)), estimate_target=False)
    told = find_usual_mistake(ur3, on_axis, table)
    assert (told.why, told.values["joints"]) == (Why.JOINTS_TURNED, "wrist_1_joint")
    assert "others" not in told.values
    points = replace(table, kinds=("point",) * 20, rotations=None)
    told = find_usual_mistake(ur3, on_axis, points)
    others = [other["joints"] for other in told.values["others"]]
    assert "wrist_1_joint, wrist_3_joint" in (told.values["joints"], *others)


@pytest.mark.slow
def test_every_mistake_of_the_study_is_named_by_its_cause():
    sys.path.insert(0, str(ROOT / "scripts"))
    study = importlib.import_module("mistakes_study")
    tables = [(name, kind) for name in study.MISTAKES for kind in study.TABLES]
    outcomes = [study.outcome(name, kind, free=False) for name, kind in tables]
    outcomes = [outcome for outcome in outcomes if outcome is not None]
    assert len(outcomes) == 64
    assert np.mean([outcome.named for outcome in outcomes]) >= 0.9
    assert all(outcome.use == "do not use" for outcome in outcomes)


def test_a_cell_may_name_targets_that_few_rows_of_a_long_table_see(ur3: Robot):
    """Of a long table some rows are looked at: with two targets by turns, every other one, those of one target."""
    q, names = random_joint_values(ur3, 119, 1), ("left", "right") * 60
    places = dict(zip(names, ([0.05, 0.0, 0.1], [-0.05, 0.0, 0.1]), strict=False))
    poses = ur3.poses(q)
    points = [T[:3, 3] + T[:3, :3] @ places[n] for T, n in zip(poses, names, strict=False)]
    table = Measurements(ur3.joint_names, q, np.array(points), targets=names[:119])
    cell = Cell(targets={name: read_only(place) for name, place in places.items()})
    assert find_usual_mistake(ur3, cell, table) is None


def test_links_of_camera_and_board_that_are_exchanged_are_named():
    backwards = images.arm().rebuilt(base="panda_link0", tip="panda_link8")
    told = find_usual_mistake(backwards, images.cell(), images.table(images.poses(12)))
    assert told.why == Why.CAMERA_ON_OTHER_LINK
    assert (told.values["tip"], told.values["base"]) == ("panda_link8", "panda_link0")
    assert told.values["error_m"] < 5e-3 < 0.03 < told.values["given_m"]


@pytest.mark.parametrize(
    ("change", "why", "values"),
    [
        (lambda q: Rotation.from_quat(np.roll(q, 1, 1)), Why.SCALAR_ELSEWHERE, {"scalar": "first"}),
        (lambda q: Rotation.from_quat(np.roll(q, -1, 1)), Why.SCALAR_ELSEWHERE, {"scalar": "last"}),
        (lambda q: Rotation.from_quat(q).inv(), Why.ORIENTATIONS_INVERSE, {}),
    ],
)
def test_orientations_that_are_written_otherwise(ur3: Robot, change, why, values):
    truth, q = draw_truth(ur3, "dh", {}, 1), random_joint_values(ur3, 20, 1)
    T = truth.poses(q)
    table = Measurements(
        ur3.joint_names, q, T[:, :3, 3], kinds=("pose",) * 20, rotations=T[:, :3, :3]
    )
    assert find_usual_mistake(ur3, Cell(), table) is None
    quaternions = Rotation.from_matrix(T[:, :3, :3]).as_quat()
    told = find_usual_mistake(
        ur3, Cell(), replace(table, rotations=change(quaternions).as_matrix())
    )
    assert told.why == why
    assert values.items() <= told.values.items()
    assert told.values["error_rad"] < 0.05 < 1.0 < told.values["given_rad"]


@pytest.mark.parametrize(
    ("change", "why", "values"),
    [
        (lambda q: q * [1, 1, 1, 1, 1, -1], Why.ORIENTATIONS_JOINT_TURNED, {}),
        (lambda q: q + np.pi * np.eye(6)[5], Why.ORIENTATIONS_JOINT_ZERO, {}),
        (
            lambda q: q - [0, 0, 0, 0, 0, np.pi / 2],
            Why.ORIENTATIONS_JOINT_ZERO,
            {"add_rad": np.pi / 2},
        ),
    ],
)
def test_the_last_joint_turns_a_target_on_its_axis_and_does_not_move_it(
    ur3: Robot, change, why, values
):
    q = random_joint_values(ur3, 20, 1)
    T = ur3.poses(q)
    table = Measurements(
        ur3.joint_names, change(q), T[:, :3, 3], kinds=("pose",) * 20, rotations=T[:, :3, :3]
    )
    told = find_usual_mistake(
        ur3, Cell(target=read_only(np.zeros(3)), estimate_target=False), table
    )
    assert (told.why, told.values["joint"]) == (why, "wrist_3_joint")
    for name, value in values.items():
        assert told.values[name] == pytest.approx(value)
    assert told.values["error_rad"] < 0.05 < 1.0 < told.values["given_rad"]


# Senses of joints: each one reversed in turn is named, and one that did not move is said to be unknown


def senses_found(q, reverse=None):
    m = images.table(q, noise=0.1)
    joints = m.joints.copy()
    if reverse is not None:
        joints[:, reverse] *= -1.0
    return list(doubtful_senses(images.arm(), images.cell(), replace(m, joints=joints)))


def test_right_senses_are_not_doubted():
    assert senses_found(images.poses(12)) == []


@pytest.mark.slow
@pytest.mark.parametrize("joint", range(7))
def test_a_reversed_joint_is_named(joint):
    q = images.poses(12)
    q[:, joint] += 0.05  # none is about zero
    reasons = senses_found(q, joint)
    assert [reason.why for reason in reasons if reason.why is Why.SENSE_REVERSED]
    assert reasons[0].values["joint"] == images.arm().joint_names[joint]
    assert reasons[0].values["error_m"] < 0.5 * reasons[0].values["given_m"]


def test_the_sense_of_a_joint_that_stood_still_is_unknown():
    q = images.poses(12)
    q[:, 2] = 1e-4
    (reason,) = senses_found(q)
    assert reason.why is Why.SENSE_UNKNOWN
    assert reason.values["joints"] == images.arm().joint_names[2]
