"""Calibrations of robots with known errors: the tables of docs/verification.md.

    python scripts/verification_study.py            all of it
    python scripts/verification_study.py --quick    few runs of each case
    python scripts/verification_study.py --only accuracy --only auto

Each run draws the errors anew, in the parameters of the stated model. `verification_truth` makes the true
positions without `calib.fit.estimate`, `verification_runs` the tables and the Cramer-Rao bounds. The name of
a case seeds its runs.
"""

from __future__ import annotations

import tempfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from arms import example_urdfs, load_arm
from scipy.stats import f as f_distribution
from studies import add_noise, rms_length, run_cases, study_parser, table_lines
from verification_runs import (
    Run,
    distances_run,
    pairs_run,
    planes_run,
    points_run,
    poses_run,
    sockets_run,
    with_known_payload,
)
from verification_truth import Truth, draw_joint_values

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.model.error_model import FRAME
from calib.numerics.errors import interval_factor
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.gravity import Payload
from calib.robot.robot import Robot
from calib.verbs.inspect.inspection import inspect

#: Figures of one run, by name.
Figures = dict[str, Any]

#: Figures of all runs of each case.
Results = Mapping[str, list[Figures]]

#: Noise of a coordinate [m].
NOISE = 0.1e-3

#: Smallest displacement of a row that counts as displaced [m].
DISPLACED = 4e-3

#: Largest error without noise, of 1e-8 m or less [m].
EXACT = 1e-8

#: Compliance of each joint [rad/Nm].
COMPLIANCE = 1e-5

#: A compliance whose standard deviation is below this is known to 30 % [rad/Nm].
KNOWN_COMPLIANCE = 3e-6

#: Largest share of runs that may miss a bar of nine in ten.
ONE_IN_TEN = 0.1


@dataclass(frozen=True, slots=True)
class Row:
    """A row of a table."""

    case: str
    bar: str
    value: str
    met: bool | None = None  # The bar is met; None where there is none


@dataclass(frozen=True, slots=True)
class Study:
    """Runs of some cases, and the table of them."""

    title: str
    cases: Callable[[], Sequence[str]]  # Names of the cases
    runs: tuple[int, int]  # Number of runs of each case, without and with --quick
    run: Callable[[str, np.random.Generator], Figures]  # One run of a case, from its random numbers
    rows: Callable[[Results], Iterator[Row]]  # The rows of the table


def column(runs: Sequence[Figures], name: str) -> Any:  # noqa: ANN401  an array of any sort
    """Return a figure of all runs, shape (R,)."""
    return np.array([run[name] for run in runs])


def rms_of(runs: Sequence[Figures], name: str) -> float:
    """Return the root mean square of a figure over all runs."""
    return float(np.sqrt(np.mean(column(runs, name) ** 2)))


def ratio(runs: Sequence[Figures], error: str = "error", bound: str = "bound") -> float:
    """Return the root mean square of a figure over all runs, over that of another.

    Args:
        runs: The runs.
        error: Name of the first figure.
        bound: Name of the second figure.
    """
    squares = np.sum(column(runs, error) ** 2)
    return float(np.sqrt(squares / np.sum(column(runs, bound) ** 2)))


def ratio_text(runs: Sequence[Figures], error: str = "error", bound: str = "bound") -> str:
    """Return `ratio` with its standard error, which comes from the number of runs."""
    value = ratio(runs, error, bound)
    errors = column(runs, error)
    bounds = column(runs, bound)
    spread = np.std(errors**2 - (value * bounds) ** 2) / np.mean(bounds**2)
    return f"{value:.3f} ± {spread / (2.0 * value * np.sqrt(len(runs))):.3f}"


def chosen_model(result: Calibration) -> str:
    """Return the name of the model, of the non-geometric one where there is one."""
    if result.non_geometric is not None:
        return result.non_geometric.name
    return result.model.name


def counts_text(words: Iterable[str]) -> str:
    """Return how often each word comes, the most frequent first: ``dh 12, zeros 1``."""
    return ", ".join(f"{word} {count}" for word, count in Counter(words).most_common())


# Accuracy against the bound


def accuracy_cases() -> list[str]:
    """Return the cases: model, measurement frame and number of poses."""
    return [
        f"{model}, {frame}, {count}"
        for model in ("auto", "dh")
        for frame in ("base", "tracker")
        for count in (30, 60, 300)
    ]


def accuracy(case: str, rng: np.random.Generator) -> Figures:
    """Calibrate a UR3 with errors of its DH parameters, measured by a tracker."""
    model, frame, count = case.split(", ")
    truth = Truth.draw(load_arm("ur3"), rng)
    sigma = float(rng.uniform(0.5, 1.0)) * NOISE
    run = points_run(truth, rng, int(count), sigma, trackers=frame == "tracker")
    result = calibrate(truth.nominal, run.measurements, cell=run.cell, model=model, validate=False)
    return {
        "error": rms_length(run.errors(result)),
        "bound": np.sqrt(run.bound),
        "sigma": result.noise.sigma["m"] / sigma,
        "model": chosen_model(result),
    }


def accuracy_rows(results: Results) -> Iterator[Row]:
    """Yield the error over the bound of each case."""
    for case, runs in results.items():
        model, frame, count = case.split(", ")
        limit = 1.10 if count == "30" else 1.05
        text = f"{ratio_text(runs)} (rms {1e3 * rms_of(runs, 'error'):.3f} mm)"
        if model == "auto":
            text += f"; chosen {counts_text(run['model'] for run in runs)}"
        where = "in the base's frame" if frame == "base" else "tracker frame unknown"
        label = f"`{model}`, N = {count}, {where}"
        yield Row(label, f"<= {limit}", text, ratio(runs) <= limit)


# Intervals


def coverage_cases() -> list[str]:
    """Return the cases: robot, number of poses and measurement frame."""
    return ["ur3, 30, base", "ur3, 60, base", "ur3, 60, tracker", "ur3, 300, base"]


def coverage(case: str, rng: np.random.Generator) -> Figures:
    """Count how often 95 % intervals of parameters and predictions contain the truth."""
    arm, count, frame = case.split(", ")
    truth = Truth.draw(load_arm(arm), rng)
    run = points_run(truth, rng, int(count), NOISE, trackers=frame == "tracker")
    result = calibrate(truth.nominal, run.measurements, cell=run.cell, model="dh", validate=False)
    true = true_values(truth, result)
    inside = [
        parameter.low <= true[parameter.name] <= parameter.high
        for parameter in result.parameters
        if parameter.identifiable and parameter.name in true
    ]
    coordinates, points = prediction_coverage(run, result)
    return {
        "parameters": float(np.mean(inside)),
        "count": len(inside),
        "coordinates": coordinates,
        "points": points,
        "error": rms_length(run.errors(result)),
        "bound": float(np.sqrt(np.mean(result.position_std(run.q) ** 2))),
    }


def prediction_coverage(run: Run, result: Calibration) -> tuple[float, float]:
    """Return the shares of coordinates and of points in 3-D that are inside their 95 % intervals and regions."""
    errors = run.errors(result)
    estimate = result.fit.geometry.estimate
    samples = result.samples(run.q)
    _, J = result.fit.geometry.kinematics.twists(estimate.x, samples, rotation=False)
    covariance = np.einsum("nij,jk,nlk->nil", J, estimate.covariance, J)
    std = np.sqrt(np.einsum("nii->ni", covariance))
    whitened = np.linalg.solve(covariance, errors[:, :, None])[..., 0]
    square = np.einsum("ni,ni->n", errors, whitened)
    limit = 3.0 * f_distribution.ppf(0.95, 3.0, estimate.freedom)
    coordinates = np.abs(errors) <= interval_factor(estimate.freedom) * std
    return float(np.mean(coordinates)), float(np.mean(square <= limit))


def true_values(truth: Truth, result: Calibration) -> dict[str, float]:
    """Return the true value of each parameter whose value does not depend on the registration."""
    model = result.model
    drawn = dict(zip(model.names, truth.x, strict=False))
    values = {}
    for parameter in model.parameters[: len(truth.x)]:
        if parameter.family != FRAME:
            values[parameter.name] = parameter.nominal + float(drawn[parameter.name])
    for axis, value in zip("xyz", truth.targets[0, :3, 3], strict=True):
        values[f"target_{axis}"] = float(value)
    return values


def coverage_rows(results: Results) -> Iterator[Row]:
    """Yield the shares that are inside, over all runs of each case."""
    titles = {
        "parameters": "identifiable parameters",
        "coordinates": "coordinates of other points",
        "points": "other points in 3-D",
    }
    for case, runs in results.items():
        arm, count, frame = case.split(", ")
        where = "base known" if frame == "base" else "tracker unknown"
        label = f"{arm.upper()}, N = {count}, {where}"
        for name, title in titles.items():
            share = float(np.mean(column(runs, name)))
            met = 0.93 <= share <= 0.97
            yield Row(f"{label}: {title}", "93 to 97 %", f"{100 * share:.1f} %", met)
        yield Row(f"{label}: rms error over rms `position_std`", "", f"{ratio(runs):.3f}")


# Displaced rows


def outlier_cases() -> list[str]:
    """Return the cases: the number of poses."""
    return ["30", "60", "120", "300"]


def outliers(case: str, rng: np.random.Generator) -> Figures:
    """Calibrate a table with a fifth of its rows displaced, with these undisplaced, and without them."""
    truth = Truth.draw(load_arm("ur3"), rng)
    run = points_run(truth, rng, int(case), NOISE, displaced=0.2)
    table = run.measurements
    true_points = truth.points(np.array(table.joints))
    displaced = np.linalg.norm(table.points - true_points, axis=1) > DISPLACED
    # The noise of a displaced row cannot be had back; the undisplaced one has other noise.
    fresh = add_noise(true_points, NOISE, rng)
    clean = replace(table, points=np.where(displaced[:, None], fresh, table.points))

    def calibrated(measurements: Measurements) -> Calibration:
        """Return the calibration of a table."""
        return calibrate(truth.nominal, measurements, cell=run.cell, model="dh", validate=False)

    result = calibrated(table)
    flagged = {outlier.row for outlier in result.rows.outliers}
    rows = {table.rows[i] for i in np.flatnonzero(displaced)}
    return {
        "error": rms_length(run.errors(result)),
        "clean": rms_length(run.errors(calibrated(clean))),
        "kept": rms_length(run.errors(calibrated(table.select(~displaced)))),
        "rows": len(table),
        "displaced": len(rows),
        "missed": len(rows - flagged),
        "wrongly": len(flagged - rows),
    }


def outlier_rows(results: Results) -> Iterator[Row]:
    """Yield the error over that of the clean table, and how many rows are flagged."""
    for case, runs in results.items():
        label = f"UR3, {case} poses"
        text = ratio_text(runs, "error", "clean")
        text += f"; over the fit of the other rows {ratio(runs, 'error', 'kept'):.4f}"
        met = ratio(runs, "error", "clean") <= 1.2
        yield Row(f"{label}: error over the clean table's", "<= 1.2", text, met)
        names = ("rows", "displaced", "missed", "wrongly")
        rows, displaced, missed, wrongly = (int(np.sum(column(runs, name))) for name in names)
        flagged = f"{displaced - missed} of {displaced}"
        text = f"{flagged} ({wrongly} good ones of {rows - displaced})"
        yield Row(f"{label}: displaced rows that are flagged", "all", text, missed == 0)


# Models that `auto` chooses

#: Models that are no larger than the true one.
ALLOWED = {
    "nothing": ("frames",),
    "zeros": ("frames", "zeros"),
    "dh": ("frames", "zeros", "dh", "hayati"),
    "dh+compliance": (
        "frames",
        "zeros",
        "dh",
        "hayati",
        "zeros+compliance",
        "dh+compliance",
        "hayati+compliance",
        # Lever arms explain bending as masses do, and so does a gain at few poses.
        "zeros+gravity",
        "dh+gravity",
        "hayati+gravity",
        "dh+gain",
    ),
}


def auto_cases() -> list[str]:
    """Return the cases: robot, model of its errors and number of poses."""
    errors = ("ur3, nothing", "ur3, zeros", "ur3, dh", "iiwa, dh+compliance")
    return [f"{error}, {count}" for count in (60, 12) for error in errors]


def auto(case: str, rng: np.random.Generator) -> Figures:
    """Calibrate with the model that `auto` chooses, and with frames alone."""
    arm, errors, count = case.split(", ")
    model = "frames" if errors == "nothing" else errors
    geometry = model.partition("+")[0]
    compliance, payload = 0.0, None
    if errors == "dh+compliance":
        compliance, payload = COMPLIANCE, Payload(5.0, np.array([0.04, 0.02, 0.1]))
    truth = Truth.draw(load_arm(arm), rng, geometry, compliance=compliance, payload=payload)
    run = with_known_payload(points_run(truth, rng, int(count), NOISE, trackers=1, model=model))
    result = calibrate(truth.nominal, run.measurements, cell=run.cell)
    frames = calibrate(
        truth.nominal, run.measurements, cell=run.cell, model="frames", validate=False
    )
    by_geometry = result.predict(run.q, non_geometric=False)
    return {
        "model": chosen_model(result),
        "error": rms_length(run.errors(result)),
        "geometry": rms_length(run.true[:, :3, 3] - by_geometry),
        "frames": rms_length(run.errors(frames)),
        "bound": float(np.sqrt(run.bound)),
    }


def auto_rows(results: Results) -> Iterator[Row]:
    """Yield the chosen models, and the errors over those of frames alone."""
    for case, runs in results.items():
        arm, errors, count = case.split(", ")
        label = f"{arm}, errors: {errors}, {count} poses"
        larger = sum(run["model"] not in ALLOWED[errors] for run in runs)
        models = counts_text(run["model"] for run in runs)
        bar = "none larger than the true one in nine of ten"
        yield Row(f"{label}: chosen models", bar, models, larger <= ONE_IN_TEN * len(runs))
        frames = column(runs, "frames")
        ratios = column(runs, "error") / frames
        worst = np.maximum(ratios, column(runs, "geometry") / frames)
        beyond = int(np.sum(worst > 1.02))
        text = f"median {np.median(ratios):.3f}, worst {np.max(worst):.3f}; {beyond} runs beyond"
        bar = "<= 1.02 in nine of ten"
        yield Row(f"{label}: error over frames only", bar, text, beyond <= ONE_IN_TEN * len(runs))


# Every robot


def robot_cases() -> list[str]:
    """Return the cases: every robot of example-robot-data."""
    return list(example_urdfs())


def robots(case: str, rng: np.random.Generator) -> Figures:
    """Load a robot, inspect it, calibrate it with points without noise, write its URDF and read it back."""
    robot = Robot.load(example_urdfs()[case])
    inspected = inspect(robot, Cell(model="dh"))
    truth = Truth.draw(robot, rng)
    q = draw_joint_values(robot, 20 + 6 * len(robot.joints), rng)
    q_other = draw_joint_values(robot, 100, rng)
    prismatic = tuple(joint.name for joint in robot.inputs if joint.type == "prismatic")
    table = Measurements(robot.joint_names, q, truth.points(q), prismatic=prismatic)
    result = calibrate(robot, table, model="dh", validate=False)
    true = truth.points(q_other)
    with tempfile.TemporaryDirectory() as folder:
        path = result.write_urdf(Path(folder) / "corrected.urdf", target_link=True)
        corrected = Robot.load(path, base=robot.base, tip="calib_target", held=robot.held)
        by_file = corrected.poses(q_other)[:, :3, 3]
    return {
        "joints": len(robot.joints),
        "rank": inspected.observability.rank,
        "columns": inspected.observability.columns,
        "error": float(np.linalg.norm(result.predict(q_other) - true, axis=1).max()),
        "written": float(np.linalg.norm(by_file - true, axis=1).max()),
    }


def robot_rows(results: Results) -> Iterator[Row]:
    """Yield the largest error of all robots, and each that misses the bar."""
    errors = {case: float(runs[0]["written"]) for case, runs in results.items()}
    joints = [runs[0]["joints"] for runs in results.values()]
    worst = max(errors, key=errors.__getitem__)
    label = f"{len(errors)} robots, {min(joints)} to {max(joints)} joints"
    text = f"{errors[worst]:.1e} m ({worst})"
    met = errors[worst] <= EXACT
    yield Row(f"{label}: largest error at 100 other poses", "<= 1e-8 m", text, met)
    for case, error in errors.items():
        if not error <= EXACT:
            yield Row(f"beyond it: {case}", "<= 1e-8 m", f"{error:.1e} m", met=False)


# Compliance


def compliance_cases() -> list[str]:
    """Return the cases: payload [kg] and number of poses."""
    return ["0, 100", "5, 100"]


def compliance(case: str, rng: np.random.Generator) -> Figures:
    """Calibrate an iiwa with a compliance on each joint."""
    mass, count = (int(word) for word in case.split(", "))
    payload = Payload(mass, np.array([0.05, 0.03, 0.1]))
    truth = Truth.draw(load_arm("iiwa"), rng, compliance=COMPLIANCE, payload=payload)
    model = "dh+compliance"
    run = points_run(truth, rng, count, 0.5 * NOISE, trackers=1, model=model)
    run = with_known_payload(run)
    result = calibrate(truth.nominal, run.measurements, cell=run.cell, model=model, validate=False)
    fitted = result.non_geometric
    if fitted is None:
        raise RuntimeError("The fit has no compliances.")
    inside, std = {}, {}
    for estimate, parameter in zip(fitted.parameters, fitted.model.parameters, strict=True):
        if parameter.family == "compliance":
            inside[estimate.name] = estimate.low <= COMPLIANCE <= estimate.high
            std[estimate.name] = estimate.std
    return {
        "inside": inside,
        "std": std,
        "error": rms_length(run.errors(result)),
        "bound": float(np.sqrt(run.bound)),
    }


def compliance_rows(results: Results) -> Iterator[Row]:
    """Yield the shares of compliances inside their intervals: of all, and of those that the rows determine."""
    for case, runs in results.items():
        label = f"iiwa, payload {case.split(', ')[0]} kg"
        inside_text = f"{label}: compliances inside their 95 % intervals"
        every, known = [], []
        for run in runs:
            for name, hit in run["inside"].items():
                every.append(hit)
                if run["std"][name] < KNOWN_COMPLIANCE:
                    known.append(hit)
        # A compliance that is not measured keeps its prior's interval, which contains the truth nearly always.
        share = float(np.mean(every))
        yield Row(f"{inside_text}, all seven", ">= 93 %", share_text(every), share >= 0.93)
        met = 0.93 <= float(np.mean(known)) <= 0.97
        yield Row(f"{inside_text}, those known to 30 %", "93 to 97 %", share_text(known), met)
        medians = [np.median([run["std"][name] for run in runs]) for name in runs[0]["std"]]
        text = ", ".join(f"{1e6 * median:.1f}" for median in medians)
        yield Row(f"{label}: median std of joints 1 to 7 [urad/Nm]", "", text)
        met = ratio(runs) <= 1.05
        yield Row(f"{label}: error over the bound", "<= 1.05", ratio_text(runs), met)


def share_text(hits: Sequence[bool]) -> str:
    """Return the share of hits, ``95.0 % (19 of 20)``."""
    return f"{100 * float(np.mean(hits)):.1f} % ({sum(hits)} of {len(hits)})"


# Kinds of measurement

#: Draw a run of each kind, from a robot and random numbers.
KINDS: Mapping[str, Callable[[Truth, np.random.Generator], Run]] = {
    "pose": partial(poses_run, count=60, sigma=NOISE, sigma_angle=1e-3),
    "distance": partial(distances_run, count=150, sigma=NOISE),
    "pair": partial(pairs_run, count=150, sigma=NOISE),
    "fixed": partial(sockets_run, count=120, sigma=NOISE),
    "plane": partial(planes_run, count=210, sigma=NOISE),
    "two targets": partial(points_run, count=80, sigma=NOISE, trackers=1),
    "two set-ups": partial(points_run, count=80, sigma=NOISE, trackers=2),
    "two targets in two set-ups": partial(points_run, count=80, sigma=NOISE, trackers=2),
}


def kind_cases() -> list[str]:
    """Return the cases: the kinds."""
    return list(KINDS)


def kinds(case: str, rng: np.random.Generator) -> Figures:
    """Calibrate a UR3 with one kind of measurement."""
    robot = load_arm("ur3")
    targets = 2 if "targets" in case else 1
    truth = Truth.draw(robot, rng, targets=targets, rotation=case == "pose")
    run = KINDS[case](truth, rng)
    result = calibrate(robot, run.measurements, cell=run.cell, model="dh", validate=False)
    figures = {"error": rms_length(run.errors(result)), "bound": float(np.sqrt(run.bound))}
    if run.bound_angle:
        figures["angle"] = float(np.sqrt(np.mean(run.angles(result) ** 2)))
        figures["bound_angle"] = float(np.sqrt(run.bound_angle))
    return figures


def kind_rows(results: Results) -> Iterator[Row]:
    """Yield the error over the bound of each kind."""
    for case, runs in results.items():
        label = case.replace("set-ups", "stations")
        text = f"{ratio_text(runs)} (rms {1e3 * rms_of(runs, 'error'):.3f} mm)"
        yield Row(f"{label}: positions", "<= 1.05", text, ratio(runs) <= 1.05)
        if "angle" in runs[0]:
            text = ratio_text(runs, "angle", "bound_angle")
            text += f" (rms {1e3 * rms_of(runs, 'angle'):.3f} mrad)"
            met = ratio(runs, "angle", "bound_angle") <= 1.05
            yield Row(f"{label}: orientations", "<= 1.05", text, met)


# All studies

STUDIES: Mapping[str, Study] = {
    "accuracy": Study(
        "Error at other poses over the Cramer-Rao bound",
        accuracy_cases,
        (200, 20),
        accuracy,
        accuracy_rows,
    ),
    "coverage": Study(
        "95 % intervals and predicted uncertainty",
        coverage_cases,
        (500, 30),
        coverage,
        coverage_rows,
    ),
    "outliers": Study(
        "A fifth of the rows displaced by 5 to 50 mm",
        outlier_cases,
        (200, 10),
        outliers,
        outlier_rows,
    ),
    "auto": Study("Models that `auto` chooses", auto_cases, (50, 4), auto, auto_rows),
    "robots": Study(
        "Every robot of example-robot-data, without noise",
        robot_cases,
        (1, 1),
        robots,
        robot_rows,
    ),
    "compliance": Study(
        "Compliance of 1e-5 rad/Nm on each joint",
        compliance_cases,
        (600, 10),
        compliance,
        compliance_rows,
    ),
    "kinds": Study("Each kind of measurement", kind_cases, (300, 10), kinds, kind_rows),
}


def run_one(name: str, case: str, number: int) -> Figures:
    """Return the figures of one run of a study's case; an error names the run."""
    rng = np.random.default_rng([zlib.crc32(f"{name}/{case}".encode()), number])
    try:
        return STUDIES[name].run(case, rng)
    except Exception as error:
        raise RuntimeError(f"study {name}, case {case}, run {number}: {error}") from error


def run_study(
    name: str, runs: int, cases: Sequence[str] | None = None, workers: int = 1
) -> dict[str, list[Figures]]:
    """Run the cases of a study.

    Args:
        name: Name of the study.
        runs: Number of runs of each case.
        cases: The cases; None: all of them.
        workers: Number of processes.

    Returns:
        Figures of all runs of each case.
    """
    if cases is None:
        cases = STUDIES[name].cases()
    run = partial(run_one, name)
    return dict(run_cases(run, cases, range(runs), workers=workers, label=name))


def study_text(name: str, runs: int, results: Results) -> str:
    """Return title and table of a study in Markdown.

    Args:
        name: Name of the study.
        runs: Number of runs of each case.
        results: Figures of the runs.
    """
    study = STUDIES[name]
    marks = {None: "", True: "yes", False: "**no**"}
    rows = ((row.case, row.bar, row.value, marks[row.met]) for row in study.rows(results))
    lines = [f"### {study.title}", ""]
    if runs > 1:
        lines += [f"{runs} runs of each.", ""]
    lines += table_lines(("case", "bar", "value", "met"), rows)
    return "\n".join(lines)


def main() -> None:
    """Print the tables in Markdown."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("--quick", action="store_true", help="few runs of each case")
    parser.add_argument("--only", action="append", choices=sorted(STUDIES), help="one study")
    arguments = parser.parse_args()
    for name in arguments.only or STUDIES:
        runs = STUDIES[name].runs[1 if arguments.quick else 0]
        results = run_study(name, runs, workers=arguments.workers)
        print(study_text(name, runs, results), end="\n\n", flush=True)


if __name__ == "__main__":
    main()
