"""Truth: a robot as it really is, where targets sit and frames stand; and what disturbs a measurement.

    T_frame_target(q) = T_frame_base  T_base_tip(true placements, q + dq)  T_tip_target

with the joints' own errors dq of `families`; the load of a compliance is that of the nominal URDF's masses and
the payload at the joint values that are read, as `calib.estimate` takes it.

Each purpose has random numbers of its own, all from one seed. So one thing can be changed about a virtual cell and the
rest stays: outliers leave the noise of other rows as it was.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

import calib.data.kinds as registry
from calib.data.cell import Cell
from calib.data.columns import DEFAULT_TARGET
from calib.errors import CalibError, ModelError, choices
from calib.model.error_model import error_model, split_name
from calib.model.families import FAMILIES, unit_of
from calib.model.kinematics import Kinematics, Samples
from calib.model.parameters import ErrorModel
from calib.robot.gravity import gravity_loads
from calib.robot.payload import Payload
from calib.robot.ranges import random_joint_values
from calib.robot.readback import check_written
from calib.robot.robot import Robot, read_only, rigid_inverse
from calib.units import Array, parse_amount

#: Where the target is said to sit on the tip, if nothing else is said [m]: off the last axis, so that all is seen.
DEFAULT_PLACE = read_only((0.05, 0.05, 0.05))

#: How far a target sits from where it is said to sit, standard deviation [m], and how far it is turned [rad].
TARGET_ERROR, TARGET_TURN = 1e-3, 10e-3

#: Of a drawn set-up: distance of the tracker from the base, heights between which it stands [m], tilt [rad].
_AWAY, _HEIGHTS, _TILT = 3.0, (-0.5, 1.0), 0.01

#: What says that there is nothing of something.
NONE = "none"

#: The purposes of random numbers. A new one goes to the end: the numbers of the others then stay.
STREAMS = (
    "errors",
    "targets",
    "frames",
    "tracker noise",
    "robot noise",
    "angle noise",
    "encoder",
    "outlier rows",
    "outlier directions",
    "poses",
    "validation poses",
)


def stream(seed: int, purpose: str) -> np.random.Generator:
    """The random numbers of one of `STREAMS`."""
    if seed < 0:
        raise CalibError(f"The seed is {seed}; it must be a whole number, 0 or more.")
    sequence = np.random.SeedSequence(int(seed), spawn_key=(STREAMS.index(purpose),))
    return np.random.default_rng(sequence)


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What is true of a virtual cell."""

    nominal: Robot  #: The robot as its URDF says it is
    model: ErrorModel  #: The errors by name, the robot's own
    #: shape (p,), their values, in the units of ``model``. Of a robot that was given as a URDF, what of it the model
    #: can say
    x: Array
    given: Robot | None  #: The true geometry, where it was given as a URDF
    groups: tuple[str, ...]  #: Names of the set-ups; ``("",)`` for the only one
    T_frame_base: Array  #: shape (F, 4, 4), true pose of the base in each measurement frame [m]
    targets: tuple[str, ...]  #: Names of the targets
    T_tip_target: Array  #: shape (T, 4, 4), their true poses in the tip [m]
    said_T_tip_target: Array  #: shape (T, 4, 4), where the targets are said to sit [m]
    payload: Payload | None  #: What the tip carries
    gravity: Array  #: shape (3,), acceleration in the URDF's root [m/s^2]

    @property
    def robot(self) -> Robot:
        """The robot with its true placements, made anew each time; errors of the joints' state are no part of it."""
        return self.model.apply(self.nominal, self.x) if self.given is None else self.given

    def write_urdf(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the URDF of the true geometry, after reading it back with Pinocchio and yourdfpy."""
        robot = self.robot
        q = random_joint_values(robot)
        check_written(robot, robot.poses(q), q)
        # What it states of a calibration was said of another geometry.
        return robot.urdf.with_verdict("").write(path, overwrite=overwrite)

    def value(self, name: str) -> float:
        """The value of one error, in its unit; a `ModelError` if there is none of this name."""
        return float(self.x[self.model.index(name)])

    def tip_poses(self, q: ArrayLike) -> Array:
        """T_base_tip, shape (N, 4, 4), [m], at joint values that are read, shape (N, m) or (m,), [rad] or [m]."""
        robot, x, load = self.nominal, self.x, None
        if self.given is not None:
            robot = self.given
            x = np.where([p.factor is not None for p in self.model.parameters], x, 0.0)
        if any(term.factor and term.factor.loaded for term in self.model.terms):
            load = gravity_loads(self.nominal, q, self.payload, self.gravity)
        kinematics = Kinematics(robot, self.model, np.eye(4), np.eye(4))
        return kinematics.poses(x, Samples.at(q, load))

    def poses(self, q: ArrayLike, target: str | None = None, group: str | None = None) -> Array:
        """T_frame_target, shape (N, 4, 4), [m], of a target and a set-up by name, the first ones by default."""
        t = 0 if target is None else self.targets.index(target)
        g = 0 if group is None else self.groups.index(group)
        T: Array = self.T_frame_base[g] @ self.tip_poses(q) @ self.T_tip_target[t]
        return T

    def points(self, q: ArrayLike, target: str | None = None, group: str | None = None) -> Array:
        """The true positions of a target, shape (N, 3), [m]; arguments as for `poses`."""
        return self.poses(q, target, group)[:, :3, 3]

    def nominal_errors(self, q: ArrayLike) -> Array:
        """How far the nominal robot puts the first target from its true place, by its own errors, shape (N,), [m]."""
        apart = (self.tip_poses(q) - self.nominal.poses(q)) @ self.T_tip_target[0]
        return np.asarray(np.linalg.norm(apart[:, :3, 3], axis=1))


def draw_truth(
    robot: Robot,
    model: str = "placement",
    sizes: Mapping[str, float] | None = MappingProxyType({}),
    seed: int = 0,
    *,
    cell: Cell | None = None,
    errors: Mapping[str, float] | None = None,
    true_robot: Robot | None = None,
    target_error: float = TARGET_ERROR,
) -> Truth:
    """Draw what is true of a virtual cell.

    Args:
        robot: The nominal robot.
        model: In which errors it is wrong: a parameter set, and families behind it, ``"placement+gain"``.
        sizes: Standard deviations of the errors by family, in its unit; a family that is missing is wrong by what is
            typical of it. None: no errors are drawn.
        seed: Of the random numbers.
        cell: Targets, frames, payload, gravity, kind, and what is frozen, tied, bounded or has a prior of its own.
            Frames whose poses it does not give are drawn where it estimates them, or its kind has a frame of its own.
        errors: Values of single errors by name, in their units [m], [rad]...; they win over what is drawn.
        true_robot: The true geometry; then only errors of the joints' state are drawn.
        target_error: Standard deviation of a target's place about where it is said to be [m]; none if the cell says
            that the targets are known.
    """
    cell, given = cell or Cell(), dict(errors or {})
    if true_robot is not None:
        model = "+".join(("placement", *split_name(model)[1]))
    whole = error_model(robot, model, target=False, gravity=cell.gravity)
    free = {p.name for p in whole.parameters if true_robot is None or p.factor}
    if true_robot is not None:
        if fixed := [name for name in given if name in whole.names and name not in free]:
            raise ModelError(f"The true robot states the errors {choices(fixed)} already.")
        true_robot = _as_nominal(robot, true_robot)
        given |= _geometry_of(robot, true_robot)
    # A cell may be made for a fit of another model: what that alone has counts for nothing here.
    whole = whole.tied({n: t for n, t in cell.ties.items() if n in free and t[0] in free})
    whole = whole.without(n for n in cell.frozen if n in free and n in whole.names)
    groups, frames = _frames(cell, seed)
    targets, said, placed = _targets(cell, seed, target_error)
    return Truth(
        nominal=robot,
        model=whole,
        x=_errors(whole, sizes, seed, cell, given),
        given=true_robot,
        groups=groups,
        T_frame_base=frames,
        targets=targets,
        T_tip_target=placed,
        said_T_tip_target=said,
        payload=cell.payload,
        gravity=cell.gravity,
    )


def sizes_of(cell: Cell, text: str | None, *, named: bool) -> Mapping[str, float] | None:
    """``length 0.5 mm, angle 3 mrad`` or ``none``; by default none beside named errors, else the cell's, or typical."""
    if text is None and not named:
        return {f: cell.priors.of(f) for f in FAMILIES} if cell.priors.source == "given" else {}
    if text is None or text.strip() == NONE:
        return None
    found: dict[str, float] = {}
    for part in text.split(","):
        name, _, value = part.strip().partition(" ")
        if name not in FAMILIES:
            raise CalibError(
                f"--sizes was given as \"{text}\"; it must be '{NONE}', or sizes with commas between them such as "
                f'"length 0.5 mm, angle 3 mrad", of {choices(FAMILIES)}.'
            )
        unit = FAMILIES[name].unit
        found[name] = parse_amount(value, f"--sizes, {name}", unit.quantity, unit.example)
    return found


def tracker_pose(position: ArrayLike, rng: np.random.Generator) -> Array:
    """T_frame_base of a tracker that stands at a point of the base [m], levelled to about 10 mrad, turned anyhow."""
    T_base_frame = np.eye(4)
    turn = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi))
    tilt = Rotation.from_rotvec(np.append(rng.normal(0.0, _TILT, 2), 0.0))
    T_base_frame[:3, :3] = (turn * tilt).as_matrix()
    T_base_frame[:3, 3] = position
    return rigid_inverse(T_base_frame)


def _errors(
    model: ErrorModel,
    sizes: Mapping[str, float] | None,
    seed: int,
    cell: Cell,
    given: Mapping[str, float],
) -> Array:
    """Errors as given, else drawn with the size of their family, or their own in the cell, inside its bounds, (p,)."""
    for name in given:
        model.index(name)  # refuses one that it has not
    x = np.zeros(len(model))
    unit = stream(seed, "errors").standard_normal(len(model))
    for k, p in enumerate(model.parameters):
        family = FAMILIES[p.family]
        if p.name in given:
            x[k] = given[p.name]
        elif sizes is not None:
            size = sizes.get(family.name, family.typical)
            if family.sliding is not None and p.unit == family.sliding.symbol:
                size *= family.lever
            size = cell.parameter_priors.get(p.name, size)
            low, high = cell.bounds.get(p.name, (-np.inf, np.inf))
            x[k] = min(max(size * (abs(unit[k]) if family.positive else unit[k]), low), high)
        if abs(x[k]) > unit_of(p.unit).largest:
            raise CalibError(
                f"The error '{p.name}' is {x[k]:.3g} {p.unit}; it is at most {unit_of(p.unit).largest:g}."
            )
    return read_only(x)


def _as_nominal(nominal: Robot, true: Robot) -> Robot:
    """The nominal robot with the placements of a true one, whose URDF may differ in more than that."""
    ours, theirs = (
        [(joint.name, joint.type, *np.round(joint.axis, 9)) for joint in robot.joints]
        for robot in (nominal, true)
    )
    if true.joint_names != nominal.joint_names or ours != theirs:
        raise ModelError(
            f"The true robot '{true.urdf.source}' has other joints, types or axes between '{true.base}' and "
            f"'{true.tip}' than the nominal robot; they must be the same."
        )
    placements = true.placements.copy()
    placements[0] = nominal.T_root_base @ rigid_inverse(true.T_root_base) @ placements[0]
    return nominal.with_placements(placements)


def _geometry_of(nominal: Robot, true: Robot) -> dict[str, float]:
    """What of a true robot's placements the set ``placement`` can say: along, then about moving axes x, y, z."""
    found: dict[str, float] = {}
    for i, joint in enumerate(nominal.joints):
        if nominal.carriers[i] is not None:
            displaced = rigid_inverse(nominal.placements[i]) @ true.placements[i]
            turn = Rotation.from_matrix(displaced[:3, :3]).as_euler("XYZ")
            names = (f"{joint.name}.{n}" for n in ("x", "y", "z", "rx", "ry", "rz"))
            found |= dict(zip(names, map(float, (*displaced[:3, 3], *turn)), strict=True))
    return found


def _frames(cell: Cell, seed: int) -> tuple[tuple[str, ...], Array]:
    """The set-ups by name, and the true pose of the base in each: as given, drawn, or the base itself."""
    groups = tuple(cell.frames) or ("",)
    drawn = cell.estimate_frame or (cell.kind is not None and registry.get(cell.kind).own_frame)
    rng = stream(seed, "frames")
    frames = []
    for group in groups:
        given = cell.frames.get(group, cell.T_frame_base)
        angle, height = rng.uniform(-np.pi, np.pi), rng.uniform(*_HEIGHTS)
        there = np.array([_AWAY * np.cos(angle), _AWAY * np.sin(angle), height])
        if cell.tracker is not None:
            there = cell.tracker.position
        pose = tracker_pose(there, rng)
        frames.append(given if given is not None else pose if drawn else np.eye(4))
    return groups, read_only(frames)


def _targets(cell: Cell, seed: int, size: float) -> tuple[tuple[str, ...], Array, Array]:
    """The targets by name, where they are said to sit, and where they truly do."""
    names = tuple(cell.targets) or (DEFAULT_TARGET,)
    rng = stream(seed, "targets")
    said = np.tile(np.eye(4), (len(names), 1, 1))
    true = said.copy()
    for t, name in enumerate(names):
        place = cell.targets.get(name, cell.target)
        said[t, :3, 3] = DEFAULT_PLACE if place is None else place
        if cell.target_rotation is not None:
            said[t, :3, :3] = cell.target_rotation
        moved, turned = rng.normal(size=(2, 3))
        true[t] = said[t]
        if cell.estimate_target and size > 0.0:
            true[t, :3, 3] += size * moved
            true[t, :3, :3] = said[t, :3, :3] @ pin.exp3(TARGET_TURN * turned)
    return names, read_only(said), read_only(true)


@dataclass(frozen=True, slots=True)
class Outliers:
    """Rows whose measurement is displaced by ``size`` [m] anyhow; lengths are that much longer or shorter.

    They are a share of the rows to estimate from, 0 to 1 and at least one if it is above 0, or a number of them.
    """

    share: float = 0.0
    count: int | None = None
    size: float = 5e-3

    @classmethod
    def parse(cls, text: str, size: float) -> Outliers:
        """A number of rows, ``3``, or a share of them, ``5 %``."""
        number = re.fullmatch(r"\s*(\d{1,9}|\d*\.?\d+(?=\s*%))\s*(%?)\s*", text)
        if number is None:
            raise CalibError(
                f'--outliers was given as "{text}"; it must be a number of rows, "3", or a share of them, "5 %".'
            )
        if number[2]:
            return cls(share=float(number[1]) / 100.0, size=size)
        return cls(count=int(number[1]), size=size)

    def choose(self, candidates: Sequence[int], seed: int) -> list[int]:
        """Which of some rows are outliers, in order; more of them are those of fewer and others."""
        among = len(candidates)
        number = self.count
        if number is None:
            number = max(round(self.share * among), 1) if self.share > 0.0 and among else 0
        if number > among:
            raise CalibError(
                f"{number} outliers were asked for among {among} measurements to estimate from."
            )
        order = stream(seed, "outlier rows").permutation(among)
        return sorted(candidates[i] for i in order[:number])


@dataclass(frozen=True, slots=True, eq=False)
class MovedTarget:
    """A target, or all of them (None), that sit elsewhere from some row on, as if they had been knocked.

    ``row`` is the number of the first row, from 1, that finds it moved; ``by``, shape (3,), is in the tip [m].
    """

    row: int
    by: Array
    target: str | None = None

    def __post_init__(self) -> None:
        """Keep a read-only copy of the displacement."""
        object.__setattr__(self, "by", read_only(self.by))

    def rows(self, targets: Sequence[str]) -> NDArray[np.bool_]:
        """Which rows, given by their targets' names, find the target moved."""
        if not 1 <= self.row <= len(targets) or self.target not in (None, *targets):
            raise CalibError(
                f"The target '{self.target or 'of all'}' is to move before row {self.row}; there are the rows 1 to "
                f"{len(targets)} and the targets {choices(dict.fromkeys(targets))}."
            )
        mask = np.array([self.target in (None, name) for name in targets])
        mask[: self.row - 1] = False
        return mask


@dataclass(frozen=True, slots=True)
class Encoder:
    """The smallest steps in which joint values are read: of joints that turn [rad] and that slide [m]; 0: none.

    The robot stops somewhere within half a step of where it is sent, and what is read is the nearest step.
    """

    angle: float = 0.0
    length: float = 0.0

    def measure(self, q: Array, sliding: Sequence[bool], seed: int) -> tuple[Array, Array]:
        """Where the robot stops when it is sent to q, and what is read there, shape (N, m) each, [rad] or [m]."""
        step = np.where(sliding, self.length, self.angle)
        stood = q + stream(seed, "encoder").uniform(-0.5, 0.5, q.shape) * step
        safe = np.where(step > 0.0, step, 1.0)
        return stood, np.where(step > 0.0, np.round(stood / safe) * step, stood)
