"""Calibration: what was found of a robot, as immutable values: the same in memory and read from its file.

What no file holds, the measurements and the solved problem, is its part ``fit``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.data.cell import Cell
from calib.data.columns import SETS
from calib.data.measurements import Measurements
from calib.diagnosis.coverage import OutsideRow, outside
from calib.diagnosis.reasons import Verdict
from calib.errors import ModelError, choices
from calib.estimate.fitting import Fitted
from calib.model.kinematics import Samples
from calib.model.observability import Observability
from calib.numerics.errors import CrossValidation, Errors
from calib.numerics.repeats import Repeats
from calib.numerics.solvers import Solution
from calib.registration.setup import Setup
from calib.result.prediction import NonGeometric, Outlier, ParameterEstimate, Solved, tells_place
from calib.result.robustness import Robustness
from calib.robot.payload import Payload
from calib.robot.robot import Robot, rigid_inverse
from calib.selection.candidates import Candidate
from calib.units import Array, Mask

#: Values that stand for all those between the ends of a measured range.
_BETWEEN = 73


@dataclass(frozen=True, slots=True)
class RowNames:
    """What each row of the measurements is: its number in the table, its set, kind, set-up and target."""

    numbers: tuple[int, ...]
    sets: tuple[str, ...]
    kinds: tuple[str, ...]
    groups: tuple[str, ...]
    targets: tuple[str, ...]

    def __len__(self) -> int:
        """The number of rows."""
        return len(self.numbers)

    @property
    def estimation(self) -> Mask:
        """Which rows were fitted, shape (N,)."""
        return np.array([one == SETS[0] for one in self.sets], dtype=bool)

    @property
    def validation(self) -> Mask:
        """Which rows were only predicted, shape (N,)."""
        return ~self.estimation


@dataclass(frozen=True, slots=True)
class Source:
    """The table of the measurements: name and SHA-256 of the file, both empty where it was none."""

    name: str
    sha256: str


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The solved problem: the fit of the geometry, which the URDF holds, and that of the non-geometric model."""

    measurements: Measurements
    cell: Cell
    geometry: Fitted
    non_geometric: Fitted | None = None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CalibrationValues(Solved):
    """The result of `calib.calibrate`; the attributes of `Solved` are those of the geometry, which the URDF holds."""

    nominal: Robot  #: The robot as it came in
    robot: Robot  #: The calibrated robot, its URDF corrected
    source: Source  #: The measurements' file
    rows: RowNames  #: What each row is, all rows
    frame_estimated: bool  #: Whether the cell left the measurement frames to be estimated
    frozen: tuple[str, ...]  #: Parameters that were kept at their nominal values
    ties: Mapping[str, tuple[str, float]]  #: Parameters that follow another one, by a factor
    prior_std_from: str  #: Where the sizes of the priors are from: ``"data"``, ``"given"``, or ``"off"`` without priors
    nominal_setup: Setup  #: Of the nominal robot's errors: as given, or registered
    solver: str  #: Name of the solver
    solution: Solution  #: Where it stopped, with its history
    seconds: float  #: Time that choosing a model, registration and estimation took; NaN where it is not to be told
    freedom: float  #: Degrees of freedom left for the noise
    sigma: float  #: Standard deviation of one measured length (median over rows) [m]; NaN where none was measured
    sigma_angle: float  #: Of one measured angle [rad]; NaN where none was
    #: Standard deviation of one measured length as the cell or the table states it (rms over fitted rows) [m]; NaN
    #: where it is not stated
    sigma_given: float = np.nan
    sigma_angle_given: float = np.nan  #: Of one measured angle, likewise [rad]
    #: shape (N, D), measured minus predicted by the nominal robot, all rows: lengths [m] in the first columns, angles
    #: [rad] in three more where poses were measured
    residual_nominal: Array
    residual_calibrated: Array  #: shape (N, D), by the calibrated robot
    used: Mask  #: shape (N, D), which scalars were measured
    scores: Array  #: shape (N,), of all rows; see `calib.numerics.scores`
    weights: Array  #: shape (N,), of all rows in the fit, between 0 and 1; 0 for validation rows
    ranges: Array  #: shape (m, 2), smallest and largest joint values that were fitted [rad], [m]
    flag_limit: float  #: The score above which a row is flagged
    outliers: tuple[Outlier, ...]  #: Fitted rows flagged; without weight if robust
    suspects: tuple[Outlier, ...]  #: Validation rows flagged; they never have weight
    robustness: (
        Robustness | None
    )  #: What lowering weights does; None if none was, or by ``"paper"``
    repeats: Repeats | None  #: Scatter of rows that repeat a pose; None where none does
    outside: tuple[OutsideRow, ...]  #: Validation rows outside of the joint values fitted
    #: Of the nominal robot, its target (and frame, if estimated) fitted to the other rows
    nominal_cross_validation: CrossValidation | None
    observability: Observability  #: Rank, and what the measured poses cannot tell apart
    candidates: tuple[Candidate, ...]  #: The ladder that ``auto`` chose from, or empty
    non_geometric: NonGeometric | None  #: The non-geometric model, if one was chosen or asked for
    verdict: Verdict | None  #: None without cross-validation, unless the set-up is plainly wrong
    #: Measurements and solved problem; None where the result was read from a file
    fit: Fit | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        """In one line."""
        verdict = "no verdict" if self.verdict is None else self.verdict.use
        return f"Calibration({self.nominal!r}, {len(self.rows)} rows, {verdict})"

    @property
    def measurements(self) -> Measurements:
        """All rows; `ModelError` where the result was read from a file."""
        return self.in_memory.measurements

    @property
    def cell(self) -> Cell:
        """The cell as given; `ModelError` where the result was read from a file."""
        return self.in_memory.cell

    @property
    def fitted(self) -> Fitted:
        """The fit of the geometry; `ModelError` where the result was read from a file."""
        return self.in_memory.geometry

    @property
    def in_memory(self) -> Fit:
        """The fit; `ModelError` where the result was read from a file."""
        if self.fit is None:
            raise ModelError(
                "This result was read from a file, which holds neither the measurements nor the solved problem. "
                "Calibrate again for what needs them."
            )
        return self.fit

    @property
    def T_frame_base(self) -> Array:
        """Pose of the base in the (first) measurement frame, as estimated or given, shape (4, 4), [m]."""
        return np.asarray(self.setup.T_frame_base[0])

    @property
    def target(self) -> Array:
        """The (first) target in the tip, as estimated or given, shape (3,), [m]."""
        return np.asarray(self.setup.T_tip_target[0, :3, 3])

    @property
    def errors(self) -> dict[str, dict[str, Errors]]:
        """``errors["nominal" | "calibrated" | "non_geometric"]["estimation" | "validation"]``."""
        residuals = {"nominal": self.residual_nominal, "calibrated": self.residual_calibrated}
        if self.non_geometric is not None:
            residuals["non_geometric"] = self.non_geometric.residual
        sets = (("estimation", self.rows.estimation), ("validation", self.rows.validation))
        return {
            who: {name: Errors.of(residual[mask], self.used[mask]) for name, mask in sets}
            for who, residual in residuals.items()
        }

    def parameter(self, name: str) -> ParameterEstimate:
        """One parameter by its exact name; of the geometry, or of the non-geometric model if only that has it."""
        non_geometric = self.non_geometric
        if (
            non_geometric is not None
            and name in non_geometric.model.names
            and name not in self.model.names
        ):
            return non_geometric.parameters[non_geometric.model.index(name)]
        return self.parameters[self.model.index(name)]

    @property
    def tells_place(self) -> bool:
        """Whether any row tells where the base stands; otherwise predictions are in the base."""
        return tells_place(self.rows.kinds)

    def verdict_on(self, *, non_geometric: bool) -> Verdict | None:
        """The verdict on the non-geometric model, where it is asked for and was judged, or on the geometry.

        Args:
            non_geometric: Whether the non-geometric model is to be used, as of `part`.

        Returns:
            The verdict; None where nothing was judged.
        """
        if (
            non_geometric
            and self.non_geometric is not None
            and self.non_geometric.verdict is not None
        ):
            return self.non_geometric.verdict
        return self.verdict

    def part(self, *, non_geometric: bool) -> Solved:
        """What to predict with: the non-geometric model, where it is asked for and there is one, or the geometry."""
        return self.non_geometric if non_geometric and self.non_geometric is not None else self

    def samples(
        self,
        q: ArrayLike,
        *,
        target: str | None = None,
        group: str | None = None,
        payload: Payload | None = None,
    ) -> Samples:
        """Joint values, shape (N, m) or (m,), as a prediction takes them, with the load on the joints.

        Target and set-up are the first, and the payload is the calibration's, where None; `ModelError` for other names.
        """
        values = np.atleast_2d(np.asarray(q, dtype=np.float64))
        load = (
            None
            if self.non_geometric is None
            else self.non_geometric.load(self.nominal, values, payload)
        )

        def numbered(what: str, name: str | None, names: tuple[str, ...]) -> NDArray[np.int_]:
            if name is not None and name not in names:
                raise ModelError(f"There is no {what} '{name}'; there is {choices(names)}.")
            return np.full(len(values), 0 if name is None else names.index(name))

        frame = numbered("set-up", group, self.setup.groups)
        return replace(
            Samples.at(values, load),
            frame=frame,
            target=numbered("target", target, self.setup.targets),
        )

    def predict_poses(
        self,
        q: ArrayLike,
        *,
        target: str | None = None,
        group: str | None = None,
        non_geometric: bool = True,
    ) -> Array:
        """Where the calibrated robot puts the target, in the measurement frame, shape (N, 4, 4), [m].

        Args:
            q: shape (N, m) or (m,), joint values in the robot's order, [rad] or [m].
            target: Name of the target; the first where None.
            group: Name of the set-up whose frame is meant; where None the first, or the base where no row tells where
                it stands.
            non_geometric: Whether to use the non-geometric model, if there is one; else the geometry of the URDF.
        """
        part = self.part(non_geometric=non_geometric)
        poses = part.kinematics.poses(part.x, self.samples(q, target=target, group=group))
        if group is None and not self.tells_place:
            poses = rigid_inverse(part.setup.T_frame_base[0]) @ poses
        return poses

    def predict(self, q: ArrayLike, **where: Any) -> Array:  # noqa: ANN401  as of predict_poses
        """The target's position, shape (N, 3), [m]; the arguments are those of `predict_poses`."""
        return self.predict_poses(q, **where)[:, :3, 3]

    def position_std(
        self,
        q: ArrayLike,
        *,
        target: str | None = None,
        group: str | None = None,
        non_geometric: bool = True,
    ) -> Array:
        """How sure `predict` is, sqrt(trace(J C J^T)), shape (N,), [m]; the arguments are those of `predict_poses`.

        Where only sockets, planes, anchors or pairs were measured, and no group is named, less what moves all positions
        as one body. It knows nothing of errors that the model lacks.
        """
        part, samples = (
            self.part(non_geometric=non_geometric),
            self.samples(q, target=target, group=group),
        )
        in_base = group is None and part.base_motion is not None
        return part.pose_std(samples, in_base=in_base)[:, 0]

    def tip_poses(self, q: ArrayLike, *, payload: Payload | None = None) -> Array:
        """T_base_tip by the non-geometric model, or the corrected origins; q (N, m), shape (N, 4, 4)."""
        if self.non_geometric is None:
            return self.robot.poses(np.atleast_2d(np.asarray(q, dtype=np.float64)))
        return self.non_geometric.tips(self.samples(q, payload=payload))

    def outside_of_measured(self, q: ArrayLike) -> tuple[OutsideRow, ...]:
        """Which joint values, shape (N, m), [rad] or [m], lie outside of the range that the fit has seen."""
        if not np.isfinite(self.ranges).all():
            return ()
        seen = np.linspace(self.ranges[:, 0], self.ranges[:, 1], _BETWEEN)
        types = [joint.type for joint in self.nominal.inputs]
        asked = np.atleast_2d(np.asarray(q, dtype=np.float64))
        return outside(seen, asked, self.nominal.joint_names, types)

    def corrected(self, robot: Robot) -> Robot:
        """A robot, nominal or corrected, with this result's origins; `UrdfError` where it lacks one of the joints."""
        own = self.robot
        return robot.rebuilt(robot.urdf.with_origins(own.origins()), own.base, own.tip)

    def uncorrected(self, robot: Robot) -> Robot:
        """A robot, nominal or corrected, with the origins that this result began with; else as `corrected`."""
        own = self.nominal
        return robot.rebuilt(robot.urdf.with_origins(own.origins()), own.base, own.tip)
