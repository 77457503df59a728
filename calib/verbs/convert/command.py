"""``calib convert``: a calibrated robot in the formats of controllers and ROS."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import typer

from calib.cli.notices import say_accepted
from calib.cli.options import Accept, CellOptions, Force, Quiet
from calib.cli.output_files import check_outputs
from calib.cli.verb import verb


@dataclass(frozen=True, slots=True)
class ChainOptions(CellOptions):
    """Chain of the robot."""

    names: ClassVar[tuple[str, ...]] = ("base", "tip", "hold")
    has_file: ClassVar[bool] = False
    helps: ClassVar[Mapping[str, str]] = {
        "tip": "Link that the chain ends at. Default: that of SOURCE."
    }


def _formats() -> tuple[str, ...]:
    """Return the names of the output formats, each with what it holds."""
    from calib.verbs.convert.convert import FORMATS

    return tuple(f"{name} ({row.what})" for name, row in FORMATS.items())


@verb(
    """Write a calibrated robot in the formats of controllers and ROS.

\b
Examples:
  calib convert result.json --to dh -o rows.csv
  calib convert calibration.conf --arm UR5e -o ur5e_calibrated.urdf
  calib convert calibration.conf --arm UR5e -o kinematics.yaml
  calib convert result.json --to ur-yaml --hash-from own_kinematics.yaml -o kinematics.yaml
  calib convert xarm6_kinematics_AB12.yaml --robot xarm6.urdf -o xarm6_calibrated.urdf
  calib convert result.json --to ufactory-yaml --update xarm6_kinematics_AB12.yaml -o xarm6_kinematics_calib.yaml
  calib convert corrected.urdf --robot robot.urdf --to hayati -o rows.csv
  calib convert result.json --to zeros -o zeros.csv
  calib convert result.json --to mjcf --robot scene.xml -o corrected.xml
  calib convert rows.csv --to urdf -o robot.urdf
  calib convert result.json --to camera-mount --camera-frame color_optical --move camera_joint -o robot.urdf
  calib convert result.json --camera-frame color_optical -o camera.launch.py
  calib convert result.json --to static-transform --parent left_camera --child right_camera -o pair.launch.py

Every file is read back and compared with the robot before it appears; what a format cannot hold is reported. A result
whose verdict is 'do not use', a URDF that states this verdict, and joint zeros that are no better than none are refused
with exit status 3, unless --accept is given.
""",
    {"{formats}": _formats},
)
def convert(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="result.json, calibration.conf, kinematics.yaml, origins.yaml, DH rows (.csv, .json), a "
            "URDF, xacro or MJCF, or a robot's name.",
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="File to write.")],
    *,
    robot: Annotated[
        str | None,
        typer.Option(
            metavar="ROBOT",
            help="Nominal URDF or xacro, or the name of a robot; for --to mjcf and xacro the file to correct. Default: "
            "the one in a result, or a bare arm for --arm.",
        ),
    ] = None,
    arm: Annotated[
        str | None,
        typer.Option(
            "--arm",
            "--ur-model",
            metavar="NAME",
            help="Model of an arm of Universal Robots, UFACTORY or Flexiv, such as 'UR5e', 'xArm6', 'Rizon4s'.",
        ),
    ] = None,
    section: Annotated[
        str | None,
        typer.Option(
            metavar="KEY",
            help="Which arm of a file with the kinematics of several: a key above its table, such as 'left'.",
        ),
    ] = None,
    cell_options: ChainOptions,
    urcontrol: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The robot's urcontrol.conf, with the nominal DH rows."),
    ] = None,
    hash_from: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="The robot's own kinematics.yaml or calibration.conf, whose hash a new "
            "kinematics.yaml keeps.",
        ),
    ] = None,
    update: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="calibration.conf or kinematics YAML whose other lines are kept; or the robot's own file of offsets: "
            "the output is a copy with the joint zeros added.",
        ),
    ] = None,
    ticks: Annotated[
        int,
        typer.Option(
            metavar="N", help="Number of ticks in a turn of the servos, for --to lerobot."
        ),
    ] = 4096,
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Name of the camera (column group), if the table has several."
        ),
    ] = None,
    camera_frame: Annotated[
        str | None,
        typer.Option(metavar="LINK", help="Link of the URDF that is the camera's optical frame."),
    ] = None,
    move: Annotated[
        str | None,
        typer.Option(
            metavar="JOINT",
            help="Fixed joint whose origin is changed, so that the optical frame gets its estimated pose. "
            "Default: the only one between the link that carries the camera and --camera-frame.",
        ),
    ] = None,
    new_camera_frame: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Name of a link to add at the optical frame, if the URDF has no camera.",
        ),
    ] = None,
    board: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Name of the board (column target), if the table has several."
        ),
    ] = None,
    new_board_frame: Annotated[
        str | None, typer.Option(metavar="NAME", help="Name of a link to add at the board.")
    ] = None,
    parent: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Station (camera, tracker), target (board), further robot or link in which the pose of --child is "
            "published; with --to static-transform.",
        ),
    ] = None,
    child: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Station, target, robot or link on the same body; see --parent."
        ),
    ] = None,
    to: Annotated[
        str | None,
        typer.Option(
            metavar="FORMAT",
            help="Format of FILE: {formats}; DH rows as .csv or .json. Default: by the ending of FILE.",
        ),
    ] = None,
    accept: Accept = False,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Convert SOURCE into the file, and print what was read and written, and what the format does not hold."""
    from calib.verbs.convert.convert import convert as convert_robot
    from calib.verbs.convert.format import CameraOptions, Options
    from calib.verbs.convert.text import text

    inputs = [source, robot, urcontrol, hash_from, update]
    check_outputs([output], inputs, force=force, xacro=to in (None, "xacro"))
    chain = cell_options.cell()
    camera_options = CameraOptions(
        camera=camera,
        camera_frame=camera_frame,
        move=move,
        new_camera_frame=new_camera_frame,
        board=board,
        new_board_frame=new_board_frame,
        parent=parent,
        child=child,
    )
    options = Options(
        to=to,
        robot=robot,
        arm=arm,
        section=section,
        urcontrol=urcontrol,
        hash_from=hash_from,
        update=update,
        ticks=ticks,
        base=chain.base,
        tip=chain.tip,
        held=dict(chain.held),
        camera=camera_options,
        overwrite=force,
    )
    conversion = convert_robot(source, output, options=options, accept=accept)
    if not quiet:
        typer.echo(text(conversion, source))
    say_accepted(f"'{source}'", conversion.against)
