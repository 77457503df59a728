"""The figures of docs/base-frame.md: biases of circle fits, the base frame's error, a calibration behind it.

    .venv/bin/python scripts/base_frame_study.py            all of it, some minutes
    .venv/bin/python scripts/base_frame_study.py --quick    few runs of each

The set-up: the paper's UR3, plane z = 0 of `base`, 20 points on a disc of 0.25 m; joint 1 and joint 2 with 40 points
each on circles of radius 0.3 m at the heights of the joints' frames (151.9 mm, both); noise of a tracker at 3 m,
15 um + 6 um/m in each coordinate. Circle biases are means over pairs of opposite noise, in which the first order
cancels.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from calib.calibration import calibrate
from calib.circle_points.fits import fit_circle, fit_plane
from calib.circle_points.survey import (
    BaseFrame,
    base_frame,
    frame_of,
    nominal_axes,
    nominal_axes_frame,
    positive,
)
from calib.data.cell import Cell, TrackerNoise
from calib.data.measurements import Measurements
from calib.errors import CalibError
from calib.example import paper_urdf
from calib.model.error_model import error_model
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot, read_only, rigid_inverse

sys.path.insert(0, str(Path(__file__).parents[1]))
from tests.circle_points.virtual_sweeps import virtual_sweeps

Array = NDArray[np.float64]

#: Of one coordinate, 3 m from the tracker [m].
SIGMA = TrackerNoise(repeatability=0.0).std(3.0)

#: Where the tracker stands does not matter; somewhere oblique, 3 m away.
T_TRACKER_BASE = read_only(pin.exp6(np.array([2.2, 1.6, -0.9, 0.3, -0.8, 1.2])).homogeneous)

ARCS = (20, 30, 45, 60, 90, 120, 180, 270, 360)
NOISES = (SIGMA, 1e-4, 3e-4, 1e-3)
RADIUS, POINTS = 0.3, 40

#: Errors of the true robot in the study's last part [m, rad].
LENGTH, ANGLE = 0.5e-3, 2e-3


def main() -> None:
    """Print the tables in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few runs of each part")
    parser.add_argument("--runs", type=int, default=0, help="of the base frame; default 500")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    runs = given.runs or (60 if given.quick else 500)
    for text in (
        *bias_table(40 if given.quick else 1000, given.seed),
        "",
        *frame_table(runs, given.seed),
        "",
        *robot_table(2 if given.quick else 20, given.seed),
    ):
        print(text, flush=True)


def watched(rows: Iterable[int], label: str) -> Iterable[int]:
    """The rows, with a bar on stderr."""
    return track(list(rows), label, console=Console(stderr=True), transient=True)


# Circles


def bias_table(pairs: int, seed: int) -> Iterator[str]:
    """The bias of the centre towards the middle of the arc, for each arc and noise."""
    yield (
        f"| noise | arc | bias | its std | ({2 * pairs} fits of {POINTS} points, radius {1e3 * RADIUS:.0f} mm; bias of "
        "the centre [um], +- its standard error) |"
    )
    yield "|---|---|---|---|---|"
    for sigma in NOISES:
        for arc in ARCS:
            found = center_bias(arc, sigma, pairs, seed)
            if found is None:
                yield f"| {1e6 * sigma:.0f} um | {arc} deg | the arc is too short for its noise |"
                continue
            mean, error, std = (1e6 * value for value in found)
            yield f"| {1e6 * sigma:.0f} um | {arc} deg | {mean:.2f} +-{error:.2f} | {std:.1f} | |"


def center_bias(
    arc: float, sigma: float, pairs: int, seed: int
) -> tuple[float, float, float] | None:
    """Bias of the centre, its standard error, and the centre's standard deviation [m]."""
    rng = np.random.default_rng((seed, int(arc), round(1e6 * sigma)))
    half = np.radians(arc) / 2.0
    angles = np.linspace(-half, half, POINTS, endpoint=arc < 360)
    B = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    points = RADIUS * (np.cos(angles)[:, None] * B[:, 0] + np.sin(angles)[:, None] * B[:, 1])
    found = np.empty((pairs, 2))
    try:
        for i in watched(range(pairs), f"circles, {arc} deg, {1e6 * sigma:.0f} um"):
            noise = sigma * rng.normal(size=points.shape)
            both = (points + noise, points - noise)
            found[i] = [fit_circle(seen, robust=False).point @ B[:, 0] for seen in both]
    except CalibError:
        return None  # to select the runs in which a fit is possible would be a bias too
    pair = found.mean(axis=1)
    return float(pair.mean()), float(pair.std(ddof=1) / np.sqrt(pairs)), float(found.std())


# The base frame


@dataclass(frozen=True, slots=True)
class Case:
    """Arcs of joints 1 and 2 [deg], and whether the noise is given to the fit."""

    arcs: tuple[float, float]
    given: bool


def frame_table(runs: int, seed: int) -> Iterator[str]:
    """Errors of the base frame, over the Cramer-Rao bound, and how often the truth is in the intervals."""
    yield (
        "| arcs | noise | median error [mm] | [mrad] | rms error [mm] | [mrad] | rms / bound, position | rotation | in "
        f"95 % intervals | ({runs} runs) |"
    )
    yield "|---|---|---|---|---|---|---|---|---|---|"
    for case in (
        Case((270.0, 180.0), given=False),
        Case((270.0, 180.0), given=True),
        Case((60.0, 60.0), given=False),
        Case((60.0, 60.0), given=True),
        Case((30.0, 30.0), given=False),
    ):
        xi, inside, bound = frame_runs(case, runs, seed)
        sizes = np.stack([np.linalg.norm(xi[:, :3], axis=1), np.linalg.norm(xi[:, 3:], axis=1)])
        rms = np.sqrt((sizes**2).mean(axis=1))
        median = np.median(sizes, axis=1)
        yield (
            f"| {case.arcs[0]:.0f}, {case.arcs[1]:.0f} deg | {'given' if case.given else 'from residuals'} | "
            f"{1e3 * median[0]:.4f} | {1e3 * median[1]:.4f} | {1e3 * rms[0]:.4f} | {1e3 * rms[1]:.4f} | "
            f"{rms[0] / bound[0]:.3f} | {rms[1] / bound[1]:.3f} | {100.0 * inside.mean():.1f} % | |"
        )


def frame_runs(case: Case, runs: int, seed: int) -> tuple[Array, NDArray[np.bool_], Array]:
    """Errors of the frame as twists (runs, 6), whether each is in its interval, bounds (position, rotation)."""
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    exact = virtual_sweeps(
        robot,
        T_TRACKER_BASE,
        0.0,
        arcs=np.radians(case.arcs),
        count=POINTS,
        radius=RADIUS,
        seed=seed,
    )
    T_axes_base = rigid_inverse(nominal_axes_frame(nominal_axes(robot)))

    def frame(noise: Sequence[Array], *, given: bool) -> BaseFrame:
        """The base frame of the sweeps with some noise."""
        touched, *swept = exact.sweeps
        sigmas = [np.full(len(sweep.points), SIGMA) if given else None for sweep in exact.sweeps]
        plane = fit_plane(touched.points + noise[0], sigmas[0])
        first, second = (
            positive(fit_circle(sweep.points + e, sigma), sweep.joints, k, exact.joint_names)
            for k, (sweep, e, sigma) in enumerate(zip(swept, noise[1:], sigmas[1:], strict=True))
        )
        return frame_of(plane, first, second, T_axes_base=T_axes_base)

    none = [np.zeros(sweep.points.shape) for sweep in exact.sweeps]
    covariance = frame(none, given=True).covariance
    bound = np.sqrt([np.trace(covariance[:3, :3]), np.trace(covariance[3:, 3:])])
    rng = np.random.default_rng((seed, int(case.arcs[0]), case.given))
    xi, inside = np.empty((runs, 6)), np.empty((runs, 6), dtype=np.bool_)
    for i in watched(range(runs), f"base frame, {case.arcs[0]:.0f}, {case.arcs[1]:.0f} deg"):
        found = frame([SIGMA * rng.normal(size=e.shape) for e in none], given=case.given)
        xi[i] = pin.log6(rigid_inverse(found.T_tracker_base) @ T_TRACKER_BASE).vector
        inside[i] = np.abs(xi[i]) <= found.within(0.95)
    return xi, inside, bound


# A calibration behind it


def robot_table(robots: int, seed: int) -> Iterator[str]:
    """Errors on unseen poses, in the tracker's frame, of robots with true offsets calibrated in the measured base."""
    yield (
        f"| {robots} UR3 with true DH offsets ({1e3 * LENGTH:.1f} mm, {1e3 * ANGLE:.0f} mrad), 40 poses, noise "
        f"{1e6 * SIGMA:.0f} um | rms error on 200 unseen poses [mm] | worst robot's rms |"
    )
    yield "|---|---|---|"
    errors = np.array([one_robot(seed + i) for i in watched(range(robots), "robots")])
    for k, label in enumerate(
        (
            "nominal robot, base frame from sweeps",
            "calibrated in the base frame from sweeps (270, 180 deg)",
            "calibrated, the frame estimated with the robot",
        )
    ):
        rms = np.sqrt((errors[:, k] ** 2).mean())
        yield f"| {label} | {1e3 * rms:.4f} | {1e3 * errors[:, k].max():.4f} |"


def one_robot(seed: int) -> tuple[float, float, float]:
    """Rms errors on unseen poses of one robot [m]: nominal, calibrated in the measured base, with the frame unknown."""
    rng = np.random.default_rng(seed)
    nominal = Robot.load(paper_urdf(), base="base", tip="tool0")
    model = error_model(nominal, "hayati")
    sizes = np.where([p.unit == "m" for p in model.parameters], LENGTH, ANGLE)
    geometric = np.array([p.family in ("length", "angle", "zero") for p in model.parameters])
    true = model.apply(nominal, rng.normal(size=len(model)) * sizes * geometric)
    target = np.array([0.07, -0.05, 0.03])

    def seen(q: Array) -> Array:
        """Where the tracker sees the target."""
        in_base = true.poses(q)[:, :3, :3] @ target + true.poses(q)[:, :3, 3]
        return np.asarray(in_base @ T_TRACKER_BASE[:3, :3].T + T_TRACKER_BASE[:3, 3])

    sweeps = virtual_sweeps(true, T_TRACKER_BASE, SIGMA, arcs=np.radians([270.0, 180.0]), seed=seed)
    frame = base_frame(sweeps, nominal).frame
    q = random_joint_values(nominal, 40, seed)
    data = Measurements(nominal.joint_names, q, seen(q) + SIGMA * rng.normal(size=(40, 3)))
    unseen = random_joint_values(nominal, 200, seed + 10_000)
    truth = seen(unseen)

    def rms(points: Array) -> float:
        """Of the distance to the truth in the tracker's frame."""
        return float(np.sqrt(np.mean(np.sum((points - truth) ** 2, axis=1))))

    poses = frame.T_tracker_base @ nominal.poses(unseen)
    in_base = calibrate(
        nominal, data, cell=Cell(T_frame_base=frame.T_tracker_base), model="hayati", validate=False
    )
    free = calibrate(nominal, data, cell=Cell(estimate_frame=True), model="hayati", validate=False)
    return (
        rms(poses[:, :3, :3] @ target + poses[:, :3, 3]),
        rms(in_base.predict(unseen)),
        rms(free.predict(unseen)),
    )


if __name__ == "__main__":
    main()
