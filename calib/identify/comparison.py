"""compare: two calibrations of one robot side by side, and whether the robot drifted between them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.errors import ModelError, choices
from calib.families import ZERO
from calib.identify.common_priors import estimated
from calib.identify.comparability import (
    CANNOT_TELL,
    DRIFT,
    NO_DRIFT,
    check_same_chain,
    notes,
    same_start,
    why_not,
)
from calib.identify.compared import Compared, Result
from calib.identify.comparison_facts import Facts
from calib.identify.comparison_text import comparison_table, comparison_text
from calib.identify.differences import (
    frame_differences,
    parameter_differences,
    target_differences,
)
from calib.identify.drift import DriftTest, Pair, drift_test
from calib.identify.moves import Compensated, Move, Seen
from calib.identify.result_file import write_table
from calib.model.observability import steps
from calib.model.readback import spread_between, spread_poses
from calib.model.robot import Robot

Array = NDArray[np.float64]

#: Joint values over which moves are told.
_POSES = 200

#: What stands for rounding where parameters are compared, in steps of 1 mm and 1 mrad.
_FLOOR = 1e-7


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Comparison(Facts):
    """The result of `compare`; its attributes are those of `Facts`."""

    def __repr__(self) -> str:
        """In one line; `summary` has the rest."""
        return (
            f"Comparison({self.a.name!r}, {self.b.name!r}, {self.outcome}, p = {self.test.p:.2g})"
        )

    def summary(self) -> str:
        """The comparison as text, without colours, in 100 columns."""
        return comparison_text(self)

    def table(self) -> dict[str, Any]:
        """The comparison as nested tables of plain values; the keys are documented in docs/comparison.md."""
        return comparison_table(self)

    def write_json(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the comparison as JSON.

        Raises:
            FileError: The file exists, or cannot be written.
        """
        return write_table(self.table(), path, overwrite=overwrite)


def compare(a: Result, b: Result, robot: Robot | str | Path | None = None) -> Comparison:
    """Compare two calibrations of one robot: did it drift?

    Args:
        a: The first: a `Calibration`, or the path of a result file.
        b: The second, made of other measurements.
        robot: The robot, or its URDF, nominal or corrected. None: the calibration's, or the URDF that the result names,
            where it lies beside the result or in this folder unchanged; without any the parameters alone are compared.

    Raises:
        FileError: A file cannot be read or is no result.
        ModelError: The results are of different chains, or the robot is another one.
        UrdfError: The URDF cannot be read, or lacks a joint.
    """
    first, second = Compared.of(a, "a"), Compared.of(b, "b")
    check_same_chain(first, second)
    arm = _robot(first, second, robot)
    return _compared(first, second, arm)


def _compared(a: Compared, b: Compared, robot: Robot | None) -> Comparison:
    """The comparison of results of one chain."""
    same = same_start(a, b)
    alike = same and a.own_names == b.own_names and a.ties == b.ties and a.model == b.model
    both = None if robot is None else _both(a, b, robot, same_start=same)
    if both is None:
        pair = _by_name(a, b, same, alike)
        difference, floor, only = _named_difference(a, b, same, pair), _FLOOR, _missing(a, b)
    else:
        pair = both.pair(alike=alike)
        difference, floor = both.difference(pair), both.floor
        only = (both.alone(0), both.alone(1))
    test = drift_test(difference, pair, floor)
    moves = () if both is None or robot is None else _moves(both, robot, pair)
    moved = moves[0].moved if moves else float("nan")
    why = why_not(a, b, test, only, known=both is not None or same, moved=moved)
    outcome = CANNOT_TELL if why else DRIFT if test.drifted else NO_DRIFT
    return Comparison(
        a=a,
        b=b,
        outcome=outcome,
        why=why,
        test=test,
        moves=moves,
        shows_from=float("nan") if both is None else _shows_from(both, test),
        parameters=parameter_differences(a, b, test, same_start=same),
        untold=() if both is None else both.untold(),
        only_a=only[0],
        only_b=only[1],
        frames=frame_differences(a, b),
        targets=target_differences(a, b),
        notes=notes(a, b, robot, same_start=same, only=() if why else only),
        robot=robot,
    )


def _robot(a: Compared, b: Compared, given: Robot | str | Path | None) -> Robot | None:
    """The robot of both, or None where its URDF is not at hand.

    Raises:
        ModelError: Another robot was given.
        UrdfError: Its URDF cannot be read or lacks a link or joint.
    """
    if given is None:
        return a.nominal or b.nominal
    s = a.stored
    robot = (
        given.rebuilt(base=s.base, tip=s.tip)
        if isinstance(given, Robot)
        else Robot.load(given, s.base, s.tip, held=s.held)
    )
    if robot.joint_names != a.joints or set(robot.origins()) != set(s.origins):
        message = (
            f"The robot given has the joints {choices(robot.joint_names)} between '{s.base}' and '{s.tip}'; "
            f"{a.name} and {b.name} are of {choices(a.joints)}. Give the URDF that they were made with."
        )
        raise ModelError(message)
    return robot


def _covered(a: Compared, b: Compared) -> Array:
    """The range of each joint that both data cover, or that either does where that is none, shape (m, 2)."""
    low = np.fmax(a.ranges[:, 0], b.ranges[:, 0])
    high = np.fmin(a.ranges[:, 1], b.ranges[:, 1])
    apart = ~(low < high)
    low = np.where(apart, np.fmin(a.ranges[:, 0], b.ranges[:, 0]), low)
    high = np.where(apart, np.fmax(a.ranges[:, 1], b.ranges[:, 1]), high)
    return np.stack([np.nan_to_num(low), np.nan_to_num(high)], axis=1)


def _both(a: Compared, b: Compared, robot: Robot, *, same_start: bool) -> Compensated:
    """Both results over the joint values that their data cover."""
    q = spread_between(_covered(a, b), _POSES)
    return Compensated.of(Seen.at(a, b, robot, q), a, b, same_start=same_start)


def _moves(both: Compensated, robot: Robot, pair: Pair) -> tuple[Move, ...]:
    """How far the target lies elsewhere, over what both data cover and over the limits."""
    everywhere = Seen.at(both.a, both.b, robot, spread_poses(robot, _POSES))
    return (
        both.move("the joint values that both measured", both.seen, pair),
        both.move("the joint limits", everywhere, pair),
    )


def _shows_from(both: Compensated, test: DriftTest) -> float:
    """How far the worst joint's zero must move the target to be noticed [m]; NaN where none can be."""
    untold, reach, families = both.untold(), both.reach(1), both.seen.families[1]
    found = [
        float(reach[k]) * test.shows_from(k)
        for k, name in enumerate(both.b.own_names)
        if families[k] == ZERO and name not in untold and np.isfinite(test.shows_from(k))
    ]
    return max(found, default=float("nan"))


def _missing(a: Compared, b: Compared) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names that only one result has."""
    first, second = a.own_names, b.own_names
    return tuple(n for n in first if n not in second), tuple(n for n in second if n not in first)


def _shared(a: Compared, b: Compared, same: bool) -> list[str]:
    """The parameters that count from the same in both."""
    return [n for n in a.own_names if n in b.own_names] if same else []


def _named_difference(a: Compared, b: Compared, same: bool, pair: Pair) -> Array:
    """The difference of the parameters that both have, under common priors, in steps of 1 mm and 1 mrad."""
    names = _shared(a, b, same)
    values = []
    for one, found in ((a, pair.a), (b, pair.b)):
        own = [one.own_names.index(name) for name in names]
        values.append((one.delta[one.own] + found.shift)[own])
    units = [a.units[a.names.index(name)] for name in names]
    return np.asarray((values[1] - values[0]) / steps(units))


def _by_name(a: Compared, b: Compared, same: bool, alike: bool) -> Pair:
    """Both results in the parameters that they share, in the same steps: what can be done without a robot."""
    names, effects = _shared(a, b, same), []
    for one in (a, b):
        effect = np.zeros((len(names), len(one.own)))
        for row, name in enumerate(names):
            k = one.own_names.index(name)
            effect[row, k] = 1.0 / steps([one.units[one.own[k]]])[0]
        effects.append(effect)
    return Pair(estimated(a, b, effects[0]), estimated(b, a, effects[1]), alike)
