"""The steps of a page of robots at a table: each is a row, or of images all corners of one board in one image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.basics.arrays import Array, Integers, Mask, read_only, rigid_inverse
from calib.data.measurements import Measurements
from calib.fit.registration.labels import same_poses
from calib.robot.robot import Robot
from calib.show.scene.posed_robot import root_poses
from calib.verbs.evaluate.evaluation import Evaluation

#: Largest number of steps that are shown: the page stays quick.
MOST_STEPS = 400

#: Of `MOST_STEPS`, the number that is kept free for flagged steps.
_FLAGGED_STEPS = 50

#: A link whose pose in the root changes by less than this between two poses of the robot does not move.
_STILL = 1e-9


def seen_from_root(e: Evaluation) -> Evaluation:
    """Reverse the chain of an evaluation if its base moves and its tip does not, as with a camera on the hand.

    The robot then stands on its foot; the board is the measurement frame, which stands still, and the camera is the
    target, which the hand carries: T_target_tip becomes a T_frame_base, and T_base_frame a T_tip_target.

    Args:
        e: The evaluation of a robot; any other one, and one of several chains, is returned as it is.
    """
    robot = e.robot
    if robot.branches or not _moves(robot, robot.base) or _moves(robot, robot.tip):
        return e
    m = e.measurements
    old = e.setup
    setup = replace(
        old,
        groups=old.targets,
        targets=old.groups,
        T_frame_base=read_only([rigid_inverse(T) for T in old.T_tip_target]),
        T_tip_target=read_only([rigid_inverse(T) for T in old.T_frame_base]),
        unknown=tuple(() for _ in old.targets),
        frame_given=np.ones(len(old.targets), dtype=bool),
        target_unknown=np.zeros(len(old.groups), dtype=bool),
        target_given=np.ones(len(old.groups), dtype=bool),
        own_axes=np.zeros(len(old.targets), dtype=bool),
    )
    return replace(
        e,
        robot=robot.rebuilt(base=robot.tip, tip=robot.base),
        measurements=replace(m, groups=m.targets, targets=m.groups),
        setup=setup,
    )


def _moves(robot: Robot, link: str) -> bool:
    """Return whether joints of the chain move a link in the root of the URDF."""
    q = np.zeros((2, len(robot.inputs)))
    q[1] = 0.1
    T_root_link: Array = root_poses(robot, robot.readings(q))[link]
    return bool(np.max(np.abs(T_root_link[1] - T_root_link[0])) > _STILL)


def rows_of_steps(m: Measurements) -> tuple[Integers, ...]:
    """Group the rows of a table into steps: by image if all rows are corners in images, else each row by itself.

    Args:
        m: The table.

    Returns:
        Of each step the indices of its rows, from 0; the steps in the order of their first rows.
    """
    if not len(m) or not np.all(m.is_image):
        return tuple(np.arange(len(m))[:, None])
    pose = same_poses(m.joints)
    names = zip(m.images, pose.tolist(), m.groups, m.targets, strict=True)
    views: dict[tuple[str, int, str, str], list[int]] = {}
    for row, (image, number, group, target) in enumerate(names):
        views.setdefault((image, number, group, target), []).append(row)
    return tuple(np.array(of_view) for of_view in views.values())


def errors_by_unit(
    first: Evaluation, last: Evaluation, rows: Sequence[Integers]
) -> dict[str, Array]:
    """Compute the errors of two robots at N steps, rms over the rows of each.

    Args:
        first: The first robot's residuals.
        last: The second robot's at the same rows, or again the first's.
        rows: Of each step the indices of its rows, from 0.

    Returns:
        Shape (2, N), by the symbol of the unit; NaN if a step has no error in it.
    """
    errors = {}
    for unit in first.channels.present:
        norms = np.array([e.channels.norms(e.residual, unit) for e in (first, last)])
        of_steps = [np.sqrt(np.mean(norms[:, of_step] ** 2, axis=1)) for of_step in rows]
        errors[unit] = np.reshape(of_steps, (-1, 2)).T
    return errors


def typical_step(errors: Array, fitted: Mask) -> int:
    """Return the index of the step that is shown first: the one whose errors, of both robots, are nearest the median.

    For each robot the steps are ranked by error. The step is chosen whose larger distance from the middle rank, of the
    two robots', is least.

    Args:
        errors: shape (2, N), in one unit; NaN where none was measured.
        fitted: shape (N,), True for steps that were fitted and not flagged; the choice is among these, if any of them
            has an error.

    Returns:
        The index, from 0; the first of equal ones, and 0 if no step has an error.
    """
    is_known = np.all(np.isfinite(errors), axis=0)
    steps = np.flatnonzero(is_known & fitted)
    if not len(steps):
        steps = np.flatnonzero(is_known)
    if not len(steps):
        return 0
    ranks = errors[:, steps].argsort(axis=1).argsort(axis=1)
    from_middle = np.abs(ranks - 0.5 * (len(steps) - 1)).max(axis=0)
    return int(steps[from_middle.argmin()])


def choose_steps(flagged: Mask, start: int) -> Integers:
    """Return the ascending indices, from 0, of the steps that are shown.

    They are all up to `MOST_STEPS`, otherwise the one that is shown first, the first flagged ones, and an even choice.

    Args:
        flagged: shape (N,), True for flagged steps.
        start: Index of the step that is shown first.
    """
    count = len(flagged)
    if count <= MOST_STEPS:
        return np.arange(count)
    evenly = np.linspace(0, count - 1, MOST_STEPS - _FLAGGED_STEPS).round().astype(int)
    first_flagged = np.flatnonzero(flagged)[: _FLAGGED_STEPS - 1]
    return np.unique([start, *first_flagged, *evenly])
