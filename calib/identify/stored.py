"""StoredResult: what a result file says of robot and set-up, and how it is put to use again."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.errors import ModelError, choices
from calib.identify.certainty import Certainty
from calib.identify.evaluation import Evaluation, Known, evaluation_at
from calib.identify.registration import register_poses
from calib.identify.table_rows import rows_of
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics, Samples
from calib.model.parameters import ErrorModel
from calib.model.robot import Robot
from calib.model.torques import Payload, gravity_load

Array = NDArray[np.float64]

#: Names of the parameters of frames and targets, which stand in the result as poses.
_PLACED = re.compile(r"(frame|target)_r?[xyz](\[.*\])?", re.DOTALL)


@dataclass(frozen=True, slots=True, eq=False)
class StoredLarger:
    """The larger model of a result, whose joints err with their state.

    Attributes:
        name: Set and families, such as ``"dh+compliance"``.
        x: The value of each parameter by name [m], [rad], [1], [m/m], [rad/Nm] or [m/N]; frozen ones are missing.
        ties: Parameters that follow others, see `calib.measure.cell.Cell`.
        known: Its own frames and targets.
        payload: What the tip carried.
        gravity: shape (3,), in the URDF's root frame [m/s^2].
    """

    name: str
    x: Mapping[str, float]
    ties: Mapping[str, tuple[str, float]]
    known: Known
    payload: Payload | None
    gravity: Array

    def model(self, nominal: Robot) -> tuple[ErrorModel, Array]:
        """The errors of a robot, and their values, shape (p,), [m], [rad] and so on; frames and targets aside.

        Args:
            nominal: The nominal robot.

        Raises:
            ModelError: The robot's model has not the parameters that the result has values for.
        """
        model = error_model(nominal, self.name, target=False)
        names = model.names
        model = model.tied({n: t for n, t in self.ties.items() if n in names and t[0] in names})
        strange = [n for n in self.x if n not in model.names and not _PLACED.fullmatch(n)]
        if strange:
            message = (
                f"The result has values for {choices(strange)}, which the model '{self.name}' of this robot lacks. "
                "Give the URDF that the result was made with."
            )
            raise ModelError(message)
        return model, np.array([self.x.get(name, 0.0) for name in model.names])

    def tip_poses(self, nominal: Robot, samples: Samples) -> Array:
        """T_base_tip with the joints' own errors, shape (N, 4, 4), [m].

        Args:
            nominal: The nominal robot.
            samples: Joint values and loads.

        Raises:
            ModelError: The robot's model has not the parameters that the result has values for.
        """
        model, x = self.model(nominal)
        kinematics = Kinematics(nominal, model, np.eye(4), np.eye(4))
        return kinematics.poses(x, Samples.at(samples.q, samples.load))


@dataclass(frozen=True, slots=True, eq=False)
class StoredResult:
    """What a result file says of robot and set-up.

    Attributes:
        base: Base link.
        tip: Tip link.
        held: Values of joints that were not measured [rad] or [m].
        known: Frames and targets.
        nominal_known: Those that the nominal robot's errors are computed with: as given, and registered to the
            estimation rows where they were not; None in a file of before they were kept.
        origins: Corrected ``<origin>`` of each joint that carries a placement of the chain, shape (4, 4), [m].
        nominal_origins: The same of the nominal robot.
        larger: The larger model; None where there is none.
        certainty: How far to trust it; None in a file that does not say.
        targets_given: Targets whose place was stated before the fit; empty in a file that does not say.
    """

    base: str
    tip: str
    held: Mapping[str, float]
    known: Known
    nominal_known: Known | None
    origins: Mapping[str, Array]
    nominal_origins: Mapping[str, Array]
    larger: StoredLarger | None
    certainty: Certainty | None = None
    targets_given: frozenset[str] = frozenset()

    @property
    def T_frame_base(self) -> Array:
        """Pose of the base in the (first) measurement frame, shape (4, 4), [m]."""
        return next(iter(self.known.frames.values()))

    @property
    def target(self) -> Array:
        """The (first) target in the tip, shape (3,), [m]."""
        return next(iter(self.known.targets.values()))[:3, 3]

    def corrected(self, robot: Robot) -> Robot:
        """A robot with this result's origins; the same robot where it has them already.

        Raises:
            UrdfError: The robot lacks one of the joints.
        """
        return robot.rebuilt(robot.urdf.with_origins(self.origins), self.base, self.tip)

    def nominal(self, robot: Robot) -> Robot:
        """A robot, nominal or corrected, with the origins that this result began with.

        Raises:
            UrdfError: The robot lacks one of the joints.
        """
        return robot.rebuilt(robot.urdf.with_origins(self.nominal_origins), self.base, self.tip)

    def tip_poses(self, robot: Robot, q: Array, payload: Payload | None = None) -> Array:
        """T_base_tip with the larger model, or with the corrected origins where there is none.

        Args:
            robot: The robot, nominal or corrected.
            q: shape (N, m), joint values [rad] or [m].
            payload: What the tip carries; None: what it carried when it was calibrated.

        Returns:
            shape (N, 4, 4), [m].

        Raises:
            UrdfError: The robot lacks one of the joints.
            ModelError: The robot's model has not the parameters that the result has values for.
        """
        if self.larger is None:
            return self.corrected(robot).poses(q)
        nominal = self.nominal(robot)
        load = gravity_load(nominal, q, payload or self.larger.payload, self.larger.gravity)
        return self.larger.tip_poses(nominal, Samples.at(q, load))

    def evaluate_larger(
        self,
        robot: Robot,
        measurements: Measurements,
        cell: Cell,
        known: Known | None = None,
    ) -> Evaluation | None:
        """Compare the larger model with measurements; None where the result has none.

        Args:
            robot: The robot, nominal or corrected.
            measurements: The rows.
            cell: The set-up; its payload wins over the result's.
            known: Frames and targets that are known; None: those of the larger model.

        Raises:
            UrdfError: The robot lacks one of the joints.
            ModelError: The table has set-ups or targets that nothing is known of, or the robot is another one.
            MeasurementError: Too few rows to register what is not known.
        """
        if self.larger is None:
            return None
        nominal = self.nominal(robot)
        cell = replace(
            cell, payload=cell.payload or self.larger.payload, gravity=self.larger.gravity
        )
        every, setup = rows_of(nominal, measurements, cell)
        setup = (self.larger.known if known is None else known).placed(setup)
        T_base_tip = self.larger.tip_poses(nominal, every.samples)
        chosen = measurements.estimation
        chosen = chosen if np.any(chosen) else np.ones(len(measurements), dtype=bool)
        asked = setup.as_known(setup.frame_given, setup.target_given)
        placed = register_poses(T_base_tip[chosen], asked, every.select(chosen))
        return evaluation_at(nominal, measurements, every, setup, placed, T_base_tip)
