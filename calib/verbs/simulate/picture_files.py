"""Pictures of a virtual cell as a folder of files: what a person has before corners are detected.

These are a PNG of every picture, ``joints.csv`` with its joint values, ``board.toml`` with the description of the
board, and ``camera.yaml`` with the stated numbers of the camera, in the format of ROS 2's camera_info.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.basics.files import check_writable, csv_bytes, make_folder, write_atomically
from calib.basics.jobs import Progress
from calib.boards.board_file import board_toml
from calib.boards.render import USUAL_SCENE, Scene, render, write_png
from calib.camera.camera_file import camera_info_yaml
from calib.data.columns import MOVE, SETS
from calib.errors import CalibError
from calib.verbs.simulate.random_streams import stream
from calib.verbs.simulate.scenario import Simulated

#: Names of the files beside the pictures.
JOINTS = "joints.csv"
BOARD = "board.toml"
CAMERA = "camera.yaml"


@dataclass(frozen=True, slots=True, kw_only=True)
class Quality:
    """Quality of pictures."""

    #: Standard deviation of the blur [px].
    blur: float = 0.6
    #: Standard deviation of a pixel's grey value, of 255.
    noise: float = 1.5
    #: Paper, ink, light and background.
    scene: Scene = USUAL_SCENE


#: The quality of a usual camera in focus.
USUAL_QUALITY = Quality()


def write_pictures(
    simulated: Simulated,
    folder: str | Path,
    quality: Quality = USUAL_QUALITY,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> tuple[Path, ...]:
    """Draw the pictures of a simulation, and write them as PNG with the joints' table, the board and the camera.

    Args:
        simulated: Measurements by a camera, with their pictures.
        folder: Made if it does not exist.
        quality: Blur, noise and light.
        overwrite: Whether existing files are replaced.
        progress: Called after each picture with the number drawn and the number of all; None: nothing is called.

    Returns:
        The files, the pictures first. There is no ``camera.yaml`` if only the size of the camera's images is stated.

    Raises:
        FileError: A file exists, or cannot be written.
        CalibError: OpenCV is not installed, or there are several cameras or boards, which are simulated as a table.
    """
    pictures = simulated.pictures
    assert pictures is not None
    equipment = pictures.equipment
    if len(equipment.cameras) > 1 or len(equipment.prints) > 1:
        raise CalibError(
            f"Pictures are drawn of one camera and one board, and the cell has {len(equipment.cameras)} and "
            f"{len(equipment.prints)}. Leave out --images: -o writes the table of corners of all of them."
        )
    values, endings = pictures.readings, [""]
    if pictures.moves is not None:
        values, endings = np.hstack([values, pictures.moves]), ["", MOVE]
    headers = [
        f"{joint.name}{ending} [{'m' if joint.type == 'prismatic' else 'rad'}]"
        for ending in endings
        for joint in simulated.truth.nominal.inputs
    ]
    has_sets = SETS[1] in pictures.sets
    station = [
        name for name in simulated.truth.groups if name
    ]  # of the one camera, if it has a name
    names = ["image", *(["group"] if station else [])]
    rows: list[list[object]] = [[*names, *headers, *(["set"] if has_sets else [])]]
    for file_name, numbers, name in zip(pictures.images, values, pictures.sets, strict=True):
        rows.append([file_name, *station, *numbers.tolist(), *([name] if has_sets else [])])
    contents = {
        JOINTS: csv_bytes(rows),
        BOARD: board_toml(equipment.printed.board).encode(),
    }
    if equipment.stated.values is not None:
        contents[CAMERA] = camera_info_yaml(equipment.stated).encode()
    made = make_folder(folder)
    paths = tuple(made / name for name in (*pictures.images, *contents))
    for path in paths:
        check_writable(path, overwrite=overwrite)
    rng = stream(simulated.seed, "pictures")
    for k, T in enumerate(pictures.T_camera_board):
        image = render(
            equipment.printed,
            equipment.camera,
            T,
            scene=quality.scene,
            blur=quality.blur,
            noise=quality.noise,
            seed=rng,
        )
        write_png(image, paths[k], overwrite=overwrite)
        if progress is not None:
            progress(k + 1, len(pictures.images))
    for name, content in contents.items():
        write_atomically(made / name, content, overwrite=overwrite)
    return paths
