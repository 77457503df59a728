"""Usual mistakes in each kind of table: those that the verdict names.

    python scripts/mistakes_study.py

A UR5 with typical errors is measured at 30 poses. Each mistake is made in a table of points, of poses, of points of two
targets and of points from two stations, with a known measurement frame and with an unknown one. Printed is the first
reason of each verdict, with ``+`` where it names the mistake.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import tee

import numpy as np
from arms import load_arm
from scipy.spatial.transform import Rotation
from studies import add_noise, print_table, run_jobs, study_parser, unchanged, verdict_of

from calib.basics.arrays import Array
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import USE
from calib.result.calibrate import calibrate
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.simulate.truth import draw_truth

Change = Callable[[Measurements], Measurements]

#: Rows of a table.
ROWS = 30

#: Noise of a coordinate [m].
NOISE = 5e-5

#: Kinds of table.
TABLES = ("points", "poses", "targets", "stations")

#: The second target, from the first one, in the tip [m].
SECOND_TARGET = (0.08, -0.05, 0.06)

#: The second station, from the first one, in the frame of the points [m].
SECOND_STATION = (0.4, 0.2, 0.1)


def joints(change: Callable[[Array], Array]) -> Change:
    """Return a mistake in joint values, shape (N, 6), [rad]."""
    return lambda table: replace(table, joints=change(table.joints))


def points(change: Callable[[Array], Array]) -> Change:
    """Return a mistake in points, shape (N, 3), [m]."""
    return lambda table: replace(table, points=change(table.points))


def rotations(change: Callable[[Rotation], Rotation]) -> Change:
    """Return a mistake in orientations."""
    return lambda table: replace(
        table, rotations=change(Rotation.from_matrix(table.rotations)).as_matrix()
    )


def inverse_poses(table: Measurements) -> Measurements:
    """Return a table of poses with their inverses."""
    if table.rotations is None:
        raise ValueError("The table has no poses.")
    back = np.swapaxes(table.rotations, 1, 2)
    return replace(table, points=-np.einsum("nij,nj->ni", back, table.points), rotations=back)


def scaled(column: int, factor: float) -> Callable[[Array], Array]:
    """Return a function that multiplies a column."""
    return lambda values: values * np.where(np.arange(values.shape[1]) == column, factor, 1.0)


def constant(column: int) -> Callable[[Array], Array]:
    """Return a function that makes a column of joint values constant."""
    return lambda q: np.where(np.arange(q.shape[1]) == column, 0.5, q)


def written_first(R: Rotation) -> Rotation:
    """Return rotations whose quaternions were written w first and read w last."""
    return Rotation.from_quat(R.as_quat(scalar_first=True))


def written_last(R: Rotation) -> Rotation:
    """Return rotations whose quaternions were written w last and read w first."""
    return Rotation.from_quat(R.as_quat(), scalar_first=True)


@dataclass(frozen=True)
class Mistake:
    """A mistake, and the code of the reason that names it."""

    change: Change
    code: str  # With a known measurement frame
    unknown_code: str = ""  # With an unknown one, if it is another
    of_poses: bool = False  # Only tables of poses can have it
    tip: str = ""  # Tip of the robot that calib is given; the right one if empty

    def named_by(self, code: str, *, free: bool) -> bool:
        """Return True if a code names the mistake, where the measurement frame is free (unknown) or not."""
        expected = self.unknown_code if free and self.unknown_code else self.code
        return code == expected


MISTAKES = {
    "a joint turned": Mistake(joints(scaled(2, -1.0)), "joints_turned"),
    "a zero off by 90 deg": Mistake(
        joints(lambda q: q + np.radians(90.0) * np.eye(6)[2]), "joint_zero"
    ),
    "joints in rad for deg": Mistake(joints(np.degrees), "wrong_unit"),
    "joint columns swapped": Mistake(joints(lambda q: q[:, [0, 2, 1, 3, 4, 5]]), "columns_swapped"),
    "joint columns reversed": Mistake(joints(lambda q: q[:, ::-1]), "columns_reversed"),
    "readings coupled": Mistake(joints(lambda q: q - q[:, [1]] * np.eye(6)[2]), "readings_coupled"),
    "rows shifted": Mistake(joints(lambda q: np.roll(q, 1, axis=0)), "rows_shifted"),
    "points in mm for m": Mistake(points(lambda p: 1e-3 * p), "wrong_unit"),
    "x in inches": Mistake(points(scaled(0, 25.4)), "wrong_unit"),
    "x and y swapped": Mistake(
        points(lambda p: p[:, [1, 0, 2]]), "columns_swapped", "points_mirrored"
    ),
    "y mirrored": Mistake(points(scaled(1, -1.0)), "sign_turned", "points_mirrored"),
    "two joints turned": Mistake(joints(lambda q: q * [1, -1, 1, 1, -1, 1]), "joints_turned"),
    "a joint's column constant": Mistake(joints(constant(3)), "joint_constant"),
    "base's column constant": Mistake(joints(constant(0)), "joint_constant"),
    "another tip": Mistake(unchanged, "other_tip", tip="wrist_2_link"),
    "quaternions w first": Mistake(rotations(written_first), "scalar_elsewhere", of_poses=True),
    "quaternions w last": Mistake(rotations(written_last), "scalar_elsewhere", of_poses=True),
    "orientations inverse": Mistake(rotations(Rotation.inv), "orientations_inverse", of_poses=True),
    "poses inverse": Mistake(inverse_poses, "poses_inverse", of_poses=True),
}


def right_table(robot: Robot, kind: str, *, free: bool) -> Measurements:
    """Measure a robot with typical errors, without a mistake.

    Args:
        robot: The nominal robot.
        kind: One of `TABLES`.
        free: The measurement frame is anywhere; it is the base otherwise.
    """
    truth = draw_truth(robot, "dh", {}, 1, cell=Cell(estimate_frame=True))
    rng = np.random.default_rng(2)
    q = random_joint_values(robot, ROWS, 3)
    second = np.arange(ROWS) % 2 == 1  # rows of the second target or station
    T_tip_target = np.tile(truth.T_tip_target[0], (ROWS, 1, 1))
    if kind == "targets":
        T_tip_target[second, :3, 3] += SECOND_TARGET
    T_frame_base = truth.T_frame_base[0] if free else np.eye(4)
    poses = T_frame_base @ truth.tip_poses(q) @ T_tip_target
    if kind == "stations" and free:
        poses[second, :3, 3] += SECOND_STATION
    return Measurements(
        joint_names=robot.joint_names,
        joints=q,
        kinds=("pose" if kind == "poses" else "point",) * ROWS,
        points=add_noise(poses[:, :3, 3], NOISE, rng),
        rotations=poses[:, :3, :3] if kind == "poses" else None,
        targets=("a", "b") * (ROWS // 2) if kind == "targets" else ("",) * ROWS,
        groups=("", "second") * (ROWS // 2) if kind == "stations" else ("",) * ROWS,
    )


@dataclass(frozen=True)
class Outcome:
    """Verdict on a table with a mistake."""

    code: str  # Of the first reason
    use: str
    named: bool  # The code names the mistake


def outcome(name: str, kind: str, free: bool) -> Outcome | None:
    """Calibrate a table with a mistake; None if a table of this kind cannot have it.

    Args:
        name: Name of the mistake.
        kind: One of `TABLES`.
        free: The measurement frame is unknown.
    """
    mistake = MISTAKES[name]
    if mistake.of_poses and kind != "poses":
        return None
    robot = load_arm("ur5")
    table = mistake.change(right_table(robot, kind, free=free))
    if mistake.tip:
        robot = robot.rebuilt(tip=mistake.tip)
    verdict = verdict_of(calibrate(robot, table, cell=Cell(estimate_frame=free)))
    code = verdict.reasons[0].code
    return Outcome(code, verdict.use, mistake.named_by(code, free=free))


def mistake_outcomes(name: str) -> list[Outcome | None]:
    """Calibrate the tables of a mistake: of each kind with a known frame, then with an unknown one."""
    return [outcome(name, kind, free) for free in (False, True) for kind in TABLES]


def cell_text(result: Outcome | None) -> str:
    """Return the text of a cell of the table."""
    if result is None:
        return "-"
    return f"{result.code} +" if result.named else result.code


def main() -> None:
    """Print a row for each mistake, and the counts."""
    parser = study_parser(__doc__, parallel=True)
    workers = parser.parse_args().workers
    jobs = [(name,) for name in MISTAKES]
    printed, counted = tee(run_jobs(mistake_outcomes, jobs, workers=workers, label="mistakes"))
    rows = ([name, *map(cell_text, cells)] for name, cells in zip(MISTAKES, printed, strict=True))
    titles = ["mistake", *TABLES, *(f"{kind}, free" for kind in TABLES)]
    print_table(titles, rows, [25] + 8 * [22])
    outcomes = [result for results in counted for result in results if result is not None]
    named = sum(result.named for result in outcomes)
    used = sum(result.use == USE for result in outcomes)
    print(f"\nnamed by their cause: {named} of {len(outcomes)}; '{USE}': {used}")


if __name__ == "__main__":
    main()
