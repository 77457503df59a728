"""``calib bag``: a table of measurements, and pictures, from a recording of ROS."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer

from calib.cli.options import Force, Quiet
from calib.cli.output_files import check_outputs, written_lines
from calib.cli.terminal import progress_bar
from calib.cli.verb import verb
from calib.errors import CalibError


@verb("""Make a table of measurements from a ROS bag (rosbag 1, rosbag 2, MCAP), without ROS.

\b
Examples:
  calib bag run.mcap
  calib bag run.mcap --joints /joint_states --points /tracker -o table.csv
  calib bag run.bag --joints /joint_states --points /tf:tool --robot robot.urdf -o table.csv
  calib bag run_folder --joints /joint_states --images /camera/image_raw --pictures pictures

Without topics those of the bag are listed. The lag of the points behind the joints is found from the motion, and taken
out. Joints and points are averaged where the arm stands; if it never does, each point is a row, with the joint values
at its time. --robot makes the lag more certain, and takes the joints of the robot alone.
""")
def bag(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="BAG",
            help="File .bag, .mcap or .db3, or the folder of a rosbag 2.",
        ),
    ],
    *,
    joints: Annotated[
        str | None,
        typer.Option(metavar="TOPIC", help="Topic of the joint values (JointState)."),
    ] = None,
    points: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[GROUP[/TARGET]=]TOPIC[:FRAME]",
            help="Topic of measured points or poses; of transforms with the frame that was measured: /tf:tool. Several "
            "are told apart by the instrument's place, GROUP, or the TARGET. Can be repeated.",
        ),
    ] = None,
    images: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[CAMERA=]TOPIC",
            help="Topic of pictures, of which one of each stop is written into --pictures. Can be repeated.",
        ),
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option(
            metavar="ROBOT",
            help="The nominal robot (URDF, xacro, DH rows, or a name): for its joints, and for the lag.",
        ),
    ] = None,
    tip: Annotated[
        str | None,
        typer.Option(
            metavar="LINK",
            help="Link of the robot that carries the target. Default: the end of the longest chain.",
        ),
    ] = None,
    without: Annotated[
        list[str] | None,
        typer.Option(
            metavar="JOINT",
            help="Leave a joint out, such as that of a gripper. Can be repeated.",
        ),
    ] = None,
    sliding: Annotated[
        list[str] | None,
        typer.Option(
            metavar="JOINT",
            help="A joint that slides, if no robot is given, which says so. Can be repeated.",
        ),
    ] = None,
    lag: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[TOPIC=]SECONDS",
            help="How much later points are stamped than joint values, if it is known. Default: found from the motion. "
            "Can be repeated.",
        ),
    ] = None,
    stamps: Annotated[
        Literal["auto", "header", "received"],
        typer.Option(
            help="Times of messages: their stamps, or when the recorder received them. auto: the stamps if they run "
            "as the recorder's clock does."
        ),
    ] = "auto",
    settle: Annotated[
        float,
        typer.Option(
            min=0.0,
            metavar="SECONDS",
            help="Time in which the arm settles at a stop, which is not used.",
        ),
    ] = 0.5,
    shortest: Annotated[
        float,
        typer.Option(
            min=0.05,
            metavar="SECONDS",
            help="Stops of which less is left are skipped.",
        ),
    ] = 0.3,
    moving: Annotated[
        bool | None,
        typer.Option(
            "--moving/--stops",
            help="Rows of the moving arm, or of its stops alone. Default: stops, if there are five.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="Write the table of points."),
    ] = None,
    pictures: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Write the pictures at the stops, and joints.csv with their joint values, for calib detect.",
        ),
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """List the topics, or read the streams, and write the table and the pictures."""
    from calib.robot.robot import Robot
    from calib.verbs.bag.bag import bag_table
    from calib.verbs.bag.bag_file import open_bag
    from calib.verbs.bag.pictures import ImageTopic, write_pictures
    from calib.verbs.bag.table import Settings
    from calib.verbs.bag.text import next_lines, skipped_lines, table_text, topics_text

    if joints is None:
        if points or images or output or pictures:
            raise CalibError(
                f"The topic of the joint values is missing: --joints TOPIC. 'calib bag {path}' lists the topics."
            )
        with open_bag(path) as opened:
            typer.echo("\n".join(topics_text(opened, str(path))))
        return
    if not points and not images:
        raise CalibError(
            f"State what was measured: --points TOPIC or --images TOPIC. 'calib bag {path}' lists the topics."
        )
    if (images is None) != (pictures is None):
        raise CalibError(
            "--images and --pictures belong together: the topics of the cameras, and the folder for their pictures."
        )
    if output is not None and not points:
        raise CalibError("-o is the table of --points, which are not given.")
    cameras = [ImageTopic.parse(text) for text in images or ()]
    if len({camera.camera for camera in cameras}) < len(cameras):
        raise CalibError("Several topics of --images need a name each: CAMERA=TOPIC.")
    check_outputs([output], [path, robot], force=force)
    arm = None if robot is None else Robot.load(robot, None, tip)
    with open_bag(path) as opened:
        with progress_bar("reading", quiet=quiet) as progress:
            made = bag_table(
                opened,
                joints,
                points or (),
                robot=arm,
                settings=Settings(settle, shortest),
                without=without or (),
                sliding=sliding or (),
                stamps=stamps,
                lags=_lags(lag or ()),
                moving=False if pictures is not None and not points else moving,
                progress=progress,
            )
        if not quiet:
            typer.echo("\n".join(table_text(made)))
        if output is not None:
            made.write(output, overwrite=force)
        if pictures is not None:
            with progress_bar("pictures", quiet=quiet) as progress:
                count, without_picture = write_pictures(
                    opened,
                    cameras,
                    made.recording.joints,
                    made.spans,
                    pictures,
                    by_stamps=made.recording.clocks[0][1].by == "header",
                    sliding=made.sliding,
                    overwrite=force,
                    progress=progress,
                )
            if not count:
                raise CalibError(
                    f"No picture was taken while the arm stood, so none is written; it has {len(made.spans)} stops "
                    "(--settle, --shortest)."
                )
            if not quiet:
                typer.echo("\n".join([f"{count} pictures.", *skipped_lines(without_picture)]))
    if not quiet:
        lines = written_lines(output, pictures)
        table = None if output is None else str(output)
        folder = None if pictures is None else str(pictures)
        typer.echo("\n".join([*lines, *next_lines(made, table, folder, robot)]))


def _lags(texts: Sequence[str]) -> dict[str, float]:
    """Return the stated lags [s] by topic, ``""`` for all of them; CalibError if one is no number."""
    lags = {}
    for text in texts:
        topic, _, value = text.rpartition("=")
        try:
            seconds = float(value)
        except ValueError as error:
            raise CalibError(
                f"--lag was given '{text}'; it must be a number of seconds, such as 0.25 or /tracker=0.25."
            ) from error
        if not math.isfinite(seconds) or topic in lags:
            raise CalibError(f"--lag was given '{text}'; it must be finite, and each topic once.")
        lags[topic] = seconds
    return lags
