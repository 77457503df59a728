"""Frames that a calibration estimated, fixed to links of the robot: a camera's optical frame, and a board's.

A camera is a measurement frame, carried by its link, the chain's first (base); a board is a target, carried by its
link, the chain's last (tip):

    T_link_optical = T_frame_base^-1        T_link_board = T_tip_target
"""

from __future__ import annotations

from dataclasses import dataclass

from calib.basics.arrays import Array, read_only, rigid_inverse
from calib.basics.values import Value
from calib.errors import CalibError, ModelError, choices, did_you_mean
from calib.model.parameter_sets import DIRECTIONS
from calib.result.calibration import Calibration
from calib.verbs.convert.format import CameraOptions


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
        ModelError: There is no such camera, there are several and none is named, or no measurement determines its pose.
    """
    setup = calibration.setup
    index = index_of("camera", "--camera", name, setup.groups)
    is_estimated = len(setup.unknown[index]) == len(DIRECTIONS)
    if not (is_estimated or setup.frame_given[index] or calibration.rows.tells_place):
        raise ModelError(
            f"No measurement in this result determines the pose of the camera '{setup.groups[index]}': its kinds are "
            f"{choices(dict.fromkeys(calibration.rows.kinds))}. Calibrate with pictures of a board, kind 'pixel'."
        )
    T_link_optical = rigid_inverse(setup.T_frame_base[index])
    link = setup.frame_links[index] if setup.frame_links else calibration.robot.base
    return EstimatedFrame(setup.groups[index], link, read_only(T_link_optical))


def estimated_board(calibration: Calibration, name: str | None = None) -> EstimatedFrame:
    """Return the frame of a board in the link that carries it, the chain's last.

    Args:
        calibration: The calibration.
        name: Name of the board; None: the only one.

    Raises:
        ModelError: There is no such board, there are several and none is named, or it is a point without orientation.
    """
    setup = calibration.setup
    index = index_of("board", "--board", name, setup.targets)
    if not setup.oriented:
        raise ModelError(
            f"The target '{setup.targets[index]}' of this result is a point: its orientation was not measured, so it "
            "has no frame. Leave out the board's link."
        )
    T_link_board = setup.T_tip_target[index]
    link = setup.target_links[index] if setup.target_links else calibration.robot.tip
    return EstimatedFrame(setup.targets[index], link, read_only(T_link_board))


def index_of(what: str, option: str, name: str | None, names: tuple[str, ...]) -> int:
    """Return the index of a name among all names, from 0.

    Args:
        what: Kind of thing that is named, for messages: ``"camera"``.
        option: The option that names it, for messages.
        name: The name; None: the only one.
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


def check_names(options: CameraOptions) -> None:
    """Refuse names of links, of a board or of a joint that do not go together, or no link at all.

    Args:
        options: The names for the hand-over of a camera.

    Raises:
        CalibError: They do not; the message says which to give.
    """
    if options.camera_frame is not None and options.new_camera_frame is not None:
        raise CalibError(
            "--camera-frame names a link that the URDF has, --new-camera-frame one that it lacks; give one of them."
        )
    if options.move is not None and options.camera_frame is None:
        raise CalibError(
            f"--move {options.move}: name the link of the optical frame that the joint moves, --camera-frame LINK."
        )
    if options.board is not None and options.new_board_frame is None:
        raise CalibError(
            f"--board {options.board}: name the link that is added there, --new-board-frame NAME."
        )
    if (options.parent is None) != (options.child is None):
        raise CalibError(
            "A transform is from a parent to a child: give both --parent NAME and --child NAME, names of cameras or "
            "other stations, boards or other targets, further robots, or links."
        )
    frames = (options.camera_frame, options.new_camera_frame, options.new_board_frame)
    if options.parent is not None:
        if any((*frames, options.move, options.camera, options.board)):
            raise CalibError(
                "--parent and --child name a transform by themselves; leave out the names of camera, board and joint."
            )
        return
    if not any(frames):
        raise CalibError(
            "Name the link of the camera's optical frame: --camera-frame LINK with --move JOINT if the URDF has the "
            "camera, --new-camera-frame NAME if it does not."
        )
