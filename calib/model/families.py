"""Families of errors: the registry. A family is one row, which everything else that names families reads.

A family of the *geometry* (length, angle, zero) is what a URDF can hold; its parameters are directions at placements.
A family of the *joints' state* moves a joint about, or along, its own axis by a parameter times a known factor:

    gain          dq = g q
    eccentricity  dq = s sin q + c cos q       the encoder's once-per-turn error
    compliance    dq = c tau                   tau: the load on the joint, by gravity and payload, or measured
    harmonic_2    dq = s sin 2q + c cos 2q     the error twice per turn, such as of an oval encoder ring
    lost_motion   dq = -b sign(m)              backlash and friction: the joint stops short of its reading
    creep         dq = -k m                    what is still to come after a move, or a reading that is late
    gravity       dq = sum_l c_l z . ((p_l - p) x g / |g|)     p_l: the origins of later joints and the tip

Gravity is compliance without known masses: the links' masses are assumed at the points of the chain. The joint's axis
is z through p, of the nominal robot, and c_l is what a mass at p_l bends it by, per metre of its lever arm. m is the
last move of the joint before the row (`calib.numerics.moves`); where it is not known it is 0, and so is the error.

No URDF can hold these. Source: J. Hollerbach, W. Khalil, M. Gautier, Handbook of Robotics, ch. 6. `register` adds a
family from outside.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

import calib.basics.plugins as plugins
from calib.basics.arguments import check_type
from calib.basics.arrays import Array
from calib.basics.values import Value
from calib.errors import ArgumentError, ModelError, choices
from calib.numerics.differences import disagreement, mostly_without_value


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit of parameters, in results, on screens and in cell files."""

    #: In SI units: ``"m"``, ``"rad/Nm"``.
    symbol: str
    #: The suffix of keys in result files: ``"rad_Nm"``.
    key: str
    #: The quantity it measures, for messages: ``"a length"``.
    quantity: str
    #: Typical error of arms, in SI: parameters of different units are compared in such steps.
    step: float
    #: The factor from SI to the unit that people read, and its symbol: ``(1e3, "mm")``.
    shown: tuple[float, str]
    #: The suffix of a cell file's keys, and its unit in SI: ``("_mm", 1e-3)``.
    cell: tuple[str, float]
    #: A value that could be typed: ``"0.5 mm"``.
    example: str
    #: A larger value, in SI, is not an error but another robot.
    largest: float = 1.0


M = Unit(
    symbol="m",
    key="m",
    quantity="a length",
    step=1e-3,
    shown=(1e3, "mm"),
    cell=("_mm", 1e-3),
    example="0.5 mm",
)
RAD = Unit(
    symbol="rad",
    key="rad",
    quantity="an angle",
    step=1e-3,
    shown=(1e3, "mrad"),
    cell=("_mrad", 1e-3),
    example="2 mrad",
    largest=2.0 * np.pi,
)
ONE = Unit(
    symbol="1",
    key="1",
    quantity="a number",
    step=1e-3,
    shown=(1e3, "mrad/rad"),
    cell=("", 1.0),
    example="5e-4",
)
M_PER_M = Unit(
    symbol="m/m",
    key="m_m",
    quantity="a number",
    step=1e-3,
    shown=(1e3, "mm/m"),
    cell=("", 1.0),
    example="5e-4",
)
RAD_PER_NM = Unit(
    symbol="rad/Nm",
    key="rad_Nm",
    quantity="a compliance",
    step=1e-5,
    shown=(1e6, "urad/Nm"),
    cell=("_rad_per_Nm", 1.0),
    example="1e-5 rad/Nm",
)
RAD_PER_M = Unit(
    symbol="rad/m",
    key="rad_m",
    quantity="an angle per length",
    step=1e-3,
    shown=(1e3, "mrad/m"),
    cell=("_mrad_per_m", 1e-3),
    example="0.5 mrad/m",
)
M_PER_N = Unit(
    symbol="m/N",
    key="m_N",
    quantity="a compliance",
    step=1e-6,
    shown=(1e6, "um/N"),
    cell=("_m_per_N", 1.0),
    example="1e-6 m/N",
)

PX = Unit(
    symbol="px",
    key="px",
    quantity="a length in the image",
    step=1.0,
    shown=(1.0, "px"),
    cell=("_px", 1.0),
    example="2 px",
    largest=1e5,
)

#: calib's own units of parameters.
_UNITS = (M, RAD, PX, ONE, M_PER_M, RAD_PER_NM, RAD_PER_M, M_PER_N)

#: Names of the points at the ends of the chain; the others have the names of its joints.
ENDS = ("tip", "base")

#: Names of families and factors: a model joins them with "+", a parameter with ".", and points stand in brackets.
_NAME = re.compile(r"[\w-]+")

#: Joints of the chain at which the functions of a new factor are called, and the number of its states.
_TRIAL_JOINTS = tuple(f"joint_{k}" for k in range(1, 7))
_TRIAL_COUNT = 64

#: Step of the differences with which its slope is compared [rad or m].
_STEP = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class JointState:
    """The state of the joints in N samples, from which the factor of one joint's error is computed."""

    #: Name of the joint that errs.
    joint: str
    #: Names of the m measured joints.
    joint_names: tuple[str, ...]
    #: Shape (N, m), values of all measured joints, [rad] or [m].
    values: Array
    #: Names of the n joints that are loaded.
    chain: tuple[str, ...] = ()
    #: shape (N, n, n + 3) or more, see `calib.robot.gravity.gravity_loads`; None if not known.
    loads: Array | None = None
    #: Name of the point of the chain that carries a mass: a joint, for its origin, one of `ENDS`, or a branch's link.
    point: str = ""
    #: Shape (N, m), last move of each measured joint, [rad] or [m], 0 where not known; None: known nowhere.
    moves: Array | None = None
    #: Names of the points whose lever arms ``loads`` holds, see `calib.robot.gravity.load_points`; empty: the joints of
    #: ``chain`` and `ENDS`.
    points: tuple[str, ...] = ()

    @property
    def last_move(self) -> Array:
        """The joint's own last move before each state, shape (N,), [rad] or [m]; 0 where it is not known."""
        if self.moves is None:
            return np.zeros(len(self.values))
        return self.moves[:, self.joint_names.index(self.joint)]

    @property
    def q(self) -> Array:
        """The joint's own values, shape (N,), [rad] or [m]; it must be a measured one."""
        return self.values[:, self.joint_names.index(self.joint)]

    @property
    def load(self) -> Array:
        """The load on the joint, shape (N,), [Nm] or [N]; ModelError if it is not known."""
        return self._loads[:, 0]

    @property
    def lever(self) -> Array:
        """The lever arm about the joint of a mass at the point, shape (N,), [m]; ModelError if loads are not known."""
        points = self.points or (*self.chain, *ENDS)
        return self._loads[:, 1 + points.index(self.point)]

    @property
    def _loads(self) -> Array:
        """The load on the joint [Nm or N] and lever arms about it [m], shape (N, n + 3); ModelError if not known."""
        if self.loads is None:
            raise ModelError(f"The compliance of '{self.joint}' needs the load on the joints.")
        return self.loads[:, self.chain.index(self.joint)]


@dataclass(frozen=True, slots=True)
class Factor(Value):
    """The known number of the joints' state that multiplies one parameter of a joint."""

    #: Names the parameter, ``<joint>.<name>``.
    name: str
    #: The number, of shape (N,), from a `JointState`.
    value: Callable[[JointState], Array]
    #: Its derivative by the joint's own value, shape (N,); None: nearly 0, and neglected.
    slope: Callable[[JointState], Array] | None
    #: True if it needs the load on the joints.
    loaded: bool = False
    #: True if it depends on the joint's last move, which its functions are given then.
    moved: bool = False
    #: True if there is one for each later point of the chain, ``<joint>.<name>[<point>]``.
    later: bool = False
    #: The name of that point; "" if ``later`` is False or the point is not chosen yet.
    point: str = ""

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle a factor of a registered family by its name, which the reading process must have registered too."""
        if _factors().get(_split(self.name)[0]) is not None and factor_of(self.name) == self:
            return factor_of, (self.name,)
        return Value.__reduce__(self)


@dataclass(frozen=True, slots=True)
class Family(Value):
    """A family of errors, whose parameters share the standard deviation of a prior."""

    #: As a model names it after a "+": ``"gain"``.
    name: str
    #: Unit of a parameter at a joint that turns.
    unit: Unit
    #: Prior standard deviation that is assumed, or where the search for it begins, in that unit.
    prior: float
    #: Standard deviation of a virtual robot's errors, in that unit.
    typical: float
    #: The factors of a joint's parameters; empty for the geometry.
    factors: tuple[Factor, ...] = ()
    #: Unit of a parameter at a joint that slides; None: such a joint has no parameters of the family.
    sliding: Unit | None = None
    #: True if all joints of the chain err; False: the measured ones, and followers with them.
    every_joint: bool = False
    #: Lowest and highest plausible prior standard deviation, in ``unit``.
    bounds: tuple[float, float] = (1e-7, 0.1)
    #: True if the sum of its parameters at a joint cannot be negative, as a compliance cannot.
    positive: bool = False
    #: A sliding joint's typical error over that of a turning one.
    lever: float = 1.0
    #: Logarithm of how much rarer it is than others: what a model must win by it, in log-likelihood, beyond their cost.
    #: A rare family is offered, but is not part of the first, largest fit, which would explain outliers by it.
    rarity: float = 0.0
    #: Description of one of its errors, for the documentation: ``"the relative error of a gear ratio"``.
    meaning: str = ""

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle a registered family by its name, which the reading process must have registered too."""
        if _REGISTRY.get(self.name) is self:
            return family_of, (self.name,)
        return Value.__reduce__(self)

    @property
    def geometric(self) -> bool:
        """True if a URDF can hold its errors."""
        return not self.factors

    @property
    def loaded(self) -> bool:
        """True if it needs the load on the joints."""
        return any(factor.loaded for factor in self.factors)

    @property
    def moved(self) -> bool:
        """True if it depends on the joints' last moves, and so on the order of the rows."""
        return any(factor.moved for factor in self.factors)


#: The family of lengths of the geometry [m].
LENGTH = "length"

#: The family of angles of the geometry other than joint zeros [rad].
ANGLE = "angle"

#: The family of joint zeros: angles about a joint's own axis [rad].
ZERO = "zero"

_GAIN = Factor("gain", lambda state: state.q, lambda state: np.ones_like(state.q))
_SIN = Factor("sin", lambda state: np.sin(state.q), lambda state: np.cos(state.q))
_COS = Factor("cos", lambda state: np.cos(state.q), lambda state: -np.sin(state.q))
_SIN_2 = Factor(
    "sin_2", lambda state: np.sin(2.0 * state.q), lambda state: 2.0 * np.cos(2.0 * state.q)
)
_COS_2 = Factor(
    "cos_2", lambda state: np.cos(2.0 * state.q), lambda state: -2.0 * np.sin(2.0 * state.q)
)
# No slope: a command that is corrected by a fraction of a degree has nearly the same last move.
_LOST_MOTION = Factor(
    "lost_motion", lambda state: -np.sign(state.last_move), slope=None, moved=True
)
_CREEP = Factor("creep", lambda state: -state.last_move, slope=None, moved=True)
_COMPLIANCE = Factor("compliance", lambda state: state.load, slope=None, loaded=True)
_GRAVITY = Factor("gravity", lambda state: state.lever, slope=None, loaded=True, later=True)

#: Rarity of families that few arms need: odds of 20 to 1.
_RARE = float(np.log(20.0))

_ROWS = (
    Family(LENGTH, M, prior=3e-3, typical=0.3e-3, meaning="an error in length"),
    Family(ANGLE, RAD, prior=15e-3, typical=3e-3, meaning="an error in angle"),
    Family(ZERO, RAD, prior=15e-3, typical=5e-3, meaning="the error of a joint's zero"),
    Family(
        "gain",
        ONE,
        prior=1e-3,
        typical=0.5e-3,
        factors=(_GAIN,),
        sliding=M_PER_M,
        meaning="the relative error of a gear ratio",
    ),
    Family(
        "eccentricity",
        RAD,
        prior=1e-3,
        typical=0.5e-3,
        factors=(_SIN, _COS),
        meaning="an encoder's once-per-turn error",
    ),
    Family(
        "harmonic_2",
        RAD,
        prior=1e-3,
        typical=0.2e-3,
        factors=(_SIN_2, _COS_2),
        rarity=_RARE,
        meaning="an encoder's twice-per-turn error",
    ),
    Family(
        "lost_motion",
        RAD,
        prior=0.3e-3,
        typical=0.2e-3,
        factors=(_LOST_MOTION,),
        rarity=_RARE,
        sliding=M,
        meaning="the angle by which a joint stops short after a move, by the direction it came from",
    ),
    Family(
        "creep",
        ONE,
        prior=1e-3,
        typical=0.3e-3,
        factors=(_CREEP,),
        rarity=_RARE,
        sliding=M_PER_M,
        meaning="the share of its last move by which a joint is short",
    ),
    Family(
        "compliance",
        RAD_PER_NM,
        prior=1e-5,
        typical=1e-5,
        factors=(_COMPLIANCE,),
        sliding=M_PER_N,
        every_joint=True,
        bounds=(1e-11, 1e-2),
        positive=True,
        lever=0.1,
        meaning="a joint's compliance",
    ),
    Family(
        "gravity",
        RAD_PER_M,
        prior=1e-3,
        typical=0.3e-3,
        factors=(_GRAVITY,),
        every_joint=True,
        positive=True,
        meaning="the rotation of a joint per lever arm of an unknown mass",
    ),
)
_REGISTRY: dict[str, Family] = {row.name: row for row in _ROWS}

#: All families by name, in the order in which they are shown.
FAMILIES: Mapping[str, Family] = MappingProxyType(_REGISTRY)

plugins.watch("families", _REGISTRY)


def register(family: Family) -> None:
    """Add a family of the joints' state, which models can then name: ``"dh+harmonic"``.

    Raises:
        ArgumentError: It is not a family, or one of its units is not a `Unit`.
        ModelError: It has no factors; its name, or that of a factor, is taken or has other characters than letters,
            digits, "_" and "-"; its unit differs from the one with the same symbol; or a function of a factor returns
            a wrong shape, hardly a finite value, or a wrong slope.
    """
    check_type("family", family, Family, "a Family of calib.model.families")
    where = f"The family '{family.name}'"
    if not family.factors:
        raise ModelError(f"{where} has no factors; give one Factor for each parameter of a joint.")
    if family.name in FAMILIES:
        raise ModelError(
            f"{where} has a name that is taken; give it one other than {choices(FAMILIES, 60)}."
        )
    factor_names = [factor.name for factor in family.factors]
    for name in (family.name, *factor_names):
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise ModelError(
                f"{where}: {name!r} is not a name for a family or a factor; use letters, digits, '_' and '-'."
            )
    taken = _factors()
    for name in factor_names:
        if name in taken or factor_names.count(name) > 1:
            raise ModelError(
                f"{where}: the name of its factor '{name}' is taken; give each factor one of its own, other than "
                f"{choices(taken, 60)}."
            )

    _check_unit(family, "unit", family.unit)
    if family.sliding is not None:
        _check_unit(family, "sliding", family.sliding)
    for factor in family.factors:
        _check_functions(factor)
    _REGISTRY[family.name] = family


def _check_unit(family: Family, field: str, unit: Unit) -> None:
    """Check the unit in a field of a family, ``unit`` or ``sliding``.

    ArgumentError if it is not a `Unit`, ModelError if it differs from the registered one with the same symbol.
    """
    known = _units()
    if not isinstance(unit, Unit):
        raise ArgumentError(
            f"The family '{family.name}' has the {field} {unit!r}; it must be a Unit of calib.model.families, such as "
            f"RAD; there are those of {choices(known)}."
        )
    if known.get(unit.symbol, unit) != unit:
        raise ModelError(
            f"The family '{family.name}' has a {field} '{unit.symbol}' that is not calib's unit of this symbol; take "
            "that one, or another symbol."
        )


def _check_functions(factor: Factor) -> None:
    """Raise ModelError on a factor whose functions fail, have hardly a finite value, or a wrong slope.

    They are called at random states of a chain of six joints, for the first of them.

    A function that does not find a joint by its name or number is for one robot, and is not checked.
    """
    step = _STEP * np.eye(len(_TRIAL_JOINTS))[0]
    q = np.random.default_rng(0).uniform(-3.0, 3.0, (_TRIAL_COUNT, len(_TRIAL_JOINTS)))
    try:
        value, low, high = (
            _called(factor, "value", factor.value, values) for values in (q, q - step, q + step)
        )
        slope = None if factor.slope is None else _called(factor, "slope", factor.slope, q)
    except (LookupError, ValueError):
        return
    if mostly_without_value(value):
        raise ModelError(
            f"The factor '{factor.name}' has no finite value at most joint values from -3 to 3; correct 'value'."
        )
    if slope is None:
        return
    fault = disagreement(slope[:, None, None], ((high - low) / (2.0 * _STEP))[:, None, None])
    if fault is not None:
        raise ModelError(
            f"The factor '{factor.name}': 'slope' does not agree with finite differences of 'value' by the joint's own "
            f"value: it is {fault.given:.3g}, the difference {fault.expected:.3g}. Check its sign and terms."
        )


def _called(factor: Factor, name: str, function: Callable[[JointState], Array], q: Array) -> Array:
    """Return what a function of a factor gives for the first of six joints at values q, (N, 6) [rad or m]: shape (N,).

    ModelError if it fails or returns another shape; LookupError and ValueError, if it does not find a joint, are passed
    on. ``name`` is that of the function, for messages.
    """
    count, joints = q.shape
    loads = np.random.default_rng(1).uniform(0.5, 1.5, (count, joints, joints + 3))
    point = "tip" if factor.later else ""
    moves = np.random.default_rng(2).uniform(-1.0, 1.0, q.shape)
    state = JointState(_TRIAL_JOINTS[0], _TRIAL_JOINTS, q, _TRIAL_JOINTS, loads, point, moves)
    where = f"The factor '{factor.name}': '{name}'"
    must = f"it must return an array of shape (N,), one number for each of the N = {count} states"
    try:
        with np.errstate(all="ignore"):
            values = function(state)
    except (LookupError, ValueError):
        raise
    except Exception as error:
        cause = " ".join(f"{type(error).__name__}: {error}".split()).rstrip(".")
        raise ModelError(f"{where} fails with {cause}; {must}.") from error
    shape = getattr(values, "shape", None)
    if shape != (count,):
        given = "no array" if shape is None else f"an array of shape {shape}"
        raise ModelError(f"{where} returns {given}; {must}.")
    return np.asarray(values, dtype=np.float64)


def family_of(name: str) -> Family:
    """Return a family by its name; ModelError if none of that name is registered."""
    if name not in FAMILIES:
        raise ModelError(plugins.unknown("families", name, FAMILIES))
    return FAMILIES[name]


def factor_of(name: str) -> Factor:
    """Return a factor of any family by its name; ModelError if no registered family has it.

    Args:
        name: Such as ``"gain"``, or, with a point of the chain, ``"gravity[elbow_joint]"``.
    """
    factor_name, point = _split(name)
    factors = _factors()
    if factor_name not in factors:
        raise ModelError(
            f"No family of errors has the factor '{factor_name}'; there are {choices(factors)}."
        )
    factor = factors[factor_name]
    if point:
        return replace(factor, name=name, point=point)
    return factor


def _split(name: str) -> tuple[str, str]:
    """Return the name of a factor without its point, and that point; empty if it has none."""
    factor_name, _, point = name.removesuffix("]").partition("[")
    return factor_name, point


def _factors() -> dict[str, Factor]:
    """Return the factors of all registered families by name."""
    return {factor.name: factor for row in FAMILIES.values() for factor in row.factors}


def joint_families() -> tuple[str, ...]:
    """Return the names of the families that no URDF can hold, which a model may add to its set."""
    return tuple(name for name, row in FAMILIES.items() if not row.geometric)


def unit_of(symbol: str) -> Unit:
    """Return a unit of parameters by its symbol, calib's own or a registered family's; ModelError if there is none."""
    units = _units()
    if symbol not in units:
        raise ModelError(f"No parameter has the unit '{symbol}'; the units are {choices(units)}.")
    return units[symbol]


def _units() -> dict[str, Unit]:
    """Return calib's own units of parameters and those of registered families, by their symbols."""
    units = {unit.symbol: unit for unit in _UNITS}
    for row in FAMILIES.values():
        for unit in (row.unit, row.sliding):
            if unit is not None:
                units[unit.symbol] = unit
    return units
