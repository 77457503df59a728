"""Parameters, frames and targets of two results side by side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.families import unit_of
from calib.identify.compared import Compared
from calib.identify.drift import DriftTest
from calib.model.robot import rigid_inverse

Array = NDArray[np.float64]

#: A drift that would have to exceed this many steps of 1 mm or 1 mrad to be noticed never will be.
_NEVER = 10.0


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
        explains: Change of this parameter alone that explains the difference best; NaN where the data do not know it.
        explains_std: Its standard deviation.
        left_p: Probability of what it leaves of the difference, or more, where nothing else has changed.
        would_show: Change of this parameter alone that the test would notice 9 times in 10; infinite where frame and
            target make up for it, or the data do not know it.
    """

    name: str
    unit: str
    a: float
    b: float
    difference: float
    std: float
    sigmas: float
    alone: bool
    explains: float
    explains_std: float
    left_p: float
    would_show: float


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


def parameter_differences(
    a: Compared,
    b: Compared,
    test: DriftTest,
    *,
    same_start: bool,
) -> tuple[ParameterDifference, ...]:
    """The robot's own parameters of either result, those of the first first."""
    nan = float("nan")
    result = []
    for name in dict.fromkeys((*a.own_names, *b.own_names)):
        found = [one.names.index(name) if name in one.names else -1 for one in (a, b)]
        values = [float(r.value[k]) if k >= 0 else nan for r, k in zip((a, b), found, strict=True)]
        pairs = [(r, k) for r, k in zip((a, b), found, strict=True) if k >= 0]
        comparable = len(pairs) == 2 and same_start
        bounded = any(r.at_bound[k] for r, k in pairs)
        std = float(np.sqrt(sum(r.covariance[k, k] for r, k in pairs)))
        std = std if len(pairs) == 2 and not bounded else nan
        difference = float(b.delta[found[1]] - a.delta[found[0]]) if comparable else nan
        number = b.own_names.index(name) if found[1] >= 0 else 0
        factor, told = test.shows_from(number), test.explained(number)
        unit = pairs[0][0].units[pairs[0][1]]
        # Both must have it: what one leaves out is no change of the robot.
        shown = factor < _NEVER * unit_of(unit).step and len(pairs) == 2
        result.append(
            ParameterDifference(
                name=name,
                unit=unit,
                a=values[0],
                b=values[1],
                difference=difference,
                std=std,
                sigmas=difference / std if std > 0.0 else nan,
                alone=all(bool(r.identifiable[k]) for r, k in pairs),
                explains=told.change if shown and np.isfinite(told.std) else nan,
                explains_std=told.std if shown and np.isfinite(told.std) else nan,
                left_p=told.p if shown and np.isfinite(told.std) else nan,
                would_show=factor if shown else float("inf"),
            )
        )
    return tuple(result)


def frame_differences(a: Compared, b: Compared) -> tuple[PlaceDifference, ...]:
    """How set-ups of the same name moved: as seen from the base."""
    return tuple(
        PlaceDifference(name, bool(a.frame or b.frame), *_moved(rigid_inverse(T), rigid_inverse(U)))
        for name, T, U in _pairs(a.stored.known.frames, b.stored.known.frames)
    )


def target_differences(a: Compared, b: Compared) -> tuple[PlaceDifference, ...]:
    """How targets of the same name moved in the tip."""
    turned = a.stored.known.rotation and b.stored.known.rotation
    result = []
    for name, T, U in _pairs(a.stored.known.targets, b.stored.known.targets):
        shift, turn = _moved(T, U)
        found = a.target_estimated or b.target_estimated
        result.append(PlaceDifference(name, found, shift, turn if turned else float("nan")))
    return tuple(result)


def _pairs(
    first: Mapping[str, Array], second: Mapping[str, Array]
) -> list[tuple[str, Array, Array]]:
    """Poses of the same name; the only one of each, whatever their names."""
    if len(first) == len(second) == 1:
        (name, T), (other, U) = next(iter(first.items())), next(iter(second.items()))
        return [(name if name == other else "", T, U)]
    return [(name, T, second[name]) for name, T in first.items() if name in second]


def _moved(T: Array, U: Array) -> tuple[float, float]:
    """Distance and angle between two poses, [m] and [rad]."""
    turn = Rotation.from_matrix(T[:3, :3].T @ U[:3, :3]).magnitude()
    return float(np.linalg.norm(U[:3, 3] - T[:3, 3])), float(turn)
