"""A session in words, for `calib measure`: the next pose, the answer to a stop, what to do, and how it ends.

Each text is made of lines with the style that a terminal gives them, see `calib.cli.terminal.say_lines`.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from calib.basics.channels import RESIDUAL_UNITS
from calib.robot.robot import Robot
from calib.show.lines import fill, number, plural, row_ranges
from calib.show.words import joint_unit, shown
from calib.verbs.measure.session import Session
from calib.verbs.measure.state import Advice, NextPose, State
from calib.verbs.measure.stop import Answer, Finding

#: A line and its style.
Line = tuple[str, str]

#: Styles: of what counts, of what does not, of what should be looked at, of what is to be read from afar, and of hints.
GOOD, BAD, LOOK, LARGE, DIM = "bold green", "bold red", "yellow", "bold", "dim"

#: Indent of what belongs to a line.
_INDENT = "  "

#: Columns of a joint value.
_VALUE = 11

#: Of a range whose ends differ by this factor, the lower one is not shown.
_WIDE = 2

#: Digits of joint values, 0.001 deg and 0.001 mm, and of places.
_DIGITS, _PLACE = 3, 1

#: The commands, with what they do.
COMMANDS: Mapping[str, str] = {
    "undo": "take the last stop back",
    "again": "take the last stop back, and measure its pose again",
    "skip": "the proposed pose cannot be reached: propose another one",
    "at J1 J2 ...": "the robot stands at these joint values, and not at the proposed ones",
    "enough": "a target cannot be seen here: take what was measured",
    "note TEXT": "write a remark into the session's journal",
    "state": "how accurate it is so far, and what would help",
    "done": "end the session, and calibrate if files are named, such as by -o",
    "quit": "leave, and go on later",
    "help": "these lines",
}


def opening_lines(session: Session, *, goes_on: bool) -> Iterator[Line]:
    """Yield what a session begins with: robot, aim, and where it is kept.

    Args:
        session: The session.
        goes_on: Whether it was begun earlier.
    """
    state = session.state
    begun = "goes on" if goes_on else "begins"
    robot = session.robot
    counted = f" with {_counted(state)}" if goes_on else ""
    yield (
        f"The session in '{session.folder}' {begun}{counted}: robot '{robot.name}', "
        f"{robot.base} to {robot.tip}.",
        LARGE,
    )
    aim = session.aim
    where = "over the joint ranges" if aim.region is None else "over the region"
    what = f"the accuracy that {aim.poses} poses at random would give" if aim.error is None else ""
    size = f"{_size(state.aim)} rms {where}, with a probability of 95 %"
    yield fill(f"The aim is {f'{what}, {size}' if what else size}."), ""
    if session.torn:
        yield (
            fill(
                "The last line of the journal was not complete, since the program was ended while it wrote it; it was "
                "left out. Measure that stop again."
            ),
            LOOK,
        )


def _counted(state: State) -> str:
    """Return how many stops a session has, and how many of them count if not all do."""
    if state.stops == state.measured:
        return plural(state.stops, "stop")
    return f"{state.stops} of {plural(state.measured, 'stop')} that count"


def hint_line(*, has_instrument: bool) -> Line:
    """Return what a person is told to do, once."""
    if has_instrument:
        return "Drive to each pose and measure there. Commands can be typed at any time: help.", DIM
    return "Drive to each pose, type what the instrument shows, and Enter. Commands: help.", DIM


def pose_lines(session: Session, pose: NextPose, state: State) -> Iterator[Line]:
    """Yield the next pose: its title, the joint values in a column, where targets are then, and why it is next."""
    yield "", ""
    yield _title(session, pose, state), LARGE
    yield from _joint_lines(session.robot, pose)
    # After something has moved, the places are those of before.
    has_moved = any(finding.code.endswith("_moved") for finding in state.findings)
    known = (state.error is not None or not session.cell.estimate_frame) and not has_moved
    frame = "the instrument's frame" if session.cell.estimate_frame else "the measurement frame"
    names = pose.targets if len(set(pose.targets)) > 1 else [""] * len(pose.targets)
    for name, place in zip(names, pose.expected.tolist(), strict=False):
        if known and np.isfinite(place).all():
            x, y, z = (number(1e3 * value, _PLACE) for value in place)
            who = f"target '{name}'" if name else "the target"
            yield f"{_INDENT}{who} will be near ({x}, {y}, {z}) mm in {frame}", DIM
    if pose.via is not None:
        text = "Drive to the pose of the column 'first' before, so that each joint arrives from the right side."
        yield fill(text, _INDENT), DIM
    if pose.error is not None and math.isfinite(pose.error):
        yield f"{_INDENT}with it the error is expected to be at most {_size(pose.error)}", DIM


def _title(session: Session, pose: NextPose, state: State) -> str:
    """Return the title of a pose: the number of its stop, how many are needed in all, and why it is next."""
    number = len(session.stops) + 1
    title = f"Stop {number}"
    if pose.stop is not None:
        repeats = "once more" if pose.stop == number else f"repeats stop {pose.stop}"
        why = ", which is far off by now" if pose.why == "outlier" else ""
        return f"{title} {repeats}{why}: drive the robot to the same pose"
    if state.needed is not None and not state.reached:
        title += f" of {_about(*(len(session.stops) + n for n in state.needed))}"
    return f"{title}: drive the robot to"


def _joint_lines(robot: Robot, pose: NextPose) -> Iterator[Line]:
    """Yield the joint values of a pose in a column, with those of the place before it."""
    slides = [robot.joint_types[name] == "prismatic" for name in robot.joint_names]
    width = max(map(len, robot.joint_names))
    if pose.via is not None:
        yield f"{_INDENT}{'':<{width}}{'first':>{_VALUE}}{'then':>{_VALUE}}", DIM
    for k, (name, is_length) in enumerate(zip(robot.joint_names, slides, strict=True)):
        factor, unit = joint_unit(prismatic=is_length)
        columns = [pose.joints] if pose.via is None else [pose.via, pose.joints]
        values = "".join(f"{number(factor * q[k], _DIGITS):>{_VALUE}}" for q in columns)
        yield f"{_INDENT}{name:<{width}}{values} {unit}", LARGE


def prompt(headers: Sequence[str], target: str) -> str:
    """Return what stands before a row that is typed, ``"x y z [mm]> "``, after the target's name if it is given."""
    units: dict[str, list[str]] = {}
    for header in headers:
        name, _, unit = header.partition(" [")
        units.setdefault(unit.rstrip("]"), []).append(name)
    parts = [
        f"{' '.join(names)} [{unit}]" if unit else " ".join(names) for unit, names in units.items()
    ]
    who = f"{target}: " if target else ""
    return f"{_INDENT}{who}{', '.join(parts)}> "


def waiting_line(source: str, missing: Sequence[str], *, waits_for_go: bool) -> Line:
    """Return the line that says what is waited for.

    Args:
        source: The instrument, as ``--reader`` names it.
        missing: Targets or cameras that are still to be measured, if there are several.
        waits_for_go: Whether the instrument is asked when a person says so.
    """
    if waits_for_go:
        what = f"Press Enter when the robot stands there; then '{source}' measures."
    elif len(missing) > 1:
        what = f"Measure {', '.join(missing)} there; waiting for '{source}'."
    else:
        what = f"Measure there; waiting for '{source}'."
    return f"{_INDENT}{what}", DIM


def late_line(count: int) -> Line:
    """Return the line on readings that came before the pose was shown."""
    came = (
        "A reading came before this pose was shown; it was"
        if count == 1
        else (f"{count} readings came before this pose was shown; they were")
    )
    return f"{_INDENT}{came} left out. Measure here.", LOOK


def answer_summary(answer: Answer) -> str:
    """Return the answer to a stop as text, with the error after it in place of that beside the aim."""
    error = "its error is not known yet"
    if answer.after is not None:
        error = f"error at most {_size(answer.after)}"
    return joined(_answer_lines(None, answer, error))


def answer_lines(robot: Robot, answer: Answer, state: State) -> Iterator[Line]:
    """Yield the answer to a stop: in a line whether it counts, how far it is off, and the error; then what to do."""
    yield from _answer_lines(robot, answer, error_text(state))


def _answer_lines(robot: Robot | None, answer: Answer, error: str) -> Iterator[Line]:
    """Yield the answer to a stop, with words on the expected error."""
    off = _sizes(answer.residual)
    if answer.outcome == "good":
        usual = f" (usual: {_sizes(answer.usual)})" if answer.usual else ""
        words, style = f"good | off by {off}{usual}" if off else "good", GOOD
    elif answer.outcome == "again":
        words, style = "NOT GOOD, it does not count", BAD
        words += f" | off by {off}" if off else ""
    else:
        words, style = "taken | too few stops to check it", ""
    if answer.outcome != "again":
        words += f" | {error}"
    yield f"Stop {answer.stop}: {words}", style
    for finding in answer.findings:
        yield (
            fill(finding_text(robot, finding, answer.stop), _INDENT),
            BAD if answer.outcome == "again" else LOOK,
        )
    if answer.outcome == "again" and not answer.findings:
        advice = "Look at target, instrument and joint values, and measure it again."
        yield fill(advice, _INDENT), BAD


def error_text(state: State) -> str:
    """Return the expected error beside the aim, and how many poses are still needed."""
    if state.error is None or state.high is None:
        because = " while it is undecided what has moved" if _is_undecided(state) else " yet"
        return f"its error is not known{because}"
    text = f"error at most {_size(state.high)}, aim {_size(state.aim)}"
    return text if state.reached else f"{text}, {_left_text(state)}"


def _left_text(state: State) -> str:
    """Return what the aim, which is not reached, still lacks: poses, or why an error below it is not enough."""
    if state.high is None or state.high > state.aim:
        return needed_text(state)
    if _is_undecided(state):
        return "not reached while it is undecided what has moved"
    return "not reached before two stops were found good by the others"


def _is_undecided(state: State) -> bool:
    """Return whether something has moved, and it is not known yet what."""
    return any(finding.code == "something_moved" for finding in state.findings)


def needed_text(state: State) -> str:
    """Return how many poses are still needed."""
    if state.needed is None:
        return "many poses to go"
    least, most = state.needed
    return f"{_about(least, most)} {'pose' if most == 1 else 'poses'} to go"


def _about(least: int, most: int) -> str:
    """Return a range of numbers; of a wide one the largest alone tells something."""
    if least == most:
        return f"about {most}"
    return f"about {least} to {most}" if most < _WIDE * least else f"up to {most}"


def _sizes(sizes: Mapping[str, float]) -> str:
    """Write residuals with their units."""
    return ", ".join(_size(size, unit) for unit, size in sizes.items())


def _size(value: float, unit: str = "m") -> str:
    """Write the size of an error with its unit: a large one with fewer digits than errors have."""
    of_unit = RESIDUAL_UNITS[unit]
    large = sum(of_unit.to_shown * value >= limit for limit in (1.0, 10.0, 100.0))
    return f"{shown(value, unit, max(of_unit.digits - large, 0))} {of_unit.shown}"


def finding_text(robot: Robot | None, finding: Finding, answered: int | None = None) -> str:
    """Return what may be wrong, and what to do.

    Args:
        robot: The robot; None: how far a joint is off is left out, since its unit is not known.
        finding: What may be wrong.
        answered: Number of the stop at which it was found; None: it is not told from an earlier one.
    """
    values, name = finding.values, finding.name
    since = row_ranges(finding.stops[:1])
    stop = values.get("stop", 0.0)
    match finding.code:
        case "gross" if answered is not None and answered not in finding.stops:
            return (
                f"Stop {row_ranges(finding.stops)} is far off by now and no longer counts. Nothing is to be done: the "
                "next poses make up for it."
            )
        case "gross":
            off = [(f"off_{unit}", unit) for unit in RESIDUAL_UNITS]
            size = ", ".join(_size(values[key], unit) for key, unit in off if key in values)
            far = f" by {size}" if size else ""
            return (
                f"The reading of stop {since} is far off{far}: was the target loose, turned away or another one, or "
                "the robot still moving? Measure it again."
            )
        case "swapped":
            what = f" ({name})" if name else ""
            return (
                f"Coordinates or targets are taken for each other{what}: in another order the reading fits. Check the "
                "order of columns and the names of targets, and measure it again."
            )
        case "repeated":
            return (
                f"This is the reading of stop {stop:.0f} once more: the instrument has not measured anew, or the robot "
                "has not moved. Measure it again."
            )
        case "not_there":
            return _not_there(robot, finding)
        case "target_moved":
            who = f"The target '{name}'" if name else "The target"
            return (
                f"{who} sits elsewhere since stop {since}. That costs no stop: those since then count with its new "
                "place. Look why it moved, and fasten it."
            )
        case "base_moved":
            return (
                f"The robot's base or the instrument stands elsewhere since stop {since}. That costs no stop: those "
                "since then count with the new place. Look why it moved, and fasten it."
            )
        case "something_moved":
            return (
                f"Target, base or instrument has moved since stop {since}; the next stops tell which. That costs no "
                "stop. Look why it moved, and fasten it."
            )


def _not_there(robot: Robot | None, finding: Finding) -> str:
    """Return the text of a reading that fits another pose."""
    if finding.name and "change" in finding.values:
        change = "off"
        if robot is not None:
            is_length = robot.joint_types[finding.name] == "prismatic"
            factor, unit = joint_unit(prismatic=is_length)
            change = f"{number(factor * finding.values['change'], 2, sign='+')} {unit}"
        return (
            f"The reading fits if '{finding.name}' is {change} from its value: was that noted wrongly, or is the "
            "robot not there? Give the joint values of the controller, and measure it again."
        )
    return (
        "The reading fits another pose: the robot is not where it was sent, or the reading was made too early. Check "
        "where it stands, and measure it again."
    )


def state_lines(robot: Robot, state: State) -> Iterator[Line]:
    """Yield what is known after the stops so far, and what would help."""
    yield count_text(state.stops, state.measured), LARGE
    if state.error is not None and state.low is not None and state.high is not None:
        yield (
            fill(
                f"Expected error of the calibrated robot: {_size(state.error)}, from {_size(state.low)} to "
                f"{_size(state.high)} (90 %); aim {_size(state.aim)}, "
                f"{'reached' if state.reached else _left_text(state)}."
            ),
            GOOD if state.reached else "",
        )
    else:
        because = " while it is undecided what has moved" if _is_undecided(state) else " yet"
        yield f"Expected error: not known{because}; aim {_size(state.aim)}.", ""
    if state.nominal is not None:
        yield f"Error of the nominal robot, as the stops show it: {_size(state.nominal)}.", ""
    if state.sigma:
        yield f"Noise of one reading: {_sizes(state.sigma)}.", ""
    for finding in state.findings:
        text = finding_text(robot, finding)
        if finding.code == "gross":
            text = f"Stop {row_ranges(finding.stops)} is far off by now; it counts little, or no longer."
        yield fill(text), LOOK
    for advice in state.advice:
        yield fill(advice_text(advice)), ""


def count_text(stops: int, measured: int) -> str:
    """Return how many stops count, of those that were measured."""
    if not measured:
        return "No stop is measured yet."
    verb = "counts" if 1 in (stops, measured) else "count"
    return f"{stops} of {plural(measured, 'stop')} {verb}."


def advice_text(advice: Advice) -> str:
    """Return what would help."""
    values = advice.values
    match advice.code:
        case "joint":
            return (
                f"What is left is mostly the joint '{advice.name}' ({100.0 * values['share']:.0f} % of the square): "
                "poses in which it moves far help most; look whether its range is narrowed."
            )
        case "region":
            place = ", ".join(number(1e3 * values[f"{axis}_m"], 0) for axis in "xyz")
            return (
                f"Around ({place}) mm the error is {number(values['ratio'], 1)} times the mean: poses that reach there "
                "help; look whether boxes or ranges keep the robot away."
            )
        case "second_target":
            return (
                "A second target on the hand, away from the first one, would show the wrist better. That is another "
                "session: name both in its cell."
            )
        case "length":
            return (
                f"The scale is {100.0 * values['share']:.0f} % of what is left: measure the board with a ruler, calib "
                "board --measured, and state how well it is known."
            )
        case "noise":
            return (
                f"The readings scatter {number(values['factor'], 1)} times as much as stated, or as usual if "
                "nothing is stated: look at the instrument, the mount of the target, and whether the robot has settled."
            )
        case "lost_motion":
            return "Poses that are approached from both sides would show lost motion."


def reached_lines(*, can_type: bool) -> Iterator[Line]:
    """Yield what is said when the aim is reached; ``can_type``: a person can go on."""
    yield "The aim is reached.", GOOD
    if can_type:
        yield f"{_INDENT}'done' ends the session; further stops make it better still.", ""


def commands(*, several: bool, has_robot: bool) -> dict[str, str]:
    """Return the commands that there are, with what they do.

    Args:
        several: Whether a stop has several targets.
        has_robot: Whether a controller says where the robot stands, so that it is not typed.
    """
    missing = {"enough": not several, "at": has_robot}
    return {k: v for k, v in COMMANDS.items() if not missing.get(k.split()[0])}


def help_lines(known: Mapping[str, str]) -> Iterator[Line]:
    """Yield commands, as of `commands`."""
    width = max(map(len, known))
    for command, what in known.items():
        yield f"{_INDENT}{command:<{width}}  {what}", ""


def kept_text(folder: str, stops: int, command: str) -> str:
    """Return what is said when a session is left: what is kept, and how it goes on."""
    kept = f"All {plural(stops, 'stop')}" if stops > 1 else plural(stops, "stop")
    return f"{kept} {'are' if stops != 1 else 'is'} kept in '{folder}'. Go on with: {command}"


def calibrate_command(robot: str, table: str, cell: str) -> str:
    """Return the command that calibrates the robot by a session's files."""
    outputs = ("-o", "corrected.urdf", "--json", "result.json", "--report", "report.html")
    return shlex.join(["calib", "calibrate", robot, table, "--cell", cell, *outputs])


def joined(lines: Iterable[Line]) -> str:
    """Return lines without their styles."""
    return "\n".join(text for text, _ in lines)
