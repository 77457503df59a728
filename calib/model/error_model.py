"""The one error model: every error is a small displacement of a placement, times a parameter.

A parameter x_k has a *place* (one of the chain's placements, the measurement frame or the target) and a *direction*, a
twist xi_k in the local frame of that place, linear part first. The displaced placement and its derivative are

    P' = P exp(xi_1 x_1) exp(xi_2 x_2) ...        dP'/dx_k = P' [Ad(exp(xi_(k+1) x_(k+1)) ...)^-1 xi_k]

Along the x axis of a DH frame this is exactly an offset of a or alpha, along the joint's axis one of d or theta. Errors
of the joints' state (`calib.model.families`) act about the joint's own axis, times a known number of that state.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from calib.errors import ModelError, choices
from calib.model.dh import dh_frames, dh_table, screw, zero_poses
from calib.model.families import (
    ANGLE,
    LENGTH,
    ZERO,
    joint_families,
)
from calib.model.joint_errors import axis_twists, joint_parameters
from calib.model.parameters import FRAME, TARGET, TIP, ErrorModel, Parameter, twist_of
from calib.robot.gravity import GRAVITY
from calib.robot.robot import Robot, read_only, rigid_inverse
from calib.units import Array

DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")  #: Of a frame or a placement.

#: The unit of a parameter along or about each, and its twist.
_UNITS = {one: "m" if k < 3 else "rad" for k, one in enumerate(DIRECTIONS)}
_TWISTS = {one: read_only(row) for one, row in zip(DIRECTIONS, np.eye(6), strict=True)}

OWN = "own"  #: The name of a set of parameters that was given, not named.
_ALIGNED = 1e-6  #: An axis within this of a coordinate axis is one [rad].


def error_model(
    robot: Robot,
    name: str | Sequence[Parameter],
    *,
    frame: bool | Mapping[str, Sequence[str]] = False,
    target: bool | Sequence[str] = True,
    targets: Sequence[str] = ("",),
    rotation: bool = False,
    gravity: ArrayLike = GRAVITY,
) -> ErrorModel:
    """A named set of parameters for a robot.

    Args:
        robot: The nominal robot.
        name: ``paper`` or ``dh`` (a, alpha, d, theta of each DH row), ``hayati`` (beta in place of d where axes are
            nearly parallel), ``placement`` (all six of each joint), ``zeros`` (the joint zeros only) or ``frames``
            (no error of the robot at all); behind it, each with a "+", any of the families of the joints' state:
            ``"dh+compliance"``. Or the robot's own parameters themselves: a set called `OWN`.
        frame: Whether the measurement frame is estimated too: True for all six parameters of the one frame, or for
            each station which of `DIRECTIONS` are (none for a frame that is known).
        target: Whether the targets are, or the names of those that are.
        targets: The names of all targets; "" for the only one.
        rotation: Whether the targets are frames, of which six parameters are estimated, or points.
        gravity: shape (3,), acceleration in the URDF's root; the family ``gravity`` leaves out what it cannot bend.

    Raises:
        ModelError: No such set or family; or ``paper`` with an unknown frame, which the paper does not have.

    Example:
        >>> len(error_model(Robot.load("ur3", base="base", tip="tool0"), "paper"))
        27
    """
    frames = {"": DIRECTIONS if frame else ()} if isinstance(frame, bool) else frame
    estimated = (targets if target else ()) if isinstance(target, bool) else target
    base = split_name(name)[0] if isinstance(name, str) else OWN
    down = tuple(np.asarray(gravity, dtype=np.float64).tolist())
    own = _own_parameters(robot, name, down) if isinstance(name, str) else name
    if base == "paper" and any(frames.values()):
        raise ModelError(
            "The parameter set 'paper' knows the measurement frame, as the paper does. To estimate the frame too, "
            "choose --model dh."
        )
    placed = frame_and_target_model(frames, estimated, targets, rotation=rotation)
    joints = tuple(joint.name for joint in robot.joints)
    places = (*placed.places[: len(frames)], *joints, *placed.places[len(frames) :])
    parameters = (*own, *placed.parameters)
    model = ErrorModel(name if isinstance(name, str) else OWN, places, parameters)
    return model.tied(_followers(robot)) if base == "zeros" else model


@lru_cache(maxsize=64)
def _own_parameters(robot: Robot, name: str, gravity: tuple[float, ...]) -> tuple[Parameter, ...]:
    """The robot's own parameters, which folds, candidates and trials ask for again and again."""
    base, families = split_name(name)
    of_joints = (one for family in families for one in joint_parameters(robot, family, gravity))
    return (*MODELS[base](robot), *of_joints)


def frame_and_target_model(
    frames: Mapping[str, Sequence[str]],
    estimated: Sequence[str],
    targets: Sequence[str],
    *,
    rotation: bool = False,
) -> ErrorModel:
    """The parameters of frames and of the targets that are estimated, alone, for given poses of the tip."""
    turns = DIRECTIONS if rotation else DIRECTIONS[:3]
    asked = [("frame", FRAME, name, directions) for name, directions in frames.items()]
    asked += [("target", TARGET, name, turns) for name in estimated]
    parameters = tuple(
        Parameter(
            placed_name(what, one, name), _UNITS[one], f"{family}{name}", _TWISTS[one], family
        )
        for what, family, name, directions in asked
        for one in DIRECTIONS
        if one in directions
    )
    places = (*(FRAME + name for name in frames), TIP, *(TARGET + name for name in targets))
    return ErrorModel("frames", places, parameters)


def _followers(robot: Robot) -> dict[str, tuple[str, float]]:
    """The zeros of joints that follow one driver, or where it is none like them the first of them, by multipliers."""
    ties = {}
    for column, driver in enumerate(robot.joint_names):
        moved = [(j, f) for j, f in zip(robot.joints, robot.coupling[:, column], strict=True) if f]
        for slides in (False, True):
            alike = [(j.name, f) for j, f in moved if (j.type == "prismatic") == slides]
            alike.sort(key=lambda pair: pair[0] != driver)
            for name, factor in alike[1:]:
                ties[f"{name}.zero"] = (f"{alike[0][0]}.zero", float(factor / alike[0][1]))
    return ties


def split_name(name: str) -> tuple[str, tuple[str, ...]]:
    """A model's set and the families added to it: ``"dh+gain"`` is ``("dh", ("gain",))``."""
    base, *families = (part.strip() for part in name.split("+"))
    wrong = [f for f in families if f not in joint_families() or families.count(f) > 1]
    if base not in MODELS or wrong:
        what = f"'{name}' adds {choices(dict.fromkeys(wrong))} to the set '{base}'"
        if base not in MODELS:
            what = f"There is no parameter set '{base}'"
        raise ModelError(
            f"{what}. Choose 'auto', or one of {choices(MODELS)} and behind it, each once and with a '+', any of "
            f"{choices(joint_families())}."
        )
    return base, tuple(families)


def placed_name(what: str, direction: str, name: str) -> str:
    """The name of a parameter of a frame or target: ``"target_x"``, or ``"target_x[left]"`` of one by name."""
    return f"{what}_{direction}[{name}]" if name else f"{what}_{direction}"


def _dh_parameters(robot: Robot, *, hayati: bool = False) -> list[Parameter]:
    """a_i, alpha_i (beta_i in place of d_i between nearly parallel axes), d_i, theta_i of each row, row by row.

    a_i and alpha_i act on the placement after joint i, and are left out where no <origin> carries it, as the tip's: the
    target takes their place. d_i and theta_i act on that of joint i.
    """
    table = dh_table(robot)
    places = [*(joint.name for joint in robot.joints[1:]), TIP]
    T_base_joint, T_base_tip = zero_poses(robot)
    parameters = []
    for i, (row, frame) in enumerate(zip(table.rows, dh_frames(table), strict=True)):
        number, axis, zeros = i + 1, np.asarray(robot.joints[i].axis), np.zeros(3)
        parallel = hayati and row.near_parallel and number < len(table.rows)
        behind, own = [], []
        if robot.carriers[number] is not None:
            T = rigid_inverse([*T_base_joint, T_base_tip][number]) @ frame
            x, origin = T[:3, 0], T[:3, 3]
            about = twist_of(np.cross(origin, x), x)
            behind += [
                Parameter(f"a{number}", "m", places[i], twist_of(x, zeros), LENGTH, row.a),
                Parameter(f"alpha{number}", "rad", places[i], about, ANGLE, row.alpha),
            ]
            if parallel:
                y = (T @ screw(1, row.beta, 0.0))[:3, 1]
                about = twist_of(np.cross(origin, y), y)
                behind.append(Parameter(f"beta{number}", "rad", places[i], about, ANGLE, row.beta))
        if not parallel:
            own.append(_before_joint(robot, i, f"d{number}", twist_of(axis, zeros), LENGTH, row.d))
        family = ANGLE if row.prismatic else ZERO
        turn = twist_of(zeros, axis)
        own.append(_before_joint(robot, i, f"theta{number}", turn, family, row.theta))
        # Where d and theta act at the same place as a and alpha, they come first, as in the row's product.
        parameters += behind + own if robot.carriers[i] is not None else own + behind
    return parameters


def _before_joint(
    robot: Robot, i: int, name: str, twist: Array, family: str, nominal: float = 0.0
) -> Parameter:
    """A displacement along or about a joint's axis, at its placement, or the next where no <origin> carries that."""
    unit, place = "m" if twist[:3].any() else "rad", robot.joints[i].name
    if robot.carriers[i] is None:
        place = robot.joints[i + 1].name if i + 1 < len(robot.joints) else TIP
        twist = read_only(pin.SE3(robot.placements[i + 1]).toActionMatrixInverse() @ twist)
    return Parameter(name, unit, place, twist, family, nominal)


def _placement_parameters(robot: Robot) -> list[Parameter]:
    """``<joint>.x`` to ``<joint>.rz`` of each joint, and ``<joint>.zero`` where its axis is none of the frame's."""
    parameters = []
    for i, joint in enumerate(robot.joints):
        if robot.carriers[i] is None:
            continue  # moved by its joint directly: what can be known of it is in the next one
        turns = joint.type != "prismatic"
        own = int(np.argmax(np.abs(joint.axis)))
        aligned = abs(abs(joint.axis[own]) - 1.0) < 0.5 * _ALIGNED**2
        zero = DIRECTIONS[3 + own] if turns and aligned else None
        for one in DIRECTIONS:
            family = LENGTH if one in DIRECTIONS[:3] else ZERO if one == zero else ANGLE
            name = f"{joint.name}.{one}"
            parameters.append(Parameter(name, _UNITS[one], joint.name, _TWISTS[one], family))
        if turns and not aligned:
            twist = axis_twists(robot)[i]
            parameters.append(Parameter(f"{joint.name}.zero", "rad", joint.name, twist, ZERO))
    return parameters


def _zero_parameters(robot: Robot) -> list[Parameter]:
    """The zero of each joint, named ``<joint>.zero``: about its axis, or along it for a prismatic one."""
    return [
        _before_joint(robot, i, f"{joint.name}.zero", twist, LENGTH if twist[:3].any() else ZERO)
        for i, (joint, twist) in enumerate(zip(robot.joints, axis_twists(robot), strict=True))
    ]


#: The named sets of a robot's own parameters.
MODELS: dict[str, Callable[[Robot], list[Parameter]]] = {
    "paper": _dh_parameters,
    "dh": _dh_parameters,
    "hayati": partial(_dh_parameters, hayati=True),
    "placement": _placement_parameters,
    "zeros": _zero_parameters,
    "frames": lambda _robot: [],  # no error of the robot: frame and target alone
}
