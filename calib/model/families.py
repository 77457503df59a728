"""Families of errors: the registry. A family is one row, and everything else that names families reads it.

A family of the *geometry* (length, angle, zero) is what a URDF can hold; its parameters are directions at placements.
A family of the *joints' state* moves a joint about, or along, its own axis by a parameter times a known factor:

    gain          dq = g q
    eccentricity  dq = s sin q + c cos q       the encoder's once-per-turn error
    compliance    dq = c tau                   tau: the load on the joint, by gravity and payload, or measured
    gravity       dq = sum_l c_l z . ((p_l - p) x g / |g|)     p_l: the origins of later joints and the tip

Gravity is compliance without masses: those of the links are unknown, and put where the chain has points. The joint's
axis is z through p, of the nominal robot, and c_l what a mass at p_l bends it by, per metre of its lever arm.

No URDF can hold those. Source: J. Hollerbach, W. Khalil, M. Gautier, Handbook of Robotics, ch. 6. `register` adds a
family from outside; each process registers its own first.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from calib.errors import ModelError, choices
from calib.units import Array


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit of parameters."""

    symbol: str  #: In SI units: ``"m"``, ``"rad/Nm"``.
    key: str  #: The suffix of keys in result files: ``"rad_Nm"``.
    quantity: str  #: What it measures, as messages say it: ``"a length"``.
    step: float  #: What arms are typically wrong by: parameters of different units are compared in such steps.
    shown: tuple[float, str]  #: The factor to the unit that people read, and it: ``(1e3, "mm")``.
    cell: tuple[str, float]  #: The suffix of a cell file's keys, and it in SI: ``("_mm", 1e-3)``.
    example: str  #: A value that could be typed: ``"0.5 mm"``.
    largest: float = 1.0  #: A value beyond this is no error but another robot.


M = Unit("m", "m", "a length", 1e-3, (1e3, "mm"), ("_mm", 1e-3), "0.5 mm")
RAD = Unit(
    "rad", "rad", "an angle", 1e-3, (1e3, "mrad"), ("_mrad", 1e-3), "2 mrad", largest=2.0 * np.pi
)
ONE = Unit("1", "1", "a number", 1e-3, (1e3, "mrad/rad"), ("", 1.0), "5e-4")
M_PER_M = Unit("m/m", "m_m", "a number", 1e-3, (1e3, "mm/m"), ("", 1.0), "5e-4")
RAD_PER_NM = Unit(
    "rad/Nm", "rad_Nm", "a compliance", 1e-5, (1e6, "urad/Nm"), ("_rad_per_Nm", 1.0), "1e-5 rad/Nm"
)
RAD_PER_M = Unit(
    "rad/m",
    "rad_m",
    "an angle per length",
    1e-3,
    (1e3, "mrad/m"),
    ("_mrad_per_m", 1e-3),
    "0.5 mrad/m",
)
M_PER_N = Unit("m/N", "m_N", "a compliance", 1e-6, (1e6, "um/N"), ("_m_per_N", 1.0), "1e-6 m/N")


@dataclass(frozen=True, slots=True, eq=False)
class JointState:
    """The state of the joints in N samples, as the factor of one joint's error sees it."""

    joint: str  #: Name of the joint that errs.
    joint_names: tuple[str, ...]  #: The m measured joints.
    values: Array  #: shape (N, m), of all measured joints, [rad] or [m].
    chain: tuple[str, ...] = ()  #: Names of the n joints of the chain.
    #: shape (N, n, n + 3), see `calib.robot.gravity.gravity_loads`; None if not known.
    loads: Array | None = None
    point: str = ""  #: Of which point of the chain a mass is asked for: the joint that lies there, or of `ENDS`.

    @property
    def q(self) -> Array:
        """The joint's own values, shape (N,), [rad] or [m]; it must be a measured one."""
        return self.values[:, self.joint_names.index(self.joint)]

    @property
    def load(self) -> Array:
        """The load on the joint, shape (N,), [Nm] or [N]; ModelError where it is not known."""
        return self._loads[:, 0]

    @property
    def lever(self) -> Array:
        """The lever arm about the joint of a mass at the point, shape (N,), [m]; ModelError as for the load."""
        return self._loads[:, 1 + (*self.chain, *ENDS).index(self.point)]

    @property
    def _loads(self) -> Array:
        if self.loads is None:
            raise ModelError(f"The compliance of '{self.joint}' needs the load on the joints.")
        return self.loads[:, self.chain.index(self.joint)]


@dataclass(frozen=True, slots=True)
class Factor:
    """The known number of the joints' state that multiplies one parameter of a joint."""

    name: str  #: Names the parameter, ``<joint>.<name>``.
    value: Callable[[JointState], Array]  #: The number, of shape (N,), from a `JointState`.
    #: Its derivative by the joint's own value, shape (N,); None: next to 0, and taken as that.
    slope: Callable[[JointState], Array] | None
    loaded: bool = False  #: Whether it needs the load on the joints.
    #: Whether there is one for each later point of the chain, ``<joint>.<name>[<point>]``, and which this is.
    later: bool = False
    point: str = ""


@dataclass(frozen=True, slots=True)
class Family:
    """A family of errors, whose parameters share the standard deviation of a prior."""

    name: str  #: As a model names it behind a "+": ``"gain"``.
    unit: Unit  #: Of a parameter, at a joint that turns.
    prior: float  #: Standard deviation that is assumed, or where the search for it begins, in that unit.
    typical: float  #: Standard deviation of a virtual robot's, in that unit.
    factors: tuple[Factor, ...] = ()  #: Of each joint's parameters; empty for the geometry.
    sliding: Unit | None = None  #: At a joint that slides; None: that has none of the family.
    every_joint: bool = False  #: Whether all of the chain err; else those measured, and followers.
    bounds: tuple[float, float] = (1e-7, 0.1)  #: Standard deviations to believe, in ``unit``.
    positive: bool = False  #: Whether its parameters are none but positive, as a compliance is.
    lever: float = 1.0  #: A sliding joint's typical error over that of a turning one.

    @property
    def geometric(self) -> bool:
        """Whether a URDF can hold its errors."""
        return not self.factors

    @property
    def loaded(self) -> bool:
        """Whether it needs the load on the joints."""
        return any(factor.loaded for factor in self.factors)


ENDS = ("tip", "base")  #: The points that the chain ends at, besides those of its joints.

#: What a URDF can hold. A zero is an angle about a joint's own axis.
LENGTH, ANGLE, ZERO = "length", "angle", "zero"

_GAIN = Factor("gain", lambda state: state.q, lambda state: np.ones_like(state.q))
_SIN = Factor("sin", lambda state: np.sin(state.q), lambda state: np.cos(state.q))
_COS = Factor("cos", lambda state: np.cos(state.q), lambda state: -np.sin(state.q))
_COMPLIANCE = Factor("compliance", lambda state: state.load, slope=None, loaded=True)
_GRAVITY = Factor("gravity", lambda state: state.lever, slope=None, loaded=True, later=True)

_ROWS = (
    Family(LENGTH, M, prior=3e-3, typical=0.3e-3),
    Family(ANGLE, RAD, prior=15e-3, typical=3e-3),
    Family(ZERO, RAD, prior=15e-3, typical=5e-3),
    Family("gain", ONE, 1e-3, 0.5e-3, (_GAIN,), sliding=M_PER_M),
    Family("eccentricity", RAD, 1e-3, 0.5e-3, (_SIN, _COS)),
    Family(
        "compliance",
        RAD_PER_NM,
        1e-5,
        1e-5,
        (_COMPLIANCE,),
        sliding=M_PER_N,
        every_joint=True,
        bounds=(1e-11, 1e-2),
        positive=True,
        lever=0.1,
    ),
    Family("gravity", RAD_PER_M, 1e-3, 0.3e-3, (_GRAVITY,), every_joint=True, positive=True),
)
_REGISTRY: dict[str, Family] = {row.name: row for row in _ROWS}

#: All families by name, in the order in which they are shown.
FAMILIES: Mapping[str, Family] = MappingProxyType(_REGISTRY)


def register(family: Family) -> None:
    """Add a family of the joints' state, which models can then name: ``"dh+harmonic"``."""
    taken = [factor.name for row in FAMILIES.values() for factor in row.factors]
    doubled = [factor.name for factor in family.factors if factor.name in taken]
    if family.name in FAMILIES or doubled or not family.factors:
        raise ModelError(
            f"The family '{family.name}' needs factors, and names other than {choices([*FAMILIES, *taken], 60)}."
        )
    _REGISTRY[family.name] = family


def family_of(name: str) -> Family:
    """A family by its name; ModelError if it is not registered."""
    if name not in FAMILIES:
        raise ModelError(f"There is no family of errors '{name}'; there are {choices(FAMILIES)}.")
    return FAMILIES[name]


def factor_of(name: str) -> Factor:
    """A factor of any family by its name, with its point behind it; KeyError if there is none."""
    own, _, point = name.removesuffix("]").partition("[")
    known = {one.name: one for row in FAMILIES.values() for one in row.factors}
    return replace(known[own], name=name, point=point) if point else known[own]


def joint_families() -> tuple[str, ...]:
    """The names of the families that no URDF can hold, which a model may add to its set."""
    return tuple(name for name, row in FAMILIES.items() if not row.geometric)


def unit_of(symbol: str) -> Unit:
    """A unit of parameters by its symbol, calib's own or a registered family's; ModelError if there is none."""
    own = (M, RAD, ONE, M_PER_M, RAD_PER_NM, RAD_PER_M, M_PER_N)
    rows = (unit for row in FAMILIES.values() for unit in (row.unit, row.sliding) if unit)
    units = {unit.symbol: unit for unit in (*own, *rows)}
    if symbol not in units:
        raise ModelError(f"No parameter has the unit '{symbol}'; the units are {choices(units)}.")
    return units[symbol]
