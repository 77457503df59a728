"""A virtual cell with a camera: the robot, the camera, the printed board and both mounts as they really are."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.basics.values import Value, one_line
from calib.boards.board import Board
from calib.boards.printed import Print, draw_print
from calib.camera.camera import Camera
from calib.data.cell import Cell
from calib.errors import CalibError
from calib.verbs.simulate.camera.equipment import draw_camera
from calib.verbs.simulate.camera.mounts import pose
from calib.verbs.simulate.camera.placing import Mounts, draw_scene
from calib.verbs.simulate.camera.scene import CameraScene
from calib.verbs.simulate.camera.views import draw_views
from calib.verbs.simulate.random_streams import stream
from calib.verbs.simulate.scenario import Scenario
from calib.verbs.simulate.truth import Truth, draw_truth


@dataclass(frozen=True, slots=True, eq=False)
class CameraCell(Value):
    """A robot with known errors, a camera and a board."""

    #: What is measured, and what disturbs it.
    scenario: Scenario
    #: The robot with its errors; its one frame is the camera, its one target the board.
    truth: Truth
    #: The camera as it is stated.
    stated: Camera
    #: The camera as it is.
    camera: Camera
    #: The board as it is.
    printed: Print

    def __repr__(self) -> str:
        """Return one line: what it was drawn out of."""
        return one_line("CameraCell", repr(self.scenario))

    @property
    def scene(self) -> CameraScene:
        """The nominal robot before the true camera: what views are planned with."""
        return CameraScene(
            self.truth.nominal,
            self.camera,
            self.printed,
            self.truth.T_frame_base[0],
            self.truth.T_tip_target[0],
        )

    def views(self, count: int, seed: int, *, validation: bool = False) -> Array:
        """Draw readings at which the camera sees the whole board, by the nominal robot.

        Args:
            count: Number of views.
            seed: Of the random numbers.
            validation: Whether they are to validate with, which have random numbers of their own.

        Returns:
            shape (count, m), [rad] or [m].

        Raises:
            CalibError: Too few were found.
        """
        if count == 0:
            return np.empty((0, len(self.truth.nominal.joint_names)))
        purpose = "validation views" if validation else "views"
        return draw_views(self.scene, count, stream(seed, purpose))


def draw_camera_cell(scenario: Scenario, camera: Camera, board: Board, seed: int) -> CameraCell:
    """Draw a virtual cell with a camera.

    Args:
        scenario: The robot, between the link that carries the camera and the one that carries the board, and the sizes
            of its errors.
        camera: The camera as it is stated.
        board: The board as it is described.
        seed: Of the random numbers.

    Returns:
        The cell. How good its camera and its print are is drawn as their standard deviations say; where they stand, if
        the scenario's cell does not give it, as `calib.verbs.simulate.camera.placing.draw_scene` does.

    Raises:
        CalibError: Both links move, or the board is seen from nowhere; or as `calib.verbs.simulate.truth.draw_truth`.
    """
    truth = draw_truth(
        scenario.robot,
        scenario.model,
        scenario.sizes,
        seed,
        cell=scenario.cell,
        errors=dict(scenario.errors),
        true_robot=scenario.true_robot,
    )
    true_camera = draw_camera(camera, stream(seed, "camera"))
    printed = draw_print(board, stream(seed, "board"))
    mounts = given_mounts(scenario.cell)
    scene = draw_scene(scenario.robot, true_camera, printed, stream(seed, "mounts"), mounts)
    placed = replace(
        truth,
        groups=("",),
        T_frame_base=read_only(scene.T_camera_base[None]),
        targets=(board.name,),
        T_tip_target=read_only(scene.T_tip_board[None]),
        stated_T_tip_target=read_only(scene.T_tip_board[None]),
    )
    return CameraCell(scenario, placed, camera, true_camera, printed)


def given_mounts(cell: Cell) -> Mounts:
    """Return the mounts that a cell gives: its measurement frame is the camera, its target the board.

    Raises:
        CalibError: It gives the board's position, and not how it is turned.
    """
    T_camera_base = cell.T_frame_base
    if len(cell.frames) == 1:
        T_camera_base = next(iter(cell.frames.values()))
    position = cell.target
    if len(cell.targets) == 1:
        position = next(iter(cell.targets.values()))
    if position is None:
        return Mounts(T_camera_base=T_camera_base)
    if cell.target_rotation is None:
        raise CalibError(
            "The cell gives the position of the board in its link, and not how it is turned: add target_rpy_deg, or "
            "leave both out, and the board's place is drawn."
        )
    T_tip_board = pose(cell.target_rotation, position)
    return Mounts(T_camera_base=T_camera_base, T_tip_board=T_tip_board)
