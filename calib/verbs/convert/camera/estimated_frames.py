"""Frames that a calibration estimated, fixed to links of the robot: a camera's optical frame, and a board's.

A camera is a measurement frame, which the chain's first link (base) carries; a board is a target, carried by its last
(tip):

    T_link_optical = T_frame_base^-1        T_link_board = T_tip_target
"""

from __future__ import annotations

from dataclasses import dataclass

from calib.basics.arrays import Array, read_only, rigid_inverse
from calib.basics.values import Value
from calib.errors import ModelError, choices, did_you_mean
from calib.model.error_model import DIRECTIONS
from calib.result.calibration import Calibration


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedFrame(Value):
    """A frame that a calibration estimated, fixed to a link."""

    #: Name of the camera or of the board.
    name: str
    #: The link that carries it.
    link: str
    #: Its pose in this link, shape (4, 4) [m].
    T_link_frame: Array


def estimated_camera(calibration: Calibration, name: str | None = None) -> EstimatedFrame:
    """Return the optical frame of a camera in the link that carries it, the chain's first.

    It belongs to the corrected robot.

    Args:
        calibration: The calibration.
        name: Name of the camera; None: the only one.

    Raises:
        ModelError: There is no such camera, there are several and none is named, or no measurement tells its pose.
    """
    setup = calibration.setup
    index = index_of("camera", "--camera", name, setup.groups)
    is_estimated = len(setup.unknown[index]) == len(DIRECTIONS)
    if not (is_estimated or setup.frame_given[index] or calibration.rows.tells_place):
        raise ModelError(
            f"No measurement of this result tells where the camera '{setup.groups[index]}' is: its kinds are "
            f"{choices(dict.fromkeys(calibration.rows.kinds))}. Calibrate with pictures of a board, kind 'pixel'."
        )
    T_link_optical = rigid_inverse(setup.T_frame_base[index])
    return EstimatedFrame(setup.groups[index], calibration.robot.base, read_only(T_link_optical))


def estimated_board(calibration: Calibration, name: str | None = None) -> EstimatedFrame:
    """Return the frame of a board in the link that carries it, the chain's last.

    Args:
        calibration: The calibration.
        name: Name of the board; None: the only one.

    Raises:
        ModelError: There is no such board, there are several and none is named, or its orientation is not known.
    """
    setup = calibration.setup
    index = index_of("board", "--board", name, setup.targets)
    if not setup.oriented:
        raise ModelError(
            f"The target '{setup.targets[index]}' of this result is a point: its orientation was not measured, so that "
            "it has no frame. Leave out the board's link."
        )
    T_link_board = setup.T_tip_target[index]
    return EstimatedFrame(setup.targets[index], calibration.robot.tip, read_only(T_link_board))


def index_of(what: str, option: str, name: str | None, names: tuple[str, ...]) -> int:
    """Return the place of a name among all; of None that of the only one.

    Args:
        what: What is named, for messages: ``"camera"``.
        option: The option that names it, for messages.
        name: The name.
        names: All names.

    Raises:
        ModelError: There is none of this name, or several and none is named.
    """
    if name is None:
        if len(names) > 1:
            raise ModelError(
                f"There are {len(names)} {what}s: {choices(names)}; name one with {option}."
            )
        return 0
    if name not in names:
        raise ModelError(
            f"There is no {what} '{name}'{did_you_mean(name, names)}; there is {choices(names)}."
        )
    return names.index(name)
