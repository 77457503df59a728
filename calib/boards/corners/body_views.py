"""Tags of a body in an image of an unknown camera: which of those read are where the body has them.

The pose of a body follows from any of its tags if the focal length is known. A lens is not, but its focal length is one
of a few, to a quarter, and that tells a tag that was misread, which is on another face or upside down, from one that is
a little off. So each tag is tried with each focal length, and the pose that most others agree with is refined by all of
these. Corners are measured in the image, whatever the pose.
"""

from __future__ import annotations

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.boards.corners.markers import Markers
from calib.boards.opencv import opencv

#: Focal lengths that are tried, in the image's longer side: fields of view of 110 to 12 deg.
_FOCAL = (0.35, 0.55, 0.8, 1.2, 1.8, 2.8, 4.5)

#: Distance of a tag's corners from where a pose predicts them with which it agrees, in its side: an unknown lens and
#: focal length move the far side of a body by as much.
_AGREES = 0.35

#: Largest share of tags that may disagree, and one in any case.
_MISREAD_SHARE = 0.2


def agreeing_tags(markers: Markers, layout: Array, image_size: tuple[int, int]) -> Mask | None:
    """Find the tags of a body that agree on its pose.

    Args:
        markers: The tags of the body that were read, with ids counted from 0.
        layout: Corners of all tags of the body, shape (tags, 4, 3) [m].
        image_size: Width and height [px].

    Returns:
        True for tags that agree, shape (m,); None if they do not agree on any pose.
    """
    if len(markers.ids) < 2:
        return np.ones(len(markers.ids), dtype=bool)
    cv2 = opencv()
    middle = (np.array(image_size) - 1.0) / 2.0
    best = np.zeros(len(markers.ids), dtype=bool)
    least = np.inf
    for share in _FOCAL:
        focal = share * max(image_size)
        K = np.array([[focal, 0.0, middle[0]], [0.0, focal, middle[1]], [0.0, 0.0, 1.0]])
        for first in range(len(markers.ids)):
            _, turns, shifts, _ = cv2.solvePnPGeneric(
                layout[markers.ids[first]], markers.corners[first], K, None, flags=cv2.SOLVEPNP_IPPE
            )
            for turn, shift in zip(turns, shifts, strict=True):
                misses = _misses(markers, layout, K, turn, shift)
                agrees = misses < _AGREES
                if agrees.sum() > 1:
                    # The pose of all that agree, which more may then agree with.
                    turn, shift = cv2.solvePnPRefineLM(
                        layout[markers.ids[agrees]].reshape(-1, 3),
                        markers.corners[agrees].reshape(-1, 2),
                        K,
                        None,
                        turn,
                        shift,
                    )
                    misses = _misses(markers, layout, K, turn, shift)
                    agrees = misses < _AGREES
                miss = float(np.mean(np.minimum(misses, 1.0)))
                if (agrees.sum(), -miss) > (best.sum(), -least):
                    best, least = agrees, miss
    allowed = max(1.0, _MISREAD_SHARE * len(best))
    return best if best.sum() >= 2 and (~best).sum() <= allowed else None


def _misses(markers: Markers, layout: Array, K: Array, turn: Array, shift: Array) -> Array:
    """Return the largest distance of each tag's corners from where a pose predicts them, in its side, shape (m,).

    Of a tag that the pose has behind the camera, or turned away from it, it is infinite.
    """
    cv2 = opencv()
    R, _ = cv2.Rodrigues(turn)
    seen = layout[markers.ids] @ R.T + np.reshape(shift, 3)
    pixels = seen @ K.T
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = pixels[..., :2] / pixels[..., 2:]
    distance = np.linalg.norm(pixels - markers.corners, axis=2).max(axis=1)
    # The normal of a tag points into it, away from a camera that sees it.
    normal = np.cross(seen[:, 1] - seen[:, 0], seen[:, 3] - seen[:, 0])
    is_seen = (seen[..., 2] > 0.0).all(axis=1) & (np.sum(normal * seen[:, 0], axis=1) > 0.0)
    return np.where(is_seen, distance / markers.sides, np.inf)
