"""An inspection as text: the chain, its DH rows, what poses determine, and the forecast of a fit to them."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array
from calib.basics.channels import RESIDUAL_UNITS
from calib.data.inputs import GENERIC_ANCHOR, GENERIC_TARGET
from calib.model.dh_table import dh_table
from calib.robot.robot import Robot
from calib.show.as_text import blocks_text
from calib.show.blocks import Block, Bullets, Paragraph
from calib.show.lines import deg, listed, mm, plural
from calib.show.reference_text import reference_lines
from calib.show.robot_sentences import coupling_sentence, rows_sentence
from calib.show.tables import Column, Table, name_column
from calib.show.words import combination_text, joint_unit, with_unit
from calib.verbs.inspect.inspection import Inspection
from calib.verbs.plan.forecast import Forecast

#: Pose differences below this are rounding: the pose is shown as the identity.
_ROUNDING = 1e-9


def inspection_text(robot: Robot, inspection: Inspection, forecast: Forecast | None = None) -> str:
    """Write an inspection.

    Args:
        robot: The robot.
        inspection: The observability of its model's parameters.
        forecast: The expected error of a fit to the poses of a table; None without a table.

    Returns:
        The chains, the DH rows of a single one, the parameters, and the forecast, in lines of 100 columns.
    """
    expected = ""
    if forecast is not None:
        f = forecast
        noise = [
            f"{with_unit(std, unit)} {RESIDUAL_UNITS[unit].per}" for unit, std in f.sigma.items()
        ]
        expected = (
            f"Forecast for a fit of these {f.poses} poses with a noise of {listed(noise)}: position error {mm(f.rms)} "
            f"mm rms over the joint limits (90 % of calibrations: {mm(f.rms_low)} to {mm(f.rms_high)}), {mm(f.max)} mm "
            "at the worst place."
        )
        if "m" in f.sigma:
            # The variance over the noise's is about rank / N for an optimal design of N poses.
            best_rms = f.sigma["m"] * (f.workspace_rank / f.poses) ** 0.5
            expected += (
                f" The best {f.poses} poses would give about {mm(best_rms)} mm rms; calib plan finds such "
                "poses."
            )
        else:
            expected += " calib plan finds better poses."
    # DH rows are of one chain.
    dh = () if robot.branches else _dh(robot)
    fault = inspection.fault_by_yourdfpy
    reader = "yourdfpy, another reader of URDFs, finds the same poses in this file."
    if fault:
        reader = (
            f"yourdfpy, another reader of URDFs, does not find this robot in the file ({fault}). Programs that are "
            "built on it will not either."
        )
    blocks = (
        *_chain(robot),
        Bullets([] if fault is None else [reader], indent="  ", tight=True),
        *dh,
        *_parameters(inspection),
        Bullets(
            [] if inspection.drift is None else list(reference_lines(inspection.drift)),
            "Targets that stand still:" if inspection.drift else "",
            "  ",
        ),
        Paragraph(expected),
    )
    return blocks_text(blocks)


def _chain(robot: Robot) -> Iterator[Block]:
    """Tabulate the joints of all chains with their limits, then word joints without a column, and bases that move."""
    rows = []
    for joint in robot.all_joints:
        axis = " ".join(f"{v + 0.0:.4g}" for v in joint.axis)
        limits = "none"
        if joint.lower is not None and joint.upper is not None:
            factor, unit = joint_unit(prismatic=joint.type == "prismatic")
            limits = f"{factor * joint.lower:.1f} to {factor * joint.upper:.1f} {unit}"
        rows.append((joint.name, joint.type, axis, limits))
    columns = (
        name_column("joint", 33),
        name_column("type", 11),
        name_column("axis", 23),
        name_column("limits"),
    )
    chains = listed([f"{chain.base} to {chain.tip}" for chain in robot.chains])
    title = f"Robot '{robot.name}' ({robot.urdf.source}), {'chains' if robot.branches else 'chain'} {chains}"
    yield Table(title, columns, rows, title_above=True, indent="  ")

    # A joint that several chains pass is worded once.
    sentences = list(dict.fromkeys(one for chain in robot.chains for one in _followers(chain)))
    coupling = coupling_sentence(robot)
    if coupling:
        sentences.append(coupling)
    of_rows = rows_sentence(robot)
    if of_rows:
        below = " The rows below are of the same robot, with z along each joint's own axis."
        sentences.append(f"{of_rows}.{'' if robot.branches else below}")
    sentences += [
        f"Joints move the base '{base}' itself; they are listed from the base outwards."
        for base in dict.fromkeys(chain.base for chain in robot.chains if chain.base_moves)
    ]
    yield Bullets(sentences, indent="  ", tight=True)


def _followers(chain: Robot) -> Iterator[str]:
    """Yield sentences on the joints of one chain without a column: what they follow, or where they are held."""
    all_at_zero = np.zeros(len(chain.inputs))
    offsets = chain.chain_values(all_at_zero)[0]
    for joint, factors, offset in zip(chain.joints, chain.mimic_matrix, offsets, strict=True):
        # What is added to the measured joints, times their factors (m,).
        factor, unit = joint_unit(prismatic=joint.type == "prismatic")
        value = f"{factor * float(offset):g} {unit}"
        if not np.any(factors):
            yield f"'{joint.name}' is held at {value}."
            continue
        largest = int(np.argmax(np.abs(factors)))
        driver = chain.inputs[largest].name
        if driver != joint.name:
            added = "" if offset == 0 else f", plus {value}"
            yield f"'{joint.name}' follows '{driver}', times {factors[largest]:g}{added}."


def _dh(robot: Robot) -> Iterator[Block]:
    """Tabulate the DH rows, and write the frames before and after them."""
    table = dh_table(robot)
    columns = (
        name_column("joint", 34),
        Column("a [mm]", 12, gap=0, unit="mm", digits=4),
        Column("alpha [deg]", 12, unit="deg", digits=4),
        Column("d [mm]", 11, unit="mm", digits=4),
        Column("theta [deg]", 12, unit="deg", digits=4),
        Column("beta [deg]", 11, unit="deg", digits=4),
    )
    rows = [
        (row.joint, row.a, row.alpha, row.d, row.theta, row.beta if row.near_parallel else math.nan)
        for row in table.rows
    ]
    title = "Standard DH rows, T = Rz(theta + q) Tz(d) Tx(a) Rx(alpha) Ry(beta)"
    notes = [
        "beta is given only where axes are nearly parallel (Hayati); there d is set to 0 by convention.",
        f"base to DH frame 0: {_pose_text(table.T_base_0)}",
        f"DH frame n to tip: {_pose_text(table.T_n_tip)}",
    ]
    yield Table(title, columns, rows, title_above=True, indent="  ")
    yield Bullets(notes, indent="  ", tight=True)


def _pose_text(T: Array) -> str:
    """Write a pose (4, 4) [m] as position [mm] and roll, pitch and yaw [deg]."""
    if np.abs(T - np.eye(4)).max() < _ROUNDING:
        return "identity"
    angles = pin.rpy.matrixToRpy(T[:3, :3])
    xyz = " ".join(mm(length, 4) for length in T[:3, 3])
    rpy = " ".join(deg(angle, 4) for angle in angles)
    return f"xyz {xyz} mm, rpy {rpy} deg"


def _parameters(inspection: Inspection) -> Iterator[Block]:
    """List the parameters of the model, and what the poses determine of them."""
    o, names = inspection.observability, inspection.model.names
    count = f"{len(names)}"
    if not all(o.identifiable):
        count += ", * known in combination with others only"
    marked = [
        name if identifiable else f"{name}*"
        for name, identifiable in zip(names, o.identifiable, strict=True)
    ]
    lead = f"Parameters of the model '{inspection.model.name}' ({count}):"
    yield Bullets([", ".join(marked)], lead, "  ")

    poses = f"the {inspection.poses} estimation rows of {inspection.source}"
    if inspection.source is None:
        poses = f"{inspection.poses} poses spread over the joint limits"
    assumed = (
        ("target", GENERIC_TARGET, "off the tip"),
        ("anchor", GENERIC_ANCHOR, "from the base"),
    )
    for name, place, frame in assumed:
        if name in inspection.assumed:
            xyz = ", ".join(f"{1e3 * v:.0f}" for v in place)
            poses += f", {name} {xyz} mm {frame}"
    rank = f"rank {o.rank} of {o.columns}, condition {o.condition:.1f}"
    indices = ", ".join(f"{name} {value:.3g}" for name, value in o.indices.items())
    yield Paragraph(f"Identifiable from {poses}: {rank}")
    if inspection.other_end:
        yield Paragraph(
            f"The board looks the same from both ends: {plural(len(inspection.other_end), 'picture')} numbered from "
            f"the other one, as the robot's motion shows, first '{inspection.other_end[0]}'.",
            tight=True,
        )
    yield Paragraph(f"Observability indices: {indices} (in steps of 1 mm, 1 mrad)", tight=True)
    lead = "Unidentifiable combinations, without effect on the measurements:"
    yield Bullets([combination_text(one) for one in o.unidentifiable], lead, "  ", tight=True)
