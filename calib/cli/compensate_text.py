"""What ``calib compensate`` prints: what to expect of the commands, how large the corrections are, what to look at."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.cli.terminal import fill, row_ranges
from calib.model.robot import rigid_inverse
from calib.units import split_header

if TYPE_CHECKING:
    from calib.compensate.commands import Commands
    from calib.compensate.program import Program
    from calib.identify.result import Calibration
    from calib.model.robot import Robot

Array = NDArray[np.float64]

#: The words for the tool that is the calibrated target, for poses in the robot's base, and for poses in the frame that
#: the points were measured in, where there is one.
TARGET, BASE, MEASURED = "target", "base", "measured"

#: One metre and one radian in the units that are printed.
MM, DEG = 1e3, float(np.degrees(1.0))

#: What a controller misses by above this, sent as a pose and not as joint values, is worth a line [m], [rad].
_WORTH = 1e-7

#: Rows of the table of corrections; and corrections that differ by less are the same [rad or m].
_ROWS, _TIE = 5, 1e-9

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
    rows, one = _reasons(found), found.reached.sum() == len(found) - 1
    head = f"{len(rows)} {'row has' if one else f'of {len(found)} rows have'} no command, and "
    head += f"{'is' if one else 'are'} empty in the table:"
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
        _joints(found),
        _largest(found),
        *map(fill, filter(None, notes)),
        "\n".join([head, *rows]) if rows else "",
        _warnings(found, larger=larger),
        after,
    ]
    return "\n\n".join(part for part in parts if part)


def no_commands(found: Commands, *, skip: bool) -> str:
    """The message that names each row without a command and why it has none; with ``skip`` no row has one."""
    count, every = int((~found.reached).sum()), len(found)
    head = f"{count} of {every} rows {'has' if count == 1 else 'have'} no command"
    if count == every:
        head = "the row has no command" if every == 1 else f"none of the {every} rows has a command"
    rows = _reasons(found)
    if count > _REASONS:
        labels = np.array(found.program.labels)[~found.reached].tolist()
        rows = [*rows[:_REASONS], f"  and rows {_listed(labels[_REASONS:], count)}"]
    advice = _elsewhere(found) or (
        "Check --tool, --poses-in and the units; --accept takes rows of which little is left, --match position or "
        "weighted those that cannot be reached exactly."
    )
    if not skip and count < every:
        advice += " --skip leaves these rows empty and writes the others."
    return "\n".join([f"{head}, and nothing was written:", *rows, fill(advice)])


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
    lines = [f"Verdict: {verdict.use if verdict else 'none'}", fill(f"of {name}, {own}.", "  ")]
    if verdict is None:
        lines.append(
            fill(
                "The result was not validated (calib fit --no-validate): how far it can be relied on is not known.",
                "  ",
            )
        )
        return "\n".join(lines)
    if verdict.use != "use":
        lines += [fill(str(reason), "  ") for reason in verdict.reasons]
    if verdict.use == "do not use":
        lines.append(
            fill("Commands made with this result may be worse than none. Calibrate anew.", "  ")
        )
    errors, crossed = result.errors, part.cross_validation
    unseen = [
        ("validation rows, with the nominal robot", errors["nominal"]["validation"]),
        ("validation rows", errors["larger" if larger else "calibrated"]["validation"]),
        ("left-out rows", crossed.errors_without_outliers if crossed is not None else None),
    ]
    rows = [
        f"{label:<58}" + "".join(f"{MM * value:>10.3f}" for value in (one.max, one.mean, one.rms))
        for label, one in unseen
        if one is not None and one.n
    ]
    if rows:
        head = f"{'Position error of the result [mm]':<58}{'max':>10}{'mean':>10}{'rms':>10}"
        expect = "Expect errors of this size on the robot. What is computed below leaves them out."
        if not of_target:
            expect = (
                "These are errors of the target that was measured, not of this tool, which may miss by more. What is "
                "computed below leaves them out."
            )
        lines += ["", head, *rows, fill(expect)]
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
    head = f"By the calibrated model, over {count} row{'s' * (count != 1)} with commands"
    lines = [
        f"{head:<58}{'max mm':>10}{'mean mm':>10}" + f"{'max deg':>10}{'mean deg':>10}" * angles
    ]
    # A controller with a redundant joint may come to other joint values than those that were meant.
    other = poses and bool((np.abs(found.left_by_pose - found.left)[rows] > _WORTH).any())
    for label, values, shown in (
        ("the tool would miss without correction by", found.missed, True),
        ("it misses with it by", found.left, True),
        ("it misses by, if sent as a pose", found.left_by_pose, other),
        ("standard deviation of where it arrives (covariance)", found.std, True),
        ("the pose to send is moved by", found.pose_corrections, True),
    ):
        if shown and np.isfinite(values[rows]).any():
            cells = [_most_and_mean(scale * values[rows, i]) for i, scale in ((0, MM), (1, DEG))]
            lines.append(f"{label:<58}" + "".join(cells[: 1 + angles]))
    return "\n".join(lines)


def _most_and_mean(values: Array) -> str:
    """Largest and mean of those that there are."""
    there = values[np.isfinite(values)]
    return f"{there.max():>10.4f}{there.mean():>10.4f}" if there.size else f"{'-':>10}{'-':>10}"


def _scales(robot: Robot) -> list[tuple[float, str]]:
    """What the value of each joint is printed in."""
    slides = [robot.joint_types[name] == "prismatic" for name in robot.joint_names]
    return [(MM, "mm") if slide else (DEG, "deg") for slide in slides]


def _joints(found: Commands) -> str:
    """How far each joint is moved."""
    changes = np.abs(found.joint_corrections)
    if not np.isfinite(changes).any():
        return ""
    lines = [f"{'Correction of each joint':<58}{'max':>10}{'mean':>10}   in"]
    robot = found.nominal
    for name, column, (scale, unit) in zip(
        robot.joint_names, changes.T, _scales(robot), strict=True
    ):
        # The first of those that differ by rounding.
        row = int(np.flatnonzero(column >= np.nanmax(column) - _TIE)[0])
        where = found.program.labels[row][:16]
        lines.append(f"  {f'{name[:48]} [{unit}]':<56}{_most_and_mean(scale * column)}   {where}")
    return "\n".join(lines)


def _largest(found: Commands) -> str:
    """The corrections of all rows, or of those where a joint is moved most."""
    changes = np.array([scale for scale, _ in _scales(found.nominal)]) * found.joint_corrections
    shown, head = np.flatnonzero(found.reached), "Corrections [mm, deg]"
    if len(shown) > _ROWS:
        most = np.nan_to_num(np.abs(changes[shown])).max(axis=1)
        # Those that differ by rounding stay in their order.
        shown = shown[np.argsort(-most.round(6), kind="stable")[:_ROWS]]
        head = "Largest corrections [mm,deg]"
    columns = changes[:, :7]
    lines = [
        f"{head:<28}{'pose mm':>9}"
        + "".join(f"{f'joint {i + 1}':>9}" for i in range(columns.shape[1]))
    ]
    for i in shown:
        values = [MM * found.pose_corrections[i, 0], *columns[i]]
        cells = [f"{round(v, 4) + 0.0:>9.4f}" if np.isfinite(v) else f"{'-':>9}" for v in values]
        lines.append(f"{found.program.labels[i][:26]:<28}" + "".join(cells))
    return "\n".join(lines)


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
    count = sum(map(bool, found.warnings))
    lines = [f"{count} of {len(found)} rows {'has' if count == 1 else 'have'} a warning:"]
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
