"""Orientations written back into an MJCF in the form in which they stand there, the branch nearest to what stood there.

Three turns R = R_a(alpha) R_b(beta) R_c(gamma), of which a and c may be the same axis:

    alpha = atan2(-w . b, w . (a x b)),  w = R c,   or that + pi
    R' = R_a(-alpha) R:   beta = atan2(R' c . (b x c), R' c . c),   gamma = atan2(-R'^T b . (c x b), R'^T b . b)

Where alpha is not determined, the other two make up for any value of it: the product is R to rounding everywhere.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array
from calib.robot.mjcf_elements import (
    Attributes,
    Compiler,
    moving_sequence,
    numbers,
    orientation_key,
)
from calib.robot.mjcf_files import Node

#: Below this alpha is not determined, and stays as it was.
_UNDETERMINED = 1e-14

#: A turn below this has no axis [rad].
_NO_TURN = 1e-15


def number_text(values: Array) -> str:
    """Return numbers (k,), without signs of zero, as a text with blanks between them that reads back exactly."""
    return " ".join(repr(float(value) + 0.0) for value in values)


def orientation_text(
    node: Node, attributes: Attributes, compiler: Compiler, R: Array
) -> tuple[str, str]:
    """Return the attribute of an orientation: its name and its numbers.

    Args:
        node: The element, for messages.
        attributes: Its attributes, which say in what form the orientation stands there.
        compiler: Unit of angles and letters of ``euler``.
        R: Shape (3, 3), the orientation.

    Returns:
        The name that stands there, or ``quat`` if none does, or if it states no full orientation: ``zaxis``, the
        ``fromto`` of a site, ``euler`` by letters of which two neighbours are one axis.
    """
    key = orientation_key(attributes)
    if key == "xyaxes":
        return key, number_text(np.concatenate([R[:, 0], R[:, 1]]))
    if key == "euler" and makes_all(compiler.eulerseq):
        before = numbers(node, attributes, key, (0.0,) * 3) / compiler.per_radian
        angles = turns_of(R, compiler.eulerseq, before)
        return key, number_text(angles * compiler.per_radian)
    if key == "axisangle":
        before = numbers(node, attributes, key, (0.0,) * 4)
        vector = Rotation.from_matrix(R).as_rotvec()
        angle = float(np.linalg.norm(vector))
        axis = before[:3] if angle < _NO_TURN else vector / angle
        if axis @ before[:3] < 0.0:
            axis, angle = -axis, -angle
        turns = round((before[3] / compiler.per_radian - angle) / (2.0 * np.pi))
        angle += 2.0 * np.pi * turns
        return key, number_text(np.append(axis, angle * compiler.per_radian))
    quat = np.roll(Rotation.from_matrix(R).as_quat(), 1)
    before = np.array([1.0, 0.0, 0.0, 0.0])
    if key == "quat":
        before = numbers(node, attributes, key, (1.0, 0.0, 0.0, 0.0))
    return "quat", number_text(-quat if quat @ before < 0.0 else quat)


def makes_all(eulerseq: str) -> bool:
    """Return True if three turns by these letters make every rotation: no two after each other about one axis."""
    letters = moving_sequence(eulerseq)[0]
    return letters[0] != letters[1] != letters[2]


def turns_of(R: Array, eulerseq: str, before: Array) -> Array:
    """Return the angles (3,) [rad] of the letters of ``eulerseq`` that make a rotation (3, 3), nearest to others.

    The letters are such that `makes_all` is true.
    """
    letters, order = moving_sequence(eulerseq)
    a, b, c = (np.eye(3)["xyz".index(letter)] for letter in letters)
    w = R @ c
    sine, cosine = -float(w @ b), float(w @ np.cross(a, b))
    first = float(np.arctan2(sine, cosine))
    if np.hypot(sine, cosine) < _UNDETERMINED:
        first = float(before[order[0]])
    candidates = []
    for alpha in (first, first + np.pi):
        rest = Rotation.from_rotvec(-alpha * a).as_matrix() @ R
        column, row = rest @ c, rest.T @ b
        beta = np.arctan2(column @ np.cross(b, c), column @ c)
        gamma = np.arctan2(-row @ np.cross(c, b), row @ b)
        angles = np.empty(3)
        angles[list(order)] = alpha, beta, gamma
        candidates.append(angles - 2.0 * np.pi * np.round((angles - before) / (2.0 * np.pi)))
    return min(candidates, key=lambda angles: float(np.abs(angles - before).sum()))
