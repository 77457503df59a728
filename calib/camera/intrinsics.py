"""Intrinsics of which nothing is known: a start for a fit, from views of flat boards alone.

The homography H = [h1 h2 h3] of a view to the image, with the principal point in the image's middle, obeys

    h1^T W h2 = 0,      h1^T W h1 = h2^T W h2,      W = diag(1 / fx^2, 1 / fy^2, 1)

which is linear in 1 / fx^2 and 1 / fy^2 (Z. Zhang, 2000). Distortion bends the lines that this rests on, so that other
focal lengths are tried too: from each the lens's numbers and the poses of a few views are refined together by least
squares, and the best is refined with all views.
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
    homography,
    planar_poses,
    tells_pose,
)
from calib.errors import MeasurementError

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

#: Views that are refined together: enough for a start.
_REFINED_VIEWS = 40

#: Rounds of the refinement.
_ROUNDS = 40


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
    tried = _tried(camera, usable)
    best = min(tried, key=lambda trial: trial.error) if tried else None
    start = _middle(camera, camera.width) if best is None else best.values
    chosen = _some(usable, _REFINED_VIEWS)
    estimated = planar_poses(chosen, LENSES[camera.lens], start)
    poses = [None if pose is None else pose.T_camera_board for pose in estimated]
    refined = refine_bundle(_bundle(camera, start), start, chosen, poses, _ROUNDS)
    return start if refined is None else refined.values


def _tried(camera: Camera, views: Sequence[View]) -> list[Refined]:
    """Refine numbers of a lens and the poses of a few views from each of several focal lengths."""
    sample = _some(views, _TRIED_VIEWS)
    result = []
    for start in _starts(camera, views):
        poses = closed_form_poses(sample, LENSES[camera.lens], start)
        refined = refine_bundle(_bundle(camera, start), start, sample, poses, _TRIED_ROUNDS)
        if refined is not None:
            result.append(refined)
    return result


def _bundle(camera: Camera, start: Array) -> Bundle:
    """Return the lens with wide priors about numbers without distortion, and the focal lengths of a start (m,)."""
    mean = _middle(camera, camera.width)
    mean[:2] = start[:2]
    std = np.full(len(start), _DISTORTION)
    std[:2] = _FOCAL * start[:2]
    std[2:4] = _CENTRE * camera.width
    return Bundle(LENSES[camera.lens], mean, std)


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
    for points, pixels in views:
        H = homography(points[:, :2], (pixels - middle) / camera.width)
        equations += _equations(H)
    A = np.array(equations)
    squares, _, rank, _ = np.linalg.lstsq(A[:, :2], -A[:, 2], rcond=1e-6)
    if rank < 2 or np.any(squares <= 0.0):
        return None
    focal = 1.0 / np.sqrt(squares)
    if np.any(focal < _PLAUSIBLE[0]) or np.any(focal > _PLAUSIBLE[1]):
        return None
    values = _middle(camera, camera.width)
    values[:2] = camera.width * focal
    return values


def _equations(H: Array) -> list[Array]:
    """Return the two equations of a homography (3, 3): the factors of 1 / fx^2, of 1 / fy^2, and of 1, shape (3,)."""
    h1, h2 = H[:, 0], H[:, 1]
    scale = 1.0 / (h1 @ h1 + h2 @ h2)
    return [scale * h1 * h2, scale * (h1**2 - h2**2)]
