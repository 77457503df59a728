"""Bias of circle fits, error of the base frame, and of a calibration in it: the figures of docs/base-frame.md.

    python scripts/base_frame_study.py            all of it, some minutes
    python scripts/base_frame_study.py --quick    few runs of each

The paper's UR3 is measured at 20 points on a disc of 0.25 m in the plane z = 0 of `base`, and at 40 points each of
sweeps of joint 1 and joint 2 on circles of radius 0.3 m at the heights of the joints' frames (151.9 mm, both). The
noise is that of a tracker at 3 m, 15 um + 6 um/m in each coordinate. Biases of circles are means over pairs of opposite
noise, in which the first order cancels.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
import pinocchio as pin
from arms import load_arm
from numpy.typing import NDArray
from studies import add_noise, draw_errors, print_table, rms, rms_length, run_jobs, study_parser

from calib.basics.arrays import Array, read_only, rigid_inverse
from calib.data.cell import Cell, TrackerNoise
from calib.data.measurements import Measurements
from calib.errors import CalibError
from calib.model.parameter_sets import error_model
from calib.result.calibrate import calibrate
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.base_frame.axes import nominal_axes, nominal_axes_frame
from calib.verbs.base_frame.base_frame import BaseFrame, base_frame, frame_of
from calib.verbs.base_frame.circles import fit_circle, fit_plane
from calib.verbs.base_frame.sweep_findings import with_positive_sense
from calib.verbs.base_frame.sweeps import Sweeps

sys.path.insert(0, str(Path(__file__).parents[1]))
from tests.verbs.base_frame.virtual_sweeps import virtual_sweeps

#: Noise of a coordinate, 3 m from the tracker [m].
SIGMA = TrackerNoise(repeatability=0.0).std(3.0)

#: Pose of the base in the tracker's frame: 3 m away and oblique, for no figure depends on it.
T_TRACKER_BASE = read_only(pin.exp6(np.array([2.2, 1.6, -0.9, 0.3, -0.8, 1.2])).homogeneous)

#: Arcs of the circles whose bias is studied [deg].
ARCS = (20, 30, 45, 60, 90, 120, 180, 270, 360)

#: Noise of their points [m].
NOISES = (SIGMA, 1e-4, 3e-4, 1e-3)

#: Radius of all circles [m].
RADIUS = 0.3

#: Number of points of a circle.
POINTS = 40

#: Standard deviation of the true robot's lengths in the last table [m].
LENGTH = 0.5e-3

#: Standard deviation of its angles [rad].
ANGLE = 2e-3


# Circles


@dataclass(frozen=True, slots=True)
class Bias:
    """Bias of a circle's centre towards the middle of its arc."""

    mean: float  # [m]
    error: float  # Standard error of the mean [m]
    std: float  # Standard deviation of one fit's centre [m]


def center_bias(arc: float, sigma: float, pairs: int, seed: int) -> Bias | None:
    """Estimate the bias of the centre of a circle by pairs of fits with opposite noise.

    Args:
        arc: Arc that the points cover [deg].
        sigma: Noise of a coordinate [m].
        pairs: Number of pairs.
        seed: Of the random numbers.

    Returns:
        The bias; None if the arc is too short for its noise in any of the fits.
    """
    rng = np.random.default_rng((seed, int(arc), round(1e6 * sigma)))
    half = np.radians(arc) / 2.0
    angles = np.linspace(-half, half, POINTS, endpoint=arc < 360)
    basis = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    middle = basis[:, 0]  # direction from the centre to the middle of the arc
    points = RADIUS * (np.cos(angles)[:, None] * middle + np.sin(angles)[:, None] * basis[:, 1])
    centers = np.empty((pairs, 2))
    try:
        for i in range(pairs):
            noise = sigma * rng.normal(size=points.shape)
            for k, noisy in enumerate((points + noise, points - noise)):
                centers[i, k] = fit_circle(noisy, robust=False).point @ middle
    except CalibError:
        return None  # to select the runs in which a fit is possible would be a bias too
    means = centers.mean(axis=1)
    error = means.std(ddof=1) / np.sqrt(pairs)
    return Bias(float(means.mean()), float(error), float(centers.std()))


def bias_rows(pairs: int, seed: int, workers: int) -> Iterator[list[str]]:
    """Yield the bias for each noise and arc."""
    cases = list(product(NOISES, ARCS))
    jobs = [(arc, sigma, pairs, seed) for sigma, arc in cases]
    biases = run_jobs(center_bias, jobs, workers=workers, label="circles")
    for (sigma, arc), bias in zip(cases, biases, strict=True):
        row = [f"{1e6 * sigma:.0f} um", f"{arc} deg"]
        if bias is None:
            yield [*row, "the arc is too short for its noise", ""]
        else:
            mean = f"{1e6 * bias.mean:.2f} +-{1e6 * bias.error:.2f}"
            yield [*row, mean, f"{1e6 * bias.std:.1f}"]


# The base frame


@dataclass(frozen=True, slots=True)
class Case:
    """Sweeps of the joints 1 and 2, and what their fit knows."""

    arcs: tuple[float, float]  # [deg]
    given: bool  # The fit is given the noise; it estimates it otherwise


CASES = (
    Case((270.0, 180.0), given=False),
    Case((270.0, 180.0), given=True),
    Case((60.0, 60.0), given=False),
    Case((60.0, 60.0), given=True),
    Case((30.0, 30.0), given=False),
)


@dataclass(frozen=True, slots=True)
class FrameErrors:
    """Errors of the base frame in some runs."""

    twists: Array  # shape (runs, 6), displacement [m] and rotation [rad] from the true base to the estimated one
    inside: NDArray[np.bool_]  # shape (runs, 6), the error is inside its 95 % interval
    bound: Array  # shape (2,), Cramer-Rao bounds of the rms displacement [m] and rotation [rad]


def fit_frame(
    sweeps: Sweeps, noise: Sequence[Array], T_axes_base: Array, *, given: bool
) -> BaseFrame:
    """Fit the base frame to sweeps with noise.

    Args:
        sweeps: Exact sweeps: of the plane, joint 1 and joint 2.
        noise: Noise of each sweep's points, shape (N, 3), [m].
        T_axes_base: Pose of the base in the frame of the axes, by the nominal robot.
        given: The standard deviation of the noise is given to the fit.
    """
    points = [sweep.points + error for sweep, error in zip(sweeps.sweeps, noise, strict=True)]
    sigmas = [np.full(len(measured), SIGMA) if given else None for measured in points]
    plane = fit_plane(points[0], sigmas[0])
    circles = []
    for joint, sweep in enumerate(sweeps.sweeps[1:]):
        circle = fit_circle(points[joint + 1], sigmas[joint + 1])
        circles.append(with_positive_sense(circle, sweep.joints, joint, sweeps.joint_names))
    return frame_of(plane, circles[0], circles[1], T_axes_base=T_axes_base)


def frame_runs(case: Case, runs: int, seed: int) -> FrameErrors:
    """Estimate the base frame many times, each with noise of its own.

    Args:
        case: The sweeps.
        runs: Number of runs.
        seed: Of the random numbers.
    """
    robot = load_arm("ur3")
    arcs = np.radians(case.arcs)
    exact = virtual_sweeps(
        robot, T_TRACKER_BASE, 0.0, arcs=arcs, count=POINTS, radius=RADIUS, seed=seed
    )
    T_axes_base = rigid_inverse(nominal_axes_frame(nominal_axes(robot)))
    zeros = [np.zeros(sweep.points.shape) for sweep in exact.sweeps]
    covariance = fit_frame(exact, zeros, T_axes_base, given=True).covariance
    variances = [np.trace(covariance[:3, :3]), np.trace(covariance[3:, 3:])]
    rng = np.random.default_rng((seed, int(case.arcs[0]), case.given))
    twists = np.empty((runs, 6))
    inside = np.empty((runs, 6), dtype=np.bool_)
    for i in range(runs):
        noise = [add_noise(zero, SIGMA, rng) for zero in zeros]
        frame = fit_frame(exact, noise, T_axes_base, given=case.given)
        twists[i] = pin.log6(rigid_inverse(frame.T_tracker_base) @ T_TRACKER_BASE).vector
        inside[i] = np.abs(twists[i]) <= frame.within(0.95)
    return FrameErrors(twists, inside, np.sqrt(variances))


def frame_rows(runs: int, seed: int, workers: int) -> Iterator[list[str]]:
    """Yield the errors of the base frame for each case."""
    jobs = [(case, runs, seed) for case in CASES]
    results = run_jobs(frame_runs, jobs, workers=workers, label="base frames")
    for case, errors in zip(CASES, results, strict=True):
        displacement = np.linalg.norm(errors.twists[:, :3], axis=1)
        rotation = np.linalg.norm(errors.twists[:, 3:], axis=1)
        yield [
            f"{case.arcs[0]:.0f}, {case.arcs[1]:.0f} deg",
            "given" if case.given else "from residuals",
            f"{1e3 * np.median(displacement):.4f} mm, {1e3 * np.median(rotation):.4f} mrad",
            f"{1e3 * rms(displacement):.4f} mm, {1e3 * rms(rotation):.4f} mrad",
            f"{rms(displacement) / errors.bound[0]:.3f}, {rms(rotation) / errors.bound[1]:.3f}",
            f"{100.0 * errors.inside.mean():.1f} %",
        ]


# A calibration in it

#: Titles of what a robot's error is measured of; the order of `robot_errors`.
ROBOTS = (
    "nominal robot, base frame from sweeps",
    "calibrated in the base frame from sweeps (270, 180 deg)",
    "calibrated, the frame estimated with the robot",
)


def in_tracker(robot: Robot, T_tracker_base: Array, target: Array, q: Array) -> Array:
    """Return the positions of a target in the tracker's frame, shape (N, 3), [m].

    Args:
        robot: The robot.
        T_tracker_base: Pose of its base, shape (4, 4), [m].
        target: Target in the tip, shape (3,), [m].
        q: Joint values, shape (N, m), [rad].
    """
    poses = robot.poses(q)
    in_base = poses[:, :3, :3] @ target + poses[:, :3, 3]
    return np.asarray(in_base @ T_tracker_base[:3, :3].T + T_tracker_base[:3, 3])


def robot_errors(seed: int) -> tuple[float, float, float]:
    """Draw and calibrate a robot; return its rms errors at other poses in the tracker's frame.

    Returns:
        Errors [m] of the nominal robot, of the one calibrated in the measured base frame, and of the one calibrated
        with an unknown frame.
    """
    rng = np.random.default_rng(seed)
    nominal = load_arm("ur3")
    model = error_model(nominal, "hayati")
    geometric = np.array([p.family in ("length", "angle", "zero") for p in model.parameters])
    true = model.apply(nominal, draw_errors(model, LENGTH, ANGLE, rng) * geometric)
    target = np.array([0.07, -0.05, 0.03])

    arcs = np.radians([270.0, 180.0])
    sweeps = virtual_sweeps(true, T_TRACKER_BASE, SIGMA, arcs=arcs, seed=seed)
    T_tracker_base = base_frame(sweeps, nominal).T_tracker_base

    q = random_joint_values(nominal, 40, seed)
    points = add_noise(in_tracker(true, T_TRACKER_BASE, target, q), SIGMA, rng)
    table = Measurements(nominal.joint_names, q, points)
    known = Cell(T_frame_base=T_tracker_base)
    unknown = Cell(estimate_frame=True)
    in_base = calibrate(nominal, table, cell=known, model="hayati", validate=False)
    free = calibrate(nominal, table, cell=unknown, model="hayati", validate=False)

    q_other = random_joint_values(nominal, 200, seed + 10_000)
    truth = in_tracker(true, T_TRACKER_BASE, target, q_other)
    by_nominal = in_tracker(nominal, T_tracker_base, target, q_other)
    return (
        rms_length(by_nominal - truth),
        rms_length(in_base.predict(q_other) - truth),
        rms_length(free.predict(q_other) - truth),
    )


def robot_rows(robots: int, seed: int, workers: int) -> Iterator[list[str]]:
    """Yield the errors of each way to calibrate, over some robots."""
    jobs = [(seed + i,) for i in range(robots)]
    errors = np.array(list(run_jobs(robot_errors, jobs, workers=workers, label="robots")))
    for title, of_robots in zip(ROBOTS, errors.T, strict=True):
        yield [title, f"{1e3 * rms(of_robots):.4f} mm", f"{1e3 * of_robots.max():.4f} mm"]


def main() -> None:
    """Print the tables."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("--quick", action="store_true", help="few runs of each part")
    parser.add_argument("--runs", type=int, default=0, help="of the base frame; default 500")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    pairs, runs, robots = 1000, 500, 20
    if arguments.quick:
        pairs, runs, robots = 40, 60, 2
    runs = arguments.runs or runs
    seed, workers = arguments.seed, arguments.workers

    print(f"{2 * pairs} circles of {POINTS} points, radius {1e3 * RADIUS:.0f} mm\n")
    titles = ["noise", "arc", "bias of the centre, +- its standard error [um]", "its std [um]"]
    print_table(titles, bias_rows(pairs, seed, workers))

    print(f"\n{runs} base frames, noise {1e6 * SIGMA:.0f} um\n")
    titles = ["arcs of joints 1, 2", "noise", "median error", "rms error"]
    titles += ["rms over the Cramer-Rao bound", "truth in the 95 % intervals"]
    print_table(titles, frame_rows(runs, seed, workers))

    print(
        f"\n{robots} UR3 with true DH offsets ({1e3 * LENGTH:.1f} mm, {1e3 * ANGLE:.0f} mrad), 40 poses, "
        f"noise {1e6 * SIGMA:.0f} um: rms error at 200 other poses\n"
    )
    print_table(["", "all robots", "worst robot"], robot_rows(robots, seed, workers))


if __name__ == "__main__":
    main()
