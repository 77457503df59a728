"""Transforms between what stands on one rigid body: measurement frames, targets, links, bases of robots.

A measurement frame F is on a link, T_F_link, and a target T as well, T_link_T. Between two links of one body there are
fixed joints only, whose origins O are known by the URDF or, for the mount of a further robot, estimated:

    T_from_to = T_1 T_2 ... T_n

Each factor is such a pose or its inverse. A unit of the parameter k moves the factor T_i by the twist xi_ik at its end,
T_i exp(xi_ik dx_k), and so the whole by the sum of these twists carried to the end,

    sum_i  Ad((T_i+1 ... T_n)^-1) xi_ik

An inverse (T exp(xi))^-1 = T^-1 exp(-Ad(T) xi).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

import calib.data.kinds as registry
from calib.basics.arrays import Array, read_only, rigid_inverse
from calib.basics.values import Value
from calib.errors import ModelError, choices, did_you_mean
from calib.model.error_model import TIP
from calib.result.calibration import Calibration
from calib.robot.joined_urdf import SEPARATOR

#: The name of the measurement frame of a table without stations.
ONLY_FRAME = "frame"

#: What a name may stand for, in the words that distinguish two of the same name: ``"station:left"``.
STATION = "station"
TARGET = "target"
ROBOT = "robot"
LINK = "link"


@dataclass(frozen=True, slots=True, eq=False)
class Transform(Value):
    """The pose of one thing in another on the same rigid body, with its uncertainty."""

    #: In whose frame the pose is given: a station, a target, a robot or a link
    from_name: str
    #: Whose pose is given
    to_name: str
    #: Shape (4, 4), T_from_to [m]
    pose: Array
    #: Shape (6, 6), covariance of the displacement of ``to`` along the axes of ``from`` (x, y, z) [m] and of its
    #: rotation about them (rx, ry, rz) [rad]: zero of what was given, of a point's orientation, and of fixed joints
    covariance: Array

    @property
    def position_std(self) -> float:
        """Standard deviation of the position along the direction in which it is largest [m]."""
        return _largest(self.covariance[:3, :3])

    @property
    def orientation_std(self) -> float:
        """Standard deviation of the orientation about the axis for which it is largest [rad]."""
        return _largest(self.covariance[3:, 3:])


@dataclass(frozen=True, slots=True, eq=False)
class Placed(Value):
    """Something that stands on a link."""

    #: Its name
    name: str
    #: One of "station", "target", "robot" and "link"
    what: str
    #: The link
    link: str
    #: Shape (4, 4), its pose in the link [m]
    T_link_it: Array
    #: Shape (6, p), twist in its own frame of a unit of each parameter, linear [m] then angular [rad]
    twists: Array


#: A factor of a pose, (4, 4) [m], and the twists at its end of a unit of each parameter, (6, p).
_Factor = tuple[Array, Array]


def transform(c: Calibration, from_name: str, to_name: str) -> Transform:
    """Return T_from_to by the geometry; see `Calibration.transform`.

    Args:
        c: The result.
        from_name: Name of a station, a target, a further robot or a link.
        to_name: Name of another.

    Raises:
        ModelError: There is nothing of that name, two things have it, no row determines its pose, or joints move
            between them.
    """
    start = find(c, from_name)
    end = find(c, to_name)
    factors = [
        _inverse((start.T_link_it, start.twists)),
        *_fixed_joints(c, start, end),
        (end.T_link_it, end.twists),
    ]
    pose = np.eye(4)
    twists = np.zeros((6, len(c.model)))
    for T, of_factor in factors:
        # The twists so far are carried past this factor.
        twists = _adjoint(rigid_inverse(T)) @ twists + of_factor
        pose = pose @ T
    along_axes = np.concatenate([pose[:3, :3] @ twists[:3], pose[:3, :3] @ twists[3:]])
    by_scale = along_axes @ c.geometry.change_by_scale
    covariance = along_axes @ c.covariance @ along_axes.T + np.outer(by_scale, by_scale)
    return Transform(from_name, to_name, read_only(pose), read_only(covariance))


def find(c: Calibration, name: str) -> Placed:
    """Return what has a name, in the order station, target, robot, link.

    Args:
        c: The result.
        name: The name; ``"station:left"`` names a station if something else is called left too.

    Raises:
        ModelError: There is nothing of that name, two things have it, or no row determines its pose.
    """
    urdf = c.robot.urdf
    stations = {group or ONLY_FRAME: f for f, group in enumerate(c.setup.groups)}
    targets = {target: t for t, target in enumerate(c.setup.targets)}
    robots = {part.name: part for part in c.robot.parts if part.name}
    names: dict[str, Collection[str]] = {
        STATION: stations,
        TARGET: targets,
        ROBOT: robots,
        LINK: urdf.links,
    }
    what, colon, after = name.partition(":")
    kinds = [kind for kind, known in names.items() if name in known]
    if not kinds and colon and what in names and after in names[what]:
        kinds, name = [what], after
    if not kinds:
        known = [*stations, *targets, *robots, *urdf.links]
        further = f"further robots {choices(robots)}, " if robots else ""
        raise ModelError(
            f"There is no station, target, robot or link '{name}'{did_you_mean(name, known)}; stations are "
            f"{choices(stations)}, targets {choices(targets)}, {further}links {choices(urdf.links)}."
        )
    if len(kinds) > 1:
        ways = choices(f"{kind}:{name}" for kind in kinds)
        raise ModelError(f"'{name}' is the name of more than one thing. Give one of {ways}.")

    if kinds == [STATION]:
        return _station(c, stations[name])
    if kinds == [TARGET]:
        return _target(c, targets[name])
    link = name
    if kinds == [ROBOT]:
        link = f"{name}{SEPARATOR}{robots[name].urdf.root}"
    return Placed(name, kinds[0], link, np.eye(4), np.zeros((6, len(c.model))))


def body_of(c: Calibration, link: str) -> str:
    """Return the link that stands for the rigid body of a link: the one nearest to the root."""
    urdf = c.robot.urdf
    _, way = urdf.chain(urdf.root, link)
    for name in reversed(way):
        joint = urdf.joint(name)
        if joint.type != "fixed":
            break
        link = joint.parent
    return link


def known_transforms(c: Calibration) -> Iterator[Transform]:
    """Yield the transforms of a result that has several frames, several robots, or several oriented targets on a body.

    They are each further robot in the link that the first one stands on, each frame in its link, and each frame and
    each target with an orientation in the first one on its body. Of one robot with one frame there are none.
    """
    setup = c.setup
    mounts = [part for part in c.robot.parts if part.name and part.mount in c.robot.mounts]
    frames = [f for f in range(len(setup.groups)) if has_pose(c, f)]
    boards = range(len(setup.targets)) if setup.oriented else range(0)
    placed = [
        [_station(c, f) for f in frames],
        [_target(c, t) for t in boards if _is_known(c, target=t)],
    ]
    if len(frames) < 2 and len(boards) < 2 and not mounts:
        return
    for part in mounts:
        yield transform(c, f"{LINK}:{c.robot.urdf.root}", f"{ROBOT}:{part.name}")
    for one in placed[0]:
        yield transform(c, f"{LINK}:{one.link}", f"{STATION}:{one.name}")
    for things in placed:
        first_of: dict[str, Placed] = {}
        for one in things:
            first = first_of.setdefault(body_of(c, one.link), one)
            if first is not one:
                yield transform(c, f"{one.what}:{first.name}", f"{one.what}:{one.name}")


def plain_name(name: str) -> str:
    """Return a name without the word that says what it is: ``left`` of ``station:left``."""
    return name.partition(":")[2] or name


def has_pose(c: Calibration, f: int) -> bool:
    """Return whether frame f, by its number, has a pose: given, or by rows that measure places in it, and known here.

    The frame of a socket, an anchor or a plane has a point or a plane alone.
    """
    pairs = zip(c.rows.kinds, c.rows.groups, strict=True)
    kinds = {kind for kind, group in pairs if group == c.setup.groups[f]}
    present = [registry.get(kind) for kind in kinds]
    tells_place = any(kind.tells_place or kind.is_image for kind in present)
    return bool(c.setup.frame_given[f] or tells_place) and _is_known(c, frame=f)


def _is_known(c: Calibration, frame: int | None = None, target: int | None = None) -> bool:
    """Return whether a frame or a target was given or fitted, and not merely registered to validation rows."""
    frames, targets = c.setup.places
    if frame is not None:
        estimated, place = bool(c.setup.unknown[frame]), frames[frame]
    else:
        index = target or 0
        estimated, place = bool(c.setup.target_unknown[index]), targets[index]
    return not estimated or any(parameter.place == place for parameter in c.model.parameters)


def _station(c: Calibration, f: int) -> Placed:
    """Return the measurement frame f, by its number; ModelError if no row determines its pose."""
    setup = c.setup
    name = setup.groups[f] or ONLY_FRAME
    if not has_pose(c, f):
        raise ModelError(
            f"The rows of the station '{name}' do not determine the pose of its frame: sockets, anchors and planes "
            "have none, pairs tell no place, and validation rows alone fit nothing."
        )
    link = setup.frame_links[f] if setup.frame_links else c.nominal.base
    T_link_frame, twists = _inverse((setup.T_frame_base[f], _twists_at(c, setup.places[0][f])))
    return Placed(name, STATION, link, T_link_frame, twists)


def _target(c: Calibration, t: int) -> Placed:
    """Return the target t, by its number; ModelError if it was only registered to validation rows."""
    setup = c.setup
    if not _is_known(c, target=t):
        raise ModelError(
            f"The target '{setup.targets[t]}' occurs in validation rows alone, which fit nothing."
        )
    link = setup.target_links[t] if setup.target_links else c.nominal.tip
    twists = _twists_at(c, setup.places[1][t])
    return Placed(setup.targets[t], TARGET, link, setup.T_tip_target[t], twists)


def _twists_at(c: Calibration, place: str) -> Array:
    """Return the twists at a place of the geometry's model by a unit of each parameter, (6, p), at the estimate."""
    model = c.model
    if place not in model.places:
        return np.zeros((6, len(model)))
    _, twists = model.displacements(c.geometry.x)
    return np.asarray(twists.reshape(len(model.places), 6, -1)[model.places.index(place)])


def _fixed_joints(c: Calibration, start: Placed, end: Placed) -> Iterator[_Factor]:
    """Yield the fixed joints between the links of two things; ModelError if one of them moves."""
    urdf = c.robot.urdf
    upwards, downwards = urdf.chain(start.link, end.link)
    moving = [name for name in (*upwards, *downwards) if urdf.joint(name).type != "fixed"]
    if moving:
        raise ModelError(
            f"'{start.name}' is on '{start.link}' and '{end.name}' on '{end.link}': the joints {choices(moving)} move "
            "between them, so that there is no constant transform. calib.Calibration.predict_poses has that at joint "
            "values."
        )
    for name in reversed(upwards):
        yield _inverse(_origin(c, name))
    for name in downwards:
        yield _origin(c, name)


def _origin(c: Calibration, name: str) -> _Factor:
    """Return the calibrated origin of a fixed joint, and its twists by a unit of each parameter."""
    T = np.asarray(c.robot.urdf.joint(name).T_parent_joint)
    if name in c.nominal.mounts:
        return T, _twists_at(c, name)
    # It may carry the placement of a limb's end, P = before O after, or before O^-1 after.
    for limb in c.nominal.limbs:
        if name in limb.carriers and name in limb.path:
            factors = limb.path[name].factors
            k = limb.path[name].placement
            place = limb.joints[k].name if k < len(limb.joints) else TIP
            twists = _adjoint(factors.after) @ _twists_at(c, place)
            if factors.inverted:
                twists = -_adjoint(rigid_inverse(T)) @ twists
            return T, twists
    return T, np.zeros((6, len(c.model)))


def _inverse(factor: _Factor) -> _Factor:
    """Return the inverse of a pose with its twists."""
    T, twists = factor
    return rigid_inverse(T), -_adjoint(T) @ twists


def _adjoint(T: Array) -> Array:
    """Return Ad(T), (6, 6), which carries a twist from the end of T to its start."""
    return np.asarray(pin.SE3(T).toActionMatrix())


def _largest(covariance: Array) -> float:
    """Return the largest standard deviation of any direction."""
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))
