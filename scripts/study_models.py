"""Studies of what is picked, of every robot, of compliance, and of each kind of measurement."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from study_robots import ROBOTS, Truth, example_files, joints_of
from study_runs import (
    Run,
    lengths_run,
    points_run,
    poses_run,
    touching_run,
    with_known_payload,
)
from study_table import NOISE, Found, Line, counted, picked, ratio, ratio_words, rms

from calib.calibration import calibrate
from calib.identify.inspection import inspect
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.model.robot import Robot

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
    geometry = run.true[:, :3, 3] - result.predict(run.q, larger=False)
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
                "no more than is there",
                f"{counted(r['picked'] for r in runs)}",
                more == 0,
            ),
            Line(
                f"{label}: error over frames only",
                "<= 1.02 in every run",
                f"median {np.median(against[:, 0]):.3f}, worst {np.max(against):.3f}; {worse} runs beyond",
                worse == 0,
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
    assert result.larger is not None
    inside, std, of = {}, {}, result.larger.model
    for p, parameter in zip(result.larger.parameters, of.parameters, strict=True):
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
