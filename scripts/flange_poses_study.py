"""Twelve simulated sets of flange poses without joint values: mount and board against the Cramer-Rao bound, and joints.

    python scripts/flange_poses_study.py --draws 20 --joints

A camera sees a chessboard; one of them is on the hand. Without joint values and without a robot, calib estimates the
mount, the board and, in some sets, focal length and centre. The truth and its bound are this script's own: a pinhole
camera in NumPy, and the Fisher information of its corners by finite differences,

    C = sigma^2 (J^T J)^-1,        ratio = sqrt(mean over draws of e_k^2 / C_kk)

with the errors e of the twelve coordinates of mount and board. A sound estimate has a ratio of 1, but for chance: with
n draws its mean over twelve coordinates varies by some 1 / sqrt(2 n), less as they are correlated.

With ``--joints`` each set with a robot is taken once more with a robot that has usual errors (0.5 mm, 2 mrad), whose
controller does not know them: its joint values by inverse kinematics of the controller's model, how many of the poses
have one solution or are decided, and the largest error there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from studies import print_table, study_parser

from calib.basics.arrays import Array, read_only
from calib.boards.board import Board
from calib.camera.camera import Camera
from calib.data.cell import Cell
from calib.data.forms.flange_poses import flange_joints
from calib.data.measurements import Measurements
from calib.model.parameter_sets import error_model
from calib.result.calibrate import calibrate
from calib.robot.flange import BASE, FLANGE, JOINTS, NAME
from calib.robot.robot import Robot
from calib.verbs.compensate.solutions import joint_solutions
from calib.verbs.joints.branches import unwound, ways
from calib.verbs.joints.joints import JointValues, MeasuredThere, joint_values

#: Standard deviation of a corner [px].
SIGMA = 0.2

#: fx, fy, cx, cy [px].
LENS = np.array([905.0, 902.0, 636.0, 362.0])

#: The inner corners of a chessboard of 8 x 6 squares of 30 mm [m].
CORNERS = np.array([[0.03 * i, 0.03 * j, 0.0] for j in range(5) for i in range(7)])

#: Step of differences [m, rad or px].
STEP = 1e-5

#: Errors of a robot [m, rad].
LENGTH, ANGLE = 5e-4, 2e-3

#: Joint values that agree by so much are the same [rad].
SAME = 1e-9


@dataclass(frozen=True)
class Set:
    """One set: how many poses, which camera, whose arm."""

    name: str
    count: int
    on_hand: bool = True
    lens_known: bool = True
    robot: str = ""  # name of the arm, whose poses they are; "" for any poses
    base: str = "base"
    tip: str = "tool0"
    own_rows: bool = (
        False  # the controller has an arm of its own, with lengths and angles that differ
    )


SETS = (
    Set("hand, 10 poses", 10),
    Set("hand, 20 poses", 20),
    Set("hand, 20 poses, lens unknown", 20, lens_known=False),
    Set("fixed, 15 poses", 15, on_hand=False),
    Set("fixed, 25 poses, lens unknown", 25, on_hand=False, lens_known=False),
    Set("ur5, hand", 20, robot="ur5"),
    Set("ur5, fixed", 20, on_hand=False, robot="ur5"),
    Set("ur3, hand, lens unknown", 20, lens_known=False, robot="ur3"),
    Set("z1, hand", 20, robot="z1", base="", tip=""),
    Set("ur10, hand", 20, robot="ur10"),
    Set("ur5, controller's own rows, hand", 20, robot="ur5", own_rows=True),
    Set("ur10, controller's own rows, fixed", 20, on_hand=False, robot="ur10", own_rows=True),
)


def pose(rotation_vector: ArrayLike, position: ArrayLike) -> Array:
    """Return a pose (4, 4) of a rotation vector [rad] and a position [m]."""
    T: Array = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rotation_vector).as_matrix()
    T[:3, 3] = position
    return T


@dataclass(frozen=True)
class Scene:
    """Truth of one set."""

    case: Set
    controller: Robot | None  # The arm as its controller has it
    q: Array  # (n, m), its joint values; empty without a robot
    T_base_flange: Array  # (n, 4, 4), as shown
    T_link_camera: Array  # In the flange, or in the base if fixed
    T_link_board: Array  # In the base, or in the flange

    def pixels(self, T_base_flange: Array, change: Array | None = None) -> Array:
        """Return the images of the corners, (n, k, 2) [px], at true poses of the flange.

        ``change`` moves mount and board along and about their own axes, 6 each, and adds to the lens, 4.
        """
        change = np.zeros(16) if change is None else change
        T_camera = self.T_link_camera @ pose(change[3:6], change[:3])
        T_board = self.T_link_board @ pose(change[9:12], change[6:9])
        inverse = np.linalg.inv(T_base_flange)
        T_from_to = inverse if self.case.on_hand else T_base_flange
        T = np.linalg.inv(T_camera) @ T_from_to @ T_board
        points: Array = np.einsum("nij,kj->nki", T[:, :3, :3], CORNERS) + T[:, None, :3, 3]
        fx, fy, cx, cy = LENS + change[12:]
        return np.asarray(points[..., :2] / points[..., 2:] * [fx, fy] + [cx, cy])

    def bound(self) -> Array:
        """Return the least variance of the twelve coordinates of mount and board, (12,), in [m^2] and [rad^2]."""
        count = 12 if self.case.lens_known else 16
        columns = []
        for step in STEP * np.eye(16)[:count]:
            ahead = self.pixels(self.T_base_flange, step)
            behind = self.pixels(self.T_base_flange, -step)
            columns.append((ahead - behind).ravel() / (2.0 * STEP))
        J = np.column_stack(columns)
        return SIGMA**2 * np.diag(np.linalg.inv(J.T @ J))[:12]

    def table(self, pixels: Array, names: tuple[str, ...], q: Array) -> Measurements:
        """Return the corners as a table of joint values (n, m) of joints with these names."""
        n, k = pixels.shape[:2]
        return Measurements(
            joint_names=names,
            joints=np.repeat(q, k, axis=0),
            prismatic=tuple(name for name in names if name in JOINTS[:3]),
            points=np.full((n * k, 3), np.nan),
            kinds=("pixel",) * (n * k),
            readings={"u": pixels[..., 0].ravel(), "v": pixels[..., 1].ravel()},
            board_points=np.tile(CORNERS, (n, 1)),
            images=tuple(f"{i:02}.png" for i in range(n) for _ in range(k)),
            corners=tuple(str(c) for _ in range(n) for c in range(k)),
        )

    def cell(self, base: str, tip: str) -> Cell:
        """Return what is known: an exact board, the lens as the set has it; the robot between two links."""
        values, sigma = np.append(LENS, np.zeros(5)), np.zeros(9)
        if not self.case.lens_known:
            sigma[:4] = np.inf
        camera = Camera(width=1280, height=720, values=values, sigma=sigma)
        board = Board(
            pattern="chessboard",
            columns=8,
            rows=6,
            square=0.03,
            sigma_scale=0.0,
            sigma_warp=0.0,
            sigma_corner=0.0,
        )
        links = (tip, base) if self.case.on_hand else (base, tip)
        sigmas = {"px": SIGMA}
        return Cell(
            base=links[0], tip=links[1], sigma=sigmas, cameras={"": camera}, boards={"": board}
        )


def make_scene(case: Set, seed: int) -> Scene:
    """Draw mount and board, and poses at which the camera sees the whole board, tilted by up to 30 deg."""
    rng = np.random.default_rng(seed)
    mounted = pose(rng.normal(0.0, 0.3, 3), [0.04, -0.06, 0.09])
    stands = pose([*rng.normal(0.0, 0.05, 2), rng.uniform(-3.0, 3.0)], [0.45, -0.1, 0.05])
    if case.robot == "z1":
        stands[:3, 3] = [0.4, 0.0, -0.2]  # a small arm: most of these poses are beyond its limits
    if not case.on_hand:
        # The board is on the hand, and the camera looks back along the axis of the flange.
        stands = pose([np.pi, 0.0, 0.0], [0.5, 0.0, 0.9]) @ pose(
            rng.normal(0.0, 0.1, 3), np.zeros(3)
        )
    controller = None
    if case.robot:
        controller = Robot.load(case.robot, case.base or None, case.tip or None)
        if case.own_rows:
            controller = with_errors(controller, rng)
    T = np.array(list(islice_views(case, mounted, stands, rng, 3 * case.count)))
    if controller is None:
        T = T[: case.count]
        return Scene(case, None, np.zeros((len(T), 0)), T, *places(case, mounted, stands))
    solutions = joint_solutions(controller, T)
    reached = [n for n, values in enumerate(solutions) if len(values)][: case.count]
    solutions = [solutions[n] for n in reached]
    every_way = ways(controller, solutions)
    way = every_way[rng.integers(len(every_way))]
    q, _ = unwound(controller, np.array([s[k] for s, k in zip(solutions, way, strict=True)]))
    return Scene(case, controller, q, controller.poses(q), *places(case, mounted, stands))


def places(case: Set, mounted: Array, stands: Array) -> tuple[Array, Array]:
    """Return the poses of camera and board in their links."""
    return (mounted, stands) if case.on_hand else (stands, mounted)


def islice_views(
    case: Set, mounted: Array, stands: Array, rng: np.random.Generator, count: int
) -> Iterator[Array]:
    """Yield poses of the flange, (4, 4), at which the camera sees the board from 0.35 to 0.5 m."""
    middle = pose(np.zeros(3), CORNERS.mean(axis=0))
    flipped = pose([np.pi, 0.0, 0.0], np.zeros(3))
    for _ in range(count):
        turned = pose([*rng.uniform(-0.5, 0.5, 2), rng.uniform(-1.0, 1.0)], np.zeros(3))
        away = pose(np.zeros(3), [*rng.uniform(-0.03, 0.03, 2), -rng.uniform(0.4, 0.55)])
        T_board_camera = middle @ flipped @ turned @ away
        if case.on_hand:
            yield stands @ T_board_camera @ np.linalg.inv(mounted)
        else:
            yield stands @ np.linalg.inv(T_board_camera) @ np.linalg.inv(mounted)


def with_errors(robot: Robot, rng: np.random.Generator) -> Robot:
    """Return an arm with usual errors of all placements."""
    model = error_model(robot, "placement", target=False)
    sizes = np.where(np.array(model.units) == "m", LENGTH, ANGLE)
    return model.apply(robot, sizes * rng.normal(size=len(sizes)))


def ratio(scene: Scene, draws: range) -> tuple[float, float]:
    """Return the rms error over its bound, of mount and of board, without joint values and without a robot."""
    squares = []
    cell = scene.cell(BASE, FLANGE)
    robot = Robot.load(NAME, cell.base, cell.tip)
    p = scene.T_base_flange
    values = flange_joints(p[:, :3, 3], p[:, :3, :3])
    exact, bound = scene.pixels(p), scene.bound()
    for draw in draws:
        noise = np.random.default_rng([draw, len(p)]).normal(0.0, SIGMA, exact.shape)
        table = scene.table(exact + noise, JOINTS, values)
        result = calibrate(robot, table, cell=cell, validate=False)
        pairs = (
            (scene.T_link_camera, np.linalg.inv(result.setup.T_frame_base[0])),
            (scene.T_link_board, result.setup.T_tip_target[0]),
        )
        error = []
        for true, found in pairs:
            D = np.linalg.inv(true) @ found
            error += [*D[:3, 3], *Rotation.from_matrix(D[:3, :3]).as_rotvec()]
        squares.append(np.array(error) ** 2 / bound)
    by_coordinate = np.mean(squares, axis=0)
    return float(np.sqrt(by_coordinate[:6].mean())), float(np.sqrt(by_coordinate[6:].mean()))


def recovered(scene: Scene, seed: int) -> tuple[JointValues, Array]:
    """Return the joint values of an arm whose controller does not know its errors, and their errors, (n,) [rad]."""
    assert scene.controller is not None
    rng = np.random.default_rng([seed, 7])
    true = with_errors(scene.controller, rng)
    pixels = scene.pixels(true.poses(scene.q))
    pixels = pixels + rng.normal(0.0, SIGMA, pixels.shape)
    names = scene.controller.joint_names
    cell = scene.cell(scene.controller.base, scene.controller.tip)
    nominal = Robot.load(scene.case.robot, cell.base, cell.tip)
    blank = np.zeros_like(scene.q)
    pose_of_row = np.repeat(np.arange(len(blank)), len(CORNERS))
    table = scene.table(pixels, names, blank)
    measured = MeasuredThere(nominal, table, cell, names, pose_of_row)
    found = joint_values(scene.controller, scene.T_base_flange, measured)
    away = np.abs((found.q - scene.q + np.pi) % (2.0 * np.pi) - np.pi)
    return replace(found, q=read_only(found.q)), away.max(axis=1)


def main() -> None:
    """Print a row for each set."""
    parser = study_parser(__doc__)
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="number of the first draw")
    parser.add_argument("--joints", action="store_true", help="recover joint values, too")
    parser.add_argument("--sets", type=int, nargs="*", default=range(1, len(SETS) + 1))
    arguments = parser.parse_args()
    every: list[float] = []
    heads = ["set", "poses", "mount", "board", "solutions", "decided", "unique", "error [rad]"]

    def rows() -> Iterator[list[str]]:
        for number in arguments.sets:
            case = SETS[number - 1]
            scene = make_scene(case, number)
            draws = range(arguments.first, arguments.first + arguments.draws)
            mount, board = ratio(scene, draws) if draws else (np.nan, np.nan)
            every.extend((mount, board))
            row = [case.name, str(len(scene.T_base_flange)), f"{mount:.2f}", f"{board:.2f}"]
            if arguments.joints and scene.controller is not None:
                found, errors = recovered(scene, number)
                worst = errors[found.unique].max(initial=0.0)
                row += [
                    f"{found.counts.min()}-{found.counts.max()}",
                    found.decided_by or "nothing",
                    f"{np.sum(found.unique)} of {len(errors)}",
                    f"{worst:.0e}",
                ]
            yield [*row, *[""] * (len(heads) - len(row))]

    print_table(heads, rows(), [36])
    print(f"\nall sets: {np.sqrt(np.mean(np.square(every))):.3f} of the bound")


if __name__ == "__main__":
    main()
