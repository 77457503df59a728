"""Parameters of an error model: each is an error, with the place that it acts at and its direction.

See `calib.model.parameter_sets` for the equation. A parameter may be *tied* to another one, x_a = factor x_b; then it
keeps its term of the equation but is not an unknown of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array, Mask, read_only
from calib.basics.values import Value
from calib.errors import ModelError, choices
from calib.model.families import FAMILIES, Factor
from calib.robot.robot import Robot

#: Place of a measurement frame, followed by the frame's name: ``"(frame)left"``. No URDF has a joint of such a name.
FRAME = "(frame)"

#: Place of the tip: its placement in the last joint.
TIP = "(tip)"

#: Place of a target, followed by the target's name.
TARGET = "(target)"

#: Family of the pose of a further robot's root in the root of the first one; its place is the fixed joint between them.
MOUNT = "(mount)"

#: Family of the intrinsics of a camera, which are estimated with its frame.
CAMERA = "camera"

#: Family of the errors of a board's print: scale, sag, corners.
BOARD = "board"

#: Families of parameters that are not errors of the robot.
SETUP = (FRAME, TARGET, MOUNT, CAMERA, BOARD)

#: A placement that is displaced by less stays as it is, and so does its <origin> [m; rotation matrices: 1].
_UNMOVED = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Parameter(Value):
    """One error: a direction at a place."""

    #: Unique, such as ``"d1"``, ``"elbow_joint.rx"`` or ``"target_x"``.
    name: str
    #: The symbol of a `calib.model.families.Unit`: "m", "rad", "rad/Nm", ...
    unit: str
    #: A joint's name, `TIP`, or that of a frame or a target.
    place: str
    #: shape (6,), twist in the place's frame, linear then angular, of a unit of the parameter or the joint's motion.
    direction: Array
    #: One of `calib.model.families.FAMILIES`, or of `SETUP`.
    family: str
    #: The value that it adds to, in its unit: the DH table's, or 0.
    nominal: float = 0.0
    #: The function of the joint's state that multiplies it; None for 1.
    factor: Factor | None = None
    #: Column of its instrument's internals that it adds to, see `calib.model.internals`; None for one that moves its
    #: place in its direction.
    internal: int | None = None
    #: Columns of the internals and their values in the samples that it changes: the number of the object that has the
    #: internal (a camera or a board), and that of one point of it (a corner).
    samples: tuple[tuple[int, int], ...] = ()

    @property
    def of_one_point(self) -> bool:
        """True for an internal of one point of a target, such as the place of a corner on its print."""
        return len(self.samples) > 1


@dataclass(frozen=True, slots=True, eq=False)
class ErrorModel(Value):
    """A named list of parameters for one chain, and the terms of the equation that they move."""

    #: The set's name, such as ``"dh"``.
    name: str
    #: All places in order: the frames, the joints, the tip, the targets.
    places: tuple[str, ...]
    #: The p unknowns, in the order of the parameter vector x.
    parameters: tuple[Parameter, ...]
    #: The parameters and those tied to them, in the order in which they act; the parameters if none is tied.
    terms: tuple[Parameter, ...] = ()
    #: shape (terms, p): the value of each term is mixing @ x; the identity if none is tied.
    mixing: Array = field(default_factory=lambda: np.zeros((0, 0)))
    #: Index, place's index, and twist of each term of a placement, the last first.
    _backwards: tuple[tuple[int, int, pin.Motion], ...] = field(init=False, repr=False)
    #: shape (6 places, terms), twist of each term at each place if all values are zero.
    _undisplaced: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Note the place and the twist of each term; raise ModelError for names given twice and unknown places."""
        if not self.mixing.shape[1]:
            object.__setattr__(self, "terms", self.parameters)
            object.__setattr__(self, "mixing", read_only(np.eye(len(self.parameters))))
        of_placements = [
            (t, term)
            for t, term in enumerate(self.terms)
            if term.factor is None and term.internal is None
        ]
        names = [term.name for term in self.terms]
        doubled = sorted({name for name in names if names.count(name) > 1})
        unknown = sorted({term.place for _, term in of_placements} - set(self.places))
        if doubled or unknown:
            raise ModelError(
                f"The model '{self.name}' has parameters {choices(doubled)} twice, or at unknown places "
                f"{choices(unknown)}; places are {choices(self.places)}."
            )
        place_index = {place: k for k, place in enumerate(self.places)}
        undisplaced = np.zeros((6 * len(self.places), len(self.terms)))
        backwards = []
        for t, term in reversed(of_placements):
            k = place_index[term.place]
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
        """The symbols of the parameters' units."""
        return tuple(p.unit for p in self.parameters)

    @property
    def families(self) -> tuple[str, ...]:
        """The families that the model has parameters of, in the order of the registry."""
        present = {p.family for p in self.parameters}
        return tuple(name for name in FAMILIES if name in present)

    def __len__(self) -> int:
        """The number p of parameters."""
        return len(self.parameters)

    @property
    def of_robot(self) -> Mask:
        """Mask, shape (p,): True for errors of the robot, False for those of frames, targets, cameras or boards."""
        return ~self.family(*SETUP)

    @property
    def internals(self) -> tuple[tuple[int, Parameter], ...]:
        """Index and parameter of each internal of an instrument that is estimated."""
        return tuple((k, p) for k, p in enumerate(self.parameters) if p.internal is not None)

    def family(self, *names: str) -> Mask:
        """Return the mask of the parameters that belong to one of the families named, shape (p,)."""
        return np.array([p.family in names for p in self.parameters], dtype=bool)

    def index(self, name: str) -> int:
        """Return the position of a parameter in x, from 0; ModelError if the model has none of that name."""
        if name not in self.names:
            raise ModelError(
                f"The model '{self.name}' has no parameter '{name}'; it has {choices(self.names, limit=60)}."
            )
        return self.names.index(name)

    def without(self, names: Iterable[str]) -> ErrorModel:
        """Return the model with these parameters, and those tied to them, frozen at their nominal values.

        Raises:
            ModelError: The model has no parameter of such a name.
        """
        frozen = {self.index(name) for name in names}
        if not frozen:
            return self
        kept = [k for k in range(len(self)) if k not in frozen]
        return self._mixed(kept, self.mixing[:, kept])

    def tied(self, ties: Mapping[str, tuple[str, float]]) -> ErrorModel:
        """Return the model with some parameters following others, x_follower = factor x_leader.

        Followers are no unknowns of that model; their terms of the equation stay.

        Args:
            ties: Leader's name and factor by the follower's name. A leader stays free.

        Raises:
            ModelError: A name is not that of a parameter, a leader is a follower too, or their units differ.
        """
        if not ties:
            return self
        mixing = self.mixing.copy()
        for name, (leader_name, factor) in ties.items():
            follower = self.index(name)
            leader = self.index(leader_name)
            unit = self.units[follower]
            leader_unit = self.units[leader]
            if leader_name in ties or follower == leader or unit != leader_unit:
                raise ModelError(
                    f"'{name}' [{unit}] cannot follow '{leader_name}' [{leader_unit}]: parameters are tied to one "
                    "that is free and of the same unit."
                )
            mixing[:, leader] += factor * mixing[:, follower]
        free = [k for k, name in enumerate(self.names) if name not in ties]
        return self._mixed(free, mixing[:, free])

    def _mixed(self, kept: list[int], mixing: Array) -> ErrorModel:
        """Return the model of the parameters with these p' indices, and the terms that ``mixing`` (terms, p') moves."""
        used = np.flatnonzero(mixing.any(axis=1))
        return replace(
            self,
            parameters=tuple(self.parameters[k] for k in kept),
            terms=tuple(self.terms[t] for t in used),
            mixing=read_only(mixing[used]),
        )

    @property
    def joint_terms(self) -> tuple[int, ...]:
        """The indices of the terms that change with the joints' state."""
        return tuple(t for t, term in enumerate(self.terms) if term.factor is not None)

    @property
    def depends_on_moves(self) -> bool:
        """True if an error depends on the last moves of the joints, as lost motion does."""
        return any(term.factor is not None and term.factor.moved for term in self.terms)

    @property
    def depends_on_loads(self) -> bool:
        """True if an error depends on the loads on the joints, as compliance does."""
        return any(term.factor is not None and term.factor.loaded for term in self.terms)

    def values(self, x: Array) -> Array:
        """Return the value of every term in its unit, shape (terms,), at the parameters x, shape (p,)."""
        return np.asarray(self.mixing @ x)

    def displacements(self, x: Array) -> tuple[Array, Array]:
        """Return the displacement of every place, and the twist of a unit of each parameter there.

            P' = P D,    D = exp(xi_1 x_1) exp(xi_2 x_2) ...,    dD/dx_k = D [twist of column k]

        Args:
            x: Shape (p,), the parameters in their units.

        Returns:
            D, shape (places, 4, 4), [m]; and the twists, shape (6 places, p): rows 6 k to 6 k + 5 are those at place
            k, in the displaced frame, linear then angular.
        """
        values = self.values(x)
        twists = self._undisplaced.copy()
        displacements = np.tile(np.eye(4), (len(self.places), 1, 1))
        if values.any():
            # Backwards, so that the product of the factors after each term is at hand, past which its twist is carried.
            products: dict[int, pin.SE3] = {}
            numbers = values.tolist()
            for t, k, twist in self._backwards:
                later = products.get(k)
                factor = pin.exp6(twist * numbers[t])
                if later is not None:
                    twists[6 * k : 6 * k + 6, t] = later.actInv(twist).vector
                    factor = factor * later
                products[k] = factor
            for k, product in products.items():
                displacements[k] = product.homogeneous
        if self.terms is not self.parameters:
            twists = twists @ self.mixing
        return displacements, twists

    def apply(self, robot: Robot, x: Array) -> Robot:
        """Return the robot with its placements displaced: the geometric model, as a URDF holds it.

        Args:
            robot: The nominal robot.
            x: Shape (p,), the parameters in their units; those of frames, targets, instruments and the joints' state
                have no effect.

        Raises:
            UrdfError: A placement is displaced that no URDF joint carries.
        """
        if not np.any(x):
            return robot
        displacements, _ = self.displacements(x)
        by_place = dict(zip(self.places, displacements, strict=True))
        placements_of_limbs = []
        for limb in robot.limbs:
            placements = limb.placements.copy()
            for i, place in enumerate((*(joint.name for joint in limb.joints), TIP)):
                if np.abs(by_place[place] - np.eye(4)).max() > _UNMOVED:
                    placements[i] = placements[i] @ by_place[place]
            placements_of_limbs.append(placements)
        mounts = {}
        for mount in robot.mounts:
            if np.abs(by_place[mount] - np.eye(4)).max() > _UNMOVED:
                mounts[mount] = robot.urdf.joint(mount).T_parent_joint @ by_place[mount]
        return robot.with_limbs(placements_of_limbs, mounts)


def twist_of(linear: Array, angular: Array) -> Array:
    """Return a twist, shape (6,), read-only: its linear, then its angular part, both of shape (3,)."""
    return read_only(np.concatenate([linear, angular]))
