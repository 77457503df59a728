"""Judgement: which commands can be given out, why the others cannot, and what to know of those that are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.compensate import cautions
from calib.compensate.inverse import Solved
from calib.compensate.matching import WEIGHTED, Matching
from calib.compensate.pair import Pair
from calib.compensate.program import Program
from calib.compensate.starts import Starts
from calib.measure.ranges import column_limits
from calib.model.robot import Robot

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Joint values may pass their limits by this, for rounding [rad or m].
_ROUNDING = 1e-9

#: What may be left where the nominal robot is held to be at the pose [m], [rad].
_NOMINAL = (1e-6, 1e-6)


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
    program: Program,
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
        program: What was asked for.
        T_wanted: shape (N, 4, 4), poses of the tool in the base [m].
        starts: Joint values of the nominal robot.
        solved: Joint values of the true one.
        left_by_pose: shape (N, 2), what is left if poses are sent [m], [rad].
        matching: What is matched.
        accept: What may be left: position [m], angle [rad]. A weighted match may leave a position as large as the
            limit, and any angle.
        limit: Corrections of the pose larger than this are warned of: position [m], angle [rad].
    """
    robot = pair.true.robot
    T_true, twists_before = pair.true.motion(starts.q)
    missed = matching.misses(T_true, T_wanted)
    left = matching.misses(solved.T_base_tool, T_wanted)
    weighted = matching.name == WEIGHTED
    may_be_left = (limit[0], np.inf) if weighted else accept
    nominal_left = matching.misses(starts.T_base_tool, T_wanted)
    nominal_reaches = _within(nominal_left, may_be_left if weighted else _NOMINAL)
    turned = _other_branch(matching.jacobian(twists_before), matching.jacobian(solved.twists))
    reasons = tuple(
        _reason(one, passed, _where(robot, matching), far=bool(f), turned=bool(t))
        for one, passed, f, t in zip(
            left,
            _limits_passed(robot, solved.q, starts.q),
            ~_within(left, may_be_left),
            turned,
            strict=True,
        )
    )
    reached = np.array([not reason for reason in reasons])
    moved = Matching("pose", 1.0).misses(pair.believed.poses(solved.q), starts.T_base_tool)
    given = None if program.T_wanted is None else program.q
    said = (
        cautions.nominal_cannot(nominal_reaches),
        cautions.left_over(left, missed, matching),
        cautions.near_singularity(pair, matching, starts, solved),
        cautions.pose_moved(moved, limit),
        cautions.joints_moved(robot, starts.q, solved.q),
        cautions.jumps(pair, T_wanted, starts.q, solved.q, program.labels, reached),
        cautions.far_from_given(robot, given, starts.q),
        cautions.by_pose(left_by_pose, ~_within(left_by_pose - left, accept)),
        cautions.outside(pair, solved.q),
    )
    return Judged(
        reached=reached,
        nominal_reaches=nominal_reaches,
        missed=missed,
        left=left,
        reasons=reasons,
        warnings=tuple(
            sum(words, ()) if one else ()
            for one, words in zip(reached, zip(*said, strict=True), strict=True)
        ),
    )


def _where(robot: Robot, matching: Matching) -> str:
    """Why something is left over, as far as it can be told."""
    count = len(robot.joint_names)
    if count < matching.rows and matching.name != WEIGHTED:
        return f"for it has {count} joints and cannot match {matching.rows} numbers"
    return "at the edge of its reach or in a singularity"


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


def _reason(left: Array, limit_passed: str, where: str, *, far: bool, turned: bool) -> str:
    """Why there is no command; nothing if there is one."""
    if far:
        angle = "" if np.isnan(left[1]) else f" and {np.degrees(left[1]):.4f} deg"
        return (
            f"the true robot cannot reach it: {1e3 * left[0]:.4f} mm{angle} would be left near the nominal joint "
            f"values, {where}"
        )
    if limit_passed:
        return limit_passed
    if turned:
        return "next to a singularity: the solution lies in another branch of the arm"
    return ""
