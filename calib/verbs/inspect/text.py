"""An inspection as text: the chain, its DH rows, what poses determine, and the forecast of a fit to them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array, Mask
from calib.basics.channels import RESIDUAL_UNITS
from calib.data.generic import GENERIC_ANCHOR, GENERIC_TARGET
from calib.model.dh_table import dh_table
from calib.robot.dh.rows import DHRow
from calib.robot.robot import Robot
from calib.robot.urdf_tree import UrdfJoint
from calib.show.lines import fill, listed, number, wrap
from calib.show.readings import coupling_sentence, rows_sentence
from calib.show.sizes import with_unit
from calib.show.tables import Column, name_column, table_lines
from calib.show.words import combination_text
from calib.verbs.inspect.inspection import Inspection
from calib.verbs.plan.forecast import Forecast

_DEG = float(np.degrees(1.0))

#: Pose differences below this are rounding: the pose is shown as the identity.
_ROUNDING = 1e-9


def inspection_text(robot: Robot, inspection: Inspection, forecast: Forecast | None = None) -> str:
    """Write an inspection.

    Args:
        robot: The robot.
        inspection: The observability of its model's parameters.
        forecast: The expected error of a fit to the poses of a table; None without a table.

    Returns:
        The chain, its DH rows, the parameters, and the forecast, in lines of 100 columns.
    """
    sections = [_chain(robot), _dh(robot), _parameters(inspection)]
    parts = ["\n".join(lines) for lines in sections]
    if forecast is not None:
        parts.append(fill(_forecast(forecast), hang="  "))
    return "\n\n".join(parts)


def _forecast(f: Forecast) -> str:
    """Word a forecast, beside the error that the best poses would leave."""
    noise = [f"{with_unit(std, unit)} {RESIDUAL_UNITS[unit].per}" for unit, std in f.sigma.items()]
    text = (
        f"Forecast for a fit of these {f.poses} poses with a noise of {listed(noise)}: position error {_mm(f.rms)} mm "
        f"rms over the joint limits (90 % of calibrations: {_mm(f.rms_low)} to {_mm(f.rms_high)}), {_mm(f.max)} mm "
        "where it is worst."
    )
    if "m" not in f.sigma:
        return f"{text} calib plan finds better poses."
    best_rms = f.sigma["m"] * (f.workspace_rank / f.poses) ** 0.5
    return f"{text} The best {f.poses} poses would give about {_mm(best_rms)} mm rms; calib plan finds such poses."


def _mm(length: float) -> str:
    """Format a length [m] in mm with three digits."""
    return f"{1e3 * length:.3f}"


def _chain(robot: Robot) -> Iterator[str]:
    """Write the table of joints with their limits, then joints without a column, and a base that moves."""
    yield f"Robot '{robot.name}' ({robot.urdf.source}), chain {robot.base} to {robot.tip}:"
    columns = [
        name_column("  joint", 33),
        Column("type", 11, left=True),
        Column("axis", 23, left=True),
        Column("limits", left=True),
    ]
    yield from table_lines(columns, [_joint_row(joint) for joint in robot.joints])
    all_at_zero = np.zeros(len(robot.inputs))
    offsets = robot.chain_values(all_at_zero)[0]
    for joint, factors, offset in zip(robot.joints, robot.mimic_matrix, offsets, strict=True):
        text = _coupled(robot, joint, factors, float(offset))
        if text:
            yield wrap(text, "  ")
    coupling = coupling_sentence(robot)
    if coupling:
        yield wrap(coupling, "  ")
    rows = rows_sentence(robot)
    if rows:
        text = f"{rows}. The rows below are of the same robot, with z along each joint's own axis."
        yield wrap(text, "  ")
    if robot.base_moves:
        text = (
            f"Joints move the base '{robot.base}' itself; they are listed from the base outwards."
        )
        yield wrap(text, "  ")


def _joint_row(joint: UrdfJoint) -> tuple[str, str, str, str]:
    """Cells of a joint."""
    axis = " ".join(f"{v + 0.0:.4g}" for v in joint.axis)
    limits = "none"
    if joint.lower is not None and joint.upper is not None:
        factor, unit = _shown(joint)
        limits = f"{factor * joint.lower:.1f} to {factor * joint.upper:.1f} {unit}"
    return f"  {joint.name}", joint.type, axis, limits


def _shown(joint: UrdfJoint) -> tuple[float, str]:
    """Factor and unit of a joint's values."""
    return (1e3, "mm") if joint.type == "prismatic" else (_DEG, "deg")


def _coupled(robot: Robot, joint: UrdfJoint, factors: Array, offset: float) -> str:
    """Word what a joint without a column follows; empty for others.

    Args:
        robot: The robot, with m measured joints.
        joint: A joint of its chain.
        factors: Shape (m,), of the measured joints in the joint's value.
        offset: What is added to them [rad], [m] of a prismatic joint.
    """
    factor, unit = _shown(joint)
    value = f"{factor * offset:g} {unit}"
    if not np.any(factors):
        return f"'{joint.name}' is held at {value}."
    largest = int(np.argmax(np.abs(factors)))
    driver = robot.inputs[largest].name
    if driver == joint.name:
        return ""
    added = "" if offset == 0 else f", plus {value}"
    return f"'{joint.name}' follows '{driver}', times {factors[largest]:g}{added}."


def _dh(robot: Robot) -> Iterator[str]:
    """Write the table of DH rows, and the frames before and after them."""
    table = dh_table(robot)
    yield "Standard DH rows, T = Rz(theta + q) Tz(d) Tx(a) Rx(alpha) Ry(beta):"
    columns = [
        name_column("  joint", 34),
        Column("a [mm]", 12, gap=0),
        Column("alpha [deg]", 12),
        Column("d [mm]", 11),
        Column("theta [deg]", 12),
        Column("beta [deg]", 11),
    ]
    yield from table_lines(columns, [_dh_row(row) for row in table.rows])
    yield "  beta is given only where axes are nearly parallel (Hayati); there d is set to 0 by convention."
    yield f"  base to DH frame 0: {_place(table.T_base_0)}"
    yield f"  DH frame n to tip: {_place(table.T_n_tip)}"


def _dh_row(row: DHRow) -> list[str]:
    """Cells of a DH row, in mm and deg."""
    lengths_and_angles = (1e3 * row.a, _DEG * row.alpha, 1e3 * row.d, _DEG * row.theta)
    cells = [number(value, 4) for value in lengths_and_angles]
    beta = number(_DEG * row.beta, 4) if row.near_parallel else "-"
    return [f"  {row.joint}", *cells, beta]


def _place(T: Array) -> str:
    """Format a pose (4, 4) [m] as position [mm] and roll, pitch and yaw [deg]."""
    distance_from_identity = np.abs(T - np.eye(4)).max()
    if distance_from_identity < _ROUNDING:
        return "identity"
    angles = pin.rpy.matrixToRpy(T[:3, :3])
    xyz = " ".join(number(1e3 * length, 4) for length in T[:3, 3])
    rpy = " ".join(number(_DEG * angle, 4) for angle in angles)
    return f"xyz {xyz} mm, rpy {rpy} deg"


def _parameters(inspection: Inspection) -> Iterator[str]:
    """Write the parameters of the model, and what the poses determine of them."""
    o, names = inspection.observability, inspection.model.names
    count = f"{len(names)}"
    if not all(o.identifiable):
        count += ", * known in combination with others only"
    yield f"Parameters of the model '{inspection.model.name}' ({count}):"
    yield wrap(_marked(names, o.identifiable), "  ")
    yield ""
    rank = f"rank {o.rank} of {o.columns}, condition {o.condition:.1f}"
    yield wrap(f"Identifiable from {_poses(inspection)}: {rank}")
    indices = ", ".join(f"{name} {value:.3g}" for name, value in o.indices.items())
    yield wrap(f"Observability indices: {indices} (in steps of 1 mm, 1 mrad)")
    if o.unidentifiable:
        yield "Unidentifiable combinations, without effect on the measurements:"
        for combination in o.unidentifiable:
            yield wrap(combination_text(combination), "  ")


def _marked(names: Sequence[str], identifiable: Mask) -> str:
    """List names of parameters, with a star behind those that are known in combination only."""
    marked = []
    for name, is_identifiable in zip(names, identifiable, strict=True):
        mark = "" if is_identifiable else "*"
        marked.append(name + mark)
    return ", ".join(marked)


def _poses(inspection: Inspection) -> str:
    """Word the poses that were inspected, and the target and anchor that were assumed."""
    text = f"the {inspection.poses} estimation rows of {inspection.source}"
    if inspection.source is None:
        text = f"{inspection.poses} poses spread over the joint limits"
    assumed = (
        ("target", GENERIC_TARGET, "off the tip"),
        ("anchor", GENERIC_ANCHOR, "from the base"),
    )
    for name, place, frame in assumed:
        if name in inspection.assumed:
            xyz = ", ".join(f"{1e3 * v:.0f}" for v in place)
            text += f", {name} {xyz} mm {frame}"
    return text
