"""What to look at before commands go to a robot: rows without one, warnings, a program that does not fit together."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.cli.terminal import row_ranges
from calib.model.robot import rigid_inverse
from calib.units import split_header

if TYPE_CHECKING:
    from calib.cli.compensate_setup import Robots
    from calib.compensate.commands import Commands
    from calib.compensate.program import Program
    from calib.model.robot import Robot

_RPY = ("roll", "pitch", "yaw")

#: Names of orientations on controllers, in small letters; whose they are, and what calib calls each.
_MEANT = (
    (("a", "b", "c"), "KUKA", ("yaw", "pitch", "roll")),
    (("w", "p", "r"), "FANUC", _RPY),
    (("q1", "q2", "q3", "q4"), "ABB", ("qw", "qx", "qy", "qz")),
    (("q0", "q1", "q2", "q3"), "a quaternion that begins with w", ("qw", "qx", "qy", "qz")),
    (("o", "a", "t"), "Kawasaki", ()),
    (("alpha", "beta", "gamma"), "", ()),
    (("phi", "theta", "psi"), "", ()),
)


_CONVERT = (
    "If they are one, convert them to quaternions, qx, qy, qz, qw, or to roll, pitch and yaw: "
    "docs/compensation.md."
)

#: One metre and one radian in the units that are printed.
MM, DEG = 1e3, float(np.degrees(1.0))

_WIDTH = 100

#: Rows that are named behind a warning, and columns at most.
_NAMED, _COLUMNS = 8, 12

#: Joint values of a program further from its poses than this ask for a second look [m]: no calibration moves a tool so.
_ELSEWHERE = 0.02

#: Rows that a message names with their reasons, one by one.
_MOST_NAMED = 50

#: Hardly anything, on an arm: position [m], angle [deg].
_HARDLY = (1e-4, 0.2)

#: The link of a URDF that is the controller's frame, where there is one, and what is no other place [mm], [deg].
_CONTROLLER, _STANDS = "base", (1e-3, 1e-3)

#: What a warning is of: its words up to the first number, name or colon.
_KIND = re.compile(r"[^\d':]*")


def no_commands(found: Commands, *, skip: bool) -> str:
    """The message that names each row without a command and why it has none.

    Args:
        found: The commands.
        skip: Whether such rows may stay empty: then no row has a command.
    """
    rows = _named(found, found.reasons)
    count, every = len(rows), len(found)
    whole = "the row has no command" if every == 1 else f"none of the {every} rows has a command"
    head = (
        whole
        if count == every
        else f"{count} of {every} rows {'has' if count == 1 else 'have'} no command"
    )
    more = count - _MOST_NAMED
    if more > 0:
        labels = [
            label for label, why in zip(found.program.labels, found.reasons, strict=True) if why
        ]
        rows = [*rows[:_MOST_NAMED], fill(f"and rows {_listed(labels[_MOST_NAMED:], more)}", "  ")]
    advice = [_elsewhere(found), _small(found), _few_joints(found)]
    if count == every and not any(advice):
        advice.append("Check --poses-in, --tool, --match, and the units.")
    if not skip and count < every:
        advice.append("--skip leaves these rows empty and writes the others.")
    said = " ".join(one for one in advice if one) or "Correct the program."
    return "\n".join([f"{head}, and nothing was written:", *rows, fill(said)])


def _small(found: Commands) -> str:
    """How to accept rows of which hardly anything is left, as next to a singularity."""
    length, angle = _HARDLY
    missing = ~found.reached & np.isfinite(found.left[:, 0])
    hardly = missing & (found.left[:, 0] <= length) & ~(found.left[:, 1] > np.radians(angle))
    # Rows that end at a joint's limit may be off by nothing: what is left of them does not matter.
    hardly &= found.left[:, 0] > 1e-9
    if not hardly.any():
        return ""
    words = f"{MM * length:g} mm {angle:g} deg"
    return (
        f"Of {counted(int(hardly.sum()), 'row')} less than {words.replace('mm ', 'mm and ')} would be left: --accept "
        f'"{words}" takes {"it" if hardly.sum() == 1 else "them"}.'
    )


def _few_joints(found: Commands) -> str:
    """What an arm of fewer than six joints can do."""
    joints = len(found.nominal.joint_names)
    if joints >= 6 or found.match not in ("pose", "axis"):
        return ""
    return f"With {joints} joints most poses cannot be reached exactly: --match weighted, or --match position."


def notes(
    found: Commands, robots: Robots, *, larger: bool, of_target: bool, poses: bool, in_base: bool
) -> list[str]:
    """What to look at before the commands go to the robot.

    Args:
        found: The commands.
        robots: What they were made with.
        larger: Whether the larger model of the result was used.
        of_target: Whether the tool is the calibrated target.
        poses: Whether poses are sent.
        in_base: Whether poses are given in the base.
    """
    notes = [
        unread_orientation(found.program),
        _elsewhere(found),
        _orientation_unsure(found, of_target=of_target),
    ]
    estimated = robots.result is not None and robots.result.frame_estimated
    if in_base and estimated and np.isfinite(found.std[found.reached, 0]).any():
        unsure = MM * float(found.std[found.reached, 0].mean())
        notes.append(
            "The frame of the measurements was estimated with the robot: where the base stands in it follows from the "
            f"robot alone, so that places in the base are known to {unsure:.2f} mm (standard deviation). Places in the "
            "frame that was measured in are known better: --poses-in measured."
        )
    if robots.was_corrected:
        notes.append(
            "ROBOT has the corrected joint origins already; what the controller has was taken from the result."
        )
    if of_target and robots.result is not None:
        notes.append(_believed(found, poses=poses))
    if in_base and (poses or found.program.T_wanted is not None):
        notes.append(_another_base(found.nominal, fitted=robots.result is not None))
    if poses and not in_base:
        notes.append(
            "The poses to send are in the frame that was measured in: set the controller's work object to "
            f"{place(rigid_inverse(found.T_frame_base))} in '{found.nominal.base}'."
        )
    empty = _named(found, found.reasons)
    if empty:
        what = "row has" if len(empty) == 1 else f"of {len(found)} rows have"
        empty[:0] = [
            f"{len(empty)} {what} no command, and {'is' if len(empty) == 1 else 'are'} empty in the table:"
        ]
    lists = ["\n".join(empty), _warnings(found, larger=larger)]
    return [*(fill(note) for note in notes if note), *(one for one in lists if one)]


def _believed(found: Commands, *, poses: bool) -> str:
    """Where the controller is to have the target, and what the wanted poses were computed with.

    Args:
        found: The commands.
        poses: Whether poses are sent.
    """
    where = f"{place(found.T_tip_tool_nominal)} in '{found.nominal.tip}'"
    same = np.array_equal(found.T_tip_tool, found.T_tip_tool_nominal)
    why = (
        "It is where the calibration found the target, whose place was not stated before"
        if same
        else "It is where the target was stated to be before the calibration, which found it elsewhere"
    )
    if poses:
        text = f"The poses to send are those of a tool at {where}: set the controller's tool to that. {why}."
        if found.program.T_wanted is None:
            text += " The poses wanted were computed from the joint values with the same tool."
        return text
    if found.program.T_wanted is not None:
        return ""
    return f"The poses wanted were computed from the joint values with a tool at {where}. {why}."


def _another_base(robot: Robot, *, fitted: bool) -> str:
    """The link that is named as the controller's frame is, where poses are in one that stands otherwise.

    URDFs with such a link mean the frame that the controller counts in: Universal Robots, and ROS-Industrial.

    Args:
        robot: The robot as its controller has it.
        fitted: Whether the base is that of a fit, and no option here changes it.
    """
    if robot.base == _CONTROLLER or _CONTROLLER not in robot.urdf.links:
        return ""
    other = robot.rebuilt(base=_CONTROLLER, tip=robot.tip)
    if other.joint_names != robot.joint_names:
        return ""
    q = np.zeros(len(robot.joint_names))
    T = robot.poses(q)[0] @ rigid_inverse(other.poses(q)[0])
    turned = DEG * float(Rotation.from_matrix(T[:3, :3]).magnitude())
    moved = MM * float(np.linalg.norm(T[:3, 3]))
    ways = [f"turned by {turned:.3g} deg"] * (turned > _STANDS[1])
    ways += [f"moved by {moved:.3g} mm"] * (moved > _STANDS[0])
    if not ways:
        return ""
    first = "Fit with" if fitted else "Give"
    return (
        f"The robot also has a link '{_CONTROLLER}', {' and '.join(ways)} against '{robot.base}'. On Universal Robots, "
        "and where a URDF of ROS-Industrial has it, that is the frame of the controller's poses. "
        f"{first} --base {_CONTROLLER} where it is."
    )


def place(T: NDArray[np.float64]) -> str:
    """A pose in words; its rotation vector where it is turned."""
    turn = DEG * Rotation.from_matrix(T[:3, :3]).as_rotvec()
    place = ", ".join(f"{MM * v:.4f}" for v in T[:3, 3])
    turned = f", rotation vector ({', '.join(f'{v + 0.0:.4f}' for v in turn)}) deg"
    return f"({place}) mm{turned if np.abs(turn).max() > 1e-9 else ''}"


def _named(found: Commands, words: Iterable[str]) -> list[str]:
    """The rows of which something is said, and what."""
    return [
        fill(f"{label}: {what}", "  ")
        for label, what in zip(found.program.labels, words, strict=True)
        if what
    ]


def _elsewhere(found: Commands) -> str:
    """A program whose joint values do not belong to its poses: mostly another tool, or another frame."""
    program = found.program
    if program.q is None or program.T_wanted is None:
        return ""
    poses = found.T_frame_base @ found.nominal.poses(program.q) @ found.T_tip_tool_nominal
    far = np.linalg.norm(poses[:, :3, 3] - program.T_wanted[:, :3, 3], axis=1)
    if np.median(far) < _ELSEWHERE:
        return ""
    return (
        f"At the program's joint values the nominal robot has the tool {MM * float(np.median(far)):.0f} mm from the "
        "program's positions (median). Are these of another tool (--tool), in another frame (--poses-in), or measured "
        "ones (--given joints)?"
    )


def _orientation_unsure(found: Commands, *, of_target: bool) -> str:
    """What is known of the orientation where positions alone were measured."""
    rows = found.reached
    if (
        found.result is None
        or found.result.setup.rotation
        or found.match == "position"
        or not np.isfinite(found.std).any()
    ):
        return ""
    unsure, moved = DEG * found.std[rows, 1].mean(), DEG * found.pose_corrections[rows, 1].mean()
    best = (
        "--match position corrects the position alone, and leaves the orientation near the nominal robot's."
        if of_target
        else "The calibrated target is known best: --tool target; or --match position."
    )
    return (
        f"Positions alone were measured for the result: how the tip is turned follows from them to {unsure:.2f} deg "
        f"(standard deviation), and the corrections turn it by {moved:.2f} deg on average. {best}"
    )


def _warnings(found: Commands, *, larger: bool) -> str:
    """The warnings of all rows, one line for each kind of them, the first of its rows as the example."""
    kinds: dict[str, list[tuple[str, str]]] = {}
    for label, said in zip(found.program.labels, found.warnings, strict=True):
        for what in said:
            kinds.setdefault(_KIND.match(what)[0], []).append((label, what))  # type: ignore[index]  # it always does
    if not kinds:
        return ""
    count = sum(bool(said) for said in found.warnings)
    who = f"{count} of {len(found)} rows {'has' if count == 1 else 'have'}"
    lines = [f"{'The row has' if len(found) == 1 else who} a warning:"]
    for rows in kinds.values():
        (label, what), others = rows[0], [other for other, _ in rows[1:]]
        more = (
            f"; and {counted(len(others), 'row')} more: {_listed(others, _NAMED)}" if others else ""
        )
        lines.append(fill(f"{label}: {what}{more}", "  "))
    if any(kind.startswith("outside") for kind in kinds):
        text = "The result was not tested outside of the measured range."
        if larger:
            text += (
                " Errors that grow with a joint's value or load, as those of the larger model in use, can be far off "
                "there: measure there too, or compare with --geometry."
            )
        lines.append(fill(text))
    return "\n".join(lines)


def _listed(labels: list[str], most: int) -> str:
    """Some rows by their names, at most so many of them or runs of them, and how many more."""
    names = [label.removeprefix("row ") for label in labels]
    if all(name.isdecimal() for name in names):
        return row_ranges(map(int, names), most)
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


def counted(number: int, what: str) -> str:
    """Such as ``1 row``, ``35 rows``."""
    return f"{number} {what}{'' if number == 1 else 's'}"


def fill(sentence: str, indent: str = "") -> str:
    """Broken at 100 columns, names left whole."""
    return textwrap.fill(
        sentence,
        _WIDTH,
        initial_indent=indent,
        subsequent_indent=indent + ("  " if indent else ""),
        break_on_hyphens=False,
        break_long_words=False,
    )


def passed_through(program: Program) -> str:
    """The columns that go into the commands unread; nothing where there are none."""
    labels = [label for label, _ in program.kept if label]
    if not labels:
        return ""
    more = f" and {len(labels) - _COLUMNS} more" if len(labels) > _COLUMNS else ""
    return f"Passed through unread: {', '.join(labels[:_COLUMNS])}{more}."


def unread_orientation(program: Program) -> str:
    """What to do about columns that look like an orientation, where positions alone were read."""
    if program.T_wanted is None or program.oriented:
        return ""
    named = {}
    for label, _ in program.kept:
        name, _ = split_header(label)
        named[name.casefold()] = name
    for names, whose, meaning in _MEANT:
        if not all(name in named for name in names):
            continue
        there = [named[name] for name in names]
        return (
            f"The columns {', '.join(there)} look like an orientation and were not read: positions alone are matched, "
            "and beside the new orientation in the table the old one is wrong. "
            + (_mapping(there, whose, meaning) if meaning else _CONVERT)
        )
    return ""


def _mapping(there: list[str], whose: str, meaning: tuple[str, ...]) -> str:
    """The options that read them."""
    unit = "" if "qw" in meaning else " [deg]"
    options = " ".join(
        f'--columns "{column}={name}{unit}"' for column, name in zip(there, meaning, strict=True)
    )
    return f"If they are one ({whose}): {options}. Otherwise they mean nothing here."
