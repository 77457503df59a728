"""Notices of a call: rows and columns that were not used, coupled readings, a verdict that was overridden."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from calib.errors import choices
from calib.show.lines import fill, row_ranges
from calib.show.robot_sentences import coupling_sentence

if TYPE_CHECKING:
    from calib.data.cell import Cell
    from calib.data.measurements import Measurements
    from calib.robot.robot import Robot


def say_accepted(name: str, stated: str) -> None:
    """Say on stderr, even with ``--quiet``, which verdict ``do not use`` was overridden by ``--accept``.

    Args:
        name: The file that the verdict is on.
        stated: The verdict, as `calib.show.verdict_text.do_not_use_text` gives it; nothing is said if it is empty.
    """
    if stated:
        typer.echo(
            f"calib: the verdict on {name} is: {stated} Because of --accept it was used anyway.",
            err=True,
        )


def say_ignored(measurements: Measurements, robot: Robot) -> None:
    """Print which rows and columns were not used, and how orientations were read if not as a quaternion.

    A joint among the columns hints at a wrong base or tip.

    Args:
        measurements: The table, which knows what of it was not used.
        robot: The chain that was measured.
    """
    from calib.basics.units import split_header
    from calib.data.forms.orientations import QUATERNION, find_convention

    empty = measurements.unmeasured
    if empty:
        total = len(measurements) + len(empty)
        text = (
            f"{len(empty)} of {total} rows not measured: {row_ranges(empty)}. They only tell from where the next rows "
            "were approached."
        )
        typer.echo(fill(text) + "\n")
    if measurements.orientation not in ("", QUATERNION.name):
        words = find_convention(measurements.orientation).words
        typer.echo(
            f"Orientations were read as {words} (--orientation {measurements.orientation}).\n"
        )
    if not measurements.ignored:
        return
    text = f"Columns not used: {choices(measurements.ignored)}."

    # A held joint and one that follows another have columns that are not needed: nothing is wrong with the chain.
    moving = {joint.name for joint in robot.urdf.joints if joint.type != "fixed"}
    beside = moving - {*robot.held, *(joint.name for joint in robot.joints)}
    names = [split_header(label)[0] for label in measurements.ignored]
    outside = [name for name in names if name in beside]
    if outside:
        text += (
            f" Not between '{robot.base}' and '{robot.tip}' (--base, --tip): {choices(outside)}."
        )
    typer.echo(fill(text) + "\n")


def say_unused_camera(measurements: Measurements, cell: Cell) -> None:
    """Say that a camera or a board is given although no row is an image."""
    names = [name for name in ("camera", "board") if getattr(cell, f"{name}s")]
    if not names or measurements.is_image.any():
        return
    given = " and ".join(f"--{name}" for name in names)
    text = f"Not used: {given}; no row is an image. Poses take the camera and its board as exact."
    typer.echo(fill(text) + "\n")


def say_coupled(robot: Robot) -> None:
    """Say which joint readings are coupled, if any are."""
    sentence = coupling_sentence(robot)
    if sentence:
        typer.echo(fill(sentence) + "\n")
