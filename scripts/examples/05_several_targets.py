"""Three reflectors on one flange: its orientation is known twice as well as by one, at as many poses."""

import numpy as np

import calib

robot = calib.Robot.load("ur3", base="base", tip="tool0")

# A plate on the flange has three nests for reflectors, whose places in the flange were measured: they are known.
nests = {
    "A": np.array([0.06, 0.0, 0.03]),  # x, y, z in tool0 [m]
    "B": np.array([-0.03, 0.052, 0.03]),
    "C": np.array([-0.03, -0.052, 0.03]),
}
cell = calib.Cell(targets=nests, estimate_target=False)
scenario = calib.Scenario(robot, cell=cell)
virtual = scenario.draw(seed=1)

# At each of 15 poses the tracker measures A, B and C: 45 rows, and the column 'target' says which.
data = virtual.measure(scenario.random_poses(15, seed=1), seed=1).measurements
print(f"rows: {len(data)}, targets: {sorted(set(data.targets))}")
only_A = data.select(np.array([target == "A" for target in data.targets]))
cell_A = calib.Cell(target=nests["A"], estimate_target=False)

# Truth: where the flange of the virtual robot really is at other poses.
unseen = scenario.random_poses(500, seed=2)
T_true = virtual.truth.tip_poses(unseen)


def flange_errors(result: calib.Calibration) -> tuple[float, float]:
    """Return rms errors of the flange's position [mm] and orientation [mrad] at the unseen poses."""
    T = result.tip_poses(unseen)
    position = np.linalg.norm(T[:, :3, 3] - T_true[:, :3, 3], axis=1)
    # The angle of the rotation from one to the other: |R - R_true| = 2 sqrt(2) sin(angle / 2)
    angle = np.linalg.norm(T[:, :3, :3] - T_true[:, :3, :3], axis=(1, 2)) / np.sqrt(2)
    return 1e3 * float(np.sqrt(np.mean(position**2))), 1e3 * float(np.sqrt(np.mean(angle**2)))


one = flange_errors(calib.calibrate(robot, only_A, cell=cell_A))
three = flange_errors(calib.calibrate(robot, data, cell=cell))
for name, (mm, mrad) in (("one reflector", one), ("three reflectors", three)):
    print(f"{name}: flange off by {mm:.3f} mm and {mrad:.2f} mrad rms at 500 other poses")
assert three[0] < one[0] < 0.1
assert three[1] < 0.5 * one[1]
