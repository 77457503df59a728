"""Calibrate from NumPy arrays alone: joint angles and measured points, no table and no cell file."""

import numpy as np

import calib

robot = calib.Robot.load("ur3", base="base", tip="tool0")

# The tracker stands anywhere: where it sees the base is estimated, and so is the reflector's place.
cell = calib.Cell(estimate_frame=True)

# A virtual robot with errors stands in for yours. Put your own two arrays in place of these lines.
scenario = calib.Scenario(robot, cell=cell)
virtual = scenario.draw(seed=1)
poses = scenario.random_poses(40, seed=1)
measured = virtual.measure(poses, seed=1).measurements
joints = np.array(measured.joints)  # (40, 6) [rad], columns in the order of robot.joint_names
points = np.array(measured.points)  # (40, 3) [m], the reflector in the tracker's frame

# The last ten rows are not fitted: they show what the calibration is worth at poses it has not seen.
data = calib.Measurements(
    joint_names=robot.joint_names,
    joints=joints,
    points=points,
    sets=("estimate",) * 30 + ("validate",) * 10,
)
result = calib.calibrate(robot, data, cell=cell)

before = result.errors["nominal"]["validation"]["m"].rms
after = result.errors["calibrated"]["validation"]["m"].rms
assert result.verdict is not None
print(f"verdict: {result.verdict.use}")
print(f"error on the ten unseen rows: {1e3 * before:.2f} mm rms before, {1e3 * after:.3f} mm after")
print(f"reflector in the tip: {np.round(1e3 * result.target, 2)} mm")

# Predictions are arrays too. This robot's truth is known, so that they can be compared with it.
unseen = scenario.random_poses(500, seed=2)
error = np.linalg.norm(result.predict(unseen) - virtual.truth.points(unseen), axis=1)
print(f"true error at 500 other poses: {1e3 * np.sqrt(np.mean(error**2)):.3f} mm rms")

result.write_urdf("corrected.urdf")
print("written: corrected.urdf")
assert after < 0.1e-3 < 1e-3 < before
assert error.max() < 0.3e-3
