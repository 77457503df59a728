"""Where a robot can be measured in its cell: the candidates that pass all conditions, and the ways between them.

A pose passes if the joints are within their ranges, the target is in the region, an instrument sees it, and nothing
collides there and on the last move to it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.basics.jobs import Progress
from calib.basics.values import Value
from calib.data.cell import Cell
from calib.errors import CalibError, ModelError, choices
from calib.instruments.instrument import Condition, Instrument
from calib.verbs.plan.approach import approaches, with_room
from calib.verbs.plan.bodies import collision_model, free_lines_of_sight
from calib.verbs.plan.choice import PlanRequest
from calib.verbs.plan.collision import CollisionCheck, CollisionModel
from calib.verbs.plan.pose_candidates import (
    Pool,
    combined,
    draw,
    draw_towards,
    joined_pools,
    planning_ranges,
)
from calib.verbs.plan.sensitivity import Sensitivity, View
from calib.verbs.workspace.region import Region

#: Number of poses among which those to drive by are looked for.
_STOPS = 4000


@dataclass(frozen=True, slots=True, eq=False)
class Ground(Value):
    """The poses at which a robot can be measured, and the ways between them."""

    #: The candidates.
    pool: Pool
    #: Shape (s, m), moves by which the joints arrive at each pose, see `calib.verbs.plan.approach.approaches`.
    sides: Array
    #: Shape (m, 2), between which the joints may move on the way, [rad] or [m].
    limits: Array
    #: The robot and its surroundings as shapes; None: collisions are not checked.
    body: CollisionModel | None

    def stops(self) -> Array:
        """Return poses of the workspace that are free of collision; the target need not be seen there."""
        first = self.pool.workspace[:_STOPS]
        return first if self.body is None else first[self.body.free(first)]


def reachable(
    sensitivity: Sensitivity,
    request: PlanRequest,
    region: Region | None = None,
    collisions: CollisionCheck | None = None,
    progress: Progress | None = None,
) -> Ground:
    """Draw the poses at which a robot can be measured in its cell.

    Args:
        sensitivity: The nominal robot in its cell.
        request: Number of candidates, margin to joint limits, approach and seed.
        region: Voxels of the robot's base frame in which the first target is to lie; None: anywhere.
        collisions: How poses are checked for collisions; None: they are not.
        progress: Called with the number of candidates so far, and that wanted; None: nothing is called.

    Returns:
        The candidates, with what moves between them need.

    Raises:
        CalibError: A region for several hands or for a camera.
        ModelError: No candidate that can be measured.
    """
    assert request.candidates is not None
    arm, cell, views = sensitivity.kinematics.robot, sensitivity.cell, sensitivity.views
    several = len(views) > 1
    if region is not None and several:
        raise CalibError(
            "--region is for the targets of one hand, and there are several: plan for one hand, or without it."
        )
    body = None
    if collisions is not None:
        body = collision_model(sensitivity.instrument, sensitivity, collisions)
    ranges = planning_ranges(arm, cell.ranges, request.margin)
    sides = approaches(arm, ranges, request.approach)
    ranges = with_room(ranges, sides)
    pools = []
    free = [*_body_conditions(body, sides)]
    conditions = [[*_sight_conditions(sensitivity, view, body)] for view in views]
    for v, (view, of_view) in enumerate(zip(views, conditions, strict=True)):
        wanted = -(-request.candidates // len(views))
        every = [*_region_condition(sensitivity, region), *of_view, *free]
        draws = (ranges, every, wanted, request.seed + v, progress)
        try:
            if view.instrument.VIEWPOINT_NUMBERS:
                (sightline,) = sensitivity.sightlines_of(view)
                pools.append(draw_towards(view.instrument, sightline, *draws))
            else:
                pools.append(draw(arm, *draws))
        except ModelError as error:
            if not several:
                raise
            raise ModelError(f"{_words_of(sensitivity, view)}: {error}") from error
    pool = pools[0]
    if several:
        both = pool.q[:0]
        if sensitivity.instrument.VIEWPOINT_NUMBERS:
            # At random poses a second camera or board is rarely seen.
            both = combined([arm.chains[view.chain] for view in views], pools, ranges)
        pool = joined_pools(arm, ranges, pools, conditions, both, free)
    # If errors depend on a joint's value, a pose one turn further is another pose.
    turns = not sensitivity.kinematics.model.joint_terms
    limits = with_room(planning_ranges(arm, cell.ranges, request.margin, turns=turns), sides)
    return Ground(pool, sides, limits, body)


def check_placed(cell: Cell) -> None:
    """Refuse a cell with a further robot of which nobody knows where it stands; raises `CalibError`."""
    for name, further in cell.robots.items():
        if further.T_root_base is None:
            raise CalibError(
                f"To plan for the robot '{name}' it must be known roughly where it stands: state xyz_mm and rpy_deg of "
                f"its root in that of the first robot in the table [robots.{name}] of the cell file."
            )


def _words_of(sensitivity: Sensitivity, view: View) -> str:
    """Word what a view measures: "board 'left' before camera 'head'", "target 'left', on 'hand'"."""
    setup, chain = sensitivity.setup, sensitivity.kinematics.robot.chains[view.chain]
    targets = choices([setup.targets[t] for t in view.targets])
    group = setup.groups[view.frame]
    if view.instrument.VIEWPOINT_NUMBERS:
        return f"board {targets} before camera '{group or chain.base}'"
    by = f" seen from '{group}'" if group else ""
    return f"target {targets} on '{chain.tip}'{by}"


def refuse_region(instrument: Instrument) -> None:
    """Refuse a region for an instrument with viewpoints, to which it does not apply; raises `CalibError`."""
    if instrument.VIEWPOINT_NUMBERS:
        raise CalibError("--region is for targets; where the board is seen is said by --board-at.")


def _region_condition(sensitivity: Sensitivity, region: Region | None) -> Iterator[Condition]:
    """Yield the condition that the first target is in a region; nothing without one (None).

    A region with an instrument that cannot have one raises `CalibError`.
    """
    if region is not None:
        refuse_region(sensitivity.instrument)
        robot, T_tip_target = sensitivity.kinematics.robot, sensitivity.setup.T_tip_target[0]
        yield Condition(
            "region", lambda q: region.contains((robot.poses(q) @ T_tip_target)[:, :3, 3])
        )


def _sight_conditions(
    sensitivity: Sensitivity, view: View, body: CollisionModel | None
) -> Iterator[Condition]:
    """Yield the conditions under which a view measures, the cheap ones first: instrument, then lines of sight."""
    yield from view.instrument.sees(sensitivity.sightlines_of(view))
    if body is not None:
        # A line of sight is one rod against all links; links among themselves take ten times as long.
        yield from free_lines_of_sight(sensitivity, body, view)


def _body_conditions(body: CollisionModel | None, sides: Array) -> Iterator[Condition]:
    """Yield the conditions that poses, and the ways to them from all sides, are free of collision."""
    if body is not None:
        yield Condition("collision", body.free)
        if len(sides):
            yield Condition("approach", partial(_approach_free, body, sides))


def _approach_free(body: CollisionModel, sides: Array, q: Array) -> Mask:
    """Test at which poses (n, m) the last moves, from all sides (s, m), are free; shape (n,).

    A move of a few degrees is tested where it begins and at each third; its end is the pose itself.
    """
    ways = [q - share * side for side in sides for share in (1.0, 2 / 3, 1 / 3)]
    return np.asarray(np.all([body.free(way) for way in ways], axis=0))
