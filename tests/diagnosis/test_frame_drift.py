"""What targets that stand still show of a table: found, said, and taken out of the measured poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import fdtrc

from calib.data.measurements import Measurements
from calib.data.references import References
from calib.diagnosis.frame_drift import (
    Displacements,
    Mover,
    _beyond,
    find_frame_drift,
    shown_by_references,
    without_frame_drift,
)
from calib.diagnosis.reasons import Why
from calib.errors import MeasurementError
from calib.numerics.frame_path import Form
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.ranges import random_joint_values
from tests.judged import arm, table_of

#: Standard deviation of a coordinate of a reading [m].
NOISE = 1e-5


def with_references(points, displace, *, count=2, every=5, seed=1, joints=None, apart=1.0):
    """A table of poses at points (N, 3) and of targets that stand still, displaced by the row's place and name.

    The targets stand about so far ``apart`` [m].
    """
    rng = np.random.default_rng(seed)
    poses = len(points)
    still = np.array([[1.0, 0.2, 0.1], [-0.8, 0.9, 0.3], [0.1, -1.0, 0.8], [0.5, 0.5, -0.2]])
    still = apart * still[:count]
    order = []
    for pose in range(poses + 1):
        if pose % every == 0:
            order += [-1 - k for k in range(count)]
        if pose < poses:
            order.append(pose)
    rows = {"pose": [], "reference": []}
    readings, names, moved = [], [], np.empty((poses, 3))
    for place, i in enumerate(order):
        if i >= 0:
            moved[i] = points[i] + displace(place, points[i], "ball")
            rows["pose"].append(place + 1)
        else:
            name = f"floor {-i}"
            noise = NOISE * rng.normal(size=3)
            readings.append(still[-1 - i] + displace(place, still[-1 - i], name) + noise)
            names.append(name)
            rows["reference"].append(place + 1)
    references = References(
        points=np.array(readings),
        targets=tuple(names),
        groups=("",) * len(names),
        rows=tuple(rows["reference"]),
        sequence=tuple(range(1, len(order) + 1)),
    )
    joints = np.zeros((poses, 1)) if joints is None else joints
    names = tuple(f"j{k}" for k in range(joints.shape[1]))
    return Measurements(names, joints, moved, rows=tuple(rows["pose"]), references=references)


def random_points(count=30, seed=2):
    return np.random.default_rng(seed).uniform(-0.7, 0.7, size=(count, 3))


BY = np.array([8e-5, -6e-5, 4e-5])


def step_of(place, by=BY, who=lambda _: True):
    return lambda t, _, name: by * (t >= place and who(name))


def test_nothing_without_references():
    assert find_frame_drift(Measurements(("j",), np.zeros((2, 1)), np.zeros((2, 3)))) is None


def test_frames_that_stand_still():
    m = with_references(random_points(), step_of(1000))
    drift, displaced = find_frame_drift(m)
    assert drift.found == ()
    assert without_frame_drift(m, displaced) is m
    assert drift.scatter == pytest.approx(NOISE, rel=0.3)
    assert drift.freedom == 14 * 3 - 6
    assert [(one.target, one.readings) for one in drift.targets] == [("floor 1", 7), ("floor 2", 7)]
    # By hand: the standard deviation of the slope of 14 readings, at the places of the poses.
    places = m.references.places_of(m.rows) / 43
    read = m.references.places_of(m.references.rows) / 43
    square = sum(np.sum((read[k::2] - read[k::2].mean()) ** 2) for k in range(2))
    left = drift.scatter * np.sqrt(np.mean(places**2) / square)
    assert drift.left == pytest.approx(left, rel=1e-9)
    (reason,) = shown_by_references(drift)
    assert (reason.why, reason.values["readings"]) == (Why.REFERENCES_STILL, 14)


def test_a_step_is_taken_out():
    points = random_points()
    m = with_references(points, step_of(24))
    drift, displaced = find_frame_drift(m)
    (step,) = drift.found
    assert (step.form, step.mover, step.reference, step.corrected) == (
        Form.STEP,
        Mover.FRAME,
        "",
        True,
    )
    # Readings of rows 22 and 23, and of rows 29 and 30: the step was between.
    assert step.after_row in (22, 23)
    assert step.before_row in (28, 29)
    assert np.all(np.abs(step.by - BY) < 4.0 * step.std)
    left = without_frame_drift(m, displaced).points - points
    clear = np.array([row < 22 or row > 28 for row in m.rows])
    assert np.abs(left[clear]).max() < 3e-5
    (reason,) = shown_by_references(drift)
    assert (reason.why, reason.values["after_row"]) == (Why.REFERENCES_STEP, step.after_row)


def test_a_drift_is_taken_out():
    points = random_points()
    m = with_references(points, lambda t, _, __: 2.0 * BY * t / 43.0)
    drift, displaced = find_frame_drift(m)
    (found,) = drift.found
    assert (found.form, found.mover, found.row) == (Form.DRIFT, Mover.FRAME, 0)
    np.testing.assert_allclose(found.by, 2.0 * BY, atol=4e-5)
    left = without_frame_drift(m, displaced).points - points
    assert np.sqrt(np.mean(left**2)) < 3.0 * drift.left
    assert [reason.why for reason in shown_by_references(drift)] == [Why.REFERENCES_DRIFT]
    # By hand: the F test of a slope of each axis, times three, as a third of the false alarms are drifts of the frame.
    share = m.references.places_of(m.references.rows) / 43.0
    names = np.array(m.references.targets)
    read = [np.column_stack([share, m.references.points])[names == k] for k in sorted(set(names))]
    read = np.concatenate([of_one - of_one.mean(axis=0) for of_one in read])
    slopes = read[:, 0] @ read[:, 1:] / np.sum(read[:, 0] ** 2)
    explained = np.sum(read[:, 0] ** 2) * np.sum(slopes**2)
    freedom = read[:, 1:].size - 6 - 3
    F = explained / 3.0 / ((np.sum(read[:, 1:] ** 2) - explained) / freedom)
    assert found.p == pytest.approx(3.0 * fdtrc(3, freedom, F), rel=1e-6, abs=0.0)


def test_a_reference_that_was_knocked_moves_no_pose():
    m = with_references(random_points(), step_of(24, who=lambda name: name == "floor 2"), count=3)
    drift, displaced = find_frame_drift(m)
    (moved,) = drift.found
    assert (moved.mover, moved.reference, moved.corrected) == (Mover.REFERENCE, "floor 2", False)
    assert not displaced.points.any()
    whys = [reason.why for reason in shown_by_references(drift)]
    assert whys == [Why.REFERENCE_MOVED, Why.REFERENCES_STILL]


def test_a_reading_that_is_off():
    off = lambda t, _, name: np.array([1e-3, 0.0, 0.0]) * (t == 15 and name == "floor 2")  # noqa: E731
    m = with_references(random_points(), off, count=2)
    row = 16
    assert row in m.references.rows
    drift, displaced = find_frame_drift(m)
    (wrong,) = drift.found
    assert (wrong.mover, wrong.reference, wrong.row) == (Mover.READING, "floor 2", row)
    assert not displaced.points.any()
    assert Why.REFERENCE_MISREAD in [reason.why for reason in shown_by_references(drift)]


LINKS = {"floor 1": "world", "floor 2": "base"}


@pytest.mark.parametrize(
    ("who", "mover"),
    [(lambda name: name != "floor 1", Mover.BASE), (lambda _: True, Mover.INSTRUMENT)],
)
def test_links_tell_who_moved(who, mover):
    points = random_points()
    m = with_references(points, step_of(24, who=who))
    drift, displaced = find_frame_drift(m, LINKS)
    (step,) = drift.found
    assert (step.mover, step.corrected) == (mover, True)
    assert [one.link for one in drift.targets] == ["world", "base"]
    last = without_frame_drift(m, displaced).points[-1] - points[-1]
    assert np.abs(last).max() < 3e-5


def test_links_name_all_references():
    m = with_references(random_points(), step_of(24))
    with pytest.raises(MeasurementError, match="floor 2"):
        find_frame_drift(m, {"floor 1": "world"})


@pytest.mark.parametrize("apart", [1.0, 0.05])
def test_three_references_show_a_rotation(apart):
    """The nearer they are, the larger it has to be."""
    points = random_points()
    turn = np.array([0.0, 0.0, 3e-4]) / apart
    R = Rotation.from_rotvec(turn).as_matrix()
    turned = lambda t, p, _: (R @ p - p) * (t >= 24)  # noqa: E731
    m = with_references(points, turned, count=4, apart=apart)
    rotations = np.tile(np.eye(3), (30, 1, 1))
    late = np.array([row > 24 for row in m.rows])
    rotations[late] = R
    m = replace(m, kinds=("pose",) * 30, rotations=rotations)
    drift, displaced = find_frame_drift(m)
    (step,) = drift.found
    np.testing.assert_allclose(step.rotation, turn, atol=4e-5 / apart)
    corrected = without_frame_drift(m, displaced)
    clear = np.array([row < 21 or row > 33 for row in m.rows])
    assert np.abs(corrected.points - points)[clear].max() < 5e-5 / apart
    left = Rotation.from_matrix(corrected.rotations[clear]).magnitude()
    assert left.max() < 5e-5 / apart
    # A rotation displaces points whose orientation was not measured too.
    positions = without_frame_drift(replace(m, kinds=(), rotations=None), displaced)
    np.testing.assert_array_equal(positions.points, corrected.points)
    assert positions.rotations is None


def test_a_drift_is_bounded_only_where_it_is_told_from_a_rotation_in_all_directions():
    """Three references before and after a rotation: one along their normal is a rotation that grows with the time.

    They were read the other way round afterwards, so that along the two others a drift is no displacement.
    """
    R = Rotation.from_rotvec([0.0, 0.0, 1e-2]).as_matrix()
    turned = lambda t, p, _: (R @ p - p) * (t >= 20)  # noqa: E731
    m = with_references(random_points(), turned, count=3, every=30)
    order = [0, 1, 2, 5, 4, 3]
    names = tuple(m.references.targets[k] for k in order)
    references = replace(m.references, points=m.references.points[order], targets=names)
    drift, _ = find_frame_drift(replace(m, references=references))
    (step,) = drift.found
    np.testing.assert_allclose(step.rotation, [0.0, 0.0, 1e-2], atol=1e-4)
    assert np.isnan(drift.left)


def test_stations_are_looked_at_by_themselves():
    left = with_references(random_points(), step_of(24))
    both = replace(left, groups=("a",) * 15 + ("b",) * 15)
    references = replace(both.references, groups=("a",) * 14)
    both = replace(both, references=references)
    _, displaced = find_frame_drift(both)
    assert not displaced.points[15:].any()


def test_references_that_were_read_once_show_nothing():
    m = with_references(random_points(4), step_of(1000), every=100)
    drift, displaced = find_frame_drift(m)
    assert np.isnan(drift.left)
    assert np.isnan(drift.scatter)
    assert not displaced.points.any()
    assert [reason.why for reason in shown_by_references(drift)] == [Why.REFERENCES_TOO_FEW]


def test_displacements_that_are_the_same():
    one = Displacements(np.zeros((2, 3)), np.zeros((2, 3)))
    assert one.same_as(Displacements(np.full((2, 3), 1e-12), np.zeros((2, 3))))
    assert not one.same_as(Displacements(np.full((2, 3), 1e-6), np.zeros((2, 3))))


@pytest.fixture(scope="module")
def scene(make_scene):
    return arm(make_scene, 63)


def calibrated(scene, displace, **given):
    """A true robot measured with references, and calibrated without cross-validation."""
    q = random_joint_values(scene.robot, 40, 3)
    points = table_of(scene, q, np.random.default_rng(3)).points
    m = with_references(points, displace, joints=q, **given)
    m = replace(m, joint_names=scene.robot.joint_names)
    return m, calibrate(scene.robot, m, model="dh", validate=False)


def test_residuals_place_a_step(scene, tmp_path):
    # Row 29 is the fifth of ten poses between the readings of rows 23, 24 and 35, 36.
    m, result = calibrated(scene, step_of(28, 2.0 * BY), every=10)
    (step,) = result.drift.found
    assert abs(step.row - 29) <= 1
    assert step.after_row < 29 <= step.before_row
    assert step.before_row - step.after_row <= 4
    assert np.all(np.abs(step.by - 2.0 * BY) < 4.0 * step.std)
    taken_out = m.points - result.fit.measurements.points
    np.testing.assert_allclose(taken_out[-1], step.by, atol=1e-12)
    result.write_json(tmp_path / "result.json")
    again = Calibration.read_json(tmp_path / "result.json").drift
    assert again.left == result.drift.left
    np.testing.assert_array_equal(again.found[0].by, step.by)
    assert (again.found[0].mover, again.found[0].form) == (step.mover, step.form)
    assert again.targets == result.drift.targets


def test_residuals_tell_a_knocked_reference_from_a_step(scene):
    _, result = calibrated(scene, step_of(28, 2.0 * BY, lambda name: name != "ball"), count=1)
    (moved,) = result.drift.found
    assert (moved.mover, moved.reference) == (Mover.REFERENCE, "floor 1")


def test_a_frame_s_place_that_the_fit_has_is_no_further_regressor():
    """Columns of any size, of which the first is in the range of the fit's, and the second all but so."""
    base = np.linalg.qr(np.random.default_rng(0).normal(size=(12, 4)))[0]
    inside, aside, outside = base @ [30.0, 0.0, -40.0, 0.0], base[:, 1].copy(), np.zeros(12)
    outside[5] = 1e-3
    aside[5] += 1e-5
    columns = np.column_stack([inside, aside, outside])
    np.testing.assert_array_equal(_beyond(base, columns), columns[:, 2:])


def test_references_that_stand_still_change_nothing(scene):
    m, result = calibrated(scene, step_of(1000))
    without = calibrate(scene.robot, replace(m, references=None), model="dh", validate=False)
    assert result.drift.found == ()
    np.testing.assert_array_equal(result.geometry.x, without.geometry.x)


@pytest.mark.parametrize("count", [2, 3])
def test_several_targets_of_one_name_are_refused(count: int):
    table = with_references(random_points(), lambda *_: np.zeros(3), count=count)
    references = table.references
    assert references is not None
    alike = replace(references, targets=("target",) * len(references))
    with pytest.raises(
        MeasurementError, match=f"{len(references)} readings of the reference 'target'"
    ):
        find_frame_drift(replace(table, references=alike))


def test_an_instrument_that_was_put_elsewhere_is_a_step():
    table = with_references(random_points(), step_of(20, np.array([0.3, -0.2, 0.1])), count=3)
    found = find_frame_drift(table)
    assert found is not None
    assert [one.form for one in found[0].found] == [Form.STEP]


def test_an_only_reference_that_drifts_says_nothing_of_the_frame(scene):
    drifts = lambda t, _, name: 3.0 * BY * t / 44.0 * (name != "ball")  # noqa: E731
    _, result = calibrated(scene, drifts, count=1)
    (moved,) = result.drift.found
    assert (moved.form, moved.mover, moved.corrected) == (Form.DRIFT, Mover.REFERENCE, False)
    assert np.isnan(result.drift.left)
