"""Bundle adjustment of one camera: its intrinsics and the poses of flat boards in its views, by least squares.

The poses of the views are eliminated from the normal equations, which leaves those of the intrinsics (the Schur
complement; D. C. Brown, 1976), so that the time of an iteration grows with the number of views, not with its cube.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np

from calib.basics.arrays import Array
from calib.camera.lenses import Lens
from calib.camera.planar_pose import View, first_rows, moved, view_system

#: A view whose rms error is more than this many times the median is left out.
_FAR_OFF = 10.0

#: Relative fall of the sum of squares below which the refinement ends.
_SETTLED = 1e-5

#: Damping of the first step, its factors after a success and a failure, and the damping at which no step helps.
_DAMPING = 1e-3
_LESS = 0.1
_MORE = 10.0
_STUCK = 1e8

#: Damping of motions that views do not determine at all, over the trace of the normal equations.
_LEAST_DAMPING = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class _Normal:
    """Normal equations of V views: of the m intrinsics, and of the motions of the boards."""

    #: Sum of squares, those of the priors included [px^2]
    cost: float
    #: shape (m, m), of the intrinsics
    lens: Array
    #: shape (V, m, 6), between these and the motion of each board
    mixed: Array
    #: shape (V, 6, 6), of the motion of each board
    motion: Array
    #: shape (m,), right side of the intrinsics
    lens_side: Array
    #: shape (V, 6), right sides of the motions
    motion_side: Array

    def step(self, damping: float) -> tuple[Array, Array]:
        """Return the damped Gauss-Newton step: of the intrinsics, shape (m,), and of the motions, shape (V, 6)."""
        diagonal = np.diagonal(self.motion, axis1=1, axis2=2)
        least = _LEAST_DAMPING * np.sum(diagonal, axis=1, keepdims=True) + np.finfo(float).tiny
        motion = self.motion + (damping * diagonal + least)[:, :, None] * np.eye(6)
        of_mixed = np.linalg.solve(motion, self.mixed.transpose(0, 2, 1))
        of_side = np.linalg.solve(motion, self.motion_side[:, :, None])[:, :, 0]
        # The intrinsics need no least damping: their priors keep these equations regular.
        lens = self.lens + damping * np.diag(np.diagonal(self.lens))
        reduced = lens - np.sum(self.mixed @ of_mixed, axis=0)
        side = self.lens_side - np.einsum("vmi,vi->m", self.mixed, of_side)
        change = np.linalg.solve(reduced, side)
        return change, of_side - of_mixed @ change


@dataclass(frozen=True, slots=True, eq=False)
class Bundle:
    """A lens of m intrinsics with normal priors."""

    #: The lens model
    lens: Lens
    #: shape (m,), means of the priors
    mean: Array
    #: shape (m,), their standard deviations
    std: Array

    def normal(self, values: Array, T: Array, views: Sequence[View]) -> _Normal:
        """Return the normal equations.

        Args:
            values: shape (m,), the intrinsics.
            T: shape (V, 4, 4), T_camera_board of each view [m].
            views: The views.
        """
        residual, by_motion, by_values = view_system(T, views, self.lens, values)
        first = first_rows(views)
        off = (self.mean - values) / self.std
        return _Normal(
            cost=float(np.sum(residual**2) + off @ off),
            lens=np.einsum("nai,naj->ij", by_values, by_values) + np.diag(1.0 / self.std**2),
            mixed=np.add.reduceat(by_values.transpose(0, 2, 1) @ by_motion, first),
            motion=np.add.reduceat(by_motion.transpose(0, 2, 1) @ by_motion, first),
            lens_side=np.einsum("nai,na->i", by_values, residual) + off / self.std,
            motion_side=np.add.reduceat(np.einsum("nai,na->ni", by_motion, residual), first),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """Intrinsics and poses of views at the end of a refinement."""

    #: shape (m,), the intrinsics
    values: Array
    #: shape (V, 4, 4), T_camera_board of the views that were used [m]
    T_camera_board: Array
    #: Mean square of the distances of images from their predictions, with the priors' squares [px^2]
    error: float


def refine_bundle(
    bundle: Bundle,
    start: Array,
    views: Sequence[View],
    poses: Sequence[Array | None],
    iterations: int,
) -> Refined | None:
    """Refine intrinsics and the poses of views together, by Levenberg-Marquardt.

    Args:
        bundle: The lens, and what is known about its intrinsics.
        start: shape (m,), intrinsics to start from.
        views: Views of flat boards.
        poses: T_camera_board of each to start from, shape (4, 4) [m]; views with None, and those that fit far worse
            than most, are left out.
        iterations: The most steps.

    Returns:
        The intrinsics and poses; None if no view has a pose.
    """
    posed = [pose is not None for pose in poses]
    if not any(posed):
        return None
    T = np.array(list(compress(poses, posed)))
    views = list(compress(views, posed))

    # Views whose corners were mixed up fit far worse than most.
    residual, _, _ = view_system(T, views, bundle.lens, start)
    squares = np.add.reduceat(np.sum(residual**2, axis=1), first_rows(views))
    mean_squares = squares / [len(points) for points, _ in views]
    fits = mean_squares <= _FAR_OFF**2 * np.median(mean_squares)
    T = T[fits]
    views = list(compress(views, fits))

    values = start
    damping = _DAMPING
    normal = bundle.normal(values, T, views)
    for _ in range(iterations):
        change, motions = normal.step(damping)
        new_values = values + change
        new_T = moved(T, motions)
        new = bundle.normal(new_values, new_T, views)
        # With negative focal lengths the image is turned by half a turn.
        if not (new.cost < normal.cost and np.all(new_values[:2] > 0.0)):
            damping *= _MORE
            if damping > _STUCK:
                break
            continue
        fall = normal.cost - new.cost
        values, T, normal = new_values, new_T, new
        damping *= _LESS
        if fall <= _SETTLED * normal.cost:
            break
    return Refined(values, T, normal.cost / sum(len(points) for points, _ in views))
