"""The one error model: every error is a small displacement of a placement, times a parameter.

A parameter x_k has a *place* (one of the chain's placements, the measurement frame or the target) and a
*direction*, a twist xi_k in the local frame of that place, linear part first. The displaced placement is

    P' = P exp(xi_1 x_1) exp(xi_2 x_2) ...

in the order of the parameters. Along the x axis of a DH frame this is exactly an offset of a or alpha, along
the joint's axis one of d or theta, so that DH offsets are injected without approximation; and the Jacobian
of any parameter is Pinocchio's placement regressor times its direction, carried past the factors after it:

    dP'/dx_k = P' [Ad(exp(xi_(k+1) x_(k+1)) ...)^-1 xi_k]
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.errors import ModelError, choices
from calib.model.dh import dh_frames, dh_table, zero_poses
from calib.model.robot import Robot, read_only, rigid_inverse

#: The places that are not the chain's own.
FRAME, TIP, TARGET = "frame", "tip", "target"

#: The families of parameters, which share the size of their prior; frame and target have none.
LENGTH, ANGLE = "length", "angle"

#: A placement that is displaced by less than this stays as it is, and so does its <origin> [m, rad].
_UNMOVED = 1e-12

_TWIST_AXES = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True, slots=True, eq=False)
class Parameter:
    """One error: a direction at a place.

    Attributes:
        name: Unique, such as ``"d1"``, ``"elbow_joint.rx"`` or ``"target_x"``.
        unit: "m" or "rad".
        place: A joint's name, or `FRAME`, `TIP`, `TARGET`.
        direction: shape (6,), twist in the place's local frame, linear then angular, of a unit of the parameter.
        family: `LENGTH`, `ANGLE`, `FRAME` or `TARGET`.
        nominal: The value that the parameter adds to, in its unit: the DH table's, or 0. A target's is where
            the cell says it is.
    """

    name: str
    unit: str
    place: str
    direction: NDArray[np.float64]
    family: str
    nominal: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class ErrorModel:
    """A named list of parameters for one chain.

    Attributes:
        name: The set's name, such as ``"dh"``.
        places: All places in order: the frame, the joints, the tip, the target.
        parameters: In the order of the parameter vector x.
    """

    name: str
    places: tuple[str, ...]
    parameters: tuple[Parameter, ...]

    def __post_init__(self) -> None:
        """Refuse a name twice and a place that the chain lacks."""
        names = self.names
        doubled = sorted({name for name in names if names.count(name) > 1})
        if doubled:
            message = f"Parameters {choices(doubled)} appear twice in the model '{self.name}'; names must differ."
            raise ModelError(message)
        unknown = sorted({p.place for p in self.parameters} - set(self.places))
        if unknown:
            message = f"The chain has no places {choices(unknown)}; it has {choices(self.places)}."
            raise ModelError(message)

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters' names in order."""
        return tuple(p.name for p in self.parameters)

    def __len__(self) -> int:
        """The number of parameters."""
        return len(self.parameters)

    def family(self, name: str) -> NDArray[np.bool_]:
        """Which parameters belong to a family, shape (p,)."""
        return np.array([p.family == name for p in self.parameters], dtype=bool)

    def index(self, name: str) -> int:
        """The position of a parameter in x.

        Raises:
            ModelError: No such parameter.
        """
        if name not in self.names:
            message = f"The model '{self.name}' has no parameter '{name}'; it has {choices(self.names, limit=60)}."
            raise ModelError(message)
        return self.names.index(name)

    def without(self, names: Iterable[str]) -> ErrorModel:
        """The model with these parameters frozen at their nominal values.

        Raises:
            ModelError: No such parameter.
        """
        gone = {self.index(name) for name in names}
        kept = tuple(p for k, p in enumerate(self.parameters) if k not in gone)
        return ErrorModel(self.name, self.places, kept)

    def displacements(
        self, x: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
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
        if np.shape(x) != (len(self.parameters),):
            message = (
                f"A parameter vector of shape {np.shape(x)} was given; the model '{self.name}' has "
                f"{len(self.parameters)} parameters: {choices(self.names)}."
            )
            raise ModelError(message)
        products: dict[str, pin.SE3] = {}
        directions = np.zeros((6 * len(self.places), len(self.parameters)))
        row = {place: 6 * k for k, place in enumerate(self.places)}
        # Backwards, so that the product of the factors after each parameter is at hand.
        for k in range(len(self.parameters) - 1, -1, -1):
            parameter = self.parameters[k]
            later = products.get(parameter.place)
            first, factor = row[parameter.place], pin.exp6(parameter.direction * x[k])
            if later is None:
                directions[first : first + 6, k] = parameter.direction
                products[parameter.place] = factor
            else:
                directions[first : first + 6, k] = (
                    later.toActionMatrixInverse() @ parameter.direction
                )
                products[parameter.place] = factor * later
        displacements = np.tile(np.eye(4), (len(self.places), 1, 1))
        for k, place in enumerate(self.places):
            if place in products:
                displacements[k] = products[place].homogeneous
        return displacements, directions

    def apply(self, robot: Robot, x: NDArray[np.float64]) -> Robot:
        """The robot with its placements displaced; frame and target are no part of a robot.

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
        for i, place in enumerate((*robot.joint_names, TIP)):
            factor = displacement[self.places.index(place)]
            if np.abs(factor - np.eye(4)).max() > _UNMOVED:
                placements[i] = placements[i] @ factor
        return robot.with_placements(placements)


def error_model(robot: Robot, name: str, *, frame: bool = False, target: bool = True) -> ErrorModel:
    """A named set of parameters for a robot.

    Args:
        robot: The nominal robot.
        name: ``paper`` or ``dh`` (a, alpha, d, theta of each DH row), ``hayati`` (beta in place of d where axes are
            nearly parallel), ``placement`` (all six of each joint), ``zeros`` (the joint zeros only) or ``frames``
            (no error of the robot at all).
        frame: Whether the six parameters of the measurement frame are estimated too.
        target: Whether the three of the target point are.

    Raises:
        ModelError: No such set; or ``paper`` with an unknown frame, which the paper does not have.

    Example:
        >>> len(error_model(Robot.load("ur3", base="base", tip="tool0"), "paper"))
        27
    """
    if name not in MODELS:
        message = f"There is no parameter set '{name}'. Choose one of {choices(MODELS)}."
        raise ModelError(message)
    if name == "paper" and frame:
        message = (
            "The parameter set 'paper' knows the measurement frame, as the paper does. To estimate the frame too, "
            "choose --model dh."
        )
        raise ModelError(message)
    parameters = list(MODELS[name](robot))
    if frame:
        parameters += [
            Parameter(f"frame_{axis}", unit, FRAME, _unit_twist(k), FRAME)
            for k, (axis, unit) in enumerate(zip(_TWIST_AXES, ["m"] * 3 + ["rad"] * 3, strict=True))
        ]
    if target:
        parameters += [
            Parameter(f"target_{axis}", "m", TARGET, _unit_twist(k), TARGET)
            for k, axis in enumerate("xyz")
        ]
    return ErrorModel(name, (FRAME, *robot.joint_names, TIP, TARGET), tuple(parameters))


def _dh_parameters(robot: Robot, *, hayati: bool = False) -> list[Parameter]:
    """a_i, alpha_i (beta_i), d_i, theta_i of each row, row by row.

    a_i and alpha_i act on the placement after joint i. Where the tip's placement is not carried by the URDF the
    last row's a and alpha are left out: the target takes their place.
    """
    table = dh_table(robot)
    places = [*robot.joint_names[1:], TIP]
    T_base_joint, T_base_tip = zero_poses(robot)
    parameters = []
    for i, (row, frame) in enumerate(zip(table.rows, dh_frames(table), strict=True)):
        number, axis = i + 1, np.asarray(robot.joints[i].axis)
        parallel = hayati and row.near_parallel and i + 1 < len(table.rows)
        if robot.carriers[i + 1] is not None:
            T_local_frame = rigid_inverse([*T_base_joint, T_base_tip][i + 1]) @ frame
            along, about = _screw_twists(T_local_frame, 0)
            parameters += [
                Parameter(f"a{number}", "m", places[i], along, LENGTH, row.a),
                Parameter(f"alpha{number}", "rad", places[i], about, ANGLE, row.alpha),
            ]
            if parallel:
                _, about_y = _screw_twists(T_local_frame @ _rotation_y(row.beta), 1)
                parameters.append(
                    Parameter(f"beta{number}", "rad", places[i], about_y, ANGLE, row.beta)
                )
        if not parallel:
            along = read_only(np.concatenate([axis, np.zeros(3)]))
            parameters.append(
                Parameter(f"d{number}", "m", robot.joint_names[i], along, LENGTH, row.d)
            )
        about = read_only(np.concatenate([np.zeros(3), axis]))
        parameters.append(
            Parameter(f"theta{number}", "rad", robot.joint_names[i], about, ANGLE, row.theta)
        )
    return parameters


def _hayati_parameters(robot: Robot) -> list[Parameter]:
    """The DH parameters with beta in place of d where axes are nearly parallel."""
    return _dh_parameters(robot, hayati=True)


def _placement_parameters(robot: Robot) -> list[Parameter]:
    """All six directions of each joint's placement, named ``<joint>.x`` to ``<joint>.rz``."""
    return [
        Parameter(
            f"{joint}.{axis}",
            "m" if k < 3 else "rad",
            joint,
            _unit_twist(k),
            LENGTH if k < 3 else ANGLE,
        )
        for joint in robot.joint_names
        for k, axis in enumerate(_TWIST_AXES)
    ]


def _zero_parameters(robot: Robot) -> list[Parameter]:
    """The zero of each joint, named ``<joint>.zero``: about its axis, or along it for a prismatic one."""
    parameters = []
    for joint in robot.joints:
        axis, nothing = np.asarray(joint.axis), np.zeros(3)
        slides = joint.type == "prismatic"
        direction = read_only(np.concatenate([axis, nothing] if slides else [nothing, axis]))
        unit, family = ("m", LENGTH) if slides else ("rad", ANGLE)
        parameters.append(Parameter(f"{joint.name}.zero", unit, joint.name, direction, family))
    return parameters


def _no_parameters(robot: Robot) -> list[Parameter]:  # noqa: ARG001
    """No error of the robot: frame and target alone."""
    return []


#: The named sets of a robot's own parameters.
MODELS: dict[str, Callable[[Robot], list[Parameter]]] = {
    "paper": _dh_parameters,
    "dh": _dh_parameters,
    "hayati": _hayati_parameters,
    "placement": _placement_parameters,
    "zeros": _zero_parameters,
    "frames": _no_parameters,
}


def _unit_twist(k: int) -> NDArray[np.float64]:
    """The k-th unit twist, linear first."""
    return read_only(np.eye(6)[k])


def _screw_twists(
    T: NDArray[np.float64], axis: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The twists along and about one axis of frame T, in the frame that T is given in."""
    direction, origin = T[:3, axis], T[:3, 3]
    along = np.concatenate([direction, np.zeros(3)])
    about = np.concatenate([np.cross(origin, direction), direction])
    return read_only(along), read_only(about)


def _rotation_y(angle: float) -> NDArray[np.float64]:
    """The rotation about y as a pose, shape (4, 4)."""
    T = np.eye(4)
    T[:3, :3] = pin.rpy.rpyToMatrix(0.0, angle, 0.0)
    return T
