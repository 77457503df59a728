"""Trend of one robot over several calibrations: what each joint's zero does over time, and how far the target moved.

The change of the joint zeros from the first result to result k is found from the predictions, so that it does not
depend on the model that was fitted:

    delta_k(q) = prediction of k less that of the first,    dz_k = E^+ (1 - G G^+) delta_k

over joint values q that all data cover, with the derivative E of the predicted target by the joint zeros, itself
without what base and target explain, and the motions G of base and target that any fit had to estimate. One
pseudo-inverse for all results: an error that stays, of whatever kind, cancels. The noise of a result's parameters
gives the standard deviations. What each zero does over time is found by `calib.verbs.compare.joint_trend`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np

from calib.basics.arguments import check_number, check_path, check_type
from calib.basics.arrays import Array, Mask
from calib.basics.dates import MONTH, date_text, parse_date
from calib.basics.values import Value, one_line, shown_by
from calib.errors import ArgumentError, CalibError
from calib.model.kinematics import Kinematics
from calib.model.parameter_sets import error_model
from calib.result.calibration import Calibration
from calib.result.calibration_file import ResultInput, result_of, versions, write_table
from calib.robot.ranges import spread_between
from calib.verbs.compare.comparison import Comparison, Kept, compare
from calib.verbs.compare.difference import (
    POSES,
    as_lengths,
    common_ranges,
    own_indices,
    own_kinematics,
    place_twists,
    prior_precision,
    unknown_places,
)
from calib.verbs.compare.joint_trend import LEVEL, Trend, joint_trend

#: Schema of `RobotTrend.table`.
SCHEMA = "trend 1"

#: From the best to the worst: of several comparisons the worst counts.
_ORDER: tuple[Kept, ...] = ("pass", "undecided", "fail")

#: A joint's zero is not seen if less than this share of its effect is left beside motions of base and target.
_SEEN = 0.03

#: Smallest standard deviation of a zero [rad] or [m]: that of results without noise.
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class JointHistory:
    """The zero of one joint over K results."""

    #: Name of the joint
    joint: str
    #: ``"rad"`` or ``"m"``
    unit: str
    #: Change of the zero from the first result, shape (K,); NaN if it cannot be seen
    values: Array
    #: Standard deviations of the values by the noise of each result, shape (K,)
    stds: Array
    #: What it does over time, in months; None if frame and target can explain any change of it
    trend: Trend | None


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class RobotTrend(Value):
    """The result of `trend`: several calibrations of one robot over time."""

    #: The K results, by date
    results: tuple[Calibration, ...]
    #: Their files, or ``"1"``, ``"2"`` and so on as they were given
    names: tuple[str, ...]
    #: When each was measured, else calibrated
    dates: tuple[datetime, ...]
    #: The zero of each joint
    joints: tuple[JointHistory, ...]
    #: The first result compared with each later one
    comparisons: tuple[Comparison, ...]
    #: Tolerance of the target's displacement from the first result [m]; None: not given
    tolerance: float | None
    #: Whether all later results keep it; None without a tolerance
    kept: Kept | None

    @property
    def months(self) -> Array:
        """Time of each result since the first, shape (K,), in months."""
        return _months(self.dates)

    @property
    def changed(self) -> tuple[JointHistory, ...]:
        """The joints that are not steady."""
        return tuple(j for j in self.joints if j.trend is not None and j.trend.shape != "steady")

    def __repr__(self) -> str:
        """Return one line: number of results, and the joints that drift, have a step, or are not steady."""
        found = [f"{j.joint}: {j.trend.shape}" for j in self.changed if j.trend is not None]
        return one_line("RobotTrend", f"{len(self.results)} results", *(found or ["steady"]))

    def summary(self) -> str:
        """Return the trend as text, without colours, in 100 columns."""
        return str(shown_by("verbs.compare.trend_page").trend_text(self))

    def write_report(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write a page with the figures over time.

        Args:
            path: The file, .html.
            overwrite: Whether a file that exists is replaced.

        Returns:
            The path.

        Raises:
            FileError: The name ends otherwise, or the file exists or cannot be written.
            CalibError: Matplotlib is not installed.
        """
        check_path("path", path)
        return Path(
            shown_by("verbs.compare.trend_page").write_report(self, path, overwrite=overwrite)
        )

    def table(self) -> dict[str, Any]:
        """Return the trend as nested tables of plain values in SI units; docs/comparison.md has the keys."""
        joints = []
        for joint in self.joints:
            of_joint: dict[str, Any] = {
                "joint": joint.joint,
                "unit": joint.unit,
                "zeros": joint.values,
                "stds": joint.stds,
                "trend": None,
            }
            if joint.trend is not None:
                entries = asdict(joint.trend)
                at = entries.pop("step_at")
                entries["step_on"] = date_text(self.dates[at])
                of_joint["trend"] = entries
            joints.append(of_joint)
        results = []
        moves = [None, *(comparison.moves[0] for comparison in self.comparisons)]
        outcomes = ["", *(comparison.outcome for comparison in self.comparisons)]
        for name, date, result, move, outcome in zip(
            self.names, self.dates, self.results, moves, outcomes, strict=True
        ):
            results.append(
                {
                    "name": name,
                    "date": date_text(date),
                    "run": result.run,
                    "verdict": None if result.verdict is None else result.verdict.use,
                    "outcome": outcome or None,
                    "moved_rms_m": None if move is None else move.moved,
                    "moved_std_m": None if move is None else move.std,
                }
            )
        robot = self.results[0].nominal
        return {
            "schema": SCHEMA,
            "robot": {"name": robot.name, "base": robot.base, "tip": robot.tip},
            "serial": self.results[0].record.robot_serial or None,
            "results": results,
            "joints": joints,
            "level": LEVEL,
            "tolerance_m": self.tolerance,
            "kept": self.kept,
            "versions": versions(),
        }

    def write_json(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the trend as JSON.

        Args:
            path: The file.
            overwrite: Whether a file that exists is replaced.

        Returns:
            The path.

        Raises:
            FileError: The file exists, or cannot be written.
        """
        check_path("path", path)
        return write_table(self.table(), path, overwrite=overwrite)


def trend(
    results: Sequence[ResultInput],
    dates: Sequence[str] | None = None,
    *,
    tolerance: float | None = None,
) -> RobotTrend:
    """Find what the joint zeros of one robot do over several calibrations: steady, a drift, or a step.

    Args:
        results: Two or more: each a `Calibration`, or the path of a result file, in any order.
        dates: The date of each (``"2026-03-01"``); None: when it was measured, as its record says, else when it was
            calibrated.
        tolerance: Largest rms displacement of the target from the first result that is allowed [m]; None: none.

    Returns:
        The zero of each joint over time with its rate in a month, and the displacement of the target.

    Raises:
        ArgumentError: An argument of another type.
        CalibError: There are fewer than two results, or dates are missing, of another number, or in another form.
        FileError: A file cannot be read or is not a result.
        ModelError: The results are not of the same chains.

    Example:
        trend = calib.trend(["january.json", "march.json", "june.json"])
    """
    if isinstance(results, (str, Path)) or not isinstance(results, Sequence):
        raise ArgumentError(
            "The argument 'results' must be a list of results, or of the paths of their files."
        )
    if len(results) < 2:
        raise CalibError("A trend needs two results or more.")
    check_type("dates", dates, (list, tuple, type(None)), "a list of dates, or None")
    if dates is not None and len(dates) != len(results):
        raise CalibError(
            f"There are {len(dates)} dates for {len(results)} results; give one for each."
        )
    if tolerance is not None:
        check_number("tolerance", tolerance, 0.0)
    given = []
    for k, one in enumerate(results):
        result = result_of(one, f"results[{k}]")
        name = str(k + 1) if isinstance(one, Calibration) else Path(one).name
        date = _date_of(result, name) if dates is None else parse_date(dates[k])
        if date is None:
            raise CalibError(f"'{dates[k] if dates else ''}' is no date; write it as 2026-03-01.")
        given.append((date, name, result))
    given.sort(key=lambda one: one[0])
    in_order = tuple(result for _, _, result in given)
    names = tuple(name for _, name, _ in given)
    when = tuple(date for date, _, _ in given)

    comparisons = tuple(compare(in_order[0], later) for later in in_order[1:])
    kept = None
    if tolerance is not None:
        kept = max((c.within(tolerance) for c in comparisons), key=_ORDER.index)
    return RobotTrend(
        results=in_order,
        names=names,
        dates=when,
        joints=_joint_histories(in_order, _months(when)),
        comparisons=comparisons,
        tolerance=tolerance,
        kept=kept,
    )


def _date_of(result: Calibration, name: str) -> datetime:
    """Return when a result was measured, else when it was calibrated; CalibError if neither is stated."""
    date = parse_date(result.record.date) or parse_date(result.method.time)
    if date is None:
        stated = f"its record's '{result.record.date}' is none" if result.record.date else "none"
        raise CalibError(
            f"{name} states no date such as 2026-03-01 ({stated}); give the dates of all results: "
            '--dates "2026-01-10, 2026-03-01" (in Python dates=[...]).'
        )
    return date


def _months(dates: Sequence[datetime]) -> Array:
    """Return the time of dates since the first, shape (K,), in months."""
    return np.array([(date - dates[0]).total_seconds() / MONTH for date in dates])


def _joint_histories(results: Sequence[Calibration], months: Array) -> tuple[JointHistory, ...]:
    """Return the zero of each joint over K results, and what it does over time; the level is shared among joints."""
    names, units, values, stds, seen = zero_changes(results)
    level = LEVEL / max(int(seen.sum()), 1)
    histories = []
    for j, name in enumerate(names):
        found = joint_trend(months, values[:, j], stds[:, j], level) if seen[j] else None
        histories.append(JointHistory(name, units[j], values[:, j], stds[:, j], found))
    return tuple(histories)


def zero_changes(
    results: Sequence[Calibration],
) -> tuple[tuple[str, ...], tuple[str, ...], Array, Array, Mask]:
    """Return the change of each joint zero from the first to each of K results; see the module's text.

    Args:
        results: K results of the same chains.

    Returns:
        Names of the m joints; their units, ``"rad"`` or ``"m"``; the changes, shape (K, m), and their standard
        deviations by the noise of each result, shape (K, m), both NaN for joints that cannot be seen; and a mask of
        those that can, shape (m,).

    Raises:
        ModelError: The robot has no joint zeros.
    """
    first = results[0]
    turns = all(result.setup.rotation for result in results)
    ranges = reduce(common_ranges, [result.rows.ranges for result in results])
    q = spread_between(ranges, POSES)

    # Derivative of the target by the joint zeros, at the nominal robot, (N D, m), beside base and target.
    zeros = error_model(first.nominal, "zeros", target=False)
    place = (np.eye(4), first.setup.T_tip_target[0])
    nominal, twists = Kinematics(first.nominal, zeros, *place).twists(np.zeros(len(zeros)), q)
    gauge = as_lengths(
        place_twists(nominal)[:, :, unknown_places(results, turns=turns)], turns=turns
    )
    explain = np.linalg.pinv(gauge, rcond=1e-9)
    effect = as_lengths(twists, turns=turns)
    remaining = effect - gauge @ (explain @ effect)
    seen = np.linalg.norm(remaining, axis=0) >= _SEEN * np.linalg.norm(effect, axis=0)
    to_zeros = np.linalg.pinv(remaining[:, seen])

    values = np.full((len(results), len(zeros)), np.nan)
    stds = np.full_like(values, np.nan)
    reference = None
    for k, result in enumerate(results):
        own = own_indices(result)
        poses, slope = own_kinematics(result, first).twists(result.geometry.x[own], q)
        slopes = as_lengths(slope, turns=turns)
        reference = poses if reference is None else reference
        moved = _moved(reference, poses, turns=turns)
        values[k, seen] = to_zeros @ (moved - gauge @ (explain @ moved))
        to_own = to_zeros @ (slopes - gauge @ (explain @ slopes))
        C = result.covariance
        noise = (C - (C * prior_precision(result)) @ C)[np.ix_(own, own)]
        variance = np.einsum("mp,pr,mr->m", to_own, noise, to_own)
        stds[k, seen] = np.sqrt(np.maximum(variance, _ROUNDING**2))
    joints = tuple(name.removesuffix(".zero") for name in zeros.names)
    return joints, tuple(zeros.units), values, stds, np.asarray(seen)


def _moved(T_before: Array, T_after: Array, *, turns: bool) -> Array:
    """Return the displacement of N poses along the base's axes as lengths, shape (N D,) [m]."""
    R = T_after[:, :3, :3] @ T_before[:, :3, :3].transpose(0, 2, 1)
    # Rotation vectors of small rotations: half the skew part.
    angles = np.stack(
        [R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1
    )
    twists = np.hstack([T_after[:, :3, 3] - T_before[:, :3, 3], angles / 2.0])
    return as_lengths(twists[:, :, None], turns=turns)[:, 0]
