"""Usual mistakes in each kind of table: those that the verdict names.

    python scripts/mistakes_study.py

A UR5 with typical errors is measured at 30 poses. Each mistake is made in a table of points, of poses, of points of two
targets and of points from two stations, with a known measurement frame and with an unknown one. Printed is the first
reason of each verdict, with ``+`` where it names the mistake. A second table has mistakes that come two at a time, and
others, on several arms: see `more_outcome` for its words.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import tee
from typing import Any

import numpy as np
from arms import load_arm
from scipy.spatial.transform import Rotation
from studies import add_noise, draw_seed, print_table, run_jobs, study_parser, unchanged, verdict_of

from calib.basics.arrays import Array, read_only
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import USE
from calib.diagnosis.trials import misfit
from calib.diagnosis.usual_mistakes import find_usual_mistake
from calib.fit.registration.table_rows import rows_and_setup
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
        targets=("a", "b") * (ROWS // 2) if kind == "targets" else (),
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


# Two at a time, and those of a part of a table

#: Arms, of which each table has one.
ARMS = ("ur5", "panda", "iiwa", "irb120", "ur10")

#: Rows of these tables.
MORE_ROWS = 40

#: A target off the last joint's axis, in the tip [m].
TARGET = (0.06, -0.05, 0.08)

#: Errors that differ by less are those of the same robot [m].
SAME_ERROR = 1e-6

#: What the file of a table says of its columns.
_STATED = {"turning": "deg", "points": "mm"}


@dataclass(frozen=True)
class Spoilt:
    """A table with one or two mistakes."""

    table: Measurements
    #: Code and values, of each mistake, that a reason must have
    named: tuple[dict[str, Any], ...]


def _zero(table: Measurements, joint: int, deg: float) -> tuple[Measurements, dict[str, Any]]:
    """Add an angle [deg] to the readings of a joint; its mistake takes that away."""
    shifted = table.joints + np.radians(deg) * np.eye(table.joints.shape[1])[joint]
    add = float(np.radians(180.0 if abs(deg) == 180.0 else -deg))
    values = {"code": "joint_zero", "joint": table.joint_names[joint], "add_rad": add}
    return replace(table, joints=shifted), values


def _sign(table: Measurements, joint: int) -> tuple[Measurements, dict[str, Any]]:
    """Reverse the readings of a joint."""
    values = {"code": "joints_turned", "joints": table.joint_names[joint]}
    return replace(table, joints=scaled(joint, -1.0)(table.joints)), values


def _factor(table: Measurements, joint: int, factor: float) -> tuple[Measurements, dict[str, Any]]:
    """Multiply the readings of a joint."""
    values = {"code": "joint_factor", "joint": table.joint_names[joint], "factor": 1.0 / factor}
    return replace(table, joints=scaled(joint, factor)(table.joints)), values


def _two_zeros(table: Measurements, i: int, j: int, rng: np.random.Generator) -> Spoilt:
    """Two joints count from another zero."""
    table, first = _zero(table, i, float(rng.choice([90.0, -90.0, 180.0, 45.0])))
    table, second = _zero(table, j, float(rng.choice([90.0, -90.0, 180.0, -45.0])))
    return Spoilt(table, (first, second))


def _sign_and_zero(table: Measurements, i: int, _: int, rng: np.random.Generator) -> Spoilt:
    """One joint counts the other way, from another zero."""
    turned, sign = _sign(table, i)
    deg = float(rng.choice([90.0, -90.0, 180.0]))
    shifted, zero = _zero(turned, i, deg)  # -q + a: turned back it is q - a
    zero["add_rad"] = float(np.radians(deg))
    return Spoilt(shifted, (sign, zero))


def _sign_zero_elsewhere(table: Measurements, i: int, j: int, rng: np.random.Generator) -> Spoilt:
    """One joint counts the other way, another from another zero."""
    table, sign = _sign(table, i)
    table, zero = _zero(table, j, float(rng.choice([90.0, -90.0])))
    return Spoilt(table, (sign, zero))


def _percent(table: Measurements, i: int, _: int, rng: np.random.Generator) -> Spoilt:
    """The readings of a joint are too large or small by some percent."""
    table, factor = _factor(table, i, float(rng.choice([0.8, 0.9, 1.1, 1.25])))
    return Spoilt(table, (factor,))


def _gear(table: Measurements, i: int, _: int, rng: np.random.Generator) -> Spoilt:
    """A column has the angles of the motor."""
    table, factor = _factor(table, i, float(rng.choice([50.0, -101.0, 2.0, -80.25])))
    return Spoilt(table, (factor,))


def _column_in_rad(table: Measurements, i: int, _: int, __: np.random.Generator) -> Spoilt:
    """One column is in rad in a table of degrees."""
    name = table.joint_names[i]
    changed = scaled(i, np.radians(1.0))(table.joints)
    values = {"code": "wrong_unit", "what": f"values of '{name}'", "unit": "rad", "header": "deg"}
    return Spoilt(replace(table, joints=changed), (values,))


def _missing_point(table: Measurements, _: int, __: int, rng: np.random.Generator) -> Spoilt:
    """A measurement is missing, and those after it moved up; another pose of the last row fills the end."""
    k = int(rng.integers(4, len(table) - 6))
    order = np.delete(np.arange(len(table)), k)
    kept = table.select(np.arange(len(table)) < len(table) - 1)
    rotations = None if table.rotations is None else table.rotations[order]
    moved = replace(kept, points=table.points[order], rotations=rotations)
    return Spoilt(moved, ({"code": "rows_moved", "row": table.rows[k], "up": True},))


def _centimetres(table: Measurements, _: int, __: int, ___: np.random.Generator) -> Spoilt:
    """Points are in cm, and their header says mm."""
    values = {"code": "wrong_unit", "what": "points", "unit": "cm", "header": "mm"}
    return Spoilt(replace(table, points=0.1 * table.points), (values,))


def _centimetres_and_sign(table: Measurements, i: int, _: int, rng: np.random.Generator) -> Spoilt:
    """Points are in cm, and a joint counts the other way."""
    table, sign = _sign(table, i)
    spoilt = _centimetres(table, i, i, rng)
    return Spoilt(spoilt.table, (*spoilt.named, sign))


def _last_turned(table: Measurements, _: int, __: int, rng: np.random.Generator) -> Spoilt:
    """The last joint is turned by 45 deg, and the target is given."""
    last = len(table.joint_names) - 1
    table, zero = _zero(table, last, float(rng.choice([45.0, -45.0, 135.0])))
    return Spoilt(table, (zero,))


MORE_MISTAKES: Mapping[str, Callable[[Measurements, int, int, np.random.Generator], Spoilt]] = {
    "two zeros": _two_zeros,
    "sign and zero of a joint": _sign_and_zero,
    "sign of one, zero of another": _sign_zero_elsewhere,
    "a factor, by percent": _percent,
    "a gear's factor": _gear,
    "one column in rad": _column_in_rad,
    "a point missing": _missing_point,
    "points in cm": _centimetres,
    "points in cm, a sign": _centimetres_and_sign,
    "last joint turned, target given": _last_turned,
}


def spoilt_table(
    name: str | None, kind: str, seed: int, *, free: bool
) -> tuple[Robot, Cell, Spoilt]:
    """Measure an arm with typical errors, and make a mistake of `MORE_MISTAKES`; None: no mistake."""
    rng = np.random.default_rng([seed, *map(ord, kind), free])
    robot = load_arm(ARMS[seed % len(ARMS)])
    cell = Cell(estimate_frame=free, target=read_only(np.array(TARGET)))
    truth = draw_truth(robot, "dh", {}, draw_seed(rng), cell=cell)
    q = random_joint_values(robot, MORE_ROWS, draw_seed(rng))
    poses = truth.T_frame_base[0] @ truth.tip_poses(q) @ truth.T_tip_target[0]
    table = Measurements(
        joint_names=robot.joint_names,
        joints=q,
        kinds=(kind,) * MORE_ROWS,
        points=add_noise(poses[:, :3, 3], NOISE, rng),
        rotations=poses[:, :3, :3] if kind == "pose" else None,
        units={
            **dict.fromkeys(robot.joint_names, _STATED["turning"]),
            **dict.fromkeys("xyz", _STATED["points"]),
        },
    )
    if name is None:
        return robot, cell, Spoilt(table, ())
    # The first joint's zero is the frame's too, and the last one's the target's: other joints are spoilt.
    i, j = sorted(rng.choice(np.arange(1, len(robot.joint_names) - 1), 2, replace=False).tolist())
    if name != "last joint turned, target given":
        cell = replace(cell, target=None)
    return robot, cell, MORE_MISTAKES[name](table, i, j, rng)


def is_named(reason: Mapping[str, Any], named: Sequence[Mapping[str, Any]]) -> bool:
    """Return True if a reason has the codes and values of the mistakes that were made."""
    told = reason.get("both", [reason])
    return len(told) == len(named) and all(
        any(_agrees(one, expected) for one in told) for expected in named
    )


def _agrees(told: Mapping[str, Any], expected: Mapping[str, Any]) -> bool:
    """Return True if a mistake has the expected code and values; a factor may differ by 1 %."""
    for key, value in expected.items():
        if key == "factor":
            if abs(told.get(key, 0.0) / value - 1.0) > 0.01:
                return False
        elif isinstance(value, float):
            if abs(told.get(key, np.inf) - value) > 1e-9:
                return False
        elif told.get(key) != value:
            return False
    return True


def more_outcome(name: str | None, kind: str, seed: int, free: bool) -> str:
    """Return whether the mistake of a table is named.

    Returns:
        ``"first"``; ``"other"``, as another explanation; ``"same"``, if what is named leaves the same errors as the
        table without its mistake, so that no rows can tell both apart; ``"wrong"``; or ``"none"``.
    """
    robot, cell, spoilt = spoilt_table(name, kind, seed, free=free)
    reason = find_usual_mistake(robot, cell, spoilt.table)
    if reason is None:
        return "none"
    first = {"code": reason.code, **reason.values}
    if is_named(first, spoilt.named):
        return "first"
    if any(is_named(other, spoilt.named) for other in first.get("others", ())):
        return "other"
    _, _, right = spoilt_table(None, kind, seed, free=free)
    rows, setup = rows_and_setup(robot, right.table, cell)
    error, _ = misfit(robot, setup, rows)
    return "same" if abs(reason.values["error_m"] - error) < SAME_ERROR else "wrong"


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
    print(f"\nnamed by their cause: {named} of {len(outcomes)}; '{USE}': {used}\n")

    # Mistakes that come two at a time, on arms and set-ups that the seed draws; the last row has none.
    cases = [(kind, free) for kind in ("point", "pose") for free in (False, True)]
    printed_rows = []
    for number, name in enumerate((*MORE_MISTAKES, None)):
        cells = [
            more_outcome(name, kind, 100 * number + k, free) for k, (kind, free) in enumerate(cases)
        ]
        printed_rows.append([name or "no mistake", *cells])
    titles = ["mistake", *(f"{kind}{', free' if free else ''}" for kind, free in cases)]
    print_table(titles, printed_rows, [31] + len(cases) * [12])


if __name__ == "__main__":
    main()
