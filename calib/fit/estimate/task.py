"""Task: all that a fit needs but the rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calib.basics.values import Value
from calib.data.cell import Cell
from calib.errors import ModelError, choices
from calib.fit.registration.setup import KnownDistance, Setup
from calib.model.error_model import FRAME, MOUNT, TARGET, ErrorModel, Parameter
from calib.model.frozen import frozen_parameters
from calib.model.parameter_sets import error_model
from calib.numerics.solvers import Solver, check_name, has_weights_and_priors
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
    #: A name of `calib.numerics.solvers.SOLVERS`, or a solver itself
    solver: str | Solver = "lm"
    #: Whether outliers lose their weight
    robust: bool = True
    #: Whether the cell may name parameters that this model lacks, as if several are tried
    allow_absent: bool = False

    @property
    def has_weights_and_priors(self) -> bool:
        """True if fits by the solver weigh rows and have priors; else it has an estimate of its own."""
        return has_weights_and_priors(self.solver)

    def check_solver(self) -> None:
        """Raise `ModelError` if the solver is a name that no solver has."""
        if not callable(self.solver):
            check_name(self.solver)

    def error_model(self) -> ErrorModel:
        """Return the parameters that are estimated, of robot, frames and targets, without frozen and tied ones.

        Returns:
            The p parameters, in the order of the parameter vector x: of the robot's model, then of the frames and
            targets that are estimated, then of cameras and boards; and the terms tied to them.

        Raises:
            ModelError: An unknown model or parameter, or a frame or target that is frozen or tied; or a parameter that
                is tied, and frozen with its joint or link.
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
            further=[unknown.parameter for unknown in setup.internals],
        )
        frozen = frozen_parameters(self.robot, model.parameters, self.cell.frozen)
        ties = self.cell.ties

        # A measurement frame or target is estimated as a whole, or not at all.
        leaders = [leader for leader, _ in ties.values()]
        tied = {*ties, *leaders}
        of_setup = [p.name for p in model.parameters if p.family in (FRAME, TARGET, MOUNT)]
        of_instruments = [parameter.name for _, parameter in model.internals]
        refused = [name for name in of_setup if name in {*frozen, *tied}]
        refused += [name for name in of_instruments if name in tied]
        refused += [name for name in ties if name in frozen]
        if refused:
            raise ModelError(
                f"{choices(refused)} cannot be frozen or tied: a frame or target is whole, numbers of a camera or "
                "board are not tied, and what is tied is not frozen too."
            )

        if self.allow_absent:
            frozen = tuple(name for name in frozen if name in model.names and name not in ties)
            ties = {
                name: tie
                for name, tie in ties.items()
                if name in model.names and tie[0] in model.names
            }
        return model.tied(ties).without(frozen)
