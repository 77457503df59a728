"""Calibrate, measure new poses another day, and test the result against a tolerance."""

import calib

TOLERANCE = 0.3e-3  # the largest position error that the application allows [m]
UNCERTAINTY = 0.06e-3  # expanded uncertainty (k = 2) of one measured position [m]

robot = calib.Robot.load("ur3", base="base", tip="tool0")
scenario = calib.Scenario(robot)
virtual = scenario.draw(seed=4)

# Day one: calibrate, and keep the result.
data = virtual.measure(scenario.random_poses(40, seed=1), seed=1).measurements
calib.calibrate(robot, data).write_json("result.json")

# Day two: ten poses that the fit has never seen, with the same reflector and the same tracker.
virtual.measure(scenario.random_poses(10, seed=99), seed=99).measurements.write("fresh.csv")
result = calib.Calibration.read_json("result.json")
fresh = calib.Measurements.read("fresh.csv", result.robot.joint_names)

# known: frames and targets of day one. Without it they would be fitted to the new rows, which flatters the robot.
calibrated = calib.evaluate(result.robot, fresh, known=result.setup)
nominal = calib.evaluate(result.nominal, fresh, known=result.nominal_setup)
print(calibrated.summary())

outcomes = {}
for name, evaluation in (("nominal", nominal), ("calibrated", calibrated)):
    found = calib.acceptance(evaluation, {"m": TOLERANCE}, uncertainty={"m": UNCERTAINTY})
    check = found.checks["m"]
    print(
        f"{name}: largest error {1e3 * check.figure:.3f} mm, with the uncertainty "
        f"{1e3 * check.held:.3f} mm, tolerance {1e3 * TOLERANCE:.1f} mm: {found.outcome}"
    )
    outcomes[name] = found.outcome
assert outcomes == {"nominal": "fail", "calibrated": "pass"}
