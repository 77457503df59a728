"""``calib simulate``: a table of a robot whose errors are known, and the truth beside it; or a study of many."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated

import typer

from calib.cli.options import Dask, Force, ModelOptions, Quiet, RobotFile, Workers, verb
from calib.cli.setup import check_outputs, executor_of, load, read_cell
from calib.errors import CalibError, choices

_Text = str | None
_File = Path | None
_SIZES = 'Standard deviations, "length 0.5 mm, angle 3 mrad", or none. Default: typical; none with --error.'
_ERROR = 'One error, "elbow_joint.rx=2 mrad". Can be repeated.'
_NOISE = (
    'Of a coordinate: "0.05 mm", "15 um + 6 um/m", or none. Default: the cell\'s, or a tracker\'s.'
)
_PLACE = "Standard deviation of the targets' places. Default: 1 mm."
_EXTRA = "Random poses for validation. Default: 10; 0 with --poses."


@dataclass(frozen=True, slots=True)
class ScenarioOptions:
    """What is wrong with the robot, and what disturbs the measurements."""

    sizes: Annotated[_Text, typer.Option(metavar='"FAMILY VALUE, ..."', help=_SIZES)] = None
    error: Annotated[list[str] | None, typer.Option(metavar="NAME=VALUE", help=_ERROR)] = None
    truth_robot: Annotated[_File, typer.Option(help="URDF of the true robot.")] = None
    target_error: Annotated[_Text, typer.Option(help=_PLACE)] = None
    noise: Annotated[_Text, typer.Option(help=_NOISE)] = None
    outliers: Annotated[_Text, typer.Option(metavar='N|"P %"', help="Rows far off.")] = None


@verb("""Simulate measurements of a robot whose errors are known.

\b
Examples:
  calib simulate ur3 --base base --tip tool0 -o table.csv
  calib simulate robot.urdf --poses plan.csv --seed 2 -o table.csv --truth truth.json
  calib simulate robot.urdf --count 50 --validation 20 --frame estimate -o table.csv
  calib simulate robot.urdf --error "elbow_joint.rx=2 mrad" --noise none -o table.csv
  calib simulate robot.urdf --count 30 --planned --study 200

It writes a table for calib calibrate and the truth beside it: the robot's errors, targets, frames and what happened in
which row. The same seed gives the same files. --model is the error model of the simulated robot, placement by default;
--target is the nominal place of the target, 50 50 50 mm by default. The cell file's table [simulation] has encoder
resolution, drift, a moved target and more. A study repeats simulation, calibration and verification with other robots.
""")
def simulate(
    robot: RobotFile,
    setup: ModelOptions,
    words: ScenarioOptions,
    poses: Annotated[_File, typer.Option(help="Poses, from this plan or table.")] = None,
    count: Annotated[int, typer.Option(min=1, metavar="N", help="Random poses.")] = 30,
    validation: Annotated[int | None, typer.Option(min=0, help=_EXTRA)] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of all random numbers.")] = 0,
    output: Annotated[_File, typer.Option("-o", "--output", help="Write the table.")] = None,
    truth: Annotated[_File, typer.Option(help="Default: TABLE_truth.json.")] = None,
    truth_urdf: Annotated[_File, typer.Option(help="Write the URDF of the true robot.")] = None,
    study: Annotated[
        int | None, typer.Option(min=2, help="Simulate and calibrate N robots.")
    ] = None,
    planned: Annotated[bool, typer.Option("--planned", help="Of a study: plan the poses.")] = False,
    fit_model: Annotated[_Text, typer.Option(help="Of a study: what is estimated.")] = None,
    workers: Workers = None,
    dask: Dask = None,
    json: Annotated[_File, typer.Option(help="Of a study: write every trial as JSON.")] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """See the text of `verb`."""
    of_one = {"-o": output, "--truth": truth, "--truth-urdf": truth_urdf}
    of_study = {"--fit-model": fit_model, "--json": json, "--planned": planned or None}
    if unfit := [n for n, v in (of_study if study is None else of_one).items() if v is not None]:
        raise CalibError(
            f"{choices(unfit)} does not go {'without' if study is None else 'with'} --study."
        )
    if study is None and output is None:
        raise CalibError("Name the table to write: -o table.csv.")
    truth = truth or (output and output.with_name(f"{output.stem}_truth.json"))
    inputs = [robot, *(str(path) for path in (poses, setup.cell, words.truth_robot) if path)]
    check_outputs([output, truth, truth_urdf, json], inputs, force=force)
    # Workers begin first: they import what they need while robot and scenario are prepared here.
    with executor_of(workers, dask, study) as executor:
        import calib.simulation.scenario as cells
        import calib.simulation.study as studies
        from calib.cli.terminal import progress_bar
        from calib.design.plan import read_poses
        from calib.result.calibration_file import write_table
        from calib.text import simulation as text

        cell = read_cell(**asdict(setup))
        arm = load(robot, cell)
        scenario = cells.read_scenario(arm, cell, setup.cell, **asdict(words))
        given, sets = (None, ()) if poses is None else read_poses(poses, arm)[:2]
        extra = (10 if given is None else 0) if validation is None else validation
        if study is None:
            assert output is not None and truth is not None  # noqa: PT018
            made = cells.simulate(scenario, count, extra, seed, given, sets)
            made.measurements.write(output, overwrite=force)
            written = [output, cells.write_truth(scenario, made, truth, overwrite=force)]
            if truth_urdf is not None:
                written.append(made.truth.write_urdf(truth_urdf, overwrite=force))
            said = text.simulated_text(scenario, made)
        else:
            # The fit knows what a person would tell it, and not what the robot is wrong in.
            told = replace(cell, model=fit_model or "auto")
            trials = studies.Trials(scenario, told, given, sets, count, extra, planned)
            with progress_bar("trials", quiet=quiet) as progress:
                found = studies.study(trials, study, seed, executor, progress)
            table = studies.study_table(found, trials, seed)
            written = [write_table(table, json, overwrite=force)] if json else []
            said = text.study_text(found, trials)
    if not quiet:
        typer.echo("\n".join([f"{said}\n", *(f"Written: {path}" for path in written)]))
