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

#: Mistakes and findings in a few words, the same for what is wrong in truth and for what the session says.
_TERMS = {
    GROSS: "far off",
    SWAPPED: "swapped",
    REPEATED: "earlier reading once more",
    MISSED: "of another pose, one late",
    TARGET_MOVED: "target moved",
    BASE_MOVED: "base or instrument moved",
    NOT_THERE: "of another pose",
    "something_moved": "something moved",
}


def legend() -> str:
    """Return what the columns of `stop_line` mean."""
    return fill(
        "residual: how far the reading is from what was expected; error: expected error of the calibrated robot in mm, "
        "at most, with 95 %; said: what the session says of the stop, in brackets what is wrong in truth."
    )


def heading(robot: Robot) -> str:
    """Return the heads of the columns of `stop_line`."""
    slides = [joint.type == "prismatic" for joint in robot.inputs]
    unit = "mm" if all(slides) else "deg, mm" if any(slides) else "deg"
    joints = f"joint values [{unit}]".ljust(_JOINT * len(slides) + 1)
    return (
        f"{'stop':>{_STOP}}  {joints}{'residual':>{_RESIDUAL}}{'error':>{_ERROR}}  said"
    ).rstrip()


def stop_line(robot: Robot, stop: VirtualStop) -> str:
    """Return a stop in a line: number, joint values, residual, expected error [mm], what is said, and the truth.

    What has no room is on a line of its own.
    """
    answer = stop.answer
    pose = "".join(
        f"{value:{_JOINT}.1f}" for value in _shown_joints(robot, stop.measurement.joints)
    )
    error = "-" if stop.high is None else mm(stop.high)
    figures = (
        f"{answer.stop:{_STOP}d}  {pose} {_residual(answer.residual):>{_RESIDUAL}}{error:>{_ERROR}}"
    )
    true = _true(stop.measurement)
    in_truth = f"(in truth: {true})" if true else ""
    lines = [figures]
    for words, gap in ((_said(answer), "  "), (in_truth, " ")):
        if len(lines[-1]) + len(gap) + len(words) <= WIDTH:
            lines[-1] = f"{lines[-1]}{gap}{words}".rstrip()
        else:
            lines.append(f"{' ' * _STOP}  {words}")
    return "\n".join(lines)


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
    """Word what the session says of a stop; an earlier stop that is meant is named."""
    findings = "; ".join(_finding(finding, answer.stop) for finding in answer.findings)
    if answer.outcome == "again":
        return f"again: {findings}" if findings else "again"
    outcome = "good" if answer.outcome == "good" else ""
    return "; ".join(filter(None, (outcome, findings)))


def _finding(finding: Finding, stop: int) -> str:
    """Word a finding at a stop: ``of another pose, elbow_joint``, or of an earlier one, ``stop 1: far off``."""
    words = _TERMS[finding.code]
    if finding.name:
        words = f"{words}, {finding.name}"
    first = min(finding.stops, default=stop)
    if first == stop:
        return words
    if finding.code.endswith("moved"):
        return f"{words} since stop {first}"
    return f"stop {first}: {words}"


def _true(measurement: Measurement) -> str:
    """Word the mistake that a stop has in truth; empty without one, and after something was knocked."""
    mistake = measurement.mistake
    is_knock = mistake is not None and mistake.code in (TARGET_MOVED, BASE_MOVED)
    if mistake is None or (is_knock and mistake.since < measurement.number):
        return ""
    words = _TERMS[mistake.code]
    if mistake.code == MISSED:
        words = f"{words} since stop {mistake.since}"
    elif mistake.code in (SWAPPED, NOT_THERE, BASE_MOVED):
        words = f"{words}, {mistake.name}" if mistake.name else words
    size = f"{mm(mistake.size, 1)} mm" if mistake.size else f"{np.degrees(mistake.turn):.2f} deg"
    return f"{words}, {size}"
