"""Initial intrinsics of an unknown camera, from views of boards alone.

The homography H = [h1 h2 h3] of points in a plane to their images, with the principal point in the image's middle,
obeys

    h1^T W h2 = 0,      h1^T W h1 = h2^T W h2,      W = diag(1 / fx^2, 1 / fy^2, 1)

which is linear in 1 / fx^2 and 1 / fy^2 (Z. Zhang, 2000). Distortion bends the lines that this rests on, so that other
focal lengths are tried too: from each the intrinsics and the poses of a few views are refined together by least
squares, and the best is refined with more views.

In this refinement, a bundle adjustment, the poses of the views are eliminated from the normal equations, which leaves
those of the intrinsics (the Schur complement; D. C. Brown, 1976), so that the time of an iteration grows with the
number of views, not with its cube.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np

from calib.basics.arrays import Array
from calib.camera.board_pose import (
    View,
    board_poses,
    closed_form_poses,
    determines_pose,
    first_rows,
    homography,
    move_poses,
    points_in_plane,
    view_system,
)
from calib.camera.camera import Camera
from calib.camera.lenses import LENSES, Lens
from calib.errors import MeasurementError

# Bundle adjustment

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
        """Return the damped Gauss-Newton step: of the intrinsics, shape (m,), and of the motions, shape (V, 6).

        The diagonals of the normal equations grow by ``damping`` times themselves.
        """
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
    """Bundle adjustment of a lens of m intrinsics with normal priors."""

    #: The lens model
    lens: Lens
    #: shape (m,), means of the priors
    mean: Array
    #: shape (m,), their standard deviations
    std: Array

    def normal(self, values: Array, T: Array, views: Sequence[View]) -> _Normal:
        """Return the normal equations of a step from given intrinsics and poses.

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
        views: Views of boards.
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
        new_T = move_poses(T, motions)
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


# Intrinsics to start from

#: Focal lengths that are tried, over the image's width: wide angles to telephoto lenses.
_TRIED = (0.3, 0.5, 0.8, 1.4, 2.5)

#: Focal lengths, over the image's width, that the closed form may give: others show that views do not determine them.
_PLAUSIBLE = (0.15, 8.0)

#: Number of views with which focal lengths are tried, and of iterations of each trial; more do not change the choice.
_TRIED_VIEWS = 8
_TRIED_ITERATIONS = 15

#: The fewest points of a view.
_FEWEST = 6

#: Standard deviations of the priors, for what views do not determine: of the centre over the image's width, of a
#: coefficient of distortion, and of the focal lengths over themselves.
_CENTRE = 0.1
_DISTORTION = 0.5
_FOCAL = 1.0

#: Number of views that are refined together: enough for a start.
_REFINED_VIEWS = 40

#: Maximum number of iterations of the refinement.
_ITERATIONS = 40


def initial_intrinsics(camera: Camera, views: Sequence[View]) -> Array:
    """Return intrinsics to start a fit from, if nothing is known but the size of the image.

    Args:
        camera: Its size and lens model.
        views: Views of boards; those with too few corners are left out.

    Returns:
        shape (m,), in the order of the lens's names: [px], and coefficients of distortion.

    Raises:
        MeasurementError: No view has enough corners.
    """
    usable = []
    for view in views:
        points, pixels = view
        if len(points) >= _FEWEST and determines_pose(points) and determines_pose(pixels):
            usable.append(view)
    if not usable:
        raise MeasurementError(
            f"No image of the camera '{camera.name}' shows {_FEWEST} corners that are not on a line: its intrinsics "
            "cannot be found. Give them (--camera camera_info.yaml), or take pictures that show more of the board."
        )
    starts = [_without_distortion(camera, factor * camera.width) for factor in _TRIED]
    closed_form = _closed_form(camera, usable)
    if closed_form is not None:
        starts.insert(0, closed_form)

    lens = LENSES[camera.lens]
    sample = _some(usable, _TRIED_VIEWS)
    best: Refined | None = None
    for start in starts:
        poses = closed_form_poses(sample, lens, start)
        trial = refine_bundle(_bundle(camera, start), start, sample, poses, _TRIED_ITERATIONS)
        if trial is not None and (best is None or trial.error < best.error):
            best = trial
    start = _without_distortion(camera, camera.width) if best is None else best.values

    chosen = _some(usable, _REFINED_VIEWS)
    estimated = board_poses(chosen, lens, start)
    poses = tuple(None if pose is None else pose.T_camera_board for pose in estimated)
    refined = refine_bundle(_bundle(camera, start), start, chosen, poses, _ITERATIONS)
    return start if refined is None else refined.values


def _closed_form(camera: Camera, views: Sequence[View]) -> Array | None:
    """Return intrinsics (m,) [px, 1] whose focal lengths solve the equations at the head of this module.

    The centre is the image's middle, and there is no distortion. None if the focal lengths are not determined, or are
    implausible; points that are not in a plane do not count.
    """
    middle = np.array([camera.width - 1, camera.height - 1]) / 2.0
    equations = []  # factors of 1 / fx^2, of 1 / fy^2, and of 1
    for points, pixels in views:
        in_plane = points_in_plane(points)
        if in_plane is None:
            continue
        H = homography(in_plane[1], (pixels - middle) / camera.width)
        h1, h2 = H[:, 0], H[:, 1]
        scale = 1.0 / (h1 @ h1 + h2 @ h2)
        equations += [scale * h1 * h2, scale * (h1**2 - h2**2)]
    if not equations:
        return None
    A = np.array(equations)
    squares, _, rank, _ = np.linalg.lstsq(A[:, :2], -A[:, 2], rcond=1e-6)
    if rank < 2 or np.any(squares <= 0.0):
        return None
    focal = 1.0 / np.sqrt(squares)
    if np.any(focal < _PLAUSIBLE[0]) or np.any(focal > _PLAUSIBLE[1]):
        return None
    values = _without_distortion(camera, camera.width)
    values[:2] = camera.width * focal
    return values


def _bundle(camera: Camera, start: Array) -> Bundle:
    """Return the lens with wide priors about no distortion, the middle, and the focal lengths of ``start`` (m,)."""
    mean = _without_distortion(camera, camera.width)
    mean[:2] = start[:2]
    std = np.full(len(start), _DISTORTION)
    std[:2] = _FOCAL * start[:2]
    std[2:4] = _CENTRE * camera.width
    return Bundle(LENSES[camera.lens], mean, std)


def _without_distortion(camera: Camera, focal: float) -> Array:
    """Return intrinsics, shape (m,), with this focal length [px], the centre in the middle, and no distortion."""
    values = np.zeros(len(LENSES[camera.lens].names))
    values[:4] = (focal, focal, (camera.width - 1) / 2.0, (camera.height - 1) / 2.0)
    return values


def _some(views: Sequence[View], count: int) -> Sequence[View]:
    """Return at most ``count`` of the views, chosen evenly from first to last."""
    return views[:: -(-len(views) // count)]
