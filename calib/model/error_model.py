"""The one error model: every error is a small displacement of a placement, times a parameter.

A parameter x_k has a *place* (one of the chain's placements, the measurement frame or the target) and a
*direction*, a twist xi_k in the local frame of that place, linear part first. The displaced placement is

    P' = P exp(xi_1 x_1) exp(xi_2 x_2) ...

in the order of the parameters. Along the x axis of a DH frame this is exactly an offset of a or alpha, along
the joint's axis one of d or theta, so that DH offsets are injected without approximation; and the Jacobian
of any parameter is Pinocchio's placement regressor times its direction, carried past the factors after it:

    dP'/dx_k = P' [Ad(exp(xi_(k+1) x_(k+1)) ...)^-1 xi_k]

Errors that change with the joints' state (`calib.model.families`) act about the joint's own axis, times a known
number of that state: the same columns of the regressor, times that number.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.errors import ModelError, choices
from calib.model.dh import dh_frames, dh_table, zero_poses
from calib.model.families import ANGLE, LENGTH, ZERO, family_of, joint_families
from calib.model.parameters import (
    FRAME,
    TARGET,
    TIP,
    ErrorModel,
    Parameter,
    frame_place,
    target_place,
)
from calib.robot.robot import Robot, read_only, rigid_inverse

Array = NDArray[np.float64]

#: The six directions of a frame or a placement.
DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")

#: The set-up that a table without groups has, and its frame's unknowns.
_ONE_FRAME: Mapping[str, tuple[str, ...]] = {"": DIRECTIONS}

#: The name of a set of parameters that was given, not named.
OWN = "own"

#: An axis within this of a coordinate axis is one [rad].
_ALIGNED = 1e-6


def error_model(
    robot: Robot,
    name: str | Sequence[Parameter],
    *,
    frame: bool | Mapping[str, Sequence[str]] = False,
    target: bool | Sequence[str] = True,
    targets: Sequence[str] = ("",),
    rotation: bool = False,
) -> ErrorModel:
    """A named set of parameters for a robot.

    Args:
        robot: The nominal robot.
        name: ``paper`` or ``dh`` (a, alpha, d, theta of each DH row), ``hayati`` (beta in place of d where axes are
            nearly parallel), ``placement`` (all six of each joint), ``zeros`` (the joint zeros only) or ``frames``
            (no error of the robot at all); behind it, each with a "+", any of the families of the
            joints' state (`families`): ``"dh+compliance"``. Or the robot's own parameters themselves, each a
            twist at a placement: a set called `OWN`.
        frame: Whether the measurement frame is estimated too: True for all six parameters of the one frame, or for
            each set-up which of `DIRECTIONS` are (none for a frame that is known).
        target: Whether the targets are, or the names of those that are.
        targets: The names of all targets; "" for the only one.
        rotation: Whether the targets are frames, of which six parameters are estimated, or points.

    Raises:
        ModelError: No such set or family; or ``paper`` with an unknown frame, which the paper does not have.

    Example:
        >>> len(error_model(Robot.load("ur3", base="base", tip="tool0"), "paper"))
        27
    """
    own = None if isinstance(name, str) else tuple(name)
    name = name if isinstance(name, str) else OWN
    base, families = (OWN, ()) if own is not None else split_name(name)
    frames = (_ONE_FRAME if frame else {"": ()}) if isinstance(frame, bool) else frame
    if base == "paper" and any(frames.values()):
        raise ModelError(
            "The parameter set 'paper' knows the measurement frame, as the paper does. To estimate the frame too, "
            "choose --model dh."
        )
    estimated = (targets if target else ()) if isinstance(target, bool) else target
    of_frames = tuple((group, tuple(directions)) for group, directions in frames.items())
    return _assembled(
        robot, name, base, families, of_frames, tuple(estimated), tuple(targets), rotation, own
    )


@lru_cache(maxsize=64)
def _assembled(
    robot: Robot,
    name: str,
    base: str,
    families: tuple[str, ...],
    frames: tuple[tuple[str, tuple[str, ...]], ...],
    estimated: tuple[str, ...],
    targets: tuple[str, ...],
    rotation: bool,
    own: tuple[Parameter, ...] | None,
) -> ErrorModel:
    """`error_model` of arguments that can be remembered: folds, candidates and trials ask for the same ones."""
    parameters = [*(_own_parameters(robot, base) if own is None else own)]
    for family in families:
        parameters += joint_parameters(robot, family)
    placed = frame_and_target_model(
        dict(frames), estimated, known_targets=targets, rotation=rotation
    )
    count = len(frames)
    joints = tuple(joint.name for joint in robot.joints)
    places = (*placed.places[:count], *joints, *placed.places[count:])
    parameters += placed.parameters
    model = ErrorModel(name, places, tuple(parameters))
    return model.tied(_followers(robot)) if base == "zeros" else model


def frame_and_target_model(
    frames: Mapping[str, Sequence[str]],
    targets: Sequence[str],
    *,
    known_targets: Sequence[str] = (),
    rotation: bool = False,
) -> ErrorModel:
    """The parameters of frames and targets alone, for a tip whose poses are given.

    Args:
        frames: For each set-up which of `DIRECTIONS` are estimated.
        targets: Names of the targets that are estimated.
        known_targets: Names of all targets, in the order of their places.
        rotation: Whether targets are frames or points.
    """
    parameters: list[Parameter] = []
    for group, directions in frames.items():
        parameters += _placed("frame", frame_place(group), group, directions, FRAME)
    for one in targets:
        directions = DIRECTIONS if rotation else DIRECTIONS[:3]
        parameters += _placed("target", target_place(one), one, directions, TARGET)
    every = known_targets or targets
    places = (*(frame_place(g) for g in frames), TIP, *(target_place(one) for one in every))
    return ErrorModel("frames", places, tuple(parameters))


def _followers(robot: Robot) -> dict[str, tuple[str, float]]:
    """The zeros of joints that follow one column: all move with that of its driver, by their multipliers.

    Where the driver lies outside the chain, or slides while its follower turns, the first that follows leads.
    """
    slides = [joint.type == "prismatic" for joint in robot.joints]
    names = [joint.name for joint in robot.joints]
    ties = {}
    for column, driver in enumerate(robot.joint_names):
        for kind in (False, True):
            moved = [i for i in np.flatnonzero(robot.coupling[:, column]) if slides[i] == kind]
            leader = next((i for i in moved if names[i] == driver), moved[0] if moved else -1)
            for i in moved:
                if i != leader:
                    factor = robot.coupling[i, column] / robot.coupling[leader, column]
                    ties[f"{names[i]}.zero"] = (f"{names[leader]}.zero", float(factor))
    return ties


def split_name(name: str) -> tuple[str, tuple[str, ...]]:
    """A model's set and the families added to it: ``"dh+gain"`` is ``("dh", ("gain",))``.

    Raises:
        ModelError: No such set or family, or one twice.
    """
    base, *families = (part.strip() for part in name.split("+"))
    if base not in MODELS:
        raise ModelError(
            f"There is no parameter set '{base}'. Choose one of {choices(MODELS)}, and behind it, each with a '+', "
            f"any of {choices(joint_families())}."
        )
    wrong = [f for f in families if f not in joint_families() or families.count(f) > 1]
    if wrong:
        raise ModelError(
            f"'{name}' adds {choices(dict.fromkeys(wrong))} to the set '{base}'; what can be added, each once, is "
            f"{choices(joint_families())}."
        )
    return base, tuple(families)


def placed_name(what: str, direction: str, name: str) -> str:
    """The name of a parameter of a frame or target: ``"target_x"``, or ``"target_x[left]"`` of one by name."""
    return f"{what}_{direction}[{name}]" if name else f"{what}_{direction}"


def _placed(
    what: str, place: str, name: str, directions: Sequence[str], family: str
) -> list[Parameter]:
    """Some of the six parameters of a frame or target."""
    return [
        Parameter(
            placed_name(what, direction, name),
            "m" if k < 3 else "rad",
            place,
            _unit_twist(k),
            family,
        )
        for k, direction in enumerate(DIRECTIONS)
        if direction in directions
    ]


def _dh_parameters(robot: Robot, *, hayati: bool = False) -> list[Parameter]:
    """a_i, alpha_i (beta_i), d_i, theta_i of each row, row by row.

    a_i and alpha_i act on the placement after joint i, d_i and theta_i on that of joint i or, at a base that moves
    without an <origin>, behind it too. Where the tip's placement is not carried by the URDF the last row's a and
    alpha are left out: the target takes their place.
    """
    table = dh_table(robot)
    joints = [joint.name for joint in robot.joints]
    places = [*joints[1:], TIP]
    T_base_joint, T_base_tip = zero_poses(robot)
    parameters = []
    for i, (row, frame) in enumerate(zip(table.rows, dh_frames(table), strict=True)):
        number, axis = i + 1, np.asarray(robot.joints[i].axis)
        parallel = hayati and row.near_parallel and i + 1 < len(table.rows)
        behind, own = [], []
        if robot.carriers[i + 1] is not None:
            T_local_frame = rigid_inverse([*T_base_joint, T_base_tip][i + 1]) @ frame
            along, about = _screw_twists(T_local_frame, 0)
            behind += [
                Parameter(f"a{number}", "m", places[i], along, LENGTH, row.a),
                Parameter(f"alpha{number}", "rad", places[i], about, ANGLE, row.alpha),
            ]
            if parallel:
                _, about_y = _screw_twists(T_local_frame @ _rotation_y(row.beta), 1)
                behind.append(
                    Parameter(f"beta{number}", "rad", places[i], about_y, ANGLE, row.beta)
                )
        if not parallel:
            along = read_only(np.concatenate([axis, np.zeros(3)]))
            own.append(_before_joint(robot, i, f"d{number}", "m", along, LENGTH, row.d))
        about = read_only(np.concatenate([np.zeros(3), axis]))
        family = ANGLE if row.prismatic else ZERO
        own.append(_before_joint(robot, i, f"theta{number}", "rad", about, family, row.theta))
        # Where d and theta act at the same place as a and alpha, they come first, as in the row's product.
        parameters += behind + own if robot.carriers[i] is not None else own + behind
    return parameters


def _before_joint(
    robot: Robot,
    i: int,
    name: str,
    unit: str,
    direction: Array,
    family: str,
    nominal: float = 0.0,
) -> Parameter:
    """A displacement along or about a joint's own axis, at its placement.

    Where no <origin> carries that placement (a base that its joint moves directly), at the next one: such a
    displacement passes through the joint's motion unchanged.
    """
    if robot.carriers[i] is not None:
        return Parameter(name, unit, robot.joints[i].name, direction, family, nominal)
    following = robot.joints[i + 1].name if i + 1 < len(robot.joints) else TIP
    behind = pin.SE3(robot.placements[i + 1]).toActionMatrixInverse() @ direction
    return Parameter(name, unit, following, read_only(behind), family, nominal)


def _hayati_parameters(robot: Robot) -> list[Parameter]:
    """The DH parameters with beta in place of d where axes are nearly parallel."""
    return _dh_parameters(robot, hayati=True)


def _placement_parameters(robot: Robot) -> list[Parameter]:
    """All six directions of each joint's placement, named ``<joint>.x`` to ``<joint>.rz``.

    Of the rotations that about the joint's own axis is its zero; an axis that is none of the frame's gets a seventh
    parameter, ``<joint>.zero``.
    """
    parameters = []
    for i, joint in enumerate(robot.joints):
        if robot.carriers[i] is None:
            continue  # moved by its joint directly: what can be known of it is in the next one
        turns = joint.type != "prismatic"
        own = int(np.argmax(np.abs(joint.axis)))
        aligned = abs(abs(joint.axis[own]) - 1.0) < 0.5 * _ALIGNED**2
        for k, direction in enumerate(DIRECTIONS):
            family = LENGTH if k < 3 else ZERO if turns and aligned and k == 3 + own else ANGLE
            unit = "m" if k < 3 else "rad"
            parameters.append(
                Parameter(f"{joint.name}.{direction}", unit, joint.name, _unit_twist(k), family)
            )
        if turns and not aligned:
            twist = axis_twists(robot)[i]
            parameters.append(Parameter(f"{joint.name}.zero", "rad", joint.name, twist, ZERO))
    return parameters


def _zero_parameters(robot: Robot) -> list[Parameter]:
    """The zero of each joint, named ``<joint>.zero``: about its axis, or along it for a prismatic one.

    Joints that follow another one have none of their own: their driver's moves them too.
    """
    parameters = []
    twists = axis_twists(robot)
    for i, joint in enumerate(robot.joints):
        unit, family = ("m", LENGTH) if joint.type == "prismatic" else ("rad", ZERO)
        name = f"{joint.name}.zero"
        parameters.append(_before_joint(robot, i, name, unit, read_only(twists[i]), family))
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


@lru_cache(maxsize=16)
def _own_parameters(robot: Robot, base: str) -> tuple[Parameter, ...]:
    """A robot's own parameters; a calibration asks for the same ones for each model and each fold."""
    return tuple(MODELS[base](robot))


def _unit_twist(k: int) -> Array:
    """The k-th unit twist, linear first."""
    return read_only(np.eye(6)[k])


def _screw_twists(T: Array, axis: int) -> tuple[Array, Array]:
    """The twists along and about one axis of frame T, in the frame that T is given in."""
    direction, origin = T[:3, axis], T[:3, 3]
    along = np.concatenate([direction, np.zeros(3)])
    about = np.concatenate([np.cross(origin, direction), direction])
    return read_only(along), read_only(about)


def _rotation_y(angle: float) -> Array:
    """The rotation about y as a pose, shape (4, 4)."""
    T = np.eye(4)
    T[:3, :3] = pin.rpy.rpyToMatrix(0.0, angle, 0.0)
    return T


def joint_parameters(robot: Robot, family: str) -> list[Parameter]:
    """The parameters of one family of the joints' state, named ``<joint>.gain`` and so on.

    Raises:
        ModelError: No such family, or one of the geometry.
    """
    row = family_of(family)
    if row.geometric:
        raise ModelError(
            f"'{family}' is a family of the geometry: it belongs to a parameter set, and cannot be added to one."
        )
    parameters = []
    for joint in robot.joints if row.every_joint else robot.inputs:
        slides = joint.type == "prismatic"
        unit = row.sliding if slides else row.unit
        if unit is None:
            continue
        twist = _axis_twist(joint.axis, slides=slides)
        parameters += [
            Parameter(
                f"{joint.name}.{factor.name}",
                unit.symbol,
                joint.name,
                twist,
                family,
                factor=factor,
            )
            for factor in row.factors
        ]
    return parameters


def axis_twists(robot: Robot) -> Array:
    """The twist of a unit of each joint of the chain, in its own frame, shape (n, 6)."""
    return read_only(
        [_axis_twist(joint.axis, slides=joint.type == "prismatic") for joint in robot.joints]
    )


def _axis_twist(axis: Array, *, slides: bool) -> Array:
    """The twist of a unit of a joint."""
    nothing = np.zeros(3)
    return read_only(np.concatenate([axis, nothing] if slides else [nothing, axis]))
