"""Checks of the functions of a kind of measurement, at generic poses, before it is registered.

A fault in them would show far from its cause: as an error of NumPy in a fit, or as a fit that finds no minimum.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array
from calib.errors import CalibError
from calib.model.parameter_sets import DIRECTIONS
from calib.numerics.differences import disagreement

#: Number of poses n: many, as a camera sees few of them.
_COUNT = 64

#: Distances of the targets from the frame's origin, from and to [m].
_DISTANCES = (0.3, 1.5)

#: Step of the differences [m and rad]: long enough for readings in single precision.
_STEP = 1e-3

#: Motions by which a target is moved, as columns: along and about each axis, and a little of all of them together.
_MOTIONS = np.column_stack([np.eye(6), np.full(6, 0.1)])

#: The motions in messages.
_MOTION_WORDS = (
    *(f"along {axis}" for axis in DIRECTIONS[:3]),
    *(f"about {axis[1]}" for axis in DIRECTIONS[3:]),
    "along and about all axes",
)


class Checked(Protocol):
    """The parts of a `calib.data.kinds.Kind` that are checked."""

    @property
    def name(self) -> str:
        """Name of the kind."""

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each scalar of the residual."""

    @property
    def size(self) -> int:
        """Number k of measured numbers a row."""

    @property
    def paired(self) -> bool:
        """True if one measurement takes two rows."""

    @property
    def depends_on_orientation(self) -> bool:
        """True if the residual depends on the target's orientation."""

    @property
    def measure(self) -> Callable[[Array], Array] | None:
        """Reading (n, k) of a perfect instrument at poses T_frame_target; None: there is no such function."""

    @property
    def derivative(self) -> Callable[[Array, Array, Array], Array]:
        """Derivative (n, s, p) of the prediction by p parameters, from readings, poses and their twists."""

    def residual_of(self, measured: Array, T_frame_target: Array) -> Array:
        """Return measured minus predicted, shape (n, s), of readings (n, k) at poses T_frame_target."""


@np.errstate(all="ignore")  # functions need not have a value at each pose
def check_functions(kind: Checked) -> None:
    """Call the functions of a kind at generic poses, and compare its derivative with differences of its residual.

    The poses are 0.3 to 1.5 m from the frame's origin, on all sides of it. Functions need not have a value at each of
    them. A kind without ``measure`` that reads numbers is not checked: what it would read is not known.

    Args:
        kind: The kind.

    Raises:
        CalibError: A function raises an exception or returns another shape; the residual depends on the orientation
            of the target, and the kind does not state so; or the derivative is wrong.
    """
    if kind.measure is None and kind.size:
        return

    # Random poses of one target or of both rows of a pair, (n, rows, 4, 4), the same in each call.
    rng = np.random.default_rng(0)
    rows = 2 if kind.paired else 1
    count = _COUNT * rows
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = Rotation.from_quat(rng.normal(size=(count, 4))).as_matrix()
    poses[:, :3, 3] = directions * rng.uniform(*_DISTANCES, (count, 1))
    poses = poses.reshape(_COUNT, rows, 4, 4)

    T = _at_rows(kind, poses)
    measured = np.zeros((len(T), 0))
    if kind.measure is not None:
        call = partial(kind.measure, T)
        meaning = "one number for x, y, z and each reading"
        measured = _called(kind, "measure", call, (len(T), kind.size), meaning)
    expected = _differences(kind, measured, poses)

    # A residual that is said not to depend on orientations does not change when a target turns.
    if not kind.depends_on_orientation:
        without_turns = expected.copy()
        for k in range(expected.shape[2]):
            if 3 <= k % _MOTIONS.shape[1] < 6:
                without_turns[:, :, k] = 0.0
        fault = disagreement(without_turns, expected)
        if fault is not None:
            raise CalibError(
                f"The kind '{kind.name}' depends on the orientation of the target: scalar {fault.scalar + 1} changes "
                f"by {fault.expected:.3g} {kind.units[fault.scalar]}/rad as it turns {_motion(kind, fault.parameter)}. "
                "State 'turns=True'."
            )

    # The derivative is called with whole twists, and with their first three rows if only positions matter.
    twists = np.tile(_twists(poses.shape[1]), (len(poses), 1, 1, 1))
    for height in (6,) if kind.depends_on_orientation else (6, 3):
        cut = _at_rows(kind, twists[:, :, :height])
        call = partial(kind.derivative, measured, T, cut)
        meaning = f"units by parameters, of twists {cut.shape}"
        given = _called(kind, "derivative", call, expected.shape, meaning)
        fault = disagreement(given, expected)
        if fault is not None:
            raise CalibError(
                f"The kind '{kind.name}': 'derivative' does not agree with finite differences: for scalar "
                f"{fault.scalar + 1} [{kind.units[fault.scalar]}] of a target that moves "
                f"{_motion(kind, fault.parameter)} it is {fault.given:.3g}, the difference {fault.expected:.3g}. "
                "Check its sign and terms: it is that of 'measure', or minus that of 'residual'."
            )


def _at_rows(kind: Checked, values: Array) -> Array:
    """Return values (n, rows, ...) as the functions of a kind take them: without the rows' axis if there is one row."""
    return values if kind.paired else values[:, 0]


def _twists(rows: int) -> Array:
    """Return twists [m, rad] that move one of 1 or 2 rows at a time by each motion: shape (rows, 6, p), p = 7 rows."""
    return np.asarray(np.kron(np.eye(rows), _MOTIONS).reshape(rows, 6, -1), dtype=np.float64)


def _differences(kind: Checked, measured: Array, poses: Array) -> Array:
    """Return minus the central differences of the residual for each motion, shape (n, s, p) [its unit per m or rad].

    ``measured``, shape (n, k), is what a perfect instrument reads at ``poses``, shape (n, rows, 4, 4).
    """
    shape = (len(poses), len(kind.units))
    meaning = "one number for each of its units"

    def residual(twist: Array) -> Array:
        """Return the residual (n, s) of the poses moved by a twist (rows, 6) [m, rad] along the axes of their frame."""
        moved: Array = poses.copy()
        moved[..., :3, :3] = Rotation.from_rotvec(twist[:, 3:]).as_matrix() @ poses[..., :3, :3]
        moved[..., :3, 3] += twist[:, :3]
        call = partial(kind.residual_of, measured, _at_rows(kind, moved))
        return _called(kind, "residual", call, shape, meaning)

    steps = np.moveaxis(_STEP * _twists(poses.shape[1]), -1, 0)
    changes = [residual(-step) - residual(step) for step in steps]
    return np.stack(changes, axis=-1) / (2.0 * _STEP)


def _motion(kind: Checked, parameter: int) -> str:
    """Return a motion, a column of `_twists` from 0, in words with the row of a pair: ``"about x (first row)"``."""
    row, motion = divmod(parameter, len(_MOTION_WORDS))
    of_row = (" (first row)", " (second row)")[row] if kind.paired else ""
    return f"{_MOTION_WORDS[motion]}{of_row}"


def _called(
    kind: Checked, name: str, call: Callable[[], Any], shape: tuple[int, ...], meaning: str
) -> Array:
    """Call a function of a kind; CalibError if it fails, or if its result is not an array of numbers of the shape."""
    where = f"The kind '{kind.name}': '{name}'"
    must = f"it must return an array of shape {shape} for {shape[0]} poses: {meaning}"
    try:
        result = call()
        shape_given = getattr(result, "shape", None)
        values = np.asarray(result, dtype=np.float64)
    except Exception as error:
        cause = " ".join(f"{type(error).__name__}: {error}".split()).rstrip(".")
        raise CalibError(f"{where} fails with {cause}; {must}, NaN where there is none.") from error
    if shape_given != shape:
        given = "no array" if shape_given is None else f"an array of shape {shape_given}"
        raise CalibError(f"{where} returns {given}; {must}.")
    return values
