"""What a picture says about its board, in words."""

from __future__ import annotations

from calib.boards.board import APRILTAG, CHESSBOARD, Board
from calib.boards.board_file import board_toml
from calib.boards.identify import (
    BOTTOM_UP,
    CUT_OFF,
    HALF_TURN,
    MIRRORED,
    MISSING,
    Identified,
)
from calib.boards.markers import KINDS
from calib.show.lines import fill
from calib.verbs.board.text import description

#: What each finding means.
_FINDINGS = {
    MIRRORED: "Mirrored: the board is found only in the flipped picture. If the print is mirrored, its text reads "
    "backwards; print it anew. If only the picture is, switch the mirror of the camera's driver off.",
    BOTTOM_UP: "The ids of the tags begin in the lowest row, as in Kalibr's grids. calib counts from the top: print a "
    "board of calib's, for this one cannot be described.",
    CUT_OFF: "The picture ends less than a row below the last row seen; if the board has more rows, correct them.",
    MISSING: "Some markers are not found: hidden, cut off, blurred or in glare. Check the rows against the board, or "
    "take a picture of all of it.",
    HALF_TURN: "With these columns and rows the chessboard looks the same after half a turn.",
}

#: Ids listed of markers that are on no board.
_LISTED = 12


def identified_text(
    identified: Identified, board: Board, picture: str, *, is_sized: bool
) -> list[str]:
    """Say which board a picture shows.

    Args:
        identified: What was found.
        board: The board found, with its name.
        picture: The file of the picture.
        is_sized: Whether the size of its squares was given.

    Returns:
        Lines of at most 100 columns.
    """
    lines = [fill(f"{picture}: {description(board)}.")]
    if board.pattern == CHESSBOARD:
        text = "Its columns and rows may be the other way round: columns run along the side that you call x."
        lines.append(fill(text))
    else:
        lines.append(fill(f"Found: {len(identified.markers)} of {board.markers} markers."))
        lines += _same_markers(board)
    lines += [fill(f"- {_FINDINGS[code]}", "", "  ") for code in identified.findings]
    if not is_sized:
        lines.append(fill(_size_text(board)))
    return lines


def _same_markers(board: Board) -> list[str]:
    """Say which dictionaries have the same markers."""
    for kind in KINDS:
        larger = kind[kind.index(board.dictionary) + 1 :] if board.dictionary in kind else ()
        if larger:
            text = f"The first markers of {', '.join(larger)} are the same: any of these names will do."
            return [fill(text)]
    return []


def _size_text(board: Board) -> str:
    """Say that a picture does not show lengths."""
    text = "Its size is not in the picture: 30 mm squares are assumed. Give it as --square, or measure the print"
    if board.pattern == CHESSBOARD:
        return f"{text} and correct square_mm."
    if board.pattern == APRILTAG:
        return f"{text} and correct square_mm, the distance of two tags' left edges, and marker_mm."
    return f"{text} and correct square_mm, and marker_mm, which is good to a few percent."


def next_lines(board: Board, path: str) -> list[str]:
    """Say how to give the size of a board whose description was written.

    Args:
        board: The board, of the size that was assumed.
        path: The file of its description.
    """
    return [
        fill(f"Next: measure over {board.columns} squares, and give calib what you read, such as"),
        f'  calib board {path} --measured "{30 * board.columns:g} mm / {board.columns}"',
    ]


def described(board: Board) -> list[str]:
    """Return the description as the lines of a file."""
    return ["", *board_toml(board).splitlines()]


def nothing_text(identified: Identified, picture: str) -> str:
    """Return the message for a picture without a board.

    Args:
        identified: What was found instead.
        picture: The file of the picture.
    """
    if not identified.markers:
        return (
            f"{picture}: no board is found, neither markers nor a chessboard. The board should fill a third of the "
            "picture, be sharp, whole and evenly lit, and have a white margin; a marker needs some 20 pixels a side."
        )
    ids = ", ".join(map(str, identified.markers[:_LISTED]))
    if len(identified.markers) > _LISTED:
        ids += ", ..."
    return (
        f"{picture}: markers of {identified.dictionary} are found (ids {ids}), but no grid of at least 4 in two rows. "
        "Take a picture that shows more of the board."
    )
