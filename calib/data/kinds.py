"""Kinds of measurement: what a row of a table says of the pose of its target, one row of a registry for each kind.

With the pose (R, p) of the target in its set-up's frame, what is measured, what is predicted, and the residual are

    point      the position                      p              m - p
    pose       position and orientation          p, R           m - p, log(M R^T)    the rotation vector in SO(3)
    distance   the distance to an anchor         |p|            d - |p|              the frame stands at the anchor
    pair       the distance between two rows     |p_i - p_j|    d - |p_i - p_j|
    fixed      nothing: the target is in a socket               0 - p                the frame stands in the socket
    plane      nothing: the target is on a plane                0 - p_z              the frame lies in the plane

Ball in a socket, anchored distance and plane are thus points, of which some coordinates are measured in a frame that is
unknown in some directions: one error model for all. `register` adds a kind from outside; see docs/extending.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.errors import CalibError, MeasurementError, choices
from calib.model.error_model import DIRECTIONS
from calib.units import Array, Quantity

#: A distance below this has no direction [m].
_TINY = 1e-12

#: No instrument is better or worse than this [m or rad], and squares beyond it leave the range of numbers.
SIGMAS = (1e-15, 1e6)

#: Beyond this [m or rad] doubles are further apart than what calib computes to, and no robot gets there.
FARTHEST = 1e6

#: A matrix of seven digits is orthonormal to this.
_MATRIX_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True)
class Reading:
    """A column of the table with a number that rows of a kind measure."""

    name: str  #: Of the column, as in ``"distance [mm]"``.
    quantity: Quantity = "length"  #: What it measures: ``"length"`` or ``"angle"``.
    positive: bool = False  #: Whether it is greater than zero, as a distance is.


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """A kind of measurement.

    What n rows measured is an array of shape (n, k): x, y, z of kinds that measure a position; then the nine entries of
    R_frame_target, row after row, of those that measure an orientation; then the readings; all in SI units. Poses are
    T_frame_target, shape (n, 4, 4) [m]; of a ``paired`` kind those of both rows, shape (n, 2, 4, 4). Twists are the
    derivatives of these poses by p parameters: of the origin, then (where any row of the table measures an
    orientation) the rotation, along the frame's axes, shape (n, 3 or 6, p); of a paired kind (n, 2, 3 or 6, p).
    """

    name: str  #: Of the kind, as in the column ``kind``.
    words: str  #: What a row measures, for texts: ``"position of the target"``.
    units: tuple[
        str, ...
    ]  #: Of each of the s residual scalars, lengths first: ``"m"`` or ``"rad"``.
    #: Of the prediction, minus that of the residual: from what was measured, poses and twists to shape (n, s, p).
    derivative: Callable[[Array, Array, Array], Array]
    #: What a perfect instrument reads at some poses, shape (n, k), to simulate and to predict with; None where poses
    #: are not free, because the target is held somewhere.
    measure: Callable[[Array], Array] | None = None
    #: Measured minus predicted, from what was measured and poses to shape (n, s); None where that is the difference to
    #: what ``measure`` gives.
    residual: Callable[[Array, Array], Array] | None = None
    position: bool = False  #: Whether the columns x, y, z are measured.
    orientation: bool = False  #: Whether an orientation is.
    readings: tuple[Reading, ...] = ()  #: The other columns that are measured.
    #: Whether two rows, which share a word in the column ``pair``, give one measurement.
    paired: bool = False
    #: The directions of the set-up's frame that such rows tell, of `DIRECTIONS`.
    directions: tuple[str, ...] = DIRECTIONS
    #: Whether the frame is that of what is measured against, unknown unless the cell gives it, such as a socket; else
    #: it is the instrument's.
    own_frame: bool = False
    #: Whether the directions are along that frame's own axes; else along those of the base.
    own_axes: bool = False
    fewest: int = (
        1  #: With fewer rows in a group what is unknown of its frame fits whatever the robot does.
    )
    #: Where the frame stands, T_frame_base, for the target's places in the base, shape (n, 3), what was measured, and a
    #: first guess; None: as a measured position's.
    locate: Callable[[Array, Array, Array], Array] | None = None
    #: The frame with the directions that no row tells put somewhere definite; None: as they come.
    settle: Callable[[Array], Array] | None = None
    place: str = "Measurement frame"  #: What the frame stands for, in a text: ``"Socket"``.

    def __post_init__(self) -> None:
        """Refuse a kind that does not say what is left over, or in what unit."""
        ordered = self.units == ("m",) * self.lengths + ("rad",) * self.angles
        if not (self.units and ordered) or (self.residual is None and self.measure is None):
            raise CalibError(
                f"The kind '{self.name}' needs 'residual' or 'measure', and 'units' of 'm' and 'rad', lengths first."
            )

    @property
    def lengths(self) -> int:
        """How many of the residual scalars are lengths."""
        return self.units.count("m")

    @property
    def angles(self) -> int:
        """How many are angles."""
        return self.units.count("rad")

    @property
    def coordinates(self) -> bool:
        """Whether the lengths are the three coordinates of the target's place, as of ``point``, ``pose``, ``fixed``."""
        return self.position or (self.lengths == 3 and not self.readings)

    @property
    def measures_length(self) -> bool:
        """Whether a row compares the arm with a unit of length: a socket or a touched plane does not."""
        return self.position or any(reading.quantity == "length" for reading in self.readings)

    @property
    def free(self) -> bool:
        """Whether the target may be anywhere, and each row says something by itself: poses can be chosen for it."""
        return self.measure is not None and not self.paired

    @property
    def size(self) -> int:
        """How many numbers a row measures, k."""
        return 3 * self.position + 9 * self.orientation + len(self.readings)

    def residual_of(self, measured: Array, T_frame_target: Array) -> Array:
        """Measured, shape (n, k), minus predicted at poses, (n, 4, 4), of a paired kind (n, 2, 4, 4); shape (n, s)."""
        if self.residual is not None:
            return self.residual(measured, T_frame_target)
        assert self.measure is not None
        return measured - self.measure(T_frame_target)


def register(kind: Kind) -> None:
    """Add a kind of measurement: tables, fits, simulations and files of this process know it from then on.

    Nothing can be replaced or taken out again. Worker processes register what they need themselves, on import.

    Raises:
        CalibError: There is a kind, or a column, of this name.
    """
    taken = any(readings().get(one.name, one) != one for one in kind.readings)
    if kind.name in _KINDS or taken:
        message = f"There is a kind '{kind.name}', or a column of its name, already; rename yours."
        raise CalibError(message)
    _KINDS[kind.name] = kind


def names() -> tuple[str, ...]:
    """The names of all kinds, in the order of their numbers."""
    return tuple(_KINDS)


def get(name: str) -> Kind:
    """The kind of this name.

    Raises:
        MeasurementError: There is none; the text names those there are.
    """
    if name not in _KINDS:
        message = f"'{name}' is not a kind of measurement; allowed are {choices(_KINDS)}"
        raise MeasurementError(message)
    return _KINDS[name]


def at(number: int) -> Kind:
    """The kind of this number, its place among `names`."""
    return tuple(_KINDS.values())[number]


def readings() -> dict[str, Reading]:
    """The readings of all kinds, by their columns' names."""
    return {one.name: one for kind in _KINDS.values() for one in kind.readings}


def no_rotation(matrices: Array) -> NDArray[np.bool_]:
    """True for matrices (N, 3, 3) that are not finite, orthonormal and right-handed, shape (N,)."""
    product = np.swapaxes(matrices, 1, 2) @ matrices
    error = np.abs(product - np.eye(3)).max(axis=(1, 2), initial=0.0)
    good = (error <= _MATRIX_TOLERANCE) & (np.linalg.det(np.nan_to_num(matrices)) > 0.0)
    return np.asarray(~good, dtype=np.bool_)


def to_quaternions(rotations: Array) -> Array:
    """Unit quaternions (x, y, z, w) with w >= 0, shape (N, 4), of matrices (N, 3, 3). NaN rows stay NaN."""
    result = np.full((len(rotations), 4), np.nan)
    there = np.isfinite(rotations).all(axis=(1, 2))
    if there.any():
        result[there] = Rotation.from_matrix(rotations[there]).as_quat(canonical=True)
    return result


def _unit(v: Array) -> Array:
    """Unit vectors, shape (..., 3)."""
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), _TINY))


def _place(T: Array) -> Array:
    """Positions, shape (..., 3)."""
    return T[..., :3, 3]


def _of_position(_measured: Array, _T: Array, twists: Array) -> Array:
    """The derivative of a position."""
    return twists[:, :3]


def _turned(measured: Array, T: Array) -> Rotation:
    """M R^T: the rotations that are left over."""
    M = measured[:, 3:12].reshape(-1, 3, 3)
    return Rotation.from_matrix(M @ T[:, :3, :3].transpose(0, 2, 1))


def _pose_derivative(measured: Array, T: Array, twists: Array) -> Array:
    """The derivative of position and orientation."""
    turned = _log_derivative(_turned(measured, T)) @ twists[:, 3:]
    return np.concatenate([twists[:, :3], turned], axis=1)


def _log_derivative(rotation: Rotation) -> Array:
    """D log(E exp(-w)) / d(-w) at w = 0, the inverse right Jacobian of SO(3), shape (n, 3, 3).

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


def _between_derivative(_measured: Array, T: Array, twists: Array) -> Array:
    """The derivative of a distance between two rows."""
    p = _place(T)
    along, apart = _unit(p[:, 0] - p[:, 1]), twists[:, 0, :3] - twists[:, 1, :3]
    return np.asarray(np.einsum("ni,nip->np", along, apart)[:, None])


def _anchor(points: Array, measured: Array, T_frame_base: Array) -> Array:
    """The frame at the anchor: |p|^2 - d^2 = 2 p a - |a|^2 is linear in (a, |a|^2)."""
    centre = points.mean(axis=0)
    p = points - centre
    A = np.column_stack([2.0 * p, -np.ones(len(p))])
    rhs = np.sum(p**2, axis=1) - measured[:, 0] ** 2
    anchor = np.linalg.lstsq(A, rhs, rcond=1e-9)[0][:3] + centre
    return _standing(T_frame_base, anchor)


def _standing(T_frame_base: Array, place: Array) -> Array:
    """The frame with its origin at a place in the base."""
    T: Array = T_frame_base.copy()
    T[:3, 3] = -T[:3, :3] @ place
    return T


def _plane(points: Array, _measured: Array, _T_frame_base: Array) -> Array:
    """The frame in the plane that fits the targets' places best."""
    centre = points.mean(axis=0)
    normal = np.linalg.svd(points - centre)[2][-1]
    return _plane_frame(normal, float(normal @ centre))


def _plane_frame(normal: Array, distance: float) -> Array:
    """T_frame_base of a frame whose x-y plane is normal p = distance, turned as little as can be, shape (4, 4).

    Which side its z points to is arbitrary: to that where the largest component of the normal is positive.
    """
    sign = float(np.sign(normal[np.argmax(np.abs(normal))]))
    axis = np.cross(sign * normal, [0.0, 0.0, 1.0])
    sine, T = float(np.linalg.norm(axis)), np.eye(4)
    if sine > _TINY:
        turn = np.arctan2(sine, sign * normal[2]) / sine
        T[:3, :3] = Rotation.from_rotvec(turn * axis).as_matrix()
    T[2, 3] = -sign * distance
    return T


_LENGTH = (Reading("distance", positive=True),)

_KINDS: dict[str, Kind] = {}
for _kind in (
    Kind(
        name="point",
        words="position of the target",
        units=("m",) * 3,
        measure=_place,
        derivative=_of_position,
        position=True,
    ),
    Kind(
        name="pose",
        words="position and orientation of the target",
        units=("m",) * 3 + ("rad",) * 3,
        measure=lambda T: np.hstack([_place(T), T[:, :3, :3].reshape(-1, 9)]),
        residual=lambda measured, T: np.hstack(
            [measured[:, :3] - _place(T), _turned(measured, T).as_rotvec()]
        ),
        derivative=_pose_derivative,
        position=True,
        orientation=True,
    ),
    Kind(
        name="distance",
        words="distance from the target to an anchor",
        units=("m",),
        measure=lambda T: np.linalg.norm(_place(T), axis=1, keepdims=True),
        derivative=lambda _, T, twists: np.asarray(
            np.einsum("ni,nip->np", _unit(_place(T)), twists[:, :3])[:, None]
        ),
        readings=_LENGTH,
        directions=("x", "y", "z"),
        own_frame=True,
        locate=_anchor,
        place="Anchor",
    ),
    Kind(
        name="pair",
        words="distance between the target's places at two poses",
        units=("m",),
        measure=lambda T: np.linalg.norm(T[:, 0, :3, 3] - T[:, 1, :3, 3], axis=1, keepdims=True),
        derivative=_between_derivative,
        readings=_LENGTH,
        paired=True,
        directions=(),
    ),
    Kind(
        name="fixed",
        words="the target sits at one unknown point",
        units=("m",) * 3,
        residual=lambda _, T: -_place(T),
        derivative=_of_position,
        directions=("x", "y", "z"),
        own_frame=True,
        fewest=2,
        locate=lambda points, _, T_frame_base: _standing(T_frame_base, points.mean(axis=0)),
        place="Socket",
    ),
    Kind(
        name="plane",
        words="the target touches one unknown plane",
        units=("m",),
        residual=lambda _, T: -T[:, 2:3, 3],
        derivative=lambda _measured, _T, twists: twists[:, 2:3],
        directions=("z", "rx", "ry"),
        own_frame=True,
        own_axes=True,
        fewest=4,
        locate=_plane,
        settle=lambda T: _plane_frame(T[2, :3], -float(T[2, 3])),
        place="Plane",
    ),
):
    register(_kind)
