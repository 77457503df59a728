"""What ``calib evaluate`` prints: the outcome first, where targets are, errors and accuracy of each robot."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calib.identify.acceptance import Acceptance
    from calib.identify.accuracy import Accuracy
    from calib.identify.evaluation import Evaluation
    from calib.identify.result import Calibration
    from calib.identify.statistics import Errors

#: What the robots are called in the table of accuracies.
_SHORT = {
    "nominal": "nominal",
    "urdf": "URDF as it is",
    "calibration": "calibrated",
    "larger": "larger model",
}

#: Residuals that differ by less are the same [m] and [rad].
_SAME = 1e-9


def names_of(result: str) -> dict[str, str]:
    """What the robots are called in a sentence.

    Args:
        result: Name of the result's file.
    """
    return {
        "nominal": f"the nominal robot of {result}",
        "urdf": "the URDF as it is",
        "calibration": f"the robot with the joint origins of {result}",
        "larger": f"the robot with the larger model of {result}",
    }


def evaluation_text(
    found: Mapping[str, Evaluation],
    figures: Mapping[str, Accuracy],
    accepted: Acceptance | None,
    *,
    judged: str,
    result: str,
    source: str,
    notes: Sequence[str] = (),
) -> str:
    """Everything that was found.

    Args:
        found: The errors of each robot.
        figures: Their accuracy.
        accepted: Whether the tolerance is kept; None where none was stated.
        judged: The key of the robot that was judged.
        result: Name of the result's file.
        source: Where the targets are from, if they were not registered.
        notes: What else must be minded with the outcome.
    """
    from calib.identify.acceptance_text import acceptance_text, accuracy_text, poses_text

    parts = [_places_text(found["urdf"], source), _errors_text(found, result)]
    repeated = any(one.repeats[1] > 1 for one in figures.values())
    if accepted is not None or repeated:
        shown = {_SHORT[who]: one for who, one in figures.items() if not _twin(found, who, judged)}
        parts.append(accuracy_text(shown))
    if accepted is not None:
        name = names_of(result)[judged]
        parts = [acceptance_text(accepted, name, notes), *parts, poses_text(accepted, name)]
    return "\n\n".join(parts)


def own_urdf(found: Mapping[str, Evaluation], judged: str) -> str:
    """A sentence that says so where the URDF as it is, is neither robot of the result, and is not judged; or nothing.

    Args:
        found: The errors of each robot.
        judged: The key of the robot that is judged.
    """
    if len(found) == 1 or judged == "urdf" or _twin(found, "urdf", judged):
        return ""
    return "The URDF as it is, is another robot than the nominal and the calibrated one; --judge urdf judges it."


def unseen_text(c: Calibration, evaluation: Evaluation, judged: Accuracy) -> str:
    """A sentence that names the judged rows with joint values that the fit did not see, or nothing.

    Args:
        c: The result.
        evaluation: Of the robot that is judged.
        judged: Its accuracy.
    """
    import numpy as np

    from calib.identify.coverage import outside, outside_sentence

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
    types = [robot.inputs[k].type for k in known]
    chosen = np.isin(m.rows, [row for pose in judged.poses for row in pose.rows[:1]])
    q = m.joints_for(robot.joint_names)[chosen][:, known]
    said = outside_sentence(outside(ends, q, names, types), np.array(m.rows)[chosen].tolist())
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
        many = "s" if len(first.setup.groups) > 1 else ""
        lines.append(f"Measurement frame{many}: registered to the rows.")
    return "\n".join(lines)


def _errors_text(found: Mapping[str, Evaluation], result: str) -> str:
    """The errors of each robot as a table; the nominal one where it is not the URDF itself."""
    from calib.identify.statements import error_title
    from calib.identify.summary import angle_head, angle_row, error_head, error_row

    labels = {
        "nominal": f"the nominal robot, with its own target and frame of {result}",
        "urdf": "the URDF as it is",
        "calibration": f"with the joint origins of {result}",
        "larger": f"with the larger model of {result}",
    }
    results = {
        labels[who]: one
        for who, one in found.items()
        if who != "nominal" or not _same(one, found["urdf"])
    }
    lines = [error_head(error_title(found["urdf"].used)), *_table(results, error_row, "n")]
    if any(one.errors["all"].n_angle for one in results.values()):
        lines += ["", angle_head(), *_table(results, angle_row, "n_angle")]
    return "\n".join(lines)


def _twin(found: Mapping[str, Evaluation], who: str, judged: str) -> bool:
    """Whether this is the URDF as it is, and it stands in the table already as the nominal or the calibrated robot."""
    if who != "urdf" or judged == "urdf":
        return False
    own = found["urdf"].robot.origins()
    return any(
        all(abs(T - own[joint]).max() < _SAME for joint, T in found[other].robot.origins().items())
        for other in ("nominal", "calibration")
        if other in found
    )


def _same(one: Evaluation, other: Evaluation) -> bool:
    """Whether two robots err alike."""
    return bool(abs(one.residual - other.residual).max(initial=0.0) < _SAME)


def _table(
    results: Mapping[str, Evaluation], row: Callable[[str, Errors], str], count: str
) -> list[str]:
    """The rows of a table of lengths or angles; ``count`` names the attribute that says how many there are."""
    import numpy as np

    lines = []
    for label, result in results.items():
        lines.append(textwrap.shorten(label, 99, placeholder="...") + ":")
        sizes = {name: getattr(errors, count) for name, errors in result.errors.items()}
        # Where the table sets none aside, nothing says that anything is estimated from these rows.
        called = {} if np.any(result.measurements.validation) else {"estimation": "measured"}
        for name, errors in result.errors.items():
            said = name == "all" and sizes["all"] in (sizes["estimation"], sizes["validation"])
            if sizes[name] and not said:
                lines.append(row(f"  {called.get(name, name)} rows", errors))
    return lines
