"""One of the results that are compared: what its tables say of parameters, their priors and what was measured."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from calib.errors import FileError
from calib.identify.result import Calibration
from calib.identify.result_file import read_table, result_table, stored_result
from calib.identify.stored import StoredResult
from calib.measure.measurements import Measurements
from calib.model.json_file import damage, plain
from calib.model.robot import Robot, read_only
from calib.model.sources import recorded_urdf

Array = NDArray[np.float64]

#: What can be compared: a calibration, the path of its result file, or the file's tables.
Result: TypeAlias = Calibration | str | Path | Mapping[str, Any]

#: Names of the parameters of frames and targets, which are no part of the robot.
_PLACED = re.compile(r"(frame|target)_r?[xyz](\[.*\])?", re.DOTALL)

#: Kinds of row that tell where the base stands.
_TELLING = {"point", "pose"}

_DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True, slots=True)
class SetErrors:
    """Position errors of some rows [m], NaN where there are none.

    Attributes:
        rows: Which rows, in words.
        n: Their number.
        max: The largest.
        mean: Their mean.
        rms: Their root mean square.
    """

    rows: str
    n: int
    max: float
    mean: float
    rms: float


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """What a comparison needs of a result.

    Attributes:
        name: Name of the file, or ``"a"`` or ``"b"``.
        stored: Robot, origins, frames and targets.
        robot_name: The robot's name in its URDF.
        joints: The measured joints.
        model: The parameter set, such as ``"dh"``.
        frozen: Parameters kept at their nominal values.
        ties: Parameters that follow others.
        names: The p parameters.
        units: Of each.
        value: shape (p,), in its unit; NaN where nothing was said of it.
        delta: shape (p,), the change from the nominal robot.
        covariance: shape (p, p).
        precision: shape (p,), 1 / prior variance; 0 without prior.
        push: shape (p,), how hard the data push against the priors, in 1 / unit.
        at_bound: shape (p,), whether a bound stopped it.
        identifiable: shape (p,), whether the measurements determine it alone.
        freedom: Degrees of freedom that the noise was estimated with.
        sigma: Noise of one measured length [m]; NaN where none was measured.
        errors: Of the calibrated robot, by set of rows.
        kinds: What the rows measure.
        frame: Directions in which the base was not known to stand, of ``x`` to ``rz``.
        target_estimated: Whether the targets were estimated.
        ranges: shape (m, 2), lowest and highest fitted value of each joint, [rad] or [m].
        use: The verdict; empty without one.
        larger: Name of the larger model; empty without one.
        urdf: Name and SHA-256 of the nominal URDF.
        data: Name and SHA-256 of the measurements.
        data_rows: Number of their rows.
        nominal: The nominal robot where it is at hand.
    """

    name: str
    stored: StoredResult
    robot_name: str
    joints: tuple[str, ...]
    model: str
    frozen: tuple[str, ...]
    ties: Mapping[str, tuple[str, float]]
    names: tuple[str, ...]
    units: tuple[str, ...]
    value: Array
    delta: Array
    covariance: Array
    precision: Array
    push: Array
    at_bound: NDArray[np.bool_]
    identifiable: NDArray[np.bool_]
    freedom: float
    sigma: float
    errors: tuple[SetErrors, ...]
    kinds: frozenset[str]
    frame: tuple[str, ...]
    target_estimated: bool
    ranges: Array
    use: str
    larger: str
    urdf: tuple[str, str]
    data: tuple[str, str]
    data_rows: int
    nominal: Robot | None

    @classmethod
    def of(cls, result: Result, name: str) -> Compared:
        """From a calibration, a result file or its tables.

        Args:
            result: See `Result`.
            name: What to call one that has no file.

        Raises:
            FileError: A file cannot be read, is no result, or lacks something.
        """
        nominal, folder = None, Path()
        if isinstance(result, Calibration):
            table: Mapping[str, Any] = plain(result_table(result))
            nominal = result.nominal
            if not result.measurements.sha256:
                table["inputs"]["measurements"]["sha256"] = _fingerprint(result.measurements)
        elif isinstance(result, Mapping):
            table = plain(result)
        else:
            table, name, folder = read_table(result), Path(result).name, Path(result).parent
        stored = stored_result(table, name)
        try:
            return cls._of(table, stored, name, nominal or _found(table, stored, folder))
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            message = (
                f"{name}: the result lacks what a comparison needs ({damage(error)}). Write it again with "
                "'calib fit --json' of this version."
            )
            raise FileError(message) from error

    @classmethod
    def _of(
        cls, table: Mapping[str, Any], stored: StoredResult, name: str, nominal: Robot | None
    ) -> Compared:
        """From the tables.

        Raises:
            KeyError, TypeError, ValueError: Something is missing or of another kind.
        """
        parameters, model, inputs = table["parameters"], table["model"], table["inputs"]
        p, robot, verdict = len(parameters), table["robot"], table["verdict"]
        prior = _floats([one["prior_std"] for one in parameters])
        with np.errstate(over="ignore", divide="ignore"):
            precision = np.where(np.isnan(prior), 0.0, 1.0 / prior**2)
        if np.any(prior <= 0.0) or not np.all(np.isfinite(precision)):
            message = "a prior of a parameter is not greater than zero"
            raise ValueError(message)
        result = cls(
            name=name,
            stored=stored,
            robot_name=str(robot["name"]),
            joints=tuple(robot["joints"]),
            model=model["set"],
            frozen=tuple(model["frozen"]),
            ties={t["name"]: (t["other"], float(t["factor"])) for t in model["ties"]},
            names=tuple(one["name"] for one in parameters),
            units=tuple(one["unit"] for one in parameters),
            value=_floats([one["value"] for one in parameters]),
            delta=_floats([one["delta"] for one in parameters]),
            covariance=_floats(table["covariance"]).reshape(p, p),
            precision=read_only(precision),
            push=_floats([one["push"] for one in parameters]),
            at_bound=np.array([one["at_bound"] for one in parameters], dtype=bool),
            identifiable=np.array([one["identifiable"] for one in parameters], dtype=bool),
            freedom=float(table["noise"]["freedom"]),
            sigma=_float(table["noise"]["sigma_m"]),
            errors=_errors(table),
            kinds=frozenset(row["kind"] for row in table["rows"]),
            frame=_unknown_frame(table),
            target_estimated=bool(table["frames"]["target_estimated"]),
            ranges=_floats([[one["low"], one["high"]] for one in robot["ranges"]]).reshape(-1, 2),
            use="" if verdict is None else verdict["use"],
            larger="" if table["larger"] is None else table["larger"]["set"],
            urdf=(inputs["urdf"]["name"], inputs["urdf"]["sha256"]),
            data=(inputs["measurements"]["name"] or "memory", inputs["measurements"]["sha256"]),
            data_rows=int(inputs["measurements"]["rows"]),
            nominal=nominal,
        )
        numbers = (result.covariance, result.delta, result.push)
        if not all(np.all(np.isfinite(one)) for one in numbers):
            message = "numbers of the parameters or of their covariance are missing"
            raise ValueError(message)
        if len(result.ranges) != len(result.joints):
            message = "the joints' ranges are not those of the joints"
            raise ValueError(message)
        return result

    @property
    def own(self) -> NDArray[np.int_]:
        """Which parameters are the robot's own: those of frames and targets left out."""
        return np.array(
            [k for k, name in enumerate(self.names) if not _PLACED.fullmatch(name)], dtype=int
        )

    @property
    def own_names(self) -> tuple[str, ...]:
        """The names of the robot's own parameters."""
        return tuple(self.names[k] for k in self.own)

    @property
    def turns(self) -> bool:
        """Whether orientations were measured."""
        return "pose" in self.kinds


def _found(table: Mapping[str, Any], stored: StoredResult, folder: Path) -> Robot | None:
    """The nominal robot of a result, from a file of the same bytes beside it, here, or of example-robot-data."""
    inputs = table["inputs"]["urdf"]
    urdf = recorded_urdf(str(inputs["name"]), inputs["sha256"], folder)
    if urdf is None:
        return None
    return Robot.from_urdf(urdf, stored.base, stored.tip, held=stored.held)


def _errors(table: Mapping[str, Any]) -> tuple[SetErrors, ...]:
    """Errors of the calibrated robot: estimation rows, validation rows, left-out rows."""
    sets = dict(table["errors"]["calibrated"])
    result = [_set(f"{name} rows", sets[name]) for name in ("estimation", "validation")]
    if table["cross_validation"] is not None:
        result.append(_set("left-out rows", table["cross_validation"]))
    return tuple(one for one in result if one.n)


def _set(rows: str, errors: Mapping[str, Any]) -> SetErrors:
    """Errors of one set of rows."""
    return SetErrors(
        rows, int(errors["n"]), *(_float(errors[key]) for key in ("max_m", "mean_m", "rms_m"))
    )


def _unknown_frame(table: Mapping[str, Any]) -> tuple[str, ...]:
    """In which directions the measurements did not know where the base stands."""
    frames = table["frames"]
    if not _TELLING & {row["kind"] for row in table["rows"]}:
        return _DIRECTIONS  # sockets, planes, anchors and pairs never do
    if not frames["frame_estimated"]:
        return ()
    every = {direction for one in frames["set_ups"] for direction in one["estimated"]}
    return tuple(direction for direction in _DIRECTIONS if direction in every)


def _fingerprint(measurements: Measurements) -> str:
    """What tells measurements without a file from others."""
    numbers = (measurements.joints, measurements.points, measurements.distances)
    digest = hashlib.sha256()
    for one in numbers:
        digest.update(b"" if one is None else np.ascontiguousarray(one).tobytes())
    return digest.hexdigest()


def _float(value: Any) -> float:  # noqa: ANN401  JSON values are of any kind
    """A number, or NaN where it is missing."""
    return float("nan") if value is None else float(value)


def _floats(values: Any) -> Array:  # noqa: ANN401
    """Numbers as an array, NaN where they are missing."""
    return read_only(np.array(values, dtype=np.float64))
