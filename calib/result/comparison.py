"""compare: two calibrations of one robot side by side, and whether the robot drifted between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.errors import ModelError, choices
from calib.result.calibration import Calibration
from calib.result.calibration_file import read_result
from calib.result.drift import Compensated, DriftTest, Move, drift_test, own_names, unknown_frame
from calib.result.verdict import NO
from calib.robot.readback import spread_between, spread_poses
from calib.robot.robot import Robot, rigid_inverse

Array = NDArray[np.float64]

#: What a comparison says.
DRIFT, NO_DRIFT, CANNOT_TELL = "drift", "no drift shown", "cannot tell"

#: Why it cannot be told, see `Comparison.why`.
SAME_DATA, BAD_VERDICT = "same data", "bad verdict"
NOTHING_KNOWN, OTHER_ERRORS = "nothing known", "other errors"

#: Joint values over which moves are told.
_POSES = 200

#: Origins, and values of held joints, that differ by less than this are the same [m; rad; rotation matrices: 1].
_SAME = 1e-9

#: What a model lacks shows in what it leaves over on its own rows: a move this many times as far has another cause.
_FAR = 3.0


@dataclass(frozen=True, slots=True)
class ParameterDifference:
    """One of the robot's parameters in both results, in its unit; NaN where a result has it not.

    ``difference`` is b less a, NaN where they count from different nominal robots; ``std`` is sqrt(C_a + C_b), NaN at a
    bound, ``sigmas`` their ratio; ``alone`` says whether both data determine it by itself.
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
    """How far a frame stands elsewhere in the base, or a target in the tip, [m] and [rad].

    ``found`` says whether it was estimated in either result; the name is empty for the only one, and the turn NaN for
    a target whose orientation is not known.
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
        only_b: The same of the second.
        frames: How set-ups of the same name moved.
        targets: The same of targets.
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
        robot: The robot, or its URDF, nominal or corrected, to show with its meshes; None: that of the first result.

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
    shown = _shown(first.nominal, robot)
    origins = first.nominal.origins(), second.nominal.origins()
    same = all(np.abs(T - origins[1][name]).max() < _SAME for name, T in origins[0].items())
    alike = (
        same
        and own_names(first) == own_names(second)
        and dict(first.ties) == dict(second.ties)
        and first.model.name == second.model.name
    )
    covered = spread_between(_covered(first.ranges, second.ranges), _POSES)
    both = Compensated(first, second, covered, same_start=same)
    pair = both.pair(alike=alike)
    test = drift_test(both.difference(pair), pair, both.floor)
    moves = (
        both.move("the joint values that both measured", None, pair),
        both.move("the joint limits", spread_poses(first.nominal, _POSES), pair),
    )
    only = both.alone(0), both.alone(1)
    left_over = max(one.errors["calibrated"]["estimation"].rms for one in (first, second))
    why = ""
    if _same_data(first, second):
        why = SAME_DATA
    elif any(one.verdict is not None and one.verdict.use == NO for one in (first, second)):
        why = BAD_VERDICT
    elif test.combinations == 0:
        why = NOTHING_KNOWN
    elif any(only) and test.drifted and not moves[0].moved > _FAR * left_over:
        why = OTHER_ERRORS
    s, t = first.setup, second.setup
    found = bool(unknown_frame(first) or unknown_frame(second))
    frames = [
        dict(zip(one.groups, map(rigid_inverse, one.T_frame_base), strict=True)) for one in (s, t)
    ]
    targets = [dict(zip(one.targets, one.T_tip_target, strict=True)) for one in (s, t)]
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
        frames=_moved(*frames, found=found, oriented=True),
        targets=_moved(
            *targets,
            found=s.estimate_target or t.estimate_target,
            oriented=s.oriented and t.oriented,
        ),
        same_start=same,
        robot=shown,
    )


def _check_same_chain(a: Calibration, b: Calibration, names: Sequence[str]) -> None:
    """Refuse results of chains that differ in base, tip, joints, held values or the joints with placements."""
    r, s = a.nominal, b.nominal
    moved = [n for n, value in r.held.items() if abs(value - s.held.get(n, value)) > _SAME]
    for what, first, second in (
        ("Base", f"'{r.base}'", f"'{s.base}'"),
        ("Tip", f"'{r.tip}'", f"'{s.tip}'"),
        ("Joints", choices(r.joint_names), choices(s.joint_names)),
        ("Joints with placements", choices(r.origins()), choices(s.origins())),
        ("Held joints", choices(r.held) or "none", choices(s.held) or "none"),
        *((f"Value of '{name}'", f"{r.held[name]:g}", f"{s.held[name]:g}") for name in moved),
    ):
        if first != second:
            raise ModelError(
                f"{names[0]} and {names[1]} are not of one chain. {what}: {first} in {names[0]}, {second} in "
                f"{names[1]}. Fit both with the same --base, --tip and --hold."
            )


def _shown(own: Robot, given: Robot | str | Path | None) -> Robot:
    """The robot to show, the results' own or one that was given; another one is refused."""
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


def _covered(a: Array, b: Array) -> Array:
    """The range of each joint that both data cover, or that either does where that is none, shape (m, 2)."""
    low, high = np.fmax(a[:, 0], b[:, 0]), np.fmin(a[:, 1], b[:, 1])
    apart = ~(low < high)
    low = np.where(apart, np.fmin(a[:, 0], b[:, 0]), low)
    high = np.where(apart, np.fmax(a[:, 1], b[:, 1]), high)
    found = np.stack([low, high], axis=1)
    return np.where(np.isfinite(found), found, 0.0)


def _same_data(a: Calibration, b: Calibration) -> bool:
    """Whether both results are made of the same measurements: of one file, or of the same numbers in memory."""
    if a.source.sha256 or b.source.sha256 or a.fit is None or b.fit is None:
        return bool(a.source.sha256) and a.source.sha256 == b.source.sha256
    m, n = a.fit.measurements, b.fit.measurements
    nothing: Array = np.zeros(0)
    distances = [nothing if one.distances is None else one.distances for one in (m, n)]
    pairs = ((m.joints, n.joints), (m.points, n.points), distances)
    return all(np.array_equal(x, y, equal_nan=True) for x, y in pairs)


def _parameters(
    a: Calibration, b: Calibration, *, same_start: bool
) -> tuple[ParameterDifference, ...]:
    """The robot's own parameters of either result, those of the first first."""
    nan = float("nan")
    every = [{one.name: one for one in c.parameters} for c in (a, b)]
    result = []
    for name in dict.fromkeys((*own_names(a), *own_names(b))):
        first, second = (one.get(name) for one in every)
        difference = std = nan
        if first is not None and second is not None:
            difference = second.delta - first.delta if same_start else nan
            std = float(np.hypot(first.std, second.std))
        known = [one for one in (first, second) if one is not None]
        result.append(
            ParameterDifference(
                name=name,
                unit=known[0].unit,
                a=nan if first is None else first.value,
                b=nan if second is None else second.value,
                difference=difference,
                std=std,
                sigmas=difference / std if std > 0.0 else nan,
                alone=all(one.identifiable for one in known),
            )
        )
    return tuple(result)


def _moved(
    a: Mapping[str, Array], b: Mapping[str, Array], *, found: bool, oriented: bool
) -> tuple[PlaceDifference, ...]:
    """How poses of the same name moved; the only one of each, whatever their names."""
    shared = [(name, a[name], b[name]) for name in a if name in b]
    if not shared and len(a) == len(b) == 1:
        shared = [("", next(iter(a.values())), next(iter(b.values())))]
    result = []
    for name, T, U in shared:
        turn = Rotation.from_matrix(T[:3, :3].T @ U[:3, :3]).magnitude()
        shift = float(np.linalg.norm(U[:3, 3] - T[:3, 3]))
        result.append(PlaceDifference(name, found, shift, turn if oriented else float("nan")))
    return tuple(result)
