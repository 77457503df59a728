"""``calib compare``: two calibrations of one robot side by side, and whether it drifted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.options import Force, Quiet
from calib.cli.outputs import check_outputs, written_lines
from calib.cli.verb import verb

if TYPE_CHECKING:
    from calib.verbs.compare.comparison import Comparison
    from calib.verbs.view.view import View


@verb("""Compare two calibrations of one robot: did it drift?

\b
Examples:
  calib compare january.json june.json
  calib compare january.json june.json --robot robot.urdf --json compared.json --view both.html

A relocated tracker or a remounted target does not count as drift.
""")
def compare(
    a: Annotated[
        Path,
        typer.Argument(metavar="A", help="First result, as 'calib calibrate --json' writes it."),
    ],
    b: Annotated[Path, typer.Argument(metavar="B", help="Second, later result.")],
    robot: Annotated[
        str | None,
        typer.Option(
            "--robot",
            metavar="ROBOT",
            help="URDF with the meshes for --view. Default: the URDF in A.",
        ),
    ] = None,
    json: Annotated[
        Path | None, typer.Option("--json", help="Write the comparison as JSON.")
    ] = None,
    view: Annotated[
        Path | None,
        typer.Option("--view", help="Write a page that shows both robots, to open in a browser."),
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Compare the results, write the files and print the comparison."""
    from calib.verbs.compare.comparison import compare as compare_results

    check_outputs([json, view], [a, b, robot], force=force)
    comparison = compare_results(a, b, robot)
    if view is not None:
        from calib.verbs.view.page import view_page

        view_page(_view(comparison)).write(view, overwrite=force)
    if json is not None:
        comparison.write_json(json, overwrite=force)
    if quiet:
        return
    typer.echo(comparison.summary())
    if written := written_lines(view, json):
        typer.echo("\n" + "\n".join(written))


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
