"""``calib workspace``: where the target comes to lie, how often, and the region to measure in."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.options import (
    Base,
    CellFile,
    Columns,
    Debug,
    Force,
    Frame,
    Hold,
    Quiet,
    RobotFile,
    RobotTip,
    reporting,
)
from calib.errors import CalibError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from calib.cli.workspace_text import Found
    from calib.measure.cell import Cell
    from calib.measure.measurements import Measurements
    from calib.model.robot import Robot

_HELP = """Show where the target comes to lie, and find the region to measure in.

\b
Examples:
  calib workspace ur3 --base base --tip tool0 --target "50 50 50 mm" -o region.json
  calib workspace robot.urdf --like data.csv --margin "5 deg" --check data.csv --picture region.png
  calib workspace robot.urdf --range "elbow_joint=-90..90 deg" --within "-600 -600 0 to 600 0 900 mm"

The joints take all values in their ranges equally often; the target is then at some places more often than at others.
The region is the smallest part of space that it is in with a probability of --share. 'calib plan --region region.json'
chooses poses inside it. Collisions are not looked at here.
"""


def workspace(
    robot: RobotFile,
    base: Base = None,
    tip: RobotTip = None,
    target: Annotated[
        str | None,
        typer.Option(
            metavar='"X Y Z UNIT"',
            help='Target in the tip, such as "70 -70 22.5 mm". Default: the cell\'s, or the tip itself.',
        ),
    ] = None,
    range_: Annotated[
        list[str] | None,
        typer.Option(
            "--range",
            metavar='"JOINT=LOW..HIGH UNIT"',
            help='Values of a joint, such as "elbow_joint=-90..90 deg". Default: all that its limits allow, '
            "one turn at most. Can be repeated.",
        ),
    ] = None,
    like: Annotated[
        Path | None,
        typer.Option(
            metavar="DATA", help="Ranges of the joints are those of this table's estimation rows."
        ),
    ] = None,
    margin: Annotated[
        list[str] | None,
        typer.Option(
            metavar='"ANGLE"',
            help='How much wider than in --like, at both ends: "5 deg"; once more for joints that slide: "10 mm".',
        ),
    ] = None,
    within: Annotated[
        str | None,
        typer.Option(
            metavar='"X Y Z to X Y Z UNIT"',
            help='Box in the base frame: places outside do not count, such as "-600 -600 0 to 600 0 900 mm".',
        ),
    ] = None,
    share: Annotated[
        float, typer.Option(metavar="P", help="Probability that the region holds, 0 to 1.")
    ] = 0.95,
    samples: Annotated[
        int, typer.Option(min=1000, max=2**24, metavar="N", help="Samples of the joint values.")
    ] = 2**19,
    voxel: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH",
            help='Edge of a voxel, such as "20 mm". Default: as small as the samples allow.',
        ),
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, metavar="S", help="The same S gives the same region.")
    ] = 0,
    check: Annotated[
        Path | None,
        typer.Option(
            metavar="DATA", help="Say which rows of this table lie in the region, and how deep."
        ),
    ] = None,
    frame: Frame = None,
    hold: Hold = None,
    columns: Columns = None,
    cell: CellFile = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Write the region, for 'calib plan --region'."),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(help="Draw density and region; the name ends in .png, .svg or .pdf."),
    ] = None,
    view: Annotated[
        Path | None,
        typer.Option(help="Write a page that shows robot and region, to open in a browser."),
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """See `_HELP`."""
    with reporting(debug=debug):
        from calib.cli.setup import check_outputs, parse_amount, read_cell
        from calib.cli.surroundings_words import add_surroundings
        from calib.cli.terminal import progress_bar
        from calib.cli.workspace_text import Found, text
        from calib.design.workspace import Density, sample_workspace
        from calib.measure.ranges import joint_ranges
        from calib.show.figure_region import check_ending

        inputs = [path for path in (robot, cell, like, check) if path]
        check_outputs([output, picture, view], inputs, force=force)
        if picture is not None:
            check_ending(picture)
        if margin and like is None:
            raise CalibError("--margin widens the ranges of a table; name the table with --like.")
        if not 0.0 < share <= 1.0:
            raise CalibError(
                f"--share was given as {share:g}; it must be greater than 0 and at most 1, such as 0.95."
            )
        box = None if within is None else parse_within(within)
        edge = None if voxel is None else parse_amount(voxel, "--voxel", "a length", "20 mm")
        setup = read_cell(cell, base=base, tip=tip, target=target, frame=frame, hold=hold)
        setup = add_surroundings(setup, ranges=range_)
        arm, tables = _load(robot, setup, columns, [like, check])
        measured = None if like is None else _estimation(tables[like], arm)
        ranges = joint_ranges(
            arm, setup.ranges, measured, 0.0 if not margin else parse_margins(margin, arm)
        )
        point = _target(setup)
        with progress_bar("workspace", quiet=quiet) as progress:
            points = sample_workspace(arm, point, ranges, samples, seed, progress)
        density = Density.of(points, edge, box)
        found = Found(
            robot=arm,
            target=point,
            ranges=ranges,
            density=density,
            region=density.region(share),
            reach=_reach(points),
            seed=seed,
            like=None if like is None else tables[like],
            margin=_margin_text(margin, bool(setup.ranges)),
            checked=_checked(arm, setup, point, tables, check or like),
        )
        written = _write(found, output, picture, view, force=force)
        if quiet:
            return
        typer.echo(text(found, every_row=check is not None))
        typer.echo("")
        for path in written:
            typer.echo(f"Written: {path}")
        typer.echo(_next(robot, found, output, cell, {"--hold": hold, "--range": range_}))


def parse_within(text: str) -> NDArray[np.float64]:
    """``--within``: ``X Y Z to X Y Z UNIT``, two corners of a box, as shape (2, 3), [m].

    Raises:
        CalibError: Words of another form, or a second corner that is not greater along each axis.
    """
    from calib.cli.setup import parse_point
    from calib.design.region import checked_box

    first, _, second = text.partition(" to ")
    unit = re.search(r"[A-Za-zµμ]+\s*$", second)
    if unit is None:
        raise CalibError(
            f'--within was given as "{text}"; it must be two corners in the base frame, the one with the smaller '
            'numbers first, and a unit, such as "-600 -600 0 to 600 0 900 mm".'
        )
    if not re.search(r"[A-Za-zµμ]+\s*$", first):
        first = f"{first} {unit[0]}"
    return checked_box([parse_point(corner, "--within") for corner in (first, second)])


def parse_margins(texts: list[str], robot: Robot) -> NDArray[np.float64]:
    """``--margin``: an angle for joints that turn, a length for those that slide; shape (m,), [rad] or [m].

    Raises:
        CalibError: Another quantity, one below 0, or the same quantity twice.
    """
    import numpy as np

    from calib.measure.quantities import ANGLE, LENGTH, parse_quantity

    slides = [robot.joint_types[name] == "prismatic" for name in robot.joint_names]
    wanted = [kind for kind, used in ((ANGLE, not all(slides)), (LENGTH, any(slides))) if used]
    found: dict[str, float] = {}
    for text in texts:
        try:
            value, kind = parse_quantity(text)
        except CalibError:
            value, kind = 0.0, ""
        if kind not in wanted or value < 0.0 or kind in found:
            raise CalibError(
                f'--margin was given as "{text}"; of these joints it must be {" or ".join(wanted)}, not below 0, and '
                'each once: "5 deg" for joints that turn, "10 mm" for those that slide.'
            )
        found[kind] = value
    return np.where(slides, found.get(LENGTH, 0.0), found.get(ANGLE, 0.0))


def _load(
    robot: str, cell: Cell, columns: list[str] | None, paths: list[Path | None]
) -> tuple[Robot, dict[Path, Measurements]]:
    """The robot's chain, whose joints are in all of the tables, and the tables."""
    from calib.cli.setup import parse_columns
    from calib.measure.row_points import read_rows
    from calib.measure.table import Table
    from calib.model.robot import Robot
    from calib.units import split_header

    renamed = parse_columns(columns or [])
    named = [path for path in dict.fromkeys(paths) if path is not None]
    known: set[str] | None = None
    for path in named:
        names = {split_header(label)[0] for label in Table.read(path).header}
        names |= {split_header(wanted)[0] for wanted in renamed.values()}
        known = names if known is None else known & names
    arm = Robot.load(robot, cell.base, cell.tip, measured=known, held=cell.held)
    kind = cell.kind
    return arm, {path: read_rows(path, arm, renamed, kind) for path in named}


def _estimation(table: Measurements, robot: Robot) -> NDArray[np.float64]:
    """The joint values of a table's estimation rows, shape (N, m)."""
    return table.joints_for(robot.joint_names)[table.estimation]


def _margin_text(margin: list[str] | None, given: bool) -> str:
    """What the ranges are beside those of a table."""
    wider = f", {' or '.join(margin)} wider at both ends but for the limits" if margin else ""
    return wider + (", but for the ranges given" if given else "")


def _target(cell: Cell) -> NDArray[np.float64]:
    """The target in the tip: the cell's, or its only named one, or the tip itself [m], shape (3,)."""
    from calib.model.robot import read_only

    if cell.target is not None:
        return cell.target
    return next(iter(cell.targets.values())) if len(cell.targets) == 1 else read_only([0.0] * 3)


def _reach(points: NDArray[np.float64]) -> float:
    """The largest distance of a sample from the base's origin [m]."""
    import numpy as np

    return float(np.sqrt(np.einsum("ni,ni->n", points, points).max()))


def _checked(
    robot: Robot,
    cell: Cell,
    target: NDArray[np.float64],
    tables: dict[Path, Measurements],
    path: Path | None,
) -> tuple[Measurements, NDArray[np.float64], NDArray[np.bool_], NDArray[np.float64]] | None:
    """A table, where its targets were in the base, whether that was measured, and where they are predicted."""
    from calib.measure.row_points import predicted_points, row_points

    if path is None:
        return None
    rows = tables[path]
    points, measured = row_points(robot, rows, cell, target)
    return rows, points, measured, predicted_points(robot, rows, cell, target)


def _write(
    found: Found, output: Path | None, picture: Path | None, view: Path | None, *, force: bool
) -> list[Path]:
    """Write what was asked for."""
    from calib.cli.workspace_text import picture_words
    from calib.design.region import RegionFile
    from calib.show.figure_region import Marked, write_picture

    title, subtitle = picture_words(found)
    marked = None
    if found.checked is not None:
        rows, points, *_ = found.checked
        marked = Marked(points, rows.rows, rows.validation)
    written = []
    if output is not None:
        file = RegionFile.of(
            found.region, found.robot, found.target, found.ranges, found.density.drawn, found.seed
        )
        written.append(file.write(output, overwrite=force))
    if picture is not None:
        words = {"title": title, "subtitle": subtitle}
        written.append(
            write_picture(
                found.density, found.region, picture, marked=marked, overwrite=force, **words
            )
        )
    if view is not None:
        from calib.show.region_view import RegionView, write_region_view

        scene = RegionView(
            robot=found.robot,
            q=found.pose,
            target=found.target,
            density=found.density,
            region=found.region,
            title=title,
            text=subtitle,
            marked=marked,
        )
        written.append(write_region_view(scene, view, overwrite=force))
    return written


def _next(
    robot: str,
    found: Found,
    output: Path | None,
    cell: Path | None,
    repeated: dict[str, list[str] | None],
) -> str:
    """What to do with the region: a command that can be copied, in lines that fit the screen."""
    from calib.cli.plan_text import command_text

    if output is None:
        return "Next:  add -o region.json; 'calib plan --region region.json' chooses poses in the region."
    parts = [shlex.join(["calib", "plan", robot])]
    options = {"--base": found.robot.base, "--tip": found.robot.tip}
    if found.target.any():
        options["--target"] = " ".join(f"{1e3 * v:.10g}" for v in found.target) + " mm"
    if cell is not None:
        options["--cell"] = str(cell)
    parts += [shlex.join(pair) for pair in options.items()]
    parts += [shlex.join([o, value]) for o, values in repeated.items() for value in values or []]
    parts += [shlex.join(["--region", str(output)]), "-o plan.csv"]
    return f"Next:  {command_text(parts, 9)}"


workspace.__doc__ = _HELP
