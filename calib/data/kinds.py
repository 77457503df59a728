"""Kinds of measurement: what a row of a table says of the pose of its target, one row of a registry for each kind.

With the pose (R, p) of the target in its measurement frame, what is measured, what is predicted, and the residual are

    point      the position                      p              m - p
    pose       position and orientation          p, R           m - p, log(M R^T)    the rotation vector in SO(3)
    distance   the distance to an anchor         |p|            d - |p|              the frame stands at the anchor
    pair       the distance between two rows     |p_i - p_j|    d - |p_i - p_j|
    fixed      nothing: the target is in a socket               0 - p                the frame stands in the socket
    plane      nothing: the target is on a plane                0 - p_z              the frame lies in the plane
    face       nothing: the target is flat on a plane           0 - p_z, 0 - w       the frame lies in the plane
    clasp      nothing: the target is held in one pose          0 - p, log(R^T)      the frame stands where it is held
    pixel      the image of a corner         u = f(R P + p)     m - u                the frame is the camera's
    stop       a joint's true angle          q                  m - q                the frame is the joint's

P is the corner on the board, which is the target, and f the camera's lens: the internals of a camera, see
`calib.model.internals` and `calib.camera.optics`. w = s (-e_y, e_x) are the sines of the tilts of the target's z axis e
about x and y of the plane; with s, the sign of e_z, it may point to either side.

A ball in a socket, an anchored distance and a plane are thus points: some of their coordinates are measured, in a frame
that is unknown in some directions. One error model serves all. `register` adds a kind from outside; see
docs/extending.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import calib.basics.plugins as plugins
from calib.basics.arguments import check_type
from calib.basics.arrays import Array, rigid_inverse
from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.units import UNITS, Quantity
from calib.basics.values import Value
from calib.camera import optics
from calib.data.kind_check import check_functions
from calib.data.stops import stop_derivative, stop_residual
from calib.errors import CalibError, MeasurementError, choices
from calib.model.internals import Internals, InternalValues, StatedSize
from calib.model.parameter_sets import DIRECTIONS
from calib.numerics.correlated_noise import POSE_UNITS
from calib.numerics.geometry import inverse_right_jacobian

#: Least and largest standard deviation accepted for a measurement [m, rad or px]: no instrument is
#: better or worse, and the squares of numbers beyond leave the range of doubles.
SIGMAS = (1e-15, 1e6)

#: Units of the three coordinates of a point.
_COORDINATES = ("m", "m", "m")

#: A distance below this has no direction [m].
_TINY = 1e-12

#: Relative singular value below which an anchor's coordinates count as undetermined.
_RANK_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class Reading:
    """A column of the table with a number that rows of a kind measure.

    Raises:
        CalibError: The quantity is none of these.
    """

    #: Name of the column without its unit, ``"distance"``.
    name: str
    #: What it measures: ``"length"``, ``"angle"`` or ``"pixel"``.
    quantity: Quantity = "length"
    #: Whether it is always greater than zero, as a distance is.
    positive: bool = False

    def __post_init__(self) -> None:
        """Raise CalibError if the quantity is none of those of residuals."""
        allowed = [unit.quantity for unit in RESIDUAL_UNITS.values()]
        if self.quantity not in allowed:
            unit = UNITS.get(str(self.quantity))
            hint = f"; '{unit.symbol}' is a unit of '{unit.quantity}'" if unit else ""
            raise CalibError(
                f"The reading '{self.name}' has the quantity '{self.quantity}'; allowed are {choices(allowed)}{hint}."
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind(Value):
    """A kind of measurement: what its rows measure, and the prediction with its derivative.

    The functions of a kind take and return arrays over n rows, in SI units, not whitened:

    * ``measured``, shape (n, k): what the rows measured. First x, y, z of kinds that measure a
      position; then the nine entries of R_frame_target, row after row, of kinds that measure an
      orientation; then one number for each of ``readings``.
    * ``T_frame_target``, shape (n, 4, 4) [m]: pose of the target in the measurement frame.
    * ``twists``, shape (n, 6, p): derivative of these poses by p parameters, along the axes of the
      measurement frame: velocity of the target's origin [m per parameter unit], then angular
      velocity [rad per parameter unit]. Only the first three rows, (n, 3, p), if no row of the
      table depends on the orientation of its target.

    Of a ``paired`` kind poses and twists are those of both rows: (n, 2, 4, 4), (n, 2, 6, p).

    Raises:
        CalibError: Neither ``residual`` nor ``measure`` is given; ``units`` are none or unknown; they do not begin
            with the three lengths of a measured position; an orientation is measured without a position; or, without
            ``residual``, the units are not those of what is measured.
    """

    #: Name of the kind, as in the table's column ``kind``.
    name: str
    #: What a row measures, for texts: ``"position of the target"``.
    words: str
    #: Unit of each of the s residual scalars, of `calib.basics.channels.RESIDUAL_UNITS`: ``"m"``, ``"rad"`` or
    #: ``"px"``. A measured position has the first three.
    units: tuple[str, ...]
    #: Derivative of the prediction by the parameters, which is minus that of the residual:
    #: (measured, T_frame_target, twists) to shape (n, s, p) [its unit per parameter unit].
    derivative: Callable[..., Any]
    #: Reading of a perfect instrument, to predict and to simulate with: T_frame_target to shape
    #: (n, k), in SI units. None for kinds whose target is held, such as a ball in a socket: their
    #: poses cannot be chosen.
    measure: Callable[..., Array] | None = None
    #: Residual, measured minus predicted: (measured, T_frame_target) to shape (n, s), in ``units``.
    #: None: the difference ``measured - measure(T_frame_target)``.
    residual: Callable[..., Array] | None = None
    #: Whether the columns x, y, z are measured.
    position: bool = False
    #: Whether an orientation is measured, with the position. The next three units are its angles, a rotation vector.
    orientation: bool = False
    #: Whether the residual depends on the target's orientation, not on its position alone. None: it does if an
    #: orientation or another angle is measured.
    turns: bool | None = None
    #: The other columns that are measured.
    readings: tuple[Reading, ...] = ()
    #: Whether one measurement takes two rows, which share a word in the column ``pair``.
    paired: bool = False
    #: Directions of the measurement frame, of `DIRECTIONS`, that rows of this kind determine.
    directions: tuple[str, ...] = DIRECTIONS
    #: Whether the measurement frame is that of the object measured against, such as a socket, and
    #: is estimated unless the cell gives it; False: it is the instrument's frame.
    own_frame: bool = False
    #: Whether ``directions`` are along the axes of the measurement frame; False: of the base.
    own_axes: bool = False
    #: Directions of the target along its own axes, of `DIRECTIONS`, that rows determine beside those of the frame, and
    #: that are estimated with it. None: its position, and of a kind that turns its orientation.
    target_directions: tuple[str, ...] | None = None
    #: Least number of rows of a group: with fewer, its frame fits whatever the robot does.
    fewest: int = 1
    #: Start of the estimate of the measurement frame: (positions of the targets in the base,
    #: shape (n, 3) [m], or their poses, (n, 4, 4), of a kind that turns; measured, (n, k); a guess of
    #: T_frame_base, (4, 4) [m]) to T_frame_base, (4, 4) [m]. None: it is found from the measured positions, as of an
    #: instrument's frame.
    locate: Callable[[Array, Array, Array], Array] | None = None
    #: Choice of the directions that no row determines, after the estimate: T_frame_base, shape
    #: (4, 4) [m], to an equivalent T_frame_base. None: they stay as the estimate left them.
    settle: Callable[[Array], Array] | None = None
    #: What the frame stands for, in texts: ``"Socket"``.
    place: str = "Measurement frame"
    #: Whether the row's target is a joint, at a stop: see `calib.data.stops`.
    of_joint: bool = False
    #: Numbers of the instrument by which readings are predicted, besides the pose; None: there are none. With c of them
    #: ``measure``, ``residual`` and ``derivative`` take their values as a last argument, shape (n, c), and
    #: ``derivative`` returns the derivative by them too, shape (n, s, c). `calib.instruments.internals` makes them of
    #: cell and table, for kinds of calib itself.
    internals: Internals | None = None

    def __post_init__(self) -> None:
        """Raise CalibError unless the residual is defined and its units fit what is measured."""
        if self.residual is None and self.measure is None:
            raise CalibError(f"The kind '{self.name}' needs 'residual' or 'measure'.")
        if not self.units:
            raise CalibError(
                f"The kind '{self.name}' needs 'units', one for each scalar of its residual."
            )
        for symbol in self.units:
            if symbol not in RESIDUAL_UNITS:
                raise CalibError(
                    f"The kind '{self.name}' has '{symbol}' among its units; allowed are {choices(RESIDUAL_UNITS)}."
                )
        if self.position and self.units[:3] != _COORDINATES:
            raise CalibError(
                f"The kind '{self.name}' measures a position: its first three units are those of x, y and z, 'm'."
            )
        if self.orientation and not self.position:
            raise CalibError(
                f"The kind '{self.name}' measures an orientation, so it needs 'position' too; an orientation alone is "
                "given as 'readings'."
            )
        is_rotation_vector = self.orientation and self.units.count("rad") == 3
        if is_rotation_vector and self.units[3:6] != ("rad", "rad", "rad"):
            raise CalibError(
                f"The kind '{self.name}' measures an orientation: its three units 'rad' follow those of the position."
            )
        if self.residual is not None:
            return

        # The prediction is subtracted from what is measured, in the same units.
        if self.orientation:
            raise CalibError(
                f"The kind '{self.name}' measures an orientation, which cannot be subtracted; give a 'residual'."
            )
        columns = [("xyz"[k], "length") for k in range(3 * self.position)]
        columns += [(reading.name, reading.quantity) for reading in self.readings]
        if len(columns) != len(self.units):
            raise CalibError(
                f"The kind '{self.name}' has the units {choices(self.units)} for the measured numbers "
                f"({choices([name for name, _ in columns])}); give one unit for each of 'readings' and of x, y, z of a "
                "position, or a 'residual' of your own."
            )
        for (name, quantity), symbol in zip(columns, self.units, strict=True):
            of_unit = RESIDUAL_UNITS[symbol].quantity
            if quantity != of_unit:
                raise CalibError(
                    f"The kind '{self.name}' has the unit '{symbol}', of the quantity '{of_unit}', for '{name}', which "
                    f"measures '{quantity}'; correct one of them, or give a 'residual' of your own."
                )

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle a registered kind by its name: the process that reads it must have registered it, in any order."""
        if _KINDS.get(self.name) is self:
            return get, (self.name,)
        return Value.__reduce__(self)

    @property
    def depends_on_orientation(self) -> bool:
        """True if the residual depends on the target's orientation, and not on its position alone."""
        if self.turns is None:
            return self.orientation or "rad" in self.units
        return self.turns

    @property
    def may_have_covariance(self) -> bool:
        """True if rows measure a position and an orientation, and nothing else: they may have a covariance."""
        return self.orientation and self.units == POSE_UNITS

    @property
    def holds_pose(self) -> bool:
        """True if the target is held in one pose: ``clasp``."""
        return self.measure is None and not self.size and self.units == POSE_UNITS

    @property
    def holds_axis(self) -> bool:
        """True if the target's z axis is held along that of the frame, and its turn about it is free: ``face``."""
        of_target = self.target_directions or ()
        return not self.orientation and {"rx", "ry"} <= {*of_target} and "rz" not in of_target

    @property
    def coordinates(self) -> bool:
        """True if the first lengths are the target's coordinates: ``point``, ``pose``, ``fixed``, ``clasp``."""
        held_at_point = self.units == _COORDINATES and not self.readings
        return self.position or held_at_point or self.holds_pose

    @property
    def vector_units(self) -> tuple[str, ...]:
        """Units in which the residual is a vector along, or about, the axes of the measurement frame.

        ``"m"`` of a position, and ``"rad"`` of a whole orientation.
        """
        whole = {"m": self.coordinates, "rad": self.orientation or self.holds_pose}
        return tuple(
            unit for unit, is_vector in whole.items() if is_vector and self.units.count(unit) == 3
        )

    @property
    def tells_place(self) -> bool:
        """True if rows determine where the base stands in the instrument's frame.

        Those of ``point`` and ``pose`` do, and of any kind of a user's that has ``directions`` and no ``own_frame``.
        """
        return bool(self.directions) and not self.own_frame

    @property
    def of_target(self) -> tuple[str, ...]:
        """Directions of an unknown target that are estimated, of `DIRECTIONS`."""
        if self.target_directions is not None:
            return self.target_directions
        return DIRECTIONS if self.depends_on_orientation else DIRECTIONS[:3]

    @property
    def is_contact(self) -> bool:
        """True if nothing is read: the target is held where the kind says, in a socket or on a plane."""
        return self.measure is None and not self.size

    @property
    def is_image(self) -> bool:
        """True if rows are the points of a board in images, with columns for the point as designed."""
        return self.internals is not None and self.internals.is_camera

    @property
    def measures_length(self) -> bool:
        """True if rows compare the arm with a unit of length, a board's too: not a socket or a touched plane."""
        reads_length = any(reading.quantity == "length" for reading in self.readings)
        return self.position or reads_length or self.is_image

    @property
    def free(self) -> bool:
        """True if each row is a measurement and its target may be anywhere: poses can be planned."""
        return self.measure is not None and not self.paired

    @property
    def size(self) -> int:
        """Number k of measured numbers a row."""
        return 3 * self.position + 9 * self.orientation + len(self.readings)

    def readings_at(self, T_frame_target: Array, internals: InternalValues | None = None) -> Array:
        """Return what a perfect instrument reads; only for kinds that have ``measure``.

        Args:
            T_frame_target: Poses, shape (n, 4, 4) [m]; of a paired kind (n, 2, 4, 4).
            internals: Those of the instrument at the n rows; None if it has none.

        Returns:
            shape (n, k), in SI units.
        """
        assert self.measure is not None
        return self.measure(T_frame_target, *self._further(internals))

    def residual_of(
        self, measured: Array, T_frame_target: Array, internals: InternalValues | None = None
    ) -> Array:
        """Return the residual, measured minus predicted.

        Args:
            measured: Measured numbers, shape (n, k), in SI units.
            T_frame_target: Poses, shape (n, 4, 4) [m]; of a paired kind (n, 2, 4, 4).
            internals: Those of the instrument at the n rows; None if it has none.

        Returns:
            The residual, shape (n, s), in ``units``, not whitened.
        """
        if self.residual is not None:
            return self.residual(measured, T_frame_target, *self._further(internals))
        return measured - self.readings_at(T_frame_target, internals)

    def derivative_of(
        self,
        measured: Array,
        T_frame_target: Array,
        twists: Array,
        internals: InternalValues | None = None,
    ) -> Array:
        """Return the derivative of the prediction by p parameters: minus that of the residual.

        Args:
            measured: Measured numbers, shape (n, k), in SI units.
            T_frame_target: Poses, shape (n, 4, 4) [m]; of a paired kind (n, 2, 4, 4).
            twists: Motion of the target by each parameter, shape (n, 6, p) or (n, 3, p); of a paired kind of both rows.
            internals: Those of the instrument, and the parameters that change them; None if it has none.

        Returns:
            Shape (n, s, p), in ``units`` per unit of each parameter.
        """
        if internals is None:
            return np.asarray(self.derivative(measured, T_frame_target, twists))
        by_motion, by_internals = self.derivative(
            measured, T_frame_target, twists, *self._further(internals)
        )
        internals.add_derivative(by_motion, by_internals)
        return np.asarray(by_motion)

    @staticmethod
    def _further(internals: InternalValues | None) -> tuple[Array, ...]:
        """Return the last argument of the kind's functions: values of the internals, (n, c); none without."""
        return () if internals is None else (internals.values,)


# The registry

_KINDS: dict[str, Kind] = {}


def register(kind: Kind) -> None:
    """Add a kind of measurement: tables, fits, simulations and files of this process know it from then on.

    Nothing can be replaced or taken out again. Worker processes load the plugins of the process that sends the jobs.

    Args:
        kind: The kind, with a name of its own; its readings have names of their own too, or are
            those of a kind that is registered.

    Raises:
        ArgumentError: It is not a kind.
        CalibError: A kind or a column of this name is registered, or one of its functions is wrong at generic poses;
            see `calib.data.kind_check.check_functions`.
    """
    check_type("kind", kind, Kind, "a Kind of calib.data.kinds")
    if kind.name in _KINDS:
        raise CalibError(f"There is a kind '{kind.name}' already; rename yours.")
    columns = readings()
    for reading in kind.readings:
        if columns.get(reading.name, reading) != reading:
            raise CalibError(
                f"The column '{reading.name}' belongs to another kind and is read differently there (quantity or "
                f"sign); rename that of '{kind.name}'."
            )
    check_functions(kind)
    _add(kind)


def _add(kind: Kind) -> None:
    """Add a kind to the registry without checks; those of calib itself are checked by its tests."""
    _KINDS[kind.name] = kind


def names() -> tuple[str, ...]:
    """Return the names of all kinds, in the order in which they were registered."""
    return tuple(_KINDS)


def get(name: str) -> Kind:
    """Return the kind of this name.

    Raises:
        MeasurementError: There is none; the message lists the names of all kinds.
    """
    if name not in _KINDS:
        raise MeasurementError(plugins.unknown("kinds", name, _KINDS))
    return _KINDS[name]


def readings() -> dict[str, Reading]:
    """Return the readings of all kinds, by the names of their columns."""
    return {reading.name: reading for kind in _KINDS.values() for reading in kind.readings}


# Positions and poses


def _position(T: Array) -> Array:
    """Return the positions of poses T_frame_target (..., 4, 4), shape (..., 3) [m]."""
    return T[..., :3, 3]


def _position_derivative(_measured: Array, _T: Array, twists: Array) -> Array:
    """Return the derivative of a position by p parameters, from twists (n, 6 or 3, p): shape (n, 3, p) [m per unit]."""
    return twists[:, :3]


def _pose_reading(T: Array) -> Array:
    """Return position [m] and rotation matrix, row after row, of poses T_frame_target (n, 4, 4), shape (n, 12)."""
    return np.hstack([_position(T), T[:, :3, :3].reshape(-1, 9)])


def _rotation_error(measured: Array, T: Array) -> Rotation:
    """Return M R^T, the rotations from the orientations of poses T (n, 4, 4) to the measured ones in (n, 12)."""
    M = measured[:, 3:12].reshape(-1, 3, 3)
    return Rotation.from_matrix(M @ T[:, :3, :3].transpose(0, 2, 1))


def _pose_residual(measured: Array, T: Array) -> Array:
    """Return m - p and log(M R^T) of measured (n, 12) and predicted poses T (n, 4, 4), shape (n, 6) [m] and [rad]."""
    shift = measured[:, :3] - _position(T)
    return np.hstack([shift, _rotation_error(measured, T).as_rotvec()])


def _pose_derivative(measured: Array, T: Array, twists: Array) -> Array:
    """Return the derivative of position and orientation by p parameters, from twists (n, 6, p): shape (n, 6, p).

    It is in m, then rad, per unit; ``measured`` is (n, 12), T the predicted poses (n, 4, 4).

    A rotation w of the target along the frame's axes makes log(M R^T) of the residual to
    log(M R^T exp(-w)): the residual changes by -J w, the prediction by J w, with the inverse
    right Jacobian J of M R^T.
    """
    jacobian = inverse_right_jacobian(_rotation_error(measured, T))
    return np.concatenate([twists[:, :3], jacobian @ twists[:, 3:]], axis=1)


# Distances


def _unit(v: Array) -> Array:
    """Return vectors (..., 3) divided by their lengths; a zero vector stays zero."""
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), _TINY))


def _distance(T: Array) -> Array:
    """Return the distances |p| of targets at poses T (n, 4, 4) from the frame's origin, shape (n, 1) [m]."""
    return np.asarray(np.linalg.norm(_position(T), axis=1, keepdims=True))


def _distance_derivative(_measured: Array, T: Array, twists: Array) -> Array:
    """Return the derivative of the distance |p| at poses T (n, 4, 4) by p parameters: shape (n, 1, p) [m per unit].

    The twists, (n, 6 or 3, p), are the motions of the targets by the parameters.
    """
    along = _unit(_position(T))
    return np.asarray(np.einsum("ni,nip->np", along, twists[:, :3])[:, None])


def _pair_distance(T: Array) -> Array:
    """Return the distances between the targets of pairs of poses (n, 2, 4, 4), shape (n, 1) [m]."""
    apart = T[:, 0, :3, 3] - T[:, 1, :3, 3]
    return np.asarray(np.linalg.norm(apart, axis=1, keepdims=True))


def _pair_derivative(_measured: Array, T: Array, twists: Array) -> Array:
    """Return the derivative of |p_1 - p_2| of pairs of poses T (n, 2, 4, 4) by p parameters: (n, 1, p) [m per unit].

    The twists, (n, 2, 6 or 3, p), are the motions of both targets by the parameters.
    """
    p = _position(T)
    along = _unit(p[:, 0] - p[:, 1])
    relative = twists[:, 0, :3] - twists[:, 1, :3]
    return np.asarray(np.einsum("ni,nip->np", along, relative)[:, None])


def _anchor_frame(points: Array, measured: Array, T_frame_base: Array) -> Array:
    """Return T_frame_base of a frame at an anchor a, from its distances d (n, 1) to points p (n, 3) of the base [m].

    |p|^2 - d^2 = 2 p a - |a|^2 is linear in (a, |a|^2); the frame keeps the turn of the given T_frame_base.
    """
    centre = points.mean(axis=0)
    p = points - centre
    A = np.column_stack([2.0 * p, -np.ones(len(p))])
    rhs = np.sum(p**2, axis=1) - measured[:, 0] ** 2
    solution = np.linalg.lstsq(A, rhs, rcond=_RANK_TOLERANCE)[0]
    return _with_origin_at(T_frame_base, solution[:3] + centre)


def _with_origin_at(T_frame_base: Array, point: Array) -> Array:
    """Return T_frame_base (4, 4) of a frame turned as given, with its origin at a point (3,) of the base [m]."""
    T: Array = T_frame_base.copy()
    T[:3, 3] = -T[:3, :3] @ point
    return T


# Sockets and planes


def _socket_residual(_measured: Array, T: Array) -> Array:
    """Return 0 - p of targets at poses T (n, 4, 4), shape (n, 3) [m]: the socket is the frame's origin."""
    return -_position(T)


def _socket_frame(points: Array, _measured: Array, T_frame_base: Array) -> Array:
    """Return T_frame_base of a frame in a socket: at the mean of the targets' positions (n, 3) in the base [m].

    It keeps the turn of the given T_frame_base, (4, 4).
    """
    return _with_origin_at(T_frame_base, points.mean(axis=0))


def _plane_residual(_measured: Array, T: Array) -> Array:
    """Return 0 - p_z of targets at poses T (n, 4, 4), shape (n, 1) [m]: the plane is the frame's x-y plane."""
    return -T[:, 2:3, 3]


def _plane_derivative(_measured: Array, _T: Array, twists: Array) -> Array:
    """Return the derivative of the height p_z over the plane by p parameters: shape (n, 1, p) [m per unit].

    The twists, (n, 6 or 3, p), are the motions of the targets by the parameters.
    """
    return twists[:, 2:3]


def _fitted_plane(points: Array, _measured: Array, _T_frame_base: Array) -> Array:
    """Return T_frame_base of a frame in the plane that fits the targets' positions (n, 3) in the base [m] best."""
    centre = points.mean(axis=0)
    normal = np.linalg.svd(points - centre)[2][-1]
    return _plane_frame(normal, float(normal @ centre))


def _settled_plane(T_frame_base: Array) -> Array:
    """Return T_frame_base of the same plane with origin and turn about its normal as `_plane_frame` chooses them."""
    return _plane_frame(T_frame_base[2, :3], -float(T_frame_base[2, 3]))


def _plane_frame(normal: Array, distance: float) -> Array:
    """Return T_frame_base of a frame whose x-y plane is n . p = d, its origin and axes as near to the base's as can be.

    The z axis points to the side on which the largest component of the unit normal n is positive.
    """
    sign = float(np.sign(normal[np.argmax(np.abs(normal))]))
    axis = np.cross(sign * normal, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(axis))
    T = np.eye(4)
    if sine > _TINY:
        angle_per_sine = np.arctan2(sine, sign * normal[2]) / sine
        T[:3, :3] = Rotation.from_rotvec(angle_per_sine * axis).as_matrix()
    T[2, 3] = -sign * distance
    return T


def _face_residual(_measured: Array, T: Array) -> Array:
    """Return 0 - p_z [m] and 0 - w [rad] of targets at poses T (n, 4, 4) in the plane's frame, shape (n, 3)."""
    e = _upward(T)
    return np.stack([-T[:, 2, 3], e[:, 1], -e[:, 0]], axis=1)


def _face_derivative(_measured: Array, T: Array, twists: Array) -> Array:
    """Return the derivative of the height p_z and the tilts w by p parameters, from twists (n, 6, p): (n, 3, p).

    A rotation omega of the target along the plane's axes moves its z axis e by omega x e.
    """
    motion = np.cross(twists[:, 3:], _upward(T)[:, :, None], axis=1)
    return np.stack([twists[:, 2], -motion[:, 1], motion[:, 0]], axis=1)


def _upward(T: Array) -> Array:
    """Return the z axes of targets at poses T (n, 4, 4), or their opposites if these point up, shape (n, 3)."""
    e = T[:, :3, 2]
    return np.asarray(np.where(e[:, 2:] < 0.0, -e, e))


def _faced_plane(T_base_target: Array, _measured: Array, _T_frame_base: Array) -> Array:
    """Return T_frame_base of a frame in the plane on which targets at poses (n, 4, 4) in the base lie flat.

    Its normal is the line nearest to their z axes, whichever way these point; its height is the mean of theirs.
    """
    z = T_base_target[:, :3, 2]
    normal = np.linalg.svd(z)[2][0]
    return _plane_frame(normal, float(np.mean(_position(T_base_target) @ normal)))


# Poses that are held


def _clasp_residual(_measured: Array, T: Array) -> Array:
    """Return 0 - p [m] and log(R^T) [rad] of targets at poses T (n, 4, 4), shape (n, 6)."""
    return _pose_residual(_held(T), T)


def _clasp_derivative(_measured: Array, T: Array, twists: Array) -> Array:
    """Return the derivative of position and orientation by p parameters as of a pose, shape (n, 6, p)."""
    return _pose_derivative(_held(T), T, twists)


def _held(T: Array) -> Array:
    """Return the pose in which targets at poses T (n, 4, 4) are held, that of the frame, as read poses (n, 12)."""
    return _pose_reading(np.broadcast_to(np.eye(4), T.shape))


def _clasp_frame(T_base_target: Array, _measured: Array, _T_frame_base: Array) -> Array:
    """Return T_frame_base of a frame at the mean of the targets' poses (n, 4, 4) in the base [m]."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_matrix(T_base_target[:, :3, :3]).mean().as_matrix()
    T[:3, 3] = _position(T_base_target).mean(axis=0)
    return rigid_inverse(T)


# Images


def _image_derivative(
    _measured: Array, T: Array, twists: Array, internals: Array
) -> tuple[Array, Array]:
    """Return the derivatives of images [px] by p parameters, (n, 2, p), and by c internals (n, c), (n, 2, c).

    ``T`` (n, 4, 4) and ``twists`` (n, 6, p) are poses and motions of the boards in their cameras.
    """
    return optics.image_derivatives(T, twists, internals)


def _pixel_lengths(points: Array, internals: Array) -> Array:
    """Return the length across the line of sight that a pixel is at points (n, 3) in the camera, shape (n,) [m/px].

    It is Z / f at the depth Z, with the mean f of both focal lengths.
    """
    focal = np.mean(internals[:, optics.INTRINSICS][:, :2], axis=1)
    return np.asarray(points[:, 2] / focal)


_OPTICS = Internals(
    count=optics.COUNT,
    is_camera=True,
    point_number=optics.CORNER,
    points=optics.board_points,
    lengths=_pixel_lengths,
    view_poses=optics.view_poses,
    stated=(
        StatedSize(
            name="focal_length",
            owner=optics.CAMERA,
            columns=tuple(range(optics.COUNT)[optics.FOCAL]),
            relative=True,
            is_unit_of_length=False,
        ),
        StatedSize(
            name="board_scale",
            owner=optics.BOARD,
            columns=optics.SCALE,
            relative=False,
            is_unit_of_length=True,
        ),
    ),
)


# The nine kinds

_DISTANCE_READING = Reading("distance", positive=True)

_add(
    Kind(
        name="point",
        words="position of the target",
        units=("m",) * 3,
        measure=_position,
        derivative=_position_derivative,
        position=True,
    )
)
_add(
    Kind(
        name="pose",
        words="position and orientation of the target",
        units=("m",) * 3 + ("rad",) * 3,
        measure=_pose_reading,
        residual=_pose_residual,
        derivative=_pose_derivative,
        position=True,
        orientation=True,
    )
)
_add(
    Kind(
        name="distance",
        words="distance from the target to an anchor",
        units=("m",),
        measure=_distance,
        derivative=_distance_derivative,
        readings=(_DISTANCE_READING,),
        directions=("x", "y", "z"),
        own_frame=True,
        locate=_anchor_frame,
        place="Anchor",
    )
)
_add(
    Kind(
        name="pair",
        words="distance between the target's places at two poses",
        units=("m",),
        measure=_pair_distance,
        derivative=_pair_derivative,
        readings=(_DISTANCE_READING,),
        paired=True,
        directions=(),
    )
)
_add(
    Kind(
        name="fixed",
        words="the target sits at one unknown point",
        units=("m",) * 3,
        residual=_socket_residual,
        derivative=_position_derivative,
        directions=("x", "y", "z"),
        own_frame=True,
        fewest=2,
        locate=_socket_frame,
        place="Socket",
    )
)
_add(
    Kind(
        name="plane",
        words="the target touches one unknown plane",
        units=("m",),
        residual=_plane_residual,
        derivative=_plane_derivative,
        directions=("z", "rx", "ry"),
        own_frame=True,
        own_axes=True,
        fewest=4,
        locate=_fitted_plane,
        settle=_settled_plane,
        place="Plane",
    )
)
_add(
    Kind(
        name="face",
        words="the target lies flat on one unknown plane",
        units=("m", "rad", "rad"),
        residual=_face_residual,
        derivative=_face_derivative,
        directions=("z", "rx", "ry"),
        own_frame=True,
        own_axes=True,
        target_directions=("z", "rx", "ry"),
        fewest=2,
        locate=_faced_plane,
        settle=_settled_plane,
        place="Plane",
    )
)
_add(
    Kind(
        name="clasp",
        words="the target is held in one unknown pose",
        units=POSE_UNITS,
        residual=_clasp_residual,
        derivative=_clasp_derivative,
        own_frame=True,
        target_directions=(),
        fewest=2,
        locate=_clasp_frame,
        place="Clasp",
    )
)
_add(
    Kind(
        name="pixel",
        words="image of a corner of the board",
        units=("px",) * 2,
        measure=optics.images,
        derivative=_image_derivative,
        turns=True,
        readings=(Reading("u", "pixel"), Reading("v", "pixel")),
        own_frame=True,
        fewest=8,
        place="Camera",
        internals=_OPTICS,
    )
)
_add(
    Kind(
        name="stop",
        words="true angle of a joint at its stop",
        units=("rad",),
        residual=stop_residual,
        derivative=stop_derivative,
        readings=(Reading("stop", "angle"),),
        directions=(),
        own_frame=True,
        place="Stop",
        of_joint=True,
    )
)
plugins.watch("kinds", _KINDS)
