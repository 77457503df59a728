"""Internals of instruments: the numbers, besides the target's pose, by which an instrument's readings are predicted.

A tracker has none. A camera has those of its lens, and of the print that it looks at. A kind of measurement declares
them (`Internals`); each row has its own values of them, which are columns of an array. Parameters of the error model
add to some columns in some rows; what is estimated, and what is known of it beforehand, is an `InternalUnknown`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, Integers
from calib.basics.values import Value
from calib.model.error_model import Parameter

#: In place of the index of a parameter, for a number that no parameter changes.
FIXED = -1


@dataclass(frozen=True, slots=True)
class StatedSize:
    """Numbers among the internals that a user states together, and that may all be wrong by one share."""

    #: Name of what is stated: ``"focal_length"``
    name: str
    #: Column with the number of the object that has them, such as a camera's
    owner: int
    #: Columns of the numbers
    columns: tuple[int, ...]
    #: Whether a share is of the numbers themselves; False: the numbers are shares already, such as errors of scale
    relative: bool
    #: Whether it is the unit of length of what is measured, as the scale of a print is
    is_unit_of_length: bool


@dataclass(frozen=True, slots=True)
class Internals:
    """The internals that the instrument of a kind of measurement has.

    The functions take the internals of n rows, shape (n, ``count``).
    """

    #: Number of columns
    count: int
    #: Whether the instrument is a camera: its rows are the points of a board in images
    is_camera: bool
    #: Column with the number of the measured point on the target; rows of one pose and different points are not repeats
    point_number: int
    #: Place of the measured point in the target's frame: internals to shape (n, 3) [m]
    points: Callable[[Array], Array]
    #: Length at the measured point that a unit of the reading is: (points in the instrument's frame, shape (n, 3) [m];
    #: internals) to shape (n,) [m per unit]
    lengths: Callable[[Array, Array], Array]
    #: Poses of the target by all rows of each view: (measured numbers and internals of each view) to T_frame_target,
    #: shape (4, 4) [m], of each; None for a view that does not determine it
    view_poses: Callable[[Sequence[tuple[Array, Array]]], list[Array | None]]
    #: What a user states of them
    stated: tuple[StatedSize, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class InternalUnknown(Value):
    """An internal of an instrument that is estimated, and what is known of it beforehand."""

    #: The parameter: the change from the number with which readings are predicted before the fit
    parameter: Parameter
    #: Mean of its prior, in its unit: 0 if the fit begins at what was given
    mean: float
    #: Standard deviation of its prior, in its unit
    sigma: float
    #: The change as estimated, in its unit; 0 before the fit
    change: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class InternalValues(Value):
    """The internals of n rows, and the parameters that add to them."""

    #: Shape (n, c), the c internals of each row.
    values: Array
    #: Shape (n, c), index of the parameter that adds to each, from 0; `FIXED` for one that no parameter changes.
    parameter: Integers

    @classmethod
    def fixed(cls, values: Array) -> InternalValues:
        """Return values, shape (n, c), that no parameter changes."""
        return cls(values, np.full(values.shape, FIXED))

    def select(self, rows: Integers | slice) -> InternalValues:
        """Return the internals of some of the n rows, by their indices, shape (k,), or a slice."""
        return InternalValues(self.values[rows], self.parameter[rows])

    def add_derivative(self, jacobian: Array, by_internals: Array) -> None:
        """Add the derivative of predictions by the internals to that by the parameters that change them, in place.

        Args:
            jacobian: Shape (n, s, p), derivative by the parameters.
            by_internals: Shape (n, s, c), derivative by the internals of each row.
        """
        for column in np.flatnonzero(np.any(self.parameter != FIXED, axis=0)).tolist():
            rows = np.flatnonzero(self.parameter[:, column] != FIXED)
            jacobian[rows, :, self.parameter[rows, column]] += by_internals[rows, :, column]


def changed_internals(
    before: Array | None, changes: Iterable[tuple[Parameter, float, int]]
) -> InternalValues | None:
    """Add the values of parameters to the internals of rows; return None if their instruments have none.

    Args:
        before: Shape (n, c), the internals before the fit; it is not changed. None: there are none.
        changes: Parameters of instruments, each with its value in its unit and its index among all parameters (or
            `FIXED`, if its value is no unknown). Each changes one column, in the rows that its ``samples`` select.
    """
    if before is None:
        return None
    values = before.copy()
    number_of_parameter = np.full(values.shape, FIXED)
    # All that change one column where others have certain values, such as the corners of a board, are found at once.
    alike: dict[tuple[int | None, tuple[int, ...]], list[tuple[tuple[float, ...], float, int]]] = {}
    for parameter, value, number in changes:
        columns = tuple(column for column, _ in parameter.samples)
        selected = tuple(float(wanted) for _, wanted in parameter.samples)
        alike.setdefault((parameter.internal, columns), []).append((selected, value, number))
    for (internal, columns), of_parameters in alike.items():
        wanted = np.array([selected for selected, _, _ in of_parameters])
        of_rows = before[:, columns]
        matches = np.ones((len(before), len(of_parameters)), dtype=bool)
        for k in range(len(columns)):
            matches &= of_rows[:, k, None] == wanted[:, k]
        rows, which = np.nonzero(matches)
        values[rows, internal] += np.array([value for _, value, _ in of_parameters])[which]
        number_of_parameter[rows, internal] = np.array([n for _, _, n in of_parameters])[which]
    return InternalValues(values, number_of_parameter)
