"""How often the stated uncertainty of a pose holds: simulated cells of ten kinds, each with 1,000 points of its own.

    python scripts/uncertainty_study.py run --first 0 --count 30 --cache cells.jsonl
    python scripts/uncertainty_study.py table --cache cells.jsonl
    python scripts/uncertainty_study.py budgets --first 0 --count 10

A cell's seed says its kind, its arm and all that is drawn. True arms have errors of DH rows, gears, encoders and
compliances, and what no model has: a third harmonic of each joint's angle, lost motion, and arrivals that scatter.
Forward kinematics and gravity of the truth are Pinocchio's (`verification_truth`); cells with pictures are those of
`calib simulate`. Each is calibrated with the model ``auto``. At 500 points within the measured ranges of the joints and
at 500 over their limits the true pose of one arrival is compared with the predicted one: U holds if the distance is not
larger. ``run`` appends a line for each cell, and goes on where it was stopped; ``table`` prints the shares by kind. In
one cell of three U is compared with that of a Monte Carlo by JCGM 101. Development has seeds below 1000, validation
from 5000 on. ``budgets`` draws ten tables of statements for each cell, and compares their budgets with Monte Carlo too:
in each the parts have to add up to the whole.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import numpy as np
import pinocchio as pin
from arms import load_arm
from studies import TYPICAL_ERRORS, joint_values_around, log_uniform, print_table, study_parser
from verification_truth import JointErrors, Truth, draw_frame

from calib.basics.arrays import Array, Integers, read_only
from calib.boards.board import Board
from calib.camera.camera import Camera
from calib.data.cell import SCALE_SIGMAS, Cell, GroupDistance, StatedUncertainty
from calib.data.measurements import Measurements
from calib.model.kinematics import Samples
from calib.numerics.geometry import pose_of
from calib.numerics.moves import last_moves
from calib.numerics.rigid_motion import without_rigid_motion
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.gravity import Payload
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.uncertainty.at_poses import PoseUncertainty, uncertainty_at
from calib.uncertainty.budget import Budget
from calib.uncertainty.monte_carlo import monte_carlo
from calib.verbs.simulate.scenario import Scenario

#: Points of a cell within the measured ranges, and as many over the joint limits.
POINTS = 500

#: Budgets of each cell that are compared with Monte Carlo.
BUDGETS = 10

#: The linear law agrees with Monte Carlo within this share.
LIKE = 0.05

#: Monte Carlo is done in one of so many cells, at so many of its points.
MONTE_CARLO_EVERY, MONTE_CARLO_POINTS = 3, 20

#: Arms that are drawn.
ARMS = ("ur10", "panda", "irb120")

#: Standard deviations of the errors of a true arm's gains and encoders, of which each arm has a share [-], [rad].
GAIN, ECCENTRICITY = TYPICAL_ERRORS["gain"], TYPICAL_ERRORS["eccentricity"]

#: The least and the greatest share.
SHARES = (0.1, 1.0)

#: Standard deviation of a third harmonic of each joint [rad].
HARMONIC = 3e-5

#: Standard deviation of a joint's arrival [rad].
ARRIVAL = 2e-5

#: Compliance of a joint of a loaded arm [rad/Nm].
COMPLIANCE = 1e-5

#: Positions of sockets in the base for arms of so much reach [m], over the reach.
SOCKETS = np.array([[0.5, 0.2, 0.2], [0.45, -0.35, 0.1], [0.2, 0.5, 0.35], [0.55, 0.0, 0.4]])

#: Standard deviation of the known distances between sockets [m].
BAR = 1e-5

BOARD = Board(
    pattern="charuco", columns=5, rows=4, square=0.045, marker=0.033, dictionary="DICT_5X5_100"
)
CAMERA = Camera(
    width=1280,
    height=720,
    values=read_only(np.array([900.0, 900.0, 639.5, 359.5, -0.05, 0.05, 0.0, 0.0, 0.0])),
)


@dataclass(frozen=True, eq=False)
class TrueArm:
    """A true arm with errors that no model has."""

    truth: Truth
    #: Amplitude and phase of the third harmonic of each joint [rad], (m,) each
    harmonic: Array
    phase: Array
    #: Lost motion of each joint to either side [rad], (m,)
    lost: Array

    def off(self, q: Array, moves: Array) -> Array:
        """Return what joints are off by at readings q after moves, (N, m) each [rad]."""
        return self.harmonic * np.sin(3.0 * q + self.phase) - self.lost * np.sign(moves)

    def arrive(
        self,
        q: Array,
        rng: np.random.Generator,
        target: int | Integers = 0,
        moves: Array | None = None,
    ) -> Array:
        """Return true poses T_base_target of one arrival at each of readings q, (N, 4, 4) [m]."""
        known = last_moves(q) if moves is None else moves
        joints = q + self.off(q, known) + ARRIVAL * rng.standard_normal(q.shape)
        return self.truth.poses(joints, target)


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A calibrated cell, and errors at points."""

    result: Calibration
    #: Within the measured ranges, then over the limits
    uncertainty: PoseUncertainty
    #: True minus predicted, (2 POINTS, 3) [m]
    position: Array
    #: Angles between true and predicted orientations, (2 POINTS,) [rad]; empty if the rows have none
    angle: Array
    #: The points
    samples: Samples
    #: Whether they are judged in the base
    in_base: bool


def draw_arm(rng: np.random.Generator, seed: int, *, loaded: bool, lost: float) -> TrueArm:
    """Draw a true arm, with a payload if it is loaded, and with lost motion [rad]."""
    nominal = load_arm(ARMS[seed // len(KINDS) % len(ARMS)])
    payload = Payload(float(rng.uniform(1.0, 3.0)), np.array([0.02, 0.0, 0.06])) if loaded else None
    truth = Truth.draw(nominal, rng, "dh", targets=2, rotation=True, payload=payload)
    count = len(nominal.joints)
    of_gain, of_encoder = (log_uniform(rng, *SHARES) for _ in range(2))
    state = JointErrors(
        gain=of_gain * GAIN * rng.standard_normal(count),
        sin=of_encoder * ECCENTRICITY * rng.standard_normal(count),
        cos=of_encoder * ECCENTRICITY * rng.standard_normal(count),
        compliance=COMPLIANCE * rng.uniform(0.5, 1.5, count) * loaded,
    )
    return TrueArm(
        replace(truth, state=state),
        HARMONIC * rng.standard_normal(count),
        rng.uniform(0.0, 2.0 * np.pi, count),
        lost * rng.uniform(0.5, 1.5, count),
    )


@dataclass(frozen=True)
class Setting:
    """What is measured in a kind of cell, and how."""

    #: Least and greatest number of rows
    rows: tuple[int, int] = (30, 60)
    poses: bool = False
    #: Whether the noise is stated
    sigma: bool = False
    free: bool = False
    stations: bool = False
    stated: bool = False
    loaded: bool = False
    lost: float = 0.0
    instrument: str = "tracker"
    #: Share of rows that are outliers
    outliers: float = 0.0
    #: Each pose is measured so often
    visits: int = 1


KINDS: dict[str, Setting | None] = {
    "points": Setting(),
    "poses": Setting(poses=True, sigma=True),
    "stated": Setting(stated=True, sigma=True),
    "stations": Setting(free=True, stations=True, rows=(60, 90), sigma=True),
    "sockets": None,
    "pictures": None,
    "payload": Setting(loaded=True, sigma=True),
    "lost motion": Setting(lost=1e-4, visits=2, sigma=True),
    "scale": Setting(instrument="stereo", free=True, outliers=0.04, sigma=True),
    "few or many": Setting(rows=(12, 200), sigma=True),
}


def measured_poses(robot: Robot, count: int, rng: np.random.Generator) -> Array:
    """Draw readings over a part of the joint ranges, (count, m) [rad]."""
    share = float(rng.uniform(0.4, 1.0))
    centre = random_joint_values(robot, 1, int(rng.integers(2**31)))
    return joint_values_around(centre, share, robot, count, int(rng.integers(2**31)))


def points_of(q: Array, robot: Robot, rng: np.random.Generator) -> Array:
    """Return `POINTS` readings within the ranges of q, and as many over the limits, (2 POINTS, m) [rad]."""
    low, high = q.min(axis=0), q.max(axis=0)
    inner = rng.uniform(low, high, (POINTS, q.shape[1]))
    return np.concatenate([inner, random_joint_values(robot, POINTS, int(rng.integers(2**31)))])


def judged(
    result: Calibration,
    q: Array,
    T_true: Array,
    *,
    group: str | None = None,
    in_base: bool = False,
    oriented: bool = False,
    moves: Array | None = None,
) -> Calibrated:
    """Return errors and uncertainty at points whose true poses, (N, 4, 4), are in the frame, or in the base."""
    samples: Samples = result.samples(q, group=group, moves=moves)
    uncertainty = uncertainty_at(result, samples, in_base=in_base)
    error = T_true[:, :3, 3] - uncertainty.poses[:, :3, 3]
    angle = np.zeros(0)
    if oriented:
        turn = T_true[:, :3, :3] @ uncertainty.poses[:, :3, :3].transpose(0, 2, 1)
        angle = np.array([np.linalg.norm(pin.log3(R)) for R in turn])
    return Calibrated(result, uncertainty, error, angle, samples, in_base)


def run_setting(setting: Setting, seed: int) -> Calibrated:
    """Draw a cell of a tracker, calibrate it, and judge it."""
    rng = np.random.default_rng([48, seed])
    arm = draw_arm(rng, seed, loaded=setting.loaded, lost=setting.lost)
    robot = arm.truth.nominal
    low, high = setting.rows
    count = int(rng.choice([low, high])) if high > 3 * low else int(rng.integers(low, high + 1))
    q = np.repeat(measured_poses(robot, count, rng), setting.visits, axis=0)
    if setting.visits > 1:  # in tours, from another side each time
        q = np.concatenate([rng.permutation(q[:: setting.visits]) for _ in range(setting.visits)])
    sigma = log_uniform(rng, 2e-5, 1e-4)
    turn_sigma = 10.0 * sigma
    scale = SCALE_SIGMAS[setting.instrument] * float(rng.standard_normal())

    number = len(q)
    several = 2 if setting.stations else 1
    station: Integers = np.asarray(rng.integers(several, size=number))
    target: Integers = np.asarray(rng.integers(several, size=number))
    frames: Array = np.tile(np.eye(4), (2, 1, 1))
    if setting.free:
        frames = np.array([draw_frame(rng), draw_frame(rng)])
    given_frame, given_target = frames[0], arm.truth.targets[0]
    frame_std, frame_turn, target_std = 1e-4, 1e-4, 1e-4
    if setting.stated:
        given_frame = draw_frame(rng)
        off = pose_of(
            frame_std * rng.standard_normal(3), pin.exp3(frame_turn * rng.standard_normal(3))
        )
        frames = np.tile(given_frame @ off, (2, 1, 1))
        given_target = given_target.copy()
        given_target[:3, 3] -= given_target[:3, :3] @ (target_std * rng.standard_normal(3))

    # Lengths from the base on have the instrument's scale.
    T: Array = np.asarray(frames[station] @ arm.arrive(q, rng, target))
    origin = frames[station][:, :3, 3]
    points = origin + (1.0 + scale) * (T[:, :3, 3] - origin)
    points = points + sigma * rng.standard_normal(points.shape)
    bad = rng.uniform(size=number) < setting.outliers
    points[bad] += 2e-3 * rng.standard_normal((int(np.sum(bad)), 3))
    rotations = None
    if setting.poses:
        noise = turn_sigma * rng.standard_normal((number, 3))
        rotations = np.array([pin.exp3(n) @ R for n, R in zip(noise, T[:, :3, :3], strict=True)])
    table = Measurements(
        robot.joint_names,
        q,
        points,
        groups=tuple(f"station_{k}" for k in station) if setting.stations else (),
        targets=tuple(f"target_{k}" for k in target) if setting.stations else (),
        kinds=("pose" if setting.poses else "point",) * number,
        rotations=rotations,
    )
    stated = {"m": sigma, "rad": turn_sigma} if setting.poses else {"m": sigma}
    cell = Cell(
        instrument=setting.instrument,
        sigma=stated if setting.sigma else {},
        estimate_frame=setting.free,
        payload=arm.truth.payload,
    )
    if setting.stated:
        cell = replace(
            cell.with_target(given_target[:3, 3], estimate=False),
            T_frame_base=given_frame,
            uncertainty=StatedUncertainty(
                frame=frame_std, frame_angle=frame_turn, target=target_std
            ),
        )
    result = calibrate(robot, table, cell=cell)

    fresh = points_of(q, robot, rng)
    moves = rng.choice([-0.5, 0.5], fresh.shape)
    group = "station_0" if setting.stations else None
    shown = 0 if not setting.stations else int(result.setup.targets[0] == "target_1")
    T_true = frames[0] @ arm.arrive(fresh, rng, shown, moves)
    return judged(result, fresh, T_true, group=group, oriented=setting.poses, moves=moves)


def run_sockets(seed: int) -> Calibrated:
    """Draw an arm whose target is put into four sockets, calibrate it, and judge it in its base."""
    rng = np.random.default_rng([48, seed])
    arm = draw_arm(rng, seed, loaded=False, lost=0.0)
    truth, robot = arm.truth, arm.truth.nominal
    reach = 1.3 if robot.name.startswith("ur10") else 0.9
    sockets = SOCKETS * reach
    sigma = log_uniform(rng, 2e-5, 1e-4)
    each = int(rng.integers(12, 20))
    parts, groups = [], []
    for k, socket in enumerate(sockets):
        start = random_joint_values(robot, 4 * each, int(rng.integers(2**31)))
        heights = socket + sigma * rng.standard_normal((len(start), 3))
        joints = truth.reach(np.eye(3), heights, start)[:each]
        q = joints
        for _ in range(3):
            q = joints - arm.off(q, np.zeros(q.shape))
        parts.append(q + ARRIVAL * rng.standard_normal(q.shape))
        groups += [f"socket_{k}"] * len(q)
    q = np.concatenate(parts)
    bars = []
    for i in range(len(sockets)):
        for j in range(i):
            length = float(np.linalg.norm(sockets[i] - sockets[j]) + BAR * rng.standard_normal())
            bars.append(GroupDistance(f"socket_{i}", f"socket_{j}", length, BAR))
    table = Measurements(
        robot.joint_names,
        q,
        np.full((len(q), 3), np.nan),
        groups=tuple(groups),
        kinds=("fixed",) * len(q),
    )
    result = calibrate(robot, table, cell=Cell(distances=tuple(bars), sigma={"m": sigma}))
    fresh = points_of(q, robot, rng)
    found = judged(result, fresh, arm.arrive(fresh, rng), in_base=True)
    # No row determines where the base stands: the best rigid motion at the measured poses does not count.
    measured = result.samples(q)
    poses = uncertainty_at(result, measured, in_base=True).poses[:, :3, 3]
    there = (arm.truth.points(q + arm.off(q, np.zeros(q.shape))) - poses)[:, :, None]
    error = without_rigid_motion(
        found.uncertainty.poses[:, :3, 3], found.position[:, :, None], (poses, there)
    )
    return replace(found, position=error[:, :, 0])


def run_pictures(seed: int) -> Calibrated:
    """Draw a cell of a camera that looks at a board on the hand, calibrate it, and judge the board's positions."""
    robot = load_arm(ARMS[seed // len(KINDS) % len(ARMS)])
    rng = np.random.default_rng([48, seed])
    known = Cell(kind="pixel", cameras={"": CAMERA}, boards={"": BOARD})
    virtual = Scenario(
        robot, known, model="dh", noise=None, sigma={"px": log_uniform(rng, 0.1, 0.4)}
    ).draw(seed)
    simulated = virtual.measure(virtual.poses(int(rng.integers(18, 31)), seed), seed)
    pictures = simulated.pictures
    assert pictures is not None
    number = len(pictures.picture)
    table = Measurements(
        joint_names=robot.joint_names,
        joints=pictures.readings[pictures.picture],
        points=np.full((number, 3), np.nan),
        kinds=("pixel",) * number,
        images=tuple(pictures.images[i] for i in pictures.picture),
        corners=tuple(map(str, pictures.corner)),
        board_points=BOARD.corners[pictures.corner],
        readings={"u": pictures.pixels[:, 0], "v": pictures.pixels[:, 1]},
    )
    result = calibrate(robot, table, cell=Cell(cameras={"": CAMERA}, boards={"": BOARD}))
    fresh = points_of(table.joints, robot, rng)
    # In the camera: how the base is turned about the first joint is the joint's zero as well.
    T_base_board = virtual.truth.tip_poses(fresh) @ virtual.truth.T_tip_target[0]
    return judged(result, fresh, virtual.truth.T_frame_base[0] @ T_base_board)


def run_cell(seed: int) -> Calibrated:
    """Run the cell of a seed."""
    kind = tuple(KINDS)[seed % len(KINDS)]
    setting = KINDS[kind]
    if setting is not None:
        return run_setting(setting, seed)
    special: dict[str, Callable[[int], Calibrated]] = {
        "sockets": run_sockets,
        "pictures": run_pictures,
    }
    return special[kind](seed)


def linear_ratio(seed: int, cell: Calibrated) -> float:
    """Return U by the linear law over that by Monte Carlo, at some points within the ranges and over the limits."""
    some = cell.samples.select(np.arange(0, 2 * POINTS, 2 * POINTS // MONTE_CARLO_POINTS))
    return monte_carlo(cell.result, some, in_base=cell.in_base, seed=seed, tolerance=0.02).ratio


def line_of(seed: int, cell: Calibrated, seconds: float) -> dict[str, object]:
    """Return the figures of a cell as a line of the cache."""
    length = np.linalg.norm(cell.position, axis=1)
    holds = length <= cell.uncertainty.position
    near, far = slice(0, POINTS), slice(POINTS, None)
    parts = {
        part.source.value: [
            float(np.sqrt(np.mean(np.trace(part.covariance[where, :3, :3], 0, 1, 2))))
            for where in (near, far)
        ]
        for part in cell.uncertainty.contributions
    }
    result = cell.result
    return {
        "seed": seed,
        "kind": tuple(KINDS)[seed % len(KINDS)],
        "near": float(np.mean(holds[near])),
        "far": float(np.mean(holds[far])),
        "error": [float(np.sqrt(np.mean(length[where] ** 2))) for where in (near, far)],
        "stated": [
            float(np.sqrt(np.mean(cell.uncertainty.position_std[where] ** 2)))
            for where in (near, far)
        ],
        "U": [
            float(np.sqrt(np.mean(cell.uncertainty.position[where] ** 2))) for where in (near, far)
        ],
        "angle": float(np.mean(cell.angle <= cell.uncertainty.orientation))
        if len(cell.angle)
        else None,
        "parts": parts,
        "use": "" if result.verdict is None else result.verdict.use,
        "model": result.part(non_geometric=True).model.name,
        "extrapolation": result.part(non_geometric=True).extrapolation,
        "undetermined": result.part(non_geometric=True).undetermined,
        "freedom": float(np.median(cell.uncertainty.position_freedom)),
        "rows": len(result.rows),
        "seconds": seconds,
        "ratio": linear_ratio(seed, cell) if seed % MONTE_CARLO_EVERY == 0 else None,
    }


def draw_statements(rng: np.random.Generator) -> StatedUncertainty:
    """Draw what is stated of a cell: each size between nearly nothing and about that of the fit's own."""
    low = float(rng.uniform(15.0, 22.0))
    return StatedUncertainty(
        repeatability=log_uniform(rng, 1e-6, 1e-4),
        resolution=log_uniform(rng, 1e-6, 4e-4),
        lost_motion=log_uniform(rng, 1e-6, 2e-4),
        drift=log_uniform(rng, 1e-6, 1e-4),
        temperature=(low, low + float(rng.uniform(0.0, 12.0))),
    )


def budgets(seeds: Sequence[int]) -> None:
    """Print how well the linear law agrees with Monte Carlo, and how well the parts add up, over many budgets."""
    ratios, sums = [], []
    for seed in seeds:
        cell = run_cell(seed)
        rng = np.random.default_rng([49, seed])
        for number in range(BUDGETS):
            result = replace(cell.result, stated_uncertainty=draw_statements(rng))
            chosen = cell.samples.select(rng.choice(2 * POINTS, MONTE_CARLO_POINTS, replace=False))
            found = monte_carlo(result, chosen, in_base=cell.in_base, seed=number)
            ratios.append(found.ratio)
            budget = Budget.of(found.linear)
            whole = sum(line.position_std**2 for line in budget.lines)
            sums.append(np.sqrt(whole) / budget.position_std)
            print(seed, f"{found.ratio:.3f}", found.trials, f"{sums[-1]:.6f}", flush=True)
    agree = float(np.mean(np.abs(np.array(ratios) - 1.0) <= LIKE))
    off = float(np.max(np.abs(np.array(sums) - 1.0)))
    print(f"linear within 5 % of Monte Carlo: {agree:.0%} of {len(ratios)} budgets")
    print(f"parts add up within {off:.2%}")


def read_cache(path: Path) -> dict[int, dict[str, object]]:
    """Return the lines of a cache by the seeds."""
    if not path.exists():
        return {}
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line]
    return {int(line["seed"]): line for line in lines}


def run(seeds: Sequence[int], path: Path) -> None:
    """Run the cells of seeds that the cache does not have, and append their lines."""
    done = read_cache(path)
    for seed in seeds:
        if seed in done:
            continue
        start = perf_counter()
        line = line_of(seed, run_cell(seed), perf_counter() - start)
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")


def table(path: Path) -> None:
    """Print the shares of points at which U holds."""
    lines = list(read_cache(path).values())
    rows = []
    for kind in (*KINDS, "all"):
        own = [line for line in lines if kind in (line["kind"], "all")]
        if not own:
            continue
        near, far = (np.array([line[name] for line in own]) for name in ("near", "far"))
        both = (near + far) / 2.0
        error, stated = (np.array([line[name] for line in own]) for name in ("error", "stated"))
        ratio = np.median(error / stated, axis=0)
        rows.append(
            [
                kind,
                len(own),
                f"{np.mean(both):.1%}",
                f"{np.mean(near):.1%}",
                f"{np.mean(far):.1%}",
                f"{np.mean(both < 0.9):.0%}",
                f"{ratio[0]:.2f}",
                f"{ratio[1]:.2f}",
            ]
        )
    print_table(
        [
            "cells",
            "number",
            "U holds",
            "in the measured ranges",
            "over the limits",
            "cells below 90 %",
            "error over stated, median, in the ranges",
            "over the limits",
        ],
        rows,
    )
    ratios = np.array([line["ratio"] for line in lines if line.get("ratio")], dtype=float)
    if len(ratios):
        agree = float(np.mean(np.abs(ratios - 1.0) <= LIKE))
        print(f"\nlinear within 5 % of Monte Carlo: {agree:.0%} of {len(ratios)} budgets")


def main() -> None:
    """Run cells, or print what was run."""
    parser = study_parser(__doc__)
    parser.add_argument("what", choices=("run", "table", "budgets"))
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--count", type=int, default=30, help="number of cells")
    parser.add_argument("--cache", type=Path, default=Path("uncertainty_cells.jsonl"))
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.count)
    if arguments.what == "run":
        run(seeds, arguments.cache)
    elif arguments.what == "budgets":
        budgets(seeds)
    else:
        table(arguments.cache)


if __name__ == "__main__":
    main()
