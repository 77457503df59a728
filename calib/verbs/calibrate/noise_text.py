"""Texts of the noise of a result: in each unit, of poses with covariances, and what it is stated for."""

from __future__ import annotations

from calib.basics.channels import RESIDUAL_UNITS, Channels
from calib.fit.registration.rows import USUAL_POSE_NOISE
from calib.numerics.correlated_noise import PoseNoise
from calib.result.calibration import Calibration
from calib.show.errors import measured_lengths
from calib.show.lines import listed
from calib.show.sizes import with_unit

#: Degrees of freedom from which on the noise is estimated from the rows, not from its prior.
ENOUGH_FREEDOM = 6.0


def noise_text(c: Calibration) -> str:
    """Word the estimated noise in each unit, and its source."""
    noise = [
        f"{with_unit(std, unit)} {per_scalar(c.rows.channels, unit)}"
        for unit, std in c.noise.sigma.items()
    ]
    source = "mostly assumed: too few rows"
    if c.noise.freedom >= ENOUGH_FREEDOM:
        source = f"from residuals, {c.noise.freedom:.0f} d.o.f."
    return f"{listed(noise)} (1 sigma, {source})."


def pose_noise_text(noise: PoseNoise) -> str:
    """Word the scale of stated covariances, and what the robot adds to them."""
    along, about = with_unit(noise.position, "m"), with_unit(noise.orientation, "rad")
    added = f"{along} along and {about} about each axis of the measurement frame"
    if noise.joint > 0.0:
        added = f"{with_unit(noise.joint, 'rad')} at each joint, {added}"
    source = " (assumed: too few rows)" if noise == USUAL_POSE_NOISE else ""
    return (
        f"the stated standard deviations times {noise.scale:.2g}; the robot adds {added}{source}."
    )


def per_scalar(channels: Channels, unit: str) -> str:
    """Word what the noise of one scalar is stated for, such as ``"per coordinate"``."""
    if unit == "m":
        return f"per {measured_lengths(channels)}"
    return RESIDUAL_UNITS[unit].per
