"""The table of docs/verification.md: what calib finds of robots whose errors are known.

    .venv/bin/python scripts/verification_study.py            all of it, on all cores
    .venv/bin/python scripts/verification_study.py --quick    few runs of each
    .venv/bin/python scripts/verification_study.py --only accuracy --only auto

Seeds are fixed: every call gives the same numbers. Errors are drawn anew in each run, in the parameters that the robot
is said to be wrong in; `verification_truth` makes the true positions without `calib.estimate`, `verification_runs` the
tables and the Cramer-Rao bounds.
"""

from __future__ import annotations

import argparse
import functools
import multiprocessing
import os
import sys
import tempfile
import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as f_distribution
from verification_runs import (
    Run,
    lengths_run,
    points_run,
    poses_run,
    touching_run,
    with_known_payload,
)
from verification_truth import ROBOTS, Truth, example_files, joints_of

from calib.calibration import Calibration, calibrate
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.inspection import inspect
from calib.model.parameters import FRAME
from calib.numerics.intervals import interval_factor
from calib.robot.robot import Robot

Array = NDArray[np.float64]
Found = dict[str, Any]

#: Noise of a tracker [m].
NOISE = 0.1e-3


@dataclass(frozen=True, slots=True)
class Line:
    """One line of the table; ``met`` is None where there is no bar."""

    case: str
    bar: str
    found: str
    met: bool | None = None


@dataclass(frozen=True, slots=True)
class Study:
    """One study.

    Attributes:
        title: In words.
        cases: Names of its cases.
        runs: How many runs of each case, in full and quickly.
        one: One run of a case, from its random numbers.
        lines: The lines of the table, from the runs of each case.
    """

    title: str
    cases: Callable[[], Sequence[str]]
    runs: tuple[int, int]
    one: Callable[[str, np.random.Generator], Found]
    lines: Callable[[Mapping[str, list[Found]]], list[Line]]


def rms(residuals: Array) -> float:
    """Root of the mean squared length."""
    return float(np.sqrt(np.mean(np.sum(residuals**2, axis=1))))


def ratio(found: list[Found], error: str = "error", bound: str = "bound") -> float:
    """Root mean square error over all runs, over that of the bound."""
    errors, bounds = (np.array([f[name] for f in found]) for name in (error, bound))
    return float(np.sqrt(np.sum(errors**2) / np.sum(bounds**2)))


def ratio_words(found: list[Found], error: str = "error", bound: str = "bound") -> str:
    """The same with its standard error, which the number of runs leaves."""
    value = ratio(found, error, bound)
    errors, bounds = (np.array([f[name] for f in found]) for name in (error, bound))
    spread = np.std(errors**2 - (value * bounds) ** 2) / np.mean(bounds**2)
    return f"{value:.3f} ± {spread / (2.0 * value * np.sqrt(len(found))):.3f}"


def picked(result: Calibration) -> str:
    """The models that were chosen: geometry, and the larger one where there is one."""
    return result.model.name if result.non_geometric is None else result.non_geometric.name


def counted(words: Iterable[str]) -> str:
    """How often each word came, most often first."""
    return ", ".join(f"{word} {n}" for word, n in Counter(words).most_common())


# ---- accuracy against the bound ----


def accuracy_cases() -> list[str]:
    """Model, measurement frame and number of poses."""
    return [
        f"{model}, {where}, {count}"
        for model in ("auto", "dh")
        for where in ("base", "tracker")
        for count in (30, 60, 300)
    ]


def accuracy(case: str, rng: np.random.Generator) -> Found:
    """A UR3 wrong in its DH parameters, measured by a tracker."""
    model, where, count = case.split(", ")
    truth = Truth.draw(ROBOTS["ur3"](), rng)
    sigma = float(rng.uniform(0.5, 1.0)) * NOISE
    run = points_run(truth, rng, int(count), sigma, tracker=where == "tracker")
    result = calibrate(truth.nominal, run.measurements, cell=run.cell, model=model, validate=False)
    return {
        "error": rms(run.residuals(result)),
        "bound": np.sqrt(run.bound),
        "sigma": result.sigma / sigma,
        "picked": picked(result),
        "flagged": len(result.outliers),
    }


def accuracy_lines(found: Mapping[str, list[Found]]) -> list[Line]:
    """Ratio of each case."""
    lines = []
    for case, runs in found.items():
        model, where, count = case.split(", ")
        bar, value = (1.10 if count == "30" else 1.05), ratio(runs)
        error = 1e3 * float(np.sqrt(np.mean([r["error"] ** 2 for r in runs])))
        words = f"{ratio_words(runs)} (rms {error:.3f} mm)"
        if model == "auto":
            words += f"; picked {counted(r['picked'] for r in runs)}"
        frame = "in the base's frame" if where == "base" else "tracker's place unknown"
        lines.append(Line(f"`{model}`, N = {count}, {frame}", f"<= {bar}", words, value <= bar))
    return lines


# ---- intervals ----


def coverage_cases() -> list[str]:
    """Robot, number of poses, frame."""
    return ["ur3, 30, base", "ur3, 60, base", "ur3, 60, tracker", "ur3, 300, base"]


def coverage(case: str, rng: np.random.Generator) -> Found:
    """Whether 95 % intervals of parameters and predictions hold the truth."""
    name, count, where = case.split(", ")
    truth = Truth.draw(ROBOTS[name](), rng)
    run = points_run(truth, rng, int(count), NOISE, tracker=where == "tracker")
    result = calibrate(truth.nominal, run.measurements, cell=run.cell, model="dh", validate=False)
    true = true_values(truth, result)
    inside = [
        p.low <= true[p.name] <= p.high
        for p in result.parameters
        if p.identifiable and p.name in true
    ]
    residuals = run.residuals(result)
    estimate = result.fitted.estimate
    _, J = result.fitted.kinematics.twists(estimate.x, result.samples(run.q), rotation=False)
    spread = np.einsum("nij,jk,nlk->nil", J, estimate.covariance, J)
    std = np.sqrt(np.einsum("nii->ni", spread))
    square = np.einsum(
        "ni,ni->n", residuals, np.linalg.solve(spread, residuals[:, :, None])[..., 0]
    )
    freedom = estimate.freedom
    return {
        "parameters": float(np.mean(inside)),
        "count": len(inside),
        "coordinates": float(np.mean(np.abs(residuals) <= interval_factor(freedom) * std)),
        "points": float(np.mean(square <= 3.0 * f_distribution.ppf(0.95, 3.0, freedom))),
        "error": rms(residuals),
        "bound": float(np.sqrt(np.mean(result.position_std(run.q) ** 2))),
    }


def true_values(truth: Truth, result: Calibration) -> dict[str, float]:
    """The true value of each parameter that has one without regard to where registration put anything."""
    model = result.model
    drawn = dict(zip(model.names, truth.x, strict=False))
    values = {
        p.name: p.nominal + float(drawn[p.name])
        for p in model.parameters[: len(truth.x)]
        if p.family != FRAME
    }
    for axis, value in zip("xyz", truth.targets[0, :3, 3], strict=True):
        values[f"target_{axis}"] = float(value)
    return values


def coverage_lines(found: Mapping[str, list[Found]]) -> list[Line]:
    """The share inside, over all runs."""
    lines = []
    for case, runs in found.items():
        name, count, where = case.split(", ")
        label = (
            f"{name.upper()}, N = {count}, {'base known' if where == 'base' else 'tracker unknown'}"
        )
        for what, words in (
            ("parameters", "identifiable parameters"),
            ("coordinates", "coordinates of unseen points"),
            ("points", "unseen points in 3-D"),
        ):
            share = float(np.mean([r[what] for r in runs]))
            lines.append(
                Line(
                    f"{label}: {words}", "93 to 97 %", f"{100 * share:.1f} %", 0.93 <= share <= 0.97
                )
            )
        value = ratio(runs)
        lines.append(Line(f"{label}: rms error over rms `position_std`", "", f"{value:.3f}"))
    return lines


# ---- displaced rows ----


def outlier_cases() -> list[str]:
    """Number of poses."""
    return ["30", "60", "120", "300"]


def outliers(case: str, rng: np.random.Generator) -> Found:
    """A fifth of the rows displaced, and the same table without."""
    truth = Truth.draw(ROBOTS["ur3"](), rng)
    run = points_run(truth, rng, int(case), NOISE, displaced=0.2)
    table = run.measurements
    clean_points = truth.points(np.array(table.joints))
    # The noise of a row that is displaced is lost in it; the clean table has another there.
    gross = np.linalg.norm(table.points - clean_points, axis=1) > 4e-3
    again = clean_points + NOISE * rng.normal(size=clean_points.shape)
    clean = replace(table, points=np.where(gross[:, None], again, table.points))
    error = {}
    for name, one in (("error", table), ("clean", clean), ("kept", table.select(~gross))):
        result = calibrate(truth.nominal, one, cell=run.cell, model="dh", validate=False)
        error[name] = rms(run.residuals(result))
        if name == "error":
            flagged = {o.row for o in result.outliers}
    named = {table.rows[i] for i in np.flatnonzero(gross)}
    return {
        **error,
        "missed": len(named - flagged),
        "wrongly": len(flagged - named),
        "rows": len(table),
        "gross": len(named),
    }


def outlier_lines(found: Mapping[str, list[Found]]) -> list[Line]:
    """Error over that of the clean table, rows flagged."""
    lines = []
    for case, runs in found.items():
        value, kept = ratio(runs, "error", "clean"), ratio(runs, "error", "kept")
        missed, gross = (sum(r[k] for r in runs) for k in ("missed", "gross"))
        wrongly = sum(r["wrongly"] for r in runs)
        lines += [
            Line(
                f"UR3, {case} poses: error over the clean table's",
                "<= 1.2",
                f"{ratio_words(runs, 'error', 'clean')}; over the fit of the other rows {kept:.4f}",
                value <= 1.2,
            ),
            Line(
                f"UR3, {case} poses: displaced rows that are flagged",
                "all",
                f"{gross - missed} of {gross} ({wrongly} good ones of {sum(r['rows'] for r in runs) - gross})",
                missed == 0,
            ),
        ]
    return lines


# ---- auto ----

#: What may be picked, and no more, where a robot is wrong in this.
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
        # Lever arms tell what bends as masses do, and so does a gain at few poses.
        "zeros+gravity",
        "dh+gravity",
        "hayati+gravity",
        "dh+gain",
    ),
}


def auto_cases() -> list[str]:
    """Robot, what is wrong, number of poses."""
    return [
        f"{robot}, {wrong}, {count}"
        for count in (60, 12)
        for robot, wrong in (
            ("ur3", "nothing"),
            ("ur3", "zeros"),
            ("ur3", "dh"),
            ("iiwa", "dh+compliance"),
        )
    ]


def auto(case: str, rng: np.random.Generator) -> Found:
    """What is picked, and how it predicts beside frames alone."""
    name, wrong, count = case.split(", ")
    model = {"nothing": "frames", "dh+compliance": "dh"}.get(wrong, wrong)
    soft = 1e-5 if "compliance" in wrong else 0.0
    load = {"compliance": soft, "payload": 5.0 if soft else 0.0, "com": (0.04, 0.02, 0.1)}
    truth = Truth.draw(ROBOTS[name](), rng, model, **load)  # type: ignore[arg-type]
    run = points_run(truth, rng, int(count), NOISE, tracker=True, model=wrong_as_fitted(wrong))
    run = with_known_payload(run) if soft else run
    result = calibrate(truth.nominal, run.measurements, cell=run.cell)
    frames = calibrate(
        truth.nominal, run.measurements, cell=run.cell, model="frames", validate=False
    )
    geometry = run.true[:, :3, 3] - result.predict(run.q, non_geometric=False)
    return {
        "picked": picked(result),
        "error": rms(run.residuals(result)),
        "geometry": rms(geometry),
        "frames": rms(run.residuals(frames)),
        "bound": float(np.sqrt(run.bound)),
    }


def wrong_as_fitted(wrong: str) -> str:
    """The model that a robot's errors belong to."""
    return "frames" if wrong == "nothing" else wrong


def auto_lines(found: Mapping[str, list[Found]]) -> list[Line]:
    """Picks, and the worst against frames only."""
    lines = []
    for case, runs in found.items():
        name, wrong, count = case.split(", ")
        more = sum(r["picked"] not in ALLOWED[wrong] for r in runs)
        against = np.array([[r["error"], r["geometry"]] for r in runs])
        against /= np.array([[r["frames"]] for r in runs])
        worse = int(np.sum(np.max(against, axis=1) > 1.02))
        label = f"{name}, wrong: {wrong}, {count} poses"
        lines += [
            Line(
                f"{label}: picks",
                "no more than is there in nine of ten",
                f"{counted(r['picked'] for r in runs)}",
                more <= 0.1 * len(runs),
            ),
            Line(
                f"{label}: error over frames only",
                "<= 1.02 in nine of ten",
                f"median {np.median(against[:, 0]):.3f}, worst {np.max(against):.3f}; {worse} runs beyond",
                worse <= 0.1 * len(runs),
            ),
        ]
    return lines


# ---- every robot ----


def robot_cases() -> list[str]:
    """Every robot of example-robot-data."""
    return list(example_files())


def robots(case: str, rng: np.random.Generator) -> Found:
    """Load, inspect, calibrate points without noise, write and read back."""
    robot = Robot.load(example_files()[case])
    inspected = inspect(robot, Cell(model="dh"))
    truth = Truth.draw(robot, rng)
    count = 20 + 6 * len(robot.joints)
    q, unseen = joints_of(robot, count, rng), joints_of(robot, 100, rng)
    prismatic = tuple(j.name for j in robot.inputs if j.type == "prismatic")
    table = Measurements(robot.joint_names, q, truth.points(q), prismatic=prismatic)
    result = calibrate(robot, table, model="dh", validate=False)
    error = np.linalg.norm(result.predict(unseen) - truth.points(unseen), axis=1)
    with tempfile.TemporaryDirectory() as folder:
        written = result.write_urdf(Path(folder) / "corrected.urdf", target_link=True)
        again = Robot.load(written, base=robot.base, tip="calib_target", held=robot.held)
        by_file = np.linalg.norm(again.poses(unseen)[:, :3, 3] - truth.points(unseen), axis=1)
    return {
        "joints": len(robot.joints),
        "rank": inspected.observability.rank,
        "columns": inspected.observability.columns,
        "error": float(error.max()),
        "written": float(by_file.max()),
    }


def robot_lines(found: Mapping[str, list[Found]]) -> list[Line]:
    """The worst of all robots, and each that misses the bar."""
    every = {case: runs[0] for case, runs in found.items()}
    worst = max(every, key=lambda case: float(every[case]["written"]))
    error = float(every[worst]["written"])
    missed = {c: r["written"] for c, r in every.items() if not r["written"] <= 1e-8}
    joints = [r["joints"] for r in every.values()]
    what = f"{len(every)} robots, {min(joints)} to {max(joints)} joints: largest error at 100 unseen poses"
    lines = [Line(what, "<= 1e-8 m", f"{error:.1e} m ({worst})", error <= 1e-8)]
    lines += [Line(f"beyond it: {c}", "<= 1e-8 m", f"{e:.1e} m", False) for c, e in missed.items()]
    return lines


# ---- compliance ----


#: A compliance of 1e-5 is known to 30 % below this [rad/Nm].
TOLD = 3e-6


def compliance_cases() -> list[str]:
    """Payload [kg] and number of poses."""
    return ["0, 100", "5, 100"]


def compliance(case: str, rng: np.random.Generator) -> Found:
    """An iiwa with 1e-5 rad/Nm on each joint."""
    payload, count = (int(word) for word in case.split(", "))
    truth = Truth.draw(
        ROBOTS["iiwa"](), rng, compliance=1e-5, payload=payload, com=(0.05, 0.03, 0.1)
    )
    model = "dh+compliance"
    run = with_known_payload(points_run(truth, rng, count, 0.5 * NOISE, tracker=True, model=model))
    result = calibrate(truth.nominal, run.measurements, cell=run.cell, model=model, validate=False)
    assert result.non_geometric is not None
    inside, std, of = {}, {}, result.non_geometric.model
    for p, parameter in zip(result.non_geometric.parameters, of.parameters, strict=True):
        if parameter.family == "compliance":
            inside[p.name] = p.low <= 1e-5 <= p.high
            std[p.name] = p.std
    return {
        "inside": inside,
        "std": std,
        "error": rms(run.residuals(result)),
        "bound": float(np.sqrt(run.bound)),
    }


def compliance_lines(found: Mapping[str, list[Found]]) -> list[Line]:
    """The share of compliances inside their intervals, all of them and those that the measurements tell."""
    lines = []
    for case, runs in found.items():
        label = f"iiwa, payload {case.split(', ')[0]} kg"
        every = [hit for r in runs for hit in r["inside"].values()]
        told = [r["inside"][n] for r in runs for n, std in r["std"].items() if std < TOLD]
        # What is not measured keeps its prior's interval, which holds the truth nearly always.
        for words, hits, highest in (
            ("all seven", every, 1.0),
            ("those known to 30 %", told, 0.97),
        ):
            share = float(np.mean(hits))
            count = f"{100 * share:.1f} % ({sum(hits)} of {len(hits)})"
            what = f"{label}: compliances inside their 95 % intervals, {words}"
            bar = ">= 93 %" if highest == 1.0 else "93 to 97 %"
            lines.append(Line(what, bar, count, 0.93 <= share <= highest))
        widths = [np.median([r["std"][n] for r in runs]) for n in runs[0]["std"]]
        words = ", ".join(f"{1e6 * w:.1f}" for w in widths)
        lines.append(Line(f"{label}: median std of joints 1 to 7 [urad/Nm]", "", words))
        value = ratio(runs)
        lines.append(
            Line(f"{label}: error over the bound", "<= 1.05", ratio_words(runs), value <= 1.05)
        )
    return lines


# ---- kinds of measurement ----


def kind_cases() -> list[str]:
    """Kinds and set-ups."""
    return [
        "pose",
        "distance",
        "pair",
        "fixed",
        "plane",
        "two targets",
        "two set-ups",
        "two targets in two set-ups",
    ]


def kinds(case: str, rng: np.random.Generator) -> Found:
    """Each kind of measurement, on the UR3."""
    robot = ROBOTS["ur3"]()
    truth = Truth.draw(robot, rng, targets=2 if "targets" in case else 1, rotation=case == "pose")
    run = kind_run(case, truth, rng)
    result = calibrate(robot, run.measurements, cell=run.cell, model="dh", validate=False)
    found = {"error": rms(run.residuals(result)), "bound": float(np.sqrt(run.bound))}
    if run.bound_angle:
        found["angle"] = float(np.sqrt(np.mean(run.angles(result) ** 2)))
        found["bound_angle"] = float(np.sqrt(run.bound_angle))
    return found


def kind_run(case: str, truth: Truth, rng: np.random.Generator) -> Run:
    """The table of one kind."""
    if case == "pose":
        return poses_run(truth, rng, 60, NOISE, 1e-3)
    if case in ("distance", "pair"):
        return lengths_run(truth, rng, 150, NOISE, case)
    if case in ("fixed", "plane"):
        return touching_run(truth, rng, 120 if case == "fixed" else 210, NOISE, case)
    setups = 2 if "set-ups" in case else 1
    return points_run(truth, rng, 80, NOISE, tracker=True, setups=setups)


def kind_lines(found: Mapping[str, list[Found]]) -> list[Line]:
    """Ratio of each kind."""
    lines = []
    for case, runs in found.items():
        for name, unit, bound in (("error", "mm", "bound"), ("angle", "mrad", "bound_angle")):
            if name in runs[0]:
                value = ratio(runs, name, bound)
                error = 1e3 * float(np.sqrt(np.mean([r[name] ** 2 for r in runs])))
                what = "positions" if name == "error" else "orientations"
                words = f"{ratio_words(runs, name, bound)} (rms {error:.3f} {unit})"
                lines.append(Line(f"{case}: {what}", "<= 1.05", words, value <= 1.05))
    return lines


# ---- all of them ----

STUDIES: Mapping[str, Study] = {
    "accuracy": Study(
        "Error on unseen poses over the Cramer-Rao bound",
        accuracy_cases,
        (200, 20),
        accuracy,
        accuracy_lines,
    ),
    "coverage": Study(
        "95 % intervals and predicted uncertainty",
        coverage_cases,
        (500, 30),
        coverage,
        coverage_lines,
    ),
    "outliers": Study(
        "A fifth of the rows displaced by 5 to 50 mm",
        outlier_cases,
        (200, 10),
        outliers,
        outlier_lines,
    ),
    "auto": Study("What `auto` picks", auto_cases, (50, 4), auto, auto_lines),
    "robots": Study(
        "Every robot of example-robot-data, without noise",
        robot_cases,
        (1, 1),
        robots,
        robot_lines,
    ),
    "compliance": Study(
        "Compliance of 1e-5 rad/Nm on each joint",
        compliance_cases,
        (600, 10),
        compliance,
        compliance_lines,
    ),
    "kinds": Study("Each kind of measurement", kind_cases, (300, 10), kinds, kind_lines),
}


def generator(study: str, case: str, number: int) -> np.random.Generator:
    """The random numbers of one run."""
    return np.random.default_rng([zlib.crc32(f"{study}/{case}".encode()), number])


def run_one(study: str, case: str, number: int) -> Found:
    """One run; what it raises names the run."""
    try:
        return STUDIES[study].one(case, generator(study, case, number))
    except Exception as error:
        raise RuntimeError(f"study {study}, case {case}, run {number}: {error}") from error


def run_study(
    name: str,
    runs: int,
    executor: Executor | None = None,
    cases: Sequence[str] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, list[Found]]:
    """All runs of some cases, in order."""
    chosen = STUDIES[name].cases() if cases is None else cases
    jobs = [(case, number) for case in chosen for number in range(runs)]
    found: dict[tuple[str, int], Found] = {}
    if executor is None:
        for case, number in jobs:
            found[case, number] = run_one(name, case, number)
    else:
        futures = {executor.submit(run_one, name, *job): job for job in jobs}
        for done, future in enumerate(as_completed(futures), start=1):
            found[futures[future]] = future.result()
            if progress is not None:
                progress(done, len(jobs))
    return {case: [found[case, number] for number in range(runs)] for case in chosen}


def markdown(title: str, runs: int, lines: Sequence[Line]) -> str:
    """A table."""
    head = f"### {title}\n\n{runs} runs of each.\n\n" if runs > 1 else f"### {title}\n\n"
    rows = [
        f"| {line.case} | {line.bar} | {line.found} | "
        f"{'' if line.met is None else 'yes' if line.met else '**no**'} |"
        for line in lines
    ]
    return head + "\n".join(["| case | bar | found | met |", "|---|---|---|---|", *rows]) + "\n"


def _tell(name: str, began: float, done: int, every: int) -> None:
    """A progress line."""
    if done % max(1, every // 100) == 0 or done == every:
        sys.stderr.write(f"\r{name}: {done} of {every} runs, {time.monotonic() - began:.0f} s ")
        sys.stderr.write("\n" if done == every else "")
        sys.stderr.flush()


def main() -> None:
    """Print the tables in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--quick", action="store_true", help="few runs of each case")
    parser.add_argument("--only", action="append", choices=sorted(STUDIES), help="one study")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes")
    arguments = parser.parse_args()
    # The matrices are small: threads of one worker would only stand in the way of the others.
    os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(arguments.workers, mp_context=context) as executor:
        for name in arguments.only or STUDIES:
            study = STUDIES[name]
            runs = study.runs[1 if arguments.quick else 0]
            tell = functools.partial(_tell, name, time.monotonic())
            found = run_study(name, runs, executor, progress=tell)
            print(markdown(study.title, runs, study.lines(found)), flush=True)


if __name__ == "__main__":
    main()
