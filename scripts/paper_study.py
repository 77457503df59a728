"""Readings of the paper, parameter sets and solvers on the paper's rows: the figures of docs/paper.md.

    python scripts/paper_study.py

Rows 1 to 30 are fitted, rows 31 to 35 are only predicted. Leave-one-out errors are without row 11. A second table moves
all points and has the measurement frame unknown: the fit must not depend on where the frame is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation
from studies import print_table, show_progress, study_parser

from calib.basics.arrays import Array, read_only
from calib.data.cell import Cell, Priors
from calib.data.measurements import Measurements
from calib.example import PAPER_TARGET, PAPER_TARGET_AS_PRINTED, paper_measurements, paper_urdf
from calib.numerics.errors import Errors
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.robot import Robot

#: The row with a gross error, which no leave-one-out error counts.
BAD_ROW = 11

#: Displacements of all points in the second table: title, length [m], angle [deg], seeds of the directions.
MOVES = (
    ("as printed", 0.0, 0.0, range(1)),
    ("5 mm and 1 deg", 5e-3, 1.0, range(1, 3)),
    ("3 m and 120 deg", 3.0, 120.0, range(9, 11)),
)


def cases() -> Iterator[tuple[str, Cell, str]]:
    """Yield title, cell and solver of each fit."""
    paper = Cell(target=read_only(PAPER_TARGET), model="paper")
    as_printed = replace(paper, target=read_only(PAPER_TARGET_AS_PRINTED))
    given_priors = replace(paper, priors=Priors("given"))
    no_priors = replace(paper, priors=Priors("off"))
    frame_unknown = Cell(estimate_frame=True, model="dh")
    yield "auto: the data choose (DH)", replace(paper, model="auto"), "lm"
    yield "the demo: DH and target, 27 parameters", paper, "lm"
    yield "the same by SciPy", paper, "scipy"
    yield "the paper's algorithm", paper, "paper"
    yield "target as printed, sign turned", as_printed, "lm"
    yield "priors of 3 mm and 15 mrad, not from the data", given_priors, "lm"
    yield "no priors: plain least squares with robust weights", no_priors, "lm"
    yield "measurement frame unknown too, 33 parameters", frame_unknown, "lm"
    for title, model in (
        ("Hayati: beta for d between parallel axes", "hayati"),
        ("full placements, 39 parameters", "placement"),
        ("joint zeros alone, 9 parameters", "zeros"),
        ("with gear gain, 33 parameters: no URDF", "dh+gain"),
        ("with eccentricity, 39 parameters: no URDF", "dh+eccentricity"),
    ):
        yield title, replace(paper, model=model), "lm"


def errors_cells(errors: Errors) -> list[str]:
    """Return largest, mean and rms error [mm]."""
    figures = errors["m"]
    return [f"{1e3 * value:.3f}" for value in (figures.max, figures.mean, figures.rms)]


def fit_row(title: str, result: Calibration) -> list[str]:
    """Return the row of a fit, of its non-geometric model where there is one."""
    model, validation = "calibrated", result.cross_validation
    if result.non_geometric is not None:
        model, validation = "non_geometric", result.non_geometric.cross_validation
    if validation is None:
        raise RuntimeError("The fit was not cross-validated.")
    numbers = np.array(result.fit.measurements.rows)[result.fit.measurements.estimation]
    held_out = Errors.of(validation.residual[numbers != BAD_ROW])
    flagged = " ".join(str(outlier.row) for outlier in result.rows.outliers)
    errors = result.errors[model]["validation"]
    return [title, *errors_cells(errors), f"{1e3 * held_out['m'].rms:.3f}", flagged or "-"]


def fit_rows(robot: Robot, table: Measurements) -> Iterator[list[str]]:
    """Yield the rows of the nominal robot and of each fit."""
    fits = list(cases())
    for number, (title, cell, solver) in enumerate(show_progress(fits, "fits")):
        result = calibrate(robot, table, cell=cell, solver=solver)
        if number == 0:
            nominal = result.errors["nominal"]["validation"]
            yield ["nominal", *errors_cells(nominal), "-", "-"]
        yield fit_row(title, result)


def moved(table: Measurements, length: float, angle: float, seed: int) -> Measurements:
    """Return a table whose points are all moved in a random direction.

    Args:
        table: The table.
        length: Length of the displacement [m].
        angle: Angle of the rotation [deg].
        seed: Of the random directions.
    """
    direction, axis = np.random.default_rng(seed).normal(size=(2, 3))
    R = Rotation.from_rotvec(np.deg2rad(angle) * axis / np.linalg.norm(axis)).as_matrix()
    displacement = length * direction / np.linalg.norm(direction)
    return replace(table, points=table.points @ R.T + displacement)


def frame_rows(robot: Robot, table: Measurements) -> Iterator[list[str]]:
    """Yield the rows of the second table."""
    for model in ("auto", "dh"):
        cell = Cell(estimate_frame=True, model=model)
        unmoved: Array | None = None  # errors of the rows as printed, shape (1, N)
        for title, length, angle, seeds in MOVES:
            results = [
                calibrate(robot, moved(table, length, angle, seed), cell=cell, validate=False)
                for seed in seeds
            ]
            rms = max(result.errors["calibrated"]["validation"]["m"].rms for result in results)
            errors = [np.linalg.norm(result.rows.residual_calibrated, axis=1) for result in results]
            text = "-"
            if unmoved is None:
                unmoved = np.array(errors)
            else:
                change = 1e3 * float(np.max(np.abs(errors - unmoved)))
                text = "below 1e-9" if change < 1e-9 else f"{change:.1e}"
            yield [f"{model}: {title}", str(len(results)), f"{1e3 * rms:.3f}", text]


def main() -> None:
    """Print the tables."""
    study_parser(__doc__).parse_args()
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    table = Measurements.read(paper_measurements(), robot.joint_names, robot.joint_types)
    titles = ["rows 31 to 35 [mm]", "max", "mean", "rms"]
    titles += ["leave-one-out rms, rows 1-30 without 11", "flagged"]
    print_table(titles, fit_rows(robot, table))
    print()
    titles = ["frame unknown, points moved by", "directions"]
    titles += ["rms of rows 31 to 35 [mm]", "largest change of an error [mm]"]
    print_table(titles, frame_rows(robot, table))


if __name__ == "__main__":
    main()
