"""Cameras and boards of virtual cells: usual ones, and true ones drawn around stated ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.basics.values import Value
from calib.boards.board import BODY, CHARUCO, Board
from calib.boards.printed import Print, draw_print
from calib.camera.camera import Camera
from calib.camera.lenses import LENSES
from calib.data.cell import Cell
from calib.errors import CalibError
from calib.robot.robot import Robot
from calib.verbs.simulate.mounting import reach
from calib.verbs.simulate.random_streams import stream

#: Numbers of the usual camera: fx, fy, cx, cy [px], k1, k2, p1, p2, k3.
_USUAL = read_only((920.0, 920.0, 639.5, 359.5, 0.1, -0.2, 0.0, 0.0, 0.1))

#: Focal length of a camera without stated numbers, as a share of the image's width.
_FOCAL = (0.65, 0.95)

#: Standard deviation of its first radial coefficient of distortion.
_RADIAL = 0.05

#: Square of the usual board, as a share of the arm's reach, and its least and largest length [m].
_SQUARE = 0.04
_SQUARES = (0.012, 0.04)

#: Ratio of the standard deviations of a coefficient of a fisheye lens and of the one before.
_HIGHER = 0.5

#: Largest number of draws of a lens that does not fold the image.
_DRAWS = 100

#: Number of angles from the axis at which a lens is examined, and the largest one [rad].
_ANGLES = 400
_WIDEST = float(np.deg2rad(85.0))


@dataclass(frozen=True, slots=True, eq=False)
class Equipment(Value):
    """The true cameras and boards of a virtual cell."""

    #: The camera of each station as stated.
    stated_cameras: tuple[Camera, ...]
    #: The same cameras with their true numbers.
    cameras: tuple[Camera, ...]
    #: The board of each target as printed.
    prints: tuple[Print, ...]

    @property
    def stated(self) -> Camera:
        """The only camera as stated, or the first one."""
        return self.stated_cameras[0]

    @property
    def camera(self) -> Camera:
        """The only camera, or the first one, with its true numbers."""
        return self.cameras[0]

    @property
    def printed(self) -> Print:
        """The only board, or the first one, as printed."""
        return self.prints[0]


def draw_equipment(
    robot: Robot,
    cell: Cell,
    seed: int,
    groups: Sequence[str] = ("",),
    targets: Sequence[str] = ("",),
) -> Equipment:
    """Draw cameras and boards around those that a cell states, or around usual ones, by their standard deviations.

    Args:
        robot: The chain between the links of camera and board, whose reach gives the size of a usual board.
        cell: Its cameras and boards; one without a name is that of all that have none of their own.
        seed: Of the random numbers.
        groups: Names of the stations.
        targets: Names of the targets.

    Returns:
        The stated camera of each station, the true one, and the board of each target as it is printed.

    Raises:
        CalibError: A board is a body of tags.
    """
    # One without a name is moved from station to station, or from target to target, as the fit takes it.
    of_groups = [name if name in cell.cameras else "" for name in groups]
    of_targets = [name if name in cell.boards else "" for name in targets]
    random = stream(seed, "camera")
    stated = {name: cell.cameras.get(name) or usual_camera() for name in of_groups}
    cameras = {name: draw_camera(camera, random) for name, camera in stated.items()}
    random = stream(seed, "board")
    boards = {name: cell.boards.get(name) or usual_board(robot) for name in of_targets}
    for board in boards.values():
        if board.pattern == BODY:
            raise CalibError(
                f"The board '{board.name}' is a body of tags, whose far tags a camera does not see; pictures are "
                "simulated of flat boards. Give a flat board of about that size."
            )
    prints = {name: draw_print(board, random) for name, board in boards.items()}
    return Equipment(
        stated_cameras=tuple(stated[name] for name in of_groups),
        cameras=tuple(cameras[name] for name in of_groups),
        prints=tuple(prints[name] for name in of_targets),
    )


def usual_camera() -> Camera:
    """Return the usual camera, with its maker's numbers."""
    return Camera(width=1280, height=720, values=_USUAL)


def usual_board(arm: Robot) -> Board:
    """Return the usual ChArUco board of 7 by 5 squares, in proportion to the reach of the arm, within limits.

    Args:
        arm: The chain from the foot to the flange, or the other way.
    """
    # Whole millimetres.
    square = round(float(np.clip(_SQUARE * reach(arm), *_SQUARES)), 3)
    return Board(
        pattern=CHARUCO,
        columns=7,
        rows=5,
        square=square,
        marker=0.75 * square,
        dictionary="DICT_5X5_100",
    )


def draw_camera(stated: Camera, rng: np.random.Generator) -> Camera:
    """Draw the true camera.

    Args:
        stated: The camera as stated: its true numbers are drawn by their standard deviations; without numbers, usual
            ones are drawn.
        rng: Random numbers.

    Returns:
        The same camera with its true numbers, whose standard deviations are 0. A lens that folds the image, which no
        real lens does, is drawn again, a limited number of times.
    """
    for _ in range(_DRAWS):
        unit_normal = rng.standard_normal(len(LENSES[stated.lens].names))
        if stated.values is None:
            focal_length = float(rng.uniform(*_FOCAL)) * stated.width
            values = np.zeros(len(unit_normal))
            values[:2] = focal_length
            values[2:4] = (np.array([stated.width, stated.height]) - 1) / 2.0
            sigma = _usual_sigma(stated, values)
            sigma[:2] = [0.0, 1e-3 * focal_length]
            sigma[4] = _RADIAL
            values = values + sigma * unit_normal
        else:
            usual = _usual_sigma(stated, stated.values)
            sigma = usual if stated.sigma is None else stated.sigma
            # A number that is not known is drawn as if a maker had stated it.
            known = np.where(np.isfinite(sigma), sigma, usual)
            values = stated.values + known * unit_normal
        exact = np.zeros(len(values))
        camera = replace(stated, values=read_only(values), sigma=read_only(exact))
        if not folds(camera):
            break
    return camera


def folds(camera: Camera) -> bool:
    """Return whether the distortion folds inside the image: points farther off axis are imaged closer to the centre.

    Args:
        camera: A camera with numbers of its lens.
    """
    assert camera.values is not None
    slopes = np.tan(np.linspace(0.0, _WIDEST, _ANGLES))
    points = np.column_stack([slopes, np.zeros(_ANGLES), np.ones(_ANGLES)])
    radii = LENSES[camera.lens].project(points, camera.values)[:, 0] - camera.values[2]
    outside = radii >= 0.5 * np.hypot(camera.width, camera.height)
    seen = radii[: int(np.argmax(outside)) + 1] if np.any(outside) else radii
    return bool(np.any(np.diff(seen) <= 0.0))


def _usual_sigma(camera: Camera, values: Array) -> Array:
    """Return the standard deviations that a maker's numbers of a lens usually have, (k,), in the units of the numbers.

    For a fisheye lens those of higher powers are smaller. Otherwise they would bend the edge of the image, 1 rad and
    more from the axis, more than real lenses do.
    """
    sigma = LENSES[camera.lens].default_sigma(values, camera.width)
    if camera.lens == "fisheye":
        sigma[4:] *= _HIGHER ** np.arange(len(sigma) - 4)
    return sigma
