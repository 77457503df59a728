"""A session with a virtual operator, from the first pose to the calibration, and how accurate that is in truth."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array, read_only
from calib.basics.values import Value
from calib.data.cell import Cell
from calib.errors import CalibError
from calib.numerics.errors import rms
from calib.robot.ranges import spread_between
from calib.verbs.measure.session import Session
from calib.verbs.measure.state import NextPose
from calib.verbs.measure.stop import Answer, Row
from calib.verbs.plan.choice import PlanRequest
from calib.verbs.plan.pose_candidates import planning_ranges
from calib.verbs.simulate.operator import Measurement, Operator
from calib.verbs.simulate.random_streams import stream
from calib.verbs.simulate.scenario import VirtualCell

#: How well a person states where a camera and a board are, along and about each axis [m], [rad].
_TAPE, _EYE = 10e-3, float(np.deg2rad(1.0))


@dataclass(frozen=True, slots=True, eq=False)
class VirtualStop(Value):
    """One pose of a session, what the operator measured there, and what the session said to it."""

    #: The pose, as the session proposed it.
    proposed: NextPose
    #: What was measured, and what is wrong with it in truth.
    measurement: Measurement
    #: The answer of the session.
    answer: Answer
    #: Expected error after it, of which 95 % of calibrations are better [m]; None: not known yet.
    high: float | None
    #: Time that the session took to propose it, and for its answer with the state [s].
    seconds: tuple[float, float]


def known_cell(virtual: VirtualCell, seed: int) -> Cell:
    """Return what a person knows of a virtual cell before anything is measured.

    That is what the scenario states. Of a camera and a board it is also their description, and where they are to a
    centimetre and a degree, which is where the session looks for poses.

    Args:
        virtual: The cell.
        seed: Of what the person states wrongly.

    Raises:
        CalibError: Several cameras or boards.
    """
    cell, equipment, truth = virtual.scenario.cell, virtual.equipment, virtual.truth
    if equipment is None:
        return cell
    if len(equipment.cameras) > 1 or len(equipment.prints) > 1:
        raise CalibError("A virtual session is measured with one camera and one board.")
    rng = stream(seed, "mistakes")
    frame, target = truth.T_frame_base[0], truth.T_tip_target[0]
    if cell.T_frame_base is None:
        frame = frame @ _wrongly_stated(rng)
    if cell.target is None:
        target = target @ _wrongly_stated(rng)
    return replace(
        cell,
        cameras=cell.cameras or {"": equipment.stated},
        boards=cell.boards or {"": equipment.printed.board},
        T_frame_base=read_only(frame),
        estimate_frame=True,
        target=read_only(target[:3, 3]),
        target_rotation=read_only(target[:3, :3]),
    )


def measure_with(session: Session, operator: Operator, most: int) -> Iterator[VirtualStop]:
    """Measure what a session proposes, until it is enough.

    A pose that the session asks for again is measured again, carefully; one at which the camera does not see the board
    is skipped.

    Args:
        session: The session, which goes on where it is.
        operator: Who measures.
        most: The most stops of the session, those that are measured again among them.

    Yields:
        Each stop, also those that do not count.
    """
    state = session.state
    while state.measured < most and not state.reached:
        began = time.perf_counter()
        proposed = session.next()
        proposing = time.perf_counter() - began
        if proposed is None:
            return
        again = proposed.why == "again"
        try:
            measurement = operator.measure(proposed.joints, again=again, via=proposed.via)
        except CalibError as error:
            session.skip(str(error))
            continue
        moves = None if proposed.via is None else proposed.joints - proposed.via
        began = time.perf_counter()
        answer = session.add(Row(measurement.joints, measurement.readings, moves))
        state = session.state
        seconds = (proposing, time.perf_counter() - began)
        yield VirtualStop(proposed, measurement, answer, state.high, seconds)


def everywhere(virtual: VirtualCell, count: int = 1500) -> Array:
    """Return poses all over the joint ranges that a plan keeps to, for `true_error`, shape (count, m), [rad] or [m]."""
    robot, ranges = virtual.truth.nominal, virtual.scenario.cell.ranges
    values = spread_between(planning_ranges(robot, ranges, PlanRequest().margin), count)
    return read_only(robot.readings(values))


def true_error(virtual: VirtualCell, q: Array, predicted: Array) -> float:
    """Return how far a calibrated robot has the first target from where it is, rms over poses [m].

    Both positions are in the first measurement frame; of a board it is that of its middle.

    Args:
        virtual: The cell as it is.
        q: Joint values, shape (N, m), [rad] or [m].
        predicted: T_frame_target there by the calibrated robot, shape (N, 4, 4) [m].
    """
    point = np.array([0.0, 0.0, 0.0, 1.0])
    if virtual.equipment is not None:
        point[:3] = virtual.equipment.printed.board.centre
    difference = (predicted - virtual.truth.poses(q)) @ point
    return rms(np.linalg.norm(difference[:, :3], axis=1))


def _wrongly_stated(rng: np.random.Generator) -> Array:
    """Draw the displacement between where something is and where a person says that it is, shape (4, 4) [m]."""
    displacement = np.eye(4)
    displacement[:3, :3] = pin.exp3(_EYE * rng.standard_normal(3))
    displacement[:3, 3] = _TAPE * rng.standard_normal(3)
    return displacement
