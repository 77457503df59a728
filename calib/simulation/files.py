"""Files and words of a simulation: a scenario from the command line and the cell file, and what was true, as JSON.

The JSON is in SI units, the unit in each key's suffix; docs/simulation.md describes the keys. It is complete: with the
nominal URDF alone, true positions follow from it.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.data.cell import Cell, TrackerNoise
from calib.errors import CalibError, choices, did_you_mean
from calib.files import json_bytes, read_bytes, write_atomically
from calib.model.error_model import error_model
from calib.model.families import FAMILIES, Unit, unit_of
from calib.robot.readback import check_written, random_joint_values
from calib.robot.robot import Robot
from calib.simulation.scenario import DEFAULT_MODEL, Scenario, Simulated
from calib.simulation.truth import TARGET_ERROR, Encoder, MovedTarget, Outliers, Truth
from calib.units import is_number, parse_noise, parse_quantity

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_NONE = "none"

#: Noise of an orientation about each axis, of a tracker's 6D probe [rad].
_PROBE = float(np.radians(0.01))

_DEG, _MM = float(np.radians(1.0)), 1e-3

#: The keys of ``[simulation]``: what each gives, what one of its unit is in SI, and of how many numbers it is.
KEYS: dict[str, tuple[str, float, int]] = {
    "visits": ("visits", 1.0, 1),
    "encoder_deg": ("angle", _DEG, 1),
    "encoder_mm": ("length", _MM, 1),
    "outlier_size_mm": ("size", _MM, 1),
    "drift_mm": ("drift", _MM, 3),
    "moved_row": ("row", 1.0, 1),
    "moved_mm": ("by", _MM, 3),
}


@dataclass(frozen=True, slots=True)
class Words:
    """What the command line says of a scenario, as it is written; None: nothing."""

    sizes: str | None = None
    error: tuple[str, ...] = ()
    noise: str | None = None
    outliers: str | None = None
    truth_robot: Path | None = None
    target_error: str | None = None


def read_simulation(path: Path | None) -> dict[str, Any]:
    """The table ``[simulation]`` of a cell file, in SI units, by what `KEYS` say that each key gives."""
    if path is None:
        return {}
    table = tomllib.loads(read_bytes(path, "cell file").decode("utf-8-sig")).get("simulation", {})
    found: dict[str, Any] = {}
    if "moved_target" in table:
        found["target"] = str(table.pop("moved_target"))
    for key, value in table.items():
        where = f"{path}: '{key}' in [simulation]"
        if key not in KEYS:
            known = [*KEYS, "moved_target"]
            raise CalibError(
                f"{where} is unknown{did_you_mean(key, known)}. It may have {choices(known)}."
            )
        name, to_si, count = KEYS[key]
        numbers = value if isinstance(value, list) else [value]
        if len(numbers) != count or not all(map(is_number, numbers)):
            what = "three numbers" if count == 3 else "a number"
            raise CalibError(f"{where} is {value!r}; it must be {what}.")
        scaled = to_si * np.array(numbers, dtype=np.float64)
        found[name] = scaled if count == 3 else float(scaled[0])
    return found


def read_scenario(robot: Robot, cell: Cell, words: Words, path: Path | None = None) -> Scenario:
    """The scenario of a robot and a cell, with what the command line and the cell file at ``path`` add."""
    more = read_simulation(path)
    model = DEFAULT_MODEL if cell.model == "auto" else cell.model
    units = {p.name: p.unit for p in error_model(robot, model, target=False).parameters}
    errors, noise = tuple(_named_errors(words.error, units)), noise_of(cell, words.noise)
    target_error, true_robot = TARGET_ERROR, None
    if words.target_error is not None:
        target_error = abs(_amount(words.target_error, "--target-error", FAMILIES["length"].unit))
    if words.truth_robot is not None:
        true_robot = Robot.load(words.truth_robot, robot.base, robot.tip, held=robot.held)
    moved = None
    if "row" in more or "by" in more:
        by = more.get("by", np.zeros(3))
        moved = MovedTarget(int(more.get("row", 1)), by, more.get("target"))
    sigma_angle = _PROBE if cell.sigma_angle is None else cell.sigma_angle
    return Scenario(
        robot=robot,
        cell=cell,
        model=model,
        sizes=sizes_of(cell, words.sizes, named=bool(errors)),
        errors=errors,
        true_robot=true_robot,
        target_error=target_error,
        noise=noise,
        sigma_angle=0.0 if noise is None else sigma_angle,
        encoder=Encoder(more.get("angle", 0.0), more.get("length", 0.0)),
        outliers=parse_outliers(words.outliers, more.get("size", Outliers().size)),
        moved=moved,
        drift=more.get("drift", np.zeros(3)),
        visits=int(more.get("visits", 1)),
    )


def sizes_of(cell: Cell, text: str | None, *, named: bool) -> Mapping[str, float] | None:
    """``length 0.5 mm, angle 3 mrad`` or ``none``; by default none beside named errors, else the cell's, or typical."""
    if text is None and not named:
        return {f: cell.priors.of(f) for f in FAMILIES} if cell.priors.sizes == "given" else {}
    if text is None or text.strip() == _NONE:
        return None
    found: dict[str, float] = {}
    for part in text.split(","):
        name, _, value = part.strip().partition(" ")
        if name not in FAMILIES or name in found:
            raise CalibError(
                f"--sizes was given as \"{text}\"; it must be '{_NONE}', or sizes with commas between them such as "
                f'"length 0.5 mm, angle 3 mrad", each once of {choices(FAMILIES)}.'
            )
        found[name] = _amount(value, f"--sizes, {name}", FAMILIES[name].unit)
        if found[name] < 0.0:
            raise CalibError(f"--sizes, {name}: '{value.strip()}' must not be below 0.")
    return found


def _named_errors(pairs: Iterable[str], units: Mapping[str, str]) -> Iterable[tuple[str, float]]:
    """Single errors, ``elbow_joint.rx=2 mrad`` each, in the units of the parameters."""
    for pair in dict.fromkeys(pairs):
        name, _, value = (part.strip() for part in pair.rpartition("="))
        if name not in units:
            raise CalibError(
                f"--error '{pair}': the robot has no error '{name}' in this model{did_you_mean(name, units)}. Write "
                f"such as 'elbow_joint.rx=2 mrad'; it has {choices(units)}."
            )
        yield name, _amount(value, "--error", unit_of(units[name]))


def _amount(text: str, option: str, unit: Unit) -> float:
    """A number with its unit, in SI; 0 needs none."""
    try:
        value, kind = parse_quantity(text.strip())
    except CalibError as error:
        raise CalibError(f'{option} "{text}": {error}. Write "{unit.example}".') from error
    if kind != unit.quantity and value != 0.0:
        raise CalibError(
            f'{option} "{text}": that is {kind}, {unit.quantity} is wanted: "{unit.example}".'
        )
    return value


def noise_of(cell: Cell, text: str | None) -> TrackerNoise | None:
    """The noise as said, ``15 um + 6 um/m``, ``0.05 mm`` or ``none``, else the cell's; None: none at all."""
    if text is not None:
        if text.strip() in (_NONE, "0"):
            return None
        read = parse_noise(text, "--noise")
        return TrackerNoise(*read, 0.0) if any(read) else None
    found = TrackerNoise() if cell.tracker is None else cell.tracker.noise
    return found if cell.sigma is None else TrackerNoise(cell.sigma, 0.0, 0.0)


def parse_outliers(text: str | None, size: float) -> Outliers | None:
    """A number of rows, ``3``, or a share of them, ``5 %``."""
    if text is None:
        return None
    number = re.fullmatch(r"\s*(\d{1,9}|\d*\.?\d+(?=\s*%))\s*(%?)\s*", text)
    if number is None:
        raise CalibError(
            f'--outliers was given as "{text}"; it must be a number of rows, such as "3", or a share of those to '
            'estimate from, such as "5 %".'
        )
    if number[2]:
        return Outliers(share=float(number[1]) / 100.0, size=size)
    return Outliers(count=int(number[1]), size=size)


SCHEMA = "truth 1"


def write_truth(
    scenario: Scenario, made: Simulated, path: str | Path, *, overwrite: bool = False
) -> Path:
    """Write what was true of a simulated table.

    Raises:
        UrdfError: No ``<origin>`` of the URDF can hold one of the errors.
        FileError: The file exists, or cannot be written.
    """
    truth, table, robot = made.truth, made.measurements, made.truth.nominal
    model, noise, moved = truth.model, scenario.noise, scenario.moved
    targets = zip(truth.targets, truth.T_tip_target, truth.said_T_tip_target, strict=True)
    leaders = np.argmax(np.abs(model.mixing), axis=1)
    content = {
        "schema": SCHEMA,
        "seed": made.seed,
        "robot": {
            "name": robot.name,
            "urdf_sha256": robot.urdf.sha256,
            "base": robot.base,
            "tip": robot.tip,
            "joints": robot.joint_names,
            "held": [{"joint": name, "value": value} for name, value in sorted(robot.held.items())],
        },
        "model": {
            "set": model.name,
            "ties": [
                {"name": term.name, "other": model.names[leader], "factor": row[leader]}
                for term, row, leader in zip(model.terms, model.mixing, leaders, strict=True)
                if term.name not in model.names
            ],
        },
        "parameters": [
            {"name": p.name, "unit": p.unit, "value": value}
            for p, value in zip(model.parameters, truth.x, strict=True)
        ],
        "displacements": [
            {
                "name": term.name,
                "place": term.place,
                "twist": term.direction,
                "value": value,
                "times": term.factor.name if term.factor else "",
            }
            for term, value in zip(model.terms, model.values(truth.x), strict=True)
        ],
        "origins": [
            {"joint": name, **_pose(T)} for name, T in sorted(truth.robot.origins().items())
        ],
        "targets": [
            {"target": name, **_pose(T), **_pose(said, "said_")} for name, T, said in targets
        ],
        "set_ups": [
            {"group": name, **_pose(T, "frame_base_")}
            for name, T in zip(truth.groups, truth.T_frame_base, strict=True)
        ],
        "payload": truth.payload and {"mass_kg": truth.payload.mass, "com_m": truth.payload.com},
        "gravity_m_s2": truth.gravity,
        "instrument": {
            "kind": scenario.kind.name,
            "noise": noise
            and {
                "constant_m": noise.constant,
                "per_length_m_per_m": noise.per_length,
                "repeatability_m": noise.repeatability,
            },
            "sigma_angle_rad": scenario.sigma_angle,
            "tracker_base_xyz_m": scenario.tracker,
            "encoder_step_rad": scenario.encoder.angle,
            "encoder_step_m": scenario.encoder.length,
            "visits": scenario.visits,
        },
        "events": {
            "outliers": [
                {"row": table.rows[i], "displacement_m": made.outliers[i]}
                for i in np.flatnonzero(made.outliers.any(axis=1))
            ],
            "moved_target": moved
            and {"from_row": moved.row, "target": moved.target, "displacement_m": moved.by},
            "drift_m": scenario.drift,
        },
        "rows": [
            {
                "row": row,
                "target": table.targets[i],
                "group": table.groups[i],
                "joints": made.q[i],
                "xyz_m": made.points[i],
                "sigma_m": made.sigma[i],
            }
            for i, row in enumerate(table.rows)
        ],
    }
    return write_atomically(path, json_bytes(content), overwrite=overwrite)


def write_true_urdf(truth: Truth, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write the URDF of the true geometry, after reading it back with Pinocchio and yourdfpy.

    Raises:
        UrdfError: A reader disagrees with the model in memory by more than 1e-9 m or rad.
        FileError: The file exists, or cannot be written.
    """
    robot = truth.robot
    q = random_joint_values(robot)
    check_written(robot, robot.poses(q), q)
    return robot.urdf.write(path, overwrite=overwrite)


def _pose(T: NDArray[np.float64], prefix: str = "") -> dict[str, Any]:
    """A pose, [m], and roll, pitch, yaw about fixed axes x, y, z [rad]."""
    rpy = pin.rpy.matrixToRpy(np.ascontiguousarray(T[:3, :3]))
    return {f"{prefix}xyz_m": T[:3, 3], f"{prefix}rpy_rad": rpy}
