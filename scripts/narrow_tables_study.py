"""Verdicts on tables that tell of a part of the workspace, or of a moving arm: what they say is too good elsewhere.

    python scripts/narrow_tables_study.py 3 [FIRST]

Each case is measured on three arms with as many seeds. Printed are the true errors of the nominal and the corrected
URDF near the fitted rows and over the joint limits, without noise and with the target registered to them, and the frame
where it is unknown; what the result says of both; and the verdict. `good` cases have nothing wrong with them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from arms import load_arm
from studies import (
    add_noise,
    draw_seed,
    joint_values_around,
    print_table,
    run_jobs,
    study_parser,
    verdict_of,
)

from calib.basics.arrays import Array
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.result.calibrate import calibrate
from calib.robot.ranges import column_ranges, random_joint_values
from calib.robot.robot import Robot
from calib.verbs.evaluate.evaluation import evaluate
from calib.verbs.simulate.truth import Truth, draw_truth

#: Arms that each case is measured on.
ARMS = ("ur5", "panda", "iiwa")

#: Noise of a coordinate [m].
NOISE = 5e-5

#: Delay of the joint values of a moving arm [s].
DELAY = 0.02

#: Time between two rows of a moving arm [s].
PERIOD = 0.2

#: Range of the frequencies at which the joints of a moving arm swing [Hz].
FREQUENCIES = (0.03, 0.12)

#: Amplitude with which they swing, as a share of half of each joint's range.
AMPLITUDE = 0.35

#: Share of the joint ranges that a corner of the workspace is.
CORNER = 0.12

#: Distance by which the rows of one posture are wrong [m].
WRONG = 8e-3

#: Poses at which a URDF is evaluated.
FRESH = 400

Rows = Callable[[Robot, np.random.Generator], tuple[Array, Array, Array]]


def everywhere(robot: Robot, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Return joint values all over the joint limits: those in the table, those measured, and others near."""
    q = random_joint_values(robot, 40, draw_seed(rng))
    return q, q, random_joint_values(robot, FRESH, draw_seed(rng))


def in_a_corner(robot: Robot, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Return joint values in a corner of the workspace."""
    centre = random_joint_values(robot, 1, draw_seed(rng))
    q = joint_values_around(centre, CORNER, robot, 30, draw_seed(rng))
    return q, q, joint_values_around(centre, CORNER, robot, FRESH, draw_seed(rng))


def with_a_posture(robot: Robot, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Return joint values in a corner of the workspace, the last of them elsewhere."""
    q, _, near = in_a_corner(robot, rng)
    q[-1:] = random_joint_values(robot, 1, draw_seed(rng))
    return q, q, near


def swinging(delay: float, count: int) -> Rows:
    """Return the joint values of a moving arm, which come late [s]."""

    def rows(robot: Robot, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        low, high = column_ranges(robot).T
        frequency = rng.uniform(*FREQUENCIES, size=len(low))
        phase = rng.uniform(0.0, 2.0 * np.pi, size=len(low))
        middle = 0.5 * (low + high) + 0.2 * (high - low) * rng.uniform(-1.0, 1.0, size=len(low))

        def at(t: Array) -> Array:
            """Return the joint values at times t [s]."""
            swing = np.sin(2.0 * np.pi * frequency * t[:, None] + phase)
            swung: Array = middle + AMPLITUDE * 0.5 * (high - low) * swing
            return swung

        t: Array = PERIOD * np.arange(count, dtype=np.float64)
        near = np.linspace(0.0, float(t[-1]), FRESH, dtype=np.float64)
        return at(t - delay), at(t), at(near)

    return rows


@dataclass(frozen=True)
class Case:
    """A kind of table."""

    rows: Rows
    model: str  # Of the true errors
    sizes: Mapping[str, float]  # Standard deviations of the errors, where they are not typical
    wrong: int = 0  # Number of last rows that are wrong
    swapped: bool = False  # Two joint columns are exchanged


GEOMETRY: dict[str, float] = {}
SMALL = {"length": 1e-4, "angle": 3e-4, "zero": 5e-4}
ECCENTRIC = SMALL | {"eccentricity": 2e-3}

CASES = {
    "late": Case(swinging(DELAY, 100), "placement", GEOMETRY),
    "late small": Case(swinging(DELAY, 100), "placement", SMALL),
    "late short": Case(swinging(DELAY, 40), "placement", SMALL),
    "eccentric corner": Case(in_a_corner, "placement+eccentricity", ECCENTRIC),
    "swapped corner": Case(in_a_corner, "placement", GEOMETRY, swapped=True),
    "path": Case(swinging(0.0, 30), "placement+eccentricity", {}),
    "path eccentric": Case(swinging(0.0, 30), "placement+eccentricity", ECCENTRIC),
    "posture": Case(with_a_posture, "placement", GEOMETRY, wrong=1),
    "posture small": Case(with_a_posture, "placement", SMALL, wrong=1),
    "good path": Case(swinging(0.0, 100), "placement", GEOMETRY),
    "good corner": Case(in_a_corner, "placement", GEOMETRY),
    "good": Case(everywhere, "placement", GEOMETRY),
    "good eccentric": Case(everywhere, "placement+eccentricity", {}),
}

TITLES = (
    "case",
    "arm",
    "seed",
    "near",
    "said",
    "limits",
    "said",
    "verdict",
    "reasons",
    "largest",
    "sizes",
)


def error(robot: Robot, truth: Truth, cell: Cell, q: Array) -> float:
    """Return the error of a robot at joint values without noise, rms [mm]."""
    table = Measurements(truth.nominal.joint_names, q, truth.points(q))
    return 1e3 * evaluate(robot, table, cell).errors["all"]["m"].rms


def row(name: str, arm: str, seed: int) -> list[str]:
    """Measure, calibrate and evaluate a case."""
    case, robot = CASES[name], load_arm(arm)
    rng = np.random.default_rng([44, seed])
    truth = draw_truth(robot, case.model, case.sizes, draw_seed(rng), cell=Cell())
    in_table, measured, near = case.rows(robot, rng)
    points = add_noise(truth.points(measured), NOISE, rng)
    if case.wrong:
        turn = rng.normal(size=3)
        points[-case.wrong :] += WRONG * turn / np.linalg.norm(turn)
    if case.swapped:
        in_table = in_table[:, [0, 2, 1, *range(3, in_table.shape[1])]]
    cell = Cell(estimate_frame=seed % 2 == 1)
    result = calibrate(robot, Measurements(robot.joint_names, in_table, points), cell=cell)
    verdict = verdict_of(result)
    q = random_joint_values(robot, FRESH, 99)
    errors = {
        key: (error(robot, truth, cell, values), error(result.robot, truth, cell, values))
        for key, values in (("near", near), ("limits", q))
    }
    said = [1e3 * value for value in result.new_point]
    codes = ", ".join(reason.code for reason in verdict.reasons[:4])
    x = np.abs(result.geometry.x[result.geometry.model.of_robot])
    sizes = " ".join(f"{k}:{1e3 * v:.2g}" for k, v in result.geometry.prior_std.items())
    sizes += f" f{result.geometry.extrapolation:.1f} u{1e3 * result.geometry.untold:.2f}"
    return [
        name,
        arm,
        str(seed),
        "{:.2f} -> {:.2f}".format(*errors["near"]),
        f"{said[0]:.2f}",
        "{:.2f} -> {:.2f}".format(*errors["limits"]),
        f"{said[1]:.2f}",
        verdict.use,
        codes,
        f"{1e3 * x.max():.1f}",
        sizes,
    ]


def main() -> None:
    """Print a row for each table."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("count", type=int, metavar="COUNT")
    parser.add_argument("first", type=int, nargs="?", default=0, metavar="FIRST", help="seed")
    parser.add_argument("--only", default="", help="cases that begin so")
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.count)
    jobs = [
        (name, arm, seed)
        for name in CASES
        for arm in ARMS
        for seed in seeds
        if name.startswith(arguments.only)
    ]
    print_table(TITLES, run_jobs(row, jobs, workers=arguments.workers), [16, 5, 4])


if __name__ == "__main__":
    main()
