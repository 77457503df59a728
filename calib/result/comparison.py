"""compare: two calibrations of one robot side by side, and whether the robot drifted between them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal

import numpy as np

from calib.errors import ModelError
from calib.result.calibration import Calibration
from calib.result.calibration_file import read_result
from calib.result.drift import Drift, drift_between
from calib.result.verdict import NO
from calib.robot.readback import spread_between, spread_poses
from calib.robot.robot import Robot
from calib.units import Array

Place = tuple[float, float]

Outcome = Literal["drift", "no drift shown", "cannot tell"]
#: Why nothing can be told; empty otherwise.
Why = Literal["", "same data", "bad verdict", "nothing known", "other errors"]

#: Joint values over which displacements are averaged; origins and held values that differ by less are the same.
_POSES, _SAME = 200, 1e-9

#: What a model lacks shows in its residuals: a displacement this many times as large has another cause.
_FAR = 3.0


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class Comparison(Drift):
    """The result of `compare`."""

    a: Calibration  #: The first result
    b: Calibration  #: The second
    names: tuple[str, str]  #: Their files, or ``"a"`` and ``"b"``
    outcome: Outcome  #: ``"drift"``, ``"no drift shown"`` or ``"cannot tell"``
    why: Why  #: Why nothing can be told; empty otherwise
    robot: Robot  #: The robot whose meshes are shown

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
        ModelError: The results are of different chains.
        UrdfError: The URDF cannot be read, or lacks a joint.
    """
    first, second = (one if isinstance(one, Calibration) else read_result(one) for one in (a, b))
    names = (
        "a" if isinstance(a, Calibration) else Path(a).name,
        "b" if isinstance(b, Calibration) else Path(b).name,
    )
    chains = [
        (r.base, r.tip, r.joint_names, set(r.origins()), dict(r.held))
        for r in (first.nominal, second.nominal)
    ]
    if chains[0] != chains[1]:
        raise ModelError(
            f"{names[0]} and {names[1]} are not of one chain: {first.nominal!r}, {second.nominal!r}. Calibrate "
            "both with the same --base, --tip and --hold."
        )
    both, own = (first, second), first.nominal
    shown = own
    if isinstance(robot, Robot):
        shown = robot.rebuilt(base=own.base, tip=own.tip)
    elif robot is not None:
        shown = Robot.load(robot, own.base, own.tip, held=own.held)
    origins = first.nominal.origins(), second.nominal.origins()
    same = all(np.abs(T - origins[1][name]).max() < _SAME for name, T in origins[0].items())
    found = drift_between(
        first,
        second,
        spread_between(_covered(first.ranges, second.ranges), _POSES),
        spread_poses(first.nominal, _POSES),
        same_start=same,
    )
    why: Why = ""
    if first is second or (first.source.sha256 and first.source.sha256 == second.source.sha256):
        why = "same data"
    elif any(one.verdict is not None and one.verdict.use == NO for one in both):
        why = "bad verdict"
    elif found.test.combinations == 0:
        why = "nothing known"
    elif (found.only_a or found.only_b) and found.test.drifted:
        residual = max(one.errors["calibrated"]["estimation"].rms for one in both)
        why = "" if found.moves[0].moved > _FAR * residual else "other errors"
    return Comparison(
        **{one.name: getattr(found, one.name) for one in fields(found)},
        a=first,
        b=second,
        names=names,
        outcome="cannot tell" if why else "drift" if found.test.drifted else "no drift shown",
        why=why,
        robot=shown,
    )


def _covered(a: Array, b: Array) -> Array:
    """The range of each joint that both data cover, or that either does where that is none, shape (m, 2)."""
    low, high = np.fmax(a[:, 0], b[:, 0]), np.fmin(a[:, 1], b[:, 1])
    apart = ~(low < high)
    low = np.where(apart, np.fmin(a[:, 0], b[:, 0]), low)
    high = np.where(apart, np.fmax(a[:, 1], b[:, 1]), high)
    found = np.stack([low, high], axis=1)
    return np.where(np.isfinite(found), found, 0.0)
