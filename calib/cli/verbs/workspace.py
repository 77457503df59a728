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
    Force,
    Frame,
    Hold,
    Quiet,
    RobotFile,
    RobotTip,
    verb,
)
from calib.errors import CalibError

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np
    from numpy.typing import NDArray

    from calib.robot.robot import Robot
    from calib.text.workspace import Found


@verb("""Show where the target comes to lie, and find the region to measure in.

\b
Examples:
  calib workspace ur3 --base base --tip tool0 --target "50 50 50 mm" -o region.json
  calib workspace robot.urdf --like data.csv --margin "5 deg" --check data.csv --picture region.png
  calib workspace robot.urdf --range "elbow_joint=-90..90 deg" --within "-600 -600 0 to 600 0 900 mm"

The joints take all values in their ranges equally often; the target is then at some places more often than at others.
The region is the smallest part of space that it is in with a probability of --share. 'calib plan --region region.json'
chooses poses inside it. Collisions are not looked at here.
""")
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
    ranges: Annotated[
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
) -> None:
    """See the text of `verb`."""
    import numpy as np

    from calib.cli.setup import check_outputs, parse_amount, parse_columns, read_cell
    from calib.cli.surroundings_words import add_surroundings
    from calib.cli.terminal import progress_bar
    from calib.data.ranges import joint_ranges, predicted_points, read_rows, row_points
    from calib.data.table import Table
    from calib.design.workspace import Density, sample_workspace
    from calib.report.figure_region import check_ending
    from calib.robot.robot import Robot
    from calib.text.workspace import Checked, Found, text

    named = [path for path in dict.fromkeys((like, check)) if path is not None]
    check_outputs([output, picture, view], [robot, *named, *([cell] if cell else [])], force=force)
    if picture is not None:
        check_ending(picture)
    if margin and like is None:
        raise CalibError("--margin widens the ranges of a table; name the table with --like.")
    box = None if within is None else parse_within(within)
    edge = None if voxel is None else parse_amount(voxel, "--voxel", "a length", "20 mm")
    setup = read_cell(cell, base=base, tip=tip, target=target, frame=frame, hold=hold)
    setup = add_surroundings(setup, ranges=ranges or ())
    renamed = parse_columns(columns or [])
    known = [Table.read(path).names(renamed) for path in named]
    joints = set.intersection(*known) if known else None
    arm = Robot.load(robot, setup.base, setup.tip, measured=joints, held=setup.held)
    tables = {path: read_rows(path, arm, renamed, setup.kind) for path in named}
    own, wider = None, 0.0 if not margin else parse_margins(margin, arm)
    if like is not None:
        own = tables[like].joints_for(arm.joint_names)[tables[like].estimation]
    ends = joint_ranges(arm, setup.ranges, own, wider)
    # The cell's target, or its only named one, or the tip itself.
    only = [*setup.targets.values()] if len(setup.targets) == 1 else [np.zeros(3)]
    point = only[0] if setup.target is None else setup.target
    with progress_bar("workspace", quiet=quiet) as progress:
        points = sample_workspace(arm, point, ends, samples, seed, progress)
    density = Density.of(points, edge, box)
    checked = None
    if (path := check or like) is not None:
        rows = tables[path]
        places, measured = row_points(arm, rows, setup, point)
        checked = Checked(rows, places, measured, predicted_points(arm, rows, setup, point))
    found = Found(
        robot=arm,
        target=point,
        ranges=ends,
        density=density,
        region=density.region(share),
        reach=float(np.sqrt(np.einsum("ni,ni->n", points, points).max())),
        seed=seed,
        checked=checked,
    )
    written = list(_write(found, output, picture, view, force=force))
    if quiet:
        return
    origin = ""
    if like is not None:
        more = f", {' or '.join(margin)} wider at both ends but for the limits" if margin else ""
        more += ", but for the ranges given" if setup.ranges else ""
        count = int(tables[like].estimation.sum())
        origin = f"the {count} estimation rows of {tables[like].source}{more}"
    options = {
        "--cell": [] if cell is None else [str(cell)],
        "--hold": hold or [],
        "--range": ranges or [],
        "--region": [] if output is None else [str(output)],
    }
    lines = [text(found, origin, every_row=check is not None), ""]
    lines += [f"Written: {path}" for path in written]
    typer.echo("\n".join([*lines, f"Next:  {_next(robot, found, options)}"]))


def _write(
    found: Found,
    output: Path | None,
    picture: Path | None,
    view: Path | None,
    *,
    force: bool,
) -> Iterator[Path]:
    """Write region, picture and page as far as they are asked for."""
    from calib.design.region import RegionFile
    from calib.report.figure_region import Marked, RegionView, write_picture

    checked, region = found.checked, found.region
    if output is not None:
        many, seed = found.density.drawn, found.seed
        file = RegionFile.of(region, found.robot, found.target, found.ranges, many, seed)
        yield file.write(output, overwrite=force)
    shown = RegionView(
        robot=found.robot,
        q=found.pose,
        target=found.target,
        density=found.density,
        region=region,
        title=found.title,
        text=found.subtitle,
        marked=checked and Marked(checked.points, checked.rows.rows, checked.rows.validation),
    )
    if picture is not None:
        yield write_picture(shown, picture, overwrite=force)
    if view is not None:
        from calib.viewer.design_view import region_page

        yield region_page(shown).write(view, overwrite=force)


def _next(robot: str, found: Found, options: dict[str, list[str]]) -> str:
    """What to do with the region: a command that can be copied."""
    from calib.text.plan import command_text

    if not options["--region"]:
        return "add -o region.json; 'calib plan --region region.json' chooses poses in the region."
    at = " ".join(f"{1e3 * v:.10g}" for v in found.target) + " mm"
    said = [("calib", "plan", robot), ("--base", found.robot.base), ("--tip", found.robot.tip)]
    said += [("--target", at)] if found.target.any() else []
    said += [(name, value) for name, values in options.items() for value in values]
    return command_text([*map(shlex.join, said), "-o plan.csv"], 9)


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
        CalibError: Another quantity, one that no joint has, one below 0, or the same quantity twice.
    """
    import numpy as np

    from calib.cli.setup import parse_pair

    slides = [robot.joint_types[name] == "prismatic" for name in robot.joint_names]
    length, angle = parse_pair(" ".join(texts), "--margin", "5 deg")
    if (length is not None and not any(slides)) or (angle is not None and all(slides)):
        raise CalibError(
            f'--margin was given as "{" ".join(texts)}"; joints that turn have an angle, "5 deg", those that slide a '
            'length, "10 mm".'
        )
    return np.where(slides, length or 0.0, angle or 0.0)
