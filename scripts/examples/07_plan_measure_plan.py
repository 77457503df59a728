"""Plan a few poses, measure them, and plan further ones with what the first have told."""

import numpy as np

import calib

# What the plan needs: about where the reflector is, and about how good the instrument is.
robot = calib.Robot.load("ur3", base="base", tip="tool0")
cell = calib.Cell(target=np.array([0.05, 0.05, 0.05]), sigma={"m": 0.05e-3}, model="placement")
scenario = calib.Scenario(robot, cell=cell)
virtual = scenario.draw(seed=2)
unseen = scenario.random_poses(500, seed=2)


def true_error(result: calib.Calibration) -> float:
    """Return the rms error of predicted positions at 500 other poses [mm]."""
    difference = result.predict(unseen) - virtual.truth.points(unseen)
    return 1e3 * float(np.sqrt(np.mean(np.sum(difference**2, axis=1))))


# Twelve poses first. Fewer candidates than usual, and no table of other numbers of poses: it takes seconds.
request = calib.PlanRequest(count=12, validation=0, candidates=2000, ladder=False)
plan = calib.plan(robot, cell, request)
print(f"12 planned poses: expected {1e3 * plan.forecast.rms:.3f} mm rms, ", end="")
print(f"12 random ones {1e3 * plan.at_random.rms:.3f} mm")
first = virtual.measure(plan.joints, seed=1).measurements
result = calib.calibrate(robot, first, cell=cell)
print(f"measured: true error {true_error(result):.3f} mm rms")

# Now more is known: the robot, the reflector, and the noise. The next poses are chosen to add to the first.
known = calib.Cell(target=result.target, sigma=result.noise.sigma, model="placement")
request = calib.PlanRequest(count=12, validation=0, candidates=2000, ladder=False, seed=1)
further = calib.plan(result.robot, known, request, taken=plan.joints)
assert further.before is not None
print(
    f"expected {1e3 * further.before.rms:.3f} mm rms now, {1e3 * further.forecast.rms:.3f} mm with 12 more"
)
second = virtual.measure(further.joints, seed=2).measurements

both = calib.Measurements(
    joint_names=robot.joint_names,
    joints=np.vstack([first.joints, second.joints]),
    points=np.vstack([first.points, second.points]),
)
final = calib.calibrate(robot, both, cell=cell)
print(f"measured: true error {true_error(final):.3f} mm rms")
assert further.forecast.rms < further.before.rms
assert true_error(final) < true_error(result)
assert true_error(final) < 0.1
