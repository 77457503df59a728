"""A camera that was moved, or refocused, from some picture on: steps in the residuals of a fit.

Larger changes are found before the fit (`calib.diagnosis.picture_mistakes`). What a fit leaves of a small one is a step
along the camera's own displacement, or along the focal lengths and the centre of its lens. A board that moved leaves
another one, and of the three that is named which explains most for the numbers that it takes.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.basics.arrays import Array, Integers, rigid_inverse
from calib.camera.optics import FOCAL
from calib.diagnosis.augmented_fit import gain_on_blocks
from calib.diagnosis.patterns import Explained, Stack, Step, drift, step
from calib.diagnosis.reasons import Reason, Why
from calib.diagnosis.residuals import Residuals
from calib.model.kinematics import Kinematics
from calib.model.parameter_sets import DIRECTIONS, error_model

#: Columns of the internals that a change of focus moves: focal lengths and centre.
_FOCUS = slice(FOCAL.start, FOCAL.stop + 2)


def changed_cameras(
    residuals: Residuals, stack: Stack, images: tuple[str, ...]
) -> Iterator[tuple[Reason, Array]]:
    """Find the picture from which on a camera stands elsewhere, or has another focal length.

    Args:
        residuals: Of a fit to N rows.
        stack: Its M whitened scalars.
        images: Name of the picture of each row.

    Yields:
        A reason `Why.CAMERA_MOVED` or `Why.CAMERA_REFOCUSED` for each camera, and the regressors of the step, shape (M,
        k).
    """
    fitted = residuals.fitted
    rows, setup = fitted.estimate.problem.rows, fitted.setup
    in_stack = np.isin(np.arange(len(rows)), stack.row_of)
    for f, group in enumerate(setup.groups):
        of_camera = rows.has_views & (rows.samples.frame == f)
        if not np.any(of_camera & in_stack):
            continue
        places = _first_rows(rows.blocks, of_camera & in_stack)
        by_place, by_focus = _displacements(residuals, f)
        target = int(np.bincount(rows.samples.target[of_camera]).argmax())
        of_target = residuals.whitened[:, residuals.of_target(target)]
        steps = {
            Why.CAMERA_MOVED: step(stack, places, residuals.whiten(by_place)),
            Why.CAMERA_REFOCUSED: step(stack, places, residuals.whiten(by_focus)),
            Why.TARGET_STEP: step(stack, places, of_target),
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
        yield _reason(residuals, jump, why, columns, of_camera, images, group), jump.Z


def _first_rows(blocks: Integers, rows: Array) -> Integers:
    """Return the first row of each view, (V,), among some rows, a mask (N,); the rows of a view have one block, (N,)."""
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
        targets=(),
        gravity=fitted.task.cell.gravity,
    )
    kinematics = Kinematics(fitted.task.robot, model, setup.T_frame_base, setup.T_tip_target)
    of_camera = (rows.samples.frame == f)[:, None, None]
    by_place = rows.derivative(kinematics.linearised(np.zeros(len(model)), rows.samples))
    sightings = setup.sightings(fitted.task.robot.poses(rows.joints), rows.samples)
    by_focus = rows.derivative_by_internals(sightings)[:, :, _FOCUS]
    return by_place * of_camera, by_focus * of_camera


def _reason(
    residuals: Residuals,
    jump: Step,
    why: Why,
    columns: Array,
    of_camera: Array,
    images: tuple[str, ...],
    group: str,
) -> Reason:
    """Make the reason of a step in the residuals along the columns, (N, D, k), at the rows of a camera, (N,)."""
    fitted = residuals.fitted
    later = np.arange(len(residuals.weights)) >= jump.row
    concerned = list(dict.fromkeys(images[i] for i in np.flatnonzero(later & of_camera).tolist()))
    every = {images[i] for i in np.flatnonzero(of_camera).tolist()}
    size: dict[str, float] = {}
    if why is Why.CAMERA_MOVED:
        # The twist is that of the base in the camera, at the base's origin: what counts is where the camera stands.
        f = int(fitted.estimate.problem.rows.samples.frame[np.argmax(of_camera)])
        place = rigid_inverse(fitted.estimated_setup().T_frame_base[f])[:3, 3]
        size = {
            "moved_m": float(np.linalg.norm(jump.by[:3] + np.cross(jump.by[3:], place))),
            "moved_rad": float(np.linalg.norm(jump.by[3:])),
        }
    else:
        internals = fitted.estimate.problem.rows.samples.internals
        assert internals is not None
        focal = internals[np.argmax(of_camera), FOCAL]
        size = {"share": float(np.mean(jump.by[:2] / focal))}
    return Reason.of(
        why,
        camera=group if len(fitted.setup.groups) > 1 else "",
        off=len(concerned),
        of=len(every),
        first=concerned[0] or f"row {residuals.numbers[jump.row]}",
        named=concerned,
        **size,
        left_out=False,
        falls=gain_on_blocks(fitted, later[:, None, None] * columns, residuals.weights),
        explained=jump.test.share,
        p=jump.test.p,
    )
