"""Other programs on the data of benchmark.py, without calib: prints their times and what they find, as JSON.

    python scripts/benchmark_peers.py points.npz
    python scripts/benchmark_peers.py pictures.npz

Run by any Python that has them: robotkinecal needs NumPy 1, and hand-eye calibration OpenCV 4, so that both need an
environment of their own (pip install robotkinecal "opencv-python-headless<4.12"). What is not installed is left out.

Points: robotkinecal (product of exponentials, Li et al. 2016) on points in the base. Pictures: `cv2.calibrateCamera`
and `cv2.calibrateHandEye`, which take the arm as exact; and a bundle adjustment by `scipy.optimize.least_squares` of
lens, camera on the hand and board on the base together, begun there, the arm as exact too.
"""

from __future__ import annotations

import importlib
import json
import sys
import time
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


# Points


def robotkinecal(data: dict[str, Array]) -> dict[str, Any]:
    """Fit joint screws and the target to points, and predict fresh ones."""
    rtb = importlib.import_module("roboticstoolbox")
    peer = importlib.import_module("robotkinecal")
    robot = rtb.ERobot.URDF(str(data["urdf"]))
    began = time.perf_counter()
    fit = peer.SerialRobotKineCal(robot, ee_name="target")
    fit.set_observations(list(data["joints"]), list(data["points"]))
    fit.solve()
    seconds = time.perf_counter() - began
    last = data["joints"].shape[1] + 1
    predicted = [fit.forward_kinematics(last, q).t for q in data["fresh_joints"]]
    miss = np.linalg.norm(np.array(predicted) - data["fresh_points"], axis=1)
    return {"error_m": float(np.sqrt(np.mean(miss**2))), "seconds": seconds}


# Pictures


def camera_and_hand_eye(data: dict[str, Array]) -> dict[str, Any]:
    """Calibrate the lens, then the camera on the hand; the board is where the mean of the pictures has it."""
    cv2 = importlib.import_module("cv2")
    began = time.perf_counter()
    points, pixels = data["board"].astype(np.float32), data["pixels"].astype(np.float32)
    size = tuple(int(length) for length in data["size"])
    _, K, lens, turns, places = cv2.calibrateCamera(
        [points] * len(pixels), pixels, size, None, None
    )
    boards = [pose(np.concatenate([np.ravel(t), np.ravel(p)])) for t, p in zip(turns, places)]  # noqa: B905
    hands = data["T_base_hand"]
    R, t = cv2.calibrateHandEye(
        [T[:3, :3] for T in hands],
        [T[:3, 3] for T in hands],
        [T[:3, :3] for T in boards],
        [T[:3, 3] for T in boards],
    )
    T_hand_camera = np.eye(4)
    T_hand_camera[:3, :3], T_hand_camera[:3, 3] = R, np.ravel(t)
    seen = np.array([T @ T_hand_camera @ board for T, board in zip(hands, boards)])  # noqa: B905
    u, _, vt = np.linalg.svd(seen[:, :3, :3].mean(axis=0))
    T_base_board = np.eye(4)
    T_base_board[:3, :3], T_base_board[:3, 3] = u @ vt, seen[:, :3, 3].mean(axis=0)
    return {
        "seconds": time.perf_counter() - began,
        "T_hand_camera": T_hand_camera.tolist(),
        "T_base_board": T_base_board.tolist(),
        "lens": [K[0, 0], K[1, 1], K[0, 2], K[1, 2], *np.ravel(lens)[:5]],
    }


def bundle(data: dict[str, Array], start: dict[str, Any] | None) -> dict[str, Any]:
    """Fit lens, camera on the hand and board on the base to all corners at once, by SciPy's own differences.

    Args:
        data: The pictures.
        start: What hand-eye calibration found; None: the true places, since nothing else is there to begin with.
    """
    from scipy.optimize import least_squares

    began = time.perf_counter()
    hands_inverse = np.linalg.inv(data["T_base_hand"])
    points, pixels = data["board"], data["pixels"]
    if start is None:
        T_hand_camera, T_base_board = data["T_hand_camera"], data["T_base_board"]
        lens = np.concatenate([data["guess"], np.zeros(5)])
    else:
        T_hand_camera, T_base_board = (
            np.array(start["T_hand_camera"]),
            np.array(start["T_base_board"]),
        )
        lens = np.array(start["lens"])

    def residual(x: Array) -> Array:
        """Return how far corners are from their images, (2 n,) [px]."""
        T = np.linalg.inv(pose(x[9:15])) @ hands_inverse @ pose(x[15:21])
        seen = points @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3]
        return np.asarray((project(seen, x[:9]) - pixels).ravel())

    x = np.concatenate([lens, vector(T_hand_camera), vector(T_base_board)])
    found = least_squares(residual, x, x_scale="jac")
    return {
        "seconds": time.perf_counter() - began,
        "T_hand_camera": pose(found.x[9:15]).tolist(),
        "T_base_board": pose(found.x[15:21]).tolist(),
        "lens": found.x[:9].tolist(),
    }


def project(seen: Array, lens: Array) -> Array:
    """Return the images (..., 2) [px] of points (..., 3) in the camera by fx, fy, cx, cy, k1, k2, p1, p2, k3."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = lens
    a, b = seen[..., 0] / seen[..., 2], seen[..., 1] / seen[..., 2]
    r2 = a**2 + b**2
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a**2)
    v = b * radial + p1 * (r2 + 2 * b**2) + 2 * p2 * a * b
    return np.stack([fx * u + cx, fy * v + cy], axis=-1)


def pose(x: Array) -> Array:
    """Return the pose (4, 4) of a rotation vector and a place (6,) [rad, m]."""
    from scipy.spatial.transform import Rotation

    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(x[:3]).as_matrix(), x[3:]
    return T


def vector(T: Array) -> Array:
    """Return the rotation vector and the place (6,) of a pose (4, 4)."""
    from scipy.spatial.transform import Rotation

    return np.concatenate([Rotation.from_matrix(T[:3, :3]).as_rotvec(), T[:3, 3]])


def main() -> None:
    """Print what each program finds that is installed here."""
    warnings.simplefilter("ignore")  # of programs that are not calib's
    with np.load(sys.argv[1]) as file:
        data = dict(file)
    found: dict[str, Any] = {}
    if "points" in data:
        try:
            found["robotkinecal"] = robotkinecal(data)
        except ImportError as error:
            print(f"robotkinecal is left out: {error}", file=sys.stderr)
    if "pixels" in data:
        try:
            found["hand_eye"] = camera_and_hand_eye(data)
        except (ImportError, AttributeError) as error:
            print(f"OpenCV's hand-eye calibration is left out: {error}", file=sys.stderr)
        found["bundle"] = bundle(data, found.get("hand_eye"))
    print(json.dumps(found))


if __name__ == "__main__":
    main()
