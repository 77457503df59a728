"""Places of targets and measurement frames, numbers of cameras and boards, with their uncertainty, in sentences."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
import pinocchio as pin

import calib.data.kinds as registry
from calib.basics.arrays import Array
from calib.camera import optics
from calib.data.kinds import Kind
from calib.diagnosis.reasons import USE
from calib.model.error_model import BOARD, CAMERA, Parameter
from calib.model.parameter_sets import DIRECTIONS, placed_name
from calib.result.calibration import Calibration
from calib.result.fitted_model import ParameterEstimate
from calib.show.lines import deg, mm, number
from calib.show.verdict_text import reason_text

#: A target further than this from the position given was given wrongly, not mounted inexactly [m].
_GIVEN_WRONGLY = 5e-3

#: Digits after the point of a number of a lens, by its unit.
_DIGITS = {"px": 1, "1": 4}

#: A number of a camera or a board that was estimated, and its estimate.
_Estimated = tuple[Parameter, ParameterEstimate]


def target_sentences(c: Calibration) -> list[str]:
    """Word the place of each target in the tip, and that it was given or registered, or its 95 % interval.

    An estimated one that was also given has its distance from there; places are in mm and, with orientations, deg.
    """
    noun = "Board" if c.rows.count_images(np.ones(len(c.rows), dtype=bool)) else "Target"
    sentences = []
    for t, name in enumerate(c.setup.target_names):
        pairs = zip(c.rows.kinds, c.rows.targets, strict=True)
        kinds = [registry.get(kind) for kind, target in pairs if target == c.setup.targets[t]]
        # A joint at its stop has none; in a clasp it is the tip.
        if any(kind.of_joint for kind in kinds) or (
            kinds and all(kind.holds_pose for kind in kinds)
        ):
            continue
        label = f"{noun} '{name}'" if name else noun
        T_tip_target = c.setup.T_tip_target[t]
        place = _position(T_tip_target[:3, 3])
        if c.setup.rotation:
            place += _rpy(T_tip_target)
        place += f" in {c.setup.target_links[t] if c.setup.target_links else c.nominal.tip}"

        if not c.setup.target_unknown[t]:
            sentences.append(f"{label}: {place}, as given.")
            continue
        directions = [d for d in DIRECTIONS if placed_name("target", d, name) in c.model.names]
        if not directions:
            sentences.append(f"{label}: registered to its validation rows, {place}.")
            continue

        lengths = [d for d in directions if d in "xyz"]
        angles = [d for d in directions if d not in "xyz"]
        parts = []
        if lengths:
            along = "" if len(lengths) == 3 else f" along its {', '.join(lengths)}"
            parts.append(f"({_half_widths(c, 'target', lengths, name)}) mm{along}")
        if angles:
            axes = "axes" if len(angles) == 3 else ", ".join(d[1] for d in angles)
            parts.append(f"({_half_widths(c, 'target', angles, name)}) deg about its {axes}")
        interval = f"95 % ± {' and '.join(parts)}"
        if not c.setup.target_given[t]:
            sentences.append(f"{label}: estimated at {place}, {interval}.")
            continue
        given = c.nominal_setup.T_tip_target[t, :3, 3]
        distance = float(np.linalg.norm(T_tip_target[:3, 3] - given))
        text = f"{label}: {place}, {interval}; {mm(distance, 1)} mm from the position given."
        if distance > _GIVEN_WRONGLY:
            text += " Check the sign and the order of the numbers given."
        sentences.append(text)
    return sentences


def frame_sentences(c: Calibration) -> list[str]:
    """Word the pose of the base in each frame that was estimated, with its 95 % intervals; mm and deg.

    Of images it is the camera's pose in the base; of a socket or an anchor the point in the base, and of a plane its
    normal and distance, both without intervals.
    """
    sentences = []
    for f, directions in enumerate(c.setup.unknown):
        if not directions:
            continue
        # Names of parameters, and the text, do not name a station if there is only one.
        group = c.setup.groups[f] if len(c.setup.groups) > 1 else ""
        pairs = zip(c.rows.kinds, c.rows.groups, strict=True)
        names = {kind for kind, of_row in pairs if of_row == c.setup.groups[f]}
        kinds = [registry.get(name) for name in names]
        label = min(kind.place for kind in kinds)  # of an anchor in a socket: anchor
        if group:
            label += f" '{group}'"

        is_fitted = placed_name("frame", directions[0], group) in c.model.names
        if not is_fitted:
            label += ", registered to its validation rows"
        text = f"{label}: {_frame_place(base_of(c, f), c.setup.T_frame_base[f], kinds)}"
        if is_fitted and not _is_point(kinds) and not _is_plane(kinds):
            lengths = [direction for direction in directions if direction in "xyz"]
            angles = [direction for direction in directions if direction not in "xyz"]
            halves = []
            if lengths:
                halves.append(f"({_half_widths(c, 'frame', lengths, group)}) mm")
            if angles:
                halves.append(f"({_half_widths(c, 'frame', angles, group)}) deg")
            axes = "the frame" if c.setup.own_axes[f] else base_of(c, f)
            text += f"; 95 % ± {' and '.join(halves)} for {', '.join(directions)} along and about the axes of {axes}"
        sentences.append(f"{text}.")
    return sentences


def base_of(c: Calibration, f: int) -> str:
    """Return the link that frame f is mounted on."""
    return c.setup.frame_links[f] if c.setup.frame_links else c.nominal.base


def chain_sentences(c: Calibration) -> list[str]:
    """Word the first reason of each chain whose verdict by itself is not ``use``."""
    return [
        f"{chain.base} to {chain.tip}, {chain.verdict.use}: {reason_text(chain.verdict.reasons[0])}"
        for chain in c.trust.chains
        if chain.verdict.use != USE and chain.verdict.reasons
    ]


def _frame_place(base: str, T_frame_base: Array, kinds: Sequence[Kind]) -> str:
    """Word the place of an estimated frame, T_frame_base (4, 4) [m], in mm and deg, by the kinds of its rows.

    It is a camera's pose, the point of a socket or anchor, a plane's normal and distance, or the held pose of a clasp,
    in the base; for other kinds the pose of the base in the frame.
    """
    position = T_frame_base[:3, 3]
    if any(kind.is_image for kind in kinds):
        T_base_camera = np.asarray(np.linalg.inv(T_frame_base))
        return f"estimated at {_position(T_base_camera[:3, 3])}{_rpy(T_base_camera)} in {base}"
    if _is_point(kinds):
        return f"estimated at {_position(-T_frame_base[:3, :3].T @ position)} in {base}"
    if _is_plane(kinds):
        normal = ", ".join(f"{v:.5f}" for v in T_frame_base[2, :3])
        return f"estimated with the normal ({normal}) in {base}, {mm(-position[2])} mm along it"
    if all(kind.holds_pose for kind in kinds):
        T_base_held = np.asarray(np.linalg.inv(T_frame_base))
        place = f"{_position(T_base_held[:3, 3])}{_rpy(T_base_held)} in {base}"
        return f"held at {place}; position and orientation errors are those by which the loop does not close"
    return f"{base} estimated at {_position(position)}{_rpy(T_frame_base)} in it"


def _is_point(kinds: Iterable[Kind]) -> bool:
    """Return True if the rows of a frame depend on its origin alone: a socket or an anchor."""
    return all(kind.own_frame and kind.directions == ("x", "y", "z") for kind in kinds)


def _is_plane(kinds: Iterable[Kind]) -> bool:
    """Return True if the rows of a frame depend on the normal and distance of its plane z = 0 alone."""
    return all(kind.own_frame and kind.directions == ("z", "rx", "ry") for kind in kinds)


def _position(lengths: Iterable[float]) -> str:
    """Write a position [m] in mm."""
    return f"({', '.join(map(mm, lengths))}) mm"


def _rpy(T: Array) -> str:
    """Write roll, pitch and yaw of a pose (4, 4), with the comma that stands before them."""
    angles = pin.rpy.matrixToRpy(T[:3, :3])
    return f", rpy ({', '.join(map(deg, angles))}) deg"


def _half_widths(c: Calibration, place: str, directions: Iterable[str], name: str) -> str:
    """List half the 95 % intervals [mm] or [deg] of the ``"frame"`` or ``"target"`` in directions such as ``"rx"``.

    Its name is empty if its parameters do not bear one.
    """
    factors = {"m": 1e3, "rad": math.degrees(1.0)}
    half_widths = []
    for direction in directions:
        p = c.parameter(placed_name(place, direction, name))
        half_widths.append(f"{0.5 * factors[p.unit] * (p.high - p.low):.3g}")
    return ", ".join(half_widths)


def camera_and_board_sentences(c: Calibration) -> list[str]:
    """Word the numbers of each camera, and the errors of each printed board, that were estimated."""
    pairs = list(zip(c.model.parameters, c.parameters, strict=True))
    internals = [pair for pair in pairs if pair[0].internal is not None]
    sentences = []
    for family, word in ((CAMERA, _camera), (BOARD, _board)):
        of_family = [pair for pair in internals if pair[0].family == family]
        for owner in dict.fromkeys(parameter.samples[0] for parameter, _ in of_family):
            estimated = [pair for pair in of_family if pair[0].samples[0] == owner]
            sentences.append(word(estimated))
    return sentences


def _camera(estimated: Sequence[_Estimated]) -> str:
    """Word the numbers of one camera that were estimated: the values, and half their 95 % intervals."""
    parts = []
    for parameter, p in estimated:
        digits = _DIGITS[parameter.unit]
        name = parameter.name.partition("[")[0]
        parts.append(f"{name} {number(p.value, digits)} ± {_half(p, digits)}")
    return f"Intrinsics{_owner(estimated[0][0])} (95 %): {', '.join(parts)}; fx, fy, cx, cy in px."


def _board(estimated: Sequence[_Estimated]) -> str:
    """Word the errors of one print: scale and sag along its axes, and how far its corners are from their places."""
    whole = [(parameter, p) for parameter, p in estimated if not parameter.of_one_point]
    parts = []
    for name, factor, unit in (("scale", 100.0, "%"), ("sag", 1e3, "mm")):
        values = []
        for parameter, p in whole:
            if parameter.name.startswith(f"board_{name}"):
                axis = parameter.name.partition("[")[0][-1]
                change = number(factor * p.delta, 2, "+")
                values.append(f"{axis} {change} ± {_half(p, 2, factor)} {unit}")
        if values:
            parts.append(f"{name} {', '.join(values)}")
    offsets = np.array([p.delta for parameter, p in estimated if parameter.of_one_point])
    if len(offsets):
        rms = float(np.sqrt(np.mean(offsets**2)))
        is_body = any(parameter.internal == optics.OFFSET[2] for parameter, _ in estimated)
        axes = "x, y and z" if is_body else "x and y"
        parts.append(f"corners {mm(rms)} mm rms from their places along {axes}")
    return f"Board{_owner(estimated[0][0])} (95 %): {'; '.join(parts)}."


def _half(p: ParameterEstimate, digits: int, factor: float = 1.0) -> str:
    """Write half the width of a parameter's 95 % interval, times a factor to the unit shown, with so many decimals."""
    return number(0.5 * factor * (p.high - p.low), digits)


def _owner(parameter: Parameter) -> str:
    """Return the name of the camera or board of a parameter with a space before it; empty if there is only one."""
    _, bracket, name = parameter.name.partition("[")
    return f" of '{name.rstrip(']')}'" if bracket else ""
