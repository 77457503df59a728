"""Usual mistakes of poses of the flange: the inverse pose, and orientations of another convention.

Each is undone in a trial, in which frames and targets are registered again. Numbers of one convention read as those of
another one give rotations; read back by the wrong convention and anew by the right one they are what was meant.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import permutations

import numpy as np

from calib.basics.arrays import Array, rigid_inverse
from calib.data.cell import Cell
from calib.data.forms.flange_poses import flange_joints
from calib.data.forms.orientations import find_convention
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Reason, Why
from calib.diagnosis.trials import misfit, poses_of_images, with_joints
from calib.errors import CalibError
from calib.fit.registration.table_rows import rows_and_setup
from calib.robot.flange import JOINTS, NAME
from calib.robot.robot import Robot

#: A mistake explains the rows if errors fall below this share.
_FAR_BETTER = 1.0 / 3.0

#: No robot's poses are this far off, nor is a camera that was calibrated by 1 % or so [m].
_BEYOND = 0.05

#: Conventions of three numbers that columns rx, ry, rz may have.
_THREE_NUMBERS = ("rotation-vector", "yaskawa", "staubli")

#: Rows that are looked at.
_ROWS = 60


def flange_mistakes(robot: Robot, cell: Cell, table: Measurements) -> Iterator[Reason]:
    """Find a mistake in the poses of the flange: one that explains the rows far better, or that they are far off.

    Args:
        robot: The robot that stands for the poses, between the links of frame and target.
        cell: The cell as given.
        table: The rows that are fitted: images, or points or poses.

    Yields:
        At most one reason, with the rms errors of the target's position as given and with the mistake undone [m].
    """
    if np.any(table.is_image):
        from_images = poses_of_images(robot, cell, table)
        if from_images is None:
            return
        table, cell = from_images
    rows, setup = rows_and_setup(robot, table, cell)
    if not np.all(rows.where(lambda kind: kind.position)):
        return
    rows = rows.select(rows.evenly(_ROWS))
    order = [robot.joint_names.index(name) for name in JOINTS]
    T_base_flange = Robot.load(NAME).poses(rows.joints[:, order])

    def errors(T: Array) -> tuple[float, float]:
        """Return the errors of positions [m] and of orientations [rad] at other poses of the flange."""
        q = np.empty_like(rows.joints)
        q[:, order] = flange_joints(T[:, :3, 3], T[:, :3, :3])
        try:
            return misfit(robot, setup, with_joints(rows, q))
        except CalibError:
            return np.inf, np.inf

    given_m, given_rad = errors(T_base_flange)
    found = []
    for why, convention, change in _changes():
        error_m, error_rad = errors(change(T_base_flange))
        turned = np.isfinite(given_rad) and error_rad > _FAR_BETTER * given_rad
        if error_m < _FAR_BETTER * given_m and not turned:
            found.append((error_m, why, convention))
    if found:
        error_m, why, convention = min(found, key=lambda each: each[0])
        yield Reason.of(why, given_m=given_m, error_m=error_m, convention=convention)
    elif given_m > _BEYOND:
        yield Reason.of(Why.FLANGE_OFF, given_m=given_m)


def _changes() -> Iterator[tuple[Why, str, Callable[[Array], Array]]]:
    """Yield reason, convention ("" for none) and what undoes the mistake, (n, 4, 4) to (n, 4, 4) [m]."""
    yield Why.FLANGE_INVERSE, "", rigid_inverse
    for given, meant in permutations(_THREE_NUMBERS, 2):
        yield Why.FLANGE_CONVENTION, meant, _read_as(given, meant)
    for given, meant in permutations(("quaternion", "abb"), 2):
        yield Why.FLANGE_CONVENTION, meant, _read_as(given, meant)


def _read_as(given: str, meant: str) -> Callable[[Array], Array]:
    """Return the function that reads the numbers of poses anew, by another convention than the one given."""
    as_given, as_meant = find_convention(given), find_convention(meant)

    def change(T: Array) -> Array:
        """Return poses (n, 4, 4) [m] with orientations as they were meant."""
        result: Array = T.copy()
        result[:, :3, :3] = as_meant.matrices(as_given.numbers(T[:, :3, :3]))
        return result

    return change
