"""Initial intrinsics of a camera of which nothing is known, from views of flat boards alone.

The homography H = [h1 h2 h3] of a view to the image, with the principal point in the image's middle, obeys

    h1^T W h2 = 0,      h1^T W h1 = h2^T W h2,      W = diag(1 / fx^2, 1 / fy^2, 1)

which is linear in 1 / fx^2 and 1 / fy^2 (Z. Zhang, 2000). Distortion bends the lines that this rests on, so that other
focal lengths are tried too: from each the intrinsics and the poses of a few views are refined together by least
squares, and the best is refined with more views.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.basics.arrays import Array
from calib.camera.bundle import Bundle, Refined, refine_bundle
from calib.camera.camera import Camera
from calib.camera.lenses import LENSES
from calib.camera.planar_pose import (
    View,
    closed_form_poses,
    determines_pose,
    homography,
    planar_poses,
)
from calib.errors import MeasurementError

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
        views: Of flat boards.

    Returns:
        shape (m,), in the order of the lens's names.

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
    estimated = planar_poses(chosen, lens, start)
    poses = tuple(None if pose is None else pose.T_camera_board for pose in estimated)
    refined = refine_bundle(_bundle(camera, start), start, chosen, poses, _ITERATIONS)
    return start if refined is None else refined.values


def _closed_form(camera: Camera, views: Sequence[View]) -> Array | None:
    """Return intrinsics, shape (m,), with focal lengths by the equations above; None if views do not determine them."""
    middle = np.array([camera.width - 1, camera.height - 1]) / 2.0
    equations = []  # factors of 1 / fx^2, of 1 / fy^2, and of 1
    for points, pixels in views:
        H = homography(points[:, :2], (pixels - middle) / camera.width)
        h1, h2 = H[:, 0], H[:, 1]
        scale = 1.0 / (h1 @ h1 + h2 @ h2)
        equations += [scale * h1 * h2, scale * (h1**2 - h2**2)]
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
    """Return the lens with wide priors about the focal lengths of a start, shape (m,), without distortion."""
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
    """Return at most so many of the views, evenly from first to last."""
    return views[:: -(-len(views) // count)]
