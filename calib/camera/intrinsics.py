"""Intrinsics of which nothing is known: a start for a fit, from views of flat boards alone.

The homography H = [h1 h2 h3] of a view to the image, with the principal point in the image's middle, obeys

    h1^T W h2 = 0,      h1^T W h1 = h2^T W h2,      W = diag(1 / fx^2, 1 / fy^2, 1)

which is linear in 1 / fx^2 and 1 / fy^2 (Z. Zhang, 2000). For a fisheye, whose straight lines are bent, focal lengths
are tried. From there the lens's numbers and the poses of all views are refined together by least squares.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.camera.camera import Camera
from calib.camera.lenses import LENSES, Lens
from calib.camera.planar_pose import View, homography, moved, planar_poses, view_system
from calib.errors import MeasurementError
from calib.units import Array

#: Focal lengths that are tried, over the image's width: wide angles to telephoto lenses.
_TRIED = np.geomspace(0.25, 4.0, 9)

#: Focal lengths in closed form beyond these shares of the image's width are those of views that do not tell them.
_PLAUSIBLE = (0.15, 8.0)

#: Views by which focal lengths are tried; more do not change the choice.
_VIEWS = 6

#: The fewest points of a view.
_FEWEST = 6

#: Standard deviations that keep what views do not tell: of the centre over the image's width, of a coefficient of
#: distortion, and of the logarithm of a focal length.
_CENTRE = 0.1
_DISTORTION = 0.5
_FOCAL = 1.0

#: Views that are refined together: enough for a start.
_REFINED_VIEWS = 40

#: Rounds of the refinement, and the relative fall of the sum of squares at which it ends.
_ROUNDS = 40
_SETTLED = 1e-6

#: Damping at the first round, its factors after a success and a failure, and where no step helps.
_DAMPING = 1e-3
_LESS = 0.1
_MORE = 10.0
_STUCK = 1e8


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
    lens = LENSES[camera.lens]
    usable = [view for view in views if len(view[0]) >= _FEWEST]
    if not usable:
        raise MeasurementError(
            f"No image of the camera '{camera.name}' shows {_FEWEST} corners: its intrinsics cannot be found. Give "
            "them (--camera camera_info.yaml), or take pictures that show more of the board."
        )
    closed = _closed_form(camera, usable)
    starts = [closed] if closed is not None else []
    width = float(camera.width)
    starts += [_values(camera, factor * width, factor * width) for factor in _TRIED]
    if closed is None or camera.lens != "pinhole":
        sample = usable[:: max(len(usable) // _VIEWS, 1)]
        starts = sorted(starts, key=lambda values: _cost(lens, values, sample))
    return _refined(camera, starts[0], usable)


def _values(camera: Camera, fx: float, fy: float) -> Array:
    """Return the numbers of a camera's lens without distortion, its centre in the middle of the image."""
    values = np.zeros(len(LENSES[camera.lens].names))
    values[:4] = (fx, fy, (camera.width - 1) / 2.0, (camera.height - 1) / 2.0)
    return values


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
    return _values(camera, *(camera.width * focal).tolist())


def _cost(lens: Lens, values: Array, views: Sequence[View]) -> float:
    """Return the sum of squares of views at numbers of a lens, each at its best pose; infinite where one has none."""
    poses = planar_poses(views, lens, values)
    total = 0.0
    for pose, (points, _) in zip(poses, views, strict=True):
        total += np.inf if pose is None else len(points) * pose.rms**2
    return total


def _refined(camera: Camera, start: Array, views: Sequence[View]) -> Array:
    """Refine numbers of a lens and the poses of views together, by Levenberg-Marquardt.

    Args:
        camera: The camera.
        start: shape (m,), the lens's numbers.
        views: Views of flat boards.

    Returns:
        shape (m,).
    """
    lens = LENSES[camera.lens]
    chosen = views[:: -(-len(views) // _REFINED_VIEWS)]
    posed = zip(planar_poses(chosen, lens, start), chosen, strict=True)
    kept = [(pose.T_camera_board, view) for pose, view in posed if pose is not None]
    if not kept:
        return start
    poses = np.array([T for T, _ in kept])
    chosen = [view for _, view in kept]
    std = np.full(len(start), _DISTORTION)
    std[:2] = _FOCAL * start[:2]
    std[2:4] = _CENTRE * camera.width
    values = start
    damping = _DAMPING
    residual, jacobian = _bundle(lens, values, poses, chosen, (start - values) / std, 1.0 / std)
    for _ in range(_ROUNDS):
        N = jacobian.T @ jacobian
        step = np.linalg.solve(N + damping * np.diag(np.diagonal(N)), jacobian.T @ residual)
        new_values = values + step[: len(values)]
        twists = step[len(values) :].reshape(-1, 6)
        new_poses = moved(poses, twists)
        new_residual, new_jacobian = _bundle(
            lens, new_values, new_poses, chosen, (start - new_values) / std, 1.0 / std
        )
        fall = residual @ residual - new_residual @ new_residual
        if not fall > 0.0:
            damping *= _MORE
            if damping > _STUCK:
                break
            continue
        values, poses = new_values, new_poses
        residual, jacobian = new_residual, new_jacobian
        damping *= _LESS
        if fall <= _SETTLED * (residual @ residual):
            break
    return values


def _bundle(
    lens: Lens,
    values: Array,
    poses: Array,
    views: Sequence[View],
    prior_residual: Array,
    prior_weights: Array,
) -> tuple[Array, Array]:
    """Return the residual of all views, and of the priors, and its derivative.

    Args:
        lens: The lens model.
        values: shape (m,), its numbers.
        poses: shape (V, 4, 4), pose of the board in each of V views [m].
        views: The views.
        prior_residual: shape (m,), prior mean minus number, over the prior standard deviation.
        prior_weights: shape (m,), 1 over the prior standard deviation.

    Returns:
        shape (n,), and shape (n, m + 6 V): derivative of the prediction by the numbers, then the motions of the boards.
    """
    residual, by_motion, by_values = view_system(poses, views, lens, values)
    m = len(values)
    jacobian = np.zeros((*residual.shape, m + 6 * len(views)))
    jacobian[:, :, :m] = by_values
    view = np.repeat(np.arange(len(views)), [len(points) for points, _ in views])
    columns = m + 6 * view[:, None] + np.arange(6)
    rows = np.arange(len(residual))[:, None]
    jacobian[rows, :, columns] = by_motion.transpose(0, 2, 1)
    of_priors = np.zeros((m, jacobian.shape[2]))
    of_priors[:, :m] = np.diag(prior_weights)
    return (
        np.concatenate([prior_residual, residual.ravel()]),
        np.vstack([of_priors, jacobian.reshape(-1, jacobian.shape[2])]),
    )
