"""Corners to touch, as `calib plan --touch` prints them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from calib.show.lines import fill
from calib.show.tables import Column, name_column, table_lines
from calib.verbs.plan.touch import ABOVE, SHARE
from calib.verbs.plan.touch_file import hand_last, in_table_units

if TYPE_CHECKING:
    from calib.basics.arrays import Array
    from calib.verbs.plan.touch import TouchPlan

_NOT_REACHED = "out of reach"
_COLLIDES = "the robot collides"


def touch_text(plan: TouchPlan) -> str:
    """Write which corners to touch and how, the error to expect, and what to do with it."""
    robot = plan.robot
    names = [robot.joint_names[k] for k in hand_last(robot)]
    head = (
        f"Corners of '{plan.board.name}' to touch with '{robot.name}', the board on '{robot.tip}'. Joint values in deg "
        f"(sliding joints in mm): {', '.join(names)}."
    )
    return "\n\n".join(
        [
            fill(head),
            "\n".join(table_lines(_columns(plan), _rows(plan))),
            *map(fill, _advice(plan)),
        ]
    )


def no_touch_text(plan: TouchPlan) -> str:
    """Word that no corner can be touched, why, and what to do."""
    counts = []
    out_of_reach = int((~plan.reached).sum())
    colliding = int((plan.reached & ~plan.free).sum())
    if out_of_reach:
        counts.append(f"{out_of_reach} {_NOT_REACHED}")
    if colliding:
        counts.append(f"{colliding} where {_COLLIDES}")
    return (
        f"None of {len(plan.corners)} corners of '{plan.board.name}' can be touched: {', '.join(counts)}. Take a "
        "longer --pointer or other --corners; where the board is below the robot's mounting plane, --no-floor."
    )


def _columns(plan: TouchPlan) -> list[Column]:
    """Return the columns of the table."""
    joints = [Column("", 7) for _ in plan.robot.joint_names]
    return [
        name_column("corner", 6),
        Column("x, y, z [mm]; error", 22),
        Column("", 5, left=True, gap=2),
        *joints,
    ]


def _rows(plan: TouchPlan) -> Iterator[list[str] | str]:
    """Yield two rows of each corner, above it and at it; one where it cannot be touched."""
    for k, corner in enumerate(plan.corners):
        place = " ".join(f"{1e3 * value:.1f}" for value in plan.places[k])
        if not plan.usable[k]:
            why = _COLLIDES if plan.reached[k] else _NOT_REACHED
            yield f"{corner:<6} {place:>22}  {why}"
            continue
        yield [str(corner), place, "above", *_values(plan, plan.above[k])]
        error = f"error {1e3 * plan.expected[k]:.2f} mm"
        yield ["", error, "touch", *_values(plan, plan.touching[k])]


def _values(plan: TouchPlan, q: Array) -> list[str]:
    """Format joint values (m,) [rad] or [m] from the foot to the hand."""
    values = in_table_units(plan.robot, q)[hand_last(plan.robot)]
    return [f"{value + 0.0:.2f}" for value in values]


def _advice(plan: TouchPlan) -> Iterator[str]:
    """Word what the table means, and how to use it."""
    yield (
        f"x, y, z: the corner in '{plan.robot.tip}', as calibrated. error: {100 * SHARE:.0f} % of robots come nearer "
        "to the corner than this, if the pointer is exactly where it was stated and the joint values are commanded as "
        "they are. An error of the pointer adds to it."
    )
    yield (
        f"First drive to 'above', {1e3 * ABOVE:.0f} mm in front of the corner, slowly, then straight on to 'touch'; "
        "stop as soon as the pointer touches. Neither the pointer nor the board is checked for collisions. If the "
        "pointer misses by much more than the error, do not use the calibration: the board or the camera may have "
        "moved."
    )
