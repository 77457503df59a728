"""``calib check``: by a few fresh poses, has anything moved since a calibration, and what?"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import typer

from calib.cli.exit_status import ExitStatus
from calib.cli.options import CellOptions, Force, Quiet, Seed, TableOptions
from calib.cli.output_files import check_outputs, written_lines
from calib.cli.terminal import say
from calib.cli.verb import verb
from calib.errors import CalibError
from calib.verbs.detect.picture_folder import table_of


@dataclass(frozen=True, slots=True)
class CheckCell(CellOptions):
    """The cell file alone: frames, targets, links and errors are those of the result."""

    names: ClassVar[tuple[str, ...] | None] = ()


@verb("""Check with a few fresh poses whether anything has moved since a calibration.

\b
Examples:
  calib check result.json --plan 3 -o poses.csv
  calib check result.json this_morning.csv
  calib check result.json this_morning.csv --tolerance "0.2 mm" --json check.json -o more_poses.csv
  calib check result.json this_morning_images

RESULT is a result of 'calib calibrate --json', which contains the robot. DATA are fresh rows, three poses or pictures,
or a folder with pictures and their joint values in joints.csv. The answer is that nothing has moved, or what has: the
camera or tracker, the board or target, the base, the zero of a joint, each with its probability. If several causes
explain the rows, it says how many more poses would tell, and -o writes them. --plan chooses the poses before anything
is measured. The exit status is 0 if nothing has moved, and 3 otherwise.
""")
def check(
    result: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT", help="Result of a calibration, as 'calib calibrate --json' writes it."
        ),
    ],
    *,
    cell_options: CheckCell,
    table_options: TableOptions,
    data: Annotated[
        Path | None,
        typer.Argument(
            metavar="[DATA]", help="Table with a few fresh rows, or a folder of pictures."
        ),
    ] = None,
    tolerance: Annotated[
        str | None,
        typer.Option(
            "--tolerance",
            metavar="LENGTH",
            help='Change of positions that does not matter: "0.2 mm". Default: the expected error of the result.',
        ),
    ] = None,
    plan: Annotated[
        int | None,
        typer.Option(
            "--plan",
            metavar="N",
            min=1,
            help="Choose N poses to check at, in place of a check of DATA.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE",
            help="Write the poses of --plan, or those that would tell what has moved, as a table, .csv.",
        ),
    ] = None,
    json: Annotated[Path | None, typer.Option("--json", help="Write the check as JSON.")] = None,
    seed: Seed = 0,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Check, or choose poses; write the files and print the answer; exit status 3 if something has moved."""
    from calib.basics.units import LENGTH, parse_amount
    from calib.result.calibration_file import read_result
    from calib.verbs.check.check import check as check_rows, read_fresh
    from calib.verbs.check.check_file import write_check
    from calib.verbs.check.poses import check_poses, further_poses
    from calib.verbs.check.text import check_text, poses_text

    if (data is None) == (plan is None):
        raise CalibError(
            "Give either DATA, fresh rows to check, or --plan with a number of poses to choose."
        )
    if plan is not None and (json is not None or tolerance is not None):
        raise CalibError("--json and --tolerance are of a check: leave them out with --plan.")
    check_outputs(
        [output, json], [result, data, cell_options.file, table_options.points], force=force
    )
    allowed = None
    if tolerance is not None:
        allowed = parse_amount(tolerance, "--tolerance", LENGTH, "0.2 mm")
    cell = cell_options.cell()
    stored = read_result(result)
    if plan is not None:
        poses = check_poses(stored, plan, cell, seed=seed)
        if output is not None:
            poses.write(output, overwrite=force)
        if not quiet:
            say("\n".join([poses_text(poses), *written_lines(output)]))
        return

    assert data is not None
    known = stored.complete_cell(cell)
    with table_of(
        data, list(known.boards.values()), list(known.cameras.values()), quiet=quiet
    ) as path:
        points, unit = table_options.points, table_options.points_unit
        rows = read_fresh(stored, path, table_options.parsed(), points, unit)
    checked = check_rows(stored, rows, cell, tolerance=allowed)
    more = None
    if checked.outcome == "undecided":
        try:
            more = further_poses(checked, cell, seed=seed)
        except CalibError:
            if output is not None:  # which poses would tell is only a remark otherwise
                raise
    written = [json]
    if json is not None:
        write_check(checked, json, more, overwrite=force)
    if more is not None and output is not None:
        more.write(output, overwrite=force, first_row=max(rows.rows, default=0) + 1)
        written.append(output)
    if not quiet:
        say(check_text(checked, more))
        lines = written_lines(*written)
        if output is not None and more is None:
            lines.append(f"Not written: {output}, as no further poses are needed.")
        if lines:
            typer.echo("\n".join(["", *lines]))
    if checked.outcome != "nothing":
        raise typer.Exit(ExitStatus.NOT_ACCEPTED)
