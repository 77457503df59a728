"""Lost motion: do the residuals go with the sides from which a joint arrived?

A joint that stops short by b, whichever way it came, is at q - b sign(m) with its last move m. With the derivative D of
what is predicted by the joint, b adds e = -D sign(m) to it; b and the squares R that it explains are as of a
displacement, see `calib.verbs.measure.moved`. Without lost motion R / s^2 follows F(1, nu - 1), with
s^2 = (Q - R) / (nu - 1).
"""

from __future__ import annotations

import numpy as np
from scipy.special import fdtri

from calib.verbs.measure.moved import LinearFit, derivative_by
from calib.verbs.measure.running_fit import RunningFit

#: Probability with which a robot without lost motion is said to have some.
_FALSE_ALARM = 1e-3

#: Degrees of freedom of the noise from which on it can be told.
_ENOUGH_FREEDOM = 6.0


def find_lost_motion(fit: RunningFit, factor: float) -> tuple[str, float] | None:
    """Find the joint whose lost motion explains most of the residuals of a fit without it.

    Args:
        fit: The fit.
        factor: Mean square of stops that are good, see `calib.verbs.measure.row_check.History`.

    Returns:
        The joint, and how far it stops short of its reading [rad] or [m]; None if none does significantly.
    """
    moves = fit.rows.samples.moves
    if moves is None or fit.fitted.kinematics.model.depends_on_moves:
        return None
    linear = LinearFit.of(fit)
    left = linear.freedom - 1.0
    if left < _ENOUGH_FREEDOM:
        return None
    model, slopes = derivative_by(fit)
    joints = fit.fitted.task.robot.joint_names
    limit = float(fdtri(1.0, left, 1.0 - _FALSE_ALARM / len(joints)))
    best: tuple[float, str, float] | None = None
    for j, joint in enumerate(joints):
        columns = [k for k, parameter in enumerate(model.parameters) if parameter.place == joint]
        if not columns:
            continue
        e = -slopes[:, :, columns[0]] * np.sign(moves[:, j, None])
        h, S = linear.beside(e.reshape(-1, 1))
        if S[0, 0] <= linear.ROUNDING * np.sum(e**2):
            continue
        gain = float(h[0] ** 2 / S[0, 0])
        noise = max(linear.square - gain, 0.0) / left * factor
        if gain > limit * noise and (best is None or gain > best[0]):
            best = gain, joint, float(h[0] / S[0, 0])
    return None if best is None else best[1:]
