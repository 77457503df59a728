"""Whether two results can be compared, and what to mind where they can."""

from __future__ import annotations

import numpy as np

from calib.errors import ModelError, choices
from calib.identify.compared import Compared
from calib.identify.drift import DriftTest
from calib.model.robot import Robot

#: What a comparison says: see `calib.identify.comparison.Comparison`.
DRIFT, NO_DRIFT, CANNOT_TELL = "drift", "no drift shown", "cannot tell"

#: Origins that differ by less than this are the same [m; rotation matrices: 1].
_SAME = 1e-9

#: What a model lacks shows in what it leaves over on its own rows: a move this many times as far has another cause.
_FAR = 3.0

#: Joints are held at the same value within this [rad, m].
_HELD = 1e-9


def check_same_chain(a: Compared, b: Compared) -> None:
    """Refuse results of different chains.

    Raises:
        ModelError: Base, tip, joints, held values or the joints that carry placements differ.
    """
    s, t = a.stored, b.stored
    for what, first, second in (
        ("Base", f"'{s.base}'", f"'{t.base}'"),
        ("Tip", f"'{s.tip}'", f"'{t.tip}'"),
        ("Joints", choices(a.joints), choices(b.joints)),
        ("Joints with placements", choices(s.origins), choices(t.origins)),
        ("Held joints", choices(s.held) or "none", choices(t.held) or "none"),
    ):
        if first != second:
            message = (
                f"{a.name} and {b.name} are not of one chain. {what}: {first} in {a.name}, {second} in {b.name}. Fit "
                "both with the same --base, --tip and --hold."
            )
            raise ModelError(message)
    moved = [name for name, value in s.held.items() if abs(value - t.held[name]) > _HELD]
    if moved:
        message = (
            f"{choices(moved)} was held at {s.held[moved[0]]:g} in {a.name} and at {t.held[moved[0]]:g} in {b.name}, "
            "so that the chains differ. Compare results of the same --hold."
        )
        raise ModelError(message)


def same_start(a: Compared, b: Compared) -> bool:
    """Whether both count from the same nominal origins."""
    first, second = a.stored.nominal_origins, b.stored.nominal_origins
    return all(np.abs(first[name] - second[name]).max() < _SAME for name in first)


def why_not(
    a: Compared,
    b: Compared,
    test: DriftTest,
    only: tuple[tuple[str, ...], tuple[str, ...]],
    *,
    known: bool,
    moved: float,
) -> str:
    """Why it cannot be told whether the robot drifted; empty where it can.

    Args:
        a: One result.
        b: The other.
        test: The test of their difference.
        only: The parameters that move the target in ways that the other result's cannot, of each.
        known: Whether the results can be subtracted at all.
        moved: How far the target moved, rms, without the noise's part [m]; NaN where it is not known.
    """
    if a.data[1] and a.data[1] == b.data[1]:
        return (
            "Both results are made of the same measurements, so that the robot was the same: what differs is how they "
            "were fitted."
        )
    bad = [one.name for one in (a, b) if one.use == "do not use"]
    if bad:
        return f"The verdict on {' and on '.join(bad)} is 'do not use': mend that first."
    if not known:
        return (
            "The results count from different nominal robots, so that their parameters cannot be compared one by one. "
            "Give the URDF of either (--robot)."
        )
    if test.combinations == 0:
        return (
            "The data of the two know no combination of the robot's parameters in common better than the priors do. "
            "Measure more poses."
        )
    if any(only) and test.drifted and not moved > _FAR * _left_over(a, b):
        return (
            f"The results differ by more than chance, but they estimate different errors: {_only(a, b, only)}. What "
            "one leaves out shows as a difference. Fit both with the same --model."
        )
    return ""


def _left_over(a: Compared, b: Compared) -> float:
    """What either result leaves over on the rows that it was fitted to, the larger rms [m]."""
    return max((one.errors[0].rms for one in (a, b) if one.errors), default=float("inf"))


def _only(a: Compared, b: Compared, only: tuple[tuple[str, ...], ...]) -> str:
    """Which parameters only one result has, in words."""
    return " and ".join(
        f"only {one.name} ('{one.model}') has {choices(names, limit=4)}"
        for one, names in zip((a, b), only, strict=True)
        if names
    )


def notes(
    a: Compared,
    b: Compared,
    robot: Robot | None,
    *,
    same_start: bool,
    only: tuple[tuple[str, ...], ...],
) -> tuple[str, ...]:
    """What to mind, sentences.

    Args:
        a: One result.
        b: The other.
        robot: The robot, where its URDF is at hand.
        same_start: Whether both count from the same nominal robot.
        only: The parameters that move the target in ways that the other result's cannot, of each; nothing where that
            has been said.
    """
    notes = []
    if robot is None:
        notes.append(
            "The URDF that the results name lies neither beside them nor here, so that only parameters are compared. "
            "Give it with --robot to see how far the target moved."
        )
    if a.robot_name != b.robot_name:
        notes.append(f"The URDFs name their robots '{a.robot_name}' and '{b.robot_name}'.")
    if any(only):
        notes.append(f"The results estimate different errors: {_only(a, b, only)}.")
    if not same_start:
        notes.append(
            "The results count from different nominal robots: parameters are not subtracted, and what the data do not "
            "know stays where each nominal robot has it."
        )
    if not a.frame and not b.frame:
        notes.append(
            "Both take the measurement frame as known: an error in where the tracker was said to stand looks like a "
            "drift of the first joints."
        )
    with_larger = [f"{one.name} ('{one.larger}')" for one in (a, b) if one.larger]
    if with_larger:
        notes.append(
            f"Compared is the geometry that the URDF holds; the larger model of {' and of '.join(with_larger)} is not. "
            "Loads, speeds and poses should be alike in both measurements."
        )
    bounded = dict.fromkeys(one.names[k] for one in (a, b) for k in one.own if one.at_bound[k])
    if bounded:
        notes.append(
            f"{choices(bounded)} {'stands' if len(bounded) == 1 else 'stand'} at a bound, and is taken as known there."
        )
    careful = [one.name for one in (a, b) if one.use == "use with care"]
    if careful:
        notes.append(f"The verdict on {' and on '.join(careful)} is 'use with care'; see there.")
    return tuple(notes)
