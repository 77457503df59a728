"""``calib convert``: a calibrated robot in the formats that controllers and ROS take."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.options import Base, Force, Hold, Quiet, one_of, verb
from calib.text.lines import fill

if TYPE_CHECKING:
    from calib.formats.sources import Source


#: A calibration that moves the tip further [mm] is most often the comparison of two robots.
_FAR_MM = 50.0

#: What to do with a file of each format; DH rows have one.
_USES = {
    "origins": "A xacro takes them with xacro.load_yaml, as the comment at the head of the file shows.",
    "ur-yaml": "The driver takes it so:",
    "ur-conf": "It is for programs that read a calibration.conf; what a controller does with one that it did not write "
    "itself, ask Universal Robots.",
    "dh": "Its head says how a row is meant. Rows alone are not the robot: 'base' goes into the frame that poses are "
    "given in, 'tool' into the tool.",
}


def parse_format(name: str) -> str:
    """The name of a format, for ``--to``."""
    from calib.formats.convert import FORMATS

    return one_of(name, FORMATS)


@verb("""Write a calibrated robot in the formats that controllers and ROS take.

\b
Examples:
  calib convert result.json --to dh -o rows.csv
  calib convert calibration.conf --ur-model UR5e -o ur5e_calibrated.urdf
  calib convert calibration.conf --ur-model UR5e -o kinematics.yaml
  calib convert result.json --to ur-yaml --hash-from own_kinematics.yaml -o kinematics.yaml
  calib convert corrected.urdf --robot robot.urdf --to hayati -o rows.md

SOURCE is a result of 'calib fit --json', a calibration.conf or kinematics.yaml of Universal Robots, an origins file, or
a URDF, a xacro or the name of a robot. What is written is read back and compared with the robot before it appears; what
a format cannot hold is said.
""")
def convert(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="What is converted: result.json, calibration.conf, kinematics.yaml, origins.yaml, a URDF, a xacro, "
            "or a robot of example-robot-data.",
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="File to write.")],
    to: Annotated[
        str | None,
        typer.Option(
            parser=parse_format,
            metavar="FORMAT",
            help="Format of FILE: urdf, ur-yaml, ur-conf, origins; dh: standard DH rows; modified-dh: Craig's; hayati: "
            "standard, with beta between near-parallel axes; each as .csv, .json or .md. Default: what its ending "
            "says, if it says one.",
        ),
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option(
            "--robot",
            metavar="ROBOT",
            help="Nominal robot: URDF, xacro or name. Default: the one that a result holds; a bare arm for --ur-model.",
        ),
    ] = None,
    ur_model: Annotated[
        str | None,
        typer.Option("--ur-model", metavar="NAME", help="Arm of Universal Robots, such as 'UR5e'."),
    ] = None,
    urcontrol: Annotated[
        Path | None,
        typer.Option(
            "--urcontrol",
            metavar="FILE",
            help="urcontrol.conf with the nominal rows of a calibration.conf. Default: those of the model.",
        ),
    ] = None,
    hash_from: Annotated[
        Path | None,
        typer.Option(
            "--hash-from",
            metavar="FILE",
            help="The robot's own kinematics.yaml or calibration.conf, whose hash a new kinematics.yaml keeps.",
        ),
    ] = None,
    update: Annotated[
        Path | None,
        typer.Option(
            "--update",
            metavar="FILE",
            help="calibration.conf whose other lines a new one keeps.",
        ),
    ] = None,
    base: Base = None,
    tip: Annotated[
        str | None,
        typer.Option(help="Link that the chain ends at. Default: that of SOURCE, or the farthest."),
    ] = None,
    hold: Hold = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """See the text of `verb`."""
    from calib.cli.setup import check_outputs, parse_held
    from calib.formats.convert import FORMATS, Wanted, check_options, chosen_format, write_target
    from calib.formats.sources import Asked, read_source, source_kind

    inputs = [source, *(path for path in (robot, urcontrol, hash_from, update) if path)]
    check_outputs([output], inputs, force=force)
    kind = source_kind(source)
    wanted = Wanted(
        output, chosen_format(output, to, kind), hash_from, update, urcontrol, overwrite=force
    )
    check_options(wanted, kind)
    asked = Asked(robot, ur_model, urcontrol, base, tip, parse_held(hold or []))
    found = read_source(source, asked)
    remarks = write_target(found, wanted)
    if quiet:
        return
    paragraphs = [
        f"Read: {source}, {found.text}.",
        _moved(found),
        *found.remarks,
        *remarks,
        f"Written: {wanted.path}, {FORMATS[wanted.format].what}. {_use(found, wanted.format)}",
    ]
    # Reader and writer may say the same.
    text = "\n\n".join(map(fill, dict.fromkeys(paragraphs)))
    if wanted.format == "ur-yaml":
        known = found.model is not None and found.model.known
        arm = found.model.name.lower().replace(" ", "") if found.model and known else "TYPE"
        here = "" if output.is_absolute() else '"$PWD"/'
        # On lines of its own, to be copied.
        text += (
            f"\n\n  ros2 launch ur_robot_driver ur_control.launch.py ur_type:={arm} robot_ip:=ADDRESS \\"
            f"\n    kinematics_params_file:={here}{shlex.quote(str(output))}"
        )
    typer.echo(text)


def _moved(found: Source) -> str:
    """How far the tip lies from where the nominal robot has it."""
    import numpy as np

    apart = found.distances()
    if apart is None:
        return "How far it is from its nominal robot is not known; --robot names that."
    if found.robot is found.nominal:
        return "This is a nominal robot: there is no calibration in it."
    mm, deg = 1e3 * apart[0], np.degrees(apart[1])
    doubt = " Calibrations move it by millimetres: check that both are one robot, between the same links."
    return (
        f"Over the joint limits '{found.robot.tip}' lies {mm.mean():.3f} mm (mean) and at most {mm.max():.3f} mm from "
        f"where the nominal robot has it, turned by {deg.mean():.3f} deg (mean) and at most {deg.max():.3f} deg."
    ) + doubt * bool(mm.max() > _FAR_MM)


def _use(found: Source, format: str) -> str:
    """What to do with the file."""
    if format != "urdf":
        return _USES.get(format, _USES["dh"])
    if found.nominal is None or found.nominal is found.robot:
        return "It is the robot as it was read."
    if found.nominal.urdf.path is None:
        return (
            "It is a bare arm, without meshes and masses. To have these origins in a description that has them, give "
            "that as --robot."
        )
    return "Only origins of joints differ from the nominal URDF: use it wherever that was used."
