"""``calib calibrate``: a URDF and a table in, a corrected URDF out."""

from __future__ import annotations

from dataclasses import asdict

import typer

from calib.cli.options import (
    DataFile,
    FitOptions,
    Quiet,
    RobotFile,
    Robust,
    SolverName,
    TableOptions,
    Validate,
    verb,
)
from calib.cli.outputs import Intervals, Outputs
from calib.cli.setup import executor_of, load_with_data, read_cell, say_accepted, say_ignored
from calib.cli.terminal import progress_bar, say
from calib.errors import CalibError, VerdictError


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
("validate"). Where the verdict is "do not use", no URDF is written, and the exit status is 3; --accept writes it.
""")
def calibrate(
    robot: RobotFile,
    data: DataFile,
    setup: FitOptions,
    table: TableOptions,
    outputs: Outputs,
    intervals: Intervals,
    solver: SolverName = "lm",
    robust: Robust = True,
    validate: Validate = True,
    quiet: Quiet = False,
) -> None:
    """See the text of `verb`."""
    count = intervals.bootstrap
    for option in ("seed", "workers", "dask"):
        if getattr(intervals, option) is not None and count is None:
            raise CalibError(
                f"--{option} is for the samples of --bootstrap; say how many, such as --bootstrap 1000."
            )
    outputs.check([robot, data, *(path for path in (setup.cell, table.points) if path)])
    with executor_of(intervals.workers, intervals.dask, count, default=1) as executor:
        cell = read_cell(**asdict(setup))
        arm, rows = load_with_data(robot, cell, data, **asdict(table))

        from calib.calibration import calibrate as calibrated

        with progress_bar("cross-validation", quiet=quiet) as progress:
            result = calibrated(
                arm,
                rows,
                cell=cell,
                solver=solver,
                robust=robust,
                validate=validate,
                progress=progress,
            )
        texts, tables = intervals.compute(result, executor, quiet=quiet)
    from calib.text.verdict import against, refusal

    stated = against(result.verdict)
    # Files first: a reader of the text that goes away (head, less) must not cost the results.
    written = list(outputs.write(result, tables, quiet=quiet))
    if not quiet:
        say_ignored(rows, arm)
        say("\n\n".join([result.summary(), *texts]) + "\n")
        for path in written:
            typer.echo(f"Written: {path}")
        if outputs.output is None and result.verdict is None:
            typer.echo(
                "No URDF was written. There is no verdict on one: --no-validate leaves it out."
            )
        elif outputs.output is None and not stated:
            typer.echo("No URDF was written; add -o corrected.urdf to write it.")
    if outputs.output is None or not stated:
        return
    if not outputs.accept:
        earlier = f" '{outputs.output}' is an earlier one." * outputs.output.exists()
        raise VerdictError(refusal("this calibration", stated) + earlier)
    say_accepted(f"'{outputs.output}'", stated)
