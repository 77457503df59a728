"""Corners of very large tables of images: some of each picture are fitted."""

from __future__ import annotations

import numpy as np

from calib.data.measurements import Measurements
from calib.diagnosis.coverage import FEW_CORNERS
from calib.diagnosis.reasons import Reason, Why

#: Corners to estimate from that are all fitted.
_MANY_CORNERS = 1500

#: Of more about this number is, evenly over the pictures; each keeps what determines its board's pose well.
_ENOUGH_CORNERS = 1200

#: Steps of this share of the corners are spread evenly, however many pictures there are.
_GOLDEN_RATIO = (5.0**0.5 - 1.0) / 2.0


def with_fewer_corners(measurements: Measurements) -> tuple[Measurements, tuple[Reason, ...]]:
    """Keep some corners of each picture if those to estimate from are very many, and say so; validation rows stay.

    Those of one picture share the robot's error there, and fifteen determine where the board is. Each corner of the
    board is kept as often as any other.

    Args:
        measurements: The table.

    Returns:
        The rows that are kept, in their order, and the reason that informs of it; the table itself and none if its
        corners are not that many.
    """
    m = measurements
    fitted = m.is_image & m.estimation
    if np.sum(fitted) <= _MANY_CORNERS:
        return m, ()
    labels = [*zip(m.images, m.groups, m.targets, (q.tobytes() for q in m.joints), strict=True)]
    views: dict[tuple[str, str, str, bytes], list[int]] = {}
    for row in np.flatnonzero(fitted).tolist():
        views.setdefault(labels[row], []).append(row)
    each = max(_ENOUGH_CORNERS // len(views), FEW_CORNERS)
    kept = ~fitted
    for k, rows in enumerate(views.values()):
        count = min(each, len(rows))
        places = (np.arange(count) + k * _GOLDEN_RATIO % 1.0) * len(rows) / count
        kept[np.array(rows)[places.astype(int)]] = True
    left = int(np.sum(kept & fitted))
    if left == np.sum(fitted):
        return m, ()
    reason = Reason.of(Why.CORNERS_THINNED, corners=int(np.sum(fitted)), kept=left)
    return m.select(kept), (reason,)
