"""A kind of measurement of one's own: a depth camera that sees the target at u, v [px] and a depth [m]."""

import numpy as np

import calib
from calib import kinds

FOCAL, CENTRE = 1200.0, np.array([960.0, 600.0])  # of the camera, which looks along its z axis [px]


def image_and_depth(T: np.ndarray) -> np.ndarray:
    """Return u, v and depth, (n, 3), of targets at the poses T, (n, 4, 4), in the camera's frame."""
    return np.hstack([CENTRE + FOCAL * T[:, :2, 3] / T[:, 2:3, 3], T[:, 2:3, 3]])


def derivative(_measured: np.ndarray, T: np.ndarray, twists: np.ndarray) -> np.ndarray:
    """Return how they change with p parameters, (n, 3, p), as the targets move by twists, (n, 3, p)."""
    x_y, depth = T[:, :2, 3, None], T[:, 2:3, 3, None]
    d_image = FOCAL / depth * (twists[:, :2] - x_y / depth * twists[:, 2:3])
    return np.concatenate([d_image, twists[:, 2:3]], axis=1)


depth_camera = kinds.Kind(
    name="depth_camera",
    words="image and depth of the target",
    units=("px", "px", "m"),  # scalars of one unit share a noise, which is estimated
    readings=(
        kinds.Reading("u", "pixel"),
        kinds.Reading("v", "pixel"),
        kinds.Reading("depth", "length"),
    ),
    measure=image_and_depth,
    derivative=derivative,
)
kinds.register(depth_camera)

# The camera stands about 1.8 m in front of the robot: the start of the estimate of its pose.
cell = calib.Cell(
    kind="depth_camera",
    T_frame_base=np.array([[0, 1, 0, 0], [0, 0, -1, 0.2], [-1, 0, 0, 1.8], [0, 0, 0, 1.0]]),
    estimate_frame=True,
    model="dh",
)
robot = calib.Robot.load("ur3", base="base", tip="tool0")
noise = calib.TrackerNoise(constant=0.3e-3, per_length=0.0)  # of the depth [m]
scenario = calib.Scenario(robot, cell=cell, model="dh", sigma={"px": 0.1}, noise=noise)
measured = scenario.draw(seed=2).measure(scenario.random_poses(100, seed=2), seed=2).measurements
measured.write("images.csv")

data = calib.Measurements.read("images.csv", robot.joint_names, kind="depth_camera")
result = calib.calibrate(robot, data, cell=cell)
before, after = (result.errors[which]["estimation"] for which in ("nominal", "calibrated"))
print(f"image: {before['px'].rms:.2f} px rms before, {after['px'].rms:.2f} px after")
print(f"depth: {1e3 * before['m'].rms:.2f} mm rms before, {1e3 * after['m'].rms:.2f} mm after")
print(f"noise: {result.noise.sigma['px']:.3f} px, {1e3 * result.noise.sigma['m']:.3f} mm")
assert abs(result.noise.sigma["px"] - 0.1) < 0.02
assert abs(result.noise.sigma["m"] - 0.3e-3) < 0.06e-3
