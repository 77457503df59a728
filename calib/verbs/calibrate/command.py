"""``calib calibrate``: a URDF and a table in, a corrected URDF out."""

from __future__ import annotations

import typer

from calib.cli.executor import executor_of
from calib.cli.loading import load_with_data
from calib.cli.notices import say_accepted, say_ignored, say_unused_camera
from calib.cli.options import (
    DataFile,
    FitOptions,
    Quiet,
    RobotFile,
    SolverOptions,
    TableOptions,
)
from calib.cli.terminal import progress_bar, say
from calib.cli.verb import verb
from calib.errors import VerdictError
from calib.verbs.calibrate.interval_options import Intervals
from calib.verbs.calibrate.outputs import Outputs


@verb("""Calibrate a robot from measurements.

\b
Examples:
  calib calibrate robot.urdf data.csv -o corrected.urdf
  calib calibrate robot.urdf data.csv --base base --tip tool0 --target "70 -70 22.5 mm" \\
        -o corrected.urdf --json result.json --report report.html --view view.html
  calib calibrate robot.urdf tracker.csv --frame estimate -o corrected.urdf
  calib calibrate robot.urdf joints.csv --points tracker.txt --frame estimate -o corrected.urdf
  calib calibrate robot.urdf data.csv --columns "J1=joint_1 [deg]" --columns "X=x [mm]" ...
  calib calibrate robot.urdf data.csv --bootstrap 1000 --seed 1 --profile alpha2

The table holds one row a pose: a column for each joint, such as "joint_1 [deg]", and the measured point "x [mm]",
"y [mm]", "z [mm]". Orientations, distances, balls in sockets and touched planes can be measured too; see
docs/data-format.md. An optional column "set" says which rows are for estimation ("estimate") and which for validation
("validate"). Where the verdict is "do not use", -o writes no URDF, and the exit status is 3; --accept writes it.
""")
def calibrate(
    robot: RobotFile,
    data: DataFile,
    cell_options: FitOptions,
    table_options: TableOptions,
    outputs: Outputs,
    intervals: Intervals,
    solver_options: SolverOptions,
    quiet: Quiet = False,
) -> None:
    """Load, fit, write the files and print the summary; exit status 3 if the verdict withheld the URDF."""
    intervals.check()
    outputs.check([robot, data, cell_options.file, table_options.points])
    samples = intervals.bootstrap
    with executor_of(intervals.workers, intervals.dask, samples, default=1) as executor:
        cell = cell_options.cell()
        solver_options.check()
        arm, measurements = load_with_data(robot, cell, data, table_options)

        from calib.result.calibrate import calibrate as calibrate_robot
        from calib.show.verdict import against, refusal

        with progress_bar("cross-validation", quiet=quiet, first="fits") as progress:
            result = calibrate_robot(
                arm,
                measurements,
                cell=cell,
                solver=solver_options.solver,
                robust=solver_options.robust,
                validate=solver_options.validate,
                progress=progress,
            )
        interval_texts, tables = intervals.compute(result, executor, quiet=quiet)
    # Files first: a reader of the text that goes away (head, less) must not cost the results.
    written = list(outputs.write(result, tables, quiet=quiet))
    if not quiet:
        say_ignored(measurements, arm)
        say_unused_camera(measurements, cell)
        say("\n\n".join([result.summary(), *interval_texts]) + "\n")
        for path in written:
            typer.echo(f"Written: {path}")
        if outputs.output is None and result.verdict is None:
            typer.echo(
                "No URDF was written (no -o), and there is no verdict because of --no-validate."
            )
        elif outputs.output is None and not against(result.verdict):
            typer.echo("No URDF was written; add -o corrected.urdf to write it.")

    stated = against(result.verdict)
    if outputs.output is None or not stated:
        return
    if outputs.accept:
        say_accepted(f"'{outputs.output}'", stated)
        return
    message = refusal("this calibration", stated)
    if outputs.output.exists():
        message += f" '{outputs.output}' is an earlier one."
    raise VerdictError(message)
