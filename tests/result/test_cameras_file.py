"""Cameras and boards as tables of a result file, and back; test_cameras has those of results."""

from __future__ import annotations

import json
from dataclasses import fields

from calib.basics.json_files import plain
from calib.basics.records import json_key, keys_of
from calib.boards.board import Board
from calib.camera.camera import UNKNOWN, Camera
from calib.camera.camera_file import camera_toml
from calib.result.cameras_file import boards_table, cameras_table, read_boards, read_cameras

VALUES = [420.1, 418.0, 641.0, 358.0, -0.02, 0.01, -4e-3, 6e-17]


def written(table):
    """What a JSON file holds of a table."""
    return json.loads(json.dumps(plain(table)))


def attributes(value):
    return {field.name: plain(getattr(value, field.name)) for field in fields(value)}


def test_cameras_are_read_back():
    size = {"width": 1280, "height": 720, "lens": "fisheye"}
    cameras = {
        "": Camera(**size),
        "left": Camera(name="eye", values=VALUES, sigma=[0.0, *[1.5] * 6, UNKNOWN], **size),
        "right": Camera(values=VALUES, **size),
    }
    table = written(cameras_table(cameras))
    assert table[1]["sigma"][-1] is None
    assert table[1]["lens_names"] == ["fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"]
    found = read_cameras(table)
    assert list(found) == ["", "left", "right"]
    for key, camera in cameras.items():
        assert attributes(found[key]) == attributes(camera)
    assert found["left"].sigma[-1] == UNKNOWN
    assert found["right"].sigma is None


def test_boards_are_read_back():
    board = Board(
        name="sheet",
        pattern="charuco",
        columns=7,
        rows=4,
        square=0.02985,
        marker=0.0221,
        dictionary="DICT_5X5_100",
        first_marker=3,
        legacy=True,
        sigma_scale=0.00123,
        sigma_corner=3e-5,
        sigma_warp=2.5e-3,
    )
    table = written(boards_table({"": board}))
    assert (table[0]["square_m"], table[0]["sigma_corner_m"]) == (0.02985, 3e-5)
    assert attributes(read_boards(table)[""]) == attributes(board)


def test_every_key_of_a_camera_is_in_both_files():
    """A new flag of a camera is a field, and nothing else."""
    camera = Camera(width=640, height=480)
    (table,) = cameras_table({"": camera})
    toml = camera_toml(camera)
    rows = keys_of(Camera)
    assert {field.name for field, _ in rows} == {"name", "width", "height", "lens"}
    for field, row in rows:
        assert table[json_key(field)] == getattr(camera, field.name)
        assert f"{row.name} = " in toml
