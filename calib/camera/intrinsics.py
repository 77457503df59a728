"""Intrinsics of which nothing is known: a start for a fit, from views of flat boards alone.

The homography H = [h1 h2 h3] of a view to the image, with the principal point in the image's middle, obeys

    h1^T W h2 = 0,      h1^T W h1 = h2^T W h2,      W = diag(1 / fx^2, 1 / fy^2, 1)

which is linear in 1 / fx^2 and 1 / fy^2 (Z. Zhang, 2000). Distortion bends the lines that this rests on, so that other
focal lengths are tried too: from each the lens's numbers and the poses of a few views are refined together by least
squares, and the best is refined with all views. The poses of single views are eliminated from the normal equations,
which leaves those of the lens's numbers (the Schur complement; D. C. Brown, 1976).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np

from calib.camera.camera import Camera
from calib.camera.lenses import LENSES, Lens
from calib.camera.planar_pose import (
    View,
    closed_form_poses,
    homography,
    moved,
    planar_poses,
    tells_pose,
    view_system,
)
from calib.errors import MeasurementError
from calib.units import Array

#: Focal lengths that are tried, over the image's width: wide angles to telephoto lenses.
_TRIED = (0.3, 0.5, 0.8, 1.4, 2.5)

#: Focal lengths in closed form beyond these shares of the image's width are those of views that do not tell them.
_PLAUSIBLE = (0.15, 8.0)

#: Views by which focal lengths are tried, and rounds of each trial; more do not change the choice.
_TRIED_VIEWS = 8
_TRIED_ROUNDS = 15

#: The fewest points of a view.
_FEWEST = 6

#: Standard deviations that keep what views do not tell: of the centre over the image's width, of a coefficient of
#: distortion, and of the focal lengths over themselves.
_CENTRE = 0.1
_DISTORTION = 0.5
_FOCAL = 1.0

#: A view whose rms error is so many times that of most is left out.
_FAR_OFF = 10.0

#: Views that are refined together: enough for a start.
_REFINED_VIEWS = 40

#: Rounds of the refinement, and the relative fall of the sum of squares at which it ends.
_ROUNDS = 40
_SETTLED = 1e-5

#: Damping at the first round, its factors after a success and a failure, and where no step helps.
_DAMPING = 1e-3
_LESS = 0.1
_MORE = 10.0
_STUCK = 1e8

#: Damping of what views do not tell at all, over the trace of the normal equations.
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
        reduced = _damped(self.lens[None], damping)[0] - np.sum(self.mixed @ of_mixed, axis=0)
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


def start_of_intrinsics(camera: Camera, views: Sequence[View]) -> Array:
    """Return numbers of a lens to start from, of which nothing is known but the size of the image.

    Args:
        camera: Its size and lens model.
        views: Of flat boards.

    Returns:
        shape (m,), the lens's numbers, in the order of its names.

    Raises:
        MeasurementError: No view has enough corners.
    """
    usable = [view for view in views if _is_usable(view)]
    if not usable:
        raise MeasurementError(
            f"No image of the camera '{camera.name}' shows {_FEWEST} corners that are not on a line: its intrinsics "
            "cannot be found. Give them (--camera camera_info.yaml), or take pictures that show more of the board."
        )
    lens = LENSES[camera.lens]
    sample = _some(usable, _TRIED_VIEWS)
    best = _middle(camera, camera.width)
    least = np.inf
    for start in _starts(camera, usable):
        poses = closed_form_poses(sample, lens, start)
        values, error = _refined(camera, start, sample, poses, _TRIED_ROUNDS)
        if error < least:
            best, least = values, error
    chosen = _some(usable, _REFINED_VIEWS)
    estimated = planar_poses(chosen, lens, best)
    of_views = [None if pose is None else pose.T_camera_board for pose in estimated]
    values, _ = _refined(camera, best, chosen, of_views, _ROUNDS)
    return values


def _is_usable(view: View) -> bool:
    """True if a view has enough corners, and neither they nor their images are on a line."""
    points, pixels = view
    return len(points) >= _FEWEST and tells_pose(points) and tells_pose(pixels)


def _some(views: Sequence[View], count: int) -> Sequence[View]:
    """Return at most so many of the views, from first to last."""
    return views[:: -(-len(views) // count)]


def _middle(camera: Camera, focal: float) -> Array:
    """Return the numbers of a camera's lens without distortion, its centre in the middle of the image."""
    values = np.zeros(len(LENSES[camera.lens].names))
    values[:4] = (focal, focal, (camera.width - 1) / 2.0, (camera.height - 1) / 2.0)
    return values


def _starts(camera: Camera, views: Sequence[View]) -> list[Array]:
    """Return numbers of a lens from which to try: those in closed form, if views tell them, and others."""
    starts = [_middle(camera, factor * camera.width) for factor in _TRIED]
    closed = _closed_form(camera, views)
    return starts if closed is None else [closed, *starts]


def _closed_form(camera: Camera, views: Sequence[View]) -> Array | None:
    """Return the focal lengths that homographies tell, as numbers of a lens; None where they do not tell them."""
    middle = np.array([camera.width - 1, camera.height - 1]) / 2.0
    equations = []
    sides = []
    for points, pixels in views:
        H = homography(points[:, :2], (pixels - middle) / camera.width)
        h1, h2 = H[:, 0], H[:, 1]
        scale = 1.0 / (h1 @ h1 + h2 @ h2)
        for row in (h1 * h2, h1**2 - h2**2):
            equations.append(scale * row[:2])
            sides.append(-scale * row[2])
    squares, _, rank, _ = np.linalg.lstsq(np.array(equations), np.array(sides), rcond=1e-6)
    if rank < 2 or np.any(squares <= 0.0):
        return None
    focal = 1.0 / np.sqrt(squares)
    if np.any(focal < _PLAUSIBLE[0]) or np.any(focal > _PLAUSIBLE[1]):
        return None
    values = _middle(camera, camera.width)
    values[:2] = camera.width * focal
    return values


def _refined(
    camera: Camera,
    start: Array,
    views: Sequence[View],
    poses: Sequence[Array | None],
    rounds: int,
) -> tuple[Array, float]:
    """Refine numbers of a lens and the poses of views together, by Levenberg-Marquardt.

    Args:
        camera: The camera.
        start: shape (m,), the lens's numbers.
        views: Views of flat boards.
        poses: T_camera_board of each, shape (4, 4) [m]; views with None are left out.
        rounds: The most rounds.

    Returns:
        shape (m,), the numbers; and the mean square of the distances of images from their predictions [px^2].
    """
    lens = LENSES[camera.lens]
    pairs = [(T, view) for T, view in zip(poses, views, strict=True) if T is not None]
    pairs = _without_far_off(lens, start, pairs)
    if not pairs:
        return start, np.inf
    T = np.array([pose for pose, _ in pairs])
    kept = [view for _, view in pairs]
    mean = _middle(camera, 1.0)
    mean[:2] = start[:2]
    std = np.full(len(start), _DISTORTION)
    std[:2] = _FOCAL * start[:2]
    std[2:4] = _CENTRE * camera.width
    values = start
    damping = _DAMPING
    normal = _normal(lens, values, T, kept, (mean, std))
    for _ in range(rounds):
        change, motions = normal.step(damping)
        new_values = values + change
        new_T = moved(T, motions)
        new = _normal(lens, new_values, new_T, kept, (mean, std))
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
    return values, normal.cost / sum(len(points) for points, _ in kept)


def _without_far_off(
    lens: Lens, values: Array, pairs: Sequence[tuple[Array, View]]
) -> list[tuple[Array, View]]:
    """Return poses and views without those that fit far worse than most, such as of corners that were mixed up.

    Args:
        lens: The lens model.
        values: shape (m,), its numbers.
        pairs: Pose of the board, shape (4, 4) [m], and view of each.
    """
    if not pairs:
        return []
    counts = np.array([len(points) for _, (points, _) in pairs])
    poses = np.array([T for T, _ in pairs])
    residual, _, _ = view_system(poses, [view for _, view in pairs], lens, values)
    first = np.cumsum([0, *counts[:-1]])
    mean_squares = np.add.reduceat(np.sum(residual**2, axis=1), first) / counts
    kept = mean_squares <= _FAR_OFF**2 * np.median(mean_squares)
    return list(compress(pairs, kept))


def _normal(
    lens: Lens, values: Array, T: Array, views: Sequence[View], prior: tuple[Array, Array]
) -> _Normal:
    """Return the normal equations of V views, and of priors of the lens's numbers.

    Args:
        lens: The lens model.
        values: shape (m,), its numbers.
        T: shape (V, 4, 4), T_camera_board of each view [m].
        views: The views.
        prior: Means and standard deviations of the lens's numbers, each of shape (m,).
    """
    residual, by_motion, by_values = view_system(T, views, lens, values)
    first = np.cumsum([0, *(len(points) for points, _ in views[:-1])])
    mean, std = prior
    off = (mean - values) / std
    return _Normal(
        cost=float(np.sum(residual**2) + off @ off),
        lens=np.einsum("nai,naj->ij", by_values, by_values) + np.diag(1.0 / std**2),
        mixed=np.add.reduceat(by_values.transpose(0, 2, 1) @ by_motion, first),
        motion=np.add.reduceat(by_motion.transpose(0, 2, 1) @ by_motion, first),
        lens_side=np.einsum("nai,na->i", by_values, residual) + off / std,
        motion_side=np.add.reduceat(np.einsum("nai,na->ni", by_motion, residual), first),
    )
