"""``calib simulate --study``: many virtual cells, each fitted and verified, in figures with their spread."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from calib.errors import CalibError, choices

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from calib.cli.simulate_setup import Prepared
    from calib.simulate.study import Study, Trials

#: The result file's kind and version.
SCHEMA = "study 1"


def check_alone(outputs: dict[str, Path | None]) -> None:
    """Refuse files of a single simulation.

    Raises:
        CalibError: One was named.
    """
    named = [name for name, path in outputs.items() if path is not None]
    if named:
        message = f"A study writes no table and no truth; leave {choices(named)} out. --json keeps every trial."
        raise CalibError(message)


def print_study(
    prepared: Prepared,
    count: int,
    fit_model: str | None,
    executor: Executor | None,
    json: Path | None,
    *,
    planned: bool,
    force: bool,
    quiet: bool,
) -> None:
    """Do a study, write it and print it.

    Raises:
        CalibError: Options that do not go together, an unknown model, or no trial that came to an end.
    """
    from calib.cli.progress import progress_bar
    from calib.cli.words import AUTO, check_model
    from calib.simulate.study import study

    check_model(fit_model or AUTO, "--fit-model")
    trials = trials_of(prepared, fit_model or AUTO, planned=planned)
    with progress_bar("trials", quiet=quiet) as progress:
        found = study(trials, count, prepared.seed, executor, progress)
    if json is not None:
        write_study(study_table(found, trials, prepared.seed), json, overwrite=force)
    if not quiet:
        typer.echo(study_text(found, trials))
        if json is not None:
            typer.echo(f"\nWritten: {json}")


def trials_of(prepared: Prepared, fit_model: str, *, planned: bool) -> Trials:
    """What is done each time.

    Args:
        prepared: The scenario and its poses, as a single simulation has them.
        fit_model: What is fitted.
        planned: Whether poses are planned anew each time.

    Raises:
        CalibError: Poses were given, and are to be planned.
    """
    from dataclasses import replace

    from calib.simulate.study import Trials

    if planned and prepared.poses is not None:
        message = "--planned makes poses; leave --poses out, or leave --planned out to measure at those of the file."
        raise CalibError(message)
    scenario = prepared.scenario
    return Trials(
        scenario=scenario,
        # The fit knows what a person would tell it, and not what the robot is wrong in.
        cell=replace(scenario.cell, model=fit_model),
        poses=prepared.poses,
        sets=prepared.sets,
        count=prepared.count,
        validation=prepared.validation,
        planned=planned,
    )


def study_text(found: Study, trials: Trials) -> str:
    """The study in words and figures."""
    poses = _poses_text(trials)
    lines = [
        f"Study: {len(found.trials)} robots, each with errors of its own, {poses},",
        f"  calibrated, and verified at {_verified()} other poses.",
        "",
        f"{'Position error at unseen poses [mm]':<44}{'rms':>9}{'  90 % of robots between':>26}",
        _row("nominal", found.nominal_rms, found.range("nominal_rms")),
        _row("calibrated", found.rms, found.range("rms")),
        _row("calibrated, the worst pose of each", None, found.range("max")),
        "",
    ]
    forecast = found.forecast
    if forecast is not None:
        lines += [
            _row(
                "forecast before any measurement",
                forecast.rms,
                (forecast.rms_low, forecast.rms_high),
            ),
        ]
    stated = found.values("stated_rms")
    lines.append(
        _row(
            "what the fits say of themselves",
            float((stated**2).mean() ** 0.5),
            found.range("stated_rms"),
        )
    )
    covered = found.values("covered")
    if (covered == covered).all():
        lines.append(
            f"Inside the fits' own 95 % regions: {100 * covered.mean():.1f} % of the true positions."
        )
    lines += _counts(found)
    return "\n".join(lines)


def study_table(found: Study, trials: Trials, seed: int) -> dict[str, Any]:
    """The study as a table for a JSON file, SI units, the unit in the keys."""
    from dataclasses import asdict

    def shown(trial: Any) -> dict[str, Any]:  # noqa: ANN401
        units = {"nominal_rms": "_m", "rms": "_m", "max": "_m", "stated_rms": "_m", "sigma": "_m"}
        values = {name + units.get(name, ""): value for name, value in asdict(trial).items()}
        # NaN is no JSON: what there is not is null.
        return {name: None if value != value else value for name, value in values.items()}

    forecast = found.forecast
    return {
        "schema": SCHEMA,
        "seed": seed,
        "poses": {"count": _number(trials), "planned": trials.planned},
        "fit_model": trials.cell.model,
        "true_model": trials.scenario.model,
        "nominal_rms_m": found.nominal_rms,
        "rms_m": found.rms,
        "rms_standard_error_m": found.rms_error,
        "forecast_rms_m": None if forecast is None else forecast.rms,
        "failures": [{"seed": one, "reason": reason} for one, reason in found.failures],
        "trials": [shown(trial) for trial in found.trials],
    }


def write_study(table: dict[str, Any], path: Path, *, overwrite: bool) -> Path:
    """Write the table as JSON.

    Raises:
        FileError: The file exists, or cannot be written.
    """
    import json

    from calib.model.files import write_atomically

    text = json.dumps(table, indent=1, allow_nan=False) + "\n"
    return write_atomically(path, text.encode(), overwrite=overwrite)


def _counts(found: Study) -> list[str]:
    """Models, verdicts, outliers and failures, as far as there is something to say."""
    lines = []
    count = len(found.trials)
    models = found.counts("model")
    lines.append(
        "Fitted: " + ", ".join(f"{name} {100 * n / count:.0f} %" for name, n in models.items())
    )
    verdicts = found.counts("verdict")
    if set(verdicts) != {""}:
        lines.append(
            "Verdicts: "
            + ", ".join(f"{word} {100 * n / count:.0f} %" for word, n in verdicts.items())
        )
    outliers, named = int(found.values("outliers").sum()), int(found.values("flagged").sum())
    wrong = int(found.values("false_alarms").sum())
    if outliers:
        lines.append(f"Outliers: {named} of {outliers} named.")
    if wrong:
        lines.append(f"Rows named as outliers that are none: {wrong} in {count} fits.")
    if found.failures:
        seed, reason = found.failures[0]
        text = f"{len(found.failures)} trials ended with an error; the first, seed {seed}: {reason}"
        lines += textwrap.wrap(text, 100, break_on_hyphens=False)
    return lines


def _row(label: str, rms: float | None, between: tuple[float, float]) -> str:
    """A line of the table [mm]."""
    middle = f"{'':>9}" if rms is None else f"{1e3 * rms:>9.3f}"
    return f"{label:<44}{middle}{1e3 * between[0]:>15.3f} to {1e3 * between[1]:.3f}"


def _poses_text(trials: Trials) -> str:
    """How many poses, and how they were made."""
    number = _number(trials)
    if trials.poses is not None:
        return f"measured at the {number} poses given"
    return f"measured at {number} {'planned' if trials.planned else 'random'} poses"


def _number(trials: Trials) -> int:
    """Poses that are fitted each time."""
    return trials.count if trials.poses is None else trials.sets.count("estimate")


def _verified() -> int:
    """Poses of the verification."""
    from calib.simulate.study import VERIFIED

    return VERIFIED
