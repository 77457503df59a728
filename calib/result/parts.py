"""The parts of a `Calibration`: rows, noise, trust, method, source, and the fit in memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Array, Mask
from calib.basics.channels import Channels
from calib.basics.values import Value, keep_read_only
from calib.data.cell import Cell
from calib.data.columns import SETS
from calib.data.measurements import Measurements
from calib.diagnosis.coverage import OutsideRow
from calib.fit.estimate.fitting import Fitted
from calib.fit.selection.candidates import Candidate
from calib.fit.selection.row_weights import Robustness
from calib.model.observability import Observability
from calib.numerics.correlated_noise import PoseNoise
from calib.numerics.errors import CrossValidation, Errors
from calib.numerics.repeats import Repeats
from calib.numerics.solvers import Solution
from calib.result.call import Call
from calib.result.chains import ChainResult


@dataclass(frozen=True, slots=True)
class Outlier:
    """A row that does not belong to the others."""

    #: Its number in the table
    row: int
    #: Norm of measured minus predicted over the scalars of each unit that the row measures, by its symbol
    residual: Mapping[str, float]
    #: Distance from what the others predict, in standard deviations
    score: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ResultRows(Value):
    """The N rows of the table, fitted or only predicted: their names, residuals, scores and weights."""

    #: Number in the table, from 1
    numbers: tuple[int, ...]
    #: ``"estimate"`` or ``"validate"``
    sets: tuple[str, ...]
    #: Name of the kind of measurement
    kinds: tuple[str, ...]
    #: Name of the station
    groups: tuple[str, ...]
    #: Name of the target
    targets: tuple[str, ...]
    #: Name of the image that a row is a corner in, ``""`` for other rows; empty without images
    images: tuple[str, ...] = ()
    #: Shape (N, D), measured minus predicted by the nominal robot, 0 where nothing was measured; ``channels`` has the
    #: unit of each entry. NaN if a measurement frame was sought and not found, see ``nominal_is_judged``
    residual_nominal: Array
    #: Shape (N, D), the same by the calibrated robot
    residual_calibrated: Array
    #: Unit of each entry of the residuals, (N, D), and which were measured (``channels.used``)
    channels: Channels
    #: Shape (N,), distance from what the other rows predict, in standard deviations; see `calib.numerics.scores`
    scores: Array
    #: Shape (N,), weight in the fit, between 0 and 1; 0 for validation rows
    weights: Array
    #: The score above which a fitted row is flagged
    flag_limit: float
    #: Fitted rows flagged; without weight if robust
    outliers: tuple[Outlier, ...]
    #: Validation rows flagged; they never have weight
    suspects: tuple[Outlier, ...]
    #: Shape (m, 2), smallest and largest value of each measured joint over the fitted rows with weight [rad], [m]
    ranges: Array
    #: Validation rows outside of these ranges
    outside: tuple[OutsideRow, ...]
    #: Shape (N,), length at the board that a pixel is [m/px]; NaN in rows that are not images, None without images
    metres_per_pixel: Array | None = None

    def __len__(self) -> int:
        """The number N of rows of the table, estimation and validation rows."""
        return len(self.numbers)

    @property
    def estimation(self) -> Mask:
        """True for the rows that were fitted, those whose entry of ``sets`` is ``"estimate"``, shape (N,)."""
        return np.array([name == SETS[0] for name in self.sets], dtype=bool)

    @property
    def validation(self) -> Mask:
        """True for the rows that were only predicted, whose entry of ``sets`` is not ``"estimate"``, shape (N,)."""
        return ~self.estimation

    @property
    def flagged(self) -> Mask:
        """True for the flagged rows, outliers among the estimation rows and suspects among the others, shape (N,)."""
        return np.isin(self.numbers, [outlier.row for outlier in (*self.outliers, *self.suspects)])

    @property
    def nominal_is_judged(self) -> bool:
        """True unless a measurement frame was sought and not found: then the nominal robot has no known errors."""
        return not np.isnan(self.residual_nominal).any()

    @property
    def tells_place(self) -> bool:
        """True if some row, by its kind, determines where the base stands, such as a measured point.

        If none does, as if only sockets, planes, anchors or pairs were measured, predictions are in the base.
        """
        return any(registry.get(kind).tells_place for kind in self.kinds)

    def count_images(self, chosen: Mask) -> int:
        """Count the images that have chosen rows.

        Args:
            chosen: shape (N,), True for these rows.

        Returns:
            The number of different images; 0 if some of the chosen rows are not corners in images.
        """
        if not self.images:
            return 0
        names = set(np.array(self.images)[chosen].tolist())
        return 0 if "" in names else len(names)

    @property
    def errors_at_board(self) -> dict[str, dict[str, Errors]]:
        """``errors_at_board["nominal" | "calibrated"]["estimation" | "validation"]["m"].rms``.

        Errors of images as lengths at the board [m]; empty without images, and without the sets that have no rows.
        """
        if self.metres_per_pixel is None:
            return {}
        sets = {"estimation": self.estimation, "validation": self.validation}
        result: dict[str, dict[str, Errors]] = {"nominal": {}, "calibrated": {}}
        for name, rows in sets.items():
            if not np.any(rows):
                continue
            for who, residual in (
                ("nominal", self.residual_nominal),
                ("calibrated", self.residual_calibrated),
            ):
                result[who][name] = errors_at_board(
                    residual[rows], self.channels.select(rows), self.metres_per_pixel[rows]
                )
        return result

    def held_out_errors_at_board(self, validation: CrossValidation | None) -> Errors | None:
        """Summarise the held-out errors of images as lengths at the board [m].

        Args:
            validation: Cross-validation of the nominal or of the calibrated robot.

        Returns:
            Their errors, outliers included; None without images or cross-validation, or if that does not hold the
            residuals of all fitted rows.
        """
        rows = self.estimation
        if self.metres_per_pixel is None or validation is None:
            return None
        if len(validation.residual) != np.sum(rows):
            return None
        return errors_at_board(
            validation.residual, self.channels.select(rows), self.metres_per_pixel[rows]
        )


def errors_at_board(residual: Array, channels: Channels, scale: Array) -> Errors:
    """Summarise the residuals of images as lengths at the board, across the line of sight.

    An error of e pixels of a corner at the depth Z is e Z / f there, with the focal length f [px].

    Args:
        residual: shape (N, D), measured minus predicted; those in pixels count.
        channels: The channel of each entry.
        scale: shape (N,), length that a pixel is at each corner [m/px]; NaN in rows that are not images.

    Returns:
        Largest, mean and rms error over the rows of images [m]; other rows do not count.
    """
    images = channels.where("px")
    lengths = np.where(images, residual, 0.0) * np.where(np.isfinite(scale), scale, 0.0)[:, None]
    return Errors.of(lengths, Channels.of_unit(images))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Noise(Value):
    """The noise of the measurements, as estimated and as stated."""

    #: Estimated standard deviation of one scalar (median over rows), by the units that were measured: ``"m"`` ...
    sigma: Mapping[str, float]
    #: Standard deviation of one scalar as the cell or the table states it (rms over fitted rows), by the units for
    #: which it is stated
    sigma_given: Mapping[str, float]
    #: Degrees of freedom left for the noise
    freedom: float
    #: Scatter of rows that repeat a pose; None if none does
    repeats: Repeats | None
    #: Scale of the stated covariances of poses, and what the robot adds to them; None if none was stated
    pose_noise: PoseNoise | None = None

    def __post_init__(self) -> None:
        """Keep read-only copies of the mappings."""
        keep_read_only(self, "sigma", "sigma_given")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Trust(Value):
    """How far to trust the result, besides the verdict and the cross-validation of each fitted model."""

    #: Cross-validation of the nominal robot, its target (and frame, if estimated) fitted to the other rows; a fitted
    #: model has its own
    nominal_cross_validation: CrossValidation | None
    #: Rank and unobservable directions of the geometry at the measured poses
    observability: Observability
    #: The fit with weights lowered beside the one with every row in full; None without outliers, or by ``"paper"``
    robustness: Robustness | None
    #: What the geometry is worth for each chain of a robot that has several; empty for one chain
    chains: tuple[ChainResult, ...] = ()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Method(Value):
    """How the fit was made: what it was told, the models it chose from, and the solver."""

    #: Whether the cell left the measurement frames to be estimated
    frame_estimated: bool
    #: Parameters that were kept at their nominal values
    frozen: tuple[str, ...]
    #: Parameters that follow another one, by a factor
    ties: Mapping[str, tuple[str, float]]
    #: Source of the prior standard deviations: ``"data"``, ``"given"``; ``"off"`` without priors
    prior_std_from: str
    #: The ladder that ``auto`` chose from, or empty
    candidates: tuple[Candidate, ...]
    #: Name of the solver
    solver: str
    #: Its solution, with its history
    solution: Solution
    #: Time that choosing a model, registration and estimation took [s]; NaN if unknown
    seconds: float
    #: When that was, see `calib.basics.dates`; empty if an earlier version wrote the file
    time: str = ""
    #: What `calibrate` was told, to make the result again; None if an earlier version wrote the file
    call: Call | None = None

    def __post_init__(self) -> None:
        """Keep a read-only copy of the mapping."""
        keep_read_only(self, "ties")


@dataclass(frozen=True, slots=True)
class Source:
    """The file of the measurements; all empty if there was none."""

    #: Its name
    name: str
    #: SHA-256 of its bytes, in hexadecimal digits
    sha256: str
    #: Convention of its orientations, one of `calib.data.forms.orientations.CONVENTIONS`; empty if it had none
    orientation: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class FitInMemory(Value):
    """Measurements and solved problem of a calibration that was made in this process."""

    #: All rows
    measurements: Measurements
    #: The cell as given
    cell: Cell
    #: Fit of the geometry, which the URDF holds
    geometry: Fitted
    #: Fit of the non-geometric model
    non_geometric: Fitted | None = None
