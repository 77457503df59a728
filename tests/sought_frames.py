"""Kinds of measurement without `locate`, and virtual cells that measure them in frames of which nothing is stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.data import kinds
from calib.data.kinds import Kind, Reading, register

#: Place of the target in the tip [m].
TARGET = np.array([0.05, 0.05, 0.05])

#: Fixed points of the drawn wires, in their own frame [m].
FIXED_POINTS = np.array(
    [[0.0, 0.0, 0.0], [0.6, 0.0, 0.0], [0.0, 0.5, 0.0], [0.6, 0.5, 0.1], [0.3, 0.2, 0.4]]
)

#: Focal length of the camera [px].
FOCAL_LENGTH = 1000.0

#: Depth below which the camera's projection takes this one: nothing is seen behind it [m].
NEAREST = 0.05


def line_distance(T):
    return np.hypot(T[:, 0, 3], T[:, 1, 3])[:, None]


def line_derivative(_measured, T, twists):
    across = T[:, :2, 3] / np.maximum(line_distance(T), 1e-12)
    return np.einsum("ni,nip->np", across, twists[:, :2])[:, None]


def line_angle(T):
    return np.arccos(np.clip(T[:, 2, 2], -1.0, 1.0))[:, None]


def line_angle_derivative(_measured, T, twists):
    z = T[:, :3, 2]
    sine = np.maximum(np.sqrt(1.0 - np.clip(z[:, 2], -1.0, 1.0) ** 2), 1e-9)
    cosine_by_turn = twists[:, 3] * z[:, 1, None] - twists[:, 4] * z[:, 0, None]
    return (-cosine_by_turn / sine[:, None])[:, None]


def wire_lengths(T):
    return np.linalg.norm(T[:, None, :3, 3] - FIXED_POINTS, axis=2)


def wire_derivative(_measured, T, twists):
    along = (T[:, None, :3, 3] - FIXED_POINTS) / np.maximum(wire_lengths(T)[:, :, None], 1e-12)
    return np.einsum("nki,nip->nkp", along, twists[:, :3])


def pixels(T):
    return FOCAL_LENGTH * T[:, :2, 3] / np.maximum(T[:, 2:3, 3], NEAREST)


def pixel_derivative(_measured, T, twists):
    depth = np.maximum(T[:, 2:3, 3], NEAREST)
    seen = T[:, 2:3, 3] > NEAREST
    columns = []
    for k in range(2):
        tangent = T[:, k, 3, None] / depth
        columns.append(FOCAL_LENGTH * (twists[:, k] - seen * tangent * twists[:, 2]) / depth)
    return np.stack(columns, axis=1)


def own_kind(name, unit, measure, derivative, readings=1, **more):
    """A kind with a frame of its own, which is not located."""
    quantity = {"m": "length", "rad": "angle", "px": "pixel"}[unit]
    columns = tuple(Reading(f"{name}_{k}", quantity) for k in range(readings))
    return Kind(
        name=name,
        words=name,
        units=(unit,) * readings,
        readings=columns,
        measure=measure,
        derivative=derivative,
        own_frame=True,
        **more,
    )


#: By what their rows measure.
KINDS = {
    "line": own_kind(
        "sought_line",
        "m",
        line_distance,
        line_derivative,
        directions=("x", "y", "rx", "ry"),
        own_axes=True,
    ),
    "angle": own_kind(
        "sought_angle",
        "rad",
        line_angle,
        line_angle_derivative,
        directions=("rx", "ry"),
        own_axes=True,
    ),
    "range": own_kind(
        "sought_range",
        "m",
        kinds.get("distance").measure,
        kinds.get("distance").derivative,
        directions=("x", "y", "z"),
    ),
    "height": own_kind(
        "sought_height",
        "m",
        lambda T: T[:, 2:3, 3],
        lambda _measured, _T, twists: twists[:, 2:3],
        directions=("z", "rx", "ry"),
        own_axes=True,
    ),
    "wires": own_kind("sought_wires", "m", wire_lengths, wire_derivative, readings=5),
    "camera": own_kind("sought_camera", "px", pixels, pixel_derivative, readings=2),
}


@pytest.fixture
def sought_kinds(monkeypatch):
    """The kinds, registered for one test."""
    monkeypatch.setattr(kinds, "_KINDS", dict(kinds._KINDS))
    for kind in KINDS.values():
        register(kind)


def turned_frame(rng, reach):
    """T_frame_base of a frame that stands anywhere within an arm's reach [m], turned anyhow."""
    away = rng.normal(size=3)
    origin = [0.0, 0.0, 0.3 * reach] + reach * rng.uniform(0.2, 1.0) * away / np.linalg.norm(away)
    R = Rotation.random(random_state=int(rng.integers(1 << 31))).as_matrix()
    return at(R, origin)


def camera_frame(rng, reach):
    """T_frame_base of a camera outside of an arm's reach [m] that looks at it."""
    away = rng.normal(size=3) * [1.0, 1.0, 0.5] + [0.0, 0.0, 0.5]
    origin = reach * rng.uniform(1.5, 3.0) * away / np.linalg.norm(away)
    z = 0.2 * reach * rng.normal(size=3) - origin
    z /= np.linalg.norm(z)
    x = np.cross(z, rng.normal(size=3))
    x /= np.linalg.norm(x)
    return at(np.array([x, np.cross(z, x), z]), origin)


def at(R_frame_base, origin):
    """T_frame_base of a frame whose origin is at a point of the base [m]."""
    T = np.eye(4)
    T[:3, :3] = R_frame_base
    T[:3, 3] = -R_frame_base @ origin
    return T


def measured(robot, what, seed, count=None):
    """A virtual robot's table of 60 to 100 rows of a kind in a frame drawn at random.

    Args:
        robot: The nominal robot.
        what: The kind, by its key in `KINDS`.
        seed: Of the frame, the robot's errors, the poses and the noise.
        count: Number of rows; None: 60 to 100.

    Returns:
        The table, and the cell with the frame; without it: `unstated`.
    """
    rng = np.random.default_rng(seed)
    reach = 0.5 if robot.name.startswith("ur") else 0.8
    T_frame_base = camera_frame(rng, reach) if what == "camera" else turned_frame(rng, reach)
    rows = int(rng.integers(60, 101)) if count is None else count
    kind = KINDS[what]
    cell = calib.Cell(target=TARGET, kind=kind.name, T_frame_base=T_frame_base, model="dh")
    scenario = calib.Scenario(robot, cell=cell, model="dh", sigma={"rad": 1e-4, "px": 0.3})
    q = scenario.random_poses(4 * rows, seed)
    if what == "camera":
        depth = (T_frame_base @ robot.poses(q) @ [*TARGET, 1.0])[:, 2]
        q = q[depth > 0.2]
    return scenario.draw(seed).measure(q[:rows], seed=seed).measurements, cell


def unstated(cell):
    """A cell without the pose of its frame."""
    return replace(cell, T_frame_base=None)
