"""A table's rows and set-up as the fit takes them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

import calib.kinds as registry
from calib.errors import MeasurementError, ModelError, choices
from calib.families import FAMILIES
from calib.identify.estimate import FIRST_SIGMA, FIRST_SIGMA_ANGLE
from calib.identify.problem import KnownDistance
from calib.identify.rows import NONE, Rows
from calib.identify.setup import Setup, setup_of
from calib.identify.statistics import same_poses
from calib.measure.cell import AUTO, Cell
from calib.measure.measurements import Measurements
from calib.model.error_model import split_name
from calib.model.kinematics import Samples
from calib.model.robot import Robot
from calib.model.torques import gravity_load

Array = NDArray[np.float64]


def rows_of(robot: Robot, measurements: Measurements, cell: Cell) -> tuple[Rows, Setup]:
    """All rows of a table, for a robot and a set-up.

    Raises:
        MeasurementError: A joint's column is missing, or a pair has lost its other row.
        ModelError: The cell names a set-up or target that the table lacks.
    """
    m, count = measurements, len(measurements)
    q = m.joints_for(robot.joint_names)
    kinds = _numbers(m.kinds, registry.names())
    partner = _partners(m)
    # Of a pair the earlier row carries what was measured, and the later one nothing more.
    kinds[(partner >= 0) & (partner < np.arange(count))] = NONE
    partner = np.where(kinds == NONE, -1, partner)
    setup = setup_of(cell, m, kinds)
    blocks = same_poses(q)
    samples = Samples(
        q=q,
        frame=_numbers(m.groups, setup.groups),
        target=_numbers(m.targets, setup.targets),
        load=_load(robot, m, cell, q) if _load_counts(cell) else None,
    )
    rows = Rows(
        samples=samples,
        kinds=kinds,
        measured=_measured(m, kinds),
        partner=partner,
        sigma=_sigma(m.sigma, cell.sigma, FIRST_SIGMA, count),
        sigma_angle=_sigma(m.sigma_angle, cell.sigma_angle, FIRST_SIGMA_ANGLE, count),
        poses=_repeats(blocks, samples, kinds, partner),
        blocks=_joined(blocks, [(int(i), int(partner[i])) for i in np.flatnonzero(partner >= 0)]),
    )
    return rows, setup


def known_distances(cell: Cell, setup: Setup) -> tuple[KnownDistance, ...]:
    """The cell's known distances between set-ups, by the numbers of their frames; a "*" stands for any text.

    Raises:
        ModelError: A distance fits no two set-ups of the table.
    """
    result: list[KnownDistance] = []
    for known in cell.distances:
        pairs = known.pairs(setup.groups)
        if not pairs:
            raise ModelError(
                f"A distance is stated between the groups '{known.first}' and '{known.second}', which fits no two of "
                f"{choices(setup.groups)}."
            )
        result += [
            KnownDistance(setup.groups.index(a), setup.groups.index(b), known.length, known.sigma)
            for a, b in pairs
        ]
    return tuple(result)


def joined_setups(rows: Rows, distances: Sequence[KnownDistance]) -> NDArray[np.int_]:
    """The set-up of each row, those with a known distance between them taken for one, shape (N,)."""
    frames = np.arange(int(rows.samples.frame.max()) + 1)
    return _joined(frames, [(d.first, d.second) for d in distances])[rows.samples.frame]


def _repeats(
    blocks: NDArray[np.int_],
    samples: Samples,
    kinds: NDArray[np.int_],
    partner: NDArray[np.int_],
) -> NDArray[np.int_]:
    """A number for each pose, frame, target and kind, and of a pair for those of both its rows, shape (N,)."""
    if int(blocks.max(initial=-1)) + 1 == len(blocks):
        return blocks  # no pose twice
    own = np.column_stack([blocks, samples.frame, samples.target, kinds])
    other = np.where((partner >= 0)[:, None], own[partner], -1)
    return np.unique(np.hstack([own, other]), axis=0, return_inverse=True)[1].reshape(-1)


def _numbers(words: Sequence[str], names: Sequence[str]) -> NDArray[np.int_]:
    """The number of each word among some names, shape (N,)."""
    if len(set(words)) == 1:
        return np.full(len(words), names.index(words[0]))
    number = {name: i for i, name in enumerate(names)}
    return np.array([number[word] for word in words], dtype=np.int_)


def _joined(labels: NDArray[np.int_], pairs: Sequence[tuple[int, int]]) -> NDArray[np.int_]:
    """Labels after joining those of some pairs of entries, numbered from 0 in order."""
    if not len(pairs):
        return np.unique(labels, return_inverse=True)[1].reshape(-1)
    count = int(labels.max()) + 1
    one, other = labels[np.array(pairs)].T
    graph = coo_matrix((np.ones(len(one)), (one, other)), shape=(count, count))
    _, component = connected_components(graph, directed=False)
    # By the smallest label of each component, as if each pair's larger one had been renamed.
    smallest = np.full(count, count)
    np.minimum.at(smallest, component, np.arange(count))
    joined = smallest[component[labels]]
    return np.unique(joined, return_inverse=True)[1].reshape(-1)


def _measured(m: Measurements, kinds: NDArray[np.int_]) -> Array:
    """What was measured, as `calib.identify.rows.Rows` has it, shape (N, K)."""
    present = [
        (registry.at(int(k)), np.flatnonzero(kinds == k)) for k in np.unique(kinds) if k != NONE
    ]
    result = np.zeros((len(m), max((kind.size for kind, _ in present), default=0)))
    for kind, rows in present:
        parts = [m.points[rows]] if kind.position else []
        if kind.orientation and m.rotations is not None:
            parts.append(m.rotations[rows].reshape(-1, 9))
        parts += [m.reading(one.name)[rows, None] for one in kind.readings]
        result[rows, : kind.size] = np.hstack(parts) if parts else 0.0
    return result


def _partners(m: Measurements) -> NDArray[np.int_]:
    """The other row of each pair, shape (N,); -1 where there is none."""
    partner = np.full(len(m), -1)
    one, other = m.pair_rows.T
    partner[one], partner[other] = other, one
    alone = np.flatnonzero(m.paired & (partner < 0))
    if len(alone):
        i = int(alone[0])
        raise MeasurementError(
            f"{m.source or 'Measurements'}, row {m.rows[i]}: the pair '{m.pairs[i]}' has one row only. A measurement "
            "between two rows needs both of them, in the same set."
        )
    return partner


def _load_counts(cell: Cell) -> bool:
    """Whether a model may be fitted that asks for the load on the joints, which takes its time to work out."""
    return cell.model == AUTO or any(FAMILIES[f].loaded for f in split_name(cell.model)[1])


def _load(robot: Robot, m: Measurements, cell: Cell, q: Array) -> Array:
    """The load on each joint: by gravity and payload, and measured where there are torques, shape (N, n)."""
    load = gravity_load(robot, q, cell.payload, cell.gravity)
    if m.torques is not None:
        names = [joint.name for joint in robot.joints]
        for column, name in enumerate(m.joint_names):
            if name in names:
                measured = -m.torques[:, column]  # the load is what the drive holds against
                own = load[:, names.index(name)]
                load[:, names.index(name)] = np.where(np.isfinite(measured), measured, own)
    return load


def _sigma(by_row: Array | None, by_cell: float | None, first: float, count: int) -> Array:
    """The standard deviation of each row: its own, the cell's, or the first guess, shape (N,)."""
    general = first if by_cell is None else by_cell
    if by_row is None:
        return np.full(count, general)
    return np.where(np.isfinite(by_row), by_row, general)
