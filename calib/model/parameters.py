"""Parameters of an error model: what can be wrong, where, and in which direction.

See `calib.model.error_model` for the equation. A parameter may be *tied* to another one, x_a = factor x_b; then it
keeps its term of the equation but is no unknown of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.errors import ModelError, choices
from calib.model.families import FAMILIES, Factor
from calib.robot.robot import Robot, read_only
from calib.units import Array

#: The places that are not joints, with the name of the frame or target behind it; no URDF calls a joint so.
FRAME, TIP, TARGET = "(frame)", "(tip)", "(target)"


_UNMOVED = 1e-12  #: A placement that is displaced by less stays as it is, and so does its <origin> [m, rad].


@dataclass(frozen=True, slots=True, eq=False)
class Parameter:
    """One error: a direction at a place."""

    name: str  #: Unique, such as ``"d1"``, ``"elbow_joint.rx"`` or ``"target_x"``.
    unit: str  #: The symbol of a `calib.model.families.Unit`: "m", "rad", "rad/Nm", ...
    place: str  #: A joint's name, `TIP`, or that of a frame or a target.
    #: shape (6,), twist in the place's frame, linear then angular, of a unit of the parameter or the joint's motion.
    direction: Array
    family: str  #: One of `calib.model.families.FAMILIES`, `FRAME` or `TARGET`.
    nominal: float = 0.0  #: The value that it adds to, in its unit: the DH table's, or 0.
    factor: Factor | None = None  #: The number of the joint's state that multiplies it; None for 1.


@dataclass(frozen=True, slots=True, eq=False)
class ErrorModel:
    """A named list of parameters for one chain."""

    name: str  #: The set's name, such as ``"dh"``.
    places: tuple[str, ...]  #: All places in order: the frames, the joints, the tip, the targets.
    parameters: tuple[Parameter, ...]  #: The unknowns, in the order of the parameter vector x.
    #: The parameters and those tied to them, in the order in which they act; the parameters where none is.
    terms: tuple[Parameter, ...] = ()
    #: shape (terms, p): the value of each term is mixing @ x; the identity where none is tied.
    mixing: Array = field(default_factory=lambda: np.zeros((0, 0)))
    _backwards: tuple[tuple[int, int, pin.Motion], ...] = field(init=False, repr=False)
    _undisplaced: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Refuse a name twice and a place that the chain lacks; see at which place each term acts, the last first."""
        if not self.terms:
            object.__setattr__(self, "terms", self.parameters)
            object.__setattr__(self, "mixing", read_only(np.eye(len(self.parameters))))
        names = [term.name for term in self.terms]
        number = {place: k for k, place in enumerate(self.places)}
        fixed = [(t, term) for t, term in enumerate(self.terms) if term.factor is None]
        doubled = sorted({name for name in names if names.count(name) > 1})
        unknown = sorted({term.place for _, term in fixed} - set(number))
        if doubled or unknown:
            raise ModelError(
                f"The model '{self.name}' has parameters {choices(doubled)} twice, or at unknown places "
                f"{choices(unknown)}; places are {choices(self.places)}."
            )
        undisplaced = np.zeros((6 * len(self.places), len(self.terms)))
        backwards = []
        for t, term in reversed(fixed):
            k = number[term.place]
            undisplaced[6 * k : 6 * k + 6, t] = term.direction
            backwards.append((t, k, pin.Motion(term.direction)))
        object.__setattr__(self, "_backwards", tuple(backwards))
        object.__setattr__(self, "_undisplaced", read_only(undisplaced))

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters' names."""
        return tuple(p.name for p in self.parameters)

    @property
    def units(self) -> tuple[str, ...]:
        """The parameters' units."""
        return tuple(p.unit for p in self.parameters)

    @property
    def families(self) -> tuple[str, ...]:
        """The families that the model has, in the order of the registry."""
        return tuple(f for f in FAMILIES if any(p.family == f for p in self.parameters))

    def __len__(self) -> int:
        """The number of parameters."""
        return len(self.parameters)

    def family(self, *names: str) -> NDArray[np.bool_]:
        """Which parameters belong to one of some families, shape (p,)."""
        return np.array([p.family in names for p in self.parameters], dtype=bool)

    def index(self, name: str) -> int:
        """The position of a parameter in x; ModelError if there is none."""
        if name not in self.names:
            raise ModelError(
                f"The model '{self.name}' has no parameter '{name}'; it has {choices(self.names, limit=60)}."
            )
        return self.names.index(name)

    def without(self, names: Iterable[str]) -> ErrorModel:
        """The model with these parameters frozen at their nominal values, and those tied to them with them."""
        gone = {self.index(name) for name in names}
        kept = [k for k in range(len(self)) if k not in gone]
        return self._mixed(kept, self.mixing[:, kept]) if gone else self

    def tied(self, ties: Mapping[str, tuple[str, float]]) -> ErrorModel:
        """The model with parameters that follow others, x_name = factor x_other; ModelError where they cannot."""
        if not ties:
            return self
        mixing = self.mixing.copy()
        for name, (other, factor) in ties.items():
            k, leader = self.index(name), self.index(other)
            units = self.units[k], self.units[leader]
            if other in ties or k == leader or units[0] != units[1]:
                raise ModelError(
                    f"'{name}' [{units[0]}] cannot follow '{other}' [{units[1]}]: parameters are tied to one that is "
                    "free and of the same unit."
                )
            mixing[:, leader] += factor * mixing[:, k]
        free = [k for k, name in enumerate(self.names) if name not in ties]
        return self._mixed(free, mixing[:, free])

    def _mixed(self, kept: list[int], mixing: Array) -> ErrorModel:
        """The model with some of its parameters, and the terms that they move."""
        used = np.flatnonzero(mixing.any(axis=1))
        return replace(
            self,
            parameters=tuple(self.parameters[k] for k in kept),
            terms=tuple(self.terms[t] for t in used),
            mixing=read_only(mixing[used]),
        )

    @property
    def joint_terms(self) -> tuple[int, ...]:
        """The terms that change with the joints' state."""
        return tuple(t for t, term in enumerate(self.terms) if term.factor is not None)

    def values(self, x: Array) -> Array:
        """The value of every term, shape (terms,)."""
        return np.asarray(self.mixing @ x)

    def displacements(self, x: Array) -> tuple[Array, Array]:
        """The displacement D of every place at x, (places, 4, 4), and what a unit of each parameter does there.

        The displaced placement is P D; rows 6 k to 6 k + 5 of (6 places, p) are the twists at place k, in its frame.
        """
        y = self.values(x)
        directions = self._undisplaced.copy()
        displacements = np.tile(np.eye(4), (len(self.places), 1, 1))
        if y.any():
            products: dict[int, pin.SE3] = {}
            values = y.tolist()
            # Backwards, so that the product of the factors after each term is at hand.
            for t, k, twist in self._backwards:
                later, factor = products.get(k), pin.exp6(twist * values[t])
                if later is not None:
                    directions[6 * k : 6 * k + 6, t] = later.actInv(twist).vector
                    factor = factor * later
                products[k] = factor
            for k, product in products.items():
                displacements[k] = product.homogeneous
        untied = self.terms is self.parameters
        return displacements, directions if untied else directions @ self.mixing

    def apply(self, robot: Robot, x: Array) -> Robot:
        """The robot with its placements displaced by x, without frame, target and errors of the joints' state."""
        if not np.any(x):
            return robot
        displacement, placements = self.displacements(x)[0], robot.placements.copy()
        first = self.places.index(TIP) - len(robot.joints)
        for i, factor in enumerate(displacement[first : first + len(placements)]):
            if np.abs(factor - np.eye(4)).max() > _UNMOVED:
                placements[i] = placements[i] @ factor
        return robot.with_placements(placements)


def twist_of(linear: Array, angular: Array) -> Array:
    """A twist, linear part first, read-only."""
    return read_only(np.concatenate([linear, angular]))
