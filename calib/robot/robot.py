"""Robot: an immutable kinematic chain, from one link of a URDF to another, over Pinocchio.

The chain's moving joints are numbered 1 to n from base to tip. Its geometry is n + 1 *placements*: the
pose of joint i in the frame of the joint before it, and the pose of the tip in the frame of joint n:

    T_base_tip(q) = T_root_base^-1  P_1 J_1(q_1)  P_2 J_2(q_2) ... P_n J_n(q_n)  P_tip

Every correction is a change of these placements, each carried by the ``<origin>`` of one URDF joint. The joints may lie
on both sides of the link where the branches to base and tip part (`calib.robot.chain`), and may be more than the
columns of q, where some mimic others or are held (`calib.robot.chain`).

Gravity loads each joint by load_i(q) = - dU(q) / dq_i, with the potential energy U of all links and the payload. A
joint of compliance c [rad/Nm or m/N] gives way by c load_i.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from calib.errors import ModelError, UrdfError, choices
from calib.robot import kernel
from calib.robot.chain import (
    Around,
    all_values,
    chain_between,
    checked_held,
    coupling,
    farthest_link,
    full_configurations,
    full_model,
    joint_frames,
    link_frame,
    rigid_inverse,
)
from calib.robot.urdf import Urdf, UrdfJoint, read_only, read_urdf
from calib.units import Array

__all__ = ["Robot", "read_only", "rigid_inverse"]


GRAVITY = (0.0, 0.0, -9.81)
"""The acceleration of gravity where the URDF's root link has z up, [m/s^2]."""

#: The least length that is divided by.
_TINY = float(np.finfo(np.float64).tiny)

#: A placement that no <origin> holds may differ by rounding [m; rotation matrices: 1].
_ROUNDING = 1e-12


@dataclass(frozen=True, slots=True)
class Robot:
    """A chain of a URDF, immutable: a changed robot is a new one. Lengths [m], angles [rad].

    Two are equal when URDF, base, tip and held joints are.
    """

    #: The n moving joints, base to tip, mimic and held ones too; those on the base's side with the axis turned round.
    joints: tuple[UrdfJoint, ...] = field(compare=False)
    #: Shape (n + 1, 4, 4), [m]; see the module's text. The last one is the tip's.
    placements: NDArray[np.float64] = field(compare=False)
    #: For each placement the URDF joint whose ``<origin>`` holds it; None where a moving joint carries the end.
    carriers: tuple[str | None, ...] = field(compare=False)
    #: Pose of the base, (4, 4), [m], where the chain starts: the URDF's root, or a base that its joints move.
    T_root_base: NDArray[np.float64] = field(compare=False)
    _around: tuple[Around, ...] = field(compare=False)
    base_moves: bool = field(compare=False)  #: Whether joints lie on the base's side.
    urdf: Urdf  #: The URDF that describes this robot; always in step with ``placements``.
    base: str  #: Link in whose frame poses are given.
    tip: str  #: Link whose pose is given.
    _held: tuple[tuple[str, float], ...]
    #: The joint of each column of q, m of them; a driver that lies outside the chain is among them.
    inputs: tuple[UrdfJoint, ...] = field(compare=False)
    #: A of q_chain = A q + b, shape (n, m): how the joints of the chain follow the columns of q.
    coupling: NDArray[np.float64] = field(compare=False)
    _offset: NDArray[np.float64] = field(compare=False)

    @classmethod
    def load(
        cls,
        source: str | Path,
        base: str | None = None,
        tip: str | None = None,
        measured: Collection[str] | None = None,
        held: Mapping[str, float] | None = None,
    ) -> Robot:
        """Load a robot from a URDF or xacro file, or by its name from example-robot-data.

        Args:
            source: Path of a URDF; or of a xacro, with arguments behind it as in ``"ur.urdf.xacro ur_type:=ur5e"``; or
                a name such as ``"ur3"`` or ``"panda"``.
            base: Link in whose frame the poses are given; default the URDF's root link.
            tip: Link that the chain ends at; default the link with the most moving joints before it.
            measured: Names of the joints whose values are known: the default tip is reached by these alone, if it can.
            held: Values [rad or m] of joints that stay where they are, so that no column of q is theirs. Joints
                beside the chain may be among them; they matter for gravity only, and are at zero if not named.

        Raises:
            FileError: The file cannot be read.
            UrdfError: No such robot, link or joint, a chain that calib cannot take, or a xacro with a fault.

        Example:
            >>> Robot.load("ur3", base="base", tip="tool0").joint_names[0]
            'shoulder_pan_joint'
        """
        return cls.from_urdf(read_urdf(source), base, tip, measured, held)

    @classmethod
    def from_urdf(
        cls,
        urdf: Urdf,
        base: str | None = None,
        tip: str | None = None,
        measured: Collection[str] | None = None,
        held: Mapping[str, float] | None = None,
    ) -> Robot:
        """The chain from ``base`` to ``tip`` of a URDF that has been read; see `load`."""
        kept = checked_held(urdf, held)
        base = urdf.root if base is None else base
        tip = farthest_link(urdf, base, measured, dict(kept)) if tip is None else tip
        chain = chain_between(urdf, base, tip)
        return cls(*chain, urdf, base, tip, kept, *coupling(urdf, chain[0], dict(kept)))

    def rebuilt(
        self, urdf: Urdf | None = None, base: str | None = None, tip: str | None = None
    ) -> Robot:
        """The robot read anew from another URDF or between other links, what is held and not named kept."""
        return Robot.from_urdf(
            self.urdf if urdf is None else urdf,
            self.base if base is None else base,
            self.tip if tip is None else tip,
            held=self.held,
        )

    def __repr__(self) -> str:
        """In one line, such as ``Robot('ur3', base to tool0, 6 joints)``."""
        return f"Robot('{self.name}', {self.base} to {self.tip}, {len(self.joints)} joints)"

    @property
    def name(self) -> str:
        """The robot's name in the URDF."""
        return self.urdf.name

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The names of the measured joints, the columns of q, in the order in which the chain needs them."""
        return tuple(joint.name for joint in self.inputs)

    @property
    def joint_types(self) -> dict[str, str]:
        """The URDF type of each column's joint: revolute, continuous or prismatic."""
        return {joint.name: joint.type for joint in self.inputs}

    @property
    def held(self) -> dict[str, float]:
        """The values of joints that stay where they are [rad or m], a new dictionary each time."""
        return dict(self._held)

    def poses(self, q: ArrayLike) -> NDArray[np.float64]:
        """T_base_tip, shape (N, 4, 4), [m], at q, shape (N, m) or (m,), [rad] or [m]."""
        values = self.chain_values(q)
        first = np.zeros(len(values), dtype=np.int_)
        stood = kernel.ChainSamples(values, first, first, np.zeros((*values.shape, 0)), first[:0])
        return kernel.poses(self.geometry(self.placements), stood)

    def geometry(
        self,
        placements: NDArray[np.float64],
        T_frame_base: NDArray[np.float64] | None = None,
        T_tip_target: NDArray[np.float64] | None = None,
    ) -> kernel.Geometry:
        """The chain with these placements, (n + 1, 4, 4), as arrays, see `calib.robot.kernel`.

        T_frame_base, (F, 4, 4), are the measurement frames and T_tip_target, (T, 4, 4), the targets [m]; None for one
        that is the base or the tip.
        """
        slides, turns, T_base_root = _axes_of(self)
        bases = np.eye(4)[None] if T_frame_base is None else T_frame_base
        targets = np.eye(4)[None] if T_tip_target is None else T_tip_target
        return kernel.Geometry(slides, turns, placements, bases, T_base_root, targets)

    def chain_values(self, q: ArrayLike) -> NDArray[np.float64]:
        """The values of ``joints``, q_chain = A q + b, shape (N, n), [rad] or [m]; raises as `poses`."""
        values = np.atleast_2d(np.asarray(q, dtype=np.float64))
        names = self.joint_names
        if values.ndim != 2 or values.shape[1] != len(names) or not np.isfinite(values).all():
            raise ModelError(
                f"Joint values of shape {np.shape(q)} were given; the chain '{self.base}' to '{self.tip}' has "
                f"{len(names)} joints: {choices(names)}, and each value is a finite number."
            )
        if tuple(joint.name for joint in self.joints) == names:
            return values  # every joint is its own column
        result: NDArray[np.float64] = values @ self.coupling.T + self._offset
        return result

    def urdf_values(self, q: ArrayLike) -> dict[str, NDArray[np.float64]]:
        """The value of every joint of the URDF with one coordinate, by name, shape (N,), [rad] or [m].

        Joints that are neither held nor follow a column of q are at zero.
        """
        count = len(self.chain_values(q))  # checks shape and numbers
        columns = np.reshape(np.asarray(q, dtype=np.float64), (count, -1)).T
        named = dict(zip(self.joint_names, columns, strict=True))
        return all_values(self.urdf, named, self.held, count)

    def with_placements(self, placements: NDArray[np.float64]) -> Robot:
        """A new robot with placements of shape (n + 1, 4, 4), [m], and the ``<origin>`` elements to match.

        Raises:
            UrdfError: A placement differs but no URDF joint can carry it: the tip's, or that of a moving base.
        """
        placements = np.array(placements, dtype=np.float64)
        for i, carrier in enumerate(self.carriers):
            if carrier is None:
                if np.abs(placements[i] - self.placements[i]).max() > _ROUNDING:
                    end = f"base '{self.base}'" if i == 0 else f"tip '{self.tip}'"
                    raise UrdfError(
                        f"The {end} of '{self.name}' is moved by its joint directly: the URDF has no <origin> between "
                        "them that could hold a correction. Choose a link that is fixed to it, or add a fixed joint "
                        "and a link to the URDF."
                    )
                placements[i] = self.placements[i]
        moved = replace(self, placements=read_only(placements))
        was = self.origins()
        origins = {name: T for name, T in moved.origins().items() if (was[name] != T).any()}
        return replace(moved, urdf=self.urdf.with_origins(origins))

    def origins(self) -> dict[str, NDArray[np.float64]]:
        """The ``<origin>`` of each URDF joint that carries a placement, shape (4, 4), [m]."""
        origins = {}
        for P, carrier, how in zip(self.placements, self.carriers, self._around, strict=True):
            before, after, inverted = how
            if carrier is not None:
                factor = rigid_inverse(before) @ P @ rigid_inverse(after)
                origins[carrier] = rigid_inverse(factor) if inverted else factor
        return origins


@lru_cache(maxsize=16)
def _axes_of(robot: Robot) -> tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.float64]]:
    """Which joints slide, shape (n,), rotations that take z to their axes, (n, 3, 3), and T_base_root, (4, 4)."""
    slides = np.array([joint.type == "prismatic" for joint in robot.joints])
    turns = kernel.turns_to(np.array([joint.axis for joint in robot.joints]))
    return slides, turns, rigid_inverse(robot.T_root_base)


# Gravity


@dataclass(frozen=True, slots=True, eq=False)
class Payload:
    """A mass that the tip carries and that the URDF does not hold."""

    mass: float  #: [kg].
    #: shape (3,), its centre of mass in the tip [m].
    com: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        """Copy the centre of mass and check the numbers."""
        object.__setattr__(self, "com", _three(self.com, "centre of mass of a payload", "[m]"))
        if not (np.isfinite(self.mass) and self.mass >= 0):
            raise ModelError(
                f"The mass of a payload is {self.mass} kg; give a number of kg, 0 or more."
            )


def gravity_loads(
    robot: Robot, q: ArrayLike, payload: Payload | None = None, gravity: ArrayLike = GRAVITY
) -> Array:
    """What gravity can load each of the chain's n joints with, shape (N, n, n + 3).

    First the load itself [Nm] or [N], by the masses of all links of the URDF, also beside the chain, where their joints
    are as `Robot.urdf_values` says; a link without a mass is massless. Then the lever arms [m] of a mass at the origin
    of each joint of the chain, at the tip, and at a base that joints move: its load over its weight. All are positive
    where gravity drives the joint towards larger values.

    Args:
        robot: The robot.
        q: shape (N, m) or (m,), [rad] or [m], in the order of ``robot.joint_names``.
        payload: What the tip carries besides.
        gravity: shape (3,), acceleration in the URDF's root link [m/s^2], which stands still.
    """
    values = robot.urdf_values(q)
    down = _three(gravity, "acceleration of gravity", "[m/s^2]")
    model = _loaded_model(robot, payload, down)
    data = model.createData()
    columns = [model.idx_vs[model.getJointId(joint.name)] for joint in robot.joints]
    towards = down / max(float(np.linalg.norm(down)), _TINY)

    def work(block: slice) -> Array:
        """The loads of a block of samples."""
        joints = {name: value[block] for name, value in values.items()}
        torques = [
            pin.computeGeneralizedGravity(model, data, configuration)
            for configuration in full_configurations(model, joints)
        ]
        drives = -np.array(torques).reshape(-1, model.nv)[:, columns, None]
        return np.concatenate([drives, _lever_arms(robot, model, joints, towards)], axis=2)

    return np.concatenate(kernel.over_blocks(work, len(next(iter(values.values())))))


def _loaded_model(robot: Robot, payload: Payload | None, gravity: Array) -> pin.Model:
    """The model of the whole URDF with a payload at the tip, in this gravity, (3,) [m/s^2]."""
    model = full_model(robot.urdf)
    model.gravity.linear = np.array(gravity)
    model.gravity.angular = np.zeros(3)
    if payload is not None:
        tip = model.frames[link_frame(model, robot.tip)]
        mass = pin.Inertia(float(payload.mass), np.array(payload.com), np.zeros((3, 3)))
        model.appendBodyToJoint(tip.parentJoint, mass, tip.placement)
    return model


def _lever_arms(robot: Robot, model: pin.Model, values: Mapping[str, Array], down: Array) -> Array:
    """The lever arms of `gravity_loads`: how much deeper a unit of each joint moves each point.

    A turning joint at o with the axis a moves a point p by a x (p - o), which is (p - o) . (down x a) deeper; a sliding
    one by a, which is a . down deeper.

    Args:
        robot: The robot.
        model: The model of its whole URDF.
        values: What `Robot.urdf_values` says of N samples.
        down: shape (3,), the direction of gravity in the URDF's root.

    Returns:
        shape (N, n, n + 2), [m] per rad or m: at the origins of the n joints, the tip and the base.
    """
    numbers = [model.getJointId(joint.name) for joint in robot.joints]
    ends = [model.frames[link_frame(model, link)] for link in (robot.tip, robot.base)]
    carriers = [*numbers, *(end.parentJoint for end in ends)]
    frames = joint_frames(model, robot.urdf, values, carriers)
    T = np.stack([frames[number] for number in numbers], axis=1)
    axes, origins = (T[:, :, :3, :3] @ _urdf_axes(robot)[:, :, None])[..., 0], T[:, :, :3, 3]
    T_ends = [frames[end.parentJoint] @ end.placement.homogeneous for end in ends]
    points = np.concatenate([origins, *(T[:, None, :3, 3] for T in T_ends)], axis=1)
    slopes = np.cross(down, axes)
    arms = slopes @ points.swapaxes(1, 2) - np.sum(slopes * origins, axis=2)[:, :, None]
    slides = np.array([joint.type == "prismatic" for joint in robot.joints])
    arms[:, slides] = (axes[:, slides] @ down)[:, :, None]
    # A joint bears what comes behind it in the URDF.
    bears = [[number in model.supports[carrier] for carrier in carriers] for number in numbers]
    return np.asarray(arms * np.array(bears))


def _urdf_axes(robot: Robot) -> Array:
    """The axes of the chain's joints as the URDF has them, none turned round, shape (n, 3)."""
    return np.array([robot.urdf.joint(joint.name).axis for joint in robot.joints])


def _three(values: ArrayLike, what: str, unit: str) -> Array:
    """Three finite numbers, read-only; refused otherwise."""
    array = read_only(values)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise ModelError(f"The {what} is {values!r}; give three finite numbers {unit}.")
    return array
