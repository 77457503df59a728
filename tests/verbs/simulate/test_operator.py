"""The virtual operator: what it reads is the truth by Pinocchio alone, and its mistakes are what they say they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from calib.basics.arrays import rigid_inverse
from calib.data.cell import Cell
from calib.errors import ArgumentError, CalibError, ModelError
from calib.robot.ranges import column_limits, random_joint_values
from calib.robot.robot import Robot
from calib.verbs.simulate.disturbances import Outliers
from calib.verbs.simulate.operator import (
    BASE_MOVED,
    GROSS,
    MISSED,
    MISTAKES,
    NOT_THERE,
    REPEATED,
    SWAPPED,
    TARGET_MOVED,
    USUAL_MISTAKES,
    Mistakes,
    Operator,
)
from calib.verbs.simulate.scenario import Scenario, VirtualCell

MM = 1e-3
DEG = np.pi / 180.0


def cell_of(robot: Robot, kind: str = "point", *, noise: bool = False, **more) -> VirtualCell:
    """A cell whose frame is 3 m away, without noise if it is not asked for."""
    cell = Cell(kind=kind, estimate_frame=True, **more)
    scenario = Scenario(robot, cell, sigma={"rad": 1e-4}) if noise else None
    return (scenario or Scenario(robot, cell, noise=None)).draw(4)


def stops_of(robot: Robot, count: int) -> np.ndarray:
    """Poses without any wish."""
    return random_joint_values(robot, count, 11)


def with_mistakes(virtual: VirtualCell, *, seed: int = 5, **at: str) -> Operator:
    """An operator with mistakes at given readings, such as ``r3="gross"``."""
    planned = {int(name[1:]): code for name, code in at.items()}
    return Operator.of(virtual, seed, Mistakes(at=planned))


def turn(R: np.ndarray, R_other: np.ndarray) -> float:
    """Angle between two orientations [rad]."""
    return float(np.linalg.norm(pin.log3(R.T @ R_other)))


@pytest.fixture(scope="module")
def points(ur3):
    return cell_of(ur3)


@pytest.fixture(scope="module")
def poses(ur3):
    return cell_of(ur3, "pose")


@pytest.fixture(scope="module")
def several(ur3):
    targets = {"a": np.array([0.05, 0.0, 0.05]), "b": np.array([-0.04, 0.07, 0.1])}
    return cell_of(ur3, "pose", targets=targets)


@pytest.fixture(scope="module")
def pictures():
    arm = Robot.load("ur5", base="tool0", tip="base_link")
    return Scenario(arm, Cell(kind="pixel"), noise=None).draw(7)


@pytest.fixture(scope="module")
def views(pictures):
    return pictures.poses(8, seed=1)


# What is read


def test_a_reading_is_the_truth_by_pinocchio_alone(points, poses, ur3, tmp_path):
    points.truth.write_urdf(tmp_path / "true.urdf")
    model = pin.buildModelFromUrdf(str(tmp_path / "true.urdf"))
    data = model.createData()
    base, tip = (model.getFrameId(name) for name in (ur3.base, ur3.tip))
    for virtual in (points, poses):
        operator = Operator.of(virtual, 1)
        for q in stops_of(ur3, 3):
            reading = operator.measure(q)
            configuration = pin.neutral(model)
            for name, value in zip(ur3.joint_names, q, strict=True):
                configuration[model.joints[model.getJointId(name)].idx_q] = value
            pin.framesForwardKinematics(model, data, configuration)
            T_base_tip = (data.oMf[base].inverse() * data.oMf[tip]).homogeneous
            T = virtual.truth.T_frame_base[0] @ T_base_tip @ virtual.truth.T_tip_target[0]
            assert reading.mistake is None
            assert reading.joints == pytest.approx(q, abs=1e-12)
            assert reading.readings.points[0] == pytest.approx(T[:3, 3], abs=1e-9)
            assert reading.T_frame_target[0] == pytest.approx(T, abs=1e-9)
            if reading.readings.rotations is not None:
                assert reading.readings.rotations[0] == pytest.approx(T[:3, :3], abs=1e-9)
    assert poses.truth.x == pytest.approx(points.truth.x)


def test_a_picture_shows_the_board_where_it_is(pictures, views):
    operator = Operator.of(pictures, 1)
    together = pictures.measure(views)
    for k, q in enumerate(views):
        reading = operator.measure(q)
        mine = np.array(together.measurements.images) == f"picture_{k + 1:02d}.png"
        assert set(reading.readings.images) == {f"picture_{k + 1:03d}.png"}
        for name in ("u", "v"):
            expected = together.measurements.reading(name)[mine]
            assert reading.readings.reading(name) == pytest.approx(expected, abs=1e-9)


def test_each_reading_has_noise_of_its_own_by_seed_and_number_alone(ur3):
    virtual = cell_of(ur3, noise=True)
    q = stops_of(ur3, 2)
    exact = virtual.truth.points(q[0])
    first = Operator.of(virtual, 8)
    one = [first.measure(q[0]).readings.points for _ in range(400)]
    second = Operator.of(virtual, 8)
    other = [second.measure(q[k % 2]).readings.points for k in range(5)]
    assert (one[0] == other[0]).all()
    assert (one[4] == other[4]).all()
    assert not np.allclose(one[0], Operator.of(virtual, 9).measure(q[0]).readings.points)
    # A distance of about 3 m and the robot's own repeatability.
    spread = np.std(np.concatenate(one) - exact, axis=0)
    expected = np.hypot(15e-6 + 6e-6 * np.linalg.norm(exact), 20e-6)
    assert spread == pytest.approx(np.full(3, expected), rel=0.15)


def test_a_joint_with_lost_motion_remembers_where_it_came_from(ur3):
    cell = Cell(estimate_frame=True, model="dh+lost_motion")
    virtual = Scenario(ur3, cell, model="dh+lost_motion", noise=None).draw(4)
    q = stops_of(ur3, 3)
    operator = Operator.of(virtual, 1)
    read = [operator.measure(pose).readings.points[0] for pose in q]
    assert np.array(read) == pytest.approx(virtual.measure(q).measurements.points, abs=1e-12)
    operator = Operator.of(virtual, 1)
    operator.measure(q[0])
    from_below = operator.measure(q[1], via=q[1] - 0.1).readings.points
    from_above = operator.measure(q[1], via=q[1] + 0.1).readings.points
    assert np.linalg.norm(from_below - from_above) > 1e-5


# Mistakes


def test_gross_readings_are_off_by_their_size(several, ur3):
    q = stops_of(ur3, 1)[0]
    lengths, angles = [], []
    for seed in range(60):
        reading = with_mistakes(several, seed=seed, r1=GROSS).measure(q)
        right = Operator.of(several, seed).measure(q)
        rows = reading.readings
        row = rows.targets.index(reading.mistake.name)
        off = np.linalg.norm(rows.points - right.readings.points, axis=1)
        turned = [
            turn(*both) for both in zip(rows.rotations, right.readings.rotations, strict=True)
        ]
        assert off[row] == pytest.approx(reading.mistake.size, abs=1e-9)
        assert turned[row] == pytest.approx(reading.mistake.turn, abs=1e-7)
        assert off[1 - row] == 0.0
        assert turned[1 - row] < 1e-7
        (lengths if reading.mistake.size else angles).append(off[row] or turned[row])
    assert MM <= min(lengths) < 3 * MM
    assert 20 * MM < max(lengths) <= 50 * MM
    assert 0.3 * DEG <= min(angles) < 1.0 * DEG
    assert 3.0 * DEG < max(angles) <= 5.0 * DEG


def test_two_targets_are_taken_for_each_other(several, ur3):
    q = stops_of(ur3, 1)[0]
    reading = with_mistakes(several, r1=SWAPPED).measure(q)
    right = Operator.of(several, 5).measure(q).readings
    assert reading.readings.targets == right.targets
    assert (reading.readings.points == right.points[::-1]).all()
    assert (reading.readings.rotations == right.rotations[::-1]).all()
    assert reading.mistake.size == pytest.approx(np.linalg.norm(np.diff(right.points, axis=0)))


def test_of_one_target_axes_are_swapped_or_joint_values_are_those_before(points, ur3):
    q = stops_of(ur3, 2)
    names = set()
    for seed in range(12):
        operator = with_mistakes(points, seed=seed, r2=SWAPPED)
        operator.measure(q[0])
        reading = operator.measure(q[1])
        right = points.truth.points(q[1])[0]
        names.add(reading.mistake.name)
        if reading.mistake.name == "x, y":
            assert reading.readings.points[0] == pytest.approx(right[[1, 0, 2]], abs=1e-9)
            assert reading.joints == pytest.approx(q[1])
            assert reading.mistake.size == pytest.approx(np.sqrt(2) * abs(right[0] - right[1]))
        else:
            assert reading.readings.points[0] == pytest.approx(right, abs=1e-9)
            assert reading.joints == pytest.approx(q[0])
            away = np.linalg.norm(right - points.truth.points(q[0])[0])
            assert reading.mistake.size == pytest.approx(away)
        assert reading.readings.joints[0] == pytest.approx(reading.joints)
    assert names == {"x, y", "joints"}


def test_a_reading_is_repeated_exactly_or_with_new_noise(ur3):
    virtual = cell_of(ur3, noise=True)
    q = stops_of(ur3, 2)
    exact = set()
    for seed in range(12):
        operator = with_mistakes(virtual, seed=seed, r2=REPEATED)
        before, reading = operator.measure(q[0]), operator.measure(q[1])
        difference = np.linalg.norm(before.readings.points - reading.readings.points)
        assert reading.joints == pytest.approx(q[1])
        assert difference < 1e-3
        assert (difference == 0.0) == (reading.mistake.name == "exact")
        away = np.linalg.norm(virtual.truth.points(q[1]) - virtual.truth.points(q[0]))
        assert reading.mistake.size == pytest.approx(away, rel=1e-6)
        exact.add(difference == 0.0)
    assert exact == {True, False}


def test_readings_are_late_until_somebody_notices(points, ur3):
    q = stops_of(ur3, 6)
    operator = with_mistakes(points, r3=MISSED, r4=GROSS)
    stands = {2: 1, 3: 2, 4: 3}  # the reading at the third stop is that of the second, and so on
    for k in range(5):
        reading = operator.measure(q[k])
        expected = points.truth.points(q[stands.get(k, k)])[0]
        assert reading.readings.points[0] == pytest.approx(expected, abs=1e-9)
        assert reading.joints == pytest.approx(q[k])
        right = points.truth.points(q[k])[0]
        assert reading.T_frame_target[0, :3, 3] == pytest.approx(right, abs=1e-9)
        wrong = [(mistake.code, mistake.since) for mistake in reading.mistakes]
        assert wrong == ([(MISSED, 3)] if k >= 2 else [])
    for k, again in ((4, True), (5, False)):
        reading = operator.measure(q[k], again=again)
        assert reading.mistakes == ()
        assert reading.readings.points[0] == pytest.approx(points.truth.points(q[k])[0], abs=1e-9)


def test_one_joint_is_not_there(points, ur3):
    low, high = column_limits(ur3).T
    q = stops_of(ur3, 1)[0]
    sizes = []
    for seed in range(60):
        operator = with_mistakes(points, seed=seed, r1=NOT_THERE)
        reading = operator.measure(q)
        joint = ur3.joint_names.index(reading.mistake.name)
        assert reading.joints == pytest.approx(q)
        # Which angle that joint has is what the next pose of the way begins with.
        measured = reading.readings.points[0]
        angles = np.linspace(-20.0, 20.0, 4001) * DEG
        tried = np.tile(q, (len(angles), 1))
        tried[:, joint] += angles
        away = np.linalg.norm(points.truth.points(tried) - measured, axis=1)
        best = int(away.argmin())
        assert away[best] < 2e-4
        assert (low <= tried[best]).all()
        assert (tried[best] <= high).all()
        size = np.linalg.norm(points.truth.points(q)[0] - measured)
        assert reading.mistake.size == pytest.approx(size, abs=1e-9)
        sizes.append(abs(angles[best]))
    assert min(sizes) >= 0.95 * DEG
    assert max(sizes) <= 20.0 * DEG


def test_a_knocked_target_stays_knocked_also_when_it_is_measured_again(several, ur3):
    q = stops_of(ur3, 5)
    for seed in range(8):
        operator = with_mistakes(several, seed=seed, r3=TARGET_MOVED)
        moves = []
        for k, again in ((0, False), (1, False), (2, False), (2, True), (3, False), (4, False)):
            reading = operator.measure(q[k], again=again)
            rows = reading.readings
            tip = rigid_inverse(several.truth.T_frame_base[0] @ several.truth.tip_poses(q[k])[0])
            of_rows = []
            for t in range(2):
                T = np.eye(4)
                T[:3, :3], T[:3, 3] = rows.rotations[t], rows.points[t]
                T_tip_target, stated = tip @ T, several.truth.T_tip_target[t]
                shift = np.linalg.norm(T_tip_target[:3, 3] - stated[:3, 3])
                of_rows.append((shift, turn(T_tip_target[:3, :3], stated[:3, :3])))
            moves.append(of_rows)
        moves = np.array(moves)
        assert moves[:2] == pytest.approx(np.zeros((2, 2, 2)), abs=1e-7)
        (knocked,) = operator.knocked
        t = several.truth.targets.index(knocked.name)
        assert (knocked.code, knocked.since) == (TARGET_MOVED, 3)
        assert moves[2:, t] == pytest.approx(
            np.tile((knocked.size, knocked.turn), (4, 1)), abs=1e-7
        )
        assert moves[2:, 1 - t] == pytest.approx(np.zeros((4, 2)), abs=1e-7)
        assert 0.3 * MM <= knocked.size <= 5 * MM
        assert 0.0 < knocked.turn <= 2.0 * DEG
        assert reading.mistakes == (knocked,)
        assert (operator.virtual.truth.T_tip_target == several.truth.T_tip_target).all()


def test_a_moved_base_moves_all_alike_and_its_turn_is_about_base_or_tracker(poses, ur3):
    q = stops_of(ur3, 4)
    names = set()
    for seed in range(12):
        operator = with_mistakes(poses, seed=seed, r2=BASE_MOVED)
        motions = []
        for pose in q:
            rows = operator.measure(pose).readings
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = rows.rotations[0], rows.points[0]
            motions.append(T @ rigid_inverse(poses.truth.poses(pose)[0]))
        (knocked,) = operator.knocked
        names.add(knocked.name)
        motion = motions[1]
        assert motions[0] == pytest.approx(np.eye(4), abs=1e-9)
        assert np.array(motions[2:]) == pytest.approx(np.array([motion] * 2), abs=1e-9)
        # The origin of the frame is the tracker.
        T_frame_base = poses.truth.T_frame_base[0]
        origin = T_frame_base if knocked.name == "base" else np.eye(4)
        shift = np.linalg.norm((motion @ origin - origin)[:3, 3])
        assert shift == pytest.approx(knocked.size, abs=1e-9)
        assert turn(np.eye(3), motion[:3, :3]) == pytest.approx(knocked.turn, abs=1e-7)
        assert 0.3 * MM <= knocked.size <= 5 * MM
        assert knocked.turn <= 0.5 * DEG
    assert names == {"base", "instrument"}


def test_in_a_known_frame_the_tracker_turns_about_where_it_stands(ur3):
    virtual = Scenario(ur3, Cell(), noise=None).draw(4)
    q = stops_of(ur3, 4)
    for seed in range(12):
        operator = with_mistakes(virtual, seed=seed, r2=BASE_MOVED)
        operator.measure(q[0])
        operator.measure(q[1])
        (knocked,) = operator.knocked
        centre = np.zeros(3) if knocked.name == "base" else virtual.scenario.tracker
        motion = operator.now.truth.T_frame_base[0]
        moved = motion[:3, :3] @ centre + motion[:3, 3] - centre
        assert np.linalg.norm(moved) == pytest.approx(knocked.size, abs=1e-9)


@pytest.mark.parametrize("code", MISTAKES)
def test_mistakes_with_pictures(pictures, views, code):
    operator = with_mistakes(pictures, r3=code)
    right = Operator.of(pictures, 5)
    for k, q in enumerate(views[:4]):
        reading, expected = operator.measure(q), right.measure(q)
        where = reading.readings
        assert set(where.images) == {f"picture_{k + 1:03d}.png"}
        assert (where.joints == reading.joints).all()
        if k < 2:
            assert reading.mistake is None
        if k == 2:
            assert reading.mistake.code == code
            assert reading.mistake.size > 1e-5
            assert reading.mistake.turn > 1e-5
            same = where.corners == expected.readings.corners and np.allclose(
                where.reading("u"), expected.readings.reading("u"), atol=0.1
            )
            assert same == (code == SWAPPED)  # the joint values are wrong, not the picture
    stays = code in (MISSED, TARGET_MOVED, BASE_MOVED)
    assert bool(reading.mistakes) == stays


def test_measured_again_all_is_right_but_what_was_knocked(points, ur3):
    q = stops_of(ur3, 3)
    for code in MISTAKES:
        operator = with_mistakes(points, r2=code)
        operator.measure(q[0])
        assert operator.measure(q[1]).mistake.code == code
        again = operator.measure(q[1], again=True)
        is_knocked = code in (TARGET_MOVED, BASE_MOVED)
        assert (again.mistake is not None) == is_knocked
        right = points.truth.points(q[1])
        assert np.allclose(again.readings.points, right, atol=1e-7) != is_knocked


def test_mistakes_are_as_often_as_they_say(points, ur3):
    q = stops_of(ur3, 50)
    codes = []
    for seed in range(25):
        mistakes = replace(USUAL_MISTAKES, missed=0.0)
        operator = Operator.of(points, seed, mistakes)
        for k, pose in enumerate(q[:30]):
            reading = operator.measure(pose)
            codes += [mistake.code for mistake in reading.mistakes if mistake.since == k + 1]
    for code in MISTAKES:
        expected = 750 * getattr(mistakes, code)
        assert abs(codes.count(code) - expected) <= 4.0 * np.sqrt(expected) + 3.0


def test_what_cannot_go_wrong_at_the_first_stop_is_right(points, ur3):
    q = stops_of(ur3, 1)[0]
    for code in (REPEATED, MISSED, TARGET_MOVED, BASE_MOVED):
        operator = with_mistakes(points, r1=code)
        assert operator.measure(q).mistake is None
        assert operator.knocked == ()


def test_who_is_late_has_caught_up_if_the_same_pose_is_proposed_once_more(points, ur3):
    q = stops_of(ur3, 3)
    operator = with_mistakes(points, r2=MISSED)
    for pose, code in ((q[0], None), (q[1], MISSED), (q[1], None), (q[2], None)):
        mistake = operator.measure(pose).mistake
        assert (mistake and mistake.code) == code


# Refusals


def test_what_the_operator_refuses(ur3, points):
    for kind in ("distance", "pair"):
        with pytest.raises(CalibError, match=kind):
            Operator.of(Scenario(ur3, Cell(kind=kind)).draw(1), 1)
    disturbed = Scenario(ur3, outliers=Outliers(count=1)).draw(1)
    with pytest.raises(CalibError, match="outliers"):
        Operator.of(disturbed, 1)
    with pytest.raises(CalibError, match="seed"):
        Operator.of(points, -1)
    with pytest.raises(ModelError, match="6 joints"):
        Operator.of(points, 1).measure(np.zeros(5))
    with pytest.raises(CalibError, match="one at a time"):
        Operator.of(points, 1).measure(np.zeros((2, 6)))
    with pytest.raises(ModelError):
        Mistakes(gross=1.5)
    with pytest.raises(ArgumentError):
        Mistakes(gross="often")
    with pytest.raises(CalibError, match="add up"):
        Mistakes(gross=0.6, missed=0.6)
    with pytest.raises(CalibError, match="tipsy"):
        Mistakes(at={3: "tipsy"})


def test_without_a_board_in_sight_nothing_is_read_and_nothing_changes(pictures, views):
    operator = with_mistakes(pictures, r2=TARGET_MOVED)
    operator.measure(views[0])
    away = views[0].copy()
    away[-3:] += (1.5, 1.5, 0.0)
    with pytest.raises(CalibError, match="corner"):
        operator.measure(away)
    assert operator.knocked == ()
    assert operator.measure(views[1]).mistakes == ()
