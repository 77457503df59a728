"""Truth of a virtual cell: the true robot, and the true poses of targets and frames.

    T_frame_target(q) = T_frame_base  T_base_tip(true placements, q + dq)  T_tip_target

with the joints' errors dq of `calib.model.families`. The load of a compliance is that of the nominal URDF's masses and
the payload at the joint values that are read, as in a fit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

import calib.data.kinds as registry
from calib.basics.arrays import Array, read_only, rigid_inverse
from calib.basics.values import ReadOnlyMapping, Value
from calib.data.cell import Cell
from calib.data.cell_chains import chain_numbers, links_of, named_stations, named_targets
from calib.errors import CalibError, ModelError, choices
from calib.model.error_model import MOUNT, ErrorModel
from calib.model.families import FAMILIES, unit_of
from calib.model.frozen import frozen_parameters
from calib.model.kinematics import Kinematics, Samples
from calib.model.parameter_sets import error_model, split_name
from calib.numerics.moves import last_moves
from calib.robot.gravity import Payload, gravity_loads
from calib.robot.joined_urdf import path_of_robot
from calib.robot.ranges import random_joint_values
from calib.robot.readback import check_written
from calib.robot.robot import Robot
from calib.verbs.simulate.random_streams import stream

#: Stated position of the target in the tip, if none is given [m]: off the last axis, so that all joints have an effect.
DEFAULT_PLACE = read_only((0.05, 0.05, 0.05))

#: Standard deviation of a target's true position around its stated one [m].
TARGET_ERROR = 1e-3

#: Standard deviation of its true orientation about each axis [rad].
TARGET_TURN = 10e-3

#: Distance of the tracker of a drawn station from the base [m].
_DISTANCE = 3.0

#: Least and greatest height of the tracker of a drawn station [m].
_HEIGHTS = (-0.5, 1.0)

#: Distance of an instrument from the moving link that it is drawn on [m].
_ON_LINK = 0.1

#: Standard deviation of its tilt about each horizontal axis [rad].
_TILT = 0.01

#: Standard deviation of the stated place of a further robot, by tape measure and by eye, along and about each axis [m
#: and rad].
MOUNT_ERROR = 10e-3


@dataclass(frozen=True, slots=True, eq=False)
class Truth(Value):
    """Truth of a virtual cell."""

    #: The nominal robot
    nominal: Robot
    #: The model of the robot's errors
    model: ErrorModel
    #: shape (p,), the errors, in the units of the model. Of a robot that was given as a URDF, the errors that the model
    #: can express
    x: Array
    #: The true geometry, if it was given as a URDF
    given: Robot | None
    #: Names of the groups; ``("",)`` for the only one
    groups: tuple[str, ...]
    #: Shape (F, 4, 4), true pose of the base in each measurement frame [m]
    T_frame_base: Array
    #: Names of the targets
    targets: tuple[str, ...]
    #: Shape (T, 4, 4), their true poses in the tip [m]
    T_tip_target: Array
    #: Shape (T, 4, 4), their stated poses in the tip [m]
    stated_T_tip_target: Array
    #: Mass and centre of mass that the tip carries; None: nothing
    payload: Payload | None
    #: Shape (3,), acceleration in the URDF's root [m/s^2]
    gravity: Array
    #: Link of each frame; empty: the base for all
    frame_links: tuple[str, ...] = ()
    #: Link of each target; empty: the tip for all
    target_links: tuple[str, ...] = ()

    @property
    def sights(self) -> Mapping[tuple[int, int], int]:
        """The chain, by its number, through which a frame sees a target, by the numbers of both."""
        robot = self.nominal
        bases = self.frame_links or (robot.base,) * len(self.groups)
        tips = self.target_links or (robot.tip,) * len(self.targets)
        return chain_numbers(robot, bases, tips)

    @property
    def robot(self) -> Robot:
        """The robot with its true placements; errors that depend on the joints' state are not part of it."""
        return self.model.apply(self.nominal, self.x) if self.given is None else self.given

    def write_urdf(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the URDF of the true geometry, after reading it back with Pinocchio and calib.

        It has no verdict, because that of the nominal URDF is on another geometry. Of several robots each has a URDF of
        its own beside it too, as `calib.robot.joined_urdf.path_of_robot` names them.

        Args:
            path: The file.
            overwrite: Whether an existing file is replaced.

        Returns:
            The file.

        Raises:
            CalibError: The URDF reads back differently, or the file exists or cannot be written.
        """
        robot = self.robot
        q = random_joint_values(robot)
        expected = np.concatenate([chain.poses(q) for chain in robot.chains])
        check_written(robot, expected, q)
        # Run and verdict in the nominal URDF are of another geometry.
        urdf = robot.urdf.with_comments(run="", verdict="")
        if robot.parts:
            for name, own in robot.own_urdfs().items():
                described = own.with_comments(run="", verdict="")
                described.write(path_of_robot(path, name), overwrite=overwrite)
        return urdf.write(path, overwrite=overwrite)

    def value(self, name: str) -> float:
        """Return the value of one error, in its unit; raises `ModelError` if the model does not have it."""
        return float(self.x[self.model.index(name)])

    def tip_poses(self, q: ArrayLike, moves: Array | None = None, chain: int = 0) -> Array:
        """Compute the true T_base_tip, with all errors of the robot, shape (N, 4, 4), [m].

        Args:
            q: Joint values as exact encoders read them, shape (N, m) or (m,), [rad] or [m].
            moves: Last move of each joint before each row, shape (N, m), [rad] or [m]; None: the robot goes from each
                row to the next.
            chain: Number of the chain whose base and tip are meant, in ``nominal.chains``.
        """
        robot, x, load = self.nominal, self.x, None
        if self.given is not None:
            robot = self.given
            x = np.where([p.factor is not None for p in self.model.parameters], x, 0.0)
        if any(term.factor and term.factor.loaded for term in self.model.terms):
            load = gravity_loads(self.nominal, q, self.payload, self.gravity)
        kinematics = Kinematics(robot, self.model, np.eye(4), np.eye(4))
        samples = Samples.at(q, load, last_moves(q) if moves is None else moves)
        return kinematics.poses(x, replace(samples, chain=np.full(len(samples), chain)))

    def poses(self, q: ArrayLike, target: str | None = None, group: str | None = None) -> Array:
        """Compute the true T_frame_target, shape (N, 4, 4), [m].

        Args:
            q: Joint values as exact encoders read them, shape (N, m) or (m,), [rad] or [m].
            target: Name of the target; None: the first.
            group: Name of the group whose frame it is; None: the first.
        """
        t = 0 if target is None else self.targets.index(target)
        g = 0 if group is None else self.groups.index(group)
        T: Array = self.T_frame_base[g] @ self.tip_poses(q, chain=self._chain(g, t))
        return np.asarray(T @ self.T_tip_target[t])

    def points(self, q: ArrayLike, target: str | None = None, group: str | None = None) -> Array:
        """Compute the true positions of a target in a frame, shape (N, 3), [m]; see `poses`."""
        return self.poses(q, target, group)[:, :3, 3]

    def nominal_errors(self, q: ArrayLike, target: int = 0, frame: int = 0) -> Array:
        """Compute how far the nominal robot has a target from where the true robot has it.

        The target's place in the tip is the true one, and both positions are in the base, so that errors of the target
        and of the frame do not count.

        Args:
            q: Joint values as exact encoders read them, shape (N, m), [rad] or [m].
            target: Number of the target, from 0.
            frame: Number of the frame, whose link is the base, from 0.

        Returns:
            Distances, shape (N,), [m].
        """
        chain = self._chain(frame, target)
        difference = self.tip_poses(q, chain=chain) - self.nominal.chains[chain].poses(q)
        difference = difference @ self.T_tip_target[target]
        return np.asarray(np.linalg.norm(difference[:, :3, 3], axis=1))

    def _chain(self, frame: int, target: int) -> int:
        """Return the number of the chain between frame and target; ModelError if nothing moves between them."""
        if (frame, target) not in self.sights:
            raise ModelError(
                f"No joint moves the target '{self.targets[target]}' against the frame '{self.groups[frame]}'."
            )
        return self.sights[frame, target]


def draw_truth(
    robot: Robot,
    model: str = "placement",
    sizes: Mapping[str, float] | None = ReadOnlyMapping(),
    seed: int = 0,
    *,
    cell: Cell | None = None,
    errors: Mapping[str, float] | None = None,
    true_robot: Robot | None = None,
    target_error: float = TARGET_ERROR,
) -> Truth:
    """Draw the truth of a virtual cell.

    Args:
        robot: The nominal robot.
        model: Errors of the robot: a parameter set, and families appended, ``"placement+gain"``.
        sizes: Standard deviations of the errors by family, in its unit; typical ones for families that are missing.
            None: no errors are drawn.
        seed: Of the random numbers.
        cell: Targets, frames, payload, gravity, kind, and what is frozen, tied, bounded or has a prior of its own.
            Frames whose poses it does not give are drawn if it estimates them, or if its kind has a frame of its own.
        errors: Values of single errors by name, in their units [m], [rad]..., in place of drawn ones.
        true_robot: The true geometry; then only errors that depend on the joints' state are drawn.
        target_error: Standard deviation of a target's position around its stated one [m]; not used if the cell says
            that the targets are known.

    Returns:
        The truth.

    Raises:
        ModelError: An unknown error, or one that the true robot has already, or a true robot with other joints.
        CalibError: An error is larger than calib allows.
    """
    cell = cell or Cell()
    given = dict(errors or {})
    if true_robot is not None:
        model = "+".join(("placement", *split_name(model)[1]))
    all_errors = error_model(robot, model, target=False, gravity=cell.gravity)
    free = {p.name for p in all_errors.parameters if true_robot is None or p.factor}
    if true_robot is not None:
        stated_twice = [name for name in given if name in all_errors.names and name not in free]
        if stated_twice:
            raise ModelError(f"The true robot has the errors {choices(stated_twice)} already.")
        true_robot, placement_errors = _compare_placements(robot, true_robot)
        given |= placement_errors | {
            p.name: 0.0 for p in all_errors.parameters if p.family == MOUNT
        }
    # A cell may be made for a fit of another model: ties and frozen parameters that only that model has do not count.
    ties = {name: tie for name, tie in cell.ties.items() if name in free and tie[0] in free}
    frozen = frozen_parameters(robot, all_errors.parameters, cell.frozen)
    frozen = tuple(name for name in frozen if name in free and name in all_errors.names)
    drawn_model = all_errors.tied(ties).without(frozen)
    images = cell.kind is not None and registry.get(cell.kind).is_image
    groups = named_stations(cell, images=images)
    targets = named_targets(cell, images=images)
    frame_links, target_links = links_of(cell, robot, groups, targets)
    stated, true = _draw_targets(cell, targets, seed, target_error)
    sights = chain_numbers(robot, frame_links, target_links)
    for k, what, names, links in (
        (0, "station", groups, frame_links),
        (1, "target", targets, target_links),
    ):
        for number, (name, link) in enumerate(zip(names, links, strict=True)):
            if not any(sight[k] == number for sight in sights):
                raise ModelError(
                    f"The {what} '{name}' on '{link}' is of no use: no joint moves any "
                    f"{'target' if k == 0 else 'station'} against it. Put it on another link, or leave it out."
                )
    return Truth(
        nominal=robot,
        model=drawn_model,
        x=_draw_errors(drawn_model, sizes, seed, cell, given),
        given=true_robot,
        groups=groups,
        T_frame_base=_draw_frames(robot, cell, groups, frame_links, seed),
        targets=targets,
        T_tip_target=true,
        stated_T_tip_target=stated,
        payload=cell.payload,
        gravity=cell.gravity,
        frame_links=frame_links,
        target_links=target_links,
    )


def tracker_pose(position: ArrayLike, rng: np.random.Generator) -> Array:
    """Draw T_frame_base of a tracker at a point, levelled to about 10 mrad, in any heading.

    The origin of its frame is the tracker, and its z axis points up, nearly along z of the base.

    Args:
        position: In the base, shape (3,), [m].
        rng: Draws heading and tilt.

    Returns:
        shape (4, 4), [m].
    """
    heading = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi))
    tilt = Rotation.from_rotvec(np.append(rng.normal(0.0, _TILT, 2), 0.0))
    T_base_frame = np.eye(4)
    T_base_frame[:3, :3] = (heading * tilt).as_matrix()
    T_base_frame[:3, 3] = position
    return rigid_inverse(T_base_frame)


def _draw_errors(
    model: ErrorModel,
    sizes: Mapping[str, float] | None,
    seed: int,
    cell: Cell,
    given: Mapping[str, float],
) -> Array:
    """Return the p errors of a model, (p,) in their units: as given by name, the others normally distributed.

    Standard deviations are the cell's priors of single errors, else the sizes by family, else typical ones. Drawn ones
    are clipped to the cell's bounds, and are 0 without sizes (None). It raises `ModelError` for a name that the model
    does not have, and `CalibError` for an error that is too large.
    """
    for name in given:
        model.index(name)  # refuses one that the model does not have
    x = np.zeros(len(model))
    unit_normal = stream(seed, "errors").standard_normal(len(model))
    for k, parameter in enumerate(model.parameters):
        if parameter.name in given:
            x[k] = given[parameter.name]
        elif sizes is not None and parameter.family == MOUNT:
            x[k] = cell.parameter_priors.get(parameter.name, MOUNT_ERROR) * unit_normal[k]
        elif sizes is not None:
            family = FAMILIES[parameter.family]
            size = sizes.get(family.name, family.typical)
            if family.sliding is not None and parameter.unit == family.sliding.symbol:
                size *= family.lever
            size = cell.parameter_priors.get(parameter.name, size)
            low, high = cell.bounds.get(parameter.name, (-np.inf, np.inf))
            normal = abs(unit_normal[k]) if family.positive else unit_normal[k]
            x[k] = min(max(size * float(normal), low), high)
        largest = unit_of(parameter.unit).largest
        if abs(x[k]) > largest:
            raise CalibError(
                f"The error '{parameter.name}' is {x[k]:.3g} {parameter.unit}; it is at most "
                f"{largest:g}."
            )
    return read_only(x)


def _compare_placements(nominal: Robot, true: Robot) -> tuple[Robot, dict[str, float]]:
    """Return the nominal robot with the placements of a true one, and its errors as those of the set ``placement``.

    The errors, by name, are along x, y, z [m], then about the moving axes x, y, z [rad]. If joints, types or axes
    differ, it raises `ModelError`; the true robot's URDF may differ in other ways.
    """
    axes = [
        [(joint.name, joint.type, *np.round(joint.axis, 9)) for joint in robot.all_joints]
        for robot in (nominal, true)
    ]
    if true.joint_names != nominal.joint_names or axes[0] != axes[1]:
        raise ModelError(
            f"The true robot '{true.urdf.source}' has other joints, types or axes between "
            f"'{true.base}' and '{true.tip}' than the nominal robot; they must be the same."
        )
    matched_limbs = []
    for limb, true_limb in zip(nominal.limbs, true.limbs, strict=True):
        placements = true_limb.placements.copy()
        placements[0] = limb.T_root_base @ rigid_inverse(true_limb.T_root_base) @ placements[0]
        matched_limbs.append(placements)
    matched = nominal.with_limbs(matched_limbs)

    errors: dict[str, float] = {}
    for limb, matched_limb in zip(nominal.limbs, matched.limbs, strict=True):
        for i, joint in enumerate(limb.joints):
            if limb.carriers[i] is None:
                continue
            T_nominal_true = rigid_inverse(limb.placements[i]) @ matched_limb.placements[i]
            angles = Rotation.from_matrix(T_nominal_true[:3, :3]).as_euler("XYZ")
            names = [f"{joint.name}.{direction}" for direction in ("x", "y", "z", "rx", "ry", "rz")]
            values = map(float, (*T_nominal_true[:3, 3], *angles))
            errors |= dict(zip(names, values, strict=True))
    return matched, errors


def _draw_frames(
    robot: Robot, cell: Cell, groups: tuple[str, ...], links: tuple[str, ...], seed: int
) -> Array:
    """Return T_frame_base of F stations on their links, (F, 4, 4) [m]: as given, drawn, or the identity.

    One is drawn if it is not given and the cell estimates it, or its kind of measurement has a frame of its own: within
    reach of a link that moves if the cell names that link, else beside the robot.
    """
    has_own_frame = cell.kind is not None and registry.get(cell.kind).own_frame
    moving = {joint.name for joint in robot.all_joints}
    rng = stream(seed, "frames")
    frames = []
    for group, link in zip(groups, links, strict=True):
        angle = rng.uniform(-np.pi, np.pi)
        height = rng.uniform(*_HEIGHTS)
        position = np.array([_DISTANCE * np.cos(angle), _DISTANCE * np.sin(angle), height])
        _, from_root = robot.urdf.chain(robot.urdf.root, link)
        if group in cell.bases and moving.intersection(from_root):
            position *= _ON_LINK / np.linalg.norm(position)
        elif cell.tracker is not None:
            position = cell.tracker.position
        # Drawn even if a pose is given, so that the random numbers of the next group do not depend on it.
        drawn = tracker_pose(position, rng)
        given = cell.frames.get(group, cell.T_frame_base)
        if given is not None:
            frames.append(given)
        elif cell.estimate_frame or has_own_frame:
            frames.append(drawn)
        else:
            frames.append(np.eye(4))
    return read_only(frames)


def _draw_targets(
    cell: Cell, names: tuple[str, ...], seed: int, position_std: float
) -> tuple[Array, Array]:
    """Return stated poses of T targets in their tips, (T, 4, 4) [m], and true ones drawn around these.

    With known targets, or a standard deviation of 0 [m], the true poses are the stated ones.
    """
    rng = stream(seed, "targets")
    stated = np.tile(np.eye(4), (len(names), 1, 1))
    true = stated.copy()
    for t, name in enumerate(names):
        place = cell.targets.get(name, cell.target)
        stated[t, :3, 3] = DEFAULT_PLACE if place is None else place
        if cell.target_rotation is not None:
            stated[t, :3, :3] = cell.target_rotation
        displacement, turn = rng.normal(size=(2, 3))
        true[t] = stated[t]
        if cell.estimate_target and position_std > 0.0:
            true[t, :3, 3] += position_std * displacement
            true[t, :3, :3] = stated[t, :3, :3] @ pin.exp3(TARGET_TURN * turn)
    return read_only(stated), read_only(true)
