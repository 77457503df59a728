"""Arm: a robot with known errors as a function of its measured joints, and how its tool moves with them.

    T_base_tool(q) = T_root_base^-1  P_1 J_1(q_1 + dq_1) ... P_n J_n(q_n + dq_n)  P_tip  T_tip_tool

with the placements P of the geometry, and the joints' own errors dq(q) of `calib.model.joint_errors`. The nominal robot
is one, the calibrated robot another, and so is the robot with the larger model.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.identify.prediction import Larger
from calib.model.joint_errors import joint_displacements, slope_of
from calib.model.parameters import TIP, Parameter
from calib.model.robot import Robot, read_only, rigid_inverse
from calib.model.torques import Payload, gravity_load

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Arm:
    """A robot whose errors are known, with a tool.

    Attributes:
        robot: The robot whose joints these are.
        placements: shape (n + 1, 4, 4), of the joints and the tip, errors included [m].
        T_tip_tool: shape (4, 4), pose of the tool in the tip [m].
        terms: Errors that change with the joints' state.
        sizes: shape (len(terms),), their values.
        load: The load on each joint of the chain at joint values, shapes (N, m) to (N, n), [Nm, N]; None where no
            term needs it.
    """

    robot: Robot
    placements: Array
    T_tip_tool: Array
    terms: tuple[Parameter, ...] = ()
    sizes: Array = field(default_factory=lambda: read_only(np.zeros(0)))
    load: Callable[[Array], Array] | None = None
    _chain: pin.Model = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Build the chain once: following a path asks for it thousands of times."""
        object.__setattr__(self, "_chain", self.robot.chain_model(self.placements))

    @classmethod
    def of_robot(cls, robot: Robot, T_tip_tool: Array) -> Arm:
        """A robot as its URDF has it."""
        return cls(robot, robot.placements, read_only(T_tip_tool))

    @classmethod
    def of_larger(
        cls,
        larger: Larger,
        nominal: Robot,
        T_tip_tool: Array,
        payload: Payload | None = None,
    ) -> Arm:
        """A robot whose joints err with their state.

        Args:
            larger: The larger model of a result.
            nominal: The robot that the result began with.
            T_tip_tool: shape (4, 4), [m].
            payload: What the tip carries; None: what it carried when it was calibrated.

        Raises:
            ModelError: The robot's model has not the parameters that the result has values for.
        """
        model, x = larger.model, larger.x
        displacements, _ = model.displacements(x)
        order = [model.places.index(name) for name in (*(j.name for j in nominal.joints), TIP)]
        chosen = list(model.joint_terms)
        terms = tuple(model.terms[t] for t in chosen)
        weight = payload or larger.payload
        loaded = any(term.factor and term.factor.loaded for term in terms)
        return cls(
            robot=nominal,
            placements=read_only(nominal.placements @ displacements[order]),
            T_tip_tool=read_only(T_tip_tool),
            terms=terms,
            sizes=read_only(model.values(x)[chosen]),
            load=(lambda q: gravity_load(nominal, q, weight, larger.gravity)) if loaded else None,
        )

    def poses(self, q: Array) -> Array:
        """T_base_tool at joint values of shape (N, m), [rad] or [m]; shape (N, 4, 4), [m]."""
        return self.motion(q)[0]

    def motion(self, q: Array) -> tuple[Array, Array]:
        """T_base_tool, and the tool's velocity in a unit of each measured joint.

        How the load changes with q is left out of the velocity: it is a part in a thousand of it, and costs an
        iteration where joint values are looked for, no accuracy.

        Args:
            q: shape (N, m), [rad] or [m], in the order of ``robot.joint_names``.

        Returns:
            shape (N, 4, 4), [m]; and shape (N, 6, m), twists along the tool's own axes, linear first [m or rad per
            rad or m].

        Raises:
            ModelError: ``q`` has not one column for each joint, or a value is not finite.
        """
        values = self.robot.chain_values(q)
        if self.terms:
            load = None if self.load is None else self.load(q)
            values = values + joint_displacements(self.robot, self.terms, q, load) @ self.sizes
        T_root_last, jacobian = self._last_joint(self.robot.configurations(values))
        T_last_tool = self.placements[-1] @ self.T_tip_tool
        poses = rigid_inverse(self.robot.T_root_base) @ T_root_last @ T_last_tool
        jacobian = pin.SE3(T_last_tool).toActionMatrixInverse() @ jacobian
        return poses, jacobian @ self._slopes(q)

    def _last_joint(self, configurations: Array) -> tuple[Array, Array]:
        """The last joint's pose in the chain's root, (N, 4, 4), and its Jacobian along its own axes, (N, 6, n)."""
        chain, data = self._chain, self._chain.createData()
        last = chain.njoints - 1
        pose = data.oMi[last]  # as Pinocchio writes it
        poses = np.empty((len(configurations), 4, 4))
        jacobians = np.empty((len(configurations), 6, chain.nv))
        for i, configuration in enumerate(configurations):
            pin.computeJointJacobians(chain, data, configuration)
            poses[i] = pose.homogeneous
            jacobians[i] = pin.getJointJacobian(chain, data, last, pin.LOCAL)
        return poses, jacobians

    def _slopes(self, q: Array) -> Array:
        """How the chain's joints move with the measured ones, shape (n, m) or (N, n, m)."""
        coupling = self.robot.coupling
        if not any(term.factor and term.factor.slope for term in self.terms):
            return coupling
        names = self.robot.joint_names
        own = np.ones((len(q), len(names)))
        for term, size in zip(self.terms, self.sizes, strict=True):
            if term.factor and term.factor.slope:
                own[:, names.index(term.place)] += size * slope_of(self.robot, term, q, None)
        return coupling * own[:, None, :]
