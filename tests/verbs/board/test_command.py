"""`calib board`: files that are read back, and the measured print."""

from __future__ import annotations

import re

import pytest

from calib.boards.board_file import read_board


def test_a_board_without_any_option(call, tmp_path):
    done = call(tmp_path, "board")
    assert done.code == 0
    assert [path.name for path in sorted(tmp_path.iterdir())] == [
        "board.pdf",
        "board.svg",
        "board.toml",
    ]
    board = read_board(tmp_path / "board.toml")
    assert (board.name, board.pattern, board.columns, board.rows) == ("board", "charuco", 10, 7)
    assert (board.square, board.marker) == (0.025, 0.019)
    assert (tmp_path / "board.pdf").read_bytes().startswith(b"%PDF-1.4")
    assert "Written: board.toml" in done.out
    # Files that exist are kept.
    again = call(tmp_path, "board", "--square", "20 mm")
    assert again.code == 1
    assert "board.pdf" in again.err
    assert read_board(tmp_path / "board.toml").square == 0.025


def test_a_board_by_its_options(call, tmp_path):
    words = ("--pattern", "apriltag", "--columns", "3", "--rows", "2", "--square", "50mm")
    words += ("--marker", "3.5 cm", "--first-marker", "10", "--paper", "letter")
    done = call(tmp_path, "board", *words, "--name", "left", "-o", "v1.2", "--quiet")
    assert (done.code, done.out) == (0, "")
    board = read_board(tmp_path / "v1.2.toml")
    assert (board.name, board.columns, board.rows, board.first_marker) == ("left", 3, 2, 10)
    assert (board.square, board.marker, board.dictionary) == (0.05, 0.035, "DICT_APRILTAG_36h11")
    assert b'width="279.4mm"' in (tmp_path / "v1.2.svg").read_bytes()
    assert call(tmp_path, "board", "-o", "b.pdf").code == 0
    assert read_board(tmp_path / "b.toml").name == "b"


def test_what_the_print_measures(call, tmp_path):
    call(tmp_path, "board")
    with (tmp_path / "board.toml").open("a", encoding="utf-8") as file:
        file.write("# on glass\n")
    done = call(tmp_path, "board", "board.toml", "--measured", "249.3 mm")
    assert done.code == 0
    board = read_board(tmp_path / "board.toml")
    assert (board.square, board.marker) == (0.02493, 0.018947)
    assert (tmp_path / "board.toml").read_text(encoding="utf-8").endswith("# on glass\n")
    before = (tmp_path / "board.toml").read_bytes()
    done = call(tmp_path, "board", "board.toml", "--measured", "213 mm")
    assert done.code == 1
    assert '"213 mm / 9"' in done.err
    assert (tmp_path / "board.toml").read_bytes() == before


def test_a_description_is_drawn(call, tmp_path):
    call(tmp_path, "board", "--columns", "5", "--rows", "4", "--legacy")
    pattern = re.search(rb'id="pattern".*', (tmp_path / "board.svg").read_bytes())[0]
    (tmp_path / "board.toml").rename(tmp_path / "b.toml")
    done = call(tmp_path, "board", "b.toml")
    assert done.code == 0
    assert re.search(rb'id="pattern".*', (tmp_path / "b.svg").read_bytes())[0] == pattern
    assert not (tmp_path / "board.toml").exists()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--square", "30"), "--square"),
        (("--square", "300 mm"), "does not fit"),
        (("--paper", "a5"), "paper 'a5'"),
        (("--dictionary", "DICT_5X5_10"), "did you mean"),
        (("--measured", "249 mm"), "--measured takes the description"),
        (("none.toml",), "does not exist"),
        (("none.toml", "--rows", "3"), "BOARD.toml goes with"),
        (("b.toml", "--measured", "1 mm", "--rows", "3"), "--measured goes with"),
    ],
)
def test_calls_that_are_refused(call, tmp_path, words, text):
    done = call(tmp_path, "board", *words)
    assert done.code == 1
    assert text in done.err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("words", [("--columns", "0"), ("--rows", "-1"), ("--first-marker", "-1")])
def test_counts_that_no_board_has_are_a_wrong_call(call, tmp_path, words):
    done = call(tmp_path, "board", *words)
    assert done.code == 2
    assert words[0] in done.err
    assert not list(tmp_path.iterdir())
