"""What the page's script is told: where everything is at each pose, what was measured, how well positions are known."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.show.arrangement import Arrangement
from calib.show.camera import Camera
from calib.show.palette import LITTLE_TO_MUCH
from calib.show.puppet import Puppet, packed, stage_poses
from calib.show.view import Cloud, View
from calib.show.window import as_base64

Array = NDArray[np.float64]

#: At most this many poses are shown, and fewer where robots have many links: so many numbers of movers in all.
MOST_POSES, _MOST_MOVERS = 400, 16_000

#: The typical arrow of the nominal robot is about this long, as a part of the scene's size.
_ARROW = 0.12

#: Factors that arrows and robots can be magnified by.
FACTORS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)

#: Between which quantiles of the standard deviation the cloud's colours change.
_ENDS = (0.02, 0.98)


def thinned(view: View) -> View:
    """The view, or a choice of its poses where they are many.

    Kept are the one shown first, flagged rows, and rows spread evenly over the table, as many for validation as their
    part of the table is, ten at least.

    Args:
        view: The view.
    """
    count = len(view.q)
    links = len(view.nominal.urdf.links) + 3
    most = max(1, min(MOST_POSES, _MOST_MOVERS // links))
    if count <= most:
        return view
    kinds = np.array(view.kinds)
    flagged = _spread(np.flatnonzero(kinds == "flagged"), most // 4)
    held = np.flatnonzero(kinds == "validation")
    share = max(min(10, most // 4), most * len(held) // count)
    validation = _spread(held, min(share, 3 * most // 4 - len(flagged)))
    kept = np.union1d(np.union1d(flagged, validation), [view.start])
    rest = np.setdiff1d(np.flatnonzero(~np.isin(kinds, ("flagged", "validation"))), kept)
    chosen = np.union1d(kept, _spread(rest, max(most - len(kept), 0)))
    return view.select(chosen, int(np.searchsorted(chosen, view.start)))


def magnification(view: View, size: float) -> int:
    """The factor of `FACTORS` that makes the typical arrow of the nominal robot well visible.

    Args:
        view: The view.
        size: Of the scene [m].
    """
    lengths = _arrow_lengths(view)
    typical = float(np.median(lengths)) if len(lengths) else 0.0
    wanted = _ARROW * size / typical if typical > 0 else 1.0
    return max((factor for factor in FACTORS if factor <= wanted), default=1)


def _arrow_lengths(view: View) -> Array:
    """The lengths of the nominal robot's arrows before they are magnified, of rows that belong to the others [m]."""
    flagged = np.array(view.kinds) == "flagged"
    nominal, calibrated = view.predicted
    apart = np.linalg.norm(calibrated - nominal, axis=1)
    lengths = view.distances[0] if view.measures else apart
    good = lengths[np.isfinite(lengths) & ~flagged]
    return np.asarray(good if len(good) else lengths[np.isfinite(lengths)])


def motion_table(
    view: View, shown: Mapping[str, Puppet], layout: Arrangement, ball: float
) -> dict[str, Any]:
    """Everything that the script needs, as values that JSON can hold; arrays as base64 of little-endian float32.

    Args:
        view: The view.
        shown: Its robots.
        layout: Where they stand.
        ball: Radius of a target's ball [m].
    """
    on_stage = stage_poses(view)
    measured = np.einsum("nij,nj->ni", on_stage[:, :3, :3], view.measured) + on_stage[:, :3, 3]
    instruments, seen_from = _instruments(on_stage, view.instruments)
    side = layout.side.centre
    return {
        "start": view.start,
        "labels": list(view.labels),
        "kinds": list(view.kinds),
        "robots": {who: _robot(who, shown) for who in shown},
        "measured": _floats(measured),
        "errors": [_numbers(values) for values in view.errors],
        "angles": [_numbers(values) for values in view.angles],
        "instruments": instruments,
        "seenFrom": seen_from,
        "places": {who: (offset - side).tolist() for who, offset in layout.offsets.items()},
        "over": (-layout.over.centre).tolist(),
        "floor": (side - layout.over.centre).tolist(),
        "cameras": {"side": _camera(layout.side), "over": _camera(layout.over)},
        "size": layout.size,
        "ball": ball,
        "arrows": magnification(view, layout.size),
        "cloud": None if view.cloud is None or view.nominal.base_moves else _cloud(view.cloud),
    }


def pose_message(shown: Mapping[str, Puppet], label: str) -> str:
    """A single pose for a page that is open, as JSON: the robots of a view of one pose.

    Args:
        shown: The robots at that pose.
        label: What the pose is called.
    """
    robots = {who: _floats(packed(puppet.poses[:1])) for who, puppet in shown.items()}
    return json.dumps({"pose": {"label": label, "robots": robots}})


def colour_scale(cloud: Cloud) -> tuple[float, float]:
    """The standard deviations of the first and of the last colour of a cloud [m]."""
    low, high = np.quantile(cloud.std, _ENDS)
    return float(low), float(max(high, low * 1.0001, 1e-12))


def _robot(who: str, shown: Mapping[str, Puppet]) -> dict[str, Any]:
    """One robot: its movers at each pose, its rods, and which mover of the nominal robot is the same."""
    puppet, nominal = shown[who], shown["nominal"]
    count, movers = puppet.poses.shape[1], len(puppet.links)
    number = {link: k for k, link in enumerate(nominal.links)}
    same = [number.get(link, -1) for link in puppet.links]
    same += [len(nominal.links) + k for k in range(count - movers)]
    return {
        "movers": count,
        "poses": _floats(packed(puppet.poses)),
        "rods": [*(list(rod) for rod in puppet.rods), [count - 2, count - 1]],
        "same": same,
    }


def _instruments(on_stage: Array, instruments: Array) -> tuple[list[list[float]], list[int]]:
    """The different instruments as positions and quaternions, and which of them saw each row; -1 where unknown."""
    known = np.all(np.isfinite(instruments), axis=(1, 2))
    seen_from = np.full(len(instruments), -1)
    if not np.any(known):
        return [], seen_from.tolist()
    poses = packed(on_stage[known] @ instruments[known])
    different, which = np.unique(poses.round(5), axis=0, return_inverse=True)
    seen_from[known] = np.ravel(which)
    return different.astype(float).tolist(), seen_from.tolist()


def _cloud(cloud: Cloud) -> dict[str, str]:
    """The cloud's points with their colours."""
    low, high = colour_scale(cloud)
    share = (
        np.log(np.maximum(cloud.std, 1e-15) / low) / np.log(high / low)
        if low > 0
        else cloud.std / high
    )
    stops = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in LITTLE_TO_MUCH]) / 255.0
    along = np.linspace(0.0, 1.0, len(stops))
    rgb = np.stack([np.interp(share, along, stops[:, k]) for k in range(3)], axis=1)
    return {
        "points": _floats(cloud.points),
        "colours": _floats(rgb),
        "measured": _floats(cloud.measured),
    }


def _camera(camera: Camera) -> list[float]:
    """Where the camera stands; it lives in a frame with y up, and its target is the origin."""
    x, y, z = camera.position
    return [x, z, -y]


def _floats(values: ArrayLike) -> str:
    """Numbers as base64 of little-endian float32."""
    return as_base64(np.ascontiguousarray(values, dtype="<f4").tobytes())


def _numbers(values: Array) -> list[float | None]:
    """Numbers as JSON has them, nothing for NaN."""
    return [float(f"{value:.9g}") if np.isfinite(value) else None for value in values]


def _spread(numbers: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """At most so many of some numbers, evenly spread."""
    if len(numbers) <= most:
        return numbers
    return (
        numbers[np.linspace(0, len(numbers) - 1, most).round().astype(int)] if most else numbers[:0]
    )
