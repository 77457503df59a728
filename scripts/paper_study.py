"""The figures of docs/paper.md: readings of the paper, parameter sets and solvers on its rows.

    .venv/bin/python scripts/paper_study.py

Rows 1 to 30 are fitted; rows 31 to 35 are only predicted. Leave-one-out leaves row 11 out of the score. A second table
moves all points and declares the measurement frame unknown: the fit must not depend on where it stands.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.progress import track
from scipy.spatial.transform import Rotation

from calib.calibration import Calibration, calibrate
from calib.data.cell import Cell, Priors
from calib.data.measurements import Measurements
from calib.example import PAPER_TARGET, PAPER_TARGET_AS_PRINTED, paper_measurements, paper_urdf
from calib.numerics.errors import Errors
from calib.robot.robot import Robot, read_only


def cases() -> Iterator[tuple[str, Cell, str]]:
    """Label, cell and solver of each line."""
    paper = Cell(target=read_only(PAPER_TARGET), model="paper")
    yield "auto: the data choose (DH)", replace(paper, model="auto"), "lm"
    yield "the demo: DH and target, 27 parameters", paper, "lm"
    yield "the same by SciPy", paper, "scipy"
    yield "the paper's algorithm", paper, "paper"
    yield (
        "target as printed, sign turned",
        replace(paper, target=read_only(PAPER_TARGET_AS_PRINTED)),
        "lm",
    )
    yield (
        "priors of 3 mm and 15 mrad, not from the data",
        replace(paper, priors=Priors("given")),
        "lm",
    )
    yield (
        "no priors: plain least squares with robust weights",
        replace(paper, priors=Priors("off")),
        "lm",
    )
    yield (
        "measurement frame unknown too, 33 parameters",
        Cell(estimate_frame=True, model="dh"),
        "lm",
    )
    yield "Hayati: beta for d between parallel axes", replace(paper, model="hayati"), "lm"
    yield "full placements, 39 parameters", replace(paper, model="placement"), "lm"
    yield "joint zeros alone, 9 parameters", replace(paper, model="zeros"), "lm"
    yield "with gear gain, 33 parameters: no URDF", replace(paper, model="dh+gain"), "lm"
    yield "with eccentricity, 39 parameters: no URDF", replace(paper, model="dh+eccentricity"), "lm"


def line(label: str, result: Calibration) -> str:
    """One line of the table; of the non-geometric model where there is one."""
    non_geometric = result.non_geometric
    validation = (
        result.cross_validation if non_geometric is None else non_geometric.cross_validation
    )
    assert validation is not None
    numbers = np.array(result.measurements.rows)[result.measurements.estimation]
    held_out = Errors.of(validation.residual[numbers != 11])
    errors = result.errors["calibrated" if non_geometric is None else "non_geometric"]["validation"]
    flagged = " ".join(str(o.row) for o in result.outliers) or "-"
    return (
        f"| {label} | {1e3 * errors.max:.3f} | {1e3 * errors.mean:.3f} | {1e3 * errors.rms:.3f} "
        f"| {1e3 * held_out.rms:.3f} | {flagged} |"
    )


def moved(table: Measurements, length: float, degrees: float, seed: int) -> Measurements:
    """All points moved by a length [m] and turned by an angle [deg], each in a random direction."""
    shift, axis = np.random.default_rng(seed).normal(size=(2, 3))
    turn = Rotation.from_rotvec(np.deg2rad(degrees) * axis / np.linalg.norm(axis))
    return replace(
        table, points=table.points @ turn.as_matrix().T + length * shift / np.linalg.norm(shift)
    )


def frame_lines(robot: Robot, table: Measurements) -> Iterator[str]:
    """The lines of the second table."""
    for model in ("auto", "dh"):
        cell = Cell(estimate_frame=True, model=model)
        norms = {}
        for label, length, degrees, seeds in (
            ("as printed", 0.0, 0.0, range(1)),
            ("5 mm and 1 deg", 5e-3, 1.0, range(1, 3)),
            ("3 m and 120 deg", 3.0, 120.0, range(9, 11)),
        ):
            results = [
                calibrate(robot, moved(table, length, degrees, seed), cell=cell, validate=False)
                for seed in seeds
            ]
            rms = max(r.errors["calibrated"]["validation"].rms for r in results)
            norms[label] = np.array(
                [np.linalg.norm(r.residual_calibrated, axis=1) for r in results]
            )
            change = 1e3 * float(np.max(np.abs(norms[label] - norms["as printed"])))
            told = "-" if len(norms) == 1 else "below 1e-9" if change < 1e-9 else f"{change:.1e}"
            yield f"| {model}: {label} | {len(results)} | {1e3 * rms:.3f} | {told} |"


def main() -> None:
    """Print the tables in Markdown."""
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    table = Measurements.read(paper_measurements(), robot.joint_names, robot.joint_types)
    every = list(cases())
    results = [
        (label, calibrate(robot, table, cell=cell, solver=solver))
        for label, cell, solver in track(every, console=Console(stderr=True), transient=True)
    ]
    nominal = results[0][1].errors["nominal"]["validation"]
    print(
        "| rows 31 to 35 [mm] | max | mean | rms | leave-one-out rms, rows 1-30 without 11 | flagged |"
    )
    print("|---|---|---|---|---|---|")
    print(
        f"| nominal | {1e3 * nominal.max:.3f} | {1e3 * nominal.mean:.3f} | {1e3 * nominal.rms:.3f} | - | - |"
    )
    for label, result in results:
        print(line(label, result))
    print()
    print(
        "| frame unknown, points moved by | directions | rms of rows 31 to 35 [mm] | largest change of an error [mm] |"
    )
    print("|---|---|---|---|")
    for row in frame_lines(robot, table):
        print(row)


if __name__ == "__main__":
    main()
