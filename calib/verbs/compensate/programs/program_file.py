"""A robot program as calib sees it: texts, the numbers of its targets in them, and the motions that go there in order.

A dialect (`calib.verbs.compensate.programs.dialects`) makes a `ProgramFile` of a program's files; `corrected` of
`calib.verbs.compensate.programs.correction` replaces the numbers of its targets, whatever the dialect. What a dialect
reads but cannot be corrected, it names as `Left`: no line of motion is passed over in silence.

With the tool frame of a motion and the frame of its target, both as the program states them, a cartesian target is

    T_base_tip = T_base_frame T_frame_tool inv(T_tip_tool)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeAlias

from calib.basics.arrays import Array, Mask
from calib.basics.values import Value
from calib.data.forms.orientations import Convention
from calib.robot.robot import Robot

LeftCode = Literal[
    "relative",
    "computed",
    "partial",
    "shared",
    "configuration",
    "external axes",
    "external tool",
    "other file",
    "not a motion",
    "group",
    "spline",
    "conveyor",
    "search",
    "force",
    "unread",
    "unused",
]
"""Why numbers of a program stay as they are; docs/programs.md says what to do about each:

relative        a motion by an offset from where the robot is, or from another target
computed        the target is made, or changed, by the program as it runs
partial         some of the target's numbers are left out, and stay those of the motion before
shared          motions with other tools, frames or approaches go to the same target, and need other numbers
configuration   no joint values of the nominal robot at the target agree with its configuration data, or the corrected
                ones do not
external axes   a track or positioner that is not in the URDF takes part in the motion
external tool   the tool stands still, and the robot carries the part
other file      the target's numbers stand in a file that was not given
not a motion    the numbers are no target of the robot: of a pallet, a frame, a weave
group           another motion group than the first
spline          a motion whose shape depends on more than its targets
conveyor        the frame moves
search          the motion ends at a sensor's signal
force           the motion is led by a force
unread          the line moves the robot, and calib does not know how
unused          no motion of the program goes to the target, so that its tool and frame are not known
"""

Motion = Literal["joint", "linear", "circular"]
"""How a motion goes to its target: by joints, on a straight line, or on an arc (through the first of two targets)."""

#: By joint values of the nominal robot in the order of ``Robot.joint_names``, shape (K, m) [rad] or [m], those that a
#: target's configuration data allow, shape (K,).
Configuration: TypeAlias = Callable[[Array], Mask]


@dataclass(frozen=True, slots=True)
class ProgramText:
    """A file of a program: its path, and its bytes, each as the character of that number (Latin-1)."""

    path: Path
    text: str

    def line_at(self, position: int) -> int:
        """Return the line, from 1, of a character, counted from 0."""
        return self.text.count("\n", 0, position) + 1


def readable(text: str) -> str:
    """Return a piece of a text, its bytes as Latin-1, as messages show it: as UTF-8, if it is."""
    try:
        return text.encode("latin-1").decode("utf-8")
    except UnicodeDecodeError:
        return text


@dataclass(frozen=True, slots=True)
class NumberText:
    """A number as it stands in the text of a file, with its sign: characters ``start`` to ``end``, the end excluded."""

    start: int
    end: int
    #: The number, in the unit of the file.
    value: float
    #: Decimals that the dialect's controller reads; None: any number of them.
    most_decimals: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Target(Value):
    """The numbers of one position in a program: joint values, or a pose of the tool in a frame."""

    #: As messages name it: ``"XP3"``, ``"P[4]"``, or ``""`` of one that has no name.
    name: str
    #: Index of its file in `ProgramFile.texts`.
    file: int
    #: Line of its first number, from 1.
    line: int
    #: Its numbers: of a pose x, y, z and the numbers of the orientation in the order of ``convention``; else one for
    #: each joint, in the order of ``Robot.joint_names``.
    numbers: tuple[NumberText, ...]
    #: SI units in one unit of the file, of each number [m] or [rad] or 1: ``1e-3`` of millimetres.
    scales: tuple[float, ...]
    #: Convention of the orientation; None: joint values.
    convention: Convention | None = None
    #: The joint values that the target's configuration data allow; None: it has none that count.
    configuration: Configuration | None = None
    #: Numbers of the configuration data that change with the joint values (such as KUKA's turn), each with the function
    #: from joint values, shape (m,) [rad] or [m], to the number; the maker calls both one position.
    dependent: tuple[tuple[NumberText, Callable[[Array], int]], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Move(Value):
    """A motion of the program to a target."""

    #: Index of the target in `ProgramFile.targets`.
    target: int
    #: File and line of the motion, the line from 1.
    file: int
    line: int
    motion: Motion
    #: shape (4, 4), the tool in the tip, the controller's flange [m]; None for joint values whose tool is not known.
    T_tip_tool: Array | None
    #: shape (4, 4), the frame of a pose in the base [m]; None for joint values.
    T_base_frame: Array | None = None


@dataclass(frozen=True, slots=True)
class Left:
    """A line of a program whose numbers stay as they are, and why."""

    file: int
    line: int
    code: LeftCode
    #: What stands there, such as ``"LIN_REL"`` or the name of a target.
    what: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class ProgramFile(Value):
    """A program: its texts, targets, motions in the order in which they run, and what is left as it is."""

    #: The program itself, then the files that came with it and hold targets of it.
    texts: tuple[ProgramText, ...]
    targets: tuple[Target, ...]
    moves: tuple[Move, ...]
    left: tuple[Left, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Stated(Value):
    """Tools, frames and files that options state, because the program does not."""

    #: Names of the joints, in the order of the controller's axes.
    joint_names: tuple[str, ...]
    #: T_tip_tool, shape (4, 4) [m], by the tool's name or number in the program; ``""`` of all that the program does
    #: not define.
    tools: Mapping[str, Array] = field(default_factory=dict)
    #: T_base_frame, shape (4, 4) [m], by the frame's name or number in the program; ``""`` as for tools.
    frames: Mapping[str, Array] = field(default_factory=dict)
    #: Further files that define tools, frames and targets.
    data: tuple[Path, ...] = ()
    #: Pulses in one SI unit (rad or m) of each joint, in the order of ``joint_names``; empty: not stated.
    pulses: tuple[float, ...] = ()
    #: The nominal robot, by whose geometry configuration data tell front from back and up from down; None: they do not.
    robot: Robot | None = None
