"""Frames and targets that were stated, and are a little elsewhere: what that does to a fit.

The rows then measure A x + Z b, with the displacement b of a frame or target and its derivative Z. A fit that takes the
place as exact is off by G b, as its parameters make up for b as well as they can; a predicted pose is off by
(Z - J G) b. Of what the arm can make up for, little is left at poses like the measured ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, Mask, read_only
from calib.basics.values import Value
from calib.diagnosis.augmented_fit import augment, thin
from calib.fit.estimate.fitting import Fitted
from calib.model.kinematics import Sightings
from calib.result.row_scatter import UNITS


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StatedPlace(Value):
    """A frame or a target whose place was stated."""

    #: True for a frame, False for a target
    is_frame: bool
    #: Its index, from 0
    index: int
    #: Shape (p, 6), change of the parameters by a unit of its displacement, along then about the axes of the frame (of
    #: a target those of the target, which turns about itself), if the fit takes it as exact [1/m, 1/rad]
    absorbed: Array
    #: Shape (2, 6), mean square of what is left of such a unit in the residuals of the rows, of a scalar in metres and
    #: of one in radians
    on_rows: Array


def stated_places(fitted: Fitted) -> tuple[StatedPlace, ...]:
    """Return the stated frames and targets of a fit whose uncertainty the cell states.

    Args:
        fitted: The fit.

    Returns:
        One for each frame, and each target, that is not estimated; empty if nothing is stated of their uncertainty.
    """
    stated = fitted.task.cell.uncertainty
    few, _ = thin(fitted)
    rows, setup = few.estimate.problem.rows, few.setup
    places = []
    if stated.frame > 0.0 or stated.frame_angle > 0.0:
        known = [k for k, directions in enumerate(setup.unknown) if not directions]
        places += [(True, k, rows.samples.frame == k) for k in known]
    if stated.target > 0.0:
        known = np.flatnonzero(~setup.target_unknown).tolist()
        places += [(False, k, rows.samples.target == k) for k in known]
    result = []
    for is_frame, index, seen in places:
        if np.any(seen):
            absorbed, on_rows = _absorbed(few, seen, is_frame=is_frame)
            result.append(
                StatedPlace(is_frame=is_frame, index=index, absorbed=absorbed, on_rows=on_rows)
            )
    return tuple(result)


def _absorbed(fitted: Fitted, seen: Mask, *, is_frame: bool) -> tuple[Array, Array]:
    """Return what parameters change by if the frame or target of rows, a mask (N,), is displaced, (p, 6).

    And what of it is left in the residuals, as mean squares of scalars in metres and in radians, (2, 6).
    """
    rows = fitted.estimate.problem.rows
    T = fitted.kinematics.poses(fitted.estimate.x, rows.samples)
    origins = fitted.estimated_setup().T_frame_base[rows.samples.frame][:, :3, 3]
    columns = rows.derivative(Sightings(T, displaced(T, origins, is_frame=is_frame)))
    columns[~seen] = 0.0
    # The fit to what Z b adds to the rows: C A^T W Z.
    estimate = fitted.estimate
    equations = augment(fitted, columns).normal_equations(
        estimate.problem.weights[None], estimate.problem.stop_shares
    )
    products = np.einsum("c,cpq->pq", np.asarray(estimate.noise) ** -2.0, equations.H[0])
    count = len(estimate.x)
    absorbed = estimate.covariance @ products[:count, count:]
    left = columns - estimate.problem.prediction_jacobian(estimate.x) @ absorbed
    on_rows = np.zeros((2, columns.shape[2]))
    for k, unit in enumerate(UNITS):
        chosen = rows.channels.where(unit)
        if np.any(chosen):
            on_rows[k] = np.mean(left[chosen] ** 2, axis=0)
    return read_only(absorbed), read_only(on_rows)


def displaced(T: Array, origins: Array, *, is_frame: bool) -> Array:
    """Return what displacements of the base in a frame, or of a target on the tip, do to poses of the target.

    Args:
        T: Shape (N, 4, 4), the poses [m].
        origins: Shape (N, 3), origins of the base [m], about which it turns.
        is_frame: True for the base in its frame, along and about the frame's axes; False for a target, along and about
            its own.

    Returns:
        Shape (N, 6, 6), displacement [m] and turn [rad] along and about the frame's axes by each of the six.
    """
    result = np.zeros((len(T), 6, 6))
    if not is_frame:
        result[:, :3, :3] = result[:, 3:, 3:] = T[:, :3, :3]
        return result
    result[:, :3, :3] = result[:, 3:, 3:] = np.eye(3)
    arm = T[:, :3, 3] - origins
    result[:, :3, 3:] = np.cross(np.eye(3)[None], arm[:, None]).transpose(0, 2, 1)
    return result
