"""Options and arguments that several verbs share, what a verb is, and how errors leave the program."""

from __future__ import annotations

import inspect
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_type_hints

import typer
from typer.core import TyperCommand

from calib.cli.exit_status import ExitStatus
from calib.errors import CalibError, VerdictError

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
        help="Link that the target is mounted on. Default: the end of the longest chain, of a table's joints if any."
    ),
]
Target = Annotated[
    str | None,
    typer.Option(
        metavar='"X Y Z UNIT"',
        help='Target in the tip, such as "70 -70 22.5 mm". A fit starts there, and finds one that is not given.',
    ),
]
ResultTarget = Annotated[
    str | None,
    typer.Option(
        "--target",
        metavar='"X Y Z UNIT"',
        help='Target in the tip, such as "70 -70 22.5 mm". Default: that of --calibration, or of the URDF\'s link '
        "calib_target; else registered to the rows.",
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
        help="Errors of the robot. auto, the default of a fit: as many as the data support. dh: a, alpha, d, theta "
        "of each DH row; paper: the same with a known frame; hayati: beta for d between near-parallel axes; placement: "
        "all six of each joint; zeros; frames: none. Behind these: gain, eccentricity, compliance, gravity (dh+gain).",
    ),
]
MeasuredKind = Annotated[
    str | None,
    typer.Option(
        "--kind",
        metavar="KIND",
        help="What every row measures: point, pose, distance, pair, fixed, plane, or a kind that was registered. "
        "Default: as a table's columns say, else point.",
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
        help='Value of a joint that stands still, such as "lift=0.3 m"; it needs no column. Can be repeated.',
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
SolverName = Annotated[
    Literal["lm", "scipy", "paper"],
    typer.Option(
        help="lm: the default. scipy: the same problem by SciPy. paper: the paper's algorithm.",
    ),
]
PriorSizes = Annotated[
    Literal["data", "given", "off"] | None,
    typer.Option(
        help="Sizes of the robot's errors: found from the data (data, default), as the cell file or calib's own "
        "3 mm and 15 mrad say (given), or no priors (off).",
    ),
]
Repeats = Annotated[
    Literal["weighted", "average", "independent"] | None,
    typer.Option(
        help="How rows of one pose count: as their own scatter and what they share say (weighted, default), as "
        "one row (average), or each for itself (independent).",
    ),
]
Workers = Annotated[
    int | None,
    typer.Option(min=1, metavar="N", help="Processes that share the work. Default: one per core."),
]
SampleWorkers = Annotated[
    int | None,
    typer.Option(
        "--workers",
        min=1,
        metavar="N",
        help="Processes that share the samples of --bootstrap. Default: one.",
    ),
]
Dask = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Dask scheduler whose workers do the work, such as tcp://192.168.0.10:8786, in place of --workers.",
    ),
]
FixTarget = Annotated[
    bool, typer.Option("--fix-target", help="Keep the target where --target says it is.")
]
Freeze = Annotated[
    list[str] | None,
    typer.Option(
        metavar="PARAMETER", help="Keep a parameter at its nominal value. Can be repeated."
    ),
]
TargetLink = Annotated[
    bool,
    typer.Option(
        "--target-link", help="Add a link 'calib_target' at the target to the corrected URDF."
    ),
]
Robust = Annotated[bool, typer.Option(help="Give outliers no weight.")]
Validate = Annotated[bool, typer.Option(help="Cross-validate; without it there is no verdict.")]
Seed = Annotated[int, typer.Option(min=0, metavar="S", help="The same seed gives the same result.")]
Accept = Annotated[
    bool,
    typer.Option(
        "--accept",
        help="Write what a robot could be given even where the verdict is 'do not use'; without it that is not "
        "written, and the exit status is 3.",
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite files that exist.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")]
Debug = Annotated[bool, typer.Option("--debug", help="Show the trace of an error.")]


@dataclass(frozen=True, slots=True)
class CellOptions:
    """The set-up as the line has it; `calib.cli.setup.read_cell` takes the fields by name."""

    base: Base = None
    tip: Tip = None
    target: Target = None
    frame: Frame = None
    kind: MeasuredKind = None
    hold: Hold = None
    cell: CellFile = None


@dataclass(frozen=True, slots=True)
class ModelOptions(CellOptions):
    """The same with the errors that are estimated."""

    model: ModelName = None
    payload: PayloadMass = None


@dataclass(frozen=True, slots=True)
class FitOptions(ModelOptions):
    """The same with how they are estimated, for `calibrate` and `fleet`."""

    fix_target: FixTarget = False
    freeze: Freeze = None
    priors: PriorSizes = None
    repeats: Repeats = None


@dataclass(frozen=True, slots=True)
class TableOptions:
    """How a table is read; `calib.cli.setup.load_with_data` takes the fields by name."""

    points: PointsFile = None
    points_unit: PointsUnit = None
    columns: Columns = None


class Verb(TyperCommand):
    """A command that refuses two values for an option that has one, of which the last would win silently."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401  typer's own class
        """Parse the words of a call; a wrong call ends the program with exit status 2.

        Args:
            ctx: The call.
            args: Its words, behind the verb's name.

        Returns:
            The words that are left over.
        """
        _, _, given = self.make_parser(ctx).parse_args(args=[*args])
        for option in self.get_params(ctx):
            # A switch such as --force may come again; --robust beside --no-robust may not.
            switch = getattr(option, "is_flag", False) and not option.secondary_opts
            if option.nargs == 1 and not (switch or getattr(option, "multiple", True)):
                times = given.count(option)
                if times > 1:
                    names = "/".join((*option.opts, *option.secondary_opts))
                    ctx.fail(f"Option '{names}' is given {times} times. Give it once.")
        return super().parse_args(ctx, args)


def verb(text: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """A function as a verb of the command line with this ``--help``, ``--debug``, and errors as `reporting` puts them.

    A parameter that is one of the classes above stands for its fields, an option each.
    """

    def made(function: Callable[..., None]) -> Callable[..., None]:
        types = get_type_hints(function, include_extras=True)
        groups: dict[str, Any] = {k: kind for k, kind in types.items() if is_dataclass(kind)}
        found: dict[str, tuple[Any, Any]] = {}
        for p in inspect.signature(function).parameters.values():
            if p.name in groups:
                inner = get_type_hints(groups[p.name], include_extras=True)
                found |= {f.name: (inner[f.name], f.default) for f in fields(groups[p.name])}
            else:
                found[p.name] = types[p.name], p.default
        found["debug"] = Debug, False
        options = [
            inspect.Parameter(
                name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind
            )
            for name, (kind, default) in found.items()
        ]

        def called(**given: Any) -> None:  # noqa: ANN401
            with reporting(debug=given.pop("debug")):
                for name, kind in groups.items():
                    given[name] = kind(**{f.name: given.pop(f.name) for f in fields(kind)})
                function(**given)

        called.__name__, called.__doc__ = function.__name__, text
        called.__annotations__ = {}
        called.__signature__ = inspect.Signature(options)  # type: ignore[attr-defined]
        return called

    return made


@contextmanager
def reporting(*, debug: bool) -> Iterator[None]:
    """Errors as one line on stderr and their exit status; with ``debug`` the trace before it.

    The text of a `KeyboardInterrupt` says what stays of the work.
    """
    try:
        yield
    except typer.Exit:
        raise
    except BrokenPipeError as error:
        # The reader of our output (head, less) has gone: nothing to say to it.
        sys.stderr.close()
        raise typer.Exit(ExitStatus.DONE) from error
    except KeyboardInterrupt as error:
        said = f"interrupted; no file was left half written. {error}".rstrip()
        typer.echo(f"calib: {said}", err=True)
        raise typer.Exit(ExitStatus.INTERRUPTED) from error
    except OSError:  # said by `calib.cli.main`
        raise
    except Exception as error:
        said, own = str(error), not isinstance(error, CalibError)
        if own:
            said = f"a fault of calib itself: {type(error).__name__}: {error}. Report it with what --debug shows."
        if own and debug:
            raise
        if debug:
            traceback.print_exc()
        typer.echo(f"calib: {said}", err=True)
        obeyed = isinstance(error, VerdictError)
        raise typer.Exit(ExitStatus.NOT_ACCEPTED if obeyed else ExitStatus.REFUSED) from error
