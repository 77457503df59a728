"""Channels: the kind and the unit of each scalar of a residual.

A row of a table measures the scalars of its kind, such as three lengths and three angles, and its residual has one
entry for each. Scalars of one kind and one unit are a channel: they come from one instrument and share one noise. Error
figures are by unit, over the rows of all kinds. `RESIDUAL_UNITS` is the registry of units: a further one is one entry.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from calib.basics.arrays import Array, Integers, Mask
from calib.basics.units import UNITS, Quantity
from calib.basics.values import ReadOnlyMapping
from calib.errors import CalibError, choices

#: Index in `Channels.index` of an entry without a scalar.
NOT_MEASURED = -1

#: Number of scalars of a vector.
VECTOR = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualUnit:
    """A unit in which residuals are computed, and what tables, texts and verdicts need to know about it."""

    #: Its symbol, as in the units of a kind: ``"m"``
    symbol: str
    #: The quantity that it measures, for columns of tables: ``"length"``
    quantity: Quantity
    #: Symbol of the unit in which texts and tables show it: ``"mm"``
    shown: str
    #: Digits after the decimal point in texts, in the unit shown
    digits: int
    #: The scalar that its noise is stated for, in texts: ``"per coordinate"``
    per: str
    #: The quantity that several scalars measure together, for texts: ``"orientation"``
    measured: str
    #: Errors of vectors are ``"along"`` or ``"about"`` the axes of the frame
    preposition: str = "along"
    #: True if tables of errors show their span along each axis of the frame
    shows_span: bool = False
    #: Table column and cell key of the standard deviation of one scalar, without its unit: ``"sigma_angle"``
    sigma_name: str
    #: Standard deviation of one scalar, if none is stated
    assumed_sigma: float
    #: Largest noise of one scalar that an instrument may have, if none is stated
    large_noise: float
    #: Repeatability of arms, which adds to the stated noise of one scalar
    repeatability: float
    #: Errors above this are beyond any uncalibrated arm and any instrument: an input is wrong
    absurd: float

    @property
    def sigma_key(self) -> str:
        """Key of a cell file for the standard deviation of one scalar: ``"sigma_angle_deg"``."""
        return f"{self.sigma_name}_{self.shown}"

    @property
    def to_shown(self) -> float:
        """One of this unit, in the unit shown: 1000 for m shown as mm."""
        return 1.0 / UNITS[self.shown].to_si


_LENGTH = ResidualUnit(
    symbol="m",
    quantity="length",
    shown="mm",
    digits=3,
    per="per coordinate",
    measured="position",
    shows_span=True,
    sigma_name="sigma",
    assumed_sigma=1e-4,  # that of a laser tracker at work
    large_noise=1e-3,
    repeatability=3e-5,
    absurd=0.02,
)
_ANGLE = ResidualUnit(
    symbol="rad",
    quantity="angle",
    shown="deg",
    digits=4,
    per="about an axis",
    measured="orientation",
    preposition="about",
    sigma_name="sigma_angle",
    assumed_sigma=1e-3,
    large_noise=np.inf,  # orientations of some instruments are that rough
    repeatability=1e-4,
    absurd=0.17,
)
_PIXEL = ResidualUnit(
    symbol="px",
    quantity="pixel",
    shown="px",
    digits=3,
    per="per image coordinate",
    measured="image position",
    sigma_name="sigma_image",
    assumed_sigma=0.3,  # that of a corner refined locally in a sharp image
    large_noise=3.0,
    repeatability=0.05,  # 3e-5 m seen from half a metre at 1000 px
    absurd=100.0,
)

#: The units of residuals by their symbols, in the order in which texts and tables list them.
RESIDUAL_UNITS: Mapping[str, ResidualUnit] = ReadOnlyMapping(
    {unit.symbol: unit for unit in (_LENGTH, _ANGLE, _PIXEL)}
)


def residual_unit(symbol: str) -> ResidualUnit:
    """Return the unit of residuals with a symbol, such as ``"m"``; CalibError if there is none."""
    if symbol not in RESIDUAL_UNITS:
        raise CalibError(
            f"'{symbol}' is not a unit of residuals; allowed are {choices(RESIDUAL_UNITS)}."
        )
    return RESIDUAL_UNITS[symbol]


@dataclass(frozen=True, slots=True, eq=False)
class Channels:
    """The channel of each entry of the residuals of N rows, which have up to D scalars."""

    #: Symbol of the unit of each of the C channels, of `RESIDUAL_UNITS`
    units: tuple[str, ...]
    #: True for a channel whose scalars are a vector: three, along or about the axes x, y, z of the measurement frame
    vectors: tuple[bool, ...]
    #: (N, D), index of each entry's channel, from 0; `NOT_MEASURED` where nothing was measured
    index: NDArray[np.int8]
    #: (N, D), True for the entries that were measured
    used: Mask = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Mark the entries that were measured."""
        index = np.array(self.index, dtype=np.int8)
        used = index != NOT_MEASURED
        for array in (index, used):
            array.setflags(write=False)
        object.__setattr__(self, "index", index)
        object.__setattr__(self, "used", used)

    @classmethod
    def of_unit(cls, used: Mask, unit: str = "m") -> Channels:
        """Make channels of entries that all have one unit; three columns are the vectors along x, y, z.

        Args:
            used: True for the entries that were measured, shape (N, D).
            unit: Symbol of their unit.
        """
        vectors = (used.shape[1] == VECTOR,)
        return cls((unit,), vectors, np.where(used, 0, NOT_MEASURED).astype(np.int8))

    def __len__(self) -> int:
        """Number of rows N."""
        return len(self.index)

    @property
    def width(self) -> int:
        """The largest number of scalars of a row, D."""
        return int(self.index.shape[1])

    @property
    def present(self) -> tuple[str, ...]:
        """Symbols of the units that some entry has, in the order of `RESIDUAL_UNITS`."""
        occurring = {unit for c, unit in enumerate(self.units) if np.any(self.index == c)}
        return tuple(symbol for symbol in RESIDUAL_UNITS if symbol in occurring)

    def where(self, unit: str) -> Mask:
        """Mark the entries that are in a unit, by its symbol; shape (N, D).

        Raises:
            CalibError: There is no such unit.
        """
        residual_unit(unit)
        of_unit = [c for c, symbol in enumerate(self.units) if symbol == unit]
        if len(of_unit) == len(self.units):
            return self.used
        return np.isin(self.index, of_unit)

    def columns(self, unit: str) -> Integers:
        """Return the indices, ascending from 0, of the columns in which some row has a scalar of a unit."""
        return np.flatnonzero(self.where(unit).any(axis=0))

    def select(self, rows: Mask | Integers | slice) -> Channels:
        """Return the channels of some rows: a mask (N,), their indices, or a slice."""
        return Channels(self.units, self.vectors, self.index[rows])

    def vector_columns(self, unit: str) -> tuple[Integers, Mask]:
        """Return the columns and rows that hold vectors in a unit: the residuals of positions, or of orientations.

        Returns:
            The three columns along x, y, z, and a mask of the rows that have such a vector in these columns, shape
            (N,); no column and no row if none has.
        """
        of_vectors = [c for c, is_vector in enumerate(self.vectors) if is_vector]
        of_vectors = [c for c in of_vectors if self.units[c] == unit]
        in_vector = np.isin(self.index, of_vectors)
        columns = np.flatnonzero(in_vector.any(axis=0))
        if len(columns) != VECTOR:
            return np.zeros(0, dtype=np.int_), np.zeros(len(self), dtype=bool)
        return columns, np.all(in_vector[:, columns], axis=1)

    def norms(self, values: Array, unit: str) -> Array:
        """Return the norm of each row over its scalars of one unit.

        Args:
            values: Residuals, shape (N, D), in SI units.
            unit: Symbol of the unit.

        Returns:
            Shape (N,), in this unit; NaN for a row that measures nothing in it.
        """
        of_unit = self.where(unit)
        norms = np.sqrt(np.sum(np.where(of_unit, values, 0.0) ** 2, axis=1))
        return np.where(of_unit.any(axis=1), norms, np.nan)


def channels_of(
    units: Sequence[Sequence[str]],
    vector_units: Sequence[Collection[str]],
    kinds: Integers,
) -> Channels:
    """Number the channels of rows by their kinds: those in the first unit of `RESIDUAL_UNITS` first, kind after kind.

    Args:
        units: Symbols of the units of each kind's scalars, for K kinds.
        vector_units: For each kind, the units in which its scalars are a vector.
        kinds: Index of each row's kind, shape (N,); negative for a row that measures nothing.

    Returns:
        The channels, in which entry j of a row is scalar j of its kind. D is the largest number of scalars of a kind
        that occurs, at least 1.
    """
    occurring = [k for k in np.unique(kinds).tolist() if k >= 0]
    width = max([1, *(len(units[k]) for k in occurring)])
    index = np.full((len(kinds), width), NOT_MEASURED, dtype=np.int8)
    symbols: list[str] = []
    vectors: list[bool] = []
    for symbol in RESIDUAL_UNITS:
        for k in occurring:
            columns = [j for j, unit in enumerate(units[k]) if unit == symbol]
            if columns:
                index[np.ix_(kinds == k, columns)] = len(symbols)
                symbols.append(symbol)
                vectors.append(symbol in vector_units[k])
    return Channels(tuple(symbols), tuple(vectors), index)
