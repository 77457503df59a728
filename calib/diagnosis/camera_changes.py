"""What changed between pictures, by a quick fit: a camera that was moved or refocused, or joint values that are late.

Larger changes are found without a fit (`calib.diagnosis.picture_mistakes`). What a fit leaves of a small one is a step
along the camera's own displacement, or along the focal lengths and the centre of its lens. A board that moved leaves
another one, and of the three that is named which explains most for the numbers that it takes. The fit is one of the
whole geometry to some corners of each view, each where the print has it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from calib.basics.arrays import Array, Integers, Mask, rigid_inverse
from calib.camera.optics import FOCAL
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.augmented_fit import FEWEST_FREEDOM, PREDICTS, gain_on_blocks
from calib.diagnosis.judge import absurd_noise
from calib.diagnosis.late_joints import late_joints
from calib.diagnosis.patterns import Explained, Step, drift, step
from calib.diagnosis.picture_mistakes import Finding
from calib.diagnosis.reasons import Reason, Why
from calib.diagnosis.residual_patterns import lagging_joints
from calib.diagnosis.residuals import Residuals
from calib.errors import CalibError
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup
from calib.fit.selection.selection import some_rows
from calib.model.kinematics import Kinematics
from calib.model.parameter_sets import DIRECTIONS, error_model
from calib.robot.robot import Robot

#: The model of the quick fit.
_MODEL = "dh"

#: Late joints are the cause if held-out errors fall by more than this share with them.
_CAUSE = 0.3

#: Columns of the internals that a change of focus moves: focal lengths and centre.
_FOCUS = slice(FOCAL.start, FOCAL.stop + 2)


def changes_between_pictures(robot: Robot, cell: Cell, table: Measurements) -> tuple[Finding, ...]:
    """Find late joint values, or pictures from which on a camera stands elsewhere, or has another focal length.

    Args:
        robot: The nominal robot.
        cell: The cell as given.
        table: N rows, in the order in which they were measured. None is examined unless all are images.

    Returns:
        One finding, without rows, if joint values are late, or the noise is more than any camera's; else one a camera
        that changed, with the rows of those pictures before or after it that are fewer.
    """
    places = np.flatnonzero(table.estimation)
    if not len(places) or not np.all(table.is_image):
        return ()
    rows, setup = rows_and_setup(robot, table, cell)
    rows = rows.select(places)
    chosen = np.flatnonzero(some_rows(rows))
    rows, places = rows.select(chosen), places[chosen]
    frames, targets = setup.seen_by(rows.samples)
    kept = tuple(u for u in setup.internals if not u.parameter.of_one_point)
    setup = replace(setup.with_fixed(~frames, ~targets), internals=kept)
    try:
        fitted = fit(Task(robot, cell, setup, _MODEL, allow_absent=True), rows)
    except CalibError:  # the fits that follow say why
        return ()
    if fitted.estimate.freedom < FEWEST_FREEDOM:
        return ()
    q = table.joints_for(robot.joint_names)
    residuals = Residuals.of(
        fitted, np.array(table.rows)[places], table.moves_for(robot.joint_names)[places]
    )
    late = [
        *late_joints(fitted, q, places),
        *lagging_joints(residuals),
    ]
    for reason in late:
        if reason.values["falls"] > _CAUSE:
            return (Finding(reason, ()),)
    absurd = absurd_noise(fitted.estimate.sigma)
    if absurd is not None:  # larger models would take minutes, and mean as little
        return (Finding(absurd, ()),)
    return tuple(_changed_cameras(residuals, table, places))


def _changed_cameras(
    residuals: Residuals, table: Measurements, places: Integers
) -> Iterator[Finding]:
    """Yield the pictures before or after a change of each camera that changed; ``places``, (N,), are in the table."""
    fitted, stack = residuals.fitted, residuals.stack
    rows, setup = fitted.estimate.problem.rows, fitted.setup
    in_stack = np.isin(np.arange(len(rows)), stack.row_of)
    for f, group in enumerate(setup.groups):
        of_camera = rows.samples.frame == f
        if not np.any(of_camera & in_stack):
            continue
        first = _first_rows(rows.blocks, of_camera & in_stack)
        by_place, by_focus = _displacements(residuals, f)
        target = int(np.bincount(rows.samples.target[of_camera]).argmax())
        of_target = residuals.whitened[:, residuals.of_target(target)]
        steps = {
            Why.CAMERA_MOVED: step(stack, first, residuals.whiten(by_place)),
            Why.CAMERA_REFOCUSED: step(stack, first, residuals.whiten(by_focus)),
            Why.TARGET_STEP: step(stack, first, of_target),
        }
        found = {why: jump for why, jump in steps.items() if jump is not None}
        if not found:
            continue
        why, jump = min(found.items(), key=lambda entry: _cost(entry[1].test))
        drifting = drift(stack, residuals.order)
        drifts = drifting is not None and _cost(drifting) <= _cost(jump.test)
        if why is Why.TARGET_STEP or drifts:
            continue
        columns = by_place if why is Why.CAMERA_MOVED else by_focus
        later = np.arange(len(rows)) >= jump.row
        if gain_on_blocks(fitted, later[:, None, None] * columns, residuals.weights) < PREDICTS:
            continue
        in_camera = np.array([name == group for name in table.groups])
        from_there = in_camera & (np.arange(len(table)) >= places[jump.row])
        names = [
            list(dict.fromkeys(table.images[i] or str(table.rows[i]) for i in np.flatnonzero(side)))
            for side in (in_camera & ~from_there, from_there)
        ]
        fewer = min((0, 1), key=lambda side: (len(names[side]), side))
        chosen = (in_camera & ~from_there, from_there)[fewer]
        reason = Reason.of(
            why,
            camera=group if len(setup.groups) > 1 else "",
            off=len(names[fewer]),
            of=len(names[0]) + len(names[1]),
            first=names[1][0],
            named=names[fewer],
            **_size(residuals, jump, why, f),
        )
        yield Finding(reason, tuple(np.array(table.rows)[chosen].tolist()))


def _first_rows(blocks: Integers, rows: Mask) -> Integers:
    """Return the first row of each view, (V,), among some rows, a mask (N,); those of a view have one block, (N,)."""
    numbers = np.flatnonzero(rows)
    _, first = np.unique(blocks[numbers], return_index=True)
    return numbers[np.sort(first)]


def _cost(test: Explained) -> float:
    """Return what a test leaves of the residual with what its columns cost: Bayes' information criterion."""
    left = max(1.0 - test.share, np.finfo(float).tiny)
    return float(test.freedom * np.log(left) + test.columns * np.log(max(test.freedom, 2)))


def _displacements(residuals: Residuals, f: int) -> tuple[Array, Array]:
    """Differentiate the predicted scalars by the pose of camera f, (N, D, 6), and by its focus, (N, D, 4)."""
    fitted = residuals.fitted
    rows, setup = fitted.estimate.problem.rows, fitted.estimated_setup()
    names = tuple(setup.frame_unknowns)
    model = error_model(
        fitted.task.robot,
        "frames",
        frame={name: DIRECTIONS if k == f else () for k, name in enumerate(names)},
        targets=setup.target_names,
        gravity=fitted.task.cell.gravity,
    )
    kinematics = Kinematics(fitted.task.robot, model, setup.T_frame_base, setup.T_tip_target)
    of_camera = (rows.samples.frame == f)[:, None, None]
    derivative = rows.derivative(kinematics.linearised(np.zeros(len(model)), rows.samples))
    place = setup.places[0][f]
    by_place = derivative[:, :, [p.place == place for p in model.parameters]]
    T_base_tip = fitted.task.robot.poses(rows.joints, rows.samples.chain)
    sightings = setup.sightings(T_base_tip, rows.samples)
    by_focus = rows.derivative_by_internals(sightings)[:, :, _FOCUS]
    return by_place * of_camera, by_focus * of_camera


def _size(residuals: Residuals, jump: Step, why: Why, f: int) -> dict[str, float]:
    """Return how far camera f was moved [m] and turned [rad], or by what share its focal length changed."""
    fitted = residuals.fitted
    if why is Why.CAMERA_MOVED:
        # The twist is that of the base in the camera, at the base's origin: what counts is where the camera stands.
        place = rigid_inverse(fitted.estimated_setup().T_frame_base[f])[:3, 3]
        return {
            "moved_m": float(np.linalg.norm(jump.by[:3] + np.cross(jump.by[3:], place))),
            "moved_rad": float(np.linalg.norm(jump.by[3:])),
        }
    samples = fitted.estimate.problem.rows.samples
    assert samples.internals is not None
    focal = samples.internals[np.argmax(samples.frame == f), FOCAL]
    return {"share": float(np.mean(jump.by[:2] / focal))}
