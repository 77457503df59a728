"""compare: two calibrations of one robot side by side, and whether the robot drifted between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.errors import ModelError, choices
from calib.identify.displacement import Compensated, Move, unknown_frame
from calib.identify.drift import DriftTest, drift_test, own_names
from calib.identify.result import Calibration
from calib.identify.result_file import read_result
from calib.identify.verdict import NO
from calib.measure.measurements import Measurements
from calib.model.readback import spread_between, spread_poses
from calib.model.robot import Robot, rigid_inverse

Array = NDArray[np.float64]

#: What a comparison says.
DRIFT, NO_DRIFT, CANNOT_TELL = "drift", "no drift shown", "cannot tell"

#: Why it cannot be told, see `Comparison.why`.
SAME_DATA, BAD_VERDICT, NOTHING_KNOWN, OTHER_ERRORS = (
    "same data",
    "bad verdict",
    "nothing known",
    "other errors",
)

#: Joint values over which moves are told.
_POSES = 200

#: Origins that differ by less than this are the same [m; rotation matrices: 1].
_SAME = 1e-9

#: Joints are held at the same value within this [rad, m].
_HELD = 1e-9

#: What a model lacks shows in what it leaves over on its own rows: a move this many times as far has another cause.
_FAR = 3.0


@dataclass(frozen=True, slots=True)
class ParameterDifference:
    """One of the robot's parameters in both results, in its unit; NaN where a result has it not.

    Attributes:
        name: Such as ``"a2"``.
        unit: Of all numbers but ``sigmas``.
        a: Value in the first result.
        b: Value in the second.
        difference: b less a; NaN where they count from different nominal robots.
        std: sqrt(C_a + C_b) of this parameter; NaN at a bound.
        sigmas: ``difference / std``.
        alone: Whether both data determine it by itself; otherwise priors share out what they know in combinations.
    """

    name: str
    unit: str
    a: float
    b: float
    difference: float
    std: float
    sigmas: float
    alone: bool


@dataclass(frozen=True, slots=True)
class PlaceDifference:
    """How a frame or a target moved.

    Attributes:
        name: Of the set-up or target; empty for the only one.
        found: Whether it was estimated in either result.
        shift: How far the tracker (or socket, or plane) stands elsewhere in the base, or the target in the tip [m].
        turn: By what angle it is turned [rad]; NaN for a target whose orientation is not known.
    """

    name: str
    found: bool
    shift: float
    turn: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Comparison:
    """The result of `compare`.

    Attributes:
        a: The first result.
        b: The second.
        names: What they are called: their files, or ``"a"`` and ``"b"``.
        outcome: ``"drift"``, ``"no drift shown"`` or ``"cannot tell"``.
        why: Why nothing can be told; empty otherwise.
        test: The test of the difference.
        moves: How far the target lies elsewhere: over the joint values that both data cover, then over the limits.
        parameters: The robot's own, of either result.
        untold: Parameters that frame and target make up for, so that their drift cannot be told.
        only_a: Parameters of the first that move the target in ways that the second's cannot.
        only_b: The other way round.
        frames: How set-ups of the same name moved.
        targets: How targets of the same name moved.
        same_start: Whether both count from the same nominal robot.
        robot: The robot whose meshes are shown.
    """

    a: Calibration
    b: Calibration
    names: tuple[str, str]
    outcome: str
    why: str
    test: DriftTest
    moves: tuple[Move, Move]
    parameters: tuple[ParameterDifference, ...]
    untold: tuple[str, ...]
    only_a: tuple[str, ...]
    only_b: tuple[str, ...]
    frames: tuple[PlaceDifference, ...]
    targets: tuple[PlaceDifference, ...]
    same_start: bool
    robot: Robot

    def __repr__(self) -> str:
        """In one line."""
        first, second = self.names
        return f"Comparison({first!r}, {second!r}, {self.outcome}, p = {self.test.p:.2g})"

    @property
    def robots(self) -> tuple[Robot, Robot]:
        """The robot as the first result has it, and as the second has it."""
        return self.a.corrected(self.robot), self.b.corrected(self.robot)


def compare(
    a: Calibration | str | Path,
    b: Calibration | str | Path,
    robot: Robot | str | Path | None = None,
) -> Comparison:
    """Compare two calibrations of one robot: did it drift?

    Args:
        a: The first: a `Calibration`, or the path of a result file.
        b: The second, made of other measurements.
        robot: The robot, or its URDF, nominal or corrected, to show with its meshes; None: the one in the first result.

    Raises:
        FileError: A file cannot be read or is no result.
        ModelError: The results are of different chains, or the robot is another one.
        UrdfError: The URDF cannot be read, or lacks a joint.
    """
    first, second = (one if isinstance(one, Calibration) else read_result(one) for one in (a, b))
    names = tuple(
        letter if isinstance(one, Calibration) else Path(one).name
        for letter, one in (("a", a), ("b", b))
    )
    _check_same_chain(first, second, names)
    shown = _shown(first, robot)
    same = _same_start(first, second)
    alike = (
        same
        and own_names(first) == own_names(second)
        and dict(first.ties) == dict(second.ties)
        and first.model.name == second.model.name
    )
    covered = spread_between(_covered(first.ranges, second.ranges), _POSES)
    both = Compensated.of(first, second, covered, same_start=same)
    pair = both.pair(alike=alike)
    test = drift_test(both.difference(pair), pair, both.floor)
    moves = (
        both.move("the joint values that both measured", None, pair),
        both.move("the joint limits", spread_poses(first.nominal, _POSES), pair),
    )
    only = both.alone(0), both.alone(1)
    why = _why_not(first, second, test, differ=any(only), moved=moves[0].moved)
    return Comparison(
        a=first,
        b=second,
        names=(names[0], names[1]),
        outcome=CANNOT_TELL if why else DRIFT if test.drifted else NO_DRIFT,
        why=why,
        test=test,
        moves=moves,
        parameters=_parameters(first, second, same_start=same),
        untold=both.untold(),
        only_a=only[0],
        only_b=only[1],
        frames=_frames(first, second),
        targets=_targets(first, second),
        same_start=same,
        robot=shown,
    )


def _check_same_chain(a: Calibration, b: Calibration, names: Sequence[str]) -> None:
    """Refuse results of different chains.

    Raises:
        ModelError: Base, tip, joints, held values or the joints that carry placements differ.
    """
    r, s = a.nominal, b.nominal
    for what, first, second in (
        ("Base", f"'{r.base}'", f"'{s.base}'"),
        ("Tip", f"'{r.tip}'", f"'{s.tip}'"),
        ("Joints", choices(r.joint_names), choices(s.joint_names)),
        ("Joints with placements", choices(r.origins()), choices(s.origins())),
        ("Held joints", choices(r.held) or "none", choices(s.held) or "none"),
    ):
        if first != second:
            raise ModelError(
                f"{names[0]} and {names[1]} are not of one chain. {what}: {first} in {names[0]}, {second} in "
                f"{names[1]}. Fit both with the same --base, --tip and --hold."
            )
    moved = [name for name, value in r.held.items() if abs(value - s.held[name]) > _HELD]
    if moved:
        raise ModelError(
            f"{choices(moved)} was held at {r.held[moved[0]]:g} in {names[0]} and at {s.held[moved[0]]:g} in "
            f"{names[1]}, so that the chains differ. Compare results of the same --hold."
        )


def _shown(a: Calibration, given: Robot | str | Path | None) -> Robot:
    """The robot to show.

    Raises:
        ModelError: Another robot was given.
        UrdfError: Its URDF cannot be read or lacks a link or joint.
    """
    own = a.nominal
    if given is None:
        return own
    robot = (
        given.rebuilt(base=own.base, tip=own.tip)
        if isinstance(given, Robot)
        else Robot.load(given, own.base, own.tip, held=own.held)
    )
    if robot.joint_names != own.joint_names or set(robot.origins()) != set(own.origins()):
        raise ModelError(
            f"The robot given has the joints {choices(robot.joint_names)} between '{own.base}' and '{own.tip}'; "
            f"the results are of {choices(own.joint_names)}. Give the URDF that they were made with."
        )
    return robot


def _same_start(a: Calibration, b: Calibration) -> bool:
    """Whether both count from the same nominal origins."""
    first, second = a.nominal.origins(), b.nominal.origins()
    return all(np.abs(T - second[name]).max() < _SAME for name, T in first.items())


def _covered(a: Array, b: Array) -> Array:
    """The range of each joint that both data cover, or that either does where that is none, shape (m, 2)."""
    low, high = np.fmax(a[:, 0], b[:, 0]), np.fmin(a[:, 1], b[:, 1])
    apart = ~(low < high)
    low = np.where(apart, np.fmin(a[:, 0], b[:, 0]), low)
    high = np.where(apart, np.fmax(a[:, 1], b[:, 1]), high)
    found = np.stack([low, high], axis=1)
    return np.where(np.isfinite(found), found, 0.0)


def _why_not(a: Calibration, b: Calibration, test: DriftTest, *, differ: bool, moved: float) -> str:
    """Why it cannot be told whether the robot drifted; empty where it can.

    Args:
        a: One result.
        b: The other.
        test: The test of their difference.
        differ: Whether either has errors of a kind that the other's model has not.
        moved: How far the target moved, rms, without the noise's part [m].
    """
    if _same_data(a, b):
        return SAME_DATA
    if any(one.verdict is not None and one.verdict.use == NO for one in (a, b)):
        return BAD_VERDICT
    if test.combinations == 0:
        return NOTHING_KNOWN
    left_over = max(one.errors["calibrated"]["estimation"].rms for one in (a, b))
    if differ and test.drifted and not moved > _FAR * left_over:
        return OTHER_ERRORS
    return ""


def _same_data(a: Calibration, b: Calibration) -> bool:
    """Whether both results are made of the same measurements."""
    if a.source.sha256 or b.source.sha256 or a.fit is None or b.fit is None:
        return bool(a.source.sha256) and a.source.sha256 == b.source.sha256
    first, second = (_measured(one.fit.measurements) for one in (a, b) if one.fit is not None)
    return all(np.array_equal(x, y, equal_nan=True) for x, y in zip(first, second, strict=True))


def _measured(m: Measurements) -> tuple[Array, ...]:
    """The numbers that tell measurements without a file from others."""
    nothing: Array = np.zeros(0)
    return m.joints, m.points, nothing if m.distances is None else m.distances


def _parameters(
    a: Calibration, b: Calibration, *, same_start: bool
) -> tuple[ParameterDifference, ...]:
    """The robot's own parameters of either result, those of the first first."""
    nan = float("nan")
    result = []
    for name in dict.fromkeys((*own_names(a), *own_names(b))):
        both = [one.parameters[one.model.index(name)] for one in (a, b) if name in one.model.names]
        known = len(both) == 2
        difference = both[1].delta - both[0].delta if known and same_start else nan
        std = float(np.hypot(both[0].std, both[1].std)) if known else nan
        result.append(
            ParameterDifference(
                name=name,
                unit=both[0].unit,
                a=both[0].value if name in a.model.names else nan,
                b=both[-1].value if name in b.model.names else nan,
                difference=difference,
                std=std,
                sigmas=difference / std if std > 0.0 else nan,
                alone=all(one.identifiable for one in both),
            )
        )
    return tuple(result)


def _frames(a: Calibration, b: Calibration) -> tuple[PlaceDifference, ...]:
    """How set-ups of the same name moved: as seen from the base."""
    found = bool(unknown_frame(a) or unknown_frame(b))
    s, t = a.setup, b.setup
    return tuple(
        PlaceDifference(name, found, *_moved(rigid_inverse(T), rigid_inverse(U)))
        for name, T, U in _pairs((s.groups, s.T_frame_base), (t.groups, t.T_frame_base))
    )


def _targets(a: Calibration, b: Calibration) -> tuple[PlaceDifference, ...]:
    """How targets of the same name moved in the tip."""
    s, t = a.setup, b.setup
    found, result = s.estimate_target or t.estimate_target, []
    for name, T, U in _pairs((s.targets, s.T_tip_target), (t.targets, t.T_tip_target)):
        shift, turn = _moved(T, U)
        known = s.oriented and t.oriented
        result.append(PlaceDifference(name, found, shift, turn if known else float("nan")))
    return tuple(result)


def _pairs(
    first: tuple[tuple[str, ...], Array], second: tuple[tuple[str, ...], Array]
) -> list[tuple[str, Array, Array]]:
    """Poses of the same name; the only one of each, whatever their names."""
    (names, poses), (others, of_other) = first, second
    if len(names) == len(others) == 1:
        return [(names[0] if names == others else "", poses[0], of_other[0])]
    known = dict(zip(others, of_other, strict=True))
    return [(n, T, known[n]) for n, T in zip(names, poses, strict=True) if n in known]


def _moved(T: Array, U: Array) -> tuple[float, float]:
    """Distance and angle between two poses, [m] and [rad]."""
    turn = Rotation.from_matrix(T[:3, :3].T @ U[:3, :3]).magnitude()
    return float(np.linalg.norm(U[:3, 3] - T[:3, 3])), float(turn)
