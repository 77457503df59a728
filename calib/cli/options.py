"""Options and arguments that several verbs share, and how errors leave the program."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from calib.errors import CalibError, choices


def parse_kind(name: str) -> str:
    """The name of a kind of measurement, for ``--kind``."""
    import calib.kinds as registry

    if name not in registry.names():
        message = f"{name!r} is not one of {choices(registry.names())}."
        raise typer.BadParameter(message)
    return name


class Repeats(str, Enum):
    """How rows of one pose count."""

    weighted = "weighted"
    average = "average"
    independent = "independent"


class Solver(str, Enum):
    """The solvers."""

    lm = "lm"
    paper = "paper"
    scipy = "scipy"


class PriorSizes(str, Enum):
    """Where the sizes of the priors come from."""

    data = "data"
    given = "given"
    off = "off"


RobotFile = Annotated[
    str,
    typer.Argument(
        metavar="ROBOT",
        help="URDF or xacro file, a xacro's arguments behind it in the same quotes; or a robot of example-robot-data, "
        "such as 'ur3'.",
    ),
]
DataFile = Annotated[
    Path,
    typer.Argument(
        metavar="DATA", help="CSV table with units in its header: joint values and measured points."
    ),
]
Base = Annotated[
    str | None, typer.Option(help="Link in whose frame the chain starts. Default: the URDF's root.")
]
Tip = Annotated[
    str | None,
    typer.Option(
        help="Link that the target sits on. Default: the end of the longest chain whose joints are in the table."
    ),
]
Target = Annotated[
    str | None,
    typer.Option(
        metavar='"X Y Z UNIT"',
        help='Target in the tip, such as "70 -70 22.5 mm"; a start, unless --fix-target. Default: found from the data.',
    ),
]
Frame = Annotated[
    str | None,
    typer.Option(
        metavar="known|estimate|LIST",
        help="'known': the points are in the base frame (default). 'estimate': in any fixed frame, such as the "
        'tracker\'s. A list such as "x,y,rz": known but for these directions.',
    ),
]
ModelName = Annotated[
    str | None,
    typer.Option(
        "--model",
        metavar="SET[+FAMILY...]",
        help="Which errors are estimated. auto: as many as the measurements support (default). dh: a, alpha, d, theta "
        "of each DH row; paper: the same with a known frame; hayati: beta for d between near-parallel axes; placement: "
        "all six of each joint; zeros; frames: none. Added to these: gain, eccentricity, compliance, as in dh+gain.",
    ),
]
MeasuredKind = Annotated[
    str | None,
    typer.Option(
        "--kind",
        parser=parse_kind,
        metavar="KIND",
        help="What every row measures: point, pose, distance, pair, fixed or plane. Default: as the columns say.",
    ),
]
PointsFile = Annotated[
    Path | None,
    typer.Option(
        "--points",
        metavar="FILE",
        help="Measured points in a list of their own, as laser tracker programs write them; DATA has the joint values.",
    ),
]
PointsUnit = Annotated[
    str | None,
    typer.Option("--points-unit", metavar="UNIT", help="The unit of --points, if it names none."),
]
Hold = Annotated[
    list[str] | None,
    typer.Option(
        metavar='"JOINT=VALUE UNIT"',
        help='Value of a joint that was not moved and has no column, such as "lift=0.3 m". Can be repeated.',
    ),
]
PayloadMass = Annotated[
    str | None,
    typer.Option(
        "--payload",
        metavar='"MASS UNIT"',
        help='What the tip carries, such as "5 kg", for compliances; its centre of mass stands in the cell file.',
    ),
]
Columns = Annotated[
    list[str] | None,
    typer.Option(
        metavar='"NAME IN TABLE=NAME IN URDF [UNIT]"',
        help="Rename a column of the table, and give its unit if it has none. Can be repeated.",
    ),
]
CellFile = Annotated[
    Path | None,
    typer.Option(
        "--cell", help="TOML file with frames, target, noise, priors; options on the line win."
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite files that exist.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")]
Debug = Annotated[bool, typer.Option("--debug", help="Show the trace of an error.")]


@contextmanager
def reporting(*, debug: bool) -> Iterator[None]:
    """Errors as one line on stderr and exit code 1; with ``debug`` the trace before it.

    The text of a `KeyboardInterrupt` says what stays of the work.
    """
    try:
        yield
    except CalibError as error:
        if debug:
            traceback.print_exc()
        typer.echo(f"calib: {error}", err=True)
        raise typer.Exit(1) from error
    except KeyboardInterrupt as error:
        more = f" {error}" if str(error) else ""
        typer.echo(f"calib: interrupted; no file was left half written.{more}", err=True)
        raise typer.Exit(130) from error
    except BrokenPipeError as error:
        # The reader of our output (head, less) has gone: nothing to say to it.
        sys.stderr.close()
        raise typer.Exit(0) from error
    except OSError as error:
        # Files have messages of their own: this is mostly a full disk behind `>`.
        if debug:
            traceback.print_exc()
        where = f"'{error.filename}'" if error.filename else "the printed text"
        reason = error.strerror or type(error).__name__
        typer.echo(f"calib: {where} cannot be read or written: {reason}.", err=True)
        raise typer.Exit(1) from error
    except typer.Exit:
        raise
    except Exception as error:
        if debug:
            raise
        typer.echo(
            f"calib: a fault of calib itself: {type(error).__name__}: {error}. Please report it with the output of the "
            "same command and --debug.",
            err=True,
        )
        raise typer.Exit(1) from error
