"""A session as its page shows it: the next pose in numbers, what was said of the last stop, the curve, all stops."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import meshcat
import meshcat.geometry as mc
import numpy as np

from calib.basics.arrays import Array
from calib.basics.channels import RESIDUAL_UNITS
from calib.robot.robot import Robot
from calib.show.lines import mm, number, row_ranges
from calib.show.look import CALIBRATED
from calib.show.scene.html_page import LegendEntry
from calib.show.scene.posed_robot import PosedRobot, chain_bases, read_visuals
from calib.show.scene.scene import draw_robot
from calib.show.words import joint_unit, shown
from calib.verbs.app.sentences import Sentences
from calib.verbs.measure.course import CurvePoint
from calib.verbs.measure.session import Session
from calib.verbs.measure.state import NextPose, State
from calib.verbs.measure.stop import Answer, Finding, Stop
from calib.verbs.view.robots_page import About, view_page
from calib.verbs.view.view import View

#: Joints of Universal Robots' arms, whose programs take a pose as ``movej``.
_UR = "shoulder_pan_joint"

#: Digits of the numbers that are typed at a robot: 0.001 deg, 0.001 mm.
_DIGITS = 3

#: Width and height of the curve, in its own units.
_WIDTH, _HEIGHT = 600.0, 200.0

#: Shades and signs of answers.
_SHADES = {"good": ("good", "✓"), "again": ("bad", "✕"), "unknown": ("none", "–")}


@dataclass(frozen=True, slots=True)
class JointValue:
    """A joint's value to be typed at the robot."""

    name: str
    value: str
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseView:
    """The next pose."""

    joints: tuple[JointValue, ...]
    via: tuple[JointValue, ...]
    #: As a row of numbers, and as a line of a robot's program; empty where there is none
    row: str
    program: str
    #: Name and place of each target, ``"812.3, 5.1, 420.9 mm"``
    expected: tuple[tuple[str, str], ...]
    why: str
    #: Number of the stop that it repeats; 0: a new one
    stop: int


@dataclass(frozen=True, slots=True)
class StopLine:
    """A stop in the list."""

    number: int
    shade: str
    sign: str
    words: str
    counts: bool
    residual: str
    findings: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class AnswerView:
    """The answer to the last stop, in words."""

    stop: int
    shade: str
    sign: str
    sentence: str
    #: What to do, where no finding says it; empty: nothing
    help: str
    #: The residual with its unit, large; empty if nothing was expected
    residual: str
    usual: str
    findings: tuple[str, ...]
    change: str


@dataclass(frozen=True, slots=True)
class Curve:
    """The expected error over the stops, on a logarithmic axis: points as SVG has them."""

    line: str
    band: str
    aim: float
    #: The axis' ends with their unit, and the last stop
    top: str
    bottom: str
    first: int
    last: int


def pose_view(session: Session, pose: NextPose, *, is_placed: bool) -> PoseView:
    """Return the next pose in the units of teach pendants.

    Args:
        session: The session.
        pose: The next pose.
        is_placed: Whether the measurement frame is known by now, so that a place in it can be said.
    """
    robot = session.robot
    slides = [robot.joint_types[name] == "prismatic" for name in robot.joint_names]

    def values(q: Array) -> tuple[JointValue, ...]:
        """Return joint values (m,) in their units."""
        found = []
        for name, value, is_length in zip(robot.joint_names, q.tolist(), slides, strict=True):
            size = 1e3 * value if is_length else math.degrees(value)
            found.append(JointValue(name, f"{size + 0.0:.{_DIGITS}f}", "mm" if is_length else "°"))
        return tuple(found)

    joints = values(pose.joints)
    program = ""
    if robot.joint_names[0].endswith(_UR):
        program = f"movej([{', '.join(f'{value:.6f}' for value in pose.joints)}], a=0.5, v=0.3)"
    expected = tuple(
        (name, f"{', '.join(number(1e3 * value, 1) for value in place)} mm")
        for name, place in zip(pose.targets, pose.expected.tolist(), strict=False)
        if is_placed and np.isfinite(place).all()
    )
    return PoseView(
        joints=joints,
        via=() if pose.via is None else values(pose.via),
        row=" ".join(one.value for one in joints),
        program=program,
        expected=expected,
        why=pose.why,
        stop=pose.stop or 0,
    )


def finding_text(finding: Finding, robot: Robot, t: Sentences, answered: int | None = None) -> str:
    """Word a finding, perhaps one at the answer to a stop: what may be wrong, and what to do."""
    values, name = finding.values, finding.name
    if finding.code == "gross" and answered is not None and answered not in finding.stops:
        return t("open_gross", stop=row_ranges(finding.stops))
    if finding.code == "not_there" and name and "change" in values:
        factor, unit = joint_unit(prismatic=robot.joint_types[name] == "prismatic")
        change = f"{number(factor * values['change'], 2, sign='+')} {unit}"
        return t("finding_not_there_joint", name=name, change=change)
    order = f"xyz → {name}" if len(name) == len("xyz") and {*name} == {*"xyz"} else name
    off = _residual({u: values[f"off_{u}"] for u in RESIDUAL_UNITS if f"off_{u}" in values})
    return t(
        f"finding_{finding.code}",
        stop=row_ranges(finding.stops[:1]),
        other=f"{values.get('stop', 0.0):.0f}",
        name=name or t("the_target"),
        order=f" ({order})" if name else "",
        off=f" ({off})" if off else "",
    )


def open_text(finding: Finding, robot: Robot, t: Sentences) -> str:
    """Word a finding that is open: a stop that is far off was accepted, and has little weight by now."""
    if finding.code == "gross":
        return t("open_gross", stop=row_ranges(finding.stops))
    return finding_text(finding, robot, t)


def unreached_text(state: State, t: Sentences) -> str:
    """Return why the aim is not reached though the expected error is within it; empty: more poses are needed."""
    if any(finding.code == "something_moved" for finding in state.findings):
        return t("unreached_undecided")
    if not state.reached and state.high is not None and state.high <= state.aim:
        return t("unreached_unchecked")
    return ""


def _residual(sizes: dict[str, float]) -> str:
    """Write a residual with its units."""
    parts = [f"{shown(size, unit)} {RESIDUAL_UNITS[unit].shown}" for unit, size in sizes.items()]
    return ", ".join(parts)


def answer_view(answer: Answer, robot: Robot, t: Sentences) -> AnswerView:
    """Return what was said of a stop, in words."""
    shade, sign = _SHADES[answer.outcome]
    change = ""
    if answer.before is not None and answer.after is not None:
        change = t("answer_change", before=mm(answer.before), after=mm(answer.after))
    return AnswerView(
        stop=answer.stop,
        shade=shade,
        sign=sign,
        sentence=t(f"answer_{answer.outcome}", stop=answer.stop),
        help=t("answer_help") if answer.outcome == "again" and not answer.findings else "",
        residual=_residual(dict(answer.residual)),
        usual=_residual(dict(answer.usual)),
        findings=tuple(finding_text(one, robot, t, answer.stop) for one in answer.findings),
        change=change,
    )


def stop_lines(stops: Sequence[Stop], robot: Robot, t: Sentences) -> Iterator[StopLine]:
    """Yield the stops for the list, the last first."""
    words = {"good": t("stop_good"), "again": t("stop_again"), "unknown": t("stop_unknown")}
    for stop in reversed(stops):
        shade, sign = _SHADES[stop.answer.outcome]
        yield StopLine(
            number=stop.number,
            shade=shade,
            sign=sign,
            words=words[stop.answer.outcome],
            counts=stop.counts,
            residual=_residual(dict(stop.answer.residual)),
            findings=tuple(
                finding_text(one, robot, t, stop.number) for one in stop.answer.findings
            ),
        )


def advice_texts(state: State, t: Sentences) -> Iterator[str]:
    """Yield what would help, in words."""
    for advice in state.advice:
        values = advice.values
        place = [values.get(f"{axis}_m") for axis in "xyz"]
        words = {
            "name": advice.name,
            "share": f"{100.0 * values.get('share', 0.0):.0f}",
            "factor": f"{values.get('factor', values.get('ratio', 0.0)):.1f}",
            "place": ", ".join(f"{1e3 * one:.0f}" for one in place if one is not None),
        }
        yield t(f"advice_{advice.code}", **words)


def curve_of(points: Sequence[CurvePoint], aim: float) -> Curve | None:
    """Return the curve of the expected error; None before there are two points."""
    known = [p for p in points if all(math.isfinite(v) and v > 0 for v in (p.low, p.error, p.high))]
    if len(known) < 2:
        return None
    low = 0.8 * min(aim, *(point.low for point in known))
    high = 1.25 * max(aim, *(point.high for point in known))
    first, last = known[0].stop, max(known[-1].stop, known[0].stop + 1)

    def x(stop: int) -> float:
        """Return the place of a stop."""
        return round(_WIDTH * (stop - first) / (last - first), 1)

    def y(error: float) -> float:
        """Return the height of an error."""
        return round(_HEIGHT * math.log(high / error) / math.log(high / low), 1)

    line = " ".join(f"{x(p.stop)},{y(p.error)}" for p in known)
    upper = [f"{x(p.stop)},{y(p.high)}" for p in known]
    lower = [f"{x(p.stop)},{y(p.low)}" for p in reversed(known)]
    return Curve(line, " ".join([*upper, *lower]), y(aim), mm(high), mm(low), first, last)


def ghost_page(session: Session, pose: NextPose, names: tuple[str, str]) -> bytes:
    """Draw the robot where it stands, and as a ghost at the next pose.

    Args:
        session: The session.
        pose: The next pose.
        names: What the robot and the ghost are called.

    Returns:
        The page.
    """
    robot = session.robot
    stops = session.stops
    now = stops[-1].row.joints if stops else pose.joints
    q = np.stack([now, pose.joints])
    target = np.eye(4)
    if session.cell.target is not None:
        target[:3, 3] = session.cell.target
    visuals, _ = read_visuals(robot.urdf)
    ghost = PosedRobot.of(robot, q, visuals, chain_bases(robot, q, None), target)
    colour = int(CALIBRATED[1:], 16)

    def draw(group: meshcat.Visualizer, size: float) -> list[LegendEntry]:
        """Draw the ghost."""
        material = mc.MeshPhongMaterial(color=colour, transparent=True, opacity=0.45)
        draw_robot(group["ghost"], ghost, 1, material, 0.008 * size)
        return [LegendEntry(names[1], CALIBRATED, "ghost")]

    if not stops:  # nobody knows where the robot stands
        alone = View(
            robot,
            None,
            q[1:],
            labels=names[1:],
            nominal_target=target,
            title=names[1],
            names=((names[1], ""),),
        )
        return view_page(alone).html
    view = View(
        robot, None, q, labels=names, nominal_target=target, title=names[1], names=((names[0], ""),)
    )
    return view_page(view, about=About(draw=draw)).html
