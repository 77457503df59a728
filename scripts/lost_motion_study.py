"""Lost motion of joints: whether it is found where there is some, and only there.

    python scripts/lost_motion_study.py 60
    python scripts/lost_motion_study.py 60 --program

Each run draws an arm with geometric errors of usual size, 40 poses in the order in which it goes to them, and points
with noise. The joints stop short of their readings by up to 0.05 to 5 mrad (``sign``), or by up to as much after a move
of a radian (``creep``), or not (``none``); in ``shuffled`` the signs are drawn at random, whatever the moves. The
displacement of the joints is computed here, by a loop over the rows, without calib's families.

Printed are how often a family of lost motion is chosen, and the error at other poses, in their own order, over that of
a fit that is told the true model: the mean of both, and how often it is beyond 1.1.

With ``--program``, arms of ``sign`` and ``creep`` run the commands of `calib.compensate` for 60 poses, one after the
other. Printed is the error of the tool, from the second row on, over that of commands by a result without the family.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from arms import load_arm
from studies import (
    add_noise,
    log_uniform,
    print_table,
    rms_length,
    run_cases,
    study_parser,
)

from calib.basics.arrays import Array
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.ranges import random_joint_values
from calib.verbs.compensate.compensate import compensate
from calib.verbs.compensate.robot_program import Program
from calib.verbs.simulate.truth import draw_truth

ARMS = ("ur5", "panda", "irb120", "iiwa")

#: Noise of a coordinate [m].
SIGMA = 5e-5

#: Range of the largest lost motion of a joint [rad], or of that after a move of a radian.
SIZES = (0.05e-3, 5e-3)

#: The same of arms that run programs: smaller ones do not matter to them.
LARGER = (0.3e-3, 5e-3)

#: Poses that are fitted, and others.
POSES, OTHER = 40, 200

#: The true model of each case.
CASES = {"sign": "dh+lost_motion", "creep": "dh+creep", "none": "dh", "shuffled": "dh"}


@dataclass(frozen=True)
class Outcome:
    """One arm."""

    chosen: bool  # Whether a family of lost motion was chosen
    use: str  # The verdict on the model that predicts
    error: float  # Of predictions at the other poses, rms [m]
    known: float  # The same of the fit that is told the true model [m]


def displaced(q: Array, sizes: Array, case: str, rng: np.random.Generator) -> Array:
    """Return the true joint values of an arm that goes through readings (N, m) [rad], one row after the other."""
    true: Array = q.copy()
    for i in range(1, len(q)):
        for k, size in enumerate(sizes):
            move = q[i, k] - q[i - 1, k]
            if case == "shuffled":
                true[i, k] -= size * rng.choice([-1.0, 1.0])
            elif case == "sign":
                true[i, k] -= size * (1.0 if move > 0.0 else -1.0)
            elif case == "creep":
                true[i, k] -= size * move
    return true


def run(case: str, seed: int) -> Outcome:
    """Draw an arm, measure it, and calibrate it."""
    rng = np.random.default_rng([seed, list(CASES).index(case)])
    robot = load_arm(ARMS[seed % len(ARMS)])
    cell = Cell(estimate_frame=bool(rng.integers(2)))
    truth = draw_truth(robot, "dh", {}, seed, cell=cell)
    sizes = log_uniform(rng, *SIZES) * rng.uniform(0.0, 1.0, len(robot.joint_names))
    q = random_joint_values(robot, POSES, seed + 1000)
    points = add_noise(truth.points(displaced(q, sizes, case, rng)), SIGMA, rng)
    table = Measurements(robot.joint_names, q, points)
    other = random_joint_values(robot, OTHER, seed + 2000)
    is_known = case in ("sign", "creep")  # what can be known of them
    true = truth.points(displaced(other, sizes, case, rng) if is_known else other)

    result = calibrate(robot, table, cell=cell)
    told = calibrate(robot, table, cell=cell, model=CASES[case], validate=False)

    def error(of: Calibration) -> float:
        """Return the error of its predictions at the other poses, rms [m]."""
        return rms_length(of.predict(other) - true)

    verdict = result.verdict_on(non_geometric=True)
    name = "" if result.non_geometric is None else result.non_geometric.name
    return Outcome(
        chosen="lost_motion" in name or "creep" in name,
        use="" if verdict is None else verdict.use,
        error=error(result),
        known=error(told),
    )


def run_program(case: str, seed: int) -> tuple[float, float]:
    """Let an arm run compensated commands; return the tool's errors with the family and without it, rms [m]."""
    rng = np.random.default_rng([seed, 7])
    robot = load_arm(ARMS[seed % len(ARMS)])
    truth = draw_truth(robot, "dh", {}, seed)
    sizes = log_uniform(rng, *LARGER) * rng.uniform(0.3, 1.0, len(robot.joint_names))
    q = random_joint_values(robot, POSES, seed + 3000)
    points = add_noise(truth.points(displaced(q, sizes, case, rng)), SIGMA, rng)
    table = Measurements(robot.joint_names, q, points)
    program = Program.of_joints(random_joint_values(robot, 60, seed + 4000))

    def error(model: str) -> float:
        """Return the error of commands by a model that is fitted, rms [m]."""
        result = calibrate(robot, table, model=model)
        commands = compensate(result, program, tool="", accept=True)
        run_q = np.where(np.isfinite(commands.q), commands.q, commands.q_nominal)
        reached = np.flatnonzero(np.isfinite(commands.q[:, 0]))
        away = truth.points(displaced(run_q, sizes, case, rng)) - commands.T_wanted[:, :3, 3]
        return rms_length(away[reached[reached > 0]])

    return error("auto"), error("dh")


def program_rows(runs: int, first: int, workers: int) -> Iterator[list[str]]:
    """Yield the figures of each case with lost motion."""
    seeds = range(first, first + runs)
    for case, errors in run_cases(run_program, ("sign", "creep"), seeds, workers=workers):
        found, without = np.array(errors).T
        ratios = found / without
        yield [
            case,
            f"{1e3 * found.mean():.4f}",
            f"{found.mean() / without.mean():.3f}",
            f"{np.median(ratios):.3f}",
            f"{ratios.max():.3f}",
        ]


def rows(runs: int, first: int, workers: int) -> Iterator[list[str]]:
    """Yield the figures of each case."""
    seeds = range(first, first + runs)
    for case, outcomes in run_cases(run, CASES, seeds, workers=workers):
        error = np.array([o.error for o in outcomes])
        known = np.array([o.known for o in outcomes])
        yield [
            case,
            f"{sum(o.chosen for o in outcomes)} of {runs}",
            f"{1e3 * error.mean():.4f}",
            f"{error.mean() / known.mean():.3f}",
            f"{np.exp(np.median(np.log(error / known))):.3f}",
            f"{int(np.sum(error > 1.1 * known))} of {runs}",
            f"{sum(o.use == 'use' for o in outcomes)} of {runs}",
        ]


def main() -> None:
    """Run the study and print its table."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("runs", type=int, nargs="?", default=60)
    parser.add_argument("--seed", type=int, default=0, help="the first seed")
    parser.add_argument("--program", action="store_true", help="compensated commands instead")
    given = parser.parse_args()
    if given.program:
        of_programs = ("case", "error [mm]", "over that without", "median", "largest")
        print_table(of_programs, program_rows(given.runs, given.seed, given.workers))
    else:
        header = ("case", "chosen", "error [mm]", "over known", "median", "beyond 1.1", "use")
        print_table(header, rows(given.runs, given.seed, given.workers))


if __name__ == "__main__":
    main()
