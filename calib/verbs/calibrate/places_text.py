"""Places of targets and measurement frames of a result, with their uncertainty, in sentences."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
import pinocchio as pin

import calib.data.kinds as registry
from calib.basics.arrays import Array
from calib.data.kinds import Kind
from calib.model.error_model import placed_name
from calib.result.calibration import Calibration
from calib.show.lines import deg, mm

#: Targets, or measurement frames, that are listed; the others are counted.
_MOST_PLACES = 6

#: A target further than this from the position given was given wrongly, not mounted inexactly [m].
_GIVEN_WRONGLY = 5e-3

_DEG = math.degrees(1.0)


def target_sentences(c: Calibration, most: int = _MOST_PLACES) -> list[str]:
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


def _target(c: Calibration, t: int, name: str) -> str:
    """Word the place of a target in the tip, its uncertainty, and its distance from the place given.

    Args:
        c: The result.
        t: The target's index in ``c.setup.targets``, from 0.
        name: Its name; empty if there is only one.
    """
    T_tip_target = c.setup.T_tip_target[t]
    place = f"({_listed(T_tip_target[:3, 3])}) mm"
    if c.setup.rotation:
        place += _rpy(T_tip_target)
    place += f" in {c.nominal.tip}"
    noun = "Board" if c.rows.images_of(np.ones(len(c.rows), dtype=bool)) else "Target"
    label = f"{noun} '{name}'" if name else noun
    if not c.setup.target_unknown[t]:
        return f"{label}: {place}, as given."
    if placed_name("target", "x", name) not in c.model.names:
        return f"{label}: registered to its validation rows, {place}."
    interval = _target_interval(c, name)
    if not c.setup.target_given[t]:
        return f"{label}: estimated at {place}, {interval}."
    return f"{label}: {place}, {interval}; {_distance_from_given(c, t)}"


def _target_interval(c: Calibration, name: str) -> str:
    """Word the 95 % intervals of the place of a fitted target; the name is empty if there is only one."""
    lengths = _half_widths(c, "target", "xyz", name)
    interval = f"95 % ± ({lengths}) mm"
    if c.setup.rotation:
        angles = _half_widths(c, "target", ("rx", "ry", "rz"), name)
        interval += f" and ({angles}) deg about its axes"
    return interval


def _distance_from_given(c: Calibration, t: int) -> str:
    """Word the distance of target number ``t``, from 0, from the position given, and what a large one means."""
    estimated = c.setup.T_tip_target[t, :3, 3]
    given = c.nominal_setup.T_tip_target[t, :3, 3]
    distance = float(np.linalg.norm(estimated - given))
    text = f"{mm(distance, 1)} mm from the position given."
    if distance > _GIVEN_WRONGLY:
        text += " Check the sign and the order of the numbers given."
    return text


def frame_sentences(c: Calibration, most: int = _MOST_PLACES) -> list[str]:
    """Word the pose of the base in each frame that was estimated, and its uncertainty.

    Args:
        c: The result.
        most: The most frames that get a sentence each; the others are counted.

    Returns:
        The sentences; of a socket the point in the base, of a plane its normal and distance.
    """
    estimated = [f for f, directions in enumerate(c.setup.unknown) if directions]
    sentences = [_frame(c, f) for f in estimated[:most]]
    if len(estimated) > most:
        sentences.append(f"... and {len(estimated) - most} more stations")
    return sentences


def _frame(c: Calibration, f: int) -> str:
    """Word the place of an estimated frame, and its uncertainty.

    Args:
        c: The result.
        f: The frame's index in ``c.setup.groups``, from 0.
    """
    # In the names of parameters and in the text the group of an only station is left out.
    group = c.setup.groups[f] if len(c.setup.groups) > 1 else ""
    kinds = _kinds_in(c, f)
    label = min(kind.place for kind in kinds)  # of an anchor in a socket: anchor
    if group:
        label += f" '{group}'"
    first_direction = c.setup.unknown[f][0]
    is_fitted = placed_name("frame", first_direction, group) in c.model.names
    if not is_fitted:
        label += ", registered to its validation rows"
    text = f"{label}: {_frame_place(c, f, kinds)}"
    if is_fitted and not _is_point(kinds) and not _is_plane(kinds):
        text += f"; {_frame_interval(c, f, group)}"
    return text + "."


def _frame_place(c: Calibration, f: int, kinds: Sequence[Kind]) -> str:
    """Word the place of an estimated frame.

    It is the point of a socket or an anchor, the normal and distance of a plane, and else the pose of the base in it.

    Args:
        c: The result.
        f: The frame's index in ``c.setup.groups``, from 0.
        kinds: Kinds of its rows.
    """
    T_frame_base = c.setup.T_frame_base[f]
    position = T_frame_base[:3, 3]
    base = c.nominal.base
    if any(kind.is_image for kind in kinds):
        T_base_camera = np.linalg.inv(T_frame_base)
        return f"estimated at ({_listed(T_base_camera[:3, 3])}) mm{_rpy(T_base_camera)} in {base}"
    if _is_point(kinds):
        p_base_point = -T_frame_base[:3, :3].T @ position
        return f"estimated at ({_listed(p_base_point)}) mm in {base}"
    if _is_plane(kinds):
        normal = ", ".join(f"{v:.5f}" for v in T_frame_base[2, :3])
        return f"estimated with the normal ({normal}) in {base}, {mm(-position[2])} mm along it"
    return f"{base} estimated at ({_listed(position)}) mm{_rpy(T_frame_base)} in it"


def _is_point(kinds: Iterable[Kind]) -> bool:
    """Return True if the rows of a frame depend on its origin alone: a socket or an anchor."""
    return all(kind.own_frame and kind.directions == ("x", "y", "z") for kind in kinds)


def _is_plane(kinds: Iterable[Kind]) -> bool:
    """Return True if the rows of a frame depend on the normal and distance of its plane z = 0 alone."""
    return all(kind.own_frame and kind.directions == ("z", "rx", "ry") for kind in kinds)


def _kinds_in(c: Calibration, f: int) -> list[Kind]:
    """Kinds of the rows in the frame with index ``f`` in ``c.setup.groups``, each once."""
    pairs = zip(c.rows.kinds, c.rows.groups, strict=True)
    names = {kind for kind, group in pairs if group == c.setup.groups[f]}
    return [registry.get(name) for name in names]


def _frame_interval(c: Calibration, f: int, group: str) -> str:
    """Word the 95 % intervals of the estimated directions of a frame.

    Args:
        c: The result.
        f: The frame's index in ``c.setup.groups``, from 0.
        group: The group in the names of its parameters; empty if there is only one.
    """
    directions = c.setup.unknown[f]
    lengths = [direction for direction in directions if direction in "xyz"]
    angles = [direction for direction in directions if direction not in "xyz"]
    parts = []
    if lengths:
        parts.append(f"({_half_widths(c, 'frame', lengths, group)}) mm")
    if angles:
        parts.append(f"({_half_widths(c, 'frame', angles, group)}) deg")
    axes = "the frame" if c.setup.own_axes[f] else c.nominal.base
    intervals = " and ".join(parts)
    names = ", ".join(directions)
    return f"95 % ± {intervals} for {names} along and about the axes of {axes}"


def _listed(lengths: Iterable[float]) -> str:
    """List lengths [m] in mm."""
    return ", ".join(map(mm, lengths))


def _rpy(T: Array) -> str:
    """Format roll, pitch and yaw of a pose (4, 4), with the comma that stands before them."""
    angles = pin.rpy.matrixToRpy(T[:3, :3])
    listed = ", ".join(map(deg, angles))
    return f", rpy ({listed}) deg"


def _half_widths(c: Calibration, place: str, directions: Iterable[str], name: str) -> str:
    """List half the 95 % intervals of parameters of a frame or target, [mm] or [deg].

    Args:
        c: The result.
        place: ``"frame"`` or ``"target"``.
        directions: Of ``x``, ``y``, ``z`` [m] and ``rx``, ``ry``, ``rz`` [rad].
        name: The station's group or the target's name; empty if there is only one.
    """
    factors = {"m": 1e3, "rad": _DEG}
    half_widths = []
    for direction in directions:
        p = c.parameter(placed_name(place, direction, name))
        half_width = 0.5 * factors[p.unit] * (p.high - p.low)
        half_widths.append(f"{half_width:.3g}")
    return ", ".join(half_widths)
