"""Covariance of a tool's predicted pose, in the measurement frame and in the base, by the parameters of a result.

    C_pose(q)  =  J C J^T  +  J g g^T J^T  +  B P B^T

    J   derivative of the tool's pose by the parameters, C their covariance; parameters of a target count only if the
        tool is that target: any other tool is known in the tip
    g   their change by the scale error of the instrument, rms
    B   derivative by a motion of the base, P covariance of what the model leaves out of the first joint's placement

The last term counts in the base only, and only if the measurement frame was estimated: such a frame absorbs whatever
displaces the first joint in the base, so that no measurement determines it. What the model has of it is in C, with the
variance of its prior; the rest is P, with the prior standard deviations of the same families.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

import calib.data.kinds as registry
from calib.basics.arrays import Array, rigid_inverse
from calib.model.error_model import TARGET
from calib.model.error_on_chain import model_on_chain
from calib.model.families import FAMILIES
from calib.model.frozen import frozen_parameters
from calib.model.kinematics import Samples
from calib.model.parameter_sets import DIRECTIONS, OWN, error_model, split_name
from calib.numerics.rigid_motion import displacements_by
from calib.result.calibration import Calibration
from calib.result.fitted_model import FittedModel, twists_in_base
from calib.robot.robot import Robot

#: Number of rows whose derivatives are in memory at the same time.
_AT_A_TIME = 2048


class View(NamedTuple):
    """Tool as seen from a frame."""

    #: N samples of joint values, frames and targets.
    samples: Samples
    #: shape (4, 4), a tool known in the tip [m]; None: the target of each sample.
    T_tip_tool: Array | None
    #: Whether poses are in the base, not in the frame of each sample.
    in_base: bool
    #: shape (6, 6), covariance of a motion of the base besides the parameters, along and about its axes, linear part
    #: first [m, rad]; None for the base less the motion of it that compensates best, see `FittedModel.base_motion`.
    base: Array | None


class PoseCovariance(NamedTuple):
    """Covariance of N predicted poses."""

    #: Shape (N, 6, 6), of each pose along the axes of its frame, linear part first [m, rad].
    covariance: Array
    #: shape (k,), variances of independent unknowns that all rows share: the mean square of the positions' errors is
    #: sum_k shared_k z_k^2 with standard normal z [m^2].
    shared: Array
    #: Mean square of the positions' errors, as far as it comes from the priors and not from the noise [m^2].
    by_priors: float
    #: Mean square of the positions' errors, as far as it comes from a scale error of the instrument [m^2].
    by_scale: float

    @property
    def mean_square(self) -> Array:
        """Mean squares over the rows, of positions [m^2] and of angles [rad^2], shape (2,)."""
        variances = np.diagonal(self.covariance, axis1=1, axis2=2)
        return np.asarray(variances.reshape(-1, 2, 3).sum(axis=2).mean(axis=0))


def pose_covariance(part: FittedModel, view: View) -> PoseCovariance:
    """Compute the covariance of the poses of a view that the parameters' covariance after a fit makes.

    Args:
        part: A result's geometry or its non-geometric model, with p parameters.
        view: The tool, its poses and the frame.

    Returns:
        The covariance, and its parts that all rows share.
    """
    # Of the parameters and of a motion of the base. A tool that is known in the tip does not depend on a target.
    p = len(part.x)
    covariance = np.zeros((p + 6, p + 6))
    covariance[:p, :p] = _determined(part)
    if view.T_tip_tool is not None:
        of_target = part.model.family(TARGET)
        covariance[:p, :p][of_target[:, None] | of_target] = 0.0
    if view.base is not None:
        covariance[p:, p:] = view.base
    # R R^T is the covariance, which may be singular.
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    # The scale error of the instrument is one more unknown.
    growth = np.pad(part.change_by_scale, (0, 6))
    if view.T_tip_tool is not None:
        growth[:p][part.model.family(TARGET)] = 0.0
    whole_root = np.column_stack([root, growth])

    derivative = _derivative(part, view)
    count = len(view.samples)
    covariances = []
    gram = np.zeros((p + 7, p + 7))
    for first in range(0, count, _AT_A_TIME):
        block = view.samples.select(slice(first, first + _AT_A_TIME))
        J = derivative(block) @ whole_root
        covariances.append(J @ J.swapaxes(1, 2))
        lengths = J[:, :3].reshape(-1, p + 7)
        gram += lengths.T @ lengths / count
    shared = np.maximum(np.linalg.eigvalsh(gram), 0.0)

    # Of the covariance C = (H + L)^-1, with the measurements' H and the precision L of the priors, the share C L C is
    # the priors'.
    precision = np.zeros((p + 6, p + 6))
    prior_std = _typical(part)
    if part.prior_std:
        prior_std = np.array([parameter.prior_std for parameter in part.parameters], np.float64)
    variances = np.square(prior_std)
    precision[range(p), range(p)] = np.where(variances > 0.0, 1.0 / variances, 0.0)
    if view.base is not None:
        precision[p:, p:] = np.linalg.pinv(view.base, hermitian=True)
    by_priors = float(np.sum(gram[:-1, :-1] * (root.T @ precision @ root)))
    return PoseCovariance(np.concatenate(covariances), shared, by_priors, float(gram[-1, -1]))


def unknown_base_directions(result: Calibration, base: str | None = None) -> tuple[str, ...]:
    """Return the directions of the base that no measurement determines, of `calib.model.parameter_sets.DIRECTIONS`.

    They are those that are estimated of every frame in which positions were measured; all six if none were measured.

    Args:
        result: The calibration.
        base: The link that is the base, of a result of several chains: frames on other links do not count.
    """
    rows, setup = result.rows, result.setup
    common = set(DIRECTIONS)
    links = dict(zip(setup.groups, setup.frame_links, strict=False)) if base else {}
    seen = set(zip(rows.groups, rows.kinds, rows.estimation.tolist(), strict=True))
    for group, kind, fitted in seen:
        if fitted and registry.get(kind).position and links.get(group, base) == base:
            common &= set(setup.unknown[setup.groups.index(group)])
    return tuple(direction for direction in DIRECTIONS if direction in common)


def unmodelled_base(result: Calibration, part: FittedModel, number: int = 0) -> Array:
    """Compute the covariance of the first joint's placement that a model leaves out, as a motion of the base (6, 6).

    Every direction of the placement counts that neither a parameter of the model nor a frozen one has, with the prior
    standard deviation of its family, along the directions of the base that no measurement determines.

    Args:
        result: The calibration.
        part: Its geometry or its non-geometric model.
        number: Number of the chain that is commanded. If it passes the estimated mount of a further robot, the first
            joint is that of a chain that does not: the mount takes up what displaces the robot that stands on it.

    Returns:
        Covariance along and about the base's axes, linear part first [m^2, m rad, rad^2]; zero for a known base.
    """
    tree = result.nominal
    robot = tree.chains[number]
    if {*tree.mounts} & {*robot.path}:
        others = [chain for chain in tree.chains if chain.base == robot.base]
        without = [chain for chain in others if not {*tree.mounts} & {*chain.path}]
        robot = next(iter(without), robot)
    if robot.carriers[0] is None:
        return np.zeros((6, 6))
    joint = robot.joints[0].name
    T_base_joint = rigid_inverse(robot.T_root_base) @ robot.placements[0]
    into_base = pin.SE3(T_base_joint).toActionMatrix() @ _left_out(result, part, robot)
    base = robot.base if tree.branches else None
    unknown = np.isin(DIRECTIONS, unknown_base_directions(result, base))

    # The standard deviation of each family: the model's, else that of the largest candidate with it, else the typical.
    prior_std = {name: family.typical for name, family in FAMILIES.items()}
    largest_first = sorted(result.method.candidates, key=lambda candidate: -candidate.parameters)
    for candidate in reversed(largest_first):
        prior_std.update(candidate.prior_std)
    prior_std.update(part.prior_std)

    covariance = np.zeros((6, 6))
    placement = model_on_chain(error_model(tree, "placement", target=False), tree, robot)
    for error in placement.terms:
        if error.place == joint and error.family in prior_std:
            motion = unknown * (into_base @ error.direction)
            covariance += np.outer(motion, motion) * float(prior_std[error.family]) ** 2
    return covariance


def _left_out(result: Calibration, part: FittedModel, chain: Robot) -> Array:
    """Return the projection P (6, 6) of twists in a chain's first placement onto those that a model leaves out.

    P = I - D^+ D,    D: directions of its errors and of frozen ones, one a row
    """
    tree = result.nominal
    on_chain = model_on_chain(part.model, tree, chain)
    modelled = [term for term in on_chain.terms if term.factor is None]
    # Frozen parameters of the model's set and of the placements: the user takes them for exact.
    sets = {"placement"}
    if part.model.name != OWN:
        sets.add(split_name(part.model.name)[0])
    for name in sorted(sets):
        of_set = error_model(tree, name, target=False)
        frozen = frozen_parameters(tree, of_set.parameters, result.method.frozen)
        terms = model_on_chain(of_set, tree, chain).terms
        modelled += [term for term in terms if term.name in frozen]
    joint = chain.joints[0].name
    directions = [term.direction for term in modelled if term.place == joint]
    spanned = np.array(directions).reshape(-1, 6)
    return np.asarray(np.eye(6) - np.linalg.pinv(spanned) @ spanned)


def _derivative(part: FittedModel, view: View) -> Callable[[Samples], Array]:
    """Return a function that differentiates poses by the p parameters and a motion of the base.

    From N samples it returns their twists, linear part first, (N, 6, p + 6), [m] and [rad] per unit.
    """
    kinematics, x = part.kinematics, part.x
    if view.T_tip_tool is not None:
        tools = np.broadcast_to(view.T_tip_tool, kinematics.T_tip_target.shape)
        kinematics = replace(kinematics, T_tip_target=tools)
        x = np.where(part.model.family(TARGET), 0.0, x)
    gauge = part.base_motion if view.base is None else None

    def derivative(samples: Samples) -> Array:
        if view.in_base:
            poses, twists = twists_in_base(kinematics, x, samples)
        else:
            poses, twists = kinematics.twists(x, samples)
        points = poses[:, :3, 3]
        if gauge is not None:
            twists[:, :3] -= displacements_by(gauge, points)
            twists[:, 3:] -= gauge[3:]
        of_base = np.tile(np.eye(6), (len(points), 1, 1))
        of_base[:, :3] = displacements_by(np.eye(6), points)
        return np.concatenate([twists, of_base], axis=2)

    return derivative


def _determined(part: FittedModel) -> Array:
    """Return the covariance of the parameters, (p, p), with typical errors in place of priors if the fit had none.

    Without priors, what no measurement determines has a standard deviation of a metre or a radian. With the variances D
    that are typical of the families of the robot's parameters r, it is C - C_r (C_rr + D)^-1 C_r^T.
    """
    of_robot = part.model.of_robot
    if part.prior_std or not np.any(of_robot):
        return part.covariance
    typical = np.diag(np.square(_typical(part)[of_robot]))
    columns = part.covariance[:, of_robot]
    return np.asarray(
        part.covariance - columns @ np.linalg.solve(columns[of_robot] + typical, columns.T)
    )


def _typical(part: FittedModel) -> Array:
    """Return typical standard deviations of the parameters' families, (p,); NaN for frames and targets."""
    families = [FAMILIES.get(parameter.family) for parameter in part.model.parameters]
    return np.array([np.nan if family is None else family.typical for family in families])
