"""Camera fits against what they can reach: errors over the Cramer-Rao bound, coverage, and starts without a guess.

    python scripts/camera_study.py bound panda panda_link8 panda_link0 --runs 75
    python scripts/camera_study.py bound so101 gripper_link base_link --cheap --runs 100
    python scripts/camera_study.py starts --runs 300
    python scripts/camera_study.py pictures ur5 tool0 base_link --runs 20
    python scripts/camera_study.py prints --runs 5 --share 0.006

``bound``: virtual cells of 40 pictures, of which only the image's size is known of the camera; 0.3 px. Errors of the
robot, of the print and of the lens are drawn from what the fit takes for their priors, and predictions are judged at 40
fresh poses. The bound is that of a fit that knows noise and prior standard deviations. With ``--cheap`` 15 pictures of
a poor lens by a servo arm: joints stop anywhere within steps of 0.1 deg, and zeros are 2 deg off. ``starts``: cells of
15 pictures without a guess of mount or board, half of them of unknown intrinsics, against a fit that starts at the true
places. ``pictures``: where the board's middle is predicted in the camera at fresh poses, by the number of pictures,
with the intrinsics of the maker, and by hand-eye calibration alone. ``prints``: verdicts where the board's file states
its print a share too large, with the true errors of both URDFs over the joint limits, without noise and with frame and
target registered to them, beside the expected one.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import count, islice, product

import numpy as np
from studies import verdict_of, verdict_text
from verdict_study import urdf_error

from calib.basics.arrays import Array, read_only
from calib.boards.board import Board
from calib.camera.camera import Camera
from calib.camera.optics import CORNER, INTRINSICS
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import USE
from calib.errors import CalibError
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.estimate.prior_terms import PriorTerms
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.task import Task
from calib.fit.registration.rows import Rows
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.families import FAMILIES
from calib.model.kinematics import Samples
from calib.result.calibrate import calibrate
from calib.robot.robot import Robot
from calib.verbs.simulate.disturbances import Encoder
from calib.verbs.simulate.scenario import Scenario, Simulated, VirtualCell

BOARD = Board(
    pattern="charuco", columns=7, rows=5, square=0.03, marker=0.022, dictionary="DICT_5X5_100"
)
STATED = Camera(
    width=1280,
    height=720,
    values=read_only(np.array([900.0, 900.0, 639.5, 359.5, -0.05, 0.05, 0.0, 0.0, 0.0])),
)
SIZE_ALONE = Camera(width=1280, height=720)
POOR = Camera(
    width=640,
    height=480,
    values=read_only(np.array([620.0, 620.0, 319.5, 239.5, -0.3, 0.1, 0.0, 0.0, 0.0])),
)

#: Robots with the links that carry camera and board: on the hand, and beside the robot.
ARMS = (
    ("panda", "panda_link8", "panda_link0"),
    ("panda", "panda_link0", "panda_link8"),
    ("ur5", "tool0", "base_link"),
    ("ur5", "base_link", "tool0"),
)

#: Noise of an image coordinate [px], fresh pictures, and the model.
NOISE = 0.3
FRESH = 40
MODEL = "dh"

#: Numbers of pictures that are compared.
NUMBERS = (10, 15, 20, 30, 40, 60)

#: Robots whose boards are stated too large, with the links that carry camera and board.
OF_PRINTS = (ARMS[0], ARMS[2], ("ur10", "tool0", "base_link"))

#: Step of differences [rad].
STEP = 1e-6

#: Pictures of a cell whose start is judged, and the rms over that of the fit from the truth that is the same minimum.
FEW = 15
SAME = 1.05


@dataclass(frozen=True, slots=True)
class Setting:
    """What cells are like."""

    #: The camera, about which the true one is drawn; of it the fit knows the image's size alone
    camera: Camera
    #: Pictures to fit
    pictures: int
    #: Standard deviations of the robot's errors, where they are not the typical ones, by family
    sizes: Mapping[str, float]
    #: Steps of the joint values
    encoder: Encoder

    def prior(self, family: str) -> float:
        """Return the standard deviation that errors of a family are drawn with, in its unit."""
        return self.sizes.get(family, FAMILIES[family].typical)


USUAL = Setting(STATED, 40, {}, Encoder())
CHEAP = Setting(POOR, 15, {"zero": np.deg2rad(2.0)}, Encoder(angle=np.deg2rad(0.1)))


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


def draw(
    name: str,
    camera_on: str,
    board_on: str,
    seed: int,
    setting: Setting = USUAL,
    board: Board = BOARD,
) -> VirtualCell:
    """Draw a virtual cell, its print about a board."""
    robot = Robot.load(name, base=camera_on, tip=board_on)
    scenario = Scenario(
        robot,
        Cell(kind="pixel", cameras={"": setting.camera}, boards={"": board}),
        model=MODEL,
        noise=None,
        sigma={"px": NOISE},
        sizes=setting.sizes,
        encoder=setting.encoder,
    )
    return scenario.draw(seed)


def table_of(simulated: Simulated) -> Measurements:
    """Return the table of the corners in pictures."""
    pictures = simulated.pictures
    assert pictures is not None
    number = len(pictures.picture)
    return Measurements(
        joint_names=simulated.truth.nominal.joint_names,
        joints=pictures.readings[pictures.picture],
        points=np.full((number, 3), np.nan),
        kinds=("pixel",) * number,
        images=tuple(pictures.images[i] for i in pictures.picture),
        corners=tuple(map(str, pictures.corner)),
        board_points=BOARD.corners[pictures.corner],
        readings={"u": pictures.pixels[:, 0], "v": pictures.pixels[:, 1]},
    )


def against_the_bound(
    name: str, camera_on: str, board_on: str, seed: int, setting: Setting = USUAL
) -> Figures:
    """Fit one cell, and compare its predictions at fresh poses with the truth."""
    cell = draw(name, camera_on, board_on, seed, setting)
    size_alone = Camera(width=setting.camera.width, height=setting.camera.height)
    known = Cell(cameras={"": size_alone}, boards={"": BOARD})
    m = table_of(cell.measure(cell.poses(setting.pictures, seed), seed))
    rows, setup = rows_and_setup(cell.truth.nominal, m, known)
    task = Task(cell.truth.nominal, known, setup, MODEL)
    fitted = fit(task, rows)
    fresh = fresh_rows(cell, rows, seed, setting)
    x = fitted.estimate.x
    jacobian = Problem.initial(fitted.kinematics, fresh).prediction_jacobian(x)
    error = fitted.residual(fresh)
    variance = of_predictions(jacobian, fitted.estimate.covariance)
    bound = of_predictions(jacobian, bound_of(fitted, task, setting))
    covered = np.abs(error) < 1.96 * np.sqrt(variance)
    return Figures(
        float(np.mean(error**2)),
        float(np.mean(bound)),
        float(np.mean(variance)),
        float(np.mean(covered)),
    )


def fresh_rows(cell: VirtualCell, fitted: Rows, seed: int, setting: Setting) -> Rows:
    """Return noiseless images at fresh poses, joints as read, predicted by the lens that a fit began with."""
    views = cell.poses(FRESH, seed, validation=True)
    exact = replace(cell, scenario=replace(cell.scenario, encoder=Encoder()))
    simulated = exact.measure(views, seed + 100_000)
    assert simulated.pictures is not None
    known = Cell(cameras={"": setting.camera}, boards={"": BOARD})
    rows, _ = rows_and_setup(cell.truth.nominal, table_of(simulated), known)
    assert rows.samples.internals is not None
    assert fitted.samples.internals is not None
    internals = rows.samples.internals.copy()
    internals[:, INTRINSICS] = fitted.samples.internals[0, INTRINSICS]
    assert set(internals[:, CORNER]) <= set(fitted.samples.internals[:, CORNER])
    samples = replace(rows.samples, internals=read_only(internals))
    return replace(rows, samples=samples, measured=simulated.pictures.true_pixels)


def of_predictions(jacobian: Array, covariance: Array) -> Array:
    """Return the variances of predictions, shape (N, D), with the Jacobian (N, D, p)."""
    return np.asarray(np.einsum("ndp,pq,ndq->nd", jacobian, covariance, jacobian))


def bound_of(fitted: Fitted, task: Task, setting: Setting) -> Array:
    """Return the covariance of parameters of a fit that knows noise and priors, shape (p, p).

    Corners of one image share the errors of the joints, which are uniform within a step.
    """
    A = fitted.estimate.problem.prediction_jacobian(fitted.estimate.x)
    by_joints = setting.encoder.angle / np.sqrt(12.0) * joint_jacobian(fitted)
    precision = PriorTerms.of(task, fitted.kinematics.model, fitted.setup).precision.copy()
    for k, parameter in enumerate(fitted.kinematics.model.parameters):
        if parameter.family in FAMILIES:
            precision[k] = 1.0 / setting.prior(parameter.family) ** 2
    information = np.diag(precision)
    images = fitted.estimate.problem.rows.blocks
    for image in np.unique(images):
        of_image = A[images == image].reshape(-1, A.shape[2])
        shared = by_joints[images == image].reshape(len(of_image), -1)
        covariance = NOISE**2 * np.eye(len(of_image)) + shared @ shared.T
        information = information + of_image.T @ np.linalg.solve(covariance, of_image)
    return np.asarray(np.linalg.inv(information))


def joint_jacobian(fitted: Fitted) -> Array:
    """Return the derivative of the fitted images by the joint values, shape (N, D, m) [px/rad], by differences."""
    rows = fitted.estimate.problem.rows
    columns = []
    for step in STEP * np.eye(rows.samples.q.shape[1]):
        ahead, behind = (
            replace(rows, samples=replace(rows.samples, q=read_only(rows.samples.q + change)))
            for change in (step, -step)
        )
        columns.append((fitted.residual(behind) - fitted.residual(ahead)) / (2.0 * STEP))
    return np.stack(columns, axis=2)


def start_ratio(arm: tuple[str, str, str], seed: int, *, known: bool) -> float:
    """Return the rms of a fit without a guess over that of a fit that starts at the true places."""
    cell = draw(*arm, seed)
    exact_corners = replace(BOARD, sigma_corner=0.0)
    camera = STATED if known else SIZE_ALONE
    given = Cell(cameras={"": camera}, boards={"": exact_corners})
    m = table_of(cell.measure(cell.poses(FEW, seed), seed))
    rows, setup = rows_and_setup(cell.truth.nominal, m, given)
    task = Task(cell.truth.nominal, given, setup, MODEL)
    true_places = setup.with_poses(cell.truth.T_frame_base, cell.truth.T_tip_target)
    of_none = fit(task, rows).residual(rows)
    of_truth = fit(task, rows, registered=true_places).residual(rows)
    return float(np.sqrt(np.mean(of_none**2) / np.mean(of_truth**2)))


def place_error(arm: tuple[str, str, str], seed: int, pictures: int, model: str) -> float:
    """Fit one cell with a model, and return how far the board's middle is off in the camera at fresh poses, rms [m]."""
    cell = draw(*arm, seed)
    known = Cell(cameras={"": STATED}, boards={"": BOARD})
    m = table_of(cell.measure(cell.poses(pictures, seed), seed))
    rows, setup = rows_and_setup(cell.truth.nominal, m, known)
    fitted = fit(Task(cell.truth.nominal, known, setup, model), rows)
    views = cell.poses(FRESH, seed, validation=True)
    fresh = cell.measure(views, seed + 100_000).pictures
    assert fresh is not None
    true = fresh.T_camera_board
    found = fitted.kinematics.poses(fitted.estimate.x, Samples.at(views))
    away = (found[:, :3, :3] - true[:, :3, :3]) @ BOARD.centre + found[:, :3, 3] - true[:, :3, 3]
    return float(np.sqrt(np.mean(np.sum(away**2, axis=1))))


def run_pictures(arguments: argparse.Namespace) -> Iterator[str]:
    """Yield the lines of the third study."""
    arm = (arguments.robot, arguments.camera_on, arguments.board_on)
    seeds = range(arguments.runs)
    yield f"{' '.join(arm)}, {len(seeds)} cells, median and largest error of the board's place [mm]:"
    for model, pictures in (("frames", max(NUMBERS)), *((MODEL, number) for number in NUMBERS)):
        errors = 1e3 * np.array([place_error(arm, seed, pictures, model) for seed in seeds])
        yield f"  {model}, {pictures} pictures: {np.median(errors):.3f}, {np.max(errors):.3f}"


def run_prints(arguments: argparse.Namespace) -> Iterator[str]:
    """Yield a line for each cell of the fourth study."""
    size = 1.0 + arguments.share
    smaller = replace(
        BOARD, square=BOARD.square / size, marker=BOARD.marker / size, sigma_scale=0.0
    )
    known = Cell(model=MODEL, cameras={"": SIZE_ALONE}, boards={"": BOARD})
    free, used = Cell(estimate_frame=True), 0
    for arm, seed in product(OF_PRINTS, range(arguments.first, arguments.first + arguments.runs)):
        cell = draw(*arm, seed, board=smaller)
        m = table_of(cell.measure(cell.poses(USUAL.pictures, seed), seed))
        result = calibrate(cell.truth.nominal, m, cell=known)
        used += verdict_of(result).use == USE
        before, after = (
            1e3 * urdf_error(robot, cell.truth, free)
            for robot in (cell.truth.nominal, result.robot)
        )
        yield f"{arm[0]} {seed}: {verdict_text(result)}"
        yield f"  {before:.2f} -> {after:.2f} mm, said {1e3 * result.new_point[1]:.2f}"
    yield f"{used} of {len(OF_PRINTS) * arguments.runs} are {USE}"


def figures_of(arm: tuple[str, str, str], setting: Setting) -> Iterator[Figures]:
    """Yield the figures of one cell after the other; a seed of which no cell comes is left out."""
    for seed in count():
        try:
            yield against_the_bound(*arm, seed, setting)
        except CalibError as error:  # noqa: PERF203
            print(f"seed {seed}: {error}", file=sys.stderr)


def run_bound(arguments: argparse.Namespace) -> Iterator[str]:
    """Yield the lines of the first study."""
    arm = (arguments.robot, arguments.camera_on, arguments.board_on)
    setting = CHEAP if arguments.cheap else USUAL
    figures = list(islice(figures_of(arm, setting), arguments.runs))
    error, bound, stated = (
        sum(getattr(f, name) for f in figures) for name in ("error", "bound", "stated")
    )
    covered = np.mean([f.covered for f in figures])
    yield f"{' '.join(arm)}, {len(figures)} cells of {setting.pictures} pictures:"
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
    bound.add_argument("--cheap", action="store_true", help="a servo arm, a poor lens, 15 pictures")
    bound.set_defaults(run=run_bound)
    starts = studies.add_parser("starts")
    starts.add_argument("--runs", type=int, default=300)
    starts.set_defaults(run=run_starts)
    pictures = studies.add_parser("pictures")
    for name in ("robot", "camera_on", "board_on"):
        pictures.add_argument(name)
    pictures.add_argument("--runs", type=int, default=20)
    pictures.set_defaults(run=run_pictures)
    prints = studies.add_parser("prints")
    prints.add_argument("--runs", type=int, default=5, help="of each arm")
    prints.add_argument("--first", type=int, default=0, help="first seed")
    prints.add_argument(
        "--share", type=float, default=0.006, help="stated over actual size, less 1"
    )
    prints.set_defaults(run=run_prints)
    arguments = parser.parse_args()
    for line in arguments.run(arguments):
        print(line, flush=True)


if __name__ == "__main__":
    main()
