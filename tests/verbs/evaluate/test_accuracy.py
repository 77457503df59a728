"""ISO 9283's figures: by hand where that is possible, and by what is left of known errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.result.calibration import Calibration
from calib.result.calibration_file import read_result, write_result
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.evaluate.accuracy import (
    Accuracy,
    _are_among,
    _KnownResiduals,
    accuracy,
    fitted_rows,
    judged_rows,
)
from calib.verbs.evaluate.evaluation import evaluate
from calib.verbs.evaluate.row_uncertainty import RowUncertainty
from tests.residuals import lengths_and_angles

#: Target and frame known: what is measured minus what is predicted is what was put in.
KNOWN = Cell(target=(0.05, 0.06, 0.07), estimate_target=False)

Errors = Callable[..., Measurements]


def with_errors(
    robot: Robot,
    e: np.ndarray,
    repeats: int = 1,
    turns: np.ndarray | None = None,
    T: np.ndarray | None = None,
    seed: int = 3,
    **columns: object,
) -> Measurements:
    """Rows that are off by e [m] and turned by ``turns`` [rad] in the base, seen from a frame; repeats one by one."""
    q = np.repeat(random_joint_values(robot, len(e) // repeats, seed), repeats, axis=0)
    poses = robot.poses(q)
    points = poses[:, :3, :3] @ np.asarray(KNOWN.target) + poses[:, :3, 3] + e
    if turns is not None:
        columns["rotations"] = Rotation.from_rotvec(turns).as_matrix() @ poses[:, :3, :3]
        columns["kinds"] = ("pose",) * len(q)
    if T is not None:
        points = points @ T[:3, :3].T + T[:3, 3]
    return Measurements(robot.joint_names, q, points, **columns)


def of(robot: Robot, m: Measurements, cell: Cell = KNOWN, **words: bool) -> Accuracy:
    return accuracy(evaluate(robot, m, cell), **words)


#: Four repeats about (3, 4, 0): at 1 from it along y and along z.
CROSS = np.array([[3.0, 5, 0], [3, 3, 0], [3, 4, 2], [3, 4, -2]])


def test_one_pose_by_hand(ur3: Robot):
    found = of(ur3, with_errors(ur3, 1e-3 * CROSS, 4))
    (pose,) = found.poses
    assert pose.rows == (1, 2, 3, 4)
    assert pose["m"].ap == pytest.approx(5e-3, abs=1e-12)
    np.testing.assert_allclose(pose["m"].ap_axis, [3e-3, 4e-3, 0.0], atol=1e-12)
    # l = 1, 1, 2, 2: mean 1.5, S = sqrt(4 * 0.25 / 3).
    assert pose["m"].rp == pytest.approx(1e-3 * (1.5 + 3.0 * np.sqrt(1.0 / 3.0)), abs=1e-12)
    assert pose["m"].single == pytest.approx(1e-3 * np.sqrt(34.0), abs=1e-12)
    assert found.repeats == (4, 4)
    assert (found.rows, found.seen, found.others) == ("all", False, ())
    # Squares about the mean: 1 + 1 + 4 + 4, over (4 - 1) * 3.
    assert np.isnan(pose["rad"].ap)
    assert [len(found.of(name, "rad")) for name in ("ap", "rp", "single")] == [0, 0, 0]
    assert found.units == ("m",)


def test_the_axes_are_the_bases_whatever_the_frame(ur3: Robot):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec([0.3, -1.0, 2.0]).as_matrix()
    T[:3, 3] = [2.0, -1.0, 0.5]
    turns = np.tile([1e-3, -2e-3, 3e-3], (4, 1))
    m = with_errors(ur3, 1e-3 * CROSS, 4, turns)
    seen = replace(
        m,
        points=m.points @ T[:3, :3].T + T[:3, 3],
        rotations=T[:3, :3] @ m.rotations,
    )
    (pose,) = of(ur3, seen, replace(KNOWN, T_frame_base=T)).poses
    np.testing.assert_allclose(pose["m"].ap_axis, [3e-3, 4e-3, 0.0], atol=1e-12)
    np.testing.assert_allclose(pose["rad"].ap_axis, [1e-3, -2e-3, 3e-3], atol=1e-12)
    assert pose["rad"].ap == pytest.approx(np.sqrt(14.0) * 1e-3)
    np.testing.assert_allclose(pose["rad"].rp_axis, np.zeros(3), atol=1e-12)


def test_orientations_by_hand(ur3: Robot):
    turns = np.array([[2e-3, 0, 1e-3], [2e-3, 0, 2e-3], [2e-3, 0, 3e-3]])
    found = of(ur3, with_errors(ur3, np.zeros((3, 3)), 3, turns))
    (pose,) = found.poses
    np.testing.assert_allclose(pose["rad"].ap_axis, [2e-3, 0.0, 2e-3], atol=1e-9)
    np.testing.assert_allclose(pose["rad"].rp_axis, [0.0, 0.0, 3e-3], atol=1e-9)
    assert pose["rad"].single == pytest.approx(np.sqrt(13.0) * 1e-3)
    assert found.of("rp", "rad") == pytest.approx([3e-3])
    assert found.of("single", "rad") == pytest.approx([pose["rad"].single])


def test_lengths_have_the_standards_distance_accuracy(ur3: Robot):
    m = with_errors(ur3, np.zeros((6, 3)), 3)
    lengths = np.linalg.norm(m.points, axis=1)
    off = 1e-3 * np.array([-1.0, -2.0, -3.0, 1.0, 1.0, 4.0])
    table = Measurements(
        ur3.joint_names, m.joints, m.points, kinds=("distance",) * 6, distances=lengths + off
    )
    known = evaluate(ur3, m, KNOWN).setup
    first, second = accuracy(evaluate(ur3, table, KNOWN, known=known)).poses
    assert first["m"].ap == pytest.approx(2e-3, abs=1e-12)
    assert first["m"].rp == pytest.approx(3e-3, abs=1e-12)
    assert first["m"].single == pytest.approx(3e-3, abs=1e-12)
    assert np.all(np.isnan(first["m"].ap_axis))
    assert second["m"].rp == pytest.approx(3e-3 * np.sqrt(3.0), abs=1e-12)
    assert second.kind == "distance"


def test_what_was_registered_is_counted(ur3: Robot):
    m = with_errors(ur3, np.zeros((12, 3)), 3)

    def told(cell: Cell, rows: int = 12) -> tuple:
        found = of(ur3, m.select(np.arange(12) < rows), cell)
        return found.registered, found.unknowns, found.numbers, found.factor

    assert told(Cell()) == (("target",), 3, 12, pytest.approx(np.sqrt(12 / 9)))
    assert told(Cell(estimate_frame=True)) == (("target", "frame"), 9, 12, 2.0)
    assert told(Cell(estimate_frame=True), 9) == (("target", "frame"), 9, 9, np.inf)
    assert told(KNOWN) == ((), 0, 12, 1.0)
    sets = ("estimate",) * 9 + ("validate",) * 3
    assert of(ur3, replace(m, sets=sets), Cell()).numbers == 9


@pytest.mark.parametrize(
    ("cell", "seen", "others"),
    [
        (KNOWN, False, ()),
        (KNOWN, True, ("calibration",)),
        (Cell(), False, ("target",)),
        (Cell(estimate_frame=True), True, ("calibration", "target", "frame")),
    ],
)
def test_rows_that_nothing_was_found_from_are_judged_alone(
    ur3: Robot, cell: Cell, seen: bool, others: tuple[str, ...]
):
    sets = ("estimate",) * 8 + ("validate",) * 4
    m = with_errors(ur3, 1e-3 * np.tile(CROSS, (3, 1)), sets=sets)
    found = of(ur3, m, cell, seen=seen)
    assert found.others == others
    assert found.rows == ("validation" if others else "all")
    assert len(found.poses) == (4 if others else 12)
    assert not found.seen
    assert found.factor == 1.0
    # With nothing kept apart they are all there is.
    alone = of(ur3, replace(m, sets=()), cell, seen=seen)
    assert (alone.rows, alone.seen, len(alone.poses)) == ("all", seen, 12)


def known_again(c: Calibration, m: Measurements) -> np.ndarray:
    """By a result that was written and read, its file's name and hash aside."""
    with TemporaryDirectory() as folder:
        stored = read_result(write_result(c, Path(folder) / "r.json"))
    return fitted_rows(stored, stored.nominal, replace(m, sha256=""), c.fit.cell)


def test_rows_of_every_kind_are_known_again(case):
    _, c = case
    wanted = c.fit.measurements.estimation & np.any(c.rows.channels.used, axis=1)
    assert np.array_equal(known_again(c, c.fit.measurements), wanted)


def test_neither_order_nor_number_nor_set_hides_a_row(default_result: Calibration):
    m = default_result.fit.measurements
    order = np.random.default_rng(1).permutation(len(m))[:20]
    shuffled = Measurements(m.joint_names, m.joints[order], m.points[order])
    assert np.array_equal(known_again(default_result, shuffled), m.estimation[order])


@pytest.mark.parametrize(("change", "known"), [(1e-9, True), (1e-6, False)])
def test_a_row_that_was_measured_again_is_another(
    default_result: Calibration, change: float, known: bool
):
    """What is lost in rounding is not a measurement; a micrometre is."""
    m = default_result.fit.measurements
    again = replace(m, points=m.points + change * np.eye(3)[0])
    assert known_again(default_result, again).sum() == known * m.estimation.sum()


@pytest.mark.parametrize(
    ("validate", "fitted", "registered", "judged"),
    [
        ("", "", False, "0123456789"),
        ("", "", True, "0123456789"),
        ("", "01234", False, "56789"),
        ("", "012345", False, "0123456789"),  # four poses are too few,
        ("89", "01234567", False, "89"),  # unless the table sets them aside
        ("89", "01234", False, "56789"),
        ("89", "01234", True, "89"),
        ("89", "", True, "89"),
        ("89", "", False, "0123456789"),
        ("89", "0123456789", True, "0123456789"),
    ],
)
def test_which_rows_are_judged(validate: str, fitted: str, registered: bool, judged: str):
    def mask(rows: str) -> np.ndarray:
        return np.array([str(k) in rows for k in range(10)])

    sets = tuple("validate" if one else "estimate" for one in mask(validate))
    m = Measurements(("a",), np.zeros((10, 1)), np.zeros((10, 3)), sets=sets)
    told = np.ones(10, dtype=bool)
    found = judged_rows(m, told, mask(fitted), np.arange(10), registered=registered)
    assert np.array_equal(found, mask(judged))


def test_residuals_of_both_robots_stand_side_by_side_without_what_was_not_measured():
    nominal = np.arange(16.0).reshape(4, 4)
    used = np.array([[1, 1, 1, 1], [0, 1, 0, 1], [1, 0, 0, 0], [0, 0, 0, 1]], dtype=bool)
    residuals = _KnownResiduals.of(nominal, 100.0 + nominal, lengths_and_angles(used))
    # Angles count only where a row measures no length.
    np.testing.assert_array_equal(residuals.rows_with(1), [1, 2, 3])
    expected = [[5.0, 105.0], [8.0, 108.0], [15.0, 115.0]]
    np.testing.assert_array_equal(residuals.side_by_side([1, 2, 3]), expected)
    np.testing.assert_array_equal(residuals.side_by_side([0]), [[0, 1, 2, 100, 101, 102]])


def test_rows_are_the_same_to_rounding():
    stored = np.array([[1e-3, 2e-3], [3e-3, 4e-3]])
    shifted = stored[1] + np.array([[0.0, 0.9e-7], [0.0, 1.1e-7]])
    np.testing.assert_array_equal(_are_among(shifted, stored), [True, False])


def test_rows_beyond_their_uncertainty_are_named_and_poses_have_that_of_their_mean(ur3):
    """Two poses, three times each; the first is off by 0.5 mm, twice what the prediction allows."""
    e = np.repeat([[5e-4, 0.0, 0.0], [1e-4, 0.0, 0.0]], 3, axis=0)
    found = evaluate(ur3, with_errors(ur3, e, 3), KNOWN)
    std = 2.5e-4 / 2.8332  # along each axis: 95.45 % of the lengths are within 0.25 mm
    uncertainty = RowUncertainty(
        np.repeat([std**2 * np.eye(3)], 6, axis=0),
        np.zeros((6, 3)),
        {"m": np.full(6, np.inf)},
        found.channels,
    )
    judged = accuracy(replace(found, uncertainty=uncertainty))
    assert judged.beyond == {"m": (1, 2, 3)}
    assert judged.known == {"m": 6}
    assert [pose["m"].U for pose in judged.poses] == pytest.approx([2.5e-4] * 2, rel=1e-3)
    # With noise as large as the prediction's, of which a mean of three has a third.
    noisy = replace(uncertainty, measured=np.full((6, 3), std))
    poses = accuracy(replace(found, uncertainty=noisy)).poses
    assert pytest.approx(2.5e-4 * np.sqrt(4 / 3), rel=1e-3) == poses[0]["m"].U
    without = accuracy(found)
    assert not without.has_uncertainty
    assert np.isnan(without.poses[0]["m"].U)
