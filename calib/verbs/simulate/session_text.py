"""A session with a virtual operator as text, for `calib simulate --session`: a line a stop, then the result."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from calib.basics.arrays import Array
from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.units import UNITS
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.show.lines import WIDTH, fill, mm, plural
from calib.verbs.measure.state import State
from calib.verbs.measure.stop import Answer, Finding
from calib.verbs.simulate.operator import (
    BASE_MOVED,
    GROSS,
    MISSED,
    NOT_THERE,
    REPEATED,
    SWAPPED,
    TARGET_MOVED,
    Measurement,
)
from calib.verbs.simulate.virtual_session import VirtualStop

#: Columns of a joint value.
_JOINT = 7

#: Columns of a stop's number, of a residual with its unit, and of an expected error.
_STOP, _RESIDUAL, _ERROR = 4, 10, 9

#: What the operator did, in a few words.
_DONE = {
    GROSS: "the reading is far off",
    SWAPPED: "taken for each other",
    REPEATED: "the reading before once more",
    MISSED: "one pose late since stop {since}",
    TARGET_MOVED: "the target is knocked",
    BASE_MOVED: "the {name} is knocked",
    NOT_THERE: "the robot is not there",
}

#: What the session says of it.
_SAID = {
    "gross": "far off",
    "swapped": "swapped",
    "repeated": "that of an earlier stop",
    "not_there": "of another pose",
    "target_moved": "the target has moved",
    "base_moved": "base or instrument has moved",
    "something_moved": "something has moved",
}


def heading(robot: Robot) -> str:
    """Return the heads of the columns of `stop_line`."""
    slides = [joint.type == "prismatic" for joint in robot.inputs]
    unit = "mm" if all(slides) else "deg, mm" if any(slides) else "deg"
    joints = f"joint values [{unit}]".ljust(_JOINT * len(slides) + 1)
    return (
        f"{'stop':>{_STOP}}  {joints}{'residual':>{_RESIDUAL}}{'error':>{_ERROR}}  what is said"
    ).rstrip()


def stop_line(robot: Robot, stop: VirtualStop) -> str:
    """Return a stop in a line: number, joint values, residual, expected error [mm], what is said, and the truth.

    The truth is on a line of its own if there is no room.
    """
    answer = stop.answer
    pose = "".join(
        f"{value:{_JOINT}.1f}" for value in _shown_joints(robot, stop.measurement.joints)
    )
    error = "-" if stop.high is None else mm(stop.high)
    figures = (
        f"{answer.stop:{_STOP}d}  {pose} {_residual(answer.residual):>{_RESIDUAL}}{error:>{_ERROR}}"
    )
    line = f"{figures}  {_said(answer)}".rstrip()
    true = _true(stop.measurement)
    if not true:
        return line
    in_truth = f"(in truth: {true})"
    if len(line) + 1 + len(in_truth) <= WIDTH:
        return f"{line} {in_truth}"
    return f"{line}\n{' ' * _STOP}  {in_truth}"


def result_lines(state: State, result: Calibration, nominal: float, true: float) -> Iterator[str]:
    """Yield what the session ends with: expected error and aim, the true error, and the verdict.

    Args:
        state: The session's state.
        result: Its calibration.
        nominal: True error of the nominal robot, rms over the joint ranges [m].
        true: True error of the calibrated one [m].
    """
    reached = "reached" if state.reached else "not reached"
    if state.error is not None and state.high is not None:
        yield fill(
            f"Expected error {mm(state.error)} mm, at most {mm(state.high)} mm with 95 %; the aim of {mm(state.aim)} "
            f"mm is {reached} after {plural(state.stops, 'pose')}."
        )
    else:
        yield fill(
            f"The aim of {mm(state.aim)} mm is {reached}: {plural(state.stops, 'pose')} tell too little."
        )
    met = "within" if true <= state.aim else "above"
    yield fill(
        f"True error {mm(true)} mm rms over the joint ranges, {met} the aim; that of the nominal robot "
        f"{mm(nominal)} mm."
    )
    if result.verdict is not None:
        yield f"Verdict: {result.verdict.use}"


def _shown_joints(robot: Robot, joints: Array) -> list[float]:
    """Return joint values in degrees, those of sliding joints in millimetres."""
    units = ["mm" if joint.type == "prismatic" else "deg" for joint in robot.inputs]
    return [value / UNITS[unit].to_si for value, unit in zip(joints.tolist(), units, strict=True)]


def _residual(residual: Mapping[str, float]) -> str:
    """Word a residual in the first of its units; a dash if nothing was expected."""
    for symbol, unit in RESIDUAL_UNITS.items():
        if symbol in residual:
            return f"{unit.to_shown * residual[symbol]:.3g} {unit.shown}"
    return "-"


def _said(answer: Answer) -> str:
    """Word what the session says of a stop."""
    findings = "; ".join(_finding(finding) for finding in answer.findings)
    if answer.outcome == "again":
        return f"again: {findings}" if findings else "again"
    return findings or ("good" if answer.outcome == "good" else "")


def _finding(finding: Finding) -> str:
    """Word a finding: ``of another pose, elbow_joint``."""
    words = _SAID[finding.code]
    return f"{words}, {finding.name}" if finding.name else words


def _true(measurement: Measurement) -> str:
    """Word the mistake that a stop has in truth; empty without one, and after something was knocked."""
    mistake = measurement.mistake
    is_knock = mistake is not None and mistake.code in (TARGET_MOVED, BASE_MOVED)
    if mistake is None or (is_knock and mistake.since < measurement.number):
        return ""
    words = _DONE[mistake.code].format(since=mistake.since, name=mistake.name)
    size = f"{mm(mistake.size, 1)} mm" if mistake.size else f"{np.degrees(mistake.turn):.2f} deg"
    return f"{words}, {size}"
