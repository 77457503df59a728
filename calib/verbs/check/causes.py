"""Causes: what may have moved since a calibration, and the displacements that each has.

A frame (a tracker or camera), a target (a reflector or board), the zero of a joint; the base if several frames stand
around it, and the hand if it holds several targets. A tracker that has moved and a base that has moved are one cause:
rows of one frame cannot tell them apart. Besides, a single stop may be off, or all of them in different ways.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.basics.arrays import Array, rigid_inverse
from calib.basics.values import Value
from calib.model.error_model import FRAME, TARGET
from calib.verbs.check.evidence import Directions
from calib.verbs.check.innovations import LEVER, Stack, StoredResult

#: The kind of a cause.
Code = Literal["frame", "target", "base", "hand", "joint", "row", "other"]

#: What can have moved, in contrast to rows that are off.
MOVING: tuple[Code, ...] = ("frame", "target", "base", "hand", "joint")

#: Weight beforehand of all stops being displaced differently, in that of a single cause: it explains whatever comes.
_SEVERAL = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Cause(Value):
    """Something that may have moved, or a row that may be off."""

    code: Code
    #: Name of the frame, target or joint; "" for the only frame or target, the base, the hand, a row and others
    name: str
    #: (c, d), how the c displacements of `StoredResult.displaced` follow from those of the cause, each of 1 m: a turn
    #: is that at the end of `LEVER`; empty for rows
    mixing: Array
    #: Units of these d displacements, ``"m"`` or ``"rad"``
    units: tuple[str, ...]
    #: Numbers of the rows that are off, of a cause ``"row"``
    rows: tuple[int, ...] = ()
    #: Name of their image; empty without
    image: str = ""

    @property
    def scale(self) -> Array:
        """Unit of each displacement in SI units, shape (d,): 1 m, or 1 m at the end of `LEVER` [rad]."""
        return np.array([1.0 if unit == "m" else 1.0 / LEVER for unit in self.units])


def moving_causes(stored: StoredResult) -> tuple[Cause, ...]:
    """List what may have moved: the frames, the targets, the base, the hand, and each joint's zero.

    Args:
        stored: The result, with all its frames, targets and joints.
    """
    model, setup = stored.displaced.model, stored.part.setup
    frames, targets = setup.places
    c = len(model)
    causes = []
    by_place: dict[str, Array] = {}
    for code, places, names in (
        ("frame", frames, setup.groups),
        ("target", targets, setup.targets),
    ):
        for place, name in zip(places, names, strict=True):
            chosen = [k for k, parameter in enumerate(model.parameters) if parameter.place == place]
            by_place[place] = np.eye(c)[:, chosen]
            units = tuple(model.parameters[k].unit for k in chosen)
            only = len(places) == 1
            causes.append(_cause(code, "" if only else name, by_place[place], units))  # type: ignore[arg-type]
    six = ("m",) * 3 + ("rad",) * 3
    if len(frames) > 1 and len(set(setup.frame_links)) <= 1:
        # A motion of the base is the same displacement of the base in each frame.
        together = sum(by_place[place] for place in frames)
        causes.append(_cause("base", "", np.asarray(together), six))
    if len(targets) > 1 and len(set(setup.target_links)) <= 1:
        moved = np.zeros((c, 6))
        for place, T in zip(targets, setup.T_tip_target, strict=True):
            moved += by_place[place] @ _adjoint(rigid_inverse(T))
        causes.append(_cause("hand", "", moved, six))
    for k, parameter in enumerate(model.parameters):
        if parameter.family not in (FRAME, TARGET):
            causes.append(_cause("joint", parameter.place, np.eye(c)[:, [k]], (parameter.unit,)))
    return tuple(causes)


def _cause(code: Code, name: str, mixing: Array, units: tuple[str, ...]) -> Cause:
    """Return a cause whose displacements, in SI units, mix those of the model by a matrix (c, d)."""
    scale = np.array([1.0 if unit == "m" else 1.0 / LEVER for unit in units])
    return Cause(code, name, mixing * scale, units)


def _adjoint(T: Array) -> Array:
    """Return the adjoint of a pose, (6, 6): it takes a twist, linear part first, from the inner to the outer frame."""
    R, t = T[:3, :3], T[:3, 3]
    result = np.zeros((6, 6))
    result[:3, :3] = result[3:, 3:] = R
    result[:3, 3:] = np.cross(t, R.T).T
    return result


def causes_of(
    moving: Sequence[Cause], stack: Stack
) -> tuple[tuple[Cause, ...], tuple[Directions, ...]]:
    """List the causes that some stops can show, and how their displacements show there.

    Args:
        moving: What may have moved.
        stack: The whitened stops.

    Returns:
        K causes: those that show at all, each as probable as any other beforehand; a single stop that is off, together
        as probable as one of these; and, less probable, all stops displaced differently. And the directions of each.
    """
    causes, directions = [], []
    for cause in moving:
        shown = Directions.of(stack.by_displacements @ cause.mixing, 1.0)
        if len(shown.singular):
            causes.append(cause)
            directions.append(shown)
    six = ("m",) * 3 + ("rad",) * 3
    nothing = np.zeros((stack.by_displacements.shape[1], 0))
    alone = stack.by_target
    if len(alone) > 1:
        for stop, derivative in zip(stack.stops, alone, strict=True):
            causes.append(Cause("row", "", nothing, six, stop.rows, stop.image))
            directions.append(Directions.of(derivative, 1.0 / len(alone)))
    causes.append(Cause("other", "", nothing, six))
    directions.append(Directions.of(np.hstack(alone), _SEVERAL))
    return tuple(causes), tuple(directions)
