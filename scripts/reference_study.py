"""Tables with targets that stand still: are drift and steps found, where, and what is the robot worth then?

    python scripts/reference_study.py [TABLES] [SEED] [--layout POSES/EVERY/REFERENCES] [--cases WORD]

The frame of a tracker drifts evenly from the first row to the last, or steps at a row anywhere in the middle 80 % of
the poses; the displacement has any direction. References are read before the first pose, after every few poses and
after the last. Positions of the robot come from Pinocchio (`verification_truth.py`), all else from NumPy.

Printed are how often a movement of the frame is found, how often it is of the right form and no other is, the share of
steps whose row is within 5 % of the rows of the true one, how often the interval of rows has it, the root mean square
of the errors of the displacement over their standard deviations, what is left (said, and true), and the true error of
the robot at fresh poses after the best rigid motion and in the frame of the first row, with the references and without.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from arms import load_arm
from studies import print_table, rms, rms_length, run_cases, study_parser
from verification_truth import Truth, draw_frame, draw_joint_values

from calib.basics.arrays import Array
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.data.references import References
from calib.diagnosis.frame_drift import find_frame_drift, without_frame_drift
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup
from calib.numerics.frame_path import Form
from calib.numerics.rigid_motion import without_rigid_motion
from calib.result.calibrate import calibrate

ARMS = ("ur3", "ur10", "panda")

#: Noise of a coordinate of the tracker, at references and at poses, and repeatability of the robot [m].
NOISE = 15e-6
REPEATABILITY = 20e-6

#: Fresh poses.
FRESH = 200

#: One of so many tables is calibrated, with its references and without.
COMPARED = 5

#: A place is right within this share of the rows.
NEAR = 0.05

#: Poses, poses between two visits of the references, and number of references.
LAYOUTS = ((30, 10, 1), (30, 5, 1), (30, 5, 2), (30, 5, 3), (60, 10, 1), (60, 10, 3), (60, 5, 1))

#: Lengths of a drift and of a step [m].
MOVED = ((0.0, 0.0), (5e-5, 0.0), (1e-4, 0.0), (0.0, 5e-5), (0.0, 1e-4))


@dataclass(frozen=True)
class Case:
    """How the references were measured, and how the frame moved."""

    poses: int
    every: int
    targets: int
    drift: float  # From the first row to the last [m]
    step: float  # [m]

    @property
    def words(self) -> str:
        """What moved, in a word."""
        if self.drift or self.step:
            size = 1e3 * (self.drift or self.step)
            return f"{'drift' if self.drift else 'step'} {size:.2f}"
        return "nothing"


@dataclass(frozen=True)
class Table:
    """A measured table and its truth."""

    measurements: Measurements
    truth: Truth
    T_frame_base: Array  # At the first row, (4, 4) [m]
    displaced: Array  # (N, 3), of each pose [m]
    by: Array  # (3,), of the whole table [m]
    row: int  # The first displaced row of a step; 0 without one


@dataclass(frozen=True)
class Outcome:
    """Figures of one table."""

    found: bool  # A movement of the frame
    right: bool  # Of the right form, and no other
    near: bool
    covered: bool
    pull: float  # Error of the displacement over its standard deviation, rms of three; NaN if it is not right
    said: float  # What is left, a coordinate [m]
    left: float  # What is left in truth [m]
    arm: tuple[
        float, ...
    ]  # Error after the best rigid motion, with references and of some without, rms [m]
    frame: tuple[float, ...]  # In the frame of the first row [m]


def make_table(case: Case, seed: int) -> Table:
    """Draw a robot, and measure it and the references."""
    rng = np.random.default_rng([48, 4, seed])
    robot = load_arm(ARMS[seed % len(ARMS)])
    truth = Truth.draw(robot, rng)
    T_frame_base = draw_frame(rng)
    q = draw_joint_values(robot, case.poses, rng)
    points = truth.points(q) @ T_frame_base[:3, :3].T + T_frame_base[:3, 3]
    still = points.mean(axis=0) + rng.uniform(-1.0, 1.0, size=(case.targets, 3))

    # Poses have numbers from 0, references those below.
    order: list[int] = []
    for pose in range(case.poses + 1):
        if pose % case.every == 0 or pose == case.poses:
            order += range(-case.targets, 0)
        if pose < case.poses:
            order.append(pose)
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    first_moved = int(rng.integers(case.poses // 10, case.poses - case.poses // 10))
    place = order.index(first_moved)
    path = np.linspace(0.0, 1.0, len(order))[:, None] * case.drift * direction
    path[place:] += case.step * direction
    true = np.array([points[i] if i >= 0 else still[i] for i in order])
    read = true + path + NOISE * rng.normal(size=true.shape)
    is_pose = np.array(order) >= 0
    read[is_pose] += REPEATABILITY * rng.normal(size=(case.poses, 3))
    numbers = np.arange(1, len(order) + 1)
    references = References(
        points=read[~is_pose],
        targets=tuple(f"floor {i + case.targets + 1}" for i in order if i < 0),
        groups=("",) * int(np.sum(~is_pose)),
        rows=tuple(numbers[~is_pose].tolist()),
        sequence=tuple(numbers.tolist()),
    )
    measurements = Measurements(
        robot.joint_names,
        q,
        read[is_pose],
        rows=tuple(numbers[is_pose].tolist()),
        references=references,
    )
    row = place + 1 if case.step else 0
    by = (case.drift + case.step) * direction
    return Table(measurements, truth, T_frame_base, path[is_pose], by, row)


def run_once(case: Case, seed: int) -> Outcome:
    """Measure a robot, and find what the references show, as a calibration does; some are calibrated as well."""
    table = make_table(case, seed)
    truth, robot, measured = table.truth, table.truth.nominal, table.measurements
    cell = Cell(estimate_frame=True)
    by_readings = find_frame_drift(measured)
    assert by_readings is not None
    corrected = without_frame_drift(measured, by_readings[1])
    rows, setup = rows_and_setup(robot, corrected, cell)
    fitted = fit(Task(robot, cell, setup, "dh"), rows)
    found_by_all = find_frame_drift(measured, None, fitted, by_readings[1])
    assert found_by_all is not None
    drift, displaced = found_by_all

    arm, frame = [], []
    for compared in (measured, replace(measured, references=None)):
        if seed % COMPARED == 0:
            result = calibrate(robot, compared, cell=cell, model="dh", validate=False)
            fresh = draw_joint_values(robot, FRESH, np.random.default_rng([48, 5, seed]))
            true = truth.points(fresh) @ table.T_frame_base[:3, :3].T + table.T_frame_base[:3, 3]
            error = result.predict(fresh) - true
            arm.append(rms_length(without_rigid_motion(true, error[:, :, None])[:, :, 0]))
            frame.append(rms_length(error))
    form = Form.DRIFT if case.drift else Form.STEP
    right = len(drift.found) == 1 and drift.corrected and drift.found[0].form is form
    near = covered = False
    pull = np.nan
    if right:
        found = drift.found[0]
        near = abs(found.row - table.row) <= NEAR * case.poses
        covered = found.after_row < table.row <= found.before_row
        pull = float(np.sqrt(np.mean(((found.by - table.by) / found.std) ** 2)))
    return Outcome(
        found=bool(drift.found),
        right=bool(right),
        near=near,
        covered=covered,
        pull=pull,
        said=drift.left,
        left=float(np.sqrt(np.mean((displaced.points - table.displaced) ** 2))),
        arm=tuple(arm),
        frame=tuple(frame),
    )


def case_row(case: Case, runs: Sequence[Outcome]) -> list[str]:
    """Return the row of a case."""
    right = [run for run in runs if run.right]
    steps = right if case.step else []
    pulls = np.array([run.pull for run in right])
    compared = [run for run in runs if len(run.arm) > 1]

    def share(flags: list[bool]) -> str:
        """Write a share of runs."""
        return f"{np.mean(flags):.0%}" if flags else ""

    def in_mm(values: list[float]) -> str:
        """Write the rms of lengths."""
        return f"{1e3 * rms(np.array(values)):.4f}"

    return [
        f"{case.poses} / {case.every} / {case.targets}",
        case.words,
        share([run.found for run in runs]),
        share([run.right for run in runs]) if case.drift or case.step else "",
        share([run.near for run in steps]),
        share([run.covered for run in steps]),
        f"{rms(pulls):.2f}" if len(pulls) else "",
        in_mm([run.said for run in runs]),
        in_mm([run.left for run in runs]),
        *(in_mm([run.arm[k] for run in compared]) for k in (0, 1)),
        *(in_mm([run.frame[k] for run in compared]) for k in (0, 1)),
    ]


def main() -> None:
    """Print a row for each layout and movement."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("tables", type=int, nargs="?", default=6, metavar="TABLES")
    parser.add_argument("seed", type=int, nargs="?", default=0, metavar="SEED")
    parser.add_argument("--cases", default="", metavar="WORD", help="only movements with this word")
    parser.add_argument("--layout", default="", help="only this layout, such as 30/5/3")
    arguments = parser.parse_args()
    layouts: tuple[tuple[int, int, int], ...] = LAYOUTS
    if arguments.layout:
        poses, every, targets = (int(word) for word in arguments.layout.split("/"))
        layouts = ((poses, every, targets),)
    every_case = itertools.product(layouts, MOVED)
    cases = [Case(*layout, *moved) for layout, moved in every_case]
    cases = [case for case in cases if arguments.cases in case.words]
    seeds = range(arguments.seed, arguments.seed + arguments.tables)
    results = run_cases(run_once, cases, seeds, workers=arguments.workers, label="tables")
    titles = ["poses / every / references", "moved [mm]", "found", "right", "place", "in interval"]
    titles += [
        "pull",
        "left, said [mm]",
        "left, true",
        "arm [mm]",
        "without",
        "frame [mm]",
        "without",
    ]
    print_table(titles, (case_row(case, runs) for case, runs in results), [12, 10])


if __name__ == "__main__":
    main()
