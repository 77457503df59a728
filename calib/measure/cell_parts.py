"""The parts of a cell: sizes of priors, known distances, and the checks that keep a cell's values sound."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import CalibError, choices
from calib.families import family_of
from calib.measure.checks import FARTHEST
from calib.model.robot import read_only

#: What `Priors.sizes` may be.
PRIOR_SIZES = ("data", "given", "off")

#: A prior outside of these says nothing, or is a constraint; their squares would leave the range of numbers.
PRIORS = (1e-15, 1e6)


def is_number(value: object) -> bool:
    """Whether a value is a finite number."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number that no float is
        return False


def is_positive(value: object) -> bool:
    """Whether a value is a positive finite number."""
    return is_number(value) and bool(value > 0)  # type: ignore[operator]  # it is a number


def check_prior(value: float, what: str) -> None:
    """Refuse a standard deviation of a prior that is next to nothing or beyond anything.

    Raises:
        CalibError: It is.
    """
    if not PRIORS[0] <= value <= PRIORS[1]:
        raise CalibError(
            f"{what} is {value:g}; it lies between {PRIORS[0]:g} and {PRIORS[1]:g} in SI units. Freeze a parameter to "
            "keep it; leave its prior out to let the data say."
        )


@dataclass(frozen=True, slots=True, init=False)
class Priors:
    """How large a robot's errors are expected to be: zero-mean normal distributions, a size for each family.

    Attributes:
        sizes: ``"data"``: the sizes are found from the measurements, starting at those given; ``"given"``: they are
            those given; ``"off"``: none, plain least squares, but for a leash on what no measurement determines.
        given: Standard deviations by family that are other than its row of the registry has, in the family's unit.

    Example:
        >>> Priors("given", length=1e-3).of("length")
        0.001
    """

    sizes: str
    given: tuple[tuple[str, float], ...]

    def __init__(self, sizes: str = "data", **given: float) -> None:
        """Sizes by name: ``Priors("given", length=1e-3, compliance=2e-6)``.

        Raises:
            CalibError: An unknown word or family, or a size that is no standard deviation.
        """
        if sizes not in PRIOR_SIZES:
            raise CalibError(
                f"Priors of the kind '{sizes}' were asked for; choose one of {choices(PRIOR_SIZES)}."
            )
        for name, value in given.items():
            unit = family_of(name).unit.symbol
            if not is_positive(value):
                raise CalibError(
                    f"The prior's {name} is {value} {unit}; it must be positive. Use sizes 'off' for none."
                )
            check_prior(value, f"The prior's {name}")
        object.__setattr__(self, "sizes", sizes)
        others = {name: value for name, value in given.items() if value != family_of(name).prior}
        object.__setattr__(self, "given", tuple(sorted(others.items())))

    def with_sizes(self, sizes: str) -> Priors:
        """The same standard deviations, used otherwise: ``"data"``, ``"given"`` or ``"off"``."""
        return Priors(sizes, **dict(self.given))

    def of(self, family: str) -> float:
        """The standard deviation of a family's errors, in its unit: as given, or that of its row of the registry."""
        return dict(self.given).get(family, family_of(family).prior)


@dataclass(frozen=True, slots=True)
class GroupDistance:
    """A known distance between the fixed points of two groups, such as two sockets on one plate.

    Attributes:
        first: Name of a group. It may hold one ``*``, which then stands for any text.
        second: Name of another one; its ``*`` stands for the same text.
        length: [m].
        sigma: Standard deviation of the length [m].

    Example:
        >>> plate = GroupDistance("*/left", "*/right", length=0.2, sigma=1e-5)
        >>> plate.pairs(["1/left", "1/right", "2/left", "2/right"])
        (('1/left', '1/right'), ('2/left', '2/right'))
    """

    first: str
    second: str
    length: float
    sigma: float

    def __post_init__(self) -> None:
        """Refuse names that cannot be matched and lengths that are none."""
        names = (self.first, self.second)
        said = f"The distance between the groups {self.first!r} and {self.second!r}"
        if not all(isinstance(name, str) and name.strip() for name in names):
            raise CalibError(f"{said}: each must be a name.")
        stars = [name.count("*") for name in names]
        if stars not in ([0, 0], [1, 1]):
            raise CalibError(
                f"{said}: '*' stands for the same text in both; write it once in each name, or in neither."
            )
        if self.first == self.second:
            raise CalibError(f"{said}: a group has one fixed point; name two different groups.")
        for name in ("length", "sigma"):
            if not is_positive(getattr(self, name)):
                raise CalibError(
                    f"{said}: its {name} is {getattr(self, name)!r} m; it must be a positive number."
                )

    def pairs(self, groups: Iterable[str]) -> tuple[tuple[str, str], ...]:
        """The pairs of these groups that the distance is between, each once, in the groups' order."""
        present = tuple(dict.fromkeys(groups))
        if "*" not in self.first:
            both = self.first in present and self.second in present
            return ((self.first, self.second),) if both else ()
        before, _, after = self.first.partition("*")
        found = []
        for group in present:
            middle = group[len(before) : len(group) - len(after)]
            # Compared as a whole: the parts before and behind the star may not overlap.
            other = self.second.replace("*", middle)
            if group == f"{before}{middle}{after}" and other in present and other != group:
                found.append((group, other))
        return tuple(found)


def _floats(value: ArrayLike) -> NDArray[np.float64] | None:
    """An array of finite numbers, or None where the value is none."""
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return array if np.all(np.isfinite(array)) else None


def _as_written(value: ArrayLike) -> Any:  # noqa: ANN401  for a message only
    """A value for a message: arrays as lists."""
    return value.tolist() if isinstance(value, np.ndarray) else value


def vector(value: ArrayLike, what: str, unit: str = "m") -> NDArray[np.float64]:
    """Three finite numbers, shape (3,).

    Raises:
        CalibError: Anything else.
    """
    array = _floats(value)
    if array is None or array.shape != (3,):
        raise CalibError(
            f"The {what} must be three finite numbers x, y, z [{unit}]; {_as_written(value)!r} was given."
        )
    _check_near(array, f"The {what}", unit)
    return read_only(array)


def _check_near(array: NDArray[np.float64], what: str, unit: str) -> None:
    """Refuse numbers so large that their digits no longer tell a position.

    Raises:
        CalibError: One of them is.
    """
    largest = float(np.abs(array).max())
    if largest > FARTHEST:
        raise CalibError(
            f"{what} holds {largest:g} {unit}; nothing in a robot cell is beyond {FARTHEST:g} {unit}. Correct it."
        )


def pose(value: ArrayLike, what: str) -> NDArray[np.float64]:
    """A pose, shape (4, 4): an orthonormal right-handed rotation and a translation.

    Raises:
        CalibError: Anything else.
    """
    T = _floats(value)
    if (
        T is None
        or T.shape != (4, 4)
        or not np.array_equal(T[3], [0, 0, 0, 1])
        or not _is_rotation(T[:3, :3])
    ):
        raise CalibError(
            f"{what} must be a 4 x 4 pose with a right-handed rotation [m]; {_as_written(value)!r} was given."
        )
    _check_near(T[:3, 3], what, "m")
    return read_only(T)


def rotation(value: ArrayLike, what: str) -> NDArray[np.float64]:
    """An orthonormal right-handed rotation, shape (3, 3).

    Raises:
        CalibError: Anything else.
    """
    R = _floats(value)
    if R is None or R.shape != (3, 3) or not _is_rotation(R):
        raise CalibError(
            f"The {what} must be a 3 x 3 right-handed rotation; {_as_written(value)!r} was given."
        )
    return read_only(R)


def _is_rotation(R: NDArray[np.float64]) -> bool:
    """Whether a matrix, shape (3, 3), is orthonormal and right-handed."""
    return bool(np.abs(R @ R.T - np.eye(3)).max() <= 1e-6 and np.linalg.det(R) > 0)


def by_name(value: object, what: str) -> Mapping[str, Any]:
    """A read-only mapping from names.

    Raises:
        CalibError: It is no mapping, or a key is no name.
    """
    if not isinstance(value, Mapping) or not all(isinstance(k, str) and k.strip() for k in value):
        raise CalibError(f"The {what} must be a mapping from names; {value!r} was given.")
    return MappingProxyType(dict(value))


def each(
    value: object, what: str, check: Callable[[Any, str], Any], named: str
) -> Mapping[str, Any]:
    """A read-only mapping from names, with each value checked under its name."""
    given = by_name(value, what)
    return MappingProxyType({name: check(one, named.format(name)) for name, one in given.items()})


def words(value: object, what: str) -> tuple[str, ...]:
    """A tuple of texts.

    Raises:
        CalibError: Anything else, one text alone among it.
    """
    if not isinstance(value, (tuple, list)) or not all(isinstance(word, str) for word in value):
        raise CalibError(f"The {what} are a tuple of names; {value!r} was given.")
    return tuple(value)


def ties(value: object) -> Mapping[str, tuple[str, float]]:
    """Parameters that follow others, ``x_name = factor * x_other``: for each name the other's and the factor.

    Raises:
        CalibError: Not that; a tie to itself or to a parameter that is tied.
    """
    given = by_name(value, "ties")
    result = {}
    for name, tie in given.items():
        pair = tuple(tie) if isinstance(tie, (tuple, list)) else ()
        if len(pair) != 2 or not isinstance(pair[0], str) or not is_number(pair[1]) or not pair[1]:
            raise CalibError(
                f"The tie of '{name}' is {tie!r}; it must be another parameter and a factor that is not zero, such "
                "as ('a2', 1.0)."
            )
        if pair[0] == name:
            raise CalibError(f"'{name}' is tied to itself; name another parameter.")
        if pair[0] in given:
            raise CalibError(
                f"'{name}' is tied to '{pair[0]}', which is tied itself; tie both to one that is not."
            )
        result[name] = (pair[0], float(pair[1]))
    return MappingProxyType(result)


def bounds(value: object) -> Mapping[str, tuple[float, float]]:
    """The least and the largest change of parameters; an infinite one is none.

    Raises:
        CalibError: Not two numbers, or an interval without the nominal value, which is a change of zero.
    """
    result = {}
    for name, interval in by_name(value, "bounds").items():
        pair = tuple(interval) if isinstance(interval, (tuple, list)) else ()
        numbers = all(
            isinstance(v, (int, float, np.number)) and not isinstance(v, bool) for v in pair
        )
        if len(pair) != 2 or not numbers or not pair[0] <= 0 <= pair[1] or pair[0] == pair[1]:
            raise CalibError(
                f"The bounds of '{name}' are {interval!r}; they must be the least and the largest change from the "
                "nominal value, such as (-0.001, 0.001), with 0 between them. To keep a parameter at its nominal "
                "value, freeze it."
            )
        result[name] = (float(pair[0]), float(pair[1]))
    return MappingProxyType(result)
