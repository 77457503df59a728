"""What ``calib compensate`` prints: what to expect of the commands, how large the corrections are, what to look at."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.robot.robot import rigid_inverse
from calib.text.lines import fill, row_ranges
from calib.units import split_header

if TYPE_CHECKING:
    from calib.compensation.commands import Commands
    from calib.compensation.program import Program
    from calib.result.calibration import Calibration
    from calib.robot.robot import Robot

Array = NDArray[np.float64]

#: The words for the tool that is the calibrated target, for poses in the robot's base, and for poses in the frame that
#: the points were measured in, where there is one.
TARGET, BASE, MEASURED = "target", "base", "measured"

#: One metre and one radian in the units that are printed.
MM, DEG = 1e3, float(np.degrees(1.0))

#: What a controller misses by above this, sent as a pose and not as joint values, is worth a line [m], [rad].
_WORTH = 1e-7

#: Rows and joints of the table of corrections; and corrections that differ by less are the same [deg or mm].
_ROWS, _JOINTS, _TIE = 5, 7, 1e-6

#: Columns and rows that are named at most, and rows with a reason each.
_COLUMNS, _NAMED, _REASONS = 12, 8, 50

#: Joint values of a program further from its poses than this ask for a second look [m]: no calibration moves a tool so.
_ELSEWHERE = 0.02

#: The link of a URDF that is the controller's frame, where there is one.
_CONTROLLER = "base"

#: Names of orientations on controllers, in small letters; whose they are, and what calib calls each.
_MEANT = (
    (("a", "b", "c"), "KUKA", ("yaw", "pitch", "roll")),
    (("w", "p", "r"), "FANUC", ("roll", "pitch", "yaw")),
    (("q1", "q2", "q3", "q4"), "ABB", ("qw", "qx", "qy", "qz")),
    (("q0", "q1", "q2", "q3"), "a quaternion that begins with w", ("qw", "qx", "qy", "qz")),
    (("o", "a", "t"), "Kawasaki", ()),
    (("alpha", "beta", "gamma"), "", ()),
    (("phi", "theta", "psi"), "", ()),
)

_MATCHED = {
    "pose": "position and orientation",
    "position": "position; the orientation is left free",
    "axis": "position and direction of the tool's z axis",
    "weighted": "position and orientation, as well as they can be",
}

_SENT = {
    "joints": "Send the joint values.",
    "poses": "Send the poses to the controller that keeps its own model.",
    "both": "Send the joint values, or the poses to the controller that keeps its own model.",
}


class Robots(NamedTuple):
    """The robot as its controller has it, and what is known of the actual one: a result, or a corrected robot.

    ``was_corrected``: ROBOT has the result's joint origins already.
    """

    nominal: Robot
    actual: Calibration | Robot
    result: Calibration | None
    name: str
    was_corrected: bool = False


def text(
    found: Commands,
    robots: Robots,
    tool: str | None,
    poses_in: str,
    send: str,
    written: Path | None,
    *,
    larger: bool,
) -> str:
    """All of it.

    ``tool``, ``poses_in`` and ``send`` are what was given; ``written`` is where to, None where nothing was; ``larger``:
    whether the larger model of the result was used.
    """
    of_target = tool is not None and tool.startswith(TARGET)
    poses = send != "joints"
    notes = _notes(found, robots, of_target=of_target, poses=poses, in_base=poses_in == BASE)
    rows = _reasons(found)
    after = "Nothing was written; -o commands.csv writes the commands."
    if written is not None:
        more = " Do not send corrected poses to a controller that was given the corrected model."
        after = f"Written: {written}\n" + fill(
            f"{_SENT[send]}{more * poses} Then measure some rows and see what was gained: docs/compensation.md."
        )
    parts = [
        _expected(robots, of_target=of_target, larger=larger),
        _asked(found, tool, poses_in),
        _errors(found, poses=poses),
        *_corrections(found),
        *map(fill, filter(None, notes)),
        "\n".join(
            [f"{_have(found, len(rows))} no command; the table has empty cells:", *rows]
            * bool(rows)
        ),
        _warnings(found, larger=larger),
        after,
    ]
    return "\n\n".join(part for part in parts if part)


def no_commands(found: Commands, *, skip: bool) -> str:
    """The message that names each row without a command and why it has none; with ``skip`` no row has one."""
    rows = _reasons(found)
    count = len(rows)
    if count > _REASONS:
        labels = np.array(found.program.labels)[~found.reached].tolist()
        rows = [*rows[:_REASONS], f"  and rows {_listed(labels[_REASONS:], count)}"]
    advice = _elsewhere(found) or (
        "Check --tool, --poses-in and the units; --accept takes rows of which little is left, --match position or "
        "weighted those that cannot be reached exactly."
    )
    if not skip and count < len(found):
        advice += " --skip leaves these rows empty and writes the others."
    head = f"{_have(found, count)} no command, and nothing was written:"
    return "\n".join([head, *rows, fill(advice)])


def _have(found: Commands, count: int) -> str:
    """``3 of 9 rows have``."""
    return f"{count} of {len(found)} rows {'has' if count == 1 else 'have'}"


def _table(
    title: str,
    heads: Iterable[str],
    rows: Iterable[tuple[str, Iterable[float], str]],
    digits: int = 4,
    widths: tuple[int, int] = (58, 10),
) -> str:
    """Labelled numbers in columns, "-" where there is none, and words behind them."""
    wide, cell = widths
    lines = [f"{title:<{wide}}" + "".join(f"{head:>{cell}}" for head in heads)]
    for label, values, behind in rows:
        cells = [
            f"{round(float(v), digits) + 0.0:>{cell}.{digits}f}"
            if np.isfinite(v)
            else f"{'-':>{cell}}"
            for v in values
        ]
        lines.append(f"{label:<{wide}}" + "".join(cells) + behind)
    return "\n".join(lines)


def _expected(robots: Robots, *, of_target: bool, larger: bool) -> str:
    """The verdict of the result and its error on rows that it had not seen: what to expect on the robot."""
    result, name = robots.result, robots.name
    if result is None:
        return fill(
            f"The true robot is {name}. How far it can be relied on is not in a URDF: with --calibration result.json "
            "this says what to expect."
        )
    part, verdict = result.part(larger=larger), result.verdict
    own = "its joint origins"
    if larger:
        of = f"its larger model '{part.model.name}'"
        own = of if verdict is None else f"{own}. The commands and the errors are of {of}"
    elif result.larger is not None:
        own += ", without the larger model that it has"
    said = [f"of {name}, {own}."]
    if verdict is None:
        said.append(
            "The result was not validated (calib fit --no-validate): how far it can be relied on is not known."
        )
        return "\n".join(["Verdict: none", *(fill(one, "  ") for one in said)])
    if verdict.use != "use":
        said += map(str, verdict.reasons)
    if verdict.use == "do not use":
        said.append("Commands made with this result may be worse than none. Calibrate anew.")
    lines = [f"Verdict: {verdict.use}", *(fill(one, "  ") for one in said)]
    errors, crossed = result.errors, part.cross_validation
    unseen = [
        ("validation rows, with the nominal robot", errors["nominal"]["validation"]),
        ("validation rows", errors["larger" if larger else "calibrated"]["validation"]),
        *([("left-out rows", crossed.errors_without_outliers)] if crossed is not None else []),
    ]
    rows = [(label, MM * np.array([e.max, e.mean, e.rms]), "") for label, e in unseen if e.n]
    if rows:
        whose = "These are errors of the target that was measured; this tool may miss by more."
        expect = "Expect errors of this size on the robot." if of_target else whose
        heads = ("max", "mean", "rms")
        lines += ["", _table("Position error of the result [mm]", heads, rows, 3)]
        lines.append(fill(f"{expect} What is computed below leaves them out."))
    return "\n".join(lines)


def _asked(found: Commands, tool: str | None, poses_in: str) -> str:
    """What is to arrive, how it is matched, and in which frame poses are."""
    robot, program = found.nominal, found.program
    what = "joint values"
    if program.T_wanted is not None:
        what = "poses" if program.oriented else "positions"
        what += f" (orientation: {program.form})" if program.form else ""
        what += ", joint values to start at" if program.q is not None else ""
    point = "" if tool is None else f"the point {_place(found.T_tip_tool)} in "
    frames = {BASE: f"'{robot.base}'", MEASURED: "the frame that was measured in"}
    frame = frames.get(poses_in, f"the frame of the set-up '{poses_in}'")
    return fill(
        f"Program: {len(found)} row{'s' * (len(found) > 1)} of {what}. What arrives: "
        f"{point or 'the tip '}'{robot.tip}'. Matched: {_MATCHED[found.match]}. Poses are in {frame}. "
        f"{passed_through(program)}"
    )


def _errors(found: Commands, *, poses: bool) -> str:
    """How far the robot would have missed, what is left, and how far the poses are moved."""
    rows = found.reached
    count = int(rows.sum())
    angles = bool(np.isfinite(found.missed[rows, 1]).any())
    # A controller with a redundant joint may come to other joint values than those that were meant.
    other = poses and bool((np.abs(found.left_by_pose - found.left)[rows] > _WORTH).any())
    table = [
        ("the tool would miss without correction by", found.missed),
        ("it misses with it by", found.left),
        *[("it misses by, if sent as a pose", found.left_by_pose)] * other,
        ("standard deviation of where it arrives (covariance)", found.std),
        ("the pose to send is moved by", found.pose_corrections),
    ]
    return _table(
        f"By the calibrated model, over {count} row{'s' * (count != 1)} with commands",
        ("max mm", "mean mm", "max deg", "mean deg")[: 2 + 2 * angles],
        [
            (
                label,
                [*_most_and_mean(MM * own[rows, 0]), *_most_and_mean(DEG * own[rows, 1]) * angles],
                "",
            )
            for label, own in table
            if np.isfinite(own[rows]).any()
        ],
    )


def _most_and_mean(values: Array) -> tuple[float, ...]:
    """Largest and mean of those that there are."""
    there = values[np.isfinite(values)]
    return (float(there.max()), float(there.mean())) if there.size else (math.nan, math.nan)


def _corrections(found: Commands) -> Iterator[str]:
    """How far each joint is moved; and the corrections of all rows, or of those where a joint is moved most."""
    robot, labels = found.nominal, found.program.labels
    slides = [robot.joint_types[name] == "prismatic" for name in robot.joint_names]
    changes = np.where(slides, MM, DEG) * found.joint_corrections
    sizes = np.abs(changes)
    if np.isfinite(changes).any():
        rows = []
        for name, slide, size in zip(robot.joint_names, slides, sizes.T, strict=True):
            # The first of those that differ by rounding.
            at = int(np.flatnonzero(size >= np.nanmax(size) - _TIE)[0])
            label = f"  {name[:48]} [{'mm' if slide else 'deg'}]"
            rows.append((label, _most_and_mean(size), f"   {labels[at][:16]}"))
        yield _table("Correction of each joint", ("max", "      mean   in"), rows)
    shown, title = np.flatnonzero(found.reached), "Corrections [mm, deg]"
    if len(shown) > _ROWS:
        most = np.nan_to_num(sizes[shown]).max(axis=1)
        # Those that differ by rounding stay in their order.
        shown = shown[np.argsort(-most.round(6), kind="stable")[:_ROWS]]
        title = "Largest corrections [mm,deg]"
    heads = ["pose mm", *(f"joint {i + 1}" for i in range(len(slides)))][: 1 + _JOINTS]
    moved = MM * found.pose_corrections[:, 0]
    lines = [(labels[i][:26], [moved[i], *changes[i, :_JOINTS]], "") for i in shown]
    yield _table(title, heads, lines, widths=(28, 9))


def _notes(
    found: Commands, robots: Robots, *, of_target: bool, poses: bool, in_base: bool
) -> Iterator[str]:
    """What to look at before the commands go to the robot, a note each; empty ones are none."""
    robot, program, rows, result = found.nominal, found.program, found.reached, robots.result
    yield unread_orientation(program)
    yield _elsewhere(found)
    known = np.isfinite(found.std[rows]).any()
    if result is not None and not result.setup.rotation and found.match != "position" and known:
        unsure, moved = (DEG * one[rows, 1].mean() for one in (found.std, found.pose_corrections))
        best = "--match position corrects the position alone, and leaves the orientation near the nominal robot's."
        other = "The calibrated target is known best: --tool target; or --match position."
        yield (
            f"Positions alone were measured for the result: how the tip is turned follows from them to {unsure:.2f} "
            f"deg (standard deviation), and the corrections turn it by {moved:.2f} deg on average. "
            f"{best if of_target else other}"
        )
    if in_base and result is not None and result.frame_estimated and known:
        yield (
            "The frame of the measurements was estimated with the robot, so that places in the base are known to "
            f"{MM * found.std[rows, 0].mean():.2f} mm (standard deviation) only. Places in the frame that was measured "
            "in are known better: --poses-in measured."
        )
    if robots.was_corrected:
        yield "ROBOT has the corrected joint origins already; what the controller has was taken from the result."
    computed = program.T_wanted is None
    if of_target and result is not None and (poses or computed):
        where = f"a tool at {_place(found.T_tip_tool_nominal)} in '{robot.tip}'"
        why = "It is where the target was stated to be before the calibration, which found it elsewhere."
        if np.array_equal(found.T_tip_tool, found.T_tip_tool_nominal):
            why = "It is where the calibration found the target, whose place was not stated before."
        wanted = "The poses wanted were computed from the joint values with"
        if poses:
            note = (
                f"The poses to send are those of {where}: set the controller's tool to that. {why}"
            )
            yield note + f" {wanted} the same tool." * computed
        else:
            yield f"{wanted} {where}. {why}"
    if in_base and (poses or not computed):
        yield _another_base(robot, "give" if result is None else "fit with")
    if poses and not in_base:
        yield (
            "The poses to send are in the frame that was measured in: set the controller's work object to "
            f"{_place(rigid_inverse(found.T_frame_base))} in '{robot.base}'."
        )


def _another_base(robot: Robot, how: str) -> str:
    """The link that is named as the controller's frame is, where poses are in one that stands otherwise."""
    if robot.base == _CONTROLLER or _CONTROLLER not in robot.urdf.links:
        return ""
    other = robot.rebuilt(base=_CONTROLLER, tip=robot.tip)
    q = np.zeros(len(robot.joint_names))
    if other.joint_names != robot.joint_names:
        return ""
    T = robot.poses(q)[0] @ rigid_inverse(other.poses(q)[0])
    if np.allclose(T, np.eye(4), rtol=0.0, atol=1e-6):
        return ""
    return (
        f"The robot also has a link '{_CONTROLLER}', at {_place(T)} in '{robot.base}'. On Universal Robots and in "
        f"URDFs of ROS-Industrial the controller's poses are in it: {how} --base {_CONTROLLER} where it is so."
    )


def _place(T: Array) -> str:
    """A pose in words; its rotation vector where it is turned."""
    turn = DEG * Rotation.from_matrix(T[:3, :3]).as_rotvec()
    place, turned = (
        ", ".join(f"{round(float(v), 4) + 0.0:.4f}" for v in one) for one in (MM * T[:3, 3], turn)
    )
    return f"({place}) mm" + f", rotation vector ({turned}) deg" * bool(np.abs(turn).max() > 1e-9)


def _elsewhere(found: Commands) -> str:
    """A program whose joint values do not belong to its poses: mostly another tool, or another frame."""
    program = found.program
    if program.q is None or program.T_wanted is None:
        return ""
    poses = found.T_frame_base @ found.nominal.poses(program.q) @ found.T_tip_tool_nominal
    far = float(np.median(np.linalg.norm(poses[:, :3, 3] - program.T_wanted[:, :3, 3], axis=1)))
    if far < _ELSEWHERE:
        return ""
    return (
        f"At the program's joint values the nominal robot has the tool {MM * far:.0f} mm from the program's positions "
        "(median). Are these of another tool (--tool), in another frame (--poses-in), or measured ones (--given "
        "joints)?"
    )


def _reasons(found: Commands) -> list[str]:
    """The rows without a command, and why."""
    rows = zip(found.program.labels, found.reasons, strict=True)
    return [fill(f"{label}: {why}", "  ", "  ") for label, why in rows if why]


def _warnings(found: Commands, *, larger: bool) -> str:
    """The warnings of all rows, one line for each kind of them, the first of its rows as the example."""
    kinds: dict[str, list[tuple[str, str]]] = {}
    for label, said in zip(found.program.labels, found.warnings, strict=True):
        for warned in said:
            kinds.setdefault(warned.code, []).append((label, str(warned)))
    if not kinds:
        return ""
    lines = [f"{_have(found, sum(map(bool, found.warnings)))} a warning:"]
    for (label, what), *others in kinds.values():
        names = _listed([other for other, _ in others], _NAMED)
        more = f"; and {len(others)} more row{'s' * (len(others) > 1)}: {names}" if others else ""
        lines.append(fill(f"{label}: {what}{more}", "  ", "  "))
    if "outside" in kinds:
        grows = " Errors that grow with a joint's value or load, as those of the larger model, can be far off there."
        text = "The result was not tested outside of the measured range: measure there too."
        lines.append(fill(text + grows * larger))
    return "\n".join(lines)


def _listed(labels: Sequence[str], most: int) -> str:
    """Some rows by their names, at most so many of them or runs of them, and how many more."""
    names = [label.removeprefix("row ") for label in labels]
    if all(name.isdecimal() for name in names):
        return row_ranges(map(int, names), most)
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


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
    names = [split_header(label)[0] for label, _ in program.kept]
    named = {name.casefold(): name for name in names}
    for looked, whose, meaning in _MEANT:
        if not set(looked) <= set(named):
            continue
        there = [named[name] for name in looked]
        unit = "" if "qw" in meaning else " [deg]"
        pairs = zip(there, meaning, strict=False)
        options = " ".join(f'--columns "{column}={name}{unit}"' for column, name in pairs)
        how = f"({whose}): {options}" if meaning else "convert them to quaternions, qx, qy, qz, qw"
        return (
            f"The columns {', '.join(there)} look like an orientation and were not read: positions alone are matched, "
            f"and in the table the old one stands beside the new one. If they are one {how}. Otherwise they mean "
            "nothing here."
        )
    return ""
