"""Several targets measured at each stop, against poses of the body that carries them, made from the same points.

    python scripts/stops_study.py 100      so many robots
    python scripts/stops_study.py 100 30   at so many stops each

UR5s of `dh` errors carry four markers on the hand, measured by cameras that stand anywhere. The robot misses each stop
by a multiple of the cameras' noise. Printed is the true error at other poses of a fit to the markers over that of a fit
to poses of the hand, the standard deviation that the first states over its error, and the shares of the variance that
the markers of a stop have in common, by a translation and a rotation of the hand and by errors of the joints.

The second table is of hands of which one stop is off as a whole: the error over that of a fit without the stop, how
often all of its markers are thrown out, and how many markers of other stops are flagged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from arms import load_arm
from scipy.spatial.transform import Rotation
from studies import add_noise, draw_errors, print_table, rms, run_cases, study_parser

from calib.basics.arrays import Array
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.fit.estimate.fitting import Fitted
from calib.model.kinematics import Kinematics, Samples
from calib.model.parameter_sets import error_model
from calib.numerics.geometry import pose_of
from calib.result.table_fits import fit_table
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot

#: Noise of a coordinate [m].
NOISE = 5e-5

#: Distances by which a stop is missed, rms, over the noise of a point.
MISSED = (0.0, 1.0, 3.0, 10.0)

#: Distance by which one stop is off as a whole, over the rms distance by which the others are missed.
OFF = 2.5

#: Positions of the markers on the hand [m].
MARKERS = np.array([[0.08, 0.0, 0.05], [-0.07, 0.03, 0.08], [0.0, -0.09, 0.06], [0.02, 0.06, 0.14]])

#: Poses at which the fits are compared.
OTHER = 200

#: Seed of these poses.
OTHER_SEED = 98


@dataclass(frozen=True)
class Hand:
    """A robot with known errors, and measured markers on its hand."""

    true: Kinematics  # The robot's errors, the cameras' frame and the markers
    x: Array  # shape (p,), true values of the errors
    q: Array  # shape (stops, 6), joint values that are read [rad]
    points: Array  # shape (stops, markers, 3), measured points [m]

    @classmethod
    def draw(cls, robot: Robot, stops: int, missed: float, seed: int) -> Hand:
        """Draw errors, the cameras' place and stops, and measure.

        Args:
            robot: The nominal robot.
            stops: Number of stops.
            missed: Distance by which the markers miss a stop, rms, over the noise of a point.
            seed: Of the random numbers.
        """
        rng = np.random.default_rng([seed, stops])
        model = error_model(robot, "dh")
        x = draw_errors(model, 1e-3, 5e-3, rng)
        T_tip_target = np.tile(np.eye(4), (len(MARKERS), 1, 1))
        T_tip_target[:, :3, 3] = MARKERS
        R = Rotation.random(random_state=seed).as_matrix()
        T_frame_base = pose_of(rng.uniform(-3.0, 3.0, 3), R)
        true = Kinematics(robot, model, T_frame_base[None], T_tip_target)
        q = random_joint_values(robot, stops, seed)
        q_error = rng.normal(size=q.shape)
        step = marker_positions(true, x, q + 1e-6 * q_error) - marker_positions(true, x, q)
        slope = np.linalg.norm(step, axis=2) / 1e-6  # [m], of a unit of q_error
        q_error *= missed * NOISE * np.sqrt(3.0) / rms(slope)
        points = marker_positions(true, x, q + q_error)
        return cls(true, x, q, add_noise(points, NOISE, rng))

    def point_table(self) -> Measurements:
        """Return a table with a row for each marker of each stop."""
        stops, markers = self.points.shape[:2]
        return Measurements(
            self.true.robot.joint_names,
            np.repeat(self.q, markers, axis=0),
            self.points.reshape(-1, 3),
            targets=tuple(f"m{k}" for k in range(markers)) * stops,
        )

    def pose_table(self) -> tuple[Measurements, Array]:
        """Make poses of the hand from the points.

        Returns:
            A table with a row for each stop, and the markers in the hand's frame, shape (markers, 3), [m].
        """
        body = self.points[0] - self.points[0].mean(axis=0)
        for _ in range(20):
            R, t = body_poses(body, self.points)
            body = np.einsum("nji,nkj->ki", R, self.points - t[:, None]) / len(R)
            body -= body.mean(axis=0)
        names = self.true.robot.joint_names
        table = Measurements(names, self.q, t, kinds=("pose",) * len(t), rotations=R)
        return table, body


def marker_samples(kinematics: Kinematics, q: Array) -> Samples:
    """Return samples of all targets at each of the joint values, shape (N, 6), [rad]."""
    markers = len(kinematics.T_tip_target)
    frame = np.zeros(markers * len(q), dtype=np.int_)
    target = np.tile(np.arange(markers), len(q))
    return Samples(np.repeat(q, markers, axis=0), frame, target)


def marker_positions(kinematics: Kinematics, x: Array, q: Array) -> Array:
    """Return the positions of all targets with errors x, shape (N, targets, 3), [m]."""
    points = kinematics.points(x, marker_samples(kinematics, q))
    return np.asarray(points.reshape(len(q), -1, 3))


def body_poses(body: Array, points: Array) -> tuple[Array, Array]:
    """Fit poses of a body to its points (Kabsch).

    Args:
        body: shape (k, 3), points in the body, their mean zero [m].
        points: shape (N, k, 3), the same points as measured [m].

    Returns:
        Rotations, shape (N, 3, 3), and positions, shape (N, 3), [m].
    """
    t = points.mean(axis=1)
    U, _, V = np.linalg.svd(np.einsum("nki,kj->nij", points - t[:, None], body))
    U[:, :, 2] *= np.linalg.det(U @ V)[:, None]
    return np.asarray(U @ V), t


def point_fit_errors(hand: Hand, fitted: Fitted) -> Array:
    """Return the errors of a fit to markers at other poses, shape (OTHER, markers, 3), [m]."""
    q = random_joint_values(hand.true.robot, OTHER, OTHER_SEED)
    predicted = marker_positions(fitted.kinematics, fitted.estimate.x, q)
    return predicted - marker_positions(hand.true, hand.x, q)


def pose_fit_errors(hand: Hand, fitted: Fitted, body: Array) -> Array:
    """Return the errors of markers that a fit to poses predicts, shape (OTHER, markers, 3), [m].

    Args:
        hand: The truth.
        fitted: The fit to poses of the hand.
        body: The markers in the hand's frame, shape (markers, 3), [m].
    """
    q = random_joint_values(hand.true.robot, OTHER, OTHER_SEED)
    T = fitted.kinematics.poses(fitted.estimate.x, Samples.at(q))
    predicted = T[:, None, :3, 3] + np.einsum("nij,kj->nki", T[:, :3, :3], body)
    return np.asarray(predicted - marker_positions(hand.true, hand.x, q))


def stated_std(fitted: Fitted) -> float:
    """Return the standard deviation that a fit to markers states of them at other poses, rms [m]."""
    q = random_joint_values(fitted.task.robot, OTHER, OTHER_SEED)
    samples = marker_samples(fitted.kinematics, q)
    _, J = fitted.kinematics.twists(fitted.estimate.x, samples, rotation=False)
    variances = np.einsum("nij,jk,nik->ni", J, fitted.estimate.covariance, J)
    return float(np.sqrt(np.mean(np.sum(variances, axis=1))))


@dataclass(frozen=True)
class Figures:
    """Figures of one robot."""

    by_points: float  # Error of the fit to markers, rms [m]
    by_poses: float  # Error of the fit to poses of the hand, rms [m]
    stated: float  # Standard deviation that the fit to markers states, rms [m]
    #: Of the variance, common to the markers of a stop: translations, rotations, errors of the joints
    shares: tuple[float, ...]


def compare_fits(robot: Robot, stops: int, missed: float, seed: int) -> Figures:
    """Draw a hand, fit its markers and its poses; arguments as for `Hand.draw`."""
    hand = Hand.draw(robot, stops, missed, seed)
    cell = Cell(estimate_frame=True)
    of_points = fit_table(robot, hand.point_table(), cell, model="dh").geometry
    table, body = hand.pose_table()
    of_poses = fit_table(robot, table, cell, model="dh").geometry
    return Figures(
        by_points=rms(np.linalg.norm(point_fit_errors(hand, of_points), axis=2)),
        by_poses=rms(np.linalg.norm(pose_fit_errors(hand, of_poses, body), axis=2)),
        stated=stated_std(of_points),
        shares=tuple(of_points.estimate.problem.stop_shares[0].tolist()),
    )


@dataclass(frozen=True)
class OffFigures:
    """Figures of one robot of which one stop is off as a whole."""

    error: float  # Of the fit to the markers of all stops, rms [m]
    without: float  # Of the fit to those of the others, rms [m]
    thrown: bool  # All markers of the stop are flagged
    others: int  # Flagged markers of other stops


def fit_off_stop(robot: Robot, stops: int, missed: float, seed: int) -> OffFigures:
    """Draw a hand, displace its first stop as a whole, and fit with it and without; arguments as for `Hand.draw`."""
    hand = Hand.draw(robot, stops, missed, seed)
    direction = np.random.default_rng([9, seed]).normal(size=3)
    points = hand.points.copy()
    points[0] += OFF * missed * NOISE * np.sqrt(3.0) * direction / np.linalg.norm(direction)
    cell = Cell(estimate_frame=True)
    errors, flagged = [], []
    for first in (0, 1):
        some = replace(hand, q=hand.q[first:], points=points[first:])
        fitted = fit_table(robot, some.point_table(), cell, model="dh").geometry
        errors.append(rms(np.linalg.norm(point_fit_errors(some, fitted), axis=2)))
        flagged.append(fitted.estimate.outliers.reshape(-1, len(MARKERS)))
    return OffFigures(
        error=errors[0],
        without=errors[1],
        thrown=bool(np.all(flagged[0][0])),
        others=int(np.sum(flagged[0][1:])),
    )


@dataclass(frozen=True)
class Case:
    """Stops of a UR5."""

    missed: float
    stops: int


def run_once(case: Case, seed: int) -> Figures:
    """Return the figures of one UR5."""
    return compare_fits(load_arm("ur5"), case.stops, case.missed, seed)


def run_off(case: Case, seed: int) -> OffFigures:
    """Return the figures of one UR5 of which one stop is off."""
    return fit_off_stop(load_arm("ur5"), case.stops, case.missed, seed)


def off_row(case: Case, runs: Sequence[OffFigures]) -> list[str]:
    """Return the row of a case with a stop that is off."""
    ratios = np.array([run.error / run.without for run in runs])
    return [
        str(case.missed),
        f"{np.median(ratios):.3f}",
        f"{np.max(ratios):.3f}",
        f"{np.mean([run.thrown for run in runs]):.0%}",
        f"{np.mean([run.others for run in runs]):.2f}",
    ]


def case_row(case: Case, runs: Sequence[Figures]) -> list[str]:
    """Return the row of a case."""
    by_points = np.array([run.by_points for run in runs])
    by_poses = np.array([run.by_poses for run in runs])
    stated = np.array([run.stated for run in runs])
    ratios = by_points / by_poses
    shares = np.mean([run.shares for run in runs], axis=0)
    return [
        str(case.missed),
        f"{rms(by_points) / rms(by_poses):.3f}",
        f"{np.mean(ratios):.3f} +- {np.std(ratios) / np.sqrt(len(runs)):.3f}",
        f"{rms(stated) / rms(by_points):.3f}",
        ", ".join(f"{share:.3f}" for share in shares),
    ]


def main() -> None:
    """Print a row for each repeatability of the robot."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("runs", type=int, metavar="ROBOTS")
    parser.add_argument("stops", type=int, nargs="?", default=30, metavar="STOPS")
    arguments = parser.parse_args()
    cases = [Case(missed, arguments.stops) for missed in MISSED]
    seeds = range(arguments.runs)
    results = run_cases(run_once, cases, seeds, workers=arguments.workers, label="robots")
    titles = ["missed by", "points over poses, rms", "mean", "stated over error", "shares"]
    print_table(titles, (case_row(case, runs) for case, runs in results), [9])

    print()
    off_cases = [case for case in cases if case.missed > 0.0]
    off = run_cases(run_off, off_cases, seeds, workers=arguments.workers, label="robots")
    titles = ["missed by", "error over that without the stop, median", "highest", "thrown out"]
    titles += ["markers flagged beside it"]
    print_table(titles, (off_row(case, runs) for case, runs in off), [9])


if __name__ == "__main__":
    main()
