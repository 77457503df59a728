"""Camera fits against what they can reach: errors over the Cramer-Rao bound, coverage, and starts without a guess.

    python scripts/camera_study.py bound panda panda_link8 panda_link0 --runs 75
    python scripts/camera_study.py starts --runs 300

``bound``: virtual cells of 40 pictures, of which only the image's size is known of the camera; 0.3 px. Errors of the
robot, of the print and of the lens are drawn from what the fit takes for their priors, and predictions are judged at 40
fresh poses. The bound is that of a fit that knows noise and prior standard deviations. ``starts``: cells of 15 pictures
without a guess of mount or board, half of them of unknown intrinsics, against a fit that starts at the true places.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from calib.camera.board import Board
from calib.camera.camera import Camera
from calib.camera.optics import CORNER, INTRINSICS
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.estimate.fitting import Fitted, fit
from calib.estimate.prior_terms import PriorTerms
from calib.estimate.problem import Problem
from calib.estimate.task import Task
from calib.model.families import FAMILIES
from calib.registration.rows import Rows
from calib.registration.table_rows import rows_and_setup
from calib.robot.robot import Robot, read_only
from calib.simulation.camera.cell import CameraCell, draw_camera_cell
from calib.simulation.camera.pictures import Pictures, take_pictures
from calib.simulation.scenario import Scenario
from calib.units import Array

BOARD = Board(
    pattern="charuco", columns=7, rows=5, square=0.03, marker=0.022, dictionary="DICT_5X5_100"
)
STATED = Camera(
    width=1280,
    height=720,
    values=read_only(np.array([900.0, 900.0, 639.5, 359.5, -0.05, 0.05, 0.0, 0.0, 0.0])),
)
SIZE_ALONE = Camera(width=1280, height=720)

#: Robots with the links that carry camera and board: on the hand, and beside the robot.
ARMS = (
    ("panda", "panda_link8", "panda_link0"),
    ("panda", "panda_link0", "panda_link8"),
    ("ur5", "tool0", "base_link"),
    ("ur5", "base_link", "tool0"),
)

#: Noise of an image coordinate [px], pictures to fit and fresh ones, and the model.
NOISE = 0.3
FITTED = 40
FRESH = 40
MODEL = "dh"

#: Pictures of a cell whose start is judged, and the rms over that of the fit from the truth that is the same minimum.
FEW = 15
SAME = 1.05


@dataclass(frozen=True, slots=True)
class Figures:
    """Mean squares over the fresh corners of one cell [px^2]."""

    #: Of the errors of the predictions
    error: float
    #: Of the Cramer-Rao bound
    bound: float
    #: Of the standard deviations that calib states
    stated: float
    #: Share of coordinates within the 95 % intervals
    covered: float


def draw(name: str, camera_on: str, board_on: str, seed: int) -> CameraCell:
    """Draw a virtual cell."""
    robot = Robot.load(name, base=camera_on, tip=board_on)
    scenario = Scenario(
        robot, Cell(kind="pixel"), model=MODEL, noise=None, sigma={"px": NOISE}, sizes={}
    )
    return draw_camera_cell(scenario, STATED, BOARD, seed)


def table_of(pictures: Pictures) -> Measurements:
    """Return the table of the corners in pictures."""
    count = len(pictures.picture)
    return Measurements(
        joint_names=pictures.cell.truth.nominal.joint_names,
        joints=pictures.readings[pictures.picture],
        points=np.full((count, 3), np.nan),
        kinds=("pixel",) * count,
        images=tuple(pictures.images[i] for i in pictures.picture),
        corners=tuple(map(str, pictures.corner)),
        board_points=BOARD.corners[pictures.corner],
        readings={"u": pictures.pixels[:, 0], "v": pictures.pixels[:, 1]},
    )


def against_the_bound(name: str, camera_on: str, board_on: str, seed: int) -> Figures:
    """Fit one cell, and compare its predictions at fresh poses with the truth."""
    cell = draw(name, camera_on, board_on, seed)
    known = Cell(cameras={"": SIZE_ALONE}, boards={"": BOARD})
    m = table_of(take_pictures(cell, cell.views(FITTED, seed), seed))
    rows, setup = rows_and_setup(cell.truth.nominal, m, known)
    task = Task(cell.truth.nominal, known, setup, MODEL)
    fitted = fit(task, rows)
    fresh = fresh_rows(cell, rows, seed)
    x = fitted.estimate.x
    jacobian = Problem.initial(fitted.kinematics, fresh).jacobian(x)
    error = fitted.residual(fresh)
    variance = of_predictions(jacobian, fitted.estimate.covariance)
    bound = of_predictions(jacobian, bound_of(fitted, task))
    covered = np.abs(error) < 1.96 * np.sqrt(variance)
    return Figures(
        float(np.mean(error**2)),
        float(np.mean(bound)),
        float(np.mean(variance)),
        float(np.mean(covered)),
    )


def fresh_rows(cell: CameraCell, fitted: Rows, seed: int) -> Rows:
    """Return noiseless images at fresh poses, predicted by the lens that a fit began with."""
    views = cell.views(FRESH, seed, validation=True)
    pictures = take_pictures(cell, views, seed + 100_000)
    known = Cell(cameras={"": STATED}, boards={"": BOARD})
    rows, _ = rows_and_setup(cell.truth.nominal, table_of(pictures), known)
    assert rows.samples.optics is not None
    assert fitted.samples.optics is not None
    optics = rows.samples.optics.copy()
    optics[:, INTRINSICS] = fitted.samples.optics[0, INTRINSICS]
    assert set(optics[:, CORNER]) <= set(fitted.samples.optics[:, CORNER])
    samples = replace(rows.samples, optics=read_only(optics))
    return replace(rows, samples=samples, measured=pictures.true_pixels)


def of_predictions(jacobian: Array, covariance: Array) -> Array:
    """Return the variances of predictions, shape (N, D), with the Jacobian (N, D, p)."""
    return np.asarray(np.einsum("ndp,pq,ndq->nd", jacobian, covariance, jacobian))


def bound_of(fitted: Fitted, task: Task) -> Array:
    """Return the covariance of parameters of a fit that knows noise and priors, shape (p, p)."""
    A = fitted.estimate.problem.jacobian(fitted.estimate.x) / NOISE
    precision = PriorTerms.of(task, fitted.kinematics.model, fitted.setup).precision.copy()
    for k, parameter in enumerate(fitted.kinematics.model.parameters):
        if parameter.family in FAMILIES:
            precision[k] = 1.0 / FAMILIES[parameter.family].typical ** 2
    information = np.einsum("ndp,ndq->pq", A, A)
    return np.asarray(np.linalg.inv(information + np.diag(precision)))


def start_ratio(arm: tuple[str, str, str], seed: int, *, known: bool) -> float:
    """Return the rms of a fit without a guess over that of a fit that starts at the true places."""
    cell = draw(*arm, seed)
    exact_corners = replace(BOARD, sigma_corner=0.0)
    camera = STATED if known else SIZE_ALONE
    given = Cell(cameras={"": camera}, boards={"": exact_corners})
    m = table_of(take_pictures(cell, cell.views(FEW, seed), seed))
    rows, setup = rows_and_setup(cell.truth.nominal, m, given)
    task = Task(cell.truth.nominal, given, setup, MODEL)
    true_places = setup.placed(cell.truth.T_frame_base, cell.truth.T_tip_target)
    of_none = fit(task, rows).residual(rows)
    of_truth = fit(task, rows, registered=true_places).residual(rows)
    return float(np.sqrt(np.mean(of_none**2) / np.mean(of_truth**2)))


def run_bound(arguments: argparse.Namespace) -> Iterator[str]:
    """Yield the lines of the first study."""
    arm = (arguments.robot, arguments.camera_on, arguments.board_on)
    figures = [against_the_bound(*arm, seed) for seed in range(arguments.runs)]
    error, bound, stated = (
        sum(getattr(f, name) for f in figures) for name in ("error", "bound", "stated")
    )
    covered = np.mean([f.covered for f in figures])
    yield f"{' '.join(arm)}, {len(figures)} cells of {FITTED} pictures:"
    yield f"  error over bound {np.sqrt(error / bound):.3f}, stated over error {np.sqrt(stated / error):.3f},"
    yield f"  {100.0 * covered:.1f} % within the 95 % intervals"


def run_starts(arguments: argparse.Namespace) -> Iterator[str]:
    """Yield the lines of the second study."""
    failed = 0
    for k in range(arguments.runs):
        arm = ARMS[k % len(ARMS)]
        ratio = start_ratio(arm, 1000 + k, known=k // len(ARMS) % 2 == 0)
        if ratio > SAME:
            failed += 1
            yield f"{' '.join(arm)}, seed {1000 + k}: {ratio:.2f} times the rms of the fit from the truth"
    yield f"{arguments.runs - failed} of {arguments.runs} cells reach the minimum of the fit from the truth"


def main() -> None:
    """Run the study that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    studies = parser.add_subparsers(dest="study", required=True)
    bound = studies.add_parser("bound")
    for name in ("robot", "camera_on", "board_on"):
        bound.add_argument(name)
    bound.add_argument("--runs", type=int, default=75)
    bound.set_defaults(run=run_bound)
    starts = studies.add_parser("starts")
    starts.add_argument("--runs", type=int, default=300)
    starts.set_defaults(run=run_starts)
    arguments = parser.parse_args()
    for line in arguments.run(arguments):
        print(line, flush=True)


if __name__ == "__main__":
    main()
