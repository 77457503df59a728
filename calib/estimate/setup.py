"""Frames and targets of a table as a fit takes them, what of them is unknown, and the table's rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

import calib.data.kinds as registry
from calib.data.cell import AUTO, Cell
from calib.data.measurements import Measurements
from calib.errors import MeasurementError, ModelError, choices
from calib.estimate.rows import NONE, Rows, same_poses
from calib.model.error_model import DIRECTIONS, split_name
from calib.model.families import FAMILIES
from calib.model.kinematics import Samples
from calib.model.parameters import FRAME, TARGET, ErrorModel, Parameter
from calib.robot.gravity import gravity_loads
from calib.robot.robot import Robot, read_only
from calib.units import Array, Integers, Mask

#: The noise assumed until the data have told theirs [m], [rad].
FIRST_SIGMA, FIRST_SIGMA_ANGLE = 1e-4, 1e-3


class KnownDistance(NamedTuple):
    """A known distance between the origins of two frames, such as two sockets on one bar."""

    first: int  # Number of a frame
    second: int  # Number of the other
    length: float  # Their distance [m]
    sigma: float  # Its standard deviation [m]


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """Frames and targets, by the number that rows refer to them with."""

    groups: tuple[str, ...]  # Names of the set-ups; one frame each
    targets: tuple[str, ...]  # Names of the targets
    T_frame_base: Array  # (F, 4, 4), pose of the base in each frame [m]
    T_tip_target: Array  # (T, 4, 4), pose of each target in the tip [m]
    unknown: tuple[tuple[str, ...], ...]  # For each frame the directions that are estimated
    frame_given: Mask  # (F,), whether a frame's pose was given; else it is to be found
    target_unknown: Mask  # (T,), whether a target is estimated
    target_given: Mask  # (T,), whether a target's place was given
    rotation: bool  # Whether targets are frames, because orientations were measured, or points
    own_axes: Mask  # (F,), whether a frame's directions are along its own axes, or the base's
    oriented: bool = False  # Whether the targets' orientations are known, measured or given

    @property
    def frame_unknowns(self) -> Mapping[str, tuple[str, ...]]:
        """The estimated directions of each frame by its set-up's name; "" stands for the only one."""
        names = self.groups if len(self.groups) > 1 else ("",)
        return dict(zip(names, self.unknown, strict=True))

    @property
    def target_names(self) -> tuple[str, ...]:
        """The targets' names for their parameters; "" for the only one."""
        return self.targets if len(self.targets) > 1 else ("",)

    @property
    def places(self) -> tuple[list[str], list[str]]:
        """What an error model calls the places of the frames and of the targets."""
        frames = [FRAME + name for name in self.frame_unknowns]
        return frames, [TARGET + name for name in self.target_names]

    @property
    def estimate_target(self) -> bool:
        """Whether any target is estimated."""
        return bool(np.any(self.target_unknown))

    @property
    def unknown_targets(self) -> tuple[str, ...]:
        """The names of the targets that are estimated, as `target_names` has them."""
        return tuple(compress(self.target_names, self.target_unknown))

    @property
    def count(self) -> int:
        """Number of unknowns."""
        of_targets = (6 if self.rotation else 3) * int(np.sum(self.target_unknown))
        return of_targets + sum(map(len, self.unknown))

    def placed(self, T_frame_base: Array, T_tip_target: Array) -> Setup:
        """The same with frames and targets elsewhere."""
        frames, targets = read_only(T_frame_base), read_only(T_tip_target)
        return replace(self, T_frame_base=frames, T_tip_target=targets)

    def displaced(self, displacement: Array) -> Setup:
        """The same with the displacements of all places of an error model, shape (F + ... + T, 4, 4)."""
        return self.placed(
            self.T_frame_base @ displacement[: len(self.groups)],
            self.T_tip_target @ displacement[-len(self.targets) :],
        )

    def seen(self, T_base_tip: Array, samples: Samples) -> Array:
        """T_frame_target of samples with these poses of the tip, shape (N, 4, 4), [m]."""
        T_frame_tip = self.T_frame_base[samples.frame] @ T_base_tip
        return np.asarray(T_frame_tip @ self.T_tip_target[samples.target])

    def seen_by(self, samples: Samples) -> tuple[Mask, Mask]:
        """Which frames and which targets some samples see, shapes (F,) and (T,)."""
        frames = np.bincount(samples.frame, minlength=len(self.groups)) > 0
        return frames, np.bincount(samples.target, minlength=len(self.targets)) > 0

    def unknown_at(self, samples: Samples) -> Mask:
        """Which samples see an unknown frame or target, shape (N,)."""
        frames = np.array([bool(directions) for directions in self.unknown])
        return np.asarray(frames[samples.frame] | self.target_unknown[samples.target])

    def not_given(self, seen: Samples | None = None) -> Setup:
        """The same with what was given taken for known, and so what some samples see."""
        rest = self.as_known(self.frame_given, self.target_given)
        return rest if seen is None else rest.as_known(*rest.seen_by(seen))

    def as_known(self, frames: Mask, targets: Mask) -> Setup:
        """The same, with some frames and targets taken for known."""
        pairs = zip(frames, self.unknown, strict=True)
        unknown = tuple(() if known else directions for known, directions in pairs)
        return replace(self, unknown=unknown, target_unknown=self.target_unknown & ~targets)

    def aligned(self, model: ErrorModel) -> ErrorModel:
        """The model with a plane's frame moving along the plane's axes, and a target's position along the tip's.

        With the rotation R of T_frame_base the twist of a unit along one of the plane's own axes e is R^T e.
        """
        frames, targets = self.places
        own = zip(compress(frames, self.own_axes), self.T_frame_base[self.own_axes], strict=True)
        turned = {place: T[:3, :3].T for place, T in own}
        positions = dict(zip(targets, self.T_tip_target[:, :3, :3].swapaxes(1, 2), strict=True))

        def turn(one: Parameter) -> Parameter:
            R = turned.get(one.place, positions.get(one.place) if one.unit == "m" else None)
            if R is None or one.unit not in ("m", "rad") or np.array_equal(R, np.eye(3)):
                return one
            return replace(one, direction=read_only((R @ one.direction.reshape(2, 3).T).T.ravel()))

        parameters, terms = (tuple(map(turn, some)) for some in (model.parameters, model.terms))
        if parameters == model.parameters and terms == model.terms:
            return model
        return replace(model, parameters=parameters, terms=terms)


def setup_of(cell: Cell, measurements: Measurements, kinds: Integers) -> Setup:
    """What a cell says of the frames and targets of a table; `ModelError` for a name that the table lacks."""
    groups = tuple(dict.fromkeys(measurements.groups))
    targets = tuple(dict.fromkeys(measurements.targets))
    for column, named, known in (
        ("group", cell.frames, groups),
        ("target", cell.targets, targets),
    ):
        strange = [name for name in named if name not in known]
        if strange:
            raise ModelError(
                f"{measurements.source}: the cell says where {choices(strange)} is; the table's column '{column}' has "
                f"{choices(known)}."
            )
    unknown, frames, frame_given, own_axes = [], [], [], []
    of_group = np.array([groups.index(g) for g in measurements.groups])
    for g, group in enumerate(groups):
        present = [registry.at(k) for k in np.unique(kinds[of_group == g]).tolist() if k != NONE]
        seen = [kind for kind in present if kind.directions]
        given = cell.frames.get(group, cell.T_frame_base)
        # Sockets, planes and anchors are unknown where the cell does not give their group's frame.
        scene = all(kind.own_frame for kind in seen) and group not in cell.frames
        telling = [d for d in DIRECTIONS if any(d in kind.directions for kind in seen)]
        wanted = telling if scene else cell.frame_directions if cell.estimate_frame else ()
        unknown.append(tuple(d for d in wanted if d in telling))
        frames.append(np.eye(4) if given is None else given)
        frame_given.append(given is not None or not unknown[-1])
        own_axes.append(scene and any(kind.own_axes for kind in seen))
    T_tip_target = np.tile(np.eye(4), (len(targets), 1, 1))
    places = [cell.targets.get(name, cell.target) for name in targets]
    for T, place in zip(T_tip_target, places, strict=True):
        T[:3, 3] = 0.0 if place is None else place
        T[:3, :3] = np.eye(3) if cell.target_rotation is None else cell.target_rotation
    rotation = any(registry.at(k).angles for k in np.unique(kinds).tolist() if k != NONE)
    return Setup(
        groups=groups,
        targets=targets,
        T_frame_base=read_only(frames),
        T_tip_target=read_only(T_tip_target),
        unknown=tuple(unknown),
        frame_given=np.array(frame_given),
        target_unknown=np.full(len(targets), cell.estimate_target),
        target_given=np.array([place is not None for place in places]),
        rotation=rotation,
        own_axes=np.array(own_axes),
        oriented=cell.target_rotation is not None or rotation,
    )


def rows_of(robot: Robot, measurements: Measurements, cell: Cell) -> tuple[Rows, Setup]:
    """All rows of a table, for a robot and a set-up; `MeasurementError` where a pair has lost its other row."""
    m, count = measurements, len(measurements)
    q = m.joints_for(robot.joint_names)
    kinds, partner = _numbers(m.kinds, registry.names()), _partners(m)
    # Of a pair the earlier row carries what was measured, and the later one nothing more.
    kinds[(partner >= 0) & (partner < np.arange(count))] = NONE
    partner = np.where(kinds == NONE, -1, partner)
    setup = setup_of(cell, m, kinds)
    blocks = same_poses(q)
    # The load on the joints takes its time to work out: a model may be fitted that asks for it, or not.
    counts = cell.model == AUTO or any(FAMILIES[f].loaded for f in split_name(cell.model)[1])
    samples = Samples(
        q=q,
        frame=_numbers(m.groups, setup.groups),
        target=_numbers(m.targets, setup.targets),
        load=joint_loads(robot, m, cell, q) if counts else None,
    )

    def sigma(by_row: Array | None, by_cell: float | None, first: float) -> Array:
        general = np.full(count, first if by_cell is None else by_cell)
        return general if by_row is None else np.where(np.isfinite(by_row), by_row, general)

    poses = blocks
    if int(blocks.max(initial=-1)) + 1 < count:  # repeats: of one pose, frame, target and kind
        own = np.column_stack([blocks, samples.frame, samples.target, kinds])
        other = np.where((partner >= 0)[:, None], own[partner], -1)
        poses = np.unique(np.hstack([own, other]), axis=0, return_inverse=True)[1].reshape(-1)
    rows = Rows(
        samples=samples,
        kinds=kinds,
        measured=_measured(m, kinds),
        partner=partner,
        sigma=sigma(m.sigma, cell.sigma, FIRST_SIGMA),
        sigma_angle=sigma(m.sigma_angle, cell.sigma_angle, FIRST_SIGMA_ANGLE),
        poses=poses,
        blocks=_joined(blocks, [(int(i), int(partner[i])) for i in np.flatnonzero(partner >= 0)]),
    )
    return rows, setup


def known_distances(cell: Cell, setup: Setup) -> tuple[KnownDistance, ...]:
    """The cell's known distances between set-ups, by the numbers of their frames; a "*" stands for any text."""
    result: list[KnownDistance] = []
    for known in cell.distances:
        pairs = known.pairs(setup.groups)
        if not pairs:
            raise ModelError(
                f"A distance is stated between the groups '{known.first}' and '{known.second}'; the table's column "
                f"'group' has {choices(setup.groups)}."
            )
        for ends in pairs:
            a, b = map(setup.groups.index, ends)
            result.append(KnownDistance(a, b, known.length, known.sigma))
    return tuple(result)


def joined_setups(rows: Rows, distances: Sequence[KnownDistance]) -> Integers:
    """The set-up of each row, those with a known distance between them taken for one, shape (N,)."""
    pairs = [(d.first, d.second) for d in distances]
    # A distance may be to a frame that these rows do not see.
    last = max(int(rows.samples.frame.max()), *(max(pair) for pair in pairs), 0)
    return _joined(np.arange(last + 1), pairs)[rows.samples.frame]


def _numbers(words: Sequence[str], names: Sequence[str]) -> Integers:
    """The number of each word among some names, shape (N,)."""
    number = {name: i for i, name in enumerate(names)}
    return np.array([number[word] for word in words], dtype=np.int_)


def _joined(labels: Integers, pairs: Sequence[tuple[int, int]]) -> Integers:
    """Labels after joining those of some pairs of entries, numbered from 0 in order."""
    if len(pairs):
        count = int(labels.max()) + 1
        one, other = labels[np.array(pairs)].T
        graph = coo_matrix((np.ones(len(one)), (one, other)), shape=(count, count))
        # Components are numbered in the order of their smallest labels.
        labels = connected_components(graph, directed=False)[1][labels]
    return np.unique(labels, return_inverse=True)[1].reshape(-1)


def _measured(m: Measurements, kinds: Integers) -> Array:
    """What was measured, as `calib.estimate.rows.Rows` has it, shape (N, K)."""
    present = [(registry.at(k), kinds == k) for k in np.unique(kinds).tolist() if k != NONE]
    result = np.zeros((len(m), max((kind.size for kind, _ in present), default=0)))
    for kind, rows in present:
        parts = [m.points[rows]] if kind.position else []
        if kind.orientation and m.rotations is not None:
            parts.append(m.rotations[rows].reshape(-1, 9))
        parts += [m.reading(one.name)[rows, None] for one in kind.readings]
        result[rows, : kind.size] = np.hstack(parts) if parts else 0.0
    return result


def _partners(m: Measurements) -> Integers:
    """The other row of each pair, shape (N,); -1 where there is none."""
    partner = np.full(len(m), -1)
    one, other = m.pair_rows.T
    partner[one], partner[other] = other, one
    alone = np.flatnonzero(m.paired & (partner < 0))
    if len(alone):
        i = int(alone[0])
        raise MeasurementError(
            f"{m.source or 'Measurements'}, row {m.rows[i]}: the pair '{m.pairs[i]}' has one row only in this set."
        )
    return partner


def joint_loads(robot: Robot, m: Measurements, cell: Cell, q: Array) -> Array:
    """What loads each joint: gravity and payload, or what was measured where there are torques.

    Args:
        robot: The robot.
        m: The measurements, N of them.
        cell: Payload and gravity.
        q: shape (N, m), their joint values in the robot's order.

    Returns:
        shape (N, n, n + 3), see `calib.robot.gravity.gravity_loads`.
    """
    load = gravity_loads(robot, q, cell.payload, cell.gravity)
    torques = np.empty((0, 0)) if m.torques is None else m.torques.T
    for name, measured in zip(m.joint_names, torques, strict=False):
        for k, joint in enumerate(robot.joints):
            if joint.name == name:  # the load is what the drive holds against
                load[:, k, 0] = np.where(np.isfinite(measured), -measured, load[:, k, 0])
    return load
