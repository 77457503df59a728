"""``calib convert``: a calibrated robot in the formats that controllers and ROS take."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.options import Accept, Base, Force, Hold, Quiet, verb

_SOURCE = "result.json, calibration.conf, kinematics.yaml, origins.yaml, a URDF or xacro, or a robot's name."
_FORMATS = (
    "Format of FILE: urdf, ur-yaml, ur-conf, origins; dh: standard DH rows; modified-dh: Craig's; hayati: standard, "
    "with beta between near-parallel axes; each as .csv or .json. Default: what its ending says."
)
_ROBOT = "Nominal URDF, xacro or name. Default: the one in a result; a bare arm for --ur-model."
_HASH = (
    "The robot's own kinematics.yaml or calibration.conf, whose hash a new kinematics.yaml keeps."
)


@verb("""Write a calibrated robot in the formats that controllers and ROS take.

\b
Examples:
  calib convert result.json --to dh -o rows.csv
  calib convert calibration.conf --ur-model UR5e -o ur5e_calibrated.urdf
  calib convert calibration.conf --ur-model UR5e -o kinematics.yaml
  calib convert result.json --to ur-yaml --hash-from own_kinematics.yaml -o kinematics.yaml
  calib convert corrected.urdf --robot robot.urdf --to hayati -o rows.csv

What is written is read back and compared with the robot before it appears; what a format cannot hold is said. A result
whose verdict is 'do not use', or a URDF that states it, is refused with exit status 3, unless --accept is given.
""")
def convert(
    source: Annotated[str, typer.Argument(metavar="SOURCE", help=_SOURCE)],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="File to write.")],
    to: Annotated[str | None, typer.Option(metavar="FORMAT", help=_FORMATS)] = None,
    robot: Annotated[str | None, typer.Option(metavar="ROBOT", help=_ROBOT)] = None,
    ur_model: Annotated[
        str | None, typer.Option(metavar="NAME", help="Arm of Universal Robots, such as 'UR5e'.")
    ] = None,
    urcontrol: Annotated[
        Path | None, typer.Option(metavar="FILE", help="urcontrol.conf with the nominal rows.")
    ] = None,
    hash_from: Annotated[Path | None, typer.Option(metavar="FILE", help=_HASH)] = None,
    update: Annotated[
        Path | None, typer.Option(metavar="FILE", help="calibration.conf whose other lines stay.")
    ] = None,
    base: Base = None,
    tip: Annotated[
        str | None, typer.Option(help="Link that the chain ends at. Default: that of SOURCE.")
    ] = None,
    hold: Hold = None,
    accept: Accept = False,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """See the text of `verb`."""
    from calib.cli.setup import check_outputs, parse_held, say_accepted
    from calib.conversion import convert as converted
    from calib.formats.convert import Options
    from calib.text.convert import text

    inputs = [source, *(path for path in (robot, urcontrol, hash_from, update) if path)]
    check_outputs([output], inputs, force=force)
    held = parse_held(hold or [])
    options = Options(to, robot, ur_model, urcontrol, hash_from, update, base, tip, held, force)
    done = converted(source, output, options, accept=accept)
    if not quiet:
        typer.echo(text(done, source))
    say_accepted(f"'{source}'", done.against)
