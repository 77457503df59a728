"""A scenario from the words of a command line, and from the table ``[simulation]`` of a cell file."""

from __future__ import annotations

from collections.abc import Mapping
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
from calib.data.cell_chains import robot_with_chains_of
from calib.data.inputs import chain_of, robot_of
from calib.errors import CalibError, choices
from calib.instruments.tracker import noise_of_lengths
from calib.model.families import FAMILIES, unit_of
from calib.model.parameter_sets import error_model
from calib.robot.robot import Robot
from calib.robot.urdf import read_urdf
from calib.verbs.simulate.disturbances import (
    Encoder,
    FrameStep,
    MovedTarget,
    Outliers,
    StandingTargets,
)
from calib.verbs.simulate.scenario import DEFAULT_MODEL, Scenario
from calib.verbs.simulate.truth import TARGET_ERROR


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
    step_row: float | None = key(
        "step_row",
        NUMBER,
        "First row that finds the measurement frame displaced.",
        default=None,
    )
    step_by: Array | None = key(
        "step_mm",
        POINT_MM,
        "Displacement of what is measured from that row on, in the measurement frame.",
        default=None,
    )
    references: float = key(
        "references",
        NUMBER,
        "Number of targets that stand still, as rows of the set `reference`.",
        default=0,
    )
    references_every: float = key(
        "references_every",
        NUMBER,
        "Number of stops of the robot between two readings of them.",
        default=StandingTargets().every,
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


#: Word for no noise, or no errors.
NONE = "none"

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
    """Read a scenario from options of the command line, and from the table ``[simulation]`` of a cell file.

    Args:
        robot: The nominal robot.
        cell: The cell, whose error model, noise and priors are the defaults; its model ``"auto"`` is taken as
            `DEFAULT_MODEL`.
        path: The cell's file, whose table ``[simulation]`` has the disturbances; None: there are none.
        words: Options of the command line; None: none are given.

    Raises:
        ModelError: An error's name that the model does not have.
        CalibError: A text that an option does not take, or a fault of the file.
    """
    words = words or ScenarioWords()
    table = {} if path is None else read_toml(path).get("simulation", {})
    disturbances = read_record(Disturbances, table, Place(heading=f"[simulation] of {path}"))

    model = DEFAULT_MODEL if cell.model == "auto" else cell.model
    parameters = error_model(robot, model, target=False, gravity=cell.gravity)
    errors: dict[str, float] = {}
    for pair in dict.fromkeys(words.error or ()):
        name, _, value = (part.strip() for part in pair.rpartition("="))
        unit = unit_of(parameters.parameters[parameters.index(name)].unit)
        errors[name] = parse_amount(value, "--error", unit.quantity, unit.example, signed=True)
    true_robot = None
    if words.truth_robot is not None:
        if robot.branches or robot.parts:
            true_robot = robot_with_chains_of(robot, read_urdf(words.truth_robot), robot.held)
        else:
            true_robot = robot_of(words.truth_robot, chain_of(robot))
    target_error = TARGET_ERROR
    if words.target_error is not None:
        target_error = parse_amount(words.target_error, "--target-error", LENGTH, "1 mm")

    # --noise is that of corners if these are measured, else that of lengths.
    of_images = cell.kind is not None and registry.get(cell.kind).is_image
    pixels = None
    noise: TrackerNoise | None = noise_of_lengths(cell)
    if words.noise is not None and of_images and words.noise != NONE:
        pixels = parse_amount(words.noise, "--noise", quantity_name("pixel"), "0.3 px")
    elif words.noise is not None:
        is_none = words.noise == NONE
        constant, per_length = (0.0, 0.0) if is_none else parse_noise(words.noise, "--noise")
        noise = TrackerNoise(constant, per_length, 0.0) if constant or per_length else None
    sigma: dict[str, float] = {}
    if noise is not None:
        usual = {symbol: unit.assumed_sigma for symbol, unit in RESIDUAL_UNITS.items()}
        sigma = usual | {"rad": _PROBE} | dict(cell.sigma)
        del sigma["m"]
    if pixels is not None:
        sigma["px"] = pixels

    outliers = None
    if words.outliers is not None:
        outliers = Outliers.parse(words.outliers, disturbances.outlier_size)
    moved = None
    if disturbances.moved_row is not None or disturbances.moved_by is not None:
        first_row = 1 if disturbances.moved_row is None else int(disturbances.moved_row)
        by = np.zeros(3) if disturbances.moved_by is None else disturbances.moved_by
        moved = MovedTarget(first_row, by, disturbances.moved_target)
    step = None
    if disturbances.step_row is not None or disturbances.step_by is not None:
        if disturbances.step_row is None or disturbances.step_by is None:
            raise CalibError(
                f"[simulation] of {path} has one of step_row and step_mm; a step of the frame needs both."
            )
        step = FrameStep(int(disturbances.step_row), disturbances.step_by)
    return Scenario(
        robot=robot,
        cell=cell,
        model=model,
        sizes=parse_error_sizes(cell, words.sizes, named=bool(errors)),
        errors=tuple(errors.items()),
        true_robot=true_robot,
        target_error=target_error,
        noise=noise,
        sigma=sigma,
        encoder=Encoder(disturbances.encoder_angle, disturbances.encoder_length),
        outliers=outliers,
        moved=moved,
        drift=disturbances.drift,
        step=step,
        standing=StandingTargets(int(disturbances.references), int(disturbances.references_every)),
        visits=int(disturbances.visits),
    )


def parse_error_sizes(cell: Cell, text: str | None, *, named: bool) -> Mapping[str, float] | None:
    """Parse standard deviations of errors, ``length 0.5 mm, angle 3 mrad``, or ``none``.

    Args:
        cell: Its priors are the default if they were given and no single errors are named.
        text: As typed; None: the default, which is the cell's priors or else typical sizes; with named errors, no
            others are drawn.
        named: Whether single errors are given by name.

    Returns:
        Standard deviations by the name of the family, in its SI unit; families that are missing have typical ones, so
        that an empty mapping means typical ones for all. None: no errors are drawn.

    Raises:
        CalibError: It is another text.
    """
    if text is None and not named:
        if cell.priors.source == "given":
            return {family: cell.priors.of(family) for family in FAMILIES}
        return {}
    if text is None or text.strip() == NONE:
        return None
    sizes: dict[str, float] = {}
    for part in text.split(","):
        name, _, value = part.strip().partition(" ")
        if name not in FAMILIES:
            raise CalibError(
                f"--sizes was given as \"{text}\"; it must be '{NONE}', or standard deviations "
                'with commas between them such as "length 0.5 mm, angle 3 mrad", of '
                f"{choices(FAMILIES)}."
            )
        unit = FAMILIES[name].unit
        sizes[name] = parse_amount(value, f"--sizes, {name}", unit.quantity, unit.example)
    return sizes
