"""``calib certificate``: a calibration certificate that a laboratory signs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer

from calib.cli.exit_status import ExitStatus
from calib.cli.loading import load_with_data
from calib.cli.notices import say_coupled, say_ignored
from calib.cli.options import DataFile, Force, Quiet, RobotFile, TableOptions
from calib.cli.output_files import check_outputs, written_lines
from calib.cli.terminal import command_line, say
from calib.cli.verb import verb
from calib.verbs.evaluate.command import EvaluateOptions, parse_by_unit

_METAVAR = '"LENGTH [ANGLE]"'


@dataclass(frozen=True, slots=True)
class ConformityOptions:
    """Statement of conformity."""

    tolerance: Annotated[
        str | None,
        typer.Option(
            metavar=_METAVAR,
            help='Tolerance of the deviations as left, such as "0.5 mm 0.1 deg". Default: conformity is not stated.',
        ),
    ] = None
    uncertainty: Annotated[
        str | None,
        typer.Option(
            metavar=_METAVAR,
            help="Expanded uncertainty U (k = 2) of a measured deviation, as the laboratory states it. Default: "
            "computed at each point from the noise of the rows, and of the calibration.",
        ),
    ] = None
    prior_mean: Annotated[
        str | None,
        typer.Option(
            metavar=_METAVAR,
            help="Mean, over such robots after calibration, of the largest deviation, for the risks over all of them.",
        ),
    ] = None
    prior_std: Annotated[
        str | None,
        typer.Option(
            metavar=_METAVAR, help="Standard deviation over such robots, with --prior-mean."
        ),
    ] = None

    def parsed(self) -> dict[str, dict[str, float] | None]:
        """Return each size by the symbol of its unit, in SI units, by the names of the options; None: not given."""
        return {
            name: None if text is None else parse_by_unit(text, f"--{name.replace('_', '-')}")
            for name, text in (
                ("tolerance", self.tolerance),
                ("uncertainty", self.uncertainty),
                ("prior_mean", self.prior_mean),
                ("prior_std", self.prior_std),
            )
        }


@verb("""Write a calibration certificate that a laboratory signs.

\b
Examples:
  calib certificate corrected.urdf fresh.csv --calibration result.json --cell cell.toml -o certificate.html
  calib certificate corrected.urdf fresh.csv --calibration result.json --cell cell.toml --tolerance "0.5 mm"
    -o certificate.pdf --dcc certificate.xml --json certificate.json

DATA has rows that were measured after the calibration. If it is the calibration's own table, its validation rows are
certified, and the certificate says so. It states the deviations at each point as found and as left with their
uncertainties, the budget, where it is valid, the decision rule with its risks, and what was not tested. Who measured
with what for whom comes from [record] of the cell file; what is not there stays a blank line. With --tolerance the exit
status is 0 if the robot conforms, and 3 otherwise. See docs/certificate.md.
""")
def certificate(
    robot: RobotFile,
    data: DataFile,
    *,
    cell_options: EvaluateOptions,
    table_options: TableOptions,
    conformity_options: ConformityOptions,
    calibration: Annotated[
        Path,
        typer.Option(
            "--calibration",
            help="Result of the calibration, as 'calib calibrate --json' writes it.",
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE",
            help="Write the certificate to print and sign: a page, .html, or a PDF, .pdf.",
        ),
    ] = None,
    dcc: Annotated[
        Path | None,
        typer.Option("--dcc", help="Write it as Digital Calibration Certificate (XML, DCC 3.2.1)."),
    ] = None,
    json: Annotated[Path | None, typer.Option("--json", help="Write it as JSON.")] = None,
    judge: Annotated[
        Literal["calibration", "non_geometric"],
        typer.Option(
            help="Robot that is certified: the corrected URDF, or the non-geometric model."
        ),
    ] = "calibration",
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Certify, write the files and print the certificate; exit status 3 if the robot is not shown to conform."""
    from calib.result.calibration_file import read_result
    from calib.result.chain_of_result import with_chain_of_result
    from calib.show.report_file import check_report
    from calib.verbs.certificate.certificate import certificate_of, files_of, priors_of

    if output is not None:
        check_report(output)
    check_outputs(
        [output, dcc, json],
        [robot, data, cell_options.file, calibration, table_options.points],
        force=force,
    )
    sizes = conformity_options.parsed()
    result = read_result(calibration)
    cell = result.complete_cell(with_chain_of_result(cell_options.cell(), result, str(calibration)))
    arm, measurements = load_with_data(robot, cell, data, table_options, result)
    made = certificate_of(
        arm,
        measurements,
        cell,
        result,
        files_of(calibration, command_line()),
        # Where the options give no frame or target, those of the result are taken.
        which=tuple(place for place in ("frame", "target") if place not in cell_options.given),
        tolerance=sizes["tolerance"],
        uncertainty=sizes["uncertainty"],
        prior=priors_of(sizes["prior_mean"], sizes["prior_std"]),
        non_geometric=judge == "non_geometric",
    )
    # The file that may be refused comes first.
    if dcc is not None:
        made.write_dcc(dcc, overwrite=force)
    if json is not None:
        made.write_json(json, overwrite=force)
    if output is not None:
        made.write_report(output, overwrite=force)
    if not quiet:
        say_ignored(measurements, arm)
        say_coupled(arm)
        say(made.summary())
        written = written_lines(output, dcc, json)
        if written:
            typer.echo("\n".join(["", *written]))
    if made.outcome not in (None, "pass"):
        raise typer.Exit(ExitStatus.NOT_ACCEPTED)
