"""Cells at the edges of what a verdict can say: most of the error stays, the base has moved, a target is not there.

    .venv/bin/python scripts/edges_study.py [SEEDS] [NAME ...]

Each case is measured with typical errors of geometry besides, at so many seeds and three arms. One line a table:
held-out errors before and after, the verdict and its reasons. But for scales, which nothing tells, no case may be told
`use`, and its own reason comes first.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.result.calibrate import calibrate
from calib.result.calibration import CalibrationValues
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.simulation.truth import draw_truth
from calib.units import Array

ARMS = {
    "ur3": ("base", "tool0"),
    "ur5": ("base_link", "tool0"),
    "panda": ("panda_link0", "panda_link8"),
}
ROWS, NOISE = 40, 5e-5

#: The joint that errs alone, by its number in the chain.
ELBOW = 2


def no_errors(_robot: Robot) -> dict[str, float]:
    """No error by name."""
    return {}


def as_they_are(q: Array) -> Array:
    """Joint values as they are."""
    return q


def at_the_frame(_rng: np.random.Generator) -> Array:
    """A base that stands where the known frame has it."""
    return np.eye(4)


@dataclass(frozen=True)
class Edge:
    """A case: what is wrong with the robot, with the table, and with what calib is given."""

    codes: tuple[str, ...]  # Of which one is the first reason
    model: str = "dh"  # In which errors the robot is wrong
    sizes: dict[str, float] = field(default_factory=dict)  # Of families that are not typical
    errors: Callable[[Robot], dict[str, float]] = no_errors
    had: Callable[[Array], Array] = as_they_are  # From joint values read to those the arm had
    read: Callable[[Array], Array] = as_they_are  # From joint values read to those in the table
    T: Callable[[np.random.Generator], Array] = at_the_frame  # The base in the frame of the points
    scale: float = 1.0  # Of all that was measured
    given: Callable[[Array, np.random.Generator], Array] | None = None  # Target, from the true one
    cell: Cell = field(default_factory=Cell)


def moved(length: float = 0.0, angle: float = 0.0) -> Callable[[np.random.Generator], Array]:
    """A base that stands so far away [m], turned so far [rad], in some direction."""

    def draw(rng: np.random.Generator) -> Array:
        T = np.eye(4)
        along, about = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        T[:3, 3] = length * along
        T[:3, :3] = Rotation.from_rotvec(angle * about).as_matrix()
        return T

    return draw


def lagging(share: float) -> Callable[[Array], Array]:
    """Joint values that miss a share of the last move."""
    return lambda q: q - share * np.diff(q, axis=0, prepend=q[:1])


def elsewhere(length: float) -> Callable[[Array, np.random.Generator], Array]:
    """A target that is given so far from where it is [m]."""

    def draw(target: Array, rng: np.random.Generator) -> Array:
        away = rng.normal(size=3)
        return np.asarray(target + length * away / np.linalg.norm(away))

    return draw


def last_turned(q: Array) -> Array:
    """The last joint with the other sign."""
    return np.asarray(q * np.where(np.arange(q.shape[1]) == q.shape[1] - 1, -1.0, 1.0))


def left_by_geometry(*codes: str) -> tuple[str, ...]:
    """Reasons that say that the geometry leaves errors."""
    return (
        "no_urdf_holds",
        "much_remains",
        "noise_large",
        "unknown_elsewhere",
        "no_better",
        *codes,
    )


EDGES = {
    "eccentricity of 5 mrad": Edge(
        left_by_geometry(), "dh+eccentricity", {"eccentricity": 5e-3}
    ),
    "one gain 1 % off": Edge(
        left_by_geometry(), "dh+gain", {"gain": 0.0},
        errors=lambda robot: {f"{robot.joint_names[ELBOW]}.gain": 0.01},
    ),
    "zeros alone": Edge(left_by_geometry("model_lacks"), cell=Cell(model="zeros")),
    "lag of 0.1 %": Edge(left_by_geometry("joint_lags"), had=lagging(1e-3)),
    "gains of 5e-3": Edge(left_by_geometry(), "dh+gain", {"gain": 5e-3}),
    "gains of 5e-3 alone": Edge(left_by_geometry(), "frames+gain", {"gain": 5e-3}),
    "base 10 mm off": Edge(("base_moved",), T=moved(10e-3)),
    "base 5 mm off": Edge(("base_moved",), T=moved(5e-3)),
    "base 1 deg off": Edge(("base_moved",), T=moved(angle=np.radians(1.0))),
    "base 0.3 deg off": Edge(("base_moved",), T=moved(angle=np.radians(0.3))),
    "target 280 mm off": Edge(("target_far",), given=elsewhere(0.28)),
    "last joint turned": Edge(("joints_turned", "joint_zero"), read=last_turned),
    "last joint turned, target given": Edge(
        ("joints_turned", "joint_zero"), read=last_turned, given=elsewhere(1e-3)
    ),
    "scale 0.1 %": Edge(("gain",), scale=1.001),
    "scale 0.2 %": Edge(("gain",), scale=1.002),
}  # fmt: skip


def calibration(edge: Edge, arm: str, seed: int) -> CalibrationValues:
    """One table of a case, calibrated; a quarter of its rows are for validation."""
    robot = Robot.load(arm, *ARMS[arm])
    errors: dict[str, Any] = {"errors": edge.errors(robot)}
    truth = draw_truth(robot, edge.model, edge.sizes, seed, **errors)
    rng = np.random.default_rng([11, seed])
    q = random_joint_values(robot, ROWS, seed + 50)
    T_frame_base = edge.T(rng)
    true = truth.points(edge.had(q)) @ T_frame_base[:3, :3].T + T_frame_base[:3, 3]
    points = edge.scale * true + NOISE * rng.normal(size=true.shape)
    sets = tuple("validate" if k % 4 == 3 else "estimate" for k in range(ROWS))
    cell = edge.cell
    if edge.given is not None:
        cell = replace(cell, target=edge.given(truth.T_tip_target[0, :3, 3], rng))
    return calibrate(
        robot, Measurements(robot.joint_names, edge.read(q), points, sets=sets), cell=cell
    )


def line(name: str, arm: str, result: CalibrationValues) -> str:
    """What became of one table."""
    verdict, values = result.verdict, (result.nominal_cross_validation, result.cross_validation)
    assert verdict is not None
    errors = " -> ".join(
        f"{1e3 * v.errors_without_outliers.rms:6.3f}" for v in values if v is not None
    )
    non_geometric = result.non_geometric.name if result.non_geometric else "-"
    right = verdict.reasons[0].code in EDGES[name].codes
    codes = ", ".join(reason.code for reason in verdict.reasons)
    return f"{name:32} {arm:6} {errors:17} {non_geometric:22} {'+' if right else '?'} {verdict.use}: {codes}"


def lines(seeds: int, names: list[str]) -> Iterator[str]:
    """A line for each table."""
    for name in names or EDGES:
        for arm in ARMS:
            for seed in range(seeds):
                yield line(name, arm, calibration(EDGES[name], arm, seed))


def main() -> None:
    """Print the lines, and how many are told `use`."""
    used = 0
    for text in lines(int(sys.argv[1]) if len(sys.argv) > 1 else 1, sys.argv[2:]):
        used += " use: " in text and "not use: " not in text
        print(text, flush=True)
    print(f"use: {used}")


if __name__ == "__main__":
    main()
