"""Verdicts of cells at the edges of what a verdict can know: the base has moved, the target is elsewhere, a gain errs.

    python scripts/edges_study.py [SEEDS] [NAME ...] [--first SEED]

Each case has typical errors of the geometry besides, and is measured with three arms at so many seeds. Printed are the
held-out errors before and after; the true ones of the nominal and the corrected URDF over the joint limits, without
noise and with the target registered to them, beside the expected one; the verdict and its reasons, ``+`` where the
first reason is one of the case's own. A URDF that is `use` has to be better by a fifth. Besides a scale error, which
nothing can show, only a lag that was modelled may get that verdict, and that is stated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import product, tee

import numpy as np
from arms import load_arm
from scipy.spatial.transform import Rotation
from studies import (
    add_noise,
    print_table,
    run_jobs,
    study_parser,
    unchanged,
    verdict_of,
    verdict_text,
)
from verdict_study import urdf_error

from calib.basics.arrays import Array
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import USE
from calib.numerics.geometry import pose_of
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.simulate.truth import Truth, draw_truth

ARMS = ("ur3", "ur5", "panda")

#: Rows of a table, of which each fourth is for validation.
ROWS = 40

#: Noise of a coordinate [m].
NOISE = 5e-5

#: A URDF is worth using if no more than this share of the nominal one's error remains.
BETTER = 0.8

TITLES = ("case", "arm", "seed", "held-out [mm]", "true [mm]", "said", "model", "right", "verdict")
WIDTHS = (32, 5, 4, 16, 16, 6, 20, 5)


def no_errors(robot: Robot) -> dict[str, float]:  # noqa: ARG001  one of several functions
    """Return no error."""
    return {}


def at_known_frame(rng: np.random.Generator) -> Array:  # noqa: ARG001  one of several functions
    """Return the pose of a base that stands where the known frame says."""
    return np.eye(4)


@dataclass(frozen=True)
class Edge:
    """A case: errors of the robot, of the table, and of what calib is given."""

    codes: tuple[str, ...]  # Reasons of which one comes first in a right verdict
    stated: tuple[str, ...] = ()  # Reasons of which one has to be among all; none: any
    model: str = "dh"  # Model of the robot's errors
    std: dict[str, float] = field(
        default_factory=dict
    )  # Their standard deviations by family; else typical ones
    errors: Callable[[Robot], dict[str, float]] = no_errors  # Values of single errors by name
    reached: Callable[[Array], Array] = (
        unchanged  # Joint values read, (N, m) -> those that the arm had
    )
    read: Callable[[Array], Array] = unchanged  # Joint values read, (N, m) -> those in the table
    base: Callable[[np.random.Generator], Array] = (
        at_known_frame  # True pose of the base in the frame, (4, 4) [m]
    )
    scale: float = 1.0  # Measured positions over true ones
    given: Callable[[Array, np.random.Generator], Array] | None = (
        None  # True target, (3,) [m] -> the given one
    )
    cell: Cell = field(default_factory=Cell)


def third_gain(robot: Robot) -> dict[str, float]:
    """Return a gain of 1 % of the third joint."""
    return {f"{robot.joint_names[2]}.gain": 0.01}


def displaced_base(
    length: float = 0.0, angle: float = 0.0
) -> Callable[[np.random.Generator], Array]:
    """Return a function that draws the pose of a base displaced by a length [m] and turned by an angle [rad]."""

    def draw(rng: np.random.Generator) -> Array:
        vectors = rng.normal(size=(2, 3))
        direction, axis = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
        return pose_of(length * direction, Rotation.from_rotvec(angle * axis).as_matrix())

    return draw


def lagging(share: float) -> Callable[[Array], Array]:
    """Return a function to joint values that miss a share of the last move."""
    return lambda q: q - share * np.diff(q, axis=0, prepend=q[:1])


def displaced_target(length: float) -> Callable[[Array, np.random.Generator], Array]:
    """Return a function that draws a target at a distance [m] from the true one."""

    def draw(target: Array, rng: np.random.Generator) -> Array:
        direction = rng.normal(size=3)
        return np.asarray(target + length * direction / np.linalg.norm(direction))

    return draw


def last_turned(q: Array) -> Array:
    """Return joint values with the other sign of the last joint."""
    last = np.arange(q.shape[1]) == q.shape[1] - 1
    return np.asarray(q * np.where(last, -1.0, 1.0))


#: Reasons that state that the geometry leaves errors.
GEOMETRY_LEAVES = (
    "no_urdf_holds",
    "much_remains",
    "noise_large",
    "unknown_elsewhere",
    "no_better",
    "validation_no_better",
)

#: Reasons where the scale is wrong and nothing is said of it: it cannot be shown, is as large as it may be, or is seen.
OF_SCALE = ("gain", "scale_hidden", "lengths_scaled")

EDGES = {
    "eccentricity of 5 mrad": Edge(
        GEOMETRY_LEAVES, model="dh+eccentricity", std={"eccentricity": 5e-3}
    ),
    "one gain 1 % off": Edge(
        GEOMETRY_LEAVES, model="dh+gain", std={"gain": 0.0}, errors=third_gain
    ),
    "zeros alone": Edge((*GEOMETRY_LEAVES, "model_lacks"), cell=Cell(model="zeros")),
    "lag of 0.1 %": Edge(
        (*GEOMETRY_LEAVES, "gain"), stated=("creeps", "joints_lag"), reached=lagging(1e-3)
    ),
    "gains of 5e-3": Edge(GEOMETRY_LEAVES, model="dh+gain", std={"gain": 5e-3}),
    "gains of 5e-3 alone": Edge(GEOMETRY_LEAVES, model="frames+gain", std={"gain": 5e-3}),
    "base 10 mm off": Edge(("base_moved",), base=displaced_base(10e-3)),
    "base 5 mm off": Edge(("base_moved",), base=displaced_base(5e-3)),
    "base 1 deg off": Edge(("base_moved",), base=displaced_base(angle=np.radians(1.0))),
    "base 2 deg off": Edge(("base_moved",), base=displaced_base(angle=np.radians(2.0))),
    "target 280 mm off": Edge(("target_far",), given=displaced_target(0.28)),
    "last joint turned": Edge(("joints_turned", "joint_zero"), read=last_turned),
    "last joint turned, target given": Edge(
        ("joints_turned", "joint_zero"), read=last_turned, given=displaced_target(1e-3)
    ),
    "scale 0.1 %": Edge(OF_SCALE, scale=1.001),
    "scale 0.2 %": Edge(OF_SCALE, scale=1.002),
}


def calibrate_case(name: str, arm: str, seed: int) -> tuple[Calibration, Truth]:
    """Draw, measure and calibrate one table of a case."""
    edge = EDGES[name]
    robot = load_arm(arm)
    truth = draw_truth(robot, edge.model, edge.std, seed, errors=edge.errors(robot))
    rng = np.random.default_rng([11, seed])
    q = random_joint_values(robot, ROWS, seed + 50)
    T_frame_base = edge.base(rng)
    true = truth.points(edge.reached(q)) @ T_frame_base[:3, :3].T + T_frame_base[:3, 3]
    points = add_noise(edge.scale * true, NOISE, rng)
    sets = tuple("validate" if row % 4 == 3 else "estimate" for row in range(ROWS))
    cell = edge.cell
    if edge.given is not None:
        cell = replace(cell, target=edge.given(truth.T_tip_target[0, :3, 3], rng))
    table = Measurements(robot.joint_names, edge.read(q), points, sets=sets)
    return calibrate(robot, table, cell=cell), truth


def case_row(name: str, arm: str, seed: int) -> list[str]:
    """Return the row of one table."""
    edge, (result, truth) = EDGES[name], calibrate_case(name, arm, seed)
    validations = (result.trust.nominal_cross_validation, result.cross_validation)
    errors = [v.errors_without_outliers["m"].rms for v in validations if v is not None]
    true = [urdf_error(one, truth, Cell()) for one in (load_arm(arm), result.robot)]
    verdict = verdict_of(result)
    codes = [reason.code for reason in verdict.reasons]
    is_right = codes[0] in edge.codes and (not edge.stated or bool({*edge.stated} & {*codes}))
    if verdict.use == USE and true[1] > BETTER * true[0]:
        is_right = False
    return [
        name,
        arm,
        str(seed),
        " -> ".join(f"{1e3 * error:.3f}" for error in errors),
        " -> ".join(f"{1e3 * error:.3f}" for error in true),
        f"{1e3 * result.new_point[1]:.2f}",
        result.non_geometric.name if result.non_geometric else "-",
        "+" if is_right else "?",
        verdict_text(result),
    ]


def main() -> None:
    """Print a row for each table, how many are `use`, and how many verdicts are right."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("seeds", type=int, nargs="?", default=1, metavar="SEEDS")
    parser.add_argument("names", nargs="*", metavar="NAME", help="cases; all of them by default")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="first of the seeds")
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    jobs = list(product(arguments.names or EDGES, ARMS, seeds))
    printed, counted = tee(run_jobs(case_row, jobs, workers=arguments.workers, label="tables"))
    print_table(TITLES, printed, WIDTHS)
    rows = list(counted)
    used = sum(row[-1].startswith(f"{USE}:") for row in rows)
    right = sum(row[-2] == "+" for row in rows)
    print(f"\n{USE}: {used} of {len(jobs)}; right: {right}")


if __name__ == "__main__":
    main()
