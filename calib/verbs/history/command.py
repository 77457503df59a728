"""``calib history``: which calibration of each robot was valid when, and back to an earlier one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.options import Accept, Force, Quiet
from calib.cli.output_files import check_outputs, written_lines
from calib.cli.verb import verb
from calib.errors import CalibError


@verb("""Show which calibration of a robot was valid when, and restore its URDF.

\b
Examples:
  calib history results
  calib history results SN-017
  calib history results SN-017 --restore 2026-03-01 -o corrected.urdf

FOLDER and all folders below it are searched for result files, as 'calib calibrate --json' and 'calib fleet' write them.
They are told apart by the serial number of the robot ([record] robot_serial of the cell file). A calibration is valid
from the date of its measurement (of the record, else when it was calibrated) until the next one replaces it, or an
acceptance test ('calib evaluate --tolerance --json') fails. See docs/history.md.
""")
def history(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of the result files.")],
    serial: Annotated[
        str | None,
        typer.Argument(metavar="SERIAL", help="Serial number of a robot. Default: all robots."),
    ] = None,
    *,
    restore: Annotated[
        str | None,
        typer.Option(
            "--restore",
            metavar="DATE|HASH",
            help="Write the corrected URDF that was valid on this date (2026-03-01), or that of a run, or of the "
            "SHA-256 of a URDF or result, by its first digits.",
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="The URDF that --restore writes.")
    ] = None,
    by_folder: Annotated[
        bool,
        typer.Option(
            "--by-folder",
            help="Take the name of the folder as serial number of a result that states none.",
        ),
    ] = False,
    json: Annotated[Path | None, typer.Option("--json", help="Write the history as JSON.")] = None,
    accept: Accept = False,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Read the folder, print the history, and write the URDF of an earlier calibration."""
    from calib.verbs.history.history import history as read_history

    if (restore is None) != (output is None):
        raise CalibError("--restore and -o go together: --restore 2026-03-01 -o corrected.urdf.")
    if restore is not None and serial is None:
        raise CalibError(
            "--restore needs the serial number of the robot: calib history FOLDER SERIAL."
        )
    check_outputs([output, json], [folder], force=force)
    found = read_history(folder, by_folder=by_folder)
    if serial is not None:
        found.of(serial)
    if restore is not None and output is not None and serial is not None:
        entry = found.restore(serial, restore, output, overwrite=force, accept=accept)
    if json is not None:
        found.write_json(json, overwrite=force)
    if quiet:
        return
    if restore is not None:
        typer.echo(f"The corrected URDF of run {entry.result.run} ({entry.result.path}).")
    else:
        typer.echo(found.summary(serial))
    if written := written_lines(output, json):
        typer.echo("\n".join(written))
