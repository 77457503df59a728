"""Certainty: what a result says of how far to trust it, read back from its tables.

How sure a predicted pose of any tool is follows from the parameters' covariance C and the tool's velocity J in a unit
of each parameter (`calib.model.kinematics.Kinematics.twists`): std^2 = trace(J C J^T), of position and angle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.identify.coverage import OutsideRow, outside
from calib.identify.setup import turned_at
from calib.model.error_model import DIRECTIONS, error_model, placed_name
from calib.model.kinematics import Kinematics
from calib.model.parameters import FRAME, TARGET, target_place
from calib.model.robot import Robot, read_only

Array = NDArray[np.float64]

#: Values that stand for all those between the ends of a measured range.
_BETWEEN = 73


@dataclass(frozen=True, slots=True)
class Unseen:
    """The error on rows that the fit did not see.

    Attributes:
        rows: Which rows, in words.
        n: How many.
        mean: [m].
        rms: [m].
        max: [m].
    """

    rows: str
    n: int
    mean: float
    rms: float
    max: float


@dataclass(frozen=True, slots=True, eq=False)
class Certainty:
    """How far to trust a result.

    Attributes:
        use: The verdict; empty where there is none.
        reasons: Its reasons.
        unseen: The error on rows held back, else on left-out rows; None where there are neither.
        turned: Whether orientations were measured, and not positions alone.
        joints: Names of the measured joints.
        ranges: shape (m, 2), smallest and largest value of each joint in the rows that were fitted [rad] or [m].
        model: The set of parameters of the geometry.
        frozen: Parameters that were not estimated.
        ties: Parameters that follow others.
        names: The parameters.
        x: shape (p,), their corrections.
        covariance: shape (p, p), of ``x``.
    """

    use: str
    reasons: tuple[str, ...]
    unseen: Unseen | None
    turned: bool
    joints: tuple[str, ...]
    ranges: Array
    model: str
    frozen: tuple[str, ...]
    ties: Mapping[str, tuple[str, float]]
    names: tuple[str, ...]
    x: Array = field(repr=False)
    covariance: Array = field(repr=False)

    def pose_std(
        self,
        nominal: Robot,
        q: Array,
        T_tip_tool: Array,
        target: str | None = None,
        set_up: str | None = None,
    ) -> Array:
        """How sure it is where the calibrated robot puts a tool, as far as its covariance knows.

        Args:
            nominal: The robot that the result began with.
            q: shape (N, m), joint values [rad] or [m].
            T_tip_tool: shape (4, 4), the tool in the tip [m]; known exactly, unless it is a target.
            target: Name of the target that the tool is; its estimate is then part of what is not sure.
            set_up: Name of the set-up in whose frame the pose is asked for; where it stands is part of it, too. None:
                in the base.

        Returns:
            shape (N, 2), standard deviations: of the position [m], of the angle [rad].

        Raises:
            ModelError: The robot has not the parameters of the result.
        """
        # The only target of a table without names has parameters without one.
        named = target if target and placed_name("target", "x", target) in self.names else ""
        model = error_model(
            nominal,
            self.model,
            frame=False if set_up is None else self._frame(set_up),
            target=target is not None,
            targets=(named,),
            rotation=placed_name("target", "rx", named) in self.names,
        )
        # Targets are found along the tip's axes.
        model = turned_at(model, {target_place(named): T_tip_tool[:3, :3].T}, ("m",))
        there = model.names
        model = model.tied({n: t for n, t in self.ties.items() if n in there and t[0] in there})
        model = model.without([name for name in model.names if name not in self.names])
        chosen = [self.names.index(name) for name in model.names]
        kinematics = Kinematics(nominal, model, np.eye(4), T_tip_tool)
        # The tool stands where the target was found already; where the frame stands is no matter to a distance.
        x = np.where(model.family(TARGET, FRAME), 0.0, self.x[chosen])
        _, twists = kinematics.twists(x, q)
        covariance = self.covariance[np.ix_(chosen, chosen)]
        variance = np.einsum("nij,jk,nik->ni", twists, covariance, twists)
        return read_only(np.sqrt(variance.reshape(-1, 2, 3).sum(axis=2)))

    def _frame(self, set_up: str) -> dict[str, tuple[str, ...]]:
        """The directions of a set-up's frame that were estimated, under the name that its parameters have."""
        named = (
            set_up if any(placed_name("frame", d, set_up) in self.names for d in DIRECTIONS) else ""
        )
        found = tuple(d for d in DIRECTIONS if placed_name("frame", d, named) in self.names)
        return {named: found}

    def outside(self, robot: Robot, q: Array) -> tuple[OutsideRow, ...]:
        """Joint values outside of the range that the fit has seen, where errors may be larger than expected.

        Args:
            robot: The robot.
            q: shape (N, m), joint values [rad] or [m].
        """
        if not np.isfinite(self.ranges).all():
            return ()
        seen = np.linspace(self.ranges[:, 0], self.ranges[:, 1], _BETWEEN)
        return outside(seen, q, self.joints, [robot.joint_types[name] for name in self.joints])


def certainty_of(table: Mapping[str, Any]) -> Certainty:
    """What a result's tables say of how far to trust it.

    Args:
        table: See `calib.identify.result_file.read_table`.

    Raises:
        KeyError, TypeError, ValueError: Something is missing or of another kind.
    """
    parameters, model, robot = table["parameters"], table["model"], table["robot"]
    verdict, count = table["verdict"], len(table["parameters"])
    ranges = [[one["low"], one["high"]] for one in robot["ranges"]]
    return Certainty(
        use="" if verdict is None else str(verdict["use"]),
        reasons=() if verdict is None else tuple(map(str, verdict["reasons"])),
        unseen=_unseen(table),
        turned=any(row["kind"] == "pose" for row in table["rows"]),
        joints=tuple(map(str, robot["joints"])),
        ranges=read_only(np.array(ranges, dtype=np.float64).reshape(len(robot["joints"]), 2)),
        model=str(model["set"]),
        frozen=tuple(map(str, model["frozen"])),
        ties={str(t["name"]): (str(t["other"]), float(t["factor"])) for t in model["ties"]},
        names=tuple(str(one["name"]) for one in parameters),
        x=read_only([float(one["delta"]) for one in parameters]),
        covariance=read_only(np.array(table["covariance"], dtype=np.float64).reshape(count, count)),
    )


def _unseen(table: Mapping[str, Any]) -> Unseen | None:
    """The error on rows held back; where there are none, on left-out rows, outliers aside."""
    held_back = table["errors"]["calibrated"]["validation"]
    validated = table["cross_validation"]
    for rows, errors in (
        ("rows held back", held_back),
        ("left-out rows", None if validated is None else validated["without_outliers"]),
    ):
        if errors is not None and errors["n"]:
            n, *lengths = (errors[key] for key in ("n", "mean_m", "rms_m", "max_m"))
            return Unseen(rows, int(n), *map(float, lengths))
    return None
