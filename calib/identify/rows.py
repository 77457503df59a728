"""Rows: the measurements of one fit as arrays, and what each kind says of the target's pose.

With the pose (R, p) of the target in its set-up's frame, what is predicted, and what is left over, is

    point      p                    m - p
    pose       R, p                 m - p, log(M R^T)          the rotation vector in SO(3)
    distance   |p|                  d - |p|                    the frame stands at the anchor
    pair       |p_i - p_j|          d - |p_i - p_j|
    fixed      p                    0 - p                      the frame stands in the socket
    plane      p_z                  0 - p_z                    the frame lies in the plane

Ball in a socket, anchored distance and plane are thus points, of which some coordinates are measured in a frame that is
unknown in some directions: one error model for all. Scalars stand in a row of `width` columns, unused ones are zero.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.identify.statistics import Mask
from calib.model.kinematics import Samples

Array = NDArray[np.float64]

POINT, POSE, DISTANCE, PAIR, FIXED, PLANE, NONE = range(7)

#: The kinds' names, in the order of their numbers.
KIND_NAMES = ("point", "pose", "distance", "pair", "fixed", "plane", "")

#: Which columns of a row each kind uses.
_USED = np.array(
    [
        [1, 1, 1, 0, 0, 0],
        [1, 1, 1, 1, 1, 1],
        [1, 0, 0, 0, 0, 0],
        [1, 0, 0, 0, 0, 0],
        [1, 1, 1, 0, 0, 0],
        [1, 0, 0, 0, 0, 0],
        [0, 0, 0, 0, 0, 0],
    ],
    dtype=bool,
)

#: The directions of a set-up's frame that a kind can tell.
FRAME_DIRECTIONS = {
    POINT: ("x", "y", "z", "rx", "ry", "rz"),
    POSE: ("x", "y", "z", "rx", "ry", "rz"),
    DISTANCE: ("x", "y", "z"),
    PAIR: (),
    FIXED: ("x", "y", "z"),
    PLANE: ("z", "rx", "ry"),
    NONE: (),
}

#: A distance below this has no direction [m].
_TINY = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """The rows of one fit.

    Attributes:
        samples: Joint values, frame and target of each of N rows.
        kinds: shape (N,), numbers of the kinds; `NONE` for the second row of a pair.
        points: shape (N, 3), measured position [m], zero where there is none.
        rotations: shape (N, 3, 3), measured R_frame_target; the identity where there is none.
        distances: shape (N,), [m]; zero where there is none.
        partner: shape (N,), the other row of a pair; -1 elsewhere.
        sigma: shape (N,), standard deviation of one length as given or first assumed [m].
        sigma_angle: shape (N,), of one angle [rad].
        poses: shape (N,), rows of one number are repeats: one pose, one target, one frame.
        blocks: shape (N,), rows of one number are left out together: one pose, and both rows of a pair.
        width: Columns of a residual: 6 with poses, 3 with points, else 1.
        used: shape (N, width), which columns of each row hold a scalar.
    """

    samples: Samples
    kinds: NDArray[np.int_]
    points: Array
    rotations: Array
    distances: Array
    partner: NDArray[np.int_]
    sigma: Array
    sigma_angle: Array
    poses: NDArray[np.int_]
    blocks: NDArray[np.int_]
    width: int = field(init=False)
    used: Mask = field(init=False, repr=False)
    _of_kind: tuple[tuple[int, NDArray[np.int_]], ...] = field(init=False, repr=False)
    _instruments: tuple[NDArray[np.int8], NDArray[np.bool_]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Work out once what every evaluation of a fit asks for."""
        width = 6 if np.any(self.kinds == POSE) else 3 if np.any(_USED[self.kinds, 1]) else 1
        used = np.ascontiguousarray(_USED[self.kinds][:, :width])
        used.setflags(write=False)
        of_kind = tuple(
            (k, np.flatnonzero(self.kinds == k)) for k in np.unique(self.kinds).tolist()
        )
        for name, value in (
            ("width", width),
            ("used", used),
            ("_of_kind", of_kind),
            ("_instruments", _instruments(used, of_kind)),
        ):
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.samples)

    @property
    def joints(self) -> Array:
        """Values of the measured joints, shape (N, m), [rad] or [m]."""
        return self.samples.q

    @property
    def count(self) -> int:
        """Number of scalars."""
        return int(np.sum(_USED[self.kinds]))

    @property
    def scales(self) -> Array:
        """Standard deviation of each column as given or first assumed, shape (N, width), [m] and [rad]."""
        result = np.repeat(self.sigma[:, None], self.width, axis=1)
        result[:, 3:] = self.sigma_angle[:, None]
        return result

    @property
    def instruments(self) -> tuple[NDArray[np.int8], NDArray[np.bool_]]:
        """Which noise each scalar has, and which of these noises are angles.

        Rows of different kinds were measured with different instruments, and positions and orientations of poses have
        each a noise of their own.

        Returns:
            shape (N, width), numbered from 0, lengths first; -1 where no scalar stands; and shape (instruments,).
        """
        return self._instruments

    def select(self, mask: Mask) -> Rows:
        """Some of the rows; of a pair both or none."""
        if np.all(mask):
            return self
        chosen = np.flatnonzero(mask)
        position = np.full(len(self), -1)
        position[chosen] = np.arange(len(chosen))
        partner = self.partner[chosen]
        return replace(
            self,
            samples=self.samples.select(chosen),
            kinds=self.kinds[chosen],
            points=self.points[chosen],
            rotations=self._rotations_of(chosen),
            distances=self.distances[chosen],
            partner=np.where(partner >= 0, position[partner], -1),
            sigma=self.sigma[chosen],
            sigma_angle=self.sigma_angle[chosen],
            poses=self.poses[chosen],
            blocks=self.blocks[chosen],
        )

    def _rotations_of(self, chosen: NDArray[np.int_]) -> Array:
        """Some of the rotations; where no row has one of its own they stay one matrix for all."""
        if self.rotations.strides[0] == 0:
            return np.broadcast_to(np.eye(3), (len(chosen), 3, 3))
        return self.rotations[chosen]

    def residual(self, T_frame_target: Array) -> Array:
        """Measured minus predicted, shape (N, width), [m] and [rad].

        Args:
            T_frame_target: shape (N, 4, 4), predicted [m].
        """
        p = T_frame_target[:, :3, 3]
        result = np.zeros((len(self), self.width))
        for kind, k in self._of_kind:
            if kind in (POINT, POSE, FIXED):
                result[k, :3] = self.points[k] - p[k]
            if kind == POSE:
                turned = self.rotations[k] @ T_frame_target[k, :3, :3].transpose(0, 2, 1)
                result[k, 3:] = Rotation.from_matrix(turned).as_rotvec()
            elif kind == DISTANCE:
                result[k, 0] = self.distances[k] - np.linalg.norm(p[k], axis=1)
            elif kind == PAIR:
                between = np.linalg.norm(p[k] - p[self.partner[k]], axis=1)
                result[k, 0] = self.distances[k] - between
            elif kind == PLANE:
                result[k, 0] = -p[k, 2]
        return result

    def derivative(self, T_frame_target: Array, twists: Array) -> Array:
        """The derivative of what is predicted, minus that of the residual, shape (N, width, p).

        Args:
            T_frame_target: shape (N, 4, 4), [m].
            twists: shape (N, 6, p), see `calib.model.kinematics.Kinematics.twists`.
        """
        if self.width == 3 and not np.any(self.kinds != POINT):
            return twists[:, :3]
        p = T_frame_target[:, :3, 3]
        result = np.zeros((len(self), self.width, twists.shape[2]))
        for kind, k in self._of_kind:
            if kind in (POINT, POSE, FIXED):
                result[k, :3] = twists[k, :3]
            if kind == POSE:
                turned = self.rotations[k] @ T_frame_target[k, :3, :3].transpose(0, 2, 1)
                result[k, 3:] = _log_derivative(Rotation.from_matrix(turned)) @ twists[k, 3:]
            elif kind == DISTANCE:
                result[k, 0] = np.einsum("ni,nip->np", _unit(p[k]), twists[k, :3])
            elif kind == PAIR:
                j = self.partner[k]
                along = _unit(p[k] - p[j])
                result[k, 0] = np.einsum("ni,nip->np", along, twists[k, :3] - twists[j, :3])
            elif kind == PLANE:
                result[k, 0] = twists[k, 2]
        return result


def evenly(rows: Rows, most: int) -> Mask:
    """About so many of the rows, the same share of each frame, target and kind, shape (N,); whole pairs.

    Which ones is drawn at random, always alike: tables have cycles, and every tenth row may be of one kind of pose.

    Args:
        rows: The rows.
        most: How many; of each frame, target and kind at least a hundred, as long as these are not more than that.
    """
    told = np.flatnonzero(rows.kinds != NONE)
    seen = np.stack([rows.samples.frame, rows.samples.target, rows.kinds], axis=1)[told]
    _, view, count = np.unique(seen, axis=0, return_inverse=True, return_counts=True)
    view = view.reshape(-1)
    fewest = min(100, max(most // len(count), 1))
    quota = np.minimum(count, np.maximum(most * count // max(len(rows), 1), fewest))
    order = np.lexsort((np.random.default_rng(0).random(len(told)), view))
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    place = np.arange(len(told)) - first[view[order]]
    result = np.zeros(len(rows), dtype=bool)
    result[told[order[place < quota[view[order]]]]] = True
    result[rows.partner[result & (rows.partner >= 0)]] = True
    return result


def whole_blocks(rows: Rows, size: int) -> Iterator[Mask]:
    """The rows in parts of about so many, repeats of a pose and pairs together, as masks of shape (N,)."""
    order = np.argsort(rows.blocks, kind="stable")
    ends = np.flatnonzero(np.diff(rows.blocks[order], append=-1)) + 1
    first = 0
    while first < len(rows):
        last = int(ends[np.searchsorted(ends, min(first + size, len(rows)))])
        mask = np.zeros(len(rows), dtype=bool)
        mask[order[first:last]] = True
        yield mask
        first = last


def thinned(rows: Rows, most: int) -> Rows:
    """The rows, or where they are more than that about so many of them, see `evenly`."""
    return rows if len(rows) <= most else rows.select(evenly(rows, most))


def _instruments(
    used: Mask, of_kind: tuple[tuple[int, NDArray[np.int_]], ...]
) -> tuple[NDArray[np.int8], NDArray[np.bool_]]:
    """See `Rows.instruments`."""
    lengths = [kind for kind, _ in of_kind if kind != NONE]
    angles = [kind for kind in lengths if kind == POSE]
    index = np.full(used.shape, -1, dtype=np.int8)
    for number, kind in enumerate(lengths):
        own = next(rows for k, rows in of_kind if k == kind)
        index[own, :3] = np.where(used[own, :3], number, -1)
        if kind == POSE:
            index[own, 3:] = len(lengths)
    index.setflags(write=False)
    return index, np.arange(len(lengths) + len(angles)) >= len(lengths)


def _unit(v: Array) -> Array:
    """Unit vectors, shape (N, 3)."""
    result: Array = v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), _TINY)
    return result


def _log_derivative(rotation: Rotation) -> Array:
    """D log(E exp(-w)) / d(-w) at w = 0, the inverse right Jacobian of SO(3), shape (N, 3, 3).

    I + [r]x / 2 + (1 / t^2 - 1 / (2 t tan(t / 2))) [r]x^2 with r = log E and t = |r|; finite up to t = pi.
    """
    r = rotation.as_rotvec()
    t = np.linalg.norm(r, axis=1)
    small = t < 1e-4
    safe = np.where(small, 1.0, t)
    factor = 1.0 / safe**2 - 0.5 / (safe * np.tan(0.5 * safe))
    factor = np.where(small, 1.0 / 12.0, factor)
    cross = np.zeros((len(r), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -r[:, 2], r[:, 1], -r[:, 0]
    cross = cross - cross.transpose(0, 2, 1)
    result: Array = np.eye(3) + 0.5 * cross + factor[:, None, None] * (cross @ cross)
    return result
