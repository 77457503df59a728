"""``calib demo``: the paper's UR3 from the paper's measurements."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.options import Force, Quiet, verb

if TYPE_CHECKING:
    from calib.calibration import Calibration


#: What is written into the folder.
_FILES = ("ur3_calibrated.urdf", "calibration.json", "report.html", "view.html")

#: What the paper reports for rows 31 to 35, its Table 5 [mm].
_PAPER = {"before": (3.5645, 2.5678, 2.7485), "after": (1.8721, 1.5926, 1.6382)}

_NOTE = """The signs of the paper's Table 1 do not fit its Table 2 as printed. This demo uses what fits,
with the reflector at (-69.97, 70.20, 22.52) mm in tool0; see docs/paper.md."""


@verb("""Calibrate the paper's UR3 from its 35 laser-tracker points.

\b
Writes into --out:
  ur3_calibrated.urdf   the corrected robot
  calibration.json      the whole result
  report.html           the report, to print and sign
  view.html             nominal and calibrated robot, to open in a browser

\b
Example:
  calib demo --out demo
""")
def demo(
    out: Annotated[
        Path, typer.Option("--out", help="Folder for the results; it is made if missing.")
    ] = Path("demo"),
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """See the text of `verb`."""
    from calib.calibration import calibrate
    from calib.cli.setup import check_outputs
    from calib.cli.terminal import command_line, say
    from calib.data.cell import Cell
    from calib.data.measurements import Measurements
    from calib.example import PAPER_TARGET, paper_measurements, paper_urdf
    from calib.files import make_folder
    from calib.report.report import write_report
    from calib.robot.robot import Robot, read_only
    from calib.viewer.page import write_page

    make_folder(out)
    paths = [out / name for name in _FILES]
    check_outputs(paths, [], force=force)
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    table = Measurements.read(
        paper_measurements(), joint_names=robot.joint_names, joint_types=robot.joint_types
    )
    cell = Cell(target=read_only(PAPER_TARGET), model="paper")
    result = calibrate(robot, table, cell=cell)
    as_paper = calibrate(robot, table, cell=cell, solver="paper", validate=False)
    result.write_urdf(paths[0], overwrite=force)
    result.write_json(paths[1], overwrite=force)
    write_report(result, paths[2], command=command_line(), overwrite=force)
    write_page(result, paths[3], overwrite=force)
    if quiet:
        return
    say("\n\n".join([result.summary(), _against_the_paper(result, as_paper), _NOTE]) + "\n")
    for path in paths:
        typer.echo(f"Written: {path}")
    typer.echo(f"Open {paths[2]} and {paths[3]} in a browser.")


def _against_the_paper(result: Calibration, as_paper: Calibration) -> str:
    """The errors on rows 31 to 35 beside those that the paper prints, [mm]."""
    rows = [("nominal, as the paper prints it", _PAPER["before"])]
    for label, one, who in (
        ("nominal, here", result, "nominal"),
        ("calibrated, the paper's algorithm here", as_paper, "calibrated"),
        ("calibrated, calib", result, "calibrated"),
    ):
        errors = one.errors[who]["validation"]
        rows.append((label, (1e3 * errors.max, 1e3 * errors.mean, 1e3 * errors.rms)))
    rows.insert(2, ("calibrated, as the paper prints it", _PAPER["after"]))
    head = f"{'Position error on rows 31 to 35 [mm]':<58}{'max':>10}{'mean':>10}{'rms':>10}"
    lines = [f"{name:<58}" + "".join(f"{v:>10.3f}" for v in values) for name, values in rows]
    return "\n".join([head, *lines])
