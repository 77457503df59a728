"""Virtual cells of tests of sessions, the readings of single stops, and all that a session shows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.robot.robot import Robot
from calib.verbs.measure.aim import Aim
from calib.verbs.measure.course import Course
from calib.verbs.measure.running_fit import RunningFit
from calib.verbs.measure.session import Session
from calib.verbs.measure.stop import Answer, Row
from calib.verbs.simulate.operator import Operator
from calib.verbs.simulate.scenario import Scenario, VirtualCell
from calib.verbs.simulate.virtual_session import known_cell

#: Noise of a coordinate [m], and of an orientation about an axis [rad].
LENGTH, ANGLE = 4e-5, 2e-4


def points_cell(model: str = "zeros", **entries: Any) -> Cell:
    """A tracker somewhere, which measures points; ``entries`` are those of the cell."""
    return Cell(**{"estimate_frame": True, "model": model, "sigma": {"m": LENGTH}, **entries})


def virtual_cell(robot: Robot, cell: Cell, seed: int = 3) -> VirtualCell:
    """A robot with errors of the cell's model, drawn by the seed."""
    return Scenario(robot, cell, cell.model if cell.model != "auto" else "placement").draw(seed)


def readings_at(virtual: VirtualCell, q: Sequence[Any], seed: int = 1) -> list[Measurements]:
    """Readings without mistakes, one table a pose."""
    operator = Operator.of(virtual, seed)
    return [operator.measure(pose).readings for pose in q]


def good_readings(virtual: VirtualCell, count: int, seed: int = 1) -> list[Measurements]:
    """Readings without mistakes at random poses, one table a pose."""
    return readings_at(virtual, [*virtual.poses(count, seed)], seed)


def fit_of(virtual: VirtualCell, tables: Sequence[Measurements]) -> RunningFit:
    """The fit to some stops."""
    fit = RunningFit.of(virtual.truth.nominal, known_cell(virtual, 1), tables)
    assert fit is not None
    return fit


def started(virtual: VirtualCell, folder: Path, aim: Aim | None = None, **options: Any) -> Session:
    """A session without stops."""
    return Session.start(
        folder,
        virtual.truth.nominal,
        known_cell(virtual, 1),
        aim or Aim(error=1e-4),
        **{"collisions": False, "seed": 1, **options},
    )


def measured(session: Session, operator: Operator, count: int) -> list[Answer]:
    """Answers to so many stops, measured where the session proposes them."""
    answers = []
    for _ in range(count):
        pose = session.next()
        assert pose is not None
        got = operator.measure(pose.joints, again=pose.why == "again", via=pose.via)
        answers.append(session.add(Row(got.joints, got.readings)))
    return answers


def with_rows(course: Course, tables: Sequence[Measurements]) -> Course:
    """The course with readings added, which nobody proposed."""
    for table in tables:
        course, _ = course.with_row(Row(table.joints[0], table), [])
    return course


def shown(session: Session) -> str:
    """All that a session shows, to the last bit."""
    state, pose = session.state, session.next()
    parts: list[object] = [
        state.stops,
        state.measured,
        state.error,
        state.low,
        state.high,
        state.aim,
        state.nominal,
        state.reached,
        state.needed,
        state.curve,
        [(a.code, dict(a.values), a.name) for a in state.advice],
        [(f.code, f.stops, dict(f.values), f.name) for f in state.findings],
        dict(state.sigma),
    ]
    if pose is not None:
        arrays = [None if a is None else a.tolist() for a in (pose.joints, pose.via, pose.expected)]
        parts += [arrays, pose.targets, pose.error, pose.why, pose.stop, pose.travel]
    for stop in session.stops:
        answer = stop.answer
        parts += [stop.number, stop.counts, answer.outcome, dict(answer.residual), answer.square]
        parts += [dict(answer.usual), answer.before, answer.after]
        parts += [stop.row.joints.tolist(), stop.row.readings.points.tolist()]
        parts += [(f.code, f.stops, dict(f.values), f.name) for f in answer.findings]
    return repr(parts)


def rms_of(values: Any) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
