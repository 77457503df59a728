"""Files of boards: written and read back, also by another reader, and mistakes in them."""

from __future__ import annotations

import sys
from dataclasses import fields, replace

import pytest

from calib.basics.records import json_key, keys_of
from calib.boards.board import APRILTAG, CHARUCO, CHESSBOARD, Board
from calib.boards.board_file import board_of_table, board_toml, correct_toml, read_board
from calib.errors import CalibError, FileError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

BOARDS = [
    Board(
        name='a "board"',
        pattern=CHARUCO,
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
    ),
    Board(pattern=CHESSBOARD, columns=4, rows=3, square=0.0317),
    Board(
        pattern=APRILTAG,
        columns=1,
        rows=1,
        square=0.13,
        marker=0.1,
        dictionary="DICT_APRILTAG_36h11",
    ),
]


def attributes(board):
    return {field.name: getattr(board, field.name) for field in fields(board)}


@pytest.mark.parametrize("board", BOARDS, ids=lambda board: board.pattern)
def test_a_board_is_read_back_exactly(board, tmp_path):
    path = tmp_path / "board.toml"
    path.write_text(board_toml(board), encoding="utf-8")
    assert attributes(read_board(path)) == attributes(board)


def test_the_file_is_in_mm_and_percent():
    table = tomllib.loads(board_toml(BOARDS[0]))
    assert table == {
        "name": 'a "board"',
        "pattern": "charuco",
        "columns": 7,
        "rows": 4,
        "square_mm": 29.85,
        "marker_mm": 22.1,
        "dictionary": "DICT_5X5_100",
        "first_marker": 3,
        "layout": "legacy",
        "sigma_scale_percent": 0.123,
        "sigma_corner_mm": 0.03,
        "sigma_warp_mm": 2.5,
    }
    assert set(tomllib.loads(board_toml(BOARDS[1]))) == {
        "name",
        "pattern",
        "columns",
        "rows",
        "square_mm",
        "sigma_scale_percent",
        "sigma_corner_mm",
        "sigma_warp_mm",
    }


def test_every_key_has_a_comment():
    lines = board_toml(BOARDS[0]).splitlines()
    keys = [k for k, line in enumerate(lines) if " = " in line and not line.startswith("#")]
    assert len(keys) == 12
    assert all(lines[k - 1].startswith("# ") for k in keys)


def test_a_table_of_another_file(tmp_path):
    (tmp_path / "board.toml").write_text(board_toml(BOARDS[0]), encoding="utf-8")
    table = {"file": "board.toml"}
    assert attributes(board_of_table(table, "cell.toml, [board]", tmp_path)) == attributes(
        BOARDS[0]
    )
    corrected = board_of_table(table | {"square_mm": 30}, "cell.toml, [board]", tmp_path)
    assert attributes(corrected) == attributes(BOARDS[0]) | {"square": 0.03}


CHARUCO_TABLE = {
    "pattern": "charuco",
    "columns": 5,
    "rows": 7,
    "square_mm": 30,
    "marker_mm": 22,
    "dictionary": "DICT_5X5_50",
}


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"sqare_mm": 30}, "did you mean 'square_mm'"),
        ({"square_mm": "30 mm"}, "'square_mm' is '30 mm'"),
        ({"square_mm": True}, "'square_mm' is True"),
        ({"columns": 5.0}, "'columns' is 5.0"),
        ({"name": 3}, "'name' is 3"),
        ({"layout": "old"}, "'new', 'legacy'"),
        ({"layout": ["new"]}, "'new', 'legacy'"),
        ({"pattern": "charucco"}, "did you mean 'charuco'"),
        ({"columns": 50}, "DICT_5X5_250"),
        ({"dictionary": "DICT_5X5_10"}, "did you mean 'DICT_5X5_1"),
        ({"sigma_warp_mm": -1}, "below 0"),
        ({"file": 3}, "'file' is 3"),
    ],
)
def test_mistakes_are_named_with_their_place(changes, text):
    with pytest.raises(CalibError, match=text) as raised:
        board_of_table(CHARUCO_TABLE | changes, "cell.toml, [board]")
    assert str(raised.value).startswith("cell.toml, [board]: ")


def test_what_is_missing_is_named():
    with pytest.raises(CalibError, match="lacks 'rows', 'square_mm', 'marker_mm', 'dictionary'"):
        board_of_table({"pattern": "charuco", "columns": 5}, "board.toml")


def test_files_that_are_none(tmp_path):
    path = tmp_path / "board.toml"
    with pytest.raises(FileError, match="does not exist"):
        read_board(path)
    path.write_text("square_mm: 30", encoding="utf-8")
    with pytest.raises(FileError, match="not a TOML"):
        read_board(path)
    path.write_text('file = "board.toml"', encoding="utf-8")
    with pytest.raises(CalibError, match="is one itself"):
        read_board(path)


DRAWN = Board(
    pattern=CHARUCO, columns=10, rows=7, square=0.025, marker=0.019, dictionary="DICT_5X5_100"
)


def test_the_file_keeps_what_else_is_in_it():
    text = board_toml(DRAWN) + "# glued to glass\n"
    board = replace(DRAWN, square=0.02493, marker=0.018947, sigma_scale=0.0012)
    corrected = correct_toml(text, board)
    before, after = text.splitlines(), corrected.splitlines()
    changed = [line for line, old in zip(after, before, strict=True) if line != old]
    assert changed == ["square_mm = 24.93", "marker_mm = 18.947", "sigma_scale_percent = 0.12"]


def test_a_file_without_all_keys_is_written_as_a_whole():
    text = (
        "pattern = 'charuco'\ncolumns=10\nrows=7\nsquare_mm = 25\nmarker_mm=19\n"
        "dictionary='DICT_5X5_100'\n"
    )
    board = replace(DRAWN, square=0.02493, marker=0.018947, sigma_scale=0.0012)
    corrected = correct_toml(text, board)
    assert board_toml(board_of_table(tomllib.loads(corrected), "")) == board_toml(board)


def test_every_field_of_a_board_has_a_key_of_its_own():
    rows = list(keys_of(Board))
    assert [field.name for field, _ in rows] == [field.name for field in fields(Board)]
    for names in ([row.name for _, row in rows], [json_key(field) for field, _ in rows]):
        assert len(set(names)) == len(names)
    flags = [option.flag for _, row in rows for option in row.options]
    assert "--first-marker" in flags
    assert len(set(flags)) == len(flags)


KALIBR = """
target_type: 'aprilgrid' #gridtype
tagCols: 6               #number of apriltags
tagRows: 5
tagSize: 0.088           #size of apriltag, edge to edge [m]
tagSpacing: 0.3          #ratio of space between tags to tagSize
"""

KALIBR_CHESSBOARD = """
target_type: 'checkerboard'
targetCols: 6               #number of internal chessboard corners
targetRows: 7
rowSpacingMeters: 0.06
colSpacingMeters: 0.06
"""


def test_targets_of_kalibr(tmp_path):
    path = tmp_path / "april_6x5.yaml"
    path.write_text(KALIBR)
    board = read_board(path)
    assert (board.name, board.pattern, board.columns, board.rows) == (
        "april_6x5",
        "aprilgrid",
        6,
        5,
    )
    assert (board.marker, board.square) == (0.088, pytest.approx(0.1144))
    path.write_text(KALIBR_CHESSBOARD)
    board = read_board(path)
    assert (board.pattern, board.columns, board.rows, board.square) == ("chessboard", 7, 8, 0.06)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (KALIBR.replace("aprilgrid", "circlegrid"), "'circlegrid'"),
        (KALIBR.replace("tagSize: 0.088", ""), "'tagSize' is None"),
        (KALIBR.replace("0.3", "-0.3"), "'tagSpacing' is -0.3"),
        (KALIBR_CHESSBOARD.replace("rowSpacingMeters: 0.06", "rowSpacingMeters: 0.05"), "squares"),
        ("[1, 2", "not a YAML file"),
        ("1", "'target_type' is None"),
    ],
)
def test_what_is_no_target_of_kalibr(tmp_path, text, words):
    path = tmp_path / "target.yaml"
    path.write_text(text)
    with pytest.raises(CalibError, match=words):
        read_board(path)
