"""Parameters, and lists of them for one chain: what can be wrong, where, and in which direction.

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

Array = NDArray[np.float64]

#: The places that are not joints; no URDF calls a joint so.
FRAME, TIP, TARGET = "(frame)", "(tip)", "(target)"

#: A placement that is displaced by less than this stays as it is, and so does its <origin> [m, rad].
_UNMOVED = 1e-12


def frame_place(group: str) -> str:
    """The place of a set-up's measurement frame."""
    return f"{FRAME}{group}"


def target_place(name: str) -> str:
    """The place of a target."""
    return f"{TARGET}{name}"


@dataclass(frozen=True, slots=True, eq=False)
class Parameter:
    """One error: a direction at a place.

    Attributes:
        name: Unique, such as ``"d1"``, ``"elbow_joint.rx"`` or ``"target_x"``.
        unit: The symbol of a `calib.model.families.Unit`: "m", "rad", "rad/Nm", ...
        place: A joint's name, `TIP`, or that of a frame or a target.
        direction: shape (6,), twist in the place's local frame, linear then angular, of a unit of the parameter. For
            errors that change with the joints' state: of a unit of the joint's displacement.
        family: One of `calib.model.families.FAMILIES`, `FRAME` or `TARGET`.
        nominal: The value that the parameter adds to, in its unit: the DH table's, or 0. A target's is where
            the cell says it is.
        factor: The known number of the joint's state that multiplies it; None for 1.
    """

    name: str
    unit: str
    place: str
    direction: Array
    family: str
    nominal: float = 0.0
    factor: Factor | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ErrorModel:
    """A named list of parameters for one chain.

    Attributes:
        name: The set's name, such as ``"dh"``.
        places: All places in order: the frames, the joints, the tip, the targets.
        parameters: The unknowns, in the order of the parameter vector x.
        terms: The parameters and those tied to them, in the order in which they act; the parameters where none is.
        mixing: shape (terms, p): the value of each term is mixing @ x; the identity where none is tied.
    """

    name: str
    places: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    terms: tuple[Parameter, ...] = ()
    mixing: Array = field(default_factory=lambda: np.zeros((0, 0)))
    _backwards: tuple[tuple[int, int, pin.Motion], ...] = field(init=False, repr=False)
    _undisplaced: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Refuse a name twice and a place that the chain lacks; see at which place each term acts, the last first."""
        if not self.terms:
            object.__setattr__(self, "terms", self.parameters)
            object.__setattr__(self, "mixing", read_only(np.eye(len(self.parameters))))
        names = [term.name for term in self.terms]
        doubled = sorted({name for name in names if names.count(name) > 1})
        if doubled:
            raise ModelError(
                f"Parameters {choices(doubled)} appear twice in the model '{self.name}'; names must differ."
            )
        unknown = sorted({t.place for t in self.terms if t.factor is None} - set(self.places))
        if unknown:
            raise ModelError(
                f"The chain has no places {choices(unknown)}; it has {choices(self.places)}."
            )
        number = {place: k for k, place in enumerate(self.places)}
        acting = [
            (t, number[term.place]) for t, term in enumerate(self.terms) if term.factor is None
        ]
        undisplaced = np.zeros((6 * len(self.places), len(self.terms)))
        for t, k in acting:
            undisplaced[6 * k : 6 * k + 6, t] = self.terms[t].direction
        backwards = tuple((t, k, pin.Motion(self.terms[t].direction)) for t, k in acting[::-1])
        object.__setattr__(self, "_backwards", backwards)
        object.__setattr__(self, "_undisplaced", read_only(undisplaced))

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters' names in order."""
        return tuple(p.name for p in self.parameters)

    @property
    def units(self) -> tuple[str, ...]:
        """The parameters' units in order."""
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
        """The position of a parameter in x.

        Raises:
            ModelError: No such parameter.
        """
        if name not in self.names:
            raise ModelError(
                f"The model '{self.name}' has no parameter '{name}'; it has {choices(self.names, limit=60)}."
            )
        return self.names.index(name)

    def without(self, names: Iterable[str]) -> ErrorModel:
        """The model with these parameters frozen at their nominal values, and those tied to them with them.

        Raises:
            ModelError: No such parameter.
        """
        gone = {self.index(name) for name in names}
        if not gone:
            return self
        kept = [k for k in range(len(self)) if k not in gone]
        mixing = self.mixing[:, kept]
        used = [t for t in range(len(self.terms)) if np.any(mixing[t])]
        return replace(
            self,
            parameters=tuple(self.parameters[k] for k in kept),
            terms=tuple(self.terms[t] for t in used),
            mixing=read_only(mixing[used]),
        )

    def tied(self, ties: Mapping[str, tuple[str, float]]) -> ErrorModel:
        """The model with parameters that follow others: x_name = factor x_other.

        Raises:
            ModelError: No such parameter, one that is tied to itself or in a circle, or units that differ.
        """
        if not ties:
            return self
        mixing, model = self.mixing.copy(), self
        for name, (other, factor) in ties.items():
            k, leader = self.index(name), self.index(other)
            if other in ties or k == leader:
                raise ModelError(
                    f"'{name}' is tied to '{other}', which is tied itself. Tie both to one parameter that is "
                    "free."
                )
            if self.parameters[k].unit != self.parameters[leader].unit:
                raise ModelError(
                    f"'{name}' [{self.parameters[k].unit}] cannot follow '{other}' "
                    f"[{self.parameters[leader].unit}]: their units differ."
                )
            mixing[:, leader] += factor * mixing[:, k]
        free = [k for k, name in enumerate(self.names) if name not in ties]
        return replace(
            model,
            parameters=tuple(self.parameters[k] for k in free),
            mixing=read_only(mixing[:, free]),
        )

    @property
    def joint_terms(self) -> tuple[int, ...]:
        """The terms that change with the joints' state."""
        return tuple(t for t, term in enumerate(self.terms) if term.factor is not None)

    def values(self, x: Array) -> Array:
        """The value of every term, shape (terms,).

        Raises:
            ModelError: ``x`` has not one entry for each parameter.
        """
        if np.shape(x) != (len(self.parameters),):
            raise ModelError(
                f"A parameter vector of shape {np.shape(x)} was given; the model '{self.name}' has "
                f"{len(self.parameters)} parameters: {choices(self.names)}."
            )
        return np.asarray(self.mixing @ x)

    def displacements(self, x: Array) -> tuple[Array, Array]:
        """The displacement of every place, and each parameter's direction there.

        Args:
            x: shape (p,), [m] and [rad].

        Returns:
            D: shape (len(places), 4, 4); the displaced placement is P D.
            S: shape (6 len(places), p); rows 6 k to 6 k + 5 are the twists at place k, in the local frame of the
            displaced placement, of a unit of each parameter.

        Raises:
            ModelError: ``x`` has not one entry for each parameter.
        """
        y = self.values(x)
        directions = self._undisplaced.copy()
        displacements = np.zeros((len(self.places), 4, 4))
        displacements[:, range(4), range(4)] = 1.0
        if y.any():
            products: dict[int, pin.SE3] = {}
            exp, values = pin.exp6, y.tolist()
            # Backwards, so that the product of the factors after each term is at hand.
            for t, k, twist in self._backwards:
                later, factor = products.get(k), exp(twist * values[t])
                if later is None:
                    products[k] = factor
                else:
                    directions[6 * k : 6 * k + 6, t] = later.actInv(twist).vector
                    products[k] = factor * later
            for k, product in products.items():
                displacements[k] = product.homogeneous
        if self.terms is not self.parameters:
            directions = directions @ self.mixing
        return displacements, directions

    def apply(self, robot: Robot, x: Array) -> Robot:
        """The robot with its placements displaced; frame, target and errors of the joints' state are no part of it.

        Args:
            robot: The nominal robot.
            x: shape (p,), [m] and [rad].

        Raises:
            ModelError: ``x`` has not one entry for each parameter.
            UrdfError: No ``<origin>`` of the URDF can hold a displacement.
        """
        displacement, _ = self.displacements(x)
        if not np.any(x):
            return robot
        placements = robot.placements.copy()
        for i, place in enumerate((*(joint.name for joint in robot.joints), TIP)):
            factor = displacement[self.places.index(place)]
            if np.abs(factor - np.eye(4)).max() > _UNMOVED:
                placements[i] = placements[i] @ factor
        return robot.with_placements(placements)
