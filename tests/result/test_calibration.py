"""What can be asked of a result: predictions by target and set-up, how sure they are, what lies outside."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from calib.data.measurements import Measurements
from calib.diagnosis.reasons import NO, Reason, Verdict, Why
from calib.errors import ModelError
from calib.model.kinematics import Samples
from calib.numerics.moves import last_moves
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration, is_corrected, joint_of_another_run
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.show.robot_sentences import other_run_sentence
from calib.verbs.view.view import view_of_result
from tests.parts import with_part


def test_predictions_are_what_residuals_are_made_of(case):
    """Of every kind that measures positions, by the target and station of the row, by either model."""
    _, c = case
    m = c.fit.measurements
    seen = m.of_kind("point", "pose")
    for i in np.flatnonzero(seen)[::7]:
        where = {"target": m.targets[i], "group": m.groups[i]}
        q = m.joints_for(c.nominal.joint_names)[i]
        geometry = c.predict(q, non_geometric=False, **where)[0]
        np.testing.assert_allclose(
            m.points[i] - geometry, c.rows.residual_calibrated[i, :3], atol=1e-12
        )
        if c.non_geometric is not None:
            non_geometric = c.predict(q, **where)[0]
            np.testing.assert_allclose(
                m.points[i] - non_geometric, c.non_geometric.residual[i, :3], atol=1e-12
            )
            assert np.linalg.norm(non_geometric - geometry) > 1e-6


def test_the_verdict_is_that_on_the_model_with_which_one_predicts(case):
    _, c = case
    assert c.verdict_on(non_geometric=False) is c.verdict
    of_model = None if c.non_geometric is None else c.non_geometric.verdict
    assert c.verdict_on(non_geometric=True) is (c.verdict if of_model is None else of_model)
    without = replace(c, non_geometric=None)
    assert without.verdict_on(non_geometric=True) is c.verdict


def test_set_ups_see_the_same_robot(calibrated):
    _, c = calibrated("set-ups")
    q = random_joint_values(c.nominal, 5, 1)
    seen = [
        np.linalg.inv(T) @ c.predict_poses(q, group=g)
        for g, T in zip(c.setup.groups, c.setup.T_frame_base, strict=True)
    ]
    np.testing.assert_allclose(seen[1], seen[0], atol=1e-12)
    np.testing.assert_allclose(seen[2], seen[0], atol=1e-12)
    np.testing.assert_array_equal(c.predict(q), c.predict(q, group="0"))


def test_without_an_instrument_s_frame_predictions_are_in_the_base(calibrated):
    scene, c = calibrated("sockets")
    q = c.fit.measurements.joints[:5]
    in_base = c.predict(q)
    T = c.setup.T_frame_base[0]
    np.testing.assert_allclose(
        c.predict(q, group=c.setup.groups[0]), in_base @ T[:3, :3].T + T[:3, 3], atol=1e-12
    )
    nominal = (scene.robot.poses(q) @ scene.kinematics.T_tip_target[0])[:, :3, 3]
    assert np.abs(in_base - nominal).max() < 0.02


def test_positions_are_as_sure_as_their_errors_are_small(calibrated):
    scene, c = calibrated("points")
    q = random_joint_values(c.nominal, 300, 3)
    assert np.sqrt(np.mean(c.position_std(q) ** 2)) == pytest.approx(
        c.geometry.expected_everywhere, rel=0.15
    )
    c = with_part(c, "geometry", scale=None)  # the instrument of this scene has no scale error
    true = scene.kinematics.points(scene.x, Samples.at(q))
    errors = np.linalg.norm(c.predict(q) - true, axis=1)
    std = c.position_std(q)
    assert 0.4 < np.sqrt(np.mean(errors**2) / np.mean(std**2)) < 2.0


def test_in_a_socket_s_frame_positions_are_as_sure_as_predictions_differ(calibrated):
    """By differences of what `predict` gives."""
    _, c = calibrated("sockets")
    q, group, step = random_joint_values(c.nominal, 5, 3), c.setup.groups[0], 1e-6

    def at(x):
        return with_part(c, "geometry", x=x).predict(q, group=group)

    J = np.stack(
        [
            (at(c.geometry.x + e) - at(c.geometry.x - e)) / (2 * step)
            for e in step * np.eye(len(c.geometry.x))
        ],
        axis=2,
    )
    expected = np.sqrt(np.einsum("nij,jk,nik->n", J, c.covariance, J))
    np.testing.assert_allclose(c.position_std(q, group=group), expected, rtol=1e-3)


def test_names_that_are_not_there_are_refused(calibrated):
    _, c = calibrated("targets")
    q = np.zeros(6)
    with pytest.raises(ModelError, match="no target 'ball'; there is 't0', 't1'"):
        c.predict(q, target="ball")
    with pytest.raises(ModelError, match="no station 'monday'; there is '0'"):
        c.position_std(q, group="monday")
    with pytest.raises(ModelError, match="no parameter 'a9'"):
        c.parameter("a9")


def test_joint_values_outside_of_the_measured_are_told(calibrated):
    _, c = calibrated("points")
    seen = c.fit.measurements.joints[c.rows.weights > 0.0]
    inside, beyond = seen[3].copy(), seen[3].copy()
    beyond[2] = seen[:, 2].max() + 0.5
    assert c.outside_of_measured(inside) == ()
    (row,) = c.outside_of_measured(np.array([inside, beyond]))
    assert row.index == 1
    assert [one.joint for one in row.beyond] == ["elbow_joint"]


def test_files_of_a_run_carry_its_id(calibrated, tmp_path):
    _, c = calibrated("poses")
    read = Calibration.read_json(c.write_json(tmp_path / "r.json"))
    urdf = Urdf.read(c.write_urdf(tmp_path / "c.urdf"))
    assert (read.run, urdf.run) == (c.run, c.run)
    assert re.fullmatch("[0-9a-f]{12}", c.run)
    # Of other measurements, another nominal robot, or another fit the run is another.
    other_rows = with_part(c, "source", sha256="0" * 64)
    tips = c.setup.T_tip_target.copy()
    tips[0, 0, 3] += 1e-9
    setup = c.setup.with_poses(c.setup.T_frame_base, tips)
    other_fit = with_part(c, "geometry", setup=setup)
    other_urdf = replace(c, nominal=c.robot)
    assert len({c.run, other_rows.run, other_fit.run, other_urdf.run}) == 4
    # The comment of an earlier run gives way, and the nominal robot carries none.
    assert other_rows.robot.urdf.run == other_rows.run
    assert other_rows.robot.urdf.data.count(b"calib run") == 1
    assert c.uncorrected(c.robot).urdf.run == ""


def test_a_urdf_of_another_run_is_told_by_its_origins(calibrated):
    _, c = calibrated("poses")
    joint = c.nominal.joint_names[2]
    T = c.nominal.origins()[joint].copy()
    T[0, 3] += 1e-6
    urdf = c.nominal.urdf.with_origins({joint: T})
    other = replace(c.nominal.rebuilt(urdf), urdf=urdf.with_comments(run="0a1b", verdict=""))
    assert joint_of_another_run(c, other) == joint
    assert [joint_of_another_run(c, robot) for robot in (c.nominal, c.robot)] == ["", ""]
    assert [is_corrected(c, robot) for robot in (c.nominal, c.robot)] == [False, True]
    with pytest.raises(ModelError, match=f"see '{joint}'.* of run 0a1b, the result of {c.run}"):
        is_corrected(c, other)
    said = other_run_sentence(other, c, "r.json")
    assert "(run 0a1b)" in said
    assert f"r.json (run {c.run})" in said
    assert other_run_sentence(c.robot, c, "r.json") == ""
    # The one joint that is neither is named; without one, one that is corrected.
    both = c.robot.urdf.with_origins({joint: T})
    assert joint_of_another_run(c, c.robot.rebuilt(both)) == joint
    mixed = c.robot.urdf.with_origins({joint: c.nominal.origins()[joint]})
    assert joint_of_another_run(c, c.robot.rebuilt(mixed)) not in ("", joint)
    # Pages say it below the verdict.
    assert view_of_result(c, other, source="r.json").note.endswith(said)


def test_the_robot_of_a_bad_result_says_so_whoever_writes_it(calibrated, tmp_path):
    _, c = calibrated("poses")
    bad = with_part(c, "geometry", verdict=Verdict(NO, (Reason.of(Why.CAMERA_TOO_ROUGH),)))
    assert c.robot.urdf.verdict == ""
    for robot in (bad.robot, bad.corrected(c.nominal), bad.corrected(c.robot)):
        written = Urdf.read(robot.urdf.write(tmp_path / "c.urdf", overwrite=True))
        assert written.verdict.startswith("do not use (camera_too_rough)")
    assert bad.uncorrected(bad.robot).urdf.verdict == ""


def test_links_stand_at_targets_and_frames(calibrated, tmp_path):
    _, c = calibrated("targets")
    several = c.write_urdf(tmp_path / "t.urdf", target_link=True)
    q = random_joint_values(c.nominal, 5, 2)
    for t, name in enumerate(c.setup.targets):
        robot = Robot.load(several, "base", f"calib_target_{name}")
        expected = c.robot.poses(q) @ c.setup.T_tip_target[t]
        np.testing.assert_allclose(robot.poses(q), expected, atol=1e-9)
    _, turned = calibrated("set-ups")
    path = turned.write_urdf(tmp_path / "f.urdf", frame_link=True)
    for f, name in enumerate(turned.setup.groups):
        robot = Robot.load(path, f"calib_frame_{name}", turned.robot.tip)
        expected = turned.setup.T_frame_base[f] @ turned.robot.poses(q)
        np.testing.assert_allclose(robot.poses(q), expected, atol=1e-9)
    _, c = calibrated("sockets")
    with pytest.raises(ModelError, match="No row determines the pose of a measurement frame"):
        c.write_urdf(tmp_path / "s.urdf", frame_link=True)
    _, turned = calibrated("poses")
    path = turned.write_urdf(tmp_path / "c.urdf", target_link=True)
    robot = Robot.load(path, "base", "calib_target")
    q = random_joint_values(turned.nominal, 5, 2)
    into_base = np.linalg.inv(turned.T_frame_base)
    np.testing.assert_allclose(robot.poses(q), into_base @ turned.predict_poses(q), atol=1e-9)


def test_predictions_go_from_row_to_row(ur3):
    """A joint that stops short does so after the move from the row before; or after moves that are given."""
    q = random_joint_values(ur3, 40, 3)
    T = ur3.poses(q - 1e-3 * np.sign(last_moves(q)))
    m = Measurements(ur3.joint_names, q, T[:, :3, :3] @ [0.05, 0.02, 0.1] + T[:, :3, 3])
    c = calibrate(ur3, m, model="zeros+lost_motion", validate=False)
    np.testing.assert_allclose(c.predict(q)[1:], m.points[1:], atol=2e-5)
    np.testing.assert_allclose(
        c.predict(q[::-1], moves=m.moves[::-1]), c.predict(q)[::-1], atol=1e-12
    )
    assert np.abs(c.predict(q[::-1])[::-1] - c.predict(q)).max() > 5e-4
    # A single row has no row before it: halfway between both sides.
    sides = [c.predict(q[5], moves=[sign * np.ones(6)]) for sign in (1.0, -1.0)]
    np.testing.assert_allclose(c.predict(q[5]), np.mean(sides, axis=0), atol=1e-5)
    with pytest.raises(ModelError, match="moves"):
        c.predict(q, moves=np.ones(6))
