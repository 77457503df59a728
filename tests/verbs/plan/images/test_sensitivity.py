"""Sensitivity of images: all corners of an image in a few rows, against finite differences of the images themselves."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from calib.camera import optics as columns
from calib.camera.camera import Camera
from calib.data.cell import Cell, Tracker, TrackerNoise
from calib.errors import ModelError
from calib.model.kinematics import Samples
from calib.robot.ranges import random_joint_values
from calib.verbs.plan.images.sensitivity import ImageSensitivity, sensitivity_of
from calib.verbs.plan.sensitivity import Sensitivity
from tests.verbs.plan.images.test_candidates import drawn
from tests.verbs.plan.images.views import BOARD, CAMERA, in_hand

SIZE = Camera(width=1280, height=960)


def cell(camera=SIZE, repeatability=0.0, **changes) -> Cell:
    tracker = Tracker(np.zeros(3), noise=TrackerNoise(repeatability=repeatability))
    given = {"model": "hayati", "sigma": {"px": 0.2}, "tracker": tracker} | changes
    return Cell(cameras={"": camera}, boards={"": BOARD}, **given)


@cache
def model(repeatability: float = 0.0) -> ImageSensitivity:
    robot, seen = in_hand("ur5")
    return ImageSensitivity.of_images(robot, cell(repeatability=repeatability), seen)


@cache
def poses() -> np.ndarray:
    return drawn(*in_hand("ur5"), count=4).q


def images_at(sensitivity: ImageSensitivity, x: np.ndarray, q: np.ndarray) -> np.ndarray:
    """The images of all corners at one pose, in standard deviations."""
    corners = len(sensitivity.optics)
    samples = replace(Samples.at(np.repeat(q[None], corners, axis=0)), optics=sensitivity.optics)
    changed = sensitivity.kinematics.optics(x, samples)
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
    assert model().kind == "pixel"


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
    T = exact.sight.T_frame_base
    by_mount = J[:, [exact.names.index(f"frame_{axis}") for axis in "xyz"]]
    B = r * by_mount @ np.linalg.inv(T[:3, :3])
    expected = J.T @ np.linalg.solve(np.eye(len(J)) + B @ B.T, J)
    A = moving.measured(q[None])[0]
    scale = np.sqrt(np.maximum(np.diag(expected), 1e-12))
    np.testing.assert_allclose(
        A.T @ A / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-5
    )


def test_corners_outside_of_the_image_do_not_count():
    robot, seen = in_hand("ur5")
    half = replace(seen, limits=replace(seen.limits, share=0.3))
    sensitivity = ImageSensitivity.of_images(robot, cell(), half)
    T = half.board_poses(robot, poses()[:1])
    visible = half.visible(T, BOARD.corners)[0]
    narrow = replace(half, camera=replace(CAMERA, width=700))
    fewer = replace(sensitivity, sight=narrow)
    in_narrow = narrow.visible(T, BOARD.corners)[0]
    assert 0 < in_narrow.sum() < visible.sum()
    J = derivative(lambda x: images_at(sensitivity, x, poses()[0]), len(sensitivity.names))
    kept = J[np.repeat(in_narrow, 2)]
    A = fewer.measured(poses()[:1])[0]
    scale = np.sqrt(np.maximum(np.diag(kept.T @ kept), 1e-12))
    np.testing.assert_allclose(
        A.T @ A / np.outer(scale, scale), kept.T @ kept / np.outer(scale, scale), atol=1e-6
    )
    # Where the camera looks elsewhere, nothing is measured.
    q = random_joint_values(robot, 20)
    unseen = q[~half.visible(half.board_poses(robot, q), BOARD.corners).any(axis=1)]
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
    robot, seen = in_hand("ur5")

    def prior(camera: Camera) -> dict[str, float]:
        sensitivity = ImageSensitivity.of_images(robot, cell(camera), seen)
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
    robot, seen = in_hand("ur5")
    codes = [note.code for note in ImageSensitivity.of_images(robot, cell(sigma={}), seen).notes]
    assert codes == ["camera_assumed", "image_noise"]
    assert ImageSensitivity.of_images(robot, cell(CAMERA), seen).notes == ()
    # From the cell of a plan, too, which has the assumed intrinsics.
    again = ImageSensitivity.of_images(robot, model().cell, seen)
    assert again.notes[0].code == "camera_assumed"
    np.testing.assert_array_equal(again.precision, model().precision)


def test_noise_is_in_pixels():
    assert model().noise(poses()) == pytest.approx([0.2] * 4)
    assert model().sigma_by_unit(poses()) == {"px": 0.2}


def test_the_model_of_a_plan_with_and_without_a_camera(ur3):
    robot, seen = in_hand("ur5")
    assert isinstance(sensitivity_of(robot, cell(), seen), ImageSensitivity)
    assert type(sensitivity_of(ur3, Cell(), None)) is Sensitivity
    with pytest.raises(ModelError, match="planned as images"):
        Sensitivity.of(ur3, Cell(kind="pixel"))
