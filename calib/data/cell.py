"""Cell: what stands around the robot while it is measured, and what of it is known.

The measurement frames, the targets on the tip, the instrument and its noise, obstacles, prior standard deviations of
the robot's errors, the payload, and which parameters are estimated. All of it can stand in a TOML file,
``--cell cell.toml``; see docs/cell.md.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import MISSING, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import calib.basics.plugins as plugins
import calib.data.kinds as registry
from calib.basics.arguments import check_path
from calib.basics.arrays import Array, read_only
from calib.basics.files import read_bytes
from calib.basics.records import (
    Key,
    Option,
    add_entries,
    given_values,
    keep_checked,
    key,
    keys,
    parse_toml,
    read_values,
    table_of,
    tables_of,
    toml_text,
)
from calib.basics.units import (
    MASS,
    Angle,
    Length,
    parse_amount,
    parse_joint_values,
    parse_point,
)
from calib.basics.value_forms import (
    JOINT_RANGE,
    JOINT_VALUE,
    NAMES,
    POINT_MM,
    TABLE,
    TRUTH,
    Check,
    Place,
    decimal,
    named,
    one_of,
    text,
    three_numbers,
)
from calib.basics.values import ReadOnlyMapping, Value, one_line
from calib.boards.board import Board
from calib.boards.board_file import board_toml
from calib.camera.camera import Camera
from calib.camera.camera_file import camera_toml
from calib.data.cell_keys import (
    ARE_BOUNDS,
    ARE_DIRECTIONS,
    ARE_FACTORS,
    ARE_SIGMAS,
    BOUNDS,
    CHANGE,
    FACTORS,
    FRAME_DIRECTIONS,
    FRAME_ESTIMATED,
    IS_JOINT_VALUE,
    IS_POSE,
    IS_POSITION,
    IS_PRIOR_STD,
    IS_RANGE,
    IS_TIE,
    RPY_DEG,
    TIE,
    board_keys,
    by_name,
    camera_keys,
    frame_option,
    link_options,
    pose_form,
    pose_keys,
    robots_by_name,
    sigma_keys,
    words_by_name,
    write_bounds,
    write_change,
    write_described,
    write_frame,
    write_pose,
    write_sigma,
)
from calib.data.priors import Priors, prior_keys, write_priors
from calib.data.record import Record
from calib.data.stated_uncertainty import StatedUncertainty
from calib.data.surroundings import (
    Box,
    FurtherRobot,
    GroupDistance,
    Reflector,
    Tracker,
    TrackerNoise,
    check_box_names,
)
from calib.errors import CalibError, FileError, choices
from calib.model.parameter_sets import DIRECTIONS
from calib.numerics.geometry import (
    pose_of,
    rotation_or_none,
    vector,
)
from calib.robot.gravity import GRAVITY, Payload

__all__ = [
    "AUTO",
    "Box",
    "Cell",
    "FurtherRobot",
    "GroupDistance",
    "Priors",
    "Record",
    "Reflector",
    "StatedUncertainty",
    "Tracker",
    "TrackerNoise",
]

#: The value of `Cell.model` that lets the data choose the model.
AUTO = "auto"

#: Allowed values of `Cell.repeats`.
REPEATS = ("weighted", "average", "independent")

#: Standard deviation of an instrument's scale error, a share, by its name in ``Cell.instrument``. A laser tracker's
#: unit of length is that of its laser, and air temperature and pressure leave 20 um/m; a wand or a bar of 0.5 m that is
#: known to 0.25 mm gives the scale of stereo cameras and of motion capture; prints are off by 0.3 %.
SCALE_SIGMAS: Mapping[str, float] = ReadOnlyMapping(
    {"tracker": 2e-5, "stereo": 5e-4, "motion_capture": 5e-4, "print": 3e-3}
)

#: That of an instrument of which nothing is said: prints that nobody measured are off by up to 1 %.
UNKNOWN_SCALE = 1e-2


#: Options of the links of measurement frames, for ``base`` and ``bases``.
_BASE_OPTIONS = link_options(
    (
        "--base",
        "Link in whose frame the chain starts. Default: the URDF's root.",
        "the frame of that station",
    ),
    (
        "--camera-on",
        "Link that the camera is mounted on: the flange, or, for a stationary camera, the URDF's root (default). The "
        "same as --base.",
        "the camera of that station",
    ),
)

#: Options of the links of targets, for ``tip`` and ``tips``.
_TIP_OPTIONS = link_options(
    (
        "--tip",
        "Link that the target is mounted on. Default: the end of the longest chain whose joints all have a column in "
        "the table, before a gripper or hand.",
        "that target",
    ),
    (
        "--board-on",
        "Link that the board is mounted on: the URDF's root if the camera is on the hand. The same as --tip.",
        "that board",
    ),
)


@dataclass(frozen=True, slots=True, eq=False)
class Cell(Value):
    """The measurement setup of a calibration: frames, targets, instrument, priors and surroundings.

    Parameters are named as `calib inspect` prints them. A change is what is added to a parameter's nominal value, in
    its unit: [m], [rad], [rad/Nm], [m/N], or [rad/rad] for a gain.

    Raises:
        CalibError: A value is of the wrong kind or out of range, or two of them contradict.
        MeasurementError: ``kind`` is not registered.
    """

    #: Base link; None: left to the command line or the URDF.
    base: str | None = key(
        "base",
        text("the name of a link"),
        "Link in whose frame the chain starts.",
        default=None,
        absent="the URDF's root",
        option=_BASE_OPTIONS,
    )
    #: Links that measurement frames are mounted on, by station; those of the others is ``base``.
    bases: Mapping[str, str] = key(
        "bases",
        named(text("the name of a link")),
        "Links that measurement frames (trackers, cameras) are mounted on by station (column `group`), if they are not "
        "all on one link.",
        default_factory=ReadOnlyMapping,
        absent="`base` for all",
        option=tuple(
            replace(option, parse=words_by_name, merge=add_entries)
            for option in (*_BASE_OPTIONS, frame_option(0))
        ),
    )
    #: Tip link; None: left to the command line or the URDF.
    tip: str | None = key(
        "tip",
        text("the name of a link"),
        "Link that the target is mounted on.",
        default=None,
        absent="the end of the longest chain whose joints all have a column in the table, before a gripper or hand",
        option=_TIP_OPTIONS,
    )
    #: Links that targets are mounted on, by name; those of the others is ``tip``.
    tips: Mapping[str, str] = key(
        "tips",
        named(text("the name of a link")),
        "Links that targets (reflectors, boards) are mounted on by name (column `target`), if they are not all on one "
        "link.",
        default_factory=ReadOnlyMapping,
        absent="`tip` for all",
        option=tuple(
            replace(option, parse=words_by_name, merge=add_entries) for option in _TIP_OPTIONS
        ),
    )
    #: Robots besides the first one, by name, which begins the names of their links and joints: ``right/tool0``.
    robots: Mapping[str, FurtherRobot] = key(
        "robots",
        named(table_of(FurtherRobot)),
        "Robots besides the first one, see [several chains](several-chains.md).",
        default_factory=ReadOnlyMapping,
        absent="none",
        option=Option(
            "--other-robot",
            metavar="NAME=ROBOT",
            type=list[str],
            help="A further robot of the cell: its URDF, or its name. Names of its links and joints begin with NAME/, "
            "here and in the table. Its base in that of the first robot is estimated.",
            parse=lambda typed, flag: {
                name: FurtherRobot(robot) for name, robot in robots_by_name(typed, flag).items()
            },
            merge=add_entries,
        ),
    )
    #: True if the targets are estimated with the robot. A fit registers them first; ``target`` is then one of several
    #: starts if that is not linear, the nominal robot is evaluated with it, and the estimate is checked against it.
    estimate_target: bool = key(
        "target",
        one_of({"known": False, "estimate": True}),
        "Whether the targets keep their stated positions or are estimated.",
        default=True,
        option=Option(
            "--fix-target",
            group="fit",
            type=bool,
            help="Keep the target where --target says it is.",
            parse=lambda _typed, _flag: False,
        ),
    )
    #: shape (3,), position of the target in the tip [m]; None: not known.
    target: Array | None = key(
        "target_mm",
        POINT_MM,
        "Stated position of the target in the tip, at most 20 m from it. The nominal robot is evaluated with it, and "
        "the estimate is checked against it.",
        default=None,
        absent="registered to the measurements",
        option=Option(
            "--target",
            metavar='"X Y Z UNIT"',
            help='Stated position of the target in the tip, such as "70 -70 22.5 mm". The nominal robot is evaluated '
            "with it, and the estimate is checked against it.",
            parse=parse_point,
        ),
        check=IS_POSITION,
    )
    #: shape (3, 3), R_tip_target, orientation of the targets in the tip; None: not known.
    target_rotation: Array | None = key(
        "target_rpy_deg",
        RPY_DEG,
        "Orientation of the target in the tip, for poses: roll, pitch, yaw as in a URDF.",
        default=None,
        absent="registered to the measurements",
        check=Check("a 3 x 3 right-handed rotation", rotation_or_none),
    )
    #: Positions of targets in the tip by name, shape (3,) each [m]; they override ``target``.
    targets: Mapping[str, Array] = key(
        "targets_mm",
        named(POINT_MM),
        "Positions of targets in the tip by name, see below.",
        default_factory=ReadOnlyMapping,
        each=IS_POSITION,
    )
    #: True if the measurement frames are estimated.
    estimate_frame: bool = key(
        "frame",
        FRAME_ESTIMATED,
        "Whether the measurement frame is known or estimated, or a list of the directions of the base in which it is "
        "estimated.",
        default=False,
        absent='"known"',
        option=frame_option(0),
        of_record=write_frame,
    )
    #: Directions, of `DIRECTIONS` along the axes of the base, that are estimated if frames are.
    frame_directions: tuple[str, ...] = key(
        "frame",
        FRAME_DIRECTIONS,
        "",
        default=DIRECTIONS,
        option=frame_option(1),
        check=ARE_DIRECTIONS,
    )
    #: shape (4, 4), pose of the base in the measurement frame [m]. None: not given; then it is
    #: estimated if ``estimate_frame``, else the measurements are in the base frame itself.
    T_frame_base: Array | None = keys(
        lambda: pose_keys("frame_", "the base in the measurement frame"),
        pose_of,
        default=None,
        check=IS_POSE,
        write=write_pose("frame_"),
    )
    #: Poses T_frame_base by group, shape (4, 4) each [m]; they override ``T_frame_base``.
    frames: Mapping[str, Array] = key(
        "frames",
        named(pose_form("the base in the measurement frame")),
        "Poses of the base in the measurement frame by station (column `group`), see below.",
        default_factory=ReadOnlyMapping,
        each=IS_POSE,
    )
    #: Kind of all measurements, a name of `calib.data.kinds`; None: as the table's columns say.
    kind: str | None = key(
        "kind",
        text("the name of a kind of measurement"),
        "What every row measures, as `--kind` and [data format](data-format.md) list it.",
        default=None,
        absent="as the table's columns say",
        option=Option(
            "--kind",
            metavar="KIND",
            help="What every row measures: {kinds}. Default: as the table's columns say, else point.",
        ),
    )
    #: Standard deviation of one measured scalar by its unit: ``"m"`` of a coordinate or length [m], ``"rad"`` of an
    #: angle [rad], ``"px"`` of an image coordinate [px]; that of a unit that is missing is estimated from the data.
    sigma: Mapping[str, float] = keys(
        sigma_keys,
        dict,
        default_factory=ReadOnlyMapping,
        check=ARE_SIGMAS,
        write=write_sigma,
    )
    #: What measures the target, a name of `SCALE_SIGMAS`: how well its scale is known; None: not said.
    instrument: str | None = key(
        "instrument",
        one_of(tuple(SCALE_SIGMAS)),
        "What measures: it says how well the scale is known, as a standard deviation: tracker 0.002 %, stereo and "
        "motion_capture 0.05 %, print 0.3 %.",
        default=None,
        absent="unknown: 1 %; with a table `tracker` a tracker; boards state their own",
        option=Option(
            "--instrument",
            group="fit",
            type=tuple(SCALE_SIGMAS),
            help="What measures; it says how well the scale is known. Default: unknown, to 1 %.",
        ),
        check=Check(
            f"one of {choices(SCALE_SIGMAS)}",
            lambda value: value if value in SCALE_SIGMAS else None,
        ),
    )
    #: True if the instrument's scale was certified, and is exact unless ``stated_scale_sigma`` says how well.
    scale_certified: bool = key(
        "scale_certified",
        TRUTH,
        "Whether the instrument's scale was certified or checked against a known length. Then it counts as exact, or "
        "as known to `sigma_scale_percent`.",
        default=False,
    )
    #: Standard deviation of the scale error, a share; None: by ``scale_certified`` and ``instrument``.
    stated_scale_sigma: float | None = key(
        "sigma_scale_percent",
        decimal("%", -2, least=0.0),
        "Standard deviation of the instrument's scale error [%].",
        default=None,
        absent="by `scale_certified` and `instrument`",
        check=Check("0 or more", lambda value: value if value >= 0.0 else None),
    )
    #: True if a known measurement frame was aligned with the base: if the base seems to have moved, the arm is off.
    frame_aligned: bool = key(
        "frame_aligned",
        TRUTH,
        "Whether a known measurement frame was aligned with the base by measuring its mounting.",
        default=False,
    )
    #: Weighting of repeated poses: ``"weighted"``, ``"average"`` or ``"independent"``.
    repeats: str = key(
        "repeats",
        one_of(REPEATS),
        "Weighting of repeated poses: by the estimated correlation of their errors (weighted, the default), as one row "
        "(average), or as rows of different poses (independent).",
        default="weighted",
        option=Option("--repeats", group="fit", type=REPEATS),
        check=Check(
            f"one of {choices(REPEATS)}", lambda value: value if value in REPEATS else None
        ),
    )
    #: Errors of the robot that are estimated: ``"auto"``, as many as the measurements support, or a parameter set such
    #: as ``"dh"``, with families of errors appended, ``"dh+gain+compliance"``.
    model: str = key(
        "model",
        text("the name of a model"),
        "Errors of the robot to estimate: a parameter set with families of errors appended by `+`, see "
        "[parameters](parameters.md), or `auto`: as many as the data support.",
        default=AUTO,
        option=Option(
            "--model",
            group="model",
            metavar="SET[+FAMILY...]",
            help="Errors of the robot to estimate. auto (the default of a fit): as many as the data support. dh: a, "
            "alpha, d, theta of each DH row. paper: the same with a known frame. hayati: beta instead of d between "
            "near-parallel axes. placement: all six errors of each joint. zeros: the joint zeros. frames: no error of "
            "the robot. Sets: {models}. Append families of errors with +: {families} (dh+gain).",
        ),
    )
    #: Names of parameters, joints and links that stay at their nominal values, see `calib.model.frozen`.
    frozen: tuple[str, ...] = key(
        "freeze",
        NAMES,
        "What is kept at its nominal value: parameters, all errors of a joint by its name, or the shape of a link.",
        default=(),
        absent="none",
        option=Option(
            "--freeze",
            group="fit",
            metavar="NAME",
            type=list[str],
            help="Keep a parameter, a joint or a link at its nominal value.",
            merge=add_entries,
        ),
    )
    #: Parameters that follow others, ``x_name = factor * x_other``: (other, factor) by name.
    ties: Mapping[str, tuple[str, float]] = key(
        "ties",
        named(TIE),
        "Parameters that follow others, see below.",
        default_factory=ReadOnlyMapping,
        each=IS_TIE,
    )
    #: The least and the largest change of parameters by name; 0 is between them.
    bounds: Mapping[str, tuple[float, float]] = key(
        "bounds",
        named(BOUNDS, write_bounds),
        "Limits of the changes of parameters, see below.",
        default_factory=ReadOnlyMapping,
        each=ARE_BOUNDS,
    )
    #: Prior standard deviations of the robot's errors, by family.
    priors: Priors = keys(prior_keys, Priors, default_factory=Priors, write=write_priors)
    #: Prior standard deviations of the changes of single parameters, by name; they override ``priors``.
    parameter_priors: Mapping[str, float] = key(
        "parameter_priors",
        named(CHANGE, write_change),
        "Prior standard deviations of single parameters, see below.",
        default_factory=ReadOnlyMapping,
        each=IS_PRIOR_STD,
    )
    #: Mass that the tip carries; None: none.
    payload: Payload | None = key(
        "payload",
        table_of(Payload),
        "What the tip carries, for compliances, see below.",
        default=None,
        option=Option(
            "--payload",
            group="model",
            metavar='"MASS UNIT"',
            help='Mass that the tip carries, such as "5 kg", for compliances. Its centre of mass is given in the cell '
            "file.",
            parse=lambda typed, flag: parse_amount(typed, flag, MASS, "5 kg"),
            merge=lambda payload, mass: replace(payload or Payload(mass), mass=mass),
        ),
    )
    #: shape (3,), acceleration of gravity in the URDF's root frame [m/s^2].
    gravity: Array = key(
        "gravity_m_per_s2",
        three_numbers("m/s^2"),
        "Acceleration of gravity in the frame of the URDF's root; change it for an arm on a wall or ceiling.",
        default_factory=lambda: read_only(GRAVITY),
        absent="0, 0, -9.81",
        check=Check("three numbers [m/s^2]", lambda value: vector(value, "gravity")),
    )
    #: Values of joints that have no column in the table, by name [rad] or [m].
    held: Mapping[str, float] = key(
        "held",
        named(JOINT_VALUE),
        "Values of joints that do not move and have no column in the table, see below.",
        default_factory=ReadOnlyMapping,
        option=Option(
            "--hold",
            metavar='"JOINT=VALUE UNIT"',
            type=list[str],
            help='Value of a joint that does not move, such as "lift=0.3 m"; it needs no column in the table.',
            parse=parse_joint_values,
            merge=add_entries,
        ),
        each=IS_JOINT_VALUE,
    )
    #: Of joints whose readings are coupled, by name, the factors of other joints' readings: the joint's value is its
    #: reading plus the sum of factor times reading; [rad/rad], [m/m], or [m/rad] and [rad/m] between turn and slide.
    coupling: Mapping[str, Mapping[str, float]] = key(
        "coupling",
        named(FACTORS),
        "Joints whose readings are coupled to those of others, see below.",
        default_factory=ReadOnlyMapping,
        each=ARE_FACTORS,
    )
    #: What targets that stand still are mounted on, by their names: ``"world"`` or ``"base"``.
    references: Mapping[str, str] = key(
        "references",
        named(one_of(("world", "base"))),
        "What targets that stand still (rows of the set `reference`) are mounted on, see below.",
        default_factory=ReadOnlyMapping,
        absent="not known: what they show is a movement of the frame",
    )
    #: Known distances between the fixed points of groups.
    distances: tuple[GroupDistance, ...] = key(
        "distances",
        tables_of(GroupDistance, "distances"),
        "Known distances between sockets, see below.",
        default=(),
        absent="none",
    )
    #: Position, range and noise of the instrument; None: not known.
    tracker: Tracker | None = key(
        "tracker",
        table_of(Tracker),
        "Position, range and noise of the tracker, see below.",
        default=None,
        option=Option(
            "--tracker",
            group="tracker",
            metavar='"X Y Z UNIT"',
            help='Position of the tracker in the base frame, such as "2500 0 500 mm".',
            parse=lambda typed, flag: parse_point(typed, flag, "2500 0 500 mm"),
            merge=lambda tracker, position: replace(
                tracker or Tracker(position), position=position
            ),
        ),
    )
    #: Direction and opening of the reflector; None: it is turned by hand, and seen from everywhere.
    reflector: Reflector | None = key(
        "reflector",
        table_of(Reflector),
        "Direction and acceptance angle of the reflector, see below.",
        default=None,
        absent="visible from everywhere",
    )
    #: Obstacles to the robot and to the tracker's beam, for poses that are planned.
    boxes: tuple[Box, ...] = key(
        "boxes",
        tables_of(Box, "boxes"),
        "Obstacles to the robot and to the tracker's beam, see below.",
        default=(),
        absent="none",
    )
    #: The least and the largest value of the URDF's joints by name, within which poses are planned [rad] or [m].
    ranges: Mapping[str, tuple[float, float]] = key(
        "ranges",
        named(JOINT_RANGE),
        "Ranges of the URDF's joints for planned poses, see below.",
        default_factory=ReadOnlyMapping,
        absent="the URDF's limits",
        each=IS_RANGE,
    )
    #: Cameras by the name of their station; ``""`` is that of a table without stations.
    cameras: Mapping[str, Camera] = keys(
        camera_keys,
        by_name,
        default_factory=ReadOnlyMapping,
        write=write_described("camera", camera_toml),
    )
    #: Printed boards by the name of their target; ``""`` is that of a table without targets.
    boards: Mapping[str, Board] = keys(
        board_keys,
        by_name,
        default_factory=ReadOnlyMapping,
        write=write_described("board", board_toml),
    )
    #: Who measured what for whom, where, when and with what; for reports.
    record: Record = key(
        "record",
        table_of(Record),
        "Who measured what, where, when and with what, for [reports](report.md) and result files, see below.",
        default_factory=Record,
    )
    #: What is stated of uncertainty, by certificates and by experience; for the budget.
    uncertainty: StatedUncertainty = key(
        "uncertainty",
        table_of(StatedUncertainty),
        "What certificates and experience say of instrument, arm and setup, for the "
        "[uncertainty budget](uncertainty.md), see below.",
        default_factory=StatedUncertainty,
        absent="nothing is stated",
    )

    def __post_init__(self) -> None:
        """Check each value, and that they agree (see the class for what is raised); keep read-only copies."""
        keep_checked(self, "cell")
        if self.kind is not None:
            registry.get(self.kind)
        check_box_names(self.boxes)
        is_given = self.target is not None or self.targets
        if not is_given and not self.estimate_target:
            raise CalibError(
                "The target is marked as known, but its position is not given; give it (--target, "
                "target_mm) or let it be estimated."
            )
        constrained = {*self.frozen, *self.bounds, *self.parameter_priors}
        for name, (other, _) in self.ties.items():
            if other in self.ties or name in constrained:
                raise CalibError(
                    f"'{name}' is tied to '{other}': it must not be frozen, have bounds or a "
                    f"prior as well, nor '{other}' be tied itself."
                )

    @property
    def scale_sigma(self) -> float:
        """Standard deviation of the instrument's scale error, a share, as stated or by its name; 0 is exact."""
        if self.stated_scale_sigma is not None:
            return self.stated_scale_sigma
        if self.scale_certified:
            return 0.0
        if self.instrument is not None:
            return SCALE_SIGMAS[self.instrument]
        if self.boards:
            return max(board.sigma_scale for board in self.boards.values())
        return UNKNOWN_SCALE if self.tracker is None else SCALE_SIGMAS["tracker"]

    def __repr__(self) -> str:
        """Return one line: the model, and the names of the other attributes that are not the default ones."""
        given = []
        for attribute in fields(self):
            value = getattr(self, attribute.name)
            default: Any = attribute.default
            if attribute.default_factory is not MISSING:
                default = attribute.default_factory()
            if attribute.name != "model" and not np.array_equal(value, default):
                given.append(attribute.name)
        return one_line(
            "Cell", f"model '{self.model}'", f"given: {', '.join(given)}" if given else ""
        )

    @classmethod
    def read(cls, path: str | Path) -> Cell:
        """Read a cell from a TOML file, see docs/cell.md.

        Args:
            path: The file.

        Returns:
            The cell; what the file does not give has its default.

        Raises:
            FileError: The file cannot be read or is not TOML.
            CalibError: It has an unknown key, or a value of the wrong kind.
        """
        check_path("path", path)
        folder = Path(path).parent
        table = read_toml(path)
        try:
            for name in NAMES.read(table.get("plugins", []), Place("'plugins'")):
                plugins.load(folder / name if name.endswith(".py") else name)
            return cls(**read_values(cls, table, Place(folder=folder), FILE_KEYS))
        except CalibError as error:
            kind = FileError if isinstance(error, FileError) else CalibError
            raise kind(f"{path}: {error}") from error

    def to_toml(self, sliding: Collection[str] = ()) -> str:
        """Return the cell as the text of a cell file, from which `read` makes the same cell.

        It has what differs from the default cell; files that parts of the cell were read from are not named.

        Args:
            sliding: Names of the joints that slide: their values are written in [m], those of the others in [rad].
        """

        def typed(name: str, value: float) -> float:
            """Return the value of a joint, which a cell may have without its unit, with it."""
            return Length(value) if name in sliding else Angle(value)

        held = {name: typed(name, value) for name, value in self.held.items()}
        ranges = {
            name: (typed(name, low), typed(name, high)) for name, (low, high) in self.ranges.items()
        }
        return toml_text(given_values(replace(self, held=held, ranges=ranges)))

    def with_target(self, target: ArrayLike, *, estimate: bool = True) -> Cell:
        """Return the cell with another target.

        Args:
            target: Position of the target in the tip, shape (3,) [m].
            estimate: Whether the target is estimated, starting there; False: it is known.

        Returns:
            The cell.
        """
        return replace(self, target=read_only(np.asarray(target)), estimate_target=estimate)


#: Keys of a cell file that are not attributes of a cell.
FILE_KEYS = (
    Key(
        "plugins",
        NAMES,
        "[Plugins](extending.md#plugins), files or modules, to load before the other keys are read. Paths are relative "
        "to the cell file. (`--plugin`)",
        "none",
    ),
    Key("simulation", TABLE, "Rare disturbances of a [virtual cell](simulation.md).", "none"),
)


def read_toml(path: str | Path) -> dict[str, Any]:
    """Read a TOML file as nested tables, without a check of its keys.

    Args:
        path: The file, in UTF-8.

    Raises:
        FileError: The file cannot be read or is not TOML.
    """
    data = read_bytes(path, "cell file")
    try:
        return parse_toml(data.decode("utf-8-sig"))
    except ValueError as error:
        raise FileError(f"{path}: this is not a TOML file: {error}") from error
