"""Judgement: which commands can be given out, why the others cannot, and what to know of those that are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.compensate.inverse import Solved
from calib.compensate.matching import WEIGHTED, Matching
from calib.compensate.pair import Pair
from calib.compensate.starts import Starts
from calib.measure.ranges import column_limits
from calib.model.robot import Robot

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Joint values may pass their limits by this, for rounding [rad or m].
_ROUNDING = 1e-9

#: What may be left where the nominal robot is held to be at the pose [m], [rad].
_NOMINAL = (1e-6, 1e-6)

#: Near a singularity: the smallest singular value of the tool's motion, lengths in units of the arm's reach.
NEAR_SINGULAR = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """What is said of N rows.

    Attributes:
        reached: Which have a command, shape (N,).
        nominal_reaches: Which poses the nominal robot reaches, shape (N,).
        missed: shape (N, 2), how far the true robot misses at the nominal joint values [m], [rad].
        left: shape (N, 2), how far it misses at those to command [m], [rad].
        reasons: Why a row has no command, or nothing.
        warnings: What to know of one that has.
    """

    reached: Mask
    nominal_reaches: Mask
    missed: Array
    left: Array
    reasons: tuple[str, ...]
    warnings: tuple[tuple[str, ...], ...]


def judged(
    pair: Pair,
    T_wanted: Array,
    starts: Starts,
    solved: Solved,
    left_by_pose: Array,
    matching: Matching,
    *,
    accept: tuple[float, float],
    limit: tuple[float, float],
) -> Judged:
    """Say of each row whether its command can be given out.

    Args:
        pair: The two models.
        T_wanted: shape (N, 4, 4), poses of the tool in the base [m].
        starts: Joint values of the nominal robot.
        solved: Joint values of the true one.
        left_by_pose: shape (N, 2), what is left if poses are sent [m], [rad].
        matching: What is matched.
        accept: What may be left: position [m], angle [rad].
        limit: Corrections of the pose larger than this are warned of: position [m], angle [rad].
    """
    robot = pair.true.robot
    T_true, twists_before = pair.true.motion(starts.q)
    missed = matching.misses(T_true, T_wanted)
    left = matching.misses(solved.T_base_tool, T_wanted)
    weighted = matching.name == WEIGHTED
    nominal_left = matching.misses(starts.T_base_tool, T_wanted)
    nominal_reaches = _within(nominal_left, _NOMINAL) | weighted
    far = ~_within(left, accept) & (not weighted)
    limits = _limits_passed(robot, solved.q, starts.q)
    turned = _other_branch(matching.jacobian(twists_before), matching.jacobian(solved.twists))
    amplified = _amplification(pair, matching, solved)
    moved = _corrections(pair, starts, solved)
    by_pose = _by_pose(left_by_pose, ~_within(left_by_pose - left, accept))
    outside = _outside(pair, solved.q)
    where = "at the edge of its reach or in a singularity"
    if len(robot.joint_names) < matching.rows:
        where = (
            f"for it has {len(robot.joint_names)} joints and cannot match {matching.rows} numbers"
        )
    reasons = tuple(
        _reason(one, passed, where, far=bool(f), turned=bool(t))
        for one, passed, f, t in zip(left, limits, far, turned, strict=True)
    )
    warnings = tuple(
        () if reason else _warnings(a, m, limit, nominal_reaches=bool(n)) + b + o
        for reason, a, m, n, b, o in zip(
            reasons, amplified, moved, nominal_reaches, by_pose, outside, strict=True
        )
    )
    return Judged(
        reached=np.array([not reason for reason in reasons]),
        nominal_reaches=nominal_reaches,
        missed=missed,
        left=left,
        reasons=reasons,
        warnings=warnings,
    )


def _within(misses: Array, allowed: tuple[float, float]) -> Mask:
    """Which misses are small enough; an angle that is not matched is."""
    return np.asarray((misses[:, 0] <= allowed[0]) & ~(misses[:, 1] > allowed[1]))


def _limits_passed(robot: Robot, q: Array, before: Array) -> list[str]:
    """For each row the joint that would pass its limit, in words; nothing where none does.

    Args:
        robot: The robot.
        q: shape (N, m), joint values to command [rad] or [m].
        before: shape (N, m), those of the nominal robot.
    """
    low, high = column_limits(robot).T
    beyond = np.maximum(low - q, q - high)
    said = []
    for values, own, excess in zip(q, before, beyond, strict=True):
        worst = int(np.argmax(excess))
        if excess[worst] <= _ROUNDING:
            said.append("")
            continue
        name = robot.joint_names[worst]
        slides = robot.joint_types[name] == "prismatic"
        scale, unit = (1e3, "mm") if slides else (180.0 / np.pi, "deg")
        bound = low[worst] if values[worst] < low[worst] else high[worst]
        text = f"'{name}' would have to be at {scale * values[worst]:.4f} {unit}, beyond its limit {scale * bound:.4f}"
        if not low[worst] - _ROUNDING <= own[worst] <= high[worst] + _ROUNDING:
            text += f"; without correction it is beyond it too, at {scale * own[worst]:.4f}"
        said.append(text)
    return said


def _other_branch(before: Array, after: Array) -> Mask:
    """Which rows have passed a singularity on their way: the determinant has turned its sign."""
    if before.shape[1] != before.shape[2]:
        return np.zeros(len(before), dtype=bool)
    return np.asarray(np.linalg.slogdet(before)[0] * np.linalg.slogdet(after)[0] < 0)


def _amplification(pair: Pair, matching: Matching, solved: Solved) -> Array:
    """How far the joints move at worst for a millimetre of the tool [rad or m]; zero where no singularity is near."""
    arm = pair.true
    lengths = np.linalg.norm(arm.placements[:, :3, 3], axis=1)
    reach = float(lengths.sum() + np.linalg.norm(arm.T_tip_tool[:3, 3])) or 1.0
    motion = matching.jacobian(solved.twists)
    motion[:, :3] /= reach
    motion[:, 3:] /= matching.lever
    values = np.linalg.svd(motion, compute_uv=False)
    # With fewer joints than numbers to match, those that can be moved count.
    smallest = np.maximum(values[:, -1], 1e-300)
    return np.asarray(np.where(smallest < NEAR_SINGULAR, 1e-3 / reach / smallest, 0.0))


def _corrections(pair: Pair, starts: Starts, solved: Solved) -> Array:
    """How far the nominal model's pose moves with the command: position [m] and angle [rad], shape (N, 2)."""
    before = starts.T_base_tool
    after = pair.believed.poses(solved.q)
    return Matching("pose", 1.0).misses(after, before)


def _by_pose(left: Array, elsewhere: Mask) -> list[tuple[str, ...]]:
    """For each row what may happen if its pose is sent, in words; nothing where the controller comes to its joints."""
    return [
        (
            f"sent as a pose it may end {1e3 * misses[0]:.3g} mm off: the controller can come to other joint "
            "values",
        )
        if far
        else ()
        for misses, far in zip(left, elsewhere, strict=True)
    ]


def _outside(pair: Pair, q: Array) -> list[tuple[str, ...]]:
    """For each row the joints outside of the range that was measured, in words; nothing where none is."""
    said: list[tuple[str, ...]] = [()] * len(q)
    if pair.certainty is not None:
        for row in pair.certainty.outside(pair.believed.robot, q):
            joints = ", ".join(map(str, row.beyond))
            said[row.index] = (f"outside the joint range that was measured: {joints}",)
    return said


def _reason(left: Array, limit_passed: str, where: str, *, far: bool, turned: bool) -> str:
    """Why there is no command; nothing if there is one."""
    if far:
        angle = "" if np.isnan(left[1]) else f" and {np.degrees(left[1]):.4f} deg"
        return (
            f"the true robot cannot reach it: {1e3 * left[0]:.4f} mm{angle} would be left, {where}"
        )
    if limit_passed:
        return limit_passed
    if turned:
        return "next to a singularity: the solution lies in another branch of the arm"
    return ""


def _warnings(
    amplified: float,
    moved: Array,
    limit: tuple[float, float],
    *,
    nominal_reaches: bool,
) -> tuple[str, ...]:
    """What to know of a command."""
    said = []
    if amplified > 0.0:
        said.append(
            f"near a singularity: 1 mm of the tool may take {min(np.degrees(amplified), 360.0):.1f} deg of a joint"
        )
    if moved[0] > limit[0]:
        said.append(f"the pose moves by {1e3 * moved[0]:.2f} mm, more than {1e3 * limit[0]:g} mm")
    if moved[1] > limit[1]:
        said.append(
            f"the pose turns by {np.degrees(moved[1]):.2f} deg, more than {np.degrees(limit[1]):g} deg"
        )
    if not nominal_reaches:
        said.append("the nominal robot cannot reach the pose itself")
    return tuple(said)
