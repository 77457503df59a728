"""Sensitivity of images: all corners of an image in a few rows, against finite differences of the images themselves."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from calib.camera import optics as columns
from calib.camera.camera import Camera
from calib.data.cell import Cell, Tracker, TrackerNoise
from calib.fit.registration.table_rows import with_internals
from calib.instruments.camera import SightLimits
from calib.instruments.tracker import TrackerInstrument
from calib.model.kinematics import Samples
from calib.robot.ranges import random_joint_values
from calib.verbs.plan.sensitivity import Sensitivity, View, instrument_of
from tests.instruments.scenes import BOARD, CAMERA, SIZE, at_places, in_hand
from tests.verbs.plan.test_pose_candidates import drawn


def cell(camera=SIZE, repeatability=0.0, **changes) -> Cell:
    tracker = Tracker(np.zeros(3), noise=TrackerNoise(repeatability=repeatability))
    given = {"model": "hayati", "sigma": {"px": 0.2}, "tracker": tracker} | changes
    cell = Cell(cameras={"": camera}, boards={"": BOARD}, **given)
    seen = in_hand("ur5")
    return at_places(cell, seen.T_instrument_base, seen.T_tip_target)


@cache
def model(repeatability: float = 0.0) -> Sensitivity:
    return Sensitivity.of(in_hand("ur5").robot, cell(repeatability=repeatability))


@cache
def poses() -> np.ndarray:
    return drawn(in_hand("ur5"), count=4).q


def images_at(sensitivity: Sensitivity, x: np.ndarray, q: np.ndarray) -> np.ndarray:
    """The images of all corners at one pose, in standard deviations."""
    internals = sensitivity.instrument.internals
    samples = replace(Samples.at(np.repeat(q[None], len(internals), axis=0)), internals=internals)
    changed = sensitivity.kinematics.internals(x, samples)
    T = sensitivity.kinematics.poses(x, samples)
    return columns.images(T, changed.values).ravel() / 0.2


def derivative(function, count: int) -> np.ndarray:
    """Central differences by each of the parameters."""
    step = 1e-6
    slopes = []
    for k in range(count):
        x = np.zeros(count)
        x[k] = step
        slopes.append((function(x) - function(-x)) / (2.0 * step))
    return np.stack(slopes, axis=-1)


def test_parameters_are_those_of_robot_mount_board_and_lens():
    names = model().names
    assert {"frame_x", "frame_rz", "target_x", "target_rz", "fx", "k3"} <= set(names)
    assert {"board_scale_x", "board_sag_y"} <= set(names)
    assert not any(name.startswith("corner") for name in names)
    assert model().instrument.kind.name == "pixel"


def test_the_information_of_an_image_is_that_of_all_its_corners():
    sensitivity = model()
    p = len(sensitivity.names)
    A = sensitivity.measured(poses())
    assert A.shape[1] == 6 + 9 + 4
    for q, rows in zip(poses(), A, strict=True):
        J = derivative(lambda x, q=q: images_at(sensitivity, x, q), p)
        full = J.T @ J
        scale = np.sqrt(np.maximum(np.diag(full), 1e-12))
        np.testing.assert_allclose(
            rows.T @ rows / np.outer(scale, scale), full / np.outer(scale, scale), atol=1e-6
        )


def test_the_robot_s_repeatability_moves_all_corners_of_an_image():
    r = 1e-4
    exact, moving = model(), model(r)
    q = poses()[0]
    p = len(exact.names)
    J = derivative(lambda x: images_at(exact, x, q), p)
    # By a translation along the camera's axes: by the mount's position, turned.
    T = exact.sightlines[0].T_instrument_base
    by_mount = J[:, [exact.names.index(f"frame_{axis}") for axis in "xyz"]]
    B = r * by_mount @ np.linalg.inv(T[:3, :3])
    expected = J.T @ np.linalg.solve(np.eye(len(J)) + B @ B.T, J)
    A = moving.measured(q[None])[0]
    scale = np.sqrt(np.maximum(np.diag(expected), 1e-12))
    np.testing.assert_allclose(
        A.T @ A / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-5
    )


def test_corners_outside_of_the_image_do_not_count():
    sensitivity = model()
    half = instrument_of(cell(), SightLimits(share=0.3))
    (sightline,) = sensitivity.sightlines
    T = sightline.target_poses(poses()[:1])
    visible = half.visible(T, BOARD.corners)[0]
    narrow = replace(half, camera=replace(half.camera, width=700))
    fewer = replace(sensitivity, views=(View(narrow, 0, (0,)),))
    in_narrow = narrow.visible(T, BOARD.corners)[0]
    assert 0 < in_narrow.sum() < visible.sum()
    J = derivative(lambda x: images_at(sensitivity, x, poses()[0]), len(sensitivity.names))
    kept = J[np.repeat(in_narrow, 2)]
    A = fewer.measured(poses()[:1])[0]
    scale = np.sqrt(np.maximum(np.diag(kept.T @ kept), 1e-12))
    np.testing.assert_allclose(
        A.T @ A / np.outer(scale, scale), kept.T @ kept / np.outer(scale, scale), atol=1e-6
    )
    # If the camera looks away from the board, nothing is measured.
    q = random_joint_values(sightline.robot, 20)
    unseen = q[~half.visible(sightline.target_poses(q), BOARD.corners).any(axis=1)]
    assert len(unseen) > 5
    assert not sensitivity.measured(unseen).any()


def test_the_middle_of_the_board_is_located():
    sensitivity = model()
    q = poses()[:2]
    centre = np.append(BOARD.centre, 1.0)
    J = derivative(
        lambda x: (sensitivity.kinematics.poses(x, Samples.at(q)) @ centre)[:, :3],
        len(sensitivity.names),
    )
    np.testing.assert_allclose(sensitivity.located(q), J, atol=1e-7)
    place = sensitivity.kinematics.poses(np.zeros(len(sensitivity.names)), Samples.at(q)) @ centre
    np.testing.assert_allclose(sensitivity.expected(q)[:, 0], place[:, :3])


def test_what_is_known_of_the_lens_is_its_prior():
    def prior(camera: Camera) -> dict[str, float]:
        sensitivity = Sensitivity.of(in_hand("ur5").robot, cell(camera))
        return dict(zip(sensitivity.names, sensitivity.precision**-0.5, strict=True))

    unknown = prior(SIZE)
    assert unknown["fx"] == pytest.approx(1e4)
    assert unknown["board_scale_x"] == pytest.approx(BOARD.sigma_scale)
    stated = prior(CAMERA)
    assert stated["fx"] == pytest.approx(0.01 * 1024.0)
    exact = prior(replace(CAMERA, sigma=np.array([0.5, 0.7, 1, 1, 0, 0, 0, 0, 0])))
    assert (exact["fx"], exact["fy"]) == pytest.approx((0.5, 0.7))
    assert "k1" not in exact


def test_what_is_assumed_is_remarked():
    robot = in_hand("ur5").robot
    codes = [note.code for note in Sensitivity.of(robot, cell(sigma={})).notes]
    assert codes == ["camera_assumed", "image_noise"]
    assert Sensitivity.of(robot, cell(CAMERA)).notes == ()
    # From the cell of a plan, too, which has the assumed intrinsics.
    again = Sensitivity.of(robot, model().cell)
    assert again.notes[0].code == "camera_assumed"
    np.testing.assert_array_equal(again.precision, model().precision)


def test_noise_is_in_pixels():
    assert model().noise(poses()) == pytest.approx([0.2] * 4)
    assert model().sigma_by_unit(poses()) == {"px": 0.2}


def test_the_numbers_of_the_instrument_are_those_of_the_fit():
    table = model().instrument.stop_rows(in_hand("ur5").robot, ("target",), "")
    stop = np.zeros(len(table), dtype=int)
    _, internals = with_internals(model().setup, table, model().cell, stop)
    np.testing.assert_array_equal(model().instrument.internals, internals)


def test_a_cell_with_a_camera_plans_images_unless_it_states_another_kind():
    assert model().instrument.kind.name == "pixel"
    assert isinstance(instrument_of(cell(kind="pose")), TrackerInstrument)
    assert isinstance(instrument_of(Cell()), TrackerInstrument)
