"""``calib inspect``: what a robot is made of, and what measurements can tell of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.options import ModelOptions, RobotFile, TableOptions, verb
from calib.cli.terminal import fill

if TYPE_CHECKING:
    from calib.design.forecast import Forecast
    from calib.identify.inspection import Inspection
    from calib.model.robot import Robot


@dataclass(frozen=True, slots=True)
class _Options(ModelOptions):
    """The set-up; what is said of tip and target holds without a table too."""

    tip: Annotated[
        str | None,
        typer.Option(
            help="Link that the target is mounted on. Default: the end of the longest chain, with DATA of joints that "
            "are in it."
        ),
    ] = None
    target: Annotated[
        str | None,
        typer.Option(
            metavar='"X Y Z UNIT"',
            help='Target in the tip, such as "70 -70 22.5 mm". Default: found from DATA; without it 50, 70, 30 mm off '
            "the tip.",
        ),
    ] = None


@verb("""Show a robot's chain, its DH rows, the parameters of a model and which of them can be identified.

\b
Examples:
  calib inspect ur3 --base base --tip tool0
  calib inspect robot.urdf data.csv --model hayati

With a table, identifiability is that of its poses; without one, of 200 poses spread over the joint limits.
""")
def inspect(
    robot: RobotFile,
    said: _Options,
    read: TableOptions,
    data: Annotated[
        Path | None, typer.Argument(metavar="[DATA]", help="CSV table, to judge its poses.")
    ] = None,
) -> None:
    """See the text of `verb`."""
    from calib.cli.setup import load, load_with_data, read_cell, say_ignored
    from calib.identify.inspection import inspect as inspect_robot

    setup = read_cell(**asdict(said))
    if data is None:
        arm, table = load(robot, setup), None
    else:
        arm, table = load_with_data(robot, setup, data, **asdict(read))
        say_ignored(table, arm)
    found = inspect_robot(arm, setup, table)
    typer.echo("\n\n".join([_chain_text(arm), _dh_text(arm), _parameters_text(found)]))
    if table is not None:
        from calib.design.forecast import forecast_of_table, planned_model

        foreseen = forecast_of_table(arm, setup, table)
        if foreseen is not None:
            typer.echo(f"\n{_forecast_text(foreseen, planned_model(setup))}")


def _chain_text(robot: Robot) -> str:
    """The chain's joints with their limits."""
    import math

    lines = [
        f"Robot '{robot.name}' ({robot.urdf.source}), chain {robot.base} to {robot.tip}:",
        f"  {'joint':<32}{'type':<12}{'axis':<24}limits",
    ]
    for joint in robot.joints:
        axis = " ".join(f"{v + 0.0:.4g}" for v in joint.axis)
        scale, unit = (1e3, "mm") if joint.type == "prismatic" else (math.degrees(1.0), "deg")
        limits = (
            "none"
            if joint.lower is None or joint.upper is None
            else f"{scale * joint.lower:.1f} to {scale * joint.upper:.1f} {unit}"
        )
        lines += _row(joint.name, f"{joint.type:<12}{axis:<24}{limits}")
    return "\n".join([*lines, *(fill(text, "  ") for text in _coupling_texts(robot))])


def _coupling_texts(robot: Robot) -> Iterator[str]:
    """Sentences on joints that have no column of their own, and on a base that moves."""
    import math

    import numpy as np

    offsets = robot.chain_values(np.zeros(len(robot.inputs)))[0]
    for joint, row, offset in zip(robot.joints, robot.coupling, offsets, strict=True):
        slides = joint.type == "prismatic"
        rest = f"{1e3 * offset:g} mm" if slides else f"{math.degrees(offset):g} deg"
        if not np.any(row):
            yield f"'{joint.name}' is held at {rest}."
        elif robot.inputs[int(np.argmax(np.abs(row)))].name != joint.name:
            driver = robot.inputs[int(np.argmax(np.abs(row)))].name
            more = "" if offset == 0 else f", plus {rest}"
            yield f"'{joint.name}' follows '{driver}', times {row[np.argmax(np.abs(row))]:g}{more}."
    if robot.base_moves:
        yield (
            f"Joints move the base '{robot.base}' itself; they are passed from the base outwards, and their axes are "
            "turned round."
        )


def _row(name: str, cells: str) -> list[str]:
    """A row of a table that begins with a joint's name; a long name gets a line of its own."""
    return [f"  {name:<32}{cells}"] if len(name) < 32 else [f"  {name}", f"  {'':<32}{cells}"]


def _dh_text(robot: Robot) -> str:
    """The DH rows."""
    import math

    from calib.model.dh import dh_table

    def angle(value: float) -> str:
        return f"{round(math.degrees(value), 4) + 0.0:.4f}"

    def length(value: float) -> str:
        return f"{round(1e3 * value, 4) + 0.0:.4f}"

    table = dh_table(robot)
    lines = [
        "Standard DH rows, T = Rz(theta + q) Tz(d) Tx(a) Rx(alpha) Ry(beta):",
        f"  {'joint':<32}{'a [mm]':>12}{'alpha [deg]':>13}{'d [mm]':>12}{'theta [deg]':>13}{'beta [deg]':>12}",
    ]
    for row in table.rows:
        beta = angle(row.beta) if row.near_parallel else "-"
        lines += _row(
            row.joint,
            f"{length(row.a):>12}{angle(row.alpha):>13}{length(row.d):>12}{angle(row.theta):>13}{beta:>12}",
        )
    lines.append(
        "  beta stands only where axes are nearly parallel (Hayati); there d is set to 0 by convention."
    )
    for label, T in (("base to DH frame 0", table.T_base_0), ("DH frame n to tip", table.T_n_tip)):
        lines.append(f"  {label}: {_pose_text(T)}")
    return "\n".join(lines)


def _pose_text(T: object) -> str:
    """A pose as xyz and rpy, or that there is none."""
    import numpy as np
    import pinocchio as pin

    matrix = np.asarray(T)
    if np.abs(matrix - np.eye(4)).max() < 1e-9:
        return "identity"
    xyz = " ".join(f"{v + 0.0:.4f}" for v in np.round(1e3 * matrix[:3, 3], 4))
    rpy = " ".join(
        f"{v + 0.0:.4f}" for v in np.round(np.degrees(pin.rpy.matrixToRpy(matrix[:3, :3])), 4)
    )
    return f"xyz {xyz} mm, rpy {rpy} deg"


def _parameters_text(inspection: Inspection) -> str:
    """Parameters of the model, and what the poses can tell of them."""
    o = inspection.observability
    names = [
        name + ("" if alone else "*")
        for name, alone in zip(inspection.model.names, o.identifiable, strict=True)
    ]
    marked = "" if all(o.identifiable) else ", * known in combination with others only"
    indices = ", ".join(f"{name} {value:.3g}" for name, value in o.indices.items())
    lines = [
        f"Parameters of the model '{inspection.model.name}' ({len(inspection.model)}{marked}):",
        fill(", ".join(names), "  "),
        "",
        fill(
            f"Identifiable from {inspection.poses}: rank {o.rank} of {o.columns}, condition {o.condition:.1f}",
            hang="  ",
        ),
        fill(f"Observability indices: {indices} (in steps of 1 mm, 1 mrad)", hang="  "),
    ]
    if o.unidentifiable:
        lines.append("These changes move nothing that is measured:")
        lines += [fill(str(combination), "  ") for combination in o.unidentifiable]
    return "\n".join(lines)


def _forecast_text(foreseen: Forecast, model: str) -> str:
    """What a fit of these poses can reach, and what the best poses could."""
    bound = foreseen.sigma * (foreseen.workspace_rank / foreseen.poses) ** 0.5
    return fill(
        f"Forecast for a fit of these {foreseen.poses} poses, with the model '{model}' and a noise of "
        f"{1e3 * foreseen.sigma:.3f} mm a coordinate: position error {1e3 * foreseen.rms:.3f} mm rms over the joint "
        f"limits (90 % of calibrations: {1e3 * foreseen.rms_low:.3f} to {1e3 * foreseen.rms_high:.3f}), "
        f"{1e3 * foreseen.max:.3f} mm where it is worst. The best {foreseen.poses} poses would give about "
        f"{1e3 * bound:.3f} mm rms; calib plan finds such.",
        hang="  ",
    )
