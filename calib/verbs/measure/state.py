"""The state of a session, and what it proposes: what is known, how much is still needed, and what would help."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.basics.arrays import Array
from calib.basics.values import Value, keep_read_only
from calib.model.error_model import FRAME, TARGET
from calib.verbs.measure.course import Course, CurvePoint
from calib.verbs.measure.lost_motion import find_lost_motion
from calib.verbs.measure.running_fit import RunningFit
from calib.verbs.measure.stop import Finding

#: Why a pose is next: it tells most (``"information"``), the last stop is to be measured again (``"again"``), or an
#: earlier one that is far off by now (``"outlier"``).
Why = Literal["information", "again", "outlier"]

#: What would help: to know a joint (``"joint"``), poses in a part of space (``"region"``), a second target
#: (``"second_target"``), a known length (``"length"``), a closer look at an instrument that is noisier than it is
#: stated (``"noise"``), a model with lost motion, which a joint has (``"lost_motion"``).
AdviceCode = Literal["joint", "region", "second_target", "length", "noise", "lost_motion"]

#: A joint whose errors make this share of the expected square is named.
_MUCH = 0.4

#: A part of space where the expected error is so many times the mean is named.
_WORSE = 1.5

#: Degrees of freedom of the residuals from which on the noise is known.
_ENOUGH_FREEDOM = 10.0

#: An instrument that is so many times as noisy as stated is named.
_NOISY = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class NextPose(Value):
    """The pose to measure next."""

    #: Shape (m,), joint values [rad] or [m], columns as ``robot.joint_names``
    joints: Array
    #: Shape (m,), where to drive before it, so that every joint arrives from the right side; None: straight
    via: Array | None
    #: Shape (k, 3), where each target will be in the measurement frame, or in the base if that is not known [m]
    expected: Array
    #: Names of these targets
    targets: tuple[str, ...]
    #: Expected error with it measured, below which 95 % of calibrations are [m]; None: not known yet
    error: float | None
    #: Why it is next
    why: Why
    #: Number of the stop that it repeats; None: it is a new one
    stop: int | None
    #: Largest move of a joint from the last stop [rad] or [m]; 0 at the first
    travel: float


@dataclass(frozen=True, slots=True, eq=False)
class Advice(Value):
    """A hint at a measurement that would help."""

    #: What
    code: AdviceCode
    #: Numbers in SI units by name
    values: Mapping[str, float]
    #: Joint or target that is meant; empty without
    name: str = ""

    def __post_init__(self) -> None:
        """Keep a read-only copy of the mapping."""
        keep_read_only(self, "values")


@dataclass(frozen=True, slots=True, eq=False)
class State(Value):
    """The state of knowledge after the stops so far."""

    #: Number of stops that count
    stops: int
    #: Number of stops that were measured, also those that do not count
    measured: int
    #: Expected error of the calibrated robot, rms over the region of the aim [m]; None: not known yet
    error: float | None
    #: 5 % of calibrations are better [m]
    low: float | None
    #: 95 % of calibrations are better [m]: the aim is reached when it is within the aim
    high: float | None
    #: The aim [m]
    aim: float
    #: Error of the nominal robot there, as the fit so far finds it [m]; None: not known yet
    nominal: float | None
    #: Whether the aim is reached
    reached: bool
    #: Least and largest number of poses that are still needed; None: more than a session looks ahead
    needed: tuple[int, int] | None
    #: Expected error by the number of stops
    curve: tuple[CurvePoint, ...]
    #: What would help
    advice: tuple[Advice, ...]
    #: What is open: stops that are far off, and what has moved
    findings: tuple[Finding, ...]
    #: Estimated noise of one scalar by unit [m], [rad], [px]
    sigma: Mapping[str, float]

    def __post_init__(self) -> None:
        """Keep a read-only copy of the mapping."""
        keep_read_only(self, "sigma")


def state_of(course: Course) -> State:
    """Return the state of a session's course."""
    expected = course.expected
    estimate = None if course.fit is None else course.fit.fitted.estimate
    return State(
        stops=len(course.counted),
        measured=len(course.stops),
        error=None if expected is None else expected.error,
        low=None if expected is None else expected.low,
        high=None if expected is None else expected.high,
        aim=course.aim,
        nominal=_nominal(course),
        reached=course.reached,
        needed=_needed(course),
        curve=course.curve,
        advice=() if expected is None else tuple(_advice(course)),
        findings=tuple(_open_findings(course)),
        sigma={} if estimate is None else estimate.sigma,
    )


def _nominal(course: Course) -> float | None:
    """Return the error of the nominal robot over the region, with frame and target as they fit it best [m]."""
    fit = course.fit
    if fit is None:
        return None
    model = course.design.sensitivity.kinematics.model
    B = course.design.workspace.mean_square
    found = dict(zip(fit.fitted.kinematics.model.names, fit.fitted.estimate.x, strict=True))
    of_setup = np.array(
        [p.place.startswith((FRAME, TARGET)) or p.internal is not None for p in model.parameters]
    )
    x = np.array(
        [0.0 if s else found.get(name, 0.0) for s, name in zip(of_setup, model.names, strict=True)]
    )
    # What frames and targets take up of it is no error of the robot.
    cross, own = B[of_setup] @ x, B[np.ix_(of_setup, of_setup)]
    taken = cross @ np.linalg.pinv(own, hermitian=True) @ cross if of_setup.any() else 0.0
    return float(np.sqrt(max(x @ B @ x - taken, 0.0)))


def _needed(course: Course) -> tuple[int, int] | None:
    """Return how many poses are still needed, at least and at most, as far as the noise is known."""
    if course.reached:
        return 0, 0
    choice = course.choice
    if choice is None or choice.expected.high > course.aim:
        return None
    ahead = len(choice.design)
    freedom = course.known.freedom
    # The number of poses goes with the square of the noise, whose standard error is that of a chi-square.
    spread = 0.0 if not np.isfinite(freedom) else np.sqrt(2.0 / max(freedom, 2.0))
    total = ahead + len(course.counted)
    return max(1, int(np.floor(ahead - spread * total))), int(np.ceil(ahead + spread * total))


def _open_findings(course: Course) -> Iterator[Finding]:
    """Yield what has moved, and the stops that are far off by now, though they were accepted."""
    for broken in course.breaks:
        since = tuple(stop.number for stop in course.counted if stop.number >= broken.stop)
        yield Finding(broken.code, since, name=broken.target or broken.station or "")
    later = [s.number for s in course.stops if not s.counts and s.answer.outcome != "again"]
    for number in sorted({*later, *course.outliers}):
        yield Finding("gross", (number,))


def _advice(course: Course) -> Iterator[Advice]:
    """Yield what would help to know more."""
    design, known = course.design, course.known
    sensitivity = design.sensitivity
    model = sensitivity.kinematics.model
    C = np.asarray(np.linalg.inv(known.total), dtype=np.float64)
    B = design.workspace.mean_square
    total = float(np.trace(C @ B))
    best, name = 0.0, ""
    for joint in sensitivity.kinematics.robot.joint_names:
        of_joint = np.array([p.place == joint for p in model.parameters])
        if not of_joint.any():
            continue
        cross, own = C[:, of_joint], C[np.ix_(of_joint, of_joint)]
        without = C - cross @ np.linalg.solve(own, cross.T)
        share = 1.0 - float(np.trace(without @ B)) / total
        if share > best:
            best, name = share, joint
    if best > _MUCH:
        yield Advice("joint", {"share": best}, name)
    yield from _worst_region(course, C, total)
    instrument = sensitivity.instrument
    if instrument.kind.name == "point" and len(sensitivity.setup.targets) == 1:
        yield Advice("second_target", {})
    if "px" in instrument.kind.units and any(n.startswith("board_scale") for n in model.names):
        scale = [k for k, n in enumerate(model.names) if n.startswith("board_scale")]
        cross, own = C[:, scale], C[np.ix_(scale, scale)]
        share = 1.0 - float(np.trace((C - cross @ np.linalg.solve(own, cross.T)) @ B)) / total
        if share > _MUCH:
            yield Advice("length", {"share": share})
    lost = None if course.fit is None else find_lost_motion(course.fit, course.history.factor)
    if lost is not None:
        joint, change = lost
        yield Advice("lost_motion", {"change": change}, joint)
    noise = float(np.max(known.noise))
    if noise > _NOISY and course.fit is not None and _is_told(course.fit):
        yield Advice("noise", {"factor": noise})


def _is_told(fit: RunningFit) -> bool:
    """Return whether the residuals tell the noise from errors of the robot."""
    return fit.fitted.estimate.freedom >= _ENOUGH_FREEDOM


def _worst_region(course: Course, C: Array, total: float) -> Iterator[Advice]:
    """Yield the middle of the eighth of the region where the expected error is largest, if it is much larger there."""
    pool, located = course.design.ground.pool, course.design.workspace.located
    poses = pool.workspace[: len(located)]
    square = np.einsum("nip,pq,niq->n", located, C, located)
    square = square / (located.shape[1] // 3)
    places = course.design.sensitivity.expected(poses)[:, 0]
    middle = np.median(places, axis=0)
    octant = (places > middle) @ np.array([1, 2, 4])
    means = np.array([square[octant == k].mean() if np.any(octant == k) else 0.0 for k in range(8)])
    worst = int(np.argmax(means))
    if means[worst] > _WORSE**2 * total:
        x, y, z = places[octant == worst].mean(axis=0).tolist()
        ratio = float(np.sqrt(means[worst] / total))
        yield Advice("region", {"x_m": x, "y_m": y, "z_m": z, "ratio": ratio})
