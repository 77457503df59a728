"""What a comparison of two results found, as values."""

from __future__ import annotations

from dataclasses import dataclass

from calib.errors import ModelError
from calib.identify.compared import Compared
from calib.identify.differences import ParameterDifference, PlaceDifference
from calib.identify.drift import DriftTest
from calib.identify.moves import Move
from calib.model.robot import Robot


@dataclass(frozen=True, slots=True, eq=False)
class Facts:
    """What was found.

    Attributes:
        a: The first result.
        b: The second.
        outcome: ``"drift"``, ``"no drift shown"`` or ``"cannot tell"``.
        why: Why nothing can be told; empty otherwise.
        test: The test of the difference.
        moves: How far the target lies elsewhere: over the joint values that both data cover, then over the limits;
            empty without the URDF.
        shows_from: How far a drift of one joint's zero must move the target over the same joint values to be noticed 9
            times in 10, the worst joint's [m]; NaN without the URDF, or where no zero can be noticed.
        parameters: The robot's own, of either result.
        untold: Parameters that frame and target make up for, so that their drift cannot be told; without the URDF: not
            known.
        only_a: Parameters of the first that move the target in ways that the second's cannot.
        only_b: The other way round.
        frames: How set-ups of the same name moved.
        targets: How targets of the same name moved.
        notes: What to mind, sentences.
        robot: The robot, where its URDF is at hand.
    """

    a: Compared
    b: Compared
    outcome: str
    why: str
    test: DriftTest
    moves: tuple[Move, ...]
    shows_from: float
    parameters: tuple[ParameterDifference, ...]
    untold: tuple[str, ...]
    only_a: tuple[str, ...]
    only_b: tuple[str, ...]
    frames: tuple[PlaceDifference, ...]
    targets: tuple[PlaceDifference, ...]
    notes: tuple[str, ...]
    robot: Robot | None

    @property
    def robots(self) -> tuple[Robot, Robot]:
        """The robot as the first result has it, and as the second has it.

        Raises:
            ModelError: There is no URDF.
        """
        if self.robot is None:
            message = (
                "The URDF that the results name was not found, so that there is no robot to show. Give it with --robot "
                "(compare(a, b, robot))."
            )
            raise ModelError(message)
        return self.a.stored.corrected(self.robot), self.b.stored.corrected(self.robot)
