"""Make a robot follow a straight path although its controller keeps the nominal model: correct the commands."""

import numpy as np

import calib

TOOL = np.array(
    [0.05, 0.0, 0.1]
)  # the tool's point in the tip, where the reflector was mounted [m]
START = np.radians([-20.0, -80.0, 85.0, -95.0, -90.0, 0.0])  # joint values at the path's start

robot = calib.Robot.load("ur3", base="base", tip="tool0")  # the model in the controller
cell = calib.Cell(target=TOOL, estimate_target=False, instrument="tracker")
scenario = calib.Scenario(robot, cell=cell)
virtual = scenario.draw(seed=5)  # the real robot
data = virtual.measure(scenario.random_poses(40, seed=5), seed=5).measurements
result = calib.calibrate(robot, data, cell=cell)

# A line of 200 mm along y in steps of 10 mm, the tool's orientation kept, as a CAD program gives it.
T_tip_tool = np.eye(4)
T_tip_tool[:3, 3] = TOOL
path = np.tile(robot.poses(START) @ T_tip_tool, (21, 1, 1))
path[:, 1, 3] += np.linspace(0.0, 0.2, 21)

# The search for joint values of the first pose starts at START, that of each other pose at the one before.
start = dict(zip(robot.joint_names, START, strict=True))
program = calib.Program.of_poses(path, start=start)
commands = calib.compensate(result, program, tool=TOOL)
assert commands.reached.all()


def off_the_path(q: np.ndarray) -> np.ndarray:
    """Return how far the real robot's tool is from each point of the path at joint values q [mm]."""
    T_base_tool = virtual.truth.tip_poses(q) @ T_tip_tool
    error: np.ndarray = np.linalg.norm(T_base_tool[:, :3, 3] - path[:, :3, 3], axis=1)
    return 1e3 * error


without = off_the_path(commands.q_nominal)
corrected = off_the_path(commands.q)
expected = 1e3 * commands.expected_errors[:, 0]
print(f"without compensation: {without.mean():.2f} mm off the path, at most {without.max():.2f} mm")
print(f"with compensation: {corrected.mean():.3f} mm, at most {corrected.max():.3f} mm")
print(f"as the calibration expected: {expected.mean():.3f} mm")
largest = np.degrees(np.abs(commands.joint_corrections)).max()
print(f"largest correction of a joint: {largest:.2f} deg")

header = ",".join(f"{name} [deg]" for name in robot.joint_names)
np.savetxt("commands.csv", np.degrees(commands.q), "%.5f", ",", header=header, comments="")
print("written: commands.csv, 21 rows for the controller")
assert corrected.max() < 0.2 < 1.0 < without.max()
