"""``calib fleet``: many robots, a row of a manifest each, calibrated and compared with each other."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.options import (
    Columns,
    Dask,
    FitOptions,
    PointsUnit,
    Quiet,
    Robust,
    SolverName,
    TargetLink,
    Validate,
    Workers,
    verb,
)
from calib.cli.setup import executor_of
from calib.cli.terminal import VERDICTS
from calib.errors import FileError
from calib.text.lines import fill

if TYPE_CHECKING:
    from calib.fleets.fleet import Fleet

#: More robots than this are counted, and those are listed that need somebody to look at them.
LISTED = 40

#: Reasons that are told of one robot, and robots of one reason that are named; fleet.json has them all.
_REASONS, _NAMES = 4, 5

#: What `Odd.figure` says of data that are another robot's too.
DATA = "data"


@verb("""Calibrate many robots and say which of them are odd.

\b
Examples:
  calib fleet manifest.csv --out results
  calib fleet manifest.csv --out results --base base --tip tool0 --target "70 -70 22.5 mm" --no-reports
  calib fleet manifest.csv --out results --dask tcp://192.168.0.10:8786

The manifest has a robot a row: its name, its robot (a URDF, a xacro, or a name such as ur3) and its data, and may say
cell, points, points_unit, base, tip, target, frame, model, kind, payload, hold and columns of it, as the options of
'calib fit' do. Options on the line are for all robots; what a row says wins. Each robot gets a folder with
corrected.urdf, result.json, report.html and summary.txt; fleet.csv and fleet.json compare them. Given again, the same
command keeps what is finished and unchanged. The exit code is 1 if a robot failed. See docs/fleet.md.
""")
def fleet(
    manifest: Annotated[
        Path, typer.Argument(metavar="MANIFEST", help="CSV table of the robots, one a row.")
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FOLDER", help="The folder for the results; made if missing."
        ),
    ],
    setup: FitOptions,
    solver: SolverName = "lm",
    points_unit: PointsUnit = None,
    columns: Columns = None,
    target_link: TargetLink = False,
    robust: Robust = True,
    validate: Validate = True,
    reports: Annotated[
        bool,
        typer.Option(
            help="Write a report for each robot, which takes longer than its calibration."
        ),
    ] = True,
    workers: Workers = None,
    dask: Dask = None,
    force: Annotated[
        bool, typer.Option("--force", help="Calibrate all robots anew, finished ones too.")
    ] = False,
    quiet: Quiet = False,
) -> None:
    """See the text of `verb`."""
    from calib.cli.fleet_manifest import read_manifest
    from calib.cli.terminal import command_line, progress_bar
    from calib.fleets.fleet import CSV, JSON, FleetOptions, fleet as calibrate_fleet

    if manifest.resolve() == (out / CSV).resolve():
        raise FileError(
            f"{manifest} is the manifest, and the table of results would have its name; choose another --out."
        )
    robots = read_manifest(manifest, setup, columns or (), points_unit)
    options = FleetOptions(solver, robust, validate, reports, target_link, command_line())
    try:
        with (
            executor_of(workers, dask, len(robots)) as executor,
            progress_bar("robots", quiet=quiet) as progress,
        ):
            found = calibrate_fleet(
                robots, out, options, executor=executor, progress=progress, force=force
            )
    except KeyboardInterrupt as error:
        raise KeyboardInterrupt(
            f"Finished robots are kept in {out}: the same command goes on with the others."
        ) from error
    if not quiet:
        _print_table(found)
        for paragraph in _paragraphs(found):
            typer.echo(paragraph)
        for name in (CSV, JSON):
            typer.echo(f"Written: {out / name}")
    if found.failed:
        text = f"calib: {len(found.failed)} of {len(found.rows)} robots failed"
        # What was printed above has the reasons.
        first = found.failed[0]
        text += f"; '{first.name}': {' '.join(first.message.split())}" if quiet else "."
        typer.echo(text, err=True)
        raise typer.Exit(1)


def _print_table(found: Fleet) -> None:
    """The robots, or of a large fleet those that are odd or not to be used, one a line.

    On a terminal long names are folded and the verdicts coloured; elsewhere it is plain text.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    shown = done = [row for row in found.rows if row not in found.failed]
    which = ":"
    if len(done) > LISTED:
        odd = {one.name for one in found.odd}
        shown = [row for row in done if row.name in odd or row.verdict not in ("use", "")]
        which = (
            f", of the {len(shown)} of {len(done)} robots that are odd or not simply to be used:"
        )
    if not shown:
        return
    # Behind "unseen" where that is of validation rows: what robots are compared by.
    cross = any(r.unseen == "validation" and r.left_out_rms == r.left_out_rms for r in shown)
    sizes = {"nominal": "nominal_rms", "calibrated": "calibrated_rms", "unseen": "unseen_rms"}
    sizes |= {"cross-val.": "left_out_rms"} if cross else {}
    sizes["noise"] = "sigma"
    table = Table(box=None, pad_edge=False, header_style="bold")
    for head in ("robot", "verdict", "model"):
        table.add_column(head, overflow="fold")
    for head in (*sizes, "rows", "out"):
        table.add_column(head, justify="right", overflow="fold")
    for row in shown:
        numbers = [getattr(row, name) for name in sizes.values()]
        verdict = Text(row.verdict or "-", VERDICTS.get(row.verdict, ""))
        model = f"{row.model} ({row.larger})" if row.larger else row.model
        cells = ["" if value != value else f"{1e3 * value:.3f}" for value in numbers]
        cells += [str(row.rows), str(row.outliers)]
        table.add_row(Text(row.name), verdict, Text(model), *cells)
    typer.echo(f"Errors and noise, rms [mm]{which}")
    # A file is as wide as its longest name.
    width = None if sys.stdout.isatty() else 10_000
    console = Console(width=width, highlight=False, markup=False, emoji=False)
    with console.capture() as printed:
        console.print(table)
    for line in printed.get().splitlines():
        typer.echo(line.rstrip())
    typer.echo("")


def _paragraphs(found: Fleet) -> Iterator[str]:
    """The odd ones, the failed ones, what could not be said, and how many there were."""
    from calib.fleets.record import STALE

    reasons: dict[str, list[str]] = {}
    for one in found.odd:
        if one.figure != DATA:
            reasons.setdefault(one.name, []).append(one.text)
    odd = [
        f"{name}: {'; '.join(texts[:_REASONS])}"
        + f"; and {len(texts) - _REASONS} more in fleet.json" * (len(texts) > _REASONS)
        for name, texts in reasons.items()
    ]
    twice = [f"{one.name}: {one.text}" for one in found.odd if one.figure == DATA]
    groups: dict[tuple[str, bool], list[str]] = {}
    for row in found.failed:
        groups.setdefault((row.message, row.status == STALE), []).append(row.name)
    failed = []
    for (message, stale), names in groups.items():
        more = f" and {len(names) - _NAMES} more" * (len(names) > _NAMES)
        kept = " The folder holds the result of earlier inputs." * stale
        failed.append(f"{', '.join(names[:_NAMES])}{more}: {message.removesuffix('.')}.{kept}")
    for head, lines in (
        ("Odd ones out:", odd),
        ("Data given twice, which count once in what is usual:", twice),
        ("Failed:", failed),
    ):
        if lines:
            yield "\n".join([head, *(fill(line, "  ", "  ") for line in lines), ""])
    for note in found.notes:
        yield fill(note)
    done = [row for row in found.rows if row not in found.failed]
    verdicts = Counter(row.verdict or "no verdict" for row in done)
    words = ", ".join(f"{count} {word}" for word, count in verdicts.most_common())
    old = sum(row.status == STALE for row in found.failed)
    yield (
        f"{len(done)} of {len(found.rows)} robots calibrated"
        + f" ({words})" * bool(words)
        + f", {found.kept} of them by an earlier run" * bool(found.kept)
        + f"; {len(odd)} odd"
        + f", {len(twice)} with the data of another" * bool(twice)
        + f", {len(found.failed)} failed"
        + f" ({old} of them with a result of earlier inputs in the folder)" * bool(old)
        + "."
    )
