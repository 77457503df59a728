"""The user's usual mistakes in every kind of table: which of them the verdict names.

    .venv/bin/python scripts/mistakes_study.py

A UR5 with typical errors is measured at 30 poses; each mistake is made in points, poses, points of two targets and
points from two set-ups, in the base frame and in an unknown one. One line a mistake, one code a cell.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.calibration import Calibration, calibrate
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import USE
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.simulation.truth import draw_truth

Array = NDArray[np.float64]
Mistake = Callable[[Measurements], Measurements]

ROWS, NOISE = 30, 5e-5

#: What is told of the robot and not of the table; what only tables of poses can have.
ANOTHER_TIP = "another tip"
OF_POSES = ("poses inverse", "quaternions w first", "quaternions w last", "orientations inverse")

#: What was measured; then whether the frame is unknown.
TABLES = ("points", "poses", "targets", "groups")


def _joints(change: Callable[[Array], Array]) -> Mistake:
    return lambda m: replace(m, joints=change(m.joints))


def _points(change: Callable[[Array], Array]) -> Mistake:
    return lambda m: replace(m, points=change(m.points))


def _inverse(m: Measurements) -> Measurements:
    assert m.rotations is not None
    back = np.swapaxes(m.rotations, 1, 2)
    return replace(m, points=-np.einsum("nij,nj->ni", back, m.points), rotations=back)


def _turned(change: Callable[[Rotation], Rotation]) -> Mistake:
    """Orientations that are written otherwise."""
    return lambda m: replace(m, rotations=change(Rotation.from_matrix(m.rotations)).as_matrix())


def _times(column: int, factor: float) -> Callable[[Array], Array]:
    return lambda values: values * np.where(np.arange(values.shape[1]) == column, factor, 1.0)


#: The mistakes, with the codes that name them: in a frame that is known, and in one that may turn freely.
MISTAKES: dict[str, tuple[Mistake, set[str], set[str]]] = {
    "a joint turned": (_joints(_times(2, -1.0)), {"joints_turned"}, {"joints_turned"}),
    "a zero off by 90 deg": (
        _joints(lambda q: q + np.radians(90.0) * np.eye(6)[2]), {"joint_zero"}, {"joint_zero"},
    ),
    "joints in rad for deg": (_joints(np.degrees), {"wrong_unit"}, {"wrong_unit"}),
    "joint columns swapped": (
        _joints(lambda q: q[:, [0, 2, 1, 3, 4, 5]]), {"columns_swapped"}, {"columns_swapped"},
    ),
    "joint columns reversed": (_joints(lambda q: q[:, ::-1]), {"columns_reversed"}, {"columns_reversed"}),
    "rows shifted": (_joints(lambda q: np.roll(q, 1, axis=0)), {"rows_shifted"}, {"rows_shifted"}),
    "points in mm for m": (_points(lambda p: 1e-3 * p), {"wrong_unit"}, {"wrong_unit"}),
    "x in inches": (_points(_times(0, 25.4)), {"wrong_unit"}, {"wrong_unit"}),
    "x and y swapped": (_points(lambda p: p[:, [1, 0, 2]]), {"columns_swapped"}, {"points_mirrored"}),
    "y mirrored": (_points(_times(1, -1.0)), {"sign_turned"}, {"points_mirrored"}),
    "two joints turned": (_joints(lambda q: q * [1, -1, 1, 1, -1, 1]), {"joints_turned"}, {"joints_turned"}),
    "a joint's column constant": (
        _joints(lambda q: np.where(np.arange(6) == 3, 0.5, q)), {"joint_constant"}, {"joint_constant"},
    ),
    "base's column constant": (
        _joints(lambda q: np.where(np.arange(6) == 0, 0.5, q)), {"joint_constant"}, {"joint_constant"},
    ),
    ANOTHER_TIP: (lambda m: m, {"other_tip"}, {"other_tip"}),
    "quaternions w first": (
        _turned(lambda R: Rotation.from_quat(R.as_quat(scalar_first=True))), {"scalar_elsewhere"}, {"scalar_elsewhere"},
    ),
    "quaternions w last": (
        _turned(lambda R: Rotation.from_quat(R.as_quat(), scalar_first=True)),
        {"scalar_elsewhere"}, {"scalar_elsewhere"},
    ),
    "orientations inverse": (_turned(Rotation.inv), {"orientations_inverse"}, {"orientations_inverse"}),
    "poses inverse": (_inverse, {"poses_inverse"}, {"poses_inverse"}),
}  # fmt: skip


def table(kind: str, *, free: bool) -> tuple[Robot, Measurements, Cell]:
    """A table without a mistake, and what the fit is told."""
    robot = Robot.load("ur5", "base_link", "tool0")
    groups = ("", "second") if kind == "groups" else ("",)
    truth = draw_truth(robot, "dh", {}, 1, cell=Cell(estimate_frame=True))
    frame = truth.T_frame_base[0] if free else np.eye(4)
    rng, q = np.random.default_rng(2), random_joint_values(robot, ROWS, 3)
    T = frame @ truth.tip_poses(q)
    target = np.arange(ROWS) % 2 * (kind == "targets")
    group = np.arange(ROWS) % len(groups)
    T_tip_target = np.tile(truth.T_tip_target[0], (ROWS, 1, 1))
    T_tip_target[target == 1, :3, 3] += [0.08, -0.05, 0.06]
    seen = T @ T_tip_target
    seen[group == 1, :3, 3] += [0.4, 0.2, 0.1] if free else [0.0, 0.0, 0.0]
    points = seen[:, :3, 3] + NOISE * rng.normal(size=(ROWS, 3))
    measurements = Measurements(
        joint_names=robot.joint_names,
        joints=q,
        kinds=("pose" if kind == "poses" else "point",) * ROWS,
        points=points,
        rotations=seen[:, :3, :3] if kind == "poses" else None,
        targets=tuple("ab"[t] for t in target) if kind == "targets" else ("",) * ROWS,
        groups=tuple(groups[g] for g in group),
    )
    return robot, measurements, Cell(estimate_frame=free)


def named(result: Calibration) -> tuple[str, str]:
    """The first code of a verdict, and its use."""
    assert result.verdict is not None
    return result.verdict.reasons[0].code, result.verdict.use


def line(what: str, *, free: bool) -> list[tuple[str, str, bool] | None]:
    """The code, the use and whether the code names the mistake, in each kind of table; None where it has none."""
    mistake, *codes = MISTAKES[what]
    found: list[tuple[str, str, bool] | None] = []
    for kind in TABLES:
        if what in OF_POSES and kind != "poses":
            found.append(None)
            continue
        robot, m, cell = table(kind, free=free)
        robot = robot.rebuilt(tip="wrist_2_link") if what == ANOTHER_TIP else robot
        code, use = named(calibrate(robot, mistake(m), cell=cell))
        found.append((code, use, code in codes[free]))
    return found


def main() -> None:
    """Print the table, and the shares."""
    every = []
    print(" " * 25 + "".join(f"{t + f:>22}" for f in ("", ", free") for t in TABLES))
    for what in MISTAKES:
        cells = [*line(what, free=False), *line(what, free=True)]
        every += [cell for cell in cells if cell]
        texts = (cell[0] + " +" * cell[2] if cell else "-" for cell in cells)
        print(f"{what:<25}" + "".join(f"{text:>22}" for text in texts), flush=True)
    right, used = sum(cell[2] for cell in every), sum(cell[1] == USE for cell in every)
    print(f"named by their cause: {right} of {len(every)}; 'use': {used}")


if __name__ == "__main__":
    main()
