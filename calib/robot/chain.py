"""The geometry of a chain: its placements, in path order, and the ``<origin>`` that holds each of them.

The path from base to tip may climb from the base to the link where the branches part, and then descend to the tip.
A joint of the base's side is walked from its child link to its parent, so that its motion and its origin O turn round:

    (O J(axis, q))^-1 = J(-axis, q) O^-1

With its axis turned round it is a joint like any other, at the same q, and the whole path is one serial chain.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from calib.errors import UrdfError, choices
from calib.robot.urdf import Urdf, UrdfJoint

Array = NDArray[np.float64]

MOVING = ("revolute", "continuous", "prismatic")
"""The types of joints that a chain may move by."""

#: What stands before the links' names in the Pinocchio model.
_LINK = "link:"


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """The path between two links as a serial chain of n moving joints."""

    #: The moving joints, base to tip; those of the base's side with their axis turned round.
    joints: tuple[UrdfJoint, ...]
    placements: Array  #: shape (n + 1, 4, 4), [m]: of each joint in the one before it, of the tip in the last joint.
    #: For each placement the URDF joint whose ``<origin>`` holds it, or None.
    carriers: tuple[str | None, ...]
    T_root_base: Array  #: shape (4, 4), [m], pose of the base in the frame that the first placement is given in.
    #: For each placement before, after and inverted: it is before @ origin @ after, or before @ origin^-1 @ after
    #: where the origin stands inverted in it; poses of shape (4, 4), [m].
    around: tuple[tuple[Array, Array, bool], ...]
    base_moves: bool  #: Whether joints lie on the base's side; the first placement is then given in the base.

    @classmethod
    def of(cls, urdf: Urdf, base: str, tip: str) -> Chain:
        """The chain between two links of a URDF.

        Raises:
            UrdfError: No such link, no moving joint between them, or one with more than one coordinate; or
                Pinocchio cannot build a model of the URDF.
        """
        by_name = {joint.name: joint for joint in urdf.joints}
        to_base, to_tip = urdf.chain(base, tip)
        path = [_Step(by_name[name], up=True) for name in reversed(to_base)]
        path += [_Step(by_name[name], up=False) for name in to_tip]
        moving = [i for i, step in enumerate(path) if step.joint.type != "fixed"]
        _check_moving(urdf, base, tip, [path[i].joint for i in moving])
        _built_model(urdf)  # which refuses what Pinocchio cannot read, or reads otherwise
        T_root_base, steps, base_moves = np.eye(4), path, path[moving[0]].up
        if (
            not base_moves
        ):  # then the chain starts in the URDF's root, joints above the base at zero
            for name in urdf.chain(urdf.root, base)[1]:
                T_root_base = T_root_base @ by_name[name].T_parent_joint
            steps = [_Step(by_name[name], up=False) for name in urdf.chain(urdf.root, tip)[1]]
        placements = _placements(steps, {path[i].joint.name for i in moving})
        carriers: list[str | None] = []
        around = []
        for k, placement in enumerate(placements):
            number, last = _carrier(path, moving, k)
            step = None if number is None else path[number]
            rest = rigid_inverse(np.eye(4) if step is None else step.origin)
            around.append(
                (
                    placement @ rest if last else np.eye(4),
                    np.eye(4) if last else rest @ placement,
                    step is not None and step.up,
                )
            )
            carriers.append(None if step is None else step.joint.name)
        joints = tuple(path[i].path_joint for i in moving)
        return cls(
            joints,
            read_only(placements),
            tuple(carriers),
            read_only(T_root_base),
            tuple(around),
            base_moves,
        )


def read_only(values: ArrayLike | Sequence[Array]) -> Array:
    """A copy of the values as a float64 array of the same shape that cannot be written to."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def rigid_inverse(T: Array) -> Array:
    """The inverses of poses, shape (..., 4, 4): (R^T, -R^T p)."""
    result = np.zeros_like(T)
    R_T = np.swapaxes(T[..., :3, :3], -1, -2)
    result[..., :3, :3] = R_T
    result[..., :3, 3] = -(R_T @ T[..., :3, 3, None])[..., 0]
    result[..., 3, 3] = 1.0
    return result


def full_model(urdf: Urdf) -> pin.Model:
    """The Pinocchio model of all of a URDF, mimic joints free; links are found by `link_frame`.

    Raises:
        UrdfError: Pinocchio cannot build it.
    """
    return _built_model(urdf).copy()


@lru_cache(maxsize=8)
def _built_model(urdf: Urdf) -> pin.Model:
    """What `full_model` hands out copies of: reading the XML takes ten times as long as a copy."""
    try:
        model = pin.buildModelFromXML(urdf.data.decode(urdf.encoding))
    except (ValueError, RuntimeError) as error:
        raise UrdfError(
            f"{urdf.source}: Pinocchio cannot build a model of this URDF: {error}"
        ) from error
    _check_same(urdf, model)
    # Pinocchio cannot lock a joint that shares its name with a link, as ANYmal's do: let links be told apart.
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            frame.name = _LINK + frame.name
    return model


def _check_same(urdf: Urdf, model: pin.Model) -> None:
    """Refuse a URDF whose links Pinocchio puts elsewhere than its text: it reads some numbers and names otherwise."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    bodies = [i for i, frame in enumerate(model.frames) if frame.type == pin.FrameType.BODY]
    T = {model.frames[i].name: data.oMf[i].homogeneous for i in bodies}
    wrong = [
        joint.name
        for joint in urdf.joints
        if joint.child not in T
        or joint.parent not in T
        or not np.allclose(T[joint.parent] @ joint.T_parent_joint, T[joint.child], 1e-9, 1e-9)
    ]
    if wrong:
        raise UrdfError(
            f"{urdf.source}: Pinocchio reads the joints {choices(wrong)} in another way than they are written. Look "
            "for unusual characters in numbers and names, and for comments inside of tags."
        )


def full_configurations(model: pin.Model, values: Mapping[str, Array]) -> Array:
    """Pinocchio's configurations of a `full_model`, other joints neutral, shape (N, nq).

    Args:
        model: See `full_model`.
        values: Of joints with one coordinate, by name, shape (N,) each, see `Robot.urdf_values`.
    """
    count = max((len(value) for value in values.values()), default=0)
    result = np.tile(pin.neutral(model), (count, 1))
    for name, value in values.items():
        joint = model.getJointId(name)
        first = model.idx_qs[joint]
        if model.nqs[joint] == 1:
            result[:, first] = value
        else:  # a continuous joint's configuration is (cos q, sin q)
            result[:, first], result[:, first + 1] = np.cos(value), np.sin(value)
    return result


def link_frame(model: pin.Model, link: str) -> int:
    """The index of a link's frame in a `full_model`, or in one that was reduced from it."""
    return int(model.getFrameId(_LINK + link, pin.FrameType.BODY))


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """A joint of the path, fixed ones included; ``up`` where it is walked from its child to its parent."""

    joint: UrdfJoint
    up: bool

    @property
    def origin(self) -> Array:
        """The factor that the joint's origin is in the path, shape (4, 4), [m]."""
        T = self.joint.T_parent_joint
        return rigid_inverse(T) if self.up else T

    @property
    def path_joint(self) -> UrdfJoint:
        """The joint with its axis in the sense of the path."""
        if not self.up:
            return self.joint
        return replace(self.joint, axis=read_only(-self.joint.axis + 0.0))


def _carrier(path: list[_Step], moving: list[int], k: int) -> tuple[int | None, bool]:
    """The step whose origin holds placement k, None without; and whether as the placement's last factor.

    That of the moving joint on either side, if its origin lies there; at the ends of the chain else that of the
    fixed joint next to the moving one, so that all that is mounted behind it moves along.
    """
    n = len(moving)
    if k < n and not path[moving[k]].up:
        return moving[k], True
    if k > 0 and path[moving[k - 1]].up:
        return moving[k - 1], False
    if k == 0:
        return moving[0] - 1 if moving[0] > 0 else None, True
    behind = moving[-1] + 1
    return (behind, False) if behind < len(path) else (None, True)


def _placements(steps: list[_Step], moves: Collection[str]) -> list[Array]:
    """The placements between the joints that move, the tip's last."""
    placements, T = [], np.eye(4)
    for step in steps:
        if step.joint.name not in moves:
            T = T @ step.origin
        elif step.up:  # it moves first, its origin comes behind it
            placements.append(T)
            T = step.origin
        else:
            placements.append(T @ step.origin)
            T = np.eye(4)
    return [*placements, T]


def pinocchio_chain(joints: Sequence[UrdfJoint], placements: Array) -> pin.Model:
    """A Pinocchio model of n joints in a row, whose configuration is their values; ``placements`` as in `Chain`."""
    model = pin.Model()
    for parent, (joint, placement) in enumerate(zip(joints, placements, strict=False)):
        slides = joint.type == "prismatic"
        kind = pin.JointModelPrismaticUnaligned if slides else pin.JointModelRevoluteUnaligned
        T = pin.SE3(placement[:3, :3], placement[:3, 3])
        model.addJoint(parent, kind(np.array(joint.axis)), T, joint.name)
    return model


def _check_moving(urdf: Urdf, base: str, tip: str, joints: Sequence[UrdfJoint]) -> None:
    """Refuse a chain without joints, and joints with more than one coordinate."""
    if not joints:
        raise UrdfError(
            f"{urdf.source}: no joint moves between the base '{base}' and the tip '{tip}'. Name two links with "
            f"the arm between them by --base and --tip; the links are {choices(urdf.links)}."
        )
    for joint in joints:
        if joint.type not in MOVING:
            raise UrdfError(
                f"{urdf.source}: joint '{joint.name}' between '{base}' and '{tip}' is of type '{joint.type}'; a "
                f"chain may hold {choices(MOVING)} and 'fixed' joints. Choose --base and --tip on one side of it."
            )


#: Names of a tip, in the order of preference, where several links lie equally far out.
_USUAL_TIPS = ("tool0", "tcp", "tool", "flange", "ee_link")


def farthest_link(
    urdf: Urdf, base: str, measured: Collection[str] | None = None, held: Collection[str] = ()
) -> str:
    """The link with the most moving joints between it and ``base``; a usual tip's name breaks ties.

    Only links that ``measured`` joints alone lead to count (all joints if None), if there are any with a moving joint
    before them; ``held`` joints lead on but do not count. Links below the base come first; where nothing moves below
    it, as on a camera's link, all others are looked at.

    Raises:
        UrdfError: The base is not a link.
    """
    urdf.chain(base, base)  # raises, with the names there are, for a link that does not exist
    every = {joint.name for joint in urdf.joints}
    knowns = [every] if measured is None else [measured, every]
    for known, climb in itertools.product(knowns, (False, True)):
        count = _counted(urdf, base, known, held, climb=climb)
        most = max(count.values())
        if most:
            break
    farthest = [link for link in count if count[link] == most]
    return next((name for name in _USUAL_TIPS if name in farthest), farthest[-1])


def _counted(
    urdf: Urdf, base: str, known: Collection[str], held: Collection[str], *, climb: bool
) -> dict[str, int]:
    """The number of moving joints before each link that can be reached; ``climb``: joints are passed upwards too."""
    above = {joint.child: joint for joint in urdf.joints}
    start = base
    while start in above and above[start].type == "fixed":
        start = above[start].parent
    beside: dict[str, list[tuple[str, bool]]] = {}
    for joint in urdf.joints:
        counts = joint.type != "fixed" and joint.name not in held
        moves = joint.type in MOVING and joint.mimic is None and joint.name in known
        if moves or not counts:
            beside.setdefault(joint.parent, []).append((joint.child, counts))
            if climb:
                beside.setdefault(joint.child, []).append((joint.parent, counts))
    count, waiting = {start: 0}, [start]
    for link in waiting:
        for other, counts in beside.get(link, []):
            if other not in count:
                count[other] = count[link] + counts
                waiting.append(other)
    return count
