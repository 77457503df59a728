"""The robot of a cell: the chains from the links of its measurement frames to those of its targets."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

import calib.data.kinds as registry
from calib.basics.tables import Table
from calib.data.cell import Cell
from calib.data.columns import WORD_COLUMNS, name_columns
from calib.data.forms.column_options import ColumnsInput, column_options
from calib.data.references import split_references
from calib.data.stops import is_stop, stop_links
from calib.errors import ModelError, UrdfError, choices, did_you_mean
from calib.robot.default_tip import SeveralArmsError, farthest_link
from calib.robot.joined_urdf import Part, joined_urdf
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf, read_urdf

#: A station and a target, by name.
Sight = tuple[str, str]

Entry = TypeVar("Entry")


def sights_of(
    table: Table, columns: ColumnsInput = None, kind: str | None = None
) -> tuple[Sight, ...]:
    """Return the stations and targets that occur together in the rows of a table, in the table's order.

    Args:
        table: The table.
        columns: What is said of its columns, as by ``--columns``; None: nothing.
        kind: The kind of all rows; None: as the table's column says. In rows of a joint at its stop it is station and
            target.

    Raises:
        MeasurementError: As of `name_columns`.
    """
    table, _ = split_references(table, columns)
    named, group_columns = name_columns(table, (), column_options(columns))
    _, default_target = WORD_COLUMNS["targets"]
    targets = [default_target] * len(table.cells)
    if "target" in named:
        targets = [word or default_target for word in table.column(named["target"])]
    groups = ["/".join(row[column.index] for column in group_columns) for row in table.cells]
    kinds = [kind or ""] * len(table.cells)
    if kind is None and "kind" in named:
        kinds = table.column(named["kind"])
    of_joint = {name for name in registry.names() if registry.get(name).of_joint}
    seen = zip(kinds, targets, groups, strict=True)
    groups = [target if name in of_joint else group for name, target, group in seen]
    return tuple(dict.fromkeys(zip(groups, targets, strict=True)))


def named_stations(cell: Cell, *, images: bool = False) -> tuple[str, ...]:
    """Return the stations that a cell names, in its order; ``("",)`` if it names none.

    Args:
        cell: The cell.
        images: Whether pictures are taken, so that its cameras are stations.
    """
    cameras = [name for name in cell.cameras if name] if images else []
    return tuple(dict.fromkeys((*cell.frames, *cell.bases, *cameras))) or ("",)


def named_targets(cell: Cell, *, images: bool = False) -> tuple[str, ...]:
    """Return the targets that a cell names, in its order; the name of a table's only target if it names none.

    Args:
        cell: The cell.
        images: Whether pictures are taken, so that its boards are targets.
    """
    boards = [name for name in cell.boards if name] if images else []
    named = tuple(dict.fromkeys((*cell.targets, *cell.tips, *boards)))
    return named or (WORD_COLUMNS["targets"][1],)


def links_of(
    cell: Cell, robot: Robot, stations: Iterable[str], targets: Iterable[str]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the links that stations, and those that targets are mounted on.

    Args:
        cell: Names links.
        robot: The robot of the cell, see `robot_of_cell`; its base and tip if the cell names none.
        stations: Names of the stations.
        targets: Names of the targets.
    """
    base, tip = robot.base, robot.tip
    if cell.bases or cell.tips:
        base, tip = cell.base or robot.urdf.root, cell.tip or robot.tip
    frame_links = tuple(cell.bases.get(name, base) for name in stations)
    return frame_links, tuple(cell.tips.get(name, tip) for name in targets)


def chain_numbers(
    robot: Robot, frame_links: Sequence[str], target_links: Sequence[str]
) -> dict[tuple[int, int], int]:
    """Return which stations see which targets, and through which chain, by its number in ``robot.chains``.

    Args:
        robot: The robot, which has a chain between two links if anything moves between them.
        frame_links: Link of each station.
        target_links: Link of each target.

    Returns:
        The chain by the numbers of station and target, those of the first station first.
    """
    numbers = {(chain.base, chain.tip): k for k, chain in enumerate(robot.chains)}
    pairs = itertools.product(enumerate(frame_links), enumerate(target_links))
    return {(f, t): numbers[base, tip] for (f, base), (t, tip) in pairs if (base, tip) in numbers}


def cell_of_sight(cell: Cell, station: str, target: str) -> Cell:
    """Return a cell with what it says of one station and one target, under no name.

    Args:
        cell: The cell.
        station: Name of the station; its frame and camera are kept, or those without a name.
        target: Name of the target; its place and board are kept, or those without a name.
    """

    def of(name: str, entries: Mapping[str, Entry]) -> dict[str, Entry]:
        """Return the entry of a name, or else that without one, if there is any."""
        found = entries.get(name, entries.get(""))
        return {} if found is None else {"": found}

    return replace(
        cell,
        T_frame_base=cell.frames.get(station, cell.T_frame_base),
        frames={},
        target=cell.targets.get(target, cell.target),
        targets={},
        cameras=of(station, cell.cameras),
        boards=of(target, cell.boards),
        bases={},
        tips={},
    )


def check_links_named(cell: Cell, sights: Iterable[Sight], source: str) -> None:
    """Refuse links that a cell names for stations or targets that a table lacks.

    Args:
        cell: Links of frames and targets.
        sights: Stations and targets of the table.
        source: The table's file.

    Raises:
        ModelError: The table lacks one.
    """
    groups, targets = zip(*sights, strict=True) if sights else ((), ())
    for option, column, given, present in (
        ("--base", "group", cell.bases, groups),
        ("--tip", "target", cell.tips, targets),
    ):
        for name, link in given.items():
            if name not in present:
                known = [word for word in dict.fromkeys(present) if word]
                if column == "target" and known == [WORD_COLUMNS["targets"][1]]:
                    known = []  # that of a table without the column
                has = f"column '{column}' has {choices(known)}{did_you_mean(name, known)}"
                if not known:
                    has = f"table has no column '{column}'"
                raise ModelError(
                    f"{source}: {option} {name}={link} names '{name}', but the {has}. Give {option} NAME=LINK for the "
                    f"names of that column, or {option} LINK for all rows."
                )


def check_arm_is_named(robot: Robot, cell: Cell) -> None:
    """Refuse the default tip if other arms end as far from the base, by a `UrdfError` that says what to type.

    Args:
        robot: The robot of the cell, whose joints are all to be measured.
        cell: Says which link the targets are on, or does not.
    """
    if cell.tip is None and not cell.tips:
        every_joint = [joint.name for joint in robot.urdf.joints]
        farthest_link(robot.urdf, robot.base, every_joint, cell.held)


def refuse_several_chains(cell: Cell, what: str) -> None:
    """Refuse a cell of several chains where one at a time is worked on.

    Args:
        cell: Links of frames and targets, and further robots.
        what: What is made of one chain, such as ``"calib workspace shows where a target gets"``.

    Raises:
        ModelError: It names links by station or target, or further robots.
    """
    if cell.tips or cell.bases or cell.robots:
        named = choices([*cell.bases, *cell.tips, *cell.robots])
        raise ModelError(
            f"{what} for one chain at a time, but links are named for {named}. Give --base LINK and --tip LINK of one "
            "hand, then of the next: the rest of the robot stands still."
        )


def robot_of_cell(
    urdf: Urdf,
    cell: Cell,
    measured: Collection[str] | None = None,
    sights: Iterable[Sight] | None = None,
) -> Robot:
    """Return the robot between the links of a cell, with the joints that the cell holds and couples.

    Args:
        urdf: The robot.
        cell: Links of frames and targets.
        measured: Names of the joints whose values are known, which decide a tip that the cell does not name.
        sights: Stations and targets that occur together; None: each station with each target that the cell names, if
            a joint moves them against each other.

    Returns:
        The robot: one chain, or one with a branch for each further pair of links.

    Raises:
        UrdfError: No such link or joint, or a chain that calib cannot take.
        ModelError: A target's link is not named, while those of others are, or none stands on a further robot.
    """
    robot = _robot_between_links(urdf, cell, measured, sights)
    reached = [link for chain in robot.chains for link in (chain.base, chain.tip)]
    for name in cell.robots:
        if not any(link.startswith(f"{name}/") for link in reached):
            raise ModelError(
                f"--other-robot {name}: no row reaches this robot: no frame or target stands on a link '{name}/...', "
                f"but all on {choices(dict.fromkeys(reached))}. Name the link of one, --tip NAME={name}/LINK or "
                f"--base NAME={name}/LINK, or leave the robot out."
            )
    return robot


def _robot_between_links(
    urdf: Urdf, cell: Cell, measured: Collection[str] | None, sights: Iterable[Sight] | None
) -> Robot:
    """Return the robot between the links of a cell; see `robot_of_cell`."""
    parts = tuple(
        Part(name, read_urdf(further.robot), estimated=further.estimated)
        for name, further in cell.robots.items()
    )
    if parts:
        mounts = {
            name: np.eye(4) if further.T_root_base is None else further.T_root_base
            for name, further in cell.robots.items()
        }
        first = Part("", urdf, estimated=False)
        urdf = joined_urdf(urdf, parts, mounts)
        parts = (first, *parts)
    _check_links_exist(cell, urdf)
    seen = tuple(sights or ())
    stops = [sight for sight in seen if is_stop(urdf, *sight)]
    if not cell.bases and not cell.tips and not stops:
        try:
            return Robot.from_urdf(
                urdf, cell.base, cell.tip, measured, cell.held, cell.coupling, parts=parts
            )
        except SeveralArmsError as e:
            targets = dict.fromkeys(target for _, target in seen)
            raise SeveralArmsError(e.source, e.tips, tuple(targets)) from None
    if not seen:  # without a table: of cameras and boards the cell has more names than of links
        stations = named_stations(cell, images=True)
        every = tuple(itertools.product(stations, named_targets(cell, images=True)))
        seen = tuple(sight for sight in every if _moves(urdf, cell, *sight)) or every
    ends: list[tuple[str, str | None]] = []
    if stops and len(stops) == len(seen):  # the arm itself is seen by no row
        ends.append((cell.base or urdf.root, cell.tip))
    # Chains of single joints come last.
    for group, target in sorted(seen, key=lambda sight: sight in stops):
        if (group, target) in stops:
            ends.append(stop_links(urdf, target))
            continue
        tip = cell.tips.get(target, cell.tip)
        if tip is None and cell.tips:
            raise ModelError(
                f"The table has the target '{target}', and no link is named for it, only for {choices(cell.tips)}. Add "
                f"--tip {target}=LINK; or, if the column 'target' is empty there, fill it in. The links are "
                f"{choices(urdf.links)}."
            )
        ends.append((cell.bases.get(group, cell.base or urdf.root), tip))
    (base, tip), *others = dict.fromkeys(ends)
    if not others:
        return Robot.from_urdf(urdf, base, tip, measured, cell.held, cell.coupling, parts=parts)
    if tip is None:  # the one tip of all frames is the farthest from the first
        tip = Robot.from_urdf(urdf, base, None, measured, cell.held, cell.coupling).tip
    branches = [(other_base, other_tip or tip) for other_base, other_tip in others]
    return Robot.from_urdf(
        urdf, base, tip, held=cell.held, coupling=cell.coupling, branches=branches, parts=parts
    )


def _moves(urdf: Urdf, cell: Cell, station: str, target: str) -> bool:
    """Return whether a joint that is not held moves a target against a station; yes if its link is not named."""
    base, tip = cell.bases.get(station, cell.base or urdf.root), cell.tips.get(target, cell.tip)
    if tip is None or not {base, tip} <= set(urdf.links):  # unknown links are refused later
        return True
    names = {name for names in urdf.chain(base, tip) for name in names}
    return any(urdf.joint(name).type != "fixed" and name not in cell.held for name in names)


def _check_links_exist(cell: Cell, urdf: Urdf) -> None:
    """Refuse links that a cell names for stations or targets and a URDF lacks, by a `UrdfError`."""
    for option, column, given in (("--base", "group", cell.bases), ("--tip", "target", cell.tips)):
        for name, link in given.items():
            if link in urdf.links:
                continue
            robot, slash, _ = link.partition("/")
            fix = f"The links are {choices(urdf.links)}."
            if slash and robot not in cell.robots:
                fix = f"If '{robot}' is another robot, name its URDF: --other-robot {robot}=URDF."
            raise UrdfError(
                f"{option} {name}={link}, for rows with '{name}' in the column '{column}': {urdf.source} has no link "
                f"'{link}'{did_you_mean(link, urdf.links)}. {fix}"
            )


def robot_with_chains_of(source: Robot, urdf: Urdf, held: Mapping[str, float]) -> Robot:
    """Return a robot of a URDF with the chains of another one, such as that of a result.

    Args:
        source: The other robot, whose base, tip, branches, coupled readings and further robots it gets.
        urdf: The URDF: of the whole cell, or of its first robot, which the further ones then join where they stand
            around ``source``.
        held: Values of joints that stay where they are [rad or m].

    Raises:
        UrdfError: It lacks a link or a joint.
    """
    further = tuple(part for part in source.parts if part.name)
    if any(part.mount not in {joint.name for joint in urdf.joints} for part in further):
        mounts = {part.name: source.urdf.joint(part.mount).T_parent_joint for part in further}
        urdf = joined_urdf(urdf, further, mounts)
    return Robot.from_urdf(
        urdf,
        source.base,
        source.tip,
        held=held,
        coupling=source.reading_coupling,
        branches=[(branch.base, branch.tip) for branch in source.branches],
        parts=source.parts,
    )
