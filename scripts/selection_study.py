"""Models that `auto` chooses against fixed models, and its treatment of gravity and of geometries.

    python scripts/selection_study.py truths 32 12 30
    python scripts/selection_study.py gravity 200
    python scripts/selection_study.py geometry 400 1000

``truths RUNS [POINTS ...]`` draws so many robots of each arm and each truth, from no errors to errors of all families,
for each number of points. Printed is the mean error at other poses of the model that `auto` chooses, over that of the
fixed model whose mean is the least.

``gravity RUNS`` draws arms with compliance and masses whose URDFs have none. Printed is the error of `auto` over that
of a fit that knows masses, payload and structure; and the same of stiff arms.

``geometry RUNS [SEED]`` draws robots whose families err by widely different amounts, half of them also by errors that
no model holds. Printed is the error of the geometry of `auto` over that of the geometry of the highest evidence.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from arms import load_arm, without_masses
from numpy.typing import NDArray
from studies import (
    add_noise,
    draw_seed,
    joint_values_around,
    log_uniform,
    print_table,
    rms_length,
    run_cases,
    run_jobs,
    study_parser,
)

from calib.basics.arrays import Array
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.selection.row_weights import with_better_weights
from calib.model.families import FAMILIES
from calib.model.kinematics import Samples
from calib.result.table_fits import fit_table
from calib.robot.gravity import Payload, gravity_loads
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.simulate.truth import Truth, draw_truth

ARMS = ("ur5", "panda")

#: Noise of a coordinate, where it is not drawn [m].
SIGMA = 5e-5

#: Poses at which predictions are compared with the truth.
OTHER = 400

#: Models of the errors of `truths`, by their title.
TRUTHS = {
    "nothing": "frames",
    "zeros": "zeros",
    "dh": "dh",
    "dh, eccentricity": "dh+eccentricity",
    "dh, compliance": "dh+compliance",
    "all": "placement+gain+eccentricity+compliance",
}

#: Numbers of points of `truths`.
COUNTS = (12, 30, 60, 300)

#: Models that `auto` is compared with. Gravity is fitted without masses, as compliance needs them.
FIXED = (
    "frames",
    "zeros",
    "dh",
    "placement",
    "zeros+eccentricity",
    "zeros+gravity",
    "dh+gain",
    "dh+eccentricity",
    "dh+gravity",
    "dh+eccentricity+gravity",
    "placement+gain+eccentricity+gravity",
)

#: Numbers of points of `gravity`.
GRAVITY_COUNTS = (40, 60, 100, 200)

#: Models of the errors of stiff arms of `gravity`, by turns.
STIFF = ("dh", "dh+eccentricity", "zeros+gain")

#: Models of the errors of `geometry`.
GEOMETRY_TRUTHS = (
    "frames",
    "zeros",
    "dh",
    "placement",
    "dh+gain",
    "dh+eccentricity",
    "placement+gravity",
)

#: Range of the standard deviation of a family's errors over its typical one.
SIZES = (0.05, 5.0)

#: Range of the amplitude of errors of joint angles that no model holds [rad].
UNMODELLED = (1e-5, 3e-3)

#: Range of the noise of `geometry` [m].
SIGMAS = (1e-5, 1e-3)

#: Shares of the joint ranges in which the poses of `geometry` are.
SHARES = (1.0, 0.5, 0.2)

#: Numbers of points of `geometry`.
GEOMETRY_COUNTS = (8, 10, 12, 15, 20, 30, 50, 100)


@dataclass(frozen=True)
class Table:
    """Points of a robot whose true errors are known."""

    robot: Robot  # As calib is given it
    cell: Cell
    measurements: Measurements
    q: Array  # shape (OTHER, m), other poses [rad]
    true: Array  # shape (OTHER, 3), true positions of the target at these [m]

    def error(self, fitted: Fitted) -> float:
        """Return the error of predictions at the other poses, rms [m]."""
        load = gravity_loads(self.robot, self.q, self.cell.payload)
        predicted = fitted.kinematics.points(fitted.estimate.x, Samples.at(self.q, load))
        return rms_length(predicted - self.true)

    def fit(self, model: str) -> Fitted:
        """Fit a model; return its non-geometric fit where it has one, for this predicts best."""
        fits = fit_table(self.robot, self.measurements, self.cell, model=model)
        return fits.non_geometric or fits.geometry


def measure(truth: Truth, cell: Cell, count: int, seed: int) -> Table:
    """Measure a robot at random poses.

    Args:
        truth: The robot.
        cell: What calib is given.
        count: Number of points.
        seed: Of the random numbers.
    """
    robot = truth.nominal
    rng = np.random.default_rng([seed, count])
    q = random_joint_values(robot, count, seed + 1000)
    points = add_noise(truth.points(q), SIGMA, rng)
    other = random_joint_values(robot, OTHER, 99)
    measurements = Measurements(robot.joint_names, q, points)
    return Table(robot, cell, measurements, other, truth.points(other))


# truths


def table_of_truth(arm: str, true_model: str, count: int, seed: int) -> Table:
    """Draw a robot and measure it.

    Args:
        arm: Name of the arm.
        true_model: Model of its errors.
        count: Number of points.
        seed: Of the random numbers; the measurement frame is known if it is even.
    """
    robot = load_arm(arm)
    rng = np.random.default_rng([seed, count])
    cell = Cell(estimate_frame=bool(seed % 2), payload=Payload(2.0, np.array([0.0, 0.0, 0.05])))
    std = None
    if true_model != "frames":
        std = {"compliance": 10.0 ** rng.uniform(-5.0, -4.0)}
    table = measure(draw_truth(robot, true_model, std, seed, cell=cell), cell, count, seed)
    if true_model.endswith("compliance"):
        # The fit knows neither the masses nor the payload.
        table = replace(table, robot=without_masses(robot), cell=replace(cell, payload=None))
    return table


def errors_by_model(table: Table) -> dict[str, float]:
    """Return the error of `auto` and of each fixed model, rms [m]."""
    auto = fit_table(table.robot, table.measurements, table.cell, model="auto")
    errors = {"auto": table.error(auto.non_geometric or auto.geometry)}
    task = replace(auto.geometry.task, allow_absent=True)
    rows = auto.geometry.estimate.problem.rows
    for model in FIXED:
        errors[model] = table.error(fit(replace(task, model=model), rows))
    return errors


def run_truth(case: tuple[str, int], run: tuple[str, int]) -> dict[str, float]:
    """Return the errors by model of a truth's title and number of points, for an arm and seed."""
    title, count = case
    arm, seed = run
    return errors_by_model(table_of_truth(arm, TRUTHS[title], count, seed))


def truth_rows(runs: int, counts: Sequence[int], workers: int) -> Iterator[list[str]]:
    """Yield the error of `auto` over that of the best fixed model, for each truth and number of points."""
    cases = product(TRUTHS, counts or COUNTS)
    robots = list(product(ARMS, range(runs)))
    for (title, count), errors in run_cases(run_truth, cases, robots, workers=workers):
        mean = {model: float(np.mean([e[model] for e in errors])) for model in errors[0]}
        auto = mean.pop("auto")
        best = min(mean, key=mean.__getitem__)
        yield [title, str(count), f"{1e3 * auto:.4f}", f"{auto / mean[best]:.3f}", best]


# gravity


def run_gravity(case: tuple[bool, str], seed: int) -> tuple[float, float]:
    """Fit an arm without masses by `auto`, and with them by its true model.

    Args:
        case: If the arm is compliant; its name.
        seed: Of the random numbers.

    Returns:
        Error of `auto` and of the true model at other poses, rms [m].
    """
    compliant, arm = case
    robot = load_arm(arm)
    rng = np.random.default_rng([seed, len(arm)])
    count = int(rng.choice(GRAVITY_COUNTS))
    cell = Cell(estimate_frame=bool(rng.integers(2)))
    compliance = 10.0 ** rng.uniform(-5.0, -4.0)
    compliances = compliance * rng.uniform(0.5, 1.5, len(robot.joints))
    model = STIFF[seed % 3]
    errors = None
    if compliant:
        model = "dh+compliance"
        names = (f"{joint.name}.compliance" for joint in robot.joints)
        errors = dict(zip(names, compliances, strict=True))
    truth = draw_truth(robot, model, {}, seed, cell=cell, errors=errors)
    table = measure(truth, cell, count, seed)
    bare = replace(table, robot=without_masses(robot))
    return bare.error(bare.fit("auto")), table.error(table.fit(model))


def gravity_rows(runs: int, workers: int) -> Iterator[list[str]]:
    """Yield the error of `auto` over that of the true model, for each arm."""
    cases = product((True, False), (*ARMS, "irb120"))
    for (compliant, arm), errors in run_cases(run_gravity, cases, range(runs), workers=workers):
        auto, known = np.array(errors).T
        logs = np.log(auto / known)
        yield [
            "compliant" if compliant else "stiff",
            arm,
            f"{np.mean(auto) / np.mean(known):.3f}",
            f"{np.exp(logs.mean()):.3f} +- {logs.std() / np.sqrt(runs):.3f}",
            f"{np.exp(np.median(logs)):.3f}",
        ]


# geometry


@dataclass(frozen=True)
class Harmonics:
    """Errors of joint angles that no model holds: dq = amplitude sin(order q + phase)."""

    amplitude: float  # [rad]
    order: NDArray[np.int_]  # shape (m,)
    phase: Array  # shape (m,), [rad]

    @classmethod
    def draw(cls, joints: int, rng: np.random.Generator) -> Harmonics:
        """Draw the errors of so many joints; half of the robots have none."""
        amplitude = log_uniform(rng, *UNMODELLED) * bool(rng.integers(2))
        order = rng.integers(2, 6, joints)
        return cls(amplitude, order, rng.uniform(0.0, 2.0 * np.pi, joints))

    def reached(self, q: Array) -> Array:
        """Return the true joint values where q is read, shape (N, m) each, [rad]."""
        return np.asarray(q + self.amplitude * np.sin(self.order * q + self.phase))


def drawn_widely(seed: int) -> tuple[str, Table]:
    """Draw a robot whose families err by widely different amounts, and measure it in a part of its joint ranges.

    Args:
        seed: Of the random numbers.

    Returns:
        The geometry in which it errs, and the table.
    """
    rng = np.random.default_rng([23, seed])
    arm = str(rng.choice(ARMS))
    true_model = str(rng.choice(GEOMETRY_TRUTHS))
    robot = load_arm(arm)
    cell = Cell(estimate_frame=bool(rng.integers(2)))
    std = {name: row.typical * log_uniform(rng, *SIZES) for name, row in FAMILIES.items()}
    sizes = None if true_model == "frames" else std
    truth = draw_truth(robot, true_model, sizes, draw_seed(rng), cell=cell)

    harmonics = Harmonics.draw(len(robot.joint_names), rng)
    centre = random_joint_values(robot, 1, draw_seed(rng))
    share = float(rng.choice(SHARES))
    count = int(rng.choice(GEOMETRY_COUNTS))
    q = joint_values_around(centre, share, robot, count, draw_seed(rng))
    other = joint_values_around(centre, share, robot, OTHER, 98)
    points = add_noise(truth.points(harmonics.reached(q)), log_uniform(rng, *SIGMAS), rng)
    measurements = Measurements(robot.joint_names, q, points)
    true = truth.points(harmonics.reached(other))
    return true_model.split("+")[0], Table(robot, cell, measurements, other, true)


def run_geometry(seed: int) -> tuple[str, int, float]:
    """Fit a robot of `drawn_widely` by the geometry of `auto` and by that of the highest evidence.

    Returns:
        The geometry in which it errs, the number of points, and the error of the first fit over that of the second.
    """
    geometry, table = drawn_widely(seed)
    count = len(table.measurements)
    fits = fit_table(table.robot, table.measurements, table.cell, model="auto")
    geometries = [candidate for candidate in fits.candidates if "+" not in candidate.name]
    likeliest = max(geometries, key=lambda candidate: candidate.evidence).name
    if likeliest == fits.geometry.task.model:
        return geometry, count, 1.0
    rows = fits.geometry.estimate.problem.rows
    likeliest_fit = fit(replace(fits.geometry.task, model=likeliest), rows)
    reference = fits.non_geometric or fits.geometry
    error = table.error(with_better_weights(likeliest_fit, rows, reference))
    return geometry, count, table.error(fits.geometry) / error


def geometry_rows(runs: int, first: int, workers: int) -> Iterator[list[str]]:
    """Yield the ratio of the errors, for all robots, each true geometry, few points and many."""
    seeds = [(seed,) for seed in range(first, first + runs)]
    ratios = defaultdict(list)
    for geometry, count, ratio in run_jobs(run_geometry, seeds, workers=workers):
        many = "below 16 poses" if count < 16 else "16 poses and more"
        for group in ("all", geometry, many):
            ratios[group].append(ratio)
    for group, of_group in ratios.items():
        logs = np.log(of_group)
        yield [
            group,
            str(len(logs)),
            f"{np.exp(logs.mean()):.4f}",
            str(np.sum(logs != 0.0)),
            str(np.sum(logs < -0.01)),
            str(np.sum(logs > 0.01)),
        ]


def main() -> None:
    """Print one of the three tables."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("part", choices=["truths", "gravity", "geometry"])
    parser.add_argument("runs", type=int, metavar="RUNS")
    parser.add_argument("numbers", type=int, nargs="*", metavar="POINTS or SEED")
    arguments = parser.parse_args()
    runs, numbers, workers = arguments.runs, arguments.numbers, arguments.workers
    if arguments.part == "truths":
        titles = ["errors", "points", "auto [mm]", "over the best", "which is"]
        print_table(titles, truth_rows(runs, numbers, workers), [18, 6])
    elif arguments.part == "gravity":
        titles = ["joints", "arm", "ratio of means", "geometric mean", "median"]
        print_table(titles, gravity_rows(runs, workers), [9, 7])
    else:
        first = numbers[0] if numbers else 0
        titles = ["robots", "number", "ratio", "another geometry", "better by 1 %", "worse by 1 %"]
        print_table(titles, geometry_rows(runs, first, workers), [18])


if __name__ == "__main__":
    main()
