"""Options and arguments that several verbs share, and the groups in which verbs take them.

A group is a frozen dataclass; `calib.cli.verb.verb` makes an option of each of its fields. Names in braces in a help
text, such as ``{families}``, are replaced by what is registered when the help is printed.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

if TYPE_CHECKING:
    from calib.data.forms.column_options import ColumnOptions

RobotFile = Annotated[
    str,
    typer.Argument(
        metavar="ROBOT",
        help="URDF or xacro file, a xacro's arguments behind it in the same quotes; DH rows; or a robot "
        "of example-robot-data, such as 'ur3'.",
    ),
]
DataFile = Annotated[
    Path,
    typer.Argument(
        metavar="DATA",
        help="Table (CSV, .xlsx) with units in its header: joint values and measured points.",
    ),
]
Base = Annotated[
    str | None,
    typer.Option(help="Link in whose frame the chain starts. Default: the URDF's root."),
]
Tip = Annotated[
    str | None,
    typer.Option(
        help="Link that the target is mounted on. Default: the end of the longest chain, of a "
        "table's joints if any, before a gripper or hand."
    ),
]
Target = Annotated[
    str | None,
    typer.Option(
        metavar='"X Y Z UNIT"',
        help='Stated position of the target in the tip, such as "70 -70 22.5 mm". The nominal robot '
        "is judged with it, and the estimate is checked against it.",
    ),
]
ResultTarget = Annotated[
    str | None,
    typer.Option(
        "--target",
        metavar='"X Y Z UNIT"',
        help='Target in the tip, such as "70 -70 22.5 mm". Default: that of --calibration, or of '
        "the URDF's link calib_target; else registered to the rows.",
    ),
]
Frame = Annotated[
    str | None,
    typer.Option(
        metavar="known|estimate|LIST",
        help="'known': the points are in the base frame (default). 'estimate': in any fixed "
        'frame, such as the tracker\'s. A list such as "x,y,rz": known but for these directions.',
    ),
]
ModelName = Annotated[
    str | None,
    typer.Option(
        "--model",
        metavar="SET[+FAMILY...]",
        help="Errors of the robot. auto, the default of a fit: as many as the data support. dh: "
        "a, alpha, d, theta of each DH row; paper: the same with a known frame; hayati: beta for "
        "d between near-parallel axes; placement: all six of each joint; zeros; frames: none. "
        "Sets: {models}. Append families with +: {families} (dh+gain).",
    ),
]
MeasuredKind = Annotated[
    str | None,
    typer.Option(
        "--kind",
        metavar="KIND",
        help="What every row measures: {kinds}. Default: as a table's columns say, else point.",
    ),
]
PointsFile = Annotated[
    Path | None,
    typer.Option(
        "--points",
        metavar="FILE",
        help="Measured points in a separate list, as laser tracker programs write them, or in a "
        "sheet, 'data.xlsx#Sheet'; DATA has the joint values.",
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
        help='Value of a joint that does not move, such as "lift=0.3 m"; it needs no column. Can '
        "be repeated.",
    ),
]
PayloadMass = Annotated[
    str | None,
    typer.Option(
        "--payload",
        metavar='"MASS UNIT"',
        help='What the tip carries, such as "5 kg", for compliances; put its centre of mass into '
        "the cell file.",
    ),
]
Columns = Annotated[
    list[str] | None,
    typer.Option(
        metavar='"NAME IN TABLE=NAME IN URDF [UNIT]"|BRAND',
        help="Rename a column of the table, and give its unit if it has none. Or the brand whose "
        "names the columns have: {brands}. Can be repeated.",
    ),
]
Orientation = Annotated[
    str | None,
    typer.Option(
        metavar="CONVENTION",
        help="Convention of the table's orientations: {conventions}. Default: as the columns' "
        "names say; rx, ry, rz are a rotation vector.",
    ),
]
JointUnit = Annotated[
    str | None,
    typer.Option(
        metavar="UNIT",
        help='Unit of joint columns that name none: deg; where some joints slide "deg mm".',
    ),
]
CellFile = Annotated[
    Path | None,
    typer.Option(
        "--cell",
        help="TOML file with frames, target, noise, priors; options on the command line win.",
    ),
]
CameraFiles = Annotated[
    list[str] | None,
    typer.Option(
        "--camera",
        metavar="[NAME=]FILE|WIDTHxHEIGHT",
        help="Intrinsics of the camera: ROS camera_info, OpenCV or calib's own file; or the size of its images alone, "
        "such as 1280x720, where nothing is known of it. With NAME= that of one station; can be repeated.",
    ),
]
BoardFiles = Annotated[
    list[str] | None,
    typer.Option(
        "--board",
        metavar="[NAME=]FILE",
        help="Description of the printed board, as 'calib board' writes it: how well its print is known. With NAME= "
        "that of one target; can be repeated.",
    ),
]
CameraOn = Annotated[
    str | None,
    typer.Option(
        metavar="LINK",
        help="Link that carries the camera: the flange, or for one that stands, the URDF's root (default). The same as "
        "--base.",
    ),
]
BoardOn = Annotated[
    str | None,
    typer.Option(
        metavar="LINK",
        help="Link that carries the board: the URDF's root where the camera is on the hand. The same as --tip.",
    ),
]
SolverName = Annotated[
    str,
    typer.Option(
        metavar="SOLVER",
        help="One of {solvers}. lm: the default. scipy: the same problem by SciPy. paper: the "
        "paper's algorithm.",
    ),
]
PriorSource = Annotated[
    Literal["data", "given", "off"] | None,
    typer.Option(
        help="Prior standard deviations of the robot's errors: estimated from the data (data, "
        "default), as the cell file or calib's own 3 mm and 15 mrad say (given), or no priors "
        "(off).",
    ),
]
Repeats = Annotated[
    Literal["weighted", "average", "independent"] | None,
    typer.Option(
        help="Weighting of repeated poses: by the estimated correlation of their errors (weighted, "
        "default), as one row (average), or each in full (independent).",
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
        help="Dask scheduler whose workers do the work, such as tcp://192.168.0.10:8786, in place "
        "of --workers.",
    ),
]
FixTarget = Annotated[
    bool, typer.Option("--fix-target", help="Keep the target where --target says it is.")
]
Freeze = Annotated[
    list[str] | None,
    typer.Option(
        metavar="PARAMETER",
        help="Keep a parameter at its nominal value. Can be repeated.",
    ),
]
TargetLink = Annotated[
    bool,
    typer.Option(
        "--target-link",
        help="Add a link 'calib_target' at the target to the corrected URDF.",
    ),
]
Robust = Annotated[bool, typer.Option(help="Give outliers no weight.")]
Validate = Annotated[
    bool,
    typer.Option(
        help="Cross-validate; without it there is no verdict, unless the input is plainly wrong."
    ),
]
Seed = Annotated[int, typer.Option(min=0, metavar="S", help="The same seed gives the same result.")]
Accept = Annotated[
    bool,
    typer.Option(
        "--accept",
        help="Write files for a robot even where the verdict is 'do not use'; without it they are "
        "not written, and the exit status is 3.",
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite files that exist.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")]
Plugins = Annotated[
    list[str] | None,
    typer.Option(
        "--plugin",
        metavar="FILE|MODULE",
        help="Python file (.py) or importable module with families, kinds, solvers, parameter sets "
        "or formats of your own, loaded before anything else. Can be repeated.",
    ),
]
Debug = Annotated[bool, typer.Option("--debug", help="Show the trace of an error.")]


@dataclass(frozen=True, slots=True)
class CellOptions:
    """Measurement setup, as typed; `calib.cli.setup.read_cell` takes the fields by name."""

    base: Base = None
    tip: Tip = None
    target: Target = None
    frame: Frame = None
    kind: MeasuredKind = None
    hold: Hold = None
    camera: CameraFiles = None
    camera_on: CameraOn = None
    board: BoardFiles = None
    board_on: BoardOn = None
    cell: CellFile = None


@dataclass(frozen=True, slots=True)
class ModelOptions(CellOptions):
    """Measurement setup, and the errors of the robot that are estimated."""

    model: ModelName = None
    payload: PayloadMass = None


@dataclass(frozen=True, slots=True)
class FitOptions(ModelOptions):
    """Measurement setup, errors, and restrictions of the estimation, for `calibrate` and `fleet`."""

    fix_target: FixTarget = False
    freeze: Freeze = None
    priors: PriorSource = None
    repeats: Repeats = None


@dataclass(frozen=True, slots=True)
class SolverOptions:
    """Estimation: solver, robust weights, cross-validation."""

    solver: SolverName = "lm"
    robust: Robust = True
    validate: Validate = True

    def check(self) -> None:
        """Check, once the cell file's plugins are loaded, that the solver exists; raises `ModelError`."""
        from calib.numerics.solvers import check_name

        check_name(self.solver)


@dataclass(frozen=True, slots=True)
class ColumnChoice:
    """Names, orientations and units of a table's columns."""

    columns: Columns = None
    orientation: Orientation = None
    joint_unit: JointUnit = None

    def parsed(self) -> ColumnOptions:
        """Return what is said of the columns; raises `CalibError`."""
        from calib.cli.words import parse_columns

        return parse_columns(self.columns, self.orientation, self.joint_unit)


@dataclass(frozen=True, slots=True)
class TableOptions(ColumnChoice):
    """Reading of a table."""

    points: PointsFile = None
    points_unit: PointsUnit = None


@dataclass(frozen=True, slots=True)
class JobOptions:
    """Processes or a Dask cluster that share the work."""

    workers: Workers = None
    dask: Dask = None
