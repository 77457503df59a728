"""Verdicts that once were wrong: tables of which each has a right verdict and a right first reason.

    python scripts/wrong_verdicts_study.py [FIRST] [--only NAME]

Each case is measured with three arms, from the seed FIRST on. Printed are the verdict and its first reason, whether
both are right, and the true errors of the nominal and the corrected URDF, without noise and with the target registered
to them (and the frame where it is unknown), near the fitted rows and over the joint limits, beside what the result says
of both; then those of a non-geometric model, near the rows. `use` is right as well of a table that tells of a part of
the workspace, if the error over the joint limits is halved and no more than twice what is said.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import tee

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
from calib.diagnosis.reasons import CARE, NO, USE, Why
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.ranges import column_ranges, random_joint_values
from calib.robot.robot import Robot
from calib.verbs.evaluate.evaluation import evaluate
from calib.verbs.simulate.truth import Truth, draw_truth

#: Arms that each case is measured on.
ARMS = ("ur5", "panda", "iiwa")

#: Arms measured with the URDF of another variant.
VARIANTS = {"ur5": ("ur3", "ur3e"), "panda": ("ur5", "ur5e"), "iiwa": ("ur10e", "ur10")}

#: Noise of a coordinate [m].
NOISE = 5e-5

#: Number of rows of a table.
ROWS = 40

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

#: Distance by which the row of one posture is wrong [m].
WRONG = 8e-3

#: Size of a gross error [m]; each twentieth row has one.
GROSS = 5e-3

#: Poses at which a URDF is evaluated.
FRESH = 400

#: Joint values in the table, those measured, and others near.
Rows = Callable[[Robot, np.random.Generator], tuple[Array, Array, Array]]

TITLES = (
    "case",
    "arm",
    "seed",
    "right",
    "verdict",
    "first reason",
    "near",
    "said",
    "limits",
    "said",
)
WIDTHS = (24, 5, 4, 5, 13, 21)


def everywhere(robot: Robot, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Draw joint values all over the joint limits."""
    q = random_joint_values(robot, ROWS, draw_seed(rng))
    return q, q, random_joint_values(robot, FRESH, draw_seed(rng))


def in_a_corner(robot: Robot, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Draw joint values in a corner of the workspace."""
    centre = random_joint_values(robot, 1, draw_seed(rng))
    q = joint_values_around(centre, CORNER, robot, 30, draw_seed(rng))
    return q, q, joint_values_around(centre, CORNER, robot, FRESH, draw_seed(rng))


def with_a_posture(robot: Robot, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Draw joint values in a corner of the workspace, the last of them elsewhere."""
    q, _, near = in_a_corner(robot, rng)
    q[-1:] = random_joint_values(robot, 1, draw_seed(rng))
    return q, q, near


def with_exchanged_columns(robot: Robot, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Draw joint values in a corner of the workspace, two columns of them exchanged in the table."""
    q, _, near = in_a_corner(robot, rng)
    return q[:, [0, 2, 1, *range(3, q.shape[1])]], q, near


def swinging(delay: float, count: int) -> Rows:
    """Return a function that draws the joint values of a moving arm, which come late [s]."""

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


#: Changes measured points, (N, 3) [m], of which some are displaced along unit vectors, (N, 3).
Change = Callable[[Array, Array], Array]


def displaced(chosen: slice, size: float) -> Change:
    """Return a function that displaces some rows by a length [m]."""

    def change(points: Array, directions: Array) -> Array:
        points = points.copy()
        points[chosen] += size * directions[chosen]
        return points

    return change


def unchanged(points: Array, _directions: Array) -> Array:
    """Return the points as they are."""
    return points


def rounded(points: Array, _directions: Array) -> Array:
    """Round points to 0.01 mm."""
    return np.asarray(1e-5 * np.round(points / 1e-5))


# What comes first has to be true, and tell what to do.
VALIDATION = slice(3, None, 4)
SMALL = {"length": 1e-4, "angle": 3e-4, "zero": 5e-4}
ECCENTRIC = {**SMALL, "eccentricity": 2e-3}
NARROW = (Why.UNKNOWN_ELSEWHERE, Why.CORNER, Why.JOINTS_STILL, Why.SMALL_GAIN)
ALONE = (Why.SOLE_POSTURE, Why.UNKNOWN_ELSEWHERE)
LATE = (Why.JOINTS_LATE,)
REMAINS = (Why.MUCH_REMAINS, Why.NO_URDF_HOLDS, Why.NO_BETTER)
SOUND = (Why.GAIN,)


@dataclass(frozen=True)
class Case:
    """A kind of table, and the right verdict on it."""

    rows: Rows
    right: tuple[str, ...]  # Verdicts
    reasons: tuple[Why, ...]  # Of which one comes first
    model: str = "placement"  # Of the true errors
    sizes: Mapping[str, float] = field(default_factory=dict)  # Of these, where not typical
    change: Change = unchanged
    noise: float = NOISE
    stated: float | None = None  # Noise as the cell states it [m]
    named: tuple[Why, ...] = ()  # Reasons that have to be among all
    validated: bool = False  # Each fourth row is for validation
    other: bool = False  # The URDF is that of another variant of the arm
    in_part: bool = False  # The rows tell of a part of the workspace
    frame: bool | None = None  # The frame is unknown; None: in each second table


UNSURE = (CARE, NO)
CASES = {
    "a late": Case(swinging(DELAY, 100), UNSURE, LATE),
    "a late, small errors": Case(swinging(DELAY, 100), UNSURE, LATE, sizes=SMALL),
    "a late, few rows": Case(swinging(DELAY, 40), UNSURE, LATE, sizes=SMALL),
    "b eccentric corner": Case(
        in_a_corner, UNSURE, NARROW, "placement+eccentricity", ECCENTRIC, in_part=True
    ),
    "c validation 420 mm off": Case(
        everywhere,
        (NO,),
        (Why.VALIDATION_UNLIKE,),
        change=displaced(VALIDATION, 0.42),
        validated=True,
    ),
    "c validation 100 mm off": Case(
        everywhere,
        (NO,),
        (Why.VALIDATION_UNLIKE,),
        change=displaced(VALIDATION, 0.1),
        validated=True,
    ),
    "d computed": Case(
        everywhere, (CARE,), (Why.MEASUREMENTS_COMPUTED,), change=rounded, noise=0.0
    ),
    "e another variant": Case(everywhere, (CARE,), (Why.OTHER_VARIANT,), other=True),
    "f sound, frame known": Case(everywhere, (USE,), SOUND, frame=False),
    "g stated 125 times too large": Case(
        everywhere, (USE,), SOUND, noise=4e-5, stated=5e-3, named=(Why.SIGMA_UNLIKELY,)
    ),
    "g stated 900 times too small": Case(
        everywhere, (USE,), SOUND, stated=NOISE / 900.0, named=(Why.SIGMA_UNLIKELY,)
    ),
    "h gross rows": Case(
        everywhere,
        UNSURE,
        REMAINS,
        "placement+eccentricity",
        {"eccentricity": 5e-3},
        displaced(slice(1, None, 20), GROSS),
    ),
    "j exchanged, corner": Case(with_exchanged_columns, (NO,), (Why.COLUMNS_SWAPPED,)),
    "k path": Case(
        swinging(0.0, 30), UNSURE, NARROW, "placement+eccentricity", ECCENTRIC, in_part=True
    ),
    "k posture": Case(
        with_a_posture, UNSURE, ALONE, change=displaced(slice(-1, None), WRONG), in_part=True
    ),
    "k posture, small errors": Case(
        with_a_posture,
        UNSURE,
        ALONE,
        sizes=SMALL,
        change=displaced(slice(-1, None), WRONG),
        in_part=True,
    ),
    "sound": Case(everywhere, (USE,), SOUND),
    "sound, validated": Case(everywhere, (USE,), SOUND, validated=True),
    "sound, path": Case(swinging(0.0, 100), (USE,), SOUND),
    "sound, eccentric": Case(everywhere, (USE,), SOUND, "placement+eccentricity"),
}


def error(robot: Robot, truth: Truth, cell: Cell, q: Array) -> float:
    """Return the error of a robot at joint values without noise, rms [mm]."""
    table = Measurements(truth.nominal.joint_names, q, truth.points(q))
    return 1e3 * evaluate(robot, table, cell).errors["all"]["m"].rms


def row(name: str, arm: str, seed: int) -> list[str]:
    """Measure and calibrate one table of a case, and judge the verdict."""
    case, robot = CASES[name], load_arm(arm)
    given = robot
    if case.other:
        robot, given = (Robot.load(one, base="base", tip="tool0") for one in VARIANTS[arm])
    rng = np.random.default_rng([44, seed])
    truth = draw_truth(robot, case.model, case.sizes, draw_seed(rng), cell=Cell())
    in_table, measured, near = case.rows(robot, rng)
    points = add_noise(truth.points(measured), case.noise, rng)
    directions = rng.normal(size=points.shape)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    table = Measurements(robot.joint_names, in_table, case.change(points, directions))
    if case.validated:
        sets = np.full(len(points), "estimate", dtype=object)
        sets[VALIDATION] = "validate"
        table = replace(table, sets=tuple(sets.tolist()))
    free = seed % 2 == 1 if case.frame is None else case.frame
    cell = Cell(estimate_frame=free, scale_certified=True)  # the virtual instrument is exact
    if case.stated is not None:
        cell = replace(cell, sigma={"m": case.stated})
    result = calibrate(given, table, cell=cell)

    places = (near, random_joint_values(robot, FRESH, 99))
    errors = [(error(given, truth, cell, q), error(result.robot, truth, cell, q)) for q in places]
    said = [1e3 * value for value in result.new_point]
    is_right = _is_right(case, result, errors[1], said[1])
    verdict = verdict_of(result)
    figures = []
    for (before, after), expected in zip(errors, said, strict=True):
        figures += [f"{before:.2f} -> {after:.2f}", f"{expected:.2f}"]
    if result.non_geometric is not None:
        expected = 1e3 * result.non_geometric.new_point[0]
        q = places[0]
        away = np.linalg.norm(result.predict(q) - truth.points(q), axis=1)
        figures.append(f"{result.non_geometric.name}: {np.sqrt(np.mean(away**2)) * 1e3:.2f}")
        figures.append(f"{expected:.2f}")
    mark = "+" if is_right else "?"
    return [name, arm, str(seed), mark, verdict.use, verdict.reasons[0].code, *figures]


def _is_right(
    case: Case, result: Calibration, over_limits: tuple[float, float], said: float
) -> bool:
    """Return whether a verdict and its first reason are right.

    ``over_limits`` are the true errors of the nominal and the corrected robot over the joint limits, ``said`` is the
    expected one, all [mm].
    """
    verdict = verdict_of(result)
    before, after = over_limits
    if case.in_part and verdict.use == USE:
        return after < min(0.5 * before, 2.0 * said)
    every = {reason.why for reason in verdict.reasons}
    is_first = verdict.reasons[0].why in case.reasons
    return verdict.use in case.right and is_first and every.issuperset(case.named)


def main() -> None:
    """Print a row for each table, and how many are right."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("first", type=int, nargs="?", default=0, metavar="FIRST", help="seed")
    parser.add_argument("--only", default="", help="cases that begin so")
    arguments = parser.parse_args()
    jobs = [
        (name, arm, arguments.first + k)
        for name in CASES
        if name.startswith(arguments.only)
        for k, arm in enumerate(ARMS)
    ]
    printed, counted = tee(run_jobs(row, jobs, workers=arguments.workers, label="tables"))
    print_table(TITLES, printed, WIDTHS)
    right = sum(cells[3] == "+" for cells in counted)
    print(f"\nright: {right} of {len(jobs)}")


if __name__ == "__main__":
    main()
