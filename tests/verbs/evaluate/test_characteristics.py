"""Distance accuracy, approaches and drift by ISO 9283, against NumPy on the rows themselves."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.evaluate.accuracy import accuracy
from calib.verbs.evaluate.characteristics import DRIFT_REPEATS, Characteristic, characteristics
from calib.verbs.evaluate.evaluation import evaluate

KNOWN = Cell(target=(0.0, 0.0, 0.0), estimate_target=False)

POSES, REPEATS = 4, 30


def table(robot: Robot, errors: np.ndarray, **words: tuple[str, ...]) -> Measurements:
    """Poses in turn, with these errors [m] of shape (poses, repeats, 3): cycles of one repeat of each."""
    count, repeats, _ = errors.shape
    q = np.tile(random_joint_values(robot, count, 3), (repeats, 1))
    points = robot.poses(q)[:, :3, 3] + errors.transpose(1, 0, 2).reshape(-1, 3)
    return Measurements(robot.joint_names, q, points, **words)


def found(robot: Robot, m: Measurements) -> dict[tuple[str, str], Characteristic]:
    evaluation = evaluate(robot, m, KNOWN)
    return {(c.symbol, c.unit): c for c in characteristics(evaluation, accuracy(evaluation))}


@pytest.fixture(scope="module")
def errors() -> np.ndarray:
    random = np.random.default_rng(5)
    own = random.normal(scale=3e-4, size=(POSES, 1, 3))
    drift = np.linspace(0.0, 2e-4, REPEATS)[None, :, None]
    return own + drift + random.normal(scale=2e-5, size=(POSES, REPEATS, 3))


def test_distances_are_those_of_the_points(ur3: Robot, errors: np.ndarray):
    m = table(ur3, errors)
    values = found(ur3, m)
    measured = m.points.reshape(REPEATS, POSES, 3)
    commanded = ur3.poses(m.joints[:POSES])[:, :3, 3]
    ad, rd = {}, {}
    for i, k in combinations(range(POSES), 2):
        distances = np.linalg.norm(measured[:, i] - measured[:, k], axis=1)
        ad[i + 1, k + 1] = abs(distances.mean() - np.linalg.norm(commanded[i] - commanded[k]))
        rd[i + 1, k + 1] = 3.0 * distances.std(ddof=1)
    for symbol, expected in (("AD", ad), ("RD", rd)):
        got = values[symbol, "m"]
        assert got.count == 6
        assert got.rows == max(expected, key=expected.get)
        assert got.largest == pytest.approx(max(expected.values()), rel=1e-9)
        assert got.mean == pytest.approx(np.mean([*expected.values()]), rel=1e-9)


def test_distances_need_no_frame(ur3: Robot, errors: np.ndarray):
    """A frame that is off by a metre moves AP, and no distance."""
    m = table(ur3, errors)
    away = Measurements(m.joint_names, m.joints, m.points + np.array([1.0, 0.0, 0.0]))
    one, other = found(ur3, m), found(ur3, away)
    assert other["AD", "m"].largest == pytest.approx(one["AD", "m"].largest, rel=1e-9)
    assert other["RD", "m"].mean == pytest.approx(one["RD", "m"].mean, rel=1e-9)


def rp(e: np.ndarray) -> float:
    l = np.linalg.norm(e - e.mean(axis=0), axis=1)  # noqa: E741  the standard's letter
    return float(l.mean() + 3.0 * l.std(ddof=1))


def test_drift_is_the_change_since_the_first_ten(ur3: Robot, errors: np.ndarray):
    values = found(ur3, table(ur3, errors))
    tens = errors.reshape(POSES, -1, DRIFT_REPEATS, 3)
    ap = np.linalg.norm(tens.mean(axis=2), axis=2)
    dap = np.abs(ap[:, 1:] - ap[:, :1]).max(axis=1)
    every_rp = np.array([[rp(ten) for ten in pose] for pose in tens])
    drp = np.abs(every_rp[:, 1:] - every_rp[:, :1]).max(axis=1)
    for symbol, expected in (("dAP", dap), ("dRP", drp)):
        got = values[symbol, "m"]
        assert got.largest == pytest.approx(expected.max(), rel=1e-9)
        assert got.mean == pytest.approx(expected.mean(), rel=1e-9)
        assert got.rows == (int(np.argmax(expected)) + 1,)
        assert got.count == POSES


def test_drift_follows_the_order_of_the_measurement(ur3: Robot, errors: np.ndarray, tmp_path):
    m = table(ur3, errors)
    m.write(tmp_path / "data.csv")
    header, *rows = (tmp_path / "data.csv").read_text().splitlines()
    in_file = np.random.default_rng(1).permutation(len(rows))
    lines = [header.replace("row,", "order,"), *(rows[k] for k in in_file)]
    (tmp_path / "data.csv").write_text("\n".join(lines))
    expected, got = found(ur3, m), found(ur3, Measurements.read(tmp_path / "data.csv"))
    for symbol in ("AD", "dAP", "dRP"):
        assert got[symbol, "m"].largest == pytest.approx(expected[symbol, "m"].largest, rel=1e-9)
    # Poses are called by their row in the file.
    assert in_file[got["dAP", "m"].rows[0] - 1] + 1 == expected["dAP", "m"].rows[0]


def test_approaches_are_compared_by_their_means(ur3: Robot, errors: np.ndarray):
    # A fourth direction with two rows, too few, and rows without one, have no part.
    words = ["x"] * 8 + ["y"] * 8 + ["z"] * 8 + ["w"] * 2 + [""] * 4
    approaches = tuple(word for word in words for _ in range(POSES))
    got = found(ur3, table(ur3, errors, approaches=approaches))["vAP", "m"]
    means = [errors[:, k : k + 8].mean(axis=1) for k in (0, 8, 16)]
    expected = np.max([np.linalg.norm(a - b, axis=1) for a, b in combinations(means, 2)], axis=0)
    assert got.largest == pytest.approx(expected.max(), rel=1e-9)
    assert got.mean == pytest.approx(expected.mean(), rel=1e-9)


def test_what_the_rows_do_not_have_is_not_a_number(ur3: Robot, errors: np.ndarray):
    values = found(ur3, table(ur3, errors[:, :2]))
    assert values["AD", "m"].count == 6
    for symbol in ("RD", "vAP", "dAP", "dRP"):
        lacking = values[symbol, "m"]
        assert (lacking.count, lacking.rows) == (0, ())
        assert np.isnan([lacking.largest, lacking.mean]).all()
    assert not [unit for _, unit in values if unit != "m"]
    values = found(ur3, table(ur3, errors[:, :19]))
    assert values["RD", "m"].count == 6
    assert values["dAP", "m"].count == 0
    # One pose has no distance.
    assert found(ur3, table(ur3, errors[:1]))["AD", "m"].count == 0


def test_orientations_have_approaches_and_drift_but_no_distance(ur3: Robot):
    random = np.random.default_rng(2)
    turns = random.normal(scale=1e-4, size=(REPEATS, 3)) + np.linspace(0, 1e-3, REPEATS)[:, None]
    q = np.tile(random_joint_values(ur3, 1, 3), (REPEATS, 1))
    T = ur3.poses(q)
    angle = np.linalg.norm(turns, axis=1)[:, None, None]
    K = np.cross(np.eye(3), turns[:, None, :] * -1.0).transpose(0, 2, 1)
    turned = np.eye(3) + np.sinc(angle / np.pi) * K + (1 - np.cos(angle)) / angle**2 * (K @ K)
    m = Measurements(
        ur3.joint_names, q, T[:, :3, 3], rotations=turned @ T[:, :3, :3], kinds=("pose",) * REPEATS
    )
    evaluation = evaluate(
        ur3, m, Cell(target=(0, 0, 0), target_rotation=np.eye(3), estimate_target=False)
    )
    values = {(c.symbol, c.unit): c for c in characteristics(evaluation, accuracy(evaluation))}
    e = evaluation.residual[:, 3:]
    np.testing.assert_allclose(np.abs(e), np.abs(turns), atol=1e-9)
    tens = e.reshape(-1, DRIFT_REPEATS, 3)
    ap = np.linalg.norm(tens.mean(axis=1), axis=1)
    spread = 3.0 * tens.std(axis=1, ddof=1).max(axis=1)
    assert values["dAP", "rad"].largest == pytest.approx(np.abs(ap - ap[0]).max(), rel=1e-9)
    assert values["dRP", "rad"].largest == pytest.approx(np.abs(spread - spread[0]).max(), rel=1e-9)
    assert ("AD", "rad") not in values
