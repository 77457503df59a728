"""The robot as its controller has it and as it is: poses of a tool on both, and its motion with the joints.

Both are `calib.model.kinematics`: the actual robot with the errors that were identified, those of its joints included.
The motion of a tool with the measured joints is that of a parameter for each joint that moves it by one, and of what
its errors add:

    dT/dq_j  =  (1 + sum_k x_k df_k/dq_j) dT/d(displacement of joint j),    dq_j = x_1 f_1(q_j) + x_2 f_2(q_j) + ...

Here q_j is the joint's value, which differs from its reading if readings are coupled.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from calib.basics.arguments import numbers
from calib.basics.arrays import Array, Integers, read_only
from calib.basics.values import Value
from calib.errors import ModelError, choices, did_you_mean
from calib.model.error_model import TIP, ErrorModel, Parameter
from calib.model.families import Factor, JointState
from calib.model.joint_errors import axis_twists
from calib.model.kinematics import Kinematics, Samples
from calib.model.parameter_sets import error_model
from calib.numerics.geometry import not_rotations, position_in_tip
from calib.result.calibration import Calibration, check_same_joints, is_corrected
from calib.result.fitted_model import NonGeometric
from calib.robot.gravity import Payload
from calib.robot.ranges import spread_poses
from calib.robot.robot import Robot

#: The family that moves a measured joint, and with it all joints that follow it.
_GAIN = "gain"

#: If the tools of two robots are typically farther apart than this share of their reach, one is not a calibration of
#: the other.
_NO_CALIBRATION = 0.1

#: Forms of a tool or a frame, in messages.
_POSE = "a pose (4, 4) or a position (3,)"

#: Number of poses at which the tools are compared.
_POSES = 64


@dataclass(frozen=True, slots=True, eq=False)
class Arm(Value):
    """Robot with known errors and a tool; made by `of` or `of_non_geometric`."""

    #: With the placements as they are.
    robot: Robot
    #: Shape (4, 4), [m].
    T_tip_tool: Array
    #: Its parameters are the errors of the joints, and one more for each measured joint.
    kinematics: Kinematics
    #: Values of the parameters; 0 for those of the measured joints.
    x: Array
    #: Load on each joint at joint values, (N, m) to (N, n), [Nm, N]; None: no error needs it.
    load: Callable[[Array], Array] | None = None
    #: Last move of each measured joint before each of N rows, shape (N, m), [rad] or [m]; None: not known, and any
    #: number of rows.
    moves: Array | None = None

    @classmethod
    def of(
        cls,
        robot: Robot,
        T_tip_tool: Array,
        terms: tuple[Parameter, ...] = (),
        values: ArrayLike = (),
        load: Callable[[Array], Array] | None = None,
    ) -> Arm:
        """Make the arm of a robot.

        Args:
            robot: With the placements as they are.
            T_tip_tool: Pose of the tool in the tip, shape (4, 4), [m].
            terms: Errors of the joints that change with their state.
            values: The value of each, in its unit.
            load: Load on each joint at joint values, (N, m) to (N, n), [Nm, N]; None: no error needs it.
        """
        term_values = np.asarray(values, dtype=np.float64)
        # A parameter for each measured joint moves it, and with it all joints that follow it, by the joint's value.
        motion_per_value = partial(_motion_per_value, terms, term_values)
        factor = Factor("motion", motion_per_value, slope=None)
        joint_names = [joint.name for joint in robot.joints]
        directions = dict(zip(joint_names, axis_twists(robot), strict=True))
        motions = []
        for name in robot.joint_names:
            direction = directions.get(name, np.zeros(6))
            motions.append(Parameter(f"{name}.motion", "1", name, direction, _GAIN, factor=factor))
        places = error_model(robot, "frames", target=False).places
        model = ErrorModel("motion", places, (*terms, *motions))
        kinematics = Kinematics(robot, model, np.eye(4), T_tip_tool)
        x = read_only(np.concatenate([term_values, np.zeros(len(motions))]))
        return cls(robot, read_only(T_tip_tool), kinematics, x, load)

    @classmethod
    def of_non_geometric(
        cls,
        non_geometric: NonGeometric,
        nominal: Robot,
        T_tip_tool: Array,
        payload: Payload | None = None,
    ) -> Arm:
        """Make the arm of a result's non-geometric model.

        Args:
            non_geometric: The model.
            nominal: The nominal robot, whose placements it corrects.
            T_tip_tool: Pose of the tool in the tip, shape (4, 4), [m].
            payload: Payload of the tip; None: that at the calibration.
        """
        model = non_geometric.model
        of_joints = list(model.joint_terms)
        terms = tuple(model.terms[t] for t in of_joints)
        values = model.values(non_geometric.x)[of_joints]
        load: Callable[[Array], Array] | None = None
        if any(term.factor and term.factor.loaded for term in terms):
            load = partial(NonGeometric.load, non_geometric, nominal, payload=payload)
        displacements, _ = model.displacements(non_geometric.x)
        places = (*(joint.name for joint in nominal.joints), TIP)
        order = [model.places.index(place) for place in places]
        robot = nominal.with_placements(nominal.placements @ displacements[order])
        return cls.of(robot, T_tip_tool, terms, values, load)

    def at_rows(self, rows: Integers) -> Arm:
        """Return the arm as it is at some of the rows of ``moves``, by their indices, shape (n,)."""
        return self if self.moves is None else replace(self, moves=self.moves[rows])

    def poses(self, q: Array) -> Array:
        """Compute T_base_tool, shape (N, 4, 4), [m], at readings of the joints, shape (N, m), [rad] or [m]."""
        return self.kinematics.poses(self.x, self.samples(q))

    def motion(self, q: Array) -> tuple[Array, Array]:
        """Compute poses of the tool, and its velocity with the value of each joint.

        The change of the load with q is left out of the velocity: this costs the search for joint values an iteration,
        but no accuracy.

        Args:
            q: Readings of the joints, shape (N, m), [rad] or [m].

        Returns:
            T_base_tool, shape (N, 4, 4), [m], and twists along the tool's own axes, linear part first, shape (N, 6, m),
            [m or rad per rad or m].
        """
        poses, twists = self.kinematics.twists(self.x, self.samples(q))
        R_tool_base = np.swapaxes(poses[:, :3, :3], 1, 2)
        in_base = twists[:, :, -len(self.robot.joint_names) :]
        linear, angular = R_tool_base @ in_base[:, :3], R_tool_base @ in_base[:, 3:]
        return poses, np.concatenate([linear, angular], axis=1)

    def samples(self, q: Array) -> Samples:
        """Return joint values as a prediction takes them, with the last moves, and the loads if an error needs them.

        Args:
            q: Shape (N, m), readings of the joints, [rad] or [m], at the N rows of ``moves`` if these are known.
        """
        return Samples.at(q, None if self.load is None else self.load(q), self.moves)


def _motion_per_value(terms: Sequence[Parameter], values: Array, state: JointState) -> Array:
    """Return the motion of a joint per change of its value at N states, (N,): 1, and the slopes of its errors.

    The errors are the terms, with their values in their units; those of other joints do not count.
    """
    per_value = np.ones(len(state.values))
    for term, value in zip(terms, values, strict=True):
        if term.place == state.joint and term.factor and term.factor.slope:
            per_value += value * term.factor.slope(state)
    return per_value


@dataclass(frozen=True, slots=True, eq=False)
class Pair(Value):
    """Tool on the nominal robot and on the actual one; made by `pair_of`."""

    #: The robot as its controller has it, with the tool that the controller is to be set to.
    nominal: Arm
    #: The calibrated robot, with the tool where it is.
    actual: Arm
    #: Shape (4, 4), the base in the frame of the poses [m].
    T_frame_base: Array
    #: Name of the target that is the tool; None if it is not a target.
    target: str | None = None
    #: Name of the station whose frame it is; None if it is not one of a station.
    group: str | None = None
    #: The calibration of the actual robot; None for two robots.
    result: Calibration | None = None
    #: Whether the actual robot is the result's non-geometric model.
    non_geometric: bool = False

    def __post_init__(self) -> None:
        """Raise `ModelError` for two robots whose tools are too far apart for one to be a calibration of the other."""
        robot = self.nominal.robot
        q = spread_poses(robot, _POSES)
        actual = replace(self.actual, moves=None)
        difference = actual.poses(q)[:, :3, 3] - self.nominal.poses(q)[:, :3, 3]
        typical = float(np.median(np.linalg.norm(difference, axis=1)))
        if typical > _NO_CALIBRATION * self.reach:
            raise ModelError(
                f"The calibrated robot has the tool {1e3 * typical:.0f} mm away from its place on the nominal robot "
                f"'{robot.name}' ({robot.urdf.source}); a calibration moves it by millimetres. Give nominal and "
                "calibrated model of the same robot, with the same zero positions."
            )

    def of_all_joints(self, q: Array) -> Array:
        """Return joint values of the pair, (N, m), as columns of all joints of the result, shape (N, M), [rad] or [m].

        Those of joints beside the pair's chain, in a result of several chains, are 0.
        """
        assert self.result is not None
        names, own = self.result.nominal.joint_names, self.nominal.robot.joint_names
        whole = np.zeros((len(q), len(names)))
        whole[:, [names.index(name) for name in own]] = q
        return whole

    @property
    def reach(self) -> float:
        """Length of the actual arm, stretched out, with its tool [m]; at least a millimetre."""
        lengths = np.linalg.norm(self.actual.robot.placements[1:, :3, 3], axis=1)
        tool = np.linalg.norm(self.actual.T_tip_tool[:3, 3])
        return float(max(lengths.sum() + tool, 1e-3))


def pair_of(
    calibration: Calibration | Robot,
    nominal: Robot | None = None,
    *,
    tool: ArrayLike | str | None = None,
    frame: ArrayLike | str | None = None,
    non_geometric: bool | Payload = True,
) -> Pair:
    """Make the pair of the nominal robot, which the controller has, and the actual one, each with the tool.

    Args:
        calibration: The model of the actual robot: a result, or a corrected robot.
        nominal: The model that the controller has; None: the nominal robot of the result.
        tool: A pose in the tip, shape (4, 4) [m], or a position, shape (3,); or the name of a target of the result
            ("" for the only one), which each robot has where its own model has it; None: the tip itself.
        frame: The base in the frame of the program's poses, shape (4, 4) [m], or the name of a station of the result
            ("" for the only one); None: the base.
        non_geometric: Whether to use the result's non-geometric model, if there is one; or the payload to use it with,
            in place of the one at its calibration.

    Returns:
        The pair.

    Raises:
        ModelError: No nominal robot, one that is not the calibration's, or a tool or frame that does not exist.
    """
    if isinstance(calibration, Robot):
        # Two robots and no result.
        given = (tool, frame, non_geometric)
        needs_result = any(isinstance(value, (str, Payload)) for value in given)
        if nominal is None or needs_result:
            raise ModelError(
                "With a corrected robot in place of a result give the nominal robot too, tool and frame "
                "as poses, and no payload: it knows no targets, stations or compliances."
            )
        corrected = calibration.rebuilt(base=nominal.base, tip=nominal.tip)
        check_same_joints(corrected, nominal)
        T_tip_tool = _pose(tool, "tool")
        arms = Arm.of(nominal, T_tip_tool), Arm.of(corrected, T_tip_tool)
        return Pair(*arms, _pose(frame, "frame"))

    result = calibration
    if result.nominal.branches:
        if isinstance(non_geometric, Payload) or (non_geometric and result.non_geometric):
            raise ModelError(
                "This result is of several chains, and its non-geometric model is for all of them together. Commands "
                "are for one chain by the geometry: --geometry, or non_geometric=False."
            )
        return _pair_of_chain(result, nominal, tool, frame)
    nominal = nominal or result.nominal
    model = result.non_geometric if non_geometric is not False else None
    if is_corrected(result, nominal) and model is None:
        raise ModelError(
            f"{nominal.urdf.source} has the corrected joint origins of this result: for a controller with this model "
            "there is nothing to correct, and commands would be corrected twice. For a controller with the nominal "
            "model give its URDF, from which the calibration started."
        )
    setup = result.setup if model is None else model.setup

    target: str | None = None
    if isinstance(tool, str):
        target = _find_name(setup.targets, tool, "target")
        t = setup.targets.index(target)
        T_tip_tool = setup.T_tip_target[t]
        # The controller has a target where it was stated, or where it was estimated if nothing was stated.
        stated = result.nominal_setup if setup.target_given[t] else setup
        T_tip_tool_nominal = stated.T_tip_target[t]
    else:
        T_tip_tool = T_tip_tool_nominal = _pose(tool, "tool")

    group: str | None = None
    if isinstance(frame, str):
        group = _find_name(setup.groups, frame, "station")
        T_frame_base = read_only(setup.T_frame_base[setup.groups.index(group)])
    else:
        T_frame_base = _pose(frame, "frame")

    if model is None:
        actual = Arm.of(result.corrected(nominal), T_tip_tool)
    else:
        payload = non_geometric if isinstance(non_geometric, Payload) else None
        actual = Arm.of_non_geometric(model, result.uncorrected(nominal), T_tip_tool, payload)
    if isinstance(non_geometric, Payload):
        factors = [term.factor for term in actual.kinematics.model.terms]
        if not any(factor and factor.loaded and not factor.later for factor in factors):
            raise ModelError(
                "A payload is given, but the result has no compliances: its commands would be the same "
                "with any. Leave the payload out; the model 'dh+compliance' estimates compliances."
            )
    return Pair(
        nominal=Arm.of(nominal, T_tip_tool_nominal),
        actual=actual,
        T_frame_base=T_frame_base,
        target=target,
        group=group,
        result=result,
        non_geometric=model is not None,
    )


def chain_of_hand(
    result: Calibration, hand: str | None, target: str | None, base: str | None = None
) -> tuple[str, str]:
    """Return base and tip of the chain of a result of several that a tip, a target's name or a tool's target names.

    Args:
        result: A result of several chains.
        hand: Link at the end of the chain, or the name of a target on it; None: that of the tool.
        target: Name of the target that is the tool; None: it is none.
        base: Link in whose frame the commands are; None: that of the first measurement frame that sees the hand.

    Raises:
        ModelError: No chain, or several, are named; or one from the base has a joint that was not calibrated.
        UrdfError: There is no such base, or no chain from it.
    """
    links = dict(zip(result.setup.targets, result.setup.target_links, strict=True))
    link = links.get(hand or "", hand) or links.get(target or "")
    found = [chain for chain in result.nominal.chains if chain.tip == link]
    if not found:
        tips = dict.fromkeys(chain.tip for chain in result.nominal.chains)
        wrong = (
            "" if link is None else f"none ends at '{link}'{did_you_mean(link, [*links, *tips])}: "
        )
        raise ModelError(
            f"The result has several hands, which end at {choices(tips)}: {wrong}choose one with "
            f"{' or '.join(f'--tip {name}' for name in links)} (or with the link)."
        )
    # Seen from several links, a tip has several chains; the commands are the same in the frame of the first.
    if base is None:
        return found[0].base, found[0].tip
    chain = result.nominal.rebuilt(None, base, found[0].tip)
    others = [name for name in chain.joint_names if name not in result.nominal.joint_names]
    if others:
        bases = dict.fromkeys(c.base for c in found)
        raise ModelError(
            f"--base {base}: from there to '{chain.tip}' the result has no joint {choices(others)}: it was not "
            f"measured. Give --base with a link between calibrated joints, or leave it out for {choices(bases)}."
        )
    return chain.base, chain.tip


def _pair_of_chain(
    result: Calibration,
    nominal: Robot | None,
    tool: ArrayLike | str | None,
    frame: ArrayLike | str | None,
) -> Pair:
    """Return the pair of one chain of a result of several, by its geometry; see `pair_of`.

    The chain is that of the nominal robot; if none is given, that of the tool's target.
    """
    setup = result.setup
    target: str | None = None
    if isinstance(tool, str):
        # Without a name, the only target on the hand.
        links = dict(zip(setup.targets, setup.target_links, strict=True))
        of_hand = [name for name in links if nominal is not None and links[name] == nominal.tip]
        names = setup.targets if tool or not of_hand else of_hand
        target = _find_name(names, tool, "target")
    if nominal is None:
        nominal = result.nominal.rebuilt(None, *chain_of_hand(result, None, target))
    whole = result.nominal.rebuilt(nominal.urdf)
    if is_corrected(result, whole):
        raise ModelError(
            f"{nominal.urdf.source} has the corrected joint origins of this result: for a controller with this model "
            "there is nothing to correct. Give the URDF from which the calibration started."
        )
    if target is None:
        T_tip_tool = T_tip_tool_nominal = _pose(tool, "tool")
    else:
        t = setup.targets.index(target)
        if setup.target_links[t] != nominal.tip:
            raise ModelError(
                f"The target '{target}' is on '{setup.target_links[t]}', but the chain ends at '{nominal.tip}'. Name "
                f"the chain of the target: --tip {target}."
            )
        stated = result.nominal_setup if setup.target_given[t] else setup
        T_tip_tool, T_tip_tool_nominal = setup.T_tip_target[t], stated.T_tip_target[t]
    T_frame_base, group = _pose(None, "frame"), None
    if isinstance(frame, str):
        group = _find_name(setup.groups, frame, "station")
        f = setup.groups.index(group)
        if setup.frame_links[f] != nominal.base:
            raise ModelError(
                f"The frame of '{group}' is on '{setup.frame_links[f]}', but the chain starts at '{nominal.base}'. "
                "Give the poses in the base."
            )
        T_frame_base = read_only(setup.T_frame_base[f])
    elif frame is not None:
        T_frame_base = _pose(frame, "frame")
    corrected = result.corrected(whole).rebuilt(None, nominal.base, nominal.tip)
    return Pair(
        nominal=Arm.of(nominal, T_tip_tool_nominal),
        actual=Arm.of(corrected, T_tip_tool),
        T_frame_base=T_frame_base,
        target=target,
        group=group,
        result=result,
    )


def _find_name(names: Sequence[str], name: str, what: str) -> str:
    """Return the name if it is one of some names, or the only one for the empty name; else it raises `ModelError`.

    What is named, ``"target"`` or ``"station"``, is for the message.
    """
    if name in names:
        return name
    if not name and len(names) == 1:
        return names[0]
    raise ModelError(
        f"The calibration has no {what} '{name}'; it has "
        f"{choices(known or '(no name)' for known in names)}. Name one."
    )


def _pose(value: ArrayLike | str | None, what: str) -> Array:
    """Return a pose (4, 4) or a position (3,) [m] as a pose, and None as the identity; `ModelError` for all else.

    What it is, ``"tool"`` or ``"frame"``, is for the message; the position of a tool is checked to be in metres.
    """
    T = np.eye(4)
    values = T if value is None else numbers(what, value, _POSE)
    if values.shape == (3,):
        T[:3, 3] = values
        values = T
    if values.shape != (4, 4) or not_rotations(values[None, :3, :3]) or np.isnan(values).any():
        raise ModelError(f"The {what} is {_POSE}, not {values.tolist()}.")
    if what == "tool":
        position_in_tip(values[:3, 3], what)
    return read_only(values)
