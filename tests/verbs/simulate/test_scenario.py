"""Scenarios and the virtual cells drawn from them: without disturbances a table is the truth; each has its size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell, Tracker, TrackerNoise
from calib.data.measurements import Measurements
from calib.errors import ArgumentError, CalibError, ModelError
from calib.instruments.tracker import noise_of_lengths
from calib.result.calibrate import calibrate
from calib.robot.ranges import column_ranges, random_joint_values
from calib.verbs.simulate.disturbances import (
    Encoder,
    FrameStep,
    MovedTarget,
    Outliers,
    StandingTargets,
)
from calib.verbs.simulate.scenario import DEFAULT_TRACKER, Scenario, simulate
from calib.verbs.simulate.scenario_words import read_scenario
from calib.verbs.simulate.truth import draw_truth, tracker_pose
from tests.verbs.simulate.cells import changed, virtual

TRACKER = Tracker(np.array([2.0, 1.0, 0.5]), noise=TrackerNoise(1e-5, 1e-6, 0.0))

STATED = Cell(sigma={"m": 5e-5, "rad": 1e-3}, tracker=TRACKER, kind="pose")


def test_a_virtual_cell_in_one_line(ur3):
    text = repr(Scenario(ur3).draw(1))
    assert text.startswith("VirtualCell(Scenario('ur3'")
    assert len(text) <= 120


def test_each_seed_makes_another_robot_and_the_same_seed_the_same(ur3):
    scenario = Scenario(ur3)
    cells = [scenario.draw(seed) for seed in (1, 1, 2)]
    assert (cells[0].truth.x == cells[1].truth.x).all()
    assert not np.allclose(cells[0].truth.x, cells[2].truth.x)
    assert cells[0].truth.nominal is ur3


def test_the_tracker_stands_where_the_cell_says_or_at_its_frame_or_3_m_away(ur3):
    def of(cell: Cell):
        return Scenario(ur3, cell).tracker

    assert (of(Cell()) == DEFAULT_TRACKER).all()
    assert (of(Cell(tracker=TRACKER)) == TRACKER.position).all()
    assert of(Cell(estimate_frame=True)) is None
    assert of(Cell(T_frame_base=np.eye(4))) is None
    assert of(Cell(frames={"a": np.eye(4)})) is None


def test_random_poses_lie_inside_the_limits_or_the_cell_s_ranges(ur3):
    low, high = column_ranges(ur3).T
    scenario = Scenario(ur3)
    q = scenario.random_poses(500, 1)
    assert (q >= low).all()
    assert (q <= high).all()
    assert (np.ptp(q, axis=0) > 0.95 * (high - low)).all()
    assert (scenario.random_poses(20, 1) == q[:20]).all()
    assert not np.allclose(scenario.random_poses(20, 1, validation=True), q[:20])
    q = Scenario(ur3, Cell(ranges={"elbow_joint": (0.1, 0.2)})).random_poses(100, 1)
    assert ((q[:, 2] >= 0.1) & (q[:, 2] <= 0.2)).all()
    with pytest.raises(CalibError, match="'elbow'"):
        Scenario(ur3, Cell(ranges={"elbow": (0.1, 0.2)})).random_poses(3, 1)


MANY = "placement+gain+eccentricity+compliance"
NOISE = TrackerNoise(1e-4, 0.0, 0.0)


@pytest.fixture(scope="module")
def truth(ur3):
    return draw_truth(ur3, "placement", seed=1)


@pytest.fixture(scope="module")
def q(ur3):
    return random_joint_values(ur3, 40, seed=7)


@pytest.fixture(scope="module")
def plain(truth):
    """A cell without any disturbance."""
    return virtual(truth, noise=None)


SETS = ("estimate",) * 30 + ("validate",) * 10


def test_without_disturbances_the_table_is_the_truth(plain, truth, q):
    made = plain.measure(q, sets=SETS)
    table = made.measurements
    assert (table.points == truth.points(q)).all()
    assert (table.joints == q).all()
    assert table.sets == SETS
    assert (table.rows, set(table.targets), set(table.groups)) == (
        tuple(range(1, 41)),
        {"target"},
        {""},
    )
    assert (made.points == truth.points(q)).all()
    assert (made.sigma == 0.0).all()
    assert made.outlier_rows == ()
    assert not made.moved.any()


@pytest.mark.parametrize(
    "model", ["hayati", "zeros", "dh+gain+compliance", pytest.param(MANY, marks=pytest.mark.slow)]
)
def test_a_fit_of_the_same_model_finds_the_truth(ur3, model):
    cell = Cell(estimate_frame=True)
    true = draw_truth(ur3, model, seed=2, cell=cell)
    q = random_joint_values(ur3, 60, seed=1)
    made = virtual(true, noise=None).measure(q)
    # Priors pull a little, where there is no noise to weigh them against.
    free = replace(cell, priors=cell.priors.with_source("off"))
    found = calibrate(ur3, made.measurements, cell=free, model=model, validate=False)
    unseen = random_joint_values(ur3, 50, seed=9)
    assert found.predict(unseen) == pytest.approx(true.points(unseen), abs=1e-9)
    found = calibrate(ur3, made.measurements, cell=cell, model=model, validate=False)
    assert found.predict(q) == pytest.approx(made.points, abs=1e-7)


@pytest.mark.parametrize("kind", ["point", "pose", "distance", "pair"])
def test_every_kind_is_fitted_back_from_its_file(ur3, tmp_path, kind):
    names = {"a": (0.05, 0.05, 0.05), "b": (-0.06, 0.03, 0.1)}
    frames = {
        "left": tracker_pose((2, 1, 0.3), np.random.default_rng(1)),
        "right": tracker_pose((2, -1, 0.3), np.random.default_rng(2)),
    }
    cell = Cell(targets=names, frames=frames, estimate_target=True)
    true = draw_truth(ur3, "placement", seed=3, cell=cell)
    q = random_joint_values(ur3, 60, seed=3)
    made = virtual(true, kind=kind, noise=None).measure(q)
    made.measurements.write(tmp_path / "table.csv")
    table = Measurements.read(tmp_path / "table.csv", ur3.joint_names, ur3.joint_types)
    assert set(table.kinds) == {kind}
    assert len(table) == 120
    free = replace(cell, priors=cell.priors.with_source("off"))
    found = calibrate(ur3, table, cell=free, model="placement", validate=False)
    unseen = random_joint_values(ur3, 30, seed=9)
    for name in names:
        for group in frames:
            ours = found.predict(unseen, target=name, group=group)
            theirs = true.points(unseen, name, group)
            # Lengths say nothing of where the base stands, or little: they themselves must be right.
            if kind == "pair":
                ours, theirs = (np.linalg.norm(p[1:] - p[:-1], axis=1) for p in (ours, theirs))
            elif kind == "distance":
                ours, theirs = (np.linalg.norm(p, axis=1) for p in (ours, theirs))
            assert ours == pytest.approx(theirs, abs=1e-8)


def test_the_noise_of_a_coordinate_has_its_sigma(truth, q):
    cell = virtual(truth, noise=NOISE, visits=200)
    made = cell.measure(q, 1)
    off = made.measurements.points - made.points
    count = off.size
    assert count == 24_000
    # The standard deviation of a sample of n is known to 1 / sqrt(2 n): four times that, and of the mean.
    assert off.std() == pytest.approx(1e-4, rel=4 / np.sqrt(2 * count))
    assert abs(off.mean()) < 4e-4 / np.sqrt(count)
    assert (made.sigma == 1e-4).all()
    # normal, and of rows and coordinates on their own
    assert (np.abs(off) > 2e-4).mean() == pytest.approx(0.0455, abs=0.006)
    assert np.corrcoef(off.T) == pytest.approx(np.eye(3), abs=0.05)
    assert np.corrcoef(off[:-1, 0], off[1:, 0])[0, 1] == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize("away", [1.0, 3.0, 20.0])
def test_noise_grows_with_the_distance_from_the_tracker(truth, q, away):
    noise = TrackerNoise()
    tracker = np.array([away, 0.0, 0.0])
    made = virtual(truth, noise=noise, tracker=tracker, visits=100).measure(q, 2)
    distance = np.linalg.norm(truth.points(q) - tracker, axis=1)
    assert made.sigma[:40] == pytest.approx(noise.std(distance))
    scaled = (made.measurements.points - made.points) / made.sigma[:, None]
    assert scaled.std() == pytest.approx(1.0, rel=4 / np.sqrt(2 * scaled.size))


def test_orientations_are_turned_by_their_noise(truth, q):
    made = virtual(truth, kind="pose", noise=None, sigma={"rad": 1e-3}, visits=100).measure(q, 1)
    turned = made.measurements.rotations @ made.T_frame_target[:, :3, :3].transpose(0, 2, 1)
    angles = Rotation.from_matrix(turned).as_rotvec()
    assert angles.std(axis=0) == pytest.approx(1e-3, rel=0.06)
    assert (made.measurements.points == made.points).all()


@pytest.mark.parametrize("kind", ["distance", "pair"])
def test_the_noise_of_a_length(ur3, q, kind):
    truth = draw_truth(ur3, cell=Cell(estimate_frame=True))
    made = virtual(truth, kind=kind, noise=TrackerNoise(5e-5, 1e-5, 4e-5), visits=300).measure(q, 1)
    if kind == "pair":
        rows = made.measurements.pair_rows
        true = np.linalg.norm(made.points[rows[:, 0]] - made.points[rows[:, 1]], axis=1)
        off = made.measurements.distances[rows[:, 0]] - true
        assert (
            made.measurements.distances[rows[:, 0]] == made.measurements.distances[rows[:, 1]]
        ).all()
        sigma = np.hypot(5e-5 + 1e-5 * true, np.sqrt(2) * 4e-5)
        assert made.sigma[rows[:, 0]] == pytest.approx(sigma)
    else:
        true = np.linalg.norm(made.points, axis=1)
        off = made.measurements.distances - true
        sigma = np.hypot(5e-5 + 1e-5 * true, 4e-5)
        assert made.sigma == pytest.approx(sigma)
    assert (off / sigma).std() == pytest.approx(1.0, rel=4 / np.sqrt(2 * len(off)))


def test_the_table_holds_what_the_encoders_read_and_the_robot_stands_elsewhere(truth, q):
    step = np.radians(0.01)
    made = virtual(truth, noise=None, encoder=Encoder(angle=step)).measure(
        np.round(q / step) * step, 1
    )
    off = made.measurements.joints - made.q
    assert 0.45 * step < np.abs(off).max() <= 0.5 * step * (1 + 1e-9)
    assert off.std() == pytest.approx(step / np.sqrt(12), rel=0.15)
    assert (made.points == truth.points(made.q)).all()
    shown = np.degrees(made.measurements.joints) / 0.01
    assert shown == pytest.approx(np.round(shown), abs=1e-6)


def test_outliers_leave_all_else_as_it_was(truth, q):
    cell = virtual(truth, outliers=Outliers(count=4, size=7e-3))
    with_them, without = cell.measure(q, 3, SETS), changed(cell, outliers=None).measure(q, 3, SETS)
    apart = np.linalg.norm(with_them.measurements.points - without.measurements.points, axis=1)
    hit = np.flatnonzero(apart)
    assert tuple(hit + 1) == with_them.outlier_rows
    assert apart[hit] == pytest.approx(7e-3)
    assert len(hit) == 4
    assert hit.max() < 30  # rows to validate with stay clean
    assert (with_them.measurements.points[30:] == without.measurements.points[30:]).all()


def test_a_moved_target_is_an_exact_step(plain, truth, q):
    by = np.array([0.0, 3e-4, -4e-4])
    made = changed(plain, moved=MovedTarget(26, by)).measure(q)
    R = truth.tip_poses(q)[:, :3, :3]
    step = made.measurements.points - plain.measure(q).measurements.points
    assert (step[:25] == 0.0).all()
    assert step[25:] == pytest.approx(R[25:] @ by, abs=1e-15)
    assert made.moved.tolist() == [False] * 25 + [True] * 15
    assert (made.points == made.measurements.points).all()


def test_set_ups_are_dealt_out_in_turn_and_tours_repeat(ur3, q):
    frames = {
        n: tracker_pose((2, y, 0), np.random.default_rng(1))
        for n, y in (("a", 1), ("b", -1), ("c", 0))
    }
    truth = draw_truth(ur3, cell=Cell(frames=frames))
    table = virtual(truth, noise=None, visits=2).measure(q[:7]).measurements
    assert table.groups == tuple("abcabca" * 2)
    assert (table.joints[:7] == table.joints[7:]).all()
    for name in frames:
        rows = [i for i, group in enumerate(table.groups) if group == name]
        assert table.points[rows] == pytest.approx(truth.points(table.joints[rows], group=name))


# Noise of the cell, and values that a scenario cannot be made with


@pytest.mark.parametrize("cell", [STATED, Cell(tracker=TRACKER), Cell()])
def test_a_scenario_has_the_noise_of_its_cell(ur3, cell):
    scenario = Scenario(ur3, cell=cell)
    assert scenario.noise == read_scenario(ur3, cell).noise
    assert scenario.sigma == {unit: std for unit, std in cell.sigma.items() if unit == "rad"}


def test_what_a_scenario_states_itself_comes_before_the_cell_s(ur3):
    own = Scenario(ur3, cell=STATED, noise=TrackerNoise(), sigma={"rad": 2e-3})
    assert own.noise == TrackerNoise()
    assert own.sigma == {"rad": 2e-3}
    quiet = Scenario(ur3, cell=STATED, noise=None)
    assert quiet.noise is None
    assert not quiet.sigma


def test_a_scenario_with_another_cell_has_that_cell_s_noise_unless_one_was_stated(ur3):
    assert replace(Scenario(ur3), cell=STATED).noise == noise_of_lengths(STATED)
    own = Scenario(ur3, noise=TrackerNoise(1e-4))
    assert replace(own, cell=STATED).noise == TrackerNoise(1e-4)


def test_the_rows_have_the_stated_noise(ur3):
    cell = Scenario(ur3, cell=Cell(sigma={"m": 2e-4})).draw(1)
    made = cell.measure(cell.scenario.random_poses(500, 1), 1)
    off = made.measurements.points - made.points
    assert (made.sigma == 2e-4).all()
    assert off.std() == pytest.approx(2e-4, rel=4 / np.sqrt(2 * off.size))


@pytest.mark.parametrize(
    ("values", "error"),
    [
        ({"model": 3}, ArgumentError),
        ({"noise": 1e-4}, ArgumentError),
        ({"target_error": -1.0}, ModelError),
        ({"visits": 0}, ModelError),
        ({"sizes": {"nothing": 1.0}}, ModelError),
        ({"sizes": {"length": -1.0}}, ModelError),
    ],
)
def test_each_is_refused_by_its_name(ur3, values, error):
    with pytest.raises(CalibError) as caught:
        Scenario(ur3, **values)
    assert type(caught.value) is error
    (name,) = values
    assert name in str(caught.value) or "nothing" in str(caught.value)


def test_the_moves_before_poses_may_be_stated(ur3):
    """Lost motion is that of the stated moves, and the table knows them; poses that are drawn besides follow."""
    scenario = Scenario(
        ur3,
        Cell(target=[0.05, 0.07, 0.03], T_frame_base=np.eye(4)),
        model="dh+lost_motion",
        sizes=None,
        errors=(("elbow_joint.lost_motion", 1e-3),),
        target_error=0.0,
        noise=None,
    )
    q = scenario.random_poses(4, 3)
    moves = np.array([[0.1] * 6, [-0.1] * 6] * 2)
    made = simulate(scenario, validation=2, poses=q, moves=moves)
    table = made.measurements
    np.testing.assert_allclose(table.moves[:4], moves)
    np.testing.assert_allclose(table.moves[5], table.joints[5] - table.joints[4])
    # A joint that rose stops short.
    elbow = ur3.joint_names.index("elbow_joint")
    stopped = q.copy()
    stopped[:, elbow] -= [1e-3, -1e-3, 1e-3, -1e-3]
    expected = ur3.poses(stopped) @ made.truth.T_tip_target[0]
    np.testing.assert_allclose(made.points[:4], expected[:, :3, 3], atol=1e-9)
    with pytest.raises(ModelError, match="one row for each"):
        simulate(scenario, poses=q, moves=moves[:3])


def test_targets_that_stand_still_drift_and_step_with_the_frame(ur3):
    by, drift = np.array([0.0, 2e-4, 0.0]), np.array([1e-3, 0.0, 0.0])
    still = Scenario(ur3, standing=StandingTargets(2, 4), noise=None)
    plain = simulate(still, 10, 0, seed=3)
    assert plain.measurements.references.sequence == (
        *(11, 12, 1, 2, 3, 4),
        *(13, 14, 5, 6, 7, 8),
        *(15, 16, 9, 10, 17, 18),
    )
    np.testing.assert_allclose(plain.measurements.references.points[::2] - plain.standing[0], 0.0)
    moved = simulate(replace(still, drift=drift, step=FrameStep(5, by)), 10, 0, seed=3)
    np.testing.assert_array_equal(moved.standing, plain.standing)
    of_poses = moved.measurements.points - plain.measurements.points
    share = np.arange(10)[:, None] / 9.0
    stepped = np.arange(10)[:, None] >= 4
    np.testing.assert_allclose(of_poses, share * drift + stepped * by, atol=1e-15)
    readings = moved.measurements.references.points - plain.measurements.references.points
    # Before row 1, between rows 4 and 5, between 8 and 9, and after row 10; the frame steps at row 5.
    expected = [[0.0, 0.0], [3.5 / 9.0, 0.0], [7.5 / 9.0, 1.0], [1.0, 1.0]]
    expected = np.array(expected) @ np.array([drift, by])
    np.testing.assert_allclose(readings, np.repeat(expected, 2, axis=0), atol=1e-15)


def test_targets_that_stand_still_are_refused_where_none_can_be(ur3):
    with pytest.raises(CalibError, match="distance"):
        Scenario(ur3, Cell(kind="distance"), standing=StandingTargets(1))
    stations = Cell(frames={"a": np.eye(4), "b": np.eye(4)})
    with pytest.raises(CalibError, match="one station"):
        simulate(Scenario(ur3, stations, standing=StandingTargets(1)), 4, 0)
    with pytest.raises(CalibError, match="rows 1 to 4"):
        simulate(Scenario(ur3, step=FrameStep(5, np.zeros(3))), 4, 0)
