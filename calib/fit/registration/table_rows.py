"""A table as the arrays of a fit: its rows, and the measurement setup that the cell states for it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import compress

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Array, Integers, numbered, read_only
from calib.basics.channels import RESIDUAL_UNITS
from calib.data.cell import AUTO, Cell
from calib.data.cell_chains import links_of
from calib.data.kinds import Kind
from calib.data.measurements import Measurements
from calib.data.stops import stop_links, stop_poses
from calib.errors import MeasurementError, ModelError, choices
from calib.fit.registration.labels import joined_labels, same_poses
from calib.fit.registration.rows import NONE, Rows
from calib.fit.registration.setup import Setup
from calib.instruments.internals import initial_internals
from calib.model.families import FAMILIES
from calib.model.kinematics import Samples
from calib.model.parameter_sets import DIRECTIONS, split_name
from calib.robot.gravity import check_masses, gravity_loads
from calib.robot.robot import Robot


def rows_and_setup(robot: Robot, measurements: Measurements, cell: Cell) -> tuple[Rows, Setup]:
    """Convert a table to the arrays of a fit.

    Args:
        robot: The nominal robot, whose joints the table's columns are.
        measurements: The table, N rows of all sets.
        cell: Frames, targets and noise as given.

    Returns:
        All N rows, in the table's order, and the measurement setup, not yet registered. Sigma is the row's, else the
        cell's, else an assumed one. Loads on the joints are None if no family of the cell's model depends on them.

    Raises:
        MeasurementError: A pair has one row only, the table lacks a joint of the robot, or what is known of an
            instrument is not enough or contradicts its rows.
        ModelError: The cell names a group or target that the table lacks.
    """
    q = measurements.joints_for(robot.joint_names)
    pose = same_poses(q)
    # Kinds in the order in which they were registered.
    occurring = set(measurements.kinds)
    kinds = tuple(registry.get(name) for name in registry.names() if name in occurring)
    kind = numbered(measurements.kinds, [kind.name for kind in kinds])

    # The other row of each pair, at both its rows; -1 at all other rows.
    partner = np.full(len(measurements), -1)
    first, second = measurements.pair_rows.T
    partner[first] = second
    partner[second] = first
    alone = np.flatnonzero(measurements.paired & (partner < 0))
    if len(alone):
        i = int(alone[0])
        raise MeasurementError(
            f"{measurements.source or 'Measurements'}, row {measurements.rows[i]}: the pair "
            f"'{measurements.pairs[i]}' has one row only in this set."
        )
    # Of a pair the earlier row has the kind, the measurement and a partner; the later one has `NONE` and no partner.
    later = (partner >= 0) & (partner < np.arange(len(measurements)))
    kind[later] = NONE
    partner = np.where(kind == NONE, -1, partner)

    setup = measurement_setup(robot, cell, measurements, kinds, kind)
    setup, internals = with_internals(setup, measurements, cell, pose)
    # Loads of the joints take time to compute: only if a model that may be fitted depends on them.
    needs_loads = cell.model == AUTO
    if not needs_loads:
        _, families = split_name(cell.model)
        needs_loads = any(FAMILIES[family].loaded for family in families)
        if "compliance" in families and measurements.torques is None:
            check_masses(robot, cell.model)
    frame = numbered(measurements.groups, setup.groups)
    target = numbered(measurements.targets, setup.targets)
    chain = setup.chains(robot, frame, target)
    for index, robot_chain in enumerate(robot.chains):
        moving = np.any(robot_chain.mimic_matrix @ robot.reading_matrix, axis=0)
        needed = [name for name, moves in zip(robot.joint_names, moving, strict=True) if moves]
        of_chain = np.ones(len(q), dtype=bool) if chain is None else chain == index
        measurements.check_joints_of(needed, of_chain)
    samples = Samples(
        q=q,
        frame=frame,
        target=target,
        load=joint_loads(robot, measurements, cell, q) if needs_loads else None,
        internals=internals,
        moves=measurements.moves_for(robot.joint_names),
        chain=chain,
    )

    # Standard deviation of one scalar of each row by unit: the row's, else the cell's, else the assumed one.
    sigma = {}
    stated = measurements.stated_sigma
    for symbol, unit in RESIDUAL_UNITS.items():
        general = np.full(len(measurements), cell.sigma.get(symbol, unit.assumed_sigma))
        by_row = stated.get(symbol, np.full(len(measurements), np.nan))
        sigma[symbol] = np.where(np.isfinite(by_row), by_row, general)

    pairs = [(int(i), int(partner[i])) for i in np.flatnonzero(partner >= 0)]
    rows = Rows(
        samples=samples,
        kinds=kinds,
        kind=kind,
        measured=_measured(measurements, kinds, kind),
        partner=partner,
        sigma=sigma,
        covariances=measurements.covariances,
        poses=_repeats(pose, samples, kinds, kind, partner),
        blocks=joined_labels(pose, pairs),
    )
    return rows, setup


def joint_loads(robot: Robot, measurements: Measurements, cell: Cell, q: Array) -> Array:
    """Return the load on each joint, which bends it: measured torques if there are any, else gravity and payload.

    Args:
        robot: The nominal robot, with n joints.
        measurements: Table of N rows; its torques [Nm] or forces [N] are those of the drives, which hold against the
            load, so that the load is minus them. Where one is NaN, gravity and payload count.
        cell: Payload and gravity.
        q: shape (N, m), joint values of the rows in the robot's order [rad] or [m].

    Returns:
        shape (N, n, n + 3), [Nm] or [N], see `calib.robot.gravity.gravity_loads`; measured torques replace the first
        column, [:, :, 0], alone.
    """
    load = gravity_loads(robot, q, cell.payload, cell.gravity)
    if measurements.torques is None:
        return load
    for name, torque in zip(measurements.joint_names, measurements.torques.T, strict=False):
        for k, joint in enumerate(robot.all_joints):
            if joint.name == name:
                load[:, k, 0] = np.where(np.isfinite(torque), -torque, load[:, k, 0])
    return load


def _repeats(
    pose: Integers,
    samples: Samples,
    kinds: tuple[Kind, ...],
    kind_of_row: Integers,
    partner: Integers,
) -> Integers:
    """Number the rows so that repeats, of one pose, frame, target, point of it and kind, have one number, shape (N,).

    The robot's pose of each row, its kind, and the second row of its pair (-1 for none) are numbers, (N,). Repeats of a
    pair repeat both its rows.
    """
    poses = int(pose.max(initial=-1)) + 1
    if poses == len(pose):
        return pose  # no pose is repeated
    labels = np.column_stack([pose, samples.frame, samples.target, kind_of_row])
    for k, kind in enumerate(kinds):
        if kind.internals is not None and samples.internals is not None:
            point = samples.internals[:, kind.internals.point_number]
            labels = np.column_stack([labels, np.where(kind_of_row == k, point, 0.0)])
    labels_of_partner = np.where((partner >= 0)[:, None], labels[partner], -1)
    both = np.hstack([labels, labels_of_partner])
    _, number = np.unique(both, axis=0, return_inverse=True)
    return number.reshape(-1)


def _measured(measurements: Measurements, kinds: tuple[Kind, ...], kind_of_row: Integers) -> Array:
    """Measured values of each row, shape (N, K), as `Rows.measured`: point, rotation matrix by rows, readings.

    Each row has a kind, by its index, (N,), or `NONE`; K is the size of the largest.
    """
    size = max((kind.size for kind in kinds), default=0)
    result = np.zeros((len(measurements), size))
    for k, kind in enumerate(kinds):
        rows = kind_of_row == k
        parts = []
        if kind.position:
            parts.append(measurements.points[rows])
        if kind.orientation and measurements.rotations is not None:
            parts.append(measurements.rotations[rows].reshape(-1, 9))
        for reading in kind.readings:
            values = measurements.reading(reading.name)
            parts.append(values[rows, None])
        if parts:
            result[rows, : kind.size] = np.hstack(parts)
    return result


def measurement_setup(
    robot: Robot,
    cell: Cell,
    measurements: Measurements,
    kinds: tuple[Kind, ...],
    kind_of_row: Integers,
) -> Setup:
    """Make the setup of a table: poses as the cell gives them, identity if it gives none.

    Args:
        robot: Its base and tip are the links of frames and targets whose links the cell does not name.
        cell: Frames and targets that are given, and whether they are estimated.
        measurements: Table of N rows; its groups are the stations.
        kinds: The kinds of its rows.
        kind_of_row: shape (N,), index of each row's kind in ``kinds``; `NONE` for the second row of a pair.

    Returns:
        One frame for each group and one target for each name, in the order in which they first occur; not registered,
        and without internals of instruments.

    Raises:
        ModelError: The cell names a group or target that the table lacks.
    """
    groups = tuple(dict.fromkeys(measurements.groups))
    targets = tuple(dict.fromkeys(measurements.targets))
    _check_names(measurements, "group", cell.frames, groups)
    _check_names(measurements, "target", cell.targets, targets)

    group_of_row = np.array([groups.index(group) for group in measurements.groups])
    T_frame_base = np.tile(np.eye(4), (len(groups), 1, 1))
    unknown = []
    frame_given = []
    own_axes = []
    for g, group in enumerate(groups):
        of_group = np.unique(kind_of_row[group_of_row == g])
        locating = [kinds[k] for k in of_group.tolist() if k != NONE and kinds[k].directions]
        # Frames of sockets, planes and anchors are estimated unless the cell gives this group's.
        part_of_scene = group not in cell.frames and all(kind.own_frame for kind in locating)
        # Of the directions that its kinds of rows depend on.
        observable = {direction for kind in locating for direction in kind.directions}
        if part_of_scene:
            directions = tuple(d for d in DIRECTIONS if d in observable)
        elif cell.estimate_frame:
            directions = tuple(d for d in cell.frame_directions if d in observable)
        else:
            directions = ()
        given = cell.frames.get(group, cell.T_frame_base)
        if given is not None:
            T_frame_base[g] = given
        unknown.append(directions)
        frame_given.append(given is not None or not directions)
        own_axes.append(part_of_scene and any(kind.own_axes for kind in locating))

    positions = [cell.targets.get(name, cell.target) for name in targets]
    T_tip_target = np.tile(np.eye(4), (len(targets), 1, 1))
    for T, position in zip(T_tip_target, positions, strict=True):
        if position is not None:
            T[:3, 3] = position
        if cell.target_rotation is not None:
            T[:3, :3] = cell.target_rotation

    # Of each target the directions that its kinds of rows depend on.
    kinds_of_targets = set(zip(measurements.targets, measurements.kinds, strict=True))
    target_directions = []
    for name in targets:
        seen_by = [registry.get(kind) for target, kind in kinds_of_targets if target == name]
        observable = {direction for kind in seen_by for direction in kind.of_target}
        target_directions.append(tuple(d for d in DIRECTIONS if d in observable))
    is_stated = np.array([position is not None for position in positions])
    pairs = set(zip(measurements.groups, measurements.targets, strict=True))
    seen = [(groups.index(group), targets.index(target)) for group, target in pairs]
    for t in _common_heights(unknown, target_directions, seen):
        target_directions[t] = tuple(d for d in target_directions[t] if d != "z")
    is_located = np.array([bool(directions) for directions in target_directions])
    not_contacts = {
        target for target, kind in kinds_of_targets if not registry.get(kind).is_contact
    }
    in_contact = np.array([name not in not_contacts for name in targets])
    # A joint at its stop: its own two links, and poses that make its angle one about z.
    frame_links, target_links = map(list, links_of(cell, robot, groups, targets))
    target_unknown = is_located & cell.estimate_target
    target_given = is_stated | ~is_located
    for name in stopped_joints(measurements):
        g, t = groups.index(name), targets.index(name)
        frame_links[g], target_links[t] = stop_links(robot.urdf, name)
        T_frame_base[g], T_tip_target[t] = stop_poses(robot.urdf, name)
        target_unknown[t], target_given[t] = False, True

    rotation = any(kind.depends_on_orientation for kind in kinds)
    return Setup(
        groups=groups,
        targets=targets,
        T_frame_base=read_only(T_frame_base),
        T_tip_target=read_only(T_tip_target),
        unknown=tuple(unknown),
        frame_given=np.array(frame_given),
        target_unknown=target_unknown,
        target_given=target_given,
        target_directions=tuple(target_directions),
        target_prior=in_contact & is_stated,
        rotation_stated=cell.target_rotation is not None,
        rotation=rotation,
        own_axes=np.array(own_axes),
        oriented=cell.target_rotation is not None or rotation,
        frame_links=tuple(frame_links),
        target_links=tuple(target_links),
    )


def _common_heights(
    frame_directions: Sequence[Sequence[str]],
    target_directions: Sequence[Sequence[str]],
    seen: Collection[tuple[int, int]],
) -> list[int]:
    """Return targets, by number, whose height is not estimated, because it is that of the planes that they touch.

    If all planes and the faces that lie on them rise by one height, no row changes: of each such set one face keeps its
    height as stated, or is at its tip, unless that of a plane is known. ``seen`` has the numbers of frames and targets
    that occur together; the others are of each frame and each target.
    """
    frames = len(frame_directions)
    together = [(f, frames + t) for f, t in seen]
    label = joined_labels(np.arange(frames + len(target_directions)), together)
    free = ["z" in directions and "x" not in directions for directions in target_directions]
    rising = ["z" in directions for directions in frame_directions] + free
    result: dict[int, int] = {}
    for t, is_free in enumerate(free):
        of_set = np.flatnonzero(label == label[frames + t])
        if is_free and all(rising[k] for k in of_set):
            result.setdefault(int(label[frames + t]), t)
    return list(result.values())


def stopped_joints(measurements: Measurements) -> tuple[str, ...]:
    """Return the names of the joints that rows of a table have at a stop, each once."""
    of_joint = measurements.where(lambda kind: kind.of_joint).tolist()
    return tuple(dict.fromkeys(compress(measurements.targets, of_joint)))


def _check_names(
    measurements: Measurements,
    column: str,
    given: Collection[str],
    present: tuple[str, ...],
) -> None:
    """Raise `ModelError` for names that a cell gives and the table's column, "group" or "target", lacks."""
    missing = [name for name in given if name not in present]
    if missing:
        table = measurements.source or "Measurements"
        raise ModelError(
            f"{table}: the cell says where {choices(missing)} is; the table's column '{column}' has "
            f"{choices(present)}."
        )


def with_internals(
    setup: Setup, measurements: Measurements, cell: Cell, pose: Integers
) -> tuple[Setup, Array | None]:
    """Add the internals of the instruments to the setup of a table.

    Args:
        setup: The table's stations and targets.
        measurements: Table of N rows.
        cell: What is known of the instruments.
        pose: shape (N,), number of the robot's pose at each row.

    Returns:
        The setup, with the internals that are estimated; and the internals of each row before the fit, shape (N, c),
        None if the instruments have none.

    Raises:
        MeasurementError: What is known of an instrument is not enough, or contradicts its rows.
    """
    frames, targets = setup.places
    values, unknowns = initial_internals(
        measurements,
        cell,
        dict(zip(setup.groups, frames, strict=True)),
        dict(zip(setup.targets, targets, strict=True)),
        pose,
    )
    return replace(setup, internals=unknowns), values
