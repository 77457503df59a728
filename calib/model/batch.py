"""Many samples at once: what `calib.model.kernel` reads, prepared from a robot under an error model.

A chunk of samples is one call of the kernel. Chunks are shared out among threads and put together in their order, so
that the result does not depend on their number.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.model.joint_errors import driven_joints, factor_of
from calib.model.parameters import FRAME, TARGET, TIP
from calib.model.robot import Robot, rigid_inverse

if TYPE_CHECKING:
    from calib.model.kernel_types import Geometry, Stood
    from calib.model.kinematics import Kinematics, Samples

Array = NDArray[np.float64]
T = TypeVar("T")

#: From so many samples on the kernel is used; below, loading it takes longer than Pinocchio's loop.
MANY = 1500

#: Samples of one call of the kernel; four times as many of a table of so many chunks, for what a call costs besides.
CHUNK = 4096
_HUGE = 64

#: What the threads are called.
_NAME = "calib-chunks"


@dataclass(frozen=True, slots=True, eq=False)
class Displaced:
    """The placements at one x, and what a unit of each parameter does to them.

    Attributes:
        placements: shape (n, 4, 4), of the joints [m].
        T_frame_base: shape (F, 4, 4), [m].
        T_frame_root: shape (F, 4, 4), [m].
        T_last_tip: shape (4, 4), of the tip in the last joint [m].
        T_tip_target: shape (T, 4, 4), [m].
        directions: shape (6 places, p), see `ErrorModel.displacements`.
    """

    placements: Array
    T_frame_base: Array
    T_frame_root: Array
    T_last_tip: Array
    T_tip_target: Array
    directions: Array

    @classmethod
    def of(cls, kinematics: Kinematics, x: Array) -> Displaced:
        """Displace every placement."""
        robot, model = kinematics.robot, kinematics.model
        displacement, directions = model.displacements(x)
        n, frames = len(robot.joints), len(kinematics.T_frame_base)
        T_frame_base = kinematics.T_frame_base @ displacement[:frames]
        return cls(
            placements=robot.placements[:n] @ displacement[frames : frames + n],
            T_frame_base=T_frame_base,
            T_frame_root=T_frame_base @ rigid_inverse(robot.T_root_base),
            T_last_tip=robot.placements[n] @ displacement[frames + n],
            T_tip_target=kinematics.T_tip_target @ displacement[frames + n + 1 :],
            directions=directions,
        )


def chunks(count: int) -> Iterator[tuple[int, int]]:
    """First and behind the last number of each chunk of some samples."""
    size = CHUNK if count < _HUGE * CHUNK else 4 * CHUNK
    return ((first, min(first + size, count)) for first in range(0, count, size))


def in_threads(work: Callable[[int, int], T], count: int) -> list[T]:
    """What ``work`` gives for each chunk of some samples, in their order, by as many threads as there are cores."""
    parts = list(chunks(count))
    threads = _threads()
    # Work that is itself in one of the threads must not wait for them.
    if min(threads, len(parts)) < 2 or threading.current_thread().name.startswith(_NAME):
        return [work(*part) for part in parts]
    return list(_pool(threads).map(lambda part: work(*part), parts))


@lru_cache(maxsize=1)
def _pool(threads: int) -> ThreadPoolExecutor:
    """The threads that wait for chunks: to start them anew for each pass would take longer than a short pass does."""
    return ThreadPoolExecutor(threads, thread_name_prefix=_NAME)


if hasattr(os, "register_at_fork"):
    # A forked process has none of its parent's threads.
    os.register_at_fork(after_in_child=_pool.cache_clear)


def _threads() -> int:
    """The cores that this process may use, or as many as OMP_NUM_THREADS says."""
    asked = os.environ.get("OMP_NUM_THREADS", "")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return max(int(asked) if asked.isdecimal() else (cores or 1), 1)


def geometry_of(kinematics: Kinematics, x: Array, *, columns: bool = True) -> Geometry:
    """The chain at x.

    Args:
        kinematics: The robot under its error model.
        x: shape (p,), [m] and [rad].
        columns: Whether derivatives are asked for.
    """
    at, robot = Displaced.of(kinematics, x), kinematics.robot
    entries = (*_no_entries(), 0)
    if columns:
        entries = (*_entries(kinematics, at.directions, _to_axes(robot)), len(kinematics.model))
    return _geometry(
        robot,
        at.placements,
        at.T_last_tip,
        entries,
        at.T_frame_root,
        at.T_frame_base,
        at.T_tip_target,
    )


def _geometry(
    robot: Robot,
    placements: Array,
    T_last_tip: Array,
    columns: tuple[NDArray[np.int_], Array, int],
    T_frame_root: Array,
    T_frame_base: Array,
    T_tip_target: Array,
) -> Geometry:
    """A chain of these placements; ``columns`` are entries, twists and the number of parameters."""
    from calib.model.kernel_types import Geometry

    n, turns = len(robot.joints), _to_axes(robot)
    own = [*(placements[i] @ turns[i] for i in range(n)), T_last_tip]
    steps = [own[0], *(turns[i].T @ own[i + 1] for i in range(n))]
    entries, twists, count = columns
    return Geometry(
        slides=fixed(np.array([joint.type == "prismatic" for joint in robot.joints])),
        steps=fixed(_flat(np.array(steps[1:]))),
        starts=fixed(_flat(T_frame_root @ steps[0])),
        bases=fixed(_flat(T_frame_base)),
        targets=fixed(_flat(T_tip_target)),
        entries=fixed(entries),
        twists=fixed(twists),
        columns=count,
    )


def stood_at(kinematics: Kinematics, x: Array, samples: Samples, *, columns: bool = True) -> Stood:
    """The joint values of samples with the joints' own errors at x, shape (p,), and what multiplies their columns."""
    from calib.model.kernel_types import Stood

    robot, model = kinematics.robot, kinematics.model
    values = robot.chain_values(samples.q)
    terms = [model.terms[t] for t in model.joint_terms]
    numbers = np.empty((len(samples), len(terms)))
    for k, term in enumerate(terms):
        numbers[:, k] = factor_of(robot, term, samples.q, samples.load)
    if terms and np.any(x):
        each = model.mixing[list(model.joint_terms)] @ x
        values = values + (numbers * each) @ _driven(robot, kinematics)
    return Stood(
        values=fixed(_within_reach(robot, values)),
        frame=fixed(samples.frame),
        target=fixed(samples.target),
        numbers=fixed(numbers if columns else np.empty((len(samples), 0))),
    )


def _within_reach(robot: Robot, values: Array) -> Array:
    """Angles so far round that the kernel would not reduce them exactly, by whole turns nearer to zero."""
    from calib.model.kernel_blocks import FARTHEST

    if np.max(np.abs(values), initial=0.0) <= FARTHEST:
        return values
    turns = [joint.type != "prismatic" for joint in robot.joints]
    near = np.arctan2(np.sin(values), np.cos(values))
    return np.where(np.array(turns), near, values)


def fixed(values: NDArray[Any]) -> NDArray[Any]:
    """A contiguous array of the same shape that cannot be written to: the kernel is compiled for this kind alone."""
    result: NDArray[Any] = np.ascontiguousarray(values).view()
    result.setflags(write=False)
    return result


def poses_of(kinematics: Kinematics, x: Array, samples: Samples) -> Array:
    """T_frame_target, shape (N, 4, 4), [m]."""
    from calib.model import kernel

    geometry = geometry_of(kinematics, x, columns=False)
    out = np.empty((len(samples), 4, 4))

    def work(first: int, last: int) -> None:
        part = stood_at(kinematics, x, samples.select(slice(first, last)), columns=False)
        kernel.poses(geometry, part, 0, last - first, out[first:last])

    in_threads(work, len(samples))
    return out


def points_of(kinematics: Kinematics, x: Array, samples: Samples) -> Array:
    """The target's positions, shape (N, 3), [m]: no more than that is kept of the poses."""
    from calib.model import kernel

    geometry = geometry_of(kinematics, x, columns=False)
    out = np.empty((len(samples), 3))

    def work(first: int, last: int) -> None:
        part = stood_at(kinematics, x, samples.select(slice(first, last)), columns=False)
        poses = np.empty((last - first, 4, 4))
        kernel.poses(geometry, part, 0, last - first, poses)
        out[first:last] = poses[:, :3, 3]

    in_threads(work, len(samples))
    return out


def twists_of(kinematics: Kinematics, x: Array, samples: Samples) -> tuple[Array, Array]:
    """T_frame_target, and the target's velocity in a unit of each parameter, shape (N, 6, p)."""
    from calib.model import kernel

    geometry = geometry_of(kinematics, x)
    poses = np.empty((len(samples), 4, 4))
    twists = np.empty((len(samples), 6, len(kinematics.model)))

    def work(first: int, last: int) -> None:
        part = stood_at(kinematics, x, samples.select(slice(first, last)))
        kernel.poses(geometry, part, 0, last - first, poses[first:last])
        kernel.twists(geometry, part, 0, last - first, twists[first:last])

    in_threads(work, len(samples))
    return poses, twists


def robot_poses(robot: Robot, values: Array) -> Array:
    """T_base_tip, shape (N, 4, 4), [m].

    Args:
        robot: The robot.
        values: shape (N, n), of the chain's joints, see `Robot.chain_values`.
    """
    from calib.model import kernel, kernel_types

    n, one = len(robot.joints), np.eye(4)
    placements, T_last_tip = robot.placements[:n], robot.placements[n]
    T_base_root = rigid_inverse(robot.T_root_base)
    geometry = _geometry(robot, placements, T_last_tip, (*_no_entries(), 0), T_base_root, one, one)
    first = fixed(np.zeros(len(values), dtype=np.int_))
    stood = kernel_types.Stood(
        fixed(_within_reach(robot, values)), first, first, fixed(np.empty((len(values), 0)))
    )
    out = np.empty((len(values), 4, 4))
    in_threads(lambda a, b: kernel.poses(geometry, stood, a, b, out), len(values))
    return out


def must_compile(count: int) -> bool:
    """Whether so many samples are the first that need the kernel, which is then compiled: some ten seconds."""
    if count < MANY:
        return False
    from calib.model import kernel, kernel_types

    return not kernel_types.is_kept(kernel.normal)


def warm_up() -> None:
    """Compile the kernel and keep it on disk, so that the first large table need not wait for it."""
    from calib.model import kernel, kernel_types

    n, p = 1, 1
    geometry = kernel_types.Geometry(
        slides=fixed(np.zeros(n, dtype=bool)),
        steps=fixed(np.zeros((n, 12))),
        starts=fixed(np.zeros((1, 12))),
        bases=fixed(np.zeros((1, 12))),
        targets=fixed(np.zeros((1, 12))),
        entries=fixed(np.zeros((p, 6), dtype=np.int_)),
        twists=fixed(np.zeros((p, 6))),
        columns=p,
    )
    first, ones = fixed(np.zeros(1, dtype=np.int_)), fixed(np.ones(1))
    stood = kernel_types.Stood(fixed(np.zeros((1, n))), first, first, fixed(np.zeros((1, 1))))
    measured = kernel_types.Measured(
        kernel_types.POSITION, fixed(np.zeros((1, 3))), fixed(np.zeros((1, 9))), ones
    )
    seen = (geometry, stood, stood, measured, ones, ones)
    kernel.poses(geometry, stood, 0, 1, np.empty((1, 4, 4)))
    kernel.twists(geometry, stood, 0, 1, np.empty((1, 6, p)))
    kernel.normal(*seen, 0, 1, np.zeros((2, 4, 4)))
    kernel.rows(*seen, 0, 1, np.empty((1, 3, p + 1)))
    kernel.norms(*seen, 0, fixed(np.zeros(p)), fixed(np.zeros((4, 4))), ones, 0, 1, np.empty(1))


@lru_cache(maxsize=16)
def _to_axes(robot: Robot) -> Array:
    """For each joint the rotation that takes z to its axis, as a pose, shape (n, 4, 4)."""
    result = np.tile(np.eye(4), (len(robot.joints), 1, 1))
    for T_joint, joint in zip(result, robot.joints, strict=True):
        axis = np.asarray(joint.axis)
        T_joint[:3, :3] = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).matrix()
        T_joint[:3, 2] = axis  # to the last bit
    result.setflags(write=False)
    return result


def _flat(T: Array) -> Array:
    """R by rows, then the origin, shape (..., 12)."""
    stacked = np.reshape(T, (-1, 4, 4))
    return np.ascontiguousarray(
        np.concatenate([stacked[:, :3, :3].reshape(-1, 9), stacked[:, :3, 3]], axis=1)
    )


def _no_entries() -> tuple[NDArray[np.int_], Array]:
    """Of a chain whose derivatives are not asked for."""
    return np.zeros((0, 6), dtype=np.int_), np.zeros((0, 6))


def _driven(robot: Robot, kinematics: Kinematics) -> Array:
    """How far each joint of the chain moves with a unit of each term of the joints' state, shape (terms, n)."""
    model = kinematics.model
    return driven_joints(robot, [model.terms[t] for t in model.joint_terms])


def _entries(
    kinematics: Kinematics, directions: Array, turns: Array
) -> tuple[NDArray[np.int_], Array]:
    """What a unit of each parameter does at each place, see `calib.model.kernel.Geometry`."""
    robot, model = kinematics.robot, kinematics.model
    places = model.places
    tip, n = places.index(TIP), len(robot.joints)
    frames = sum(place.startswith(FRAME) for place in places[:tip])
    found: list[tuple[tuple[int, int, int, int, int], Array]] = []
    for k, place in enumerate(places):
        local = directions[6 * k : 6 * k + 6]
        joint = k - frames
        for column in np.flatnonzero(local.any(axis=0)).tolist():
            twist = local[:, column]
            if k < frames:
                found.append(((0, column, k if frames > 1 else -1, -1, -1), twist))
            elif joint < n:
                R = turns[joint][:3, :3]
                own = np.concatenate([R.T @ twist[:3], R.T @ twist[3:]])
                found.append(((1 + joint, column, -1, -1, -1), own))
            elif k == tip:
                found.append(((n + 1, column, -1, -1, -1), twist))
            else:
                assert place.startswith(TARGET)
                targets = len(places) - tip - 1
                only = k - tip - 1 if targets > 1 else -1
                found.append(((n + 2, column, -1, only, -1), twist))
    driven = _driven(robot, kinematics)
    mixing = model.mixing[list(model.joint_terms)]
    for number, column in zip(*np.nonzero(mixing), strict=True):
        for joint in np.flatnonzero(driven[number]).tolist():
            slides = robot.joints[joint].type == "prismatic"
            twist = np.zeros(6)
            twist[2 if slides else 5] = mixing[number, column] * driven[number, joint]
            found.append(((1 + joint, int(column), -1, -1, int(number)), twist))
    found += [((0, c, -1, -1, -1), np.zeros(6)) for c in _untouched(found, len(model))]
    seen: set[int] = set()
    entries = np.empty((len(found), 6), dtype=np.int_)
    for e, (numbers, _) in enumerate(found):
        entries[e] = (*numbers, int(numbers[1] in seen))
        seen.add(numbers[1])
    return entries, np.array([twist for _, twist in found]).reshape(-1, 6)


def _untouched(found: list[tuple[tuple[int, int, int, int, int], Array]], count: int) -> list[int]:
    """Columns without an entry: they must be written too."""
    return sorted(set(range(count)) - {numbers[1] for numbers, _ in found})
