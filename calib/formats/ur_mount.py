"""How a robot is an arm of Universal Robots: which one, and where its base and its flange are.

The names of the links in Universal Robots' descriptions say where the controller's base and flange are: no axes show an
error of the first joint's zero and height or of the last one's. The arm is the one with the nearest nominal kinematics.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.errors import ModelError, UrdfError, choices
from calib.formats.ur_arms import JOINTS, MODELS, TOLERANCE, UrModel, chain_of_rows, chain_poses
from calib.model.dh import zero_poses
from calib.robot.robot import Robot, read_only, rigid_inverse

Array = NDArray[np.float64]

#: One that is calibrated already may lie this far from it [m; rotation matrices: 1].
_CALIBRATED = 0.05

#: Links that are the controller's base, and whether they are turned by half a turn about z against it.
_BASES = (("base_link_inertia", False), ("base", False), ("base_link", True))

#: Links that are its flange. In the old descriptions the last link is not.
_FLANGES = ("tool0", "wrist_3_link")

_HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])

#: Joint values within one turn at which arms are compared, shape (200, 6), [rad], the same every time.
SPREAD = read_only(np.random.default_rng(20170401).uniform(-np.pi, np.pi, (200, 6)))


@dataclass(frozen=True, slots=True, eq=False)
class Mount:
    """How a URDF's frames are fixed to those of an arm: T_base_tip = T_base_arm chain(q) T_flange_tip.

    Attributes:
        model: Which arm it is.
        T_base_arm, T_flange_tip: shape (4, 4), [m]: the controller's base in the robot's, the tip in its flange.
        T_arm_joint: shape (6, 4, 4), [m]: each joint's frame in the arm's frame of that joint, a motion along and about
            the axis.
        off, turned: How far the flange lies from the nominal arm's, at most [m], [rad]; 0 if the robot is nominal.
    """

    model: UrModel
    T_base_arm: Array
    T_flange_tip: Array
    T_arm_joint: Array
    off: float
    turned: float

    @property
    def nominal(self) -> bool:
        """Whether the robot has the arm's nominal kinematics."""
        return self.off == self.turned == 0.0

    def chain_of(self, robot: Robot) -> Array:
        """The placements of a robot mounted so as those of the arm, shape (7, 4, 4), [m]."""
        at, back = self.T_arm_joint, rigid_inverse(self.T_arm_joint)
        P = robot.placements
        first = rigid_inverse(self.T_base_arm) @ rigid_inverse(robot.T_root_base) @ P[0] @ back[0]
        between = [at[i - 1] @ P[i] @ back[i] for i in range(1, 6)]
        return read_only([first, *between, at[5] @ P[6] @ rigid_inverse(self.T_flange_tip)])

    def placements_of(self, chain: Array, robot: Robot) -> Array:
        """The placements of the robot whose arm is this chain: the inverse of `chain_of`."""
        at, back = self.T_arm_joint, rigid_inverse(self.T_arm_joint)
        first = robot.T_root_base @ self.T_base_arm @ chain[0] @ at[0]
        between = [back[i - 1] @ chain[i] @ at[i] for i in range(1, 6)]
        return read_only([first, *between, back[5] @ chain[6] @ self.T_flange_tip])


def the_mount(robot: Robot, model: UrModel | None = None) -> Mount:
    """How a robot's frames are fixed to those of the arm that it is, or that it must be; `ModelError` if it is not."""
    wanted = MODELS if model is None else (model,)
    for T_base_arm, T_flange_tip in _named_frames(robot):
        arm = rigid_inverse(T_base_arm) @ robot.poses(SPREAD) @ rigid_inverse(T_flange_tip)
        apart = [(arm - chain_poses(chain_of_rows(one.rows), SPREAD))[:, :3] for one in wanted]
        nearest = min(range(len(wanted)), key=lambda i: float(np.abs(apart[i]).max()))
        most = float(np.abs(apart[nearest]).max())
        if most < _CALIBRATED:
            off = turned = near = 0.0
            if most > TOLERANCE:
                off = float(np.linalg.norm(apart[nearest][:, :, 3], axis=1).max())
                chord = np.linalg.norm(apart[nearest][:, :, :3], axis=(1, 2)).max() / np.sqrt(8.0)
                turned, near = 2.0 * float(np.arcsin(min(chord, 1.0))), _CALIBRATED
            frame, on_axes = T_base_arm, []
            chain = chain_of_rows(wanted[nearest].rows)
            for T, P, joint in zip(zero_poses(robot)[0], chain, robot.joints, strict=False):
                frame = frame @ P
                on_axes.append(_on_axis(rigid_inverse(frame) @ T, joint.axis, near))
            base, tip, joints = map(read_only, (T_base_arm, T_flange_tip, np.array(on_axes)))
            return Mount(wanted[nearest], base, tip, joints, off, turned)
    raise ModelError(
        f"The robot '{robot.name}' from '{robot.base}' to '{robot.tip}' is no "
        f"{model.name if model else 'arm of Universal Robots that calib knows'}: that has the joints {choices(JOINTS)} "
        "between base and tip, the link names of Universal Robots' description, and kinematics near the nominal ones."
    )


def distance_from(chain: Array, arm: UrModel) -> float:
    """How far the flange of a chain, shape (7, 4, 4), lies from that of the nominal arm, at most [m]."""
    nominal = chain_poses(chain_of_rows(arm.rows), SPREAD)
    moved = chain_poses(chain, SPREAD)[:, :3, 3] - nominal[:, :3, 3]
    return float(np.linalg.norm(moved, axis=1).max())


def _on_axis(T: Array, axis: Array, near: float) -> Array:
    """The pose Tz(s) Rz(phi) R nearest to T, where R turns the axis into z; no s below ``near``, phi a right angle."""
    seed = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = seed - axis * (axis @ seed)
    x = x / np.linalg.norm(x)
    R = np.stack([x, np.cross(axis, x), axis])
    turned = T[:3, :3] @ R.T
    phi = np.arctan2(turned[1, 0] - turned[0, 1], turned[0, 0] + turned[1, 1])
    right = np.round(phi / (np.pi / 2.0)) * np.pi / 2.0
    phi = right if abs(phi - right) < near else phi
    result = np.eye(4)
    result[:3, :3] = pin.rpy.rpyToMatrix(0.0, 0.0, float(phi)) @ R
    result[2, 3] = T[2, 3] if abs(T[2, 3]) >= near else 0.0
    return result


def _named_frames(robot: Robot) -> Iterator[tuple[Array, Array]]:
    """T_base_arm and T_flange_tip, every pair that the links' names allow, the robot's own base and tip first."""
    names = [joint.name for joint in robot.joints]
    prefix = names[0].removesuffix(JOINTS[0])
    if names != [prefix + joint for joint in JOINTS] or robot.joint_names != tuple(names):
        return
    zero = np.zeros(len(names))
    here = robot.poses(zero)[0]
    flanges = sorted(_FLANGES, key=lambda link: prefix + link != robot.tip)
    bases = sorted(_BASES, key=lambda base: prefix + base[0] != robot.base)
    for flange, (base, turned) in itertools.product(flanges, bases):
        try:
            at_flange = robot.rebuilt(tip=prefix + flange)
            arm = at_flange.rebuilt(base=prefix + base)
        except UrdfError:  # no such link, or no joint between them
            continue
        if [joint.name for joint in arm.joints] == names and not arm.base_moves:
            T_base_flange = at_flange.poses(zero)[0]
            T_base_link = T_base_flange @ rigid_inverse(arm.poses(zero)[0])
            T_flange_tip = rigid_inverse(T_base_flange) @ here
            yield T_base_link @ _HALF_TURN if turned else T_base_link, T_flange_tip
