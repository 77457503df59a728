"""The robot as its controller has it and as it is: poses of a tool on both, and how it moves with the joints.

Both are `calib.model.kinematics`: the actual robot with the errors that were identified, those of its joints included.
How a tool moves with the measured joints is asked of the same kinematics, by a parameter for each joint that moves it
by one, and by what its own errors add:

    dT/dq_j  =  (1 + sum_k x_k df_k/dq_j) dT/d(displacement of joint j),    dq_j = x_1 f_1(q_j) + x_2 f_2(q_j) + ...
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from calib.errors import ModelError, choices
from calib.model.error_model import error_model
from calib.model.families import Factor, JointState
from calib.model.joint_errors import axis_twists
from calib.model.kinematics import Kinematics, Samples
from calib.model.parameters import TIP, ErrorModel, Parameter
from calib.numerics.geometry import not_rotations
from calib.result.calibration import CalibrationValues
from calib.result.prediction import NonGeometric
from calib.robot.payload import Payload
from calib.robot.ranges import spread_poses
from calib.robot.robot import Robot, read_only
from calib.units import Array

#: The family that moves a measured joint, and with it all joints that follow it.
_GAIN = "gain"

#: Origins of one robot differ by rounding [m; rotation matrices: 1].
_SAME = 1e-9

#: Two robots whose tools are typically further apart than this share of their reach are no calibration of each other;
#: looked at in so many poses.
_NO_CALIBRATION, _POSES = 0.1, 64


@dataclass(frozen=True, slots=True, eq=False)
class Arm:
    """A robot whose errors are known, with a tool at T_tip_tool (4, 4) [m]; made by `of` or `of_non_geometric`.

    ``kinematics`` has a parameter more for each measured joint, 0 in ``x``; ``load`` gives the load on each joint at
    joint values, (N, m) to (N, n), [Nm, N], where an error needs it.
    """

    robot: Robot
    T_tip_tool: Array
    kinematics: Kinematics
    x: Array
    load: Callable[[Array], Array] | None = None

    @classmethod
    def of(
        cls,
        robot: Robot,
        T_tip_tool: Array,
        terms: tuple[Parameter, ...] = (),
        sizes: ArrayLike = (),
        load: Callable[[Array], Array] | None = None,
    ) -> Arm:
        """A robot, with the errors of its joints that change with their state and their values (len(terms),)."""
        values = np.asarray(sizes, dtype=np.float64)
        directions = dict(
            zip((joint.name for joint in robot.joints), axis_twists(robot), strict=True)
        )

        def moved(state: JointState) -> Array:
            """How far a joint moves where its value changes by one: 1, and the slopes of its own errors."""
            number = np.ones(len(state.values))
            for term, size in zip(terms, values, strict=True):
                if term.place == state.joint and term.factor and term.factor.slope:
                    number += size * term.factor.slope(state)
            return number

        factor = Factor("motion", moved, slope=None)
        motions = [
            Parameter(f"{n}.motion", "1", n, directions.get(n, np.zeros(6)), _GAIN, factor=factor)
            for n in robot.joint_names
        ]
        places = error_model(robot, "frames", target=False).places
        model = ErrorModel("motion", places, (*terms, *motions))
        kinematics = Kinematics(robot, model, np.eye(4), T_tip_tool)
        x = read_only(np.concatenate([values, np.zeros(len(motions))]))
        return cls(robot, read_only(T_tip_tool), kinematics, x, load)

    @classmethod
    def of_non_geometric(
        cls,
        non_geometric: NonGeometric,
        nominal: Robot,
        T_tip_tool: Array,
        payload: Payload | None = None,
    ) -> Arm:
        """The robot of a result's non-geometric model, with another payload than at its calibration if one is given."""
        model, x = non_geometric.model, non_geometric.x
        displacements, _ = model.displacements(x)
        order = [model.places.index(name) for name in (*(j.name for j in nominal.joints), TIP)]
        chosen = list(model.joint_terms)
        terms = tuple(model.terms[t] for t in chosen)
        loaded = any(term.factor and term.factor.loaded for term in terms)
        return cls.of(
            nominal.with_placements(nominal.placements @ displacements[order]),
            T_tip_tool,
            terms,
            model.values(x)[chosen],
            (lambda q: non_geometric.load(nominal, q, payload)) if loaded else None,
        )

    def poses(self, q: Array) -> Array:
        """T_base_tool at joint values of shape (N, m), [rad] or [m]; shape (N, 4, 4), [m]."""
        return self.kinematics.poses(self.x, self._samples(q))

    def motion(self, q: Array) -> tuple[Array, Array]:
        """T_base_tool at joint values (N, m), shape (N, 4, 4), and the tool's velocity with each, (N, 6, m).

        Twists are along the tool's own axes, linear first [m or rad per rad or m]. How the load changes with q is left
        out of them: it costs an iteration where joint values are looked for, no accuracy.
        """
        poses, twists = self.kinematics.twists(self.x, self._samples(q))
        back = np.swapaxes(poses[:, :3, :3], 1, 2)
        moved = twists[:, :, -len(self.robot.joint_names) :]
        return poses, np.concatenate([back @ moved[:, :3], back @ moved[:, 3:]], axis=1)

    def _samples(self, q: Array) -> Samples:
        """Joint values with their loads."""
        return Samples.at(q, None if self.load is None else self.load(q))


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """The same tool on the nominal robot and on the actual one; made by `pair_of`."""

    nominal: Arm  #: The robot as its controller has it, with the tool that the controller is to be set to.
    actual: Arm  #: The calibrated robot, with the tool where it is.
    T_frame_base: Array  #: shape (4, 4), the base in the frame of the poses [m].
    target: str | None = None  #: Name of the target that the tool is; None where it is none.
    set_up: str | None = None  #: Name of the set-up whose frame it is; None where it is none.
    result: CalibrationValues | None = (
        None  #: What is known of the actual robot; None of two robots.
    )
    non_geometric: bool = False  #: Whether the actual robot is the result's non-geometric model.

    def __post_init__(self) -> None:
        """Refuse two robots that are no calibration of each other."""
        robot = self.nominal.robot
        q = spread_poses(robot, _POSES)
        away = (self.actual.poses(q) - self.nominal.poses(q))[:, :3, 3]
        typical = float(np.median(np.linalg.norm(away, axis=1)))
        if typical > _NO_CALIBRATION * self.reach:
            raise ModelError(
                f"The calibrated robot has the tool {1e3 * typical:.0f} mm away from where the nominal robot "
                f"'{robot.name}' ({robot.urdf.source}) has it; a calibration moves it by millimetres. Give the nominal "
                "and the calibrated model of one robot, with zero positions that agree."
            )

    @property
    def reach(self) -> float:
        """How long the actual arm is, stretched out, with its tool [m]; at least a millimetre."""
        lengths = np.linalg.norm(self.actual.robot.placements[1:, :3, 3], axis=1)
        tool = np.linalg.norm(self.actual.T_tip_tool[:3, 3])
        return float(max(lengths.sum() + tool, 1e-3))


def pair_of(
    calibration: CalibrationValues | Robot,
    nominal: Robot | None = None,
    *,
    tool: ArrayLike | str | None = None,
    frame: ArrayLike | str | None = None,
    non_geometric: bool | Payload = True,
) -> Pair:
    """The two robots; the arguments are those of `calib.compensation.commands.compensate`.

    Raises:
        ModelError: No nominal robot, one that is not the calibration's, or a tool or frame that there is not.
    """
    if isinstance(calibration, Robot):
        if nominal is None or any(
            isinstance(one, (str, Payload)) for one in (tool, frame, non_geometric)
        ):
            raise ModelError(
                "With a corrected robot in place of a result give the nominal robot too, tool and frame as poses, and "
                "no payload: it knows no targets, set-ups and compliances."
            )
        actual = calibration.rebuilt(base=nominal.base, tip=nominal.tip)
        check_same_joints(actual, nominal)
        T_tip_tool, T_frame_base = _pose(tool, "tool"), _pose(frame, "frame")
        return Pair(Arm.of(nominal, T_tip_tool), Arm.of(actual, T_tip_tool), T_frame_base)
    result, nominal = calibration, nominal or calibration.nominal
    began = result.uncorrected(nominal) if is_corrected(result, nominal) else nominal
    model = result.non_geometric if non_geometric is not False else None
    known = result.setup if model is None else model.setup
    target = set_up = None
    if isinstance(tool, str):
        target = _name(known.targets, tool, "target")
        t = known.targets.index(target)
        # Where it was said to be, and so where the controller has it. One that was found has no such place.
        stated = result.nominal_setup if known.target_given[t] else known
        T_actual, T_nominal = known.T_tip_target[t], stated.T_tip_target[t]
    else:
        T_actual = T_nominal = _pose(tool, "tool")
    if isinstance(frame, str):
        set_up = _name(known.groups, frame, "set-up")
        T_frame_base = read_only(known.T_frame_base[known.groups.index(set_up)])
    else:
        T_frame_base = _pose(frame, "frame")
    payload = non_geometric if isinstance(non_geometric, Payload) else None
    if model is None:
        arm = Arm.of(result.corrected(nominal), T_actual)
    else:
        arm = Arm.of_non_geometric(model, result.uncorrected(nominal), T_actual, payload)
    factors = [term.factor for term in arm.kinematics.model.terms]
    if payload is not None and not any(f and f.loaded and not f.later for f in factors):
        raise ModelError(
            "A payload is given, but the result has no compliances: its commands would be the same with any. Leave the "
            "payload out; the model 'dh+compliance' estimates compliances."
        )
    nominal_arm = Arm.of(began, T_nominal)
    return Pair(nominal_arm, arm, T_frame_base, target, set_up, result, model is not None)


def is_corrected(result: CalibrationValues, robot: Robot) -> bool:
    """Whether a robot has the joint origins that a result corrected, not those that it began with; or `ModelError`."""
    own = result.nominal
    if (robot.base, robot.tip) != (own.base, own.tip):
        raise ModelError(
            f"The result is for --base {own.base} --tip {own.tip}, not for '{robot.base}' to '{robot.tip}'."
        )
    for other, corrected in ((result.corrected(robot), True), (result.uncorrected(robot), False)):
        theirs = other.origins()
        far = [n for n, T in robot.origins().items() if np.abs(T - theirs[n]).max() > _SAME]
        if not far:
            return corrected
    raise ModelError(
        f"{robot.urdf.source}: the origin of '{far[0]}' is neither the one that the calibration began with nor its "
        "corrected one. Give the URDF that the result was made with, or the corrected URDF in place of the result."
    )


def _name(names: Sequence[str], name: str, what: str) -> str:
    """The name that is meant: the only one there is for the empty name."""
    if name in names:
        return name
    if not name and len(names) == 1:
        return names[0]
    raise ModelError(
        f"The calibration has no {what} '{name}'; it has {choices(own or '(no name)' for own in names)}. Name one."
    )


def _pose(given: ArrayLike | str | None, what: str) -> Array:
    """A pose, shape (4, 4), from a pose or from a position, shape (3,), [m]; the identity of nothing."""
    T = np.eye(4)
    values = T if given is None else np.asarray(given, dtype=np.float64)
    if values.shape == (3,):
        T[:3, 3] = values
        values = T
    if values.shape != (4, 4) or not_rotations(values[None, :3, :3]) or np.isnan(values).any():
        raise ModelError(f"The {what} is a pose (4, 4) or a position (3,), not {values.tolist()}.")
    return read_only(values)


def check_same_joints(robot: Robot, nominal: Robot) -> None:
    """Refuse two robots whose joints differ in name, type or axis."""
    ours, theirs = (
        [f"{joint.name} ({joint.type}, axis {joint.axis + 0.0})" for joint in one.joints]
        for one in (robot, nominal)
    )
    if ours != theirs:
        raise ModelError(
            f"The robot '{robot.name}' has the joints {choices(ours)}, its nominal robot '{nominal.name}' "
            f"{choices(theirs)}. Give the nominal URDF that the robot was corrected from, with the same base and tip."
        )
