"""Studies of a UR3 measured by a tracker: error against the bound, intervals, displaced rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.stats import f as f_distribution
from study_robots import ROBOTS, Truth
from study_runs import points_run
from study_table import NOISE, Found, Line, counted, picked, ratio, ratio_words, rms

from calib.calibration import Calibration, calibrate
from calib.identify.statistics import interval_factor
from calib.model.parameters import FRAME

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
    _, J = result.fitted.kinematics.points_jacobian(estimate.x, result.samples(run.q))
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
