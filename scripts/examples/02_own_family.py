"""A family of joint errors of one's own: strain-wave gears that err twice in each turn of the motor.

A URDF cannot hold such an error: it is used in predictions and in compensated commands.
"""

import numpy as np

import calib
from calib import families

RATIO = 100  # turns of the motor in one turn of the joint
TWICE = 2 * RATIO

# A joint is off by dq = s sin(200 q) + c cos(200 q), with s and c of its own.
families.register(
    families.Family(
        name="strain_wave",
        unit=families.RAD,
        prior=0.2e-3,  # where the estimate of their size starts [rad]
        typical=0.3e-3,  # how large they are in a virtual robot [rad]
        factors=(
            # slope: the derivative by q, which the inverse kinematics of compensation needs
            families.Factor(
                "sin200", lambda s: np.sin(TWICE * s.q), lambda s: TWICE * np.cos(TWICE * s.q)
            ),
            families.Factor(
                "cos200", lambda s: np.cos(TWICE * s.q), lambda s: -TWICE * np.sin(TWICE * s.q)
            ),
        ),
    )
)

# From here on its name can stand behind a '+' wherever a model is named.
robot = calib.Robot.load("ur3", base="base", tip="tool0")
scenario = calib.Scenario(robot, model="placement+strain_wave")
virtual = scenario.draw(seed=3)
data = virtual.measure(scenario.random_poses(120, seed=3), seed=3).measurements

result = calib.calibrate(robot, data, model="placement+strain_wave")
gears = result.non_geometric  # the model with errors that depend on the joints' state
assert gears is not None
assert result.cross_validation is not None
assert gears.cross_validation is not None
geometry_only = result.cross_validation.errors["m"].rms
with_gears = gears.cross_validation.errors["m"].rms
print(f"held-out error, geometry only: {1e3 * geometry_only:.3f} mm rms")
print(f"held-out error, with the gears: {1e3 * with_gears:.3f} mm rms")

print("parameter                     estimated      true [mrad]")
for p in gears.parameters:
    if p.name.endswith(("sin200", "cos200")):
        true = virtual.truth.value(p.name)
        print(f"{p.name:27}{1e3 * p.value:12.3f}{1e3 * true:10.3f}")
        assert abs(p.value - true) < 4.5 * p.std
assert with_gears < 0.1e-3 < geometry_only
