"""What a report says of how it came about: rows, noise, joint ranges, method, files, versions, command, date."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import datetime, timezone

import numpy as np

from calib.identify.coverage import outside_sentence
from calib.identify.result import Calibration
from calib.identify.result_tables import versions
from calib.identify.statements import expected_text, noise_text, repeats_text, solver_text
from calib.show.document import Block, Bullets, Facts, Paragraph, Signatures, Table, blocks, table

#: More names than this are counted.
_MOST_NAMES = 12

#: A joint value beyond a limit by less is at it: tables and URDFs round [m or rad].
_EXACT = 1e-4

#: What a kind of row measures.
_KINDS = {
    "point": "position of the target",
    "pose": "position and orientation of the target",
    "distance": "distance from the target to an anchor",
    "pair": "distance between the target's places at two poses",
    "fixed": "the target sits at one unknown point",
    "plane": "the target touches one unknown plane",
}


def heading_facts(c: Calibration, date: str) -> Facts:
    """Which robot, which rows, when."""
    m = c.measurements
    return Facts(
        (
            ("Robot", f"{c.nominal.name}, {c.nominal.base} to {c.nominal.tip}, {_axes(c)}"),
            (
                "Measurements",
                f"{m.source or 'from memory'}: {m.estimation.sum():,} rows to estimate, "
                f"{m.validation.sum():,} to validate",
            ),
            ("Date of the report", date),
        )
    )


def measurement_blocks(c: Calibration) -> tuple[Block, ...]:
    """Rows, kinds, targets, set-ups, noise, joint ranges."""
    return blocks(
        Facts(tuple(_measured(c))), _ranges(c), *(Paragraph(text) for text in _outside(c))
    )


def method_blocks(c: Calibration) -> tuple[Block, ...]:
    """How it was computed."""
    v = c.cross_validation
    lines = [
        f"{solver_text(c)}. {c.solution.message}",
        "Outliers "
        + (
            "have no weight in the fit."
            if c.fitted.task.robust
            else "keep their weight in the fit."
        ),
        f"Errors of left-out rows: {v.method}, {v.folds} fits."
        if v is not None
        else "No rows were left out in turn (no cross-validation), so there is no verdict.",
    ]
    sizes = {
        "data": "The sizes of the robot's errors (priors) were found from the data.",
        "given": "The sizes of the robot's errors (priors) were given.",
        "off": "No priors on the robot's errors.",
    }
    return blocks(Bullets((*lines, sizes[c.cell.priors.sizes])))


def trace_blocks(c: Calibration, command: str, date: str) -> tuple[Block, ...]:
    """Files with their hashes, versions, the command and the date: what it takes to do it again."""
    m, urdf = c.measurements, c.nominal.urdf
    pairs = [
        ("Nominal robot", urdf.source or "from memory"),
        ("  SHA-256", urdf.sha256),
        ("Measurements", m.source or "from memory"),
        ("  SHA-256", m.sha256.replace(" + ", ", ") or "-"),
        ("Corrected robot", "as written without a target link"),
        ("  SHA-256", c.robot.urdf.sha256),
        ("Software", ", ".join(f"{name} {number}" for name, number in versions().items())),
        ("Command", command or "not from the command line"),
        ("Date of the report", date),
    ]
    return (Facts(tuple(pairs)),)


def sign_blocks(c: Calibration, date: str) -> tuple[Block, ...]:
    """What is signed, room for what no file knows, and to sign."""
    verdict = "none" if c.verdict is None else c.verdict.use
    return (
        Paragraph(
            f"This report of {date} is about the robot {c.nominal.name} as the files above describe it. Its verdict: "
            f"{verdict}."
        ),
        Signatures(
            blanks=(
                "Robot, serial number",
                "Instrument, serial number",
                "Place, temperature",
            ),
            parties=("Calibrated by", "Approved by"),
            lines=("Name", "Date", "Signature"),
        ),
    )


def report_date() -> str:
    """Now, or what ``SOURCE_DATE_EPOCH`` says, in UTC."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH", "")
    # Whoever sets it wants the same bytes twice; what is no number is no date.
    when = (
        datetime.fromtimestamp(int(epoch), timezone.utc)
        if epoch.isdecimal()
        else datetime.now(timezone.utc)
    )
    return f"{when:%Y-%m-%d %H:%M} UTC"


def _axes(c: Calibration) -> str:
    """How many joints."""
    count = len(c.nominal.joints)
    return f"{count} joint{'s' * (count > 1)}"


def _measured(c: Calibration) -> Iterator[tuple[str, str]]:
    """What was measured, and how well."""
    m = c.measurements
    yield (
        "Rows",
        f"{len(m):,}: {m.estimation.sum():,} to estimate, {m.validation.sum():,} to validate (column 'set')"
        + (f"; {len(m.unmeasured):,} more without a measurement, left out" if m.unmeasured else ""),
    )
    kinds = Counter(m.kinds)
    yield (
        "Each row measures",
        "; ".join(f"{_KINDS.get(kind, kind)} ({count:,} rows)" for kind, count in kinds.items()),
    )
    if len(set(m.targets)) > 1:
        yield "Targets", _named(tuple(dict.fromkeys(m.targets)))
    if len(set(m.groups)) > 1:
        yield "Set-ups", _named(tuple(dict.fromkeys(m.groups)))
    yield "Measurement frame", _frame(c)
    yield "Noise of the rows", noise_text(c).removeprefix("Noise: ")
    if m.sigma is not None or c.cell.sigma is not None:
        given = c.cell.sigma if m.sigma is None else float(np.nanmedian(m.sigma))
        yield "Noise stated", f"{1e3 * (given or 0.0):.3f} mm a coordinate (median of the rows)"
    if repeats_text(c):
        yield "Repeats", repeats_text(c)
    held = c.nominal.held
    if held:
        yield (
            "Joints held",
            ", ".join(f"{name} at {_value(c, name, v)}" for name, v in held.items()),
        )
    if m.ignored:
        yield "Columns not used", _named(m.ignored)
    yield (
        "Expected error",
        f"{expected_text(c).removeprefix('Expected error, ').removesuffix('.')}; one standard deviation of the "
        "target's position, from the covariance of the parameters.",
    )


def _frame(c: Calibration) -> str:
    """In which frame positions are given."""
    found = [
        group
        for group, directions in zip(c.setup.groups, c.setup.unknown, strict=True)
        if directions
    ]
    if not found:
        given = c.cell.T_frame_base is not None or bool(c.cell.frames)
        return f"known: {'as the set-up places it' if given else c.nominal.base}"
    return f"estimated from the rows, for {len(found)} of {len(c.setup.groups)} set-ups"


def _value(c: Calibration, name: str, value: float) -> str:
    """A joint's value with its unit."""
    slides = any(
        joint.name == name and joint.type == "prismatic" for joint in c.nominal.urdf.joints
    )
    return f"{1e3 * value:.3f} mm" if slides else f"{np.degrees(value):.3f} deg"


def _named(names: Sequence[str]) -> str:
    """Names, the first dozen."""
    shown = ", ".join(f"'{name}'" for name in names[:_MOST_NAMES])
    rest = len(names) - _MOST_NAMES
    return shown + (f" and {rest} more" if rest > 0 else "")


def _ranges(c: Calibration) -> Table | None:
    """Joint values of the estimation rows beside the limits."""
    m = c.measurements
    q = m.joints_for(c.nominal.joint_names)[m.estimation]
    cells, beyond = [], []
    for joint, values in zip(c.nominal.inputs, q.T, strict=True):
        slides = joint.type == "prismatic"
        scale, unit = (1e3, "mm") if slides else (float(np.degrees(1.0)), "deg")
        low, high = float(values.min()), float(values.max())
        limits = ["-" if v is None else f"{scale * v:.2f}" for v in (joint.lower, joint.upper)]
        share = "-"
        if joint.lower is not None and joint.upper is not None and joint.upper > joint.lower:
            inside = max(0.0, min(high, joint.upper) - max(low, joint.lower))
            share = f"{100.0 * inside / (joint.upper - joint.lower):.0f} %"
            if low < joint.lower - _EXACT or high > joint.upper + _EXACT:
                beyond.append(f"'{joint.name}'")
        cells.append(
            (joint.name, unit, f"{scale * low:.2f}", f"{scale * high:.2f}", *limits, share)
        )
    return table(
        "Joint values of the estimation rows",
        ("joint", "unit", "lowest", "highest", "lower", "upper", "used"),
        cells,
        "llrrrrr",
        groups=(("", 2), ("measured", 2), ("limit", 2), ("", 1)),
        note="Used: share of the range between the limits. Beyond what was measured errors may be larger."
        + (f" Measured beyond the limits of the URDF: {', '.join(beyond)}." if beyond else ""),
    )


def _outside(c: Calibration) -> list[str]:
    """Rows for validation beyond the joint values that were fitted, where the verdict does not name them."""
    m = c.measurements
    said = outside_sentence(c.outside, np.array(m.rows)[m.validation])
    reasons = () if c.verdict is None else c.verdict.reasons
    if not said or any(said in reason for reason in reasons):
        return []
    return [f"Validation rows beyond the joint values that were fitted: {said}."]
