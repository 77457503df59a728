"""The pictures of `calib demo --camera` by OpenCV's five hand-eye methods, which take the arm as exact, and by calib.

    pip install "opencv-python-headless<5"     of version 5 OpenCV has no hand-eye methods any more
    python scripts/hand_eye_study.py
    python scripts/hand_eye_study.py --models frames zeros dh auto --poses dh auto

Poses k and k + 6 of both places of the board are left out together, k = 0 to 5. Printed is what the left-out pictures
say: the rms distance of corners from their predictions, and that of the board's origin as found by solvePnP from where
the fit has it. Of the hand-eye methods the board stands at the mean of the fitted pictures, each place by itself. With
``--poses`` calib is given the poses by solvePnP alone, without and with their covariances.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from studies import print_table, rms_length, study_parser

from calib.basics.arrays import Array, Mask
from calib.boards.board_file import read_board
from calib.camera import optics
from calib.camera.camera_file import read_camera
from calib.camera.lenses import LENSES
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.example import franka_file
from calib.fit.registration.table_rows import rows_and_setup
from calib.numerics.geometry import pose_of
from calib.result.calibrate import calibrate
from calib.robot.robot import Robot

#: Names of OpenCV's methods.
METHODS = ("TSAI", "PARK", "HORAUD", "ANDREFF", "DANIILIDIS")

#: Step of differences [m, rad].
STEP = 1e-6

#: Links that carry the camera and the board.
CAMERA_ON, BOARD_ON = "panda_link8", "panda_link0"

#: Pictures of a place, of which every sixth is left out.
FOLDS = 6


@dataclass(frozen=True)
class Picture:
    """The corners of one picture."""

    place: str  # Where the board stood
    q: Array  # shape (7,), joint values [rad]
    points: Array  # shape (n, 3), the corners on the board [m]
    pixels: Array  # shape (n, 2), where they were found [px]


@dataclass(frozen=True)
class Prediction:
    """What a fit has of a left-out picture."""

    T_camera_board: Array  # shape (4, 4), [m]
    lens: Array  # shape (9,), numbers of the lens
    points: Array  # shape (n, 3), the corners as printed [m]


@dataclass(frozen=True)
class Data:
    """The pictures, and what is known of robot, camera and board."""

    robot: Robot  # The chain from the hand to the root
    table: Measurements
    cell: Cell

    @classmethod
    def load(cls) -> Data:
        """Read the example."""
        robot = Robot.load("panda", base=CAMERA_ON, tip=BOARD_ON)
        table = Measurements.read(franka_file("corners.csv"), joint_names=robot.joint_names)
        cameras = {"": read_camera(franka_file("camera.toml"))}
        boards = {"": read_board(franka_file("board.toml"))}
        return cls(robot, table, Cell(cameras=cameras, boards=boards))

    @property
    def lens(self) -> Array:
        """The factory's numbers of the lens."""
        values = self.cell.cameras[""].values
        assert values is not None
        return values

    def left_out(self, k: int) -> Mask:
        """Return the rows of poses k and k + 6."""
        numbers = [int(name.split("_")[-1].split(".")[0]) for name in self.table.images]
        return np.asarray(np.array(numbers) % FOLDS == k)

    def pictures(self, rows: Mask) -> list[Picture]:
        """Return the pictures that these rows are of."""
        m = self.table.select(rows)
        q = m.joints_for(self.robot.joint_names)
        pixels = np.column_stack([m.reading("u"), m.reading("v")])
        assert m.board_points is not None
        names = np.array(m.images)
        result = []
        for name in dict.fromkeys(m.images):
            of = names == name
            first = int(np.argmax(of))
            result.append(Picture(m.targets[first], q[first], m.board_points[of], pixels[of]))
        return result


def board_pose(points: Array, pixels: Array, lens: Array) -> Array:
    """Return T_camera_board by solvePnP, shape (4, 4) [m]."""
    fx, fy, cx, cy = lens[:4]
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    _, rotation, place = cv2.solvePnP(points, pixels, K, lens[4:])
    return pose_of(place.ravel(), cv2.Rodrigues(rotation)[0])


def by_hand_eye(method: str) -> Callable[[Data, int], Iterator[Prediction]]:
    """Return how one of OpenCV's methods predicts the left-out pictures of a fold."""
    number = getattr(cv2, f"CALIB_HAND_EYE_{method}")

    def predict(data: Data, k: int) -> Iterator[Prediction]:
        out = data.left_out(k)
        fitted = data.pictures(~out)
        for picture in data.pictures(out):
            of_place = [one for one in fitted if one.place == picture.place]
            T_hand_camera, T_base_board = hand_eye(data, of_place, number)
            T_base_hand = hand_pose(data, picture.q)
            T = np.linalg.inv(T_base_hand @ T_hand_camera) @ T_base_board
            yield Prediction(T, data.lens, picture.points)

    return predict


def hand_pose(data: Data, q: Array) -> Array:
    """Return the pose of the hand in the base by the nominal robot, shape (4, 4) [m]."""
    return np.asarray(np.linalg.inv(data.robot.poses(q[None])[0]))


def hand_eye(data: Data, pictures: list[Picture], method: int) -> tuple[Array, Array]:
    """Return T_hand_camera by one of OpenCV's methods, and the mean T_base_board, shape (4, 4) [m]."""
    hands = [hand_pose(data, one.q) for one in pictures]
    boards = [board_pose(one.points, one.pixels, data.lens) for one in pictures]
    calibrate_hand_eye = getattr(cv2, "calibrateHandEye")  # noqa: B009  of version 4 alone
    R, t = calibrate_hand_eye(
        [T[:3, :3] for T in hands],
        [T[:3, 3] for T in hands],
        [T[:3, :3] for T in boards],
        [T[:3, 3] for T in boards],
        method=method,
    )
    T_hand_camera = pose_of(t.ravel(), R)
    seen = np.array([T @ T_hand_camera @ board for T, board in zip(hands, boards, strict=True)])
    u, _, vt = np.linalg.svd(seen[:, :3, :3].mean(axis=0))
    return T_hand_camera, pose_of(seen[:, :3, 3].mean(axis=0), u @ vt)


def by_calib(model: str) -> Callable[[Data, int], Iterator[Prediction]]:
    """Return how a fit with a model predicts the left-out pictures of a fold."""

    def predict(data: Data, k: int) -> Iterator[Prediction]:
        out = data.left_out(k)
        result = calibrate(
            data.robot,
            data.table.select(~out),
            cell=data.cell,
            model=model,
            validate=model == "auto",
        )
        held_out = replace(data, table=data.table.select(out))
        rows, _ = rows_and_setup(data.robot, held_out.table, data.cell)
        seen = result.setup.sightings(result.robot.poses(rows.joints), rows.samples)
        assert seen.internals is not None
        values, T = seen.internals.values, seen.T_frame_target
        printed = optics.board_points(values)
        names = np.array(held_out.table.images)
        for name in dict.fromkeys(held_out.table.images):
            of = names == name
            first = int(np.argmax(of))
            yield Prediction(T[first], values[first, optics.INTRINSICS][:9], printed[of])

    return predict


def pose_covariance(T_camera_board: Array, points: Array, lens: Array) -> Array:
    """Return the covariance of a pose by solvePnP for corners of 1 px, shape (6, 6) [m^2, m rad, rad^2]."""
    columns = []
    for step in STEP * np.eye(6):
        ahead, behind = (
            _images(_moved(T_camera_board, change), points, lens) for change in (step, -step)
        )
        columns.append((ahead - behind).ravel() / (2.0 * STEP))
    J = np.column_stack(columns)
    return np.linalg.inv(J.T @ J)


def _moved(T_camera_board: Array, step: Array) -> Array:
    """Return a pose, shape (4, 4), moved along the camera's axes and turned about them by a step, shape (6,)."""
    turned = cv2.Rodrigues(step[3:])[0] @ T_camera_board[:3, :3]
    return pose_of(T_camera_board[:3, 3] + step[:3], turned)


def _images(T_camera_board: Array, points: Array, lens: Array) -> Array:
    """Return the images of points of the board, shape (n, 2) [px]."""
    in_camera = points @ T_camera_board[:3, :3].T + T_camera_board[:3, 3]
    return LENSES["pinhole"].project(in_camera, lens)


def by_poses(model: str, *, covariances: bool) -> Callable[[Data, int], Iterator[Prediction]]:
    """Return how a fit to poses by solvePnP, with or without covariances, predicts the left-out pictures of a fold."""

    def predict(data: Data, k: int) -> Iterator[Prediction]:
        out = data.left_out(k)
        table = _table_of_poses(data, data.pictures(~out), covariances=covariances)
        result = calibrate(
            data.robot,
            table,
            cell=Cell(estimate_frame=True),
            model=model,
            validate=model == "auto",
        )
        places = result.setup.targets
        for picture in data.pictures(out):
            T_base_tip = result.robot.poses(picture.q[None])[0]
            T_tip_board = result.setup.T_tip_target[places.index(picture.place)]
            T = result.setup.T_frame_base[0] @ T_base_tip @ T_tip_board
            yield Prediction(T, data.lens, picture.points)

    return predict


def _table_of_poses(data: Data, pictures: Sequence[Picture], *, covariances: bool) -> Measurements:
    """Return the table of the board's poses by solvePnP."""
    T = np.array([board_pose(one.points, one.pixels, data.lens) for one in pictures])
    stated = None
    if covariances:
        pairs = zip(T, pictures, strict=True)
        stated = np.array([pose_covariance(pose, one.points, data.lens) for pose, one in pairs])
    return Measurements(
        joint_names=data.robot.joint_names,
        joints=np.array([one.q for one in pictures]),
        points=T[:, :3, 3],
        rotations=T[:, :3, :3],
        kinds=("pose",) * len(pictures),
        targets=tuple(one.place for one in pictures),
        covariances=stated,
    )


def judge(data: Data, predict: Callable[[Data, int], Iterator[Prediction]]) -> tuple[float, float]:
    """Return the rms error of the left-out corners [px], and of the board's place [m]."""
    corners, places = [], []
    for k in range(FOLDS):
        pictures = data.pictures(data.left_out(k))
        for picture, predicted in zip(pictures, predict(data, k), strict=True):
            T = predicted.T_camera_board
            in_camera = predicted.points @ T[:3, :3].T + T[:3, 3]
            corners.append(picture.pixels - LENSES["pinhole"].project(in_camera, predicted.lens))
            found = board_pose(predicted.points, picture.pixels, predicted.lens)
            places.append(found[:3, 3] - T[:3, 3])
    return rms_length(np.concatenate(corners)), rms_length(np.array(places))


def main() -> None:
    """Print a row for each method."""
    parser = study_parser(__doc__)
    parser.add_argument("--models", nargs="*", default=["frames", "zeros", "dh", "auto"])
    parser.add_argument("--poses", nargs="*", default=[], help="models of fits to solvePnP's poses")
    arguments = parser.parse_args()
    data = Data.load()
    methods = {}
    if hasattr(cv2, "calibrateHandEye"):
        methods = {f"calibrateHandEye, {name}": by_hand_eye(name) for name in METHODS}
    methods |= {f"calib, --model {model}": by_calib(model) for model in arguments.models}
    for model in arguments.poses:
        methods[f"calib, poses, {model}"] = by_poses(model, covariances=False)
        methods[f"calib, poses with covariances, {model}"] = by_poses(model, covariances=True)
    figures = ((name, *judge(data, predict)) for name, predict in methods.items())
    rows = ([name, f"{px:.2f}", f"{1e3 * m:.2f}"] for name, px, m in figures)
    print_table(["method", "corners [px]", "board's place [mm]"], rows, [40])


if __name__ == "__main__":
    main()
