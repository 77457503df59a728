"""Poses by a camera with their covariances: how much they gain, and whether what is said of the errors is right.

    python scripts/pose_covariance_study.py --runs 100

Virtual cells of 25 pictures, corners found to 0.2 px, intrinsics and print known exactly; from each picture the board's
pose and its covariance are computed. Joints stop anywhere within steps of their encoders, of which the covariances know
nothing. Fits of the poses are judged at 40 fresh ones: by the error of the predicted place of the board in the camera,
relative to a fit that knows the covariance of every pose, C + step^2 / 12 J_q J_q^T; and by the share of predictions
within the 95 % intervals. Fitted are poses of equal standard deviations, poses with covariances as they are (nothing
added for the robot), and poses with covariances. The fits that take the noise of poses as given, "known" and
"covariances alone", have all rows in full; all four estimate a factor on the noise of positions and orientations.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from camera_study import ARMS, BOARD, FRESH, MODEL, STATED
from studies import print_table, rms_length, run_cases, study_parser

from calib.basics.arrays import Array
from calib.camera.board_pose import board_poses
from calib.camera.lenses import LENSES
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.special_cases.stops import twists_of_joints
from calib.fit.estimate.task import Task
from calib.fit.registration.rows import Rows
from calib.fit.registration.table_rows import rows_and_setup
from calib.numerics.correlated_noise import PoseNoise
from calib.robot.robot import Robot
from calib.verbs.simulate.disturbances import Encoder
from calib.verbs.simulate.scenario import Scenario, VirtualCell
from calib.verbs.simulate.simulated_rows import Pictures

#: Steps of the encoders [deg].
STEPS = (0.0, 0.005, 0.02, 0.1)

#: Pictures of a cell, and noise of an image coordinate [px].
PICTURES = 25
NOISE = 0.2

#: Nothing is added to the stated covariances [m, rad].
NOTHING = PoseNoise(scale=1.0, position=1e-9, orientation=1e-9, joint=1e-9)


@dataclass(frozen=True, slots=True)
class Figures:
    """Of one cell, of the fits in the order of `WAYS`, and of the one that knows the covariances."""

    #: Error of the place of the board at fresh poses, rms [m]
    errors: tuple[float, ...]
    #: Share of the predicted coordinates and angles within their 95 % intervals
    covered: tuple[float, ...]


WAYS = ("equal", "covariances alone", "covariances", "known")


def draw(arm: tuple[str, str, str], step: float, seed: int) -> VirtualCell:
    """Draw a virtual cell with encoders of these steps [deg]."""
    name, camera_on, board_on = arm
    scenario = Scenario(
        Robot.load(name, base=camera_on, tip=board_on),
        Cell(
            kind="pixel",
            cameras={"": STATED},
            boards={"": replace(BOARD, sigma_corner=0.0)},
        ),
        model=MODEL,
        noise=None,
        sigma={"px": NOISE},
        encoder=Encoder(angle=np.deg2rad(step)),
    )
    return scenario.draw(seed)


def take_pictures(cell: VirtualCell, q: Array, seed: int) -> Pictures:
    """Take a picture at each of some joint values, shape (n, m), [rad] or [m]."""
    pictures = cell.measure(q, seed).pictures
    assert pictures is not None
    return pictures


def table_of(cell: VirtualCell, q: Array, T: Array, covariances: Array | None) -> Measurements:
    """Return the table of the board's poses in the camera, shape (n, 4, 4) [m]."""
    return Measurements(
        joint_names=cell.truth.nominal.joint_names,
        joints=q,
        points=T[:, :3, 3],
        rotations=T[:, :3, :3],
        kinds=("pose",) * len(q),
        covariances=covariances,
    )


def poses_of(pictures: Pictures) -> tuple[Array, Array]:
    """Return the board's poses in the camera, shape (n, 4, 4) [m], and their covariances at 1 px, shape (n, 6, 6)."""
    camera, printed = pictures.equipment.camera, pictures.equipment.printed
    assert camera.values is not None
    views = []
    for k in range(len(pictures.images)):
        own = pictures.picture == k
        views.append((printed.corners[pictures.corner[own]], pictures.pixels[own]))
    found = board_poses(views, LENSES[camera.lens], camera.values)
    poses = [pose for pose in found if pose is not None]
    assert len(poses) == len(views)
    return np.array([p.T_camera_board for p in poses]), np.array([p.covariance for p in poses])


def figures_of(case: tuple[tuple[str, str, str], float], seed: int) -> Figures:
    """Fit one cell in each way."""
    arm, step = case
    cell = draw(arm, step, seed)
    pictures = take_pictures(cell, cell.poses(PICTURES, seed), seed)
    T, covariances = poses_of(pictures)
    fresh = fresh_table(cell, seed)
    known = Cell(estimate_frame=True)
    fits = []
    for stated in (None, covariances):
        table = table_of(cell, pictures.readings, T, stated)
        rows, setup = rows_and_setup(cell.truth.nominal, table, known)
        task = Task(cell.truth.nominal, known, setup, MODEL)
        if stated is not None:
            # With weights of their own, rows keep the noise of poses that they come with.
            fixed = replace(rows, weights=np.ones(len(rows)))
            fits.append(fit(task, replace(fixed, pose_noise=NOTHING)))
        fits.append(fit(task, rows))
    whole = NOISE**2 * covariances + by_steps(fits[-1], rows, step)
    fits.append(fit(task, replace(fixed, covariances=whole, pose_noise=NOTHING)))
    judged = [judge(one, fresh) for one in fits]
    return Figures(tuple(error for error, _ in judged), tuple(share for _, share in judged))


def fresh_table(cell: VirtualCell, seed: int) -> Measurements:
    """Return noiseless poses of the board, at joint values that are exact."""
    exact = replace(cell, scenario=replace(cell.scenario, encoder=Encoder()))
    q = cell.poses(FRESH, seed, validation=True)
    return table_of(cell, q, take_pictures(exact, q, seed + 100_000).T_camera_board, None)


def by_steps(fitted: Fitted, rows: Rows, step: float) -> Array:
    """Return the covariance of poses by joints that are uniform within steps [deg], shape (n, 6, 6)."""
    J = twists_of_joints(fitted.kinematics, rows.samples)
    return np.asarray(np.deg2rad(step) ** 2 / 12.0 * J @ J.transpose(0, 2, 1))


def judge(fitted: Fitted, fresh: Measurements) -> tuple[float, float]:
    """Return the error of the board's place at fresh poses, rms [m], and the share within the 95 % intervals."""
    rows, _ = rows_and_setup(fitted.task.robot, fresh, fitted.task.cell)
    error = fitted.residual(rows)
    J = Problem.initial(fitted.kinematics, rows).prediction_jacobian(fitted.estimate.x)
    variance = np.einsum("ndp,pq,ndq->nd", J, fitted.estimate.covariance, J)
    covered = np.mean(np.abs(error) < 1.96 * np.sqrt(variance))
    return rms_length(error[:, :3]), float(covered)


def rows_of(runs: int, workers: int) -> Iterator[list[str]]:
    """Yield the cells of the table, a row for each arm and step."""
    cases = [(arm, step) for arm in ARMS for step in STEPS]
    for (arm, step), figures in run_cases(figures_of, cases, range(runs), workers=workers):
        squares = np.mean(np.square([f.errors for f in figures]), axis=0)
        ratios = np.sqrt(squares / squares[-1])
        covered = np.mean([f.covered for f in figures], axis=0)
        last = f"{1e3 * np.sqrt(squares[-1]):.3f}"
        yield [
            f"{arm[0]}, camera on {arm[1]}, {step:g} deg",
            last,
            *(f"{ratio:.2f}" for ratio in ratios[:-1]),
            *(f"{100.0 * share:.1f}" for share in covered[:-1]),
        ]


def main() -> None:
    """Print the table."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("--runs", type=int, default=100)
    arguments = parser.parse_args()
    titles = ["cell", "known [mm]", *(f"{way} / known" for way in WAYS[:-1])]
    titles += [f"{way} covered [%]" for way in WAYS[:-1]]
    print_table(titles, rows_of(arguments.runs, arguments.workers), [40])


if __name__ == "__main__":
    main()
