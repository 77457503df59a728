"""The corners that the cameras of a calibration saw, and the joint values of their images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.camera import optics
from calib.camera.lenses import LENSES
from calib.fit.registration.table_rows import rows_and_setup
from calib.instruments.internals import number_corners
from calib.result.calibration import Calibration
from calib.show.row_values import flagged_rows
from calib.verbs.calibrate.camera.seen_corners import SeenCorners


@dataclass(frozen=True, slots=True, eq=False)
class _Prediction:
    """Predictions of the calibrated robot at all N rows of a table."""

    #: Shape (N, 4, 4), pose of the target in the frame [m]
    T_frame_target: Array
    #: Shape (N, `calib.camera.optics.COUNT`), numbers of camera and board
    optics: Array
    #: Names of the images
    images: tuple[str, ...]


def has_images(c: Calibration) -> bool:
    """Tell if any row is the image of a corner."""
    return bool(np.any(_is_image(c)))


def all_pixels_are_images(c: Calibration) -> bool:
    """Tell if no other rows than images of corners measure pixels."""
    measures_pixels = np.any(c.rows.channels.where("px"), axis=1)
    return bool(np.all(_is_image(c)[measures_pixels]))


def _is_image(c: Calibration) -> Mask:
    """Return the rows that are images of corners, shape (N,)."""
    return c.fit.measurements.is_image


def seen_corners(c: Calibration) -> tuple[SeenCorners, ...]:
    """Return the corners that each camera saw, camera by camera; nothing without images."""
    if not has_images(c):
        return ()
    predicted = _prediction(c)
    is_image = _is_image(c)
    numbers = predicted.optics[:, optics.CAMERA]
    cameras = np.unique(numbers[is_image])
    return tuple(
        _of_camera(c, predicted, np.flatnonzero(is_image & (numbers == camera)))
        for camera in cameras
    )


def _prediction(c: Calibration) -> _Prediction:
    """Predict all rows with the calibrated robot, camera and board."""
    rows, _ = rows_and_setup(c.nominal, c.fit.measurements, c.fit.cell)
    T_base_tip = c.robot.poses(c.fit.measurements.joints_for(c.nominal.joint_names))
    seen = c.setup.sightings(T_base_tip, rows.samples)
    assert seen.internals is not None
    return _Prediction(
        T_frame_target=seen.T_frame_target,
        optics=seen.internals.values,
        images=_image_names(c.fit.measurements.images, rows.blocks),
    )


def _image_names(images: tuple[str, ...], poses: Integers) -> tuple[str, ...]:
    """Name the images of the table; one without a name by the number of its pose, from 1."""
    return tuple(
        image or f"pose {pose + 1}" for image, pose in zip(images, poses.tolist(), strict=True)
    )


def _of_camera(c: Calibration, predicted: _Prediction, at: Integers) -> SeenCorners:
    """Return the corners that one camera saw, by their indices ``at`` in the table."""
    m = c.fit.measurements
    names, corner = number_corners(m)
    values = predicted.optics[at]
    T_camera_board = predicted.T_frame_target[at]
    printed = optics.board_points(values)
    points = np.einsum("nij,nj->ni", T_camera_board[:, :3, :3], printed) + T_camera_board[:, :3, 3]
    lens = list(LENSES.values())[int(values[0, optics.LENS])]
    by_point, _ = lens.derivatives(points, values[:, : len(lens.names)])
    held_out = np.full((len(m), 2), np.nan)
    if c.cross_validation is not None:
        held_out[m.estimation] = c.cross_validation.residual[:, :2]
    name = _camera_of(c, m.groups[at[0]])
    camera = c.fit.cell.cameras[name]
    return SeenCorners(
        camera=name or camera.name,
        size=(camera.width, camera.height),
        images=tuple(predicted.images[i] for i in at),
        boards=tuple(_printed_board(c, m.targets[i]) for i in at),
        corners=tuple(names[corner[i]] for i in at),
        rows=at,
        measured=np.column_stack([m.reading("u"), m.reading("v")])[at],
        nominal=c.rows.residual_nominal[at, :2],
        calibrated=c.rows.residual_calibrated[at, :2],
        held_out=held_out[at],
        validation=m.validation[at],
        flagged=flagged_rows(c)[at],
        T_camera_board=T_camera_board,
        designed=values[:, optics.POINT],
        printed=printed,
        by_point=by_point,
    )


def _camera_of(c: Calibration, station: str) -> str:
    """Return the name by which the cell has the camera of a station: one without a name may stand at several."""
    return station if station in c.fit.cell.cameras else ""


def _printed_board(c: Calibration, target: str) -> str:
    """Return the name of the board that a target is: one without a name may have been moved to several places."""
    boards = c.fit.cell.boards
    if target not in boards and "" in boards:
        return boards[""].name
    return target


@dataclass(frozen=True, slots=True, eq=False)
class JointSpan:
    """The values of a joint in the images, and its limits."""

    #: Name of the joint
    name: str
    #: Whether its values are lengths [m]; else they are angles [rad]
    slides: bool
    #: Shape (n,), its values in the images that were fitted [rad] or [m]
    values: Array
    #: Its lower and upper limit [rad] or [m]; NaN without one
    limits: tuple[float, float]


def joint_spans(c: Calibration) -> tuple[JointSpan, ...]:
    """Return the values of each joint in the fitted images, in the order of the URDF."""
    m = c.fit.measurements
    chosen = _is_image(c) & m.estimation
    if not np.any(chosen):
        chosen = _is_image(c)
    q = m.joints_for(c.nominal.joint_names)[chosen]
    values = c.nominal.input_values(np.unique(q, axis=0)).T
    spans = [
        JointSpan(
            joint.name, joint.type == "prismatic", of_joint, _limits(joint.lower, joint.upper)
        )
        for joint, of_joint in zip(c.nominal.inputs, values, strict=True)
    ]
    # A chain from a camera on the hand to the board has them from the hand to the base.
    order = [joint.name for joint in c.nominal.urdf.joints]
    return tuple(sorted(spans, key=lambda span: order.index(span.name)))


def _limits(lower: float | None, upper: float | None) -> tuple[float, float]:
    """Return limits as numbers; NaN for one that is not given."""
    return (
        float("nan") if lower is None else lower,
        float("nan") if upper is None else upper,
    )
