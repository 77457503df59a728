"""Places of targets and measurement frames of a result, with their uncertainty, in sentences."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import pinocchio as pin

import calib.data.kinds as registry
from calib.data.kinds import Kind
from calib.model.error_model import placed_name
from calib.result.calibration import CalibrationValues
from calib.text.layout.lines import deg, mm
from calib.units import Array

#: Targets, or measurement frames, that are listed; the others are counted.
_MOST_PLACES = 6

#: A target further than this from the position given was given wrongly, not mounted inexactly [m].
_GIVEN_WRONGLY = 5e-3

_DEG = math.degrees(1.0)


def target_sentences(c: CalibrationValues, most: int = _MOST_PLACES) -> list[str]:
    """Word the place of each target in the tip, its uncertainty, and its distance from the place given.

    Args:
        c: The result.
        most: The most targets that get a sentence each; the others are counted.

    Returns:
        The sentences.
    """
    names, count = c.setup.target_names, len(c.setup.targets)
    sentences = [_target(c, number, name) for number, name in enumerate(names[:most])]
    if count > most:
        sentences.append(f"... and {count - most} more targets")
    return sentences


def _target(c: CalibrationValues, t: int, name: str) -> str:
    """Word the place of target number ``t``; the name is empty if there is only one."""
    T, rotation = c.setup.T_tip_target[t], c.setup.rotation
    label = f"Target '{name}'" if name else "Target"
    place = f"({_listed(T[:3, 3])}) mm{_rpy(T) if rotation else ''} in {c.nominal.tip}"
    if not c.setup.target_unknown[t]:
        return f"{label}: {place}, as given."
    if placed_name("target", "x", name) not in c.model.names:
        return f"{label}: registered to its validation rows, {place}."
    interval = f"({_half_widths(c, 'target', 'xyz', name)}) mm"
    if rotation:
        turns = _half_widths(c, "target", ("rx", "ry", "rz"), name)
        interval += f" and ({turns}) deg about its axes"
    if not c.setup.target_given[t]:
        return f"{label}: estimated at {place}, 95 % ± {interval}."
    moved = float(np.linalg.norm(T[:3, 3] - c.nominal_setup.T_tip_target[t, :3, 3]))
    text = f"{label}: {place}, 95 % ± {interval}; {mm(moved, 1)} mm from the position given."
    if moved > _GIVEN_WRONGLY:
        text += " Check the sign and the order of the numbers given."
    return text


def frame_sentences(c: CalibrationValues, most: int = _MOST_PLACES) -> list[str]:
    """Word the pose of the base in each frame that was estimated, and its uncertainty.

    Args:
        c: The result.
        most: The most frames that get a sentence each; the others are counted.

    Returns:
        The sentences; of a socket the point in the base, of a plane its normal and distance.
    """
    several = len(c.setup.groups) > 1
    estimated = [f for f, directions in enumerate(c.setup.unknown) if directions]
    sentences = [_frame(c, f, c.setup.groups[f] if several else "") for f in estimated[:most]]
    if len(estimated) > most:
        sentences.append(f"... and {len(estimated) - most} more stations")
    return sentences


def _frame(c: CalibrationValues, f: int, group: str) -> str:
    """Word estimated frame number ``f``; the group is empty if there is only one."""
    T, directions = c.setup.T_frame_base[f], c.setup.unknown[f]
    kinds = _kinds_in(c, f)
    fitted = placed_name("frame", directions[0], group) in c.model.names
    label = min(kind.place for kind in kinds)  # of an anchor in a socket: anchor
    if group:
        label += f" '{group}'"
    if not fitted:
        label += ", registered to its validation rows"
    own_directions = {kind.directions if kind.own_frame else () for kind in kinds}
    base = c.nominal.base
    if own_directions == {("x", "y", "z")}:
        return f"{label}: estimated at ({_listed(-T[:3, :3].T @ T[:3, 3])}) mm in {base}."
    if own_directions == {("z", "rx", "ry")}:
        normal = ", ".join(f"{v:.5f}" for v in T[2, :3])
        return (
            f"{label}: estimated with the normal ({normal}) in {base}, {mm(-T[2, 3])} mm along it."
        )
    place = f"{label}: {base} estimated at ({_listed(T[:3, 3])}) mm{_rpy(T)} in it"
    return f"{place}; {_frame_interval(c, f, group)}." if fitted else f"{place}."


def _kinds_in(c: CalibrationValues, f: int) -> list[Kind]:
    """Kinds of the rows in frame number ``f``."""
    pairs = zip(c.rows.kinds, c.rows.groups, strict=True)
    names = {kind for kind, group in pairs if group == c.setup.groups[f]}
    return [registry.get(name) for name in names]


def _frame_interval(c: CalibrationValues, f: int, group: str) -> str:
    """Word the 95 % intervals of the estimated directions of frame number ``f``."""
    directions = c.setup.unknown[f]
    lengths = [direction for direction in directions if direction in "xyz"]
    angles = [direction for direction in directions if direction not in "xyz"]
    parts = []
    if lengths:
        parts.append(f"({_half_widths(c, 'frame', lengths, group)}) mm")
    if angles:
        parts.append(f"({_half_widths(c, 'frame', angles, group)}) deg")
    axes = "the frame" if c.setup.own_axes[f] else c.nominal.base
    names = ", ".join(directions)
    return f"95 % ± {' and '.join(parts)} for {names} along and about the axes of {axes}"


def _listed(lengths: Iterable[float]) -> str:
    """List lengths [m] in mm."""
    return ", ".join(map(mm, lengths))


def _rpy(T: Array) -> str:
    """Format roll, pitch and yaw of a pose."""
    return f", rpy ({', '.join(map(deg, pin.rpy.matrixToRpy(T[:3, :3])))}) deg"


def _half_widths(c: CalibrationValues, place: str, directions: Iterable[str], name: str) -> str:
    """List half the 95 % intervals of parameters of a frame or target, [mm] or [deg]."""
    factors = {"m": 1e3, "rad": _DEG}
    parameters = [c.parameter(placed_name(place, direction, name)) for direction in directions]
    return ", ".join(f"{0.5 * factors[p.unit] * (p.high - p.low):.3g}" for p in parameters)
