"""Bodies of tags in the hand: what is recovered without noise, error and coverage against the bound, and by pictures.

    python scripts/body_study.py exact            noise-free corners of a cube and an icosahedron
    python scripts/body_study.py bound 200        runs with noise: error over the Cramer-Rao bound, coverage
    python scripts/body_study.py pictures 4       cubes drawn, photographed, found and calibrated

A Panda holds the body in front of a camera on the wall. Truths are Pinocchio's alone (`cell_truth.py`): all placements
of joints are off by 0.5 mm and 3 mrad, the camera's pose and the body's are unknown, and every corner of the body is
`CORNER` off along each axis. The pictures are those of `boards_study.py`, whose drawing is not calib's; a tag is off as
a whole there, as one that was glued.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, product
from pathlib import Path

import boards_study
import numpy as np
import pinocchio as pin
from boards_study import CUBE_FACES, CUBE_SIDE, FOCAL, SIZE, TAG_SIDE, cube
from cell_truth import ANGLE, LENGTH, TrueCell, draw_cell
from studies import run_jobs, study_parser

from calib.basics.arrays import Array, Integers, Mask
from calib.boards.board import Board
from calib.boards.bodies import Tag, tag_at
from calib.boards.detection.copies import as_it_is
from calib.boards.detection.picture import Search, search_image
from calib.camera.camera import Camera
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.data.priors import Priors
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.kinematics import Samples
from calib.model.observability import steps
from calib.numerics.errors import interval_factor
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.robot.urdf import read_urdf

#: Standard deviation of a corner's place on its body, along each axis [m], and of a glued tag, along each and about
#: each [rad].
CORNER = 3e-4
GLUED = 2.5e-4
GLUED_TURN = 4e-3

#: Noise of images [px].
NOISE = 0.2

#: Poses of the hand to fit, and fresh ones at which predictions are compared.
POSES = 60
FRESH = 60

#: Tags are found if they are seen at less than this angle to their normals (cosine), and bodies by so many corners.
_STEEPEST = 0.45
_FEWEST = 8

#: Distances from the camera at which the body is seen [m].
_NEAREST, _FARTHEST = 0.35, 1.1

#: The camera stands here, before the robot, and looks back at the hand's workspace.
PLACE = np.array([1.15, 0.0, 0.45])
TOWARDS = np.array([0.45, 0.0, 0.45])

#: The camera: known, and unknown.
CAMERA = Camera(
    width=SIZE[0],
    height=SIZE[1],
    values=np.array([FOCAL, FOCAL, SIZE[0] / 2, SIZE[1] / 2, 0.0, 0.0, 0.0, 0.0, 0.0]),
    sigma=np.zeros(9),
)
UNKNOWN_CAMERA = Camera(width=SIZE[0], height=SIZE[1])


def icosahedron() -> Board:
    """Describe tags of 34 mm on the faces of an icosahedron of 60 mm from its middle to each face."""
    golden = (1.0 + 5.0**0.5) / 2.0
    vertices = []
    for a, b in ((1.0, golden), (-1.0, golden), (1.0, -golden), (-1.0, -golden)):
        vertices += [(0.0, a, b), (a, b, 0.0), (b, 0.0, a)]
    points = np.array(vertices)
    tags: list[Tag] = []
    for face in combinations(range(12), 3):
        triangle = points[list(face)]
        sides = np.linalg.norm(triangle - np.roll(triangle, 1, axis=0), axis=1)
        if not np.allclose(sides, 2.0):
            continue
        middle = triangle.mean(axis=0)
        z = -middle / np.linalg.norm(middle)  # into the tag
        x = (triangle[0] - middle) / np.linalg.norm(triangle[0] - middle)
        R = np.column_stack([x, np.cross(z, x), z])
        tags.append(tag_at(len(tags), -0.06 * z, pin.rpy.matrixToRpy(R), 0.034))
    return Board(pattern="body", dictionary="DICT_APRILTAG_36h11", tags=tuple(tags))


@dataclass(frozen=True, eq=False)
class Scene:
    """A true Panda with a body in its hand, before a camera on the wall."""

    truth: TrueCell
    #: The body as described.
    board: Board
    #: True places of its corners, (n, 3) [m].
    corners: Array

    def seen(self, T: Array) -> Mask | None:
        """Return which corners are seen at a pose (4, 4) of the body in the camera, (n,); None if too few are."""
        in_camera = self.corners @ T[:3, :3].T + T[:3, 3]
        middle = in_camera.mean(axis=0)
        if not _NEAREST < middle[2] < _FARTHEST or in_camera[:, 2].min() < 0.1:
            return None
        pixels = boards_study.project(T[:3], self.corners)
        tags = in_camera.reshape(-1, 4, 3)
        normal = np.cross(tags[:, 1] - tags[:, 0], tags[:, 3] - tags[:, 0])
        sight = tags.mean(axis=1)
        lengths = np.linalg.norm(normal, axis=1) * np.linalg.norm(sight, axis=1)
        faces_camera = np.sum(normal * sight, axis=1) / lengths > _STEEPEST
        inside = np.all((pixels > 6) & (pixels < np.array(SIZE) - 7), axis=1).reshape(-1, 4)
        # The tag whose normal, into it, is along the hand's axis is where the body is held.
        held = normal / np.linalg.norm(normal, axis=1, keepdims=True) @ T[:3, 2] > 0.9
        visible = np.repeat(faces_camera & inside.all(axis=1) & ~held, 4)
        return visible if visible.sum() >= _FEWEST else None

    def pose(self, q: Array) -> Array:
        """Return the pose (4, 4) of the body in the camera at joint values (n,)."""
        return np.asarray(self.truth.pose(q, "wall", "body").homogeneous)

    def poses(self, rng: np.random.Generator, count: int) -> tuple[Array, list[Mask]]:
        """Draw joint values, (count, n), at which the body is seen, and which corners are."""
        q: list[Array] = []
        seen = []
        while len(q) < count:
            values = self.truth.draw(rng, 1)[0]
            visible = self.seen(self.pose(values))
            if visible is not None:
                q.append(values)
                seen.append(visible)
        return np.array(q), seen

    def table(self, q: Array, ids: list[Integers], pixels: list[Array]) -> Measurements:
        """Return the table of corners by their ids and pixels (k, 2), of each picture."""
        rows = [len(of_picture) for of_picture in ids]
        every = np.concatenate(ids)
        u, v = np.concatenate(pixels).T
        return Measurements(
            joint_names=tuple(self.truth.joints),
            joints=np.repeat(q, rows, axis=0),
            points=np.full((len(every), 3), np.nan),
            kinds=("pixel",) * len(every),
            images=tuple(f"{k}.png" for k, count in enumerate(rows) for _ in range(count)),
            corners=tuple(map(str, every.tolist())),
            board_points=self.board.corners[every],
            readings={"u": u, "v": v},
        )

    def measured(self, rng: np.random.Generator, noise: float) -> Measurements:
        """Return the corners seen at `POSES`, with noise [px]."""
        q, seen = self.poses(rng, POSES)
        pixels = []
        for values, visible in zip(q, seen, strict=True):
            exact = boards_study.project(self.pose(values)[:3], self.corners[visible])
            pixels.append(exact + noise * rng.standard_normal(exact.shape))
        return self.table(q, [np.flatnonzero(visible) for visible in seen], pixels)

    def cell(self, camera: Camera) -> Cell:
        """Return what calib is told: the camera's lens and the body, and nothing of where they are."""
        return Cell(
            estimate_frame=True,
            model="placement",
            cameras={"": camera},
            boards={"": self.board},
            base="panda_link0",
            tip="panda_link8",
        )

    def calibrated(self, table: Measurements, camera: Camera = CAMERA) -> Calibration:
        """Calibrate by a table."""
        return calibrate("panda", table, cell=self.cell(camera), validate=False)


def draw_scene(board: Board, corners: Array, rng: np.random.Generator) -> Scene:
    """Draw a true robot that holds a body, described by its board, whose corners truly are at others, (n, 3) [m]."""
    z = (TOWARDS - PLACE) / np.linalg.norm(TOWARDS - PLACE)
    y = np.array([0.0, 0.0, -1.0])
    R = np.column_stack([np.cross(y, z), y, z])
    place = pin.SE3(
        R @ pin.exp3(0.05 * rng.standard_normal(3)), PLACE + 0.03 * rng.standard_normal(3)
    )
    held = pin.SE3(pin.exp3(0.1 * rng.standard_normal(3)), np.array([0.0, 0.0, 0.12]))
    truth = draw_cell(
        read_urdf("panda").data.decode(),
        rng,
        {"wall": "panda_link0"},
        {"body": "panda_link8"},
        {"wall": place, "body": held},
    )
    return Scene(truth, board, corners)


def errors_through_files(scene: Scene, result: Calibration, rng: np.random.Generator) -> float:
    """Return the largest error of predicted corners by the written URDF, as Pinocchio reads it [m]."""
    with tempfile.TemporaryDirectory() as folder:
        path = result.write_urdf(Path(folder) / "panda.urdf", accept=True)
        written = pin.buildModelFromUrdf(str(path))
    frame = pin.SE3(result.setup.T_frame_base[0]).inverse()
    target = pin.SE3(result.setup.T_tip_target[0])
    found = TrueCell(
        written,
        written,
        {"wall": ("panda_link0", frame)},
        {"body": ("panda_link8", target)},
    )
    worst = 0.0
    q, _ = scene.poses(rng, FRESH)
    for values in q:
        true = scene.corners @ scene.pose(values)[:3, :3].T + scene.pose(values)[:3, 3]
        T = found.pose(values, "wall", "body").homogeneous
        predicted = scene.board.corners @ T[:3, :3].T + T[:3, 3]
        worst = max(worst, float(np.linalg.norm(predicted - true, axis=1).max()))
    return worst


def run_exact(_arguments: argparse.Namespace) -> Iterator[str]:
    """Yield what is recovered without noise."""
    rng = np.random.default_rng(45)
    for name, body in (("cube", cube()), ("icosahedron", icosahedron())):
        exact = replace(body, sigma_scale=0.0, sigma_corner=0.0)
        scene = draw_scene(exact, exact.corners, rng)
        result = scene.calibrated(scene.measured(rng, 0.0))
        yield f"{name}, corners as described: {errors_through_files(scene, result, rng):.1e} m"


@dataclass(frozen=True)
class Figures:
    """One run with noise."""

    #: Squared error of the body's predicted position, mean [m^2]
    square: float
    #: The Cramer-Rao bound of the same [m^2]
    bound: float
    #: Share of coordinates of positions, and of errors of corners, within their 95 % intervals
    covered: float
    corners_covered: float


def figures_of(name: str, source: str, seed: int) -> Figures:
    """Return the figures of one run, with prior standard deviations of the robot from the ``source``."""
    rng = np.random.default_rng(seed)
    body = cube() if name == "cube" else icosahedron()
    board = replace(body, sigma_scale=0.0, sigma_corner=CORNER)
    offsets = CORNER * rng.standard_normal(board.corners.shape)
    scene = draw_scene(board, board.corners + offsets, rng)
    table = scene.measured(rng, NOISE)
    cell = replace(
        scene.cell(CAMERA), priors=Priors(source, length=LENGTH, angle=ANGLE, zero=ANGLE)
    )
    robot = Robot.load("panda", base="panda_link0", tip="panda_link8")
    rows, setup = rows_and_setup(robot, table, cell)
    fitted = fit(Task(robot, cell, setup, cell.model), rows)
    estimate, model = fitted.estimate, fitted.kinematics.model

    q, _ = scene.poses(rng, FRESH)
    order = [scene.truth.joints.index(joint) for joint in robot.joint_names]
    poses, twists = fitted.kinematics.twists(estimate.x, Samples.at(q[:, order]))
    J = twists[:, :3]
    error = poses[:, :3, 3] - np.array([scene.pose(values)[:3, 3] for values in q])
    bound = np.einsum("nip,pq,niq->", J, bound_of(estimate.problem, estimate.x), J)
    variance = np.einsum("nip,pq,niq->ni", J, estimate.covariance, J)
    factor = interval_factor(estimate.freedom)
    numbers, true = [], []
    for k, parameter in model.internals:
        _, corner, axis = parameter.name.split("_")
        numbers.append(k)
        true.append(offsets[int(corner), "xyz".index(axis)])
    off = estimate.x[numbers] - true
    width = factor * np.sqrt(np.diagonal(estimate.covariance)[numbers])
    return Figures(
        square=float(np.mean(np.sum(error**2, axis=1))),
        bound=float(bound) / len(error),
        covered=float(np.mean(np.abs(error) <= factor * np.sqrt(variance))),
        corners_covered=float(np.mean(np.abs(off) <= width)),
    )


def bound_of(problem: Problem, x: Array) -> Array:
    """Return the bound (p, p) with the noise and the priors that the truth is drawn from; none of camera and body."""
    rows, model = problem.rows, problem.kinematics.model
    A = (problem.prediction_jacobian(x) / NOISE)[rows.used]
    std = {"length": LENGTH, "angle": ANGLE, "zero": ANGLE, "board": CORNER}
    prior = [1.0 / std.get(parameter.family, np.inf) for parameter in model.parameters]
    step = steps(model.units)
    inverse = np.linalg.pinv(np.concatenate([A, np.diag(prior)]) * step, rcond=1e-12)
    return np.asarray(inverse @ inverse.T) * np.outer(step, step)


def run_bound(arguments: argparse.Namespace) -> Iterator[str]:
    """Yield error over the bound and coverage of each body, with priors given and from the data."""
    for name, source in product(("cube", "icosahedron"), ("given", "data")):
        cases = [(name, source, arguments.seed + k) for k in range(arguments.count)]
        runs = list(run_jobs(figures_of, cases, workers=arguments.workers, label=name))
        ratio = np.sqrt(sum(run.square for run in runs) / sum(run.bound for run in runs))
        error = 1e3 * np.sqrt(np.mean([run.square for run in runs]))
        covered = 100.0 * np.mean([run.covered for run in runs])
        corners = 100.0 * np.mean([run.corners_covered for run in runs])
        yield (
            f"{name}, priors {source}: error {error:.3f} mm, over the bound {ratio:.3f}, covered {covered:.1f} %; "
            f"corners covered {corners:.1f} %"
        )


# By pictures


def glued(rng: np.random.Generator) -> dict[int, Array]:
    """Draw by how much each tag of the cube is off, (4, 4), in the body's frame and about its middle."""
    motions = {}
    for number in CUBE_FACES:
        turn = pin.exp3(GLUED_TURN * rng.standard_normal(3))
        motions[number] = pin.SE3(turn, GLUED * rng.standard_normal(3)).homogeneous
    return motions


def face_pose(number: int, motion: Array) -> Array:
    """Return the pose (4, 4) of the glued face of the cube in its frame, origin at its upper left corner."""
    T: Array = np.vstack([boards_study.face_pose(number), [0.0, 0.0, 0.0, 1.0]])
    middle = T[:3] @ [CUBE_SIDE / 2, CUBE_SIDE / 2, 0.0, 1.0]
    T[:3, 3] = motion[:3, :3] @ (T[:3, 3] - middle) + middle + motion[:3, 3]
    T[:3, :3] = motion[:3, :3] @ T[:3, :3]
    return T


def photograph(T: Array, motions: dict[int, Array], held: Mask, rng: np.random.Generator) -> Array:
    """Photograph the cube at a pose (4, 4) in the camera, without the face that is ``held``, (faces,)."""
    fine = np.full((boards_study.FINE * SIZE[1], boards_study.FINE * SIZE[0]), 120.0)
    for number, is_held in zip(CUBE_FACES, held, strict=True):
        T_face = T @ face_pose(number, motions[number])
        middle = T_face[:3] @ [CUBE_SIDE / 2, CUBE_SIDE / 2, 0.0, 1.0]
        if T_face[:3, 2] @ middle > 0.0 and not is_held:
            face = boards_study.draw_face(number, TAG_SIDE, CUBE_SIDE)
            fine = boards_study.see(face, T_face[:3], fine, 0.0)
    return boards_study.photograph(fine, rng)


def run_pictures(arguments: argparse.Namespace) -> Iterator[str]:
    """Yield errors of the calibrations by pictures of a cube, with corners off as stated, and taken as exact."""
    edge = (CUBE_SIDE - TAG_SIDE) / 2
    flat = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * TAG_SIDE + edge
    for seed in range(arguments.seed, arguments.seed + arguments.count):
        rng = np.random.default_rng(seed)
        motions = glued(rng)
        corners = np.concatenate(
            [
                (face_pose(number, motions[number]) @ np.c_[flat, np.zeros(4), np.ones(4)].T)[:3].T
                for number in CUBE_FACES
            ]
        )
        board = replace(cube(), sigma_scale=0.0, sigma_corner=CORNER)
        scene = draw_scene(board, corners, rng)
        q, _ = scene.poses(rng, POSES)
        used, ids, pixels = [], [], []
        held = np.array([boards_study.face_pose(number)[2, 2] > 0.9 for number in CUBE_FACES])
        for k, values in enumerate(q):
            image = photograph(scene.pose(values), motions, held, rng)
            _, (view,) = search_image(Search((board,), _FEWEST), as_it_is(image))
            if view.is_used:
                used.append(k)
                ids.append(view.ids)
                pixels.append(view.pixels)
        table = scene.table(q[used], ids, pixels)
        fresh, _ = scene.poses(rng, FRESH)
        figures: list[str] = []
        for name, sigma, camera in (
            ("stated", CORNER, CAMERA),
            ("stated, lens unknown", CORNER, UNKNOWN_CAMERA),
            ("exact", 0.0, CAMERA),
        ):
            told = replace(scene, board=replace(board, sigma_corner=sigma))
            result = told.calibrated(table, camera)
            order = [scene.truth.joints.index(joint) for joint in result.nominal.joint_names]
            if not figures:
                nominal = result.nominal_setup.T_frame_base[0] @ result.nominal.poses(
                    fresh[:, order]
                )
                nominal = nominal @ result.nominal_setup.T_tip_target[0]
                figures.append(
                    f"nominal {1e3 * corner_error(scene, nominal, board.corners, fresh):.3f}"
                )
            found = result.setup.T_frame_base[0] @ result.robot.poses(fresh[:, order])
            found = found @ result.setup.T_tip_target[0]
            error = corner_error(scene, found, fitted_corners(result, board), fresh)
            figures.append(f"corners {name} {1e3 * error:.3f}")
        yield f"seed {seed}: {len(used)} of {len(q)} pictures; error of corners [mm]: {', '.join(figures)}"


def fitted_corners(result: Calibration, board: Board) -> Array:
    """Return where a result has the corners of a body, (n, 3) [m]."""
    corners = board.corners
    for k, parameter in result.geometry.kinematics.model.internals:
        name, _, rest = parameter.name.partition("_")
        if name == "corner":
            number, axis = rest.split("_")
            corners[int(number), "xyz".index(axis)] += result.geometry.x[k]
    return corners


def corner_error(scene: Scene, found: Array, corners: Array, q: Array) -> float:
    """Return the rms error of corners in the camera at poses ``found``, (n, 4, 4), but for the size of all [m].

    A body whose corners are 0.3 mm off tells the size of all to 0.1 % only.
    """
    true, predicted = [], []
    for T, values in zip(found, q, strict=True):
        T_true = scene.pose(values)
        true.append(scene.corners @ T_true[:3, :3].T + T_true[:3, 3])
        predicted.append(corners @ T[:3, :3].T + T[:3, 3])
    a, b = np.concatenate(predicted), np.concatenate(true)
    size = np.sum(a * b) / np.sum(a * a)
    return float(np.sqrt(np.mean(np.sum((size * a - b) ** 2, axis=1))))


def main() -> None:
    """Run one part of the study."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("part", choices=("exact", "bound", "pictures"))
    parser.add_argument("count", type=int, nargs="?", default=25, help="runs of each body")
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    arguments = parser.parse_args()
    run = {"exact": run_exact, "bound": run_bound, "pictures": run_pictures}[arguments.part]
    for line in run(arguments):
        print(line, flush=True)


if __name__ == "__main__":
    main()
