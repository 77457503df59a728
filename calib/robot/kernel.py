"""Poses and their derivatives, vectorised over samples: all of them are computed here, from arrays alone.

A frame of B samples is an array of shape (4, 3, B): its axes x, y, z and its origin, along the axes of the measurement
frame. Samples come last, so that a constant placement is one matrix product for all samples, and so is the step from
a chain's regressor to the columns of a model's parameters. A twist (v, w) of a body with the axes R moves a point of
it, d from its origin, with R v + (R w) x d: that is the whole derivative, and it is exact.

Samples are processed in blocks that stay in the processor's cache. What a block needs of the chain and of the
parameters is prepared once, in `Motion`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import parent_process
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from calib.basics.arrays import Array
from calib.basics.jobs import core_count

Numbers = NDArray[np.int_]


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """A serial chain, seen at targets from measurement frames."""

    #: shape (n,), True for joints that slide along their axis; the others turn about it.
    slides: NDArray[np.bool_]
    #: Shape (n, 3, 3), a rotation that takes z to each joint's axis, see `turns_to`.
    turns: Array
    #: Shape (n + 1, 4, 4), [m]: of each joint in the one before it, of the tip in the last joint.
    placements: Array
    #: Shape (F, 4, 4), [m], T_frame_base.
    bases: Array
    #: Shape (4, 4), [m], of the frame that the first placement is given in.
    T_base_root: Array
    #: Shape (T, 4, 4), [m], T_tip_target.
    targets: Array


@dataclass(frozen=True, slots=True, eq=False)
class Directions:
    """Twists per unit of each of p parameters, linear part first, in the local axes of the place that they move."""

    #: Shape (F, 6, p), of the base in each measurement frame.
    bases: Array
    #: Shape (n + 1, 6, p), of the joints and the tip.
    placements: Array
    #: Shape (T, 6, p).
    targets: Array


@dataclass(frozen=True, slots=True, eq=False)
class ChainSamples:
    """Joint values of the chain in N samples, and the frame and the target of each."""

    #: Shape (N, n), of the chain's joints, their own errors included [rad or m].
    values: Array
    #: Shape (N,), index of the measurement frame, from 0.
    frame: Numbers
    #: Shape (N,), index of the target, from 0.
    target: Numbers
    #: shape (N, n, k), derivative of ``values`` by the k parameters that change them; k = 0 if there are none.
    moved: Array
    #: Shape (k,), indices of these parameters among all p.
    columns: Numbers


def turns_to(axes: Array) -> Array:
    """Return a rotation that takes z to each of n unit vectors, (n, 3) to (n, 3, 3)."""
    x, y, z = np.reshape(axes, (-1, 3)).T
    # From the nearer of z and -z: the formula for the other divides by nearly zero.
    side = np.where(z >= 0.0, 1.0, -1.0)
    y = side * y
    z = side * z
    c = 1.0 / (1.0 + z)
    turns = np.array(
        [
            [1.0 - c * x * x, -c * x * y, x],
            [-c * x * y, 1.0 - c * y * y, y],
            [-x, -y, z],
        ]
    )
    turns[1:] *= side
    return np.ascontiguousarray(np.moveaxis(turns, 2, 0))


@dataclass(frozen=True, slots=True, eq=False)
class _Share:
    """The twist of one body by some of the parameters."""

    #: Its index among the frames of `_frames`
    body: int
    #: Which of the p parameters
    parameters: slice | Numbers
    #: shape (k, 6), twist of the body per unit of each of these k parameters, along the axes of its frame
    twists: Array
    #: True if these parameters have a part of an earlier body already
    adds: bool


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A chain and how its p parameters move the targets, ready for any samples."""

    #: The chain, its measurement frames and its targets
    geometry: Geometry
    #: Twists of the p parameters at the places that they move
    directions: Directions
    #: The placements of `_steps`
    _steps: Array = field(init=False, repr=False)
    #: What parameters of the joints and the tip move, body by body
    _shares: tuple[_Share, ...] = field(init=False, repr=False)
    #: The parameters that no share has
    _others: Numbers = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Find which parameters each body has: most have one alone."""
        geometry, directions = self.geometry, self.directions
        n = len(geometry.slides)
        # Twists of joints along the frames of `_steps`, whose z is the joint's axis.
        inner = directions.placements.reshape(n + 1, 2, 3, -1).copy()
        inner[:n] = geometry.turns.transpose(0, 2, 1)[:, None] @ inner[:n]
        bodies = [*inner.reshape(n + 1, 6, -1)]
        numbers = [*range(1, n + 2)]
        # All samples see the only frame, and the only target.
        if len(directions.bases) == 1:
            bodies.append(directions.bases[0])
            numbers.append(0)
        if len(directions.targets) == 1:
            bodies.append(directions.targets[0])
            numbers.append(n + 2)
        shares = []
        moving = np.any(bodies, axis=1)
        first = np.argmax(moving, axis=0)  # the first body of each parameter
        for k, (body, twists_of_body) in enumerate(zip(numbers, bodies, strict=True)):
            for chosen, adds in (
                (moving[k] & (first == k), False),
                (moving[k] & (first < k), True),
            ):
                which = np.flatnonzero(chosen)
                if len(which):
                    of_these = np.ascontiguousarray(twists_of_body[:, which].T)
                    shares.append(_Share(body, _run(which), of_these, adds))
        has_share = moving.any(axis=0)
        object.__setattr__(self, "_steps", _steps(geometry))
        object.__setattr__(self, "_shares", tuple(shares))
        object.__setattr__(self, "_others", np.flatnonzero(~has_share))

    def over(self, samples: ChainSamples, block: slice, *, rotation: bool) -> tuple[Array, Array]:
        """Return the target's frame in a block of B samples, and its Jacobian.

        Args:
            samples: N samples.
            block: Some of them, few enough that what is computed stays in the cache.
            rotation: False for the velocity of the target's origin alone.

        Returns:
            Axes x, y, z and origin of the target, shape (4, 3, B), [m], along the axes of the measurement frame; and
            its velocity per unit of each parameter, shape (p, 6, B), or (p, 3, B) without ``rotation``, as of `twists`.
        """
        geometry, directions = self.geometry, self.directions
        n = len(geometry.slides)
        joints = np.arange(1, n + 1)
        frames = _frames(geometry, self._steps, samples, block)
        B = frames.shape[3]
        jacobian = np.empty((directions.placements.shape[2], 6 if rotation else 3, B))

        def fill(part: Array, moves: Array, components: slice, joint_moves: Array) -> None:
            """Fill in linear or angular velocities (p, 3, B) by those per unit twist of each body (n + 3, d, 3, B)."""
            part[self._others] = 0.0
            for share in self._shares:
                of_body = moves[share.body].reshape(moves.shape[1], 3 * B)
                velocity = share.twists[:, components] @ of_body
                velocity = velocity.reshape(len(velocity), 3, B)
                if share.adds:
                    part[share.parameters] += velocity
                else:
                    part[share.parameters] = velocity
            if len(directions.bases) > 1:
                bases = directions.bases[:, components]
                add_columns(part, moves[0], bases, samples.frame[block])
            if len(directions.targets) > 1:
                targets = directions.targets[:, components]
                add_columns(part, moves[-1], targets, samples.target[block])
            if len(samples.columns):
                moved = samples.moved[block]
                part[samples.columns] += np.einsum("idb,bik->kdb", joint_moves, moved)

        moves = regressor(frames, frames[-1, 3])
        along = moves[joints, np.where(geometry.slides, 2, 5)] if len(samples.columns) else moves
        fill(jacobian[:, :3], moves, slice(0, 6), along)
        if rotation:
            axes = frames[:, :3]
            about = np.where(geometry.slides[:, None, None], 0.0, axes[joints, 2])
            fill(jacobian[:, 3:], axes, slice(3, 6), about)
        return frames[-1], jacobian


def _run(numbers: Numbers) -> slice | Numbers:
    """Return ascending indices as a slice if they are consecutive."""
    first, last = int(numbers[0]), int(numbers[-1])
    return slice(first, last + 1) if last - first + 1 == len(numbers) else numbers


def poses(geometry: Geometry, samples: ChainSamples) -> Array:
    """Return T_frame_target of every sample.

        T_frame_target = T_frame_base T_base_root  P_1 J_1(q_1) ... P_n J_n(q_n)  P_tip  T_tip_target

    Args:
        geometry: The chain, its measurement frames and its targets.
        samples: N samples.

    Returns:
        Shape (N, 4, 4), [m].
    """
    count = len(samples.values)
    T_frame_target = _poses_to_fill(count)
    steps = _steps(geometry)

    def work(block: slice) -> None:
        target_frame = _frames(geometry, steps, samples, block)[-1]
        T_frame_target[block, :3] = target_frame.transpose(2, 1, 0)

    over_blocks(work, count)
    return T_frame_target


def twists(motion: Motion, samples: ChainSamples, *, rotation: bool = True) -> tuple[Array, Array]:
    """Return T_frame_target and its Jacobian: the target's velocity per unit of each parameter.

    The velocity is that of the target's origin, then the angular velocity, both along the axes of the measurement
    frame: column k is (dp, dphi) / dx_k, with dR = [dphi]_x R.

    Args:
        motion: The chain, and the twists of the p parameters.
        samples: N samples.
        rotation: False for the velocity of the origin alone.

    Returns:
        T_frame_target, shape (N, 4, 4), [m]; and the Jacobian, shape (N, 6, p), or (N, 3, p) without ``rotation``,
        [m and rad per unit of the parameter]. In the Jacobian's memory samples come last.
    """
    count = len(samples.values)
    T_frame_target = _poses_to_fill(count)
    if count <= BLOCK:
        target_frame, jacobian = motion.over(samples, slice(0, count), rotation=rotation)
        T_frame_target[:, :3] = target_frame.transpose(2, 1, 0)
        return T_frame_target, jacobian.transpose(2, 1, 0)
    jacobian = np.empty((motion.directions.placements.shape[2], 6 if rotation else 3, count))

    def work(block: slice) -> None:
        """Fill in the poses and the Jacobian of a block of samples."""
        target_frame, jacobian[:, :, block] = motion.over(samples, block, rotation=rotation)
        T_frame_target[block, :3] = target_frame.transpose(2, 1, 0)

    over_blocks(work, count)
    return T_frame_target, jacobian.transpose(2, 1, 0)


def regressor(frames: Array, point: Array) -> Array:
    """Return the velocity of a point that unit twists of P bodies carry along.

        v_point = R v + (R w) x (point - origin)

    Args:
        frames: Shape (P, 4, 3, B), axes R and origin of each body in B samples [m].
        point: Shape (3, B), [m].

    Returns:
        Shape (P, 6, 3, B): the velocity per unit of v along, then of w about, the x, y and z axis of each body.
    """
    axes = frames[:, :3]
    d = (point - frames[:, 3])[:, None]
    moves = np.empty((len(frames), 6, *frames.shape[2:]))
    moves[:, :3] = axes
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(axes[:, :, j], d[:, :, k], out=moves[:, 3:, i])
        moves[:, 3:, i] -= axes[:, :, k] * d[:, :, j]
    return moves


def add_columns(columns: Array, moves: Array, twists_at: Array, place: Numbers) -> None:
    """Add the Jacobian columns of frame or target parameters to the samples that see them.

    Args:
        columns: Shape (p, 3, B), the Jacobian of B samples, added to in place.
        moves: Shape (d, 3, B), velocity per unit twist of the place that each sample sees; d = 6, or 3 angular.
        twists_at: Shape (K, d, p), twists of the parameters at each of K frames or targets.
        place: Shape (B,), index of the frame or target that each sample sees.
    """
    for k, twist in enumerate(twists_at):
        used = np.flatnonzero(twist.any(axis=0))
        if not len(used):
            continue
        # A slice is faster than indices; the unused columns within it get zeros added.
        first = int(used[0])
        last = int(used[-1]) + 1
        seeing: slice | Numbers = slice(None)
        if len(twists_at) > 1:
            seeing = np.flatnonzero(place == k)
        seen_moves = moves[:, :, seeing]
        part = twist[:, first:last].T @ seen_moves.reshape(len(seen_moves), -1)
        columns[first:last, :, seeing] += part.reshape(last - first, *seen_moves.shape[1:])


def carry_frames(frames: Array, T: Array, place: Numbers) -> Array:
    """Return the next frames: frames times the placement that belongs to each sample.

    Args:
        frames: Shape (4, 3, B), axes x, y, z and origin [m] of a frame in B samples.
        T: Shape (K, 4, 4), [m], the placements to choose from.
        place: Shape (B,), index of each sample's placement.

    Returns:
        Shape (4, 3, B), [m].
    """
    if len(T) == 1:
        return np.asarray((T[0].T @ frames.reshape(4, -1)).reshape(frames.shape))
    return np.asarray(np.einsum("bkc,kib->cib", T[place], frames))


def _poses_to_fill(count: int) -> Array:
    """Return ``count`` poses to fill in, (N, 4, 4): only their last row, 0 0 0 1, is set."""
    T = np.empty((count, 4, 4))
    T[:, 3] = 0.0, 0.0, 0.0, 1.0
    return T


def _steps(geometry: Geometry) -> Array:
    """Return the placements (n + 1, 4, 4) [m], P_1 in the base, ..., P_tip, between joints whose axis is z.

    With the rotation Q = ``turns`` a joint is J(axis, q) = Q J(z, q) Q^-1; Q^-1 and the next Q go into the placements.
    """
    n = len(geometry.slides)
    steps: Array = geometry.placements.copy()
    steps[:n, :3, :3] = steps[:n, :3, :3] @ geometry.turns
    steps[1:, :3] = geometry.turns.transpose(0, 2, 1) @ steps[1:, :3]
    steps[0] = geometry.T_base_root @ steps[0]
    return steps


def _frames(geometry: Geometry, steps: Array, samples: ChainSamples, block: slice) -> Array:
    """Return the frames of base, n joints before they move, tip and target in a block of B samples.

    Shape (n + 3, 4, 3, B): axes x, y, z and origin [m] of each, along the axes of the sample's measurement frame.
    ``steps`` are the placements of `_steps`.
    """
    values = np.ascontiguousarray(samples.values[block].T)
    n, B = values.shape
    # By the tangent of the half angle, because NumPy has one function of angles that is fast.
    tangents = np.tan(0.5 * values)
    one_more = 2.0 / (1.0 + tangents * tangents)
    cosines = one_more - 1.0
    sines = one_more * tangents
    frames = np.empty((n + 3, 4, 3, B))
    bases = geometry.bases[:, :3]
    if len(bases) == 1:
        frames[0] = bases[0].T[:, :, None]
    else:
        frames[0] = bases[samples.frame[block]].transpose(2, 1, 0)
    moved = frames[0]
    moved_joint = np.empty((4, 3, B))
    by_sine = np.empty((2, 3, B))
    for i in range(n):
        np.matmul(steps[i].T, moved.reshape(4, -1), out=frames[i + 1].reshape(4, -1))
        # The joint moves its frame along, or about, its own z.
        frame = frames[i + 1]
        if geometry.slides[i]:
            moved_joint[:] = frame
            moved_joint[3] += frame[2] * values[i]
        else:
            np.multiply(frame[:2], cosines[i], out=moved_joint[:2])
            np.multiply(frame[:2], sines[i], out=by_sine)
            moved_joint[0] += by_sine[1]
            moved_joint[1] -= by_sine[0]
            moved_joint[2:] = frame[2:]
        moved = moved_joint
    np.matmul(steps[n].T, moved.reshape(4, -1), out=frames[n + 1].reshape(4, -1))
    frames[n + 2] = carry_frames(frames[n + 1], geometry.targets, samples.target[block])
    return frames


T = TypeVar("T")

# The C library glibc (Linux) gives large blocks back to the system at once, and clearing their pages again takes longer
# than a fit, until it has seen a block of up to 32 MB freed: then it keeps as much for the next. This one is never
# written to. With other C libraries it has no effect.
np.empty(2**25 - 2**16, dtype=np.uint8)

#: Samples of one block: with fewer, NumPy's calls take longer than the arithmetic; what more need leaves the cache.
BLOCK = 4096


#: Up to so many blocks are worked off by one thread: to start others takes as long as one of them.
_FEW_BLOCKS = 8

#: Threads of many blocks: memory does not feed more of them.
_THREADS = 2


def over_blocks(work: Callable[[slice], T], count: int, *, in_threads: bool = False) -> list[T]:
    """Call a function for each block of samples, so that what it computes stays in the processor's cache.

    Args:
        work: Function of the slice of one block's samples.
        count: Number of all samples.
        in_threads: Whether it may be called for several blocks at a time. Only the main process does so: its workers
            have the other cores.

    Returns:
        Its results, block by block, whatever the number of threads.
    """
    return list(_results_of_blocks(work, count, in_threads))


def sum_over_blocks(work: Callable[[slice], Array], count: int) -> Array:
    """Return the sum of the arrays, of one shape, that a function returns for each block of samples, see `over_blocks`.

    Blocks are added in their order, each as soon as it is there.
    """
    results = _results_of_blocks(work, count, in_threads=True)
    total = np.array(next(results, 0.0))
    for result in results:
        total += result
    return total


def _results_of_blocks(work: Callable[[slice], T], count: int, in_threads: bool) -> Iterator[T]:
    """Yield what a function returns for each block of samples, see `over_blocks`."""
    blocks = [slice(k, min(k + BLOCK, count)) for k in range(0, count, BLOCK)]
    if not in_threads or len(blocks) <= _FEW_BLOCKS or parent_process() is not None:
        yield from map(work, blocks)
        return
    with ThreadPoolExecutor(min(_THREADS, core_count())) as threads:
        yield from threads.map(work, blocks)
