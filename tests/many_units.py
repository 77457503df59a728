"""A plugin with three kinds of measurement: of five lengths, of two pixels, and of lengths, an angle and a pixel."""

from __future__ import annotations

import numpy as np

from calib.data.kinds import Kind, Reading, register

#: Ends of the draw wires in the measurement frame [m].
WIRES = np.array(
    [[1.5, 0.2, 0.1], [-0.8, 1.4, 0.3], [0.2, -1.3, 0.9], [0.9, 0.8, 1.6], [-0.6, -0.7, 1.8]]
)

#: Focal length of the camera [px].
F = 1000.0


def lengths(T):
    """Distances of the target's origin from five fixed points, shape (n, 5) [m]."""
    return np.linalg.norm(T[:, None, :3, 3] - WIRES, axis=2)


def lengths_derivative(_measured, T, twists):
    """Return the derivative of the distances, shape (n, 5, p)."""
    along = (T[:, None, :3, 3] - WIRES) / lengths(T)[:, :, None]
    return np.einsum("nki,nip->nkp", along, twists[:, :3])


register(
    Kind(
        name="five_wires",
        words="distances to five draw wires",
        units=("m",) * 5,
        readings=tuple(Reading(f"wire_{k}", "length", positive=True) for k in range(1, 6)),
        measure=lengths,
        derivative=lengths_derivative,
    )
)


def image(T):
    """Image of the target in a camera that looks along z of the frame, shape (n, 2) [px]."""
    depth = np.maximum(T[:, 2, 3], 0.05)
    return F * T[:, :2, 3] / depth[:, None]


def image_derivative(_measured, T, twists):
    """Return the derivative of the image coordinates, shape (n, 2, p)."""
    depth = np.maximum(T[:, 2, 3], 0.05)[:, None, None]
    uv = image(T)[:, :, None]
    return (F * twists[:, :2] - uv * twists[:, 2:3]) / depth


register(
    Kind(
        name="corner",
        words="image coordinates of the target",
        units=("px", "px"),
        readings=(Reading("u", "pixel"), Reading("v", "pixel")),
        measure=image,
        derivative=image_derivative,
    )
)


def mixed(T):
    """Position, elevation angle of the target's z axis, and a pixel."""
    tilt = np.arcsin(np.clip(T[:, 2, 2], -1, 1))
    return np.column_stack([T[:, :3, 3], tilt, image(T)[:, 0]])


def mixed_derivative(_measured, T, twists):
    """Return the derivative of all five, shape (n, 5, p)."""
    z = T[:, :3, 2]
    turned = np.cross(twists[:, 3:], z[:, :, None], axis=1)[:, 2:3]
    cosine = np.sqrt(np.maximum(1 - z[:, 2] ** 2, 1e-6))[:, None, None]
    return np.concatenate(
        [twists[:, :3], turned / cosine, image_derivative(None, T, twists)[:, :1]], axis=1
    )


register(
    Kind(
        name="mixed",
        words="position, tilt and an image coordinate",
        units=("m", "m", "m", "rad", "px"),
        position=True,
        readings=(Reading("tilt", "angle"), Reading("column", "pixel")),
        measure=mixed,
        derivative=mixed_derivative,
    )
)
