"""Task: all that a fit needs but the rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calib.basics.values import Value
from calib.data.cell import Cell
from calib.errors import ModelError, choices
from calib.fit.registration.known_distances import KnownDistance
from calib.fit.registration.setup import Setup
from calib.model.error_model import error_model
from calib.model.parameters import FRAME, TARGET, ErrorModel, Parameter
from calib.numerics.solvers import PAPER as PAPER, Solver, check_name
from calib.robot.robot import Robot


@dataclass(frozen=True, slots=True, eq=False)
class Task(Value):
    """Robot, cell, measurement setup and model of a fit, and its options."""

    #: The nominal robot
    robot: Robot
    #: What the user gave: priors, bounds, frozen and tied parameters, gravity
    cell: Cell
    #: Frames and targets as given, not registered
    setup: Setup
    #: Name of the set and families, or the robot's own parameters
    model: str | Sequence[Parameter]
    #: Known distances between frames
    distances: tuple[KnownDistance, ...] = ()
    #: A name of `calib.numerics.solvers.SOLVERS`, `PAPER`, or a solver itself
    solver: str | Solver = "lm"
    #: Whether outliers lose their weight
    robust: bool = True
    #: Whether the cell may name parameters that this model lacks, as where several are tried
    allow_absent: bool = False

    def check_solver(self) -> None:
        """Raise `ModelError` where ``solver``, a name or a solver itself (a callable), is an unknown name.

        Raises:
            ModelError: No such solver.
        """
        if not callable(self.solver):
            check_name(self.solver)

    def error_model(self) -> ErrorModel:
        """Return the parameters that are estimated: of the robot, frames and targets, without frozen and tied ones.

        Uses the nominal ``robot``; ``model``, the name of a set of its errors or these parameters themselves;
        ``setup``, frames and targets as given, with what is estimated of them; of ``cell`` the acceleration of gravity
        [m/s^2], the names of ``frozen`` parameters, which stay nominal, and ``ties``, by name of a follower the name of
        its leader and a factor: x_follower = factor x_leader; and ``allow_absent``, True to skip
        names in these that the model lacks.

        Returns:
            The p parameters, in the order of the parameter vector x: of the robot's model, then of the frames and
            targets that are estimated; and the terms tied to them.

        Raises:
            ModelError: An unknown model or parameter, or a frame or target that is frozen or tied.
        """
        setup = self.setup
        model = error_model(
            self.robot,
            self.model,
            frame=setup.frame_unknowns,
            target=setup.unknown_targets,
            targets=setup.target_names,
            rotation=setup.rotation,
            gravity=self.cell.gravity,
            further=[unknown.parameter for unknown in setup.optics],
        )
        self._check_setup_is_whole(model)
        frozen = self.cell.frozen
        ties = self.cell.ties
        if self.allow_absent:
            frozen = tuple(name for name in frozen if name in model.names and name not in ties)
            ties = {
                name: tie
                for name, tie in ties.items()
                if name in model.names and tie[0] in model.names
            }
        return model.tied(ties).without(frozen)

    def _check_setup_is_whole(self, model: ErrorModel) -> None:
        """Raise `ModelError` where the cell freezes or ties a parameter of a frame or target.

        A measurement frame or target is estimated as a whole, or not at all. Uses the names in ``cell.frozen``, and in
        ``cell.ties``, a mapping from a follower's name to its leader's name and a factor, x_follower = factor x_leader.

        Args:
            model: The parameters of robot, frames and targets, none of them frozen or tied yet.

        Raises:
            ModelError: Such a parameter is frozen, is tied to another one, or another one to it.
        """
        ties = self.cell.ties
        leaders = [leader for leader, _ in ties.values()]
        named = {*self.cell.frozen, *ties, *leaders}
        of_setup = [p.name for p in model.parameters if p.family in (FRAME, TARGET)]
        of_optics = [parameter.name for _, parameter in model.optical]
        refused = [name for name in of_setup if name in named]
        refused += [name for name in of_optics if name in {*ties, *leaders}]
        if refused:
            raise ModelError(
                f"{choices(refused)} cannot be frozen or tied: a frame or target is whole, and numbers of a camera or "
                "board are not tied."
            )
