"""calib beside other programs on the same simulated data: times, and errors against the truth.

The truth is another robot than the nominal one, which the programs are given: every DH parameter is off. Pictures: a
Panda with a camera on its hand and a board beside it, 24 pictures of 24 corners to 0.3 px; only the image's size is
known of the camera. Points: a Panda's target 50 mm off the flange, at 60 poses, to 0.05 mm, in the base.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from camera_study import ARMS, BOARD, SIZE_ALONE, draw, table_of
from numpy.typing import NDArray
from studies import rms_length

from calib.basics.arrays import Array, rigid_inverse
from calib.data.cell import Cell, TrackerNoise
from calib.numerics.geometry import pose_of
from calib.result.calibrate import calibrate
from calib.robot.robot import Robot
from calib.verbs.simulate.scenario import Scenario, VirtualCell, simulate

#: Pictures, and fresh poses at which predictions are judged.
PICTURES, FRESH = 24, 40

#: Virtual cells, over which errors are averaged.
CELLS = 3

#: Points, their noise [m], and where the target is on the flange [m].
POINTS, SIGMA = 60, 5e-5
OFFSET = np.array([0.05, 0.05, 0.05])


#: Titles of other programs.
_TITLES = {
    "hand_eye": "`cv2.calibrateCamera` and `calibrateHandEye`",
    "bundle": "bundle adjustment by SciPy, the arm exact",
}


@dataclass(frozen=True, eq=False)
class Truth:
    """A virtual cell as it is, and poses at which predictions are judged."""

    cell: VirtualCell
    #: Joint values of the fresh poses, shape (n, 7) [rad]
    fresh: Array
    #: Poses of the board in the camera there, shape (n, 4, 4) [m]
    T_camera_board: Array

    @classmethod
    def of(cls, cell: VirtualCell, seed: int) -> Truth:
        """Look at fresh poses of a cell."""
        fresh = cell.poses(FRESH, seed, validation=True)
        pictures = cell.measure(fresh, seed + 100_000).pictures
        assert pictures is not None
        return cls(cell, fresh, pictures.T_camera_board)

    def errors(self, T_camera_board: Array, T_hand_camera: Array, focal: float) -> list[float]:
        """Return how far off the camera on the hand [m], the focal length [1] and the board [m] are.

        Args:
            T_camera_board: Predictions at the fresh poses, shape (n, 4, 4) [m].
            T_hand_camera: The camera on the hand, shape (4, 4) [m].
            focal: Focal length along u [px].
        """
        assert self.cell.equipment is not None
        camera = self.cell.equipment.cameras[0].values
        assert camera is not None
        away = T_hand_camera[:3, 3] - rigid_inverse(self.cell.truth.T_frame_base[0])[:3, 3]
        change = T_camera_board - self.T_camera_board
        misses = change[:, :3, :3] @ BOARD.centre + change[:, :3, 3]
        return [float(np.linalg.norm(away)), focal / float(camera[0]) - 1.0, rms_length(misses)]


def picture_rows(peers: str) -> Iterator[list[str]]:
    """Yield time and errors of each program on pictures; ``peers`` is the Python that has the other ones."""
    figures: dict[str, list[list[float]]] = defaultdict(list)
    for seed in range(CELLS):
        cell = draw(*ARMS[0], seed)
        truth = Truth.of(cell, seed)
        q = cell.poses(PICTURES, seed)
        table = table_of(cell.measure(q, seed))
        nominal = cell.truth.nominal
        for model in ("frames", "auto"):
            known = Cell(cameras={"": SIZE_ALONE}, boards={"": BOARD})
            began = time.perf_counter()
            result = calibrate(nominal, table, cell=known, model=model)
            seconds = time.perf_counter() - began
            values = result.optics.cameras[""].values
            assert values is not None
            T_hand_camera = rigid_inverse(result.T_frame_base)
            part = result.part(non_geometric=True)
            T = part.kinematics.poses(part.x, result.samples(truth.fresh))
            found = truth.errors(T, T_hand_camera, float(values[0]))
            figures[f"calib, `--model {model}`"].append([seconds, *found])

        # The chain begins at the hand, which carries the camera.
        pixels = np.column_stack([table.reading("u"), table.reading("v")])
        data = {
            "size": np.array([SIZE_ALONE.width, SIZE_ALONE.height]),
            "board": BOARD.corners,
            "pixels": pixels.reshape(len(q), -1, 2),
            "T_base_hand": rigid_inverse(nominal.poses(q)),
            "T_hand_camera": rigid_inverse(cell.truth.T_frame_base[0]),
            "T_base_board": cell.truth.T_tip_target[0],
            "guess": np.array([900.0, 900.0, SIZE_ALONE.width / 2, SIZE_ALONE.height / 2]),
        }
        for name, of_peer in _run_peers(peers, data).items():
            T_hand_camera = np.array(of_peer["T_hand_camera"])
            T_base_camera = rigid_inverse(nominal.poses(truth.fresh)) @ T_hand_camera
            T = rigid_inverse(T_base_camera) @ np.array(of_peer["T_base_board"])
            found = truth.errors(T, T_hand_camera, float(of_peer["lens"][0]))
            figures[_TITLES[name]].append([of_peer["seconds"], *found])
    for title, of_cells in figures.items():
        seconds, camera, focal, board = np.sqrt(np.mean(np.square(of_cells), axis=0))
        texts = [f"{1e3 * camera:.2f} mm", f"{1e2 * focal:.2f} %", f"{1e3 * board:.2f} mm"]
        yield [title, f"{seconds:.2f} s", *texts]


def point_rows(peers: str) -> Iterator[list[str]]:
    """Yield time and errors of each program on points; ``peers`` is the Python that has the other ones."""
    robot = Robot.load("panda", base="panda_link0", tip="panda_link8")
    figures: dict[str, list[list[float]]] = defaultdict(list)
    for seed in range(CELLS):
        cell = Cell(target=OFFSET)
        scenario = Scenario(robot, cell, model="dh", noise=TrackerNoise(constant=SIGMA))
        simulated = simulate(scenario, count=POINTS, validation=FRESH, seed=seed)
        fitted = np.array([name == "estimate" for name in simulated.measurements.sets])
        q = simulated.measurements.joints_for(robot.joint_names)
        true = simulated.T_frame_target[:, :3, 3]
        table = simulated.measurements.select(fitted)
        for model in ("dh", "auto"):
            began = time.perf_counter()
            result = calibrate(robot, table, cell=cell, model=model)
            seconds = time.perf_counter() - began
            miss = rms_length(result.predict(q[~fitted]) - true[~fitted])
            figures[f"calib, `--model {model}`"].append([seconds, miss])
        data = {
            "urdf": np.array(_chain_urdf(robot)),
            "joints": q[fitted],
            "points": table.points,
            "fresh_joints": q[~fitted],
            "fresh_points": true[~fitted],
        }
        for name, of_peer in _run_peers(peers, data).items():
            figures[name].append([of_peer["seconds"], of_peer["error_m"]])
        miss = rms_length((robot.poses(q[~fitted]) @ pose_of(OFFSET))[:, :3, 3] - true[~fitted])
        figures["nominal robot"].append([0.0, miss])
    for title, of_cells in figures.items():
        seconds, miss = np.sqrt(np.mean(np.square(of_cells), axis=0))
        yield [title, f"{seconds:.2f} s" if seconds else "–", f"{1e3 * miss:.3f} mm"]


def _run_peers(python: str, data: Mapping[str, NDArray[Any]]) -> dict[str, dict[str, Any]]:
    """Return what benchmark_peers.py finds in data by a Python of another environment."""
    script = Path(__file__).with_name("benchmark_peers.py")
    # What is set here for calib is not for another environment.
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    with tempfile.TemporaryDirectory() as folder:
        file, urdf = Path(folder) / "data.npz", Path(folder) / "chain.urdf"
        if "urdf" in data:
            urdf.write_text(str(data["urdf"]), encoding="utf-8")
        arrays: dict[str, Any] = {**data, "urdf": np.array(str(urdf))}
        np.savez(file, **arrays)
        command = [python, str(script), str(file)]
        ran = subprocess.run(
            command, stdout=subprocess.PIPE, text=True, check=True, env=environment
        )
    return dict(json.loads(ran.stdout.splitlines()[-1]))


def _chain_urdf(robot: Robot) -> str:
    """Return the URDF of the joints from base to tip alone, with a link ``target`` at `OFFSET` on the tip."""
    tree = ElementTree.fromstring(robot.urdf.data)
    by_child = {joint.find("child").attrib["link"]: joint for joint in tree.findall("joint")}  # type: ignore[union-attr]
    chain: list[ElementTree.Element] = []
    link = robot.tip
    while link != robot.base:
        chain.insert(0, by_child[link])
        link = by_child[link].find("parent").attrib["link"]  # type: ignore[union-attr]
    made = ElementTree.Element("robot", name="chain")
    for name in (robot.base, *(joint.find("child").attrib["link"] for joint in chain), "target"):  # type: ignore[union-attr]
        ElementTree.SubElement(made, "link", name=name)
    made.extend(chain)
    last = ElementTree.SubElement(made, "joint", name="to_target", type="fixed")
    ElementTree.SubElement(last, "parent", link=robot.tip)
    ElementTree.SubElement(last, "child", link="target")
    ElementTree.SubElement(last, "origin", xyz=" ".join(str(value) for value in OFFSET))
    return ElementTree.tostring(made, encoding="unicode")
