"""The one error model: every error is a small displacement of a placement, times a parameter.

A parameter x_k has a *place* (one of the chain's placements, the measurement frame or the target) and a *direction*, a
twist xi_k in the local frame of that place, linear part first. The displaced placement and its derivative are

    P' = P exp(xi_1 x_1) exp(xi_2 x_2) ...        dP'/dx_k = P' [Ad(exp(xi_(k+1) x_(k+1)) ...)^-1 xi_k]

Along the x axis of a DH frame this is exactly an offset of a or alpha, along the joint's axis one of d or theta. Errors
of the joints' state (`calib.model.families`) act about the joint's own axis, times a known number of that state.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache, partial

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

import calib.basics.plugins as plugins
from calib.basics.arguments import check_type
from calib.basics.arrays import Array, read_only, rigid_inverse
from calib.errors import ModelError, choices, did_you_mean
from calib.model.dh_table import dh_table, zero_poses
from calib.model.error_model import (
    FRAME,
    MOUNT,
    TARGET,
    TIP,
    ErrorModel,
    Parameter as Parameter,
    twist_of,
)
from calib.model.families import ANGLE, LENGTH, ZERO, joint_families
from calib.model.joint_errors import axis_twists, joint_parameters
from calib.robot.dh_rows import dh_frames, screw
from calib.robot.gravity import GRAVITY
from calib.robot.robot import Robot

#: The six directions of a frame or a placement: along, then about its axes.
DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")

#: The unit of a parameter in each direction.
_UNITS = {"x": "m", "y": "m", "z": "m", "rx": "rad", "ry": "rad", "rz": "rad"}

#: The unit twist in each direction, shape (6,), linear then angular.
_TWISTS = {direction: read_only(row) for direction, row in zip(DIRECTIONS, np.eye(6), strict=True)}

#: The name of a set of parameters that was given as parameters, not by its name.
OWN = "own"

#: Names that no set may have: ``auto``, the choice by the data, and `OWN`.
_RESERVED = ("auto", OWN)

#: Sets whose parameters are those of numbered DH rows, of which a tree has none.
OF_ONE_CHAIN = ("paper", "dh", "hayati")

#: An axis within this angle of a coordinate axis counts as that [rad].
_ALIGNED = 1e-6


def error_model(
    robot: Robot,
    name: str | Sequence[Parameter],
    *,
    frame: bool | Mapping[str, Sequence[str]] = False,
    target: bool | Sequence[str] | Mapping[str, Sequence[str]] = True,
    targets: Sequence[str] = ("",),
    rotation: bool = False,
    gravity: ArrayLike = GRAVITY,
    further: Sequence[Parameter] = (),
) -> ErrorModel:
    """Return a named set of parameters for a robot, its measurement frames and its targets.

    Args:
        robot: The nominal robot.
        name: ``paper`` or ``dh`` (a, alpha, d, theta of each DH row), ``hayati`` (beta in place of d between nearly
            parallel axes), ``placement`` (all six of each joint), ``zeros`` (the joint zeros only) or ``frames`` (no
            error of the robot at all); after it, each with a "+", any of the families of the joints' state:
            ``"dh+compliance"``. Or the robot's own parameters themselves: a set called `OWN`.
        frame: True to estimate all six parameters of the one measurement frame; or for each station which of
            `DIRECTIONS` are estimated (none for a frame that is known).
        target: True to estimate all targets, or the names of those that are estimated, or which of `DIRECTIONS` are
            estimated of each of them.
        targets: The names of all targets; "" for the only one.
        rotation: True if targets are frames, of which six parameters are estimated; False for points. Not used where
            ``target`` has the directions.
        gravity: Shape (3,), acceleration in the URDF's root [m/s^2]; the family ``gravity`` leaves out what it cannot
            bend.
        further: Further parameters, of cameras and boards, which come last.

    Raises:
        ArgumentError: ``name`` is neither a text nor a sequence of parameters.
        ModelError: No such set or family; a name of a parameter that occurs twice; or ``paper`` with an unknown frame,
            which the paper does not have.

    Example:
        >>> len(error_model(Robot.load("ur3", base="base", tip="tool0"), "paper"))
        27
    """
    if isinstance(frame, bool):
        frame = {"": DIRECTIONS if frame else ()}
    if isinstance(target, bool):
        target = targets if target else ()
    if isinstance(name, str):
        set_name, _ = split_name(name)
        acceleration = tuple(np.asarray(gravity, dtype=np.float64).tolist())
        robot_parameters = _robot_parameters(robot, name, acceleration)
    else:
        set_name = OWN
        allowed = "the name of a model, or a sequence of Parameters"
        check_type("model", name, Sequence, allowed)
        for parameter in name:
            check_type("model", parameter, Parameter, allowed)
        robot_parameters = tuple(name)
    if set_name == "paper" and any(frame.values()):
        raise ModelError(
            "The parameter set 'paper' knows the measurement frame, as the paper does. To estimate the frame too, "
            "choose --model dh."
        )
    outer = frame_and_target_model(frame, target, targets, rotation=rotation)
    joints = tuple(joint.name for joint in robot.all_joints)
    mounts = [
        Parameter(
            name=placed_name("mount", direction, part.name),
            unit=_UNITS[direction],
            place=part.mount,
            direction=_TWISTS[direction],
            family=MOUNT,
        )
        for part in robot.parts
        if part.mount in robot.mounts
        for direction in DIRECTIONS
    ]
    model = ErrorModel(
        name=name if isinstance(name, str) else OWN,
        places=(*outer.places[: len(frame)], *joints, *robot.mounts, *outer.places[len(frame) :]),
        parameters=(*robot_parameters, *mounts, *outer.parameters, *further),
    )
    if set_name == "zeros":
        return model.tied(_follower_ties(robot))
    return model


@lru_cache(maxsize=64)
def _robot_parameters(robot: Robot, name: str, gravity: tuple[float, ...]) -> tuple[Parameter, ...]:
    """Return the parameters of the robot itself by the model's name; folds, candidates and trials ask repeatedly."""
    set_name, families = split_name(name)
    if robot.is_tree and set_name in OF_ONE_CHAIN:
        raise ModelError(
            f"The parameter set '{set_name}' numbers the DH rows of one chain, but '{robot.name}' has "
            f"{len(robot.limbs)} limbs, to {choices(limb.tip for limb in robot.limbs)}. Choose --model placement, "
            "which has all six errors of each joint, or zeros."
        )
    parameters = list(_geometric_parameters(robot, set_name))
    for family in families:
        parameters += joint_parameters(robot, family, gravity)
    return tuple(parameters)


@lru_cache(maxsize=16)
def _geometric_parameters(robot: Robot, set_name: str) -> tuple[Parameter, ...]:
    """Return the parameters of a set, without families; candidates differ in these more often than in the set."""
    # The limbs share what they pass together.
    by_name: dict[str, Parameter] = {}
    for limb in robot.limbs:
        for parameter in MODELS[set_name](limb):
            by_name.setdefault(parameter.name, parameter)
    return tuple(by_name.values())


def frame_and_target_model(
    frames: Mapping[str, Sequence[str]],
    estimated: Sequence[str] | Mapping[str, Sequence[str]],
    targets: Sequence[str],
    *,
    rotation: bool = False,
) -> ErrorModel:
    """Return the parameters of frames and targets alone, for given poses of the tip.

    Args:
        frames: Which of `DIRECTIONS` are estimated, by the name of each measurement frame; () for a known one.
        estimated: Names of the targets that are estimated, or which of `DIRECTIONS` are estimated of each of them.
        targets: Names of all targets.
        rotation: True if targets are frames, of which six parameters are estimated; False for points. Not used where
            ``estimated`` has the directions.
    """
    parameters = []
    for name, directions in frames.items():
        parameters += _placed_parameters("frame", FRAME, name, directions)
    whole = DIRECTIONS if rotation else DIRECTIONS[:3]
    if not isinstance(estimated, Mapping):
        estimated = dict.fromkeys(estimated, whole)
    for name, directions in estimated.items():
        parameters += _placed_parameters("target", TARGET, name, directions)
    frame_places = [FRAME + name for name in frames]
    target_places = [TARGET + name for name in targets]
    places = (*frame_places, TIP, *target_places)
    return ErrorModel("frames", places, tuple(parameters))


def _placed_parameters(
    prefix: str,
    family: str,
    name: str,
    directions: Iterable[str],
) -> list[Parameter]:
    """Return the parameters [m or rad] of a frame or target of this name, "" for the only one, in some of `DIRECTIONS`.

    Their names begin with the prefix, ``"frame"`` or ``"target"``; the family is `FRAME` or `TARGET`.
    """
    return [
        Parameter(
            name=placed_name(prefix, direction, name),
            unit=_UNITS[direction],
            place=f"{family}{name}",
            direction=_TWISTS[direction],
            family=family,
        )
        for direction in DIRECTIONS
        if direction in directions
    ]


def _follower_ties(robot: Robot) -> dict[str, tuple[str, float]]:
    """Return ties of the zeros of joints that follow the same column of q, for `ErrorModel.tied`.

    The leader is the column's own joint, or the first follower if one slides and the other turns. The factor is the
    ratio of the mimic multipliers.
    """
    ties = {}
    multipliers = {
        joint: row
        for limb in robot.limbs
        for joint, row in zip(limb.joints, limb.mimic_matrix, strict=True)
    }
    for column, driver in enumerate(robot.joint_names):
        followers: dict[bool, list[tuple[str, float]]] = {False: [], True: []}
        for joint, row in multipliers.items():
            if row[column]:
                followers[joint.type == "prismatic"].append((joint.name, float(row[column])))
        for alike in followers.values():
            alike.sort(key=lambda pair: pair[0] != driver)
            for name, multiplier in alike[1:]:
                leader, leader_multiplier = alike[0]
                factor = float(multiplier / leader_multiplier)
                ties[f"{name}.zero"] = (f"{leader}.zero", factor)
    return ties


def split_name(name: str) -> tuple[str, tuple[str, ...]]:
    """Return a model's set and the families added to it: ``"dh+gain"`` is ``("dh", ("gain",))``.

    Raises:
        ModelError: There is no such set or family, or a family is added twice.
    """
    base, *families = (part.strip() for part in name.split("+"))
    wrong = [f for f in families if f not in joint_families() or families.count(f) > 1]
    if base not in MODELS or wrong:
        fault = f"'{name}' adds {choices(dict.fromkeys(wrong))} to the set '{base}'"
        if base not in MODELS:
            fault = f"There is no parameter set '{base}'{did_you_mean(base, MODELS)}"
        raise ModelError(
            f"{fault}. Choose 'auto', or one of {choices(MODELS)} and after it, each once and with a '+', any of "
            f"{choices(joint_families())}. {plugins.HINT}"
        )
    return base, tuple(families)


def placed_name(prefix: str, direction: str, name: str) -> str:
    """Return the name of a parameter of a frame or target: ``"target_x"``, or ``"target_x[left]"`` of one with a name.

    Args:
        prefix: ``"frame"`` or ``"target"``.
        direction: One of `DIRECTIONS`.
        name: The frame's or the target's name; "" for the only one.
    """
    return f"{prefix}_{direction}[{name}]" if name else f"{prefix}_{direction}"


def _dh_parameters(robot: Robot, *, hayati: bool = False) -> list[Parameter]:
    """Return a_i, alpha_i, d_i, theta_i of each DH row, row by row; with ``hayati`` beta_i in place of some d_i.

    a_i and alpha_i act on the placement after joint i, and are left out if no <origin> carries it, such as the tip's:
    the target takes their place. d_i and theta_i act on that of joint i. With ``hayati``, a row between nearly parallel
    axes has beta_i in place of d_i.
    """
    table = dh_table(robot)
    T_base_joint, T_base_tip = zero_poses(robot)
    T_base_next = [*T_base_joint[1:], T_base_tip]
    zeros = np.zeros(3)
    parameters = []
    for i, (row, frame) in enumerate(zip(table.rows, dh_frames(table), strict=True)):
        number = i + 1
        is_last = number == len(table.rows)
        with_beta = hayati and row.near_parallel and not is_last

        after = []
        if robot.carriers[number] is not None:
            place = TIP if is_last else robot.joints[number].name
            T_next_row = rigid_inverse(T_base_next[i]) @ frame
            x = T_next_row[:3, 0]
            origin = T_next_row[:3, 3]
            along_x = twist_of(x, zeros)
            about_x = twist_of(np.cross(origin, x), x)
            after.append(Parameter(f"a{number}", "m", place, along_x, LENGTH, row.a))
            after.append(Parameter(f"alpha{number}", "rad", place, about_x, ANGLE, row.alpha))
            if with_beta:
                y = (T_next_row @ screw(1, row.beta, 0.0))[:3, 1]
                about_y = twist_of(np.cross(origin, y), y)
                after.append(Parameter(f"beta{number}", "rad", place, about_y, ANGLE, row.beta))

        before = []
        axis = np.asarray(robot.joints[i].axis)
        if not with_beta:
            along = twist_of(axis, zeros)
            before.append(_before_joint(robot, i, f"d{number}", along, LENGTH, row.d))
        family = ANGLE if row.prismatic else ZERO
        about = twist_of(zeros, axis)
        before.append(_before_joint(robot, i, f"theta{number}", about, family, row.theta))

        # If d and theta act at the same place as a and alpha, they come first, as in the row's product.
        if robot.carriers[i] is not None:
            parameters += after + before
        else:
            parameters += before + after
    return parameters


def _before_joint(
    robot: Robot,
    i: int,
    name: str,
    twist: Array,
    family: str,
    nominal: float = 0.0,
) -> Parameter:
    """Return a parameter at the placement of joint i, or at the next one if no <origin> carries that.

    Its twist, shape (6,), is along or about the joint's axis, in the joint's frame; it adds to the nominal value.
    """
    unit = "m" if twist[:3].any() else "rad"
    place = robot.joints[i].name
    if robot.carriers[i] is None:
        place = robot.joints[i + 1].name if i + 1 < len(robot.joints) else TIP
        T_joint_next = pin.SE3(robot.placements[i + 1])
        twist = read_only(T_joint_next.toActionMatrixInverse() @ twist)
    return Parameter(name, unit, place, twist, family, nominal)


def _placement_parameters(robot: Robot) -> list[Parameter]:
    """Return ``<joint>.x`` to ``<joint>.rz`` of each joint, and ``<joint>.zero`` if it turns about another axis.

    A joint that moves the base directly, without an <origin>, has none: what can be known about it is in the next one.
    """
    parameters = []
    for joint, carrier, twist in zip(
        robot.joints, robot.carriers[:-1], axis_twists(robot), strict=True
    ):
        if carrier is None:
            continue
        turns = joint.type != "prismatic"
        nearest = int(np.argmax(np.abs(joint.axis)))
        is_aligned = abs(abs(joint.axis[nearest]) - 1.0) < 0.5 * _ALIGNED**2
        zero = DIRECTIONS[3 + nearest] if turns and is_aligned else None
        for direction in DIRECTIONS:
            unit = _UNITS[direction]
            family = LENGTH if unit == "m" else ANGLE
            if direction == zero:
                family = ZERO
            name = f"{joint.name}.{direction}"
            parameters.append(Parameter(name, unit, joint.name, _TWISTS[direction], family))
        if turns and zero is None:
            parameters.append(Parameter(f"{joint.name}.zero", "rad", joint.name, twist, ZERO))
    return parameters


def _zero_parameters(robot: Robot) -> list[Parameter]:
    """Return the zero of each joint, named ``<joint>.zero``: about its axis, or along it for a prismatic one."""
    parameters = []
    for i, (joint, twist) in enumerate(zip(robot.joints, axis_twists(robot), strict=True)):
        family = LENGTH if twist[:3].any() else ZERO
        parameters.append(_before_joint(robot, i, f"{joint.name}.zero", twist, family))
    return parameters


#: The named sets of a robot's own parameters, by the name that a model begins with.
MODELS: dict[str, Callable[[Robot], list[Parameter]]] = {
    "paper": _dh_parameters,
    "dh": _dh_parameters,
    "hayati": partial(_dh_parameters, hayati=True),
    "placement": _placement_parameters,
    "zeros": _zero_parameters,
    "frames": lambda _robot: [],  # no error of the robot: frame and target alone
}

plugins.watch("models", MODELS)


def register(name: str, parameters: Callable[[Robot], list[Parameter]]) -> None:
    """Add a parameter set, which models can then name: ``"shoulder"``, ``"shoulder+gain"``.

    Args:
        name: Its name, which no other set has.
        parameters: A function from the nominal robot to the robot's own parameters.

    Raises:
        ModelError: The name is taken, has a "+", or means something else.
    """
    taken = (*MODELS, *_RESERVED)
    if name in taken or "+" in name:
        raise ModelError(
            f"The parameter set '{name}' needs a name without '+', other than {choices(taken, 60)}."
        )
    MODELS[name] = parameters
