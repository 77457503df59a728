"""What `calib evaluate` finds of every robot that a URDF and a result hold: one value, its text and its table."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import CalibError, choices
from calib.estimate.statistics import Errors
from calib.result.acceptance import Acceptance, acceptance
from calib.result.accuracy import (
    Accuracy,
    accuracy,
    fitted_rows,
)
from calib.result.calibration import Calibration
from calib.result.calibration_fields import ERRORS, pose_table, versions
from calib.result.evaluation import Evaluation, evaluate, evaluate_larger, hint, moved
from calib.result.support import outside, outside_sentence
from calib.robot.robot import Robot
from calib.text.acceptance import (
    acceptance_reasons,
    acceptance_text,
    accuracy_text,
    figures_of,
    poses_text,
)
from calib.text.summary import ANGLE_HEAD, angle_row, error_head, error_row, error_title

#: Residuals that differ by less are the same [m] and [rad].
_SAME = 1e-9

#: The robots: in the table of accuracies, and in a sentence.
_NAMES = {
    "nominal": ("nominal", "the nominal robot of {}"),
    "urdf": ("URDF as it is", "the URDF as it is"),
    "calibration": ("calibrated", "the robot with the joint origins of {}"),
    "larger": ("larger model", "the robot with the larger model of {}"),
}

#: Attribute of a pose, and its key in the file.
_POSE_KEYS = {
    **{name: name for name in ("rows", "kind", "group", "target")},
    **{name: f"{name}_m" for name in ("ap", "ap_xyz", "rp", "single")},
    **{f"{name}_angle": f"{name}_rad" for name in ("ap", "single")},
    **{name: f"{name}_rad" for name in ("ap_abc", "rp_abc")},
}


@dataclass(frozen=True, slots=True, eq=False)
class Evaluated:
    """What was found, by ``"nominal"``, ``"urdf"``, ``"calibration"`` and ``"larger"`` as far as they are there."""

    found: Mapping[str, Evaluation]
    figures: Mapping[str, Accuracy]
    judged: str
    accepted: Acceptance | None
    result: str  # name of its file
    notes: tuple[str, ...]  # what must be minded with the outcome
    advice: str  # a set-up that would explain the rows far better

    @property
    def name(self) -> str:
        """What the robot is called that is judged."""
        return _NAMES[self.judged][1].format(self.result)


def evaluate_all(
    robot: Robot,
    table: Measurements,
    cell: Cell,
    c: Calibration | None,
    *,
    result: str = "",
    which: tuple[str, ...] = (),
    judge: str | None = None,
    limits: Mapping[str, Any] | None = None,
) -> Evaluated:
    """Evaluate the robot as it is; and of a result its nominal robot, its joint origins, and its larger model.

    Args:
        robot: The robot.
        table: The rows.
        cell: The set-up.
        c: The result.
        result: Name of its file.
        which: Which of its ``"frame"`` and ``"target"`` are used.
        judge: Which robot is judged; by default the corrected one.
        limits: What `calib.acceptance` is given; without it nothing is judged.

    Raises:
        CalibError: There is no such robot to be judged, or what `evaluate` and `acceptance` raise.
    """
    seen = np.zeros(len(table), dtype=bool)
    if c is None:
        found = {"urdf": evaluate(robot, table, cell)}
    else:
        states = {
            "nominal": (c.uncorrected(robot), c.nominal_setup),
            "urdf": (robot, c.setup),
            "calibration": (c.corrected(robot), c.setup),
        }
        found = {
            who: evaluate(one, table, cell, known=known, which=which)
            for who, (one, known) in states.items()
        }
        larger = evaluate_larger(c, robot, table, cell, which)
        found |= {} if larger is None else {"larger": larger}
        seen = fitted_rows(c, robot, table, cell)
    judged = judge or ("urdf" if c is None else "calibration")
    if judged not in found:
        reason = "takes --calibration" if c is None else f"is none of {result}"
        raise CalibError(f"--judge {judged} {reason}; choose one of {choices(found)}.")
    figures = {who: accuracy(one, seen=seen) for who, one in found.items()}
    accepted = acceptance(found[judged], **limits, seen=seen) if limits else None
    notes, advice = [], ""
    if c is None:
        advice = hint(found["urdf"], cell)
    elif set(which) == {"frame", "target"}:
        advice = moved(found["calibration"].robot, table, cell, c.setup)
    if c is not None and judged in ("calibration", "larger"):
        notes.append(_unseen_text(c, found[judged], figures[judged]))
    if len(found) > 1 and judged != "urdf" and _own(found):
        notes.append(
            "The URDF as it is, is another robot than the nominal and the calibrated one; --judge urdf judges it."
        )
    notes = [note for note in (*notes, advice) if note]
    return Evaluated(found, figures, judged, accepted, result, tuple(notes), advice)


def evaluated_text(e: Evaluated, source: str) -> str:
    """Everything as text of 100 columns: the outcome first, where targets are, errors and accuracy of each robot.

    Args:
        e: What was found.
        source: Where the targets are from, if they were not registered.
    """
    parts = [_places_text(e.found["urdf"], source), _errors_text(e.found, e.result)]
    if e.accepted is not None or any(one.repeats[1] > 1 for one in e.figures.values()):
        shown = {
            _NAMES[who][0]: one
            for who, one in e.figures.items()
            if who != "urdf" or e.judged == "urdf" or _own(e.found)
        }
        parts.append(accuracy_text(shown))
    if e.accepted is not None:
        said = acceptance_text(e.accepted, e.name, e.notes)
        parts = [said, *parts, poses_text(e.accepted, e.name)]
    elif e.advice:
        parts.append(textwrap.fill(e.advice, 100, break_on_hyphens=False))
    return "\n\n".join(parts)


def evaluated_table(e: Evaluated) -> dict[str, Any]:
    """Everything as nested tables in SI units, which `calib evaluate --json` writes."""
    a = e.accepted
    accepted = None if a is None else acceptance_table(a, e.judged, e.name, e.notes)
    return {
        **evaluation_table(e.found),
        "accuracy": {who: accuracy_table(one) for who, one in e.figures.items()},
        "acceptance": accepted,
    }


def evaluation_table(found: Mapping[str, Evaluation]) -> dict[str, Any]:
    """The errors of each robot, and where targets and frames are for the URDF as it is."""
    e = found["urdf"]
    m, setup = e.measurements, e.setup
    frames = zip(setup.groups, setup.T_frame_base, strict=True)
    targets = zip(setup.targets, setup.T_tip_target, strict=True)
    return {
        "schema": "evaluation 1",  # a word, so that it is not taken for a result's
        "robot": {"name": e.robot.name, "base": e.robot.base, "tip": e.robot.tip},
        "frames": {
            **pose_table(e.T_frame_base, "frame_base_"),
            "target_m": e.target,
            "registered": list(e.registered),
            "set_ups": [{"group": name, **pose_table(T, "frame_base_")} for name, T in frames],
            "targets": [{"target": name, **pose_table(T)} for name, T in targets],
        },
        "errors": {
            who: {name: ERRORS.table(errors) for name, errors in one.errors.items()}
            for who, one in found.items()
        },
        "inputs": {
            "urdf": {"name": e.robot.urdf.source, "sha256": e.robot.urdf.sha256},
            "measurements": {"name": m.source, "sha256": m.sha256, "rows": len(m)},
        },
        "versions": versions(),
    }


def accuracy_table(one: Accuracy) -> dict[str, Any]:
    """Accuracy and repeatability of one robot."""
    low, high = one.repeats
    names = ("rows", "measured", "fitted", "seen")
    table: dict[str, Any] = {name: getattr(one, name) for name in names}
    table |= {"repeats_min": low, "repeats_max": high}
    for unit, angle in (("m", False), ("rad", True)):
        keys = ("ap_max", "ap_mean", "rp_max", "rp_mean", "single_max")
        figures = zip(keys, figures_of(one, angle=angle), strict=True)
        table |= {f"{key}_{unit}": value for key, value in figures}
    poses = [{key: getattr(p, name) for name, key in _POSE_KEYS.items()} for p in one.poses]
    return table | {"poses": poses}


def acceptance_table(
    a: Acceptance, who: str, judged: str, notes: Sequence[str] = ()
) -> dict[str, Any]:
    """An acceptance of the robot with the key ``who``, which is called ``judged``."""
    table: dict[str, Any] = {
        "outcome": a.outcome,
        "robot": who,
        "criterion": a.criterion,
        "within": a.within,
        "share": a.share,
        "length": None,
        "angle": None,
        "reasons": acceptance_reasons(a, judged, notes),
    }
    for check, angle in a.checks:
        names = ("figure", "tolerance", "uncertainty", "random", "held")
        unit = "rad" if angle else "m"
        table["angle" if angle else "length"] = {
            **{f"{name}_{unit}": getattr(check, name) for name in names},
            "factor": check.factor,
            "outcome": check.outcome,
        }
    return table


def _unseen_text(c: Calibration, evaluation: Evaluation, judged: Accuracy) -> str:
    """The judged rows with joint values that the fit did not see, or nothing."""
    robot, m = evaluation.robot, evaluation.measurements
    ranges = dict(zip(c.nominal.joint_names, c.ranges, strict=True))
    # A joint that turns without end has no range to be outside of.
    known = [
        k
        for k, joint in enumerate(robot.inputs)
        if joint.type != "continuous" and np.isfinite(ranges.get(joint.name, np.nan)).all()
    ]
    names = [robot.joint_names[k] for k in known]
    ends = np.array([ranges[name] for name in names]).reshape(-1, 2).T
    chosen = np.isin(m.rows, [row for pose in judged.poses for row in pose.rows[:1]])
    q = m.joints_for(robot.joint_names)[chosen][:, known]
    found = outside(ends, q, names, [robot.inputs[k].type for k in known])
    said = outside_sentence(found, np.array(m.rows)[chosen].tolist())
    return f"The calibration did not see such joint values: {said}." if said else ""


def _places_text(first: Evaluation, source: str) -> str:
    """Where targets and frames are, and how that is known."""
    how = "registered to the rows" if "target" in first.registered else source
    lines = []
    targets = first.setup.targets
    for name, T in zip(targets, first.setup.T_tip_target, strict=True):
        place = ", ".join(f"{1e3 * v:.3f}" for v in T[:3, 3])
        label = f"Target '{name}'" if len(targets) > 1 else "Target"
        lines.append(textwrap.fill(f"{label} at ({place}) mm in {first.robot.tip}, {how}.", 100))
    if "frame" in first.registered:
        many = "s" * (len(first.setup.groups) > 1)
        lines.append(f"Measurement frame{many}: registered to the rows.")
    return "\n".join(lines)


def _errors_text(found: Mapping[str, Evaluation], result: str) -> str:
    """The errors of each robot as tables; the nominal one where it is not the URDF itself."""
    urdf = found["urdf"]
    shown = {
        _NAMES[who][1].format(result): one
        for who, one in found.items()
        if who != "nominal" or not abs(one.residual - urdf.residual).max(initial=0.0) < _SAME
    }

    def table(head: str, row: Callable[[str, Errors], str], count: str) -> str:
        """Of lengths or angles; ``count`` names the attribute that says how many there are."""
        lines = [head]
        for label, one in shown.items():
            lines.append(textwrap.shorten(label, 99, placeholder="...") + ":")
            sizes = {name: getattr(errors, count) for name, errors in one.errors.items()}
            # Where the table sets none aside, nothing says that anything is estimated from these rows.
            called = {} if np.any(one.measurements.validation) else {"estimation": "measured"}
            for name, errors in one.errors.items():
                said = name == "all" and sizes["all"] in (sizes["estimation"], sizes["validation"])
                if sizes[name] and not said:
                    lines.append(row(f"  {called.get(name, name)} rows", errors))
        return "\n".join(lines)

    parts = [table(error_head(error_title(urdf.used)), error_row, "n")]
    if any(one.errors["all"].n_angle for one in shown.values()):
        parts.append(table(ANGLE_HEAD, angle_row, "n_angle"))
    return "\n\n".join(parts)


def _own(found: Mapping[str, Evaluation]) -> bool:
    """Whether the URDF as it is, is neither the nominal nor the calibrated robot."""
    own = found["urdf"].robot.origins()
    return not any(
        all(abs(T - own[joint]).max() < _SAME for joint, T in found[other].robot.origins().items())
        for other in ("nominal", "calibration")
        if other in found
    )
