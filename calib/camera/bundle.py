"""Bundle adjustment of one camera: the numbers of its lens and the poses of flat boards in its views, by least squares.

The poses of single views are eliminated from the normal equations, which leaves those of the lens's numbers (the Schur
complement; D. C. Brown, 1976), so that a round takes a time that grows with the number of views, not with its cube.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.camera.lenses import Lens
from calib.camera.planar_pose import View, moved, view_system

#: A view whose rms error is so many times that of most is left out.
_FAR_OFF = 10.0

#: Relative fall of the sum of squares at which the refinement ends.
_SETTLED = 1e-5

#: Damping at the first round, its factors after a success and a failure, and where no step helps.
_DAMPING = 1e-3
_LESS = 0.1
_MORE = 10.0
_STUCK = 1e8

#: Damping of motions that views do not tell at all, over the trace of the normal equations.
_LEAST_DAMPING = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class _Normal:
    """Normal equations of V views: of the m numbers of the lens, and of the motions of the boards."""

    #: Sum of squares, those of the priors included [px^2]
    cost: float
    #: shape (m, m), of the lens's numbers
    lens: Array
    #: shape (V, m, 6), between these and the motion of each board
    mixed: Array
    #: shape (V, 6, 6), of the motion of each board
    motion: Array
    #: shape (m,), right side of the lens's numbers
    lens_side: Array
    #: shape (V, 6), right sides of the motions
    motion_side: Array

    def step(self, damping: float) -> tuple[Array, Array]:
        """Return the damped Gauss-Newton step: of the lens's numbers, shape (m,), and the motions, shape (V, 6)."""
        motion = _damped(self.motion, damping)
        of_mixed = np.linalg.solve(motion, self.mixed.transpose(0, 2, 1))
        of_side = np.linalg.solve(motion, self.motion_side[:, :, None])[:, :, 0]
        # Their priors keep the lens's numbers apart.
        lens = self.lens + damping * np.diag(np.diagonal(self.lens))
        reduced = lens - np.sum(self.mixed @ of_mixed, axis=0)
        side = self.lens_side - np.einsum("vmi,vi->m", self.mixed, of_side)
        change = np.linalg.solve(reduced, side)
        return change, of_side - of_mixed @ change


def _damped(matrices: Array, damping: float) -> Array:
    """Return matrices (V, k, k) with their diagonals enlarged."""
    diagonal = np.diagonal(matrices, axis1=1, axis2=2)
    least = _LEAST_DAMPING * np.sum(diagonal, axis=1, keepdims=True) + np.finfo(float).tiny
    return np.asarray(
        matrices + (damping * diagonal + least)[:, :, None] * np.eye(matrices.shape[1])
    )


@dataclass(frozen=True, slots=True, eq=False)
class Bundle:
    """A lens of m numbers with priors of these."""

    #: The lens model
    lens: Lens
    #: shape (m,), means of the priors
    mean: Array
    #: shape (m,), their standard deviations
    std: Array

    def normal(self, values: Array, T: Array, views: Sequence[View]) -> _Normal:
        """Return the normal equations.

        Args:
            values: shape (m,), the lens's numbers.
            T: shape (V, 4, 4), T_camera_board of each view [m].
            views: The views.
        """
        residual, by_motion, by_values = view_system(T, views, self.lens, values)
        first = _first_rows(views)
        off = (self.mean - values) / self.std
        return _Normal(
            cost=float(np.sum(residual**2) + off @ off),
            lens=np.einsum("nai,naj->ij", by_values, by_values) + np.diag(1.0 / self.std**2),
            mixed=np.add.reduceat(by_values.transpose(0, 2, 1) @ by_motion, first),
            motion=np.add.reduceat(by_motion.transpose(0, 2, 1) @ by_motion, first),
            lens_side=np.einsum("nai,na->i", by_values, residual) + off / self.std,
            motion_side=np.add.reduceat(np.einsum("nai,na->ni", by_motion, residual), first),
        )

    def is_near(self, values: Array, T: Array, views: Sequence[View]) -> Mask:
        """Find the views that do not fit far worse than most, as those whose corners were mixed up do.

        Args:
            values: shape (m,), the lens's numbers.
            T: shape (V, 4, 4), T_camera_board of each view [m].
            views: The views.

        Returns:
            shape (V,).
        """
        residual, _, _ = view_system(T, views, self.lens, values)
        squares = np.add.reduceat(np.sum(residual**2, axis=1), _first_rows(views))
        mean_squares = squares / [len(points) for points, _ in views]
        return np.asarray(mean_squares <= _FAR_OFF**2 * np.median(mean_squares))


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """Numbers of a lens and poses of views at the end of a refinement."""

    #: shape (m,), the lens's numbers
    values: Array
    #: shape (V, 4, 4), T_camera_board of the views that were used [m]
    T_camera_board: Array
    #: Mean square of the distances of images from their predictions [px^2]
    error: float


def refine_bundle(
    bundle: Bundle,
    start: Array,
    views: Sequence[View],
    poses: Sequence[Array | None],
    rounds: int,
) -> Refined | None:
    """Refine numbers of a lens and the poses of views together, by Levenberg-Marquardt.

    Args:
        bundle: The lens, and what is known of its numbers.
        start: shape (m,), its numbers to start from.
        views: Views of flat boards.
        poses: T_camera_board of each to start from, shape (4, 4) [m]; views with None are left out, and those that fit
            far worse than most.
        rounds: The most rounds.

    Returns:
        The numbers and poses; None where no view has a pose.
    """
    posed = [pose is not None for pose in poses]
    if not any(posed):
        return None
    T = np.array(list(compress(poses, posed)))
    kept = list(compress(views, posed))
    near = bundle.is_near(start, T, kept)
    return _iterated(bundle, start, T[near], list(compress(kept, near)), rounds)


def _iterated(
    bundle: Bundle, values: Array, T: Array, views: Sequence[View], rounds: int
) -> Refined:
    """Take rounds of the Levenberg-Marquardt method; see `refine_bundle`."""
    damping = _DAMPING
    normal = bundle.normal(values, T, views)
    for _ in range(rounds):
        change, motions = normal.step(damping)
        new_values = values + change
        new_T = moved(T, motions)
        new = bundle.normal(new_values, new_T, views)
        # Negative focal lengths are those of an image that is turned by half a turn.
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


def _first_rows(views: Sequence[View]) -> Integers:
    """Return the number of the first point of each view, shape (V,)."""
    return np.cumsum([0, *(len(points) for points, _ in views[:-1])])
