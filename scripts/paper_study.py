"""The figures of docs/paper.md: readings of the paper, parameter sets and solvers on its rows.

    .venv/bin/python scripts/paper_study.py

Rows 1 to 30 are fitted; rows 31 to 35 are only predicted. Leave-one-out leaves row 11 out of the score.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.progress import track

from calib.data import PAPER_TARGET, PAPER_TARGET_AS_PRINTED, paper_measurements, paper_urdf
from calib.identify.calibration import Calibration, calibrate
from calib.identify.statistics import Errors
from calib.measure.cell import Cell, Priors
from calib.measure.measurements import Measurements
from calib.model.robot import Robot, read_only


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
    """One line of the table; of the larger model where there is one."""
    larger = result.larger
    validation = result.cross_validation if larger is None else larger.cross_validation
    assert validation is not None
    numbers = np.array(result.measurements.rows)[result.measurements.estimation]
    left_out = Errors.of(validation.residual[numbers != 11])
    errors = result.errors["calibrated" if larger is None else "larger"]["validation"]
    flagged = " ".join(str(o.row) for o in result.outliers) or "-"
    return (
        f"| {label} | {1e3 * errors.max:.3f} | {1e3 * errors.mean:.3f} | {1e3 * errors.rms:.3f} "
        f"| {1e3 * left_out.rms:.3f} | {flagged} |"
    )


def main() -> None:
    """Print the table in Markdown."""
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


if __name__ == "__main__":
    main()
