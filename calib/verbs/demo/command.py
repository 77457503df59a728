"""``calib demo``: the paper's UR3 from the paper's measurements."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.options import Force, Quiet
from calib.cli.output_files import check_outputs, written_lines
from calib.cli.terminal import command_line, say
from calib.cli.verb import verb

if TYPE_CHECKING:
    from calib.result.calibration import Calibration


#: The files that are written into the folder.
_FILES = ("ur3_calibrated.urdf", "calibration.json", "report.html", "view.html")

#: What the paper reports for rows 31 to 35, its Table 5: max, mean and rms [mm].
_PAPER = {"before": (3.5645, 2.5678, 2.7485), "after": (1.8721, 1.5926, 1.6382)}

_NOTE = """The signs of the paper's Table 1 do not fit its Table 2 as printed. This demo uses what fits,
with the reflector at (-69.97, 70.20, 22.52) mm in tool0; see docs/paper.md."""


#: The files of ``--camera``.
_CAMERA_FILES = ("panda_calibrated.urdf", *_FILES[1:])

_CAMERA_NOTE = """24 pictures of a printed A4 board by a camera on the hand of a Franka arm, standing at two places
(github.com/kvasios/franka-handeye, MIT). Nothing but the factory intrinsics and the board's size was given.
Hand-eye calibration alone, the arm taken as exact, is the line 'nominal'. Pictures of your own: docs/camera.md."""


@verb("""Calibrate the paper's UR3 from its 35 laser-tracker points, or a Franka arm from pictures of a printed board.

\b
Writes into --out:
  ur3_calibrated.urdf   the corrected robot; with --camera panda_calibrated.urdf
  calibration.json      the whole result
  report.html           the report, to print and sign
  view.html             nominal and calibrated robot, to open in a browser

\b
Example:
  calib demo --out demo
  calib demo --camera --out demo_camera
""")
def demo(
    out: Annotated[
        Path, typer.Option("--out", help="Folder for the results; it is made if missing.")
    ] = Path("demo"),
    camera: Annotated[
        bool,
        typer.Option("--camera", help="Calibrate a Franka arm from pictures of a printed board."),
    ] = False,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Calibrate the example, write the files and print the summary."""
    from calib.basics.files import make_folder
    from calib.show.plotting import require_matplotlib

    require_matplotlib("The report of the demo")
    make_folder(out)
    paths = [out / name for name in (_CAMERA_FILES if camera else _FILES)]
    check_outputs(paths, [], force=force)
    if camera:
        result = _calibrate_by_camera(quiet=quiet)
        texts = [result.summary(), _CAMERA_NOTE]
    else:
        result, by_paper = _calibrate()
        texts = [result.summary(), _against_the_paper(result, by_paper), _NOTE]
    _write(result, paths, force=force)
    if quiet:
        return
    say("\n\n".join(texts) + "\n")
    for line in written_lines(*paths):
        typer.echo(line)
    report, view = paths[2:]
    typer.echo(f"Open {report} and {view} in a browser.")


def _calibrate() -> tuple[Calibration, Calibration]:
    """Calibrate the paper's robot by calib, then by the paper's algorithm without cross-validation."""
    from calib.basics.arrays import read_only
    from calib.data.cell import Cell
    from calib.data.measurements import Measurements
    from calib.example import PAPER_TARGET, paper_measurements, paper_urdf
    from calib.result.calibrate import calibrate
    from calib.robot.robot import Robot

    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    measurements = Measurements.read(
        paper_measurements(), joint_names=robot.joint_names, joint_types=robot.joint_types
    )
    cell = Cell(target=read_only(PAPER_TARGET), model="paper", instrument="tracker")
    result = calibrate(robot, measurements, cell=cell)
    by_paper = calibrate(robot, measurements, cell=cell, solver="paper", validate=False)
    return result, by_paper


def _calibrate_by_camera(*, quiet: bool) -> Calibration:
    """Calibrate the Franka arm from the corners in its pictures."""
    from calib.boards.board_file import read_board
    from calib.camera.camera_file import read_camera
    from calib.cli.terminal import work_line
    from calib.data.cell import Cell
    from calib.data.measurements import Measurements
    from calib.example import franka_file
    from calib.result.calibrate import calibrate
    from calib.robot.robot import Robot

    robot = Robot.load("panda", base="panda_link8", tip="panda_link0")
    measurements = Measurements.read(
        franka_file("corners.csv"), joint_names=robot.joint_names, joint_types=robot.joint_types
    )
    cell = Cell(
        cameras={"": read_camera(franka_file("camera.toml"))},
        boards={"": read_board(franka_file("board.toml"))},
        model="dh",
    )
    with work_line(quiet=quiet):
        return calibrate(robot, measurements, cell=cell)


def _write(result: Calibration, paths: list[Path], *, force: bool) -> None:
    """Write URDF, result, report and page to four paths in this order."""
    from calib.verbs.calibrate.report import write_report
    from calib.verbs.view.robots_page import write_page

    urdf, json, report, view = paths
    result.write_urdf(urdf, overwrite=force)
    result.write_json(json, overwrite=force)
    write_report(result, report, command=command_line(), overwrite=force)
    write_page(result, view, overwrite=force)


def _against_the_paper(result: Calibration, by_paper: Calibration) -> str:
    """Tabulate the errors on rows 31 to 35 [mm] by calib and by the paper's algorithm beside those of the paper."""
    from calib.show.as_text import blocks_text
    from calib.show.tables import Column, Table, name_column

    def in_mm(calibration: Calibration, robot: str) -> tuple[float, float, float]:
        figures = calibration.errors[robot]["validation"]["m"]
        return 1e3 * figures.max, 1e3 * figures.mean, 1e3 * figures.rms

    rows = [
        ("nominal, as the paper prints it", *_PAPER["before"]),
        ("nominal, here", *in_mm(result, "nominal")),
        ("calibrated, as the paper prints it", *_PAPER["after"]),
        ("calibrated, the paper's algorithm here", *in_mm(by_paper, "calibrated")),
        ("calibrated, calib", *in_mm(result, "calibrated")),
    ]
    columns = (name_column("", 58), *(Column(head, 9) for head in ("max", "mean", "rms")))
    return blocks_text([Table("Position error on rows 31 to 35 [mm]", columns, rows)])
