"""A scenario from the words of a command line, and from the table ``[simulation]`` of a cell file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import calib.data.kinds as registry
from calib.basics.arrays import Array
from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.records import key, read_record
from calib.basics.units import LENGTH, parse_amount, parse_noise, quantity_name
from calib.basics.value_forms import DEGREES, MM, NUMBER, POINT_MM, Place, text
from calib.data.cell import Cell, TrackerNoise, read_toml
from calib.data.inputs import chain_of, robot_of
from calib.instruments.camera import is_image
from calib.instruments.tracker import noise_of_lengths
from calib.model.error_model import error_model
from calib.model.families import unit_of
from calib.model.parameters import ErrorModel
from calib.robot.robot import Robot
from calib.verbs.simulate.disturbances import Encoder, MovedTarget, Outliers
from calib.verbs.simulate.scenario import DEFAULT_MODEL, Scenario
from calib.verbs.simulate.truth import NONE, TARGET_ERROR, parse_error_sizes


@dataclass(frozen=True, slots=True, eq=False)
class Disturbances:
    """The table ``[simulation]`` of a cell file."""

    visits: float = key("visits", NUMBER, "Number of times that all poses are visited.", default=1)
    #: [rad]
    encoder_angle: float = key(
        "encoder_deg", DEGREES, "Resolution of the encoders of revolute joints.", default=0.0
    )
    #: [m]
    encoder_length: float = key(
        "encoder_mm", MM, "Resolution of the encoders of prismatic joints.", default=0.0
    )
    #: [m]
    outlier_size: float = key(
        "outlier_size_mm", MM, "Displacement of an outlier.", default=Outliers().size
    )
    #: shape (3,) [m]
    drift: Array = key(
        "drift_mm",
        POINT_MM,
        "Drift of the instrument from the first to the last row, in the measurement frame.",
        default_factory=lambda: np.zeros(3),
        absent="none",
    )
    moved_row: float | None = key(
        "moved_row", NUMBER, "First row that finds the target displaced.", default=None
    )
    #: shape (3,) [m]
    moved_by: Array | None = key(
        "moved_mm", POINT_MM, "Displacement of the target, along the axes of the tip.", default=None
    )
    moved_target: str | None = key(
        "moved_target",
        text("the name of a target"),
        "Target that is displaced.",
        default=None,
        absent="all targets",
    )


#: Noise of an orientation about each axis, of a tracker's 6D probe [rad].
_PROBE = float(np.radians(0.01))


@dataclass(frozen=True, slots=True)
class ScenarioWords:
    """Errors of the robot and disturbances of the measurements, as typed on the command line; None: not given."""

    sizes: Annotated[
        str | None,
        typer.Option(
            metavar='"FAMILY VALUE, ..."',
            help='Standard deviations of the errors, such as "length 0.5 mm, angle 3 mrad", or none. Default: typical '
            "ones, or none with --error.",
        ),
    ] = None
    error: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE",
            help='A single error, such as "elbow_joint.rx=2 mrad". Can be repeated.',
        ),
    ] = None
    truth_robot: Annotated[
        Path | None, typer.Option(help="URDF with the true geometry of the robot.")
    ] = None
    target_error: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH",
            help="Standard deviation of the stated positions of the targets. Default: 1 mm.",
        ),
    ] = None
    noise: Annotated[
        str | None,
        typer.Option(
            help='Noise of a coordinate, such as "0.05 mm" or "15 um + 6 um/m", or none; for pictures that of a '
            'corner, such as "0.3 px". Default: that of the cell, or else of a usual tracker.'
        ),
    ] = None
    outliers: Annotated[
        str | None,
        typer.Option(metavar='N|"P %"', help="Number of outliers, or their share of the rows."),
    ] = None


def read_scenario(
    robot: Robot,
    cell: Cell,
    path: Path | None = None,
    words: ScenarioWords | None = None,
) -> Scenario:
    """Read a scenario.

    Args:
        robot: The nominal robot.
        cell: The cell.
        path: Its file, whose table ``[simulation]`` counts too; None: there is none.
        words: Options of the command line; None: none are given.

    Returns:
        The scenario.

    Raises:
        CalibError: A text that an option does not take, or a fault of the file.
    """
    words = words or ScenarioWords()
    disturbances = _disturbances(path)
    model = DEFAULT_MODEL if cell.model == "auto" else cell.model
    all_errors = error_model(robot, model, target=False, gravity=cell.gravity)
    errors = tuple(_named_errors(words.error or (), all_errors))
    noise, sigma = _noise(cell, words.noise)
    outliers = None
    if words.outliers is not None:
        outliers = Outliers.parse(words.outliers, disturbances.outlier_size)
    return Scenario(
        robot=robot,
        cell=cell,
        model=model,
        sizes=parse_error_sizes(cell, words.sizes, named=bool(errors)),
        errors=errors,
        true_robot=_true_robot(robot, words.truth_robot),
        target_error=_target_error(words.target_error),
        noise=noise,
        sigma=sigma,
        encoder=Encoder(disturbances.encoder_angle, disturbances.encoder_length),
        outliers=outliers,
        moved=_moved_target(disturbances),
        drift=disturbances.drift,
        visits=int(disturbances.visits),
    )


def _disturbances(path: Path | None) -> Disturbances:
    """Read the table ``[simulation]`` of a cell file; None: there is no file."""
    table = {} if path is None else read_toml(path).get("simulation", {})
    return read_record(Disturbances, table, Place(heading=f"[simulation] of {path}"))


def _true_robot(robot: Robot, path: Path | None) -> Robot | None:
    """Load the true robot, with the chain of the nominal one; None without a file."""
    if path is None:
        return None
    return robot_of(path, chain_of(robot))


def _target_error(text: str | None) -> float:
    """Parse ``--target-error`` [m]; the default without one."""
    if text is None:
        return TARGET_ERROR
    return parse_amount(text, "--target-error", LENGTH, "1 mm")


def _noise(cell: Cell, text: str | None) -> tuple[TrackerNoise | None, dict[str, float]]:
    """Parse ``--noise``: of the images of corners [px], of anything else that of lengths.

    Args:
        cell: Has the kind, and the noise where nothing is typed.
        text: As typed; None: not given.

    Returns:
        The noise of lengths, and that of one scalar in the other units by their symbols.
    """
    of_images = cell.kind is not None and is_image(registry.get(cell.kind))
    if not of_images or text is None or text == NONE:
        noise = parse_tracker_noise(cell, text)
        return noise, _further_noise(cell, noise)
    pixels = parse_amount(text, "--noise", quantity_name("pixel"), "0.3 px")
    noise = noise_of_lengths(cell)
    return noise, {**_further_noise(cell, noise), "px": pixels}


def _further_noise(cell: Cell, noise: TrackerNoise | None) -> dict[str, float]:
    """Return the noise of one scalar in units other than of length: the cell's, or a usual one; none without noise."""
    if noise is None:
        return {}
    usual = {symbol: unit.assumed_sigma for symbol, unit in RESIDUAL_UNITS.items()}
    del usual["m"]
    of_cell = {unit: std for unit, std in cell.sigma.items() if unit != "m"}
    return usual | {"rad": _PROBE} | of_cell


def _moved_target(disturbances: Disturbances) -> MovedTarget | None:
    """Return the target that moves; None if none does."""
    row, by = disturbances.moved_row, disturbances.moved_by
    if row is None and by is None:
        return None
    displacement = np.zeros(3) if by is None else by
    return MovedTarget(int(1 if row is None else row), displacement, disturbances.moved_target)


def _named_errors(pairs: Iterable[str], model: ErrorModel) -> Iterator[tuple[str, float]]:
    """Parse single errors, ``elbow_joint.rx=2 mrad`` each, in the units of the parameters."""
    for pair in dict.fromkeys(pairs):
        name, _, value = (part.strip() for part in pair.rpartition("="))
        unit = unit_of(model.parameters[model.index(name)].unit)
        yield name, parse_amount(value, "--error", unit.quantity, unit.example, signed=True)


def parse_tracker_noise(cell: Cell, text: str | None) -> TrackerNoise | None:
    """Parse ``--noise``: ``15 um + 6 um/m``, ``0.05 mm`` or ``none``.

    Args:
        cell: Has the noise where nothing is typed: its own sigma, its tracker's, or a usual tracker's.
        text: As typed; None: not given.

    Returns:
        The noise; None: none at all.

    Raises:
        CalibError: It is no such text.
    """
    if text is not None:
        constant, per_length = (0.0, 0.0) if text == NONE else parse_noise(text, "--noise")
        return TrackerNoise(constant, per_length, 0.0) if constant or per_length else None
    return noise_of_lengths(cell)
