"""Robots that are wrong in a known way: the truth of `verification_study.py`, made without `calib.estimate`.

Forward kinematics and gravity come from Pinocchio, on a model of the whole URDF that the true robot writes; the errors
of the joints' state and the poses that bring a target to a socket or a plane are computed here.
"""

from __future__ import annotations

import functools
import importlib.metadata
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.errors import UrdfError
from calib.model.error_model import error_model
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf

Array = NDArray[np.float64]

#: Where the target sits on the tip [m].
TARGET = (-0.06, 0.07, 0.03)

#: Sizes of the errors that are drawn [m, rad].
LENGTH, ANGLE = 0.5e-3, 3e-3

#: xyz and rpy of each joint's origin, then mass [kg] and centre of mass [m] of the link behind it, of a 14 kg iiwa.
_IIWA = (
    ((0.0, 0.0, 0.1575), (0.0, 0.0, 0.0), 4.0, (0.0, -0.03, 0.12)),
    ((0.0, 0.0, 0.2025), (np.pi / 2, 0.0, np.pi), 4.0, (0.0003, 0.059, 0.042)),
    ((0.0, 0.2045, 0.0), (np.pi / 2, 0.0, np.pi), 3.0, (0.0, 0.03, 0.13)),
    ((0.0, 0.0, 0.2155), (np.pi / 2, 0.0, 0.0), 2.7, (0.0, 0.067, 0.034)),
    ((0.0, 0.1845, 0.0), (-np.pi / 2, np.pi, 0.0), 1.7, (0.0001, 0.021, 0.076)),
    ((0.0, 0.0, 0.2155), (np.pi / 2, 0.0, 0.0), 1.8, (0.0, 0.0006, 0.0004)),
    ((0.0, 0.081, 0.0), (-np.pi / 2, np.pi, 0.0), 0.3, (0.0, 0.0, 0.02)),
)
_IIWA_LIMITS = np.deg2rad((170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 175.0))


def _text(values: tuple[float, ...]) -> str:
    """Numbers as an attribute holds them."""
    return " ".join(repr(float(v)) for v in values)


@functools.cache
def iiwa() -> Robot:
    """An arm of an iiwa 14's dimensions and masses, which example-robot-data does not have."""
    lines = ['<robot name="iiwa">', '<link name="base"/>']
    parent = "base"
    for i, (xyz, rpy, mass, com) in enumerate(_IIWA, start=1):
        limit = repr(float(_IIWA_LIMITS[i - 1]))
        lines += [
            f'<link name="link_{i}"><inertial><origin xyz="{_text(com)}"/><mass value="{mass}"/>',
            '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>',
            f'<joint name="joint_{i}" type="revolute"><parent link="{parent}"/><child link="link_{i}"/>',
            f'<origin xyz="{_text(xyz)}" rpy="{_text(rpy)}"/><axis xyz="0 0 1"/>',
            f'<limit lower="-{limit}" upper="{limit}" effort="300" velocity="1"/></joint>',
        ]
        parent = f"link_{i}"
    lines += [
        '<link name="flange"/><joint name="flange_joint" type="fixed"><parent link="link_7"/>',
        '<child link="flange"/><origin xyz="0 0 0.045"/></joint></robot>',
    ]
    return Robot.from_urdf(Urdf.from_bytes("\n".join(lines).encode(), "iiwa.urdf"))


@functools.cache
def ur3() -> Robot:
    """The UR3, `base` to `tool0`."""
    return Robot.load("ur3", base="base", tip="tool0")


@functools.cache
def panda() -> Robot:
    """The arm of the Panda."""
    return Robot.load("panda", base="panda_link0", tip="panda_link8")


ROBOTS: Mapping[str, Callable[[], Robot]] = {"ur3": ur3, "panda": panda, "iiwa": iiwa}


def example_files() -> dict[str, str]:
    """Path of every URDF of example-robot-data that holds a chain of two or more joints, by a short name."""
    found: dict[str, str] = {}
    for file in importlib.metadata.files("example-robot-data") or []:
        if file.suffix != ".urdf":
            continue
        path = str(file.locate())
        try:
            robot = Robot.load(path)
        except UrdfError as error:
            # Flying bases whose only joints are fixed, and files that are empty shells for xacro, hold no arm.
            if "has no <joint>" in str(error) or "no joint moves" in str(error):
                continue
            raise
        if len(robot.joints) >= 2:
            name = file.name.removesuffix(".urdf")
            found[name if name not in found else f"{name} ({file.parts[-3]})"] = path
    return dict(sorted(found.items()))


@dataclass(frozen=True, slots=True, eq=False)
class JointErrors:
    """Errors of the joints' state, shape (n,) each: gain, sine and cosine of the eccentricity, compliance [rad/Nm]."""

    gain: Array
    sin: Array
    cos: Array
    compliance: Array

    @classmethod
    def none(cls, count: int) -> JointErrors:
        """No error at all."""
        nothing = np.zeros(count)
        return cls(nothing, nothing, nothing, nothing)


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """A robot as it really is, and the targets on it.

    Attributes:
        nominal: What calib is given.
        x: shape (p,), the geometric errors.
        model: Name of the set that x belongs to.
        robot: The true geometry.
        targets: shape (T, 4, 4), T_tip_target [m].
        state: Errors of the joints' state.
        payload: Mass at the tip [kg].
        com: shape (3,), its centre of mass in the tip [m].
    """

    nominal: Robot
    x: Array
    model: str
    robot: Robot
    targets: Array
    state: JointErrors
    payload: float = 0.0
    com: Array = field(default_factory=lambda: np.zeros(3))
    _pin: pin.Model = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Build Pinocchio's model of the whole URDF."""
        model = pin.buildModelFromXML(self.robot.urdf.data.decode())
        frame = model.frames[model.getFrameId(self.robot.tip)]
        if self.payload:
            mass = pin.Inertia(self.payload, np.array(self.com), np.zeros((3, 3)))
            model.appendBodyToJoint(frame.parentJoint, mass, frame.placement)
        object.__setattr__(self, "_pin", model)

    @classmethod
    def draw(
        cls,
        nominal: Robot,
        rng: np.random.Generator,
        model: str = "dh",
        *,
        size: float = 1.0,
        targets: int = 1,
        rotation: bool = False,
        compliance: float = 0.0,
        payload: float = 0.0,
        com: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> Truth:
        """Errors drawn in a set of parameters: `LENGTH`, `ANGLE`, times size, and the same compliance on each joint."""
        parameters = error_model(nominal, model, target=False)
        sizes = np.where(np.array(parameters.units) == "m", LENGTH, ANGLE)
        x = size * sizes * rng.normal(size=len(parameters))
        T = np.tile(np.eye(4), (targets, 1, 1))
        T[:, :3, 3] = np.array(TARGET) + np.linspace(0.0, 0.1, targets)[:, None]
        T[:, :3, 3] += 5e-3 * rng.normal(size=(targets, 3))
        if rotation:
            T[:, :3, :3] = [pin.exp3(0.5 * rng.normal(size=3)) for _ in range(targets)]
        nothing = JointErrors.none(len(nominal.joints))
        state = JointErrors(
            nothing.gain, nothing.sin, nothing.cos, np.full(len(nominal.joints), compliance)
        )
        true = parameters.apply(nominal, x) if len(x) else nominal
        return cls(nominal, x, model, true, T, state, payload, np.array(com))

    def load(self, values: Mapping[str, Array]) -> Array:
        """Gravity's torque on each joint of the chain, shape (N, n), at joint values by name."""
        data = self._pin.createData()
        columns = [self._pin.idx_vs[self._pin.getJointId(j.name)] for j in self.robot.joints]
        return np.array(
            [
                -pin.computeGeneralizedGravity(self._pin, data, c)[columns]
                for c in self._configurations(values)
            ]
        )

    def joint_values(self, q: Array) -> dict[str, Array]:
        """Where every joint of the URDF really stands, shape (N,) each, when the controller reads q."""
        read = self.robot.urdf_values(q)
        state, names = self.state, [j.name for j in self.robot.joints]
        dq = {
            name: state.gain[i] * read[name]
            + state.sin[i] * np.sin(read[name])
            + state.cos[i] * np.cos(read[name])
            for i, name in enumerate(names)
        }
        true = {**read, **{name: read[name] + dq[name] for name in names}}
        if not np.any(state.compliance):
            return true
        for _ in range(4):  # the load where the arm has sagged to, not where it was told to go
            load = self.load(true)
            sag = load * state.compliance
            true = {
                **read,
                **{name: read[name] + dq[name] + sag[:, i] for i, name in enumerate(names)},
            }
        return true

    def poses(self, q: Array, target: int | NDArray[np.int_] = 0) -> Array:
        """T_base_target, shape (N, 4, 4), [m]."""
        model, data = self._pin, self._pin.createData()
        base, tip = (model.getFrameId(link) for link in (self.robot.base, self.robot.tip))
        which = np.broadcast_to(target, (len(q),))
        result = np.empty((len(q), 4, 4))
        for i, configuration in enumerate(self._configurations(self.joint_values(q))):
            pin.framesForwardKinematics(model, data, configuration)
            T = data.oMf[base].actInv(data.oMf[tip]).homogeneous
            result[i] = T @ self.targets[which[i]]
        return result

    def points(self, q: Array, target: int | NDArray[np.int_] = 0) -> Array:
        """The target in the base, shape (N, 3), [m]."""
        return self.poses(q, target)[:, :3, 3]

    def _configurations(self, values: Mapping[str, Array]) -> Array:
        """Pinocchio's configuration vectors, shape (N, nq)."""
        count = len(next(iter(values.values())))
        result = np.tile(pin.neutral(self._pin), (count, 1))
        for name, value in values.items():
            k = self._pin.getJointId(name)
            first = self._pin.idx_qs[k]
            if self._pin.nqs[k] == 2:
                result[:, first], result[:, first + 1] = np.cos(value), np.sin(value)
            else:
                result[:, first] = value
        return result

    def reach(self, normals: Array, heights: Array, q: Array) -> Array:
        """Joint values near q at which the target lies at some height along some directions; others are left out.

        Args:
            normals: shape (k, 3), directions in the base.
            heights: shape (N, k), the height of each row along them [m].
            q: shape (N, m), starts [rad].
        """
        q = q.copy()
        for _ in range(20):
            r = self.points(q) @ normals.T - heights
            if np.abs(r).max() < 1e-11:
                break
            J = normals @ self._slopes(q)
            JJ = J @ J.transpose(0, 2, 1) + 1e-9 * np.eye(len(normals))
            dq = -np.einsum("nkj,nk->nj", J, np.linalg.solve(JJ, r[:, :, None])[:, :, 0])
            q = q + dq * np.minimum(1.0, 0.3 / np.maximum(np.abs(dq).max(axis=1), 1e-12))[:, None]
        q = np.arctan2(np.sin(q), np.cos(q))
        off = np.abs(self.points(q) @ normals.T - heights).max(axis=1)
        there: Array = q[off < 1e-10]
        return there

    def _slopes(self, q: Array) -> Array:
        """How the first target moves with q, shape (N, 3, m) [m/rad]: what `reach` steps by, so nothing hangs on it."""
        model, data = self._pin, self._pin.createData()
        base, tip = (model.getFrameId(link) for link in (self.robot.base, self.robot.tip))
        columns = [model.idx_vs[model.getJointId(j.name)] for j in self.robot.joints]
        result = np.empty((len(q), 3, q.shape[1]))
        for i, configuration in enumerate(self._configurations(self.joint_values(q))):
            J = pin.computeFrameJacobian(model, data, configuration, tip, pin.ReferenceFrame.LOCAL)[
                :, columns
            ]
            pin.framesForwardKinematics(model, data, configuration)
            R_base_tip = data.oMf[base].rotation.T @ data.oMf[tip].rotation
            linear = J[:3] - pin.skew(self.targets[0, :3, 3]) @ J[3:]
            result[i] = R_base_tip @ linear @ self.robot.coupling
        return result


def joints_of(robot: Robot, count: int, rng: np.random.Generator) -> Array:
    """Random joint values inside the limits, shape (count, m)."""
    return random_joint_values(robot, count, int(rng.integers(2**31)))


def frame(rng: np.random.Generator) -> Array:
    """Where a tracker might stand: a pose of the base in it, shape (4, 4), [m]."""
    T = np.eye(4)
    T[:3, :3] = pin.exp3(rng.uniform(-2.0, 2.0, size=3))
    T[:3, 3] = rng.uniform(-2.0, 2.0, size=3)
    return T
