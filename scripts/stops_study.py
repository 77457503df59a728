"""Several targets seen at each stop, against poses of the body that carries them, made from the same points.

``100 30``: so many UR5s of ``dh`` errors with four markers on the hand, seen at so many stops (30 if none is
said) by cameras that stand anywhere; by how much each stop is missed, in units of the cameras' noise; the error on
unseen poses of a fit to the markers over that of a fit to poses of the hand, and standard deviations over errors.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.estimate.fitting import Fitted
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics, Samples
from calib.numerics.errors import rms
from calib.result.fits import fit_table
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.units import Array

#: Noise of the cameras, places of the markers on the hand [m], and how far a stop is missed over that noise.
NOISE, MISSED = 5e-5, (0.0, 1.0, 3.0, 10.0)
MARKERS = np.array([[0.08, 0.0, 0.05], [-0.07, 0.03, 0.08], [0.0, -0.09, 0.06], [0.02, 0.06, 0.14]])

#: Poses at which the fits are compared.
UNSEEN = 200


@dataclass(frozen=True)
class Hand:
    """A robot that is wrong in a known way, and markers on its hand that were seen."""

    true: Kinematics
    x: Array
    q: Array  # (stops, 6), [rad]
    points: Array  # (stops, markers, 3), [m]

    @classmethod
    def drawn(cls, robot: Robot, stops: int, missed: float, seed: int) -> Hand:
        """A robot, its stops and what was seen there."""
        rng, model = np.random.default_rng([seed, stops]), error_model(robot, "dh")
        size = np.where(np.array(model.units) == "m", 1e-3, 5e-3)
        x, targets = size * rng.normal(size=len(model)), np.tile(np.eye(4), (len(MARKERS), 1, 1))
        targets[:, :3, 3] = MARKERS
        frame = np.eye(4)
        frame[:3, :3] = Rotation.random(random_state=seed).as_matrix()
        frame[:3, 3] = rng.uniform(-3.0, 3.0, 3)
        true = Kinematics(robot, model, frame[None], targets)
        q = random_joint_values(robot, stops, seed)
        off = rng.normal(size=q.shape)
        moved = np.linalg.norm(seen(true, x, q + 1e-6 * off) - seen(true, x, q), axis=2) / 1e-6
        off *= missed * NOISE * np.sqrt(3.0) / rms(moved)
        points = seen(true, x, q + off)
        return cls(true, x, q, points + NOISE * rng.normal(size=points.shape))

    def by_points(self) -> Measurements:
        """A table with a row for each marker."""
        count, k = self.points.shape[:2]
        return Measurements(
            self.true.robot.joint_names,
            np.repeat(self.q, k, axis=0),
            self.points.reshape(-1, 3),
            targets=tuple(f"m{t}" for _ in range(count) for t in range(k)),
        )

    def by_poses(self) -> tuple[Measurements, Array]:
        """A table with a row for each pose of the hand, and the markers in it."""
        body = self.points[0] - self.points[0].mean(axis=0)
        for _ in range(20):
            R, t = fitted_to(body, self.points)
            body = np.einsum("nji,nkj->ki", R, self.points - t[:, None]) / len(R)
            body -= body.mean(axis=0)
        table = Measurements(
            self.true.robot.joint_names, self.q, t, kinds=("pose",) * len(t), rotations=R
        )
        return table, body


def seen(kinematics: Kinematics, x: Array, q: Array) -> Array:
    """The places of all targets, shape (N, k, 3), [m]."""
    return kinematics.points(x, of_all(kinematics, q)).reshape(len(q), -1, 3)


def of_all(kinematics: Kinematics, q: Array) -> Samples:
    """All targets at each of some joint values."""
    k = len(kinematics.T_tip_target)
    frame, target = np.zeros(k * len(q), dtype=np.int_), np.tile(np.arange(k), len(q))
    return Samples(np.repeat(q, k, axis=0), frame, target)


def fitted_to(body: Array, points: Array) -> tuple[Array, Array]:
    """The poses, (N, 3, 3) and (N, 3), that take a body's points (k, 3), centred, nearest to others (N, k, 3)."""
    t = points.mean(axis=1)
    U, _, V = np.linalg.svd(np.einsum("nki,kj->nij", points - t[:, None], body))
    U[:, :, 2] *= np.linalg.det(U @ V)[:, None]
    return U @ V, t


def errors(hand: Hand, fitted: Fitted, body: Array | None = None) -> Array:
    """How far a fit puts the markers from where they are at unseen poses, shape (UNSEEN, k, 3), [m]."""
    q = random_joint_values(hand.true.robot, UNSEEN, 98)
    if body is None:
        found = seen(fitted.kinematics, fitted.estimate.x, q)
    else:
        T = fitted.kinematics.poses(fitted.estimate.x, Samples.at(q))
        found = T[:, None, :3, 3] + np.einsum("nij,kj->nki", T[:, :3, :3], body)
    return found - seen(hand.true, hand.x, q)


def stated(fitted: Fitted) -> float:
    """The standard deviation that a fit to markers states of these at the unseen poses, rms [m]."""
    q = random_joint_values(fitted.task.robot, UNSEEN, 98)
    samples = of_all(fitted.kinematics, q)
    _, J = fitted.kinematics.twists(fitted.estimate.x, samples, rotation=False)
    spread = np.einsum("nij,jk,nik->ni", J, fitted.estimate.covariance, J)
    return float(np.sqrt(np.mean(np.sum(spread, axis=1))))


def compared(robot: Robot, stops: int, missed: float, seed: int) -> Array:
    """Errors of the fit to the markers and of that to poses, what the first states, and its two shares, shape (5,)."""
    hand, cell = Hand.drawn(robot, stops, missed, seed), Cell(estimate_frame=True)
    one = fit_table(robot, hand.by_points(), cell, model="dh").geometry
    table, body = hand.by_poses()
    other = fit_table(robot, table, cell, model="dh").geometry
    off, of_poses = (
        rms(np.linalg.norm(e, axis=2)) for e in (errors(hand, one), errors(hand, other, body))
    )
    return np.array([off, of_poses, stated(one), *one.estimate.problem.rho[0]])


def points(runs: int, stops: int = 30) -> Iterator[str]:
    """A line for each repeatability of the robot."""
    robot = Robot.load("ur5", "base_link", "tool0")
    for missed in MISSED:
        found = np.array([compared(robot, stops, missed, seed) for seed in range(runs)])
        by_points, by_poses, told, *rho = found.T
        ratio = by_points / by_poses
        yield (
            f"missed by {missed:4}: points over poses {rms(by_points) / rms(by_poses):.3f} rms, "
            f"{np.mean(ratio):.3f} +- {np.std(ratio) / np.sqrt(runs):.3f}; stated over error "
            f"{rms(told) / rms(by_points):.3f}; shares {np.mean(rho[0]):.3f}, {np.mean(rho[1]):.3f}"
        )


if __name__ == "__main__":
    for line in points(*map(int, sys.argv[1:3])):
        print(line, flush=True)
