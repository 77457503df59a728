"""Sensitivity of images of a board to the parameters that a fit will estimate: of robot, mount, board and lens.

The c corners of an image depend on the parameters by the board's motion in the camera (6) and by a few numbers of lens
and print (k - 6) alone. With the derivative J of their images by these, (2 c, k), in standard deviations of the noise,
and the derivative D of these by the parameters, (k, p),

    A = J D,    A^T A = (R D)^T (R D),    J = Q R

so that k rows, R D, stand for the 2 c rows of an image. The robot's repeatability moves all corners of an image alike,
by a translation with the standard deviation r along each axis: with B = r R_t, the columns of R by translations,

    A -> L^-1 R D,    L L^T = I + B B^T

The corners' own errors on the print are left out: each is seen in many images, and known well after a few.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Array, read_only
from calib.basics.channels import RESIDUAL_UNITS
from calib.camera import optics as optics_columns
from calib.camera.camera import UNKNOWN, Camera
from calib.camera.lenses import LENSES
from calib.data.cell import Cell, TrackerNoise
from calib.data.measurements import Measurements
from calib.fit.registration.setup import Setup
from calib.fit.registration.table_optics import initial_optics
from calib.fit.registration.table_setup import measurement_setup
from calib.model.kinematics import Kinematics
from calib.robot.kernel import over_blocks
from calib.robot.robot import Robot
from calib.verbs.plan.images.sight import CameraSight, intrinsics, transformed
from calib.verbs.plan.notes import Note
from calib.verbs.plan.sensitivity import Sensitivity, planned_model, prior_precision

#: Kind of measurement.
PIXEL = "pixel"

#: Images whose derivatives by lens and board are held at a time.
_AT_A_TIME = 128


@dataclass(frozen=True, slots=True, eq=False)
class ImageSensitivity(Sensitivity):
    """Model of a robot, a camera and a board, as the fit of images will use it; p is the number of parameters."""

    #: The camera, the board, and where they are.
    sight: CameraSight
    #: Shape (c, `calib.camera.optics.COUNT`), numbers of lens and board of each corner.
    optics: Array

    @classmethod
    def of_images(cls, robot: Robot, cell: Cell, sight: CameraSight) -> ImageSensitivity:
        """Make the model of a robot with a camera and a board.

        Args:
            robot: The nominal robot, from the camera's link to the board's link.
            cell: The measurement setup that the fit will use: noise, priors, error model. Its only camera may lack
                intrinsics: then they are all unknown, and assumed to be those of ``sight``.
            sight: The camera, with intrinsics, and the board, and where they are.

        Returns:
            The model, whose derivatives are taken at the nominal robot; mount, board and lens are unknown as they will
            be in the fit. ``notes`` say what was assumed.

        Raises:
            ModelError: A parameter that the model does not have, or there is no such model.
        """
        cell = replace(
            cell,
            kind=PIXEL,
            cameras={"": _as_known(cell, sight)},
            boards={"": replace(sight.board, sigma_corner=0.0)},
            distances=(),
        )
        table = _one_image(robot, sight)
        pose = np.zeros(len(table), dtype=np.int_)
        setup = measurement_setup(cell, table, (registry.get(PIXEL),), pose)
        optics, unknowns = initial_optics(table, cell, setup, pose)
        assert optics is not None
        setup = replace(setup, optics=unknowns)
        setup = setup.with_poses(sight.T_frame_base[None], sight.T_tip_board[None])
        return cls._assembled(robot, cell, setup, sight, optics)

    @classmethod
    def _assembled(
        cls, robot: Robot, cell: Cell, setup: Setup, sight: CameraSight, optics: Array
    ) -> ImageSensitivity:
        """Put the model together; see `of_images`."""
        model = planned_model(robot, cell, setup)
        optical = {unknown.parameter.name: unknown.sigma for unknown in setup.optics}
        return cls(
            cell=cell,
            kind=PIXEL,
            setup=setup,
            kinematics=Kinematics(robot, model, setup.T_frame_base, setup.T_tip_target),
            precision=read_only(prior_precision(cell, model, optical)),
            notes=_notes(cell),
            sight=sight,
            optics=optics,
        )

    def expected(self, q: Array) -> Array:
        """Predict where the board's centre is in the camera, by the nominal robot.

        Args:
            q: Joint values of N poses, shape (N, m), [rad] or for sliding joints [m].

        Returns:
            Shape (N, 1, 3), [m].
        """
        return self.sight.centres(self.sight.board_poses(self.kinematics.robot, q))[:, None]

    def measured(self, q: Array) -> Array:
        """Differentiate images by the parameters, whitened by the noise, the corners of an image as k rows.

        Args:
            q: Joint values of n poses, shape (n, m), [rad] or for sliding joints [m].

        Returns:
            Shape (n, k, p), in standard deviations of the noise per unit of the parameter; zero where no corner is in
            the image.
        """

        def work(block: slice) -> Array:
            """Return the derivatives at a slice of the poses."""
            return self._measured(q[block])

        starts = range(0, len(q), _AT_A_TIME)
        return np.concatenate([work(slice(start, start + _AT_A_TIME)) for start in starts])

    def _measured(self, q: Array) -> Array:
        """Differentiate n images; see `measured`."""
        T, twists = self.kinematics.twists(np.zeros(len(self.names)), self._samples(q))
        by_place = self._by_place(T)
        R = np.asarray(np.linalg.qr(by_place, mode="r"))
        shared = self._repeatability * R[:, :, :3]
        covariance = np.eye(R.shape[1]) + shared @ shared.swapaxes(1, 2)
        whitened = np.linalg.solve(np.linalg.cholesky(covariance), R)
        places = np.concatenate([twists, self._of_optics(len(q))], axis=1)
        return np.asarray(whitened @ places)

    def _by_place(self, T: Array) -> Array:
        """Differentiate images by the board's motion and by what is unknown of lens and board.

        Args:
            T: Poses of the board in the camera, shape (n, 4, 4), [m].

        Returns:
            Shape (n, 2 c, k), in standard deviations of the noise; zero for corners outside of the image.
        """
        corners = len(self.optics)
        rows = np.repeat(T, corners, axis=0)
        motions = np.broadcast_to(np.eye(6), (len(rows), 6, 6))
        by_motion, by_optics = optics_columns.image_derivatives(
            rows, motions, np.tile(self.optics, (len(T), 1))
        )
        by_place = np.concatenate([by_motion, by_optics[:, :, self._columns]], axis=2)
        seen = self.sight.visible(T, self.sight.board.corners).reshape(-1, 1, 1)
        by_place = np.where(seen, by_place / self._sigma, 0.0)
        return np.asarray(by_place.reshape(len(T), 2 * corners, -1))

    @property
    def _columns(self) -> list[int]:
        """Columns of `calib.camera.optics` that are unknown."""
        return [
            parameter.optic
            for _, parameter in self.kinematics.model.optical
            if parameter.optic is not None
        ]

    def _of_optics(self, count: int) -> Array:
        """Return the derivative of the unknown numbers of lens and board by the parameters, shape (count, k - 6, p)."""
        numbers = [k for k, _ in self.kinematics.model.optical]
        selected = np.eye(len(self.names))[numbers]
        return np.broadcast_to(selected, (count, *selected.shape))

    @property
    def _sigma(self) -> float:
        """Standard deviation of an image coordinate [px]."""
        return float(self.cell.sigma.get("px", RESIDUAL_UNITS["px"].assumed_sigma))

    @property
    def _repeatability(self) -> float:
        """Standard deviation of the board's place in the camera along one axis, by the robot's repeatability [m]."""
        tracker = self.cell.tracker
        noise = TrackerNoise() if tracker is None else tracker.noise
        return noise.repeatability

    def located(self, q: Array) -> Array:
        """Differentiate the predicted position of the board's centre in the camera by the p parameters.

        Args:
            q: Joint values of n poses, shape (n, m), [rad] or for sliding joints [m].

        Returns:
            Shape (n, 3, p), [m per unit of the parameter].
        """
        zero = np.zeros(len(self.names))

        def work(block: slice) -> Array:
            """Return the derivatives at a slice of the poses."""
            T, twists = self.kinematics.twists(zero, self._samples(q[block]))
            lever = transformed(T, self.sight.board.centre[None])[:, 0] - T[:, :3, 3]
            turned = np.cross(twists[:, 3:], lever[:, :, None], axis=1)
            return np.asarray(twists[:, :3] + turned)

        return np.concatenate(over_blocks(work, len(q)))

    def noise(self, q: Array) -> Array:
        """Return the standard deviation of an image coordinate at each pose, shape (n,), [px]."""
        return np.full(len(q), self._sigma)


def sensitivity_of(robot: Robot, cell: Cell, sight: CameraSight | None) -> Sensitivity:
    """Make the model of a plan: of images of a board where a camera is given, else of the cell's instrument.

    Args:
        robot: The nominal robot.
        cell: The measurement setup that the fit will use.
        sight: The camera and the board; None: there are none.
    """
    if sight is None:
        return Sensitivity.of(robot, cell)
    return ImageSensitivity.of_images(robot, cell, sight)


def _as_known(cell: Cell, sight: CameraSight) -> Camera:
    """Return the only camera with intrinsics, as uncertain as the fit will take them."""
    camera = next(iter(cell.cameras.values()))
    if camera.values is not None:
        return camera
    unknown = np.full(len(LENSES[sight.camera.lens].names), UNKNOWN)
    return replace(sight.camera, sigma=read_only(unknown))


def _notes(cell: Cell) -> tuple[Note, ...]:
    """Return what was assumed."""
    notes = []
    camera = cell.cameras[""]
    if camera.sigma is not None and np.all(np.isinf(camera.sigma)):
        notes.append(Note("camera_assumed", (float(intrinsics(camera)[0]),)))
    if "px" not in cell.sigma:
        notes.append(Note("image_noise", (RESIDUAL_UNITS["px"].assumed_sigma,)))
    return tuple(notes)


def _one_image(robot: Robot, sight: CameraSight) -> Measurements:
    """Return a table of one image, in which all corners are seen; what was measured does not matter."""
    corners = sight.board.corners
    count = len(corners)
    centre = 0.5 * np.array([sight.camera.width, sight.camera.height])
    return Measurements(
        joint_names=robot.joint_names,
        joints=np.zeros((count, len(robot.joint_names))),
        points=np.full((count, 3), np.nan),
        kinds=(PIXEL,) * count,
        readings={"u": np.full(count, centre[0]), "v": np.full(count, centre[1])},
        board_points=corners,
        corners=tuple(map(str, range(count))),
        prismatic=tuple(joint.name for joint in robot.inputs if joint.type == "prismatic"),
    )
