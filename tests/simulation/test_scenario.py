"""Scenarios: what a cell is to be like, and cells with errors of their own out of it."""

from dataclasses import astuple

import numpy as np
import pytest

from calib.data.cell import Cell, Tracker, TrackerNoise
from calib.errors import CalibError
from calib.robot.ranges import column_ranges
from calib.simulation.scenario import (
    DEFAULT_TRACKER,
    FIELDS,
    Scenario,
    noise_of,
    read_scenario,
)
from calib.simulation.truth import Encoder, Outliers, sizes_of

TRACKER = Tracker(np.array([2.0, 1.0, 0.5]), noise=TrackerNoise(1e-5, 1e-6, 0.0))

CELL = Cell()


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


def test_sizes():
    said = (
        "length 0.5 mm, angle 2mrad,zero 0, gain 1e-3, eccentricity 0.1 deg, compliance 2e-5 rad/Nm"
    )
    found = sizes_of(CELL, said, named=False)
    assert tuple(found.values()) == pytest.approx((0.5e-3, 2e-3, 0.0, 1e-3, np.radians(0.1), 2e-5))
    assert sizes_of(CELL, " none ", named=False) is None
    assert sizes_of(CELL, None, named=True) is None
    assert sizes_of(CELL, None, named=False) == {}


def test_single_errors(ur3):
    pairs = ("a2=0.5 mm", "theta3 = -2 mrad", "elbow_joint.compliance=1e-5 rad/Nm", "d1=0")
    scenario = read_scenario(ur3, Cell(model="dh+compliance"), error=pairs)
    assert scenario.errors == (
        *(("a2", 0.5e-3), ("theta3", -2e-3), ("elbow_joint.compliance", 1e-5)),
        ("d1", 0.0),
    )
    assert scenario.sizes is None
    for wrong in ("a2", "teta2=1 mrad", "a2=1 mrad"):
        with pytest.raises(CalibError, match=r"--error|no parameter"):
            read_scenario(ur3, Cell(model="dh"), error=(wrong,))


@pytest.mark.parametrize(
    ("cell", "text", "noise"),
    [
        (CELL, "0.05 mm", TrackerNoise(5e-5, 0.0, 0.0)),
        (CELL, "15 um + 6 um/m", TrackerNoise(15e-6, 6e-6, 0.0)),
        (CELL, None, TrackerNoise()),
        (Cell(tracker=TRACKER), None, TRACKER.noise),
        (Cell(sigma=1e-4, tracker=TRACKER), None, TrackerNoise(1e-4, 0.0, 0.0)),
        *((CELL, text, None) for text in ("none", "0", "0 mm", "0 um + 0 um/m")),
    ],
)
def test_noise(cell, text, noise):
    found = noise_of(cell, text)
    assert (found and pytest.approx(astuple(found))) == (noise and astuple(noise))


def test_outliers():
    assert Outliers.parse("3", 1e-3) == Outliers(count=3, size=1e-3)
    assert Outliers.parse("2.5%", 1e-3) == Outliers(share=0.025, size=1e-3)
    for text in ("", "-1", "1.5", "many"):
        with pytest.raises(CalibError, match=r"[Oo]utliers"):
            Outliers.parse(text, 1e-3)


def test_every_key_of_the_table(ur3, tmp_path):
    path = tmp_path / "cell.toml"
    path.write_text(
        "[simulation]\nvisits = 3\nencoder_deg = 0.001\nencoder_mm = 0.01\n"
        "outlier_size_mm = 8\ndrift_mm = [0, 0, 0.1]\nmoved_row = 4\nmoved_mm = [1, 0, 0]\nmoved_target = 't'\n"
    )
    assert all(key in path.read_text() for key in FIELDS)
    made = read_scenario(ur3, Cell.read(path), path, outliers="2", target_error="2 mm")
    assert (made.target_error, made.visits) == (2e-3, 3)
    assert astuple(made.encoder) == pytest.approx(astuple(Encoder(np.radians(1e-3), 1e-5)))
    assert made.outliers == Outliers(count=2, size=8e-3)
    assert made.drift.tolist() == [0.0, 0.0, 1e-4]
    assert (made.moved.row, made.moved.by.tolist(), made.moved.target) == (4, [1e-3, 0, 0], "t")
    for wrong in ("drift_mm = 1", "visit = 2", "visits = 'two'"):
        path.write_text(f"[simulation]\n{wrong}\n")
        with pytest.raises(CalibError, match=r"in \[simulation\]"):
            read_scenario(ur3, CELL, path)
