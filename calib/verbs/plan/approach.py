"""Approach of the poses of a plan: from which side each joint comes, on which lost motion depends.

A joint with lost motion stops short by an angle that depends on the sign of its last move only. Straight from pose to
pose the signs are as good as random, and a fit finds lost motion beside the geometry. If the robot first goes to

    q_via = q - move

every joint arrives by ``move``. With the same move at every pose lost motion is a part of the joints' zeros: right for
a robot whose programs arrive so too, and unseen for all others. With both signs at every pose the difference of two
measurements is lost motion alone.
"""

from __future__ import annotations

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.numerics.moves import last_moves
from calib.robot.robot import Robot

#: Sides from which every pose is measured, as signs of the last moves; none: straight from the pose before.
SIDES = {"straight": (), "one": (1.0,), "both": (1.0, -1.0)}

#: Last move of a joint that turns [rad]: more than the play of a worn gear.
_TURN = np.radians(5.0)

#: Last move of a joint that slides [m].
_SLIDE = 0.02

#: Largest share of a joint's range that the last move takes.
_SHARE = 0.1


def approaches(robot: Robot, ranges: Array, approach: str) -> Array:
    """Return the moves by which the joints arrive at every pose.

    Args:
        robot: The robot, with m measured joints.
        ranges: Lowest and highest value of each joint, shape (m, 2), [rad] or for sliding joints [m].
        approach: One of `SIDES`.

    Returns:
        Shape (s, m), one row for each side, [rad] or [m]: 5 deg or 20 mm, and no more than a tenth of the range.
    """
    slides = np.array([joint.type == "prismatic" for joint in robot.inputs])
    lengths = np.minimum(np.where(slides, _SLIDE, _TURN), _SHARE * np.ptp(ranges, axis=1))
    return read_only(np.multiply.outer(np.array(SIDES[approach]), lengths))


def with_room(ranges: Array, moves: Array) -> Array:
    """Return the part of some ranges (m, 2) whose every value can be approached by moves (s, m) within them."""
    rise, fall = moves.max(axis=0, initial=0.0), moves.min(axis=0, initial=0.0)
    return np.column_stack([ranges[:, 0] + rise, ranges[:, 1] + fall])


def visits(q: Array, moves: Array) -> tuple[Array, Array]:
    """Return the poses (n, m) as they are visited, once from each side, and the last move of each joint there.

    Args:
        q: Joint values, shape (n, m), [rad] or for sliding joints [m].
        moves: Moves by which the joints arrive, shape (s, m); s = 0: straight from the pose before.

    Returns:
        Both of shape (n s, m), or (n, m) without sides: all visits of the first pose, then of the second, ...
    """
    if not len(moves):
        return q, last_moves(q)
    return np.repeat(q, len(moves), axis=0), np.tile(moves, (len(q), 1))


def side_name(move: Array) -> str:
    """Return the word for the side from which all joints approach a pose, by their last moves (m,)."""
    return "rising" if move[0] > 0.0 else "falling"
