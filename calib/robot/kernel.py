"""The one arithmetic of poses and their derivatives, vectorised over samples; it knows arrays only, no robot.

A frame of B samples is an array of shape (4, 3, B): its axes x, y, z and its origin, along the axes of the measurement
frame. Samples come last, so that a constant placement is one matrix product for all samples, and so is the step from
a chain's regressor to the columns of a model's parameters. A twist (v, w) of a body with the axes R moves a point of
it, d from its origin, with R v + (R w) x d: that is the whole derivative, and it is exact.

Samples are worked on in blocks that stay in the processor's cache.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from calib.units import Array

Numbers = NDArray[np.int_]


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """A serial chain, seen at targets from measurement frames; every pose of shape (4, 4) [m]."""

    #: shape (n,), which joints slide along their axis; the others turn about it.
    slides: NDArray[np.bool_]
    turns: Array  #: shape (n, 3, 3), a rotation that takes z to each joint's axis, see `turns_to`.
    placements: Array  #: shape (n + 1, 4, 4): of each joint in the one before it, of the tip in the last joint.
    bases: Array  #: shape (F, 4, 4), T_frame_base.
    T_base_root: Array  #: shape (4, 4), of the frame that the first placement is given in.
    targets: Array  #: shape (T, 4, 4), T_tip_target.


@dataclass(frozen=True, slots=True, eq=False)
class Directions:
    """What a unit of each of p parameters does: twists, linear part first, in the local axes of the places."""

    bases: Array  #: shape (F, 6, p), of the base behind each frame.
    placements: Array  #: shape (n + 1, 6, p), of the joints and the tip.
    targets: Array  #: shape (T, 6, p).


@dataclass(frozen=True, slots=True, eq=False)
class ChainSamples:
    """Where the robot stood in N samples, and which frame saw which target."""

    values: Array  #: shape (N, n), of the chain's joints [rad or m].
    frame: Numbers  #: shape (N,), number of the frame.
    target: Numbers  #: shape (N,), number of the target.
    moved: Array  #: shape (N, n, k), how far a unit of some parameters moves each joint besides; k = 0 for none.
    columns: Numbers  #: shape (k,), which parameters these are.


def turns_to(axes: Array) -> Array:
    """For each unit vector, shape (n, 3), a rotation that takes z there, shape (n, 3, 3)."""
    x, y, z = np.reshape(axes, (-1, 3)).T
    # From the nearer of z and -z, for the other one's formula divides by next to nothing.
    side = np.where(z >= 0.0, 1.0, -1.0)
    y, z = side * y, side * z
    c = 1.0 / (1.0 + z)
    turns = np.array(
        [[1.0 - c * x * x, -c * x * y, x], [-c * x * y, 1.0 - c * y * y, y], [-x, -y, z]]
    )
    turns[1:] *= side
    return np.ascontiguousarray(np.moveaxis(turns, 2, 0))


def poses(geometry: Geometry, stood: ChainSamples) -> Array:
    """T_frame_target, shape (N, 4, 4), [m]."""
    found = np.empty((len(stood.values), 4, 4))
    found[:, 3] = 0.0, 0.0, 0.0, 1.0
    steps = _steps(geometry)

    def work(own: slice) -> None:
        found[own, :3] = _frames(geometry, steps, stood, own)[-1].transpose(2, 1, 0)

    over_blocks(work, len(found))
    return found


def twists(
    geometry: Geometry, directions: Directions, stood: ChainSamples, *, rotation: bool = True
) -> tuple[Array, Array]:
    """T_frame_target, (N, 4, 4), [m], and the target's velocity in a unit of each parameter, in the frame's axes.

    The velocity has shape (N, 6, p), or (N, 3, p) without ``rotation``; samples are last in memory.
    """
    N, p = len(stood.values), directions.placements.shape[2]
    T_frame_target = np.empty((N, 4, 4))
    T_frame_target[:, 3] = 0.0, 0.0, 0.0, 1.0
    found = np.empty((p, 6 if rotation else 3, N))
    steps, n = _steps(geometry), len(geometry.slides)
    # Joints are looked at along their turned axes, and a place that many samples share is like a joint.
    inner = directions.placements.reshape(n + 1, 2, 3, p).copy()
    inner[:n] = geometry.turns.transpose(0, 2, 1)[:, None] @ inner[:n]
    seen = (directions.bases, stood.frame), (directions.targets, stood.target)
    linear = inner.reshape(6 * (n + 1), p).T
    angular = inner[:, 1].reshape(3 * (n + 1), p).T

    def work(own: slice) -> None:
        frames = _frames(geometry, steps, stood, own)
        T_frame_target[own, :3] = frames[-1].transpose(2, 1, 0)
        moves, axes = regressor(frames, frames[-1, 3]), frames[:, :3]
        B = frames.shape[3]
        joints = np.arange(1, n + 1)
        along = moves[joints, np.where(geometry.slides, 2, 5)]
        part = (linear @ moves[1:-1].reshape(6 * (n + 1), 3 * B)).reshape(p, 3, B)
        add(part, moves, 0, along, own)
        found[:, :3, own] = part
        if rotation:
            about = np.where(geometry.slides[:, None, None], 0.0, axes[joints, 2])
            part = (angular @ axes[1:-1].reshape(3 * (n + 1), 3 * B)).reshape(p, 3, B)
            add(part, axes, 3, about, own)
            found[:, 3:, own] = part

    def add(part: Array, moves: Array, first: int, along: Array, own: slice) -> None:
        """What parameters of frames, targets and the joints' state do besides."""
        for k, (local, which) in zip((0, -1), seen, strict=True):
            add_columns(part, moves[k], local[:, first:], which[own])
        if len(stood.columns):
            part[stood.columns] += np.einsum("idb,bik->kdb", along, stood.moved[own])

    over_blocks(work, N)
    return T_frame_target, found.transpose(2, 1, 0)


def regressor(frames: Array, point: Array) -> Array:
    """The velocity of a point, (3, B), that unit twists of bodies, (P, 4, 3, B), carry along; shape (P, 6, 3, B)."""
    axes = frames[:, :3]
    d = (point - frames[:, 3])[:, None]
    moves = np.empty((len(frames), 6, *frames.shape[2:]))
    moves[:, :3] = axes
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(axes[:, :, j], d[:, :, k], out=moves[:, 3:, i])
        moves[:, 3:, i] -= axes[:, :, k] * d[:, :, j]
    return moves


def add_columns(columns: Array, moves: Array, local: Array, which: Numbers) -> None:
    """Add to columns (p, 3, B) what parameters of one of several like places do, each to its own samples.

    ``moves`` (d, 3, B) is what unit twists of each sample's place do, ``local`` (K, d, p) the parameters' twists there,
    ``which`` (B,) the place of each sample.
    """
    for k, twist in enumerate(local):
        used = np.flatnonzero(twist.any(axis=0))
        if not len(used):
            continue
        first, last = int(used[0]), int(used[-1]) + 1  # columns between them get nothing
        own = slice(None) if len(local) == 1 else np.flatnonzero(which == k)
        there = moves[:, :, own]
        part = twist[:, first:last].T @ there.reshape(len(there), -1)
        columns[first:last, :, own] += part.reshape(last - first, *there.shape[1:])


def carried(frames: Array, T: Array, which: Numbers) -> Array:
    """Frames, shape (4, 3, B), followed by one of some placements, shapes (K, 4, 4) and (B,)."""
    if len(T) == 1:
        return np.asarray((T[0].T @ frames.reshape(4, -1)).reshape(frames.shape))
    return np.asarray(np.einsum("bkc,kib->cib", T[which], frames))


def _steps(geometry: Geometry) -> Array:
    """The placements between turned joints, whose axis is z: of the first in the base, ..., of the tip in the last."""
    n = len(geometry.slides)
    steps: Array = geometry.placements.copy()
    steps[:n, :3, :3] = steps[:n, :3, :3] @ geometry.turns
    steps[1:, :3] = geometry.turns.transpose(0, 2, 1) @ steps[1:, :3]
    steps[0] = geometry.T_base_root @ steps[0]
    return steps


def _frames(geometry: Geometry, steps: Array, stood: ChainSamples, own: slice) -> Array:
    """The frames of base, joints before they move, tip and target, shape (n + 3, 4, 3, B)."""
    values, n = stood.values[own].T, len(geometry.slides)
    B = values.shape[1]
    frames = np.empty((n + 3, 4, 3, B))
    bases = geometry.bases[:, :3]
    if len(bases) == 1:
        frames[0] = bases[0].T[:, :, None]
    else:
        frames[0] = bases[stood.frame[own]].transpose(2, 1, 0)
    sines, cosines = np.sin(values), np.cos(values)
    moved = frames[0]
    room = np.empty((4, 3, B))
    for i in range(n):
        frame = frames[i + 1]
        np.matmul(steps[i].T, moved.reshape(4, 3 * B), out=frame.reshape(4, 3 * B))
        moved = room
        if geometry.slides[i]:
            moved[:] = frame
            moved[3] += frame[2] * values[i]
        else:
            s, c = sines[i], cosines[i]
            np.multiply(frame[0], c, out=moved[0])
            moved[0] += frame[1] * s
            np.multiply(frame[1], c, out=moved[1])
            moved[1] -= frame[0] * s
            moved[2:] = frame[2:]
    np.matmul(steps[n].T, moved.reshape(4, 3 * B), out=frames[n + 1].reshape(4, 3 * B))
    frames[n + 2] = carried(frames[n + 1], geometry.targets, stood.target[own])
    return frames


T = TypeVar("T")

BLOCK = 1024  #: Samples of one block.


def over_blocks(work: Callable[[slice], T], count: int) -> list[T]:
    """What ``work`` gives for each block of samples, in their order."""
    return [work(slice(k, min(k + BLOCK, count))) for k in range(0, count, BLOCK)]
