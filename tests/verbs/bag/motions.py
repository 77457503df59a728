"""An arm that moves as a controller moves it, and the streams that a bag would have of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.robot.robot import Robot
from calib.verbs.bag.streams import JointStream, PointStream

TARGET = np.array([0.05, -0.03, 0.12])


@dataclass
class Motion:
    """Joint values as a function of time, and the times at which the arm stands."""

    knots: Array
    q: Array
    rests: list[tuple[float, float]]
    duration: float

    def at(self, t: Array) -> Array:
        return np.column_stack([np.interp(t, self.knots, column) for column in self.q.T])


def stop_and_go(
    rng: np.random.Generator,
    stops: int = 25,
    rest: float = 2.0,
    shape: str = "trapezoid",
    spread: float = 0.7,
    n: int = 6,
    dt: float = 2e-4,
) -> Motion:
    """Moves from pose to pose, all joints at once, with rests between them."""
    poses = (
        rng.uniform(-spread, spread, (stops, n)) + np.array([0.3, -1.2, 1.4, -0.5, 1.0, 0.2])[:n]
    )
    pieces, rests, t = [], [], 0.0
    for k, pose in enumerate(poses):
        length = rest * rng.uniform(0.8, 1.3)
        rests.append((t, t + length))
        pieces.append(np.repeat(pose[None], round(length / dt), axis=0))
        t += round(length / dt) * dt
        if k + 1 < stops:
            way = np.abs(poses[k + 1] - pose).max()
            time = max(0.6, way / rng.uniform(0.4, 0.8))
            u = np.arange(round(time / dt)) * dt / time
            if shape == "trapezoid":
                ramp = 0.25
                s = np.where(u < ramp, u**2 / (2 * ramp * (1 - ramp)), (u - ramp / 2) / (1 - ramp))
                s = np.where(u > 1 - ramp, 1 - (1 - u) ** 2 / (2 * ramp * (1 - ramp)), s)
            else:
                s = 10 * u**3 - 15 * u**4 + 6 * u**5
            pieces.append(pose + s[:, None] * (poses[k + 1] - pose))
            t += len(u) * dt
    q = np.vstack(pieces)
    return Motion(read_only(np.arange(len(q)) * dt), q, rests, len(q) * dt)


def wandering(
    rng: np.random.Generator, duration: float = 200.0, n: int = 6, dt: float = 1e-3
) -> Motion:
    """All joints swing, each at its own frequencies, without a rest."""
    t = np.arange(round(duration / dt)) * dt
    q = np.tile(np.array([0.3, -1.2, 1.4, -0.5, 1.0, 0.2])[:n], (len(t), 1))
    for j in range(n):
        for f in rng.uniform(0.03, 0.4, 4):
            q[:, j] += 0.3 * np.sin(2 * np.pi * (f * t + rng.uniform()))
    return Motion(read_only(t), q, [], duration)


def stamps(
    rng: np.random.Generator, duration: float, rate: float, jitter: float, drops: float
) -> tuple[Array, Array]:
    """True times, and as they are stamped."""
    t = np.arange(0.0, duration, 1.0 / rate)
    t = t[rng.uniform(size=len(t)) >= drops]
    return t, np.sort(t + jitter * rng.standard_normal(len(t)))


def streams(
    motion: Motion,
    robot: Robot,
    rng: np.random.Generator,
    lag: float,
    *,
    joint_rate: float = 125.0,
    point_rate: float = 100.0,
    jitter: float = 1e-3,
    drops: float = 0.02,
    noise: float = 1e-4,
    joint_noise: float = 2e-5,
) -> tuple[JointStream, PointStream]:
    """Streams of a motion; the points come later by the lag."""
    true, stamped = stamps(rng, motion.duration, joint_rate, jitter, drops)
    q = motion.at(true) + joint_noise * rng.standard_normal((len(true), len(robot.joint_names)))
    keep = np.diff(stamped, prepend=-1e9) > 0
    joints = JointStream(robot.joint_names, stamped[keep], q[keep], np.full_like(q[keep], np.nan))
    true, stamped = stamps(rng, motion.duration, point_rate, jitter, drops)
    T = robot.poses(motion.at(true))
    R, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    R *= np.sign(np.linalg.det(R))
    p = (T[:, :3, 3] + T[:, :3, :3] @ TARGET) @ R.T + [1.0, 2.0, 0.5]
    p += noise * rng.standard_normal(p.shape)
    stamped = stamped + lag
    keep = np.diff(stamped, prepend=-1e9) > 0
    none = np.full((keep.sum(), 4), np.nan)
    return joints, PointStream("/tracker", "", "", stamped[keep], p[keep], none)
