"""Targets and measurement frames of a result in words, and how its text is set."""

from __future__ import annotations

import textwrap

import numpy as np
import pinocchio as pin

import calib.kinds as registry
from calib.identify.result import Calibration
from calib.model.error_model import placed_name

#: Columns of the text.
WIDTH = 100

#: A target that moved further than this was given wrongly, rather than mounted inexactly [m].
_TARGET_MOVED = 5e-3

#: More targets, and more measurement frames, than this are not listed one by one.
_MOST_PLACES = 6


def target_text(c: Calibration) -> str:
    """Where each target is, how sure that is, and how far from where it was said to be; broken at 100 columns."""
    return "\n".join(wrap(sentence) for sentence in target_sentences(c))


def target_sentences(c: Calibration, most: int = _MOST_PLACES) -> list[str]:
    """The same, one sentence for each target.

    Args:
        c: The calibration.
        most: Of more targets than this the number is given.
    """
    names = c.setup.targets
    shown = [
        _one_target(c, t, name if len(names) > 1 else "") for t, name in enumerate(names[:most])
    ]
    more = len(names) - len(shown)
    return [*shown, *([f"... and {more} more targets"] if more else [])]


def _one_target(c: Calibration, t: int, name: str) -> str:
    """One target."""
    T = c.setup.T_tip_target[t]
    place = ", ".join(three(1e3 * float(v)) for v in T[:3, 3])
    what = f"Target '{name}'" if name else "Target"
    rpy = ""
    if c.setup.rotation:
        angles = np.degrees(pin.rpy.matrixToRpy(T[:3, :3]))
        rpy = f", rpy ({', '.join(three(float(v)) for v in angles)}) deg"
    if not c.setup.target_unknown[t]:
        return f"{what}: ({place}) mm{rpy} in {c.nominal.tip}, as given."
    sure = f"({_half_widths(c, [placed_name('target', axis, name) for axis in 'xyz'], 1e3)}) mm"
    if c.setup.rotation:
        turns = [placed_name("target", f"r{axis}", name) for axis in "xyz"]
        sure += f" and ({_half_widths(c, turns, float(np.degrees(1.0)))}) deg about its axes"
    if not c.setup.target_given[t]:
        return f"{what}: found at ({place}) mm{rpy} in {c.nominal.tip}, 95 % ± {sure}."
    moved = float(np.linalg.norm(T[:3, 3] - c.nominal_setup.T_tip_target[t, :3, 3]))
    text = (
        f"{what}: ({place}) mm{rpy} in {c.nominal.tip}, 95 % ± {sure}; it moved {1e3 * moved:.1f} mm from the "
        "position given."
    )
    if moved > _TARGET_MOVED:
        text += " That is further than mounting explains: check the sign and the order of the numbers given."
    return text


def frame_text(c: Calibration) -> str:
    """Where the base stands in each measurement frame that was estimated, and how sure that is; at 100 columns."""
    return "\n".join(wrap(sentence) for sentence in frame_sentences(c))


def frame_sentences(c: Calibration, most: int = _MOST_PLACES) -> list[str]:
    """The same, one sentence for each frame.

    Args:
        c: The calibration.
        most: Of more frames than this the number is given.
    """
    many = len(c.setup.groups) > 1
    found = [f for f, directions in enumerate(c.setup.unknown) if directions]
    lines = [_one_frame(c, f, c.setup.groups[f] if many else "") for f in found[:most]]
    more = len(found) - len(lines)
    return [*lines, *([f"... and {more} more set-ups"] if more else [])]


def _one_frame(c: Calibration, f: int, group: str) -> str:
    """One measurement frame; of a socket the point in the base, of a plane its normal and distance."""
    T, directions = c.setup.T_frame_base[f], c.setup.unknown[f]
    what = f" '{group}'" if group else ""
    names = {k for k, g in zip(c.rows.kinds, c.rows.groups, strict=True) if g == c.setup.groups[f]}
    kinds = [registry.get(name) for name in names]
    base, places = c.nominal.base, sorted(kind.place for kind in kinds)
    if all(kind.own_frame and kind.directions == ("x", "y", "z") for kind in kinds):
        name = places[0]  # of an anchor in a socket: anchor
        place = ", ".join(three(1e3 * float(v)) for v in -T[:3, :3].T @ T[:3, 3])
        return f"{name}{what}: found at ({place}) mm in {base}."
    if all(kind.own_frame and kind.directions == ("z", "rx", "ry") for kind in kinds):
        normal = ", ".join(f"{v:.5f}" for v in T[2, :3])
        return f"{places[0]}{what}: found with the normal ({normal}) in {base}, {-1e3 * T[2, 3]:.3f} mm along it."
    xyz = ", ".join(three(1e3 * float(v)) for v in T[:3, 3])
    rpy = ", ".join(three(float(v)) for v in np.degrees(pin.rpy.matrixToRpy(T[:3, :3])))
    shift = [placed_name("frame", d, group) for d in directions if d in "xyz"]
    turn = [placed_name("frame", d, group) for d in directions if d not in "xyz"]
    sure = [f"({_half_widths(c, shift, 1e3)}) mm"] * bool(shift)
    sure += [f"({_half_widths(c, turn, float(np.degrees(1.0)))}) deg"] * bool(turn)
    return (
        f"{places[0]}{what}: {base} found at ({xyz}) mm, rpy ({rpy}) deg in it; 95 % ± "
        f"{' and '.join(sure)} for {', '.join(directions)} along and about the axes of "
        f"{'the frame' if c.setup.own_axes[f] else base}."
    )


def _half_widths(c: Calibration, names: list[str], scale: float) -> str:
    """Half the 95 % intervals of some parameters."""
    chosen = [c.parameter(name) for name in names]
    return ", ".join(f"{0.5 * scale * (p.high - p.low):.3g}" for p in chosen)


def three(value: float, sign: str = "-") -> str:
    """Three digits after the point, and no minus before a zero."""
    return f"{round(value, 3) + 0.0:{sign}.3f}"


def wrap(text: str, indent: str = "") -> str:
    """Text broken at 100 columns."""
    return textwrap.fill(
        text,
        WIDTH,
        initial_indent=indent,
        subsequent_indent=indent + "  ",
        break_on_hyphens=False,
    )
