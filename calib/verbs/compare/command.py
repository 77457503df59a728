"""``calib compare``: two calibrations of one robot side by side, or several over time, and whether it drifted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.exit_status import ExitStatus
from calib.cli.options import Force, Quiet
from calib.cli.output_files import check_outputs, written_lines
from calib.cli.verb import verb
from calib.errors import CalibError

if TYPE_CHECKING:
    from calib.verbs.compare.comparison import Comparison
    from calib.verbs.view.view import View

#: Results that it takes to compare them.
_FEWEST = 2


@verb("""Compare calibrations of one robot: did it drift?

\b
Examples:
  calib compare january.json june.json
  calib compare january.json june.json --robot robot.urdf --json compared.json --view both.html
  calib compare january.json march.json june.json --report trend.html
  calib compare january.json june.json --tolerance "0.2 mm"

Two results are tested for a difference. Of three or more, or with --report, the zero of each joint is followed over
time: whether it is steady, drifts or has a step. A relocated tracker or a remounted target does not count as drift.
With --tolerance the exit status is 0 if the target is shown to have moved by no more since the first result, and 3
otherwise.
""")
def compare(
    results: Annotated[
        list[Path],
        typer.Argument(
            metavar="A B [C ...]", help="Results, as 'calib calibrate --json' writes them."
        ),
    ],
    robot: Annotated[
        str | None,
        typer.Option(
            "--robot",
            metavar="ROBOT",
            help="URDF with the meshes for --view. Default: the URDF in A.",
        ),
    ] = None,
    dates: Annotated[
        str | None,
        typer.Option(
            "--dates",
            metavar="DATES",
            help='Dates of all results, with commas: "2026-01-10, 2026-03-01". Default: when each was measured, as its '
            "record says, else when it was calibrated.",
        ),
    ] = None,
    tolerance: Annotated[
        str | None,
        typer.Option(
            "--tolerance",
            metavar="LENGTH",
            help='How far the target may have moved since the first result, rms: "0.2 mm".',
        ),
    ] = None,
    json: Annotated[
        Path | None, typer.Option("--json", help="Write the comparison as JSON.")
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(
            "--report", metavar="FILE", help="Write a page with the figures over time, .html."
        ),
    ] = None,
    view: Annotated[
        Path | None,
        typer.Option(
            "--view",
            help="Write a page that shows the first and the last robot, to open in a browser.",
        ),
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Compare the results, write the files and print the comparison; exit status 3 if a tolerance is not kept."""
    from calib.basics.units import LENGTH, parse_amount
    from calib.show.as_html import check_ending
    from calib.verbs.compare.comparison import Comparison, compare as compare_results
    from calib.verbs.compare.text import kept_sentence
    from calib.verbs.compare.trend import RobotTrend, trend

    if len(results) < _FEWEST:
        raise CalibError("One result cannot be compared; name two or more: calib compare A B.")
    if report is not None:
        check_ending(report)
    check_outputs([json, report, view], [*results, robot], force=force)
    allowed = None
    if tolerance is not None:
        allowed = parse_amount(tolerance, "--tolerance", LENGTH, "0.2 mm")
    shown: Comparison | RobotTrend
    if len(results) > _FEWEST or report is not None or dates is not None:
        given = None if dates is None else dates.split(",")
        shown = trend(results, given, tolerance=allowed)
        kept = shown.kept
        pair = shown.comparisons[-1]
        if view is not None:
            ends = (shown.results[0], shown.results[-1])
            names = (shown.names[0], shown.names[-1])
            pair = replace(compare_results(*ends, robot), names=names)
    else:
        shown = pair = compare_results(results[0], results[1], robot)
        kept = None if allowed is None else pair.within(allowed)
    if view is not None:
        from calib.verbs.view.robots_page import view_page

        view_page(_view(pair)).write(view, overwrite=force)
    if report is not None and isinstance(shown, RobotTrend):
        shown.write_report(report, overwrite=force)
    if json is not None:
        shown.write_json(json, overwrite=force)
    if not quiet:
        typer.echo(shown.summary())
        if allowed is not None and kept is not None and isinstance(shown, Comparison):
            typer.echo(f"\n{kept_sentence(kept, allowed)}")
        if written := written_lines(view, report, json):
            typer.echo("\n" + "\n".join(written))
    if kept not in (None, "pass"):
        raise typer.Exit(ExitStatus.NOT_ACCEPTED)


def _view(c: Comparison) -> View:
    """View both results with the first one's target, each in the base of its own fit."""
    from calib.show.scene.posed_robot import translation
    from calib.verbs.compare.text import sentence
    from calib.verbs.view.view import view_of_robots

    names = ((f"a: {c.names[0]}", "the first result"), (f"b: {c.names[1]}", "the second result"))
    view = view_of_robots(c.a.corrected(c.robot), c.b.corrected(c.robot), names=names)
    target = translation(c.a.target)
    title = f"{c.a.nominal.name or 'Robot'}: two calibrations"
    return replace(
        view, nominal_target=target, calibrated_target=target, title=title, note=sentence(c)
    )
