"""Cells with several chains: what is recovered without noise, and error and coverage against the Cramer-Rao bound.

    python scripts/cell_study.py exact            noise-free points, pixels and contacts, through the written URDFs
    python scripts/cell_study.py bound 25         25 runs of each cell with noise: error over the bound, coverage
    python scripts/cell_study.py clasp 4          4 runs of two arms that clasp a part, and nothing else
    python scripts/cell_study.py stops 200        200 runs of an SO-101 at the stops of its joints, and nothing else

Truths are Pinocchio's alone (`cell_truth.py`).
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from cell_truth import FOCAL, SIZE, TrueCell, draw_cell, joined
from studies import run_jobs, study_parser

from calib.basics.arrays import Array
from calib.boards.board import Board
from calib.camera.camera import Camera
from calib.data.cell import Cell, FurtherRobot
from calib.data.cell_chains import robot_of_cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Why
from calib.fit.estimate.problem import Problem
from calib.model.observability import steps
from calib.numerics.errors import interval_factor, rms
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.ranges import column_limits
from calib.robot.robot import Robot
from calib.robot.urdf import read_urdf
from calib.show.verdict_text import reason_text

#: Noise of points [m] and of images [px].
POINT_NOISE = 5e-5
PIXEL_NOISE = 0.2

#: Noise of joint values in contacts [rad].
JOINT_NOISE = 1e-4

#: Noise of a joint's reading at its stop, and offsets of joints of an arm that was put together by hand [rad].
STOP_NOISE = 1e-3
OFFSET = 0.02

#: Height of the table that hands lie on, over the link that it stands on [m].
TABLE = 0.4

#: Poses of each hand.
POSES = 60

#: Poses at which predictions are compared.
FRESH = 60

#: A known camera without distortion.
CAMERA = Camera(
    width=SIZE[0],
    height=SIZE[1],
    values=np.array([FOCAL, FOCAL, SIZE[0] / 2, SIZE[1] / 2, 0.0, 0.0, 0.0, 0.0, 0.0]),
    sigma=np.zeros(9),
)

#: The boards of `cell_truth`, without errors of their print: what one camera and one board leave open is the scale of
#: the cell, which a print's scale alone determines.
BOARD = Board(
    pattern="chessboard",
    columns=5,
    rows=4,
    square=0.05,
    sigma_scale=0.0,
    sigma_corner=0.0,
    sigma_warp=0.0,
)

#: Links of the hands, by the target's name.
HANDS = {"left": "arm_left_7_link", "right": "arm_right_7_link"}

#: True place of the second of two robots.
PLACE = pin.SE3(pin.exp3(np.array([0.05, -0.02, 2.8])), np.array([1.1, 0.2, 0.05]))

#: A lens that is not known, of a camera whose images have the size of the others.
UNKNOWN_CAMERA = Camera(width=SIZE[0], height=SIZE[1])


@dataclass(frozen=True, eq=False)
class Study:
    """A cell, what is measured in it, and what calib is told."""

    robot: str
    truth: TrueCell
    table: Measurements
    cell: Cell
    seen: tuple[tuple[str, str], ...]

    def fitted(self) -> Calibration:
        """Calibrate."""
        return calibrate(self.robot, self.table, cell=self.cell, validate=False)


def cell_of(truth: TrueCell, **known: object) -> Cell:
    """Return what calib is told of a cell: links, and that frames and targets are unknown."""
    return Cell(
        bases={name: link for name, (link, _) in truth.frames.items()},
        tips={name: link for name, (link, _) in truth.targets.items()},
        estimate_frame=True,
        model="placement",
        **known,  # type: ignore[arg-type]
    )


def one_robot(
    name: str,
    rng: np.random.Generator,
    frames: Mapping[str, str],
    targets: Mapping[str, str],
    poses: Mapping[str, pin.SE3] | None = None,
) -> TrueCell:
    """Draw a true cell of one robot, by its name."""
    return draw_cell(read_urdf(name).data.decode(), rng, frames, targets, poses or {})


def two_robots(
    rng: np.random.Generator,
    frames: Mapping[str, str],
    targets: Mapping[str, str],
    poses: Mapping[str, pin.SE3] | None = None,
) -> TrueCell:
    """Draw a true cell of two Pandas."""
    stated = Cell(robots={"right": FurtherRobot("panda")})
    text = robot_of_cell(read_urdf("panda"), stated).urdf.data.decode()
    return draw_cell(text, rng, frames, targets, poses or {}, {"right/mount": PLACE})


def points_on_hands(robot: str, root: str, rng: np.random.Generator, sigma: float) -> Study:
    """A tracker sees a reflector on either hand."""
    truth = one_robot(robot, rng, {"tracker": root}, HANDS)
    seen = (("tracker", "left"), ("tracker", "right"))
    table = truth.points(rng, seen, POSES, sigma)
    return Study(robot, truth, table, cell_of(truth, instrument="tracker"), seen)


def boards_on_hands(
    robot: str, head: str, rng: np.random.Generator, sigma: float, camera: Camera = CAMERA
) -> Study:
    """A camera on the head sees a board on either hand."""
    seen = (("head", "left"), ("head", "right"))
    truth = one_robot(robot, rng, {"head": head}, HANDS).aimed(rng, seen)
    table = truth.pixels(rng, seen, POSES, sigma)
    cell = cell_of(truth, cameras={"head": camera}, boards={"left": BOARD, "right": BOARD})
    return Study(robot, truth, table, cell, seen)


def wrist_and_wall(rng: np.random.Generator, sigma: float) -> Study:
    """A camera on the wrist sees a board on the table, and one on the wall a board on the flange."""
    seen = (("wrist", "on_table"), ("wall", "on_flange"))
    truth = one_robot(
        "panda",
        rng,
        {"wrist": "panda_link8", "wall": "panda_link0"},
        {"on_table": "panda_link0", "on_flange": "panda_link8"},
    ).aimed(rng, seen)
    table = truth.pixels(rng, seen, POSES, sigma)
    cameras = {"wrist": CAMERA, "wall": CAMERA}
    boards = {"on_table": BOARD, "on_flange": BOARD}
    return Study("panda", truth, table, cell_of(truth, cameras=cameras, boards=boards), seen)


def camera_and_board_on_two_arms(
    rng: np.random.Generator, sigma: float, camera: Camera = UNKNOWN_CAMERA
) -> Study:
    """One of two arms carries a camera, the other a board; intrinsics are unknown unless a camera is given."""
    seen = (("camera", "board"),)
    truth = two_robots(rng, {"camera": "panda_link8"}, {"board": "right/panda_link8"})
    truth = truth.aimed(rng, seen)
    table = truth.pixels(rng, seen, 2 * POSES, sigma)
    robots = {"right": FurtherRobot("panda")}
    cell = cell_of(truth, cameras={"camera": camera}, boards={"board": BOARD}, robots=robots)
    return Study("panda", truth, table, cell, seen)


def points_on_two_arms(rng: np.random.Generator, sigma: float) -> Study:
    """A tracker sees the hands of two arms."""
    targets = {"left": "panda_link8", "right": "right/panda_link8"}
    truth = two_robots(rng, {"tracker": "panda_link0"}, targets)
    seen = (("tracker", "left"), ("tracker", "right"))
    table = truth.points(rng, seen, POSES, sigma)
    robots = {"right": FurtherRobot("panda")}
    cell = cell_of(truth, robots=robots, instrument="tracker")
    return Study("panda", truth, table, cell, seen)


def touches(robot: str, root: str, rng: np.random.Generator, place: str) -> Study:
    """A tracker sees both hands, which touch: a ball in a socket on the left one, or both flat on one plane.

    Args:
        robot: Name of a robot with two hands, or of one of two alike that stand opposite each other.
        root: Link that the tracker and the plane stand on.
        rng: Random numbers.
        place: ``"socket"`` or ``"plane"``.
    """
    hands = HANDS
    robots = {}
    if robot == "panda":
        hands = {"left": "panda_link8", "right": "right/panda_link8"}
        robots = {"right": FurtherRobot("panda")}
    frames = {"tracker": root, place: hands["left"] if place == "socket" else root}
    # A table that both hands reach.
    table = pin.SE3(pin.exp3(0.2 * rng.standard_normal(3)), np.array([0.4, 0.0, TABLE]))
    poses = {"plane": table}
    stands = (rng, frames, hands, poses)
    truth = two_robots(*stands) if robots else one_robot(robot, *stands)
    points = truth.points(rng, [("tracker", "left"), ("tracker", "right")], POSES, 0.0)
    touching, kind = (["right"], "fixed") if place == "socket" else (["left", "right"], "face")
    contacts = truth.contacts(rng, place, touching, POSES // 2, kind)
    seen = [("tracker", "left"), ("tracker", "right"), *((place, hand) for hand in touching)]
    cell = cell_of(truth, instrument="tracker", robots=robots)
    return Study(robot, truth, joined([points, contacts]), cell, tuple(seen))


def errors_through_files(study: Study, result: Calibration, rng: np.random.Generator) -> float:
    """Return the largest error of predictions by the written URDF, as Pinocchio reads it [m].

    Of a socket, whose axes mean nothing, the distance from its origin counts; of a plane, whose normal has two signs,
    the distance of the hand's face, and the cosine of its tilt as if it were a length.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = result.write_urdf(Path(folder) / "cell.urdf", accept=True)
        written = pin.buildModelFromUrdf(str(path))
    setup = result.setup
    frames = {
        name: (link, pin.SE3(setup.T_frame_base[setup.groups.index(name)]).inverse())
        for name, (link, _) in study.truth.frames.items()
    }
    targets = {
        name: (link, pin.SE3(setup.T_tip_target[setup.targets.index(name)]))
        for name, (link, _) in study.truth.targets.items()
    }
    found = TrueCell(written, written, frames, targets)
    worst = 0.0
    for frame, target in study.seen:
        for values in study.truth.fresh(rng, frame, FRESH):
            true = seen_of(frame, study.truth.pose(values, frame, target))
            predicted = seen_of(frame, found.pose(values, frame, target))
            worst = max(worst, float(np.linalg.norm(true - predicted)))
    return worst


def seen_of(frame: str, T: pin.SE3) -> Array:
    """Return what a frame, by its name, sees of a target's pose in it."""
    if frame == "socket":
        return np.array([np.linalg.norm(T.translation)])
    if frame == "plane":
        return np.abs([T.translation[2], T.rotation[2, 2]])
    return np.asarray(T.translation)


def run_exact(_arguments: argparse.Namespace) -> Iterator[str]:
    """Yield what is recovered without noise."""
    rng = np.random.default_rng(45)
    tiago, talos, pandas = (
        ("tiago_dual", "base_footprint"),
        ("talos_reduced", "base_link"),
        ("panda", "panda_link0"),
    )
    studies: dict[str, Callable[[], Study]] = {
        "tiago_dual, points": lambda: points_on_hands(*tiago, rng, 0.0),
        "tiago_dual, pixels": lambda: boards_on_hands("tiago_dual", "head_2_link", rng, 0.0),
        "tiago_dual, ball in a socket": lambda: touches(*tiago, rng, "socket"),
        "tiago_dual, faces": lambda: touches(*tiago, rng, "plane"),
        "talos, points": lambda: points_on_hands(*talos, rng, 0.0),
        "talos, pixels": lambda: boards_on_hands("talos_reduced", "head_2_link", rng, 0.0),
        "talos, ball in a socket": lambda: touches(*talos, rng, "socket"),
        "talos, faces": lambda: touches(*talos, rng, "plane"),
        "two Pandas, points": lambda: points_on_two_arms(rng, 0.0),
        "two Pandas, pixels": lambda: camera_and_board_on_two_arms(rng, 0.0, CAMERA),
        "two Pandas, ball in a socket": lambda: touches(*pandas, rng, "socket"),
        "two Pandas, faces": lambda: touches(*pandas, rng, "plane"),
    }
    for name, make in studies.items():
        study = make()
        error = errors_through_files(study, study.fitted(), rng)
        yield f"{name}: {error:.1e} m"


@dataclass(frozen=True)
class Figures:
    """One run with noise."""

    #: Squared error of predicted positions, mean [m^2]
    square: float
    #: The Cramer-Rao bound of the same [m^2]
    bound: float
    #: Share of coordinates within their 95 % intervals
    covered: float


def figures_of(study: Study, rng: np.random.Generator) -> Figures:
    """Calibrate a cell, and compare predictions at fresh joint values with the truth."""
    result = study.fitted()
    part = result.geometry
    names = result.nominal.joint_names
    order = [study.truth.joints.index(name) for name in names]
    errors = []
    twists = []
    for frame, target in study.seen:
        values = study.truth.fresh(rng, frame, FRESH)
        true = [study.truth.pose(row, frame, target).translation for row in values]
        samples = result.samples(values[:, order], target=target, group=frame)
        poses, J = part.kinematics.twists(part.x, samples, rotation=False)
        errors.append(poses[:, :3, 3] - np.array(true))
        twists.append(J)
    error = np.concatenate(errors)
    J = np.concatenate(twists)
    fitted = result.fit.geometry
    bound = np.einsum("nip,pq,niq->", J, information_inverse(fitted.estimate.problem, part.x), J)
    variance = np.einsum("nip,pq,niq->ni", J, part.covariance, J)
    if part.scale is not None:
        variance += (J @ part.change_by_scale) ** 2
    inside = np.abs(error) <= interval_factor(fitted.estimate.freedom) * np.sqrt(variance)
    return Figures(
        square=float(np.mean(np.sum(error**2, axis=1))),
        bound=float(bound) / len(error),
        covered=float(np.mean(inside)),
    )


def information_inverse(problem: Problem, x: Array) -> Array:
    """Return the covariance of an unbiased fit with known noise and no prior, (p, p), zero where nothing is known."""
    sigma = {"m": POINT_NOISE, "px": PIXEL_NOISE}
    rows = problem.rows
    J = problem.prediction_jacobian(x)
    scales = np.ones(rows.used.shape)
    for unit in rows.channels.present:
        scales = np.where(rows.channels.where(unit), sigma[unit], scales)
    A = (J / scales[:, :, None])[rows.used]
    step = steps(problem.kinematics.model.units)
    return np.asarray(
        np.linalg.pinv(A * step, rcond=1e-7) @ np.linalg.pinv(A * step, rcond=1e-7).T
    ) * np.outer(step, step)


#: Cells with noise.
NOISY: Mapping[str, Callable[[np.random.Generator], Study]] = {
    "shared torso, points on both hands": lambda rng: points_on_hands(
        "tiago_dual", "base_footprint", rng, POINT_NOISE
    ),
    "camera on the head, board on either hand": lambda rng: boards_on_hands(
        "tiago_dual", "head_2_link", rng, PIXEL_NOISE
    ),
    "cameras on wrist and wall": lambda rng: wrist_and_wall(rng, PIXEL_NOISE),
    "two arms, camera and board, intrinsics unknown": lambda rng: camera_and_board_on_two_arms(
        rng, PIXEL_NOISE
    ),
}


def run_case(name: str, seed: int) -> Figures:
    """Return the figures of one run of a cell, by its name and seed."""
    rng = np.random.default_rng(seed)
    return figures_of(NOISY[name](rng), rng)


def run_bound(arguments: argparse.Namespace) -> Iterator[str]:
    """Yield error over the bound and coverage of each cell."""
    for name in NOISY:
        cases = [(name, arguments.seed + k) for k in range(arguments.count)]
        runs = list(run_jobs(run_case, cases, workers=arguments.workers, label=name))
        ratio = np.sqrt(sum(run.square for run in runs) / sum(run.bound for run in runs))
        covered = 100.0 * np.mean([run.covered for run in runs])
        error = 1e3 * np.sqrt(np.mean([run.square for run in runs]))
        yield f"{name}: error {error:.3f} mm, over the bound {ratio:.3f}, covered {covered:.1f} %"


def two_arms_clasped(rng: np.random.Generator) -> Study:
    """Two Pandas hold one rigid part at 60 postures: nothing else is measured."""
    stated = Cell(robots={"right": FurtherRobot("panda")})
    text = robot_of_cell(read_urdf("panda"), stated).urdf.data.decode()
    part = pin.SE3(pin.exp3(np.array([0.2, 3.0, 0.1])), np.array([0.02, 0.01, 0.2]))
    poses = {"right": pin.SE3.Identity(), "grip": part}
    frames, targets = {"grip": "panda_link8"}, {"right": "right/panda_link8"}
    truth = draw_cell(text, rng, frames, targets, poses, {"right/mount": PLACE})
    table = truth.contacts(rng, "grip", ["right"], POSES, "clasp", JOINT_NOISE)
    cell = cell_of(truth, robots=dict(stated.robots))
    return Study("panda", truth, table, cell, (("grip", "right"),))


def run_clasp(arguments: argparse.Namespace) -> Iterator[str]:
    """Yield errors of the right hand in the grip of the left one, in further clasps and anywhere, and the verdict."""
    squares: list[tuple[float, float]] = []
    for seed in range(arguments.seed, arguments.seed + arguments.count):
        rng = np.random.default_rng(seed)
        study = two_arms_clasped(rng)
        result = calibrate(study.robot, study.table, cell=study.cell)
        part = result.geometry
        order = [study.truth.joints.index(name) for name in result.nominal.joint_names]
        clasped = study.truth.contacts(rng, "grip", ["right"], POSES, "clasp").joints
        fresh = study.truth.draw(rng, FRESH)
        figures = []
        for where, values in (("clasped", clasped), ("anywhere", fresh)):
            samples = result.samples(values[:, order], target="right", group="grip")
            found, J = part.kinematics.twists(part.x, samples, rotation=False)
            true = np.array([study.truth.pose(row, "grip", "right").translation for row in values])
            nominal = result.nominal_setup.T_frame_base[0] @ result.nominal.poses(values[:, order])
            variance = np.einsum("nip,pq,niq->n", J, part.covariance, J)
            before = 1e3 * rms(np.linalg.norm(nominal[:, :3, 3] - true, axis=1))
            after = 1e3 * rms(np.linalg.norm(found[:, :3, 3] - true, axis=1))
            expected = 1e3 * float(np.sqrt(np.mean(variance)))
            figures.append(f"{where} {before:.2f} to {after:.3f} mm, expected {expected:.3f}")
        stated = 1e3 * part.new_point[1]
        squares.append((after**2, stated**2))  # with the hands anywhere, which came last
        seen = result.trust.observability
        rank = f"rank {seen.rank} of {seen.columns}"
        assert result.verdict is not None
        yield f"seed {seed}: {'; '.join(figures)}, stated {stated:.1f}; {rank}; {result.verdict.use}"
    true, told = np.sqrt(np.mean(squares, axis=0))
    above = sum(square > bound for square, bound in squares)
    yield f"anywhere: {true:.2f} mm rms, stated {told:.2f}; larger than stated in {above} of {len(squares)}"


def run_stops(arguments: argparse.Namespace) -> Iterator[str]:
    """Yield errors of zeros by end stops alone over their bound, coverage, and what is named as open.

    Each joint but the gripper is read twice at each of its stops: the bound of its zero is the noise over two.
    """
    arm = Robot.load("so101")
    limits = column_limits(arm)
    count = len(arm.joint_names)
    at = [(j, k) for _ in range(2) for j in range(count) for k in range(2)]
    ratios, covered = [], []
    for seed in range(arguments.seed, arguments.seed + arguments.count):
        rng = np.random.default_rng(seed)
        zeros = OFFSET * rng.standard_normal(count)
        q = rng.uniform(-1.0, 1.0, (len(at), count))
        for row, (j, k) in zip(q, at, strict=True):
            row[j] = limits[j][k] - zeros[j] + STOP_NOISE * rng.standard_normal()
        table = Measurements(
            joint_names=arm.joint_names,
            joints=q,
            points=np.full((len(at), 3), np.nan),
            kinds=("stop",) * len(at),
            targets=tuple(arm.joint_names[j] for j, _ in at),
            readings={"stop": np.array([limits[j][k] for j, k in at])},
        )
        if seed == arguments.seed:  # what stays open is named alike in all runs
            verdict = calibrate("so101", table).verdict
            assert verdict is not None
            alone = next(r for r in verdict.reasons if r.why is Why.STOPS_ALONE)
            yield f"{verdict.use}; no zero of {alone.values['not_stopped']}; {reason_text(alone)}"
        result = calibrate("so101", table, model="zeros", validate=False)
        ratios.append((result.geometry.x - zeros) / (STOP_NOISE / 2.0))
        found = zip(result.parameters, zeros, strict=True)
        covered.append([estimate.low <= zero <= estimate.high for estimate, zero in found])
    by_joint = ", ".join(f"{ratio:.2f}" for ratio in np.sqrt(np.mean(np.square(ratios), axis=0)))
    over = np.sqrt(np.mean(np.square(ratios)))
    yield f"error over the bound {over:.3f} (by joint {by_joint}), covered {100.0 * np.mean(covered):.1f} %"


def main() -> None:
    """Run one part of the study."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("part", choices=("exact", "bound", "clasp", "stops"))
    parser.add_argument("count", type=int, nargs="?", default=25, help="runs of each cell")
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    arguments = parser.parse_args()
    parts = {"exact": run_exact, "bound": run_bound, "clasp": run_clasp, "stops": run_stops}
    for line in parts[arguments.part](arguments):
        print(line, flush=True)


if __name__ == "__main__":
    main()
