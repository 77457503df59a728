"""Options and arguments that several verbs share, and the groups in which verbs take them.

A group is a frozen dataclass; `calib.cli.verb.verb` makes an option of each of its fields. The options of a cell are
declared at the fields of `calib.data.cell.Cell`; `CellOptions` takes them from there. Names in braces in a help text,
such as ``{families}``, are replaced by what is registered when the help is printed.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeVar, get_args

import typer

from calib.errors import CalibError, choices

if TYPE_CHECKING:
    from calib.data.cell import Cell
    from calib.data.forms.column_options import ColumnOptions
    from calib.result.call import Call

Self = TypeVar("Self", bound="CellOptions")

#: Help of ROBOT and of DATA.
ROBOT_HELP = (
    "URDF or xacro file (a xacro's arguments follow its name in the same quotes), MuJoCo model (MJCF), DH rows, or the "
    "name of a robot in example-robot-data, such as 'ur3'."
)
DATA_HELP = "Table (CSV or .xlsx) of joint values and measured points, with units in its header."

RobotFile = Annotated[str, typer.Argument(metavar="ROBOT", help=ROBOT_HELP)]
DataFile = Annotated[Path, typer.Argument(metavar="DATA", help=DATA_HELP)]
Accept = Annotated[
    bool,
    typer.Option(
        "--accept",
        help="Write files for a robot even if the verdict is 'do not use'. Without it they are not written, and the "
        "exit status is 3.",
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite files that exist.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")]
Seed = Annotated[
    int,
    typer.Option(
        min=0, metavar="S", help="Seed of the random numbers; the same seed gives the same result."
    ),
]
TargetLink = Annotated[
    bool,
    typer.Option(
        "--target-link",
        help="Add a link 'calib_target' at the target to the corrected URDF, of several 'calib_target_NAME' at each.",
    ),
]
FrameLink = Annotated[
    bool,
    typer.Option(
        "--frame-link",
        help="Add a link 'calib_frame' at the measurement frame (tracker, camera) to the corrected URDF, of several "
        "'calib_frame_NAME' at each.",
    ),
]
Columns = Annotated[
    list[str] | None,
    typer.Option(
        metavar='"NAME IN TABLE=NAME IN URDF [UNIT]"|BRAND',
        help="Rename a column of the table, and give its unit if the table has none; or name the brand whose column "
        "names the table has: {brands}. Can be repeated.",
    ),
]
PointsFile = Annotated[
    Path | None,
    typer.Option(
        "--points",
        metavar="FILE",
        help="List of the measured points, as laser tracker programs write it, or a sheet, 'data.xlsx#Sheet'. DATA "
        "then has the joint values.",
    ),
]
PointsUnit = Annotated[
    str | None,
    typer.Option("--points-unit", metavar="UNIT", help="Unit of --points, if the list names none."),
]
Workers = Annotated[
    int | None,
    typer.Option(
        min=1,
        metavar="N",
        help="Number of processes that share the work. Default: one for each core.",
    ),
]
Dask = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Address of a Dask scheduler, such as tcp://192.168.0.10:8786, whose workers do the work instead of "
        "--workers.",
    ),
]


def field_parameters(
    kind: type, groups: tuple[str, ...] = (), helps: Mapping[str, str] = MappingProxyType({})
) -> list[inspect.Parameter]:
    """Return the options that the fields of a record declare, as parameters of which typer makes options.

    Args:
        kind: The record, such as `Cell`.
        groups: Groups of options besides those of every verb.
        helps: Other help texts, by the names of the options.
    """
    from calib.basics.records import options

    parameters = []
    for option in options(kind, groups):
        words: Any = Literal[option.type] if isinstance(option.type, tuple) else option.type
        is_flag = option.type is bool
        help_text = helps.get(option.name, option.help)
        declared = typer.Option(
            option.flag, metavar=option.metavar, min=option.least, help=help_text
        )
        parameter = inspect.Parameter(
            option.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=False if is_flag else None,  # not given
            annotation=Annotated[words if is_flag else words | None, declared],
        )
        parameters.append(parameter)
    return parameters


def is_list(parameter: inspect.Parameter) -> bool:
    """Return True if an option of `field_parameters` can be repeated."""
    return list[str] in get_args(get_args(parameter.annotation)[0])


@dataclass(frozen=True, slots=True)
class CellOptions:
    """The cell file, and options over it: those that the fields of `Cell` declare for every verb."""

    #: Groups of further options, see `calib.basics.records.Option`.
    groups: ClassVar[tuple[str, ...]] = ()
    #: Names of the options that a verb takes, if it does not take all.
    names: ClassVar[tuple[str, ...] | None] = None
    #: True if a verb takes ``--cell``.
    has_file: ClassVar[bool] = True
    #: Help texts, by name, of options that mean something else to a verb.
    helps: ClassVar[Mapping[str, str]] = MappingProxyType({})

    #: ``--cell``; None: not given.
    file: Path | None = None
    #: The words typed, by the names of the options that were given.
    given: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def parameters(cls) -> list[inspect.Parameter]:
        """Return the options as parameters of a function, of which typer makes options."""
        from calib.data.cell import Cell

        parameters = field_parameters(Cell, cls.groups, cls.helps)
        if cls.names is not None:
            parameters = [parameter for parameter in parameters if parameter.name in cls.names]
        if not cls.has_file:
            return parameters
        help_text = "Cell file (TOML) with frames, targets, noise and priors. Options on the command line override it."
        of_file = typer.Option("--cell", help=cls.helps.get("cell", help_text))
        kind = inspect.Parameter.KEYWORD_ONLY
        annotation = Annotated[Path | None, of_file]
        return [inspect.Parameter("cell", kind, default=None, annotation=annotation), *parameters]

    @classmethod
    def of_typed(cls: type[Self], typed: Mapping[str, Any]) -> Self:
        """Make the options from the values typed for `parameters`, by name; those not given are left out."""
        # Zero is a value, though it equals False.
        given = {
            name: value
            for name, value in typed.items()
            if not (value is None or value is False or value == [])
        }
        return cls(given.pop("cell", None), given)

    def cell(self) -> Cell:
        """Read the cell file and put the options on top of it.

        Raises:
            CalibError: A text that its option does not take, or a fault of the file.
        """
        from calib.basics.records import changes
        from calib.data.cell import Cell

        of_file = Cell() if self.file is None else Cell.read(self.file)
        return replace(of_file, **changes(of_file, self.given))


@dataclass(frozen=True, slots=True)
class ModelOptions(CellOptions):
    """Options of the cell, with those of the errors of the robot."""

    groups: ClassVar[tuple[str, ...]] = ("model",)


@dataclass(frozen=True, slots=True)
class FitOptions(CellOptions):
    """Options of the cell, with those of the errors of the robot and of their estimation."""

    groups: ClassVar[tuple[str, ...]] = ("model", "fit")


#: Help of ``--target`` if there may be a result.
TARGET_OF_RESULT: Mapping[str, str] = {
    "target": 'Position of the target in the tip, such as "70 -70 22.5 mm". Default: that of --calibration, or of the '
    "URDF's link calib_target; else it is registered to the rows."
}


@dataclass(frozen=True, slots=True)
class SolverOptions:
    """Estimation: solver, robust weights, cross-validation."""

    solver: Annotated[
        str,
        typer.Option(
            metavar="SOLVER",
            help="Solver, one of {solvers}. lm (the default): calib's own; scipy: the same problem solved by SciPy; "
            "paper: the paper's algorithm.",
        ),
    ] = "lm"
    robust: Annotated[bool, typer.Option(help="Give outliers no weight.")] = True
    validate: Annotated[
        bool,
        typer.Option(
            help="Cross-validate. Without it there is no verdict, unless the input is plainly wrong."
        ),
    ] = True

    def check(self) -> None:
        """Check, once the cell file's plugins are loaded, that the solver exists; raises `ModelError`."""
        from calib.numerics.solvers import check_name

        check_name(self.solver)


@dataclass(frozen=True, slots=True)
class ColumnChoice:
    """Names, orientations and units of a table's columns."""

    columns: Columns = None
    orientation: Annotated[
        str | None,
        typer.Option(
            metavar="CONVENTION",
            help="Convention of the table's orientations: {conventions}. Default: as the columns' names say; rx, ry, "
            "rz are a rotation vector.",
        ),
    ] = None
    joint_unit: Annotated[
        str | None,
        typer.Option(
            metavar="UNIT",
            help='Unit of joint columns that name none, such as "deg"; "deg mm" if some joints slide.',
        ),
    ] = None

    def parsed(self) -> ColumnOptions:
        """Return the options for columns; ``--columns`` may rename some and name one brand.

        Raises:
            CalibError: A word is not of its form, a column is named twice, or there is no such convention or unit.
        """
        from calib.basics.units import parse_pairs
        from calib.data.forms.column_options import BRANDS, ColumnOptions

        given = list(self.columns or [])
        brands = [word for word in dict.fromkeys(given) if word.strip().casefold() in BRANDS]
        wanted = (
            "'name in the table=name in the URDF', with a unit in brackets if the table has none, each name once, or "
            f"one brand: {choices(BRANDS)}"
        )
        if len(brands) > 1:
            raise CalibError(f"--columns was given {choices(brands)}; it must be {wanted}.")
        names = parse_pairs((word for word in given if word not in brands), "--columns", wanted)
        brand = brands[0].strip().casefold() if brands else None
        return ColumnOptions(names, brand, self.orientation, self.joint_unit)


@dataclass(frozen=True, slots=True)
class TableOptions(ColumnChoice):
    """Reading of a table."""

    points: PointsFile = None
    points_unit: PointsUnit = None
    motors: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|TICKS@ZERO",
            help="What joint columns in ticks, or in LeRobot's numbers from -100 to 100 (--joint-unit ticks or %), "
            "mean: LeRobot's calibration file, or the ticks in a turn and the tick of the joints' zero, as 4096@2048.",
        ),
    ] = None

    @classmethod
    def of_call(cls, told: Call) -> TableOptions:
        """Return the options by which a calibration was told how its table is read."""
        return cls(
            columns=list(told.columns) or None,
            orientation=told.orientation,
            joint_unit=told.joint_unit,
            points=None if told.points is None else Path(told.points),
            points_unit=told.points_unit,
            motors=told.motors,
        )

    def parsed(self) -> ColumnOptions:
        """Return the options for columns, with what the numbers of servos mean; see `ColumnChoice.parsed`."""
        options = ColumnChoice(self.columns, self.orientation, self.joint_unit).parsed()
        return replace(options, motors=self.motors)


@dataclass(frozen=True, slots=True)
class JobOptions:
    """Processes or a Dask cluster that share the work."""

    workers: Workers = None
    dask: Dask = None
